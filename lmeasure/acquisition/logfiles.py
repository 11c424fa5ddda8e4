"""Log files of CAN frames, read in batches of bounded size: BLF, ASC and candump by compiled scans, the rest by python-can's readers.

A log that breaks off gives everything up to the break, and the report says where. Lines that cannot be read are counted, never guessed.
Times are those of python-can's readers with absolute times: what the log says plus the start it states (0 where it states none).
"""

import gc
import gzip
import io
import itertools
import sys
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, BinaryIO, cast

import numpy as np

from lmeasure.acquisition.frames import ERROR, EXTENDED, Frames, frames_from_messages, join, no_frames
from lmeasure.acquisition.log_blf import blf_batches
from lmeasure.acquisition.log_common import LogReport, checked
from lmeasure.acquisition.log_text import asc_batches, candump_batches
from lmeasure.errors import FileFormatError

__all__ = ["LogReport", "identifiers_in", "log_batches", "read_log"]

Progress = Callable[[int, int], None]

COMPILED = {".blf": blf_batches, ".asc": asc_batches, ".log": candump_batches}
OTHERS = (".csv", ".trc", ".mf4")
MESSAGES_AT_ONCE = 20_000


def log_batches(path: Path, report: LogReport, progress: Progress | None = None) -> Iterator[Frames]:
    """The log's frames in batches of at most some ten thousand, in the order of the file.

    progress gets the bytes read so far and the size of the file. FileFormatError when the file is no such log, or cannot be opened.
    """
    path = Path(path)
    suffixes = [s.lower() for s in path.suffixes[-2:]]
    packed = suffixes[-1:] == [".gz"]
    suffix = "".join(suffixes[:-1] if packed else suffixes[-1:])
    if suffix not in COMPILED and (packed or suffix not in OTHERS):
        raise FileFormatError(f"{path}: is no log this program reads: {', '.join([*COMPILED, *OTHERS])}, the first three also as .gz")
    try:
        size = path.stat().st_size
        raw = path.open("rb")
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from error
    with raw:
        if size == 0:
            raise FileFormatError(f"{path}: is empty")
        if suffix in COMPILED:
            batches = COMPILED[suffix](path, cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw, report)
        else:
            batches = _library_batches(path, report)
        for batch in batches:
            report.frames += len(batch)
            if progress:
                progress(raw.tell(), size)
            if len(batch):
                yield batch
        if progress:
            progress(size, size)


def read_log(path: Path) -> tuple[Frames, LogReport]:
    """The whole log at once, and what reading it met."""
    report = LogReport()
    parts = list(log_batches(path, report))
    return (join(parts) if parts else no_frames(str(path), "log")), report


def identifiers_in(path: Path) -> set[int]:
    """The 11-bit identifiers of the frames in the first of the log's batches that has any."""
    for batch in log_batches(path, LogReport()):
        plain = (batch.flags & (EXTENDED | ERROR)) == 0
        return set(np.unique(batch.identifier[plain]).tolist())
    return set()


def _library_batches(path: Path, report: LogReport) -> Iterator[Frames]:
    """Frames by python-can's reader for the file's suffix. Whatever goes wrong inside it ends the reading."""
    from can.io import MF4Reader
    from can.io.player import MESSAGE_READERS

    reader = MESSAGE_READERS[path.suffix.lower()]
    broken = ""
    with path.open("rb") as raw:
        file: Any = raw if reader is MF4Reader else io.TextIOWrapper(raw, encoding="utf-8")
        messages: Iterator[Any] = iter(())
        while not broken:
            batch: list[Any] = []
            try:
                # these readers, and asammdf beneath one of them, raise whatever their code runs into on a broken file
                messages = messages if report.frames else iter(reader(file))
                for message in itertools.islice(messages, MESSAGES_AT_ONCE):
                    batch.append(checked(message))
            except Exception as error:
                broken = _told(error)
            if not batch:
                break
            yield frames_from_messages(batch, "log", str(path))
    if broken and report.frames == 0:
        raise FileFormatError(f"{path}: cannot be read: {broken}")
    if broken:
        report.ended_early = f"after frame {report.frames}: {broken}"


def _told(error: Exception) -> str:
    """What an exception says, in one line; its frames are let go, and with them a file that asammdf could not open, whose end is not
    worth a word."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        traceback.clear_frames(error.__traceback__)
        gc.collect()
    finally:
        sys.unraisablehook = hook
    return " ".join(str(error).split()) or type(error).__name__
