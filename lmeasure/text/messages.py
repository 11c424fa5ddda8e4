"""What a computation has to say of its data: a code with values. Its words come from the catalogues, at the end.

English is what files and certificates keep (`str`); pages are printed in their own language (`Finding.text`).
"""

import re
import string
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from typing import Any

from lmeasure.text.catalogue import Writer, texts

DOMAIN = "findings"
_ONE = r"(?:[-+\d.e]+|nan|inf)"
NUMBER = rf"{_ONE}(?:, {_ONE})*"
"""A number as it is printed, or several."""
JOINED = "joined"
"""Two findings, one behind the other."""


@dataclass(frozen=True)
class Finding:
    """A code, a key of the catalogues `locale/*/findings.po`, and the values that its text names: numbers, texts, other findings or tuples
    of these."""

    code: str
    values: Mapping[str, Any]

    def __hash__(self) -> int:
        return hash((self.code, tuple(self.values.values())))

    def text(self, language: str) -> str:
        """In the words of a language."""
        return Writer(language).vformat(texts(DOMAIN, language)[self.code], (), self.values)

    def __str__(self) -> str:
        return self.text("en")

    def stated(self) -> dict[str, Any]:
        """As certificate.json has it: the English text, the code and the values."""
        return {"text": str(self), "code": self.code, "values": {key: _stated(value) for key, value in self.values.items()}}


def finding(code: str, **values: Any) -> Finding:
    """A finding of these values."""
    return Finding(code, values)


def from_stated(stated: Mapping[str, Any]) -> Finding | None:
    """What `Finding.stated` gave; None where it is something else, as of a code that another version knows."""
    try:
        found = Finding(stated["code"], {key: _read(value) for key, value in stated["values"].items()})
        return found if str(found) == stated["text"] else None
    except (KeyError, TypeError, ValueError, AttributeError):
        return None


def _stated(value: Any) -> Any:
    if isinstance(value, Finding):
        return value.stated()
    return [_stated(v) for v in value] if isinstance(value, tuple) else value


def _read(value: Any) -> Any:
    if isinstance(value, dict):
        return from_stated(value) or recognised(value["text"]) or value["text"]
    return tuple(_read(v) for v in value) if isinstance(value, list) else value


def recognised(text: str) -> Finding | None:
    """The finding of an English text that comes out of a file, or from where no codes are kept; None where the catalogue has no such text.

    The patterns are made of the catalogue's own texts, the first that fits counts; numbers stay as they are printed.
    """
    # first, for a value of a text could hold a whole second one
    for mark in re.finditer("; ", text):
        first, then = recognised(text[: mark.start()]), recognised(text[mark.end() :])
        if first is not None and then is not None:
            return Finding(JOINED, {"first": first, "then": then})
    for code, pattern, numbers in _patterns():
        found = pattern.fullmatch(text)
        if found is not None:
            return Finding(code, {k: v if k in numbers else _value(v) for k, v in found.groupdict().items()})
    return None


def _value(text: str) -> Finding | tuple[Finding, ...] | str:
    """What stands in a text: several findings in a row, one, or as it is."""
    parts = [recognised(part) for part in text.split(", ")]
    several = tuple(part for part in parts if part is not None)
    return several if len(several) == len(parts) > 1 else recognised(text) or text


@cache
def _patterns() -> tuple[tuple[str, re.Pattern[str], frozenset[str]], ...]:
    """Codes, patterns of their English texts, and which of the values are numbers; what has no word of its own beside other texts cannot
    be told."""
    out = []
    for code, text in texts(DOMAIN, "en").items():
        pattern, literal = "", ""
        numbers: dict[str, bool] = {}
        for before, name, spec, conversion in string.Formatter().parse(text):
            pattern, literal = pattern + re.escape(before), literal + before
            if name is not None:
                numbers[name] = bool(spec)
                value = f"(?P<{name}>{NUMBER if spec else '.+'})"
                pattern += f"'{value}'" if conversion else value
        if all(numbers.values()) or any(map(str.isalpha, literal)):
            out.append((code, re.compile(pattern), frozenset(name for name, number in numbers.items() if number)))
    return tuple(out)
