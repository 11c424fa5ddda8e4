"""Reasons why samples have no pose, or have one without a channel: (n,) arrays of messages, "" without one."""

import json
from collections.abc import Callable, Iterable, Mapping
from typing import Any

import numpy as np

from lmeasure.core import TextArray
from lmeasure.text.messages import JOINED, Message, from_stated, message

Cause = str
"""A message, or the text of a file; empty where there is nothing to report."""


def and_also(causes: TextArray, more: Message) -> TextArray:
    """Return (n,) causes with a further one behind each."""
    return _each(causes, lambda cause: message(JOINED, first=cause, then=more), more)


def without(causes: TextArray) -> TextArray:
    """Return (n,) messages for good samples without the channels named by causes (n,)."""
    return _each(causes, lambda cause: message("cause.without", cause=cause), message("cause.without", cause=""))


def of_file(texts: TextArray, stated: Iterable[Mapping[str, Any]]) -> TextArray:
    """Return the causes (n,) of the texts of a file: messages where the file keeps their ids (`table`), else its texts."""
    known = {str(one): one for one in map(from_stated, stated) if one is not None}
    return _each(texts, lambda text: known.get(text, text), "")


def stated_causes(causes: TextArray) -> TextArray:
    """Return ids and values of causes (n,) as JSON, "" where there are none."""
    return _each(causes, lambda cause: json.dumps(cause.stated(), ensure_ascii=False) if isinstance(cause, Message) else "", "")


def said_first(cause: Cause) -> Cause:
    """Return the first of several causes."""
    while isinstance(cause, Message) and cause.code == JOINED:
        cause = cause.values["first"]
    return cause


def is_of(cause: Cause, code: str) -> bool:
    """Return whether a cause, or the first of several, has this code."""
    first = said_first(cause)
    return isinstance(first, Message) and first.code == code


def within(cause: Cause, code: str) -> Message | None:
    """The finding of a code that a cause is, or holds."""
    if not isinstance(cause, Message):
        return None
    if cause.code == code:
        return cause
    return next((found for value in cause.values.values() if (found := within(value, code)) is not None), None)


def common(n: int, cause: Cause) -> TextArray:
    """Return the same cause for n samples, (n,); `np.full` and `np.where` would make a plain text of a single message."""
    out = np.empty(n, dtype=np.object_)
    out[:] = cause
    return out


def _each(causes: TextArray, made: Callable[[Any], Cause], of_nothing: Cause) -> TextArray:
    """Return the result of `made` for each cause, once for those that are the same object, as for many samples."""
    out = common(len(causes), of_nothing)
    at = np.flatnonzero(causes != "")
    kept: dict[int, Cause] = {}
    for i, cause in zip(at.tolist(), causes[at].tolist(), strict=True):
        if id(cause) not in kept:
            kept[id(cause)] = made(cause)
        out[i] = kept[id(cause)]
    return out
