"""Columns and units: what `--columns x=X[m],joint_1=A1[rad]` states, and the units that headers name."""

import re
from dataclasses import dataclass

from lmeasure.core import CONVENTIONS, SettingsError

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
    """Where a quantity stands in a file: the column's name there, and its unit. text: the mapping as written, with the unit's brackets."""

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
    """Return what a column is called without the unit that its header states, as `X [mm]`, `Time (Seconds)` or `x_mm`, and that unit; the
    whole name and nothing where it states none."""
    match = _HEADED.fullmatch(name.strip())
    if match is not None and (unit := unit_named(match[2])):
        return match[1], unit
    base, _, last = name.strip().rpartition("_")
    return (base, last) if base and last in UNITS else (name.strip(), "")


def columns_of(text: str) -> dict[str, Column]:
    """Read `--columns`: columns by our names without units; SettingsError for what is no mapping."""
    out: dict[str, Column] = {}
    for part in (p for p in text.split(",") if p.strip()):
        match = _MAPPED.fullmatch(part)
        if match is None or (match[3] and not unit_named(match[3])):
            known = ", ".join(UNITS)
            raise SettingsError("columns", f"{part.strip()!r} is not name=column[unit]; units: {known}")
        if match[1] in out:
            raise SettingsError("columns", f"{match[1]!r} is given twice")
        written = part.split("=", 1)[1].strip()
        out[match[1]] = Column(match[2], unit_named(match[3] or ""), written if match[3] else "")
    return out
