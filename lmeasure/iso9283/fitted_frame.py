"""A frame of the program that is fitted to the attained poses, and what it takes of their errors."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import CertificationError, FloatArray, se3
from lmeasure.iso9283.figure import Subject
from lmeasure.iso9283.uncertainty import Moving, Part
from lmeasure.recording import read_program
from lmeasure.trajectory import AttainedPose, Frame, Trajectory, attain


def fit_frame(poses: Sequence[AttainedPose]) -> FloatArray:
    """(7,) base_from_program that brings the commanded positions to the means of the attained ones (least squares, every pose alike).

    CertificationError for fewer than three poses, or on one line.
    """
    commanded = np.array([p.commanded[:3] for p in poses])
    attained = np.array([p.poses[:, :3].mean(axis=0) for p in poses])
    if len(poses) < 3 or np.linalg.svd(commanded - commanded.mean(axis=0), compute_uv=False)[1] < 1.0:
        raise CertificationError(f"alignment: {len(poses)} poses with windows, or poses on one line, fix no frame; at least three apart")
    middle, place = commanded.mean(axis=0), attained.mean(axis=0)
    turn, _ = Rotation.align_vectors(attained - place, commanded - middle)
    return se3.pose(place - turn.apply(middle), turn)


def in_program_frame(trajectory: Trajectory, path: Path, still_mm: float = 0.2) -> Trajectory:
    """Return a trajectory in the frame of a program, fitted to its poses in their windows.

    CertificationError where the program states no windows, or poses fix no frame.
    """
    program = read_program(path)
    if not any(pose.windows_s for pose in program.pose):
        raise CertificationError(f"{path}: states no windows of poses: `lmeasure program --ran TRAJECTORY --align` fills them in")
    same = Frame(np.zeros(3))
    poses = [
        attain(p.name, np.array([*p.position_mm, *p.quaternion_xyzw]), p.windows_s, trajectory, frame=same, still_mm=still_mm)
        for p in program.pose
        if p.windows_s
    ]
    frame = fit_frame(poses)
    turn = se3.rotation(frame).inv()
    moved = np.full_like(trajectory.poses, np.nan)
    moved[:, :3] = turn.apply(trajectory.poses[:, :3] - frame[:3])
    known = ~np.isnan(trajectory.poses[:, 3])
    if known.any():
        moved[known, 3:] = (turn * se3.rotation(trajectory.poses[known])).as_quat(canonical=True)
    both = np.kron(np.eye(2), turn.as_matrix())
    return replace(trajectory, poses=moved, random=both @ trajectory.random @ both.T, systematic=both @ trajectory.systematic @ both.T)


def follows(parts: Mapping[Subject, Part]) -> Moving:
    """What the frame that is fitted to the poses takes of the errors of all parts: the small displacement that the errors of the poses'
    means make it move by."""
    places = {key: part.positions for key, part in parts.items()}
    fitted = [key for key in parts if key.kind == "pose"]
    inverse = np.linalg.pinv(np.concatenate([se3.at_points(places[k].mean(axis=0))[3:] for k in fitted]))

    def moved(errors: dict[Subject, FloatArray]) -> dict[Subject, FloatArray]:
        of_means = np.concatenate([errors[k][..., 3:].mean(axis=-2) for k in fitted], axis=-1)
        twist = of_means @ inverse.T
        return {k: e - np.einsum("nij,...j->...ni", se3.at_points(places[k]), twist) for k, e in errors.items()}

    return moved
