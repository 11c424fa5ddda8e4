"""Quality of a trajectory: the uncertainty of each pose, the samples without one, the speed; thinned for pictures."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.accuracy.readings import stated_radii_95
from lmeasure.core import WORDS, FloatArray, IntArray, Status, TrajectoryError, se3
from lmeasure.text import Cause
from lmeasure.trajectory import FULL, WIDEST_S, Motion, Trajectory, motion_of

MOST_ROWS = 12_000
MOST_STRETCHES = 2_000  # Of a status; more of them lie so close together that a picture shows them as one
AXIS_95 = 1.959963984540054  # Half width of the 95 % interval of a normal coordinate, in standard uncertainties


@dataclass(frozen=True)
class Stretch:
    """Samples first to last of one status, cause and cables; begin_s, end_s: of the first and of the last."""

    first: int
    last: int
    begin_s: float
    end_s: float
    status: int
    cause: Cause
    cable: str

    @property
    def ok(self) -> bool:
        """Whether these samples have a pose, though not all cables."""
        return self.status == Status.OK

    @property
    def samples(self) -> int:
        """Return how many."""
        return self.last - self.first + 1


@dataclass(frozen=True)
class Along:
    """u95_mm, u95_rad (n,): radii that hold 95 % of the tool origin and of the rotation vector, NaN without a pose or a statement;
    rotation_deg (n, 3): since the first known orientation, rotation vector about the base axes; stretches: all samples that are not ok, or
    ok without a cable; motion: its speed, None where `no_motion` states why; rows: samples that a picture needs, at most about MOST_ROWS,
    among them the extremes of every figure and the ends of every stretch."""

    trajectory: Trajectory
    u95_mm: FloatArray
    u95_rad: FloatArray
    rotation_deg: FloatArray
    stretches: tuple[Stretch, ...]
    motion: Motion | None
    no_motion: str
    rows: IntArray

    @property
    def worst(self) -> int | None:
        """The sample whose place is known least; None where nothing is stated."""
        return None if np.isnan(self.u95_mm).all() else int(np.nanargmax(self.u95_mm))


def along(trajectory: Trajectory) -> Along:
    """Return the plotted and reported quality of a trajectory."""
    covariance = trajectory.random + trajectory.systematic
    u95_mm, u95_rad = stated_radii_95(covariance[:, 3:, 3:]), stated_radii_95(covariance[:, :3, :3])
    no_place, no_turn = np.isnan(trajectory.poses[:, 0]), np.isnan(trajectory.poses[:, 3])
    u95_mm[no_place], u95_rad[no_turn] = np.nan, np.nan
    stretches = stretches_of(trajectory)
    motion, why = _motion(trajectory)
    turned = _turned(trajectory.poses)
    series = [*trajectory.poses[:, :3].T, *turned.T, u95_mm, u95_rad, trajectory.worst_pressure_angle_deg]
    if motion is not None:
        series.append(motion.speed_mm_s)
    kinds = [[s for s in stretches if s.status == status] for status in range(len(WORDS))]
    shown = [s for kind in kinds for s in merged(kind, float(np.ptp(trajectory.time_s)) / MOST_STRETCHES)]
    edges = np.array([i for s in shown for i in (s.first - 1, s.first, s.last, s.last + 1)], dtype=np.int64)
    n = len(trajectory.time_s)
    rows = kept_rows(series, edges[(edges >= 0) & (edges < n)], MOST_ROWS)
    return Along(trajectory, u95_mm, u95_rad, turned, stretches, motion, why, rows)


def _turned(poses: FloatArray) -> FloatArray:
    """(n, 3) rotation vectors [deg], base axes, from the first known orientation."""
    out = np.full((len(poses), 3), np.nan)
    known = np.flatnonzero(~np.isnan(poses[:, 3]))
    if len(known):
        turns = se3.rotation(poses[known])
        out[known] = np.degrees((turns * turns[0].inv()).as_rotvec())
    return out


def _motion(trajectory: Trajectory) -> tuple[Motion | None, str]:
    """The motion, or why there is none."""
    try:
        needed = FULL * float(np.median(np.diff(trajectory.time_s))) if len(trajectory.time_s) > 1 else 0.0
        return motion_of(trajectory, needed if needed > WIDEST_S else None), ""
    except TrajectoryError as error:
        return None, str(error)


def stretches_of(trajectory: Trajectory) -> tuple[Stretch, ...]:
    """All stretches of one status, cause and cables that are not ok, or ok without a cable."""
    said = (trajectory.status, trajectory.cause, trajectory.cable)
    n = len(trajectory.status)
    changed = np.zeros(n, np.bool_)
    for values in said:
        changed[1:] |= values[1:] != values[:-1]
    first = np.concatenate([[0], np.flatnonzero(changed)])
    last = np.concatenate([first[1:] - 1, [n - 1]])
    plain = (trajectory.status[first] == Status.OK) & (trajectory.cable[first] == "")
    return tuple(
        Stretch(a, b, float(trajectory.time_s[a]), float(trajectory.time_s[b]), int(trajectory.status[a]), said[1][a], str(said[2][a]))
        for a, b in zip(first[~plain].tolist(), last[~plain].tolist(), strict=True)
    )


def merged(stretches: Sequence[Stretch], gap_s: float) -> list[Stretch]:
    """Stretches of one status of which those less than a gap apart are one: none vanishes."""
    out: list[Stretch] = []
    for s in stretches:
        if out and s.begin_s - out[-1].end_s <= gap_s and s.status == out[-1].status:
            out[-1] = replace(out[-1], last=s.last, end_s=s.end_s)
        else:
            out.append(s)
    return out


def kept_rows(series: Sequence[FloatArray], must: IntArray, most: int) -> IntArray:
    """Rows, in order, that draw series (n,) as all of them would: of each of equal pieces the least and the largest value of each series,
    the first and the last of all, and those that must be there."""
    n = len(series[0])
    if n <= most:
        return np.arange(n)
    pieces = max(1, most // (2 * len(series)))
    size = -(-n // pieces)
    start = np.arange(0, n, size)
    rows = [np.array([0, n - 1]), must]
    for values in series:
        padded = np.full(len(start) * size, np.nan)
        padded[:n] = values
        blocks = padded.reshape(-1, size)
        some = ~np.isnan(blocks).all(axis=1)
        if some.any():
            rows += [start[some] + np.nanargmin(blocks[some], axis=1), start[some] + np.nanargmax(blocks[some], axis=1)]
    return np.unique(np.concatenate(rows)).astype(np.int64)
