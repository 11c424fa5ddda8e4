"""Whether a rig was written in millimetres: a size that suits no cell is named, and never refused, for somebody may have built it so."""

import math
from collections.abc import Mapping
from itertools import combinations
from typing import Any

from lmeasure.text import Message, message

SMALLEST_CELL_MM = 30.0
"""Between the observation points that are farthest apart; in metres no cell has more."""
SMALLEST_ROUND_MM = 2.0
"""Radius of the largest drum, or pulley, over which a cable still goes; in inches those of cells have less."""
UNITS_MM = {"metres": 1000.0, "inches": 25.4}


def unlikely_size(rig: Mapping[str, Any], source: str) -> Message | None:
    """What is unlikely about the sizes of a rig, the content of its file, and in which unit they would be usual; None where nothing is, or
    where it is no rig. source names the file."""
    try:
        points = [point for point in rig["observation_point"] if "position_mm" in point]
        places = [tuple(map(float, point["position_mm"])) for point in points]
        pulleys = max((float(point.get("pulley_radius_mm") or 0.0) for point in points), default=0.0)
        drums = max((_radius_mm(point["drum"]) for point in points if "drum" in point), default=0.0)
        apart = max((math.dist(a, b) for a, b in combinations(places, 2)), default=0.0)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    round_mm = min((radius for radius in (pulleys, drums) if radius > 0.0), default=math.inf)
    # what is round tells the units apart: it differs less from cell to cell
    unit = "inches" if SMALLEST_ROUND_MM / UNITS_MM["inches"] <= round_mm < SMALLEST_ROUND_MM else "metres"
    if 0.0 < apart < SMALLEST_CELL_MM:
        return _said("points", unit, apart, source)
    return _said("round", unit, round_mm, source) if round_mm < SMALLEST_ROUND_MM else None


def _radius_mm(drum: Mapping[str, Any]) -> float:
    return float(drum["counts_per_revolution"]) * float(drum["count_length_mm"]) / math.tau


def _said(what: str, unit: str, mm: float, source: str) -> Message:
    return message(f"rig.size.{what}", file=source, mm=mm, unit=message(f"unit.{unit}"), real_mm=mm * UNITS_MM[unit])
