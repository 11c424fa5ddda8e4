"""Encoders whose zeros are known to degrees, or not at all, beside drums that tell the pose: by where they stand poses are off by tens of
millimetres, and what channels say of each other is no longer of first order there."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from cells import START, FloatArray, cell
from reference.channel import Observation, predictions
from reference.rig_channels import cable_lengths, swivel_angle
from reference.solver import solve_poses
from scipy.stats import chi2

from lmeasure.core import Status, TrajectoryError, se3
from lmeasure.recording import Run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import simulate_run
from lmeasure.trajectory import NEAR_RAD, RunModel, covariances, reconstruct, reconstruction_of
from lmeasure.trajectory.uncertainty.sources import LIGHT_RAD, variance_until_determined

TIME_S = np.arange(0.0, 1.5, 0.005)
ROUGH: dict[str, Any] = {"zero_deg": 20.0, "u_zero_deg": 2.0}
WELL: dict[str, Any] = {"zero_deg": 20.0, "u_zero_deg": 0.002}
UNKNOWN: dict[str, Any] = {}
INCREMENTAL: dict[str, Any] = {"absolute": False}


FOUR = (0, 2, 4, 1)
"""Drums that reach all points of the tool."""
LEVELS_DEG = (0.01, 0.1, 0.5, 2.0)


def with_encoders(encoders: dict[int, dict[str, Any]], drums: int | tuple[int, ...] = 6, **values: Any) -> Rig:
    """The first drums of the cell, or these, and encoders at these points."""
    data = cell().to_dict()
    chosen = range(drums) if isinstance(drums, int) else drums
    swivels = [{"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**20, **e, **values} for i, e in encoders.items()]
    return rig_from_dict(data | {"cable": [data["cable"][i] for i in chosen], "swivel": swivels})


def run_of(
    encoders: dict[int, dict[str, Any]],
    seed: int,
    drums: int | tuple[int, ...] = 6,
    u_start: tuple[float, float] = (0.0, 0.0),
    time_s: FloatArray = TIME_S,
) -> tuple[Run, FloatArray]:
    """A run whose true zeros are drawn from what is known of them, and its true poses."""
    rng = np.random.default_rng(seed)
    way = rng.uniform(1.0, 2.5, (2, 6))
    swing = np.sin(way[0] * time_s[:, None]) + 0.3 * np.sin(3.0 * way[1] * time_s[:, None])
    poses = se3.displaced(START, np.repeat([0.15, 120.0], 3) * rng.uniform(0.4, 1.0, 6) * swing)

    def true(e: dict[str, Any]) -> dict[str, Any]:
        if "absolute" in e:
            return e
        off = rng.normal(0.0, e["u_zero_deg"]) if e else rng.uniform(-180.0, 180.0)
        return {"zero_deg": e.get("zero_deg", 0.0) + off}

    run = simulate_run(with_encoders({i: true(e) for i, e in encoders.items()}, drums), time_s, poses, noise_mm=0.0, rng=rng).run
    stated = se3.displaced(poses[0], np.repeat(u_start[::-1], 3) * rng.normal(size=6))
    return replace(run, rig=with_encoders(encoders, drums), start=stated, u_start=u_start), poses


@pytest.mark.parametrize(
    ("encoders", "u_start"),
    [
        ({2: ROUGH}, (0.0, 0.0)),
        ({2: ROUGH, 4: WELL}, (0.0, 0.0)),
        (dict.fromkeys(range(1, 7), ROUGH), (0.0, 0.0)),
        ({1: ROUGH, 4: UNKNOWN, 5: UNKNOWN}, (0.5, 0.001)),
        ({1: ROUGH, 2: INCREMENTAL, 4: UNKNOWN}, (0.0, 0.0)),
        (dict.fromkeys(range(1, 7), UNKNOWN), (0.0, 0.0)),
    ],
)
def test_a_sound_run_is_used_whole_and_errs_as_stated(encoders: dict[int, dict[str, Any]], u_start: tuple[float, float]) -> None:
    squares = []
    for seed in range(2):
        run, poses = run_of(encoders, seed, u_start=u_start)
        found = reconstruct(run)
        assert (found.status == Status.OK).all()
        assert not found.cable.any()
        error = se3.displacement(found.poses, poses)
        both = covariances(found, run)
        covariance = both.random + both.factors @ np.swapaxes(both.factors, 1, 2)
        squares.append(float(error[200] @ np.linalg.solve(covariance[200], error[200])))
    assert 0.001 < chi2.cdf(sum(squares), 6 * len(squares)) < 0.999


def test_an_encoder_known_about_adds_nothing_wrong_to_six_drums() -> None:
    """Its zero is told by the drums, and poses stay where they are without it to within what it tells."""
    run, poses = run_of({2: ROUGH}, 1)
    plain = replace(run, rig=with_encoders({}))
    with_it, without = (np.linalg.norm(se3.displacement(reconstruct(r).poses, poses)[:, 3:], axis=1) for r in (run, plain))
    assert with_it.max() < 1.2 * without.max()


def test_where_poses_need_an_encoder_its_zero_must_be_known() -> None:
    """Five drums and an encoder: readings of an unknown zero fit any pose."""
    with pytest.raises(TrajectoryError, match=r"the zero of sw1 is not known, .* state zero_deg"):
        reconstruction_of(RunModel(with_encoders({1: UNKNOWN}, 5), START))
    reconstruction_of(RunModel(with_encoders({1: WELL}, 5), START))


def test_channels_that_contradict_each_other_are_no_unknown_zero() -> None:
    """Plugs of two pairs of drums are exchanged: nothing is left to learn from, and a zero that is not known is not to blame."""
    run, _ = run_of({2: UNKNOWN, 4: WELL, 5: WELL}, 0)
    counts = run.passes[0]
    recorded = counts.recorded[:, [1, 0, 3, 2, *range(4, 9)]]
    found = reconstruct(replace(run, passes=(replace(counts, recorded=recorded),)))
    assert (found.status[1:] == Status.INCONSISTENT).mean() > 0.9


def test_four_drums_and_four_encoders_are_not_singular_for_zeros_known_to_degrees() -> None:
    """The geometry is the same whatever is known of the zeros: poses only grow less certain."""
    u_mm, squares = [], []
    for u_zero in LEVELS_DEG:
        encoders = {i + 1: {"zero_deg": 20.0, "u_zero_deg": u_zero} for i in FOUR}
        run, poses = run_of(encoders, 3, FOUR, (0.5, 0.001))
        found = reconstruct(run)
        assert (found.status == Status.OK).all()
        error = se3.displacement(found.poses, poses)[150]
        both = covariances(found, run)
        covariance = both.random[150] + both.factors[150] @ both.factors[150].T
        u_mm.append(float(np.sqrt(np.trace(covariance[3:, 3:]))))
        squares.append(float(error @ np.linalg.solve(covariance, error)))
    assert (np.diff(u_mm) > -0.01 * np.array(u_mm[:-1])).all()
    assert max(u_mm) < 5.0
    assert max(squares) < chi2.ppf(0.999, 6)


def test_the_motion_of_four_drums_and_four_encoders_determines_an_unknown_start() -> None:
    """Fewer than six drums: the start counts by what they read and by where the encoders stand at it."""
    drums = (0, 2, 4, 3)
    encoders = {i + 1: {"zero_deg": 20.0, "u_zero_deg": 2.0} for i in drums}
    run, poses = run_of(encoders, 3, drums, time_s=np.arange(0.0, 6.0, 0.02))
    run = replace(run, start=None)
    found = reconstruct(run)
    assert (found.status == Status.OK).all()
    error = se3.displacement(found.poses, poses)
    both = covariances(found, run)
    covariance = both.random[150] + both.factors[150] @ both.factors[150].T
    assert float(error[150] @ np.linalg.solve(covariance, error[150])) < chi2.ppf(0.999, 6)
    assert np.sqrt(np.trace(covariance[3:, 3:])) < 1.0


def test_a_pose_that_readings_hardly_tell_is_uncertain_and_not_singular() -> None:
    """Six swivels beside four drums that are known a million times better, in the plain solver: u grows as that of the angles."""
    rig = with_encoders({})
    drums = [replace(o, variance=1e-8) for o in cable_lengths(rig, START)[:4]]
    swivels = [swivel_angle(rig, c.name, c.from_point, c.to_point, counts_per_revolution=2**20) for c in rig.cable]
    u = []
    for u_angle in (1e-3, 1e-1, 10.0):
        known: list[Observation] = [*drums, *(replace(o, variance=u_angle**2) for o in swivels)]
        found = solve_poses(known, predictions(known, START[None]), START)
        assert found.status[0] == Status.OK
        u.append(float(np.sqrt(np.trace(found.covariance[0, 3:, 3:]))))
    np.testing.assert_allclose(np.array(u[1:]) / u[:-1], 100.0, rtol=1e-3)


def test_readings_weigh_as_their_zeros_are_known() -> None:
    """Six drums tell the pose: any zero may be as uncertain as it is. One that is known well weighs by its rounding alone."""
    zeros = np.array([0.0] * 6 + [0.9 * NEAR_RAD, 0.02, 1.8])
    np.testing.assert_allclose(np.sqrt(variance_until_determined(zeros, 6)), [0.0] * 7 + [0.02, 1.8], rtol=1e-12)


def test_zeros_that_poses_need_weigh_enough_to_tell_them() -> None:
    """Four drums, and the pose needs two of four angles: the second best weighs as one known to LIGHT_RAD, the others in proportion."""
    zeros = np.array([0.0] * 4 + [0.01, 0.02, 0.04, 1.8])
    np.testing.assert_allclose(np.sqrt(variance_until_determined(zeros, 6))[4:], zeros[4:] * LIGHT_RAD / 0.02, rtol=1e-12)
    # what is better known than that is not made worse
    zeros = np.array([0.0] * 4 + [0.5 * LIGHT_RAD] * 2 + [1.8])
    np.testing.assert_allclose(np.sqrt(variance_until_determined(zeros, 6)), zeros, rtol=1e-12)
