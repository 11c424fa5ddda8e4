"""Scan of an accuracy zone: for each place of the tool origin the worst figures over all orientations, by the pivoted scalar way.

The scan measures; limits are applied to its figures afterwards, so that one scan serves any limit. A pose where a cable cannot run, or
where the cables do not determine the pose, has an infinite speed of an attachment point (a pressure angle of 90 degrees) and an infinite
uncertainty. `kernels.zone_lanes` gives the same figures faster and leaves the difficult places to this kernel.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels import layout
from lmeasure.kernels.cable import drum_count, leaving, length_gradient, span_at
from lmeasure.kernels.clearance import span_clearance
from lmeasure.kernels.decorators import inline, slow_to_compile, strict_kernel
from lmeasure.kernels.gaussian import radius_95
from lmeasure.kernels.least_squares import length_twists
from lmeasure.kernels.screw import CABLES, attachment_speed, invert, platform_size
from lmeasure.kernels.vector import Vec3, add, dot, orientation, rotate, scale, sub, vec

FIGURES = (
    "speed2",  # largest squared speed of an attachment point when only its own cable changes at unit rate, at least 1: 1/cos^2
    "u95_position",  # 95 % radius [mm] of the tool origin
    "u95_rotation",  # 95 % radius [rad] of the rotation vector
    "u95_attachment",  # 95 % radius [mm] of the worst attachment point
    "shortest",  # cable, B to attachment point [mm]
    "longest",
    "wrap",  # largest wrapped angle [rad]
    "determinant_low",  # of six rows (arm x e / size ; e), extremes over the orientations
    "determinant_high",
    "norm2",  # largest squared Frobenius norm of the rows' inverse, of more than six their pseudo-inverse
    "clearance",  # least distance between cables, and from cable to body surface [mm]
)
SPEED2, U95_POSITION, U95_ROTATION, U95_ATTACHMENT, SHORTEST, LONGEST, WRAP, DET_LOW, DET_HIGH, NORM2, CLEARANCE = range(len(FIGURES))
WORST_START = (1.0, 0.0, 0.0, 0.0, math.inf, 0.0, 0.0, math.inf, -math.inf, 0.0, math.inf)

CANNOT_RUN, SINGULAR = 1, 2


@inline
def parameter_changes(
    cables: FloatArray, pose: FloatArray, zero: FloatArray, at_start: FloatArray, scales: FloatArray, here: FloatArray
) -> None:
    """Derivatives of the m changes of length since the zero pose by the rig's parameters, into here (m, WIDTH).

    A parameter moves the length at the pose *and* at the pose where the counters were zeroed (lengths zero (m,), derivatives at_start).
    """
    for j in range(len(cables)):
        change = span_at(cables[j], pose)[0] - zero[j]
        drum = cables[j]
        k = drum_count(change, drum[layout.TANGENT], drum[layout.AXIAL], drum[layout.TRAVEL], drum[layout.COUNT_LENGTH])
        length_gradient(drum, pose, k, scales[j], here[j])
        for c in range(layout.WIDTH):
            here[j, c] -= at_start[j, c]


@inline
def add_systematic(here: FloatArray, factor: FloatArray, twists: FloatArray, C: FloatArray) -> None:
    """Add the calibration's part to the covariance C (6, 6) of (rotation; tool origin): the parameters' covariance is factor @ factor.T."""
    for column in range(factor.shape[1]):
        shift = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
        for j in range(len(here)):
            dl = 0.0
            for c in range(layout.WIDTH):
                dl += here[j, c] * factor[layout.WIDTH * j + c, column]
            shift = (
                shift[0] + twists[0, j] * dl,
                shift[1] + twists[1, j] * dl,
                shift[2] + twists[2, j] * dl,
                shift[3] + twists[3, j] * dl,
                shift[4] + twists[4, j] * dl,
                shift[5] + twists[5, j] * dl,
            )
        for a in range(6):
            for b in range(6):
                C[a, b] += shift[a] * shift[b]


@inline
def radius_at(C: FloatArray, arm: Vec3) -> float:
    """95 % radius of a body point at the arm from the tool origin, from the covariance C (6, 6) of (rotation; tool origin).

    The point moves by t + w x arm = [ -[arm] I ] (w; t).
    """
    x, y, z = arm
    J = ((0.0, z, -y, 1.0, 0.0, 0.0), (-z, 0.0, x, 0.0, 1.0, 0.0), (y, -x, 0.0, 0.0, 0.0, 1.0))
    m = (_form(C, J[0], J[0]), _form(C, J[1], J[1]), _form(C, J[2], J[2]))
    return radius_95(m[0], m[1], m[2], _form(C, J[0], J[1]), _form(C, J[0], J[2]), _form(C, J[1], J[2]))


@inline
def _form(C: FloatArray, a: tuple[float, ...], b: tuple[float, ...]) -> float:
    s = 0.0
    for i in range(6):
        t = 0.0
        for k in range(6):
            t += C[i, k] * b[k]
        s += a[i] * t
    return s


@inline
def clearance_at(cables: FloatArray, pose: FloatArray, pairs: IntArray, bodies: FloatArray) -> float:
    """Least distance [mm] between the free spans of the pairs of cables, and from any free span to a body's surface."""
    least = math.inf
    for k in range(pairs.shape[0]):
        p, e, t = _free_span(cables[pairs[k, 0]], pose)
        q, f, u = _free_span(cables[pairs[k, 1]], pose)
        gap = span_clearance(sub(p, q), e, t, f, u, 0.0)
        least = gap if gap < least else least
    for k in range(bodies.shape[0]):
        # a body of the tool turns and moves with it; one of the base is at rest
        start, way = vec(bodies[k], layout.BODY_START), vec(bodies[k], layout.BODY_WAY)
        if bodies[k, layout.BODY_OF_TOOL] > 0.0:
            start, way = add(vec(pose, layout.PLACE), rotate(orientation(pose), start)), rotate(orientation(pose), way)
        for j in range(len(cables)):
            p, e, t = _free_span(cables[j], pose)
            gap = span_clearance(sub(p, start), e, t, scale(-1.0, way), bodies[k, layout.BODY_LENGTH], bodies[k, layout.BODY_RADIUS])
            least = gap if gap < least else least
    return least


@inline
def _free_span(cable: FloatArray, pose: FloatArray) -> tuple[Vec3, Vec3, float]:
    """(attachment point, unit direction, straight part) of a cable."""
    point = add(vec(pose, layout.PLACE), rotate(orientation(pose), vec(cable, layout.ATTACHMENT)))
    if cable[layout.RADIUS] == 0.0:
        length, e, _ = span_at(cable, pose)
        return point, e, length
    s = leaving(sub(point, vec(cable, layout.BASE)), vec(cable, layout.GUIDE), cable[layout.RADIUS])
    return point, s.e, s.t


@inline
def _wrapped(cable: FloatArray, pose: FloatArray) -> float:
    """Wrapped angle [rad]; for a straight cable the angle between its guide and the cable, the limit of a vanishing pulley."""
    point = add(vec(pose, layout.PLACE), rotate(orientation(pose), vec(cable, layout.ATTACHMENT)))
    return leaving(sub(point, vec(cable, layout.BASE)), vec(cable, layout.GUIDE), cable[layout.RADIUS]).phi


@strict_kernel
def around(cables: FloatArray, poses: FloatArray, pairs: IntArray, bodies: FloatArray) -> FloatArray:
    """(n, 2) at (n, 7) poses: largest wrapped angle [rad], and least distance [mm] of pairs of cables and of cables from bodies."""
    out = np.empty((len(poses), 2))
    for i in range(len(poses)):
        out[i, 0] = 0.0
        for j in range(len(cables)):
            out[i, 0] = max(out[i, 0], _wrapped(cables[j], poses[i]))
        out[i, 1] = clearance_at(cables, poses[i], pairs, bodies)
    return out


@inline
def _norm2(twists: FloatArray, size: float) -> float:
    """Squared Frobenius norm of twists per unit of length, turns times size."""
    norm2 = 0.0
    for j in range(twists.shape[1]):
        turn, move = (twists[0, j], twists[1, j], twists[2, j]), (twists[3, j], twists[4, j], twists[5, j])
        norm2 += size * size * dot(turn, turn) + dot(move, move)
    return norm2


@slow_to_compile
def scan(
    cables: FloatArray,
    positions: FloatArray,
    quaternions: FloatArray,
    variance: FloatArray,
    weights: FloatArray,
    scales: FloatArray,
    factor: FloatArray,
    start: FloatArray,
    points: FloatArray,
    pairs: IntArray,
    bodies: FloatArray,
) -> tuple[FloatArray, IntArray]:
    """Worst figures at (n, 3) positions of the tool origin over (k, 4) orientations x, y, z, w, all in the base frame.

    cables (m, columns), six or more; variance (m,) of the lengths' own errors [mm^2]; weights (m,), at most 1, of the
    residuals of more than six; scales (m,) decoding factors; factor (m WIDTH, r) with factor @ factor.T the rig parameters' covariance
    (r = 0: not linked); start (7,) pose at which the counters are zeroed; points (p, 3) attachment points in the tool frame whose
    uncertainty is asked (p = 0: neither theirs nor the rotation's); pairs (c, 2) of cables whose distance is asked; bodies.
    Returns (F, n) figures in the order of `FIGURES` and (n,) flags CANNOT_RUN and SINGULAR. More than six rows have no determinant: its
    extremes stay infinite.
    """
    n, m = positions.shape[0], cables.shape[0]
    out, flags = np.empty((len(WORST_START), n)), np.zeros(n, np.int64)
    size, six = platform_size(cables), m == CABLES
    J, twists, C = np.empty((CABLES, CABLES)), np.empty((6, m)), np.empty((6, 6))
    free, equal, spare = np.arange(6), np.ones(m), np.empty(m)
    here, at_start = np.empty((m, layout.WIDTH)), np.empty((m, layout.WIDTH))
    zero, pose = np.empty(m), np.empty(layout.POSE_COLUMNS)
    for j in range(m):
        zero[j] = span_at(cables[j], start)[0]
        length_gradient(cables[j], start, 0.0, scales[j], at_start[j])
    for i in range(n):
        for f in range(len(WORST_START)):
            out[f, i] = WORST_START[f]
        for o in range(quaternions.shape[0]):
            for c in range(3):
                pose[layout.PLACE + c] = positions[i, c]
            for c in range(4):
                pose[layout.ORIENTATION + c] = quaternions[o, c]
            runs = True
            for j in range(m):
                length = span_at(cables[j], pose)[0]
                runs &= not math.isnan(length)
                out[SHORTEST, i] = min(out[SHORTEST, i], length)
                out[LONGEST, i] = max(out[LONGEST, i], length)
                out[WRAP, i] = max(out[WRAP, i], _wrapped(cables[j], pose))
            known, det, norm2 = False, 0.0, 0.0
            if runs and six:
                det = invert(cables, pose, J, twists, size)
                known, norm2 = det != 0.0, _norm2(twists, size)
            elif runs:
                # the norm is that of the rows as they are, whatever the weights
                known = length_twists(cables, pose, equal, free, size, zero, twists, spare)
                norm2 = _norm2(twists, size)
                known = known and length_twists(cables, pose, weights, free, size, zero, twists, spare)
            if runs and six:
                out[DET_LOW, i], out[DET_HIGH, i] = min(out[DET_LOW, i], det), max(out[DET_HIGH, i], det)
            if not known:
                flags[i] |= SINGULAR if runs else CANNOT_RUN
                out[SPEED2, i], out[NORM2, i] = math.inf, math.inf
                out[U95_POSITION, i], out[U95_ROTATION, i], out[U95_ATTACHMENT, i] = math.inf, math.inf, math.inf
                continue
            out[NORM2, i] = max(out[NORM2, i], norm2)
            for j in range(m):
                speed = attachment_speed(cables, pose, twists, j)
                out[SPEED2, i] = max(out[SPEED2, i], speed * speed)
            for a in range(6):
                for b in range(6):
                    s = 0.0
                    for j in range(m):
                        s += twists[a, j] * variance[j] * twists[b, j]
                    C[a, b] = s
            if factor.shape[1] > 0:
                parameter_changes(cables, pose, zero, at_start, scales, here)
                add_systematic(here, factor, twists, C)
            out[U95_POSITION, i] = max(out[U95_POSITION, i], radius_at(C, (0.0, 0.0, 0.0)))
            if points.shape[0] > 0:
                rotation = radius_95(C[0, 0], C[1, 1], C[2, 2], C[0, 1], C[0, 2], C[1, 2])
                out[U95_ROTATION, i] = max(out[U95_ROTATION, i], rotation)
                for k in range(points.shape[0]):
                    worst = radius_at(C, rotate(orientation(pose), vec(points[k], 0)))
                    out[U95_ATTACHMENT, i] = max(out[U95_ATTACHMENT, i], worst)
            if pairs.shape[0] > 0 or bodies.shape[0] > 0:
                out[CLEARANCE, i] = min(out[CLEARANCE, i], clearance_at(cables, pose, pairs, bodies))
    return out, flags
