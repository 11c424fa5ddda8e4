"""Text logs: blocks of whole lines, which a format reads line by line, or by a compiled scan and only its odd lines one by one.

A format turns one line into one frame, or names the kind of a line that is none (comment, header, status), and raises ValueError for
any other line. All are counted; the lines around an unread one are read.
"""

import io
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, NamedTuple, Protocol

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, ERROR, FD, FD_BYTES, REMOTE, Frames, frames_from_messages, join
from lmeasure.acquisition.logs.report import (
    BLANK,
    BLOCK_BYTES,
    LARGEST_IDENTIFIER,
    LARGEST_STANDARD,
    NO_END,
    SHOWN_BYTES,
    UNKNOWN_LINE,
    Batches,
    LogReport,
    UnreadableError,
    bytes_announced,
    checked,
    frames_of,
    kind_of_failure,
    new_columns,
    read_into,
)
from lmeasure.core import FileFormatError, IntArray
from lmeasure.kernels import LATEST_S, ODD, WIDE, Bytes, Columns, line_ends, line_stop
from lmeasure.text import message, reason

if TYPE_CHECKING:
    import can

LONGEST_LINE = 1 << 16
USUAL_LINE = 30

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


class Lines(Protocol):
    """Lines of one log. Each can be read by itself, once the header is known."""

    def read(self, line: str) -> Line | str:
        """Return the line's frame, or the kind of a line that is none; ValueError where nobody can read it."""


def by_lines(lines: Callable[[Path], Lines]) -> Batches:
    """Return the reader of a format whose lines can be read one by one.

    Parameters
    ----------
    lines
        Makes of the path of a log what reads its lines.
    """

    def batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
        yield from line_batches(path, blocks_of_lines(path, file, report), lines(path), report)

    return batches


def blocks_of_lines(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Bytes]:
    """Blocks of whole lines, each overwritten by the next; the report counts them. A last line without its end is not read: a number cut
    short would pass for another."""
    held = bytearray(LONGEST_LINE + BLOCK_BYTES)
    room, text = memoryview(held), np.frombuffer(held, np.uint8)
    kept = 0
    while got := read_into(room[kept : kept + BLOCK_BYTES], file, report):
        end = kept + got
        # a carriage return at the very end may have its line feed in the next block
        feed = held.rfind(b"\n", 0, end)
        cut = max(feed, held.rfind(b"\r", feed + 1, end - 1)) + 1
        kept = end - cut
        if kept > LONGEST_LINE:
            raise FileFormatError(message("error.is_no_text_log", where=path, longest_line=LONGEST_LINE))
        if cut:
            report.total += line_ends(text[:cut])
            yield text[:cut]
        room[:kept] = room[cut:end]
    if kept and held[kept - 1] == ord("\r"):
        report.total += line_ends(text[:kept])
        yield text[:kept]
    elif kept:
        tail = bytes(room[:kept])
        report.total += 1
        if not tail.strip(b" \t\0\x1a"):
            report.known_kinds[BLANK] += 1
        else:
            shown = tail[:SHOWN_BYTES].decode("ascii", "replace")
            report.ended_early = report.ended_early or message("log.last_line", shown=repr(shown))
            report.cannot_read(tail, message("log.no_end"), message("log.line", number=report.total), NO_END)


def line_batches(path: Path, blocks: Iterable[Bytes], dialect: Lines, report: LogReport) -> Iterator[Frames]:
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
                    raise ValueError(message("log.too_many_buses", most=MOST_BUSES))  # noqa: TRY301
                found.append(_checked(line))
                buses.setdefault(line.bus, len(buses))
            except FileFormatError:
                raise  # of the header: nothing behind it can be read
            except (ValueError, IndexError, OverflowError, OSError) as error:
                why = message("log.cells_missing") if isinstance(error, IndexError) else reason(error)
                place = "" if report.unread else message("log.line", number=number)
                report.cannot_read(raw, why, place, kind_of_failure(error))
        yield _frames(found, buses, path)


def _checked(line: Line) -> Line:
    if not 0 <= line.identifier <= LARGEST_IDENTIFIER:
        raise ValueError(message("log.no_identifier"))
    if not abs(line.time_s) <= LATEST_S:
        raise ValueError(message("log.no_time", seconds=line.time_s))
    limit = FD_BYTES if line.flags & FD else CLASSIC_BYTES
    if len(line.data) > limit or line.length > limit:
        raise ValueError(message("log.too_many_bytes", bytes=max(len(line.data), line.length), most=limit))
    if not line.flags & (REMOTE | ERROR) and line.length != len(line.data):
        raise ValueError(bytes_announced(line.length, len(line.data)))
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


class ScannedLines(Protocol):
    """The lines of one log: how whole ones are scanned, and how one that the scan does not know is read."""

    kinds: tuple[str, ...]
    """Kinds of the known lines that the scan counts."""

    def scan(self, text: Bytes, columns: Columns, known: IntArray) -> tuple[int, int, int]:
        """Fill columns, and count known lines: frames, bytes used, status."""

    def names(self) -> tuple[str, ...]:
        """Names of the channels met so far."""

    def odd(self, line: bytes) -> Frames | str:
        """Frames of one line, or the kind of a line that is none; ValueError where nobody can read it."""


def scanned_batches(path: Path, blocks: Iterable[Bytes], dialect: ScannedLines, report: LogReport) -> Iterator[Frames]:
    """Yield frames of blocks of whole lines, by a compiled scan."""
    width = CLASSIC_BYTES
    for block in blocks:
        parts: list[Frames] = []
        known = np.zeros(len(dialect.kinds), np.int64)
        pos = 0
        while pos < len(block):
            columns = new_columns((len(block) - pos) // USUAL_LINE + 1, width)  # where they are full, the next go on
            count, used, status = dialect.scan(block[pos:], columns, known)
            if count:
                parts.append(frames_of(columns, count, dialect.names(), path))
            pos += used
            if status == WIDE:
                width = FD_BYTES
            elif status == ODD:
                stop, following = line_stop(block, pos)
                line = block[pos:stop].tobytes()
                try:
                    found = dialect.odd(line)
                    if isinstance(found, str):
                        report.known_kinds[found] += 1
                    else:
                        parts.append(found)
                except ValueError as error:
                    place = "" if report.unread else message("log.line", number=report.total - line_ends(block[pos:]) + 1)
                    report.cannot_read(line, reason(error), place, kind_of_failure(error))
                pos = following
        for kind, count in zip(dialect.kinds, known.tolist(), strict=True):
            if count:
                report.known_kinds[kind] += count
        yield parts[0] if len(parts) == 1 else join(parts)


def decoded(line: bytes) -> str:
    """Return a line as text: UTF-8, else Latin-1."""
    try:
        return line.decode("utf-8").strip()
    except UnicodeDecodeError:
        return line.decode("latin-1").strip()


def by_library(reader: Callable[[io.StringIO], Iterable["can.Message"]], text: str, path: Path) -> Frames:
    """Frames that python-can reads from a text; ValueError where it reads none, or where they contradict themselves."""
    try:
        messages = [checked(m) for m in reader(io.StringIO(text))]
    except (IndexError, OverflowError, TypeError) as error:
        raise ValueError(reason(error)) from error
    if not messages:
        raise UnreadableError(message("log.no_event"), UNKNOWN_LINE)
    if any(m.arbitration_id > LARGEST_STANDARD and not m.is_extended_id for m in messages):
        raise ValueError(message("log.no_identifier_11", text=f"{messages[0].arbitration_id:X}"))
    return frames_from_messages(messages, "log", str(path), classes=False)


def whole_number(text: str) -> int:
    """Decimal digits and nothing else; ValueError otherwise."""
    if not WHOLE.fullmatch(text):
        raise ValueError(message("log.no_whole_number", text=repr(text[:20])))
    return int(text)


def decimal_number(text: str) -> float:
    """Read digits, perhaps with a sign, a point or a decimal comma; ValueError otherwise: no recorder writes exponents or underscores."""
    if not DECIMAL.fullmatch(text):
        raise ValueError(message("log.no_number", text=repr(text[:20])))
    return float(text.replace(",", "."))


def hexadecimal(text: str) -> int:
    """Hexadecimal digits and nothing else; ValueError otherwise."""
    if not HEXADECIMAL.fullmatch(text):
        raise ValueError(message("log.no_hexadecimal", text=repr(text[:20])))
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
            raise ValueError(message("log.no_byte", text=repr(text[:20])))
    return bytes(int(text, 16) for text in texts)
