"""Robust loss for groups of residuals that the others contradict: Tukey's biweight by iteratively reweighted least squares.

A group errs together: an instrument that did not stand where it says. d is its studentised deletion residual: the shift of its residuals
that all others ask for, in units of that shift's own covariance, so that a group of great leverage cannot hide. d^2 is chi-squared with
as many degrees of freedom as the group can err in; z is the normal deviate as improbable as it, and t = z/scale with the scale from the
median of all z, at least 1: the noise as stated. The biweight w = (1 - (t/c)^2)^2, zero beyond c, is 95 % efficient where nothing is wrong.

A weight is carried as a variance: the group's shifts get the independent variance s^2 (1/w - 1) with s^2 their stated one, on top of it.
The covariance of the result is then that of a least squares with these variances, a little wider than without a robust loss, as it must be.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import scipy.stats

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.estimation.deletion import Deletion
from lmeasure.estimation.fit import Fit
from lmeasure.estimation.least_squares import fit
from lmeasure.estimation.problem import Problem

BIWEIGHT = 4.685  # Tukey's constant for 95 % efficiency
ROUNDS = 30
SETTLED = 1e-3  # of a weight
NEAR = 0.2  # of a weight, from where the optimum moves little
EXCLUDED = 1e-6
"""Least weight, of the stated variances: a group without any has a finite variance still. It leaves one that is far off hardly a pull, and
smaller ones would leave its deletion residual no digits."""

P = TypeVar("P", bound=Problem)


@dataclass(frozen=True)
class Group:
    """What may be wrong together: columns (e, c) by which it shifts the residuals, its own rows, from which its stated variance is taken,
    and how many members it stands for among all groups."""

    columns: FloatArray
    rows: IntArray
    members: int = 1


@dataclass(frozen=True)
class Weights:
    """weight (g,) of each group, 1 where nothing speaks against it; scale of the noise in stated ones."""

    weight: FloatArray
    scale: float


def robust_fit(found: Fit, groups: Sequence[Group], weighted: Callable[[FloatArray], P]) -> tuple[P, Fit, Weights]:
    """The problem with the variances (g,) that the groups were given, as weighted makes it, its fit with Tukey's biweight, and the weights.

    The biweight has many optima. Begun at found, which bad groups may have pulled far away, and, with the weights it then has, at the
    nominal values; of the two, the one that believes more of the groups.
    """
    members = np.array([group.members for group in groups])
    first, variance = _reweighted(found, np.zeros(len(groups)), groups, weighted)
    begun = fit(first[0], first[0].start, found.prior_everywhere)
    second, _ = _reweighted(begun, variance, groups, weighted)
    return max(first, second, key=lambda result: float(result[2].weight @ members))


def _reweighted(
    found: Fit, variance: FloatArray, groups: Sequence[Group], weighted: Callable[[FloatArray], P]
) -> tuple[tuple[P, Fit, Weights], FloatArray]:
    """`robust_fit` from one fit and the variances it was made with, and those it ends with."""
    count, members = len(groups), [group.members for group in groups]
    weights, problem = Weights(np.ones(count), 1.0), weighted(variance)
    base = np.diag(weighted(np.zeros(count)).covariance(found.theta))
    stated = np.array([base[group.rows].mean() if len(group.rows) else base.mean() for group in groups])
    for _ in range(ROUNDS):
        deletion, z = Deletion(found), np.full(count, np.nan)
        for i, group in enumerate(groups):
            judged = deletion.shift(group.columns, float(variance[i]))
            if judged is not None:
                z[i] = _normal_deviate(judged.square, judged.freedom)
        scale = max(1.0, float(np.nanmedian(np.repeat(z, members))) / scipy.stats.norm.ppf(0.75)) if np.isfinite(z).any() else 1.0
        t = np.where(np.isfinite(z), z, 0.0) / (scale * BIWEIGHT)
        weight = np.where(t < 1.0, (1.0 - np.minimum(t, 1.0) ** 2) ** 2, 0.0).clip(EXCLUDED)
        variance = stated * np.minimum(scale**2 * (1.0 / weight - 1.0), 1.0 / EXCLUDED)
        change = float(np.abs(weight - weights.weight).max())
        weights, problem = Weights(weight, scale), weighted(variance)
        found = fit(problem, found.theta, found.prior_everywhere, near=change < NEAR)
        if change < SETTLED:
            break
    return (problem, found, weights), variance


def _normal_deviate(square: float, freedom: int) -> float:
    """The |z| of a standard normal variable that is as improbable as a chi-squared with that many degrees of freedom."""
    probability = float(scipy.stats.chi2.sf(square, freedom))
    # beyond doubles' reach the degrees of freedom hardly matter
    return float(scipy.stats.norm.isf(probability / 2)) if probability > 1e-280 else math.sqrt(square)
