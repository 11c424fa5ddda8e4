"""Which way a cable travelled last."""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels.decorators import kernel
from lmeasure.kernels.layout import TRAVEL_FAR, TRAVEL_WAY


@kernel
def last_travel(counts: FloatArray, band: FloatArray, state: FloatArray) -> FloatArray:
    """(n, m) 1 where a count last rose, -1 where it fell, 0 where it has done neither, by more than its band (m,), for counts (n, m) with
    NaN for gaps, in which the last direction stays.

    state (m, 2), zeros at the beginning, is moved on in place: the farthest count in the present direction, and that direction.
    """
    n, m = counts.shape
    out = np.empty((n, m))
    for j in range(m):
        far, way = state[j, TRAVEL_FAR], state[j, TRAVEL_WAY]
        for i in range(n):
            k = counts[i, j]
            if not math.isnan(k):
                if way == 0.0:
                    if abs(k - far) > band[j]:
                        way, far = math.copysign(1.0, k - far), k
                elif way * (k - far) > 0.0:
                    far = k
                elif way * (far - k) > band[j]:
                    way, far = -way, k
            out[i, j] = way
        state[j, TRAVEL_FAR], state[j, TRAVEL_WAY] = far, way
    return out
