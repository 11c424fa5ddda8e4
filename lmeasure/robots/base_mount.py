"""A robot of any kind where it stands, as a simulation moves it: tool poses in the frame of the cell in, joint values out, and back."""

from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import FloatArray, IntArray, RobotError, se3
from lmeasure.robots.model import RobotModel
from lmeasure.robots.parallel.model import Parallel
from lmeasure.robots.platform import Platform
from lmeasure.robots.serial_robot import SerialRobot
from lmeasure.text import message

COARSE = 10
"""Samples of a motion between those whose poses are found from home; the others are found from these."""
NONE: IntArray = np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Mounted:
    """base (7,): cell_from_base; tool (7,): flange_from_tool. Lengths do not grow."""

    robot: RobotModel
    base: FloatArray
    tool: FloatArray

    @property
    def axes_count(self) -> int:
        """Return the number of joints."""
        return len(self.robot.joint_names)

    def flange(self, poses: FloatArray) -> FloatArray:
        """(N, 7) base_from_flange at tool poses (N, 7) in the cell."""
        back = se3.compose(se3.inverse(self.base), poses)
        return se3.compose(back, se3.inverse(self.tool))

    def placed(self, flange: FloatArray) -> FloatArray:
        """(N, 7) tool poses in the cell at base_from_flange (N, 7)."""
        return se3.compose(self.base, se3.compose(flange, self.tool))

    def follow(self, poses: FloatArray, start: FloatArray) -> FloatArray:
        """(N, n) joint values along tool poses (N, 7), beginning near start (n,); RobotError names the first sample out of reach."""
        flange, robot = self.flange(poses), self.robot
        if isinstance(robot, Parallel):
            return robot.follow(flange, start)
        if isinstance(robot, Platform):
            joints = (robot.lengths(flange) - robot.offset) / robot.scale
            beyond = (joints < robot.low) | (joints > robot.high)
            apart = ~robot.assembled(flange)
            if apart.any():
                raise RobotError(message("error.sample_takes_a_rod_out", sample=int(np.argmax(apart))), int(np.argmax(apart)))
            if beyond.any():
                sample = int(np.argmax(beyond.any(axis=1)))
                leg = int(np.argmax(beyond[sample]))
                raise RobotError(
                    message("error.sample_would_be_at", sample=sample, joint_names=robot.joint_names[leg], joints=joints[sample, leg]),
                    sample,
                )
            return np.asarray(joints)
        if isinstance(robot, SerialRobot) and robot.arm.is_elbow:
            return replace(robot.arm, tool=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])).follow(flange, start)
        raise RobotError(message("error.robot_paths_are_followed", name=robot.name))

    def forward(self, joints: FloatArray, growth: FloatArray | float = 0.0) -> FloatArray:
        """(N, 7) tool poses in the cell at the joint values (N, n) of a motion; RobotError names the first sample that has none."""
        robot = self.robot
        if isinstance(robot, Parallel):
            far = robot.forward(joints[::COARSE])
            self._say(far, COARSE)
            flange, same = robot.beside(joints, np.repeat(far, COARSE, axis=0)[: len(joints)])
            if not same.all():  # it moves far between: each by its own way from home
                flange[~same] = robot.forward(joints[~same])
        else:
            flange = robot.forward(joints)
        self._say(flange, 1)
        return self.placed(flange)

    def deflection(self, joints: FloatArray, stiffness: FloatArray, force: FloatArray, points: FloatArray) -> FloatArray:
        """(N, n) rad or mm by which forces (N, 3) [N] at points (N, 3) [mm], both in the cell's axes, move joints of the stiffness (n,)."""
        _, by_joints, _ = self.robot.derivatives(joints, None, NONE)
        turn = se3.matrices(self.base)
        own, at = force @ turn, (points - self.base[:3]) @ turn
        moved = by_joints[:, :, 3:] + np.cross(by_joints[:, :, :3], at[:, None])
        return np.asarray(np.einsum("njc,nc->nj", moved, own) / stiffness)

    def _say(self, flange: FloatArray, every: int) -> None:
        lost = np.isnan(flange[:, 0])
        if lost.any():
            raise RobotError(message("error.sample_no_pose_of", every=every * int(np.argmax(lost)), name=self.robot.name))
