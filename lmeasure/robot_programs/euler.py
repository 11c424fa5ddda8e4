"""Poses of controllers that write three angles in degrees, of a convention of `lmeasure.core.conventions`."""

from collections.abc import Callable, Sequence

import numpy as np

from lmeasure.core import FloatArray, angles_from_rotation, rotation_from_angles, se3
from lmeasure.robot_programs.program import near_turns, pose


def of_angles(convention: str) -> tuple[Callable[[Sequence[float]], FloatArray], Callable[[FloatArray, Sequence[float]], FloatArray]]:
    """(pose of numbers x, y, z and three angles; numbers of a pose near old ones). Of the two triples that say one rotation the one nearer
    to the old is written, so that a corrected target looks like the one before."""

    def of(values: Sequence[float]) -> FloatArray:
        return pose(values[:3], rotation_from_angles(convention, np.asarray(values[3:6], dtype=np.float64)))

    def numbers(row: FloatArray, old: Sequence[float]) -> FloatArray:
        first = angles_from_rotation(convention, se3.rotation(row))
        # Tait-Bryan: the middle angle mirrored, the outer ones half a turn further
        both = [near_turns(a, old[3:6]) for a in (first, np.array([first[0] + 180.0, 180.0 - first[1], first[2] + 180.0]))]
        # near the singular orientation only the sum of the outer angles is determined: the old first one is kept
        best = min(both, key=lambda a: float(np.abs(a - np.asarray(old[3:6])).max()))
        return np.concatenate([row[:3], best])

    return of, numbers
