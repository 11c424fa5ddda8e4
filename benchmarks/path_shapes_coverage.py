"""How often does the U95 of a largest deviation hold the truth, by what shape the deviations have along the path?

python benchmarks/path_shapes_coverage.py [--runs 1000] [--write]

AT is the largest of many means. Here they have no errors but those of the crossings, white and of standard deviation 1: the worst case,
for systematic errors move all of them together. The law is that of the certificate: errors drawn at the likely deviations.
"""

import argparse
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure.iso9283.clauses.path import DOUBT_OF_MEAN
from lmeasure.iso9283.path_spectrum import cosines, reduced

FloatArray = NDArray[np.float64]

RESULTS = Path(__file__).parent / "results" / "path_shapes_coverage.md"
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


def inside(shape: Shape, planes: int, runs: int, seed: int) -> tuple[float, float]:
    """Share of runs whose U95 holds the truth, and the mean error of the largest."""
    rng, rows, t = np.random.default_rng(seed), cosines(np.zeros(planes, dtype=np.int64)), np.arange(planes) / planes
    held, errors = [], []
    for _ in range(runs):
        true = shape(rng, t)
        measured = true + rng.normal(size=planes)
        likely = rows.T @ reduced((rows @ measured)[:, None, None], np.ones((planes, 1)), 1, DOUBT_OF_MEAN)[:, 0, 0]
        drawn = np.abs(likely + rng.normal(size=(TRIALS, planes))).max(axis=1) - np.abs(likely).max()
        errors.append(np.abs(measured).max() - np.abs(true).max())
        held.append(abs(errors[-1]) <= np.quantile(np.abs(drawn), 0.95))
    return float(np.mean(held)), float(np.mean(errors))


def main() -> None:
    """Print the table, or write it."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--write", action="store_true")
    asked = parser.parse_args()
    lines = [
        "# Coverage of the U95 of a largest deviation, by shape",
        "",
        f"`python benchmarks/path_shapes_coverage.py --write`: {asked.runs} runs, {TRIALS} trials each. Errors of crossings alone, "
        "standard deviation 1. A largest of many that are equally large in truth is enlarged by errors more than one measurement can tell.",
        "",
        "| deviations along the path | planes | inside U95 | mean error |",
        "|---|---|---|---|",
    ]
    for name, shape in SHAPES.items():
        for planes in (30, 100):
            share, error = inside(shape, planes, asked.runs, seed=1)
            lines.append(f"| {name} | {planes} | {share:.1%} | {error:+.2f} |")
    text = "\n".join([*lines, ""])
    if asked.write:
        RESULTS.write_text(text, encoding="utf-8")
    print(text)


if __name__ == "__main__":
    main()
