"""Regions of estimates: laws that hold whatever is estimated, and distributions that are drawn plainly."""

import numpy as np
import pytest
import scipy.stats
from problems import Curve, Line, Readings, Tied, plane

from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, fit, regions


def test_a_prior_everywhere_is_a_measurement_of_each_value() -> None:
    """Of values that are told about as well as they were known, along a bent valley."""

    def of(theta: FloatArray) -> FloatArray:
        a, b = theta
        return np.array([2.0 * a + 2.4 * a**2 - 0.3 * b, 0.7 * b + 0.2 * a])

    def by(theta: FloatArray) -> FloatArray:
        return np.array([[2.0 + 4.8 * theta[0], -0.3], [0.2, 0.7]])

    held = Curve(of, by, np.zeros(2))
    measured = Curve(lambda z: np.r_[of(z), z], lambda z: np.vstack([by(z), np.eye(2)]), np.zeros(2))
    measured.parameters = Parameters(measured.parameters.names, np.zeros(2), np.full(2, 1000.0))
    fits = fit(held, held.start, prior_everywhere=True), fit(measured, measured.start)
    # figures of eight draws, each of which tells them to a few per cent
    one, other = ([regions(found, seed) for seed in range(8)] for found in fits)
    assert np.mean([r.bend for r in one]) > 0.5

    def same(a: list[FloatArray], b: list[FloatArray]) -> None:
        np.testing.assert_allclose(np.mean(a, axis=0), np.mean(b, axis=0), rtol=0.06, atol=0.01)

    same([np.r_[r.bend, r.factor] for r in one], [np.r_[r.bend, r.factor] for r in other])
    same([r.U95 for r in one], [r.U95 for r in other])
    same([r.covariance for r in one], [r.covariance for r in other])


@pytest.mark.parametrize("freedom", [None, 5])
def test_the_second_order_grows_with_the_square_of_an_estimated_noise(freedom: int | None) -> None:
    """One value is told to a tenth, and along a parabola: x = t xi - 0.6 (t xi)^2 with xi normal and t Student's, drawn plainly."""
    problem = Curve(lambda z: 10.0 * z + 60.0 * z**2, lambda z: np.array([[10.0 + 120.0 * z[0]]]), np.zeros(1))
    where = regions(fit(problem, problem.start), 0, freedom)
    rng = np.random.default_rng(1)
    t = 1.0 if freedom is None else np.sqrt(freedom / rng.chisquare(freedom, 400_000))
    xi = t * rng.normal(size=400_000)
    x = xi - 0.6 * xi**2
    assert where.covariance[0, 0] == pytest.approx((1.0 + 3.0 * 0.36) / 100.0, rel=0.1)
    assert where.U95[0] == pytest.approx(np.quantile(np.abs(x), 0.95) / 10.0, rel=0.08)
    assert where.factor == pytest.approx(np.quantile(np.abs(x), 0.95) / np.sqrt(1.0 + 3.0 * 0.36), rel=0.08)


@pytest.mark.parametrize("freedom", [0, 1])
def test_of_a_noise_that_one_residual_tells_values_are_students(freedom: int) -> None:
    """Where none is left to tell it too: there is no wider law."""
    problem = Line(Readings(np.linspace(-1.0, 1.0, 12), np.zeros(12)))
    found = fit(problem, problem.start)
    where = regions(found, 0, freedom)
    np.testing.assert_allclose(where.U95 / np.sqrt(np.diag(found.covariance)), scipy.stats.t.ppf(0.975, 1), rtol=0.25)


def test_what_the_choice_of_a_frame_holds_has_no_width() -> None:
    """The rest is as wide as the linear covariance says, in as many directions as there are."""
    problem = plane(1, since_first=False)
    problem.gauge = Tied(problem)
    found = fit(problem, problem.start)
    where, u = regions(found, 0), np.sqrt(np.diag(found.covariance)[: problem.own])
    assert (u[:2] < 1e-9).all()
    assert (where.U95[:2] < 1e-6).all()
    np.testing.assert_allclose(where.U95[2:], 1.96 * u[2:], rtol=0.08)
    np.testing.assert_allclose(where.covariance[2:, 2:], found.covariance[2 : problem.own, 2 : problem.own], rtol=1e-3, atol=1e-9)
    assert where.factor == pytest.approx(np.sqrt(scipy.stats.chi2.ppf(0.95, problem.own - 3)), rel=0.03)
    assert where.bend < 0.05
