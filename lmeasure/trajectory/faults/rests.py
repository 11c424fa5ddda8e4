"""Rests of a run, visits of one position among them, and late channels on a path forth and back.

A rest is a mean of lengths. Two rests are of one position if all cables but one agree: six lengths are a pose, and two commanded poses do
not differ by the one twist that changes a single cable; a counter that lost counts does.

The counts of a channel that is late by tau_j show l_j - v_j tau_j, with v_j the speed of the cable. Where the robot passes a position in
both directions, the lengths of the two passages differ by

    l(t2) - l(t1) = s u - (v(t2) - v(t1)) tau + e,

with s the distance of the two along the mean direction u of the path, and e the robot's deviation. s is eliminated, and tau follows by
least squares over all such pairs, except for the common delay of all channels. Play and friction of a single drum look alike.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray

VISIT_LAG_S = 0.05
STILL_MM = 0.2  # largest change of a cable's length within VISIT_LAG_S while the robot rests
LEAST_S = 0.15
SETTLED = 0.5  # of a rest: its last part is taken, up to VISIT_LAG_S before its end
LONGEST_S = 60.0  # of a longer rest, samples more than two of these before its end are dropped
NEAR_MM = 0.5  # largest difference of a cable between two visits of one position
LEAST_CABLES = 4  # one of them may disagree
SPACING_MM = 2.0  # Way between samples that are compared, of the cable that moves most
MOST = 10_000  # Samples that are compared; of a longer run the spacing is doubled
SLOW_MM_S = 20.0  # Below this speed of the fastest cable nothing shows
PAUSE_S = 0.5  # Longest time between two samples of one movement
WITHIN_MM = 15.0  # Distance of the lengths of two passages: up to twice the way that a late channel is behind
NEIGHBOURS = 16
BY_HAND = 1500  # Samples whose neighbours are found sooner without SciPy, which takes 0.2 s to load
OPPOSITE = -0.95
LEAST_PAIRS = 10
LOOSE = 3.0  # Factor on the lower quartile of the deviations: pairs beyond it are of two neighbouring paths
APART_MM = 0.3  # Deviation of a pair that is used in any case


@dataclass(frozen=True)
class Rests:
    """N rests in order of time: begin_s, end_s (N,), length_mm (N, m) mean changes of the cables' lengths, from the counts alone."""

    begin_s: FloatArray
    end_s: FloatArray
    length_mm: FloatArray

    def __len__(self) -> int:
        return len(self.begin_s)

    def places(self) -> IntArray:
        """Return (N,) the index of each rest's position, from 0 in order of first visits. A rest is compared with the last visit of every
        position, since robots drift and counters slip more than once."""
        n, m = self.length_mm.shape
        last = np.empty((n, m))
        out = np.empty(n, np.int64)
        known = 0
        for i, here in enumerate(self.length_mm):
            apart = np.sort(np.abs(last[:known] - here), axis=1)
            far = apart[:, -2] if m >= LEAST_CABLES else apart[:, -1]
            nearest = int(np.argmin(far)) if known else -1
            if nearest < 0 or not far[nearest] <= NEAR_MM:
                nearest, known = known, known + 1
            out[i], last[nearest] = nearest, here
        return out


class RestFinder:
    """Finds rests in a run that is given in pieces."""

    def __init__(self) -> None:
        self._time_s: FloatArray | None = None
        self._length_mm = np.empty((0, 0))
        self._begun_s: float | None = None  # begin of a rest that continues from earlier pieces
        self._found: list[tuple[float, float, FloatArray]] = []

    def add(self, time_s: FloatArray, length_mm: FloatArray) -> None:
        """The next samples: times (n,) and changes of length (n, m), NaN where they are not known."""
        if self._time_s is not None:
            time_s, length_mm = np.concatenate([self._time_s, time_s]), np.concatenate([self._length_mm, length_mm])
        kept = self._look(time_s, length_mm, last=False)
        self._time_s, self._length_mm = time_s[kept:].copy(), length_mm[kept:].copy()

    def rests(self) -> Rests:
        """All of them, the run having ended."""
        if self._time_s is not None:
            self._look(self._time_s, self._length_mm, last=True)
            self._time_s = None
        if not self._found:
            return Rests(np.empty(0), np.empty(0), np.empty((0, self._length_mm.shape[1])))
        begin, end, lengths = zip(*self._found, strict=True)
        return Rests(np.array(begin), np.array(end), np.array(lengths))

    def _look(self, time_s: FloatArray, length_mm: FloatArray, *, last: bool) -> int:
        """Keep the rests that have ended, all of them at last; the sample from which the others must be looked at again."""
        n = len(time_s)
        ahead = np.searchsorted(time_s, time_s + VISIT_LAG_S)
        judged = n if last else int(np.searchsorted(ahead, n))
        ahead = np.minimum(ahead[:judged], n - 1)
        with np.errstate(invalid="ignore"):
            still = (np.abs(length_mm[ahead] - length_mm[:judged]) <= STILL_MM).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        begun, self._begun_s = self._begun_s, None
        for first, stop in edges.reshape(-1, 2):
            begin = float(time_s[first]) if first or begun is None else begun
            if stop == judged and not last:
                self._begun_s = begin
                return int(np.searchsorted(time_s, _kept_from(begin, float(time_s[-1]))))
            self._keep(begin, time_s[first : ahead[stop - 1] + 1], length_mm[first : ahead[stop - 1] + 1])
        return judged

    def _keep(self, begin: float, time_s: FloatArray, length_mm: FloatArray) -> None:
        end = float(time_s[-1])
        if end - begin < LEAST_S:
            return
        first = max(_kept_from(begin, end), float(time_s[0]))
        settled = (time_s >= first + (1.0 - SETTLED) * (end - first)) & (time_s <= end - VISIT_LAG_S)
        middle = length_mm[settled]
        middle = middle[~np.isnan(middle).any(axis=1)]
        if len(middle):
            self._found.append((begin, end, middle.mean(axis=0)))


def _kept_from(begin: float, end: float) -> float:
    """Return the time from which a rest is used: the same for any pieces in which it comes."""
    return begin + max(np.floor((end - begin) / LONGEST_S) - 1.0, 0.0) * LONGEST_S


@dataclass(frozen=True)
class Reversals:
    """Lateness late_s (m,) of each channel against the others' median, and the mean change of each cable's speed at a reversal (m,)."""

    late_s: FloatArray
    speed_mm_s: FloatArray

    @property
    def effect_mm(self) -> FloatArray:
        """Return (m,) by how much the two passages of a position differ by each channel's lateness."""
        return np.asarray(np.abs(self.late_s) * self.speed_mm_s)


class ReversalFinder:
    """Collects samples of the movements of a run that comes in pieces."""

    def __init__(self) -> None:
        self._spacing_mm = SPACING_MM
        self._way_mm, self._last = 0.0, np.empty(0)
        self._kept: list[FloatArray] = []
        self._count = 0

    def add(self, time_s: FloatArray, length_mm: FloatArray) -> None:
        """Take the next samples: times (n,) and changes of length (n, m), NaN where they are not known."""
        known = np.isfinite(length_mm.sum(axis=1) + time_s)
        if not known.all():
            time_s, length_mm = time_s[known], length_mm[known]
        if not len(time_s):
            return
        before = length_mm[0] if not len(self._last) else self._last
        steps = np.zeros(len(time_s))
        for column, first in zip(length_mm.T, before, strict=True):
            np.maximum(steps, np.abs(np.diff(column, prepend=first)), out=steps)
        way = self._way_mm + np.cumsum(steps)
        number = np.floor(np.concatenate([[self._way_mm], way]) / self._spacing_mm)
        taken = np.flatnonzero(np.diff(number))
        self._kept.append(np.column_stack([time_s[taken], length_mm[taken]]))
        self._count += len(taken)
        self._way_mm, self._last = float(way[-1]), length_mm[-1].copy()
        if self._count > MOST:
            self._kept = [np.concatenate(self._kept)[::2]]
            self._count, self._spacing_mm = len(self._kept[0]), 2.0 * self._spacing_mm

    def found(self) -> Reversals | None:
        """Return the lateness of the channels; None where no path was followed in both directions."""
        if self._count < LEAST_PAIRS:
            return None
        rows = np.concatenate(self._kept)
        time_s, lengths = rows[:, 0], rows[:, 1:]
        moving, speeds = _speeds(time_s, lengths)
        first, second = _pairs(time_s[moving], lengths[moving], speeds)
        if len(first) < LEAST_PAIRS:
            return None
        return _lateness(lengths[moving][second] - lengths[moving][first], speeds[first], speeds[second])


def _speeds(time_s: FloatArray, lengths: FloatArray) -> tuple[IntArray, FloatArray]:
    """(k,) samples in movement, and their speeds (k, m) between the neighbours."""
    span = time_s[2:] - time_s[:-2]
    speeds = (lengths[2:] - lengths[:-2]) / np.maximum(span, 1e-9)[:, None]
    moving = (span < PAUSE_S) & (np.abs(speeds).max(axis=1) > SLOW_MM_S)
    return np.flatnonzero(moving) + 1, speeds[moving]


def _pairs(time_s: FloatArray, lengths: FloatArray, speeds: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs of samples at which the robot passes nearly one position in opposite directions, each sample with the nearest of later ones."""
    none = np.empty(0, np.int64)
    if len(lengths) <= NEIGHBOURS:
        return none, none
    unit = speeds / np.linalg.norm(speeds, axis=1)[:, None]
    away, other = _nearest(lengths)
    fits = (away < WITHIN_MM) & (other > np.arange(len(lengths))[:, None]) & (time_s[other] - time_s[:, None] > PAUSE_S)
    fits &= np.einsum("nm,nkm->nk", unit, unit[other]) < OPPOSITE
    first = np.flatnonzero(fits.any(axis=1))
    return first, other[first, np.argmax(fits[first], axis=1)].astype(np.int64)


def _nearest(rows: FloatArray) -> tuple[FloatArray, IntArray]:
    """Distances and numbers (n, NEIGHBOURS) of the rows that are nearest to each of (n, m) rows, nearest first."""
    if len(rows) > BY_HAND:
        away, other = scipy.spatial.cKDTree(rows).query(rows, NEIGHBOURS, distance_upper_bound=WITHIN_MM)
        return away, np.where(np.isfinite(away), other, 0)
    square = (rows**2).sum(axis=1)
    near = np.argpartition(square - 2.0 * rows @ rows.T, NEIGHBOURS - 1, axis=1)[:, :NEIGHBOURS]
    away = np.linalg.norm(rows[near] - rows[:, None], axis=2)
    order = np.argsort(away, axis=1)
    return np.take_along_axis(away, order, axis=1), np.take_along_axis(near, order, axis=1)


def _lateness(apart: FloatArray, before: FloatArray, after: FloatArray) -> Reversals | None:
    """The lateness by differences (n, m) of the lengths of pairs and speeds (n, m) at both."""
    along = before - after
    along /= np.linalg.norm(along, axis=1)[:, None]
    beside = apart - (apart * along).sum(axis=1, keepdims=True) * along
    deviation = np.linalg.norm(beside, axis=1)
    used = deviation <= max(APART_MM, LOOSE * float(np.quantile(deviation, 0.25)))
    if used.sum() < LEAST_PAIRS:
        return None
    change, along, beside = (after - before)[used], along[used], beside[used]
    m = change.shape[1]
    rows = change[:, :, None] * np.eye(m) - along[:, :, None] * (along * change)[:, None, :]
    late = -np.linalg.lstsq(rows.reshape(-1, m), beside.reshape(-1), rcond=1e-6)[0]
    return Reversals(late - np.median(late), np.sqrt(np.mean(change**2, axis=0)))
