"""A sensor that nobody thought of reconstructs with cables, has its covariance and its map: nothing of lmeasure is changed for it."""

import numpy as np
import pytest
from invented import around, read, sensors
from reference.channel import Observation, predictions
from reference.continuation import follow
from reference.rig_channels import cable_lengths
from reference.solver import solve_poses
from reference.zone_map import figures, map_channels
from rigs import HOME, FloatArray
from scipy.linalg import block_diag
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import scan_zone, tilts
from lmeasure.core import se3
from lmeasure.rig import CalibrationRecord, Parameter
from lmeasure.simulation import cell_rig


def test_it_reconstructs_with_cables_and_states_what_it_errs_by() -> None:
    """Five cables, the two axes and the beam; the covariance of counts and of a calibration against solving again and again."""
    channels: list[Observation] = [*cable_lengths(cell_rig(1), HOME)[:5], *sensors()]
    truth = around(3, 1)
    path = se3.displaced(HOME, np.linspace(0.0, 1.0, 50)[:, None] * se3.displacement(truth, HOME[None]))
    assert np.abs(se3.displacement(follow(channels, predictions(channels, path), HOME).poses, path)).max() < 1e-9
    g, n = np.random.default_rng(4), 1500
    names = ("lean x.zero", "beam.scale", "B1.x_mm")
    root = np.diag([1e-4, 2e-5, 0.05]) @ np.array([[1.0, 0, 0], [0.3, 0.95, 0], [0, 0.2, 0.98]])
    stated = figures(channels, truth, names, root)
    drawn = g.normal(size=(n, 3)) @ root.T
    # readings of channels whose parameters are off, one draw after the other
    readings = read(channels, np.repeat(truth, n, axis=0), 5)
    for j, o in enumerate(channels):
        own = [i for i, q in enumerate(o.parameters) if q.name in names]
        for k, shift in enumerate(drawn if own else ()):
            p = np.array([q.value for q in o.parameters])
            p[own] += shift[[names.index(o.parameters[i].name) for i in own]]
            readings[k, j] += (o.predict(truth, p) - o.predict(truth, np.array([q.value for q in o.parameters])))[0]
    met = np.cov(se3.displacement(solve_poses(channels, readings, truth[0]).poses, np.repeat(truth, n, axis=0)).T)
    scale = np.sqrt(np.diag(stated.covariance[0]))
    np.testing.assert_allclose(met / np.outer(scale, scale), stated.covariance[0] / np.outer(scale, scale), atol=4.0 * np.sqrt(2.0 / n))


def test_it_has_its_map() -> None:
    """Where a cable is lost the sensor holds the pose; a map has the figures of its poses, the worst over the orientations."""
    cables = cable_lengths(cell_rig(1), HOME)
    x, turns = np.array([-100.0, 50.0, 200.0]), Rotation.from_rotvec([[0.1, 0.0, 0.0], [0.0, -0.1, 0.1]])
    five = map_channels(cables[:5], x=x, y=np.zeros(1), z=np.zeros(1), rotations=turns)
    assert np.isinf(five["u95_position_mm"]).all()
    assert (five["worst_pressure_angle_deg"] == 90.0).all()
    channels = [*cables[:5], *sensors()]
    both = map_channels(channels, x=x, y=np.zeros(1), z=np.zeros(1), rotations=turns)
    alone = [figures(channels, se3.pose([[150.0 * i - 100.0, 0.0, 0.0]], turn)) for i in range(3) for turn in turns]
    np.testing.assert_allclose(both["u95_position_mm"].values.ravel(), np.reshape([a.u95_position_mm for a in alone], (3, 2)).max(axis=1))
    # 95 of 100 draws are within the radius
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), alone[0].covariance[0, 3:, 3:], 4000)
    assert (np.linalg.norm(draws, axis=1) < alone[0].u95_position_mm[0]).mean() == pytest.approx(
        0.95, abs=4.0 * np.sqrt(0.05 * 0.95 / 4000)
    )


@pytest.mark.parametrize("linked", [False, True])
def test_of_six_cables_the_map_is_the_zone(linked: bool) -> None:
    """With zero phases, and with a calibration whose parameters, five to a point, are correlated."""
    rig, g = cell_rig(1), np.random.default_rng(7)
    x, y, z = np.linspace(-150.0, 150.0, 3), np.array([0.0, 120.0]), np.array([-80.0])
    channels = cable_lengths(rig, HOME)
    solved = [q for o in channels for q in o.parameters[:5]] if linked else []
    root = 1e-3 * g.normal(size=(len(solved), len(solved))) * np.array([[q.prior_u] for q in solved]).reshape(-1, 1)
    record = _record(solved, root @ root.T) if linked else None
    zone = scan_zone(rig, record, x=x, y=y, z=z, rotations=tilts(0.2, 2), start=HOME)
    names = (*(q.name for q in solved), *(f"{o.name}.zero_mm" for o in channels))
    found = map_channels(
        channels,
        x=x,
        y=y,
        z=z,
        rotations=tilts(0.2, 2),
        names=names,
        root=block_diag(root, np.diag([o.parameters[-1].prior_u for o in channels])),
    )
    np.testing.assert_allclose(found["worst_pressure_angle_deg"], zone["worst_pressure_angle_deg"], rtol=1e-9)
    # the kernels' radius is a polynomial
    np.testing.assert_allclose(found["u95_position_mm"], zone["u95_position_mm"], rtol=6e-5)


def _record(solved: list[Parameter], covariance: FloatArray) -> CalibrationRecord:
    u = np.sqrt(np.diag(covariance))
    parameters = [{"name": q.name, "value": q.value, "u": float(s), "prior_u": q.prior_u} for q, s in zip(solved, u, strict=True)]
    whole = {"equations": 0, "unknowns": len(solved), "rank": len(solved), "residuals": [], "rig": "cell"}
    return CalibrationRecord.model_validate(
        {"schema": "lmeasure.calibration/1", "parameters": parameters, "covariance": covariance.tolist()} | whole
    )
