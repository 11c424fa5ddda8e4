"""Laws of each shipped mechanism over its whole workspace, not about its home alone."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import qmc

from lmeasure.core import FloatArray, se3
from lmeasure.robots import REGULAR, Allowed, Mounted, any_shipped, shipped_names
from lmeasure.robots.parallel import model as strides
from lmeasure.robots.parallel.limits import spread
from lmeasure.robots.parallel.model import Parallel

HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
POSES, LOOKED_AT, MOST_RAD = 512, 24, 1.0
MECHANISMS = {name: model for name in shipped_names() if isinstance(model := any_shipped(name).model, Parallel)}


def over(robot: Parallel) -> FloatArray:
    """(n, j) joint values over the workspace that are reached from home: of a robot of six joints those of poses within its limits, of
    others what its joints allow."""
    if len(robot.joint_names) == 6:
        joints = spread(robot, qmc.Halton(6, rng=1).random(POSES), most_rad=MOST_RAD)[:LOOKED_AT]
        assert np.isfinite(robot.forward(joints)).all()
        return joints
    low, high = robot.limits
    joints = low + qmc.Halton(len(low), rng=1).random(LOOKED_AT * 8) * (high - low)
    return np.asarray(joints[np.isfinite(robot.forward(joints)[:, 0])][:LOOKED_AT])


def turned(robot: Parallel, change: FloatArray) -> FloatArray:
    """Changes of joints without whole turns, sliding ones in parts of the platform's size."""
    return np.where(robot.sliding, change / robot.size_mm, change - 2.0 * np.pi * np.round(change / (2.0 * np.pi)))


@pytest.mark.parametrize("name", MECHANISMS)
def test_inverse_forward_inverse(name: str) -> None:
    robot = MECHANISMS[name]
    joints = over(robot)
    poses = robot.forward(joints)
    assert len(joints) >= 15
    # as far from home, in the direction in which it goes farthest, as a good part of its size
    assert np.abs(se3.displacement(poses, robot.home) / robot.units).max() > 0.05 * robot.size_mm
    for pose, q in zip(poses, joints, strict=True):
        every = robot.inverse(pose)
        assert np.abs(turned(robot, every - q)).max(axis=1).min() < 1e-9
        again = robot.forward(every)
        assert np.abs(se3.displacement(again, np.broadcast_to(pose, again.shape)) / robot.units).max() < 1e-9 * robot.size_mm


def test_planned_poses_are_reached_from_home_by_a_robot_built_otherwise() -> None:
    """Ends alone would do for the drawing, whose way from home may leave the workspace between; 0.2 mm in each length are not drawn."""
    robot = MECHANISMS["four-chains-arms"]
    joints = spread(robot, qmc.Halton(6, rng=1).random(8 * POSES), most_rad=MOST_RAD)
    rng = np.random.default_rng(0)
    built = robot.moved(np.where([p.unit == "mm" for p in robot.parameters], rng.normal(size=len(robot.parameters)) * 0.2, 0.0))
    allowed = Allowed(robot, HERE, HERE, np.empty((0, 3, 2)), regular=REGULAR)(joints)
    way = np.linspace(0.0, 1.0, 101)[:, None, None] * (joints - robot.home_joints) + robot.home_joints
    lost = np.array([np.isnan(b.forward(way.reshape(-1, 6))[:, 0]).reshape(101, -1).any(axis=0) for b in (robot, built)])
    assert allowed.sum() > 600
    assert not lost[:, allowed].any()
    assert lost.any()


def test_a_motion_stays_in_its_assembly_where_the_way_is_steep() -> None:
    """The seven-link guide, fast: from ten samples before, Newton's method finds another assembly 90 mm off."""
    robot = MECHANISMS["seven-link"]
    joints = np.linspace(-76.0, 54.0, 30)[:, None]
    alone = robot.forward(joints)
    assert np.linalg.norm(robot.near(joints, np.repeat(alone[::10], 10, axis=0))[0][:, :3] - alone[:, :3], axis=1).max() > 50.0
    np.testing.assert_allclose(Mounted(robot, HERE, HERE).forward(joints), alone, atol=1e-6)


@pytest.mark.parametrize("name", [name for name, robot in MECHANISMS.items() if len(robot.joint_names) == 6])
def test_strides_step_over_nothing_in_the_workspace(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """A twentieth as long, they lead to the same poses."""
    robot = MECHANISMS[name]
    joints = over(robot)
    poses = robot.forward(joints)
    monkeypatch.setattr(strides, "STRIDE_RAD", strides.STRIDE_RAD / 20.0)
    monkeypatch.setattr(strides, "STRIDE", strides.STRIDE / 20.0)
    monkeypatch.setattr(strides, "MOST_PARTS", 20 * strides.MOST_PARTS)
    again = replace(robot).forward(joints)  # which has no strides kept
    np.testing.assert_allclose(se3.displacement(again, poses) / robot.units, 0.0, atol=1e-9 * robot.size_mm)
