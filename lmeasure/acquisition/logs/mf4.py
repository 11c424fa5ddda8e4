"""MF4 logs, by python-can's reader and asammdf beneath it, in a process of its own: their compiled code may crash on a broken file."""

import importlib.util
import itertools
import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import Any, BinaryIO, cast

from lmeasure.acquisition.bus.frames import Frames, frames_from_messages
from lmeasure.acquisition.logs.report import LogFormat, LogReport, checked
from lmeasure.core import FileFormatError, how_to_install
from lmeasure.text import message

MESSAGES_AT_ONCE = 20_000
LONGEST_S = 120.0
"""Longest time of the other process for one batch of messages."""
READ = "import sys; from lmeasure.acquisition.logs.mf4 import read_aside; read_aside(sys.argv[1])"


def mf4_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Yield frames from the other process. Any failure in it ends the reading."""
    del file  # the other process opens it
    if importlib.util.find_spec("asammdf") is None:
        raise FileFormatError(message("error.mf4_needs_the_package", where=path, install=how_to_install("mf4")))
    report.unit = "records"
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(place for place in sys.path if place)}
    words = [sys.executable, "-P", "-c", READ, str(path.absolute())]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, env=environment) as child:
        assert child.stdout is not None
        try:
            while isinstance(found := _next(child), Frames):
                report.total += len(found)
                yield found
        finally:
            child.kill()
    if found and report.frames == 0:
        raise FileFormatError(message("error.cannot_be_read", where=path, broken=found))
    if found:
        report.ended_early = message("log.after_frame", frame=report.frames, why=found)


def _next(child: "subprocess.Popen[bytes]") -> Frames | str:
    """Return the next batch of the other process, or at the end the reason."""
    patience = threading.Timer(LONGEST_S, child.kill)
    patience.start()
    try:
        found: Frames | str = pickle.load(cast(BinaryIO, child.stdout))
    except (EOFError, pickle.UnpicklingError):
        return message("log.reader_ended", seconds=LONGEST_S)
    else:
        return found
    finally:
        patience.cancel()


def read_aside(path: str) -> None:
    """Write batches of frames to standard output, and at the end why reading broke off."""
    from lmeasure.acquisition.bus.python_can import mf4_reader

    out = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)  # libraries may print
    broken, messages = "", None
    with Path(path).open("rb") as file:
        while not broken:
            batch: list[Any] = []
            try:
                # this reader, and asammdf beneath it, raise whatever their code runs into on a broken file
                messages = messages or iter(mf4_reader()(cast(Any, file)))
                for one in itertools.islice(messages, MESSAGES_AT_ONCE):
                    batch.append(checked(one))
            except Exception as error:
                broken = " ".join(str(error).split()) or type(error).__name__
            if not batch:
                break
            pickle.dump(frames_from_messages(batch, "log", path, classes=False), out)
            out.flush()
        pickle.dump(broken, out)
        out.flush()


FORMAT = LogFormat(name="mf4", label="MF4", read=mf4_batches, suffixes=(".mf4",), suffix_decides=True, packed=False)
