"""On which lines of a TOML file its keys stand, which tomllib does not say.

The file has been read as a whole before. Each of its statements is then read alone, by tomllib again: it is the fewest lines that are TOML,
and what it gives says which key or table it is. No grammar is needed for that.
"""

import re
import tomllib
from collections.abc import Iterator
from functools import cached_property
from typing import Any

Keys = tuple[int | str, ...]
"""Path to a value of a document: keys of tables, numbers of elements from 0."""

MOST_READ = 20_000
"""Attempts after which keys that follow have no line: a statement of n lines takes n."""

_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP = re.compile(rf"^[ \t]*+(?:\[{{1,2}}[ \t]*+)?{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{100}}", re.MULTILINE)
"""A key of more than a hundred parts, which no file has that a person wrote: reading it takes the square of their number."""

_LONG = re.compile(r"0[xob][0-9A-Fa-f_]{250}")
MOST_BITS = 1000


def loads(text: str) -> dict[str, Any]:
    """Return the content of a TOML text; ValueError, or RecursionError, for what is none, and for a key of more than a hundred parts."""
    if found := _DEEP.search(text):
        raise ValueError(f"a key has more than a hundred parts (at line {text.count(chr(10), 0, found.start()) + 1}, column 1)")
    content = tomllib.loads(text)
    if _LONG.search(text) and _longest(content) > MOST_BITS:
        raise ValueError("a number has more than a thousand bits")  # Python shows none of 4300 digits
    return content


def _longest(value: Any) -> int:
    """Return the number of bits of the longest whole number in a document."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return max(map(_longest, inner), default=0) if not isinstance(value, int) else value.bit_length()


class Document(dict[str, Any]):
    """A TOML document that knows its text."""

    def __init__(self, content: dict[str, Any], text: str) -> None:
        super().__init__(content)
        self.text = text

    def holding(self, content: dict[str, Any]) -> "Document":
        """Other content with the same text, where its keys still have their lines."""
        return Document(content, self.text)

    @cached_property
    def _lines(self) -> dict[Keys, int]:
        return dict(reversed(list(_statements(self.text))))  # a table begins at its first line

    def line(self, keys: Keys) -> int | None:
        """The line, from 1, of the value, else of the innermost table around it that has one."""
        for end in range(len(keys), 0, -1):
            if keys[:end] in self._lines:
                return self._lines[keys[:end]]
        return None


def _statements(text: str) -> Iterator[tuple[Keys, int]]:
    """Keys of each statement, and of the tables that it begins, with its line."""
    lines = text.replace("\r\n", "\n").split("\n")
    counts: dict[Keys, int] = {}
    here: Keys = ()
    begin, attempts = 0, 0
    while begin < len(lines) and attempts < MOST_READ:
        end, found = begin, None
        while found is None and end < len(lines) and attempts < MOST_READ:
            end, attempts = end + 1, attempts + 1
            found = _read("\n".join(lines[begin:end]))
        head = lines[begin].lstrip()
        if head.startswith("["):
            here = _table(found or {}, head.startswith("[["), counts)
            for depth in range(1, len(here) + 1):
                yield here[:depth], begin + 1
        elif found:
            keys = (*here, *_chain(found))
            for depth in range(len(here) + 1, len(keys) + 1):
                yield keys[:depth], begin + 1
        begin = end


def _read(statement: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(statement)
    except (ValueError, RecursionError):
        return None


def _chain(found: dict[str, Any]) -> Keys:
    """The dotted key of one statement; an inline table is a value."""
    key, value = next(iter(found.items()))
    return (key, *_chain(value)) if isinstance(value, dict) and len(value) == 1 else (key,)


def _table(found: dict[str, Any], several: bool, counts: dict[Keys, int]) -> Keys:
    """The keys of a header's table; counts: how many of each array of tables have begun."""
    out: Keys = ()
    value: Any = found
    while value:
        if isinstance(value, list):
            value = value[0]
            continue
        key, value = next(iter(value.items()))
        out = (*out, key)
        if several and isinstance(value, list):
            counts[out] = counts.get(out, 0) + 1
        if out in counts:
            out = (*out, counts[out] - 1)
    return out
