"""Distance between straight pieces: cable and cable, cable and body."""

import math

from lmeasure.kernels import inline
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
