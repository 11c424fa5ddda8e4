"""Sound runs of six drums with six swivel encoders, and of eight drums: how often rounding alone would be taken for a contradiction.

    python benchmarks/false_alarms.py [--cells 400] [--write]

Each cell is one of `single_faults`: a rig, a motion of 4 s at 250 Hz, phases of its counters, all known exactly but these. Chi-squared of
every sample is held against the limits of the normal law (chi-squared of as many degrees of freedom as there are channels to spare) and of
rounding (`trajectory.faults.redundancy`), and the largest of a run against the limits that a run is to pass once in so many.
"""

import sys
from typing import Any

import numpy as np
from scipy.stats import binom, chi2
from single_faults import RIGS, TIME_S, Cell
from study import Study, table

SAMPLES = (1e-2, 1e-3, 1e-4, 1e-5)
RUNS = (0.5, 0.1, 0.01)


def draw(number: int, name: str) -> dict[str, Any]:
    """Return how many samples of a cell are above the limits of SAMPLES, whether its run is above those of RUNS, and the limit of an alarm;
    each by the normal law and by rounding."""
    at = Cell(name, number)
    m = len(at.per_count)
    chi = at.redundancy.parities(at.epochs, at.poses).chi_squared
    limits = (chi2(m - 6).isf, at.redundancy.chance(at.epochs, at.poses, np.ones(m, np.bool_)).limit)
    return {
        "rig": name,
        "samples": [[int((chi > limit(chance)).sum()) for chance in SAMPLES] for limit in limits],
        "runs": [[bool(chi.max() > limit(chance / len(TIME_S))) for chance in RUNS] for limit in limits],
        "limit": [float(limit(1e-3 / len(TIME_S))) for limit in limits],
    }


def page(found: list[dict[str, Any]]) -> str:
    """Return the page of results."""
    about = (__doc__ or "").split("\n\n", 2)
    own = {name: [f for f in found if f["rig"] == name] for name in RIGS}
    return "\n".join(["# Alarms of sound runs", "", about[0], "", about[2].strip(), "", *(part(n, f) for n, f in own.items() if f)])


def part(name: str, found: list[dict[str, Any]]) -> str:
    """Return the table of a rig."""
    samples, runs, limits = (np.array([f[key] for f in found]).astype(float).mean(axis=0) for key in ("samples", "runs", "limit"))
    rows = [
        ["samples", f"{p:g}", f"{n / len(TIME_S):.2g}", f"{o / len(TIME_S):.2g}", ""] for p, n, o in zip(SAMPLES, *samples, strict=True)
    ]
    for chance, normal, own in zip(RUNS, *runs, strict=True):
        rows.append(["runs", f"{chance:g}", f"{normal:.3g}", f"{own:.3g}", f"{binom.ppf(0.99, len(found), chance) / len(found):.3g}"])
    return (
        f"## {name}: {len(found)} runs of {len(TIME_S)} samples\n\n"
        + table(["of", "stated", "normal law", "rounding", "consistent up to"], rows)
        + f"\n\nAn alarm (once in 1,000 runs) starts at chi-squared {limits[1]:.1f} in the mean, by the normal law at {limits[0]:.1f}: "
        f"a fault is seen from {np.sqrt(limits[1] / limits[0]):.2f} times the size on.\n"
    )


STUDY = Study("false_alarms", draw, page, "cells", 400, {"rig": tuple(RIGS)})

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
