"""A program corrected for an identified robot: joint values for every target are chosen, corrected and written back; the others are
reported.

A robot that is commanded to a pose p goes to p with the error e(p); it is commanded to p* with p* + e(p*) = p, found by iteration from p.
Errors change so little over their own size that each step leaves a thousandth of the one before.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmeasure.core import DataFrame, FileFormatError, FloatArray, Shown, framed, se3
from lmeasure.io import files
from lmeasure.robot_programs.frame_evidence import NEAR_RAD, contradicted, joint_values
from lmeasure.robot_programs.program import IDENTITY, Dialect, Listing, Target, rewritten
from lmeasure.robots import (
    NO_POSE,
    Correction,
    ErrorMap,
    IdentifiedRobot,
    Limits,
    RobotModel,
    SerialRobot,
    corrections,
    in_keep_out,
    too_large,
    ways,
    whole_turns,
)
from lmeasure.text import message

AS_WRITTEN_DEG = 0.02
"""Angle by which a joint at 0 or at a quarter turn may seem to be beyond it, because positions and angles have few decimals."""


@dataclass(frozen=True)
class Outcome:
    """Outcome of a target. correction: None if no joint values for it were found or chosen; left: reason why it is unchanged, else empty;
    u95_mm: radius about the wanted position that holds 95 % of the corrected robot's positions, with the remainder after clipping; u_mm:
    standard uncertainty of that by identification alone, all coordinates together."""

    target: Target
    file: str
    correction: Correction | None
    values: tuple[float, ...]
    left: str
    u95_mm: float
    u_mm: float


@dataclass(frozen=True, repr=False)
class Corrected(Shown):
    """outcomes in the order of the listing, and the texts of its sources."""

    outcomes: tuple[Outcome, ...]
    texts: tuple[str, ...]

    def about(self) -> dict[str, str]:
        """Return how many targets are corrected, by how much, and how well the robot goes there."""
        out = {"targets": f"{len(self.outcomes)}, {self.changed} corrected"}
        sizes = [o.correction.size_mm for o in self.done if o.correction is not None]
        return out | ({"largest correction": f"{max(sizes):.3f} mm", "U95": f"{max(o.u95_mm for o in self.done):.3f} mm"} if sizes else {})

    def to_frame(self) -> DataFrame:
        """A row for each target."""
        return framed([{key: value for key, value in _record(o).items() if not isinstance(value, list)} for o in self.outcomes])

    @property
    def done(self) -> tuple[Outcome, ...]:
        """The targets that are corrected."""
        return tuple(o for o in self.outcomes if not o.left and o.correction is not None)

    @property
    def u_mm(self) -> dict[str, float]:
        """Return by a target's name the standard uncertainty by identification [mm], all coordinates together; for several targets of one
        name the largest."""
        out: dict[str, float] = {}
        for o in self.done:
            out[o.target.name] = max(o.u_mm, out.get(o.target.name, 0.0))
        return out

    @property
    def changed(self) -> int:
        """Return how many targets are corrected."""
        return sum(not o.left for o in self.outcomes)


def corrected_program(
    listing: Listing, dialect: Dialect, robot: IdentifiedRobot, *, limits: Limits, near: Sequence[float] = ()
) -> Corrected:
    """Targets in the order of the first motions to them, joint values nearest to the one before, at first to near (n,) [deg, mm] or
    to the first target of joint values. A target is unchanged if neither the configuration nor such values choose one of several solutions.

    A target in a keep-out box or on a straight path through one, for the identified robot, is unchanged too. Jumps, loops and calls are not
    followed: a path that only they make is not checked.
    """
    apart = contradicted(listing, dialect, robot.nominal, single=not len(near))
    chosen, left = _chosen([i for i in in_motion_order(listing) if i not in apart], listing, dialect, robot, near)
    left |= apart
    ready = corrections(robot.nominal, robot.seen, np.array(list(chosen.values())), limits) if chosen else []
    found = dict(zip(chosen, ready, strict=True))

    def answer(i: int) -> Answer | str:
        if i in left:
            return left[i]
        target, joints = listing.targets[i], found[i].joints[None]
        at = se3.compose(robot.seen.forward(joints)[0], listing.frames.get(target.tool, np.array(IDENTITY)))[:3]
        why = found[i].refused or _other_flags(target, dialect, found[i], robot)
        numbers = _values(target, listing, dialect, found[i], robot)
        return Answer(found[i], at, why, numbers, float(robot.u95_mm(joints)[0]), float(robot.u_mm(joints)[0]))

    return carried_out(listing, dialect, limits, answer)


def in_motion_order(listing: Listing) -> list[int]:
    """Return the indices of the targets, in the order of the first motions to them."""
    return sorted(range(len(listing.targets)), key=lambda i: listing.targets[i].moved)


@dataclass(frozen=True)
class Answer:
    """Data of a target. at (3,): where the robot goes [mm]; why: reason to leave it, may be empty; numbers: to be written."""

    correction: Correction
    at: FloatArray
    why: str
    numbers: FloatArray
    u95_mm: float
    u_mm: float


def carried_out(listing: Listing, dialect: Dialect, limits: Limits, answer: Callable[[int], Answer | str]) -> Corrected:
    """Return the program with the answers to its targets, in the order of motions; a text gives the reason for none."""
    outcomes: dict[int, Outcome] = {}
    values: dict[int, Sequence[float]] = {}
    place: FloatArray | None = None
    for i in in_motion_order(listing):
        target, found = listing.targets[i], answer(i)
        file = listing.sources[target.source].name
        if isinstance(found, str):
            outcomes[i] = Outcome(target, file, None, target.values, found, float("nan"), float("nan"))
            continue
        why = found.why
        if not why and in_keep_out(limits, np.array([found.at if place is None else place, found.at])) is not None:
            why = message("robot_programs.way_leads_through_keep")
        place = found.at
        if not why:
            values[i] = tuple(float(v) for v in found.numbers)
        u95_mm = found.u95_mm + found.correction.left_mm
        outcomes[i] = Outcome(target, file, found.correction, tuple(values.get(i, target.values)), why, u95_mm, found.u_mm)
    return Corrected(tuple(outcomes[i] for i in range(len(listing.targets))), rewritten(listing, dialect, values))


def _chosen(
    order: Sequence[int], listing: Listing, dialect: Dialect, robot: IdentifiedRobot, near: Sequence[float]
) -> tuple[dict[int, FloatArray], dict[int, str]]:
    """Return by target the joint values at which the controller reaches it, each nearest to those before; and the reasons for targets
    without any."""
    chosen: dict[int, FloatArray] = {}
    left: dict[int, str] = {}
    last = _first(listing, dialect, robot, near)
    for i in order:
        joints, left[i] = _joints(listing.targets[i], listing, dialect, robot, last)
        if joints is not None and not np.isfinite([m.forward(joints[None])[0] for m in (robot.nominal, robot.seen)]).all():
            joints, left[i] = None, NO_POSE
        if joints is not None:
            chosen[i] = last = joints
            del left[i]
    return chosen, left


def _first(listing: Listing, dialect: Dialect, robot: IdentifiedRobot, near: Sequence[float]) -> FloatArray | None:
    if len(near):
        return np.where(robot.nominal.sliding, near, np.radians(near))
    for target in (listing.targets[i] for i in in_motion_order(listing)):
        if target.joints and len(target.values) == len(robot.nominal.joint_names):
            return joint_values(target.values, dialect, robot.nominal)
    return None


def _joints(
    target: Target, listing: Listing, dialect: Dialect, robot: IdentifiedRobot, last: FloatArray | None
) -> tuple[FloatArray | None, str]:
    """The joint values at which the controller reaches a target, or why they are not known."""
    low, high = robot.nominal.limits
    if target.joints:
        if len(target.values) != len(low):
            return None, message("robot_programs.joint_values_robot_has", n=len(target.values), of=len(low))
        joints = joint_values(target.values, dialect, robot.nominal)
        return (
            (joints, "")
            if ((joints >= low - 1e-9) & (joints <= high + 1e-9)).all()
            else (None, message("robot_programs.beyond_limits_joints"))
        )
    if target.near:
        if len(target.near) != len(low):
            return None, message("program.beside", n=len(target.near), of=len(low))
        last = joint_values(target.near, dialect, robot.nominal)
    flange = se3.compose(listing.frames[target.base], dialect.pose(target.values))
    found = ways(robot.nominal, se3.compose(flange, se3.inverse(listing.frames[target.tool])), last)
    if not len(found):
        return None, message("robot_programs.out_nominal_robots_reach")
    if target.near and last is not None and not target.taught:
        away = np.where(robot.nominal.sliding, 0.0, np.abs(found - last)).max(axis=1)
        if away.min() > NEAR_RAD:
            return None, message("robot_programs.none_ways_within_90", n=len(found))
    if target.flags:
        # a configuration may state whole turns, not always those nearest to the previous target
        every = [q for way in found for q in whole_turns(robot.nominal, way)]
        found = np.array(sorted(every, key=lambda q: 0.0 if last is None else float(np.abs(q - last).max())))
    fitting = [q for q in found if fits(dialect, target.flags, robot.nominal, q, slack_deg=AS_WRITTEN_DEG)]
    if target.loose and last is not None:
        # nearest to the previous position, unless the program states another
        if fitting and not np.array_equal(fitting[0], found[0]):
            return None, message("robot_programs.configuration_may_not_hold")
        return found[0], ""
    if target.loose and len(found) > 1:
        return None, message("robot_programs.configuration_may_not_hold_confj")
    if not fitting:
        return None, message("robot_programs.none_ways_has_configuration", n=len(found))
    if last is None and len(fitting) > 1:
        return None, message("robot_programs.ways_lead_nothing_says", n=len(fitting))
    return fitting[0], ""


def _other_flags(target: Target, dialect: Dialect, found: Correction, robot: IdentifiedRobot) -> str:
    if target.joints or target.loose or fits(dialect, target.flags, robot.nominal, found.joints):
        return ""
    return message("robot_programs.corrected_would_have_another")


def _values(target: Target, listing: Listing, dialect: Dialect, found: Correction, robot: IdentifiedRobot) -> FloatArray:
    """The numbers to be written."""
    if target.joints:
        return np.where(robot.nominal.sliding, found.joints, found.joints / dialect.joint_size)
    pose = se3.compose(se3.compose(se3.inverse(listing.frames[target.base]), found.flange), listing.frames[target.tool])
    return dialect.numbers(pose, target.values)


def as_record(found: Corrected, listing: Listing, frames: Mapping[str, FloatArray]) -> dict[str, object]:
    """The content of corrections.json."""
    return {
        "schema": "lmeasure.corrections/1",
        "targets": [_record(o) for o in found.outcomes],
        "corrected": found.changed,
        "unread": [{"file": u.file, "line": u.line, "text": u.text} for u in listing.unread],
        "frames": {name: {"position_mm": row[:3].tolist(), "quaternion_xyzw": row[3:].tolist()} for name, row in frames.items()},
    }


def _record(o: Outcome) -> dict[str, object]:
    out: dict[str, object] = {"name": o.target.name, "file": o.file, "line": o.target.line, "left": o.left or None}
    out |= {"values": list(o.target.values), "corrected_values": list(o.values)}
    if o.correction is not None:
        c = o.correction
        out |= {"size_mm": c.size_mm, "size_deg": float(np.degrees(c.size_rad)), "error_before_mm": c.was_mm, "error_left_mm": c.left_mm}
        out |= {"clipped": c.clipped, "u95_mm": None if np.isnan(o.u95_mm) else o.u95_mm, "u_identified_mm": o.u_mm}
    return out


def identified_mm(path: Path) -> dict[str, float]:
    """`Corrected.u_mm` of a corrections.json; FileFormatError where it is none."""
    out: dict[str, float] = {}
    raw = files.read_bytes(path)
    try:
        for row in json.loads(raw)["targets"]:
            if not row["left"]:
                out[str(row["name"])] = max(float(row["u_identified_mm"]), out.get(str(row["name"]), 0.0))
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise FileFormatError(message("error.not_what_lmeasure_correct", where=path, error=error)) from None
    return out


def fits(dialect: Dialect, flags: Mapping[str, int], robot: RobotModel, joints: FloatArray, *, slack_deg: float = 1e-6) -> bool:
    """Return whether joint values (n,) have the configuration that a target states, as far as this robot shows it.

    Signs and quarters that change within slack_deg of a joint are not compared. Only elbow arms with a spherical wrist show where the arm
    is.
    """
    if not flags or dialect.configured is None or not isinstance(robot, SerialRobot) or robot.sliding.any() or len(joints) != 6:
        return True
    arm = _arm(robot, joints) if robot.arm.is_elbow else None
    return dialect.configured(flags, np.degrees(joints), arm, slack_deg)


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


STEPS = 50
SETTLED = 1e-9
SAME_MM, SAME_RAD = 0.01, 1e-4
"""Differences of a program's tool from the map's up to which they are the same."""


def mapped_program(listing: Listing, dialect: Dialect, errors: ErrorMap, *, limits: Limits, tool: FloatArray | None = None) -> Corrected:
    """Targets in the order of the first motions to them. tool (7,): pose of the measured target on the flange; targets with another
    tool are unchanged, and with None every tool counts as that one."""

    def answer(i: int) -> Answer | str:
        target = listing.targets[i]
        if why := _unfit(target, listing, tool):
            return why
        base = listing.frames[target.base]
        wanted = se3.compose(base, dialect.pose(target.values))
        found = _corrected(wanted, errors, limits)
        numbers = dialect.numbers(se3.compose(se3.inverse(base), found.flange), target.values)
        at = _known(errors, found.flange)[None]
        return Answer(found, wanted[:3], found.refused, numbers, float(errors.u95_mm(at)[0]), float(errors.u_mm(at)[0]))

    return carried_out(listing, dialect, limits, answer)


def _unfit(target: Target, listing: Listing, tool: FloatArray | None) -> str:
    """Return why the map does not apply to a target."""
    if target.joints:
        return message("robot_programs.joint_values_map_knows")
    if tool is None:
        return ""
    off = se3.displacement(listing.frames[target.tool], tool)
    if np.linalg.norm(off[3:]) <= SAME_MM and np.linalg.norm(off[:3]) <= SAME_RAD:
        return ""
    return message("robot_programs.tool_not_one_map", tool=target.tool)


def _known(errors: ErrorMap, pose: FloatArray) -> FloatArray:
    """A pose as the map knows poses: without an orientation where it has none."""
    return pose if errors.turned else np.concatenate([pose[:3], [0.0, 0.0, 0.0, 1.0]])


def _corrected(wanted: FloatArray, errors: ErrorMap, limits: Limits) -> Correction:
    nothing = np.zeros(0)
    was = errors.errors(_known(errors, wanted)[None])[0]
    reported, step = wanted, np.inf
    for _ in range(STEPS):
        # displacements act from the left: the command is the wanted pose minus the error that it will have
        after = se3.displaced(wanted, -errors.errors(_known(errors, reported)[None])[0])
        step, reported = float(np.abs(se3.displacement(after, reported)).max()), after
        if step < SETTLED:
            break
    refused = errors.outside(_known(errors, wanted)) or errors.outside(_known(errors, reported))
    if not refused and step >= SETTLED:
        refused = message("robot_programs.errors_change_too_much")
    change, clipped = se3.displacement(reported, wanted), False
    if not refused and (why := too_large(change, limits)):
        if limits.clip:
            size = np.array([np.linalg.norm(change[3:]), np.linalg.norm(change[:3])])
            change = change * float((np.array([limits.most_mm, limits.most_rad]) / np.maximum(size, 1e-300)).min())
            reported, clipped = se3.displaced(wanted, change), True
        else:
            refused = why
    if refused:
        reported, change = wanted, np.zeros(6)
    left = se3.displacement(se3.displaced(reported, errors.errors(_known(errors, reported)[None])[0]), wanted)
    size_mm, size_rad, was_mm, left_mm = (float(np.linalg.norm(part)) for part in (change[3:], change[:3], was[3:], left[3:]))
    return Correction(nothing, nothing, wanted, reported, size_mm, size_rad, was_mm, left_mm, clipped, refused)
