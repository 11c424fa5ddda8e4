"""Frames of a log file, as rows."""

from pathlib import Path

from log_corpus import Row, library_rows, rows

from lmeasure.acquisition import LogReport, read_frames
from lmeasure.acquisition.bus.frames import messages_from_frames

ERROR_COLUMN = 4
BUS_ERROR = 0x80


def read_rows(path: Path) -> tuple[list[Row], LogReport]:
    frames, report = read_frames(path)
    found = rows(messages_from_frames(frames))
    # python-can drops channel, class and data of candump's bus errors; the scan keeps them
    error = (0, True, False, True, False, False, False, True, 0, b"", "0")
    candump = path.suffix == ".log"
    return [(r[0], *error) if candump and r[ERROR_COLUMN] and r[1] & BUS_ERROR else r for r in found], report


def assert_as_the_library(path: Path, count: int | None = None) -> None:
    """Assert that python-can reads the log to its end, and the same frames are read here, of which there are so many."""
    expected, whole = library_rows(path)
    found, report = read_rows(path)
    assert whole
    assert found == expected
    assert count is None or len(found) == count
    assert report.notes() == []
