"""3-vectors as tuples, unit quaternions as tuples x, y, z, w: the alphabet of the other kernels."""

import math

from lmeasure.kernels import inline

Vec3 = tuple[float, float, float]
Quat = tuple[float, float, float, float]


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


@inline
def angle(y: float, x: float) -> float:
    """atan2(y, x) in [0, 2 pi) without a branch, so that a loop over samples vectorises; NaN where both are zero.

    The arctangent is Cephes' rational approximation on [0, 0.66] after reduction (Moshier, Methods and Programs for Mathematical
    Functions, 1989; atan.c): within two units in the last place.
    """
    ay, ax = abs(y), abs(x)
    steep = ay > 2.414213562373095 * ax
    middle = ay > 0.66 * ax
    numerator = -ax if steep else (ay - ax if middle else ay)
    denominator = ay if steep else (ay + ax if middle else ax)
    offset = 0.5 * math.pi if steep else (0.25 * math.pi if middle else 0.0)
    f = numerator / denominator
    z = f * f
    p = -8.750608600031904122785e-1 * z - 1.615753718733365076637e1
    p = (p * z - 7.500855792314704667340e1) * z - 1.228866684490136173410e2
    p = p * z - 6.485021904942025371773e1
    r = (z + 2.485846490146142306297e1) * z + 1.650270098316988542046e2
    r = (r * z + 4.328810604912902668951e2) * z + 4.853903996359136964868e2
    r = r * z + 1.945506571482613964425e2
    a = offset + (f + f * (z * p / r))
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
