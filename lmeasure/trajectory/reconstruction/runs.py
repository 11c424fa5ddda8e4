"""A run as a whole: its model and its own results for it, its trajectory in one piece or from file to file, its covariances.

A log of ten hours goes from file to file a few pieces at a time, in bounded memory.

A long run over the workers of a cluster: each part by itself, with the bits of the whole.

A part depends on the run before it in three ways only: the state of the counters, the pose, and the cables' direction of travel. This
process goes through the run once for results of the whole (rests, steps, origins) and once for those, which is about half of the work.
Workers do the rest, part by part, as soon as a beginning is known; none of them holds more than a few pieces.
"""

import itertools
import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol, Self

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import BoolArray, FloatArray, Status, TrajectoryError
from lmeasure.io import PIECE_ROWS, in_order
from lmeasure.kernels import (
    AXIAL,
    BELIEVED_AT,
    KIND,
    TANGENT,
    changes_from_counts as changes_of_rows,
    counts_from_changes,
    span_lengths,
    span_rows,
)
from lmeasure.recording import Counts, RateEvidence, Run, RunHead, WidthEvidence, notes_of, read_counts_in_pieces
from lmeasure.rig import PHASED, Rig
from lmeasure.sensors import COUNTER_STATE, Lengths, axial_travel, changes_from_counts, lengths_from_counts, rate_notes, zero_temperature
from lmeasure.text import Message, and_also, is_of, message
from lmeasure.trajectory.faults.consistency import RunSamples, collect_epochs, consistent
from lmeasure.trajectory.faults.continuity import Doubts
from lmeasure.trajectory.faults.redundancy import Epochs, detectable_sizes, places_of_reliability, reliability, reliability_notes
from lmeasure.trajectory.faults.rest_evidence import CLOSURE, Evidence, EvidenceFinder
from lmeasure.trajectory.files.trajectory import NAMES, Summary, Trajectory
from lmeasure.trajectory.files.write import trajectory_writer
from lmeasure.trajectory.origin.origins import settle_origins
from lmeasure.trajectory.origin.start import find_start, motion_of, zeros_by_motion
from lmeasure.trajectory.reconstruction.run_model import RunModel, Scheme
from lmeasure.trajectory.reconstruction.screw_method import (
    COMPILING_PAYS,
    Place,
    Reconstruction,
    by_monte_carlo,
    poses_from,
    reconstruction_of,
)
from lmeasure.trajectory.time.passes import Alignment, align
from lmeasure.trajectory.uncertainty.budget import CHUNK, RESTORED_ORIGIN, Budget, PoseCovariances
from lmeasure.trajectory.uncertainty.sources import LIGHT_RAD, PassClock, Situation, needed_zero, zeros_of

Progress = Callable[[int, int], None]
LEAST_AXIAL_MM = 0.001  # Largest unreported difference of length from axial offsets that are valid elsewhere
SURE_S = 86400.0  # A counter that cannot pass half its range in this time needs no stated rate
Each = Callable[[Counts, Lengths, Trajectory], None]
"""Function of a piece of a run: its recorded counts, its lengths and its part of the trajectory."""
Judge = Callable[[Reconstruction], tuple[Message, ...]]


class LengthSource(Protocol):
    """A run, in memory or in its files, with its lengths piece by piece."""

    @property
    def run(self) -> Run | RunHead:
        """Return its head."""

    @property
    def clocks(self) -> tuple[PassClock, ...]:
        """Return the uncertainties of each pass's time against pass 1's."""

    @property
    def evidence(self) -> Evidence:
        """Return the evidence of its rests and of the continuity of its counts on the counters."""

    @property
    def name(self) -> str:
        """Return the name of its first file."""

    def zeroed(self, rig: Rig) -> Self:
        """Return the same with its rig as its counters were zeroed, if that is another state of the drums."""

    def pieces(self, doubts: Doubts) -> Iterable[Lengths]:
        """Return its lengths, without the counts that are in these doubts."""


def prepare(source: LengthSource, constraint: str | None = None, repeatability_mm: float = 0.0, *, compares: bool = True) -> Reconstruction:
    """Return the reconstruction of a run, ready for its trajectory: with its start, its origins from redundancy, and the doubtful counts.
    compares: whether the channels are compared with each other, sample by sample.

    Raises the errors of `reconstruction_of` and `find_start`.
    """
    run, doubts = source.run, source.evidence.doubts
    rig = run.rig

    def begin(start: FloatArray, begun: FloatArray | None = None, zeros: FloatArray | None = None) -> Reconstruction:
        own, zeroed = source, rig
        if begun is not None:
            counts = counts_from_changes(rig.cable_rows(rig.observed), begun[None])
            zeroed = rig.zeroed_at(start, counts[0])
            own = source.zeroed(zeroed)
            begun = begun if own is source else changes_from_counts(zeroed, counts, rig.observed)[0]
        model = RunModel(zeroed, start, run.calibration, constraint, clocks=source.clocks, begun=begun, exact=run.unstated == "exact")
        model = replace(model, repeatability_mm=repeatability_mm, temperature_c=run.temperature_c)
        if begun is None:
            model = replace(model, u_start=run.start_errors.u, assumed_start=run.start_errors.assumed)
        if run.temperature_c is None and (model.correction is not None or model.temperatures_assumed):
            # where no effect needs it, counts without a temperature at the beginning have none
            pieces = own.pieces(doubts) if model.correction is not None else itertools.islice(own.pieces(doubts), 1)
            measured = (zero_temperature(lengths, None) for lengths in pieces)
            model = replace(model, measured_c=next((value for value in measured if value is not None), None))
        reconstruction = replace(reconstruction_of(model), doubts=doubts)
        if begun is None and needed_zero(zeros_of(rig, run.calibration), len(model.scheme.free)) > LIGHT_RAD:
            # the poses that such zeros leave lie too far off for first order: where the motion puts them it begins
            at = motion_of(model.rig, reconstruction.corrected(next(iter(own.pieces(doubts)))), record=run.calibration)
            zeros = zeros_by_motion(at, model.zero_pose, np.repeat([model.u_start[1], model.u_start[0]], 3))
        if zeros is None or not model.scheme.redundancy:
            return reconstruction
        return replace(reconstruction, budget=reconstruction.budget.with_zeros(zeros))

    def candidate(start: FloatArray, begun: FloatArray, zeros: FloatArray | None) -> tuple[Reconstruction, Epochs | None]:
        reconstruction, samples = begin(start, begun, zeros), RunSamples()
        if reconstruction.redundancy is None:
            return reconstruction, None
        epochs = collect_epochs(reconstruction, source.zeroed(reconstruction.model.rig).pieces(doubts), samples)[0]
        return replace(reconstruction, samples=samples.epochs()), epochs

    first = None if run.start is not None else next(iter(source.pieces(doubts)))
    reconstruction = begin(run.known_start) if first is None else find_start(rig, first, source.name, candidate)
    source = source.zeroed(reconstruction.model.rig)
    if reconstruction.redundancy is None or not compares:
        return reconstruction
    samples = RunSamples() if reconstruction.samples is None else None
    found = consistent(reconstruction, source.pieces(doubts), doubts, samples)
    kept = reconstruction.samples if samples is None else samples.epochs()
    reconstruction, epochs = settle_origins(replace(reconstruction, doubts=found, samples=kept), source.pieces)
    if not len(epochs) or reconstruction.redundancy is None:
        return reconstruction
    some = places_of_reliability(epochs)
    poses = reconstruction.poses_of(some.change_mm - reconstruction.budget.estimated_offsets(some.time_s))
    return replace(reconstruction, reliability=reliability_notes(rig, reliability(reconstruction.redundancy, some, poses)))


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
    """Reconstruct the trajectory of a run, its cables counted in one pass or several; a constraint replaces the rig's.

    repeatability_mm: standard deviation, per axis, of the tool's position in repeated passes. trials: of Monte Carlo instead of the linear
    law for the uncertainties, 0 for none; see `monte_carlo.by_monte_carlo`. covariances: False leaves those of a single pass at zero, to
    compute them only where needed: pass an aligned run (`passes.align`) to both, so that its lengths are computed once. judge: further
    report on the prepared run. Raises the errors of `Reconstruction` and `passes.align`.
    """
    aligned = align(run)
    reconstruction = prepare(aligned, constraint, repeatability_mm)
    aligned = aligned.zeroed(reconstruction.model.rig)
    run = aligned.run
    more = () if judge is None else judge(reconstruction)
    covariances = covariances or run.rig.passes > 1 or trials > 0
    lengths = aligned.lengths_of(reconstruction.doubts)
    trajectory = reconstruction.trajectory(lengths, covariances=covariances)
    if trials:
        trajectory = by_monte_carlo(reconstruction, lengths, trajectory, trials, seed=seed, progress=progress)
    trajectory = with_evidence(reconstruction, trajectory, lengths, aligned, covariances=covariances)
    unstated = (message("passes.repeatability"),) if run.rig.passes > 1 and repeatability_mm == 0.0 else ()
    return replace(trajectory, time_s=aligned.stamp_s, notes=(*trajectory.notes, *more, *aligned.notes, *unstated))


def can_stream(head: RunHead) -> bool:
    """Return whether the run can be processed in pieces: one pass, a recording that was closed properly, channels that were read together,
    no limit that needs later samples."""
    if head.rig.passes == 1:
        first = next(read_counts_in_pieces(head.counts[0]))
        if first.stamp_s is not None and first.frames is None:
            return False  # a piece ends at another time for each channel
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
    """Reconstruct a run for which `can_stream` holds and write its trajectory by `trajectory_writer`.

    The result is that of `reconstruct`, with its judge; progress is called with (done, of), and each piece with `each`. Raises the errors
    of `Reconstruction`, and FileFormatError for unreadable counts.
    """
    run = StreamedRun.of(head)
    reconstruction = prepare(run, constraint)
    run = run.zeroed(reconstruction.model.rig)
    more = () if judge is None else judge(reconstruction)
    summary = Summary()
    with trajectory_writer(out, covered(reconstruction.budget.covers, run.evidence), angles) as write:
        # a trajectory is taken before the next lengths are requested, so one piece is kept at a time
        waiting: deque[tuple[Counts, Lengths]] = deque()

        def lengths_of() -> Iterator[Lengths]:
            for counts, lengths in run.recorded_pieces(reconstruction.doubts, progress):
                waiting.append((counts, lengths))
                yield lengths

        for trajectory in reconstruction.trajectories(lengths_of()):
            piece, lengths = waiting.popleft()
            trajectory = with_evidence(reconstruction, trajectory, lengths, run, covariances=True)
            write(trajectory)
            trajectory = replace(trajectory, notes=(*trajectory.notes, *more))
            summary.add(trajectory)
            if each is not None:
                each(piece, lengths, trajectory)
    return summary


@dataclass(frozen=True)
class StreamedRun:
    """A run in its file: `LengthSource` of one pass. counters (m, `COUNTER_STATE`): at the beginning of the file."""

    run: RunHead
    counters: FloatArray
    notes: tuple[Message, ...]
    clocks: tuple[PassClock, ...] = ()

    @classmethod
    def of(cls, head: RunHead) -> "StreamedRun":
        """Look through the whole file for the widths and rates of its counters, where the rig states none."""
        rig, notes = _with_widths(head)
        counters, more = _counters(head, rig)
        return cls(replace(head, rig=rig), counters, (*notes, *more))

    @property
    def name(self) -> str:
        """Return the name of its file."""
        return str(self.run.counts[0])

    @cached_property
    def evidence(self) -> Evidence:
        """Return the evidence of the whole run on its counts: a step may show only at the end of the file."""
        finder = EvidenceFinder(self.run.rig, self.run.recorded)
        for _, lengths in self.recorded_pieces(Doubts()):
            finder.add(lengths)
        return finder.found()

    def zeroed(self, rig: Rig) -> "StreamedRun":
        """Return the same with its rig as its counters were zeroed."""
        return self if np.array_equal(rig.paid_out(), self.run.rig.paid_out()) else replace(self, run=replace(self.run, rig=rig))

    def pieces(self, doubts: Doubts) -> Iterator[Lengths]:
        """Yield the lengths piece by piece."""
        return (lengths for _, lengths in self.recorded_pieces(doubts))

    def recorded_pieces(
        self, doubts: Doubts, progress: Progress | None = None, *, first: int = 0, counters: FloatArray | None = None
    ) -> Iterator[tuple[Counts, Lengths]]:
        """Yield recorded counts and their lengths piece by piece, from the first sample on; counters (m, `COUNTER_STATE`) there, changed in
        place, by default those of the beginning."""
        rig, counters = self.run.rig, self.counters.copy() if counters is None else counters
        for piece in read_counts_in_pieces(self.run.counts[0], progress, first):
            lengths = doubts.applied(rig, lengths_from_counts(Run(rig, self.run.start, (piece,)), counters))
            yield piece, replace(lengths, notes=(*self.notes, *lengths.notes))


def _counters(head: RunHead, rig: Rig) -> tuple[FloatArray, list[Message]]:
    """Return (m, `COUNTER_STATE`) counters at the beginning of the file, with rates from the whole of it where needed."""
    fresh, requested, believed = np.zeros((len(rig.observed), COUNTER_STATE)), {}, {}
    for j, c in enumerate(rig.observed):
        counter = rig.counter(c)
        full = 0.0 if counter.counter_bits is None else 2.0**counter.counter_bits
        if not counter.rate_stated and 0.0 < full / 2.0 < SURE_S * counter.rate:
            requested[j] = RateEvidence(counter.rate, full)
    for piece in read_counts_in_pieces(head.counts[0]) if requested else ():
        for j, seen in requested.items():
            seen.add(piece.of(rig.observed[j].channel), piece.time_s)
    for j, seen in requested.items():
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


def with_evidence(
    reconstruction: Reconstruction, trajectory: Trajectory, lengths: Lengths, source: LengthSource, *, covariances: bool
) -> Trajectory:
    """Return a piece of a run's trajectory with the evidence on its own counts: notes, causes of `ok` samples with suspected counts, and
    closure errors in the systematic covariances."""
    evidence, budget, scheme = source.evidence, reconstruction.budget, reconstruction.model.scheme
    unseen = () if evidence.unseen is None else (evidence.unseen,)
    counters = (*notes_of(source.run.recorded), *reconstruction.doubts.notes, *evidence.notes, *unseen)
    stated = (
        *_redundancy_notes(reconstruction.model, evidence),
        *_phase_notes(reconstruction),
        *_zero_notes(reconstruction.model, lengths),
    )
    trajectory = replace(trajectory, notes=(*trajectory.notes, *counters, *stated, *reconstruction.reliability))
    if evidence.sound:
        return trajectory
    unused, ok = unused_channels(trajectory, lengths.cables), trajectory.status == Status.OK
    cause = trajectory.cause.copy()
    for mask, why in evidence.causes(trajectory.time_s, unused):
        cause[ok & mask] = and_also(cause[ok & mask], why)
    trajectory = replace(trajectory, cause=cause)
    if not covariances or not (evidence.closure_mm.any() or evidence.late_s.any()):
        return trajectory
    systematic, poses = trajectory.systematic.copy(), trajectory.poses
    if scheme.point is not None:
        poses = np.where(np.isnan(poses) & ~np.isnan(poses[:, :1]), [0.0] * 6 + [1.0], poses)
    speed = lengths.speed_mm_s
    for begin in range(0, len(systematic), CHUNK):
        i = slice(begin, begin + CHUNK)
        at = Situation(trajectory.time_s[i], poses[i], lengths.counts[i], speed[i])
        factors = _closure_factors(budget, evidence, at, unused[i])
        systematic[i] += factors @ np.swapaxes(factors, 1, 2)
    return replace(trajectory, systematic=systematic, covers=covered(trajectory.covers, evidence))


def _phase_notes(reconstruction: Reconstruction) -> list[Message]:
    """Return the assumptions on the angles of eccentric drums and pulleys at the start of the run."""
    rig, record = reconstruction.model.rig, reconstruction.model.calibration
    solved = set() if record is None else {name.partition(".")[0] for name in record.names if name.rpartition(".")[2] in PHASED}
    unsolved = reconstruction.budget.unsolved.variables
    free = sorted({v.owner for v in unsolved if any(name.rpartition(".")[2] in PHASED for name in v.names)} - solved)
    at_zero = sorted(name for name in solved if rig.point(name).phase_length_mm is None)
    by_code = {"phase.calibrated": sorted(solved - set(at_zero)), "phase.at_zero": at_zero, "phase.any": free}
    return [message(code, points=tuple(points)) for code, points in by_code.items() if points]


def _zero_notes(model: RunModel, lengths: Lengths) -> list[Message]:
    """Return a note on drums whose counters were zeroed at other lengths than in the calibration, while no length is stated at which axial
    offsets hold: how much other the lengths would be if they hold at those of the calibration."""
    known, rig = {} if model.calibration is None else model.calibration.zero_length_mm, model.rig
    travel = {} if model.calibration is None else axial_travel(rig, model.calibration)
    if not travel:
        return []
    rows, counts = rig.cable_rows(), np.ascontiguousarray(lengths.counts[:, : len(rig.cable)])
    moved = rows.copy()
    moved[:, AXIAL] += [travel.get(c.name, 0.0) for c in rig.cable]
    mm = float(np.nanmax(np.abs(changes_of_rows(moved, counts) - changes_of_rows(rows, counts)), initial=0.0))
    if mm < LEAST_AXIAL_MM:
        return []
    paid = np.abs(rig.paid_out_since(known)) * [rig.counter(c).per_count for c in rig.cable]
    example = next((name for name in travel if name in known), next(iter(known)))
    code = "zero.elsewhere.exact" if rig.unstated == "exact" else "zero.elsewhere"
    return [message(code, away=float(np.max(paid)), mm=mm, example=example, length=known[example])]


def _redundancy_notes(model: RunModel, evidence: Evidence) -> list[Message]:
    """Return notes on the faults that a run can show with its number of cables; without a redundant one, also their least sizes."""
    scheme = model.scheme
    if not scheme.six:
        return [_redundancy_note(scheme)]
    rows, begun = scheme.rows, span_lengths(scheme.rows, model.zero_pose[None])[0]
    poses = poses_from(rows, model.zero_pose, begun + evidence.returned_mm.reshape(-1, len(rows)))
    poses = poses[np.isfinite(poses).all(axis=1)]
    lengths = span_lengths(rows, poses) + np.hypot(rows[:, TANGENT], rows[:, AXIAL])
    directions = np.array([span_rows(rows, pose)[:, 3:] for pose in poses]).reshape(-1, len(rows), 3)
    found = detectable_sizes(evidence.lost_mm, evidence.return_mm, directions, lengths, late_s=evidence.least_late_s)
    return [_redundancy_note(scheme), *found.lines]


def _redundancy_note(scheme: Scheme) -> Message:
    of = {"cables": len(scheme.rows), "unknowns": len(scheme.free)} | ({"spare": scheme.redundancy} if scheme.redundancy > 1 else {})
    channels = ".channels" if scheme.rows[:, KIND].any() else ""
    return message(f"redundancy.{('none', 'one', 'more')[min(scheme.redundancy, 2)]}{channels}", **of)


def covered(covers: str, evidence: Evidence) -> str:
    """Return the sources in the standard uncertainties, in words, with closure errors."""
    covers = message("trajectory.does_not_close_counts", sources=covers) if evidence.closure_mm.any() else covers
    return message("trajectory.late_channels", sources=covers) if evidence.late_s.any() else covers


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
        numbers = {"n_time_s": len(lengths.time_s), "n_time_s2": len(trajectory.time_s)}
        raise TrajectoryError(message("error.has_samples_the_trajectory", where=run.passes[0].source, **numbers))
    reconstruction = prepare(aligned, constraint, repeatability_mm)
    aligned = aligned.zeroed(reconstruction.model.rig)
    # as they were used: some counts are not, and those of restored channels are
    lengths = aligned.lengths_of(reconstruction.doubts)
    budget, scheme = reconstruction.budget, reconstruction.model.scheme
    chosen = slice(None) if samples is None else samples
    time_s, counts, poses = lengths.time_s[chosen], lengths.counts[chosen], trajectory.poses[chosen].copy()
    speed, travel = budget.speed_mm_s(lengths)[chosen], budget.travel(lengths)
    u_mm, warm, travel = (None if given is None else given[chosen] for given in (lengths.u_mm, lengths.temperature_c, travel))
    if scheme.point is not None:
        # of the point alone: any orientation will do, for the rows have no arms
        known = ~np.isnan(poses[:, 0])
        poses[known, 3:] = (0.0, 0.0, 0.0, 1.0)
    unused = unused_channels(trajectory, lengths.cables)[chosen]
    found = budget.of(Situation(time_s, poses, counts, speed, warm, travel), u_mm, unused, compiled=len(poses) >= COMPILING_PAYS)
    if aligned.evidence.closure_mm.any() or aligned.evidence.late_s.any():
        at = Situation(time_s, poses, counts, lengths.speed_mm_s[chosen])
        closing = _closure_factors(budget, aligned.evidence, at, unused)
        k, factors = closing.shape[2], np.concatenate([found.factors, closing], axis=2)
        uniform, assumed = (*found.uniform, *(False,) * k), (*found.assumed, *("",) * k)
        found = replace(found, factors=factors, sources=(*found.sources, *(CLOSURE,) * k), uniform=uniform, assumed=assumed)
    if scheme.point is None:
        return found
    # the orientation is not measured
    own, factors = found.own.copy(), found.factors.copy()
    own[:, :3] = factors[:, :3] = np.nan
    return replace(found, own=own, factors=factors)


def _closure_factors(budget: Budget, evidence: Evidence, at: Situation, unused: BoolArray) -> FloatArray:
    """Return (n, 6, K) factors of poses for closure errors of the run's counts, and for late channels."""
    G = budget.twists(np.ascontiguousarray(at.poses), at.counts, unused, compiled=True)
    lengths = np.concatenate([evidence.closure_lengths(at.time_s), evidence.late_lengths(at.speed_mm_s)], axis=2)
    return np.asarray(G[:, :, : lengths.shape[1]] @ lengths)


def unused_channels(trajectory: Trajectory, cables: tuple[str, ...]) -> BoolArray:
    """(n, m) cables that `ok` samples name because they were not used."""
    out = np.zeros((len(trajectory.time_s), len(cables)), np.bool_)
    ok = (trajectory.status == Status.OK) & (trajectory.cable != "")
    # a restored channel is named too, and used
    ok[ok] = [not is_of(cause, RESTORED_ORIGIN) for cause in trajectory.cause[ok]]
    for names in set(trajectory.cable[ok]):
        mask = ok & (trajectory.cable == names)
        out[np.ix_(mask, [cables.index(name) for name in names.split(NAMES) if name in cables])] = True
    return out


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
