"""A list of commands for the people and programs that make a robot run it."""

from pathlib import Path
from typing import Any

import numpy as np

from lmeasure import conventions, files, se3
from lmeasure.arrays import IntArray
from lmeasure.certification.campaign import CIRCLE_STEPS, Campaign
from lmeasure.conventions import QUATERNION_COLUMNS
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.program import write_program
from lmeasure.robots.commands import Command

ROBODK_CIRCLE_POINTS = 36


def write_campaign(out: Path, plan: Campaign) -> None:
    """program.toml, commands.csv and robodk.csv in the folder out: all of them or none, for they belong together."""
    with (
        files.whole(out / "program.toml") as program,
        files.whole(out / "commands.csv") as commands,
        files.whole(out / "robodk.csv") as robodk,
    ):
        write_program(program, plan.program)
        write_commands(commands, plan)
        write_robodk(robodk, plan)


def write_commands(path: Path, plan: Campaign) -> None:
    """One row per move (.csv or .parquet): linear, or by arcs, of which a circle has two with a point on the way (`via`) each.

    Columns: command (from 1), target, role, cycle, move, pose, speed_mm_s, dwell_s behind the move, load_kg, and the force at the tool.
    """
    circles = {p.name for p in plan.program.path if p.kind == "circular"}
    rows, owners, moves = [], [], []
    for number, command in enumerate(plan.commands):
        kept = _quarters(command) if command.target in circles and len(command.poses) == CIRCLE_STEPS else None
        poses = command.poses if kept is None else command.poses[kept]
        rows.append(poses)
        owners += [number] * len(poses)
        moves += ["linear"] * len(poses) if kept is None else ["via", "arc"] * (len(poses) // 2)
    owner = np.array(owners)
    last = np.append(np.diff(owner) > 0, True)

    def of(key: str) -> list[Any]:
        return [getattr(plan.commands[i], key) for i in owners]

    columns: dict[str, Any] = {
        "command": owner + 1,
        "target": of("target"),
        "role": [plan.commands[i].role if plan.commands[i].target else "" for i in owners],
    }
    columns |= {"cycle": np.array(of("cycle")), "move": moves}
    columns |= dict(zip((*POSITION_COLUMNS, *QUATERNION_COLUMNS), np.concatenate(rows).T, strict=True))
    columns |= {"speed_mm_s": np.array(of("speed_mm_s")), "dwell_s": np.where(last, of("dwell_s"), 0.0), "load_kg": np.array(of("load_kg"))}
    columns |= dict(zip(("force_x_n", "force_y_n", "force_z_n"), np.array(of("force_n")).T, strict=True))
    files.write_table(path, columns)


def write_robodk(path: Path, plan: Campaign) -> None:
    """Targets as RoboDK's script ImportCSV_XYZWPR reads them: no header; x, y, z [mm], rx, ry, rz [deg] of Rz Ry Rx, the command's number.

    A circle is 36 targets. Speeds and rests have no place in this file.
    """
    lines = []
    for number, command in enumerate(plan.commands, 1):
        every = max(1, len(command.poses) // ROBODK_CIRCLE_POINTS) if len(command.poses) == CIRCLE_STEPS else 1
        poses = command.poses[every - 1 :: every]
        angles = conventions.angles_from_rotation("fanuc-wpr", se3.rotation(poses))
        lines += [", ".join([*(repr(float(v)) for v in (*pose[:3], *turn)), str(number)]) for pose, turn in zip(poses, angles, strict=True)]
    files.write_text(path, "\n".join(lines) + "\n")


def _quarters(command: Command) -> IntArray:
    """Which poses of a circle end its quarters."""
    return np.arange(1, 5) * (len(command.poses) // 4) - 1
