"""What the readers of every log format share: the report, the columns that the compiled scans fill, reading that may break off."""

import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO

import numpy as np

from lmeasure.acquisition.frames import CLASSIC_BYTES, FD_BYTES, Frames
from lmeasure.kernels.frames import LATEST_S, NAMED_CHANNELS, Columns

if TYPE_CHECKING:
    import can

BLOCK_BYTES = 1 << 21
LARGEST_IDENTIFIER = 0x1FFFFFFF


@dataclass
class LogReport:
    """What reading a log met, filled as its batches are taken.

    dialect: what kind of log it is, in words; frames read; unread lines that are no frames anyone can read, and the first of them;
    ended_early: why the reading stopped before the log's proper end, or None.
    """

    dialect: str = ""
    frames: int = 0
    unread: int = 0
    first_unread: str = ""
    ended_early: str | None = None

    def cannot_read(self, line: bytes, why: str) -> None:
        """Count a line."""
        if not self.unread:
            shown = line[:60].decode("ascii", "replace").strip()
            self.first_unread = f"{shown!r} ({why})"
        self.unread += 1

    def notes(self) -> list[str]:
        """What a person should know, one line each."""
        early = [f"ended early: {self.ended_early}; everything before it was read"] if self.ended_early else []
        return early + self._unread()

    def why(self) -> str:
        """The same for a run.toml, which says apart that the recording ended early."""
        return "; ".join([*([self.ended_early] if self.ended_early else []), *self._unread()])

    def _unread(self) -> list[str]:
        return [f"{self.unread} lines could not be read; the first is {self.first_unread}"] if self.unread else []


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
    """How many bytes were read into the room; a packed file that breaks off, or is broken, ends there."""
    try:
        return file.readinto(room)  # type: ignore[attr-defined, no-any-return]
    except (EOFError, OSError, zlib.error) as error:
        report.ended_early = f"the file cannot be read further: {error}"
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


def checked(message: "can.Message") -> "can.Message":
    """The message, its length being that of its data; ValueError where it does not hold the bytes it announces."""
    held = len(message.data)
    if not message.is_remote_frame and not message.is_error_frame:
        if held != message.dlc and not (held == CLASSIC_BYTES < message.dlc and not message.is_fd):
            raise ValueError(f"{message.dlc} bytes are announced and {held} are there")
        message.dlc = held
    if held > FD_BYTES or not 0 <= message.dlc < 256 or not 0 <= message.arbitration_id <= LARGEST_IDENTIFIER:
        raise ValueError("it is no frame of CAN")
    if not abs(message.timestamp) <= LATEST_S:
        raise ValueError(f"{message.timestamp} s is no time")
    return message
