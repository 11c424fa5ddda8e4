"""Text logs of the Pelican, a recorder that does not exist:

#PELICAN 1
12.345678 181 : 0A 0B 0C 0D
"""

import re
from pathlib import Path

from lmeasure.acquisition import EXTENDED, Line, LogFormat, by_lines

FRAME = re.compile(r"(\d+\.\d+) ([0-9A-F]{3}|[0-9A-F]{8}) :((?: [0-9A-F]{2}){0,8})")


class Lines:
    """The lines of one log; what a header says for the lines behind it would be kept here."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, line: str) -> Line | str:
        """Return the frame of a line, or the kind of a line that is none; ValueError for a line that cannot be read."""
        if line.startswith("#"):
            return "header"
        found = FRAME.fullmatch(line)
        if found is None:
            raise ValueError("not as a Pelican writes it")
        time, identifier, cells = found.groups()
        data = bytes.fromhex(cells)
        return Line(float(time), int(identifier, 16), EXTENDED if len(identifier) == 8 else 0, len(data), data, "0")


FORMAT = LogFormat(
    name="pelican",
    label="Pelican's text log",
    read=by_lines(Lines),
    suffixes=(".pel",),
    possible_suffixes=(".txt",),
    typical_line=re.compile("#PELICAN 1"),
)
