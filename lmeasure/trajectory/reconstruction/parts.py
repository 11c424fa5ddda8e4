"""A long run over the workers of a cluster: each part by itself, with the bits of the whole.

A part depends on the run before it in three ways only: the state of the counters, the pose, and the cables' direction of travel. This
process goes through the run once for results of the whole (rests, steps, origins) and once for those, which is about half of the work.
Workers do the rest, part by part, as soon as a beginning is known; none of them holds more than a few pieces.
"""

import pickle
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from lmeasure.core import FloatArray, TrajectoryError
from lmeasure.io import PIECE_ROWS, in_order
from lmeasure.recording import RunHead
from lmeasure.sensors import Lengths
from lmeasure.text import message
from lmeasure.trajectory.files.trajectory import Summary
from lmeasure.trajectory.files.write import trajectory_writer
from lmeasure.trajectory.reconstruction.runs import Judge, Progress, StreamedRun, covered, prepare, with_evidence
from lmeasure.trajectory.reconstruction.screw_method import Place, Reconstruction

PIECES = 64  # Pieces of `PIECE_ROWS` samples in a part: about a million samples


@dataclass(frozen=True)
class Part:
    """A part of a run: its number, the first sample and where it begins, and how many pieces it has."""

    run: StreamedRun
    reconstruction: Reconstruction
    out: Path
    angles: str | None
    number: int
    counters: FloatArray
    place: Place
    pieces: int

    @property
    def first(self) -> int:
        """Number of its first sample in the run."""
        return self.number * self.pieces * PIECE_ROWS


def reconstruct_in_parts(
    head: RunHead,
    out: Path,
    scheduler: str,
    constraint: str | None = None,
    *,
    angles: str | None = None,
    progress: Progress | None = None,
    judge: Judge | None = None,
    pieces: int = PIECES,
) -> Summary:
    """Reconstruct a run for which `can_stream` holds into the files part-00000.parquet, ... of a folder that all workers reach.

    Rows and bits are those of `reconstruct_stream`; pieces: in each part. Raises its errors, and LMeasureError for the scheduler.
    """
    if head.counts[0].suffix.lower() != ".parquet":
        raise TrajectoryError(message("error.parts_need_parquet", where=head.counts[0]))
    run = StreamedRun.of(head)
    reconstruction = prepare(run, constraint)
    summary, notes = Summary(), () if judge is None else judge(reconstruction)
    # bytes of our own: arrays that come over the wire are read-only, for which kernels would be compiled once more
    packed: Any = import_module("cloudpickle")
    begun = _beginnings(run, reconstruction, pieces, progress)
    tasks = (packed.dumps(Part(run, reconstruction, out, angles, *begin, pieces)) for begin in begun)
    for part in in_order(scheduler, work_on_part, tasks):
        summary.join(part)
    for unfinished in out.glob(".part-*.parquet"):  # of workers that died
        unfinished.unlink(missing_ok=True)
    summary.notes += [note for note in notes if note not in summary.notes]
    return summary


def _beginnings(
    run: StreamedRun, reconstruction: Reconstruction, pieces: int, progress: Progress | None
) -> Iterator[tuple[int, FloatArray, Place]]:
    """Yield the number of each part, with the counters and the place at its beginning."""
    counters, place = run.counters.copy(), reconstruction.beginning
    begun = 0, counters.copy(), place.copy()
    yield begun
    for number, (_, lengths) in enumerate(run.recorded_pieces(reconstruction.doubts, progress, counters=counters)):
        # counters are those behind this piece, so those before it were kept
        if number and number % pieces == 0:
            yield begun
        reconstruction.follow(lengths, place)
        begun = (number + 1) // pieces, counters.copy(), place.copy()


def work_on_part(packed: bytes) -> Summary:
    """Reconstruct a part, write its file, whole or not at all, and return its summary."""
    part: Part = pickle.loads(packed)
    run, reconstruction, summary = part.run, part.reconstruction, Summary(part.first)
    covers = covered(reconstruction.budget.covers, run.evidence)
    kept: list[Lengths] = []

    def lengths() -> Iterator[Lengths]:
        found = run.recorded_pieces(reconstruction.doubts, first=part.first, counters=part.counters.copy())
        for _, (_, one) in zip(range(part.pieces), found, strict=False):
            kept.append(one)
            yield one

    with trajectory_writer(part.out / f"part-{part.number:05}.parquet", covers, part.angles) as write:
        for trajectory in reconstruction.trajectories(lengths(), place=part.place):
            whole = with_evidence(reconstruction, trajectory, kept.pop(), run, covariances=True)
            write(whole)
            summary.add(whole)
    return summary
