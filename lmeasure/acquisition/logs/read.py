"""Log files of CAN frames, read in batches of bounded size: BLF, ASC and candump by compiled scans, TRC, candump's screen and CSV line by
line, MF4 by python-can's reader.

A log that breaks off gives everything up to the break, and the report says where. Every line or object is a frame, of a known other
kind, or counted as unread; nothing is guessed.
Times are those of python-can's readers with absolute times: what the log says plus the start it states (0 where it states none).
"""

import gzip
import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO, cast

import numpy as np

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, Frames, join, no_frames
from lmeasure.acquisition.logs.registry import HEAD_BYTES, format_of
from lmeasure.acquisition.logs.report import LogReport, read_some
from lmeasure.core import FileFormatError
from lmeasure.io import open_regular

__all__ = ["LogReport", "identifiers_in", "log_batches", "read_frames"]

Progress = Callable[[int, int], None]


def log_batches(path: Path, report: LogReport, progress: Progress | None = None) -> Iterator[Frames]:
    """The log's frames in batches of at most some ten thousand, in the order of the file.

    progress gets the bytes read so far and the size of the file. FileFormatError when the file is no such log, or cannot be opened.
    """
    path = Path(path)
    suffixes = [s.lower() for s in path.suffixes[-2:]]
    packed = suffixes[-1:] == [".gz"]
    suffix = "".join(suffixes[:-1] if packed else suffixes[-1:])
    with open_regular(path) as raw:
        size = os.fstat(raw.fileno()).st_size
        if size == 0:
            raise FileFormatError(f"{path}: is empty")
        file = cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw
        log_format = format_of(path, suffix, read_some(file, HEAD_BYTES, LogReport()))
        if packed and not log_format.packed:
            raise FileFormatError(f"{path}: is no log this program reads: {suffix} only unpacked")
        report.dialect = f"{log_format.label}{', packed' if packed else ''}"
        file.seek(0)
        for batch in log_format.read(path, file, report):
            report.frames += len(batch)
            if progress:
                progress(size if raw.closed else raw.tell(), size)  # python-can's readers close it behind the last frame
            if len(batch):
                yield batch
        report.close()
        if progress:
            progress(size, size)


def read_frames(log: Path | str) -> tuple[Frames, LogReport]:
    """Read all CAN frames of a log file, and account for the rest of it.

    Parameters
    ----------
    log
        Log file: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4.

    Returns
    -------
    frames
        Arrays of n frames in the order of the file: time_s (n,) [s] as the log states it, identifier (n,), flags (n,) as in
        `lmeasure.acquisition.bus.frames`, length (n,) [bytes], data (n, 8) or (n, 64), channel (n,), an index into buses. Error frames are
        among them, with the class and data that the log states, and bus-off, error-passive and warning states of controllers: as
        error frames of SocketCAN (flag CLASSED).
    report
        frames + known + unread = total, the number of lines (unit "lines") or BLF objects ("objects"); known_kinds and unread_kinds by
        name; first_unread with its line or object; ended_early: why reading stopped before the end, or None.

    Raises
    ------
    FileFormatError
        If the file is no such log, or cannot be opened; the message names a converter where one is known.

    Examples
    --------
    >>> frames, report = lm.read_frames("drive.blf")  # doctest: +SKIP
    """
    path, report = Path(log), LogReport()
    parts = list(log_batches(path, report))
    return (join(parts) if parts else no_frames(str(path), "log")), report


def identifiers_in(path: Path) -> set[int]:
    """The 11-bit identifiers of the frames in the first of the log's batches that has any."""
    for batch in log_batches(path, LogReport()):
        plain = (batch.flags & (EXTENDED | ERROR)) == 0
        return set(np.unique(batch.identifier[plain]).tolist())
    return set()
