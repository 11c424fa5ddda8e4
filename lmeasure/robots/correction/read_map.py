"""Measured errors of a robot from a table: where it was sent in its base, and by how much it was off."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from lmeasure.core import MAX_LENGTH_MM, FileFormatError, FloatArray
from lmeasure.io import Column, ForeignTable

LARGEST_MM, LARGEST_DEG = 100.0, 10.0
"""Errors beyond which frames or units are others than stated."""


@dataclass(frozen=True)
class MeasuredErrors:
    """poses (N, 7) that were commanded, base from the measured target; errors_mm (N, 3), turns (N, 3) [rad] of the attained less these,
    about the base's axes, None where orientations were not measured; turned: whether the commanded orientations are stated."""

    poses: FloatArray
    errors_mm: FloatArray
    turns: FloatArray | None
    turned: bool


def read_map(path: Path, columns: Mapping[str, Column] | None = None) -> MeasuredErrors:
    """Read `x_mm, y_mm, z_mm` commanded, with an orientation of any convention, and `dx_mm, dy_mm, dz_mm` errors, or the attained
    `attained_x_mm` ... instead; optional `drx_deg, dry_deg, drz_deg`, a small turn about the base's axes.

    FileFormatError names file, line and column, and errors too large to be those of a robot.
    """
    table = ForeignTable(path, columns)
    if len(table) == 0:
        raise FileFormatError(f"{path}: has no rows")
    place = np.column_stack([table.numbers(axis, "mm") for axis in "xyz"])
    if table.find("dx", "mm") is None and table.find("attained_x", "mm") is not None:
        errors = np.column_stack([table.numbers(f"attained_{axis}", "mm") for axis in "xyz"]) - place
    else:
        errors = np.column_stack([table.numbers(f"d{axis}", "mm") for axis in "xyz"])
    turns = None
    if table.find("drx", "deg") is not None:
        turns = np.column_stack([table.numbers(f"dr{axis}", "deg") for axis in "xyz"])
        _limited(table, np.abs(turns).max(axis=1), LARGEST_DEG, "deg")
    _limited(table, np.linalg.norm(errors, axis=1), LARGEST_MM, "mm")
    far = (np.abs(place) > MAX_LENGTH_MM).any(axis=1)
    if far.any():
        raise FileFormatError(f"{table.row(int(np.argmax(far)))}: lies more than {MAX_LENGTH_MM:.0f} mm from the origin")
    quaternion = table.orientation()
    table.nothing_else()
    here = np.tile([0.0, 0.0, 0.0, 1.0], (len(table), 1))
    poses = np.concatenate([place, here if quaternion is None else quaternion], axis=1)
    return MeasuredErrors(poses, errors, None if turns is None else np.radians(turns), quaternion is not None)


def _limited(table: ForeignTable, size: FloatArray, most: float, unit: str) -> None:
    if (size > most).any():
        row = int(np.argmax(size > most))
        raise FileFormatError(
            f"{table.row(row)}: an error of {size[row]:.4g} {unit}, more than {most:g}: frames or units are others than stated"
        )
