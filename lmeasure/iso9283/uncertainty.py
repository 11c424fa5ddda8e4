"""Uncertainty of characteristics by propagation of distributions (JCGM 101) and by the linear law (JCGM 100).

A characteristic is a function f of the attained poses x of its cycles. What is measured is x + e, with e the instrument's errors of known
law, and f(x + e) is the value that is certified; its error is f(x + e) - f(x). For a signed component f is linear and the error's law does
not depend on x. For a length of a vector, a standard deviation or a maximum it does: noise makes them larger than they are. The law of the
error is therefore drawn at an x* as likely as x itself: the measured poses with their deviations reduced by what the errors have added on
average (`reduction`). U95 is the 95 % quantile of |f(x* + e) - f(x*)|, so that value +- U95 holds f(x).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.iso9283.figure import Function, Subject
from lmeasure.trajectory import PoseErrors

COVERAGE = 0.95
NORMAL_95 = 1.959963984540054
"""Half width of the interval that holds 95 % of a normal law, in standard deviations."""
NORMAL_95_ONE_SIDED = 1.6448536269514722
STEP = 1e-3
"""Of the errors, for the linear law: derivatives along the drawn errors."""
POINTS_AT_ONCE = 100_000
LINEAR_TRIALS = 500  # a standard deviation of as many draws is known to 3 %


class Part(Protocol):
    """Attained poses that figures are made of, and the law of their errors (n poses)."""

    @property
    def positions(self) -> FloatArray:
        """(n, 3) where they are [mm]."""
        ...

    @property
    def errors(self) -> PoseErrors:
        """Law of the n errors."""
        ...

    def state(self, errors: FloatArray, reduced: bool) -> Any:
        """What figures are functions of, moved by errors (..., n, 6); reduced: of x*, else of the measured poses."""
        ...


@dataclass(frozen=True)
class Spread:
    """What is known of a figure's error: u95 by Monte Carlo, standard uncertainties by the linear law; bias: mean of the error."""

    u95: float
    u_random: float
    u_systematic: float
    bias: float


def reduction(observed: FloatArray | float, added: FloatArray | float, freedom: float = np.inf) -> FloatArray:
    """Factor (...) on deviations whose mean square is observed (...) so that what errors have added to it is taken away.

    freedom: degrees of freedom of the observed mean square. It is taken for the most that is likely, 1.64 standard deviations (5 %) of
    sqrt(2 / freedom) above what it should be: the smaller the deviations are in truth, the more the errors enlarge figures made of them.
    """
    observed, added = np.asarray(observed, dtype=np.float64), np.asarray(added, dtype=np.float64)
    least = observed / (1.0 + NORMAL_95_ONE_SIDED * np.sqrt(2.0 / freedom))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.where(least > added, (least - added) / observed, 0.0))


def reduction_of_mean(observed: FloatArray | float, added: FloatArray | float, axes: int) -> FloatArray:
    """Factor (...) on vectors of so many axes, whose squared lengths are observed (...), down to the least length that could have been
    measured so long.

    added (...): trace of the covariance of their errors. One part of as many as there are axes lies along the vector, the rest lengthens
    it; the least is 1.64 standard deviations (5 %) of an error wholly along it shorter. Errors that are added to a vector near zero always
    lengthen it, by up to the radius that holds 95 % of them.
    """
    observed, added = np.asarray(observed, dtype=np.float64), np.asarray(added, dtype=np.float64)
    least = np.sqrt(np.maximum(observed - (1.0 - 1.0 / axes) * added, 0.0)) - NORMAL_95_ONE_SIDED * np.sqrt(added)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(least > 0.0, least / np.sqrt(observed), 0.0)


@dataclass(frozen=True)
class _Law:
    """The errors of a part, ready to be drawn."""

    errors: PoseErrors
    rng: np.random.Generator

    def draw(self, common: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Errors by the counts and by the instrument (trials, n, 6) each, with the run's own draws common (trials, K)."""
        e, trials, n = self.errors, len(common), len(self.errors)
        random = np.einsum("nij,tnj->tni", e.own, e.drawn(self.rng, (trials, n, e.own.shape[2])), optimize=True)
        of_counts = np.flatnonzero(e.counted)
        by_counts = np.zeros_like(common)
        by_counts[:, of_counts] = common[:, of_counts]
        shared = e.shared.reshape(n * 6, -1).T
        random += (by_counts @ shared).reshape(trials, n, 6)
        systematic = ((common - by_counts) @ shared).reshape(trials, n, 6)
        if e.local.any():
            drawn = e.drawn(self.rng, (trials, int(e.place.max()) + 1, e.local.shape[2]))
            systematic += np.einsum("nij,tnj->tni", e.local, drawn[:, e.place], optimize=True)
        return random, systematic


Moving = Callable[[dict[Subject, FloatArray]], dict[Subject, FloatArray]]
"""What a fitted frame does to the errors of all parts."""


def propagate(
    parts: Mapping[Subject, Part],
    figures: Sequence[Function],
    *,
    trials: int,
    seed: int,
    fitted: Moving | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Spread]:
    """The spread of each figure over as many trials; every part draws from its own stream, the run's common errors from one."""
    points = max(sum(len(p.errors) for p in parts.values()), 1)
    at_once = int(np.clip(POINTS_AT_ONCE // points, 1, trials))
    widest = max((p.errors for p in parts.values()), key=lambda e: e.shared.shape[2], default=None)
    streams = np.random.default_rng(seed).spawn(len(parts) + 1)
    laws = {name: _Law(p.errors, rng) for (name, p), rng in zip(parts.items(), streams[1:], strict=True)}
    still = {name: np.zeros((len(p.errors), 6)) for name, p in parts.items()}

    def values(errors: dict[Subject, FloatArray], reduced: bool) -> list[FloatArray]:
        moved = fitted(errors) if fitted is not None else errors
        states = {name: part.state(moved[name], reduced) for name, part in parts.items()}
        return [np.atleast_1d(f(states)) for f in figures]

    base, measured = values(still, True), values(still, False)
    error = np.empty((len(figures), trials))
    linear = np.empty((2, len(figures), min(trials, LINEAR_TRIALS)))
    for first in range(0, trials, at_once):
        last = min(first + at_once, trials)
        common = np.empty((last - first, 0)) if widest is None else widest.drawn_common(streams[0], last - first)
        drawn = {name: law.draw(common[:, : parts[name].errors.shared.shape[2]]) for name, law in laws.items()}
        both = values({name: r + s for name, (r, s) in drawn.items()}, True)
        for i, value in enumerate(both):
            error[i, first:last] = value - base[i]
        if first < linear.shape[2]:
            stop = min(last, linear.shape[2])
            for kind in (0, 1):
                small = values({name: STEP * pair[kind][: stop - first] for name, pair in drawn.items()}, False)
                for i, value in enumerate(small):
                    linear[kind, i, first:stop] = (value - measured[i]) / STEP
        if progress is not None:
            progress(last, trials)
    u = np.sqrt(np.mean(linear**2, axis=2))
    u95 = np.quantile(np.abs(error), COVERAGE, axis=1)
    return [Spread(float(u95[i]), float(u[0, i]), float(u[1, i]), float(error[i].mean())) for i in range(len(figures))]
