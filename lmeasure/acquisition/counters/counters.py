"""Counters: wraps undone, start offsets taken off, and origins that are lost. One state per channel, fed piece by piece."""

import dataclasses
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, REMOTE, Frames
from lmeasure.acquisition.bus.network import LOST
from lmeasure.acquisition.counters.decoders import NO_RANGE, CounterField, Readings
from lmeasure.acquisition.counters.events import Event, EventLog
from lmeasure.acquisition.counters.origins import Doubt, Line, Pause, may_wrap, speed_of
from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels import runs_on
from lmeasure.rig import StartInput
from lmeasure.text import Message, message

RESET_WITHIN = 2
"""Units from zero within which a device that starts again is found."""
RESET_FACTOR = 20
"""A step to zero this many times longer than its neighbours is a reset even where the speed limit would allow it."""
RESET_LEAST = 200
"""Units: a shorter step to zero is not looked at."""
MOVED = 4
"""Units from its first count beyond which a channel has moved."""


@dataclass(frozen=True)
class DeviceReport:
    """Report of the device or its master before sample `sample`, at time_s, and its effect on the origin (`network.Word`)."""

    sample: int
    time_s: float
    text: str
    origin: str
    first: int
    """First sample whose count was taken behind it: one before, where that SYNC had not been answered yet."""


@dataclass(frozen=True)
class Unit:
    """A unit of a device: how large it is in mm or degrees; slack: by how many units a count may be off its line though nothing happened,
    as that of a cable that sticks and slips; tight: in how narrow a band of units a restart at zero is not looked for; hard: the hardest
    acceleration of any machine [units/s^2], for gaps that only late stamps may have made."""

    size: float = 1.0
    name: str = "units"
    slack: float = 0.0
    tight: float = 0.0
    hard: float = 0.0


class _Piece(NamedTuple):
    """Readings of one call: (n,) values, steps [units], times [s], the same by their numbers, samples, intervals by number and by time, and
    which are behind a gap; the usual interval; whether intervals are numbered."""

    values: IntArray
    steps: IntArray
    times: FloatArray
    even: FloatArray
    samples: IntArray
    gone: IntArray
    pause: FloatArray
    gaps: BoolArray
    usual_s: float
    numbered: bool


@dataclass
class CounterState:
    """State of one channel: its field, the largest rate [device units/s], the need of unwrapping by later stages, and its count."""

    field: CounterField
    max_rate: float
    wraps_later: bool = False
    codes: bool = False
    """Whether it shows its angle within a revolution, from 0 on."""
    unit: Unit = Unit()
    acceleration: float | None = None
    """Limit [device units/s^2] that the rig states."""
    exact: bool = False
    """Whether the rig states an exact zero: then a restart is no proof that the count is lost, and the motion decides."""
    value: int = 0
    total: int = 0
    time_s: float = float("nan")
    step: int = 0
    sample: int = 0
    even_s: float = 0.0
    """Time of the last reading by the numbers of samples: stamps may be late."""
    seen: bool = False
    lost: bool = False
    first: int = 0
    moved_at: int | None = None
    """Sample from which on the channel had moved."""
    early: DeviceReport | None = None
    """A restart before its first count: no loss where nothing had moved yet."""
    words: list[DeviceReport] = dataclasses.field(default_factory=list)
    doubt: Doubt | None = None
    line: Line = dataclasses.field(init=False)

    def __post_init__(self) -> None:
        self.line = Line(self.unit.slack, self.max_rate, self.acceleration)

    @property
    def absolute(self) -> bool:
        """Return whether its count is true whatever happened to its device."""
        return self.codes or self.field.absolute

    @property
    def values(self) -> int:
        """Number of its values, 0 where it never wraps unseen."""
        return self.field.modulus if self.field.modulus < NO_RANGE and not self.wraps_later else 0

    @property
    def unit_mm(self) -> float | None:
        """Millimetres of a device unit, None where it is no length."""
        return self.unit.size if self.unit.name == "mm" else None

    def advance(
        self,
        values: IntArray,
        times: FloatArray,
        samples: IntArray,
        events: EventLog,
        *,
        least_s: float = 0.0,
        passed_s: FloatArray | None = None,
        gone: IntArray | None = None,
        calm: BoolArray | None = None,
        longest_s: float = np.inf,
    ) -> FloatArray:
        """(n,) recorded counts, unwrapped, of the (n,) values read at the times [s], for the rows `samples`; NaN once the origin is lost,
        and while it is in doubt. least_s: the usual interval, taken for the time between readings whose stamps are closer; passed_s (n,):
        the time since the reading before, where that is better known than by the stamps; gone (n,): how many intervals that is, where
        they are numbered; calm (n,): where other channels rule out that it wrapped unseen; longest_s: a longer interval is a gap."""
        doubtful, ends, ended = self._listen(samples, events)
        if len(values) == 0:
            self.lost |= ended
            return np.empty(0)
        modulus, half = self.field.modulus, self.field.modulus // 2
        wraps = modulus < NO_RANGE
        if not self.seen:
            first = int(values[0]) - self.field.start
            self.total = self.first = (first + half) % modulus - half if wraps else first
            self.value, self.time_s, self.sample, self.seen = int(values[0]), float(times[0]), int(samples[0]), True
        full = modulus if wraps else 0
        most = modulus / 2 if wraps and not self.wraps_later else np.inf
        longest = longest_s if least_s > 0.0 and not self.absolute else np.inf
        numbered = gone is not None and least_s > 0.0
        intervals = np.ones(len(values), np.int64) if gone is None else gone
        even = np.asarray(self.even_s + least_s * np.cumsum(intervals), np.float64) if numbered else times.copy()
        quiet = not self.lost and self.doubt is None and not len(doubtful) and ends == len(values)
        quiet &= self.absolute or bool((intervals <= 1).all())
        if quiet and runs_on(values, times, self.value, self.time_s, full, self.max_rate, most, RESET_WITHIN, RESET_LEAST, longest):
            totals = self.total + (values - self.value)
            self.step = int(values[-1]) - int(values[-2] if len(values) > 1 else self.value)
            good = None
            self._learn(even, totals, least_s)
        else:
            before = np.concatenate([[self.value], values[:-1]])
            pause = np.maximum(np.diff(times, prepend=self.time_s) if passed_s is None else passed_s, least_s)
            with np.errstate(over="ignore"):
                plain = values - before
            steps = (plain + half) % modulus - half if wraps else plain
            gaps = (pause > longest) | (intervals > 1)
            piece = _Piece(values, steps, times, even, samples, intervals, pause, gaps, least_s, numbered)
            follows, good = np.zeros(len(values), np.bool_), np.full(len(values), not self.lost)
            totals = self.total + np.cumsum(steps)
            if not self.lost and not self.absolute:
                suspects = np.union1d(np.flatnonzero(piece.gaps), doubtful).astype(np.int64)
                totals = self._judge(piece, suspects[suspects < ends], ends, good, follows, events)
            self._find(values, plain, steps, self.max_rate * pause + 1.0, times, samples, events)
            if not self.lost and (row := self._origin_lost(piece, follows, calm, events)) is not None:
                good[row:] = False
                self.lost = True
            good[ends:] = False
            self.step = int(steps[-1])
        self.lost |= ended
        self.even_s = float(even[-1])
        self.value, self.total, self.time_s, self.sample = int(values[-1]), int(totals[-1]), float(times[-1]), int(samples[-1])
        if self.moved_at is None and len(moved := np.flatnonzero(np.abs(totals - self.first) > MOVED)):
            self.moved_at = int(samples[moved[0]])
        out = np.asarray(self.field.scale * totals, np.float64)
        return out if good is None else np.where(good, out, np.nan)

    def shown(self, counts: FloatArray) -> FloatArray:
        """Return (n,) counts in the form of the counts file: wrapped like the encoder's if the rig states it and later stages unwrap."""
        if not self.wraps_later:
            return counts
        full = self.field.scale * self.field.modulus
        if self.codes:
            turned = counts % full
            # rounding up to a whole turn would give a code that does not exist
            return np.asarray(np.where(turned < full, turned, 0.0))
        raised = counts + full / 2
        return (raised if ((raised >= 0) & (raised < full)).all() else raised % full) - full / 2

    def _listen(self, samples: IntArray, events: EventLog) -> tuple[IntArray, int, bool]:
        """Rows of (n,) samples behind words that leave the origin in doubt, the row from which on a word ends it, and whether one does."""
        n, ends, ended = len(samples), len(samples), False
        doubtful: list[int] = []
        later: list[DeviceReport] = []
        for word in self.words:
            row = int(np.searchsorted(samples, word.first))
            counted = self.seen or row > 0
            if self.lost or ended or self.absolute:
                continue
            if not counted and n == 0:
                later.append(word)
            elif not counted:
                self.early = word if word.origin == LOST else self.early
            elif word.origin == LOST and not self.exact:
                events.add(Event(word.sample, word.time_s, self.field.channel, "reset", word.text))
                ends, ended = row, True
            elif row < n:
                doubtful.append(row)
            else:
                later.append(word)
        self.words = later
        return np.array(doubtful, np.int64), ends, ended

    def _learn(self, times: FloatArray, totals: IntArray, usual_s: float, *, behind_gap: bool = False) -> None:
        if not self.absolute:
            self.line.learn(times, totals, usual_s, behind_gap=behind_gap)

    def _judge(self, piece: _Piece, suspects: IntArray, ends: int, good: BoolArray, follows: BoolArray, events: EventLog) -> IntArray:
        """Return (n,) totals, wraps undone by the motion if it is unambiguous. good (n,) becomes False where the origin is lost or in
        doubt, follows (n,) True where a count behind a gap was found to follow."""
        totals = self.total + np.cumsum(piece.steps)
        row = 0
        for i in [*suspects.tolist(), ends]:
            row = self._settle(piece, totals, row, i, good, events)
            if self.lost:
                good[row:] = False
                break
            if self.doubt is not None:
                good[row:i] = False
                row = i
                if i < ends and piece.gone[i] > 1:
                    self.doubt.go_on(float(piece.even[i]), int(piece.gone[i]) * piece.usual_s)
                continue
            self._learn(piece.even[row:i], totals[row:i], piece.usual_s, behind_gap=bool(row in suspects and piece.gaps[row]))
            row = i
            if i < ends and self.seen and len(self.line.times):
                totals[i:] += self._behind(piece, totals, i, follows, events)
        return totals

    def _settle(self, piece: _Piece, totals: IntArray, row: int, end: int, good: BoolArray, events: EventLog) -> int:
        """Take readings row .. end into a doubt until it is decided; the row from which on counts are normal again."""
        while self.doubt is not None and row < end:
            doubt = self.doubt
            doubt.times.append(float(piece.even[row]))
            doubt.totals.append(int(totals[row]))
            row += 1
            if not doubt.known():
                good[row - 1] = False
                continue
            times, counts = np.array(doubt.times), np.array(doubt.totals, np.int64)
            low, high = self.line.band_between(doubt.pause, speed_of(times, counts, piece.usual_s))
            self.doubt = None
            if not low <= doubt.totals[0] <= high or (doubt.restart and high - low > self.unit.tight):
                row -= 1
                self._lose(piece, row, message("event.not_continued"), events)
                return row
            self._state_step(piece, row - 1, high - low, events)
            self._learn(times, counts, piece.usual_s, behind_gap=True)
        return row

    def _behind(self, piece: _Piece, totals: IntArray, i: int, follows: BoolArray, events: EventLog) -> int:
        """Judge reading i; by how much its total and those behind are to be changed: whole turns of the counter."""
        modulus, before = self.field.modulus, int(totals[i - 1]) if i else self.total
        most_s = float(piece.pause[i])
        pause = Pause(before, self.line.speed(piece.usual_s), min(int(piece.gone[i]) * piece.usual_s or most_s, most_s), most_s)
        turns, total = 0, int(totals[i])
        stamped_s = float(piece.times[i] - (piece.times[i - 1] if i else self.time_s))
        lengths = [(one, 0.0) for one in (pause.least_s, max(stamped_s, 0.0), pause.most_s)]
        if int(piece.gone[i]) == 1 and pause.least_s < pause.most_s:
            lengths.append((pause.least_s, self.unit.hard))  # only the stamps show a gap
        bands = []
        for pause_s, hard in lengths:
            low, high = self.line.band(pause, pause_s, hard)
            bands.append((low, high))
            if high - low < modulus < NO_RANGE:
                turns = modulus * round(((low + high) / 2 - int(totals[i])) / modulus)
            total = int(totals[i]) + turns
            if low <= total <= high:
                break
        width = high - low
        # a counter that restarted at zero may have moved with the motion since
        was = self._signed(int(piece.values[i - 1]) if i else self.value)
        restart = width > self.unit.tight and abs(self._signed(int(piece.values[i]))) <= width
        restart &= abs(was) > RESET_LEAST and abs(total - before) > RESET_WITHIN + 1
        if low <= total <= high and not restart:
            follows[i] = width < modulus
            if piece.numbered:
                piece.even[i:] += pause_s - pause.least_s
            if int(piece.gone[i]) > 1 or (piece.gaps[i] and pause_s > pause.least_s):
                self._state_step(piece, i, width, events)
            elif piece.gaps[i] and hard:  # late without a gap: a hard stop, or missing readings; undecidable
                self._state_step(piece, i, max(high for _, high in bands) - min(low for low, _ in bands), events)
            return turns
        moved = {"moved": int(total - before), "seconds": most_s}
        text: str = message("event.restarted", **moved)
        if not restart:
            text = message("event.not_its_motion", low=float(low - before), high=float(high - before), **moved)
        events.add(Event(int(piece.samples[i]), float(piece.times[i]), self.field.channel, "doubt", text))
        self.doubt = Doubt(pause, restart)
        return turns

    def _signed(self, value: int) -> int:
        half = self.field.modulus // 2
        return (value + half) % self.field.modulus - half if self.field.modulus < NO_RANGE else value

    def _state_step(self, piece: _Piece, i: int, width: float, events: EventLog) -> None:
        sample, channel = int(piece.samples[i]), self.field.channel
        size = width * self.unit.size
        unit = message(f"acquisition.unit.{self.unit.name}")
        hidden = message("event.gap_step", units=float(width), size=size, unit=unit)
        events.add(Event(sample, float(piece.times[i]), channel, "gap_step", hidden))
        at = message("acquisition.step_at_sample", channel=channel, units=float(width), size=size, unit=unit, sample=sample)
        events.note_step(channel, size, at)

    def _lose(self, piece: _Piece, i: int, text: str, events: EventLog) -> None:
        self.lost, self.doubt = True, None
        events.add(Event(int(piece.samples[i]), float(piece.times[i]), self.field.channel, "reset", text))

    def _find(
        self, values: IntArray, plain: IntArray, steps: IntArray, limit: FloatArray, times: FloatArray, samples: IntArray, events: EventLog
    ) -> None:
        for i in np.flatnonzero(plain != steps):
            events.add(Event(int(samples[i]), float(times[i]), self.field.channel, "wrap", _from_to(values[i] - plain[i], values[i])))
        for i in np.flatnonzero(np.abs(steps) > limit):
            text = message("acquisition.units_where_possible", moved=steps[i], possible=limit[i])
            events.add(Event(int(samples[i]), float(times[i]), self.field.channel, "jump", text))

    def _origin_lost(self, piece: _Piece, follows: BoolArray, calm: BoolArray | None, events: EventLog) -> int | None:
        """Row from which the origin is lost: after a pause in which the counter could have wrapped unseen, or a start again at zero, except
        for counts that follow the motion; never that of absolute codes."""
        if self.codes:
            return None
        values, steps, times, samples = piece.values, piece.steps, piece.times, piece.samples
        found: list[tuple[int, str, str]] = []
        limit = self.max_rate * piece.pause + 1.0
        if self.values:
            unsure = may_wrap(steps, piece.pause, self.values, self.max_rate)
            unsure &= True if calm is None else ~calm
            if unsure.any():
                i = int(np.argmax(unsure))
                lost = message("event.lost_wrap", seconds=float(piece.pause[i]), units=float(limit[i]), range=self.values)
                found.append((i, "lost_wrap", lost))
        length = np.abs(steps)
        previous = np.concatenate([[abs(self.step)], length[:-1]])
        following = np.concatenate([length[1:], [0]])
        usual = np.maximum(previous, following)
        zero = (np.abs(values) <= RESET_WITHIN) & (length > RESET_LEAST) & ((length > RESET_FACTOR * usual) | (length > limit)) & ~follows
        if zero.any() and not self.absolute:
            i = int(np.argmax(zero))
            found.append((i, "reset", _from_to(values[i] - steps[i], values[i])))
        if not found:
            return None
        row, kind, text = min(found)
        events.add(Event(int(samples[row]), float(times[row]), self.field.channel, kind, text))
        return row


def _from_to(before: int, after: int) -> Message:
    return message("event.from_to", before=int(before), after=int(after))


class StartLine:
    """Keep the last known state of the start-of-counting input, 0 before its first frame."""

    def __init__(self, place: StartInput) -> None:
        self._place = place
        self._state = 0.0

    def states(self, frames: Frames) -> tuple[IntArray, FloatArray]:
        """Return the positions (k,) of its frames in a batch, and the states (k + 1,) before them and after each."""
        p = self._place
        mine = (frames.identifier == p.id) & (((frames.flags & EXTENDED) != 0) == p.extended) & ((frames.flags & (ERROR | REMOTE)) == 0)
        rows = np.flatnonzero(mine & (frames.length > p.byte_offset))
        states = np.concatenate([[self._state], (frames.data[rows, p.byte_offset] >> p.bit) & 1 if len(rows) else []])
        self._state = float(states[-1])
        return rows, states

    def before(self, frames: Frames, rows: IntArray) -> FloatArray:
        """Return the state (n,) before each of the frames at the rising positions rows (n,) of a batch.

        It follows the order of reception: late stamps, or a clock that is set, do not separate the input from the counts.
        """
        own, states = self.states(frames)
        return np.asarray(states[np.searchsorted(own, rows)])


def note_values(events: EventLog, fields: tuple[CounterField, ...], readings: Readings) -> None:
    """Count values outside of their channel's limits."""
    for j, field in enumerate(fields):
        if field.limits is not None or field.reserved is not None:
            void = [v for v in readings.void[readings.void[:, 1] == j, 2].tolist() if v not in field.names]
            came = int((readings.field == j).sum()) + len(void)
            events.note_values(field.channel, came, len(void), field.range_text, reserved=field.limits is None)


def started_late(counters: tuple[CounterState, ...], events: EventLog) -> list[int]:
    """Return channels that restarted before their first count while others had already moved: their origin is unknown."""
    out = []
    for c, counter in enumerate(counters):
        word, counter.early = counter.early, None
        if word is not None and any(o.moved_at is not None and o.moved_at < word.sample for o in counters if o is not counter):
            events.add(Event(word.sample, word.time_s, counter.field.channel, "reset", word.text))
            counter.lost = True
            out.append(c)
    return out
