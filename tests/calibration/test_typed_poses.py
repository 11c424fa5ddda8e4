"""Planned poses as they are typed into a controller: to 0.1 mm and 0.01 degrees, away from where its angles are not unique."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Instrument, Region
from lmeasure.core import CONVENTIONS, rotation_from_angles
from lmeasure.core.conventions import from_singular_deg
from lmeasure.estimation import estimated_covariance, parameter_information
from lmeasure.io.tables import read_table
from lmeasure.recording import read_poses
from lmeasure.rig import Rig, rig_from_dict, write_rig
from lmeasure.simulation import cell_rig
from lmeasure.workflows import plan_poses

IDENTITY = np.array([0.0, 0.0, 0.0, 1.0])


def two_drums(angles: str) -> Rig:
    data = cell_rig(0).to_dict() | {"angles": angles}
    data["observation_point"], data["cable"] = data["observation_point"][:2], data["cable"][:2]
    return rig_from_dict(data)


@pytest.mark.parametrize("name", [name for name, c in CONVENTIONS.items() if c.axes != "rotvec"])
def test_the_distance_from_a_singular_orientation_is_what_the_turns_lack_in_volume(name: str) -> None:
    """Three axes of turns, the middle one square to both others, span the sine of the angle between the first and the last."""
    rng = np.random.default_rng(2)
    for angles in rng.uniform(-180.0, 180.0, (20, 3)):
        h = 1e-4
        ahead, behind = (rotation_from_angles(name, angles + s * h * np.eye(3)) for s in (1.0, -1.0))
        axes = (ahead * behind.inv()).as_rotvec(degrees=True) / (2.0 * h)
        here = from_singular_deg(name, rotation_from_angles(name, angles))
        assert abs(np.linalg.det(axes)) == pytest.approx(np.sin(np.radians(here)), abs=1e-6)


def test_a_rotation_vector_is_not_unique_at_half_a_turn() -> None:
    turns = Rotation.from_rotvec([[3.0, 0.0, 0.0], [0.0, 1e-9, 0.0]])
    np.testing.assert_allclose(from_singular_deg("ur-rotation-vector", turns), [180.0 - np.degrees(3.0), 90.0])


@pytest.mark.parametrize("name", CONVENTIONS)
def test_a_region_of_typed_poses_has_no_others(name: str) -> None:
    """Each is in the box, a step from the pose that it stands for, and typing its angles again gives it."""
    region = Region(np.array([-10.04, 5.0, 0.03]), np.array([10.0, 30.16, 0.04]), 0.4, Rotation.from_rotvec([0.3, 0.2, -1.0]).as_quat())
    typed = Region(region.low, region.high, region.tilt_rad, region.quaternion, name)
    unit = np.vstack([region.corners(), np.random.default_rng(1).uniform(0.0, 1.0, (50, 6))])
    exact, rows = region.rows(unit), typed.rows(unit)
    assert np.abs(rows[:, :3] * 10.0 - np.rint(rows[:, :3] * 10.0)).max() < 1e-9
    assert (rows[:, :2] >= region.low[:2]).all()
    assert (rows[:, :2] <= region.high[:2]).all()
    assert np.abs(rows[:, :3] - exact[:, :3]).max() <= 0.1
    # three angles, each half a step off at most
    assert np.degrees((Rotation.from_quat(rows[:, 3:]) * Rotation.from_quat(exact[:, 3:]).inv()).magnitude()).max() < 0.016


def test_a_plan_is_of_the_poses_that_are_typed(tmp_path: Path) -> None:
    rig = two_drums("puma-oat")
    write_rig(tmp_path / "rig.toml", rig)
    box = ((-300.02, 300.0), (-300.0, 300.0), (-300.0, 300.07))
    requested: dict[str, Any] = {"rig": tmp_path / "rig.toml", "poses": 4, "criterion": "I", "box": box, "tilt_deg": 8.0, "further": 0}
    plan = plan_poses.run_plan_poses(plan_poses.PlanPosesSettings(**requested, out=tmp_path / "typed.csv")).made
    table, poses = read_table(tmp_path / "typed.csv"), read_poses(tmp_path / "typed.csv", rig.angles)
    np.testing.assert_allclose(poses.rows, plan.poses.rows, rtol=0, atol=1e-9)
    lines = (tmp_path / "typed.csv").read_text().splitlines()[1:]
    assert all(len(cell.partition(".")[2]) <= 1 + (i > 2) for line in lines for i, cell in enumerate(line.split(",")[1:]))
    assert from_singular_deg(rig.angles, poses.rotation).min() >= 2.0
    assert dict(plan.broken)["angles near singular"] > 0.0
    assert table.columns == ["pose", "x_mm", "y_mm", "z_mm", "o_deg", "a_deg", "t_deg"]
    # the figures are those of these poses
    instrument = Instrument(rig, rig.cable, ("position", "guide"), np.zeros(6), visit=np.zeros(6))
    blocks = instrument.blocks(poses.rows[1:], instrument.zero(poses.rows[0]))
    A = blocks.reshape(-1, blocks.shape[2])
    covariance, rank = estimated_covariance(parameter_information(A.T @ A, 10))
    assert rank == plan.outlook.rank
    np.testing.assert_allclose([u / width for _, u, width in plan.parameters], np.sqrt(np.diag(covariance)), rtol=1e-3)


def test_one_singular_orientation_alone_is_planned_for(tmp_path: Path) -> None:
    """The identity is singular in puma-oat; a box without tilts has nowhere else to go."""
    write_rig(tmp_path / "rig.toml", two_drums("puma-oat"))
    box = ((-300.0, 300.0), (-300.0, 300.0), (-300.0, 300.0))
    requested: dict[str, Any] = {"rig": tmp_path / "rig.toml", "out": tmp_path / "poses.csv", "box": box, "poses": 3, "further": 0}
    plan = plan_poses.run_plan_poses(plan_poses.PlanPosesSettings(**requested, criterion="I", tilt_deg=0.0, rounded=False)).made
    assert np.abs(plan.poses.rows[:, :3] * 10.0 - np.rint(plan.poses.rows[:, :3] * 10.0)).max() > 0.01  # not asked for
    np.testing.assert_allclose(np.abs(plan.poses.rows[:, 3:]), np.tile(IDENTITY, (3, 1)), atol=1e-9)
