"""BLF logs: the containers by the standard library's zlib, a few ahead in threads, their objects by a compiled scan."""

import itertools
import zlib
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import BinaryIO

import numpy as np

from lmeasure.acquisition.frames import CLASSIC_BYTES, FD_BYTES, Frames
from lmeasure.acquisition.log_common import BLOCK_BYTES, Channels, LogReport, frames_of, new_columns, read_some
from lmeasure.errors import FileFormatError
from lmeasure.kernels.frames import BROKEN, SMALLEST_FRAME_OBJECT, WIDE, scan_blf

LARGEST_HEADER = 1 << 16
CONTAINER = 10
LARGEST_CONTAINER = 1 << 24
CONTAINERS_AHEAD = 8


def blf_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a BLF log, up to the first container or object that contradicts itself."""
    start_s = _header(path, file, report)
    channels = Channels()
    width = CLASSIC_BYTES
    tail = b""
    for piece in _joined(_containers(file, report), BLOCK_BYTES):
        block = tail + piece
        b = np.frombuffer(block, np.uint8)
        while True:
            columns = new_columns(len(b) // SMALLEST_FRAME_OBJECT + 1, width)
            count, used, status, channels.used = scan_blf(b, start_s, columns, channels.places, channels.used)
            yield frames_of(columns, count, channels.names(), path)
            b = b[used:]
            if status != WIDE:
                break
            width = FD_BYTES
        if status == BROKEN:
            report.ended_early = f"after frame {report.frames} an object contradicts itself"
            return
        tail = b.tobytes()
    if tail.strip(b"\0"):
        report.ended_early = report.ended_early or f"the last object, after frame {report.frames}, is not whole"


def _header(path: Path, file: BinaryIO, report: LogReport) -> float:
    """Reads the file header and stands behind it; the start of the measurement [s since 1970], 0 where it states none."""
    from can.io.blf import FILE_HEADER_STRUCT, systemtime_to_timestamp

    raw = read_some(file, FILE_HEADER_STRUCT.size, report)
    if raw[:4] != b"LOGG":
        raise FileFormatError(f"{path}: is no BLF file: it does not begin with LOGG")
    if len(raw) < FILE_HEADER_STRUCT.size:
        raise FileFormatError(f"{path}: breaks off inside the file header")
    header = FILE_HEADER_STRUCT.unpack(raw)
    size, stated = header[1], header[10]
    if not FILE_HEADER_STRUCT.size <= size <= LARGEST_HEADER:
        raise FileFormatError(f"{path}: the file header says it is {size} bytes long")
    read_some(file, size - FILE_HEADER_STRUCT.size, report)
    actual = path.stat().st_size
    if path.suffix.lower() != ".gz" and actual < stated:
        report.ended_early = f"the header states {stated} bytes and the file has {actual}"
    elif stated <= size:
        report.ended_early = "the recorder did not close the file"
    return float(systemtime_to_timestamp(header[14:22]))


def _containers(file: BinaryIO, report: LogReport) -> Iterator[bytes]:
    """Contents of the log containers, unpacked ahead by a few threads (zlib releases the interpreter's lock)."""
    with ThreadPoolExecutor(max_workers=2) as pool:
        pending: deque[Future[bytes]] = deque()
        bodies = _container_bodies(file, report)
        while True:
            pending.extend(pool.submit(_unpack, *body) for body in itertools.islice(bodies, CONTAINERS_AHEAD - len(pending)))
            if not pending:
                return
            try:
                yield pending.popleft().result()
            except (zlib.error, ValueError) as error:
                report.ended_early = f"a log container cannot be unpacked: {error}"
                return


def _container_bodies(file: BinaryIO, report: LogReport) -> Iterator[tuple[int, bytes]]:
    """(compression method, packed bytes) of each log container; other objects at this level are passed over."""
    from can.io.blf import LOG_CONTAINER_STRUCT, NO_COMPRESSION, OBJ_HEADER_BASE_STRUCT, ZLIB_DEFLATE

    while head := read_some(file, OBJ_HEADER_BASE_STRUCT.size, report):
        if len(head) < OBJ_HEADER_BASE_STRUCT.size:
            report.ended_early = report.ended_early or "the last log container has no whole header"
            return
        signature, _, _, size, kind = OBJ_HEADER_BASE_STRUCT.unpack(head)
        if signature != b"LOBJ" or not OBJ_HEADER_BASE_STRUCT.size <= size <= LARGEST_CONTAINER:
            report.ended_early = "a log container contradicts itself"
            return
        body = read_some(file, size - OBJ_HEADER_BASE_STRUCT.size, report)
        if len(body) < size - OBJ_HEADER_BASE_STRUCT.size:
            report.ended_early = report.ended_early or "the last log container is not whole"
        read_some(file, size % 4, report)
        if kind != CONTAINER or len(body) < LOG_CONTAINER_STRUCT.size:
            continue
        method, _ = LOG_CONTAINER_STRUCT.unpack_from(body)
        if method in (NO_COMPRESSION, ZLIB_DEFLATE):
            yield method, body[LOG_CONTAINER_STRUCT.size :]
        else:
            report.ended_early = f"a log container is packed by method {method}, which nobody documents"
            return


def _unpack(method: int, body: bytes) -> bytes:
    """A container's content. What it says about its size is not believed; ValueError where it grows beyond any recorder's."""
    from can.io.blf import NO_COMPRESSION

    if method == NO_COMPRESSION:
        return body
    inflate = zlib.decompressobj()
    data = inflate.decompress(body, LARGEST_CONTAINER)
    if inflate.unconsumed_tail:
        raise ValueError(f"it grows beyond {LARGEST_CONTAINER} bytes")
    return data


def _joined(pieces: Iterable[bytes], size: int) -> Iterator[bytes]:
    """Pieces put together to about the given size, so that each compiled call has work to do."""
    held: list[bytes] = []
    total = 0
    for piece in pieces:
        held.append(piece)
        total += len(piece)
        if total >= size:
            yield b"".join(held)
            held, total = [], 0
    if held:
        yield b"".join(held)
