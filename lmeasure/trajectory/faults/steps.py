"""Steps of single channels between samples (`trajectory.faults.continuity` says by what they are told): where one may be, and how large."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray

STEP_MM = 0.2
"""A smaller step may be a cable's that sticks and slips."""
BINS = np.concatenate([[0.0], np.geomspace(1.0, 1e9, 181)])
"""Accelerations [mm/s^2] up to which they are counted."""
JITTERED = 4.0
"""Times the way that a cable goes while stamps are off: both speeds, and the interval itself."""
AROUND = 6
"""Samples either way over which a speed is taken that stale counts do not hide."""
EVEN = 0.02
"""Of an interval by which stamps of rows that are not there may differ from whole intervals."""
HOLE = 2.5  # usual intervals: a longer one is a gap
SMALLEST_COUNTS = 2.0  # by which rounding alone may miss the interval


@dataclass(frozen=True)
class Break:
    """Where a channel went on elsewhere: after the sample at before_s, at the latest by the one at after_s, by about by_mm of cable within
    u_mm; by_mm is NaN where it did not step but stopped or ran off. length_mm and speed_mm_s: its length and speed before and after."""

    cable: int
    before_s: float
    after_s: float
    by_mm: float
    u_mm: float
    length_mm: tuple[float, float] = (np.nan, np.nan)
    speed_mm_s: tuple[float, float] = (np.nan, np.nan)


@dataclass(frozen=True)
class Candidates:
    """Intervals in which something may have happened: before_s, after_s (k,); by (k, m) steps [mm], or accelerations [mm/s^2]; allowed_mm
    (k, m) what steps may be without any acceleration; geometry_s2 (k,) what an acceleration adds to that; going_mm_s (k, m) speeds over a
    few samples either way, without the interval; length_mm, speed_mm_s (2, k, m) of the cables before and after."""

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
    # between samples of one order both continuations err alike by half of this at most, whatever the stamps say
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
    """What two estimates of a step agree on: the smaller of the same sign, else nothing; nothing where one is NaN."""
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
