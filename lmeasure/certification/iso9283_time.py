"""Characteristics in time of ISO 9283:1998, clauses 7.4, 7.5 and 9, of one cycle each: the certificate takes their means or maxima.

distance (k,) [mm]: of the attained position from where the robot comes to rest, at times time_s (k,).
"""

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


def first_arrival(distance: FloatArray, band_mm: float) -> int:
    """Index of the first sample within the limit band; -1 when there is none."""
    inside = np.flatnonzero(distance <= band_mm)
    return int(inside[0]) if len(inside) else -1


def _crossing(time_s: FloatArray, distance: FloatArray, i: int, band_mm: float) -> float:
    """When the distance, straight between samples i - 1 and i, crosses the band."""
    if i == 0:
        return float(time_s[0])
    a, b = distance[i - 1], distance[i]
    return float(time_s[i - 1] + (a - band_mm) / (a - b) * (time_s[i] - time_s[i - 1])) if a != b else float(time_s[i])


def arrivals(time_s: FloatArray, distance: FloatArray, band_mm: float) -> tuple[float, float]:
    """When [s] the robot first enters the limit band, and when it enters it to stay; NaN when it does not."""
    first = first_arrival(distance, band_mm)
    outside = np.flatnonzero(distance > band_mm)
    last = int(outside[-1]) + 1 if len(outside) else 0
    if first < 0 or last == len(distance):
        return float("nan"), float("nan")
    return _crossing(time_s, distance, first, band_mm), _crossing(time_s, distance, last, band_mm)


def stabilisation_time(time_s: FloatArray, distance: FloatArray, band_mm: float) -> float:
    """7.4: t_s [s], from the first entry into the limit band until the robot stays within it."""
    first, last = arrivals(time_s, distance, band_mm)
    return last - first


def overshoot(distance: FloatArray, band_mm: float) -> float:
    """7.5: OV [mm], largest distance after the first entry into the limit band; zero when the robot does not leave the band again."""
    first = first_arrival(distance, band_mm)
    if first < 0:
        return float("nan")
    largest = float(distance[first:].max())
    return largest if largest > band_mm else 0.0


def departure(time_s: FloatArray, distance_from_start: FloatArray, band_mm: float) -> float:
    """When [s] the robot leaves the limit band about where it stood for the last time; NaN when it never stood within it."""
    outside = np.flatnonzero(distance_from_start > band_mm)
    if len(outside) == 0 or outside[0] == 0:
        return float("nan")
    i = int(outside[0])
    return _crossing(time_s, distance_from_start, i, band_mm)


def posing_time(time_s: FloatArray, from_start: FloatArray, to_end: FloatArray, band_mm: float) -> float:
    """9: t_min [s], from leaving the start to staying within the limit band about the end; distances (k,) from where the robot stood
    and from where it comes to rest."""
    return arrivals(time_s, to_end, band_mm)[1] - departure(time_s, from_start, band_mm)
