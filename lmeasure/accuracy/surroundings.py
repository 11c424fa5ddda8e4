"""A box to look at first, where nobody has said which: around the rig, as coarse as a first look may be."""

import math

import numpy as np

from lmeasure.rig import Rig

NODES = 20
"""About how many steps the longest side has."""
FLATTEST = 0.5
"""Of its longest side: what another one is at least. Points on one wall or ceiling leave the tool room before it and behind."""
LEAST_MM = 1000.0
"""The longest side at least."""

Range = tuple[float, float, float]


def box_around(rig: Rig) -> tuple[Range, Range, Range]:
    """(start, stop, step) along x, y, z [mm, base frame]: the box of the observation points and of the base frame's origin, where the robot
    stands, at whole multiples of one step that is 1, 2 or 5 and zeros."""
    points = np.array([(0.0, 0.0, 0.0), *(rig.point(name).position_mm for name in dict.fromkeys(c.from_point for c in rig.cable))])
    low, high = points.min(axis=0), points.max(axis=0)
    longest = max(float((high - low).max()), LEAST_MM)
    half = 0.5 * np.maximum(high - low, FLATTEST * longest)
    half[np.argmax(high - low)] = 0.5 * longest
    step, middle = _round(longest / NODES), 0.5 * (low + high)
    first, last = np.floor((middle - half) / step) * step, np.ceil((middle + half) / step) * step
    x, y, z = ((float(a), float(b), step) for a, b in zip(first, last, strict=True))
    return x, y, z


def _round(value: float) -> float:
    """The least 1, 2 or 5 with zeros that is not below the value."""
    ten = 10.0 ** math.floor(math.log10(value))
    return next(ten * m for m in (1.0, 2.0, 5.0, 10.0) if ten * m >= value * (1.0 - 1e-9))
