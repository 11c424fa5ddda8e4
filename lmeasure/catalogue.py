"""Texts by key in the languages that people read: gettext catalogues of this package, `locale/LANGUAGE/DOMAIN.po`."""

import string
from collections.abc import Mapping
from functools import cache
from pathlib import Path
from typing import Any

LANGUAGES = ("en", "ru")
LOCALE = Path(__file__).parent / "locale"
DECIMAL_MARK = {"en": ".", "ru": ","}  # GOST R 1.5


@cache
def texts(domain: str, language: str) -> Mapping[str, str]:
    """All texts of a domain by their keys, in the order of the catalogue."""
    # takes a tenth of a second to import
    from babel.messages.pofile import read_po

    with (LOCALE / language / f"{domain}.po").open("rb") as file:
        return {str(message.id): str(message.string) for message in read_po(file, abort_invalid=True) if message.id}


def decimal(language: str, printed: str) -> str:
    """A printed number with the decimal mark of the language."""
    return printed.replace(".", DECIMAL_MARK[language])


class Writer(string.Formatter):
    """Puts values into the texts of a language: numbers get its decimal mark, values that have words of their own (`text`) those words, and
    several of them stand in a row."""

    def __init__(self, language: str) -> None:
        self.language = language

    def format_field(self, value: Any, format_spec: str) -> str:
        """See `string.Formatter`; a number that was read from a text comes as that text."""
        if isinstance(value, tuple):
            return ", ".join(self.format_field(v, format_spec) for v in value)
        if hasattr(value, "text"):
            return str(value.text(self.language))
        if not format_spec:
            return str(value)
        return decimal(self.language, value if isinstance(value, str) else format(value, format_spec))
