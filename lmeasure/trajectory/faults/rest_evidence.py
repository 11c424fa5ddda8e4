"""Evidence of a run's rests about its counters: counts that were lost on the way, and whether the counts close.

A robot that comes back to a place brings back all counts, but for its repeatability and a drift that is gradual. A counter that lost counts
shifts one channel, at once, at all places after that moment. With six cables such a shift is also a pose shift, along exactly the twist
that this one cable sees and no other does: a robot that steps so is far less likely than a counter that slips, but not impossible:
"suspected".

A counter that stepped (`trajectory.faults.continuity`) counts on, from another origin. Its lengths are not used from there on, until
something shows that the origin is where it was: a rest at a place where the run rested before, or began, at which all the other channels
are back and this one too. (Redundant cables prove it likewise: `trajectory.faults.consistency`.)
"""

from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from lmeasure.core import BoolArray, FloatArray, IntArray, Status
from lmeasure.recording import Recorded
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.continuity import NONE, Away, Break, Continuity, ContinuityFinder, Doubt, Doubts, StuckCounter
from lmeasure.trajectory.faults.redundancy import ALONE, CLOSED_COUNTS, CLOSED_MM, CLOSED_SCATTERS
from lmeasure.trajectory.faults.rests import LEAST_CABLES, NEAR_MM, RestFinder, Rests, ReversalFinder, Reversals

BACK_COUNTS = 3.0
BACK_MM = 0.1
BACK_SCATTERS = 3.0
"""Scatter of the other channels at the two visits (root mean square), between these bounds: up to this a channel has returned."""
MOST_NOTES = 12  # Most notes about counters of a run
STILL_MM_S2 = 1e-6  # An acceleration below it is rounding of numbers: samples 1 s apart would show 1e-6 mm of it
COARSE_MM = 1.0  # Undetectable steps from this size on are reported as too slow sampling


def doubts_of(rig: Rig, continuity: Continuity, rests: Rests) -> Doubts:
    """Return the doubts about a run, by its breaks and its rests, whose lengths are those of all counts, doubtful ones included."""
    every = [_for_a_moment(rig, away) for away in continuity.away]
    for s in continuity.stood:
        said = message("channel.stands", channel=rig.cable[s.cable].channel, from_s=s.after_s)
        every.append(Doubt(s.cable, s.after_s, s.until_s, Status.ORIGIN_LOST, said))
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
        # a stalled channel seems to be back everywhere
        proof = places.proof(doubt, count_mm, [s for s in continuity.stood if s.cable == doubt.cable])
        if proof is None:
            again = not np.isinf(doubt.until_s)
            notes.append(message("origin.again", what=doubt.said, again_s=doubt.until_s) if again else doubt.said)
        else:
            every.remove(doubt)
            places.forget(doubt)
            notes.append(message("origin.back", what=doubt.said, at_s=proof))
    if continuity.clock_s:
        determined = ", ".join(f"{t:.6g}" for t in continuity.clock_s[:3])
        more = {"more": len(continuity.clock_s) - 3} if len(continuity.clock_s) > 3 else {}
        notes.append(message(f"clock.stepped{'.often' if more else ''}", after_s=determined, **more))
    if len(notes) > MOST_NOTES:
        notes = [*notes[:MOST_NOTES], message("counts.more", more=len(notes) - MOST_NOTES)]
    return Doubts(tuple(every), tuple(notes))


def unseen_steps(rig: Rig, continuity: Continuity) -> Message:
    """Return the steps of a counter that this run would not detect."""
    blind = np.flatnonzero(np.isinf(continuity.least_mm))
    if len(blind) == len(rig.cable):
        return message("steps.none")
    seen, channels = _seen(rig, continuity), ", ".join(dict.fromkeys(rig.cable[j].channel for j in blind))
    return message("steps.seen.but", seen=seen, channels=channels) if len(blind) else seen


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
        times = {"times": len(mine)} if len(mine) > 1 else {}
        notes.append(message(f"channel.elsewhere{'.often' if times else ''}", channel=rig.cable[j].channel, after_s=mine[0], **times))
    return notes


def _for_a_moment(rig: Rig, away: Away) -> Doubt:
    said = message("channel.elsewhere.then", channel=rig.cable[away.cable].channel)
    # the sample at until_s is the first that is right again
    return Doubt(away.cable, away.after_s, float(np.nextafter(away.until_s, -np.inf)), Status.JUMP, said)


def _lost(rig: Rig, at: Break, until_s: float, count_mm: float, *, stood: bool) -> Doubt:
    """Return the doubt; stood: the channel was stuck before."""
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
    """Rests of a run by position, and the trusted channels there, while doubts continue."""

    def __init__(self, rests: Rests, every: list[Doubt]) -> None:
        self._begin_s, self._length_mm = rests.begin_s, rests.length_mm
        self._doubts = np.zeros(rests.length_mm.shape, np.int64)
        for doubt in every:
            self._doubts[doubt.mask(self._begin_s), doubt.cable] += 1

    def forget(self, doubt: Doubt) -> None:
        """One that was proved wrong."""
        self._doubts[doubt.mask(self._begin_s), doubt.cable] -= 1

    def proof(self, doubt: Doubt, count_mm: FloatArray, standing: list[StuckCounter]) -> float | None:
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


SIGNIFICANCE = 1e-3  # Of a run: shared by all channels and all moments at which counts may have been lost (Bonferroni)
LEAST_COUNTS = 5.0  # A step that is smaller is not determined from the robot's
SCATTERS = 3.0  # Or smaller than this many scatters of single visits
AT_ONCE = 0.5
"""Part of a step that must lie between the two visits of each position next to it, beyond the usual change between visits: a drift is
spread over all."""
TRENDED = 6  # Degrees of freedom from which a linear drift is taken off
DETERMINED = 3  # Changes from visit to visit from which their scatter is determined
MOST_STEPS = 12
MOST_RETURNS = 32  # Most positions visited again whose cable directions are computed
TERMS = 8  # Of the series of a closure that was lost at an unknown moment

SUSPECTED = "counts.suspected"
"""Cause of a sample whose pose depends on doubtful counts."""
CLOSURE = "closure of the counts"


@dataclass(frozen=True)
class Step:
    """Step in one channel's counts: index of the cable, times before and after [s], recorded counts and mm of length."""

    cable: int
    name: str
    channel: str
    after_s: float
    before_s: float
    counts: float
    length_mm: float

    @property
    def said(self) -> Message:
        """Return its messages."""
        by = {"counts": self.counts, "mm": self.length_mm}
        return message("counts.stepped", channel=self.channel, cable=self.name, **by, after_s=self.after_s, before_s=self.before_s)


@dataclass(frozen=True)
class Evidence:
    """Findings at rests. closure_mm (m,): by how much each cable's length fails to close where that cannot be the robot's, else zero; from
    first_s, the end of the first visit, to last_s, the beginning of the last. notes: for the reader."""

    steps: tuple[Step, ...]
    closure_mm: FloatArray
    first_s: float = 0.0
    last_s: float = 0.0
    notes: tuple[Message, ...] = ()
    doubts: Doubts = NONE  # Channels that stepped while the robot moved, or stalled: not used at all
    unseen: Message | None = None  # Steps that the run would not have shown
    returned_mm: FloatArray = field(default_factory=lambda: np.empty((0, 0)))
    """(k, m) changes of length at the positions to which the robot came back."""
    return_mm: FloatArray = field(default_factory=lambda: np.empty(0))
    """(m,) difference of two visits from which a single channel does not close."""
    lost_mm: FloatArray = field(default_factory=lambda: np.empty(0))
    """(m,) length from which lost counts of a single channel show, by all visits."""
    reversals: Reversals | None = None  # Evidence of paths that were followed forth and back

    @property
    def sound(self) -> bool:
        """Return whether the counts are trusted."""
        return not self.steps and not self.closure_mm.any() and not self.late_s.any()

    @property
    def late_s(self) -> FloatArray:
        """(m,) lateness of a single channel that paths forth and back show [s], 0 of all others."""
        if self.reversals is None:
            return np.zeros(len(self.closure_mm))
        effect = self.reversals.effect_mm
        return np.where(_alone(effect) & (effect > CLOSED_MM), self.reversals.late_s, 0.0)

    @property
    def least_late_s(self) -> float:
        """The smallest lateness of any single channel that these paths would show [s]; infinite without them."""
        if self.reversals is None:
            return np.inf
        effect = np.where(self.late_s != 0.0, 0.0, self.reversals.effect_mm)
        return float((np.maximum(CLOSED_MM, ALONE * _others(effect)) / np.maximum(self.reversals.speed_mm_s, 1e-9)).max())

    def closure_lengths(self, time_s: FloatArray) -> FloatArray:
        """(n, m, K) errors of the lengths [mm] at times (n,) per variable of unit variance that the run shares. All that does not close was
        lost at once, at a moment that is uniform over the run: then the product of the errors at two times, not taken off, has the mean
        closure^2 min(f, g), f and g the parts of the run that are over. That is Brownian motion, whose series (Karhunen-Loeve) is cut off
        and brought back to the variance at each time."""
        lost = np.flatnonzero(self.closure_mm)
        over = np.clip((time_s - self.first_s) / max(self.last_s - self.first_s, 1e-9), 0.0, 1.0)
        frequency = np.pi * (np.arange(TERMS) + 0.5)
        series = np.sqrt(2.0) * np.sin(over[:, None] * frequency) / frequency
        variance = np.maximum((series**2).sum(axis=1, keepdims=True), 1e-300)
        series *= np.sqrt(over[:, None] / variance)
        out = np.zeros((len(time_s), len(self.closure_mm), len(lost) * TERMS))
        for k, j in enumerate(lost):
            out[:, j, k * TERMS : (k + 1) * TERMS] = self.closure_mm[j] * series
        return out

    def late_lengths(self, speed_mm_s: FloatArray) -> FloatArray:
        """(n, m, K) errors of the lengths [mm] at speeds (n, m) by channels that are late, a variable of unit variance each."""
        late, m = np.flatnonzero(self.late_s), len(self.closure_mm)
        return np.where(np.arange(m)[:, None] == late, speed_mm_s[:, :m, None] * self.late_s[late], 0.0)

    def causes(self, time_s: FloatArray, unused: BoolArray) -> list[tuple[BoolArray, Message]]:
        """Return the samples of n at times (n,) with suspected counts, and the reason; unused (n, m): omitted cables."""
        return [((time_s > step.after_s) & ~unused[:, step.cable], message(SUSPECTED, step=step.said)) for step in self.steps]


class EvidenceFinder:
    """Collects the evidence of a run whose lengths are given in pieces."""

    def __init__(self, rig: Rig, recorded: tuple[Recorded, ...] = ()) -> None:
        self._rig, self._recorded = rig, recorded
        self._mm = np.array([rig.point(c.from_point).drum.count_length_mm for c in rig.cable])
        self._finder, self._continuity = RestFinder(), ContinuityFinder(rig)
        # channels of several passes share a motion only up to the robot's repeatability
        self._reversals = ReversalFinder() if rig.passes == 1 else None

    def add(self, lengths: Lengths) -> None:
        """Take the next piece into account."""
        lengths = lengths.of_cables()
        assert lengths.gone_on is not None
        self._finder.add(lengths.time_s, lengths.gone_on * self._mm)
        if self._reversals is not None:
            self._reversals.add(lengths.time_s, lengths.change_mm)
        self._continuity.add(lengths)

    def found(self) -> Evidence:
        """All that the run determined."""
        rests, continuity = self._finder.rests(), self._continuity.found()
        doubts = doubts_of(self._rig, continuity, rests)
        evidence = evidence_of(self._rig, rests, self._recorded, doubts)
        reversals = None if self._reversals is None else self._reversals.found()
        evidence = replace(evidence, doubts=doubts, unseen=unseen_steps(self._rig, continuity), reversals=reversals)
        effect = np.zeros(0) if reversals is None else reversals.effect_mm
        late = [(self._rig.cable[j].channel, 1e3 * float(s), float(effect[j])) for j, s in enumerate(evidence.late_s) if s]
        return replace(evidence, notes=(*evidence.notes, *(message("counts.late", channel=c, ms=ms, mm=mm) for c, ms, mm in late)))


def evidence_of(rig: Rig, rests: Rests, recorded: tuple[Recorded, ...] = (), doubts: Doubts = NONE) -> Evidence:
    """Return the evidence of a run's rests on the rig's counters, beside the recorded closures. The values of a channel in doubt are no
    lengths: its steps and closures are not reported."""
    drums = [rig.point(c.from_point).drum for c in rig.cable]
    per_mm = np.array([d.count_sign * d.scale / d.count_length_mm for d in drums])
    count_mm = 1.0 / np.abs(per_mm)
    steps = tuple(
        Step(j, (c := rig.cable[j]).name, c.channel, float(rests.end_s[i]), float(rests.begin_s[k]), by * float(per_mm[j]), by)
        for j, i, k, by in _steps(rests, count_mm)
        if not doubts.about(j, float(rests.begin_s[k]))
    )
    notes = [message("counts.suspected.note", step=step.said) for step in steps]
    limit = np.maximum(np.maximum(CLOSED_COUNTS * count_mm, CLOSED_MM), CLOSED_SCATTERS * np.sqrt(2.0) * _scatter(rests, steps))
    whole = (float(rests.begin_s[0]), float(rests.end_s[-1])) if len(rests) else (0.0, 0.0)
    back = [(_without(steps, difference, between), between) for difference, between in _returns(rests)]
    back += [(_without(steps, _recorded(rig, entry, per_mm), whole), whole) for entry in recorded if entry.closure_counts]
    closure, span, moved = np.zeros(len(drums)), whole, np.zeros((0, len(drums)))
    for difference, between in back:
        believed = np.array([not doubts.about(j, between[1]) for j in range(len(drums))])
        lost = (np.abs(difference) > np.maximum(limit, np.abs(closure))) & _alone(difference) & believed
        if lost.any():
            closure, span = np.where(lost, difference, closure), between
        moved = np.vstack([moved, np.where(_alone(difference) & believed, difference, 0.0)])
    # an even loss is within the scatter of single visits, but not within that of all
    slow, u_slow = _slow_loss(rests, steps)
    slow_limit = np.maximum(np.maximum(CLOSED_COUNTS * count_mm, CLOSED_MM), CLOSED_SCATTERS * u_slow)
    believed = np.array([not doubts.about(j, whole[1]) for j in range(len(drums))])
    lost = (np.abs(slow) > np.maximum(slow_limit, np.abs(closure))) & _alone(slow) & believed
    if lost.any():
        closure, span = np.where(lost, slow, closure), whole
    for j in np.flatnonzero(closure):
        by = {"counts": float(closure[j] * per_mm[j]), "mm": float(closure[j])}
        notes.append(message("counts.not_closed", channel=rig.cable[j].channel, **by))
        if np.ptp(moved[:, j]) > 2.0 * limit[j]:
            notes.append(message("counts.moved_point", point=rig.cable[j].from_point, least=moved[:, j].min(), most=moved[:, j].max()))
    several = np.flatnonzero((np.abs(back[0][0]) > limit) & (closure == 0.0)) if _returns(rests) and not doubts.every else ()
    if len(several) > 1:
        determined = ", ".join(f"{rig.cable[j].channel} {back[0][0][j] * per_mm[j]:+.1f}" for j in several)
        notes.append(message("counts.not_closed.several", channels=determined))
    by_returns = _shown_from(limit, [difference for difference, _ in back])
    lost_mm = np.minimum(by_returns, _shown_from(slow_limit, [slow]))
    returned = _returned(rests, recorded)
    return Evidence(steps, closure, *span, tuple(notes), returned_mm=returned, return_mm=by_returns, lost_mm=lost_mm)


def _shown_from(limit: FloatArray, differences: list[FloatArray]) -> FloatArray:
    """(m,) sizes from which a difference of visits shows in a single channel, beside those of the other channels (m,)."""
    calm = [_others(np.where(_alone(d), 0.0, d)) for d in differences]
    return np.maximum(limit, ALONE * np.max(calm, axis=0, initial=0.0))


def _returned(rests: Rests, recorded: tuple[Recorded, ...]) -> FloatArray:
    """(k, m) changes of length at positions that were visited again, the start included where a recorder saw that counts close."""
    places = rests.places()
    again = [np.flatnonzero(places == place)[0] for place in np.unique(places) if (places == place).sum() > 1][:MOST_RETURNS]
    begun = any(entry.closure_counts for entry in recorded) and not again
    return np.concatenate([rests.length_mm[again], np.zeros((int(begun), rests.length_mm.shape[1]))])


def _recorded(rig: Rig, entry: Recorded, per_mm: FloatArray) -> FloatArray:
    """Return (m,) closures of a pass by the recorder [mm], zero for cables of other passes."""
    counts = [entry.closure_counts.get(c.channel, 0.0) if entry.passage == c.passage else 0.0 for c in rig.cable]
    return np.asarray(np.array(counts) / per_mm)


def _without(steps: tuple[Step, ...], difference: FloatArray, between: tuple[float, float]) -> FloatArray:
    """A difference of lengths (m,) minus the steps between its times."""
    out = difference.copy()
    for step in steps:
        if between[0] <= step.after_s and step.before_s <= between[1]:
            out[step.cable] -= step.length_mm
    return out


def _returns(rests: Rests) -> list[tuple[FloatArray, tuple[float, float]]]:
    """Return for each position with several visits, in order of first rests: the lengths (m,) at the last visit minus those at the first,
    and the times between which the robot was away."""
    places, out = rests.places(), []
    for place in np.unique(places):
        first, last = np.flatnonzero(places == place)[[0, -1]]
        if last > first:
            out.append((rests.length_mm[last] - rests.length_mm[first], (float(rests.end_s[first]), float(rests.begin_s[last]))))
    return out


def _alone(sizes: FloatArray) -> BoolArray:
    """(m,) which of m channels is ALONE times as large as the others together (root mean square); none can be determined of few."""
    return (np.abs(sizes) > ALONE * _others(sizes)) & (len(sizes) >= LEAST_CABLES)


def _others(sizes: FloatArray) -> FloatArray:
    """(m,) root mean square of the other channels' sizes."""
    return np.sqrt(np.maximum((sizes**2).sum() - sizes**2, 0.0) / max(len(sizes) - 1, 1))


def _slow_loss(rests: Rests, steps: tuple[Step, ...]) -> tuple[FloatArray, FloatArray]:
    """(m,) changes of length [mm] from the first rest to the last one, in proportion to time, by the differences of visits of one position,
    and their standard uncertainties; infinite where there are too few visits."""
    m = rests.length_mm.shape[1]
    none = np.zeros(m), np.full(m, np.inf)
    if not len(rests):
        return none
    places = rests.places()
    r, freedom = _within(_without_steps(rests, steps), places)
    t = _within(rests.begin_s[:, None], places)[0][:, 0]
    if freedom < TRENDED or not t.any():
        return none
    slope = t @ r / (t @ t)
    each = ((r - t[:, None] * slope) ** 2).sum(axis=0) / (freedom - 1)
    whole = rests.begin_s[-1] - rests.end_s[0]
    return slope * whole, whole * np.sqrt(np.maximum(each, each.mean()) / (t @ t))


def _without_steps(rests: Rests, steps: tuple[Step, ...]) -> FloatArray:
    """(N, m) lengths of the rests without the suspected steps."""
    values = rests.length_mm.copy()
    for step in steps:
        values[rests.begin_s >= step.before_s, step.cable] -= step.length_mm
    return values


def _scatter(rests: Rests, steps: tuple[Step, ...]) -> FloatArray:
    """Return (m,) standard deviations [mm] of single visits without the suspected steps, from the changes between visits of a position,
    which a slow drift hardly affects; zero with too few visits."""
    values = _without_steps(rests, steps)
    places = rests.places()
    changes = np.concatenate([np.diff(values[places == place], axis=0) for place in np.unique(places)] or [values])
    if len(changes) < DETERMINED:
        return np.zeros(values.shape[1])
    each = np.sqrt(np.mean(changes**2, axis=0) / 2.0)
    return np.asarray(np.maximum(each, np.sqrt(np.mean(each**2))))


def _within(values: FloatArray, places: IntArray) -> tuple[FloatArray, int]:
    """(N, m) values minus the means of their places, and the degrees of freedom they have."""
    if not len(values):
        return values, 0
    number = np.bincount(places)
    means = np.array([np.bincount(places, column) for column in values.T]).T / np.maximum(number, 1)[:, None]
    return values - means[places], int((number - 1).clip(0).sum())


def _steps(rests: Rests, count_mm: FloatArray) -> list[tuple[int, int, int, float]]:
    """Cable, last rest before and first rest behind, and size [mm] of every step that is significant, in order of time."""
    places = rests.places()
    again = np.flatnonzero(np.bincount(places)[places] > 1)
    values, labels = rests.length_mm[again].copy(), places[again]
    m = values.shape[1]
    found: list[tuple[int, int, int, float]] = []
    if m < LEAST_CABLES:
        return found
    while len(found) < MOST_STEPS:
        step = _step(values, labels, rests.begin_s[again], count_mm)
        if step is None:
            break
        j, k, by = step
        values[k:, j] -= by
        found.append((j, int(again[k - 1]), int(again[k]), by))
    return sorted(found, key=lambda step: step[1])


def _step(values: FloatArray, labels: IntArray, time_s: FloatArray, count_mm: FloatArray) -> tuple[int, int, float] | None:
    """The most significant step of values (N, m) at places (N,): its column, the first row behind it and its size; None without one."""
    r, freedom = _within(values, labels)
    n, m = r.shape
    if freedom < 2:
        return None
    drift = _within(time_s[:, None], labels)[0][:, 0]
    drift = drift / max(float(np.linalg.norm(drift)), 1e-300) if freedom >= TRENDED and np.ptp(drift) > 0.0 else np.zeros(n)
    freedom -= int(drift.any())
    r = r - drift[:, None] * (drift @ r)
    # a step before row k, k = 1 .. n - 1: its part beside positions and drift, and its fit in every channel
    behind, length = np.cumsum(r[::-1], axis=0)[::-1][1:], _squares(labels) - np.cumsum(drift[::-1])[::-1][1:] ** 2
    usable = length > 1e-9
    if not usable.any():
        return None
    length = np.where(usable, length, np.inf)
    size, squares = behind / length[:, None], (r**2).sum(axis=0)
    left = squares - behind**2 / length[:, None]
    # the other channels have no step: all they scatter by counts; a channel that scatters more than they do counts for itself
    pooled = (squares.sum() - squares + left) / (m * freedom - 1)
    variance = np.maximum(pooled, left / (freedom - 1)) if freedom > 4 else pooled
    scatter = np.sqrt(np.maximum(variance, count_mm**2 / 12.0))
    t = np.where(usable[:, None], np.abs(size) * np.sqrt(np.where(usable, length, 0.0))[:, None] / scatter, 0.0)
    k, j = (int(i) for i in np.unravel_index(int(np.argmax(t)), t.shape))
    # six lengths of a robot's three or six ways to be off: counted as if half of them were independent
    p = 2.0 * float(scipy.special.stdtr(max(0.5 * m * freedom - 1.0, 1.0), -t[k, j])) * m * int(usable.sum())
    by = float(size[k, j])
    enough = abs(by) >= max(LEAST_COUNTS * count_mm[j], SCATTERS * scatter[k, j]) and _alone(size[k])[j]
    if p >= SIGNIFICANCE or not enough or not _at_once(values[:, j], labels, k + 1) / by >= AT_ONCE:
        return None
    return j, k + 1, by


def _squares(labels: IntArray) -> FloatArray:
    """(N - 1,) squared length of a step before row 1, 2 .. of rows at places (N,), their places' means taken off."""
    behind = np.bincount(labels)
    number = np.maximum(behind, 1)
    out = np.empty(len(labels) - 1)
    total = float((behind - behind**2 / number).sum())
    for k, place in enumerate(labels[:-1]):
        before = behind[place] - behind[place] ** 2 / number[place]
        behind[place] -= 1
        total += behind[place] - behind[place] ** 2 / number[place] - before
        out[k] = total
    return out


def _at_once(values: FloatArray, labels: IntArray, k: int) -> float:
    """Return the change of values (N,) at row k: the mean, over the positions (N,) visited on both sides, of the first value behind it
    minus the last before it, beyond the mean change between visits next to that."""
    changes = []
    for place in np.unique(labels[k:]):
        visits = np.flatnonzero(labels == place)
        behind = int(np.searchsorted(visits, k))
        if not 0 < behind < len(visits):
            continue
        near = np.diff(values[visits[max(behind - 2, 0) : behind + 2]])
        here = min(behind, 2) - 1
        others = np.delete(near, here)
        changes.append(near[here] - (others.mean() if len(others) else 0.0))
    return float(np.mean(changes))
