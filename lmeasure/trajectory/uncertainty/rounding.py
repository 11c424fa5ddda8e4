"""Rounded counts of a robot at rest: the same pose is rounded alike, again and again.

The error of a count is a sawtooth of the true length. If lengths scatter by a standard deviation of sigma counts, rounding errors of any
two of them are correlated by

    kept(sigma) = 6 / pi^2 * sum over k >= 1 of exp(-4 pi^2 k^2 sigma^2) / k^2

(the Fourier series of the sawtooth, averaged over the place of the mean length within a count): 1 if nothing moves, 0.5 at a tenth of a
count, 0.02 at three tenths. That fraction of the variance is not averaged away by more samples of a dwell nor by more cycles of a pose. For
a swinging robot see `vibration`.
"""

from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.trajectory.uncertainty.pose_errors import PoseErrors

_TERMS = np.arange(1, 200)


def kept(sigma_counts: FloatArray | float) -> FloatArray:
    """Correlation (...) of the rounding errors of two lengths that scatter by sigma_counts (...)."""
    sigma = np.asarray(sigma_counts, dtype=np.float64)
    series = 6.0 / np.pi**2 * np.sum(np.exp(-4.0 * (np.pi * _TERMS * sigma[..., None]) ** 2) / _TERMS**2, axis=-1)
    return np.where(sigma == 0.0, 1.0, series)


_SCATTER = np.linspace(0.0, 1.0, 2001)
_OBSERVED = 12.0 * _SCATTER**2 + 1.0 - kept(_SCATTER)


def scatter_counts(observed: FloatArray | float) -> FloatArray:
    """Return the standard deviation (...) of lengths [counts] whose rounded counts have the observed variance (...) in units of that of one
    rounding, 1/12: the solution of 12 sigma^2 + 1 - kept(sigma) = observed."""
    observed = np.asarray(observed, dtype=np.float64)
    # beyond the table kept is nothing
    far = np.sqrt(np.maximum(observed - 1.0, 0.0) / 12.0)
    return np.where(observed < _OBSERVED[-1], np.interp(observed, _OBSERVED, _SCATTER), far)


def whitened_variance(covariance: FloatArray, of_one: FloatArray) -> FloatArray:
    """Return the mean variance (...) of poses' scatter (..., 6, 6) in units of that by one rounding, of_one (..., 6, 6), over the
    directions with one; zero without any."""
    size = np.sqrt(np.maximum(np.diagonal(of_one, axis1=-2, axis2=-1), 0.0))
    per = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    scale = per[..., :, None] * per[..., None, :]
    inverse = np.linalg.pinv(of_one * scale, rcond=1e-9, hermitian=True)
    rank = np.linalg.matrix_rank(of_one * scale, tol=1e-9, hermitian=True)
    total = np.einsum("...ij,...ji->...", inverse, covariance * scale)
    return np.asarray(total / np.maximum(rank, 1))


def of_dwells(errors: PoseErrors, factor: FloatArray, between: FloatArray, groups: IntArray) -> PoseErrors:
    """Return errors of the means over n dwells of one pose from those of single samples.

    factor (n, q): variance of the mean of each dwell over that of one rounding (`vibration.averaged`); groups (n,): index of the group of
    dwells at one position; between (6, 6): covariance of dwells about the mean of their group. Between the dwells of a group, the kept
    rounding is common; the scatter that it hides is not, and the whole of it stays.
    """
    mean = errors.random.mean(axis=0)
    common = kept(scatter_counts(whitened_variance(np.nan_to_num(between), mean)))
    local = np.sqrt(common * factor.mean(axis=0)) * errors.own.mean(axis=0)
    several = np.bincount(groups)[groups] > 1
    own = np.sqrt(factor)[:, None, :] * errors.own
    return replace(errors, own=own, local=np.where(several[:, None, None], local, 0.0), place=groups)


def of_crossings(errors: PoseErrors, weights: FloatArray, step: FloatArray, between: FloatArray) -> PoseErrors:
    """Errors where n cycles cross m planes, plane by plane, from those of single samples.

    A crossing has weights (m, n, 4) of the samples about it, step (m, n, 6) apart: of the variance of one it has the sum of the squares of
    them, if rounding keeps nothing over the step. Cycles in which the same samples are taken within a count of each other, between
    (m, 6, 6), are rounded alike: that is common to a plane. The scatter that rounding hides is not, and the whole of it stays.
    """
    m, n = weights.shape[:2]
    random = errors.random
    squares, way = weights.reshape(m * n, 4).T ** 2, step.reshape(m * n, 6)
    # lengths that scatter by sigma are sqrt(2) sigma apart
    apart = np.sqrt(whitened_variance(way[:, :, None] * way[:, None, :], random) / 12.0)
    same = kept(apart / np.sqrt(2.0))
    # the outer two have little: one draw for both
    parts = np.sqrt([same, *((1.0 - same) * square for square in (squares[1], squares[2], squares[0] + squares[3]))])
    crossed = replace(errors, own=np.einsum("kn,nij->nikj", parts, errors.own).reshape(m * n, 6, -1))
    if n == 1:
        return crossed
    common = kept(scatter_counts(whitened_variance(between, random.reshape(m, n, 6, 6).mean(axis=1))))
    size = np.sqrt(common * (parts**2).sum(axis=0).reshape(m, n).mean(axis=1))
    local = size[:, None, None] * errors.own.reshape(m, n, 6, -1).mean(axis=1)
    return replace(crossed, local=np.repeat(local, n, axis=0), place=np.repeat(np.arange(m), n))


def kept_over(errors: PoseErrors, step_mm: FloatArray) -> FloatArray:
    """(n,) correlation of the rounding errors of samples that follow each other in steps (n,) or (1,) [mm], errors of each (n)."""
    of_count = np.sqrt(12.0 * np.trace(errors.random[:, 3:, 3:], axis1=1, axis2=2) / 3.0)
    step_mm = np.broadcast_to(step_mm, of_count.shape)
    counts = np.divide(step_mm, of_count, out=np.zeros_like(of_count), where=of_count > 0.0)
    return kept(counts / np.sqrt(2.0))


def of_neighbours(errors: PoseErrors, step_mm: FloatArray, row: IntArray) -> PoseErrors:
    """Return errors of samples that follow each other in rows, row (n,) their index from 0, from those of single samples: the rounding kept
    over steps (n,) [mm] from one to the next is common to a row."""
    share = kept_over(errors, step_mm)[:, None, None]
    return replace(errors, own=np.sqrt(1.0 - share) * errors.own, local=np.sqrt(share) * errors.own, place=row)


def phases(errors: PoseErrors, apart: FloatArray, rng: np.random.Generator, trials: int) -> FloatArray:
    """Return (trials, n, m) possible places within a count of the m lengths at n visits, apart (n, 6) (rotation [rad]; position [mm]) from
    their mean; errors: of the n visits. The scatter of the visits, without their roundings, separates them."""
    n, m = len(errors), errors.own.shape[2]
    common = rng.random((trials, 1, m))
    if n == 1 or m == 0:
        return np.broadcast_to(common, (trials, n, m))
    counts = apart @ per_count(errors.own.mean(axis=0)).T
    sigma = float(scatter_counts(12.0 * counts.var(axis=0, ddof=1).mean()))
    return np.asarray(common + sigma * rng.standard_normal((trials, n, m)))


def roundings(own: FloatArray, moved: FloatArray, phase: FloatArray, away: FloatArray) -> FloatArray:
    """Return (trials, k, 6) errors (rotation [rad]; position [mm]) of k poses moved (k, 6) from a place where m lengths lie at phases
    (trials, m) of a count; own (6, m): effect on a pose there of one standard deviation of a rounded length.

    Measurements are whole counts from the place, true lengths are not: more than a count away lengths lie anywhere, by phases away (trials,
    m).
    """
    lengths = moved @ per_count(own).T
    lengths = phase[:, None, :] + lengths + np.minimum(np.abs(lengths), 1.0) * away[:, None, :]
    return np.asarray(np.sqrt(12.0) * (np.rint(lengths) - lengths) @ own.T)


def per_count(own: FloatArray) -> FloatArray:
    """(m, 6) counts that a pose's displacement makes, own (6, m) as in `roundings`."""
    size = np.linalg.norm(own, axis=1)
    per = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    return np.asarray(np.linalg.pinv(own * per[:, None]) * per / np.sqrt(12.0))
