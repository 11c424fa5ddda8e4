"""Values between samples at uneven times: by the cubic through the four about an instant where the samples bear it, else straight."""

import itertools
from typing import NamedTuple

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray, IntArray


class Between(NamedTuple):
    """values (n,) at instants between samples, and missed (n,): about as much as they are off where they are read off a straight line."""

    values: FloatArray
    missed: FloatArray


def lagrange(time_s: FloatArray, at: FloatArray) -> FloatArray:
    """(m, 4) weights with which values at time_s (m, 4) make those of the cubics through them at (m,)."""
    out = np.ones_like(time_s)
    for i, j in itertools.permutations(range(4), 2):
        out[:, i] *= (at - time_s[:, j]) / (time_s[:, i] - time_s[:, j])
    return out


def between(
    time_s: FloatArray, values: FloatArray, good: BoolArray, left: IntArray, at_s: FloatArray, quantum: float, smooth: float
) -> Between:
    """Values (n,) at the instants at_s (n,), each between the sample left (n,) and the next, of samples (k,) rounded to a quantum. good
    (k - 1,): steps between samples that are neither a hole nor end in doubt.

    By the cubic where the steps about are good too, the samples bend alike on both sides - their second differences are no farther apart
    than their mean or than smooth, or something happened there that no cubic is to spread - and where four uneven samples do not scatter
    more together than one alone. Else straight; that misses by f (1 - f) / 2 of the second difference, f the part of the step.
    """
    k = len(time_s)
    step = np.diff(time_s)
    # twice the second divided difference at each sample, and by how much rounding alone may change it
    bend, rounding = np.full(k, np.nan), np.full(k, np.nan)
    inner = good[:-1] & good[1:]
    slope = np.diff(values) / step
    bend[1:-1][inner] = (2.0 * np.diff(slope) / (time_s[2:] - time_s[:-2]))[inner]
    rounding[1:-1][inner] = (2.0 * quantum / (step[:-1] * step[1:]))[inner]
    right, h = left + 1, step[left]
    f = (at_s - time_s[left]) / h
    out = (1.0 - f) * values[left] + f * values[right]
    sides = bend[[left, right]] * h**2
    least = rounding[[left, right]] * h**2
    size = np.maximum(np.abs(sides) - least, 0.0)
    with np.errstate(invalid="ignore"):
        alike = np.abs(sides[1] - sides[0]) <= np.maximum(smooth + least.sum(axis=0), np.abs(sides).mean(axis=0))
    rows = np.flatnonzero(alike)
    about = left[rows, None] + np.arange(-1, 3)
    weights = lagrange(time_s[about] - time_s[left[rows], None], (at_s - time_s[left])[rows])
    calm = (weights**2).sum(axis=1) <= 1.0
    rows, about, weights = rows[calm], about[calm], weights[calm]
    origin = values[left[rows]]
    out[rows] = origin + (weights * (values[about] - origin[:, None])).sum(axis=1)
    # where one side alone is known it stands for both; where none is, the most that the samples bend anywhere
    most = np.fmax.reduce(np.abs(bend) - rounding, initial=0.0) * h**2
    size = np.where(np.isnan(size), size[::-1], size).mean(axis=0)
    missed = np.where(np.isnan(size), most, size) * f * (1.0 - f) / 2.0
    missed[rows] = 0.0
    return Between(out, missed)
