"""Detection of the robot's rests in its incoming counts, and the samples of the present rest."""

import math
from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from lmeasure.acquisition import ContinuedCounts, Samples, joined
from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.text import message

STILL_MM = 0.1
"""Largest change of a cable's length while the robot rests: half of that of a run's rests, since here a mean is wanted."""
STILL_DEG = 0.01
"""The same of angles."""
STILL_COUNTS = 5.0
"""Least such change in counts: a counter at the edge of a count, or one that trembles, goes to and fro."""
SILENT_S = 0.5
LONGEST_S = 60.0
LEAP = 20.0
"""Times as much as before and after it a channel moves from one sample to the next when it leaps."""
TOGETHER = 0.5
"""Part of the channels that leap at once at most; if more do, the robot moved between two samples."""
PART_UNSEEN = 0.25
"""Part of a dwell without samples above which it is not read, unless UNSEEN median intervals are longer."""
UNSEEN = 2.5
NEWEST = 200
"""Samples from which a median interval is taken."""
HOLE = 1.5
"""Median intervals between samples above which a jump cannot be detected."""


def still_counts(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """Return (m,) the largest changes of channels while the robot rests [counts]."""
    known = [rig.counters_of(passage)[c] for c in channels]
    still = [(STILL_MM if c.is_length else math.radians(STILL_DEG)) * c.scale / c.per_count for c in known]
    return np.maximum(np.array(still), STILL_COUNTS)


@dataclass(frozen=True)
class Leap:
    """A channel that moved by so many counts from one sample to the next, alone and at once."""

    channel: str
    counts: float
    time_s: float


class _Piece(NamedTuple):
    """Samples that came together: number of the first, how many they are, and extremes (m,) of their counts."""

    first: int
    rows: int
    least: FloatArray
    most: FloatArray


def _extremes(counts: FloatArray) -> tuple[FloatArray, FloatArray]:
    return np.fmin.reduce(counts), np.fmax.reduce(counts)


def _median(values: FloatArray) -> float:
    """Return the upper median; np.median takes ten times as long for a few values."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


class _Rows:
    """Samples with m channels that are numbered as they come: new ones are added, old ones forgotten, and none is copied each time."""

    def __init__(self, channels: int) -> None:
        self._time_s, self._counts = np.empty(256), np.empty((256, channels))
        self._before = self._begin = self._end = 0

    def add(self, samples: Samples) -> int:
        """Add samples; return the number of the first."""
        count, kept = len(samples.time_s), self._end - self._begin
        if self._end + count > len(self._time_s):
            size = max(2 * (kept + count), 256)
            time_s, counts = np.empty(size), np.empty((size, self._counts.shape[1]))
            time_s[:kept], counts[:kept] = self.all.time_s, self.all.recorded
            self._before, self._begin, self._end = self._before + self._begin, 0, kept
            self._time_s, self._counts = time_s, counts
        first, self._end = self._end, self._end + count
        self._time_s[first : self._end], self._counts[first : self._end] = samples.time_s, samples.recorded
        return self._before + first

    def begin(self, number: int) -> None:
        """Forget samples before this one."""
        self._begin = number - self._before

    def part(self, first: int, rows: int) -> Samples:
        """Return so many samples from a number on."""
        part = slice(first - self._before, first - self._before + rows)
        return Samples(self._time_s[part], self._counts[part])

    def time_of(self, number: int) -> float:
        """Return the time of a sample [s]."""
        return float(self._time_s[number - self._before])

    @property
    def all(self) -> Samples:
        """All samples that are kept."""
        return Samples(self._time_s[self._begin : self._end], self._counts[self._begin : self._end])


class Rest:
    """The rest that the newest samples belong to: their times (n,) and counts (n, m), none while the robot moves.

    band (m,): largest changes of channels within a rest [counts]; modulus (m,): see `moduli`, counts here continue from the first ones.
    Only the last `LONGEST_S` of a long rest are kept; since_s is its beginning. Time is that of the samples, whenever they come.
    """

    def __init__(self, channels: tuple[str, ...], band: FloatArray, modulus: FloatArray) -> None:
        self.channels, self._band, self._gone_on = channels, band, ContinuedCounts(modulus)
        self._rows = _Rows(len(channels))
        self._pieces: deque[_Piece] = deque()
        self._least, self._most = np.full((2, len(channels)), np.nan)
        self.begun_s = self.since_s = self.now_s = np.nan
        self._seen_s, self._speed = np.full(len(channels), -np.inf), np.zeros(len(channels))
        self._tail = Samples(self.time_s, self.counts)
        self._leaps: list[Leap] = []

    def add(self, samples: Samples) -> None:
        """Add the next samples; those before the rest that they end in are dropped."""
        if not len(samples.time_s):
            return
        samples = Samples(samples.time_s, self._gone_on.of(samples.recorded[:, : len(self.channels)]))
        self.begun_s = float(samples.time_s[0]) if np.isnan(self.begun_s) else self.begun_s
        self.now_s = float(samples.time_s[-1])
        there = np.isfinite(samples.recorded)
        last = samples.time_s[len(there) - 1 - np.argmax(there[::-1], axis=0)]
        self._seen_s = np.where(there.any(axis=0), last, self._seen_s)
        self._tail = self._look_for_leaps(joined([self._tail, samples]))
        piece = _Piece(self._rows.add(samples), len(samples.time_s), *_extremes(samples.recorded))
        self._pieces.append(piece)
        self._least, self._most = np.fmin(self._least, piece.least), np.fmax(self._most, piece.most)
        if np.isnan(self.since_s):
            self.since_s = float(samples.time_s[0])
        if (self._most - self._least > self._band).any():
            self._let_go_of_motion()
        while self._rows.time_of(self._pieces[0].first + self._pieces[0].rows - 1) < self.now_s - LONGEST_S:
            self._pieces.popleft()
        self._rows.begin(self._pieces[0].first)

    def _let_go_of_motion(self) -> None:
        """Keep the newest samples within the band. An empty cell neither moves nor rests."""
        pieces = list(self._pieces)[::-1]
        # extremes of all that is behind a sample only grow backwards: the first piece that leaves the band is looked at by samples
        least = np.fmin.accumulate([p.least for p in pieces])
        most = np.fmax.accumulate([p.most for p in pieces])
        outside = np.flatnonzero((most - least > self._band).any(axis=1))
        if len(outside):
            k = int(outside[0])
            piece = pieces[k]
            rows = self._rows.part(piece.first, piece.rows).recorded[::-1]
            behind = np.vstack([most[k - 1 : k], least[k - 1 : k], rows]) if k else rows
            extent = (np.fmax.accumulate(behind) - np.fmin.accumulate(behind))[len(behind) - len(rows) :]
            kept = int((~(extent > self._band).any(axis=1)).sum())
            self._pieces = deque(pieces[:k][::-1])
            if kept:
                self._pieces.appendleft(_Piece(piece.first + piece.rows - kept, kept, *_extremes(rows[:kept])))
            if kept < piece.rows:
                self.since_s = self._rows.time_of(self._pieces[0].first)
        self._least = np.fmin.reduce([p.least for p in self._pieces])
        self._most = np.fmax.reduce([p.most for p in self._pieces])

    @property
    def time_s(self) -> FloatArray:
        """(n,) times of the samples of the rest."""
        return self._rows.all.time_s

    @property
    def counts(self) -> FloatArray:
        """(n, m) counts of the rest."""
        return self._rows.all.recorded

    def _look_for_leaps(self, piece: Samples) -> Samples:
        """Steps that have one before and one behind them; the samples with which those of the next piece are looked at."""
        if len(piece.time_s) > 1:
            lasts = max(piece.time_s[-1] - piece.time_s[0], 1e-9)
            self._speed = np.nan_to_num(np.abs(piece.recorded[-1] - piece.recorded[0])) / lasts
        if len(piece.time_s) > 3:
            step, pause = np.diff(piece.recorded, axis=0), np.diff(piece.time_s)
            size = np.abs(step)
            beside = np.maximum(np.maximum(size[:-2], size[2:]), 1.0)
            leaps = (size[1:-1] > np.maximum(LEAP * beside, 2.0 * self._band)) & (pause[1:-1] < HOLE * _median(pause))[:, None]
            leaps &= (leaps.mean(axis=1) <= TOGETHER)[:, None]
            for row, j in np.argwhere(leaps):
                self._leaps.append(Leap(self.channels[j], float(step[row + 1, j]), float(piece.time_s[row + 2])))
        return Samples(piece.time_s[-3:], piece.recorded[-3:])

    @property
    def middle(self) -> FloatArray:
        """(m,) counts in the middle of the rest's extremes."""
        return (self._least + self._most) / 2.0

    def leaps(self) -> list[Leap]:
        """Those since the last question."""
        reported, self._leaps = self._leaps, []
        return reported

    @property
    def lasts_s(self) -> float:
        """Return the duration of the robot's rest [s]."""
        return float(self.now_s - self.since_s) if len(self.time_s) else 0.0

    def seen_throughout(self, seconds: float) -> bool:
        """Return whether samples came throughout the last seconds of the rest: in a hole the robot may have been elsewhere."""
        intervals = np.diff(self.time_s[-NEWEST:])
        if not len(intervals):
            return False
        longest = np.diff(np.concatenate([[self.now_s - seconds], self.last(seconds).time_s])).max()
        return bool(longest <= max(PART_UNSEEN * seconds, UNSEEN * _median(intervals)))

    @property
    def silent(self) -> tuple[str, ...]:
        """Return channels without a count for `SILENT_S`."""
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


ALLOWED = 3.0
"""Standard uncertainties of the difference of two means."""
LOST_COUNTS = 3.0
LOST_MM = 0.1
"""Beyond both limits counts were lost, a cable slipped, or it is another pose; the second is the usual drift of robots."""


@dataclass(frozen=True)
class Return:
    """Return to a pose by channels: counts minus those at first, the tolerance of rounding and of the robot's stated repeatability, and in
    mm; lost: channels that neither rounding nor a robot's drift explains."""

    channels: tuple[str, ...]
    counts: FloatArray
    allowed: FloatArray
    mm: FloatArray

    @property
    def beyond(self) -> tuple[str, ...]:
        """Channels that came back to other counts than are allowed."""
        return tuple(c for c, far in zip(self.channels, np.abs(self.counts) > self.allowed, strict=True) if far)

    @property
    def lost(self) -> tuple[str, ...]:
        """Those of them that lost counts."""
        far = (np.abs(self.counts) > np.maximum(self.allowed, LOST_COUNTS)) & ((np.abs(self.mm) > LOST_MM) | (self.mm == 0.0))
        return tuple(c for c, is_far in zip(self.channels, far, strict=True) if is_far)

    def lines(self) -> list[str]:
        reported = dict(zip(self.channels, zip(self.counts, self.mm, strict=True), strict=True))
        shown = "  ".join(f"{c} {counts:+.1f}" for c, (counts, _) in reported.items())
        lines: list[str] = [message("capture.back_first_pose_counts", shown=shown)]
        if not self.beyond:
            return [*lines, message("capture.closed_no_more_than", v1=self.allowed.max())]
        for channel in self.lost:
            lines.append(message("capture.came_back_counts_mm", channel=channel, counts=reported[channel][0], mm=reported[channel][1]))
        if not self.lost:
            most = np.abs(self.mm).max()
            lines.append(message("capture.not_closed_rounding_alone", v1=tuple(self.beyond), most=most))
        elif len(self.lost) > len(self.channels) / 2:
            lines.append(message("capture.most_channels_off_this"))
        return lines


def lengths_of_counts(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) length of a recorded count of each channel [mm], 0 of those that count no length."""
    known = [rig.counters_of(passage)[c] for c in channels]
    return np.array([c.per_count / c.scale if c.is_length else 0.0 for c in known])


def judged_return(
    rig: Rig, channels: tuple[str, ...], passage: int, counts: FloatArray, *, variance: FloatArray, u_repeatability_mm: float
) -> Return:
    """Counts (m,) at the return minus those at first, whose difference has the variance (m,) by reading; the robot comes back with the
    standard deviation u_repeatability_mm, twice."""
    mm = lengths_of_counts(rig, channels, passage)
    of_robot = np.where(mm > 0.0, np.sqrt(2.0) * u_repeatability_mm / np.where(mm > 0.0, mm, 1.0), 0.0)
    return Return(channels, counts, ALLOWED * np.sqrt(variance + of_robot**2), counts * mm)
