"""Robots whose joints repeat to some hundredths of a degree, read several times at each stay: how often does u95 hold new measurements?

    python benchmarks/repeated_readings.py --robots 200 --keep benchmarks/results/repeated_readings.jsonl [--write]

Each draw is a robot of one of five structures with errors of its links. Its joints repeat to 0.002 to 0.02 degrees, its legs to 0.002 to
0.02 mm, each joint by itself. 30 to 60 stays are read 1 to 10 times, with 1 to 4 targets on the flange, by an instrument of 0.001 to
0.05 mm. `identify` chooses the effects to free by its own tests: none is in the robot but those of the links. 50 new stays judge u95.
"""

import sys
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation
from study import Study, table

from lmeasure.core import se3
from lmeasure.robots import any_shipped, beyond, cross_validation, freed, identify_with_choice, predict
from lmeasure.robots.identification.measurements import measured

STRUCTURES = ("generic6", "generic7", "ur5", "puma560", "gough")
SEED = 18
DEGREE = np.radians(1.0)
KINDS = ("robot", "readings", "targets", "orientation", "u stated")


@dataclass(frozen=True)
class RobotResult:
    """Hold what kind of robot was drawn, the shares [%] of new and of held-out measurements within u95, the number of families freed
    beside the links, and whether u95 was widened away from the measured joints."""

    kinds: dict[str, str]
    unseen: float
    held_out: float
    families: int
    widened: bool


def draw(number: int) -> RobotResult:
    """Draw a robot, identify it and judge it at new stays."""
    rng = np.random.default_rng([SEED, 11, number])
    name = STRUCTURES[number % len(STRUCTURES)]
    nominal: Any = any_shipped(name).model
    n, stays = len(nominal.joint_names), int(rng.integers(30, 61))
    readings, targets = int(rng.integers(1, 11)), int(rng.integers(1, 5))
    oriented, stated = bool(rng.integers(2)), bool(rng.integers(2))
    u_mm, u_rad = 10.0 ** rng.uniform(-3.0, -1.3), np.radians(0.01)
    repeats = rng.uniform(0.002, 0.02, n) * np.where(nominal.sliding, 1.0, DEGREE)
    size = np.array([0.3 if p.unit == "mm" else 0.03 for p in nominal.parameters]) * [p.size for p in nominal.parameters]
    true = nominal.moved(rng.normal(size=len(size)) * size * np.isin(np.arange(len(size)), freed(nominal, ("links",))))
    base = se3.pose(rng.uniform(-2000, 2000, 3), Rotation.random(rng=rng))
    seats = [se3.pose(rng.uniform(-150, 150, 3), Rotation.random(rng=rng)) for _ in range(targets)]
    low, high = nominal.limits
    middle = 0.5 * (low + high)
    first, last = (np.where(nominal.sliding, middle + side * 60.0, np.clip(end, -2.5, 2.5)) for side, end in ((-1.0, low), (1.0, high)))

    def seen(count: int, times: int) -> Any:
        """Return readings of all targets at new stays, stay by stay, all readings of a target one after another."""
        reported = rng.uniform(first, last, (count, n))
        flange = se3.compose(base, true.forward(reported + rng.normal(size=reported.shape) * repeats))
        poses = np.repeat(np.stack([se3.compose(flange, seat) for seat in seats], axis=1), times, axis=1).reshape(-1, 7)
        poses = se3.displaced(poses, rng.normal(size=(len(poses), 6)) * np.repeat([u_rad, u_mm], 3))
        each = np.repeat(np.arange(targets), times)
        return measured(
            np.repeat(reported, len(each), axis=0),
            poses[:, :3],
            poses[:, 3:] if oriented else None,
            target=[f"T{t + 1}" for t in np.tile(each, count)],
            u_position_mm=u_mm if stated else None,
            u_rotation_rad=u_rad if stated and oriented else None,
        )

    found = identify_with_choice(nominal, seen(stays, readings))
    held = cross_validation(found)
    found = replace(found, misfit=1.0 if held is None else held.misfit, beyond=beyond(found))
    later = seen(50, 1)
    predicted = predict(found, later.joints, later.target_of)
    inside = np.mean(np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1) <= predicted.u95_mm)
    kinds = (
        name,
        "1" if readings == 1 else "2 to 4" if readings < 5 else "5 to 10",
        str(targets),
        "yes" if oriented else "no",
        "yes" if stated else "no",
    )
    return RobotResult(
        dict(zip(KINDS, kinds, strict=True)),
        100.0 * float(inside),
        np.nan if held is None else 100.0 * held.within,
        len(found.settings.free) - 1,
        bool(found.beyond.factor > 0.0),
    )


def page(every: list[RobotResult]) -> str:
    """Return the page of results: one row for all robots and one for each kind."""
    groups = [("all", every)]
    groups += [(f"{key}: {v}", [d for d in every if d.kinds[key] == v]) for key in KINDS for v in sorted({d.kinds[key] for d in every})]
    rows = [
        (
            title,
            len(of),
            f"{np.mean([d.unseen for d in of]):.1f}",
            f"{np.nanmean([d.held_out for d in of]):.1f}",
            sum(d.families for d in of),
            sum(d.widened for d in of),
        )
        for title, of in groups
    ]
    about = "\n\n".join((__doc__ or "").split("\n\n")[2:])
    head = ("of", "robots", "unseen within u95, %", "held out within u95, %", "families freed", "widened beyond")
    return f"# Repeated readings and several targets\n\n{about.strip()}\n\n{table(head, rows)}\n"


STUDY = Study("repeated_readings", draw, page, "robots", 200, key="{seed}", record=RobotResult)

if __name__ == "__main__":
    sys.exit(STUDY.command(__doc__))
