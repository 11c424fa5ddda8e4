"""Interface of every robot under test: parameters by name, joint values to poses, and the derivatives of both."""

from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Parameter:
    """A parameter of a robot as files name it, such as `joint_2.a_mm`; value in the unit (`mm`, `deg`, ...) that the name ends with.

    size: what a unit of it is in the robot's own numbers, radians and millimetres; width: how far it may lie from its nominal value, as
    a standard uncertainty in its unit, where nothing else is known.
    """

    name: str
    unit: str
    value: float
    size: float
    width: float


class RobotModel(Protocol):
    """A robot that can be identified. Joint values are rad, or mm where a joint slides; poses (N, 7) are base_from_flange.

    side (N, n): on which side of its play each joint lies, -1, 0 or 1, by the way that it was come from; 0 where it is not given.
    """

    @property
    def name(self) -> str:
        """As its file calls it."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """In the order of joint values."""
        ...

    @property
    def sliding(self) -> BoolArray:
        """(n,) whether a joint's value is a length."""
        ...

    @property
    def limits(self) -> tuple[FloatArray, FloatArray]:
        """(n,) least and largest joint values."""
        ...

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """All of them, freed or not."""
        ...

    @property
    def reach_mm(self) -> float:
        """How far from its base the flange can be [mm]; infinity where that is not known."""
        ...

    def moved(self, change: FloatArray) -> Self:
        """The robot with (p,) added to its parameters, in the robot's own numbers (rad, mm)."""
        ...

    def forward(self, joints: FloatArray, side: FloatArray | None = None) -> FloatArray:
        """(N, 7) base_from_flange at joint values (N, n)."""
        ...

    def derivatives(
        self, joints: FloatArray, side: FloatArray | None = None, of: IntArray | None = None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """base_from_flange (N, 7), and twists (omega; v) at the base's origin: (N, n, 6) by joint values and (N, p, 6) by the parameters of
        these indices, by default all."""
        ...

    def inverse(self, pose: FloatArray, seed: int = 0) -> FloatArray:
        """(k, n) joint values within the limits that take the flange to the pose (7,): all that there are, none where k is 0."""
        ...


def joint_columns(robot: RobotModel, joints: FloatArray) -> dict[str, FloatArray]:
    """Return joint values (..., n) [rad, mm] as columns `NAME_deg` or `NAME_mm` of files."""
    values = np.moveaxis(np.where(robot.sliding, joints, np.degrees(joints)), -1, 0)
    return {f"{name}_{'mm' if slides else 'deg'}": v for name, slides, v in zip(robot.joint_names, robot.sliding, values, strict=True)}


def nearest_turns(values: FloatArray, to: FloatArray, sliding: BoolArray) -> FloatArray:
    """Return joint values (..., n) whose turning joints are brought by whole turns nearest to others (..., n)."""
    return np.asarray(values - np.where(sliding, 0.0, 2.0 * np.pi * np.round((values - to) / (2.0 * np.pi))))


def joint_value(robot: RobotModel, joint: int, value: float) -> tuple[float, str]:
    """Return a joint's value [rad, mm] in degrees or millimetres, and that unit, for a message."""
    return (float(value), "mm") if robot.sliding[joint] else (float(np.degrees(value)), "deg")
