"""Rounded counts of a robot that stands still: the same pose is rounded alike, again and again.

A count errs by a sawtooth of the true length. Where lengths scatter by a standard deviation of sigma counts, rounding errors of any two of
them are correlated by

    kept(sigma) = 6 / pi^2 * sum over k >= 1 of exp(-4 pi^2 k^2 sigma^2) / k^2

(the Fourier series of the sawtooth, averaged over where the mean length lies within a count): 1 where nothing moves, 0.5 at a tenth of a
count, 0.02 at three tenths. That fraction of the variance is not averaged away by more samples of a dwell nor by more cycles of a pose.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import brentq

from lmeasure.certification.errors_of_poses import PoseErrors, roots

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

_TERMS = np.arange(1, 200)


def kept(sigma_counts: float) -> float:
    """Correlation of the rounding errors of two lengths that scatter by sigma_counts."""
    if sigma_counts == 0.0:
        return 1.0
    return float(6.0 / np.pi**2 * np.sum(np.exp(-4.0 * (np.pi * _TERMS * sigma_counts) ** 2) / _TERMS**2))


def scatter_counts(observed: float) -> float:
    """Standard deviation of lengths [counts] whose rounded counts have the observed variance in units of 1/12, what one rounding has.

    Solves 12 sigma^2 + 1 - kept(sigma) = observed.
    """
    if observed <= 0.0:
        return 0.0
    return float(brentq(lambda s: 12.0 * s * s + 1.0 - kept(s) - observed, 0.0, np.sqrt(observed / 12.0) + 1.0, xtol=1e-9))


def whitened_variance(covariance: FloatArray, of_one: FloatArray) -> float:
    """Mean variance of poses' scatter (6, 6) in units of what one rounding makes, of_one (6, 6), over the directions that have it."""
    size = np.sqrt(np.maximum(np.diag(of_one), 0.0))
    measured = size > 0
    if not measured.any():
        return 0.0
    scale = np.outer(size[measured], size[measured])
    scaled = of_one[np.ix_(measured, measured)] / scale
    inverse = np.linalg.pinv(scaled, rcond=1e-9, hermitian=True)
    rank = int(np.linalg.matrix_rank(scaled, tol=1e-9, hermitian=True))
    return float(np.trace(inverse @ (covariance[np.ix_(measured, measured)] / scale)) / rank)


def of_dwells(errors: PoseErrors, within: FloatArray, between: FloatArray, readings: IntArray, groups: IntArray) -> PoseErrors:
    """Errors of the means over n dwells of one pose from those of single samples.

    within (n, 6, 6): covariance of the samples in each dwell; readings (n,): how many different readings each dwell has; groups (n,):
    number of the group of dwells at one place; between (6, 6): covariance of dwells about the mean of their group. A dwell whose samples
    stay within a count is one draw. Between the dwells of a group, what rounding keeps is common; the scatter that it hides is not, and
    the whole of it stays.
    """
    random = np.nan_to_num(errors.random)
    factor = np.empty(len(random))
    for j, one in enumerate(random):
        share = kept(scatter_counts(whitened_variance(np.nan_to_num(within[j]), one))) if within[j].any() else 1.0
        factor[j] = share + (1.0 - share) / readings[j]
    mean = random.mean(axis=0)
    share = kept(scatter_counts(whitened_variance(np.nan_to_num(between), mean)))
    common = np.sqrt(share) * roots((mean * factor.mean())[None])[0]
    several = [group for group, size in zip(*np.unique(groups, return_counts=True), strict=True) if size > 1]
    own = [np.where((groups == group)[:, None, None], common, 0.0) for group in several]
    return PoseErrors(random * factor[:, None, None], np.concatenate([errors.own, *own], axis=2), errors.shared)
