"""Way along a line of straight pieces, followed sample by sample."""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import kernel


@kernel
def follow_polyline(corners: FloatArray, arc: FloatArray, positions: FloatArray) -> FloatArray:
    """(n,) way [mm] along the corners (k, 3), at ways arc (k,), of the point nearest to each of (n, 3) positions.

    The nearest point is sought near the one before, ahead and behind by what the position has moved and by its distance, so that
    a line that comes near itself, or back to its start, is followed and not jumped across. Starts at the beginning of the line.
    """
    n, k = positions.shape[0], corners.shape[0]
    out = np.empty(n)
    s, j, away = 0.0, 0, 0.0
    for i in range(n):
        moved = 0.0
        if i > 0:
            for a in range(3):
                moved += (positions[i, a] - positions[i - 1, a]) ** 2
        reach = 2.0 * math.sqrt(moved) + 3.0 * away if i > 0 else math.inf
        best, best_s, best_j = math.inf, s, j
        first = j
        while first > 0 and arc[first] > s - reach:
            first -= 1
        if i == 0:
            first = 0
        for m in range(first, k - 1):
            if arc[m] > s + reach or (i == 0 and m > 0):
                break
            dot, length, square = 0.0, arc[m + 1] - arc[m], 0.0
            for a in range(3):
                dot += (positions[i, a] - corners[m, a]) * (corners[m + 1, a] - corners[m, a])
            part = min(max(dot / length, 0.0), length)
            for a in range(3):
                square += (positions[i, a] - corners[m, a] - part / length * (corners[m + 1, a] - corners[m, a])) ** 2
            if square < best:
                best, best_s, best_j = square, arc[m] + part, m
        s, j, away = best_s, best_j, math.sqrt(best)
        out[i] = s
    return out
