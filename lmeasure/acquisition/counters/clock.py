"""Give the frames of a log or bus one clock: repair clocks that restart, clocks that were set, and single wrong stamps.

Within one bus the order of reception is true. Stamps that contradict it are repaired here, before any sample is assembled. Thresholds are
periods of the SYNC, or of a counter's own timer:

- A few frames have stamps out of line, and the frames on both sides are in line: they get the times at which they were due.
- A logger wrote two blocks in the wrong order, and each fills the hole that the other leaves: they are put in order.
- A step back by more than BACK periods is a clock that restarted at the end of its range, or was set: times continue.
- A step forward is a pause of the bus. If the counters moved as in one period, the clock was set: times continue.

Steps by fractions of periods remain: late stamps, and frames of several buffers.
"""

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition.bus.frames import EXTENDED, Frames, join
from lmeasure.acquisition.counters.decoders import NO_RANGE, CounterField, decode
from lmeasure.core import FloatArray, IntArray
from lmeasure.text import message

MODULI_S = {2**32 * 1e-6: "2^32 us", 60.0: "60 s", 2**16 * 1e-3: "2^16 ms", 3600.0: "1 h", 86400.0: "24 h", 2**32 * 1e-3: "2^32 ms"}
"""Ranges of clocks that restart: GVRET and ESP32, SLCAN, timers of 16 and 32 bits, and times of day."""
BACK = 2.5
"""Periods of a step back that still counts as frames out of order."""
FORWARD = 5.0
FORWARD_S = 0.05
"""A longer silence, in periods and seconds, may be a clock that was set forward."""
AWAY = 64
"""Frames at most that have wrong stamps while those on both sides are in line."""
FIRST = 8
"""Frames at most that have wrong stamps at the beginning of a log."""
BLOCK_S = 1.0
"""Length at most of blocks in exchanged order."""
AHEAD = 2000
"""Frames that are looked at behind a step."""
KEPT = 512
"""Frames from which the period and the times at which frames are due are known."""
UNKNOWN_PERIOD_S = 0.02
FIRST_PERIOD_S = 1e-3
"""Times continue by this where no period is known."""
NO_PAUSE_S = 1e6
"""No bus pauses for longer."""
FIRST_PAUSE_S = 10.0
"""No bus pauses for longer behind its first few frames."""
RESTART_S = 1.0
"""Longest pause in which a clock that restarted at zero is detected."""
LATE = 0.95
"""Smallest interval between two frames of a timer, in periods, when late stamps are judged."""
SURE = 0.98
"""The same over many periods."""
MOVES = 3.0
"""Counts per period from which a counter shows whether a period or a pause passed."""

Keys = NDArray[np.int64]


@dataclass(frozen=True)
class Repair:
    """State a repair of stamps: time by the repaired clock, kind of event, text."""

    time_s: float
    kind: str
    text: str


@dataclass
class _Bus:
    """Keep the clock of one bus: the shift of its stamps, and its latest frames by repaired time."""

    shift: float = 0.0
    time_s: FloatArray = field(default_factory=lambda: np.empty(0))
    key: Keys = field(default_factory=lambda: np.empty(0, np.int64))
    frames: Frames | None = None
    """The same frames, for a log: its clock may be set forward."""


def earliest(stamps_s: FloatArray, least_s: float) -> FloatArray:
    """Return the latest instants (n,) at which frames of a timer can have come: stamps are never early, and instants keep least_s."""
    ramp = least_s * np.arange(len(stamps_s))
    return np.asarray(np.minimum.accumulate((stamps_s - ramp)[::-1])[::-1] + ramp)


class Clock:
    """Repair the stamps of frames, batch by batch. Frames behind a step wait until the step can be judged."""

    def __init__(self, fields: tuple[CounterField, ...], sync_id: int | None) -> None:
        """Take the SYNC at which counts are latched; None if each encoder has its own timer."""
        self._fields, self._sync_id = fields, sync_id
        self._buses: dict[str, _Bus] = {}
        self._held: Frames | None = None
        self.repairs: list[Repair] = []

    def feed(self, frames: Frames, last: bool = False) -> Frames:
        """Return the frames that are certain by now, in true order. last: nothing follows."""
        if self._held is not None:
            frames = join([self._held, frames]) if len(frames) else self._held
            self._held = None
        if not len(frames):
            return frames
        if not last and len(frames.buses) == 1 and self._runs_on(frames):
            return frames if not (bus := self._buses[frames.buses[0]]).shift else replace(frames, time_s=frames.time_s + bus.shift)
        certain = len(frames)
        lines = {int(number): np.flatnonzero(frames.channel == number) for number in np.unique(frames.channel)}
        while True:  # again up to where all buses are certain
            found = {number: self._line(frames, rows, last) for number, rows in lines.items()}
            cuts = {number: found[number].straighten(int(np.searchsorted(rows, certain))) for number, rows in lines.items()}
            held = min((int(rows[cuts[number]]) for number, rows in lines.items() if cuts[number] < len(rows)), default=certain)
            if held >= certain:
                break
            certain = held
            if len(lines) == 1:
                break
        return self._certain(frames, lines, found, certain)

    def _line(self, frames: Frames, rows: IntArray, last: bool) -> "_Line":
        name = frames.buses[frames.channel[rows[0]]]
        return _Line(self._fields, self._sync_id, self._buses.get(name, _Bus()), frames.take(rows), last=last)

    def _certain(self, frames: Frames, lines: dict[int, IntArray], found: dict[int, "_Line"], certain: int) -> Frames:
        """Move the state of each bus to the first frame that is not certain; hold this frame and those behind it."""
        time_s, order = frames.time_s.copy(), np.arange(len(frames))
        for number, rows in lines.items():
            one, count = found[number], int(np.searchsorted(rows, certain))
            time_s[rows[:count]], order[rows[:count]] = one.time_s[:count], rows[one.order[:count]]
            before = self._buses.get(frames.buses[number], _Bus())
            after = self._buses[frames.buses[number]] = _Bus(one.shift, before.time_s, before.key, before.frames)
            self._keep(after, one.time_s[:count], frames.take(rows[one.order[:count]]))
            self.repairs += one.repairs
        if certain < len(frames):
            self._held = frames.take(slice(certain, None))
        moved = frames if (order == np.arange(len(frames))).all() else frames.take(order)
        return replace(moved, time_s=time_s).take(slice(certain))

    def _runs_on(self, frames: Frames) -> bool:
        """Return whether the stamps of the only bus need no repair; if so, move its state on."""
        bus = self._buses.setdefault(frames.buses[0], _Bus())
        time_s = frames.time_s + bus.shift if bus.shift else frames.time_s
        first = float(time_s[0] - bus.time_s[-1]) if len(bus.time_s) else 0.0
        step = time_s[1:] - time_s[:-1]
        if not 0.0 <= first <= FORWARD_S or (len(step) and (step.min() < 0.0 or step.max() > FORWARD_S)):
            return False
        self._keep(bus, time_s, frames)
        return True

    @staticmethod
    def _keep(bus: _Bus, time_s: FloatArray, frames: Frames) -> None:
        tail = slice(-KEPT, None)
        bus.time_s = np.concatenate([bus.time_s, time_s[tail]])[tail]
        bus.key = np.concatenate([bus.key, _keys(frames.take(tail))])[tail]
        if frames.timestamp_source == "log" and len(frames):
            bus.frames = frames.take(tail) if bus.frames is None or len(frames) >= KEPT else join([bus.frames, frames]).take(tail)


def _keys(frames: Frames) -> Keys:
    """Return identifiers, 2^29 above them if extended."""
    return np.asarray(frames.identifier.astype(np.int64) | ((frames.flags & EXTENDED) != 0).astype(np.int64) << 29)


class _Line:
    """Repair the frames of one bus in a batch, in the order of reception; the latest frames of earlier batches precede them."""

    def __init__(self, fields: tuple[CounterField, ...], sync_id: int | None, bus: _Bus, frames: Frames, *, last: bool) -> None:
        self._fields, self._sync_id, self._frames, self._last = fields, sync_id, frames, last
        self._log = frames.timestamp_source == "log"
        self._known, self._earlier = len(bus.time_s), bus.frames
        self._t = np.concatenate([bus.time_s, frames.time_s + bus.shift])
        self._key = np.concatenate([bus.key, _keys(frames)])
        self.shift = bus.shift
        self.order: IntArray = np.arange(len(frames))
        self.repairs: list[Repair] = []
        self._period = self._usual()
        self._back_s, self._forward_s = BACK * self._period, max(FORWARD * self._period, FORWARD_S)
        self._hold = self._limit = len(self._t)
        """The first frame that has to wait for others."""

    @property
    def time_s(self) -> FloatArray:
        """Return the repaired times (n,), in `order`."""
        return self._t[self._known :]

    def _usual(self) -> float:
        """Return the period of the SYNC, or of the counters' own timers, as far as the frames show it."""
        wanted = [self._sync_id] if self._sync_id is not None else []
        wanted += [f.identifier | (int(f.extended) << 29) for f in self._fields]
        masks = ([-1] if self._sync_id is not None else []) + [f.mask | 1 << 29 for f in self._fields]
        some = slice(0, self._known + 4 * AHEAD)
        for key, mask in zip(wanted, masks, strict=True):
            times = self._t[some][(self._key[some] & mask) == key]
            if len(times) > 3 and (period := float(np.median(np.abs(np.diff(times))))) > 0.0:
                return period
        return UNKNOWN_PERIOD_S

    def straighten(self, limit: int) -> int:
        """Repair the steps before the frame `limit`; return how many frames are certain."""
        self._limit = self._known + limit
        at = max(self._known, 1)
        while at < len(self._t):
            highest = np.maximum.accumulate(self._t[at - 1 :])
            behind = self._t[at:] - highest[:-1]
            steps = np.flatnonzero((behind < -self._back_s) | ((behind > self._forward_s) & self._log))
            if not len(steps):
                break
            i = at + int(steps[0])
            if i >= self._limit:
                break
            highest_s = float(highest[i - at])
            going = self._forward(i, highest_s) if behind[i - at] > 0 else self._back(i, highest_s)
            if self._hold < len(self._t):
                return self._hold - self._known
            at = going
        return limit

    def _enough(self, i: int, frames: int, hold: int) -> bool:
        """Return whether so many frames are known behind frame i; if not, hold those from `hold` on."""
        if self._last or len(self._t) - i > frames:
            return True
        self._hold = min(self._hold, hold)
        return False

    def _in_line(self, i: int, highest_s: float, frames: int) -> int:
        """Return the first of so many frames behind frame i whose stamps step back into line; 0 if none does."""
        step = np.diff(self._t[i : i + frames + 2])
        ahead = self._t[i + 1 : i + frames + 2] - highest_s
        line = (ahead >= -self._back_s) & (ahead <= self._forward_s + self._period * np.arange(len(ahead)))
        returns = line & (np.abs(step) > self._back_s) & ((step < 0) == (self._t[i] > highest_s))
        returns[:-1] &= line[1:]
        return i + 1 + int(np.argmax(returns)) if returns[:frames].any() else 0

    def _back(self, i: int, highest_s: float) -> int:
        """Judge a step back at frame i behind the latest stamp; return the frame to continue with."""
        t = self._t
        f = i - int(np.argmin(np.append(t[:i][::-1] > t[i] + 0.2 * self._back_s, False)))
        hole = float(t[f] - t[f - 1]) if f else np.inf
        near = f == 0 or t[i] - t[f - 1] < self._forward_s
        ahead = self._known <= f < i and hole > self._back_s and near
        if not self._enough(i, AWAY, f if ahead else i):
            return i
        if ahead and f and hole <= BLOCK_S and (k := self._block(i, f)):
            return k
        if k := self._in_line(i, highest_s, AWAY):
            self._replace(i, k, highest_s, float(t[k]))
            return k
        if ahead and (i - f <= AWAY if f else i <= FIRST < len(t) - i):
            self._replace(f, i, float(t[f - 1]) if f else -np.inf, float(t[i]))
            return i + 1
        self._set(i, highest_s)
        return i + 1

    def _block(self, i: int, f: int) -> int:
        """Put frames i to k before frames f to i if they fill the hole before these exactly; return k, or 0 if they do not."""
        t, back = self._t, self._back_s
        top, over = float(t[f:i].max()), np.flatnonzero(t[i : i + AHEAD] >= t[f])
        if not len(over):
            return 0 if self._enough(i, AHEAD, f) else i
        k = i + int(over[0])
        inside = t[i:k]
        rises = len(inside) > 0 and k <= self._limit and (np.diff(inside) >= -back).all()
        if not rises or t[f] - inside.max() > back or not -0.4 * back <= t[k] - top < self._forward_s:
            return 0
        turn = np.argsort(t[f:k], kind="stable")
        if not self._regular(f, i, np.concatenate([t[max(f - KEPT, 0) : f], t[f:k][turn], t[k : k + KEPT]])):
            return 0
        self._t[f:k] = t[f:k][turn]
        self._key[f:k] = self._key[f:k][turn]
        here = slice(f - self._known, k - self._known)
        self.order[here] = self.order[here][turn]
        self.repairs.append(Repair(float(self._t[f]), "reordered", message("event.written_late", frames=k - i, later=i - f)))
        return k

    def _regular(self, f: int, i: int, times: FloatArray) -> bool:
        """Return whether frames f to i keep their identifiers' own pace among the frames at these times: none comes too soon."""
        begin = max(f - KEPT, 0)
        key = self._key[begin : begin + len(times)][np.argsort(self._t[begin : begin + len(times)], kind="stable")]
        for name in np.unique(self._key[f : min(i, f + AWAY)]):
            intervals = np.diff(times[key == name])
            if len(intervals) and intervals.min() < 0.5 * np.median(intervals):
                return False
        return True

    def _due(self, i: int, end: int, before: int) -> float | None:
        """Return the shift [s] that brings the frames from i on to their due times, from the frames up to `before`."""
        begin = max(before - KEPT, 0)
        t, key = self._t[begin:before], self._key[begin:before]
        out: dict[int, float] = {}
        for j in range(i, min(end, i + 32)):
            name = int(self._key[j])
            if name in out:
                continue
            times = t[key == name]
            if len(times) > 2:
                out[name] = float(times[-1] + np.median(np.diff(times)) - self._t[j])
        if not out:
            return None
        middle = float(np.median(list(out.values())))
        exact = out.get(-1 if self._sync_id is None else self._sync_id, middle)
        return exact if abs(exact - middle) < self._period else middle

    def _replace(self, f: int, k: int, least_s: float, most_s: float) -> None:
        """Move frames f to k to their due times, between the two instants."""
        was = self._t[f:k].copy()
        move = self._due(f, k, f)
        if move is None:
            move = self._due_before(f, k) if not np.isfinite(least_s) else least_s - float(was[0])
        self._t[f:k] = np.clip(np.maximum.accumulate(was + move), least_s, most_s)
        text = message("event.stamped_late" if move < 0 else "event.stamped_early", frames=k - f, seconds=abs(move))
        self.repairs.append(Repair(float(self._t[f]), "stamp", text))

    def _due_before(self, f: int, k: int) -> float:
        """Return the shift [s] of frames f to k, the first of all, from the frames behind them."""
        t, key = self._t[k : k + KEPT], self._key[k : k + KEPT]
        for j in range(f, k):
            times = t[key == self._key[j]]
            if len(times) > 2:
                return float(times[0] - np.median(np.diff(times)) - self._t[j])
        return float(t[0] - FIRST_PERIOD_S - self._t[k - 1])

    def _set(self, i: int, highest_s: float) -> None:
        """Continue the times behind a clock that restarted or was set back."""
        t = self._t
        due = self._due(i, len(t), i)
        step = highest_s - float(t[i])
        expected = FIRST_PERIOD_S if due is None else max(float(t[i]) + due - highest_s, 0.0)
        for modulus, name in MODULI_S.items():
            passed = modulus - step
            from_zero = -self._period < t[i] - self.shift < RESTART_S and highest_s - self.shift < modulus + self._period
            longest = max(RESTART_S, 20 * self._period) if from_zero else expected + BACK * self._period
            if -BACK * self._period < passed < longest:
                self._move(i, modulus)
                self.repairs.append(Repair(float(t[i]), "clock_wrap", message("event.clock_wrap", range=name)))
                return
        self._move(i, step + expected)
        self.repairs.append(Repair(float(t[i]), "time", message("event.clock_back", seconds=step)))

    def _move(self, i: int, by: float) -> None:
        self._t[i:] += by
        self.shift += by

    def _forward(self, i: int, highest_s: float) -> int:
        """Judge a silence of a log before frame i; return the frame to continue with."""
        t = self._t
        begins = self._known == 0 and i <= FIRST
        if not self._enough(i, AHEAD, 0 if begins else i):
            return i
        silence = float(t[i]) - highest_s
        if silence <= BLOCK_S and (k := self._in_line(i, highest_s, AHEAD)) and (behind := self._block(k, i)):
            return behind
        if k := self._in_line(i, highest_s, AWAY):
            self._replace(i, k, highest_s, float(t[k]))
            return k
        if begins and silence > FIRST_PAUSE_S:
            self._replace(0, i, -np.inf, float(t[i]))
            return i + 1
        if silence > NO_PAUSE_S or self._moved_as_in_one_period(i):
            due = self._due(i, len(t), i)
            by = silence - (FIRST_PERIOD_S if due is None else min(max(float(t[i]) + due - highest_s, 0.0), silence))
            self._move(i, -by)
            self.repairs.append(Repair(float(t[i]), "time", f"forward by {by:.6g} s"))
        return i + 1

    def _moved_as_in_one_period(self, i: int) -> bool:
        """Return whether the counters moved across the silence before frame i as in one period.

        The steps before and behind it are the measure. Stamps behind it that follow faster than the period were late: no clock was set.
        """
        part = self._frames.take(self.order[: min(i + AHEAD, len(self._t)) - self._known])
        if self._earlier is not None:
            part = join([self._earlier, part])
        readings = decode(part, self._fields, self._sync_id)
        at = readings.frame + self._known - (0 if self._earlier is None else len(self._earlier))
        moving = 0
        for c, one in enumerate(self._fields):
            mine = readings.field == c
            values, rows = readings.value[mine], at[mine]
            before, behind = np.flatnonzero(rows < i)[-3:], np.flatnonzero(rows >= i)
            if len(before) < 3 or len(behind) < 3:
                continue
            stamps = self._t[rows]
            period = float(np.median(np.diff(stamps[rows < i][-16:])))
            at_once = float(np.median(np.diff(stamps[behind][:8]))) < 0.5 * period
            if at_once or earliest(stamps[behind], LATE * period)[0] - stamps[before[-1]] <= BACK * period:
                return False
            steps = _shortest(np.diff(values[np.concatenate([before, behind[:3]])]), one.modulus)
            wanted, across = float(steps[[0, 1, 3, 4]].mean()), float(steps[2])
            spread = float(np.ptp(steps[[0, 1, 3, 4]]))
            if abs(across - wanted) > 1.5 + spread:
                return False
            moving += abs(wanted) >= MOVES and spread < 0.5 * abs(wanted)
        return moving >= min(2, len(self._fields))


def _shortest(steps: IntArray, modulus: int) -> IntArray:
    """Return steps of a counter with so many values, the shorter way round."""
    return steps if modulus >= NO_RANGE else np.asarray((steps + modulus // 2) % modulus - modulus // 2)
