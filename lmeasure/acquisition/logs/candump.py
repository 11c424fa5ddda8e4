"""Logs of `candump -L`: plain lines by a compiled scan, the others line by line."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, Frames
from lmeasure.acquisition.logs.report import (
    BLANK,
    COMMENT,
    COMMENT_SIGNS,
    UNKNOWN_LINE,
    LogFormat,
    LogReport,
    UnreadableError,
    blocks_of_lines,
    by_library,
    decoded,
    frames_of,
    new_columns,
    scanned_batches,
)
from lmeasure.core import IntArray
from lmeasure.kernels import NAME_BYTES, NAMES, Bytes, Columns, scan_candump
from lmeasure.text import message

LINE = re.compile(r"\(-?[0-9]+[.,]?[0-9]*\)\s+\S+\s+[0-9a-f]{1,8}#(#[0-9])?(r[0-9]*|[0-9a-f]*)(\s+[rt])?", re.IGNORECASE)

ERROR_LINE = re.compile(r"\s[2367abef][0-9a-f]{7}#", re.IGNORECASE)
"""Identifiers with the error flag (bit 29)."""


def candump_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Yield frames of a `candump -L` log. An identifier with the error flag is an error frame of any class."""
    yield from scanned_batches(path, blocks_of_lines(path, file, report), _Candump(path), report)


class _Candump:
    kinds: tuple[str, ...] = (BLANK,)

    def __init__(self, path: Path) -> None:
        self.path = path
        self._names, self._lengths = np.zeros((NAMES, NAME_BYTES), np.uint8), np.zeros(NAMES, np.int64)
        self._used = 0

    def scan(self, text: Bytes, columns: Columns, known: IntArray) -> tuple[int, int, int]:
        count, end, status, self._used = scan_candump(text, columns, self._names, self._lengths, self._used, known)
        return count, end, status

    def names(self) -> tuple[str, ...]:
        return tuple(self._names[i, : self._lengths[i]].tobytes().decode("ascii") for i in range(self._used))

    def odd(self, line: bytes) -> Frames | str:
        from lmeasure.acquisition.bus.python_can import can

        text = decoded(line)
        if text.startswith(COMMENT_SIGNS):
            return COMMENT
        if not LINE.fullmatch(text):
            raise UnreadableError(message("log.not_candump"), UNKNOWN_LINE)
        plain = " ".join(text.replace(",", ".", 1).split())
        if ERROR_LINE.search(plain):  # python-can drops the class and the data of most
            columns = new_columns(1, CLASSIC_BYTES)
            count, _, _ = self.scan(np.frombuffer(f"{plain}\n".encode(), np.uint8), columns, np.zeros(1, np.int64))
            if not count:
                raise ValueError(message("log.not_candump_error"))
            return frames_of(columns, count, self.names(), self.path)
        return by_library(can.CanutilsLogReader, text.replace(",", ".", 1), self.path)


FORMAT = LogFormat(
    name="candump",
    label=message("acquisition.lines_candump_l"),
    read=candump_batches,
    suffixes=(".log",),
    possible_suffixes=(".txt",),
    typical_line=LINE,
)
