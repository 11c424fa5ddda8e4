"""AX = YB with covariance: a robot's base in an instrument's frame, and a target's pose on its flange, from poses of both.

Y is instrument_from_base, X flange_from_target: instrument_from_target = Y base_from_flange X. It is an identification without free
parameters of the robot (cf. Ha, Probabilistic framework for hand-eye and robot-world calibration AX = YB, IEEE T-RO 39, 2023).
"""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, RobotError, se3
from lmeasure.recording import Poses
from lmeasure.robots.identification.identify import Identified, Settings, identify
from lmeasure.robots.identification.measurements import Measurements, measured
from lmeasure.robots.model import Parameter
from lmeasure.text import message

ASTRAY = 0.1
"""Part of the positions' spread from which the remaining differences show that poses are not those of one robot and one target."""


@dataclass(frozen=True)
class StatedPoses:
    """A robot whose poses a table states: its only joint value is the row's number, and it has no parameters."""

    poses: FloatArray
    name: str = "poses"
    joint_names: tuple[str, ...] = ("row",)
    reach_mm: float = np.inf
    parameters: tuple[Parameter, ...] = ()

    @property
    def sliding(self) -> BoolArray:
        return np.ones(1, np.bool_)

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        return np.zeros(1), np.full(1, len(self.poses) - 1.0)

    def moved(self, change: FloatArray) -> Self:
        return self

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        return self.poses[joints[:, 0].astype(int)]

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        return self.forward(joints), np.zeros((len(joints), 1, 6)), np.zeros((len(joints), 0, 6))

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        return np.flatnonzero(np.abs(self.poses - pose).max(axis=1) < 1e-9)[:, None].astype(np.float64)


def frames(robot: Poses, instrument: Poses, seed: int = 0) -> Identified[StatedPoses]:
    """Return base and target from poses of the same names in both: base_from_flange and instrument_from_target.

    Stated uncertainties of both are used, those of the robot in the instrument's frame; if neither states any, the residuals determine the
    noise. RobotError without a common name, or if the residuals are too large for errors of measurement.
    """
    both = [n for n in instrument.names if n in set(robot.names)]
    if not both:
        firsts = message("robots.first_names", robot=repr(robot.names[0]), measured=repr(instrument.names[0]))
        raise RobotError(message("error.no_pose_has_one", firsts=firsts))
    of_robot = robot.of(np.array([robot.names.index(n) for n in both], dtype=np.int64))
    seen = instrument.of(np.array([instrument.names.index(n) for n in both], dtype=np.int64))
    rows = measured(
        np.arange(len(both), dtype=np.float64)[:, None], seen.rows[:, :3], seen.rows[:, 3:] if seen.oriented else None, names=both
    )
    model = StatedPoses(of_robot.rows)
    stated = ("position" not in seen.absent, "rotation" not in seen.absent and seen.oriented)
    rows = replace(rows, covariance=seen.covariances, stated=stated)
    # stated for whole poses and positive: then this is their scatter, and the robot's poses are exact
    determined = bool(all(stated) and (np.einsum("nii->ni", rows.covariance) > 0.0).all())
    found = identify(model, rows, Settings(seed=seed, own_noise=not determined))
    _check_one(found)
    if not of_robot.covariances.any():
        return found
    return identify(model, _with_robot(rows, of_robot, found), Settings(seed=seed, own_noise=not determined))


def _check_one(found: Identified[StatedPoses]) -> None:
    kept = found.kept & found.rows.placed
    places = found.rows.position[kept]
    off, spread = (float(np.sqrt((part**2).sum() / len(part))) for part in (found.errors_mm()[kept], places - places.mean(axis=0)))
    if off > ASTRAY * spread:
        raise RobotError(message("error.robot_and_instrument_still", off=off, spread=spread))


def _with_robot(rows: Measurements, robot: Poses, found: Identified[StatedPoses]) -> Measurements:
    """Rows with the robot's own uncertainty added, in the instrument's axes and at the target as the frames found have it."""
    state = found.state
    turn = se3.matrices(state.base)
    both = np.zeros((6, 6))
    both[:3, :3] = both[3:, 3:] = turn
    arm = se3.apply(robot.rows, state.targets[0, :3]) - robot.rows[:, :3]
    moves = both @ se3.at_points(arm)
    return replace(rows, covariance=rows.covariance + moves @ robot.covariances @ np.swapaxes(moves, 1, 2))
