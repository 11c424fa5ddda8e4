"""From a trajectory and the program it ran to the characteristics of ISO 9283."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from lmeasure.arrays import FloatArray
from lmeasure.certification.attained import AttainedPose, Frame
from lmeasure.certification.capability import with_vector_verdict, with_verdict
from lmeasure.certification.characteristic import Characteristic
from lmeasure.certification.dwells import with_windows
from lmeasure.certification.errors_of_poses import ErrorModel, ErrorsOfFile, ErrorsOfRun
from lmeasure.certification.figures import SIGNED, Figure
from lmeasure.certification.gathered import Gathered
from lmeasure.certification.paths import LEAST_PLANES, Crossings
from lmeasure.certification.settings import Settings as Settings
from lmeasure.certification.timing import on_times, with_time
from lmeasure.certification.uncertainty import Spread, propagate
from lmeasure.errors import CertificationError
from lmeasure.program import Program
from lmeasure.run import Run
from lmeasure.trajectory import Trajectory
from lmeasure.trajectory.stamps import Stamps, stamps_of

SCHEMA = "lmeasure.certificate/1"


@dataclass(frozen=True)
class Excluded:
    """A part of the program that gets no verdict, and why."""

    kind: str
    name: str
    reason: str


@dataclass(frozen=True)
class AttainedPath:
    """How a path was run: commanded (m, 3) points [mm] at arc (m,) [mm], where the planes stand; attained (n, m, 3) crossings
    [mm] of n cycles, deviation (n, m) their distance from the commanded points, speed (n, m - 1) between the planes [mm/s]."""

    name: str
    arc_mm: FloatArray
    commanded: FloatArray
    attained: FloatArray
    deviation_mm: FloatArray
    speed_mm_s: FloatArray
    commanded_speed_mm_s: float | None
    excluded: str | None = None


@dataclass(frozen=True)
class Evaluation:
    """The characteristics, and what stands behind them.

    excluded: parts outside the zone. poses: commanded and attained poses in the base frame (after an alignment, in the
    program's); paths: likewise. base_from_program (7,): the fitted frame, None when not asked for. angles: convention of component-wise
    angles. covers: what the uncertainties hold, in words. notes: for the reader.
    """

    characteristics: tuple[Characteristic, ...]
    excluded: tuple[Excluded, ...]
    poses: tuple[AttainedPose, ...]
    paths: tuple[AttainedPath, ...]
    base_from_program: FloatArray | None
    angles: str
    covers: str
    settings: Settings
    notes: tuple[str, ...] = field(default=())


def evaluate(
    trajectory: Trajectory,
    program: Program,
    covariances: ErrorModel | None = None,
    *,
    run: Run | None = None,
    settings: Settings | None = None,
    progress: Callable[[int, int], None] | None = None,
    stamps: Stamps | None = None,
) -> Evaluation:
    """The characteristics that the program's poses and paths allow, each with U95 and a verdict.

    covariances: where the errors of poses come from; by default the run's rig and calibration, or without a run the uncertainties of the
    trajectory, whose common part is not known and is therefore taken as whatever is worse for each figure. Parts without windows are looked
    for in the trajectory's rests. stamps: as judged already, else by the motion
    itself. CertificationError names the window and sample when a pose or path cannot be told.
    """
    settings = settings or Settings()
    _check(trajectory, program, settings)
    models: tuple[ErrorModel, ...]
    if covariances is not None:
        models = (covariances,)
    elif run is not None:
        models = (ErrorsOfRun(run),)
    else:
        models = (ErrorsOfFile(together=True), ErrorsOfFile(together=False))
    stamps = stamps or stamps_of(trajectory)
    trajectory = replace(trajectory, time_s=stamps.time_s)
    program = on_times(program, stamps)
    program, notes = with_windows(trajectory, program, Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64)), settings.still_mm)
    work = Gathered(trajectory, program, settings, run.rig.angles if run is not None else None, stamps)
    spreads: list[list[Spread]] = []
    values: list[float] = []
    laws = [work.errors_of(model) for model in models]
    for i, (errors, _) in enumerate(laws):
        parts, figures = work.parts(errors)
        states = {key: part.state(np.zeros((len(part.errors), 6)), reduced=False) for key, part in parts.items()}
        values = [float(f.of(states)) for f in figures]

        def step(done: int, of: int, i: int = i) -> None:
            if progress is not None:
                progress(i * of + done, len(models) * of)

        spreads.append(propagate(parts, [f.of for f in figures], settings.trials, settings.seed, work.fitted(parts), step))
        work.exclude(parts)
    found = [
        _characteristic(f, value, [s[i] for s in spreads], work.reason(*f.needs))
        for i, (f, value) in enumerate(zip(figures, values, strict=True))
    ]
    by_name = {(c.name, c.pose): c.value for c in found if c.part is None}
    signed = [f.signed for f in figures]
    extra = work.from_motion(by_name, [errors for errors, _ in laws])
    found += extra
    found = with_time(found, work.paths, program, stamps)
    signed += [c.name in SIGNED for c in extra]
    own = [with_verdict(c, program.tolerance, settings.capability, settings.rule, s) for c, s in zip(found, signed, strict=True)]
    vectors = {(c.name, c.pose, c.path): c for c in own}
    for i, f in enumerate(figures):
        if f.vector is not None and (vector := vectors.get((f.vector, f.pose, f.path))) is not None:
            own[i] = with_vector_verdict(own[i], vector, settings.capability)
    excluded = tuple(Excluded(kind, name, why) for (kind, name), why in work.excluded.items())
    return Evaluation(
        tuple(own),
        excluded,
        tuple(replace(p, excluded=work.excluded.get(("pose", p.name))) for p in work.poses),
        tuple(_attained_path(n, c, work.excluded.get(("path", n))) for n, c in work.paths.items()),
        work.frame.base_from_program,
        work.angles,
        laws[0][1],
        settings,
        (*((stamps.note,) if stamps.note else ()), *notes, *work.notes),
    )


def _check(trajectory: Trajectory, program: Program, settings: Settings) -> None:
    """What no figure can be told from."""
    if not (program.pose or program.path):
        raise CertificationError("the program has neither poses nor paths")
    back = np.flatnonzero(~(np.diff(trajectory.time_s) > 0.0))
    if len(back):
        i = int(back[0]) + 1
        raise CertificationError(
            f"sample {i} of the trajectory: its time, {trajectory.time_s[i]:.6g} s, is not after that of the one before"
        )
    measured = not (np.isnan(trajectory.poses[:, 3]).all() and not np.isnan(trajectory.poses[:, 0]).all())
    if not measured and (settings.align or any(settings.tool_offset_mm)):
        raise CertificationError("the trajectory has no orientation: neither another point of the tool nor a fitted frame can be had")
    for name in ("capability", "planes", "still_mm", "trials"):
        if not getattr(settings, name) > 0:
            raise CertificationError(f"{name} = {getattr(settings, name)} is not positive")
    if settings.planes < LEAST_PLANES:
        raise CertificationError(f"planes = {settings.planes} normal to a path are too few: at least {LEAST_PLANES}")


def _characteristic(figure: Figure, value: float, spreads: Sequence[Spread], excluded: str | None) -> Characteristic:
    """The figure with the larger of the uncertainties that the laws of errors give."""
    worst = max(spreads, key=lambda s: s.u95)
    u = float(np.hypot(worst.u_random, worst.u_systematic))
    return Characteristic(
        name=figure.name,
        clause=figure.clause,
        value=value,
        unit=figure.unit,
        u95=worst.u95,
        capable=False,
        cycles=figure.cycles,
        pose=figure.pose,
        path=figure.path,
        part=figure.part,
        u_random=worst.u_random,
        u_systematic=worst.u_systematic,
        coverage_factor=worst.u95 / u if u > 0 else None,
        angles=figure.angles,
        extension=figure.extension,
        excluded=excluded,
    )


def _attained_path(name: str, crossed: Crossings, excluded: str | None) -> AttainedPath:
    attained = crossed.attained[:, :, :3].transpose(1, 0, 2)
    deviation = np.linalg.norm(attained - crossed.commanded, axis=2)
    speed = crossed.line.path.speed_mm_s
    return AttainedPath(name, crossed.way_mm, crossed.commanded, attained, deviation, crossed.speed_mm_s, speed, excluded)
