"""What the studies of calibrations against their truth have in common: their table and their command line."""

import itertools
from collections.abc import Callable, Iterable
from functools import partial
from typing import Any

import numpy as np
import pandas as pd
import scipy.stats
from pieces import options, run_all

HEADER = (
    "case", "campaigns", "determined", "values / bound", "lengths / bound", "of these straight", "joint / bound",
    "in 95 % region", "p", "Gaussian region", "values in U95", "lengths in 1.96 u", "another minimum, said", "unsaid",
)  # fmt: skip


def root(squares: pd.Series) -> str:
    """Root of the mean of squared ratios, one a campaign, with its standard error."""
    if len(squares) < 2:
        return "none"
    m = squares.astype(float)
    return f"{np.sqrt(m.mean()):.3f} ± {m.std() / np.sqrt(len(m)) / 2 / np.sqrt(m.mean()):.3f}"


def row(case: str, own: pd.DataFrame, known: pd.DataFrame, regions: pd.DataFrame, minima: pd.DataFrame, straight: float) -> str:
    """A case's line: of its own campaigns those known are held to the bound, regions to their coverage, minima to having said so; straight
    is the bend below which the linear bound is what can be reached."""
    least_bent = known[known["bend"] < straight]
    inside = int(regions["inside"].sum())
    p = scipy.stats.binomtest(inside, len(regions), 0.95).pvalue
    wrong, said = minima["wrong"].astype(bool), minima["said"].astype(bool)
    cells = (
        case, len(own), len(known), root(known["values_to_bound"]), root(known["lengths_to_bound"]), len(least_bent),
        root(least_bent["joint_to_bound"]), f"{100 * inside / len(regions):.1f} %", f"{p:.3f}",
        f"{100 * regions['inside_gaussian'].mean():.1f} %", f"{100 * regions['values_inside'].mean():.1f} %",
        f"{100 * regions['lengths_inside'].mean():.1f} %", int((wrong & said).sum()), int((wrong & ~said).sum()),
    )  # fmt: skip
    return "| " + " | ".join(str(c) for c in cells) + " |"


def command(
    doc: str | None, cases: Iterable[str], study: Callable[[str, int], dict[str, Any]], line: Callable[[str, pd.DataFrame], str | None]
) -> None:
    """Run the studies that are asked for, each kept as soon as it is done, and print the table; line: a case's, None where it has none."""
    parser = options(doc, "campaigns", writes=False)
    parser.add_argument("--case", default="all", choices=["all", *cases])
    asked = parser.parse_args()
    seeds = range(asked.first, asked.first + asked.campaigns)
    every = itertools.product(cases if asked.case == "all" else [asked.case], seeds)
    data = pd.DataFrame(run_all(asked, ((f"{case} {seed}", partial(study, case, seed)) for case, seed in every)))
    print("| " + " | ".join(HEADER) + " |\n" + "|" + "---|" * len(HEADER))
    for case in cases:
        text = line(case, data[data["case"] == case])
        if text is not None:
            print(text)
