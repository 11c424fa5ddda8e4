"""Targets in tables: plain CSV of this program's columns, and those of RoboDK; any separator, decimal points or commas, quotes.

Plain: `x_mm, y_mm, z_mm` with the columns of a convention of angles or a quaternion, or `joint_1_deg` ...; `name`, or `target`, where it
has one.
RoboDK: `J1` ... [deg], or `X, Y, Z` [mm] with `Rx, Ry, Rz` [deg] of its XYZRPW, R = Rz(rz) Ry(ry) Rx(rx). Poses are told in `base` with
`tool`, which columns of these names may say.
"""

import math
import re
from collections.abc import Sequence
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.arrays import FloatArray
from lmeasure.conventions import CONVENTIONS, QUATERNION_COLUMNS
from lmeasure.robots.dialects.euler import of_angles
from lmeasure.robots.dialects.program_text import IDENTITY, Dialect, Listing, Source, Span, Target, Unread, pose

PLACE = ("x_mm", "y_mm", "z_mm")
ROBODK_PLACE, ROBODK_TURN = ("x", "y", "z"), ("rx", "ry", "rz")
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


def _read(sources: Sequence[Source], turn: tuple[str, ...], place: tuple[str, ...]) -> Listing:
    targets: list[Target] = []
    unread: list[Unread] = []
    for k, source in enumerate(sources):
        text, at, header = source.text, 0, None
        if text.startswith("\xef\xbb\xbf"):
            at = 3
        separator = max(",;\t", key=lambda c: text[at:].split("\n", 1)[0].count(c))
        for raw in text[at:].split("\n"):
            start, stop = at, at + len(raw)
            at = stop + 1
            if not raw.strip() or raw.lstrip().startswith("#"):
                continue
            cells = _cells(text, start, stop, separator)
            words = [text[slice(*c)] for c in cells]
            if header is None:
                header = [w.strip().lower() for w in words]
                continue
            row = dict(zip(header, cells, strict=False))
            joints = [h for h in header if _JOINT.fullmatch(h)]
            posed = all(c in row for c in (*place, *turn))
            wanted = [*place, *turn] if posed else joints
            called = next((text[slice(*row[key])] for key in ("name", "target") if key in row), "")
            name = called or f"row {len(targets) + len(unread) + 1}"
            if not wanted:
                unread.append(Unread(source.name, source.line(start), f"{name}: neither {', '.join((*place, *turn))} nor joint values"))
                continue
            if len(cells) != len(header):
                unread.append(Unread(source.name, source.line(start), f"{name}: {len(cells)} cells under {len(header)} columns"))
                continue
            spans = tuple(row[c] for c in wanted)
            try:
                values = tuple(float(text[slice(*s)].replace(",", ".")) for s in spans)
            except ValueError:
                unread.append(Unread(source.name, source.line(start), f"{name}: a cell that is no number"))
                continue
            base, tool = (text[slice(*row[c])] if c in row else c for c in ("base", "tool"))
            targets.append(Target(name, k, source.line(start), not posed, values, spans, base, tool, moved=(k, start)))
    return Listing(tuple(sources), tuple(targets), {}, tuple(unread), {"base": np.array(IDENTITY), "tool": np.array(IDENTITY)})


def _of_quaternion(values: Sequence[float]) -> FloatArray:
    return pose(values[:3], Rotation.from_quat(np.asarray(values[3:7], dtype=np.float64)))


def _to_quaternion(row: FloatArray, old: Sequence[float]) -> FloatArray:
    same = row[3:] @ np.asarray(old[3:7]) >= 0.0
    return np.concatenate([row[:3], row[3:] if same else -row[3:]])


def plain(header: str) -> Dialect:
    """The dialect of a table whose first line this is: which columns of an orientation it has."""
    words = {w.strip(' "\r').lower() for w in re.split(r"[,;\t]", header.removeprefix("\xef\xbb\xbf"))}
    if set(QUATERNION_COLUMNS) <= words:
        return Dialect(
            "csv", partial(_read, turn=QUATERNION_COLUMNS, place=PLACE), _of_quaternion, _to_quaternion, math.radians(1.0), (6, 12, 9)
        )
    for c in CONVENTIONS.values():
        if set(c.columns) <= words:
            of, numbers = of_angles(c.name) if c.axes != "rotvec" else (_of_vector, _to_vector)
            return Dialect("csv", partial(_read, turn=c.columns, place=PLACE), of, numbers, math.radians(1.0), (6, 9, 9))
    return Dialect(
        "csv", partial(_read, turn=QUATERNION_COLUMNS, place=PLACE), _of_quaternion, _to_quaternion, math.radians(1.0), (6, 12, 9)
    )


def _of_vector(values: Sequence[float]) -> FloatArray:
    return pose(values[:3], Rotation.from_rotvec(np.asarray(values[3:6], dtype=np.float64)))


def _to_vector(row: FloatArray, old: Sequence[float]) -> FloatArray:
    return np.concatenate([row[:3], Rotation.from_quat(row[3:]).as_rotvec()])


_robodk_pose, _robodk_numbers = of_angles("fanuc-wpr")
ROBODK = Dialect(
    "robodk",
    partial(_read, turn=ROBODK_TURN, place=ROBODK_PLACE),
    _robodk_pose,
    _robodk_numbers,
    math.radians(1.0),
    (6, 6, 6),
    ("base", "tool"),
)
