"""How often does the U95 of a largest deviation hold the truth, by what shape the deviations have along the path?

python benchmarks/path_shapes_coverage.py [--runs 1000] [--write]

AT is the largest of many means. Here they have no errors but those of the crossings, white and of standard deviation 1: the worst case,
for systematic errors move all of them together. The law is that of the certificate: errors drawn at the likely deviations.
"""

import sys
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from study import Study, percent, table

from lmeasure.iso9283.clauses.path import DOUBT_OF_MEAN
from lmeasure.iso9283.figure import cosines, reduced

FloatArray = NDArray[np.float64]

TRIALS = 200
Shape = Callable[[np.random.Generator, FloatArray], FloatArray]
SHAPES: dict[str, Shape] = {
    "none": lambda _, t: 0.0 * t,
    "a constant offset of 3": lambda _, t: 3.0 + 0.0 * t,
    "a slope of 20": lambda _, t: 20.0 * t,
    "one bump of 5, a tenth of the path wide": lambda _, t: 5.0 * np.exp(-(((t - 0.4) / 0.1) ** 2)),
    "a swing of 30 that dies down": lambda _, t: 30.0 * np.exp(-8.0 * t) * np.sin(40.0 * t),
    "a random walk": lambda rng, t: np.cumsum(rng.normal(size=len(t))),
    "white, as large as the errors": lambda rng, t: rng.normal(size=len(t)),
    "white, three times as large": lambda rng, t: 3.0 * rng.normal(size=len(t)),
    "two waves of 30": lambda _, t: 30.0 * np.cos(4.0 * np.pi * t + 0.3),
    "five waves of 30": lambda _, t: 30.0 * np.cos(10.0 * np.pi * t + 0.3),
    "a step of 10 with a flat top": lambda _, t: np.where(t > 0.6, 10.0, 0.0),
}


def draw(seed: int, shape: str, planes: int) -> dict[str, Any]:
    """Return the error of the largest deviation of one run, and whether its U95 holds the truth."""
    rng, rows, t = np.random.default_rng([1, seed]), cosines(np.zeros(planes, dtype=np.int64)), np.arange(planes) / planes
    true = SHAPES[shape](rng, t)
    measured = true + rng.normal(size=planes)
    likely = rows.T @ reduced((rows @ measured)[:, None, None], np.ones((planes, 1)), 1, DOUBT_OF_MEAN)[:, 0, 0]
    drawn = np.abs(likely + rng.normal(size=(TRIALS, planes))).max(axis=1) - np.abs(likely).max()
    error = float(np.abs(measured).max() - np.abs(true).max())
    return {"shape": shape, "planes": planes, "error": error, "inside": bool(abs(error) <= np.quantile(np.abs(drawn), 0.95))}


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    rows = []
    for shape, planes in dict.fromkeys((f["shape"], f["planes"]) for f in found):
        own = [f for f in found if (f["shape"], f["planes"]) == (shape, planes)]
        rows.append([shape, planes, f"{percent(f['inside'] for f in own)}%", f"{np.mean([f['error'] for f in own]):+.2f}"])
    return (
        "# Coverage of the U95 of a largest deviation, by shape\n\n"
        f"`python benchmarks/path_shapes_coverage.py --write`: {len(own)} runs, {TRIALS} trials each. Errors of crossings alone, standard "
        "deviation 1. A largest of many that are equally large in truth is enlarged by errors more than one measurement can tell.\n\n"
        + table(["deviations along the path", "planes", "inside U95", "mean error"], rows)
    )


STUDY = Study("path_shapes_coverage", draw, page, "runs", 1000, {"shape": tuple(SHAPES), "planes": (30, 100)})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
