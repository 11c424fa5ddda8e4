"""Robots from files: their derivatives against differences, all ways to a pose, files that come back, and refusals in one line."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, LMeasureError, RobotError
from lmeasure.robots import Robot, read_robot, read_urdf, serial as arms, write_robot
from lmeasure.robots.robot import robot_from_dict, serial, shipped
from lmeasure.robots.serial import SerialRobot


def gantry() -> Robot:
    """Two sliding joints and three that turn, with everything that can be said of a joint, on a tilted foot."""
    turn = {"min_deg": -170.0, "max_deg": 170.0}
    joints = [
        {"type": "prismatic", "alpha_deg": -90.0, "d_mm": 30.0, "min_mm": -500.0, "max_mm": 500.0, "pitch_mm": 20.0, "sin1_mm": 0.01},
        {
            "type": "prismatic", "alpha_deg": 88.0, "a_mm": 50.0, "theta_deg": 20.0, "min_mm": 0.0, "max_mm": 800.0,
            "compliance_mm_per_n": 1e-4,
        },
        {"type": "revolute", "a_mm": 300.0, "alpha_deg": 1.0, "beta_deg": 0.5, "sin2_deg": 0.02, "cos1_deg": 0.01, **turn},
        {"type": "revolute", "a_mm": 250.0, "alpha_deg": 70.0, "compliance_deg_per_nm": 0.002, "backlash_deg": 0.01, **turn},
        {"type": "revolute", "d_mm": 80.0, "scale": -1.001, "cos2_deg": 0.03, **turn},
    ]  # fmt: skip
    named = [{"name": f"j{i}"} | j for i, j in enumerate(joints, 1)]
    quaternion = [float(v) for v in Rotation.from_rotvec([0.1, 0.2, -0.3]).as_quat()]
    data = {
        "schema": "lmeasure.robot/1",
        "name": "gantry",
        "joint": named,
        "base": {"position_mm": [100.0, 20.0, 5.0], "quaternion_xyzw": quaternion},
    }
    return serial(robot_from_dict(data | {"payload": {"mass_kg": 12.0, "centre_mm": [10.0, 20.0, 90.0]}}), "gantry")


def drawn(model: SerialRobot, count: int, rng: np.random.Generator) -> FloatArray:
    low, high = model.limits
    wide = ~model.sliding
    return np.asarray(
        rng.uniform(np.where(wide, np.maximum(low, -3.0), low), np.where(wide, np.minimum(high, 3.0), high), (count, len(low)))
    )


def twist(before: FloatArray, after: FloatArray, step: float) -> FloatArray:
    """(n, 6) (omega; v at the base's origin) of poses that a small step has moved, by SciPy alone."""
    omega = (Rotation.from_quat(after[:, 3:]) * Rotation.from_quat(before[:, 3:]).inv()).as_rotvec() / step
    middle = 0.5 * (before[:, :3] + after[:, :3])
    return np.concatenate([omega, (after[:, :3] - before[:, :3]) / step - np.cross(omega, middle)], axis=1)


@pytest.mark.parametrize("robot", [gantry(), shipped("ur5"), shipped("generic7")], ids=lambda r: r.name)
def test_derivatives_are_those_of_differences(robot: Robot) -> None:
    rng = np.random.default_rng(3)
    model = robot.model
    joints, side = drawn(model, 4, rng), rng.choice([-1.0, 1.0], (4, len(robot.joint)))
    poses, _, by_parameters = model.derivatives(joints, side)
    assert poses == pytest.approx(model.forward(joints, side), abs=1e-9)
    h = 1e-6
    unloaded = replace(model, load_n=np.zeros(3))  # how the payload's torques change with the pose is left out
    _, by_joints, _ = unloaded.derivatives(joints, side)
    for i in range(joints.shape[1]):
        step = h * np.eye(joints.shape[1])[i]
        got = twist(unloaded.forward(joints - step, side), unloaded.forward(joints + step, side), 2 * h)
        assert by_joints[:, i] == pytest.approx(got, rel=1e-6, abs=2e-4)
    parameters = model.parameters
    for i, p in enumerate(parameters):
        h = 1e-4 * p.width * p.size
        step = h * np.eye(len(parameters))[i]
        got = twist(model.moved(-step).forward(joints, side), model.moved(step).forward(joints, side), 2 * h)
        assert by_parameters[:, i] == pytest.approx(got, rel=1e-6, abs=5e-10 / h), p.name


def test_parameters_move_what_the_file_names() -> None:
    model = gantry().model
    parameters = model.parameters
    change = np.array([2.0 * p.size for p in parameters])
    for before, after in zip(parameters, model.moved(change).parameters, strict=True):
        assert after.name == before.name
        assert after.value == pytest.approx(before.value + 2.0, abs=1e-12)
    assert [p.name for p in parameters if "beta" in p.name] == ["j3.beta_deg"]  # where the next axis is nearly parallel
    moved = gantry().with_values({"j3.a_mm": 301.0, "j5.scale": 1.0}).model
    assert {p.name: p.value for p in moved.parameters}["j3.a_mm"] == 301.0
    assert {p.name: p.value for p in moved.parameters}["j5.scale"] == 1.0


def test_published_poses_of_shipped_arms() -> None:
    # PUMA 560 upright and stretched out, as Corke's Robotics Toolbox has them (qr, qs)
    upright, out = [0.0, math.pi / 2, -math.pi / 2, 0.0, 0.0, 0.0], [0.0, 0.0, -math.pi / 2, 0.0, 0.0, 0.0]
    got = shipped("puma560").model.forward(np.array([upright, out]))[:, :3]
    assert got == pytest.approx(np.array([[20.3, -150.05, 863.6], [863.6, -150.05, -20.3]]), abs=1e-9)
    # UR5 at zero: outstretched along -x (maker's drawing)
    assert shipped("ur5").model.forward(np.zeros((1, 6)))[0, :3] == pytest.approx([-817.25, -191.45, -5.491], abs=1e-9)


@pytest.mark.parametrize("name", ["generic6", "generic7", "puma560", "ur5"])
def test_every_way_leads_back_and_one_is_where_it_came_from(name: str) -> None:
    model = shipped(name).model
    for joints in drawn(model, 2, np.random.default_rng(8)):
        pose = model.forward(joints[None])[0]
        ways = model.inverse(pose)
        back = model.forward(ways)
        assert np.abs(back[:, :3] - pose[:3]).max() < 1e-6
        assert (Rotation.from_quat(back[:, 3:]) * Rotation.from_quat(pose[3:]).inv()).magnitude().max() < 1e-9
        if len(joints) == 6:
            assert np.abs(np.mod(ways - joints + math.pi, 2 * math.pi) - math.pi).max(axis=1).min() < 1e-6
        assert len(ways) > (1 if len(joints) == 6 else 20)


def test_newton_finds_all_ways_of_the_closed_form() -> None:
    arm = shipped("generic6").arm
    rng = np.random.default_rng(5)
    for joints in rng.uniform(np.maximum(arm.low, -3), np.minimum(arm.high, 3), (3, 6)):
        pose = arm.forward(joints)
        found = arms._different(arm, arms._wrapped(arm, arms._newton(arm, pose, 0)))
        closed = arms.solutions(arm, pose)
        inside = found[((found >= arm.low) & (found <= arm.high)).all(axis=1)]
        assert len(inside) == len(closed) > 0
        gap = np.abs(np.mod(inside[:, None] - closed[None] + math.pi, 2 * math.pi) - math.pi).max(axis=2)
        assert gap.min(axis=0).max() < 1e-6


def test_the_inverse_of_a_robot_with_terms_and_sliding_joints() -> None:
    robot = gantry()
    model = replace(robot.model, load_n=np.zeros(3))
    joints = drawn(model, 1, np.random.default_rng(2))[0]
    pose = model.forward(joints[None])[0]
    ways = model.inverse(pose)
    back = model.forward(ways)
    assert np.abs(back[:, :3] - pose[:3]).max() < 1e-6
    assert np.abs((ways - joints) / np.where(model.sliding, 100.0, 1.0)).max(axis=1).min() < 1e-5
    far = pose + [9e4, 0, 0, 0, 0, 0, 0]
    assert len(model.inverse(far)) == 0


def test_files_come_back(tmp_path: Path) -> None:
    robot = gantry()
    write_robot(tmp_path / "robot.toml", robot)
    assert read_robot(tmp_path / "robot.toml") == robot
    assert "sin1_mm" not in robot.to_dict()["joint"][1]


URDF = """<robot name="two"><link name="b"/><link name="m"/><link name="e"/>
<joint name="one" type="continuous"><parent link="b"/><child link="m"/><origin xyz="0 0 0.5" rpy="0.1 0 0"/><axis xyz="0 1 0"/></joint>
<joint name="two" type="prismatic"><parent link="m"/><child link="e"/><origin xyz="0.2 0.1 0"/><axis xyz="0 0 -2"/>
<limit lower="0" upper="0.4" effort="1" velocity="1"/></joint></robot>"""


def test_urdf_of_others_by_hand(tmp_path: Path) -> None:
    (tmp_path / "two.urdf").write_text(URDF, encoding="utf-8")
    robot = read_urdf(tmp_path / "two.urdf")
    q, s = 0.7, 150.0
    stand = Rotation.from_euler("xyz", [0.1, 0, 0])
    turn = stand * Rotation.from_rotvec([0, q, 0])
    expected = [0, 0, 500] + turn.apply([200, 100, -s])
    got = robot.arm.forward(np.array([q, s]))
    assert got[:3] == pytest.approx(expected, abs=1e-9)
    assert (Rotation.from_quat(got[3:]).inv() * turn).magnitude() < 1e-12
    assert (robot.arm.low[1], robot.arm.high[1]) == (0.0, 400.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("<robot name", '<!DOCTYPE r [<!ENTITY a "b">]><robot name'), "document type"),
        (('type="prismatic"', 'type="sliding"'), "joint 'two': type 'sliding'"),
        (('<limit lower="0" upper="0.4" effort="1" velocity="1"/>', ""), "joint 'two': <limit> is missing"),
        (('xyz="0 0 -2"', 'xyz="0 0 x"'), "joint 'two': '0 0 x' is not three numbers"),
        (('xyz="0 0 -2"', 'xyz="0 0 0"'), "joint 'two': its axis has no direction"),
        (('<child link="e"/>', ""), "joint 'two': <child link=...> is missing"),
        (
            ('<child link="e"/>', '<child link="e"/><mimic joint="three"/>'),
            "joint 'two': follows 'three' .mimic., which is no joint of the file",
        ),
        (('<child link="e"/>', '<child link="e"/><mimic joint="two"/>'), "joint 'two': follows 'two' .mimic., follows itself"),
        (('<child link="e"/>', '<child link="e"/><mimic joint="one" multiplier="x"/>'), "joint 'two': 'x' is not a number"),
        (('xyz="0 0 -2"', 'xyz="${a} 0 0"'), "is xacro, a template of URDF"),
        (("</robot>", '<xacro:arm xmlns:xacro="http://ros.org/wiki/xacro"/></robot>'), "is xacro, a template of URDF"),
        (("</robot>", "<xacro:arm/></robot>"), "is xacro, a template of URDF"),
        (('<parent link="b"/>', '<parent link="e"/>'), "no chain of joints"),
        (("</robot>", ""), "is not URDF"),
        (("<robot", "<sdf"), "is not URDF"),
    ],
)
def test_urdf_that_cannot_be_read_is_refused_in_one_line(change: tuple[str, str], said: str, tmp_path: Path) -> None:
    path = tmp_path / "bad.urdf"
    path.write_text(URDF.replace(*change).replace("</robot>", "</sdf>") if change[1] == "<sdf" else URDF.replace(*change), encoding="utf-8")
    with pytest.raises(RobotError, match=said) as caught:
        read_urdf(path)
    assert "\n" not in str(caught.value)
    assert str(path) in str(caught.value)


def test_two_arms_ask_for_a_tip(tmp_path: Path) -> None:
    other = '<joint name="three" type="continuous"><parent link="m"/><child link="f"/></joint></robot>'
    path = tmp_path / "two.urdf"
    path.write_text(URDF.replace("</robot>", other), encoding="utf-8")
    with pytest.raises(RobotError, match=r"several chains could be meant: to 'e' \(2 joints\), 'f' \(2 joints\). State one with --tip"):
        read_urdf(path)
    assert [j.name for j in read_urdf(path, "f").joint] == ["one", "three"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "lmeasure.robot/2"}, "schema"),
        ({"joint": []}, "joint"),
        ({"joint": [{"name": "a", "type": "revolute", "d": 3.0}]}, "joint a.*unknown key 'd'. The unit is part of the name: 'd_mm'"),
        ({"joint": [{"name": "a", "type": "revolute", "min_deg": 10.0, "max_deg": -10.0}]}, "joint a: min_deg 10 is not below max_deg -10"),
        ({"joint": [{"name": "a", "type": "prismatic"}]}, "joint a.*min_mm.*is missing"),
        ({"joint": [{"name": "a", "type": "revolute"}] * 2}, "the name 'a' is given twice"),
        ({"joint": [{"name": "a", "type": "revolute", "d_mm": 1e9}]}, "joint a.*length"),
        ({"joint": [{"name": "a", "type": "revolute", "scale": 0.0}]}, "leaves nothing"),
        ({"tool": {"quaternion_xyzw": [0.0, 0.0, 0.0, 2.0]}}, "its length is 2, not 1"),
        ({"joint": [{"name": "a", "follows": "b"}]}, "joint a: follows 'b', which is no joint with a value of its own"),
        (
            {"joint": [{"name": "a"}, {"name": "b", "follows": "a"}, {"name": "c", "follows": "b"}]},
            "joint c: follows 'b', which is no joint",
        ),
        ({"joint": [{"name": "a"}, {"name": "b", "follows": "a", "ratio": 0.0}]}, "joint b: follows a: ratio must not be 0"),
        ({"joint": [{"name": "a"}, {"name": "b", "follows": "a", "sin1_deg": 0.1}]}, "scale and errors are those of a"),
        ({"joint": [{"name": "a", "ratio": 2.0}]}, "joint a: ratio needs follows"),
    ],
)
def test_robots_that_contradict_themselves_are_refused_in_one_line(change: dict[str, object], said: str) -> None:
    data: dict[str, Any] = {"schema": "lmeasure.robot/1", "name": "r", "joint": [{"name": "a", "type": "revolute"}]} | change
    data["joint"] = [{"type": "revolute"} | joint for joint in data["joint"]]
    with pytest.raises(RobotError, match=said):
        robot_from_dict(data, "robot.toml")


def test_an_unknown_name_is_told_the_known_ones() -> None:
    with pytest.raises(LMeasureError, match=r"generic6, generic7, gough, .*puma560, .*suspended, .*ur5"):
        shipped("kr210")
