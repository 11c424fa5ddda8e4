"""The words of a certificate in the languages it can be printed in; names, numbers and units as each writes them."""

import re
from typing import Any

from lmeasure.text import Say, Writer, texts


def word(language: str, key: str, **values: Any) -> str:
    """The text of a key in a language, with values put in as they are."""
    text = texts(language)[f"certificate.{key}"]
    return Writer(language).vformat(text, (), values) if values else text


_SYMBOL = re.compile(r"(?<!\w)(?:([vd]?[AR]P|[AR]D|[AR]T|[Ct])_(p|l|x|y|z|a|b|c|s|min|rot)|(U)(95))(?!\w)")


def with_indices(text: str) -> list[tuple[str, str]]:
    """A text in pieces (plain, index): symbols such as AP_p and U95 are set as AP and U with an index behind them."""
    out, end = [], 0
    for found in _SYMBOL.finditer(text):
        stem, index = (group for group in found.groups() if group is not None)
        out.append((text[end : found.start()] + stem, index))
        end = found.end()
    return [*out, (text[end:], "")] if end < len(text) or not out else out


def axes(say: Say) -> dict[str, Any]:
    """Return the axes of a drawing in the base frame."""
    return {"xaxis_title": say("page.x_mm"), "yaxis_title": say("page.y_mm"), "zaxis_title": say("page.z_mm"), "aspectmode": "data"}


def unit(language: str, symbol: str) -> str:
    """A unit as the language writes it."""
    return texts(language).get(f"certificate.unit.{symbol}", symbol)
