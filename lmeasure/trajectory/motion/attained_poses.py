"""Attained poses of a trajectory: where it rests, the part of each rest in which the robot has settled, and the mean over each dwell."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import WORDS, CertificationError, FloatArray, IntArray, Status, conventions, se3
from lmeasure.recording import Windows
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.motion.vibration import Vibration, vibration
from lmeasure.trajectory.uncertainty.pose_errors import PoseErrors, at_tool_point

LAG_S = 0.05  # A robot rests if it moves by less than `still_mm` in this time
LEAST_S = 0.15  # Shortest rest that counts as a dwell: turning points of a motion are shorter
BROKEN_S = 0.15  # Shorter than it a rest is not left for another at the same place: single samples lay off
UNSEEN_S = 1.0  # Without a sample for longer, or for several usual intervals, the robot may have been elsewhere
SETTLED = 0.5  # Of a rest: its last part, when the robot no longer swings
LEAVES = 4.0  # Times as far from the middle of a rest as its middle part scatters: the robot is on its way again


def rests(trajectory: Trajectory, positions: FloatArray, still_mm: float) -> list[slice]:
    """The samples of each rest, in order of time: positions (n, 3) that move by less than still_mm within `LAG_S` for `LEAST_S` at least.

    Samples that are not ok end a rest, and so does a long gap; some that lie off for a moment do not.
    """
    time_s = trajectory.time_s
    if len(time_s) < 2:
        return []
    ahead = np.minimum(np.searchsorted(time_s, time_s + LAG_S), len(time_s) - 1)
    with np.errstate(invalid="ignore"):
        still = (np.linalg.norm(positions[ahead] - positions, axis=1) <= still_mm) & ~np.isnan(positions[:, 0])
    steps = np.diff(time_s)
    still[:-1] &= steps <= max(UNSEEN_S, 2.5 * float(np.median(steps)))
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    out: list[slice] = []
    for first, stop in edges.reshape(-1, 2).tolist():
        # the last sample that was compared belongs to the rest as well
        last = int(ahead[stop - 1])
        while np.isnan(positions[last, 0]):
            last -= 1
        rest = slice(first, last + 1)
        if out and _goes_on(time_s, positions, out[-1], rest, still_mm):
            rest = slice(out.pop().start, rest.stop)
        out.append(rest)
    return [r for r in out if time_s[r.stop - 1] - time_s[r.start] >= LEAST_S]


def _goes_on(time_s: FloatArray, positions: FloatArray, one: slice, other: slice, still_mm: float) -> bool:
    """Return whether two rests are one that some outlying samples have interrupted."""
    between = positions[one.stop - 1 : other.start + 1]
    if time_s[other.start] - time_s[one.stop - 1] > BROKEN_S or np.isnan(between).any():
        return False
    apart = np.median(positions[one], axis=0) - np.median(positions[other], axis=0)
    return bool(np.linalg.norm(apart) <= still_mm)


def settled(time_s: FloatArray, positions: FloatArray, rest: slice) -> tuple[float, float]:
    """Return the window of a rest: from its middle to the robot's departure, which is slow at first.

    It ends when the robot goes away for good: flickering counts of a rest may lie outside its scatter.
    """
    times, here = time_s[rest], positions[rest]
    n = len(times)
    middle = here[int(0.4 * n) : max(int(0.6 * n), int(0.4 * n) + 2)]
    centre = middle.mean(axis=0)
    scatter = float(np.sqrt(np.mean(np.sum((middle - centre) ** 2, axis=1))))
    half = int((1.0 - SETTLED) * n)
    there = np.flatnonzero(np.linalg.norm(here[half:] - centre, axis=1) <= LEAVES * scatter + 1e-6)
    end = times[half + there[-1]] if len(there) else times[-1]
    return float(times[half]), float(max(end - LAG_S, times[half]))


UNIT_TOLERANCE = 1e-6
SAME = 1e-9  # mm: rounded alike
TIME_TOLERANCE_S = 1e-9  # times such as 0.1 + 0.2 that are meant to be a window's end


@dataclass(frozen=True)
class Frame:
    """Point of the tool and its frame: tool_mm (3,) in the tool frame; base_from_program (7,), None when they are the
    same."""

    tool_mm: FloatArray
    base_from_program: FloatArray | None = None

    def of(self, poses: FloatArray) -> FloatArray:
        """(n, 7) poses of that point in that frame, from poses of the tool origin in the base frame."""
        out = poses
        if self.tool_mm.any():
            out = np.concatenate([se3.apply(out, self.tool_mm), out[:, 3:]], axis=1)
        if self.base_from_program is not None:
            out = in_frame(self.base_from_program, out)
        return out

    def of_errors(self, poses: FloatArray, errors: PoseErrors) -> PoseErrors:
        """Errors in that frame at (n, 7) poses of the tool origin in the base frame."""
        matrices = at_tool_point(poses, self.tool_mm) if self.tool_mm.any() else np.tile(np.eye(6), (len(poses), 1, 1))
        if self.base_from_program is not None:
            turned = se3.pose(np.zeros(3), se3.rotation(self.base_from_program).inv())
            matrices = se3.adjoint(turned) @ matrices
        return errors.moved(matrices)


def in_frame(base_from_frame: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, 7) poses in another frame; a pose without an orientation keeps its position alone."""
    out, known = np.full_like(poses, np.nan), ~np.isnan(poses[:, 3])
    out[known] = se3.between(base_from_frame, poses[known])
    out[~known, :3] = se3.rotation(base_from_frame).inv().apply(poses[~known, :3] - base_from_frame[:3])
    return out


@dataclass(frozen=True)
class AttainedPose:
    """The cycles of a commanded pose (7,): attained poses (n, 7), mm and unit quaternions, middles of their windows time_s (n,) and samples
    (n,). vibration: how the samples in the windows swing; readings (n,): how many different ones each holds; angle_deg: worst pressure
    angle in the windows.
    """

    name: str
    commanded: FloatArray
    poses: FloatArray
    time_s: FloatArray
    samples: IntArray
    vibration: Vibration
    readings: IntArray
    angle_deg: float

    def scatter_within(self, groups: IntArray) -> FloatArray:
        """Return the (6, 6) covariance of the attained poses about the mean of their group, groups (n,) by index; zero if each is alone."""
        total, freedom = np.zeros((6, 6)), 0
        for group in np.unique(groups):
            poses = self.poses[groups == group]
            total += (len(poses) - 1) * scatter(poses)
            freedom += len(poses) - 1
        return total / max(freedom, 1)


def window(trajectory: Trajectory, start_s: float, end_s: float, what: str) -> slice:
    """The samples of a window, both ends included; CertificationError names the window when it has none or one that is not ok."""
    first = int(np.searchsorted(trajectory.time_s, start_s - TIME_TOLERANCE_S, side="left"))
    last = int(np.searchsorted(trajectory.time_s, end_s + TIME_TOLERANCE_S, side="right"))
    if last <= first:
        raise CertificationError(message("error.the_trajectory_has_no_sample_within", where=what, start_s=start_s, end_s=end_s))
    bad = np.flatnonzero((trajectory.status[first:last] != Status.OK) | np.isnan(trajectory.poses[first:last, 0]))
    if len(bad):
        i = first + int(bad[0])
        if trajectory.status[i] == Status.OK:
            raise CertificationError(message("error.sample_at_s_has", where=what, i=i, time_s=trajectory.time_s[i]))
        why = trajectory.cause[i] or WORDS[trajectory.status[i]]
        raise CertificationError(message("error.sample_at_s_is", where=what, i=i, time_s=trajectory.time_s[i], why=why))
    far = np.abs(trajectory.poses[first:last]) > np.repeat([conventions.MAX_LENGTH_MM, 2.0], [3, 4])
    bad = np.flatnonzero(far.any(axis=1))
    if len(bad):
        i = first + int(bad[0])
        raise CertificationError(message("error.sample_at_s_holds", where=what, i=i, time_s=trajectory.time_s[i]))
    length = np.linalg.norm(trajectory.poses[first:last, 3:], axis=1)
    bad = np.flatnonzero(np.abs(length - 1.0) > UNIT_TOLERANCE)  # never for unmeasured samples
    if len(bad):
        i = first + int(bad[0])
        raise CertificationError(message("error.sample_at_s_the", where=what, i=i, time_s=trajectory.time_s[i], length=length[bad[0]]))
    return slice(first, last)


def mean_pose(poses: FloatArray) -> FloatArray:
    """(7,) mean of poses (n, 7) that lie close together: of positions, and of quaternions brought to one side."""
    quaternions = poses[:, 3:] * np.where(poses[:, 3:] @ poses[0, 3:] < 0, -1.0, 1.0)[:, None]
    mean = quaternions.mean(axis=0)
    return np.concatenate([poses[:, :3].mean(axis=0), mean / np.linalg.norm(mean)])


def scatter(poses: FloatArray) -> FloatArray:
    """(6, 6) covariance of (rotation [rad]; position [mm]) of poses (n, 7) that lie close together; zero where it is not measured."""
    return np.zeros((6, 6)) if len(poses) < 2 else np.asarray(np.cov(displacements(poses).T))


def displacements(poses: FloatArray) -> FloatArray:
    """(n, 6) (rotation [rad]; position [mm]) of poses (n, 7) that lie close together, from their mean; zero where it is not measured."""
    return moved(poses, mean_pose(poses))


def moved(poses: FloatArray, reference: FloatArray) -> FloatArray:
    """(n, 6) (rotation [rad]; position [mm]) of poses (n, 7) from a reference (7,) or (n, 7); no rotation where it is not measured."""
    if np.isnan(poses[0, 3]):
        return np.concatenate([np.zeros((len(poses), 3)), poses[:, :3] - reference[..., :3]], axis=1)
    return se3.displacement(poses, reference)


def dwell(trajectory: Trajectory, frame: Frame, start_s: float, end_s: float, *, still_mm: float, what: str) -> tuple[slice, FloatArray]:
    """The samples of a window in which the robot rests, and their poses (k, 7); CertificationError names the sample that moves."""
    part = window(trajectory, start_s, end_s, what)
    poses = frame.of(trajectory.poses[part])
    away = np.linalg.norm(poses[:, :3] - np.median(poses[:, :3], axis=0), axis=1)
    if away.max() > still_mm:
        i = part.start + int(np.argmax(away))
        when = {"start_s": start_s, "end_s": end_s, "i": i, "time_s": trajectory.time_s[i]}
        raise CertificationError(message("error.the_robot_moves_in", where=what, **when, away=away.max(), still_mm=still_mm))
    return part, poses


def attain(
    name: str,
    commanded: FloatArray,
    windows: Windows,
    trajectory: Trajectory,
    *,
    frame: Frame,
    still_mm: float,
    dither_s: float | None = None,
) -> AttainedPose:
    """The attained poses of one commanded pose (7,), one per window: means, or the middles of a stated dither of a period dither_s."""
    rows, starts, middles, sampled, readings, worst = [], [], [], [], [], np.nan
    for cycle, (start, end) in enumerate(windows, 1):
        part, poses = dwell(trajectory, frame, start, end, still_mm=still_mm, what=f"pose {name}, cycle {cycle}")
        rows.append(mean_pose(poses))
        starts.append(part.start)
        middles.append((part.start + part.stop - 1) // 2)
        changed = (np.abs(np.diff(trajectory.poses[part], axis=0)) > SAME).any(axis=1)
        readings.append(1 + int(changed.sum()))
        sampled.append((trajectory.time_s[part], displacements(poses) if changed.any() else np.zeros((len(poses), 6))))
        worst = float(np.fmax.reduce(trajectory.worst_pressure_angle_deg[part], initial=worst))
    times = np.array([0.5 * (start + end) for start, end in windows])
    swings, poses = vibration(sampled, dither_s), np.array(rows)
    if swings.dither_hz:
        turned = poses[:, 3:] if np.isnan(poses[0, 3]) else se3.displaced(poses, swings.middles)[:, 3:]
        poses = np.hstack([poses[:, :3] + swings.middles[:, 3:], turned])
        at = [int(np.argmin(np.abs(t - t.mean() - s))) for (t, _), s in zip(sampled, swings.instants_s, strict=True)]
        middles = [start + i for start, i in zip(starts, at, strict=True)]
    return AttainedPose(name, commanded, poses, times, np.array(middles, dtype=np.int64), swings, np.array(readings), worst)


def worst_angle(trajectory: Trajectory, windows: Windows, what: str) -> float:
    """Worst pressure angle [deg] met in windows, NaN where it is not known."""
    parts = [trajectory.worst_pressure_angle_deg[window(trajectory, start, end, what)] for start, end in windows]
    return float(np.fmax.reduce(np.concatenate(parts), initial=np.nan))
