"""Poses from the readings of any channels, and what they err by: weighted least squares, all samples side by side.

The step is Gauss and Newton's in the components of a small motion that are free, turns counted in millimetres at the size of the tool.
A sample without a pose says why, as everywhere (`lmeasure.core.status`).
"""

from typing import NamedTuple

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, Status, se3
from reference.channel import Channels, arms, differences, predictions, rows, size_mm, values, variances

ALL = np.arange(6)
"""All components of a motion (omega; v) are free."""
MOST_STEPS = 30
STEP_MM = 1e-11  # a step below it moves nothing that a reading could show
FLOOR_MM = 1e-9  # below it a step that no longer falls is rounding
LARGEST_TURN = 0.5  # rad of one step
SINGULAR = 1e-7  # of the largest singular value of the rows: the pose is not determined
ROUNDING = 1e-14  # likewise of rows as they weigh: below it nothing can be worked out
LOST = np.radians(88.0)
"""Pressure angle beyond which the readings cannot tell one pose from another."""


class Solved(NamedTuple):
    """poses (n, 7) and covariance (n, 6, 6) of their errors by the readings' own variances, (rotation [rad]; tool origin [mm]), R_true =
    Exp(delta) R, base axes; chi2 (n,) of the readings; status (n,) of `Status`; angle (n,) worst pressure angle [rad]. What is not OK is
    NaN."""

    poses: FloatArray
    covariance: FloatArray
    chi2: FloatArray
    status: IntArray
    angle: FloatArray


def solve_poses(channels: Channels, readings: FloatArray, starts: FloatArray, free: IntArray = ALL) -> Solved:
    """Poses (n, 7) that fit readings (n, m) best, NaN where there is none, each sought from its start, (n, 7) or (7,); free (f,): the
    components of a motion (omega; v) that can change, as in `trajectory.reconstruction.run_model`.

    Which of several poses is found is a matter of the start; `follow` knows where a run has come from.
    """
    poses = np.array(np.broadcast_to(starts, (len(readings), 7)))
    used = np.isfinite(readings)
    status = np.where(used.sum(axis=1) < len(free), Status.GAP, Status.NOT_CONVERGED).astype(np.int64)
    before = np.full(len(poses), np.inf)
    index = np.flatnonzero((status == Status.NOT_CONVERGED) & np.isfinite(poses).all(axis=1))
    for _ in range(MOST_STEPS):
        step, determined = towards(channels, readings[index], poses[index], free)
        status[index[~determined]] = Status.SINGULAR
        # where a channel cannot be read there is no way on
        goes_on = determined & np.isfinite(step).all(axis=1)
        index, step = index[goes_on], step[goes_on]
        if not len(index):
            break
        turn = np.linalg.norm(step[:, :3], axis=1)
        step *= (LARGEST_TURN / np.maximum(turn, LARGEST_TURN))[:, None]
        poses[index] = se3.displaced(poses[index], step)
        length = lengths(channels, step)
        there = (length <= STEP_MM) | ((length < FLOOR_MM) & (length >= 0.5 * before[index]))
        before[index] = length
        status[index[there]] = Status.OK
        index = index[~there]
    return _judged(channels, readings, poses, status, free)


def towards(channels: Channels, readings: FloatArray, poses: FloatArray, free: IntArray = ALL) -> tuple[FloatArray, BoolArray]:
    """(n, 6) motions of poses (n, 7), or of one (1, 7), towards the least squares of readings (n, m), to first order, NaN where a channel
    cannot be read, and whether they are determined (n,)."""
    used = np.isfinite(readings)
    with np.errstate(invalid="ignore"):
        away = np.where(used, differences(channels, readings, predictions(channels, poses)), 0.0)
        G, determined = _inverse(channels, poses, used, free)
        return np.einsum("ncm,nm->nc", G, away), determined


def twists(
    channels: Channels, poses: FloatArray, used: BoolArray | None = None, free: IntArray = ALL, *, weighted: bool = True
) -> FloatArray:
    """(n, 6, m) motion (omega; v) of (n, 7) poses per unit of each reading, by least squares over those used (n, m), all by default; zero
    in what is not free and for what is not used, NaN where the pose is NaN or not determined. weighted: by what readings are known to,
    else all count alike, in rows of one size."""
    out = np.full((len(poses), 6, len(channels)), np.nan)
    known = np.isfinite(poses).all(axis=1)
    mine = np.ones(out[known, 0].shape, np.bool_) if used is None else used[known]
    G, determined = _inverse(channels, poses[known], mine, free, weighted)
    out[known] = np.where(determined[:, None, None], G, np.nan)
    return out


def _inverse(channels: Channels, poses: FloatArray, used: BoolArray, free: IntArray, weighted: bool = True) -> tuple[FloatArray, BoolArray]:
    """`twists`, and whether they are determined; NaN where a row is."""
    scale = np.repeat([1.0 / size_mm(channels), 1.0], 3)
    every = rows(channels, poses)
    by = np.sqrt(variances(channels)) if weighted else np.maximum(np.linalg.norm(every * scale, axis=2), 1e-300)
    weight = np.where(used, 1.0 / by, 0.0)
    scaled = np.where(used[:, :, None], every, 0.0) * weight[:, :, None] * scale
    fine = np.isfinite(scaled).all(axis=(1, 2))
    U, s, V = np.linalg.svd(np.where(fine[:, None, None], scaled, 0.0)[:, :, free], full_matrices=False)
    determined = ~fine | (s[:, -1] > SINGULAR * s[:, 0]) & (len(channels) >= len(free))
    hardly = np.flatnonzero(~determined & (s[:, -1] > ROUNDING * s[:, 0]) & (len(channels) >= len(free)))
    # readings that are hardly known make a pose uncertain; whether it is singular rows of one size tell
    size = np.linalg.norm(scaled[hardly], axis=2, keepdims=True)
    geometry = np.linalg.svd((scaled[hardly] / np.where(size > 0.0, size, 1.0))[:, :, free], compute_uv=False)
    determined[hardly] = geometry[:, -1] > SINGULAR * geometry[:, 0]
    s = np.where((fine & determined)[:, None], s, np.inf)
    out = np.zeros((len(used), 6, len(channels)))
    out[:, free] = np.swapaxes(V, 1, 2) @ (np.swapaxes(U, 1, 2) / s[:, :, None]) * weight[:, None, :]
    out *= scale[:, None]
    out[~fine] = np.nan
    return out, determined


def pressure_angles(channels: Channels, poses: FloatArray, twists: FloatArray) -> FloatArray:
    """(n, m) angles [rad] between the way in which a channel sees its point move and the way in which that point does move when only its
    reading changes, from `twists` (n, 6, m): 0 in the best of cases, a right angle at a singular pose. Of a channel that looks at no point:
    the angle between the axes of turning."""
    found = rows(channels, poses)
    out = np.empty(found.shape[:2])
    for j, o in enumerate(channels):
        turn, shift = twists[:, :3, j], twists[:, 3:, j]
        moved, seen = (turn, found[:, j, :3]) if o.point is None else (shift + np.cross(turn, arms(poses, o.point)), found[:, j, 3:])
        out[:, j] = np.arccos(1.0 / np.maximum(1.0, np.linalg.norm(moved, axis=1) * np.linalg.norm(seen, axis=1)))
    return out


def shared_errors(channels: Channels, poses: FloatArray, twists: FloatArray, names: tuple[str, ...], *, root: FloatArray) -> FloatArray:
    """(n, 6, r) errors of (n, 7) poses, from `twists` (n, 6, m), by independent variables of unit variance that all readings share: those
    of the parameters names (q,), whose covariance is root root^T, root (q, r) in their units. The linear propagation of any calibration."""
    index = {name: i for i, name in enumerate(names)}
    out = np.zeros((len(poses), 6, root.shape[1]))
    for j, o in enumerate(channels):
        own = [i for i, q in enumerate(o.parameters) if q.name in index]
        moved = o.gradient(poses, values(o))[:, own] @ root[[index[o.parameters[i].name] for i in own]]
        # what should read more than it is taken to is fitted by a pose that errs the other way
        out -= twists[:, :, j, None] * moved[:, None, :]
    return out


def lengths(channels: Channels, motions: FloatArray) -> FloatArray:
    """(n,) largest component of motions (n, 6) [mm], turns counted at the size of the tool."""
    return np.asarray(np.abs(motions * np.repeat([size_mm(channels), 1.0], 3)).max(axis=1, initial=0.0))


def _judged(channels: Channels, readings: FloatArray, poses: FloatArray, status: IntArray, free: IntArray) -> Solved:
    """What was found, and whether it is determined."""
    ok = np.flatnonzero(status == Status.OK)
    used, there = np.isfinite(readings[ok]), poses[ok]
    G = twists(channels, there, used, free)
    angle = pressure_angles(channels, there, G).max(axis=1)
    clear = angle <= LOST
    lost = np.flatnonzero(~clear)
    alike = twists(channels, there[lost], used[lost], free, weighted=False)
    clear[lost] = pressure_angles(channels, there[lost], alike).max(axis=1) <= LOST
    status[ok[~clear]] = Status.SINGULAR
    own = G * np.sqrt(variances(channels))
    with np.errstate(invalid="ignore"):
        away = np.where(used, differences(channels, readings[ok], predictions(channels, there)), 0.0)
    out = nowhere(status)
    figures = there, own @ np.swapaxes(own, 1, 2), (away**2 / variances(channels)).sum(axis=1), angle
    for into, found in zip((out.poses, out.covariance, out.chi2, out.angle), figures, strict=True):
        into[ok[clear]] = found[clear]
    return out


def nowhere(status: IntArray) -> Solved:
    """Samples (n,) without a pose."""
    n = len(status)
    return Solved(np.full((n, 7), np.nan), np.full((n, 6, 6), np.nan), np.full(n, np.nan), status, np.full(n, np.nan))
