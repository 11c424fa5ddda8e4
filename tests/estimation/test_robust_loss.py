"""Tukey's biweight of groups, each number of it said a second time: what the others say of a group by a fit without it, weights by the
formula, the worth of weighted blocks by differences and quantiles."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from problems import Curve, Line, Readings

from lmeasure.core import FloatArray
from lmeasure.estimation import Group, biweights, fit, robust_fit, scatter, trust

GROUPS = np.repeat(np.arange(10), 3)
X = np.linspace(-1.0, 1.0, 30) ** 3
OWN = 0.002 * (1.0 + GROUPS)
"""Variances of the groups' readings beside 0.1^2."""
OFF, UNDETERMINED = 3, 9


def shifts(group: int) -> FloatArray:
    """A group's readings are shifted and tilted, but for the last, which shifts everything: nobody can contradict that."""
    return np.ones((30, 1)) if group == UNDETERMINED else np.where(GROUPS[:, None] == group, np.vander(X - X[3 * group], 2), 0.0)


def groups(*, members: int = 1) -> list[Group]:
    """The one that is off has no rows of its own, another stands for more."""
    some = [Group(shifts(g), np.flatnonzero(g == GROUPS)) for g in range(10)]
    some[OFF] = replace(some[OFF], rows=np.zeros(0, np.int64))
    some[7] = replace(some[7], members=members)
    return some


def line(noise: float) -> tuple[Line, Callable[[FloatArray], Line], list[FloatArray]]:
    """A line whose fourth group is off; the same with variances of the groups, and all variances that it was asked with."""
    y = 0.3 + 2.0 * X + noise * np.random.default_rng(3).normal(size=30) * np.sqrt(0.1**2 + OWN)
    y[GROUPS == OFF] += 0.3 * max(noise, 1.0)
    requested: list[FloatArray] = []

    def weighted(variance: FloatArray) -> Line:
        requested.append(variance)
        more = np.diag(OWN) + sum((v * shifts(g) @ shifts(g).T for g, v in enumerate(variance)), start=np.zeros((30, 30)))
        return Line(Readings(X, y, more=more))

    return weighted(np.zeros(10)), weighted, requested


def deviate(problem: Line, variance: FloatArray, group: int) -> float:
    """|z| of a group's shift and tilt against a line through the other readings alone."""
    rest, mine = np.flatnonzero(group != GROUPS), np.flatnonzero(group == GROUPS)
    own, V, J, y = shifts(group)[mine], problem.covariance(np.zeros(2)), np.vander(X, 2, increasing=True), problem.readings.y
    of_rest = np.linalg.solve(V[np.ix_(rest, rest)], J[rest])
    information = J[rest].T @ of_rest
    error = y[mine] - J[mine] @ np.linalg.solve(information, of_rest.T @ y[rest])
    W = np.linalg.inv(V[np.ix_(mine, mine)] - variance[group] * own @ own.T + J[mine] @ np.linalg.solve(information, J[mine].T))
    seen = own.T @ W @ error
    square = float(seen @ np.linalg.solve(own.T @ W @ own, seen))
    return float(-scipy.stats.norm.ppf(scipy.stats.chi2.sf(square, 2) / 2.0))


@pytest.mark.parametrize(("noise", "members"), [(0.4, 1), (2.5, 1), (2.5, 6)])
def test_weights_are_those_of_what_the_others_say(noise: float, members: int) -> None:
    begun, weighted, requested = line(noise)
    problem, found, weights = robust_fit(fit(begun, begun.start), groups(members=members), weighted)
    variance = next(v for v in reversed(requested) if np.array_equal(weighted(v).covariance(found.theta), problem.covariance(found.theta)))
    z = np.array([deviate(problem, variance, g) for g in range(UNDETERMINED)])
    every = np.repeat(z, [members if g == 7 else 1 for g in range(UNDETERMINED)])
    scale = max(1.0, float(np.median(every)) / 0.6744897501960817)
    assert weights.scale == pytest.approx(scale, abs=0.0 if noise < 1 else 5e-3)
    assert (weights.scale == 1.0) == (noise < 1)
    expected = np.r_[(1.0 - np.minimum(z / scale / 4.685, 1.0) ** 2) ** 2, 1.0]
    np.testing.assert_allclose(weights.weight, expected, atol=3e-3)
    assert weights.weight[UNDETERMINED] == 1.0
    assert 0.01 < weights.weight[OFF] < 0.8
    # what has no rows of its own errs as all do in the mean
    stated = np.r_[[0.1**2 + 0.002 * (1.0 + g) for g in range(9)], 0.1**2 + OWN.mean()]
    stated[OFF] = 0.1**2 + OWN.mean()
    np.testing.assert_allclose(variance, stated * weights.scale**2 * (1.0 / weights.weight - 1.0), rtol=1e-9)


def test_it_ends_when_weights_are_settled() -> None:
    begun, weighted, requested = line(0.4)
    robust_fit(fit(begun, begun.start), groups(), weighted)
    assert len(requested) < 30


def test_where_nobody_can_be_contradicted_all_are_believed() -> None:
    begun, weighted, _ = line(2.5)
    everything = [Group(shifts(UNDETERMINED), np.arange(30)), Group(np.zeros((30, 0)), np.arange(3))]
    _, found, weights = robust_fit(fit(begun, begun.start), everything, lambda variance: weighted(np.zeros(10)))
    assert (weights.scale, weights.weight.tolist()) == (1.0, [1.0, 1.0])
    np.testing.assert_allclose(found.theta, fit(begun, begun.start).theta, atol=1e-9)


def test_an_optimum_that_nothing_contradicts_is_kept() -> None:
    """Nothing is left at -2 and at 2; from the nominal value the other one would be found."""
    gain = 1.0 / np.sqrt(12.0)
    problem = Curve(lambda z: np.full(3, gain * (z[0] ** 2 - 4.0)), lambda z: np.full((3, 1), 2.0 * gain * z[0]), np.array([3.0]))
    each = [Group(column[:, None], np.array([row])) for row, column in enumerate(np.eye(3))]
    found = fit(problem, np.array([-2.1]), near=True)
    assert robust_fit(found, each, lambda variance: problem)[1].theta[0] == pytest.approx(-2.0, abs=1e-6)
    assert fit(problem, np.array([-2.1])).theta[0] == pytest.approx(2.0, abs=1e-6)


def quantiles(freedom: int) -> tuple[FloatArray, FloatArray]:
    """d^2 of chi-squared in even steps of probability, and the weights of the normal deviates that are as improbable."""
    share = (np.arange(20_000) + 0.5) / 20_000
    z = scipy.stats.norm.ppf(0.5 + 0.5 * share)
    return scipy.stats.chi2.ppf(share, freedom), (1.0 - np.minimum(z / 4.685, 1.0) ** 2) ** 2


@pytest.mark.parametrize("freedom", [1, 3, 6])
def test_a_weighted_scatter_is_that_of_chi_squared(freedom: int) -> None:
    square, weight = quantiles(freedom)
    assert scatter(freedom) == pytest.approx(float(weight @ square) / (freedom * weight.sum()), abs=5e-4)


@pytest.mark.parametrize("size", [0.4, 1.7])
def test_the_worth_of_weighted_blocks(size: float) -> None:
    """The sandwich of the estimating equation by definition, how it goes with d by differences; few blocks of several sizes."""
    rng = np.random.default_rng(5)
    freedom = np.tile([1, 3, 6], 12)
    d = size * np.sqrt(rng.chisquare(freedom))
    # three blocks are far off, one of them so far that only its steepness would tell
    d[[4, 11, 18]] = 9.0, 6.0, 80.0

    def weight(d: FloatArray) -> FloatArray:
        z = scipy.stats.norm.isf(np.maximum(scipy.stats.chi2.sf(d**2, freedom), 1e-300) / 2.0)
        return np.asarray((1.0 - np.minimum(z / 4.685, 1.0) ** 2) ** 2)

    w, determined, n = weight(d), 7.0, float(freedom.sum())
    change = (weight(d + 1e-6) - weight(d - 1e-6)) / 2e-6
    # per component, of which each block has its freedom
    slope = np.repeat(w + d * change / freedom, freedom)
    a, mean = float(slope.mean()), float(np.repeat(w, freedom).mean())
    noise = float(np.sum(w * d**2)) / float(np.sum(w * freedom * [scatter(int(m)) for m in freedom]))
    assert (noise < 1.0) == (size < 1.0)
    b = float(np.sum(w**2 * d**2)) / n / min(noise, 1.0)
    few = 1.0 + determined / n * float(slope.var()) / a**2
    assert trust(d**2, freedom, w, determined) == pytest.approx(1.0 / (b / a**2 * few**2 * mean), rel=1e-6)
    np.testing.assert_allclose(biweights(np.array([0.0, 2.3425, 4.685, 50.0])), [1.0, 0.5625, 0.0, 0.0], atol=1e-15)
