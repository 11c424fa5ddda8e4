"""Targets in tables: plain CSV of this program's columns, and those of RoboDK; any separator, decimal points or commas, quotes.

Plain: `x_mm, y_mm, z_mm` with the columns of a convention of angles or a quaternion, or `joint_1_deg` ...; `name`, or `target`, if it has
one. RoboDK: `J1` ... [deg], or `X, Y, Z` [mm] with `Rx, Ry, Rz` [deg] of its XYZRPW, R = Rz(rz) Ry(ry) Rx(rx). Poses are given in `base`
with `tool`, which columns of these names may state.
"""

import math
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import CONVENTIONS, QUATERNION_COLUMNS, FloatArray, RobotError, se3
from lmeasure.io import COLUMN_KINDS, Column
from lmeasure.robot_programs.program import (
    IDENTITY,
    NUMBER,
    Dialect,
    Listing,
    Reader,
    Source,
    Span,
    Target,
    of_angles,
    of_quaternion,
    wrong,
)
from lmeasure.text import message

PLACE = ("x_mm", "y_mm", "z_mm")
Columns = Mapping[str, Column]
NAMED = ("name", "target", "", "unnamed: 0")
"""Columns of a target's name; pandas writes an index under no name."""
ROBODK_PLACE, ROBODK_TURN = ("x", "y", "z"), ("rx", "ry", "rz")
BOM = "\xef\xbb\xbf"
"""Byte order mark of UTF-8, a character a byte."""
_JOINT = re.compile(r"joint_\d+_deg|j\d+")


def _cells(text: str, start: int, stop: int, separator: str) -> list[Span]:
    """Places of a line's cells, without quotes and blanks."""
    out, at, quoted = [], start, False
    for i in range(start, stop + 1):
        if i < stop and text[i] == '"':
            quoted = not quoted
        elif i == stop or (text[i] == separator and not quoted):
            cell = text[at:i]
            left = at + len(cell) - len(cell.lstrip(' "\t'))
            out.append((left, max(left, at + len(cell.rstrip(' "\t\r')))))
            at = i + 1
    return out


def header_line(text: str) -> str:
    """The first line that is neither blank nor a remark, nor a spreadsheet's word for its separator; empty where there is none."""
    lines = text.removeprefix(BOM).split("\n")
    return next((line for line in lines if not _passed_over(line)), "")


def _passed_over(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#") or line.lower().startswith("sep=")


def _column(word: str) -> str:
    """The name of a column, without the unit behind it in brackets where that is the one that is taken for granted."""
    name = word.strip().lower()
    plain = re.fullmatch(r"(.*\S)\s*+[\[(](mm|deg|\xb0|\xc2\xb0)[\])]", name)
    return plain[1] if plain and (plain[2] == "mm") == (plain[1] in ROBODK_PLACE) else name


Renamed = dict[str, tuple[str, float]]
"""Our name of a column and the size of its unit in ours, by the header in lower case."""


def mapping_of(columns: Columns, header: str) -> Renamed:
    """Return the assignment of `--columns` for a table of targets; RobotError for unknown columns, or those not in the header."""
    out: Renamed = {}
    turns = {name for c in CONVENTIONS.values() for name in c.columns}
    there = [_column(word.strip('"')) for word in re.split(r"[,;\t]", header)]
    for name, column in columns.items():
        kind = "mm" if name in ("x", "y", "z") else "deg" if re.fullmatch(r"joint_\d+", name) else ""
        whole = f"{name}_{column.unit}"
        if name in ("name", "base", "tool", *QUATERNION_COLUMNS):
            own, size = name, 1.0
        elif kind and (column.unit or kind) in COLUMN_KINDS[kind]:
            own, size = f"{name}_{kind}", COLUMN_KINDS[kind][column.unit or kind]
        elif whole in turns:
            own, size = whole, 1.0
        else:
            known = ", ".join(("name", *"xyz", "joint_1", *QUATERNION_COLUMNS, *sorted(turns)))
            raise RobotError(message("error.columns_a_table_of", name=name, name2=column.name, unit=column.unit, known=known))
        if column.name.lower() not in there:
            raise RobotError(message("error.columns_the_table_has", name=name, name2=column.name, there=", ".join(filter(None, there))))
        out[column.name.lower()] = own, size
    return out


def _read(sources: Sequence[Source], turn: tuple[str, ...], place: tuple[str, ...], mapping: Renamed | None = None) -> Listing:
    reader = Reader(sources)
    for k in range(len(sources)):
        _rows(k, turn, place, mapping or {}, reader)
    return replace(reader.listing(), assumed={"base": np.array(IDENTITY), "tool": np.array(IDENTITY)})


def _rows(k: int, turn: tuple[str, ...], place: tuple[str, ...], mapping: Renamed, reader: Reader) -> None:
    text, header, sizes = reader.sources[k].text, list[str](), dict[str, float]()
    at = len(BOM) if text.startswith(BOM) else 0
    separator = max(",;\t", key=header_line(text).count)
    wanted, often, posed, number = list[str](), Counter[str](), False, 0
    for raw in text[at:].split("\n"):
        start, at = at, at + len(raw) + 1
        if _passed_over(raw):
            continue
        cells = _cells(text, start, at - 1, separator)
        if not header:
            named = [mapping.get(word, (word, 1.0)) for word in (_column(text[slice(*c)]) for c in cells)]
            header, sizes = [name for name, _ in named], dict(named)
            posed = all(c in header for c in (*place, *turn))
            wanted = [*place, *turn] if posed else [h for h in header if _JOINT.fullmatch(h)]
            often = Counter(header)
            continue
        number += 1
        row = dict(zip(header, cells, strict=False))
        called = next((text[slice(*row[key])] for key in NAMED if key in row), "")
        name, line = called or f"row {number}", reader.line(k, start)
        spans = tuple(row[c] for c in wanted if c in row)
        words = [text[slice(*s)] for s in spans]
        if separator != ",":
            words = [word.replace(",", ".") for word in words]
        values = tuple(sizes[c] * float(w) for c, w in zip(wanted, words, strict=False) if re.fullmatch(NUMBER, w))
        why = ""
        if not wanted:
            why = message("program.neither", columns=(*place, *turn))
        elif twice := [c for c in wanted if often[c] > 1]:
            why = message("program.two_columns", name=twice[0])
        elif len(cells) != len(header):
            why = message("robot_programs.cells_under_columns", cells=len(cells), of=len(header))
        elif len(values) < len(wanted):
            why = message("robot_programs.cell_no_number")
        why = why or wrong(values, values[3:] if posed and turn == QUATERNION_COLUMNS else ())
        if why:
            reader.leave(k, start, why, name)
            continue
        base, tool = (text[slice(*row[c])] if c in row else c for c in ("base", "tool"))
        own = tuple(sizes[c] for c in wanted) if mapping else ()
        reported = Target(name, k, line, not posed, values, spans, base, tool, moved=(k, start), sizes=own)
        axes = [c for c in header if posed and _JOINT.fullmatch(c)]
        beside = tuple(row[c] for c in axes)
        words = [text[slice(*s)] if separator == "," else text[slice(*s)].replace(",", ".") for s in beside]
        if beside and all(re.fullmatch(NUMBER, word) for word in words):
            # given by joint values too: both are corrected
            joints, own = tuple(sizes[c] * float(w) for c, w in zip(axes, words, strict=True)), tuple(sizes[c] for c in axes)
            by_joints = replace(reported, joints=True, values=joints, spans=beside, sizes=own if mapping else ())
            reader.targets += [replace(reported, near=joints, taught=True), by_joints]
        else:
            reader.targets.append(reported)


def _table(sources: Sequence[Source], columns: Columns | None = None) -> Dialect:
    """Return the dialect of a table with the columns that `--columns` assigns."""
    header = header_line(sources[0].text)
    mapping = mapping_of(columns or {}, header)
    words = {w.strip(' "\r').lower() for w in re.split(r"[,;\t]", header)}
    words |= {name for name, _ in mapping.values()}
    read = partial(_read, mapping=mapping)
    convention = next((c for c in CONVENTIONS.values() if set(c.columns) <= words), None)
    if set(QUATERNION_COLUMNS) <= words or convention is None:
        return replace(CSV, read=partial(read, turn=QUATERNION_COLUMNS, place=PLACE))
    of, numbers = of_angles(convention.name) if convention.axes != "rotvec" else (_of_vector, _to_vector)
    return replace(CSV, read=partial(read, turn=convention.columns, place=PLACE), pose=of, numbers=numbers, decimals=(6, 9, 9))


def _has_units(text: str) -> bool:
    """Return whether the header of a table names units, as the columns of this program do."""
    return any(unit in header_line(text).lower() for unit in ("_mm", "_deg"))


def _of_vector(values: Sequence[float]) -> FloatArray:
    return se3.pose(values[:3], Rotation.from_rotvec(np.asarray(values[3:6], dtype=np.float64)))


def _to_vector(row: FloatArray, old: Sequence[float]) -> FloatArray:
    return np.concatenate([row[:3], Rotation.from_quat(row[3:]).as_rotvec()])


CSV = Dialect(
    "csv",
    partial(_read, turn=QUATERNION_COLUMNS, place=PLACE),
    *of_quaternion((0, 1, 2, 3)),
    math.radians(1.0),
    (6, 12, 9),
    suffixes=(".csv",),
    recognises=_has_units,
    of_table=_table,
)
ROBODK = Dialect(
    "robodk",
    partial(_read, turn=ROBODK_TURN, place=ROBODK_PLACE),
    *of_angles("fanuc-wpr"),
    math.radians(1.0),
    (6, 6, 6),
    suffixes=(".csv",),
)
