"""Rows of lanes: what the stages of the zone's lane kernel share, a buffer of rows that are LANES long and the way to them."""

import math

from lmeasure.arrays import FloatArray
from lmeasure.kernels import inline
from lmeasure.kernels.vector import Vec3, add, dot, scale, sub
from lmeasure.kernels.zone import WORST_START

LANES = 32

# Rows, LANES long each. The compiler vectorises a loop only where it can tell that rows do not overlap: all offsets within one buffer are
# constants, and what depends on the cable has a part of its own.
# of a cable: direction and straight part of its free span, then by its unit rate the tool's turn and move and the velocity of a point
SPAN, STRAIGHT, TURN, MOVE, VELOCITY, CABLE_ROWS = 0, 3, 4, 7, 10, 13
# of the place: the tool origin, a covariance (xx, yy, zz, xy, xz, yz), worst figures so far, least of what tells a sound inverse, total of
# the radii, which keeps what is not finite
PLACE, COVARIANCE, WORST = 0, 3, 9
SOUND, TOTAL, PLACE_ROWS = WORST + len(WORST_START), WORST + len(WORST_START) + 1, WORST + len(WORST_START) + 2

# arctan(f)/f = 1 + z (c0 + c1 z + ...), z = f^2 <= tan^2(22.5 deg): interpolated at Chebyshev's points; errs by less than 1.4e-16
ARCTANGENT = (
    -0.3333333333333325, 0.19999999999898407, -0.1428571426609662, 0.11111109636534361, -0.09090852557176049,
    0.0769105515839315, -0.06649613695291669, 0.05736332165907643, -0.04483334622272886, 0.02275052699336167,
)  # fmt: skip


@inline
def angle(y: float, x: float, over: float) -> tuple[float, float]:
    """atan2(y, x) in [0, 2 pi), and 1/over, by a single division and no branch."""
    ay, ax = abs(y), abs(x)
    steep = ay > 2.414213562373095 * ax
    middle = ay > 0.41421356237309503 * ax
    numerator = -ax if steep else (ay - ax if middle else ay)
    denominator = ay if steep else (ay + ax if middle else ax)
    offset = 0.5 * math.pi if steep else (0.25 * math.pi if middle else 0.0)
    both = 1.0 / (over * denominator)
    f = numerator * (over * both)
    z = f * f
    c = ARCTANGENT
    p = c[6] + z * (c[7] + z * (c[8] + z * c[9]))
    p = c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * (c[5] + z * p)))))
    a = offset + (f + f * (z * p))
    a = a if x >= 0.0 else math.pi - a
    return (a if y >= 0.0 else 2.0 * math.pi - a), denominator * both


@inline
def leaving(d: Vec3, u: Vec3, radius: float) -> tuple[float, float, Vec3, float, float, float]:
    """(phi, t, e, cos phi, sin phi, q/p) of the cable to the point d from B, as in `kernels.cable.wrapped_span`, by two divisions."""
    q = dot(d, u)
    n = sub(d, scale(q, u))
    p = math.sqrt(dot(n, n))
    x = p - radius
    square = x * x + q * q
    t = math.sqrt(square - radius * radius)
    sine, cosine = q * radius + x * t, q * t - x * radius
    phi, k = angle(sine, cosine, p * square)
    e = add(scale(sine * k, n), scale(cosine * p * k, u))
    return phi, t, e, cosine * p * k, sine * p * k, q * (k * square)


@inline
def at(B: FloatArray, row: int, lane: int) -> Vec3:
    return B[row * LANES + lane], B[(row + 1) * LANES + lane], B[(row + 2) * LANES + lane]


@inline
def put(B: FloatArray, row: int, lane: int, a: Vec3) -> None:
    B[row * LANES + lane], B[(row + 1) * LANES + lane], B[(row + 2) * LANES + lane] = a


@inline
def least(B: FloatArray, row: int, lane: int, value: float) -> None:
    i = row * LANES + lane
    B[i] = value if value < B[i] else B[i]


@inline
def most(B: FloatArray, row: int, lane: int, value: float) -> None:
    i = row * LANES + lane
    B[i] = value if value > B[i] else B[i]


@inline
def vec(row: FloatArray, i: int) -> Vec3:
    return row[i], row[i + 1], row[i + 2]
