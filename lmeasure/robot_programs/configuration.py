"""Configurations of a robot as programs state them: which of the ways to a pose is meant."""

from collections.abc import Mapping

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.robot_programs.program import Dialect
from lmeasure.robots import RobotModel, SerialRobot


def fits(dialect: Dialect, flags: Mapping[str, int], robot: RobotModel, joints: FloatArray, *, slack_deg: float = 1e-6) -> bool:
    """Return whether joint values (n,) have the configuration that a target states, as far as this robot shows it.

    Signs and quarters that change within slack_deg of a joint are not compared. Only elbow arms with a spherical wrist show where the arm
    is.
    """
    if not flags or dialect.configured is None or not isinstance(robot, SerialRobot) or robot.sliding.any() or len(joints) != 6:
        return True
    arm = _arm(robot, joints) if robot.arm.is_elbow else None
    return dialect.configured(flags, np.degrees(joints), arm, slack_deg)


def _arm(robot: SerialRobot, joints: FloatArray) -> tuple[bool, bool]:
    """(behind, up): whether the wrist's centre is behind the first axis, as its joint is turned, and whether the elbow is bent upwards."""
    points, along = robot.arm.axes(joints[None])
    shoulder, elbow, wrist = (points[0, i] for i in (1, 2, 4))
    up, side = along[0, 0], along[0, 1]
    # the second axis points to the left or to the right of an arm that faces forward at zero
    _, zero_along = robot.arm.axes(np.zeros((1, 6)))
    forward = np.cross(side, up)
    ahead = np.cross(zero_along[0, 1], zero_along[0, 0]) @ se3.matrices(robot.arm.foot)[:, 0]
    forward = forward if ahead > 0.0 else -forward
    way = wrist - points[0, 0]
    bent = np.cross(elbow - shoulder, wrist - shoulder) @ np.cross(forward, up)
    return bool(way @ forward < 0.0), bool(bent < 0.0)
