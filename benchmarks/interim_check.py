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
from encoder_calibration_coverage import HOME, drawn_campaign, true_rig
from scipy.spatial.transform import Rotation
from study import Asked, Study

from lmeasure.calibration import calibrate
from lmeasure.core import se3
from lmeasure.procedures import Checked, Limits, check_instrument
from lmeasure.rig import Rig, value_of, with_values
from lmeasure.simulation import Leg, simulate_run, smooth_path

ALARM = 0.05
ROBOT_MM = 0.01
POSES, U_MM = 24, 0.02
SIZES = (0.2, 0.5, 1.0)


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


def sizes(asked: Asked, seed: int) -> list[tuple[float]]:
    """Return a sound instrument, and for every fourth seed one of each size too."""
    return [(mm,) for mm in asked.change if mm == 0.0 or seed % 4 == 0]


STUDY = Study("interim_check", drawn, table, "draws", 200, {"change": (0.0, *SIZES)}, "{change:g} {seed}", sizes, record=Draw)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
