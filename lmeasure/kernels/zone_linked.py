"""The calibration's part in the zone's lane kernel: what each column of the rig parameters' covariance factor does to the lengths, and
the lengths to the pose. The same formulas as `kernels.cable.length_gradient` and `kernels.zone.add_systematic`, LANES places at a time."""

import math

from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.kernels import inline, layout, strict_kernel
from lmeasure.kernels.cable import drum_count, length_gradients, span_lengths
from lmeasure.kernels.vector import Vec3, add, dot, scale, sub
from lmeasure.kernels.zone_rows import LANES, PLACE, SPAN_ROWS, angle, at, put, vec

Linked = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray]

LENGTH = layout.WIDTH  # row of a cable's length behind those of its derivatives

strict_gradients, strict_lengths = strict_kernel(length_gradients), strict_kernel(span_lengths)


@inline
def add_shift(B: FloatArray, row: int, C: FloatArray, D: FloatArray) -> None:
    """Add the square of what shifts D (6, LANES) of the lengths do by the columns at `row` to C: xx, yy, zz, xy, xz, yz."""
    for lane in range(LANES):
        s = scale(D[lane], at(B, row, lane))
        s = add(s, scale(D[LANES + lane], at(B, row + 3, lane)))
        s = add(s, scale(D[2 * LANES + lane], at(B, row + 6, lane)))
        s = add(s, scale(D[3 * LANES + lane], at(B, row + 9, lane)))
        s = add(s, scale(D[4 * LANES + lane], at(B, row + 12, lane)))
        s = add(s, scale(D[5 * LANES + lane], at(B, row + 15, lane)))
        C[lane] += s[0] * s[0]
        C[LANES + lane] += s[1] * s[1]
        C[2 * LANES + lane] += s[2] * s[2]
        C[3 * LANES + lane] += s[0] * s[1]
        C[4 * LANES + lane] += s[0] * s[2]
        C[5 * LANES + lane] += s[1] * s[2]


@inline
def _gradient(
    H: FloatArray, B: FloatArray, S: FloatArray, offset: Vec3, cable: FloatArray, by_alpha: Vec3, by_beta: Vec3, turn: FloatArray
) -> None:
    """Derivatives of a cable's length by what `kernels.cable.length_gradient` knows but the drum, into rows of H in the order of
    `PARAMETERS`, and the length itself into row LENGTH. by_alpha, by_beta: derivatives of the guide; turn (3, 3): base_from_tool."""
    u, radius = vec(cable, layout.GUIDE), cable[layout.RADIUS]
    bent = 1.0 if radius > 0.0 else 0.0
    x_axis, y_axis, z_axis = (
        (turn[0, 0], turn[1, 0], turn[2, 0]),
        (turn[0, 1], turn[1, 1], turn[2, 1]),
        (turn[0, 2], turn[1, 2], turn[2, 2]),
    )
    for lane in range(LANES):
        d = add(at(B, PLACE, lane), offset)
        q = dot(d, u)
        n = sub(d, scale(q, u))
        p = math.sqrt(dot(n, n))
        x = p - radius
        square = x * x + q * q
        t = math.sqrt(square - radius * radius)
        sine, cosine = q * radius + x * t, q * t - x * radius
        phi, k = angle(sine, cosine, p * square)
        sine, cosine = sine * (k * p), cosine * (k * p)
        by_guide = bent * (cosine - sine * q * (k * square))
        e = at(S, 0, lane)
        put(H, layout.BY_BASE, lane, scale(-1.0, e))
        H[layout.BY_ALPHA * LANES + lane], H[layout.BY_BETA * LANES + lane] = by_guide * dot(d, by_alpha), by_guide * dot(d, by_beta)
        H[layout.BY_RADIUS * LANES + lane] = phi - sine
        put(H, layout.BY_ATTACHMENT, lane, (dot(e, x_axis), dot(e, y_axis), dot(e, z_axis)))
        H[LENGTH * LANES + lane] = radius * phi + t


@inline
def _drum_gradient(H: FloatArray, cable: FloatArray, zero: float, factor: float) -> None:
    """The derivatives by the counter's scale and the drum's dimensions, for the length in row LENGTH and that at the zero pose."""
    tangent, axial, travel = cable[layout.TANGENT], cable[layout.AXIAL], cable[layout.TRAVEL]
    count_length, turn = cable[layout.COUNT_LENGTH], cable[layout.TURN_COUNTS]
    for lane in range(LANES):
        k = drum_count(H[LENGTH * LANES + lane] - zero, tangent, axial, travel, count_length)
        a = axial + travel * k
        h, h0 = math.sqrt(tangent * tangent + a * a), math.sqrt(tangent * tangent + axial * axial)
        runs = h > 0.0 and h0 > 0.0
        H[layout.BY_SCALE * LANES + lane] = (count_length - (travel * a / h if runs else 0.0)) * k / factor
        H[layout.BY_TANGENT * LANES + lane] = tangent / h - tangent / h0 if runs else 0.0
        H[layout.BY_AXIAL * LANES + lane] = a / h - axial / h0 if runs else 0.0
        H[layout.BY_PITCH * LANES + lane] = a / h * k / turn if runs else 0.0


@inline
def _by_point(D: FloatArray, H: FloatArray, f0: float, f1: float, f2: float, f3: float, f4: float) -> None:
    """Shifts of a length by the first five parameters, an observation point's place and guide, which most calibrations are about."""
    for lane in range(LANES):
        shift = H[lane] * f0 + H[LANES + lane] * f1 + H[2 * LANES + lane] * f2
        D[lane] = shift + H[3 * LANES + lane] * f3 + H[4 * LANES + lane] * f4


@inline
def _add_part(D: FloatArray, H: FloatArray, factor: float) -> None:
    """Add another parameter's part to the shifts of a length."""
    for lane in range(LANES):
        D[lane] += H[lane] * factor


@inline
def shifts(
    D: FloatArray, H: FloatArray, B: FloatArray, S: FloatArray, arms: FloatArray, cables: FloatArray, linked: Linked, used: BoolArray,
    turn: FloatArray,
) -> None:  # fmt: skip
    """Shifts (columns, 6, LANES) of the changes of length since the zero pose by each column of the parameters' factor, whose rows that
    are not zero are `used`."""
    factor, at_start, zero, scales, guides = linked
    columns = factor.shape[1]
    for j in range(6):
        offset = sub(vec(arms[j], 0), vec(cables[j], layout.BASE))
        _gradient(H, B, S[j * SPAN_ROWS * LANES :], offset, cables[j], vec(guides[j], 0), vec(guides[j], 3), turn)
        first = layout.WIDTH * j
        own = used[first : first + layout.WIDTH]
        if own[layout.BY_SCALE] or own[layout.BY_TANGENT] or own[layout.BY_AXIAL] or own[layout.BY_PITCH]:
            _drum_gradient(H, cables[j], zero[j], scales[j])
        # a parameter moves the length at the pose and at the zero pose
        for c in range(layout.WIDTH):
            for lane in range(LANES):
                H[c * LANES + lane] -= at_start[j, c]
        for column in range(columns):
            f = factor[first : first + layout.BY_RADIUS, column]
            _by_point(D[(column * 6 + j) * LANES :], H, f[0], f[1], f[2], f[3], f[4])
        for c in range(layout.BY_RADIUS, layout.WIDTH):
            for column in range(columns if used[first + c] else 0):
                _add_part(D[(column * 6 + j) * LANES :], H[c * LANES :], factor[first + c, column])
