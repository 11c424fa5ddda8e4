"""Screen output of candump, redirected into a file: ` (1234.567890)  can0  181   [4]  01 02 03 04`.

Options that are understood: time stamps of every kind (-t a, A, d, z), directions (-x), ASCII (-a), bytes from the last to the first (-S),
colours. Without -t there are no times, and nothing can be read.
"""

import itertools
import re
from collections.abc import Iterator
from datetime import datetime
from pathlib import Path
from typing import BinaryIO

import numpy as np

from lmeasure.acquisition.bus.frames import BITRATE_SWITCH, CLASSED, ERROR, ERROR_STATE, EXTENDED, FD, LARGEST_CLASS, REMOTE, SENT, Frames
from lmeasure.acquisition.logs.report import (
    COMMENT,
    COMMENT_SIGNS,
    LARGEST_IDENTIFIER,
    UNKNOWN_LINE,
    Line,
    LogFormat,
    LogReport,
    UnreadableError,
    blocks_of_lines,
    bytes_announced,
    data_bytes,
    decimal_number,
    line_batches,
)
from lmeasure.kernels import Bytes
from lmeasure.text import message

SCREEN_LINE = re.compile(
    r"(?:\((?P<time>[^()]*)\)\s+)?(?P<bus>\S+)\s+(?:(?P<way>[RT]X)\s+(?P<switch>[B-])\s+(?P<state>[E-])\s+)?"
    r"(?P<identifier>[0-9A-F]{8}|[0-9A-F]{3})\s+\[(?P<length>[0-9]{1,2})\](?P<rest>.*)"
)
COLOUR = re.compile(r"\x1b\[[0-9;]*m")
ERROR_FLAG = 0x20000000
EXPLANATION = re.compile(
    r"(tx-timeout|lost-arbitration|controller-problem|protocol-violation|transceiver-status|no-acknowledgement-on-tx|bus-off|bus-error"
    r"|restarted-after-bus-off|error-counter-tx-rx)\b.*"
)
"""Lines that `candump -e` writes behind an error frame."""
DATE_FORMAT = "%Y-%m-%d %H:%M:%S.%f"
SINCE_1970_S = 1e8
"""Earlier times count from the first frame or from the one before."""


def screen_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of candump's screen output.

    Times that do not count from 1970 count from the first frame (-t z), or from the frame before (-t d) where one of the first block's is
    smaller than its predecessor: then they are summed.
    """
    blocks = blocks_of_lines(path, file, report)
    first = next(blocks, None)
    if first is None:
        return
    summed = _are_differences(first)
    since = 0.0
    for batch in line_batches(path, itertools.chain([first], blocks), _Screen(), report):
        if summed and len(batch):
            batch.time_s[:] = since + np.cumsum(batch.time_s)
            since = float(batch.time_s[-1])
        yield batch


def _are_differences(block: Bytes) -> bool:
    before = 0.0
    for raw in block.tobytes().splitlines():
        found = SCREEN_LINE.fullmatch(_plain(raw.decode("utf-8", "replace")))
        if found is None or found["time"] is None:
            continue
        try:
            time_s = _seconds(found["time"])
        except (ValueError, OverflowError, OSError):
            continue
        if time_s >= SINCE_1970_S:
            return False
        if time_s < before:
            return True
        before = time_s
    return False


def _plain(line: str) -> str:
    return COLOUR.sub("", line).strip()


def _seconds(text: str) -> float:
    if text.count("-") == 2:
        return datetime.strptime(text.strip().replace(",", "."), DATE_FORMAT).timestamp()
    return decimal_number(text.strip())


class _Screen:
    def read(self, line: str) -> Line | str:
        if line.startswith(COMMENT_SIGNS):
            return COMMENT
        found = SCREEN_LINE.fullmatch(_plain(line))
        if found is None and EXPLANATION.fullmatch(_plain(line)):
            return "explanation of an error frame"
        if found is None:
            raise UnreadableError(message("log.not_candump_screen"), UNKNOWN_LINE)
        if found["time"] is None:
            raise ValueError(message("log.candump_no_time"))
        identifier, rest = int(found["identifier"], 16), found["rest"].strip()
        flags = EXTENDED if len(found["identifier"]) > 3 else 0
        flags |= FD if len(found["length"]) > 1 else 0
        flags |= SENT if found["way"] == "TX" else 0
        flags |= (BITRATE_SWITCH if found["switch"] == "B" else 0) | (ERROR_STATE if found["state"] == "E" else 0)
        length = int(found["length"])
        time_s = _seconds(found["time"])
        if flags & EXTENDED and identifier & ERROR_FLAG:
            shown, _, _ = rest.partition("ERRORFRAME")
            identifier &= LARGEST_IDENTIFIER
            flags |= ERROR | (CLASSED if identifier <= LARGEST_CLASS else 0)
            return Line(time_s, identifier, flags, length, _data(shown, length), found["bus"])
        if rest == "remote request":
            return Line(time_s, identifier, flags | REMOTE, length, b"", found["bus"])
        return Line(time_s, identifier, flags, length, _data(rest, length), found["bus"])


def _data(rest: str, length: int) -> bytes:
    """Return the data bytes; the text in quotation marks behind them is the same as ASCII."""
    shown = rest.split("'", 1)[0]
    if "`" in shown:
        return data_bytes(shown.strip().split("`"))[::-1]
    cells = shown.split()
    if len(cells) != length:
        raise ValueError(bytes_announced(length, len(cells)))
    return data_bytes(cells)


FORMAT = LogFormat(
    name="screen",
    label=message("acquisition.candump_shows_screen"),
    read=screen_batches,
    possible_suffixes=(".log", ".txt"),
    typical_line=SCREEN_LINE,
)
