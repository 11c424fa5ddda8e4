"""Vector's ASC logs: plain lines by a compiled scan, the others line by line."""

import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

from lmeasure.acquisition.bus.frames import BUS_OFF, ERROR, PASSIVE, WARNING, Frames, controller_state, frames_from_messages
from lmeasure.acquisition.logs.report import (
    BLANK,
    COMMENT,
    COMMENT_SIGNS,
    HEADER,
    UNKNOWN_LINE,
    Channels,
    LogFormat,
    LogReport,
    UnreadableError,
    blocks_of_lines,
    by_library,
    decoded,
    scanned_batches,
)
from lmeasure.core import IntArray
from lmeasure.kernels import EVENTS, Bytes, Columns, scan_asc
from lmeasure.text import message

ASC_DATE = re.compile(r"date\s+\w+\s+(.+)", re.IGNORECASE)
ASC_BASE = re.compile(r"base\s+(hex|dec)(?:\s+timestamps\s+(absolute|relative))?", re.IGNORECASE)
ASC_INTERNAL = re.compile(r"(no)?\s*internal\s+events", re.IGNORECASE)
ASC_BEGIN = re.compile(r"begin\s+triggerblock(?:\s+\w+\s+(.+))?", re.IGNORECASE)
ASC_END = re.compile(r"end\s+triggerblock", re.IGNORECASE)
ASC_TIME = re.compile(r"([+-]?\d+)[.,](\d+)\s+(.*)", re.ASCII | re.DOTALL)
ASC_NAMED = re.compile(r"(\d+)\s+(\D\S*)(\s+(?:rx|tx)\s+[dr]\s.*\bid\s*=\s*(\d+)(x?))", re.IGNORECASE)
"""A frame whose identifier is a message's name: its number is behind the data."""
ASC_STATED = re.compile(r"\sID\s*=\s*(\d+)")
ASC_CLASSIC = re.compile(r"\d+\s+[0-9a-f]+x?\s+(?:rx|tx)\s+d\s+([0-9a-f]+)\s+(\S.*)", re.IGNORECASE)
"""A frame as nearly all lines have it: number of bytes, and the bytes."""
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
    ("start, stop or trigger", re.compile(r"(start|end|stop) of measurement|log (direct )?(start|stop)|(log )?trigger", re.IGNORECASE)),
    ("statistics", re.compile(r"\d+\s+statistic:", re.IGNORECASE)),
    ("bus status", re.compile(r"can\s|canfd\s+\d+\s+(status|txerr|rxerr)", re.IGNORECASE)),
    ("overload frame", re.compile(r"\d+\s+overloadframe", re.IGNORECASE)),
    ("request to send", re.compile(r"(\d+\s+\S+|canfd\s+\d+)\s+txrq\b", re.IGNORECASE)),
    ("environment variable", re.compile(r"\S+\s*:=")),
    ("comment or marker", re.compile(r"gm(group|marker)|comment", re.IGNORECASE)),
    ("frame of another bus", re.compile(r"(l\d+|li|fr|m\d+|most\w*|eth|afdx|a429|wlan|k-?line|j1587|j1708|j1939tp)\s", re.IGNORECASE)),
)
"""Events that are no frames, by the text behind their time."""
ASC_EVENT = re.compile("|".join(f"(?:{pattern.pattern})" for _, pattern in ASC_EVENTS), re.IGNORECASE)
"""Any of them."""
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


def asc_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Yield the frames of an ASC log. With `timestamps relative` in its header, the times are differences, and are summed."""
    dialect = _Asc(path)
    yield from scanned_batches(path, blocks_of_lines(path, file, report), dialect, report)
    if dialect.block_open:
        report.ended_early = report.ended_early or message("log.no_trigger_end")


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
        text = decoded(line)
        time = ASC_TIME.match(text)
        if time is None:
            return BLANK if not text else self._untimed(text)
        whole, part, rest = time.groups()
        offset_s = float(f"{whole}.{part}")
        if self.relative:
            self.since_ns += round(offset_s * 1e9)
            offset_s = self.since_ns / 1e9
        state = ASC_STATE.match(rest)
        if state is None and ASC_EVENT.match(rest):
            return next(kind for kind, pattern in ASC_EVENTS if pattern.match(rest))
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
            raise UnreadableError(message("log.no_event"), UNKNOWN_LINE)
        return HEADER

    def _start(self, text: str) -> None:
        started = _moment(text)
        if started is None:
            raise UnreadableError(message("log.no_date"), UNKNOWN_LINE)
        self.start_s = started

    def _frames(self, rest: str) -> Frames:
        from lmeasure.acquisition.bus.python_can import can

        if named := ASC_NAMED.match(rest):
            channel, _, behind, number, extended = named.groups()
            rest = f"{channel} {int(number):{'X' if self.base == 'hex' else 'd'}}{extended}{behind}"
        if NO_NUMBER.search(f" {rest}"):
            raise ValueError(message("log.signed_number"))
        if classic := ASC_CLASSIC.match(rest):
            # a byte that is none fails as in the library, which takes twenty times as long to find it
            base = 16 if self.base == "hex" else 10
            for byte in classic[2].split(maxsplit=8)[: min(8, int(classic[1], base))]:
                int(byte, base)
        frames = by_library(can.ASCReader, f"base {self.base}\ninternal events logged\n0.0 {rest}\n", self.path)
        stated = ASC_STATED.search(rest)
        if stated and not frames.flags[0] & ERROR and frames.identifier[0] != int(stated[1]):
            raise ValueError(message("log.other_identifier", stated=stated[1]))
        return frames


def _state(found: re.Match[str], path: Path) -> Frames:
    """Return a controller's status as an error frame of SocketCAN."""
    from lmeasure.acquisition.bus.python_can import can

    channel, state, *counts = found.groups()
    counters = min(int(counts[0] or 0), 255), min(int(counts[1] or 0), 255)
    words = state.lower()
    error = (BUS_OFF, b"") if words.startswith("bus") else controller_state(PASSIVE if words.startswith("error") else WARNING, counters)
    message = can.Message(arbitration_id=error[0], data=error[1], is_error_frame=True, channel=int(channel) - 1)
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


FORMAT = LogFormat(
    name="asc",
    label=message("acquisition.vectors_asc"),
    read=asc_batches,
    suffixes=(".asc",),
    suffix_decides=True,
    typical_line=re.compile(rf"{ASC_DATE.pattern}|{ASC_BASE.pattern}.*", re.IGNORECASE),
)
