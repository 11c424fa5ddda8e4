"""ASC and candump logs: plain lines by a compiled scan, the others line by line through python-can's readers."""

import io
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

import numpy as np

from lmeasure.acquisition.frames import CLASSIC_BYTES, FD_BYTES, Frames, frames_from_messages, join, no_frames
from lmeasure.acquisition.log_common import BLOCK_BYTES, Channels, LogReport, checked, frames_of, new_columns, read_into
from lmeasure.errors import FileFormatError
from lmeasure.kernels.frames import ODD, WIDE, Bytes, Columns
from lmeasure.kernels.log_asc import scan_asc
from lmeasure.kernels.log_candump import NAME_BYTES, NAMES, scan_candump
from lmeasure.kernels.log_text import line_stop

if TYPE_CHECKING:
    import can

LONGEST_LINE = 1 << 16
USUAL_LINE = 30

CANDUMP_LINE = re.compile(r"\([0-9]+\.?[0-9]*\)\s+\S+\s+[0-9a-f]{1,8}#(#[0-9])?(r[0-9]*|[0-9a-f]*)(\s+[rt])?", re.IGNORECASE)

ASC_DATE = re.compile(r"date\s+\w+\s+(.+)", re.IGNORECASE)
ASC_BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
ASC_HEADER = re.compile(r"date\s|base\s|//|(no)?\s*internal\s+events", re.IGNORECASE)
ASC_BEGIN = re.compile(r"begin\s+triggerblock(?:\s+\w+\s+(.+))?", re.IGNORECASE)
ASC_END = re.compile(r"end\s+triggerblock", re.IGNORECASE)
ASC_TIME = re.compile(r"(\d+\.\d+)\s", re.ASCII)
NO_NUMBER = re.compile(r"\s[+-]|\d_", re.ASCII)
"""Python reads signs and underscores in numbers; no recorder writes them."""
# English and German names, as CANoe writes them
MONTHS = {name: i for i, name in enumerate(["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"], 1)}
MONTHS |= {"Mär": 3, "Mai": 5, "Okt": 10, "Dez": 12}
DATE_FORMATS = ("%m %d %I:%M:%S.%f %p %Y", "%m %d %I:%M:%S %p %Y", "%m %d %H:%M:%S.%f %Y", "%m %d %H:%M:%S %Y")


def candump_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a `candump -L` log. An identifier with the error flag is an error frame, of whatever class."""
    yield from _batches(path, blocks_of_lines(path, file, report), _Candump(path, report))


def asc_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of an ASC log. Where its header says `timestamps relative`, each time counts from the event before and is summed."""
    dialect = _Asc(path, report)
    yield from _batches(path, dialect.begun(blocks_of_lines(path, file, report)), dialect)
    if dialect.block_open:
        report.ended_early = report.ended_early or "the line End TriggerBlock is missing"


class _Dialect(Protocol):
    """A text format: how whole lines are scanned, and how one line that the scan does not know is read."""

    def scan(self, text: Bytes, columns: Columns) -> tuple[int, int, int]:
        """Fill columns: frames, bytes used, status."""

    def names(self) -> tuple[str, ...]:
        """Names of the channels met so far."""

    def odd(self, line: bytes) -> Frames:
        """Frames of one line; none where it holds none, or where nobody can read it, which is counted."""


def _batches(path: Path, blocks: Iterable[Bytes], dialect: _Dialect) -> Iterator[Frames]:
    width = CLASSIC_BYTES
    for block in blocks:
        parts: list[Frames] = []
        pos = 0
        while pos < len(block):
            columns = new_columns((len(block) - pos) // USUAL_LINE + 1, width)  # where they are full, the next go on
            count, used, status = dialect.scan(block[pos:], columns)
            if count:
                parts.append(frames_of(columns, count, dialect.names(), path))
            pos += used
            if status == WIDE:
                width = FD_BYTES
            elif status == ODD:
                stop = line_stop(block, pos)
                parts.append(dialect.odd(block[pos:stop].tobytes()))
                pos = stop + 1
        yield parts[0] if len(parts) == 1 else join(parts)


def blocks_of_lines(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Bytes]:
    """Blocks of whole lines, each overwritten by the next. A last line without its end is not read: a number cut short would pass for
    another."""
    held = bytearray(LONGEST_LINE + BLOCK_BYTES)
    room, text = memoryview(held), np.frombuffer(held, np.uint8)
    kept = 0
    while got := read_into(room[kept : kept + BLOCK_BYTES], file, report):
        end = kept + got
        cut = max(held.rfind(b"\n", 0, end), held.rfind(b"\r", 0, end)) + 1
        kept = end - cut
        if kept > LONGEST_LINE:
            raise FileFormatError(f"{path}: is no text log: a line is longer than {LONGEST_LINE} bytes")
        if cut:
            yield text[:cut]
        room[:kept] = room[cut:end]
    tail = bytes(room[:kept])
    if tail.strip(b" \t\0\x1a"):
        shown = tail[:60].decode("ascii", "replace")
        report.ended_early = report.ended_early or f"the last line has no end and was not read: {shown!r}"


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8").strip()
    except UnicodeDecodeError:
        return line.decode("latin-1").strip()


def _by_library(reader: Callable[[io.StringIO], Iterable["can.Message"]], text: str, path: Path) -> Frames:
    """Frames that python-can reads from a text; ValueError where it cannot, or where the frames contradict themselves."""
    try:
        messages = [checked(m) for m in reader(io.StringIO(text))]
    except (IndexError, OverflowError, TypeError) as error:
        raise ValueError(str(error)) from error
    return frames_from_messages(messages, "log", str(path))


class _Candump:
    def __init__(self, path: Path, report: LogReport) -> None:
        self.path, self.report = path, report
        self._names, self._lengths = np.zeros((NAMES, NAME_BYTES), np.uint8), np.zeros(NAMES, np.int64)
        self._used = 0

    def scan(self, text: Bytes, columns: Columns) -> tuple[int, int, int]:
        count, end, status, self._used = scan_candump(text, columns, self._names, self._lengths, self._used)
        return count, end, status

    def names(self) -> tuple[str, ...]:
        return tuple(self._names[i, : self._lengths[i]].tobytes().decode("ascii") for i in range(self._used))

    def odd(self, line: bytes) -> Frames:
        from can.io import CanutilsLogReader

        text = _text(line)
        try:
            if not CANDUMP_LINE.fullmatch(text):
                raise ValueError("not as candump writes it")  # noqa: TRY301
            return _by_library(CanutilsLogReader, text, self.path)
        except ValueError as error:
            self.report.cannot_read(line, str(error))
            return no_frames(str(self.path), "log")


class _Asc:
    def __init__(self, path: Path, report: LogReport) -> None:
        self.path, self.report = path, report
        self.base = "hex"
        self.start_s = 0.0
        self.since_ns = -1
        self.block_open = False
        self._channels = Channels()

    def begun(self, blocks: Iterator[Bytes]) -> Iterator[Bytes]:
        """The blocks, the header lines of the first one understood."""
        for number, block in enumerate(blocks):
            if number == 0:
                for line in block[:LONGEST_LINE].tobytes().splitlines():
                    text = _text(line)
                    if text and not ASC_HEADER.match(text):
                        break
                    self._header_line(text)
            yield block

    def _header_line(self, text: str) -> None:
        if date := ASC_DATE.match(text):
            self._start(date[1])
        elif base := ASC_BASE.match(text):
            self.base = base[1].lower()
            self.since_ns = 0 if (base[2] or "").lower() == "relative" else -1

    def _start(self, text: str) -> None:
        started = _moment(text)
        if started is None:
            self.report.cannot_read(text.encode(), "its date is not understood")
        else:
            self.start_s = started

    def scan(self, text: Bytes, columns: Columns) -> tuple[int, int, int]:
        base = 16 if self.base == "hex" else 10
        found = scan_asc(text, self.start_s, base, self.since_ns, columns, self._channels.places, self._channels.used)
        count, end, status, self._channels.used, self.since_ns = found
        return count, end, status

    def names(self) -> tuple[str, ...]:
        return self._channels.names()

    def odd(self, line: bytes) -> Frames:
        from can.io import ASCReader

        nothing = no_frames(str(self.path), "log")
        text = _text(line)
        if begin := ASC_BEGIN.match(text):
            self.block_open = True
            self.since_ns = min(self.since_ns, 0)
            if begin[1]:
                self._start(begin[1])
            return nothing
        if ASC_END.match(text):
            self.block_open = False
            return nothing
        time = ASC_TIME.match(text)
        if time is None:
            return nothing
        try:
            if NO_NUMBER.search(text):
                raise ValueError("a number with a sign or an underscore")  # noqa: TRY301
            frames = _by_library(ASCReader, f"base {self.base}\ninternal events logged\n{text}\n", self.path)
        except ValueError as error:
            self.report.cannot_read(line, str(error))
            return nothing
        if self.since_ns >= 0:
            self.since_ns += round(float(time[1]) * 1e9)
            frames.time_s[:] = self.since_ns / 1e9
        frames.time_s[:] += self.start_s
        return frames


def _moment(text: str) -> float | None:
    """Seconds since 1970 of a date as ASC headers write it, without its weekday, in local time; None where it is not understood."""
    for name, number in MONTHS.items():
        text = text.replace(name, f"{number:02d}")
    for form in DATE_FORMATS:
        try:
            return datetime.strptime(text, form).timestamp()
        except (ValueError, OverflowError, OSError):
            continue
    return None
