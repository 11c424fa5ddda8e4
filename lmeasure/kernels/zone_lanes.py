"""Scan of an accuracy zone, `LANES` places of the tool origin at a time: the same figures as `kernels.zone.scan`, ten times as fast.

How it becomes fast
-------------------
All lanes share an orientation, so the arms of the attachment points are constants of the inner loops. Each stage is one loop over the
lanes without a branch, which the compiler turns into vector instructions; intermediate rows stay in a small buffer of the first-level
cache. The 6x6 rows are inverted by two 3x3 blocks whose inverses are cross products: with the rows [E1 M1; E2 M2] (v; w) = dl,
G = E2 E1^-1 and the Schur complement S = M2 - G M1,

    w = S^-1 (dl2 - G dl1),    v = E1^-1 (dl1 - M1 w).

Without pivots this needs three first cables whose directions are far from coplanar; the caller chooses them (`accuracy.scan.block_order`).
Places where their determinant falls below `WEAK_BLOCK`, or where a figure is not finite, are marked for the pivoted scalar kernel.

Each stage is inlined, so that the compiler sees its rows as constants and vectorises it. Only + - * / and square roots are used, in a fixed
order and without contraction (`strict_kernel`), so that every processor gives the same bits.
"""

import math

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.kernels import inline, strict_kernel
from lmeasure.kernels.clearance import span_clearance
from lmeasure.kernels.gaussian import radius_95
from lmeasure.kernels.layout import BASE, BODY_LENGTH, BODY_OF_TOOL, BODY_RADIUS, GUIDE, RADIUS
from lmeasure.kernels.vector import Vec3, add, cross, dot, scale, sub
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
from lmeasure.kernels.zone_linked import LENGTH, Linked, add_shift, shifts
from lmeasure.kernels.zone_rows import (
    LANES,
    MOVE,
    PLACE,
    POINT,
    ROWS,
    SPAN_ROWS,
    TOTAL,
    TURN,
    WEAK,
    WORST,
    angle,
    at,
    least,
    most,
    put,
    vec,
)

WEAK_BLOCK = 1e-3


@inline
def _spans(
    B: FloatArray, S: FloatArray, offset: Vec3, u: Vec3, radius: float
) -> None:  # fmt: skip
    """Direction and straight part of a cable's free span into S; extremes of its length and wrap. offset = arm - base point."""
    for lane in range(LANES):
        d = add(at(B, PLACE, lane), offset)
        q = dot(d, u)
        n = sub(d, scale(q, u))
        p = math.sqrt(dot(n, n))
        x = p - radius
        square = x * x + q * q
        t = math.sqrt(square - radius * radius)
        sine, cosine = q * radius + x * t, q * t - x * radius
        phi, k = angle(sine, cosine, p * square)
        put(S, 0, lane, add(scale(sine * k, n), scale(cosine * p * k, u)))
        S[3 * LANES + lane] = t
        length = radius * phi + t
        least(B, WORST + SHORTEST, lane, length)
        most(B, WORST + LONGEST, lane, length)
        most(B, WORST + WRAP, lane, phi)


@inline
def _twists(
    B: FloatArray, S: FloatArray, a0: Vec3, a1: Vec3, a2: Vec3, a3: Vec3, a4: Vec3, a5: Vec3,
    size: float,
) -> None:  # fmt: skip
    """Unit-rate twists of the six cables from their spans and arms, and what the determinants tell.

    low, high: extremes of the determinant with moments divided by size; away: least 1/|J^-1| (Frobenius), J likewise divided; weak:
    least absolute determinant of the first block.
    """
    for lane in range(LANES):
        e0, e1, e2 = at(S, 0, lane), at(S, 4, lane), at(S, 8, lane)
        e3, e4, e5 = at(S, 12, lane), at(S, 16, lane), at(S, 20, lane)
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
        put(B, TURN, lane, w0)
        put(B, TURN + 3, lane, w1)
        put(B, TURN + 6, lane, w2)
        put(B, TURN + 9, lane, w3)
        put(B, TURN + 12, lane, w4)
        put(B, TURN + 15, lane, w5)
        put(B, MOVE, lane, v0)
        put(B, MOVE + 3, lane, v1)
        put(B, MOVE + 6, lane, v2)
        put(B, MOVE + 9, lane, v3)
        put(B, MOVE + 12, lane, v4)
        put(B, MOVE + 15, lane, v5)
        det = block * schur / (size * size * size)
        least(B, WORST + DET_LOW, lane, det)
        most(B, WORST + DET_HIGH, lane, det)
        least(B, WEAK, lane, abs(block))
        turns = dot(w0, w0) + dot(w1, w1) + dot(w2, w2) + dot(w3, w3) + dot(w4, w4) + dot(w5, w5)
        moves = dot(v0, v0) + dot(v1, v1) + dot(v2, v2) + dot(v3, v3) + dot(v4, v4) + dot(v5, v5)
        most(B, WORST + NORM2, lane, turns * (size * size) + moves)


@inline
def _move(x: Vec3, y: Vec3, z: Vec3, m0: Vec3, m1: Vec3, m2: Vec3, w: Vec3, unit: Vec3) -> Vec3:
    """v = E1^-1 (unit - M1 w), with x, y, z the columns of E1^-1."""
    return add(add(scale(unit[0] - dot(m0, w), x), scale(unit[1] - dot(m1, w), y)), scale(unit[2] - dot(m2, w), z))


@inline
def _fastest(B: FloatArray, a0: Vec3, a1: Vec3, a2: Vec3, a3: Vec3, a4: Vec3, a5: Vec3) -> None:
    """Largest squared speed of an attachment point when only its own cable changes."""
    for lane in range(LANES):
        s0, s1, s2 = _speed(B, 0, lane, a0), _speed(B, 3, lane, a1), _speed(B, 6, lane, a2)
        s3, s4, s5 = _speed(B, 9, lane, a3), _speed(B, 12, lane, a4), _speed(B, 15, lane, a5)
        s0 = s0 if s0 > s1 else s1
        s2 = s2 if s2 > s3 else s3
        s4 = s4 if s4 > s5 else s5
        s0 = s0 if s0 > s2 else s2
        most(B, WORST + SPEED2, lane, s0 if s0 > s4 else s4)


@inline
def _speed(B: FloatArray, row: int, lane: int, arm: Vec3) -> float:
    v = add(at(B, MOVE + row, lane), cross(at(B, TURN + row, lane), arm))
    return dot(v, v)


@inline
def _at_point(B: FloatArray, arm: Vec3) -> None:
    """Velocities of an attachment point for unit rates of the six cables, into the POINT rows."""
    for lane in range(LANES):
        for row in range(0, 18, 3):
            put(B, POINT + row, lane, add(at(B, MOVE + row, lane), cross(at(B, TURN + row, lane), arm)))


@inline
def _radius(B: FloatArray, row: int, sigma: FloatArray, worst: int, C: FloatArray, D: FloatArray | None) -> None:
    """Largest 95 % radius of sum_j sigma_j^2 c_j c_j^T for the six columns c_j at `row`, and of the (r, 6, LANES) shifts D of the lengths
    besides; total keeps what is not finite. C (6 LANES,) is scratch."""
    s0, s1, s2, s3, s4, s5 = sigma[0], sigma[1], sigma[2], sigma[3], sigma[4], sigma[5]
    if D is not None:
        for i in range(6 * LANES):
            C[i] = 0.0
        for first in range(0, len(D), 6 * LANES):
            add_shift(B, row, C, D[first:])
    for lane in range(LANES):
        c0, c1, c2 = scale(s0, at(B, row, lane)), scale(s1, at(B, row + 3, lane)), scale(s2, at(B, row + 6, lane))
        c3, c4, c5 = scale(s3, at(B, row + 9, lane)), scale(s4, at(B, row + 12, lane)), scale(s5, at(B, row + 15, lane))
        xx = c0[0] * c0[0] + c1[0] * c1[0] + c2[0] * c2[0] + c3[0] * c3[0] + c4[0] * c4[0] + c5[0] * c5[0]
        yy = c0[1] * c0[1] + c1[1] * c1[1] + c2[1] * c2[1] + c3[1] * c3[1] + c4[1] * c4[1] + c5[1] * c5[1]
        zz = c0[2] * c0[2] + c1[2] * c1[2] + c2[2] * c2[2] + c3[2] * c3[2] + c4[2] * c4[2] + c5[2] * c5[2]
        xy = c0[0] * c0[1] + c1[0] * c1[1] + c2[0] * c2[1] + c3[0] * c3[1] + c4[0] * c4[1] + c5[0] * c5[1]
        xz = c0[0] * c0[2] + c1[0] * c1[2] + c2[0] * c2[2] + c3[0] * c3[2] + c4[0] * c4[2] + c5[0] * c5[2]
        yz = c0[1] * c0[2] + c1[1] * c1[2] + c2[1] * c2[2] + c3[1] * c3[2] + c4[1] * c4[2] + c5[1] * c5[2]
        if D is not None:
            xx, yy, zz = xx + C[lane], yy + C[LANES + lane], zz + C[2 * LANES + lane]
            xy, xz, yz = xy + C[3 * LANES + lane], xz + C[4 * LANES + lane], yz + C[5 * LANES + lane]
        r = radius_95(xx, yy, zz, xy, xz, yz)
        most(B, worst, lane, r)
        B[TOTAL * LANES + lane] += r


@inline
def _between(B: FloatArray, S: FloatArray, T: FloatArray, d: Vec3) -> None:
    """Least distance between the free spans of two cables whose attachment points are d apart."""
    for lane in range(LANES):
        gap = span_clearance(d, at(S, 0, lane), S[3 * LANES + lane], at(T, 0, lane), T[3 * LANES + lane], 0.0)
        least(B, WORST + CLEARANCE, lane, gap)


@inline
def _to_body(B: FloatArray, S: FloatArray, d: Vec3, moves: float, way: Vec3, length: float, radius: float) -> None:
    """Least distance of a free span from a body's surface; d from the body's start to the attachment point, less the tool's place when
    the body stands in the base frame (moves 1)."""
    for lane in range(LANES):
        gap = span_clearance(add(d, scale(moves, at(B, PLACE, lane))), at(S, 0, lane), S[3 * LANES + lane], way, length, radius)
        least(B, WORST + CLEARANCE, lane, gap)


@strict_kernel
def scan_lanes(
    cables: FloatArray,
    positions: FloatArray,
    arms: FloatArray,
    points: FloatArray,
    body_starts: FloatArray,
    body_ways: FloatArray,
    bodies: FloatArray,
    pairs: IntArray,
    sigma: FloatArray,
    size: float,
    linked: Linked | None,
    turns: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """(F, n) figures of `kernels.zone.FIGURES` at (n, 3) positions, n a multiple of LANES, and (n,) places left to the scalar kernel.

    cables (6, 17), the first three being the block that is inverted first (the determinant's sign is that of this order); over k
    orientations, all turned into the base frame: arms (k, 6, 3) of the attachment points, points (k, p, 3) whose uncertainty is asked
    (p = 0: neither theirs nor the rotation's), body_starts and body_ways (k, b, 3); bodies (b, 9) and pairs (c, 2) as in
    `kernels.zone.scan`; sigma (6,) standard uncertainties of the lengths [mm]; size [mm] divides the moments.
    linked: of the rig parameters' covariance (`kernels.zone.scan`) the factor (6 WIDTH, r), derivatives (6, WIDTH) and lengths (6,) at the
    zero pose, decoding factors (6,), derivatives (6, 6) of the guides by alpha and beta; None where there is none, which is compiled apart.
    turns (k, 3, 3) base_from_tool.
    """
    C, D = np.empty(6 * LANES), None
    if linked is not None:
        used = np.array([np.any(row != 0.0) for row in linked[0]])
        D, H = np.empty(linked[0].shape[1] * 6 * LANES), np.empty((LENGTH + 1) * LANES)
    n = positions.shape[0]
    out, left = np.empty((len(WORST_START), n)), np.empty(n, np.bool_)
    B, S = np.empty(ROWS * LANES), np.empty(6 * SPAN_ROWS * LANES)
    for first in range(0, n, LANES):
        for lane in range(LANES):
            put(B, PLACE, lane, vec(positions[first + lane], 0))
            for f in range(len(WORST_START)):
                B[(WORST + f) * LANES + lane] = WORST_START[f]
            B[WEAK * LANES + lane], B[TOTAL * LANES + lane] = math.inf, 0.0
        for o in range(arms.shape[0]):
            a = arms[o]
            a0, a1, a2, a3, a4, a5 = vec(a[0], 0), vec(a[1], 0), vec(a[2], 0), vec(a[3], 0), vec(a[4], 0), vec(a[5], 0)
            for j in range(6):
                offset = sub(vec(a[j], 0), vec(cables[j], BASE))
                _spans(B, S[j * SPAN_ROWS * LANES :], offset, vec(cables[j], GUIDE), cables[j, RADIUS])
            _twists(B, S, a0, a1, a2, a3, a4, a5, size)
            _fastest(B, a0, a1, a2, a3, a4, a5)
            if linked is not None:
                shifts(D, H, B, S, a, cables, linked, used, turns[o])
            _radius(B, MOVE, sigma, WORST + U95_POSITION, C, D)
            if points.shape[1] > 0:
                _radius(B, TURN, sigma, WORST + U95_ROTATION, C, D)
                for k in range(points.shape[1]):
                    _at_point(B, vec(points[o, k], 0))
                    _radius(B, POINT, sigma, WORST + U95_ATTACHMENT, C, D)
            for k in range(pairs.shape[0]):
                i, j = pairs[k]
                apart = sub(vec(a[i], 0), vec(a[j], 0))
                _between(B, S[i * SPAN_ROWS * LANES :], S[j * SPAN_ROWS * LANES :], apart)
            for k in range(bodies.shape[0]):
                back = scale(-1.0, vec(body_ways[o, k], 0))
                moves = 0.0 if bodies[k, BODY_OF_TOOL] > 0.0 else 1.0
                for j in range(6):
                    d = sub(vec(a[j], 0), vec(body_starts[o, k], 0))
                    _to_body(B, S[j * SPAN_ROWS * LANES :], d, moves, back, bodies[k, BODY_LENGTH], bodies[k, BODY_RADIUS])
        for lane in range(LANES):
            for f in range(len(WORST_START)):
                out[f, first + lane] = B[(WORST + f) * LANES + lane]
            left[first + lane] = not (B[WEAK * LANES + lane] >= WEAK_BLOCK and math.isfinite(B[TOTAL * LANES + lane]))
    return out, left
