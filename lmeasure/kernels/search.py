"""LP-search: many candidates for one observation point against the counted poses."""

import math

import numpy as np

from lmeasure.kernels import inline, kernel
from lmeasure.kernels.cable import FloatArray, guide_direction, span


@inline
def misfit(candidate: FloatArray, radii: FloatArray, points: FloatArray, changes: FloatArray, zero: FloatArray) -> float:
    """Sum of squared length residuals [mm^2] of a candidate (x, y, z, alpha, beta); infinite where a cable cannot run.

    points (e, 3) attachment points in the base frame, changes (e,) of the cable since its zero pose, zero (e, 3) the attachment point
    there, radii (1,) the pulley's.
    """
    base = (candidate[0], candidate[1], candidate[2])
    u = guide_direction(candidate[3], candidate[4])
    total = 0.0
    for i in range(points.shape[0]):
        here, _ = span((points[i, 0], points[i, 1], points[i, 2]), base, u, radii[0])
        start, _ = span((zero[i, 0], zero[i, 1], zero[i, 2]), base, u, radii[0])
        r = here - start - changes[i]
        total += r * r
    return math.inf if math.isnan(total) else total


@kernel
def scan(candidates: FloatArray, radii: FloatArray, points: FloatArray, changes: FloatArray, zero: FloatArray) -> FloatArray:
    """(q,) misfits [mm^2] of (q, 5) candidates."""
    out = np.empty(candidates.shape[0])
    for c in range(candidates.shape[0]):
        out[c] = misfit(candidates[c], radii, points, changes, zero)
    return out


@kernel
def descend(
    start: FloatArray, steps: FloatArray, sweeps: int, radii: FloatArray, points: FloatArray, changes: FloatArray, zero: FloatArray
) -> tuple[FloatArray, float]:
    """Coordinate descent (thesis 5.5): each coordinate in turn is moved by its step while that helps; a sweep that moves none halves the
    steps. (candidate, misfit [mm^2])."""
    best, steps = start.copy(), steps.copy()
    value = misfit(best, radii, points, changes, zero)
    for _ in range(sweeps):
        moved = False
        for c in range(best.shape[0]):
            for sign in (1.0, -1.0):
                kept = best[c]
                best[c] = kept + sign * steps[c]
                trial = misfit(best, radii, points, changes, zero)
                if trial < value:
                    value, moved = trial, True
                    break
                best[c] = kept
        if not moved:
            steps *= 0.5
    return best, value
