"""Texts by key in the languages that people read: gettext catalogues of this package, `locale/LANGUAGE/DOMAIN.po`."""

import json
import os
import re
import string
from collections.abc import Callable, Iterable, Mapping
from functools import cache, partial
from pathlib import Path
from typing import Any

LANGUAGES = ("en", "ru")
LOCALE = Path(__file__).parent / "locale"
DECIMAL_MARK = {"en": ".", "ru": ","}  # GOST R 1.5
BETWEEN_NUMBERS = {"en": ", ", "ru": "; "}
NUMBER = r"[-+]?\d[-+\d.e]*|nan|[-+]?inf"
WORD = "s"
KINDS = {"": ".+", WORD: r"\S+"}
"""What a value of a template may be, by its format; of any other it is a number."""
PLACES = "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"
"""Variables of the environment that name a language; the first that is not empty counts."""


def of_terminal(environment: Mapping[str, str] | None = None) -> str:
    """The language of the environment, English where it is none that has a catalogue."""
    known = os.environ if environment is None else environment
    named = next((known[place] for place in PLACES if known.get(place)), "")
    # LANGUAGE may name several, de:ru
    asked = (re.split(r"[._@]", one)[0].lower() for one in named.split(":"))
    return next((one for one in asked if one in LANGUAGES), "en")


@cache
def texts(domain: str, language: str) -> Mapping[str, str]:
    """Return all texts of a domain by their keys, in the order of the catalogue."""
    return read_catalogue(LOCALE / language / f"{domain}.po")


_LINE = re.compile(r'(?:(msgid|msgstr) )?(".*")|#.*|\s*')


def read_catalogue(path: Path) -> dict[str, str]:
    """Return the texts of a .po file by their keys: the part of the format that these catalogues use, without contexts and plurals.

    The standard library reads only compiled catalogues, which would have to be built for every checkout. Raises ValueError with file and
    line for anything else.
    """
    entries: list[list[str]] = []
    for number, line in enumerate(path.read_text(encoding="utf-8").split("\n"), 1):
        found, parts = _LINE.fullmatch(line), len(entries[-1]) if entries else 0
        if found is None or (found[2] and not {"msgid": parts != 1, "msgstr": parts == 1, None: parts > 0}[found[1]]):
            raise ValueError(f"{path}:{number}: no key, text or comment of a catalogue: {line!r}")
        if not found[2]:
            continue
        text = json.loads(found[2])
        if found[1] == "msgid":
            entries.append([text])
        elif found[1]:
            entries[-1].append(text)
        else:
            entries[-1][-1] += text
    return {key: text for key, text in entries if key}


def plain(text: str) -> str:
    """A text whose numbers below ten million have no power of ten: 4380, not 4.38e+03; its digits stay as they were rounded."""
    return _POWER.sub(lambda found: f"{float(found[0]):.0f}", text) if "e+0" in text else text


_POWER = re.compile(r"(?<![\w.])\d(?:\.\d+)?e\+0[1-6](?!\d)")


def signs(text: str) -> str:
    """A text whose signs are those that people write, where files and keys have letters of any machine: mm/s², ±."""
    return text.replace("mm/s2", "mm/s²").replace("+-", "±")


def decimal(language: str, printed: str) -> str:
    """A printed number with the decimal mark of the language."""
    return plain(printed).replace(".", DECIMAL_MARK[language])


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
    """Return coordinates or angles in a row, between which the decimal mark of the language does not stand."""
    return BETWEEN_NUMBERS[language].join(number(language, settled(v), form) for v in values)


def typed(values: Iterable[float]) -> str:
    """Return numbers as people type them into a field or an option, in any language: 0,0,0,0,0,0,1."""
    return ",".join(number("en", settled(v), ".9g") for v in values)


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
        if format_spec in ("", WORD):
            return str(value)
        return decimal(self.language, value) if isinstance(value, str) else number(self.language, value, format_spec)


def retold(domain: str, language: str, message: str, inner: Callable[[str], str] = str) -> str | None:
    """An English message as one of a domain's templates, whose keys are English, has it in a language; None where none fits.

    A value with the format s is one word, with any other format a number, which gets the language's decimal mark; one without a format may
    be a message itself, which `inner` tells.
    """
    known = texts(domain, language)
    if message in known:
        return known[message]
    for pattern, template, kinds in _patterns(domain, language):
        found = pattern.fullmatch(message)
        if found is not None and not any(_BROKEN.match(value) for value in found.groupdict().values()):
            tell: dict[str, Callable[[str], str]] = {"": inner, WORD: str}
            values = {name: tell.get(kinds[name], partial(decimal, language))(value) for name, value in found.groupdict().items()}
            return Writer(language).vformat(known[template], (), values)
    return None


_BROKEN = re.compile(r"[^(]*\).*\(", re.DOTALL)
"""No value of a template: it begins within brackets and ends within others, two values of a list with what stands between them."""


@cache
def _patterns(domain: str, language: str) -> tuple[tuple[re.Pattern[str], str, Mapping[str, str]], ...]:
    """What each template with values looks like when it is filled in, the most wordy first."""
    out = []
    for key in texts(domain, language):
        pattern, literal = "", 0
        kinds: dict[str, str] = {}
        for before, name, spec, _ in string.Formatter().parse(key):
            pattern, literal = pattern + re.escape(before), literal + len(before)
            if name is not None:
                pattern += f"(?P<{name}>{KINDS.get(spec or '', NUMBER)})"
                kinds[name] = spec or ""
        if kinds:
            out.append((literal, (re.compile(pattern, re.DOTALL), key, kinds)))
    return tuple(each for _, each in sorted(out, key=lambda found: -found[0]))
