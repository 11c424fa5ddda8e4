"""Poses as points of Study's quadric, and links of given lengths as quadrics in the same space (`kernels.homotopy` has the formulas)."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import ComplexArray, FloatArray

Array = NDArray[Any]  # Real or complex


def links(base: ComplexArray | FloatArray, platform: ComplexArray | FloatArray, squares: ComplexArray | FloatArray) -> ComplexArray:
    """Return (6, 7) rows of links between points base (6, 3) and platform (6, 3) of squared lengths (6,): both points, and the
    remainder."""
    c = (base * base).sum(axis=-1) + (platform * platform).sum(axis=-1) - squares
    return np.concatenate([base, platform, c[..., None]], axis=-1).astype(np.complex128)


def product(p: Array, q: Array) -> Array:
    """(..., 4) products of quaternions (..., 4), scalar first."""
    p0, q0, u, v = p[..., :1], q[..., :1], p[..., 1:], q[..., 1:]
    return np.concatenate([p0 * q0 - (u * v).sum(axis=-1, keepdims=True), p0 * v + q0 * u + np.cross(u, v)], axis=-1)


def points(poses: FloatArray) -> FloatArray:
    """(..., 8) Study coordinates of poses (..., 7)."""
    e = np.roll(poses[..., 3:], 1, axis=-1)
    p = np.concatenate([np.zeros_like(e[..., :1]), poses[..., :3]], axis=-1)
    return np.concatenate([e, product(p, e)], axis=-1)


def points_of(shift: Array, turn: Array) -> Array:
    """(..., 8) Study coordinates of shifts (..., 3) and rotation matrices (..., 3, 3), real or complex. Of the four columns of 4 e e^T,
    which has no term that could cancel on its diagonal, the largest."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = (tuple(turn[..., i, j] for j in range(3)) for i in range(3))
    columns = [
        [1.0 + xx + yy + zz, zy - yz, xz - zx, yx - xy],
        [zy - yz, 1.0 + xx - yy - zz, xy + yx, xz + zx],
        [xz - zx, xy + yx, 1.0 - xx + yy - zz, yz + zy],
        [yx - xy, xz + zx, yz + zy, 1.0 - xx - yy + zz],
    ]
    four = np.stack([np.stack(column, axis=-1) for column in columns], axis=-2)
    best = np.nan_to_num(np.abs(np.einsum("...ii->...i", four))).argmax(axis=-1)
    e = np.take_along_axis(four, best[..., None, None], axis=-2)[..., 0, :]
    p = np.concatenate([np.zeros_like(shift[..., :1]), shift], axis=-1)
    return np.concatenate([e, product(p, e)], axis=-1)


def turns(x: Array) -> Array:
    """(..., 3, 3) rotation matrices of Study coordinates (..., 8), real or complex."""
    e = x[..., :4]
    e0, u = e[..., :1, None], e[..., 1:]
    uu, ee = (u * u).sum(axis=-1)[..., None, None], (e * e).sum(axis=-1)[..., None, None]
    across = np.cross(u[..., None, :], np.eye(3)).swapaxes(-1, -2)
    return np.asarray(((e0 * e0 - uu) * np.eye(3) + 2.0 * u[..., :, None] * u[..., None, :] + 2.0 * e0 * across) / ee)


def poses(x: FloatArray) -> FloatArray:
    """(..., 7) the poses that have real Study coordinates (..., 8)."""
    x = x / np.linalg.norm(x[..., :4], axis=-1, keepdims=True)
    e, g = x[..., :4], x[..., 4:]
    p = product(g, e * [1.0, -1.0, -1.0, -1.0])[..., 1:]
    return np.concatenate([p, np.roll(e, -1, axis=-1)], axis=-1)


def quadrics(rows: ComplexArray) -> ComplexArray:
    """(7, 8, 8) symmetric matrices Q of links (6, 7) and of Study's quadric: x.Q x = 0."""
    one = np.eye(4)
    left = np.stack([product(np.broadcast_to(q, (4, 4)), one).T for q in one])  # left[i] e = q_i e
    right = np.stack([product(one, np.broadcast_to(q, (4, 4))).T for q in one])
    La, Rb = np.einsum("ni,ijk->njk", rows[:, :3], left[1:]), np.einsum("ni,ijk->njk", rows[:, 3:6], right[1:])
    Q = np.zeros((7, 8, 8), dtype=np.complex128)
    Q[:6, :4, :4] = rows[:, 6, None, None] * one + La @ Rb + (La @ Rb).swapaxes(1, 2)
    Q[:6, 4:, :4] = Rb - La
    Q[:6, :4, 4:] = Q[:6, 4:, :4].swapaxes(1, 2)
    Q[:6, 4:, 4:] = one
    Q[6, 4:, :4] = Q[6, :4, 4:] = 0.5 * one
    return Q


def inverse(x: ComplexArray) -> ComplexArray:
    """(..., 8) of the inverse poses: with p = g e^-1, the inverse has the quaternion e* and the position -e^-1 p e: g becomes g*."""
    return x * [1.0, -1.0, -1.0, -1.0, 1.0, -1.0, -1.0, -1.0]
