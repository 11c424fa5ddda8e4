"""The words of a certificate in the languages it can be printed in, `locale/*/report.po`; names, numbers and units as each writes them."""

from collections.abc import Iterable
from typing import Any

from lmeasure.catalogue import decimal, texts

DOMAIN = "report"
BETWEEN_NUMBERS = {"en": ", ", "ru": "; "}
THOUSANDS = {"en": ",", "ru": "\u00a0"}
UNITS = {
    "ru": {"kg": "кг", "mm": "мм", "deg": "°", "s": "с", "%": "%", "mm/s": "мм/с", "mm/N": "мм/Н", "Hz": "Гц", "rad": "рад", "ms": "мс"},
    "en": {"deg": "°"},
}


def word(language: str, key: str, **values: Any) -> str:
    """The text of a key in a language, with values put in as they are."""
    text = texts(DOMAIN, language)[key]
    return text.format(**values) if values else text


def characteristic_name(language: str, name: str) -> str:
    """What a characteristic such as AP_p is called; empty where the table has no name for it."""
    words = texts(DOMAIN, language)
    stem = name if f"name.{name}" in words else name.split("_")[0]
    return words.get(f"name.{stem}", "")


def numbers(language: str, printed: Iterable[str]) -> str:
    """Printed numbers in a row."""
    return BETWEEN_NUMBERS[language].join(decimal(language, one) for one in printed)


def unit(language: str, symbol: str) -> str:
    """A unit as the language writes it."""
    return UNITS[language].get(symbol, symbol)
