"""Logs that this program does not read, and what converts them: detected by a line of their text, or by their suffix."""

import re
from typing import NamedTuple

SAVVYCAN = "open it in SavvyCAN and save it as GVRET log (.csv)"
ROS = "where it has CAN frames, play it into ros2_socketcan or socketcan_bridge on vcan0 and record there by candump -L vcan0"


class Other(NamedTuple):
    """A format of other programs: what to do with it, its suffixes, and a pattern of lines that are typical of it."""

    advice: str
    suffixes: tuple[str, ...] = ()
    typical_line: str = ""


OTHERS = (
    Other(f"a trace of IXXAT's canAnalyser or MiniMon: export it there as .asc, or {SAVVYCAN}", typical_line=r".*\bixxat\b.*"),
    Other(f"a trace of CANopen Magic: {SAVVYCAN}", typical_line=r".*canopen magic.*"),
    Other(
        "a table of Kvaser's: its converter (kmeconvert, or Save as in CanKing) writes .asc or .blf of the same recording",
        typical_line=r".*kvaser.*|.*\bchn\b.*\bflg\b.*|.*\btime.*\bch\w*\W.*\bflags?\b.*\bdlc\b.*",
    ),
    Other(f"a BUSMASTER log: {SAVVYCAN}", typical_line=r"\*\*\*BUSMASTER.*"),
    Other(f"a CRTD log: {SAVVYCAN}", (".crtd",), r"\d+\.\d+ (?-i:CXX|\d?[RT](11|29)) .*"),
    Other(f"a Microchip log: {SAVVYCAN}", (".can",)),
    Other(f"a capture of Wireshark: {SAVVYCAN}", (".pcap", ".pcapng")),
    Other("a python-can database: can_logconvert FILE.db FILE.blf", (".db",)),
    Other("a python-can database: can_logconvert FILE FILE.blf, renamed to .db", (".sqlite",)),
    Other("an MDF 3 measurement: asammdf saves it as .mf4, or exports .asc", (".mdf",)),
    Other("an MDF 3 measurement, or somebody's own format: asammdf saves MDF 3 as .mf4, or exports .asc", (".dat",)),
    Other("a Vehicle Spy buffer: export it from Vehicle Spy as .asc", (".vsb",)),
    Other("a Kvaser Memorator log: Kvaser's kmeconvert writes .asc or .blf of it", (".kme50", ".kme40", ".kmf")),
    Other(f"a ROS 2 bag, which holds messages of ROS and no CAN log: {ROS}", (".db3",)),
    Other(f"a ROS bag, which holds messages of ROS and no CAN log: {ROS}", (".bag", ".mcap")),
    Other("a table: save the log itself from the program that recorded it", (".xlsx",)),
)


def advice_for(suffix: str = "", line: str = "") -> str:
    """Return what to do with a log of that suffix, or with such a line; empty where it is not known."""
    by_line = (one for one in OTHERS if one.typical_line and re.fullmatch(one.typical_line, line, re.IGNORECASE))
    return next((one.advice for one in OTHERS if suffix in one.suffixes), "") or next((one.advice for one in by_line), "")
