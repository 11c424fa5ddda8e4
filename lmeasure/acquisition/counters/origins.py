"""Judge whether a counter continues from the same origin: compare its counts with the motion before and behind a gap.

The speed v0 before the gap is the mean over a window w0. A body with an acceleration within A moves by v0 p +- A p (p + w0) / 2 in a pause
p. A is the rig's limit, else twice the largest acceleration of the channel so far. A step within that band cannot be detected: its width is
reported. A count outside the band is in doubt until the speed v1 behind the pause is known. So is a count that a device restarted at zero
could show too. A motion from speed v0 to v1 covers between v0 p and v1 p, +- A p^2 / 4.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from lmeasure.core import FloatArray, IntArray

GAP = 1.6
"""Periods without a reading, in a log or of a free timer: behind them the motion decides whether the origin is the same."""
PAUSE_PERIODS, PAUSE_S = 10.0, 0.25
"""The same for SYNCs of a live bus, in periods and seconds, and the pause of a bus that is reported. A busy host takes frames late, or
loses SYNCs, for that long while every encoder runs on. A log cannot be asked: there a single missing period is judged."""
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
