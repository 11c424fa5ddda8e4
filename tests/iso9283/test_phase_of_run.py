"""Accuracy certified from counters that were zeroed anywhere within a count: what one run is off by, U95 holds."""

import numpy as np
from honest import assert_honest
from scipy.spatial.transform import Rotation
from zeroed import zeroed_exactly

from lmeasure.iso9283 import CertificationSettings, evaluate
from lmeasure.recording import Program
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import PoseErrors, reconstruct

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
CAMPAIGNS, CYCLES = 15, 10


def test_accuracy_lies_within_u95_of_the_truth() -> None:
    """Each campaign has a pose, cycles about it and phases of its own; its rig is known, so that nothing but the counts errs. Roundings
    average over the cycles, phases do not."""
    held: list[list[float]] = []
    sure: list[list[float]] = []
    parts: list[tuple[float, float]] = []
    for seed in range(CAMPAIGNS):
        rng = np.random.default_rng(seed)
        there = np.r_[rng.uniform(-200.0, 200.0, 3), Rotation.from_rotvec(rng.uniform(-0.2, 0.2, 3)).as_quat()]
        reached = np.tile(there, (CYCLES, 1))
        reached[:, :3] += rng.normal(0.0, 0.03, (CYCLES, 3))
        away = np.r_[there[:3] + 30.0, there[3:]]
        time_s, poses = smooth_path(HOME, [leg for pose in reached for leg in (Leg(pose, dwell_s=0.3), Leg(away))], 50.0)
        run = simulate_run(cell_rig(seed), time_s, poses, noise_mm=0.0, rng=rng).run
        windows = [time_s[(np.abs(poses - pose) < 1e-12).all(axis=1)][[0, -1]].tolist() for pose in reached]
        commanded = {"name": "P1", "position_mm": there[:3].tolist(), "quaternion_xyzw": there[3:].tolist(), "windows_s": windows}
        program = Program.model_validate({"schema": "lmeasure.program/1", "pose": [commanded]})
        settings = CertificationSettings(trials=300, seed=seed, limit_angle_deg=None)
        truth = reached[:, :3].mean(axis=0) - there[:3]
        for each, found in ((run, held), (zeroed_exactly(run), sure)):
            done = evaluate(reconstruct(each), program, run=each, settings=settings)
            of_axes = [next(c for c in done.characteristics if c.name == f"AP_{axis}") for axis in "xyz"]
            found.append([(c.value - true) / (c.u95 or 0.0) for c, true in zip(of_axes, truth, strict=True)])
            parts.append((of_axes[0].u_random or 0.0, of_axes[0].u_systematic or 0.0))
    # three figures in each campaign, which are not independent
    assert_honest(held)
    assert np.mean(np.abs(sure) <= 1.0) < 0.75
    # another run draws phases anew: they are among what two runs of one calibration do not share
    (random, systematic), (without, same) = np.array(parts).reshape(-1, 2, 2).mean(axis=0)
    assert random > 1.5 * without
    assert systematic == same


def test_common_errors_are_drawn_by_their_own_laws() -> None:
    shared = np.tile(np.eye(6)[:, :3], (2, 1, 1))
    errors = PoseErrors.of(np.zeros((2, 6, 6)), shared, rounded=True, uniform=(False, True, False), counted=(False, True, False))
    drawn = errors.drawn_common(np.random.default_rng(1), 20_000)
    np.testing.assert_allclose(drawn.std(axis=0), 1.0, atol=0.03)
    assert np.abs(drawn[:, 1]).max() < np.sqrt(3.0)
    assert np.abs(drawn[:, [0, 2]]).max(axis=0).min() > 3.0
    # of any number of poses, and where nothing is said of the laws, normal
    assert errors[np.array([1])].uniform == errors.uniform
    plain = PoseErrors.of(np.zeros((2, 6, 6)), shared, rounded=True)
    assert np.abs(plain.drawn_common(np.random.default_rng(1), 20_000)).max() > 3.0
