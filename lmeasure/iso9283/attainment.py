"""Attained parts of a program in a trajectory: its poses and paths as attained, at one point of the tool and in one frame."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import CertificationError, FloatArray, IntArray, conventions, se3
from lmeasure.iso9283.characteristic import CertificationSettings
from lmeasure.iso9283.figure import Subject, convention_at
from lmeasure.iso9283.motion_readings import Stretch
from lmeasure.iso9283.paths import LEAST_PLANES, Crossings, crossings
from lmeasure.iso9283.uncertainty import Moving, Part, most_planes
from lmeasure.recording import Program, Windows, read_program
from lmeasure.text import Message, message
from lmeasure.trajectory import AttainedPose, Frame, Stamps, Trajectory, attain, in_frame, window, worst_angle


def fit_frame(poses: Sequence[AttainedPose]) -> FloatArray:
    """(7,) base_from_program that brings the commanded positions to the means of the attained ones (least squares, every pose alike).

    CertificationError for fewer than three poses, or on one line.
    """
    commanded = np.array([p.commanded[:3] for p in poses])
    attained = np.array([p.poses[:, :3].mean(axis=0) for p in poses])
    if len(poses) < 3 or np.linalg.svd(commanded - commanded.mean(axis=0), compute_uv=False)[1] < 1.0:
        raise CertificationError(message("error.alignment_poses_with_windows", n_poses=len(poses)))
    middle, place = commanded.mean(axis=0), attained.mean(axis=0)
    turn, _ = Rotation.align_vectors(attained - place, commanded - middle)
    return se3.pose(place - turn.apply(middle), turn)


def in_program_frame(trajectory: Trajectory, path: Path) -> Trajectory:
    """Return a trajectory in the frame of a program, fitted to its poses in their windows.

    CertificationError where the program states no windows, or poses fix no frame.
    """
    program = read_program(path)
    if not any(pose.windows_s for pose in program.pose):
        raise CertificationError(message("error.states_no_windows_of", where=path))
    frame = fit_frame(list(_poses(trajectory, program, Frame(np.zeros(3)), STILL_MM).values()))
    both = np.kron(np.eye(2), se3.rotation(frame).inv().as_matrix())
    moved = in_frame(frame, trajectory.poses)
    return replace(trajectory, poses=moved, random=both @ trajectory.random @ both.T, systematic=both @ trajectory.systematic @ both.T)


def follows(parts: Mapping[Subject, Part]) -> Moving:
    """Return the motion of the fitted frame by the errors of all parts: the small displacement by errors of the poses' means."""
    places = {key: part.positions for key, part in parts.items()}
    fitted = [key for key in parts if key.kind == "pose"]
    inverse = np.linalg.pinv(np.concatenate([se3.at_points(places[k].mean(axis=0))[3:] for k in fitted]))

    def moved(errors: dict[Subject, FloatArray]) -> dict[Subject, FloatArray]:
        of_means = np.concatenate([errors[k][..., 3:].mean(axis=-2) for k in fitted], axis=-1)
        twist = of_means @ inverse.T
        return {k: e - np.einsum("nij,...j->...ni", se3.at_points(places[k]), twist) for k, e in errors.items()}

    return moved


STILL_MM = 0.2
"""Largest motion within a window of a pose, by default."""
ELSEWHERE = 3.0
"""Times as far from the commanded pose as from another one of the program: the robot is at that one."""
LARGEST_MISS = 0.05
"""Largest distance, as a part of a program's size, of a robot that misses poses; beyond it is another fault."""

Convention = tuple[str | None, tuple[Message, ...]]
"""Convention of component-wise angles, None if angles are not meaningful, and remarks."""


@dataclass(frozen=True, kw_only=True)
class Attainment:
    """Poses and paths by their names, those with windows alone; angles: convention of component-wise angles, stated: whether you chose it.
    stamps: recorded times of the trajectory, if its samples have corrected times."""

    trajectory: Trajectory
    program: Program
    settings: CertificationSettings
    stamps: Stamps
    frame: Frame
    poses: Mapping[str, AttainedPose]
    paths: Mapping[str, Crossings]
    angles: str
    stated: bool

    def commanded(self, name: str) -> FloatArray:
        """(7,) the commanded pose of that name."""
        return _commanded(self.program, name)

    def convention_of_pose(self, pose: AttainedPose) -> Convention:
        """Return the convention of its angles; none where its orientation is not measured."""
        if np.isnan(pose.poses[0, 3]):
            return None, ()
        part = Subject("pose", pose.name).said
        return convention_at(self.angles, se3.rotation(pose.commanded[None]), part, stated=self.stated)

    def convention_on_path(self, crossed: Crossings) -> Convention:
        """Return the convention of its angles; none where its orientation is not commanded, or not measured."""
        commanded = crossed.line.orientation(crossed.way_mm)
        if commanded is None:
            return None, ()
        part = Subject("path", crossed.line.path.name).said
        convention, findings = convention_at(self.angles, commanded, part, stated=self.stated)
        return None if np.isnan(crossed.attained[0, 0, 3]) else convention, findings

    def worst_angle(self, windows: Windows, what: str) -> float:
        """Worst pressure angle [deg] met in windows, NaN where it is not known."""
        return worst_angle(self.trajectory, windows, what)


def attained(
    trajectory: Trajectory, program: Program, settings: CertificationSettings, stamps: Stamps, *, rig_angles: str | None
) -> Attainment:
    """Return the attained poses and paths of a program. rig_angles: the rig's convention of angles, used by default. CertificationError
    names the window and the sample of a pose or path that cannot be determined."""
    stated = settings.angles or program.angles
    angles = stated or rig_angles or conventions.DEFAULT
    conventions.convention(angles)
    frame = Frame(np.asarray(settings.tool_offset_mm, dtype=np.float64))
    poses = _poses(trajectory, program, frame, settings.still_mm)
    if settings.align:
        frame = replace(frame, base_from_program=fit_frame(list(poses.values())))
        poses = _poses(trajectory, program, frame, settings.still_mm)
    _check_order(list(poses.values()), program, settings.still_mm)
    paths = {}
    for path in program.path:
        if path.windows_s:
            shortest = min(end - start for start, end in path.windows_s)
            planes = max(LEAST_PLANES, min(settings.planes, most_planes(stamps, shortest)))
            paths[path.name] = crossings(trajectory, path, planes, frame, quarters=settings.quarters, read=stamps.read)
    return Attainment(
        trajectory=trajectory,
        program=program,
        settings=settings,
        stamps=stamps,
        frame=frame,
        poses=poses,
        paths=paths,
        angles=angles,
        stated=stated is not None,
    )


def places_in(trajectory: Trajectory, windows: Windows, what: str) -> IntArray:
    """(k,) samples where windows begin and where the robot comes to rest in them."""
    parts = [window(trajectory, *w, what) for w in windows]
    return np.array([part.start + i for part in parts for i in (0, Stretch.rested(part.stop - part.start)[0])], dtype=np.int64)


def _commanded(program: Program, name: str) -> FloatArray:
    pose = next(p for p in program.pose if p.name == name)
    return np.array([*pose.position_mm, *pose.quaternion_xyzw])


def _poses(trajectory: Trajectory, program: Program, frame: Frame, still_mm: float) -> dict[str, AttainedPose]:
    return {
        p.name: attain(p.name, _commanded(program, p.name), p.windows_s, trajectory, frame=frame, still_mm=still_mm, dither_s=p.dither_s)
        for p in program.pose
        if p.windows_s
    }


def _check_order(poses: Sequence[AttainedPose], program: Program, still_mm: float) -> None:
    """Raise CertificationError if a dwell is at another pose of the program than its window's. Poses about as near to each other as the
    robot's errors cannot be distinguished, and a robot that misses its poses as a whole runs in order."""
    if not poses:
        return
    commanded = np.array([p.position_mm for p in program.pose])
    distances = [np.linalg.norm(pose.poses[:, None, :3] - commanded[None], axis=2) for pose in poses]
    nearest = np.concatenate([d.min(axis=1) for d in distances])
    miss = float(np.median(nearest))
    misses = min(miss, LARGEST_MISS * float(np.ptp(commanded, axis=0).max()))
    for pose, apart in zip(poses, distances, strict=True):
        own = np.linalg.norm(pose.poses[:, :3] - pose.commanded[:3], axis=1)
        apart[:, np.linalg.norm(commanded - pose.commanded[:3], axis=1) <= ELSEWHERE * misses] = np.inf
        for j in np.flatnonzero(own > ELSEWHERE * np.maximum(apart.min(axis=1), still_mm)):
            if ELSEWHERE * _besides_a_frame(poses) < np.sqrt(np.mean(nearest**2)):
                return
            other = program.pose[int(np.argmin(apart[j]))].name
            said = message("iso.other_order")
            if ELSEWHERE**2 * miss > own[j]:
                said = message("iso.far_from_all", miss=miss)
            raise CertificationError(
                message(
                    "error.pose_cycle_at_s",
                    name=pose.name,
                    j=j + 1,
                    time_s=pose.time_s[j],
                    own=own[j],
                    apart=apart[j].min(),
                    other=other,
                    said=said,
                )
            )


def _besides_a_frame(poses: Sequence[AttainedPose]) -> float:
    """Return the distance [mm] of the poses from their own commanded ones in a frame fitted to them, infinite if they fix none."""
    try:
        frame = fit_frame(poses)
    except CertificationError:
        return np.inf
    turn = se3.rotation(frame[None])[0]
    off = [pose.poses[:, :3] - frame[:3] - turn.apply(pose.commanded[None, :3]) for pose in poses]
    return float(np.sqrt(np.mean(np.concatenate(off) ** 2) * 3.0))
