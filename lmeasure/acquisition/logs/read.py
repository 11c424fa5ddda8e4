"""Log files of CAN frames, read in batches of bounded size: BLF, ASC and candump by compiled scans, TRC, candump's screen and CSV line by
line, MF4 by python-can's reader.

A log that breaks off gives everything up to the break, and the report states where. Every line or object is a frame, of a known other kind,
or counted as unread; nothing is guessed. Times are those of python-can's readers with absolute times: the log's times plus its stated start
(0 without one).
"""

import gzip
import os
import re
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import BinaryIO, NamedTuple, cast

import numpy as np

from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, Frames, join, no_frames
from lmeasure.acquisition.logs import asc, blf, candump, candump_screen, csv_tables, mf4, trc
from lmeasure.acquisition.logs.candump_screen import COLOUR
from lmeasure.acquisition.logs.report import LogFormat, LogReport, read_some
from lmeasure.core import FileFormatError, plug_ins
from lmeasure.io import open_regular
from lmeasure.text import joined, message


class Other(NamedTuple):
    """A format of other programs: its name in the ids of texts, its suffixes, and a pattern of lines that are typical of it."""

    name: str
    suffixes: tuple[str, ...] = ()
    typical_line: str = ""


OTHERS = (
    Other("canalyser", typical_line=r".*\bixxat\b.*"),
    Other("canopen_magic", typical_line=r".*canopen magic.*"),
    Other("kvaser", typical_line=r".*kvaser.*|.*\bchn\b.*\bflg\b.*|.*\btime.*\bch\w*\W.*\bflags?\b.*\bdlc\b.*"),
    Other("busmaster", typical_line=r"\*\*\*BUSMASTER.*"),
    Other("crtd", (".crtd",), r"\d+\.\d+ (?-i:CXX|\d?[RT](11|29)) .*"),
    Other("microchip", (".can",)),
    Other("wireshark", (".pcap", ".pcapng")),
    Other("python_can_db", (".db",)),
    Other("python_can_sqlite", (".sqlite",)),
    Other("mdf3", (".mdf",)),
    Other("dat", (".dat",)),
    Other("vehicle_spy", (".vsb",)),
    Other("memorator", (".kme50", ".kme40", ".kmf")),
    Other("ros2", (".db3",)),
    Other("ros1", (".bag", ".mcap")),
    Other("table", (".xlsx",)),
)


def advice_for(suffix: str = "", line: str = "") -> str:
    """Return advice for a log of that suffix, or for such a line; empty if none is known."""
    by_line = (one for one in OTHERS if one.typical_line and re.fullmatch(one.typical_line, line, re.IGNORECASE))
    found = next((one.name for one in OTHERS if suffix in one.suffixes), "") or next((one.name for one in by_line), "")
    return message(f"log.other.{found}", savvycan=message("log.savvycan"), ros=message("log.ros")) if found else ""


FORMATS: tuple[LogFormat, ...] = (
    blf.FORMAT,
    asc.FORMAT,
    candump.FORMAT,
    candump_screen.FORMAT,
    trc.FORMAT,
    csv_tables.GVRET,
    csv_tables.PYTHON_CAN,
    mf4.FORMAT,
)
GROUP = "lmeasure.log_formats"

HEAD_BYTES = 1 << 16
HEAD_LINES = 200
SHOWN = 60
NEW_LINE = "\n"


def log_suffixes() -> tuple[str, ...]:
    """Return the suffixes, in small letters, of files that are logs whatever they contain."""
    return _suffixes((*FORMATS, *plug_ins(GROUP, LogFormat)[0].values()))


def _suffixes(formats: Iterable[LogFormat], *, possible: bool = False) -> tuple[str, ...]:
    return tuple(dict.fromkeys(s for one in formats for s in (*one.suffixes, *(one.possible_suffixes if possible else ()))))


def format_of(path: Path, suffix: str, head: bytes) -> LogFormat:
    """Return the format of a log of that suffix (without .gz) that begins with `head`; FileFormatError names the program that reads it."""
    usual = next((one for one in FORMATS if suffix in one.suffixes), None)
    if usual is not None and usual.suffix_decides:
        return usual
    ours = suffix in _suffixes(FORMATS, possible=True)
    lines = [COLOUR.sub("", raw.decode("utf-8-sig", "replace")).strip() for raw in head.splitlines()[:HEAD_LINES]]
    found, line = _first_typical(FORMATS, lines) if ours else (None, "")
    if found is not None:
        return found
    advice = advice_for(line=line)
    added, broken = plug_ins(GROUP, LogFormat)
    others = [one for one in added.values() if suffix in (*one.suffixes, *one.possible_suffixes)]
    found, _ = _first_typical(others, lines)
    if found is None and not advice:
        found = usual or next((one for one in others if suffix in one.suffixes), None)
    if found is not None:
        return found
    if advice:
        raise FileFormatError(message("error.is_no_log_this", where=path, advised=advice, broken=broken))
    if ours:
        begin = head.decode("utf-8-sig", "replace").strip()[:SHOWN].partition(NEW_LINE)[0]
        known = ", ".join(one.label for one in (*FORMATS, *added.values()) if one.typical_line is not None)
        raise FileFormatError(
            message("error.is_no_log_this_program", where=path, known=known, begin=begin, savvycan=message("log.savvycan"), broken=broken)
        )
    raise FileFormatError(message("error.is_no_log_this", where=path, advised=_advised(suffix, (*FORMATS, *added.values())), broken=broken))


def _first_typical(formats: Iterable[LogFormat], lines: Iterable[str]) -> tuple[LogFormat | None, str]:
    """Return the format that the first typical line is of, and that line; None for a line of another program's log."""
    for line in lines:
        found = next((one for one in formats if one.typical_line is not None and one.typical_line.fullmatch(line)), None)
        if found is not None or (formats is FORMATS and advice_for(line=line)):
            return found, line
    return None, ""


def _advised(suffix: str, formats: Iterable[LogFormat]) -> str:
    """Return advice for a file of an unknown suffix."""
    every = tuple(formats)
    advice = advice_for(suffix)
    known, bare = (", ".join(found) for found in (_suffixes(every, possible=True), _suffixes(one for one in every if not one.packed)))
    read = message("log.read", known=known, bare=bare)
    return joined([advice, read]) if advice else message("log.read_or", read=read, savvycan=message("log.savvycan"))


__all__ = ["LogReport", "identifiers_in", "log_batches", "read_frames"]

Progress = Callable[[int, int], None]


def log_batches(path: Path, report: LogReport, progress: Progress | None = None) -> Iterator[Frames]:
    """The log's frames in batches of at most some ten thousand, in the order of the file.

    progress gets the bytes read so far and the size of the file. FileFormatError when the file is no such log, or cannot be opened.
    """
    path = Path(path)
    suffixes = [s.lower() for s in path.suffixes[-2:]]
    packed = suffixes[-1:] == [".gz"]
    suffix = "".join(suffixes[:-1] if packed else suffixes[-1:])
    with open_regular(path) as raw:
        size = os.fstat(raw.fileno()).st_size
        if size == 0:
            raise FileFormatError(message("error.is_empty", where=path))
        file = cast(BinaryIO, gzip.GzipFile(fileobj=raw)) if packed else raw
        log_format = format_of(path, suffix, read_some(file, HEAD_BYTES, LogReport()))
        if packed and not log_format.packed:
            raise FileFormatError(message("error.is_no_log_this_program_reads", where=path, suffix=suffix))
        report.dialect = f"{log_format.label}{', packed' if packed else ''}"
        file.seek(0)
        for batch in log_format.read(path, file, report):
            report.frames += len(batch)
            if progress:
                progress(size if raw.closed else raw.tell(), size)  # python-can's readers close it behind the last frame
            if len(batch):
                yield batch
        report.close()
        if progress:
            progress(size, size)


def read_frames(log: Path | str) -> tuple[Frames, LogReport]:
    """Read all CAN frames of a log file, and account for the rest of it.

    Parameters
    ----------
    log
        Log file: .blf, .asc, .log, .txt, .trc, .csv (all also .gz), .mf4.

    Returns
    -------
    frames
        Arrays of n frames in the order of the file: time_s (n,) [s] as the log states it, identifier (n,), flags (n,) as in
        `lmeasure.acquisition.bus.frames`, length (n,) [bytes], data (n, 8) or (n, 64), channel (n,), an index into buses. Error frames are
        among them, with the class and data that the log states, and bus-off, error-passive and warning states of controllers: as
        error frames of SocketCAN (flag CLASSED).
    report
        frames + known + unread = total, the number of lines (unit "lines") or BLF objects ("objects"); known_kinds and unread_kinds by
        name; first_unread with its line or object; ended_early: why reading stopped before the end, or None.

    Raises
    ------
    FileFormatError
        If the file is no such log, or cannot be opened; the message names a converter where one is known.

    Examples
    --------
    >>> frames, report = lm.read_frames("drive.blf")  # doctest: +SKIP
    """
    path, report = Path(log), LogReport()
    parts = list(log_batches(path, report))
    return (join(parts) if parts else no_frames(str(path), "log")), report


def identifiers_in(path: Path) -> set[int]:
    """The 11-bit identifiers of the frames in the first of the log's batches that has any."""
    for batch in log_batches(path, LogReport()):
        plain = (batch.flags & (EXTENDED | ERROR)) == 0
        return set(np.unique(batch.identifier[plain]).tolist())
    return set()
