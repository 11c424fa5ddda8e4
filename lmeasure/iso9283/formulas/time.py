"""Characteristics in time of ISO 9283:1998, clauses 7.4, 7.5 and 9, of one cycle each: the certificate takes their means or maxima.

distance (..., k) [mm]: of the attained position from where the robot comes to rest, at times time_s (k,). Leading axes are draws of an
uncertainty or nothing.
"""

import numpy as np

from lmeasure.core import FloatArray, IntArray


def first_arrival(distance: FloatArray, band_mm: float) -> IntArray:
    """Index (...) of the first sample within the limit band; -1 when there is none."""
    inside = distance <= band_mm
    return np.where(inside.any(axis=-1), inside.argmax(axis=-1), -1)


def last_arrival(distance: FloatArray, band_mm: float) -> IntArray:
    """Index (...) of the sample from which on the robot stays within the limit band; k when it does not."""
    outside = distance > band_mm
    return np.where(outside.any(axis=-1), distance.shape[-1] - outside[..., ::-1].argmax(axis=-1), 0)


def crossing(time_s: FloatArray, distance: FloatArray, i: IntArray, band_mm: float) -> FloatArray:
    """When (...) [s] the distance, straight between samples i - 1 and i (...), crosses the band; time_s (k,) or (..., k)."""
    after = np.clip(i, 1, distance.shape[-1] - 1)[..., None]
    times = np.broadcast_to(time_s, distance.shape)
    a, b, before, behind = (np.take_along_axis(x, at, axis=-1)[..., 0] for x in (distance, times) for at in (after - 1, after))
    part = np.divide(a - band_mm, a - b, out=np.ones_like(a), where=a != b)
    return np.where(np.asarray(i) == 0, times[..., 0], before + part * (behind - before))


def arrivals(time_s: FloatArray, distance: FloatArray, band_mm: float) -> tuple[FloatArray, FloatArray]:
    """When (...) [s] the robot first enters the limit band, and when it enters it to stay; NaN when it does not."""
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
    """When (...) [s] the robot leaves the limit band about where it stood for the first time; NaN when it never stood within it, or never
    leaves it."""
    outside = distance_from_start > band_mm
    i = outside.argmax(axis=-1)
    return np.where(i == 0, np.nan, crossing(time_s, distance_from_start, i, band_mm))


def posing_time(time_s: FloatArray, from_start: FloatArray, to_end: FloatArray, band_mm: float) -> FloatArray:
    """9: t_min (...) [s], from leaving the start to staying within the limit band about the end; distances (..., k) from where the robot
    stood and from where it comes to rest."""
    return arrivals(time_s, to_end, band_mm)[1] - departure(time_s, from_start, band_mm)
