"""Tables of poses, as this program writes them or as anybody else: columns by mapping, units, separators, decimal commas, code pages."""

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa

from lmeasure.core import QUATERNION_COLUMNS, FileFormatError, convention
from lmeasure.io import Column, ForeignTable, files, text_of

PLACES = ("x", "y", "z")
STATED = (
    ("u_position", "mm"),
    ("u_rotation", "deg"),
    ("u_repeatability", "mm"),
    ("u_repeatability", "deg"),
    *((f"u_{axis}", "mm") for axis in PLACES),
    *((f"u_r{axis}", "deg") for axis in PLACES),
)
"""What may be stated beside a pose, by name and unit."""


def read_pose_table(
    path: Path, angles: str, columns: Mapping[str, Column] | None = None, *, unnamed: bool = False, part: bool = False
) -> files.Table:
    """A table with our own columns: pose, x_mm, y_mm, z_mm, and quaternions or the angles of the convention where it has orientations.

    columns: which column is which, as `foreign.columns_of` reads it; pose may be called name too, or be a first column without a name.
    unnamed: poses without these are called by their number, from 1. part: columns speaks of other tables too. FileFormatError says what is
    missing.
    """
    path = Path(path)
    if not columns and (not path.is_file() or path.suffix.lower() == ".parquet" or _is_ours(path)):
        return files.read_table(path)
    given = ForeignTable(path, columns, part=part)
    names = given.row_names("pose", "name")
    if names is None and not unnamed:
        hint = "" if columns is None else "; --columns says which column is which"
        raise FileFormatError(f"{path}: column 'pose' is missing; it has {given.has}{hint}")
    names = names or [str(i + 1) for i in range(len(given))]
    out: dict[str, pa.Array] = {"pose": pa.array(names, pa.string())}
    out |= {f"{axis}_mm": pa.array(given.numbers(axis, "mm")) for axis in PLACES}
    turns = given.orientation(convention(angles))
    if turns is not None:
        out |= {name: pa.array(values) for name, values in zip(QUATERNION_COLUMNS, turns.T, strict=True)}
    for name, unit in STATED:
        if given.find(name, unit):
            out[f"{name}_{unit}"] = pa.array(given.numbers(name, unit))
    for name in given.columns:
        if name == "temperature_c" or name.startswith("rho_"):
            out[name] = pa.array(np.asarray(given.numbers(name)))
    given.nothing_else()
    return files.Table(path, pa.table(out), lines=given.lines)


def _is_ours(path: Path) -> bool:
    """Whether the header is one of this program: names with units, commas between."""
    line = next((line for line in text_of(path).splitlines() if line.strip()), "")
    names = [name.strip().strip('"') for name in line.split(",")]
    return "pose" in names and any(f"{axis}_mm" in names for axis in PLACES) and not any(name.endswith("_rad") for name in names)
