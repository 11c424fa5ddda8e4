"""Numbers of the documents, each by its section in the sources, slips named: the mechanisms of robot.toml with the dimensions in print."""

from itertools import permutations, product

import numpy as np
import pytest
from mechanism_tables import TABLE_1, TABLE_2, TABLE_3, TABLE_4, crank_platform, hexapod, pose_of, poses, rotopod, vehicle
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robots import ParallelFile, checked, described
from lmeasure.robots.model import Limits
from lmeasure.robots.parallel import dyads
from lmeasure.robots.parallel.legs import SevenLink
from lmeasure.robots.parallel.limits import own_roots
from lmeasure.robots.parallel.model import Jacobians, Parallel, Singular, singular

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])
CORRECTED = Limits(least_gap_deg=12.0, most_gap_deg=120.0, base_cone_deg=11.0, platform_cone_deg=22.0, mass_mm=(0.0, 0.0, 0.0))


def at_home(robot: Parallel) -> tuple[np.ndarray, Jacobians]:
    """Drives and both Jacobians at home, of one pose."""
    drives = own_roots(robot, robot.home[None])
    found = robot.jacobians(robot.home[None], drives)
    return drives[0], Jacobians(found.output[0], found.drives[0])


def test_vectors_of_the_hooke_joints() -> None:
    """Thesis 5.8, of B (-0.1475, -0.49, 0.793): axes along the leg and of both crosses, turned by 20 degrees about Z; E5 has the other sign
    in print, with which its arccos would be 163.4 degrees."""
    low, high, turn = np.array([-0.46, -0.421, 0.0]), np.array([-0.1475, -0.49, 0.793]), Rotation.from_rotvec([0, 0, np.radians(20.0)])
    a, b = 0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high
    assert high[0] - low[0] == pytest.approx(0.312, abs=6e-4)
    e2 = -np.array([b[0], b[1], 0.0])
    assert np.cross(b - a, e2)[2] == pytest.approx(0.131, abs=6e-4)
    np.testing.assert_allclose(turn.apply(high), [0.0285, -0.511, 0.793], atol=6e-4)
    upper = turn.apply(b)
    np.testing.assert_allclose(upper, [-0.0027, -0.515, 0.714], atol=6e-4)
    e4, e6 = upper - a, -np.array([upper[0], upper[1], 0.0])
    np.testing.assert_allclose(e4, [0.426, -0.087, 0.634], atol=6e-4)
    e3, e5 = np.cross(e4, e2), np.cross(e4, e6)
    np.testing.assert_allclose(e3, [-0.307, 0.113, 0.221], atol=1e-3)
    np.testing.assert_allclose(e5, [-0.327, 0.0017, 0.22], atol=1e-3)
    assert np.degrees(np.arctan2(np.linalg.norm(np.cross(e3, e5)), e3 @ e5)) == pytest.approx(16.555, abs=0.01)
    assert np.degrees(np.arccos(-e3 @ e5 / np.linalg.norm(e3) / np.linalg.norm(e5))) == pytest.approx(163.4, abs=0.2)


@pytest.mark.parametrize(("x", "degrees"), [(-147.0, 16.5488), (-148.0, 16.5567), (-147.5, 16.5528)])
def test_the_worked_leg(x: float, degrees: float) -> None:
    """Thesis 5.8: a leg turns about itself as the platform turns by 20 degrees."""
    file, turned = hexapod(x), se3.pose(np.zeros(3), Rotation.from_rotvec([0.0, 0.0, np.radians(20.0)]))
    assert list(described(file, file.model.home)["leg_turns_deg"].values()) == pytest.approx([0.0] * 6, abs=1e-9)
    found = described(file, turned)["leg_turns_deg"]["leg_1"]
    assert abs(found) == pytest.approx(degrees, abs=6e-5)
    # bringing the lower second axis round the leg by the turn gives the upper one
    leg = file.model.legs[0]
    e = se3.apply(turned, leg.point) - leg.values[:3]
    e /= np.linalg.norm(e)
    cross = np.array(file.to_dict()["leg"][0]["base_axis"])
    low, high = np.cross(e, cross), np.cross(e, se3.rotation(turned).apply(cross))
    brought = Rotation.from_rotvec(np.radians(found) * e).apply(low)
    assert np.abs(np.cross(brought, high)).max() < 1e-9
    assert brought @ high > 0.0


def test_a_hexapod_is_singular_a_quarter_from_where_its_pairs_are_opposite() -> None:
    """Turned by a quarter about its axis the six legs touch one hyperboloid (Fichter's pose): for plates of equal pairs."""
    robot = hexapod().model
    angle = np.linspace(-3.1, 3.1, 3000)
    at = np.concatenate([np.zeros((3000, 3)), Rotation.from_rotvec(np.outer(angle, [0, 0, 1.0])).as_quat()], axis=1)
    drives = np.concatenate([root[:, 0] for root in robot.roots(at)], axis=1)
    det = np.linalg.det(robot.jacobians(at, drives).output)
    zeros = angle[:-1][det[1:] * det[:-1] < 0.0]
    pairs = [np.sum([leg.values[:2] for leg in robot.legs[:2]], axis=0), np.sum([leg.point[:2] for leg in robot.legs[:2]], axis=0)]
    opposite = np.subtract(*(np.arctan2(pair[1], pair[0]) for pair in pairs))
    assert len(zeros) == 2
    np.testing.assert_allclose([abs(np.angle(np.exp(1j * (z - opposite)))) for z in zeros], np.pi / 2.0, atol=3e-3)


def test_the_rotopod_to_all_digits() -> None:
    """002, 4.1: carriages, the whole matrix, its condition and determinant; ten entries of A and three of B are misprinted; the text's rule
    of elbows is the reverse, and r = 0.95 gives q1 = 5.508."""
    robot = rotopod().model
    q, found = at_home(robot)
    np.testing.assert_allclose(np.mod(q, 2.0 * np.pi), [5.5294, 0.7538, 1.3406, 2.8482, 3.4350, 4.9426], atol=6e-5)
    # the derivative printed in metres has 0.0435 sqrt(3) - 1.024, and the hinge's x by z is 0.9487
    first = robot.legs[0].point / 1000.0
    assert first[0] == pytest.approx(1.024 - 0.0435 * np.sqrt(3.0), abs=1e-12)
    assert first[0] == pytest.approx(1.328 / 1.4, abs=1e-4)
    assert np.linalg.norm(first) == pytest.approx(0.95, abs=5e-4)
    other = rotopod(corner=950.0).model
    assert other.legs[0].point[0] == pytest.approx(874.6, abs=0.1)
    assert np.mod(at_home(other)[0][0], 2.0 * np.pi) == pytest.approx(5.5081, abs=1e-4)
    # the source's rows are of |A - C|^2 - L^2, by metres
    rows = 2.0 * 980.0 * found.output / ([1e6] * 3 + [1e3] * 3)
    exact = [
        [-0.0609, -1.3281, 1.2596, 0.4103, 1.3089, 1.4],
        [0.0609, -1.3281, -1.2596, 0.4103, -1.3089, 1.4],
        [1.1806, 0.6113, 1.2596, -1.3387, -0.2992, 1.4],
        [1.1197, 0.7168, -1.2596, 0.9284, 1.0098, 1.4],
        [-1.1197, 0.7168, 1.2596, 0.9284, -1.0098, 1.4],
        [-1.1806, 0.6113, -1.2596, -1.3387, 0.2992, 1.4],
    ]
    np.testing.assert_allclose(rows, exact, atol=6e-5)
    printed = np.array(
        [
            [-0.061, -1.328, 1.259, 0.409, 1.308, 1.4], [0.061, -1.328, -1.260, 0.411, -1.309, 1.4],
            [1.181, -0.611, 1.863, -2.360, 0.290, 1.4], [1.120, 0.717, 0.674, -1.489, 1.009, 1.4],
            [-1.120, 0.717, 1.864, 0.928, -2.190, 1.4], [-1.181, -0.611, -1.0, -1.338, 0.299, 1.4],
        ]
    )  # fmt: skip
    wrong = np.argwhere(np.abs(rows - printed) > 2e-3) + 1
    assert wrong.tolist() == [[3, 2], [3, 3], [3, 4], [3, 5], [4, 3], [4, 4], [5, 3], [5, 5], [6, 2], [6, 3]]
    assert np.linalg.cond(rows) == pytest.approx(1.70, abs=5e-3)
    assert np.linalg.det(rows) == pytest.approx(-296.1035, abs=5e-4)
    drives, first_printed = np.diag(2.0 * 980.0 * found.drives / 1e6), np.array([-1.259, 1.260, -1.863, -1.478, -1.864, 1.259])
    np.testing.assert_allclose(drives, 1.2596 * np.array([-1, 1, -1, 1, -1, 1]), atol=5e-5)
    assert (np.flatnonzero(np.abs(drives - first_printed) > 2e-3) + 1).tolist() == [3, 4, 5]
    np.testing.assert_allclose(np.linalg.solve(found.output, -found.drives @ np.full(6, 0.1)), [0, 0, 0.1, 0, 0, 0], atol=1e-12)
    # with the matrices as printed first the same solve gives something else
    slipped = np.linalg.solve(printed, -first_printed * 0.1)
    np.testing.assert_allclose(slipped, [0.031, 0.035, 0.089, 0.016, 0.012, 0.029], atol=6e-4)


def test_the_four_chains_to_all_digits() -> None:
    """002, 4.2: the plain rods are 0.8461 long (1 is stated); one entry of A; the printed right side in the printed diagonal's order."""
    robot = vehicle().model
    q, found = at_home(robot)
    rod = robot.legs[2].values[3]
    assert rod == pytest.approx(846.1, abs=0.05)
    np.testing.assert_allclose(np.mod(q[[0, 2, 4, 5]], 2.0 * np.pi), [1.1071, 2.0344, 4.3726, 5.0522], atol=6e-5)
    np.testing.assert_allclose(q[[1, 3]], 783.1, atol=0.06)
    # carriages straight beyond their hinges
    beyond = 3.0 * np.column_stack([np.cos(q[4:]), np.sin(q[4:])])
    np.testing.assert_allclose(beyond, [[-1.0, -np.sqrt(8.0)], [1.0, -np.sqrt(8.0)]], atol=1e-9)
    # the source: |A - C|^2 - l^2, and A_x / cos q - A_y / sin q of the radial chains, last, which fails at every quarter
    order, drives = [0, 2, 4, 5, 1, 3], [1, 3, 4, 5, 0, 2]
    scale = np.array([*(2e-3 * q[[1, 3]]), *[2e-3 * rod] * 2, *(-1.0 / (np.sin(q[[0, 2]]) * np.cos(q[[0, 2]])))])
    rows = scale[:, None] * found.output[order] * ([1e-3] * 3 + [1.0] * 3)
    right = [
        [0.688, -0.344, 0, -0.6833, -1.3666, 0.344], [0.688, 0.344, 0, 0.6833, -1.3666, 0.344],
        [-0.688, 0.344, -1.6569, 0, 1.6569, 0.344], [-0.688, -0.344, 1.6569, 0, 1.6569, 0.344], [0, 0, -5.5902, 2.2361, -1.1180, 0],
        [0, 0, 5.5902, -2.2361, -1.1180, 0],
    ]  # fmt: skip
    np.testing.assert_allclose(rows, right, atol=6e-5)  # the second of the first is printed -0.688
    assert abs(np.linalg.det(rows)) == pytest.approx(10.9587, abs=5e-4)
    by = (scale[:, None] * found.drives[order])[np.arange(6), drives] * [1.0, 1.0, *[1e-3] * 4]
    np.testing.assert_allclose(np.abs(by), [1.5661, 1.5661, 1.6569, 1.6569, 5.5902, 5.5902], atol=6e-5)
    # of rods: 2 R times what is printed without R
    np.testing.assert_allclose(np.abs(by[2:4]) / 3.0, 0.5523, atol=6e-5)

    def rates(given: list[float]) -> np.ndarray:
        return np.linalg.solve(rows, -by * given)

    np.testing.assert_allclose(rates([0.0, 0.0, 0.1, 0.1, 0.1, 0.1]), [0, 0, 0.1, 0, 0, 0], atol=1e-12)
    assert np.abs(rates([0.1, 0.1, 0.1, 0.1, 0.0, 0.0]) - [0, 0, 0.1, 0, 0, 0]).max() > 0.05


def test_the_wrenches_of_chapter_5_to_all_digits() -> None:
    """002, 5.1, A at z = 1: all rows; lengths of chains 1 and 3; moments are those of unit vectors; a sign of row four makes -3.945 of
    -8.0649."""
    robot = vehicle(1000.0).model
    drives, found = at_home(robot)
    assert robot.legs[2].values[3] / 1e3 == pytest.approx(1.2986, abs=6e-5)
    assert drives[1] / 1e3 == pytest.approx(1.2584, abs=6e-5)  # printed 1.259
    force = found.output[:, 3:]
    right = np.hstack([force, found.output[:, :3] / 1e3 + np.cross([0, 0, 1.0], force)])
    exact = np.array(
        [
            [0.0, 0.6380, 0.7701, -2.1781, 0.7701, -0.6380],
            [0.0, 0.6380, 0.7701, -2.1781, -0.7701, 0.6380],
            [-0.2715, -0.5430, 0.7947, 2.1323, -1.0661, 0.0],
            [0.8944, -0.4472, 0.0, 0.4472, 0.8944, -2.2361],
            [0.2715, -0.5430, 0.7947, 2.1323, 1.0661, 0.0],
            [0.8944, 0.4472, 0.0, -0.4472, 0.8944, -2.2361],
        ]
    )
    for row in exact:
        # each is one of the mechanism's wrenches, up to which end of the guide it points to
        assert min(np.abs(sign * own - row).max() for own in right for sign in (1.0, -1.0)) < 6e-5
    assert np.linalg.det(exact) == pytest.approx(-8.0649, abs=2e-3)
    printed = [
        [0, 0.638, 0.77, -2.178, 0.77, -0.638], [0, 0.638, 0.77, -2.178, -0.77, 0.638], [-0.272, -0.542, 0.794, 2.13, -1.066, 0.003],
        [0.894, -0.447, 0, 0.447, 0.894, 2.235], [0.272, -0.542, 0.794, 2.13, 1.066, -0.002], [0.894, 0.447, 0, -0.447, 0.894, -2.235],
    ]  # fmt: skip
    assert np.linalg.det(printed) == pytest.approx(-3.945, abs=6e-4)


def test_screws_of_chains() -> None:
    """002, 5.1: the chain with two ball joints is singular where both lie in a plane with the axis; the others are not."""

    def screws(*axes: tuple[tuple[float, ...], tuple[float, ...] | None]) -> np.ndarray:
        """Rows (axis; moment) of hinges (axis, a point of it) and slides (direction, None)."""
        return np.array([[*a, *np.cross(p, a)] if p is not None else [0, 0, 0, *a] for a, p in axes])

    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    o, b = (0, 0, 0), (1, 0, 0)
    for a, value in (((0.5, 0, 1), 0.0), ((0.5, 0.2, 1), -0.2)):
        assert np.linalg.det(screws((z, o), (x, b), (y, b), (z, b), (x, a), (y, a))) == pytest.approx(value, abs=1e-12)
    a = (0.5, 0, 1)
    middle = np.array([0, 1, 0, 0, 0, 0.5])  # an axis over (0.5, 0, 0), as printed
    two_hinges = np.vstack([screws((z, o), (y, b)), middle, screws((x, a), (y, a), (z, a))])
    assert np.linalg.det(two_hinges) == pytest.approx(-0.25)
    assert np.linalg.det(screws((z, o), (y, b), ((-0.5, 0, 1), None), (x, a), (y, a), (z, a))) == pytest.approx(0.625)


def span_inside(file: ParallelFile, limits: Limits, places: np.ndarray, along: np.ndarray) -> list[float]:
    """First and last of the values along a line of places (N, 3), level, that keep the limits."""
    kept = checked(file.model, limits, np.column_stack([places, np.tile(LEVEL, (len(places), 1))])).all
    return [float(along[kept].min()), float(along[kept].max())] if kept.any() else []


@pytest.mark.parametrize(
    ("rod", "corner", "heights"),
    [(980, 1024, [962.0, 975.5]), (1000, 1024, [982.0, 995.5]), (980, 950, [962.0, 967.5]), (1000, 950, [982.0, 988.0])],
)
def test_heights_of_the_rotopod_over_the_centre(rod: float, corner: float, heights: list[float]) -> None:
    """002, 3.1: angles to the normal; read as the printed elevation, no pose is left at all. The least gap is 12 degrees, not 120."""
    file, z = rotopod(rod, corner), np.arange(400.0, 1000.0, 0.5)
    places = np.column_stack([0 * z, 0 * z, z])
    assert span_inside(file, CORRECTED, places, z) == pytest.approx(heights, abs=1e-6)
    gaps = Limits(least_gap_deg=12.0, most_gap_deg=120.0, singular=0.0)
    if (rod, corner) == (980, 1024):
        low, high = span_inside(file, gaps, places, z)
        assert [low, high] == pytest.approx([477.5, 975.5], abs=1e-6)
        assert not checked(file.model, CORRECTED, np.array([[0.0, 0.0, 700.0, *LEVEL]])).base_cone[0]
        assert rod * np.sin(np.radians(11.0)) == pytest.approx(187.0, abs=0.5)


@pytest.mark.parametrize(("z", "x", "y"), [(962.0, [-110, 169], 129), (965.0, [-93, 151], 109)])
def test_slices_of_the_rotopod(z: float, x: list[float], y: float) -> None:
    line = np.arange(-250.0, 250.0, 0.5)
    for axis, expected in ((0, x), (1, [-y, y])):
        places = np.tile([0.0, 0.0, z], (len(line), 1))
        places[:, axis] = line
        assert span_inside(rotopod(), CORRECTED, places, line) == pytest.approx(expected, abs=1.0)


def test_singular_types_where_the_source_puts_them() -> None:
    """002: a rod in the plane of the guide's axis is a dead point of its carriage; with all of them there the platform turns by itself."""
    robot = rotopod().model
    q, found = at_home(robot)
    assert singular(found, robot.units) == Singular.NO
    radial = np.array([np.arctan2(leg.point[1], leg.point[0]) for leg in robot.legs])
    height = float(np.sqrt(980.0**2 - (1019.8 - np.linalg.norm(robot.legs[0].point)) ** 2))
    at = np.array([[0.0, 0.0, height, *LEVEL]])
    every, one = (robot.jacobians(at, drives[None]) for drives in (radial, np.array([radial[0], *q[1:]])))
    assert singular(every, robot.units)[0] & Singular.OUTPUT
    assert np.abs(np.diag(every.drives[0])).max() < 1e-9
    assert singular(one, robot.units)[0] & Singular.DRIVES


def test_the_recomputed_crank_platform() -> None:
    """003: rods and poses of the recomputed fixture, metres there; C3 and b6 are missing in print; the hinges lie on a triangle's sides."""
    robot = crank_platform().model
    np.testing.assert_allclose([leg.values[-1] for leg in robot.legs], [246.119, 279.418] * 3, atol=5e-4)
    drives = np.radians([[10.0, 10.0, 10.0], [10.0, -5.0, 20.0], [-30.0, 30.0, 0.0], [12.0, -17.0, 25.0]])
    found = robot.forward(drives)
    stated = [[0.0, 0.0, 196.373], [4.382, -3.314, 196.564], [-10.676, -1.217, 197.217]]
    np.testing.assert_allclose(found[:3, :3], stated, atol=6e-4)
    np.testing.assert_allclose(own_roots(robot, found), drives, atol=1e-9)
    # virtual points: W = 2 r sin(60 - v/2) + 4 r sin(v/2), K the part of a side between its corner and the hinge
    half, rest = np.sin(np.radians(50.0)), np.sin(np.radians(10.0))
    side, part = 400.0 * rest + 800.0 * half, half / (2.0 * half + rest)
    assert [side, part] == pytest.approx([682.29482, 0.44909879], rel=2e-8)
    corners = side / np.sqrt(3.0) * np.array([[np.cos(a), np.sin(a), 0.0] for a in np.radians([0.0, 120.0, 240.0])])
    w = se3.apply(np.tile(found[1], (3, 1)), corners)
    np.testing.assert_allclose(w[0], [391.024, 71.542, 205.510], atol=6e-4)
    upper = se3.apply(np.tile(found[1], (6, 1)), np.array([leg.point for leg in robot.legs]))
    for own, (near, other) in zip(upper, ((0, 2), (0, 1), (1, 0), (1, 2), (2, 1), (2, 0)), strict=True):
        np.testing.assert_allclose(own, w[near] + part * (w[other] - w[near]), atol=1e-9)
    upper = se3.apply(np.tile(found[3], (6, 1)), np.array([leg.point for leg in robot.legs]))
    third = Rotation.from_rotvec([0, 0, np.radians(240.0)]).apply([300.0, 50.0 * np.sin(drives[3, 2]), 50.0 * np.cos(drives[3, 2])])
    assert np.linalg.norm(upper[4] - third) == pytest.approx(246.119, abs=6e-4)


@pytest.mark.parametrize(("base", "ways", "degrees"), [(20.0, [1.0, 1.0, 1.0], -21.0), (30.0, [1.0, -1.0, 0.0], -18.0)])
def test_crank_platforms_that_do_not_keep_their_root(base: float, ways: list[float], degrees: float) -> None:
    """003: nearly upright rods pass a dead point, rod and crank in line, and the other root takes over: an inverse that keeps its first
    root gives angles that the cranks never had."""
    robot, f = crank_platform(90.0, 300.0, base).model, np.radians(np.arange(0.0, -30.1, -0.25))
    drives = np.outer(f, ways)
    way = robot.forward(drives)
    assert np.isfinite(way).all()
    roots = np.stack([root[..., 0] for root in (robot.roots(way)[i] for i in (0, 2, 4))], axis=1)
    side = np.argmin(np.abs(np.angle(np.exp(1j * (roots - drives[..., None])))), axis=2)
    first = int(np.argmax((side != side[0]).any(axis=1)))
    assert np.degrees(f[first]) == pytest.approx(degrees, abs=0.6)
    assert np.abs(own_roots(robot, way[-1:]) - drives[-1]).max() > 0.1


def test_narrow_pairs_over_each_other_leave_no_pose_at_large_angles() -> None:
    """003."""
    found = crank_platform(20.0, base=30.0).model.forward(np.radians([[5.0, 5.0, 5.0], [-30.0, 30.0, 30.0]]))
    assert np.isfinite(found[:, 0]).tolist() == [True, False]


def test_turns_of_table_3() -> None:
    """004: what table 1 began with is off by these; the turn that fits table 2 best is table 3's; no other order of the axes fits it."""
    off = [0.041, 0.072, 0.089, 0.087, 0.071, 0.044, 0.017, -0.006, -0.018, -0.019]
    np.testing.assert_allclose(TABLE_1[:, 5] - TABLE_3, off, atol=6e-4)

    def turn(phi: np.ndarray, i: int) -> np.ndarray:
        at = pose_of(np.array([*TABLE_1[i, :3], *np.radians(TABLE_1[i, 3:5]), np.radians(phi[0])]))
        return dyads.misses(at[None], TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6])[0]

    best = np.array([least_squares(turn, TABLE_3[i : i + 1], args=(i,), xtol=1e-14, ftol=1e-14).x[0] for i in range(10)])
    assert np.abs(best - TABLE_3).max() < 0.0095
    # the next best order of the axes, signs and angles is off by 0.322 with the turns of table 1, by 0.327 with those of table 3
    for turns, right, next_best in ((TABLE_3, 0.0024, 0.327), (TABLE_1[:, 5], 0.0071, 0.322)):
        spread = spreads(np.column_stack([TABLE_1[:, 3:5], turns]))
        assert len(spread) == 12 * 6 * 8 * 2
        # about the body's axes one after the other, or about the base's from the last to the first: the same turn
        for same in (("ZXZ", (0, 1, 2)), ("zxz", (2, 1, 0))):
            assert spread.pop((*same, (1.0, 1.0, 1.0))) == pytest.approx(right, abs=6e-5)
        assert min(spread.values()) == pytest.approx(next_best, abs=5e-4)


def spreads(angles: np.ndarray) -> dict[tuple[str, tuple[int, ...], tuple[float, ...]], float]:
    """By axes, order and signs of angles (10, 3) [deg]: by how much the lengths that the links of table 2 would need differ, together."""
    out = {}
    for axes, order in product(product("xyz", repeat=3), permutations(range(3))):
        if axes[0] == axes[1] or axes[1] == axes[2]:
            continue
        for signs, name in product(product((1.0, -1.0), repeat=3), ("".join(axes), "".join(axes).upper())):
            at = se3.pose(TABLE_1[:, :3], Rotation.from_euler(name, np.radians(np.array(signs) * angles[:, order])))
            misses = dyads.misses(at, TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6])
            out[name, order, signs] = float(misses.std(axis=0).sum())
    return out


def test_table_4_from_the_turns_of_table_3() -> None:
    """004: with phi held, of table 2 as printed, the other five coordinates come out to 0.0004 to 0.002, but to 0.012 and 0.007 at poses 5
    and 6, where phi stands still along the path: so far as that of pose 6 the path never turns."""
    link = SevenLink(TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6])
    begin = np.column_stack([TABLE_1[:, :3], np.radians(np.column_stack([TABLE_1[:, 3:5], TABLE_3]))])
    off, left = [], []
    for row, stated in zip(begin, TABLE_4, strict=True):

        def lacks(x: np.ndarray, phi: float = float(row[5])) -> np.ndarray:
            return link.residuals(pose_of(np.array([*x, phi])))

        found = least_squares(lacks, row[:5], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        left.append(float(np.abs(found.fun).max()))
        off.append(float(np.linalg.norm(found.x[:3] - stated)))
    assert (np.flatnonzero(np.array(left) > 1e-9) + 1).tolist() == [6]
    others = np.delete(off, [4, 5])
    assert [others.min(), others.max()] == pytest.approx([0.0004, 0.0019], abs=6e-5)
    assert off[4:6] == pytest.approx([0.012, 0.0072], abs=6e-5)


def test_synthesis_again_with_the_turns_of_table_3_and_with_free_ones() -> None:
    """004: largest misses by least squares from table 2, link by link with phi held, all together with phi free."""
    found = dyads.fitted(poses(TABLE_3), TABLE_2[:, :6])
    held = np.abs(dyads.misses(poses(TABLE_3), found[:, :3], found[:, 3:6], found[:, 6])).max(axis=0)
    np.testing.assert_allclose(held, [0.00053, 0.00039, 0.00148, 0.00041, 0.00057], atol=6e-5)

    def all_misses(x: np.ndarray) -> np.ndarray:
        links = x[:35].reshape(5, 7)
        return dyads.misses(poses(x[35:]), links[:, :3], links[:, 3:6], links[:, 6]).ravel()

    begin = np.concatenate([TABLE_2[:, :7].ravel(), TABLE_1[:, 5]])
    free = least_squares(all_misses, begin, x_scale=np.abs(begin) + 0.1, max_nfev=300).fun.reshape(10, 5)
    # in a flat valley, where turns go on to drift by degrees, each link's part is a matter of where one stops: the largest is told
    assert np.abs(free).max() < 0.00044
