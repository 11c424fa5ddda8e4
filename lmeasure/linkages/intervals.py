"""Interval arithmetic on arrays (..., 2) of lower and upper bounds: every result is widened to the next numbers, so that it holds.

As much as proofs about tetrahedra need (Moore, Kearfott, Cloud, Introduction to Interval Analysis, 2009).
"""

import numpy as np

from lmeasure.core import FloatArray


def _widened(low: FloatArray, high: FloatArray) -> FloatArray:
    return np.stack([np.nextafter(low, -np.inf), np.nextafter(high, np.inf)], axis=-1)


def add(a: FloatArray, b: FloatArray) -> FloatArray:
    """a + b."""
    return _widened(a[..., 0] + b[..., 0], a[..., 1] + b[..., 1])


def sub(a: FloatArray, b: FloatArray) -> FloatArray:
    """a - b."""
    return _widened(a[..., 0] - b[..., 1], a[..., 1] - b[..., 0])


def mul(a: FloatArray, b: FloatArray) -> FloatArray:
    """a * b."""
    ends = np.stack([a[..., i] * b[..., j] for i in (0, 1) for j in (0, 1)])
    return _widened(ends.min(axis=0), ends.max(axis=0))


def div(a: FloatArray, b: FloatArray) -> FloatArray:
    """a / b of b > 0."""
    ends = np.stack([a[..., i] / b[..., j] for i in (0, 1) for j in (0, 1)])
    return _widened(ends.min(axis=0), ends.max(axis=0))


def square(a: FloatArray) -> FloatArray:
    """a * a, which is not negative."""
    ends = a * a
    low = np.where((a[..., 0] <= 0.0) & (a[..., 1] >= 0.0), 0.0, ends.min(axis=-1))
    out = _widened(low, ends.max(axis=-1))
    return np.maximum(out, 0.0)


def root(a: FloatArray) -> FloatArray:
    """Return the square root of the part of a that is not negative; NaN without one."""
    with np.errstate(invalid="ignore"):
        low, high = np.sqrt(np.maximum(a[..., 0], 0.0)), np.sqrt(a[..., 1])
    out = _widened(low, high)
    return np.stack([np.maximum(out[..., 0], 0.0), out[..., 1]], axis=-1)


def sign(a: FloatArray) -> FloatArray:
    """1 or -1 where a has one sign, else 0."""
    return np.where(a[..., 0] > 0.0, 1.0, np.where(a[..., 1] < 0.0, -1.0, 0.0))
