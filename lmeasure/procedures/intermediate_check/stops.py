"""Where a run stands still, at what poses, and which of these are visits of one place."""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import FloatArray, IntArray, TrajectoryError, se3
from lmeasure.kernels import CABLE, KIND, span_lengths, span_rows
from lmeasure.sensors import Lengths, last_travel
from lmeasure.text import message
from lmeasure.trajectory import SETTLED, VISIT_LAG_S, Budget, RestFinder

BETWEEN = 60
"""Samples between two stops by which the tool is followed from one to the next."""
STEPS = 40
SMALL_MM = 1e-9
SIZE_MM = 100.0
"""By which a turn is held against a shift, of a tool."""
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Stops:
    """N stops in order of time: begin_s, end_s (N,); place (N,) of which each is a visit, from 0 in order of their first visits; readings
    (N, m) and true counts (N, m) of all channels, NaN where one was not read; poses (N, 7); travel (N, m): which way each cable came, 1
    paying out, -1 winding in."""

    begin_s: FloatArray
    end_s: FloatArray
    place: IntArray
    readings: FloatArray
    counts: FloatArray
    poses: FloatArray
    travel: FloatArray

    def __len__(self) -> int:
        return len(self.begin_s)

    @property
    def names(self) -> tuple[str, ...]:
        """(N,) P1, P2, ...: of the places."""
        return tuple(f"P{i + 1}" for i in self.place)

    def visits(self, place: int) -> IntArray:
        """Stops at a place."""
        return np.flatnonzero(self.place == place)


def find_stops(budget: Budget, lengths: Lengths, source: str, near_mm: float, *, zero: FloatArray | None = None) -> Stops:
    """The stops of a run from its lengths; two are of one place where the tool's origin and its turn differ by less than near_mm, a turn
    at `SIZE_MM`. zero (m,): what of a span readings do not show, where that is not what there was at the start.

    TrajectoryError where the run stands still less than twice, or no pose has its readings.
    """
    rig = budget.rig
    finder = RestFinder()
    of_cables = lengths.of_cables()
    finder.add(lengths.time_s, of_cables.change_mm)
    rests = finder.rests()
    if len(rests) < 2:
        raise TrajectoryError(message("error.stands_still_time_s", where=source, n_rests=len(rests)))
    path = Path(budget, zero)
    n, m = len(rests), lengths.change_mm.shape[1]
    readings, counts, poses = np.full((n, m), np.nan), np.full((n, m), np.nan), np.empty((n, 7))
    travel = last_travel(np.where(np.isfinite(lengths.counts), lengths.counts, 0.0), 1.0 / rig.scales(rig.observed))
    ways, at, pose = np.zeros((n, m)), 0, budget.model.start
    for i, (begin, end) in enumerate(zip(rests.begin_s, rests.end_s, strict=True)):
        settled = (lengths.time_s >= begin + (1.0 - SETTLED) * (end - begin)) & (lengths.time_s <= end - VISIT_LAG_S)
        rows = np.flatnonzero(settled)
        with np.errstate(invalid="ignore"):
            seen = np.isfinite(lengths.change_mm[rows]).all(axis=0)
        readings[i, seen], counts[i, seen] = lengths.change_mm[rows][:, seen].mean(axis=0), lengths.counts[rows][:, seen].mean(axis=0)
        ways[i] = travel[rows[-1]]
        for row in np.linspace(at, rows[0], BETWEEN).astype(np.intp):
            pose = path.pose(lengths.change_mm[row], pose)
        pose = path.pose(readings[i], pose)
        if not np.isfinite(path.residual(readings[i], pose)[seen]).all():
            raise TrajectoryError(message("error.no_pose_has_the", where=source, begin=begin))
        poses[i], at = pose, int(rows[-1])
    return Stops(rests.begin_s, rests.end_s, _places(poses, near_mm), readings, counts, poses, ways)


class Path:
    """Poses of a run, each from the one before, by weighted least squares of all channels that were read."""

    def __init__(self, budget: Budget, zero: FloatArray | None = None) -> None:
        self._rows = budget.scheme.rows
        self._weight = 1.0 / np.sqrt(budget.length_variance)
        self._angles = self._rows[:, KIND] > CABLE
        begun = span_lengths(self._rows, budget.model.start[None])[0]
        self._zero = np.where(budget.absolute, 0.0, begun) if zero is None else zero

    def residual(self, reading: FloatArray, pose: FloatArray) -> FloatArray:
        """(m,) readings (m,) less those at a pose (7,)."""
        off = reading - (span_lengths(self._rows, pose[None])[0] - self._zero)
        off[self._angles] -= TURN * np.round(off[self._angles] / TURN)
        return np.asarray(off)

    def pose(self, reading: FloatArray, near: FloatArray) -> FloatArray:
        """(7,) the pose that has the reading, near another; that other where too little was read."""
        pose, used = near, np.isfinite(reading)
        if used.sum() < 6:
            return near
        scale = np.repeat([1.0 / SIZE_MM, 1.0], 3)
        for _ in range(STEPS):
            J = (span_rows(self._rows, pose) * scale)[used] * self._weight[used, None]
            off = self.residual(reading, pose)[used] * self._weight[used]
            if not (np.isfinite(J).all() and np.isfinite(off).all()):
                return near
            step = np.linalg.lstsq(J, off)[0]
            pose = se3.displaced(pose, step * scale)
            if np.abs(step).max() < SMALL_MM:
                break
        return np.asarray(pose)


def _places(poses: FloatArray, near_mm: float) -> IntArray:
    out, first = np.empty(len(poses), np.int64), np.empty((0, 7))
    for i, pose in enumerate(poses):
        away = np.linalg.norm(se3.displacement(first, pose) * np.repeat([SIZE_MM, 1.0], 3), axis=1) if len(first) else np.empty(0)
        near = np.flatnonzero(away < near_mm)
        out[i] = near[np.argmin(away[near])] if len(near) else len(first)
        if not len(near):
            first = np.vstack([first, pose])
    return out
