"""From a trajectory and the program it ran to the characteristics of ISO 9283."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import conventions
from lmeasure.accuracy.radius import exact_radius_95
from lmeasure.certification import direct
from lmeasure.certification.attained import AttainedPose, Frame, attain, attained_poses, fit_frame
from lmeasure.certification.capability import with_vector_verdict, with_verdict
from lmeasure.certification.characteristic import Characteristic, Rule
from lmeasure.certification.dwells import with_windows
from lmeasure.certification.errors_of_poses import ErrorModel, ErrorsOfFile, ErrorsOfRun, PoseErrors
from lmeasure.certification.figures import (
    SIGNED,
    Figure,
    PosePart,
    compliance_figures,
    distance_figures,
    group_figures,
    pose_figures,
    singular,
)
from lmeasure.certification.path_figures import CornerPart, PathPart, at_corner, corner_figures, corners_of, path_figures
from lmeasure.certification.paths import Crossings, crossings
from lmeasure.certification.rounding import of_dwells
from lmeasure.certification.uncertainty import Moving, Part, Spread, propagate
from lmeasure.errors import CertificationError
from lmeasure.program import Distance, Program
from lmeasure.run import Run
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

SCHEMA = "lmeasure.certificate/1"


@dataclass(frozen=True)
class Settings:
    """What of an evaluation can be chosen; all of it belongs in the certificate.

    align: fit the base frame to the poses before anything else; tool_offset_mm: the point of the tool that is certified, in the tool
    frame; angles: convention of component-wise angles, else the program's, else the rig's; capability: largest u95 as a fraction of the
    characteristic; limit_angle_deg, limit_u95_mm: of the instrument's zone, None for no limit; rule: of decision on tolerances; planes:
    normal to a path; still_mm: largest motion within a window; trials, seed: of Monte Carlo.
    """

    align: bool = False
    angles: str | None = None
    tool_offset_mm: tuple[float, float, float] = (0.0, 0.0, 0.0)
    capability: float = 0.25
    limit_angle_deg: float | None = 60.0
    limit_u95_mm: float | None = None
    rule: Rule = "simple"
    planes: int = 100
    still_mm: float = 0.2
    trials: int = 2000
    seed: int = 0

    def as_dict(self) -> dict[str, Any]:
        """For certificate.json."""
        return {k: list(v) if isinstance(v, tuple) else v for k, v in vars(self).items() if v is not None}


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


PLAIN_ANGLES = "fanuc-wpr"
"""Turns about the fixed X, Y and Z: the standard's a, b, c, where a controller's own angles are singular."""


class _Evaluation:
    """One evaluation: what is known of the parts, gathered step by step."""

    def __init__(self, trajectory: Trajectory, program: Program, settings: Settings, angles: str | None) -> None:
        self.trajectory, self.program, self.settings = trajectory, program, settings
        self.stated = settings.angles or program.angles
        self.angles = self.stated or angles or conventions.DEFAULT
        conventions.convention(self.angles)
        self.notes: list[str] = []
        self.frame = Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64))
        self.poses = attained_poses(trajectory, program, self.frame, settings.still_mm)
        if settings.align:
            self.frame = replace(self.frame, base_from_program=fit_frame(self.poses))
            self.poses = attained_poses(trajectory, program, self.frame, settings.still_mm)
        self.paths = {p.name: crossings(trajectory, p, settings.planes, self.frame) for p in program.path if p.windows_s}
        self.loaded = [
            attain(c.pose, self.commanded(c.pose), c.windows_s, trajectory, self.frame, settings.still_mm) for c in program.compliance
        ]
        self.corners = {
            name: [(corner, [at_corner(c, corner) for c in crossed.cycles]) for corner in corners_of(crossed)]
            for name, crossed in self.paths.items()
        }
        self.excluded: dict[tuple[str, str], str] = {}
        self.samples = self._samples()

    def commanded(self, name: str) -> FloatArray:
        """(7,) the commanded pose of that name."""
        pose = next(p for p in self.program.pose if p.name == name)
        return np.array([*pose.position_mm, *pose.quaternion_xyzw])

    def convention_at(self, what: str, rotation: Rotation) -> str | None:
        """The convention in which angles at these rotations tell something."""
        if not singular(self.angles, rotation):
            return self.angles
        if self.stated is not None or singular(PLAIN_ANGLES, rotation):
            self.notes.append(f"{what}: angles {self.angles!r} are singular at the commanded orientation; no component-wise angles")
            return None
        self.notes.append(f"{what}: angles {self.angles!r} are singular at the commanded orientation; {PLAIN_ANGLES!r} instead")
        return PLAIN_ANGLES

    def _samples(self) -> IntArray:
        """All samples whose errors are asked for, in order."""
        asked = [p.samples for p in (*self.poses, *self.loaded)] + [c.samples.ravel() for c in self.paths.values()]
        asked += [np.array([f[2] for f in found], dtype=np.int64) for corners in self.corners.values() for _, found in corners]
        return np.unique(np.concatenate([*asked, direct.samples_of(self.program, self.trajectory)]))

    def errors_of(self, model: ErrorModel) -> tuple[PoseErrors, str]:
        """Errors of what is certified at all `samples`, and what they hold."""
        errors, covers = model.at(self.trajectory, self.samples)
        return self.frame.of_errors(self.trajectory.poses[self.samples], errors), covers

    def at(self, errors: PoseErrors, samples: IntArray) -> PoseErrors:
        """Of all errors those at some samples."""
        return errors[np.searchsorted(self.samples, samples)]

    def pose_part(self, every: PoseErrors, rounded: bool, pose: AttainedPose, convention: str | None) -> PosePart:
        """A pose with the errors of its dwells."""
        errors = self.at(every, pose.samples)
        if rounded:
            errors = of_dwells(errors, pose.within, pose.between, pose.readings)
        return PosePart(pose, errors, convention)

    def parts(self, every: PoseErrors, rounded: bool) -> tuple[dict[str, Part], list[Figure]]:
        """All parts by one law of errors, and their figures."""
        parts: dict[str, Part] = {}
        poses: dict[str, PosePart] = {}
        figures: list[Figure] = []
        self.notes.clear()
        for pose in self.poses:
            measured = not np.isnan(pose.poses[0, 3])
            turn = Rotation.from_quat(pose.commanded[None, 3:])
            convention = self.convention_at(f"pose {pose.name}", turn) if measured else None
            poses[f"pose {pose.name}"] = part = self.pose_part(every, rounded, pose, convention)
            figures += pose_figures(f"pose {pose.name}", part)
            figures += group_figures(f"pose {pose.name}", part, self.program)
        parts |= poses
        figures += self.distances(poses)
        for i, (asked, loaded) in enumerate(zip(self.program.compliance, self.loaded, strict=True)):
            key = f"compliance {i + 1}"
            parts[key] = part = self.pose_part(every, rounded, loaded, None)
            figures += compliance_figures(key, part, np.array(asked.force_n))
        for path in self.program.path:
            if path.name not in self.paths:
                continue
            crossed = self.paths[path.name]
            key, commanded = f"path {path.name}", crossed.line.orientation(crossed.way_mm)
            convention = None if commanded is None else self.convention_at(key, commanded)
            errors = self.at(every, crossed.samples.ravel())
            parts[key] = part_of_path = PathPart(crossed, errors, convention)
            figures += path_figures(key, part_of_path, path)
            for corner, found in self.corners[path.name]:
                of_corner = self.at(every, np.array([f[2] for f in found], dtype=np.int64))
                name = f"{key} corner {corner.number}"
                parts[name] = CornerPart(np.array([f[0] for f in found]), np.array([f[1] for f in found]), of_corner)
                figures += corner_figures(name, corner, path, len(found))
        return parts, figures

    def distances(self, poses: dict[str, PosePart]) -> list[Figure]:
        """Figures of the distances asked for; by default between P2 and P4, as the standard has it, or the first two poses."""
        names = [p.name for p in self.poses]
        asked = list(self.program.distance)
        if not asked:
            pair = ["P2", "P4"] if {"P2", "P4"} <= set(names) else names[:2]
            if len(pair) == 2 and len({len(poses[f"pose {n}"].attained.poses) for n in pair}) == 1:
                asked = [Distance.model_validate({"from": pair[0], "to": pair[1]})]
        out: list[Figure] = []
        for d in asked:
            keys = f"pose {d.from_pose}", f"pose {d.to_pose}"
            for key, name in zip(keys, (d.from_pose, d.to_pose), strict=True):
                if key not in poses:
                    raise CertificationError(f"distance {d.name}: pose {name} has no windows")
            n = [len(poses[k].attained.poses) for k in keys]
            if n[0] != n[1]:
                raise CertificationError(f"distance {d.name}: {d.from_pose} has {n[0]} cycles and {d.to_pose} {n[1]}")
            out += distance_figures(*keys, poses, d.name)
        return out

    def fitted(self, parts: dict[str, Part]) -> Moving | None:
        """What a fitted frame takes of the errors: the small displacement that the errors of the poses' means make it move by."""
        if not self.settings.align:
            return None
        places: dict[str, FloatArray] = {f"pose {p.name}": p.poses[:, :3] for p in self.poses}
        for i, loaded in enumerate(self.loaded):
            places[f"compliance {i + 1}"] = loaded.poses[:, :3]
        for name, crossed in self.paths.items():
            places[f"path {name}"] = crossed.attained[:, :, :3].reshape(-1, 3)
            for corner, _ in self.corners[name]:
                places[f"path {name} corner {corner.number}"] = np.tile(corner.place, (len(crossed.cycles), 1))
        keys = [f"pose {p.name}" for p in self.poses]
        means = np.array([places[k].mean(axis=0) for k in keys])
        inverse = np.linalg.pinv(np.concatenate([_displacement(m[None])[0, 3:] for m in means]))

        def moved(errors: dict[str, FloatArray]) -> dict[str, FloatArray]:
            of_means = np.concatenate([errors[k][..., 3:].mean(axis=-2) for k in keys], axis=-1)
            twist = of_means @ inverse.T
            return {k: e - np.einsum("nij,...j->...ni", _displacement(places[k]), twist) for k, e in errors.items()}

        return moved

    def exclude(self, parts: dict[str, Part]) -> None:
        """Parts outside the instrument's zone, by the worst pressure angle met and by the radius that holds 95 %."""
        met = [("pose", p.name, p.angle_deg) for p in self.poses] + [("path", n, c.angle_deg) for n, c in self.paths.items()]
        met += [("compliance", p.name, p.angle_deg) for p in self.loaded]
        limit, radius = self.settings.limit_angle_deg, self.settings.limit_u95_mm
        for kind, name, angle in met:
            if limit is not None and angle > limit:
                self.excluded[kind, name] = f"worst pressure angle {angle:.1f} deg; the zone ends at {limit:g} deg"
            elif limit is not None and np.isnan(angle):
                self.notes.append(f"{kind} {name}: its pressure angles are not known, and not held against the zone")
            if radius is None or (kind, name) in self.excluded or f"{kind} {name}" not in parts:
                continue
            e = parts[f"{kind} {name}"].errors
            factors = np.concatenate([e.own, e.shared], axis=2)
            covariance = np.nan_to_num(e.random + factors @ factors.transpose(0, 2, 1))[:, 3:, 3:]
            largest = covariance[int(np.argmax(np.trace(covariance, axis1=1, axis2=2)))]
            u95 = exact_radius_95(np.linalg.eigvalsh(largest))
            if u95 > radius:
                self.excluded[kind, name] = f"U95 of a position {u95:.4g} mm; the zone ends at {radius:g} mm"

    def reason(self, *needs: str) -> str | None:
        """Why a figure of these parts gets no verdict."""
        for (kind, name), why in self.excluded.items():
            if f"{kind} {name}" in needs:
                return f"{kind} {name}: {why}"
        return None

    def reached(self, figures: Callable[..., list[Characteristic]], *given: Any) -> list[Characteristic]:
        """Figures, or a note that the robot does not reach a limit."""
        try:
            return figures(*given)
        except direct.NotReachedError as error:
            self.notes.append(str(error))
            return []

    def from_motion(self, values: dict[tuple[str, str | None], float], laws: Sequence[PoseErrors]) -> list[Characteristic]:
        """Figures that are read from the motion itself; values: the repeatabilities, for want of limit bands."""
        out: list[Characteristic] = []
        motion = direct.Motion(self.trajectory, self.frame, lambda samples: [self.at(e, samples) for e in laws])
        for pose in self.program.pose:
            if pose.settling_s:
                found = self.reached(direct.settling, pose, values.get(("RP_l", pose.name)), motion)
                out += [replace(c, excluded=self.reason(f"pose {pose.name}")) for c in found]
        for asked in self.program.posing:
            found = self.reached(direct.posing, asked, values.get(("RP_l", asked.to_pose)), motion)
            out += [replace(c, excluded=self.reason(f"pose {asked.from_pose}", f"pose {asked.to_pose}")) for c in found]
        for path in self.program.path:
            if path.name not in self.paths:
                continue
            crossed, found = self.paths[path.name], []
            if path.weave_stroke_mm is not None:
                found += direct.weaving(crossed, path, motion)
            if path.stabilisation_mm is not None:
                for corner, _ in self.corners[path.name]:
                    found += self.reached(direct.stabilisation, crossed, corner, path, motion)
            out += [replace(c, excluded=self.reason(f"path {path.name}")) for c in found]
        return out


def _displacement(places: FloatArray) -> FloatArray:
    """(n, 6, 6) what a small twist (rotation; translation) of the frame about its origin does to (rotation; position) at places (n, 3)."""
    out = np.tile(np.eye(6), (len(places), 1, 1))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        out[:, 3 + i, j], out[:, 3 + i, k] = places[:, k], -places[:, j]
    return out


def evaluate(
    trajectory: Trajectory,
    program: Program,
    covariances: ErrorModel | None = None,
    *,
    run: Run | None = None,
    settings: Settings | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Evaluation:
    """The characteristics that the program's poses and paths allow, each with U95 and a verdict.

    covariances: where the errors of poses come from; by default the run's rig and calibration, or without a run the uncertainties of the
    trajectory, whose common part is not known and is therefore taken as whatever is worse for each figure. Parts without windows are looked
    for in the trajectory's rests. CertificationError names the window and sample when a pose or path cannot be told.
    """
    settings = settings or Settings()
    _check(trajectory, program, settings)
    models: tuple[ErrorModel, ...]
    if covariances is not None:
        models = (covariances,)
    elif run is not None:
        models = (ErrorsOfRun(run),)
    else:
        models = (ErrorsOfFile(True), ErrorsOfFile(False))
    program, notes = with_windows(trajectory, program, Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64)), settings.still_mm)
    work = _Evaluation(trajectory, program, settings, run.rig.angles if run is not None else None)
    spreads: list[list[Spread]] = []
    values: list[float] = []
    laws = [work.errors_of(model) for model in models]
    for i, (model, (errors, _)) in enumerate(zip(models, laws, strict=True)):
        parts, figures = work.parts(errors, model.rounded)
        states = {key: part.state(np.zeros((len(part.errors.random), 6)), reduced=False) for key, part in parts.items()}
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
    signed += [c.name in SIGNED for c in extra]
    own = [with_verdict(c, program.tolerance, settings.capability, settings.rule, s) for c, s in zip(found, signed, strict=True)]
    vectors = {(c.name, c.pose, c.path): c for c in own}
    for i, f in enumerate(figures):
        if f.vector is not None and (vector := vectors.get((f.vector, f.pose, f.path))) is not None:
            own[i] = with_vector_verdict(own[i], vector)
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
        (*notes, *work.notes),
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
