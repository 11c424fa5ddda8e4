"""The crank platform: the recomputed fixture of source 003, virtual points against legs, both roots, dead points."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import least_squares

from lmeasure.core import GeometryError, se3
from lmeasure.robots.parallel.mechanisms import legs, virtual_points
from lmeasure.robots.parallel.mechanisms.crank import CrankPlatform
from lmeasure.robots.parallel.mechanisms.jacobians import Singular, singular

UNITS = np.array([1 / 200.0] * 3 + [1.0] * 3)


def fixture() -> CrankPlatform:
    """No dead point within 30 degrees; lengths of the recomputed fixture, metres there."""
    return CrankPlatform.regular(300.0, 200.0, np.radians(20.0), np.radians(100.0), crank_mm=50.0, height_mm=200.0)


def angles(*degrees: float) -> np.ndarray:
    return np.radians(np.array(degrees, dtype=np.float64)).reshape(-1, 3)


def test_the_recomputed_fixture() -> None:
    mechanism = fixture()
    side, part = virtual_points.side_and_part(200.0, np.radians(100.0))
    assert side == pytest.approx(682.29482, abs=6e-6)
    assert part == pytest.approx(0.44909879, abs=5e-9)
    np.testing.assert_allclose(mechanism.rods, [246.119, 279.418] * 3, atol=5e-4)
    found = virtual_points.forward(mechanism, angles(10, 10, 10, 10, -5, 20, -30, 30, 0), mechanism.home)
    assert found.found.all()
    stated = [[0.0, 0.0, 196.373], [4.382, -3.314, 196.564], [-10.676, -1.217, 197.217]]
    np.testing.assert_allclose(found.poses[:, :3], stated, atol=6e-4)
    np.testing.assert_allclose(virtual_points.corners_at(mechanism, found.poses[1])[0], [391.024, 71.542, 205.510], atol=6e-4)


def test_virtual_points_and_legs_find_the_same_pose() -> None:
    """Two sets of equations, nine and six, over the grid of the source's experiment; and the angles come back, always the second root."""
    mechanism = fixture()
    one = np.radians(np.arange(-30.0, 31.0, 5.0))
    drives = np.stack(np.meshgrid(one, one, one, indexing="ij"), axis=-1).reshape(-1, 3)
    found, other = virtual_points.forward(mechanism, drives, mechanism.home), legs.forward(mechanism, drives, mechanism.home)
    assert found.found.all()
    assert other.found.all()
    assert np.abs(se3.displacement(found.poses, other.poses)).max() < 1e-9
    np.testing.assert_allclose(mechanism.inverse(other.poses)[..., 1], drives, atol=1e-11)
    assert (mechanism.sides(other.poses, drives) == 1).all()
    assert mechanism.misfit(other.poses).max() < 1e-9


def test_a_generic_solver_agrees() -> None:
    """SciPy on the distances between hinges, written anew: rotation vector and position."""
    mechanism, drives = fixture(), angles(17, -22, 8)[0]
    azimuth = np.radians([0.0, 120.0, 240.0])
    ends = mechanism.feet.copy()
    for k, (g, f) in enumerate(zip(azimuth, drives, strict=True)):
        turn = np.array([[np.cos(g), -np.sin(g), 0], [np.sin(g), np.cos(g), 0], [0, 0, 1]])
        ends[2 * k] = turn @ [300.0, 50.0 * np.sin(f), 50.0 * np.cos(f)]

    def lacks(x: np.ndarray) -> np.ndarray:
        a, b, c = x[:3]
        angle = np.sqrt(a * a + b * b + c * c) + 1e-300
        k = np.array([[0, -c, b], [c, 0, -a], [-b, a, 0]]) / angle
        turn = np.eye(3) + np.sin(angle) * k + (1 - np.cos(angle)) * k @ k
        return np.linalg.norm(mechanism.points @ turn.T + x[3:] - ends, axis=1) - mechanism.rods

    solved = least_squares(
        lacks, [0.0, 0.0, np.radians(10.0), 0.0, 0.0, 200.0], xtol=1e-15, ftol=1e-15, gtol=1e-15, x_scale=[1e-2] * 3 + [1.0] * 3
    )
    found = legs.forward(mechanism, drives[None], mechanism.home).poses[0]
    np.testing.assert_allclose(found[:3], solved.x[3:], atol=1e-8)
    np.testing.assert_allclose(se3.rotation(found).as_rotvec(), solved.x[:3], atol=1e-10)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_jacobians_are_differences(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mechanism, drives = fixture(), rng.uniform(-0.5, 0.5, 3)
    pose = se3.displaced(mechanism.home, rng.normal(size=6) * [0.05, 0.05, 0.05, 5.0, 5.0, 5.0])
    found = legs.jacobians(mechanism, pose, drives)
    for k in range(6):
        h = np.eye(6)[k] * (1e-5 if k < 3 else 1e-3)
        difference = (
            legs.residuals(mechanism, se3.displaced(pose, h), drives) - legs.residuals(mechanism, se3.displaced(pose, -h), drives)
        ) / (2 * h[k])
        np.testing.assert_allclose(found.output[:, k], difference, rtol=1e-7, atol=2e-6)
    for k in range(3):
        h = np.eye(3)[k] * 1e-5
        difference = (legs.residuals(mechanism, pose, drives + h) - legs.residuals(mechanism, pose, drives - h)) / 2e-5
        np.testing.assert_allclose(found.drives[:, k], difference, rtol=1e-7, atol=2e-6)


def test_the_pose_of_a_height_and_a_normal() -> None:
    """Of poses that the mechanism takes, moved in what the rods determine: the same come back."""
    mechanism, rng = fixture(), np.random.default_rng(3)
    drives = rng.uniform(-0.4, 0.4, (50, 3))
    true = legs.forward(mechanism, drives, mechanism.home).poses
    normal = se3.matrices(true)[..., 2]
    shift = rng.normal(size=(50, 3)) * [8.0, 8.0, 0.0]
    asked = se3.displaced(true, np.concatenate([rng.normal(size=(50, 1)) * 0.05 * normal, shift], axis=1))
    found, exists = mechanism.nearest(asked)
    assert exists.all()
    assert np.abs(se3.displacement(found, true)).max() < 1e-8
    high = se3.displaced(mechanism.home, [0.0, 0.0, 0.0, 0.0, 0.0, 400.0])
    assert not mechanism.nearest(high[None])[1].any()


def test_a_branch_that_is_left_is_said() -> None:
    """Nearly upright rods: all cranks turned together pass a dead point, rod and crank in line, and the other root takes over."""
    mechanism = CrankPlatform.regular(300.0, 200.0, np.radians(20.0), np.radians(90.0), crank_mm=50.0, height_mm=300.0)
    f = np.radians(np.arange(0.0, -30.5, -0.5))
    drives = np.column_stack([f, f, f])
    way = legs.followed(mechanism, drives, mechanism.home)
    assert way.found.all()
    sides = mechanism.sides(way.poses, drives)
    changes = np.flatnonzero((sides[1:] != sides[:-1]).any(axis=1))
    assert len(changes) == 1
    # in the crank's plane, y and z at azimuth zero
    rod = (legs.uppers(mechanism, way.poses)[:, 0] - mechanism.legs(drives).ends[:, 0])[:, 1:]
    in_line = np.sin(f) * rod[:, 1] - np.cos(f) * rod[:, 0]
    assert in_line[changes[0]] * in_line[changes[0] + 1] < 0.0
    assert np.degrees(f[changes[0]]) == pytest.approx(-21.0)
    roots = mechanism.inverse(way.poses)
    own = np.take_along_axis(roots, np.abs(sides)[..., None], axis=-1)[..., 0]
    np.testing.assert_allclose(own, drives, atol=1e-7)
    # an inverse that keeps its first root tells angles that the cranks never had
    assert np.abs(roots[-1, :, 1] - drives[-1]).max() > 0.1


def test_a_rod_in_line_with_its_crank_is_a_dead_point() -> None:
    mechanism, pose = fixture(), fixture().home
    upper = legs.uppers(mechanism, pose)[0]
    crank = np.arctan2(upper[1] - mechanism.feet[0, 1], upper[2] - mechanism.feet[0, 2])
    drives = np.array([crank, 0.0, 0.0])
    ends = mechanism.legs(drives).ends
    rods = np.linalg.norm(legs.uppers(mechanism, pose) - ends, axis=1)
    stretched = CrankPlatform(mechanism.feet, mechanism.points, rods, mechanism.crank, mechanism.home)
    assert mechanism.sides(pose, np.zeros(3)).tolist() == [1, 1, 1]
    assert stretched.sides(pose, drives).tolist() == [-1, 1, 1]
    assert singular(legs.jacobians(stretched, pose, drives), UNITS) == Singular.DRIVES
    assert singular(legs.jacobians(mechanism, pose, np.zeros(3)), UNITS) == Singular.NO


def test_all_assemblies_are_found_and_the_one_followed_is_among_them() -> None:
    mechanism, drives = fixture(), angles(12, -7, 20)
    own = legs.forward(mechanism, drives, mechanism.home).poses[0]
    found = legs.assemblies(mechanism, drives[0])
    assert found.certified.all()
    assert len(found.poses) % 2 == 0
    assert np.abs(legs.residuals(mechanism, found.poses, np.broadcast_to(drives[0], (len(found.poses), 3)))).max() < 1e-8
    assert np.abs(se3.displacement(found.poses, np.broadcast_to(own, found.poses.shape))).max(axis=1).min() < 1e-8


def test_what_cannot_be_is_refused() -> None:
    with pytest.raises(GeometryError, match="crank_mm is 0; it must be positive"):
        CrankPlatform.regular(300.0, 200.0, 0.3, 1.7, crank_mm=0.0, height_mm=200.0)
    # rods that cannot reach their cranks
    short = CrankPlatform(fixture().feet, fixture().points, fixture().rods * 0.2, 50.0, fixture().home)
    for method in (legs.forward, virtual_points.forward):
        none = method(short, np.zeros((1, 3)), short.home)
        assert not none.found.any()
        assert np.isnan(none.poses).all()
    assert np.isnan(short.inverse(short.home)).all()
