"""Measurements of a robot from a file, and joint values from a table of their own: a log of the controller, or one row for each pose.

A rest belongs to the row of joint values with its time. Without times rests and rows have the same order, some perhaps without a
counterpart. The angle between two orientations of the target, and roughly its motion, are the same in every frame, and so assign rests to
rows like an alignment of two sequences (Needleman and Wunsch, J. Mol. Biol. 48, 1970).

Positions may come from a run of cables, from the rests of any instrument's trajectory, or as points by name.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from lmeasure.core import FileFormatError, FloatArray, IntArray, RobotError, conventions, symmetric_root
from lmeasure.io import Column, ForeignTable
from lmeasure.recording import read_run
from lmeasure.robots.identification.measurements import POSITION, Measurements, Noted, measured, noted, sides
from lmeasure.robots.model import RobotModel, joint_value
from lmeasure.text import Message, message
from lmeasure.trajectory import (
    LAG_S,
    ErrorModel,
    ErrorsOfRun,
    JointLog,
    PoseErrors,
    Stated,
    Trajectory,
    align,
    kind_of,
    mean_pose,
    read_trajectory,
    reconstruct,
    rests,
    settled,
)

OF_THE_PLACE = ("x", "y", "z", "length")
"""Names of columns of the measured place, and joints are not determined by."""


def read_measurements(
    path: Path, robot: RobotModel, columns: Mapping[str, Column] | None = None, *, joints_alone: bool = False, points_alone: bool = False
) -> Measurements:
    """Read `name, joint_1_deg, ..., x_mm, y_mm, z_mm`, optional qx..qw, u_position_mm, u_rotation_deg, target, length_mm with station.

    joints_alone: a file of poses to be predicted, without positions; points_alone: one of measured points by name, whose joint values are
    in another file and NaN here. FileFormatError names file, line and column.
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
    """joints (m, n) [rad, mm] by name, in the order of a file; time_s (m,) of the instrument's clock, None if the file has no times."""

    path: Path
    names: tuple[str, ...]
    joints: FloatArray
    time_s: FloatArray | None
    lines: tuple[int, ...]
    named: bool = True
    """Whether the file has names, or else the rows' numbers are used."""

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


def read_joint_log(path: Path, robot: RobotModel) -> JointLog:
    """Read `time_s, joint_1_deg, ...` as the motion of the flange; RobotError without times, and the errors of `read_commanded`."""
    rows = read_commanded(path, robot)
    if rows.time_s is None:
        raise RobotError(message("error.log_without_times", where=path))
    return JointLog(rows.time_s, robot.forward(rows.joints), path.name)


def with_joints(points: Measurements, commanded: Commanded) -> tuple[Measurements, list[Noted]]:
    """Return measured points with names and no joint values, joined with those of the commanded rows of these names, in their order.

    FileFormatError if a name occurs twice, or none is in both.
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


STILL_MM = 0.2
"""Largest motion of the target within `LAG_S` while the robot rests."""
LEAST_RESTS = 3
SKIPPED = 5
"""Rests, or rows, in a row that may be without their like."""
TURN_RAD, PLACE_MM, TOOL_MM = np.radians(1.5), 15.0, 400.0
"""Differences of an angle and a distance between two rests from those of the nominal flange, and the largest distance of the target from
the flange."""
LIKELY = 0.5
"""Least part of the rests or rows, whichever are fewer, that must find a counterpart."""
STILL_JOINT = 1e-3
"""Largest change [rad or mm] of joint values in a rest; more means different clocks."""
FUNCTIONS = 16
"""Number of smooth functions in a field without a description."""
FAR_REACHING = 3.0
"""Over how many times the spread of the poses its longer half is correlated."""
SMALL = 1e-9
"""Part of the largest below which common errors of rows are negligible."""


@dataclass(frozen=True)
class Rests:
    """Rests (k): windows_s (k, 2) after settling, whole_s (k, 2) of the whole rest, poses (k, 7) instrument_from_target, NaN for
    orientations that were not measured, covariance (k, 6, 6) of each by itself and systematic (k, 6, K) by the common variables; stated: as
    in `Measurements`."""

    windows_s: FloatArray
    whole_s: FloatArray
    poses: FloatArray
    covariance: FloatArray
    systematic: FloatArray
    stated: tuple[bool, bool]

    def __len__(self) -> int:
        return len(self.poses)


def rests_of(trajectory: Trajectory, model: ErrorModel | None = None) -> Rests:
    """Return the rests of a trajectory, their poses the means after settling.

    model: of the trajectory's errors, such as a run's; by default the file's statements, whose systematic part is modelled as fields over
    the measured poses (`fields_over`). A rest's own error is that of one sample: counts at rest repeat their rounding. RobotError with too
    few.
    """
    positions = trajectory.poses[:, :3]
    found = rests(trajectory, positions, STILL_MM)
    if len(found) < LEAST_RESTS:
        raise RobotError(
            message("error.the_trajectory_has_rests", n_found=len(found), still_mm=STILL_MM, lag_s=LAG_S, least_rests=LEAST_RESTS)
        )
    windows = np.array([settled(trajectory.time_s, positions, rest) for rest in found])
    parts = [slice(*np.searchsorted(trajectory.time_s, (start - 1e-9, end + 1e-9))) for start, end in windows]
    poses = np.array([mean_pose(trajectory.poses[part]) for part in parts])
    middles = np.array([(part.start + part.stop - 1) // 2 for part in parts], dtype=np.int64)
    errors = _of_file(trajectory, middles, poses) if model is None else model.at(trajectory, middles)[0]
    whole = np.array([(trajectory.time_s[rest.start], trajectory.time_s[rest.stop - 1]) for rest in found])
    stated = ("position" not in trajectory.absent, "rotation" not in trajectory.absent and not np.isnan(poses[:, 3]).all())
    return Rests(windows, whole, poses, errors.random, independent(errors.factors), stated)


def matched(found: Rests, commanded: Commanded, robot: RobotModel) -> tuple[Measurements, list[Noted]]:
    """Return the rests with joint values, as measurements in their order, and remarks on the others.

    RobotError if hardly any rest belongs to a row.
    """
    notes: list[Noted] = []
    if commanded.time_s is not None:
        pairs, joints, notes = _by_time(found, commanded, commanded.time_s, robot)
    else:
        pairs = _in_order(found, commanded, robot)
        joints = commanded.joints[pairs[:, 1]]
    if len(pairs) < max(LEAST_RESTS, LIKELY * min(len(found), len(commanded))) and len(pairs) < len(found):
        hint = message("robots.add_time" if commanded.time_s is None else "robots.other_clock")
        raise RobotError(
            message(
                "error.only_of_rests_of",
                where=commanded.path,
                n_pairs=len(pairs),
                n_found=len(found),
                n_commanded=len(commanded),
                hint=hint,
            )
        )
    notes += [
        noted("unmatched", "rest_without_joints", f"{a:.6g} s", begin_s=float(a), end_s=float(b))
        for i, (a, b) in enumerate(found.whole_s)
        if i not in pairs[:, 0]
    ]
    if commanded.time_s is None:
        lost = [k for k in range(len(commanded)) if k not in pairs[:, 1]]
        notes += [noted("unmatched", "joints_without_rest", commanded.names[k], row=commanded.subject(k)) for k in lost]
    of = pairs[:, 0]
    poses = found.poses[of]
    names = [commanded.names[k] if commanded.named else f"rest {i + 1}" for i, k in pairs]
    rows = measured(joints, poses[:, :3], poses[:, 3:], names=names)
    rows = replace(rows, covariance=found.covariance[of], systematic=found.systematic[of], stated=found.stated)
    return (rows.of_lines([commanded.lines[k] for k in pairs[:, 1]]) if commanded.lines else rows), notes


def _by_time(found: Rests, commanded: Commanded, time_s: FloatArray, robot: RobotModel) -> tuple[IntArray, FloatArray, list[Noted]]:
    """(k, 2) rests and rows, and (k, n) joint values: the mean where the robot had settled, else the last row since the rest before."""
    pairs, joints, notes, before = [], [], [], -np.inf
    for i, ((start, end), (_, leaves)) in enumerate(zip(found.windows_s, found.whole_s, strict=True)):
        inside = np.flatnonzero((time_s >= start) & (time_s <= end))
        since = np.flatnonzero((time_s > before) & (time_s <= leaves))
        before = leaves
        if not len(since):
            continue
        own = inside if len(inside) else since[-1:]
        values = commanded.joints[own]
        moves = np.ptp(values, axis=0)
        if (moves > STILL_JOINT).any():
            j = int(np.argmax(moves))
            by, unit = joint_value(robot, j, moves[j])
            at, name = float(start), robot.joint_names[j]
            notes.append(noted("joints-move", f"joints_move.{unit}", f"{at:.6g} s", by, joint=name, by=by, at_s=at))
        pairs.append((i, int(own[len(own) // 2])))
        joints.append(values.mean(axis=0))
    return np.array(pairs, dtype=np.int64).reshape(-1, 2), np.array(joints).reshape(-1, commanded.joints.shape[1]), notes


def _in_order(found: Rests, commanded: Commanded, robot: RobotModel) -> IntArray:
    """(k, 2) rests and rows that follow each other in the same order."""
    same = np.column_stack([np.arange(len(found))] * 2) if len(found) == len(commanded) else None
    if np.isnan(found.poses[:, 3:]).any():
        if same is None:
            raise RobotError(message("error.has_rows_the_trajectory", where=commanded.path, n_commanded=len(commanded), n_found=len(found)))
        return same
    pairs = aligned(found.poses, robot.forward(commanded.joints))
    # no angle fits a wrong robot; its mistakes are searched with rests and rows in order
    return same if same is not None and len(pairs) < LIKELY * len(same) else pairs


def aligned(rests_at: FloatArray, flange: FloatArray) -> IntArray:
    """(k, 2) numbers of poses (n, 7) instrument_from_target and (m, 7) base_from_flange that are the same, in order, as many as fit."""
    n, m = len(rests_at), len(flange)
    turn_r, way_r = _between(rests_at)
    turn_f, way_f = _between(flange)
    widest = abs(n - m) + 2 * SKIPPED
    best, before = np.full((n, m), -np.inf), np.full((n, m, 2), -1)
    for i in range(n):
        for k in range(max(0, i - widest), min(m, i + widest + 1)):
            best[i, k] = 0.0
            a, b = slice(max(0, i - 1 - SKIPPED), i), slice(max(0, k - 1 - SKIPPED), k)
            if a.start == i or b.start == k:
                continue
            turn = turn_f[b, k][None, :]
            off = np.abs(turn_r[a, i][:, None] - turn) / TURN_RAD
            loose = PLACE_MM + 2.0 * TOOL_MM * np.sin(0.5 * turn)
            far = np.abs(way_r[a, i][:, None] - way_f[b, k][None, :]) / loose
            gain = np.where((off < 1.0) & (far < 1.0), best[a, b] + 2.0 - off**2 - far**2, -np.inf)
            at = np.unravel_index(int(np.argmax(gain)), gain.shape)
            if gain[at] > 0.0:
                best[i, k], before[i, k] = gain[at], (a.start + at[0], b.start + at[1])
    end = np.unravel_index(int(np.argmax(best)), best.shape)
    out = [(int(end[0]), int(end[1]))]
    while before[out[-1]][0] >= 0:
        i, k = before[out[-1]]
        out.append((int(i), int(k)))
    return np.array(out[::-1], dtype=np.int64)


def _between(poses: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n, n) angles [rad] and distances [mm] between poses (n, 7)."""
    alike = np.clip(np.abs(poses[:, 3:] @ poses[:, 3:].T), 0.0, 1.0)
    return 2.0 * np.arccos(alike), np.linalg.norm(poses[:, None, :3] - poses[None, :, :3], axis=2)


def _of_file(trajectory: Trajectory, samples: IntArray, poses: FloatArray) -> PoseErrors:
    """Return errors by a trajectory file alone, without the structure of its systematic ones: each component is modelled as a field over
    the measured poses (`fields_over`)."""
    own = symmetric_root(trajectory.systematic[samples])
    basis = fields_over(poses)
    return PoseErrors.of(symmetric_root(trajectory.random[samples]), np.einsum("nij,nb->nijb", own, basis).reshape(len(own), 6, -1))


def fields_over(poses: FloatArray) -> FloatArray:
    """Return (n, b) functions of poses (n, 7), whose sums with normal factors model systematic errors without a description.

    Equal errors would be absorbed by the robot's base, and independent ones would vanish in the mean. An instrument's errors are neither,
    and it is unknown which of its fields a robot's parameters follow most. So two kinds have the whole stated variance each: affine fields,
    a constant and a slope along each axis; and smooth ones, half of them correlated over the spread of the positions, half over three times
    that of positions and turns. With half the variance for each, fields of one kind alone would be understated
    (`benchmarks/uneven_fields.py`).
    """
    off = poses[:, :3] - poses[:, :3].mean(axis=0)
    spread = max(float(np.sqrt((off**2).sum(axis=1).mean())), 1e-9)
    turns, ways = _between(poses)
    far = (ways / spread) ** 2
    typical = float(np.mean(np.nan_to_num(turns) ** 2)) / 2.0
    turned = far + (turns**2 / typical if typical > 1e-12 and not np.isnan(turns).any() else 0.0)
    values, vectors = np.linalg.eigh(np.exp(-far / 2.0) + np.exp(-turned / (2.0 * FAR_REACHING**2)))
    smooth = (vectors * np.sqrt(np.maximum(values, 0.0)))[:, : -FUNCTIONS - 1 : -1]
    parts = (np.column_stack([np.ones(len(off)), np.sqrt(3.0) * off / spread]), smooth)
    return np.hstack([part / np.linalg.norm(part, axis=1)[:, None] for part in parts])


def independent(factors: FloatArray) -> FloatArray:
    """(n, 6, K) factors (n, 6, L) in as few variables as they have, rotations weighed by their own size."""
    if not factors.any():
        return factors[:, :, :0]
    sizes = np.sqrt((factors**2).mean(axis=(0, 2)))
    sizes = np.repeat([max(float(np.linalg.norm(sizes[own])), 1e-300) for own in (slice(0, 3), POSITION)], 3)
    n, _, count = factors.shape
    u, s, _ = np.linalg.svd((factors / sizes[None, :, None]).reshape(6 * n, count), full_matrices=False)
    kept = s > SMALL * s[0]
    return np.asarray((u[:, kept] * s[kept]).reshape(n, 6, -1) * sizes[None, :, None])


@dataclass(frozen=True)
class MeasurementFile:
    """Measurements and remarks on their origin."""

    rows: Measurements
    notes: tuple[Noted, ...] = ()


def read_robot_measurements(path: Path, joints: Path | None, robot: RobotModel, stated: Stated) -> MeasurementFile:
    """Read measurements, with columns and uncertainties in `stated`; joints: file of the joint values, None: beside the positions.

    A run's rests have the errors of its counts by themselves and those of its calibration, start and zeroing in common. RobotError or
    FileFormatError names unreadable or contradicting parts.
    """
    columns = dict(stated.columns or {})
    tabular = not path.is_dir() and kind_of(path) in ("table", "parquet")
    if joints is None:
        if path.is_dir() and not (path / "run.toml").is_file():
            raise RobotError(message("error.is_a_folder_and", where=path))
        if not tabular:
            kind = "run folder" if path.is_dir() else "trajectory"
            raise RobotError(message("error.is_a_joints_file", where=path, kind=kind))
        return MeasurementFile(_with(read_measurements(path, robot, columns), stated))
    commanded = read_commanded(joints, robot, columns)
    if tabular and ForeignTable(path, columns, part=True).find("time", "s") is None:
        rows, notes = with_joints(read_measurements(path, robot, columns, points_alone=True), commanded)
        return MeasurementFile(_with(rows, stated), tuple(notes))
    trajectory, model, said = _trajectory(path, columns)
    found = rests_of(trajectory, model)
    rows, notes = matched(found, commanded, robot)
    determined = noted("rests", "rested", rests=len(found), used=len(rows))
    return MeasurementFile(_with(rows, stated), (determined, *said, *notes))


def _trajectory(path: Path, columns: Mapping[str, Column]) -> tuple[Trajectory, ErrorModel | None, list[Noted]]:
    """Return a trajectory, its errors if a run has them, and its remarks."""
    if path.is_dir():
        aligned = align(read_run(path))
        trajectory = reconstruct(aligned, covariances=False)
        notes = [Noted("run", note) for note in trajectory.notes]
        return trajectory, ErrorsOfRun(aligned), notes + [Noted("assumed", line) for line in trajectory.assumed.lines]
    trajectory = read_trajectory(path, Stated(columns or None, of_others=True))
    notes = [Noted("markers" if kind_of(path) == "markers" else "trajectory", note) for note in trajectory.notes]
    if trajectory.systematic.any():
        notes.append(noted("systematic", "even", file=path.name))
    return trajectory, None, notes


def _with(rows: Measurements, stated: Stated) -> Measurements:
    return rows.with_uncertainty(stated.u_position_mm, stated.u_rotation_rad)
