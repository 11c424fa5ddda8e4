"""Pose characteristics of ISO 9283:1998, clauses 7 and 10: one function per figure.

Every function takes the attained poses of n cycles as arrays (..., n, 3) - positions [mm] or angles [deg] - and gives (...) or (..., 3):
leading axes are draws of an uncertainty or nothing. Means over cycles are written with a bar, deviations have n - 1 degrees of freedom.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from lmeasure.core import FloatArray


def barycentre(values: FloatArray) -> FloatArray:
    """(..., k) mean over cycles of (..., n, k): of positions the standard's x-bar, y-bar, z-bar."""
    return np.asarray(np.einsum("...nk->...k", values) / values.shape[-2])


def deviation_over_cycles(values: FloatArray) -> FloatArray:
    """(..., k) standard deviation over cycles of (..., n, k), with n - 1 degrees of freedom."""
    away = values - barycentre(values)[..., None, :]
    return np.sqrt(np.einsum("...nk,...nk->...k", away, away) / (values.shape[-2] - 1))


def length(vectors: FloatArray) -> FloatArray:
    """(...) Euclidean lengths of (..., k)."""
    return np.sqrt(np.einsum("...k,...k->...", vectors, vectors))


def spread(distances: FloatArray) -> FloatArray:
    """(...) mean and three standard deviations, l-bar + 3 S_l, of distances (..., n); S_l with n - 1 degrees of freedom."""
    return np.asarray(distances.mean(axis=-1) + 3.0 * deviation_over_cycles(distances[..., None])[..., 0])


FULL_TURN_DEG = 360.0


def wrapped(angles_deg: FloatArray) -> FloatArray:
    """Differences of angles [deg] brought into (-180, 180]."""
    return np.asarray(FULL_TURN_DEG / 2 - np.mod(FULL_TURN_DEG / 2 - angles_deg, FULL_TURN_DEG))


def pose_accuracy_components(positions: FloatArray, commanded: FloatArray) -> FloatArray:
    """7.2.1: AP_x = x-bar - x_c, AP_y, AP_z (..., 3) [mm] of positions (..., n, 3) about the commanded (3,)."""
    return barycentre(positions) - commanded


def pose_accuracy(positions: FloatArray, commanded: FloatArray) -> FloatArray:
    """7.2.1: AP_p = sqrt(AP_x^2 + AP_y^2 + AP_z^2) (...) [mm]."""
    return length(pose_accuracy_components(positions, commanded))


def orientation_accuracy(angles_deg: FloatArray, commanded_deg: FloatArray) -> FloatArray:
    """7.2.1: AP_a = a-bar - a_c, AP_b, AP_c (..., 3) [deg]; angles are counted from the commanded one, so that none jumps by a turn."""
    return barycentre(wrapped(angles_deg - commanded_deg))


def pose_repeatability(positions: FloatArray) -> FloatArray:
    """7.2.2: RP_l = l-bar + 3 S_l (...) [mm], l_j the distance of position j from the barycentre."""
    return spread(length(positions - barycentre(positions)[..., None, :]))


def three_deviations(values: FloatArray) -> FloatArray:
    """3 S over cycles of (..., n, k): (..., k)."""
    return np.asarray(3.0 * deviation_over_cycles(values))


def orientation_repeatability(angles_deg: FloatArray, commanded_deg: FloatArray) -> FloatArray:
    """7.2.2: RP_a = +-3 S_a, RP_b, RP_c (..., 3) [deg]; written as the positive half."""
    return three_deviations(wrapped(angles_deg - commanded_deg))


def rotation_accuracy(turns_deg: FloatArray) -> FloatArray:
    """Extension of 7.2.1: AP_rot, length of the mean rotation vector (...) [deg] of turns (..., n, 3) from the commanded orientation."""
    return length(barycentre(turns_deg))


def rotation_repeatability(turns_deg: FloatArray) -> FloatArray:
    """Extension of 7.2.2: RP_rot = l-bar + 3 S_l (...) [deg] of rotation vectors (..., n, 3), as RP_l of positions; free of the order of
    axes and of jumps by a turn."""
    return pose_repeatability(turns_deg)


def largest_distance(barycentres: Sequence[FloatArray]) -> FloatArray:
    """Largest of the distances between any two of several points (..., 3): (...)."""
    pairs = [length(a - b) for a, b in itertools.combinations(barycentres, 2)]
    return np.asarray(np.max(pairs, axis=0))


def multidirectional_variation(groups: Sequence[FloatArray]) -> FloatArray:
    """7.2.3: vAP_p (...) [mm], the largest distance between the barycentres of positions (..., n, 3) reached from each direction."""
    return largest_distance([barycentre(g) for g in groups])


def multidirectional_variation_of_angles(groups: Sequence[FloatArray]) -> FloatArray:
    """7.2.3: vAP_a, vAP_b, vAP_c (..., 3) [deg], the largest difference between mean angles, counted from the commanded ones."""
    means = [barycentre(g) for g in groups]
    return np.asarray(np.max([np.abs(wrapped(a - b)) for a, b in itertools.combinations(means, 2)], axis=0))


def distances(one: FloatArray, other: FloatArray) -> FloatArray:
    """D_j = |P_1j - P_2j| (..., n) [mm] of positions (..., n, 3) of the same cycles."""
    return length(one - other)


def distance_accuracy(one: FloatArray, other: FloatArray, commanded_mm: float) -> FloatArray:
    """7.3.2: AD_p = D-bar - D_c (...) [mm], signed."""
    return np.asarray(distances(one, other).mean(axis=-1) - commanded_mm)


def distance_accuracy_components(one: FloatArray, other: FloatArray, commanded: FloatArray) -> FloatArray:
    """7.3.2: AD_x = D_x-bar - D_xc with D_xj = |x_1j - x_2j|, AD_y, AD_z (..., 3); commanded (3,): commanded difference."""
    return barycentre(np.abs(one - other)) - np.abs(commanded)


def distance_repeatability(one: FloatArray, other: FloatArray) -> FloatArray:
    """7.3.3: RD = +-3 S (...) [mm] of the distances; written as the positive half."""
    return np.asarray(three_deviations(distances(one, other)[..., None])[..., 0])


def distance_repeatability_components(one: FloatArray, other: FloatArray) -> FloatArray:
    """7.3.3: RD_x, RD_y, RD_z (..., 3) [mm]."""
    return three_deviations(np.abs(one - other))


def largest_change(values: Sequence[FloatArray]) -> FloatArray:
    """Largest difference from the first of several figures (...)."""
    return np.asarray(np.max([np.abs(v - values[0]) for v in values[1:]], axis=0))


def drift_of_accuracy(groups: Sequence[FloatArray], commanded: FloatArray) -> FloatArray:
    """7.6: dAP_p = max |AP_p(t) - AP_p(0)| (...) [mm] over groups of cycles (..., n, 3) in order of time."""
    return largest_change([pose_accuracy(g, commanded) for g in groups])


def drift_of_orientation(groups: Sequence[FloatArray]) -> FloatArray:
    """7.6: dAP_a, dAP_b, dAP_c (..., 3) [deg] over groups of angles (..., n, 3) counted from the commanded ones."""
    return largest_change([barycentre(g) for g in groups])


def drift_of_repeatability(groups: Sequence[FloatArray]) -> FloatArray:
    """7.6: dRP_l = max |RP_l(t) - RP_l(0)| (...) [mm] over groups of cycles in order of time."""
    return largest_change([pose_repeatability(g) for g in groups])


def exchangeability(groups: Sequence[FloatArray]) -> FloatArray:
    """7.7: E (...) [mm], the largest distance between the barycentres that robots of one type reach on the same command."""
    return largest_distance([barycentre(g) for g in groups])


def static_compliance(positions: FloatArray, forces_n: FloatArray) -> FloatArray:
    """10: C (..., 3, 3) [mm/N], displacement per force along the base axes: least squares of positions (..., n, 3) = p_0 + C f, f (n, 3).

    The standard's figures are the diagonal. Rows of axes along which no force acted are NaN.
    """
    design = forces_n - forces_n.mean(axis=0)
    values = design.T @ (positions - positions.mean(axis=-2, keepdims=True))
    out = np.full((*positions.shape[:-2], 3, 3), np.nan)
    acted = np.abs(design).max(axis=0) > 0
    solved = np.linalg.solve(design[:, acted].T @ design[:, acted], values[..., acted, :])
    out[..., :, acted] = np.swapaxes(solved, -1, -2)
    return out
