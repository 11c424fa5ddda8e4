"""The motion of a curve: velocity, acceleration and jerk with all their uncertainties, without a window."""

import numpy as np

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.text import message
from lmeasure.trajectory.curve.curve import Curve
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.motion.motion import Motion
from lmeasure.trajectory.motion.spectrum import HIGHEST
from lmeasure.trajectory.time.stamps import sound

SAME_MM = 1e-6
FINER = 4
"""Points between samples by which the path is measured."""


def motion_of_curve(trajectory: Trajectory, curve: Curve, of_run: Trajectory | None = None) -> Motion:
    """Return the motion of a curve at the samples of its trajectory.

    The uncertainties include what the smoothness of the curve may miss, and what the whole run shares. TrajectoryError names the first
    sample that differs from that of the run's own curve, of_run.
    """
    known = np.isfinite(trajectory.poses[:, 0])
    if of_run is not None:
        here, there = (np.nan_to_num(np.column_stack([each.time_s, each.poses[:, :3]])) for each in (trajectory, of_run))
        if len(here) != len(there):
            raise TrajectoryError(message("curve.other_length", samples=len(here), of_run=len(there)))
        other = np.abs(here - there).max(axis=1) > SAME_MM
        if other.any():
            raise TrajectoryError(message("curve.other_trajectory", sample=int(np.argmax(other))))
    n, time_s = len(trajectory.time_s), trajectory.time_s
    at = curve.at(time_s[known])
    rates, u, u_speed = np.full((4, n, 6), np.nan), np.full((4, n, 6), np.nan), np.full(n, np.nan)
    rates[:, known], u[:, known] = np.swapaxes(at.rates, 0, 1), np.swapaxes(at.u, 0, 1)
    velocity = at.rates[:, 1, 3:]
    speed = np.linalg.norm(velocity, axis=1, keepdims=True)
    unit = np.divide(velocity, speed, out=np.full_like(velocity, np.sqrt(1.0 / 3.0)), where=speed > 0.0)
    both = at.random[:, 1, 3:, 3:] + at.systematic[:, 1, 3:, 3:]
    u_speed[known] = np.sqrt(np.einsum("ni,nij,nj->n", unit, both, unit))
    poses = np.full_like(trajectory.poses, np.nan)
    poses[known] = at.poses
    if np.isnan(trajectory.poses[known, 3:]).all():
        poses[:, 3:] = rates[:, :, :3] = u[:, :, :3] = np.nan
    path = np.full(n, np.nan)
    path[known] = _path(curve, time_s[known])
    period = float(np.median(np.diff(time_s)))
    return Motion(
        time_s=time_s,
        poses=poses,
        velocity=rates[1],
        acceleration=rates[2],
        jerk=rates[3],
        u_pose=u[0],
        u_velocity=u[1],
        u_acceleration=u[2],
        u_jerk=u[3],
        u_speed_mm_s=u_speed,
        path_mm=path,
        half_width_s=curve.spacing_s,
        stamps=sound(time_s),
        highest_hz=HIGHEST / period,
    )


def _path(curve: Curve, time_s: FloatArray) -> FloatArray:
    """Return the way (n,) [mm] of the tool origin since the first of times (n,)."""
    part = np.arange(FINER) / FINER
    fine = np.append((time_s[:-1, None] + part * np.diff(time_s)[:, None]).ravel(), time_s[-1])
    steps = np.linalg.norm(np.diff(curve.poses(fine)[:, :3], axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])[::FINER]
