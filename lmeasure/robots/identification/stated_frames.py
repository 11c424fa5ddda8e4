"""A robot seen from frames that others state: where its base is said to stand, and its tool to sit."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, se3
from lmeasure.robots.model import Parameter, RobotModel


@dataclass(frozen=True)
class Placed:
    """`RobotModel` of a robot whose own base is at `stand` (7,) of the base that is stated, and the stated flange at `seat` (7,) of its
    own: forward is stand, the robot's own forward, seat, one after the other."""

    robot: RobotModel
    stand: FloatArray
    seat: FloatArray

    @property
    def name(self) -> str:
        """The robot's."""
        return self.robot.name

    @property
    def joint_names(self) -> tuple[str, ...]:
        """The robot's."""
        return self.robot.joint_names

    @property
    def sliding(self) -> BoolArray:
        """(n,) the robot's."""
        return self.robot.sliding

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """(n,) the robot's."""
        return self.robot.limits

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The robot's."""
        return self.robot.parameters

    @property
    def reach_mm(self) -> float:
        """How far from the stated base the stated flange can be [mm]."""
        return self.robot.reach_mm + float(np.linalg.norm(self.stand[:3]) + np.linalg.norm(self.seat[:3]))

    def moved(self, change: FloatArray) -> Self:
        """With (p,) added to the robot's parameters."""
        return replace(self, robot=self.robot.moved(change))

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        """(N, 7) stated base from stated flange at joint values (N, n)."""
        return self._seen(self.robot.forward(joints, side))

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """As `RobotModel.derivatives`, twists at the stated base's origin in its axes."""
        poses, by_joints, by_parameters = self.robot.derivatives(joints, side, of)
        carried = se3.adjoint(self.stand).T
        return self._seen(poses), by_joints @ carried, by_parameters @ carried

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        """(k, n) joint values that take the stated flange to the pose (7,)."""
        return self.robot.inverse(se3.compose(se3.compose(se3.inverse(self.stand), pose), se3.inverse(self.seat)), seed)

    def _seen(self, poses: FloatArray) -> FloatArray:
        known = ~np.isnan(poses).any(axis=1)
        out = np.full_like(poses, np.nan)
        out[known] = se3.compose(se3.compose(np.broadcast_to(self.stand, poses[known].shape), poses[known]), self.seat)
        return out
