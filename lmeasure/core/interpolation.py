"""Values between samples at uneven times: by the cubic through the four about an instant where the samples bear it, else straight."""

import itertools

import numpy as np

from lmeasure.core.arrays import BoolArray, FloatArray


def lagrange(time_s: FloatArray, at: FloatArray) -> FloatArray:
    """(m, 4) weights with which values at time_s (m, 4) make those of the cubics through them at (m,)."""
    times = np.ascontiguousarray(time_s.T)
    out = np.ones_like(times)
    for i, j in itertools.permutations(range(4), 2):
        out[i] *= (at - times[j]) / (times[i] - times[j])
    return out.T


class OtherTimes:
    """Position of instants at_s (n,) among samples taken at time_s (k,). hole: median sample intervals from which an interval is a hole.

    outside, in_hole (n,): instants beyond the samples, or in a hole between two.
    """

    def __init__(self, time_s: FloatArray, at_s: FloatArray, hole: float) -> None:
        k = len(time_s)
        right = np.clip(np.searchsorted(time_s, at_s), 1, max(k - 1, 1))
        self._left = right - 1
        self._right = right = np.minimum(right, k - 1)
        self.outside = (at_s < time_s[0]) | (at_s > time_s[-1])
        step = np.diff(time_s)
        f = (at_s - time_s[self._left]) / np.where(right > self._left, time_s[right] - time_s[self._left], 1.0)
        # on a sample only that sample counts: its neighbour may be a gap
        self._at_left, self._at_right = f == 0.0, f == 1.0
        self._whole = step <= hole * np.median(step) if k > 1 else np.zeros(0, np.bool_)
        inside = np.flatnonzero(~self.outside & ~self._at_left & ~self._at_right)
        self.in_hole = np.zeros(len(at_s), np.bool_)
        self.in_hole[inside] = ~self._whole[self._left[inside]]
        # readings between two samples; the cubic ones have two more around them and weights (4, c)
        self._inside = inside = inside[~self.in_hole[inside]]
        self._step, self._f, self._h = step, f[inside], step[self._left[inside]]
        about = np.flatnonzero((self._left[inside] > 0) & (right[inside] < k - 1))
        first = self._left[inside[about]] - 1
        times = np.stack([time_s[first + i] for i in range(4)]) - time_s[first + 1]
        weights = lagrange(times.T, self._f[about] * self._h[about]).T
        # uneven samples may scatter more together than one alone
        calm = (weights**2).sum(axis=0) <= 1.0
        self._cubic, self._weights = about[calm], weights[:, calm]

    def either(self, mask: BoolArray) -> BoolArray:
        """Return (n,) whether either sample of an instant's value is in a mask (k,)."""
        return np.asarray((mask[self._left] & ~self._at_right | mask[self._right] & ~self._at_left) & ~self.outside)

    def read(self, values: FloatArray, good: BoolArray, quantum: float, smooth: float) -> tuple[FloatArray, FloatArray]:
        """(n,) each: values at the instants, NaN outside and in holes, and by about how much they are off, of samples (k,) that are
        rounded to a quantum; good (k,): those that are not in doubt.

        By the cubic where all four samples about are good and bend alike on both sides: their second differences are no farther apart
        than their mean or than smooth, or something happened there that no cubic is to spread. Else straight: that misses by f (1 - f) / 2
        of the second difference, f the part of the interval.
        """
        out = np.where(self._at_left, values[self._left], values[self._right])
        out[self.outside | self.in_hole] = np.nan
        missed, inside, f, step = np.zeros_like(out), self._inside, self._f, self._step
        if not len(inside):
            return out, missed
        left, h2 = self._left[inside], self._h**2
        ok = good[1:] & good[:-1] & self._whole
        # twice the second divided difference at each sample, and by how much rounding alone may change it
        bend, rounding = np.full(len(values), np.nan), np.full(len(values), np.nan)
        slope = np.diff(values) / step
        bend[1:-1] = np.where(ok[:-1] & ok[1:], 2.0 * np.diff(slope) / (step[:-1] + step[1:]), np.nan)
        rounding[1:-1] = 2.0 * quantum / (step[:-1] * step[1:])
        before, behind = bend[left] * h2, bend[left + 1] * h2
        straight = values[left] + f * (values[left + 1] - values[left])
        c = self._cubic
        apart, mean = np.abs(before[c] - behind[c]), (np.abs(before[c]) + np.abs(behind[c])) / 2.0
        least = (rounding[left[c]] + rounding[left[c] + 1]) * h2[c]
        with np.errstate(invalid="ignore"):
            alike = apart <= np.maximum(smooth + least, mean)
        c, weights = c[alike], self._weights[:, alike]
        origin = values[left[c]]
        straight[c] = origin + sum(weights[i] * (values[left[c] + i - 1] - origin) for i in (0, 2, 3))
        out[inside] = straight
        rest = np.delete(np.arange(len(inside)), c)
        sizes = np.maximum(np.abs(bend) - rounding, 0.0)
        sides = np.stack([sizes[left[rest]], sizes[left[rest] + 1]])
        # if one side is known it counts for both; if none is, the largest curvature of all samples
        sides = np.where(np.isnan(sides), sides[::-1], sides)
        size = np.where(np.isnan(sides[0]), np.fmax.reduce(sizes, initial=0.0), sides.mean(axis=0))
        missed[inside[rest]] = size * h2[rest] * f[rest] * (1.0 - f[rest]) / 2.0
        return out, missed
