"""How the tool moves: velocity, acceleration and jerk from a trajectory, by local cubics of a stated bandwidth."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure import files
from lmeasure.conventions import QUATERNION_COLUMNS
from lmeasure.errors import TrajectoryError
from lmeasure.kernels import motion as kernels
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.trajectory.record import Trajectory

FloatArray = NDArray[np.float64]

HALF_WIDTH_S = 0.02
_AXES = ("x", "y", "z")


@dataclass(frozen=True)
class Motion:
    """Smoothed poses and their derivatives, NaN where there is no pose or too few neighbours.

    time_s (n,); poses (n, 7) base_from_tool; velocity, acceleration, jerk (n, 6) of (rotation [rad]; tool origin [mm]) per s, s^2, s^3, in
    base axes; u_pose, u_velocity, u_acceleration, u_jerk (n, 6) standard uncertainties in the same order, from the independent errors
    of the samples: an error that all samples share moves the poses and hardly their derivatives. path_mm (n,): way of the tool origin
    since the beginning, over gaps as the crow flies. half_width_s: of the window; motion much faster than it is smoothed away.
    """

    time_s: FloatArray
    poses: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    jerk: FloatArray
    u_pose: FloatArray
    u_velocity: FloatArray
    u_acceleration: FloatArray
    u_jerk: FloatArray
    path_mm: FloatArray
    half_width_s: float

    @property
    def speed_mm_s(self) -> FloatArray:
        """(n,) speed of the tool origin."""
        return np.asarray(np.linalg.norm(self.velocity[:, 3:], axis=1))

    def columns(self) -> dict[str, Any]:
        """Columns of a motion file."""
        out: dict[str, Any] = {"time_s": self.time_s}
        out |= dict(zip(POSITION_COLUMNS, self.poses[:, :3].T, strict=True))
        out |= dict(zip(QUATERNION_COLUMNS, self.poses[:, 3:].T, strict=True))
        out |= {"speed_mm_s": self.speed_mm_s, "path_mm": self.path_mm}
        for letters, power, values, u in (
            (("v", "w"), "", self.velocity, self.u_velocity),
            (("a", "alpha"), "2", self.acceleration, self.u_acceleration),
            (("j", "beta"), "3", self.jerk, self.u_jerk),
        ):
            for prefix, table in (("", values), ("u_", u)):
                out |= {f"{prefix}{letters[0]}{axis}_mm_s{power}": table[:, 3 + i] for i, axis in enumerate(_AXES)}
                out |= {f"{prefix}{letters[1]}{axis}_rad_s{power}": table[:, i] for i, axis in enumerate(_AXES)}
        return out


def motion_of(trajectory: Trajectory, half_width_s: float = HALF_WIDTH_S) -> Motion:
    """Motion of a trajectory by cubics over +- half_width_s; TrajectoryError when the orientation is not measured or no window is full."""
    if not half_width_s > 0:
        raise TrajectoryError(f"half width of the window: {half_width_s:g} s is not positive")
    if np.isnan(trajectory.poses[:, 3:]).all() and not np.isnan(trajectory.poses[:, :3]).all():
        raise TrajectoryError("motion: the trajectory has no orientation")
    poses, derivatives, factors = kernels.local_cubics(trajectory.time_s, np.ascontiguousarray(trajectory.poses), half_width_s)
    if np.isnan(poses[:, 0]).all():
        raise TrajectoryError(f"motion: no window of +-{half_width_s:g} s holds {kernels.LEAST} poses")
    u = np.sqrt(np.einsum("nii->ni", trajectory.random))
    steps = np.diff(poses[~np.isnan(poses[:, 0]), :3], axis=0)
    path = np.full(len(poses), np.nan)
    path[~np.isnan(poses[:, 0])] = np.concatenate([[0.0], np.cumsum(np.linalg.norm(steps, axis=1))])
    u_pose, u_velocity, u_acceleration, u_jerk = (factors[:, a, None] * u for a in range(kernels.TERMS))
    velocity, acceleration, jerk = (derivatives[:, a] for a in range(3))
    return Motion(trajectory.time_s, poses, velocity, acceleration, jerk, u_pose, u_velocity, u_acceleration, u_jerk, path, half_width_s)


def write_motion(path: Path, motion: Motion) -> None:
    """Write .parquet or .csv, whole or not at all."""
    files.write_table(path, motion.columns(), {"half_width_s": repr(motion.half_width_s)})
