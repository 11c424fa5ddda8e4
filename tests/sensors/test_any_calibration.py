"""Whatever its sensors are, an instrument is calibrated: channels at reference poses are a problem of estimation."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from invented import around, read, sensors
from reference.calibration import AtReferencePoses
from reference.zone_map import figures
from rigs import FloatArray, cables
from truth_sets import Set

from lmeasure.core import rotation_from_angles, se3
from lmeasure.estimation import fit


def off(channels: list[Any], seed: int) -> list[Any]:
    """The channels as somebody took them to be, before they were calibrated."""
    g = np.random.default_rng(seed)
    shift = {q.name: q.value + 0.5 * q.prior_u * g.normal() for o in channels for q in o.parameters}
    return [replace(o, parameters=tuple(replace(q, value=shift[q.name]) for q in o.parameters)) for o in channels]


def test_it_is_calibrated() -> None:
    true, at = sensors(), around(0, 60)
    u = np.diag([2e-5, 2e-5, 2e-5, 0.02, 0.02, 0.02]) ** 2
    apart, whole = [], []
    for seed in range(40):
        g = np.random.default_rng(seed)
        stated = se3.displaced(at, g.multivariate_normal(np.zeros(6), u, len(at)))
        problem = AtReferencePoses(off(true, seed), read(true, at, seed), stated, u)
        found = fit(problem, problem.start)
        assert (found.converged, found.rank) == (True, 6)
        wanted = np.array([2e-3, 2e-3, -400.0, 250.0, -900.0, 1.002])
        apart.append((found.theta - wanted) / np.sqrt(np.diag(found.covariance)))
        whole.append(np.array(apart[-1] @ np.linalg.solve(_correlation(found.covariance), apart[-1])))
    # of 40 campaigns: standard deviations known to 1/sqrt(80), and sums of six squares
    np.testing.assert_allclose(np.std(apart, axis=0), 1.0, atol=4.0 / np.sqrt(80.0))
    assert np.mean(whole) == pytest.approx(6.0, abs=4.0 * np.sqrt(12.0 / 40.0))


def _correlation(covariance: FloatArray) -> FloatArray:
    u = np.sqrt(np.diag(covariance))
    return np.asarray(covariance / np.outer(u, u))


def test_what_the_data_do_not_tell_is_left_as_it_was() -> None:
    """A single pose tells the beam's length alone: three of its four parameters stay where they were taken to be."""
    channels = off(sensors(), 1)
    problem = AtReferencePoses(channels, read(sensors(), around(0, 1), 0), around(0, 1), solve={q.name for q in channels[2].parameters})
    found = fit(problem, problem.start)
    assert found.rank == 1
    np.testing.assert_allclose(np.sqrt(np.diag(found.covariance))[:3], problem.parameters.width[:3], rtol=0.5)


def test_eight_cables_are_calibrated_and_mapped() -> None:
    eight = cables(3, 8)
    places = {q.name for o in eight for q in o.parameters[:5]}
    g, at = np.random.default_rng(3), around(2, 25)
    nominal = [
        replace(o, parameters=tuple(replace(q, value=q.value + 0.1 * q.prior_u * g.normal() * (q.name in places)) for q in o.parameters))
        for o in eight
    ]
    problem = AtReferencePoses(nominal, read(eight, at, 1), at, solve=places)
    found = fit(problem, problem.start)
    assert (found.converged, found.rank) == (True, 40)
    true = {q.name: q.value for o in eight for q in o.parameters}
    normalised = (found.theta - [true[name] for name in problem.names]) / np.sqrt(np.diag(found.covariance))
    assert np.abs(normalised).max() < 4.5
    assert normalised @ np.linalg.solve(_correlation(found.covariance), normalised) < 40.0 + 4.0 * np.sqrt(80.0)
    # redundant cables tell more than six of them
    assert (figures(eight[:6], at).u95_position_mm > 1.02 * figures(eight, at).u95_position_mm).all()


def test_swivels_and_drums_are_calibrated_together() -> None:
    """Of the independent simulator: points up to 30 mm, guides up to 5 degrees, zeros of encoders up to 2 degrees off, 12 poses known to
    0.05 mm. The pose of zeroing is a pose like the others: what the drums had out there is found."""
    run = Set("swivel-12-poses", None, "counts.csv")
    table = np.loadtxt(run.folder / "reference_poses.csv", delimiter=",", skiprows=1)
    at = se3.pose(table[:, 1:4], rotation_from_angles("puma-oat", table[:, 4:]))
    channels: list[Any] = [*run.cables, *run.swivels]
    solve = {q.name for o in run.cables for q in o.parameters[:5]} | {o.parameters[-1].name for o in channels}
    problem = AtReferencePoses(channels, run.readings, at, np.diag(np.repeat([1e-9, 0.05], 3)) ** 2, solve=solve)
    found = fit(problem, problem.start)
    assert (found.converged, found.rank) == (True, 42)
    truth = json.loads((run.folder / "truth.json").read_text())
    true = {f"{o.name}.zero_deg": zero for o, zero in zip(run.swivels, truth["zero_deg"], strict=True)}
    for name, point in truth["points"].items():
        keys = ("x_mm", "y_mm", "z_mm", "guide_alpha_deg", "guide_beta_deg")
        true |= {f"{name}.{key}": v for key, v in zip(keys, (*point["B"], point["alpha_deg"], point["beta_deg"]), strict=True)}
    own = [i for i, name in enumerate(problem.names) if name in true]
    off = found.theta[own] - [true[problem.names[i]] for i in own]
    covariance = found.covariance[np.ix_(own, own)]
    assert len(own) == 36
    assert off @ np.linalg.solve(covariance, off) < 36.0 + 4.0 * np.sqrt(72.0)
    # the points are where the encoders see them too: drums alone leave them less certain
    alone = AtReferencePoses(run.cables, run.readings[:, :6], at, np.diag(np.repeat([1e-9, 0.05], 3)) ** 2, solve=solve)
    u = {name: np.sqrt(v) for name, v in zip(alone.names, np.diag(fit(alone, alone.start).covariance), strict=True)}
    gained = [u[problem.names[i]] / np.sqrt(found.covariance[i, i]) for i in own if problem.names[i] in u]
    assert np.median(gained) > 1.3
    assert found.chi2 == pytest.approx(144.0 - 42.0, abs=4.0 * np.sqrt(2.0 * 102.0))
