"""TRC logs of PEAK's programs, versions 1.0 to 2.1 (PEAK CAN TRC File Format, PEAK-System 2020).

The times are those of python-can's reader: the offset behind the start that the header states, taken as UTC. Of CAN FD frames the column L
holds the length code (9 means 12 bytes); some programs write the length there, which the bytes that stand behind it tell apart.
"""

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import BinaryIO

from lmeasure.acquisition.frames import BITRATE_SWITCH, CLASSIC_BYTES, ERROR_STATE, EXTENDED, FD, REMOTE, SENT, Frames
from lmeasure.acquisition.log_common import LogReport
from lmeasure.acquisition.log_lines import (
    FD_LENGTHS,
    LARGEST_STANDARD,
    Line,
    data_bytes,
    decimal_number,
    hexadecimal,
    line_batches,
    whole_number,
)
from lmeasure.acquisition.log_text import blocks_of_lines
from lmeasure.errors import FileFormatError

HEADER = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)\s*=\s*(.*)", re.IGNORECASE)
DAY_ZERO = datetime(1899, 12, 30, tzinfo=UTC)
STANDARD_DIGITS = 4
"""An identifier of more digits is one of 29 bits, whatever its value."""
NO_IDENTIFIER = "FFFFFFFF"
# columns of the versions before 2.0, of those that are read; None where a version has none
PLACES: dict[str, dict[str, int]] = {
    "1.0": {"O": 1, "I": 2, "L": 3},
    "1.1": {"O": 1, "d": 2, "I": 3, "L": 4},
    "1.2": {"O": 1, "B": 2, "d": 3, "I": 4, "L": 5},
    "1.3": {"O": 1, "B": 2, "d": 3, "I": 4, "L": 6},
}
KINDS = {
    "DT": 0,
    "FD": FD,
    "FB": FD | BITRATE_SWITCH,
    "FE": FD | ERROR_STATE,
    "BI": FD | BITRATE_SWITCH | ERROR_STATE,
    "RR": REMOTE,
}
"""Message types from 2.0 on that are frames; the others tell states and errors of the adapter."""
NEEDED = ("O", "T", "I", "d")


def trc_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a TRC log."""
    yield from line_batches(path, blocks_of_lines(path, file, report), _Trc(path), report)


class _Trc:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.version = "1.0"
        self.start_s = 0.0
        self.columns: dict[str, int] = PLACES["1.0"]

    def read(self, line: str) -> Line | None:
        if line.startswith(";"):
            if header := HEADER.match(line):
                self._header(header[1].upper(), header[2].strip().rstrip(";"))
            return None
        return self._frame_2(line) if self.version >= "2" else self._frame_1(line)

    def _header(self, key: str, value: str) -> None:
        if key == "FILEVERSION":
            if value not in PLACES and value not in ("2.0", "2.1"):
                raise FileFormatError(f"{self.path}: is TRC of version {value[:20]!r}; 1.0 to 1.3, 2.0 and 2.1 are read")
            self.version, self.columns = value, PLACES.get(value, {})
        elif key == "STARTTIME":
            self.start_s = (DAY_ZERO + timedelta(days=decimal_number(value))).timestamp()
        elif self.version >= "2":
            self.columns = {name.strip(): place for place, name in enumerate(value.split(","))}
            missing = [name for name in NEEDED if name not in self.columns] + ["L"] * (not {"l", "L"} & self.columns.keys())
            if missing:
                raise FileFormatError(f"{self.path}: its columns are {value[:60]}; column {missing[0]} is missing")

    def _frame_1(self, line: str) -> Line | None:
        cells, at = line.split(), self.columns
        direction = cells[at["d"]] if "d" in at else "Rx"
        identifier = cells[at["I"]]
        if direction not in ("Rx", "Tx") or identifier == NO_IDENTIFIER:
            return None
        length, rest = whole_number(cells[at["L"]]), cells[at["L"] + 1 :]
        if rest[:1] == ["ERROR"]:
            return None
        remote = rest[:1] == ["RTR"]
        flags = (REMOTE if remote else 0) | (SENT if direction == "Tx" else 0)
        return self._line(
            cells[at["O"]], identifier, flags, length, b"" if remote else data_bytes(rest), cells[at["B"]] if "B" in at else "1"
        )

    def _frame_2(self, line: str) -> Line | None:
        at = self.columns
        if not at:
            raise FileFormatError(f"{self.path}: has no line ;$COLUMNS= before its frames")
        cells = line.split(maxsplit=len(at) - 1)
        flags = KINDS.get(cells[at["T"]])
        if flags is None:
            return None
        stated = whole_number(cells[at["l"] if "l" in at else at["L"]])
        data = data_bytes(cells[at["D"]].split()) if "D" in at and len(cells) > at["D"] and not flags & REMOTE else b""
        if flags & FD and "l" not in at and len(data) != stated and stated < len(FD_LENGTHS):
            stated = FD_LENGTHS[stated]
        if not flags & FD and stated > CLASSIC_BYTES:  # codes 9 to 15 of a classic frame mean 8 bytes
            stated = CLASSIC_BYTES
        flags |= SENT if cells[at["d"]] == "Tx" else 0
        return self._line(cells[at["O"]], cells[at["I"]], flags, stated, data, cells[at["B"]] if "B" in at else "1")

    def _line(self, offset: str, identifier: str, flags: int, length: int, data: bytes, bus: str) -> Line:
        extended = EXTENDED if len(identifier) > STANDARD_DIGITS else 0
        number = hexadecimal(identifier)
        if not extended and number > LARGEST_STANDARD:
            raise ValueError(f"{identifier} is no identifier of 11 bits")
        return Line(decimal_number(offset) / 1000 + self.start_s, number, flags | extended, length, data, str(whole_number(bus)))
