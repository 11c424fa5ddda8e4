"""From a trajectory and the program it ran to the characteristics of ISO 9283.

Two kinds of results get no verdict: parts outside the instrument's zone, and parts that depend on doubtful counts.
"""

import math
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import scipy

from lmeasure.accuracy import exact_radius_95
from lmeasure.core import CertificationError, DataFrame, FloatArray, IntArray, Shown, framed
from lmeasure.iso9283.attainment import attained, follows
from lmeasure.iso9283.characteristic import (
    CertificationSettings,
    Characteristic,
    CharacteristicKey,
    Conformity,
    Contribution,
    Rule,
    Verdict,
)
from lmeasure.iso9283.clause import IsoTest, SampleErrors
from lmeasure.iso9283.clauses import clauses_of, signed_names, tests_of
from lmeasure.iso9283.figure import Figure, Subject
from lmeasure.iso9283.motion_readings import Motion, with_windows
from lmeasure.iso9283.paths import LEAST_PLANES, Crossings
from lmeasure.iso9283.uncertainty import NORMAL_95, Spread, on_times, propagate, with_instants
from lmeasure.recording import Program, Run, Tolerance
from lmeasure.text import Message, is_of, message, within
from lmeasure.trajectory import (
    SUSPECTED,
    AttainedPose,
    ErrorModel,
    ErrorsOfCurve,
    ErrorsOfFile,
    ErrorsOfRun,
    Frame,
    PoseErrors,
    Stamps,
    Trajectory,
    finer_trajectory,
    stamps_of,
    window,
)


def conformity(value: float, u95: float, tolerance: Tolerance, rule: Rule) -> Conformity:
    """Compare a value with a tolerance, JCGM 106:2012, 8.2 (simple acceptance) and 8.3 (guarded acceptance, guard band U95).

    Guarded: within the limits by U95 it conforms, outside them by U95 it does not, between them there is no decision.
    """
    rule = tolerance.rule or rule
    lower = -math.inf if tolerance.lower is None else tolerance.lower
    upper = math.inf if tolerance.upper is None else tolerance.upper
    guard = u95 if rule == "guarded" else 0.0
    verdict: Verdict
    if lower + guard <= value <= upper - guard:
        verdict = "conforms"
    elif value < lower - guard or value > upper + guard:
        verdict = "does not conform"
    else:
        verdict = "not decided"
    u = max(u95 / NORMAL_95, 1e-300)
    probability = float(scipy.special.ndtr((upper - value) / u) - scipy.special.ndtr((lower - value) / u))
    return Conformity(tolerance.lower, tolerance.upper, rule, verdict, probability)


def limit_of(value: float, tolerance: Tolerance | None, fraction: float) -> float:
    """Largest u95 with which a value may be stated: a fraction of it, or of half a tolerance of a signed figure, which may well be zero.

    A tolerance of one side reaches from zero.
    """
    if tolerance is None:
        return fraction * abs(value)
    lower = 0.0 if tolerance.lower is None else tolerance.lower
    upper = 0.0 if tolerance.upper is None else tolerance.upper
    return fraction * max(abs(value), 0.5 * abs(upper - lower))


def tolerance_of(c: Characteristic, tolerances: Sequence[Tolerance]) -> Tolerance | None:
    """The first tolerance that names this characteristic, at its pose or path or at all."""
    for t in tolerances:
        here = (t.pose is None and t.path is None) or (t.pose is not None and t.pose == c.pose) or (t.path is not None and t.path == c.path)
        if t.characteristic == c.name and here:
            return t
    return None


def undecided(found: Sequence[Characteristic], tolerances: Sequence[Tolerance]) -> Tolerance | None:
    """Return the first tolerance that no characteristic is compared with, excluded ones included: its name is unknown, or an earlier one
    applies to all."""
    used = {id(tolerance_of(c, tolerances)) for c in found}
    return next((t for t in tolerances if id(t) not in used), None)


def with_verdicts(
    found: Sequence[Characteristic],
    *,
    vectors: Mapping[CharacteristicKey, CharacteristicKey],
    signed: Sequence[str],
    tolerances: Sequence[Tolerance],
    settings: CertificationSettings,
) -> tuple[Characteristic, ...]:
    """Return all characteristics with their verdicts; vectors: the vector of each component; signed: names of others that may be zero
    without being bad."""
    own = [with_verdict(c, tolerances, settings, signed=c.key in vectors or c.name in signed) for c in found]
    known = {c.key: c for c in own}
    return tuple(with_vector_verdict(c, known[vectors[c.key]], settings.capability) if vectors.get(c.key) in known else c for c in own)


def with_verdict(c: Characteristic, tolerances: Sequence[Tolerance], settings: CertificationSettings, *, signed: bool) -> Characteristic:
    """The characteristic with its own verdict of capability and conformity; none when it is excluded."""
    tolerance = tolerance_of(c, tolerances)
    limit = limit_of(c.value, tolerance if signed else None, settings.capability)
    if c.excluded is not None:
        return replace(c, capable=False, limit_u95=None, conformity=None)
    found = None if tolerance is None else conformity(c.value, c.u95, tolerance, settings.rule)
    return replace(c, capable=bool(c.u95 <= limit), limit_u95=limit, conformity=found)


def with_vector_verdict(c: Characteristic, vector: Characteristic, fraction: float) -> Characteristic:
    """Return a signed component with the verdict of its vector, unless a tolerance gave it one: near zero it is always small beside its
    uncertainty. Its verdict alone is stored beside."""
    c = replace(c, capable_alone=c.excluded is None and bool(c.u95 <= limit_of(c.value, None, fraction)))
    if c.conformity is not None or c.excluded is not None:
        return c
    return replace(c, capable=vector.capable, limit_u95=vector.limit_u95, note=message("verdict.of_vector", vector=vector.name))


ORDER = ("pose", "path", "compliance", "settling", "posing")
"""Order of the kinds of parts in certificates."""


class Exclusions(NamedTuple):
    """Reasons why parts get no verdict, and parts that could not be compared with the zone."""

    reasons: Mapping[Subject, Message]
    findings: tuple[Message, ...] = ()

    def reason(self, needs: Sequence[Subject]) -> Message | None:
        """Return the reason why a figure of these parts gets no verdict."""
        first = next((s for s in self.reasons if s in needs), None)
        return None if first is None else message("excluded.part", part=first.said, reason=self.reasons[first])


def exclusions(
    tests: Sequence[IsoTest], trajectory: Trajectory, settings: CertificationSettings, laws: Sequence[SampleErrors]
) -> Exclusions:
    """Return the exclusions of tests with windows, by the worst pressure angle there, the radius that holds 95 % of a position by any of
    the laws of errors, and samples with counts suspected lost."""
    held = sorted((t for t in tests if t.windows), key=lambda t: ORDER.index(t.subject.kind))
    reasons: dict[Subject, Message] = {}
    findings = []
    limit, radius = settings.limit_angle_deg, settings.limit_u95_mm
    for test in held:
        if limit is not None and test.angle_deg > limit:
            reasons[test.subject] = message("zone.angle", angle_deg=test.angle_deg, limit_deg=limit)
        elif limit is not None and np.isnan(test.angle_deg):
            findings.append(message("zone.unknown", part=test.subject.said))
    for test in held:
        errors = [] if radius is None or test.subject in reasons else [test.excludable(law) for law in laws]
        u95 = next((u for e in errors if e is not None and (u := largest_radius_95(e)) > (radius or 0.0)), None)
        if u95 is not None:
            reasons[test.subject] = message("zone.radius", u95_mm=u95, limit_mm=radius)
    reasons = {subject: reasons[subject] for subject in sorted(reasons, key=[t.subject for t in held].index)}
    suspected = {cause: found for cause in set(trajectory.cause.tolist()) if (found := within(cause, SUSPECTED)) is not None}
    for test in held if suspected else ():
        windows = [window(trajectory, *w, str(test.subject.said)) for w in test.windows]
        seen = {cause for samples in windows for cause in trajectory.cause[samples].tolist()} & suspected.keys()
        if seen:
            reasons[test.subject] = message(SUSPECTED, step=suspected[min(seen)].values["step"])
    return Exclusions(reasons, tuple(findings))


def largest_radius_95(errors: PoseErrors) -> float:
    """Radius of the sphere [mm] that holds 95 % of the error of a position, of the pose where it is the largest."""
    covariance = errors.covariance[:, 3:, 3:]
    largest = covariance[int(np.argmax(np.trace(covariance, axis1=1, axis2=2)))]
    return exact_radius_95(np.linalg.eigvalsh(largest))


SCHEMA = "lmeasure.certificate/1"
HALF = 0.5
"""Expanded uncertainty of a correction, as a share of it."""
NEGLIGIBLE = 1e-2
"""Largest share of U95 from motion that the samples do not show, with which a bias is still corrected."""


@dataclass(frozen=True)
class Excluded:
    """A part of the program that gets no verdict, and why."""

    kind: str
    name: str
    reason: Message


@dataclass(frozen=True)
class AttainedPath:
    """Run of a path: commanded (m, 3) points [mm] at the planes' arc (m,) [mm]; attained (n, m, 3) crossings [mm] of n cycles, deviation
    (n, m) their distance from the commanded points, speed (n, m - 1) between the planes [mm/s]; unseen: the first part of the path without
    samples in a cycle, in words."""

    name: str
    arc_mm: FloatArray
    commanded: FloatArray
    attained: FloatArray
    deviation_mm: FloatArray
    speed_mm_s: FloatArray
    commanded_speed_mm_s: float | None
    unseen: str | None = None


@dataclass(frozen=True, repr=False)
class Evaluation(Shown):
    """Characteristics of a robot by ISO 9283, each with its U95.

    Examples
    --------
    >>> figures = lm.evaluate(trajectory, program, run=simulated, rig=calibration)
    >>> figures.characteristics[0].unit
    'mm'
    """

    characteristics: tuple[Characteristic, ...]
    """Characteristics with U95 and verdict."""
    excluded: tuple[Excluded, ...]
    """Poses and paths without a verdict, with the reason."""
    poses: tuple[AttainedPose, ...]
    """Commanded and attained poses in the base frame; after an alignment, in the program's frame."""
    paths: tuple[AttainedPath, ...]
    """Commanded and attained paths in the same frame."""
    base_from_program: FloatArray | None
    """(7,) fitted frame, x, y, z [mm], qx, qy, qz, qw; None: no alignment."""
    angles: str
    """Angle convention of component-wise angles."""
    covers: Message | str
    """Effects included in the uncertainties, in words."""
    settings: CertificationSettings
    """CertificationSettings of the evaluation."""
    notes: tuple[Message | str, ...] = ()
    """Findings for the user."""
    correlation: FloatArray | None = field(default=None, compare=False)
    """Correlation (n, n) of the errors of the first n characteristics, those with a linear law; None if the errors of poses have no stated
    correlation."""

    def about(self) -> dict[str, str]:
        """Return how many characteristics, of how many the instrument is capable."""
        capable = sum(c.capable for c in self.characteristics)
        return {"characteristics": str(len(self.characteristics)), "capable": str(capable), "u95 covers": str(self.covers)}

    def to_frame(self) -> DataFrame:
        """A row for each characteristic."""
        return framed([c.as_dict() for c in self.characteristics])


def evaluate(
    trajectory: Trajectory,
    program: Program,
    covariances: ErrorModel | None = None,
    *,
    run: Run | None = None,
    settings: CertificationSettings | None = None,
    progress: Callable[[int, int], None] | None = None,
    stamps: Stamps | None = None,
) -> Evaluation:
    """Evaluate the characteristics that the program's poses and paths allow, each with U95 and a verdict.

    covariances: source of the errors of poses; by default the run's rig and calibration, or without a run the uncertainties of the
    trajectory, whose common part is unknown and is therefore the worse one for each figure. With `ErrorsOfCurve` the trajectory is that of
    a curve, which is evaluated between the samples too. Parts without windows are searched in the trajectory's rests. stamps: known
    judgement of the times, else by the motion itself. CertificationError names the window and sample of a pose or path that cannot be
    determined.
    """
    settings = settings or CertificationSettings()
    _check(trajectory, program, settings)
    models: tuple[ErrorModel, ...]
    if covariances is not None:
        models = (covariances,)
    elif run is not None:
        models = (ErrorsOfRun(run),)
    else:
        models = (ErrorsOfFile(together=True), ErrorsOfFile(together=False))
    if isinstance(covariances, ErrorsOfCurve):
        stamps = stamps_of(trajectory)
        if stamps.kind != "sound":
            raise CertificationError(message("error.curve_of_jitter"))
        trajectory, of = finer_trajectory(trajectory, covariances.curve)
        at_s = trajectory.time_s
        stretch = None if stamps.stretch is None else stamps.stretch[of]
        stamps = replace(stamps, stamp_s=at_s, time_s=at_s, stretch=stretch, read=np.diff(of, prepend=-1) > 0)
    stamps = stamps or stamps_of(trajectory)
    trajectory = replace(trajectory, time_s=stamps.time_s)
    program = on_times(program, stamps)
    program, found_windows = with_windows(
        trajectory, program, Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64)), settings.still_mm
    )
    given = attained(trajectory, program, settings, stamps, rig_angles=None if run is None else run.rig.angles)
    clauses = clauses_of(program.characteristics)
    tests = tests_of(clauses, given)
    samples = np.unique(np.concatenate([test.samples() for test in tests]))
    laws = [_Law.of(model, replace(trajectory, time_s=stamps.stamp_s), samples, given.frame) for model in models]
    figures = [figure for test in tests for figure in test.figures()]
    values, spreads = _drawn(tests, figures, laws, settings, progress=progress)
    excluded = exclusions(tests, trajectory, settings, laws)
    found = [
        _characteristic(figure, value, [s[i] for s in spreads], excluded=excluded, stamps=stamps, joint=laws[0].errors.joint)
        for i, (figure, value) in enumerate(zip(figures, values, strict=True))
    ]
    motion = Motion(trajectory, given.frame, lambda at: [law(at) for law in laws], stamps=stamps, settings=settings)
    known = {c.key: c.value for c in found}
    read = [(test, test.read(motion, known)) for test in tests]
    found += [replace(c, excluded=excluded.reason(test.needs)) for test, reported in read for c in reported.characteristics]
    twice = [str(key) for key, times in Counter(c.key for c in found).items() if times > 1]
    if twice and program.characteristics:
        added = ", ".join(program.characteristics)
        raise CertificationError(message("error.characteristics_is_computed_twice", twice=twice[0], added=added))
    vectors = {f.key: f.key._replace(name=f.vector) for f in figures if f.vector is not None}
    judged = with_verdicts(found, vectors=vectors, signed=signed_names(clauses), tolerances=program.tolerance, settings=settings)
    unstated = () if covariances is not None or run is not None else _unstated(trajectory, settings)
    return Evaluation(
        characteristics=tuple(c.unstated() if "position" in unstated or c.unit in unstated else c for c in judged),
        excluded=tuple(Excluded(subject.kind, subject.name, why) for subject, why in excluded.reasons.items()),
        poses=tuple(given.poses.values()),
        paths=tuple(_attained_path(name, crossed) for name, crossed in given.paths.items()),
        base_from_program=given.frame.base_from_program,
        angles=given.angles,
        covers=laws[0].covers,
        settings=settings,
        correlation=_correlation(spreads[0]) if len(laws) == 1 and figures else None,
        notes=(
            *((message("uncertainty.unstated", what=trajectory.absent),) if unstated else ()),
            *stamps.notes,
            *found_windows,
            *(said for test in tests for said in test.findings),
            *excluded.findings,
            *(said for _, reported in read for said in reported.findings),
        ),
    )


@dataclass(frozen=True)
class _Law:
    """Errors of the certified point at all samples (n,) of the tests, by one law, with their structure; together: those of a curve, at
    joint samples."""

    samples: IntArray
    errors: PoseErrors
    covers: Message | str
    together: SampleErrors | None = None

    @classmethod
    def of(cls, model: ErrorModel, trajectory: Trajectory, samples: IntArray, frame: Frame) -> "_Law":
        """Return the errors at the certified point and in the certified frame."""

        def at(some: IntArray) -> tuple[PoseErrors, Message | str]:
            errors, covers = model.at(trajectory, some)
            return frame.of_errors(trajectory.poses[some], errors), covers

        together = isinstance(model, ErrorsOfCurve)
        return cls(samples, *at(samples[:1] if together else samples), (lambda some: at(some)[0]) if together else None)

    def __call__(self, samples: IntArray) -> PoseErrors:
        """Return the errors at some samples."""
        if self.together is not None:
            return self.together(samples)
        return self.errors[np.searchsorted(self.samples, samples)]


def _drawn(
    tests: Sequence[IsoTest],
    figures: Sequence[Figure],
    laws: Sequence[_Law],
    settings: CertificationSettings,
    *,
    progress: Callable[[int, int], None] | None,
) -> tuple[list[float], list[list[Spread]]]:
    """Return the values of figures, and their errors by each law."""
    values, spreads = [], []
    for i, law in enumerate(laws):
        parts = {key: part for test in tests for key, part in test.parts(law).items()}
        states = {key: part.state(np.zeros((len(part.errors), 6)), reduced=False) for key, part in parts.items()}
        values = [float(f.of(states)) for f in figures]

        def step(done: int, of: int, i: int = i) -> None:
            if progress is not None:
                progress(i * of + done, len(laws) * of)

        fitted = follows(parts) if settings.align else None
        of = [f.of for f in figures]
        spreads.append(propagate(parts, of, trials=settings.trials, seed=settings.seed, fitted=fitted, progress=step))
    return values, spreads


def _correlation(spreads: Sequence[Spread]) -> FloatArray:
    """(n, n) of n figures from their derivatives; of one without error nothing but its own 1."""
    rows = np.array([s.sensitivities for s in spreads])
    size = np.linalg.norm(rows, axis=1)
    unit = rows / np.where(size > 0.0, size, 1.0)[:, None]
    out = unit @ unit.T
    np.fill_diagonal(out, 1.0)
    return np.asarray(np.clip(out, -1.0, 1.0))


def _unstated(trajectory: Trajectory, settings: CertificationSettings) -> tuple[str, ...]:
    """Return the parts of a foreign trajectory without a stated uncertainty; "position" leaves all results without a verdict, "deg" those
    in that unit."""
    if "position" in trajectory.absent or ("rotation" in trajectory.absent and any(settings.tool_offset_mm)):
        return ("position",)
    return ("deg",) if "rotation" in trajectory.absent else ()


def _check(trajectory: Trajectory, program: Program, settings: CertificationSettings) -> None:
    """Raise an error for inputs that determine no figure."""
    if not (program.pose or program.path):
        raise CertificationError(message("error.the_program_has_neither"))
    back = np.flatnonzero(~(np.diff(trajectory.time_s) > 0.0))
    if len(back):
        i = int(back[0]) + 1
        raise CertificationError(message("error.sample_of_the_trajectory", i=i, time_s=trajectory.time_s[i]))
    measured = not (np.isnan(trajectory.poses[:, 3]).all() and not np.isnan(trajectory.poses[:, 0]).all())
    if not measured and any(settings.tool_offset_mm):
        raise CertificationError(message("error.the_trajectory_has_no"))
    for name in ("capability", "planes", "still_mm", "trials"):
        if not getattr(settings, name) > 0:
            raise CertificationError(message("error.is_not_positive", name=name, value=getattr(settings, name)))
    if settings.planes < LEAST_PLANES:
        raise CertificationError(message("error.planes_normal_to_a", planes=settings.planes, least_planes=LEAST_PLANES))


def _characteristic(
    figure: Figure, value: float, spreads: Sequence[Spread], *, excluded: Exclusions, stamps: Stamps, joint: bool
) -> Characteristic:
    """The figure with the larger of the uncertainties that the laws of errors give."""
    worst = max(spreads, key=lambda s: s.u95)
    between = (Contribution(message("source.between"), figure.between / NORMAL_95, random=True),) * (figure.between > 0.0)
    # the largest of many places of a smooth path is one that erred outwards: by how much on average is known
    hides = any(is_of(row.source, "source.between") and row.contribution > NEGLIGIBLE * worst.u95 for row in worst.budget)
    corrected = figure.extreme and joint and not hides
    # the correction depends on the true path, which is known by its likely shape alone
    u95 = float(np.hypot(worst.u95_corrected, HALF * worst.bias)) if corrected else worst.u95
    found = Characteristic(
        **figure.key._asdict(),
        clause=figure.clause,
        value=max(value - worst.bias, 0.0) if corrected else value,
        unit=figure.unit,
        u95=u95,
        capable=False,
        cycles=figure.cycles,
        bias=worst.bias,
        u_drawn=worst.u_drawn,
        angles=figure.angles,
        extension=figure.extension,
        excluded=excluded.reason(figure.needs),
        note=message("figure.corrected", bias=worst.bias, unit=figure.unit) if corrected else None,
    ).with_budget((*worst.budget, *between), float(np.hypot(u95, figure.between)))
    return found if figure.instants is None or stamps.kind == "sound" else with_instants(found, figure.instants(value))


def _attained_path(name: str, crossed: Crossings) -> AttainedPath:
    attained = crossed.attained[:, :, :3].transpose(1, 0, 2)
    return AttainedPath(
        name=name,
        arc_mm=crossed.way_mm,
        commanded=crossed.commanded,
        attained=attained,
        deviation_mm=np.linalg.norm(attained - crossed.commanded, axis=2),
        speed_mm_s=crossed.speed_mm_s,
        commanded_speed_mm_s=crossed.line.path.speed_mm_s,
        unseen=crossed.unseen(),
    )
