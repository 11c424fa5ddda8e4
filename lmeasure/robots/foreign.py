"""Tables of other people: any usual separator, decimal commas, code pages, and columns under other names in other units.

`--columns x=X[m],joint_1=A1[rad]` says which column is which and in which unit; columns under our own names need not be mentioned.
"""

import csv
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import pyarrow as pa

from lmeasure import files
from lmeasure.arrays import FloatArray
from lmeasure.errors import FileFormatError
from lmeasure.opened import read_regular

LARGEST = 1 << 28
UNITS = {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "in": 25.4, "deg": 1.0, "rad": 57.29577951308232}
"""Millimetres or degrees in one."""
_MAPPED = re.compile(r"\s*([^=\s]+)\s*=\s*(.+?)\s*(?:\[\s*(\w+)\s*\])?\s*")
_HEADED = re.compile(r"(.+?)\s*[\[(]\s*(\w+)\s*[\])]")
_COMMA = re.compile(r"[+-]?\d*,\d+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Column:
    """Where a quantity stands in a file: the column's name there, and its unit."""

    name: str
    unit: str


def columns_of(text: str) -> dict[str, Column]:
    """What `--columns` says, by our names without units; FileFormatError for what is no mapping."""
    out: dict[str, Column] = {}
    for part in (p for p in text.split(",") if p.strip()):
        match = _MAPPED.fullmatch(part)
        if match is None or (match[3] and match[3] not in UNITS):
            known = ", ".join(UNITS)
            raise FileFormatError(f"--columns: {part.strip()!r} is not name=column[unit]; units: {known}")
        if match[1] in out:
            raise FileFormatError(f"--columns: {match[1]!r} is given twice")
        out[match[1]] = Column(match[2], match[3] or "")
    return out


class ForeignTable:
    """A table whose columns are asked for by our own names; numbers come in millimetres and degrees."""

    def __init__(self, path: Path, columns: Mapping[str, Column] | None = None) -> None:
        self.path = Path(path)
        self._columns = dict(columns or {})
        self._table = files.read_table(self.path) if self.path.suffix.lower() == ".parquet" else _read(self.path)
        for name, column in self._columns.items():
            if column.name not in self._table.columns:
                raise FileFormatError(f"{path}: column {column.name!r}, which --columns says is {name}, is missing; it has {self.has}")

    @property
    def has(self) -> str:
        """Names of its columns."""
        return ", ".join(self._table.columns)

    def __len__(self) -> int:
        return len(self._table)

    def find(self, name: str, unit: str = "") -> Column | None:
        """Where a quantity stands: as --columns says, else under its name with a unit as ours or as others write it (`x_mm`, `x [m]`)."""
        if name in self._columns:
            column = self._columns[name]
            return Column(column.name, column.unit or unit)
        lengths, angles = ("mm", "m", "cm", "um", "in"), ("deg", "rad")
        for other in lengths if unit == "mm" else angles if unit == "deg" else ():
            if f"{name}_{other}" in self._table.columns:
                return Column(f"{name}_{other}", other)
        for own in self._table.columns:
            headed = _HEADED.fullmatch(own)
            if headed and headed[1] == name and headed[2] in UNITS:
                return Column(own, headed[2])
        return Column(name, "") if name in self._table.columns and not unit else None

    def numbers(self, name: str, unit: str = "", *, gaps: bool = False) -> FloatArray:
        """(n,) floats [mm, deg, or none] of a quantity; FileFormatError where the file has it not, or not with a unit of its kind."""
        column = self.find(name, unit)
        if column is None:
            shown = f"{name}_{unit}" if unit else name
            raise FileFormatError(f"{self.path}: column {shown!r} is missing; it has {self.has}; --columns says which column is which")
        kinds = ("mm", "m", "cm", "um", "in"), ("deg", "rad")
        if unit and column.unit not in next(kind for kind in kinds if unit in kind):
            raise FileFormatError(f"{self.path}: column {column.name!r}: {column.unit!r} is no unit of {name}")
        return self._table.numbers(column.name, gaps=gaps) * (UNITS[column.unit] if unit else 1.0)

    def text(self, name: str) -> list[str]:
        """(n,) cells of a quantity as text."""
        column = self.find(name)
        if column is None:
            raise FileFormatError(f"{self.path}: column {name!r} is missing; it has {self.has}")
        return self._table.text(column.name)


def _read(path: Path) -> files.Table:
    """A text file of any usual separator, code page and decimal mark; comments (#, %) and blank lines before the header are left out."""
    raw = read_regular(path, LARGEST)
    text = _decoded(raw, path)
    lines = text.splitlines()
    first = next((i for i, line in enumerate(lines) if line.strip() and line.lstrip()[0] not in "#%"), None)
    if first is None:
        raise FileFormatError(f"{path}: is empty")
    separator = max((";", "\t", "|", ","), key=lambda s: (lines[first].count(s) > 0, s != ",", lines[first].count(s)))
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
    numbered = [(first + 1 + k, row) for k, row in enumerate(rows[1:], 1) if any(row) and not row[0].startswith(("#", "%"))]
    twice = sorted({name for name in header if header.count(name) > 1})
    if twice or "" in header:
        raise FileFormatError(
            f"{path}: column {twice[0]!r} stands twice" if twice else f"{path}: column number {header.index('') + 1} has no name"
        )
    for line, row in numbered:
        if len(row) < len(header) or any(row[len(header) :]):
            raise FileFormatError(f"{path}:{line}: has {len(row)} cells, the first line {len(header)}")
    if separator != ",":
        numbered = [(line, [cell.replace(",", ".") if _COMMA.fullmatch(cell) else cell for cell in row]) for line, row in numbered]
    columns = {name: pa.array([row[i] or None for _, row in numbered], pa.string()) for i, name in enumerate(header)}
    return files.Table(path, pa.table(columns), first)


def _decoded(raw: bytes, path: Path) -> str:
    code = "utf-16" if raw[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    for attempt in (code, "cp1252"):
        try:
            text = raw.decode(attempt)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise FileFormatError(f"{path}: is no text file")
