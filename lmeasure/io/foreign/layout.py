"""Layout of a text table: names, units and rows, with one header, a commented one, or the several rows of motion capture programs.

Motive (NaturalPoint) writes a line of settings and rows Type, Name, ID, kind and axis; Nexus (Vicon) sections with a rate, a row of
segments or markers, one of axes and one of units. Nexus states a segment's rotation as a rotation vector.
"""

import csv
import datetime
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from lmeasure.core import CONVENTIONS, FileFormatError, FloatArray, SettingsError
from lmeasure.io.safe_open import read_regular
from lmeasure.text import message

COLUMN_KINDS = {
    "mm": {"mm": 1.0, "m": 1e3, "cm": 10.0, "um": 1e-3, "in": 25.4},
    "deg": {"deg": 1.0, "rad": 57.29577951308232},
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0},
}
"""Units of lengths, angles and times: how many of ours are in one."""
UNITS = {unit: size for kind in COLUMN_KINDS.values() for unit, size in kind.items()}
ANGLES = {name.rsplit("_", 1)[0] for each in CONVENTIONS.values() for name in each.columns}
"""Names of the angles of all controllers."""
_SPELLED = {
    "mm": ("millimeter", "millimetre"), "m": ("meter", "metre"), "cm": ("centimeter", "centimetre"), "in": ("inch", "inche"),
    "um": ("µm", "μm", "micron", "micrometer", "micrometre"), "deg": ("°", "degree", "grad"), "rad": ("radian",),
    "s": ("sec", "second", "sek"), "ms": ("msec", "millisecond"), "us": ("µs", "μs", "usec", "microsecond"), "ns": ("nsec", "nanosecond"),
    "min": ("minute",),
}  # fmt: skip
_UNIT_OF = {word: unit for unit, words in _SPELLED.items() for word in words}
_MAPPED = re.compile(r"\s*([^=\s]+)\s*=\s*(.+?)\s*(?:\[\s*([^\[\]]*?)\s*\])?\s*")
_HEADED = re.compile(r"(.+?)\s*[\[(]\s*([^\[\]()]+?)\s*[\])]")


@dataclass(frozen=True)
class Column:
    """Place of a quantity in a file: the column's name there, and its unit. text: the mapping as written, with the unit's brackets."""

    name: str
    unit: str
    text: str = ""


def unit_named(text: str) -> str:
    """Return the unit that a header's word names ("mm", "Seconds", "µs", in brackets or not), empty for any other word."""
    word = text.strip().strip("[]()").strip()
    if word in UNITS:
        return word
    word = word.lower()
    return word if word in UNITS else _UNIT_OF.get(word) or _UNIT_OF.get(word.removesuffix("s"), "")


def headed(name: str) -> tuple[str, str]:
    """Return the name of a column without the unit that its header states, as `X [mm]`, `Time (Seconds)` or `x_mm`, and that unit; the
    whole name and nothing where it states none."""
    match = _HEADED.fullmatch(name.strip())
    if match is not None and (unit := unit_named(match[2])):
        return match[1], unit
    base, _, last = name.strip().rpartition("_")
    return (base, last) if base and last in UNITS else (name.strip(), "")


def columns_of(text: str) -> dict[str, Column]:
    """Read `--columns`: columns by our names without units; SettingsError for a wrong mapping."""
    out: dict[str, Column] = {}
    for part in (p for p in text.split(",") if p.strip()):
        match = _MAPPED.fullmatch(part)
        if match is None or (match[3] and not unit_named(match[3])):
            known = ", ".join(UNITS)
            raise SettingsError("columns", message("error.is_not_name_column", strip=part.strip(), known=known))
        if match[1] in out:
            raise SettingsError("columns", message("error.is_given_twice_2", match=match[1]))
        written = part.split("=", 1)[1].strip()
        out[match[1]] = Column(match[2], unit_named(match[3] or ""), written if match[3] else "")
    return out


LARGEST = 1 << 28
COMMENTS = ("#", "%", "//")
SECTIONS = ("Segments", "Trajectories", "Joints", "Devices", "Model Outputs", "Events", "Forces")
"""First lines of a section of Nexus."""
BODY = "body"
"""Name in `--columns` for the choice of one of several bodies."""
_NUMBER = re.compile(r"[+-]?[\d.,]+([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Layout:
    """names of the columns, some perhaps twice or empty; rows: cells by line; units (by name) of a row of them; header: its line, from 0.

    bodies: the column of each quantity of a rigid body by its name; markers: likewise of single markers. angles: convention of
    orientations, if the format fixes it; said: the format in words, empty for a plain table.
    """

    names: list[str]
    rows: list[tuple[int, list[str]]]
    units: dict[str, str] = field(default_factory=dict)
    header: int = 0
    bodies: dict[str, dict[str, Column]] = field(default_factory=dict)
    markers: dict[str, dict[str, Column]] = field(default_factory=dict)
    angles: str = ""
    said: str = ""


def text_of(path: Path) -> str:
    """Read a text file in UTF-8, UTF-16 or cp1252; FileFormatError where it is none."""
    return decoded(read_regular(Path(path), LARGEST), path)


def decoded(raw: bytes, path: Path) -> str:
    """Return text in UTF-8, UTF-16 or cp1252; FileFormatError where it is none."""
    head = raw[:400]
    code = "utf-16" if head[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig"
    if code != "utf-16" and b"\0" in head:
        # without a mark: every other byte of Latin letters is zero
        code = "utf-16-le" if head[1::2].count(0) > head[0::2].count(0) else "utf-16-be"
    for attempt in (code, "cp1252"):
        try:
            text = raw[: len(raw) // 2 * 2 if attempt.startswith("utf-16") else None].decode(attempt)
        except UnicodeDecodeError:
            continue
        if "\0" not in text:
            return text
    raise FileFormatError(message("error.is_no_text_file", where=path))


def layout_of(path: Path) -> Layout:
    """Return the layout of a text table; FileFormatError where none is found, or a row has too few cells."""
    lines = text_of(path).splitlines()
    if not any(line.strip() for line in lines):
        raise FileFormatError(message("error.is_empty", where=path))
    first = _first_cell(next(line for line in lines if line.strip()))
    if first == "Format Version":
        return _of_motive(path, lines)
    if first in SECTIONS:
        return _of_nexus(path, lines)
    return _of_table(path, lines)


def _first_cell(line: str) -> str:
    return re.split(r"[,;\t]", line)[0].strip().strip('"')


def _of_table(path: Path, lines: list[str]) -> Layout:
    head = _header(path, lines)
    separator = _separator(lines[head])
    names = lines[head]
    while names.lstrip().startswith(COMMENTS):
        names = names.lstrip()[2:] if names.lstrip().startswith("//") else names.lstrip()[1:]
    if names != lines[head]:
        # a commented header may be separated by other marks than its rows
        following = next(line for line in lines[head:] if line.strip() and not line.lstrip().startswith(COMMENTS))
        separator = _separator(following)
        if separator not in names or separator not in following:
            names = (separator if separator in following else " ").join(re.split(r"[,;\t]\s*|\s+", names.strip()))
    body = [names, *lines[head + 1 :]]
    if separator not in names and len(names.split()) > 1:
        body = [",".join(line.split()) for line in body]
        separator = ","
    cells = _cells(path, body, separator)
    header = cells[0]
    while header and not header[-1]:
        header.pop()
    numbered = [(head + 1 + k, row) for k, row in enumerate(cells[1:], 1) if any(row) and not row[0].startswith(COMMENTS)]
    units = dict[str, str]()
    rows_of_units = [row for row in (numbered[0][1] if numbered else [], _commented_units(lines, head, separator)) if row]
    for row in rows_of_units:
        if all(not cell or unit_named(cell) for cell in row) and any(row):
            units = {name: unit_named(cell) for name, cell in zip(header, row, strict=False) if cell}
            if row is numbered[0][1]:
                numbered.pop(0)
            break
    for line, row in numbered:
        if len(row) < len(header) or any(row[len(header) :]):
            raise FileFormatError(message("error.has_cells_the_first", where=path, line=line, n_row=len(row), n_header=len(header)))
    return Layout(header, numbered, units, head)


def _cells(path: Path, lines: list[str], separator: str) -> list[list[str]]:
    try:
        return [[cell.strip() for cell in row] for row in csv.reader(lines, delimiter=separator)]
    except csv.Error as error:
        raise FileFormatError(message("error.cannot_be_read_as_a_table", where=path, error=error)) from None


def _separator(line: str) -> str:
    """Return the separator of a line's cells."""
    return max((";", "\t", "|", ","), key=lambda s: (line.count(s) > 0, s != ",", line.count(s)))


def _split(line: str) -> list[str]:
    """Return the cells of a line by any separator, blanks too."""
    separator = _separator(line)
    return [cell.strip() for cell in (line.split(separator) if separator in line else line.split())]


def _is_number(cell: str) -> bool:
    return _NUMBER.fullmatch(cell.strip().strip('"')) is not None


def _header(path: Path, lines: list[str]) -> int:
    """Return the line with the names of the columns: the first that has as many cells as the next and no number among them. If rows begin
    at once, it is the comment above them. FileFormatError for a row of numbers there."""
    there = [i for i, line in enumerate(lines) if line.strip() and not line.lstrip().startswith(COMMENTS)]
    if not there:
        raise FileFormatError(message("error.has_no_rows_only", where=path))
    for i, following in pairwise(there):
        separator = _separator(lines[i])
        cells = lines[i].split(separator)
        if len(cells) > 1 and lines[following].count(separator) == len(cells) - 1 and not any(map(_is_number, cells)):
            return i
    row = _split(lines[there[0]])
    if not any(map(_is_number, row)):
        return there[0]
    for i in range(there[0] - 1, -1, -1):
        names = _split(lines[i].lstrip().lstrip("#%/ "))
        if len(names) == len(row) and not any(map(_is_number, names)) and not all(unit_named(name) for name in names):
            return i
    if sum(map(_is_number, row)) * 2 < len(row) and len(there) > 1:
        return there[0]
    raise FileFormatError(message("error.line_holds_numbers_and", where=path, there=there[0] + 1, n_row=len(row)))


def _commented_units(lines: list[str], head: int, separator: str) -> list[str]:
    """Return the units that a commented line right behind a commented header states."""
    if not lines[head].lstrip().startswith(COMMENTS) or head + 1 >= len(lines) or not lines[head + 1].lstrip().startswith(COMMENTS):
        return []
    return _split(lines[head + 1].lstrip().lstrip("#%/ "))


def _of_motive(path: Path, lines: list[str]) -> Layout:
    rows = _cells(path, lines, _separator(lines[0]))
    settings = dict(zip(rows[0][::2], rows[0][1::2], strict=False))
    at = next((i for i, row in enumerate(rows) if row and row[0] == "Frame"), None)
    named = {row[1]: row for row in rows[1 : at or 0] if len(row) > 2 and row[0] == "" and row[1] in ("Type", "Name", "ID", "Parent")}
    if at is None or at < 2 or not {"Type", "Name"} <= set(named):
        raise FileFormatError(message("error.a_motive_export_has", where=path))
    unit = unit_named(settings.get("Length Units", ""))
    if not unit:
        raise FileFormatError(message("error.line_1_length_units", where=path, stated=settings.get("Length Units", "")))
    axes, wide = rows[at], len(rows[at])
    kinds, bodies, groups = (row + [""] * (wide - len(row)) for row in (named["Type"], named["Name"], rows[at - 1]))
    names = axes[:2] + [".".join(p for p in (bodies[i], groups[i], axes[i]) if p) for i in range(2, wide)]
    time = Column(names[1], "s")
    turned = settings.get("Rotation Type", "Quaternion") == "Quaternion"
    found: dict[str, dict[str, dict[str, Column]]] = {"Rigid Body": {}, "Marker": {}}
    for i in range(2, wide):
        if kinds[i] not in found:
            continue
        own = found[kinds[i]].setdefault(bodies[i], {"time": time})
        if groups[i] == "Position" and axes[i] in ("X", "Y", "Z"):
            own[axes[i].lower()] = Column(names[i], unit)
        elif groups[i] == "Rotation" and turned and axes[i] in ("X", "Y", "Z", "W"):
            own[f"q{axes[i].lower()}"] = Column(names[i], "")
        elif groups[i] == "Rotation" and axes[i] in ("X", "Y", "Z"):
            own[f"r{axes[i].lower()}"] = Column(names[i], "deg")
    numbered = [(i + 1, row + [""] * (wide - len(row))) for i, row in enumerate(rows[at + 1 :], at + 1) if any(row)]
    return Layout(names, numbered, header=at, bodies=found["Rigid Body"], markers=found["Marker"], said="a Motive export")


def _of_nexus(path: Path, lines: list[str]) -> Layout:
    rows = _cells(path, lines, ",")
    starts = {row[0]: i for i, row in enumerate(rows) if row and row[0] in SECTIONS and not any(row[1:])}
    kind = next((name for name in SECTIONS[:2] if name in starts), None)
    if kind is None:
        raise FileFormatError(message("error.a_nexus_export_without", where=path))
    at = starts[kind]
    head = rows[at + 1 : at + 5]
    if len(head) < 4 or not head[0] or not _is_number(head[0][0]) or float(head[0][0]) <= 0.0 or head[2][:2] != ["Frame", "Sub Frame"]:
        raise FileFormatError(message("error.line_section_of_a", where=path, at=at + 2, kind=kind))
    rate, axes = float(head[0][0]), head[2]
    wide, whose, names = len(axes), "", ["Frame", "Sub Frame"]
    units = head[3] + [""] * (wide - len(head[3]))
    found: dict[str, dict[str, Column]] = {}
    time = Column("time_s", "s")
    for i in range(2, wide):
        whose = head[1][i] if i < len(head[1]) and head[1][i] else whose
        names.append(f"{whose}.{axes[i]}")
        key = {"TX": "x", "TY": "y", "TZ": "z"}.get(axes[i], axes[i].lower())
        if key in ("x", "y", "z", "rx", "ry", "rz"):
            found.setdefault(whose, {"time": time})[key] = Column(names[i], unit_named(units[i]))
    numbered = []
    for i, row in enumerate(rows[at + 5 :], at + 5):
        if not any(row):
            break
        cells = row + [""] * (wide - len(row))
        if not cells[0].isdigit():
            raise FileFormatError(message("error.line_is_no_number", where=path, i=i + 1, cells=cells[0]))
        numbered.append((i + 1, [*cells[:wide], repr((int(cells[0]) - 1) / rate)]))
    segments = kind == "Segments"
    return Layout(
        [*names, "time_s"], numbered, header=at + 3, bodies=found if segments else {}, markers={} if segments else found,
        angles="ur-rotation-vector" if segments else "", said="a Nexus export",
    )  # fmt: skip


_BLANKS = re.compile(r"(?<=\d)[ \u00a0\u202f'’](?=\d{3}(?!\d))")
"""Between groups of three digits."""
_EITHER = re.compile(r"[+-]?[1-9]\d{0,2}[.,]\d{3}")
"""May be thousands, or three digits behind a decimal mark."""
_GROUPED = {
    mark: re.compile(rf"[+-]?\d{{1,3}}(?:{re.escape(mark)}\d{{3}})+(?:{re.escape(other)}\d*)?(?:[eE][+-]?\d+)?")
    for mark, other in ((".", ","), (",", "."))
}
_MARKED = re.compile(r"[+-]?[\d.,]*\d[\d.,]*(?:[eE][+-]?\d+)?")
_OTHER = {".": ",", ",": "."}

_DATES = (
    r"(?:(?P<y>\d{4})[-/.](?P<m>\d{1,2})[-/.](?P<d>\d{1,2})|(?P<d1>\d{1,2})\.(?P<m1>\d{1,2})\.(?P<y1>\d{4})"
    r"|(?P<a>\d{1,2})/(?P<b>\d{1,2})/(?P<y2>\d{4}))"
)
_CLOCKS = r"(?P<h>\d{1,2}):(?P<min>\d{2}):(?P<s>\d{2})(?:[.,](?P<part>\d+))?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
_ZONES = r"\s*(?P<zone>Z|z|UTC|[+-]\d{2}(?::?\d{2})?)?"
_CLOCK = re.compile(rf"(?:{_DATES}(?:[Tt]|,?\s+))?{_CLOCKS}{_ZONES}", re.ASCII)
_BASIC = re.compile(
    r"(?P<y>\d{4})(?P<m>\d{2})(?P<d>\d{2})[Tt](?P<h>\d{2})(?P<min>\d{2})(?P<s>\d{2})(?:[.,](?P<part>\d+))?" + _ZONES, re.ASCII
)
DAY_S = 86400.0


def decimal_marks(cells: Iterable[str]) -> set[str]:
    """Return which of "." and "," certainly are decimal marks of these cells."""
    found = set[str]()
    for cell in cells:
        dots, commas = cell.count("."), cell.count(",")
        if not (dots or commas) or _MARKED.fullmatch(cell) is None:
            continue
        if dots and commas:
            found.add("," if cell.rfind(",") > cell.rfind(".") else ".")
        elif dots > 1 or commas > 1:
            mark = "." if dots else ","
            if _GROUPED[mark].fullmatch(cell):
                found.add(_OTHER[mark])
        elif _EITHER.fullmatch(cell) is None:
            found.add("." if dots else ",")
    return found


def without_blanks(cells: Sequence[str]) -> list[str]:
    """Return the cells without blanks or apostrophes between thousands."""
    return [_BLANKS.sub("", cell) if " " in cell or "'" in cell or not cell.isascii() else cell for cell in cells]


def plain(cells: Sequence[str], of_file: set[str], what: str) -> list[str]:
    """Return cells with decimal points and without thousands. of_file: marks that other columns of the file certainly have.

    Cells that are no numbers stay as they are. FileFormatError, naming `what`, if "1.234" or "1,234" may be either.
    """
    cells = without_blanks(cells)
    if not any("," in cell or cell.count(".") > 1 for cell in cells) and "," not in of_file:
        return list(cells)
    own = decimal_marks(cells)
    if len(own) > 1:
        raise FileFormatError(message("error.has_both_decimal_points", where=what))
    either = [cell for cell in cells if _EITHER.fullmatch(cell)]
    if own:
        mark = own.pop()
    elif not either:
        return list(cells)
    else:
        dots = any("." in cell for cell in either)
        every = len(either) == sum(1 for cell in cells if cell)
        mark = "." if dots else ","
        if len(of_file) == 1 and not dots:
            mark = next(iter(of_file))
        elif (dots and "," in of_file) or (not dots and not every):
            shown = either[0]
            raise FileFormatError(
                message(
                    "error.may_be_or_write",
                    where=what,
                    shown=shown,
                    replace=shown.replace(",", "").replace(".", ""),
                    replace2=shown.replace(",", "."),
                )
            )
    thousands = _GROUPED[_OTHER[mark]]
    out = []
    for cell in cells:
        if _MARKED.fullmatch(cell) is None:
            out.append(cell)
            continue
        bare = cell.replace(_OTHER[mark], "") if thousands.fullmatch(cell) else cell
        out.append(bare if mark == "." else bare.replace(",", ".") if "." not in bare else cell)
    return out


@dataclass(frozen=True)
class Times:
    """time_s (n,) [s] since the first midnight; day: its date, empty where only clock times are stated."""

    time_s: FloatArray
    day: str


def are_clock_times(cells: Sequence[str]) -> bool:
    """Return whether the first cell with content is a clock time or a date with one."""
    first = next((cell for cell in cells if cell), "")
    return _CLOCK.fullmatch(first) is not None or _BASIC.fullmatch(first) is not None


def clock_times(cells: Sequence[str], row: Callable[[int], str]) -> Times:
    """Read clock times, with or without dates and zones; those without a date continue over midnight. row: the name of each in an error.

    FileFormatError names the first cell that is none.
    """
    found = [_CLOCK.fullmatch(cell) or _BASIC.fullmatch(cell) for cell in cells]
    monthly = [m for m in found if m is not None and m.groupdict().get("a")]
    month_first = any(int(m["b"]) > 12 for m in monthly)
    if monthly and not month_first and not any(int(m["a"]) > 12 for m in monthly) and len({(m["a"], m["b"]) for m in monthly}) > 1:
        raise FileFormatError(message("error.days_and_months_cannot", where=row(0), cells=cells[0]))
    values, first_day, kinds = np.empty(len(cells)), 0, set[tuple[bool, bool]]()
    first_zone = 0.0
    for i, match in enumerate(found):
        if match is None:
            raise FileFormatError(message("file.other_clock_time" if cells[i] else "file.no_time", where=row(i), cell=repr(cells[i])))
        part = {key: value for key, value in match.groupdict().items() if value is not None}
        hour, minute, second = int(part["h"]), int(part["min"]), int(part["s"])
        if "half" in part:
            if not 1 <= hour <= 12:
                raise FileFormatError(message("error.is_no_time_of", where=row(i), cells=cells[i]))
            hour = hour % 12 + (12 if part["half"][0] in "pP" else 0)
        if hour > 23 or minute > 59 or second > 60:
            raise FileFormatError(message("error.is_no_time_of", where=row(i), cells=cells[i]))
        day = _day(part, month_first, f"{row(i)}: {cells[i]!r}")
        zone = _zone(part.get("zone"))
        kinds.add((day is not None, zone is not None))
        if i == 0:
            first_day, first_zone = day or 0, zone or 0.0
        fraction = int(part["part"]) / 10.0 ** len(part["part"]) if "part" in part else 0.0
        seconds = 3600 * hour + 60 * minute + second + DAY_S * ((day or 0) - first_day) - ((zone or 0.0) - first_zone)
        values[i] = seconds + fraction
        if len(kinds) > 1:
            raise FileFormatError(message("error.is_written_otherwise_than", where=row(i), cells=cells[i]))
    if not next(iter(kinds))[0]:
        values += DAY_S * np.concatenate([[0.0], np.cumsum(np.diff(values) < -0.5 * DAY_S)])
    return Times(values, datetime.date.fromordinal(first_day).isoformat() if first_day else "")


def _day(part: dict[str, str], month_first: bool, what: str) -> int | None:
    """Number of the day of a date; None where there is none."""
    if "y" in part:
        date = part["y"], part["m"], part["d"]
    elif "y1" in part:
        date = part["y1"], part["m1"], part["d1"]
    elif "y2" in part:
        date = (part["y2"], part["a"], part["b"]) if month_first else (part["y2"], part["b"], part["a"])
    else:
        return None
    try:
        return datetime.date(*map(int, date)).toordinal()
    except ValueError:
        raise FileFormatError(message("error.is_no_date", what=what)) from None


def _zone(text: str | None) -> float | None:
    """Seconds of a zone ahead of UTC; None where none is stated."""
    if text is None:
        return None
    if text.upper() in ("Z", "UTC"):
        return 0.0
    digits = text[1:].replace(":", "").ljust(4, "0")
    return (1.0 if text[0] == "+" else -1.0) * (3600.0 * int(digits[:2]) + 60.0 * int(digits[2:]))


def scaled(cells: Sequence[str], size: float) -> FloatArray | None:
    """Return whole numbers of many digits, such as nanoseconds since 1970, times a size below 1, exactly; None where not all are."""
    if size >= 1.0 or not all(cell.isascii() and cell.isdigit() for cell in cells):
        return None
    of = round(1.0 / size)
    return np.array([whole + part / of for whole, part in (divmod(int(cell), of) for cell in cells)])
