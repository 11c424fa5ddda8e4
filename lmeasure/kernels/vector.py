"""3-vectors as tuples, unit quaternions as tuples x, y, z, w: the alphabet of the other kernels."""

import math

from lmeasure.core import FloatArray
from lmeasure.kernels import layout
from lmeasure.kernels.decorators import inline

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]


@inline
def vec(row: FloatArray, i: int) -> Vec3:
    return row[i], row[i + 1], row[i + 2]


@inline
def orientation(pose: FloatArray) -> Quat:
    return pose[layout.ORIENTATION], pose[layout.ORIENTATION + 1], pose[layout.ORIENTATION + 2], pose[layout.ORIENTATION + 3]


@inline
def add(a: Vec3, b: Vec3) -> Vec3:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inline
def sub(a: Vec3, b: Vec3) -> Vec3:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


@inline
def scale(k: float, a: Vec3) -> Vec3:
    return k * a[0], k * a[1], k * a[2]


@inline
def dot(a: Vec3, b: Vec3) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inline
def cross(a: Vec3, b: Vec3) -> Vec3:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inline
def norm(a: Vec3) -> float:
    return math.sqrt(a[0] * a[0] + a[1] * a[1] + a[2] * a[2])


# arctan(f)/f = 1 + z (c0 + c1 z + ...), z = f^2 <= tan^2(22.5 deg): interpolated at Chebyshev's points; its error is less than 1.4e-16
ARCTANGENT = (
    -0.3333333333333325, 0.19999999999898407, -0.1428571426609662, 0.11111109636534361, -0.09090852557176049,
    0.0769105515839315, -0.06649613695291669, 0.05736332165907643, -0.04483334622272886, 0.02275052699336167,
)  # fmt: skip


@inline
def angle(y: float, x: float) -> float:
    """atan2(y, x) in [0, 2 pi) by a single division and no branch, so that a loop over samples vectorises; NaN where both are zero."""
    ay, ax = abs(y), abs(x)
    steep = ay > 2.414213562373095 * ax
    middle = ay > 0.41421356237309503 * ax
    numerator = -ax if steep else (ay - ax if middle else ay)
    denominator = ay if steep else (ay + ax if middle else ax)
    offset = 0.5 * math.pi if steep else (0.25 * math.pi if middle else 0.0)
    f = numerator / denominator
    z = f * f
    c = ARCTANGENT
    p = c[6] + z * (c[7] + z * (c[8] + z * c[9]))
    p = c[0] + z * (c[1] + z * (c[2] + z * (c[3] + z * (c[4] + z * (c[5] + z * p)))))
    a = offset + (f + f * (z * p))
    a = a if x >= 0.0 else math.pi - a
    return a if y >= 0.0 else 2.0 * math.pi - a


@inline
def sine_cosine(x: float) -> tuple[float, float]:
    """(sin x, cos x) without a branch, so that a loop over candidates vectorises, for |x| of a few turns.

    Reduced to [-pi/4, pi/4] by quarter turns in three parts, then Cephes' polynomials (Moshier, Methods and Programs for Mathematical
    Functions, 1989; sin.c): within two units in the last place of 1.
    """
    k = math.floor(x * (2.0 / math.pi) + 0.5)
    r = ((x - k * 1.57079625129699707031) - k * 7.54978941586159635335e-8) - k * 5.39030285815811905290e-15
    z = r * r
    s = (1.58962301576546568060e-10 * z - 2.50507477628578072866e-8) * z + 2.75573136213857245213e-6
    s = ((s * z - 1.98412698295895385996e-4) * z + 8.33333333332211858878e-3) * z - 1.66666666666666307295e-1
    s = r + r * z * s
    c = (-1.13585365213876817300e-11 * z + 2.08757008419747316778e-9) * z - 2.75573141792967388112e-7
    c = ((c * z + 2.48015872888517045348e-5) * z - 1.38888888888730564116e-3) * z + 4.16666666666665929218e-2
    c = 1.0 - 0.5 * z + z * z * c
    quarter = k - 4.0 * math.floor(0.25 * k)
    odd = quarter == 1.0 or quarter == 3.0
    sine, cosine = (c if odd else s), (s if odd else c)
    return (-sine if quarter >= 2.0 else sine), (-cosine if quarter == 1.0 or quarter == 2.0 else cosine)


@inline
def rotate(q: Quat, a: Vec3) -> Vec3:
    """Rotate a by the unit quaternion q (x, y, z, w): a + 2 w (n x a) + 2 n x (n x a), n the vector part."""
    n = (q[0], q[1], q[2])
    t = scale(2.0, cross(n, a))
    return add(a, add(scale(q[3], t), cross(n, t)))


@inline
def rotation_matrix(q: Quat) -> tuple[Vec3, Vec3, Vec3]:
    """Rows of the rotation matrix of the unit quaternion q: cheaper than `rotate` for several vectors."""
    x2, y2, z2 = q[0] + q[0], q[1] + q[1], q[2] + q[2]
    xx, yy, zz = q[0] * x2, q[1] * y2, q[2] * z2
    xy, xz, yz = q[0] * y2, q[0] * z2, q[1] * z2
    wx, wy, wz = q[3] * x2, q[3] * y2, q[3] * z2
    return (1.0 - (yy + zz), xy - wz, xz + wy), (xy + wz, 1.0 - (xx + zz), yz - wx), (xz - wy, yz + wx, 1.0 - (xx + yy))


@inline
def rotate_back(q: Quat, a: Vec3) -> Vec3:
    """Rotate a by the inverse of the unit quaternion q."""
    return rotate((-q[0], -q[1], -q[2], q[3]), a)


@inline
def multiply(p: Quat, q: Quat) -> Quat:
    """Quaternion of the rotation q followed by p."""
    return (
        p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
        p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
        p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
    )
