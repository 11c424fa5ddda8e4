"""The way to an optimum: from where it begins to the nearest one, and how the prior is taken off what the data determine. All of it with
and without a nuisance parameter beside, which is eliminated and changes nothing."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from problems import Curve

from lmeasure.estimation import Fit, fit

Scalar = Callable[[float], float]

pytestmark = pytest.mark.parametrize("beside", [False, True])


def one(of: Scalar, by: Scalar, beside: bool, nominal: float = 0.0) -> Curve:
    """One residual by one value."""
    return Curve(lambda z: np.array([of(z[0])]), lambda z: np.array([[by(z[0])]]), np.array([nominal]), beside=beside)


def begun(problem: Curve, start: float, *, near: bool = False) -> Fit:
    return fit(problem, np.r_[start, problem.start[1:]], near=near)


def parabola(beside: bool) -> Curve:
    """Nothing is left at z = -2 and at z = 2."""
    return one(lambda z: 2.0 * (z * z - 4.0), lambda z: 4.0 * z, beside, 0.5)


@pytest.mark.parametrize(("start", "found"), [(-1.5, -2.0), (1.5, 2.0)])
@pytest.mark.parametrize("near", [False, True])
def test_it_goes_to_the_optimum_nearest_to_its_start(start: float, found: float, near: bool, beside: bool) -> None:
    got = begun(parabola(beside), start, near=near)
    assert got.theta == pytest.approx([found, 3.0][: 1 + beside], abs=1e-7)
    assert (got.rank, got.converged) == (1 + beside, True)
    assert got.chi2 == pytest.approx(0.0, abs=1e-9)
    np.testing.assert_allclose(got.covariance, np.diag([1.0 / 8.0**2, 0.5][: 1 + beside]), atol=1e-9)
    assert got.nominal_misfit == pytest.approx((found - 0.5) ** 2, rel=1e-6)


@pytest.mark.parametrize("start", [-0.55, 0.55])
def test_values_are_counted_in_their_own_prior_widths(start: float, beside: bool) -> None:
    """Beginning half a unit from the pass between two optima, which is one prior width, leads to the one on that side."""
    problem = one(lambda v: 8.0 * (v * v - 1.0), lambda v: 16.0 * v, beside, 1.5 * np.sign(start))
    problem.parameters = replace(problem.parameters, width=np.array([0.5]), nominal=-problem.parameters.nominal)
    got = begun(problem, start, near=True)
    assert got.theta[0] == pytest.approx(np.sign(start), abs=1e-7)
    assert got.nominal_misfit == pytest.approx((2.5 / 0.5) ** 2)


def test_fewer_residuals_than_values_tell_as_many(beside: bool) -> None:
    """Of two values their sum, and of a third nothing; where they do not lead values stay where they were, and follow no error."""
    start = np.array([0.5, 0.1, -0.4])
    problem = Curve(lambda z: np.array([3.0 * (z[0] + z[1] - 1.0)]), lambda z: np.array([[3.0, 3.0, 0.0]]), start, beside=beside)
    got = fit(problem, problem.start)
    assert got.theta[:3] == pytest.approx([0.7, 0.3, -0.4], abs=1e-7)
    assert (got.rank, got.converged, got.s.shape) == (1 + beside, True, (3,))
    np.testing.assert_allclose(got.gain[:3, 0], [1.0 / 6.0, 1.0 / 6.0, 0.0], atol=1e-9)
    assert len(got.silent) == 2
    np.testing.assert_allclose(got.silent @ [1.0, 1.0, 0.0], 0.0, atol=1e-9)
    half = 0.5 * np.array([[1.0, -1.0], [-1.0, 1.0]])
    np.testing.assert_allclose(got.covariance[:2, :2], half + 1.0 / 36.0, atol=1e-9)
    np.testing.assert_allclose(got.covariance[2, :3], [0.0, 0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize(("step", "settled"), [(1e-3, True), (0.05, False)])
def test_residuals_in_steps_are_settled_within_a_hundredth(step: float, settled: bool, beside: bool) -> None:
    """Of a standard uncertainty: no value brings them nearer to nothing than half a step."""
    problem = one(lambda z: step * (np.floor(10.0 * (z - 0.7) / step) + 0.5), lambda z: 10.0, beside)
    got = begun(problem, 0.0)
    assert got.theta[0] == pytest.approx(0.7, abs=0.2 * step)
    assert got.converged == settled


def test_priors_lead_first_unless_it_begins_near(beside: bool) -> None:
    """Here they pull over the pass between two optima, to the one on their side."""
    problem = one(lambda z: (z * z - 4.0) / 2.0, lambda z: z, beside, 3.0)
    assert begun(problem, -1.1).theta[0] == pytest.approx(2.0, abs=1e-7)
    assert begun(problem, -1.1, near=True).theta[0] == pytest.approx(-2.0, abs=1e-7)


@pytest.mark.parametrize(("gain", "known"), [(0.8, False), (1.2, True)])
def test_data_decide_where_they_tell_more_than_the_prior(gain: float, known: bool, beside: bool) -> None:
    got = begun(one(lambda z: gain * (z - 0.7), lambda z: gain, beside), 0.0)
    assert got.theta[0] == pytest.approx(0.7 if known else 0.0, abs=1e-7)
    assert got.covariance[0, 0] == pytest.approx(1.0 / gain**2 if known else 1.0)
    assert (got.rank, got.converged) == (known + beside, True)
    assert got.gain[0, 0] == pytest.approx(1.0 / gain if known else 0.0, abs=1e-9)
    assert got.prior_misfit == pytest.approx(0.0, abs=1e-9)
    everywhere = fit(got.problem, got.problem.start, prior_everywhere=True)
    assert everywhere.theta[0] == pytest.approx(0.7 * gain**2 / (1.0 + gain**2), abs=1e-7)
    assert everywhere.covariance[0, 0] == pytest.approx(1.0 / (1.0 + gain**2))
    assert everywhere.converged


def test_what_is_told_once_others_are_released_is_told(beside: bool) -> None:
    """The second value is told by less than its prior until the prior of the first is off."""
    problem = Curve(
        lambda z: np.array([1.5 * (z[0] - 2.0), 0.6 * z[0] * z[1]]),
        lambda z: np.array([[1.5, 0.0], [0.6 * z[1], 0.6 * z[0]]]),
        np.zeros(2),
        beside=beside,
    )
    got = fit(problem, np.r_[1.0, 0.0, np.zeros(int(beside))])
    assert got.theta[:2] == pytest.approx([2.0, 0.0], abs=1e-7)
    assert got.s == pytest.approx([1.5, 1.2])
    assert (got.rank, got.converged) == (2 + beside, True)


def test_what_keeps_changing_sides_is_left_to_its_prior(beside: bool) -> None:
    """At its nominal value the data tell it, at their own optimum they do not."""
    steep = one(lambda z: 1.5 - 3.0 * 4.0**-z, lambda z: 3.0 * np.log(4.0) * 4.0**-z, beside)
    flat = one(lambda z: 0.36 - 1.443 * 4.0**-z, lambda z: 1.443 * np.log(4.0) * 4.0**-z, beside)
    assert begun(steep, 0.0).theta[0] == pytest.approx(0.5, abs=1e-7)
    got = begun(flat, 0.0)
    assert got.theta[0] == pytest.approx(0.0, abs=0.01)
    assert got.converged


@pytest.mark.parametrize(("steep", "start"), [(5.0, 0.5), (5e4, 0.002)])
def test_a_step_that_leads_uphill_is_halved(steep: float, start: float, beside: bool) -> None:
    """From there a whole Gauss-Newton step lies farther off on the other side, and twice the step farther still; or a hundred times as far
    as the optimum."""
    problem = one(lambda z: 100.0 * np.arctan(steep * z), lambda z: 100.0 * steep / (1.0 + (steep * z) ** 2), beside)
    got = begun(problem, start, near=True)
    assert got.theta[0] == pytest.approx(0.0, abs=1e-7)
    assert got.converged


@pytest.mark.parametrize("near", [False, True])
def test_wrong_derivatives_do_not_settle(near: bool, beside: bool) -> None:
    """Every step leads uphill, so that none is made."""
    problem = one(lambda z: 100.0 * (z - 3.0), lambda z: -100.0, beside)
    got = begun(problem, 0.0, near=near)
    assert not got.converged
    assert got.theta[0] == pytest.approx(0.0, abs=1e-6)
