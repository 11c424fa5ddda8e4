"""Covariances of a run's poses: what every sample has of its own, and what a whole run shares."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import BoolArray, FloatArray, Status, TrajectoryError
from lmeasure.recording import Run
from lmeasure.text import is_of
from lmeasure.trajectory.faults.rest_evidence import CLOSURE, Evidence
from lmeasure.trajectory.files.trajectory import NAMES, Trajectory
from lmeasure.trajectory.reconstruction.preparation import prepared
from lmeasure.trajectory.time.passes import Alignment, align
from lmeasure.trajectory.uncertainty.budget import RESTORED_ORIGIN, Budget, PoseCovariances


def covariances(
    trajectory: Trajectory,
    run: Run | Alignment,
    samples: slice | NDArray[np.intp] | BoolArray | None = None,
    *,
    constraint: str | None = None,
    repeatability_mm: float = 0.0,
) -> PoseCovariances:
    """Return how the errors of a trajectory's poses correlate.

    Parameters
    ----------
    trajectory
        Trajectory of this run; one that was read from its file will do.
    run
        The run.
    samples
        Samples of interest; by default all.
    constraint, repeatability_mm
        As `reconstruct` got them.

    Returns
    -------
    PoseCovariances
        Random errors per sample and factors of the systematic errors that all samples share [rad, mm].

    Raises
    ------
    TrajectoryError
        If the trajectory is not of this run.

    Examples
    --------
    >>> lm.covariances(trajectory, run, slice(0, 2)).factors.shape[:2]
    (2, 6)
    """
    aligned = align(run)
    run, lengths = aligned.run, aligned.lengths
    if len(aligned.stamp_s) != len(trajectory.time_s) or not np.allclose(aligned.stamp_s, trajectory.time_s, rtol=0.0, atol=1e-9):
        raise TrajectoryError(
            f"{run.passes[0].source}: has {len(lengths.time_s)} samples, the trajectory has {len(trajectory.time_s)} or at other times: "
            "it is not of this run"
        )
    reconstruction, doubts = prepared(aligned, constraint, repeatability_mm)
    if doubts is not aligned.evidence.doubts:
        # as they were used: some counts are not, and those of restored channels are
        lengths = aligned.without(doubts)
    budget, scheme = reconstruction.budget, reconstruction.scheme
    chosen = slice(None) if samples is None else samples
    speed, u_mm = budget.speed_mm_s(lengths)[chosen], None if lengths.u_mm is None else lengths.u_mm[chosen]
    poses = trajectory.poses[chosen].copy()
    if scheme.point is not None:
        # of the point alone: any orientation will do, for the rows have no arms
        known = ~np.isnan(poses[:, 0])
        poses[known, 3:] = (0.0, 0.0, 0.0, 1.0)
    warm = None if lengths.temperature_c is None else lengths.temperature_c[chosen]
    travel = budget.travel(lengths)
    travel = None if travel is None else travel[chosen]
    unused = left_out(trajectory, lengths.cables)[chosen]
    found = budget.of(
        lengths.time_s[chosen],
        poses,
        counts=lengths.counts[chosen],
        speed_mm_s=speed,
        u_mm=u_mm,
        unused=unused,
        temperature_c=warm,
        travel=travel,
    )
    if aligned.evidence.closure_mm.any():
        closing = closure_factors(budget, aligned.evidence, lengths.time_s[chosen], poses, counts=lengths.counts[chosen], unused=unused)
        sources = (*found.sources, *(CLOSURE,) * closing.shape[2])
        uniform = (*found.uniform, *(False,) * closing.shape[2])
        found = replace(found, factors=np.concatenate([found.factors, closing], axis=2), sources=sources, uniform=uniform)
    return found if scheme.point is None else without_orientation(found)


def without_orientation(found: PoseCovariances) -> PoseCovariances:
    """The same where the orientation is not measured: NaN."""
    own, factors = found.own.copy(), found.factors.copy()
    own[:, :3] = factors[:, :3] = np.nan
    return replace(found, own=own, factors=factors)


def closure_factors(
    budget: Budget, evidence: Evidence, time_s: FloatArray, poses: FloatArray, *, counts: FloatArray, unused: BoolArray
) -> FloatArray:
    """(n, 6, K) factors of (n, 7) poses at times (n,) of what does not close in the run's counts; see `Evidence.closure_lengths`."""
    G = budget.twists(np.ascontiguousarray(poses), counts, unused, compiled=True)
    lengths = evidence.closure_lengths(time_s)
    return np.asarray(G[:, :, : lengths.shape[1]] @ lengths)


def left_out(trajectory: Trajectory, cables: tuple[str, ...]) -> BoolArray:
    """(n, m) cables that `ok` samples name because they were not used."""
    out = np.zeros((len(trajectory.time_s), len(cables)), np.bool_)
    # a restored channel is named too, and used
    ok = (trajectory.status == Status.OK) & ~np.array([is_of(cause, RESTORED_ORIGIN) for cause in trajectory.cause], dtype=np.bool_)
    for names in set(trajectory.cable[ok]) - {""}:
        mask = ok & (trajectory.cable == names)
        out[np.ix_(mask, [cables.index(name) for name in names.split(NAMES) if name in cables])] = True
    return out
