"""BLF logs: the containers by Intel's ISA-L, two to three times as fast as zlib, a few ahead in threads, their objects by a compiled scan.

Objects that are in the file itself, outside containers, are read in the same manner. Every object is a frame, of a kind that binlog.h
names, or unread; their number is compared with the one that the file header states.
"""

import itertools
import struct
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import numpy as np
from isal import isal_zlib

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, FD_BYTES, Frames, join
from lmeasure.acquisition.logs.report import BLOCK_BYTES, Channels, LogFormat, LogReport, frames_of, new_columns, read_some
from lmeasure.core import FileFormatError
from lmeasure.kernels import BROKEN, ODD, OTHER_OBJECTS, SMALLEST_FRAME_OBJECT, WIDE, scan_blf
from lmeasure.text import message

LARGEST_HEADER = 1 << 16
CONTAINER, RESTORE_POINT = 10, 115
LARGEST_CONTAINER = 1 << 24
CONTAINERS_AHEAD = 8
SIGNATURE = b"LOBJ"
PADDING = 4
LOST = (91, 125)
"""Kinds of objects that report lost data."""
KINDS = {
    "overload frame": (3,),
    "statistics": (4,),
    "variable": (6, 7, 8, 9, 72),
    "frame or state of another bus": (*range(11, 31), *range(32, 44), 45, *range(47, 51), *range(54, 65), *range(66, 72), *range(75, 86)),
    "state of the controller": (31, 44, 74, 129),
    "comment, marker or text": (65, 92, 96),
    "restore point": (RESTORE_POINT,),
    "loss stated by the recorder": (91, 125, 126),
}
"""Names of objects that are no frames."""
NOT_WHOLE, CONTRADICTORY = "cut off", "contradicting itself"
OTHER = "event or frame of another bus"
NAMES = {number: name for name, numbers in KINDS.items() for number in numbers}


def blf_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a BLF log, up to the first container or object that contradicts itself."""
    report.unit = "objects"
    start_s, stated = _header(path, file, report)
    scan = _Scan(path, start_s, report)
    for inside, piece in _joined(_pieces(file, report), BLOCK_BYTES):
        yield scan.read(piece, whole=not inside)
        if scan.broken:
            break
    scan.close()
    _compare(report, stated)


class _Scan:
    """Objects as they come: those of containers may continue in the next container, those outside are whole."""

    def __init__(self, path: Path, start_s: float, report: LogReport) -> None:
        self.path, self.start_s, self.report = path, start_s, report
        self.channels, self.width = Channels(), CLASSIC_BYTES
        self.tail, self.broken = b"", False
        self.known = np.zeros(OTHER_OBJECTS, np.int64)
        self.frames = 0

    def read(self, piece: bytes, whole: bool) -> Frames:
        """Frames of the next piece."""
        b = np.frombuffer(piece if whole else self.tail + piece, np.uint8)
        parts = []
        while True:
            columns = new_columns(len(b) // SMALLEST_FRAME_OBJECT + 1, self.width)
            channels = self.channels
            count, used, status, channels.used = scan_blf(b, self.start_s, columns, channels.places, channels.used, self.known)
            parts.append(frames_of(columns, count, channels.names(), self.path))
            self.frames += count
            b = b[used:]
            if status == ODD:
                b = b[self._unknown(b[:16].tobytes()) :]
            elif status == WIDE:
                self.width = FD_BYTES
            else:
                break
        if status == BROKEN:
            self._end(message("log.object_contradicts", frame=self.frames), CONTRADICTORY)
        if not whole:
            self.tail = b.tobytes()
        elif b.tobytes().strip(b"\0") and not self.broken:
            self._end(message("log.object_not_whole", frame=self.frames), NOT_WHOLE)
        return parts[0] if len(parts) == 1 else join(parts)

    def close(self) -> None:
        """Count the known objects, and report where the last one is cut off."""
        if self.tail.strip(b"\0") and not self.broken:
            self._end(message("log.last_object_not_whole", frame=self.frames), NOT_WHOLE)
        for number in np.flatnonzero(self.known).tolist():
            self.report.known_kinds[NAMES.get(number, OTHER)] += int(self.known[number])
        if lost := int(self.known[list(LOST)].sum()):
            self.report.remarks.append(message("log.recorder_lost", count=lost))

    def _end(self, why: str, kind: str) -> None:
        """Stop reading at an object, which is unread."""
        self.broken = True
        self.report.ended_early = self.report.ended_early or why
        self.report.cannot_read(b"", kind, self._place(), kind)

    def _place(self) -> str:
        return message("log.object", number=self.frames + int(self.known.sum()) + self.report.unread + 1)

    def _unknown(self, head: bytes) -> int:
        """Count an object that is no known kind or has no known header; return its size."""
        _, version, size, kind = struct.unpack("<4xHHLL", head)
        name = message("log.object_version", version=version)
        if not 0 < kind < OTHER_OBJECTS or kind == CONTAINER:
            name = message("log.object_kind", kind=kind)
        self.report.cannot_read(b"", name, self._place(), name)
        return int(size)


def _compare(report: LogReport, stated: int) -> None:
    """Compare the number of objects with that of the header, which may count restore points or not."""
    found = report.total = report.frames + report.known + report.unread
    if stated in (0, found, found - report.known_kinds.get("restore point", 0)):
        return
    if stated > found:
        report.ended_early = report.ended_early or message("log.objects_missing", stated=stated, found=found)
        report.total = stated
        missing = message("log.absent")
        report.cannot_read(b"", missing, message("log.object", number=found + 1), missing)
        report.unread_kinds[missing] += stated - found - 1
    else:
        report.remarks.append(message("log.objects_more", stated=stated, found=found))


def _header(path: Path, file: BinaryIO, report: LogReport) -> tuple[float, int]:
    """Read the file header: the start of the measurement [s since 1970] and the number of objects, each 0 where it states none."""
    from lmeasure.acquisition.bus.python_can import can

    raw = read_some(file, can.io.blf.FILE_HEADER_STRUCT.size, report)
    if raw[:4] != b"LOGG":
        raise FileFormatError(message("error.is_no_blf_file", where=path))
    if len(raw) < can.io.blf.FILE_HEADER_STRUCT.size:
        raise FileFormatError(message("error.breaks_off_inside_the", where=path))
    header = can.io.blf.FILE_HEADER_STRUCT.unpack(raw)
    size, stated = header[1], header[10]
    if not can.io.blf.FILE_HEADER_STRUCT.size <= size <= LARGEST_HEADER:
        raise FileFormatError(message("error.the_file_header_says", where=path, size=size))
    read_some(file, size - can.io.blf.FILE_HEADER_STRUCT.size, report)
    actual = path.stat().st_size
    if path.suffix.lower() != ".gz" and actual < stated:
        report.ended_early = message("log.bytes_missing", stated=stated, found=actual)
    elif stated <= size:
        report.ended_early = message("log.not_closed")
    return float(can.io.blf.systemtime_to_timestamp(header[14:22])), int(header[12])


def _pieces(file: BinaryIO, report: LogReport) -> Iterator[tuple[bool, bytes]]:
    """Contents of the log containers (True), unpacked ahead by threads (ISA-L releases the interpreter's lock), and objects outside."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        pending: deque[Future[tuple[bytes, bool]] | bytes] = deque()
        bodies = _bodies(file, report)
        while True:
            for method, body in itertools.islice(bodies, CONTAINERS_AHEAD - len(pending)):
                pending.append(body if method is None else pool.submit(_unpack, method, body))
            if not pending:
                return
            first = pending.popleft()
            if isinstance(first, bytes):
                yield False, first
                continue
            try:
                content, whole = first.result()
            except (isal_zlib.IsalError, ValueError) as error:  # type: ignore[misc]
                report.ended_early = message("log.container_packed", error=error)
                return
            yield True, content
            if not whole:
                report.ended_early = report.ended_early or message("log.container_not_whole")
                return


def _bodies(file: BinaryIO, report: LogReport) -> Iterator[tuple[int | None, bytes]]:
    """Yield (compression method, packed bytes) of each log container, and (None, objects) between them."""
    from lmeasure.acquisition.bus.python_can import can

    head = can.io.blf.OBJ_HEADER_BASE_STRUCT.size
    held, at, outside, size_outside = b"", 0, [], 0
    while True:
        if len(held) - at < head + PADDING:
            held, at = held[at:] + read_some(file, max(BLOCK_BYTES, head + PADDING), report), 0
        start = held.find(SIGNATURE, at, at + PADDING + len(SIGNATURE))
        if start < 0 or len(held) - start < head:
            if held[at:].strip(b"\0"):
                short = len(held) - at < head + PADDING
                report.ended_early = report.ended_early or (
                    message("log.container_header") if short else message("log.container_contradicts")
                )
            break
        _, _, _, size, kind = can.io.blf.OBJ_HEADER_BASE_STRUCT.unpack_from(held, start)
        if not head <= size <= LARGEST_CONTAINER:
            report.ended_early = message("log.container_contradicts")
            break
        if len(held) - start < size:
            held, start = held[start:] + read_some(file, size + BLOCK_BYTES, report), 0
        if len(held) - start < size:
            report.ended_early = report.ended_early or message("log.last_container_not_whole")
        at = min(start + size, len(held))
        if kind != CONTAINER or at - start < head + can.io.blf.LOG_CONTAINER_STRUCT.size:
            outside.append(held[start:at])
            size_outside += at - start
        if outside and (kind == CONTAINER or size_outside > BLOCK_BYTES):
            yield None, b"".join(outside)
            outside, size_outside = [], 0
        if kind != CONTAINER or at - start < head + can.io.blf.LOG_CONTAINER_STRUCT.size:
            continue
        method, _ = can.io.blf.LOG_CONTAINER_STRUCT.unpack_from(held, start + head)
        if method not in (can.io.blf.NO_COMPRESSION, can.io.blf.ZLIB_DEFLATE):
            report.ended_early = message("log.container_method", method=method)
            break
        yield method, held[start + head + can.io.blf.LOG_CONTAINER_STRUCT.size : at]
    if outside:
        yield None, b"".join(outside)


def _unpack(method: int, body: bytes) -> tuple[bytes, bool]:
    """Return a container's content, and whether it is whole. Its own statement of its size is not believed; ValueError where it grows
    beyond any recorder's."""
    from lmeasure.acquisition.bus.python_can import can

    if method == can.io.blf.NO_COMPRESSION:
        return body, True
    inflate = isal_zlib.decompressobj()
    data = inflate.decompress(body, LARGEST_CONTAINER)
    if inflate.unconsumed_tail:
        raise ValueError(message("log.container_grows", bytes=LARGEST_CONTAINER))
    return data, inflate.eof


def _joined(pieces: Iterator[tuple[bool, bytes]], size: int) -> Iterator[tuple[bool, bytes]]:
    """Pieces of one sort put together to about the given size, so that each compiled call has work to do."""
    for inside, some in itertools.groupby(pieces, key=lambda piece: piece[0]):
        held: list[bytes] = []
        total = 0
        for _, piece in some:
            held.append(piece)
            total += len(piece)
            if total >= size:
                yield inside, b"".join(held)
                held, total = [], 0
        if held:
            yield inside, b"".join(held)


FORMAT = LogFormat(name="blf", label=message("acquisition.vectors_blf"), read=blf_batches, suffixes=(".blf",), suffix_decides=True)
