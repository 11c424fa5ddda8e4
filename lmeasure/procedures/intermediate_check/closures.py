"""Closures of a check: their sizes, and those expected from the calibration, the counts and the robot.

Two visits of one position differ by the rounding of their counts, by the robot's repeatability, and by errors that act differently at the
two (calibration, offset at zeroing and start cancel): the covariance of the difference of poses i and j is O_i O_i' + O_j O_j' + (F_i -
F_j)(F_i - F_j)' + twice the robot's, with O and F of `trajectory.pose_covariances.PoseCovariances`.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.accuracy import radii_95
from lmeasure.calibration import Distance
from lmeasure.core import FloatArray, IntArray, TrajectoryError, se3
from lmeasure.kernels import CABLE, KIND, span_lengths, span_rows
from lmeasure.sensors import Lengths, last_travel
from lmeasure.text import message
from lmeasure.trajectory import SETTLED, VISIT_LAG_S, Budget, PoseCovariances, RestFinder

MISSED = 0.05
"""Part of a run for which a cable need not be read: stops in it are not seen."""
BETWEEN = 60
"""Samples between two stops at which the tool is followed."""
STEPS = 40
SMALL_MM = 1e-9
SIZE_MM = 100.0
"""Lever arm that makes a turn of the tool comparable with a shift."""
TURN = 2.0 * np.pi


@dataclass(frozen=True)
class Stops:
    """N stops in order of time: begin_s, end_s (N,); place (N,): index of its position, from 0 in order of first visits; readings (N, m)
    and true counts (N, m) of all channels, NaN where one was not read; poses (N, 7); travel (N, m): direction of each cable's last motion,
    1 paying out, -1 winding in."""

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
    """Return the stops of a run from its lengths. Two are at one position if the tool's origin and its turn differ by less than near_mm, a
    turn at `SIZE_MM`. zero (m,): part of a span that readings do not show, if it differs from that at the start.

    TrajectoryError if the run has fewer than two rests, or no pose has its readings.
    """
    rig = budget.rig
    finder = RestFinder()
    of_cables = lengths.of_cables()
    missing = ~np.isfinite(of_cables.change_mm)
    if (share := missing.mean(axis=0)).max() > MISSED:
        j = int(np.argmax(share))
        numbers = {"since": float(lengths.time_s[missing[:, j].argmax()]), "percent": 100.0 * float(share[j])}
        raise TrajectoryError(message("error.check_misses_channel", where=source, channel=rig.cable[j].channel, **numbers))
    finder.add(lengths.time_s, of_cables.change_mm)
    rests = finder.rests()
    if len(rests) < 2:
        raise TrajectoryError(message("error.stands_still_time_s", where=source, n_rests=len(rests)))
    path = Path(budget, zero)
    n, m = len(rests), lengths.change_mm.shape[1]
    readings, counts, poses = np.full((n, m), np.nan), np.full((n, m), np.nan), np.empty((n, 7))
    travel = last_travel(np.where(np.isfinite(lengths.counts), lengths.counts, 0.0), 1.0 / rig.scales(rig.observed))
    ways, at, pose = np.zeros((n, m)), 0, budget.model.zero_pose
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
        if seen.sum() < len(budget.scheme.free) or not np.isfinite(path.residual(readings[i], pose)[seen]).all():
            raise TrajectoryError(message("error.no_pose_has_the", where=source, begin=begin))
        poses[i], at = pose, int(rows[-1])
    return Stops(rests.begin_s, rests.end_s, _places(poses, near_mm), readings, counts, poses, ways)


class Path:
    """Poses of a run, each from the one before, by weighted least squares of all channels that were read."""

    def __init__(self, budget: Budget, zero: FloatArray | None = None) -> None:
        self._rows, self._free = budget.scheme.rows, budget.scheme.free_index
        self._weight = 1.0 / np.sqrt(budget.length_variance)
        self._angles = self._rows[:, KIND] > CABLE
        begun = span_lengths(self._rows, budget.model.zero_pose[None])[0]
        self._zero = np.where(budget.absolute, 0.0, begun) if zero is None else zero

    def residual(self, reading: FloatArray, pose: FloatArray) -> FloatArray:
        """(m,) readings (m,) minus those at a pose (7,)."""
        off = reading - (span_lengths(self._rows, pose[None])[0] - self._zero)
        off[self._angles] -= TURN * np.round(off[self._angles] / TURN)
        return np.asarray(off)

    def pose(self, reading: FloatArray, near: FloatArray) -> FloatArray:
        """(7,) the pose that has the reading, near another; that other where too little was read."""
        pose, used, step = near, np.isfinite(reading), np.zeros(6)
        if used.sum() < len(self._free):
            return near
        scale = np.repeat([1.0 / SIZE_MM, 1.0], 3)
        for _ in range(STEPS):
            J = (span_rows(self._rows, pose) * scale)[np.ix_(used, self._free)] * self._weight[used, None]
            off = self.residual(reading, pose)[used] * self._weight[used]
            if not (np.isfinite(J).all() and np.isfinite(off).all()):
                return near
            step[self._free] = np.linalg.lstsq(J, off)[0]
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


GAUSS_95 = 1.959963984540054


@dataclass(frozen=True)
class Closure:
    """kind: return, revisit, reversal, drift, distance; name: of its position; value and u95 [mm]: the closure error, and its 95 % limit;
    probability of as much or more if all is as stated."""

    kind: str
    name: str
    value_mm: float
    u95_mm: float
    probability: float


def closures(
    budget: Budget, stops: Stops, known: PoseCovariances, distances: Sequence[Distance], *, repeatability_mm: float
) -> tuple[Closure, ...]:
    """All closures of a check; repeatability_mm: standard deviation per axis with which the robot comes back to a place, and of a turn at
    `SIZE_MM`."""
    robot = np.diag(np.repeat([(repeatability_mm / SIZE_MM) ** 2, repeatability_mm**2], 3))
    return (
        *_returns(stops, known, robot, budget.scheme.free_index),
        *_reversals(budget, stops, repeatability_mm),
        *_drifts(budget, stops, repeatability_mm),
        *(_distance(stops, known, each, repeatability_mm) for each in distances),
    )


def _returns(stops: Stops, known: PoseCovariances, robot: FloatArray, free: IntArray) -> list[Closure]:
    """Return the distance of each later visit of a place from the first one, in the freedoms (f,) that the rig measures."""
    out = []
    for place in range(int(stops.place.max()) + 1):
        first, *later = stops.visits(place)
        for number, i in enumerate(later, 2):
            apart = se3.displacement(stops.poses[i], stops.poses[first])
            moved = known.factors[i] - known.factors[first]
            C = known.random[i] + known.random[first] + moved @ moved.T + 2.0 * robot
            chi2 = float(apart[free] @ np.linalg.solve(C[np.ix_(free, free)], apart[free]))
            # the last visit of where the run began is the return of the whole
            whole = place == stops.place[0] and i == stops.visits(place)[-1]
            name = f"P{place + 1} ({number})"
            radius = float(radii_95(C[None, 3:, 3:])[0])
            size = float(np.linalg.norm(apart[3:]))
            out.append(Closure("return" if whole else "revisit", name, size, radius, float(scipy.stats.chi2.sf(chi2, len(free)))))
    return out


def _tested(kind: str, name: str, value: float, u: float) -> Closure:
    return Closure(kind, name, value, GAUSS_95 * u, float(2.0 * scipy.stats.norm.sf(abs(value) / u)))


def _scatter_mm(budget: Budget, stops: Stops, repeatability_mm: float) -> FloatArray:
    """(cables,) standard deviations [mm] of a cable's length at a visit: of counting and of the robot, which moves its end."""
    m = len(budget.rig.cable)
    rows = np.array([span_rows(budget.scheme.rows, pose)[:m] for pose in stops.poses])
    turned = np.linalg.norm(rows[:, :, :3], axis=2) / SIZE_MM
    by_robot = repeatability_mm**2 * (1.0 + np.mean(turned**2, axis=0))
    return np.sqrt(budget.variance[:m] + by_robot)


def _reversals(budget: Budget, stops: Stops, repeatability_mm: float) -> list[Closure]:
    """Return, for each cable, its length at places that it came to both ways, paid out minus wound in, the mean over places."""
    out, u = [], _scatter_mm(budget, stops, repeatability_mm)
    for j, c in enumerate(budget.rig.cable):
        differences, weights = [], []
        for place in range(int(stops.place.max()) + 1):
            visits = stops.visits(place)
            ways = [visits[stops.travel[visits, j] == side] for side in (1.0, -1.0)]
            if all(len(way) for way in ways):
                differences.append(float(np.nanmean(stops.readings[ways[0], j]) - np.nanmean(stops.readings[ways[1], j])))
                weights.append(1.0 / (1.0 / len(ways[0]) + 1.0 / len(ways[1])))
        if differences and np.isfinite(differences).all():
            value = float(np.average(differences, weights=weights))
            # a stated band is expected, and no finding
            out.append(_tested("reversal", c.name, value, float(np.hypot(u[j] / np.sqrt(sum(weights)), 2.0 * budget.unsolved.play_mm[j]))))
    return out


def _drifts(budget: Budget, stops: Stops, repeatability_mm: float) -> list[Closure]:
    """Return, for each cable, how its length at places changes with time, over the whole of the run; least squares with a constant of each
    place."""
    out, u = [], _scatter_mm(budget, stops, repeatability_mm)
    time_s = (stops.begin_s + stops.end_s) / 2.0
    span = float(time_s[-1] - time_s[0])
    for j, c in enumerate(budget.rig.cable):
        y, t = stops.readings[:, j].copy(), time_s.copy()
        for place in range(int(stops.place.max()) + 1):
            visits = stops.visits(place)
            y[visits] -= y[visits].mean()
            t[visits] -= t[visits].mean()
        square = float(t @ t)
        if square > 0.0 and np.isfinite(y).all():
            out.append(_tested("drift", c.name, float(t @ y) / square * span, float(u[j]) / np.sqrt(square) * span))
    return out


def _distance(stops: Stops, known: PoseCovariances, requested: Distance, repeatability_mm: float) -> Closure:
    at = []
    for name in (requested.a, requested.b):
        if name not in stops.names:
            raise TrajectoryError(message("error.distance_is_none_of_the", name=name, fromkeys=", ".join(dict.fromkeys(stops.names))))
        at.append(stops.names.index(name))
    i, j = at
    way = stops.poses[i, :3] - stops.poses[j, :3]
    length = float(np.linalg.norm(way))
    if not length > 0.0:
        raise TrajectoryError(message("error.distance_and_are_one_place", a=requested.a, b=requested.b))
    e = way / length
    own = np.concatenate([e @ known.own[i, 3:], e @ known.own[j, 3:], e @ (known.factors[i, 3:] - known.factors[j, 3:])])
    u = float(np.sqrt(own @ own + requested.u_mm**2 + 2.0 * repeatability_mm**2))
    return _tested("distance", f"{requested.a} to {requested.b}", length - requested.mm, u)
