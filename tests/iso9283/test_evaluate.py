"""Characteristics of simulated dwells against a plain statement of them."""

import numpy as np

from lmeasure.iso9283 import evaluate
from lmeasure.recording import Program, Run
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path
from lmeasure.trajectory import ErrorsOfRun, reconstruct

START = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
COMMANDED = {"P1": (100.0, 0.0, 50.0), "P2": (-100.0, 80.0, 0.0)}


def dwelling_run(cycles: int, seed: int) -> tuple[Run, Program, dict[str, np.ndarray]]:
    """A robot that goes to P1 and P2 in turn, 0.3 mm off and with 0.05 mm of scatter; windows in the rest; true positions (n, 3)."""
    rng = np.random.default_rng(seed)
    legs: list[Leg] = []
    true: dict[str, list[np.ndarray]] = {name: [] for name in COMMANDED}
    for _ in range(cycles):
        for name in COMMANDED:
            pose = START.copy()
            pose[:3] = np.array(COMMANDED[name]) + [0.3, 0.0, 0.0] + 0.05 * rng.normal(size=3)
            true[name].append(pose[:3])
            legs.append(Leg(pose, 2000.0, 1.0, 0.1))
    time_s, poses = smooth_path(START, legs, 500.0)
    windows: dict[str, list[tuple[float, float]]] = {name: [] for name in COMMANDED}
    for name in COMMANDED:
        for place in true[name]:
            rest = np.flatnonzero(np.linalg.norm(poses[:, :3] - place, axis=1) < 1e-9)
            windows[name].append((float(time_s[rest[2]]), float(time_s[rest[-2]])))
    program = Program.model_validate(
        {
            "schema": "lmeasure.program/1",
            "pose": [
                {"name": n, "position_mm": COMMANDED[n], "quaternion_xyzw": (0.0, 0.0, 0.0, 1.0), "windows_s": windows[n]}
                for n in COMMANDED
            ],
        }
    )
    return simulate_run(cell_rig(1), time_s, poses, noise_mm=0.0, rng=rng).run, program, {k: np.array(v) for k, v in true.items()}


def test_pose_accuracy_and_repeatability_of_a_run() -> None:
    run, program, true = dwelling_run(6, 3)
    found = evaluate(reconstruct(run), program, run=run)
    values = {(c.name, c.pose): c for c in found.characteristics}
    for name, place in COMMANDED.items():
        mean = true[name].mean(axis=0)
        distance = np.linalg.norm(true[name] - mean, axis=1)
        ap, rp = values["AP_p", name], values["RP_l", name]
        assert abs(ap.value - np.linalg.norm(mean - place)) < 2 * ap.u95
        assert abs(rp.value - (distance.mean() + 3 * distance.std(ddof=1))) < 0.03
        assert ap.as_dict()["unit"] == "mm"
        assert list(ap.as_dict())[:2] == ["name", "pose"]


def test_errors_of_a_run_are_those_of_its_trajectory() -> None:
    run, _, _ = dwelling_run(2, 3)
    trajectory = reconstruct(run)
    samples = np.array([10, 200, 400])
    errors, _ = ErrorsOfRun(run).at(trajectory, samples)
    np.testing.assert_allclose(errors.random, trajectory.random[samples], rtol=1e-6, atol=1e-15)
