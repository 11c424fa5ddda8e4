"""Channels that stand on one count while their attachment point is drawn far: an encoder that died, a cable that hangs."""

from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.trajectory.faults.steps import two_largest

STANDS_S = 0.2
STANDS_MM = 50.0
"""For so long at least, and by so much another cable of the same attachment point moves while one stands on a count: its point moves, and
not on a sphere."""
MOST_MM = 5.0
MOST = 2.0
"""From sample to sample a cable is drawn by so much at most, or by so many times the second most of all cables; what is more is a step."""
MOVES_MM = 5.0
MOVING = 3
"""Cables that move at least so much, when the tool does."""


@dataclass(frozen=True)
class Stood:
    """A cable (index) whose channel stood from after_s on, until_s [s] or to the end."""

    cable: int
    after_s: float
    until_s: float


class StandingFinder:
    """Channels that stand on one count while another cable of the same attachment point moves far."""

    def __init__(self, rig: Rig) -> None:
        points = np.array([c.to_point for c in rig.cable])
        m = len(points)
        braked = np.array([rig.point(c.from_point).drum.braked for c in rig.cable])
        self._together = (points[:, None] == points) & ~np.eye(m, dtype=np.bool_) & ~braked[:, None]
        # of each channel: its last count and since when, the extremes of the ways of all cables since then, and whether it has been told
        self._last, self._last_s, self._since = np.full(m, np.nan), np.full(m, np.nan), np.full(m, np.nan)
        self._low, self._high = np.full((m, m), np.inf), np.full((m, m), -np.inf)
        self._told, self._way = np.zeros(m, np.bool_), np.zeros(m)
        self._found: list[Stood] = []

    def add(self, time_s: FloatArray, mm: FloatArray) -> None:
        """The next samples: times (n,) and lengths (n, m) by the counts alone."""
        # a cable that steps has not been drawn
        steps = np.nan_to_num(np.diff(mm, axis=0, prepend=self._last[None]))
        most = np.maximum(MOST_MM, MOST * two_largest(np.abs(steps.T))[1])[:, None]
        gone = steps.clip(-most, most).cumsum(axis=0) + self._way
        self._way = gone[-1]
        for j in np.flatnonzero(self._together.any(axis=1)):
            # empty cells neither move a channel nor let it stand
            seen = np.flatnonzero(np.isfinite(mm[:, j]))
            if len(seen):
                self._look(int(j), time_s[seen], mm[seen, j], gone[seen])

        for cable, column in enumerate(mm.T):
            seen = np.flatnonzero(np.isfinite(column))
            if len(seen):
                self._last[cable], self._last_s[cable] = column[seen[-1]], time_s[seen[-1]]

    def _look(self, j: int, time_s: FloatArray, mm: FloatArray, gone: FloatArray) -> None:
        """At a channel's own samples: times and lengths (n,), and the ways of all cables (n, m)."""
        values, times = np.concatenate([self._last[j : j + 1], mm]), np.concatenate([self._last_s[j : j + 1], time_s])
        moved = np.flatnonzero((values[1:] != values[:-1]) | ~(np.diff(times) <= STANDS_S))
        edges = np.concatenate([[0], moved, [len(time_s)]])
        # the one that goes on from before, long ones, and the one that will go on
        lasting = time_s[edges[1:] - 1] - time_s[edges[:-1]] >= STANDS_S
        lasting[0] = lasting[-1] = True
        for number in np.flatnonzero(lasting).tolist():
            begin, end = int(edges[number]), int(edges[number + 1])
            if number:
                self._begin(j, float(time_s[begin]))
            if end > begin:
                self._go_on(j, time_s[begin:end], gone[begin:end])
            if self._told[j] and end < len(time_s):
                # the last sample at which it stood may be one of the piece before
                self._end(j, float(time_s[end - 1]) if end else float(self._last_s[j]))

    def _end(self, j: int, time_s: float) -> None:
        k = max(i for i, stood in enumerate(self._found) if stood.cable == j)
        self._found[k] = replace(self._found[k], until_s=time_s)

    def _begin(self, j: int, time_s: float) -> None:
        self._since[j], self._told[j] = time_s, False
        self._low[j], self._high[j] = np.inf, -np.inf

    def _go_on(self, j: int, time_s: FloatArray, mm: FloatArray) -> None:
        if self._told[j]:
            return
        self._low[j] = np.fmin(self._low[j], np.fmin.reduce(mm, axis=0))
        self._high[j] = np.fmax(self._high[j], np.fmax.reduce(mm, axis=0))
        far = self._high[j] - self._low[j]
        # one cable alone that runs off is itself at fault
        since = float(self._since[j] if np.isfinite(self._since[j]) else time_s[0])
        self._since[j] = since
        long = time_s[-1] - since >= STANDS_S
        if long and far[self._together[j]].max() > STANDS_MM and (far > MOVES_MM).sum() >= MOVING:
            self._told[j] = True
            self._found.append(Stood(j, since, np.inf))

    def found(self) -> tuple[Stood, ...]:
        """All of them."""
        return tuple(sorted(self._found, key=lambda stood: stood.after_s))
