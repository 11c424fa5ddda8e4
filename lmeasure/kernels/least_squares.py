"""Poses from any number of cables: least squares over the components of the twist that are free to change.

The screw method for other schemes than six cables to a body. A scheme states which of the six components of the twist (omega; v), base
axes, can change: all six, only v (several cables to one point), omega_z, v_x, v_y (a planar stage) or omega_z and v (a tool that stays
vertical). Each of these sets is a group of displacements, so a finite twist of such components stays within it. With more cables than
free components the step is Gauss and Newton's, readings weighted by their uncertainty, and the residuals show whether the channels agree.

Whether a pose is singular is a matter of geometry. So it is judged by rows of about unit size, an angle's taken as the length by which it
is seen, whatever the readings weigh: readings of large uncertainty make a pose uncertain, not singular.

Where just as many channels count as components are free, two poses of the same readings meet at a singular one, as with six cables
(`screw.resume`): what cannot be distinguished from it is refused, and from there on everything until more channels count.

Poses sought from far: least squares by damped steps, where whole ones lead nowhere.
"""

import math

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.kernels.cable import seen_at, way_round
from lmeasure.kernels.decorators import inline, kernel
from lmeasure.kernels.layout import ATTACHMENT, CABLE, CHANGES, KIND, POSE_COLUMNS
from lmeasure.kernels.screw import (
    COVERAGE,
    LOOK_AHEAD,
    MAX_ITERATIONS,
    NEAR_SINGULAR,
    NOT_CONVERGED,
    OK,
    ON_THE_WAY_MM,
    OTHER_ASSEMBLY,
    SINGULAR,
    SINGULAR_PIVOT,
    STRIDE_MM,
    copy,
    displace,
    eliminate,
    go_on,
    platform_size,
)
from lmeasure.kernels.vector import Vec3, add, cross, norm, orientation, rotate, vec

STEP_MM = 1e-11  # a step below it moves nothing that a length could show
FALLING_MM = 1e-4  # from which on steps show how they continue to fall
LOST_SPEED = 1.0 / math.cos(math.radians(88.0))  # of an attachment point per unit of length: no assembly can be determined from the other
NEAR_SPEED = 1.0 / math.cos(NEAR_SINGULAR)
TURNS_ALONE = 1e-7  # force of a channel, over its moment, below which it is rounding
HARDLY_KNOWN = 1e-14  # pivot of the weighted normal equations down to which rounding leaves them sound


@kernel
def fill(
    cables: FloatArray,
    pose: FloatArray,
    targets: FloatArray,
    weights: FloatArray,
    free: IntArray,
    size: float,
    A: FloatArray,
    r: FloatArray,
) -> bool:
    """Weighted rows by the free components into A (m, f), weighted residuals into r (m,), but for those of weight 0; False where a cable
    cannot run."""
    full = np.empty(6)
    fine = True
    for j in range(cables.shape[0]):
        if weights[j] == 0.0:
            continue
        length, moment, e = seen_at(cables[j], pose)
        for c in range(3):
            full[c], full[3 + c] = moment[c] / size, e[c]
        for c in range(len(free)):
            A[j, c] = weights[j] * full[free[c]]
        r[j] = weights[j] * way_round(targets[j] - length, cables[j, KIND])
        fine = fine and math.isfinite(r[j])
    return fine


@kernel
def normal(A: FloatArray, N: FloatArray) -> None:
    """The normal matrix of rows A (m, f) into N (f, f)."""
    for a in range(A.shape[1]):
        for b in range(a, A.shape[1]):
            s = 0.0
            for j in range(A.shape[0]):
                s += A[j, a] * A[j, b]
            N[a, b] = N[b, a] = s


@kernel
def alike(cables: FloatArray, pose: FloatArray, weights: FloatArray, size: float, units: FloatArray) -> None:
    """Write the approximate motion per unit of each counted reading [mm] into units (m,), which scale rows to about unit size; else 0."""
    for j in range(cables.shape[0]):
        units[j] = 0.0
        if weights[j] > 0.0:
            units[j] = reach_of(cables[j], pose, size)


@inline
def reach_of(cable: FloatArray, pose: FloatArray, size: float) -> float:
    """Return the approximate motion per unit of a channel's reading [mm]."""
    if cable[KIND] == CABLE:
        return 1.0
    _, moment, e = seen_at(cable, pose)
    return size if sees_turns(moment, e, size) else 1.0 / norm(e)


@inline
def sees_turns(moment: Vec3, e: Vec3, size: float) -> bool:
    """Whether a channel's reading changes by turns of the tool alone, as an inclination does."""
    return size * norm(e) <= TURNS_ALONE * norm(moment)


@kernel
def determined(cables: FloatArray, pose: FloatArray, weights: FloatArray, free: IntArray, size: float) -> bool:
    """Whether the channels that count determine the pose, however well they are known."""
    m, f = cables.shape[0], len(free)
    A, r, N, units = np.zeros((m, f)), np.zeros(m), np.empty((f, f)), np.empty(m)
    alike(cables, pose, weights, size, units)
    fill(cables, pose, np.zeros(m), units, free, size, A, r)
    normal(A, N)
    return eliminate(N, np.zeros((f, 1))) != 0.0


@kernel
def _solve(
    cables: FloatArray, pose: FloatArray, targets: FloatArray, weights: FloatArray, free: IntArray, size: float, tolerance: float
) -> tuple[int, int]:
    """Move the pose (in place) to the least squares: (status, iterations)."""
    m, f = cables.shape[0], len(free)
    A, r, N, b, twist = np.zeros((m, f)), np.zeros(m), np.empty((f, f)), np.empty((f, 1)), np.zeros(6)
    previous = 0.0
    for iteration in range(1, MAX_ITERATIONS + 1):
        if not fill(cables, pose, targets, weights, free, size, A, r):
            return NOT_CONVERGED, iteration
        least = SINGULAR_PIVOT
        while True:
            normal(A, N)
            for c in range(f):
                s = 0.0
                for j in range(m):
                    s += A[j, c] * r[j]
                b[c, 0] = s
            if eliminate(N, b, least) != 0.0:
                break
            if least == HARDLY_KNOWN or not determined(cables, pose, weights, free, size):
                return SINGULAR, iteration
            least = HARDLY_KNOWN
        step = 0.0
        for c in range(f):
            twist[free[c]] = b[c, 0]
            step = max(step, abs(b[c, 0]))
        displace(pose, twist, size)
        # rounding floor: a tiny step that no longer falls has nothing left to gain; one that falls will fall as much again at least
        if (
            step <= tolerance
            or (step < 1e-9 and step >= 0.5 * previous > 0.0)
            or (step <= FALLING_MM and step * step <= tolerance * previous)
        ):
            return OK, iteration
        previous = step
    return NOT_CONVERGED, MAX_ITERATIONS


@kernel
def length_twists(
    cables: FloatArray,
    pose: FloatArray,
    weights: FloatArray,
    free: IntArray,
    size: float,
    targets: FloatArray,
    G: FloatArray,
    r: FloatArray,
) -> bool:
    """Twist per unit of each length into G (6, m), residuals [mm] into r (m,); whether they exist."""
    m, f = cables.shape[0], len(free)
    A, N, B = np.zeros((m, f)), np.empty((f, f)), np.empty((f, m))
    fill(cables, pose, targets, weights, free, size, A, r)
    least = SINGULAR_PIVOT
    while True:
        normal(A, N)
        for c in range(f):
            for j in range(m):
                B[c, j] = A[j, c] * weights[j]
        if eliminate(N, B, least) != 0.0:
            break
        if least == HARDLY_KNOWN or not determined(cables, pose, weights, free, size):
            return False
        least = HARDLY_KNOWN
    for j in range(m):
        r[j] = r[j] / weights[j] if weights[j] > 0.0 else math.nan
        for c in range(6):
            G[c, j] = 0.0
        for c in range(f):
            G[free[c], j] = B[c, j] / (size if free[c] < 3 else 1.0)
    return True


@kernel
def _determinant(cables: FloatArray, pose: FloatArray, weights: FloatArray, free: IntArray, size: float) -> float:
    """Of the rows of those channels that count, of about unit size, as many as components are free; 0 where they are singular."""
    m, f = cables.shape[0], len(free)
    A, r, square, used, units = np.zeros((m, f)), np.empty(m), np.empty((f, f)), 0, np.empty(m)
    alike(cables, pose, weights, size, units)
    fill(cables, pose, np.zeros(m), units, free, size, A, r)
    for j in range(m):
        if weights[j] > 0.0:
            copy(A[j], square[used])
            used += 1
    return eliminate(square, np.zeros((f, 1)))


@kernel
def _could_turn(
    cables: FloatArray, pose: FloatArray, weights: FloatArray, u: FloatArray, free: IntArray, size: float, G: FloatArray, side: float
) -> bool:
    """Whether the determinant changes its sign within COVERAGE standard uncertainties of the pose, for readings uncertain by u (m,).

    As `screw._could_turn`: near a singular pose all columns of G (6, m) lie along the one direction that the channels see badly.
    """
    total, largest, worst = 0.0, 0.0, 0
    for j in range(len(u)):
        if weights[j] > 0.0:
            moved = u[j] * math.hypot(size * norm((G[0, j], G[1, j], G[2, j])), norm((G[3, j], G[4, j], G[5, j])))
            total += moved * moved
            if moved > largest:
                largest, worst = moved, j
    twist, probe = np.empty(6), np.empty(POSE_COLUMNS)
    for way in (1.0, -1.0):
        for c in range(6):
            twist[c] = way * COVERAGE * u[worst] * math.sqrt(total) / largest * G[c, worst]
        copy(pose, probe)
        displace(probe, twist, 1.0)
        if _determinant(cables, probe, weights, free, size) * side <= 0.0:
            return True
    return False


@kernel
def fastest(cables: FloatArray, pose: FloatArray, G: FloatArray) -> float:
    """Largest speed of an attachment point per unit rate of its own cable; of an angle likewise, by the speed that turns it by that rate
    where it is seen best."""
    largest = 1.0
    for j in range(cables.shape[0]):
        turn = (G[0, j], G[1, j], G[2, j])
        arm = rotate(orientation(pose), vec(cables[j], ATTACHMENT))
        moved = norm(add((G[3, j], G[4, j], G[5, j]), cross(turn, arm)))
        if cables[j, KIND] != CABLE:
            _, moment, e = seen_at(cables[j], pose)
            # a channel that sees turns alone has no force, and no arm
            moved = norm(turn) if sees_turns(moment, e, 1.0) else moved * norm(e)
        largest = max(largest, moved)
    return largest


@kernel
def _lost(cables: FloatArray, pose: FloatArray, weights: FloatArray, free: IntArray, size: float, targets: FloatArray) -> bool:
    """Whether channels that count move a point without end, were all known alike: then no assembly can be determined from the other."""
    units, G, r = np.empty(len(weights)), np.empty((6, len(weights))), np.empty(len(weights))
    alike(cables, pose, weights, size, units)
    return not length_twists(cables, pose, units, free, size, targets, G, r) or fastest(cables, pose, G) > LOST_SPEED


@kernel
def new_state(start: FloatArray, m: int) -> FloatArray:
    """(8 + m,) state of a run of m cables at its start: last good pose, change of the cables there, the
    number of cables by which it was lost, else 0."""
    state = np.zeros(CHANGES + m + 1)
    copy(start, state)
    return state


@kernel
def _go(
    cables: FloatArray,
    pose: FloatArray,
    zero: FloatArray,
    begun: FloatArray,
    changes: FloatArray,
    weights: FloatArray,
    free: IntArray,
    size: float,
    reach: FloatArray,
) -> tuple[int, int]:
    """Move a pose (in place) along the straight way of the weighted readings from their changes begun (m,) to changes (m,), in parts of
    `STRIDE_MM`, to near its end: (status, iterations). One part is no way."""
    longest, steps = 0.0, 0
    for j in range(len(zero)):
        if weights[j] > 0.0:
            longest = max(longest, reach[j] * abs(way_round(changes[j] - begun[j], cables[j, KIND])))
    parts = math.ceil(longest / STRIDE_MM)
    if parts <= 1:
        return OK, 0
    targets, before, behind = np.zeros(len(zero)), np.empty(POSE_COLUMNS), np.empty(POSE_COLUMNS)
    for part in range(1, parts):
        for j in range(len(zero)):
            if weights[j] > 0.0:
                targets[j] = zero[j] + begun[j] + part / parts * way_round(changes[j] - begun[j], cables[j, KIND])
        copy(pose, before)
        if part > 1:
            # continue as before: only the bend remains to be found
            go_on(behind, pose, 1.0)
        copy(before, behind)
        outcome, more = _solve(cables, pose, targets, weights, free, size, ON_THE_WAY_MM)
        steps += more
        if outcome != OK:
            return outcome, steps
    go_on(behind, pose, 1.0)
    return OK, steps


@kernel
def follow_least_squares(
    cables: FloatArray,
    start: FloatArray,
    zero: FloatArray,
    state: FloatArray,
    changes: FloatArray,
    flags: IntArray,
    u: FloatArray,
    free: IntArray,
) -> tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray, FloatArray]:
    """Poses of a run by continuation, from m >= f cables and f free components of the twist.

    cables (m, columns), channels of any kind; start (7,); zero (m,) each reading where its change is 0; state (8 + m,), moved on in
    place; changes (n, m) [mm, rad], NaN where a channel has no count: the others are used as long as f are left, else the sample keeps its
    flag of flags (n,); u (m,) standard uncertainties of the readings; free (f,) indices into the twist.

    Returns poses (n, 7), largest absolute residual of a length (n,) [mm], iterations (n,), status (n,), worst pressure angle (n,) [rad],
    chi squared (n,) of the residuals by u alone.
    """
    n, m, f = changes.shape[0], cables.shape[0], len(free)
    poses, residual, angle, chi = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations, status = np.zeros(n, np.int64), np.zeros(n, np.int64)
    size, lost = platform_size(cables), CHANGES + m
    targets, weights, pose, reach = np.empty(m), np.empty(m), np.empty(POSE_COLUMNS), np.empty(m)
    G, r, lengths = np.empty((6, m)), np.empty(m), np.empty(m)
    smallest = math.inf
    for j in range(m):
        targets[j] = seen_at(cables[j], start)[0]
        reach[j] = reach_of(cables[j], start, size)
        smallest = min(smallest, u[j] * reach[j])
    probe = np.empty(POSE_COLUMNS)
    for i in range(n):
        counted, of_lengths = 0, 0
        for j in range(m):
            good = math.isfinite(changes[i, j])
            weights[j] = smallest / u[j] if good else 0.0
            lengths[j] = weights[j] if cables[j, KIND] == CABLE else 0.0
            if good:
                counted += 1
                of_lengths += cables[j, KIND] == CABLE
        outcome = OK if counted >= f else flags[i]
        # more cables than when it was lost determine the pose again
        if outcome == OK and state[lost] > 0.0 and counted <= state[lost]:
            status[i] = OTHER_ASSEMBLY
            continue
        # just as many as there are unknowns: their rows have a determinant, whose sign distinguishes assemblies
        exact, ahead, side = counted == f, False, 0.0
        if outcome == OK:
            copy(state[:CHANGES], pose)
            if exact:
                side = _determinant(cables, pose, weights, free, size)
            begun, gone = state[CHANGES : CHANGES + m], False
            if of_lengths >= f and of_lengths < counted:
                # lengths alone, where they are enough: an angle seen from near may change by half a turn on a short path
                outcome, steps = _go(cables, pose, zero, begun, changes[i], lengths, free, size, reach)
                iterations[i], gone = steps, outcome == OK
                if not gone:
                    copy(state[:CHANGES], pose)
            if not gone:
                outcome, steps = _go(cables, pose, zero, begun, changes[i], weights, free, size, reach)
                iterations[i] += steps
            if outcome == OK:
                for j in range(m):
                    targets[j] = zero[j] + changes[i, j]
                outcome, steps = _solve(cables, pose, targets, weights, free, size, STEP_MM)
                iterations[i] += steps
        if outcome == OK and not length_twists(cables, pose, weights, free, size, targets, G, r):
            outcome = SINGULAR
        if outcome == OK and exact and _determinant(cables, pose, weights, free, size) * side <= 0.0:
            outcome = OTHER_ASSEMBLY
        if outcome == OK:
            speed = fastest(cables, pose, G)
            if speed > LOST_SPEED and _lost(cables, pose, weights, free, size, targets):
                outcome = SINGULAR
            else:
                angle[i] = math.acos(1.0 / speed)
                if exact and speed > NEAR_SPEED:
                    if _could_turn(cables, pose, weights, u, free, size, G, side):
                        outcome = SINGULAR
                    copy(pose, probe)
                    go_on(state[:CHANGES], probe, LOOK_AHEAD)
                    ahead = _determinant(cables, probe, weights, free, size) * side <= 0.0
        if ahead or (outcome == SINGULAR and not (exact and side == 0.0)):
            # beyond, the same readings have two poses, and the one that is nearer to where it was is the wrong one; where it was singular
            # before, there is nothing to lose
            state[lost] = counted
        elif outcome == OK:
            state[lost] = 0.0
        status[i] = outcome
        if outcome == OK:
            copy(pose, poses[i])
            copy(pose, state)
            worst, chi[i] = 0.0, 0.0
            for j in range(m):
                # a cable without a count continues from its length at the pose
                state[CHANGES + j] = changes[i, j] if weights[j] > 0.0 else seen_at(cables[j], pose)[0] - zero[j]
                if weights[j] > 0.0:
                    if cables[j, KIND] == CABLE:
                        worst = max(worst, abs(r[j]))
                    chi[i] += (r[j] / u[j]) ** 2
            residual[i] = worst
    return poses, residual, iterations, status, angle, chi


@kernel
def twists(cables: FloatArray, poses: FloatArray, weights: FloatArray, free: IntArray) -> FloatArray:
    """(n, 6, m) twist (omega; v) about the tool origin per unit of each length, by least squares with weights (n, m), zero for a cable that
    is not used; zero in components that are not free (f,), NaN where the pose of poses (n, 7) is NaN or singular."""
    n, m = weights.shape
    out = np.full((n, 6, m), np.nan)
    G, r, targets = np.empty((6, m)), np.empty(m), np.zeros(m)
    size = platform_size(cables)
    for i in range(n):
        if not math.isnan(poses[i, 0]) and length_twists(cables, poses[i], weights[i], free, size, targets, G, r):
            for c in range(6):
                copy(G[c], out[i, c])
    return out


SEARCH_STEPS = 60


@kernel
def _cost(r: FloatArray) -> float:
    s = 0.0
    for j in range(len(r)):
        s += r[j] * r[j]
    return s


@kernel
def _seek(cables: FloatArray, targets: FloatArray, weights: FloatArray, free: IntArray, size: float, pose: FloatArray) -> float:
    """Move a pose (in place) by damped steps to where readings fit targets best: chi squared there, infinite where none was reached."""
    m, f = cables.shape[0], len(free)
    A, r, N, damped, b, twist, tried = (
        np.zeros((m, f)), np.zeros(m), np.empty((f, f)), np.empty((f, f)), np.empty((f, 1)), np.zeros(6), np.empty(POSE_COLUMNS),
    )  # fmt: skip
    if not fill(cables, pose, targets, weights, free, size, A, r):
        return math.inf
    damping, cost = 1e-3, _cost(r)
    for _ in range(SEARCH_STEPS):
        normal(A, N)
        # pivots are compared with 1
        scale = 1.0 / max(np.abs(A).max(), 1e-300)
        for a in range(f):
            b[a, 0] = 0.0
            for j in range(m):
                b[a, 0] += A[j, a] * r[j] * scale * scale
            for c in range(f):
                damped[a, c] = N[a, c] * scale * scale
            damped[a, a] *= 1.0 + damping
            damped[a, a] += 1e-18
        if eliminate(damped, b) == 0.0:
            return math.inf
        step = 0.0
        for c in range(f):
            twist[free[c]] = b[c, 0]
            step = max(step, abs(b[c, 0]))
        copy(pose, tried)
        displace(tried, twist, size)
        fine = fill(cables, tried, targets, weights, free, size, A, r)
        now = _cost(r)
        if fine and now <= cost:
            copy(tried, pose)
            if step < 1e-6:
                return now
            cost, damping = now, max(0.1 * damping, 1e-12)
        else:
            fill(cables, pose, targets, weights, free, size, A, r)
            damping *= 10.0
            if damping > 1e12:
                return cost
    return math.inf


@kernel
def damped_search(
    cables: FloatArray, targets: FloatArray, u: FloatArray, free: IntArray, starts: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Poses (n, 7) at which readings of channels, rows (m, columns), fit targets (m,) of standard uncertainties u (m,) best, each sought
    from its start (n, 7) by damped steps (Levenberg and Marquardt), and chi squared (n,), infinite where none was reached."""
    poses, chi, size = starts.copy(), np.empty(len(starts)), platform_size(cables)
    weights = 1.0 / u
    for i in range(len(starts)):
        chi[i] = _seek(cables, targets, weights, free, size, poses[i])
    return poses, chi
