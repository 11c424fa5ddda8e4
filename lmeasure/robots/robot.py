"""A robot of a robot.toml: joints by standard Denavit-Hartenberg links, and further data."""

import math
from importlib.resources import files as resources
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

import numpy as np
from pydantic import Field, model_validator

from lmeasure.core import FloatArray, RobotError
from lmeasure.io import Name, Strict, checked, files, of_key
from lmeasure.robots.model import Angle, Frame, Length, Place, Small, named_once
from lmeasure.robots.parallel.file import ParallelFile
from lmeasure.robots.platform import PlatformFile
from lmeasure.robots.serial import GRAVITY_M_S2, Coupling, SerialArm, SerialRobot
from lmeasure.text import message

SCHEMA = "lmeasure.robot/1"
_SHIPPED = resources("lmeasure.robots").joinpath("shipped")
MOST_JOINTS = 32
LIMITS = ("min_deg", "max_deg", "min_mm", "max_mm")
GEOMETRY = frozenset(("name", "type", "theta_deg", "d_mm", "a_mm", "alpha_deg", "beta_deg", *LIMITS, "pitch_mm", "follows", "ratio"))
"""Keys of a joint for its axis, its limits and the joint that it follows."""


class _Link(Strict):
    """Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta). The joint's value is added to theta of a turning joint and to d of a sliding one."""

    name: Name
    """Name of the joint; `measurements.csv` has its values in `NAME_deg` or `NAME_mm`."""
    theta_deg: Angle = 0.0
    """Rotation about the joint's axis, z."""
    d_mm: Length = 0.0
    """Displacement along the joint's axis, z."""
    a_mm: Length = 0.0
    """Displacement along the new x."""
    alpha_deg: Angle = 0.0
    """Rotation about the new x."""
    beta_deg: Angle = 0.0
    """Rotation about the new y (Hayati), for nearly parallel axes."""
    scale: Annotated[float, Field(ge=-10.0, le=10.0)] = 1.0
    """Factor of the joint's value; -1: the joint counts in the opposite direction."""
    follows: Name | None = None
    """Joint that also moves this one, as in a parallelogram; this joint then has no value or limits."""
    ratio: Annotated[float, Field(ge=-1e4, le=1e4)] = 1.0
    """Value of this joint per value of the followed joint; `theta_deg` or `d_mm` is its offset."""

    @model_validator(mode="after")
    def _scale_is_not_nothing(self) -> Self:
        if abs(self.scale) < 0.1:
            raise of_key("scale", message("error.leaves_nothing_of_the", scale=self.scale))
        return self


class Revolute(_Link):
    """Joint that turns."""

    type: Literal["revolute"] = "revolute"
    """Joint that turns."""
    min_deg: Angle = -360.0
    """Smallest joint value."""
    max_deg: Angle = 360.0
    """Largest joint value."""
    sin1_deg: Small = 0.0
    """Amplitude of the error once per turn, sine."""
    cos1_deg: Small = 0.0
    """Amplitude of the error once per turn, cosine."""
    sin2_deg: Small = 0.0
    """Amplitude of the error twice per turn, sine."""
    cos2_deg: Small = 0.0
    """Amplitude of the error twice per turn, cosine."""
    compliance_deg_per_nm: Small = 0.0
    """Compliance of the joint under the payload's torque."""
    backlash_deg: Small = 0.0
    """Play of the joint, full width."""

    @property
    def terms(self) -> tuple[float, ...]:
        """Return the terms in the order of `serial_robot.TERMS`, rad and N mm."""
        angles = (self.sin1_deg, self.cos1_deg, self.sin2_deg, self.cos2_deg, 1e-3 * self.compliance_deg_per_nm, self.backlash_deg)
        return (self.scale - 1.0, *(math.radians(v) for v in angles))


class Prismatic(_Link):
    """Joint that slides."""

    type: Literal["prismatic"] = "prismatic"
    """Joint that slides."""
    min_mm: Length = 0.0
    """Smallest joint value."""
    max_mm: Length = 0.0
    """Largest joint value."""
    pitch_mm: Annotated[Length, Field(gt=0)] | None = None
    """Pitch of the driving screw: the period of the harmonic errors."""
    sin1_mm: Small = 0.0
    """Amplitude of the error once per pitch, sine."""
    cos1_mm: Small = 0.0
    """Amplitude of the error once per pitch, cosine."""
    sin2_mm: Small = 0.0
    """Amplitude of the error twice per pitch, sine."""
    cos2_mm: Small = 0.0
    """Amplitude of the error twice per pitch, cosine."""
    compliance_mm_per_n: Small = 0.0
    """Compliance of the joint under the payload's weight."""
    backlash_mm: Small = 0.0
    """Play of the joint, full width."""

    @model_validator(mode="after")
    def _has_limits(self) -> Self:
        missing = next((key for key in ("min_mm", "max_mm") if key not in self.model_fields_set), None)
        if missing is not None and self.follows is None:
            raise of_key(missing, message("error.is_missing"))
        return self

    @property
    def terms(self) -> tuple[float, ...]:
        """Return the terms in the order of `serial_robot.TERMS`, mm and N."""
        return (self.scale - 1.0, self.sin1_mm, self.cos1_mm, self.sin2_mm, self.cos2_mm, self.compliance_mm_per_n, self.backlash_mm)


class Payload(Strict):
    """Payload at the flange."""

    mass_kg: Annotated[float, Field(ge=0, le=1e5)]
    """Mass."""
    centre_mm: tuple[Length, Length, Length] = (0.0, 0.0, 0.0)
    """Centre of mass, in the flange's frame."""


Joint = Annotated[Revolute | Prismatic, Field(discriminator="type")]


class Robot(Strict):
    """Serial robot: joints from the base to the flange."""

    schema_: Annotated[Literal["lmeasure.robot/1"], Field(alias="schema")] = "lmeasure.robot/1"
    """Kind and version of the file."""
    name: Name
    """Name of the robot."""
    kind: Literal["serial"] = "serial"
    """Serial chain of joints."""
    base: Frame | None = None
    """Pose of the first axis' frame (z along the axis) in the controller's base; default: identity."""
    flange: Frame | None = None
    """Pose of the controller's flange in the last link's frame; default: identity."""
    tool: Place | None = None
    """Pose of the tool on the flange; default: the flange itself."""
    payload: Payload | None = None
    """Payload at the flange."""
    joint: Annotated[tuple[Joint, ...], Field(min_length=1, max_length=MOST_JOINTS)]
    """Joints from the base to the flange, one table `[[joint]]` each."""

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        named_once("joint", [j.name for j in self.joint])
        for j in self.joint:
            if j.follows is not None:
                self._followed(j)
                continue
            if j.ratio != 1.0:
                raise ValueError(message("error.joint_ratio_goes_with", name=j.name))
            low, high, unit = (j.min_deg, j.max_deg, "deg") if isinstance(j, Revolute) else (j.min_mm, j.max_mm, "mm")
            if not low < high:
                raise ValueError(message("error.joint_min_is_not", name=j.name, unit=unit, low=low, high=high))
        return self

    def _followed(self, joint: "Joint") -> None:
        """ValueError unless the joint follows one of the others that has its own value."""
        leader = next((j for j in self.joint if j.name == joint.follows), None)
        if leader is None or leader.follows is not None:
            raise ValueError(message("error.joint_follows_which_is", name=joint.name, follows=joint.follows))
        if joint.ratio == 0.0 or any(joint.terms):
            raise ValueError(message("error.joint_follows_ratio_must", name=joint.name, name2=leader.name))

    @property
    def sliding(self) -> tuple[bool, ...]:
        """Return whether each joint slides."""
        return tuple(isinstance(j, Prismatic) for j in self.joint)

    @property
    def driven(self) -> "tuple[Joint, ...]":
        """The joints that have a value of their own."""
        return tuple(j for j in self.joint if j.follows is None)

    @property
    def _coupling(self) -> Coupling | None:
        if len(self.driven) == len(self.joint):
            return None
        at = {j.name: i for i, j in enumerate(self.joint)}
        driven = [at[j.name] for j in self.driven]
        matrix = np.zeros((len(self.joint), len(driven)))
        for i, j in enumerate(self.joint):
            leader = self.joint[at[j.follows or j.name]]
            matrix[i, driven.index(at[leader.name])] = (j.ratio if j.follows else 1.0) * _unit(j) / _unit(leader)
        return Coupling(matrix, np.array(driven, dtype=np.int64))

    @property
    def arm(self) -> SerialArm:
        """Its geometry as arrays."""
        links = np.array(
            [[math.radians(j.theta_deg), j.d_mm, j.a_mm, math.radians(j.alpha_deg), math.radians(j.beta_deg)] for j in self.joint]
        )
        limits = np.array([np.radians([j.min_deg, j.max_deg]) if isinstance(j, Revolute) else [j.min_mm, j.max_mm] for j in self.driven])
        foot, tool = ((Place() if place is None else place).row for place in (self.base, self.tool))
        seat = None if self.flange is None else self.flange.row
        return SerialArm(links, foot, tool, limits[:, 0], limits[:, 1], np.array(self.sliding), seat, self._coupling)

    @property
    def tool_pose(self) -> FloatArray:
        """(7,) flange from tool, the flange itself where none is stated."""
        return (self.tool or Place()).row

    @property
    def model(self) -> SerialRobot:
        """The robot that computes."""
        driven, links = self.driven, tuple(j.name for j in self.joint)
        turn = [1.0 if isinstance(j, Revolute) else 2.0 * math.pi / j.pitch_mm if j.pitch_mm else math.nan for j in driven]
        load = np.zeros(3) if self.payload is None else np.array([0.0, 0.0, -GRAVITY_M_S2 * self.payload.mass_kg])
        at = np.zeros(3) if self.payload is None else np.array(self.payload.centre_mm)
        terms = np.array([j.terms for j in driven])
        return SerialRobot(self.name, tuple(j.name for j in driven), links, self.arm, terms, np.array(turn), load, at, self.arm)

    def to_dict(self) -> dict[str, Any]:
        """The content of robot.toml; terms that are nothing are left out."""
        data = self.model_dump(by_alias=True, exclude_none=True, mode="json")
        for joint in data["joint"]:
            for key in [k for k, v in joint.items() if k not in GEOMETRY and v == (1.0 if k == "scale" else 0.0)]:
                del joint[key]
            for key in LIMITS if joint.get("follows") else ("ratio",):
                joint.pop(key, None)
        return data

    def with_values(self, values: dict[str, float]) -> Self:
        """Return it with values of its parameters by name, such as `joint_2.a_mm`."""
        of: dict[str, dict[str, float]] = {}
        for name, value in values.items():
            joint, key = name.rsplit(".", 1)
            of.setdefault(joint, {})[key] = float(value)
        return self.model_copy(update={"joint": tuple(j.model_copy(update=of.get(j.name, {})) for j in self.joint)})


def _unit(joint: "Joint") -> float:
    """Rad or mm in one degree or mm of a joint's value."""
    return math.radians(1.0) if isinstance(joint, Revolute) else 1.0


AnyRobot: TypeAlias = Robot | PlatformFile | ParallelFile
"""A robot.toml of any kind."""


def robot_from_dict(data: dict[str, Any], source: str = "robot") -> AnyRobot:
    """A checked robot of the kind that is stated; RobotError names the source and the key."""
    if "schema" not in data:
        raise RobotError(message("error.schema_is_missing_this_program", where=source, schema=SCHEMA))
    if data.get("kind") in ("hexapod", "cables"):
        return checked(data, PlatformFile, source, RobotError)
    if data.get("kind") == "parallel":
        return checked(data, ParallelFile, source, RobotError)
    return checked(data, Robot, source, RobotError)


def read_robot(path: Path) -> AnyRobot:
    """Read and check a robot.toml; RobotError names the file and the key."""
    return robot_from_dict(files.read_toml(path), str(path))


def write_robot(path: Path, robot: AnyRobot) -> None:
    """Write a robot.toml, whole or not at all."""
    files.write_toml(path, robot.to_dict())


def shipped_names() -> tuple[str, ...]:
    """Robots that come along."""
    return tuple(sorted(Path(entry.name).stem for entry in _SHIPPED.iterdir() if entry.name.endswith(".toml")))


def any_shipped(name: str) -> AnyRobot:
    """A robot that comes along, by its name; RobotError names those that there are."""
    if name not in shipped_names():
        raise RobotError(message("error.is_no_robot_that", name=name, shipped_names=", ".join(shipped_names())))
    return read_robot(Path(str(_SHIPPED.joinpath(f"{name}.toml"))))


def shipped(name: str) -> Robot:
    """A serial arm that comes along, by its name."""
    return serial(any_shipped(name), name)


def serial(robot: AnyRobot, source: str) -> Robot:
    """The robot where it is a serial arm; RobotError where it is none."""
    if not isinstance(robot, Robot):
        raise RobotError(message("error.is_a_robot_of", where=source, kind=robot.kind))
    return robot
