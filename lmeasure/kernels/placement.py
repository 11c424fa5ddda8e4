"""Many candidate rigs at one task."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.cable import span_at
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.gaussian import radius_95
from lmeasure.kernels.layout import ATTACHMENT, BODY_COLUMNS, ORIENTATION, PLACE, POSE_COLUMNS, WIDTH
from lmeasure.kernels.least_squares import alike, fastest, length_twists
from lmeasure.kernels.screw import platform_size
from lmeasure.kernels.vector import rotate, vec
from lmeasure.kernels.zone import LONGEST, SHORTEST, SPEED2, U95_POSITION, scan
from lmeasure.kernels.zone_lanes import scan_lanes


@kernel
def worst_at_task(
    candidates: FloatArray,
    positions: FloatArray,
    quaternions: FloatArray,
    variance: FloatArray,
    weights: FloatArray,
    order: IntArray,
    limits: FloatArray,
) -> FloatArray:
    """(n, 4) worst squared speed, 95 % radius [mm] from counts, shortest and longest cable [mm] of (n, m, columns) rigs.

    positions (m, 3), m a whole number of lanes; quaternions (k, 4); variance, weights and order (m,) as in
    `accuracy.scan.Plan`. Places where that order is unsound are done by the pivoted kernel. limits (n, 2) of squared speed and radius:
    a rig that exceeds one at some orientation is left there, with the worst figures so far; that orientation is the next rig's first.
    """
    n, m, k = candidates.shape[0], candidates.shape[1], quaternions.shape[0]
    out = np.empty((n, 4))
    cables, ordered, fitted = np.empty(candidates.shape[1:]), np.empty(m), np.empty(m)
    turns, no_bodies, no_pairs = np.arange(k), np.empty((0, BODY_COLUMNS)), np.empty((0, 2), np.int64)
    factor, no_points, start = np.empty((m * WIDTH, 0)), np.empty((0, 3)), np.zeros(POSE_COLUMNS)
    start[-1] = 1.0
    for i in range(n):
        for j in range(m):
            cables[j] = candidates[i, order[j]]
            ordered[j], fitted[j] = variance[order[j]], weights[order[j]] ** 2
        size, step = platform_size(cables), 1 if math.isfinite(limits[i, 0]) or math.isfinite(limits[i, 1]) else k
        arms, tried, nothing = np.empty((step, m, 3)), np.empty((step, 4)), np.empty((step, 0, 3))
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = 0.0, 0.0, math.inf, 0.0
        for first in range(0, k, step):
            for s in range(step):
                for c in range(4):
                    tried[s, c] = quaternions[turns[first + s], c]
                for j in range(m):
                    q = tried[s]
                    arms[s, j, 0], arms[s, j, 1], arms[s, j, 2] = rotate((q[0], q[1], q[2], q[3]), vec(cables[j], ATTACHMENT))
            figures, left = scan_lanes(
                cables, positions, arms, nothing, nothing, nothing, no_bodies, no_pairs, ordered, fitted, size, None, arms
            )
            if np.any(left):
                figures[:, left] = scan(
                    candidates[i], positions[left], tried, variance, weights, np.ones(m), factor, start, no_points, no_pairs, no_bodies
                )[0]
            out[i, 0], out[i, 1] = max(out[i, 0], figures[SPEED2].max()), max(out[i, 1], figures[U95_POSITION].max())
            out[i, 2], out[i, 3] = min(out[i, 2], figures[SHORTEST].min()), max(out[i, 3], figures[LONGEST].max())
            if out[i, 0] > limits[i, 0] or out[i, 1] > limits[i, 1]:
                turns[0], turns[first] = turns[first], turns[0]
                break
    return out


@kernel
def worst_of_channels(
    candidates: FloatArray, cables: int, positions: FloatArray, quaternions: FloatArray, variance: FloatArray, own: FloatArray
) -> FloatArray:
    """Return the result of `worst_at_task` for rigs whose channels (n, m, columns), the first so many of them cables, are of any kind.

    variance (m,) [mm^2, rad^2] of the weights of readings, own (m,) of their errors; positions (k, 3), any number.
    """
    n, m = candidates.shape[0], candidates.shape[1]
    out, pose = np.empty((n, 4)), np.empty(POSE_COLUMNS)
    # about 1 of lengths: pivots are compared with that
    free, nothing, left, G, weights = np.arange(6), np.zeros(m), np.empty(m), np.empty((6, m)), np.sqrt(variance[:cables].min() / variance)
    units = np.empty(m)
    for i in range(n):
        rows, size = candidates[i], platform_size(candidates[i])
        speed, radius, shortest, longest = 1.0, 0.0, math.inf, 0.0
        for p in range(len(positions)):
            for o in range(len(quaternions)):
                for c in range(3):
                    pose[PLACE + c] = positions[p, c]
                for c in range(4):
                    pose[ORIENTATION + c] = quaternions[o, c]
                runs = True
                for j in range(cables):
                    length = span_at(rows[j], pose)[0]
                    runs = runs and not math.isnan(length)
                    shortest, longest = min(shortest, length), max(longest, length)
                # a pressure angle is geometry: there all readings count alike
                if runs:
                    alike(rows, pose, weights, size, units)
                    runs = length_twists(rows, pose, units, free, size, nothing, G, left)
                speed = max(speed, fastest(rows, pose, G)) if runs else math.inf
                if not (runs and length_twists(rows, pose, weights, free, size, nothing, G, left)):
                    speed, radius = math.inf, math.inf
                    continue
                xx = yy = zz = xy = xz = yz = 0.0
                for j in range(m):
                    x, y, z = G[3, j], G[4, j], G[5, j]
                    xx, yy, zz = xx + own[j] * x * x, yy + own[j] * y * y, zz + own[j] * z * z
                    xy, xz, yz = xy + own[j] * x * y, xz + own[j] * x * z, yz + own[j] * y * z
                radius = max(radius, radius_95(xx, yy, zz, xy, xz, yz))
        out[i, 0], out[i, 1], out[i, 2], out[i, 3] = speed * speed, radius, shortest, longest
    return out
