"""Legacy: tells English sentences of told.po and cli.po again; goes when all are messages."""

import re
import string
from collections.abc import Callable, Mapping
from functools import cache, partial

from lmeasure.text.catalogue import LOCALE, Writer, decimal, plain, read_catalogue, texts
from lmeasure.text.messages import JOINED, Message

NUMBER = r"[-+]?\d[-+\d.e]*|nan|[-+]?inf"
WORD = "s"
KINDS = {"": ".+", WORD: r"\S+"}
TOLD = "told"


@cache
def old_texts(domain: str, language: str) -> Mapping[str, str]:
    path = LOCALE / language / f"{domain}.po"
    return read_catalogue(path) if path.is_file() else {}


def retold(domain: str, language: str, message: str, inner: Callable[[str], str] = str) -> str | None:
    """An English message as one of a domain's templates, whose keys are English, has it in a language; None where none fits.

    A value with the format s is one word, with any other format a number, which gets the language's decimal mark; one without a format may
    be a message itself, which `inner` tells.
    """
    catalogue = old_texts(domain, language)
    if message in catalogue:
        return catalogue[message]
    for pattern, template, kinds in _patterns(domain, language):
        found = pattern.fullmatch(message)
        if found is not None and not any(_BROKEN.match(value) for value in found.groupdict().values()):
            tell: dict[str, Callable[[str], str]] = {"": inner, WORD: str}
            values = {name: tell.get(kinds[name], partial(decimal, language))(value) for name, value in found.groupdict().items()}
            return Writer(language).vformat(catalogue[template], (), values)
    return None


_BROKEN = re.compile(r"[^(]*\).*\(", re.DOTALL)
"""No value of a template: it begins within brackets and ends within others, two values of a list with what stands between them."""


@cache
def _patterns(domain: str, language: str) -> tuple[tuple[re.Pattern[str], str, Mapping[str, str]], ...]:
    """What each template with values looks like when it is filled in, the most wordy first."""
    out = []
    for key in old_texts(domain, language):
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


_ONE = r"(?:[-+\d.e]+|nan|inf)"
NUMBERS = rf"{_ONE}(?:, {_ONE})*"
OTHERS = {"calibration", "structure", "comparison", "correction", "robot", "mechanism", "certify", "page"}
APART = {"workbench", "label", "certificate", "interim", "trajectory", "number", "cli", "rig_form"}
KEPT = {"zone.angle", "zone.radius", "zone.unknown"}


def recognised(text: str) -> Message | None:
    """The finding of an English text that comes out of a file, or from where no codes are kept; None where the catalogue has no such text.

    The patterns are made of the catalogue's own texts, the first that fits counts; numbers stay as they are printed.
    """
    # first, for a value of a text could hold a whole second one
    for mark in re.finditer("; ", text):
        first, then = recognised(text[: mark.start()]), recognised(text[mark.end() :])
        if first is not None and then is not None:
            return Message(JOINED, {"first": first, "then": then})
    for code, pattern, numbers in _recognisable():
        found = pattern.fullmatch(text)
        if found is not None:
            return Message(code, {k: v if k in numbers else _value(v) for k, v in found.groupdict().items()})
    return None


def _value(text: str) -> Message | tuple[Message, ...] | str:
    """What stands in a text: several findings in a row, one, or as it is."""
    parts = [recognised(part) for part in text.split(", ")]
    several = tuple(part for part in parts if part is not None)
    return several if len(several) == len(parts) > 1 else recognised(text) or text


@cache
def _recognisable() -> tuple[tuple[str, re.Pattern[str], frozenset[str]], ...]:
    """Codes, patterns of their English texts, and which of the values are numbers; what has no word of its own beside other texts cannot
    be told."""
    out = []
    for code, text in texts("en").items():
        if code.split(".")[0] in OTHERS | APART | {"zone"} and code not in KEPT:
            continue
        pattern, literal = "", ""
        numbers: dict[str, bool] = {}
        for before, name, spec, conversion in string.Formatter().parse(text):
            pattern, literal = pattern + re.escape(before), literal + before
            if name is not None:
                numbers[name] = bool(spec)
                value = f"(?P<{name}>{NUMBERS if spec else '.+'})"
                pattern += f"'{value}'" if conversion else value
        if all(numbers.values()) or any(map(str.isalpha, literal)):
            out.append((code, re.compile(pattern), frozenset(name for name, number in numbers.items() if number)))
    return tuple(out)


BETWEEN = "; ", ". ", ", "


def known(language: str, text: str) -> str:
    """A sentence of a computation in a language."""
    if isinstance(text, Message):
        return text.text(language)
    text = plain(text)
    return (_known(language, text) or text) if language != "en" and text else text


def _known(language: str, text: str) -> str | None:
    whole = retold(TOLD, language, text, partial(known, language))
    if whole is not None:
        return whole
    for mark in BETWEEN:
        parts_known = [_known(language, part) for part in text.split(mark)] if mark in text else []
        if parts_known and all(said is not None for said in parts_known):
            return mark.join(said for said in parts_known if said is not None)
    found = recognised(text)
    if found is not None:
        return found.text(language)
    for mark in BETWEEN:
        parts = [(part, _known(language, part)) for part in text.split(mark)] if mark in text else []
        if any(said is not None for _, said in parts):
            return mark.join(said or part for part, said in parts)
    return None


def pages(language: str) -> dict[str, str]:
    """Texts of pages in a language, by their English."""
    own = texts(language)
    return {text: own[key] for key, text in texts("en").items() if key.split(".")[0] in OTHERS | {"zone"} and key not in KEPT}
