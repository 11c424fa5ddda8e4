"""Changes of the free cables, from recorded counts: signs, wraps and drums undone, passes brought to one time base.

An incremental counter that is set to zero shows 0 at any place within a count: recorded = round(count_sign * scale * k + phase), the phase
uniform within half a recorded count. It is one draw for all rows until the counter is zeroed again (`Rig.zeroings`); a drum may state that
its zero is exact.
"""

import json
from dataclasses import dataclass, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure import core, kernels
from lmeasure.core import BoolArray, DataFrame, FloatArray, IntArray, Shown, Status, TextArray
from lmeasure.io import files
from lmeasure.recording import Run, unwrap
from lmeasure.rig import Drum, Observed, Rig, SensorTable, cables_among
from lmeasure.sensors.cable_effects import effects_of, zero_at
from lmeasure.sensors.rejected_samples import Reasons, on_time_base, other_times, rate_notes, reasons_of
from lmeasure.sensors.stated_errors import last_travel
from lmeasure.text import Message, message, of_file, table as table_of

POSE = 7  # Numbers of a pose
NEARLY_UNIT = 1e-3  # Tolerance of a quaternion's length: readers normalize it, and writers round it
MAX_ROUNDS = 30  # of fixed points whose contraction is a strain


@dataclass(frozen=True, repr=False)
class Lengths(Shown):
    """Changes of m cable lengths and sensor readings since zeroing, over n samples.

    Examples
    --------
    >>> lengths = lm.lengths_from_counts(run)
    >>> lengths.cables[0], lengths.change_mm.shape
    ('c1', (58, 6))
    """

    time_s: FloatArray
    """(n,) times [s]."""
    cables: tuple[str, ...]
    """Names of the channels, m: cables, followed by other sensors."""
    change_mm: FloatArray
    """(n, m) change of the free length since the zero pose [mm]; angle since count 0 [rad] for angle encoders."""
    counts: FloatArray
    """(n, m) decoded counts k."""
    flags: IntArray
    """(n,) `Status` of each sample: ok, gap or jump."""
    cause: TextArray
    """(n,) cause of a flag, a code of `lmeasure.text.messages`."""
    cable: TextArray
    """(n,) cable of a flag."""
    notes: tuple[Message, ...] = ()
    """Notes for the user."""
    u_time_s: FloatArray | None = None
    """(n, m) standard uncertainty of the counting times [s]; None: latched together."""
    temperature_c: FloatArray | None = None
    """(n, m) temperatures of the cables [°C]; None: not recorded."""
    gone_on: FloatArray | None = None
    """(n, m) decoded counts of all channels, including those not used because their origin is in doubt."""
    reasons: tuple[Reasons, ...] = ()
    """Reasons by cable."""
    encoders: int = 0
    """Number of channels that are no cables, the last ones."""
    missed_mm: FloatArray | None = None
    """(n, m) estimated errors of lengths interpolated linearly between samples of a later pass [mm]; None: not interpolated."""
    angles: tuple[bool, ...] = ()
    """(m,) whether a channel reads an angle; empty: all that are no cables do."""
    frames: tuple[FloatArray, FloatArray] | None = None
    """(n, m) times [s] of channels that have their own, and by how much their counts exceed `counts`, which are at `time_s`."""

    def about(self) -> dict[str, str]:
        """Samples, cables, how far they were drawn."""
        farthest = np.nanmax(np.abs(self.change_mm[:, : self.lengths]), initial=0.0)
        ok = int((self.flags == Status.OK).sum())
        return {"samples": f"{len(self.time_s)}, {ok} ok", "cables": ", ".join(self.cables), "largest change": f"{farthest:.6g} mm"}

    def to_frame(self) -> DataFrame:
        """The columns of a lengths file."""
        return core.framed(self.columns())

    @property
    def lengths(self) -> int:
        """Return how many of the channels are cables: the first ones."""
        return len(self.cables) - self.encoders

    def of_cables(self) -> "Lengths":
        """The same of the cables alone."""
        if not self.encoders:
            return self
        m, names = self.lengths, ("change_mm", "counts", "u_time_s", "temperature_c", "gone_on", "missed_mm")
        some: dict[str, Any] = {name: values[:, :m] for name in names if (values := getattr(self, name)) is not None}
        some |= {"cables": self.cables[:m], "reasons": self.reasons[:m], "angles": self.angles[:m]}
        frames = None if self.frames is None else (self.frames[0][:, :m], self.frames[1][:, :m])
        return replace(self, **some, frames=frames, encoders=0)

    def part(self, rows: slice) -> "Lengths":
        """Return the same for some of the samples."""
        named = {f.name: getattr(self, f.name) for f in fields(self)}
        some: dict[str, Any] = {name: values[rows] for name, values in named.items() if isinstance(values, np.ndarray)}
        reasons = tuple(tuple(why._replace(mask=why.mask[rows]) for why in each) for each in self.reasons)
        frames = None if self.frames is None else (self.frames[0][rows], self.frames[1][rows])
        return replace(self, **some, reasons=reasons, frames=frames)

    @property
    def u_mm(self) -> FloatArray | None:
        """Return (n, m) standard uncertainties of the lengths besides the rounding of counts: from the instants of counting and from
        straight lines between samples. None without either."""
        if self.u_time_s is None:
            return self.missed_mm
        late = self.u_time_s * self.speed_mm_s
        return late if self.missed_mm is None else np.hypot(late, self.missed_mm)

    @cached_property
    def speed_mm_s(self) -> FloatArray:
        """(n, m) speeds of the cables, zero where they are not known."""
        if len(self.time_s) < 2:
            return np.zeros_like(self.change_mm)
        return np.asarray(np.nan_to_num(np.gradient(self.change_mm, self.time_s, axis=0)))

    def columns(self) -> dict[str, Any]:
        """Columns of a lengths file."""
        out: dict[str, Any] = {"time_s": self.time_s}
        angles = self.angles or tuple(i >= self.lengths for i in range(len(self.cables)))
        out |= {f"{name}_{'rad' if angles[i] else 'mm'}": self.change_mm[:, i] for i, name in enumerate(self.cables)}
        out |= {f"{name}_count": self.counts[:, i] for i, name in enumerate(self.cables)}
        return out | {"status": core.words(self.flags), "cause": self.cause, "cable": self.cable}


def write_lengths(path: Path, lengths: Lengths) -> None:
    """Write changes of length as .csv or .parquet.

    Parameters
    ----------
    path
        File to write: time_s, `<cable>_mm` and `<cable>_count` per cable, status, cause, cable.
    lengths
        Lengths of a run.

    Examples
    --------
    >>> lm.write_lengths(Path("lengths.parquet"), lm.lengths_from_counts(run))
    """
    files.write_table(path, lengths.columns(), lambda: {"messages": json.dumps(table_of(lengths.cause.tolist()))})


def read_lengths(path: Path) -> Lengths:
    """Read a file that `write_lengths` wrote.

    Parameters
    ----------
    path
        .csv or .parquet.

    Returns
    -------
    Lengths
        Changes of length [mm].

    Raises
    ------
    FileFormatError
        If the file is wrong. The message names row and column.

    Examples
    --------
    >>> lm.write_lengths(Path("lengths.csv"), lm.lengths_from_counts(run))
    >>> lm.read_lengths(Path("lengths.csv")).cables[:2]
    ('c1', 'c2')
    """
    table = files.read_table(path)
    columns = [c for c in table.columns if c.endswith(("_mm", "_rad"))]
    names = tuple(c.rsplit("_", 1)[0] for c in columns)
    if not names:
        raise core.FileFormatError(message("error.has_no_column_cable", where=path))
    angles = tuple(c.endswith("_rad") for c in columns)
    time_s, change_mm = table.numbers("time_s"), table.matrix(columns, gaps=True)
    counts, flags = table.matrix([f"{n}_count" for n in names], gaps=True), table.choices("status", core.WORDS)
    cause = of_file(table.labels("cause"), json.loads(table.kept("messages") or "[]"))
    return Lengths(time_s, names, change_mm, counts, flags, cause, table.labels("cable"), encoders=sum(angles), angles=angles)


def span_lengths(rig: Rig, rows: FloatArray, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """Return the readings of all channels at poses: cable lengths [mm] and angles [rad].

    Parameters
    ----------
    rig
        The rig.
    rows
        (n, 7) poses base_from_tool: position [mm] and unit quaternion x, y, z, w.
    cables
        Channels of interest; by default all of the rig.

    Returns
    -------
    ndarray
        (n, m): length from the observation point over its pulley to the attachment point, or the angle of an encoder.

    Raises
    ------
    GeometryError
        If a cable cannot run there. The message names pose and cable.

    Examples
    --------
    >>> lm.span_lengths(rig, np.array([[0.0, 0, 0, 0, 0, 0, 1]])).shape
    (1, 6)
    """
    rows = np.ascontiguousarray(rows, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != POSE:
        # a kernel would read on behind the end of a row
        raise core.GeometryError(message("error.poses_of_shape_wanted_are", shape=str(rows.shape), pose=POSE))
    off = np.flatnonzero(np.abs(np.linalg.norm(rows[:, 3:], axis=1) - 1.0) > NEARLY_UNIT)
    if len(off):
        i = int(off[0])
        raise core.GeometryError(message("error.pose_its_quaternion_is", i=i + 1, norm=np.linalg.norm(rows[i, 3:])))
    chosen = rig.cable if cables is None else cables
    out = kernels.span_lengths(rig.cable_rows(chosen), rows)
    bad = np.argwhere(~np.isfinite(out))
    if len(bad):
        i, j = (int(x) for x in bad[0])
        if not chosen[j].is_cable and chosen[j].kind not in ("swivel", "inclination"):
            raise core.GeometryError(message("error.pose_has_no_reading", i=i + 1, kind=chosen[j].kind, name=chosen[j].name))
        if not chosen[j].from_point:
            raise core.GeometryError(message("error.pose_inclination_its_axis", i=i + 1, name=chosen[j].name))
        ends = {"to_point": chosen[j].to_point, "from_point": chosen[j].from_point}
        raise core.GeometryError(message("error.pose_cable_lies_on", i=i + 1, name=chosen[j].name, **ends))
    return np.asarray(out)


def counts_from_poses(
    rig: Rig,
    rows: FloatArray,
    zero: FloatArray,
    cables: tuple[Observed, ...] | None = None,
    *,
    temperature_c: FloatArray | None = None,
    zero_temperature_c: float | None = None,
) -> FloatArray:
    """(n, m) true counts k, not rounded, at (n, 7) poses when the counters were zeroed at the pose zero (7,), of cables first and then of
    other channels, absolute ones from their own zero, and without the play of any.

    temperature_c (n,) at the poses and zero_temperature_c at the zero pose, the rig's reference where not given, matter only to rigs that
    state effects (`lmeasure.sensors.cable_effects`). GeometryError names a cable that cannot run, or carries no tension.
    """
    chosen = rig.cable if cables is None else cables
    every = span_lengths(rig, np.vstack([zero[None, :], rows]), chosen)
    channel_rows, m = rig.cable_rows(chosen), sum(c.is_cable for c in chosen)
    absolute = np.array([rig.counter(c).absolute for c in chosen])
    angles = [not c.is_length for c in chosen]
    # readings of angles continue along the motion, also beyond half a turn
    every[:, angles] = np.unwrap(every[:, angles], axis=0)
    all_counts = np.asarray(kernels.counts_from_changes(channel_rows, every[1:] - np.where(absolute, 0.0, every[0])))
    cables = cables_among(chosen)
    effects = effects_of(rig, cables)
    if effects is None:
        return all_counts
    changes, counts, cable_rows = every[1:, :m] - every[0, :m], all_counts[:, :m], channel_rows[:m]
    start = zero_at(zero, m, effects.reference_c if zero_temperature_c is None else zero_temperature_c)
    warm = np.full(len(rows), effects.reference_c) if temperature_c is None else np.asarray(temperature_c, dtype=np.float64)
    warm = np.repeat(warm[:, None], m, axis=1)
    # the excess hardly depends on the count: each round gains three digits or more
    for _ in range(MAX_ROUNDS):
        before = counts
        excess = effects.checked_excess(cable_rows, start, rows, counts, temperature_c=warm)
        counts = np.asarray(kernels.counts_from_changes(cable_rows, changes + excess))
        if not np.abs(counts - before).max(initial=0.0) > 1e-9:
            break
    return np.column_stack([counts, all_counts[:, m:]])


def recorded_from_counts(
    rig: Rig, counts: FloatArray, cables: tuple[Observed, ...] | None = None, phase: FloatArray | None = None
) -> FloatArray:
    """(n, m) counts as the encoders record them: whole, with sign and scale, wrapped to signed counters of the stated width; phase (m,) as
    `sensors.lengths.drawn_phases` has it, zero by default."""
    chosen = rig.cable if cables is None else cables
    within = np.zeros(len(chosen)) if phase is None else phase
    out = np.empty_like(counts)
    for j, c in enumerate(chosen):
        drum = rig.counter(c)
        values = np.rint(drum.count_sign * drum.scale * (counts[:, j] + _play(drum, counts[:, j])) + within[j])
        if drum.codes is not None:
            values = values % drum.codes
        elif drum.counter_bits is not None:
            half = 2.0 ** (drum.counter_bits - 1)
            values = (values + half) % (2 * half) - half
        out[:, j] = values
    return out


def changes_from_counts(rig: Rig, counts: FloatArray, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(n, m) changes of the free cables [mm] from (n, m) true counts, of encoders of angles [rad]."""
    return np.asarray(kernels.changes_from_counts(rig.cable_rows(cables), np.ascontiguousarray(counts)))


def rounding_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) variance [mm^2, rad^2] of a length or angle by the rounding of its count: uniform within half a recorded count."""
    return np.array([(rig.counter(c).per_count / rig.counter(c).scale) ** 2 / 12.0 for c in (rig.cable if cables is None else cables)])


def count_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """Return the (m,) variance [mm^2, rad^2] of a length or angle read in whole counts: uniform within half a recorded count, plus a
    sensor's stated one for its readings; independent."""
    chosen = rig.cable if cables is None else cables
    return rounding_variance(rig, chosen) + np.array([rig.counter(c).u_reading ** 2 for c in chosen])


def _play(counter: Drum | SensorTable, counts: FloatArray, state: FloatArray | None = None) -> FloatArray:
    """(n,) counts that a swivel's reading is off by its play, by the way it turned last in true counts (n,); state as that of
    `last_travel`."""
    width = getattr(counter, "backlash_deg", None)
    if not width:
        return np.zeros(len(counts))
    half = width / 720.0 * counter.counts_per_revolution
    return np.asarray(half * last_travel(counts[:, None], np.ones(1), state)[:, 0])


def _lag(drum: Drum, counts: FloatArray, state: FloatArray | None) -> FloatArray:
    """(n,) true counts that a drum's counter is behind by play, by the way it turned last, from counts (n,); state as that of
    `last_travel`."""
    if not drum.backlash_counts:
        return np.zeros(len(counts))
    return np.asarray(drum.backlash_counts / drum.scale * last_travel(counts[:, None], np.full(1, 1.0 / drum.scale), state)[:, 0])


COUNTER_STATE = kernels.STATE + 2  # Of a counter from one piece of a run to the next: as the kernel has it, and which way it turned last


def lengths_from_counts(run: Run, counters: FloatArray | None = None) -> Lengths:
    """Convert the counts of a run to changes of cable length, on the time base of pass 1.

    Parameters
    ----------
    run
        The run. Later passes must share the clock of pass 1.
    counters
        (m, k) state of the counters between the pieces of a long run, zeros at first; changed in place. None: the run is whole.

    Returns
    -------
    Lengths
        Changes since zeroing [mm; rad for encoders of angles]. Samples with a gap or a jump are flagged; nothing is filled in.

    Raises
    ------
    LMeasureError
        If a count is impossible. The message names sample and cable.

    Examples
    --------
    >>> lm.lengths_from_counts(run).change_mm.shape
    (58, 6)
    """
    time_s = run.passes[0].time_s
    observed = run.rig.observed
    n, m = len(time_s), len(observed)
    gone_on = np.full((n, m), np.nan)
    reasons: list[Reasons] = []
    notes: list[Message] = []
    believed: dict[str, dict[str, tuple[Drum | SensorTable, float]]] = {p.source: {} for p in run.passes}
    missed_mm = np.zeros((n, m))
    others: dict[tuple[int, int], core.OtherTimes | None] = {}
    frames = np.full((n, m), np.nan), np.full((n, m), np.nan)
    skewed = any(p.u_time_s is not None for p in run.passes)
    u_time = np.zeros((n, m)) if skewed else None
    warm = np.empty((n, m)) if any(p.temperature_c is not None for p in run.passes) else None
    for j, c in enumerate(observed):
        counts = run.passes[c.passage - 1]
        drum = run.rig.counter(c)
        state = None if counters is None else counters[j]
        column = counts.channels.index(c.channel) if c.channel in counts.channels else 0
        at_s = counts.time_s if counts.stamp_s is None or counts.frames is not None else np.ascontiguousarray(counts.stamp_s[:, column])
        # an absolute sensor without codes does not wrap
        fresh = np.zeros(kernels.STATE) if state is None and drum.absolute and drum.codes is None else state
        counter = unwrap(
            counts.of(c.channel), at_s, max_rate=drum.rate, bits=drum.counter_bits, stated=drum.rate_stated, state=fresh, codes=drum.codes
        )
        if counter.inferred_bits is not None:
            notes.append(message("counts.bits", source=counts.source, channel=c.channel, bits=counter.inferred_bits))
        if counter.believed_rate is not None and state is None:
            believed[counts.source][c.channel] = drum, counter.believed_rate
        values = counter.counts * drum.count_sign / drum.scale
        way = None if state is None else state[None, kernels.STATE :]
        values += -_play(drum, values, way) if isinstance(drum, SensorTable) else _lag(drum, values, way)
        why = reasons_of(counter, c.channel, drum, at_s)
        if c.passage > 1 or at_s is not counts.time_s:
            key = c.passage, -1 if at_s is counts.time_s else column
            if key not in others:
                others[key] = other_times(at_s, time_s)
            times = others[key]
            own = values
            if times is not None:
                values, missed, why = on_time_base(c.passage, times, values, why, drum=drum)
                missed_mm[:, j] = missed * drum.per_count
            if c.passage == 1:
                frames[0][:, j], frames[1][:, j] = at_s, own - values
        gone_on[:, j] = values
        reasons.append(why)
        if u_time is not None and counts.u_time_s is not None:
            u_time[:, j] = counts.u_time_s if c.passage == 1 else np.interp(time_s, counts.time_s, counts.u_time_s)
        if warm is not None:
            warm[:, j] = np.nan if counts.temperature_c is None else np.interp(time_s, counts.time_s, counts.temperature_c)
    notes += [note for source, rates in believed.items() for note in rate_notes(source, rates)]
    cables, nothing = tuple(c.name for c in observed), np.zeros(n, np.int64)
    none, encoders = np.full(n, "", dtype=np.object_), m - len(run.rig.cable)
    whole = Lengths(time_s, cables, gone_on, gone_on, nothing, none, none, tuple(notes), u_time, warm, gone_on, encoders=encoders)
    whole = replace(whole, angles=tuple(not c.is_length for c in observed))
    if run.passes[0].stamp_s is not None and run.passes[0].frames is None:
        whole = replace(whole, frames=frames)
    return with_reasons(run.rig, replace(whole, missed_mm=missed_mm if missed_mm.any() else None), tuple(reasons))


def with_reasons(rig: Rig, lengths: Lengths, reasons: tuple[Reasons, ...]) -> Lengths:
    """The same lengths, each channel used but for these reasons."""
    assert lengths.gone_on is not None
    n, k = len(lengths.time_s), lengths.gone_on.copy()
    flags = np.zeros(n, np.int64)
    cause, where = np.full(n, "", dtype=np.object_), np.full(n, "", dtype=np.object_)
    for j, (c, why) in enumerate(zip(rig.observed, reasons, strict=True)):
        for mask, flag, said in why:
            k[mask, j] = np.nan
            first = mask & (flags == Status.OK)
            flags[first], cause[first], where[first] = flag, said, c.name
    change_mm = changes_from_counts(rig, k, rig.observed)
    return replace(lengths, change_mm=change_mm, counts=k, flags=flags, cause=cause, cable=where, reasons=reasons)


def channel_message(channel: Observed) -> Message:
    """Return a channel by its kind and name."""
    if channel.kind in ("cable", "swivel", "inclination", "distance"):
        return message(f"channel.{channel.kind}", name=channel.name)
    return message("channel.sensor", kind=channel.kind, name=channel.name)


def zero_temperature(lengths: Lengths, stated: float | None) -> float | None:
    """Temperature [deg C] at which the counters were zeroed: the one stated for the run, else that of the first sample that has one."""
    if stated is not None or lengths.temperature_c is None:
        return stated
    known = lengths.temperature_c[np.isfinite(lengths.temperature_c)]
    return float(known[0]) if len(known) else None


def length_residuals(run: Run, poses: FloatArray) -> FloatArray:
    """(n, m) residuals [mm] of each cable at (n, 7) poses on the time base of pass 1, as `lengths_from_counts` has it: change by the counts
    minus change by the model. Of a run whose start is unknown they are about their mean.

    NaN where the pose or the count is not known.
    """
    return LengthResiduals(run.rig, run.start, run.temperature_c).of(lengths_from_counts(run), poses)


class LengthResiduals:
    """`length_residuals` of a run from its start pose (7,), given the lengths of one piece of it after the other.

    start: None if it is unknown: the cable length at zeroing is then the one without a mean residual in the first piece that determines it.
    temperature_c is that at the start; None: that of the first sample with one.
    """

    def __init__(self, rig: Rig, start: FloatArray | None, temperature_c: float | None = None) -> None:
        self._rows, self._effects = rig.cable_rows(), effects_of(rig)
        self._start, self._temperature_c = start, temperature_c
        m = len(self._rows)
        self._begun = np.full((1, m), np.nan) if start is None else kernels.span_lengths(self._rows, start[None, :])

    def of(self, lengths: Lengths, poses: FloatArray) -> FloatArray:
        """(n, m) residuals [mm] at the piece's (n, 7) poses."""
        lengths = lengths.of_cables()
        modelled = kernels.span_lengths(self._rows, np.ascontiguousarray(poses))
        known = np.flatnonzero(np.isfinite(poses[:, 0]))
        if self._start is None and len(known):
            self._start = poses[known[0]]
        effects = self._effects
        if effects is not None and self._start is not None:
            self._temperature_c = zero_temperature(lengths, self._temperature_c)
            start = zero_at(self._start, len(self._rows), effects.reference_c if self._temperature_c is None else self._temperature_c)
            warm = np.tile(start.temperature_c, (len(poses), 1)) if lengths.temperature_c is None else lengths.temperature_c
            warm = np.where(np.isfinite(warm), warm, start.temperature_c)
            modelled = modelled + effects.excess(self._rows, start, poses, lengths.counts, temperature_c=warm)
        out = modelled - lengths.change_mm
        determined = np.isnan(self._begun[0]) & np.isfinite(out).any(axis=0)
        self._begun[0, determined] = np.nanmean(out[:, determined], axis=0)
        return np.asarray(self._begun - out)


def zeroed_exactly(rig: Rig, cables: tuple[Observed, ...] | None = None) -> BoolArray:
    """(m,) whether a recorded count of zero is k = 0 exactly; an absolute encoder is not zeroed at all."""
    chosen = rig.cable if cables is None else cables
    return np.array([rig.counter(c).zero_exact or rig.counter(c).absolute for c in chosen], dtype=np.bool_)


def drawn_phases(rig: Rig, rng: "np.random.Generator", cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) where within a recorded count the cables' counters were zeroed: one draw within +-1/2 for each zeroing, 0 for one that is
    exact."""
    of = rig.zeroings(cables)
    drawn = rng.uniform(-0.5, 0.5, len(np.unique(of)))[of]
    return np.where(zeroed_exactly(rig, cables), 0.0, drawn)


def phase_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) variance [mm^2] of a length by where within a count its counter was zeroed: uniform within half a recorded count, the same for
    all rows counted from one zeroing (`Rig.zeroings`); 0 where the zero is exact."""
    return np.where(zeroed_exactly(rig, cables), 0.0, rounding_variance(rig, cables))


def phase_columns(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """Return (m, z) effects on the lengths [mm] of one standard deviation of each zeroing's sub-count offset, if it is not exact."""
    u_mm, of = np.sqrt(phase_variance(rig, cables)), rig.zeroings(cables)
    return np.where(of[:, None] == np.unique(of[u_mm > 0.0]), u_mm[:, None], 0.0)


def length_variance(rig: Rig, cables: tuple[Observed, ...] | None = None) -> FloatArray:
    """(m,) variance [mm^2] of a single length: of the count and of where it was zeroed."""
    return count_variance(rig, cables) + phase_variance(rig, cables)
