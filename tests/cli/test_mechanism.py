"""`lmeasure mechanism` and `lmeasure dyads`: workspaces against a brute force of their own, tables, pages, recordings, refusals."""

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lmeasure.cli.app import app
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.robots import ParallelFile, any_shipped, over_grid
from lmeasure.view.viewer import check_recording

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def run(*words: object) -> str:
    done = CliRunner().invoke(app, [str(w) for w in words])
    assert done.exit_code == 0, done.output
    return done.output


def refused(*words: object) -> str:
    done = CliRunner().invoke(app, [str(w) for w in words])
    assert done.exit_code in (1, 2)
    said = done.output + str(done.exception)
    assert done.exit_code == 2 or isinstance(done.exception, LMeasureError)
    return said


def test_the_rotopods_workspace_is_three_fold_at_fixed_yaw_and_of_revolution_with_free_yaw() -> None:
    file = any_shipped("rotopod")
    assert isinstance(file, ParallelFile)
    flat = np.arange(-200.0, 200.1, 10.0)
    heights = np.arange(955.0, 980.1, 1.0)
    found = over_grid(file, (flat, flat, heights), LEVEL, yaw_free=False)
    assert set(found.ended_by) <= {"reached", "joints", "gaps", "base_cone", "regular"}
    inside = found.found.inside
    place = np.array([150.0, 0.0]), np.array([-150.0, 0.0])
    at = [tuple(np.searchsorted(flat, p)) for p in place]
    assert inside[at[0]].any() != inside[at[1]].any()
    free = over_grid(file, (flat, flat, heights[11:12]), LEVEL, yaw_free=True).found.inside
    far = np.hypot(*np.meshgrid(flat, flat, indexing="ij"))
    for level in range(free.shape[2]):
        edge = far[free[:, :, level]].max()
        assert free[:, :, level][far < edge - 5.0].all()


def test_a_mechanism_is_told_drawn_and_recorded(tmp_path: Path) -> None:
    out = run(
        "mechanism", "four-chains-arms", "--x", "-40:40:20", "--y", "-20:40:20", "--z", "70:130:20", "--out", tmp_path / "m.json",
        "--report", tmp_path / "page", "--rerun", tmp_path / "m.rrd",
    )  # fmt: skip
    assert "four-chains-arms: 6 freedoms, 36 parameters" in out
    assert out.splitlines()[-2] == f"written: {tmp_path / 'page' / 'mechanism.html'}"
    record = json.loads((tmp_path / "m.json").read_text())
    assert record["singular"] == "no"
    assert record["workspace"]["places"] > 5
    page = (tmp_path / "page" / "mechanism.html").read_text(encoding="utf-8")
    assert "Mechanism four-chains-arms" in page
    assert "leg_2_lift_deg" in page
    check_recording(tmp_path / "m.rrd")
    logos = json.loads(run("mechanism", "logos", "--quaternion", "0,0,0.17364817766693033,0.984807753012208", "--json"))
    turns = [
        float(v)
        for v in next(line for line in logos["summary"] if "legs about" in line).split(" axes ")[1].removesuffix(" deg").split(", ")
    ]
    assert turns[0] == pytest.approx(16.5567, abs=0.002)  # thesis 5.8: 16.555 +- 0.01


def test_a_table_of_poses_becomes_joints_and_completions(tmp_path: Path) -> None:
    robot = any_shipped("seven-link")
    poses = robot.model.forward(np.array([[-30.0], [0.0], [25.0]]))
    columns = {"pose": ["a", "b", "c"], **dict(zip(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), poses.T, strict=True))}
    files.write_table(tmp_path / "poses.csv", columns)
    run("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "joints.csv")
    table = files.read_table(tmp_path / "joints.csv")
    np.testing.assert_allclose(table.numbers("way_mm"), [-30.0, 0.0, 25.0], atol=1e-6)
    assert (table.numbers("kept") == 1.0).all()
    for kind in ("line", "plane", "point-on-a-line"):
        run("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "c.csv", "--complete", kind, "--force")
        done = files.read_table(tmp_path / "c.csv")
        found = done.matrix(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"))
        # the pose itself completes what it tells
        for name, pose in zip("abc", poses, strict=True):
            own = found[[n.startswith(f"{name}_") for n in done.text("pose")]]
            assert np.minimum(np.abs(own - pose).max(axis=1), np.abs(own * [1, 1, 1, -1, -1, -1, -1] - pose).max(axis=1)).min() < 1e-6


def test_links_are_found_for_poses(tmp_path: Path) -> None:
    """Exact poses of five links give back links that miss none of them."""
    poses = any_shipped("seven-link").model.forward(np.linspace(-70.0, 50.0, 12)[:, None])
    columns = {"pose": [f"p{i}" for i in range(12)], **dict(zip(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), poses.T, strict=True))}
    files.write_table(tmp_path / "poses.csv", columns)
    out = run("dyads", tmp_path / "poses.csv", "--out", tmp_path / "links", "--links", "1", "--starts", "10")
    assert "largest error" in out
    links = files.read_table(tmp_path / "links" / "links.csv")
    anchor, point = (links.matrix([f"{end}_{axis}_mm" for axis in "xyz"])[0] for end in ("base", "platform"))
    far = [np.linalg.norm(p[:3] + _turn(p[3:]) @ point - anchor) for p in poses]
    assert np.ptp(far) < 1e-6


def test_poses_need_no_names(tmp_path: Path) -> None:
    """A table of what the help names, x_mm ... qw, is read: poses are called by their number. What is missing has no hint to an option that
    these commands do not have."""
    poses = any_shipped("seven-link").model.forward(np.linspace(-70.0, 50.0, 12)[:, None])
    columns = dict(zip(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), poses.T, strict=True))
    files.write_table(tmp_path / "poses.csv", columns)
    run("dyads", tmp_path / "poses.csv", "--out", tmp_path / "links", "--links", "1", "--starts", "10")
    assert files.read_table(tmp_path / "links" / "misses.csv").text("pose") == [str(i + 1) for i in range(12)]
    run("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "joints.csv")
    assert files.read_table(tmp_path / "joints.csv").text("pose") == [str(i + 1) for i in range(12)]
    del columns["z_mm"]
    files.write_table(tmp_path / "flat.csv", columns)
    said = refused("dyads", tmp_path / "flat.csv", "--out", tmp_path / "none")
    assert "column 'z_mm' is missing" in said
    assert "--columns" not in said


def _turn(q: np.ndarray) -> np.ndarray:
    x, y, z, w = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_what_cannot_be_studied_is_said_in_one_line(tmp_path: Path) -> None:
    assert "its legs do not reach this pose" in refused("mechanism", "rotopod", "--position-mm", "0,0,2000")
    assert "is of kind 'hexapod'" in refused("mechanism", "gough")
    assert "give all three for a workspace" in refused("mechanism", "rotopod", "--x", "0:1:0.5")
    assert "is no robot that comes along" in refused("mechanism", "rotopode")
    assert "goes with --joints" in refused("mechanism", "rotopod", "--poses", tmp_path / "p.csv")
    (tmp_path / "p.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\nb,1,0,zero,0,0,0,1\n")
    said = refused("dyads", tmp_path / "p.csv", "--out", tmp_path / "d")
    assert "p.csv" in said
    assert "zero" in said
    (tmp_path / "p.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\n")
    assert "1 poses; a link has 7 parameters" in refused("dyads", tmp_path / "p.csv", "--out", tmp_path / "d")
    assert not (tmp_path / "d").exists()
    (tmp_path / "q.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\n")
    said = refused("mechanism", "three-prr", "--poses", tmp_path / "q.csv", "--joints", tmp_path / "j.csv", "--complete", "plane")
    assert "completed by 3 rods; it has 0" in said
