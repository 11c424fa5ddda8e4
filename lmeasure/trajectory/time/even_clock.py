"""Samples that come evenly, under stamps that do not: their numbers, holes counted, and the clock that the stamps show of them.

A host stamps a sample late by what it was busy with: never early, several at once behind a pause. What a device took evenly therefore
lies on a line of stamp against number, and the scatter about it is the stamps' own. A sample that was lost leaves a hole of whole
periods, which no later stamp makes up for; while the tool moves, its step there is as many times those beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter1d, median_filter, minimum_filter1d

from lmeasure.core import BoolArray, FloatArray, IntArray

LAG = 50
"""Samples over which a first period is taken."""
BESIDE = 7
"""Steps of the tool that one is held against."""
CLEAR = 10.0
"""Standard uncertainties of a place that a step must have to tell by how many periods it went."""
LEVEL, AT_REST = 25, 40
"""Samples on either side of a hole by which the stamps confirm it where the motion shows it, and find it where the tool rests."""
SURE, LIKELY, WHOLE = 0.6, 0.2, 0.25
"""Of a period: by how much stamps must stay behind for a hole, by how much where the motion shows it too, which must then be as near to
whole ones."""
PAUSE_S = 1.0
"""Behind a longer one the device may have started anew: its phase is not that of before."""
AROUND = 50
"""Samples on either side of an interval by which it is a gap."""
GAP = 2.5
"""Usual intervals: a longer one, after which the stamps stay behind, is a gap of the record."""
CATCHES_UP = 0.5
"""Of a period by sample: so fast a host that was held up comes back at least."""
FINE = 0.1
"""Of a period: stamps that scatter by less show a hole of a part of one."""
OFF = 6.0
"""Scatters of the stamps by which a gap is longer than the usual interval, and such a hole differs from whole periods."""
BLOCKS, LEAST_OF_BLOCK = 32, 25
CONTRADICTED = 8.0
"""Standard uncertainties of the level of a block of stamps by which it lies off an even clock that they do not keep."""
LEAST_PART = 10
"""One of so many samples of a block is earlier than its level: the least alone may be numbered wrongly."""
OF_LATENCY = 0.2
"""Of the latencies' median above that level: by so much a host that is busy raises it."""
LEAST_LAG, OF_LAG = 4, 48
"""Samples over which a random walk of stamps is looked for at least, and parts of a record over which at most."""
WALKS = 2.0
"""Times by which second differences over the longest lag exceed those of neighbours, where intervals of stamps add up."""
STRAYS = 2.0
"""Standard deviations of the end of a random walk by which it strays from the line between its ends: 7 of 10,000 stray farther."""
MEDIAN_SQUARE = 0.4549
"""Median over mean of the square of a normal deviate."""
WHITE = 1.3
"""Durbin and Watson's statistic of the blocks below which they wander: 2 where they scatter, 2 % of 30 such below 1.3."""
PASSES = 5
SETTLING = 4
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Clock:
    """Even times time_s (n,) [s] of samples, on the stamps' mean; period_s; u_rate: relative standard uncertainty of the period;
    level_s: standard deviation by which the levels of blocks of stamps, each of `block` samples, lie off."""

    time_s: FloatArray
    period_s: float
    u_rate: float
    level_s: float
    block: int


@dataclass(frozen=True)
class Numbers:
    """Numbers (n,) of evenly taken samples, from 0, with holes where some were lost; the stretches (n,) between pauses, in which alone the
    numbers tell times; known (n,): where the number of what was lost is sure."""

    number: IntArray
    stretch: IntArray
    known: BoolArray


def gaps(stamps_s: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return (n - 1,) which intervals of stamps (n,) are gaps, and which begin a new phase: gaps, and holes of parts of a period.

    A late sample is followed by others in quick succession, until the stamps have caught up; behind a gap they stay behind.
    """
    intervals = np.diff(stamps_s)
    if len(intervals) == 0:
        return np.zeros(0, np.bool_), np.zeros(0, np.bool_)
    usual = float(np.median(intervals))
    scatter = 1.4826 * float(np.median(np.abs(intervals - usual))) / np.sqrt(2.0)
    excess = intervals - usual
    long = (intervals > GAP * usual) & (excess > OFF * scatter)
    part = np.zeros_like(long)
    if scatter < FINE * usual:
        part = (excess > OFF * scatter + 1e-3 * usual) & (np.abs(excess - usual * np.rint(excess / usual)) > OFF * scatter + 1e-3 * usual)
    # the median of intervals that jitter is not their mean: over lags without a long one it is nearer
    for lag in (LAG, LAG // 5):
        holes = _summed(long)
        whole = holes[lag:] == holes[:-lag]
        if whole.sum() >= LAG:
            usual = float(np.median((stamps_s[lag:] - stamps_s[:-lag])[whole])) / lag
            break
    behind = stamps_s - usual * np.arange(len(stamps_s))
    stays = np.zeros_like(long)
    for i in np.flatnonzero(long | part).tolist():
        reach = AROUND + int(min(excess[i] / (CATCHES_UP * usual), len(intervals)))
        before, after = behind[max(i + 1 - AROUND, 0) : i + 1], behind[i + 1 : i + 1 + reach]
        # near the end of the record there may be no time to catch up
        left = max(0.0, float(excess[i]) - CATCHES_UP * usual * (len(after) - 1))
        rise = min(float(after.min() - before.min()), float(np.median(after[len(after) // 2 :]) - np.median(before)))
        stays[i] = rise > max(left, 0.5 * float(excess[i]))
    # behind the last interval nothing can catch up: it is a gap if it is longer than those behind which stamps did
    caught_up = excess[(long | part) & ~stays][:-1] if not stays[-1] and (long | part)[-1] else excess[:0]
    if (long | part)[-1] and excess[-1] > caught_up.max(initial=0.0):
        stays[-1] = True
    return long & stays, (long | part) & stays


def stretches(begins: BoolArray) -> IntArray:
    """Return (n,) numbers of stretches of samples, from intervals (n - 1,) behind which a new one begins."""
    return _summed(begins)


def numbers(stamps_s: FloatArray, places: FloatArray, u_mm: float, begins: BoolArray | None = None) -> Numbers:
    """Numbers of samples from stamps (n,), places (n, c) [mm] that are NaN where there is none, and the standard uncertainty of a place;
    begins (n - 1,): intervals behind which the device may have started anew, beside pauses."""
    intervals = np.diff(stamps_s)
    steps = np.ones(len(intervals), np.int64)
    pause = intervals > PAUSE_S
    if begins is not None:
        pause |= begins
    way = np.nan_to_num(np.linalg.norm(np.diff(places, axis=0), axis=1))
    usual = median_filter(way, BESIDE)
    clear = (usual > CLEAR * u_mm) & (usual > 0.0)
    times = np.divide(way, usual, out=np.ones_like(way), where=clear)
    seen = np.maximum(np.rint(times), 1).astype(np.int64)
    # a count that was read twice is no sample that was lost
    stood = np.minimum(np.append(1.0, times[:-1]), np.append(times[1:], 1.0)) < 0.5
    seen[pause | stood | (np.abs(times - seen) > WHOLE)] = 1
    period = _first_period(stamps_s, seen, clear)
    rise = _rise(stamps_s - period * _summed(steps).astype(np.float64), LEVEL)
    told = (seen > 1) & (rise > LIKELY * period * (seen - 1))
    steps[told] = seen[told]
    period = _first_period(stamps_s, steps, clear)
    steps[pause] = np.maximum(np.rint(intervals[pause] / period), 1).astype(np.int64)
    for _ in range(PASSES):
        if not _count_holes(stamps_s, steps, period, clear | pause):
            break
    known = np.ones(len(stamps_s), np.bool_)
    if (steps[~pause] > 1).any():
        known = _reconciled(stamps_s, steps, clear & ~pause, pause)
    return Numbers(_summed(steps), _summed(pause), known)


def _summed(steps: NDArray[Any]) -> IntArray:
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _reconciled(stamps_s: FloatArray, steps: IntArray, clear: BoolArray, pause: BoolArray) -> BoolArray:
    """Of samples (n,) those on stretches where the tool moves; the steps (n - 1,) between such stretches are brought to what all stamps on
    either side say, which is more than those of a short rest do. All samples where the tool hardly moves."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], clear, [False]]).astype(np.int64))).reshape(-1, 2)
    moves = [slice(a, b + 1) for a, b in edges.tolist() if b - a >= LEAST_OF_BLOCK]
    known = np.zeros(len(stamps_s), np.bool_)
    for m in moves:
        known[m] = True
    if not moves:
        return ~known
    number = _summed(steps).astype(np.float64)
    # over half a move: one long pause of the host moves no median
    over = [(stamps_s[m], number[m], (m.stop - m.start) // 2) for m in moves]
    period = float(np.median(np.concatenate([(s[half:] - s[:-half]) / (k[half:] - k[:-half]) for s, k, half in over])))
    level = [float(np.median(stamps_s[m] - period * number[m])) for m in moves]
    for (one, before), (other, behind) in pairwise(zip(moves, level, strict=True)):
        between = slice(one.stop - 1, other.start)
        lost = 0 if pause[between].any() else round((behind - before) / period)
        while lost:
            more = 1 if lost > 0 else -1
            may = steps[between] + more > 0
            if not may.any():
                break
            late = np.where(may, more * np.diff(stamps_s[between.start : between.stop + 1]), -np.inf)
            steps[between.start + int(np.argmax(late))] += more
            lost -= more
    return known


def _first_period(stamps_s: FloatArray, steps: IntArray, clear: BoolArray) -> float:
    """The median over long lags, of those in which the motion shows the holes where there are enough."""
    lag = min(LAG, max(len(steps) // 4, 1))
    number = np.concatenate([[0], np.cumsum(steps)])
    per = (stamps_s[lag:] - stamps_s[:-lag]) / (number[lag:] - number[:-lag])
    unclear = np.concatenate([[0], np.cumsum(~clear)])
    sure = unclear[lag:] == unclear[:-lag]
    return float(np.median(per[sure] if sure.sum() >= LAG else per))


def _rise(behind: FloatArray, m: int) -> FloatArray:
    """(n - 1,) by how much stamps stay behind an even clock from each interval on: the lesser of the rises of the median and of the
    least of the m stamps on either side. A pause of the host raises the first alone."""
    after = np.minimum(np.arange(1, len(behind)) + m // 2, len(behind) - 1)
    before = np.maximum(np.arange(len(behind) - 1) - m // 2, 0)
    middle = np.asarray(median_filter(behind, m, mode="reflect"))
    least = np.asarray(minimum_filter1d(behind, m, mode="reflect"))
    return np.asarray(np.minimum(middle[after] - middle[before], least[after] - least[before]))


def _count_holes(stamps_s: FloatArray, steps: IntArray, period: float, known: BoolArray) -> bool:
    """Raise the steps (n - 1,) at the holes that stamps alone show, where the motion does not know; whether there were any."""
    number = np.concatenate([[0], np.cumsum(steps)])
    rise = _rise(stamps_s - period * number, AT_REST)
    top = (rise > SURE * period) & (rise >= maximum_filter1d(rise, 2 * AT_REST + 1)) & ~known
    top[: AT_REST // 2] = top[-(AT_REST // 2) :] = False  # too few on the other side
    tops = np.flatnonzero(top)
    tops = tops[np.diff(tops, prepend=-2 * AT_REST) > AT_REST]
    for i in tops.tolist():
        near = np.arange(max(i - AT_REST // 2, 0), min(i + AT_REST // 2 + 1, len(steps)))
        near = near[~known[near]]
        steps[near[np.argmax(np.diff(stamps_s)[near])]] += max(round(float(rise[i] / period)), 1)
    return len(tops) > 0


def clock(stamps_s: FloatArray, found: Numbers) -> Clock | None:
    """The even clock through stamps (n,) of numbered samples; None where they are too few, or do not keep it.

    A line through what stands for blocks of stamps - the least, the middle or the mean, whichever scatters least: the least knows nothing
    of what kept a host busy, the mean most of errors to both sides. The line's uncertainty comes from the blocks' own scatter, or where
    they wander from how the rate differs from block to block.
    """
    stamps, number, stretch = stamps_s[found.known], found.number[found.known], found.stretch[found.known]
    blocks = _blocks(stretch)
    of = np.array([stretch[b.start] for b in blocks])
    apart = np.unique(of)
    freedom = len(blocks) - 1 - len(apart)
    if freedom < 1:
        return None
    middle = np.array([number[b].mean() for b in blocks])
    inside = (of[:, None] == apart).astype(np.float64)
    along = middle - inside @ (inside.T @ middle / inside.sum(axis=0))
    lines = []
    ways: tuple[Callable[[FloatArray], Any], ...] = (np.min, np.median, np.mean)
    for place in ways:
        period = float(np.median(np.diff(stamps)))
        for _ in range(SETTLING):
            behind = np.array([place(stamps[b] - period * number[b]) for b in blocks])
            slope = float(along @ behind / (along @ along))
            period += slope
        away = behind - inside @ (inside.T @ behind / inside.sum(axis=0)) - slope * along
        lines.append((float(away @ away), period, away))
    square, period, away = min(lines, key=lambda line: line[0])
    # of three scatters the least was taken, and each is known to 1 / sqrt(2 freedom)
    least = 1.0 + 1.0 / np.sqrt(2.0 * freedom)
    u_rate = least * np.sqrt(square / freedom / (along @ along)) / period * scipy.stats.t.ppf(0.975, freedom) / NORMAL_95
    same = np.diff(of) == 0
    moved = np.diff(away)[same]
    if len(moved) and moved @ moved < WHITE * square:
        u_rate = max(u_rate, np.sqrt(np.mean((moved / np.diff(middle)[same]) ** 2)) / period)
    time_s = period * found.number.astype(np.float64)
    for s in np.unique(found.stretch):
        mine = found.stretch == s
        seen = mine & found.known if (mine & found.known).any() else mine
        time_s[mine] += (stamps_s - time_s)[seen].mean()
    if not (np.diff(time_s) > 0).all():
        return None
    late, size = (stamps_s - time_s)[found.known], _size(len(stamps))
    level, contradicted = _levels(late, stretch)
    walk = random_walk(late, number, stretch)
    # stamps that stray so far cannot show the holes between moves either, and numbers that follow them hide it
    if contradicted or walk * np.sqrt(size) > WHOLE * period:
        level, contradicted = _levels(late, stretch, STRAYS * walk * np.sqrt(len(late)))
        if walk == 0.0 or contradicted:
            return None
        # as much as the rates of neighbouring blocks differ: intervals that err may be too long or too short on the mean, too
        u_rate = max(u_rate, walk / period * np.sqrt(2.0 / 3.0 / size))
    return Clock(time_s, period, float(u_rate), level, size)


def _levels(late_s: FloatArray, stretch: IntArray, beside_s: float = 0.0) -> tuple[float, bool]:
    """Return the standard deviation [s] by which blocks of samples lie off an even clock, late_s (n,) by their stamps; and whether some lie
    farther off than their halves differ, beside_s and latencies: a hole that was not counted, another rate, a clock that drifts."""
    blocks = _blocks(stretch)
    levels = np.array([_least(late_s[b]) for b in blocks])
    halves = [slice(b.start, (b.start + b.stop) // 2) for b in blocks], [slice((b.start + b.stop) // 2, b.stop) for b in blocks]
    apart = np.array([_least(late_s[a]) - _least(late_s[b]) for a, b in zip(*halves, strict=True)])
    # the mean of the halves is known twice as well as their difference
    allowed = CONTRADICTED * 1.4826 * float(np.median(np.abs(apart))) / 2.0 + beside_s
    busy = np.array([OF_LATENCY * (float(np.median(late_s[b])) - level) for b, level in zip(blocks, levels, strict=True)])
    return float(np.std(levels)), bool((levels - busy).max() - levels.min() > 2.0 * allowed)


def _least(late_s: FloatArray) -> float:
    """Return the level of stamps: a host that was busy raises all but the least."""
    return float(np.partition(late_s, len(late_s) // LEAST_PART)[len(late_s) // LEAST_PART])


def random_walk(late_s: FloatArray, number: IntArray, stretch: IntArray) -> float:
    """Return the standard deviation [s] of one interval where the intervals of stamps, late_s (n,), add up to a random walk, else 0.

    Second differences over L samples (the Allan variance of a clock) have a mean square of 6 u^2 where each stamp errs by u on its own, and
    of 2 L w^2 where intervals err by w. A clock that drifts, or has another rate from some sample on, hardly shows in their median.
    """
    most = len(late_s) // OF_LAG
    if most < LEAST_LAG:
        return 0.0
    lags = np.unique(np.append(2 ** np.arange(2, int(np.log2(most)) + 1), most))
    one = _second_differences(late_s, number, stretch, 1)
    squares = np.array([_second_differences(late_s, number, stretch, int(lag)) for lag in lags])
    if squares[-1] < WALKS * one:
        return 0.0
    return float(np.sqrt(max(np.min((squares - one) / (2.0 * (lags - 1.0))), 0.0)))


def unexplained_walk(stamps_s: FloatArray, found: Numbers, u_s: float) -> tuple[float, int]:
    """Return the standard deviation [s] of one interval of a random walk by which the rates of blocks of numbered samples differ, beside
    errors u_s of single stamps; and the number of samples of the longest part whose numbers are sure.

    Second differences of the levels of blocks of m samples have a variance of m w^2 by a walk, and of 6 u^2 / m by single stamps.
    """
    parts = np.flatnonzero(np.diff(np.concatenate([[False], found.known, [False]]).astype(np.int64))).reshape(-1, 2)
    size, second = _size(int(found.known.sum())), [np.zeros(0)]
    for begin, end in parts.tolist():
        blocks = np.arange(begin, end - size + 1, size)[:, None] + np.arange(size)
        if len(blocks) > 2 and np.ptp(found.stretch[begin:end]) == 0:
            rate = np.diff(stamps_s[blocks].mean(axis=1)) / np.diff(found.number[blocks].mean(axis=1))
            second.append(size * np.diff(rate))
    squares = np.concatenate(second) ** 2
    if len(squares) == 0:
        return 0.0, 0
    variance = float(np.median(squares)) / MEDIAN_SQUARE - 6.0 * u_s**2 / size
    return float(np.sqrt(max(variance, 0.0) / size)), int(np.diff(parts, axis=1).max())


def _second_differences(late_s: FloatArray, number: IntArray, stretch: IntArray, lag: int) -> float:
    """Return the mean square, by the median, of second differences over a lag of samples without a hole that is longer than it."""
    within = (stretch[2 * lag :] == stretch[: -2 * lag]) & (number[2 * lag :] - number[: -2 * lag] <= 3 * lag)
    squares = (late_s[2 * lag :] - 2.0 * late_s[lag:-lag] + late_s[: -2 * lag])[within] ** 2
    return float(np.median(squares)) / MEDIAN_SQUARE if len(squares) else 0.0


def _size(n: int) -> int:
    return max(LEAST_OF_BLOCK, -(-n // BLOCKS))


def _blocks(stretch: IntArray) -> list[slice]:
    """Pieces of about equal size of samples in stretches (n,), none over two of them and none too small to stand for itself."""
    size = _size(len(stretch))
    out = []
    for start, end in pairwise([0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(stretch)]):
        edges = np.linspace(start, end, max((end - start) // size, 1) + 1).astype(int).tolist()
        out += [slice(a, b) for a, b in pairwise(edges) if b - a >= LEAST_OF_BLOCK]
    return out
