"""Repeated passes of one motion: brought to one clock, checked to be the same motion, and what their differences add to the uncertainty."""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from lmeasure.counts import Counts
from lmeasure.errors import TrajectoryError
from lmeasure.lengths import Lengths, lengths_from_counts
from lmeasure.run import Run
from lmeasure.trajectory.evidence import Evidence, EvidenceFinder

FloatArray = NDArray[np.float64]

CLOCKS = 1e-3  # difference of rate beyond which two clocks are not meant to be the same
MOVING = 0.05  # of a pass's largest cable speed
LAG_S = 0.25  # difference of the instants at which two passes begin or end to move
VARYING = 0.5  # standard deviation of the speed over its mean from which its profile can be recognised
ALIKE = 0.3  # correlation of two speed profiles: of one motion seen by different cables it is mostly above 0.5 (simulated)


@dataclass(frozen=True)
class Alignment:
    """A run whose later passes are on the clock of pass 1, with the standard uncertainty [s] of each pass's time against it."""

    run: Run
    u_time_s: tuple[float, ...]
    notes: tuple[str, ...]

    @cached_property
    def lengths(self) -> Lengths:
        """Its lengths, worked out once for all who ask for them."""
        return lengths_from_counts(self.run)

    @cached_property
    def evidence(self) -> Evidence:
        """What its rests tell of its counters."""
        finder = EvidenceFinder(self.run.rig, self.run.recorded)
        finder.add(self.lengths)
        return finder.found()


def align(run: Run | Alignment) -> Alignment:
    """Bring later passes to the clock of pass 1 by their rising sync edges: a shift by one edge, shift and rate by several. What is aligned
    stays as it is, its lengths with it.

    TrajectoryError when passes are not the same motion: other edges, clocks that differ by more than CLOCKS, another beginning or end,
    another profile of speed.
    """
    if isinstance(run, Alignment):
        return run
    first = run.passes[0]
    passes, u_time, notes = [first], [0.0], []
    for number in range(2, run.rig.passes + 1):
        later = run.passes[number - 1]
        edges = first.rising(), later.rising()
        if len(edges[0]) != len(edges[1]):
            raise TrajectoryError(
                f"{later.source}: pass {number} has {len(edges[1])} rising sync edges, pass 1 has {len(edges[0])}: not the same motion"
            )
        shift, rate, u = _clock(edges[0], edges[1], _period(first), _period(later))
        if not abs(rate - 1.0) <= CLOCKS:
            raise TrajectoryError(f"{later.source}: pass {number}: its clock runs {rate:.6f} times pass 1's: not the same motion")
        if len(edges[0]) == 0:
            notes.append(f"pass {number} has no sync edges: its clock is taken as pass 1's")
        elif shift or rate != 1.0:
            notes.append(f"pass {number}: clock shifted by {shift:+.6f} s, rate {rate:.9f}, from {len(edges[0])} sync edges")
        later = replace(later, time_s=shift + rate * later.time_s)
        _same_motion(first, later, number)
        passes.append(later)
        u_time.append(u)
    return Alignment(replace(run, passes=tuple(passes)), tuple(u_time), tuple(notes))


def _period(counts: Counts) -> float:
    return float(np.median(np.diff(counts.time_s))) if len(counts.time_s) > 1 else 0.0


def _clock(first: FloatArray, later: FloatArray, period: float, later_period: float) -> tuple[float, float, float]:
    """(shift, rate, standard uncertainty [s]) of t_first = shift + rate t_later.

    An edge is known to within a sampling period. Only what scatters of that is averaged by further edges: pulses that keep step with the
    sampling are all late by the same.
    """
    quantum = np.hypot(period, later_period) / np.sqrt(12.0)
    if len(first) == 0:
        return 0.0, 1.0, 0.0
    if len(first) == 1:
        return float(first[0] - later[0]), 1.0, float(quantum)
    rate, shift = np.polyfit(later, first, 1)
    scatter = first - (shift + rate * later)
    spread = (scatter**2).sum() / max(len(first) - 2, 1)
    variance = max(quantum**2 - spread, 0.0) + spread / (len(first) / 2)
    return float(shift), float(rate), float(np.sqrt(variance))


def _speed(counts: Counts) -> FloatArray:
    """(n,) root mean square over the channels of the counts' speed [1/s]; wraps and jumps are no motion."""
    step = np.diff(counts.recorded, axis=0)
    step[np.abs(step) > 2**14] = np.nan
    return np.sqrt(np.nan_to_num((step / np.diff(counts.time_s)[:, None]) ** 2).mean(axis=1))


def _same_motion(first: Counts, later: Counts, number: int) -> None:
    if min(len(first.time_s), len(later.time_s)) < 3:
        return
    speeds = _speed(first), _speed(later)
    spans = []
    for counts, speed in zip((first, later), speeds, strict=True):
        moving = np.flatnonzero(speed > MOVING * speed.max()) if speed.max() > 0 else np.array([0])
        spans.append((counts.time_s[moving[0]], counts.time_s[moving[-1] + 1]))
    for what, i in (("begins", 0), ("ends", 1)):
        lag = spans[1][i] - spans[0][i]
        if abs(lag) > LAG_S:
            side = "after" if lag > 0 else "before"
            raise TrajectoryError(f"{later.source}: pass {number} {what} to move {abs(lag):.3f} s {side} pass 1: not the same motion")
    on_first = np.interp(first.time_s[:-1], later.time_s[:-1], speeds[1])
    if all(s.std() > VARYING * s.mean() for s in (speeds[0], on_first)):
        alike = float(np.corrcoef(speeds[0], on_first)[0, 1])
        if alike < ALIKE:
            raise TrajectoryError(
                f"{later.source}: pass {number}: its profile of speed is not that of pass 1 (correlation {alike:.2f}): not the same motion"
            )
