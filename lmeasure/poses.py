"""Poses: positions and orientations of the tool in the base frame, with their standard uncertainties where stated."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import conventions, files
from lmeasure.errors import FileFormatError

FloatArray = NDArray[np.float64]

POSITION_COLUMNS = ("x_mm", "y_mm", "z_mm")
UNIT_TOLERANCE = 1e-6


@dataclass(frozen=True)
class Poses:
    """Named poses base_from_tool.

    rows (n, 7): x, y, z [mm], qx, qy, qz, qw (unit); u_position_mm and u_rotation_rad (n,): standard uncertainty of each coordinate and of
    each component of a small rotation, zero where the pose is taken as exact.
    """

    names: tuple[str, ...]
    rows: FloatArray
    u_position_mm: FloatArray
    u_rotation_rad: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    @property
    def rotation(self) -> Rotation:
        """base_from_tool rotations."""
        return Rotation.from_quat(self.rows[:, 3:7])

    def points(self, attachment_mm: Sequence[float] | FloatArray) -> FloatArray:
        """(n, 3) positions [mm, base frame] of a point given in the tool frame."""
        return np.asarray(self.rows[:, :3] + self.rotation.apply(np.asarray(attachment_mm, dtype=np.float64)))


def poses_from_rows(rows: FloatArray, names: Sequence[str] | None = None) -> Poses:
    """Exact poses from (n, 7) rows; names default to 1, 2, ...; FileFormatError when a quaternion is not of unit length."""
    rows = np.array(rows, dtype=np.float64).reshape(-1, 7)
    if not np.isfinite(rows).all():
        raise FileFormatError(f"pose {int(np.argmax(~np.isfinite(rows).all(axis=1))) + 1}: holds a number that is not finite")
    far = (np.abs(rows[:, :3]) > conventions.MAX_LENGTH_MM).any(axis=1)
    if far.any():
        raise FileFormatError(f"pose {int(np.argmax(far)) + 1}: lies more than {conventions.MAX_LENGTH_MM:.0f} mm from the origin")
    with np.errstate(over="ignore"):  # a length of infinity is refused like others
        length = np.linalg.norm(rows[:, 3:], axis=1)
    if (np.abs(length - 1) > UNIT_TOLERANCE).any():
        i = int(np.argmax(np.abs(length - 1)))
        raise FileFormatError(f"pose {i + 1}: the quaternion's length is {length[i]:.9g}, not 1")
    rows[:, 3:] /= length[:, None]
    zero = np.zeros(len(rows))
    return Poses(tuple(names) if names is not None else tuple(str(i + 1) for i in range(len(rows))), rows, zero, zero)


def read_poses(path: Path, angles: str) -> Poses:
    """Read `pose, x_mm, y_mm, z_mm` with angle columns of the convention or qx, qy, qz, qw; optional u_position_mm, u_rotation_deg."""
    table = files.read_table(path)
    names = table.text("pose")
    if len(names) == 0:
        raise FileFormatError(f"{path}: has no poses")
    if "" in names:
        raise FileFormatError(f"{path}: pose number {names.index('') + 1} has no name")
    name, times = Counter(names).most_common(1)[0]
    if times > 1:
        raise FileFormatError(f"{path}: pose {name!r} is given {times} times")
    position = table.matrix(POSITION_COLUMNS)
    columns = conventions.convention(angles).columns
    if all(c in table.columns for c in conventions.QUATERNION_COLUMNS):
        quaternion = table.matrix(conventions.QUATERNION_COLUMNS)
    elif all(c in table.columns for c in columns):
        quaternion = conventions.rotation_from_angles(angles, table.matrix(columns)).as_quat()
    else:
        raise FileFormatError(
            f"{path}: needs the columns {', '.join(columns)} (angles = {angles!r}) or qx, qy, qz, qw; it has {', '.join(table.columns)}"
        )
    try:
        poses = poses_from_rows(np.column_stack([position, quaternion]), names)
    except FileFormatError as error:
        raise FileFormatError(f"{path}: {error}") from None
    u = {c: table.numbers(c) if c in table.columns else np.zeros(len(names)) for c in ("u_position_mm", "u_rotation_deg")}
    for column, values in u.items():
        if (values < 0).any():
            raise FileFormatError(f"{path}: column {column!r}: a standard uncertainty is negative")
    return Poses(poses.names, poses.rows, u["u_position_mm"], np.radians(u["u_rotation_deg"]))


def pose_columns(poses: Poses, angles: str | None = None) -> dict[str, Any]:
    """Columns of a pose file: angles of the convention, or quaternions when None."""
    out: dict[str, Any] = {"pose": list(poses.names)}
    out |= dict(zip(POSITION_COLUMNS, poses.rows[:, :3].T, strict=True))
    if angles is None:
        out |= dict(zip(conventions.QUATERNION_COLUMNS, poses.rows[:, 3:].T, strict=True))
    else:
        values = conventions.angles_from_rotation(angles, poses.rotation)
        out |= dict(zip(conventions.convention(angles).columns, values.T, strict=True))
    if poses.u_position_mm.any():
        out["u_position_mm"] = poses.u_position_mm
    if poses.u_rotation_rad.any():
        out["u_rotation_deg"] = np.degrees(poses.u_rotation_rad)
    return out


def write_poses(path: Path, poses: Poses, angles: str | None = None) -> None:
    """Write a pose file, whole or not at all."""
    files.write_table(path, pose_columns(poses, angles))
