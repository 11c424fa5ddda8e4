"""Pose characteristics of ISO 9283:1998, clauses 7 and 11: one function per figure.

Every function takes the attained poses of n cycles as arrays (..., n, 3) - positions [mm] or angles [deg] - and gives (...) or (..., 3):
leading axes are draws of an uncertainty or nothing. Means over cycles are written with a bar, deviations have n - 1 degrees of freedom.
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

FULL_TURN_DEG = 360.0


def wrapped(angles_deg: FloatArray) -> FloatArray:
    """Differences of angles [deg] brought into (-180, 180]."""
    return np.asarray(FULL_TURN_DEG / 2 - np.mod(FULL_TURN_DEG / 2 - angles_deg, FULL_TURN_DEG))


def barycentre(values: FloatArray) -> FloatArray:
    """(..., 3) mean over cycles of (..., n, 3): the standard's x-bar, y-bar, z-bar."""
    return np.asarray(values.mean(axis=-2))


def pose_accuracy_components(positions: FloatArray, commanded: FloatArray) -> FloatArray:
    """7.2.1: AP_x = x-bar - x_c, AP_y, AP_z (..., 3) [mm] of positions (..., n, 3) about the commanded (3,)."""
    return barycentre(positions) - commanded


def pose_accuracy(positions: FloatArray, commanded: FloatArray) -> FloatArray:
    """7.2.1: AP_p = sqrt(AP_x^2 + AP_y^2 + AP_z^2) (...) [mm]."""
    return np.asarray(np.linalg.norm(pose_accuracy_components(positions, commanded), axis=-1))


def orientation_accuracy(angles_deg: FloatArray, commanded_deg: FloatArray) -> FloatArray:
    """7.2.1: AP_a = a-bar - a_c, AP_b, AP_c (..., 3) [deg]; angles are counted from the commanded one, so that none jumps by a turn."""
    return barycentre(wrapped(angles_deg - commanded_deg))


def spread(distances: FloatArray) -> FloatArray:
    """Mean and three standard deviations, l-bar + 3 S_l, of distances (..., n) with S_l^2 = sum (l_j - l-bar)^2 / (n - 1)."""
    return np.asarray(distances.mean(axis=-1) + 3.0 * distances.std(axis=-1, ddof=1))


def pose_repeatability(positions: FloatArray) -> FloatArray:
    """7.2.2: RP_l = l-bar + 3 S_l (...) [mm], l_j the distance of position j from the barycentre."""
    return spread(np.linalg.norm(positions - barycentre(positions)[..., None, :], axis=-1))


def three_deviations(values: FloatArray) -> FloatArray:
    """3 S over cycles of (..., n, k): (..., k)."""
    return np.asarray(3.0 * values.std(axis=-2, ddof=1))


def orientation_repeatability(angles_deg: FloatArray, commanded_deg: FloatArray) -> FloatArray:
    """7.2.2: RP_a = +-3 S_a, RP_b, RP_c (..., 3) [deg]; written as the positive half."""
    return three_deviations(wrapped(angles_deg - commanded_deg))
