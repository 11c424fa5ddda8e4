"""Whether the robot stands still, found by its counts as they come, and the samples of the rest it is in."""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition import GoneOn, Samples, joined
from lmeasure.core import FloatArray
from lmeasure.rig import Rig

STILL_MM = 0.1
"""By which no cable's length changes while the robot stands still: half of what a run's rests are given by, for here a mean is wanted."""
STILL_DEG = 0.01
"""The same of angles."""
STILL_COUNTS = 5.0
"""At least: a counter at the edge of a count goes to and fro, and so does one that trembles."""
SILENT_S = 0.5
LONGEST_S = 60.0
LEAP = 20.0
"""Times as much as before and after it a channel moves from one sample to the next when it leaps."""
TOGETHER = 0.5
"""Part of the channels that leap at once at most; if more do, the robot moved between two samples."""
PART_UNSEEN = 0.25
"""Of a dwell that is read: without samples for longer it is not, unless UNSEEN median intervals are longer."""
UNSEEN = 2.5
HOLE = 1.5
"""Median intervals: farther apart, samples do not tell a leap."""


def still_counts(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) recorded counts by which channels change at most while the robot stands still."""
    known = [rig.counters_of(passage)[c] for c in channels]
    still = [(STILL_MM if c.is_length else math.radians(STILL_DEG)) * c.scale / c.per_count for c in known]
    return np.maximum(np.array(still), STILL_COUNTS)


@dataclass(frozen=True)
class Leap:
    """A channel that moved by so many counts from one sample to the next, alone and at once."""

    channel: str
    counts: float
    time_s: float


class Rest:
    """The rest that the newest samples belong to: their times (n,) and counts (n, m), none while the robot moves.

    band (m,): counts by which channels change within a rest at most; modulus (m,): see `moduli`, counts here go on from the first ones
    seen. Of a long one only the last `LONGEST_S` are kept; since_s is when it
    began. Time is that of the samples, whenever they come.
    """

    def __init__(self, channels: tuple[str, ...], band: FloatArray, modulus: FloatArray) -> None:
        self.channels, self._band, self._gone_on = channels, band, GoneOn(modulus)
        self.time_s, self.counts = np.empty(0), np.empty((0, len(channels)))
        self.begun_s = self.since_s = self.now_s = np.nan
        self._seen_s, self._speed = np.full(len(channels), -np.inf), np.zeros(len(channels))
        self._tail = Samples(self.time_s, self.counts)
        self._leaps: list[Leap] = []

    def add(self, samples: Samples) -> None:
        """The next samples; what is not of the rest that they end in is let go."""
        if not len(samples.time_s):
            return
        samples = Samples(samples.time_s, self._gone_on.of(samples.recorded[:, : len(self.channels)]))
        self.begun_s = float(samples.time_s[0]) if np.isnan(self.begun_s) else self.begun_s
        self.now_s = float(samples.time_s[-1])
        there = np.isfinite(samples.recorded)
        last = samples.time_s[len(there) - 1 - np.argmax(there[::-1], axis=0)]
        self._seen_s = np.where(there.any(axis=0), last, self._seen_s)
        self._tail = self._look_for_leaps(joined([self._tail, samples]))
        whole = joined([Samples(self.time_s, self.counts), samples])
        # extremes of all that is behind each sample only grow backwards; an empty cell neither moves nor stands
        behind = whole.recorded[::-1]
        extent = np.nan_to_num(np.fmax.accumulate(behind) - np.fmin.accumulate(behind))[::-1]
        moved = int((extent > self._band).any(axis=1).sum())
        if moved or np.isnan(self.since_s):
            self.since_s = float(whole.time_s[moved])
        first = max(moved, int(np.searchsorted(whole.time_s, self.now_s - LONGEST_S)))
        self.time_s, self.counts = whole.time_s[first:], whole.recorded[first:]

    def _look_for_leaps(self, piece: Samples) -> Samples:
        """Steps that have one before and one behind them; the samples with which those of the next piece are looked at."""
        if len(piece.time_s) > 1:
            lasts = max(piece.time_s[-1] - piece.time_s[0], 1e-9)
            self._speed = np.nan_to_num(np.abs(piece.recorded[-1] - piece.recorded[0])) / lasts
        if len(piece.time_s) > 3:
            step, pause = np.diff(piece.recorded, axis=0), np.diff(piece.time_s)
            size = np.abs(step)
            beside = np.maximum(np.maximum(size[:-2], size[2:]), 1.0)
            leaps = (size[1:-1] > np.maximum(LEAP * beside, 2.0 * self._band)) & (pause[1:-1] < HOLE * np.median(pause))[:, None]
            leaps &= (leaps.mean(axis=1) <= TOGETHER)[:, None]
            for row, j in np.argwhere(leaps):
                self._leaps.append(Leap(self.channels[j], float(step[row + 1, j]), float(piece.time_s[row + 2])))
        return Samples(piece.time_s[-3:], piece.recorded[-3:])

    def leaps(self) -> list[Leap]:
        """Those since the last question."""
        reported, self._leaps = self._leaps, []
        return reported

    @property
    def lasts_s(self) -> float:
        """For how long the robot has been still [s]."""
        return float(self.now_s - self.since_s) if len(self.time_s) else 0.0

    def seen_throughout(self, seconds: float) -> bool:
        """Whether samples came all along the last seconds of the rest: in a hole the robot may have been elsewhere."""
        intervals = np.diff(self.time_s)
        if not len(intervals):
            return False
        longest = np.diff(np.concatenate([[self.now_s - seconds], self.last(seconds).time_s])).max()
        return bool(longest <= max(PART_UNSEEN * seconds, UNSEEN * np.median(intervals)))

    @property
    def silent(self) -> tuple[str, ...]:
        """Channels of which no count came for `SILENT_S`."""
        since = np.maximum(self._seen_s, self.begun_s)
        return tuple(c for c, s in zip(self.channels, since, strict=True) if self.now_s - s > SILENT_S)

    @property
    def fastest(self) -> tuple[str, float]:
        """The channel that moves fastest, and how fast [counts/s]."""
        j = int(np.argmax(self._speed))
        return self.channels[j], float(self._speed[j])

    def last(self, seconds: float) -> Samples:
        """The last seconds of the rest."""
        rows = slice(int(np.searchsorted(self.time_s, self.now_s - seconds - 1e-9)), None)
        return Samples(self.time_s[rows], self.counts[rows])
