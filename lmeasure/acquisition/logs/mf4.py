"""MF4 logs, by python-can's reader and asammdf beneath it."""

import gc
import importlib.util
import itertools
import sys
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, cast

from lmeasure.acquisition.bus.frames import Frames, frames_from_messages
from lmeasure.acquisition.logs.report import LogFormat, LogReport, checked
from lmeasure.core import FileFormatError, how_to_install
from lmeasure.text import message

MESSAGES_AT_ONCE = 20_000


def mf4_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames by python-can's reader of MF4. Whatever goes wrong inside it ends the reading."""
    from lmeasure.acquisition.bus.python_can import mf4_reader

    report.unit = "records"
    broken = ""
    messages: Iterator[Any] = iter(())
    while not broken:
        batch: list[Any] = []
        try:
            # this reader, and asammdf beneath it, raise whatever their code runs into on a broken file
            if not report.frames:
                messages = iter(mf4_reader()(cast(Any, file)))
            for one in itertools.islice(messages, MESSAGES_AT_ONCE):
                batch.append(checked(one))
        except Exception as error:
            broken = _why(error)
        if not batch:
            break
        report.total += len(batch)
        yield frames_from_messages(batch, "log", str(path), classes=False)
    if broken and importlib.util.find_spec("asammdf") is None:
        raise FileFormatError(message("error.mf4_needs_the_package", where=path, install=how_to_install("mf4")))
    if broken and report.frames == 0:
        raise FileFormatError(message("error.cannot_be_read", where=path, broken=broken))
    if broken:
        report.ended_early = message("log.after_frame", frame=report.frames, why=broken)


def _why(error: Exception) -> str:
    """Return what an exception says, in one line; its frames are let go, and with them a file that asammdf could not open, whose end is not
    worth a word."""
    hook, sys.unraisablehook = sys.unraisablehook, lambda _: None
    try:
        traceback.clear_frames(error.__traceback__)
        gc.collect()
    finally:
        sys.unraisablehook = hook
    return " ".join(str(error).split()) or type(error).__name__


FORMAT = LogFormat(name="mf4", label="MF4", read=mf4_batches, suffixes=(".mf4",), suffix_decides=True, packed=False)
