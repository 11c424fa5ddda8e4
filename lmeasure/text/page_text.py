"""The words of a page in its language. English is the source: a text stands in the code where it is said, and is the key of the catalogues
`locale/*/pages.po`; what a computation has said already, in English, is told again by the templates of `locale/*/told.po`."""

import re
from typing import Any

from lmeasure.text.catalogue import Writer, number, numbers, plain, retold, signs, texts
from lmeasure.text.messages import Finding, recognised

PAGES, TOLD = "pages", "told"
BETWEEN = "; ", ". ", ", "
"""What stands between parts that were told one by one."""


def powers(printed: str) -> str:
    """Printed numbers with their powers of ten as people write them: 4.3·10⁻¹³ for 4.3e-13."""
    return _EXPONENT.sub(lambda found: "·10" + (found[1].lstrip("+") + found[2]).translate(_RAISED), printed)


def typeset(text: str) -> str:
    """A line of a computation with signs as people write them: powers, mm/s², ±, m³."""
    return signs(powers(text)).replace("m^3", "m³")


_EXPONENT = re.compile(r"(?<=\d)e([+-])0*(\d+)(?![\w.])")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Say:
    """Says texts in a language: `say("Residuals")`, `say("{n} poses", n=7)`."""

    def __init__(self, language: str = "en") -> None:
        self.language = language
        self._own = {} if language == "en" else texts(PAGES, language)
        self._writer = Writer(language)

    def __call__(self, text: str, /, **values: Any) -> str:
        """A text of the code, or a template with its values; numbers with the language's decimal mark."""
        said = self._own.get(text, text)
        return powers(self._writer.vformat(said, (), values)) if values else said

    def number(self, value: float, form: str) -> str:
        """A number by itself; a zero has no sign."""
        return powers(number(self.language, value, form))

    def numbers(self, values: Any, form: str) -> str:
        """Coordinates or angles in a row, between which the decimal mark does not stand."""
        return powers(numbers(self.language, values, form))

    def told(self, text: str | Finding) -> str:
        """What a computation said; as it is where the language has no words for it."""
        if isinstance(text, Finding):
            return typeset(text.text(self.language))
        text = plain(text)
        if self.language == "en" or not text:
            return typeset(text)
        return typeset(self._known(text) or text)

    def _known(self, text: str) -> str | None:
        whole = retold(TOLD, self.language, text, self.told)
        if whole is not None:
            return whole
        # a list of which each part is known, before what takes a whole list for one value
        for mark in BETWEEN:
            known = [self._known(part) for part in text.split(mark)] if mark in text else []
            if known and all(said is not None for said in known):
                return mark.join(said for said in known if said is not None)
        found = recognised(text)
        if found is not None:
            return found.text(self.language)
        for mark in BETWEEN:
            parts = [(part, self._known(part)) for part in text.split(mark)] if mark in text else []
            if any(said is not None for _, said in parts):
                return mark.join(said or part for part, said in parts)
        return None


ENGLISH = Say()
