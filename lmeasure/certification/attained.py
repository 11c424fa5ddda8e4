"""From a trajectory to attained poses: the mean over each dwell, and what says that a dwell is none."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lmeasure.errors import CertificationError
from lmeasure.kernels import screw
from lmeasure.program import Program
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

UNIT_TOLERANCE = 1e-6
TIME_TOLERANCE_S = 1e-9  # times such as 0.1 + 0.2 that are meant to be a window's end


@dataclass(frozen=True)
class AttainedPose:
    """The cycles of a commanded pose (7,): attained poses (n, 7), mm and unit quaternions, middles of their windows time_s (n,) and
    samples (n,). angle_deg: worst pressure angle in the windows; readings (n,): how often the reading changed within the window, plus one;
    excluded: why no verdict is given.
    """

    name: str
    commanded: FloatArray
    poses: FloatArray
    time_s: FloatArray
    samples: IntArray
    readings: IntArray
    angle_deg: float
    excluded: str | None = None


def window(trajectory: Trajectory, start_s: float, end_s: float, what: str) -> slice:
    """The samples of a window, both ends included; CertificationError names the window when it has none or one that is not ok."""
    first = int(np.searchsorted(trajectory.time_s, start_s - TIME_TOLERANCE_S, side="left"))
    last = int(np.searchsorted(trajectory.time_s, end_s + TIME_TOLERANCE_S, side="right"))
    if last <= first:
        raise CertificationError(f"{what}: the trajectory has no sample within [{start_s:g}, {end_s:g}] s")
    bad = np.flatnonzero((trajectory.status[first:last] != screw.OK) | np.isnan(trajectory.poses[first:last, 0]))
    if len(bad):
        i = first + int(bad[0])
        why = trajectory.cause[i] or screw.STATUS[trajectory.status[i]]
        raise CertificationError(f"{what}: sample {i} at {trajectory.time_s[i]:.6g} s is not ok: {why}")
    length = np.linalg.norm(trajectory.poses[first:last, 3:], axis=1)
    bad = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)
    if len(bad):
        i = first + int(bad[0])
        raise CertificationError(
            f"{what}: sample {i} at {trajectory.time_s[i]:.6g} s: the quaternion's length is {length[bad[0]]:.9g}, not 1"
        )
    return slice(first, last)


def mean_pose(poses: FloatArray) -> FloatArray:
    """(7,) mean of poses (n, 7) that lie close together: of positions, and of quaternions brought to one side."""
    quaternions = poses[:, 3:] * np.where(poses[:, 3:] @ poses[0, 3:] < 0, -1.0, 1.0)[:, None]
    mean = quaternions.mean(axis=0)
    return np.concatenate([poses[:, :3].mean(axis=0), mean / np.linalg.norm(mean)])


def attained_poses(trajectory: Trajectory, program: Program, still_mm: float) -> tuple[AttainedPose, ...]:
    """Attained poses of the program's poses that have windows."""
    out = []
    for pose in program.pose:
        if not pose.windows_s:
            continue
        rows, times, middles, readings, worst = [], [], [], [], 0.0
        for cycle, (start, end) in enumerate(pose.windows_s, 1):
            what = f"pose {pose.name}, cycle {cycle}"
            part = window(trajectory, start, end, what)
            poses = trajectory.poses[part]
            away = np.linalg.norm(poses[:, :3] - np.median(poses[:, :3], axis=0), axis=1)
            if away.max() > still_mm:
                i = part.start + int(np.argmax(away))
                raise CertificationError(
                    f"{what}: the robot moves in the window [{start:g}, {end:g}] s: sample {i} at {trajectory.time_s[i]:.6g} s is "
                    f"{away.max():.4g} mm from the rest; at most {still_mm:g} mm"
                )
            rows.append(mean_pose(poses))
            middles.append((part.start + part.stop - 1) // 2)
            times.append(0.5 * (start + end))
            readings.append(1 + int((np.abs(np.diff(poses, axis=0)) > 1e-9).any(axis=1).sum()))
            worst = max(worst, float(np.nanmax(trajectory.worst_pressure_angle_deg[part])))
        commanded = np.array([*pose.position_mm, *pose.quaternion_xyzw])
        out.append(AttainedPose(pose.name, commanded, np.array(rows), np.array(times), np.array(middles), np.array(readings), worst))
    return tuple(out)
