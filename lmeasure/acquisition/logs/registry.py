"""Which format a log is of: by its suffix, and for text by its first lines, since one suffix names many formats.

Each module states its own format; a new one is its file and a word in `FORMATS`. Other packages add theirs by the entry point
`lmeasure.log_formats` (docs/extending.md), which is read when no format of this program fits.
"""

from collections.abc import Iterable
from pathlib import Path

from lmeasure.acquisition.logs import asc, blf, candump, candump_screen, csv_tables, mf4, trc
from lmeasure.acquisition.logs.candump_screen import COLOUR
from lmeasure.acquisition.logs.converters import SAVVYCAN, advice_for
from lmeasure.acquisition.logs.format import LogFormat
from lmeasure.core import FileFormatError, plug_ins

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
"""Beginning of a text log, by which its format is detected."""
HEAD_LINES = 200
SHOWN = 60
NEW_LINE = "\n"


def log_suffixes() -> tuple[str, ...]:
    """Return the suffixes of files that are logs whatever they contain, in small letters."""
    return _suffixes((*FORMATS, *plug_ins(GROUP, LogFormat)[0].values()))


def _suffixes(formats: Iterable[LogFormat], *, possible: bool = False) -> tuple[str, ...]:
    return tuple(dict.fromkeys(s for one in formats for s in (*one.suffixes, *(one.possible_suffixes if possible else ()))))


def format_of(path: Path, suffix: str, head: bytes) -> LogFormat:
    """Return the format of a log of that suffix (without .gz) that begins with `head`; FileFormatError names what reads it."""
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
        raise FileFormatError(f"{path}: is no log this program reads: {advice}{broken}")
    if ours:
        begin = head.decode("utf-8-sig", "replace").strip()[:SHOWN].partition(NEW_LINE)[0]
        known = ", ".join(one.label for one in (*FORMATS, *added.values()) if one.typical_line is not None)
        raise FileFormatError(
            f"{path}: is no log this program knows: its first lines are of none of {known}; it begins with {begin!r}; for others, "
            f"{SAVVYCAN}{broken}"
        )
    raise FileFormatError(f"{path}: is no log this program reads: {_advised(suffix, (*FORMATS, *added.values()))}{broken}")


def _first_typical(formats: Iterable[LogFormat], lines: Iterable[str]) -> tuple[LogFormat | None, str]:
    """Return the format that the first typical line is of, and that line; None for a line of another program's log."""
    for line in lines:
        found = next((one for one in formats if one.typical_line is not None and one.typical_line.fullmatch(line)), None)
        if found is not None or (formats is FORMATS and advice_for(line=line)):
            return found, line
    return None, ""


def _advised(suffix: str, formats: Iterable[LogFormat]) -> str:
    """Say what may be done with a file of an unknown suffix."""
    every = tuple(formats)
    advice = advice_for(suffix)
    what, other = (f"{advice}; ", "") if advice else ("", f"; for others, {SAVVYCAN}")
    bare = ", ".join(_suffixes(one for one in every if not one.packed))
    return f"{what}{', '.join(_suffixes(every, possible=True))} are read, all but {bare} also as .gz{other}"
