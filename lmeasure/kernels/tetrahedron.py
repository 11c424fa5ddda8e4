"""The fourth corner of a tetrahedron from three corners and its distances to them (thesis 4.1, trilateration)."""

import math

from lmeasure.kernels import kernel
from lmeasure.kernels.vector import Vec3, add, cross, dot, norm, scale, sub


@kernel
def apex(a: Vec3, b: Vec3, c: Vec3, ra: float, rb: float, rc: float) -> tuple[Vec3, Vec3, float]:
    """(apex, its mirror image, squared height [mm^2]) over the plane of the corners a, b, c, at distances ra, rb, rc from them.

    The first apex is on the side of (b - a) x (c - a). A squared height below zero means that no such tetrahedron exists: both are then the
    foot of the one that misses least. NaN when the corners lie on one line.
    """
    ab, ac = sub(b, a), sub(c, a)
    normal = cross(ab, ac)
    area = norm(normal)
    d = norm(ab)
    x = scale(1.0 / d, ab)
    z = scale(1.0 / area, normal) if area > 1e-12 * d * norm(ac) else (math.nan, math.nan, math.nan)
    y = cross(z, x)
    i, j = dot(x, ac), dot(y, ac)
    px = (ra * ra - rb * rb + d * d) / (2.0 * d)
    py = (ra * ra - rc * rc + i * i + j * j - 2.0 * i * px) / (2.0 * j)
    square = ra * ra - px * px - py * py
    foot = add(a, add(scale(px, x), scale(py, y)))
    height = math.sqrt(max(0.0, square))
    return add(foot, scale(height, z)), sub(foot, scale(height, z)), square
