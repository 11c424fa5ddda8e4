"""Path characteristics of ISO 9283:1998, clauses 8 and 11: one function per figure.

Deviations are arrays (..., m, n, 3): n cycles crossing m planes normal to the commanded path, positions [mm] or angles [deg] less the
commanded ones. Speeds are (..., n, k): k measurements in each cycle. Leading axes are draws of an uncertainty or nothing.
"""

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.iso9283.formulas.pose import barycentre, deviation_over_cycles, length, spread
from lmeasure.iso9283.formulas.time import crossing, last_arrival


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
