"""Rows of channels of any kind for a tile of lanes (`kernels.lanes_redundant`): how a reading changes as the pose does."""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.angles import frame_at
from lmeasure.kernels.cable import leaving, seen_at, way_round
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.lanes import WIDTH, _orientation, _place
from lmeasure.kernels.layout import (
    ANGLE_ZERO,
    ATTACHMENT,
    BASE,
    ECCENTRIC_PHASE,
    ECCENTRICITY,
    GUIDE,
    KIND,
    ORIENTATION,
    PLACE,
    POSE_COLUMNS,
    RADIUS,
)
from lmeasure.kernels.vector import Vec3, add, angle, cross, dot, norm, rotation_matrix, scale, sub, vec

TURN = 2.0 * math.pi


@inline
def _matrix(M: FloatArray, i: int) -> tuple[Vec3, Vec3, Vec3]:
    """The rotation of a lane, kept by `turned`."""
    return (
        (M[i], M[WIDTH + i], M[2 * WIDTH + i]),
        (M[3 * WIDTH + i], M[4 * WIDTH + i], M[5 * WIDTH + i]),
        (M[6 * WIDTH + i], M[7 * WIDTH + i], M[8 * WIDTH + i]),
    )


@inline
def arm_of(M: FloatArray, i: int, point: Vec3) -> Vec3:
    """A point of the gripper, turned as the gripper of lane i is."""
    A = _matrix(M, i)
    return dot(A[0], point), dot(A[1], point), dot(A[2], point)


@kernel
def turned(S: FloatArray, M: FloatArray) -> None:
    """The lanes' rotation matrices, row by row, into M (9 WIDTH,)."""
    for i in range(WIDTH):
        A = rotation_matrix(_orientation(S, i))
        M[i], M[WIDTH + i], M[2 * WIDTH + i] = A[0]
        M[3 * WIDTH + i], M[4 * WIDTH + i], M[5 * WIDTH + i] = A[1]
        M[6 * WIDTH + i], M[7 * WIDTH + i], M[8 * WIDTH + i] = A[2]


@inline
def _keep(a: FloatArray, i: int, weight: float, moment: Vec3, e: Vec3) -> None:
    a[i], a[WIDTH + i], a[2 * WIDTH + i] = scale(weight, moment)
    a[3 * WIDTH + i], a[4 * WIDTH + i], a[5 * WIDTH + i] = scale(weight, e)


@kernel
def cable_rows(
    S: FloatArray, M: FloatArray, t: FloatArray, c: FloatArray, weight: float, size: float, a: FloatArray, r: FloatArray
) -> None:
    """Weighted rows of a cable in every lane into a (6 WIDTH,), weighted residuals into r (WIDTH,); turns in units of 1/size."""
    base, guide, point, radius = vec(c, BASE), vec(c, GUIDE), vec(c, ATTACHMENT), c[RADIUS]
    by_size = 1.0 / size
    for i in range(WIDTH):
        arm = arm_of(M, i, point)
        s = leaving(sub(add(_place(S, i), arm), base), guide, radius)
        _keep(a, i, weight, scale(by_size, cross(arm, s.e)), s.e)
        r[i] = weight * (t[i] - (radius * s.phi + s.t))


@kernel
def swivel_rows(
    S: FloatArray, M: FloatArray, t: FloatArray, c: FloatArray, weight: float, size: float, a: FloatArray, r: FloatArray
) -> None:
    """The same of a swivel's encoder."""
    base, point, zero, by_size = vec(c, BASE), vec(c, ATTACHMENT), c[ANGLE_ZERO], 1.0 / size
    off_x, off_y = c[ECCENTRICITY] * math.cos(c[ECCENTRIC_PHASE]), c[ECCENTRICITY] * math.sin(c[ECCENTRIC_PHASE])
    e0, e1 = frame_at(c)
    for i in range(WIDTH):
        arm = arm_of(M, i, point)
        d = sub(add(_place(S, i), arm), base)
        x, y = dot(d, e0), dot(d, e1)
        across = 1.0 / (x * x + y * y)
        root = math.sqrt(across)
        # sine and cosine of the angle less the phase of the eccentricity, times this
        sine, cosine = root * (y * off_x - x * off_y), root * (x * off_x + y * off_y)
        e = scale((1.0 + cosine) * across, sub(scale(x, e1), scale(y, e0)))
        _keep(a, i, weight, scale(by_size, cross(arm, e)), e)
        away = t[i] - (angle(y, x) + sine - zero)
        r[i] = weight * (away - TURN * math.floor(away / TURN + 0.5))


@kernel
def inclination_rows(M: FloatArray, t: FloatArray, c: FloatArray, weight: float, size: float, a: FloatArray, r: FloatArray) -> None:
    """The same of an axis of an inclinometer."""
    up, point, zero, by_size = vec(c, BASE), vec(c, ATTACHMENT), c[ANGLE_ZERO], 1.0 / size
    for i in range(WIDTH):
        axis = arm_of(M, i, point)
        across = cross(axis, up)
        level = norm(across)
        _keep(a, i, weight, scale(by_size / level, across), (0.0, 0.0, 0.0))
        # within a quarter of a turn
        lean = angle(dot(axis, up), level)
        away = t[i] - (lean - (TURN if lean > math.pi else 0.0) - zero)
        r[i] = weight * (away - TURN * math.floor(away / TURN + 0.5))


@kernel
def other_rows(S: FloatArray, t: FloatArray, c: FloatArray, weight: float, size: float, a: FloatArray, r: FloatArray) -> None:
    """The same of a channel of any other kind, lane by lane."""
    pose = np.empty(POSE_COLUMNS)
    by_size = 1.0 / size
    for i in range(WIDTH):
        pose[PLACE], pose[PLACE + 1], pose[PLACE + 2] = _place(S, i)
        pose[ORIENTATION], pose[ORIENTATION + 1], pose[ORIENTATION + 2], pose[ORIENTATION + 3] = _orientation(S, i)
        value, moment, e = seen_at(c, pose)
        _keep(a, i, weight, scale(by_size, moment), e)
        r[i] = weight * way_round(t[i] - value, c[KIND])
