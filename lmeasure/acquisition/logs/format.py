"""A log format: its name, its suffixes, the lines by which its text is detected, and its reader."""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from lmeasure.acquisition.bus.frames import Frames
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import check_kind

Batches = Callable[[Path, BinaryIO, LogReport], Iterator[Frames]]
"""Yields frames of a log, at most some ten thousand at once, and accounts for everything else in the report."""


@dataclass(frozen=True, kw_only=True)
class LogFormat:
    """A format of log files, stated by the module that reads it.

    Parameters
    ----------
    name
        Short name.
    label
        Name for people, such as "Vector's BLF".
    read
        Reader of an open file; path is for messages. FileFormatError where nothing of the file can be read.
    suffixes
        Suffixes of files that are of this format, unless one of their first lines is typical of another.
    suffix_decides
        Whether files of these suffixes are of this format whatever their first lines are.
    possible_suffixes
        Suffixes of files that are of this format if one of their first lines is typical of it.
    typical_line
        Pattern of whole lines, without blanks at both ends, by which a text is detected.
    packed
        Whether such files are also read when gzip has packed them (.gz).
    """

    name: str
    label: str
    read: Batches
    suffixes: tuple[str, ...] = ()
    suffix_decides: bool = False
    possible_suffixes: tuple[str, ...] = ()
    typical_line: re.Pattern[str] | None = None
    packed: bool = True

    def __post_init__(self) -> None:
        check_kind(self.suffixes, self.read)
        check_kind(self.possible_suffixes)
