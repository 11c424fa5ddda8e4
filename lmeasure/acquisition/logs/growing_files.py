"""What a recording's files hold: frames as lines of candump, counts as lines of a table, in files that grow by whole pieces."""

import os
from pathlib import Path

import numpy as np

from lmeasure.acquisition.bus.frames import BITRATE_SWITCH, CLASSED, ERROR, ERROR_STATE, EXTENDED, FD, REMOTE, SENT, Frames, each
from lmeasure.acquisition.counters.samples import Samples

ERROR_FLAG, BUS_ERROR = 0x20000000, 0x80
"""Bit of an error frame's identifier in candump's logs, and its class for errors of the bus."""


def candump_lines(frames: Frames) -> bytes:
    """The frames as lines of candump, which python-can and can-utils read."""
    names = ["".join(c if (c.isascii() and c.isalnum()) or c in "._-" else "_" for c in name) or "can0" for name in frames.buses]
    names = [f"can{name}" if name.isdigit() else name for name in names]
    lines = []
    for t, identifier, flags, length, data, channel in each(frames):
        if flags & ERROR:
            # without a class the one that python-can takes for an error frame
            shown = ERROR_FLAG | (identifier if flags & CLASSED and identifier else BUS_ERROR)
            lines.append(f"({t:.6f}) {names[channel]} {shown:08X}#{data[:length].tobytes().hex().upper()}\n")
            continue
        arbitration = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:03X}"
        direction = "T" if flags & SENT else "R"
        if flags & REMOTE:
            body = f"#R{length}"
        elif flags & FD:
            body = f"##{(1 if flags & BITRATE_SWITCH else 0) | (2 if flags & ERROR_STATE else 0):X}{data[:length].tobytes().hex().upper()}"
        else:
            body = f"#{data[:length].tobytes().hex().upper()}"
        lines.append(f"({t:.6f}) {names[channel]} {arbitration}{body} {direction}\n")
    return "".join(lines).encode("ascii")


def count_lines(samples: Samples, origin_s: float) -> bytes:
    """Samples as lines of a counts file; an empty cell where there is no count."""
    times = np.round(samples.time_s - origin_s, 6).tolist()
    columns = [samples.recorded]
    columns += [extra[:, None] for extra in (samples.start_input, samples.u_time_s) if extra is not None]
    rows = np.hstack(columns).tolist()
    return "".join(f"{t!r}," + ",".join(map(_cell, row)) + "\n" for t, row in zip(times, rows, strict=True)).encode("ascii")


def _cell(value: float) -> str:
    if value != value:  # NaN
        return ""
    return str(int(value)) if value.is_integer() else repr(value)


class Appended:
    """A file that grows by whole pieces: a piece that the disk does not take is taken off again, and the file is closed to more."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._size = 0
        self._full = False

    def append(self, data: bytes) -> None:
        """Write all of it; OSError when it cannot be written."""
        if self._full:
            return
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError as error:
            self._full = True
            self._file.truncate(self._size)
            raise OSError(error.errno, error.strerror, str(self._file.name)) from error
        self._size += len(data)

    def to_disk(self) -> None:
        """Return when the disk has it."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """No more."""
        self._file.close()
