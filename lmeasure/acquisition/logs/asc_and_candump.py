"""ASC and candump logs: plain lines by a compiled scan, the others line by line."""

import io
import re
from collections.abc import Callable, Iterable, Iterator
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO, Protocol

import numpy as np

from lmeasure.acquisition.bus.frames import (
    BUS_OFF,
    CLASSIC_BYTES,
    ERROR,
    FD_BYTES,
    PASSIVE,
    WARNING,
    Frames,
    controller_state,
    frames_from_messages,
    join,
)
from lmeasure.acquisition.logs.report import (
    BLANK,
    BLOCK_BYTES,
    COMMENT,
    COMMENT_SIGNS,
    HEADER,
    LARGEST_STANDARD,
    NO_END,
    SHOWN_BYTES,
    UNKNOWN_LINE,
    Channels,
    LogReport,
    UnreadableError,
    checked,
    frames_of,
    kind_of_failure,
    new_columns,
    read_into,
)
from lmeasure.core import FileFormatError, IntArray
from lmeasure.kernels import EVENTS, NAME_BYTES, NAMES, ODD, WIDE, Bytes, Columns, line_ends, line_stop, scan_asc, scan_candump

if TYPE_CHECKING:
    import can

LONGEST_LINE = 1 << 16
USUAL_LINE = 30

CANDUMP_LINE = re.compile(r"\(-?[0-9]+[.,]?[0-9]*\)\s+\S+\s+[0-9a-f]{1,8}#(#[0-9])?(r[0-9]*|[0-9a-f]*)(\s+[rt])?", re.IGNORECASE)

CANDUMP_ERROR = re.compile(r"\s[2367abef][0-9a-f]{7}#", re.IGNORECASE)
"""Identifiers with the error flag (bit 29)."""

ASC_DATE = re.compile(r"date\s+\w+\s+(.+)", re.IGNORECASE)
ASC_BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
ASC_INTERNAL = re.compile(r"(no)?\s*internal\s+events", re.IGNORECASE)
ASC_BEGIN = re.compile(r"begin\s+triggerblock(?:\s+\w+\s+(.+))?", re.IGNORECASE)
ASC_END = re.compile(r"end\s+triggerblock", re.IGNORECASE)
ASC_TIME = re.compile(r"([+-]?\d+)[.,](\d+)\s+(.*)", re.ASCII | re.DOTALL)
ASC_NAMED = re.compile(r"(\d+)\s+(\D\S*)(\s+(?:rx|tx)\s+[dr]\s.*\bid\s*=\s*(\d+)(x?))", re.IGNORECASE)
"""A frame whose identifier is a message's name: its number is behind the data."""
ASC_STATED = re.compile(r"\sID\s*=\s*(\d+)")
NO_NUMBER = re.compile(r"\s[+-]|\d_", re.ASCII)
"""Python reads signs and underscores in numbers; no recorder writes them."""
EVENT_KINDS = (
    "system variable",
    "test step",
    "transport protocol",
    *("frame of another bus",) * 5,
    "GPS",
    *("comment or marker",) * 2,
    "application",
)
"""Kinds of the events whose first word the scan knows, as in EVENTS."""
ASC_EVENTS: tuple[tuple[str, re.Pattern[str]], ...] = (
    *((kind, re.compile(re.escape(word), re.IGNORECASE)) for kind, word in zip(EVENT_KINDS, EVENTS, strict=True) if word.endswith(":")),
    (
        "start, stop or trigger",
        re.compile(r"(start|end|stop) of measurement|log (direct )?(start|stop)|(log )?trigger", re.IGNORECASE),
    ),
    ("statistics", re.compile(r"\d+\s+statistic:", re.IGNORECASE)),
    ("bus status", re.compile(r"can\s|canfd\s+\d+\s+(status|txerr|rxerr)", re.IGNORECASE)),
    ("overload frame", re.compile(r"\d+\s+overloadframe", re.IGNORECASE)),
    ("request to send", re.compile(r"(\d+\s+\S+|canfd\s+\d+)\s+txrq\b", re.IGNORECASE)),
    ("environment variable", re.compile(r"\S+\s*:=")),
    ("comment or marker", re.compile(r"gm(group|marker)|comment", re.IGNORECASE)),
    ("frame of another bus", re.compile(r"(l\d+|li|fr|m\d+|most\w*|eth|afdx|a429|wlan|k-?line|j1587|j1708|j1939tp)\s", re.IGNORECASE)),
)
"""Events that are no frames, by what is behind their time."""
ASC_STATE = re.compile(
    r"can(?:fd)?\s+(\d+)\s+status\s*:\s*chip status (bus ?off|error passive|warning (?:level|limit))"
    r"(?:\s*-\s*txerr:\s*(\d+)\s+rxerr:\s*(\d+))?",
    re.IGNORECASE,
)
"""Statuses of a controller that are errors: `CAN 1 Status:chip status error passive - TxErr: 132 RxErr: 0`."""
# English and German names, as CANoe writes them
MONTHS = {name: i for i, name in enumerate(["Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"], 1)}
MONTHS |= {"Mär": 3, "Mai": 5, "Okt": 10, "Dez": 12}
DATE_FORMATS = ("%m %d %I:%M:%S.%f %p %Y", "%m %d %I:%M:%S %p %Y", "%m %d %H:%M:%S.%f %Y", "%m %d %H:%M:%S %Y")


def candump_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a `candump -L` log. An identifier with the error flag is an error frame, of whatever class."""
    yield from _batches(path, blocks_of_lines(path, file, report), _Candump(path), report)


def asc_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of an ASC log. Where its header says `timestamps relative`, each time counts from the event before and is summed."""
    dialect = _Asc(path)
    yield from _batches(path, blocks_of_lines(path, file, report), dialect, report)
    if dialect.block_open:
        report.ended_early = report.ended_early or "the line End TriggerBlock is missing"


class _Dialect(Protocol):
    """A text format: how whole lines are scanned, and how one line that the scan does not know is read."""

    kinds: tuple[str, ...]
    """Kinds of the known lines that the scan counts."""

    def scan(self, text: Bytes, columns: Columns, known: IntArray) -> tuple[int, int, int]:
        """Fill columns, and count known lines: frames, bytes used, status."""

    def names(self) -> tuple[str, ...]:
        """Names of the channels met so far."""

    def odd(self, line: bytes) -> Frames | str:
        """Frames of one line, or the kind of a line that is none; ValueError where nobody can read it."""


def _batches(path: Path, blocks: Iterable[Bytes], dialect: _Dialect, report: LogReport) -> Iterator[Frames]:
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
                    place = "" if report.unread else f"line {report.total - line_ends(block[pos:]) + 1}"
                    report.cannot_read(line, str(error), place, kind_of_failure(error))
                pos = following
        for kind, count in zip(dialect.kinds, known.tolist(), strict=True):
            if count:
                report.known_kinds[kind] += count
        yield parts[0] if len(parts) == 1 else join(parts)


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
            raise FileFormatError(f"{path}: is no text log: a line is longer than {LONGEST_LINE} bytes")
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
            report.ended_early = report.ended_early or f"the last line has no end and was not read: {shown!r}"
            report.cannot_read(tail, "it has no end", f"line {report.total}", NO_END)


def _text(line: bytes) -> str:
    try:
        return line.decode("utf-8").strip()
    except UnicodeDecodeError:
        return line.decode("latin-1").strip()


def _by_library(reader: Callable[[io.StringIO], Iterable["can.Message"]], text: str, path: Path) -> Frames:
    """Frames that python-can reads from a text; ValueError where it reads none, or where they contradict themselves."""
    try:
        messages = [checked(m) for m in reader(io.StringIO(text))]
    except (IndexError, OverflowError, TypeError) as error:
        raise ValueError(str(error)) from error
    if not messages:
        raise UnreadableError("neither a frame nor a known event", UNKNOWN_LINE)
    if any(m.arbitration_id > LARGEST_STANDARD and not m.is_extended_id for m in messages):
        raise ValueError(f"{messages[0].arbitration_id:X} is no identifier of 11 bits")
    return frames_from_messages(messages, "log", str(path), classes=False)


class _Candump:
    kinds: tuple[str, ...] = (BLANK,)

    def __init__(self, path: Path) -> None:
        self.path = path
        self._names, self._lengths = np.zeros((NAMES, NAME_BYTES), np.uint8), np.zeros(NAMES, np.int64)
        self._used = 0

    def scan(self, text: Bytes, columns: Columns, known: IntArray) -> tuple[int, int, int]:
        count, end, status, self._used = scan_candump(text, columns, self._names, self._lengths, self._used, known)
        return count, end, status

    def names(self) -> tuple[str, ...]:
        return tuple(self._names[i, : self._lengths[i]].tobytes().decode("ascii") for i in range(self._used))

    def odd(self, line: bytes) -> Frames | str:
        from can.io import CanutilsLogReader

        text = _text(line)
        if text.startswith(COMMENT_SIGNS):
            return COMMENT
        if not CANDUMP_LINE.fullmatch(text):
            raise UnreadableError("not as candump writes it", UNKNOWN_LINE)
        plain = " ".join(text.replace(",", ".", 1).split())
        if CANDUMP_ERROR.search(plain):  # python-can drops the class and the data of most
            columns = new_columns(1, CLASSIC_BYTES)
            count, _, _ = self.scan(np.frombuffer(f"{plain}\n".encode(), np.uint8), columns, np.zeros(1, np.int64))
            if not count:
                raise ValueError("its error frame is not as candump writes it")
            return frames_of(columns, count, self.names(), self.path)
        return _by_library(CanutilsLogReader, text.replace(",", ".", 1), self.path)


class _Asc:
    kinds: tuple[str, ...] = (BLANK, COMMENT, *EVENT_KINDS)

    def __init__(self, path: Path) -> None:
        self.path = path
        self.base = "hex"
        self.start_s = 0.0
        self.relative, self.since_ns = False, 0
        self.block_open = False
        self._channels = Channels()

    def scan(self, text: Bytes, columns: Columns, known: IntArray) -> tuple[int, int, int]:
        base = 16 if self.base == "hex" else 10
        channels = self._channels
        found = scan_asc(text, self.start_s, base, self.relative, self.since_ns, columns, channels.places, channels.used, known)
        count, end, status, channels.used, self.since_ns = found
        return count, end, status

    def names(self) -> tuple[str, ...]:
        return self._channels.names()

    def odd(self, line: bytes) -> Frames | str:
        text = _text(line)
        time = ASC_TIME.match(text)
        if time is None:
            return BLANK if not text else self._untimed(text)
        whole, part, rest = time.groups()
        offset_s = float(f"{whole}.{part}")
        if self.relative:
            self.since_ns += round(offset_s * 1e9)
            offset_s = self.since_ns / 1e9
        state = ASC_STATE.match(rest)
        for kind, pattern in ASC_EVENTS if state is None else ():
            if pattern.match(rest):
                return kind
        frames = self._frames(rest) if state is None else _state(state, self.path)
        frames.time_s[:] = offset_s + self.start_s
        return frames

    def _untimed(self, text: str) -> str:
        """Kind of a line without a time; header and trigger blocks are understood."""
        if date := ASC_DATE.match(text):
            self._start(date[1])
        elif base := ASC_BASE.match(text):
            self.base = base[1].lower()
            self.relative, self.since_ns = (base[2] or "").lower() == "relative", 0
        elif begin := ASC_BEGIN.match(text):
            self.block_open, self.since_ns = True, 0
            if begin[1]:
                self._start(begin[1])
            return "trigger block"
        elif ASC_END.match(text):
            self.block_open = False
            return "trigger block"
        elif text.startswith(COMMENT_SIGNS):
            return COMMENT
        elif not ASC_INTERNAL.match(text):
            raise UnreadableError("neither a frame nor a known event", UNKNOWN_LINE)
        return HEADER

    def _start(self, text: str) -> None:
        started = _moment(text)
        if started is None:
            raise UnreadableError("its date is not understood; times count from 0", UNKNOWN_LINE)
        self.start_s = started

    def _frames(self, rest: str) -> Frames:
        """Frames of what is behind the time."""
        from can.io import ASCReader

        if named := ASC_NAMED.match(rest):
            channel, _, behind, number, extended = named.groups()
            rest = f"{channel} {int(number):{'X' if self.base == 'hex' else 'd'}}{extended}{behind}"
        if NO_NUMBER.search(f" {rest}"):
            raise ValueError("a number with a sign or an underscore")
        frames = _by_library(ASCReader, f"base {self.base}\ninternal events logged\n0.0 {rest}\n", self.path)
        stated = ASC_STATED.search(rest)
        if stated and not frames.flags[0] & ERROR and frames.identifier[0] != int(stated[1]):
            raise ValueError(f"its identifier is not the one that it states as ID = {stated[1]}")
        return frames


def _state(found: re.Match[str], path: Path) -> Frames:
    """Return a controller's status as an error frame of SocketCAN."""
    from can import Message

    channel, state, *counts = found.groups()
    counters = min(int(counts[0] or 0), 255), min(int(counts[1] or 0), 255)
    words = state.lower()
    error = (BUS_OFF, b"") if words.startswith("bus") else controller_state(PASSIVE if words.startswith("error") else WARNING, counters)
    message = Message(arbitration_id=error[0], data=error[1], is_error_frame=True, channel=int(channel) - 1)
    return frames_from_messages([message], "log", str(path))


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
