"""Proof that near a computed assembly there is exactly one: Krawczyk's test in Study coordinates, complex, with every rounding bounded.

A point x with one coordinate held at 1 and a box of radii r around it: if |Y F(x)| + |I - Y J| r < r for the derivatives J anywhere in the
box and some matrix Y, the map x - Y F(x) takes the box into itself and contracts it, and the box has one solution (Krawczyk 1969; Rump,
Verification methods, 2010, 13.3). The equations are quadrics, so that J varies by a known amount. What is computed in floating point is
enlarged by bounds of its rounding (Higham, Accuracy and Stability, 3.1), as wide as all sums here need by far.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import BoolArray, ComplexArray, FloatArray
from lmeasure.lcoordinate import study

ROUNDING = 5e-15
"""Bound of the relative rounding of a sum of eight sums of eight complex products, 45 units; they have 16 additions and two products at
most one behind the other, of 3 units each."""
WIDEN = 3.0  # a box is this much wider than the distance that Newton's method still goes
REFINED = 6  # steps of Newton's method before the test


@dataclass(frozen=True)
class Proved:
    """Points (n, 8), one coordinate of each 1, with what is proved of them."""

    points: ComplexArray
    radius: FloatArray
    """(n,) of the box in every coordinate."""
    certain: BoolArray
    """(n,) that the box holds one assembly, and a proper one (e.e is not 0)."""
    real: BoolArray
    """(n,) that this assembly is real; false where it is proved not to be, or not known."""


def proved(rows: ComplexArray, points: ComplexArray) -> Proved:
    """What is true of points (n, 8) near assemblies of links with real dimensions (6, 7).

    The rows need only be what `study.links` makes of coordinates that were moved and scaled: each of these operations is exact up to a
    rounding of its result.
    """
    Q, slack = study.quadrics(rows), ROUNDING * _magnitudes(rows)
    held = np.abs(points).argmax(axis=1)
    x = points / np.take_along_axis(points, held[:, None], axis=1)
    for _ in range(REFINED):
        x = _stepped(Q, x, held)
    radius, certain = _box(Q, slack, x, held)
    # a real assembly's box holds its conjugate too, and there is but one
    near = certain & (np.abs(x.imag).max(axis=1) <= radius)
    x[near] = _stepped(Q, x[near].real.astype(np.complex128), held[near]).real
    radius[near], certain[near] = _box(Q, slack, x[near], held[near])
    return Proved(x, radius, certain, near & certain)


def apart(found: Proved) -> BoolArray:
    """(n,) which of the certain assemblies are certainly none of those before: a minor of the two points cannot vanish."""
    n = len(found.points)
    new = found.certain.copy()
    size = np.abs(found.points).max(axis=1)
    for i in range(n):
        for j in np.flatnonzero(new[:i]):
            minors = np.outer(found.points[i], found.points[j])
            r = found.radius[i] * (size[j] + found.radius[j]) + found.radius[j] * (size[i] + found.radius[i])
            if np.abs(minors - minors.T).max() <= 2.0 * r + ROUNDING:
                new[i] = False
                break
    return new


def _stepped(Q: ComplexArray, x: ComplexArray, held: np.ndarray) -> ComplexArray:
    """x after a step of Newton's method; where there is none, x."""
    F, J = _at(Q, x)
    J, F = _square(J, F, held)
    step = np.einsum("nij,nj->ni", _inverses(J), F)
    return np.where(np.isfinite(step).all(axis=1, keepdims=True), x - step, x)


def _at(Q: ComplexArray, x: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Equations (n, 7) and their derivatives (n, 7, 8)."""
    Qx = np.einsum("kij,nj->nki", Q, x)
    return np.einsum("nki,ni->nk", Qx, x), 2.0 * Qx


def _square(J: ComplexArray, F: ComplexArray, held: np.ndarray) -> tuple[ComplexArray, ComplexArray]:
    """With an eighth equation, that the held coordinate stays."""
    fixed = np.zeros((len(J), 1, 8))
    fixed[np.arange(len(J)), 0, held] = 1.0
    return np.concatenate([J, fixed], axis=1), np.concatenate([F, np.zeros((len(F), 1))], axis=1)


def _inverses(J: ComplexArray) -> ComplexArray:
    """(n, 8, 8) inverses, NaN where there is none."""
    out = np.full(J.shape, np.nan, dtype=np.complex128)
    regular = np.linalg.cond(J) < 1.0 / np.finfo(float).eps if len(J) else np.zeros(0, bool)
    out[regular] = np.linalg.inv(J[regular])
    return out


def _box(Q: ComplexArray, slack: FloatArray, x: ComplexArray, held: np.ndarray) -> tuple[FloatArray, BoolArray]:
    """Radii (n,) of boxes around x, and for which the test proves one proper assembly."""
    F, J = _at(Q, x)
    J, F = _square(J, F, held)
    Y = _inverses(J)
    with np.errstate(invalid="ignore"):
        size, weight = np.abs(x), np.abs(Y)
        # |F| at most: what is computed, its rounding, and what the dimensions may be off
        off = np.einsum("kij,ni,nj->nk", ROUNDING * np.abs(Q) + slack, size, size)
        f = np.abs(F) + np.concatenate([off, np.zeros((len(x), 1))], axis=1)
        reach = np.einsum("nij,nj->ni", weight, f)
        radius = WIDEN * reach.max(axis=1) + 1e-15
        # |J| off at most: by the dimensions, by the rounding, and over the box
        most = np.abs(Q) + slack
        wide = 2.0 * np.einsum("kij,nj->nki", ROUNDING * np.abs(Q) + slack, size) + 2.0 * radius[:, None, None] * most.sum(axis=-1)
        wide = np.concatenate([wide, np.zeros((len(x), 1, 8))], axis=1)
        A = np.abs(np.eye(8) - Y @ J) + ROUNDING * (weight @ np.abs(J)) + weight @ wide
        inside = (reach + A.sum(axis=2) * radius[:, None]) * (1.0 + ROUNDING) < radius[:, None]
        ee = np.abs((x[:, :4] ** 2).sum(axis=1))
        proper = ee > 2.0 * radius * size[:, :4].sum(axis=1) + 4.0 * radius**2 + ROUNDING * (size[:, :4] ** 2).sum(axis=1)
    return radius, inside.all(axis=1) & proper


def _magnitudes(rows: ComplexArray) -> FloatArray:
    """(7, 8, 8) the quadrics with every term taken by its size: what their entries' rounding is a part of."""
    a, b = np.abs(rows[:, :3]).max(axis=1), np.abs(rows[:, 3:6]).max(axis=1)
    out = np.zeros((7, 8, 8))
    # c is a sum of three squares of which the length's may be as large as both others with it
    of_c = np.abs(rows[:, 6]) + 6.0 * (a**2 + b**2)
    out[:6, :4, :4] = of_c[:, None, None] * np.eye(4) + 6.0 * (a * b)[:, None, None]
    out[:6, :4, 4:] = out[:6, 4:, :4] = 2.0 * (a + b)[:, None, None]
    return out
