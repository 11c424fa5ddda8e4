"""Measurements of a robot from a file, and joint values from a table of their own: a log of the controller, or one row for each pose."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure.core import FileFormatError, FloatArray, conventions
from lmeasure.io import Column, ForeignTable
from lmeasure.robots.identification.measurements import Measurements, Noted, measured, noted, sides
from lmeasure.robots.model import RobotModel
from lmeasure.text import Message, message

OF_THE_PLACE = ("x", "y", "z", "length")
"""Names of columns of the measured place, and joints are not determined by."""


def read_measurements(
    path: Path, robot: RobotModel, columns: Mapping[str, Column] | None = None, *, joints_alone: bool = False, points_alone: bool = False
) -> Measurements:
    """Read `name, joint_1_deg, ..., x_mm, y_mm, z_mm`, optional qx..qw, u_position_mm, u_rotation_deg, target, length_mm with station.

    joints_alone: a file of poses to be predicted, whose places are not looked at; points_alone: one of measured points by name, whose joint
    values stand elsewhere and are NaN here. FileFormatError names file, line and column.
    """
    table = ForeignTable(path, columns, part=points_alone)
    n = len(table)
    if n == 0:
        raise FileFormatError(message("error.has_no_rows", where=path))
    joints = np.full((n, len(robot.joint_names)), np.nan) if points_alone else joints_of(table, robot)
    names = names_of(table)
    target = table.text("target") if table.find("target") else None
    lines = tuple(table.lines)
    if joints_alone:
        return replace(measured(joints, names=names, target=target), lines=lines)
    length = table.numbers("length", "mm", gaps=True) if table.find("length", "mm") else np.full(n, np.nan)
    position = np.full((n, 3), np.nan)
    if table.find("x", "mm") or np.isnan(length).any():
        position = np.column_stack([table.numbers(axis, "mm", gaps=True) for axis in "xyz"])
    _whole(path, position, names, "x, y, z")
    _in_range(path, position, names)
    neither = np.isnan(position[:, 0]) == np.isnan(length)
    if neither.any():
        what = message("robots.row_has_neither" if np.isnan(length[np.argmax(neither)]) else "robots.row_has_both")
        raise FileFormatError(message("error.row", where=path, names=names[int(np.argmax(neither))], what=what))
    quaternion = table.orientation(gaps=True)
    if quaternion is not None:
        _whole(path, quaternion, names, "qx, qy, qz, qw")
    station = None
    if not np.isnan(length).all():
        station = table.text("station")
        lost = [name for name, s, value in zip(names, station, length, strict=True) if not s and not np.isnan(value)]
        if lost:
            raise FileFormatError(message("error.row_a_length_without", where=path, lost=lost[0]))
        station = [s if not np.isnan(value) else "" for s, value in zip(station, length, strict=True)]
    u = {key: table.numbers(key, unit) if table.find(key, unit) else None for key, unit in (("u_position", "mm"), ("u_rotation", "deg"))}
    for key, values in u.items():
        if values is not None and (values < 0).any():
            column = table.find(key, "mm" if key == "u_position" else "deg")
            row = int(np.argmax(values < 0))
            raise FileFormatError(message("error.row_column_a_standard", where=path, names=names[row], name=column.name if column else key))
    if not points_alone:
        table.nothing_else()
    turn = u["u_rotation"]
    found = measured(
        joints,
        position,
        quaternion,
        names=names,
        target=target,
        station=station,
        length_mm=length,
        u_position_mm=u["u_position"],
        u_rotation_rad=None if turn is None else np.radians(turn),
    )
    return replace(found, lines=lines)


def joints_of(table: ForeignTable, robot: RobotModel) -> FloatArray:
    """(N, n) joint values [rad, mm] of a table; FileFormatError where one is missing."""
    return np.column_stack([_joint(table, i, name, bool(robot.sliding[i])) for i, name in enumerate(robot.joint_names)])


def names_of(table: ForeignTable) -> list[str]:
    """Names of its rows, their numbers where it has none."""
    names = table.row_names("name") or [""] * len(table)
    return [name or str(i + 1) for i, name in enumerate(names)]


def _joint(table: ForeignTable, i: int, name: str, slides: bool) -> FloatArray:
    """(n,) values [rad, mm] of a joint, under its own name or its number; a gantry's x is not that of the measured place."""
    unit = "mm" if slides else "deg"
    key = name if name not in OF_THE_PLACE and table.find(name, unit) else f"joint_{i + 1}"
    values = table.numbers(key, unit)
    if slides:
        return values
    conventions.check_angles(values, f"{table.path}: {key}")
    return np.radians(values)


def _whole(path: Path, values: FloatArray, names: list[str], what: str) -> None:
    part = np.isnan(values).any(axis=1) & ~np.isnan(values).all(axis=1)
    if part.any():
        raise FileFormatError(message("error.row_one_of_is", where=path, names=names[int(np.argmax(part))], what=what))


def _in_range(path: Path, position: FloatArray, names: list[str]) -> None:
    far = (np.abs(position) > conventions.MAX_LENGTH_MM).any(axis=1)
    if far.any():
        raise FileFormatError(
            message("error.row_lies_more_than", where=path, names=names[int(np.argmax(far))], max_length_mm=conventions.MAX_LENGTH_MM)
        )


@dataclass(frozen=True)
class Commanded:
    """joints (m, n) [rad, mm] by name, as they stand in a file; time_s (m,) of the instrument's clock, None where the file has no times."""

    path: Path
    names: tuple[str, ...]
    joints: FloatArray
    time_s: FloatArray | None
    lines: tuple[int, ...]
    named: bool = True
    """Whether the file has names, or the rows' numbers stand for them."""

    def __len__(self) -> int:
        return len(self.names)

    def subject(self, row: int) -> Message:
        """A row for a person."""
        return measured(self.joints[row : row + 1], names=self.names[row : row + 1]).of_lines(self.lines[row : row + 1]).subject(0)


def read_commanded(path: Path, robot: RobotModel, columns: Mapping[str, Column] | None = None) -> Commanded:
    """Read `name, joint_1_deg, ...`, optional time_s, which must not go back. FileFormatError names file, line and column."""
    table = ForeignTable(path, columns, part=True)
    if len(table) == 0:
        raise FileFormatError(message("error.has_no_rows", where=path))
    time_s = table.numbers("time", "s") if table.find("time", "s") else None
    if time_s is not None and (np.diff(time_s) < 0.0).any():
        raise FileFormatError(message("error.its_time_is_before", where=table.row(1 + int(np.argmax(np.diff(time_s) < 0.0)))))
    return Commanded(path, tuple(names_of(table)), joints_of(table, robot), time_s, tuple(table.lines), table.row_names("name") is not None)


def with_joints(points: Measurements, commanded: Commanded) -> tuple[Measurements, list[Noted]]:
    """Measured points that have names and no joint values, with those of the commanded rows of these names, in the order of these.

    FileFormatError where a name stands twice, or none is in both.
    """
    name, times = Counter(commanded.names).most_common(1)[0]
    if times > 1:
        raise FileFormatError(message("error.name_is_given_times", where=commanded.path, name=name, times=times))
    row_of = {name: i for i, name in enumerate(commanded.names)}
    both = sorted((row_of[name], i) for i, name in enumerate(points.names) if name in row_of)
    if not both:
        raise FileFormatError(message("error.none_of_its_names", where=commanded.path, names=points.names[0]))
    notes = [noted("unmatched", "point_without_joints", n, row=points.subject(i)) for i, n in enumerate(points.names) if n not in row_of]
    measured_names = set(points.names)
    lost = [i for i, name in enumerate(commanded.names) if name not in measured_names]
    notes += [noted("unmatched", "joints_without_point", commanded.names[i], row=commanded.subject(i)) for i in lost]
    joints = commanded.joints[[row for row, _ in both]]
    return replace(points.of(np.array([i for _, i in both])), joints=joints, side=sides(joints)), notes
