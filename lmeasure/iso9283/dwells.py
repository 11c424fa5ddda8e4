"""Windows that a program does not state: the rests of a trajectory, assigned to the commanded poses and paths they belong to."""

import itertools
from collections import Counter
from typing import NamedTuple

import numpy as np

from lmeasure.core import CertificationError, FloatArray
from lmeasure.recording import CommandedPath, CommandedPose, Program
from lmeasure.text import Message, message
from lmeasure.trajectory import LEAST_S, Frame, Trajectory, rests, settled

NEAR = 0.4
"""Of the least distance between commanded poses: farther from one, a rest belongs to none."""
FARTHEST_MM = 20.0


def with_windows(trajectory: Trajectory, program: Program, frame: Frame, still_mm: float) -> tuple[Program, tuple[Message, ...]]:
    """The program with windows found in the trajectory, where it states no time of anything, and what is to be said of them.

    A dwell is the second half of a rest near a commanded pose, up to `LAG_S` before the robot leaves it; a run of a path is what lies
    between a rest near its start and the next near its end. CertificationError when a pose or path is not found, or poses are
    taken different numbers of times.
    """
    timed = [w for p in program.pose for w in (p.windows_s, p.settling_s)] + [p.windows_s for p in program.path]
    timed += [p.windows_s for p in program.posing] + [c.windows_s for c in program.compliance]
    if any(timed) or not (program.pose or program.path):
        return program, ()
    positions = frame.of(trajectory.poses)[:, :3]
    found = rests(trajectory, positions, still_mm)
    places = np.array([np.nanmean(positions[r], axis=0) for r in found]).reshape(-1, 3)
    seen = _Rests(trajectory, positions, found, places)
    poses = tuple(_with_dwells(p, program, seen) for p in program.pose)
    cycles = Counter(len(p.windows_s) for p in poses)
    if len(cycles) > 1:
        most = cycles.most_common(1)[0][0]
        odd = next(p for p in poses if len(p.windows_s) != most)
        raise CertificationError(message("error.pose_is_rested_at", name=odd.name, n_windows_s=len(odd.windows_s), most=most))
    paths = tuple(_with_runs(p, seen) for p in program.path)
    note = message("windows.found", rests=len(found), least_s=LEAST_S, still_mm=still_mm)
    data = program.model_dump(by_alias=True, exclude_none=True)
    data["pose"] = [p.model_dump(by_alias=True, exclude_none=True) for p in poses]
    data["path"] = [p.model_dump(by_alias=True, exclude_none=True) for p in paths]
    return Program.model_validate(data), (note,)


def _reach(program: Program) -> float:
    """Return how far from a commanded pose a rest may lie and still belong to it [mm]."""
    places = np.array([p.position_mm for p in program.pose]).reshape(-1, 3)
    apart = [float(np.linalg.norm(a - b)) for a, b in itertools.combinations(places, 2)]
    return min([FARTHEST_MM, *(NEAR * d for d in apart if d > 0)])


class _Rests(NamedTuple):
    """Where a trajectory rests: positions (n, 3) of what is certified, the samples of each rest, and where it is, places (k, 3) [mm]."""

    trajectory: Trajectory
    positions: FloatArray
    found: list[slice]
    places: FloatArray


def _with_dwells(pose: CommandedPose, program: Program, rests: _Rests) -> CommandedPose:
    found = rests.found
    near = np.flatnonzero(np.linalg.norm(rests.places - np.array(pose.position_mm), axis=1) <= _reach(program))
    if len(near) == 0:
        raise CertificationError(message("error.pose_the_trajectory_has", name=pose.name, reach=_reach(program), n_found=len(found)))
    windows = [settled(rests.trajectory.time_s, rests.positions, found[i]) for i in near]
    _expect(pose.name, "pose", len(windows), pose.cycles)
    return pose.model_copy(update={"windows_s": tuple(windows)})


def _with_runs(path: CommandedPath, rests: _Rests) -> CommandedPath:
    trajectory, positions, found, places = rests
    points = path.points(10.0)
    windows = []
    for i in range(len(found) - 1):
        ends = np.linalg.norm(places[i] - points[0]), np.linalg.norm(places[i + 1] - points[-1])
        if max(ends) > FARTHEST_MM:
            continue
        first, last = found[i].stop - 1, found[i + 1].start
        # a way of other length between the same ends is another motion
        way = np.nansum(np.linalg.norm(np.diff(positions[first : last + 1], axis=0), axis=1))
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if 0.8 * length < way < 1.5 * length:
            windows.append((float(trajectory.time_s[first]), float(trajectory.time_s[last])))
    if not windows:
        raise CertificationError(message("error.path_the_trajectory_has", name=path.name))
    _expect(path.name, "path", len(windows), path.cycles)
    return path.model_copy(update={"windows_s": tuple(windows)})


def _expect(name: str, kind: str, found: int, stated: int | None) -> None:
    if stated is not None and found != stated:
        raise CertificationError(message("error.found_cycles_in_the", kind=kind, name=name, found=found, stated=stated))
