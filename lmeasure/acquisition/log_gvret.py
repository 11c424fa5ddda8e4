"""The CSV files of SavvyCAN and of GVRET devices: `Time Stamp,ID,Extended,Dir,Bus,LEN,D1,...`, without the column Dir in old ones.

The time stamps are microseconds of the device's own clock, identifiers and bytes hexadecimal. What stands behind LEN bytes is left over.
"""

from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

from lmeasure.acquisition.frames import CLASSIC_BYTES, EXTENDED, FD, SENT, Frames
from lmeasure.acquisition.log_common import LogReport
from lmeasure.acquisition.log_lines import LARGEST_STANDARD, Line, data_bytes, hexadecimal, line_batches, whole_number
from lmeasure.acquisition.log_text import blocks_of_lines
from lmeasure.errors import FileFormatError

NEEDED = ("time stamp", "id", "extended", "bus", "len", "d1")
YES, NO = ("true", "1"), ("false", "0")


def gvret_batches(path: Path, file: BinaryIO, report: LogReport) -> Iterator[Frames]:
    """Frames of a GVRET CSV file. FileFormatError where its first line does not name the columns."""
    yield from line_batches(path, blocks_of_lines(path, file, report), _Gvret(path), report)


class _Gvret:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.columns: dict[str, int] = {}

    def read(self, line: str) -> Line | None:
        cells = [cell.strip() for cell in line.split(",")]
        if not self.columns:
            self.columns = {name.lower(): place for place, name in reversed(list(enumerate(cells)))}
            missing = [name for name in NEEDED if name not in self.columns]
            if missing:
                raise FileFormatError(
                    f"{self.path}: column {missing[0]!r} is missing in the first line; SavvyCAN writes {', '.join(NEEDED)}"
                )
            return None
        at = self.columns
        extended = cells[at["extended"]].lower()
        if extended not in YES + NO:
            raise ValueError(f"{extended[:20]!r} is neither true nor false")
        identifier, length = hexadecimal(cells[at["id"]].lower().removeprefix("0x")), whole_number(cells[at["len"]])
        if extended in NO and identifier > LARGEST_STANDARD:
            raise ValueError(f"{cells[at['id']]} is no identifier of 11 bits")
        flags = EXTENDED if extended in YES else 0
        flags |= FD if length > CLASSIC_BYTES else 0
        flags |= SENT if "dir" in at and cells[at["dir"]].lower() == "tx" else 0
        data = data_bytes(cells[at["d1"] : at["d1"] + length], least=1)
        return Line(whole_number(cells[at["time stamp"]]) / 1e6, identifier, flags, length, data, str(whole_number(cells[at["bus"]])))
