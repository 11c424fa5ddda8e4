"""The calibration's part in the zone's lane kernel: the covariance of the lengths by that of the rig's parameters, LANES places at a time.

A length changes since the zero pose by h_j . dp_j for its parameters' errors dp_j, h_j being its gradient there minus that at the zero pose
(`kernels.cable.length_gradient`). The parameters' covariance F F^T is taken cable by cable, F_j = R_j^T Q_j^T (QR of F_j^T), so that

    cov(dl_j, dl_k) = (R_j h_j)^T (Q_j^T Q_k) (R_k h_k):

gradients in units of their own uncertainty, which loses nothing where parameters of a cable are known in combination only, and what
correlates two cables; of one cable Q_j^T Q_j = 1. Products are done by blocks of five rows, as many as an observation point and its guide
have; blocks of zeros are passed over, and so are derivatives that no block needs.
"""

import math
from typing import NamedTuple

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels import layout
from lmeasure.kernels.cable import drum_change, drum_way, leaving
from lmeasure.kernels.decorators import inline, strict_kernel
from lmeasure.kernels.vector import Vec3, add, dot, scale, sub, vec
from lmeasure.kernels.zone_rows import CABLE_ROWS, LANES, PLACE, SPAN, at, put

BLOCK = 5
BLOCKS = -(-layout.WIDTH // BLOCK)
LENGTH = BLOCK * BLOCKS  # row of a cable's length behind those of its derivatives, then of its change, true count and Newton's last step
CHANGE, COUNT, STEP, GRADIENT_ROWS = LENGTH + 1, LENGTH + 2, LENGTH + 3, LENGTH + 4

Five = tuple[float, float, float, float, float]


class Linked(NamedTuple):
    """Values of a calibration for the lanes, of m cables in the lanes' order; blocks are BLOCK x BLOCK.

    roots (m, BLOCKS, BLOCKS, 5, 5) R_j and begun (m, LENGTH) R_j times the gradient at the zero pose; both (m, m, BLOCKS, BLOCKS, 5, 5)
    Q_j^T Q_k; in_roots and in_both tell which blocks are not zero, tied (m, m) which cables' errors are correlated, ranks (m,) how many
    blocks of rows R_j has; beyond (m,) whether anything but observation point and guide is uncertain, drums (m,) whether anything of a
    counter or drum is; zero (m,) lengths at the zero pose [mm], scales (m,) decoding factors, guides (m, 6) derivatives of the guide's
    direction by alpha and beta.
    """

    roots: FloatArray
    begun: FloatArray
    both: FloatArray
    in_roots: BoolArray
    in_both: BoolArray
    tied: BoolArray
    ranks: IntArray
    beyond: BoolArray
    drums: BoolArray
    zero: FloatArray
    scales: FloatArray
    guides: FloatArray


@inline
def _product(a: FloatArray, b: FloatArray) -> float:
    """Of the numbers that both have."""
    s = 0.0
    for i in range(min(len(a), len(b))):
        s += a[i] * b[i]
    return s


@inline
def _length(a: FloatArray) -> float:
    return math.sqrt(_product(a, a))


@strict_kernel
def roots_by_cable(factor: FloatArray, at_start: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """R_j (m, LENGTH, LENGTH), R_j times at_start (m, LENGTH) and Q_j^T Q_k (m, m, LENGTH, LENGTH) of F (m, WIDTH, r), with gradients
    at_start (m, WIDTH) at the zero pose: Gram and Schmidt's way, each remainder twice; rows that are not needed are zero."""
    m, width, r = factor.shape
    roots, begun, both = np.zeros((m, LENGTH, LENGTH)), np.zeros((m, LENGTH)), np.zeros((m, m, LENGTH, LENGTH))
    Q, rest = np.zeros((m, LENGTH, r)), np.empty(r)
    for j in range(m):
        rank = 0
        for c in range(width):
            for i in range(r):
                rest[i] = factor[j, c, i]
            whole = _length(rest)
            for _ in range(2):
                for b in range(rank):
                    s = _product(Q[j, b], rest)
                    roots[j, b, c] += s
                    for i in range(r):
                        rest[i] -= s * Q[j, b, i]
            left = _length(rest)
            # the rest of a dependent one is rounding
            if left > 1e-14 * whole:
                roots[j, rank, c] = left
                for i in range(r):
                    Q[j, rank, i] = rest[i] / left
                rank += 1
        for a in range(LENGTH):
            begun[j, a] = _product(roots[j, a], at_start[j])
    for j in range(m):
        for k in range(m):
            for a in range(LENGTH):
                for b in range(LENGTH):
                    both[j, k, a, b] = _product(Q[j, a], Q[k, b])
    return roots, begun, both


@inline
def _gradient(H: FloatArray, B: FloatArray, S: FloatArray, offset: Vec3, u: Vec3, radius: float, by_alpha: Vec3, by_beta: Vec3) -> None:
    """Derivatives of a cable's length by its observation point and guide, as `kernels.cable.length_gradient` has them, into the first rows
    of H. by_alpha, by_beta: derivatives of the guide. With the span e, q = d . u and n the part of d across u: cos phi = e . u, and
    sin phi q/p = (e . n) q/p^2."""
    bent = 1.0 if radius > 0.0 else 0.0
    for lane in range(LANES):
        d, e = add(at(B, PLACE, lane), offset), at(S, SPAN, lane)
        q = dot(d, u)
        across = sub(d, scale(q, u))
        by_guide = bent * (dot(e, u) - dot(e, across) * q / dot(across, across))
        put(H, layout.BY_BASE, lane, scale(-1.0, e))
        H[layout.BY_ALPHA * LANES + lane], H[layout.BY_BETA * LANES + lane] = by_guide * dot(d, by_alpha), by_guide * dot(d, by_beta)


@inline
def _gradient_beyond(H: FloatArray, B: FloatArray, S: FloatArray, offset: Vec3, u: Vec3, radius: float, turn: FloatArray) -> None:
    """Derivatives by pulley and attachment point, none by the drum, and the length itself into row LENGTH; turn (3, 3): base_from_tool."""
    x_axis, y_axis, z_axis = (
        (turn[0, 0], turn[1, 0], turn[2, 0]),
        (turn[0, 1], turn[1, 1], turn[2, 1]),
        (turn[0, 2], turn[1, 2], turn[2, 2]),
    )
    for lane in range(LANES):
        s, e = leaving(add(at(B, PLACE, lane), offset), u, radius), at(S, SPAN, lane)
        H[layout.BY_RADIUS * LANES + lane] = s.phi - s.sine
        put(H, layout.BY_SCALE, lane, (0.0, 0.0, 0.0))
        put(H, layout.BY_ATTACHMENT, lane, (dot(e, x_axis), dot(e, y_axis), dot(e, z_axis)))
        H[layout.BY_PITCH * LANES + lane] = 0.0
        H[LENGTH * LANES + lane] = radius * s.phi + s.t


@inline
def _drum_gradient(H: FloatArray, cable: FloatArray, zero: float, factor: float) -> None:
    """The derivatives by the counter's scale and the drum's dimensions, for the length in row LENGTH and that at the zero pose."""
    tangent, axial, travel = cable[layout.TANGENT], cable[layout.AXIAL], cable[layout.TRAVEL]
    count_length, turn = cable[layout.COUNT_LENGTH], cable[layout.TURN_COUNTS]
    for lane in range(LANES):
        H[CHANGE * LANES + lane] = H[LENGTH * LANES + lane] - zero
        H[COUNT * LANES + lane], H[STEP * LANES + lane] = H[CHANGE * LANES + lane] / count_length, math.inf
    # `kernels.cable.drum_count`, all lanes at once: each keeps its count once its step is rounding, whatever the others do
    for _ in range(50):
        settled = True
        for lane in range(LANES):
            k, last = H[COUNT * LANES + lane], H[STEP * LANES + lane]
            _, slant = drum_way(tangent, axial + travel * k)
            way = H[CHANGE * LANES + lane] - drum_change(k, tangent, axial, travel, count_length)
            step = way / (count_length - travel * slant) if abs(last) > 1e-13 * max(1.0, abs(k)) else 0.0
            H[COUNT * LANES + lane], H[STEP * LANES + lane] = k + step, step
            settled &= not abs(step) > 1e-13 * max(1.0, abs(k + step))
        if settled:
            break
    aside_begun, slant_begun = drum_way(tangent, axial)
    for lane in range(LANES):
        k = H[COUNT * LANES + lane]
        aside, slant = drum_way(tangent, axial + travel * k)
        H[layout.BY_SCALE * LANES + lane] = (count_length - travel * slant) * k / factor
        H[layout.BY_TANGENT * LANES + lane] = aside - aside_begun
        H[layout.BY_AXIAL * LANES + lane] = slant - slant_begun
        H[layout.BY_PITCH * LANES + lane] = slant * k / turn


@inline
def _five(H: FloatArray, lane: int) -> Five:
    return H[lane], H[LANES + lane], H[2 * LANES + lane], H[3 * LANES + lane], H[4 * LANES + lane]


@inline
def _row(M: FloatArray, i: int) -> Five:
    return M[i, 0], M[i, 1], M[i, 2], M[i, 3], M[i, 4]


@inline
def _dot(a: Five, b: Five) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4]


@inline
def _add_times(G: FloatArray, M: FloatArray, H: FloatArray, begun: FloatArray, more: bool) -> None:
    """Add the block M times five rows of H to five rows of G, which begin at minus begun unless there are more blocks before."""
    m0, m1, m2, m3, m4 = _row(M, 0), _row(M, 1), _row(M, 2), _row(M, 3), _row(M, 4)
    b0, b1, b2, b3, b4 = begun[0], begun[1], begun[2], begun[3], begun[4]
    for lane in range(LANES):
        h, g = _five(H, lane), _five(G, lane) if more else (-b0, -b1, -b2, -b3, -b4)
        G[lane] = g[0] + _dot(m0, h)
        G[LANES + lane] = g[1] + _dot(m1, h)
        G[2 * LANES + lane] = g[2] + _dot(m2, h)
        G[3 * LANES + lane] = g[3] + _dot(m3, h)
        G[4 * LANES + lane] = g[4] + _dot(m4, h)


@inline
def _add_form(L: FloatArray, G: FloatArray, M: FloatArray, H: FloatArray, more: bool) -> None:
    """Add g^T M h for five rows g of G and h of H to L, which begins at nothing unless there are more blocks before."""
    m0, m1, m2, m3, m4 = _row(M, 0), _row(M, 1), _row(M, 2), _row(M, 3), _row(M, 4)
    for lane in range(LANES):
        h, before = _five(H, lane), L[lane] if more else 0.0
        L[lane] = before + _dot(_five(G, lane), (_dot(m0, h), _dot(m1, h), _dot(m2, h), _dot(m3, h), _dot(m4, h)))


@inline
def _add_squares(L: FloatArray, G: FloatArray, variance: float, more: bool) -> None:
    """Add g^T g for five rows g of G to L, which begins at the variance unless there are more blocks before."""
    for lane in range(LANES):
        g, before = _five(G, lane), L[lane] if more else variance
        L[lane] = before + _dot(g, g)


@inline
def length_covariance(
    L: FloatArray, H: FloatArray, B: FloatArray, S: FloatArray, arms: FloatArray, cables: FloatArray, variance: FloatArray, linked: Linked,
    turn: FloatArray,
) -> None:  # fmt: skip
    """Covariance of the lengths, their own variances (m,) and the calibration's, into L: the lower triangle row by row, LANES each,
    nothing where two cables are not tied.

    H is scratch: GRADIENT_ROWS of one cable's gradient, then LENGTH rows a cable of the same in units of its uncertainty.
    """
    m = len(cables)
    for j in range(m):
        offset, u, radius = sub(vec(arms[j], 0), vec(cables[j], layout.BASE)), vec(cables[j], layout.GUIDE), cables[j, layout.RADIUS]
        span, scaled = S[j * CABLE_ROWS * LANES :], H[(GRADIENT_ROWS + j * LENGTH) * LANES :]
        _gradient(H, B, span, offset, u, radius, vec(linked.guides[j], 0), vec(linked.guides[j], 3))
        if linked.beyond[j]:
            _gradient_beyond(H, B, span, offset, u, radius, turn)
        if linked.drums[j]:
            _drum_gradient(H, cables[j], linked.zero[j], linked.scales[j])
        for a in range(linked.ranks[j]):
            more = False
            for b in range(BLOCKS):
                if linked.in_roots[j, a, b]:
                    here = scaled[a * BLOCK * LANES :]
                    _add_times(here, linked.roots[j, a, b], H[b * BLOCK * LANES :], linked.begun[j, a * BLOCK :], more)
                    more = True
    for j in range(m):
        G, own = H[(GRADIENT_ROWS + j * LENGTH) * LANES :], L[(j * (j + 1) // 2 + j) * LANES :]
        if linked.ranks[j] == 0:
            for lane in range(LANES):
                own[lane] = variance[j]
        for a in range(linked.ranks[j]):
            _add_squares(own, G[a * BLOCK * LANES :], variance[j], a > 0)
        for k in range(j):
            here, D, more = L[(j * (j + 1) // 2 + k) * LANES :], H[(GRADIENT_ROWS + k * LENGTH) * LANES :], False
            for a in range(linked.ranks[j]):
                for b in range(linked.ranks[k]):
                    if linked.in_both[j, k, a, b]:
                        _add_form(here, G[a * BLOCK * LANES :], linked.both[j, k, a, b], D[b * BLOCK * LANES :], more)
                        more = True
