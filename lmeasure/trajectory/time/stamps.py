"""Time stamps with jitter: the true times of samples, and their uncertainty.

Gaps, after which the stamps stay behind, divide a record into stretches, and no fit goes over one. Nothing else is examined if stamps are
even, or so nearly that positions do not change. Else two explanations are compared with the motion: a tool moves smoothly in time, so that
positions at the right instants have only their own noise about local cubics, while wrong instants leave the speed times the error of the
time. Either the samples were taken evenly and the host stamped them later (`clock`): then even times are used, with the period from the
stamps. Or the host requested them: then its stamps stay, and the noise of the motion about them is theirs. They also stay if even times
would differ from the stamps by more than their scatter.

The motion shows whether neighbouring samples are even, within a few samples; only stamps show whether the period is the same a second
later. Independent errors of intervals of stamps add up to a random walk, which grows with the square root of time, and is the host's if
neighbouring samples are even: then even times are used. Faster growth, or a sum of the device's own errors, is no such walk.

A busy host stamps a sample late: never early, several at once behind a pause. Even samples of a device therefore lie on a line of stamp
against number, and the scatter about it is the stamps' own. A lost sample leaves a hole of whole periods, which no later stamp closes;
while the tool moves, its step there is as many times those beside it.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Literal, Protocol

import numpy as np
import scipy
from numpy.typing import NDArray

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.text import Message, message

LAG = 50  # Samples over which a first period is taken
BESIDE = 7  # Steps of the tool that one is compared with
CLEAR = 10.0  # Least step, in standard uncertainties of a position, that shows the number of its periods
LEVEL, AT_REST = 25, 40
"""Samples on either side of a hole by which the stamps confirm a hole in the motion, and find one while the tool rests."""
SURE, LIKELY, WHOLE = 0.6, 0.2, 0.25
"""Part of a period by which stamps must stay behind for a hole, by which if the motion shows it too, and its largest difference from whole
periods then."""
PAUSE_S = 1.0  # Behind a longer one the device may have started anew: its phase is not that of before
AROUND = 50  # Samples on either side of an interval for the test of a gap
GAP = 2.5  # Usual intervals: a longer one, after which the stamps stay behind, is a gap of the record
CATCHES_UP = 0.5  # Of a period by sample: so fast a host that was held up comes back at least
FINE = 0.1  # Relative to a period: a smaller scatter of stamps shows gaps of a part of a period
OFF = 6.0  # Excess of a gap over the usual interval, and difference of such a gap from whole periods, in scatters of the stamps
BLOCKS, LEAST_OF_BLOCK = 32, 25
CONTRADICTED = 8.0  # Deviation of a block of stamps from an even clock that contradicts it, in standard uncertainties of its level
LEAST_PART = 10  # One of so many samples of a block is earlier than its level: the least alone may be numbered wrongly
OF_LATENCY = 0.2  # Of the latencies' median above that level: by so much a host that is busy raises it
LEAST_LAG, OF_LAG = 4, 48  # Samples over which a random walk of stamps is looked for at least, and parts of a record over which at most
WALKS = 2.0  # Ratio of second differences over the longest lag to those of neighbours, if errors of intervals add up
STRAYS = 2.0  # Largest deviation of a random walk from the line between its ends, in standard deviations of its end: 7 of 10,000 exceed it
MEDIAN_SQUARE = 0.4549  # Median over mean of the square of a normal deviate
WHITE = 1.3  # Durbin and Watson's statistic of the blocks below which they wander: 2 where they scatter, 2 % of 30 such below 1.3
PASSES = 5
SETTLING = 4
NORMAL_95 = 1.959963984540054


@dataclass(frozen=True)
class Clock:
    """Even times time_s (n,) [s] of samples, on the stamps' mean; period_s; u_rate: relative standard uncertainty of the period; level_s:
    standard deviation of the levels of blocks of stamps, each of `block` samples."""

    time_s: FloatArray
    period_s: float
    u_rate: float
    level_s: float
    block: int


@dataclass(frozen=True)
class Numbers:
    """Numbers (n,) of evenly taken samples, from 0, with holes for lost ones; the stretches (n,) between pauses, within which alone the
    numbers determine times; known (n,): True if the number of lost samples is sure."""

    number: IntArray
    stretch: IntArray
    known: BoolArray


def gaps(stamps_s: FloatArray) -> tuple[BoolArray, BoolArray]:
    """Return (n - 1,) which intervals of stamps (n,) are gaps, and which begin a new phase: gaps, and holes of parts of a period. A late
    sample is followed by others in quick succession, until the stamps have caught up; behind a gap they stay behind."""
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


def numbers(stamps_s: FloatArray, places: FloatArray, u_mm: float, begins: BoolArray | None = None) -> Numbers:
    """Numbers of samples from stamps (n,), places (n, c) [mm] that are NaN where there is none, and the standard uncertainty of a place;
    begins (n - 1,): intervals behind which the device may have started anew, beside pauses."""
    intervals = np.diff(stamps_s)
    steps = np.ones(len(intervals), np.int64)
    pause = intervals > PAUSE_S
    if begins is not None:
        pause |= begins
    way = np.nan_to_num(np.linalg.norm(np.diff(places, axis=0), axis=1))
    usual = scipy.ndimage.median_filter(way, BESIDE)
    clear = (usual > CLEAR * u_mm) & (usual > 0.0)
    times = np.divide(way, usual, out=np.ones_like(way), where=clear)
    seen = np.maximum(np.rint(times), 1).astype(np.int64)
    # a count that was read twice is no sample that was lost
    stood = np.minimum(np.append(1.0, times[:-1]), np.append(times[1:], 1.0)) < 0.5
    seen[pause | stood | (np.abs(times - seen) > WHOLE)] = 1
    period = _first_period(stamps_s, seen, clear)
    rise = _rise(stamps_s - period * _summed(steps).astype(np.float64), LEVEL)
    determined = (seen > 1) & (rise > LIKELY * period * (seen - 1))
    steps[determined] = seen[determined]
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
    """(n,) sums of the steps (n - 1,) before each of n samples."""
    return np.concatenate([[0], np.cumsum(steps)]).astype(np.int64)


def _reconciled(stamps_s: FloatArray, steps: IntArray, clear: BoolArray, pause: BoolArray) -> BoolArray:
    """Return, of samples (n,), those on stretches where the tool moves; the steps (n - 1,) between such stretches are set by all stamps on
    either side, which are more than those of a short rest. All samples if the tool hardly moves."""
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
    number = _summed(steps)
    per = (stamps_s[lag:] - stamps_s[:-lag]) / (number[lag:] - number[:-lag])
    unclear = _summed(~clear)
    sure = unclear[lag:] == unclear[:-lag]
    return float(np.median(per[sure] if sure.sum() >= LAG else per))


def _rise(behind: FloatArray, m: int) -> FloatArray:
    """(n - 1,) by how much stamps stay behind an even clock from each interval on: the lesser of the rises of the median and of the
    least of the m stamps on either side. A pause of the host raises the first alone."""
    after = np.minimum(np.arange(1, len(behind)) + m // 2, len(behind) - 1)
    before = np.maximum(np.arange(len(behind) - 1) - m // 2, 0)
    middle = np.asarray(scipy.ndimage.median_filter(behind, m, mode="reflect"))
    least = np.asarray(scipy.ndimage.minimum_filter1d(behind, m, mode="reflect"))
    return np.asarray(np.minimum(middle[after] - middle[before], least[after] - least[before]))


def _count_holes(stamps_s: FloatArray, steps: IntArray, period: float, known: BoolArray) -> bool:
    """Raise the steps (n - 1,) at the holes that stamps alone show, where the motion does not know; whether there were any."""
    number = _summed(steps)
    rise = _rise(stamps_s - period * number, AT_REST)
    top = (rise > SURE * period) & (rise >= scipy.ndimage.maximum_filter1d(rise, 2 * AT_REST + 1)) & ~known
    top[: AT_REST // 2] = top[-(AT_REST // 2) :] = False  # too few on the other side
    tops = np.flatnonzero(top)
    tops = tops[np.diff(tops, prepend=-2 * AT_REST) > AT_REST]
    for i in tops.tolist():
        near = np.arange(max(i - AT_REST // 2, 0), min(i + AT_REST // 2 + 1, len(steps)))
        near = near[~known[near]]
        steps[near[np.argmax(np.diff(stamps_s)[near])]] += max(round(float(rise[i] / period)), 1)
    return len(tops) > 0


def clock(stamps_s: FloatArray, found: Numbers) -> Clock | None:
    """The even clock through stamps (n,) of numbered samples; None with too few, or if they do not keep it. It is a line through the least,
    the middle or the mean of blocks of stamps, whichever scatters least: delays of a busy host do not affect the least, errors to both
    sides average in the mean. The line's uncertainty comes from the blocks' own scatter, or for wandering blocks from the variation of the
    rate between blocks."""
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
        # the difference between rates of neighbouring blocks: wrong intervals may also be wrong on average
        u_rate = max(u_rate, walk / period * np.sqrt(2.0 / 3.0 / size))
    return Clock(time_s, period, float(u_rate), level, size)


def _levels(late_s: FloatArray, stretch: IntArray, beside_s: float = 0.0) -> tuple[float, bool]:
    """Return the standard deviation [s] of blocks of samples about an even clock, late_s (n,) by their stamps; and whether some deviate
    more than the difference of their halves, beside_s and latencies: an uncounted hole, another rate, or a drifting clock."""
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
    """Return the standard deviation [s] of one interval where the intervals of stamps, late_s (n,), add up to a random walk, else 0. Second
    differences over L samples (the Allan variance of a clock) have a mean square of 6 u^2 where stamps have independent errors u, of 2 L
    w^2 where intervals have errors w. A clock that drifts, or has another rate from some sample on, hardly shows in their median."""
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
    errors u_s of single stamps; and the number of samples of the longest part with sure numbers. Second differences of the levels of blocks
    of m samples have a variance of m w^2 by a walk, and of 6 u^2 / m by single stamps."""
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
    """Return pieces of about equal size of samples in stretches (n,), none across two of them and none too small to be used alone."""
    size = _size(len(stretch))
    out = []
    for start, end in pairwise([0, *(np.flatnonzero(np.diff(stretch)) + 1).tolist(), len(stretch)]):
        edges = np.linspace(start, end, max((end - start) // size, 1) + 1).astype(int).tolist()
        out += [slice(a, b) for a, b in pairwise(edges) if b - a >= LEAST_OF_BLOCK]
    return out


LEAST = 32  # Least samples for an estimate
EVEN = 1e-3  # Of a period: scatter or error of the stamps below which they are sound
FELT = 0.3  # Of a place's standard uncertainty: an error of place by time that adds less than a twentieth to it is none
SIGNIFICANT = 3.0  # Standard deviations of chance beyond which stamps are found in error
WINDOW, TERMS = 9, 4  # Samples of a window, and coefficients of its cubic
WINDOWS, LEAST_WINDOWS = 4000, 8
MOVING, OF_FASTEST = 2.0, 0.1
"""Standard uncertainties of a position by which the stamps' scatter must move it for the motion to decide, and the part of the largest
speed that it must have."""
OF_ONE_STEP = 0.5  # Relative to a window's chord: a longer step is a jump and shows nothing about time
HOSTS, OF_DEVICE = 3.0, 2.0
"""Standard uncertainties of a block's stamps that their errors explain, and those of all instants of a device, were its errors to add up:
where it is between, the device itself strays from even times."""
FAR = 0.02  # Part of the windows that is ignored: those with the largest residuals, as at corners
MEDIAN = 0.87  # Median over mean of a sum of WINDOW - TERMS squares (chi-squared of 5)


class Timed(Protocol):
    """Data of a trajectory for judging stamps: times (n,) [s], poses (n, 7) and their random covariances (n, 6, 6)."""

    @property
    def time_s(self) -> FloatArray: ...
    @property
    def poses(self) -> FloatArray: ...
    @property
    def random(self) -> FloatArray: ...


@dataclass(frozen=True)
class Stamps:
    """Times of samples.

    stamp_s (n,): as recorded; time_s (n,): the same unless `kind` is "even". u_time_s: standard uncertainty of each, independent from
    sample to sample; u_rate: relative one of all intervals together. kind: "sound", "even" (taken evenly, stamped late) or "uneven" (taken
    on request, stamps in error by u_time_s). note: remark on jitter, None for sound ones. stretch (n,): index of a sample's stretch between
    gaps, None if not examined; gap: remark on these. read (n,): whether an instant of a curve is that of a sample; None if all are.
    """

    stamp_s: FloatArray
    time_s: FloatArray
    u_time_s: float = 0.0
    u_rate: float = 0.0
    kind: Literal["sound", "even", "uneven"] = "sound"
    note: Message | None = None
    stretch: IntArray | None = None
    gap: Message | None = None
    read: BoolArray | None = None

    @property
    def notes(self) -> tuple[Message, ...]:
        """Return the messages about the stamps."""
        return tuple(said for said in (self.note, self.gap) if said is not None)


def sound(stamp_s: FloatArray) -> Stamps:
    """Stamps (n,) taken as they are."""
    return Stamps(stamp_s, stamp_s)


def stamps_of(trajectory: Timed) -> Stamps:
    """The stamps of a trajectory, judge_stamps by its motion."""
    variances = np.einsum("nii->ni", trajectory.random)[:, 3:]
    return judge_stamps(trajectory.time_s, trajectory.poses[:, :3], np.sqrt(variances.mean(axis=1)))


def jitter(stamp_s: FloatArray) -> tuple[float, float]:
    """The usual interval [s] of stamps (n,), and the scatter [s] of one that their intervals show, holes of whole intervals apart."""
    intervals = np.diff(stamp_s)
    usual = float(np.median(intervals))
    whole = np.maximum(np.rint(intervals / usual), 1.0)
    away = (intervals - usual * whole)[whole <= 3]
    return usual, float(np.sqrt(np.mean(away**2) / 2.0))


def judge_stamps(stamp_s: FloatArray, places: FloatArray, u_mm: FloatArray) -> Stamps:
    """Judge stamps (n,) of positions (n, c) [mm], NaN for missing ones, each known to u_mm (n,) per axis; without a statement (zero or NaN)
    to their scatter across the motion."""
    known = np.flatnonzero(~np.isnan(places).any(axis=1))
    if len(known) < 2 or not (np.diff(stamp_s) > 0).all():
        return sound(stamp_s)
    gap, begins = (np.zeros(len(stamp_s) - 1, np.bool_) for _ in range(2))
    for out, there in zip((gap, begins), gaps(stamp_s[known]), strict=True):
        out[known[1:][there] - 1] = True
    found = _jittered(stamp_s, places, u_mm, begins) if len(stamp_s) >= LEAST else sound(stamp_s)
    return replace(found, stretch=_summed(gap), gap=_stamp_note(stamp_s[known], gap[known[1:] - 1]))


def _stamp_note(stamp_s: FloatArray, gap: BoolArray) -> Message | None:
    """Return how many gaps there are, and the longest."""
    if not gap.any():
        return None
    lasts = np.where(gap, np.diff(stamp_s), 0.0)
    i = int(np.argmax(lasts))
    return message("time.gaps", gaps=int(gap.sum()), longest_s=float(lasts[i]), at_s=float(stamp_s[i]))


def _jittered(stamp_s: FloatArray, places: FloatArray, u_mm: FloatArray, begins: BoolArray) -> Stamps:
    """`judge_stamps`, gaps and holes (n - 1,) known."""
    usual, scatter = jitter(stamp_s)
    if scatter <= EVEN * usual:
        return sound(stamp_s)
    stated = u_mm[u_mm > 0.0]
    noise = float(np.median(stated)) if len(stated) else 0.0
    first = _windows(places, noise, scatter / usual, begins)
    if len(first) < LEAST_WINDOWS:
        return sound(stamp_s)
    as_stamped, speed, across = _residuals(stamp_s, places, first)
    noise = noise or float(np.sqrt(np.median(across) / MEDIAN))
    u_stamp = _time_noise(as_stamped, speed, noise)
    felt = FELT * noise / float(np.sqrt(np.mean(speed**2)))
    # random scatter of the noise of positions is not noise of stamps
    samples = WINDOW + int(np.minimum(np.diff(first), WINDOW).sum())
    chance = SIGNIFICANT * np.sqrt(2.0 * WINDOW / ((WINDOW - TERMS) * samples))
    if u_stamp <= max(felt, felt / FELT * np.sqrt(chance), EVEN * usual):
        return sound(stamp_s)
    numbered = numbers(stamp_s, places, noise, begins)
    as_even, speed, _ = _residuals(usual * numbered.number.astype(np.float64), places, first)
    evenly = bool(np.median(as_even) < np.median(as_stamped))
    even = clock(stamp_s, numbered) if evenly else None
    u_even = 0.0 if even is None else _time_noise(as_even, speed * (usual / even.period_s), noise)
    if even is not None and u_even > felt / FELT and _of_device(even, u_even, u_stamp):
        even = None
    intervals = 1e3 * np.diff(stamp_s)[~begins]
    apart = {"least_ms": float(intervals.min()), "most_ms": float(intervals.max())}
    if even is None:
        u_rate = 0.0
        if evenly:
            # whether the host strayed or the device, nothing shows: stamps stay, and both ends of a move may be off by that
            walk, longest = unexplained_walk(stamp_s, numbered, u_stamp)
            u_stamp, u_rate = float(np.hypot(u_stamp, walk * np.sqrt(longest / 2.0))), walk / usual / np.sqrt(max(longest, 1))
        note = message("stamps.uneven", **apart, error_ms=1e3 * u_stamp)
        return Stamps(stamp_s, stamp_s, u_stamp, u_rate, "uneven", note)
    u_even = u_even if u_even > felt else 0.0
    # where a gap begins a new phase it is known by the stamps of its stretch
    several = len(np.unique(numbered.stretch))
    if several > 1:
        u_even = float(np.hypot(u_even, np.std(stamp_s - even.time_s) * np.sqrt(several / len(stamp_s))))
    note = message("stamps.even", **apart, period_ms=1e3 * even.period_s, rate=even.u_rate, error_ms=1e3 * u_even)
    return Stamps(stamp_s, even.time_s, u_even, even.u_rate, "even", note)


def _of_device(even: Clock, u_even: float, u_stamp: float) -> bool:
    """Return whether the device may have strayed as far as stamps differ from its even clock: farther than their own errors explain, and no
    farther than the sum of its errors u_even of single instants."""
    return HOSTS * u_stamp / np.sqrt(even.block) < even.level_s < OF_DEVICE * u_even * np.sqrt(len(even.time_s))


def _windows(places: FloatArray, noise: float, scatter: float, begins: BoolArray) -> IntArray:
    """First samples (k,) of windows without a gap in which the tool moves so fast that a scatter of the stamps [periods] would show; begins
    (n - 1,): intervals that they do not go over."""
    chord = np.linalg.norm(places[WINDOW - 1 :] - places[: 1 - WINDOW], axis=1) / (WINDOW - 1)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    longest = np.lib.stride_tricks.sliding_window_view(steps, WINDOW - 1).max(axis=1)
    holes, cuts = _summed(np.asarray(np.isnan(places).any(axis=1))), _summed(begins)
    chord = np.where((holes[WINDOW:] == holes[:-WINDOW]) & (cuts[WINDOW - 1 :] == cuts[: 1 - WINDOW]), chord, 0.0)
    chord = np.where(longest < OF_ONE_STEP * (WINDOW - 1) * chord, chord, 0.0)
    first = np.flatnonzero(chord > max(MOVING * noise / scatter, OF_FASTEST * float(chord.max())))
    return first[np.linspace(0, len(first) - 1, min(len(first), WINDOWS)).astype(np.int64)]


def _residuals(time_s: FloatArray, places: FloatArray, first: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean squared residuals [mm^2] of the places about cubics in time, in windows (k,): along the motion, the speeds [mm/s], and across it
    per axis."""
    rows = first[:, None] + np.arange(WINDOW)
    t, x = np.asarray(time_s[rows], dtype=np.float64), places[rows]
    span = t[:, -1:] - t[:, :1]
    basis = np.linalg.qr((2.0 * (t - t[:, :1]) / span - 1.0)[:, :, None] ** np.arange(TERMS))[0]
    x = x - x[:, :1]
    away = x - basis @ (np.swapaxes(basis, 1, 2) @ x)
    length = np.linalg.norm(x[:, -1], axis=1)
    along = (np.einsum("kwc,kc->kw", away, x[:, -1] / length[:, None]) ** 2).sum(axis=1) / (WINDOW - TERMS)
    every = (away**2).sum(axis=(1, 2)) / (WINDOW - TERMS)
    return along, length / span[:, 0], np.maximum(every - along, 0.0) / max(places.shape[1] - 1, 1)


def _time_noise(squares: FloatArray, speed: FloatArray, noise: float) -> float:
    """Standard uncertainty [s] of single instants that residuals (k,) [mm^2] at speeds (k,) show: by the mean without the farthest, or by
    the median where that is more."""
    of_time = squares / speed**2
    kept = of_time <= np.quantile(of_time, 1.0 - FAR)
    mean = (squares[kept] - noise**2).sum() / (speed[kept] ** 2).sum()
    median = np.median((squares / MEDIAN - noise**2) / speed**2)
    return float(np.sqrt(max(mean, median, 0.0)))
