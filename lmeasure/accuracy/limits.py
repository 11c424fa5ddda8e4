"""Conditions of a pose in an accuracy zone, bodies that the cables must not touch, and which of it a place breaks."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import AfterValidator, Field

from lmeasure.core import AccuracyError, BoolArray, FloatArray
from lmeasure.io import Strict, checked, files
from lmeasure.kernels import BODY_COLUMNS, BODY_LENGTH, BODY_OF_TOOL, BODY_RADIUS, BODY_START, BODY_WAY, CANNOT_RUN, SINGULAR
from lmeasure.text import message


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
        raise AccuracyError(message("error.an_accuracy_of_mm", position_mm=position_mm, length_mm=length_mm))
    return math.degrees(math.acos(length_mm / position_mm))


REASONS = (
    "cable_cannot_run", "singular", "pressure_angle", "cable_too_short", "cable_too_long", "u95_position", "u95_rotation", "u95_attachment",
    "wrap", "clearance", "other_assembly", "near_singular",
)  # fmt: skip
"""Reasons why a node is not in the zone, in the order of the bits of `rejected_because`."""


@dataclass(frozen=True)
class Limits:
    """Conditions of a pose in the zone; None is no condition.

    angle_deg: pressure-angle analogue; length_mm: shortest and longest cable, B to attachment point; u95_mm, u95_rotation_deg,
    u95_attachment_mm: 95 % radii of the tool origin, the rotation vector and the worst attachment point; wrap_deg: largest wrapped angle;
    clearance_mm: least distance between cables and from cable to body; one_assembly: the determinant of six cables keeps its sign (more
    cables have no singular surface between their assemblies); singularity: least `singularity_distance`.
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
            raise AccuracyError(message("error.a_pressure_angle_limit", angle_deg=self.angle_deg))
        if self.length_mm is not None and not 0.0 <= self.length_mm[0] < self.length_mm[1]:
            raise AccuracyError(message("error.cable_lengths_of_to", length_mm=self.length_mm[0], length_mm2=self.length_mm[1]))
        for name in ("u95_mm", "u95_rotation_deg", "u95_attachment_mm", "wrap_deg", "clearance_mm", "singularity"):
            value = getattr(self, name)
            if value is not None and not 0.0 <= value < math.inf:
                raise AccuracyError(message("error.a_limit_must_be", name=name, value=value))

    @property
    def needs_all(self) -> bool:
        """Return whether the limits need the radii of rotation and attachment points."""
        return self.u95_rotation_deg is not None or self.u95_attachment_mm is not None


def broken_limits(figures: Mapping[str, NDArray[Any]], limits: Limits, sign: int | None = None) -> tuple[NDArray[np.int32], int]:
    """Bits of `REASONS` for arrays of figures named as in the dataset, with `flags`; and the assembly's sign. The assembly that
    `one_assembly` keeps is the given sign, or that of most places without another fault."""
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


def _length(value: float) -> float:
    if not abs(value) <= 1e6:
        raise ValueError(message("error.must_be_a_length"))
    return value


Length = Annotated[float, AfterValidator(_length)]


class Body(Strict):
    """Capsule: all points within `radius_mm` of a line segment. A cable's clearance is at most its attachment point's distance."""

    name: Annotated[str, Field(min_length=1)]
    """Name of the body in reports."""
    frame: Literal["base", "tool"] = "base"
    """base: the body is fixed in the cell; tool: it moves with the tool."""
    from_mm: tuple[Length, Length, Length]
    """First end of the segment, in that frame."""
    to_mm: tuple[Length, Length, Length]
    """Second end of the segment, in that frame; equal to the first for a ball."""
    radius_mm: Annotated[float, Field(gt=0), AfterValidator(_length)]
    """Radius of the body around the segment."""


class BodiesFile(Strict):
    """Bodies that cables must not touch, input of `lmeasure zone --bodies`."""

    schema_: Annotated[Literal["lmeasure.bodies/1"], Field(alias="schema")]
    """Kind and version of the file."""
    body: tuple[Body, ...]
    """Bodies, one table `[[body]]` each."""


def read_bodies(path: Path) -> tuple[Body, ...]:
    """Read `schema = "lmeasure.bodies/1"` and [[body]] tables; FileFormatError names the file and the key."""
    return checked(files.read_toml(path), BodiesFile, str(path)).body


def body_rows(bodies: Sequence[Body]) -> FloatArray:
    """(b, BODY_COLUMNS) rows of the kernels: start, unit way, length, radius [mm], 1 when it is the tool's."""
    out = np.zeros((len(bodies), BODY_COLUMNS))
    for row, body in zip(out, bodies, strict=True):
        way = np.subtract(body.to_mm, body.from_mm)
        length = math.sqrt(float(way @ way))
        row[BODY_START : BODY_START + 3] = body.from_mm
        row[BODY_WAY : BODY_WAY + 3] = way / length if length > 0.0 else (1.0, 0.0, 0.0)
        row[BODY_LENGTH], row[BODY_RADIUS], row[BODY_OF_TOOL] = length, body.radius_mm, 1.0 if body.frame == "tool" else 0.0
    return out
