"""Trajectories that another instrument measured: tables of any usual kind, TUM, EuRoC, and messages of ROS.

Nothing need be there but times and positions. What is not measured is NaN; uncertainties that nobody states are not known, which
`Trajectory.absent` says, and no zero.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure import files, se3
from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.conventions import MAX_LENGTH_MM
from lmeasure.errors import FileFormatError, SettingsError, TrajectoryError
from lmeasure.findings import finding
from lmeasure.foreign import UNIT_TOLERANCE, Column, ForeignTable, decoded, text_of
from lmeasure.opened import open_regular
from lmeasure.status import WORDS, Status
from lmeasure.trajectory.markers import body_of, is_of_markers, read_markers
from lmeasure.trajectory.record import (
    COLUMNS_OF_OURS,
    SYSTEMATIC_COLUMNS,
    UNCERTAINTY_COLUMNS,
    Trajectory,
    diagonal,
    read_own,
)
from lmeasure.trajectory.ros import read_messages

EUROC = re.compile(r"#?\s*timestamp\s*(\[ns\])?\s*,")
_EUROC_POSITION = ("p_RS_R_x", "p_RS_R_y", "p_RS_R_z")
_EUROC_QUATERNION = ("q_RS_x", "q_RS_y", "q_RS_z", "q_RS_w")


@dataclass(frozen=True)
class Stated:
    """What is said of a file beside itself: which column is which, and standard uncertainties of each coordinate [mm] and of a small
    rotation about each axis [rad], instead of the file's. of_others: columns speak of other files too, and what this one has not is one of
    theirs."""

    columns: Mapping[str, Column] | None = None
    u_position_mm: float | None = None
    u_rotation_rad: float | None = None
    of_others: bool = False

    @property
    def anything(self) -> bool:
        """Whether anything is said at all."""
        return bool(self.columns) or self.u_position_mm is not None or self.u_rotation_rad is not None


def read_trajectory(path: Path, stated: Stated | None = None) -> Trajectory:
    """Read what `written.write_trajectory` wrote, where covariances come back as their diagonals, or what another instrument measured.

    .csv, .parquet or any text table with at least time_s, x_mm, y_mm, z_mm (or what `stated.columns` says they are called), EuRoC's .csv,
    .tum, .mcap with PoseStamped or PoseWithCovarianceStamped, labelled markers of a rigid body (`markers`). FileFormatError names the row
    and column.
    """
    path, stated = Path(path), stated or Stated()
    suffix = path.suffix.lower()
    if suffix in (".csv", ".parquet") and not stated.anything:
        table = files.read_table(path) if suffix == ".parquet" else None
        names = table.columns if table is not None else _header(path)
        if set(COLUMNS_OF_OURS) <= set(names):
            return read_own(path)
    kind = kind_of(path)
    if kind == "mcap":
        return _checked(path, _of_messages(path, stated), [])
    if kind in _READERS:
        if stated.columns and not stated.of_others:
            raise SettingsError("columns", f"{path} {_FIXED[kind]}, which says itself what stands where: a table has columns to name")
        return _READERS[kind](path, stated)
    given = ForeignTable(path, stated.columns, part=stated.of_others)
    if len(given) == 0:
        raise FileFormatError(f"{path}: has no rows")
    time_s = given.numbers("time", "s")
    position = np.column_stack([given.numbers(axis, "mm", gaps=True) for axis in "xyz"])
    quaternion = given.orientation(gaps=True)
    random, systematic, absent = _uncertainties(given, stated, quaternion is not None)
    status = None
    if "status" in given.columns:
        words = given.text("status")
        strange = next((i for i, word in enumerate(words) if word not in WORDS), None)
        if strange is not None:
            raise FileFormatError(f"{given.row(strange)}: status {words[strange]!r} is not one of {', '.join(WORDS)}")
        status = np.array([WORDS.index(word) for word in words], dtype=np.int64)
    if not stated.of_others:
        given.nothing_else()
    return _checked(path, _trajectory(time_s, position, quaternion, random, systematic, absent, status), given.lines)


def kind_of(path: Path) -> str:
    """What `read_trajectory` takes a file for: mcap, tum, parquet, markers, euroc, or table."""
    suffix = path.suffix.lower()
    if suffix in (".mcap", ".tum", ".parquet"):
        return suffix[1:]
    line = _header_line(path)
    return "markers" if is_of_markers(line) else "euroc" if EUROC.match(line) else "table"


def _header_line(path: Path) -> str:
    """The first line with anything in it, of a file that may be large."""
    with open_regular(path) as file:
        text = decoded(file.read(1 << 16), path)
    return next((line for line in text.splitlines() if line.strip()), "")


def _header(path: Path) -> list[str]:
    return [name.strip().strip('"') for name in _header_line(path).split(",")]


def _trajectory(
    time_s: FloatArray,
    position: FloatArray,
    quaternion: FloatArray | None,
    random: FloatArray,
    systematic: FloatArray,
    absent: tuple[str, ...],
    status: IntArray | None = None,
) -> Trajectory:
    n = len(time_s)
    poses = np.column_stack([position, np.full((n, 4), np.nan) if quaternion is None else quaternion])
    lost = np.isnan(position).any(axis=1)
    if quaternion is not None:
        lost |= np.isnan(poses[:, 3:]).any(axis=1)
    known = np.where(lost, Status.GAP, Status.OK).astype(np.int64)
    codes = known if status is None else np.where((status == Status.OK) & lost, Status.GAP, status).astype(np.int64)
    poses[codes != Status.OK] = np.nan
    empty = np.full(n, "", dtype=np.object_)
    cause = np.where(codes == Status.OK, empty, np.full(n, finding("cause.not_in_file"), dtype=np.object_))
    covers = "as the file says" if not absent else f"not stated for the {' and the '.join(absent)}"
    nothing = np.full(n, np.nan)
    return Trajectory(
        time_s, poses, nothing, np.zeros(n, dtype=np.int64), codes, cause, empty, nothing.copy(), random, systematic, covers, absent=absent
    )  # fmt: skip


def _uncertainties(table: ForeignTable, stated: Stated, oriented: bool) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """(n, 6, 6) random and systematic covariances, and what of "position" and "rotation" has none."""
    n, given = len(table), set(table.columns)
    u, common = np.zeros((n, 6)), np.zeros((n, 6))
    absent: list[str] = []
    parts = (
        ("position", stated.u_position_mm, "u_position", "mm", slice(0, 3), True),
        ("rotation", stated.u_rotation_rad, "u_rotation", "deg", slice(3, 6), oriented),
    )
    for what, said, name, unit, own, wanted in parts:
        axes = UNCERTAINTY_COLUMNS[own]
        if said is not None:
            u[:, own] = said
        elif set(axes) <= given:
            u[:, own] = np.column_stack([table.numbers(c, gaps=True) for c in axes])
        elif table.find(name, unit):
            one = table.numbers(name, unit, gaps=True)
            u[:, own] = (one if unit == "mm" else np.radians(one))[:, None]
        elif wanted:
            absent.append(what)
        if said is None and set(SYSTEMATIC_COLUMNS[own]) <= given:
            common[:, own] = np.column_stack([table.numbers(c, gaps=True) for c in SYSTEMATIC_COLUMNS[own]])
        bad = (u[:, own] < 0.0).any(axis=1) | (common[:, own] < 0.0).any(axis=1)
        if bad.any():
            raise FileFormatError(f"{table.row(int(np.argmax(bad)))}: a standard uncertainty of the {what} is negative")
    return diagonal(np.maximum(u**2 - common**2, 0.0)), diagonal(common**2), tuple(absent)


def _same(n: int, stated: Stated, oriented: bool) -> tuple[FloatArray, FloatArray, tuple[str, ...]]:
    """Of a file that states no uncertainty."""
    said = (stated.u_position_mm, stated.u_rotation_rad)
    u = np.repeat([0.0 if value is None else value for value in said], 3)
    absent = [w for w, value in zip(("position", "rotation"), said, strict=True) if value is None]
    return diagonal(np.tile(u**2, (n, 1))), np.zeros((n, 6, 6)), tuple(w for w in absent if oriented or w == "position")


def _of_lines(path: Path, stated: Stated) -> Trajectory:
    """TUM: time [s], x y z [m], qx qy qz qw, with blanks between; # begins a comment."""
    rows, lines = [], []
    for number, line in enumerate(text_of(path).splitlines(), 1):
        words = line.split("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            values = [float(word) for word in words]
        except ValueError:
            values = []
        if len(values) != 8 or not np.isfinite(values).all():
            raise FileFormatError(f"{path}: line {number}: is not time x y z qx qy qz qw, eight numbers")
        rows.append(values)
        lines.append(number)
    if not rows:
        raise FileFormatError(f"{path}: has no rows")
    table = np.array(rows)
    return _checked(path, _trajectory(table[:, 0], 1e3 * table[:, 1:4], table[:, 4:], *_same(len(table), stated, oriented=True)), lines)


def _of_euroc(path: Path, stated: Stated) -> Trajectory:
    """EuRoC: times [ns], positions [m], quaternions w first, by the names in the header, which begins with #; or positions alone."""
    rows = [(i, line) for i, line in enumerate(text_of(path).splitlines(), 1) if line.strip()]
    header = [name.split("[")[0].strip() for name in rows[0][1].lstrip("# ").split(",")]
    if header[0] != "timestamp" or not set(_EUROC_POSITION) <= set(header):
        raise FileFormatError(f"{path}: line {rows[0][0]}: an EuRoC header has timestamp, {', '.join(_EUROC_POSITION)}")
    values, lines = [], []
    for number, line in rows[1:]:
        cells = line.split(",")
        try:
            # nanoseconds since 1970 have more digits than a double
            whole, part = divmod(int(cells[0]), 10**9)
            values.append([whole + 1e-9 * part, *(float(cell) for cell in cells[1 : len(header)])])
        except (ValueError, IndexError, OverflowError):
            raise FileFormatError(f"{path}: line {number}: is not a time in nanoseconds and {len(header) - 1} numbers") from None
        if len(values[-1]) != len(header) or not np.isfinite(values[-1]).all():
            raise FileFormatError(f"{path}: line {number}: has {len(values[-1])} numbers, the header {len(header)}")
        lines.append(number)
    if not values:
        raise FileFormatError(f"{path}: has no rows")
    table = np.array(values)
    at = {name: table[:, i] for i, name in enumerate(header)}
    oriented = set(_EUROC_QUATERNION) <= set(header)
    quaternion = np.column_stack([at[name] for name in _EUROC_QUATERNION]) if oriented else None
    position = 1e3 * np.column_stack([at[name] for name in _EUROC_POSITION])
    return _checked(path, _trajectory(table[:, 0], position, quaternion, *_same(len(table), stated, oriented)), lines)


def _of_markers(path: Path, stated: Stated) -> Trajectory:
    """Labelled markers: the rigid body that they are, its uncertainty by how they scatter about it."""
    marked = read_markers(path)
    body = body_of(marked, path)
    random, systematic, absent = _same(len(marked.time_s), stated, oriented=True)
    for what, own in (("rotation", slice(0, 3)), ("position", slice(3, 6))):
        if what in absent:
            random[:, own, own] = body.covariance[:, own, own]
    if len(absent) == 2:
        random = body.covariance
    found = _trajectory(marked.time_s, body.poses[:, :3], body.poses[:, 3:], random, systematic, ())
    return _checked(path, replace(found, notes=body.notes, covers="how the markers scatter about a rigid body"), list(marked.lines))


def _of_messages(path: Path, stated: Stated) -> Trajectory:
    others = [name for name in stated.columns or () if name != "topic"]
    if others and not stated.of_others:
        raise SettingsError("columns", f"{path} holds messages: topic=/NAME may be said of it, not {', '.join(others)}")
    topic = None if stated.columns is None else stated.columns.get("topic")
    read = read_messages(path, None if topic is None else topic.name)
    random, systematic, absent = _same(len(read.time_s), stated, oriented=True)
    # ROS: zeros say that nothing is known
    if read.covariance is not None:
        told = {"rotation": slice(0, 3), "position": slice(3, 6)}
        for what, own in told.items():
            if what in absent and np.einsum("nii->ni", read.covariance)[:, own].all():
                random[:, own, own] = read.covariance[:, own, own]
                absent = tuple(w for w in absent if w != what)
        if not absent and stated.u_position_mm is None and stated.u_rotation_rad is None:
            random = read.covariance
    return _trajectory(read.time_s, read.poses[:, :3], read.poses[:, 3:], random, systematic, absent)


def _checked(path: Path, found: Trajectory, lines: list[int]) -> Trajectory:
    """The trajectory with quaternions of unit length; FileFormatError names the row of a time that goes back, or a number that is none."""

    def refuse(bad: BoolArray, why: str) -> None:
        if bad.any():
            i = int(np.argmax(bad))
            raise FileFormatError(f"{path}: {f'line {lines[i]}' if lines else f'row {i + 1}'}: {why}")

    refuse(np.asarray(np.diff(found.time_s, prepend=-np.inf) <= 0.0), "its time is not after that of the row before")
    with np.errstate(invalid="ignore"):
        refuse(
            np.asarray((np.abs(found.poses[:, :3]) > MAX_LENGTH_MM).any(axis=1)), f"lies more than {MAX_LENGTH_MM:.0f} mm from the origin"
        )
        length = np.linalg.norm(found.poses[:, 3:], axis=1)
        refuse(np.asarray(np.abs(length - 1.0) > UNIT_TOLERANCE), "its quaternion is not of length 1")
    if (found.status != Status.OK).all():
        raise TrajectoryError(f"{path}: no row has a whole pose")
    poses = found.poses.copy()
    poses[:, 3:] /= length[:, None]
    known = ~np.isnan(poses[:, 3])
    poses[known, 3:] = se3.rotation(poses[known]).as_quat(canonical=True)
    return replace(found, poses=poses)


_READERS = {"tum": _of_lines, "markers": _of_markers, "euroc": _of_euroc}
_FIXED = {"tum": "is a TUM file", "markers": "is one of labelled markers", "euroc": "is an EuRoC file"}
