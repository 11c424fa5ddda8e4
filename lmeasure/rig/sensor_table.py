"""Tables of rig.toml that state a sensor other than a cable: the common part of all kinds, and the registry of kinds.

A kind is a model of its table, registered by the table's name. Those of this program are in `TABLES`; other packages enter theirs through
the entry point group `lmeasure.sensors`, whose objects have the model as `table` (`sensors.SensorKind`). They are loaded only for a rig
with a table of that name.

Tables of the sensors of this program other than cables: swivel encoders, inclinometers, straight distances.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Protocol, get_args, get_origin, runtime_checkable

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from lmeasure import kernels
from lmeasure.core import FloatArray, RigError, plug_in, plug_in_names
from lmeasure.io import Name, Strict, Whole, of_key, whole
from lmeasure.rig.points_and_drums import Cable, Length, NotNegative, ObservationPoint, Positive
from lmeasure.text import message

TABLES: "dict[str, type[SensorTable]]" = {}  # Models of the tables of this process by their names in rig.toml
ANYWHERE_DEG = 360.0 / math.sqrt(12.0)  # Standard uncertainty of an angle that may be anywhere on the circle
ANY_MM = 1000.0  # The same of a length
SCALE = "scale"
Degrees = Annotated[float, Field(ge=-360, le=360)]
SmallAngle = Annotated[float, Field(ge=0, le=360)]


class Instrument(Protocol):
    """Parts of a rig that its sensors depend on."""

    @property
    def tool(self) -> dict[str, tuple[Length, Length, Length]]:
        """Attachment points."""

    @property
    def cable(self) -> tuple[Cable, ...]:
        """Its cables."""

    @property
    def observation_point(self) -> tuple[ObservationPoint, ...]:
        """Its observation points."""

    @property
    def passes(self) -> int:
        """Return the number of passes of the motion that it needs."""

    def point(self, name: str) -> ObservationPoint:
        """Return the observation point of that name."""


@dataclass(frozen=True)
class Keyed:
    """A parameter of a rig, whose key ends in its unit."""

    key: str

    @property
    def unit(self) -> str:
        """mm, deg, or nothing."""
        return next((unit for unit in ("mm", "deg") if self.key.endswith(f"_{unit}")), "")

    @property
    def factor(self) -> float:
        """Return the kernels' value of one unit: radians of a degree."""
        return math.radians(1.0) if self.unit == "deg" else 1.0


@dataclass(frozen=True)
class OwnParameter(Keyed):
    """A number of a sensor's table on which its reading depends. key: its name in a calibration record, behind the channel's; stored,
    index: where rig.toml has it; place: where it is among the kernels' `PARAMETERS`; stated: the key of its standard uncertainty."""

    stored: str
    index: int | None
    place: int
    stated: str


@dataclass(frozen=True)
class SensorChannel:
    """A sensor as a channel of one pass; from and to the points between which it measures, empty where it has none."""

    table: "SensorTable"
    passage: int = 1
    from_point: str = ""
    to_point: str = ""
    again: bool = False
    """Whether other passes read it too."""

    is_cable: ClassVar[bool] = False

    @property
    def channel(self) -> str:
        """Return the channel of its column."""
        return self.table.channel

    @property
    def name(self) -> str:
        """Return the name of its column; `sw1@2` in pass 2, if several passes read sw1."""
        return f"{self.channel}@{self.passage}" if self.again else self.channel

    @property
    def kind(self) -> str:
        """Return its table's name in rig.toml."""
        return self.table.kind

    @property
    def is_length(self) -> bool:
        """Return whether it reads a length [mm]; else an angle [rad]."""
        return self.table.is_length


class SensorTable(Strict):
    """A sensor with a channel of counts: reading = zero + count_sign * count * (unit of a count), linear in the count."""

    kind: ClassVar[str] = ""
    """The name of its table in rig.toml."""
    is_length: ClassVar[bool] = False
    """Whether it reads a length [mm]; else an angle [rad]."""
    if TYPE_CHECKING:

        @property
        def counts_per_revolution(self) -> Any:
            """Counts in a turn of it, as drums have them."""

        @property
        def scale(self) -> Any:
            """Decoding factor, as drums have one."""

    own: ClassVar[tuple[str, ...]] = ()
    """Keys of the numbers on which its reading depends, each a number or a list of numbers, named with their unit. `u_` and such a key is
    the key of its standard uncertainty, if there is one."""
    zero: ClassVar[str] = "zero_deg"
    """The key of the reading at count 0."""
    motion: ClassVar[str] = ""
    """Request of `lmeasure check` to a person so that its reading rises, such as "Move the tool away from the range finder"."""
    channel: Name
    """Column of the sensor in counts files."""
    count_sign: Annotated[Literal[1, -1], BeforeValidator(whole)] = 1
    """1: the count rises with the reading; -1: it falls."""
    absolute: bool = True
    """true: the reading is known at power-on. false: incremental, 0 where the counter was zeroed."""
    counter_bits: Annotated[Whole, Field(ge=8, le=64)] | None = None
    """Width of an incremental counter, after which it wraps around."""
    zero_exact: bool = False
    """true: count 0 of an incremental sensor is exact. Default: an unknown sub-count offset, as for drums."""

    @property
    def per_count(self) -> float:
        """Reading of a count [mm or rad]."""
        raise NotImplementedError

    @property
    def rate_key(self) -> str:
        """The key of the largest speed of its reading."""
        raise NotImplementedError

    @property
    def u_reading(self) -> float:
        """Standard uncertainty of one reading besides the rounding of its count [mm or rad]."""
        return 0.0

    @property
    def codes(self) -> int | None:
        """Return how many values an absolute one has whose reading comes round; None of others."""
        return None

    @property
    def speed_per_count(self) -> float:
        """Return the unit of `rate_key` per recorded count per second."""
        return self.per_count / self.scale * (1.0 if self.is_length else math.degrees(1.0))

    @property
    def rate(self) -> float:
        """Largest rate of its recorded count [1/s]."""
        return float(getattr(self, self.rate_key)) / self.speed_per_count

    @property
    def rate_stated(self) -> bool:
        """Return whether the rate is stated."""
        return self.rate_key in self.model_fields_set

    @model_validator(mode="after")
    def _zero_is_of_its_kind(self) -> "SensorTable":
        zero, u_zero = getattr(self, self.zero), getattr(self, f"u_{self.zero}")
        if self.absolute:
            for key in ("counter_bits", "zero_exact"):
                if getattr(self, key):
                    raise of_key(key, message("error.is_of_incremental_sensors"))
        elif zero is not None or u_zero is not None:
            raise of_key(self.zero, message("error.is_of_absolute_sensors"))
        if zero is None and u_zero is not None:
            raise of_key(f"u_{self.zero}", message("error.is_the_uncertainty_of", key=self.zero))
        return self

    @property
    def zero_value(self) -> float:
        """Reading at count 0, in the unit of its key."""
        return float(getattr(self, self.zero) or 0.0)

    @property
    def zero_u(self) -> float:
        """Standard uncertainty of the reading at count 0, in the unit of its key: it may be any where it is not stated."""
        if getattr(self, self.zero) is None:
            return ANY_MM if self.is_length else ANYWHERE_DEG
        return float(getattr(self, f"u_{self.zero}") or 0.0)

    def ends(self, rig: Instrument) -> list[tuple[int, str, str]]:
        """Return the passes in which it is read, with the points between which it measures there."""
        return [(passage, "", getattr(self, "to", "")) for passage in range(1, rig.passes + 1)]

    def faults(self, rig: Instrument) -> Iterator[tuple[str, str]]:
        """Yield contradictions with the rig's other tables: the key, empty for the whole table, and the fault."""
        to = getattr(self, "to", None)
        if to is not None and to not in rig.tool:
            yield "to", message("rig.no_tool_point", point=repr(to), known=", ".join(rig.tool))

    @classmethod
    def parameters(cls) -> tuple[OwnParameter, ...]:
        """Return the numbers of `own`, in their order; RigError where there are too many."""
        found: list[tuple[str, str, int | None]] = []
        for key in cls.own:
            annotation = cls.model_fields[key].annotation
            size = len(get_args(annotation)) if get_origin(annotation) is tuple else 0
            base, _, unit = key.rpartition("_") if key.endswith(("_mm", "_deg")) else (key, "", "")
            axes = "xyz" if size == 3 else "123456789"
            found += [(f"{base}_{axes[i]}{'_' if unit else ''}{unit}", key, i) for i in range(size)] if size else [(key, key, None)]
        if len(found) > len(kernels.OWN_PARAMETERS):
            numbers = {"n_found": len(found), "n_own_parameters": len(kernels.OWN_PARAMETERS)}
            raise RigError(message("error.its_reading_depends_on", kind=cls.kind, **numbers))
        return tuple(OwnParameter(k, s, i, p, f"u_{s}") for (k, s, i), p in zip(found, kernels.OWN_PARAMETERS, strict=False))

    def solvable(self) -> tuple[OwnParameter, ...]:
        """Return its own parameters, scale and zero included where it has them."""
        scale = (OwnParameter(SCALE, SCALE, None, kernels.BY_SCALE, f"u_{SCALE}"),) if SCALE in type(self).model_fields else ()
        zero = (OwnParameter(self.zero, self.zero, None, kernels.BY_ANGLE_ZERO, f"u_{self.zero}"),) if self.absolute else ()
        return (*self.parameters(), *scale, *zero)

    def value(self, p: OwnParameter) -> float:
        """Return a parameter's value in its own unit."""
        value = getattr(self, p.stored)
        return float((value if p.index is None else value[p.index]) or 0.0)

    def u(self, p: OwnParameter) -> float:
        """Return a parameter's standard uncertainty in its own unit, 0 where none is stated."""
        if p.key == self.zero:
            return self.zero_u
        return float(getattr(self, p.stated, None) or 0.0)

    def drawn(self, generator: "np.random.Generator") -> dict[str, Any]:
        """Return keys of a sensor with numbers of its `own`, with errors drawn of their standard uncertainties."""
        out: dict[str, Any] = {}
        stated = [p for p in self.solvable() if getattr(self, p.stored) is not None] if self.own else []
        for p in stated:
            value = self.value(p) + self.u(p) * generator.standard_normal()
            out[p.stored] = value if p.index is None else (*out.get(p.stored, ()), value)
        return out

    def names(self, channel: SensorChannel) -> list[str]:
        """Return the calibration record's names of the kernels' `PARAMETERS`, empty where it does not have one."""
        out = [""] * len(kernels.PARAMETERS)
        for p in self.solvable():
            out[p.place] = f"{self.channel}.{p.key}"
        if channel.to_point:
            out[kernels.BY_ATTACHMENT : kernels.BY_ATTACHMENT + 3] = [f"tool.{channel.to_point}.{axis}_mm" for axis in "xyz"]
        return out

    def fill(self, rig: Instrument, channel: SensorChannel, row: FloatArray) -> None:
        """Write the kernels' row of a channel."""
        row[kernels.KIND] = kernel_kind(type(self))
        row[kernels.COUNT_LENGTH], row[kernels.TURN_COUNTS] = self.per_count, self.counts_per_revolution
        row[kernels.ANGLE_ZERO] = self.zero_value * (1.0 if self.is_length else math.radians(1.0))
        own = self.parameters()
        row[list(kernels.OWN_COLUMNS[: len(own)])] = [self.value(p) * p.factor for p in own]
        if channel.to_point:
            row[kernels.ATTACHMENT_XYZ] = rig.tool[channel.to_point]


class LengthSensor(SensorTable):
    """A sensor that reads a length [mm]."""

    is_length: ClassVar[bool] = True
    zero: ClassVar[str] = "zero_mm"
    count_length_mm: Positive
    """Length per count."""
    u_count_length_mm: NotNegative | None = None
    """Standard uncertainty of `count_length_mm`."""
    scale: Annotated[float, Field(gt=1e-6, le=1e6)] = 1.0
    """Decoding factor: recorded count = count_sign * scale * count."""
    zero_mm: float | None = None
    """Length at count 0 of an absolute sensor; default: unknown, found by calibration."""
    u_zero_mm: NotNegative | None = None
    """Standard uncertainty of `zero_mm`; default: 0 if `zero_mm` is stated."""
    u_reading_mm: NotNegative | None = None
    """Standard uncertainty of one reading besides the rounding to counts; independent from reading to reading."""
    max_speed_mm_s: Positive = 20000.0
    """Largest speed; faster changes of the count are faults."""

    def u(self, p: OwnParameter) -> float:
        """Return a parameter's standard uncertainty in its own unit, 0 where none is stated."""
        if p.key == SCALE:
            return (self.u_count_length_mm or 0.0) / self.count_length_mm * self.scale
        return super().u(p)

    @property
    def per_count(self) -> float:
        """Length of a count [mm]."""
        return self.count_length_mm

    @property
    def counts_per_revolution(self) -> int:
        """It has no turns."""
        return 1

    @property
    def u_reading(self) -> float:
        """Standard uncertainty of one reading [mm]."""
        return self.u_reading_mm or 0.0

    @property
    def rate_key(self) -> str:
        """The key of the largest speed."""
        return "max_speed_mm_s"


class AngleSensor(SensorTable):
    """A sensor that reads an angle [rad]: an absolute one shows its count modulo its revolution, 0 .. counts_per_revolution - 1, an
    incremental one counts from where it was zeroed."""

    counts_per_revolution: Annotated[Whole, Field(ge=4, le=2**32)]
    """Counts per turn of the encoder."""
    zero_deg: Degrees | None = None
    """Angle at count 0 of an absolute encoder; default: unknown, found by calibration."""
    u_zero_deg: SmallAngle | None = None
    """Standard uncertainty of `zero_deg`; default: 0 if `zero_deg` is stated."""
    u_reading_deg: NotNegative | None = None
    """Standard uncertainty of one reading besides the rounding to counts; independent from reading to reading."""
    max_speed_deg_s: Annotated[float, Field(gt=0, le=1e6)] = 3600.0
    """Largest angular speed; faster changes of the count are faults."""

    @property
    def scale(self) -> float:
        """Decoding factor, as drums have one."""
        return 1.0

    @property
    def per_count(self) -> float:
        """Angle of a count [rad]."""
        return 2.0 * math.pi / self.counts_per_revolution

    @property
    def u_reading(self) -> float:
        """Standard uncertainty of one reading [rad]."""
        return math.radians(self.u_reading_deg or 0.0)

    @property
    def rate_key(self) -> str:
        """The key of the largest speed."""
        return "max_speed_deg_s"

    @property
    def codes(self) -> int | None:
        """Return how many values an absolute one has; None of an incremental one."""
        return self.counts_per_revolution if self.absolute else None


@runtime_checkable
class TableKind(Protocol):
    """A kind of sensor of another package, as far as rig.toml is concerned."""

    @property
    def table(self) -> type[SensorTable]:
        """The model of its table."""


def table_of(name: str) -> type[SensorTable] | None:
    """Return the model of a table of sensors by its name; None where there is none.

    Raises
    ------
    PlugInError
        If another package's cannot be loaded.
    """
    if name not in TABLES and name in plug_in_names(kernels.GROUP):
        kind = plug_in(kernels.GROUP, name, TableKind)  # type: ignore[type-abstract]
        assert kind is not None
        if kind.table.kind != name:
            raise RigError(message("error.the_package_that_adds", name=name, kind=kind.table.kind))
        TABLES[name] = kind.table
    return TABLES.get(name)


def register_table(table: type[SensorTable]) -> type[SensorTable]:
    """Register the model of a table of sensors in this process."""
    TABLES[table.kind] = table
    return table


def kernel_kind(table: type[SensorTable]) -> int:
    """Return KIND in the kernels' rows for a kind that another package adds."""
    number = external_number(table.kind)
    return kernels.EXTERNAL_LENGTH - number if table.is_length else kernels.EXTERNAL_ANGLE + number


def external_number(name: str) -> int:
    """Return the number of a kind that another package adds, the same in all processes with the same packages."""
    names = plug_in_names(kernels.GROUP)
    every = [*names, *(n for n, table in TABLES.items() if n not in names and table.fill is SensorTable.fill)]
    if every.index(name) >= kernels.KINDS:
        raise RigError(message("error.there_are_kinds_of", name=name, n_every=len(every), kinds=kernels.KINDS))
    return every.index(name)


def _has_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not 1e-6 < math.hypot(*value) < 1e6:
        raise ValueError(message("error.must_have_a_length"))
    return value


Way = Annotated[tuple[float, float, float], AfterValidator(_has_length)]


@register_table
class Swivel(AngleSensor):
    """Encoder of the rotation of a swivel pulley about the incoming cable. It reads angle + eccentricity sin(angle - phase)."""

    kind: ClassVar[str] = "swivel"
    point: Annotated[str, Field(min_length=1)]
    """Observation point of the swivel pulley."""
    cable: str | None = None
    """Cable that turns the pulley; needed if several cables leave the point in one pass."""
    eccentricity_deg: Annotated[float, Field(ge=0, le=10)] | None = None
    """Amplitude of the error from an encoder off its axis; default: 0."""
    eccentricity_phase_deg: Degrees | None = None
    """Swivel angle at which this error is zero and rising; default: 0."""
    backlash_deg: Annotated[float, Field(ge=0, le=10)] | None = None
    """Full width of the dead band between the two directions of rotation."""

    @model_validator(mode="after")
    def _phase_is_of_something(self) -> "Swivel":
        if self.eccentricity_phase_deg is not None and self.eccentricity_deg is None:
            raise of_key("eccentricity_phase_deg", message("error.is_the_phase_of"))
        return self

    def ends(self, rig: Instrument) -> list[tuple[int, str, str]]:
        """Return the passes in which a cable turns it, with that cable's points."""
        turning = [c for c in rig.cable if c.from_point == self.point and self.cable in (None, c.name)]
        return [(c.passage, c.from_point, c.to_point) for c in turning]

    def faults(self, rig: Instrument) -> Iterator[tuple[str, str]]:
        """Yield the faults of its point and cable."""
        points = [p.name for p in rig.observation_point]
        if self.point not in points:
            yield "point", message("rig.no_observation_point", point=repr(self.point), known=", ".join(points))
            return
        leaving = [c for c in rig.cable if c.from_point == self.point]
        determined = ", ".join(c.name for c in leaving) or message("rig.no_cable")
        if self.cable is not None and self.cable not in [c.name for c in leaving]:
            yield "cable", message("rig.no_cable_from", cable=repr(self.cable), point=self.point, known=determined)
        several = max(Counter(c.passage for c in leaving).values(), default=0) > 1
        if not leaving or (self.cable is None and several):
            yield "", message("rig.state_cable", point=self.point, channel=self.channel, known=determined)

    def names(self, channel: SensorChannel) -> list[str]:
        """Return the calibration record's names of the kernels' parameters: those of its point, its cable's end, and the zero."""
        out = super().names(channel)
        guide = ("x_mm", "y_mm", "z_mm", "guide_alpha_deg", "guide_beta_deg")
        out[kernels.BY_BASE : kernels.BY_BETA + 1] = [f"{channel.from_point}.{key}" for key in guide]
        return out

    def fill(self, rig: Instrument, channel: SensorChannel, row: FloatArray) -> None:
        """Write the kernels' row."""
        row[kernels.KIND], row[kernels.COUNT_LENGTH], row[kernels.TURN_COUNTS] = kernels.SWIVEL, self.per_count, self.counts_per_revolution
        row[kernels.ANGLE_ZERO] = math.radians(self.zero_value)
        fill_point(rig, channel.from_point, row)
        row[kernels.ATTACHMENT_XYZ] = rig.tool[channel.to_point]
        row[kernels.ECCENTRICITY] = math.radians(self.eccentricity_deg or 0.0)
        row[kernels.ECCENTRIC_PHASE] = math.radians(self.eccentricity_phase_deg or 0.0)


def fill_point(rig: Instrument, point: str, row: FloatArray) -> None:
    """Write an observation point and its guide into a kernels' row."""
    p = rig.point(point)
    tilt = p.swivel_tilt_deg or (0.0, 0.0)
    row[kernels.ALPHA], row[kernels.BETA] = math.radians(p.guide_alpha_deg + tilt[0]), math.radians(p.guide_beta_deg + tilt[1])
    a, b = float(row[kernels.ALPHA]), float(row[kernels.BETA])
    row[kernels.BASE_XYZ], row[kernels.GUIDE_XYZ] = p.position_mm, (-math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a))


@register_table
class Inclination(AngleSensor):
    """One axis of an inclinometer on the tool: angle of a sensing axis above the horizontal. Two axes: two tables."""

    kind: ClassVar[str] = "inclination"
    axis: Way
    """Sensing axis in the tool frame, of any length."""
    up: Way = (0.0, 0.0, 1.0)
    """Upward direction, against gravity, base frame."""

    def fill(self, rig: Instrument, channel: SensorChannel, row: FloatArray) -> None:
        """Write the kernels' row: the way up for the fixed point, the axis for the tool point."""
        row[kernels.KIND], row[kernels.COUNT_LENGTH] = kernels.INCLINATION, self.per_count
        row[kernels.TURN_COUNTS] = self.counts_per_revolution
        row[kernels.ANGLE_ZERO] = math.radians(self.zero_value)
        row[kernels.BASE_XYZ] = [v / math.hypot(*self.up) for v in self.up]
        row[kernels.ATTACHMENT_XYZ] = [v / math.hypot(*self.axis) for v in self.axis]


@register_table
class Distance(LengthSensor):
    """Straight distance from a fixed point to a point of the tool: range finder, or draw wire without a pulley."""

    kind: ClassVar[str] = "distance"
    own: ClassVar[tuple[str, ...]] = ("position_mm",)
    position_mm: tuple[Length, Length, Length]
    """Fixed point, base frame."""
    u_position_mm: NotNegative | None = None
    """Standard uncertainty of each coordinate of the fixed point; default: 0."""
    to: str
    """Point of the tool in `[tool]`."""

    def fill(self, rig: Instrument, channel: SensorChannel, row: FloatArray) -> None:
        """Write the kernels' row."""
        row[kernels.KIND], row[kernels.COUNT_LENGTH] = kernels.DISTANCE, self.per_count
        row[kernels.TURN_COUNTS] = self.counts_per_revolution
        row[kernels.ANGLE_ZERO], row[kernels.BASE_XYZ], row[kernels.ATTACHMENT_XYZ] = self.zero_value, self.position_mm, rig.tool[self.to]
