"""A run as a whole: its passes brought together, reconstructed, and its uncertainties by the law that is asked for."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from lmeasure.core import Status
from lmeasure.kernels import KIND
from lmeasure.recording import Run, RunHead, notes_of
from lmeasure.sensors import Lengths
from lmeasure.text import Message, and_also, message
from lmeasure.trajectory.faults.rest_evidence import Evidence
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.reconstruction.monte_carlo import by_monte_carlo
from lmeasure.trajectory.reconstruction.preparation import prepared
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction
from lmeasure.trajectory.time.passes import Alignment, align
from lmeasure.trajectory.uncertainty.budget import CHUNK
from lmeasure.trajectory.uncertainty.run_covariances import closure_factors, left_out

Judge = Callable[[Reconstruction], tuple[Message, ...]]


def reconstruct(
    run: Run | Alignment,
    constraint: str | None = None,
    repeatability_mm: float = 0.0,
    trials: int = 0,
    *,
    seed: int = 0,
    progress: Callable[[int, int], None] | None = None,
    covariances: bool = True,
    judge: Judge | None = None,
) -> Trajectory:
    """The trajectory of a run, its cables counted in one pass or several; a constraint replaces the rig's.

    repeatability_mm: standard deviation, per axis, of the place to which the robot brings the tool in repeated passes. trials: of Monte
    Carlo instead of the linear law for the uncertainties, 0 for none; see `monte_carlo.by_monte_carlo`. covariances: False leaves those
    of a single pass at zero, for a reader who works them out only where he needs them: who aligns the run (`passes.align`) and gives
    both of them that has its lengths worked out once. judge: what more is to be said of the run, once it is prepared.
    Raises what `Reconstruction` and `passes.align` raise.
    """
    aligned = align(run)
    run = aligned.run
    reconstruction, doubts = prepared(aligned, constraint, repeatability_mm)
    said = () if judge is None else judge(reconstruction)
    covariances = covariances or run.rig.passes > 1 or trials > 0
    evidence = replace(aligned.evidence, doubts=doubts)
    lengths = aligned.lengths if doubts is aligned.evidence.doubts else aligned.without(doubts)
    trajectory = reconstruction.add(lengths, covariances=covariances)
    if trials:
        trajectory = by_monte_carlo(reconstruction, lengths, trajectory, trials, seed=seed, progress=progress)
    trajectory = with_evidence(reconstruction, trajectory, lengths, evidence, run=run, covariances=covariances)
    notes = (*trajectory.notes, *said, *aligned.notes)
    if run.rig.passes > 1 and repeatability_mm == 0.0:
        notes = (*notes, message("passes.repeatability"))
    return replace(trajectory, time_s=aligned.stamp_s, notes=notes)


def with_evidence(
    reconstruction: Reconstruction, trajectory: Trajectory, lengths: Lengths, evidence: Evidence, *, run: Run | RunHead, covariances: bool
) -> Trajectory:
    """A piece of a run's trajectory with what the run tells of its own counts: notes, causes of `ok` samples that hang on counts that are
    suspected, and what does not close in the systematic covariances."""
    unseen = () if evidence.unseen is None else (evidence.unseen,)
    said = (*evidence.doubts.notes, *evidence.notes, *unseen, said_of_redundancy(reconstruction), *reconstruction.reliability)
    trajectory = replace(trajectory, notes=(*trajectory.notes, *notes_of(run.recorded), *said))
    if evidence.sound:
        return trajectory
    unused, ok = left_out(trajectory, lengths.cables), trajectory.status == Status.OK
    cause = trajectory.cause.copy()
    for mask, why in evidence.causes(trajectory.time_s, unused):
        cause[ok & mask] = and_also(cause[ok & mask], why)
    trajectory = replace(trajectory, cause=cause)
    if not covariances or not evidence.closure_mm.any():
        return trajectory
    systematic, poses = trajectory.systematic.copy(), trajectory.poses
    if reconstruction.scheme.point is not None:
        poses = np.where(np.isnan(poses) & ~np.isnan(poses[:, :1]), [0.0] * 6 + [1.0], poses)
    for begin in range(0, len(systematic), CHUNK):
        i = slice(begin, begin + CHUNK)
        factors = closure_factors(
            reconstruction.budget, evidence, trajectory.time_s[i], poses[i], counts=lengths.counts[i], unused=unused[i]
        )
        systematic[i] += factors @ np.swapaxes(factors, 1, 2)
    return replace(trajectory, systematic=systematic, covers=covered(trajectory.covers, evidence))


def said_of_redundancy(reconstruction: Reconstruction) -> Message:
    """What the number of cables lets a run tell of its own faults."""
    scheme = reconstruction.scheme
    of: dict[str, int] = {"cables": len(scheme.rows), "unknowns": len(scheme.free)}
    channels = ".channels" if scheme.rows[:, KIND].any() else ""
    if scheme.redundancy == 0:
        return message(f"redundancy.none{channels}", **of)
    if scheme.redundancy == 1:
        return message(f"redundancy.one{channels}", **of)
    return message(f"redundancy.more{channels}", spare=scheme.redundancy, **of)


def covered(covers: str, evidence: Evidence) -> str:
    """What the standard uncertainties hold, in words, with what does not close."""
    return f"{covers}; and what does not close in the counts" if evidence.closure_mm.any() else covers
