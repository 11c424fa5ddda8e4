"""Proof that near a computed assembly there is exactly one: Krawczyk's test in Study coordinates, complex, with every rounding bounded.

A point x with one coordinate held at 1 and a box of radii r around it: if |Y F(x)| + |I - Y J| r < r for the derivatives J anywhere in the
box and some matrix Y, the map x - Y F(x) takes the box into itself and contracts it, and the box has one solution (Krawczyk 1969; Rump,
Verification methods, 2010, 13.3). The equations are quadrics, so that J varies by a known amount. Results in floating point are enlarged by
bounds of their rounding (Higham, Accuracy and Stability, 3.1), far wider than the sums here need.

Near folds and far out the map's own rounding, multiplied by Y, fills the box. If that is all, the point gets as many digits as it needs and
F(x) is computed in whole numbers (`exact`): the rest of the test has room for the roundings of double precision.

Points and lengths of a file are binary fractions; moved by one and divided by a power of two they are whole multiples of a small one still.
So is a pose whose Study coordinates are kept to DIGITS binary digits. With h = g + e b - a e, whose parts are linear in the pose (e,
g), a link's equation is h.h - l^2 e.e = 0 (`kernels.homotopy`), and Python's whole numbers know no overflow.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import BoolArray, ComplexArray, FloatArray, IntArray
from lmeasure.linkages import study_quadric
from lmeasure.linkages.study_quadric import Array

DIGITS = 160  # Binary digits of the coordinates of a pose, of size 1 at most
Whole = NDArray[np.object_]  # Of Python's integers


@dataclass(frozen=True)
class ExactLinks:
    """Six links between quaternions base and platform (6, 4) without a scalar part, of lengths (6,), as multiples of `unit`, a power of
    two."""

    base: Whole
    platform: Whole
    lengths: Whole
    unit: int

    @classmethod
    def of(
        cls, base: FloatArray, platform: FloatArray, lengths: FloatArray, *, origins: tuple[FloatArray, FloatArray], size: float
    ) -> "ExactLinks":
        """Return the links of points base (6, 3) and platform (6, 3) minus the origins (3,) of their frames, and lengths (6,), all divided
        by a size, a power of two."""
        points = [_less(base, origins[0]), _less(platform, origins[1]), _less(lengths[:, None], np.zeros(1))]
        unit = max(number.denominator for rows in points for row in rows for number in row) * int(max(size, 1.0))
        per = Fraction(unit) / Fraction(size)
        a, b, length = (np.array([[int(number * per) for number in row] for row in rows], dtype=object) for rows in points)
        pure = np.zeros((6, 1), dtype=object)
        return cls(np.concatenate([pure, a], axis=1), np.concatenate([pure, b], axis=1), length[:, 0], unit)

    def equations(self, u: Whole, v: Whole) -> ComplexArray:
        """(n, 7) of the links and of Study's quadric at poses u + i v (n, 8), multiples of 2^-DIGITS, rounded once."""
        (au, hu), (av, hv) = ((x[:, None, :4], self._away(x)) for x in (u, v))
        square = self.lengths**2
        real = (hu * hu - hv * hv).sum(axis=-1) - square * (au * au - av * av).sum(axis=-1)
        imaginary = 2 * ((hu * hv).sum(axis=-1) - square * (au * av).sum(axis=-1))
        one = self.unit**2 << (2 * DIGITS)
        links = _float(real, one) + 1j * _float(imaginary, one)
        one = 1 << (2 * DIGITS)
        study_real = (u[:, :4] * u[:, 4:] - v[:, :4] * v[:, 4:]).sum(axis=-1)
        study_imaginary = (u[:, :4] * v[:, 4:] + v[:, :4] * u[:, 4:]).sum(axis=-1)
        return np.concatenate([links, (_float(study_real, one) + 1j * _float(study_imaginary, one))[:, None]], axis=1)

    def _away(self, x: Whole) -> Whole:
        """(n, 6, 4) of g + e b - a e."""
        e, g = x[:, None, :4], x[:, None, 4:]
        return np.asarray(self.unit * g + study_quadric.product(e, self.platform) - study_quadric.product(self.base, e))


def _less(points: FloatArray, origin: FloatArray) -> list[list[Fraction]]:
    """Points (n, k) minus an origin (k,)."""
    return [[Fraction(p) - Fraction(o) for p, o in zip(row, origin.tolist(), strict=True)] for row in points.tolist()]


def whole(x: FloatArray) -> Whole:
    """Multiples of 2^-DIGITS nearest to numbers below 2."""
    return np.array([int(Fraction(value) * (1 << DIGITS)) for value in x.ravel().tolist()], dtype=object).reshape(x.shape)


def rounded(u: Whole) -> FloatArray:
    """Multiples of 2^-DIGITS as floating-point numbers."""
    return _float(u, 1 << DIGITS)


def _float(numbers: Whole, one: int) -> FloatArray:
    """Each divided by one and rounded once."""
    return np.array([value / one for value in numbers.ravel().tolist()], dtype=np.float64).reshape(numbers.shape)


ROUNDING = 5e-15
"""Bound of the relative rounding of a sum of eight sums of eight complex products, 45 units; they have 16 additions and two products at
most one behind the other, of 3 units each."""
LEAST, LEAST_KNOWN = 1e-15, 1e-40  # radii: of points in double precision, and in whole numbers
WIDEN = 3.0  # a box is this much wider than the distance that Newton's method still goes
REFINED = 6  # steps of Newton's method before the test
SHARPENED = 12  # of those in whole numbers
NEAR = 1e-3  # of the largest coordinate: a step beyond which a point is near no assembly


@dataclass(frozen=True)
class Proved:
    """Points (n, 8), one coordinate of each 1, with their proofs."""

    points: ComplexArray
    radius: FloatArray  # (n,) of the box in every coordinate
    certain: BoolArray  # (n,) that the box holds one assembly, and a proper one (e.e is not 0)
    real: BoolArray  # (n,) that this assembly is real; false where it is proved not to be, or not known


def proved(rows: ComplexArray, points: ComplexArray, exact: ExactLinks | None = None) -> Proved:
    """Return the proofs for points (n, 8) near assemblies of links with real dimensions (6, 7).

    The rows are those of `study.links` for moved and scaled coordinates: each of these operations is exact up to a rounding of its result.
    exact: the same links in whole numbers, for points without a proof in double precision.
    """
    Q, slack = study_quadric.quadrics(rows), ROUNDING * _magnitudes(rows)
    held = np.abs(points).argmax(axis=1)
    x = points / np.take_along_axis(points, held[:, None], axis=1)
    for _ in range(REFINED):
        x = x - _newton(*_at(Q, x), held)
    radius, certain = _box(Q, slack, x, held)
    # a real assembly's box holds its conjugate too, and there is but one
    real = certain & (np.abs(x.imag).max(axis=1) <= radius)
    x[real] = x[real].real
    x[real] -= _newton(*_at(Q, x[real]), held[real]).real
    radius[real], certain[real] = _box(Q, slack, x[real], held[real])
    real &= certain
    if exact is not None:
        left = np.flatnonzero(~certain & (np.abs(_newton(*_at(Q, x), held)).max(axis=1) < NEAR))
        x[left], radius[left], certain[left], real[left] = _sharpened(exact, Q, slack, x[left], held[left])
    return Proved(x, radius, certain, real)


def _sharpened(
    exact: ExactLinks, Q: ComplexArray, slack: FloatArray, x: ComplexArray, held: IntArray
) -> tuple[ComplexArray, FloatArray, BoolArray, BoolArray]:
    """`Proved` of points taken to `exact.DIGITS` digits: as they are rounded, with boxes around those."""
    u, v = whole(x.real), whole(x.imag)
    x, radius, certain = _settled(exact, Q, slack, u, v, held)
    real = certain & (np.abs(x.imag).max(axis=1) <= radius)
    v[real] = 0
    x[real], radius[real], certain[real] = _settled(exact, Q, slack, u[real], v[real], held[real])
    return x, radius + ROUNDING, certain, real & certain


def _settled(
    exact: ExactLinks, Q: ComplexArray, slack: FloatArray, u: Whole, v: Whole, held: IntArray
) -> tuple[ComplexArray, FloatArray, BoolArray]:
    """Points u + i v after SHARPENED steps, rounded, radii of boxes around them before that, and which are proved."""
    for _ in range(SHARPENED):
        step = _newton(exact.equations(u, v), _at(Q, rounded(u) + 1j * rounded(v))[1], held)
        step[~(np.abs(step).max(axis=1) < NEAR)] = 0.0
        u, v = u - whole(step.real), v - whole(step.imag)
    x = rounded(u) + 1j * rounded(v)
    return (x, *_box(Q, slack, x, held, exact.equations(u, v)))


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


def _newton(F: ComplexArray, J: ComplexArray, held: IntArray) -> ComplexArray:
    """(n, 8) a step of Newton's method from equations (n, 7) and their derivatives, to be taken off; where there is none, 0."""
    step = np.einsum("nij,nj->ni", _inverses(_square(J, held)), _with_held(F))
    return np.where(np.isfinite(step).all(axis=1, keepdims=True), step, 0.0)


def _at(Q: ComplexArray, x: ComplexArray) -> tuple[ComplexArray, ComplexArray]:
    """Equations (n, 7) and their derivatives (n, 7, 8)."""
    Qx = np.einsum("kij,nj->nki", Q, x)
    return np.einsum("nki,ni->nk", Qx, x), 2.0 * Qx


def _square(J: ComplexArray, held: IntArray) -> ComplexArray:
    """(n, 8, 8) with an eighth equation, that the held coordinate stays."""
    fixed = np.zeros((len(J), 1, 8))
    fixed[np.arange(len(J)), 0, held] = 1.0
    return np.concatenate([J, fixed], axis=1)


def _with_held(F: Array) -> Array:
    """(n, 8), real or complex, with an eighth equation, which is met."""
    return np.concatenate([F, np.zeros((len(F), 1))], axis=1)


def _inverses(J: ComplexArray) -> ComplexArray:
    """(n, 8, 8) inverses, NaN where there is none."""
    out = np.full(J.shape, np.nan, dtype=np.complex128)
    regular = np.linalg.cond(J) < 1.0 / np.finfo(float).eps if len(J) else np.zeros(0, bool)
    out[regular] = np.linalg.inv(J[regular])
    return out


def _box(
    Q: ComplexArray, slack: FloatArray, x: ComplexArray, held: IntArray, known: ComplexArray | None = None
) -> tuple[FloatArray, BoolArray]:
    """Return radii (n,) of boxes around x, and whether the test proves one proper assembly in each. known: the equations (n, 7) computed in
    whole numbers at the rounded x."""
    F, J = _at(Q, x)
    J = _square(J, held)
    Y = _inverses(J)
    with np.errstate(invalid="ignore"):
        size, weight = np.abs(x), np.abs(Y)
        if known is None:
            # |F| at most: computed value, rounding, and tolerance of the dimensions
            f = _with_held(np.abs(F) + np.einsum("kij,ni,nj->nk", ROUNDING * np.abs(Q) + slack, size, size))
        else:
            f = _with_held(np.abs(known) * (1.0 + ROUNDING))
        reach = np.einsum("nij,nj->ni", weight, f)
        radius = WIDEN * reach.max(axis=1) + (LEAST if known is None else LEAST_KNOWN)
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
    """Return (7, 8, 8) the quadrics with every term taken by its size: the scale of their entries' rounding."""
    a, b = np.abs(rows[:, :3]).max(axis=1), np.abs(rows[:, 3:6]).max(axis=1)
    out = np.zeros((7, 8, 8))
    # c is a sum of three squares; the length's may be as large as both others together
    of_c = np.abs(rows[:, 6]) + 6.0 * (a**2 + b**2)
    out[:6, :4, :4] = of_c[:, None, None] * np.eye(4) + 6.0 * (a * b)[:, None, None]
    out[:6, :4, 4:] = out[:6, 4:, :4] = 2.0 * (a + b)[:, None, None]
    return out
