"""Finite twists: the exponential of screws, and the logarithm of turns.

A twist is (omega; v) with v the velocity of the body point that is momentarily at the reference point. The displacement is
x -> R x + V v about that reference point, R = exp[omega], V = sin(t)/t I + (1-cos t)/t^2 [omega] + (t - sin t)/t^3 omega omega^T,
t = |omega| (Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 2.3). The coefficients are written so that
none cancels for tiny angles: (1 - cos t)/t^2 = 2 sin^2(t/2)/t^2, and the last one by its series below 0.5 rad.
"""

import math

from lmeasure.kernels.decorators import inline
from lmeasure.kernels.vector import Quat, Vec3, add, cross, dot, norm, scale


@inline
def _third_coefficient(t: float) -> float:
    """(t - sin t)/t^3, by its Taylor series where the difference would cancel (9 terms: below 1e-17 relative at 0.5)."""
    if abs(t) > 0.5:
        return (t - math.sin(t)) / (t * t * t)
    z = t * t
    return (1.0 - z / 20.0 * (1.0 - z / 42.0 * (1.0 - z / 72.0 * (1.0 - z / 110.0 * (1.0 - z / 156.0 * (1.0 - z / 210.0)))))) / 6.0


@inline
def exp_rotation(omega: Vec3) -> Quat:
    """Unit quaternion (x, y, z, w) of the rotation vector omega [rad]."""
    t = norm(omega)
    half = 0.5 * t
    k = 0.5 if t < 1e-150 else math.sin(half) / t
    return k * omega[0], k * omega[1], k * omega[2], math.cos(half)


@inline
def exp_translation(omega: Vec3, v: Vec3) -> Vec3:
    """Displacement V v of the body point at the reference point, by the twist (omega; v) applied for unit time."""
    t = norm(omega)
    if t < 1e-150:
        return v
    s = math.sin(0.5 * t) / t
    b = 2.0 * s * s
    c = _third_coefficient(t)
    a = math.sin(t) / t
    return add(scale(a, v), add(scale(b, cross(omega, v)), scale(c * dot(omega, v), omega)))


@inline
def log_rotation(q: Quat) -> Vec3:
    """Rotation vector of the unit quaternion q, of length at most pi."""
    n = (q[0], q[1], q[2])
    s = norm(n)
    if s < 1e-150:
        return scale(2.0 if q[3] >= 0.0 else -2.0, n)
    t = 2.0 * math.atan2(s, q[3]) if q[3] >= 0.0 else -2.0 * math.atan2(s, -q[3])
    return scale(t / s, n)
