"""Many candidate rigs at one task."""

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.kernels import kernel
from lmeasure.kernels.cable import vec
from lmeasure.kernels.layout import ATTACHMENT, BODY_COLUMNS, POSE_COLUMNS, WIDTH
from lmeasure.kernels.screw import platform_size
from lmeasure.kernels.vector import rotate
from lmeasure.kernels.zone import LONGEST, SHORTEST, SPEED2, U95_POSITION, scan
from lmeasure.kernels.zone_lanes import scan_lanes


@kernel
def worst_at_task(
    candidates: FloatArray, positions: FloatArray, quaternions: FloatArray, variance: FloatArray, weights: FloatArray, order: IntArray
) -> FloatArray:
    """(n, 4) worst squared speed, 95 % radius [mm] from counts, shortest and longest cable [mm] of (n, m, columns) rigs.

    positions (m, 3), m a whole number of lanes; quaternions (k, 4); variance, weights and order (m,) as in
    `accuracy.scan.Plan`. Places where that order is unsound are done by the pivoted kernel.
    """
    n, m, k = candidates.shape[0], candidates.shape[1], quaternions.shape[0]
    out = np.empty((n, 4))
    arms = np.empty((k, m, 3))
    cables, ordered, fitted = np.empty(candidates.shape[1:]), np.empty(m), np.empty(m)
    nothing, no_ways, no_bodies, no_pairs = (
        np.empty((k, 0, 3)),
        np.empty((k, 0, 3)),
        np.empty((0, BODY_COLUMNS)),
        np.empty((0, 2), np.int64),
    )
    factor, no_points, start = np.empty((m * WIDTH, 0)), np.empty((0, 3)), np.zeros(POSE_COLUMNS)
    start[-1] = 1.0
    for i in range(n):
        for j in range(m):
            cables[j] = candidates[i, order[j]]
            ordered[j], fitted[j] = variance[order[j]], weights[order[j]] ** 2
            for o in range(k):
                turned = rotate((quaternions[o, 0], quaternions[o, 1], quaternions[o, 2], quaternions[o, 3]), vec(cables[j], ATTACHMENT))
                arms[o, j, 0], arms[o, j, 1], arms[o, j, 2] = turned
        size = platform_size(cables)
        figures, left = scan_lanes(
            cables, positions, arms, nothing, nothing, no_ways, no_bodies, no_pairs, ordered, fitted, size, None, arms
        )
        if np.any(left):
            figures[:, left] = scan(
                candidates[i], positions[left], quaternions, variance, weights, np.ones(m), factor, start, no_points, no_pairs, no_bodies
            )[0]
        out[i, 0], out[i, 1] = figures[SPEED2].max(), figures[U95_POSITION].max()
        out[i, 2], out[i, 3] = figures[SHORTEST].min(), figures[LONGEST].max()
    return out
