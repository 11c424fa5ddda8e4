"""Trajectory by the screw method (thesis Rashoyan 2021, 5.6), with the uncertainty of every pose.

Where the cables do not determine the pose, notes name the motion that they lost (`linkages.lost_screw`).
"""

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from lmeasure.core import BoolArray, FloatArray, GeometryError, IntArray, Status, TextArray, TrajectoryError, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BASE_XYZ, CHANGES, follow_lanes, follow_least_squares, follow_redundant_lanes, resume_screw
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import Lengths, span_lengths, span_rows
from lmeasure.text import JOINED, Message, and_also, message, without
from lmeasure.trajectory.faults.doubts import Shift
from lmeasure.trajectory.faults.redundancy import Epochs, Redundancy
from lmeasure.trajectory.files.trajectory import NAMES, Trajectory
from lmeasure.trajectory.reconstruction import reference
from lmeasure.trajectory.reconstruction.corrections import correction_of
from lmeasure.trajectory.reconstruction.scheme import FREEDOMS, scheme_of
from lmeasure.trajectory.uncertainty.budget import RESTORED_ORIGIN, Budget
from lmeasure.trajectory.uncertainty.sources import PassClock, loose_zeros

if TYPE_CHECKING:
    from lmeasure.trajectory.uncertainty.sources import Told


from lmeasure.linkages import Split

PROBES = 12  # to either side of a pose
NEWTON_STEPS = 15
SOLVED_MM, APART_MM = 1e-6, 1e-2
"""Lengths met, and poses farther apart than a solution of the same one ends."""
NEARLY = 88.0  # worst pressure angle [deg] from which a pose that is known says what is seen badly


def split_at(cables: FloatArray, pose: FloatArray, free: IntArray, u: FloatArray) -> Split:
    """The split at a pose (7,) of cables (m, columns) with free components free (f,) of the twist and uncertain by u (m,) [mm]."""
    size = max(float(np.linalg.norm(cables[:, ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    return Split(span_rows(cables, pose[None])[1][0], pose[:3], free, u, size_mm=size)


def explain(split: Split, changes: FloatArray) -> list[Message]:
    """For each of n samples with changes (n, m) [mm] since the pose of the split: what is lost there, and what is determined."""
    twists, u = split.determined(changes)
    size = {"mm": float(np.linalg.norm(u[3:])), "deg": float(np.degrees(np.linalg.norm(u[:3])))}
    lost = message("cause.lost", screw=split.lost.said)

    def said(twist: FloatArray) -> Message:
        moved = {"shift": tuple(twist[3:].tolist()), "turn": tuple(np.degrees(twist[:3]).tolist())}
        return message("cause.lost.determined", screw=split.lost.said, **size, **moved)

    return [said(twist) if np.isfinite(twist).all() else lost for twist in twists]


def other_near(cables: FloatArray, start: FloatArray, within_mm: float) -> tuple[FloatArray, float] | None:
    """The nearest other pose (7,) with the lengths that six cables (6, columns) have at a pose (7,), and how far it is [mm], a turn counted
    at the rim; None where none is met within a distance.

    Two assemblies meet at a fold, a singular pose, and near one they lie apart along the screw that the lengths see least: Newton's method
    from places along it, to both sides, ends at the other one.
    """
    six = np.arange(6)
    twist, rim = split_at(cables, start, six, np.ones(6)).twist, max(float(np.linalg.norm(cables[:, ATTACHMENT_XYZ], axis=1).max()), 1e-3)
    unit = np.repeat([1.0 / rim, 1.0], 3)
    aim = span_rows(cables, start[None])[0]
    reach = within_mm * np.geomspace(1.0, 1e-3, PROBES)
    poses = se3.displaced(np.tile(start, (2 * PROBES, 1)), np.outer(np.concatenate([reach, -reach]), twist))
    for _ in range(NEWTON_STEPS):
        lengths, rows = span_rows(cables, poses)
        sound = np.isfinite(rows).all(axis=(1, 2)) & (np.linalg.cond(np.nan_to_num(rows * unit)) < 1e14)
        poses, rows, lengths = poses[sound], rows[sound] * unit, lengths[sound]
        step = np.linalg.solve(rows, (aim - lengths)[..., None])[..., 0]
        # farther than what is looked for is not gone at once
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
START_NEAR_MM = 50.0  # another assembly this near to the start is told: a start that is off by centimetres may be meant for it

_CAUSES = {
    Status.SINGULAR: message("cause.singular"),
    Status.NOT_CONVERGED: message("cause.no_pose"),
    Status.OTHER_ASSEMBLY: message("cause.assemblies"),
}
NOT_MEASURED = message("cause.orientation")


class Reconstruction:
    """A run that is being reconstructed: give it the lengths of one piece of the run after the other.

    begun (m,): what the channels' changes were at the start pose, where that is no pose at which they were zeroed but one that was found.

    RigError when the rig's cables cannot tell the pose; GeometryError when a cable cannot run at the start pose; TrajectoryError when the
    start pose is singular, or needs an encoder whose zero is not known.
    """

    def __init__(
        self,
        rig: Rig,
        start: FloatArray,
        calibration: CalibrationRecord | None = None,
        constraint: str | None = None,
        *,
        u_start: tuple[float, ...] = (0.0, 0.0),
        clocks: tuple[PassClock, ...] = (),
        repeatability_mm: float = 0.0,
        temperature_c: float | None = None,
        begun: FloatArray | None = None,
    ) -> None:
        self._begun = begun
        self.rig, self.scheme = rig, scheme_of(rig, start, constraint)
        rows = rig.cable_rows(rig.observed)
        drawn = rows[: len(rig.cable)]
        on = np.abs(se3.apply(start, drawn[:, ATTACHMENT_XYZ]) - drawn[:, BASE_XYZ]).max(axis=1) == 0.0
        if on.any():
            lost = rig.cable[int(np.argmax(on))]
            raise GeometryError(f"start: cable {lost.name}: {lost.to_point} lies on {lost.from_point}: the cable has no direction there")
        if not np.isfinite(span_rows(rows, start[None])[0]).all():
            try:
                span_lengths(rig, start[None, :], rig.observed)
            except GeometryError as error:
                raise GeometryError(f"start {error}") from None
        self.start = self.scheme.start_of(start)
        self.correction = correction_of(rig, self.scheme, self.start, temperature_c)
        self.budget = Budget(
            rig,
            start,
            self.scheme,
            calibration,
            u_start=u_start,
            clocks=clocks,
            repeatability_mm=repeatability_mm,
            correction=self.correction,
            temperature_c=temperature_c,
            unknown=begun is not None,
        )
        self.covers = self.budget.covers
        self.redundancy = Redundancy(self.budget, begun) if self.scheme.redundancy else None
        self.loose = loose_zeros(rig, calibration, len(self.scheme.free))
        """Channels whose zeros only a run can tell."""
        self.reliability: tuple[Message, ...] = ()
        """Of the run, in lines (`trajectory.faults.redundancy`), once it is prepared."""
        self.shifts: tuple[Shift, ...] = ()
        """By which restored channels read too much, once it is prepared."""
        self.thinned: Epochs | None = None
        """Some samples of the run, evenly over it, before its channels were held against each other; None where none is redundant."""
        self._state = self._new_state(self.start)
        self._many = False
        self._travelled = np.zeros((len(self.scheme.rows), 2))
        (_, _, _, status, angle, *_), _ = self._next(self._at_start(self.start)[None], np.zeros(1, np.int64))
        if status[0] != Status.OK:
            raise TrajectoryError(f"start: {_CAUSES[Status(status[0])]}{self._lost_at(self.start)}")
        self._start_angle = float(angle[0])
        self._near: float | None = None
        if self.scheme.six:
            other = other_near(self.scheme.rows, self.start, START_NEAR_MM)
            self._near = None if other is None else other[1]
            if any(u_start):
                self._check_side()

    def _check_side(self) -> None:
        """TrajectoryError when the start, uncertain as it is, may lie beyond a singular pose: then the run may be in another assembly."""
        rows, m = self.scheme.rows, len(self.scheme.rows)
        found = self.budget.of(
            np.zeros(1), self.start[None], counts=np.zeros((1, m)), speed_mm_s=np.zeros((1, m)), compiled=False, travel=np.zeros((1, m))
        )
        systematic = found.systematic[0]
        split = split_at(rows, self.start, self.scheme.free_index, np.sqrt(self.budget.length_variance))
        part = split.twist * split.metric  # of an error of the start that is this twist [mm]
        reach = START_COVERAGE * np.sqrt(part @ systematic @ part)
        probes = np.stack([self.start, *(se3.displaced(self.start, way * split.twist) for way in (reach, -reach))])
        sides = np.sign(np.linalg.det(span_rows(rows, probes)[1]))
        if not (sides == sides[0]).all():
            raise TrajectoryError(
                f"start: within its uncertainty lies a singular pose (worst pressure angle {np.degrees(self._start_angle):.1f} deg at the "
                f"stated one; badly seen: {split.lost.said}): in which of two assemblies the run is cannot be told"
            )

    def add(self, lengths: Lengths, *, covariances: bool = True) -> Trajectory:
        """The trajectory of the next piece of the run; without covariances theirs are zero, for a quarter of the time."""
        scheme, lengths = self.scheme, self.corrected(lengths, self._state)
        begun = self._state.copy()
        found, compiled = self._next(lengths.change_mm, lengths.flags)
        poses, residual, iterations, status, angle, *_ = found
        cause = np.where(status == lengths.flags, lengths.cause, _TEXTS[status])
        cable, left_out, chi_squared = np.where(status == lengths.flags, lengths.cable, ""), None, None
        if not scheme.six:
            left_out = np.isnan(lengths.change_mm)
            cause, cable = self._remarks(lengths, status, left_out, cause, cable)
        # with as many cables as unknowns it is the solver's, not the lengths'
        residual = np.where(np.isfinite(lengths.change_mm).sum(axis=1) > len(scheme.free), residual, np.nan)
        cause = self._explained(cause, status, poses, angle, lengths.change_mm, begun)
        random = systematic = np.broadcast_to(np.zeros((6, 6)), (len(poses), 6, 6))
        if covariances:
            travel = self.budget.travel(lengths, self._travelled)
            random, systematic = self.budget.covariances(poses, lengths, left_out, compiled, travel=travel)
            if self.redundancy is not None:
                parities = self.redundancy.parities(self.redundancy.epochs(lengths, travel), poses)
                chi_squared = np.where(parities.freedom > 0, parities.chi_squared, np.nan)
        trajectory = Trajectory(
            lengths.time_s,
            poses,
            residual,
            iterations,
            status,
            cause,
            cable,
            np.degrees(angle),
            random,
            systematic,
            self.covers,
            (*lengths.notes, *self._notes()),
            chi_squared,
            self.budget.taken_as_exact(poses, lengths),
        )
        return _without_orientation(trajectory) if scheme.point else trajectory

    def examined(self, pieces: Iterable[Lengths]) -> Iterator[tuple[Lengths, FloatArray, FloatArray, FloatArray | None]]:
        """Of a run whose cables are redundant, one piece after the other: its lengths as they are used, its poses (n, 7), chi-squared (n,)
        by the counts alone, and which way the cables travelled last. Where this reconstruction has got to is not touched."""
        state, travelled = self._new_state(self.start), np.zeros((len(self.scheme.rows), 2))
        for piece in pieces:
            lengths = self.corrected(piece, state)
            poses, *_, chi_squared = self._follow(self.scheme.rows, self.start, state, lengths.change_mm, lengths.flags)
            yield lengths, poses, chi_squared, self.budget.travel(lengths, travelled)

    def corrected(self, lengths: Lengths, state: FloatArray | None = None) -> Lengths:
        """The lengths without the effects of temperature, stretch and sag that the rig states; state is where the run has got to, by
        default its start."""
        if self.budget.told is not None or self.budget.supposed.any():
            lengths = replace(lengths, change_mm=lengths.change_mm - self.budget.offsets(lengths.time_s))
        if self.correction is None:
            return lengths
        begun = self._new_state(self.start) if state is None else state

        def solve(changes: FloatArray) -> FloatArray:
            return np.asarray(self._follow(self.scheme.rows, self.start, begun.copy(), changes, lengths.flags)[0])

        return self.correction.corrected(lengths, solve)

    def solve(self, rows: FloatArray, start: FloatArray, changes: FloatArray, flags: IntArray) -> FloatArray:
        """(n, 7) poses of a whole run by other rows of cables, from another start, changes (n, m) [mm] and flags (n,); NaN where none is
        found."""
        return np.asarray(self._follow(rows, start, self._new_state(start), changes, flags)[0])

    def use(self, told: "Told | None") -> None:
        """Take what the run told of its origins from now on, or forget it."""
        self.budget.use(told)

    def solve_from_told(self, changes: FloatArray) -> FloatArray:
        """(n, 7) poses of samples of a run by changes (n, m) of its channels, NaN for one that is not used."""
        return self.solve(self.scheme.rows, self.start, changes, np.full(len(changes), Status.GAP, np.int64))

    def begun_state(self) -> FloatArray:
        """(8 + m,) where a run has got to at its start, as `kernels.least_squares` has it."""
        return self._new_state(self.start)

    @property
    def zero(self) -> FloatArray:
        """(m,) what its channels read where their change is 0."""
        return self._zero(self.scheme.rows, self.start)

    def _new_state(self, start: FloatArray) -> FloatArray:
        """Where a run has got to at its start, without compiling: the start pose, no change of the cables, not lost."""
        return np.concatenate([start, self._at_start(start), [0.0]])

    def _at_start(self, start: FloatArray) -> FloatArray:
        """(m,) the changes at the start: none but of absolute channels, or where it was found."""
        begun = np.zeros(len(self.scheme.rows)) if self._begun is None else self._begun
        if not self.budget.absolute.any():
            return begun
        return np.where(self.budget.absolute, span_rows(self.scheme.rows, start[None])[0][0], begun)

    def _zero(self, rows: FloatArray, start: FloatArray) -> FloatArray:
        """(m,) what channels, rows (m, columns), read where their change is 0."""
        begun = 0.0 if self._begun is None else self._begun
        return np.where(self.budget.absolute, 0.0, span_rows(rows, start[None])[0][0] - begun)

    def _next(self, changes: FloatArray, flags: IntArray) -> tuple[tuple[Any, ...], bool]:
        """The next samples, and whether by the compiled kernels: not as long as they are few and plain."""
        found = None
        if self.scheme.six and not self._many and len(changes) < COMPILING_PAYS:
            found = reference.follow(self.scheme.rows, self.start, self._state, changes, flags=flags)
        self._many = self._many or found is None or len(changes) > 1
        if found is not None:
            return found, False
        return self._follow(self.scheme.rows, self.start, self._state, changes, flags), True

    def _follow(self, rows: FloatArray, start: FloatArray, state: FloatArray, changes: FloatArray, flags: IntArray) -> tuple[Any, ...]:
        u = np.sqrt(self.budget.length_variance)
        if self.scheme.six:
            follow = follow_lanes if len(changes) >= COMPILING_PAYS else resume_screw
            return tuple(follow(rows, start, state, changes, flags, u))
        in_lanes = len(changes) >= LANES_PAY and self.scheme.redundancy and len(self.scheme.free) == len(FREEDOMS)
        by = follow_redundant_lanes if in_lanes else follow_least_squares
        return tuple(by(rows, start, self._zero(rows, start), state, changes, flags, u, self.scheme.free_index))

    def _remarks(
        self, lengths: Lengths, status: IntArray, left_out: BoolArray, cause: TextArray, cable: TextArray
    ) -> tuple[TextArray, TextArray]:
        """Causes and cables of samples that are good without some of the cables, left_out (n, m), and what a scheme does not measure."""
        ok = status == Status.OK
        cause, cable = cause.copy(), np.where(ok, "", cable)
        cause[ok] = NOT_MEASURED if self.scheme.point else ""
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

    def _lost_at(self, pose: FloatArray) -> str:
        split = split_at(self.scheme.rows, pose, self.scheme.free_index, np.sqrt(self.budget.length_variance))
        return f"; not determined: {split.lost.said}"

    def _explained(
        self, cause: TextArray, status: IntArray, poses: FloatArray, angle: FloatArray, changes: FloatArray, begun: FloatArray
    ) -> TextArray:
        """The causes with what is lost at singular samples and nearly lost at known ones; begun is the state before these samples."""
        singular = status == Status.SINGULAR
        near = (status == Status.OK) & (angle > np.radians(NEARLY))
        if not (singular.any() or near.any()):
            return cause
        cause, u, free = cause.copy(), np.sqrt(self.budget.length_variance), self.scheme.free_index
        m = len(u)
        before = np.maximum.accumulate(np.where(status == Status.OK, np.arange(len(status)), -1))
        for last in np.unique(before[singular]):
            pose, there = (begun[:CHANGES], begun[CHANGES : CHANGES + m]) if last < 0 else (poses[last], changes[last])
            mine = np.flatnonzero(singular & (before == last))
            explained = explain(split_at(self.scheme.rows, pose, free, u), changes[mine] - there)
            for i, said in zip(mine, explained, strict=True):
                cause[i] = message(JOINED, first=cause[i], then=said)
        for i in np.flatnonzero(near):
            lost = split_at(self.scheme.rows, poses[i], free, u).lost
            remark = message("cause.nearly_singular", screw=lost.said, mm=lost.mm_per_mm)
            cause[i] = message(JOINED, first=cause[i], then=remark) if cause[i] else remark
        return cause

    def _notes(self) -> tuple[Message, ...]:
        point = self.scheme.point
        notes = []
        if point:
            notes.append(message("scheme.point", point=point))
        if self.scheme.constraint:
            notes.append(message("scheme.held", freedoms=self.scheme.held, constraint=self.scheme.constraint))
        if self._start_angle > START_CLEAR:
            notes.append(message("start.angle", angle_deg=float(np.degrees(self._start_angle))))
        if self._near is not None:
            notes.append(message("start.near", apart_mm=self._near, fold_mm=self._near / 2.0))
        if self.correction is not None:
            notes += self.correction.notes()
        return tuple(notes)


_TEXTS = np.array([_CAUSES.get(status, "") for status in Status], dtype=np.object_)


def _without_orientation(trajectory: Trajectory) -> Trajectory:
    poses, random, systematic = trajectory.poses.copy(), trajectory.random.copy(), trajectory.systematic.copy()
    poses[:, 3:] = np.nan
    for covariance in (random, systematic):
        covariance[:, :3, :] = covariance[:, :, :3] = np.nan
    return replace(trajectory, poses=poses, random=random, systematic=systematic)
