"""LP-search: many candidates for one observation point against the counted poses."""

import math

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import inline, kernel
from lmeasure.kernels.cable import FloatArray, guide_direction, span

BoolArray = NDArray[np.bool_]


@inline
def misfit(candidate: FloatArray, radius: float, points: FloatArray, changes: FloatArray, zeroed: BoolArray, bound: float) -> float:
    """Sum of squared length residuals [mm^2] of a candidate (x, y, z, alpha, beta), given up as infinite once it passes the bound;
    infinite where a cable cannot run.

    points (e, 3) attachment points in the base frame and changes (e,) of their cables, cable by cable; zeroed (e,) marks the zero pose
    that each cable begins with.
    """
    base = (candidate[0], candidate[1], candidate[2])
    u = guide_direction(candidate[3], candidate[4])
    total, start = 0.0, 0.0
    for i in range(points.shape[0]):
        length, _ = span((points[i, 0], points[i, 1], points[i, 2]), base, u, radius)
        if zeroed[i]:
            start = length - changes[i]
            continue
        r = length - start - changes[i]
        total += r * r
        # written so that NaN gives up too
        if not total <= bound:
            return math.inf
    return total


@kernel
def best_of(
    candidates: FloatArray, keep: int, radius: float, points: FloatArray, changes: FloatArray, zeroed: BoolArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Indices (keep,) and misfits (keep,) [mm^2] of the best of (q, 5) candidates, best first; -1 and infinity where there are fewer.

    A candidate is given up as soon as it is worse than the last one kept, usually after a few poses.
    """
    index, value = np.full(keep, -1, np.int64), np.full(keep, math.inf)
    for c in range(candidates.shape[0]):
        found = misfit(candidates[c], radius, points, changes, zeroed, value[keep - 1])
        if not found < value[keep - 1]:
            continue
        k = keep - 1
        while k > 0 and value[k - 1] > found:
            value[k], index[k] = value[k - 1], index[k - 1]
            k -= 1
        value[k], index[k] = found, c
    return index, value


@kernel
def descend(
    start: FloatArray, steps: FloatArray, sweeps: int, radius: float, points: FloatArray, changes: FloatArray, zeroed: BoolArray
) -> tuple[FloatArray, float]:
    """Coordinate descent (thesis 5.5): each coordinate in turn is moved by its step while that helps; a sweep that moves none halves the
    steps. (candidate, misfit [mm^2])."""
    best, steps = start.copy(), steps.copy()
    value = misfit(best, radius, points, changes, zeroed, math.inf)
    for _ in range(sweeps):
        moved = False
        for c in range(best.shape[0]):
            for sign in (1.0, -1.0):
                kept = best[c]
                best[c] = kept + sign * steps[c]
                trial = misfit(best, radius, points, changes, zeroed, value)
                if trial < value:
                    value, moved = trial, True
                    break
                best[c] = kept
        if not moved:
            steps *= 0.5
    return best, value
