"""Doubts about channels: from when to when a channel's counts are not used, and by how much they are shifted."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import BoolArray, FloatArray, Status
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, Reason, with_reasons
from lmeasure.text import Message

EVERY = -1  # Instead of a cable: all of them


@dataclass(frozen=True)
class During:
    """Doubt of a cable, or another channel (index), or `EVERY`, from the sample behind after_s to the one at until_s [s]."""

    cable: int
    after_s: float
    until_s: float

    def mask(self, time_s: FloatArray) -> BoolArray:
        """(n,) which samples at times (n,) it is about."""
        return (time_s > self.after_s) & (time_s <= self.until_s)


@dataclass(frozen=True)
class Doubt(During):
    """Counts that are not used, with the status and cause of samples that need them."""

    status: Status
    said: Message


@dataclass(frozen=True)
class Shift(During):
    """Approximate surplus of true counts in a channel that continues from another origin. The remainder is a length: a drum is not linear
    in its counts, so that a length compensates them only near its place."""

    counts: float


@dataclass(frozen=True)
class Doubts:
    """Doubts of a run, in order of time, notes for the reader, and corrections of used counts."""

    every: tuple[Doubt, ...] = ()
    notes: tuple[Message, ...] = ()
    shifts: tuple[Shift, ...] = ()

    def with_more(self, *doubts: Doubt) -> "Doubts":
        """Return these doubts and others."""
        return replace(self, every=tuple(sorted((*self.every, *doubts), key=lambda d: (d.after_s, d.cable))))

    def about(self, cable: int, time_s: float) -> bool:
        """Return whether a cable is in doubt at a time."""
        return any(d.cable == cable and d.after_s < time_s <= d.until_s for d in self.every)

    def applied(self, rig: Rig, lengths: Lengths) -> Lengths:
        """Return lengths of a piece of the run without doubtful counts; counts in doubt only for a jump are used again if nothing
        contradicts them."""
        lost = any(reason.status == Status.ORIGIN_LOST for reasons in lengths.reasons for reason in reasons)
        first, last = float(lengths.time_s[0]), float(lengths.time_s[-1])
        here = [d for d in self.every if d.after_s < last and d.until_s >= first]
        moved = [s for s in self.shifts if s.after_s < last and s.until_s >= first]
        if not lost and not here and not moved:
            return lengths
        assert lengths.gone_on is not None
        lengths = replace(lengths, gone_on=shifted(moved, lengths.time_s, lengths.gone_on))
        reasons = []
        for j, before in enumerate(lengths.reasons):
            mine = [Reason(d.mask(lengths.time_s), d.status, d.said) for d in here if d.cable == j]
            # whether an encoder of angles lost its origin nothing else tells
            kept = [r for r in before if r.status != Status.ORIGIN_LOST or j >= lengths.lengths]
            reasons.append((*kept, *(r for r in mine if r.mask.any())))
        lengths = with_reasons(rig, lengths, tuple(reasons))
        for doubt in here:
            if doubt.cable == EVERY:
                mask = doubt.mask(lengths.time_s)
                lengths.change_mm[mask] = lengths.counts[mask] = np.nan
                lengths.flags[mask], lengths.cause[mask], lengths.cable[mask] = doubt.status, doubt.said, ""
        return lengths


NONE = Doubts()


def shifted(shifts: Iterable[Shift], time_s: FloatArray, counts: FloatArray) -> FloatArray:
    """(n, m) true counts at times (n,), less these shifts."""
    counts = counts.copy()
    for s in shifts:
        counts[s.mask(time_s), s.cable] -= s.counts
    return counts
