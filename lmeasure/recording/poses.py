"""Poses: positions and orientations of the tool in the base frame, with their standard uncertainties where stated."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa

from lmeasure.core import QUATERNION_COLUMNS, DataFrame, FileFormatError, FloatArray, IntArray, Shown, convention, conventions, framed, se3
from lmeasure.io import Column, ForeignTable, files, text_of
from lmeasure.text import composed, message

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

PLACES = ("x", "y", "z")
STATED = (
    ("u_position", "mm"),
    ("u_rotation", "deg"),
    ("u_repeatability", "mm"),
    ("u_repeatability", "deg"),
    *((f"u_{axis}", "mm") for axis in PLACES),
    *((f"u_r{axis}", "deg") for axis in PLACES),
)
"""Columns that may be stated beside a pose, by name and unit."""


def read_pose_table(
    path: Path,
    angles: str,
    columns: Mapping[str, Column] | None = None,
    *,
    positions_alone: bool = True,
    unnamed: bool = False,
    part: bool = False,
) -> files.Table:
    """Return a table with our own columns: pose, x_mm, y_mm, z_mm, and quaternions or the angles of the convention if it has orientations.

    columns: assignment of columns, as in `foreign.columns_of`; pose may be called name too, or be a first column without a name. unnamed:
    poses without names get their number, from 1. part: columns may name those of other tables too. FileFormatError names missing parts,
    orientations too without positions_alone.
    """
    path = Path(path)
    if not columns and (not path.is_file() or path.suffix.lower() == ".parquet" or _is_ours(path)):
        return files.read_table(path)
    given = ForeignTable(path, columns, part=part)
    names = given.row_names("pose", "name")
    if names is None and not unnamed:
        hint = "" if columns is None else message("error.columns_name_each")
        raise FileFormatError(message("error.column_pose_is_missing", where=path, has=given.has, hint=hint))
    names = names or [str(i + 1) for i in range(len(given))]
    out: dict[str, pa.Array] = {"pose": pa.array(names, pa.string())}
    out |= {f"{axis}_mm": pa.array(given.numbers(axis, "mm")) for axis in PLACES}
    turns = given.orientation(convention(angles))
    if turns is None and not positions_alone:
        raise _without_orientations(path, angles, given.columns)
    if turns is not None:
        out |= {name: pa.array(values) for name, values in zip(QUATERNION_COLUMNS, turns.T, strict=True)}
    for name, unit in STATED:
        if given.find(name, unit):
            out[f"{name}_{unit}"] = pa.array(given.numbers(name, unit))
    for name in given.columns:
        if name == "temperature_c" or name.startswith("rho_"):
            out[name] = pa.array(np.asarray(given.numbers(name)))
    given.nothing_else()
    return files.Table(path, pa.table(out), lines=given.lines)


def _is_ours(path: Path) -> bool:
    """Return whether the header is one of this program: names with units, commas between."""
    line = next((line for line in text_of(path).splitlines() if line.strip()), "")
    names = [name.strip().strip('"') for name in line.split(",")]
    return "pose" in names and any(f"{axis}_mm" in names for axis in PLACES) and not any(name.endswith("_rad") for name in names)


POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
AXES = ("rx", "ry", "rz", "x", "y", "z")
AXIS_COLUMNS = ("u_rx_deg", "u_ry_deg", "u_rz_deg", "u_x_mm", "u_y_mm", "u_z_mm")
"""Standard uncertainties of a small rotation about each base axis and of each coordinate, in the order of `AXES`."""
UNIT_TOLERANCE = 1e-6
_ORIENTATION_COLUMNS = {c for convention in conventions.CONVENTIONS.values() for c in convention.columns} | {
    *conventions.QUATERNION_COLUMNS
}


@dataclass(frozen=True, repr=False)
class Poses(Shown):
    """n named poses base_from_tool with their uncertainties.

    Examples
    --------
    >>> poses = lm.poses_from_rows(np.array([[100.0, 0, 0, 0, 0, 0, 1]]), ["P1"])
    >>> poses.names, poses.rows.shape
    (('P1',), (1, 7))
    """

    names: tuple[str, ...]
    """Names of the poses, n."""
    rows: FloatArray
    """(n, 7) poses base_from_tool: x, y, z [mm], qx, qy, qz, qw (unit quaternion)."""
    u_position_mm: FloatArray
    """(n,) standard uncertainty of each coordinate [mm]; 0: exact."""
    u_rotation_rad: FloatArray
    """(n,) standard uncertainty of the rotation about each axis [rad]; 0: exact."""
    covariance: FloatArray | None = None
    """(n, 6, 6) covariance of (rotation [rad]; position [mm]), base frame, R_true = Exp(delta) R. None: from the two fields above."""
    oriented: bool = True
    """False: only positions were measured, and the rotations are identities."""
    absent: tuple[str, ...] = ()
    """Quantities without a stated uncertainty: "position", "rotation". Their zero means unknown."""

    def __len__(self) -> int:
        return len(self.names)

    def about(self) -> dict[str, str]:
        """Return how many, and how well they are known."""
        stated = (("position", self.u_position_mm, "mm"), ("rotation", self.u_rotation_rad, "rad"))
        return {"poses": str(len(self)) if self.oriented else f"{len(self)}, positions only"} | {
            f"u of {name}": "not stated" if name in self.absent else f"{u.max(initial=0.0):.3g} {unit}" for name, u, unit in stated
        }

    def to_frame(self) -> DataFrame:
        """The columns of a pose file, with quaternions."""
        return framed(pose_columns(self))

    @property
    def rotation(self) -> "Rotation":
        """base_from_tool rotations."""
        return se3.rotation(self.rows)

    @property
    def covariances(self) -> FloatArray:
        """(n, 6, 6) of (rotation [rad]; position [mm]), whichever way they are stated."""
        if self.covariance is not None:
            return self.covariance
        sigma = np.column_stack([np.repeat(u[:, None], 3, axis=1) for u in (self.u_rotation_rad, self.u_position_mm)])
        return np.asarray(sigma[:, :, None] * np.eye(6) * sigma[:, None, :])

    def of(self, index: IntArray) -> "Poses":
        """The poses of these indices."""
        covariance = None if self.covariance is None else self.covariance[index]
        stated = self.rows[index], self.u_position_mm[index], self.u_rotation_rad[index], covariance
        return Poses(tuple(self.names[i] for i in index), *stated, self.oriented, self.absent)

    def with_uncertainty(self, u_position_mm: float | None = None, u_rotation_rad: float | None = None) -> "Poses":
        """Return the poses with these standard uncertainties instead of stated or missing ones; None keeps them."""
        n, given = len(self), {"position": u_position_mm, "rotation": u_rotation_rad}
        place = self.u_position_mm if u_position_mm is None else np.full(n, u_position_mm)
        turn = self.u_rotation_rad if u_rotation_rad is None else np.full(n, u_rotation_rad)
        covariance = None if self.covariance is None else self.covariance.copy()
        for u, own in ((u_position_mm, slice(3, 6)), (u_rotation_rad, slice(0, 3))):
            if u is not None and covariance is not None:
                covariance[:, own, :] = covariance[:, :, own] = 0.0
                covariance[:, own, own] = u**2 * np.eye(3)
        absent = tuple(name for name, u in given.items() if name in self.absent and u is None)
        return replace(self, u_position_mm=place, u_rotation_rad=turn, covariance=covariance, absent=absent)

    def or_uncertain(self, u_position_mm: float, u_rotation_rad: float) -> "Poses":
        """Return the poses with these standard uncertainties if they state none."""
        stated = (self.u_position_mm > 0) | (self.u_rotation_rad > 0)
        other = Poses(self.names, self.rows, np.full(len(self), u_position_mm), np.full(len(self), u_rotation_rad))
        place, turn = np.where(stated, self.u_position_mm, u_position_mm), np.where(stated, self.u_rotation_rad, u_rotation_rad)
        covariance = None if self.covariance is None else np.where(stated[:, None, None], self.covariance, other.covariances)
        return replace(self, u_position_mm=place, u_rotation_rad=turn, covariance=covariance)

    def points(self, attachment_mm: Sequence[float] | FloatArray) -> FloatArray:
        """(n, 3) positions [mm, base frame] of a point given in the tool frame."""
        return np.asarray(self.rows[:, :3] + self.rotation.apply(np.asarray(attachment_mm, dtype=np.float64)))


def poses_from_rows(rows: FloatArray, names: Sequence[str] | None = None) -> Poses:
    """Make exact poses from rows of numbers.

    Parameters
    ----------
    rows
        (n, 7) or (7,): position [mm] and unit quaternion x, y, z, w, base_from_tool.
    names
        Names of the poses; by default 1, 2, ...

    Returns
    -------
    Poses
        The poses, without uncertainty.

    Raises
    ------
    FileFormatError
        If a quaternion is not of unit length, or the rows have another shape.

    Examples
    --------
    >>> lm.poses_from_rows(np.array([100.0, 0, 0, 0, 0, 0, 1])).names
    ('1',)
    """
    rows = np.atleast_2d(np.array(rows, dtype=np.float64))
    if rows.ndim != 2 or rows.shape[1] != 7:
        raise FileFormatError(message("error.poses_of_shape_wanted", shape=str(rows.shape)))
    if not np.isfinite(rows).all():
        raise FileFormatError(message("error.pose_holds_a_number", row=int(np.argmax(~np.isfinite(rows).all(axis=1))) + 1))
    far = (np.abs(rows[:, :3]) > conventions.MAX_LENGTH_MM).any(axis=1)
    if far.any():
        raise FileFormatError(message("error.pose_lies_more_than", row=int(np.argmax(far)) + 1, max_length_mm=conventions.MAX_LENGTH_MM))
    with np.errstate(over="ignore"):  # a length of infinity is refused like others
        length = np.linalg.norm(rows[:, 3:], axis=1)
    if (np.abs(length - 1) > UNIT_TOLERANCE).any():
        i = int(np.argmax(np.abs(length - 1)))
        raise FileFormatError(message("error.pose_the_quaternion_s", i=i + 1, length=length[i]))
    rows[:, 3:] /= length[:, None]
    zero = np.zeros(len(rows))
    return Poses(tuple(names) if names is not None else tuple(str(i + 1) for i in range(len(rows))), rows, zero, zero)


def joined(first: Poses, then: Poses) -> Poses:
    """All poses of both, oriented ones, with their stated uncertainties."""
    both = first, then
    u = np.concatenate([p.u_position_mm for p in both]), np.concatenate([p.u_rotation_rad for p in both])
    covariance = None if all(p.covariance is None for p in both) else np.concatenate([p.covariances for p in both])
    return Poses((*first.names, *then.names), np.vstack([p.rows for p in both]), *u, covariance)


def read_poses(
    path: Path,
    angles: str,
    columns: Mapping[str, Column] | None = None,
    *,
    positions_alone: bool = False,
    unnamed: bool = False,
    part: bool = False,
) -> Poses:
    """Read a table of poses.

    Parameters
    ----------
    path
        .csv, .parquet or a text table with pose, x_mm, y_mm, z_mm and angle or quaternion columns, or anybody's table. Uncertainties are
        u_position_mm and u_rotation_deg, or one column per axis with correlations such as rho_x_y.
    angles
        Convention of the angle columns.
    columns
        Names and units of other columns.
    positions_alone
        True accepts a file without orientations.
    unnamed
        True numbers the poses of a table without names.
    part
        True if `columns` also names columns of other tables.

    Returns
    -------
    Poses
        Poses base_from_tool [mm] with their standard uncertainties.

    Raises
    ------
    FileFormatError
        If the file is wrong. The message names row and column.

    Examples
    --------
    >>> len(lm.read_poses(Path("campaign/reference_poses.csv"), "puma-oat"))
    12
    """
    table = read_pose_table(path, angles, columns, positions_alone=positions_alone, unnamed=unnamed, part=part)
    turns = conventions.convention(angles).columns
    known = (*POSITION_COLUMNS, *conventions.QUATERNION_COLUMNS, *turns, "u_position_mm", "u_rotation_deg", *AXIS_COLUMNS)
    with table.every_fault(known):
        return _poses_in(table, angles, positions_alone)


def _poses_in(table: files.Table, angles: str, positions_alone: bool) -> Poses:
    path = table.path
    names = table.text("pose")
    if len(names) == 0:
        raise FileFormatError(message("error.has_no_poses", where=path))
    if "" in names:
        raise FileFormatError(message("error.pose_number_has_no", where=path, index=names.index("") + 1))
    name, times = Counter(names).most_common(1)[0]
    if times > 1:
        raise FileFormatError(message("error.pose_is_given_times", where=path, name=name, times=times))
    position, oriented = table.matrix(POSITION_COLUMNS), True
    columns = conventions.convention(angles).columns
    if all(c in table.columns for c in conventions.QUATERNION_COLUMNS):
        quaternion = table.matrix(conventions.QUATERNION_COLUMNS)
    elif all(c in table.columns for c in columns):
        stated = table.matrix(columns)
        conventions.check_angles(stated, f"{path}: {', '.join(columns)}")
        quaternion = conventions.rotation_from_angles(angles, stated).as_quat()
    elif positions_alone and not any(c in table.columns for c in _ORIENTATION_COLUMNS):
        quaternion, oriented = np.tile([0.0, 0.0, 0.0, 1.0], (len(names), 1)), False
    else:
        raise _without_orientations(path, angles, table.columns)
    try:
        poses = poses_from_rows(np.column_stack([position, quaternion]), names)
    except FileFormatError as error:
        raise FileFormatError(composed("{where}: {error}", where=path, error=error)) from None
    u = {c: table.numbers(c) if c in table.columns else np.zeros(len(names)) for c in ("u_position_mm", "u_rotation_deg")}
    for column, values in u.items():
        if (values < 0).any():
            raise FileFormatError(message("error.column_a_standard_uncertainty", where=path, name=column))
    covariance = _covariance(table, u["u_position_mm"], np.radians(u["u_rotation_deg"]))
    columns_of = {"position": ("u_position_mm", "u_x_mm"), "rotation": ("u_rotation_deg", "u_rx_deg")}
    absent = tuple(n for n, c in columns_of.items() if not set(c) & set(table.columns) and (oriented or n == "position"))
    if covariance is None:
        return Poses(poses.names, poses.rows, u["u_position_mm"], np.radians(u["u_rotation_deg"]), oriented=oriented, absent=absent)
    variance = np.einsum("nii->ni", covariance)
    rotation, place = np.sqrt(variance[:, :3].mean(axis=1)), np.sqrt(variance[:, 3:].mean(axis=1))
    return Poses(poses.names, poses.rows, place, rotation, covariance, oriented, absent)


def _without_orientations(path: Path, angles: str, has: Sequence[str]) -> FileFormatError:
    """Return the error, with the convention whose names the columns have."""
    needed = {"columns": ", ".join(conventions.convention(angles).columns), "angles": angles, "columns2": ", ".join(filter(None, has))}
    reason = message("error.needs_the_columns_angles", where=path, **needed)
    bare = {name.lower().rsplit("_", 1)[0] for name in has}
    fit = [n for n, each in conventions.CONVENTIONS.items() if {c.rsplit("_", 1)[0] for c in each.columns} <= bare]
    return FileFormatError(
        composed("{reason}. {fit}", reason=reason, fit=message("error.columns_of_convention", fit=", ".join(fit))) if fit else reason
    )


def _covariance(table: files.Table, u_position_mm: FloatArray, u_rotation_rad: FloatArray) -> FloatArray | None:
    """(n, 6, 6) covariance of a file that states it by axes, None of any other."""
    path, sigma = table.path, np.column_stack([np.repeat(u[:, None], 3, axis=1) for u in (u_rotation_rad, u_position_mm)])
    stated = [c for c in table.columns if c in AXIS_COLUMNS or c.startswith("rho_")]
    if not stated:
        return None
    for group, common in ((AXIS_COLUMNS[:3], "u_rotation_deg"), (AXIS_COLUMNS[3:], "u_position_mm")):
        given = [c for c in group if c in table.columns]
        if given and common in table.columns:
            raise FileFormatError(message("error.has_and_one_of", where=path, given=given[0], common=common))
        if given and len(given) < len(group):
            lacking = next(c for c in group if c not in given)
            raise FileFormatError(message("error.column_is_missing_is", where=path, next=lacking, given=given[0]))
        for c in given:
            values = table.numbers(c)
            if (values < 0).any():
                raise FileFormatError(message("error.column_a_standard_uncertainty", where=path, name=c))
            sigma[:, AXIS_COLUMNS.index(c)] = np.radians(values) if c.endswith("_deg") else values
    correlation = np.tile(np.eye(6), (len(sigma), 1, 1))
    for c in stated:
        if not c.startswith("rho_"):
            continue
        axes = [AXES.index(a) for a in c.split("_")[1:] if a in AXES]
        if len(axes) != 2 or axes[0] == axes[1] or c.count("_") != 2:
            raise FileFormatError(message("error.column_a_correlation_is", where=path, c=c, axes=", ".join(AXES)))
        correlation[:, axes[0], axes[1]] = correlation[:, axes[1], axes[0]] = table.numbers(c)
    least = np.linalg.eigvalsh(correlation)[:, 0]
    if (least < -1e-9).any():
        pose = int(np.argmin(least))
        raise FileFormatError(message("error.no_six_quantities_can", where=path, pose=pose + 2))
    return np.asarray(sigma[:, :, None] * correlation * sigma[:, None, :])


def pose_columns(poses: Poses, angles: str | None = None) -> dict[str, Any]:
    """Columns of a pose file: angles of the convention, or quaternions when None."""
    out: dict[str, Any] = {"pose": list(poses.names)}
    out |= dict(zip(POSITION_COLUMNS, poses.rows[:, :3].T, strict=True))
    if not poses.oriented:
        pass
    elif angles is None:
        out |= dict(zip(conventions.QUATERNION_COLUMNS, poses.rows[:, 3:].T, strict=True))
    else:
        values = conventions.angles_from_rotation(angles, poses.rotation)
        out |= dict(zip(conventions.convention(angles).columns, values.T, strict=True))
    if poses.covariance is not None:
        sigma = np.sqrt(np.einsum("nii->ni", poses.covariance))
        out |= {c: np.degrees(s) if c.endswith("_deg") else s for c, s in zip(AXIS_COLUMNS, sigma.T, strict=True)}
        for i, j in zip(*np.triu_indices(6, 1), strict=True):
            both = sigma[:, i] * sigma[:, j]
            rho = np.where(both > 0, poses.covariance[:, i, j] / np.where(both > 0, both, 1.0), 0.0)
            if rho.any():
                out[f"rho_{AXES[i]}_{AXES[j]}"] = rho
        return out
    # zeros too: a missing column means unknown
    if "position" not in poses.absent:
        out["u_position_mm"] = poses.u_position_mm
    if "rotation" not in poses.absent and poses.oriented:
        out["u_rotation_deg"] = np.degrees(poses.u_rotation_rad)
    return out


def write_poses(path: Path, poses: Poses, angles: str | None = None) -> None:
    """Write a pose file, complete or not at all.

    Parameters
    ----------
    path
        .csv or .parquet to write.
    poses
        Poses.
    angles
        Convention of the angle columns; None writes quaternions.

    Examples
    --------
    >>> lm.write_poses(Path("poses.csv"), lm.poses_from_rows(np.array([0.0, 0, 0, 0, 0, 0, 1])), "kuka-abc")
    """
    files.write_table(path, pose_columns(poses, angles))
