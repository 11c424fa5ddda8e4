"""When a channel is not to be believed, and what proves it right again.

A counter that stepped (`trajectory.continuity`) counts on, from another origin. Its lengths are not used from there on, until something
shows that the origin is where it was: a rest at a place where the run rested before, or began, at which all the other channels are back and
this one too. (Redundant cables prove it likewise: `trajectory.consistency`.)
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.lengths import Lengths, Reason, with_reasons
from lmeasure.rig import Rig
from lmeasure.status import Status
from lmeasure.trajectory.continuity import Away, Continuity
from lmeasure.trajectory.standing import Stood
from lmeasure.trajectory.steps import Break
from lmeasure.trajectory.visits import LEAST_CABLES, NEAR_MM, Rests

EVERY = -1
"""Instead of a cable: all of them."""
BACK_COUNTS = 3.0
BACK_MM = 0.1
BACK_SCATTERS = 3.0
"""Of the other channels at the two visits (root mean square), between these bounds: up to this a channel is back where it was."""
TOLD = 12
"""Notes of a run's counters that a reader is asked to read."""
COARSE_MM = 1.0
"""A step of a channel that would not be seen is said to be one that sampling is too slow for from this size on."""


@dataclass(frozen=True)
class Doubt:
    """A cable whose counts are not used, or `EVERY`, from the sample behind after_s to the one at until_s, with the status and cause of
    samples that need it."""

    cable: int
    after_s: float
    until_s: float
    status: Status
    text: str

    def mask(self, time_s: FloatArray) -> BoolArray:
        """(n,) which samples at times (n,) it is about."""
        return (time_s > self.after_s) & (time_s <= self.until_s)


@dataclass(frozen=True)
class Doubts:
    """All of a run, in order of time, and notes for the reader."""

    every: tuple[Doubt, ...] = ()
    notes: tuple[str, ...] = ()

    def about(self, cable: int, time_s: float) -> bool:
        """Whether a cable is in doubt at a time."""
        return any(d.cable == cable and d.after_s < time_s <= d.until_s for d in self.every)

    def applied(self, rig: Rig, lengths: Lengths) -> Lengths:
        """Lengths of a piece of the run without the counts that are in doubt; what only a jump had made doubtful is used again where
        nothing is said against it."""
        lost = any(reason.status == Status.ORIGIN_LOST for reasons in lengths.reasons for reason in reasons)
        first, last = float(lengths.time_s[0]), float(lengths.time_s[-1])
        here = [d for d in self.every if d.after_s < last and d.until_s >= first]
        if not lost and not here:
            return lengths
        reasons = []
        for j, before in enumerate(lengths.reasons):
            mine = [Reason(d.mask(lengths.time_s), d.status, d.text) for d in here if d.cable == j]
            # whether an encoder of angles lost its origin nothing else tells
            kept = [r for r in before if r.status != Status.ORIGIN_LOST or j >= lengths.lengths]
            reasons.append((*kept, *(r for r in mine if r.mask.any())))
        lengths = with_reasons(rig, lengths, tuple(reasons))
        for doubt in here:
            if doubt.cable == EVERY:
                mask = doubt.mask(lengths.time_s)
                lengths.change_mm[mask] = lengths.counts[mask] = np.nan
                lengths.flags[mask], lengths.cause[mask], lengths.cable[mask] = doubt.status, doubt.text, ""
        return lengths


NONE = Doubts()


def judged(rig: Rig, continuity: Continuity, rests: Rests) -> Doubts:
    """What is in doubt of a run, by its breaks and its rests, whose lengths are those of all counts, doubtful ones included."""
    every = [_for_a_moment(rig, away) for away in continuity.away] + [_stood(rig, stood) for stood in continuity.stood]
    notes = _of_moments(rig, continuity.away)
    count_mm = np.array([(d := rig.point(c.from_point).drum).count_length_mm / d.scale for c in rig.cable])
    open_until: dict[int, float] = {}
    for new in sorted(continuity.breaks, key=lambda b: -b.before_s):
        stood = any(s.cable == new.cable and s.until_s == new.before_s for s in continuity.stood)
        every.append(_lost(rig, new, open_until.get(new.cable, np.inf), float(count_mm[new.cable]), stood=stood))
        open_until[new.cable] = new.before_s
    every.sort(key=lambda d: (d.after_s, d.cable))
    places = _Places(rests, every)
    for doubt in [d for d in every if d.status == Status.ORIGIN_LOST]:
        if any(stood.cable == doubt.cable and stood.after_s == doubt.after_s for stood in continuity.stood):
            notes.append(doubt.text)
            continue
        # where a channel stands it is back everywhere
        proof = places.proof(doubt, count_mm, [s for s in continuity.stood if s.cable == doubt.cable])
        if proof is None:
            notes.append(f"{doubt.text}{'' if np.isinf(doubt.until_s) else f', and it errs again at {doubt.until_s:.6g} s'}")
        else:
            every.remove(doubt)
            places.forget(doubt)
            notes.append(f"{doubt.text}; but it is back where it was at the rest at {proof:.6g} s: it has lost nothing")
    if continuity.clock_s:
        told = ", ".join(f"{t:.6g}" for t in continuity.clock_s[:3])
        more = len(continuity.clock_s) - 3
        notes.append(f"all channels step as if the clock had, behind {told} s{f' and at {more} more instants' if more > 0 else ''}")
    if len(notes) > TOLD:
        notes = [*notes[:TOLD], f"and {len(notes) - TOLD} more of the kind"]
    return Doubts(tuple(every), tuple(notes))


def unseen(rig: Rig, continuity: Continuity) -> str:
    """What steps of a counter this run would not show, in words."""
    blind = np.flatnonzero(np.isinf(continuity.least_mm))
    if len(blind) == len(rig.cable):
        return "steps of counters are not seen: no channel has four counts on end"
    text = _seen(rig, continuity)
    if not len(blind):
        return text
    channels = dict.fromkeys(rig.cable[j].channel for j in blind)
    return f"{text}; of {', '.join(channels)}, without four counts on end, none are"


def _seen(rig: Rig, continuity: Continuity) -> str:
    j = int(np.argmax(np.where(np.isfinite(continuity.least_mm), continuity.least_mm, 0.0)))
    drum = rig.point(rig.cable[j].from_point).drum
    counts = continuity.least_mm[j] / drum.count_length_mm * drum.scale
    limit = f"the acceleration of the motion itself, {continuity.acceleration_mm_s2:.3g} mm/s2, being the limit"
    text = f"steps of a counter by {counts:.0f} counts ({continuity.least_mm[j]:.2g} mm) and more are seen, {limit}"
    slow = "; it is sampled too slowly for its speed to show smaller ones" if continuity.least_mm[j] > COARSE_MM else ""
    return text + slow


def _of_moments(rig: Rig, away: tuple[Away, ...]) -> list[str]:
    """A line for each channel that was elsewhere for moments."""
    notes = []
    for j in sorted({a.cable for a in away}):
        mine = [a.after_s for a in away if a.cable == j]
        often = f", {len(mine)} times, first" if len(mine) > 1 else ""
        notes.append(f"channel {rig.cable[j].channel} was elsewhere for a moment{often} behind {mine[0]:.6g} s")
    return notes


def _for_a_moment(rig: Rig, away: Away) -> Doubt:
    channel = rig.cable[away.cable].channel
    # the sample at until_s is the first that is right again
    until = float(np.nextafter(away.until_s, -np.inf))
    return Doubt(away.cable, away.after_s, until, Status.JUMP, f"channel {channel} was elsewhere for a moment")


def _stood(rig: Rig, stood: Stood) -> Doubt:
    channel = rig.cable[stood.cable].channel
    text = f"channel {channel} stands from {stood.after_s:.6g} s on while its point is drawn far: it does not count"
    return Doubt(stood.cable, stood.after_s, stood.until_s, Status.ORIGIN_LOST, text)


def _lost(rig: Rig, at: Break, until_s: float, count_mm: float, *, stood: bool) -> Doubt:
    """stood: the channel stood before."""
    channel = rig.cable[at.cable].channel
    between = f"between {at.before_s:.6g} and {at.after_s:.6g} s"
    if np.isnan(at.by_mm) and stood:
        text = f"channel {channel} stood up to {at.before_s:.6g} s and counts again: its origin is lost"
    elif np.isnan(at.by_mm):
        text = f"channel {channel} does not follow the tool {between}, which goes on evenly: its origin is lost"
    else:
        drum = rig.point(rig.cable[at.cable].from_point).drum
        by = f"{drum.count_sign * at.by_mm / count_mm:+.0f} counts (within {np.ceil(at.u_mm / count_mm):.0f})"
        text = f"channel {channel} stepped by about {by} {between}: its origin is lost"
    return Doubt(at.cable, at.before_s, until_s, Status.ORIGIN_LOST, text)


class _Places:
    """Where a run rested, and which channels are believed there, as long as doubts go."""

    def __init__(self, rests: Rests, every: list[Doubt]) -> None:
        self._begin_s, self._length_mm = rests.begin_s, rests.length_mm
        self._doubts = np.zeros(rests.length_mm.shape, np.int64)
        for doubt in every:
            self._doubts[doubt.mask(self._begin_s), doubt.cable] += 1

    def forget(self, doubt: Doubt) -> None:
        """One that was proved wrong."""
        self._doubts[doubt.mask(self._begin_s), doubt.cable] -= 1

    def proof(self, doubt: Doubt, count_mm: FloatArray, standing: list[Stood]) -> float | None:
        """The beginning [s] of the first rest at which a cable in doubt is back where it was at a place known from before, or None."""
        tried, j = doubt.mask(self._begin_s), doubt.cable
        for stood in standing:
            tried &= (self._begin_s < stood.after_s) | (self._begin_s > stood.until_s)
        trusted = self._doubts == 0
        for i in np.flatnonzero(tried):
            # places at which the cable itself is known, where counting began among them
            before = np.flatnonzero(trusted[:i, j])
            known = np.vstack([np.ones_like(trusted[:1]), trusted[before]])
            apart = self._length_mm[i] - np.vstack([np.zeros_like(self._length_mm[:1]), self._length_mm[before]])
            others = trusted[i] & known
            others[:, j] = False
            number, of_others = others.sum(axis=1), np.where(others, np.abs(apart), 0.0)
            scatter = np.sqrt((of_others**2).sum(axis=1) / np.maximum(number, 1))
            back = np.maximum(BACK_COUNTS * count_mm[j], np.minimum(BACK_MM, BACK_SCATTERS * scatter))
            if ((number >= LEAST_CABLES - 1) & (of_others.max(axis=1) <= NEAR_MM) & (np.abs(apart[:, j]) <= back)).any():
                return float(self._begin_s[i])
        return None
