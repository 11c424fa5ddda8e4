"""Planned reference poses beside random ones, and predicted length uncertainties beside those of simulated calibrations.

    python benchmarks/planning.py [--campaigns 20] [--write]

For each number of poses: a plan for the simulated cell (box of 600 mm, tilts of 0.3 rad), random poses of the same box (what a user
would teach), and `lmeasure calibrate` on simulated campaigns at both. The rig that is planned with and calibrated from is off by up to
30 mm and 5 degrees from the true one, counts are rounded. The robot stops within 1 mm of the plan; where it stopped is known exactly or
to 0.05 mm. Errors are those of length changes since the cell's middle at 150 held-out poses. --write keeps the table in
results/planning.md.
"""

import os
import platform
import time
from dataclasses import dataclass

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import numpy as np
from numpy.typing import NDArray
from study import options, show

from lmeasure.calibration import Campaign, PlanSettings, Region, calibrate, plan_poses
from lmeasure.recording import Poses
from lmeasure.rig import Rig
from lmeasure.sensors import counts_from_poses, recorded_from_counts, span_lengths
from lmeasure.simulation import cell_rig, scattered_poses

FloatArray = NDArray[np.float64]

REGION = Region(np.full(3, -300.0), np.full(3, 300.0), 0.3, np.array([0.0, 0.0, 0.0, 1.0]))
HALF = (300.0, 300.0, 300.0)
SEED = 20


@dataclass(frozen=True)
class Outcome:
    """Held-out errors of several campaigns [mm]: rms over all, and the largest of all."""

    rms: float
    worst: float


def mistaken(rig: Rig, rng: np.random.Generator) -> Rig:
    """The rig as somebody measured it with a tape and a protractor."""
    points = tuple(
        p.model_copy(
            update={
                "position_mm": tuple(float(x) for x in p.position_mm + rng.uniform(-30, 30, 3)),
                "guide_alpha_deg": p.guide_alpha_deg + float(rng.uniform(-5, 5)),
                "guide_beta_deg": p.guide_beta_deg + float(rng.uniform(-5, 5)),
            }
        )
        for p in rig.observation_point
    )
    return rig.model_copy(update={"observation_point": points})


def campaign_error(true: Rig, nominal: Rig, rows: FloatArray, u_mm: float, held_out: FloatArray, rng: np.random.Generator) -> FloatArray:
    """(n, 6) errors [mm] of length changes after one simulated calibration near the commanded poses rows."""
    n = len(rows)
    rows = rows.copy()
    rows[:, :3] += rng.uniform(-1.0, 1.0, (n, 3))
    real = rows.copy()
    real[:, :3] += u_mm * rng.normal(size=(n, 3))
    counts = recorded_from_counts(true, counts_from_poses(true, real, real[0]))
    poses = Poses(tuple(str(i + 1) for i in range(n)), rows, np.full(n, u_mm), np.zeros(n))
    found = calibrate(Campaign(nominal, poses, true.cable, counts, np.zeros(6, np.int64))).rig
    every = np.vstack([REGION.centre, held_out])
    error = span_lengths(found, every) - span_lengths(true, every)
    return np.asarray(error[1:] - error[0])


def outcome(errors: list[FloatArray]) -> Outcome:
    every = np.array(errors)
    return Outcome(float(np.sqrt(np.mean(every**2))), float(np.abs(every).max()))


def measure(campaigns: int) -> list[str]:
    true = cell_rig(0)
    held_out = scattered_poses(150, HALF, 0.3, REGION.centre, rng=np.random.default_rng(SEED))
    lines = [
        "| poses | u of the poses, mm | plan, s | predicted u, rms / worst, mm | error met, rms / worst, mm | met / predicted, rms | "
        "random poses, error met, rms / worst, mm | random / planned, rms | random / planned, worst |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for u_mm in (0.0, 0.05):
        for count in (6, 8, 12, 20):
            rng = np.random.default_rng([SEED, count, round(100 * u_mm)])
            nominal = mistaken(true, rng)
            began = time.perf_counter()
            plan = plan_poses(nominal, PlanSettings(count, REGION, u_position_mm=u_mm))
            took = time.perf_counter() - began
            planned, drawn = [], []
            for _ in range(campaigns):
                planned.append(campaign_error(true, nominal, plan.poses.rows, u_mm, held_out, rng))
                rows = scattered_poses(count, HALF, 0.3, REGION.centre, rng=rng)
                drawn.append(campaign_error(true, nominal, rows, u_mm, held_out, rng))
            a, b = outcome(planned), outcome(drawn)
            reported = plan.outlook
            lines.append(
                f"| {count} | {u_mm:g} | {took:.1f} | {reported.rms_mm:.4f} / {reported.worst_mm:.4f} | {a.rms:.4f} / {a.worst:.4f} | "
                f"{a.rms / reported.rms_mm:.2f} | {b.rms:.4f} / {b.worst:.4f} | {b.rms / a.rms:.1f} | {b.worst / a.worst:.1f} |"
            )
            print(lines[-1], flush=True)
    return lines


def main() -> None:
    parser = options(__doc__)
    parser.add_argument("--campaigns", type=int, default=20)
    chosen = parser.parse_args()
    lines = measure(chosen.campaigns)
    head = (
        f"# Planned reference poses\n\n`python benchmarks/planning.py --campaigns {chosen.campaigns} --write`, seed {SEED}, one thread; "
        f"{platform.machine()}, {os.cpu_count()} cores, Python {platform.python_version()}, NumPy {np.__version__}.\n\n"
        f"{chosen.campaigns} campaigns a row; each random campaign has poses of its own.\n\n"
    )
    show(chosen, head + "\n".join(lines), "planning")


if __name__ == "__main__":
    main()
