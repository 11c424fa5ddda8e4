"""Keep a computation's reports as ids and values until a face renders them in the reader's language.

Files, `--json` and certificates keep the English text; beside it `stated` and `table` keep ids and values, so that no text is read back.

Reasons why samples have no pose, or have one without a channel: (n,) arrays of messages, "" without one.
"""

import json
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from lmeasure.core import LMeasureError, SettingsError
from lmeasure.text.catalogue import Writer, plain, texts

if TYPE_CHECKING:
    from lmeasure.core import TextArray

JOINED = "joined"
"""Two messages, one behind the other."""


class Message(str):
    """An English text that knows its id (`code`) and values, and so its words in every language.

    It is a string, so that files, JSON and scripts have its English text without any conversion. Values are numbers, texts, other messages,
    or tuples of these; an error becomes its first message, a path its text. `template` is the English text of messages that no catalogue
    has, such as those of plug-ins.
    """

    code: str
    values: Mapping[str, Any]
    template: str

    def __new__(cls, code: str, values: Mapping[str, Any] | None = None, template: str = "") -> "Message":
        """Return the message of an id and values; KeyError where neither the catalogue nor the template has its text."""
        known = {key: _kept(value) for key, value in values.items()} if values else {}
        out = super().__new__(cls, plain(_filled("en", code, known, template)))
        out.code, out.values, out.template = code, known, template
        return out

    def text(self, language: str) -> str:
        """Return the message in the words of a language."""
        return str(self) if language == "en" else _filled(language, self.code, self.values, self.template)

    def stated(self) -> dict[str, Any]:
        """Return the English text, the id and the values, as JSON keeps them."""
        own = {"template": self.template} if self.template else {}
        return {"text": str(self), "code": self.code, "values": {key: _stated(value) for key, value in self.values.items()}, **own}

    def __getnewargs__(self) -> tuple[str, Mapping[str, Any], str]:  # type: ignore[override]
        return self.code, self.values, self.template

    def __repr__(self) -> str:
        return f"Message({self.code!r}, {dict(self.values)!r})"


def _kept(value: Any) -> Any:
    if isinstance(value, LMeasureError):
        return faults(value)[0]
    if isinstance(value, BaseException):
        return reason(value)
    return str(value) if isinstance(value, PurePath) else value


def reason(error: BaseException) -> str:
    """Return the message that an error of any kind was raised with; its text where that is none."""
    first = error.args[0] if error.args else ""
    return first if isinstance(first, Message) else str(error)


def faults(error: LMeasureError) -> tuple[str, ...]:
    """Return everything that is wrong, as messages where the catalogue has them; `error.lines` has the English lines."""
    if isinstance(error, SettingsError) and error.option:
        return (composed("{option}: {text}", option=error.option, text=error.text),)
    return error.complaints or tuple(error.args[:1]) or ("",)


def _filled(language: str, code: str, values: Mapping[str, Any], template: str) -> str:
    own = texts(language)
    text = own.get(code, template) if template else own[code]
    return Writer(language).vformat(text, (), values) if values else text


def message(code: str, /, **values: Any) -> Message:
    """Return the message of an id and values."""
    return Message(code, values)


def sentence(text: str, language: str) -> str:
    """Return a text in a language as a sentence by itself: with a capital letter, unless it begins with a value or a name."""
    said, first = text.text(language) if isinstance(text, Message) else text, text
    while isinstance(first, Message):
        own = texts(language).get(first.code, first.template)
        if (value := re.match(r"{(\w+)", own)) is None:
            return said[:1].upper() + said[1:] if re.match(r"[^\W\d_]+(?![\w.=/]| =)", own) else said
        first = first.values[value[1]]
    return said


def composed(template: str, /, **values: Any) -> Message:
    return Message("", values, template)


def count_of(kind: str, count: int) -> Message:
    """Return how many faults of a kind there were."""
    return message(f"fault.{kind}", count=count) if f"fault.{kind}" in texts("en") else composed("{n:d} {kind}", n=count, kind=kind)


def joined(messages: Iterable[str]) -> str:
    """Return messages one behind the other, with semicolons between them; empty where there are none."""
    out = ""
    for one in messages:
        out = message(JOINED, first=out, then=one) if out else one
    return out


def from_stated(stated: Mapping[str, Any]) -> Message | None:
    """Return the message that `Message.stated` wrote; None for anything else, such as the id of another version."""
    try:
        values = {key: _read(value) for key, value in stated["values"].items()}
        found = Message(stated["code"], values, stated.get("template", ""))
        return found if str(found) == stated["text"] else None
    except (KeyError, TypeError, ValueError, AttributeError, IndexError):
        return None


def _stated(value: Any) -> Any:
    if isinstance(value, Message):
        return value.stated()
    if hasattr(value, "item"):  # a number of numpy
        return value.item()
    return [_stated(v) for v in value] if isinstance(value, tuple | list) else value


def _read(value: Any) -> Any:
    if isinstance(value, dict):
        return from_stated(value) or value["text"]
    return tuple(_read(v) for v in value) if isinstance(value, list) else value


def table(texts_of: Any) -> list[dict[str, Any]]:
    """Return id and values of every message in a document of lists and dicts, once each, as a file keeps them beside its texts."""
    return [one.stated() for one in {str(one): one for one in _messages(texts_of)}.values()]


def restored(document: Any, stated: Iterable[Mapping[str, Any]]) -> Any:
    """Return a document in which each text that a table (`table`) has is the message again; all others stay the text they are."""
    return _replaced(document, {str(one): one for one in map(from_stated, stated) if one is not None})


def _messages(document: Any) -> Iterator[Message]:
    if isinstance(document, Message):
        yield document
    elif isinstance(document, Mapping):
        for value in document.values():
            yield from _messages(value)
    elif isinstance(document, list | tuple):
        for value in document:
            yield from _messages(value)


def _replaced(document: Any, known: Mapping[str, Message]) -> Any:
    if isinstance(document, str):
        return known.get(document, document)
    if isinstance(document, Mapping):
        return {key: _replaced(value, known) for key, value in document.items()}
    if isinstance(document, list | tuple):
        return type(document)(_replaced(value, known) for value in document)
    return document


class Versions(str):
    """An English text with its words in each language, of something that writes itself whole; a value of messages."""

    versions: Mapping[str, str]

    def __new__(cls, versions: Mapping[str, str]) -> "Versions":
        """Return the text of these versions, by language."""
        out = super().__new__(cls, versions["en"])
        out.versions = versions
        return out

    def text(self, language: str) -> str:
        """Return the text in a language."""
        return self.versions.get(language, str(self))

    def __getnewargs__(self) -> tuple[Mapping[str, str]]:  # type: ignore[override]
        return (self.versions,)


class Lines(str):
    """A text of several lines that are messages: `splitlines` gives them as they are."""

    lines: tuple[str, ...]

    def __new__(cls, lines: Iterable[str]) -> "Lines":
        """Return the text of these lines, each without a line break."""
        own = tuple(lines)
        out = super().__new__(cls, "\n".join(own))
        out.lines = own
        return out

    def splitlines(self, keepends: bool = False) -> list[str]:
        """Return the lines."""
        return super().splitlines(keepends) if keepends else list(self.lines)


Cause = str
"""A message, or the text of a file; empty where there is nothing to report."""


def and_also(causes: "TextArray", more: Message) -> "TextArray":
    """Return (n,) causes with a further one behind each."""
    return _each(causes, lambda cause: message(JOINED, first=cause, then=more), more)


def without(causes: "TextArray") -> "TextArray":
    """Return (n,) messages for good samples without the channels named by causes (n,)."""
    return _each(causes, lambda cause: message("cause.without", cause=cause), message("cause.without", cause=""))


def of_file(texts: "TextArray", stated: Iterable[Mapping[str, Any]]) -> "TextArray":
    """Return the causes (n,) of the texts of a file: messages where the file keeps their ids (`table`), else its texts."""
    known = {str(one): one for one in map(from_stated, stated) if one is not None}
    return _each(texts, lambda text: known.get(text, text), "")


def stated_causes(causes: "TextArray") -> "TextArray":
    """Return ids and values of causes (n,) as JSON, "" where there are none."""
    return _each(causes, lambda cause: json.dumps(cause.stated(), ensure_ascii=False) if isinstance(cause, Message) else "", "")


def first_cause(cause: Cause) -> Cause:
    """Return the first of several causes."""
    while isinstance(cause, Message) and cause.code == JOINED:
        cause = cause.values["first"]
    return cause


def is_of(cause: Cause, code: str) -> bool:
    """Return whether a cause, or the first of several, has this code."""
    first = first_cause(cause)
    return isinstance(first, Message) and first.code == code


def within(cause: Cause, code: str) -> Message | None:
    """The finding of a code that a cause is, or holds."""
    if not isinstance(cause, Message):
        return None
    if cause.code == code:
        return cause
    return next((found for value in cause.values.values() if (found := within(value, code)) is not None), None)


def common(n: int, cause: Cause) -> "TextArray":
    """Return the same cause for n samples, (n,); `np.full` and `np.where` would make a plain text of a single message."""
    import numpy as np

    out = np.empty(n, dtype=np.object_)
    out[:] = cause
    return out


def _each(causes: "TextArray", made: Callable[[Any], Cause], of_nothing: Cause) -> "TextArray":
    """Return the result of `made` for each cause, once for those that are the same object, as for many samples."""
    out = common(len(causes), of_nothing)
    at = (causes != "").nonzero()[0]
    kept: dict[int, Cause] = {}
    for i, cause in zip(at.tolist(), causes[at].tolist(), strict=True):
        if id(cause) not in kept:
            kept[id(cause)] = made(cause)
        out[i] = kept[id(cause)]
    return out
