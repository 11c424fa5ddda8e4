"""Effects of temperature, tension and weight on the length of a cable.

A count is a piece of cable with a temperature, a strain and a weight. S is the length of the free cable, drum to
attachment point, as it would be unstrained at the reference temperature. With e, d, f = 1 + coefficient * (T - T_ref) of cable, drum and
frame, tension tau(k) at the drum and tau_m in the middle of the free span,

    S(P, k, T) = [(h(k) + G + R phi) / (1 + tau/EA) + arc(t, tau_m) / (1 + tau_m/EA)] / e

where h, R phi and t are those of `kernels.cable` with B, the drum's distances and the cable G between the fixed pulley and B scaled by f,
the pulley scaled by d. Friction holds what is wound: a turn keeps the material it was wound with, d and e at the temperature of the zero
pose and the tension either of the drum at that turn or one stated for the winding, so that counts and lengths belong together by

    S(P, k, T) - S(P0, k0, T0) = integral from k0 to k of c d(T0) / (e(T0) (1 + tau_w/EA)) dk.

With one tension everywhere and one temperature this is the equation of `kernels.cable`: a constant strain is wound and unwound alike.

The arc is that of a hanging cable without an approximation for small sag. Of a catenary of length s over the horizontal distance H and
the height V, whose tensions at its ends are tau and tau + w V, it holds that (tau + w V/2) * 2 = w s coth x and s^2 = V^2 + (H
sinh(x)/x)^2 with x = w H/2 over the horizontal tension (Irvine, Cable Structures, 1981, ch. 1; the first by adding the tensions at both
ends). The parabola's (w cos)^2 L^3 / (24 tau_m^2) is the first term. Neglected: the strain is taken at the mean tension, and the
pulley keeps the angle of the straight span, both of second order in the sag's angle (`docs/physical-effects.md` has the figures).

Columns: `kernels.layout`.
"""

import math

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import layout
from lmeasure.kernels.cable import drum_change, leaving, span
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.vector import Vec3, add, norm, orientation, rotate, scale, sub, vec

_ARC_STEPS = 30


@inline
def arc_length(across: float, height: float, weight: float, tension: float) -> float:
    """Length of a cable of that weight per length whose ends are so far apart, horizontally and in height, when its mean end tension is
    tension; NaN where it cannot be held by that tension."""
    chord = math.sqrt(across * across + height * height)
    if weight == 0.0:
        return chord
    s = chord
    for _ in range(_ARC_STEPS):
        y = weight * s / (2.0 * tension)
        if not 0.0 <= y < 0.9:
            return math.nan
        x = 0.5 * math.log((1.0 + y) / (1.0 - y))
        stretched = across * (math.sinh(x) / x if x > 1e-4 else 1.0 + x * x / 6.0)
        longer = math.sqrt(height * height + stretched * stretched)
        done = abs(longer - s) <= 1e-15 * s
        s = longer
        if done:
            break
    return s


@inline
def material_length(cable: FloatArray, effect: FloatArray, point: Vec3, k: float, warm: float) -> float:
    """S [mm] for an attachment point in the base frame, k counts paid out and a temperature warm [K] above the reference; NaN where the
    cable cannot run or carries no tension."""
    e, d, f = (
        1.0 + effect[layout.CABLE_EXPANSION] * warm,
        1.0 + effect[layout.DRUM_EXPANSION] * warm,
        1.0 + effect[layout.FRAME_EXPANSION] * warm,
    )
    base, u, radius = scale(f, vec(cable, layout.BASE)), vec(cable, layout.GUIDE), d * cable[layout.RADIUS]
    away = sub(point, base)
    if radius == 0.0:
        wrapped, straight = 0.0, norm(away)
        way = scale(1.0 / straight, away)
    else:
        s = leaving(away, u, radius)
        wrapped, straight, way = radius * s.phi, s.t, s.e
    rise = straight * way[2]
    tension = effect[layout.TENSION] + effect[layout.TENSION_RISE] * cable[layout.COUNT_LENGTH] * k
    middle = tension + 0.5 * effect[layout.WEIGHT] * rise
    arc = straight
    if effect[layout.WEIGHT] > 0.0:
        arc = arc_length(math.sqrt(max(straight * straight - rise * rise, 0.0)), rise, effect[layout.WEIGHT], middle)
    if effect[layout.COMPLIANCE] > 0.0 and not min(tension, middle) > 0.0:
        return math.nan
    # the frame carries the drum's mounting with it
    tangent, axial = f * cable[layout.TANGENT], f * cable[layout.AXIAL] + cable[layout.TRAVEL] * k
    inner = math.sqrt(tangent * tangent + axial * axial) + f * effect[layout.GUIDE_LENGTH] + wrapped
    return (inner / (1.0 + tension * effect[layout.COMPLIANCE]) + arc / (1.0 + middle * effect[layout.COMPLIANCE])) / e


@inline
def wound_length(cable: FloatArray, effect: FloatArray, k: float, warm_zero: float) -> float:
    """Material [mm] on the first k counts, wound at the zero pose's temperature."""
    per_count = (
        cable[layout.COUNT_LENGTH] * (1.0 + effect[layout.DRUM_EXPANSION] * warm_zero) / (1.0 + effect[layout.CABLE_EXPANSION] * warm_zero)
    )
    if not math.isnan(effect[layout.WINDING_TENSION]):
        return k * per_count / (1.0 + effect[layout.WINDING_TENSION] * effect[layout.COMPLIANCE])
    strain = 1.0 + effect[layout.TENSION] * effect[layout.COMPLIANCE]
    # integral of 1 / (strain + rate k): k log(1 + z)/z / strain
    z = effect[layout.TENSION_RISE] * cable[layout.COUNT_LENGTH] * effect[layout.COMPLIANCE] * k / strain
    mean = math.log1p(z) / z if abs(z) > 1e-12 else 1.0 - 0.5 * z
    return k * per_count * mean / strain


@kernel
def excesses(
    cables: FloatArray,
    effects: FloatArray,
    zeros: FloatArray,
    zero_counts: FloatArray,
    poses: FloatArray,
    counts: FloatArray,
    warm_zero: FloatArray,
    warm: FloatArray,
) -> FloatArray:
    """(n, m) contribution of the effects to modelled minus measured change of each cable [mm]: E such that F(P) - F(P0) + E = D(k) - D(k0).

    cables (m, columns), effects (m, columns); zeros (m, 7) pose, zero_counts (m,) count and warm_zero (m,) [K above the reference]
    at which each cable's equation starts; poses (n, 7), true counts (n, m), warm (n, m).
    NaN where a cable cannot run or carries no tension.
    """
    n, m = counts.shape
    out = np.empty_like(counts)
    for j in range(m):
        cable, effect = cables[j], effects[j]
        base, u, radius = vec(cable, layout.BASE), vec(cable, layout.GUIDE), cable[layout.RADIUS]
        point0 = add(vec(zeros[j], layout.PLACE), rotate(orientation(zeros[j]), vec(cable, layout.ATTACHMENT)))
        F0 = span(point0, base, u, radius)[0]
        k0 = zero_counts[j]
        S0 = material_length(cable, effect, point0, k0, warm_zero[j])
        W0 = wound_length(cable, effect, k0, warm_zero[j])
        D0 = drum_change(k0, cable[layout.TANGENT], cable[layout.AXIAL], cable[layout.TRAVEL], cable[layout.COUNT_LENGTH])
        for i in range(n):
            k = counts[i, j]
            point = add(vec(poses[i], layout.PLACE), rotate(orientation(poses[i]), vec(cable, layout.ATTACHMENT)))
            F = span(point, base, u, radius)[0]
            S = material_length(cable, effect, point, k, warm[i, j])
            W = wound_length(cable, effect, k, warm_zero[j])
            D = drum_change(k, cable[layout.TANGENT], cable[layout.AXIAL], cable[layout.TRAVEL], cable[layout.COUNT_LENGTH])
            # unstrained material back to the length it has there, so that a millimetre is one of the modelled length
            tension = effect[layout.TENSION] + effect[layout.TENSION_RISE] * cable[layout.COUNT_LENGTH] * k
            here = (1.0 + effect[layout.CABLE_EXPANSION] * warm[i, j]) * (1.0 + tension * effect[layout.COMPLIANCE])
            out[i, j] = ((S - S0) - (W - W0)) * here - ((F - F0) - (D - D0))
    return out
