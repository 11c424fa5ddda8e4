"""A frame of the program that is fitted to the attained poses, and what it takes of their errors."""

from collections.abc import Mapping, Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.certification.figure import Subject
from lmeasure.certification.uncertainty import Moving, Part
from lmeasure.errors import CertificationError
from lmeasure.trajectory.attained import AttainedPose


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
