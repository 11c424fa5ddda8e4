"""Links in whole numbers: their equations at poses of any number of digits without a rounding.

Points and lengths of a file are binary fractions; moved by one and divided by a power of two they are whole multiples of a small one still.
So is a pose whose Study coordinates are kept to DIGITS binary digits. With h = g + e b - a e, of which each part is linear in the pose
(e, g), a link's equation is h.h - l^2 e.e = 0 (`kernels.homotopy`), and Python's whole numbers know no overflow.
"""

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import ComplexArray, FloatArray
from lmeasure.linkages import study_quadric

DIGITS = 160
"""Binary ones of a pose's coordinates, of which the largest is 1."""
Whole = NDArray[np.object_]
"""Of Python's integers."""


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
        """Of points base (6, 3) and platform (6, 3) less the origins (3,) of their frames, and lengths (6,), all divided by a size, a power
        of two."""
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
    """Points (n, k) less an origin (k,)."""
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
