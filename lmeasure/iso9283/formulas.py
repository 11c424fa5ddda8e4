"""Pose characteristics of ISO 9283:1998, clauses 7 and 10: one function per figure.

Every function takes the attained poses of n cycles as arrays (..., n, 3) - positions [mm] or angles [deg] - and gives (...) or (..., 3):
leading axes are draws of an uncertainty or nothing. Means over cycles are written with a bar, deviations have n - 1 degrees of freedom.

Deviations are arrays (..., m, n, 3): n cycles crossing m planes normal to the commanded path, positions [mm] or angles [deg] minus the
commanded ones. Speeds are (..., n, k): k measurements in each cycle. Leading axes are draws of an uncertainty or nothing.

distance (..., k) [mm]: of the attained position from where the robot comes to rest, at times time_s (k,). Leading axes are draws of an
uncertainty or nothing.
"""

import itertools
from collections.abc import Sequence

import numpy as np

from lmeasure.core import FloatArray, IntArray


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


def first_arrival(distance: FloatArray, band_mm: float) -> IntArray:
    """Index (...) of the first sample within the limit band; -1 when there is none."""
    inside = distance <= band_mm
    return np.where(inside.any(axis=-1), inside.argmax(axis=-1), -1)


def last_arrival(distance: FloatArray, band_mm: float) -> IntArray:
    """Index (...) of the sample from which on the robot stays within the limit band; k when it does not."""
    outside = distance > band_mm
    return np.where(outside.any(axis=-1), distance.shape[-1] - outside[..., ::-1].argmax(axis=-1), 0)


def crossing(time_s: FloatArray, distance: FloatArray, i: IntArray, band_mm: float) -> FloatArray:
    """Return the times (...) [s] at which the distance, straight between samples i - 1 and i (...), crosses the band; time_s (k,) or (...,
    k)."""
    after = np.clip(i, 1, distance.shape[-1] - 1)[..., None]
    times = np.broadcast_to(time_s, distance.shape)
    a, b, before, behind = (np.take_along_axis(x, at, axis=-1)[..., 0] for x in (distance, times) for at in (after - 1, after))
    part = np.divide(a - band_mm, a - b, out=np.ones_like(a), where=a != b)
    return np.where(np.asarray(i) == 0, times[..., 0], before + part * (behind - before))


def arrivals(time_s: FloatArray, distance: FloatArray, band_mm: float) -> tuple[FloatArray, FloatArray]:
    """Return the times (...) [s] at which the robot first enters the limit band, and enters it to stay; NaN if it does not."""
    first, last = first_arrival(distance, band_mm), last_arrival(distance, band_mm)
    never = (first < 0) | (last == distance.shape[-1])
    one, other = (np.where(never, np.nan, crossing(time_s, distance, i, band_mm)) for i in (first, last))
    return one, other


def stabilisation_time(time_s: FloatArray, distance: FloatArray, band_mm: float) -> FloatArray:
    """7.4: t_s (...) [s], from the first entry into the limit band until the robot stays within it."""
    first, last = arrivals(time_s, distance, band_mm)
    return last - first


def excursion(distance: FloatArray, band_mm: float) -> FloatArray:
    """Largest distance (...) [mm] after the first entry into the limit band; NaN when there is none."""
    first = first_arrival(distance, band_mm)
    behind = np.arange(distance.shape[-1]) >= first[..., None]
    return np.where(first < 0, np.nan, np.where(behind, distance, -np.inf).max(axis=-1))


def overshoot(excursions: FloatArray, band_mm: float, axis: int = -1) -> FloatArray:
    """7.5: OV (...) [mm], the largest of the cycles' excursions (..., n); zero when the robot does not leave the band again."""
    largest = excursions.max(axis=axis)
    return np.where(largest > band_mm, largest, 0.0)


def departure(time_s: FloatArray, distance_from_start: FloatArray, band_mm: float) -> FloatArray:
    """Return the times (...) [s] at which the robot leaves the limit band about its rest for the first time; NaN if it was never within it,
    or never leaves it."""
    outside = distance_from_start > band_mm
    i = outside.argmax(axis=-1)
    return np.where(i == 0, np.nan, crossing(time_s, distance_from_start, i, band_mm))


def posing_time(time_s: FloatArray, from_start: FloatArray, to_end: FloatArray, band_mm: float) -> FloatArray:
    """Return 9: t_min (...) [s], from leaving the start to staying within the limit band about the end; distances (..., k) from the start
    and from the final rest."""
    return arrivals(time_s, to_end, band_mm)[1] - departure(time_s, from_start, band_mm)


def path_accuracy(deviations: FloatArray) -> FloatArray:
    """8.2 (8.4 while turning): AT_p = max over planes of |mean over cycles| (...) [mm]."""
    return np.asarray(length(barycentre(deviations)).max(axis=-1))


def path_orientation_accuracy(deviations_deg: FloatArray) -> FloatArray:
    """8.2: AT_a = max over planes of |a-bar_i - a_ci|, AT_b, AT_c (..., 3) [deg]."""
    return np.asarray(np.abs(barycentre(deviations_deg)).max(axis=-2))


def path_repeatability(deviations: FloatArray) -> FloatArray:
    """8.3: RT_p = max over planes of l-bar_i + 3 S_li (...) [mm], l_ij the distance of crossing j from the barycentre of its plane."""
    return np.asarray(spread(length(deviations - barycentre(deviations)[..., None, :])).max(axis=-1))


def path_orientation_repeatability(deviations_deg: FloatArray) -> FloatArray:
    """8.3: RT_a = max over planes of 3 S_ai, RT_b, RT_c (..., 3) [deg]."""
    return np.asarray(3.0 * deviation_over_cycles(deviations_deg).max(axis=-2))


def cornering_round_off(vectors: FloatArray) -> FloatArray:
    """8.5: CR (...) [mm], least distance of the attained path from the corner; mean over cycles of vectors (..., n, 3) from it."""
    return np.asarray(length(vectors).mean(axis=-1))


def cornering_overshoot(vectors: FloatArray, incoming: FloatArray) -> FloatArray:
    """8.5: CO (...) [mm], the largest deviation beyond the second line, mean over cycles.

    vectors (..., n, k, 3): from the commanded line to k points of the attained path about the farthest; incoming (3,): unit direction of
    the first line normal to the second. Zero for a cycle that stays on the inner side.
    """
    return np.asarray(np.maximum((vectors @ incoming).max(axis=-1), 0.0).mean(axis=-1))


def stabilisation_length(arc_mm: FloatArray, deviation_mm: FloatArray, limit_mm: float) -> FloatArray:
    """8.5: SPL (...) [mm], way behind the corner from which the deviation stays within the limit; arc (..., k) from the corner, deviation
    (..., k).

    Zero when it never leaves the limit, NaN when it is not back at the end.
    """
    last = last_arrival(deviation_mm, limit_mm)
    back = crossing(arc_mm, deviation_mm, last, limit_mm)
    return np.where(last == 0, 0.0, np.where(last == deviation_mm.shape[-1], np.nan, back))


def velocity_accuracy(speeds: FloatArray, commanded_mm_s: float) -> FloatArray:
    """8.6.2: AV = 100 (v-bar - v_c) / v_c (...) [%], v-bar the mean over cycles of the mean v_j over measurements."""
    return np.asarray(100.0 * (speeds.mean(axis=-1).mean(axis=-1) - commanded_mm_s) / commanded_mm_s)


def velocity_repeatability(speeds: FloatArray, commanded_mm_s: float) -> FloatArray:
    """8.6.3: RV = +-100 * 3 S_v / v_c (...) [%], S_v of the cycles' mean speeds; written as the positive half."""
    return np.asarray(300.0 * speeds.mean(axis=-1).std(axis=-1, ddof=1) / commanded_mm_s)


def velocity_fluctuation(speeds: FloatArray) -> FloatArray:
    """8.6.4: FV = max over cycles of (max v - min v) (...) [mm/s]."""
    return np.asarray((speeds.max(axis=-1) - speeds.min(axis=-1)).max(axis=-1))


def weaving_stroke_error(strokes_mm: FloatArray, commanded_mm: float) -> FloatArray:
    """11: WS = 100 (S_a - S_c) / S_c (...) [%], S_a the mean of the strokes (..., n)."""
    return np.asarray(100.0 * (strokes_mm.mean(axis=-1) - commanded_mm) / commanded_mm)


def weaving_frequency_error(frequencies_hz: FloatArray, commanded_hz: float) -> FloatArray:
    """11: WF = 100 (F_a - F_c) / F_c (...) [%], F = speed along the path / way of one weave, F_a the mean of (..., n)."""
    return np.asarray(100.0 * (frequencies_hz.mean(axis=-1) - commanded_hz) / commanded_hz)
