"""TRC logs of PEAK's programs, versions 1.0 to 2.1 (PEAK CAN TRC File Format, PEAK-System 2020).

The times are those of python-can's reader: the offset behind the start that the header states, taken as UTC; numbers may have a decimal
comma. The column L of CAN FD frames holds the length code (9 means 12 bytes). Some programs write the length there: the number of bytes
behind it decides. Errors and states of the adapter are error frames with the classes and data of SocketCAN.
"""

import re
from datetime import UTC, datetime, timedelta
from pathlib import Path

from lmeasure.acquisition.bus.frames import (
    BITRATE_SWITCH,
    BUS_OFF,
    CLASSED,
    CLASSIC_BYTES,
    CONTROLLER,
    COUNTERS,
    ERROR,
    ERROR_STATE,
    EXTENDED,
    FD,
    PASSIVE,
    REMOTE,
    SENT,
    WARNING,
    controller_state,
)
from lmeasure.acquisition.logs.report import (
    COMMENT,
    FD_LENGTHS,
    HEADER,
    LARGEST_STANDARD,
    UNKNOWN_LINE,
    Line,
    LogFormat,
    UnreadableError,
    announced,
    by_lines,
    data_bytes,
    decimal_number,
    hexadecimal,
    whole_number,
)
from lmeasure.core import FileFormatError
from lmeasure.text import message

HEADER_LINE = re.compile(r";\$(FILEVERSION|STARTTIME|COLUMNS)\s*=\s*(.*)", re.IGNORECASE)
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
KINDS = {"DT": 0, "FD": FD, "FB": FD | BITRATE_SWITCH, "FE": FD | ERROR_STATE, "BI": FD | BITRATE_SWITCH | ERROR_STATE, "RR": REMOTE}
"""Message types from 2.0 on that are frames."""
STATUS = "status or error of the adapter"
OF_ADAPTER = ("Warng", "Warn", "Error", "ST", "EC", "ER", "EV", "MK")
"""Directions of the versions before, and types from 2.0 on, of lines that are no frames."""
OVERRUN, LIGHT, HEAVY, OFF, BUS_PASSIVE = 0x42, 0x04, 0x08, 0x10, 0x40000
"""Bits of the status, as TPCANStatus has them. Heavy is error-passive with some adapters and the warning limit with others: the error
counters decide, where the log has them."""
RECEIVE_OVERFLOW = 0x01
PROTOCOL, TRANSMITTED = 0x88, 0x80
"""SocketCAN's class for errors of a frame, and the bit of byte 2 for one that was sent; bits 0 to 2 there are PEAK's: bit, form, stuff."""
DIRECTION = re.compile(r"\s[RT]x\s")
BYTE = re.compile(r"[0-9A-Fa-f]{2}")
NEEDED = ("O", "T", "I", "d")


class _Trc:
    def __init__(self, path: Path) -> None:
        self.path = path
        self.version = "1.0"
        self.start_s = 0.0
        self.columns: dict[str, int] = PLACES["1.0"]
        self.counters: dict[str, tuple[int, int]] = {}
        """Error counters (sent, received) by bus."""

    def read(self, line: str) -> Line | str:
        if line.startswith(";"):
            if header := HEADER_LINE.match(line):
                self._header(header[1].upper(), header[2].strip().rstrip(";"))
                return HEADER
            return COMMENT
        return self._frame_2(line) if self.version >= "2" else self._frame_1(line)

    def _header(self, key: str, value: str) -> None:
        if key == "FILEVERSION":
            version = value.replace(",", ".")
            if version not in PLACES and version not in ("2.0", "2.1"):
                raise FileFormatError(message("error.is_trc_of_version", where=self.path, value=value[:20]))
            self.version, self.columns = version, PLACES.get(version, {})
        elif key == "STARTTIME":
            self.start_s = (DAY_ZERO + timedelta(days=decimal_number(value))).timestamp()
        elif self.version >= "2":
            self.columns = {name.strip(): place for place, name in enumerate(value.split(","))}
            missing = [name for name in NEEDED if name not in self.columns] + ["L"] * (not {"l", "L"} & self.columns.keys())
            if missing:
                raise FileFormatError(message("error.its_columns_are_column", where=self.path, value=value[:60], missing=missing[0]))

    def _frame_1(self, line: str) -> Line | str:
        cells, at = line.split(), self.columns
        direction = cells[at["d"]] if "d" in at else "Rx"
        identifier = cells[at["I"]]
        bus = cells[at["B"]] if "B" in at else "1"
        behind = cells[at["L"] + 1 :]
        error = direction == "Error" or behind[:1] == ["ERROR"]
        if error or direction in OF_ADAPTER or identifier == NO_IDENTIFIER:
            shown = [cell for cell in behind if BYTE.fullmatch(cell)][:4]
            return self._of_adapter(cells[at["O"]], bus, "ER" if error else "ST", [identifier, *shown] if error else shown)
        if direction not in ("Rx", "Tx"):
            raise UnreadableError(message("log.no_direction", text=repr(direction[:20])), UNKNOWN_LINE)
        length = whole_number(cells[at["L"]])
        remote = behind[:1] == ["RTR"]
        flags = (REMOTE if remote else 0) | (SENT if direction == "Tx" else 0)
        data = b"" if remote else data_bytes(announced(behind, length))
        return self._line(cells[at["O"]], identifier, flags, length, data, bus)

    def _frame_2(self, line: str) -> Line | str:
        at = self.columns
        if not at:
            raise FileFormatError(message("error.has_no_line_columns", where=self.path))
        cells = line.split(maxsplit=len(at) - 1)
        bus = cells[at["B"]] if "B" in at else "1"
        if cells[at["T"]] in OF_ADAPTER:  # cells that they have not are blank or '-'
            shown = [cell for cell in DIRECTION.split(line)[-1].split() if BYTE.fullmatch(cell)]
            return self._of_adapter(cells[at["O"]], bus, cells[at["T"]], shown)
        flags = KINDS.get(cells[at["T"]])
        if flags is None:
            raise UnreadableError(message("log.no_line_type", text=repr(cells[at["T"]][:20])), UNKNOWN_LINE)
        stated = whole_number(cells[at["l"] if "l" in at else at["L"]])
        shown = cells[at["D"]].split() if "D" in at and len(cells) > at["D"] and not flags & REMOTE else []
        if flags & FD and "l" not in at and len(shown) != stated and stated < len(FD_LENGTHS):
            stated = FD_LENGTHS[stated]
        if not flags & FD and stated > CLASSIC_BYTES:  # codes 9 to 15 of a classic frame mean 8 bytes
            stated = CLASSIC_BYTES
        flags |= SENT if cells[at["d"]] == "Tx" else 0
        data = data_bytes(announced(shown, stated))
        return self._line(cells[at["O"]], cells[at["I"]], flags, stated, data, bus)

    def _of_adapter(self, offset: str, bus: str, kind: str, shown: list[str]) -> Line | str:
        """Return an error frame, a state or a loss as an error frame of SocketCAN; others are known lines."""
        cells = [int(cell, 16) for cell in shown]
        if kind == "EC" and len(cells) == 2:
            self.counters[bus] = cells[1], cells[0]
        if kind == "ER" and len(cells) == 5:
            error, received, place, *counters = cells
            self.counters[bus] = counters[1], counters[0]
            if not error:  # a change of the counters only
                return STATUS
            data = bytes([0, 0, error & 0x07 | (0 if received else TRANSMITTED), place & 0x1F, 0, 0, *self.counters[bus]])
            found = PROTOCOL | COUNTERS, data
        elif kind == "ER":
            found = 0, b""
        elif kind == "ST" and len(cells) == 4 and (state := self._state(int.from_bytes(bytes(cells), "big"), bus)):
            found = state
        else:
            return STATUS
        flags = ERROR | (CLASSED if found[0] else 0)
        return Line(decimal_number(offset) / 1000 + self.start_s, found[0], flags, len(found[1]), found[1], str(whole_number(bus)))

    def _state(self, status: int, bus: str) -> tuple[int, bytes] | None:
        """Return class and data of a status; None where it is no error."""
        counters = self.counters.get(bus, (0, 0))
        if status & OFF:
            return BUS_OFF, b""
        if status & BUS_PASSIVE or (status & HEAVY and max(counters) >= PASSIVE[0]):
            return controller_state(PASSIVE, counters)
        if status & (HEAVY | LIGHT):
            return controller_state(WARNING, counters)
        return (CONTROLLER, bytes([0, RECEIVE_OVERFLOW, *[0] * 6])) if status & OVERRUN else None

    def _line(self, offset: str, identifier: str, flags: int, length: int, data: bytes, bus: str) -> Line:
        extended = EXTENDED if len(identifier) > STANDARD_DIGITS else 0
        number = hexadecimal(identifier)
        if not extended and number > LARGEST_STANDARD:
            raise ValueError(message("log.no_identifier_11", text=str(identifier)))
        return Line(decimal_number(offset) / 1000 + self.start_s, number, flags | extended, length, data, str(whole_number(bus)))


FORMAT = LogFormat(
    name="trc",
    label=message("acquisition.peaks_trc"),
    read=by_lines(_Trc),
    suffixes=(".trc",),
    typical_line=re.compile(r";\$FILEVERSION.*|;-+\+-.*|\d+\)\s.*", re.IGNORECASE),
)
