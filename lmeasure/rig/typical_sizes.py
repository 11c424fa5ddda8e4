"""Typical sizes of errors that nobody stated: what a missing `u_...` key means where a file does not say `unstated = "exact"`."""

from dataclasses import dataclass
from typing import Literal

from lmeasure.text import Message, message

Unstated = Literal["typical", "exact"]
"""What a missing `u_...` key means: the typical size below, or 0."""


@dataclass(frozen=True)
class TypicalSize:
    """Typical standard uncertainty of what the key of a file states: its value in the unit of the key, a share of the stated quantity where
    `relative`; size: how reports write it; code: name in the catalogue."""

    key: str
    value: float
    size: Message
    code: str
    relative: bool = False

    @property
    def reason(self) -> Message:
        """Return why this size is typical."""
        return message(f"typical.{self.code}")


def _mm(key: str, value: float, code: str) -> TypicalSize:
    return TypicalSize(key, value, message("size.mm", mm=value), code)


def _band(key: str, half: float, code: str) -> TypicalSize:
    return TypicalSize(key, half, message("size.band", counts=round(2.0 * half)), code)


WARMER_K = 5.0
_SIZES = (
    TypicalSize("u_count_length_mm", 5e-4, message("size.percent", percent=0.05), "count_length", relative=True),
    _mm("u_groove_pitch_mm", 0.01, "groove_pitch"),
    _mm("u_run_out_mm", 0.02, "run_out"),
    _mm("u_pulley_eccentricity_mm", 0.05, "pulleys"),
    _mm("u_swivel_offset_mm", 0.05, "swivels"),
    _mm("u_attachment_mm", 0.3, "attachment"),
    _band("u_backlash_counts", 1.0, "backlash"),
    _band("u_friction_counts", 4.0, "friction"),
    TypicalSize("temperature_c", WARMER_K, message("size.kelvin", kelvin=WARMER_K), "temperature"),
    _mm("u_position_mm", 0.3, "start_position"),
    TypicalSize("u_rotation_deg", 0.05, message("size.deg", deg=0.05), "start_rotation"),
    _mm("u_length_mm", 0.3, "start_length"),
)
TYPICAL_SIZES = {size.key: size for size in _SIZES}
"""The one table of typical sizes, by the key that states each: of rig.toml down to friction, then of run.toml and its [start]."""
