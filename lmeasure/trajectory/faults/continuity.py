"""Steps in the counts of single channels that no motion makes, determined by the motion itself.

Between two samples a body of some inertia does not step. Let x be a cable's length at four samples, d1, d2, d3 the changes between them in
the times t1, t2, t3. Extrapolated from before at d1/t1, or back from behind at d3/t3, the middle interval has the errors

    e1 = d2 - d1 t2/t1        e0 = d2 - d3 t2/t3.

Where the speed changes at once within the interval the two have opposite signs, and so they have under any steady acceleration: a step is
the median of 0, e0 and e1, the value on which both agree. An acceleration that changes from -A to A leaves at most A t2 (t1 + 2 t2 + t3) /
4. A is taken from the motion: at every sample the second largest acceleration of all cables, which is no fault of one channel, over
stretches long enough to make rounding irrelevant; twice its largest value is allowed.

A channel that stops or runs off from one sample to the next while the others continue evenly does not follow either: its change of speed is
compared with the same A. One that all cables share is the robot's. Nor does a channel that stays on one count while another cable of the
same point moves far: its encoder died, or the cable hangs.

Doubts about channels: from when to when a channel's counts are not used, and by how much they are shifted.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, Status
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, Reason, with_reasons
from lmeasure.text import Message

EVERY = -1  # Instead of a cable: all of them


@dataclass(frozen=True)
class During:
    """Doubt of a cable, or another channel (index), or `EVERY`, from the sample behind after_s to the one at until_s [s]."""

    cable: int
    after_s: float
    until_s: float

    def mask(self, time_s: FloatArray) -> BoolArray:
        """(n,) which samples at times (n,) it is about."""
        return (time_s > self.after_s) & (time_s <= self.until_s)


@dataclass(frozen=True)
class Doubt(During):
    """Counts that are not used, with the status and cause of samples that need them."""

    status: Status
    said: Message


@dataclass(frozen=True)
class Shift(During):
    """Approximate surplus of true counts in a channel that continues from another origin. The remainder is a length: a drum is not linear
    in its counts, so that a length compensates them only near its place."""

    counts: float


@dataclass(frozen=True)
class Doubts:
    """Doubts of a run, in order of time, notes for the reader, and corrections of used counts."""

    every: tuple[Doubt, ...] = ()
    notes: tuple[Message, ...] = ()
    shifts: tuple[Shift, ...] = ()

    def with_more(self, *doubts: Doubt) -> "Doubts":
        """Return these doubts and others."""
        return replace(self, every=tuple(sorted((*self.every, *doubts), key=lambda d: (d.after_s, d.cable))))

    def about(self, cable: int, time_s: float) -> bool:
        """Return whether a cable is in doubt at a time."""
        return any(d.cable == cable and d.after_s < time_s <= d.until_s for d in self.every)

    def applied(self, rig: Rig, lengths: Lengths) -> Lengths:
        """Return lengths of a piece of the run without doubtful counts; counts in doubt only for a jump are used again if nothing
        contradicts them."""
        lost = any(reason.status == Status.ORIGIN_LOST for reasons in lengths.reasons for reason in reasons)
        first, last = float(lengths.time_s[0]), float(lengths.time_s[-1])
        here = [d for d in self.every if d.after_s < last and d.until_s >= first]
        moved = [s for s in self.shifts if s.after_s < last and s.until_s >= first]
        if not lost and not here and not moved:
            return lengths
        assert lengths.gone_on is not None
        lengths = replace(lengths, gone_on=shifted(moved, lengths.time_s, lengths.gone_on))
        reasons = []
        for j, before in enumerate(lengths.reasons):
            mine = [Reason(d.mask(lengths.time_s), d.status, d.said) for d in here if d.cable == j]
            # nothing else shows whether an angle encoder lost its origin
            kept = [r for r in before if r.status != Status.ORIGIN_LOST or j >= lengths.lengths]
            reasons.append((*kept, *(r for r in mine if r.mask.any())))
        lengths = with_reasons(rig, lengths, tuple(reasons))
        for doubt in here:
            if doubt.cable == EVERY:
                mask = doubt.mask(lengths.time_s)
                lengths.change_mm[mask] = lengths.counts[mask] = np.nan
                lengths.flags[mask], lengths.cause[mask], lengths.cable[mask] = doubt.status, doubt.said, ""
        return lengths


NONE = Doubts()


def shifted(shifts: Iterable[Shift], time_s: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, m) true counts at times (n,), minus these shifts."""
    counts = counts.copy()
    for s in shifts:
        counts[s.mask(time_s), s.cable] -= s.counts
    return counts


STEP_MM = 0.2  # A smaller step may be a cable's that sticks and slips
BINS = np.concatenate([[0.0], np.geomspace(1.0, 1e9, 181)])  # Accelerations [mm/s^2] up to which they are counted
JITTERED = 4.0  # Times the way that a cable goes while stamps are off: both speeds, and the interval itself
AROUND = 6  # Samples either way over which a speed is taken that stale counts do not hide
EVEN = 0.02  # Tolerance, in intervals, of whole multiples between stamps around missing rows
HOLE = 2.5  # usual intervals: a longer one is a gap
SMALLEST_COUNTS = 2.0  # largest effect of rounding alone


@dataclass(frozen=True)
class Break:
    """Change of a channel's origin: after the sample at before_s, at the latest by the one at after_s, by about by_mm of cable within u_mm;
    by_mm is NaN if it did not step but stopped or ran off. length_mm and speed_mm_s: its length and speed before and after."""

    cable: int
    before_s: float
    after_s: float
    by_mm: float
    u_mm: float
    length_mm: tuple[float, float] = (np.nan, np.nan)
    speed_mm_s: tuple[float, float] = (np.nan, np.nan)


@dataclass(frozen=True)
class Candidates:
    """Intervals with a possible change: before_s, after_s (k,); by (k, m) steps [mm], or accelerations [mm/s^2]; allowed_mm (k, m) allowed
    steps without any acceleration; geometry_s2 (k,) their increase by an acceleration; going_mm_s (k, m) speeds over a few samples either
    way, without the interval; length_mm, speed_mm_s (2, k, m) of the cables before and after."""

    before_s: FloatArray
    after_s: FloatArray
    by: FloatArray
    allowed_mm: FloatArray
    geometry_s2: FloatArray
    going_mm_s: FloatArray
    length_mm: FloatArray
    speed_mm_s: FloatArray

    def at(self, i: int, j: int, u_mm: float) -> Break:
        """Interval i as a break of cable j."""
        length, speed = self.length_mm[:, i, j].tolist(), self.speed_mm_s[:, i, j].tolist()
        return Break(j, float(self.before_s[i]), float(self.after_s[i]), float(self.by[i, j]), u_mm, tuple(length), tuple(speed))


def off_usual_s(time_s: FloatArray, interval: float) -> FloatArray:
    """(n - 1,) by how much intervals of stamps are off the usual one [s]: then it is not known how fast a cable went. Rows that are not
    there leave whole intervals."""
    steps = np.diff(time_s)
    off = np.abs(steps - np.maximum(np.rint(steps / interval), 1.0) * interval)
    return np.where((off < EVEN * interval) | (steps > HOLE * interval), 0.0, np.abs(steps - interval))


def steps_seen(
    time_s: FloatArray, mm: FloatArray, x: FloatArray, known: int, *, stride: int, count_mm: FloatArray, off_s: FloatArray
) -> list[Candidates]:
    """Steps of channels over `stride` samples that are larger than rounding, jitter and a cable that slips."""
    n = len(time_s)
    first = max(known - 3 * stride, 0)
    if n < first + 3 * stride + 1:
        return []
    d = x[:, first + stride :] - x[:, first:-stride]
    last = d.shape[1] - 2 * stride
    twice = 2.0 * d[:, stride : stride + last]
    twice -= d[:, :last]
    twice -= d[:, 2 * stride :]
    # errors of both continuations by half of this at most are alike, for any stamps
    rows = first + np.flatnonzero(np.fmax.reduce(np.abs(twice, out=twice), axis=0) > 2.0 * STEP_MM)
    if not len(rows):
        return []
    at = [rows + k * stride for k in range(4)]
    t1, t2, t3 = (time_s[at[k + 1]] - time_s[at[k]] for k in range(3))
    d1, d2, d3 = (mm[at[k + 1]] - mm[at[k]] for k in range(3))
    v1, v3 = d1 / t1[:, None], d3 / t3[:, None]
    e1, e0 = d2 - v1 * t2[:, None], d2 - v3 * t2[:, None]
    # stamps may be late where samples were even, and samples uneven where stamps are right: a step is one by both
    by = _both(_both(e0, e1), _both(d2 - d1, d2 - d3))
    # by how much the stamps of these samples may be off
    off = off_s[rows[:, None] + np.arange(3 * stride)].max(axis=1)
    rounding = SMALLEST_COUNTS * count_mm * np.maximum(1.0, np.maximum(t2 / t1, t2 / t3) / 2.0 + 0.5)[:, None]
    allowed = STEP_MM + rounding + np.nan_to_num(np.fmax(np.abs(v1), np.abs(v3))) * (JITTERED * off)[:, None]
    kept = (np.abs(by) > allowed).any(axis=1)
    if not kept.any():
        return []
    by, allowed, geometry = by[kept], allowed[kept], (t2 * (t1 + 2.0 * t2 + t3) / 4.0)[kept]
    i, k = at[1][kept], at[2][kept]
    before, after = np.maximum(i - AROUND, 0), np.minimum(k + AROUND, n - 1)
    around = np.maximum(time_s[i] - time_s[before] + time_s[after] - time_s[k], 1e-9)[:, None]
    going = np.nan_to_num((mm[i] - mm[before] + mm[after] - mm[k]) / around)
    return [Candidates(time_s[i], time_s[k], by, allowed, geometry, going, np.array((mm[i], mm[k])), np.array((v1[kept], v3[kept])))]


def _both(a: FloatArray, b: FloatArray) -> FloatArray:
    """Return the common part of two estimates of a step: the smaller of the same sign, else zero; zero if one is NaN."""
    out = np.where(np.sign(a) == np.sign(b), np.sign(a) * np.minimum(np.abs(a), np.abs(b)), 0.0)
    return np.where(np.isfinite(out), out, 0.0)


def counted_sizes(values: FloatArray) -> IntArray:
    """(m, bins) how many of (m, n) accelerations are up to each of `BINS` and above the one before; NaN counts as none at all."""
    place = np.searchsorted(BINS, np.nan_to_num(values)).clip(max=len(BINS) - 1)
    return np.stack([np.bincount(row, minlength=len(BINS)) for row in place])


def two_largest(values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(n,) each: the largest and the second largest of (m, n) values; NaN is passed over."""
    largest, second = np.full(values.shape[1], -np.inf), np.full(values.shape[1], -np.inf)
    for row in values:
        # NaN is no smaller one
        second = np.fmax(second, np.minimum(largest, row))
        largest = np.fmax(largest, row)
    return largest, second


def others_largest(values: FloatArray) -> FloatArray:
    """(n, m) of each column the largest of the other columns at the same row; NaN is passed over."""
    values = np.nan_to_num(values)
    if values.shape[1] < 2:
        return np.zeros_like(values)
    ordered = np.partition(values, -2, axis=1)
    return np.where(values >= ordered[:, -1:], ordered[:, -2:-1], ordered[:, -1:])


STANDS_S = 0.2
STANDS_MM = 50.0
"""Way of another cable of the same attachment point while one stays on a count, and least duration: its point moves, and not on a
sphere."""
MOST_MM = 5.0
MOST = 2.0
"""Largest change of a cable from sample to sample, or multiple of the second largest of all cables; more is a step."""
MOVES_MM = 5.0
MOVING = 3  # Cables that move at least so much, when the tool does


@dataclass(frozen=True)
class StuckCounter:
    """Channel of a cable (index) that stayed on one count from after_s until until_s [s], or to the end."""

    cable: int
    after_s: float
    until_s: float


class StandingFinder:
    """Search for channels that stay on one count while another cable of the same attachment point moves far."""

    def __init__(self, rig: Rig) -> None:
        points = np.array([c.to_point for c in rig.cable])
        m = len(points)
        braked = np.array([rig.point(c.from_point).drum.braked for c in rig.cable])
        self._together = (points[:, None] == points) & ~np.eye(m, dtype=np.bool_) & ~braked[:, None]
        # of each channel: its last count and since when, the extremes of the ways of all cables since then, and whether it has been
        # determined
        self._last, self._last_s, self._since = np.full(m, np.nan), np.full(m, np.nan), np.full(m, np.nan)
        self._low, self._high = np.full((m, m), np.inf), np.full((m, m), -np.inf)
        self._reported, self._way = np.zeros(m, np.bool_), np.zeros(m)
        self._found: list[StuckCounter] = []

    def add(self, time_s: FloatArray, mm: FloatArray) -> None:
        """The next samples: times (n,) and lengths (n, m) by the counts alone."""
        # a cable that steps has not been drawn
        steps = np.nan_to_num(np.diff(mm, axis=0, prepend=self._last[None]))
        most = np.maximum(MOST_MM, MOST * two_largest(np.abs(steps.T))[1])[:, None]
        gone = steps.clip(-most, most).cumsum(axis=0) + self._way
        self._way = gone[-1]
        for j in np.flatnonzero(self._together.any(axis=1)):
            # empty cells show neither motion nor rest
            seen = np.flatnonzero(np.isfinite(mm[:, j]))
            if len(seen):
                self._look(int(j), time_s[seen], mm[seen, j], gone[seen])

        for cable, column in enumerate(mm.T):
            seen = np.flatnonzero(np.isfinite(column))
            if len(seen):
                self._last[cable], self._last_s[cable] = column[seen[-1]], time_s[seen[-1]]

    def _look(self, j: int, time_s: FloatArray, mm: FloatArray, gone: FloatArray) -> None:
        """Check a channel's own samples: times and lengths (n,), and the ways of all cables (n, m)."""
        values, times = np.concatenate([self._last[j : j + 1], mm]), np.concatenate([self._last_s[j : j + 1], time_s])
        moved = np.flatnonzero((values[1:] != values[:-1]) | ~(np.diff(times) <= STANDS_S))
        edges = np.concatenate([[0], moved, [len(time_s)]])
        # the interval that continues from before, long ones, and the last one
        lasting = time_s[edges[1:] - 1] - time_s[edges[:-1]] >= STANDS_S
        lasting[0] = lasting[-1] = True
        for number in np.flatnonzero(lasting).tolist():
            begin, end = int(edges[number]), int(edges[number + 1])
            if number:
                self._since[j], self._reported[j] = time_s[begin], False
                self._low[j], self._high[j] = np.inf, -np.inf
            if end > begin:
                self._go_on(j, time_s[begin:end], gone[begin:end])
            if self._reported[j] and end < len(time_s):
                k = max(i for i, stood in enumerate(self._found) if stood.cable == j)
                # its last sample at rest may be in the previous piece
                self._found[k] = replace(self._found[k], until_s=float(time_s[end - 1] if end else self._last_s[j]))

    def _go_on(self, j: int, time_s: FloatArray, mm: FloatArray) -> None:
        if self._reported[j]:
            return
        self._low[j] = np.fmin(self._low[j], np.fmin.reduce(mm, axis=0))
        self._high[j] = np.fmax(self._high[j], np.fmax.reduce(mm, axis=0))
        far = self._high[j] - self._low[j]
        # one cable alone that runs off is itself at fault
        since = float(self._since[j] if np.isfinite(self._since[j]) else time_s[0])
        self._since[j] = since
        long = time_s[-1] - since >= STANDS_S
        if long and far[self._together[j]].max() > STANDS_MM and (far > MOVES_MM).sum() >= MOVING:
            self._reported[j] = True
            self._found.append(StuckCounter(j, since, np.inf))

    def found(self) -> tuple[StuckCounter, ...]:
        """All of them."""
        return tuple(sorted(self._found, key=lambda stood: stood.after_s))


STRIDES = (1, 2)  # Of samples: a count that was lost half-way between two samples, or was interpolated, is spread over two
MARGIN = 2.0  # Factor on the acceleration of the motion, for its hardest stop
WINDOWS_S = (0.02, 0.005)
"""Over which accelerations are taken: whole counts of 0.012 mm then are 0.1 and 2 m/s^2. The first is that of the motion."""
RUSH = 5.0  # Times the acceleration of the motion from which a single channel that changes its speed does not follow it
ALONE = 8.0  # Times as much as the others change theirs together (root mean square)
GOING_MM_S = 5.0  # Speed of another cable, before and behind, from which the tool is known to be on its way
BRIDGED_S = 0.1  # Within which a channel that comes back to where it would be anyway has lost nothing
SHARED = 0.25  # Of the largest step that may be left of the steps of all channels where the clock stepped, or their counts were held
HABITS_EVERY = 4  # One sample of this many is used for usual values
STALE = 0.1
"""Part of the intervals in which a cable moves: a channel that steps more often does so by nature, if it is read more often than it
counts."""
HELD = 8.0  # Intervals for which such a channel holds its counts at most
HABIT = 0.02  # Part of a run: longer behaviour is usual for the cable


@dataclass(frozen=True)
class Away:
    """A channel that was elsewhere for a moment, from the sample behind after_s to the one before until_s, and came back."""

    cable: int
    after_s: float
    until_s: float


@dataclass(frozen=True)
class Continuity:
    """Evidence of a run's counts about its channels: breaks, moments away and stuck channels, in order of time; acceleration_mm_s2 of the
    motion, least_mm (m,) the smallest step that is detectable everywhere, infinite if none would, clock_s: steps of all channels like a
    step of the clock, jitter_mm (m,) the part of least_mm from jitter of time stamps."""

    breaks: tuple[Break, ...]
    away: tuple[Away, ...]
    stood: tuple[StuckCounter, ...]
    acceleration_mm_s2: float
    least_mm: FloatArray
    clock_s: tuple[float, ...] = ()
    jitter_mm: FloatArray | None = None


class ContinuityFinder:
    """Collects the breaks of a run whose lengths are given in pieces."""

    def __init__(self, rig: Rig) -> None:
        drums = [rig.point(c.from_point).drum for c in rig.cable]
        self._count_mm = np.array([d.count_length_mm / d.scale for d in drums])
        self._mm = np.array([d.count_length_mm for d in drums])
        self._time_s, self._mm_at = np.empty(0), np.empty((0, len(drums)))
        self._interval_s = 0.0
        self._accelerations, self._hardest = np.zeros(len(WINDOWS_S)), np.zeros(len(WINDOWS_S))
        """Least acceleration of the motion, and its part from stamps."""
        self._standing = StandingFinder(rig)
        self._geometry = 0.0  # largest time squared over which a step may hide [s^2]
        self._jitter_mm = np.zeros(len(drums))
        self._looked = np.zeros(len(drums), np.bool_)  # Channels that had as many counts on end as show a step
        self._going = np.zeros(len(drums))  # Intervals in which each cable moved
        self._steps: list[Candidates] = []
        self._habits = [np.zeros((len(drums), len(BINS)), np.int64) for _ in WINDOWS_S]
        self._rushes: list[list[Candidates]] = [[] for _ in WINDOWS_S]
        self._jumps: list[Break] = []
        self._last_seen: list[tuple[float, float] | None] = [None] * len(drums)

    def add(self, lengths: Lengths) -> None:
        """Take the next piece into account."""
        assert lengths.gone_on is not None
        time_s = np.concatenate([self._time_s, lengths.time_s])
        mm = np.concatenate([self._mm_at, lengths.gone_on * self._mm])
        known = len(self._time_s)
        self._take_jumps(lengths, time_s, mm, known)
        if len(time_s) >= 4:
            interval = float(np.median(np.diff(time_s)))
            self._interval_s = max(self._interval_s, interval)
            windows = [max(1, round(window / interval)) for window in WINDOWS_S]
            off = off_usual_s(time_s, interval)
            x = np.ascontiguousarray(mm.T)  # along each channel
            self._look_for_steps(time_s, mm, x, known, interval, off)
            for number, w in enumerate(windows):
                self._look_for_rushes(time_s, mm, x, known, w, number, float(off.max()))
            kept = max(2 * max(windows) + 1, 3 * max(STRIDES) + 1)
            self._time_s, self._mm_at = time_s[-kept:].copy(), mm[-kept:].copy()
        else:
            self._time_s, self._mm_at = time_s, mm
        self._standing.add(lengths.time_s, lengths.gone_on * self._mm)

    def found(self) -> Continuity:
        """All that the run determined."""
        breaks: list[Break] = []
        clock: set[float] = set()
        held, acceleration = self._held_s(), np.maximum(self._accelerations[0], self._usual(0))
        for candidates in self._steps:
            allowed = candidates.allowed_mm + MARGIN * acceleration * candidates.geometry_s2[:, None]
            allowed += held * np.abs(candidates.going_mm_s)
            beyond = np.abs(candidates.by) > allowed
            for i in np.flatnonzero(beyond.any(axis=1)):
                if _of_the_clock(candidates.by[i], candidates.going_mm_s[i], allowed[i]):
                    clock.add(float(candidates.before_s[i]))
                else:
                    _add(breaks, (candidates.at(int(i), int(j), float(allowed[i, j])) for j in np.flatnonzero(beyond[i])))
        _add(breaks, self._jumps)
        for number, every in enumerate(self._rushes):
            for candidates in every:
                beyond = np.abs(candidates.by) > RUSH * self._hardest[: number + 1].max() + 2.0 * self._usual(number)
                rushed = (replace(candidates.at(int(i), int(j), np.nan), by_mm=np.nan) for i, j in np.argwhere(beyond))
                # a step is a rush as well, as far as the stretch reaches
                _add(breaks, rushed, 1.5 * max(WINDOWS_S[number], self._interval_s))
        stood = self._standing.found()
        ends = [(s.cable, s.until_s, float(np.nextafter(s.until_s, np.inf))) for s in stood if s.until_s < np.inf]
        _add(breaks, (Break(*end, np.nan, np.nan) for end in ends), self._interval_s)
        breaks.sort(key=lambda b: b.before_s)
        lost, away = self._bridged(breaks)
        least = STEP_MM + SMALLEST_COUNTS * self._count_mm + MARGIN * acceleration * self._geometry + self._jitter_mm
        least = np.where(self._looked, least, np.inf)
        of_motion = float(self._accelerations[0])
        return Continuity(tuple(lost), tuple(away), stood, of_motion, least, tuple(sorted(clock)), self._jitter_mm.copy())

    def _usual(self, number: int) -> FloatArray:
        """(m,) the acceleration of each cable by habit, in all but some hundredths of the run: a tool may have a way along which it
        accelerates one cable only."""
        counts = np.cumsum(self._habits[number], axis=1)
        reached = counts >= (1.0 - HABIT) * np.maximum(counts[:, -1:], 1)
        return np.where(counts[:, -1] > 0, BINS[np.argmax(reached, axis=1)], 0.0)

    def _held_s(self) -> FloatArray:
        """(m,) for how long [s] a channel that steps all the time holds its counts: more than steps of that size are faults."""
        by = np.concatenate([np.abs(c.by) * (np.abs(c.by) > c.allowed_mm) for c in self._steps] or [np.zeros((0, len(self._mm)))])
        going = np.concatenate([np.abs(c.going_mm_s) for c in self._steps] or [np.zeros((0, len(self._mm)))])
        out = np.zeros(len(self._mm))
        for j in np.flatnonzero((by > 0.0).sum(axis=0) > STALE * self._going):
            steps = by[:, j] > 0.0
            held = 2.0 * np.quantile(by[steps, j] / np.maximum(going[steps, j], GOING_MM_S), 0.95)
            out[j] = min(held, HELD * self._interval_s)
        return out

    def _bridged(self, breaks: list[Break]) -> tuple[list[Break], list[Away]]:
        """Return breaks without those that the cable's next one takes back at once, as moments away: a step in the other direction, or a
        stuck channel that continues at its expected value, within the accuracy of the motion."""
        lost: list[Break] = []
        away: list[Away] = []
        for new in breaks:
            old = next((old for old in reversed(lost) if old.cable == new.cable), None)
            if old is not None and new.before_s - old.after_s <= BRIDGED_S and self._took_back(old, new):
                lost.remove(old)
                away.append(Away(new.cable, old.before_s, new.after_s))
            else:
                lost.append(new)
        return lost, away

    def _took_back(self, old: Break, new: Break) -> bool:
        if np.isfinite(old.by_mm):
            return bool(abs(old.by_mm + new.by_mm) <= old.u_mm + new.u_mm)
        gone = new.after_s - old.before_s
        missed = new.length_mm[1] - old.length_mm[0] - gone * (old.speed_mm_s[0] + new.speed_mm_s[1]) / 2.0
        known = STEP_MM + MARGIN * self._accelerations[0] * gone**2 / 4.0 + new.u_mm
        return bool(abs(missed) <= known <= abs(new.by_mm) / 2.0)

    def _take_jumps(self, lengths: Lengths, time_s: FloatArray, mm: FloatArray, known: int) -> None:
        """Record jumps beyond the stated speed, which are kept if the motion cannot determine a step: behind empty cells, or at the very
        beginning."""
        for j, reasons in enumerate(lengths.reasons):
            for reason in reasons:
                if reason.status != Status.JUMP:
                    continue
                for i in (np.flatnonzero(reason.mask) + known).tolist():
                    seen = np.flatnonzero(np.isfinite(mm[:i, j]))
                    before = (float(time_s[seen[-1]]), float(mm[seen[-1], j])) if len(seen) else self._last_seen[j]
                    if before is None or not np.isfinite(mm[i, j]):
                        continue
                    about = float(np.fmax.reduce(np.abs(np.diff(mm[max(i - 3, 0) : i, j])), initial=0.0))
                    self._jumps.append(Break(j, before[0], float(time_s[i]), float(mm[i, j]) - before[1], STEP_MM + 2.0 * about))
        for j, column in enumerate(mm.T):
            seen = np.flatnonzero(np.isfinite(column))
            if len(seen):
                self._last_seen[j] = float(time_s[seen[-1]]), float(column[seen[-1]])

    def _look_for_steps(self, time_s: FloatArray, mm: FloatArray, x: FloatArray, known: int, interval: float, off: FloatArray) -> None:
        steps = np.diff(time_s)
        for stride in STRIDES:
            self._steps += steps_seen(time_s, mm, x, known, stride=stride, count_mm=self._count_mm, off_s=off)
        for j in np.flatnonzero(~self._looked):
            there = np.isfinite(x[j])
            self._looked[j] = (there[:-3] & there[1:-2] & there[2:-1] & there[3:]).any()
        gone = np.abs(np.diff(x[:, max(known - 1, 0) :]))
        self._going += (gone > self._count_mm[:, None]).sum(axis=1)
        fine = steps <= HOLE * interval
        self._geometry = max(self._geometry, float((steps[fine] ** 2).max(initial=0.0)))
        if off.any():
            speed = np.abs(np.diff(x))[:, fine] / np.maximum(steps[fine], interval)
            self._jitter_mm = np.fmax(self._jitter_mm, JITTERED * np.fmax.reduce(speed * off[fine], axis=1, initial=0.0))

    def _look_for_rushes(self, time_s: FloatArray, mm: FloatArray, x: FloatArray, known: int, w: int, number: int, off_s: float) -> None:
        """Find accelerations over w samples either way: the motion's, and those of one channel by itself; off_s: error of the stamps. Wrong
        stamps leave less of a moving cable than of one at its turning point, where the speed is zero. So a suspected acceleration is taken
        at its least, and compared with the largest of the others."""
        m, n = x.shape
        if n <= 2 * w or m < 2:
            return
        before, after = time_s[w:-w] - time_s[: -2 * w], time_s[2 * w :] - time_s[w:-w]
        interval = float(np.median(np.diff(time_s)))
        bent = x[:, 2 * w :] - 2.0 * x[:, w:-w]
        bent += x[:, : -2 * w]
        # by the samples' order, and where they are not even by their stamps: as for steps
        missed_mm = SMALLEST_COUNTS * self._count_mm[:, None]
        size = (np.abs(bent, out=bent) - 2.0 * missed_mm) / (w * interval) ** 2
        least = size
        if max(np.abs(before - w * interval).max(), np.abs(after - w * interval).max()) > EVEN * w * interval:
            first, second = (x[:, w:-w] - x[:, : -2 * w]) / before, (x[:, 2 * w :] - x[:, w:-w]) / after
            changed, per = np.abs(second - first), 2.0 / (before + after)
            twice = 1.0 / before + 1.0 / after
            by_stamps = (changed - missed_mm * twice) * per
            least = np.fmin(size, by_stamps - 2.0 * off_s * np.fmax(np.abs(first), np.abs(second)) * twice * per)
            size = np.fmin(size, by_stamps)
        largest, next_largest = two_largest(least)
        self._accelerations[number] = max(self._accelerations[number], float(np.fmax.reduce(next_largest, initial=0.0)))
        self._hardest[number] = max(self._hardest[number], float(np.fmax.reduce(two_largest(size)[1], initial=0.0)))
        self._habits[number] += counted_sizes(least[:, max(known - 2 * w, 0) :: HABITS_EVERY])
        limit = RUSH * self._hardest[: number + 1].max()
        # a cable that sticks and slips rushes as well
        slips = 2.0 * STEP_MM / (w * interval) ** 2
        some = np.flatnonzero(largest > limit + slips)
        some = some[some + 2 * w >= known]
        if not len(some):
            return
        # few, so row by row from here on; missing values count as zero
        mine, seen = (np.maximum(np.nan_to_num(a[:, some].T), 0.0) for a in (least, size))
        first, second = ((mm[some + k] - mm[some + k - w]) / (time_s[some + k] - time_s[some + k - w])[:, None] for k in (w, 2 * w))
        others = np.sqrt(np.maximum((seen**2).sum(axis=1, keepdims=True) - seen**2, 0.0) / (m - 1))
        going = np.minimum(others_largest(np.abs(first)), others_largest(np.abs(second))) > GOING_MM_S
        # where the change is in the middle of the stretch it is seen largest
        around = np.clip(some[:, None] + np.arange(-w, w + 1), 0, size.shape[1] - 1)
        peak = np.fmax.reduce(least[:, around], axis=2).T
        alone = (mine > limit + slips) & (mine > ALONE * others) & going & (mine >= peak)
        rows = np.flatnonzero(alone.any(axis=1))
        if len(rows):
            middle, nothing = some[rows] + w, np.zeros(len(rows))
            by = np.where(alone, mine - slips, 0.0)[rows]
            states = np.zeros_like(by), np.array((mm[middle], mm[middle])), np.array((first[rows], second[rows]))
            self._rushes[number].append(Candidates(time_s[middle - 1], time_s[middle + 1], by, nothing[:, None], nothing, *states))


def _of_the_clock(by_mm: FloatArray, speed_mm_s: FloatArray, allowed_mm: FloatArray) -> bool:
    """Return whether the steps of all channels (m,) are those of a step of the clock at their speeds."""
    speed = np.nan_to_num(speed_mm_s)
    squares = float(speed @ speed)
    if (np.abs(by_mm) > allowed_mm).sum() < 2 or squares == 0.0:
        return False
    left = by_mm - speed * (speed @ by_mm / squares)
    return bool((np.abs(left) <= np.maximum(allowed_mm, SHARED * np.abs(by_mm).max())).all())


def _add(breaks: list[Break], new: Iterable[Break], within_s: float = 0.0) -> None:
    """Take the new ones that are not seen already, or near."""
    for one in new:
        near = (one.before_s < old.after_s + within_s and old.before_s - within_s < one.after_s for old in breaks if old.cable == one.cable)
        if not any(near):
            breaks.append(one)
