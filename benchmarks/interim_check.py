"""Interim checks drawn again and again: how often a sound instrument fails, and how often what has changed is named.

    python benchmarks/interim_check.py --draws 200 [--keep checks.jsonl --seconds 500] [--write]

Each draw is a calibration of its own (24 poses known to 0.02 mm; six cables with six swivel encoders), and a run of eleven stops by
a rig that counts as the true one, with phases of its own and a robot that repeats to 0.01 mm.
"""

import sys
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats
from scipy.spatial.transform import Rotation
from study import Asked, Study

from lmeasure.calibration import Campaign, calibrate, unknowns_of
from lmeasure.core import se3
from lmeasure.procedures import Checked, Limits, check_instrument
from lmeasure.recording import Poses
from lmeasure.rig import Rig, rig_from_dict, value_of, with_values
from lmeasure.sensors import counts_from_poses, drawn_phases, recorded_from_counts
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
ALARM = 0.05
ROBOT_MM = 0.01
POSES, U_MM = 24, 0.02
SIZES = (0.2, 0.5, 1.0)


def true_rig(seed: int) -> Rig:
    """A cell with an encoder on every pulley."""
    data, rng = cell_rig(seed % 7 + 1).to_dict(), np.random.default_rng([seed, 2])
    data["swivel"] = [
        {
            "point": f"B{i}",
            "channel": f"sw{i}",
            "counts_per_revolution": 2**17,
            "zero_deg": float(rng.uniform(-180, 180)),
            "u_zero_deg": 2.0,
        }
        for i in range(1, 7)
    ]
    return rig_from_dict(data)


def drawn_campaign(true: Rig, rng: np.random.Generator, poses: int, u_mm: float) -> tuple[Campaign, np.ndarray]:
    """What is counted at poses that are known to u_mm, with a nominal rig, and the true poses."""
    rows = np.column_stack([rng.uniform(-300, 300, (poses, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (poses, 3))).as_quat()])
    counts = counts_from_poses(true, rows, rows[0], true.observed)
    counts = recorded_from_counts(true, counts, true.observed, drawn_phases(true, rng, true.observed))
    stated = rows.copy()
    stated[:, :3] += rng.normal(0, u_mm, (poses, 3))
    reference = Poses(tuple(map(str, range(poses))), stated, np.full(poses, u_mm), np.zeros(poses))
    campaign = Campaign(true, reference, true.observed, counts, np.zeros(len(true.observed), np.int64))
    unknowns = unknowns_of(campaign, ("position", "guide"))
    off = unknowns.nominal + rng.normal(size=len(unknowns.names)) * unknowns.width / 3.0
    return replace(campaign, rig=with_values(true, dict(zip(unknowns.names, off.tolist(), strict=True)))), rows


def checked(seed: int, change: Callable[[Rig, np.random.Generator], Rig]) -> Checked:
    """One calibration, and one check of the rig as it has changed."""
    rng, true = np.random.default_rng([seed, 1]), true_rig(seed)
    found = calibrate(drawn_campaign(true, rng, POSES, U_MM)[0])
    places = rng.uniform(-200, 200, (4, 3))
    legs = []
    for place in (*places, np.zeros(3), *places[::-1], np.zeros(3)):
        there = se3.pose(place + rng.normal(0, ROBOT_MM, 3), Rotation.from_rotvec(place / 1000.0))
        legs.append(Leg(there, 800.0, 60.0, 0.5))
    time_s, path = smooth_path(HOME, legs, 25.0)
    time_s, path = np.r_[np.arange(15) / 25.0, time_s + 0.6], np.vstack([np.repeat(path[:1], 15, axis=0), path])
    run = simulate_run(change(true, rng), time_s, path, noise_mm=0.0, rng=rng).run
    limits = Limits(ALARM, repeatability_mm=ROBOT_MM)
    return check_instrument(replace(run, rig=found.rig, calibration=found.record), (), limits)


def moved(mm: float) -> Callable[[Rig, np.random.Generator], Rig]:
    """B3 by so much in any direction."""

    def change(rig: Rig, rng: np.random.Generator) -> Rig:
        way = rng.normal(size=3)
        way *= mm / np.linalg.norm(way)
        names = [f"B3.{axis}_mm" for axis in "xyz"]
        return with_values(rig, {n: (value_of(rig, n) or 0.0) + d for n, d in zip(names, way.tolist(), strict=True)})

    return change


@dataclass(frozen=True)
class Draw:
    """One check: by how much B3 had moved [mm], 0 where nothing had; whether it passed, whether its channels disagreed; what was named."""

    mm: float
    passed: bool
    disagrees: bool
    named: list[str]


def drawn(number: int, mm: float) -> Draw:
    """The check of this number with B3 moved by so much."""
    found = checked(number + (10_000 if mm else 0), moved(mm) if mm else lambda rig, _: rig)
    return Draw(mm, found.passed, found.disagrees, [f"{c.kind} {c.name}" for c in found.causes])


def table(every: list[Draw]) -> tuple[str, bool]:
    """The page of results, and whether all is consistent with what is stated."""
    sound = [d for d in every if not d.mm]
    alarms, n = sum(not d.passed for d in sound), len(sound)
    low, high = (int(scipy.stats.binom.ppf(q, n, ALARM)) for q in (5e-4, 1 - 5e-4))
    good = low <= alarms <= high
    lines = ["# Interim checks, drawn again and again", "", (__doc__ or "").split("\n\n")[2].strip(), ""]
    lines += [f"Sound instruments that fail: {alarms} of {n}; stated {ALARM:.0%}, consistent with it from {low} to {high}.", ""]
    lines += ["| B3 moved, mm | seen | named alone | it is among those named | another named alone |", "|---|---|---|---|---|"]
    for mm in SIZES:
        own = [d for d in every if d.mm == mm]
        seen = [d for d in own if d.disagrees]
        alone = [d.named[0] == "point B3" for d in seen if len(d.named) == 1]
        among, others = sum("point B3" in d.named for d in seen), len(alone) - sum(alone)
        lines.append(f"| {mm:g} | {len(seen)} of {len(own)} | {sum(alone)} | {among} | {others} |")
        # odds of a hundred are what a cause is named by
        good &= others <= max(2, 0.05 * len(own))
    return "\n".join([*lines, "", "All consistent." if good else "NOT consistent.", ""]), good


def sizes(options: Asked, seed: int) -> list[tuple[float]]:
    """Return a sound instrument, and for every fourth seed one of each size too."""
    return [(mm,) for mm in options.change if mm == 0.0 or seed % 4 == 0]


STUDY = Study("interim_check", drawn, table, "draws", 200, {"change": (0.0, *SIZES)}, "{change:g} {seed}", sizes, record=Draw)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
