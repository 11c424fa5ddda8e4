"""Effect of a unit of each of more than six lengths on the pose, by weighted least squares, LANES places at a time.

With the rows (m_j; e_j), m_j = arm x e, and weights q_j the twist (w; v) that fits dl best is that of the normal equations

    [A B; B^T C] (w; v) = sum_j q_j dl_j (m_j; e_j),    A = sum q m m^T,  B = sum q m e^T,  C = sum q e e^T,

solved by blocks: with K = C^-1 B^T and the Schur complement S = A - B K, a unit of length j turns by w = q_j S^-1 (m_j - K^T e_j) and moves
by v = q_j C^-1 e_j - K w. C is sound where the spans are far from coplanar, S where the cables see every turn.
"""

import math

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import inline
from lmeasure.kernels.vector import Vec3, add, cross, dot, scale, sub, vec
from lmeasure.kernels.zone import NORM2
from lmeasure.kernels.zone_rows import CABLE_ROWS, LANES, MOVE, SOUND, SPAN, TURN, WORST, at, least, most, put

# rows: A and C by xx, yy, zz, xy, xz, yz, B row by row; the same places then hold S^-1, C^-1 and K^T
_A, _B, _C, NORMAL_ROWS = 0, 6, 15, 21

Symmetric = tuple[Vec3, Vec3]
"""(xx, yy, zz), (xy, xz, yz)"""


@inline
def least_squares_twists(B: FloatArray, S: FloatArray, N: FloatArray, arms: FloatArray, weights: FloatArray, size: float) -> None:
    """Twists per unit of each length into S, from their spans, arms (m, 3) and the weights (m,) of the squares, at most 1.

    The norm of the inverse is that of the rows as they are, without the weights: it shows how far a singular pose is. With the weights it
    shows whether this inverse is sound.
    """
    alike = True
    for j in range(len(weights)):
        alike = alike and weights[j] == 1.0
    _normal(N, S, arms, weights, True)
    _solve(N)
    _norm(B, N, size, True)
    if not alike:
        _normal(N, S, arms, weights, False)
        _solve(N)
        _norm(B, N, size, False)
    for j in range(len(weights)):
        _twist(S[j * CABLE_ROWS * LANES :], N, vec(arms[j], 0), weights[j])


@inline
def _normal(N: FloatArray, S: FloatArray, arms: FloatArray, weights: FloatArray, plain: bool) -> None:
    for row in range(NORMAL_ROWS):
        for lane in range(LANES):
            N[row * LANES + lane] = 0.0
    for j in range(len(weights)):
        _add_row(N, S[j * CABLE_ROWS * LANES :], vec(arms[j], 0), 1.0 if plain else weights[j])


@inline
def _add_row(N: FloatArray, S: FloatArray, arm: Vec3, weight: float) -> None:
    for lane in range(LANES):
        e = at(S, SPAN, lane)
        m, q = cross(arm, e), scale(weight, e)
        p = scale(weight, m)
        _more(N, _A, lane, (p[0] * m[0], p[1] * m[1], p[2] * m[2]))
        _more(N, _A + 3, lane, (p[0] * m[1], p[0] * m[2], p[1] * m[2]))
        _more(N, _B, lane, scale(p[0], e))
        _more(N, _B + 3, lane, scale(p[1], e))
        _more(N, _B + 6, lane, scale(p[2], e))
        _more(N, _C, lane, (q[0] * e[0], q[1] * e[1], q[2] * e[2]))
        _more(N, _C + 3, lane, (q[0] * e[1], q[0] * e[2], q[1] * e[2]))


@inline
def _more(N: FloatArray, row: int, lane: int, a: Vec3) -> None:
    put(N, row, lane, add(at(N, row, lane), a))


@inline
def _solve(N: FloatArray) -> None:
    """S^-1, K^T and C^-1 in the places of A, B and C."""
    for lane in range(LANES):
        C = _inverse((at(N, _C, lane), at(N, _C + 3, lane)))
        b0, b1, b2 = at(N, _B, lane), at(N, _B + 3, lane), at(N, _B + 6, lane)
        k0, k1, k2 = _times(C, b0), _times(C, b1), _times(C, b2)  # rows of K^T = B C^-1
        a, mixed = at(N, _A, lane), at(N, _A + 3, lane)
        a = sub(a, (dot(b0, k0), dot(b1, k1), dot(b2, k2)))
        mixed = sub(mixed, (dot(b0, k1), dot(b0, k2), dot(b1, k2)))
        A = _inverse((a, mixed))
        put(N, _A, lane, A[0])
        put(N, _A + 3, lane, A[1])
        put(N, _B, lane, k0)
        put(N, _B + 3, lane, k1)
        put(N, _B + 6, lane, k2)
        put(N, _C, lane, C[0])
        put(N, _C + 3, lane, C[1])


@inline
def _norm(B: FloatArray, N: FloatArray, size: float, determined: bool) -> None:
    """Squared Frobenius norm of the pseudo-inverse, moments divided by size: the trace of the inverse of the normal equations. It tells
    whether that is sound, and where it is determined it is a figure of the place."""
    for lane in range(LANES):
        a, c = at(N, _A, lane), at(N, _C, lane)
        A = (a, at(N, _A + 3, lane))
        # K S^-1 K^T by the columns of K
        k0, k1, k2 = at(N, _B, lane), at(N, _B + 3, lane), at(N, _B + 6, lane)
        x, y, z = (k0[0], k1[0], k2[0]), (k0[1], k1[1], k2[1]), (k0[2], k1[2], k2[2])
        moves = c[0] + c[1] + c[2] + dot(x, _times(A, x)) + dot(y, _times(A, y)) + dot(z, _times(A, z))
        norm2 = (a[0] + a[1] + a[2]) * (size * size) + moves
        if determined:
            most(B, WORST + NORM2, lane, norm2)
        # rounding alone makes it negative, and a NaN would be taken for a negative value
        least(B, SOUND, lane, 1.0 / math.sqrt(norm2) if norm2 > 0.0 else 0.0)


@inline
def _twist(S: FloatArray, N: FloatArray, arm: Vec3, weight: float) -> None:
    for lane in range(LANES):
        e = at(S, SPAN, lane)
        k0, k1, k2 = at(N, _B, lane), at(N, _B + 3, lane), at(N, _B + 6, lane)
        rest = sub(cross(arm, e), (dot(k0, e), dot(k1, e), dot(k2, e)))
        w = scale(weight, _times((at(N, _A, lane), at(N, _A + 3, lane)), rest))
        v = scale(weight, _times((at(N, _C, lane), at(N, _C + 3, lane)), e))
        put(S, TURN, lane, w)
        put(S, MOVE, lane, sub(v, add(add(scale(w[0], k0), scale(w[1], k1)), scale(w[2], k2))))


@inline
def _inverse(a: Symmetric) -> Symmetric:
    xx, yy, zz = a[0]
    xy, xz, yz = a[1]
    x, y, z = yy * zz - yz * yz, xx * zz - xz * xz, xx * yy - xy * xy
    p, q, r = xz * yz - xy * zz, xy * yz - xz * yy, xy * xz - xx * yz
    k = 1.0 / (xx * x + xy * p + xz * q)
    return scale(k, (x, y, z)), scale(k, (p, q, r))


@inline
def _times(a: Symmetric, v: Vec3) -> Vec3:
    d, o = a
    return (d[0] * v[0] + o[0] * v[1] + o[1] * v[2], o[0] * v[0] + d[1] * v[1] + o[2] * v[2], o[1] * v[0] + o[2] * v[1] + d[2] * v[2])
