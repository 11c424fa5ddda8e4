"""Where a run rests, and which of its rests are visits of one place, told by the counts alone.

A rest is a mean of lengths. Two rests are of one place when all cables but one agree: six lengths are a pose, and two poses that a robot is
sent to do not differ by the one twist that a single cable sees; a counter that lost counts does.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray

VISIT_LAG_S = 0.05
STILL_MM = 0.2  # by which no cable's length changes within VISIT_LAG_S while the robot rests
LEAST_S = 0.15
SETTLED = 0.5  # of a rest: its last part is taken, up to VISIT_LAG_S before its end
LONGEST_S = 60.0  # of a rest that is longer, what is more than two of these before its end is let go
NEAR_MM = 0.5  # by which cables agree at two visits of one place
LEAST_CABLES = 4  # of which one may disagree


@dataclass(frozen=True)
class Rests:
    """N rests in order of time: begin_s, end_s (N,), length_mm (N, m) mean changes of the cables' lengths, from the counts alone."""

    begin_s: FloatArray
    end_s: FloatArray
    length_mm: FloatArray

    def __len__(self) -> int:
        return len(self.begin_s)

    def places(self) -> IntArray:
        """(N,) the number of the place that each rest is a visit of, from 0 in order of their first visits.

        A rest is held against the last visit of every place, for robots drift and counters slip more than once.
        """
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
        self._begun_s: float | None = None  # when the rest began that goes on from the pieces before
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
    """From when on a rest is looked at: the same whatever the pieces in which it comes."""
    return begin + max(np.floor((end - begin) / LONGEST_S) - 1.0, 0.0) * LONGEST_S
