"""Return the texts of a page in its language, by their ids; numbers and signs as people write them."""

import re
from typing import Any

from lmeasure.text.catalogue import Writer, number, numbers, plain, signs, texts
from lmeasure.text.messages import Message, sentence


def powers(printed: str) -> str:
    """Write printed numbers with their powers of ten as people do: 4.3·10⁻¹³ for 4.3e-13."""
    return _EXPONENT.sub(lambda found: "·10" + (found[1].lstrip("+") + found[2]).translate(_RAISED), printed)


def typeset(text: str) -> str:
    """Write a line of a computation with signs as people do: powers, mm/s², ±, m³."""
    return signs(powers(text)).replace("m^3", "m³")


_EXPONENT = re.compile(r"(?<=\d)e([+-])0*(\d+)(?![\w.])")
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


class Say:
    """Writer of texts in a language: `say("page.residuals")`, `say("page.poses", n=7)`."""

    def __init__(self, language: str = "en") -> None:
        self.language = language
        self._texts = texts(language)
        self._writer = Writer(language)

    def __call__(self, code: str, /, **values: Any) -> str:
        """Return the text of an id with its values; numbers with the language's decimal mark."""
        text = self._texts[code]
        return powers(self._writer.vformat(text, (), values)) if values else text

    def number(self, value: float, form: str) -> str:
        """Return a number by itself; a zero has no sign."""
        return powers(number(self.language, value, form))

    def numbers(self, values: Any, form: str) -> str:
        """Return coordinates or angles in a row; the mark between them differs from the decimal mark."""
        return powers(numbers(self.language, values, form))

    def message(self, text: str) -> str:
        """Return a computation's report: a message in the language, any other text unchanged."""
        return typeset(text.text(self.language) if isinstance(text, Message) else plain(text))

    def sentence(self, text: str) -> str:
        """Return a computation's report as a sentence by itself."""
        return typeset(sentence(text, self.language) if isinstance(text, Message) else plain(text))


ENGLISH = Say()
