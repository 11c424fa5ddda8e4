"""A robot's joint log as a prior of the shape of the motion, not of its position.

The log gives base_from_flange F(t) by the nominal robot. The tool is at Y F(t + late) X, with unknown frames and clock, which a fit to the
poses of the samples determines. The prior takes from it only the fourth differences of the control poses: those of the curve are normal
about them, of a variance that the readings determine (`fit`). Motion that the log does not show is in the differences between
both. If it is smooth it has no fourth differences, so it costs nothing. If it is sharp the variance grows there, as it does without a log.
"""

from dataclasses import dataclass

import numpy as np
import scipy
from scipy.interpolate import CubicSpline
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation, RotationSpline

from lmeasure.core import FloatArray, TrajectoryError, se3
from lmeasure.kernels import spline_differences
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Trajectory

LATE_S, STEPS = 1.0, 80  # Largest difference of the clocks, and steps of it that are tried to either side
FITTED = 100  # Samples for frames and clock
ROUNDS = 20  # Of the fit of the frames, which is linear in the target and in the turn by turns
LEVER_MM = 300.0  # At which a turn counts as a displacement
ASTRAY = 0.1  # Largest error of the log relative to the spread of the positions
LEAST = 8  # Rows of a log


@dataclass(frozen=True)
class JointLog:
    """Motion of a flange by a robot's log: poses base_from_flange (n, 7) at times (n,) [s] of the log's clock; source: its file."""

    time_s: FloatArray
    poses: FloatArray
    source: str = "joint log"

    def __post_init__(self) -> None:
        if len(self.time_s) < LEAST or not (np.diff(self.time_s) > 0.0).all() or not np.isfinite(self.poses).all():
            raise TrajectoryError(message("curve.log_rows", source=self.source, least=LEAST))

    def moving(self, trajectory: Trajectory) -> "Shape":
        """Return the motion of the tool by this log, in the frame and by the clock of a trajectory. TrajectoryError where both have no
        motion in common."""
        place, turn = CubicSpline(self.time_s, self.poses[:, :3]), RotationSpline(self.time_s, se3.rotation(self.poses))
        inside = trajectory.time_s[np.isfinite(trajectory.poses).all(axis=1)]
        inside = inside[(inside >= self.time_s[0] + LATE_S) & (inside <= self.time_s[-1] - LATE_S)] if len(inside) else inside
        some = np.isin(trajectory.time_s, inside[:: max(len(inside) // FITTED, 1)])
        if some.sum() < LEAST:
            raise TrajectoryError(message("curve.log_short", source=self.source, late_s=LATE_S))
        time_s, measured = trajectory.time_s[some], trajectory.poses[some]

        def fitted(late_s: float, rounds: int = ROUNDS) -> tuple[float, Rotation, FloatArray, FloatArray, Rotation]:
            return _frames(place(time_s + late_s), turn(time_s + late_s), measured, rounds)

        tried = np.linspace(-LATE_S, LATE_S, 2 * STEPS + 1)
        nearest = float(tried[int(np.argmin([fitted(late, 3)[0] for late in tried.tolist()]))])
        step = LATE_S / STEPS
        late_s = float(minimize_scalar(lambda t: fitted(t)[0], bounds=(nearest - step, nearest + step), options={"xatol": 1e-6}).x)
        off, Y, x, y, X = fitted(late_s)
        spread = float(np.sqrt(((measured[:, :3] - measured[:, :3].mean(axis=0)) ** 2).sum(axis=1).mean()))
        if not off < ASTRAY * spread:
            raise TrajectoryError(message("curve.log_astray", source=self.source, off_mm=off, spread_mm=spread))
        flange = se3.rotation(self.poses)
        poses = np.hstack([Y.apply(self.poses[:, :3] + flange.apply(x)) + y, (Y * flange * X).as_quat()])
        return Shape(self.time_s - late_s, poses, late_s, off)


def _frames(
    place: FloatArray, turn: Rotation, measured: FloatArray, rounds: int
) -> tuple[float, Rotation, FloatArray, FloatArray, Rotation]:
    """Root mean square misfit [mm], turn of the base, target on the flange, shift of the base and turn of the target, from places (n, 3)
    and turns of the flange and poses (n, 7): p = Y (f + R x) + y. Only Y turns the vectors of turns between poses (Park, Martin, 1994)."""
    own, seen = turn.as_matrix(), se3.rotation(measured)
    about = len(place) // 2
    vectors = LEVER_MM * (seen * seen[about].inv()).as_rotvec(), LEVER_MM * (turn * turn[about].inv()).as_rotvec()
    x, off = np.zeros(3), measured[:, :3] - measured[:, :3].mean(axis=0)
    Y, arms = Rotation.identity(), own - own.mean(axis=0)
    for _ in range(rounds):
        moved = place + own @ x
        Y = Rotation.align_vectors(np.vstack([off, vectors[0]]), np.vstack([moved - moved.mean(axis=0), vectors[1]]))[0]
        left = Y.inv().apply(off) - (place - place.mean(axis=0))
        x = np.linalg.lstsq(arms.reshape(-1, 3), left.ravel(), rcond=1e-6)[0]
    moved = Y.apply(place + own @ x)
    y = measured[:, :3].mean(axis=0) - moved.mean(axis=0)
    X = ((Y * turn).inv() * seen).mean()
    turned = LEVER_MM * (seen * (Y * turn * X).inv()).as_rotvec()
    misfit = np.hstack([measured[:, :3] - moved - y, turned])
    return float(np.sqrt((misfit**2).sum(axis=1).mean())), Y, x, y, X


@dataclass(frozen=True)
class Shape:
    """Poses (n, 7) of the tool by a log at times (n,) [s] of the instrument; late_s: of the log's clock; off_mm: by which it misses."""

    time_s: FloatArray
    poses: FloatArray
    late_s: float
    off_mm: float

    def differences(self, knots_s: FloatArray, signs: FloatArray) -> FloatArray:
        """Return (K - s + 1, 6) differences, by s signs, of the control poses of a spline through the log at K knots; 0 beyond its ends."""
        inside = np.clip(knots_s, self.time_s[0], self.time_s[-1])
        points = CubicSpline(self.time_s, self.poses[:, :3])(inside)
        turns = RotationSpline(self.time_s, se3.rotation(self.poses))(inside).as_quat()
        values = np.asarray(spline_differences(np.ascontiguousarray(points), np.ascontiguousarray(turns), signs))
        reach = len(signs) - 1
        values[(knots_s[:-reach] < self.time_s[0]) | (knots_s[reach:] > self.time_s[-1])] = 0.0
        # values of a quintic spline at its knots, by its coefficients
        band = np.repeat(np.array([[1.0], [26.0], [66.0]]) / 120.0, len(values), axis=1)
        return np.asarray(scipy.linalg.solveh_banded(band, values))
