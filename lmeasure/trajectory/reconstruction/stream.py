"""Reconstruction from file to file in bounded memory: a log of ten hours goes through a few pieces at a time."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.kernels import BELIEVED_AT
from lmeasure.recording import Counts, RateEvidence, Run, RunHead, WidthEvidence, read_counts_in_pieces
from lmeasure.rig import Rig
from lmeasure.sensors import COUNTER_STATE, Lengths, lengths_from_counts, rate_notes
from lmeasure.text import Message, message
from lmeasure.trajectory.faults.doubts import Doubts
from lmeasure.trajectory.faults.rest_evidence import Evidence, EvidenceFinder
from lmeasure.trajectory.files.trajectory import Summary, Trajectory
from lmeasure.trajectory.files.write import trajectory_writer
from lmeasure.trajectory.reconstruction.preparation import prepare
from lmeasure.trajectory.reconstruction.runs import Judge, covered, with_evidence

Progress = Callable[[int, int], None]
SURE_S = 86400.0
"""A counter that no rate takes through half its range for as long is asked for nothing."""
Each = Callable[[Counts, Lengths, Trajectory], None]
"""What is done with a piece of a run: its recorded counts, its lengths and its part of the trajectory."""


def can_stream(head: RunHead) -> bool:
    """Whether the run can go through in pieces: one pass, a recording that was closed properly, no limit that asks for later samples."""
    limited = any(point.drum.max_cable_acceleration_mm_s2 is not None for point in head.rig.observation_point)
    return head.rig.passes == 1 and not head.torn[0] and not limited


def reconstruct_stream(
    head: RunHead,
    out: Path,
    constraint: str | None = None,
    angles: str | None = None,
    *,
    progress: Progress | None = None,
    each: Each | None = None,
    judge: Judge | None = None,
) -> Summary:
    """Reconstruct a run for which `can_stream` holds and write its trajectory as `trajectory_writer` does.

    The result is that of `reconstruct`, whose judge is this; progress is told (done, of), each piece is given to `each` and then let go.
    Raises what `Reconstruction` raises, and FileFormatError for counts that cannot be read.
    """
    rig, notes = _with_widths(head)
    fresh, told = _counters(head, rig)
    notes += told
    counters = fresh.copy()
    summary = Summary()
    evidence = _evidence(head, rig, fresh.copy())
    pieces = partial(_pieces, head, rig, fresh)
    reconstruction, doubts = prepare(head, rig, pieces, doubts=evidence.doubts, source=str(head.counts[0]), constraint=constraint)
    evidence = replace(evidence, doubts=doubts)
    more = () if judge is None else judge(reconstruction)
    with trajectory_writer(out, covered(reconstruction.covers, evidence), angles) as write:
        for piece in read_counts_in_pieces(head.counts[0], progress):
            lengths = evidence.doubts.applied(rig, lengths_from_counts(Run(rig, head.start, (piece,)), counters))
            lengths = replace(lengths, notes=(*notes, *lengths.notes))
            trajectory = reconstruction.add(lengths)
            trajectory = with_evidence(reconstruction, trajectory, lengths, evidence, run=head, covariances=True)
            write(trajectory)
            trajectory = replace(trajectory, notes=(*trajectory.notes, *more))
            summary.add(trajectory)
            if each is not None:
                each(piece, lengths, trajectory)
    return summary


def _evidence(head: RunHead, rig: Rig, counters: FloatArray) -> Evidence:
    """What the whole run tells of its counters: a step may show only at the end of the file."""
    finder = EvidenceFinder(rig, head.recorded)
    for piece in read_counts_in_pieces(head.counts[0]):
        finder.add(lengths_from_counts(Run(rig, head.start, (piece,)), counters))
    return finder.found()


def _pieces(head: RunHead, rig: Rig, fresh: FloatArray, doubts: Doubts) -> Iterator[Lengths]:
    """Lengths of one piece after the other, without what is in these doubts."""
    counters = fresh.copy()
    for piece in read_counts_in_pieces(head.counts[0]):
        yield doubts.applied(rig, lengths_from_counts(Run(rig, head.start, (piece,)), counters))


def _counters(head: RunHead, rig: Rig) -> tuple[FloatArray, list[Message]]:
    """(m, `COUNTER_STATE`) counters at the beginning of the file, with what the whole of it tells of their rates where that is asked."""
    fresh, asked, believed = np.zeros((len(rig.observed), COUNTER_STATE)), {}, {}
    for j, c in enumerate(rig.observed):
        counter = rig.counter(c)
        full = 0.0 if counter.counter_bits is None else 2.0**counter.counter_bits
        if not counter.rate_stated and 0.0 < full / 2.0 < SURE_S * counter.rate:
            asked[j] = RateEvidence(counter.rate, full)
    for piece in read_counts_in_pieces(head.counts[0]) if asked else ():
        for j, seen in asked.items():
            seen.add(piece.of(rig.observed[j].channel), piece.time_s)
    for j, seen in asked.items():
        fresh[j, BELIEVED_AT] = seen.believed()
        if fresh[j, BELIEVED_AT]:
            c = rig.observed[j]
            believed[c.channel] = rig.counter(c), float(fresh[j, BELIEVED_AT])
    return fresh, rate_notes(str(head.counts[0]), believed)


def _with_widths(head: RunHead) -> tuple[Rig, list[Message]]:
    """The rig with the counter widths that the whole file shows, where it states none."""
    unknown = {c.channel: c for c in head.rig.cable if head.rig.point(c.from_point).drum.counter_bits is None}
    if not unknown:
        return head.rig, []
    evidence = {name: WidthEvidence(head.rig.counter(c).rate) for name, c in unknown.items()}
    for piece in read_counts_in_pieces(head.counts[0]):
        for name, seen in evidence.items():
            seen.add(piece.of(name), piece.time_s)
    bits = {unknown[name].from_point: (name, seen.bits()) for name, seen in evidence.items()}
    points, notes = [], []
    for point in head.rig.observation_point:
        channel, width = bits.get(point.name, ("", None))
        if width is not None:
            notes.append(message("counts.bits", source=str(head.counts[0]), channel=channel, bits=int(width)))
            point = point.model_copy(update={"drum": point.drum.model_copy(update={"counter_bits": width})})
        points.append(point)
    return head.rig.model_copy(update={"observation_point": tuple(points)}), notes
