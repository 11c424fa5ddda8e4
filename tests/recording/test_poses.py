"""Pose files: angles of every controller or quaternions, there and back, and one line for what is wrong."""

import math
from pathlib import Path

import numpy as np
import oracles
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import CONVENTIONS, FileFormatError
from lmeasure.recording import Poses, poses_from_rows, read_poses, write_poses


def some_poses(n: int = 20) -> Poses:
    g = np.random.default_rng(4)
    rows = np.column_stack([g.uniform(-500, 500, (n, 3)), Rotation.random(n, rng=np.random.default_rng(5)).as_quat()])
    exact = poses_from_rows(rows, [f"p{i}" for i in range(n)])
    return Poses(exact.names, exact.rows, np.full(n, 0.05), np.radians(np.full(n, 0.01)))


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_quaternions_come_back_bit_for_bit(tmp_path: Path, suffix: str) -> None:
    poses = some_poses()
    write_poses(tmp_path / f"p{suffix}", poses)
    once = read_poses(tmp_path / f"p{suffix}", "puma-oat")
    assert once.names == poses.names
    assert np.array_equal(once.rows[:, :3], poses.rows[:, :3])
    assert once.rows[:, 3:] == pytest.approx(poses.rows[:, 3:], abs=3e-16)
    assert np.array_equal(once.u_position_mm, poses.u_position_mm)
    assert once.u_rotation_rad == pytest.approx(poses.u_rotation_rad, rel=1e-15)


@pytest.mark.parametrize("angles", sorted(CONVENTIONS))
def test_angles_of_every_controller_come_back(tmp_path: Path, angles: str) -> None:
    poses = some_poses()
    write_poses(tmp_path / "p.csv", poses, angles)
    back = read_poses(tmp_path / "p.csv", angles)
    assert (back.rotation * poses.rotation.inv()).magnitude().max() < 1e-7
    assert np.array_equal(back.rows[:, :3], poses.rows[:, :3])


def test_angles_are_those_of_the_controller(tmp_path: Path) -> None:
    (tmp_path / "p.csv").write_text("pose,x_mm,y_mm,z_mm,o_deg,a_deg,t_deg\n1,10,20,30,40,50,60\n")
    poses = read_poses(tmp_path / "p.csv", "puma-oat")
    assert poses.names == ("1",)
    assert poses.rotation.as_matrix()[0] == pytest.approx(oracles.puma_oat(40, 50, 60), abs=1e-15)
    assert poses.points([1, 2, 3])[0] == pytest.approx(oracles.puma_oat(40, 50, 60) @ [1, 2, 3] + [10, 20, 30], abs=1e-12)
    assert not poses.u_position_mm.any()
    assert len(poses) == 1


def test_a_stated_convention_states_the_unit_of_bare_angle_columns(tmp_path: Path) -> None:
    text = "name,X [mm],Y [mm],Z [mm],A,B,C\nP1,10,20,30,40,50,60\nP2,1,2,3,-4,5,-6\n"
    (tmp_path / "robot.csv").write_text(text)
    (tmp_path / "ours.csv").write_text("pose,x_mm,y_mm,z_mm,a_deg,b_deg,c_deg\n" + text.partition("\n")[2])
    bare, ours = (read_poses(tmp_path / name, "kuka-abc") for name in ("robot.csv", "ours.csv"))
    assert np.array_equal(bare.rows, ours.rows)
    with pytest.raises(FileFormatError, match=r"It has name, .*, A, B, C\. Its angles have the names of kuka-abc"):
        read_poses(tmp_path / "robot.csv", "puma-oat")


HEAD = "pose,x_mm,y_mm,z_mm,qx,qy,qz,qw"
FILES = [
    ("pose,x_mm,y_mm,z_mm\n1,0,0,0\n", "needs the columns o_deg, a_deg, t_deg (angles = 'puma-oat') or qx, qy, qz, qw"),
    ("pose,x_mm,y_mm,o_deg,a_deg,t_deg\n1,0,0,0,0,0\n", "column 'z_mm' is missing"),
    ("x_mm,y_mm,z_mm,qx,qy,qz,qw\n0,0,0,0,0,0,1\n", "column 'pose' is missing"),
    (f"{HEAD}\n", "has no poses"),
    (f"{HEAD}\n1,0,0,0,0,0,0,1\n1,0,0,0,0,0,0,1\n", "pose '1' is given 2 times"),
    (f"{HEAD}\n1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,0.99\n", "pose 2: the quaternion's length is 0.99, not 1"),
    (f"{HEAD}\n1,0,0,0,0,0,0,0\n", "pose 1: the quaternion's length is 0, not 1"),
    (f"{HEAD}\n1,0,,0,0,0,0,1\n", ":2: y_mm: is empty"),
    (f"{HEAD}\n1,0,nan,0,0,0,0,1\n", ":2: y_mm: must be a finite number, is nan"),
    (f"{HEAD}\n1,0,1e400,0,0,0,0,1\n", ":2: y_mm: must be a finite number, is inf"),
    (f"{HEAD}\n1,0,x,0,0,0,0,1\n", ":2: y_mm: must be a number, is 'x'"),
    (f"{HEAD},u_position_mm\n1,0,0,0,0,0,0,1,-0.1\n", "column 'u_position_mm': a standard uncertainty is negative"),
    (f"{HEAD}\n,0,0,0,0,0,0,1\n", "pose number 1 has no name"),
]


@pytest.mark.parametrize(("text", "line"), FILES)
def test_one_line_names_the_pose(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "reference_poses.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_poses(path, "puma-oat")
    assert str(caught.value).startswith(f"{path}:")
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)


def test_rows_are_made_unit_and_checked() -> None:
    poses = poses_from_rows(np.array([[0, 0, 0, 0, 0, 0, 1 + 5e-7]]))
    assert poses.rows[0, 6] == 1.0
    assert poses.names == ("1",)
    for bad in ([[0, 0, math.nan, 0, 0, 0, 1]], [[0, 0, 0, 0, 0, 0, math.inf]]):
        with pytest.raises(FileFormatError, match="pose 1: contains a number that is not finite"):
            poses_from_rows(np.array(bad))


def test_names_that_are_numbers_read_alike(tmp_path: Path) -> None:
    """A spreadsheet turns 1 into 1.0 when another cell of the column is a fraction."""
    (tmp_path / "p.csv").write_text(f"{HEAD}\n1.0,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,1\n")
    assert read_poses(tmp_path / "p.csv", "puma-oat").names == ("1", "2")
