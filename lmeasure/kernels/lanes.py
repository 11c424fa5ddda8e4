"""The screw method over many samples at once, for logs: the same poses as `screw.resume_screw`, a multiple faster.

Time is gone through coarse to fine: every COARSE-th sample by `screw.resume`, one from the other; then every MIDDLE-th, then all, each
started by interpolation between the samples already known, so that samples no longer wait for each other. WIDTH of them make a tile, an
array of lanes that the compiler turns into vector instructions: nothing branches in a lane, and the 6x6 system is solved by two 3x3
blocks whose inverses are cross products, instead of pivots. A tile is only taken where that is safe: every lane starts near (NEAR_MM),
converges, keeps the start's sign of the determinant and stays away from singular poses, and the tile goes on where the one before
ended. Everything else goes to `screw.resume`, sample by sample.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.cable import leaving, span_at
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.layout import ATTACHMENT, BASE, CHANGES, GUIDE, ORIENTATION, PLACE, POSE_COLUMNS, RADIUS
from lmeasure.kernels.screw import CABLES, OK, TOLERANCE_MM, copy, invert, platform_size, resume_screw
from lmeasure.kernels.vector import Quat, Vec3, add, angle, cross, dot, rotation_matrix, scale, sub, vec

COARSE, MIDDLE = 128, 8
WIDTH = 64  # lanes of a tile
CHUNK = 4096  # samples whose coarse ones are found before the fine ones
NEAR_MM = 10.0  # largest length residual from which a lane may start
LAST_STEP_MM = 3e-5  # a Newton step on residuals this small leaves nothing: its error is about their square over a metre
SAME_MM = 1e-6  # two ways to one pose
PASSES = 5
CLEAR_OF_SINGULAR = math.radians(75.0)  # worst pressure angle up to which a tile is taken
CLEAR_OF_FLAT = 0.05  # triple product of the first block's directions
RESIDUAL, ANGLE, DETERMINANT = POSE_COLUMNS, POSE_COLUMNS + 1, POSE_COLUMNS + 2  # rows of a tile behind those of the pose
TILE_ROWS = POSE_COLUMNS + 3

Row = tuple[Vec3, Vec3, float]
Constants = tuple[Vec3, Vec3, Vec3, float]


@inline
def _constants(cable: FloatArray) -> Constants:
    return vec(cable, BASE), vec(cable, GUIDE), vec(cable, ATTACHMENT), cable[RADIUS]


@inline
def _place(S: FloatArray, i: int) -> Vec3:
    return S[PLACE * WIDTH + i], S[(PLACE + 1) * WIDTH + i], S[(PLACE + 2) * WIDTH + i]


@inline
def _orientation(S: FloatArray, i: int) -> Quat:
    first = ORIENTATION * WIDTH + i
    return S[first], S[first + WIDTH], S[first + 2 * WIDTH], S[first + 3 * WIDTH]


@inline
def _move(S: FloatArray, i: int, place: Vec3, turned: Quat) -> None:
    S[PLACE * WIDTH + i], S[(PLACE + 1) * WIDTH + i], S[(PLACE + 2) * WIDTH + i] = place
    first = ORIENTATION * WIDTH + i
    S[first], S[first + WIDTH], S[first + 2 * WIDTH], S[first + 3 * WIDTH] = turned


@inline
def _row(position: Vec3, A: tuple[Vec3, Vec3, Vec3], cable: Constants, target: float) -> Row:
    """(e, arm x e, residual) of a cable at a pose."""
    arm = (dot(A[0], cable[2]), dot(A[1], cable[2]), dot(A[2], cable[2]))
    s = leaving(sub(add(position, arm), cable[0]), cable[1], cable[3])
    return s.e, cross(arm, s.e), target - (cable[3] * s.phi + s.t)


@inline
def _block(e: Vec3, x: Vec3, y: Vec3, z: Vec3, k: float) -> Vec3:
    """A row of E2 E1^-1."""
    return k * dot(e, x), k * dot(e, y), k * dot(e, z)


@inline
def _combine(g: Vec3, a: Vec3, b: Vec3, c: Vec3) -> Vec3:
    return add(add(scale(g[0], a), scale(g[1], b)), scale(g[2], c))


@inline
def _speed(w: Vec3, v: Vec3, A: tuple[Vec3, Vec3, Vec3], cable: Constants) -> float:
    """Squared speed of the cable's attachment point under the twist (w; v)."""
    s = add(v, cross(w, (dot(A[0], cable[2]), dot(A[1], cable[2]), dot(A[2], cable[2]))))
    return dot(s, s)


@kernel
def _step(S: FloatArray, T: FloatArray, c: FloatArray) -> None:
    """One Newton step of every lane: tile S of poses, T of targets (flat, WIDTH lanes a row), c (6, columns) cables.

    [E1 M1; E2 M2] [v; w] = [b1; b2]: v is eliminated by E1^-1 = k [x y z], whose columns are cross products of E1's rows.
    """
    k0, k1, k2, k3, k4, k5 = _constants(c[0]), _constants(c[1]), _constants(c[2]), _constants(c[3]), _constants(c[4]), _constants(c[5])
    for i in range(WIDTH):
        r, q = _place(S, i), _orientation(S, i)
        A = rotation_matrix(q)
        e0, m0, b0 = _row(r, A, k0, T[i])
        e1, m1, b1 = _row(r, A, k1, T[WIDTH + i])
        e2, m2, b2 = _row(r, A, k2, T[2 * WIDTH + i])
        e3, m3, b3 = _row(r, A, k3, T[3 * WIDTH + i])
        e4, m4, b4 = _row(r, A, k4, T[4 * WIDTH + i])
        e5, m5, b5 = _row(r, A, k5, T[5 * WIDTH + i])
        x, y, z = cross(e1, e2), cross(e2, e0), cross(e0, e1)
        k = 1.0 / dot(e0, x)
        g3, g4, g5 = _block(e3, x, y, z, k), _block(e4, x, y, z, k), _block(e5, x, y, z, k)
        s3 = sub(m3, _combine(g3, m0, m1, m2))
        s4 = sub(m4, _combine(g4, m0, m1, m2))
        s5 = sub(m5, _combine(g5, m0, m1, m2))
        b = (b0, b1, b2)
        p3, p4, p5 = cross(s4, s5), cross(s5, s3), cross(s3, s4)
        w = scale(1.0 / dot(s3, p3), _combine((b3 - dot(g3, b), b4 - dot(g4, b), b5 - dot(g5, b)), p3, p4, p5))
        v = scale(k, _combine((b0 - dot(m0, w), b1 - dot(m1, w), b2 - dot(m2, w)), x, y, z))
        # the turn to first order in w, made a unit again: Newton's order is kept
        h = scale(0.5, w)
        turned = (
            q[0] + h[0] * q[3] + h[1] * q[2] - h[2] * q[1],
            q[1] + h[1] * q[3] + h[2] * q[0] - h[0] * q[2],
            q[2] + h[2] * q[3] + h[0] * q[1] - h[1] * q[0],
            q[3] - h[0] * q[0] - h[1] * q[1] - h[2] * q[2],
        )
        f = 1.0 / math.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2] + turned[3] * turned[3])
        _move(S, i, add(r, v), (f * turned[0], f * turned[1], f * turned[2], f * turned[3]))
        S[RESIDUAL * WIDTH + i] = max(max(max(abs(b0), abs(b1)), max(abs(b2), abs(b3))), max(abs(b4), abs(b5)))


@kernel
def _judge(S: FloatArray, T: FloatArray, c: FloatArray) -> None:
    """Residual, worst pressure angle and determinant of every lane into the tile's last rows; the arguments are those of `_step`.

    The angle is that of the fastest attachment point under the unit-rate twists, the columns of the inverse
    (see `screw.worst_pressure_angle`):
    cos = 1 / speed, written by its tangent so that the lanes need no acos.
    """
    k0, k1, k2, k3, k4, k5 = _constants(c[0]), _constants(c[1]), _constants(c[2]), _constants(c[3]), _constants(c[4]), _constants(c[5])
    for i in range(WIDTH):
        r, A = _place(S, i), rotation_matrix(_orientation(S, i))
        e0, m0, b0 = _row(r, A, k0, T[i])
        e1, m1, b1 = _row(r, A, k1, T[WIDTH + i])
        e2, m2, b2 = _row(r, A, k2, T[2 * WIDTH + i])
        e3, m3, b3 = _row(r, A, k3, T[3 * WIDTH + i])
        e4, m4, b4 = _row(r, A, k4, T[4 * WIDTH + i])
        e5, m5, b5 = _row(r, A, k5, T[5 * WIDTH + i])
        x, y, z = cross(e1, e2), cross(e2, e0), cross(e0, e1)
        first = dot(e0, x)
        k = 1.0 / first
        g3, g4, g5 = _block(e3, x, y, z, k), _block(e4, x, y, z, k), _block(e5, x, y, z, k)
        s3 = sub(m3, _combine(g3, m0, m1, m2))
        s4 = sub(m4, _combine(g4, m0, m1, m2))
        s5 = sub(m5, _combine(g5, m0, m1, m2))
        p3, p4, p5 = cross(s4, s5), cross(s5, s3), cross(s3, s4)
        second = dot(s3, p3)
        kk = 1.0 / second
        w3, w4, w5 = scale(kk, p3), scale(kk, p4), scale(kk, p5)
        w0 = scale(-1.0, _combine((g3[0], g4[0], g5[0]), w3, w4, w5))
        w1 = scale(-1.0, _combine((g3[1], g4[1], g5[1]), w3, w4, w5))
        w2 = scale(-1.0, _combine((g3[2], g4[2], g5[2]), w3, w4, w5))
        v0 = scale(k, _combine((1.0 - dot(m0, w0), -dot(m1, w0), -dot(m2, w0)), x, y, z))
        v1 = scale(k, _combine((-dot(m0, w1), 1.0 - dot(m1, w1), -dot(m2, w1)), x, y, z))
        v2 = scale(k, _combine((-dot(m0, w2), -dot(m1, w2), 1.0 - dot(m2, w2)), x, y, z))
        v3 = scale(-k, _combine((dot(m0, w3), dot(m1, w3), dot(m2, w3)), x, y, z))
        v4 = scale(-k, _combine((dot(m0, w4), dot(m1, w4), dot(m2, w4)), x, y, z))
        v5 = scale(-k, _combine((dot(m0, w5), dot(m1, w5), dot(m2, w5)), x, y, z))
        f0, f1 = _speed(w0, v0, A, k0), _speed(w1, v1, A, k1)
        f2, f3 = _speed(w2, v2, A, k2), _speed(w3, v3, A, k3)
        f4, f5 = _speed(w4, v4, A, k4), _speed(w5, v5, A, k5)
        S[RESIDUAL * WIDTH + i] = max(max(max(abs(b0), abs(b1)), max(abs(b2), abs(b3))), max(abs(b4), abs(b5)))
        fastest = max(max(max(f0, f1), max(f2, f3)), max(f4, f5))
        S[ANGLE * WIDTH + i] = angle(math.sqrt(max(0.0, fastest - 1.0)), 1.0)
        S[DETERMINANT * WIDTH + i] = first * second if abs(first) > CLEAR_OF_FLAT else 0.0


@kernel
def _order(cables: FloatArray, pose: FloatArray) -> tuple[FloatArray, IntArray]:
    """The cables with the three first whose directions are farthest from coplanar at the pose, and their old places (6,)."""
    e = np.empty((CABLES, 3))
    for j in range(CABLES):
        e[j, 0], e[j, 1], e[j, 2] = span_at(cables[j], pose)[1]
    best, first = -1.0, (0, 1, 2)
    for a in range(CABLES):
        for b in range(a + 1, CABLES):
            for c in range(b + 1, CABLES):
                volume = abs(dot(vec(e[a], 0), cross(vec(e[b], 0), vec(e[c], 0))))
                if volume > best:
                    best, first = volume, (a, b, c)
    places = np.empty(CABLES, np.int64)
    places[0], places[1], places[2] = first
    n = 3
    for j in range(CABLES):
        if j not in first:
            places[n] = j
            n += 1
    ordered = np.empty(cables.shape)
    for j in range(CABLES):
        copy(cables[places[j]], ordered[j])
    return ordered, places


@inline
def _side_of(work: FloatArray, a: int, b: int) -> float:
    """The sign with which the quaternion of sample b is that of sample a's half of the sphere."""
    aligned = 0.0
    for c in range(ORIENTATION, POSE_COLUMNS):
        aligned += work[a, c] * work[b, c]
    return 1.0 if aligned >= 0.0 else -1.0


@kernel
def _load(
    work: FloatArray, targets: FloatArray, places: IntArray, first: int, fine: int, coarse: int, last: int, S: FloatArray, T: FloatArray
) -> None:
    """Fill a tile with the samples first, first + fine, ..., at most last: targets, and poses interpolated between multiples of coarse.

    Between the far samples of the first level by the cubic through four of them (Catmull and Rom), which is exact under constant
    acceleration, between near ones and at the ends straight.
    """
    q, far = np.empty(POSE_COLUMNS), coarse == COARSE
    for lane in range(WIDTH):
        i = min(first + lane * fine, last)
        a = i - i % coarse
        b = min(a + coarse, last)
        f = (i - a) / (b - a) if b > a else 0.0
        sign = _side_of(work, a, b)
        for c in range(POSE_COLUMNS):
            q[c] = (1.0 - f) * work[a, c] + f * (sign if c >= ORIENTATION else 1.0) * work[b, c]
        if far and a >= coarse and a + 2 * coarse <= last:
            before, behind = a - coarse, a + 2 * coarse
            first_sign, last_sign = _side_of(work, a, before), _side_of(work, a, behind)
            for c in range(POSE_COLUMNS):
                p0 = (first_sign if c >= ORIENTATION else 1.0) * work[before, c]
                p1, p2 = work[a, c], (sign if c >= ORIENTATION else 1.0) * work[b, c]
                p3 = (last_sign if c >= ORIENTATION else 1.0) * work[behind, c]
                bend = f * (1.0 - f) * ((1.0 - f) * (p0 - 2.0 * p1 + p2) + f * (p1 - 2.0 * p2 + p3))
                q[c] -= 0.5 * bend
        square = 0.0
        for c in range(ORIENTATION, POSE_COLUMNS):
            square += q[c] * q[c]
        unit = 1.0 / math.sqrt(square)
        for c in range(POSE_COLUMNS):
            S[c * WIDTH + lane] = q[c] * (unit if c >= ORIENTATION else 1.0)
        for j in range(len(places)):
            T[j * WIDTH + lane] = targets[i, places[j]]


@kernel
def _refine(S: FloatArray, T: FloatArray, cables: FloatArray) -> int:
    """Newton steps on a tile until none is needed: how many, or 0 when a lane starts too far away or does not converge."""
    for step in range(1, PASSES + 1):
        _step(S, T, cables)
        worst = 0.0
        for lane in range(WIDTH):
            residual = S[RESIDUAL * WIDTH + lane]
            # written so that NaN is the worst of all
            if not residual <= worst:
                worst = residual
        if not worst <= NEAR_MM:
            return 0
        if worst <= LAST_STEP_MM:
            return step
    return 0


@kernel
def _safe(S: FloatArray, side: float) -> bool:
    """Whether every lane of a judged tile has its lengths, is clear of singular poses and on the side of the start."""
    for lane in range(WIDTH):
        if not (
            S[RESIDUAL * WIDTH + lane] <= TOLERANCE_MM
            and S[ANGLE * WIDTH + lane] <= CLEAR_OF_SINGULAR
            and S[DETERMINANT * WIDTH + lane] * side > 0.0
        ):
            return False
    return True


@kernel
def _goes_on(
    cables: FloatArray, start: FloatArray, state: FloatArray, change: FloatArray, flag: IntArray, u: FloatArray, S: FloatArray
) -> bool:
    """Whether the tile's first lane is the pose that the run reaches from where it has got to."""
    pose, _, _, outcome, _ = resume_screw(cables, start, state.copy(), change, flag, u)
    distance = 0.0
    for c in range(3):
        distance = max(distance, abs(pose[0, c] - S[c * WIDTH]))
    return outcome[0] == OK and distance <= SAME_MM


@kernel
def follow_lanes(
    cables: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, flags: IntArray, u: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]:
    """Do the work of `screw.resume`, with the same arguments and results, coarse to fine and in lanes; iterations are those of the tile."""
    n = changes.shape[0]
    poses, residual, angles = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations, status = np.zeros(n, np.int64), flags.copy()
    index = np.flatnonzero(flags == OK)
    zero = np.empty(CABLES)
    for j in range(CABLES):
        zero[j] = span_at(cables[j], start)[0]
    S, T = np.empty(TILE_ROWS * WIDTH), np.empty(CABLES * WIDTH)
    J, inverse = np.empty((CABLES, CABLES)), np.empty((CABLES, CABLES))
    work, targets = np.empty((CHUNK, POSE_COLUMNS)), np.empty((CHUNK, CABLES))
    for chunk in range(0, len(index), CHUNK):
        here = index[chunk : chunk + CHUNK]
        last = len(here) - 1
        for i in range(last + 1):
            for j in range(CABLES):
                targets[i, j] = zero[j] + changes[here[i], j]
        coarse = np.append(np.arange(0, last, COARSE), last)
        anchors, _, _, anchored, _ = resume_screw(cables, start, state.copy(), changes[here[coarse]], flags[here[coarse]], u)
        together = np.all(anchored == OK)
        ordered, places = _order(cables, state[:CHANGES])
        # columns (moment; direction) there, (direction; moment) here: nine exchanges
        side = -invert(ordered, start, J, inverse, platform_size(cables))
        if together:
            for i in range(len(coarse)):
                copy(anchors[i], work[coarse[i]])
            for first in range(0, last + 1, WIDTH * MIDDLE):
                _load(work, targets, places, first, MIDDLE, COARSE, last, S, T)
                done = _refine(S, T, ordered)
                for lane in range(WIDTH):
                    i = min(first + lane * MIDDLE, last)
                    for c in range(POSE_COLUMNS):
                        work[i, c] = S[c * WIDTH + lane] if done else math.nan
        joined = True  # the first coarse sample was reached from the state itself
        for first in range(0, last + 1, WIDTH):
            tile = here[first : first + WIDTH]
            taken = False
            if together:
                _load(work, targets, places, first, 1, MIDDLE, last, S, T)
                done = _refine(S, T, ordered)
                if done > 0:
                    _judge(S, T, ordered)
                    taken = _safe(S, side) and (joined or _goes_on(cables, start, state, changes[tile[:1]], flags[tile[:1]], u, S))
                if taken:
                    for lane in range(len(tile)):
                        i = tile[lane]
                        for c in range(POSE_COLUMNS):
                            poses[i, c] = S[c * WIDTH + lane]
                        residual[i] = S[RESIDUAL * WIDTH + lane]
                        angles[i] = S[ANGLE * WIDTH + lane]
                        iterations[i] = done
                    copy(poses[tile[-1]], state)
                    for j in range(CABLES):
                        state[CHANGES + j] = changes[tile[-1], j]
            joined = taken
            if not taken:
                p, r, k, s, a = resume_screw(cables, start, state, changes[tile], flags[tile], u)
                for lane in range(len(tile)):
                    i = tile[lane]
                    copy(p[lane], poses[i])
                    residual[i], iterations[i], status[i], angles[i] = r[lane], k[lane], s[lane], a[lane]
    return poses, residual, iterations, status, angles
