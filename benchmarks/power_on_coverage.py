"""Runs that begin nobody knows where, drawn again and again: are the first pose and the lengths that were out where they are stated to be?

    python benchmarks/power_on_coverage.py --draws 200 --keep power_on.jsonl [--write]     (goes on from what is kept)

Each draw is a rig of six drums, zeroed anywhere within a count at the first sample, with six absolute swivel encoders of 17 bits whose
zeros are known to 0.002 degrees and drawn so, and a motion of 2 s at 250 Hz. Squared errors are in units of the stated covariances.
"""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.stats import binom, chi2
from study import Study

from lmeasure.core import LMeasureError, se3
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import span_lengths
from lmeasure.simulation import cell_rig, simulate_run
from lmeasure.trajectory import align, covariances, prepare, reconstruct

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
TIME_S = np.arange(0.0, 2.0, 0.004)
U_ZERO_DEG = 0.002
KINDS = {"first": 3, "turn": 3, "last": 3, "lengths": 6}
"""What is held against its covariance, and of how many degrees of freedom."""


@dataclass(frozen=True)
class Draw:
    """Squared errors of the first place, the first orientation, the last place and the six lengths that were out; NaN where the start, or
    the pose, was not told, and nothing was stated."""

    number: int
    first: float
    turn: float
    last: float
    lengths: float


def draw(number: int) -> Draw:
    """One run."""
    rng = np.random.default_rng([number, 11])
    data = cell_rig(int(rng.integers(1, 1000))).to_dict()
    zeros = rng.uniform(-180.0, 180.0, 6)
    common = {"counts_per_revolution": 2**17, "u_zero_deg": U_ZERO_DEG}

    def with_zeros(values: Any) -> Any:
        swivels = [{"point": f"B{i + 1}", "channel": f"sw{i + 1}", "zero_deg": float(v), **common} for i, v in enumerate(values)]
        return rig_from_dict(data | {"swivel": swivels})

    size, way = np.repeat([0.2, 150.0], 3) * rng.uniform(0.4, 1.0, 6), rng.uniform(1.0, 2.5, (2, 6))
    start = se3.displaced(HOME, np.repeat([0.1, 80.0], 3) * rng.uniform(-1.0, 1.0, 6))
    poses = se3.displaced(start, size * (np.sin(way[0] * TIME_S[:, None]) + 0.4 * np.sin(3.0 * way[1] * TIME_S[:, None])))
    true, nominal = with_zeros(zeros), with_zeros(zeros + U_ZERO_DEG * rng.standard_normal(6))
    run = replace(simulate_run(true, TIME_S, poses, noise_mm=0.0, rng=rng).run, rig=nominal, start=None)
    try:
        reconstruction = prepare(align(run))
        found = reconstruct(run)
    except LMeasureError as refused:
        print(f"{number}: {refused}")
        return Draw(number, *[np.nan] * 4)
    known = np.isfinite(found.poses[:, :1])
    error = np.where(known, se3.displacement(np.where(known, found.poses, HOME), poses), np.nan)
    both = covariances(found, run)
    whole = both.random + both.factors @ np.swapaxes(both.factors, 1, 2)
    reported, budget = reconstruction.budget.estimate, reconstruction.budget
    if reported is None:  # the readings contradict each other from the beginning on, and it says so
        return Draw(number, *[np.nan] * 4)
    # readings are too large by what was taken to be out less what was, and by where within a count each was zeroed, which nobody knows
    out = span_lengths(nominal, reconstruction.model.zero_pose[None])[0] - span_lengths(true, poses[:1])[0]
    columns = budget.origin_lengths(np.zeros(1))[0, :6] @ reported.mix[-len(reported.mean) :]
    off = budget.offsets(np.zeros(1))[0, :6] - out
    return Draw(number, *(_square(e, c) for e, c in (
        (error[0, 3:], whole[0, 3:, 3:]), (error[0, :3], whole[0, :3, :3]), (error[-1, 3:], whole[-1, 3:, 3:]),
        (off, columns @ columns.T + np.diag(budget.variance[:6])),
    )))  # fmt: skip


def _square(error: Any, covariance: Any) -> float:
    return float(error @ np.linalg.solve(covariance, error))


def table(draws: list[Draw]) -> str:
    """The page of results."""
    lines = ["# Power-on: where a run began", "", (__doc__ or "").split("\n\n")[2].strip(), ""]
    lines += ["| what | within the stated 95 % | consistent from | mean of the square over its freedom |", "|---|---|---|---|"]
    for kind, freedom in KINDS.items():
        values = np.array([getattr(d, kind) for d in draws])
        values = values[np.isfinite(values)]
        n = len(values)
        within = int((values <= chi2.ppf(0.95, freedom)).sum())
        low, high = (int(binom.ppf(q, n, 0.95)) for q in (0.005, 0.995))
        lines.append(f"| {kind} | {within} of {n} ({within / n:.1%}) | {low} to {high} | {values.mean() / freedom:.2f} |")
    missed = sum(not np.isfinite(d.first) for d in draws)
    return "\n".join([*lines, "", f"{missed} of {len(draws)} runs did not tell their start, and said so.", ""])


STUDY = Study("power_on_coverage", draw, table, "draws", record=Draw)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
