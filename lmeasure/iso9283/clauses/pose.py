"""Pose accuracy and repeatability (clauses 7.2.1 and 7.2.2): the cycles of a pose, and the errors that they have."""

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, IntArray, se3
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, SampleErrors
from lmeasure.iso9283.figure import ANGLES, Figure, Maker, Subject, angle_rates, angles_deg
from lmeasure.iso9283.uncertainty import Part, reduction, reduction_of_mean
from lmeasure.recording import Program
from lmeasure.text import message
from lmeasure.trajectory import AttainedPose, PoseErrors, averaged, of_dwells, with_rest

ZERO = np.zeros(3)
"""Angles are counted from the commanded ones."""


@dataclass(frozen=True, kw_only=True)
class PoseTest(IsoTest):
    """AP always, RP from two cycles on, of one pose; groups (n,): numbers of the groups of its cycles at one place; convention of
    component-wise angles, None where there are none."""

    attained: AttainedPose
    groups: IntArray
    convention: str | None

    def samples(self) -> IntArray:
        return self.attained.samples

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        a = self.attained
        return {self.subject: PosePart(a, of_rests(errors(a.samples), a, self.groups), self.convention, self.groups)}

    def figures(self) -> list[Figure]:
        key, commanded = self.subject, self.attained.commanded[:3]
        n, turns = len(self.attained.poses), not np.isnan(self.attained.poses[0, 3])
        make = Maker(cycles=n, needs=(key,), pose=self.attained.name, angles=self.convention)
        out = [make.one("AP_p", "7.2.1", "mm", lambda s: iso.pose_accuracy(s[key].position, commanded))]
        out += make.components("AP", "7.2.1", lambda s: iso.pose_accuracy_components(s[key].position, commanded), vector="AP_p")
        if turns:
            out.append(make.rotation("AP_rot", "7.2.1", lambda s: iso.rotation_accuracy(s[key].turn_deg)))
        if self.convention is not None:
            out += make.components("AP", "7.2.1", lambda s: iso.orientation_accuracy(s[key].angles_deg, ZERO), ANGLES, vector="AP_rot")
        if n < 2:
            return out
        out.append(make.one("RP_l", "7.2.2", "mm", lambda s: iso.pose_repeatability(s[key].position)))
        if self.convention is not None:
            out += make.components("RP", "7.2.2", lambda s: iso.orientation_repeatability(s[key].angles_deg, ZERO), ANGLES)
        if turns:
            out.append(make.rotation("RP_rot", "7.2.2", lambda s: iso.rotation_repeatability(s[key].turn_deg)))
        return out


def tests(attained: Attainment) -> Iterator[PoseTest]:
    """Return the tests of every pose that has windows."""
    for pose in attained.program.pose:
        if pose.name in attained.poses:
            found = attained.poses[pose.name]
            convention, findings = attained.convention_of_pose(found)
            if pose.dither_mm is not None:
                hz, size = found.vibration.dither_hz, max(map(abs, pose.dither_mm))
                code = "iso.dither_found" if hz else "iso.dither_missing"
                findings = (*findings, message(code, pose=pose.name, mm=size, period_s=1.0 / hz if hz else pose.dither_s))
            yield PoseTest(
                subject=Subject("pose", pose.name),
                windows=pose.windows_s,
                angle_deg=found.angle_deg,
                findings=findings,
                attained=found,
                groups=groups_of(pose.name, len(found.poses), attained.program),
                convention=convention,
            )


@dataclass(frozen=True)
class Cycles:
    """Attained poses: position (..., n, 3) [mm], angles (..., n, 3) [deg] and rotation vector (..., n, 3) [deg, base axes], both counted
    from the commanded orientation; None where the orientation is not measured or the angles are singular."""

    position: FloatArray
    angles_deg: FloatArray | None
    turn_deg: FloatArray | None


@dataclass(frozen=True)
class PosePart:
    """The cycles of a pose with the law of their errors; convention of the angles or None; groups (n,): numbers
    of the groups of cycles at one place; see `uncertainty.Part`."""

    attained: AttainedPose
    errors: PoseErrors
    convention: str | None
    groups: IntArray
    _states: dict[bool, Cycles] = field(init=False, default_factory=dict)
    _rates: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        a, e = self.attained, self.errors
        random = e.random.mean(axis=0)
        laws = [random, *e.covariance_of(np.full((1, len(e)), 1.0 / len(e)))]
        for group in range(int(self.groups.max()) + 1):
            members = self.groups == group
            # errors common to other groups do not separate them
            alone = np.isin(e.place, e.place[~members], invert=True)[:, None, None]
            apart = replace(e, own=e.own[:, :, :0], local=np.where(alone, e.local, 0.0), shared=e.shared[:, :, :0])
            laws.append(random / np.sum(members) + apart.covariance_of(members[None] / np.sum(members))[0])
        turn, angles = self._orientation()
        position = a.poses[:, :3]
        self._states[False] = Cycles(position, angles, turn)
        likely = a.commanded[:3] + _reduced(position - a.commanded[:3], [law[3:, 3:] for law in laws], self.groups)
        likely_turn = None if turn is None else _reduced(turn, [np.degrees(np.degrees(law[:3, :3])) for law in laws], self.groups)
        likely_angles = None
        if angles is not None and self.convention is not None:
            mean = se3.rotation(a.poses).mean()
            rates = angle_rates(self.convention, Rotation.from_quat(mean.as_quat()[None, :]))[0]
            self._rates.append(rates)
            # the standard treats angles one by one, and so does this bias
            of_angles = [rates @ law[:3, :3] @ rates.T for law in laws]
            axes = [slice(i, i + 1) for i in range(3)]
            likely_angles = np.hstack([_reduced(angles[:, i], [law[i, i] for law in of_angles], self.groups) for i in axes])
        self._states[True] = Cycles(likely, likely_angles, likely_turn)

    def _orientation(self) -> tuple[FloatArray | None, FloatArray | None]:
        """Rotation vectors and angles (n, 3) [deg] from the commanded orientation."""
        if np.isnan(self.attained.poses[0, 3]):
            return None, None
        rotation, commanded = se3.rotation(self.attained.poses), se3.rotation(self.attained.commanded)
        turn = np.degrees((rotation * commanded.inv()).as_rotvec())
        if self.convention is None:
            return turn, None
        return turn, iso.wrapped(angles_deg(self.convention, rotation) - angles_deg(self.convention, commanded))

    @property
    def positions(self) -> FloatArray:
        return self.attained.poses[:, :3]

    def state(self, errors: FloatArray, reduced: bool) -> Cycles:
        state, turned = self._states[reduced], errors[..., :3]
        return Cycles(
            state.position + errors[..., 3:],
            None if state.angles_deg is None else state.angles_deg + turned @ self._rates[0].T,
            None if state.turn_deg is None else state.turn_deg + np.degrees(turned),
        )


def _reduced(values: FloatArray, laws: Sequence[FloatArray], groups: IntArray) -> FloatArray:
    """Return deviations (n, d) from the command with their mean, the means of their groups about it and the scatter within groups reduced
    by the part of errors. laws: covariances (d, d) of the errors of one, of the mean, and of the mean of each group."""
    axes, mean = values.shape[1], values.mean(axis=0)
    out = np.tile(reduction_of_mean((mean**2).sum(), np.trace(laws[1]), axes) * mean, (len(values), 1))
    away = np.empty_like(values)
    several = len(laws) > 3
    for group, law in enumerate(laws[2:]):
        members = groups == group
        apart = values[members].mean(axis=0) - mean
        away[members] = values[members] - mean - apart
        if several:
            out[members] += reduction_of_mean((apart**2).sum(), np.trace(law), axes) * apart
    freedom = max(len(values) - len(laws) + 2, 1)
    square, added = (away**2).sum() / freedom, np.trace(laws[0])
    spread = np.trace(laws[0] @ laws[0])
    # effective number of axes with equal errors
    alike = added**2 / spread if spread > 0.0 else 1.0
    less = reduction(square, added, freedom * alike)
    if several and np.bincount(groups).min() > 1 and square > 0.0:
        return np.asarray(out + _alike(away, groups, laws[0], square, float(less)))
    return np.asarray(out + less * away)


def _alike(away: FloatArray, groups: IntArray, law: FloatArray, square: float, less: float) -> FloatArray:
    """Return scatter (n, d) within groups with its size reduced to `less` of it, and the differences of the groups' repeatabilities to the
    least that could have been measured so large.

    With k degrees of freedom the variance of the mean square S + E, E of the errors, is 2 tr E^2 + 4 tr(E S) over k; the relative variance
    of the repeatability is a quarter.
    """
    sizes = np.bincount(groups)
    of_robot = max(square - float(np.trace(law)), 0.0)
    relative = (2.0 * np.trace(law @ law) + 4.0 * np.trace(law) * of_robot / len(law)) / (4.0 * square**2 * (sizes - 1))
    repeatability = np.array([iso.pose_repeatability(away[groups == g]) for g in range(len(sizes))])
    middle = repeatability.mean()
    apart = repeatability - middle
    wanted = less * middle + reduction_of_mean((apart**2).sum(), middle**2 * relative.sum(), len(sizes) - 1) * apart
    factor = np.divide(np.maximum(wanted, 0.0), repeatability, out=np.zeros_like(wanted), where=repeatability > 0.0)
    return np.asarray(factor[groups, None] * away)


def numbered(labels: Sequence[Hashable]) -> IntArray:
    """(n,) numbers of labels, in order of their first use."""
    number = {label: i for i, label in enumerate(dict.fromkeys(labels))}
    return np.array([number[label] for label in labels], dtype=np.int64)


def split(values: FloatArray, labels: Sequence[str]) -> list[FloatArray]:
    """Cycles (..., n, 3) by label, labels in order of their first use."""
    of = np.array(labels)
    return [values[..., of == label, :] for label in dict.fromkeys(labels)]


def groups_of(name: str, cycles: int, program: Program) -> IntArray:
    """(n,) numbers of the groups into which the program divides a pose's cycles: approach, robot and time."""
    pose = next(p for p in program.pose if p.name == name)
    sizes = [d.group for d in program.drift if d.pose == name]
    columns = [pose.approaches or [""] * cycles, pose.units or [""] * cycles, *([j // size for j in range(cycles)] for size in sizes)]
    return numbered(list(zip(*columns, strict=True)))


def of_rests(errors: PoseErrors, pose: AttainedPose, groups: IntArray) -> PoseErrors:
    """Return errors of the means of a pose's dwells, in groups (n,) at one position each, from those of single samples."""
    if errors.rounded:
        # the scatter of means from vibration is not scatter of rest positions
        scatter = pose.scatter_within(groups) - pose.vibration.of_mean
        errors = of_dwells(errors, averaged(errors, pose.vibration, pose.readings), scatter, groups)
    return with_rest(errors, pose.vibration, groups)


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="AP", label="pose accuracy", summary={"AP_p": 10, "AP_rot": 240}, trend="AP_p"),
        Quantity(symbol="RP", label="pose repeatability", summary={"RP_l": 20, "RP_rot": 250}, trend="RP_l"),
    ),
)
