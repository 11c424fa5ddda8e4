"""Bodies that the cables must not touch: capsules of the cell or of the tool."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field

from lmeasure.core import FloatArray
from lmeasure.io import Strict, checked, files
from lmeasure.kernels import BODY_COLUMNS, BODY_LENGTH, BODY_OF_TOOL, BODY_RADIUS, BODY_START, BODY_WAY


def _length(value: float) -> float:
    if not abs(value) <= 1e6:
        raise ValueError("must be a length of at most a kilometre")
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
