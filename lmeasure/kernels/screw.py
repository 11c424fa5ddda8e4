"""The screw method: one pose from six lengths, and a run of them by continuation.

Thesis 5.6: solve P Phi = dl with the Pluecker coordinates of the free spans, displace the body by the *finite* twist Phi, find the
tangent points and lengths again, repeat with the residuals until they are below a tolerance. As the row of a cable is the exact
gradient of its length (wrap included), the step is Newton's. Rows and twists are taken about the tool origin, not the base origin:
the determinant and the displacement are the same, the conditioning is better.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray, Status
from lmeasure.kernels.cable import span_at
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.layout import ATTACHMENT, CHANGES, ORIENTATION, PLACE, POSE_COLUMNS
from lmeasure.kernels.se3 import exp_rotation, exp_translation
from lmeasure.kernels.vector import add, cross, multiply, orientation, rotate, vec

# plain integers: numba would hand members of the enumeration back as objects, at the price of a whole sample
OK, SINGULAR, NOT_CONVERGED = int(Status.OK), int(Status.SINGULAR), int(Status.NOT_CONVERGED)
GAP, JUMP, SLACK = int(Status.GAP), int(Status.JUMP), int(Status.SLACK)
OTHER_ASSEMBLY, INCONSISTENT, ORIGIN_LOST = int(Status.OTHER_ASSEMBLY), int(Status.INCONSISTENT), int(Status.ORIGIN_LOST)

CABLES = 6
TOLERANCE_MM = 1e-11  # a hundred units in the last place of a metre: Newton's last step leaves a far smaller residual
MAX_ITERATIONS = 30
STRIDE_MM = 10.0  # longest change of a cable that one Newton start is asked to bridge; more is gone in parts
ON_THE_WAY_MM = 0.5  # residual at which a part that is not the last ends
LOST = CHANGES + CABLES  # index in a run's state: 1 if it was lost near a singular pose
STATE = LOST + 1
SINGULAR_PIVOT = 1e-7  # of the rows scaled to unit size: a count moves the pose by kilometres
MAX_STEP_ROTATION = 0.5  # rad
NEAR_SINGULAR = math.radians(80.0)  # worst pressure angle from which a change of the determinant's sign is looked for
LOOK_AHEAD = 2.0  # steps of the motion
COVERAGE = 3.0  # standard deviations of the lengths


@inline
def copy(source: FloatArray, target: FloatArray) -> None:
    """target[:] = source; the slice assignment would compile the text of an error that cannot happen."""
    for c in range(len(source)):
        target[c] = source[c]


@kernel
def _fill(cables: FloatArray, pose: FloatArray, targets: FloatArray, J: FloatArray, r: FloatArray, size: float) -> float:
    """Rows (arm x e / size ; e) into J, residuals target - length into r; the largest absolute residual."""
    worst = 0.0
    for j in range(CABLES):
        length, e, arm = span_at(cables[j], pose)
        moment = cross(arm, e)
        for c in range(3):
            J[j, c] = moment[c] / size
            J[j, 3 + c] = e[c]
        r[j] = targets[j] - length
        # written so that NaN is the worst of all
        if not abs(r[j]) <= worst:
            worst = abs(r[j])
    return worst


@kernel
def eliminate(A: FloatArray, B: FloatArray, least: float = SINGULAR_PIVOT) -> float:
    """Solve A X = B in place by elimination with row pivots (X in B); the determinant of A, or 0 when a pivot is least or less."""
    n, m = A.shape[0], B.shape[1]
    det = 1.0
    for i in range(n):
        best = i
        for k in range(i + 1, n):
            if abs(A[k, i]) > abs(A[best, i]):
                best = k
        if best != i:
            for c in range(n):
                A[i, c], A[best, c] = A[best, c], A[i, c]
            for c in range(m):
                B[i, c], B[best, c] = B[best, c], B[i, c]
            det = -det
        pivot = A[i, i]
        if not abs(pivot) > least:
            return 0.0
        det *= pivot
        for k in range(i + 1, n):
            f = A[k, i] / pivot
            if f != 0.0:
                for c in range(i + 1, n):
                    A[k, c] -= f * A[i, c]
                for c in range(m):
                    B[k, c] -= f * B[i, c]
    for i in range(n - 1, -1, -1):
        for c in range(m):
            s = B[i, c]
            for k in range(i + 1, n):
                s -= A[i, k] * B[k, c]
            B[i, c] = s / A[i, i]
    return det


@kernel
def displace(pose: FloatArray, x: FloatArray, size: float) -> None:
    """Displace the pose by the finite twist (x[0:3]/size ; x[3:6]) about the tool origin, at most MAX_STEP_ROTATION of it."""
    omega = (x[0] / size, x[1] / size, x[2] / size)
    v = (x[3], x[4], x[5])
    turn = math.sqrt(omega[0] * omega[0] + omega[1] * omega[1] + omega[2] * omega[2])
    if turn > MAX_STEP_ROTATION:
        f = MAX_STEP_ROTATION / turn
        omega = (f * omega[0], f * omega[1], f * omega[2])
        v = (f * v[0], f * v[1], f * v[2])
    position = add(vec(pose, PLACE), exp_translation(omega, v))
    q = multiply(exp_rotation(omega), orientation(pose))
    f = 1.0 / math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    for c in range(3):
        pose[PLACE + c] = position[c]
    for c in range(4):
        pose[ORIENTATION + c] = f * q[c]


@inline
def go_on(behind: FloatArray, pose: FloatArray, steps: float) -> None:
    """Move a pose (in place) by a multiple of its motion from the previous one, to first order."""
    aligned, square = 0.0, 0.0
    for c in range(ORIENTATION, POSE_COLUMNS):
        aligned += pose[c] * behind[c]
    sign = 1.0 if aligned >= 0.0 else -1.0
    for c in range(POSE_COLUMNS):
        pose[c] += steps * (pose[c] - (sign if c >= ORIENTATION else 1.0) * behind[c])
    for c in range(ORIENTATION, POSE_COLUMNS):
        square += pose[c] * pose[c]
    for c in range(ORIENTATION, POSE_COLUMNS):
        pose[c] /= math.sqrt(square)


@kernel
def newton(
    cables: FloatArray, targets: FloatArray, tolerance: float, pose: FloatArray, J: FloatArray, r: FloatArray, size: float
) -> tuple[int, int, float]:
    """Move the pose (in place) until the six lengths are the targets within the tolerance: (status, iterations, largest residual).

    When OK, J holds the rows at the pose that was found.
    """
    previous = math.inf
    for iteration in range(MAX_ITERATIONS):
        worst = _fill(cables, pose, targets, J, r[:, 0], size)
        # rounding floor: when the residual is tiny and no longer falls there is nothing left to gain
        if worst <= tolerance or (worst < 1e-9 and worst >= 0.5 * previous):
            return OK, iteration, worst
        if not worst < 1e9:
            return NOT_CONVERGED, iteration, worst
        previous = worst
        if eliminate(J, r) == 0.0:
            return SINGULAR, iteration, worst
        displace(pose, r[:, 0], size)
    return NOT_CONVERGED, MAX_ITERATIONS, worst


@inline
def platform_size(cables: FloatArray) -> float:
    """Length that makes rotations comparable with translations: the largest arm of an attachment point [mm]."""
    size = 1e-3
    for j in range(cables.shape[0]):
        p = vec(cables[j], ATTACHMENT)
        size = max(size, math.sqrt(p[0] * p[0] + p[1] * p[1] + p[2] * p[2]))
    return size


@kernel
def _invert_rows(J: FloatArray, inverse: FloatArray, size: float) -> float:
    """`invert` for rows that are already in J, which is used up."""
    for j in range(CABLES):
        for c in range(CABLES):
            inverse[j, c] = 1.0 if c == j else 0.0
    det = eliminate(J, inverse)
    for c in range(CABLES):
        for k in range(3):
            inverse[k, c] /= size
    return det


@kernel
def invert(cables: FloatArray, pose: FloatArray, J: FloatArray, inverse: FloatArray, size: float) -> float:
    """Inverse of the rows about the tool origin into `inverse` (6, 6): column i is the unit-rate twist of cable i, (omega; v).

    Returns the determinant of the rows with moments divided by size (its sign shows the assembly); 0 when singular.
    """
    for j in range(CABLES):
        _, e, arm = span_at(cables[j], pose)
        moment = cross(arm, e)
        for c in range(3):
            J[j, c] = moment[c] / size
            J[j, 3 + c] = e[c]
    return _invert_rows(J, inverse, size)


@inline
def attachment_speed(cables: FloatArray, pose: FloatArray, inverse: FloatArray, i: int) -> float:
    """|v_i|: speed of cable i's attachment point per unit rate of cable i, the other lengths held; `inverse` is that of `invert`."""
    arm = rotate(orientation(pose), vec(cables[i], ATTACHMENT))
    omega = (inverse[0, i], inverse[1, i], inverse[2, i])
    v = add((inverse[3, i], inverse[4, i], inverse[5, i]), cross(omega, arm))
    return math.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2])


@kernel
def worst_pressure_angle(cables: FloatArray, pose: FloatArray, inverse: FloatArray) -> float:
    """Return the largest pressure-angle analogue [rad] of the cables at a pose (thesis 5.1, 5.7; `linkages.pressure_angles`).

    The angle between the free span e_i and the velocity v_i of its attachment point when only cable i changes. The unit-rate twist has
    e_i . v_i = 1, so the angle is arccos(1/|v_i|).
    """
    fastest = 1.0
    for i in range(CABLES):
        fastest = max(fastest, attachment_speed(cables, pose, inverse, i))
    return math.acos(1.0 / fastest)


@kernel
def pose_twists(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 6, 6) inverses of the rows at (n, 7) poses: column i is the twist (omega; v) about the tool origin per unit of length i; NaN
    where the pose is NaN or singular."""
    out = np.full((poses.shape[0], 6, CABLES), np.nan)
    J, inverse = np.empty((CABLES, CABLES)), np.empty((CABLES, CABLES))
    size = platform_size(cables)
    for i in range(poses.shape[0]):
        if not math.isnan(poses[i, 0]) and invert(cables, poses[i], J, inverse, size) != 0.0:
            for a in range(6):
                copy(inverse[a], out[i, a])
    return out


@kernel
def solve_pose(cables: FloatArray, targets: FloatArray, start: FloatArray) -> tuple[int, int, float, FloatArray]:
    """One pose from six lengths [mm], by the screw method from a start pose: (status, iterations, largest residual [mm], pose)."""
    pose = start.copy()
    J, r = np.empty((CABLES, CABLES)), np.empty((CABLES, 1))
    status, iterations, worst = newton(cables, targets, TOLERANCE_MM, pose, J, r, platform_size(cables))
    return status, iterations, worst, pose


@kernel
def solve_poses(cables: FloatArray, targets: FloatArray, starts: FloatArray) -> tuple[IntArray, FloatArray]:
    """`solve_pose` from (n, 7) starts: status (n,), poses (n, 7)."""
    poses, status = starts.copy(), np.empty(len(starts), np.int64)
    J, r = np.empty((CABLES, CABLES)), np.empty((CABLES, 1))
    size = platform_size(cables)
    for i in range(len(starts)):
        status[i] = newton(cables, targets, TOLERANCE_MM, poses[i], J, r, size)[0]
    return status, poses


@kernel
def _could_turn(
    cables: FloatArray, pose: FloatArray, u: FloatArray, side: float, probe: FloatArray, J: FloatArray, inverse: FloatArray, size: float
) -> bool:
    """Whether the determinant changes its sign within COVERAGE standard uncertainties of the pose, for lengths uncertain by u (6,) [mm].

    Near a singularity all columns of the inverse point along the one direction that the cables see badly: the probes go there.
    """
    total, largest, worst = 0.0, 0.0, 0
    for i in range(CABLES):
        s = 0.0
        for c in range(6):
            x = inverse[c, i] * (size if c < 3 else 1.0)
            s += x * x
        s = math.sqrt(s) * u[i]
        total += s * s
        if s > largest:
            largest, worst = s, i
    reach = COVERAGE * math.sqrt(total) / largest * u[worst]
    twist = np.empty(6)
    for c in range(6):
        twist[c] = inverse[c, worst] * reach
    for _ in range(2):
        copy(pose, probe)
        displace(probe, twist, 1.0)
        for c in range(6):
            twist[c] = -twist[c]
        if invert(cables, probe, J, inverse, size) * side <= 0.0:
            return True
    return False


@kernel
def _next_could_turn(
    cables: FloatArray,
    before: FloatArray,
    pose: FloatArray,
    side: float,
    probe: FloatArray,
    J: FloatArray,
    inverse: FloatArray,
    size: float,
) -> bool:
    """Whether the determinant changes its sign when the motion goes on by LOOK_AHEAD steps like the last one."""
    copy(pose, probe)
    go_on(before, probe, LOOK_AHEAD)
    return invert(cables, probe, J, inverse, size) * side <= 0.0


@kernel
def new_state(start: FloatArray) -> FloatArray:
    """(STATE,) state of a run at its start pose (7,), where the counters were zeroed."""
    state = np.zeros(STATE)
    copy(start, state)
    return state


@kernel
def resume_screw(
    cables: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, flags: IntArray, u: FloatArray
) -> tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]:
    """Poses of a run by continuation: each sample starts from the last good one.

    cables (6, columns); start (7,) pose at which the counters were zeroed; changes (n, 6) of the free cables since then [mm]; flags (n,) of
    `Status`: samples that are not OK are passed over. A change longer than STRIDE_MM, as behind a gap, is made in parts along the
    straight line in lengths, so that no other assembly is reached by a jump. A pose whose determinant has the other sign than
    the start's is in another assembly.

    Two assemblies meet at a singular pose. There the same lengths have two poses, and the start's sign of the determinant fits the
    wrong one once the motion went through. So a sample that lengths uncertain by u (6,) [mm] cannot distinguish from a singular pose is
    SINGULAR, and from it, or from a sample whose next ones could lie beyond, everything is OTHER_ASSEMBLY: it cannot be determined which.

    Returns poses (n, 7), residuals (n,) [mm], iterations (n,), status (n,), worst pressure angles (n,) [rad]. Other samples are NaN.
    """
    n = changes.shape[0]
    poses, residual, angle = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations, status = np.zeros(n, np.int64), np.zeros(n, np.int64)
    J, r, inverse = np.empty((CABLES, CABLES)), np.empty((CABLES, 1)), np.empty((CABLES, CABLES))
    size = platform_size(cables)
    zero = np.empty(CABLES)
    for j in range(CABLES):
        zero[j] = span_at(cables[j], start)[0]
    side = invert(cables, start, J, inverse, size)
    good, good_change = state[:CHANGES], state[CHANGES:LOST]
    pose, probe, targets = np.empty(POSE_COLUMNS), np.empty(POSE_COLUMNS), np.empty(CABLES)
    for i in range(n):
        if flags[i] != OK:
            status[i] = flags[i]
            continue
        if state[LOST] != 0.0:
            status[i] = OTHER_ASSEMBLY
            continue
        longest = 0.0
        for j in range(CABLES):
            longest = max(longest, abs(changes[i, j] - good_change[j]))
        parts = max(1, math.ceil(longest / STRIDE_MM))
        copy(good, pose)
        outcome, worst, reached = OK, 0.0, 0.0
        for part in range(1, parts + 1):
            f = part / parts
            for j in range(CABLES):
                # the last part aims at the target itself, free of the rounding of the interpolation
                way = changes[i, j] if part == parts else good_change[j] + f * (changes[i, j] - good_change[j])
                targets[j] = zero[j] + way
            outcome, steps, worst = newton(cables, targets, TOLERANCE_MM if part == parts else ON_THE_WAY_MM, pose, J, r, size)
            iterations[i] += steps
            if outcome != OK:
                break
        if outcome == OK:
            det = _invert_rows(J, inverse, size)
            if det == 0.0:
                outcome = SINGULAR
            elif det * side < 0.0:
                outcome = OTHER_ASSEMBLY
        if outcome == OK:
            reached = worst_pressure_angle(cables, pose, inverse)
            if reached > NEAR_SINGULAR:
                if _could_turn(cables, pose, u, side, probe, J, inverse, size):
                    outcome = SINGULAR
                if outcome == SINGULAR or _next_could_turn(cables, good, pose, side, probe, J, inverse, size):
                    state[LOST] = 1.0
        status[i] = outcome
        if outcome == OK:
            copy(pose, poses[i])
            residual[i] = worst
            angle[i] = reached
            copy(pose, good)
            copy(changes[i], good_change)
    return poses, residual, iterations, status, angle
