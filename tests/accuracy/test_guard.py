"""A program held against the zone."""

from pathlib import Path

import numpy as np
import pytest
from in_process import ran
from scipy.spatial.transform import Rotation

from lmeasure.accuracy import axis, guard, scan_zone, tilts
from lmeasure.io import files
from lmeasure.recording import read_program
from lmeasure.rig import read_rig

RIG = Path(__file__).parents[2] / "datasets" / "thesis-5.7" / "placed.toml"
PROGRAM = (Path(__file__).parent / "inputs" / "program.toml").read_text(encoding="utf-8")


def test_each_part_is_told_with_its_distance_from_the_edge(tmp_path: Path) -> None:
    (tmp_path / "program.toml").write_text(PROGRAM)
    span = "-300:300:50"
    arguments = ["zone", str(RIG), "--x", span, "--y", span, "--z", span, "--tilt-rad", "0.3", "--out", str(tmp_path / "zone.nc")]
    result = ran(*arguments, "--path", tmp_path / "program.toml")
    assert "path out: pressure angle up to" in result
    assert "LEAVES THE ZONE" in result.split("path out")[1].split("\n")[0]
    assert "LEAVES" not in result.split("path round")[1]
    table = files.read_table(tmp_path / "zone.path.csv")
    part, edge = np.array(table.text("part")), table.numbers("to_edge_mm")
    # the whole box is in the zone: its faces are the edge
    assert edge[part == "pose P1"] == pytest.approx([300.0])
    assert edge[part == "path round"].min() == pytest.approx(200.0, abs=0.5)
    out = part == "path out"
    np.testing.assert_allclose(edge[out], np.maximum(300.0 - table.numbers("x_mm")[out], 0.0), atol=1e-9)
    one = scan_zone(read_rig(RIG), None, x=axis(0, 0, 1), y=axis(0, 0, 1), z=axis(0, 0, 1), rotations=tilts(0, 1))
    assert table.numbers("u95_position_mm")[part == "pose P1"] == pytest.approx([one["u95_position_mm"].item()], rel=1e-9)


def test_a_path_is_judged_at_the_orientation_its_program_states(tmp_path: Path) -> None:
    """At its ends a path that turns is what poses with its end orientations are, halfway what one turned half as far is; where the program
    states no orientation it is the one that was asked for."""
    begin, end = Rotation.from_rotvec([0.2, -0.1, 0.15]), Rotation.from_rotvec([-0.15, 0.2, 0.1])
    middle = begin * Rotation.from_rotvec(0.5 * (begin.inv() * end).as_rotvec())
    requested = Rotation.from_rotvec([0.0, 0.1, 0.0])
    line = 'kind = "linear"\nstart_mm = [-50.0, 0.0, 20.0]\nend_mm = [50.0, 40.0, 20.0]\n'
    first = f"quaternion_xyzw = {begin.as_quat().tolist()}\n"
    text = 'schema = "lmeasure.program/1"\n'
    for name, at, turn in (
        ("begin", [-50.0, 0.0, 20.0], begin), ("middle", [0.0, 20.0, 20.0], middle), ("end", [50.0, 40.0, 20.0], end),
        ("kept", [50.0, 40.0, 20.0], begin), ("asked", [50.0, 40.0, 20.0], requested),
    ):  # fmt: skip
        text += f'[[pose]]\nname = "{name}"\nposition_mm = {at}\nquaternion_xyzw = {turn.as_quat().tolist()}\n'
    text += f'[[path]]\nname = "turning"\n{line}{first}end_quaternion_xyzw = {end.as_quat().tolist()}\n'
    text += f'[[path]]\nname = "one"\n{line}{first}[[path]]\nname = "none"\n{line}'
    (tmp_path / "program.toml").write_text(text)
    rig = read_rig(RIG)
    zone = scan_zone(rig, None, x=axis(-100, 100, 100), y=axis(-100, 100, 100), z=axis(-100, 100, 100), rotations=tilts(0, 1))
    parts = {p.name: p for p in guard(rig, None, zone, read_program(tmp_path / "program.toml"), rotation=requested, step_mm=9.0)}

    def figures(name: str, at: int = 0) -> list[float]:
        return [float(parts[name].angle_deg[at]), float(parts[name].u95_mm[at])]

    assert len(parts["path turning"].points) == 12 + 1
    np.testing.assert_array_equal(parts["path turning"].points[6], [0.0, 20.0, 20.0])
    for place, pose in ((0, "begin"), (6, "middle"), (-1, "end")):
        assert figures("path turning", place) == pytest.approx(figures(f"pose {pose}"), rel=1e-12)
    assert figures("path one", -1) == pytest.approx(figures("pose kept"), rel=1e-12)
    assert figures("path none", -1) == pytest.approx(figures("pose asked"), rel=1e-12)
    # and these differ
    assert len({round(figures(f"pose {name}")[0], 3) for name in ("end", "kept", "asked")}) == 3


def test_points_of_a_path_close_and_keep_their_step(tmp_path: Path) -> None:
    (tmp_path / "program.toml").write_text(PROGRAM)
    out, circle, square = read_program(tmp_path / "program.toml").path
    for path in (out, circle, square):
        points = path.points(7.0)
        assert np.linalg.norm(np.diff(points, axis=0), axis=1).max() <= 7.0 + 1e-9
    points = circle.points(5.0)
    np.testing.assert_allclose(np.linalg.norm(points - [0, 0, 50], axis=1), 100.0)
    np.testing.assert_allclose(points[0], points[-1], atol=1e-9)
    np.testing.assert_allclose(square.points(5.0)[0], square.points(5.0)[-1])
