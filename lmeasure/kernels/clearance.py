"""Distance between straight pieces: cable and cable, cable and body, cable and pulley."""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.vector import Vec3, add, dot, scale, sub


@inline
def square_distance(d: Vec3, e: Vec3, s_end: float, f: Vec3, t_end: float) -> float:
    """Least squared distance between P - s e, 0 <= s <= s_end, and Q - t f, 0 <= t <= t_end, for d = P - Q and unit e, f.

    Without a branch: the s of the common normal (0 for parallel lines), cut to the piece; the t nearest to it, cut; and the s nearest to
    that, cut (Ericson, Real-Time Collision Detection, 5.1.9, with arc lengths as parameters).
    """
    along, c, g = dot(e, f), dot(e, d), dot(f, d)
    sine2 = 1.0 - along * along
    s = (c - along * g) / sine2 if sine2 > 1e-12 else 0.0
    s = cut(s, s_end)
    t = cut(along * s - g, t_end)
    s = cut(c + along * t, s_end)
    gap = add(sub(d, scale(s, e)), scale(t, f))
    return dot(gap, gap)


@inline
def cut(value: float, end: float) -> float:
    """The value, no less than 0 and no more than the end."""
    value = value if value > 0.0 else 0.0
    return value if value < end else end


@inline
def span_clearance(d: Vec3, e: Vec3, s_end: float, f: Vec3, t_end: float, radius: float) -> float:
    """Distance from the surface of the given radius about the second piece [mm]."""
    return math.sqrt(square_distance(d, e, s_end, f, t_end)) - radius


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
