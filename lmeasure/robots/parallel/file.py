"""A parallel robot of a robot.toml: its legs, a pose near which it works, and the limits of its joints and carriages."""

from dataclasses import replace
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.io import Name, Strict, of_key
from lmeasure.robots.model import Angle, Length, Limits, Place, legs_with, named_once, nearest_turns
from lmeasure.robots.parallel.legs import KINDS, Driver, Leg, way_of
from lmeasure.robots.parallel.model import COMPONENTS, EQUATIONS, Parallel, nearness
from lmeasure.text import message

NEAR_HOME = 0.2
"""Largest distance of the pose at which the legs meet from the stated home, as a part of the platform's size."""
SINGULAR = 1e-6
Point = tuple[Length, Length, Length]
Positive = Annotated[Length, Field(gt=0.0)]


class _Leg(Strict):
    """Common keys of all legs."""

    type: str
    """Kind of the leg."""
    name: Name
    """Name of the leg and its joint; `measurements.csv` has the joint's values in `NAME_deg` or `NAME_mm`."""
    platform_mm: Point
    """Upper end, in the flange's frame."""

    @property
    def values(self) -> FloatArray:
        """(k,) of its kind's keys, mm and rad."""
        out = []
        for key in KINDS[self.type].keys:
            value = self.base_mm["xyz".index(key[5])] if key.startswith("base_") else getattr(self, key)  # type: ignore[attr-defined]
            out.append(np.radians(value) if key.endswith("_deg") else value)
        return np.array(out, dtype=np.float64)

    def limits(self, end: str, per: str = "") -> FloatArray:
        """(d,) a value of its drives, mm and rad: least or most ("min", "max"), or another of their keys; NaN where it is not stated."""
        out = []
        for name, slides in KINDS[self.type].drives:
            value = getattr(self, f"{name[1:]}_{end}_{'mm' if slides else 'deg'}{per}".lstrip("_"))
            out.append(np.nan if value is None else value if slides else np.radians(value))
        return np.array(out, dtype=np.float64)


class _Turning(_Leg):
    min_deg: Angle = -360.0
    """Smallest joint value."""
    max_deg: Angle = 360.0
    """Largest joint value."""
    max_speed_deg_s: Positive | None = None
    """Largest speed of the drive."""
    max_acceleration_deg_s2: Positive | None = None
    """Largest acceleration of the drive."""
    resolution_deg: Positive | None = None
    """Step of the drive, such as that of a stepper motor behind its gear."""
    resolution_error_deg: Positive | None = None
    """Largest error of a step's position."""


class _Sliding(_Leg):
    min_mm: Length
    """Smallest joint value."""
    max_mm: Length
    """Largest joint value."""
    max_speed_mm_s: Positive | None = None
    """Largest speed of the drive."""
    max_acceleration_mm_s2: Positive | None = None
    """Largest acceleration of the drive."""
    resolution_mm: Positive | None = None
    """Step of the drive."""
    resolution_error_mm: Positive | None = None
    """Largest error of a step's position."""


class _Ring(_Turning):
    ring_mm: Positive
    """Radius of the circular guide about the base's z."""
    height_mm: Length = 0.0
    """Height of the carriage above the base's z = 0."""
    offset_deg: Angle = 0.0
    """Azimuth of the carriage at joint value 0."""


class Strut(_Sliding):
    """Leg of variable length, scale * joint value + offset."""

    type: Literal["strut"]
    """Leg of variable length, as of a hexapod."""
    base_mm: Point
    """Lower end, in the base's frame."""
    offset_mm: Length = 0.0
    """Length at joint value 0."""
    scale: Annotated[float, Field(ge=0.1, le=10.0)] = 1.0
    """Change of length per joint value."""
    base_axis: Point | None = None
    """Direction of the first axis of the lower Hooke joint, in the base's frame."""
    platform_axis: Point | None = None
    """Direction of the first axis of the upper Hooke joint, in the flange's frame."""

    @model_validator(mode="after")
    def _axes_are_two(self) -> Self:
        if (self.base_axis is None) != (self.platform_axis is None):
            raise ValueError(message("error.base_axis_and_platform"))
        for name, axis in (("base_axis", self.base_axis), ("platform_axis", self.platform_axis)):
            if axis is not None and not any(axis):
                raise of_key(name, message("error.is_no_direction"))
        return self


class Rod(_Leg):
    """Rod of constant length between ball joints."""

    type: Literal["rod"]
    """Rod of constant length between ball joints."""
    base_mm: Point
    """Lower end, in the base's frame."""
    rod_mm: Positive
    """Length of the rod."""


class Carriage(_Ring):
    """Rod from a carriage on a circular guide."""

    type: Literal["carriage"]
    """Rod from a carriage on a circular guide."""
    rod_mm: Positive
    """Length of the rod."""
    elbow: Literal[1, 2] = 1
    """Solution for the carriage at home: 1 is the smaller rotation, 2 the larger."""


class Crank(_Turning):
    """Rod from a crank that turns in a vertical plane."""

    type: Literal["crank"]
    """Rod from a crank that turns in a vertical plane."""
    base_mm: Point
    """Axis of the crank, in the base's frame."""
    azimuth_deg: Angle
    """Azimuth of the crank's axis; the crank turns across it, positive towards azimuth + 90°."""
    tilt_deg: Angle = 0.0
    """Tilt of the crank's vertical towards the azimuth."""
    crank_mm: Positive
    """Length of the crank."""
    offset_deg: Angle = 0.0
    """Angle of the crank from vertical at joint value 0."""
    rod_mm: Positive
    """Length of the rod."""
    elbow: Literal[1, 2] = 2
    """Solution for the crank at home: 1 is the smaller rotation, 2 the larger."""


class Slider(_Sliding):
    """Rod from a carriage on a straight guide."""

    type: Literal["slider"]
    """Rod from a carriage on a straight guide."""
    base_mm: Point
    """Position of the carriage at joint value 0, in the base's frame."""
    azimuth_deg: Angle
    """Azimuth of the guide."""
    elevation_deg: Angle = 0.0
    """Elevation of the guide above the horizontal."""
    rod_mm: Positive
    """Length of the rod."""
    elbow: Literal[1, 2] = 1
    """Solution for the carriage at home: 2 is farther along the guide."""


class _Hinged(_Ring):
    turn_deg: Angle = 0.0
    """Rotation of the hinge from the direction along the guide, about the vertical."""
    tilt_deg: Angle = 0.0
    """Tilt of the hinge about the outward direction."""


class Radial(_Hinged):
    """Carriage on a circular guide, with a hinge along the guide and a slide."""

    type: Literal["radial"]
    """Carriage on a circular guide, with a hinge and a slide."""
    slide_offset_mm: Length = 0.0
    """Length at slide value 0."""
    slide_min_mm: Length
    """Smallest slide value."""
    slide_max_mm: Length
    """Largest slide value."""
    slide_max_speed_mm_s: Positive | None = None
    """Largest speed of the slide."""
    slide_max_acceleration_mm_s2: Positive | None = None
    """Largest acceleration of the slide."""
    slide_resolution_mm: Positive | None = None
    """Step of the slide."""
    slide_resolution_error_mm: Positive | None = None
    """Largest error of a step's position of the slide."""


class RadialArm(_Hinged):
    """Carriage on a circular guide, with a hinge along the guide and two arms."""

    type: Literal["radial-arm"]
    """Carriage on a circular guide, with a hinge and two arms."""
    lift_deg: Angle = 0.0
    """Angle of the lower arm above the inward direction at lift value 0."""
    lower_mm: Positive
    """Length of the arm at the carriage."""
    upper_mm: Positive
    """Length of the arm at the platform."""
    lift_min_deg: Angle = -360.0
    """Smallest lift value."""
    lift_max_deg: Angle = 360.0
    """Largest lift value."""
    lift_max_speed_deg_s: Positive | None = None
    """Largest speed of the lift."""
    lift_max_acceleration_deg_s2: Positive | None = None
    """Largest acceleration of the lift."""
    lift_resolution_deg: Positive | None = None
    """Step of the lift."""
    lift_resolution_error_deg: Positive | None = None
    """Largest error of a step's position of the lift."""
    elbow: Literal[1, 2] = 2
    """Solution for the lift at home: 1 is the smaller lift, 2 the larger."""


class Plane(_Leg):
    """Constraint that keeps a point of the platform at a height."""

    type: Literal["plane"]
    """Constraint to a height; three of them make a platform planar."""
    height_mm: Length = 0.0
    """Height above the base's z = 0."""


class Way(_Sliding):
    """Drive of a point of the platform along the path that five rods allow."""

    type: Literal["way"]
    """Drive along the path that five rods allow; 0 at home."""
    way_offset_mm: Length = 0.0
    """Path length at joint value 0."""
    step_mm: Positive = 10.0
    """Distance of nodes along the path."""


AnyLeg = Annotated[Strut | Rod | Carriage | Crank | Slider | Radial | RadialArm | Plane | Way, Field(discriminator="type")]
Component = Literal["rx", "ry", "rz", "x", "y", "z"]


class ParallelFile(Strict):
    """Parallel robot: a platform on legs."""

    schema_: Annotated[Literal["lmeasure.robot/1"], Field(alias="schema")] = "lmeasure.robot/1"
    """Kind and version of the file."""
    name: Name
    """Name of the robot."""
    kind: Literal["parallel"]
    """Platform on legs of several kinds, six equations in total."""
    home: Place
    """Pose of the flange in the base's frame, near which the robot works. It selects the assembly mode."""
    tool: Place | None = None
    """Pose of the tool on the flange; default: the flange itself."""
    commanded: tuple[Component, ...] = ()
    """Commanded coordinates of a robot with fewer than six joints, as many as joints; rotations about the platform's axes."""
    limits: Limits = Limits()
    """Limits of the workspace besides those of the joints."""
    leg: Annotated[tuple[AnyLeg, ...], Field(min_length=3, max_length=EQUATIONS + 3)]
    """Legs, one table `[[leg]]` each."""

    @model_validator(mode="after")
    def _holds_together(self) -> Self:
        named_once("leg", [leg.name for leg in self.leg])
        equations = sum(2 if leg.type.startswith("radial") else 1 for leg in self.leg)
        if equations != EQUATIONS:
            raise of_key("leg", message("error.equations_hold_the_platform", equations=equations, equations2=EQUATIONS))
        for leg in self.leg:
            if not (leg.limits("min") < leg.limits("max")).all():
                raise ValueError(message("error.leg_its_least_joint", name=leg.name))
        found = self.model
        count = len(found.joint_names)
        if count == 0:
            raise of_key("leg", message("error.none_has_a_drive"))
        if count < EQUATIONS and len(set(self.commanded)) != count:
            raise of_key("commanded", message("error.must_name_of_as", count=count, components=", ".join(COMPONENTS)))
        low, high = found.limits
        beyond = (found.home_joints < low) | (found.home_joints > high)
        if beyond.any():
            raise of_key("home", message("error.is_beyond_its_limits", joint_names=found.joint_names[int(np.argmax(beyond))]))
        return self

    @property
    def model(self) -> Parallel:
        """The robot that computes."""
        home, legs = self.home.row, []
        for leg in self.leg:
            carried: Any = None
            if isinstance(leg, Strut) and leg.base_axis is not None and leg.platform_axis is not None:
                axes = np.array([leg.base_axis, leg.platform_axis])
                carried = axes / np.linalg.norm(axes, axis=1, keepdims=True)
            if isinstance(leg, Way):
                rods = tuple((rod.base_mm, rod.platform_mm, rod.rod_mm) for rod in self.leg if isinstance(rod, Rod))
                driver = Driver(leg.platform_mm, leg.step_mm, (leg.min_mm, leg.max_mm))
                try:
                    home, carried = way_of(rods, tuple(home.tolist()), driver)
                except GeometryError as error:
                    raise ValueError(message("error.leg", name=leg.name, error=error)) from None
            legs.append(Leg(leg.name, leg.type, np.array(leg.platform_mm), leg.values, leg.limits("min"), leg.limits("max"), carried))
        robot = Parallel(self.name, tuple(legs), home, np.zeros(0), self.commanded or COMPONENTS, self.limits)
        joints = []
        for leg, every in zip(self.leg, robot.roots(home[None]), strict=True):
            own = every[0, min(getattr(leg, "elbow", 1), every.shape[1]) - 1]
            if not np.isfinite(own).all():
                raise of_key("home", message("error.does_not_reach_there", name=leg.name))
            slides = np.array([slide for _, slide in KINDS[leg.type].drives], dtype=np.bool_)
            joints.append(nearest_turns(own, 0.5 * (leg.limits("min") + leg.limits("max")), slides))
        robot = replace(robot, home_joints=np.concatenate(joints))
        closed, met = robot.near(robot.home_joints[None], home[None])
        away = np.abs(se3.displacement(closed, home[None]) / robot.units).max()
        if not met[0] or away > NEAR_HOME * robot.size_mm:
            raise of_key("home", message("error.the_legs_do_not"))
        robot = replace(robot, home=closed[0])
        if nearness(robot.jacobians(closed, robot.home_joints[None]).output, robot.units)[0] <= SINGULAR:
            raise of_key("home", message("error.is_a_singular_pose"))
        return robot

    def drives(self, key: str, per: str = "") -> FloatArray:
        """(n,) a key of all drives such as `max_speed` per `_s`, mm and rad; NaN where it is not stated."""
        return np.concatenate([leg.limits(key, per) for leg in self.leg])

    @property
    def tool_pose(self) -> FloatArray:
        """(7,) flange from tool, the flange itself where none is stated."""
        return (self.tool or Place()).row

    def to_dict(self) -> dict[str, Any]:
        """The content of robot.toml."""
        data = self.model_dump(by_alias=True, exclude_none=True, mode="json")
        if not self.commanded:
            del data["commanded"]
        return data

    def with_values(self, values: dict[str, float]) -> Self:
        """Return it with values of its parameters by name, such as `leg_1.rod_mm`."""
        return self.model_copy(update={"leg": legs_with(self.leg, values)})
