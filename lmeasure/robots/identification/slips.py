"""Slips in the inputs: a joint with the opposite sign, degrees for radians, swapped joints, metres for millimetres.

A robot that is only built inexactly fits its measurements to some millimetres as soon as its base is known. If it does not, each usual slip
is tried: the frames are found again (`initial_frames`), and a slip is named if undoing it makes the misfit several times smaller. Two slips
are found one after the other.
"""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from lmeasure.core import FloatArray, RobotError
from lmeasure.robots.identification.measurements import Measurements, Noted, noted, sides
from lmeasure.robots.identification.unknowns import find_frames
from lmeasure.robots.parallel.file import ParallelFile
from lmeasure.robots.robot import AnyRobot, Robot
from lmeasure.robots.serial import reach_mm
from lmeasure.text import message

SUSPECT_MM, SUSPECT_PART = 8.0, 0.004
"""Misfit, absolutely and in parts of how far the measured places spread, from which slips are looked for."""
CURES = 4.0
"""Factor of the misfit at which a mistake is named."""
MOST = 3
SMALLEST_MM, LARGEST_MM = 50.0, 30_000.0
"""Reach of robots."""
SPREAD = 0.003, 2.0
"""Possible spread of measured positions, in parts of the reach."""
ENOUGH = 80
"""Rows that are tried; more give no more information about a slip."""
_Slip = Callable[[Any, Measurements], tuple[Any, Measurements]]


@dataclass(frozen=True)
class Mended:
    """A robot and measurements with the slips undone that `findings` name, and `joints`, which does the same to other joint values."""

    robot: AnyRobot
    rows: Measurements
    findings: tuple[Noted, ...]
    joints: Callable[[FloatArray], FloatArray]


def mended(robot: AnyRobot, rows: Measurements, seed: int = 0) -> Mended:
    """The robot and its measurements without the slips that explain why they do not fit; unchanged where nothing explains it."""
    some = rows.of(np.unique(np.linspace(0, len(rows) - 1, min(ENOUGH, len(rows))).round().astype(int)))
    findings: list[Noted] = []
    slips: list[_Slip] = []
    misfit = _misfit(robot, some, seed)
    while misfit > 1.0 and len(findings) < MOST:
        # impossible lengths hide everything else, and are corrected in any case
        sized = [] if findings else [pair for pair in _slips(robot, some) if _impossible(robot, some) and pair[0].code == "units"]
        sized = [(said, slip) for said, slip in sized if said.of != "joints" and not _impossible(*slip(robot, some))]
        if sized:
            said, slip = sized[0]
            robot, some = slip(robot, some)
            slips.append(slip)
            findings.append(said)
            misfit = _misfit(robot, some, seed)
            continue
        tried = [(_misfit(*slip(robot, some), seed), said, slip) for said, slip in _slips(robot, some)]
        best, said, slip = min(tried, key=lambda each: each[0])
        if not best < misfit / CURES:
            break
        robot, some = slip(robot, some)
        slips.append(slip)
        findings.append(replace(said, value=misfit / best))
        misfit = best
    for slip in slips:
        _, rows = slip(robot, rows)

    def joints(values: FloatArray) -> FloatArray:
        of = replace(rows, joints=values, names=tuple(map(str, range(len(values)))))
        for slip in slips:
            of = slip(robot, of)[1]
        return of.joints

    return Mended(robot, rows, tuple(findings), joints)


def _misfit(robot: AnyRobot, rows: Measurements, seed: int) -> float:
    """Rms of the rows with the robot as it is, in units from which slips are looked for."""
    try:
        model = robot.model
        flange = model.forward(rows.joints, rows.side)
        there = np.flatnonzero(~np.isnan(flange).any(axis=1))
        if len(there) <= 0.5 * len(rows):
            return math.inf
        rows = rows.of(there)
        frames = find_frames(flange[there], rows, seed)
    except (RobotError, np.linalg.LinAlgError):
        return math.inf
    measured = rows.position[rows.placed] if rows.placed.any() else rows.length_mm[rows.ranged, None]
    spread = float(np.sqrt(((measured - measured.mean(axis=0)) ** 2).sum(axis=1).mean()))
    # half of the rows may be outliers: judge by the others
    return frames.rms_mm / (SUSPECT_PART * max(spread, 1e-9)) if frames.rms_mm > SUSPECT_MM else 0.5 * frames.rms_mm / SUSPECT_MM


def _impossible(robot: AnyRobot, rows: Measurements) -> bool:
    """Return whether the positions spread farther than the robot reaches, or hardly at all."""
    if not rows.placed.any():
        return False
    part = float(np.linalg.norm(rows.position[rows.placed].std(axis=0))) / _size(robot)
    return not SPREAD[0] < part < SPREAD[1]


def _size(robot: AnyRobot) -> float:
    """Return how far its places can spread [mm]."""
    if isinstance(robot, Robot):
        return reach_mm(robot.arm)
    if isinstance(robot, ParallelFile):
        return robot.model.size_mm + float(np.linalg.norm(robot.tool_pose[:3]))
    return float(np.ptp(np.array([[leg.min_mm, leg.max_mm] for leg in robot.leg])) + np.linalg.norm(robot.tool_pose[:3]))


def _swapped(what: str, one: str, other: str) -> Noted:
    return noted("swapped", f"swapped.{what}", f"{one}, {other}", one=one, other=other)


def _units(what: str, unit: str, of: str) -> Noted:
    """Return the note on the units of joints, robot or measurements."""
    return noted("units", f"units.{what}", of, unit=message(f"unit.{unit}"))


def _slips(robot: AnyRobot, rows: Measurements) -> Iterator[tuple[Noted, _Slip]]:
    """Yield every slip to try, with its note."""
    names, turning, serial = robot.model.joint_names, ~robot.model.sliding, isinstance(robot, Robot)
    at = [i for i, j in enumerate(robot.joint) if j.follows is None] if isinstance(robot, Robot) else []  # joints' own links: others follow
    for name, link in zip(names, at, strict=False):
        yield noted("sign", "sign", name, joint=name), _other_way(link)
    for i, k in combinations(range(len(names)), 2):
        if turning[i] == turning[k]:
            yield _swapped("values", names[i], names[k]), _values_swapped(i, k)
            if serial:
                yield _swapped("links", names[i], names[k]), _links_swapped(at[i], at[k])
    if turning.any():
        yield noted("units", "units.joints.rad", "joints"), _joints_times(True, 180.0 / math.pi)
        yield noted("units", "units.joints.deg", "joints"), _joints_times(True, math.pi / 180.0)
        if serial:
            yield noted("units", "units.robot.rad", "robot"), _robot_times(1.0, 180.0 / math.pi)
    likely = not serial or SMALLEST_MM < _size(robot) < LARGEST_MM  # the ratio of two lengths does not show which one is wrong
    for factor, unit in ((1e3, "m"), (1e-3, "um"), (25.4, "in")) if serial else ((1e3, "m"), (25.4, "in")):
        if not serial and not turning.all():
            yield _units("lengths", unit, "joints"), _joints_times(False, factor)
        if likely:
            yield _units("places", unit, "measurements"), _places_times(factor)
        else:
            yield _units("robot", unit, "robot"), _robot_times(factor, 1.0)
    for name, link, turns in zip(names, at, turning, strict=False):
        for turn in (90.0, -90.0, 180.0) if turns else ():
            yield noted("zero", "zero", name, joint=name, turn_deg=turn), _zero(link, turn)


def _of_joint(robot: Robot, i: int, **values: float) -> Robot:
    return robot.model_copy(update={"joint": tuple(j.model_copy(update=values) if k == i else j for k, j in enumerate(robot.joint))})


def _other_way(i: int) -> _Slip:
    return lambda robot, rows: (_of_joint(robot, i, scale=-robot.joint[i].scale), rows)


def _zero(i: int, turn_deg: float) -> _Slip:
    return lambda robot, rows: (_of_joint(robot, i, theta_deg=robot.joint[i].theta_deg + turn_deg), rows)


def _with_joints(rows: Measurements, joints: FloatArray) -> Measurements:
    return replace(rows, joints=joints, side=sides(joints))


def _values_swapped(i: int, k: int) -> _Slip:
    def slip(robot: Robot, rows: Measurements) -> tuple[Robot, Measurements]:
        order = np.arange(rows.joints.shape[1])
        order[[i, k]] = k, i
        return robot, _with_joints(rows, rows.joints[:, order])

    return slip


def _links_swapped(i: int, k: int) -> _Slip:
    def slip(robot: Robot, rows: Measurements) -> tuple[Robot, Measurements]:
        joint = list(robot.joint)
        joint[i], joint[k] = (joint[k].model_copy(update={"name": joint[i].name}), joint[i].model_copy(update={"name": joint[k].name}))
        return robot.model_copy(update={"joint": tuple(joint)}), rows

    return slip


def _joints_times(turning: bool, factor: float) -> _Slip:
    """Values of the joints that turn, or of those that slide."""
    return lambda robot, rows: (robot, _with_joints(rows, rows.joints * np.where(robot.model.sliding != turning, factor, 1.0)))


def _robot_times(lengths: float, angles: float) -> _Slip:
    def slip(robot: Robot, rows: Measurements) -> tuple[Robot, Measurements]:
        joint = []
        for j in robot.joint:
            values = {key: getattr(j, key) * lengths for key in ("d_mm", "a_mm")}
            values |= {key: getattr(j, key) * angles for key in ("theta_deg", "alpha_deg", "beta_deg")}
            joint.append(j.model_copy(update=values))
        return robot.model_copy(update={"joint": tuple(joint)}), rows

    return slip


def _places_times(factor: float) -> _Slip:
    return lambda robot, rows: (robot, replace(rows, position=rows.position * factor, length_mm=rows.length_mm * factor))
