"""Trajectories of other instruments: tables of any usual kind, TUM, EuRoC, motion capture, and messages of ROS.

A format is detected by its whole header, and `--columns` that names the header's columns overrules it. Only times and positions are
required. Missing values are NaN; unstated uncertainties are unknown, as `Trajectory.absent` states, not zero.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure import core
from lmeasure.core import BoolArray, FloatArray, IntArray, Status
from lmeasure.io import TIMES, UNIT_TOLERANCE, Column, ForeignTable, columns_of, decoded, files, headed, open_regular, text_of
from lmeasure.text import Message, common, composed, message
from lmeasure.trajectory.files.markers import LEAST, Marked, body_of, is_of_markers, read_markers
from lmeasure.trajectory.files.ros import read_messages
from lmeasure.trajectory.files.trajectory import COLUMNS_OF_OURS, SYSTEMATIC_COLUMNS, UNCERTAINTY_COLUMNS, Trajectory, diagonal, read_own

EUROC = {
    "time": "timestamp", "x": "p_RS_R_x", "y": "p_RS_R_y", "z": "p_RS_R_z",
    "qx": "q_RS_x", "qy": "q_RS_y", "qz": "q_RS_z", "qw": "q_RS_w",
}  # fmt: skip
"""Columns of EuRoC by our names: nanoseconds and metres, where the header states no other units."""
TUM = ("timestamp", "tx", "ty", "tz", "qx", "qy", "qz", "qw")
BAGS = {
    ".db3": "is a ROS 2 bag of SQLite: `mcap convert {name} {stem}.mcap`, or `ros2 bag convert`, makes the .mcap that is read here",
    ".bag": "is a ROS 1 bag: `mcap convert {name} {stem}.mcap` makes the .mcap that is read here",
}
Uncertain = tuple[FloatArray, FloatArray, tuple[str, ...]]
"""(n, 6, 6) random and systematic covariances, and the parts "position" and "rotation" without one."""
REPEATED = 0.01  # Of the rows: so many may have the stamp of the row before and another pose; more, and the stamps are too coarse


@dataclass(frozen=True)
class Stated:
    """Statements about a file outside it: assignment of columns, and standard uncertainties of each coordinate [mm] and of a small rotation
    about each axis [rad], instead of the file's. of_others: columns may name those of other files too. angles: convention of the file's
    angles; likely: that of the program, used unless the units contradict it."""

    columns: Mapping[str, Column] | None = None
    u_position_mm: float | None = None
    u_rotation_rad: float | None = None
    of_others: bool = False
    angles: str | None = None
    likely: str | None = None

    @property
    def anything(self) -> bool:
        """Return whether anything replaces the file's statements."""
        return bool(self.columns) or self.u_position_mm is not None or self.u_rotation_rad is not None


def read_trajectory(
    path: Path,
    stated: Stated | None = None,
    *,
    columns: str | Mapping[str, Column] | None = None,
    u_position_mm: float | None = None,
    u_rotation_deg: float | None = None,
    angles: str | None = None,
) -> Trajectory:
    """Read a trajectory of lmeasure or of another instrument.

    Parameters
    ----------
    path
        .csv, .parquet or text table with time_s, x_mm, y_mm, z_mm; .tum, EuRoC's .csv, exports of Motive and Nexus, markers of a rigid
        body, .mcap with PoseStamped or PoseWithCovarianceStamped.
    stated
        The keywords below as one value.
    columns
        Names and units of other columns: "time=t[ms],x=X[m],...".
    u_position_mm, u_rotation_deg
        Standard uncertainties, if the file states none.
    angles
        Convention of the angle columns.

    Returns
    -------
    Trajectory
        Poses over time. Covariances of a written trajectory come back as their diagonals.

    Raises
    ------
    FileFormatError
        If the file is wrong or its angles are ambiguous. The message names row and column.

    Examples
    --------
    >>> lm.write_trajectory(Path("trajectory.csv"), trajectory)
    >>> lm.read_trajectory(Path("trajectory.csv")).poses.shape
    (58, 7)
    """
    path, stated = Path(path), stated or Stated()
    if columns is not None:
        stated = replace(stated, columns=columns_of(columns) if isinstance(columns, str) else columns)
    if u_position_mm is not None or u_rotation_deg is not None:
        turn = None if u_rotation_deg is None else float(np.radians(u_rotation_deg))
        stated = replace(stated, u_position_mm=u_position_mm, u_rotation_rad=turn)
    stated = replace(stated, angles=angles or stated.angles)
    for name in (stated.angles, stated.likely):
        if name is not None:
            core.convention(name)
    suffix = path.suffix.lower()
    if suffix in (".csv", ".parquet") and not stated.anything:
        table = files.read_table(path) if suffix == ".parquet" else None
        names = table.columns if table is not None else _header(path)
        if set(COLUMNS_OF_OURS) <= set(names):
            return read_own(path)
    kind = kind_of(path)
    if kind == "mcap":
        return _checked(path, _of_messages(path, stated), [], [message("orientation.read", how="ROS message (m): quaternion x, y, z, w")])
    if kind in ("table", "parquet") or (stated.columns and _is_named(path, kind, stated.columns)):
        return _of_table(path, stated)
    if stated.columns and not stated.of_others and set(stated.columns) != {"body"}:
        raise core.SettingsError("columns", message("error.which_says_itself_what", path=path, fixed=_FIXED[kind]))
    return _READERS[kind](path, stated)


def _is_named(path: Path, kind: str, columns: Mapping[str, Column]) -> bool:
    """Return whether --columns names columns of a format's header, as of a table; a choice of one of its markers counts too."""
    if kind == "markers" or (kind == "tum" and not _is_tum_header(_header_line(path))):
        return "body" in columns
    table = ForeignTable(path, {})
    return all(table.holds(name, at) for name, at in columns.items() if name != "body")


def _of_table(path: Path, stated: Stated, default: Mapping[str, Column] | None = None) -> Trajectory:
    """Return the trajectory of a table; default: assignment of columns that --columns does not state."""
    given = ForeignTable(path, {**(default or {}), **(stated.columns or {})}, part=stated.of_others)
    if len(given) == 0:
        raise core.FileFormatError(message("error.has_no_rows", where=path))
    markers = given.layout.markers
    if not given.layout.bodies and len(markers) >= LEAST and not stated.columns:
        return _of_marked(path, _marked(given), stated)
    time_s = given.numbers("time", "s")
    position = np.column_stack([given.numbers(axis, "mm", gaps=True) for axis in "xyz"])
    quaternion = given.orientation(core.convention(stated.angles) if stated.angles else None, likely=stated.likely, gaps=True)
    uncertain = _uncertainties(given, stated, quaternion is not None)
    status = None
    if "status" in given.columns:
        words = given.text("status")
        strange = next((i for i, word in enumerate(words) if word not in core.WORDS), None)
        if strange is not None:
            known = {"words": words[strange], "words2": ", ".join(core.WORDS)}
            raise core.FileFormatError(message("error.status_is_not_one", where=given.row(strange), **known))
        status = np.array([core.WORDS.index(word) for word in words], dtype=np.int64)
    if not stated.of_others:
        given.nothing_else()
    notes = []
    if given.read_as:
        notes.append(message("orientation.read", how=given.read_as))
    elif given.unread:
        notes.append(message("orientation.unread", columns=given.unread))
    if given.day:
        notes.append(message("time.of_day", day=given.day))
    return _checked(path, _trajectory(time_s, position, quaternion, uncertain, status), given.lines, notes)


def kind_of(path: Path) -> str:
    """Return the kind of a file for `read_trajectory`: mcap, tum, parquet, markers, euroc, or table."""
    suffix = path.suffix.lower()
    if suffix in BAGS:
        raise core.FileFormatError(composed("{where}: {error}", where=path, error=BAGS[suffix].format(name=path.name, stem=path.stem)))
    if suffix in (".mcap", ".tum", ".parquet"):
        return suffix[1:]
    text = _beginning(path)
    line = _header_line(path)
    if is_of_markers(line):
        return "markers"
    bare = [name.split("[")[0].strip() for name in line.lstrip("# ").split(",")]
    if bare[0] == "timestamp" and set(EUROC.values()) - set(bare) <= {name for name in EUROC.values() if name.startswith("q")}:
        return "euroc"
    if _is_tum_header(line) or (suffix == ".txt" and _is_tum(text)):
        return "tum"
    return "table"


def _is_tum_header(line: str) -> bool:
    """Return whether a commented line names the columns of a TUM file."""
    names = tuple(re.split(r"[\s,]+", line.strip("# \t\r\n").lower()))
    return line.lstrip().startswith("#") and names[0] in TIMES and names[1:] == TUM[1:]


def _is_tum(text: str) -> bool:
    """Return whether all lines but comments are eight numbers with blanks between, quaternions of unit length in the last four."""
    rows = [line.split() for line in text.splitlines()[:-1] if line.strip() and not line.lstrip().startswith("#")]
    try:
        values = np.array([[float(word) for word in row] for row in rows])
    except ValueError:
        return False
    return values.ndim == 2 and values.shape[1] == 8 and bool((np.abs(np.linalg.norm(values[:, 4:], axis=1) - 1.0) <= UNIT_TOLERANCE).all())


def _beginning(path: Path) -> str:
    """The first lines of a file that may be large."""
    with open_regular(path) as file:
        text = decoded(file.read(1 << 16), path)
    return text if text.endswith("\n") else text + "\n"


def _header_line(path: Path) -> str:
    """The first line with anything in it."""
    return next((line for line in _beginning(path).splitlines() if line.strip()), "")


def _header(path: Path) -> list[str]:
    return [name.strip().strip('"') for name in _header_line(path).split(",")]


def _trajectory(
    time_s: FloatArray, position: FloatArray, quaternion: FloatArray | None, uncertain: Uncertain, status: IntArray | None = None
) -> Trajectory:
    n, (random, systematic, absent) = len(time_s), uncertain
    poses = np.column_stack([position, np.full((n, 4), np.nan) if quaternion is None else quaternion])
    lost = np.isnan(position).any(axis=1)
    if quaternion is not None:
        lost |= np.isnan(poses[:, 3:]).any(axis=1)
    known = np.where(lost, Status.GAP, Status.OK).astype(np.int64)
    codes = known if status is None else np.where((status == Status.OK) & lost, Status.GAP, status).astype(np.int64)
    poses[codes != Status.OK] = np.nan
    empty = np.full(n, "", dtype=np.object_)
    cause = np.where(codes == Status.OK, empty, common(n, message("cause.not_in_file")))
    covers = message(f"covers.not_{'both' if len(absent) > 1 else absent[0]}" if absent else "covers.file_")
    nothing = np.full(n, np.nan)
    return Trajectory(
        time_s, poses, nothing, np.zeros(n, dtype=np.int64), codes, cause, empty, nothing.copy(), random, systematic, covers, absent=absent
    )  # fmt: skip


def _uncertainties(table: ForeignTable, stated: Stated, oriented: bool) -> Uncertain:
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
            raise core.FileFormatError(message("error.a_standard_uncertainty_of", where=table.row(int(np.argmax(bad))), what=what))
    return diagonal(np.maximum(u**2 - common**2, 0.0)), diagonal(common**2), tuple(absent)


def _same(n: int, stated: Stated, oriented: bool) -> Uncertain:
    """Return the uncertainty of a file that states none."""
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
            raise core.FileFormatError(message("error.line_is_not_time", where=path, number=number))
        rows.append(values)
        lines.append(number)
    if not rows:
        raise core.FileFormatError(message("error.has_no_rows", where=path))
    table = np.array(rows)
    found = _trajectory(table[:, 0], 1e3 * table[:, 1:4], table[:, 4:], _same(len(table), stated, oriented=True))
    return _checked(path, found, lines, [message("orientation.read", how="TUM (s, m): quaternion x, y, z, w")])


def _of_euroc(path: Path, stated: Stated) -> Trajectory:
    """EuRoC: its columns are known by name, in the units of its header."""
    columns, given = dict[str, Column](), ForeignTable(path, {})
    for name, own in EUROC.items():
        there = next((n for n in given.columns if n.split("[")[0].strip() == own), None)
        if there is None:
            continue
        unit = headed(there)[1] or given.layout.units.get(there, "")
        columns[name] = Column(there, "" if name.startswith("q") else unit or ("ns" if name == "time" else "m"))
    return _of_table(path, replace(stated, columns=None), columns)


def _of_marked(path: Path, marked: Marked, stated: Stated) -> Trajectory:
    """Labelled markers: the rigid body that they are, its uncertainty by how they scatter about it."""
    body = body_of(marked, path)
    random, systematic, absent = _same(len(marked.time_s), stated, oriented=True)
    for what, own in (("rotation", slice(0, 3)), ("position", slice(3, 6))):
        if what in absent:
            random[:, own, own] = body.covariance[:, own, own]
    if len(absent) == 2:
        random = body.covariance
    found = _trajectory(marked.time_s, body.poses[:, :3], body.poses[:, 3:], (random, systematic, ()))
    return _checked(path, replace(found, covers=message("covers.markers")), list(marked.lines), list(body.notes))


def _marked(given: ForeignTable) -> Marked:
    """The markers of an export that has no rigid body."""
    places = []
    for name, own in given.layout.markers.items():
        one = ForeignTable(given.path, {"body": Column(name, "")})
        places.append(np.column_stack([one.numbers(axis, "mm", gaps=True) for axis in own if axis in "xyz"]))
    time_s = one.numbers("time", "s")
    there = np.stack(places, axis=1)
    there[np.isnan(there).any(axis=2)] = np.nan
    return Marked(tuple(given.layout.markers), time_s, there, tuple(given.lines))


def _of_messages(path: Path, stated: Stated) -> Trajectory:
    others = [name for name in stated.columns or () if name != "topic"]
    if others and not stated.of_others:
        raise core.SettingsError("columns", message("error.holds_messages_topic_name", path=path, others=", ".join(others)))
    topic = None if stated.columns is None else stated.columns.get("topic")
    read = read_messages(path, None if topic is None else topic.name)
    random, systematic, absent = _same(len(read.time_s), stated, oriented=True)
    # ROS: zeros mean unknown
    if read.covariance is not None:
        determined = {"rotation": slice(0, 3), "position": slice(3, 6)}
        for what, own in determined.items():
            if what in absent and np.einsum("nii->ni", read.covariance)[:, own].all():
                random[:, own, own] = read.covariance[:, own, own]
                absent = tuple(w for w in absent if w != what)
        if not absent and stated.u_position_mm is None and stated.u_rotation_rad is None:
            random = read.covariance
    return _trajectory(read.time_s, read.poses[:, :3], read.poses[:, 3:], (random, systematic, absent))


def _checked(path: Path, found: Trajectory, lines: list[int], notes: list[Message] | None = None) -> Trajectory:
    """Return the trajectory with quaternions of unit length, and without rows that repeat the stamp of the one before; notes report these.
    FileFormatError names the row of a time that goes back, or of a wrong number."""

    def at(row: int) -> str:
        return message("log.line", number=lines[row]) if lines else message("file.row", number=row + 1)

    def refuse(bad: BoolArray, why: str) -> None:
        if bad.any():
            raise core.FileFormatError(composed("{where}: {at}: {why}", where=path, at=at(int(np.argmax(bad))), why=why))

    notes = list(notes or [])
    steps = np.diff(found.time_s, prepend=-np.inf)
    refuse(np.asarray(steps < 0.0), message("trajectory_file.time_back"))
    again = np.flatnonzero(steps == 0.0)
    if len(again):
        apart = ~(np.isclose(found.poses[again], found.poses[again - 1], rtol=0.0, atol=1e-12, equal_nan=True)).all(axis=1)
        if apart.sum() > max(2, REPEATED * len(steps)):
            why = message("trajectory_file.coarse_stamps", rows=len(again))
            refuse(np.isin(np.arange(len(steps)), again[apart]), why)
        first = int(again[0])
        number = lines[first] if lines else first + 1
        notes.append(message("time.repeated", rows=len(again), at_s=float(found.time_s[first]), line=number, moved=int(apart.sum())))
        kept = np.ones(len(steps), np.bool_)
        kept[again] = False
        found, lines = _rows_of(found, kept), [line for line, keep in zip(lines, kept, strict=True) if keep] if lines else []
    with np.errstate(invalid="ignore"):
        far = np.asarray((np.abs(found.poses[:, :3]) > core.MAX_LENGTH_MM).any(axis=1))
        refuse(far, message("trajectory_file.too_far", mm=core.MAX_LENGTH_MM))
        length = np.linalg.norm(found.poses[:, 3:], axis=1)
        refuse(np.asarray(np.abs(length - 1.0) > UNIT_TOLERANCE), message("trajectory_file.quaternion"))
    if (found.status != Status.OK).all():
        raise core.TrajectoryError(message("error.no_row_has_a", where=path))
    poses = found.poses.copy()
    poses[:, 3:] /= length[:, None]
    known = ~np.isnan(poses[:, 3])
    poses[known, 3:] = core.se3.rotation(poses[known]).as_quat(canonical=True)
    return replace(found, poses=poses, notes=(*found.notes, *notes))


def _rows_of(found: Trajectory, kept: BoolArray) -> Trajectory:
    """Some of the samples."""
    names = (
        "time_s", "poses", "residual_mm", "iterations", "status", "cause", "cable", "worst_pressure_angle_deg", "random", "systematic"
    )  # fmt: skip
    return replace(found, **{name: getattr(found, name)[kept] for name in names})


_READERS = {"tum": _of_lines, "markers": lambda path, stated: _of_marked(path, read_markers(path), stated), "euroc": _of_euroc}
_FIXED = {"tum": "is a TUM file", "markers": "is one of labelled markers", "euroc": "is an EuRoC file"}
