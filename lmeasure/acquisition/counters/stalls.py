"""Stalls: a counter that is stuck while the others move. Found over a whole run, whose counts come piece by piece."""

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from lmeasure.acquisition.counters.events import Event, EventLog
from lmeasure.core import FloatArray
from lmeasure.kernels import rests
from lmeasure.recording import Counts
from lmeasure.rig import Rig
from lmeasure.text import message

STALL_S = 1.0
STALL_OTHERS_MM = 20.0
"""A channel that keeps its count for STALL_S while the median of the others is moved this far (there and back counts) is stuck."""


@dataclass(frozen=True)
class Stall:
    """A channel (its column) without good counts from sample `begin` to `last`, at those times [s]; path of the others meanwhile [mm]."""

    channel: int
    begin: int
    last: int
    begin_s: float
    last_s: float
    others_mm: float


@dataclass
class _Rest:
    """A count that stays the same: its value, its first and last sample with time [s] and paths (m,) [mm], and the first sample at which
    others moved."""

    value: float
    first_s: float
    path: FloatArray
    last: int
    last_s: float
    last_path: FloatArray
    begin: int
    begin_s: float
    moved: bool = False

    @classmethod
    def at(cls, row: int, first: int, time_s: FloatArray, value: float, *, path: FloatArray) -> Self:
        """Begin at a row of a piece whose first sample has number `first`."""
        t, number = float(time_s[row]), first + row
        return cls(value, t, path[row].copy(), number, t, path[row].copy(), number, t)

    def extend(self, rows: slice, first: int, time_s: FloatArray, column: FloatArray, *, path: FloatArray, j: int) -> None:
        """Extend the rest over rows of a piece that have no other count of channel j."""
        same = np.flatnonzero(column[rows] == self.value)
        if len(same):
            at = rows.start + int(same[-1])
            self.last, self.last_s, self.last_path = first + at, float(time_s[at]), path[at].copy()
        if self.moved or rows.stop == rows.start or not np.median(np.delete(path[rows.stop - 1] - self.path, j)) > 0:
            return
        # the others had not moved before this row, so the count is good
        at = rows.start + int(np.argmax(np.median(np.delete(path[rows] - self.path, j, axis=1), axis=1) > 0))
        self.begin, self.begin_s, self.moved = first + at, float(time_s[at]), True


class Stalls:
    """Search for stalls of the drums of one pass. A swivel may rest while cables move.

    Six cables have no redundancy: a stuck counter gives a plausible pose. A cable does not keep its length to one
    count while others move by centimetres.
    """

    def __init__(self, rig: Rig, channels: tuple[str, ...], passage: int = 1) -> None:
        drums = rig.drums_of(passage)
        self._own = [j for j, channel in enumerate(channels) if channel in drums]
        self._drums = [drums[channels[j]] for j in self._own]
        self._mm = np.array([drum.count_length_mm / drum.scale for drum in self._drums])
        self._before: FloatArray | None = None
        self._path = np.zeros((1, len(self._own)))
        self._rests: list[_Rest | None] = [None] * len(self._own)
        self._found: list[Stall] = []
        self._seen = 0

    def add(self, counts: Counts) -> None:
        """Take the next piece into account."""
        if len(self._own) < 2:
            return
        time_s, recorded = counts.time_s, counts.recorded[:, self._own]
        moves = np.diff(recorded, axis=0, prepend=recorded[:1] if self._before is None else self._before)
        for j, drum in enumerate(self._drums):
            if drum.counter_bits is not None:
                moves[:, j] = (moves[:, j] + 2.0 ** (drum.counter_bits - 1)) % 2.0**drum.counter_bits - 2.0 ** (drum.counter_bits - 1)
        path = np.cumsum(np.concatenate([self._path, np.nan_to_num(np.abs(moves)) * self._mm]), axis=0)[1:]
        for j, column in enumerate(np.ascontiguousarray(recorded.T)):
            self._look(j, time_s, column, path)
        self._before, self._path, self._seen = recorded[-1:].copy(), path[-1:].copy(), self._seen + len(time_s)

    def found(self) -> list[Stall]:
        """Return those of the whole run, when it has ended."""
        for j, rest in enumerate(self._rests):
            self._judge(j, rest)
        return sorted(self._found, key=lambda stall: (stall.channel, stall.begin))

    def _look(self, j: int, time_s: FloatArray, column: FloatArray, path: FloatArray) -> None:
        """Follow the rests of one channel through a piece."""
        n, first, rest, end = len(time_s), self._seen, self._rests[j], 0
        seen = np.flatnonzero(~np.isnan(column))
        if rest is not None:
            others = seen[column[seen] != rest.value]
            end = int(others[0]) if len(others) else n
            rest.extend(slice(0, end), first, time_s, column, path=path, j=j)
        if not len(seen) or end == n:
            return
        self._judge(j, rest)
        # the last count of the piece may continue in the next one
        value = float(column[seen[-1]])
        others = seen[column[seen] != value]
        begun = (
            int(seen[np.searchsorted(seen, others[-1], side="right")]) if len(others) and others[-1] >= end else int(seen[seen >= end][0])
        )
        inner = slice(end, begun)
        for a, b in (rests(time_s[inner], column[inner], STALL_S) + end).tolist():
            whole = _Rest.at(a, first, time_s, float(column[a]), path=path)
            whole.extend(slice(a, b + 1), first, time_s, column, path=path, j=j)
            self._judge(j, whole)
        self._rests[j] = rest = _Rest.at(begun, first, time_s, value, path=path)
        rest.extend(slice(begun, n), first, time_s, column, path=path, j=j)

    def _judge(self, j: int, rest: _Rest | None) -> None:
        """Keep a rest that is a stall."""
        if rest is None or rest.last_s - rest.first_s < STALL_S or self._drums[j].braked:
            return
        others = float(np.median(np.delete(rest.last_path - rest.path, j)))
        if others >= STALL_OTHERS_MM:
            self._found.append(Stall(self._own[j], rest.begin, rest.last, rest.begin_s, rest.last_s, others))


def note_stalls(found: list[Stall], channels: tuple[str, ...], events: EventLog, *, origin_s: float = 0.0) -> None:
    """Add an event for each stall; origin_s: start of its times by the frames' clock."""
    for one in found:
        span = message("event.stall", seconds=one.last_s - one.begin_s, others=one.others_mm)
        events.add(Event(one.begin, origin_s + one.begin_s, channels[one.channel], "stall", span))


def marked(counts: Counts, found: list[Stall]) -> Counts:
    """Return counts, or a piece of them by its first sample, with empty cells where a channel is stuck."""
    mine = [one for one in found if one.last >= counts.first and one.begin < counts.first + len(counts.time_s)]
    if not mine:
        return counts
    recorded = counts.recorded.copy()
    for one in mine:
        recorded[max(one.begin - counts.first, 0) : one.last + 1 - counts.first, one.channel] = np.nan
    frames = None if counts.frames is None else np.where(np.isnan(recorded) & ~np.isnan(counts.recorded), np.nan, counts.frames)
    return replace(counts, recorded=recorded, frames=frames)


def mark_stalls(rig: Rig, counts: Counts, events: EventLog, passage: int = 1, *, origin_s: float = 0.0) -> Counts | None:
    """Return the counts with empty cells where a channel is stuck while the others move, and an event for each; None without any."""
    search = Stalls(rig, counts.channels, passage)
    search.add(counts)
    found = search.found()
    note_stalls(found, counts.channels, events, origin_s=origin_s)
    return marked(counts, found) if found else None
