"""Where a trajectory rests, told by its poses, and the part of each rest in which the robot has settled."""

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.trajectory.files.trajectory import Trajectory

LAG_S = 0.05
"""A robot that in this time moves by less than what a still one may is resting."""
LEAST_S = 0.15
"""Shortest rest that counts as a dwell: turning points of a motion are shorter."""
BROKEN_S = 0.15
"""Shorter than it a rest is not left for another at the same place: single samples lay off."""
UNSEEN_S = 1.0
"""Without a sample for longer, or for several usual intervals, the robot may have been elsewhere."""
SETTLED = 0.5
"""Of a rest: its last part, when the robot no longer swings."""
LEAVES = 4.0
"""Times as far from the middle of a rest as its middle part scatters: the robot is on its way again."""


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
    """Whether two rests are one that some samples that lie off have broken."""
    between = positions[one.stop - 1 : other.start + 1]
    if time_s[other.start] - time_s[one.stop - 1] > BROKEN_S or np.isnan(between).any():
        return False
    apart = np.median(positions[one], axis=0) - np.median(positions[other], axis=0)
    return bool(np.linalg.norm(apart) <= still_mm)


def settled(time_s: FloatArray, positions: FloatArray, rest: slice) -> tuple[float, float]:
    """The window of a rest: from its middle to where the robot is about to leave, which it does slowly at first.

    It leaves when it goes away for good: of counts that flicker now and then while it stands some lie outside its scatter.
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
