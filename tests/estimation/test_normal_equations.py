"""Levenberg's steps by normal equations, against SciPy, of curves that have nothing to do with robots."""

from dataclasses import dataclass

import numpy as np
import pytest
import scipy.optimize

from lmeasure.core import FloatArray
from lmeasure.estimation import optimum


@dataclass(frozen=True)
class Decay:
    """Readings y (e,) of a exp(-b x) that err by u; theta (2,) is what a and b differ by from (2, 1). sign -1: wrong derivatives."""

    x: FloatArray
    y: FloatArray
    width: FloatArray
    u: float = 0.01
    sign: float = 1.0

    def linearised(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        a, b = np.array([2.0, 1.0]) + theta
        fall = np.exp(-b * self.x)
        return theta, a * fall, self.sign * np.column_stack([fall, -a * self.x * fall])

    def whitened(self, at: tuple[FloatArray, FloatArray, FloatArray]) -> tuple[FloatArray, FloatArray]:
        return (self.y - at[1]) / self.u, at[2] / self.u

    def shifted(self, at: tuple[FloatArray, FloatArray, FloatArray], step: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        return at[0] + step, at[1] + at[2] @ step, at[2]

    def both(self, theta: FloatArray) -> FloatArray:
        return np.r_[self.whitened(self.linearised(theta))[0], theta / self.width]


def decay(width: tuple[float, float], sign: float = 1.0) -> Decay:
    x = np.linspace(0.0, 3.0, 20)
    return Decay(x, 1.6 * np.exp(-1.3 * x) + np.random.default_rng(0).normal(0.0, 0.01, 20), np.array(width), sign=sign)


@pytest.mark.parametrize("width", [(100.0, 100.0), (0.02, 3.0)])
@pytest.mark.parametrize("start", [(0.0, 0.0), (-0.5, 4.0)])
def test_the_optimum_is_that_of_all_residuals_and_priors(width: tuple[float, float], start: tuple[float, float]) -> None:
    """From afar too, where a whole Gauss-Newton step would lead uphill."""
    problem = decay(width)
    exact = scipy.optimize.least_squares(problem.both, np.array([-0.4, 0.3]), xtol=1e-15, ftol=1e-15, gtol=1e-15)
    found = optimum(problem, np.array(start))
    J = problem.whitened(problem.linearised(exact.x))[1]
    covariance = np.linalg.inv(J.T @ J + np.diag(problem.width**-2.0))
    u = np.sqrt(np.diag(covariance))
    assert found.converged
    assert found.equations == 20
    np.testing.assert_allclose((found.theta - exact.x) / u, 0.0, atol=1e-3)
    np.testing.assert_allclose(found.covariance / np.outer(u, u), covariance / np.outer(u, u), atol=1e-3)
    np.testing.assert_allclose(found.information, J.T @ J, rtol=1e-3)
    assert found.determined == pytest.approx(float(np.trace(J.T @ J @ covariance)), rel=1e-3)
    assert found.chi2 == pytest.approx(float(np.sum(problem.both(exact.x)[:20] ** 2)), rel=1e-6)
    # what is predicted there
    np.testing.assert_allclose(found.at[0], found.theta, rtol=1e-12)
    np.testing.assert_allclose(found.at[1], problem.linearised(found.theta)[1], atol=1e-6)


def test_where_it_begins_at_the_optimum_nothing_is_predicted_anew() -> None:
    problem = decay((100.0, 100.0))
    found = optimum(problem, np.zeros(2))

    @dataclass(frozen=True)
    class Known(Decay):
        def linearised(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            raise AssertionError("predicted anew")

    again = optimum(Known(problem.x, problem.y, problem.width), found.theta, problem.linearised(found.theta))
    assert again.converged
    np.testing.assert_allclose(again.theta, found.theta, atol=1e-7)


def test_steps_made_short_by_damping_settle_nothing() -> None:
    """With derivatives of the wrong sign every step leads uphill, however short: it stays and says so."""
    found = optimum(decay((100.0, 100.0), sign=-1.0), np.zeros(2))
    assert not found.converged
    np.testing.assert_array_equal(found.theta, 0.0)


def levenberg(problem: Decay, start: FloatArray) -> list[FloatArray]:
    """Where Levenberg's rule tries, by the inverse of the normal matrix: damping tenfold with every step uphill, a tenth with every one
    downhill, until the whole step is a ten-thousandth of a standard uncertainty or damping is beyond 1e8."""
    theta, damping, out = start, 0.0, [start]
    while damping <= 1e8:
        r, J = problem.whitened(problem.linearised(theta))
        N, g = J.T @ J + np.diag(problem.width**-2.0), J.T @ r - theta / problem.width**2
        if g @ np.linalg.solve(N, g) < 1e-8:
            break
        out.append(theta + np.linalg.solve(N + damping * np.diag(np.diag(N)), g))
        if np.sum(problem.both(out[-1]) ** 2) <= np.sum(problem.both(theta) ** 2):
            theta, damping = out[-1], damping / 10.0 if damping > 1.01e-9 else 0.0
        else:
            damping = max(10.0 * damping, 1e-6)
    return out


@pytest.mark.parametrize(
    ("width", "start", "sign"),
    [
        ((100.0, 100.0), (-0.5, 4.0), 1.0),  # first uphill
        ((0.02, 3.0), (-0.5, 4.0), 1.0),  # far from what was known before
        ((100.0, 100.0), (-1.9, -0.9), 1.0),  # long damped
        ((0.5, 0.1), (3.0, -2.0), 1.0),
        ((0.001, 0.001), (-0.4, 0.3), 1.0),  # where the readings alone are best, and nothing else was expected
        ((100.0, 100.0), (0.0, 0.0), -1.0),  # always uphill
    ],
)
def test_it_tries_where_levenbergs_rule_says(width: tuple[float, float], start: tuple[float, float], sign: float) -> None:
    tried: list[FloatArray] = []

    @dataclass(frozen=True)
    class Determined(Decay):
        def linearised(self, theta: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
            tried.append(theta)
            return super().linearised(theta)

    problem = decay(width, sign)
    optimum(Determined(problem.x, problem.y, problem.width, sign=sign), np.array(start))
    expected = levenberg(problem, np.array(start))
    assert len(tried) == len(expected)
    np.testing.assert_allclose(tried, expected, rtol=1e-5, atol=1e-7)
