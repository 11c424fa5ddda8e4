"""Poses as arrays: composed, inverted, displaced, and twists taken from one frame to another. Compiled code has its own (`kernels.se3`).

A pose is a row `x, y, z, qx, qy, qz, qw`, mm and a unit quaternion; an array of poses is (..., 7), any axes before the last one being a
batch, and two arrays broadcast against each other. A name says which frames it joins: `a_from_b` takes coordinates in b to those in a,
so that `compose(a_from_b, b_from_c)` is `a_from_c`. A pose that is not known (NaN) is none of these: ValueError.

Twists and small errors are (omega; v), rotation first. A *displacement* delta is an error as every covariance here states it: a turn and a
shift of the origin in the axes of the outer frame, R' = Exp(delta[:3]) R, p' = p + delta[3:]. The screw motion of a twist is `exp`.
"""

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from lmeasure.core.arrays import FloatArray


def rotation(a_from_b: FloatArray) -> Rotation:
    """The rotation of a pose (7,), or those of poses (n, 7)."""
    return Rotation.from_quat(a_from_b[..., 3:])


def pose(position_mm: ArrayLike, turn: Rotation) -> FloatArray:
    """(7,) or (n, 7) poses with these positions (3,) or (n, 3) and rotations, one of them for all where only the other is many."""
    position, quaternion = np.asarray(position_mm, dtype=np.float64), turn.as_quat()
    if position.shape[:-1] != quaternion.shape[:-1]:
        shape = np.broadcast_shapes(position.shape[:-1], quaternion.shape[:-1])
        position, quaternion = np.broadcast_to(position, (*shape, 3)), np.broadcast_to(quaternion, (*shape, 4))
    return np.concatenate([position, quaternion], axis=-1)


def matrices(a_from_b: FloatArray) -> FloatArray:
    """(..., 3, 3) rotation matrices of poses (..., 7)."""
    shape, (rows,) = _flat(a_from_b)
    return np.asarray(rotation(rows).as_matrix()).reshape(*shape, 3, 3)


def apply(a_from_b: FloatArray, points: ArrayLike) -> FloatArray:
    """(..., 3) coordinates in a of points (..., 3) given in b."""
    shape, (rows, at) = _flat(a_from_b, points)
    return np.asarray(rows[..., :3] + rotation(rows).apply(at)).reshape(*shape, 3)


def compose(a_from_b: FloatArray, b_from_c: FloatArray) -> FloatArray:
    """(..., 7) a_from_c."""
    shape, (outer, inner) = _flat(a_from_b, b_from_c)
    turn = rotation(outer)
    return pose(outer[..., :3] + turn.apply(inner[..., :3]), turn * rotation(inner)).reshape(*shape, 7)


def inverse(a_from_b: FloatArray) -> FloatArray:
    """(..., 7) b_from_a."""
    shape, (rows,) = _flat(a_from_b)
    back = rotation(rows).inv()
    return pose(-back.apply(rows[..., :3]), back).reshape(*shape, 7)


def between(a_from_b: FloatArray, a_from_c: FloatArray) -> FloatArray:
    """(..., 7) b_from_c; positions are subtracted before they are turned, so that two near poses far from a lose no digits."""
    shape, (one, other) = _flat(a_from_b, a_from_c)
    back = rotation(one).inv()
    return pose(back.apply(other[..., :3] - one[..., :3]), back * rotation(other)).reshape(*shape, 7)


def displaced(a_from_b: FloatArray, delta: ArrayLike) -> FloatArray:
    """(..., 7) poses after displacements delta (..., 6) [rad; mm] in the axes of a: Exp(delta[:3]) R, p + delta[3:]."""
    shape, (rows, by) = _flat(a_from_b, delta)
    return pose(rows[..., :3] + by[..., 3:], Rotation.from_rotvec(by[..., :3]) * rotation(rows)).reshape(*shape, 7)


def displacement(a_from_b: FloatArray, reference: FloatArray) -> FloatArray:
    """(..., 6) [rad; mm] the delta for which `displaced(reference, delta)` are these poses."""
    shape, (rows, other) = _flat(a_from_b, reference)
    turn = np.asarray((rotation(rows) * rotation(other).inv()).as_rotvec())
    return np.concatenate([turn, np.broadcast_to(rows[..., :3] - other[..., :3], turn.shape)], axis=-1).reshape(*shape, 6)


def exp(twists: ArrayLike) -> FloatArray:
    """(..., 7) what the screw motions of twists (..., 6), (omega [rad]; v [mm]) at the origin, make of the identity in unit time.

    Murray, Li, Sastry, A Mathematical Introduction to Robotic Manipulation, 2.3: the shift is the left Jacobian of omega times v.
    """
    shape, (rows,) = _flat(twists)
    shift = (left_jacobians(rows[..., :3]) @ rows[..., 3:, None])[..., 0]
    return pose(shift, Rotation.from_rotvec(rows[..., :3])).reshape(*shape, 7)


def log(a_from_b: FloatArray) -> FloatArray:
    """(..., 6) the twists of at most half a turn whose `exp` are the poses (..., 7)."""
    shape, (rows,) = _flat(a_from_b)
    omega = np.asarray(rotation(rows).as_rotvec())
    v = np.linalg.solve(left_jacobians(omega), rows[..., :3, None])[..., 0]
    return np.concatenate([omega, v], axis=-1).reshape(*shape, 6)


def left_jacobians(turns: FloatArray) -> FloatArray:
    """(..., 3, 3) of rotation vectors (..., 3): Exp(a + da) = Exp(J da) Exp(a) to first order."""
    angle = np.linalg.norm(turns, axis=-1)[..., None, None]
    K = np.cross(turns[..., None, :], np.eye(3)).swapaxes(-1, -2)
    # what cancels in (angle - sin angle)/angle^3 is multiplied by the angle's square, and nothing of a double is lost
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
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[..., 3 + i, j], out[..., 3 + i, k] = arms_mm[..., k], -arms_mm[..., j]
    return out


def _flat(*arrays: ArrayLike) -> tuple[tuple[int, ...], list[FloatArray]]:
    """The shape of the batch that arrays (..., columns) share, and the arrays with no more than one axis before the last: SciPy knows more
    only since 1.17."""
    rows = [np.asarray(a, dtype=np.float64) for a in arrays]
    shape = np.broadcast_shapes(*(r.shape[:-1] for r in rows))
    if len(shape) > 1:
        rows = [np.broadcast_to(r, (*shape, r.shape[-1])).reshape(-1, r.shape[-1]) for r in rows]
    # SciPy takes no array that cannot be written to
    return shape, [np.require(r, requirements="W") for r in rows]
