"""Scan of an accuracy zone, `LANES` places of the tool origin at a time: the same figures as `kernels.zone.scan`, ten times as fast.

How it becomes fast
-------------------
All lanes share an orientation, so the arms of the attachment points are constants of the inner loops. Each stage is one loop over the
lanes without a branch, which the compiler turns into vector instructions; intermediate rows stay in small buffers of the first-level
cache. What a unit of each length does to the pose comes without pivots: of six cables by `zone_six`, of more by `zone_redundant`. Places
where that is not sound, or where a figure is not finite, are marked for the pivoted scalar kernel.

Each stage is inlined, so that the compiler sees its rows as constants and vectorises it. Only + - * / and square roots are used, in a fixed
order and without contraction (`slow_to_compile`), so that every processor gives the same bits.
"""

import math

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels.cable import leaving
from lmeasure.kernels.clearance import span_clearance
from lmeasure.kernels.decorators import inline, slow_to_compile
from lmeasure.kernels.gaussian import radius_95
from lmeasure.kernels.layout import BASE, BODY_LENGTH, BODY_OF_TOOL, BODY_RADIUS, GUIDE, RADIUS
from lmeasure.kernels.vector import Vec3, add, cross, dot, scale, sub, vec
from lmeasure.kernels.zone import CLEARANCE, LONGEST, SHORTEST, SPEED2, U95_ATTACHMENT, U95_POSITION, U95_ROTATION, WORST_START, WRAP
from lmeasure.kernels.zone_linked import GRADIENT_ROWS, Linked, length_covariance
from lmeasure.kernels.zone_redundant import NORMAL_ROWS, least_squares_twists
from lmeasure.kernels.zone_rows import (  # fmt: skip
    CABLE_ROWS,
    COVARIANCE,
    LANES,
    MOVE,
    PLACE,
    PLACE_ROWS,
    SOUND,
    SPAN,
    STRAIGHT,
    TOTAL,
    TURN,
    VELOCITY,
    WORST,
    at,
    least,
    most,
    put,
)
from lmeasure.kernels.zone_six import inverse_twists

LEAST_SOUND = 1e-3
NOTHING = (0.0, 0.0, 0.0)


@inline
def _spans(B: FloatArray, S: FloatArray, offset: Vec3, u: Vec3, radius: float) -> None:
    """Direction and straight part of a cable's free span into S; extremes of its length and wrap. offset = arm - base point."""
    for lane in range(LANES):
        s = leaving(add(at(B, PLACE, lane), offset), u, radius)
        put(S, SPAN, lane, s.e)
        S[STRAIGHT * LANES + lane] = s.t
        length = radius * s.phi + s.t
        least(B, WORST + SHORTEST, lane, length)
        most(B, WORST + LONGEST, lane, length)
        most(B, WORST + WRAP, lane, s.phi)


@inline
def _speed(B: FloatArray, S: FloatArray, arm: Vec3) -> None:
    """Largest squared speed of an attachment point when only its own cable changes."""
    for lane in range(LANES):
        v = add(at(S, MOVE, lane), cross(at(S, TURN, lane), arm))
        most(B, WORST + SPEED2, lane, dot(v, v))


@inline
def _velocity(S: FloatArray, arm: Vec3) -> None:
    """Velocity of the body point at the arm by a unit rate of the cable, into the VELOCITY rows."""
    for lane in range(LANES):
        put(S, VELOCITY, lane, add(at(S, MOVE, lane), cross(at(S, TURN, lane), arm)))


@inline
def _add_square(B: FloatArray, S: FloatArray, row: int, variance: float) -> None:
    """Add variance c c^T for the cable's column c at `row`."""
    for lane in range(LANES):
        c = at(S, row, lane)
        s = scale(variance, c)
        put(B, COVARIANCE, lane, add(at(B, COVARIANCE, lane), (s[0] * c[0], s[1] * c[1], s[2] * c[2])))
        put(B, COVARIANCE + 3, lane, add(at(B, COVARIANCE + 3, lane), (s[0] * c[1], s[0] * c[2], s[1] * c[2])))


@inline
def _add_product(B: FloatArray, S: FloatArray, T: FloatArray, row: int, L: FloatArray, share: float) -> None:
    """Add share l (c d^T + d c^T) for two cables' columns c and d at `row` and the covariance l of their lengths."""
    for lane in range(LANES):
        c, d = scale(share * L[lane], at(S, row, lane)), at(T, row, lane)
        put(B, COVARIANCE, lane, add(at(B, COVARIANCE, lane), (2.0 * c[0] * d[0], 2.0 * c[1] * d[1], 2.0 * c[2] * d[2])))
        mixed = (c[0] * d[1] + c[1] * d[0], c[0] * d[2] + c[2] * d[0], c[1] * d[2] + c[2] * d[1])
        put(B, COVARIANCE + 3, lane, add(at(B, COVARIANCE + 3, lane), mixed))


@inline
def _radius(B: FloatArray, S: FloatArray, m: int, row: int, variance: FloatArray, L: FloatArray | None, worst: int) -> None:
    """Largest 95 % radius of what the columns c_j at `row` make of the lengths' covariance: of their variances alone, or of L, its lower
    triangle row by row, LANES each; total keeps what is not finite."""
    for lane in range(LANES):
        put(B, COVARIANCE, lane, NOTHING)
        put(B, COVARIANCE + 3, lane, NOTHING)
    if L is None:
        for j in range(m):
            _add_square(B, S[j * CABLE_ROWS * LANES :], row, variance[j])
    else:
        for j in range(m):
            first = j * (j + 1) // 2
            for k in range(j + 1):
                share = 0.5 if j == k else 1.0
                _add_product(B, S[j * CABLE_ROWS * LANES :], S[k * CABLE_ROWS * LANES :], row, L[(first + k) * LANES :], share)
    for lane in range(LANES):
        xx, yy, zz = at(B, COVARIANCE, lane)
        xy, xz, yz = at(B, COVARIANCE + 3, lane)
        r = radius_95(xx, yy, zz, xy, xz, yz)
        most(B, worst, lane, r)
        B[TOTAL * LANES + lane] += r


@inline
def _between(B: FloatArray, S: FloatArray, T: FloatArray, d: Vec3) -> None:
    """Least distance between the free spans of two cables whose attachment points are d apart."""
    for lane in range(LANES):
        gap = span_clearance(d, at(S, SPAN, lane), S[STRAIGHT * LANES + lane], at(T, SPAN, lane), T[STRAIGHT * LANES + lane], 0.0)
        least(B, WORST + CLEARANCE, lane, gap)


@inline
def _to_body(B: FloatArray, S: FloatArray, d: Vec3, moves: float, way: Vec3, length: float, radius: float) -> None:
    """Least distance of a free span from a body's surface; d from the body's start to the attachment point, less the tool's place when
    the body stands in the base frame (moves 1)."""
    for lane in range(LANES):
        away = add(d, scale(moves, at(B, PLACE, lane)))
        gap = span_clearance(away, at(S, SPAN, lane), S[STRAIGHT * LANES + lane], way, length, radius)
        least(B, WORST + CLEARANCE, lane, gap)


@slow_to_compile
def scan_lanes(
    cables: FloatArray,
    positions: FloatArray,
    arms: FloatArray,
    points: FloatArray,
    body_starts: FloatArray,
    body_ways: FloatArray,
    bodies: FloatArray,
    pairs: IntArray,
    variance: FloatArray,
    weights: FloatArray,
    size: float,
    linked: Linked | None,
    turns: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """(F, n) figures of `kernels.zone.FIGURES` at (n, 3) positions, n a multiple of LANES, and (n,) places left to the scalar kernel.

    cables (m, columns); of six the first three are the block that is inverted first (the determinant's sign is that of this order); over k
    orientations, all turned into the base frame: arms (k, m, 3) of the attachment points, points (k, p, 3) whose uncertainty is asked
    (p = 0: neither theirs nor the rotation's), body_starts and body_ways (k, b, 3); bodies (b, BODY_COLUMNS) and pairs (c, 2) as in
    `kernels.zone.scan`, and variance (m,) and weights (m,); size [mm] divides the moments. linked: of the rig parameters' covariance,
    None where there is none, which is compiled apart. turns (k, 3, 3) base_from_tool.
    """
    n, m = positions.shape[0], cables.shape[0]
    out, left = np.empty((len(WORST_START), n)), np.empty(n, np.bool_)
    B, S, N = np.empty(PLACE_ROWS * LANES), np.empty(m * CABLE_ROWS * LANES), np.empty(NORMAL_ROWS * LANES)
    L = None
    if linked is not None:
        L, H = np.empty(m * (m + 1) // 2 * LANES), np.zeros(2 * m * GRADIENT_ROWS * LANES)
    for first in range(0, n, LANES):
        for lane in range(LANES):
            put(B, PLACE, lane, (positions[first + lane, 0], positions[first + lane, 1], positions[first + lane, 2]))
            for f in range(len(WORST_START)):
                B[(WORST + f) * LANES + lane] = WORST_START[f]
            B[SOUND * LANES + lane], B[TOTAL * LANES + lane] = math.inf, 0.0
        for o in range(arms.shape[0]):
            a = arms[o]
            for j in range(m):
                offset = sub(vec(a[j], 0), vec(cables[j], BASE))
                _spans(B, S[j * CABLE_ROWS * LANES :], offset, vec(cables[j], GUIDE), cables[j, RADIUS])
            if m == 6:
                inverse_twists(B, S, a, size)
            else:
                least_squares_twists(B, S, N, a, weights, size)
            for j in range(m):
                _speed(B, S[j * CABLE_ROWS * LANES :], vec(a[j], 0))
            if linked is not None:
                length_covariance(L, H, B, S, a, cables, variance, linked, turns[o])
            _radius(B, S, m, MOVE, variance, L, WORST + U95_POSITION)
            if points.shape[1] > 0:
                _radius(B, S, m, TURN, variance, L, WORST + U95_ROTATION)
                for k in range(points.shape[1]):
                    for j in range(m):
                        _velocity(S[j * CABLE_ROWS * LANES :], vec(points[o, k], 0))
                    _radius(B, S, m, VELOCITY, variance, L, WORST + U95_ATTACHMENT)
            for k in range(pairs.shape[0]):
                i, j = pairs[k]
                apart = sub(vec(a[i], 0), vec(a[j], 0))
                _between(B, S[i * CABLE_ROWS * LANES :], S[j * CABLE_ROWS * LANES :], apart)
            for k in range(bodies.shape[0]):
                back = scale(-1.0, vec(body_ways[o, k], 0))
                moves = 0.0 if bodies[k, BODY_OF_TOOL] > 0.0 else 1.0
                for j in range(m):
                    d = sub(vec(a[j], 0), vec(body_starts[o, k], 0))
                    _to_body(B, S[j * CABLE_ROWS * LANES :], d, moves, back, bodies[k, BODY_LENGTH], bodies[k, BODY_RADIUS])
        for lane in range(LANES):
            for f in range(len(WORST_START)):
                out[f, first + lane] = B[(WORST + f) * LANES + lane]
            left[first + lane] = not (B[SOUND * LANES + lane] >= LEAST_SOUND and math.isfinite(B[TOTAL * LANES + lane]))
    return out, left
