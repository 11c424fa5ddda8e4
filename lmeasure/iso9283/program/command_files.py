"""A list of commands for the people and programs that make a robot run it."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import numpy as np
from scipy.spatial.transform import Slerp

from lmeasure.core import QUATERNION_COLUMNS, FileFormatError, FloatArray, IntArray, conventions, se3
from lmeasure.io import files
from lmeasure.iso9283.program.campaign import CIRCLE_STEPS, Campaign
from lmeasure.recording import POSITION_COLUMNS, write_program
from lmeasure.robots import Command, Role
from lmeasure.text import message

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


def read_commands(path: Path) -> tuple[Command, ...]:
    """The commands of such a list, for who carries them out; arcs are straight pieces of a circle's `CIRCLE_STEPS`-th.

    FileFormatError names the file and what is missing.
    """
    table = files.read_table(path)
    if len(table) == 0:
        raise FileFormatError(message("error.holds_no_command", where=path))
    rows = table.matrix((*POSITION_COLUMNS, *QUATERNION_COLUMNS))
    number, move = table.numbers("command"), table.text("move")
    target, role = table.text("target"), table.text("role")
    speed, dwell, load, cycle = (table.numbers(name) for name in ("speed_mm_s", "dwell_s", "load_kg", "cycle"))
    force = table.matrix(("force_x_n", "force_y_n", "force_z_n"))
    edges = [0, *(np.flatnonzero(np.diff(number)) + 1).tolist(), len(number)]
    out, here = [], rows[0]
    for first, end in itertools.pairwise(edges):
        poses = _with_arcs(path, here, rows[first:end], move[first:end])
        role_of = role[first] or "pose"
        if role_of not in get_args(Role):
            raise FileFormatError(
                message("error.line_role_is_none", where=path, first=first + 2, role_of=role_of, options=", ".join(get_args(Role)))
            )
        named = Command(poses, float(speed[first]), float(dwell[end - 1]), target[first], cast(Role, role_of), int(cycle[first]))
        out.append(replace(named, load_kg=float(load[first]), force_n=force[first]))
        here = rows[end - 1]
    return tuple(out)


def _with_arcs(path: Path, here: FloatArray, rows: FloatArray, move: Sequence[str]) -> FloatArray:
    """(k, 7) poses of the way through rows (n, 7), the first from here (7,): `via` and `arc` are a circle's piece through three points."""
    out: list[FloatArray] = []
    for i, kind in enumerate(move):
        if kind == "linear":
            out.append(rows[i][None])
        elif kind == "arc" and i > 0 and move[i - 1] == "via":
            out.append(_arc(path, here if i == 1 else rows[i - 2], rows[i - 1], rows[i]))
        elif kind != "via":
            raise FileFormatError(message("error.move_is_none_of", where=path, kind=kind))
    return np.concatenate(out)


def _arc(path: Path, first: FloatArray, via: FloatArray, last: FloatArray) -> FloatArray:
    """(k, 7) poses behind the first on the arc from it through via to the last; it turns evenly from one orientation to the next."""
    a, b = via[:3] - first[:3], last[:3] - first[:3]
    normal = np.cross(a, b)
    if normal @ normal < 1e-12 * (a @ a) * (b @ b):
        raise FileFormatError(message("error.three_points_of_an", where=path))
    # from the first point to the centre of the circle through three points
    centre = first[:3] + np.cross((a @ a) * b - (b @ b) * a, normal) / (2.0 * (normal @ normal))
    out = first[:3] - centre
    axis = normal / np.linalg.norm(normal)
    across = np.cross(axis, out)
    at = [0.0, *(math.atan2(float((p[:3] - centre) @ across), float((p[:3] - centre) @ out)) % (2.0 * math.pi) for p in (via, last))]
    turn = at[2]
    angles = np.linspace(0.0, turn, max(2, round(turn / (2.0 * math.pi) * CIRCLE_STEPS) + 1))[1:]
    places = centre + np.cos(angles)[:, None] * out + np.sin(angles)[:, None] * across
    return se3.pose(places, Slerp(at, se3.rotation(np.array([first, via, last])))(angles))


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
