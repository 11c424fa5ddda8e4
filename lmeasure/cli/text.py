"""The command line's own words, help, messages and progress, in the language of the terminal: `locale/*/cli.po`, by their English text.

A computation says what it says in English: what scripts hold on to, `--json` and errors, which people look up, stay so.
"""

import re
from collections.abc import Callable
from functools import partial

from lmeasure.text import Message, of_terminal as language, old_texts, retold as told, signs, texts

DOMAIN = "cli"
COLUMNS = "  "
"""What stands between the columns of a table, at least."""
BETWEEN = "; ", ", "
"""What stands between parts of a line."""


def said(text: str, /, **values: object) -> str:
    """A text, or a template with its values, in the words of the terminal; as it is where the catalogue has none."""
    own = "en" if not text else language()
    found = text if own == "en" else old_texts(DOMAIN, own).get(text, text)
    return found.format(**values) if values else found


def retold(message: str) -> str:
    """A line that is English, of the parser, of a workflow or of what a computation found, as one of the catalogue's templates has it, or
    what pages tell of a computation, or a finding; as it is where none fits. What stands in it is told so too, a part after the other where
    several stand in a row, and columns stay where they are. Numbers have the language's decimal mark, but for what may be
    typed again, and signs are those that people write."""
    own = language()
    return signs(message if own == "en" else marked(_in(own, message), texts(own)["number.decimal_mark"]))


def as_typed(message: str) -> str:
    """The same of what was typed wrongly: numbers stay as they are typed."""
    own = language()
    return message if own == "en" else _in(own, message)


def marked(text: str, mark: str) -> str:
    """Numbers of a line with a decimal mark, and with semicolons between those in a row. What may be typed or pasted again keeps its point:
    values of options (`--u-mm 0.5`) and of keys (`u_mm = 0.5`), ranges, paths, addresses, what stands in quotes, and the pose that is
    typed into a controller, behind its number (`(1 of 12): `)."""

    def told(found: re.Match[str]) -> str:
        row = found["row"]
        return row.replace(", ", "; ").replace(".", mark) if row and "." in row else found[0]

    return _NUMBERS.sub(told, text)


_NUMBER = r"[-+±]?\d+(?:\.\d+)?(?:e[-+]?\d+|·10[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+)?"
_KEPT = r"--[\w-]+[ =]\S+|\w*_\w+ = (?:\[[^]]*\]|\S+)|'[^']*'|\"[^\"]*\"|`[^`]*`|\(\d+ \w+ \d+\): .*"
_NUMBERS = re.compile(rf"{_KEPT}|(?<![\w.,:/=-])(?P<row>{_NUMBER}(?:, {_NUMBER})*)(?![\w=-]|/(?![sс]\b)|[.,:]\w)")


def _in(own: str, message: str) -> str:
    text = message.strip()
    if not text or not any(letter.isalpha() for letter in text):
        return message
    own_words = partial(told, DOMAIN, own, inner=partial(_part, own))
    found = _each(text, own_words, BETWEEN) or _of_pages(own, text) or _finding(own, text)
    if found is None:
        separator = next((one for one in (COLUMNS, *BETWEEN) if one in text), None)
        if separator == COLUMNS:
            found = _in_columns(own, text)
        else:
            parts = () if separator is None else text.split(separator)
            found = text if separator is None else separator.join(_part(own, part) for part in parts)
    begin = message.index(text)
    return message[:begin] + found + message[begin + len(text) :]


def _each(text: str, tell: Callable[[str], str | None], between: tuple[str, ...]) -> str | None:
    """A text, or else all parts of it, where there are words for them."""
    whole = tell(text)
    for mark in between if whole is None else ():
        parts = [tell(part) for part in text.split(mark)]
        if None not in parts:
            return mark.join(part for part in parts if part is not None)
    return whole


def _in_columns(own: str, text: str) -> str:
    """A row of a table: what grows takes from the gap behind it."""
    out, more = "", 0
    for cell, gap in re.findall(rf"(.+?)({COLUMNS} *|$)", text):
        told_of = _part(own, cell)
        more += len(told_of) - len(cell)
        width = max(len(gap) - more, len(COLUMNS)) if gap else 0
        more -= len(gap) - width
        out += told_of + " " * width
    return out


def _part(own: str, value: str) -> str:
    """What stands in a line: a single word is a name, and stays."""
    return _in(own, value) if " " in value.strip() else value


def _of_pages(own: str, text: str) -> str | None:
    from lmeasure.text import TOLD, Say, pages, powers

    found = _each(text, partial(told, TOLD, own, inner=Say(own).message), BETWEEN[:1])
    counted = re.fullmatch(r"(.+?)( \(?\d+\)?)", text)
    if found is None and counted is not None and counted[1] in pages(own):
        return pages(own)[counted[1]] + counted[2]
    return None if found is None else powers(found)


def _finding(own: str, text: str) -> str | None:
    from lmeasure.text import recognised

    found = recognised(text)
    return None if found is None else found.text(own)


def word(code: str, /, **values: object) -> str:
    """Return the text of an id with its values in the words of the terminal."""
    return Message(code, values).text(language())
