"""Repeated passes of one motion: brought to one clock, checked to be the same motion, and what their differences add to the uncertainty.

Time stamps that jitter: when samples were taken in truth, and how uncertain that is.

Gaps, after which the stamps stay behind, part a record into stretches, and no fit goes over one. Nothing else is looked for where stamps
come evenly, or so nearly that a sample's place does not feel it. Else two explanations are compared with the motion: a tool moves
smoothly in time, so that places against the right instants leave nothing but their own noise about local cubics, while wrong instants
leave the speed times the error of the time. Either the samples were taken evenly and the host stamped them as it got
round to it (`evenly`): then the even times are taken, and the stamps say how long a period is. Or they were taken when the host asked:
then its stamps stay, and the noise that the motion shows about them is theirs. So they do where even times would be off the stamps by more
than those scatter.

The motion shows whether neighbouring samples are even, within a few samples; only stamps show whether the period is the same a second
later. Intervals of stamps that err each on its own add up to a random walk, which grows with the square root of time, and is the host's if
neighbouring samples are even: then even times are taken. What grows faster, or what the device's own errors may add up to, is no such walk.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, TrajectoryError
from lmeasure.recording import Counts, Run
from lmeasure.sensors import Lengths, count_variance, lengths_from_counts
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.doubts import Doubts
from lmeasure.trajectory.faults.rest_evidence import Evidence, EvidenceFinder
from lmeasure.trajectory.time.even_clock import Clock, clock, gaps, numbers, stretches, unexplained_walk
from lmeasure.trajectory.uncertainty.sources import PassClock

LEAST = 32
"""Samples from which anything can be said."""
EVEN = 1e-3
"""Of a period: scatter or error of the stamps below which they are sound."""
FELT = 0.3
"""Of a place's standard uncertainty: an error of place by time that adds less than a twentieth to it is none."""
SIGNIFICANT = 3.0
"""Standard deviations of chance beyond which stamps are found in error."""
WINDOW, TERMS = 9, 4
"""Samples of a window, and coefficients of its cubic."""
WINDOWS, LEAST_WINDOWS = 4000, 8
MOVING_STAMPS, OF_FASTEST = 2.0, 0.1
"""Standard uncertainties of a place by which the stamps' scatter must move it where the motion is to tell anything, and part of the
largest speed that it must have."""
OF_ONE_STEP = 0.5
"""Of a window's chord: a longer step is a jump, by which a motion tells nothing of time."""
HOSTS, OF_DEVICE = 3.0, 2.0
"""Standard uncertainties of a block's stamps that their errors explain, and those of all instants of a device, were its errors to add up:
where it is between, the device itself strays from even times."""
FAR = 0.02
"""Of the windows: those with the largest residuals, at corners and at what else is no cubic, are passed over."""
MEDIAN = 0.87
"""Median over mean of a sum of WINDOW - TERMS squares (chi-squared of 5)."""


class Timed(Protocol):
    """What is looked at of a trajectory: times (n,) [s], poses (n, 7) and their random covariances (n, 6, 6)."""

    @property
    def time_s(self) -> FloatArray: ...
    @property
    def poses(self) -> FloatArray: ...
    @property
    def random(self) -> FloatArray: ...


@dataclass(frozen=True)
class Stamps:
    """When samples were taken.

    stamp_s (n,): as recorded; time_s (n,): the same unless `kind` is "even". u_time_s: standard uncertainty of each, independent from
    sample to sample; u_rate: relative one of all intervals together. kind: "sound", "even" (taken evenly, stamped late) or "uneven" (taken
    when asked, stamps in error by u_time_s). note: what is to be said of jitter, None of sound ones. stretch (n,): number of the stretch
    between gaps that a sample is in, None where nobody looked; gap: what is to be said of these.
    """

    stamp_s: FloatArray
    time_s: FloatArray
    u_time_s: float = 0.0
    u_rate: float = 0.0
    kind: Literal["sound", "even", "uneven"] = "sound"
    note: Message | None = None
    stretch: IntArray | None = None
    gap: Message | None = None

    @property
    def notes(self) -> tuple[Message, ...]:
        """Return what is to be said of the stamps."""
        return tuple(said for said in (self.note, self.gap) if said is not None)


def sound(stamp_s: FloatArray) -> Stamps:
    """Stamps (n,) taken as they are."""
    return Stamps(stamp_s, stamp_s)


def stamps_of(trajectory: Timed) -> Stamps:
    """The stamps of a trajectory, judged by its motion."""
    variances = np.einsum("nii->ni", trajectory.random)[:, 3:]
    return judged(trajectory.time_s, trajectory.poses[:, :3], np.sqrt(variances.mean(axis=1)))


def jitter(stamp_s: FloatArray) -> tuple[float, float]:
    """The usual interval [s] of stamps (n,), and the scatter [s] of one that their intervals show, holes of whole intervals apart."""
    intervals = np.diff(stamp_s)
    usual = float(np.median(intervals))
    whole = np.maximum(np.rint(intervals / usual), 1.0)
    away = (intervals - usual * whole)[whole <= 3]
    return usual, float(np.sqrt(np.mean(away**2) / 2.0))


def judged(stamp_s: FloatArray, places: FloatArray, u_mm: FloatArray) -> Stamps:
    """Stamps (n,) of places (n, c) [mm], NaN where there is none, that are each known to u_mm (n,) per axis; where nothing is stated (zero
    or NaN) what the places scatter by across the motion."""
    known = np.flatnonzero(~np.isnan(places).any(axis=1))
    if len(known) < 2 or not (np.diff(stamp_s) > 0).all():
        return sound(stamp_s)
    gap, begins = (np.zeros(len(stamp_s) - 1, np.bool_) for _ in range(2))
    for out, there in zip((gap, begins), gaps(stamp_s[known]), strict=True):
        out[known[1:][there] - 1] = True
    found = _jittered(stamp_s, places, u_mm, begins) if len(stamp_s) >= LEAST else sound(stamp_s)
    return replace(found, stretch=stretches(gap), gap=_stamp_note(stamp_s[known], gap[known[1:] - 1]))


def _stamp_note(stamp_s: FloatArray, gap: BoolArray) -> Message | None:
    """Return how many gaps there are, and the longest."""
    if not gap.any():
        return None
    lasts = np.where(gap, np.diff(stamp_s), 0.0)
    i = int(np.argmax(lasts))
    return message("time.gaps", gaps=int(gap.sum()), longest_s=float(lasts[i]), at_s=float(stamp_s[i]))


def _jittered(stamp_s: FloatArray, places: FloatArray, u_mm: FloatArray, begins: BoolArray) -> Stamps:
    """`judged`, gaps and holes (n - 1,) known."""
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
    # what scatters by chance about the places' own noise is no noise of stamps
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
    """Whether the device may have strayed as far as stamps lie off its even clock: farther than their own errors explain, and no farther
    than its errors u_even of single instants add up to."""
    return HOSTS * u_stamp / np.sqrt(even.block) < even.level_s < OF_DEVICE * u_even * np.sqrt(len(even.time_s))


def _windows(places: FloatArray, noise: float, scatter: float, begins: BoolArray) -> IntArray:
    """First samples (k,) of windows without a gap in which the tool moves so fast that a scatter of the stamps [periods] would show; begins
    (n - 1,): intervals that they do not go over."""
    chord = np.linalg.norm(places[WINDOW - 1 :] - places[: 1 - WINDOW], axis=1) / (WINDOW - 1)
    steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
    longest = np.lib.stride_tricks.sliding_window_view(steps, WINDOW - 1).max(axis=1)
    holes = np.concatenate([[0], np.cumsum(np.isnan(places).any(axis=1))])
    cuts = np.concatenate([[0], np.cumsum(begins)])
    chord = np.where((holes[WINDOW:] == holes[:-WINDOW]) & (cuts[WINDOW - 1 :] == cuts[: 1 - WINDOW]), chord, 0.0)
    chord = np.where(longest < OF_ONE_STEP * (WINDOW - 1) * chord, chord, 0.0)
    first = np.flatnonzero(chord > max(MOVING_STAMPS * noise / scatter, OF_FASTEST * float(chord.max())))
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


CLOCKS = 1e-3  # difference of rate beyond which two clocks are not meant to be the same
OVER_S = 0.04  # over which a speed is taken
MOVING = 0.05  # of a pass's largest cable speed
LAG_S = 0.25  # difference of the instants at which two passes begin or end to move
VARYING = 0.5  # standard deviation of the speed over its mean from which its profile can be recognised
BLOCKS = 16  # of stamps, whose means scatter by what is not common to all
ALIKE = 0.3  # correlation of two speed profiles: of one motion seen by different cables it is mostly above 0.5 (simulated)


@dataclass(frozen=True)
class Alignment:
    """A run whose later passes are on the clock of pass 1, with what each pass's time is uncertain by against it.

    Where stamps jitter the run has the times at which the motion shows its samples to have been taken; stamp_s (n,) are pass 1's as they
    were recorded, which its trajectory keeps.
    """

    run: Run
    clocks: tuple[PassClock, ...]
    notes: tuple[Message, ...]
    stamp_s: FloatArray

    @property
    def name(self) -> str:
        """Return the name of the first pass's file."""
        return self.run.passes[0].source

    @cached_property
    def lengths(self) -> Lengths:
        """Return its lengths, without counts that are in doubt by themselves; computed once."""
        return self.evidence.doubts.applied(self.run.rig, self._all_lengths)

    def lengths_of(self, doubts: Doubts) -> Lengths:
        """Return its lengths, without the counts that are in these doubts."""
        return self.lengths if doubts is self.evidence.doubts else doubts.applied(self.run.rig, self._all_lengths)

    def pieces(self, doubts: Doubts) -> list[Lengths]:
        """Return its lengths in one piece."""
        return [self.lengths_of(doubts)]

    @cached_property
    def evidence(self) -> Evidence:
        """What it tells of its counters."""
        finder = EvidenceFinder(self.run.rig, self.run.recorded)
        finder.add(self._all_lengths)
        return finder.found()

    @cached_property
    def _all_lengths(self) -> Lengths:
        return lengths_from_counts(self.run)


def align(run: Run | Alignment) -> Alignment:
    """Bring later passes to the clock of pass 1 by their rising sync edges: a shift by one edge, shift and rate by several. What is aligned
    stays as it is, its lengths with it.

    Stamps that jitter are judged in each pass by its own cables (`stamps`), or a later pass would be interpolated at wrong instants: what
    is left of their errors is one of its lengths.

    TrajectoryError when passes are not the same motion: other edges, clocks that differ by more than CLOCKS, another beginning or end,
    another profile of speed.
    """
    if isinstance(run, Alignment):
        return run
    stamp_s = run.passes[0].time_s
    if run.rig.passes == 1:
        return Alignment(run, (PassClock(),), (), stamp_s)
    stamps = [_stamps(run, number) for number in range(1, run.rig.passes + 1)]
    notes = [_said(number, of) for number, of in enumerate(stamps, 1) if of.kind != "sound"]
    first = replace(run.passes[0], time_s=stamps[0].time_s)
    passes, clocks = [first], [PassClock()]
    for number in range(2, run.rig.passes + 1):
        both = stamps[0], stamps[number - 1]
        later = replace(run.passes[number - 1], time_s=both[1].time_s)
        edges = first.rising(), later.rising()
        if len(edges[0]) != len(edges[1]):
            raise TrajectoryError(
                f"{later.source}: pass {number} has {len(edges[1])} rising sync edges, pass 1 has {len(edges[0])}: not the same motion"
            )
        u_stamp = float(np.hypot(both[0].u_time_s, both[1].u_time_s))
        shift, rate, u = _clock(edges[0], edges[1], _period(first), _period(later), u_stamp)
        if not abs(rate - 1.0) <= CLOCKS:
            raise TrajectoryError(f"{later.source}: pass {number}: its clock runs {rate:.6f} times pass 1's: not the same motion")
        if len(edges[0]) == 0:
            notes.append(message("passes.no_sync", number=number))
        elif shift or rate != 1.0:
            notes.append(message("passes.clock", number=number, shift_s=float(shift), rate=float(rate), edges=len(edges[0])))
        later = replace(later, time_s=shift + rate * later.time_s)
        _same_motion(first, later, number)
        if u_stamp > 0.0:
            skew = 0.0 if later.u_time_s is None else later.u_time_s
            later = replace(later, u_time_s=np.hypot(skew, np.full(len(later.time_s), u_stamp)))
        passes.append(later)
        clocks.append(_uncertain(edges[0], u, both))
    return Alignment(replace(run, passes=tuple(passes)), tuple(clocks), tuple(notes), stamp_s)


def _stamps(run: Run, number: int) -> Stamps:
    """The stamps of a pass, judged by the lengths of its cables as places."""
    cables = tuple(c.model_copy(update={"passage": 1}) for c in run.rig.cables_of(number))
    alone = replace(run, rig=run.rig.model_copy(update={"cable": cables}), passes=(run.passes[number - 1],))
    lengths = lengths_from_counts(alone).of_cables().change_mm
    return judged(run.passes[number - 1].time_s, lengths, np.full(len(lengths), np.sqrt(count_variance(alone.rig).mean())))


def _said(number: int, stamps: Stamps) -> Message:
    intervals = 1e3 * np.diff(stamps.stamp_s)
    apart = {"number": number, "least_ms": float(intervals.min()), "most_ms": float(intervals.max())}
    if stamps.kind == "even":
        return message("stamps.pass.even", **apart)
    return message("stamps.pass.uneven", **apart, error_ms=1e3 * stamps.u_time_s)


def _uncertain(edges: FloatArray, u_s: float, both: tuple[Stamps, Stamps]) -> PassClock:
    """What the time of a pass is uncertain by, of both passes' stamps and pass 1's edges, by which they were brought together to u_s."""
    if len(edges) > 1:
        return PassClock(u_s)  # which tell the rate too
    u_rate = float(np.hypot(both[0].u_rate, both[1].u_rate))
    if len(edges) == 1:
        return PassClock(u_s, u_rate, float(edges[0]))
    return PassClock(float(np.hypot(_u_mean(both[0]), _u_mean(both[1]))), u_rate, float(both[0].time_s.mean()))


def _u_mean(stamps: Stamps) -> float:
    """Standard uncertainty [s] of even times as a whole, which are on the mean of stamps: by how means of BLOCKS parts of these scatter."""
    if stamps.kind != "even":
        return 0.0
    means = [float(part.mean()) for part in np.array_split(stamps.stamp_s - stamps.time_s, BLOCKS)]
    return float(np.std(means, ddof=1) / np.sqrt(BLOCKS))


def _period(counts: Counts) -> float:
    return float(np.median(np.diff(counts.time_s))) if len(counts.time_s) > 1 else 0.0


def _clock(first: FloatArray, later: FloatArray, period: float, later_period: float, u_stamp_s: float) -> tuple[float, float, float]:
    """(shift, rate, standard uncertainty [s]) of t_first = shift + rate t_later; u_stamp_s: of an edge's two stamps.

    An edge is known to within a sampling period. Only what scatters of that is averaged by further edges: pulses that keep step with the
    sampling are all late by the same.
    """
    quantum = np.hypot(period, later_period) / np.sqrt(12.0)
    if len(first) == 0:
        return 0.0, 1.0, 0.0
    if len(first) == 1:
        return float(first[0] - later[0]), 1.0, float(np.hypot(quantum, u_stamp_s))
    rate, shift = np.polyfit(later, first, 1)
    scatter = first - (shift + rate * later)
    spread = (scatter**2).sum() / max(len(first) - 2, 1)
    variance = max(quantum**2 - spread, 0.0) + spread / (len(first) / 2)
    return float(shift), float(rate), float(np.sqrt(variance))


def _speed(counts: Counts) -> tuple[FloatArray, int]:
    """(n - k,) root mean square over the channels of the counts' speed [1/s] over k samples, about OVER_S: stamps in error would be
    speeds between neighbours. Wraps and jumps are no motion."""
    k = int(np.clip(np.rint(OVER_S / _period(counts)), 1, len(counts.time_s) - 2))
    step = counts.recorded[k:] - counts.recorded[:-k]
    step[np.abs(step) > 2**14] = np.nan
    return np.sqrt(np.nan_to_num((step / (counts.time_s[k:] - counts.time_s[:-k])[:, None]) ** 2).mean(axis=1)), k


def _same_motion(first: Counts, later: Counts, number: int) -> None:
    if min(len(first.time_s), len(later.time_s)) < 3:
        return
    speeds = _speed(first), _speed(later)
    spans = []
    for counts, (speed, k) in zip((first, later), speeds, strict=True):
        moving = np.flatnonzero(speed > MOVING * speed.max()) if speed.max() > 0 else np.array([0])
        spans.append((counts.time_s[moving[0]], counts.time_s[moving[-1] + k]))
    for what, i in (("begins", 0), ("ends", 1)):
        lag = spans[1][i] - spans[0][i]
        if abs(lag) > LAG_S:
            side = "after" if lag > 0 else "before"
            raise TrajectoryError(f"{later.source}: pass {number} {what} to move {abs(lag):.3f} s {side} pass 1: not the same motion")
    (own, k), (other, later_k) = speeds
    on_first = np.interp(first.time_s[:-k], later.time_s[:-later_k], other)
    if all(s.std() > VARYING * s.mean() for s in (own, on_first)):
        alike = float(np.corrcoef(own, on_first)[0, 1])
        if alike < ALIKE:
            raise TrajectoryError(
                f"{later.source}: pass {number}: its profile of speed is not that of pass 1 (correlation {alike:.2f}): not the same motion"
            )
