"""Readings other than cables' lengths: the angle of a swivel pulley about the incoming cable, that of an axis of the tool above the
horizontal, and a straight distance.

Swivel: with d = P - B, e0 = (sin a sin b, sin a cos b, cos a) normal to u and upward, e1 = u x e0 = (-cos b, sin b, 0), the pulley's plane
is at theta = atan2(y, x), x = d.e0, y = d.e1, whose gradient by P is (x e1 - y e0)/(x^2 + y^2). An eccentric encoder shows theta +
c sin(theta - phase). Inclination: an axis a of the tool leans by atan2(a.g, |a x g|) against the upward g, and grows as the tool turns
about a x g. Each minus its zero. Columns: `kernels.layout`.
"""

import math

from lmeasure.core import FloatArray
from lmeasure.kernels import layout
from lmeasure.kernels.decorators import inline
from lmeasure.kernels.vector import Vec3, add, cross, dot, norm, orientation, rotate, rotate_back, scale, sub, vec

NOWHERE = (0.0, 0.0, 0.0)


@inline
def distance_at(channel: FloatArray, pose: FloatArray) -> tuple[float, Vec3, Vec3]:
    """(reading [mm], its gradient by the tool point, arm of that [mm]) of a straight distance, base axes; NaN where both points meet."""
    arm = rotate(orientation(pose), vec(channel, layout.ATTACHMENT))
    d = sub(add(vec(pose, layout.PLACE), arm), vec(channel, layout.BASE))
    length = norm(d)
    return length - channel[layout.ANGLE_ZERO], scale(1.0 / length, d), arm


@inline
def frame_at(channel: FloatArray) -> tuple[Vec3, Vec3]:
    """(e0, e1) of the guide's angles."""
    alpha, beta = channel[layout.ALPHA], channel[layout.BETA]
    sa, sb, cb = math.sin(alpha), math.sin(beta), math.cos(beta)
    return (sa * sb, sa * cb, math.cos(alpha)), (-cb, sb, 0.0)


@inline
def swivel_at(channel: FloatArray, pose: FloatArray) -> tuple[float, Vec3, Vec3]:
    """(reading [rad], its gradient by the attachment point [rad/mm], arm of that [mm]), base axes; NaN on the axis."""
    arm = rotate(orientation(pose), vec(channel, layout.ATTACHMENT))
    d = sub(add(vec(pose, layout.PLACE), arm), vec(channel, layout.BASE))
    e0, e1 = frame_at(channel)
    x, y = dot(d, e0), dot(d, e1)
    theta, square = math.atan2(y, x), x * x + y * y
    off, phase = channel[layout.ECCENTRICITY], channel[layout.ECCENTRIC_PHASE]
    gain = (1.0 + off * math.cos(theta - phase)) / square
    gradient = scale(gain, sub(scale(x, e1), scale(y, e0)))
    return theta + off * math.sin(theta - phase) - channel[layout.ANGLE_ZERO], gradient, arm


@inline
def inclination_at(channel: FloatArray, pose: FloatArray) -> tuple[float, Vec3]:
    """(reading [rad], its rate by a turn about each base axis); NaN where the axis is upright."""
    axis, up = rotate(orientation(pose), vec(channel, layout.ATTACHMENT)), vec(channel, layout.BASE)
    across = cross(axis, up)
    size = norm(across)
    return math.atan2(dot(axis, up), size) - channel[layout.ANGLE_ZERO], scale(1.0 / size, across)


@inline
def sensor_gradient(channel: FloatArray, pose: FloatArray, k: float, scale_factor: float, out: FloatArray) -> None:
    """Derivatives of the reading by `PARAMETERS`, into out (layout.WIDTH,): the zero's derivative instead of the pulley radius'. k and
    scale_factor as `kernels.cable.length_gradient` has them; angles have no scale."""
    for c in range(layout.WIDTH):
        out[c] = 0.0
    out[layout.BY_ANGLE_ZERO] = -1.0
    if channel[layout.KIND] == layout.SWIVEL:
        _, gradient, arm = swivel_at(channel, pose)
        d = sub(add(vec(pose, layout.PLACE), arm), vec(channel, layout.BASE))
        # alpha turns the frame about e1, beta about the base's -Z: to turn it is to turn d back
        out[layout.BY_ALPHA] = dot(gradient, cross(d, frame_at(channel)[1]))
        out[layout.BY_BETA] = dot(gradient, cross(d, (0.0, 0.0, -1.0)))
        inward = rotate_back(orientation(pose), gradient)
        for c in range(3):
            out[layout.BY_BASE + c], out[layout.BY_ATTACHMENT + c] = -gradient[c], inward[c]
    elif channel[layout.KIND] == layout.DISTANCE:
        _, gradient, arm = distance_at(channel, pose)
        inward = rotate_back(orientation(pose), gradient)
        for c in range(3):
            out[layout.BY_BASE + c], out[layout.BY_ATTACHMENT + c] = -gradient[c], inward[c]
        out[layout.BY_SCALE] = channel[layout.COUNT_LENGTH] * k / scale_factor
