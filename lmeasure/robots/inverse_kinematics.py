"""All joint values that take an arm's tool to a pose: in closed form for elbow arms, by Newton's method from many starts for any other.

A general arm of six turning joints has at most 16 solutions (Raghavan and Roth, J. Mech. Design 115, 1993); one of seven has whole curves
of them, of which the starts give single points. Solutions that differ by whole turns of a joint count as one, that
nearest to its middle.
"""

import math

import numpy as np
from scipy.stats import qmc

from lmeasure.core import FloatArray, se3
from lmeasure.robots.serial import SerialArm

STARTS = 256
STEPS = 60
SAME = 1e-5
"""Rad, or parts of the arm's reach: solutions nearer than this are one."""
REACHED = 1e-10
"""Largest error of a pose that is reached, rad and parts of the arm's reach."""
LONGEST_STEP = 0.5


def solutions(arm: SerialArm, pose: FloatArray, seed: int = 0) -> FloatArray:
    """(k, n) joint values within the limits that take the tool to the pose (7,), in order of the first joint; k is 0 where none do."""
    pose = np.asarray(pose, dtype=np.float64)
    found = arm.ways(pose) if arm.is_elbow else _newton(arm, pose, seed)
    found = found[~np.isnan(found).any(axis=1)]
    found = _different(arm, _wrapped(arm, found))
    inside = ((found >= arm.low) & (found <= arm.high)).all(axis=1)
    found = found[inside]
    return np.asarray(found[np.lexsort(found.T[::-1])])


def reach_mm(arm: SerialArm) -> float:
    """The farthest that links and tool can stretch [mm], sliding joints half-way out."""
    ends = np.linalg.norm(arm.tool[:3]) + (0.0 if arm.seat is None else np.linalg.norm(arm.seat[:3]))
    links = np.hypot(arm.links[:, 1], arm.links[:, 2]).sum() + ends
    out = np.abs(arm.link_values(0.5 * (arm.low + arm.high)))[arm.slides].sum()
    return max(float(links + out), 1.0)


def _newton(arm: SerialArm, pose: FloatArray, seed: int) -> FloatArray:
    """(k, n) where damped Newton steps from many starts have arrived, some of them twice."""
    scale = np.array([1.0, 1.0, 1.0, *(1.0 / reach_mm(arm),) * 3])
    unit = np.where(arm.sliding, reach_mm(arm), 1.0)
    starts = qmc.Sobol(arm.axes_count, rng=np.random.default_rng(seed)).random(STARTS)
    low = np.where(arm.sliding, arm.low, np.maximum(arm.low, -math.pi))
    high = np.where(arm.sliding, arm.high, np.minimum(arm.high, math.pi))
    joints = low + starts * (high - low)
    flange = se3.compose(pose, se3.inverse(arm.tool))
    for _ in range(STEPS):
        poses, links = arm.twists(joints)
        # the twist that takes each flange to where it should be, at the flange's own origin and in base axes
        off = se3.displacement(np.broadcast_to(flange, poses.shape), poses) * scale
        if (np.abs(off).max(axis=1) < REACHED).all():
            break
        at_flange = se3.at_points(poses[:, :3]) @ np.swapaxes(arm.joint_twists(links), 1, 2)
        jacobian = scale[:, None] * at_flange * unit
        damping = 1e-3 * np.minimum(np.abs(off).max(axis=1), 0.1)  # goes with the error: quadratic in the end
        square = np.swapaxes(jacobian, 1, 2) @ jacobian + damping[:, None, None] * np.eye(arm.axes_count)
        # to the last digits where the pose does not bind every joint
        square += 1e-14 * np.eye(arm.axes_count)
        step = np.linalg.solve(square, np.swapaxes(jacobian, 1, 2) @ off[..., None])[..., 0]
        step *= np.minimum(1.0, LONGEST_STEP / np.maximum(np.abs(step).max(axis=1), 1e-300))[:, None]
        joints = joints + step * unit
    poses, _ = arm.twists(joints)
    off = np.abs(se3.displacement(np.broadcast_to(flange, poses.shape), poses) * scale).max(axis=1)
    return np.asarray(joints[off < 1e3 * REACHED])


def _wrapped(arm: SerialArm, joints: FloatArray) -> FloatArray:
    """Joint values with the whole turns that bring them nearest to the middle of their limits."""
    middle = 0.5 * (arm.low + arm.high)
    turns = np.round((joints - middle) / (2.0 * math.pi))
    return np.asarray(np.where(arm.sliding, joints, joints - 2.0 * math.pi * turns))


def _different(arm: SerialArm, joints: FloatArray) -> FloatArray:
    """The rows that are not the same as an earlier one."""
    unit = np.where(arm.sliding, reach_mm(arm), 1.0)
    kept: list[FloatArray] = []
    for row in joints:
        gap = [np.where(arm.sliding, (row - k) / unit, np.abs(np.mod(row - k + math.pi, 2.0 * math.pi) - math.pi)) for k in kept]
        if not any(np.abs(g).max() < SAME for g in gap):
            kept.append(row)
    return np.array(kept).reshape(-1, arm.axes_count)
