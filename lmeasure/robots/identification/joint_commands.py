"""Joint values that a robot was sent to, from a table of their own: a log of the controller with times, or one row for each pose."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.io import Column, ForeignTable
from lmeasure.robots.identification.measurements import Measurements, measured, sides
from lmeasure.robots.identification.notes import Noted, noted
from lmeasure.robots.identification.read_measurements import joints_of, names_of
from lmeasure.robots.model import RobotModel
from lmeasure.text import Message


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
        raise FileFormatError(f"{path}: has no rows")
    time_s = table.numbers("time", "s") if table.find("time", "s") else None
    if time_s is not None and (np.diff(time_s) < 0.0).any():
        raise FileFormatError(f"{table.row(1 + int(np.argmax(np.diff(time_s) < 0.0)))}: its time is before that of the row before")
    return Commanded(path, tuple(names_of(table)), joints_of(table, robot), time_s, tuple(table.lines), table.row_names("name") is not None)


def with_joints(points: Measurements, commanded: Commanded) -> tuple[Measurements, list[Noted]]:
    """Measured points that have names and no joint values, with those of the commanded rows of these names, in the order of these.

    FileFormatError where a name stands twice, or none is in both.
    """
    name, times = Counter(commanded.names).most_common(1)[0]
    if times > 1:
        raise FileFormatError(
            f"{commanded.path}: name {name!r} is given {times} times: which a measured point belongs to is not determined"
        )
    row_of = {name: i for i, name in enumerate(commanded.names)}
    both = sorted((row_of[name], i) for i, name in enumerate(points.names) if name in row_of)
    if not both:
        raise FileFormatError(f"{commanded.path}: none of its names is one of the measured points, such as {points.names[0]!r}")
    notes = [noted("unmatched", "point_without_joints", n, row=points.subject(i)) for i, n in enumerate(points.names) if n not in row_of]
    measured_names = set(points.names)
    lost = [i for i, name in enumerate(commanded.names) if name not in measured_names]
    notes += [noted("unmatched", "joints_without_point", commanded.names[i], row=commanded.subject(i)) for i in lost]
    joints = commanded.joints[[row for row, _ in both]]
    return replace(points.of(np.array([i for _, i in both])), joints=joints, side=sides(joints)), notes
