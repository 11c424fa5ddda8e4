"""Tables of the sensors of this program other than cables: swivel encoders, inclinometers, straight distances."""

import math
from collections import Counter
from collections.abc import Iterator
from typing import Annotated, ClassVar

from pydantic import AfterValidator, Field, model_validator

from lmeasure import kernels
from lmeasure.core import FloatArray
from lmeasure.io import of_key
from lmeasure.rig.points_and_drums import Length, NotNegative
from lmeasure.rig.sensor_table import AngleSensor, Degrees, Instrument, LengthSensor, SensorChannel, register_table
from lmeasure.text import message


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
