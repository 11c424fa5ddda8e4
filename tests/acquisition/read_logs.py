"""Frames of a log file, as rows."""

from pathlib import Path

from log_corpus import Row, rows

from lmeasure.acquisition.frames import messages_from_frames
from lmeasure.acquisition.logfiles import LogReport, read_log

ERROR_COLUMN = 4


def read_rows(path: Path) -> tuple[list[Row], LogReport]:
    frames, report = read_log(path)
    found = rows(messages_from_frames(frames))
    # python-can drops the channel of candump's error frames; the scan keeps it
    return [(*r[:-1], "0") if r[ERROR_COLUMN] and path.suffix == ".log" else r for r in found], report
