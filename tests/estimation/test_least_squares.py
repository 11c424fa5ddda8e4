"""The estimator by itself: problems of a circle, a line and stations in a plane, against exact results, Monte Carlo and SciPy."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
import scipy.stats
from problems import Curve, Line, Plane, Readings, Stations, arc, plane

from lmeasure.core import CalibrationError, FloatArray
from lmeasure.estimation import Eliminated, Fit, Nuisance, Parameters, Problem, fit, linear_objective, regions


def test_values_belong_to_what_their_names_say() -> None:
    """All of a name but its last part is whose the value is; blocks of unknowns are as many as there are sets of them."""
    names = ("cell.B1.x_mm", "B2.x_mm", "cell.B1.y_mm")
    parameters = Parameters(names, np.zeros(3), np.ones(3))
    assert [parameters.owner(i) for i in range(3)] == ["cell.B1", "B2", "cell.B1"]
    assert parameters.of("cell.B1").tolist() == [0, 2]
    problem = plane(1, since_first=False)
    assert problem.nuisance is not None
    assert problem.nuisance.blocks == 12
    nothing = np.zeros(0, np.int64)
    assert Nuisance(0, (), nothing, nothing).blocks == 0
    # unless a problem says so no error is uniform
    own, shared = problem.uniform()
    np.testing.assert_array_equal(own, np.zeros(60))
    assert shared.shape == (60, 0)


@pytest.mark.parametrize(
    "problem",
    [arc(6.0, 20, 0.1, 0), plane(1, since_first=False), plane(1, since_first=True, hidden=3), plane(1, since_first=True, firsts=2)],
)
def test_derivatives(problem: Problem) -> None:
    theta = problem.start + np.random.default_rng(0).normal(size=len(problem.names))
    h = 1e-4
    numeric = [(problem.residuals(theta + d) - problem.residuals(theta - d)) / (2 * h) for d in h * np.eye(len(theta))]
    np.testing.assert_allclose(problem.jacobian(theta), np.array(numeric).T, atol=1e-7)


def test_a_circle_is_found_and_what_no_point_tells_stays() -> None:
    """As far as the data decide the result is that of SciPy; the covariance is that of repeated measurements."""
    problem = arc(6.0, 20, 0.1, 0)
    found = fit(problem, problem.start)
    plain = scipy.optimize.least_squares(lambda x: problem.residuals(np.r_[x, 0.0]), [0.0, 0.0, 90.0], xtol=1e-14, ftol=1e-14)
    np.testing.assert_allclose(found.theta[:3], plain.x, atol=1e-7)
    assert found.theta[3] == 0.5
    assert (found.rank, found.freedom, found.converged) == (3, 17, True)
    assert found.chi2 == pytest.approx(2 * plain.cost / 0.1**2)
    np.testing.assert_allclose(np.abs(found.silent), [[0.0, 0.0, 0.0, 1.0]], atol=1e-12)
    assert found.covariance[3, 3] == pytest.approx(0.1**2)
    assert found.held_covariance == pytest.approx(np.diag([0.0, 0.0, 0.0, 0.01]), abs=1e-15)
    J = problem.jacobian(found.theta)[:, :3]
    np.testing.assert_allclose(found.covariance[:3, :3], 0.1**2 * np.linalg.inv(J.T @ J), rtol=1e-9, atol=1e-12)
    drawn = np.array([fit(p, p.start).theta[:3] for p in (arc(6.0, 20, 0.1, seed) for seed in range(300))]) - [3.0, -2.0, 100.0]
    squares = np.einsum("na,na->n", drawn, np.linalg.solve(found.covariance[:3, :3], drawn.T).T)
    assert squares.mean() == pytest.approx(3.0, abs=4 * np.sqrt(6 / 300))
    # how the result follows errors of the residuals
    shift = np.random.default_rng(1).normal(0, 1e-4, 20)
    moved = arc(6.0, 20, 0.1, 0)
    moved.points = moved.points + shift[:, None] * (moved.points - found.theta[:2]) / 100.0
    far = np.linalg.norm(problem.points - found.theta[:2], axis=1) / 100.0
    np.testing.assert_allclose(fit(moved, found.theta).theta - found.theta, -found.gain @ (shift * far), atol=1e-7)


def test_where_the_data_say_less_than_the_prior_it_decides() -> None:
    """Of a short arc the data tell one combination of centre and radius less well than the priors do; along it nominal values stay, with
    the prior everywhere all is as by Bayes' rule."""
    problem = arc(0.05, 8, 0.1, 2)
    found, width = fit(problem, problem.start), problem.parameters.width
    assert 1 <= found.rank < 3
    away = found.silent @ ((found.theta - problem.start) / width)
    assert np.abs(away).max() < 0.01
    # what only priors tell of the points: how they would lie with it one standard uncertainty off
    apart, J = found.undetermined, problem.jacobian(found.theta)
    np.testing.assert_allclose(apart @ apart.T, J @ found.held_covariance @ J.T, atol=1e-12)
    assert np.abs(apart).max() > 1e-3
    everywhere = fit(problem, problem.start, prior_everywhere=True)

    def both(theta: FloatArray) -> FloatArray:
        return np.r_[problem.residuals(theta) / 0.1, (theta - problem.start) / width]

    plain = scipy.optimize.least_squares(both, problem.start, x_scale=width, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    np.testing.assert_allclose((everywhere.theta - plain.x) / width, 0.0, atol=1e-4)
    assert everywhere.objective == pytest.approx(2 * plain.cost)
    J = problem.jacobian(everywhere.theta)
    bayes = np.linalg.inv(J.T @ J / 0.1**2 + np.diag(width**-2.0))
    np.testing.assert_allclose(everywhere.covariance / np.outer(width, width), bayes / np.outer(width, width), atol=1e-9)


def test_with_the_prior_everywhere_the_optimum_is_exact() -> None:
    """Where residuals are large and bent, so that each step mends only a part: the derivative of the objective is nothing there."""
    points = np.array([[3.0, 1.0], [-2.0, 2.0], [1.0, -3.0], [-1.0, -2.0]])

    def of(theta: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(points - theta, axis=1) - [7.0, 1.0, 6.0, 1.5])

    def by(theta: FloatArray) -> FloatArray:
        way = points - theta
        return np.asarray(-way / np.linalg.norm(way, axis=1)[:, None])

    problem = Curve(of, by, np.zeros(2))
    found = fit(problem, problem.start, prior_everywhere=True)
    assert found.chi2 > 5.0
    assert found.converged
    slope = problem.jacobian(found.theta).T @ problem.residuals(found.theta) + found.theta
    assert np.abs(slope).max() < 1e-5


def test_a_valley_that_never_ends_is_said_not_to_be_settled() -> None:
    """It winds a thousandth of a standard uncertainty wide to where the data are eight prior widths away."""

    def of(theta: FloatArray) -> FloatArray:
        return np.array([1000.0 * (theta[1] - np.sin(5.0 * theta[0]) / 5.0), 2.0 * (theta[0] - 8.0)])

    def by(theta: FloatArray) -> FloatArray:
        return np.array([[-1000.0 * np.cos(5.0 * theta[0]), 1000.0], [2.0, 0.0]])

    problem = Curve(of, by, np.zeros(2))
    assert not fit(problem, problem.start, prior_everywhere=True).converged
    # next to its end it comes there
    near = fit(problem, np.array([6.4, np.sin(32.0) / 5.0]), prior_everywhere=True)
    assert near.converged
    assert near.theta[0] == pytest.approx(6.4, abs=0.02)


class Uneven(Line):
    """Readings err the more the steeper the line is, far out above all."""

    covariance_varies = True

    def covariance(self, theta: FloatArray) -> FloatArray:
        return np.diag(self.readings.u**2 * (1.0 + theta[1] ** 2 * self.readings.x**4))


@pytest.mark.parametrize("prior", [False, True])
def test_a_covariance_that_varies_is_that_at_the_optimum(prior: bool) -> None:
    """From a start where it was quite another; against least squares with weights that are renewed until they stay."""
    x, rng = np.linspace(0.0, 3.0, 20), np.random.default_rng(2)
    readings = Readings(x, 0.3 + 2.0 * x + np.sqrt(1.0 + 4.0 * x**4) * rng.normal(0, 0.1, 20))
    problem = Uneven(readings)
    theta: FloatArray = np.zeros(2)
    J = problem.jacobian(theta)
    for _ in range(50):
        weight = 1.0 / np.diag(problem.covariance(theta))
        information = (J.T * weight) @ J + prior * np.eye(2) / 100.0
        theta = np.asarray(np.linalg.solve(information, (J.T * weight) @ readings.y), dtype=np.float64)
    u = np.sqrt(np.diag(np.linalg.inv(information)))
    found, plain = fit(problem, problem.start, prior), fit(Line(readings), problem.start, prior)
    assert np.abs((plain.theta - theta) / u).max() > 0.5
    np.testing.assert_allclose((found.theta - theta) / u, 0.0, atol=0.05)
    np.testing.assert_allclose(found.V, problem.covariance(found.theta))


def whole(problem: Stations, found: Fit, prior: bool) -> tuple[FloatArray, FloatArray]:
    """The problem solved for everything at once, with the prior everywhere or not, and the information there."""
    width = np.r_[problem.parameters.width, np.full(len(found.theta) - problem.own, np.inf)]
    W = np.linalg.inv(np.linalg.cholesky(problem.covariance(found.theta)))

    def both(theta: FloatArray) -> FloatArray:
        return np.r_[W @ problem.residuals(theta), prior * (theta - problem.start) / width]

    def jacobian(theta: FloatArray) -> FloatArray:
        return np.vstack([W @ problem.jacobian(theta), prior * np.diag(1.0 / width)])

    solved = scipy.optimize.least_squares(both, found.theta + 0.01, jac=jacobian, xtol=1e-15, ftol=1e-15, gtol=1e-15)
    J = jacobian(solved.x)
    return solved.x, J.T @ J


@pytest.mark.parametrize(
    ("since_first", "hidden", "firsts"), [(False, 0, 1), (False, 3, 1), (True, 0, 1), (True, 3, 1), (True, 0, 2), (True, 2, 3)]
)
def test_eliminating_is_solving_for_everything(since_first: bool, hidden: int, firsts: int) -> None:
    """Also of what several residuals share, and has residuals of its own beside."""
    problem = plane(1, since_first=since_first, hidden=hidden, firsts=firsts)
    found = fit(problem, problem.start, prior_everywhere=True)
    theta, information = whole(problem, found, prior=True)
    u = np.sqrt(np.diag(found.covariance))
    assert found.converged
    np.testing.assert_allclose((found.theta - theta) / u, 0.0, atol=2e-3)
    inverse = np.linalg.inv(information)
    np.testing.assert_allclose(found.covariance / np.outer(u, u), inverse / np.outer(u, u), atol=1e-6)


def test_the_linear_problem_is_solved_as_for_everything_at_once() -> None:
    problem = plane(1, since_first=True, hidden=3)
    own, start = problem.own, problem.start
    W, J, r = np.linalg.inv(np.linalg.cholesky(problem.covariance(start))), problem.jacobian(start), problem.residuals(start)
    prior = np.eye(own, len(start)) / problem.parameters.width[:, None]
    rest = np.linalg.lstsq(np.vstack([W @ J, prior]), -np.r_[W @ r, np.zeros(own)])[1]
    assert linear_objective(problem) == pytest.approx(float(rest[0]))
    # with the parameters held only nuisance parameters follow
    held = float(np.linalg.lstsq(W @ J[:, own:], -W @ r)[1][0])
    part, z = Eliminated(problem, start, problem.covariance(start), own), np.linspace(-1.0, 2.0, own)
    assert part.merit(r, z, everywhere=False) == pytest.approx(held)
    assert part.merit(r, z, everywhere=True) == pytest.approx(held + z @ z)


def test_only_motions_of_the_whole_are_left_to_the_priors() -> None:
    """Shifts and a turn of stations and targets together change no distance: three directions, along which nominal values stay."""
    problem = plane(1, since_first=False)
    found = fit(problem, problem.start)
    z = (found.theta[: problem.own] - problem.parameters.nominal) / problem.parameters.width
    assert (found.rank, len(found.silent)) == (len(found.theta) - 3, 3)
    assert np.abs(found.silent @ z).max() < 1e-3
    np.testing.assert_allclose(found.undetermined, 0.0, atol=1e-8)
    theta, _ = whole(problem, found, prior=False)
    r = problem.residuals(theta)
    assert found.chi2 == pytest.approx(float(r @ np.linalg.solve(found.V, r)), rel=1e-6)
    assert found.freedom == 60 - len(found.theta) + 3
    # together the gains and what is held make the covariance
    follows, held = found.gain, np.linalg.svd(found.covariance)[0]
    assert held.shape == found.covariance.shape
    np.testing.assert_allclose(found.covariance[: problem.own, : problem.own], (follows @ found.V @ follows.T)[: problem.own, : problem.own]
                               + found.held_covariance, rtol=1e-6, atol=1e-9)  # fmt: skip


def test_a_block_that_is_not_told_is_named() -> None:
    """A target that one station alone sees lies anywhere on a circle."""
    problem = plane(1, since_first=False)
    seen = problem.nominal.seen.copy()
    seen[7, 1:] = False
    blind = Stations(Plane(problem.nominal.stations, problem.nominal.targets, seen), np.full((12, 5), 500.0), 0.01, since_first=False)
    with pytest.raises(CalibrationError, match=r"^target 7\.x: the residuals do not determine it$"):
        fit(blind, blind.start, prior_everywhere=True)


def test_what_others_count_from_is_named_where_it_is_undetermined() -> None:
    """One station counts from a target that no other sees: from wherever on a circle about itself."""
    sound = plane(1, since_first=True, firsts=2)
    seen = sound.nominal.seen.copy()
    seen[:, 3] = False
    seen[1, [0, 2, 4]] = False
    blind = Stations(Plane(sound.nominal.stations, sound.nominal.targets, seen), np.full((12, 5), 500.0), 0.01, since_first=True, firsts=2)
    with pytest.raises(CalibrationError, match=r"^target [01]\.x: the residuals do not determine it$"):
        fit(blind, blind.start, prior_everywhere=True)


def test_a_block_of_which_no_residual_says_anything_is_named() -> None:
    problem = Curve(lambda z: 3.0 * z, lambda z: 3.0 * np.eye(1), np.zeros(1), beside=True)
    deaf = Curve(lambda z: 3.0 * z, lambda z: 3.0 * np.eye(1), np.zeros(1), beside=True)
    deaf.jacobian = lambda theta: problem.jacobian(theta) * [1.0, 0.0]  # type: ignore[method-assign]
    assert fit(problem, problem.start).converged
    with pytest.raises(CalibrationError, match=r"^place: the residuals do not determine it$"):
        fit(deaf, deaf.start)


def test_what_a_loss_takes_back_tells_no_more_than_if_it_were_not_there() -> None:
    """A target whose distances count for nothing leaves as many degrees of freedom as one that was not seen: its place goes with them. One
    that two stations see has none to lose, and of half a variance half is lost."""
    whole = plane(1, since_first=False, hidden=1)
    seen = whole.nominal.seen.copy()
    seen[5] = False
    kept = np.delete(np.arange(12), 5)
    distance = np.zeros((12, 5))
    distance[whole.target, whole.station] = whole.measured
    fewer = Stations(Plane(whole.nominal.stations, whole.nominal.targets[kept], seen[kept]), distance[kept], whole.u, since_first=False)
    expected = fit(fewer, fewer.start)

    def loosened(target: int, times: float) -> Fit:
        taken = times * whole.u**2 * (whole.target == target)
        problem = Stations(whole.nominal, distance, whole.u, since_first=False, taken=taken)
        return fit(problem, problem.start)

    found = loosened(5, 1e6)
    assert found.lost == pytest.approx(5 - 2, rel=1e-5)
    assert found.freedom == expected.freedom
    np.testing.assert_allclose(found.theta[: whole.own], expected.theta[: whole.own], atol=1e-3)
    assert loosened(5, 1.0).lost == pytest.approx((5 - 2) / 2.0)
    assert loosened(1, 1e6).lost == 0.0


def test_regions_of_a_straight_problem_are_those_of_its_errors() -> None:
    """Gaussian errors make chi-squared; those of one value of three uniform errors reach less far than a Gaussian of their variance."""
    x, rng = np.linspace(-1.0, 1.0, 12), np.random.default_rng(0)
    y = 0.3 + 0.2 * x + rng.normal(0, 0.1, 12)
    problem = Line(Readings(x, y))
    found = fit(problem, problem.start)
    where = regions(found, 0)
    np.testing.assert_allclose(where.covariance, found.covariance, rtol=1e-9, atol=1e-12)
    assert where.factor == pytest.approx(2.448, rel=0.04)
    assert pytest.approx(1.96 * np.sqrt(np.diag(found.covariance)), rel=0.04) == where.U95
    assert where.bend < 1e-6
    three = Line(Readings(np.array([-1.0, 0.0, 1.0]), np.array([0.1, 0.0, 0.2]), rounded=True))
    rounded = regions(fit(three, three.start), 0)
    # the slope is half the difference of two uniform errors: triangular, which 95 % of it is within 1.9 standard deviations
    assert rounded.U95[1] == pytest.approx(np.sqrt(6.0) * (1 - np.sqrt(0.05)) * 0.1 / np.sqrt(2.0), rel=0.03)
    wider = regions(found, 0, freedom=4)
    assert wider.factor > 1.2 * where.factor


def test_regions_of_what_no_residual_tells_are_those_of_its_prior() -> None:
    problem = arc(6.0, 20, 0.1, 0)
    where = regions(fit(problem, problem.start), 0)
    assert where.U95[3] == pytest.approx(1.96 * 0.1, rel=0.04)
    assert where.covariance[3] == pytest.approx([0.0, 0.0, 0.0, 0.1**2], abs=1e-9)


def test_regions_beside_nuisance_parameters_are_those_of_the_whole() -> None:
    """What the whole turns by bends less than distances err by, so that the linear covariance is all."""
    problem = plane(1, since_first=False, u=1.0)
    found = fit(problem, problem.start, prior_everywhere=True)
    own, where = problem.own, regions(found, 0)
    u = np.sqrt(np.diag(found.covariance)[:own])
    np.testing.assert_allclose(where.covariance / np.outer(u, u), found.covariance[:own, :own] / np.outer(u, u), atol=1e-3)
    np.testing.assert_allclose(where.U95, 1.96 * u, rtol=0.06)
    assert where.factor == pytest.approx(np.sqrt(scipy.stats.chi2.ppf(0.95, own)), rel=0.03)


@pytest.mark.parametrize("excess", [1.0, 2.0])
def test_regions_beside_nuisance_parameters_are_as_bent_as_without(excess: float) -> None:
    """The same values with and without a place beside them that does not hang on them; of the second order there is an exact figure, also
    of residuals that are larger than stated."""

    def of(theta: FloatArray) -> FloatArray:
        a, b = theta
        return np.array([10.0 * a + 60.0 * a**2, 12.0 * b, 12.0 * b])

    def by(theta: FloatArray) -> FloatArray:
        return np.array([[10.0 + 120.0 * theta[0], 0.0], [0.0, 12.0], [0.0, 12.0]])

    fits = [fit(p, p.start, prior_everywhere=False) for p in (Curve(of, by, np.zeros(2), beside=beside) for beside in (False, True))]
    alone, beside = (regions(replace(one, covariance=excess * one.covariance, excess=excess), 0) for one in fits)
    # x = xi - 0.6 xi^2 in standard uncertainties of 1 / 10: variance 1 + 0.36 * 3
    for found in (alone, beside):
        np.testing.assert_allclose(np.diag(found.covariance), [excess * (1.0 + 0.36 * 3.0 * excess) / 100.0, excess / 288.0], rtol=0.13)
        assert found.bend == pytest.approx(np.sqrt(0.36 * 3.0 * excess), rel=0.1)
    np.testing.assert_allclose(beside.covariance, alone.covariance, rtol=0.2, atol=1e-4)
    np.testing.assert_allclose(beside.U95, alone.U95, rtol=0.08)
    assert beside.factor == pytest.approx(alone.factor, rel=0.08)
