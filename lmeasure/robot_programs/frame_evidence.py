"""Evidence of frames in a program: joint values and a pose of one point must lead the nominal robot to one position.

A program that states both for a point (a `qnear` of its own, a row of a table, two targets of one name) shows whether base, flange and tool
are those of its controller. Joint values typed as a rough hint lie anywhere near; wrong frames have the same error in every point.
"""

import re
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, RobotError, se3
from lmeasure.robot_programs.program import Dialect, Listing, Target
from lmeasure.robots import RobotModel
from lmeasure.text import joined, message

NOMINAL_MM, NOMINAL_PART, NOMINAL_RAD = 10.0, 0.005, np.radians(1.0)
"""Largest miss of a nominal robot at its controller's poses, in mm or parts of its reach: several times the errors of arms."""
SINGLE_MM, SINGLE_RAD = 60.0, np.radians(15.0)
"""Size from which a single hint counts: typed joint values may be rough."""
NEAR_RAD = np.radians(90.0)
"""Largest distance from a hint to the joint values of its pose."""
MOST = 60
"""Points that are compared with each other."""
_MARK = r"(?:j(?:oint|nt|p|t|pos)?s?|q|ax(?:is|es)?|p(?:os(?:e|ition)?)?|c(?:art(?:esian)?)?|x)"
_MARKED = re.compile(rf"(?:{_MARK}_)?(.*?)(?:_{_MARK})?", re.I)


@dataclass(frozen=True)
class Pair:
    """A pose target, and the joint values (n,) [rad, mm] of the same point; digit: their last written one, in units of the dialect; sure:
    the program states them, and not only as a hint."""

    target: Target
    joints: FloatArray
    digit: float
    sure: bool


@dataclass(frozen=True)
class _Compared:
    """by_joints, by_pose (7,): base_from_flange; off_mm, off_rad: between them; most_mm, most_rad: largest allowed."""

    by_joints: FloatArray
    by_pose: FloatArray
    off_mm: float
    off_rad: float
    most_mm: float
    most_rad: float

    @property
    def apart(self) -> str:
        """Return how far the two places are apart, for a message."""
        return message("program.apart", mm=self.off_mm, deg=float(np.degrees(self.off_rad)))

    @property
    def agree(self) -> bool:
        """Return whether the two are one position."""
        return self.off_mm <= self.most_mm and self.off_rad <= self.most_rad


def pairs_of(listing: Listing, dialect: Dialect, robot: RobotModel) -> dict[int, Pair]:
    """Return, by number of a pose target, the joint values of the same point, where the program states both."""
    n, out = len(robot.joint_names), dict[int, Pair]()
    hints = defaultdict(set)
    for target in listing.targets:
        if target.near:
            hints[target.near].add(target.values)
    named: dict[str, dict[bool, list[int]]] = defaultdict(lambda: {True: [], False: []})
    for i, target in enumerate(listing.targets):
        if len(target.near) == n and not target.joints and (target.taught or len(hints[target.near]) == 1):
            # in a row with both, the joint values are the next target
            written = _written(listing, listing.targets[i + 1]) if target.taught else [f"{v:.9g}" for v in target.near]
            out[i] = Pair(target, joint_values(target.near, dialect, robot), _digit(written), target.taught)
        point = _point(target.label or target.name)
        if point:
            named[point][target.joints].append(i)
    for both in named.values():
        if len(both[True]) == len(both[False]) == 1 and both[False][0] not in out:
            by_joints, by_pose = listing.targets[both[True][0]], listing.targets[both[False][0]]
            if len(by_joints.values) == n:
                same = (by_joints.label or by_joints.name) == (by_pose.label or by_pose.name)
                joints = joint_values(by_joints.values, dialect, robot)
                out[both[False][0]] = Pair(by_pose, joints, _digit(_written(listing, by_joints)), same)
    return out


def contradicted(listing: Listing, dialect: Dialect, robot: RobotModel, *, single: bool = True) -> dict[int, str]:
    """Return, by index of a pose target, why it contradicts the joint values of its point while others agree with theirs.

    RobotError if frames explain most points, or nothing does. single: whether one hint alone counts.
    """
    pairs = pairs_of(listing, dialect, robot)
    known = {i: c for i, pair in pairs.items() if (c := _compared(pair, listing, dialect, robot)) is not None}
    off = [i for i, c in known.items() if not c.agree]
    if not off:
        return {}
    sure = [i for i in known if pairs[i].sure]
    sure_off = [i for i in sure if not known[i].agree]
    if len(off) > 0.5 * len(known):
        frame = _frame(list(known.values()))
        if frame is not None and (len(known) > 1 or sure or (single and _large(known[off[0]]))):
            raise RobotError(_refusal(listing, pairs[off[0]], known[off[0]], len(off), len(known), frame=frame))
        if len(sure_off) > 0.5 * len(sure) and sure:
            said = _refusal(listing, pairs[sure_off[0]], known[sure_off[0]], len(sure_off), len(sure), frame=None)
            raise RobotError(joined((said, *_level(list(pairs.values()), listing, dialect, robot))))
    return {i: message("program.not_one_place", apart=known[i].apart) for i in sure_off}


def _level(pairs: Sequence[Pair], listing: Listing, dialect: Dialect, robot: RobotModel) -> tuple[str, ...]:
    """Report if the program counts the third axis from the horizontal, as FANUC controllers do, and the robot does not."""
    for sign in (1.0, -1.0) if len(robot.joint_names) == 6 and not robot.sliding.any() else ():
        turned = [replace(p, joints=p.joints + sign * p.joints[1] * np.eye(6)[2]) for p in pairs]
        compared = [_compared(p, listing, dialect, robot) for p in turned]
        if all(c is not None and c.agree for c in compared):
            names = robot.joint_names
            return (message("robot_programs.from_horizontal", third=names[2], second=names[1], by=sign),)
    return ()


def _large(compared: _Compared) -> bool:
    return compared.off_mm > SINGLE_MM + compared.most_mm or compared.off_rad > SINGLE_RAD + compared.most_rad


def _point(name: str) -> str:
    """Return the name of a point, without the marks of joint values and poses; empty where that is no name."""
    plain = re.sub(r"^[jpqx](?=[A-Z][a-z])", "", name)
    match = _MARKED.fullmatch(plain)
    point = (match[1] if match else plain).lower()
    return point if re.search(r"[a-z]", point) and " " not in name and "[" not in name else ""


def joint_values(values: Sequence[float], dialect: Dialect, robot: RobotModel) -> FloatArray:
    """Return joint values (n,) [rad, mm] of those in the units of a dialect."""
    return np.where(robot.sliding, values, np.array(values) * dialect.joint_size)


def _compared(pair: Pair, listing: Listing, dialect: Dialect, robot: RobotModel) -> _Compared | None:
    """The two places of a point, and how far apart they may be: nominal errors, and the digits with which they are written."""
    target = pair.target
    poses, twists, _ = robot.derivatives(pair.joints[None], of=np.empty(0, dtype=np.int64))
    if not np.isfinite(poses).all():
        return None
    reported = se3.compose(listing.frames[target.base], dialect.pose(target.values))
    by_pose = se3.compose(reported, se3.inverse(listing.frames[target.tool]))
    half, units = 0.5 * pair.digit, np.where(robot.sliding, 1.0, dialect.joint_size)
    shifts = twists[0, :, 3:] + np.cross(twists[0, :, :3], poses[0, :3])
    rounding_mm = half * float(units @ np.linalg.norm(shifts, axis=1))
    rounding_rad = half * float(units @ np.linalg.norm(twists[0, :, :3], axis=1))
    reach = robot.reach_mm if np.isfinite(robot.reach_mm) else 0.0
    change = se3.displacement(by_pose, poses[0])
    off_mm, off_rad = float(np.linalg.norm(by_pose[:3] - poses[0, :3])), float(np.linalg.norm(change[:3]))
    return _Compared(
        poses[0], by_pose, off_mm, off_rad, max(NOMINAL_MM, NOMINAL_PART * reach) + rounding_mm, float(NOMINAL_RAD) + rounding_rad
    )


def _written(listing: Listing, target: Target) -> list[str]:
    """The numbers of a target as they are written."""
    return [listing.sources[target.source].text[slice(*span)] for span in target.spans]


def _digit(numbers: Iterable[str]) -> float:
    """The last digit of the numbers that has the most decimals."""
    decimals = [0]
    for number in numbers:
        mantissa, _, exponent = number.replace(",", ".").lower().partition("e")
        decimals.append(len(mantissa.partition(".")[2]) - int(exponent or 0))
    return 10.0 ** -max(decimals)


def _frame(known: Sequence[_Compared]) -> tuple[str, FloatArray] | None:
    """The one of base and flange that is wrong by the same (7,) in most points; None where neither is."""
    known = known[:MOST]
    best: tuple[float, str, FloatArray] | None = None
    for name in ("base", "flange"):
        for c in known:
            if name == "base":
                wrong = se3.compose(c.by_pose, se3.inverse(c.by_joints))
                explained = [se3.compose(wrong, k.by_joints) for k in known]
            else:
                wrong = se3.compose(se3.inverse(c.by_joints), c.by_pose)
                explained = [se3.compose(k.by_joints, wrong) for k in known]
            left = [(e - k.by_pose)[:3] for e, k in zip(explained, known, strict=True)]
            turns = [float(np.linalg.norm(se3.displacement(e, k.by_pose)[:3])) for e, k in zip(explained, known, strict=True)]
            size = [float(np.linalg.norm(v)) for v in left]
            good = [s <= k.most_mm and t <= k.most_rad for s, t, k in zip(size, turns, known, strict=True)]
            # of two equal explanations, as for a single point, the one nearer to usual mistakes of frames
            score = float(np.sum(good)) - 1e-3 * float(np.median(size)) / 1e3 - (1e-2 if _strange(wrong) else 0.0)
            if sum(good) > 0.8 * len(known) and (best is None or score > best[0]):
                best = score, name, wrong
    return None if best is None else best[1:]


def _strange(wrong: FloatArray) -> bool:
    """Return whether a frame is turned by other than quarter turns."""
    return bool(np.abs(se3.matrices(wrong) - np.round(se3.matrices(wrong))).max() > 0.03)


def _refusal(listing: Listing, pair: Pair, compared: _Compared, count: int, of: int, *, frame: tuple[str, FloatArray] | None) -> str:
    target = pair.target
    where = f"{listing.sources[target.source].name}:{target.line}: {target.name}"
    begin = message("robot_programs.flange_elsewhere", where=where, apart=compared.apart, count=count, of=of)
    if frame is None:
        return joined((begin, message("robot_programs.unexplained")))
    name, wrong = frame
    shift, turn = (np.round(v, 1) + 0.0 for v in (wrong[:3], Rotation.from_quat(wrong[3:]).as_rotvec(degrees=True)))
    by = {"shift": tuple(map(float, shift)), "turn": tuple(map(float, turn))}
    if name == "base":
        return joined((begin, message("robot_programs.other_base", frame=target.base, **by)))
    return joined((begin, message("robot_programs.other_flange", tool=target.tool, **by)))
