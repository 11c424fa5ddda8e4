"""How near the free spans of the cables come to each other and to the pulleys, at many poses."""

import math

import numpy as np
from numpy.typing import NDArray

from lmeasure.kernels import kernel
from lmeasure.kernels.clearance import span_clearance
from lmeasure.kernels.vector import scale, sub

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@kernel
def least_clearances(
    centre: FloatArray, tangent: FloatArray, attachment: FloatArray, radius: FloatArray, pairs: IntArray, strangers: IntArray
) -> FloatArray:
    """(n,) least distance [mm] between free spans, and between a free span and a pulley it does not run over; infinite without pairs.

    centre, tangent, attachment (n, m, 3) from `kernels.cable.wrap_geometry` [mm, base frame]; radius (m,) of the pulleys [mm], each taken
    as a ball; pairs (a, 2) of spans; strangers (b, 2) of a span and the cable whose pulley it must pass. NaN where a cable cannot run.
    """
    n = attachment.shape[0]
    out = np.full(n, math.inf)
    for i in range(n):
        for k in range(pairs.shape[0]):
            a, b = pairs[k, 0], pairs[k, 1]
            p = (attachment[i, a, 0], attachment[i, a, 1], attachment[i, a, 2])
            q = (attachment[i, b, 0], attachment[i, b, 1], attachment[i, b, 2])
            e = sub(p, (tangent[i, a, 0], tangent[i, a, 1], tangent[i, a, 2]))
            f = sub(q, (tangent[i, b, 0], tangent[i, b, 1], tangent[i, b, 2]))
            s = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            t = math.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])
            gap = span_clearance(sub(p, q), scale(1.0 / s, e), s, scale(1.0 / t, f), t, 0.0)
            out[i] = gap if not gap >= out[i] else out[i]
        for k in range(strangers.shape[0]):
            a, b = strangers[k, 0], strangers[k, 1]
            p = (attachment[i, a, 0], attachment[i, a, 1], attachment[i, a, 2])
            e = sub(p, (tangent[i, a, 0], tangent[i, a, 1], tangent[i, a, 2]))
            s = math.sqrt(e[0] * e[0] + e[1] * e[1] + e[2] * e[2])
            o = (centre[i, b, 0], centre[i, b, 1], centre[i, b, 2])
            # a ball is a piece of no length, whatever its direction
            gap = span_clearance(sub(p, o), scale(1.0 / s, e), s, (1.0, 0.0, 0.0), 0.0, radius[b])
            out[i] = gap if not gap >= out[i] else out[i]
    return out
