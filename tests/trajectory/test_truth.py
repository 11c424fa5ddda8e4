"""Runs of an independent simulator, against where the tool really was (see tests/authorities/truth/README.md)."""

import gzip
import re
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from zeroed import zeroed_exactly

from lmeasure.recording import read_run
from lmeasure.trajectory import Trajectory, motion_of, reconstruct

AUTHORITY = Path(__file__).parents[1] / "authorities" / "truth"


def truth_of(name: str) -> NDArray[np.float64]:
    """(n, 8) rows time_s, x, y, z [mm], qx, qy, qz, qw of the simulator."""
    with gzip.open(AUTHORITY / name / "truth.csv.gz", "rt") as file:
        return np.asarray(np.loadtxt(file, delimiter=",", skiprows=1))


def errors(trajectory: Trajectory, truth: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(n,) distances of the tool origin [mm] and angles of rotation [rad] between truth and result, sample by sample."""
    np.testing.assert_array_equal(trajectory.time_s, truth[:, 0])
    distance = np.linalg.norm(trajectory.poses[:, :3] - truth[:, 1:4], axis=1)
    angle = (Rotation.from_quat(trajectory.poses[:, 3:]) * Rotation.from_quat(truth[:, 4:]).inv()).magnitude()
    return distance, np.asarray(angle)


def normalised(trajectory: Trajectory, truth: NDArray[np.float64]) -> NDArray[np.float64]:
    """(6,) root mean square errors (position, rotation) over what is stated of them."""
    difference = trajectory.poses[:, :3] - truth[:, 1:4]
    turn = (Rotation.from_quat(truth[:, 4:]) * Rotation.from_quat(trajectory.poses[:, 3:]).inv()).as_rotvec()
    return np.asarray(np.sqrt(np.mean((np.hstack([difference, turn]) / trajectory.u) ** 2, axis=0)))


def rms(values: NDArray[np.float64]) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_exact_counts_give_the_exact_motion() -> None:
    """Nothing is rounded here, so what is left is the model's and the solver's own error: none beyond floating point."""
    distance, angle = errors(reconstruct(zeroed_exactly(read_run(AUTHORITY / "cell-run-exact"))), truth_of("cell-run-exact"))
    assert distance.max() < 1e-9
    assert angle.max() < 1e-12


@pytest.mark.parametrize(
    ("name", "position_mm", "rotation_rad"),
    [("cell-run", 0.004612, 3.963e-5), ("three-drums-two-passes", 0.005721, 3.633e-5), ("cell-run-long", 0.004859, 4.378e-5)],
)
def test_whole_counts_cost_what_they_cost_a_generic_optimiser(name: str, position_mm: float, rotation_rad: float) -> None:
    distance, angle = errors(reconstruct(zeroed_exactly(read_run(AUTHORITY / name))), truth_of(name))
    assert rms(distance) == pytest.approx(position_mm, rel=0.05)
    assert rms(angle) == pytest.approx(rotation_rad, rel=0.05)


def test_the_readme_states_what_is_met() -> None:
    readme = (AUTHORITY.parents[2] / "README.md").read_text(encoding="utf-8")
    distance, angle = errors(reconstruct(zeroed_exactly(read_run(AUTHORITY / "cell-run-exact"))), truth_of("cell-run-exact"))
    said = re.search(r"within (\S+) mm and (\S+) rad of the truth", readme)
    assert said is not None
    # what is left is rounding, which another processor may do otherwise
    assert float(said[1]) / 4.0 < distance.max() < 2.0 * float(said[1])
    assert float(said[2]) / 4.0 < angle.max() < 2.0 * float(said[2])
    runs = [read_run(AUTHORITY / name) for name in ("cell-run", "three-drums-two-passes", "cell-run-long")]
    found = [reconstruct(zeroed_exactly(run)) for run in runs]
    truths = [truth_of(name) for name in ("cell-run", "three-drums-two-passes", "cell-run-long")]
    met = np.array([[rms(e) for e in errors(f, t)] for f, t in zip(found, truths, strict=True)])
    least, most = met.min(axis=0), met.max(axis=0)
    figures = f"{least[0]:.4f} to {most[0]:.4f} mm and {least[1]:.1e} to {most[1]:.1e} rad rms"
    assert figures.replace("e-0", "e-") in readme
    assert "| Stated uncertainty and actual error | agree within 5 % |" in readme
    for f, t in zip(found, truths, strict=True):
        np.testing.assert_allclose(normalised(f, t), 1.0, atol=0.05)


def test_a_counter_of_16_bits_tells_the_same_motion() -> None:
    wide, narrow = (reconstruct(zeroed_exactly(read_run(AUTHORITY / name))) for name in ("cell-run-long", "cell-run-16-bit"))
    assert set(narrow.status) == {0}
    np.testing.assert_array_equal(narrow.poses, wide.poses)


def test_smoothed_cell_run_is_within_three_micrometres() -> None:
    found = motion_of(reconstruct(zeroed_exactly(read_run(AUTHORITY / "cell-run"))))
    distance = np.linalg.norm(found.poses[:, :3] - truth_of("cell-run")[:, 1:4], axis=1)
    assert np.sqrt(np.mean(distance**2)) <= 0.003
