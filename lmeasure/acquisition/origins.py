"""Whether a counter goes on from the same origin: its counts compared with the motion before and behind a gap.

The speed v0 before is taken over a window w0. A body whose acceleration stays within A moves, in a pause p, by v0 p +- A p (p + w0) / 2. A
is the rig's limit, else twice the largest acceleration that the channel has shown so far. A step within that band would not be seen: its
width is stated. A count outside the band, or one that a device started anew at zero could show as well, is in doubt until the speed v1
behind the pause is known too. A motion whose speed changes from v0 to v1 covers between v0 p and v1 p, +- A p^2 / 4.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from lmeasure.arrays import FloatArray, IntArray

WINDOW_S = 0.02
"""Over which speeds and accelerations are taken."""
READINGS = 3
"""Intervals at least that give a speed, where there are so many."""
LONGEST_WINDOW = 32
"""Intervals at most."""
MARGIN = 2.0
"""Times the acceleration of the motion: what its hardest stop has more."""
ROUNDING = 1.0
"""Units by which two whole counts may miss the way between them."""


@dataclass(frozen=True)
class Speed:
    """A speed [units/s], the window [s] over which it was taken, and by how much the stamps in it are off their usual interval [s]."""

    rate: float
    window_s: float
    off_s: float = 0.0

    def error(self, pause_s: float) -> float:
        """By how many units the way in a pause may be off because counts are whole and stamps are late."""
        return (ROUNDING + 2.0 * abs(self.rate) * self.off_s) * (1.0 + pause_s / self.window_s)


@dataclass(frozen=True)
class Pause:
    """From the last reading before, with its total and speed, to the next one: least_s as readings are numbered, most_s by their stamps,
    which may be late."""

    total: int
    speed: Speed | None
    least_s: float
    most_s: float


@dataclass
class Line:
    """The last readings of a counter and the largest acceleration so far. slack: units by which a count may be off though nothing
    happened; limits: rate [units/s] and acceleration [units/s^2], as the rig states them."""

    slack: float
    max_rate: float
    stated: float | None = None
    times: FloatArray = field(default_factory=lambda: np.empty(0))
    totals: IntArray = field(default_factory=lambda: np.empty(0, np.int64))
    whole: int = 0
    """How many of them have no gap between them."""
    hardest: float = np.inf
    """Largest acceleration that the channel has shown [units/s^2]; infinite before there is one."""

    def learn(self, times: FloatArray, totals: IntArray, usual_s: float, *, behind_gap: bool = False) -> None:
        """Take (n,) readings without a gap between them; behind_gap: one is before them."""
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
        """The speed at the last reading; None where there is one reading only."""
        n = len(self.times)
        if n < 2:
            return None
        far = int(np.searchsorted(-(self.times[::-1] - self.times[-1]), WINDOW_S - 1e-9))
        return speed_of(self.times[-1 - min(max(far, READINGS), n - 1) :], self.totals[-1 - min(max(far, READINGS), n - 1) :], usual_s)

    def band(self, pause: Pause, pause_s: float, least: float = 0.0) -> tuple[float, float]:
        """Least and largest total that the motion before can have led to, if it lasted pause_s, by an acceleration of `least` or more."""
        speed, fastest = pause.speed, self.max_rate * pause_s + ROUNDING
        if speed is None:
            return pause.total - fastest, pause.total + fastest
        way = speed.rate * pause_s
        by = self.slack + speed.error(pause_s) + max(self._acceleration(), least) * pause_s * (pause_s + speed.window_s) / 2.0
        by = min(by, fastest + abs(way))
        return pause.total + way - by, pause.total + way + by

    def band_between(self, pause: Pause, behind: Speed) -> tuple[float, float]:
        """The same where the speed behind the pause is known too."""
        before, p = pause.speed or behind, pause.most_s
        ends = [s.rate * t for s in (before, behind) for t in (pause.least_s, p)]
        by = self.slack + before.error(p) + behind.error(p)
        by += self._acceleration() * p * (p / 4.0 + max(before.window_s, behind.window_s) / 2.0)
        by = min(by, self.max_rate * p + ROUNDING + abs(before.rate) * p)
        return pause.total + min(ends) - by, pause.total + max(ends) + by

    def _acceleration(self) -> float:
        return self.stated if self.stated is not None else MARGIN * self.hardest


def speed_of(times: FloatArray, totals: IntArray, usual_s: float) -> Speed:
    """The speed from the first to the last of (n,) readings, two at least."""
    steps = np.diff(times)
    off = float(np.abs(steps - np.maximum(np.rint(steps / usual_s), 1.0) * usual_s).max()) if usual_s > 0.0 else 0.0
    window = max(float(times[-1] - times[0]), len(steps) * usual_s, 1e-9)
    return Speed(float(totals[-1] - totals[0]) / window, window, off)


@dataclass
class Doubt:
    """An origin in doubt: the pause, what its readings behind are so far, and whether the device may have started anew at zero."""

    pause: Pause
    restart: bool
    times: list[float] = field(default_factory=list)
    totals: list[int] = field(default_factory=list)

    def go_on(self, time_s: float, least_s: float) -> None:
        """Take a further gap behind the readings so far, the next one being at time_s: the pause lasts until then."""
        gone = self.times[-1] - self.times[0]
        more = (gone + least_s, gone + max(time_s - self.times[-1], least_s))
        self.pause = replace(self.pause, least_s=self.pause.least_s + more[0], most_s=self.pause.most_s + more[1])
        self.times, self.totals = [], []

    def known(self) -> bool:
        """Whether the readings behind give a speed."""
        return len(self.times) > READINGS and self.times[-1] - self.times[0] >= WINDOW_S - 1e-9
