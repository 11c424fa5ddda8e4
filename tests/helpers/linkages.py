"""Rigs of a structure with dimensions at random, and what they say of the pose they are at."""

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import Structure

# P. Dietmaier, The Stewart-Gough platform of general geometry can have 40 real postures, 1998
DIETMAIER = (
    np.array(
        [
            (0.0, 0.0, 0.0), (1.107915, 0.0, 0.0), (0.549094, 0.756063, 0.0), (0.735077, -0.223935, 0.525991),
            (0.514188, -0.526063, -0.368418), (0.590473, 0.094733, -0.205018),
        ]
    ),
    np.array(
        [
            (0.0, 0.0, 0.0), (0.542805, 0.0, 0.0), (0.956919, -0.528915, 0.0), (0.665885, -0.353482, 1.402538),
            (0.478359, 1.158742, 0.107672), (-0.137087, -0.235121, 0.353913),
        ]
    ),
    np.array([1.0, 0.645275, 1.086284, 1.503439, 1.281933, 0.771071]),
)  # fmt: skip


def rig(structure: Structure, seed: int, poses: int = 1) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points of base and platform (6, 3), links in any order, and poses (n, 7)."""
    rng = np.random.default_rng(seed)
    platform, base = (rng.normal(size=(len(degrees), 3)) for degrees in structure.degrees)
    of_platform, of_base = rng.permutation(np.array(structure.links)).T
    there = se3.pose(100.0 * rng.normal(size=(poses, 3)), Rotation.random(poses, rng=rng))
    return 300.0 * base[of_base] + 50.0, 100.0 * platform[of_platform] + 20.0, there


def lengths_at(base: FloatArray, platform: FloatArray, poses: FloatArray) -> FloatArray:
    """(..., 6) lengths of the links at poses (..., 7)."""
    return np.linalg.norm(se3.apply(poses[..., None, :], platform) - base, axis=-1)


def nearest(found: FloatArray, pose: FloatArray) -> float:
    """How far the nearest of poses (k, 7) is from a pose (7,) [mm, a radian counting as 100]."""
    return float(np.abs(se3.displacement(found, pose) * np.repeat([100.0, 1.0], 3)).max(axis=1).min())
