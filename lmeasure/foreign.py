"""Tables of other people: any usual separator, decimal commas, code pages, and columns under other names in other units.

`--columns x=X[m],joint_1=A1[rad]` says which column is which and in which unit; columns under our own names need not be mentioned.
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pyarrow as pa

from lmeasure import files
from lmeasure.arrays import FloatArray
from lmeasure.conventions import CONVENTIONS, QUATERNION_COLUMNS, AngleConvention, check_angles, rotation_from_angles
from lmeasure.errors import FileFormatError, SettingsError
from lmeasure.opened import read_regular

LARGEST = 1 << 28
KINDS = {
    "mm": {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "in": 25.4},
    "deg": {"deg": 1.0, "rad": 57.29577951308232},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
}
"""Units of lengths, angles and times: how many of ours are in one."""
UNITS = {unit: size for kind in KINDS.values() for unit, size in kind.items()}
ANGLES = {name.rsplit("_", 1)[0] for each in CONVENTIONS.values() for name in each.columns}
"""What controllers call them."""
INDEX = ("", "Unnamed: 0")
"""What a first column without a name is called: not at all, or by pandas, which has read and written it again."""
UNIT_TOLERANCE = 1e-3
"""Of a quaternion's length: other programs write four digits."""
_MAPPED = re.compile(r"\s*([^=\s]+)\s*=\s*(.+?)\s*(?:\[\s*(\w+)\s*\])?\s*")
_HEADED = re.compile(r"(.+?)\s*[\[(]\s*(\w+)\s*[\])]")
_COMMENTS = ("#", "%", "//")
_NUMBER = re.compile(r"[+-]?[\d.,]+([eE][+-]?\d+)?")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Column:
    """Where a quantity stands in a file: the column's name there, and its unit."""

    name: str
    unit: str


def columns_of(text: str) -> dict[str, Column]:
    """What `--columns` says, by our names without units; SettingsError for what is no mapping."""
    out: dict[str, Column] = {}
    for part in (p for p in text.split(",") if p.strip()):
        match = _MAPPED.fullmatch(part)
        if match is None or (match[3] and match[3] not in UNITS):
            known = ", ".join(UNITS)
            raise SettingsError("columns", f"{part.strip()!r} is not name=column[unit]; units: {known}")
        if match[1] in out:
            raise SettingsError("columns", f"{match[1]!r} is given twice")
        out[match[1]] = Column(match[2], match[3] or "")
    return out


class ForeignTable:
    """A table whose columns are asked for by our own names; numbers come in millimetres and degrees."""

    def __init__(self, path: Path, columns: Mapping[str, Column] | None = None, *, part: bool = False) -> None:
        """columns: None where whoever asks has no --columns. part: --columns speaks of other files too, and what this one has not is one
        of theirs; half a quaternion is none."""
        self.path = Path(path)
        self._columns = dict(columns or {})
        self._mapped, self._part = columns is not None, part
        self.lines: list[int] = []
        """Where its rows stand in a text file."""
        self._asked = set[str]()
        """Names by which columns were looked for."""
        self._units: dict[str, str] = {}
        """Of columns, where a row under the header says them."""
        if self.path.suffix.lower() == ".parquet":
            self._table = files.read_table(self.path)
        else:
            self._table, self.lines, self._units = _read(self.path)
        # a column may be stated by its number, from 1
        own = self._table.columns
        numbers = {str(i + 1): name for i, name in enumerate(own) if str(i + 1) not in own}
        self._columns = {name: replace(column, name=numbers.get(column.name, column.name)) for name, column in self._columns.items()}
        if part:
            self._columns = {name: column for name, column in self._columns.items() if column.name in own}
        for name, column in self._columns.items():
            if column.name not in self._table.columns:
                raise FileFormatError(f"{path}: column {column.name!r}, which --columns says is {name}, is missing; it has {self.has}")

    @property
    def columns(self) -> list[str]:
        """Names of its columns, as the file has them."""
        return self._table.columns

    @property
    def mapped(self) -> frozenset[str]:
        """Our names of the columns that --columns says and the file has."""
        return frozenset(self._columns)

    @property
    def has(self) -> str:
        """Names of its columns."""
        return ", ".join(name for name in self._table.columns if name)

    def __len__(self) -> int:
        return len(self._table)

    def find(self, name: str, unit: str = "") -> Column | None:
        """Where a quantity stands: as --columns says, else under its name with a unit as ours or as others write it (`x_mm`, `X [m]`, or
        a row of units)."""
        self._asked.add(name)
        if name in self._columns:
            column = self._columns[name]
            return Column(column.name, column.unit or self._units.get(column.name, unit))
        for other in KINDS.get(unit, {}):
            if f"{name}_{other}" in self._table.columns:
                return Column(f"{name}_{other}", other)
        for own in self._table.columns:
            headed = _HEADED.fullmatch(own)
            if headed and headed[1].lower() == name and headed[2] in UNITS:
                return Column(own, headed[2])
            if own.lower() == name and self._units.get(own) in KINDS.get(unit, {}):
                return Column(own, self._units[own])
        return Column(name, "") if name in self._table.columns and not unit else None

    def nothing_else(self) -> None:
        """When all is read: SettingsError names what --columns says of something that is not."""
        for name, column in self._columns.items():
            if name not in self._asked | ANGLES:
                known = ", ".join(sorted(n for n in self._asked - ANGLES if not n.endswith(("_mm", "_rad"))))
                told = f"{name}={column.name}: {self.path} is asked for {known}, and controllers' angles, not for {name}"
                raise SettingsError("columns", told)

    def orientation(self, preferred: AngleConvention | None = None, *, gaps: bool = False) -> FloatArray | None:
        """(n, 4) quaternions x, y, z, w of unit length, from `qx` ... `qw` or the angles of any controller's convention, NaN in a row
        without one where gaps are allowed; None where there is no such column. preferred: whose columns are looked for first, in any
        unit. FileFormatError names a row whose quaternion is none, and what of a quaternion is missing."""
        if all(self.find(name) for name in QUATERNION_COLUMNS):
            out = np.column_stack([self.numbers(name, gaps=gaps) for name in QUATERNION_COLUMNS])
            length = np.linalg.norm(out, axis=1)
            bad = np.abs(length - 1.0) > UNIT_TOLERANCE
            if bad.any():
                i = int(np.argmax(bad))
                raise FileFormatError(f"{self.row(i)}: the quaternion's length is {length[i]:.9g}, not 1")
            return np.asarray(out / length[:, None])
        # a and rx stand in several: only a set that is there whole counts, the longest names first
        first = () if preferred is None else (preferred,)
        for each, any_unit in (*((c, False) for c in (*first, *CONVENTIONS.values())), *((c, True) for c in first)):
            columns = [tuple(name.rsplit("_", 1)) for name in each.columns]
            if all(
                name in self._columns or f"{name}_{unit}" in self._table.columns or (any_unit and self.find(name, "deg"))
                for name, unit in columns
            ):
                values = np.column_stack([self.numbers(name, "deg", gaps=gaps) for name, _ in columns])
                check_angles(values[~np.isnan(values)], f"{self.path}: {', '.join(each.columns)}")
                known = ~np.isnan(values).any(axis=1)
                out = np.full((len(values), 4), np.nan)
                of = np.radians(values[known]) if each.axes == "rotvec" else values[known]
                out[known] = rotation_from_angles(each.name, of).as_quat()
                return out
        some = [name for name in QUATERNION_COLUMNS if self.find(name)]
        if some and not self._part:
            missing = ", ".join(name for name in QUATERNION_COLUMNS if name not in some)
            raise FileFormatError(f"{self.path}: has {', '.join(some)}, but no {missing}: a quaternion is all four")
        return None

    def row_names(self, *called: str) -> list[str] | None:
        """Return what the rows are called: the cells of the first of these columns, else of a first column without a name, as pandas writes
        its index; None where neither is there."""
        name = next((name for name in called if self.find(name)), None)
        if name is not None:
            return self.text(name)
        first = self._table.columns[0]
        return self._table.text(first) if first in INDEX else None

    def row(self, index: int) -> str:
        """Which row that is, for a complaint: file and line."""
        return f"{self.path}: line {self.lines[index]}" if self.lines else f"{self.path}: row {index + 1}"

    def numbers(self, name: str, unit: str = "", *, gaps: bool = False) -> FloatArray:
        """(n,) floats [mm, deg, or none] of a quantity; FileFormatError where the file has it not, or not with a unit of its kind."""
        column = self.find(name, unit)
        if column is None:
            shown, said = (f"{name}_{unit}", f"{name}=COLUMN[{unit}]") if unit else (name, f"{name}=COLUMN")
            hint = f"; --columns {said} says which it is" if self._mapped else ""
            raise FileFormatError(f"{self.path}: column {shown!r} is missing; it has {self.has}{hint}")
        if unit and column.unit not in KINDS[unit]:
            raise FileFormatError(f"{self.path}: column {column.name!r}: {column.unit!r} is no unit of {name}")
        return self._table.numbers(column.name, gaps=gaps) * (UNITS[column.unit] if unit else 1.0)

    def text(self, name: str) -> list[str]:
        """(n,) cells of a quantity as text."""
        column = self.find(name)
        if column is None:
            raise FileFormatError(f"{self.path}: column {name!r} is missing; it has {self.has}")
        return self._table.text(column.name)


def text_of(path: Path) -> str:
    """A text file in UTF-8, UTF-16 or cp1252; FileFormatError where it is none."""
    return decoded(read_regular(Path(path), LARGEST), path)


def _read(path: Path) -> tuple[files.Table, list[int], dict[str, str]]:
    """A text file of any usual separator, code page and decimal mark, the lines of its rows, and units of a row of them under the header;
    comments (#, %, //), blank lines and titles before the header are left out."""
    text = text_of(path)
    lines = text.splitlines()
    first = _header(lines)
    if first is None:
        raise FileFormatError(f"{path}: is empty")
    separator = _separator(lines[first])
    if separator not in lines[first] and len(lines[first].split()) > 1:
        lines = [*lines[:first], *(",".join(line.split()) for line in lines[first:])]
        separator = ","
    try:
        rows = [[cell.strip() for cell in row] for row in csv.reader(lines[first:], delimiter=separator)]
    except csv.Error as error:
        raise FileFormatError(f"{path}: cannot be read as a table: {error}") from None
    header = rows[0]
    while header and not header[-1]:
        header.pop()
    numbered = [(first + 1 + k, row) for k, row in enumerate(rows[1:], 1) if any(row) and not row[0].startswith(_COMMENTS)]
    units = dict[str, str]()
    if numbered and all(cell.strip("[]()") in ("", *UNITS) for cell in numbered[0][1]) and any(numbered[0][1]):
        units = {name: cell.strip("[]()") for name, cell in zip(header, numbered.pop(0)[1], strict=False) if cell}
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice:
        raise FileFormatError(f"{path}: column {twice[0]!r} stands twice" if twice[0] else f"{path}: several columns have no name")
    if "" in header[1:]:
        raise FileFormatError(f"{path}: column number {header.index('', 1) + 1} has no name")
    for line, row in numbered:
        if len(row) < len(header) or any(row[len(header) :]):
            raise FileFormatError(f"{path}:{line}: has {len(row)} cells, the first line {len(header)}")
    if separator != ",":
        numbered = [(line, [cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell for cell in row]) for line, row in numbered]
    columns = {name: pa.array([row[i] or None for _, row in numbered], pa.string()) for i, name in enumerate(header)}
    return files.Table(path, pa.table(columns), first), [line for line, _ in numbered], units


def _separator(line: str) -> str:
    """Of the cells of a line."""
    return max((";", "\t", "|", ","), key=lambda s: (line.count(s) > 0, s != ",", line.count(s)))


def _header(lines: list[str]) -> int | None:
    """The line with the names of columns: the first that has as many cells as the next and no number among them, else the first of all that
    is not blank and no comment."""
    there = [i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(_COMMENTS)]
    for i, following in pairwise(there):
        separator = _separator(lines[i])
        cells = lines[i].split(separator)
        if len(cells) > 1 and lines[following].count(separator) == len(cells) - 1 and not any(_NUMBER.fullmatch(c.strip()) for c in cells):
            return i
    return there[0] if there else None


def decoded(raw: bytes, path: Path) -> str:
    """Text in UTF-8, UTF-16 or cp1252; FileFormatError where it is none."""
    code = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    for attempt in (code, "cp1252"):
        try:
            text = raw.decode(attempt)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise FileFormatError(f"{path}: is no text file")
