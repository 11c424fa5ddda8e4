"""Repeated passes of one motion: brought to one clock, checked to be the same motion, with the uncertainty from their differences."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.io import PIECE_ROWS
from lmeasure.recording import Counts, Run
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, count_variance, lengths_from_counts
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.continuity import Doubts
from lmeasure.trajectory.faults.rest_evidence import Evidence, EvidenceFinder
from lmeasure.trajectory.time.stamps import Stamps, judge_stamps
from lmeasure.trajectory.uncertainty.sources import PassClock

CLOCKS = 1e-3  # difference of rate beyond which two clocks are not meant to be the same
OVER_S = 0.04  # over which a speed is taken
MOVING = 0.05  # of a pass's largest cable speed
LAG_S = 0.25  # difference of the instants at which two passes begin or end to move
VARYING = 0.5  # standard deviation of the speed over its mean from which its profile can be detected
BLOCKS = 16  # blocks of stamps, whose means scatter by their independent errors
ALIKE = 0.3  # least correlation of two speed profiles: for one motion and different cables it is mostly above 0.5 (simulated)


@dataclass(frozen=True)
class Alignment:
    """A run whose later passes are on the clock of pass 1, with the uncertainty of each pass's time.

    For stamps with jitter the run has the samples' true times by the motion; stamp_s (n,) are pass 1's recorded ones, which its trajectory
    keeps.
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

    def zeroed(self, rig: Rig) -> "Alignment":
        """Return the same with its rig as its counters were zeroed."""
        return self if np.array_equal(rig.paid_out(), self.run.rig.paid_out()) else replace(self, run=replace(self.run, rig=rig))

    def lengths_of(self, doubts: Doubts) -> Lengths:
        """Return its lengths, without the counts that are in these doubts."""
        return self.lengths if doubts is self.evidence.doubts else doubts.applied(self.run.rig, self._all_lengths)

    def pieces(self, doubts: Doubts) -> list[Lengths]:
        """Return its lengths in one piece."""
        return [self.lengths_of(doubts)]

    @cached_property
    def evidence(self) -> Evidence:
        """Return the evidence on its counters."""
        finder = EvidenceFinder(self.run.rig, self.run.recorded)
        lengths = self._all_lengths
        for first in range(0, max(len(lengths.time_s), 1), PIECE_ROWS):  # which a processor keeps at hand
            finder.add(lengths.part(slice(first, first + PIECE_ROWS)))
        return finder.found()

    @cached_property
    def _all_lengths(self) -> Lengths:
        return lengths_from_counts(self.run)


def align(run: Run | Alignment) -> Alignment:
    """Bring later passes to the clock of pass 1 by their rising sync edges: a shift by one edge, shift and rate by several. An aligned run
    stays the same, with its lengths.

    Stamps that jitter are judged in each pass by its own cables (`stamps`), or a later pass would be interpolated at wrong instants: the
    rest of their errors is one of its lengths.

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
            several = {"n_edges": len(edges[1]), "n_edges2": len(edges[0])}
            raise TrajectoryError(message("error.pass_has_rising_sync", where=later.source, number=number, **several))
        u_stamp = float(np.hypot(both[0].u_time_s, both[1].u_time_s))
        shift, rate, u = _clock(edges[0], edges[1], _period(first), _period(later), u_stamp)
        if not abs(rate - 1.0) <= CLOCKS:
            raise TrajectoryError(message("error.pass_its_clock_runs", where=later.source, number=number, rate=rate))
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
    return judge_stamps(run.passes[number - 1].time_s, lengths, np.full(len(lengths), np.sqrt(count_variance(alone.rig).mean())))


def _said(number: int, stamps: Stamps) -> Message:
    intervals = 1e3 * np.diff(stamps.stamp_s)
    apart = {"number": number, "least_ms": float(intervals.min()), "most_ms": float(intervals.max())}
    error = {} if stamps.kind == "even" else {"error_ms": 1e3 * stamps.u_time_s}
    return message(f"stamps.pass.{stamps.kind}", **apart, **error)


def _uncertain(edges: FloatArray, u_s: float, both: tuple[Stamps, Stamps]) -> PassClock:
    """Return the uncertainty of a pass's time, from both passes' stamps and pass 1's edges, which align them to u_s."""
    if len(edges) > 1:
        return PassClock(u_s)  # these determine the rate too
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
    """Return (shift, rate, standard uncertainty [s]) of t_first = shift + rate t_later; u_stamp_s: of an edge's two stamps. An edge is
    known to within a sampling period. Further edges average only its scatter: pulses that keep step with the sampling are all late by the
    same."""
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
            raise TrajectoryError(message("error.pass_to_move_s", where=later.source, number=number, what=what, lag=abs(lag), side=side))
    (own, k), (other, later_k) = speeds
    on_first = np.interp(first.time_s[:-k], later.time_s[:-later_k], other)
    if all(s.std() > VARYING * s.mean() for s in (own, on_first)):
        alike = float(np.corrcoef(own, on_first)[0, 1])
        if alike < ALIKE:
            raise TrajectoryError(message("error.pass_its_profile_of", where=later.source, number=number, alike=alike))
