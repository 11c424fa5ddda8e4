"""Parameters of an instrument by their names: values, priors, and where rig and kernels keep them.

A further parameter of cables is a row of `TABLE`, its key in `rig`, and its derivative in `kernels.cable`; or, where a rig seldom has it,
a row of `FURTHER`, its key, and its law in `sensors.imperfect_parts`.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import NamedTuple

import numpy as np

from lmeasure import kernels
from lmeasure.core import BoolArray, CalibrationError, FloatArray, RigError
from lmeasure.rig.points_and_drums import Cable, Drum, ObservationPoint
from lmeasure.rig.rig import Observed, Rig, rig_from_dict
from lmeasure.rig.sensor_table import Keyed, OwnParameter, SensorChannel, SensorTable
from lmeasure.text import message


class Owner(StrEnum):
    """Part of a rig that a cable's parameter belongs to. Of a drum the observation point's name is the name."""

    POINT = "observation point"
    DRUM = "drum"
    ATTACHMENT = "attachment point"
    SENSOR = "sensor"


@dataclass(frozen=True, kw_only=True)
class CableParameter(Keyed):
    """A kind of parameter of a cable. key: after the owner's name, that of a value in a calibration record; group: its name in `--solve`.
    default_u: prior standard uncertainty of a nominal value that states none (a drawing, a tape measure, a protractor); assumed_u: of one
    in the rig's `assumed` list, without a measurement. column: its place in the kernels' rows, if any."""

    owner: Owner
    group: str
    default_u: float
    assumed_u: float
    column: int | None
    stored: str = ""  # Its key in rig.toml, where that is another; index: which of several numbers there
    index: int | None = None
    stated: str = ""  # The key of its standard uncertainty, where that is another than u_ and the key
    inverse: str = ""  # A key of rig.toml with the inverse quantity: its uncertainty is that of the parameter
    per_revolution: bool = False  # Whether the kernels' rows have it per count, as its share of a drum's revolution
    unsigned: bool = False  # Whether its sign means nothing

    def name(self, cable: Cable) -> str:
        """Return its name in a calibration record."""
        return f"tool.{cable.to_point}.{self.key}" if self.owner is Owner.ATTACHMENT else f"{cable.from_point}.{self.key}"


def _place(axis: str, column: int) -> CableParameter:
    return CableParameter(
        key=f"{axis}_mm", owner=Owner.POINT, group="position", default_u=30.0, assumed_u=300.0, column=column,
        stored="position_mm", index="xyz".index(axis), stated="u_position_mm",
    )  # fmt: skip


def _attachment(axis: str, column: int) -> CableParameter:
    return CableParameter(
        key=f"{axis}_mm", owner=Owner.ATTACHMENT, group="attachment", default_u=0.5, assumed_u=20.0, column=column,
        index="xyz".index(axis), stated="u_attachment_mm",
    )  # fmt: skip


def _guide(angle: str, column: int, assumed_u: float) -> CableParameter:
    return CableParameter(
        key=f"guide_{angle}_deg", owner=Owner.POINT, group="guide", default_u=5.0, assumed_u=assumed_u,
        column=column, stated="u_guide_deg",
    )  # fmt: skip


TABLE = (
    _place("x", kernels.BASE),
    _place("y", kernels.BASE + 1),
    _place("z", kernels.BASE + 2),
    _guide("alpha", kernels.ALPHA, 26.0),  # anywhere within +-45 degrees
    _guide("beta", kernels.BETA, 104.0),  # anywhere on the circle: 360/sqrt(12)
    CableParameter(
        key="pulley_radius_mm", owner=Owner.POINT, group="radius", default_u=1.0, assumed_u=10.0,
        column=kernels.RADIUS, unsigned=True,
    ),
    CableParameter(
        key="scale", owner=Owner.DRUM, group="scale", default_u=0.01, assumed_u=0.3, column=None,
        inverse="count_length_mm",
    ),
    CableParameter(
        key="tangent_length_mm", owner=Owner.DRUM, group="tangent", default_u=5.0, assumed_u=60.0,
        column=kernels.TANGENT,
    ),
    CableParameter(
        key="axial_offset_mm", owner=Owner.DRUM, group="axial", default_u=5.0, assumed_u=20.0,
        column=kernels.AXIAL,
    ),
    _attachment("x", kernels.ATTACHMENT),
    _attachment("y", kernels.ATTACHMENT + 1),
    _attachment("z", kernels.ATTACHMENT + 2),
    CableParameter(
        key="groove_pitch_mm", owner=Owner.DRUM, group="pitch", default_u=0.05, assumed_u=1.0,
        column=kernels.TRAVEL, per_revolution=True,
    ),
)  # fmt: skip
"""In the order of `kernels.layout.PARAMETERS`."""


def _pair(key: str, owner: Owner, group: str, *, u: float, suffixes: tuple[str, str], unit: str = "mm") -> tuple[CableParameter, ...]:
    """Two components that rig.toml keeps in one list."""
    return tuple(
        CableParameter(
            key=f"{key}_{suffix}_{unit}",
            owner=owner,
            group=group,
            default_u=u,
            assumed_u=10.0 * u,
            column=None,
            stored=f"{key}_{unit}",
            index=i,
            stated=f"u_{key}_{unit}",
        )
        for i, suffix in enumerate(suffixes)
    )


FURTHER = (
    *_pair("run_out", Owner.DRUM, "run-out", u=0.05, suffixes=("cos", "sin")),
    *_pair("pulley_eccentricity", Owner.POINT, "eccentricity", u=0.1, suffixes=("cos", "sin")),
    CableParameter(
        key="swivel_offset_mm", owner=Owner.POINT, group="offset", default_u=0.5, assumed_u=5.0, column=None,
    ),
    CableParameter(
        key="cable_oversize_mm", owner=Owner.DRUM, group="diameter", default_u=0.1, assumed_u=0.5,
        column=None,
    ),
    CableParameter(
        key="backlash_counts", owner=Owner.DRUM, group="backlash", default_u=2.0, assumed_u=20.0, column=None,
    ),
)  # fmt: skip
"""Values that a rig need not have, 0 where it is not given: in the order of `sensors.imperfect_parts`, which has their laws."""

TILT = _pair("swivel_tilt", Owner.POINT, "tilt", u=0.3, suffixes=("alpha", "beta"), unit="deg")
"""Values that are added to the guide's angles, whose derivatives are its own; 0 where it is not given."""


ZEROS = ("zero_deg", "zero_mm")
"""Value found of an absolute sensor, by the name of its channel: the angle or length at count 0."""
EXACT = 1e-9  # Least prior standard uncertainty, of a value that is stated to be exact and solved for all the same


@dataclass(frozen=True)
class Parameter:
    """One number of an instrument, in the unit of its name, and how well it was known before: its standard uncertainty."""

    name: str
    value: float
    prior_u: float
    unit: str = "mm"


_SELDOM = (*FURTHER, *TILT)
_OF_POINT = (*(p for p in TABLE if p.owner is not Owner.ATTACHMENT), *_SELDOM)
_OF_TOOL = tuple(p for p in TABLE if p.owner is Owner.ATTACHMENT)
_OF_KEY = {p.key: p for p in _OF_POINT}

GROUPS = {g: tuple(p.key for p in (*TABLE, *_SELDOM) if p.group == g) for g in dict.fromkeys(p.group for p in (*TABLE, *_SELDOM))}
"""Names for `--solve`, and the keys of each."""
PLACE, GUIDE = GROUPS["position"], GROUPS["guide"]
SCALE = next(i for i, p in enumerate(TABLE) if p.key == "scale")
"""Index of the decoding scale in the table, which the kernels' rows do not have."""
UNSIGNED = frozenset(p.key for p in TABLE if p.unsigned)
"""Keys of values whose sign means nothing."""
FACTORS = np.array([p.factor for p in TABLE])
"""(13,) factors from one unit of each to the kernels' units."""
FURTHER_KEYS = frozenset(p.key for p in FURTHER)
"""Keys of parameters unknown to the kernels."""
PHASED = frozenset(p.key for p in FURTHER if p.group in ("run-out", "eccentricity"))
"""Keys of parameters that turn with drum and pulley, and are meaningless without their angles."""

_OF_PULLEY = ("eccentricity", "offset")  # Groups that a point without a pulley does not have
_ABSENT = frozenset(p.stored or p.key for p in _SELDOM)  # Keys that mean 0 where they are not given
_IN_ROWS = np.array([p.column is not None for p in TABLE])
_COLUMNS = np.array([-1 if p.column is None else p.column for p in TABLE])
_PER_REVOLUTION = np.array([p.per_revolution for p in TABLE])
_UNSIGNED = np.array([p.unsigned for p in TABLE])


def parameter_names(rig: Rig, cables: tuple[Observed, ...] | None = None) -> list[list[str]]:
    """Return for each channel, default all cables, the calibration record's names of the kernels' parameters (`kernels.layout.PARAMETERS`);
    empty if an encoder of angles does not have one."""
    return [_names(o) for o in (rig.cable if cables is None else cables)]


def _names(observed: Observed) -> list[str]:
    return observed.table.names(observed) if isinstance(observed, SensorChannel) else [p.name(observed) for p in TABLE]


def further_names(rig: Rig, cables: tuple[Observed, ...] | None = None) -> list[list[str]]:
    """Return for each channel, default all cables, the names of `FURTHER`; empty ones for an encoder of angles, which has none."""
    return [[p.name(o) if not isinstance(o, SensorChannel) else "" for p in FURTHER] for o in (rig.cable if cables is None else cables)]


def tilt_names(observed: Observed) -> tuple[str, ...]:
    """Return the names of the tilts that are added to the guide's angles of a channel, empty without a guide."""
    return tuple(f"{observed.from_point}.{p.key}" for p in TILT) if observed.from_point else ()


def attachment_names(point: str) -> tuple[str, ...]:
    """The calibration record's names of an attachment point's coordinates."""
    return tuple(f"tool.{point}.{p.key}" for p in _OF_TOOL)


def solved_parameters(rig: Rig, cables: tuple[Observed, ...], solve: tuple[str, ...]) -> tuple[Parameter, ...]:
    """Return the solved parameters: the named groups, and every assumed value, of the points that the cables join; and the zeros and stated
    uncertain values of other sensors.

    CalibrationError for a group that does not exist, and without any parameter.
    """
    points = [p.name for p in rig.observation_point]
    for group, _, owner in (requested.partition(":") for requested in solve):
        if group not in GROUPS:
            raise CalibrationError(message("error.solve_is_not_one", group=group, groups=", ".join(GROUPS)))
        if owner and (owner not in points or group == "attachment"):
            raise CalibrationError(message("error.solve_is_no_observation", group=group, owner=owner, points=", ".join(points)))
    assumed, out = _assumed(rig), []
    for name, p in _named(cables):
        owner = name.rpartition(".")[0]
        if (p.group in solve or f"{p.group}:{owner}" in solve or name in assumed) and not (
            p.group in _OF_PULLEY and not rig.point(name.rpartition(".")[0]).pulley_radius_mm
        ):
            out.append(parameter_of(rig, name))
    for name in dict.fromkeys(f"{o.channel}.{p.key}" for o in cables if isinstance(o, SensorChannel) for p in o.table.solvable()):
        own = parameter_of(rig, name)
        if own.prior_u > EXACT:
            out.append(own)
    if not out:
        raise CalibrationError(message("error.solve_nothing_is_left"))
    return tuple(out)


def parameter_of(rig: Rig, name: str) -> Parameter:
    """The parameter of a calibration record's name as the rig states it, its prior standard uncertainty as usual where it states none."""
    owner, _, key = name.rpartition(".")
    if (own := _of_sensor(rig, name)) is not None:
        sensor, q = own
        return Parameter(name, sensor.value(q), max(sensor.u(q), EXACT), q.unit)
    p = next(q for q in _OF_TOOL if q.key == key) if owner.startswith("tool.") else _OF_KEY[key]
    u, value = stated_u(rig, name), value_of(rig, name)
    assert value is not None
    usual = p.assumed_u if name in _assumed(rig) else p.default_u
    prior_u = usual if u is None else max(u, EXACT)
    if p.column == kernels.BETA and u != 0.0:
        prior_u = min(prior_u * azimuth_stretch(rig.point(owner).guide_alpha_deg), max(p.assumed_u, prior_u))
    return Parameter(name, value, prior_u, p.unit)


def azimuth_stretch(alpha_deg: float) -> float:
    """Return the factor on beta's uncertainty over that of a guide's direction, 1 up to 60 degrees of alpha. Near vertical, beta can be
    anything: beyond 60 degrees it is as uncertain as the direction makes it."""
    return max(1.0, 0.5 / max(abs(math.cos(math.radians(alpha_deg))), 1e-9))


def _of_sensor(rig: Rig, name: str) -> tuple[SensorTable, OwnParameter] | None:
    """The sensor other than a cable, and which of its own parameters has that name; None for other names."""
    owner, _, key = name.rpartition(".")
    every = ((sensor, p) for sensor in rig.sensors if sensor.channel == owner for p in sensor.solvable() if p.key == key)
    return next(every, None)


def group_names(cables: tuple[Observed, ...], group: str) -> tuple[str, ...]:
    """Names of a group's parameters of the points that the cables lead from and to."""
    return tuple(name for name, p in _named(cables) if p.group == group)


def _named(cables: tuple[Observed, ...]) -> list[tuple[str, CableParameter]]:
    """Every parameter of some cables by its name: those of observation points before those of attachment points."""
    points = dict.fromkeys(c.from_point for c in cables if c.is_cable)
    tool = dict.fromkeys(c.to_point for c in cables if c.to_point)
    of_points = [(f"{point}.{p.key}", p) for point in points for p in _OF_POINT]
    return of_points + [(f"tool.{point}.{p.key}", p) for point in tool for p in _OF_TOOL]


def _assumed(rig: Rig) -> set[str]:
    """Names of the parameters that the rig's `assumed` list means."""
    out: set[str] = set()
    for name in rig.assumed:
        if name in rig.tool:
            out |= {*attachment_names(name)}
            continue
        point, key = name.split(".", 1)
        out |= {f"{point}.{p.key}" for p in _OF_POINT if key in (p.stored or p.key, p.inverse)}
    return out


def stated_u(rig: Rig, name: str) -> float | None:
    """Standard uncertainty that the rig states of a parameter's value, in its unit; None where it states none."""
    owner, _, key = name.rpartition(".")
    if owner.startswith("tool."):
        return rig.u_attachment_mm
    if (own := _of_sensor(rig, name)) is not None:
        return own[0].u(own[1])
    p, point = _OF_KEY[key], rig.point(owner)
    holder = point.drum if p.owner is Owner.DRUM else point
    u: float | None = getattr(holder, p.stated or f"u_{key}", None)
    if u is None and p.inverse and (of_inverse := getattr(holder, f"u_{p.inverse}")) is not None:
        u = of_inverse / getattr(holder, p.inverse) * getattr(holder, key)
    return u


class _Location(NamedTuple):
    """Place of a number in rig.toml: the table, its name, the key, and the index among several numbers there."""

    kind: Owner
    owner: str
    key: str
    place: int | None


def _located(rig: Rig, name: str) -> _Location | None:
    """Return the place of a number by its name in a calibration record; None for a kind of number that a rig does not contain."""
    owner, _, key = name.rpartition(".")
    if (own := _of_sensor(rig, name)) is not None:
        return _Location(Owner.SENSOR, owner, own[1].stored, own[1].index)
    if key in ZEROS:
        return _Location(Owner.SENSOR, owner, key, None)
    if owner.startswith("tool."):
        index = next((p.index for p in _OF_TOOL if p.key == key), None)
        point = owner.removeprefix("tool.")
        return None if index is None else _Location(Owner.ATTACHMENT, point, point, index)
    if key in _OF_KEY:
        p = _OF_KEY[key]
        return _Location(p.owner, owner, p.stored or key, p.index)
    kind = next((kind for kind, model in ((Owner.POINT, ObservationPoint), (Owner.DRUM, Drum)) if key in model.model_fields), None)
    return None if kind is None else _Location(kind, owner, key, None)


def value_of(rig: Rig, name: str) -> float | None:
    """The rig's number of a calibration record's name, a dimension's too, in the unit of the name; None for a kind of number that no rig
    holds. RigError, the beginning of a sentence, where its owner is missing."""
    at = _located(rig, name)
    if at is None:
        return None
    if at.kind is Owner.ATTACHMENT:
        if at.owner not in rig.tool:
            raise RigError(message("error.there_is_no_point", owner=at.owner))
        return rig.tool[at.owner][at.place or 0]
    if at.kind is Owner.SENSOR:
        own = _of_sensor(rig, name)
        if own is None:
            raise RigError(message("error.there_is_no_encoder", owner=at.owner))
        return None if getattr(own[0], at.key) is None else own[0].value(own[1])
    point = next((p for p in rig.observation_point if p.name == at.owner), None)
    if point is None:
        raise RigError(message("error.there_is_no_observation", owner=at.owner))
    value = getattr(point.drum if at.kind is Owner.DRUM else point, at.key)
    if value is None and at.key in _ABSENT:
        return 0.0
    value = value if at.place is None else value[at.place]
    return float(value) if isinstance(value, int | float) else None


def with_values(rig: Rig, values: Mapping[str, float]) -> Rig:
    """The rig with other values of parameters or dimensions by their names, signs taken off where they mean nothing, guide angles brought
    back to their ranges."""
    data = rig.to_dict()
    points = {p["name"]: p for p in data["observation_point"]}
    sensors = {table["channel"]: table for kind in rig.sensor_tables for table in data.get(kind, ())}
    for name, number in values.items():
        at = _located(rig, name)
        assert at is not None
        value = abs(float(number)) if at.key in UNSIGNED else float(number)
        point = points.get(at.owner, {})
        holder = {Owner.POINT: point, Owner.DRUM: point.get("drum"), Owner.ATTACHMENT: data["tool"]}
        holder = sensors[at.owner] if at.kind is Owner.SENSOR else holder[at.kind]
        value = math.remainder(value, 360.0) if at.key == ZEROS[0] else value
        if at.place is None:
            holder[at.key] = value
        else:
            holder.setdefault(at.key, [0.0, 0.0])[at.place] = value
    for point in points.values():
        point[GUIDE[0]], point[GUIDE[1]] = _in_range(point[GUIDE[0]], point[GUIDE[1]])
    return rig_from_dict(data, "calibrated rig")


def _in_range(alpha: float, beta: float) -> tuple[float, float]:
    """Guide angles [deg] of the same direction, alpha within +-90 and beta within +-360."""
    alpha = math.remainder(alpha, 360.0)
    if abs(alpha) > 90.0:
        alpha, beta = math.copysign(180.0, alpha) - alpha, beta + 180.0
    return alpha, math.remainder(beta, 360.0) if abs(beta) > 360.0 else beta


def same_direction(key: str, angle: float) -> Iterable[float]:
    """A guide angle [deg] and the other of the same direction: (alpha, beta) and (180 - alpha, beta + 180)."""
    return angle, 180.0 - angle if key == GUIDE[0] else angle + 180.0


def kernel_values(rows: FloatArray) -> FloatArray:
    """Return (m, 13) parameters of m cables in the kernels' order and units, from their rows; NaN for missing ones."""
    out = np.full((len(rows), len(TABLE)), np.nan)
    out[:, _IN_ROWS] = rows[:, _COLUMNS[_IN_ROWS]]
    out[:, _PER_REVOLUTION] *= rows[:, [kernels.TURN_COUNTS]]
    return out


def with_kernel_values(rows: FloatArray, values: FloatArray) -> FloatArray:
    """(m, CABLE_COLUMNS) rows of cables with parameters (m, 13) in the kernels' order and units."""
    slots = Slots(rows, np.ones(values.shape, dtype=np.bool_))
    return slots.filled(rows, values[slots.cable, slots.parameter])


class Slots:
    """Places of chosen (m, 13) parameters of m cables, rows (m, CABLE_COLUMNS), in the kernels' rows: cable (k,) and parameter (k,) of
    those with a place."""

    def __init__(self, rows: FloatArray, chosen: BoolArray) -> None:
        self.cable, self.parameter = np.nonzero(chosen & _IN_ROWS)
        self._at = self.cable, _COLUMNS[self.parameter]
        self._per = np.where(_PER_REVOLUTION[self.parameter], rows[self.cable, kernels.TURN_COUNTS], 1.0)
        # other sensors have their zero where a cable has a radius
        self._unsigned = np.flatnonzero(_UNSIGNED[self.parameter] & (rows[self.cable, kernels.KIND] == kernels.CABLE))
        self._guided = np.flatnonzero(np.isin(rows[:, kernels.KIND], (kernels.CABLE, kernels.SWIVEL)))

    def filled(self, rows: FloatArray, values: FloatArray) -> FloatArray:
        """The rows with values (k,) in the kernels' units there."""
        out, new = rows.copy(), values / self._per
        # a radius has no sign: a step below zero comes out on the other side
        new[self._unsigned] = np.abs(new[self._unsigned])
        out[self._at] = new
        for j in self._guided:
            out[j, kernels.GUIDE_XYZ] = kernels.guide_direction(out[j, kernels.ALPHA], out[j, kernels.BETA])
        return out
