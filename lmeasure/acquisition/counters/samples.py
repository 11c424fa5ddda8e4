"""Assemble samples from frames: the counts of all channels at one instant. Unambiguous faults are repaired, all others marked."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.bus.frames import Frames
from lmeasure.acquisition.bus.network import ANSWERS, MOST, NetworkWatch, Transmission, Word, misfits, ordinal
from lmeasure.acquisition.counters.clock import LATE, SURE, Clock, Repair, earliest
from lmeasure.acquisition.counters.counters import CounterState, DeviceReport, StartLine, note_values, started_late
from lmeasure.acquisition.counters.decoders import CounterField, Readings, decode
from lmeasure.acquisition.counters.events import Event, EventLog
from lmeasure.acquisition.counters.origins import Evidence, longest_interval
from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels import tabulate
from lmeasure.text import joined as in_sequence, message

LONGEST_HOLD_S = 0.3
"""Longest time for which a sample waits for the end of a burst of late stamps."""
FIRST_HOLD_S = 1.0
"""The same for the first samples, until the period behind late stamps is known."""
FRAMES_OF_A_SYNC = 16
"""Frames per channel that are kept while no SYNC comes."""
PERIODS = 2048
"""Intervals from which the SYNC period is estimated: more than a busy host stamps at once."""
LAG = 64
"""Most intervals over which a host's stamps are compared: a serial adapter delivers the frames of 16 ms at once."""
LAGS = 8
"""There are at least so many times more intervals than are compared: few stretches then contain a pause of the bus."""
FIRST_INTERVALS = 16
"""Intervals that give a period in spite of a few lost SYNCs: until then no sample is returned."""
MANY_INTERVALS = 256
TICKED = 0.2
"""Part of the SYNCs of a log with the stamp of the one before, from which on it was stamped in ticks: it is judged by MANY_INTERVALS."""
FIRST_PERIOD_S = 1e-3
"""SYNC period until enough SYNCs have come."""
IN_A_ROW = 2
"""Most answers of a channel that come behind the next SYNC one after the other."""
MISSED = 0.75
"""Frames that come later than so many periods behind a SYNC answer the next one, which is missing."""
HELD_UP_S = 0.05
"""Longest delay of a sender between a SYNC and its answer."""
LONG = 2.5
"""Periods: a longer interval may be that of a late stamp."""


def tie(repairs: list[Repair], time_s: FloatArray, sample: Callable[[int], int], events: EventLog) -> None:
    """Tie repairs of the clock to the first sample at their time or later, among samples at times (n,); sample: number of a row."""
    for repair in repairs:
        row = int(np.searchsorted(time_s, repair.time_s - 1e-9))
        events.add(Event(sample(row), repair.time_s, "", repair.kind, repair.text))
    repairs.clear()


def paused(intervals_s: FloatArray, period_s: float) -> BoolArray:
    """Return in which of the intervals (n,) the bus, or its SYNC, paused."""
    return np.asarray(intervals_s > longest_interval(period_s, live=True))


@dataclass(frozen=True)
class Samples:
    """Hold samples that are ready to be written.

    time_s (n,); recorded (n, m) counts, NaN if there is none; start_input (n,) 0 or 1 if the rig has one; u_time_s (n,) standard
    uncertainty of the channels' instants relative to the sample's, unless all were latched together; frames: then the channels' own counts
    (n, m), NaN where a sample has none, and when these came (n, m).
    """

    time_s: FloatArray
    recorded: FloatArray
    start_input: FloatArray | None = None
    u_time_s: FloatArray | None = None
    frames: tuple[FloatArray, FloatArray] | None = None


def joined(parts: Sequence[Samples]) -> Samples:
    """Return the samples of one assembler, one part after the other."""
    start = [p.start_input for p in parts if p.start_input is not None]
    skew = [p.u_time_s for p in parts if p.u_time_s is not None]
    frames = [p.frames for p in parts if p.frames is not None]
    return Samples(
        np.concatenate([p.time_s for p in parts]),
        np.vstack([p.recorded for p in parts]),
        np.concatenate(start) if start else None,
        np.concatenate(skew) if skew else None,
        (np.vstack([own for own, _ in frames]), np.vstack([at_s for _, at_s in frames])) if frames else None,
    )


@dataclass(frozen=True)
class _CounterFrame:
    """State a message, its time, the SYNC before it (-1: none), and which of its channels had already answered that SYNC."""

    word: Word
    time_s: float
    window: int
    answered: frozenset[int]


MISFITS = ("short_frame", "wider")


def pace(intervals: FloatArray) -> float:
    """Return the period [s] of a timer from the intervals (n,) of its stamps, which may be late, several of them at once.

    Delays at both ends of a stretch cancel on average. The result is the mean of the middle third of the means over LAG intervals: few
    stretches contain a pause of the timer.
    """
    lag = max(min(LAG, len(intervals) // LAGS), 1)
    stamps = np.concatenate([[0.0], np.cumsum(intervals)])
    means = np.sort(stamps[lag:] - stamps[:-lag]) / lag
    third = len(means) // 3
    return float(means[third : len(means) - third].mean())


class Assembler(Protocol):
    """Take frames in the order of reception; return samples once no later frame can change them.

    given: number of samples so far; stamps_moved_s: largest shift of a sample's time back from a busy host's stamp.
    """

    events: EventLog
    given: int
    stamps_moved_s: float

    def feed(self, frames: Frames, last: bool = False) -> Samples:
        """Take a batch; return the samples that are now known. last: nothing follows, return all."""


class SyncAssembler:
    """Assemble samples of encoders that latch at SYNC and then send.

    A sample is a SYNC and the frames up to the next one. It is returned when the frames after the next SYNC are known too: a frame on the
    wrong side of its SYNC can then be put back. SYNCs that some channel does not answer, by its transmission type, are no samples.
    """

    def __init__(
        self,
        fields: tuple[CounterField, ...],
        counters: tuple[CounterState, ...],
        sync_id: int,
        events: EventLog,
        *,
        start_line: StartLine | None = None,
    ) -> None:
        self.fields, self.counters, self.events = fields, counters, events
        self._sync_id, self._start_line = sync_id, start_line
        self._watch = NetworkWatch(fields, sync_id)
        self._words: list[_CounterFrame] = []
        self._void: IntArray = np.empty((0, 3), np.int64)
        self._clock = Clock(fields, sync_id)
        self.transmission = Transmission(len(fields))
        self._decided = False
        self._evidence = Evidence(counters)
        self._sync_time: FloatArray = np.empty(0)
        self._intervals: FloatArray = np.empty(0)
        self._started: FloatArray = np.empty(0)
        self._window: IntArray = np.empty(0, np.int64)
        self._field: NDArray[np.int16] = np.empty(0, np.int16)
        self._value: IntArray = np.empty(0, np.int64)
        self._at: FloatArray = np.empty(0)
        self._period: float | None = None
        self._last_time = -np.inf
        self._last_seen = np.full(len(fields), -1), np.full(len(fields), np.nan)
        """Number and time of the last SYNC that each channel answered."""
        self._sync_number: IntArray = np.empty(0, np.int64)
        self._last_instant: FloatArray = np.empty(0)
        self._time_shift = 0.0
        self._late_stamps = self._log = False
        self.stamps_moved_s = 0.0
        self.syncs = self.given = 0
        self._latest_s = -np.inf
        """Time of the last frame, without the shift of the times."""

    def feed(self, frames: Frames, last: bool = False) -> Samples:
        """Take a batch; return the samples that are now known. last: nothing follows, return all."""
        frames = self._clock.feed(frames, last)
        readings = decode(frames, self.fields, self._sync_id)
        self._hear(frames, readings)
        if self._start_line is not None:
            self._started = np.concatenate([self._started, self._start_line.before(frames, readings.sync)])
        window = readings.window - 1 + len(self._sync_time)
        begun = slice(int(np.searchsorted(window, 0)), None)  # earlier frames answer a SYNC before the recording
        if len(frames):
            self._log = frames.timestamp_source == "log"
            self._late_stamps |= frames.timestamp_source == "host"
            self._latest_s = float(frames.time_s[-1])
        came = frames.time_s[readings.sync] + self._time_shift
        # of those before some are always kept until the last batch
        intervals = np.abs(np.diff(np.concatenate([self._sync_time[-1:], came])))
        self._intervals = np.concatenate([self._intervals, intervals])[-PERIODS:]
        self._sync_time = np.concatenate([self._sync_time, came])
        self._at = np.concatenate([self._at, frames.time_s[readings.frame[begun]] + self._time_shift])
        self._window = np.concatenate([self._window, window[begun]])
        self._field = np.concatenate([self._field, readings.field[begun]])
        self._value = np.concatenate([self._value, readings.value[begun]])
        tie(self._clock.repairs, self._sync_time, self._number, self.events)
        self._count_syncs(frames, readings.sync)
        self._forget_what_no_sync_ends()
        return self._give(last)

    def _forget_what_no_sync_ends(self) -> None:
        """Drop frames of encoders that send on after the SYNC has stopped: they belong to no sample."""
        surplus = np.flatnonzero(self._window == len(self._sync_time) - 1)[FRAMES_OF_A_SYNC * len(self.fields) :]
        if len(surplus):
            self._event(len(self._sync_time), "", "missing_sync", message("event.without_sync", frames=len(surplus)))
            keep = np.ones(len(self._window), np.bool_)
            keep[surplus] = False
            self._keep(keep)

    def _keep(self, keep: BoolArray) -> None:
        """Drop all other readings."""
        self._window, self._field, self._value, self._at = self._window[keep], self._field[keep], self._value[keep], self._at[keep]

    def _count_syncs(self, frames: Frames, sync: IntArray) -> None:
        """Report missing SYNCs by their counter byte (CiA 301). It restarts at 1; some masters write 0."""
        counted = sync[frames.length[sync] == 1]
        numbers = np.concatenate([self._sync_number, frames.data[counted, 0].astype(np.int64)])
        self._sync_number = numbers[-1:]
        for k in np.flatnonzero((np.diff(numbers) > 1) & (numbers[:-1] > 0)):
            row = len(self._sync_time) - len(sync) + int(np.searchsorted(sync, counted[k - len(numbers) + len(counted) + 1]))
            missing = int(numbers[k + 1] - numbers[k]) - 1
            text = message("event.missing_sync", number=int(numbers[k + 1]), before=int(numbers[k]), missing=missing)
            self._event(row, "", "missing_sync", text)

    def _hear(self, frames: Frames, readings: Readings) -> None:
        """Take messages between the readings, and frames that do not fit, with the SYNC before them."""
        held = len(self._sync_time)
        for word in sorted([*self._watch.words(frames), *misfits(self.fields, readings)], key=lambda w: w.row):
            window = int(np.searchsorted(readings.sync, word.row)) - 1
            answered = {c for c in word.of if (self._field[self._window == window + held] == c).any()}
            before = readings.field[(readings.window - 1 == window) & (readings.frame < word.row)]
            answered |= {c for c in word.of if (before == c).any()}
            self._words.append(_CounterFrame(word, float(frames.time_s[word.row]), window + held, frozenset(answered)))
        windows = np.searchsorted(readings.sync, readings.void[:, 0]) - 1 + held
        self._void = np.vstack([self._void, np.column_stack([windows, readings.void[:, 1:]])[windows >= 0]]).astype(np.int64)
        note_values(self.events, self.fields, readings)

    def _say(self, ready: int, last: bool) -> None:
        """Pass messages on: as events of the samples behind them, and to the counters that they concern."""
        later = []
        for heard in self._words:
            word, row = heard.word, max(heard.window + (heard.word.kind not in MISFITS), 0)
            if heard.window >= ready and not last:
                later.append(replace(heard, window=heard.window - ready))
                continue
            time_s = float(self._sync_time[row]) if row < len(self._sync_time) else heard.time_s
            for channel in [self.fields[c].channel for c in word.of] or [""]:
                self.events.add(Event(self._number(row), time_s, channel, word.kind, word.text))
            for c in word.of if word.origin else ():
                first = self._number(max(heard.window + (c in heard.answered), 0))
                self.counters[c].words.append(DeviceReport(self._number(row), time_s, word.text, word.origin, first))
        self._words = later

    def _kept(self, end: int) -> BoolArray:
        """Return which of the SYNCs at hand are samples (end,): those that all channels are due to answer, else those that any is."""
        due = self.transmission.due(self.syncs, self.syncs + end)
        return np.asarray(due.all(axis=0) if self.transmission.meets else due.any(axis=0))

    def _number(self, row: int) -> int:
        """Return the number of the sample of a SYNC at hand, or of the next one."""
        return self.given + (row if (self.transmission.n == 1).all() else int(self._kept(row).sum()))

    def _event(self, row: int, channel: str, kind: str, text: str = "") -> None:
        time_s = float(self._sync_time[min(row, len(self._sync_time) - 1)]) if len(self._sync_time) else float("nan")
        self.events.add(Event(self._number(row), time_s, channel, kind, text))

    def _give(self, last: bool) -> Samples:
        self._time_the_sync()
        if self._period is not None or last:
            self._drop_double_syncs()
            self._rise()
        total, m = len(self._sync_time), len(self.fields)
        instants, settled, known = self._settled(last)
        ready = min(total if last else max(total - 2, 0), known)
        if ready and not self._decided:
            ready = ready if self._decide(ready, last) else 0
        if ready:
            self._without_sync(instants, ready)
        value, n = tabulate(self._window, self._field, self._value, m, total)
        ready = ready if last else self._before_late(n, ready)
        if ready == 0:
            if last:
                self._say(0, last)
            return Samples(np.empty(0), np.empty((0, m)), None if self._start_line is None else np.empty(0))
        kept = np.ones(ready, np.bool_)
        many = n.max(axis=0)
        if not (full := bool(n[:, :ready].all() and (self.transmission.n == 1).all())):
            kept, due = self._repeated(value, n, ready)
        self._say(ready, last)
        for w in np.flatnonzero(many[: total if last else total - 1] > 1):
            self._settle(int(w), n, value, ready)
        void = {(w, c): v for w, c, v in self._void.tolist() if w < ready}
        self._void = self._void[self._void[:, 0] >= ready] - np.array([ready, 0, 0])
        if not full:
            for row, c in np.argwhere((n[:, :ready].T == 0) & due.T & kept[:, None]).tolist():
                if (row, c) in void:
                    self._event(row, self.fields[c].channel, "no_value", self.fields[c].why_no_count(void[row, c]))
                else:
                    self._event(row, self.fields[c].channel, "gap")
        time_s = settled[:ready]
        self._last_time = float(time_s[-1])
        recorded = self._advanced(value, n == 1, instants, time_s, kept)
        self._pauses(instants, ready, last)
        moved = self._sync_time[:ready] - time_s
        self._keep(self._window >= ready)
        self._window = self._window - ready
        self._sync_time = self._sync_time[ready:]
        started, self._started = self._started[:ready], self._started[ready:]
        self.given += int(kept.sum())
        self.syncs += ready
        self.stamps_moved_s = max(self.stamps_moved_s, float(moved.max()))
        return Samples(time_s[kept], recorded[kept], None if self._start_line is None else started[kept])

    def _advanced(self, value: IntArray, there: BoolArray, instants: FloatArray, time_s: FloatArray, kept: BoolArray) -> FloatArray:
        """Return the counts (ready, m) of the SYNCs that are now ready; some of these are samples.

        The time between two counts is at least that of the SYNCs between them, and at most the time by their stamps, without delays.
        """
        period, m, ready = self._period or 0.0, len(self.fields), len(kept)
        recorded = np.full((ready, m), np.nan)
        number = self.given + np.cumsum(kept) - kept
        before = instants[0] if not len(self._last_instant) else self._last_instant[0]
        intervals = np.empty(ready)
        intervals[0], intervals[1:] = instants[0] - before, instants[1:ready] - instants[: ready - 1]
        even = bool(there[:, :ready].all() and (self._last_seen[0] == self.syncs - 1).all() and intervals.max() <= LONG * period)
        others = self._evidence.of(value[:, :ready], there[:, :ready], intervals > LONG * period)
        for c, counter in enumerate(self.counters):
            rows: IntArray | slice = slice(ready)
            passed, gone = intervals, np.ones(ready, np.int64)
            if not even:
                rows = np.flatnonzero(there[c, :ready])
                if not len(rows):
                    counter.advance(value[c, rows], time_s[rows], number[rows], self.events)  # it may be spoken of all the same
                    continue
                seen = np.concatenate([self._last_seen[0][c : c + 1], self.syncs + rows])
                at = np.concatenate([self._last_seen[1][c : c + 1], instants[rows]])
                gone = np.diff(seen)
                passed = np.maximum(np.diff(at), period * gone)
                passed[: int(seen[0] < 0)] = period
                gone = np.maximum(gone // int(self.transmission.n[c]), 1)
                gone[: int(seen[0] < 0)] = 1
                self._last_seen[0][c], self._last_seen[1][c] = seen[-1], at[-1]
            usual = period * int(self.transmission.n[c])
            calm = others(c) if others is not None else None
            counts = counter.advance(
                value[c, rows],
                time_s[rows],
                number[rows],
                self.events,
                least_s=usual,
                passed_s=passed,
                gone=gone,
                calm=calm,
                longest_s=longest_interval(usual, live=not self._log),
            )
            recorded[rows, c] = counter.shown(counts)
        if even:
            self._last_seen[0][:], self._last_seen[1][:] = self.syncs + ready - 1, instants[ready - 1]
        for c in started_late(self.counters, self.events):
            recorded[:, c] = np.nan
        return recorded

    def _decide(self, ready: int, last: bool) -> bool:
        """Return whether the period, and the SYNCs that each channel answers, are known: the first samples can be returned."""
        for first in (ANSWERS, ANSWERS * MOST):
            head = self._window < first
            known = self.transmission.known([np.unique(self._window[head & (self._field == c)]) for c in range(len(self.fields))])
            if known.all():
                break
        waited = self._sync_time[ready - 1] - self._sync_time[0]
        patient = waited < FIRST_HOLD_S or self._log or not known.any()
        sure = bool(known.all()) and len(self._intervals) >= FIRST_INTERVALS
        self._decided = last or sure or not patient or ready >= ANSWERS * MOST
        return self._decided

    def _repeated(self, value: IntArray, n: IntArray, ready: int) -> tuple[BoolArray, BoolArray]:
        """Return which SYNCs are samples (ready,), and which of them each channel is due to answer (m, ready).

        If a channel answers every n-th SYNC only, an answer behind the next SYNC is put back.
        """
        answered = n[:, :ready] > 0
        self._announce(self.transmission.learn([self.syncs + np.flatnonzero(one) for one in answered]))
        if (self.transmission.n == 1).all():
            return np.ones(ready, np.bool_), np.ones((len(n), ready), np.bool_)
        due = self.transmission.due(self.syncs, self.syncs + n.shape[1])
        for c in np.flatnonzero(self.transmission.n > 1):
            every = int(self.transmission.n[c])
            for w in np.flatnonzero(due[c, :-1] & (n[c, :-1] == 0) & (n[c, 1:] == 1) & ~due[c, 1:]):
                if w + 1 < ready and w + every < n.shape[1] and n[c, w + every]:
                    n[c, w], value[c, w], n[c, w + 1] = 1, value[c, w + 1], 0
                    self._window[(self._window == w + 1) & (self._field == c)] = w
                    self.transmission.moved(int(c), self.syncs + int(w))
                    self._event(int(w), self.fields[c].channel, "reordered", message("event.after_sync"))
        due = self.transmission.due(self.syncs, self.syncs + n.shape[1])
        kept = self._kept(ready) | (n[:, :ready] > 0).all(axis=0)
        return np.asarray(kept), due[:, :ready]

    def _announce(self, channels: list[int]) -> None:
        """Report once that channels answer every n-th SYNC."""
        for c in channels:
            n = int(self.transmission.n[c])
            text: str = message("acquisition.answers_every_sync", n=ordinal(n))
            if n > 1 and not self.transmission.meets:
                text = in_sequence((text, message("event.never_together")))
            self._event(0, self.fields[c].channel, "unanswered", text)

    def _pauses(self, instants: FloatArray, ready: int, last: bool) -> None:
        """Report that the SYNC stopped."""
        at = np.concatenate([self._last_instant, instants[:ready]])
        self._last_instant = at[-1:]
        for w in np.flatnonzero(paused(np.diff(at), self._period or 0.0)):
            row = int(w) + 1 - (len(at) - ready)
            self._event(row, "", "pause", message("event.no_sync", seconds=float(at[w + 1] - at[w])))
        silent = self._latest_s + self._time_shift - at[-1:]
        if last and paused(silent, self._period or 0.0).any():
            self._event(ready, "", "pause", message("event.no_sync_at_end", seconds=float(silent[0])))

    def _without_sync(self, instants: FloatArray, ready: int) -> None:
        """Drop frames that answer a missing SYNC, up to the SYNC behind those that are ready: a late answer may follow it.

        Such a frame comes later than a period, and well before the next SYNC. Some channel that sends then has answered already, or the
        frame's own channel was not due to, or the frame is later than any delay of a sender.
        """
        if self._period is None:
            return
        spacing = np.diff(np.append(instants, np.inf))
        if not (long := spacing > 1.5 * self._period)[: ready + 1].any():
            return
        stamps = np.append(self._sync_time, np.inf)
        strays = long[self._window] & (self._at - stamps[self._window] > MISSED * self._period)
        strays &= (stamps[self._window + 1] - self._at > (1.0 - MISSED) * self._period) & (self._window <= ready)
        if not strays.any():
            return
        _, first = np.unique(self._window * len(self.fields) + self._field, return_index=True)
        again = np.ones(len(strays), np.bool_)
        again[first] = False
        due = self.transmission.due(self.syncs, self.syncs + len(self._sync_time))[self._field, self._window]
        missed = np.isin(self._window, self._window[strays & again])
        strays &= missed | ~due | (self._at - stamps[self._window] > max(LONG * self._period, HELD_UP_S))
        for w in np.unique(self._window[strays]):
            channels = len(np.unique(self._field[strays & (self._window == w)]))
            text = message("event.unsampled", seconds=float(spacing[w]), channels=channels)
            self._event(int(w) + 1, "", "missing_sync", text)
        if strays.any():
            self._keep(~strays)

    def _before_late(self, n: IntArray, ready: int) -> int:
        """Return how many of the SYNCs that are ready can be given: not one without an answer, after which answers may be late in a row."""
        for c, w in np.argwhere((n[:, :ready] == 0) & (self.transmission.n == 1)[:, None]).tolist():
            following = n[c, w + 1 : n.shape[1] - 1]
            if len(following) < IN_A_ROW and (following == 1).all():
                ready = min(ready, w)
        return ready

    def _late(self, c: int, w: int, n: IntArray, value: IntArray, own: IntArray) -> tuple[int, bool]:
        """Return the first of the SYNCs up to w, which has two answers, whose answers may have come behind the next SYNC, and whether they
        did; w if none may have.

        Of several in a row, the first SYNC seems unanswered, and the next ones have the answer of the one before. This is sure if the
        counts lie much nearer to the line from the last count to that of SYNC w when they are moved.
        """
        back = next((k for k in range(1, min(IN_A_ROW, w) + 1) if n[c, w - k] != 1), 0)
        first, counter = w - back, self.counters[c]
        if not back or n[c, first] != 0 or (back == 1 and own[0] == own[1]):
            return w, False
        there = bool(first) and n[c, first - 1] == 1
        if back == 1 or len(own) > 2 or self.transmission.n[c] != 1 or not (there or counter.seen):
            return first, back == 1 and len(own) == 2
        before, modulus = int(value[c, first - 1]) if there else counter.value, self.fields[c].modulus
        ways = [int(v) - before for v in (*value[c, first + 1 : w], *own)]
        way = np.array([(v + modulus // 2) % modulus - modulus // 2 for v in ways], dtype=np.float64)
        line = way[-1] * np.arange(1.0, back + 2.0) / (back + 1.0)
        moved, here = np.abs(way - line)[:-1].sum(), np.abs(way[:-1] - line[1:]).sum()
        return first, bool(here > 3.0 * moved + 2.0 * back)

    def _settle(self, w: int, n: IntArray, value: IntArray, ready: int) -> None:
        """Settle a SYNC with several frames of one channel: late ones, early ones, duplicates, conflicts."""
        several = np.flatnonzero(n[:, w] > 1)
        alone = w + 1 >= n.shape[1]
        for c in several:
            mine = np.flatnonzero((self._window == w) & (self._field == c))
            values = self._value[mine]
            channel = self.fields[c].channel
            own = values if len(mine) == 2 else values[np.append(True, values[1:] != values[:-1])]
            late, sure = self._late(int(c), w, n, value, own) if len(own) > 1 else (w, False)
            if late < w and not sure:
                # neither the answers of their own SYNCs for certain, nor those of the SYNCs before
                n[c, late + 1 : w] = 0
            if sure:
                value[c, late : w + 1] = *value[c, late + 1 : w], *own
                n[c, late : w + 1] = 1
                moved = np.flatnonzero((self._window > late) & (self._window < w) & (self._field == c))
                self._window[[*moved, mine[0]]] -= 1
                for k in range(late, w):
                    self._event(k, channel, "reordered", message("event.after_sync"))
            elif w >= ready:
                continue  # the next frame has not arrived yet
            elif len(mine) == 2 and not alone and n[c, w + 1] == 0 and values[0] != values[1]:
                n[c, w + 1], value[c, w + 1] = 1, values[1]
                n[c, w] = 1
                self._window[mine[1]] = w + 1
                self._event(w + 1, channel, "reordered", message("event.before_sync"))
            elif (values == values[0]).all():
                n[c, w] = 1
                for _ in range(len(mine) - 1):
                    self._event(w, channel, "duplicate")
            else:
                # several values remain: neither one value nor a gap
                self._event(w, channel, "conflict", ", ".join(str(v) for v in values[:4]))

    def _time_the_sync(self) -> None:
        """Estimate the period of the SYNC from its latest intervals."""
        if len(self._intervals) <= 2:
            return
        # a log with stamps in ticks has many SYNCs with one stamp, as from a late host
        if self._log and len(self._intervals) >= MANY_INTERVALS:
            self._late_stamps |= TICKED < float(np.mean(self._intervals == 0.0)) < 1.0
        whole = self._intervals[self._intervals > 0.1 * np.quantile(self._intervals, 0.75)]  # doubled SYNCs part theirs
        self._period = pace(self._intervals) if self._late_stamps else float(np.median(whole if len(whole) else self._intervals))

    def _drop_double_syncs(self) -> None:
        """Drop a SYNC that follows another at once, with nothing between them: it is the same one."""
        intervals = np.diff(self._sync_time, prepend=-np.inf)
        double = (intervals <= 0.25 * (self._period or 0.0)) & (intervals >= 0)
        if not double.any():
            return
        filled = np.bincount(self._window, minlength=len(self._sync_time)) > 0
        double[1:] &= ~filled[:-1]
        if not double.any():
            return
        for w in np.flatnonzero(double):
            self._event(int(w), "", "duplicate_sync")
        earlier = len(self._intervals) - (len(self._sync_time) - 1)
        self._intervals = np.concatenate([self._intervals[: max(earlier, 0)], np.abs(np.diff(self._sync_time[~double]))])[-PERIODS:]
        self._time_the_sync()
        number = np.cumsum(~double) - 1
        self._window = number[self._window]
        self._void[:, 0] = number[self._void[:, 0]]
        self._words = [replace(h, window=int(number[h.window])) if h.window >= 0 else h for h in self._words]
        self._sync_time = self._sync_time[~double]
        self._started = self._started[~double] if self._start_line is not None else self._started

    def _settled(self, last: bool) -> tuple[FloatArray, FloatArray, int]:
        """Return the latest possible instants of the SYNCs, the times of their samples, and how many of these are known.

        A host stamps a frame late, never early; after a pause it stamps several at once. Stamps that follow each other faster than LATE of
        the period mean that the earlier ones were late. Times of a host are moved back. Other times stay: the instants then only limit how
        far a counter can have moved.
        """
        stamps = self._sync_time
        if self._period is None or len(stamps) < 2:
            return stamps, stamps, len(stamps)
        intervals = np.diff(stamps)
        if not self._late_stamps:
            known = len(stamps)
            if not last:
                # behind a silence it takes a while to see whether stamps were late
                waits = np.flatnonzero((intervals > LONG * self._period) & (stamps[1:] > stamps[-1] - LONGEST_HOLD_S))
                known = int(waits[0]) + 1 if len(waits) else known
            return earliest(stamps, SURE * self._period), stamps, known
        least = LATE * self._period
        out = earliest(stamps, least)
        count = np.arange(len(stamps))
        out = np.maximum(out, self._last_time + 0.1 * least * (count + 1)) if np.isfinite(self._last_time) else out
        if last:
            return out, out, len(out)
        known = int(np.searchsorted(stamps, stamps[-1] - (LONGEST_HOLD_S if self.syncs else FIRST_HOLD_S)))
        if self.syncs or known:
            # frames that come at their own pace are not held up any more
            pace = intervals >= least
            calm = np.flatnonzero(pace[:-2] & pace[1:-1] & pace[2:]) if len(pace) > 2 else np.empty(0, np.intp)
            known = max(known, int(calm[-1]) + 1 if len(calm) else 0)
        return out, out, known

    def _rise(self) -> None:
        """Continue the times one period after the last where the clock went back."""
        while True:
            steps = np.diff(self._sync_time, prepend=self._last_time)
            back = np.flatnonzero((steps < 0) | ((steps == 0) & (not self._late_stamps)))
            if len(back) == 0:
                return
            i = int(back[0])
            before = self._sync_time[i - 1] if i else self._last_time
            step = before - self._sync_time[i]
            self._event(i, "", "time", message("event.clock_back", seconds=float(step)))
            shift = step + (self._period or FIRST_PERIOD_S)
            self._sync_time[i:] += shift
            self._at[self._window >= i] += shift
            self._time_shift += shift
            # of a time so large that a period is lost in it, the next double: each turn settles one sample at least
            self._sync_time[i] = max(self._sync_time[i], np.nextafter(before, np.inf))
