"""What a unit of each of six lengths does to the pose, LANES places at a time: the rows inverted by blocks.

The 6x6 rows are inverted by two 3x3 blocks whose inverses are cross products: with the rows [E1 M1; E2 M2] (v; w) = dl,
G = E2 E1^-1 and the Schur complement S = M2 - G M1,

    w = S^-1 (dl2 - G dl1),    v = E1^-1 (dl1 - M1 w).

Without pivots this needs three first cables whose directions are far from coplanar; the caller chooses them (`accuracy.scan.block_order`).
"""

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import inline
from lmeasure.kernels.vector import Vec3, add, cross, dot, scale, sub, vec
from lmeasure.kernels.zone import DET_HIGH, DET_LOW, NORM2
from lmeasure.kernels.zone_rows import CABLE_ROWS, LANES, MOVE, SOUND, SPAN, TURN, WORST, at, least, most, put


@inline
def inverse_twists(B: FloatArray, S: FloatArray, arms: FloatArray, size: float) -> None:
    """Twists per unit of each length into S, from their spans and arms (6, 3), and what the determinants tell: extremes of that with
    moments divided by size, and the least absolute one of the first block, which tells whether the inverse is sound."""
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
