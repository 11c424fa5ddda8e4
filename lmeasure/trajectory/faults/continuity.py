"""Steps in the counts of single channels that no motion makes, told by the motion itself.

Between two samples a body of some inertia does not step. Let x be a cable's length at four samples, d1, d2, d3 the changes between them
in the times t1, t2, t3. Going on from before at d1/t1, or back from behind at d3/t3, the middle interval is missed by

    e1 = d2 - d1 t2/t1        e0 = d2 - d3 t2/t3.

Where the speed changes at once within the interval the two have opposite signs, and so they have under any steady acceleration: a step is
the median of 0, e0 and e1, what both agree on. An acceleration that changes from -A to A leaves at most A t2 (t1 + 2 t2 + t3) / 4. A is
taken from the motion: at every sample the second largest acceleration of all cables, which no fault of one channel can be, over stretches
long enough for whole counts not to matter; twice its largest value is allowed for.

A channel that stops or runs off from one sample to the next while the others go on evenly does not follow either: its change of speed is
held against the same A. One that all cables share is the robot's. Nor does a channel that stands on one count while another cable of the
same point is drawn far.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import FloatArray, Status
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths
from lmeasure.trajectory.faults.steps import (
    BINS,
    EVEN,
    HOLE,
    JITTERED,
    SMALLEST_COUNTS,
    STEP_MM,
    Break,
    Candidates,
    counted_sizes,
    off_usual_s,
    others_largest,
    steps_seen,
    two_largest,
)
from lmeasure.trajectory.faults.stuck_channels import StandingFinder, Stood

STRIDES = (1, 2)
"""Of samples: a count that was lost half-way between two samples, or was interpolated, is spread over two."""
MARGIN = 2.0
"""Times the acceleration of the motion: what its hardest stop has more."""
WINDOWS_S = (0.02, 0.005)
"""Over which accelerations are taken: whole counts of 0.012 mm then are 0.1 and 2 m/s^2. The first is that of the motion."""
RUSH = 5.0
"""Times the acceleration of the motion from which a single channel that changes its speed does not follow it."""
ALONE = 8.0
"""Times as much as the others change theirs together (root mean square)."""
GOING_MM_S = 5.0
"""Speed of another cable, before and behind, from which the tool is known to be on its way."""
BRIDGED_S = 0.1
"""Within which a channel that comes back to where it would be anyway has lost nothing."""
SHARED = 0.25
"""Of the largest step that may be left of the steps of all channels where the clock stepped, or their counts were held."""
HABITS_EVERY = 4
"""Samples of which one is looked at for what is usual."""
STALE = 0.1
"""Of the intervals in which a cable moves: a channel that steps more often does so by nature, as one that is read more often than it
counts."""
HELD = 8.0
"""Intervals for which such a channel holds its counts at most."""
HABIT = 0.02
"""Of a run: what a cable does for longer is its habit."""


@dataclass(frozen=True)
class Away:
    """A channel that was elsewhere for a moment, from the sample behind after_s to the one before until_s, and came back."""

    cable: int
    after_s: float
    until_s: float


@dataclass(frozen=True)
class Continuity:
    """What a run's counts tell of its channels: breaks, moments away and channels that stood, in order of time; acceleration_mm_s2 of the
    motion, least_mm (m,) the smallest step that would have been seen everywhere, infinite where none would, clock_s where all channels
    step as if the clock did, jitter_mm (m,) what of least_mm is from time stamps that jitter."""

    breaks: tuple[Break, ...]
    away: tuple[Away, ...]
    stood: tuple[Stood, ...]
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
        """Of the motion: at least, and what its stamps make of it."""
        self._standing = StandingFinder(rig)
        self._geometry = 0.0  # largest time squared over which a step may hide [s^2]
        self._jitter_mm = np.zeros(len(drums))
        self._looked = np.zeros(len(drums), np.bool_)
        """Channels that had as many counts on end as show a step."""
        self._going = np.zeros(len(drums))
        """Intervals in which each cable moved."""
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

    @property
    def _acceleration(self) -> float:
        return float(self._accelerations[0])

    def found(self) -> Continuity:
        """All that the run told."""
        breaks: list[Break] = []
        clock: set[float] = set()
        held, acceleration = self._held_s(), np.maximum(self._acceleration, self._usual(0))
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
        return Continuity(tuple(lost), tuple(away), stood, self._acceleration, least, tuple(sorted(clock)), self._jitter_mm.copy())

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
        """Breaks less those that the next one of the cable takes back at once, as moments away: a step the other way, or where a channel
        that stood goes on, to within what the motion tells, where it had come without."""
        lost: list[Break] = []
        away: list[Away] = []
        for new in breaks:
            of_cable = [old for old in lost if old.cable == new.cable]
            old = of_cable[-1] if of_cable else None
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
        known = STEP_MM + MARGIN * self._acceleration * gone**2 / 4.0 + new.u_mm
        return bool(abs(missed) <= known <= abs(new.by_mm) / 2.0)

    def _take_jumps(self, lengths: Lengths, time_s: FloatArray, mm: FloatArray, known: int) -> None:
        """Jumps beyond the stated speed, which may stand where no step can be told from the motion: behind empty cells, or first of all."""
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
        """Accelerations over w samples either way: the motion's, and those that one channel has by itself; off_s: of the stamps.

        Stamps that are off leave less of a cable that goes than of one that turns back, whose speed is none: what is suspected is taken at
        the least, and held against what the others may have at most.
        """
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
        # few: row by row from here on, what is not there being nothing
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
    """Whether the steps of all channels (m,) are what a step of the clock makes of their speeds."""
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
