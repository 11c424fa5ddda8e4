"""Angle encoders of a rig: on the swivel pulleys, which turn with their cables, and of inclinometers on the tool."""

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from lmeasure.io import Name, Strict, Whole, whole

Degrees = Annotated[float, Field(ge=-360, le=360)]
SmallAngle = Annotated[float, Field(ge=0, le=360)]


def _has_length(value: tuple[float, float, float]) -> tuple[float, float, float]:
    if not 1e-6 < math.hypot(*value) < 1e6:
        raise ValueError("must have a length")
    return value


Way = Annotated[tuple[float, float, float], AfterValidator(_has_length)]


class AngleEncoder(Strict):
    """What encoders of angles have in common: count = count_sign (angle - zero) / 360 deg * counts_per_revolution, rounded; an absolute
    one shows it modulo its revolution, 0 .. counts_per_revolution - 1, an incremental one counts from where it was zeroed."""

    channel: Name
    """Its column in counts files."""
    counts_per_revolution: Annotated[Whole, Field(ge=4, le=2**32)]
    """Counts in a turn of the encoder."""
    count_sign: Annotated[Literal[1, -1], BeforeValidator(whole)] = 1
    """1 when the count rises with the angle, -1 when it falls."""
    absolute: bool = True
    """Whether it knows its angle at power-on; false: incremental, zero where the counter was zeroed."""
    zero_deg: Degrees | None = None
    """Angle at count 0 of an absolute encoder; absent: to be found."""
    u_zero_deg: SmallAngle | None = None
    """Its standard uncertainty; absent: 0 where zero_deg is given."""
    counter_bits: Annotated[Whole, Field(ge=8, le=64)] | None = None
    """Of an incremental one: after how many bits the counter starts again."""
    zero_exact: bool = False
    """Of an incremental one, as of drums."""
    max_speed_deg_s: Annotated[float, Field(gt=0, le=1e6)] = 3600.0
    """Beyond which a change of counts is no motion but a fault."""

    @model_validator(mode="after")
    def _zero_is_of_its_kind(self) -> Self:
        if self.absolute:
            for key in ("counter_bits", "zero_exact"):
                if getattr(self, key):
                    raise ValueError(f"{key}: is of incremental encoders; this one is absolute, and shows its angle modulo a revolution")
        elif self.zero_deg is not None or self.u_zero_deg is not None:
            raise ValueError("zero_deg: is of absolute encoders; an incremental one counts from where it was zeroed")
        if self.zero_deg is None and self.u_zero_deg is not None:
            raise ValueError("u_zero_deg: is the uncertainty of zero_deg, which is missing")
        return self

    @property
    def per_count(self) -> float:
        """Angle of a count [rad]."""
        return 2.0 * math.pi / self.counts_per_revolution

    @property
    def rate(self) -> float:
        """Largest rate of its count [1/s]."""
        return self.max_speed_deg_s / 360.0 * self.counts_per_revolution

    @property
    def rate_stated(self) -> bool:
        """Whether somebody said so."""
        return "max_speed_deg_s" in self.model_fields_set

    @property
    def scale(self) -> float:
        """Decoding factor, as drums have one."""
        return 1.0

    @property
    def codes(self) -> int | None:
        """How many values an absolute one has; None of an incremental one."""
        return self.counts_per_revolution if self.absolute else None


class Swivel(AngleEncoder):
    """An encoder of the angle by which the swivel pulley of an observation point is turned about the incoming cable.

    It reads angle + eccentricity sin(angle - phase), and backlash_deg is the width of the band in which a reading lies by the direction of
    the last turning.
    """

    point: Annotated[str, Field(min_length=1)]
    """Name of the observation point whose pulley turns."""
    cable: str | None = None
    """The cable that turns it, where several leave the point in one pass."""
    eccentricity_deg: Annotated[float, Field(ge=0, le=10)] | None = None
    """By how much a reading is off at most by an encoder that stands off its axis."""
    eccentricity_phase_deg: Degrees | None = None
    """Swivel angle from which on that error rises."""
    backlash_deg: Annotated[float, Field(ge=0, le=10)] | None = None
    """Width of the band in which a reading lies by the way it turned last."""

    @model_validator(mode="after")
    def _phase_is_of_something(self) -> Self:
        if self.eccentricity_phase_deg is not None and self.eccentricity_deg is None:
            raise ValueError("eccentricity_phase_deg: is the phase of eccentricity_deg, which is missing")
        return self


class Inclination(AngleEncoder):
    """One axis of an inclinometer on the tool: the angle of a sensing axis, tool frame, above the horizontal; an inclinometer of two axes
    is two of them."""

    axis: Way
    """The sensing axis in the tool frame, of any length."""
    up: Way = (0.0, 0.0, 1.0)
    """The way against gravity in the base frame."""
