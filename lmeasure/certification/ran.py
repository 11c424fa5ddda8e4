"""When a robot ran its program: the rests of a trajectory, one after the other, held against the list of commands."""

from pathlib import Path

import numpy as np

from lmeasure import files
from lmeasure.certification.dwells import FARTHEST_MM, rests
from lmeasure.errors import CertificationError
from lmeasure.poses import POSITION_COLUMNS
from lmeasure.program import Program
from lmeasure.trajectory import Trajectory

SETTLED = 0.5
"""Of a rest: its last part is measured."""


def windows_from_rests(program: Program, commands: Path, trajectory: Trajectory, still_mm: float = 0.2) -> Program:
    """The program with the windows of a trajectory that ran the commands of a commands.csv, all of them and in their order.

    Every command with a rest is looked for, in turn, among the rests of the trajectory near its place; others, such as one before the
    start, are passed over; a command that leaves the tool where it rests shares that rest. A pose is measured over the last half of its
    rest; settling and posing from the end of the rest before; a path from the end of the rest before until its own rest begins.
    CertificationError names the first command that is not found, and a compliance test: forces at one place leave no rests apart.
    """
    if program.compliance:
        raise CertificationError(
            f"{commands}: rests under load at one place cannot be told apart; state windows_s of [[compliance]] by hand"
        )
    table = files.read_table(commands)
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
    for i in np.flatnonzero(dwell > 0):
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
        at += int(near[0]) + 1
        begin, end = float(trajectory.time_s[rest.start]), float(trajectory.time_s[rest.stop - 1])
        at_rest, whole = (end - SETTLED * (end - begin), end), (before, end)
        ways = {
            "pose": {"pose": at_rest},
            "settling": {"pose": at_rest, "settling": whole},
            "posing": {"posing": whole},
            "path": {"path": (before, begin)},
        }
        for kind, window in ways[role[i]].items() if target[i] else ():
            windows.setdefault((kind, target[i]), []).append(window)
        before = end
    return program.with_windows(windows)
