"""Read the texts of each language by id from `locale/LANGUAGE.po`, and write numbers in the language's form.

A new language needs one file: `LANGUAGES` lists those that exist. English is complete; texts missing in another language appear in English.
"""

import json
import os
import re
import string
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from gettext import c2py
from pathlib import Path
from typing import Any

LOCALE = Path(__file__).parent / "locale"
LANGUAGES = tuple(sorted(path.stem for path in LOCALE.glob("*.po")))
PLACES = "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"
"""Environment variables that name a language; the first that is not empty counts."""


def of_terminal(environment: Mapping[str, str] | None = None) -> str:
    """Return the language of the environment, English where it names none that has a catalogue."""
    known = os.environ if environment is None else environment
    named = next((known[place] for place in PLACES if known.get(place)), "")
    # LANGUAGE may name several, de:ru
    requested = (re.split(r"[._@]", one)[0].lower() for one in named.split(":"))
    return next((one for one in requested if one in LANGUAGES), "en")


@cache
def texts(language: str, subject: str = "") -> Mapping[str, str]:
    """Return the texts of a language by their ids; with a subject those of ids that begin with it, by the rest of their ids."""
    if subject:
        begin = f"{subject}."
        return {key.removeprefix(begin): text for key, text in texts(language).items() if key.startswith(begin)}
    own = read_catalogue(LOCALE / f"{language}.po")
    return own if language == "en" else {**texts("en"), **own}


def read_catalogue(path: Path) -> dict[str, str]:
    """Return the texts of a .po file by their keys: the part of the format that these catalogues use, without contexts.

    The standard library reads only compiled catalogues, which would have to be built for every checkout. Raises ValueError with file and
    line for anything else.
    """
    entries: list[list[str]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
        if line.startswith("#") or not line.strip():
            continue
        kind, _, quoted = ("", "", line) if line[0] == '"' else line.partition(" ")
        parts = len(entries[-1]) if entries else 0
        fits = {"msgid": parts != 1, "msgstr": parts == 1, "": parts > 0}.get(kind, False)
        if not fits or len(quoted) < 2 or quoted[0] != '"' or quoted[-1] != '"':
            raise ValueError(f"{path}:{number}: no key, text or comment of a catalogue: {line!r}")
        text = json.loads(quoted) if "\\" in quoted or '"' in quoted[1:-1] else quoted[1:-1]
        if kind == "msgid":
            entries.append([text])
        elif kind:
            entries[-1].append(text)
        else:
            entries[-1][-1] += text
    return {key: text for key, text in entries if key}


def plain(text: str) -> str:
    """Write numbers below ten million without a power of ten: 4380, not 4.38e+03; their digits stay as they were rounded."""
    return _POWER.sub(lambda found: f"{float(found[0]):.0f}", text) if "e+0" in text else text


_POWER = re.compile(r"(?<![\w.])\d(?:\.\d+)?e\+0[1-6](?!\d)")


def signs(text: str) -> str:
    """Write signs as people do where files and keys have letters of any machine: mm/s², ±."""
    return text.replace("mm/s2", "mm/s²").replace("+-", "±")


def decimal(language: str, printed: str) -> str:
    """Return a printed number with the decimal mark of the language."""
    return plain(printed).replace(".", texts(language)["number.decimal_mark"])


LAST_BITS = 1e-9
"""A length, an angle or a part of a quaternion below this is rounding: no rig measures picometres."""


def settled(value: float) -> float:
    """Return zero instead of the last bits of a computation, which differ between processors: 1e-17 mm."""
    return 0.0 if abs(value) < LAST_BITS else value


def number(language: str, value: float, form: str) -> str:
    """Return a number in a format, with the decimal mark of the language; a zero has no sign."""
    # Python's z comes behind fill, alignment and sign
    whole = form[-1:].lower() not in ("e", "f", "g", "%") or "z" in form
    return decimal(language, format(value, form if whole else _SIGN.sub(r"\g<0>z", form, count=1)))


_SIGN = re.compile(r"^(?:.?[<>=^])?[-+ ]?")


def numbers(language: str, values: Iterable[float], form: str) -> str:
    """Return coordinates or angles in a row; the mark between them differs from the decimal mark of the language."""
    return texts(language)["number.between"].join(number(language, settled(v), form) for v in values)


def typed(values: Iterable[float]) -> str:
    """Return numbers as people type them into a field or an option, in any language: 0,0,0,0,0,0,1."""
    return ",".join(number("en", settled(v), ".9g") for v in values)


@cache
def _form_of_count(language: str) -> Callable[[int], int]:
    """Return the rule that picks the form of a word by a count, which a catalogue states as gettext's plural expressions do."""
    return c2py(texts(language)["number.plural"])


class Writer(string.Formatter):
    """Put values into the texts of a language: numbers get its decimal mark, messages its words, and tuples of values become a list.

    A word follows a count by a field with the forms of the language: `{n} {n:pose|poses}`.
    """

    def __init__(self, language: str) -> None:
        self.language = language

    def format_field(self, value: Any, format_spec: str) -> str:
        """Return one value as text; a number that was read from a text keeps that text, and unknown ones are a dash."""
        if isinstance(value, tuple):
            several = [self.format_field(v, format_spec) for v in value]
            return (texts(self.language)["number.between"] if _are_numbers(value) else ", ").join(several)
        if value is None:
            return "–"
        if callable(getattr(value, "text", None)):
            return format(str(value.text(self.language)), format_spec)
        if "|" in format_spec:
            return format_spec.split("|")[_form_of_count(self.language)(int(value))]
        if format_spec[-1:] in "s<>^" or format_spec.lstrip("<>^").isdigit():
            return format(str(value), format_spec)
        return decimal(self.language, value) if isinstance(value, str) else number(self.language, value, format_spec)


def _are_numbers(values: tuple[Any, ...]) -> bool:
    return all(isinstance(value, float) for value in values)
