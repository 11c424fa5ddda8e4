"""Corrected commands: joint values at which the identified robot is where the nominal one was meant to be, and what a controller is told.

A controller knows the nominal robot. Told a pose, it goes to joint values q with nominal(q) = pose, and the real flange is at found(q).
Corrected joint values q* solve found(q*) = nominal(q) by Newton's method from q, which stays on q's branch; the pose that makes the
controller go to them is nominal(q*). What is left is how well the robot is known and how well it repeats.
"""

import itertools
import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.errors import RobotError
from lmeasure.robots.model import RobotModel
from lmeasure.robots.serial_robot import SerialRobot

STEPS = 30
SETTLED = 1e-10
"""Rad, and mm over a metre: when Newton's steps have ended."""
MOST_JOINT_RAD = np.radians(5.0)
MOST_JOINT_MM = 50.0
"""A joint that a correction moves farther leaves its branch or is near a singular pose, where errors of the robot are no small changes."""

NO_POSE = "no pose of the nominal or the identified robot has these joint values"
BETWEEN = 9
"""Joint values between nominal and corrected ones at which the branch is looked at."""


@dataclass(frozen=True)
class Limits:
    """most_mm, most_rad: largest correction of the flange; clip: shorten larger ones instead of refusing them; keep_out: boxes (3, 2) in
    the robot's base frame in which the tool's origin must not be [mm]."""

    most_mm: float = 5.0
    most_rad: float = float(np.radians(1.0))
    clip: bool = False
    keep_out: tuple[FloatArray, ...] = ()


@dataclass(frozen=True)
class Correction:
    """Of one target. before, joints (n,): joint values told and corrected; wanted, flange (7,): nominal poses of both; size_mm, size_rad:
    by how much the told pose changes; left_mm, left_rad: by how much the identified robot then is off, not nothing where it was clipped or
    has fewer joints than a pose; was_mm: the same without correction; refused: why it stays as it was, empty where it does not."""

    before: FloatArray
    joints: FloatArray
    wanted: FloatArray
    flange: FloatArray
    size_mm: float
    size_rad: float
    was_mm: float
    left_mm: float
    left_rad: float
    clipped: bool
    refused: str


def correct(nominal: RobotModel, found: RobotModel, joints: FloatArray, limits: Limits) -> Correction:
    """The correction of the target that the nominal robot reaches at joint values (n,).

    RobotError where the nominal or the identified robot has no pose there, as a platform at lengths that do not close.
    """
    wanted = nominal.forward(joints[None])[0]
    if not np.isfinite([wanted, found.forward(joints[None])[0]]).all():
        raise RobotError(NO_POSE)
    solved, off = _solved(found, joints, wanted)
    told = nominal.forward(solved[None])[0]
    change = se3.displacement(told, wanted)
    size_mm, size_rad = float(np.linalg.norm(change[3:])), float(np.linalg.norm(change[:3]))
    refused, clipped = _refused(nominal, found, joints, solved, off=off), False
    if not refused and (size_mm > limits.most_mm or size_rad > limits.most_rad):
        refused, clipped = ("", True) if limits.clip else (too_large(change, limits), False)
    while clipped and (size_mm > limits.most_mm or size_rad > limits.most_rad):
        # joints do not shorten quite as places do: once more where a little is left
        part = min(limits.most_mm / max(size_mm, 1e-300), limits.most_rad / max(size_rad, 1e-300))
        solved = joints + 0.999999 * part * (solved - joints)
        told = nominal.forward(solved[None])[0]
        change = se3.displacement(told, wanted)
        size_mm, size_rad = float(np.linalg.norm(change[3:])), float(np.linalg.norm(change[:3]))
    if refused:
        solved, told = joints, wanted
        size_mm = size_rad = 0.0
    at = se3.displacement(found.forward(solved[None])[0], wanted)
    was = se3.displacement(found.forward(joints[None])[0], wanted)
    left = float(np.linalg.norm(at[3:])), float(np.linalg.norm(at[:3]))
    return Correction(joints, solved, wanted, told, size_mm, size_rad, float(np.linalg.norm(was[3:])), *left, clipped, refused)


def too_large(change: FloatArray, limits: Limits) -> str:
    """Why a change (6,) of what is told is refused; empty where it is not too large."""
    size_mm, size_rad = float(np.linalg.norm(change[3:])), float(np.linalg.norm(change[:3]))
    if size_mm <= limits.most_mm and size_rad <= limits.most_rad:
        return ""
    most = f"{limits.most_mm:g} mm and {np.degrees(limits.most_rad):g} deg are the most"
    return f"a correction of {size_mm:.3f} mm and {np.degrees(size_rad):.3f} deg; {most}"


def in_keep_out(limits: Limits, places: FloatArray) -> int | None:
    """The first of places (k, 3) [mm, base frame], taken as the corners of one way, from which on the way is in a box; None where it is in
    none. Ways between targets are taken as straight, which a controller's joint motions are not."""
    for i, place in enumerate(places):
        before = places[max(i - 1, 0)]
        if any(_crosses(box, before, place) for box in limits.keep_out):
            return i
    return None


def ways(nominal: RobotModel, flange: FloatArray, near: FloatArray | None) -> FloatArray:
    """(k, n) joint values that take the nominal flange to a pose (7,), with the whole turns within the limits that are nearest to joint
    values (n,) where those are given; the nearest first."""
    found = nominal.inverse(flange)
    if near is None or not len(found):
        return found
    low, high = nominal.limits
    turns = np.where(nominal.sliding, 0.0, np.round((near - found) / (2.0 * np.pi)))
    turned = found + 2.0 * np.pi * turns
    turned = np.where((turned >= low) & (turned <= high), turned, found)
    away = np.where(nominal.sliding, 0.0, turned - near)
    return np.asarray(turned[np.argsort(np.abs(away).max(axis=1), kind="stable")])


def whole_turns(nominal: RobotModel, joints: FloatArray) -> FloatArray:
    """(k, n) joint values that differ from (n,) by whole turns of turning joints, all that the limits allow."""
    low, high = nominal.limits
    every = []
    for value, least, most, slides in zip(joints, low, high, nominal.sliding, strict=True):
        first, last = math.ceil((least - value) / (2.0 * math.pi) - 1e-12), math.floor((most - value) / (2.0 * math.pi) + 1e-12)
        every.append([value] if slides else [value + 2.0 * math.pi * turn for turn in range(first, last + 1)])
    return np.array(list(itertools.product(*every))).reshape(-1, len(joints))


def fits(dialect: str, flags: Mapping[str, int], robot: RobotModel, joints: FloatArray, *, slack_deg: float = 1e-6) -> bool:
    """Whether joint values (n,) are those that a target's configuration says, as far as it can be told of this robot; signs and quarters
    that change within slack_deg of a joint are not held against them.

    krl: bit i of T is set where axis i + 1 is negative; bit 0 of S behind the first axis, bit 1 with the elbow up. rapid: cf1, cf4, cf6
    are the quarters of axes 1, 4, 6, floor(q / 90 degrees); cfx 4 and more behind the first axis, odd where axis 5 is negative. fanuc:
    whole turns of axes 4, 5, 6 or 1, 4, 6, as the controller is set ($TURN_AXIS), T in front of the first axis, U with the elbow up; of N
    and F it is not known which way axis 5 counts. Where the arm stands is told of elbow arms with a spherical wrist alone.
    """
    if not isinstance(robot, SerialRobot) or robot.sliding.any() or len(joints) != 6:
        return True
    q = np.degrees(joints)
    arm = _arm(robot, joints) if robot.arm.is_elbow else None
    if dialect == "krl" and {"S", "T"} <= set(flags):
        turned = all(bool(flags["T"] >> i & 1) == bool(q[i] < 0.0) or abs(q[i]) < slack_deg for i in range(6))
        return turned and (arm is None or (bool(flags["S"] & 1), bool(flags["S"] & 2)) == arm)
    if dialect == "rapid" and "cf1" in flags:
        quarters = all(
            int(np.floor(q[i] / 90.0)) == flags[key] or _at_quarter(q[i], slack_deg) for key, i in (("cf1", 0), ("cf4", 3), ("cf6", 5))
        )
        wrist = bool(flags["cfx"] & 1) == bool(q[4] < 0.0) or abs(q[4]) < slack_deg
        return quarters and (arm is None or ((flags["cfx"] >= 4) == arm[0] and wrist))
    if dialect == "fanuc" and "turn1" in flags:
        whole = np.sign(q) * ((np.abs(q) + 180.0) // 360.0)
        stated = [flags[f"turn{k}"] for k in (1, 2, 3)]
        turns = any(np.array_equal(whole[list(axes)], stated) for axes in ((3, 4, 5), (0, 3, 5)))
        return turns and (arm is None or (not bool(flags["front"]), bool(flags["up"])) == arm)
    return True


def _arm(robot: SerialRobot, joints: FloatArray) -> tuple[bool, bool]:
    """(behind, up): whether the wrist's centre is behind the first axis, as its joint is turned, and whether the elbow is bent upwards."""
    points, along = robot.arm.axes(joints[None])
    shoulder, elbow, wrist = (points[0, i] for i in (1, 2, 4))
    up, side = along[0, 0], along[0, 1]
    # the second axis points to the left or to the right of an arm that faces forward at zero
    _, zero_along = robot.arm.axes(np.zeros((1, 6)))
    forward = np.cross(side, up)
    ahead = np.cross(zero_along[0, 1], zero_along[0, 0]) @ se3.matrices(robot.arm.foot)[:, 0]
    forward = forward if ahead > 0.0 else -forward
    way = wrist - points[0, 0]
    bent = np.cross(elbow - shoulder, wrist - shoulder) @ np.cross(forward, up)
    return bool(way @ forward < 0.0), bool(bent < 0.0)


def _at_quarter(degrees: float, slack_deg: float) -> bool:
    return abs(degrees - 90.0 * round(degrees / 90.0)) < slack_deg


def _solved(found: RobotModel, joints: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Joint values (n,) at which the robot is where it is wanted, and what is left (6,); NaN where steps led to values that no pose has."""
    solved = joints.copy()
    for _ in range(STEPS):
        pose, rows = _rows(found, solved[None])
        if not (np.isfinite(pose).all() and np.isfinite(rows).all()):
            break
        off = se3.displacement(wanted, pose[0])
        step = np.linalg.lstsq(rows[0].T, off / ([1.0] * 3 + [1e3] * 3), rcond=1e-9)[0]
        step = step / max(1.0, float(np.abs(step).max()) / 0.1) if not found.sliding.any() else step
        solved = solved + step
        if np.abs(step).max() < SETTLED:
            break
    pose = found.forward(solved[None])[0]
    return solved, se3.displacement(wanted, pose) if np.isfinite(pose).all() else np.full(6, np.nan)


def _rows(robot: RobotModel, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flange poses (N, 7), and derivatives (N, n, 6) by the joints: turns, and the flange's shifts in metres."""
    poses, twists, _ = robot.derivatives(joints, of=np.empty(0, dtype=np.int64))
    shifts = (twists[:, :, 3:] + np.cross(twists[:, :, :3], poses[:, None, :3])) / 1e3
    return poses, np.concatenate([twists[:, :, :3], shifts], axis=2)


def _one_branch(robot: RobotModel, joints: FloatArray, solved: FloatArray) -> bool:
    """Whether no singular pose of a robot of six joints lies between: near one, another branch is as near as the right one."""
    if len(joints) != 6:
        return True
    signs = np.sign(np.linalg.det(_rows(robot, joints + np.linspace(0.0, 1.0, BETWEEN)[:, None] * (solved - joints))[1]))
    return bool(np.all(signs == signs[0]) and signs[0] != 0.0)


def _refused(nominal: RobotModel, found: RobotModel, joints: FloatArray, solved: FloatArray, *, off: FloatArray) -> str:
    low, high = nominal.limits
    moved = np.abs(solved - joints)
    if not np.isfinite([*solved, *off]).all() or (len(joints) >= 6 and np.abs(off / ([1.0] * 3 + [1e3] * 3)).max() > 1e-6):
        return "the identified robot does not reach it"
    far = moved / np.where(nominal.sliding, MOST_JOINT_MM, MOST_JOINT_RAD)
    if far.max() > 1.0:
        j = int(np.argmax(far))
        by, unit = (moved[j], "mm") if nominal.sliding[j] else (np.degrees(moved[j]), "deg")
        return f"{nominal.joint_names[j]} would move by {by:.1f} {unit}: near a singular pose, or another branch"
    if not all(_one_branch(robot, joints, solved) for robot in (nominal, found)):
        return "a singular pose lies between the nominal and the corrected joint values: another branch"
    beyond = np.flatnonzero((solved < low) | (solved > high))
    if len(beyond):
        j = int(beyond[0])
        value, unit = (solved[j], "mm") if nominal.sliding[j] else (np.degrees(solved[j]), "deg")
        return f"{nominal.joint_names[j]} would be at {value:.4f} {unit}, beyond its limit"
    return ""


def _crosses(box: FloatArray, start: FloatArray, stop: FloatArray) -> bool:
    """Whether the straight way between two points meets a box (3, 2): slabs."""
    way = stop - start
    with np.errstate(divide="ignore", invalid="ignore"):
        first, last = (box[:, 0] - start) / way, (box[:, 1] - start) / way
    still = way == 0.0
    inside = (start >= box[:, 0]) & (start <= box[:, 1])
    enter = np.where(still, np.where(inside, -np.inf, np.inf), np.minimum(first, last))
    leave = np.where(still, np.where(inside, np.inf, -np.inf), np.maximum(first, last))
    return bool(max(enter.max(), 0.0) <= min(leave.min(), 1.0))
