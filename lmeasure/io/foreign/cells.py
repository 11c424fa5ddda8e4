"""Cells of other people's tables as numbers: decimal commas, thousands, clock times and dates."""

import datetime
import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.text import message

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

    Cells that are no numbers stay as they are. FileFormatError, naming what, where "1.234" or "1,234" may be either.
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
    """Whether the first cell with anything in it is a clock time or a date with one."""
    first = next((cell for cell in cells if cell), "")
    return _CLOCK.fullmatch(first) is not None or _BASIC.fullmatch(first) is not None


def clock_times(cells: Sequence[str], row: Callable[[int], str]) -> Times:
    """Read clock times, with or without dates and zones; those without a date go on over midnight. row: what a complaint calls each.

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
