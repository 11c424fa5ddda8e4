"""CSV logs: of SavvyCAN and GVRET devices (`Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...`, without Dir in old ones), and of python-can.

The cells may be separated by commas, semicolons or tabs; where commas do not separate, a comma between digits is a decimal sign. The
times of GVRET are microseconds of the device's own clock, with fractions and signs; identifiers and bytes are hexadecimal. Cells behind
LEN bytes are ignored. Times of python-can are seconds, data are base64.
"""

import base64
import binascii
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

from lmeasure.acquisition.bus.frames import CLASSED, CLASSIC_BYTES, ERROR, EXTENDED, FD, LARGEST_CLASS, REMOTE, SENT
from lmeasure.acquisition.logs.report import (
    COMMENT,
    HEADER,
    LARGEST_STANDARD,
    Line,
    LogFormat,
    by_lines,
    data_bytes,
    decimal_number,
    hexadecimal,
    whole_number,
)
from lmeasure.core import FileFormatError
from lmeasure.text import composed, message

GVRET_COLUMNS = ("time stamp", "id", "extended", "bus", "len", "d1")
PYTHON_CAN_COLUMNS = ("timestamp", "arbitration_id", "extended", "remote", "error", "dlc", "data")
"""Columns that the first line must name."""
SEPARATORS = ",;\t"
YES, NO = ("true", "1"), ("false", "0")
SECONDS = re.compile(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", re.ASCII | re.IGNORECASE)
"""Number of seconds, also in Python's notation of small ones."""


class _Csv:
    """A table of frames whose first line names the columns."""

    def __init__(self, path: Path, *, needed: tuple[str, ...], frame: Callable[[list[str], dict[str, int]], Line]) -> None:
        self.path, self.needed, self.frame = path, needed, frame
        self.columns: dict[str, int] = {}
        self.separator = ","

    def read(self, line: str) -> Line | str:
        if not self.columns and line.startswith("#"):
            return COMMENT
        if not self.columns:
            self.separator = max(SEPARATORS, key=line.count)
        cells = [cell.strip().strip('"') for cell in line.split(self.separator)]
        names = {name.lower().lstrip("\ufeff").strip('"'): place for place, name in reversed(list(enumerate(cells)))}
        if not self.columns:
            missing = [name for name in self.needed if name not in names]
            if missing:
                raise FileFormatError(
                    message("error.column_is_missing_in", where=self.path, missing=missing[0], needed=", ".join(self.needed))
                )
            self.columns = names
            return HEADER
        if names == self.columns:  # of a file that was put behind another
            return HEADER
        return self.frame(cells, self.columns)


def _gvret_line(cells: list[str], at: dict[str, int]) -> Line:
    extended = _flag(cells[at["extended"]])
    identifier, length = hexadecimal(cells[at["id"]].lower().removeprefix("0x")), whole_number(cells[at["len"]])
    if not extended and identifier > LARGEST_STANDARD:
        raise ValueError(message("log.no_identifier_11", text=cells[at["id"]]))
    flags = EXTENDED if extended else 0
    flags |= FD if length > CLASSIC_BYTES else 0
    flags |= SENT if "dir" in at and cells[at["dir"]].lower() == "tx" else 0
    data = data_bytes(cells[at["d1"] : at["d1"] + length], least=1)
    return Line(decimal_number(cells[at["time stamp"]]) / 1e6, identifier, flags, length, data, str(whole_number(cells[at["bus"]])))


def _python_can_line(cells: list[str], at: dict[str, int]) -> Line:
    marks = {"extended": EXTENDED, "remote": REMOTE, "error": ERROR}
    flags = sum(mark for name, mark in marks.items() if _flag(cells[at[name]]))
    identifier, length = hexadecimal(cells[at["arbitration_id"]].lower().removeprefix("0x")), whole_number(cells[at["dlc"]])
    if not flags & EXTENDED and identifier > LARGEST_STANDARD:
        raise ValueError(message("log.no_identifier_11", text=cells[at["arbitration_id"]]))
    time = cells[at["timestamp"]].replace(",", ".")
    if not SECONDS.fullmatch(time):
        raise ValueError(message("log.no_number", text=repr(time[:20])))
    try:
        data = base64.b64decode(cells[at["data"]], validate=True)
    except binascii.Error as error:
        raise ValueError(composed("data: {error}", error=error)) from error
    if flags & ERROR and 0 < identifier <= LARGEST_CLASS and len(data) == CLASSIC_BYTES:  # only error frames of SocketCAN have 8 bytes
        flags |= CLASSED
    return Line(float(time), identifier, flags | (FD if length > CLASSIC_BYTES else 0), length, data, "0")


def _flag(cell: str) -> bool:
    if cell.lower() not in YES + NO:
        raise ValueError(message("log.no_truth", text=repr(cell[:20])))
    return cell.lower() in YES


GVRET = LogFormat(
    name="gvret",
    label=message("acquisition.csv_gvret_savvycan"),
    read=by_lines(partial(_Csv, needed=GVRET_COLUMNS, frame=_gvret_line)),
    possible_suffixes=(".csv",),
    typical_line=re.compile(r"\W?time stamp\W+id\W+extended\W.*", re.IGNORECASE),
)
PYTHON_CAN = LogFormat(
    name="python-can",
    label="CSV of python-can",
    read=by_lines(partial(_Csv, needed=PYTHON_CAN_COLUMNS, frame=_python_can_line)),
    possible_suffixes=(".csv",),
    typical_line=re.compile(r"\W?timestamp\W+arbitration_id\W.*", re.IGNORECASE),
)
