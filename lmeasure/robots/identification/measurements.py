"""Measurements of a robot by an instrument: joint values, and for each the position, the pose, or the distance of a target on its flange,
with notes.

The covariance of the parameters is right if the model is right. A real robot has errors that the model lacks, and the parameters absorb
part of them. Near the measured joint values this does no harm; far from them the parameters extrapolate it. The leverage of a pose, the
variance of its place by the parameters, measures how far it is away. Up to the leverage of the measured poses nothing is added. The rest
grows by a factor from predictions between blocks of the measurements (`hold_out.beyond`).

The robot's noise at a stay is one draw. Rows of one stay share it, however many they are; only the instrument's noise differs from reading
to reading. Readings of one target at one stay have the same derivatives, so that their mean and their scatter contain all information.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.text import Message, message

COMPONENTS = 6
ROTATION, POSITION = slice(0, 3), slice(3, 6)
LENGTH = 3
"""Index of a length in a row of components (rotation [rad]; position [mm])."""


@dataclass(frozen=True)
class Measurements:
    """N rows. Each has either a position, with or without the quaternion, or a length; the others are NaN.

    joints (N, n) [rad, mm], side (N, n): see `RobotModel`; target_of, station_of (N,): index of the target on the flange, and of the
    station of a length, -1 without one; position (N, 3) [mm], quaternion (N, 4): instrument_from_target; length_mm (N,). covariance (N, 6,
    6): of the instrument's random errors, (rotation [rad]; position [mm]) about its own axes, a length's variance at the index of x;
    stated: whether positions (and lengths), and rotations, have it, or it is unknown and zero. systematic (N, 6, k): errors per standard
    deviation of k variables common to all rows. stay (N,): index of the robot's stay; readings (N,): number of readings in its mean.
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
    """Lines of the file, one for each row; empty without a file."""

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
        """Return them with the lines of the rows in a file."""
        return replace(self, lines=tuple(lines))

    def of(self, rows: IntArray) -> "Measurements":
        """These rows alone; targets and stations keep their numbers."""
        many: tuple[str, ...] = ("joints", "side", "target_of", "station_of", "stay", "readings")
        many += ("position", "quaternion", "length_mm", "covariance", "systematic")
        parts = {key: getattr(self, key)[rows] for key in many}
        return replace(self, names=tuple(self.names[i] for i in rows), lines=tuple(self.lines[i] for i in rows if self.lines), **parts)

    def with_uncertainty(self, u_position_mm: float | None = None, u_rotation_rad: float | None = None) -> "Measurements":
        """Return them with these standard uncertainties of all rows; None keeps the present ones."""
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
    """Make measurements from arrays: joints (N, n) [rad, mm], position (N, 3) [mm], quaternion (N, 4), lengths (N,) from stations by name.

    The side of play is by default that of the motion from the row before, none for the first: rows are in the order of the motion.
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
    """One line: code as in identified.json, its text, its subject, if any, and the value that it is judged by."""

    code: str
    said: Message
    of: str = ""
    value: float | None = None

    @property
    def text(self) -> str:
        """Return the message, whose text is English."""
        return self.said

    def stated(self) -> dict[str, Any]:
        return {"code": self.code, "of": self.of, "value": self.value, "text": self.text, "finding": self.said.stated()}


def noted(code: str, words: str, of: str = "", value: float | None = None, **values: Any) -> Noted:
    """A note in the words of the catalogue's `identify.WORDS` with these values."""
    return Noted(code, message(f"identify.{words}", **values), of, value)


MOST = 4.0
"""Times its prior: how far a parameter may be off that absorbs errors which the model lacks."""


@dataclass(frozen=True, eq=False)
class Beyond:
    """factor: of standard deviations; from_mm2: variance of all three coordinates together from which on it counts; width (p,): standard
    uncertainties of the priors of the unknowns."""

    factor: float = 0.0
    from_mm2: float = 0.0
    width: FloatArray = field(default_factory=lambda: np.ones(0))

    def places(self, jacobian: FloatArray, covariance: FloatArray) -> FloatArray:
        """Return covariances (N, 3, 3) [mm²] of places with derivatives (N, 3, p) by unknowns of a covariance (p, p), widened beyond the
        measured poses.

        No combination of unknowns becomes less certain than `MOST` times its prior.
        """
        known = jacobian @ covariance @ np.swapaxes(jacobian, 1, 2)
        if not self.factor:
            return np.asarray(known)
        width = self.width
        size, axes = np.linalg.eigh(covariance / np.outer(width, width))
        more = (axes * np.clip(MOST**2 - size, 0.0, self.factor**2 * np.maximum(size, 0.0))) @ axes.T * np.outer(width, width)
        far = np.maximum(1.0 - self.from_mm2 / np.maximum(np.einsum("nii->n", known), 1e-300), 0.0)
        return np.asarray(known + far[:, None, None] * (jacobian @ more @ np.swapaxes(jacobian, 1, 2)))


NOWHERE = Beyond()
"""A robot with a complete model."""


STILL, COARSE = 0.01, 0.1
"""Degrees or millimetres by which joint values of one stay may differ: their last stated digit, between these two."""
DIGITS = 6
OUTLYING = 1e-6
"""Probability, over all readings, with which one of Gaussian errors would be taken for an outlier of its stay."""
HEAVY = 2.0
"""Times the scale of readings, about their median, that tails of a drift or a vibration may be longer than Gaussian ones."""
OTHER = 1e-3
"""Probability of the scatter of readings under the stated one, below which it is another."""
KINDS = (ROTATION, POSITION)


@dataclass(frozen=True)
class Scatter:
    """Scatter of readings about the mean of their stay: sum of squares and degrees of freedom, each (2,) of turns [rad²] and of positions
    and lengths [mm²]."""

    square: FloatArray
    freedom: FloatArray

    @property
    def variance(self) -> FloatArray:
        """(2,) of one reading in each component, 0 where nothing was read twice."""
        return np.asarray(self.square / np.maximum(self.freedom, 1.0))


@dataclass(frozen=True)
class Stays:
    """rows: one for each target, and station, of each stay, the mean of its readings, with `stay` and `readings`; of (N,): which of them
    each reading is part of, -1 where of none; scatter of the readings about these; times (2,): how many times the stated variances of turns
    and positions the readings scatter by, 1 where they are as stated or nothing is stated or read twice."""

    rows: Measurements
    of: IntArray
    scatter: Scatter
    times: FloatArray


def stays_of(joints: FloatArray, sliding: BoolArray) -> IntArray:
    """(N,) the number of each row's stay: rows that follow each other with the same joint values (N, n) [rad, mm], within their resolution.

    The same joint values visited later are another stay.
    """
    values = np.where(sliding, joints, np.degrees(joints))
    digits = next((k for k in range(DIGITS) if np.allclose(values * 10.0**k, np.round(values * 10.0**k), rtol=0.0, atol=1e-6)), DIGITS)
    still = 1.01 * np.clip(10.0**-digits, STILL, COARSE)
    out, first = np.zeros(len(values), dtype=np.int64), 0
    for i in range(1, len(values)):
        moved = bool((np.abs(values[i] - values[first]) > still).any())
        first = i if moved else first
        out[i] = out[i - 1] + moved
    return out


def read_at_stays(rows: Measurements, used: BoolArray) -> Stays:
    """The means of the readings that are used (N,), in the order of the rows."""
    of = np.full(len(rows), -1, dtype=np.int64)
    kinds = np.column_stack([rows.stay, rows.target_of, rows.station_of, rows.oriented, rows.placed])[used]
    _, first, inverse, counts = np.unique(kinds, axis=0, return_index=True, return_inverse=True, return_counts=True)
    place = np.argsort(np.argsort(first))
    of[used] = place[inverse.reshape(-1)]
    firsts, counts = np.flatnonzero(used)[np.sort(first)], counts[np.argsort(first)]
    means, scatter = rows.of(firsts), Scatter(np.zeros(2), np.zeros(2))
    if (counts == 1).all():
        return Stays(means, of, scatter, np.ones(2))

    def mean(values: FloatArray) -> FloatArray:
        out = np.zeros((len(firsts), *values.shape[1:]))
        np.add.at(out, of[used], values[used])
        return out / counts.reshape(-1, *[1] * (values.ndim - 1))

    quaternion = means.quaternion.copy()
    for i in np.flatnonzero((counts > 1) & means.oriented):
        quaternion[i] = Rotation.from_quat(rows.quaternion[of == i]).mean().as_quat()
    # joint values that are the same stay so to the last digit
    joints = means.joints + mean(np.where(of[:, None] >= 0, rows.joints - means.joints[of], 0.0))
    means = replace(means, joints=joints, position=mean(rows.position), quaternion=quaternion, length_mm=mean(rows.length_mm))
    means = replace(means, covariance=mean(rows.covariance), systematic=mean(rows.systematic), readings=counts)
    again = used & (counts[of] > 1)
    own = of[again]
    off = np.zeros((len(own), 6))
    off[:, POSITION] = np.nan_to_num(rows.position[again] - means.position[own])
    turned = rows.oriented[again]
    if turned.any():
        to = Rotation.from_quat(rows.quaternion[again][turned])
        off[turned, ROTATION] = (to * Rotation.from_quat(means.quaternion[own][turned]).inv()).as_rotvec()
    off[:, 3] += np.nan_to_num(rows.length_mm[again] - means.length_mm[own])
    known = rows.known[again]
    share = 1.0 - 1.0 / counts[own]
    stated = np.einsum("nii->ni", rows.covariance[again])
    square, freedom, times = np.zeros(2), np.zeros(2), np.ones(2)
    for kind, part in enumerate(KINDS):
        square[kind], freedom[kind] = (off[:, part] ** 2).sum(), (known[:, part] * share[:, None]).sum()
        if rows.stated[1 - kind] and freedom[kind] > 0.0 and stated[:, part][known[:, part]].all():
            met = float((off[:, part] ** 2 / np.where(known[:, part], stated[:, part], 1.0)).sum())
            if min(scipy.stats.chi2.sf(met, freedom[kind]), scipy.stats.chi2.cdf(met, freedom[kind])) < OTHER / 2.0:
                times[kind] = met / freedom[kind]
    # errors that are stated and not seen between readings are the same in all of them
    size = np.repeat(np.sqrt(times[:, None] / counts + np.maximum(1.0 - times[:, None], 0.0)), 3, axis=0).T
    means = replace(means, covariance=means.covariance * size[:, :, None] * size[:, None, :])
    return Stays(means, of, Scatter(square, freedom), times)


def agreeing(rows: Measurements, used: BoolArray) -> BoolArray:
    """Return (N,) the used rows that agree with the median of three or more readings of their stay; others agree."""
    kinds = np.column_stack([rows.stay, rows.target_of, rows.station_of])
    _, of, counts = np.unique(kinds[used], axis=0, return_inverse=True, return_counts=True)
    of, at = of.reshape(-1), np.flatnonzero(used)
    out = used.copy()
    values = np.column_stack([rows.position, rows.length_mm])[at]
    values = np.where(np.isnan(values), 0.0, values)
    requested = counts[of] > 2
    if not requested.any():
        return out
    square = np.zeros(len(at))
    order = np.argsort(of, kind="stable")
    for part in np.split(order, np.cumsum(counts)[:-1]):
        if len(part) > 2:
            square[part] = ((values[part] - np.median(values[part], axis=0)) ** 2).sum(axis=1)
    stated = np.einsum("nii->n", rows.covariance[:, POSITION, POSITION])[at] / 3.0
    scale = np.maximum(float(np.median(square[requested])) / scipy.stats.chi2.ppf(0.5, 3), stated)
    out[at] &= ~requested | (square <= HEAVY**2 * scale * scipy.stats.chi2.isf(OUTLYING / len(rows), 3))
    return out
