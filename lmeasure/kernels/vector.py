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
def rotate(q: Quat, a: Vec3) -> Vec3:
    """Rotate a by the unit quaternion q (x, y, z, w): a + 2 w (n x a) + 2 n x (n x a), n the vector part."""
    n = (q[0], q[1], q[2])
    t = scale(2.0, cross(n, a))
    return add(a, add(scale(q[3], t), cross(n, t)))


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
