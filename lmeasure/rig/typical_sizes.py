"""Typical sizes of unstated errors: the meaning of a missing `u_...` key in a file without `unstated = "exact"`.

A size that suits no cell is reported, and never refused, as it may be true.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Literal

from lmeasure.text import Message, message

Unstated = Literal["typical", "exact"]
"""Meaning of a missing `u_...` key: the typical size below, or 0."""


@dataclass(frozen=True)
class TypicalSize:
    """Typical standard uncertainty of a file's key: its value in the unit of the key, a share of the stated quantity where `relative`.
    stated: a size that a careful measurement reaches, in the same unit; unit: code of the sizes' text; code: name in the catalogue."""

    key: str
    value: float
    stated: float
    unit: str
    code: str
    relative: bool = False

    @property
    def what(self) -> Message:
        """Return the name of the error."""
        return message(f"exact.{self.code}")

    @property
    def reason(self) -> Message:
        """Return why this size is typical."""
        return message(f"typical.{self.code}")

    @property
    def size(self) -> Message:
        """Return the typical size as reports write it."""
        return self._written(self.value)

    @property
    def stated_size(self) -> Message:
        """Return the size that a careful measurement reaches, likewise."""
        return self._written(self.stated)

    @property
    def in_unit(self) -> tuple[float, str]:
        """Return the typical size as a number and its unit."""
        if self.unit == "zeroings":  # each cable has its own
            return 1.0, ""
        unit = {"percent": "%", "kelvin": "K", "band": "count"}.get(self.unit, self.unit)
        return (100.0 * self.value if self.unit == "percent" else self.value), unit

    @property
    def stated_share(self) -> float:
        """Return the share of the typical size that such a measurement leaves."""
        return self.stated / self.value

    def _written(self, value: float) -> Message:
        if self.unit == "band":
            return message("size.band", counts=round(2.0 * value))
        if self.unit == "zeroings":
            return message("size.zeroings") if value == self.value else message("size.mm", mm=value)
        return message(f"size.{self.unit}", **{self.unit.partition("_of_")[0]: 100.0 * value if self.unit == "percent" else value})


WARMER_K = 5.0
STEEL_PER_K = 11.5e-6
"""Expansion of steel."""
_SIZES = (
    TypicalSize("u_count_length_mm", 5e-4, 1e-4, "percent", "count_length", relative=True),
    TypicalSize("u_groove_pitch_mm", 0.01, 0.002, "mm", "groove_pitch"),
    TypicalSize("u_run_out_mm", 0.02, 0.005, "mm", "run_out"),
    TypicalSize("u_pulley_eccentricity_mm", 0.05, 0.01, "mm", "pulleys"),
    TypicalSize("u_swivel_offset_mm", 0.05, 0.01, "mm", "swivels"),
    TypicalSize("u_attachment_mm", 0.3, 0.05, "mm", "attachment"),
    TypicalSize("u_backlash_counts", 1.0, 0.0, "band", "backlash"),
    TypicalSize("u_friction_counts", 4.0, 1.0, "band", "friction"),
    TypicalSize("temperature_c", WARMER_K, 0.5, "kelvin", "temperature"),
    TypicalSize("calibration.temperature_c", WARMER_K, 0.5, "kelvin_of_calibration", "calibration_temperature"),
    TypicalSize("cable_expansion_per_k", STEEL_PER_K, 1e-6, "per_k", "expansion"),
    TypicalSize("zero_length_mm", 300.0, 10.0, "zeroings", "zero_lengths"),
    TypicalSize("u_position_mm", 0.3, 0.02, "mm", "start_position"),
    TypicalSize("u_rotation_deg", 0.05, 0.003, "deg", "start_rotation"),
    TypicalSize("u_length_mm", 0.3, 0.05, "mm", "start_length"),
)
TYPICAL_SIZES = {size.key: size for size in _SIZES}
"""The one table of typical sizes, by the key that states each: of rig.toml down to friction, of temperatures, of a run's [start]."""


SMALLEST_CELL_MM = 30.0  # Between the observation points that are farthest apart; in metres no cell has more
SMALLEST_ROUND_MM = 2.0  # Radius of the largest drum, or pulley, over which a cable still goes; in inches those of cells have less
UNITS_MM = {"metres": 1000.0, "inches": 25.4}


def unlikely_size(rig: Mapping[str, Any], source: str) -> Message | None:
    """Return a message on unlikely sizes of a rig, the content of its file, and the unit in which they would be usual; None without any, or
    for no rig. source names the file."""
    try:
        points = [point for point in rig["observation_point"] if "position_mm" in point]
        places = [tuple(map(float, point["position_mm"])) for point in points]
        pulleys = max((float(point.get("pulley_radius_mm") or 0.0) for point in points), default=0.0)
        drums = max((_radius_mm(point["drum"]) for point in points if "drum" in point), default=0.0)
        apart = max((math.dist(a, b) for a, b in combinations(places, 2)), default=0.0)
    except (KeyError, TypeError, ValueError, AttributeError):
        return None
    round_mm = min((radius for radius in (pulleys, drums) if radius > 0.0), default=math.inf)
    # drums and pulleys distinguish the units, because they differ less between cells
    unit = "inches" if SMALLEST_ROUND_MM / UNITS_MM["inches"] <= round_mm < SMALLEST_ROUND_MM else "metres"
    if 0.0 < apart < SMALLEST_CELL_MM:
        return _said("points", unit, apart, source)
    return _said("round", unit, round_mm, source) if round_mm < SMALLEST_ROUND_MM else None


def _radius_mm(drum: Mapping[str, Any]) -> float:
    return float(drum["counts_per_revolution"]) * float(drum["count_length_mm"]) / math.tau


def _said(what: str, unit: str, mm: float, source: str) -> Message:
    return message(f"rig.size.{what}", file=source, mm=mm, unit=message(f"unit.{unit}"), real_mm=mm * UNITS_MM[unit])
