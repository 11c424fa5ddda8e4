"""When a channel is not to be believed, and what proves it right again.

A counter that stepped (`trajectory.faults.continuity`) counts on, from another origin. Its lengths are not used from there on, until
something
shows that the origin is where it was: a rest at a place where the run rested before, or began, at which all the other channels are back and
this one too. (Redundant cables prove it likewise: `trajectory.faults.consistency`.)

Where a run rests, and which of its rests are visits of one place, told by the counts alone.

A rest is a mean of lengths. Two rests are of one place when all cables but one agree: six lengths are a pose, and two poses that a robot is
sent to do not differ by the one twist that a single cable sees; a counter that lost counts does.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, Status
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, Reason, with_reasons
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.continuity import Away, Break, Continuity, Stood

VISIT_LAG_S = 0.05
STILL_MM = 0.2  # by which no cable's length changes within VISIT_LAG_S while the robot rests
LEAST_S = 0.15
SETTLED = 0.5  # of a rest: its last part is taken, up to VISIT_LAG_S before its end
LONGEST_S = 60.0  # of a rest that is longer, what is more than two of these before its end is let go
NEAR_MM = 0.5  # by which cables agree at two visits of one place
LEAST_CABLES = 4  # of which one may disagree


@dataclass(frozen=True)
class Rests:
    """N rests in order of time: begin_s, end_s (N,), length_mm (N, m) mean changes of the cables' lengths, from the counts alone."""

    begin_s: FloatArray
    end_s: FloatArray
    length_mm: FloatArray

    def __len__(self) -> int:
        return len(self.begin_s)

    def places(self) -> IntArray:
        """(N,) the number of the place that each rest is a visit of, from 0 in order of their first visits.

        A rest is held against the last visit of every place, for robots drift and counters slip more than once.
        """
        n, m = self.length_mm.shape
        last = np.empty((n, m))
        out = np.empty(n, np.int64)
        known = 0
        for i, here in enumerate(self.length_mm):
            apart = np.sort(np.abs(last[:known] - here), axis=1)
            far = apart[:, -2] if m >= LEAST_CABLES else apart[:, -1]
            nearest = int(np.argmin(far)) if known else -1
            if nearest < 0 or not far[nearest] <= NEAR_MM:
                nearest, known = known, known + 1
            out[i], last[nearest] = nearest, here
        return out


class RestFinder:
    """Finds rests in a run that is given in pieces."""

    def __init__(self) -> None:
        self._time_s: FloatArray | None = None
        self._length_mm = np.empty((0, 0))
        self._begun_s: float | None = None  # when the rest began that goes on from the pieces before
        self._found: list[tuple[float, float, FloatArray]] = []

    def add(self, time_s: FloatArray, length_mm: FloatArray) -> None:
        """The next samples: times (n,) and changes of length (n, m), NaN where they are not known."""
        if self._time_s is not None:
            time_s, length_mm = np.concatenate([self._time_s, time_s]), np.concatenate([self._length_mm, length_mm])
        kept = self._look(time_s, length_mm, last=False)
        self._time_s, self._length_mm = time_s[kept:].copy(), length_mm[kept:].copy()

    def rests(self) -> Rests:
        """All of them, the run having ended."""
        if self._time_s is not None:
            self._look(self._time_s, self._length_mm, last=True)
            self._time_s = None
        if not self._found:
            return Rests(np.empty(0), np.empty(0), np.empty((0, self._length_mm.shape[1])))
        begin, end, lengths = zip(*self._found, strict=True)
        return Rests(np.array(begin), np.array(end), np.array(lengths))

    def _look(self, time_s: FloatArray, length_mm: FloatArray, *, last: bool) -> int:
        """Keep the rests that have ended, all of them at last; the sample from which the others must be looked at again."""
        n = len(time_s)
        ahead = np.searchsorted(time_s, time_s + VISIT_LAG_S)
        judged = n if last else int(np.searchsorted(ahead, n))
        ahead = np.minimum(ahead[:judged], n - 1)
        with np.errstate(invalid="ignore"):
            still = (np.abs(length_mm[ahead] - length_mm[:judged]) <= STILL_MM).all(axis=1)
        edges = np.flatnonzero(np.diff(np.concatenate([[False], still, [False]]).astype(np.int8)))
        begun, self._begun_s = self._begun_s, None
        for first, stop in edges.reshape(-1, 2):
            begin = float(time_s[first]) if first or begun is None else begun
            if stop == judged and not last:
                self._begun_s = begin
                return int(np.searchsorted(time_s, _kept_from(begin, float(time_s[-1]))))
            self._keep(begin, time_s[first : ahead[stop - 1] + 1], length_mm[first : ahead[stop - 1] + 1])
        return judged

    def _keep(self, begin: float, time_s: FloatArray, length_mm: FloatArray) -> None:
        end = float(time_s[-1])
        if end - begin < LEAST_S:
            return
        first = max(_kept_from(begin, end), float(time_s[0]))
        settled = (time_s >= first + (1.0 - SETTLED) * (end - first)) & (time_s <= end - VISIT_LAG_S)
        middle = length_mm[settled]
        middle = middle[~np.isnan(middle).any(axis=1)]
        if len(middle):
            self._found.append((begin, end, middle.mean(axis=0)))


def _kept_from(begin: float, end: float) -> float:
    """From when on a rest is looked at: the same whatever the pieces in which it comes."""
    return begin + max(np.floor((end - begin) / LONGEST_S) - 1.0, 0.0) * LONGEST_S


EVERY = -1
"""Instead of a cable: all of them."""
BACK_COUNTS = 3.0
BACK_MM = 0.1
BACK_SCATTERS = 3.0
"""Of the other channels at the two visits (root mean square), between these bounds: up to this a channel is back where it was."""
TOLD = 12
"""Notes of a run's counters that a reader is asked to read."""
STILL_MM_S2 = 1e-6
"""An acceleration below it is rounding of numbers: samples 1 s apart would show 1e-6 mm of it."""
COARSE_MM = 1.0
"""A step of a channel that would not be seen is said to be one that sampling is too slow for from this size on."""


@dataclass(frozen=True)
class During:
    """Of a cable, or another channel (index), or `EVERY`, from the sample behind after_s to the one at until_s [s]."""

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
    """By how many true counts a channel that goes on from another origin reads too much, about. What is left of it is a length: a drum's is
    not linear in its counts, so that only near where it was can a length make up for them."""

    counts: float


@dataclass(frozen=True)
class Doubts:
    """All of a run, in order of time, notes for the reader, and what is taken off counts that are used."""

    every: tuple[Doubt, ...] = ()
    notes: tuple[Message, ...] = ()
    shifts: tuple[Shift, ...] = ()

    def with_more(self, *doubts: Doubt) -> "Doubts":
        """Return these doubts and others."""
        return replace(self, every=tuple(sorted((*self.every, *doubts), key=lambda d: (d.after_s, d.cable))))

    def about(self, cable: int, time_s: float) -> bool:
        """Whether a cable is in doubt at a time."""
        return any(d.cable == cable and d.after_s < time_s <= d.until_s for d in self.every)

    def applied(self, rig: Rig, lengths: Lengths) -> Lengths:
        """Lengths of a piece of the run without the counts that are in doubt; what only a jump had made doubtful is used again where
        nothing is said against it."""
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
            notes.append(doubt.said)
            continue
        # where a channel stands it is back everywhere
        proof = places.proof(doubt, count_mm, [s for s in continuity.stood if s.cable == doubt.cable])
        if proof is None:
            again = not np.isinf(doubt.until_s)
            notes.append(message("origin.again", what=doubt.said, again_s=doubt.until_s) if again else doubt.said)
        else:
            every.remove(doubt)
            places.forget(doubt)
            notes.append(message("origin.back", what=doubt.said, at_s=proof))
    if continuity.clock_s:
        told = ", ".join(f"{t:.6g}" for t in continuity.clock_s[:3])
        more = len(continuity.clock_s) - 3
        notes.append(message("clock.stepped.often", after_s=told, more=more) if more > 0 else message("clock.stepped", after_s=told))
    if len(notes) > TOLD:
        notes = [*notes[:TOLD], message("counts.more", more=len(notes) - TOLD)]
    return Doubts(tuple(every), tuple(notes))


def unseen(rig: Rig, continuity: Continuity) -> Message:
    """What steps of a counter this run would not show."""
    blind = np.flatnonzero(np.isinf(continuity.least_mm))
    if len(blind) == len(rig.cable):
        return message("steps.none")
    seen = _seen(rig, continuity)
    if not len(blind):
        return seen
    return message("steps.seen.but", seen=seen, channels=", ".join(dict.fromkeys(rig.cable[j].channel for j in blind)))


def _seen(rig: Rig, continuity: Continuity) -> Message:
    j = int(np.argmax(np.where(np.isfinite(continuity.least_mm), continuity.least_mm, 0.0)))
    drum = rig.point(rig.cable[j].from_point).drum
    mm = float(continuity.least_mm[j])
    step = {"counts": mm / drum.count_length_mm * drum.scale, "mm": mm}
    if continuity.jitter_mm is not None and continuity.jitter_mm[j] > mm / 2.0:
        return message("steps.seen.clock", **step)
    if continuity.acceleration_mm_s2 < STILL_MM_S2:
        return message("steps.seen.rounding", **step)
    seen = message("steps.seen", **step, mm_s2=float(continuity.acceleration_mm_s2))
    return message("steps.seen.slow", seen=seen) if mm > COARSE_MM else seen


def _of_moments(rig: Rig, away: tuple[Away, ...]) -> list[Message]:
    """A note for each channel that was elsewhere for moments."""
    notes = []
    for j in sorted({a.cable for a in away}):
        mine = [a.after_s for a in away if a.cable == j]
        told = {"channel": rig.cable[j].channel, "after_s": mine[0]}
        notes.append(message("channel.elsewhere.often", **told, times=len(mine)) if len(mine) > 1 else message("channel.elsewhere", **told))
    return notes


def _for_a_moment(rig: Rig, away: Away) -> Doubt:
    channel = rig.cable[away.cable].channel
    # the sample at until_s is the first that is right again
    until = float(np.nextafter(away.until_s, -np.inf))
    return Doubt(away.cable, away.after_s, until, Status.JUMP, message("channel.elsewhere.then", channel=channel))


def _stood(rig: Rig, stood: Stood) -> Doubt:
    channel = rig.cable[stood.cable].channel
    said = message("channel.stands", channel=channel, from_s=stood.after_s)
    return Doubt(stood.cable, stood.after_s, stood.until_s, Status.ORIGIN_LOST, said)


def _lost(rig: Rig, at: Break, until_s: float, count_mm: float, *, stood: bool) -> Doubt:
    """stood: the channel stood before."""
    channel = rig.cable[at.cable].channel
    between = {"after_s": at.before_s, "before_s": at.after_s}
    if np.isnan(at.by_mm) and stood:
        said = message("origin.stood", channel=channel, until_s=at.before_s)
    elif np.isnan(at.by_mm):
        said = message("origin.left", channel=channel, **between)
    else:
        by = rig.point(rig.cable[at.cable].from_point).drum.count_sign * at.by_mm / count_mm
        said = message("origin.stepped", channel=channel, counts=float(by), within=float(np.ceil(at.u_mm / count_mm)), **between)
    return Doubt(at.cable, at.before_s, until_s, Status.ORIGIN_LOST, said)


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
            number, of_others = others.sum(axis=1), np.where(others, np.abs(apart), 0.0)
            scatter = np.sqrt((of_others**2).sum(axis=1) / np.maximum(number, 1))
            back = np.maximum(BACK_COUNTS * count_mm[j], np.minimum(BACK_MM, BACK_SCATTERS * scatter))
            if ((number >= LEAST_CABLES - 1) & (of_others.max(axis=1) <= NEAR_MM) & (np.abs(apart[:, j]) <= back)).any():
                return float(self._begin_s[i])
        return None
