"""The tables of rig.toml, each key with its meaning: a drum, an observation point, a cable."""

import math
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, SerializerFunctionWrapHandler, model_serializer, model_validator

from lmeasure.core import conventions
from lmeasure.io import Name, Strict, Whole, of_key, whole
from lmeasure.text import message


def _finite_length(value: float) -> float:
    if not abs(value) <= conventions.MAX_LENGTH_MM:
        raise ValueError(message("error.must_be_a_length_of", max_length_mm=conventions.MAX_LENGTH_MM))
    return value


LEAST_SCALE = 1e-6
GREATEST_PART = 0.1  # Relative to the size of a drum or a pulley: a larger error is a typing mistake


def _scale(value: float) -> float:
    if value < LEAST_SCALE:
        raise ValueError(message("error.must_be_at_least", least_scale=LEAST_SCALE))
    return value


Length = Annotated[float, AfterValidator(_finite_length)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite_length)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_finite_length)]


Expansion = Annotated[float, Field(ge=-1e-3, le=1e-3)]
SmallTilt = Annotated[float, Field(ge=-10, le=10)]
Tension = Annotated[float, Field(gt=0, le=1e5)]


class CableOnDrum(Strict):
    """Effects of temperature, tension and weight on the cable of a drum; an omitted key has no effect. See `kernels.effects`."""

    cable_expansion_per_k: Expansion | None = None
    """Thermal expansion coefficient of the cable; 16e-6 for steel rope."""
    drum_expansion_per_k: Expansion | None = None
    """Thermal expansion coefficient of the drum and the swivel pulley."""
    guide_length_mm: NotNegative | None = None
    """Cable length from the fixed pulley's tangent point to B, which also expands and stretches."""
    cable_stiffness_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """Axial stiffness EA of the cable: tension divided by strain."""
    cable_mass_kg_per_m: Annotated[float, Field(ge=0, le=10)] | None = None
    """Mass of the cable per metre, for its sag."""
    cable_tension_n: Tension | None = None
    """Tension of the cable at the zero pose (k = 0)."""
    cable_tension_n_per_m: Annotated[float, Field(ge=-1e4, le=1e4)] | None = None
    """Increase of the tension per metre of cable paid out."""
    winding_tension_n: Tension | None = None
    """Tension at which the cable was wound; default: the tension of the drum."""
    u_cable_expansion_per_k: NotNegative | None = None
    """Standard uncertainty of `cable_expansion_per_k`."""
    u_cable_stiffness_n: NotNegative | None = None
    """Standard uncertainty of `cable_stiffness_n`, at most half of it."""
    u_cable_mass_kg_per_m: NotNegative | None = None
    """Standard uncertainty of `cable_mass_kg_per_m`, at most half of it."""
    u_cable_tension_n: NotNegative | None = None
    """Standard uncertainty of `cable_tension_n`, at most half of it."""
    u_cable_tension_change_n: NotNegative | None = None
    """Standard uncertainty of the momentary tension, from friction that reverses with the direction of travel."""

    @model_validator(mode="after")
    def _tension_is_given(self) -> Self:
        for key in ("cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n_per_m"):
            if getattr(self, key) is not None and self.cable_tension_n is None:
                raise of_key(key, message("error.has_an_effect_only_with"))
        if self.winding_tension_n is not None and self.cable_stiffness_n is None:
            raise of_key("winding_tension_n", message("error.has_an_effect_only"))
        for key in ("cable_expansion_per_k", "cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n"):
            if getattr(self, f"u_{key}") is not None and getattr(self, key) is None:
                raise of_key(f"u_{key}", message("error.is_the_uncertainty_of", key=key))
        for key in ("cable_stiffness_n", "cable_mass_kg_per_m", "cable_tension_n"):
            value, u = getattr(self, key), getattr(self, f"u_{key}")
            if u is not None and u > 0.5 * value:
                raise of_key(f"u_{key}", message("error.is_half_of_its_value", key=key, u=u, value=value))
        if self.u_cable_tension_change_n is not None and self.cable_stiffness_n is None:
            raise of_key("u_cable_tension_change_n", message("error.has_an_effect_only"))
        return self


class Drum(CableOnDrum):
    """Grooved drum with its encoder. `lmeasure drum` computes this table from measured dimensions."""

    UNTRUE: ClassVar[tuple[str, ...]] = ("run_out_mm", "cable_oversize_mm", "backlash_counts")
    own: ClassVar[tuple[str, ...]] = ()
    zero: ClassVar[str] = ""
    zero_u: ClassVar[float] = 0.0
    counts_per_revolution: Annotated[Whole, Field(gt=0, le=2**32)]
    """Encoder counts per turn of the drum (N)."""
    count_length_mm: Positive
    """Cable length per count, along the groove (c)."""
    groove_pitch_mm: Length
    """Axial travel of the pay-out point per turn (t_m); positive if paying out increases `axial_offset_mm`."""
    tangent_length_mm: NotNegative
    """Cable length from drum to fixed pulley, projected along the drum's axis."""
    axial_offset_mm: Length
    """Axial distance from the pay-out point to the plane of the fixed pulley, at `zero_length_mm` of the cable (default: k = 0)."""
    count_sign: Annotated[Literal[1, -1], BeforeValidator(whole)] = 1
    """1: the count rises as cable is paid out; -1: it falls."""
    scale: Annotated[float, Field(gt=0, le=1e6), AfterValidator(_scale)] = 1.0
    """Decoding factor: recorded count = count_sign * scale * k. It is 1 if the decoder keeps the encoder's resolution."""
    zero_exact: bool = False
    """true: k = 0 is exact. Default: an unknown sub-count offset at zeroing, uniform within half a recorded count."""
    counter_bits: Annotated[Whole, Field(ge=8, le=64)] | None = None
    """Width of the counter, after which it wraps around; default: inferred from jumps, with a note."""
    braked: bool = False
    """true: the winch is locked, so a constant count is a valid reading and not a dead encoder."""
    max_cable_speed_mm_s: Positive = 20000.0
    """Largest cable speed; faster changes of the count are faults."""
    max_cable_acceleration_mm_s2: Positive | None = None
    """Largest acceleration of a taut cable; beyond it the cable went slack or became taut again."""
    u_scale: NotNegative | None = None
    """Standard uncertainty of `scale`, if calibration solves for it."""
    u_count_length_mm: NotNegative | None = None
    """Standard uncertainty of `count_length_mm`, at most half of it."""
    u_groove_pitch_mm: NotNegative | None = None
    """Standard uncertainty of `groove_pitch_mm`."""
    run_out_mm: tuple[Length, Length] | None = None
    """Run-out [a, b]: the drum pays out a cos(2 pi k/N) + b sin(2 pi k/N) more cable; phase from `phase_length_mm`."""
    cable_oversize_mm: Length | None = None
    """Cable diameter minus the diameter assumed in `count_length_mm` and `pulley_radius_mm`."""
    backlash_counts: Length | None = None
    """Half the dead band from play and friction: true minus recorded count while cable is paid out."""
    u_run_out_mm: NotNegative | None = None
    """Standard uncertainty of each of a and b in `run_out_mm`."""
    u_cable_oversize_mm: NotNegative | None = None
    """Standard uncertainty of `cable_oversize_mm`."""
    u_backlash_counts: NotNegative | None = None
    """Standard uncertainty of `backlash_counts` from play between drum and encoder."""
    u_friction_counts: NotNegative | None = None
    """Standard uncertainty of `backlash_counts` from friction, which stretches the cable by the direction of travel."""
    u_tangent_length_mm: NotNegative | None = None
    """Standard uncertainty of `tangent_length_mm`."""
    u_axial_offset_mm: NotNegative | None = None
    """Standard uncertainty of `axial_offset_mm`."""

    @model_validator(mode="after")
    def _groove_is_shallow(self) -> Self:
        turn = self.counts_per_revolution * self.count_length_mm
        if abs(self.groove_pitch_mm) >= turn:
            raise of_key("groove_pitch_mm", message("error.must_be_less_than", n=turn))
        for key, value in (
            ("run_out_mm", math.hypot(*self.run_out_mm or (0.0, 0.0))),
            ("cable_oversize_mm", self.cable_oversize_mm or 0.0),
        ):
            if abs(value) > GREATEST_PART * turn / math.pi:
                raise of_key(key, message("error.is_more_than_a", value=value, turn=turn / math.pi))
        if self.u_count_length_mm is not None and self.u_count_length_mm > 0.5 * self.count_length_mm:
            sizes = {"u_count_length_mm": self.u_count_length_mm, "count_length_mm": self.count_length_mm}
            raise of_key("u_count_length_mm", message("error.is_more_than_half", **sizes))
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
        """Return whether the rate is stated."""
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
        """Return mm/s per recorded count per second."""
        return self.count_length_mm / self.scale

    @property
    def axial_per_count_mm(self) -> float:
        """Axial travel of the pay-out point per count [mm]."""
        return self.groove_pitch_mm / self.counts_per_revolution


class ObservationPoint(Strict):
    """Fixed point B with its swivel pulley and drum."""

    UNTRUE: ClassVar[tuple[str, ...]] = ("pulley_eccentricity_mm", "swivel_offset_mm")
    name: Name
    """Name in cables, `assumed` and reports."""
    position_mm: tuple[Length, Length, Length]
    """Point B, base frame: contact of the swivel axis with the pulley's groove, where the cable arrives."""
    guide_alpha_deg: Annotated[float, Field(ge=-90, le=90)]
    """Inclination below the horizontal of the path from B to the fixed pulley."""
    guide_beta_deg: Annotated[float, Field(ge=-360, le=360)]
    """Angle from +Y to the horizontal projection of that path, positive towards +X, base frame."""
    pulley_radius_mm: NotNegative
    """Radius R of the swivel pulley to the middle of the cable; 0: a straight cable from B."""
    drum: Drum
    """Drum, a table `[observation_point.drum]`."""
    u_position_mm: NotNegative | None = None
    """Standard uncertainty of each coordinate of B; default: 30 mm."""
    u_guide_deg: NotNegative | None = None
    """Standard uncertainty of the guide's angles; default: 5°. For beta it grows above 60° of inclination."""
    u_pulley_radius_mm: NotNegative | None = None
    """Standard uncertainty of `pulley_radius_mm`."""
    pulley_eccentricity_mm: tuple[Length, Length] | None = None
    """Eccentricity of the groove: along the cable's travel at B, and away from the swivel axis; phase from `phase_length_mm`."""
    swivel_offset_mm: Length | None = None
    """Distance of the pulley's centre from the swivel axis, minus its radius; 0: the axis touches the groove."""
    swivel_tilt_deg: tuple[SmallTilt, SmallTilt] | None = None
    """Deviation of the swivel axis from the incoming cable, added to `guide_alpha_deg` and `guide_beta_deg`."""
    phase_length_mm: NotNegative | None = None
    """Cable length from B to the attachment point at phase 0 of run-out and eccentricity; default: at the zero pose."""
    u_swivel_offset_mm: NotNegative | None = None
    """Standard uncertainty of `swivel_offset_mm`."""
    u_swivel_tilt_deg: NotNegative | None = None
    """Standard uncertainty of each angle of `swivel_tilt_deg`."""
    u_pulley_eccentricity_mm: NotNegative | None = None
    """Standard uncertainty of each component of `pulley_eccentricity_mm`."""

    @model_validator(mode="after")
    def _turns_about_an_axle(self) -> Self:
        if self.u_pulley_eccentricity_mm and self.u_pulley_eccentricity_mm > 0.5 * self.pulley_radius_mm:
            sizes = {"u_pulley_eccentricity_mm": self.u_pulley_eccentricity_mm, "pulley_radius_mm": self.pulley_radius_mm}
            raise of_key("u_pulley_eccentricity_mm", message("error.is_more_than_half_of", **sizes))
        given = (("pulley_eccentricity_mm", self.pulley_eccentricity_mm or (0.0,)), ("swivel_offset_mm", (self.swivel_offset_mm or 0.0,)))
        for key, values in given:
            size = math.hypot(*values)
            if size > 0.5 * self.pulley_radius_mm:
                sizes = {"u_pulley_eccentricity_mm": size, "pulley_radius_mm": self.pulley_radius_mm}
                raise of_key(key, message("error.is_more_than_half_of", **sizes))
        return self


class Cable(Strict):
    """Cable from an observation point to an attachment point, counted by one channel in one pass of the motion."""

    name: Name
    """Name of the cable in reports."""
    channel: Name
    """Column of its counter in counts files; one cable per channel and pass."""
    from_point: Annotated[str, Field(alias="from")]
    """Observation point of the cable."""
    to_point: Annotated[str, Field(alias="to")]
    """Attachment point of the cable in `[tool]`."""
    passage: Annotated[Whole, Field(alias="pass", ge=1, le=1000)] = 1
    """Pass of the motion that counts the cable."""
    zero_length_mm: NotNegative | None = None
    """Cable length from B to the attachment point at which `axial_offset_mm` and `cable_tension_n` hold; default: at the zero pose."""
    is_cable: ClassVar[bool] = True
    kind: ClassVar[str] = "cable"
    is_length: ClassVar[bool] = True
