"""Errors of a curve at several instants together, from which `certify` draws characteristics.

A control pose has an error from the readings' own errors, of covariance N^-1, and one from the run's common variables. With the Cholesky
factor L of N, and w the control poses about some instants, r those that follow them,

    e_w = L_ww^-T (z - L_rw^T e_r),

z independent and of unit variance, e_r of the covariance that the band of N^-1 has. So the errors of instants within a cluster are those of
z and e_r, and the largest principal components of these; the rest stays as an error of each instant alone. Instants of other clusters,
which are far off, share only the variables of the run.
"""

from dataclasses import dataclass, replace

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray, symmetric_root
from lmeasure.text import Message, message
from lmeasure.trajectory.curve.curve import ORDER, Curve
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.uncertainty.pose_errors import OF_COUNTERS, PoseErrors, name_of_source, source_of

APART = 24.0  # Knots between neighbouring instants of two clusters
LONGEST = 240  # Knots that a cluster has at most
COMPONENTS, LEFT = 120, 1e-4  # Principal components of a cluster at most, and the part of the variance that others may have
WIDEST = 3.0  # Usual intervals between samples, beyond which there is a gap
PIECES = 3.0  # Instants in an interval of the knots
NAMES_OF_ROWS = ("residual_mm", "iterations", "status", "cause", "cable", "worst_pressure_angle_deg", "random", "systematic")
LEVER_MM = 100.0  # Distance at which a turn counts as a displacement


def clusters(curve: Curve, time_s: FloatArray) -> IntArray:
    """Return numbers (n,) of the clusters of increasing times (n,)."""
    knots = (time_s - time_s[0]) / curve.spacing_s
    out, number, begun = np.zeros(len(knots), dtype=np.int64), 0, knots[0]
    for i in range(1, len(knots)):
        if knots[i] - knots[i - 1] > APART or knots[i] - begun > LONGEST:
            number, begun = number + 1, knots[i]
        out[i] = number
    return out


def joint_root(curve: Curve, time_s: FloatArray) -> FloatArray:
    """Return R (6 n, q) of the covariance R R^T that the displacements at increasing times (n,) have by the readings' own errors."""
    first, weights, _ = curve.weights(time_s, 0)
    begin, end = 6 * int(first[0]), 6 * (int(first[-1]) + ORDER)
    W = np.zeros((end - begin, len(time_s), 6))
    for p in range(ORDER):
        for x in range(6):
            W[6 * (first + p) + x - begin, np.arange(len(time_s)), x] = weights[0, :, p]
    factor = curve.factor[begin:end]
    V = np.asarray(scipy.linalg.lapack.dtbtrs(np.asfortranarray(factor.T), W.reshape(len(W), -1), uplo="L")[0])
    width = factor.shape[1] - 1
    behind = min(width, len(curve.factor) - end)
    if not behind:
        return np.asarray(V.T)
    L, Z = np.zeros((behind, width)), np.zeros((behind, behind))
    for c in range(max(width - len(factor), 0), width):
        # column c of the last ones before the end reaches so many rows behind it
        d = np.arange(width - c, width + 1)
        rows = d - (width - c)
        inside = rows < behind
        L[rows[inside], c] = factor[len(factor) - width + c, d[inside]]
    for c in range(behind):
        Z[c:, c] = Z[c, c:] = curve.band[end + c, : behind - c]
    used = min(width, len(V))
    return np.hstack([V.T, V[-used:].T @ L[:, width - used :].T @ symmetric_root(Z[None])[0]])


def principal(root: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the largest principal components (n, 6, r) of R (6 n, q), and roots (n, 6, 6) of the rest of each instant."""
    n = len(root) // 6
    size = np.tile([LEVER_MM] * 3 + [1.0] * 3, n)[:, None]
    scaled = root * size
    tall = len(scaled) > scaled.shape[1]
    values, vectors = np.linalg.eigh(scaled.T @ scaled if tall else scaled @ scaled.T)
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    beyond = values.sum() - np.cumsum(values)
    r = min(int(np.searchsorted(-beyond, -LEFT * values.sum())) + 1, COMPONENTS, len(values))
    kept = scaled @ vectors[:, :r] if tall else vectors[:, :r] * np.sqrt(values[:r])
    whole = np.einsum("nxq,nyq->nxy", *(root.reshape(n, 6, -1),) * 2)
    part = (kept / size).reshape(n, 6, r)
    left = whole - part @ np.swapaxes(part, 1, 2)
    return part, symmetric_root(0.5 * (left + np.swapaxes(left, 1, 2)))


def finer_trajectory(trajectory: Trajectory, curve: Curve) -> tuple[Trajectory, IntArray]:
    """Return the trajectory of a curve at its samples and between them, and the sample (n,) at or before each of its instants.

    Between samples without a pose, or in a gap, there is no instant.
    """
    time_s = trajectory.time_s
    steps, known = np.diff(time_s), np.isfinite(trajectory.poses[:, 0])
    usual = float(np.median(steps))
    pieces = np.ones(len(time_s), dtype=np.int64)
    fine = known[1:] & known[:-1] & (steps <= WIDEST * usual)
    pieces[:-1][fine] = max(int(np.ceil(PIECES * usual / curve.spacing_s)), 1)
    of = np.repeat(np.arange(len(time_s)), pieces)
    part = (np.arange(len(of)) - np.repeat(np.cumsum(pieces) - pieces, pieces)) / pieces[of]
    at = time_s[of] + part * np.append(steps, 0.0)[of]
    rows = {name: getattr(trajectory, name)[of] for name in NAMES_OF_ROWS}
    used = known[of]
    poses = np.where(used[:, None], curve.poses(np.clip(at, curve.begin_s, curve.end_s)), np.nan)
    if np.isnan(trajectory.poses[known, 3:]).all():
        poses[:, 3:] = np.nan
    return replace(trajectory, time_s=at, poses=poses, chi_squared=None, u95_assumed_mm=None, **rows), of


@dataclass(frozen=True)
class ErrorsOfCurve:
    """Errors by the curve of a run; see `ErrorModel`. Those of neighbouring instants belong together."""

    curve: Curve

    def at(self, trajectory: Trajectory, samples: IntArray) -> tuple[PoseErrors, Message | str]:
        """See `ErrorModel`."""
        curve = self.curve
        time_s, back = np.unique(trajectory.time_s[samples], return_inverse=True)
        of = clusters(curve, time_s)
        parts = [principal(joint_root(curve, time_s[of == number])) for number in range(int(of.max(initial=-1)) + 1)]
        widest = max((part.shape[2] for part, _ in parts), default=0)
        own = np.concatenate([left for _, left in parts]) if parts else np.zeros((0, 6, 6))
        local = np.concatenate([np.pad(part, ((0, 0), (0, 0), (0, widest - part.shape[2]))) for part, _ in parts] or [own[:, :, :0]])
        alone = np.bincount(of)[of] == 1
        if alone.all() and len(of):
            own, local = symmetric_root(own @ np.swapaxes(own, 1, 2) + local @ np.swapaxes(local, 1, 2)), local[:, :, :0]
        shared, counted = curve.at(time_s, rates=0).shared[:, 0], tuple(name in OF_COUNTERS for name in curve.sources)
        sources = tuple(source_of(*each) for each in zip(curve.sources, curve.assumed, strict=True))
        errors = PoseErrors(own[back], local[back], of[back], shared[back], joint=True, counted=counted, sources=sources)
        names = dict.fromkeys(curve.sources)
        return errors, message("covers.curve", sources=(message("source.counts"), *(name_of_source(name) for name in names)))
