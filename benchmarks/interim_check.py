"""Interim checks drawn again and again: how often a sound instrument fails, and how often what has changed is named.

    python benchmarks/interim_check.py [--draws 200] [--out benchmarks/results/interim_check.md]

Each draw is a calibration of its own (24 poses known to 0.02 mm; six cables with six swivel encoders), and a run of eleven stops by
a rig that counts as the true one, with phases of its own and a robot that repeats to 0.01 mm.
"""

import argparse
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import scipy.stats
from encoder_calibration_coverage import HOME, drawn_campaign, true_rig
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.calibration import calibrate
from lmeasure.interim import Checked, Limits, check_instrument
from lmeasure.observation.parameters import value_of, with_values
from lmeasure.rig import Rig
from lmeasure.simulation.instrument import simulate_run
from lmeasure.simulation.motion import Leg, smooth_path

ALARM = 0.05
ROBOT_MM = 0.01
POSES, U_MM = 24, 0.02


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


def main(arguments: list[str] | None = None) -> int:
    """Exit code 0, or 1 where false alarms are not consistent with what is stated, or what is named is mostly not it."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--draws", type=int, default=200)
    parser.add_argument("--out", type=Path)
    asked = parser.parse_args(arguments)
    n = asked.draws
    lines, good = ["# Interim checks, drawn again and again", "", (__doc__ or "").split("\n\n")[2].strip(), ""], True
    alarms = sum(not checked(seed, lambda rig, _: rig).passed for seed in range(n))
    low, high = (int(scipy.stats.binom.ppf(q, n, ALARM)) for q in (5e-4, 1 - 5e-4))
    good &= low <= alarms <= high
    lines += [f"Sound instruments that fail: {alarms} of {n}; stated {ALARM:.0%}, consistent with it from {low} to {high}.", ""]
    lines += ["| B3 moved, mm | seen | named alone | it is among those named | another named alone |", "|---|---|---|---|---|"]
    for mm in (0.2, 0.5, 1.0):
        every = [checked(10_000 + seed, moved(mm)) for seed in range(n // 4)]
        seen = [f for f in every if f.disagrees]
        alone = [f.causes[0].name == "B3" and f.causes[0].kind == "point" for f in seen if len(f.causes) == 1]
        among = sum(any(c.kind == "point" and c.name == "B3" for c in f.causes) for f in seen)
        k = len(every)
        lines.append(f"| {mm:g} | {len(seen)} of {k} | {sum(alone)} | {among} | {len(alone) - sum(alone)} |")
        # odds of a hundred are what a cause is named by
        good &= len(alone) - sum(alone) <= max(2, 0.05 * k)
    text = "\n".join([*lines, "", "All consistent." if good else "NOT consistent.", ""])
    print(text)
    if asked.out:
        asked.out.write_text(text)
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
