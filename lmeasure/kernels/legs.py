"""Poses of platforms whose legs' lower ends stand still: six equations, each of a distance or of a plane, closed by Newton's method."""

import math

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.kernels import inline, kernel
from lmeasure.kernels.screw import MAX_ITERATIONS, NOT_CONVERGED, OK, SINGULAR, TOLERANCE_MM, displace, eliminate
from lmeasure.kernels.vector import add, cross, dot, norm, orientation, rotate, scale, sub, vec

EQUATIONS, UNKNOWNS = 6, 9
FLOOR_MM = 1e-9  # residuals below it that no longer fall are rounding


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
    """Rows (arm x d / size ; d) into J and what is lacking into r; the largest of that, by its size."""
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


@kernel
def placed(
    points: FloatArray, ends: FloatArray, lengths: FloatArray, normals: FloatArray, starts: FloatArray
) -> tuple[IntArray, FloatArray]:
    """Status (n,) and poses (n, 7) from starts (n, 7) of platforms with points a (6, 3), one for each equation: |a - c| = length, or
    where a normal is not nothing, normal . (a - c) = length; ends c (n, 6, 3), lengths (n, 6) [mm], normals (n, 6, 3)."""
    poses, status = starts.copy(), np.empty(len(starts), np.int64)
    J, r = np.empty((EQUATIONS, EQUATIONS)), np.empty((EQUATIONS, 1))
    size = 1e-3
    for j in range(EQUATIONS):
        size = max(size, norm(vec(points[j], 0)))
    for i in range(len(starts)):
        status[i], previous = NOT_CONVERGED, math.inf
        for _ in range(MAX_ITERATIONS):
            worst = _fill(points, ends[i], lengths[i], normals[i], poses[i], J, r[:, 0], size)
            if worst <= TOLERANCE_MM or (worst < FLOOR_MM and worst >= 0.5 * previous):
                status[i] = OK
                break
            if not worst < 1e9:
                break
            previous = worst
            if eliminate(J, r) == 0.0:
                status[i] = SINGULAR
                break
            displace(poses[i], r[:, 0], size)
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
