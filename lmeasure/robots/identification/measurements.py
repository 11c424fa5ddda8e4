"""Measurements of a robot by an instrument: joint values, and for each the place, the pose, or the distance of a target on its flange; and
notes on it."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.text import Message, message

COMPONENTS = 6
ROTATION, POSITION = slice(0, 3), slice(3, 6)
LENGTH = 3
"""Where a row of components (rotation [rad]; position [mm]) holds a length instead."""


@dataclass(frozen=True)
class Measurements:
    """N rows. Of a row either the position is known, with or without the quaternion, or the length; NaN stands for what is not.

    joints (N, n) [rad, mm], side (N, n): see `RobotModel`; target_of, station_of (N,): number of the target on the flange, and of the
    station a length was measured from, -1 where none; position (N, 3) [mm], quaternion (N, 4): instrument_from_target; length_mm (N,).
    covariance (N, 6, 6): of the instrument's random errors, (rotation [rad]; position [mm]) about its own axes, a length's variance at
    the place of x; stated: whether positions (and lengths), and rotations, have it, or it is not known and zero. systematic
    (N, 6, k): errors per standard deviation of k variables that all rows have in common. stay (N,): number of the stay of the robot at
    which a row was measured; readings (N,): of how many readings it is the mean.
    """

    names: tuple[str, ...]
    joints: FloatArray
    side: FloatArray
    targets: tuple[str, ...]
    target_of: IntArray
    stations: tuple[str, ...]
    station_of: IntArray
    position: FloatArray
    quaternion: FloatArray
    length_mm: FloatArray
    covariance: FloatArray
    stated: tuple[bool, bool]
    systematic: FloatArray
    stay: IntArray
    readings: IntArray
    lines: tuple[int, ...] = ()
    """Of the file that they are from, one for each row; none where they are from none."""

    def subject(self, row: int) -> Message:
        """A row for a person: its name, and its line in the file."""
        if self.lines:
            return message("subject.row.line", name=self.names[row], line=self.lines[row])
        return message("subject.row", name=self.names[row])

    def __len__(self) -> int:
        return len(self.names)

    @property
    def placed(self) -> BoolArray:
        """(N,) rows with a position."""
        return np.asarray(~np.isnan(self.position).any(axis=1))

    @property
    def oriented(self) -> BoolArray:
        """(N,) rows with an orientation."""
        return np.asarray(~np.isnan(self.quaternion).any(axis=1))

    @property
    def ranged(self) -> BoolArray:
        """(N,) rows with a length."""
        return np.asarray(~np.isnan(self.length_mm))

    @property
    def known(self) -> BoolArray:
        """(N, 6) components that were measured."""
        out = np.zeros((len(self), COMPONENTS), np.bool_)
        out[:, ROTATION] = self.oriented[:, None]
        out[:, POSITION] = self.placed[:, None]
        out[:, LENGTH] |= self.ranged
        return out

    def of_lines(self, lines: Sequence[int]) -> "Measurements":
        """With where the rows stand in a file."""
        return replace(self, lines=tuple(lines))

    def of(self, rows: IntArray) -> "Measurements":
        """These rows alone; targets and stations keep their numbers."""
        many: tuple[str, ...] = ("joints", "side", "target_of", "station_of", "stay", "readings")
        many += ("position", "quaternion", "length_mm", "covariance", "systematic")
        parts = {key: getattr(self, key)[rows] for key in many}
        return replace(self, names=tuple(self.names[i] for i in rows), lines=tuple(self.lines[i] for i in rows if self.lines), **parts)

    def with_uncertainty(self, u_position_mm: float | None = None, u_rotation_rad: float | None = None) -> "Measurements":
        """With these standard uncertainties of all rows; None leaves what there is."""
        covariance, systematic, stated = self.covariance.copy(), self.systematic.copy(), list(self.stated)
        for which, (u, own) in enumerate(((u_position_mm, POSITION), (u_rotation_rad, ROTATION))):
            if u is not None:
                covariance[:, own, :] = covariance[:, :, own] = 0.0
                covariance[:, own, own] = u**2 * np.eye(3)
                systematic[:, own] = 0.0
                stated[which] = True
        systematic = systematic[:, :, (systematic != 0.0).any(axis=(0, 1))]
        return replace(self, covariance=covariance, systematic=systematic, stated=(stated[0], stated[1]))


def measured(
    joints: FloatArray,
    position: FloatArray | None = None,
    quaternion: FloatArray | None = None,
    *,
    names: Sequence[str] | None = None,
    target: Sequence[str] | None = None,
    station: Sequence[str] | None = None,
    length_mm: FloatArray | None = None,
    u_position_mm: FloatArray | float | None = None,
    u_rotation_rad: FloatArray | float | None = None,
    side: FloatArray | None = None,
) -> Measurements:
    """Measurements from arrays: joints (N, n) [rad, mm], position (N, 3) [mm], quaternion (N, 4), lengths (N,) from stations by name.

    The side of play is by default that of the way from the row before, none for the first: rows stand in the order they were gone to.
    """
    joints = np.asarray(joints, dtype=np.float64)
    n = len(joints)
    covariance = np.zeros((n, COMPONENTS, COMPONENTS))
    for u, own in ((u_rotation_rad, ROTATION), (u_position_mm, POSITION)):
        if u is not None:
            covariance[:, own, own] = np.broadcast_to(np.asarray(u, dtype=np.float64), n)[:, None, None] ** 2 * np.eye(3)
    targets, target_of = _numbered(target, n, "tool")
    stations, station_of = _numbered(station, n, "")
    return Measurements(
        tuple(str(i + 1) for i in range(n)) if names is None else tuple(names),
        joints,
        sides(joints) if side is None else np.asarray(side, dtype=np.float64),
        targets,
        target_of,
        stations,
        station_of,
        np.full((n, 3), np.nan) if position is None else np.asarray(position, dtype=np.float64),
        np.full((n, 4), np.nan) if quaternion is None else np.asarray(quaternion, dtype=np.float64),
        np.full(n, np.nan) if length_mm is None else np.asarray(length_mm, dtype=np.float64),
        covariance,
        (u_position_mm is not None, u_rotation_rad is not None),
        np.zeros((n, COMPONENTS, 0)),
        np.arange(n),
        np.ones(n, dtype=np.int64),
    )


def sides(joints: FloatArray) -> FloatArray:
    """(N, n) on which side of its play each joint lies when it has come from the row before: where it did not move, as it was."""
    moves = np.sign(np.diff(joints, axis=0, prepend=joints[:1]))
    for i in range(1, len(moves)):
        moves[i] = np.where(moves[i] == 0.0, moves[i - 1], moves[i])
    return np.asarray(moves)


def repeated(rows: Measurements) -> list[tuple[int, int]]:
    """Rows that are the copy of an earlier one, joints and measured values alike to the last digit, each with that earlier row."""
    first: dict[bytes, int] = {}
    out = []
    values = np.column_stack([rows.joints, rows.target_of, rows.station_of, rows.position, rows.quaternion, rows.length_mm]) + 0.0
    for i, row in enumerate(values):
        earlier = first.setdefault(row.tobytes(), i)
        if earlier != i:
            out.append((i, earlier))
    return out


def named_alike(rows: Measurements, of: IntArray) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
    """Rows among those given whose name an earlier one of them has, each with that one: with other joint values; and with the same, where
    the same target was measured, from the same station if from any."""
    moved, again = [], []
    first: dict[str, int] = {}
    once: dict[tuple[str, int, int], int] = {}
    for i in of.tolist():
        earlier = first.setdefault(rows.names[i], i)
        if not np.array_equal(rows.joints[i], rows.joints[earlier]):
            moved.append((i, earlier))
            continue
        same = once.setdefault((rows.names[i], int(rows.target_of[i]), int(rows.station_of[i])), i)
        if same != i:
            again.append((i, same))
    return moved, again


def _numbered(names: Sequence[str] | None, n: int, alone: str) -> tuple[tuple[str, ...], IntArray]:
    """Different names in order of appearance and (n,) which of them each row has; an empty name is `alone`, or -1 where that is empty."""
    given = [""] * n if names is None else list(names)
    filled = [name or alone for name in given]
    different = tuple(dict.fromkeys(name for name in filled if name))
    place = {name: i for i, name in enumerate(different)} | {"": -1}
    return different, np.array([place[name] for name in filled], dtype=np.int64)


@dataclass(frozen=True)
class Noted:
    """One line: code as in identified.json, what it says, what it is of, if anything, and the value that it is judged by."""

    code: str
    said: Message
    of: str = ""
    value: float | None = None

    @property
    def text(self) -> str:
        """Return the message, whose text is English."""
        return self.said

    def stated(self) -> dict[str, Any]:
        """As identified.json has it."""
        return {"code": self.code, "of": self.of, "value": self.value, "text": self.text, "finding": self.said.stated()}


def noted(code: str, words: str, of: str = "", value: float | None = None, **values: Any) -> Noted:
    """A note in the words of the catalogue's `identify.WORDS` with these values."""
    return Noted(code, message(f"identify.{words}", **values), of, value)
