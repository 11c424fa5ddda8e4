"""A table of other people by our own names: numbers in millimetres, degrees and seconds, and orientations by their convention."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa

from lmeasure.core import (
    CONVENTIONS,
    QUATERNION_COLUMNS,
    AngleConvention,
    FileFormatError,
    FloatArray,
    SettingsError,
    check_angles,
    rotation_from_angles,
)
from lmeasure.io import files
from lmeasure.io.foreign.layout import (
    ANGLES,
    BODY,
    COLUMN_KINDS,
    UNITS,
    Column,
    Layout,
    are_clock_times,
    clock_times,
    decimal_marks,
    headed,
    layout_of,
    plain,
    scaled,
    without_blanks,
)
from lmeasure.text import message

UNIT_TOLERANCE = 1e-3
"""Tolerance of a quaternion's length: other programs write four digits."""
TIMES = ("time", "timestamp", "t")
"""Headers of a column of times, beside a unit of theirs or clock times."""
INDEX = ("", "Unnamed: 0")
"""Names of a first column without a name: not at all, or by pandas, which has read and written it again."""
_GROUPS = {"x": ("Position", "T"), "y": ("Position", "T"), "z": ("Position", "T")}
"""Group names that mark positions among several columns of one name, in a header of several rows."""


class ForeignTable:
    """A table with columns under our own names; numbers come in millimetres and degrees."""

    def __init__(self, path: Path, columns: Mapping[str, Column] | None = None, *, part: bool = False) -> None:
        """columns: None for a caller without --columns. part: --columns may name columns of other files too; half a quaternion is an
        error."""
        self.path = Path(path)
        self._mapped, self._part = columns is not None, part
        self.lines: list[int] = []
        """Lines of its rows in a text file."""
        self._asked = set[str]()
        """Names of the requested columns."""
        self.read_as = ""
        """Reading of the orientation: columns and convention; empty before, and where there is none."""
        self.unread: tuple[str, ...] = ()
        """Columns that look like angles of an unstated convention."""
        self.day = ""
        """Date of the first time, where clock times with dates were read."""
        self._marks: set[str] | None = None
        layout = Layout([], [])
        if self.path.suffix.lower() == ".parquet":
            self._table = files.read_table(self.path)
            self._names, self._twice = self._table.columns, set[str]()
        else:
            layout = layout_of(self.path)
            self._table, self._names, self._twice = _table(self.path, layout)
            self.lines = [line for line, _ in layout.rows]
        self._units = layout.units
        self.layout = layout
        given = dict(columns or {})
        whose = self._body(given.get(BODY))
        self._columns = {name: Column(at.name, at.unit) for name, at in whose.items()}
        for name, column in given.items():
            if name == BODY and (layout.bodies or layout.markers):
                self._asked.add(name)
                continue
            try:
                self._columns[name] = self._resolved(name, column)
            except FileFormatError:
                if not part:
                    raise

    def _body(self, chosen: Column | None) -> dict[str, Column]:
        """Return the columns of the chosen or only body, for formats with bodies; FileFormatError lists them."""
        there = {**self.layout.bodies, **self.layout.markers}
        if chosen is not None and there:
            if chosen.name not in there:
                raise FileFormatError(
                    message("error.which_columns_calls_is", where=self.path, name=chosen.name, body=BODY, there=", ".join(there))
                )
            return there[chosen.name]
        one = self.layout.bodies or self.layout.markers
        return next(iter(one.values())) if len(one) == 1 else {}

    def _resolved(self, name: str, column: Column) -> Column:
        """Return a column in the file's form from its name in --columns: its whole header, or its name without the unit.

        FileFormatError if it is missing, occurs twice or is in another unit.
        """
        own = self._names
        # a column may be stated by its number, from 1
        number = int(column.name) - 1 if column.name.isdecimal() and column.name not in own else -1
        exact = [own[number]] if 0 <= number < len(own) else [n for n in own if n == column.name]
        whole = [n for n in own if column.text and _squeezed(n) == _squeezed(column.text)]
        unit = column.unit
        if not exact and whole:
            found, unit = whole, ""
        else:
            found = exact or [n for n in own if headed(n)[0].lower() == column.name.lower() and n]
        if not found and self.layout.said:
            ends = [n for n in own if n.rpartition(".")[2] == column.name]
            found = [n for n in ends if n.split(".")[-2] in _GROUPS.get(name, ("Rotation",))] or ends
        if not found:
            raise FileFormatError(message("error.column_which_columns_says", where=self.path, name=column.name, name2=name, has=self.has))
        if len(found) > 1:
            raise FileFormatError(
                message("error.column_which_columns_says_is", where=self.path, name=column.name, name2=name, found=", ".join(found))
            )
        stated = self._units.get(found[0]) or headed(found[0])[1]
        if unit and stated and unit != stated and any(unit in kind and stated in kind for kind in COLUMN_KINDS.values()):
            raise FileFormatError(message("error.column_is_in_by", where=self.path, found=found[0], stated=stated, unit=unit))
        return Column(found[0], unit or stated)

    def holds(self, name: str, column: Column) -> bool:
        """Return whether the table has a column that --columns states."""
        try:
            self._resolved(name, column)
        except FileFormatError:
            return False
        return True

    @property
    def mapped(self) -> frozenset[str]:
        """Return our names of the columns that --columns states and the file has."""
        return frozenset(self._columns)

    @property
    def columns(self) -> list[str]:
        """Names of its columns, as the file has them."""
        return self._names

    @property
    def has(self) -> str:
        """Names of its columns."""
        return ", ".join(name for name in self._names if name)

    def __len__(self) -> int:
        return len(self._table)

    def find(self, name: str, unit: str = "") -> Column | None:
        """Return the column of a quantity: by --columns, else under its name with a unit in our or others' form (`x_mm`, `X [m]`, or a row
        of units); times by clock need no unit."""
        self._asked.add(name)
        kind = COLUMN_KINDS.get(unit, {})
        if name in self._columns:
            column = self._columns[name]
            return Column(column.name, column.unit or unit)
        for other in kind:
            if f"{name}_{other}" in self._names:
                return Column(f"{name}_{other}", other)
        called = TIMES if name == "time" else (name,)
        for own in self._names:
            bare, stated = headed(own)
            stated = self._units.get(own) or stated
            if unit and bare.lower() in called and stated in kind:
                return Column(own, stated)
        if unit == "s":
            clocks = [own for own in self._names if own.lower() in called and self._is_clock(own)]
            return Column(clocks[0], "s") if clocks else None
        return Column(name, "") if name in self._names and not unit else None

    def _is_clock(self, column: str) -> bool:
        kind = self._table.kind(column)
        return pa.types.is_timestamp(kind) or (pa.types.is_string(kind) and are_clock_times(self._table.text(column)[:20]))

    def nothing_else(self) -> None:
        """Raise SettingsError for columns in --columns that do not exist, after all is read."""
        for name, column in self._columns.items():
            if name not in self._asked | ANGLES:
                known = ", ".join(sorted(n for n in self._asked - ANGLES if not n.endswith(("_mm", "_rad"))))
                reported = message("file.column_unused", name=name, column=column.name, path=self.path, known=known)
                raise SettingsError("columns", reported)

    def orientation(self, preferred: AngleConvention | None = None, *, likely: str | None = None, gaps: bool = False) -> FloatArray | None:
        """Return (n, 4) quaternions x, y, z, w of unit length, from `qx` ... `qw` or the angles of a controller's convention.

        preferred: the convention that is stated for the file. likely: the program's, used unless the units contradict it. NaN in a row
        without one if gaps are allowed; None without such a column. FileFormatError names a row with a wrong quaternion, the missing part
        of a quaternion, or the conventions among which nothing decides.
        """
        if all(self.find(name) for name in QUATERNION_COLUMNS):
            out = np.column_stack([self.numbers(name, gaps=gaps) for name in QUATERNION_COLUMNS])
            length = np.linalg.norm(out, axis=1)
            bad = np.abs(length - 1.0) > UNIT_TOLERANCE
            if bad.any():
                i = int(np.argmax(bad))
                raise FileFormatError(message("error.the_quaternion_s_length", where=self.row(i), length=length[i]))
            names = [column.name for name in QUATERNION_COLUMNS if (column := self.find(name))]
            self.read_as = f"{', '.join(names)}: quaternion x, y, z, w"
            return np.asarray(out / length[:, None])
        if preferred is not None:
            self._columns |= self._without_units(preferred)
        chosen = self._convention(None if preferred is None else preferred.name, likely)
        if chosen is not None:
            return self._turned(chosen, gaps)
        some = [name for name in QUATERNION_COLUMNS if self.find(name)]
        if some and not self._part:
            missing = ", ".join(name for name in QUATERNION_COLUMNS if name not in some)
            raise FileFormatError(message("error.has_but_no_a", where=self.path, some=", ".join(some), missing=missing))
        return None

    def _without_units(self, convention: AngleConvention) -> dict[str, Column]:
        """Return the columns under the bare names of a stated convention (`A, B, C`), which states their unit; empty without all three."""
        names = [name.rsplit("_", 1)[0] for name in convention.columns]
        own = {name.lower(): Column(name, "") for name in self._names if not self._units.get(name)}
        missing = [name for name in names if not self.find(name, "deg")]
        return {name: own[name] for name in missing} if own.keys() >= set(missing) else {}

    def _angles(self, convention: AngleConvention) -> tuple[Column, ...]:
        """Return the columns of the three angles, each with its stated unit, if any; empty if one is missing."""
        out = []
        for name in (n.rsplit("_", 1)[0] for n in convention.columns):
            column = self.find(name, "deg")
            if column is None:
                return ()
            out.append(self._columns.get(name, column))
        return tuple(out)

    def _convention(self, stated: str | None, likely: str | None) -> AngleConvention | None:
        """Return the convention of the file's angles, None without angles or with a foreign header alone.

        The stated one counts first, in any unit, then the one that the format fixes; else the program's, or that of the unit. Otherwise the
        user must state it.
        """
        there = {name: found for name, each in CONVENTIONS.items() if (found := self._angles(each))}
        for one in (stated, self.layout.angles):
            if one and one in there:
                return CONVENTIONS[one]
        explicit = {
            name
            for name, found in there.items()
            if not self.layout.said
            and all(
                n.rsplit("_", 1)[0] in self._columns or (at.name == f"{n.rsplit('_', 1)[0]}_{at.unit}")
                for n, at in zip(CONVENTIONS[name].columns, found, strict=True)
            )
        }
        by_unit = {name for name in explicit if {at.unit for at in there[name]} == {_native(CONVENTIONS[name])}}
        if likely in there and (likely in by_unit or len(there) == 1 or {at.unit for at in there[likely]} == {""}):
            return CONVENTIONS[str(likely)]
        if likely not in explicit:
            one_left = by_unit or (explicit if len(there) == 1 else set())
            if len(one_left) == 1:
                return CONVENTIONS[next(iter(one_left))]
        if explicit:
            columns = ", ".join(dict.fromkeys(at.name for name in explicit for at in there[name]))
            raise FileFormatError(
                message(
                    "error.may_be_angles_of",
                    where=self.path,
                    columns=columns,
                    conventions=", ".join(n for n in CONVENTIONS if n in explicit),
                )
            )
        self.unread = tuple(dict.fromkeys(at.name for found in there.values() for at in found))
        return None

    def _turned(self, convention: AngleConvention, gaps: bool) -> FloatArray:
        """Return (n, 4) quaternions from angles of a convention, in their own units or in that of the convention where none is stated."""
        at = [Column(c.name, c.unit or _native(convention)) for c in self._angles(convention)]
        values = np.column_stack([self._of(c, "deg", name, gaps=gaps) for c, name in zip(at, convention.columns, strict=True)])
        check_angles(values[~np.isnan(values)], f"{self.path}: {', '.join(convention.columns)}")
        known = ~np.isnan(values).any(axis=1)
        out = np.full((len(values), 4), np.nan)
        own = np.radians(values[known]) if convention.axes == "rotvec" else values[known]
        out[known] = rotation_from_angles(convention.name, own).as_quat()
        self.read_as = f"{', '.join(f'{c.name} in {c.unit}' for c in at)}: {convention.name}"
        return out

    def row_names(self, *called: str) -> list[str] | None:
        """Return the names of the rows: the cells of the first of these columns, else of a first column without a name, as pandas writes
        its index; None without either."""
        name = next((name for name in called if self.find(name)), None)
        if name is not None:
            return self.text(name)
        first = self._names[0]
        return self._table.text(first) if first in INDEX else None

    def row(self, index: int) -> str:
        """Return the file and line of a row, for an error."""
        return f"{self.path}: line {self.lines[index]}" if self.lines else f"{self.path}: row {index + 1}"

    def numbers(self, name: str, unit: str = "", *, gaps: bool = False) -> FloatArray:
        """Return (n,) floats [mm, deg, s, or none] of a quantity; FileFormatError where the file has it not, or not with a unit of its
        kind."""
        column = self.find(name, unit)
        if column is None:
            shown, said = (f"{name}_{unit}", f"{name}=COLUMN[{unit}]") if unit else (name, f"{name}=COLUMN")
            hint = message("error.columns_choose", option=said) if self._mapped else ""
            several = self.layout.bodies or self.layout.markers
            if len(several) > 1:
                raise FileFormatError(
                    message("error.of_columns_name_chooses", where=self.path, said=self.layout.said, several=", ".join(several), body=BODY)
                )
            raise FileFormatError(message("error.column_is_missing_it", where=self.path, shown=shown, has=self.has, hint=hint))
        return self._of(column, unit, name, gaps=gaps)

    def _of(self, column: Column, unit: str, name: str, *, gaps: bool) -> FloatArray:
        if unit and column.unit not in COLUMN_KINDS[unit]:
            raise FileFormatError(message("error.column_is_no_unit", where=self.path, name=column.name, unit=column.unit, name2=name))
        if column.name in self._twice:
            raise FileFormatError(message("error.column_stands_twice", where=self.path, name=column.name))
        size = UNITS[column.unit] if unit else 1.0
        kind = self._table.kind(column.name)
        if pa.types.is_timestamp(kind) and unit == "s":
            return self._stamped(column.name)
        if not pa.types.is_string(kind):
            return self._table.numbers(column.name, gaps=gaps) * size
        cells = self._table.text(column.name)
        if unit == "s":
            if are_clock_times(cells):
                found = clock_times(cells, self.row)
                self.day = found.day
                return found.time_s
            exact = scaled(cells, size) if cells and len(cells[0]) > 15 else None
            if exact is not None:
                return exact
        if self._marks is None:
            self._marks = self._decimal_marks()
        cells = plain(cells, self._marks, f"{self.path}: column {column.name!r}")
        read = pa.table({column.name: pa.array([cell or None for cell in cells], pa.string())})
        return files.Table(self.path, read, lines=self.lines).numbers(column.name, gaps=gaps) * size

    def _decimal_marks(self) -> set[str]:
        """Return the decimal marks that some column certainly has."""
        if not any("," in cell for _, row in self.layout.rows for cell in row):
            return {"."}
        found = set[str]()
        for name in self._table.columns:
            own = decimal_marks(without_blanks(self._table.text(name)))
            found |= own if len(own) == 1 else set()
        return found

    def _stamped(self, name: str) -> FloatArray:
        """Return (n,) seconds since the first midnight of a column of instants."""
        import pandas as pd

        stamps = pd.DatetimeIndex(self._table.cells(name))
        if stamps.hasnans:
            raise FileFormatError(message("error.has_no_time", where=self.row(int(np.argmax(stamps.isna())))))
        self.day = stamps[0].date().isoformat()
        return np.asarray((stamps - stamps[0].normalize()) / pd.Timedelta(seconds=1), dtype=np.float64)

    def text(self, name: str) -> list[str]:
        """Return (n,) cells of a quantity as text."""
        column = self.find(name)
        if column is None:
            raise FileFormatError(message("error.column_is_missing_it_has", where=self.path, name=name, has=self.has))
        return self._table.text(column.name)


def _native(convention: AngleConvention) -> str:
    """Return the unit of a convention's own columns."""
    return convention.columns[0].rsplit("_", 1)[1]


def _squeezed(text: str) -> str:
    """Return a header without its blanks."""
    return "".join(text.split())


def _table(path: Path, layout: Layout) -> tuple[files.Table, list[str], set[str]]:
    """Return a table of texts, the names of its columns, and those that occur twice, with only the first readable."""
    twice = {name for name in layout.names if name and layout.names.count(name) > 1}
    columns: dict[str, Any] = {}
    for i, name in enumerate(layout.names):
        if name not in columns:
            columns[name] = pa.array([row[i] or None for _, row in layout.rows], pa.string())
    lines = [line for line, _ in layout.rows]
    return files.Table(path, pa.table(columns), layout.header, lines), list(columns), twice
