"""What all others say about groups that correlate with no others, by fits without each; falls of chi-squared column by column."""

import numpy as np
import pytest
from problems import Line, Readings

from lmeasure.estimation import Deletion, deletion_squares, fit


def test_squares_of_groups_are_those_of_fits_without_each() -> None:
    """Groups of three residuals with covariances of their own, of which the fit has seen some less or not at all."""
    rng, n = np.random.default_rng(4), 6
    J, root = rng.normal(size=(n, 3, 2)), rng.normal(size=(n, 3, 3)) + 2.0 * np.eye(3)
    V, y = root @ np.swapaxes(root, 1, 2), rng.normal(size=(n, 3)) * 3.0
    weight = np.array([1.0, 0.5, 0.0, 1.0, 0.2, 1.0])
    W = weight[:, None, None] * np.linalg.inv(V)
    determined, pull = np.einsum("nji,njk,nkl->nil", J, W, J), np.einsum("nji,njk,nk->ni", J, W, y)
    C = np.linalg.inv(determined.sum(axis=0))
    found = deletion_squares(y - J @ (C @ pull.sum(axis=0)), V, J @ C @ np.swapaxes(J, 1, 2), weight)
    for i in range(n):
        others = np.arange(n) != i
        without = np.linalg.inv(determined[others].sum(axis=0))
        error = y[i] - J[i] @ without @ pull[others].sum(axis=0)
        assert found[i] == pytest.approx(error @ np.linalg.solve(V[i] + J[i] @ without @ J[i].T, error), rel=1e-9)


def test_a_group_that_alone_tells_something_is_judged_by_a_thousandth() -> None:
    found = deletion_squares(np.array([[0.3]]), np.array([[[4.0]]]), np.array([[[4.0]]]), np.ones(1))
    assert found[0] == pytest.approx(0.3**2 / 4.0 / (0.001 * 1.001))


def test_falls_are_those_of_regressions_with_one_column_more() -> None:
    """Nothing for a column that the line explains itself, or that is none."""
    x, rng = np.linspace(-1.0, 1.0, 12), np.random.default_rng(6)
    problem = Line(Readings(x, 1.0 + 2.0 * x + rng.normal(0, 0.3, 12)))
    found = fit(problem, problem.start)
    columns = np.column_stack([x**2, 3.0 + 2.0 * x, np.zeros(12), np.eye(12)[0] * 1e-3])
    falls = Deletion(found).falls(columns)
    assert falls[[1, 2]].tolist() == [0.0, 0.0]
    for i in (0, 3):
        J = np.column_stack([problem.jacobian(found.theta), columns[:, i] / np.abs(columns[:, i]).max()])
        left = problem.readings.y - J @ np.linalg.lstsq(J, problem.readings.y)[0]
        assert falls[i] == pytest.approx(found.chi2 - left @ left / 0.1**2)


def test_what_columns_take_from_chi_squared_does_not_depend_on_their_units() -> None:
    """As a fit that has them among its parameters."""
    x, rng = np.linspace(-1.0, 1.0, 12), np.random.default_rng(8)
    problem = Line(Readings(x, 1.0 + 2.0 * x + rng.normal(0, 0.3, 12)))
    found, columns = fit(problem, problem.start), np.column_stack([x**2, x**3])
    J = np.column_stack([problem.jacobian(found.theta), columns])
    left = problem.readings.y - J @ np.linalg.lstsq(J, problem.readings.y)[0]
    for units in ([1.0, 1.0], [1e7, 1e-7]):
        freed = Deletion(found).freed(columns * units)
        assert freed._chi2 == pytest.approx(left @ left / 0.1**2, rel=1e-9)
        assert freed._freedom == 8
