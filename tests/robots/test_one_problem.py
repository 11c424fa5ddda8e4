"""An identification is a problem like any other: the general fit and the general deletion diagnostics give what its own way gives."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.estimation import Deletion, fit
from lmeasure.robots import Identified, Measurements, Settings, identify
from lmeasure.robots.identification.identify import of_all
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.problem import Problem, solved
from lmeasure.robots.identification.unknowns import Frames, Unknowns
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import SerialRobot

BASE = np.array([2000.0, -300.0, 500.0, *Rotation.from_rotvec([0.4, 2.0, -1.0]).as_quat()])
TOOL = np.array([40.0, -25.0, 110.0, *Rotation.from_rotvec([0.3, -0.2, 1.1]).as_quat()])
U = np.repeat([1e-4, 0.05], 3)


def poses(shared: int = 0) -> Measurements:
    """Of an arm, with errors that all rows share by as many variables; the last row without an orientation."""
    rng = np.random.default_rng(2)
    model = shipped("generic6").model
    joints = rng.uniform(-2.0, 2.0, (30, 6))
    factors = rng.normal(size=(30, 6, shared)) * U[:, None]
    where = se3.displaced(
        se3.compose(se3.compose(BASE, model.forward(joints)), TOOL), rng.normal(size=(30, 6)) * U + factors @ rng.normal(size=shared)
    )
    turns = where[:, 3:].copy()
    turns[-1] = np.nan
    return replace(measured(joints, where[:, :3], turns, u_position_mm=0.05, u_rotation_rad=1e-4), systematic=factors)


def found(rows: Measurements) -> Identified[SerialRobot]:
    return identify(shipped("generic6").model, rows, Settings(outliers=False, own_noise=False))


def test_the_general_fit_ends_where_its_own_ends() -> None:
    one = found(poses(3)).fit
    other = fit(one.problem, one.problem.start, prior_everywhere=True)
    u = np.sqrt(np.diag(one.covariance))
    np.testing.assert_allclose((other.theta - one.theta) / u, 0.0, atol=1e-3)
    np.testing.assert_allclose(other.covariance / np.outer(u, u), one.covariance / np.outer(u, u), atol=1e-3)
    assert other.chi2 == pytest.approx(one.chi2, rel=1e-6)


@dataclass(frozen=True)
class Correlated(Problem[SerialRobot]):
    """With what the rows share in the covariance of all of them, dense, and not among the unknowns."""

    shared: FloatArray | None = None

    def covariance(self, theta: FloatArray) -> FloatArray:
        assert self.shared is not None
        return super().covariance(theta) + self.shared @ self.shared.T


def test_shared_errors_as_unknowns_and_in_a_dense_covariance_are_the_same() -> None:
    rows = poses(3)
    one = found(rows).fit
    own = replace(rows, systematic=np.zeros((len(rows), 6, 0)))
    start = one.problem.unknowns.start
    frames = Frames(start.base, start.targets, start.stations, 0.0, np.ones(len(rows), np.bool_))
    unknowns = Unknowns(start.robot, one.problem.unknowns.freed, frames, own)
    problem = Correlated(unknowns, own, one.problem.noise, False, shared=rows.systematic[rows.known])
    dense = fit(problem, problem.start, prior_everywhere=True)
    requested = one.problem.unknowns.asked
    u = np.sqrt(np.diag(one.covariance))[:requested]
    np.testing.assert_allclose((dense.theta - one.theta[:requested]) / u, 0.0, atol=1e-3)
    np.testing.assert_allclose(dense.covariance / np.outer(u, u), one.covariance[:requested, :requested] / np.outer(u, u), atol=1e-3)


def test_rows_are_judged_by_the_general_deletion() -> None:
    rows = poses()
    one = found(rows)
    squares, components = of_all(one.fit, rows, np.ones(30, np.bool_))
    # priors a hundred metres wide leave the general way, which inverts over all residuals, four digits
    general = Deletion(fit(one.fit.problem, one.fit.theta, prior_everywhere=True))
    of = np.nonzero(rows.known)[0]
    for i in range(30):
        determined = general.shift(np.eye(len(of))[:, of == i])
        assert determined is not None
        assert determined.freedom == components[i]
        assert squares[i] == pytest.approx(determined.square, rel=0.02, abs=0.02)
    # by a fit without the row
    for i in (0, 11, 29):
        rest = solved(replace(one.fit.problem, rows=rows.of(np.delete(np.arange(30), i))), one.fit.theta)
        alone = replace(one.fit.problem, rows=rows.of(np.array([i])))
        residuals, J = alone.residuals(rest.theta), alone.jacobian(rest.theta)
        V = alone.covariance(rest.theta) + J @ rest.covariance @ J.T
        assert squares[i] == pytest.approx(float(residuals @ np.linalg.solve(V, residuals)), rel=1e-3)
