"""Parts that the readers of all log formats share: the account of a log, columns that compiled scans fill, reading that may break off."""

import re
import zlib
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, FD_BYTES, Frames
from lmeasure.core import check_kind
from lmeasure.kernels import LATEST_S, NAMED_CHANNELS, Columns
from lmeasure.text import Message, composed, joined, message as text_of, texts

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

    frames + known + unread = total. dialect: kind of log, in words; unit: what total counts ("lines", "objects" of BLF, "records" of MF4);
    known_kinds and unread_kinds: how many of each kind, by name; first_unread: where the first unread one is, its text and the reason;
    ended_early: why reading stopped before the proper end, or None; remarks: other facts, such as losses that the recorder states itself.
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
        """Count a line or object as unread; place says where it is."""
        if not self.unread:
            shown = line[:SHOWN_BYTES].decode("utf-8", "replace").strip()
            template = "{place}: {shown} ({why})" if shown else "{place} ({why})"
            self.first_unread = composed(template, place=place, shown=repr(shown), why=why)
        self.unread_kinds[kind] += 1

    def close(self) -> None:
        """Count what no reader accounted for as unread: the sum must match."""
        if missing := self.total - self.frames - self.known - self.unread:
            self.unread_kinds["not accounted for"] += missing

    def notes(self) -> list[str]:
        """Return what a person should know, one line each."""
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
    """At most size bytes, as `read_into`."""
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
    """Say that a frame does not have the bytes that it announces."""
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
