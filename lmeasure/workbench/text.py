"""Words of the workbench's pages, by their ids."""

import itertools
import re
from collections.abc import Iterable

from lmeasure.text import LANGUAGES, Message, texts


def said(language: str, text: str, /, **values: object) -> str:
    """Return a message, or the text of an id with its values, in a language; anything else as it is."""
    if isinstance(text, Message):
        return text.text(language)
    found = texts(language).get(text, text)
    return found.format(**values) if values else found


def preferred(header: str) -> str:
    """Return the first language of a browser's Accept-Language that has a catalogue; English without one."""
    names = (part.split(";")[0].strip().split("-")[0].lower() for part in header.split(","))
    return next((name for name in names if name in LANGUAGES), "en")


def blocks(lines: Iterable[str]) -> list[list[list[str]]]:
    """Return the lines of a result as blocks of rows of cells: lines in columns one after the other are a table, any other is by itself.
    A first row that begins farther right than the second names the columns behind the first."""
    rows = [(line, re.split(r"\s{2,}", line.strip())) for text in lines for line in text.splitlines() if line.strip()]
    out: list[list[list[str]]] = []
    for columns, group in itertools.groupby(rows, key=lambda row: len(row[1]) > 1):
        own = list(group)
        cells = [row for _, row in own]
        if columns and len(own) > 1 and _indent(own[0][0]) > _indent(own[1][0]) + 1:
            cells[0] = ["", *cells[0]]
        out += [cells] if columns else [[row] for row in cells]
    return out


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())
