"""Rounded counts of a robot that stands still: the same pose is rounded alike, again and again.

A count errs by a sawtooth of the true length. Where lengths scatter by a standard deviation of sigma counts, rounding errors of any two of
them are correlated by

    kept(sigma) = 6 / pi^2 * sum over k >= 1 of exp(-4 pi^2 k^2 sigma^2) / k^2

(the Fourier series of the sawtooth, averaged over where the mean length lies within a count): 1 where nothing moves, 0.5 at a tenth of a
count, 0.02 at three tenths. That fraction of the variance is not averaged away by more samples of a dwell nor by more cycles of a pose.
"""

import numpy as np
from numpy.typing import NDArray

from lmeasure.certification.errors_of_poses import PoseErrors, roots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_TERMS = np.arange(1, 200)


def kept(sigma_counts: FloatArray | float) -> FloatArray:
    """Correlation (...) of the rounding errors of two lengths that scatter by sigma_counts (...)."""
    sigma = np.asarray(sigma_counts, dtype=np.float64)
    series = 6.0 / np.pi**2 * np.sum(np.exp(-4.0 * (np.pi * _TERMS * sigma[..., None]) ** 2) / _TERMS**2, axis=-1)
    return np.where(sigma == 0.0, 1.0, series)


_SCATTER = np.linspace(0.0, 1.0, 2001)
_OBSERVED = 12.0 * _SCATTER**2 + 1.0 - kept(_SCATTER)


def scatter_counts(observed: FloatArray | float) -> FloatArray:
    """Standard deviation (...) of lengths [counts] whose rounded counts have the observed variance (...) in units of 1/12, what one
    rounding has: the solution of 12 sigma^2 + 1 - kept(sigma) = observed."""
    observed = np.asarray(observed, dtype=np.float64)
    # beyond the table kept is nothing
    far = np.sqrt(np.maximum(observed - 1.0, 0.0) / 12.0)
    return np.where(observed < _OBSERVED[-1], np.interp(observed, _OBSERVED, _SCATTER), far)


def whitened_variance(covariance: FloatArray, of_one: FloatArray) -> FloatArray:
    """Mean variance (...) of poses' scatter (..., 6, 6) in units of what one rounding makes, of_one (..., 6, 6), over the directions that
    have it; zero where none has."""
    size = np.sqrt(np.maximum(np.diagonal(of_one, axis1=-2, axis2=-1), 0.0))
    per = np.divide(1.0, size, out=np.zeros_like(size), where=size > 0.0)
    scale = per[..., :, None] * per[..., None, :]
    inverse = np.linalg.pinv(of_one * scale, rcond=1e-9, hermitian=True)
    rank = np.linalg.matrix_rank(of_one * scale, tol=1e-9, hermitian=True)
    total = np.einsum("...ij,...ji->...", inverse, covariance * scale)
    return np.asarray(total / np.maximum(rank, 1))


def of_dwells(errors: PoseErrors, within: FloatArray, between: FloatArray, readings: IntArray, groups: IntArray) -> PoseErrors:
    """Errors of the means over n dwells of one pose from those of single samples.

    within (n, 6, 6): covariance of the samples in each dwell; readings (n,): how many different readings each dwell has; groups (n,):
    number of the group of dwells at one place; between (6, 6): covariance of dwells about the mean of their group. A dwell whose samples
    stay within a count is one draw. Between the dwells of a group, what rounding keeps is common; the scatter that it hides is not, and
    the whole of it stays.
    """
    random = np.nan_to_num(errors.random)
    share = kept(scatter_counts(whitened_variance(np.nan_to_num(within), random)))
    factor = share + (1.0 - share) / readings
    mean = random.mean(axis=0)
    common = kept(scatter_counts(whitened_variance(np.nan_to_num(between), mean)))
    local = np.sqrt(common) * roots(mean * factor.mean())
    several = np.bincount(groups)[groups] > 1
    return PoseErrors(random * factor[:, None, None], np.where(several[:, None, None], local, 0.0), groups, errors.shared)


def of_crossings(errors: PoseErrors, part: FloatArray, step: FloatArray, between: FloatArray) -> PoseErrors:
    """Errors where n cycles cross m planes, plane by plane, from those of single samples.

    A crossing lies at part (m, n) of the step (m, n, 6) between two samples, straight between them: with p and 1 - p of their errors it has
    (1 - p)^2 + p^2 of the variance of one, two thirds on average, if rounding keeps nothing over the step. Cycles in which the same samples
    are taken within a count of each other, between (m, 6, 6), are rounded alike: that is common to a plane. The scatter that rounding hides
    is not, and the whole of it stays.
    """
    m, n = part.shape
    random = np.nan_to_num(errors.random)
    p, way = part.ravel(), step.reshape(m * n, 6)
    # lengths that scatter by sigma are sqrt(2) sigma apart
    apart = np.sqrt(whitened_variance(way[:, :, None] * way[:, None, :], random) / 12.0)
    factor = 1.0 - 2.0 * p * (1.0 - p) * (1.0 - kept(apart / np.sqrt(2.0)))
    crossed = random * factor[:, None, None]
    if n == 1:
        return PoseErrors.of(crossed, errors.shared)
    common = kept(scatter_counts(whitened_variance(between, random.reshape(m, n, 6, 6).mean(axis=1))))
    local = np.sqrt(common)[:, None, None] * roots(crossed.reshape(m, n, 6, 6).mean(axis=1))
    return PoseErrors(crossed, np.repeat(local, n, axis=0), np.repeat(np.arange(m), n), errors.shared)


def of_neighbours(errors: PoseErrors, step_mm: FloatArray, row: IntArray) -> PoseErrors:
    """Errors of samples that follow each other in rows, row (n,) their number from 0, from those of single samples: what rounding keeps
    over steps (n,) [mm] from one to the next is common to a row."""
    random = np.nan_to_num(errors.random)
    of_count = np.sqrt(12.0 * np.trace(random[:, 3:, 3:], axis1=1, axis2=2) / 3.0)
    counts = np.divide(step_mm, of_count, out=np.zeros_like(step_mm), where=of_count > 0.0)
    share = kept(counts / np.sqrt(2.0))[:, None, None]
    return PoseErrors((1.0 - share) * random, np.sqrt(share) * roots(random), row, errors.shared)
