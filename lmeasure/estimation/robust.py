"""Robust loss for groups of residuals that the others contradict: Tukey's biweight by iteratively reweighted least squares.

A group has a common error: an instrument was not where stated. d is its studentised deletion residual: the shift of its residuals from
all others, in units of that shift's own covariance, so that a group of great leverage cannot hide. d^2 is chi-squared with as many degrees
of freedom as the group can err in; z is the normal deviate as improbable as it, and t = z/scale with the scale from the median of all z, at
least 1, the stated noise. The biweight w = (1 - (t/c)^2)^2, zero beyond c, is 95 % efficient without faults.

A weight is carried as a variance: the group's shifts get the independent variance s^2 (1/w - 1) with s^2 their stated one, on top of it.
The covariance of the result is then that of a least squares with these variances, a little wider than without a robust loss, as it must be.

If residuals come in blocks that correlate with no others, the weights divide the blocks instead, and `trust` returns the efficiency of an
equation of weighted blocks.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from typing import TypeVar

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation.deletion import Deletion
from lmeasure.estimation.least_squares import fit
from lmeasure.estimation.problem import Fit, Problem

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
    """Rows that may be wrong together: columns (e, c) of their joint shift, its own rows, which give its stated variance, and the number of
    members that it represents among all groups."""

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
        deletion = Deletion(found)
        judged = [deletion.shift(group.columns, float(v)) for group, v in zip(groups, variance, strict=True)]
        square = np.array([np.nan if one is None else one.square for one in judged])
        z = normal_deviates(square, np.array([1 if one is None else one.freedom for one in judged]))
        scale = max(1.0, float(np.nanmedian(np.repeat(z, members))) / scipy.stats.norm.ppf(0.75)) if np.isfinite(z).any() else 1.0
        weight = biweights(np.where(np.isfinite(z), z, 0.0) / scale).clip(EXCLUDED)
        variance = stated * np.minimum(scale**2 * (1.0 / weight - 1.0), 1.0 / EXCLUDED)
        change = float(np.abs(weight - weights.weight).max())
        weights, problem = Weights(weight, scale), weighted(variance)
        found = fit(problem, found.theta, found.prior_everywhere, near=change < NEAR)
        if change < SETTLED:
            break
    return (problem, found, weights), variance


def normal_deviates(square: FloatArray, freedom: IntArray) -> FloatArray:
    """The |z| of standard normal variables that are as improbable as chi-squared values with those degrees of freedom."""
    probability = scipy.stats.chi2.sf(square, freedom)
    # beyond doubles' reach the degrees of freedom hardly matter
    return np.where(probability > 1e-280, scipy.stats.norm.isf(np.maximum(probability, 1e-280) / 2.0), np.sqrt(square))


def biweights(deviate: FloatArray) -> FloatArray:
    """Tukey's weight of normal deviates |z| in standard deviations, 0 from `BIWEIGHT` on."""
    return np.asarray((1.0 - np.minimum(deviate / BIWEIGHT, 1.0) ** 2) ** 2)


@cache
def scatter(freedom: int) -> float:
    """Weighted mean square of a component, in its variance, where nothing is wrong: E[w d^2] / (m E[w]), d^2 chi-squared with m degrees of
    freedom. By it a weighted scatter becomes a variance."""

    def mean(power: int) -> float:
        def part(d: float) -> float:
            weight = biweights(normal_deviates(np.array([d * d]), np.array([freedom])))[0]
            # but for a factor, which cancels
            return float(weight * d ** (power + 1) * scipy.stats.chi2.pdf(d * d, freedom))

        return float(scipy.integrate.quad(part, 0.0, 12.0, limit=200)[0])

    return mean(2) / (freedom * mean(0))


def trust(square: FloatArray, freedom: IntArray, weight: FloatArray, determined: float) -> float:
    """Return the true over the apparent information of a least squares with weighted blocks: 1.04 without faults.

    square (n,): d^2 of every block with m components, freedom (n,), from which weight (n,) follows; determined: number of unknowns that
    they determine. The sandwich of an equation sum w(d) J' V^-1 r = 0 (Huber and Ronchetti, Robust Statistics, 2009, 6.3 and 7.6) is, with
    means over all components, b / (a^2 n) times (J' V^-1 J / n)^-1, a = E[w + d w'/m], b = E[w^2 d^2/m], both times 1 + determined/n var(w
    + d w'/m)/a^2 for few of them. A least squares with weights states 1 / (n E[w]) instead. Blocks without weight stay visible in its
    normal equations: if all blocks of one kind are bad, nothing determines their parameters.
    """
    d, m = np.sqrt(square), freedom.astype(np.float64)
    z = normal_deviates(square, freedom)
    share = np.minimum(z / BIWEIGHT, 1.0)
    # two-sided tails are equal, and so are their derivatives: dz/dd
    steepness = 2.0 * d * scipy.stats.chi2.pdf(square, freedom) / np.maximum(2.0 * scipy.stats.norm.pdf(z), 1e-300)
    slope = weight - d / m * 4.0 * share / BIWEIGHT * (1.0 - share**2) * steepness
    a, mean = float(np.average(slope, weights=m)), float(np.average(weight, weights=m))
    expected = np.array([scatter(int(k)) for k in freedom])
    # errors smaller than stated make nothing better than stated
    size = min(float((weight @ square) / (weight @ (m * expected))), 1.0)
    b = float((weight**2) @ square / m.sum()) / size
    few = 1.0 + determined / m.sum() * float(np.average((slope - a) ** 2, weights=m)) / a**2
    return a**2 / (b * mean * few**2)
