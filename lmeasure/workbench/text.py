"""Words of the workbench's pages, by their ids."""

from lmeasure.core import LMeasureError
from lmeasure.text import LANGUAGES, Message, Writer, faults, reason, texts


def said(language: str, text: str, /, **values: object) -> str:
    """Return a message, or the text of an id with its values, in a language; anything else as it is."""
    if isinstance(text, Message):
        return text.text(language)
    found = texts(language).get(text, text)
    return Writer(language).vformat(found, (), values) if values else found


def why(language: str, error: BaseException) -> str:
    """Return the text of an error, in a language."""
    return said(language, faults(error)[0] if isinstance(error, LMeasureError) else reason(error))


def preferred(header: str) -> str:
    """Return the first language of a browser's Accept-Language that has a catalogue; English without one."""
    names = (part.split(";")[0].strip().split("-")[0].lower() for part in header.split(","))
    return next((name for name in names if name in LANGUAGES), "en")
