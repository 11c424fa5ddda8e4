"""A run made ready to be reconstructed: where it begins, what its channels count from, which of them are in doubt."""

from collections.abc import Callable, Iterable
from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray, Status
from lmeasure.recording import Run, RunHead
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths, channel_message
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.consistency import IN_TIME, collected, consistent
from lmeasure.trajectory.faults.doubts import EVERY, Doubt, Doubts, Shift
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.faults.reliability import of_run, said, said_apart
from lmeasure.trajectory.origin.origins import Slip, learn, moved, slip
from lmeasure.trajectory.origin.start import find_start, motion_of, zeros_by_motion
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.time.passes import Alignment
from lmeasure.trajectory.uncertainty.sources import ANYWHERE, LIGHT_RAD, UNKNOWN_MM, PassClock, Told, needed_zero, zeros_of

STEPPED = "origin.stepped"
RESTORED = ("origin.restored.length", "origin.restored.angle")
UNTOLD = "origin.untold"
"""Of a channel whose new origin the run does not tell."""
HARDLY = 0.5
"""Of what was supposed of an origin before the run: what is known no better was not told by it."""
OF_NOBODY = frozenset({*(IN_TIME[code] for code in IN_TIME if code.startswith("contradiction")), "rig.uncalibrated", "passes.not_repeated"})
LEFT_OUT = (IN_TIME["cable.left_out"], IN_TIME["cable.left_out.unknown"])
SLIPS = 8
"""Found one after the other."""

Pieces = Callable[[Doubts], Iterable[Lengths]]
"""The lengths of a run, one piece after the other, without what is in these doubts."""


def prepare(
    run: Run | RunHead,
    rig: Rig,
    pieces: Pieces,
    *,
    doubts: Doubts,
    source: str,
    constraint: str | None = None,
    clocks: tuple[PassClock, ...] = (),
    repeatability_mm: float = 0.0,
) -> tuple[Reconstruction, Doubts]:
    """The reconstruction of a run, not yet begun, with the origins of its channels as its redundancy tells them, and what is in doubt of
    it; doubts: what is before that.

    Raises what `Reconstruction` and `find_start` raise.
    """

    def made(start: FloatArray, begun: FloatArray | None = None, zeros: FloatArray | None = None) -> Reconstruction:
        u_start = run.u_start if begun is None else (0.0, 0.0)
        reconstruction = Reconstruction(
            rig,
            start,
            run.calibration,
            constraint,
            u_start=u_start,
            clocks=clocks,
            repeatability_mm=repeatability_mm,
            temperature_c=run.temperature_c,
            begun=begun,
        )
        if begun is None and needed_zero(zeros_of(rig, run.calibration), len(reconstruction.scheme.free)) > LIGHT_RAD:
            # the poses that such zeros leave lie too far off for first order: where the motion puts them it begins
            at = motion_of(rig, reconstruction.corrected(next(iter(pieces(doubts)))), record=run.calibration)
            zeros = zeros_by_motion(at, reconstruction.start, np.repeat([u_start[1], u_start[0]], 3))
        if zeros is not None and reconstruction.scheme.redundancy:
            reconstruction.budget.suppose(zeros)
        return reconstruction

    def tried(start: FloatArray, begun: FloatArray, zeros: FloatArray | None) -> tuple[Reconstruction, Epochs | None]:
        reconstruction = made(start, begun, zeros)
        return reconstruction, None if reconstruction.redundancy is None else collected(reconstruction, pieces(doubts))[0]

    given = run.start
    reconstruction = find_start(rig, next(iter(pieces(doubts))), source, tried) if given is None else made(given)
    found = consistent(reconstruction, pieces(doubts), doubts)
    if reconstruction.redundancy is None:
        return reconstruction, found
    reconstruction.use(None)
    found = _moved(reconstruction, _restored(reconstruction, found), pieces)
    for _ in range(SLIPS):
        epochs, told, found = _learned(reconstruction, found, pieces)
        # of drums alone every sample tells as much, and what calibrations have wrong would pass for slips over so many samples together
        if told is None or not reconstruction.budget.absolute.any():
            break
        # so would what a channel that hung for a while read before it was seen to
        slipped = slip(reconstruction, epochs.without(_wrong(found, reconstruction)), told)
        if slipped is None:
            break
        reconstruction.use(None)
        again = any(cable == slipped.channel for cable, _, _ in reconstruction.budget.restored)
        gradually = None
        if not (slipped.others or reconstruction.budget.absolute[slipped.channel] or again):
            others = epochs.without(_wrong(found, reconstruction))
            gradually = moved(reconstruction, others, slipped.channel, slipped.from_s)
        if gradually is None or np.isinf(gradually.after_s):
            found = _with(found, slipped, rig)
        else:
            after_s = max(slipped.after_s, gradually.after_s)
            reconstruction.budget.restore(slipped.channel, after_s)
            why = _said(slipped.channel, gradually.by, gradually.u, rig)
            found = _meanwhile(found, slipped.channel, min(slipped.from_s, gradually.from_s), after_s, why)
            found = replace(found, shifts=(*found.shifts, _shift(rig, slipped.channel, after_s, by=gradually.by)))
    if untold := _untold(reconstruction, found):
        epochs, _, found = _learned(reconstruction, replace(found, every=tuple(sorted((*found.every, *untold), key=_order))), pieces)
    if reconstruction.budget.restored:
        # what goes on must agree with the others there, which without it may have come to another assembly
        judged = _without_contradictions(found)
        after = consistent(reconstruction, pieces(judged), judged)
        if after is not found:
            epochs, _, found = _learned(reconstruction, after, pieces)
        found = replace(found, notes=(*found.notes, *_told(reconstruction, found.shifts)))
    reconstruction.shifts = found.shifts
    reliable = of_run(reconstruction, epochs)
    reconstruction.reliability = () if reliable is None else (said(reconstruction, reliable), said_apart(reconstruction, reliable))
    return reconstruction, found


def _learned(reconstruction: Reconstruction, doubts: Doubts, pieces: Pieces) -> tuple[Epochs, Told | None, Doubts]:
    """The epochs of a run, what they tell of its origins, and the doubts with the shifts of channels that go on from others."""
    while True:
        reconstruction.use(None)
        epochs = collected(reconstruction, pieces(doubts))[0]
        told = learn(reconstruction, epochs)
        known = {(s.cable, s.after_s) for s in doubts.shifts}
        new = tuple(
            _shift(reconstruction.rig, cable, after_s, until_s, by=by)
            for cable, after_s, until_s, by, _ in reconstruction.budget.restored_origins()
            if (cable, after_s) not in known
        )
        if not any(s.counts for s in new):
            return epochs, told, doubts
        doubts = replace(doubts, shifts=(*doubts.shifts, *new))


def _shift(rig: Rig, channel: int, after_s: float, until_s: float = np.inf, *, by: float) -> Shift:
    """What is taken off a channel's counts behind a time, of a length or an angle by which it reads too much."""
    return Shift(channel, after_s, until_s, float(np.rint(by / rig.counter(rig.observed[channel]).per_count)))


def _order(doubt: Doubt) -> tuple[float, int]:
    return doubt.after_s, doubt.cable


def _untold(reconstruction: Reconstruction, doubts: Doubts) -> list[Doubt]:
    """Of channels that go on from another origin which the run does not tell: they are not used behind it."""
    out = []
    for cable, after_s, until_s, _, u in reconstruction.budget.restored_origins():
        covered = any(d.cable == cable and d.after_s <= after_s and d.until_s >= until_s for d in doubts.every)
        if _is_untold(reconstruction, cable, u) and not covered:
            said = message(UNTOLD, what=_what(reconstruction, cable), after_s=after_s)
            out.append(Doubt(cable, after_s, until_s, Status.ORIGIN_LOST, said))
    return out


def _is_untold(reconstruction: Reconstruction, channel: int, u: float) -> bool:
    """Whether a standard uncertainty of a channel's new origin is hardly less than what was supposed of it."""
    return u > HARDLY * (UNKNOWN_MM if reconstruction.rig.observed[channel].is_length else ANYWHERE)


def _what(reconstruction: Reconstruction, channel: int) -> Message:
    """A channel by its kind and name."""
    o = reconstruction.rig.observed[channel]
    return channel_message(o)


def _without_contradictions(doubts: Doubts) -> Doubts:
    """The doubts without those of samples whose channels contradict each other, nobody knows which."""
    every = tuple(d for d in doubts.every if not (d.cable == EVERY and d.said.code in IN_TIME))
    if len(every) == len(doubts.every):
        return doubts
    return replace(doubts, every=every, notes=tuple(note for note in doubts.notes if note.code not in OF_NOBODY))


def _wrong(doubts: Doubts, reconstruction: Reconstruction) -> list[int]:
    """Channels that contradict the others for a while, or lost their origins, other than those that go on from a restored one."""
    restored = {cable for cable, _, _ in reconstruction.budget.restored}
    seen = (Status.INCONSISTENT, Status.ORIGIN_LOST)
    return sorted({d.cable for d in doubts.every if d.cable != EVERY and d.status in seen} - restored)


def _restored(reconstruction: Reconstruction, doubts: Doubts) -> Doubts:
    """The doubts without those of channels that stepped and count on: with more channels than unknowns the others tell from where. One
    that stands, or hangs, shows no length at all."""
    budget = reconstruction.budget
    lost = [d for d in doubts.every if d.said.code == STEPPED and d.cable != EVERY and not budget.absolute[d.cable]]
    # a channel that errs again and again is not one that slipped
    once = [d for d in lost if sum(other.cable == d.cable for other in doubts.every) == 1]
    if not once or len(once) > reconstruction.scheme.redundancy:
        return doubts
    for d in once:
        budget.restore(d.cable, d.after_s, d.until_s)
    return replace(doubts, every=tuple(d for d in doubts.every if d not in once))


def _told(reconstruction: Reconstruction, shifts: tuple[Shift, ...]) -> list[Message]:
    """What is said of restored channels in a summary."""
    out = []
    for cable, after_s, _, left, u in reconstruction.budget.restored_origins():
        o = reconstruction.rig.observed[cable]
        by = left + sum(s.counts for s in shifts if (s.cable, s.after_s) == (cable, after_s)) * reconstruction.rig.counter(o).per_count
        what = _what(reconstruction, cable)
        if _is_untold(reconstruction, cable, u):
            out.append(message(UNTOLD, what=what, after_s=after_s))
        elif o.is_length:
            out.append(message(RESTORED[0], what=what, after_s=after_s, mm=by, u_mm=u))
        else:
            out.append(message(RESTORED[1], what=what, after_s=after_s, deg=float(np.degrees(by)), u_deg=float(np.degrees(u))))
    return out


def _moved(reconstruction: Reconstruction, doubts: Doubts, pieces: Pieces) -> Doubts:
    """The doubts, without those of drums that contradicted the others and go on from another origin but for the time within which they
    came to it."""
    budget = reconstruction.budget
    restored = {cable for cable, _, _ in budget.restored}
    seen = (Status.INCONSISTENT, Status.ORIGIN_LOST)
    wrong = {d.cable for d in doubts.every if d.status in seen and d.cable != EVERY and not budget.absolute[d.cable]}
    for j in sorted(wrong - restored):
        # who else is wrong tells nothing of this one
        others = replace(doubts, every=tuple(d for d in doubts.every if d.cable != j))
        epochs = collected(reconstruction, pieces(others))[0]
        since_s = min(d.after_s for d in doubts.every if d.cable == j)
        found = moved(reconstruction, epochs.without(sorted(wrong - restored - {j})), j, since_s)
        if found is None:
            continue
        name = reconstruction.rig.observed[j].name
        if np.isinf(found.after_s):
            doubts = _since(doubts, j, name, found.from_s)
        else:
            budget.restore(j, found.after_s)
            others = replace(others, shifts=(*others.shifts, _shift(reconstruction.rig, j, found.after_s, by=found.by)))
            why = _said(j, found.by, found.u, reconstruction.rig)
            notes = tuple(note for note in doubts.notes if not (note.code in LEFT_OUT and note.values.get("cable") == name))
            doubts = _meanwhile(replace(others, notes=notes), j, found.from_s, found.after_s, why)
    return doubts


def _since(doubts: Doubts, cable: int, name: str, from_s: float) -> Doubts:
    """The doubts, the last one of a cable that is left out to the end from the time on at which it began to err."""
    last = next((d for d in doubts.every if d.cable == cable and np.isinf(d.until_s) and d.after_s > from_s), None)
    if last is None:
        return doubts
    within = [d for d in doubts.every if d.cable == cable and d.after_s >= from_s]
    every = [d for d in doubts.every if d not in within] + [replace(last, after_s=from_s)]
    notes = []
    for note in doubts.notes:
        if (
            note.code in LEFT_OUT
            and note.values["cable"] == name
            and any(note.values["begin"].values.get("s") == d.after_s for d in within)
        ):
            if note.values["end"].code != "time.end":
                continue
            note = message(note.code, **{**note.values, "begin": message("time.at", s=from_s)})
        notes.append(note)
    return replace(doubts, every=tuple(sorted(every, key=lambda d: (d.after_s, d.cable))), notes=tuple(notes))


def _meanwhile(doubts: Doubts, cable: int, from_s: float, after_s: float, said: Message) -> Doubts:
    """The doubts and one of the time within which a channel slipped, nobody knows when exactly."""
    if not after_s > from_s:
        return doubts
    new = Doubt(cable, from_s, after_s, Status.INCONSISTENT, said)
    return replace(doubts, every=tuple(sorted((*doubts.every, new), key=lambda d: (d.after_s, d.cable))))


def _said(channel: int, by: float, u: float, rig: Rig) -> Message:
    if rig.observed[channel].is_length:
        return message("slip.length", mm=by, u_mm=u)
    return message("slip.angle", deg=float(np.degrees(by)), u_deg=float(np.degrees(u)))


def _with(doubts: Doubts, slipped: Slip, rig: Rig) -> Doubts:
    """The doubts and what a slip adds: its channel is not used behind it, or no sample where others explain the readings as well."""
    observed, when = rig.observed, {"begin": message("time.at", s=slipped.from_s), "end": message("time.end")}
    if slipped.others:
        cable = EVERY
        said = message("slip.among", names=", ".join(observed[j].name for j in (slipped.channel, *slipped.others)))
        note = message("channels.contradict", **when, said=said)
    else:
        cable, o = slipped.channel, observed[slipped.channel]
        said = _said(cable, slipped.by, slipped.u, rig)
        note = message("channel.left_out", **when, what=channel_message(o), said=said)
    new = Doubt(cable, slipped.from_s, np.inf, Status.INCONSISTENT, said)
    every = tuple(sorted((*doubts.every, new), key=lambda d: (d.after_s, d.cable)))
    return replace(doubts, every=every, notes=(*doubts.notes, note))


def prepared(aligned: Alignment, constraint: str | None = None, repeatability_mm: float = 0.0) -> tuple[Reconstruction, Doubts]:
    """`prepare` of a run whose lengths are in memory."""
    run, own = aligned.run, aligned.evidence.doubts

    def pieces(doubts: Doubts) -> list[Lengths]:
        return [aligned.lengths if doubts is own else aligned.without(doubts)]

    return prepare(
        run,
        run.rig,
        pieces,
        doubts=own,
        source=run.passes[0].source,
        constraint=constraint,
        clocks=aligned.clocks,
        repeatability_mm=repeatability_mm,
    )
