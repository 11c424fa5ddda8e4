"""A network that hangs on nothing: what the choice of its frame changes, and what it does not."""

from dataclasses import replace

import numpy as np
import pytest
from problems import Stations, Tied, plane

from lmeasure.estimation import Fit, fit


def tied(*, keeps_prior: bool = False, blind: bool = False) -> tuple[Stations, Tied]:
    problem = plane(1, since_first=False, blind=blind)
    gauge = Tied(problem, keeps_prior=keeps_prior)
    problem.gauge = gauge
    return problem, gauge


def held_where_chosen(found: Fit, gauge: Tied) -> None:
    nominal = gauge.problem.nominal.stations
    first, second = found.theta[:4].reshape(2, 2)
    np.testing.assert_allclose(first, nominal[0], atol=1e-9)
    way, to = second - first, nominal[1] - nominal[0]
    np.testing.assert_allclose(way / np.linalg.norm(way), to / np.linalg.norm(to), atol=1e-12)


def test_the_result_is_that_of_minimal_constraints() -> None:
    """The covariance is the inverse of the information bordered with the conditions of the frame; what does not hang on the frame is as
    without it."""
    problem, gauge = tied()
    found, free = fit(problem, problem.start), fit(plane(1, since_first=False), problem.start)
    held_where_chosen(found, gauge)
    assert found.converged
    assert found.chi2 == pytest.approx(free.chi2, rel=1e-6)
    assert (found.motions, len(found.silent), found.rank, found.freedom) == (3, 0, free.rank, free.freedom)
    assert found.prior_misfit == pytest.approx(0.0, abs=1e-12)
    np.testing.assert_allclose(found.held_covariance, 0.0, atol=1e-12)
    J, C = problem.jacobian(found.theta), gauge.conditions
    M = J.T @ J / problem.u**2
    scale = 1.0 / np.sqrt(np.diag(M))
    bordered = np.block([[M * np.outer(scale, scale), (C * scale).T], [C * scale, np.zeros((3, 3))]])
    exact = np.linalg.inv(bordered)[: len(M), : len(M)] * np.outer(scale, scale)
    u = np.sqrt(np.diag(exact)) + 1e-6
    np.testing.assert_allclose(found.covariance / np.outer(u, u), exact / np.outer(u, u), atol=1e-6)


@pytest.mark.parametrize("blind", [False, True])
def test_directions_of_the_frame_are_the_last(blind: bool) -> None:
    """Behind where a station is that sees nothing, which its prior alone tells."""
    problem, gauge = tied(blind=blind)
    # some are known better than others
    problem.parameters = replace(problem.parameters, width=np.repeat([2.0, 5.0, 9.0, 4.0, 20.0], 2))
    found = fit(problem, problem.start)
    assert found.s.shape == (problem.own,)
    assert (np.diff(found.s) <= 0.0).all()
    assert (found.motions, len(found.silent)) == (3, 2 * blind)
    moved = gauge.motions(found.theta)[: problem.own] / problem.parameters.width[:, None]
    determined = found.directions[: problem.own - 3]
    np.testing.assert_allclose(determined @ np.linalg.qr(moved)[0], 0.0, atol=1e-6)
    np.testing.assert_allclose(found.directions @ found.directions.T, np.eye(problem.own), atol=1e-9)


def test_with_the_prior_everywhere_the_prior_chooses_or_the_gauge_does() -> None:
    problem, gauge = tied()
    plain = fit(plane(1, since_first=False), problem.start, prior_everywhere=True)
    kept, _ = tied(keeps_prior=True)
    same = fit(kept, kept.start, prior_everywhere=True)
    np.testing.assert_array_equal(same.theta, plain.theta)
    np.testing.assert_array_equal(same.covariance, plain.covariance)
    moved = fit(problem, problem.start, prior_everywhere=True)
    held_where_chosen(moved, gauge)
    assert moved.motions == same.motions == 0
    # how far targets lie from each other, and how surely, is not a matter of the frame
    span = np.zeros((2, len(moved.theta)))
    for row, (i, j) in zip(span, ((0, 7), (3, 11)), strict=True):
        way = np.diff((gauge.at + moved.theta).reshape(-1, 2)[[5 + i, 5 + j]], axis=0)[0]
        way /= np.linalg.norm(way)
        row[10 + 2 * i : 12 + 2 * i], row[10 + 2 * j : 12 + 2 * j] = -way, way
    free = fit(problem, problem.start)
    np.testing.assert_allclose(span @ moved.covariance @ span.T, span @ free.covariance @ span.T, rtol=0.01)
    assert np.abs(moved.covariance[:2]).max() < 1e-9
