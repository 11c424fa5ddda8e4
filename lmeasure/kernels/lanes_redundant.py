"""Poses from more channels than unknowns over many samples at once, for logs: the same as `least_squares.follow`, a multiple faster.

Coarse to fine as `lanes` goes through time, by tiles of WIDTH samples whose lanes do not branch. A lane's step is Gauss and Newton's: the
weighted rows of its channels, of any kind, make a 6x6 system N x = b, which L D L^T solves without pivots, for it is positive definite.
The last step moves a pose by less than LAST_STEP_MM: so the rows there are those of the pose itself, the residuals minus A x are its own,
and its pressure angles follow from N^-1 without the channels. A tile is only taken where that is safe: every lane
starts near, converges, stays clear of singular poses, reads the same channels, and the tile goes on where the one before ended.
Everything else goes to `least_squares.follow`, sample by sample.

Normal equations of redundant channels, WIDTH samples at once and no lane branching: N holds the upper halves of symmetric 6x6 matrices,
and behind them the right sides, a row of lanes for each component.

Rows of channels of any kind for a tile of lanes (`kernels.lanes_redundant`): how a reading changes as the pose does.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels import least_squares
from lmeasure.kernels.angles import frame_at
from lmeasure.kernels.cable import leaving, seen_at, way_round
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.lanes import (
    CHUNK,
    CLEAR_OF_SINGULAR,
    COARSE,
    LAST_STEP_MM,
    MIDDLE,
    NEAR_MM,
    PASSES,
    SAME_MM,
    WIDTH,
    _load,
    _move as _move_to,
    _orientation,
    _place,
)
from lmeasure.kernels.layout import (
    ANGLE_ZERO,
    ATTACHMENT,
    BASE,
    CABLE,
    CHANGES,
    ECCENTRIC_PHASE,
    ECCENTRICITY,
    GUIDE,
    INCLINATION,
    KIND,
    ORIENTATION,
    PLACE,
    POSE_COLUMNS,
    RADIUS,
    SWIVEL,
)
from lmeasure.kernels.least_squares import sees_turns
from lmeasure.kernels.screw import OK, copy, platform_size
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
        # sine and cosine of the angle minus the phase of the eccentricity, times this
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


FREE = 6
PAIRS = 21
"""Of the components of a twist: the upper half of a symmetric 6x6 matrix, row by row."""

Symmetric = tuple[
    float, float, float, float, float, float, float, float, float, float, float,
    float, float, float, float, float, float, float, float, float, float,
]  # fmt: skip


@kernel
def gather(a: FloatArray, r: FloatArray, b: FloatArray, s: FloatArray, N: FloatArray) -> None:
    """Add what two channels, rows a, b (6 WIDTH,) and residuals r, s (WIDTH,), give to the normal equations N (27 WIDTH,)."""
    for i in range(WIDTH):
        a0, a1, a2, a3, a4, a5 = a[i], a[WIDTH + i], a[2 * WIDTH + i], a[3 * WIDTH + i], a[4 * WIDTH + i], a[5 * WIDTH + i]
        b0, b1, b2, b3, b4, b5 = b[i], b[WIDTH + i], b[2 * WIDTH + i], b[3 * WIDTH + i], b[4 * WIDTH + i], b[5 * WIDTH + i]
        N[i] += a0 * a0 + b0 * b0
        N[WIDTH + i] += a0 * a1 + b0 * b1
        N[2 * WIDTH + i] += a0 * a2 + b0 * b2
        N[3 * WIDTH + i] += a0 * a3 + b0 * b3
        N[4 * WIDTH + i] += a0 * a4 + b0 * b4
        N[5 * WIDTH + i] += a0 * a5 + b0 * b5
        N[6 * WIDTH + i] += a1 * a1 + b1 * b1
        N[7 * WIDTH + i] += a1 * a2 + b1 * b2
        N[8 * WIDTH + i] += a1 * a3 + b1 * b3
        N[9 * WIDTH + i] += a1 * a4 + b1 * b4
        N[10 * WIDTH + i] += a1 * a5 + b1 * b5
        N[11 * WIDTH + i] += a2 * a2 + b2 * b2
        N[12 * WIDTH + i] += a2 * a3 + b2 * b3
        N[13 * WIDTH + i] += a2 * a4 + b2 * b4
        N[14 * WIDTH + i] += a2 * a5 + b2 * b5
        N[15 * WIDTH + i] += a3 * a3 + b3 * b3
        N[16 * WIDTH + i] += a3 * a4 + b3 * b4
        N[17 * WIDTH + i] += a3 * a5 + b3 * b5
        N[18 * WIDTH + i] += a4 * a4 + b4 * b4
        N[19 * WIDTH + i] += a4 * a5 + b4 * b5
        N[20 * WIDTH + i] += a5 * a5 + b5 * b5
        N[21 * WIDTH + i] += a0 * r[i] + b0 * s[i]
        N[22 * WIDTH + i] += a1 * r[i] + b1 * s[i]
        N[23 * WIDTH + i] += a2 * r[i] + b2 * s[i]
        N[24 * WIDTH + i] += a3 * r[i] + b3 * s[i]
        N[25 * WIDTH + i] += a4 * r[i] + b4 * s[i]
        N[26 * WIDTH + i] += a5 * r[i] + b5 * s[i]


@inline
def factors(N: FloatArray, i: int) -> Symmetric:
    """N = L D L^T: 1/d0 .. 1/d5 and the fifteen entries of L below its diagonal, row by row."""
    i0 = 1.0 / N[i]
    n1, n2, n3, n4, n5 = N[WIDTH + i], N[2 * WIDTH + i], N[3 * WIDTH + i], N[4 * WIDTH + i], N[5 * WIDTH + i]
    l10, l20, l30, l40, l50 = n1 * i0, n2 * i0, n3 * i0, n4 * i0, n5 * i0
    i1 = 1.0 / (N[6 * WIDTH + i] - l10 * n1)
    m2, m3, m4, m5 = N[7 * WIDTH + i] - l20 * n1, N[8 * WIDTH + i] - l30 * n1, N[9 * WIDTH + i] - l40 * n1, N[10 * WIDTH + i] - l50 * n1
    l21, l31, l41, l51 = m2 * i1, m3 * i1, m4 * i1, m5 * i1
    i2 = 1.0 / (N[11 * WIDTH + i] - l20 * n2 - l21 * m2)
    o3 = N[12 * WIDTH + i] - l30 * n2 - l31 * m2
    o4 = N[13 * WIDTH + i] - l40 * n2 - l41 * m2
    o5 = N[14 * WIDTH + i] - l50 * n2 - l51 * m2
    l32, l42, l52 = o3 * i2, o4 * i2, o5 * i2
    i3 = 1.0 / (N[15 * WIDTH + i] - l30 * n3 - l31 * m3 - l32 * o3)
    p4 = N[16 * WIDTH + i] - l40 * n3 - l41 * m3 - l42 * o3
    p5 = N[17 * WIDTH + i] - l50 * n3 - l51 * m3 - l52 * o3
    l43, l53 = p4 * i3, p5 * i3
    i4 = 1.0 / (N[18 * WIDTH + i] - l40 * n4 - l41 * m4 - l42 * o4 - l43 * p4)
    q5 = N[19 * WIDTH + i] - l50 * n4 - l51 * m4 - l52 * o4 - l53 * p4
    l54 = q5 * i4
    i5 = 1.0 / (N[20 * WIDTH + i] - l50 * n5 - l51 * m5 - l52 * o5 - l53 * p5 - l54 * q5)
    return (
        i0, i1, i2, i3, i4, i5, l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54,
    )  # fmt: skip


@kernel
def inverse(N: FloatArray, V: FloatArray) -> None:
    """The inverses of all lanes' N, as N has them, into V (21 WIDTH,): L^-T D^-1 L^-1."""
    for i in range(WIDTH):
        i0, i1, i2, i3, i4, i5, l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54 = factors(N, i)
        k10, k21, k32, k43, k54 = -l10, -l21, -l32, -l43, -l54
        k20 = -l20 - l21 * k10
        k31 = -l31 - l32 * k21
        k42 = -l42 - l43 * k32
        k53 = -l53 - l54 * k43
        k30 = -l30 - l31 * k10 - l32 * k20
        k41 = -l41 - l42 * k21 - l43 * k31
        k52 = -l52 - l53 * k32 - l54 * k42
        k40 = -l40 - l41 * k10 - l42 * k20 - l43 * k30
        k51 = -l51 - l52 * k21 - l53 * k31 - l54 * k41
        k50 = -l50 - l51 * k10 - l52 * k20 - l53 * k30 - l54 * k40
        m1, m2, m3, m4, m5 = k10 * i1, k20 * i2, k30 * i3, k40 * i4, k50 * i5
        V[i] = i0 + k10 * m1 + k20 * m2 + k30 * m3 + k40 * m4 + k50 * m5
        V[WIDTH + i] = m1 + k21 * m2 + k31 * m3 + k41 * m4 + k51 * m5
        V[2 * WIDTH + i] = m2 + k32 * m3 + k42 * m4 + k52 * m5
        V[3 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[4 * WIDTH + i] = m4 + k54 * m5
        V[5 * WIDTH + i] = m5
        m2, m3, m4, m5 = k21 * i2, k31 * i3, k41 * i4, k51 * i5
        V[6 * WIDTH + i] = i1 + k21 * m2 + k31 * m3 + k41 * m4 + k51 * m5
        V[7 * WIDTH + i] = m2 + k32 * m3 + k42 * m4 + k52 * m5
        V[8 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[9 * WIDTH + i] = m4 + k54 * m5
        V[10 * WIDTH + i] = m5
        m3, m4, m5 = k32 * i3, k42 * i4, k52 * i5
        V[11 * WIDTH + i] = i2 + k32 * m3 + k42 * m4 + k52 * m5
        V[12 * WIDTH + i] = m3 + k43 * m4 + k53 * m5
        V[13 * WIDTH + i] = m4 + k54 * m5
        V[14 * WIDTH + i] = m5
        m4, m5 = k43 * i4, k53 * i5
        V[15 * WIDTH + i] = i3 + k43 * m4 + k53 * m5
        V[16 * WIDTH + i] = m4 + k54 * m5
        V[17 * WIDTH + i] = m5
        V[18 * WIDTH + i] = i4 + k54 * k54 * i5
        V[19 * WIDTH + i] = k54 * i5
        V[20 * WIDTH + i] = i5


LEFT_MM = 1e-10
"""What a last step may leave: steps fall at least as fast as from the one before, by residuals over distances or by their squares."""
ROUGH_MM = 0.5
"""Of the samples between which others are interpolated: what such a step leaves is some micrometres."""
STEP, FASTEST, RESIDUAL, CHI = POSE_COLUMNS, POSE_COLUMNS + 1, POSE_COLUMNS + 2, POSE_COLUMNS + 3  # rows of a tile behind the pose's
MOVED = POSE_COLUMNS + 4  # six rows: the last step
TILE_ROWS = MOVED + FREE


@kernel
def _solve(N: FloatArray, S: FloatArray, size: float) -> None:
    """Solve every lane's N x = b, move its pose by x, and keep x and its largest component [mm] in the tile."""
    by_size = 1.0 / size
    for i in range(WIDTH):
        i0, i1, i2, i3, i4, i5, l10, l20, l21, l30, l31, l32, l40, l41, l42, l43, l50, l51, l52, l53, l54 = factors(N, i)
        y0 = N[21 * WIDTH + i]
        y1 = N[22 * WIDTH + i] - l10 * y0
        y2 = N[23 * WIDTH + i] - l20 * y0 - l21 * y1
        y3 = N[24 * WIDTH + i] - l30 * y0 - l31 * y1 - l32 * y2
        y4 = N[25 * WIDTH + i] - l40 * y0 - l41 * y1 - l42 * y2 - l43 * y3
        y5 = N[26 * WIDTH + i] - l50 * y0 - l51 * y1 - l52 * y2 - l53 * y3 - l54 * y4
        x5 = y5 * i5
        x4 = y4 * i4 - l54 * x5
        x3 = y3 * i3 - l43 * x4 - l53 * x5
        x2 = y2 * i2 - l32 * x3 - l42 * x4 - l52 * x5
        x1 = y1 * i1 - l21 * x2 - l31 * x3 - l41 * x4 - l51 * x5
        x0 = y0 * i0 - l10 * x1 - l20 * x2 - l30 * x3 - l40 * x4 - l50 * x5
        S[MOVED * WIDTH + i], S[(MOVED + 1) * WIDTH + i], S[(MOVED + 2) * WIDTH + i] = x0, x1, x2
        S[(MOVED + 3) * WIDTH + i], S[(MOVED + 4) * WIDTH + i], S[(MOVED + 5) * WIDTH + i] = x3, x4, x5
        S[STEP * WIDTH + i] = max(max(max(abs(x0), abs(x1)), max(abs(x2), abs(x3))), max(abs(x4), abs(x5)))
        # the turn to first order, made a unit again: Newton's order is kept
        h0, h1, h2 = 0.5 * by_size * x0, 0.5 * by_size * x1, 0.5 * by_size * x2
        q, place = _orientation(S, i), _place(S, i)
        t0 = q[0] + h0 * q[3] + h1 * q[2] - h2 * q[1]
        t1 = q[1] + h1 * q[3] + h2 * q[0] - h0 * q[2]
        t2 = q[2] + h2 * q[3] + h0 * q[1] - h1 * q[0]
        t3 = q[3] - h0 * q[0] - h1 * q[1] - h2 * q[2]
        f = 1.0 / math.sqrt(t0 * t0 + t1 * t1 + t2 * t2 + t3 * t3)
        _move_to(S, i, add(place, (x3, x4, x5)), (f * t0, f * t1, f * t2, f * t3))


@kernel
def _judge_channel(
    S: FloatArray, M: FloatArray, V: FloatArray, a: FloatArray, r: FloatArray, c: FloatArray, weight: float, size: float, u: float
) -> None:
    """Judge every lane by a channel: its residual and chi-squared at the moved pose, and the speed of its point under the twist that
    its reading alone makes, squared; see `least_squares.fastest`."""
    point, of_length, of_cable = vec(c, ATTACHMENT), 1.0 if c[KIND] <= CABLE else 0.0, c[KIND] == CABLE
    by_weight, by_u, by_size = 1.0 / weight, 1.0 / u, 1.0 / size
    looks = 0.0 if sees_turns((a[0], a[WIDTH], a[2 * WIDTH]), (a[3 * WIDTH], a[4 * WIDTH], a[5 * WIDTH]), 1.0) else 1.0
    scaled = looks > 0.0 and not of_cable
    for i in range(WIDTH):
        a0, a1, a2, a3, a4, a5 = a[i], a[WIDTH + i], a[2 * WIDTH + i], a[3 * WIDTH + i], a[4 * WIDTH + i], a[5 * WIDTH + i]
        left = r[i] - (
            a0 * S[MOVED * WIDTH + i]
            + a1 * S[(MOVED + 1) * WIDTH + i]
            + a2 * S[(MOVED + 2) * WIDTH + i]
            + a3 * S[(MOVED + 3) * WIDTH + i]
            + a4 * S[(MOVED + 4) * WIDTH + i]
            + a5 * S[(MOVED + 5) * WIDTH + i]
        )
        left *= by_weight
        v01, v02, v03, v04, v05 = V[WIDTH + i], V[2 * WIDTH + i], V[3 * WIDTH + i], V[4 * WIDTH + i], V[5 * WIDTH + i]
        v12, v13, v14, v15 = V[7 * WIDTH + i], V[8 * WIDTH + i], V[9 * WIDTH + i], V[10 * WIDTH + i]
        v23, v24, v25 = V[12 * WIDTH + i], V[13 * WIDTH + i], V[14 * WIDTH + i]
        v34, v35, v45 = V[16 * WIDTH + i], V[17 * WIDTH + i], V[19 * WIDTH + i]
        w0 = by_size * (V[i] * a0 + v01 * a1 + v02 * a2 + v03 * a3 + v04 * a4 + v05 * a5)
        w1 = by_size * (v01 * a0 + V[6 * WIDTH + i] * a1 + v12 * a2 + v13 * a3 + v14 * a4 + v15 * a5)
        w2 = by_size * (v02 * a0 + v12 * a1 + V[11 * WIDTH + i] * a2 + v23 * a3 + v24 * a4 + v25 * a5)
        x0 = v03 * a0 + v13 * a1 + v23 * a2 + V[15 * WIDTH + i] * a3 + v34 * a4 + v35 * a5
        x1 = v04 * a0 + v14 * a1 + v24 * a2 + v34 * a3 + V[18 * WIDTH + i] * a4 + v45 * a5
        x2 = v05 * a0 + v15 * a1 + v25 * a2 + v35 * a3 + v45 * a4 + V[20 * WIDTH + i] * a5
        # of a channel that looks at no point only the turn counts
        arm = scale(looks, arm_of(M, i, point))
        moved = add(scale(looks, (x0, x1, x2)), cross((w0, w1, w2), arm))
        moved = add(moved, scale(1.0 - looks, (w0, w1, w2)))
        squared = weight * weight * dot(moved, moved)
        if scaled:
            squared *= by_weight * by_weight * (a3 * a3 + a4 * a4 + a5 * a5)
        S[FASTEST * WIDTH + i] = max(S[FASTEST * WIDTH + i], squared)
        S[RESIDUAL * WIDTH + i] = max(S[RESIDUAL * WIDTH + i], of_length * abs(left))
        S[CHI * WIDTH + i] += left * by_u * (left * by_u)


@kernel
def _refine(
    S: FloatArray,
    T: FloatArray,
    M: FloatArray,
    A: FloatArray,
    R: FloatArray,
    N: FloatArray,
    cables: FloatArray,
    weights: FloatArray,
    size: float,
    rough: bool,
) -> int:
    """Steps on a tile until none is needed: how many, or 0 when a lane starts too far away or does not converge. A (m + 1, 6 WIDTH) and R
    (m + 1, WIDTH) keep rows and residuals, zero in the last row; rough: a start for others is enough."""
    m, before = cables.shape[0], 1e-7
    for step in range(1, PASSES + 1):
        turned(S, M)
        N[:] = 0.0
        for j in range(m):
            if weights[j] == 0.0:
                A[j], R[j] = 0.0, 0.0
                continue
            t = T[j * WIDTH : (j + 1) * WIDTH]
            if cables[j, KIND] == CABLE:
                cable_rows(S, M, t, cables[j], weights[j], size, A[j], R[j])
            elif cables[j, KIND] == SWIVEL:
                swivel_rows(S, M, t, cables[j], weights[j], size, A[j], R[j])
            elif cables[j, KIND] == INCLINATION:
                inclination_rows(M, t, cables[j], weights[j], size, A[j], R[j])
            else:
                other_rows(S, t, cables[j], weights[j], size, A[j], R[j])
        for j in range(0, m, 2):
            gather(A[j], R[j], A[j + 1], R[j + 1], N)
        _solve(N, S, size)
        worst = 0.0
        for lane in range(WIDTH):
            moved = S[STEP * WIDTH + lane]
            # written so that NaN is the worst of all
            if not moved <= worst:
                worst = moved
        if not worst <= NEAR_MM:
            return 0
        if (rough and worst <= ROUGH_MM) or (worst <= LAST_STEP_MM and worst * worst <= LEFT_MM * before):
            return step
        before = worst
    return 0


@kernel
def _safe(
    S: FloatArray,
    M: FloatArray,
    A: FloatArray,
    R: FloatArray,
    N: FloatArray,
    V: FloatArray,
    cables: FloatArray,
    weights: FloatArray,
    size: float,
    u: FloatArray,
) -> bool:
    """Judge a tile whose steps are done; whether every lane is clear of singular poses."""
    inverse(N, V)
    S[FASTEST * WIDTH : (FASTEST + 1) * WIDTH] = 1.0
    S[RESIDUAL * WIDTH : (CHI + 1) * WIDTH] = 0.0
    for j in range(cables.shape[0]):
        if weights[j] > 0.0:
            _judge_channel(S, M, V, A[j], R[j], cables[j], weights[j], size, u[j])
    limit, worst = 1.0 / math.cos(CLEAR_OF_SINGULAR) ** 2, 0.0
    for lane in range(WIDTH):
        worst = worst if S[FASTEST * WIDTH + lane] <= worst else S[FASTEST * WIDTH + lane]
    return worst <= limit


@kernel
def _alike(
    targets: FloatArray, counted: IntArray, first: int, fine: int, last: int, smallest: float, u: FloatArray, weights: FloatArray
) -> bool:
    """Whether the samples first, first + fine, ... of a tile are read by the same channels, whose weights (m,) are set; counted: by how
    many each is."""
    for lane in range(WIDTH):
        if counted[min(first + lane * fine, last)] != counted[first]:
            return False
    whole = counted[first] == len(u)
    for j in range(len(u)):
        there = math.isfinite(targets[first, j])
        weights[j] = smallest / u[j] if there else 0.0
        for lane in range(0 if whole else WIDTH):
            if math.isfinite(targets[min(first + lane * fine, last), j]) != there:
                return False
    return True


@kernel
def _goes_on(
    cables: FloatArray,
    start: FloatArray,
    zero: FloatArray,
    state: FloatArray,
    change: FloatArray,
    flag: IntArray,
    u: FloatArray,
    free: IntArray,
    S: FloatArray,
) -> bool:
    """Whether the tile's first lane is the pose that the run reaches from where it has got to."""
    pose, _, _, outcome, _, _ = least_squares.follow_least_squares(cables, start, zero, state.copy(), change, flag, u, free)
    distance = 0.0
    for c in range(3):
        distance = max(distance, abs(pose[0, c] - S[c * WIDTH]))
    return outcome[0] == OK and distance <= SAME_MM


@kernel
def follow_redundant_lanes(
    cables: FloatArray,
    start: FloatArray,
    zero: FloatArray,
    state: FloatArray,
    changes: FloatArray,
    flags: IntArray,
    u: FloatArray,
    free: IntArray,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray, FloatArray]:
    """Do as `least_squares.follow` does, with the same arguments and results, coarse to fine and in lanes, for more channels than the six
    components of a twist that are free; iterations are those of the tile."""
    n, m = changes.shape
    poses, residual, angles, chi = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations, status = np.zeros(n, np.int64), flags.copy()
    size, lost, places = platform_size(cables), CHANGES + m, np.arange(m)
    S, T, M = np.empty(TILE_ROWS * WIDTH), np.empty(m * WIDTH), np.empty(9 * WIDTH)
    A, R = np.zeros((m + 1, FREE * WIDTH)), np.zeros((m + 1, WIDTH))
    N, V = np.empty((PAIRS + FREE) * WIDTH), np.empty(PAIRS * WIDTH)
    work, targets = np.empty((CHUNK, POSE_COLUMNS)), np.empty((CHUNK, m))
    smallest, weights = math.inf, np.empty(m)
    for j in range(m):
        smallest = min(smallest, u[j] * least_squares.reach_of(cables[j], start, size))
    counted = np.zeros(n, np.int64)
    for i in range(n):
        for j in range(m):
            counted[i] += math.isfinite(changes[i, j])
    index = np.flatnonzero(counted >= len(free))
    for chunk in range(0, len(index), CHUNK):
        here = index[chunk : chunk + CHUNK]
        last, counts = len(here) - 1, counted[here]
        for i in range(last + 1):
            for j in range(m):
                targets[i, j] = zero[j] + changes[here[i], j]
        coarse = np.append(np.arange(0, last, COARSE), last)
        anchors, _, _, anchored, _, _ = least_squares.follow_least_squares(
            cables, start, zero, state.copy(), changes[here[coarse]], flags[here[coarse]], u, free
        )
        together = np.all(anchored == OK)
        if together:
            for i in range(len(coarse)):
                copy(anchors[i], work[coarse[i]])
            for first in range(0, last + 1, WIDTH * MIDDLE):
                done = 0
                if _alike(targets, counts, first, MIDDLE, last, smallest, u, weights):
                    _load(work, targets, places, first, MIDDLE, COARSE, last, S, T)
                    done = _refine(S, T, M, A, R, N, cables, weights, size, True)
                for lane in range(WIDTH):
                    i = min(first + lane * MIDDLE, last)
                    for c in range(POSE_COLUMNS):
                        work[i, c] = S[c * WIDTH + lane] if done else math.nan
        joined = True  # the first coarse sample was reached from the state itself
        for first in range(0, last + 1, WIDTH):
            tile = here[first : first + WIDTH]
            taken = False
            if together and state[lost] == 0.0 and _alike(targets, counts, first, 1, last, smallest, u, weights):
                _load(work, targets, places, first, 1, MIDDLE, last, S, T)
                done = _refine(S, T, M, A, R, N, cables, weights, size, False)
                if done > 0 and _safe(S, M, A, R, N, V, cables, weights, size, u):
                    taken = joined or _goes_on(cables, start, zero, state, changes[tile[:1]], flags[tile[:1]], u, free, S)
                if taken:
                    for lane in range(len(tile)):
                        i = tile[lane]
                        for c in range(POSE_COLUMNS):
                            poses[i, c] = S[c * WIDTH + lane]
                        residual[i], chi[i] = S[RESIDUAL * WIDTH + lane], S[CHI * WIDTH + lane]
                        angles[i] = angle(math.sqrt(max(0.0, S[FASTEST * WIDTH + lane] - 1.0)), 1.0)
                        iterations[i], status[i] = done, OK
                    copy(poses[tile[-1]], state)
                    for j in range(m):
                        # a channel without a count continues from its reading at the pose
                        there = weights[j] > 0.0
                        state[CHANGES + j] = changes[tile[-1], j] if there else seen_at(cables[j], poses[tile[-1]])[0] - zero[j]
            joined = taken
            if not taken:
                p, r, k, s, a, x = least_squares.follow_least_squares(cables, start, zero, state, changes[tile], flags[tile], u, free)
                for lane in range(len(tile)):
                    i = tile[lane]
                    copy(p[lane], poses[i])
                    residual[i], iterations[i], status[i], angles[i], chi[i] = r[lane], k[lane], s[lane], a[lane], x[lane]
    return poses, residual, iterations, status, angles, chi
