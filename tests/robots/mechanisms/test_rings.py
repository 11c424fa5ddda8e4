"""Rotopod and four-chain mechanism: worked examples of source 002 with their misprints named, laws, workspaces, singular types."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from lmeasure.core import GeometryError, se3
from lmeasure.robots.parallel.mechanisms import legs
from lmeasure.robots.parallel.mechanisms.four_chains import FourChains
from lmeasure.robots.parallel.mechanisms.jacobians import Singular, singular
from lmeasure.robots.parallel.mechanisms.ring_limits import RingLimits, gaps
from lmeasure.robots.parallel.mechanisms.rotopod import Rotopod

PARAMETER, CUT, RING, ROD = 1024.0, 87.0, 1019.8, 980.0
"""r is 1.024: the printed derivative has 0.0435 sqrt(3) - 1.024; the joint circle then is the stated 0.95."""
FREE = RingLimits(0.0, np.pi, np.pi, np.pi, 0.0)


def rotopod(rod: float = ROD, parameter: float = PARAMETER) -> Rotopod:
    return Rotopod.of_triangle(parameter, CUT, RING, rod)


def at(x: float, y: float, z: float, yaw: float = 0.0) -> np.ndarray:
    return se3.pose([x, y, z], Rotation.from_rotvec([0.0, 0.0, yaw]))


def vehicle(arms: np.ndarray | None = None) -> FourChains:
    """Of chapter 4.2 [mm]: radial chains at (1, 2) and (-1, 2), rods at (-1, -2) and (1, -2). Their length is hypot(sqrt(8) - 2, 0.172):
    the stated 1 gives other angles."""
    points = np.array([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [-1.0, -2.0, 0.0], [1.0, -2.0, 0.0]])
    return FourChains(1000.0 * points, 3000.0, 1000.0 * float(np.hypot(np.sqrt(8.0) - 2.0, 0.172)), arms)


def cabin() -> FourChains:
    """Of chapter 3.2 [mm]."""
    side = 672.0
    points = np.array([[-side, side, 0.0], [-side, -side, 0.0], [side, -side, 0.0], [side, side, 0.0]])
    return FourChains(points, 1019.8, 1000.0, slide=(950.0, 1050.0))


def test_hinges_of_the_rotopod() -> None:
    s = np.sin(np.pi / 3.0)
    r, c = PARAMETER, CUT
    first = [[r - c * s, -c / 2], [r - c * s, c / 2], [-r / 2 + c * s, r * s - c / 2], [-r / 2, r * s - c]]
    np.testing.assert_allclose(rotopod().points[:4, :2], first, atol=1e-9)
    assert np.linalg.norm(rotopod().points[0]) / 1000.0 == pytest.approx(0.95, abs=5e-4)


def test_the_worked_example_of_the_rotopod() -> None:
    mechanism, pose = rotopod(), at(0, 0, 700)
    q = mechanism.inverse(pose)
    np.testing.assert_allclose(q, [5.53, 0.754, 1.341, 2.848, 3.435, 4.942], atol=7e-4)
    found = legs.jacobians(mechanism, pose, q)
    # the source's rows are of |A - C|^2 - L^2, by metres
    rows = 2.0 * ROD * found.output / ([1e6] * 3 + [1e3] * 3)
    printed = np.array(
        [
            [-0.061, -1.328, 1.259, 0.409, 1.308, 1.4],
            [0.061, -1.328, -1.260, 0.411, -1.309, 1.4],
            [1.181, -0.611, 1.863, -2.360, 0.290, 1.4],
            [1.120, 0.717, 0.674, -1.489, 1.009, 1.4],
            [-1.120, 0.717, 1.864, 0.928, -2.190, 1.4],
            [-1.181, -0.611, -1.0, -1.338, 0.299, 1.4],
        ]
    )
    wrong = np.argwhere(np.abs(rows - printed) > 2e-3) + 1
    assert wrong.tolist() == [[3, 2], [3, 3], [3, 4], [3, 5], [4, 3], [4, 4], [5, 3], [5, 5], [6, 2], [6, 3]]
    corrected = {(3, 2): 0.6113, (3, 3): 1.2596, (3, 4): -1.3387, (3, 5): -0.2992, (4, 3): -1.2596, (4, 4): 0.9284, (5, 3): 1.2596}
    for (i, j), value in (corrected | {(5, 5): -1.0098, (6, 2): 0.6113, (6, 3): -1.2596}).items():
        assert rows[i - 1, j - 1] == pytest.approx(value, abs=6e-5)
    np.testing.assert_allclose(np.diag(2.0 * ROD * found.drives / 1e6), 1.2596 * np.array([-1, 1, -1, 1, -1, 1]), atol=5e-5)
    assert np.linalg.det(rows) == pytest.approx(-296.1035, abs=5e-4)
    np.testing.assert_allclose(found.output_rates(np.full(6, 0.1)), [0, 0, 0.1, 0, 0, 0], atol=1e-12)
    # with the matrices as printed first the same solve gives something else
    slipped = np.linalg.solve(printed, -np.array([-1.259, 1.260, -1.863, -1.478, -1.864, 1.259]) * 0.1)
    np.testing.assert_allclose(slipped, [0.031, 0.035, 0.089, 0.016, 0.012, 0.029], atol=6e-4)


def test_the_worked_example_of_four_chains() -> None:
    mechanism, pose = vehicle(), at(0, 0, 172)
    q = mechanism.inverse(pose)
    np.testing.assert_allclose(q[:4], [1.107, 2.034, 4.373, 5.052], atol=6e-4)
    np.testing.assert_allclose(q[4:] / 1000.0, 0.783, atol=5e-4)
    found = mechanism.jacobians(pose, q)
    # the source: |A - C|^2 - l^2, and A_x / cos q - A_y / sin q of the radial chains, last
    scale = np.array([*(-1000.0 / (np.sin(q[:2]) * np.cos(q[:2])) / 1000.0), *(2.0 * q[4:] / 1000.0), *[2.0 * mechanism.rod / 1000.0] * 2])
    rows = (scale[:, None] * found.output * ([1e-3] * 3 + [1.0] * 3))[[2, 3, 4, 5, 0, 1]]
    right = [
        [0.688, -0.344, 0, -0.6833, -1.3666, 0.344],
        [0.688, 0.344, 0, 0.6833, -1.3666, 0.344],
        [-0.688, 0.344, -1.6569, 0, 1.6569, 0.344],
        [-0.688, -0.344, 1.6569, 0, 1.6569, 0.344],
        [0, 0, -5.5902, 2.2361, -1.1180, 0],
        [0, 0, 5.5902, -2.2361, -1.1180, 0],
    ]
    np.testing.assert_allclose(rows, right, atol=6e-5)
    assert abs(np.linalg.det(rows)) == pytest.approx(10.9587, abs=5e-4)
    drives = (scale[:, None] * found.drives)[[2, 3, 4, 5, 0, 1]] * ([1e-3] * 4 + [1.0] * 2)
    np.testing.assert_allclose([drives[0, 4], drives[1, 5]], -1.5661, atol=6e-5)
    np.testing.assert_allclose(np.abs([drives[2, 2], drives[3, 3]]), 1.6569, atol=6e-5)
    np.testing.assert_allclose(np.abs([drives[4, 0], drives[5, 1]]), 5.5902, atol=6e-5)
    # carriages alone: the order of the printed right side is not that of the printed diagonal
    np.testing.assert_allclose(found.output_rates(np.array([0.1] * 4 + [0.0] * 2)), [0, 0, 0.1, 0, 0, 0], atol=1e-12)


def _screws(*axes: tuple[tuple[float, ...], tuple[float, ...] | None]) -> np.ndarray:
    """Rows (axis; moment) of hinges (axis, a point of it) and slides (direction, None)."""
    return np.array([[*a, *np.cross(p, a)] if p is not None else [0, 0, 0, *a] for a, p in axes])


def test_screws_of_chains() -> None:
    """Chapter 5.1: the chain with two ball joints is singular where both lie in a plane with the axis; the others are not."""
    x, y, z = (1, 0, 0), (0, 1, 0), (0, 0, 1)
    o, b = (0, 0, 0), (1, 0, 0)
    for a, value in (((0.5, 0, 1), 0.0), ((0.5, 0.2, 1), -0.2)):
        assert np.linalg.det(_screws((z, o), (x, b), (y, b), (z, b), (x, a), (y, a))) == pytest.approx(value, abs=1e-12)
    a = (0.5, 0, 1)
    middle = np.array([0, 1, 0, 0, 0, 0.5])  # an axis over (0.5, 0, 0), as printed
    two_hinges = np.vstack([_screws((z, o), (y, b)), middle, _screws((x, a), (y, a), (z, a))])
    assert np.linalg.det(two_hinges) == pytest.approx(-0.25)
    assert np.linalg.det(_screws((z, o), (y, b), ((-0.5, 0, 1), None), (x, a), (y, a), (z, a))) == pytest.approx(0.625)


def test_the_wrenches_of_the_platform() -> None:
    """Chapter 5.1, A at z = 1, plain chains parallel to Y: printed -3.945 rests on a sign in row 4; the determinant is -8.0649."""
    mechanism = FourChains(vehicle().points, 3000.0, 1000.0 * float(np.hypot(np.sqrt(8.0) - 2.0, 1.0)))
    pose = at(0, 0, 1000)
    output = mechanism.jacobians(pose, mechanism.inverse(pose)).output
    force = output[:, 3:]
    moment = output[:, :3] / 1e3 + np.cross([0, 0, 1.0], force)
    right = np.hstack([force, moment])[[4, 5, 2, 0, 3, 1]]
    right[3:6:2] *= -1.0  # forces along the guide, towards the other end
    assert abs(np.linalg.det(right)) == pytest.approx(8.0649, abs=5e-5)
    exact = [0.0, 0.6380, 0.7701, -2.1781, 0.7701, -0.6380]
    np.testing.assert_allclose(right[0], exact, atol=6e-5)
    printed = np.array(
        [
            [0, 0.638, 0.77, -2.178, 0.77, -0.638],
            [0, 0.638, 0.77, -2.178, -0.77, 0.638],
            [-0.272, -0.542, 0.794, 2.13, -1.066, 0.003],
            [0.894, -0.447, 0, 0.447, 0.894, 2.235],
            [0.272, -0.542, 0.794, 2.13, 1.066, -0.002],
            [0.894, 0.447, 0, -0.447, 0.894, -2.235],
        ]
    )
    assert np.linalg.det(printed) == pytest.approx(-3.945, abs=6e-4)
    assert np.argwhere(np.abs(np.abs(right) - np.abs(printed)) > 4e-3).size == 0
    printed[3, 5] *= -1.0
    assert np.linalg.det(printed) == pytest.approx(-8.0649, abs=0.03)  # of three digits


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_inverse_forward_inverse_of_the_rotopod(seed: int) -> None:
    rng, mechanism = np.random.default_rng(seed), rotopod()
    true = se3.displaced(at(0, 0, 800, rng.uniform(-3, 3)), rng.uniform(-1, 1, 6) * [0.1, 0.1, 0.1, 60, 60, 60])
    q = mechanism.inverse(true)
    start = se3.displaced(true, rng.normal(size=6) * [0.02, 0.02, 0.02, 10.0, 10.0, 10.0])
    again = legs.forward(mechanism, q[None], start)
    assert again.found.all()
    assert np.abs(se3.displacement(again.poses[0], true)).max() < 1e-9
    np.testing.assert_allclose(mechanism.inverse(again.poses[0]), q, atol=1e-11)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_inverse_forward_inverse_of_four_chains(seed: int, hinged: bool) -> None:
    rng, mechanism = np.random.default_rng(seed), vehicle(np.array([600.0, 700.0]) if hinged else None)
    true = se3.displaced(at(0, 0, 180), rng.uniform(-1, 1, 6) * [0.02, 0.02, 0.05, 20, 20, 20])
    q = mechanism.inverse(true)
    assert np.isfinite(q).all()
    start = se3.displaced(true, rng.normal(size=6) * [0.003, 0.003, 0.003, 3.0, 3.0, 3.0])
    again = mechanism.forward(q[None], start)
    assert again.found.all()
    assert np.abs(se3.displacement(again.poses[0], true)).max() < 1e-8
    np.testing.assert_allclose(mechanism.inverse(again.poses[0]), q, atol=1e-8)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6), st.booleans())
def test_jacobians_of_four_chains_are_differences(seed: int, hinged: bool) -> None:
    rng, mechanism = np.random.default_rng(seed), vehicle(np.array([600.0, 700.0]) if hinged else None)
    pose = se3.displaced(at(0, 0, 180), rng.uniform(-1, 1, 6) * [0.02, 0.02, 0.05, 20, 20, 20])
    q = mechanism.inverse(pose) + rng.normal(size=6) * ([0.01] * 4 + ([0.01] * 2 if hinged else [5.0] * 2))
    found = mechanism.jacobians(pose, q)
    for k in range(6):
        h = np.eye(6)[k] * (1e-6 if k < 3 else 1e-3)
        difference = (mechanism.residuals(se3.displaced(pose, h), q) - mechanism.residuals(se3.displaced(pose, -h), q)) / (2 * h[k])
        np.testing.assert_allclose(found.output[:, k], difference, rtol=1e-7, atol=1e-3)
        h = np.eye(6)[k] * (1e-6 if k < 4 or hinged else 1e-3)
        difference = (mechanism.residuals(pose, q + h) - mechanism.residuals(pose, q - h)) / (2 * h[k])
        np.testing.assert_allclose(found.drives[:, k], difference, rtol=1e-7, atol=1e-3)


def test_gaps_of_carriages() -> None:
    """By atan2: 80 and 100 degrees are two, and carriages that have passed each other are negative."""
    np.testing.assert_allclose(np.degrees(gaps(np.radians([0.0, 80.0, 180.0, 300.0]))), [80, 100, 120, 60])
    np.testing.assert_allclose(np.degrees(gaps(np.radians([10.0, 350.0, 180.0]))), [-20, -170, -170])


def _range(inside: np.ndarray, values: np.ndarray) -> list[float]:
    return [float(values[inside].min()), float(values[inside].max())]


@pytest.mark.parametrize(
    ("rod", "parameter", "heights"),
    [(980, 1024, [962.0, 975.5]), (1000, 1024, [982.0, 995.5]), (980, 950, [962.0, 967.5]), (1000, 950, [982.0, 988.0])],
)
def test_heights_of_the_rotopod_over_the_centre(rod: float, parameter: float, heights: list[float]) -> None:
    """Angles to the normal: read as the printed elevation, no pose is left at all."""
    mechanism, z = rotopod(rod, parameter), np.arange(400.0, 1000.0, 0.5)
    poses = np.column_stack([0 * z, 0 * z, z, np.tile([0, 0, 0, 1.0], (len(z), 1))])
    assert _range(mechanism.checks(poses, RingLimits(singular=0.0)).all, z) == pytest.approx(heights, abs=1e-6)
    if (rod, parameter) == (980, 1024):
        only_gaps = RingLimits(base_cone=np.pi, platform_cone=np.pi, singular=0.0)
        assert _range(mechanism.checks(poses, only_gaps).all, z) == pytest.approx([477.5, 975.5], abs=1e-6)
        assert not mechanism.checks(at(0, 0, 700)[None], RingLimits()).base_cone[0]
        elevation = np.degrees(np.arcsin(np.minimum(z / rod, 1.0)))
        assert not (mechanism.checks(poses, only_gaps).all & (elevation <= 11.0)).any()


@pytest.mark.parametrize(("z", "x", "y"), [(962.0, [-110, 169], 129), (965.0, [-93, 151], 109)])
def test_slices_of_the_rotopod(z: float, x: list[float], y: float) -> None:
    line = np.arange(-250.0, 250.0, 0.5)
    for axis, expected in ((0, x), (1, [-y, y])):
        poses = np.tile(at(0, 0, z), (len(line), 1))
        poses[:, axis] = line
        inside = rotopod().checks(poses, RingLimits(singular=0.0)).all
        assert _range(inside, line) == pytest.approx(expected, abs=1.0)


def test_symmetry_of_the_workspace() -> None:
    """At fixed yaw three-fold; turned about the vertical together with its yaw, any pose keeps what it keeps: a body of revolution."""
    rng, mechanism = np.random.default_rng(4), rotopod()
    poses = np.concatenate([rng.uniform([-160, -160, 955], [160, 160, 976], (400, 3)), np.tile([0, 0, 0, 1.0], (400, 1))], axis=1)
    inside = mechanism.checks(poses, RingLimits()).all
    assert 0 < inside.sum() < 400
    third = poses.copy()
    third[:, :3] = Rotation.from_rotvec([0, 0, 2 * np.pi / 3]).apply(poses[:, :3])
    np.testing.assert_array_equal(mechanism.checks(third, RingLimits()).all, inside)
    other = poses.copy()
    other[:, :3] = Rotation.from_rotvec([0, 0, 0.5]).apply(poses[:, :3])
    assert (mechanism.checks(other, RingLimits()).all != inside).any()
    turned = se3.compose(np.broadcast_to(at(0, 0, 0, 0.5), poses.shape), poses)
    np.testing.assert_array_equal(mechanism.checks(turned, RingLimits()).all, inside)


def test_singular_types_where_the_source_puts_them() -> None:
    """Rods in the plane of guide's axis: a dead point of that carriage. Rods that meet the axis all: the platform turns by itself."""
    mechanism, pose = rotopod(), at(0, 0, 700)
    q = mechanism.inverse(pose)
    assert singular(legs.jacobians(mechanism, pose, q), mechanism.units) == Singular.NO
    radial = np.arctan2(mechanism.points[:, 1], mechanism.points[:, 0])
    height = float(np.sqrt(ROD**2 - (RING - np.linalg.norm(mechanism.points[0])) ** 2))
    both = singular(legs.jacobians(mechanism, at(0, 0, height), radial), mechanism.units)
    assert both & Singular.OUTPUT
    assert np.abs(np.diag(legs.jacobians(mechanism, at(0, 0, height), radial).drives)).max() < 1e-9
    one = legs.jacobians(mechanism, at(0, 0, height), np.array([radial[0], *q[1:]]))
    assert singular(one, mechanism.units) & Singular.DRIVES
    # plain chains in planes with the axis too: nothing holds the turn about it
    four, high = vehicle(), at(0, 0, 172)
    drives = four.inverse(high)
    assert singular(four.jacobians(high, drives), four.units) == Singular.NO
    drives[2:4] = np.arctan2(four.points[2:, 1], four.points[2:, 0])
    assert singular(four.jacobians(high, drives), four.units) & Singular.DRIVES


def test_other_assemblies_of_the_same_drives() -> None:
    mechanism, pose = rotopod(), se3.displaced(at(20, -10, 800), [0.02, 0.03, 0, 0, 0, 0])
    q = mechanism.inverse(pose)
    found = legs.assemblies(mechanism, q)
    assert found.certified.all()
    assert len(found.poses) >= 2
    assert np.abs(legs.residuals(mechanism, found.poses, np.broadcast_to(q, (len(found.poses), 6)))).max() < 1e-7
    four, low = vehicle(), at(10, 5, 175)
    drives = four.inverse(low)
    poses = four.assemblies(drives)
    assert len(poses) >= 2  # its mirror image below the guide at least
    assert np.abs(four.residuals(poses, np.broadcast_to(drives, (len(poses), 6)))).max() < 1e-6
    for one in (low, at(10, 5, -175)):
        assert np.abs(se3.displacement(poses, np.broadcast_to(one, poses.shape))).max(axis=1).min() < 1e-6


def test_the_workspace_of_four_chains() -> None:
    """Section 3.2, whose figure has no numbers: computed here over the centre from its rules one by one."""
    z = np.arange(900.0, 1010.0, 0.1)
    poses = np.column_stack([0 * z, 0 * z, z, np.tile([0, 0, 0, 1.0], (len(z), 1))])
    found = cabin().checks(poses, RingLimits(singular=0.0))
    far = np.hypot(672.0, 672.0)
    slid = np.hypot(1019.8 - far, z)
    rho = np.sqrt(np.maximum(1000.0**2 - z**2, 0.0))
    with np.errstate(invalid="ignore"):
        turn = np.degrees(np.arccos((1019.8**2 + far**2 - rho**2) / (2 * 1019.8 * far)))
    expected = (
        (slid >= 950) & (slid <= 1050) & (turn <= 30.0) & (90 - 2 * turn >= 12) & (z >= 1000 * np.cos(np.radians(11))) & np.isfinite(turn)
    )
    np.testing.assert_array_equal(found.all, expected)
    assert _range(found.all, z) == pytest.approx([981.7, 997.5], abs=0.11)


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(GeometryError, match="rod is 0 mm"):
        rotopod(rod=0.0)
    with pytest.raises(GeometryError, match="arms is -1 mm"):
        vehicle(np.array([-1.0, 5.0]))
    assert np.isnan(rotopod().inverse(at(0, 0, 990))).all()
    assert not rotopod().checks(at(0, 0, 990)[None], FREE).reached[0]
