"""Interface of every robot under test: parameters by name, joint values to poses, and the derivatives of both."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated, Any, Protocol, Self

import numpy as np
from pydantic import AfterValidator, Field, model_validator

from lmeasure.core import LARGEST_ANGLE, MAX_LENGTH_MM, BoolArray, FloatArray, IntArray
from lmeasure.io import Name, Strict, of_key
from lmeasure.recording import UNIT_TOLERANCE
from lmeasure.text import message


@dataclass(frozen=True)
class Parameter:
    """A parameter of a robot with its name in files, such as `joint_2.a_mm`; value in the unit (`mm`, `deg`, ...) that the name ends with.

    size: its unit in the robot's own numbers, radians and millimetres; width: default standard uncertainty of its nominal value, in its
    unit.
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
        """Return the name in its file."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Return names in the order of joint values."""
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
        """Return the farthest distance of the flange from its base [mm]; infinity if unknown."""
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


def _length(value: float) -> float:
    if not abs(value) <= MAX_LENGTH_MM:
        raise ValueError(message("error.must_be_a_length_of", max_length_mm=MAX_LENGTH_MM))
    return value


def _angle(value: float) -> float:
    if not abs(value) <= LARGEST_ANGLE:
        raise ValueError(message("error.must_be_an_angle", largest_angle=LARGEST_ANGLE))
    return value


Length = Annotated[float, AfterValidator(_length)]
Angle = Annotated[float, AfterValidator(_angle)]
Small = Annotated[float, Field(ge=-1e3, le=1e3)]


def named_once(kind: str, names: list[str]) -> None:
    """ValueError for a name that several have."""
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise of_key(kind, message("error.the_name_is_given_twice", twice=twice))


def legs_with(legs: Sequence[Any], values: dict[str, float]) -> tuple[Any, ...]:
    """Legs with values of their parameters by name, such as `leg_1.rod_mm` or `leg_1.base_x_mm`."""
    out = []
    for leg in legs:
        own = {name.split(".", 1)[1]: float(value) for name, value in values.items() if name.startswith(f"{leg.name}.")}
        update: dict[str, Any] = {key: value for key, value in own.items() if key in type(leg).model_fields}
        for end in ("base", "platform"):
            if (old := getattr(leg, f"{end}_mm", None)) is not None:
                update[f"{end}_mm"] = tuple(own.get(f"{end}_{axis}_mm", v) for axis, v in zip("xyz", old, strict=True))
        out.append(leg.model_copy(update=update))
    return tuple(out)


class Place(Strict):
    """Pose: of the home pose or the first axis in the robot's base, or of the tool on the flange."""

    position_mm: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Position."""
    quaternion_xyzw: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    """Orientation."""

    @model_validator(mode="after")
    def _turns(self) -> Self:
        length = math.hypot(*self.quaternion_xyzw)
        if not abs(length - 1.0) <= UNIT_TOLERANCE:
            raise of_key("quaternion_xyzw", message("error.its_length_is_not", length=length))
        return self

    @property
    def row(self) -> FloatArray:
        """(7,) pose."""
        quaternion = np.array(self.quaternion_xyzw)
        return np.concatenate([self.position_mm, quaternion / np.linalg.norm(quaternion)])


class Frame(Place):
    """Pose of the first axis in the controller's base, or of the controller's flange behind the last link."""

    link: Name | None = None
    """Link of the URDF file that the frame was read from."""


Cone = Annotated[float, Field(gt=0.0, le=180.0)]


class Limits(Strict):
    """Limits of the workspace. Neighbouring carriages are those of one circular guide, in the order of the legs."""

    least_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Smallest angle between neighbouring carriages."""
    most_gap_deg: Annotated[float, Field(ge=0.0, le=180.0)] | None = None
    """Largest angle between neighbouring carriages."""
    base_cone_deg: Cone | None = None
    """Largest angle between a leg and the base's z."""
    platform_cone_deg: Cone | None = None
    """Largest angle between a leg and the platform's z."""
    leg_turn_deg: Cone | None = None
    """Largest rotation of a leg on Hooke joints about itself, from the rotation at which both crosses are parallel."""
    hooke_deg: Annotated[float, Field(gt=0.0, le=90.0)] | None = None
    """Largest angle between a leg and the plane normal to the first axis of either of its Hooke joints."""
    singular: Annotated[float, Field(ge=0.0, lt=1.0)] = 1e-3
    """Smallest allowed ratio of the smallest to the largest singular value of the Jacobian."""
    mass_mm: tuple[Length, Length, Length] | None = None
    """Centre of mass in the flange's frame. It must stay above the polygon of the legs' lower ends."""
