"""Judge whether a counter continues from the same origin: compare its counts with the motion before and behind a gap.

The speed v0 before the gap is the mean over a window w0. A body with an acceleration within A moves by v0 p +- A p (p + w0) / 2 in a pause
p. A is the rig's limit, else twice the largest acceleration of the channel so far. A step within that band cannot be detected: its width is
reported. A count outside the band is in doubt until the speed v1 behind the pause is known. So is a count that a device restarted at zero
could show too. A motion from speed v0 to v1 covers between v0 p and v1 p, +- A p^2 / 4.

A step s of a counter with M values may also be s - M or s + M. This is ruled out if

- the largest speed does not allow M - |s| in the time between the readings, which late stamps do not lengthen;
- the other channels were read throughout and moved by less than QUARTER of M - |s|: all cables hold one body;
- no channel changed its count by more than REST_MM: the body is at rest.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from lmeasure.acquisition.counters.decoders import NO_RANGE, CounterField
from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.rig import Rig
from lmeasure.text import message

GAP = 1.6
"""Periods without a reading, in a log or of a free timer: behind them the motion decides whether the origin is the same."""
PAUSE_PERIODS, PAUSE_S = 10.0, 0.25
"""The same for SYNCs of a live bus, in periods and seconds, and the pause of a bus that is reported. A busy host takes frames late, or
loses SYNCs, for that long while every encoder runs on. In a log a single missing period is already a gap."""
WINDOW_S = 0.02
"""Window for speeds and accelerations."""
READINGS = 3
"""Smallest number of intervals for a speed, if there are so many."""
LONGEST_WINDOW = 32
"""Largest number of intervals."""
MARGIN = 2.0
"""Factor from the acceleration so far to that of the hardest stop."""
ROUNDING = 1.0
"""Units by which two whole counts may miss the path between them."""


def longest_interval(usual_s: float, *, live: bool) -> float:
    """Return the longest interval [s] between readings that is no gap, by their usual interval."""
    return max(PAUSE_PERIODS * usual_s, PAUSE_S) if live else GAP * usual_s


@dataclass(frozen=True)
class Speed:
    """State a speed [units/s], its window [s], and the largest deviation of the stamps in it from their usual interval [s]."""

    rate: float
    window_s: float
    off_s: float = 0.0

    def error(self, pause_s: float) -> float:
        """Return the error [units] of the path in a pause: counts are whole, and stamps may be late."""
        return (ROUNDING + 2.0 * abs(self.rate) * self.off_s) * (1.0 + pause_s / self.window_s)


@dataclass(frozen=True)
class Pause:
    """Describe a pause between two readings: total and speed at the first one, and its length.

    least_s is the length by the numbers of the readings, most_s by their stamps, which may be late."""

    total: int
    speed: Speed | None
    least_s: float
    most_s: float


@dataclass
class Line:
    """Keep the last readings of a counter and the largest acceleration so far.

    slack: units by which a count may deviate without a fault; max_rate [units/s] and stated [units/s^2]: limits that the rig states.
    """

    slack: float
    max_rate: float
    stated: float | None = None
    times: FloatArray = field(default_factory=lambda: np.empty(0))
    totals: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    whole: int = 0
    """Number of the latest of them without a gap between them."""
    hardest: float = np.inf
    """Largest acceleration of the channel so far [units/s^2]; infinite before the first."""

    def learn(self, times: FloatArray, totals: IntArray, usual_s: float, *, behind_gap: bool = False) -> None:
        """Take (n,) readings without a gap between them; behind_gap: a gap precedes them."""
        if len(times) == 0:
            return
        self.times, self.totals = np.concatenate([self.times, times]), np.concatenate([self.totals, totals])
        self.whole = len(times) + (0 if behind_gap else self.whole)
        t, x = self.times[-self.whole :], self.totals[-self.whole :]
        w = int(np.clip(round(WINDOW_S / usual_s), 1, LONGEST_WINDOW)) if usual_s > 0.0 else 1
        interval = usual_s if usual_s > 0.0 else float(np.median(np.diff(t))) if len(t) > 2 * w else 0.0
        if len(x) > 2 * w and interval > 0.0:
            # by their order: stamps may be late, counts are taken evenly
            steps = x[w:] - x[:-w]
            bends = steps[w:] - steps[:-w]
            bent = max(int(bends.max()), -int(bends.min())) - 2.0 * ROUNDING
            self.hardest = max(0.0 if np.isinf(self.hardest) else self.hardest, bent / (w * interval) ** 2)
        most = 2 * LONGEST_WINDOW + 1
        self.times, self.totals, self.whole = self.times[-most:].copy(), self.totals[-most:].copy(), min(self.whole, most)

    def speed(self, usual_s: float) -> Speed | None:
        """Return the speed at the last reading; None if there is only one."""
        n = len(self.times)
        if n < 2:
            return None
        far = int(np.searchsorted(-(self.times[::-1] - self.times[-1]), WINDOW_S - 1e-9))
        return speed_of(self.times[-1 - min(max(far, READINGS), n - 1) :], self.totals[-1 - min(max(far, READINGS), n - 1) :], usual_s)

    def band(self, pause: Pause, pause_s: float, least: float = 0.0) -> tuple[float, float]:
        """Return the smallest and largest total after pause_s from the motion before, with an acceleration of at least `least`."""
        speed, fastest = pause.speed, self.max_rate * pause_s + ROUNDING
        if speed is None:
            return pause.total - fastest, pause.total + fastest
        way = speed.rate * pause_s
        by = self.slack + speed.error(pause_s) + max(self._acceleration(), least) * pause_s * (pause_s + speed.window_s) / 2.0
        by = min(by, fastest + abs(way))
        return pause.total + way - by, pause.total + way + by

    def band_between(self, pause: Pause, behind: Speed) -> tuple[float, float]:
        """Return the same if the speed behind the pause is known too."""
        before, p = pause.speed or behind, pause.most_s
        ends = [s.rate * t for s in (before, behind) for t in (pause.least_s, p)]
        by = self.slack + before.error(p) + behind.error(p)
        by += self._acceleration() * p * (p / 4.0 + max(before.window_s, behind.window_s) / 2.0)
        by = min(by, self.max_rate * p + ROUNDING + abs(before.rate) * p)
        return pause.total + min(ends) - by, pause.total + max(ends) + by

    def _acceleration(self) -> float:
        return self.stated if self.stated is not None else MARGIN * self.hardest


def speed_of(times: FloatArray, totals: IntArray, usual_s: float) -> Speed:
    """Return the speed from the first to the last of (n,) readings, at least two."""
    steps = np.diff(times)
    off = float(np.abs(steps - np.maximum(np.rint(steps / usual_s), 1.0) * usual_s).max()) if usual_s > 0.0 else 0.0
    window = max(float(times[-1] - times[0]), len(steps) * usual_s, 1e-9)
    return Speed(float(totals[-1] - totals[0]) / window, window, off)


@dataclass
class Doubt:
    """Keep an origin in doubt: the pause, the readings behind it so far, and whether the device may have restarted at zero."""

    pause: Pause
    restart: bool
    times: list[float] = field(default_factory=list)
    totals: list[int] = field(default_factory=list)

    def go_on(self, time_s: float, least_s: float) -> None:
        """Take a further gap behind the readings so far: the pause lasts until the next reading, at time_s."""
        gone = self.times[-1] - self.times[0]
        more = (gone + least_s, gone + max(time_s - self.times[-1], least_s))
        self.pause = replace(self.pause, least_s=self.pause.least_s + more[0], most_s=self.pause.most_s + more[1])
        self.times, self.totals = [], []

    def known(self) -> bool:
        """Return whether the readings behind give a speed."""
        return len(self.times) > READINGS and self.times[-1] - self.times[0] >= WINDOW_S - 1e-9


def moduli(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) how many codes absolute encoders have before they begin anew, 0 of channels that count on."""
    return np.array([float(rig.counters_of(passage)[c].codes or 0) for c in channels])


def folded(difference: FloatArray, modulus: FloatArray) -> FloatArray:
    """Differences (..., m) of counts, of absolute encoders the shorter way round."""
    turn = np.where(modulus > 0.0, modulus, 1.0)
    return np.where(modulus > 0.0, (difference + turn / 2.0) % turn - turn / 2.0, difference)


class ContinuedCounts:
    """Counts of m channels, given piece by piece, without the turns of absolute encoders with modulus (m,): they continue from the first
    count."""

    def __init__(self, modulus: FloatArray) -> None:
        self._modulus, self._latest = modulus, np.full(len(modulus), np.nan)

    def of(self, recorded: FloatArray) -> FloatArray:
        """(n, m) of the next counts (n, m), NaN where there is none."""
        out = recorded.copy()
        for j in np.flatnonzero(self._modulus):
            there = np.flatnonzero(np.isfinite(recorded[:, j]))
            if len(there):
                first = recorded[there[0], j] if np.isnan(self._latest[j]) else self._latest[j]
                steps = folded(np.diff(recorded[there, j], prepend=first)[:, None], self._modulus[j : j + 1])[:, 0]
                out[there, j] = first + np.cumsum(steps)
                self._latest[j] = out[there[-1], j]
        return out


ASSUMED_S = 0.02
"""SYNC period for the warning, before the period is known."""
NARROW_S = 10.0
"""A counter that needs longer for half its range at the largest speed is not judged."""
QUARTER = 0.25
REST_MM = 5.0
WATCHED = 0.7
"""Smallest part of its SYNCs that a channel answers if it was read throughout."""
UNSEEN = 1e9
"""A pause counts as so many SYNCs."""
OTHERS = 2
"""Smallest number of other channels for a decision."""


class Counter(Protocol):
    """State a counter's number of values, largest rate [1/s], and millimetres per unit (None: it is no length)."""

    max_rate: float

    @property
    def unit_mm(self) -> float | None:
        """Return the millimetres per unit, None if it is no length."""

    @property
    def values(self) -> int:
        """Return the number of its values, 0 if it never wraps unseen."""


def range_notes(rig: Rig, fields: Sequence[CounterField], passage: int = 1, period_s: float | None = None) -> list[str]:
    """Return a line for counters that can pass half their range within two periods of the SYNC, or within ASSUMED_S where none is known."""
    known = rig.counters_of(passage)
    alike: dict[tuple[int, str, float, str, float], list[str]] = {}
    for f in fields:
        counter = known[f.channel]
        half_s = 0.5 * f.modulus * f.scale / counter.rate
        if counter.codes is None and f.modulus < NO_RANGE and half_s < 2.0 * (period_s or ASSUMED_S):
            key, unit = counter.rate_key, "mm/s" if counter.is_length else "deg/s"
            limit = counter.rate * counter.speed_per_count
            alike.setdefault((f.modulus, key, limit, unit, half_s), []).append(f.channel)
    return [
        message(
            "acquisition.counts_pass_half_their",
            channels=tuple(channels),
            counts=modulus,
            time=1000.0 * half_s,
            limit=limit,
            unit=unit,
            key=key,
            period=1000.0 * 0.46 * half_s,
        )
        for (modulus, key, limit, unit, half_s), channels in alike.items()
    ]


def may_wrap(steps: IntArray, passed_s: FloatArray, values: int, max_rate: float) -> BoolArray:
    """Return (n,) whether the speed allows another way round for steps (n,) between readings that are passed_s (n,) apart."""
    return np.asarray(values - np.abs(steps) <= max_rate * passed_s + 1.0)


class Evidence:
    """Collect the evidence of other channels on a channel's gap."""

    def __init__(self, counters: Sequence[Counter]) -> None:
        self._values = np.array([c.values for c in counters], np.float64)
        self._unit = np.array([np.nan if c.unit_mm is None else c.unit_mm for c in counters])
        rates = np.array([c.max_rate for c in counters])
        self.narrow = bool(((self._values > 0) & (self._values < 2.0 * NARROW_S * rates)).any())
        m = len(counters)
        self._before = np.zeros(m)
        self._any = np.zeros(m, np.bool_)
        self._since = np.zeros((m, m)), np.zeros((m, m)), np.zeros(m)
        """Since the last reading of each channel: how far each other one moved, how often it was read, and the SYNCs."""

    def of(self, value: IntArray, there: BoolArray, paused: BoolArray) -> Callable[[int], BoolArray] | None:
        """Take the readings of the next SYNCs (m, n); paused (n,): whether a long silence precedes each of them.

        Return a function of the channel: it returns for each of its readings (k,) whether the other channels rule out a wrap.
        """
        if not self.narrow:
            return None
        m, n = value.shape
        travel = np.zeros((m, n + 1))
        for c in range(m):
            rows = np.flatnonzero(there[c])
            if len(rows):
                first = self._before[c] if self._any[c] else float(value[c, rows[0]])
                steps = np.diff(value[c, rows].astype(np.float64), prepend=first)
                if full := self._values[c]:
                    steps = (steps + full / 2) % full - full / 2
                travel[c, rows + 1] = np.abs(steps)
                self._before[c], self._any[c] = float(value[c, rows[-1]]), True
        own = travel[:, 1:].copy()
        np.cumsum(travel, axis=1, out=travel)
        read = np.concatenate([np.zeros((m, 1)), np.cumsum(there, axis=1)], axis=1)
        syncs = np.concatenate([[0.0], np.cumsum(np.where(paused, UNSEEN, 1.0))])
        since = tuple(one.copy() for one in self._since)
        for c in range(m):
            rows = np.flatnonzero(there[c])
            ends = rows[-1] + 1 if len(rows) else 0
            for kept, table in zip(self._since[:2], (travel, read), strict=True):
                kept[c] = table[:, -1] - table[:, ends] + (0.0 if len(rows) else kept[c])
            self._since[2][c] = syncs[-1] - syncs[ends] + (0.0 if len(rows) else self._since[2][c])

        def calm(c: int) -> BoolArray:
            rows = np.flatnonzero(there[c])
            begin = np.concatenate([[0], rows[:-1] + 1])
            moved, seen = (table[:, rows + 1] - table[:, begin] for table in (travel, read))
            gone = syncs[rows + 1] - syncs[begin]
            moved[:, 0] += since[0][c]
            seen[:, 0] += since[1][c]
            gone[0] += since[2][c]
            others = np.isfinite(self._unit) & (np.arange(m) != c)
            mm = moved * self._unit[:, None]
            other_way = (self._values[c] - own[c, rows]) * self._unit[c]
            watched = others[:, None] & (seen >= WATCHED * gone)
            slow = np.where(watched, mm, 0.0).max(axis=0) <= QUARTER * other_way
            held = (watched.sum(axis=0) >= OTHERS) & (2 * watched.sum(axis=0) >= others.sum()) & slow
            rest = (own[c, rows] * self._unit[c] <= REST_MM) & (np.where(others[:, None], mm, 0.0).max(axis=0) <= REST_MM)
            return np.asarray(held | (rest & (others.sum() >= OTHERS)))

        return calm
