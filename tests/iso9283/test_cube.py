"""The test cube: planes that hold their corners, poses a tenth of the diagonal from them."""

import numpy as np
import pytest

from lmeasure.core import CertificationError
from lmeasure.iso9283 import POSES, Cube, Tests, campaign, largest_cube
from lmeasure.iso9283.program.campaign import PLANES


def test_the_poses_of_a_cube_of_1000_mm_by_hand() -> None:
    # diagonal C1-C7 from (500, 500, -500) to (-500, -500, 500): a tenth of it is (-100, -100, 100)
    points = Cube(np.array([10.0, 20.0, 30.0]), 1000.0).points()
    assert points["P1"] == pytest.approx([10, 20, 30])
    assert points["P2"] == pytest.approx([410, 420, -370])
    assert points["P3"] == pytest.approx([-390, 420, 430])
    assert points["P4"] == pytest.approx([-390, -380, 430])
    assert points["P5"] == pytest.approx([410, -380, -370])


@pytest.mark.parametrize("plane", PLANES)
def test_each_plane_holds_its_corners_and_poses_near_them(plane: str) -> None:
    cube = Cube(np.zeros(3), 500.0, plane)
    corners = [cube.corner(int(c[1])) for c in plane.split("-")]
    points = cube.points()
    for at in (*corners, *points.values()):
        assert at @ cube.normal == pytest.approx(0.0, abs=1e-9)
    diagonal = 500.0 * np.sqrt(3.0)
    for name in POSES[1:]:
        assert min(np.linalg.norm(points[name] - c) for c in corners) == pytest.approx(0.1 * diagonal)
        assert np.linalg.norm(points[name]) == pytest.approx(0.4 * diagonal)
    # neighbours in turn: P2 and P4 are opposite each other
    assert points["P2"] == pytest.approx(-points["P4"])
    assert points["P3"] == pytest.approx(-points["P5"])


def test_the_first_speed_and_load_are_those_of_all_other_tests() -> None:
    tests = Tests(tests=("pose", "approach", "stabilisation", "reorientation", "posing"), speeds_percent=(50.0, 100.0), loads_kg=(5.0, 0.0))
    plan = campaign(Cube(np.zeros(3), 300.0), tests)
    for row in (*plan.program.pose, *plan.program.path):
        if " at " not in row.name:
            assert (row.speed_percent, row.load_kg) == (50.0, 5.0)
    speeds = {c.target: c.speed_mm_s for c in plan.commands}
    assert speeds["P1"] == speeds["P1 from three sides"] == speeds["P1 settling"] == 500.0
    assert speeds["P1 at 100 %"] == 1000.0
    assert speeds["line turning about x"] == 250.0
    assert {c.load_kg for c in plan.commands if c.target == "P1 from three sides"} == {5.0}


def test_corners_stand_above_each_other() -> None:
    cube = Cube(np.zeros(3), 2.0)
    for low in range(1, 5):
        assert cube.corner(low + 4) - cube.corner(low) == pytest.approx([0, 0, 2])
        assert np.linalg.norm(cube.corner(low % 4 + 1) - cube.corner(low)) == pytest.approx(2.0)


def test_largest_cube_in_a_box() -> None:
    cube = largest_cube([-100.0, 0.0, 0.0], [100.0, 300.0, 600.0])
    assert cube.edge_mm == 200.0
    assert cube.centre == pytest.approx([0, 150, 300])
    with pytest.raises(CertificationError, match="no volume"):
        largest_cube([0.0, 0.0, 0.0], [1.0, 0.0, 1.0])
    with pytest.raises(CertificationError, match="C1-C2-C3-C4"):
        Cube(np.zeros(3), 1.0, "C1-C2-C3-C4")


def test_the_zone_states_the_same_poses() -> None:
    import xarray as xr

    from lmeasure.accuracy import extent

    axes = {name: np.linspace(-200, 200, 5) for name in "xyz"}
    inside = xr.DataArray(np.ones((5, 5, 5), np.int8), dims=("x", "y", "z"))
    zone = xr.Dataset({"in_zone": inside}, coords=axes, attrs={"node_spacing_mm": [100.0] * 3})
    points = Cube(np.zeros(3), 400.0).points()
    for stated in extent(zone).cube_points:
        assert stated["position_mm"] == pytest.approx(points[stated["name"]])
