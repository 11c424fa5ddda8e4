"""Where a trajectory rests, told by its poses, and the part of each rest in which the robot has settled."""

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.trajectory.record import Trajectory

LAG_S = 0.05
"""A robot that in this time moves by less than what a still one may is resting."""
LEAST_S = 0.15
"""Shortest rest that counts as a dwell: turning points of a motion are shorter."""
SETTLED = 0.5
"""Of a rest: its last part, when the robot no longer swings."""
LEAVES = 4.0
"""Times as far from the middle of a rest as its middle part scatters: the robot is on its way again."""


def rests(trajectory: Trajectory, positions: FloatArray, still_mm: float) -> list[slice]:
    """The samples of each rest, in order of time: positions (n, 3) that move by less than still_mm within `LAG_S` for `LEAST_S` at least.

    Samples that are not ok end a rest.
    """
    time_s = trajectory.time_s
    if len(time_s) < 2:
        return []
    ahead = np.minimum(np.searchsorted(time_s, time_s + LAG_S), len(time_s) - 1)
    with np.errstate(invalid="ignore"):
        still = (np.linalg.norm(positions[ahead] - positions, axis=1) <= still_mm) & ~np.isnan(positions[:, 0])
    edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
    out = []
    for first, stop in edges.reshape(-1, 2):
        # the last sample that was compared belongs to the rest as well
        last = int(ahead[stop - 1])
        while np.isnan(positions[last, 0]):
            last -= 1
        if time_s[last] - time_s[first] >= LEAST_S:
            out.append(slice(int(first), last + 1))
    return out


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
