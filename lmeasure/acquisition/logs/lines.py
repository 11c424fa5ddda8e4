"""Text logs that are read line by line: TRC, the screen output of candump, CSV files.

Each dialect turns one line into one frame, or names the kind of a line that is none (comment, header, status), and raises ValueError for
any other line. All are counted; the lines around an unread one are read.
"""

import re
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple, Protocol

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, ERROR, FD, FD_BYTES, REMOTE, Frames
from lmeasure.acquisition.logs.report import BLANK, LARGEST_IDENTIFIER, LogReport, kind_of_failure
from lmeasure.core import FileFormatError
from lmeasure.kernels import LATEST_S, Bytes, line_ends

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes of a CAN FD frame by its length code, ISO 11898-1."""
MOST_BUSES = 1000
WHOLE = re.compile(r"\d+", re.ASCII)
HEXADECIMAL = re.compile(r"[0-9A-Fa-f]+")
DECIMAL = re.compile(r"[+-]?\d+([.,]\d*)?", re.ASCII)


class Line(NamedTuple):
    """A frame as a line tells it: time [s], identifier, flags, length (of a remote frame: bytes asked for), data, bus."""

    time_s: float
    identifier: int
    flags: int
    length: int
    data: bytes
    bus: str


class Dialect(Protocol):
    """A format each of whose lines can be read by itself, given the header."""

    def read(self, line: str) -> Line | str:
        """Return the line's frame, or the kind of a line that is none; ValueError where nobody can read it."""


def line_batches(path: Path, blocks: Iterable[Bytes], dialect: Dialect, report: LogReport) -> Iterator[Frames]:
    """Frames of blocks of whole lines."""
    buses: dict[str, int] = {}
    for block in blocks:
        found: list[Line] = []
        first = report.total - line_ends(block) + 1
        for number, raw in enumerate(block.tobytes().splitlines(), first):
            if not raw or raw.isspace():
                report.known_kinds[BLANK] += 1
                continue
            try:
                line = dialect.read(raw.decode("utf-8", "replace").strip())
                if isinstance(line, str):
                    report.known_kinds[line] += 1
                    continue
                if len(buses) == MOST_BUSES and line.bus not in buses:
                    raise ValueError(f"a bus beyond the first {MOST_BUSES}")  # noqa: TRY301
                found.append(_checked(line))
                buses.setdefault(line.bus, len(buses))
            except FileFormatError:
                raise  # of the header: nothing behind it can be read
            except (ValueError, IndexError, OverflowError, OSError) as error:
                why = "cells are missing" if isinstance(error, IndexError) else str(error)
                report.cannot_read(raw, why, f"line {number}", kind_of_failure(error))
        yield _frames(found, buses, path)


def _checked(line: Line) -> Line:
    if not 0 <= line.identifier <= LARGEST_IDENTIFIER:
        raise ValueError("it is no identifier of CAN")
    if not abs(line.time_s) <= LATEST_S:
        raise ValueError(f"{line.time_s} s is no time")
    limit = FD_BYTES if line.flags & FD else CLASSIC_BYTES
    if len(line.data) > limit or line.length > limit:
        raise ValueError(f"{max(len(line.data), line.length)} bytes, {limit} are the most")
    if not line.flags & (REMOTE | ERROR) and line.length != len(line.data):
        raise ValueError(f"{line.length} bytes are announced and {len(line.data)} are there")
    return line


def _frames(found: list[Line], buses: dict[str, int], path: Path) -> Frames:
    width = FD_BYTES if any(len(f.data) > CLASSIC_BYTES for f in found) else CLASSIC_BYTES
    data = np.frombuffer(b"".join(f.data.ljust(width, b"\0") for f in found), np.uint8).reshape(-1, width)
    channel = np.array([buses[f.bus] for f in found], np.int16)
    return Frames(
        np.array([f.time_s for f in found], np.float64),
        np.array([f.identifier for f in found], np.uint32),
        np.array([f.flags for f in found], np.uint8),
        np.array([f.length for f in found], np.uint8),
        data,
        channel,
        tuple(buses) or ("0",),
        "log",
        str(path),
    )


def whole_number(text: str) -> int:
    """Decimal digits and nothing else; ValueError otherwise."""
    if not WHOLE.fullmatch(text):
        raise ValueError(f"{text[:20]!r} is no whole number")
    return int(text)


def decimal_number(text: str) -> float:
    """Read digits, perhaps with a sign, a point or a decimal comma; ValueError otherwise: no recorder writes exponents or underscores."""
    if not DECIMAL.fullmatch(text):
        raise ValueError(f"{text[:20]!r} is no number")
    return float(text.replace(",", "."))


def hexadecimal(text: str) -> int:
    """Hexadecimal digits and nothing else; ValueError otherwise."""
    if not HEXADECIMAL.fullmatch(text):
        raise ValueError(f"{text[:20]!r} is no hexadecimal number")
    return int(text, 16)


def announced(cells: list[str], length: int) -> list[str]:
    """Return the cells of the announced bytes; text behind them is ignored, further bytes are not: ValueError in `_checked`."""
    behind = [cell for cell in cells[length:] if len(cell) == 2 and HEXADECIMAL.fullmatch(cell)]
    return cells[:length] + behind


def data_bytes(cells: Iterable[str], least: int = 2) -> bytes:
    """Bytes of two hexadecimal digits each, or of at least so many; ValueError otherwise."""
    texts = list(cells)
    if set(map(len, texts)) <= {2}:
        return bytes.fromhex("".join(texts))
    for text in texts:
        if not least <= len(text) <= 2 or not HEXADECIMAL.fullmatch(text):
            raise ValueError(f"{text[:20]!r} is no byte")
    return bytes(int(text, 16) for text in texts)
