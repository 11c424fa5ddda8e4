"""One cable: from the drum over the fixed pulley and the swivel pulley to the attachment point.

Swivel pulley (thesis Rashoyan 2021, 5.5, eqs. 5.9-5.10, derived again)
-----------------------------------------------------------------------
The cable reaches the fixed point B travelling along the unit vector u, which is also the axis about which the pulley swivels. The
pulley turns into the plane of u and P - B. In that plane take q = (P-B).u along u and p = distance of P from the axis, n its unit
vector: the pulley's centre is O = B + R n. The cable wraps through phi and leaves at T = O + R (sin phi u - cos phi n) along
e = cos phi u + sin phi n for a straight part t, so that

    q = R sin phi + t cos phi,    p - R = -R cos phi + t sin phi,    t = sqrt(q^2 + (p-R)^2 - R^2).

Length F = R phi + t. Its derivatives follow by differentiating the two equations: dF/dq = cos phi, dF/dp = sin phi (so the gradient at
P is e, the unit vector of the free span), and dF/dR = phi - sin phi at fixed q, p. The thesis' printed systems have
misprints (the plane normal, a sign in the third row of 5.9, eps = 2 arcsin(|BT|/2R), which holds only up to 180 degrees); its floor
point N fails for points below the floor, so u is built from the angles.

Grooved drum (thesis 5.5)
-------------------------
The pay-out point travels axially, a(k) = a0 + k g/N for pitch g and N counts per turn, so the stretch from drum to fixed
pulley is h(k) = hypot(t_d, a(k)). Paying out k counts of length c gives the free cable the change

    D(k) = k c - (h(k) - h(0)) = F(P) - F(P0),

which grows strictly with k when g < N c. The rig file is checked for this.

Columns of a cable and of a pose: `kernels.layout`.
"""

import math
from typing import NamedTuple

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import layout
from lmeasure.kernels.angles import NOWHERE, distance_at, inclination_at, sensor_gradient, swivel_at
from lmeasure.kernels.decorators import inline, strict_kernel
from lmeasure.kernels.external import external_at, external_gradient, is_external
from lmeasure.kernels.vector import (
    Vec3,
    add,
    angle,
    cross,
    dot,
    norm,
    orientation as orientation,
    rotate,
    rotate_back,
    scale,
    sub,
    vec as vec,
)

ON_AXIS_MM = 1e-9  # nearer to the swivel axis than this the side is a matter of rounding


@strict_kernel
def guide_direction(alpha: float, beta: float) -> Vec3:
    """Unit direction u of cable travel at B: against the way from B to the fixed pulley (alpha below the horizontal, beta from +Y
    towards +X)."""
    return -math.cos(alpha) * math.sin(beta), -math.cos(alpha) * math.cos(beta), math.sin(alpha)


class Leaving(NamedTuple):
    """How a cable leaves its swivel pulley: phi, wrapped angle in [0, 2 pi); t, straight length; e, unit vector of the free span; cosine
    and sine of phi; n, unit vector away from the swivel axis; slope q/p."""

    phi: float
    t: float
    e: Vec3
    cosine: float
    sine: float
    n: Vec3
    slope: float


@inline
def leaving(d: Vec3, u: Vec3, radius: float) -> Leaving:
    """Of the cable to the point d from B, by two divisions and no branch; the compiler omits unused results. NaN inside
    the pulley, and on its axis, even of a pulley of radius 0: the length would be finite, but the pulley has no plane to turn into."""
    q = dot(d, u)
    across = sub(d, scale(q, u))
    p = norm(across)
    p = p if p >= ON_AXIS_MM else math.nan
    x = p - radius
    square = x * x + q * q
    t = math.sqrt(square - radius * radius)
    # the two equations above solved for phi, times square
    sine, cosine = q * radius + x * t, q * t - x * radius
    k = 1.0 / (p * square)
    e = add(scale(cosine * p * k, u), scale(sine * k, across))
    return Leaving(angle(sine, cosine), t, e, cosine * p * k, sine * p * k, scale(square * k, across), q * (square * k))


@inline
def span(point: Vec3, base: Vec3, u: Vec3, radius: float) -> tuple[float, Vec3]:
    """(length from B over the swivel pulley to the point, unit vector e of the free span); NaN where no cable can run.

    radius 0 is a straight cable from B.
    """
    d = sub(point, base)
    if radius == 0.0:
        length = norm(d)
        return length, scale(1.0 / length, d)
    s = leaving(d, u, radius)
    return radius * s.phi + s.t, s.e


@inline
def drum_change(k: float, tangent: float, axial: float, travel: float, count_length: float) -> float:
    """D(k): change of the free cable, drum to attachment minus drum to fixed pulley, when k counts are paid out."""
    a = axial + travel * k
    # h(k) - h(0) as a quotient: the difference of two square roots would lose the digits that one count moves
    h = math.sqrt(tangent * tangent + a * a) + math.sqrt(tangent * tangent + axial * axial)
    dh = travel * k * (a + axial) / h if h > 0.0 else 0.0
    return k * count_length - dh


@inline
def drum_way(tangent: float, axial: float) -> tuple[float, float]:
    """Rates of the stretch between drum and fixed pulley by both legs; zero if both are at one point, which has no direction."""
    h = math.sqrt(tangent * tangent + axial * axial)
    return (tangent / h, axial / h) if h > 0.0 else (0.0, 0.0)


@inline
def drum_count(change: float, tangent: float, axial: float, travel: float, count_length: float) -> float:
    """The k whose D(k) is the change: Newton from k = change/c, monotone because |dh/dk| <= g/N < c."""
    k = change / count_length
    for _ in range(50):
        _, slant = drum_way(tangent, axial + travel * k)
        slope = count_length - travel * slant
        step = (change - drum_change(k, tangent, axial, travel, count_length)) / slope
        k += step
        if abs(step) <= 1e-13 * max(1.0, abs(k)):
            break
    return k


@inline
def span_at(cable: FloatArray, pose: FloatArray) -> tuple[float, Vec3, Vec3]:
    """(length, e, arm): the arm is the attachment point from the tool origin, in base axes."""
    arm = rotate(orientation(pose), vec(cable, layout.ATTACHMENT))
    length, e = span(add(vec(pose, layout.PLACE), arm), vec(cable, layout.BASE), vec(cable, layout.GUIDE), cable[layout.RADIUS])
    return length, e, arm


@inline
def seen_at(channel: FloatArray, pose: FloatArray) -> tuple[float, Vec3, Vec3]:
    """(reading, moment, force) of a channel of any kind: a length [mm] or an angle [rad], and its rates by a turn about the tool origin and
    by a shift, base axes."""
    kind = channel[layout.KIND]
    if is_external(kind):
        return external_at(channel, pose)
    if kind == layout.INCLINATION:
        leaning, moment = inclination_at(channel, pose)
        return leaning, moment, NOWHERE
    if kind == layout.DISTANCE:
        value, e, arm = distance_at(channel, pose)
    else:
        value, e, arm = swivel_at(channel, pose) if kind == layout.SWIVEL else span_at(channel, pose)
    return value, cross(arm, e), e


@inline
def way_round(difference: float, kind: float) -> float:
    """A difference of readings, the shortest way around for angles."""
    if kind <= layout.CABLE:
        return difference
    return difference - 2.0 * math.pi * math.floor(difference / (2.0 * math.pi) + 0.5)


@strict_kernel
def span_lengths(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, m) lengths F [mm] from B to the attachment point, for m cables at n poses; NaN where no cable can run. Of channels of another
    kind their readings."""
    out = np.empty((poses.shape[0], cables.shape[0]))
    for sample in range(poses.shape[0]):
        for j in range(cables.shape[0]):
            out[sample, j] = seen_at(cables[j], poses[sample])[0]
    return out


@strict_kernel
def span_rows_of(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, m, 6) `span_rows` at (n, 7) poses."""
    out = np.empty((poses.shape[0], cables.shape[0], 6))
    for sample in range(poses.shape[0]):
        for j in range(cables.shape[0]):
            _, moment, e = seen_at(cables[j], poses[sample])
            for c in range(3):
                out[sample, j, c] = moment[c]
                out[sample, j, 3 + c] = e[c]
    return out


@strict_kernel
def span_rows(cables: FloatArray, pose: FloatArray) -> FloatArray:
    """(m, 6) rows (arm x e ; e): rate of each length by the twist (omega; v), v at the tool origin, base axes."""
    return span_rows_of(cables, pose.reshape(1, -1))[0]


@strict_kernel
def wrap_geometry(cables: FloatArray, poses: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Where the cables run, for pictures and limits: (n, m, 3) pulley centres, tangent points and attachment points in the base frame,
    (n, m) wrapped angles [rad]."""
    n, m = poses.shape[0], cables.shape[0]
    centre, tangent, attachment = np.empty((n, m, 3)), np.empty((n, m, 3)), np.empty((n, m, 3))
    wrapped = np.zeros((n, m))
    for sample in range(n):
        for j in range(m):
            base, u, radius = vec(cables[j], layout.BASE), vec(cables[j], layout.GUIDE), cables[j, layout.RADIUS]
            point = add(vec(poses[sample], layout.PLACE), rotate(orientation(poses[sample]), vec(cables[j], layout.ATTACHMENT)))
            o, t = base, base
            if radius > 0.0:
                s = leaving(sub(point, base), u, radius)
                o = add(base, scale(radius, s.n))
                t = add(o, add(scale(radius * s.sine, u), scale(-radius * s.cosine, s.n)))
                wrapped[sample, j] = s.phi
            for c in range(3):
                centre[sample, j, c], tangent[sample, j, c], attachment[sample, j, c] = o[c], t[c], point[c]
    return centre, tangent, attachment, wrapped


@strict_kernel
def changes_from_counts(cables: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, m) changes D [mm] of the free cable from (n, m) true counts k (paid out positive)."""
    out = np.empty(counts.shape)
    for sample in range(counts.shape[0]):
        for j in range(counts.shape[1]):
            out[sample, j] = drum_change(
                counts[sample, j],
                cables[j, layout.TANGENT],
                cables[j, layout.AXIAL],
                cables[j, layout.TRAVEL],
                cables[j, layout.COUNT_LENGTH],
            )
    return out


@strict_kernel
def counts_from_changes(cables: FloatArray, changes: FloatArray) -> FloatArray:
    """(n, m) true counts k, not rounded, from (n, m) changes of the free cable [mm]."""
    out = np.empty(changes.shape)
    for sample in range(changes.shape[0]):
        for j in range(changes.shape[1]):
            out[sample, j] = drum_count(
                changes[sample, j],
                cables[j, layout.TANGENT],
                cables[j, layout.AXIAL],
                cables[j, layout.TRAVEL],
                cables[j, layout.COUNT_LENGTH],
            )
    return out


@inline
def length_gradient(cable: FloatArray, pose: FloatArray, k: float, scale_factor: float, out: FloatArray) -> None:
    """Derivatives of F(pose) - D(k) by `PARAMETERS`, into out (layout.WIDTH,).

    k is decoded from a recorded count by 1/scale, hence dk/dscale = -k/scale. The count's zero pose enters by a second call with k = 0.
    """
    base, u, radius = vec(cable, layout.BASE), vec(cable, layout.GUIDE), cable[layout.RADIUS]
    attachment = vec(cable, layout.ATTACHMENT)
    q4 = orientation(pose)
    d = sub(add(vec(pose, layout.PLACE), rotate(q4, attachment)), base)
    alpha, beta = cable[layout.ALPHA], cable[layout.BETA]
    if radius == 0.0:
        length = norm(d)
        e = scale(1.0 / length, d)
        out[layout.BY_ALPHA], out[layout.BY_BETA] = 0.0, 0.0
        # the limit R -> 0 of phi - sin phi, with the angle between u and the straight cable
        cosine = min(1.0, max(-1.0, dot(e, u)))
        phi = math.acos(cosine)
        out[layout.BY_RADIUS] = phi - math.sin(phi)
    else:
        s = leaving(d, u, radius)
        e = s.e
        # dq = d.du and, as p^2 = |d|^2 - q^2, dp = -(q/p) dq
        by_u = s.cosine - s.sine * s.slope
        out[layout.BY_ALPHA] = by_u * dot(d, (math.sin(alpha) * math.sin(beta), math.sin(alpha) * math.cos(beta), math.cos(alpha)))
        out[layout.BY_BETA] = by_u * dot(d, (-math.cos(alpha) * math.cos(beta), math.cos(alpha) * math.sin(beta), 0.0))
        out[layout.BY_RADIUS] = s.phi - s.sine
    for c in range(3):
        out[layout.BY_BASE + c] = -e[c]
    tangent, axial, travel = cable[layout.TANGENT], cable[layout.AXIAL], cable[layout.TRAVEL]
    a = axial + travel * k
    aside, slant = drum_way(tangent, a)
    aside_begun, slant_begun = drum_way(tangent, axial)
    out[layout.BY_SCALE] = (cable[layout.COUNT_LENGTH] - travel * slant) * k / scale_factor
    out[layout.BY_TANGENT] = aside - aside_begun
    out[layout.BY_AXIAL] = slant - slant_begun
    out[layout.BY_PITCH] = slant * k / cable[layout.TURN_COUNTS]
    inward = rotate_back(q4, e)
    for c in range(3):
        out[layout.BY_ATTACHMENT + c] = inward[c]


@strict_kernel
def length_gradients(cables: FloatArray, poses: FloatArray, counts: FloatArray, scales: FloatArray) -> FloatArray:
    """(n, m, layout.WIDTH) derivatives of F(pose) - D(k) by `PARAMETERS`, for (n, m) true counts and (m,) decoding scales."""
    out = np.empty((poses.shape[0], cables.shape[0], layout.WIDTH))
    for sample in range(poses.shape[0]):
        for j in range(cables.shape[0]):
            if cables[j, layout.KIND] == layout.CABLE:
                length_gradient(cables[j], poses[sample], counts[sample, j], scales[j], out[sample, j])
            elif is_external(cables[j, layout.KIND]):
                external_gradient(cables[j], poses[sample], counts[sample, j], scales[j], out[sample, j])
            else:
                sensor_gradient(cables[j], poses[sample], counts[sample, j], scales[j], out[sample, j])
    return out
