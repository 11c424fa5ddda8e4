"""LP-search: many candidates for one observation point against the counted poses."""

import math

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels.cable import guide_direction, leaving, span
from lmeasure.kernels.decorators import inline, kernel, strict_kernel
from lmeasure.kernels.vector import Vec3, norm, sine_cosine, sub

LANES = 32  # candidates tried at a time


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
        # in this form NaN ends the search too
        if not total <= bound:
            return math.inf
    return total


@strict_kernel
def best_of(
    candidates: FloatArray, keep: int, radius: float, points: FloatArray, changes: FloatArray, zeroed: BoolArray
) -> tuple[IntArray, FloatArray]:
    """Indices (keep,) and misfits (keep,) [mm^2] of the best of (q, 5) candidates, q a whole number of `LANES_AT_ONCE`,
    best first; -1 and infinity where there are fewer.

    A tile of candidates is given up as soon as all of it is worse than the last one kept, usually after a few poses.
    """
    index, value = np.full(keep, -1, np.int64), np.full(keep, math.inf)
    place, way = np.empty((3, LANES)), np.empty((3, LANES))
    start, total = np.empty(LANES), np.empty(LANES)
    number = candidates.shape[0]
    for first in range(0, number, LANES):
        for lane in range(LANES):
            for axis in range(3):
                place[axis, lane] = candidates[first + lane, axis]
            way[0, lane], way[1, lane] = candidates[first + lane, 3], candidates[first + lane, 4]
        for lane in range(LANES):
            sa, ca = sine_cosine(way[0, lane])
            sb, cb = sine_cosine(way[1, lane])
            way[0, lane], way[1, lane], way[2, lane] = -ca * sb, -ca * cb, sa
            total[lane] = 0.0
        bound = value[keep - 1]
        for i in range(points.shape[0]):
            _add_pose(place, way, radius, (points[i, 0], points[i, 1], points[i, 2]), changes[i], zeroed[i], start, total)
            # in this form NaN ends the search too
            if not np.min(total) <= bound:
                break
        else:
            for i in range(LANES):
                found = total[i]
                if not found < value[keep - 1]:
                    continue
                k = keep - 1
                while k > 0 and value[k - 1] > found:
                    value[k], index[k] = value[k - 1], index[k - 1]
                    k -= 1
                value[k], index[k] = found, first + i
    return index, value


@inline
def _add_pose(
    place: FloatArray, way: FloatArray, radius: float, point: Vec3, change: float, zeroed: bool, start: FloatArray, total: FloatArray
) -> None:
    """Add one pose's squared residuals to the totals (LANES,) of a tile, or begin a cable at its zero pose.

    place, way (3, LANES): positions and guide directions of the candidates.
    """
    if zeroed:
        for lane in range(LANES):
            start[lane] = _length(place, way, radius, point, lane) - change
    else:
        for lane in range(LANES):
            r = _length(place, way, radius, point, lane) - start[lane] - change
            t = total[lane] + r * r
            # a candidate where a cable cannot run is out, and its NaN must not hide the others
            total[lane] = t if t < math.inf else math.inf


@inline
def _length(place: FloatArray, way: FloatArray, radius: float, point: Vec3, lane: int) -> float:
    d = sub(point, (place[0, lane], place[1, lane], place[2, lane]))
    if radius == 0.0:
        return norm(d)
    s = leaving(d, (way[0, lane], way[1, lane], way[2, lane]), radius)
    return radius * s.phi + s.t


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
