"""The tables of rig.toml, each key with what it means: a drum, an observation point, a cable."""

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from lmeasure.core import conventions
from lmeasure.io import Name, Strict, Whole, whole


def _finite_length(value: float) -> float:
    if not abs(value) <= conventions.MAX_LENGTH_MM:
        raise ValueError(f"must be a length of at most {conventions.MAX_LENGTH_MM:.0f} mm")
    return value


LEAST_SCALE = 1e-6
GREATEST_PART = 0.1
"""Of what a drum or a pulley measures: an error beyond it is a slip of the pen."""


def _scale(value: float) -> float:
    if value < LEAST_SCALE:
        raise ValueError(f"must be at least {LEAST_SCALE:g}")
    return value


Length = Annotated[float, AfterValidator(_finite_length)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite_length)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_finite_length)]


Expansion = Annotated[float, Field(ge=-1e-3, le=1e-3)]
SmallTilt = Annotated[float, Field(ge=-10, le=10)]
Tension = Annotated[float, Field(gt=0, le=1e5)]


class CableOnDrum(Strict):
    """What temperature, tension and weight do to the cable of a drum; nothing where a key is not given. See `kernels.effects`."""

    cable_expansion_per_k: Expansion | None = None
    """Relative growth of the cable per kelvin: 16e-6 for steel rope."""
    drum_expansion_per_k: Expansion | None = None
    """Of the drum and the swivel pulley."""
    guide_length_mm: NotNegative | None = None
    """Cable from the fixed pulley's tangent point to B, which expands with the rest."""
    cable_stiffness_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """EA: tension over strain."""
    cable_mass_kg_per_m: Annotated[float, Field(ge=0, le=10)] | None = None
    """Mass of a metre of cable, by which it sags."""
    cable_tension_n: Tension | None = None
    """Tension that the drum keeps, at k = 0."""
    cable_tension_n_per_m: Annotated[float, Field(ge=-1e4, le=1e4)] | None = None
    """How it rises with the cable paid out."""
    winding_tension_n: Tension | None = None
    """Tension with which the cable was wound, when it was not the drum's own."""
    u_cable_expansion_per_k: NotNegative | None = None
    """Standard uncertainty of `cable_expansion_per_k`."""
    u_cable_stiffness_n: NotNegative | None = None
    """Standard uncertainty of `cable_stiffness_n`, at most half of it."""
    u_cable_mass_kg_per_m: NotNegative | None = None
    """Standard uncertainty of `cable_mass_kg_per_m`, at most half of it."""
    u_cable_tension_n: NotNegative | None = None
    """Standard uncertainty of `cable_tension_n`, at most half of it."""
    u_cable_tension_change_n: NotNegative | None = None
    """How far the tension may be from the drum's law at a moment: friction, which turns with the direction of travel."""

    @model_validator(mode="after")
    def _tension_is_given(self) -> Self:
        for key in ("cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n_per_m"):
            if getattr(self, key) is not None and self.cable_tension_n is None:
                raise ValueError(f"{key}: has an effect only with cable_tension_n, which is missing")
        if self.winding_tension_n is not None and self.cable_stiffness_n is None:
            raise ValueError("winding_tension_n: has an effect only with cable_stiffness_n, which is missing")
        for key in ("cable_expansion_per_k", "cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n"):
            if getattr(self, f"u_{key}") is not None and getattr(self, key) is None:
                raise ValueError(f"u_{key}: is the uncertainty of {key}, which is missing")
        for key in ("cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n"):
            value, u = getattr(self, key), getattr(self, f"u_{key}")
            if u is not None and u > 0.5 * value:
                raise ValueError(f"u_{key}: {u:g} is more than half of {key}, {value:g}: then its effect is not known at all")
        if self.u_cable_tension_change_n is not None and self.cable_stiffness_n is None:
            raise ValueError("u_cable_tension_change_n: has an effect only with cable_stiffness_n, which is missing")
        return self


class Drum(CableOnDrum):
    """A grooved drum with its encoder; `lmeasure drum` makes this table of what a mechanic measures."""

    UNTRUE: ClassVar[tuple[str, ...]] = ("run_out_mm", "cable_oversize_mm", "backlash_counts")
    counts_per_revolution: Annotated[Whole, Field(gt=0, le=2**32)]
    """Counts of the encoder in one turn of the drum (N)."""
    count_length_mm: Positive
    """Cable paid out along the groove by one count (c)."""
    groove_pitch_mm: Length
    """How far the place where the cable leaves the drum travels along the axis in a turn (t_m); positive when paying out lengthens
    `axial_offset_mm`."""
    tangent_length_mm: NotNegative
    """Cable from drum to fixed pulley, looked at along the drum's axis."""
    axial_offset_mm: Length
    """From where the cable leaves the drum to the plane of the fixed pulley, along the drum's axis, at k = 0."""
    count_sign: Annotated[Literal[1, -1], BeforeValidator(whole)] = 1
    """1 when the counter rises as cable is paid out, -1 when it falls."""
    scale: Annotated[float, Field(gt=0, le=1e6), AfterValidator(_scale)] = 1.0
    """Decoding factor: recorded count = count_sign * scale * k; 1 unless the counter is decoded at another resolution than it has."""
    zero_exact: bool = False
    """Whether k = 0 is exact. A counter is zeroed anywhere within a count: recorded = round(count_sign * scale * k + phase), the phase
    uniform within half a recorded count and one draw for all rows until the counter is zeroed again."""
    counter_bits: Annotated[Whole, Field(ge=8, le=64)] | None = None
    """After how many bits the counter starts again; absent: inferred from jumps, and noted."""
    braked: bool = False
    """Its winch stood still on purpose: a count that never changes is a reading, not a dead encoder."""
    max_cable_speed_mm_s: Positive = 20000.0
    """Beyond which a change of counts is no motion but a fault."""
    max_cable_acceleration_mm_s2: Positive | None = None
    """Beyond which a cable does not follow the tool: it went slack or is taut again."""
    u_scale: NotNegative | None = None
    """Standard uncertainty of `scale`, when it is solved for."""
    u_count_length_mm: NotNegative | None = None
    """Standard uncertainty of `count_length_mm`, at most half of it."""
    u_groove_pitch_mm: NotNegative | None = None
    """Standard uncertainty of `groove_pitch_mm`."""
    run_out_mm: tuple[Length, Length] | None = None
    """a and b, where the drum pays out a cos(2 pi k/N) + b sin(2 pi k/N) more than k counts: out of round, or off its axis; k from where
    `phase_length_mm` says."""
    cable_oversize_mm: Length | None = None
    """How much thicker the cable is than the one with which `count_length_mm` and `pulley_radius_mm` were stated."""
    backlash_counts: Length | None = None
    """Half the width of the band in which a reading lies by the way it was come from: the true count is s times it more than what is
    recorded, s = 1 while cable is paid out and -1 while it is wound in. Play of the encoder and friction along the cable."""
    u_run_out_mm: NotNegative | None = None
    """Of each of a and b, where the cable paid out errs by a cos(2 pi k/N) + b sin(2 pi k/N): a drum out of round or off its axis."""
    u_cable_oversize_mm: NotNegative | None = None
    """Standard uncertainty of `cable_oversize_mm`."""
    u_backlash_counts: NotNegative | None = None
    """Of half the width of the band in which a reading lies by the way it was come from: play between drum and encoder."""
    u_friction_counts: NotNegative | None = None
    """The same of friction, which stretches the cable one way or the other."""
    u_tangent_length_mm: NotNegative | None = None
    """Standard uncertainty of `tangent_length_mm`."""
    u_axial_offset_mm: NotNegative | None = None
    """Standard uncertainty of `axial_offset_mm`."""

    @model_validator(mode="after")
    def _groove_is_shallow(self) -> Self:
        turn = self.counts_per_revolution * self.count_length_mm
        if abs(self.groove_pitch_mm) >= turn:
            raise ValueError(f"groove_pitch_mm: must be less than the cable of one turn, {turn:g} mm")
        for key, value in (
            ("run_out_mm", math.hypot(*self.run_out_mm or (0.0, 0.0))),
            ("cable_oversize_mm", self.cable_oversize_mm or 0.0),
        ):
            if abs(value) > GREATEST_PART * turn / math.pi:
                raise ValueError(f"{key}: {value:g} is more than a tenth of the drum's diameter, {turn / math.pi:.4g} mm: no drum is so")
        if self.u_count_length_mm is not None and self.u_count_length_mm > 0.5 * self.count_length_mm:
            raise ValueError(
                f"u_count_length_mm: {self.u_count_length_mm:g} is more than half of count_length_mm, {self.count_length_mm:g}: "
                "then no length is known at all"
            )
        return self

    @model_serializer(mode="wrap")
    def _without_what_is_so_by_default(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        # rigs written before, and digests of them, do not have these keys
        return {key: value for key, value in handler(self).items() if key not in {"zero_exact", "braked"} or value}

    @property
    def rate(self) -> float:
        """Largest rate of its recorded count [1/s], at the largest cable speed."""
        return self.max_cable_speed_mm_s / self.count_length_mm * self.scale

    @property
    def rate_stated(self) -> bool:
        """Whether somebody said so."""
        return "max_cable_speed_mm_s" in self.model_fields_set

    @property
    def per_count(self) -> float:
        """Length of a true count [mm]."""
        return self.count_length_mm

    @property
    def codes(self) -> None:
        """It has no absolute codes."""

    @property
    def absolute(self) -> bool:
        """It counts from where it was zeroed."""
        return False

    @property
    def is_length(self) -> bool:
        """It counts a length."""
        return True

    @property
    def u_reading(self) -> float:
        """A length has no noise besides the rounding of its count."""
        return 0.0

    @property
    def rate_key(self) -> str:
        """The key of the largest speed."""
        return "max_cable_speed_mm_s"

    @property
    def speed_per_count(self) -> float:
        """What a recorded count per second is in mm/s."""
        return self.count_length_mm / self.scale

    @property
    def axial_per_count_mm(self) -> float:
        """Axial travel of the pay-out point per count [mm]."""
        return self.groove_pitch_mm / self.counts_per_revolution


class ObservationPoint(Strict):
    """A fixed point B with its swivel pulley and drum."""

    UNTRUE: ClassVar[tuple[str, ...]] = ("pulley_eccentricity_mm", "swivel_offset_mm")
    name: Name
    """By which cables, `assumed` and reports call it."""
    position_mm: tuple[Length, Length, Length]
    """B in the robot's base frame: where the swivel axis touches the pulley's groove, and the cable comes up to it."""
    guide_alpha_deg: Annotated[float, Field(ge=-90, le=90)]
    """Inclination below the horizontal of the way from B to the fixed pulley."""
    guide_beta_deg: Annotated[float, Field(ge=-360, le=360)]
    """From +Y to that way's horizontal projection, positive towards +X."""
    pulley_radius_mm: NotNegative
    """Radius R of the swivel pulley to the middle of the cable; 0 means a straight cable from B."""
    drum: Drum
    """Its drum, a table `[observation_point.drum]`."""
    u_position_mm: NotNegative | None = None
    """Standard uncertainty of each coordinate of B, where it is better or worse known than the usual 30 mm."""
    u_guide_deg: NotNegative | None = None
    """Standard uncertainty of the guide's angles, where it is not the usual 5 degrees; beta's is more where steeper than 60 degrees."""
    u_pulley_radius_mm: NotNegative | None = None
    """Standard uncertainty of `pulley_radius_mm`."""
    pulley_eccentricity_mm: tuple[Length, Length] | None = None
    """Way from the swivel pulley's axle to the centre of its groove, in the pulley's plane: along the cable's travel at B and away from the
    swivel axis, as the pulley stands where `phase_length_mm` says."""
    swivel_offset_mm: Length | None = None
    """How much farther from the swivel axis the pulley's centre is than its radius: the axis does not touch the groove."""
    swivel_tilt_deg: tuple[SmallTilt, SmallTilt] | None = None
    """By which the swivel axis is off the incoming cable, added to `guide_alpha_deg` and `guide_beta_deg`."""
    phase_length_mm: NotNegative | None = None
    """Cable from B to the attachment point with which drum and pulley stand as `run_out_mm` and `pulley_eccentricity_mm` say; absent:
    where the counter was zeroed. It holds until the cable is taken off the drum or the pulley."""
    u_swivel_offset_mm: NotNegative | None = None
    """Standard uncertainty of `swivel_offset_mm`."""
    u_swivel_tilt_deg: NotNegative | None = None
    """Standard uncertainty of each of `swivel_tilt_deg`."""
    u_pulley_eccentricity_mm: NotNegative | None = None
    """Of each of two components of the way from the swivel pulley's axle to the centre of its groove."""

    @model_validator(mode="after")
    def _turns_about_an_axle(self) -> Self:
        if self.u_pulley_eccentricity_mm and self.u_pulley_eccentricity_mm > 0.5 * self.pulley_radius_mm:
            raise ValueError(
                f"u_pulley_eccentricity_mm: {self.u_pulley_eccentricity_mm:g} is more than half of pulley_radius_mm, "
                f"{self.pulley_radius_mm:g}: no pulley turns so"
            )
        given = (("pulley_eccentricity_mm", self.pulley_eccentricity_mm or (0.0,)), ("swivel_offset_mm", (self.swivel_offset_mm or 0.0,)))
        for key, values in given:
            size = math.hypot(*values)
            if size > 0.5 * self.pulley_radius_mm:
                raise ValueError(f"{key}: {size:g} is more than half of pulley_radius_mm, {self.pulley_radius_mm:g}: no pulley turns so")
        return self


class Cable(Strict):
    """A cable from an observation point to an attachment point, counted by a channel in one pass of the motion."""

    name: Name
    """By which reports call it."""
    channel: Name
    """Its counter's column in counts files; a channel may serve one cable per pass."""
    from_point: Annotated[str, Field(alias="from")]
    """Name of its observation point."""
    to_point: Annotated[str, Field(alias="to")]
    """Name of its attachment point in `[tool]`."""
    passage: Annotated[Whole, Field(alias="pass", ge=1, le=1000)] = 1
    """Which repetition of the motion it is counted in."""
    is_cable: ClassVar[bool] = True
    kind: ClassVar[str] = "cable"
    is_length: ClassVar[bool] = True
