"""Parts that the readers of all log formats share: the account of a log, columns that compiled scans fill, reading that may break off.

A format turns one line into one frame, or names the kind of a line that is none (comment, header, status), and raises ValueError for
any other line. All are counted; the lines around an unread one are read.
"""

import io
import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, NamedTuple, Protocol

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, ERROR, FD, FD_BYTES, REMOTE, Frames, frames_from_messages, join
from lmeasure.core import FileFormatError, IntArray, check_kind
from lmeasure.kernels import LATEST_S, NAMED_CHANNELS, ODD, WIDE, Bytes, Columns, line_ends, line_stop
from lmeasure.text import Message, composed, joined, message, message as text_of, reason, texts

if TYPE_CHECKING:
    import can


BLOCK_BYTES = 1 << 21
LARGEST_IDENTIFIER = 0x1FFFFFFF
LARGEST_STANDARD = 0x7FF
SHOWN_BYTES = 60
BLANK, COMMENT, HEADER = "blank", "comment", "header"
"""Kinds of known lines that several formats have."""
COMMENT_SIGNS = ("#", ";", "//")
BROKEN_FRAME, UNKNOWN_LINE, NO_END = "broken", "unknown", "without an end"
"""Kinds of unread lines."""


@dataclass
class LogReport:
    """Account of every line or object of a log; it grows while batches are taken.

    frames + known + unread = total. dialect: kind of log, in words; unit: noun of the total ("lines", "objects" of BLF, "records" of MF4);
    known_kinds and unread_kinds: how many of each kind, by name; first_unread: place, text and reason of the first unread one; ended_early:
    reason for a stop before the proper end, or None; remarks: other facts, such as losses that the recorder states itself.
    """

    dialect: str = ""
    unit: str = "lines"
    total: int = 0
    frames: int = 0
    known_kinds: Counter[str] = field(default_factory=Counter)
    unread_kinds: Counter[str] = field(default_factory=Counter)
    first_unread: str = ""
    ended_early: str | None = None
    remarks: list[str] = field(default_factory=list)

    @property
    def known(self) -> int:
        """Lines or objects that are no frames, of known kinds: comments, headers, statistics, events."""
        return self.known_kinds.total()

    @property
    def unread(self) -> int:
        """Lines or objects that are neither a frame nor of a known kind."""
        return self.unread_kinds.total()

    def cannot_read(self, line: bytes, why: str, place: str, kind: str = BROKEN_FRAME) -> None:
        """Count a line or object at `place` as unread."""
        if not self.unread:
            shown = line[:SHOWN_BYTES].decode("utf-8", "replace").strip()
            template = "{place}: {shown} ({why})" if shown else "{place} ({why})"
            self.first_unread = composed(template, place=place, shown=repr(shown), why=why)
        self.unread_kinds[kind] += 1

    def close(self) -> None:
        """Count everything that no reader counted as unread: the sum must match."""
        if missing := self.total - self.frames - self.known - self.unread:
            self.unread_kinds["not accounted for"] += missing

    def notes(self) -> list[str]:
        """Return notes for a person, one line each."""
        early = [text_of("log.ended_early", why=self.ended_early)] if self.ended_early else []
        return early + self._unread() + self.remarks

    def why(self) -> str:
        """Return the same for a run.toml, which states separately that the recording ended early."""
        return "; ".join([*([self.ended_early] if self.ended_early else []), *self._unread(), *self.remarks])

    def empty(self, log: Path) -> str:
        """Return the message about a log without a frame, and why it has none."""
        why = self.notes()
        if self.known_kinds:
            why.append(text_of("log.its_lines", total=self.total, unit=_word("unit", self.unit), kinds=_counted(self.known_kinds)))
        found = text_of("log.no_can_frame", log=log)
        return composed("{found}: {why}", found=found, why=joined(why)) if why else found

    def as_dict(self) -> dict[str, Any]:
        """Return the account for JSON and run.toml."""
        account = {"unit": self.unit, "total": self.total, "frames": self.frames, "known": self.known, "unread": self.unread}
        kinds = {"known_kinds": dict(self.known_kinds), "unread_kinds": dict(self.unread_kinds)}
        return account | {k: v for k, v in kinds.items() if v} | ({"first_unread": self.first_unread} if self.first_unread else {})

    def _unread(self) -> list[str]:
        if not self.unread or (self.ended_early and set(self.unread_kinds) == {NO_END}):
            return []
        unit, kinds = _word("unit", self.unit), _counted(self.unread_kinds)
        found = text_of("log.unread", unread=self.unread, total=self.total, unit=unit, kinds=kinds)
        return [joined([found, *([text_of("log.first_unread", first=self.first_unread)] if self.first_unread else [])])]


def _word(subject: str, name: str) -> str:
    """Return a name of files in words: a unit, or a kind of lines. Those of a plug-in have none."""
    key = f"log.{subject}.{re.sub(r'[^a-z0-9]+', '_', name.lower())}"
    return text_of(key) if key in texts("en") else name


def _counted(kinds: Counter[str]) -> tuple[Message, ...]:
    return tuple(composed("{n} {kind}", n=n, kind=_word("kind", kind)) for kind, n in kinds.most_common())


class UnreadableError(ValueError):
    """A line or object that is no frame anyone can read, and of no known kind."""

    def __init__(self, why: str, kind: str = BROKEN_FRAME) -> None:
        super().__init__(why)
        self.kind = kind


def kind_of_failure(error: Exception) -> str:
    """Return the kind as which an unread line is counted."""
    return error.kind if isinstance(error, UnreadableError) else BROKEN_FRAME


def new_columns(count: int, width: int) -> Columns:
    """Columns for at most count frames of at most width data bytes; their pages cost nothing until they are written."""
    return (
        np.empty(count),
        np.empty(count, np.uint32),
        np.empty(count, np.uint8),
        np.empty(count, np.uint8),
        np.empty((count, width), np.uint8),
        np.empty(count, np.int16),
    )


def frames_of(columns: Columns, count: int, buses: tuple[str, ...], path: Path) -> Frames:
    """The first count rows of the columns."""
    return Frames(*columns, buses, "log", str(path)).take(slice(count))


def read_into(room: memoryview, file: BinaryIO, report: LogReport) -> int:
    """Return how many bytes were read into the room; a packed file that breaks off, or is broken, ends there."""
    try:
        return file.readinto(room)  # type: ignore[attr-defined, no-any-return]
    except (EOFError, OSError, zlib.error) as error:
        report.ended_early = text_of("log.not_further", error=error)
        return 0


def read_some(file: BinaryIO, size: int, report: LogReport) -> bytes:
    """Return at most size bytes, as in `read_into`."""
    room = bytearray(size)
    return bytes(memoryview(room)[: read_into(memoryview(room), file, report)])


class Channels:
    """Names of the channels met, in the order of their first frame, for logs that number them."""

    def __init__(self) -> None:
        self.places = np.full(NAMED_CHANNELS, -1, np.int32)
        self.used = 0

    def names(self) -> tuple[str, ...]:
        """python-can counts channels from 0, the logs from 1."""
        numbers = np.flatnonzero(self.places >= 0)
        return tuple(str(number - 1) for number in numbers[np.argsort(self.places[numbers])])


def bytes_announced(announced: int, found: int) -> Message:
    """Report that a frame does not have the bytes that it announces."""
    return text_of("log.bytes", announced=announced, found=found)


def checked(message: "can.Message") -> "can.Message":
    """The message, its length being that of its data; ValueError where it does not hold the bytes it announces."""
    held = len(message.data)
    if not message.is_remote_frame and not message.is_error_frame:
        if held != message.dlc and not (held == CLASSIC_BYTES < message.dlc and not message.is_fd):
            raise ValueError(bytes_announced(message.dlc, held))
        message.dlc = held
    if held > FD_BYTES or not 0 <= message.dlc < 256 or not 0 <= message.arbitration_id <= LARGEST_IDENTIFIER:
        raise ValueError(text_of("log.no_frame"))
    if not abs(message.timestamp) <= LATEST_S:
        raise ValueError(text_of("log.no_time", seconds=message.timestamp))
    return message


Batches = Callable[[Path, BinaryIO, LogReport], Iterator[Frames]]
"""Yields frames of a log, at most some ten thousand at once, and accounts for everything else in the report."""


@dataclass(frozen=True, kw_only=True)
class LogFormat:
    """A format of log files, stated by the module that reads it.

    Parameters
    ----------
    name
        Short name.
    label
        Name for people, such as "Vector's BLF".
    read
        Reader of an open file; path is for messages. FileFormatError where nothing of the file can be read.
    suffixes
        Suffixes of files that are of this format, unless one of their first lines is typical of another.
    suffix_decides
        Whether files of these suffixes are of this format whatever their first lines are.
    possible_suffixes
        Suffixes of files that are of this format if one of their first lines is typical of it.
    typical_line
        Pattern of whole lines, without blanks at both ends, by which a text is detected.
    packed
        Whether such files are also read when gzip has packed them (.gz).
    """

    name: str
    label: str
    read: Batches
    suffixes: tuple[str, ...] = ()
    suffix_decides: bool = False
    possible_suffixes: tuple[str, ...] = ()
    typical_line: re.Pattern[str] | None = None
    packed: bool = True

    def __post_init__(self) -> None:
        check_kind(self.suffixes, self.read)
        check_kind(self.possible_suffixes)


LONGEST_LINE = 1 << 16
USUAL_LINE = 30

FD_LENGTHS = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Bytes of a CAN FD frame by its length code, ISO 11898-1."""
MOST_BUSES = 1000
WHOLE = re.compile(r"\d+", re.ASCII)
HEXADECIMAL = re.compile(r"[0-9A-Fa-f]+")
DECIMAL = re.compile(r"[+-]?\d+([.,]\d*)?", re.ASCII)


class Line(NamedTuple):
    """Frame of a line: time [s], identifier, flags, length (of a remote frame: bytes requested), data, bus."""

    time_s: float
    identifier: int
    flags: int
    length: int
    data: bytes
    bus: str


class Lines(Protocol):
    """Lines of one log. Each can be read by itself, once the header is known."""

    def read(self, line: str) -> Line | str:
        """Return the line's frame, or the kind of a line that is none; ValueError if it is unreadable."""


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
        """Return the frames of one line, or the kind of a line that is none; ValueError if it is unreadable."""


def scanned_batches(path: Path, blocks: Iterable[Bytes], dialect: ScannedLines, report: LogReport) -> Iterator[Frames]:
    """Yield frames of blocks of whole lines, by a compiled scan."""
    width = CLASSIC_BYTES
    for block in blocks:
        parts: list[Frames] = []
        known = np.zeros(len(dialect.kinds), np.int64)
        pos, columns = 0, None
        while pos < len(block):
            columns = columns or new_columns((len(block) - pos) // USUAL_LINE + 1, width)  # the next columns continue where these are full
            count, used, status = dialect.scan(block[pos:], columns, known)
            if count:
                parts.append(frames_of(columns, count, dialect.names(), path))
            pos += used
            if status == WIDE:
                width = FD_BYTES
            if count or status == WIDE:
                columns = None
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
