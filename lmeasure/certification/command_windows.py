"""When a robot ran its program: the rests of a trajectory, one after the other, held against the list of commands."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lmeasure import files
from lmeasure.arrays import FloatArray
from lmeasure.certification.dwells import FARTHEST_MM
from lmeasure.errors import CertificationError
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.program import Program
from lmeasure.trajectory import Trajectory
from lmeasure.trajectory.resting import rests, settled

SETTLED = 0.5
"""Of a rest: its last part is measured."""


def windows_from_rests(
    program: Program, commands: Path, trajectory: Trajectory, *, still_mm: float = 0.2, loaded: Path | None = None
) -> Program:
    """The program with the windows of a trajectory that ran the commands of a commands.csv, all of them and in their order.

    Every command with a rest is looked for, in turn, among the rests of the trajectory near its place; others, such as one before the
    start, are passed over; a command that leaves the tool where it rests shares that rest. A pose is measured over the last half of its
    rest; posing from the end of the rest before, settling from where the robot was farthest since; a path from the end of the rest before
    until its own rest begins.
    Forces at one place leave no rests apart: loaded, a table with start_s and end_s of each force in the commands' order, says when they
    acted, else the windows_s that the program's [[compliance]] states already.
    CertificationError names the first command that is not found, or the row of a force whose times cannot be.
    """
    table = files.read_table(commands)
    if len(table) == 0 or len(trajectory.time_s) == 0:
        raise CertificationError(f"{commands}: {'there is no command' if len(table) == 0 else 'the trajectory has no sample'} to look for")
    command = table.numbers("command")
    last = np.flatnonzero(np.append(np.diff(command) > 0, True))
    places, dwell, cycle = table.matrix(POSITION_COLUMNS)[last], table.numbers("dwell_s")[last], table.numbers("cycle")[last]
    target, role = (np.array(table.text(name))[last] for name in ("target", "role"))
    found = rests(trajectory, trajectory.poses[:, :3], still_mm)
    middles = np.array([np.nanmedian(trajectory.poses[r, :3], axis=0) for r in found]).reshape(-1, 3)
    # without a move, and not round a closed path
    stays = np.concatenate([[False], (np.diff(last) == 1) & (np.linalg.norm(np.diff(places, axis=0), axis=1) <= still_mm)])
    windows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    at, before = 0, float(trajectory.time_s[0])
    forces = _under_load(program, target[(role == "compliance") & (dwell > 0)], trajectory, loaded)
    for i in np.flatnonzero(dwell > 0):
        if role[i] == "compliance":
            window = forces.pop(0)
            if window[0] < before:
                raise CertificationError(
                    f"{loaded or commands}: a force of {target[i]} acts from {window[0]:.6g} s, before what comes before it has ended at "
                    f"{before:.6g} s"
                )
            windows.setdefault(("compliance", target[i]), []).append(window)
            before = window[1]
            at = sum(trajectory.time_s[r.start] < before for r in found)
            continue
        if stays[i] and dwell[i - 1] > 0 and not target[i]:
            continue
        near = np.flatnonzero(np.linalg.norm(middles[at:] - places[i], axis=1) <= FARTHEST_MM)
        if not len(near):
            where = ", ".join(f"{v:.1f}" for v in places[i])
            raise CertificationError(
                f"{commands}: command {command[last][i]:.0f} ({target[i] or 'on the way'}, cycle {cycle[i]:.0f}): no rest near "
                f"({where}) mm after {before:.6g} s"
            )
        rest = found[at + int(near[0])]
        middle = middles[at + int(near[0])]
        at += int(near[0]) + 1
        # a rest goes on until the robot has moved by still_mm: what needs its place at rest ends before
        begin, (_, end) = float(trajectory.time_s[rest.start]), settled(trajectory.time_s, trajectory.poses[:, :3], rest)
        if forces and forces[0][0] > begin:
            # under load at the place where the robot rests already it hardly moves
            end = min(end, forces[0][0])
        at_rest, whole = (end - SETTLED * (end - begin), end), (before, end)
        ways = {
            "pose": {"pose": at_rest},
            "settling": {"pose": at_rest, "settling": (_farthest(trajectory, middle, before, begin), end)},
            "posing": {"posing": whole},
            "path": {"path": (before, begin)},
        }
        for kind, window in ways[role[i]].items() if target[i] else ():
            windows.setdefault((kind, target[i]), []).append(window)
        before = end
    return program.with_windows(windows)


def _farthest(trajectory: Trajectory, place: FloatArray, start: float, end: float) -> float:
    """When, within an interval, the tool was farthest from a place (3,): a way that leads there and back begins at its turn."""
    on_way = (trajectory.time_s >= start) & (trajectory.time_s <= end)
    away = np.nan_to_num(np.linalg.norm(trajectory.poses[on_way, :3] - place, axis=1), nan=-1.0)
    return float(trajectory.time_s[on_way][int(np.argmax(away))])


def _under_load(program: Program, targets: NDArray[np.str_], trajectory: Trajectory, loaded: Path | None) -> list[tuple[float, float]]:
    """When each force of the compliance tests acted, in the order of the commands, whose targets (n,) are the tables' poses."""
    if loaded is None:
        stated = {c.pose: list(c.windows_s) for c in program.compliance}
        if any(len(stated.get(name, [])) != (targets == name).sum() for name in targets):
            raise CertificationError("rests under load at one place cannot be told apart: say when each force acted, by --loaded")
        return [stated[name].pop(0) for name in targets]
    table = files.read_table(loaded)
    windows = list(zip(table.numbers("start_s").tolist(), table.numbers("end_s").tolist(), strict=True))
    if len(windows) != len(targets):
        raise CertificationError(f"{loaded}: has {len(windows)} rows for {len(targets)} forces of the commands; one for each")
    before, last = float(trajectory.time_s[0]), float(trajectory.time_s[-1])
    for row, (start, end) in enumerate(windows):
        if not before <= start < end <= last:
            raise CertificationError(
                f"{loaded}: row {row}: [{start:.6g}, {end:.6g}] s: must begin after {before:.6g} s and end later, by {last:.6g} s at most"
            )
        before = end
    return windows
