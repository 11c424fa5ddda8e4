"""Which format a log is of: by its suffix, and for text by what stands in it, since one suffix names many dialects."""

import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import BinaryIO

from lmeasure.acquisition.bus.frames import Frames
from lmeasure.acquisition.logs.asc_and_candump import ASC_BASE, ASC_DATE, CANDUMP_LINE, asc_batches, candump_batches
from lmeasure.acquisition.logs.blf import blf_batches
from lmeasure.acquisition.logs.candump_screen import COLOUR, SCREEN_LINE, screen_batches
from lmeasure.acquisition.logs.csv_tables import gvret_batches, python_can_batches
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.acquisition.logs.trc import trc_batches
from lmeasure.core import FileFormatError

Batches = Callable[[Path, BinaryIO, LogReport], Iterator[Frames]]

HEAD_BYTES = 1 << 16
"""Of a text log, looked at to tell its dialect."""
HEAD_LINES = 200
SHOWN = 60
NEW_LINE = "\n"

OWN: dict[str, Batches] = {
    "blf": blf_batches,
    "asc": asc_batches,
    "candump": candump_batches,
    "screen": screen_batches,
    "trc": trc_batches,
    "gvret": gvret_batches,
    "python-can": python_can_batches,
}
LIBRARY = "library"
"""Read by python-can: MF4."""
DIALECTS = {
    "blf": "Vector's BLF",
    "asc": "Vector's ASC",
    "candump": "lines of candump -L",
    "screen": "what candump shows on a screen",
    "trc": "PEAK's TRC",
    "gvret": "CSV of GVRET or SavvyCAN",
    "python-can": "CSV of python-can",
    LIBRARY: "MF4",
}
"""For people."""
BY_SUFFIX = {".blf": "blf", ".asc": "asc", ".log": "candump", ".txt": "", ".trc": "trc", ".csv": "", ".mf4": LIBRARY}
FIXED = (".blf", ".asc", ".mf4")
"""Suffixes that leave no doubt."""

TELLING: tuple[tuple[str, re.Pattern[str]], ...] = (
    ("candump", CANDUMP_LINE),
    ("screen", SCREEN_LINE),
    ("trc", re.compile(r";\$FILEVERSION.*|;-+\+-.*|\d+\)\s.*", re.IGNORECASE)),
    ("gvret", re.compile(r"\W?time stamp\W+id\W+extended\W.*", re.IGNORECASE)),
    ("python-can", re.compile(r"\W?timestamp\W+arbitration_id\W.*", re.IGNORECASE)),
    ("IXXAT", re.compile(r".*\bixxat\b.*", re.IGNORECASE)),
    ("CANopen Magic", re.compile(r".*canopen magic.*", re.IGNORECASE)),
    ("Kvaser", re.compile(r".*kvaser.*|.*\bchn\b.*\bflg\b.*|.*\btime.*\bch\w*\W.*\bflags?\b.*\bdlc\b.*", re.IGNORECASE)),
    ("asc", re.compile(rf"{ASC_DATE.pattern}|{ASC_BASE.pattern}.*", re.IGNORECASE)),
    ("***BUSMASTER", re.compile(r"\*\*\*BUSMASTER.*", re.IGNORECASE)),
    ("CRTD", re.compile(r"\d+\.\d+ (CXX|\d?[RT](11|29)) .*")),
)
SAVVYCAN = "open it in SavvyCAN and save it as GVRET log (.csv)"
ROS = "where it has CAN frames, play it into ros2_socketcan or socketcan_bridge on vcan0 and record there by candump -L vcan0"
TOOLS = {
    "***BUSMASTER": f"a BUSMASTER log: {SAVVYCAN}",
    "CRTD": f"a CRTD log: {SAVVYCAN}",
    "IXXAT": f"a trace of IXXAT's canAnalyser or MiniMon: export it there as .asc, or {SAVVYCAN}",
    "CANopen Magic": f"a trace of CANopen Magic: {SAVVYCAN}",
    "Kvaser": "a table of Kvaser's: its converter (kmeconvert, or Save as in CanKing) writes .asc or .blf of the same recording",
    ".crtd": f"a CRTD log: {SAVVYCAN}",
    ".can": f"a Microchip log: {SAVVYCAN}",
    ".pcap": f"a capture of Wireshark: {SAVVYCAN}",
    ".pcapng": f"a capture of Wireshark: {SAVVYCAN}",
    ".db": "a python-can database: can_logconvert FILE.db FILE.blf",
    ".sqlite": "a python-can database: can_logconvert FILE FILE.blf, renamed to .db",
    ".mdf": "an MDF 3 measurement: asammdf saves it as .mf4, or exports .asc",
    ".dat": "an MDF 3 measurement, or somebody's own format: asammdf saves MDF 3 as .mf4, or exports .asc",
    ".vsb": "a Vehicle Spy buffer: export it from Vehicle Spy as .asc",
    ".kme50": "a Kvaser Memorator log: Kvaser's kmeconvert writes .asc or .blf of it",
    ".kme40": "a Kvaser Memorator log: Kvaser's kmeconvert writes .asc or .blf of it",
    ".kmf": "a Kvaser Memorator log: Kvaser's kmeconvert writes .asc or .blf of it",
    ".db3": f"a ROS 2 bag, which holds messages of ROS and no CAN log: {ROS}",
    ".bag": f"a ROS bag, which holds messages of ROS and no CAN log: {ROS}",
    ".mcap": f"a ROS bag, which holds messages of ROS and no CAN log: {ROS}",
    ".xlsx": "a table: save the log itself from the program that recorded it",
}
READ = ", ".join(BY_SUFFIX)


def kind_of(path: Path, suffix: str, head: bytes) -> str:
    """Key of `OWN`, or LIBRARY, for a log of that suffix (without .gz) that begins with `head`; FileFormatError names what reads it."""
    if suffix not in BY_SUFFIX:
        what = f"{TOOLS[suffix]}; " if suffix in TOOLS else ""
        other = "" if what else f"; for others, {SAVVYCAN}"
        raise FileFormatError(f"{path}: is no log this program reads: {what}{READ} are read, all but .mf4 also as .gz{other}")
    usual = BY_SUFFIX[suffix]
    told = None if suffix in FIXED else _first_typical(head)
    if told in TOOLS:
        raise FileFormatError(f"{path}: is no log this program reads: {TOOLS[told]}")
    if told is None and not usual:
        text = head.decode("utf-8-sig", "replace").strip()
        raise FileFormatError(
            f"{path}: is no log this program knows: neither candump, TRC, ASC nor CSV of SavvyCAN (Time Stamp,ID,Extended,...) or "
            f"python-can (timestamp,arbitration_id,...); it begins with {text[:SHOWN].partition(NEW_LINE)[0]!r}; for others, {SAVVYCAN}"
        )
    return told or usual


def _first_typical(head: bytes) -> str | None:
    """What the first line that is typical of a format says."""
    for raw in head.splitlines()[:HEAD_LINES]:
        line = COLOUR.sub("", raw.decode("utf-8-sig", "replace")).strip()
        for kind, typical in TELLING:
            if typical.fullmatch(line):
                return kind
    return None
