"""The command line's own words, help, messages and progress, in the language of the terminal: `locale/*/cli.po`, by their English text.

A computation says what it says in English: what scripts hold on to, `--json` and errors, which people look up, stay so.
"""

from functools import partial

from lmeasure.catalogue import of_terminal as language
from lmeasure.catalogue import retold as told
from lmeasure.catalogue import texts

DOMAIN = "cli"


def said(text: str, /, **values: object) -> str:
    """A text, or a template with its values, in the words of the terminal; as it is where the catalogue has none."""
    own = "en" if not text else language()
    found = text if own == "en" else texts(DOMAIN, own).get(text, text)
    return found.format(**values) if values else found


def retold(message: str) -> str:
    """A line that is English, of the parser, of a workflow or of what a computation found, as one of the catalogue's templates has it, or
    a finding; as it is where none fits. What stands in it is told so too, a part after the other where several stand in a row. Numbers keep
    their point, as they are typed."""
    own = language()
    return message if own == "en" else _in(own, message)


def _in(own: str, message: str) -> str:
    text = message.strip()
    if not text or not any(letter.isalpha() for letter in text):
        return message
    found = told(DOMAIN, own, text, partial(_part, own)) or _finding(own, text)
    if found is None:
        separator = next((one for one in ("; ", ", ") if one in text), None)
        parts = () if separator is None else text.split(separator)
        found = text if separator is None else separator.join(_part(own, part) for part in parts)
    begin = message.index(text)
    return message[:begin] + found + message[begin + len(text) :]


def _part(own: str, value: str) -> str:
    """What stands in a line: a single word is a name, and stays."""
    return _in(own, value) if " " in value.strip() else value


def _finding(own: str, text: str) -> str | None:
    from lmeasure.findings import recognised

    found = recognised(text)
    return None if found is None else found.text(own)
