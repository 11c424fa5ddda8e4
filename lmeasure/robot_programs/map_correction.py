"""A program corrected by a map of measured errors: for who has no model of the robot, where the map tells something and nowhere else.

A robot that is commanded to a pose p goes to p with the error e(p); it is commanded to p* with p* + e(p*) = p, found by going on from p.
Errors change so little over their own size that each step leaves a thousandth of the one before.
"""

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.robot_programs.correction import Answer, Corrected, carried_out
from lmeasure.robot_programs.program import Dialect, Listing, Target
from lmeasure.robots import Correction, ErrorMap, Limits, too_large
from lmeasure.text import message

STEPS = 50
SETTLED = 1e-9
SAME_MM, SAME_RAD = 0.01, 1e-4
"""By which a program's tool may differ from the one that the map was measured with."""


def mapped_program(listing: Listing, dialect: Dialect, errors: ErrorMap, *, limits: Limits, tool: FloatArray | None = None) -> Corrected:
    """Targets in the order in which first motions to them stand. tool (7,): where the measured target sat on the flange; a target given
    with another is left, and with None every tool is taken for that one."""

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
    """Why a map cannot be asked about a target."""
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
