"""What a pose must keep to lie in an accuracy zone, and which of it a place breaks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import AccuracyError, BoolArray
from lmeasure.kernels import CANNOT_RUN, SINGULAR


def limit_from_accuracy(length_mm: float, position_mm: float) -> float:
    """Return the largest pressure angle at which lengths of a given accuracy give positions of a given accuracy.

    Parameters
    ----------
    length_mm
        Full width of a length reading [mm]: 0.025 for +-0.0125.
    position_mm
        Accuracy of the position [mm].

    Returns
    -------
    float
        arccos(length / position) [deg], thesis 5.7.

    Raises
    ------
    AccuracyError
        If the position is to be better than the lengths.

    Examples
    --------
    >>> round(lm.limit_from_accuracy(0.025, 0.05), 9)
    60.0
    """
    if not 0.0 < length_mm <= position_mm < math.inf:
        raise AccuracyError(
            f"an accuracy of {position_mm:g} mm cannot be asked of lengths good to {length_mm:g} mm: it must be the larger of the two"
        )
    return math.degrees(math.acos(length_mm / position_mm))


REASONS = (
    "cable_cannot_run",
    "singular",
    "pressure_angle",
    "cable_too_short",
    "cable_too_long",
    "u95_position",
    "u95_rotation",
    "u95_attachment",
    "wrap",
    "clearance",
    "other_assembly",
    "near_singular",
)
"""Why a node is not in the zone, in the order of the bits of `rejected_because`."""


@dataclass(frozen=True)
class Limits:
    """What a pose must keep to lie in the zone; None asks nothing.

    angle_deg: pressure-angle analogue; length_mm: shortest and longest cable, B to attachment point; u95_mm, u95_rotation_deg,
    u95_attachment_mm: 95 % radii of the tool origin, the rotation vector and the worst attachment point; wrap_deg: largest wrapped angle;
    clearance_mm: least distance between cables and from cable to body; one_assembly: the determinant of six
    cables keeps its sign (what more determine is not parted by singular poses); singularity: least `singularity_distance`.
    """

    angle_deg: float = 60.0
    length_mm: tuple[float, float] | None = None
    u95_mm: float | None = None
    u95_rotation_deg: float | None = None
    u95_attachment_mm: float | None = None
    wrap_deg: float | None = None
    clearance_mm: float | None = None
    one_assembly: bool = False
    singularity: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.angle_deg <= 90.0:
            raise AccuracyError(f"a pressure-angle limit of {self.angle_deg:g} degrees: it must lie in (0, 90]")
        if self.length_mm is not None and not 0.0 <= self.length_mm[0] < self.length_mm[1]:
            raise AccuracyError(f"cable lengths of {self.length_mm[0]:g} to {self.length_mm[1]:g} mm: the limits must rise from 0 or more")
        for name in ("u95_mm", "u95_rotation_deg", "u95_attachment_mm", "wrap_deg", "clearance_mm", "singularity"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise AccuracyError(f"{name} = {value:g}: a limit must be a number, 0 or more")

    @property
    def needs_all(self) -> bool:
        """Whether the radii of rotation and attachment points are asked for."""
        return self.u95_rotation_deg is not None or self.u95_attachment_mm is not None


def broken_limits(figures: Mapping[str, NDArray[Any]], limits: Limits, sign: int | None = None) -> tuple[NDArray[np.int32], int]:
    """Bits of `REASONS` for arrays of figures named as in the dataset, with `flags`; and the assembly's sign.

    The assembly that `one_assembly` keeps is the given sign, or that of most places without another fault.
    """
    flags = figures["flags"]
    shortest, longest = limits.length_mm or (0.0, math.inf)
    nothing = np.zeros(flags.shape, bool)

    def over(name: str, limit: float | None) -> BoolArray:
        return nothing if limit is None else ~(figures[name] <= limit)

    def under(name: str, limit: float | None) -> BoolArray:
        return nothing if limit is None else ~(figures[name] >= limit)

    broken = [
        flags & CANNOT_RUN != 0,
        flags & SINGULAR != 0,
        over("worst_pressure_angle_deg", limits.angle_deg),
        figures["shortest_cable_mm"] < shortest,
        figures["longest_cable_mm"] > longest,
        over("u95_position_mm", limits.u95_mm),
        over("u95_rotation_deg", limits.u95_rotation_deg),
        over("u95_attachment_mm", limits.u95_attachment_mm),
        over("largest_wrap_deg", limits.wrap_deg),
        under("clearance_mm", limits.clearance_mm),
        nothing,
        under("singularity_distance", limits.singularity),
    ]
    assembly = figures.get("assembly", np.ones(flags.shape, np.int8))
    if sign is None:
        sign = 1 if assembly[~np.any(broken, axis=0)].sum() >= 0 else -1
    if limits.one_assembly:
        broken[REASONS.index("other_assembly")] = assembly != sign
    return sum((mask.astype(np.int32) << bit for bit, mask in enumerate(broken)), np.zeros(flags.shape, np.int32)), sign
