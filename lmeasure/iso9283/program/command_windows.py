"""Times of a robot's program: the rests of a trajectory assigned to the commands of a commands.csv.

Commands and rests follow each other in one order. A rest belongs to a command if it is near the commanded position, if the path since the
previous command's rest is as long as commanded, and if its duration is similar. Other rests, such as one broken by an outlying sample, are
skipped. The assignment of least cost is used (dynamic programming).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, CertificationError, FloatArray, IntArray
from lmeasure.io import files
from lmeasure.iso9283.motion_readings import FARTHEST_MM
from lmeasure.iso9283.program.campaign import EDGE_S
from lmeasure.iso9283.program.command_files import read_commands
from lmeasure.recording import Program
from lmeasure.robots import Command
from lmeasure.text import Message, message
from lmeasure.trajectory import Trajectory, rests, settled

SETTLED = 0.5
"""Last part of a rest, which is measured."""
SHORTER, LONGER = 0.4, 1.4
"""Limits of a path over the commanded one: a shorter or longer one is another motion. A fast robot cuts corners and small circles."""
MISSES = 4.0
"""Multiple of the robot's misses by which a path may be shorter or longer besides."""
CORNER_MM = 2.0
"""Length by which a very short path may also be longer or shorter."""
STEP_S = 0.02
"""Step in which paths are measured: noise of single samples is no path."""
FASTER, SLOWER, AWAY_S = 0.6, 2.0, 2.0
"""Limits of the duration over the commanded one, at the pace of the whole run, beyond which it is another motion; and the time to come to
rest."""
PASSED = 1.0
"""Cost of passing over a rest as long as a commanded one."""
SKIPPED_AT_ALIGNING = 8
"""Rests in a row that belong to no command, where the frame is not known yet."""
PACE = (0.6, 1.25)
"""Range of the commanded speed, which accelerations lower: outside it the run's pace gets a remark."""


@dataclass(frozen=True)
class _Rests:
    """Rests (k) of a trajectory: samples, places (k, 3) [mm], begin_s and end_s (k,), and way_mm (k,) since the beginning when each begins,
    rests not counted."""

    samples: list[slice]
    places: FloatArray
    begin_s: FloatArray
    end_s: FloatArray
    way_mm: FloatArray

    def __len__(self) -> int:
        return len(self.samples)


@dataclass(frozen=True)
class _Expected:
    """Rests (m) that commands require: number of the command, position (m, 3), dwell_s, and the path from the previous one: straight and
    way [mm], lasts_s; least_s: its earliest beginning."""

    command: IntArray
    places: FloatArray
    dwell_s: FloatArray
    straight_mm: FloatArray
    way_mm: FloatArray
    lasts_s: FloatArray
    least_s: FloatArray


def windows_from_rests(
    program: Program, commands: Path, trajectory: Trajectory, *, still_mm: float = 0.2, loaded: Path | None = None, align: bool = False
) -> tuple[Program, tuple[Message, ...]]:
    """Return the program with the windows of a trajectory that ran the commands of a commands.csv, all of them and in their order, and
    remarks on the run.

    A command that leaves the tool where it rests shares that rest. A pose is measured over the last half of its rest, or its dither; posing
    from the end of the rest before, settling from the farthest point since; a path from the end of the rest before until its own rest
    begins. align: the trajectory is in a frame of its own, which is found from the distances between rests. Forces at one place leave no
    rests apart: loaded, a table with start_s and end_s of each force in the commands' order, gives their times, else the windows_s that the
    program's [[compliance]] states already. CertificationError names the first command that is not found, or the row of a force with
    impossible times.
    """
    if len(trajectory.time_s) == 0:
        raise CertificationError(message("error.the_trajectory_has_no_sample", where=commands))
    every = read_commands(commands)
    dwell = np.array([c.dwell_s for c in every])
    loads = [i for i, c in enumerate(every) if c.role == "compliance" and c.dwell_s > 0]
    targets = np.array([every[i].target for i in loads], dtype=np.str_)
    forces = dict(zip(loads, _under_load(program, targets, trajectory, loaded), strict=True))
    found = _rests_of(trajectory, still_mm)
    expected = _expected(every, forces, still_mm)
    if align:
        found = _in_frame(found, expected, commands, every)
    pairs, pace = _assigned(found, expected, commands, every)
    rest_of = dict(zip(expected.command.tolist(), pairs.tolist(), strict=True))
    windows: dict[tuple[str, str], list[tuple[float, float]]] = {}
    before = float(trajectory.time_s[0])
    for i in np.flatnonzero(dwell > 0).tolist():
        target = every[i].target
        if i in forces:
            window = forces.pop(i)
            if window[0] < before:
                raise CertificationError(
                    message("error.a_force_of_acts", where=loaded or commands, target=target, window=window[0], before=before)
                )
            windows.setdefault(("compliance", target), []).append(window)
            before = window[1]
            continue
        if i not in rest_of:
            continue
        rest = found.samples[rest_of[i]]
        middle = np.nanmedian(trajectory.poses[rest, :3], axis=0)
        # a rest lasts until the robot has moved by still_mm; tests of the rest position end earlier
        begin, (_, end) = float(trajectory.time_s[rest.start]), settled(trajectory.time_s, trajectory.poses[:, :3], rest)
        following = next(iter(forces.values()), None)
        if following is not None and following[0] > begin:
            # under load at the place where the robot rests already it hardly moves
            end = min(end, following[0])
        at_rest, whole = (end - SETTLED * (end - begin), end), (before, end)
        ways = {
            "pose": {"pose": at_rest},
            "settling": {"pose": at_rest, "settling": (_farthest(trajectory, middle, before, begin), end)},
            "posing": {"posing": whole},
            "path": {"path": (before, begin)},
        }
        for kind, window in ways[every[i].role].items() if target else ():
            windows.setdefault((kind, target), []).append(window)
        if i + 1 < len(every) and every[i + 1].role == "dither":
            lasts = float(every[i + 1].durations(every[i].poses[-1]).sum())
            windows.setdefault(("pose", every[i + 1].target), []).append((max(end - lasts, begin) + EDGE_S, end - EDGE_S))
        before = end
    notes = () if PACE[0] <= pace <= PACE[1] else (message("ran.pace", percent=100.0 * pace),)
    return program.with_windows(windows), notes


def _rests_of(trajectory: Trajectory, still_mm: float) -> _Rests:
    """Return the rests of a trajectory and the ways between them."""
    positions, time_s = trajectory.poses[:, :3], trajectory.time_s
    found = rests(trajectory, positions, still_mm)
    places = np.array([np.nanmedian(positions[r], axis=0) for r in found]).reshape(-1, 3)
    begin = np.array([time_s[r.start] for r in found])
    end = np.array([time_s[r.stop - 1] for r in found])
    way = np.zeros(len(found))
    for k in range(1, len(found)):
        between = slice(found[k - 1].stop - 1, found[k].start + 1)
        here = positions[between][~np.isnan(positions[between, 0])]
        at = time_s[between][~np.isnan(positions[between, 0])]
        if len(here):
            _, first = np.unique(np.floor((at - at[0]) / STEP_S), return_index=True)
            means = np.add.reduceat(here, first, axis=0) / np.diff(np.append(first, len(here)))[:, None]
            here = np.vstack([places[k - 1], means, places[k]])
        else:
            here = places[[k - 1, k]]
        way[k] = float(np.linalg.norm(np.diff(here, axis=0), axis=1).sum())
    return _Rests(found, places, begin, end, np.cumsum(way))


def _expected(every: Sequence[Command], forces: dict[int, tuple[float, float]], still_mm: float) -> _Expected:
    """Return the rests that commands ask for; those under load and those that share the rest before are none of their own."""
    rows: list[tuple[int, FloatArray, float, float, float]] = []
    start, way, lasts, least = every[0].poses[0], 0.0, 0.0, -np.inf
    leasts = []
    for i, command in enumerate(every):
        if command.role == "dither":
            # the robot counts as at rest
            rows[-1] = (*rows[-1][:2], rows[-1][2] + float(command.durations(start).sum()), *rows[-1][3:])
            continue
        steps = np.linalg.norm(np.diff(np.vstack([start[:3], command.poses[:, :3]]), axis=0), axis=1)
        way, lasts = way + float(steps.sum()), lasts + float(command.durations(start).sum())
        start = command.poses[-1]
        here = start[:3]
        if i in forces:
            least = forces[i][1]
            way = lasts = 0.0
        elif command.dwell_s > 0:
            # without a move, and not round a closed path
            stays = i > 0 and every[i - 1].dwell_s > 0 and steps.sum() <= still_mm and not command.target
            if not stays:
                rows.append((i, here, command.dwell_s, way, lasts))
                leasts.append(least)
            way = lasts = 0.0
    number, places, dwell, ways, durations = zip(*rows, strict=True) if rows else ((), (), (), (), ())
    at = np.array(places).reshape(-1, 3)
    straight = np.concatenate([[0.0], np.linalg.norm(np.diff(at, axis=0), axis=1)])[: len(at)]
    return _Expected(
        np.array(number, dtype=np.int64), at, np.array(dwell), straight, np.array(ways), np.array(durations), np.array(leasts)
    )  # fmt: skip


def _assigned(found: _Rests, expected: _Expected, commands: Path, every: Sequence[Command]) -> tuple[IntArray, float]:
    """Return the rest (m,) of each command that requires one, and the robot's pace, 1 as commanded.

    The pace is found from a first assignment without durations. CertificationError names the first command without a rest.
    """
    apart = scipy.spatial.distance.cdist(expected.places, found.places)
    near = apart <= FARTHEST_MM
    miss = float(np.median(apart.min(axis=1))) if apart.size else 0.0
    miss = min(miss, FARTHEST_MM)
    pairs = _cheapest(found, expected, near, miss, None, None, commands, every)
    lasted = found.begin_s[pairs[1:]] - found.end_s[pairs[:-1]]
    pace = 1.0
    if len(lasted):
        due = expected.lasts_s[1:]
        long = (due > 0.5 * AWAY_S) | (due >= np.median(due))
        pace = float(np.median(due[long] / np.maximum(lasted[long], 1e-9)))
    return _cheapest(found, expected, near, miss, pace, None, commands, every), pace


def _in_frame(found: _Rests, expected: _Expected, commands: Path, every: Sequence[Command]) -> _Rests:
    """Return the rests in the frame of the commands: assigned by the distances between them first, which are the same in every frame."""
    anywhere = np.ones((len(expected.places), len(found)), np.bool_)
    pairs = _cheapest(found, expected, anywhere, CORNER_MM, None, SKIPPED_AT_ALIGNING, commands, every)
    there = found.places[pairs]
    flat = np.linalg.svd(expected.places - expected.places.mean(axis=0), compute_uv=False)
    if len(pairs) < 3 or flat[1] < 1.0:
        raise CertificationError(message("error.rests_on_one_line", where=commands))
    middle, place = expected.places.mean(axis=0), there.mean(axis=0)
    turn, _ = Rotation.align_vectors(expected.places - middle, there - place)
    return _Rests(found.samples, middle + turn.apply(found.places - place), found.begin_s, found.end_s, found.way_mm)


def _cheapest(
    found: _Rests,
    expected: _Expected,
    near: BoolArray,
    miss: float,
    pace: float | None,
    skipped: int | None,
    commands: Path,
    every: Sequence[Command],
) -> IntArray:
    """Return the rest (m,) of each command, by dynamic programming over near (m, k): which may belong to which; skipped: rests in a row
    that may belong to none; pace: None where durations are not looked at. CertificationError names the first command without one."""
    m = len(expected.places)
    lasts = found.end_s - found.begin_s
    usual = float(np.median(expected.dwell_s)) if m else 1.0
    passed = np.concatenate([[0.0], np.cumsum(PASSED * np.minimum(lasts / usual, 1.0))])
    slack = MISSES * miss + CORNER_MM
    cost, back = np.empty(0), []
    candidates: list[IntArray] = []
    for i in range(m):
        at = np.flatnonzero(near[i] & (found.begin_s >= expected.least_s[i]))
        if skipped is not None and i:
            at = np.intersect1d(at, candidates[-1][:, None] + np.arange(1, skipped + 2))
        own = np.abs(np.log(np.maximum(lasts[at], 1e-3) / expected.dwell_s[i])).clip(max=3.0) * 0.1
        if i == 0:
            cost, step = own + 1e-3 * passed[at], np.zeros(len(at), np.int64)
        else:
            before = candidates[-1]
            way = found.way_mm[at][:, None] - found.way_mm[before]
            took = found.begin_s[at][:, None] - found.end_s[before]
            may = at[:, None] > before
            if expected.least_s[i] == expected.least_s[i - 1]:
                may &= (way >= SHORTER * expected.way_mm[i] - slack) & (way <= LONGER * expected.way_mm[i] + 2.0 * slack)
                if pace is not None:
                    due = expected.lasts_s[i] / pace
                    may &= (took >= FASTER * due - 0.5 * STEP_S) & (took <= SLOWER * due + AWAY_S)
            if skipped is not None:
                straight = np.linalg.norm(found.places[at][:, None] - found.places[before], axis=2)
                may &= (at[:, None] - before <= skipped + 1) & (np.abs(straight - expected.straight_mm[i]) <= FARTHEST_MM)
            over = passed[at][:, None] - passed[before + 1]
            total = np.where(may, cost + over, np.inf)
            step = np.argmin(total, axis=1) if len(before) else np.zeros(len(at), np.int64)
            cost = own + (total[np.arange(len(at)), step] if len(before) else np.inf)
            if skipped is not None:
                cost = (
                    cost
                    + np.abs(np.linalg.norm(found.places[at] - found.places[before[step]], axis=1) - expected.straight_mm[i]) / FARTHEST_MM
                )
        kept = np.isfinite(cost)
        if not kept.any():
            _not_found(found, expected, i, candidates, near, commands, every)
        candidates.append(at[kept])
        back.append(step[kept])
        cost = cost[kept]
    out = np.empty(m, np.int64)
    j = int(np.argmin(cost)) if m else 0
    for i in range(m - 1, -1, -1):
        out[i] = candidates[i][j]
        j = int(back[i][j])
    return out


def _not_found(
    found: _Rests, expected: _Expected, i: int, candidates: list[IntArray], near: BoolArray, commands: Path, every: Sequence[Command]
) -> None:
    """Raise CertificationError with the command without a rest, and the motion found instead."""
    command = every[int(expected.command[i])]
    where = ", ".join(f"{v:.1f}" for v in expected.places[i])
    since = float(found.end_s[candidates[-1].min()]) if i and len(candidates[-1]) else float(found.begin_s[0]) if len(found) else 0.0
    head = f"{commands}: command {int(expected.command[i]) + 1} ({command.target or 'on the way'}, cycle {command.cycle})"
    later = np.flatnonzero(near[i] & (found.begin_s >= since))
    if not len(later):
        hint = "" if i else message("iso.other_frame")
        raise CertificationError(message("error.no_rest_near_mm", where=head, where2=where, since=since, hint=hint))
    before = candidates[-1] if i else later[:1]
    off = np.where(later[:, None] > before, np.abs(found.way_mm[later][:, None] - found.way_mm[before] - expected.way_mm[i]), np.inf)
    row, column = np.unravel_index(int(np.argmin(off)), off.shape)
    j, b = int(later[row]), int(before[column])
    way, took = found.way_mm[j] - found.way_mm[b], found.begin_s[j] - found.end_s[b]
    raise CertificationError(
        message(
            "error.the_rest_near_mm",
            where=head,
            where2=where,
            begin_s=found.begin_s[j],
            way=way,
            took=took,
            way_mm=expected.way_mm[i],
            lasts_s=expected.lasts_s[i],
        )
    )


def _farthest(trajectory: Trajectory, place: FloatArray, start: float, end: float) -> float:
    """Return the time, within an interval, at which the tool was farthest from a position (3,): a path there and back begins at its
    turn."""
    on_way = (trajectory.time_s >= start) & (trajectory.time_s <= end)
    away = np.nan_to_num(np.linalg.norm(trajectory.poses[on_way, :3] - place, axis=1), nan=-1.0)
    return float(trajectory.time_s[on_way][int(np.argmax(away))])


def _under_load(program: Program, targets: NDArray[np.str_], trajectory: Trajectory, loaded: Path | None) -> list[tuple[float, float]]:
    """Return the times of each force of the compliance tests, in the order of the commands, whose targets (n,) are the tables' poses."""
    if loaded is None:
        stated = {c.pose: list(c.windows_s) for c in program.compliance}
        if any(len(stated.get(name, [])) != (targets == name).sum() for name in targets):
            raise CertificationError(message("error.rests_under_load_at"))
        return [stated[name].pop(0) for name in targets]
    table = files.read_table(loaded)
    windows = list(zip(table.numbers("start_s").tolist(), table.numbers("end_s").tolist(), strict=True))
    if len(windows) != len(targets):
        raise CertificationError(message("error.has_rows_for_forces", where=loaded, n_windows=len(windows), n_targets=len(targets)))
    before, last = float(trajectory.time_s[0]), float(trajectory.time_s[-1])
    for row, (start, end) in enumerate(windows):
        if not before <= start < end <= last:
            raise CertificationError(
                message("error.row_s_must_begin", where=loaded, row=row, start=start, end=end, before=before, last=last)
            )
        before = end
    return windows
