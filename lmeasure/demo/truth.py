"""What a simulated instrument says, beside the truth it was made from."""

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from lmeasure.core import FloatArray, Status, se3
from lmeasure.rig import Rig
from lmeasure.sensors import span_lengths
from lmeasure.simulation import WORK_SPACE_MM, WORK_TILT_RAD, scattered_poses
from lmeasure.trajectory import Trajectory

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
HELD_OUT_POSES = 150
COVERAGE = 0.95


@dataclass(frozen=True)
class Errors:
    """A trajectory against the truth, over the samples that are ok.

    position_mm (n, 3), rotation_rad (n, 3): small rotation that takes the reconstructed to the true orientation, base axes; NaN where not
    ok. inside_position, inside_rotation: fraction of the samples whose error lies in the stated 95 % region.
    """

    position_mm: FloatArray
    rotation_rad: FloatArray
    inside_position: float
    inside_rotation: float


def errors_of(trajectory: Trajectory, truth: FloatArray) -> Errors:
    """Compare with (n, 7) true poses, sample by sample."""
    ok = trajectory.status == Status.OK
    delta = np.full((len(truth), 6), np.nan)
    delta[ok] = se3.displacement(truth[ok], trajectory.poses[ok])
    rotation, position = delta[:, :3], delta[:, 3:]
    covariance = trajectory.random + trajectory.systematic
    inside = [
        float(np.mean(_mahalanobis(error[ok], covariance[ok][:, part, part]) <= chi2.ppf(COVERAGE, 3)))
        for error, part in ((position, slice(3, 6)), (rotation, slice(0, 3)))
    ]
    return Errors(position, rotation, *inside)


def _mahalanobis(errors: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.einsum("ni,ni->n", errors, np.linalg.solve(covariance, errors[..., None])[..., 0]))


def held_out_length_error(true: Rig, found: Rig, rng: np.random.Generator) -> float:
    """rms [mm] of the lengths a calibrated rig predicts at poses it was not calibrated at, against the true rig's, each cable's mean
    removed."""
    poses = scattered_poses(HELD_OUT_POSES, (WORK_SPACE_MM,) * 3, WORK_TILT_RAD, HOME, rng=rng)
    difference = span_lengths(found, poses) - span_lengths(true, poses)
    return rms(difference - difference.mean(axis=0))


def rms(values: FloatArray) -> float:
    """Root of the mean square of numbers, NaN left out."""
    return math.sqrt(float(np.nanmean(values**2)))


def vector_rms(vectors: FloatArray) -> float:
    """Root of the mean square length of (n, 3) vectors, NaN left out."""
    return math.sqrt(3.0) * rms(vectors)


def point_error(rig: Rig, true: Rig) -> float:
    """rms distance [mm] of the observation points of two rigs."""
    found = np.array([p.position_mm for p in rig.observation_point]) - np.array([p.position_mm for p in true.observation_point])
    return vector_rms(found)
