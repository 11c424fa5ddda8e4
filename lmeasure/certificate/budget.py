"""Budgets of a certificate's results (JCGM 100, 8; EA-4/02): which results matter most, their sources by size, what would halve u."""

import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

from lmeasure.core import FloatArray
from lmeasure.iso9283 import key_of, quantity_of

MOST = 10
"""Results that are shown first."""
SMALL = 0.05
"""Share of the variance [%] below which rows are shown together."""
HALF = 0.25
"""Of the variance, that is left when u is halved."""
LEAST_FACTOR = 0.2
"""Smaller than by this factor a source is not made alone: the next one has its part too."""


class Chosen(NamedTuple):
    """A figure of certificate.json, and of how many of its name it is the worst."""

    figure: Mapping[str, Any]
    of: int


def chosen(certificate: Mapping[str, Any]) -> list[Chosen]:
    """At most `MOST` figures, one of a name: of each name the worst. Names with a stated tolerance come before others are left out.

    Worst is the smallest probability to lie within its tolerance, and where none is stated the largest magnitude. Figures of excluded
    parts of the program are none.
    """
    by_name: dict[str, list[Mapping[str, Any]]] = {}
    for figure in certificate["characteristics"]:
        if not figure.get("excluded"):
            by_name.setdefault(str(figure["name"]), []).append(figure)
    known = sorted((n for n in by_name if _place(n)[0] < math.inf or _held(by_name[n])), key=lambda n: (not _held(by_name[n]), _place(n)))
    return [Chosen(min(by_name[n], key=_goodness), len(by_name[n])) for n in sorted(known[:MOST], key=_place)]


def _place(name: str) -> tuple[float, str]:
    """Where the list has a name: those first that tell most of a robot; a component is given by its vector."""
    known = quantity_of(name)
    return (math.inf if known is None else known.summary.get(name, math.inf), name)


def _held(figures: Sequence[Mapping[str, Any]]) -> bool:
    return any("conformity" in f for f in figures)


def _goodness(figure: Mapping[str, Any]) -> tuple[float, float]:
    held = figure.get("conformity")
    return (2.0 if held is None else float(held["probability"]), -abs(float(figure["value"])))


class Gathered(NamedTuple):
    """Rows of a budget, the largest first, and those that are too small to be shown alone."""

    rows: list[Mapping[str, Any]]
    small: list[Mapping[str, Any]]

    @property
    def together(self) -> tuple[float, float]:
        """Contribution and share [%] of the small ones."""
        return math.hypot(*(row["contribution"] for row in self.small)), sum(row["share_percent"] for row in self.small)


def gathered(budget: Sequence[Mapping[str, Any]]) -> Gathered:
    """Return the rows of a budget by size."""
    rows = sorted(budget, key=lambda row: -row["share_percent"])
    large = [row for row in rows if row["share_percent"] >= SMALL]
    return Gathered(large, rows[len(large) :])


def halving(budget: Sequence[Mapping[str, Any]]) -> tuple[list[str], float]:
    """Return the fewest sources which, all this many times smaller, halve the standard uncertainty; none where it is zero."""
    rows, share = sorted(budget, key=lambda row: -row["share_percent"]), 0.0
    for i, row in enumerate(rows, 1):
        share += row["share_percent"] / 100.0
        square = (HALF - (1.0 - share)) / share if share > 0.0 else 0.0
        if square >= LEAST_FACTOR**2:
            return [str(one["source"]) for one in rows[:i]], 1.0 / math.sqrt(square)
    return [], 1.0


def correlations(figures: Sequence[Mapping[str, Any]], matrix: FloatArray | None, results: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return the coefficients of correlation between those of these results that have a linear law; matrix (n, n) of the first n."""
    of = {key_of(f): i for i, f in enumerate(figures[: 0 if matrix is None else len(matrix)])}
    own = [of[key_of(r)] for r in results if key_of(r) in of]
    table = [] if matrix is None else matrix[own][:, own].tolist()
    return {"results": [str(key_of(figures[i])) for i in own], "coefficients": table}
