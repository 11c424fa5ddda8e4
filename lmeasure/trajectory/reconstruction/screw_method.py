"""Trajectory by the screw method (thesis Rashoyan 2021, 5.6), with the uncertainty of every pose.

Where the cables do not determine the pose, notes name the motion that they lost (`linkages.Split`). Logs too short to wait for a
compiler are solved in NumPy (`follow_together`), the twin of the lane kernel, by the same rule: a whole run is solved at once, started from
anchors that continuation reaches one from the other, and the result only counts where nothing can be in doubt: every sample starts near,
converges, keeps the side of the start and stays below 75 degrees of pressure angle. Anything else is left to the compiled kernels, which
go sample by sample and know every status.

`by_monte_carlo` states the uncertainty by propagation of distributions (JCGM 101): it reconstructs a run again and again with drawn inputs.
"""

import itertools
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lmeasure import kernels
from lmeasure.core import BoolArray, FloatArray, GeometryError, IntArray, Status, TextArray, TrajectoryError, se3
from lmeasure.kernels import BY_RADIUS, BY_SCALE, CABLE, KIND, WIDTH, changes_from_counts
from lmeasure.linkages import Split, pressure_angles
from lmeasure.rig import kernel_values, with_kernel_values
from lmeasure.sensors import Lengths, arms, span_lengths, span_rows
from lmeasure.text import JOINED, Message, and_also, message, without
from lmeasure.trajectory.faults.continuity import NONE, Doubts
from lmeasure.trajectory.faults.redundancy import Epochs, Redundancy
from lmeasure.trajectory.files.trajectory import NAMES, Trajectory
from lmeasure.trajectory.reconstruction.run_model import FREEDOMS, RunModel
from lmeasure.trajectory.uncertainty.budget import RESTORED_ORIGIN, Budget
from lmeasure.trajectory.uncertainty.sources import OriginEstimate, Situation, drawn, standard

ANCHORS = 2000  # more, as of a long way, and compiling costs less
STEPS = 6
FLOOR_MM = 1e-9  # a residual of rounding, when it no longer falls

Followed = tuple[FloatArray, FloatArray, IntArray, IntArray, FloatArray]


def follow_together(cables: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, *, flags: IntArray) -> Followed | None:
    """Return the result of `kernels.screw.resume` for these samples, or None if it is ambiguous; only a result changes the state. cables
    (6, columns), start (7,), state (`kernels.screw.STATE`,), changes (n, 6) [mm], flags (n,)."""
    index = np.flatnonzero(flags == Status.OK)
    if state[-1] != 0.0 or not len(index):
        return None
    (zero,), start_rows = span_rows(cables, start[None])
    side = np.sign(np.linalg.det(start_rows[0]))
    wanted = changes[index]
    starts = _anchors(cables, zero, state, wanted)
    if starts is None:
        return None
    found = _newton(cables, starts, zero + wanted, STEPS)
    if found is None:
        return None
    solved, worst, rows, steps = found
    with np.errstate(invalid="ignore"):
        determinants = np.linalg.det(rows)
        if not (determinants * side > 0.0).all():
            return None
        angles = pressure_angles(rows, arms(cables, solved)).max(axis=1)
        if not (angles <= kernels.CLEAR_OF_SINGULAR).all():
            return None
    n = len(changes)
    poses, residual, angle = np.full((n, 7), np.nan), np.full(n, np.nan), np.full(n, np.nan)
    iterations = np.zeros(n, np.int64)
    poses[index], residual[index], iterations[index] = solved, worst, steps
    angle[index] = angles
    state[: kernels.CHANGES], state[kernels.CHANGES : kernels.LOST] = solved[-1], wanted[-1]
    return poses, residual, iterations, flags.copy(), angle


def _anchors(cables: FloatArray, zero: FloatArray, state: FloatArray, changes: FloatArray) -> FloatArray | None:
    """(n, 7) poses near those of the samples: of the last anchor, each NEAR_MM of length from the one before; None where samples are
    farther apart, anchors too many, or one is not found."""
    pose, there = state[: kernels.CHANGES].copy(), state[kernels.CHANGES : kernels.LOST].copy()
    out = np.empty((len(changes), 7))
    begin, anchors = 0, 0
    while True:
        far = np.flatnonzero(np.abs(changes[begin:] - there).max(axis=1) > kernels.NEAR_MM)
        end = begin + int(far[0]) if len(far) else len(changes)
        out[begin:end] = pose
        if end == len(changes):
            return out
        # a sample that is itself far from the last one is no continuation
        if end == begin or anchors == ANCHORS:
            return None
        # one step of Newton's method is near enough: its rest is of second order, and does not add up
        lengths, rows = span_rows(cables, pose[None])
        residuals = zero + changes[end - 1] - lengths
        moved = _moved(pose[None], rows, residuals) if np.abs(residuals).max() <= 2.0 * kernels.NEAR_MM else None
        if moved is None:
            return None
        pose, there = moved[0], changes[end - 1]
        begin, anchors = end, anchors + 1


def poses_from(cables: FloatArray, start: FloatArray, targets: FloatArray) -> FloatArray:
    """(n, 7) poses whose lengths are the targets (n, 6), each from a start pose (7,); NaN where none is found."""
    found = _newton(cables, np.tile(start, (len(targets), 1)), targets, NEWTON_STEPS, near_mm=np.inf) if len(targets) else None
    return np.array([kernels.solve_pose(cables, one, start)[3] for one in targets]).reshape(-1, 7) if found is None else found[0]


def _newton(
    cables: FloatArray, poses: FloatArray, targets: FloatArray, most: int, near_mm: float = 2.0 * kernels.NEAR_MM
) -> tuple[FloatArray, FloatArray, FloatArray, int] | None:
    """Poses (n, 7) whose lengths are the targets (n, 6), largest residuals (n,), rows there (n, 6, 6), steps; None when one is missing, or
    a residual is larger than near_mm."""
    poses, previous = poses.copy(), np.inf
    for step in range(most + 1):
        lengths, rows = span_rows(cables, poses)
        residuals = targets - lengths
        worst = np.abs(residuals).max(axis=1)
        largest = float(worst.max())
        if not largest <= near_mm:  # NaN is no answer either
            return None
        if largest <= kernels.TOLERANCE_MM or (largest < FLOOR_MM and largest >= 0.5 * previous):
            return poses, worst, rows, step
        previous = largest
        moved = _moved(poses, rows, residuals)
        if moved is None:
            return None
        poses = moved
    return None


def _moved(poses: FloatArray, rows: FloatArray, residuals: FloatArray) -> FloatArray | None:
    """Poses (n, 7) after a step of Newton's method; None where one is too long, or there is none."""
    try:
        twist = np.linalg.solve(rows, residuals[:, :, None])[:, :, 0]
    except np.linalg.LinAlgError:
        return None
    if not np.linalg.norm(twist[:, :3], axis=1).max() <= kernels.MAX_STEP_ROTATION:
        return None
    # a turn and a shift of the tool origin; Newton's order does not need the screw between two steps
    return se3.displaced(poses, twist)


PROBES = 12  # to either side of a pose
NEWTON_STEPS = 15
SOLVED_MM, APART_MM = 1e-6, 1e-2  # Lengths met, and poses farther apart than a solution of the same one ends
NEARLY = 88.0  # worst pressure angle [deg] from which a known pose reports its poorly determined screw


def split_at(cables: FloatArray, pose: FloatArray, free: IntArray, u: FloatArray) -> Split:
    """The split at a pose (7,) of cables (m, columns) with free components free (f,) of the twist and uncertain by u (m,) [mm]."""
    size = max(float(np.linalg.norm(cables[:, kernels.ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    return Split(span_rows(cables, pose[None])[1][0], pose[:3], free, u, size_mm=size)


def explain(split: Split, changes: FloatArray) -> list[Message]:
    """Return for each of n samples with changes (n, m) [mm] since the pose of the split the lost and the determined part."""
    twists, u = split.determined(changes)
    size = {"mm": float(np.linalg.norm(u[3:])), "deg": float(np.degrees(np.linalg.norm(u[:3])))}
    lost = message("cause.lost", screw=split.lost.said)

    def said(twist: FloatArray) -> Message:
        moved = {"shift": tuple(twist[3:].tolist()), "turn": tuple(np.degrees(twist[:3]).tolist())}
        return message("cause.lost.determined", screw=split.lost.said, **size, **moved)

    return [said(twist) if np.isfinite(twist).all() else lost for twist in twists]


def other_near(cables: FloatArray, start: FloatArray, within_mm: float) -> tuple[FloatArray, float] | None:
    """The nearest other pose (7,) with the lengths that six cables (6, columns) have at a pose (7,), and how far it is [mm], a turn counted
    at the rim; None where none is met within a distance. Two assemblies meet at a fold, a singular pose, and near one they lie apart along
    the screw that the lengths see least: Newton's method from places along it, to both sides, ends at the other one."""
    six = np.arange(6)
    twist = split_at(cables, start, six, np.ones(6)).twist
    rim = max(float(np.linalg.norm(cables[:, kernels.ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    unit = np.repeat([1.0 / rim, 1.0], 3)
    aim = span_rows(cables, start[None])[0]
    reach = within_mm * np.geomspace(1.0, 1e-3, PROBES)
    poses = se3.displaced(np.tile(start, (2 * PROBES, 1)), np.outer(np.concatenate([reach, -reach]), twist))
    for _ in range(NEWTON_STEPS):
        lengths, rows = span_rows(cables, poses)
        sound = np.isfinite(rows).all(axis=(1, 2)) & (np.linalg.cond(np.nan_to_num(rows * unit)) < 1e14)
        poses, rows, lengths = poses[sound], rows[sound] * unit, lengths[sound]
        step = np.linalg.solve(rows, (aim - lengths)[..., None])[..., 0]
        # limit the step to the search distance
        step *= np.minimum(1.0, within_mm / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None]
        poses = se3.displaced(poses, step * unit)
    lengths = span_rows(cables, poses)[0]
    away = np.linalg.norm(se3.displacement(poses, start) / unit, axis=1)
    with np.errstate(invalid="ignore"):
        found = np.flatnonzero((np.abs(lengths - aim).max(axis=1) < SOLVED_MM) & (away > APART_MM) & (away <= within_mm))
    if not len(found):
        return None
    nearest = found[np.argmin(away[found])]
    return poses[nearest], float(away[nearest])


COMPILING_PAYS = 2**14  # samples from which the kernels save more than they take to compile
LANES_PAY = 2**17  # of redundant channels, whose lanes take longer to compile
START_CLEAR = np.radians(75.0)  # worst pressure angle up to which a start that is off by centimetres is still on its side
START_COVERAGE = 3.0  # standard uncertainties of the start
START_NEAR_MM = 50.0  # another assembly this near to the start is determined: a start that is off by centimetres may be meant for it

_CAUSES = {
    Status.SINGULAR: message("cause.singular"),
    Status.NOT_CONVERGED: message("cause.no_pose"),
    Status.OTHER_ASSEMBLY: message("cause.assemblies"),
}
NOT_MEASURED = message("cause.orientation")


@dataclass
class Place:
    """Progress of following a run: state (8 + m,) of the kernels, last direction of its cables (m, 2), and whether by the compiled kernels.
    The rest depends on nothing else."""

    state: FloatArray
    travelled: FloatArray
    by_kernels: bool

    def copy(self) -> "Place":
        """Return a copy, which stays where it is."""
        return Place(self.state.copy(), self.travelled.copy(), self.by_kernels)


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A run's model with the results so far: origins from redundancy, and doubtful counts.

    state (8 + m,): the kernels' state at its start; compiled: whether NumPy did not find the start. notes: of the model. samples: some of
    the run, evenly over it, before its channels were compared; None without redundancy. reliability: of the run, in lines
    (`trajectory.faults.redundancy`).
    """

    model: RunModel
    budget: Budget
    state: FloatArray
    compiled: bool
    notes: tuple[Message, ...] = ()
    doubts: Doubts = NONE
    samples: Epochs | None = None
    reliability: tuple[Message, ...] = ()

    @cached_property
    def redundancy(self) -> Redundancy | None:
        """Return the tests of the channels against each other, None where there are no more than unknowns."""
        return Redundancy(self.budget) if self.model.scheme.redundancy else None

    def with_estimate(self, estimate: OriginEstimate | None) -> "Reconstruction":
        """Return the reconstruction after the run determined its origins, or before."""
        return replace(self, budget=self.budget.with_estimate(estimate))

    def trajectory(self, lengths: Lengths, *, covariances: bool = True) -> Trajectory:
        """Return the trajectory of a run in one piece."""
        (found,) = self.trajectories([lengths], covariances=covariances)
        return found

    @property
    def beginning(self) -> Place:
        """The place where the run begins."""
        return Place(self.state.copy(), np.zeros((len(self.model.scheme.rows), 2)), self.compiled)

    def follow(self, piece: Lengths, place: Place) -> tuple[Lengths, tuple[Any, ...], bool, FloatArray | None]:
        """Follow a run over its next piece, and move the place on.

        Return the used lengths, the kernels' results, whether they were the compiled ones, and the cables' travel.
        """
        lengths = self.corrected(piece, place.state)
        found, compiled = self._next(place.state, lengths.change_mm, lengths.flags, by_kernels=place.by_kernels)
        place.by_kernels = place.by_kernels or compiled or len(lengths.change_mm) > 1
        return lengths, found, compiled, self.budget.travel(lengths, place.travelled)

    def trajectories(self, pieces: Iterable[Lengths], *, covariances: bool = True, place: Place | None = None) -> Iterator[Trajectory]:
        """Yield the trajectory of a run piece by piece, from a place on; without covariances theirs are zero, for a quarter of the time."""
        scheme, at = self.model.scheme, self.beginning if place is None else place.copy()
        for piece in pieces:
            begun = at.state.copy()
            lengths, found, compiled, travel = self.follow(piece, at)
            poses, residual, iterations, status, angle, *_ = found
            cause = np.where(status == lengths.flags, lengths.cause, _TEXTS[status])
            cable, unused, chi_squared = np.where(status == lengths.flags, lengths.cable, ""), None, None
            if not scheme.six:
                unused = np.isnan(lengths.change_mm)
                cause, cable = self._remarks(lengths, status, unused, cause, cable)
            # with as many cables as unknowns it is the solver's, not the lengths'
            residual = np.where(np.isfinite(lengths.change_mm).sum(axis=1) > len(scheme.free), residual, np.nan)
            cause = self._explained(cause, status, poses, angle, lengths.change_mm, begun)
            random = systematic = np.broadcast_to(np.zeros((6, 6)), (len(poses), 6, 6))
            assumed_mm = np.zeros(len(poses))
            if covariances:
                random, systematic, assumed_mm = self.budget.covariances(poses, lengths, unused, compiled, travel=travel)
                if self.redundancy is not None:
                    parities = self.redundancy.parities(self.redundancy.epochs(lengths, travel), poses)
                    chi_squared = np.where(parities.freedom > 0, parities.chi_squared, np.nan)
            solved = lengths.time_s, poses, residual, iterations, status, cause, cable, np.degrees(angle)
            notes, assumed = (*lengths.notes, *self.notes), self.budget.assumed_of_run(poses, lengths, unused, travel=travel)
            uncertain = random, systematic, self.budget.covers
            trajectory = Trajectory(*solved, *uncertain, notes, chi_squared, assumed, u95_assumed_mm=assumed_mm)
            yield _without_orientation(trajectory) if scheme.point else trajectory

    def examine(self, pieces: Iterable[Lengths]) -> Iterator[tuple[Lengths, FloatArray, FloatArray, FloatArray | None]]:
        """Yield of a run whose cables are redundant, piece by piece, its lengths as they are used, its poses (n, 7), chi-squared (n,) by
        the counts alone, and which way the cables travelled last."""
        scheme, travelled = self.model.scheme, np.zeros((len(self.model.scheme.rows), 2))
        state = new_run_state(self.model)
        for piece in pieces:
            lengths = self.corrected(piece, state)
            poses, *_, chi_squared = self._follow(scheme.rows, self.model.zero_pose, state, lengths.change_mm, lengths.flags)
            yield lengths, poses, chi_squared, self.budget.travel(lengths, travelled)

    def corrected(self, lengths: Lengths, state: FloatArray | None = None) -> Lengths:
        """Return the lengths without the effects of temperature, stretch and sag that the rig states; state is where the run has got to, by
        default its start."""
        if self.budget.estimate is not None or self.budget.supposed.any():
            lengths = replace(lengths, change_mm=lengths.change_mm - self.budget.offsets(lengths.time_s))
        model = self.model
        if model.correction is None:
            return lengths
        begun = new_run_state(model) if state is None else state

        def solve(changes: FloatArray) -> FloatArray:
            return np.asarray(self._follow(model.scheme.rows, model.zero_pose, begun.copy(), changes, lengths.flags)[0])

        return model.correction.corrected(lengths, solve)

    def solve(self, rows: FloatArray, start: FloatArray, changes: FloatArray, flags: IntArray) -> FloatArray:
        """Return (n, 7) poses of a whole run by other rows of cables, from another start, changes (n, m) [mm] and flags (n,); NaN where
        none is found."""
        return np.asarray(self._follow(rows, start, new_run_state(self.model, start), changes, flags)[0])

    def poses_of(self, changes: FloatArray) -> FloatArray:
        """Return (n, 7) poses of samples of a run by changes (n, m) of its channels, NaN for one that is not used."""
        return self.solve(self.model.scheme.rows, self.model.zero_pose, changes, np.full(len(changes), Status.GAP, np.int64))

    def _next(self, state: FloatArray, changes: FloatArray, flags: IntArray, *, by_kernels: bool) -> tuple[tuple[Any, ...], bool]:
        """Follow the next samples, and whether by the compiled kernels: not as long as they are few and plain."""
        rows, start = self.model.scheme.rows, self.model.zero_pose
        if self.model.scheme.six and not by_kernels and len(changes) < COMPILING_PAYS:
            found = follow_together(rows, start, state, changes, flags=flags)
            if found is not None:
                return found, False
        return self._follow(rows, start, state, changes, flags), True

    def _follow(self, rows: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, flags: IntArray) -> tuple[Any, ...]:
        scheme, u = self.model.scheme, np.sqrt(self.budget.length_variance)
        if scheme.six:
            follow = kernels.follow_lanes if len(changes) >= COMPILING_PAYS else kernels.resume_screw
            return tuple(follow(rows, start, state, changes, flags, u))
        in_lanes = len(changes) >= LANES_PAY and scheme.redundancy and len(scheme.free) == len(FREEDOMS)
        by = kernels.follow_redundant_lanes if in_lanes else kernels.follow_least_squares
        return tuple(by(rows, start, zero_readings(self.model, rows, start), state, changes, flags, u, scheme.free_index))

    def _remarks(
        self, lengths: Lengths, status: IntArray, left_out: BoolArray, cause: TextArray, cable: TextArray
    ) -> tuple[TextArray, TextArray]:
        """Return causes and cables of good samples without some of the cables, left_out (n, m), and freedoms that a scheme does not
        measure."""
        ok = status == Status.OK
        cause, cable = cause.copy(), np.where(ok, "", cable)
        cause[ok] = NOT_MEASURED if self.model.scheme.point else ""
        lacking = ok & left_out.any(axis=1)
        for missing in np.unique(left_out[lacking], axis=0):
            mask = lacking & (left_out == missing).all(axis=1)
            cable[mask] = NAMES.join(np.array(lengths.cables)[missing])
            cause[mask] = without(lengths.cause[mask])
        for j, after_s, until_s, *_ in self.budget.restored_origins():
            mask = ok & (lengths.time_s > after_s) & (lengths.time_s <= until_s) & ~left_out[:, j]
            alone = mask & (cable == "")
            cable[alone] = lengths.cables[j]
            cause[mask] = and_also(cause[mask], message(RESTORED_ORIGIN, cable=lengths.cables[j], after_s=after_s))
        return cause, cable

    def _explained(
        self, cause: TextArray, status: IntArray, poses: FloatArray, angle: FloatArray, changes: FloatArray, begun: FloatArray
    ) -> TextArray:
        """Return the causes with the part lost at singular samples and nearly lost at known ones; begun is the state before these
        samples."""
        singular = status == Status.SINGULAR
        near = (status == Status.OK) & (angle > np.radians(NEARLY))
        if not (singular.any() or near.any()):
            return cause
        cause, u, free = cause.copy(), np.sqrt(self.budget.length_variance), self.model.scheme.free_index
        m = len(u)
        before = np.maximum.accumulate(np.where(status == Status.OK, np.arange(len(status)), -1))
        for last in np.unique(before[singular]):
            pose, there = np.split(begun[: kernels.CHANGES + m], [kernels.CHANGES]) if last < 0 else (poses[last], changes[last])
            mine = np.flatnonzero(singular & (before == last))
            explained = explain(split_at(self.model.scheme.rows, pose, free, u), changes[mine] - there)
            for i, said in zip(mine, explained, strict=True):
                cause[i] = message(JOINED, first=cause[i], then=said)
        for i in np.flatnonzero(near):
            lost = split_at(self.model.scheme.rows, poses[i], free, u).lost
            remark = message("cause.nearly_singular", screw=lost.said, mm=lost.mm_per_mm)
            cause[i] = message(JOINED, first=cause[i], then=remark) if cause[i] else remark
        return cause


def reconstruction_of(model: RunModel) -> Reconstruction:
    """Return the reconstruction of a model, before anything is known of its run.

    RigError when the rig's cables do not determine the pose; GeometryError when a cable cannot run at the start pose; TrajectoryError when
    the start pose is singular, or needs an encoder whose zero is not known.
    """
    rig, start, scheme, zero_pose = model.rig, model.start, model.scheme, model.zero_pose
    rows = rig.cable_rows(rig.observed)
    drawn = rows[: len(rig.cable)]
    on = np.abs(se3.apply(start, drawn[:, kernels.ATTACHMENT_XYZ]) - drawn[:, kernels.BASE_XYZ]).max(axis=1) == 0.0
    if on.any():
        lost = rig.cable[int(np.argmax(on))]
        raise GeometryError(message("error.start_cable_lies_on", name=lost.name, to_point=lost.to_point, from_point=lost.from_point))
    if not np.isfinite(span_rows(rows, start[None])[0]).all():
        try:
            span_lengths(rig, start[None, :], rig.observed)
        except GeometryError as error:
            raise GeometryError(message("error.start_2", error=error)) from None
    budget, state = Budget(model), new_run_state(model)
    _ = model.loose_zeros
    fresh = Reconstruction(model, budget, state, compiled=False)
    begun, flags = _changes_at(model, zero_pose)[None], np.zeros(1, np.int64)
    (_, _, _, status, angle, *_), compiled = fresh._next(state, begun, flags, by_kernels=False)
    if status[0] != Status.OK:
        split = split_at(scheme.rows, zero_pose, scheme.free_index, np.sqrt(budget.length_variance))
        raise TrajectoryError(message("error.start_not_determined", causes=_CAUSES[Status(status[0])], said=split.lost.said))
    notes: list[Message] = []
    if scheme.point:
        notes.append(message("scheme.point", point=scheme.point))
    if scheme.constraint:
        notes.append(message("scheme.held", freedoms=scheme.held, constraint=scheme.constraint))
    if angle[0] > START_CLEAR:
        notes.append(message("start.angle", angle_deg=float(np.degrees(angle[0]))))
    if scheme.six:
        other = other_near(scheme.rows, zero_pose, START_NEAR_MM)
        if other is not None:
            notes.append(message("start.near", apart_mm=other[1], fold_mm=other[1] / 2.0))
        if any(model.u_start):
            _check_side(budget, float(angle[0]))
    if model.correction is not None:
        notes += model.correction.notes
    return replace(fresh, compiled=compiled, notes=tuple(notes))


def _check_side(budget: Budget, angle: float) -> None:
    """TrajectoryError when the start, uncertain as it is, may lie beyond a singular pose: then the run may be in another assembly; angle:
    the worst pressure angle [rad] there."""
    scheme, start = budget.scheme, budget.model.zero_pose
    nothing = np.zeros((1, len(scheme.rows)))
    found = budget.of(Situation(np.zeros(1), start[None], nothing, nothing, travel=nothing), compiled=False)
    systematic = found.systematic[0]
    split = split_at(scheme.rows, start, scheme.free_index, np.sqrt(budget.length_variance))
    part = split.twist * split.metric  # of an error of the start that is this twist [mm]
    reach = START_COVERAGE * np.sqrt(part @ systematic @ part)
    probes = np.stack([start, *(se3.displaced(start, way * split.twist) for way in (reach, -reach))])
    sides = np.sign(np.linalg.det(span_rows(scheme.rows, probes)[1]))
    if not (sides == sides[0]).all():
        raise TrajectoryError(message("error.start_within_its_uncertainty", angle=np.degrees(angle), said=split.lost.said))


def new_run_state(model: RunModel, start: FloatArray | None = None) -> FloatArray:
    """Return where a run has got to at its start, (8 + m,), as `kernels.least_squares` has it, without compiling: the start pose, no change
    of the cables, not lost. start (7,): another one than the model's."""
    start = model.zero_pose if start is None else start
    return np.concatenate([start, _changes_at(model, start), [0.0]])


def _changes_at(model: RunModel, start: FloatArray) -> FloatArray:
    """Return (m,) the changes at the start: none but of absolute channels, or where it was found."""
    begun = np.zeros(len(model.scheme.rows)) if model.begun is None else model.begun
    if not model.absolute.any():
        return begun
    return np.where(model.absolute, span_rows(model.scheme.rows, start[None])[0][0], begun)


def zero_readings(model: RunModel, rows: FloatArray, start: FloatArray) -> FloatArray:
    """Return (m,) readings of channels, rows (m, columns), at the zero of their changes."""
    begun = 0.0 if model.begun is None else model.begun
    return np.where(model.absolute, 0.0, span_rows(rows, start[None])[0][0] - begun)


_TEXTS = np.array([_CAUSES.get(status, "") for status in Status], dtype=np.object_)


def _without_orientation(trajectory: Trajectory) -> Trajectory:
    poses, random, systematic = trajectory.poses.copy(), trajectory.random.copy(), trajectory.systematic.copy()
    poses[:, 3:] = np.nan
    for covariance in (random, systematic):
        covariance[:, :3, :] = covariance[:, :, :3] = np.nan
    return replace(trajectory, poses=poses, random=random, systematic=systematic)


Progress = Callable[[int, int], None]

TRIALS = 400  # a standard deviation of as many draws is known to 3.5 %


def by_monte_carlo(
    reconstruction: Reconstruction,
    lengths: Lengths,
    trajectory: Trajectory,
    trials: int = TRIALS,
    *,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trajectory:
    """Return the trajectory with covariances from as many trials, each kind of error by itself. Random: every count is anywhere within half
    a unit of the recorded one, plus the length's other uncertainty at that sample (`Lengths.u_mm`). Systematic: the rig's parameters, the
    start pose and other influences on the lengths are drawn from their own laws, once per trial for the whole run. Poses that a trial does
    not find are omitted. TrajectoryError for fewer than 2 trials."""
    if trials < 2:
        raise TrajectoryError(message("error.monte_carlo_trials_tell", trials=trials))
    generator = np.random.default_rng(seed)
    budget, model = reconstruction.budget, reconstruction.model
    start = model.zero_pose
    rows, counts, factor = model.scheme.rows, lengths.counts, budget.by_parameter.root
    u_mm = lengths.u_mm
    of = trials * (2 if budget.sources else 1)
    lengths = reconstruction.corrected(lengths)
    # trials keep the corrections for temperature, stretch, sag and determined origins
    corrected = model.correction is not None or budget.estimate is not None
    offset = lengths.change_mm - changes_from_counts(rows, counts) if corrected else 0.0
    situation = Situation(lengths.time_s, trajectory.poses, counts, lengths.speed_mm_s, lengths.temperature_c, budget.travel(lengths))
    shifts = np.empty(0) if budget.estimate is not None else np.nan_to_num(budget.lengths_of(situation, budget.by_length))
    by_parts = np.nan_to_num(budget.by_parameter.of_parts(trajectory.poses, counts, situation.travel))

    def random_trial() -> FloatArray:
        within = counts + generator.uniform(-0.5, 0.5, counts.shape) / budget.scales
        changes = changes_from_counts(rows, within) + offset
        if u_mm is not None:
            changes += u_mm * generator.standard_normal(changes.shape)
        return reconstruction.solve(rows, start, changes, lengths.flags)

    def by_other_parameters(shift: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Rows and changes of the lengths when the parameters are off by shift (13 m,)."""
        each = shift.reshape(len(rows), WIDTH)
        moved, scales = moved_rows(rows, each), budget.scales
        k = counts * scales / (scales + each[:, BY_SCALE])
        return moved, changes_from_counts(moved, k) + offset

    def systematic_trial() -> FloatArray:
        if budget.estimate is not None:
            shift, errors = _drawn_by_estimate(budget, budget.estimate, situation, generator)
            moved, changes = by_other_parameters(shift)
            return reconstruction.solve(moved, start, changes + np.nan_to_num(errors), lengths.flags)
        values = generator.standard_normal(factor.shape[1])
        moved, changes = by_other_parameters(factor @ values)
        changes = changes + shifts @ drawn(budget.by_length, generator) + by_parts @ values
        return reconstruction.solve(moved, budget.drawn_start(generator, moved), changes, lengths.flags)

    done = itertools.count(1)

    def step() -> None:
        if progress is not None:
            progress(next(done), of)

    base = reconstruction.solve(rows, start, lengths.change_mm, lengths.flags)
    random = _scatter(random_trial, base, trials, step)
    systematic = _scatter(systematic_trial, base, trials, step) if budget.sources else np.zeros_like(random)
    unknown = np.isnan(trajectory.random)
    random[unknown] = systematic[unknown] = np.nan
    covers = message("trajectory.monte_carlo_trials_jcgm", sources=trajectory.covers, trials=trials)
    return replace(trajectory, random=random, systematic=systematic, covers=covers)


def _drawn_by_estimate(
    budget: Budget, estimate: OriginEstimate, situation: Situation, generator: "np.random.Generator"
) -> tuple[FloatArray, FloatArray]:
    """Return a draw of a run's common errors after it determined its origins: errors of the rig's parameters (13 m,), and other errors of
    the readings (n, m). Origins contain a part of the parameters' errors."""
    own = [standard(generator, (len(s.names),), s.uniform and s not in budget.origins) for s in budget.every]
    root = budget.by_parameter.root
    drawn, r = estimate.mix @ np.concatenate(own), root.shape[1]
    # those of the parameters come first
    others = [budget.lengths_of(situation, (source,)) for source in (budget.every[1:] if r else budget.every)]
    by_parts = budget.by_parameter.of_parts(situation.poses, situation.counts, situation.travel) @ drawn[:r]
    return np.asarray(root @ drawn[:r]), np.asarray(np.concatenate(others, axis=2) @ drawn[r:] + by_parts)


def moved_rows(rows: FloatArray, shift: FloatArray) -> FloatArray:
    """(m, columns) rows of cables whose parameters are moved by shift (m, 13), in the order of `PARAMETERS`; scale has no place there."""
    values = kernel_values(rows) + shift
    cables = rows[:, KIND] == CABLE
    # an encoder has its zero there
    values[cables, BY_RADIUS] = np.maximum(values[cables, BY_RADIUS], 0.0)
    return with_kernel_values(rows, values)


def _scatter(trial: Callable[[], FloatArray], base: FloatArray, trials: int, step: Callable[[], None]) -> FloatArray:
    """(n, 6, 6) covariance of (rotation; tool origin) of the trials' poses about their mean."""
    n = len(base)
    good = ~np.isnan(base[:, 0])
    count, total, squares = np.zeros(n), np.zeros((n, 6)), np.zeros((n, 6, 6))
    for _ in range(trials):
        poses = trial()
        found = ~np.isnan(poses[good, 0])
        delta = np.zeros((int(good.sum()), 6))
        delta[found] = se3.displacement(poses[good][found], base[good][found])
        count[good] += found
        total[good] += delta
        squares[good] += delta[:, :, None] * delta[:, None, :]
        step()
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = total / count[:, None]
        out = (squares - count[:, None, None] * mean[:, :, None] * mean[:, None, :]) / (count - 1)[:, None, None]
    out[count < 2] = np.nan
    return np.asarray(out)
