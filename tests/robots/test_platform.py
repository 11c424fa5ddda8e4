"""Platforms on legs and cables: lengths and poses there and back, derivatives by differences, and identified like any other robot."""

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.linkages import assemblies
from lmeasure.robots import Measurements, PlatformFile, Settings, any_shipped, identify, predict
from lmeasure.robots.identification.measurements import measured
from lmeasure.robots.identification.observability import determined_parameters, unobservable_directions
from lmeasure.robots.platform import Platform
from lmeasure.robots.robot import robot_from_dict

KINDS = ("gough", "suspended", "rods", "input-rods")
BASE = np.array([800.0, -300.0, 200.0, *Rotation.from_rotvec([0.4, 0.2, -1.0]).as_quat()])
TOOL = np.array([40.0, -25.0, 110.0, 0.0, 0.0, 0.0, 1.0])


def shipped(name: str) -> PlatformFile:
    found = any_shipped(name)
    assert isinstance(found, PlatformFile)
    return found


def some_joints(robot: Platform, count: int, rng: np.random.Generator, shift: float = 60.0, turn: float = 0.15) -> FloatArray:
    """Joint values of poses about the home pose, in a platform of some 40 mm nearer to it."""
    shift, turn = (shift, turn) if robot.size_mm > 100.0 else (1.0, 0.02)
    moves = np.column_stack([turn * rng.uniform(-1, 1, (count, 3)), shift * rng.uniform(-1, 1, (count, 3))])
    poses = se3.displaced(np.tile(robot.home, (count, 1)), moves)
    return np.array([robot.inverse(pose)[0] for pose in poses])


def built(robot: Platform, rng: np.random.Generator) -> Platform:
    errors = [0.0 if p.name.endswith("scale") else 0.3 if robot.size_mm > 100.0 else 0.01 for p in robot.parameters]
    return robot.moved(rng.normal(size=len(robot.parameters)) * errors)


def seen(true: Platform, joints: FloatArray, rng: np.random.Generator, u_mm: float = 0.02) -> Measurements:
    pose = se3.compose(se3.compose(np.tile(BASE, (len(joints), 1)), true.forward(joints)), np.tile(TOOL, (len(joints), 1)))
    pose = se3.displaced(pose, np.column_stack([1e-4 * rng.normal(size=(len(joints), 3)), u_mm * rng.normal(size=(len(joints), 3))]))
    return measured(joints, pose[:, :3], pose[:, 3:], u_position_mm=u_mm, u_rotation_rad=1e-4)


@pytest.mark.parametrize("name", KINDS)
def test_forward_is_the_inverse_of_the_inverse_and_a_proved_assembly(name: str) -> None:
    robot, rng = shipped(name).model, np.random.default_rng(5)
    joints = some_joints(robot, 20, rng)
    poses = robot.forward(joints)
    assert robot.lengths(poses) == pytest.approx(joints, abs=1e-9)
    assert [robot.inverse(p)[0] for p in poses] == [pytest.approx(q, abs=1e-9) for q in joints]
    if robot.links is None:
        every = assemblies(robot.base, robot.platform, joints[0]).poses
    elif robot.links.gauges is None:
        every = robot.links.poses_of(joints[0])
    else:
        every = assemblies(*robot.links.bodies, robot.links.links_of_drives(joints[0])).poses
    assert np.abs(every[:, :3] - poses[0, :3]).max(axis=1).min() < 1e-6
    assert np.isnan(robot.forward(joints[:1] + np.array([[0.0, 0.0, 4000.0, 0.0, 0.0, 0.0]]))).all()


@pytest.mark.parametrize("name", KINDS)
def test_derivatives_are_those_of_differences(name: str) -> None:
    rng = np.random.default_rng(6)
    robot = built(shipped(name).model, rng)
    joints = some_joints(robot, 5, rng)
    poses, by_joints, by_parameters = robot.derivatives(joints)

    def twist(one: FloatArray, other: FloatArray, h: float) -> FloatArray:
        at_flange = se3.displacement(one, other) / (2.0 * h)
        return np.concatenate([at_flange[:, :3], at_flange[:, 3:] - np.cross(at_flange[:, :3], poses[:, :3])], axis=1)

    for i in range(6):
        h = 1e-3 * np.eye(6)[i]
        assert by_joints[:, i] == pytest.approx(twist(robot.forward(joints + h), robot.forward(joints - h), 1e-3), rel=1e-5, abs=1e-7)
    for i, p in enumerate(robot.parameters):
        size = 1e-6 if p.name.endswith("scale") else 1e-3
        step = size * np.eye(len(robot.parameters))[i]
        got = twist(robot.moved(step).forward(joints), robot.moved(-step).forward(joints), size)
        assert by_parameters[:, i] == pytest.approx(got, rel=2e-4, abs=1e-5), p.name


@pytest.mark.parametrize("name", ["gough", "suspended", "input-rods"])
def test_a_built_platform_is_identified_through_the_same_door(name: str) -> None:
    rng = np.random.default_rng(8)
    nominal = shipped(name).model
    true = built(nominal, rng)
    found = identify(nominal, seen(true, some_joints(nominal, 60, rng), rng), Settings(("links",)))
    later = seen(true, some_joints(nominal, 100, rng), rng)
    predicted = predict(found, later.joints)
    off = np.linalg.norm(predicted.pose[:, :3] - later.position, axis=1)
    assert 0.88 < np.mean(off <= predicted.u95_mm) <= 1.0
    assert off.mean() < 0.06
    value = {p.name: p.value for p in true.parameters}
    determined, u = determined_parameters(found.fit), np.sqrt(np.diag(found.fit.covariance))
    names, values = found.fit.problem.names, found.fit.problem.unknowns.values(found.fit.x)
    z = [(v - value[n]) / s for n, v, s, known in zip(names, values, u, determined, strict=True) if known and n in value]
    assert not z or np.abs(z).max() < 4.5
    texts = " ".join(s.text for s in unobservable_directions(found.fit))
    assert "the base frame" in texts


def test_files_of_platforms_are_written_and_refused(tmp_path: Path) -> None:
    nominal = shipped("gough")
    assert robot_from_dict(nominal.to_dict()) == nominal
    changed = nominal.with_values({"leg_2.base_x_mm": 343.0, "leg_3.offset_mm": 0.2})
    assert changed.model.base[1, 0] == 343.0
    assert changed.model.offset[2] == 0.2
    data = nominal.to_dict()
    data["leg"] = data["leg"][:5]
    with pytest.raises(RobotError, match="leg"):
        robot_from_dict(data, "five.toml")
    data = nominal.to_dict()
    for i, leg in enumerate(data["leg"]):
        leg["platform_mm"] = [200.0 * np.cos(i), 200.0 * np.sin(i), 0.0]
        leg["base_mm"] = [350.0 * np.cos(i), 350.0 * np.sin(i), 0.0]
    with pytest.raises(RobotError, match="home: is a singular pose"):
        robot_from_dict(data, "flat.toml")
