"""Corrected commands: joint values at which the identified robot is where the nominal one was meant to be, and the commands of a
controller.

A controller knows the nominal robot. Commanded to a pose, it goes to joint values q with nominal(q) = pose, and the real flange is at
found(q). Corrected joint values q* solve found(q*) = nominal(q) by Newton's method from q, which stays on q's branch; the pose that makes
the controller go to them is nominal(q*). What is left is how well the robot is known and how well it repeats.
"""

import itertools
import math
from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray, FloatArray, RobotError, se3
from lmeasure.robots.model import RobotModel, joint_value
from lmeasure.text import message

STEPS = 30
SETTLED = 1e-10
"""Rad, and mm over a metre: when Newton's steps have ended."""
MOST_JOINT_RAD = np.radians(5.0)
MOST_JOINT_MM = 50.0
"""A joint that a correction moves farther leaves its branch or is near a singular pose, where errors of the robot are no small changes."""

NO_POSE = message("robots.no_pose_nominal_identified")
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
    """Correction of one target. before, joints (n,): commanded and corrected joint values; wanted, flange (7,): nominal poses of both;
    size_mm,
    size_rad: by how much the commanded pose changes; left_mm: by how much the identified robot then is off, not nothing where it was
    clipped or has fewer joints than a pose; was_mm: the same without correction; refused: why it stays as it was, empty where it does
    not."""

    before: FloatArray
    joints: FloatArray
    wanted: FloatArray
    flange: FloatArray
    size_mm: float
    size_rad: float
    was_mm: float
    left_mm: float
    clipped: bool
    refused: str


def correct(nominal: RobotModel, found: RobotModel, joints: FloatArray, limits: Limits) -> Correction:
    """The correction of the target that the nominal robot reaches at joint values (n,); RobotError as `corrections`."""
    return corrections(nominal, found, joints[None], limits)[0]


def corrections(nominal: RobotModel, found: RobotModel, joints: FloatArray, limits: Limits) -> list[Correction]:
    """The corrections of N targets that the nominal robot reaches at joint values (N, n), each for itself and all at once.

    RobotError where the nominal or the identified robot has no pose at some, as a platform at lengths that do not close.
    """
    wanted, was = nominal.forward(joints), found.forward(joints)
    if not np.isfinite([wanted, was]).all():
        raise RobotError(NO_POSE)
    solved, off = _solved(found, joints, wanted)
    refused = _refused(nominal, found, joints, solved, off=off)
    solved = np.where(np.array([bool(why) for why in refused])[:, None], joints, solved)
    determined = nominal.forward(solved)
    clipped = np.zeros(len(joints), np.bool_)
    for i, (told_at, aim) in enumerate(zip(determined, wanted, strict=True)):
        if not np.isfinite(told_at).all():
            refused[i] = NO_POSE
        elif not refused[i] and (why := too_large(se3.displacement(told_at, aim), limits)):
            if limits.clip:
                clipped[i], solved[i] = True, _shortened(nominal, joints[i], solved[i], wanted=aim, limits=limits)
            else:
                refused[i] = why
    kept = np.array([not why for why in refused])[:, None]
    solved = np.where(kept, solved, joints)
    determined = np.where(kept, nominal.forward(solved), wanted)
    at = found.forward(solved)
    size_mm, size_rad = _sizes(se3.displacement(determined, wanted))
    left_mm, _ = _sizes(se3.displacement(at, wanted))
    was_mm, _ = _sizes(se3.displacement(was, wanted))
    columns = (joints, solved, wanted, determined, size_mm, size_rad, was_mm, left_mm, clipped.tolist(), refused)
    return [Correction(*row) for row in zip(*columns, strict=True)]


def _sizes(changes: FloatArray) -> tuple[list[float], list[float]]:
    """Shifts (N,) [mm] and turns (N,) [rad] of displacements (N, 6)."""
    return np.linalg.norm(changes[:, 3:], axis=1).tolist(), np.linalg.norm(changes[:, :3], axis=1).tolist()


def _shortened(nominal: RobotModel, joints: FloatArray, solved: FloatArray, *, wanted: FloatArray, limits: Limits) -> FloatArray:
    """Joint values (n,) on the way from the commanded to the corrected ones at which the commanded pose changes by no more than is
    allowed."""
    while too_large(change := se3.displacement(nominal.forward(solved[None])[0], wanted), limits):
        size = np.array([np.linalg.norm(change[3:]), np.linalg.norm(change[:3])])
        # joints do not shorten quite as places do: once more where a little is left
        part = float((np.array([limits.most_mm, limits.most_rad]) / np.maximum(size, 1e-300)).min())
        solved = joints + 0.999999 * min(part, 1.0) * (solved - joints)
    return solved


def too_large(change: FloatArray, limits: Limits) -> str:
    """Why a change (6,) of the command is refused; empty where it is not too large."""
    size_mm, size_rad = float(np.linalg.norm(change[3:])), float(np.linalg.norm(change[:3]))
    if size_mm <= limits.most_mm and size_rad <= limits.most_rad:
        return ""
    most = {"most_mm": limits.most_mm, "most_deg": float(np.degrees(limits.most_rad))}
    return message("robots.correction_limit", mm=size_mm, deg=float(np.degrees(size_rad)), **most)


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


def _solved(found: RobotModel, joints: FloatArray, wanted: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Joint values (N, n) at which the robot is where it is wanted, and what is left (N, 6); NaN where steps led to values that no pose
    has."""
    solved, scale = joints.copy(), np.array([1.0] * 3 + [1e3] * 3)
    on = np.arange(len(joints))
    for _ in range(STEPS):
        pose, rows = _rows(found, solved[on])
        there = np.isfinite(pose).all(axis=1) & np.isfinite(rows).all(axis=(1, 2))
        on, rows = on[there], rows[there]
        off = se3.displacement(wanted[on], pose[there]) / scale
        step = np.einsum("nij,ni->nj", np.linalg.pinv(rows, rcond=1e-9), off)
        largest = np.abs(step).max(axis=1)
        if not found.sliding.any():
            step = step / np.maximum(1.0, largest / 0.1)[:, None]
        solved[on] += step
        on = on[np.abs(step).max(axis=1) >= SETTLED]
        if not len(on):
            break
    pose = found.forward(solved)
    there = np.isfinite(pose).all(axis=1)
    left = np.full((len(joints), 6), np.nan)
    left[there] = se3.displacement(wanted[there], pose[there])
    return solved, left


def _rows(robot: RobotModel, joints: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Flange poses (N, 7), and derivatives (N, n, 6) by the joints: turns, and the flange's shifts in metres."""
    poses, twists, _ = robot.derivatives(joints, of=np.empty(0, dtype=np.int64))
    shifts = (twists[:, :, 3:] + np.cross(twists[:, :, :3], poses[:, None, :3])) / 1e3
    return poses, np.concatenate([twists[:, :, :3], shifts], axis=2)


def _one_branch(robot: RobotModel, joints: FloatArray, solved: FloatArray) -> BoolArray:
    """(N,) whether no singular pose of a robot of six joints lies between: near one, another branch is as near as the right one."""
    count, n = joints.shape
    if n != 6:
        return np.ones(count, np.bool_)
    between = joints[:, None] + np.linspace(0.0, 1.0, BETWEEN)[:, None] * (solved - joints)[:, None]
    signs = np.sign(np.linalg.det(_rows(robot, between.reshape(-1, n))[1])).reshape(count, BETWEEN)
    return np.asarray((signs == signs[:, :1]).all(axis=1) & (signs[:, 0] != 0.0))


def _refused(nominal: RobotModel, found: RobotModel, joints: FloatArray, solved: FloatArray, *, off: FloatArray) -> list[str]:
    """Why each correction cannot be; empty where it can."""
    low, high = nominal.limits
    moved = np.abs(solved - joints)
    lost = np.asarray(~np.isfinite(np.hstack([solved, off])).all(axis=1))
    if joints.shape[1] >= 6:
        lost |= np.abs(off / ([1.0] * 3 + [1e3] * 3)).max(axis=1) > 1e-6
    far = moved / np.where(nominal.sliding, MOST_JOINT_MM, MOST_JOINT_RAD)
    near = np.flatnonzero(~lost & (far.max(axis=1) <= 1.0))
    one = np.zeros(len(joints), np.bool_)
    one[near] = _one_branch(nominal, joints[near], solved[near]) & _one_branch(found, joints[near], solved[near])
    out: list[str] = []
    for i, at in enumerate(solved):
        beyond = np.flatnonzero((at < low) | (at > high))
        if lost[i]:
            out.append(message("robots.identified_robot_does_not"))
        elif far[i].max() > 1.0:
            j = int(np.argmax(far[i]))
            by, unit = joint_value(nominal, j, moved[i, j])
            out.append(message("robots.would_move_near_singular", joint=nominal.joint_names[j], size=by, unit=unit))
        elif not one[i]:
            out.append(message("robots.singular_pose_lies_between"))
        elif len(beyond):
            j = int(beyond[0])
            value, unit = joint_value(nominal, j, at[j])
            out.append(message("robots.would_beyond_limit", joint=nominal.joint_names[j], value=value, unit=unit))
        else:
            out.append("")
    return out


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
