"""Many candidate rigs at one task."""

import math

import numpy as np

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.kernels import kernel
from lmeasure.kernels.cable import vec
from lmeasure.kernels.layout import ATTACHMENT, BODY_COLUMNS, POSE_COLUMNS, WIDTH
from lmeasure.kernels.screw import CABLES, platform_size
from lmeasure.kernels.vector import rotate
from lmeasure.kernels.zone import LONGEST, SHORTEST, SPEED2, U95_POSITION, scan
from lmeasure.kernels.zone_lanes import scan_lanes


@kernel
def worst_at_task(
    candidates: FloatArray, positions: FloatArray, quaternions: FloatArray, variance: FloatArray, order: IntArray
) -> FloatArray:
    """(n, 4) worst squared speed, 95 % radius [mm] from counts, shortest and longest cable [mm] of (n, 6, columns) rigs.

    positions (m, 3), m a whole number of lanes; quaternions (k, 4); variance (6,) of the lengths; order (6,) in which the lanes take the
    cables. Places where that order is unsound are done by the pivoted kernel.
    """
    n, k = candidates.shape[0], quaternions.shape[0]
    out = np.empty((n, 4))
    arms = np.empty((k, CABLES, 3))
    cables, sigma = np.empty(candidates.shape[1:]), np.empty(CABLES)
    nothing, no_ways, no_bodies, no_pairs = (
        np.empty((k, 0, 3)),
        np.empty((k, 0, 3)),
        np.empty((0, BODY_COLUMNS)),
        np.empty((0, 2), np.int64),
    )
    factor, no_points, start = np.empty((CABLES * WIDTH, 0)), np.empty((0, 3)), np.zeros(POSE_COLUMNS)
    start[-1] = 1.0
    for i in range(n):
        for j in range(CABLES):
            cables[j] = candidates[i, order[j]]
            sigma[j] = math.sqrt(variance[order[j]])
            for o in range(k):
                turned = rotate((quaternions[o, 0], quaternions[o, 1], quaternions[o, 2], quaternions[o, 3]), vec(cables[j], ATTACHMENT))
                arms[o, j, 0], arms[o, j, 1], arms[o, j, 2] = turned
        size = platform_size(cables)
        figures, left = scan_lanes(cables, positions, arms, nothing, nothing, no_ways, no_bodies, no_pairs, sigma, size, None, arms)
        if np.any(left):
            figures[:, left] = scan(
                candidates[i], positions[left], quaternions, variance, np.ones(CABLES), factor, start, no_points, no_pairs, no_bodies
            )[0]
        out[i, 0], out[i, 1] = figures[SPEED2].max(), figures[U95_POSITION].max()
        out[i, 2], out[i, 3] = figures[SHORTEST].min(), figures[LONGEST].max()
    return out
