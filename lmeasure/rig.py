"""The rig: observation points, drums, attachment points and cables, exactly as rig.toml writes them."""

import difflib
import math
from collections import Counter
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    Field,
    SerializerFunctionWrapHandler,
    model_serializer,
    model_validator,
)

from lmeasure import conventions, files
from lmeasure.arrays import FloatArray, IntArray
from lmeasure.can_table import CAN_TABLES, CanOpenCan, CanTable, DbcCan, J1939Can, RawCan, check_channels, default_can
from lmeasure.checked import Name, Strict, Whole, checked, whole
from lmeasure.errors import RigError
from lmeasure.kernels import layout
from lmeasure.shown import DataFrame, Shown, framed

Vector = tuple[float, float, float]

CABLES_FOR_A_POSE = 6


def _finite_length(value: float) -> float:
    if not abs(value) <= conventions.MAX_LENGTH_MM:
        raise ValueError(f"must be a length of at most {conventions.MAX_LENGTH_MM:.0f} mm")
    return value


def _one_line(value: str) -> str:
    if not value.isprintable():
        raise ValueError("must be one line of printable text")
    return value


LEAST_SCALE = 1e-6


def _scale(value: float) -> float:
    if value < LEAST_SCALE:
        raise ValueError(f"is {value:g}; {LEAST_SCALE:g} is the least")
    return value


Length = Annotated[float, AfterValidator(_finite_length)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_finite_length)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_finite_length)]


Expansion = Annotated[float, Field(ge=-1e-3, le=1e-3)]
Tension = Annotated[float, Field(gt=0, le=1e5)]


class CableOnDrum(Strict):
    """What temperature, tension and weight do to the cable of a drum; nothing where a key is not given. See `kernels.effects`."""

    cable_expansion_per_k: Expansion | None = None
    drum_expansion_per_k: Expansion | None = None
    """Of the drum and the swivel pulley."""
    guide_length_mm: NotNegative | None = None
    """Cable from the fixed pulley's tangent point to B, which expands with the rest."""
    cable_stiffness_n: Annotated[float, Field(gt=0, le=1e9)] | None = None
    """EA: tension over strain."""
    cable_mass_kg_per_m: Annotated[float, Field(ge=0, le=10)] | None = None
    cable_tension_n: Tension | None = None
    """Tension that the drum keeps, at k = 0."""
    cable_tension_n_per_m: Annotated[float, Field(ge=-1e4, le=1e4)] | None = None
    """How it rises with the cable paid out."""
    winding_tension_n: Tension | None = None
    """Tension with which the cable was wound, when it was not the drum's own."""
    u_cable_expansion_per_k: NotNegative | None = None
    u_cable_stiffness_n: NotNegative | None = None
    u_cable_mass_kg_per_m: NotNegative | None = None
    u_cable_tension_n: NotNegative | None = None
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
    """A grooved drum with its encoder. Lengths in mm; see the contract of rig.toml for each."""

    counts_per_revolution: Annotated[Whole, Field(gt=0, le=2**32)]
    count_length_mm: Positive
    groove_pitch_mm: Length
    tangent_length_mm: NotNegative
    axial_offset_mm: Length
    count_sign: Annotated[Literal[1, -1], BeforeValidator(whole)] = 1
    scale: Annotated[float, Field(gt=0, le=1e6), AfterValidator(_scale)] = 1.0
    """Decoding factor: recorded count = count_sign * scale * k."""
    zero_exact: bool = False
    """Whether k = 0 is exact. A counter is zeroed anywhere within a count: recorded = round(count_sign * scale * k + phase), the phase
    uniform within half a recorded count and one draw for all rows until the counter is zeroed again."""
    counter_bits: Annotated[Whole, Field(ge=8, le=64)] | None = None
    braked: bool = False
    """Its winch stood still on purpose: a count that never changes is a reading, not a dead encoder."""
    max_cable_speed_mm_s: Positive = 20000.0
    max_cable_acceleration_mm_s2: Positive | None = None
    """Beyond which a cable does not follow the tool: it went slack or is taut again."""
    u_scale: NotNegative | None = None
    u_count_length_mm: NotNegative | None = None
    u_groove_pitch_mm: NotNegative | None = None
    u_run_out_mm: NotNegative | None = None
    """Of each of a and b, where the cable paid out errs by a cos(2 pi k/N) + b sin(2 pi k/N): a drum out of round or off its axis."""
    u_backlash_counts: NotNegative | None = None
    """Of half the width of the band in which a reading lies by the way it was come from: play between drum and encoder."""
    u_friction_counts: NotNegative | None = None
    """The same of friction, which stretches the cable one way or the other."""
    u_tangent_length_mm: NotNegative | None = None
    u_axial_offset_mm: NotNegative | None = None

    @model_validator(mode="after")
    def _groove_is_shallow(self) -> Self:
        turn = self.counts_per_revolution * self.count_length_mm
        if abs(self.groove_pitch_mm) >= turn:
            raise ValueError(f"groove_pitch_mm: must be less than the cable of one turn, {turn:g} mm")
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
    def axial_per_count_mm(self) -> float:
        """Axial travel of the pay-out point per count [mm]."""
        return self.groove_pitch_mm / self.counts_per_revolution


class ObservationPoint(Strict):
    """A fixed point B with its swivel pulley and drum. position_mm in the robot's base frame."""

    name: Name
    position_mm: tuple[Length, Length, Length]
    guide_alpha_deg: Annotated[float, Field(ge=-90, le=90)]
    guide_beta_deg: Annotated[float, Field(ge=-360, le=360)]
    pulley_radius_mm: NotNegative
    drum: Drum
    u_position_mm: NotNegative | None = None
    u_guide_deg: NotNegative | None = None
    u_pulley_radius_mm: NotNegative | None = None
    u_pulley_eccentricity_mm: NotNegative | None = None
    """Of each of two components of the way from the swivel pulley's axle to the centre of its groove."""

    @model_validator(mode="after")
    def _turns_about_an_axle(self) -> Self:
        if self.u_pulley_eccentricity_mm and self.u_pulley_eccentricity_mm > 0.5 * self.pulley_radius_mm:
            raise ValueError(
                f"u_pulley_eccentricity_mm: {self.u_pulley_eccentricity_mm:g} is more than half of pulley_radius_mm, "
                f"{self.pulley_radius_mm:g}: no pulley turns so"
            )
        return self


class Cable(Strict):
    """A cable from an observation point to an attachment point, counted by a channel in one pass of the motion."""

    name: Name
    channel: Name
    from_point: Annotated[str, Field(alias="from")]
    to_point: Annotated[str, Field(alias="to")]
    passage: Annotated[Whole, Field(alias="pass", ge=1, le=1000)] = 1


class Rig(Shown, Strict):
    """A rig as rig.toml states it. Frozen; `cable_rows` gives the kernels' arrays."""

    schema_: Annotated[Literal["lmeasure.rig/1"], Field(alias="schema")] = "lmeasure.rig/1"
    name: Annotated[str, Field(min_length=1, max_length=200), AfterValidator(_one_line)]
    angles: str = conventions.DEFAULT
    assumed: tuple[str, ...] = ()
    calibration: str | None = None
    constraint: Literal["planar", "vertical-axis"] | None = None
    """What holds the tool where fewer than six cables measure it; see `trajectory.scheme`."""
    side: tuple[float, float, float] | None = None
    """Direction in which the tool lies from the middle of the observation points: tells assemblies apart where a run gives lengths."""
    frame_expansion_per_k: Expansion | None = None
    """Of what carries the observation points and drums, from the base frame's origin."""
    reference_temperature_c: Annotated[float, Field(ge=-100, le=200)] | None = None
    """Temperature at which the rig has the dimensions stated here; 20 where it is not given (ISO 1)."""
    u_frame_expansion_per_k: NotNegative | None = None
    u_temperature_k: NotNegative | None = None
    """Standard uncertainty of a temperature: of the parts against the thermometer."""
    u_attachment_mm: NotNegative | None = None
    """Of each coordinate of every attachment point in the tool frame."""
    observation_point: Annotated[tuple[ObservationPoint, ...], Field(min_length=1)]
    tool: Annotated[dict[Name, tuple[Length, Length, Length]], Field(min_length=1)]
    cable: Annotated[tuple[Cable, ...], Field(min_length=1)]
    can: CanTable | None = None

    def about(self) -> dict[str, str]:
        """Name, cables, points, calibration."""
        passes = f" in {self.passes} passes" if self.passes > 1 else ""
        assumed = {"assumed": ", ".join(self.assumed)} if self.assumed else {}
        linked = "none" if self.calibration is None else self.calibration
        points = ", ".join(p.name for p in self.observation_point)
        return {"name": self.name, "cables": f"{len(self.cable)}{passes}", "observation points": points, "calibration": linked} | assumed

    def to_frame(self) -> DataFrame:
        """A row for each cable: its ends, its observation point, guide and pulley."""
        rows = []
        for cable in self.cable:
            point = self.point(cable.from_point)
            rows.append(
                {"cable": cable.name, "channel": cable.channel, "pass": cable.passage, "from": cable.from_point, "to": cable.to_point}
                | dict(zip(("x_mm", "y_mm", "z_mm"), point.position_mm, strict=True))
                | {name: getattr(point, name) for name in ("guide_alpha_deg", "guide_beta_deg", "pulley_radius_mm")}
                | {"count_length_mm": point.drum.count_length_mm}
            )
        return framed(rows)

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if self.angles not in conventions.CONVENTIONS:
            raise ValueError(f"angles: {self.angles!r} is not one of {', '.join(conventions.CONVENTIONS)}")
        for kind, names in (
            ("observation_point", [p.name for p in self.observation_point]),
            ("cable", [c.name for c in self.cable]),
        ):
            for name, times in Counter(names).items():
                if times > 1:
                    raise ValueError(f"{kind}: the name {name!r} is given {times} times")
        points = [p.name for p in self.observation_point]
        for c in self.cable:
            if c.channel in conventions.RESERVED_COLUMNS:
                raise ValueError(f"cable {c.name}: channel = {c.channel!r} is the name of another column of counts files")
            if c.from_point not in points:
                raise ValueError(f"cable {c.name}: from = {c.from_point!r} is no observation_point ({', '.join(points)})")
            if c.to_point not in self.tool:
                raise ValueError(f"cable {c.name}: to = {c.to_point!r} is no point of [tool] ({', '.join(self.tool)})")
        for (channel, passage), times in Counter((c.channel, c.passage) for c in self.cable).items():
            if times > 1:
                raise ValueError(f"cable: channel = {channel!r} serves {times} cables in pass {passage}; one cable per pass")
        passes = {c.passage for c in self.cable}
        if passes != set(range(1, len(passes) + 1)):
            raise ValueError(f"cable: the passes are {sorted(passes)}; they must be numbered from 1 without a hole")
        if self.can is not None:
            check_channels(self.can, set(self.channels))
        known = set(self.parameter_names())
        for name in self.assumed:
            if name not in known:
                close = difflib.get_close_matches(name, known, n=1)
                hint = f"; did you mean {close[0]!r}?" if close else ""
                raise ValueError(f"assumed: {name!r} names no value of this rig{hint}")
        return self

    def parameter_names(self) -> list[str]:
        """Names that `assumed` may hold: `<observation point>.<key>`, drum keys included, and `<attachment point>`."""
        keys = [k for k in ObservationPoint.model_fields if k not in {"name", "drum"} and not k.startswith("u_")]
        keys += [k for k in Drum.model_fields if not k.startswith("u_") and k != "zero_exact"]
        return [f"{p.name}.{k}" for p in self.observation_point for k in keys] + list(self.tool)

    def point(self, name: str) -> ObservationPoint:
        """The observation point of that name."""
        return next(p for p in self.observation_point if p.name == name)

    @property
    def passes(self) -> int:
        """How many passes of the motion the cables need."""
        return max(c.passage for c in self.cable)

    @property
    def channels(self) -> tuple[str, ...]:
        """The counter channels of the cables, each once, in the cables' order."""
        return tuple(dict.fromkeys(c.channel for c in self.cable))

    def drums_of(self, passage: int = 1) -> dict[str, Drum]:
        """The drum that each channel counts in one pass."""
        return {c.channel: self.point(c.from_point).drum for c in self.cables_of(passage)}

    @property
    def can_table(self) -> RawCan | DbcCan | CanOpenCan | J1939Can:
        """The `[can]` table, or the default frames of CiA 406 encoders."""
        return self.can or default_can(self.channels)

    def cables_of(self, passage: int) -> tuple[Cable, ...]:
        """The cables measured in one pass."""
        return tuple(c for c in self.cable if c.passage == passage)

    def cable_rows(self, cables: tuple[Cable, ...] | None = None) -> FloatArray:
        """(m, columns) rows of the kernels (`lmeasure.kernels.layout`) for the given cables, default all: mm and rad, B and u in the base
        frame, P in the tool frame."""
        rows = np.empty((len(self.cable if cables is None else cables), layout.CABLE_COLUMNS))
        for row, c in zip(rows, self.cable if cables is None else cables, strict=True):
            p = self.point(c.from_point)
            a, b = math.radians(p.guide_alpha_deg), math.radians(p.guide_beta_deg)
            row[layout.BASE_XYZ] = p.position_mm
            row[layout.GUIDE_XYZ] = (-math.cos(a) * math.sin(b), -math.cos(a) * math.cos(b), math.sin(a))
            row[layout.RADIUS] = p.pulley_radius_mm
            row[layout.ATTACHMENT_XYZ] = self.tool[c.to_point]
            row[layout.TANGENT], row[layout.AXIAL] = p.drum.tangent_length_mm, p.drum.axial_offset_mm
            row[layout.TRAVEL], row[layout.COUNT_LENGTH] = p.drum.axial_per_count_mm, p.drum.count_length_mm
            row[layout.ALPHA], row[layout.BETA], row[layout.TURN_COUNTS] = a, b, p.drum.counts_per_revolution
        return rows

    def scales(self, cables: tuple[Cable, ...] | None = None) -> FloatArray:
        """(m,) decoding scales of the cables' counters."""
        return np.array([self.point(c.from_point).drum.scale for c in (self.cable if cables is None else cables)])

    def zeroings(self, cables: tuple[Cable, ...] | None = None) -> IntArray:
        """(m,) which zeroing of a counter each cable is counted from, numbered from 0 in the order of the cables, default all.

        A channel that leads the same cable, from and to, in passes that follow one another on it is taken not to be zeroed again between
        them. To lead another it has to be taken off at the start pose, fastened there and zeroed.
        """
        zeroing: dict[tuple[str, int], int] = {}
        led: dict[str, tuple[str, str, int]] = {}
        for c in sorted(self.cable, key=lambda c: c.passage):
            before = led.get(c.channel)
            same = before is not None and before[:2] == (c.from_point, c.to_point)
            led[c.channel] = c.from_point, c.to_point, before[2] if before is not None and same else c.passage
            zeroing[c.channel, c.passage] = led[c.channel][2]
        begun = [(c.channel, zeroing[c.channel, c.passage]) for c in (self.cable if cables is None else cables)]
        number = {key: i for i, key in enumerate(dict.fromkeys(begun))}
        return np.array([number[key] for key in begun], dtype=np.int64)

    def require_pose(self, redundant: bool = False) -> None:
        """RigError unless the cables can tell a whole pose: six of them, or more where these are welcome, to attachment points that do not
        lie on one line."""
        if len(self.cable) < CABLES_FOR_A_POSE or (len(self.cable) > CABLES_FOR_A_POSE and not redundant):
            raise RigError(
                f"rig {self.name!r}: has {len(self.cable)} cables; a pose is reconstructed from "
                f"{'at least' if redundant else 'exactly'} {CABLES_FOR_A_POSE}, "
                "in one pass or in several"
            )
        self.require_spread()

    def require_spread(self) -> None:
        """RigError when the attachment points lie on one line: no cable sees a turn about it."""
        used = sorted({c.to_point for c in self.cable})
        points = np.array([self.tool[name] for name in used])
        spread = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
        if len(used) < 3 or spread[1] < 1e-6 * max(spread[0], 1e-9) or spread[1] < 1e-3:
            raise RigError(
                f"rig {self.name!r}: tool: the attachment points {', '.join(used)} lie on one line; the orientation cannot be measured"
            )

    def without_effects(self) -> Self:
        """The rig with cables of fixed length: nothing stated of temperature, tension and weight."""
        nothing: dict[str, None] = dict.fromkeys(CableOnDrum.model_fields)
        points = tuple(p.model_copy(update={"drum": p.drum.model_copy(update=nothing)}) for p in self.observation_point)
        frame = dict.fromkeys(("frame_expansion_per_k", "u_frame_expansion_per_k", "u_temperature_k"))
        return self.model_copy(update={"observation_point": points} | frame)

    def to_dict(self) -> dict[str, Any]:
        """The content of rig.toml, optional keys left out where they are not set."""
        return self.model_dump(by_alias=True, exclude_none=True, mode="json")


_TABLES: dict[str, type[BaseModel]] = {"observation_point": ObservationPoint, "drum": Drum, "cable": Cable, **CAN_TABLES}


def rig_from_dict(data: dict[str, Any], source: str = "rig") -> Rig:
    """A checked rig; RigError names the source and the key."""
    if "schema" not in data:
        raise RigError(f"{source}: schema: is missing; this program reads 'lmeasure.rig/1'")
    return checked(data, Rig, source, _TABLES, RigError)


def read_rig(path: Path) -> Rig:
    """Read and check a rig.toml; RigError names the file and the key."""
    return rig_from_dict(files.read_toml(path), str(path))


def write_rig(path: Path, rig: Rig) -> None:
    """Write a rig.toml, whole or not at all."""
    files.write_toml(path, rig.to_dict())
