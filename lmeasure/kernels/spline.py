"""Poses on a B-spline of uniform knots: normal equations of its control poses, their band inverted, covariances between knots.

A control pose moves by (turn about the base axes; shift), a left displacement. The pose at a time moves by the weights of the k control
poses about it: exact for the place, and for the turn to first order in the angle between neighbouring control poses (cumulative splines:
Sommer et al., CVPR 2020). So normal equations couple k neighbours, and a band of 6 k rows holds them: N[c, d] is element (c + d, c).
"""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.cable import seen_at, way_round
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.layout import KIND, ORIENTATION, PLACE, POSE_COLUMNS
from lmeasure.kernels.se3 import exp_rotation, log_rotation
from lmeasure.kernels.vector import Quat, Vec3, add, cross, multiply, rotate, rotate_back, scale, sub, vec

FREE = 6


@inline
def _span_of(place: float, knots: int, k: int) -> int:
    """The first control pose that acts at a place [knots]."""
    return min(max(math.floor(place), 0), knots - k)


@inline
def _weigh(u: float, table: FloatArray, out: FloatArray) -> None:
    """Weights (orders, k) at u of a span by polynomials (orders, k, k), lowest power first."""
    orders, k, _ = table.shape
    for d in range(orders):
        for p in range(k):
            s = 0.0
            for e in range(k - 1, -1, -1):
                s = s * u + table[d, p, e]
            out[d, p] = s


@inline
def _turned(first: int, cumulative: FloatArray, turns: FloatArray, steps: FloatArray, leans: FloatArray) -> tuple[Quat, Vec3]:
    """Orientation at a time, and its angular velocity in base axes, by cumulative weights (2, k).

    A control pose p that turns by delta turns the curve by w_p delta - lean_p x delta, to second order in the steps between control poses:
    leans (k, 3).
    """
    k = cumulative.shape[1]
    q = (turns[first, 0], turns[first, 1], turns[first, 2], turns[first, 3])
    w, before, above = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.0, 0.0, 0.0)
    for j in range(1, k):
        d = vec(steps[first + j - 1], 0)
        a, b = cumulative[0, j], cumulative[1, j]
        D = rotate(q, d)
        here = scale(a, add(above, scale(0.5 * (1.0 - a), D)))
        above = add(above, scale(1.0 - a, D))
        leans[j - 1, 0], leans[j - 1, 1], leans[j - 1, 2] = sub(before, here)
        before = here
        e = exp_rotation(scale(a, d))
        q = multiply(q, e)
        w = add(rotate_back(e, w), scale(b, d))
    leans[k - 1, 0], leans[k - 1, 1], leans[k - 1, 2] = before
    return q, rotate(q, w)


@kernel
def spline_equations(
    rows: FloatArray,
    zero: FloatArray,
    readings: FloatArray,
    times: FloatArray,
    weights: FloatArray,
    grid: tuple[float, float],
    tables: tuple[FloatArray, FloatArray],
    points: FloatArray,
    turns: FloatArray,
    steps: FloatArray,
    shared: FloatArray,
    late: tuple[FloatArray, FloatArray, float],
    N: FloatArray,
    g: FloatArray,
    X: FloatArray,
    S: FloatArray,
    s: FloatArray,
) -> float:
    """Add samples to the normal equations of a curve, and return their weighted sum of squares.

    rows (m, columns), zero (m,) readings where a change is 0; readings (n, m) changes, NaN for none, at times (n, m) [s], with weights;
    grid: time of the first knot and spacing [s]; tables: polynomials (2, k, k) of the weights and of the cumulative ones, with their
    first derivatives; points (K, 3), turns (K, 4) of control poses, steps (K - 1, 3) between these; shared (n, m, b0) errors of the
    readings by variables; late: errors of the times by variables of clocks (m, c), and of their rates about a middle. N (6 K, 6 k),
    g (6 K,); X (6 K, b), S (b, b), s (b,): what the b = b0 + 2 c variables border them with.
    """
    n, m = readings.shape
    begin, spacing = grid
    table, cumulative = tables
    offsets, rates, middle = late
    k, knots, b0, c = table.shape[1], len(points), shared.shape[2], offsets.shape[1]
    b = b0 + 2 * c
    W, C, leans = np.empty((2, k)), np.empty((2, k)), np.zeros((k, 3))
    moved, block = np.empty((k, FREE, FREE)), np.empty((FREE, FREE))
    pose, a, right, L = np.empty(POSE_COLUMNS), np.empty(FREE), np.zeros(FREE), np.empty(b)
    A, border = np.zeros((FREE, FREE)), np.zeros((FREE, b))
    ox = oy = oz = vx = vy = vz = 0.0
    total = 0.0
    for i in range(n):
        last, first, waits = math.nan, 0, False
        for j in range(m + 1):
            if j < m and not math.isfinite(readings[i, j]):
                continue
            other = j == m or times[i, j] != last
            if other and waits:
                for q in range(k):
                    lean, weight = vec(leans[q], 0), W[0, q]
                    for x in range(FREE):
                        more = cross(lean, (A[x, 0], A[x, 1], A[x, 2]))
                        moved[q, x, 0], moved[q, x, 1] = weight * A[x, 0] + more[0], weight * A[x, 1] + more[1]
                        moved[q, x, 2] = weight * A[x, 2] + more[2]
                        for y in range(3, FREE):
                            moved[q, x, y] = weight * A[x, y]
                for p in range(k):
                    weight, lean = W[0, p], vec(leans[p], 0)
                    column = FREE * (first + p)
                    for x, more in enumerate(cross(lean, (right[0], right[1], right[2]))):
                        g[column + x] += more
                    for e in range(b):
                        for x, more in enumerate(cross(lean, (border[0, e], border[1, e], border[2, e]))):
                            X[column + x, e] += more
                    for x in range(FREE):
                        g[column + x] += weight * right[x]
                        for e in range(b):
                            X[column + x, e] += weight * border[x, e]
                    for q in range(p, k):
                        for y in range(FREE):
                            above, beside, below = moved[q, 0, y], moved[q, 1, y], moved[q, 2, y]
                            block[0, y] = weight * above + (lean[1] * below - lean[2] * beside)
                            block[1, y] = weight * beside + (lean[2] * above - lean[0] * below)
                            block[2, y] = weight * below + (lean[0] * beside - lean[1] * above)
                            for x in range(3, FREE):
                                block[x, y] = weight * moved[q, x, y]
                        for x in range(FREE):
                            of = N[column + x]
                            for y in range(x if p == q else 0, FREE):
                                of[FREE * (q - p) - x + y] += block[x, y]
                waits = False
            if j == m:
                break
            if other:
                last = times[i, j]
                place = (last - begin) / spacing
                first = _span_of(place, knots, k)
                _weigh(place - first, table, W)
                _weigh(place - first, cumulative, C)
                turn, (ox, oy, oz) = _turned(first, C, turns, steps, leans)
                px = py = pz = vx = vy = vz = 0.0
                for p in range(k):
                    x0, y0, z0 = points[first + p, 0], points[first + p, 1], points[first + p, 2]
                    px, py, pz = px + W[0, p] * x0, py + W[0, p] * y0, pz + W[0, p] * z0
                    vx, vy, vz = vx + W[1, p] * x0, vy + W[1, p] * y0, vz + W[1, p] * z0
                pose[PLACE], pose[PLACE + 1], pose[PLACE + 2] = px, py, pz
                pose[ORIENTATION], pose[ORIENTATION + 1], pose[ORIENTATION + 2], pose[ORIENTATION + 3] = turn
                for x in range(FREE):
                    right[x] = 0.0
                    for y in range(FREE):
                        A[x, y] = 0.0
                    for e in range(b):
                        border[x, e] = 0.0
            value, moment, force = seen_at(rows[j], pose)
            r, weight = way_round(readings[i, j] + zero[j] - value, rows[j, KIND]), weights[i, j]
            if not (math.isfinite(r) and weight > 0.0):
                continue
            waits = True
            a[0], a[1], a[2] = moment
            a[3], a[4], a[5] = force
            total += weight * r * r
            for x in range(FREE):
                right[x] += weight * a[x] * r
                for y in range(FREE):
                    A[x, y] += weight * a[x] * a[y]
            if b == 0:
                continue
            rate = a[0] * ox + a[1] * oy + a[2] * oz + a[3] * vx + a[4] * vy + a[5] * vz
            for e in range(b0):
                L[e] = shared[i, j, e]
            for e in range(c):
                L[b0 + e] = rate * offsets[j, e]
                L[b0 + c + e] = rate * rates[j, e] * (last - middle)
            for e in range(b):
                if L[e] == 0.0:
                    continue
                for x in range(FREE):
                    border[x, e] += weight * a[x] * L[e]
                s[e] += weight * L[e] * r
                for f in range(b):
                    S[e, f] += weight * L[e] * L[f]
    return total


@kernel
def spline_poses(
    times: FloatArray,
    grid: tuple[float, float],
    tables: tuple[FloatArray, FloatArray],
    points: FloatArray,
    turns: FloatArray,
    steps: FloatArray,
) -> FloatArray:
    """(n, 7) poses of a curve at times (n,) [s]; the other arguments as `spline_equations` has them."""
    k = tables[0].shape[1]
    out, W, C, leans = np.zeros((len(times), POSE_COLUMNS)), np.empty((2, k)), np.empty((2, k)), np.empty((k, 3))
    for i in range(len(times)):
        place = (times[i] - grid[0]) / grid[1]
        first = _span_of(place, len(points), k)
        _weigh(place - first, tables[0], W)
        _weigh(place - first, tables[1], C)
        turn = _turned(first, C, turns, steps, leans)[0]
        for p in range(k):
            for c in range(3):
                out[i, PLACE + c] += W[0, p] * points[first + p, c]
        out[i, ORIENTATION], out[i, ORIENTATION + 1], out[i, ORIENTATION + 2], out[i, ORIENTATION + 3] = turn
    return out


@kernel
def band_inverse(factor: FloatArray) -> FloatArray:
    """(n, w) band of the inverse of a matrix whose Cholesky factor L has the band factor[c, d] = L[c + d, c] (Takahashi's recurrence)."""
    n, w = factor.shape
    Z, z = np.zeros((n, w)), np.empty(w)
    for j in range(n - 1, -1, -1):
        p = min(w - 1, n - 1 - j)
        by = 1.0 / factor[j, 0]
        for d in range(p + 1):
            z[d] = 0.0
        for c in range(1, p + 1):
            lc, s, row = factor[j, c], 0.0, Z[j + c]
            z[c] += row[0] * lc
            for d in range(c + 1, p + 1):
                z[d] += row[d - c] * lc
                s += row[d - c] * factor[j, d]
            z[c] += s
        s = 0.0
        for d in range(1, p + 1):
            Z[j, d] = -by * z[d]
            s += z[d] * factor[j, d]
        Z[j, 0] = by * by * (1.0 + s)
    return Z


@kernel
def spline_covariances(times: FloatArray, grid: tuple[float, float], table: FloatArray, Z: FloatArray) -> FloatArray:
    """(n, 6 D, 6 D) covariances at times (n,) [s] of the displacement of a curve and of its derivatives, as many as the table (D, k, k)
    has, by the band of the covariance of its control poses (6 K, 6 k)."""
    D, k, _ = table.shape
    begin, spacing = grid
    out, W = np.zeros((len(times), FREE * D, FREE * D)), np.empty((D, k))
    ahead, here = np.empty((D, FREE, FREE)), np.empty((FREE, FREE))
    for i in range(len(times)):
        place = (times[i] - begin) / spacing
        first = _span_of(place, len(Z) // FREE, k)
        _weigh(place - first, table, W)
        of = out[i]
        for p in range(k):
            column = FREE * (first + p)
            ahead[:] = 0.0
            for x in range(FREE):
                row = Z[column + x]
                for y in range(x, FREE):
                    here[x, y] = here[y, x] = row[y - x]
                for q in range(p + 1, k):
                    for e in range(D):
                        weight = W[e, q]
                        for y in range(FREE):
                            ahead[e, x, y] += weight * row[FREE * (q - p) - x + y]
            for d in range(D):
                for e in range(d, D):
                    one, other = W[d, p], W[e, p]
                    for x in range(FREE):
                        for y in range(FREE):
                            of[FREE * d + x, FREE * e + y] += one * (ahead[e, x, y] + other * here[x, y]) + other * ahead[d, y, x]
        for x in range(FREE * D):
            for y in range(x):
                of[x, y] = of[y, x]
    return out


@kernel
def spline_steps(turns: FloatArray) -> FloatArray:
    """(K - 1, 3) rotation vectors from each of K orientations (K, 4) to the next, body axes."""
    out = np.empty((len(turns) - 1, 3))
    for i in range(len(out)):
        x, y, z, w = turns[i, 0], turns[i, 1], turns[i, 2], turns[i, 3]
        other = (turns[i + 1, 0], turns[i + 1, 1], turns[i + 1, 2], turns[i + 1, 3])
        out[i, 0], out[i, 1], out[i, 2] = log_rotation(multiply((-x, -y, -z, w), other))
    return out


@kernel
def spline_moved(points: FloatArray, turns: FloatArray, by: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points (K, 3) and unit quaternions (K, 4) of control poses after displacements (K, 6)."""
    places, turned = points + by[:, 3:], np.empty_like(turns)
    for i in range(len(turns)):
        x, y, z, w = multiply(exp_rotation(vec(by[i], 0)), (turns[i, 0], turns[i, 1], turns[i, 2], turns[i, 3]))
        size = math.sqrt(x * x + y * y + z * z + w * w)
        turned[i, 0], turned[i, 1], turned[i, 2], turned[i, 3] = x / size, y / size, z / size, w / size
    return places, turned


@kernel
def spline_differences(points: FloatArray, turns: FloatArray, signs: FloatArray) -> FloatArray:
    """(K - s + 1, 6) differences of control poses by s signs, of turns in the chart about the middle one."""
    s = len(signs)
    out = np.zeros((len(points) - s + 1, FREE))
    for i in range(len(out)):
        middle = turns[i + s // 2]
        back = (-middle[0], -middle[1], -middle[2], middle[3])
        for a in range(s):
            turn = turns[i + a]
            for x, angle in enumerate(log_rotation(multiply((turn[0], turn[1], turn[2], turn[3]), back))):
                out[i, x] += signs[a] * angle
                out[i, 3 + x] += signs[a] * points[i + a, x]
    return out


@kernel
def add_spline_prior(signs: FloatArray, weights: FloatArray, differences: FloatArray, N: FloatArray, g: FloatArray) -> None:
    """Add differences (r, 6) about 0, with weights (r, 6), to the normal equations of control poses: N (6 K, 6 k), g (6 K,)."""
    s = len(signs)
    for i in range(len(weights)):
        for a in range(s):
            for x in range(FREE):
                row = FREE * (i + a) + x
                weight = signs[a] * weights[i, x]
                g[row] -= weight * differences[i, x]
                for b in range(a, s):
                    N[row, FREE * (b - a)] += weight * signs[b]


@kernel
def variances_of_differences(signs: FloatArray, Z: FloatArray, rows: int) -> FloatArray:
    """(r, 6) variances of r differences of control poses by the band of their covariance (6 K, 6 k)."""
    s = len(signs)
    out = np.zeros((rows, FREE))
    for i in range(rows):
        for a in range(s):
            for x in range(FREE):
                row = Z[FREE * (i + a) + x]
                total = signs[a] * row[0]
                for b in range(a + 1, s):
                    total += 2.0 * signs[b] * row[FREE * (b - a)]
                out[i, x] += signs[a] * total
    return out
