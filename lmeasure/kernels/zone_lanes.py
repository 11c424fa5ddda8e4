"""Scan of an accuracy zone, `LANES` places of the tool origin at a time: the same figures as `kernels.zone.scan`, ten times as fast.

How it becomes fast
-------------------
All lanes share an orientation, so the arms of the attachment points are constants of the inner loops. Each stage is one loop over the
lanes without a branch, which the compiler turns into vector instructions; intermediate rows stay in small buffers of the first-level
cache. The effect of a unit of each length on the pose is computed without pivots: of six cables by `inverse_twists`, of more by
`zone_redundant`. Places
where that is not sound, or where a figure is not finite, are marked for the pivoted scalar kernel.

Each stage is inlined, so that the compiler sees its rows as constants and vectorises it. Only + - * / and square roots are used, in a fixed
order and without contraction (`slow_to_compile`), so that every processor gives the same bits.

Effect of a unit of each of six lengths on the pose, LANES places at a time: the rows inverted by blocks.

The 6x6 rows are inverted by two 3x3 blocks whose inverses are cross products: with the rows [E1 M1; E2 M2] (v; w) = dl,
G = E2 E1^-1 and the Schur complement S = M2 - G M1,

    w = S^-1 (dl2 - G dl1),    v = E1^-1 (dl1 - M1 w).

Without pivots this needs three first cables whose directions are far from coplanar; the caller chooses them (`accuracy.scan.block_order`).
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
from lmeasure.kernels.zone import (
    CLEARANCE,
    DET_HIGH,
    DET_LOW,
    LONGEST,
    NORM2,
    SHORTEST,
    SPEED2,
    U95_ATTACHMENT,
    U95_POSITION,
    U95_ROTATION,
    WORST_START,
    WRAP,
)
from lmeasure.kernels.zone_linked import GRADIENT_ROWS, LENGTH, Linked, length_covariance
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


@inline
def inverse_twists(B: FloatArray, S: FloatArray, arms: FloatArray, size: float) -> None:
    """Twists per unit of each length into S, from their spans and arms (6, 3), and results from the determinants: extremes of that with
    moments divided by size, and the least absolute one of the first block, which shows whether the inverse is sound."""
    a0, a1, a2, a3, a4, a5 = vec(arms[0], 0), vec(arms[1], 0), vec(arms[2], 0), vec(arms[3], 0), vec(arms[4], 0), vec(arms[5], 0)
    for lane in range(LANES):
        e0, e1, e2 = at(S, SPAN, lane), at(S, CABLE_ROWS + SPAN, lane), at(S, 2 * CABLE_ROWS + SPAN, lane)
        e3, e4, e5 = at(S, 3 * CABLE_ROWS + SPAN, lane), at(S, 4 * CABLE_ROWS + SPAN, lane), at(S, 5 * CABLE_ROWS + SPAN, lane)
        m0, m1, m2 = cross(a0, e0), cross(a1, e1), cross(a2, e2)
        # columns of E1^-1, times the determinant
        x, y, z = cross(e1, e2), cross(e2, e0), cross(e0, e1)
        block = dot(e0, x)
        k = 1.0 / block
        x, y, z = scale(k, x), scale(k, y), scale(k, z)
        g0 = (dot(e3, x), dot(e3, y), dot(e3, z))
        g1 = (dot(e4, x), dot(e4, y), dot(e4, z))
        g2 = (dot(e5, x), dot(e5, y), dot(e5, z))
        s0 = sub(cross(a3, e3), add(add(scale(g0[0], m0), scale(g0[1], m1)), scale(g0[2], m2)))
        s1 = sub(cross(a4, e4), add(add(scale(g1[0], m0), scale(g1[1], m1)), scale(g1[2], m2)))
        s2 = sub(cross(a5, e5), add(add(scale(g2[0], m0), scale(g2[1], m1)), scale(g2[2], m2)))
        w3, w4, w5 = cross(s1, s2), cross(s2, s0), cross(s0, s1)
        schur = dot(s0, w3)
        k = 1.0 / schur
        w3, w4, w5 = scale(k, w3), scale(k, w4), scale(k, w5)
        w0 = scale(-1.0, add(add(scale(g0[0], w3), scale(g1[0], w4)), scale(g2[0], w5)))
        w1 = scale(-1.0, add(add(scale(g0[1], w3), scale(g1[1], w4)), scale(g2[1], w5)))
        w2 = scale(-1.0, add(add(scale(g0[2], w3), scale(g1[2], w4)), scale(g2[2], w5)))
        v0 = _move(x, y, z, m0, m1, m2, w0, (1.0, 0.0, 0.0))
        v1 = _move(x, y, z, m0, m1, m2, w1, (0.0, 1.0, 0.0))
        v2 = _move(x, y, z, m0, m1, m2, w2, (0.0, 0.0, 1.0))
        v3 = _move(x, y, z, m0, m1, m2, w3, (0.0, 0.0, 0.0))
        v4 = _move(x, y, z, m0, m1, m2, w4, (0.0, 0.0, 0.0))
        v5 = _move(x, y, z, m0, m1, m2, w5, (0.0, 0.0, 0.0))
        _keep(S, 0, lane, w0, v0)
        _keep(S, 1, lane, w1, v1)
        _keep(S, 2, lane, w2, v2)
        _keep(S, 3, lane, w3, v3)
        _keep(S, 4, lane, w4, v4)
        _keep(S, 5, lane, w5, v5)
        det = block * schur / (size * size * size)
        least(B, WORST + DET_LOW, lane, det)
        most(B, WORST + DET_HIGH, lane, det)
        least(B, SOUND, lane, abs(block))
        turns = dot(w0, w0) + dot(w1, w1) + dot(w2, w2) + dot(w3, w3) + dot(w4, w4) + dot(w5, w5)
        moves = dot(v0, v0) + dot(v1, v1) + dot(v2, v2) + dot(v3, v3) + dot(v4, v4) + dot(v5, v5)
        most(B, WORST + NORM2, lane, turns * (size * size) + moves)


@inline
def _move(x: Vec3, y: Vec3, z: Vec3, m0: Vec3, m1: Vec3, m2: Vec3, w: Vec3, unit: Vec3) -> Vec3:
    """v = E1^-1 (unit - M1 w), with x, y, z the columns of E1^-1."""
    return add(add(scale(unit[0] - dot(m0, w), x), scale(unit[1] - dot(m1, w), y)), scale(unit[2] - dot(m2, w), z))


@inline
def _keep(S: FloatArray, cable: int, lane: int, w: Vec3, v: Vec3) -> None:
    put(S, cable * CABLE_ROWS + TURN, lane, w)
    put(S, cable * CABLE_ROWS + MOVE, lane, v)


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
def _add_scaled(Y: FloatArray, S: FloatArray, row: int, L: FloatArray, more: bool) -> None:
    """Add l c for a cable's column c at `row` and the covariance l with another one to Y, which begins at nothing unless there are more."""
    for lane in range(LANES):
        before = at(Y, 0, lane) if more else NOTHING
        put(Y, 0, lane, add(before, scale(L[lane], at(S, row, lane))))


@inline
def _add_symmetric(B: FloatArray, S: FloatArray, row: int, L: FloatArray, Y: FloatArray, more: bool) -> None:
    """Add c y^T + y c^T to the covariance for the cable's column c at `row`: y is half its variance l times c, and Y if there is more."""
    for lane in range(LANES):
        c, before = at(S, row, lane), at(Y, 0, lane) if more else NOTHING
        y = add(before, scale(0.5 * L[lane], c))
        put(B, COVARIANCE, lane, add(at(B, COVARIANCE, lane), (2.0 * c[0] * y[0], 2.0 * c[1] * y[1], 2.0 * c[2] * y[2])))
        mixed = (c[0] * y[1] + c[1] * y[0], c[0] * y[2] + c[2] * y[0], c[1] * y[2] + c[2] * y[1])
        put(B, COVARIANCE + 3, lane, add(at(B, COVARIANCE + 3, lane), mixed))


@inline
def _radius(B: FloatArray, S: FloatArray, m: int, row: int, variance: FloatArray, L: FloatArray, linked: Linked | None, worst: int) -> None:
    """Largest 95 % radius from the lengths' covariance by the columns c_j at `row`: of their variances alone, or, linked, of L,
    its lower triangle row by row, LANES each, and three rows of scratch; total keeps what is not finite."""
    for lane in range(LANES):
        put(B, COVARIANCE, lane, NOTHING)
        put(B, COVARIANCE + 3, lane, NOTHING)
    if linked is None:
        for j in range(m):
            _add_square(B, S[j * CABLE_ROWS * LANES :], row, variance[j])
    else:
        Y = L[m * (m + 1) // 2 * LANES :]
        for j in range(m):
            here, first, more = S[j * CABLE_ROWS * LANES :], j * (j + 1) // 2, False
            for k in range(j):
                if linked.tied[j, k]:
                    _add_scaled(Y, S[k * CABLE_ROWS * LANES :], row, L[(first + k) * LANES :], more)
                    more = True
            _add_symmetric(B, here, row, L[(first + j) * LANES :], Y, more)
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
    """Least distance of a free span from a body's surface; d from the body's start to the attachment point, minus the tool's position if
    the body is fixed in the base frame (moves 1)."""
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
    orientations, all turned into the base frame: arms (k, m, 3) of the attachment points, points (k, p, 3) whose uncertainty is requested
    (p = 0: neither theirs nor the rotation's), body_starts and body_ways (k, b, 3); bodies (b, BODY_COLUMNS) and pairs (c, 2) as in
    `kernels.zone.scan`, and variance (m,) and weights (m,); size [mm] divides the moments. linked: of the rig parameters' covariance,
    None where there is none, which is compiled apart. turns (k, 3, 3) base_from_tool.
    """
    n, m = positions.shape[0], cables.shape[0]
    out, left = np.empty((len(WORST_START), n)), np.empty(n, np.bool_)
    B, S, N = np.empty(PLACE_ROWS * LANES), np.empty(m * CABLE_ROWS * LANES), np.empty(NORMAL_ROWS * LANES)
    L = None
    if linked is not None:
        L, H = np.empty((m * (m + 1) // 2 + 3) * LANES), np.zeros((GRADIENT_ROWS + m * LENGTH) * LANES)
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
            _radius(B, S, m, MOVE, variance, L, linked, WORST + U95_POSITION)
            if points.shape[1] > 0:
                _radius(B, S, m, TURN, variance, L, linked, WORST + U95_ROTATION)
                for k in range(points.shape[1]):
                    for j in range(m):
                        _velocity(S[j * CABLE_ROWS * LANES :], vec(points[o, k], 0))
                    _radius(B, S, m, VELOCITY, variance, L, linked, WORST + U95_ATTACHMENT)
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
