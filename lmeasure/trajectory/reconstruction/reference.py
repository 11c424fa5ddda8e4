"""The screw method in NumPy, for logs too short to wait for a compiler: nothing here needs one.

The twin of the lane kernel, by the same rule: a whole run is solved at once, started from anchors that continuation reaches one from the
other, and the result only counts where nothing can be in doubt - every sample starts near, converges, keeps the side of the start and
stays below 75 degrees of pressure angle. Anything else is left to the compiled kernels, which go sample by sample and know every status.
"""

import numpy as np

from lmeasure.core import FloatArray, IntArray, Status, se3
from lmeasure.kernels import CHANGES, CLEAR_OF_SINGULAR, LOST, MAX_STEP_ROTATION, NEAR_MM, TOLERANCE_MM
from lmeasure.linkages import pressure_angles
from lmeasure.sensors import arms, span_rows

ANCHORS = 2000  # more, as of a long way, and compiling costs less
STEPS = 6
FLOOR_MM = 1e-9  # a residual of rounding, when it no longer falls

Followed = tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]


def twists(cables: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 6, 6) `kernels.pose_covariance.twists` of six cables; NaN where the pose is NaN."""
    out = np.full((len(poses), 6, len(cables)), np.nan)
    known = ~np.isnan(poses[:, 0])
    out[known] = np.linalg.inv(span_rows(cables, poses[known])[1])
    return out


def follow(cables: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, *, flags: IntArray) -> Followed | None:
    """What `kernels.screw.resume` gives for these samples, or None where that is not plain; the state is moved on only with a result.

    cables (6, columns), start (7,), state (`kernels.screw.STATE`,), changes (n, 6) [mm], flags (n,).
    """
    index = np.flatnonzero(flags == Status.OK)
    if state[-1] != 0.0 or not len(index):
        return None
    (zero,), start_rows = span_rows(cables, start[None])
    side = np.sign(np.linalg.det(start_rows[0]))
    wanted = changes[index]
    starts = _anchors(cables, zero, state, wanted)
    if starts is None:
        return None
    found = _newton(cables, starts, zero + wanted, STEPS)
    if found is None:
        return None
    solved, worst, rows, steps = found
    with np.errstate(invalid="ignore"):
        determinants = np.linalg.det(rows)
        if not (determinants * side > 0.0).all():
            return None
        angles = pressure_angles(rows, arms(cables, solved)).max(axis=1)
        if not (angles <= CLEAR_OF_SINGULAR).all():
            return None
    n = len(changes)
    poses, residual, angle = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations = np.zeros(n, np.int64)
    poses[index], residual[index], iterations[index] = solved, worst, steps
    angle[index] = angles
    state[:CHANGES], state[CHANGES:LOST] = solved[-1], wanted[-1]
    return poses, residual, iterations, flags.copy(), angle


def _anchors(cables: FloatArray, zero: FloatArray, state: FloatArray, changes: FloatArray) -> FloatArray | None:
    """(n, 7) poses near those of the samples: of the last anchor, each NEAR_MM of length from the one before; None where samples are
    farther apart, anchors too many, or one is not found."""
    pose, there = state[:CHANGES].copy(), state[CHANGES:LOST].copy()
    out = np.empty((len(changes), 7))
    begin, anchors = 0, 0
    while True:
        far = np.flatnonzero(np.abs(changes[begin:] - there).max(axis=1) > NEAR_MM)
        end = begin + int(far[0]) if len(far) else len(changes)
        out[begin:end] = pose
        if end == len(changes):
            return out
        # a sample that is itself far from the last one is no continuation
        if end == begin or anchors == ANCHORS:
            return None
        found = _newton(cables, pose[None], (zero + changes[end - 1])[None], STEPS)
        if found is None:
            return None
        pose, there = found[0][0], changes[end - 1]
        begin, anchors = end, anchors + 1


def _newton(cables: FloatArray, poses: FloatArray, targets: FloatArray, most: int) -> tuple[FloatArray, FloatArray, FloatArray, int] | None:
    """Poses (n, 7) whose lengths are the targets (n, 6), largest residuals (n,), rows there (n, 6, 6), steps; None when one is missing."""
    poses, previous = poses.copy(), np.inf
    for step in range(most + 1):
        lengths, rows = span_rows(cables, poses)
        residuals = targets - lengths
        worst = np.abs(residuals).max(axis=1)
        largest = float(worst.max())
        if not largest <= 2.0 * NEAR_MM:  # NaN is no answer either
            return None
        if largest <= TOLERANCE_MM or (largest < FLOOR_MM and largest >= 0.5 * previous):
            return poses, worst, rows, step
        previous = largest
        try:
            twist = np.linalg.solve(rows, residuals[:, :, None])[:, :, 0]
        except np.linalg.LinAlgError:
            return None
        if not np.linalg.norm(twist[:, :3], axis=1).max() <= MAX_STEP_ROTATION:
            return None
        # a turn and a shift of the tool origin; Newton's order does not need the screw between two steps
        poses = se3.displaced(poses, twist)
    return None
