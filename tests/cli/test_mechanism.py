"""`lmeasure mechanism` and `lmeasure dyads`: workspaces against a brute force of their own, tables, pages, recordings, refusals."""

import json
import tomllib
from importlib.resources import files as resources
from pathlib import Path

import numpy as np
import pytest
from in_process import code_and_text, ran

from lmeasure.io import files
from lmeasure.robots import ParallelFile, Turns, any_shipped, over_grid
from lmeasure.view.recording import check_recording

robot_files = resources("lmeasure.robots").joinpath("shipped")
LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def refused(*words: object) -> str:
    code, said = code_and_text(*words)
    assert code in (1, 2)
    return said


def test_the_rotopods_workspace_is_three_fold_at_fixed_yaw_and_of_revolution_with_free_yaw() -> None:
    file = any_shipped("rotopod")
    assert isinstance(file, ParallelFile)
    flat = np.arange(-200.0, 200.1, 10.0)
    heights = np.arange(955.0, 980.1, 1.0)
    found = over_grid(file, (flat, flat, heights), LEVEL)
    assert set(found.ended_by) <= {"reached", "joints", "gaps", "base_cone", "regular"}
    inside = found.found.inside
    place = np.array([150.0, 0.0]), np.array([-150.0, 0.0])
    at = [tuple(np.searchsorted(flat, p)) for p in place]
    assert inside[at[0]].any() != inside[at[1]].any()
    free = over_grid(file, (flat, flat, heights[11:12]), LEVEL, Turns(yaw_free=True)).found.inside
    far = np.hypot(*np.meshgrid(flat, flat, indexing="ij"))
    for level in range(free.shape[2]):
        edge = far[free[:, :, level]].max()
        assert free[:, :, level][far < edge - 5.0].all()


def test_places_of_a_six_coordinate_scan_are_those_of_each_orientation(tmp_path: Path) -> None:
    """002, 3.1: six coordinates, seven constraints. Inside at one orientation, and inside at all, are unions and intersections."""
    scan = ["--x", "-100:100:50", "--y", "-100:100:50", "--z", "960:976:2", "--out", tmp_path / "m.json", "--force"]
    ran("mechanism", "rotopod", *scan, "--tilt-rad", "0.004", "--tilt-steps", "3")
    found = json.loads((tmp_path / "m.json").read_text())["workspace"]
    axes = np.arange(-100, 101, 50.0), np.arange(-100, 101, 50.0), np.arange(960, 977, 2.0)
    each, file = [], any_shipped("rotopod")
    assert isinstance(file, ParallelFile)
    for a, b, c in np.stack(np.meshgrid(*[[-0.004, 0.0, 0.004]] * 3), axis=-1).reshape(-1, 3):
        size = np.sqrt(a * a + b * b + c * c)
        turn = np.r_[np.array([a, b, c]) * (np.sin(size / 2.0) / size if size else 0.5), np.cos(size / 2.0)]
        each.append(over_grid(file, axes, turn).found.inside)
    cell = 50.0 * 50.0 * 2.0
    assert found["poses"] == 27 * 225
    assert found["volume_mm3"] == np.any(each, axis=0).sum() * cell
    assert found["every_orientation_volume_mm3"] == np.all(each, axis=0).sum() * cell
    assert 0 < np.all(each, axis=0).sum() < np.any(each, axis=0).sum()


def test_the_crank_platforms_workspace_by_drives_and_by_coordinates(tmp_path: Path) -> None:
    """003, figures 7 and 8: home is inside, and both ways find the same cells, those apart that drives touch beside a node only."""
    box = ["--x", "-12:12:4", "--y", "-12:12:4", "--z", "196:204:1", "--out", tmp_path / "m.json", "--force"]
    out = ran("mechanism", "crank-platform", *box, "--drives", "25", "--joints", tmp_path / "all.csv")
    by_drives = json.loads((tmp_path / "m.json").read_text())["workspace"]
    table = files.read_table(tmp_path / "all.csv")
    places = table.matrix(("x_mm", "y_mm", "z_mm"))
    assert f"{len(places)} poses within all limits" in out
    # an own count of the cells of the table
    cells = {tuple(c) for c in np.rint(places / [4.0, 4.0, 1.0]).astype(int) if np.abs(c[:2]).max() <= 3 and 196 <= c[2] <= 204}
    assert (0, 0, 200) in cells
    assert by_drives["places"] == len(cells)
    assert by_drives["volume_mm3"] == len(cells) * 16.0
    joints = np.column_stack([table.numbers(f"leg_{i}_deg") for i in (1, 3, 5)])
    np.testing.assert_allclose(any_shipped("crank-platform").model.forward(np.radians(joints[::400]))[:, :3], places[::400], atol=1e-9)
    ran("mechanism", "crank-platform", *box, "--tilt-deg", "5.729577951308232", "--tilt-steps", "25")
    by_coordinates = json.loads((tmp_path / "m.json").read_text())["workspace"]
    assert 0.7 * by_drives["places"] < by_coordinates["places"] <= by_drives["places"]


def test_a_planar_mechanism_has_an_area(tmp_path: Path) -> None:
    ran("mechanism", "three-prr", "--x=-200:200:10", "--y=-200:200:10", "--z=0:0:1", "--out", tmp_path / "m.json")
    found = json.loads((tmp_path / "m.json").read_text())["workspace"]
    assert "volume_mm3" not in found
    # a rod reaches a point of the platform from its guide within the carriage's limits: each by a quadratic of its own
    x, y = (a.ravel() for a in np.meshgrid(np.arange(-200, 201, 10.0), np.arange(-200, 201, 10.0)))
    good = np.ones(len(x), dtype=bool)
    for k in range(3):
        c, s = np.cos(2.0 * np.pi * k / 3), np.sin(2.0 * np.pi * k / 3)
        across, along = c * (x + 120.0 * c) + s * (y + 120.0 * s) - 400.0, -s * (x + 120.0 * c) + c * (y + 120.0 * s)
        with np.errstate(invalid="ignore"):
            good &= np.abs(along - np.sqrt(330.0**2 - across**2)) <= 400.0
    assert found["area_mm2"] == pytest.approx(good.sum() * 100.0, abs=300.0)  # rounded dimensions of the file; singular ones apart


def test_a_mechanism_is_told_drawn_and_recorded(tmp_path: Path) -> None:
    out = ran(
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
    logos = json.loads(ran("mechanism", "logos", "--quaternion", "0,0,0.17364817766693033,0.984807753012208", "--json"))
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
    ran("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "joints.csv")
    table = files.read_table(tmp_path / "joints.csv")
    np.testing.assert_allclose(table.numbers("way_mm"), [-30.0, 0.0, 25.0], atol=1e-6)
    assert (table.numbers("kept") == 1.0).all()
    for kind in ("line", "plane", "point-on-a-line"):
        ran("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "c.csv", "--complete", kind, "--force")
        done = files.read_table(tmp_path / "c.csv")
        found = done.matrix(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"))
        # the pose itself completes what it tells
        for name, pose in zip("abc", poses, strict=True):
            own = found[[n.startswith(f"{name}_") for n in done.text("pose")]]
            assert np.minimum(np.abs(own - pose).max(axis=1), np.abs(own * [1, 1, 1, -1, -1, -1, -1] - pose).max(axis=1)).min() < 1e-6


def test_velocities_and_steps_of_drives_are_differences_of_the_forward_solution(tmp_path: Path) -> None:
    """002, 4 and 5.3: A x' + B q' = 0, V = -A^-1 B; steps of 1.8 +- 0.09 degrees of one drive through a gear of 50."""
    file = any_shipped("rotopod")
    assert isinstance(file, ParallelFile)
    text = Path(str(robot_files.joinpath("rotopod.toml"))).read_text(encoding="utf-8")
    (tmp_path / "own.toml").write_text(text.replace("elbow = 1", "elbow = 1\nresolution_deg = 0.036\nresolution_error_deg = 0.0018", 1))
    out = ran("mechanism", tmp_path / "own.toml", "--matrices", "--out", tmp_path / "m.json")
    found = json.loads((tmp_path / "m.json").read_text())
    A, B, V = (np.array(found[name]) for name in "ABV")
    np.testing.assert_allclose(A @ V + B, 0.0, atol=1e-9)
    model, h = file.model, 1e-5
    for i in range(6):
        ahead, behind = (model.forward((model.home_joints + s * h * np.eye(6)[i])[None])[0] for s in (1.0, -1.0))
        np.testing.assert_allclose((ahead[:3] - behind[:3]) / (2.0 * h), V[3:, i], rtol=1e-5, atol=1e-3)
        np.testing.assert_allclose(2.0 * (ahead[3:6] - behind[3:6]) / (2.0 * h), V[:3, i], rtol=1e-5, atol=1e-6)
    assert "V  0.166667, 0.166667, 0.166667, 0.166667, 0.166667, 0.166667" in out
    u = np.radians(np.hypot(0.036 / np.sqrt(12.0), 0.0018 / np.sqrt(3.0)))
    np.testing.assert_allclose(found["by_steps"]["u_position_mm"], np.abs(V[3:, 0]) * u, rtol=1e-9)
    # of one direction 95 % lie within 1.96 standard uncertainties
    assert found["by_steps"]["u95_position_mm"] == pytest.approx(1.96 * np.linalg.norm(V[3:, 0]) * u, rel=2e-3)
    assert found["mobility"] == {"bodies": 13, "pairs": {"P5": 6, "P4": 0, "P3": 12, "P2": 0, "P1": 0}, "freedoms": 6, "rods_turn": 6}


def test_speeds_are_compared_with_the_limits_of_drives(tmp_path: Path) -> None:
    """A turn of the rotopod's platform by a cubic of time: every carriage goes with it, at 3 a t^2 and 6 a t."""
    text = Path(str(robot_files.joinpath("rotopod.toml"))).read_text(encoding="utf-8")
    t = np.linspace(0.0, 2.0, 9)
    turn = 5.0 * t**3
    half = np.radians(turn) / 2.0
    table = {
        "time_s": t,
        "x_mm": 0 * t,
        "y_mm": 0 * t,
        "z_mm": 965.0 + 0 * t,
        "qx": 0 * t,
        "qy": 0 * t,
        "qz": np.sin(half),
        "qw": np.cos(half),
    }
    files.write_table(tmp_path / "poses.csv", table)
    for limit, kept in (
        ("max_speed_deg_s = 61", [1] * 9),
        ("max_speed_deg_s = 40", [1] * 7 + [0, 0]),
        ("max_acceleration_deg_s2 = 44", [1] * 6 + [0] * 3),
    ):
        (tmp_path / "own.toml").write_text(text.replace("elbow = 2", f"elbow = 2\n{limit}", 1))
        ran("mechanism", tmp_path / "own.toml", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "j.csv", "--force")
        found = files.read_table(tmp_path / "j.csv")
        np.testing.assert_allclose(found.numbers("leg_2_deg_s"), 15.0 * t**2, atol=1e-9)
        np.testing.assert_allclose(found.numbers("leg_5_deg_s2"), 30.0 * t, atol=1e-8)
        np.testing.assert_array_equal(found.numbers("kept"), kept)
    files.write_table(tmp_path / "poses.csv", table | {"time_s": t[::-1]})
    assert "row 2: time_s does not rise" in refused(
        "mechanism", "rotopod", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "k.csv"
    )


def test_links_are_found_for_poses(tmp_path: Path) -> None:
    """Exact poses of five links give back links that miss none of them."""
    poses = any_shipped("seven-link").model.forward(np.linspace(-70.0, 50.0, 12)[:, None])
    columns = {"pose": [f"p{i}" for i in range(12)], **dict(zip(("x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw"), poses.T, strict=True))}
    files.write_table(tmp_path / "poses.csv", columns)
    out = ran("dyads", tmp_path / "poses.csv", "--out", tmp_path / "links", "--links", "1", "--starts", "10")
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
    ran("dyads", tmp_path / "poses.csv", "--out", tmp_path / "links", "--links", "1", "--starts", "10")
    assert files.read_table(tmp_path / "links" / "misses.csv").text("pose") == [str(i + 1) for i in range(12)]
    ran("mechanism", "seven-link", "--poses", tmp_path / "poses.csv", "--joints", tmp_path / "joints.csv")
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


def test_legs_on_hooke_joints_turn_and_bend_no_farther_than_is_stated(tmp_path: Path) -> None:
    """Thesis 5.8: at 20 degrees about z legs turn by 16.56 and 20.05 degrees; angles of joints by an own product."""
    text = Path(str(robot_files.joinpath("logos.toml"))).read_text(encoding="utf-8")
    turned = ["--quaternion", "fixed-xyz:0,0,20"]
    data = tomllib.loads(text)
    c, s = np.cos(np.radians(20.0)), np.sin(np.radians(20.0))
    turn, home = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array(data["home"]["position_mm"])
    bent = []
    for leg in data["leg"]:
        e = home + turn @ leg["platform_mm"] - leg["base_mm"]
        for axis in (np.array(leg["base_axis"]), turn @ leg["platform_axis"]):
            bent.append(90.0 - np.degrees(np.arccos(abs(e @ axis) / np.linalg.norm(e) / np.linalg.norm(axis))))
    for key, value in (("leg_turn_deg", 20.06), ("hooke_deg", max(bent))):
        for more, words in ((0.01, False), (-0.03, True)):
            (tmp_path / "own.toml").write_text(text.replace("[[leg]]", f"[limits]\n{key} = {value + more}\n\n[[leg]]", 1))
            assert ("outside" in ran("mechanism", tmp_path / "own.toml", *turned)) == words


def test_angles_of_the_documents_do_where_quaternions_do(tmp_path: Path) -> None:
    """002: alpha, beta, gamma; 004: psi, theta, phi; the thesis: O, A, T. Each turn written out as a quaternion is the same pose."""
    half = np.radians(10.0)
    same = ["0 0 0.17364817766693033 0.984807753012208", "fixed-xyz:0,0,20", "zxz:15,0,5", "kuka-abc:20 0 0", "puma-oat:20,-90,90"]
    found = [json.loads(ran("mechanism", "logos", "--quaternion", *words.split(" "), "--json"))["summary"] for words in same]
    assert all(one == found[0] for one in found[1:])
    assert "is not a known convention" in refused("mechanism", "logos", "--quaternion", "zxy:1,2,3")
    assert "'1,2' is not three numbers" in refused("mechanism", "logos", "--quaternion", "zxz:1,2")
    table = {"x_mm": [0.0], "y_mm": [0.0], "z_mm": [713.7], "psi_deg": [15.0], "theta_deg": [0.0], "phi_deg": [5.0]}
    files.write_table(tmp_path / "a.csv", table)
    files.write_table(
        tmp_path / "q.csv", dict(list(table.items())[:3]) | {"qx": [0.0], "qy": [0.0], "qz": [np.sin(half)], "qw": [np.cos(half)]}
    )
    ran("mechanism", "logos", "--poses", tmp_path / "a.csv", "--angles", "zxz", "--joints", tmp_path / "ja.csv")
    ran("mechanism", "logos", "--poses", tmp_path / "q.csv", "--joints", tmp_path / "jq.csv")
    one, other = (files.read_table(tmp_path / name) for name in ("ja.csv", "jq.csv"))
    for i in range(1, 7):
        np.testing.assert_allclose(one.numbers(f"leg_{i}_mm"), other.numbers(f"leg_{i}_mm"), atol=1e-9)


def test_what_cannot_be_studied_is_said_in_one_line(tmp_path: Path) -> None:
    assert "its legs do not reach this pose" in refused("mechanism", "rotopod", "--position-mm", "0,0,2000")
    assert "is of kind 'hexapod'" in refused("mechanism", "gough")
    assert "works only with --x, --y and --z" in refused("mechanism", "rotopod", "--drives", "5")
    box = ("--x", "0:1:1", "--y", "0:1:1", "--z", "960:961:1")
    assert "is given together with --tilt-deg" in refused("mechanism", "rotopod", *box, "--tilt-deg", "1", "--tilt-rad", "0.01")
    assert "give all three for a workspace" in refused("mechanism", "rotopod", "--x", "0:1:0.5")
    assert "is not a shipped robot" in refused("mechanism", "rotopode")
    assert "works only with --joints" in refused("mechanism", "rotopod", "--poses", tmp_path / "p.csv")
    (tmp_path / "p.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\nb,1,0,zero,0,0,0,1\n")
    said = refused("dyads", tmp_path / "p.csv", "--out", tmp_path / "d")
    assert "p.csv" in said
    assert "zero" in said
    (tmp_path / "p.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\n")
    assert "1 poses. A link has 7 parameters" in refused("dyads", tmp_path / "p.csv", "--out", tmp_path / "d")
    assert not (tmp_path / "d").exists()
    (tmp_path / "q.csv").write_text("pose,x_mm,y_mm,z_mm,qx,qy,qz,qw\na,0,0,0,0,0,0,1\n")
    said = refused("mechanism", "three-prr", "--poses", tmp_path / "q.csv", "--joints", tmp_path / "j.csv", "--complete", "plane")
    assert "completed by 3 rods. It has 0" in said
