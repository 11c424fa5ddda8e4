"""What lies between the samples of a path: where it passes a plane, and where it is nearest to or farthest from something."""

import numpy as np
from scipy.interpolate import Akima1DInterpolator, CubicSpline

from lmeasure.core import BoolArray, FloatArray, lagrange

HALVINGS = 40
"""Of a step between samples, until a passage is found in it: to 1e-12 of it."""
MOST_UNEVEN = 2.0
"""Times as long as the shortest of three steps the longest may be: cubics through samples at uneven times swing."""
FINER = 16
"""Pieces of a step in which the nearest or farthest place is looked for."""


def passage(time_s: FloatArray, ahead: FloatArray, part: FloatArray, smooth: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Times (m,) at which something passes zero upwards between the second and the third of four samples ahead (m, 4) at time_s (m, 4), and
    the samples' weights (m, 4) there.

    By the cubic through the four where they are smooth (m,), even in time and on both sides of zero; else straight between the two, at
    part (m,) of the step.
    """
    time = time_s - time_s[:, 1:2]
    steps = np.diff(time, axis=1)
    cubic = smooth & (ahead[:, 1] < 0.0) & (ahead[:, 2] >= 0.0) & (steps.max(axis=1) <= MOST_UNEVEN * steps.min(axis=1))
    at = part * time[:, 2]
    weights = np.stack([np.zeros_like(part), 1.0 - part, part, np.zeros_like(part)], axis=1)
    at[cubic] = _zero(time[cubic], ahead[cubic])
    weights[cubic] = lagrange(time[cubic], at[cubic])
    return time_s[:, 1] + at, weights


def _zero(time_s: FloatArray, ahead: FloatArray) -> FloatArray:
    """(m,) where the cubics through (m, 4) pass zero between the second and the third, by bisection on their divided differences."""
    differences = ahead.T.copy()
    for k in range(1, 4):
        differences[k:] = (differences[k:] - differences[k - 1 : -1]) / (time_s[:, k:] - time_s[:, : 4 - k]).T
    start, end = time_s[:, 1], time_s[:, 2]
    for _ in range(HALVINGS):
        middle = 0.5 * (start + end)
        value = differences[3]
        for k in (2, 1, 0):
            value = differences[k] + (middle - time_s[:, k]) * value
        behind = value < 0.0
        start, end = np.where(behind, middle, start), np.where(behind, end, middle)
    return np.asarray(0.5 * (start + end))


def share(part: FloatArray) -> FloatArray:
    """(m,) of the variance of a sample what is read from the four about it has, at part (m,) of the even step between the middle ones."""
    steps = np.tile(np.arange(-1.0, 3.0), (len(part), 1))
    return np.asarray((lagrange(steps, part) ** 2).sum(axis=1))


def finer(values: FloatArray, *, kinks: bool) -> FloatArray:
    """(..., FINER (k - 1) + 1, c) what values (..., k, c) at even steps are between them: by the cubic spline, or where there may be kinks
    by cubics that hardly swing there (modified Akima)."""
    steps = np.arange(values.shape[-2])
    curve = Akima1DInterpolator(steps, values, axis=-2, method="makima") if kinks else CubicSpline(steps, values, axis=-2)
    return np.asarray(curve(np.arange(FINER * steps[-1] + 1) / FINER))
