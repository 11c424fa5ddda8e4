"""The command line's own words, help, messages and progress, in the language of the terminal: `locale/*/cli.po`, by their English text.

What computations say of data, and errors, which scripts and people look up, stay English.
"""

import os
import re
import string
from collections.abc import Iterator, Mapping
from functools import cache

from lmeasure.catalogue import LANGUAGES, texts

DOMAIN = "cli"
PLACES = "LANGUAGE", "LC_ALL", "LC_MESSAGES", "LANG"
"""Variables of the environment that name a language; the first that is not empty counts."""


def language(environment: Mapping[str, str] | None = None) -> str:
    """The language of the environment, English where it is none that has a catalogue."""
    known = os.environ if environment is None else environment
    named = next((known[place] for place in PLACES if known.get(place)), "")
    # LANGUAGE may name several, de:ru
    asked = (re.split(r"[._@]", one)[0].lower() for one in named.split(":"))
    return next((one for one in asked if one in LANGUAGES), "en")


def said(text: str, /, **values: object) -> str:
    """A text, or a template with its values, in the words of the terminal; as it is where the catalogue has none."""
    own = "en" if not text else language()
    found = text if own == "en" else texts(DOMAIN, own).get(text, text)
    return found.format(**values) if values else found


def retold(message: str) -> str:
    """A message of the parser, which is English, as one of the catalogue's templates has it."""
    own = language()
    if own == "en":
        return message
    known = texts(DOMAIN, own)
    if message in known:
        return known[message]
    for pattern, template in _patterns(own):
        found = pattern.fullmatch(message)
        if found is not None:
            return known[template].format(**found.groupdict())
    return message


@cache
def _patterns(own: str) -> tuple[tuple[re.Pattern[str], str], ...]:
    """What each template with values looks like when it is filled in, the most wordy first."""
    with_values = (key for key in texts(DOMAIN, own) if "{" in key)
    return tuple((re.compile("".join(_parts(key))), key) for key in sorted(with_values, key=len, reverse=True))


def _parts(template: str) -> Iterator[str]:
    for before, name, _, _ in string.Formatter().parse(template):
        yield re.escape(before)
        if name is not None:
            yield f"(?P<{name}>.+)"
