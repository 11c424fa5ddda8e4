"""Poses of platforms whose legs' lower ends are fixed: six equations, each of a distance or of a plane, closed by Newton's method."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.layout import ORIENTATION, POSE_COLUMNS
from lmeasure.kernels.screw import MAX_ITERATIONS, NOT_CONVERGED, OK, SINGULAR, TOLERANCE_MM, copy, displace, eliminate
from lmeasure.kernels.vector import add, cross, dot, norm, orientation, rotate, scale, sub, vec

EQUATIONS, UNKNOWNS = 6, 9
FLOOR_MM = 1e-9  # residuals below it that no longer fall are rounding
ON_THE_WAY = 1e-3  # of the platform's size: residual with which a part of a way that is not the last is left behind


@inline
def _fill(
    points: FloatArray,
    ends: FloatArray,
    lengths: FloatArray,
    normals: FloatArray,
    pose: FloatArray,
    J: FloatArray,
    r: FloatArray,
    size: float,
) -> float:
    """Rows (arm x d / size ; d) into J and the residuals into r; return the largest residual, divided by its size."""
    turn, place, worst = orientation(pose), vec(pose, 0), 0.0
    for j in range(EQUATIONS):
        arm = rotate(turn, vec(points[j], 0))
        away = sub(add(place, arm), vec(ends[j], 0))
        d = vec(normals[j], 0)
        if d[0] == 0.0 and d[1] == 0.0 and d[2] == 0.0:
            far = norm(away)
            d = scale(1.0 / far, away)
        else:
            far = dot(d, away)
        moment = cross(arm, d)
        for c in range(3):
            J[j, c] = moment[c] / size
            J[j, 3 + c] = d[c]
        r[j] = lengths[j] - far
        # written so that NaN is the worst of all
        if not abs(r[j]) <= worst:
            worst = abs(r[j])
    return worst


@inline
def _close(
    points: FloatArray,
    ends: FloatArray,
    lengths: FloatArray,
    normals: FloatArray,
    tolerance: float,
    pose: FloatArray,
    J: FloatArray,
    r: FloatArray,
    size: float,
) -> int:
    """Move the pose (in place) until no residual exceeds the tolerance; return the status. When OK, J holds the rows there."""
    previous = math.inf
    for _ in range(MAX_ITERATIONS):
        worst = _fill(points, ends, lengths, normals, pose, J, r[:, 0], size)
        if worst <= tolerance or (worst < FLOOR_MM and worst >= 0.5 * previous):
            return OK
        if not worst < 1e9:
            break
        previous = worst
        if eliminate(J, r) == 0.0:
            return SINGULAR
        displace(pose, r[:, 0], size)
    return NOT_CONVERGED


@inline
def _size(points: FloatArray) -> float:
    """Return the motion per radian [mm]: the largest distance of a point from the platform's origin."""
    size = 1e-3
    for j in range(EQUATIONS):
        size = max(size, norm(vec(points[j], 0)))
    return size


@kernel
def placed(
    points: FloatArray, ends: FloatArray, lengths: FloatArray, normals: FloatArray, starts: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Status (n,) and poses (n, 7) from starts (n, 7) of platforms with points a (6, 3), one for each equation: |a - c| = length, or
    where a normal is not nothing, normal . (a - c) = length; ends c (n, 6, 3), lengths (n, 6) [mm], normals (n, 6, 3)."""
    poses, status = starts.copy(), np.empty(len(starts), np.int64)
    J, r, size = np.empty((EQUATIONS, EQUATIONS)), np.empty((EQUATIONS, 1)), _size(points)
    for i in range(len(starts)):
        status[i] = _close(points, ends[i], lengths[i], normals[i], TOLERANCE_MM, poses[i], J, r, size)
    return status, poses


@kernel
def driven(
    points: FloatArray, ends: FloatArray, lengths: FloatArray, normals: FloatArray, first: IntArray, home: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Status (n,) and poses (n, 7) at the ends of n ways that platforms of `placed` are driven from home (7,): the equations' row 0 is
    that of home, rows first[i] to first[i + 1] (n + 1,) are those of way i.

    Newton's method begins every part straight ahead of the two before. SINGULAR where the rows' determinant has another sign than at
    home: behind a singular pose the nearest other assembly lies.
    """
    n = len(first) - 1
    poses, status = np.empty((n, POSE_COLUMNS)), np.empty(n, np.int64)
    J, r, size = np.empty((EQUATIONS, EQUATIONS)), np.empty((EQUATIONS, 1)), _size(points)
    begin, before = home.copy(), np.empty(POSE_COLUMNS)
    at_home = _close(points, ends[0], lengths[0], normals[0], TOLERANCE_MM, begin, J, r, size)
    side = eliminate(J, r)
    for i in range(n):
        pose = poses[i]
        copy(begin, pose)
        copy(begin, before)
        status[i] = at_home
        for k in range(first[i], first[i + 1]):
            if status[i] != OK:
                break
            square = 0.0
            for c in range(POSE_COLUMNS):
                on = 2.0 * pose[c] - before[c]
                before[c] = pose[c]
                pose[c] = on
                if c >= ORIENTATION:
                    square += on * on
            for c in range(ORIENTATION, POSE_COLUMNS):
                pose[c] /= math.sqrt(square)
            tolerance = TOLERANCE_MM if k + 1 == first[i + 1] else ON_THE_WAY * size
            status[i] = _close(points, ends[k], lengths[k], normals[k], tolerance, pose, J, r, size)
            if status[i] == OK and not eliminate(J, r) * side > 0.0:
                status[i] = SINGULAR
    return status, poses


@kernel
def triangles(start: FloatArray, corners: FloatArray, part: float, ends: FloatArray, rods: FloatArray) -> tuple[IntArray, FloatArray]:
    """Status (n,) and corners (n, 9) of equilateral triangles of side one, from a start (9,), whose points w_i + part (w_j - w_i), with
    i, j of corners (6, 2), are as far from ends (n, 6, 3) as rods (6,) are long: nine quadratic equations."""
    found, status = np.empty((len(ends), UNKNOWNS)), np.empty(len(ends), np.int64)
    J, r = np.empty((UNKNOWNS, UNKNOWNS)), np.empty((UNKNOWNS, 1))
    for n in range(len(ends)):
        w = found[n]
        for c in range(UNKNOWNS):
            w[c] = start[c]
        status[n], previous = NOT_CONVERGED, math.inf
        for _ in range(MAX_ITERATIONS):
            worst = 0.0
            J[:, :] = 0.0
            for k in range(UNKNOWNS):
                if k < 3:
                    i, j, by_i, by_j, wanted = k, (k + 1) % 3, 1.0, -1.0, 1.0
                else:
                    i, j, by_i, by_j, wanted = corners[k - 3, 0], corners[k - 3, 1], 1.0 - part, part, rods[k - 3]
                square = 0.0
                for c in range(3):
                    v = by_i * w[3 * i + c] + by_j * w[3 * j + c]
                    if k >= 3:
                        v -= ends[n, k - 3, c]
                    square += v * v
                    J[k, 3 * i + c] = 2.0 * by_i * v
                    J[k, 3 * j + c] = 2.0 * by_j * v
                r[k, 0] = wanted * wanted - square
                if not abs(r[k, 0]) <= worst:
                    worst = abs(r[k, 0])
            if worst <= 1e-15 or (worst < 1e-12 and worst >= 0.5 * previous):
                status[n] = OK
                break
            if not worst < 1e6:
                break
            previous = worst
            if eliminate(J, r) == 0.0:
                status[n] = SINGULAR
                break
            for c in range(UNKNOWNS):
                w[c] += r[c, 0]
    return status, found
