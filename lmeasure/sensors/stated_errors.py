"""Errors of cables' parameters: stated errors of drums, pulleys and attachment points that no calibration has solved, their effect on
lengths, and the covariance of a calibration's record. The laws of these errors are in `sensors.imperfect_parts`."""

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, BY_AXIAL, PARAMETERS, last_travel as kernels_last_travel, length_gradients
from lmeasure.rig import (
    FURTHER,
    FURTHER_KEYS,
    PHASED,
    TYPICAL_SIZES,
    Cable,
    CalibrationRecord,
    Drum,
    Observed,
    Rig,
    SensorChannel,
    attachment_names,
    further_names,
    parameter_names,
)
from lmeasure.sensors import imperfect_parts as laws
from lmeasure.sensors.cable_effects import Zero
from lmeasure.sensors.wrap import Span, arms, spans
from lmeasure.text import message

BAND = 2.5  # recorded counts
SAME_MM = 1.0  # Difference of cable lengths up to which a counter is zeroed at the same pose: `calibrate` writes whole millimetres


@dataclass(frozen=True)
class Variable:
    """One independent error: its kind, its observation point or attachment point, and its standard uncertainty in the unit of the kind's
    key. assumed: whether that is a typical size, without a statement."""

    kind: laws.CableEffect
    owner: str
    u: float
    assumed: bool = False

    @property
    def typical(self) -> str:
        """The key of the typical size that it is, empty where it is stated."""
        return self.kind.key if self.assumed else ""

    @property
    def names(self) -> tuple[str, ...]:
        """Names of its components, those of a calibration's parameters where it could be one."""
        if self.kind is laws.ATTACHMENT:
            return attachment_names(self.owner)
        key = self.kind.key.removeprefix("u_")
        if self.kind not in (laws.RUN_OUT, laws.ECCENTRICITY):
            return (f"{self.owner}.{key}",)
        return tuple(f"{self.owner}.{key.removesuffix('_mm')}_{component}_mm" for component in ("cos", "sin"))


def stated(
    rig: Rig, cables: tuple[Observed, ...] | None = None, solved: Iterable[str] = (), kinds: tuple[laws.CableEffect, ...] = laws.STATED
) -> list[Variable]:
    """Return the rig's stated uncertainties, and typical sizes of missing ones; solved: names of a calibration's parameters, which are not
    counted again."""
    known = set(solved)
    every = [variable(rig, kind, owner) for kind, owner in _places(rig, cables, kinds) if not _solved(kind, owner, known)]
    return [v for v in every if v.u]


def variable(rig: Rig, kind: laws.CableEffect, owner: str) -> Variable:
    """Return the error of one part as the rig states it, or of a typical size."""
    u = _stated(rig, kind, owner)
    return Variable(kind, owner, _typical(rig, kind, owner) if u is None else u, assumed=u is None)


def _typical(rig: Rig, kind: laws.CableEffect, owner: str) -> float:
    """Return the typical size for a missing statement of a rig; 0 if the rig states that it is exact, or the point has no such part."""
    if kind.key not in TYPICAL_SIZES:
        return 0.0
    if kind in (laws.ECCENTRICITY, laws.OFFSET):
        return min(rig.typical(kind.key), 0.5 * rig.point(owner).pulley_radius_mm)
    return rig.typical(kind.key, 1.0 if kind.of is None else float(getattr(rig.point(owner).drum, kind.of)))


def of_record(rig: Rig, record: CalibrationRecord | None) -> list[Variable]:
    """Return the rig's stated uncertainties of drums and pulleys that its calibration has not solved, and the remaining ones of solved
    parameters."""
    if record is None:
        return stated(rig, kinds=laws.OTHERS)
    u = {p.name: p.u for p in record.parameters} | {d.name: d.u for d in record.dimensions}
    every = [Variable(kind, owner, 1.0) for kind, owner in _places(rig, None, laws.OTHERS)]
    solved = [v for v in every if v.names[0] in u and v.kind is not laws.FRICTION]
    left = [Variable(v.kind, v.owner, math.sqrt(sum(u[n] ** 2 for n in v.names) / len(v.names))) for v in solved]
    return [*stated(rig, None, record.names, laws.OTHERS), *left]


def _places(rig: Rig, cables: tuple[Observed, ...] | None, kinds: tuple[laws.CableEffect, ...]) -> Iterator[tuple[laws.CableEffect, str]]:
    chosen = rig.cable if cables is None else cables
    points = dict.fromkeys(c.to_point for c in chosen if c.to_point)
    drums = dict.fromkeys(c.from_point for c in chosen if c.is_cable)
    for kind in kinds:
        yield from ((kind, name) for name in (points if kind is laws.ATTACHMENT else drums))


def _stated(rig: Rig, kind: laws.CableEffect, owner: str) -> float | None:
    if kind is laws.ATTACHMENT:
        return rig.u_attachment_mm
    point = rig.point(owner)
    value: float | None = getattr(point if kind in (laws.ECCENTRICITY, laws.OFFSET) else point.drum, kind.key)
    return value


def _solved(kind: laws.CableEffect, owner: str, known: set[str]) -> bool:
    if kind is laws.ATTACHMENT:
        return attachment_names(owner)[0] in known
    # friction along a cable obeys the law of play
    key = "backlash_counts" if kind is laws.FRICTION else kind.key.removeprefix("u_")
    return any(f"{owner}.{name}" in known for name in (kind.parameter, key, f"{key.removesuffix('_mm')}_cos_mm"))


def phase_errors(rig: Rig, solved: Iterable[str], start: FloatArray) -> list[Variable]:
    """Return the errors of known run-out and eccentricity from the angle of drum and pulley at the start pose (7,) of a run.

    The angle follows from the cable length there. Its error is the effect of run-out and eccentricity on the length. Without
    `phase_length_mm` the angle of solved parameters (names) is unknown, as counters are zeroed anywhere.
    """
    found, out = {name.partition(".")[0] for name in solved if name.rpartition(".")[2] in PHASED}, list[Variable]()
    for c in {c.from_point: c for c in rig.cable}.values():
        p = rig.point(c.from_point)
        run_out, pulley = math.hypot(*p.drum.run_out_mm or (0.0,)), math.hypot(*p.pulley_eccentricity_mm or (0.0,))
        if not (run_out or pulley):
            continue
        if p.phase_length_mm is None:
            of_drum = of_pulley = float(p.name in found)
        else:
            length = float(free_lengths(rig.cable_rows((c,)), start[None])[0])
            off = run_out + pulley if abs(length - p.phase_length_mm) > SAME_MM else 0.0
            of_drum = math.tau * off / (p.drum.counts_per_revolution * p.drum.count_length_mm)
            of_pulley = off / p.pulley_radius_mm if p.pulley_radius_mm else 0.0
        out += [Variable(kind, p.name, u) for kind, u in ((laws.RUN_OUT, run_out * of_drum), (laws.ECCENTRICITY, pulley * of_pulley)) if u]
    return out


class Unsolved:
    """Errors of the lengths of m cables from unsolved dimensions: variables that all samples share, and play."""

    def __init__(self, rig: Rig, variables: Iterable[Variable], cables: tuple[Cable, ...] | None = None) -> None:
        self._cables = rig.cable if cables is None else cables
        chosen = list(variables)
        self.variables = [v for v in chosen if v.kind not in (laws.BACKLASH, laws.FRICTION)]
        self.names = tuple(name for v in self.variables for name in v.names)
        self.sources = tuple(v.kind.said for v in self.variables for _ in v.names)
        self.assumed = tuple(v.typical for v in self.variables for _ in v.names)
        """Typical size of each column of `shifts`, empty for a stated one."""
        played = [v for v in chosen if v.kind in (laws.BACKLASH, laws.FRICTION)]
        # they follow one law, so they are one variable each, of stated and of assumed sizes
        self._plays = [(laws.FRICTION.key if assumed else "", self._band(rig, played, assumed)) for assumed in (False, True)]
        self._plays = [(key, band) for key, band in self._plays if band.any()]
        self.play_mm = np.sqrt(sum((band**2 for _, band in self._plays), start=np.zeros(len(self._cables))))
        """(m,) half the width of the band, one standard uncertainty of it [mm]."""

    def _band(self, rig: Rig, played: list[Variable], assumed: bool) -> FloatArray:
        """(m,) half the width of the band [mm] by the variables that are assumed, or by the others."""
        squares: dict[str, float] = {}
        for v in played:
            if v.assumed is assumed:
                squares[v.owner] = squares.get(v.owner, 0.0) + v.u**2
        drums = [(c.from_point, rig.point(c.from_point).drum) for c in self._cables]
        return np.array([np.sqrt(squares.get(point, 0.0)) * drum.count_length_mm / drum.scale for point, drum in drums])

    def __bool__(self) -> bool:
        return bool(self.variables) or bool(self.play_mm.any())

    def shifts(self, cable_rows: FloatArray, zero: Zero, poses: FloatArray, counts: FloatArray) -> FloatArray:
        """(n, m, q) changes of modelled minus measured changes [mm] by one standard uncertainty of each variable but play, at (n, 7) poses
        and true counts (n, m); NaN where pose or count is NaN or a cable cannot run."""
        out = self._at(cable_rows, poses, counts)
        if not self.variables:
            return out
        m = len(cable_rows)
        begun = self._at(cable_rows, zero.poses, np.broadcast_to(zero.counts, (m, m)))
        return np.asarray(out - begun[np.arange(m), np.arange(m)])

    def play(self, travel: FloatArray) -> FloatArray:
        """(n, m, p) the same by play, in a run whose last travel at its samples is travel (n, m): 1 paying out, -1 winding in, 0 not yet.

        A variable for each drum, and one for each cable's count where it was zeroed.
        """
        columns = []
        for _, u in self._plays:
            columns += [np.where(mask, -travel * u, 0.0) for mask in self._drums_of(u)]
            columns += [np.where(np.arange(len(u)) == j, (travel != 0.0) * u, 0.0) for j in np.flatnonzero(u)]
        return np.moveaxis(np.array(columns).reshape(-1, *travel.shape), 0, 2)

    def _drums_of(self, u: FloatArray) -> list[BoolArray]:
        """The cables (m,) of each drum that has play u (m,) [mm]."""
        drums = np.array([c.from_point for c in self._cables])
        return [drums == point for point in dict.fromkeys(drums[u > 0.0].tolist())]

    @property
    def play_assumed(self) -> tuple[str, ...]:
        """Return (p,) the typical size of each column of `play`, empty for a stated one."""
        return tuple(key for key, u in self._plays for _ in range(len(self._drums_of(u)) + int(np.count_nonzero(u))))

    @property
    def play_sources(self) -> tuple[str, ...]:
        """Return (p,) the sources of the columns of `play`."""
        return (message("sensors.play_drums"),) * len(self.play_assumed)

    def _at(self, rows: FloatArray, poses: FloatArray, counts: FloatArray) -> FloatArray:
        """Return (n, m, q) effects of each variable on F(P) - D(k)."""
        out = np.zeros((*counts.shape, len(self.names)))
        if not self.variables:
            return out
        known = np.isfinite(poses).all(axis=1)
        arm, turns = arms(rows, poses[known]), se3.matrices(poses[known])
        every = spans(rows, poses[known], arm)
        column = 0
        for v in self.variables:
            assert v.kind.adds is not None
            width = len(v.names)
            for j, c in enumerate(self._cables):
                if v.owner == (c.to_point if v.kind is laws.ATTACHMENT else c.from_point):
                    at = laws.Acted(rows[j], turns, counts[known, j], Span(*(values[:, j] for values in every)))
                    out[known, j, column : column + width] = v.u * v.kind.adds(at)
            column += width
        # a length has no error from values that it does not depend on, but a sample without a pose or count has none at all
        out[~known] = np.nan
        out[~np.isfinite(counts)] = np.nan
        return out


def free_lengths(rows: FloatArray, poses: FloatArray) -> FloatArray:
    """(m,) lengths from B to the attachment point [mm] of each cable at its own pose (m, 7), along straight lines, without compiling."""
    points = se3.apply(poses, rows[:, ATTACHMENT_XYZ])
    return np.asarray(np.linalg.norm(points - rows[:, BASE_XYZ], axis=1))


def last_travel(counts: FloatArray, quantum: FloatArray, state: FloatArray | None = None) -> FloatArray:
    """(n, m) which way each cable travelled last: 1 paid out, -1 wound in, 0 not yet, from true counts (n, m) since counters were zeroed.

    A way back of less than `BAND` recorded counts, quantum (m,) true counts each, is not seen: a counter flickers. state (m, 2), zeros
    where counting began, is moved on in place.
    """
    state = np.zeros((counts.shape[1], 2)) if state is None else state
    return np.asarray(kernels_last_travel(np.ascontiguousarray(counts), BAND * quantum, state))


def further_solved(record: CalibrationRecord | None) -> bool:
    """Return whether a calibration solved any of `parameters.FURTHER`, which the kernels do not know."""
    return record is not None and any(name.rpartition(".")[2] in FURTHER_KEYS for name in record.names)


def channel_names(rig: Rig, cables: tuple[Observed, ...] | None = None, *, wide: bool = False) -> list[list[str]]:
    """Return each channel's names in the record, of the kernels' 13 parameters; wide: and of the 7 of `parameters.FURTHER` behind them."""
    names = parameter_names(rig, cables)
    return [own + more for own, more in zip(names, further_names(rig, cables), strict=True)] if wide else names


def width_of(*, wide: bool) -> int:
    """Return how many these are."""
    return len(PARAMETERS) + (len(FURTHER) if wide else 0)


def length_gradients_since(
    rig: Rig, cables: tuple[Cable, ...], zero: FloatArray, poses: FloatArray, *, counts: FloatArray, wide: bool = False
) -> FloatArray:
    """(n, m, 13) derivatives of modelled minus measured changes of cables since a pose (7,) by their parameters, at (n, 7) poses and
    true counts (n, m); wide: as `channel_names` has it, (n, m, 20)."""
    rows, scales, m = rig.cable_rows(cables), rig.scales(cables), len(cables)
    begun = length_gradients(rows, np.array([zero]), np.zeros((1, m)), scales)
    out = length_gradients(rows, np.ascontiguousarray(poses), counts, scales) - begun
    if not wide:
        return np.asarray(out)
    of_parts = laws.every_part(rig, cables).gradient(rows, (np.tile(zero, (m, 1)), np.zeros(m)), poses, counts)
    return np.concatenate([out, of_parts], axis=2)


def cable_covariance(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> FloatArray:
    """(13 m, 13 m) covariance of the cables' parameters, mm and rad, in the kernels' order: of the record, and of dimensions that the rig
    states to be uncertain (`unsolved_dimensions`); zero where there is neither. wide: as `channel_names` has it, 20 for each."""
    rest, columns = solved_covariance(rig, record, cables, wide=wide), unsolved_dimensions(rig, record, cables, wide=wide)[0]
    return rest + columns @ columns.T if columns.shape[1] else rest


def solved_covariance(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> FloatArray:
    """Return the (13 m, 13 m) covariance of the cables' parameters from the calibration's solution, without the part of
    `unsolved_dimensions`."""
    m = len(rig.cable if cables is None else cables)
    if record is None:
        return np.zeros((m * width_of(wide=wide),) * 2)
    names = channel_names(rig, cables, wide=wide)
    covariance = record.cable_covariance(names)
    if not record.dimensions:
        return covariance
    followed = record.dimension_columns(names)[1]
    return np.asarray(covariance - followed @ followed.T)


def unsolved_dimensions(
    rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...] | None = None, *, wide: bool = False
) -> tuple[FloatArray, tuple[str, ...]]:
    """Return (13 m, s) errors of the cables' parameters, in the kernels' order, by independent variables of unit variance: of stated
    uncertain dimensions that the record has not solved, and of the parameters that a calibration fitted with them; (s,) the typical size of
    each, empty for stated or calibrated ones.

    A record's value of a dimension replaces that of the rig, whose statement was the calibration's prior.
    """
    chosen = rig.cable if cables is None else cables
    names = channel_names(rig, chosen, wide=wide)
    known = () if record is None else record.dimensions
    solved = () if record is None else record.names
    variables = stated(rig, chosen, solved, laws.DIMENSIONS)
    size = {n: v.u for v in variables for n in v.names}
    assumed = {n: v.typical for v in variables for n in v.names}
    # zeros of sensors are sources of their own, which a run may determine
    for sensor in {c.channel: c.table for c in chosen if isinstance(c, SensorChannel)}.values():
        own = {f"{sensor.channel}.{p.key}": sensor.u(p) * p.factor for p in sensor.solvable() if p.key != sensor.zero}
        size |= {name: u for name, u in own.items() if u and name not in solved}
    zeroed = _zeroed_elsewhere(rig, record, chosen, len(names[0]))
    columns = np.column_stack([_selected(rig, chosen, names, tuple(size)) * np.array(list(size.values())), zeroed])
    keys = tuple(assumed.get(name, "") for name in size) + ("zero_length_mm",) * zeroed.shape[1]
    if record is None or not known:
        return columns, keys
    of_dimensions, followed = record.dimension_columns(names)
    calibrated = _selected(rig, chosen, names, tuple(d.name for d in known)) @ of_dimensions + followed
    return np.column_stack([calibrated, columns]), ("",) * calibrated.shape[1] + keys


def _zeroed_elsewhere(rig: Rig, record: CalibrationRecord | None, cables: tuple[Observed, ...], width: int) -> FloatArray:
    """(13 m, s) errors of axial offsets, a variable for each drum whose counters were zeroed at other lengths than in the calibration.
    The lengths of the offsets are not stated. They are taken to hold where the counters are zeroed, as if the drum was turned back.
    The travel of a drum that was not is the standard uncertainty."""
    travel = {} if record is None or rig.unstated == "exact" else axial_travel(rig, record)
    drums = list(dict.fromkeys(c.from_point for c in cables if travel.get(c.name)))
    out = np.zeros((len(cables), width, len(drums)))
    for j, c in enumerate(cables):
        if travel.get(c.name):
            out[j, BY_AXIAL, drums.index(c.from_point)] = travel[c.name]
    return out.reshape(len(cables) * width, len(drums))


def axial_travel(rig: Rig, record: CalibrationRecord) -> dict[str, float]:
    """Travel [mm] of each cable's pay-out point from where the calibration zeroed its counter to where it was zeroed now, empty of cables
    that state `zero_length_mm` or were zeroed at the same length."""
    counts = rig.paid_out_since(record.zero_length_mm).tolist()
    every = [(c.name, k, rig.point(c.from_point).drum) for c, k in zip(rig.cable, counts, strict=True)]
    return {name: k * drum.axial_per_count_mm for name, k, drum in every if abs(k) * drum.per_count >= SAME_MM}


def _selected(rig: Rig, cables: tuple[Observed, ...], names: list[list[str]], dimensions: tuple[str, ...]) -> FloatArray:
    """(13 m, s) the kernels' parameters by these dimensions of the rig."""
    out = np.zeros((len(cables), len(names[0]), len(dimensions)))
    for j, c in enumerate(cables):
        drum = rig.counter(c)
        for s, name in enumerate(dimensions):
            if isinstance(drum, Drum) and name == f"{c.from_point}.count_length_mm":
                # a longer count means more cable per recorded count: f changes by k c/scale and by -k
                out[j, PARAMETERS.index("scale"), s] = -drum.scale / drum.count_length_mm
            elif name in names[j]:
                out[j, names[j].index(name), s] = 1.0
    return out.reshape(len(cables) * len(names[0]), len(dimensions))
