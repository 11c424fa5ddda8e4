"""Poses as arrays: composed, inverted, displaced, and twists taken from one frame to another. Compiled code has its own (`kernels.se3`).

A pose is a row `x, y, z, qx, qy, qz, qw`, mm and a unit quaternion; an array of poses is (..., 7), any axes before the last one being a
batch, and two arrays broadcast against each other. A name says which frames it joins: `a_from_b` takes coordinates in b to those in a, so
that `compose(a_from_b, b_from_c)` is `a_from_c`. An unknown pose (NaN) raises ValueError.

Twists and small errors are (omega; v), rotation first. A *displacement* delta is an error as every covariance here states it: a turn and a
shift of the origin in the axes of the outer frame, R' = Exp(delta[:3]) R, p' = p + delta[3:]. The screw motion of a twist is `exp`.
"""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from lmeasure.core.arrays import FloatArray

if TYPE_CHECKING:
    # a fifth of a second to load, for commands that need a dozen products of quaternions
    from scipy.spatial.transform import Rotation

_CYCLES = (0, 1, 2), (1, 2, 0), (2, 0, 1)


def rotation(a_from_b: FloatArray) -> "Rotation":
    """The rotation of a pose (7,), or those of poses (n, 7)."""
    from scipy.spatial.transform import Rotation

    return Rotation.from_quat(a_from_b[..., 3:])


def pose(position_mm: ArrayLike, turn: "Rotation") -> FloatArray:
    """(7,) or (n, 7) poses with these positions (3,) or (n, 3) and rotations, one of them for all where only the other is many."""
    return _joined(np.asarray(position_mm, dtype=np.float64), turn.as_quat())


def matrices(a_from_b: FloatArray) -> FloatArray:
    """(..., 3, 3) rotation matrices of poses (..., 7)."""
    q = _quaternions(a_from_b)
    both = q[..., :, None] * q[..., None, :]
    out = np.empty((*q.shape[:-1], 3, 3))
    for i, j, k in _CYCLES:
        out[..., i, i] = both[..., i, i] - both[..., j, j] - both[..., k, k] + both[..., 3, 3]
        out[..., i, j] = 2.0 * (both[..., i, j] - both[..., k, 3])
        out[..., j, i] = 2.0 * (both[..., i, j] + both[..., k, 3])
    return out


def apply(a_from_b: FloatArray, points: ArrayLike) -> FloatArray:
    """(..., 3) coordinates in a of points (..., 3) given in b."""
    return np.asarray(np.asarray(a_from_b)[..., :3] + _turned(matrices(a_from_b), points))


def compose(a_from_b: FloatArray, b_from_c: FloatArray) -> FloatArray:
    """(..., 7) a_from_c."""
    return _joined(apply(a_from_b, np.asarray(b_from_c)[..., :3]), _product(_quaternions(a_from_b), _quaternions(b_from_c)))


def inverse(a_from_b: FloatArray) -> FloatArray:
    """(..., 7) b_from_a."""
    back = _inverted(a_from_b)
    return _joined(-_turned(matrices(back), back[..., :3]), back[..., 3:])


def between(a_from_b: FloatArray, a_from_c: FloatArray) -> FloatArray:
    """(..., 7) b_from_c; positions are subtracted before they are turned, so that two near poses far from a lose no digits."""
    back, other = _inverted(a_from_b), np.asarray(a_from_c, dtype=np.float64)
    return _joined(_turned(matrices(back), other[..., :3] - back[..., :3]), _product(back[..., 3:], _quaternions(other)))


def displaced(a_from_b: FloatArray, delta: ArrayLike) -> FloatArray:
    """(..., 7) poses after displacements delta (..., 6) [rad; mm] in the axes of a: Exp(delta[:3]) R, p + delta[3:]."""
    rows, by = np.asarray(a_from_b, dtype=np.float64), np.asarray(delta, dtype=np.float64)
    return _joined(rows[..., :3] + by[..., 3:], _product(_exponential(by[..., :3]), _quaternions(rows)))


def displacement(a_from_b: FloatArray, reference: FloatArray) -> FloatArray:
    """(..., 6) [rad; mm] the delta for which `displaced(reference, delta)` are these poses."""
    rows, back = np.asarray(a_from_b, dtype=np.float64), _inverted(reference)
    return _joined(_logarithm(_product(_quaternions(rows), back[..., 3:])), rows[..., :3] - back[..., :3])


def exp(twists: ArrayLike) -> FloatArray:
    """Return the (..., 7) poses of screw motions from the identity in unit time, for twists (..., 6), (omega [rad]; v [mm]) at the origin.
    Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 2.3: the shift is the left Jacobian of omega times v."""
    rows = np.asarray(twists, dtype=np.float64)
    return _joined(_turned(left_jacobians(rows[..., :3]), rows[..., 3:]), _exponential(rows[..., :3]))


def log(a_from_b: FloatArray) -> FloatArray:
    """(..., 6) the twists of at most half a turn whose `exp` are the poses (..., 7)."""
    omega = _logarithm(_quaternions(a_from_b))
    v = np.linalg.solve(left_jacobians(omega), np.asarray(a_from_b)[..., :3, None])[..., 0]
    return np.concatenate([omega, v], axis=-1)


def left_jacobians(turns: FloatArray) -> FloatArray:
    """(..., 3, 3) of rotation vectors (..., 3): Exp(a + da) = Exp(J da) Exp(a) to first order."""
    angle = np.linalg.norm(turns, axis=-1)[..., None, None]
    K = np.cross(turns[..., None, :], np.eye(3)).swapaxes(-1, -2)
    # the cancellation in (angle - sin angle)/angle^3 is multiplied by the angle's square, so no digits are lost
    third = (1.0 - np.sinc(angle / np.pi)) / np.where(angle > 1e-100, angle**2, 1.0)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * K + third * (K @ K))


def adjoint(a_from_b: FloatArray) -> FloatArray:
    """(..., 6, 6) matrices that take twists at the origin of b in its axes to the same motions at the origin of a in its axes."""
    turn = matrices(np.asarray(a_from_b))
    out = np.zeros((*turn.shape[:-2], 6, 6))
    out[..., :3, :3] = out[..., 3:, 3:] = turn
    # v at the other origin: a turn omega about b carries it by omega x (-p)
    out[..., 3:, :3] = at_points(-a_from_b[..., :3])[..., 3:, :3] @ turn
    return out


def at_points(arms_mm: FloatArray) -> FloatArray:
    """(..., 6, 6) matrices that take twists or displacements of an origin to those of points at arms_mm (..., 3) from it, axes kept."""
    out = np.zeros((*arms_mm.shape[:-1], 6, 6))
    out[...] = np.eye(6)
    # v + omega x r
    for i, j, k in _CYCLES:
        out[..., 3 + i, j], out[..., 3 + i, k] = arms_mm[..., k], -arms_mm[..., j]
    return out


def _joined(first: FloatArray, second: FloatArray) -> FloatArray:
    """(..., a + b) rows side by side, of batches that broadcast against each other."""
    shape = np.broadcast_shapes(first.shape[:-1], second.shape[:-1])
    return np.concatenate([np.broadcast_to(part, (*shape, part.shape[-1])) for part in (first, second)], axis=-1)


def _quaternions(a_from_b: ArrayLike) -> FloatArray:
    """(..., 4) unit quaternions of poses; ValueError where there is none."""
    q = np.asarray(a_from_b, dtype=np.float64)[..., 3:]
    norm = np.linalg.norm(q, axis=-1, keepdims=True)
    if not (norm > 0.0).all():
        raise ValueError("a pose has a quaternion of zero length. State one of length 1")
    return np.asarray(q / norm)


def _inverted(a_from_b: ArrayLike) -> FloatArray:
    """(..., 7) poses with their turns back and their positions as they are."""
    rows = np.asarray(a_from_b, dtype=np.float64)
    return np.concatenate([rows[..., :3], _quaternions(rows) * (-1.0, -1.0, -1.0, 1.0)], axis=-1)


def _turned(turns: FloatArray, points: ArrayLike) -> FloatArray:
    """(..., 3) matrices times points."""
    return np.asarray((turns @ np.asarray(points, dtype=np.float64)[..., None])[..., 0])


def _product(p: FloatArray, q: FloatArray) -> FloatArray:
    """(..., 4) the turns q, then p."""
    both = p[..., :, None] * q[..., None, :]
    out = np.empty(both.shape[:-1])
    for i, j, k in _CYCLES:
        out[..., i] = both[..., 3, i] + both[..., i, 3] + both[..., j, k] - both[..., k, j]
    out[..., 3] = both[..., 3, 3] - both[..., 0, 0] - both[..., 1, 1] - both[..., 2, 2]
    return out


def _exponential(turns: FloatArray) -> FloatArray:
    """(..., 4) quaternions of rotation vectors (..., 3)."""
    half = 0.5 * np.linalg.norm(turns, axis=-1, keepdims=True)
    return np.concatenate([0.5 * np.sinc(half / np.pi) * turns, np.cos(half)], axis=-1)


def _logarithm(quaternions: FloatArray) -> FloatArray:
    """(..., 3) rotation vectors of at most half a turn."""
    axis, w = quaternions[..., :3], quaternions[..., 3:]
    sine = np.linalg.norm(axis, axis=-1, keepdims=True)
    half = np.arctan2(sine, np.abs(w))
    return np.asarray(np.where(w < 0.0, -1.0, 1.0) * 2.0 * axis / np.sinc(half / np.pi))
