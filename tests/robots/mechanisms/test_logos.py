"""The hexapod of thesis 5.8: the worked leg, and what its turn must be whatever the frame."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from lmeasure.core import GeometryError, se3
from lmeasure.robots.parallel.mechanisms import legs
from lmeasure.robots.parallel.mechanisms.jacobians import Singular, singular
from lmeasure.robots.parallel.mechanisms.logos import HookeHexapod

LOWER = np.array([-460.0, -421.0, 0.0])
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def hexapod(x: float = -147.5) -> HookeHexapod:
    """Upper x is printed as -0.147, and by its difference 0.312 as -0.148."""
    return HookeHexapod.of_leg(LOWER, np.array([x, -490.0, 793.0]))


@pytest.mark.parametrize(("x", "degrees"), [(-147.0, 16.5488), (-148.0, 16.5567), (-147.5, 16.5528)])
def test_the_worked_leg(x: float, degrees: float) -> None:
    mechanism, turned = hexapod(x), se3.pose(np.zeros(3), Rotation.from_rotvec([0.0, 0.0, np.radians(20.0)]))
    assert mechanism.leg_turns(HOME)[0] == pytest.approx(0.0, abs=1e-12)
    found = np.degrees(mechanism.leg_turns(turned))[0]
    assert abs(found) == pytest.approx(16.555, abs=0.01)
    assert abs(found) == pytest.approx(degrees, abs=6e-5)
    ends = [np.linalg.norm(Rotation.from_rotvec([0, 0, t]).apply([x, -490.0, 793.0]) - LOWER) for t in (0.0, np.radians(20.0))]
    np.testing.assert_allclose(ends, [855.0, 936.0], atol=1.0)
    # the crosses' centres, printed in metres
    np.testing.assert_allclose(mechanism.feet[0] / 1000.0, [-0.428, -0.428, 0.079], atol=1.1e-3)
    upper = se3.apply(turned, mechanism.points[0])
    np.testing.assert_allclose(upper / 1000.0, [-0.0027, -0.515, 0.714], atol=1.1e-3)


def test_the_printed_sign_is_the_other_turn() -> None:
    """arccos of E3 . E5 as printed, E5 (0.327, -0.0017, -0.22), would be 163.4 degrees."""
    e3, printed = np.array([-0.307, 0.113, 0.221]), np.array([0.327, -0.0017, -0.22])
    cos = e3 @ printed / np.linalg.norm(e3) / np.linalg.norm(printed)
    assert np.degrees(np.arccos(cos)) == pytest.approx(163.4, abs=0.2)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6))
def test_turns_are_of_the_leg_alone(seed: int) -> None:
    """Bringing the lower second axis round the leg by the turn gives the upper one; the whole mechanism carried elsewhere turns as much."""
    rng, mechanism = np.random.default_rng(seed), hexapod()
    pose = se3.displaced(HOME, rng.uniform(-1, 1, 6) * [0.3, 0.3, 0.8, 100, 100, 100])
    turn = mechanism.leg_turns(pose)
    e = legs.uppers(mechanism, pose) - mechanism.feet
    e /= np.linalg.norm(e, axis=1)[:, None]
    low = np.cross(e, mechanism.feet_axes)
    high = np.cross(e, se3.rotation(pose).apply(mechanism.point_axes))
    brought = Rotation.from_rotvec(turn[:, None] * e).apply(low)
    assert np.abs(np.cross(brought, high)).max() < 1e-12
    assert (np.einsum("ij,ij->i", brought, high) > 0.0).all()
    by = se3.displaced(HOME, rng.normal(size=6) * [1, 1, 1, 500, 500, 500])
    carried = HookeHexapod(
        se3.apply(by, mechanism.feet), mechanism.points, se3.rotation(by).apply(mechanism.feet_axes), mechanism.point_axes
    )
    np.testing.assert_allclose(carried.leg_turns(se3.compose(by, pose)), turn, atol=1e-12)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10**6))
def test_inverse_forward_inverse(seed: int) -> None:
    rng, mechanism = np.random.default_rng(seed), hexapod()
    true = se3.displaced(HOME, rng.uniform(-1, 1, 6) * [0.2, 0.2, 0.3, 60, 60, 60])
    lengths = mechanism.inverse(true)
    found = legs.forward(mechanism, lengths[None], HOME)
    assert found.found.all()
    np.testing.assert_allclose(mechanism.inverse(found.poses[0]), lengths, atol=1e-9)
    assert np.abs(se3.displacement(found.poses[0], true)).max() < 1e-8
    jacobians = legs.jacobians(mechanism, true, lengths)
    h = 1e-3
    rates = (mechanism.inverse(se3.displaced(true, [0, 0, 0, h, 0, 0])) - mechanism.inverse(se3.displaced(true, [0, 0, 0, -h, 0, 0]))) / (
        2 * h
    )
    np.testing.assert_allclose(jacobians.drive_rates(np.array([0, 0, 0, 1.0, 0, 0])), rates, rtol=1e-7, atol=1e-8)


def test_it_is_singular_where_a_hexapod_of_this_kind_is() -> None:
    """Turned by a quarter about its axis at rest the six legs touch one hyperboloid (Fichter's pose): for plates of equal pairs."""
    mechanism, units = hexapod(), np.array([1 / 500.0] * 3 + [1.0] * 3)
    assert singular(legs.jacobians(mechanism, HOME, mechanism.inverse(HOME)), units) == Singular.NO
    angle = np.linspace(-3.1, 3.1, 3000)
    poses = np.concatenate([np.zeros((3000, 3)), Rotation.from_rotvec(np.outer(angle, [0, 0, 1.0])).as_quat()], axis=1)
    det = np.linalg.det(legs.jacobians(mechanism, poses, mechanism.inverse(poses)).output)
    zeros = angle[:-1][det[1:] * det[:-1] < 0.0]
    # by symmetry the sign of the legs' tangential slant is that of the determinant: it changes a quarter from where pairs are opposite
    centre = [np.arctan2(p[:2].sum(axis=0)[1], p[:2].sum(axis=0)[0]) for p in (mechanism.feet[[0, 1]], mechanism.points[[0, 1]])]
    opposite = centre[0] - centre[1]
    off = [abs(np.angle(np.exp(1j * (z - opposite)))) for z in zeros]
    np.testing.assert_allclose(off, np.pi / 2.0, atol=3e-3)
    assert len(zeros) == 2


def test_what_cannot_be_is_refused() -> None:
    good = hexapod()
    with pytest.raises(GeometryError, match="point_axes: each row must be of length one"):
        HookeHexapod(good.feet, good.points, good.feet_axes, 2.0 * good.point_axes)
    along = HookeHexapod(
        good.feet, good.points, (good.points - good.feet) / np.linalg.norm(good.points - good.feet, axis=1)[:, None], good.point_axes
    )
    assert np.isnan(along.leg_turns(HOME)).all()
    assert np.abs(good.bends(HOME)).max() < np.radians(60.0)
