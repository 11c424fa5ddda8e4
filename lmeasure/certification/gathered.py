"""What a trajectory holds of a program, part by part, and the figures it allows."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import conventions, se3
from lmeasure.accuracy.radius import exact_radius_95
from lmeasure.arrays import FloatArray, IntArray
from lmeasure.certification import direct
from lmeasure.certification.attained import AttainedPose, Frame, attain, attained_poses, check_order, fit_frame, window, worst_angle
from lmeasure.certification.characteristic import Characteristic
from lmeasure.certification.corners import CornerPart, Passing, at_corner, corner_figures, corners_of
from lmeasure.certification.errors_of_poses import ErrorModel, PoseErrors
from lmeasure.certification.figures import (
    Figure,
    PosePart,
    compliance_figures,
    distance_figures,
    group_figures,
    groups_of,
    numbered,
    pose_figures,
    singular,
)
from lmeasure.certification.motion import Motion
from lmeasure.certification.path_figures import PathPart, path_figures
from lmeasure.certification.paths import LEAST_PLANES, Crossings, crossings
from lmeasure.certification.rounding import of_crossings, of_dwells
from lmeasure.certification.settings import Settings
from lmeasure.certification.timing import most_planes
from lmeasure.certification.uncertainty import Moving, Part
from lmeasure.certification.vibration import averaged, with_rest
from lmeasure.certification.weaving import WeavePart, weaves, weaving_figures
from lmeasure.errors import CertificationError
from lmeasure.program import CommandedPath, Distance, Program
from lmeasure.trajectory import Trajectory
from lmeasure.trajectory.evidence import SUSPECTED
from lmeasure.trajectory.stamps import Stamps

PLAIN_ANGLES = "fanuc-wpr"
"""Turns about the fixed X, Y and Z: the standard's a, b, c, where a controller's own angles are singular."""


class Gathered:
    """What a trajectory holds of a program: its poses and paths as attained, their errors, and the figures they allow.

    stamps: those of the trajectory as recorded, which has its samples at their times otherwise.
    """

    def __init__(self, trajectory: Trajectory, program: Program, settings: Settings, angles: str | None, stamps: Stamps) -> None:
        self.trajectory, self.program, self.settings, self.stamps = trajectory, program, settings, stamps
        self.stated = settings.angles or program.angles
        self.angles = self.stated or angles or conventions.DEFAULT
        conventions.convention(self.angles)
        self.notes: list[str] = []
        self.frame = Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64))
        self.poses = attained_poses(trajectory, program, self.frame, settings.still_mm)
        if settings.align:
            self.frame = replace(self.frame, base_from_program=fit_frame(self.poses))
            self.poses = attained_poses(trajectory, program, self.frame, settings.still_mm)
        check_order(self.poses, program, settings.still_mm)
        self.paths = {p.name: self._crossed(p) for p in program.path if p.windows_s}
        self.loaded = [
            attain(c.pose, self.commanded(c.pose), c.windows_s, trajectory, self.frame, settings.still_mm) for c in program.compliance
        ]
        self.corners = {
            name: [
                (corner, [at_corner(c, corner, f"path {name}, cycle {j}") for j, c in enumerate(crossed.cycles, 1)])
                for corner in corners_of(crossed)
            ]
            for name, crossed in self.paths.items()
        }
        self.weaves = {
            p.name: tuple(weaves(self.paths[p.name], p.weave_stroke_mm)) for p in program.path if p.weave_stroke_mm and p.windows_s
        }
        self.excluded: dict[tuple[str, str], str] = {}
        self.samples = self._samples()

    def _crossed(self, path: CommandedPath) -> Crossings:
        shortest = min(end - start for start, end in path.windows_s)
        planes = max(LEAST_PLANES, min(self.settings.planes, most_planes(self.stamps, shortest)))
        return crossings(self.trajectory, path, planes, self.frame)

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
        asked += [self._of_corner(name, passed) for name, corners in self.corners.items() for _, passed in corners]
        asked += [WeavePart.samples(cycles) for cycles in self.weaves.values()]
        return np.unique(np.concatenate([*asked, direct.samples_of(self.program, self.trajectory)]))

    def _of_corner(self, path: str, passed: Sequence[Passing]) -> IntArray:
        """(n,) the samples near a corner of a path at which its n cycles pass."""
        return np.array([c.samples[p.behind.start] for c, p in zip(self.paths[path].cycles, passed, strict=True)], dtype=np.int64)

    def errors_of(self, model: ErrorModel) -> tuple[PoseErrors, str]:
        """Errors of what is certified at all `samples`, and what they hold."""
        errors, covers = model.at(replace(self.trajectory, time_s=self.stamps.stamp_s), self.samples)
        return self.frame.of_errors(self.trajectory.poses[self.samples], errors), covers

    def at(self, errors: PoseErrors, samples: IntArray) -> PoseErrors:
        """Of all errors those at some samples."""
        return errors[np.searchsorted(self.samples, samples)]

    def pose_part(self, every: PoseErrors, pose: AttainedPose, convention: str | None, groups: IntArray) -> PosePart:
        """A pose with the errors of its dwells, which stand in groups (n,) at one place each."""
        errors = self.at(every, pose.samples)
        if every.rounded:
            # what means scatter by because robots swing is not where they rest
            between = pose.between(groups) - pose.vibration.of_mean
            errors = of_dwells(errors, averaged(errors, pose.vibration, pose.readings), between, groups)
        return PosePart(pose, with_rest(errors, pose.vibration, groups), convention, groups)

    def parts(self, every: PoseErrors) -> tuple[dict[str, Part], list[Figure]]:
        """All parts by one law of errors, and their figures."""
        parts: dict[str, Part] = {}
        poses: dict[str, PosePart] = {}
        figures: list[Figure] = []
        self.notes.clear()
        for pose in self.poses:
            measured = not np.isnan(pose.poses[0, 3])
            turn = se3.rotation(pose.commanded[None])
            convention = self.convention_at(f"pose {pose.name}", turn) if measured else None
            poses[f"pose {pose.name}"] = part = self.pose_part(every, pose, convention, groups_of(pose.name, len(pose.poses), self.program))
            figures += pose_figures(f"pose {pose.name}", part)
            figures += group_figures(f"pose {pose.name}", part, self.program)
        parts |= poses
        figures += self.distances(poses)
        for i, (asked, loaded) in enumerate(zip(self.program.compliance, self.loaded, strict=True)):
            key = f"compliance {i + 1}"
            parts[key] = part = self.pose_part(every, loaded, None, numbered(asked.force_n))
            figures += compliance_figures(key, part, np.array(asked.force_n))
        for path in self.program.path:
            if path.name not in self.paths:
                continue
            crossed = self.paths[path.name]
            key, commanded = f"path {path.name}", crossed.line.orientation(crossed.way_mm)
            convention = None if commanded is None else self.convention_at(key, commanded)
            errors = self.at(every, crossed.samples.ravel())
            if every.rounded:
                errors = of_crossings(errors, crossed.weights, crossed.step, crossed.between)
            parts[key] = part_of_path = PathPart(crossed, errors, convention, self.stamps)
            figures += path_figures(key, part_of_path, path)
            for corner, passed in self.corners[path.name]:
                of_corner = self.at(every, self._of_corner(path.name, passed))
                name = f"{key} corner {corner.number}"
                parts[name] = CornerPart(corner, tuple(passed), of_corner)
                figures += corner_figures(name, corner, path, len(passed))
            if path.name in self.weaves:
                cycles = self.weaves[path.name]
                parts[f"{key} weave"] = woven = WeavePart.of(cycles, self.at(every, WeavePart.samples(cycles)))
                figures += weaving_figures(f"{key} weave", woven, path)
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
                key = f"path {name} corner {corner.number}"
                places[key] = np.tile(corner.place, (len(parts[key].errors), 1))
        places |= {f"path {name} weave": WeavePart.positions(cycles) for name, cycles in self.weaves.items()}
        keys = [f"pose {p.name}" for p in self.poses]
        means = np.array([places[k].mean(axis=0) for k in keys])
        inverse = np.linalg.pinv(np.concatenate([se3.at_points(m)[3:] for m in means]))

        def moved(errors: dict[str, FloatArray]) -> dict[str, FloatArray]:
            of_means = np.concatenate([errors[k][..., 3:].mean(axis=-2) for k in keys], axis=-1)
            twist = of_means @ inverse.T
            return {k: e - np.einsum("nij,...j->...ni", se3.at_points(places[k]), twist) for k, e in errors.items()}

        return moved

    def exclude(self, parts: dict[str, Part]) -> None:
        """Parts outside the instrument's zone, by the worst pressure angle met and by the radius that holds 95 %; parts with samples that
        hang on counts suspected lost."""
        met = [("pose", p.name, p.angle_deg) for p in self.poses] + [("path", n, c.angle_deg) for n, c in self.paths.items()]
        met += [("compliance", str(i), p.angle_deg) for i, p in enumerate(self.loaded, 1)]
        moves = [("settling", p.name, p.settling_s) for p in self.program.pose if p.settling_s]
        moves += [("posing", p.name, p.windows_s) for p in self.program.posing]
        met += [(kind, name, worst_angle(self.trajectory, w, f"{kind} {name}")) for kind, name, w in moves]
        limit, radius = self.settings.limit_angle_deg, self.settings.limit_u95_mm
        for kind, name, angle in met:
            if limit is not None and angle > limit:
                self.excluded[kind, name] = f"worst pressure angle {angle:.1f} deg; the zone ends at {limit:g} deg"
            elif limit is not None and np.isnan(angle):
                self.notes.append(f"{kind} {name}: its pressure angles are not known, and not held against the zone")
            if radius is None or (kind, name) in self.excluded or f"{kind} {name}" not in parts:
                continue
            part = parts[f"{kind} {name}"]
            e = part.places if isinstance(part, PathPart) else part.errors
            covariance = e.covariance[:, 3:, 3:]
            largest = covariance[int(np.argmax(np.trace(covariance, axis1=1, axis2=2)))]
            u95 = exact_radius_95(np.linalg.eigvalsh(largest))
            if u95 > radius:
                self.excluded[kind, name] = f"U95 of a position {u95:.4g} mm; the zone ends at {radius:g} mm"
        suspected = {text for text in set(self.trajectory.cause.tolist()) if SUSPECTED in text}
        if suspected:
            windows = [("pose", p.name, p.windows_s) for p in self.program.pose]
            windows += [("path", p.name, p.windows_s) for p in self.program.path]
            windows += [("compliance", str(i), c.windows_s) for i, c in enumerate(self.program.compliance, 1)]
            for kind, name, asked in [*windows, *moves]:
                seen = {t for w in asked for t in self.trajectory.cause[window(self.trajectory, *w, f"{kind} {name}")].tolist()}
                if seen & suspected:
                    text = min(seen & suspected)
                    self.excluded[kind, name] = text[text.index(SUSPECTED) :]

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
        motion = Motion(self.trajectory, self.frame, lambda samples: [self.at(e, samples) for e in laws], self.settings)
        for pose in self.program.pose:
            if pose.settling_s:
                found = self.reached(direct.settling, pose, values.get(("RP_l", pose.name)), motion)
                out += [replace(c, excluded=self.reason(f"pose {pose.name}", f"settling {pose.name}")) for c in found]
        for asked in self.program.posing:
            found = self.reached(direct.posing, asked, values.get(("RP_l", asked.to_pose)), motion)
            out += [replace(c, excluded=self.reason(f"posing {asked.name}")) for c in found]
        for path in self.program.path:
            if path.name not in self.paths:
                continue
            crossed, found = self.paths[path.name], []
            if path.stabilisation_mm is not None:
                for corner, _ in self.corners[path.name]:
                    found += self.reached(direct.stabilisation, crossed, corner, path, motion)
            out += [replace(c, excluded=self.reason(f"path {path.name}")) for c in found]
        return out
