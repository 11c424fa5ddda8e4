"""The arm's kinematics against a product of exponentials that knows nothing of link tables, and round trips."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError
from lmeasure.robots.robot import shipped
from lmeasure.robots.serial import ALPHA, SerialArm

FOOT = np.array([1100.0, 30.0, -500.0, *Rotation.from_euler("xyz", [2.0, -1.0, 175.0], degrees=True).as_quat()])
TOOL = np.array([5.0, -3.0, 120.0, *Rotation.from_euler("xyz", [178.0, 3.0, 40.0], degrees=True).as_quat()])
ARM = replace(shipped("generic6").arm, foot=FOOT, tool=TOOL)
ANGLES = st.lists(st.floats(-3.0, 3.0), min_size=6, max_size=6).map(np.array)


def homogeneous(pose: FloatArray) -> FloatArray:
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_quat(pose[3:]).as_matrix(), pose[:3]
    return out


def by_exponentials(joints: FloatArray) -> FloatArray:
    """base_from_tool of ARM: screws read off a drawing of the arm at zero, in the foot's frame (upper arm upright, forearm along x)."""
    shoulder, wrist = (150.0, 0.0, 450.0), (150.0 + 850.0, 0.0, 450.0 + 800.0 + 120.0)
    elbow, flange = (150.0, 0.0, 1250.0), (1100.0, 0.0, wrist[2])
    screws = (
        ((0, 0, 1), (0, 0, 0)), ((0, 1, 0), shoulder), ((0, 1, 0), elbow),
        ((1, 0, 0), wrist), ((0, 1, 0), wrist), ((1, 0, 0), wrist),
    )  # fmt: skip
    # at zero the flange looks along x, its x axis up
    zero = np.array([[0.0, 0.0, 1.0, flange[0]], [0.0, -1.0, 0.0, flange[1]], [1.0, 0.0, 0.0, flange[2]], [0.0, 0.0, 0.0, 1.0]])
    out = homogeneous(FOOT)
    for (axis, point), angle in zip(screws, joints, strict=True):
        w = np.array(axis, dtype=float)
        twist = np.zeros((4, 4))
        twist[:3, :3] = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
        twist[:3, 3] = -np.cross(w, point)
        out = out @ expm(angle * twist)
    return np.asarray(out @ zero @ homogeneous(TOOL))


@given(ANGLES)
def test_forward_is_the_product_of_exponentials(joints: FloatArray) -> None:
    assert homogeneous(ARM.forward(joints)) == pytest.approx(by_exponentials(joints), abs=1e-9)


def test_a_link_with_all_errors_is_its_five_elementary_motions_in_their_order() -> None:
    rng = np.random.default_rng(1)
    errors = rng.uniform(-0.1, 0.1, (6, 5))
    built, joints = ARM.with_errors(errors), rng.uniform(-2, 2, 6)
    out = homogeneous(FOOT)
    for (offset, d, a, alpha, beta), q in zip(ARM.links + errors, joints, strict=True):
        for axis, turn, shift in (("z", q + offset, (0, 0, d)), ("x", alpha, (a, 0, 0)), ("y", beta, (0, 0, 0))):
            step = np.eye(4)
            step[:3, :3], step[:3, 3] = Rotation.from_euler(axis, turn).as_matrix(), shift
            out = out @ step
    assert homogeneous(built.forward(joints)) == pytest.approx(out @ homogeneous(TOOL), abs=1e-9)


@given(ANGLES)
def test_all_eight_ways_lead_back_and_one_of_them_is_where_it_came_from(joints: FloatArray) -> None:
    limits = np.full(6, 3.2)
    arm = SerialArm(ARM.links, FOOT, TOOL, -limits, limits)
    pose = arm.forward(joints)
    ways = arm.ways(pose)
    reached = ways[~np.isnan(ways).any(axis=1)]
    back = arm.forward(reached)
    assert np.abs(back[:, :3] - pose[:3]).max() < 1e-6
    assert (Rotation.from_quat(back[:, 3:]) * Rotation.from_quat(pose[3:]).inv()).magnitude().max() < 1e-12
    bend = abs(math.sin(joints[4]))
    knee = abs(math.sin(joints[2] - math.atan2(120.0, 850.0) + 0.5 * math.pi))
    wrist = np.linalg.norm(by_exponentials(joints)[:3, 3] - FOOT[:3])
    if bend > 0.01 and knee > 0.01 and wrist > 1.0:
        off = np.abs(np.mod(reached - joints + math.pi, 2 * math.pi) - math.pi)
        assert off.max(axis=1).min() < 1e-4


def test_a_straight_wrist_is_still_solved() -> None:
    # only the sum of the fourth and sixth angles is determined
    joints = np.array([0.3, -0.4, 0.5, 0.0, 0.0, 0.7])
    pose = ARM.forward(joints)
    ways = ARM.ways(pose)
    back = ARM.forward(ways[~np.isnan(ways).any(axis=1)])
    assert np.abs(back[:, :3] - pose[:3]).max() < 1e-6
    assert np.abs(np.abs(back[:, 3:] @ pose[3:]) - 1.0).max() < 1e-15


def test_a_pose_out_of_reach_or_beyond_a_limit_has_no_way() -> None:
    far = np.array([9000.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert np.isnan(ARM.ways(far)).all()
    stiff = SerialArm(ARM.links, FOOT, TOOL, np.full(6, -0.01), np.full(6, 0.01))
    assert np.isnan(stiff.ways(ARM.forward(np.full(6, 0.5)))).all()


def test_the_closed_inverse_refuses_links_it_does_not_fit() -> None:
    error = np.zeros((6, 5))
    error[4, ALPHA] = 1e-3
    with pytest.raises(RobotError, match="spherical wrist"):
        ARM.with_errors(error).ways(ARM.forward(np.zeros(6)))


def test_a_path_is_followed_without_turning_a_joint_by_a_whole_turn() -> None:
    joints = np.linspace([0.1, 0.2, -0.3, -0.4, 0.9, 3.0], [0.4, 0.5, 0.1, 0.4, 0.7, 3.5], 200)
    assert ARM.follow(ARM.forward(joints), joints[0]) == pytest.approx(joints, abs=1e-8)


def test_a_path_that_cannot_be_gone_names_its_sample() -> None:
    here = ARM.forward(np.array([0.0, 0.2, 0.3, 0.1, 0.8, 0.1]))
    out = np.tile(here, (100, 1))
    out[:, 0] += np.linspace(0.0, -4000.0, 100)
    with pytest.raises(RobotError, match=r"sample \d+: the arm cannot reach x"):
        ARM.follow(out, np.zeros(6))
    # through a straight wrist to the other side of it
    bend = np.array([0.0, 0.2, 0.3, 0.0, 0.3, 0.0])
    side = np.array([0.0, 0.2, 0.3, 1.5, 0.3, -1.5])
    a, b = ARM.forward(bend), ARM.forward(side)
    jump = np.stack([a, a, b, b])
    with pytest.raises(RobotError, match="sample 2: a joint jumps"):
        ARM.follow(jump, bend)


def test_heat_lengthens_the_arm_and_nothing_else() -> None:
    joints = np.array([0.3, -0.4, 0.5, 0.6, 0.7, 0.8])
    at, turn = ARM.flange(joints)
    grown, turned = ARM.flange(joints, 1e-4)
    assert grown == pytest.approx(at * (1 + 1e-4), rel=1e-14)
    assert turned == pytest.approx(turn, abs=1e-15)


@given(ANGLES, st.lists(st.floats(-100, 100), min_size=3, max_size=3).map(np.array))
def test_a_force_deflects_by_the_transposed_jacobian(joints: FloatArray, force: FloatArray) -> None:
    # virtual work: F . dx = sum torque dq, with dx from small turns of one joint
    stiffness = np.array([2e9, 2e9, 1e9, 3e8, 3e8, 2e8])
    point = ARM.forward(joints)[:3]
    turned = ARM.deflection(joints[None], stiffness, force[None], point[None])[0]
    h = 1e-6
    for i in range(6):
        step = np.zeros(6)
        step[i] = h
        moved = (ARM.forward(joints + step)[:3] - ARM.forward(joints - step)[:3]) / (2 * h)
        assert turned[i] * stiffness[i] == pytest.approx(float(force @ moved), abs=1e-3)
