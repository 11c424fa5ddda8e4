"""Assembly of counts from frames: the rig's assembler, whole batches at once, and faults that only the whole run shows."""

import itertools
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.bus.frames import Frames, no_frames
from lmeasure.acquisition.bus.network import NetworkWatch, Word, misfits
from lmeasure.acquisition.counters.clock import SURE, Clock, earliest
from lmeasure.acquisition.counters.counters import CounterState, DeviceReport, StartLine, Unit, note_values, started_late
from lmeasure.acquisition.counters.decoders import CounterField, decode
from lmeasure.acquisition.counters.events import Event, EventLog
from lmeasure.acquisition.counters.origins import longest_interval
from lmeasure.acquisition.counters.samples import LONGEST_HOLD_S, PERIODS, Assembler, Samples, SyncAssembler, pace, paused, tie
from lmeasure.acquisition.counters.stalls import mark_stalls
from lmeasure.core import AcquisitionError, BoolArray, FloatArray, IntArray
from lmeasure.recording import Counts, joined_counts
from lmeasure.rig import Drum, Rig, SensorTable
from lmeasure.text import composed, message

NO_SYNC = -1
APART_S = 2e-6
"""Between the frames of two samples at least: files keep microseconds."""
LONGEST_GAP = 2.5
"""Periods between two readings of a channel over which its count is still interpolated."""
WAIT_S = 1.0
"""A channel that is silent for longer is not waited for."""


def scatter(intervals: FloatArray) -> float:
    """Standard deviation [s] of the intervals (n,) of a regular timer's stamps, without its pauses.

    The median absolute deviation, or the mean one where that is larger: intervals behind a serial adapter are nothing or 16 ms, most of
    them the same.
    """
    period = pace(intervals)
    off = np.abs(intervals - period)
    off = off[off <= LONGEST_GAP * period]
    return max(1.4826 * float(np.median(off)), math.sqrt(math.pi / 2.0) * float(off.mean())) if len(off) else 0.0


class FreeAssembler:
    """Samples at the instants of the first channel's frames, the others interpolated linearly between their own.

    u_time_s: the standard uncertainty of the stamps, from how far the intervals between frames of a regular timer scatter (over sqrt 2,
    because two stamps make an interval), the root mean square over the channels.
    """

    def __init__(
        self, fields: tuple[CounterField, ...], counters: tuple[CounterState, ...], events: EventLog, start_line: StartLine | None = None
    ) -> None:
        self.fields, self.counters, self.events, self._start_line = fields, counters, events, start_line
        self._watch = NetworkWatch(fields, NO_SYNC)
        self._words: list[tuple[float, Word]] = []
        self._ends: list[list[tuple[float, Word]]] = [[] for _ in fields]
        """Words that concern the origin of each channel, until its next reading."""
        self._clock = Clock(fields, None)
        self.given = 0
        self.stamps_moved_s = 0.0
        m = len(fields)
        self._new: list[tuple[FloatArray, IntArray]] = [(np.empty(0), np.empty(0, np.int64))] * m
        self._silent: list[FloatArray] = [np.empty(0)] * m
        """Times at which each channel reported that it has no count."""
        self._old: list[tuple[FloatArray, FloatArray]] = [(np.empty(0), np.empty(0))] * m
        self._intervals: list[FloatArray] = [np.empty(0)] * m
        self._period: list[float | None] = [None] * m
        self._scatter = np.zeros(m)
        self._instant = np.full(m, np.nan)
        """Latest time of the last reading of each channel."""
        self._given_to = -math.inf
        self._used_s = np.full(m, -math.inf)
        """Time of the last frame of each channel that a sample uses as its own."""
        self._started: tuple[FloatArray, FloatArray] = (np.full(1, -math.inf), np.zeros(1))
        """Times and states of the start input; the first is the state before all frames."""

    def feed(self, frames: Frames, last: bool = False) -> Samples:
        """Take a batch; give the samples that are now known. last: nothing follows, give all."""
        frames = self._clock.feed(frames, last)
        if self._start_line is not None:
            rows, states = self._start_line.states(frames)
            self._started = np.concatenate([self._started[0], frames.time_s[rows]]), np.concatenate([self._started[1], states[1:]])
        readings = decode(frames, self.fields)
        for i, field in enumerate(self.fields):
            mine = readings.field == i
            times, values = self._new[i]
            self._new[i] = np.concatenate([times, frames.time_s[readings.frame[mine]]]), np.concatenate([values, readings.value[mine]])
            silent = readings.void[readings.void[:, 1] == i]
            self._words += [(float(frames.time_s[k]), Word(k, "no_value", field.why_no_count(v), (i,))) for k, _, v in silent.tolist()]
            self._silent[i] = np.concatenate([self._silent[i], frames.time_s[silent[:, 0]]])
        note_values(self.events, self.fields, readings)
        for word in [*self._watch.words(frames), *misfits(self.fields, readings)]:
            self._words.append((float(frames.time_s[word.row]), word))
            for c in word.of if word.origin else ():
                self._ends[c].append(self._words[-1])
        if self._clock.repairs:
            ahead = np.concatenate([self._old[0][0], self._new[0][0]])
            ahead = np.sort(ahead[ahead > self._given_to])
            tie(self._clock.repairs, ahead, lambda row: self.given + row, self.events)
        latest = [
            float(max(new[0].max(initial=-math.inf), old[0].max(initial=-math.inf))) for new, old in zip(self._new, self._old, strict=True)
        ]
        known = max(latest) if last else max(min(latest), max(latest) - WAIT_S)
        if not math.isfinite(known):
            return self._samples(np.empty(0), known, last)
        for i in range(len(self.fields)):
            self._take(i, known, last)
        for i in started_late(self.counters, self.events):
            self._old[i] = self._old[i][0], np.full(len(self._old[i][0]), np.nan)
        # a sample waits until every channel's next reading can be there
        horizon = known if last else known - LONGEST_GAP * max((p for p in self._period if p is not None), default=0.0)
        reference = self._old[0][0]
        return self._samples(reference[(reference > self._given_to) & (reference <= horizon)], horizon, last)

    def _event(self, sample: int, time_s: float, i: int, kind: str, text: str = "") -> None:
        self.events.add(Event(sample, time_s, self.fields[i].channel, kind, text))

    def _take(self, i: int, known: float, last: bool) -> None:
        """Readings up to the known time, put in order, doubles dropped, into the channel's counts."""
        times, values = self._new[i]
        silent, self._silent[i] = self._silent[i][self._silent[i] <= known], self._silent[i][self._silent[i] > known]
        if len(silent):
            self._put(i, silent, np.full(len(silent), np.nan))
        if len(times) == 0:
            return
        for k in np.flatnonzero(np.diff(times) < 0) + 1:
            self._event(self.given, float(times[k]), i, "reordered", message("event.late", seconds=float(times[k - 1] - times[k])))
        order = np.argsort(times, kind="stable")
        times, values = times[order], values[order]
        due = times <= known
        period = self._period[i] or 0.0
        if not last and period and len(times):
            # behind a silence it takes a while to see whether stamps were late
            waits = (np.diff(times, prepend=times[0]) > LONGEST_GAP * period) & (times > times[-1] - LONGEST_HOLD_S)
            due &= ~np.maximum.accumulate(waits)
        self._new[i] = times[~due], values[~due]
        times, values = times[due], values[due]
        counter = self.counters[i]
        last_time = counter.time_s if counter.seen else -math.inf
        late = times < last_time
        for k in np.flatnonzero(late):
            self._event(self.given, float(times[k]), i, "conflict", message("event.past"))
        times, values = times[~late], values[~late]
        intervals = np.diff(times, prepend=last_time if counter.seen else times[:1])
        self._intervals[i] = np.concatenate([self._intervals[i], intervals[0 if counter.seen else 1 :]])[-PERIODS:]
        if len(self._intervals[i]) > 2:
            self._period[i] = pace(self._intervals[i])
            self._scatter[i] = scatter(self._intervals[i]) / math.sqrt(2.0)
        double = self._doubles(i, times, values, last_time)
        for k in np.flatnonzero(double):
            kind = "duplicate" if values[k] == (values[k - 1] if k else counter.value) else "conflict"
            self._event(self.given, float(times[k]), i, kind, "" if kind == "duplicate" else message("event.same_time"))
        times, values = times[~double], values[~double]
        samples = np.full(len(times), self.given, np.int64)
        if i == 0:
            samples += np.arange(len(times))
        elif len(self._old[0][0]):
            samples += np.searchsorted(self._old[0][0][self._old[0][0] > self._given_to], times)
        period = self._period[i] or 0.0
        at = np.concatenate([self._instant[i : i + 1], earliest(times, SURE * period)])
        passed = np.nan_to_num(np.diff(at))
        for word_s, word in self._ends[i]:
            if len(times) and word_s <= times[-1]:
                ahead = self._old[0][0][self._old[0][0] > self._given_to] if i else times
                at_row, first = int(np.searchsorted(ahead, word_s)), int(samples[np.searchsorted(times, word_s)])
                shown = float(ahead[at_row]) if at_row < len(ahead) else word_s
                counter.words.append(DeviceReport(self.given + at_row, shown, word.text, word.origin, first))
        self._ends[i] = [(word_s, word) for word_s, word in self._ends[i] if not len(times) or word_s > times[-1]]
        longest = longest_interval(period, live=False)
        counts = counter.advance(values, times, samples, self.events, least_s=period, passed_s=passed, longest_s=longest)
        self._instant[i] = at[-1]
        if i == 0:
            for k in np.flatnonzero(paused(passed, period)):
                self.events.add(Event(int(samples[k]), float(times[k]), "", "pause", message("event.no_count", seconds=float(passed[k]))))
        self._put(i, times, counts)

    def _put(self, i: int, times: FloatArray, counts: FloatArray) -> None:
        """Put readings among those of a channel, by their times."""
        all_times, all_counts = np.concatenate([self._old[i][0], times]), np.concatenate([self._old[i][1], counts])
        order = np.argsort(all_times, kind="stable")
        self._old[i] = all_times[order], all_counts[order]

    def _doubles(self, i: int, times: FloatArray, values: IntArray, last_time: float) -> BoolArray:
        if len(times) == 0:
            return np.zeros(0, np.bool_)
        period = self._period[i] or 0.0
        counter = self.counters[i]
        before_t = np.concatenate([[last_time], times[:-1]])
        same = np.concatenate([[counter.seen and int(values[0]) == counter.value], values[1:] == values[:-1]])
        return np.asarray((same & (times - before_t < 0.25 * period)) | (times == before_t))

    def _say(self, time_s: FloatArray, last: bool) -> None:
        """Give words as events of the samples at the times (n,) that follow them."""
        later = []
        for at, word in self._words:
            row = int(np.searchsorted(time_s, at))
            if row == len(time_s) and not last:
                later.append((at, word))
                continue
            shown = float(time_s[row]) if row < len(time_s) else at
            for channel in [self.fields[c].channel for c in word.of] or [""]:
                self.events.add(Event(self.given + row, shown, channel, word.kind, word.text))
        self._words = later

    def _samples(self, time_s: FloatArray, horizon: float, last: bool) -> Samples:
        """The samples at the times; readings that no later sample can need are let go."""
        n, m = len(time_s), len(self.fields)
        self._say(time_s, last)
        recorded = np.full((n, m), np.nan)
        own, at_s = np.full((n, m), np.nan), np.tile(time_s[:, None], (1, m))
        for i in range(m):
            times, counts = self._old[i]
            silent = np.zeros(n, np.bool_)
            if n:
                own[:, i], at_s[:, i] = self._own_frames(i, time_s)
            if len(times) and n:
                between, silent = self._interpolated(i, time_s)
                recorded[:, i] = self.counters[i].shown(between)
            for row in np.flatnonzero(np.isnan(recorded[:, i]) & ~silent):
                if not self.counters[i].lost:
                    self._event(self.given + int(row), float(time_s[row]), i, "gap")
            # one reading before the next sample is kept for it
            keep = max(int(np.searchsorted(times, horizon, side="right")) - 1, 0)
            self._old[i] = times[keep:], counts[keep:]
        if n:
            self._given_to = float(time_s[-1])
            self.given += n
        start = None
        if self._start_line is not None:
            times = np.maximum.accumulate(self._started[0])
            start = self._started[1][np.searchsorted(times, time_s, side="right") - 1]
            keep = max(int(np.searchsorted(times, horizon, side="right")) - 1, 0)
            self._started = times[keep:], self._started[1][keep:]
        skew = math.sqrt(float(np.mean(self._scatter**2)))
        return Samples(time_s, recorded, start, np.full(n, skew), (own, at_s))

    def _own_frames(self, i: int, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the counts (n,) of the frames of a channel next to the times (n,), each frame once, and when they came, increasing."""
        times, counts = self._old[i]
        half = 0.5 * (self._period[0] or math.inf)
        if not len(times):
            return np.full(len(time_s), np.nan), time_s.copy()
        near = np.maximum(np.searchsorted(times, time_s - half), np.searchsorted(times, self._used_s[i], side="right"))
        there = (near < len(times)) & (times[np.minimum(near, len(times) - 1)] < time_s + half)
        if not (np.diff(near) > 0).all():
            # several samples have the same frame next to them: the first takes it, the next one another if there is one
            following = 0
            for row, first in enumerate(near.tolist()):
                k = max(first, following)
                near[row], there[row] = k, k < len(times) and times[k] < time_s[row] + half
                following = k + 1 if there[row] else following
        near = np.minimum(near, len(times) - 1)
        at_s = np.where(there, times[near], time_s)
        late = np.flatnonzero(np.diff(at_s, prepend=self._used_s[i]) < APART_S)
        if len(late):
            # a frame between two samples belongs to the first
            for k in range(int(late[0]), len(at_s)):
                before = at_s[k - 1] if k else self._used_s[i]
                if at_s[k] < before + APART_S:
                    there[k], at_s[k] = False, max(time_s[k], before + APART_S)
        self._used_s[i] = at_s[-1]
        return np.where(there, self.counters[i].shown(counts[near]), np.nan), at_s

    def _interpolated(self, i: int, time_s: FloatArray) -> tuple[FloatArray, BoolArray]:
        """Counts at the times (n,), and where there is none because a reading beside has none."""
        times, counts = self._old[i]
        right = np.searchsorted(times, time_s, side="left")
        exact = times[np.minimum(right, len(times) - 1)] == time_s
        left = np.maximum(right - 1, 0)
        r = np.minimum(right, len(times) - 1)
        span = times[r] - times[left]
        longest = LONGEST_GAP * (self._period[i] or math.inf)
        part = (time_s - times[left]) / np.where(span > 0, span, 1.0)
        between = counts[left] + part * (counts[r] - counts[left])
        known = (right > 0) & (right < len(times)) & (span <= longest)
        silent = np.where(exact, np.isnan(counts[r]), np.isnan(counts[left]) | np.isnan(counts[r]))
        return np.asarray(np.where(exact, counts[r], np.where(known, between, np.nan))), np.asarray(silent)


STICK_MM, STICK_DEG = 0.2, 0.02
"""Deviation of a count from its line without a fault: a cable that sticks and slips, play."""
TIGHT_MM, TIGHT_DEG = 1.0, 0.1
"""Size of a motion across a gap below which a restart at zero would be detected."""
HARD_MM_S2, HARD_DEG_S2 = 50_000.0, 100_000.0
"""The hardest acceleration of any machine."""


@dataclass(frozen=True)
class Assembled:
    """Counts of one pass, the faults found on the way, and how many frames were looked at."""

    counts: Counts
    events: EventLog
    frames: int


def new_assembler(rig: Rig, fields: tuple[CounterField, ...], passage: int = 1) -> Assembler:
    """An assembler for the timing that the rig's `[can]` table states."""
    known, table = rig.counters_of(passage), rig.can_table
    counters = tuple(_counter(f, known[f.channel]) for f in fields)
    start_line = None if table.start_input is None else StartLine(table.start_input)
    if table.timing == "free":
        return FreeAssembler(fields, counters, EventLog(), start_line)
    return SyncAssembler(fields, counters, table.sync_id, EventLog(), start_line=start_line)


def _counter(field: CounterField, known: Drum | SensorTable) -> CounterState:
    """The state of a channel, its limits in the units of its device."""
    drum = isinstance(known, Drum)
    size = (known.per_count if drum else math.degrees(known.per_count)) * field.scale / known.scale
    slack, tight, hard, name = (STICK_MM, TIGHT_MM, HARD_MM_S2, "mm") if drum else (STICK_DEG, TIGHT_DEG, HARD_DEG_S2, "deg")
    hardest = known.max_cable_acceleration_mm_s2 if isinstance(known, Drum) else None
    return CounterState(
        field,
        known.rate / field.scale,
        wraps_later=known.counter_bits is not None or known.codes is not None,
        codes=known.codes is not None,
        unit=Unit(size, name, slack / size, tight / size, hard / size),
        acceleration=None if hardest is None else hardest / size,
        exact=known.zero_exact and isinstance(known, Drum),
    )


def counts_from_frames(
    rig: Rig, batches: Iterable[Frames], fields: tuple[CounterField, ...], passage: int = 1, *, source: str = "frames"
) -> Assembled:
    """Counts of one pass from batches of frames in the order of their reception; time_s is as the frames give it.

    AcquisitionError when there is not one sample.
    """
    assembler, frames = new_assembler(rig, fields, passage), 0

    def counted() -> Iterator[Frames]:
        nonlocal frames
        for batch in batches:
            frames += len(batch)
            yield batch

    counts = joined_counts(list(counts_in_pieces(rig, assembler, counted(), fields, source=source)))
    marked = mark_stalls(rig, counts, assembler.events, passage)
    return Assembled(counts if marked is None else marked, assembler.events, frames)


def counts_in_pieces(
    rig: Rig, assembler: Assembler, batches: Iterable[Frames], fields: tuple[CounterField, ...], *, source: str
) -> Iterator[Counts]:
    """Yield the counts of one pass as they are known, without marks of stalls; AcquisitionError when there is not one sample."""
    frames = first = 0
    channels = tuple(f.channel for f in fields)
    for batch in itertools.chain(batches, (None,)):
        samples = assembler.feed(no_frames(source) if batch is None else batch, last=batch is None)
        frames += 0 if batch is None else len(batch)
        if len(samples.time_s):
            frame, stamp_s = samples.frames or (None, None)
            start, skew = samples.start_input, samples.u_time_s
            yield Counts(samples.time_s, channels, samples.recorded, start, source, skew, first=first, stamp_s=stamp_s, frames=frame)
            first += len(samples.time_s)
    if not first:
        table = rig.can_table
        own = message("bus.frame_of_channel", channel=fields[0].channel)
        wanted = composed("SYNC {sync_id:#x}", sync_id=table.sync_id) if table.timing == "sync" else own
        raise AcquisitionError(message("error.frames_but_no_among", where=source, frames=frames, wanted=wanted))
