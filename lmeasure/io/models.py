"""Checked tables: models that refuse unknown keys, and every fault of a file in a line with its place.

The file has been read as a whole before. Each of its statements is then read alone, again by tomllib: it is the fewest lines that are TOML,
and its content shows its key or table. This needs no grammar.
"""

import difflib
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import cached_property
from typing import Annotated, Any, Literal, TypeVar, get_args, get_origin

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.text import Message, composed, message

Keys = tuple[int | str, ...]
"""Path to a value of a document: keys of tables, numbers of elements from 0."""

MOST_READ = 20_000
"""Attempts after which keys that follow have no line: a statement of n lines takes n."""

_PART = r"""(?:[A-Za-z0-9_-]+|"[^"\n]*"|'[^'\n]*')"""
_DEEP = re.compile(rf"^[ \t]*+(?:\[{{1,2}}[ \t]*+)?{_PART}(?:[ \t]*+\.[ \t]*+{_PART}){{100}}", re.MULTILINE)
"""A key of more than a hundred parts, which no file has that a person wrote: reading it takes the square of their number."""

_LONG = re.compile(r"0[xob][0-9A-Fa-f_]{250}")
MOST_BITS = 1000


def loads(text: str) -> dict[str, Any]:
    """Return the content of a TOML text; ValueError, or RecursionError, for other texts, and for a key of more than a hundred parts."""
    if found := _DEEP.search(text):
        raise ValueError(f"a key has more than a hundred parts (at line {text.count(chr(10), 0, found.start()) + 1}, column 1)")
    content = tomllib.loads(text)
    if _LONG.search(text) and _longest(content) > MOST_BITS:
        raise ValueError("a number has more than a thousand bits")  # Python prints no number of 4300 digits
    return content


def _longest(value: Any) -> int:
    """Return the number of bits of the longest whole number in a document."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return max(map(_longest, inner), default=0) if not isinstance(value, int) else value.bit_length()


class Document(dict[str, Any]):
    """A TOML document that knows its text."""

    def __init__(self, content: dict[str, Any], text: str) -> None:
        super().__init__(content)
        self.text = text

    def holding(self, content: dict[str, Any]) -> "Document":
        """Other content with the same text, where its keys still have their lines."""
        return Document(content, self.text)

    @cached_property
    def _lines(self) -> dict[Keys, int]:
        return dict(reversed(list(_statements(self.text))))  # a table begins at its first line

    def line(self, keys: Keys) -> int | None:
        """The line, from 1, of the value, else of the innermost table around it that has one."""
        for end in range(len(keys), 0, -1):
            if keys[:end] in self._lines:
                return self._lines[keys[:end]]
        return None


def _statements(text: str) -> Iterator[tuple[Keys, int]]:
    """Keys of each statement, and of the tables that it begins, with its line."""
    lines = text.replace("\r\n", "\n").split("\n")
    counts: dict[Keys, int] = {}
    here: Keys = ()
    begin, attempts = 0, 0
    while begin < len(lines) and attempts < MOST_READ:
        end, found = begin, None
        while found is None and end < len(lines) and attempts < MOST_READ:
            end, attempts = end + 1, attempts + 1
            found = _read("\n".join(lines[begin:end]))
        head = lines[begin].lstrip()
        if head.startswith("["):
            here = _table(found or {}, head.startswith("[["), counts)
            for depth in range(1, len(here) + 1):
                yield here[:depth], begin + 1
        elif found:
            keys = (*here, *_chain(found))
            for depth in range(len(here) + 1, len(keys) + 1):
                yield keys[:depth], begin + 1
        begin = end


def _read(statement: str) -> dict[str, Any] | None:
    try:
        return tomllib.loads(statement)
    except (ValueError, RecursionError):
        return None


def _chain(found: dict[str, Any]) -> Keys:
    """The dotted key of one statement; an inline table is a value."""
    key, value = next(iter(found.items()))
    return (key, *_chain(value)) if isinstance(value, dict) and len(value) == 1 else (key,)


def _table(found: dict[str, Any], several: bool, counts: dict[Keys, int]) -> Keys:
    """The keys of a header's table; counts: how many of each array of tables have begun."""
    out: Keys = ()
    value: Any = found
    while value:
        if isinstance(value, list):
            value = value[0]
            continue
        key, value = next(iter(value.items()))
        out = (*out, key)
        if several and isinstance(value, list):
            counts[out] = counts.get(out, 0) + 1
        if out in counts:
            out = (*out, counts[out] - 1)
    return out


Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\s.,;\"\x00-\x1f]+$")]


def whole(value: Any) -> int:
    """A number of a file as an integer; ValueError (pydantic's) when it is none."""
    if isinstance(value, bool) or not (isinstance(value, int) or (isinstance(value, float) and value.is_integer())):
        raise ValueError(message("complaint.whole_number"))
    return int(value)


Whole = Annotated[int, BeforeValidator(whole)]
"""A whole number; 6000.0 is one, true is not."""

_PLAIN = {
    "float_type": "number",
    "int_type": "whole_number",
    "float_parsing": "number",
    "int_parsing": "whole_number",
    "int_from_float": "whole_number",
    "string_type": "text",
    "bool_type": "true_or_false",
    "tuple_type": "array",
    "dict_type": "table",
    "model_type": "table",
    "model_attributes_type": "table",
    "too_short": "too_few",
    "too_long": "too_many",
    "string_too_short": "empty",
    "string_pattern_mismatch": "name",
    "finite_number": "finite",
    "path_type": "path",
    "missing": "missing",
    "literal_error": "one_of",
    "greater_than": "more_than",
    "greater_than_equal": "at_least",
    "less_than": "less_than",
    "less_than_equal": "at_most",
}
"""Kinds of pydantic's complaints, by the ends of the ids of messages in the words of files (`complaint.number`)."""

_UNITS = ("_m", "_cm", "_um", "_inch", "_in", "_rad", "_deg", "_mm", "_m_s")
_OWN_WORDS = frozenset(("schema_", "from_point", "to_point", "from_pose", "to_pose", "passage", "passes", "[key]"))
"""Names in models for keys that are words of Python, and pydantic's mark of a key of a table that is wrong itself."""
_NAMED_BY = ("name", "channel", "point", "pose", "characteristic", "from")
"""Keys that identify one of several tables."""
MOST = 20
"""Complaints about one file that are reported."""


class Strict(BaseModel):
    """A frozen table of a file. Unknown keys, numbers that are not finite, and text or true/false for a number are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True, defer_build=True)

    @model_validator(mode="before")
    @classmethod
    def _arrays_are_tuples(cls, data: Any) -> Any:
        # files have only lists, frozen models only tuples: the one conversion that a strict model must not refuse
        return {key: _as_tuple(value) for key, value in data.items()} if isinstance(data, dict) else data


def _as_tuple(value: Any) -> Any:
    if isinstance(value, list):
        return tuple(_as_tuple(v) for v in value)
    # a table of arrays such as [tool]; tables of tables convert their own
    return {k: _as_tuple(v) for k, v in value.items()} if isinstance(value, dict) else value


Model = TypeVar("Model", bound=BaseModel)


class ContradictionError(ValueError):
    """Findings of a validator of a whole table: (keys that lead there from that table, the fault), several at once."""

    def __init__(self, found: Iterable[tuple[Keys, str]]) -> None:
        self.found = tuple(found)
        super().__init__("; ".join(text for _, text in self.found))


def of_key(key: str, text: str) -> ContradictionError:
    """Return a validator's finding for one key of a whole table."""
    return ContradictionError([((key,), text)])


def refuse(found: Iterable[tuple[Keys, str]]) -> None:
    """Raise ContradictionError where any was found."""
    contradictions = ContradictionError(found)
    if contradictions.found:
        raise contradictions


def checked(
    data: Mapping[str, Any],
    model: type[Model],
    source: str,
    error: Callable[[str], LMeasureError] = FileFormatError,
    *,
    also: Callable[[Mapping[str, Any]], Iterable[tuple[Keys, str]]] = lambda data: (),
) -> Model:
    """Return the model of a file's content. The error has a line for every fault: source (the file) and, if data come from
    `io.files.read_toml`, the line there; table, key, the required and the present value. also: faults of data that the model does not take,
    which its own validators of the whole check only if every part is right."""
    try:
        return model.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as found:
        every = (*complaints(found, data, model), *also(data))
        raise reported(source, data, _of_another_kind(every, data) or every, error) from None


def _of_another_kind(found: Iterable[tuple[Keys, str]], data: Mapping[str, Any]) -> list[tuple[Keys, str]]:
    """Return the complaint about the schema alone if the file is of another kind: all others follow from that."""
    stated = data.get("schema")
    return [one for one in found if one[0] == ("schema",)] if isinstance(stated, str) and stated.startswith("lmeasure.") else []


def reported(
    source: str, data: Any, found: Iterable[tuple[Keys, str]], error: Callable[[str], LMeasureError] = FileFormatError
) -> LMeasureError:
    """Return the error of complaints (keys that lead there, fault), in the order of the file's lines."""
    line_of = data.line if isinstance(data, Document) else lambda keys: None
    placed = sorted(((line_of(keys) or 0, shown_path(keys, data), text) for keys, text in found), key=_by_line)
    return gathered(source, [_placed(source, *one) for one in dict.fromkeys(placed)], error)


def _placed(source: str, line: int, path: str, text: str) -> str:
    where = "".join((source, f":{line}" if line else "", f": {path}" if path else ""))
    return composed("{where}: {text}", where=where, text=text)


def _by_line(placed: tuple[int, str, str]) -> int:
    return placed[0]


def gathered(source: str, lines: Sequence[str], error: Callable[[str], LMeasureError] = FileFormatError) -> LMeasureError:
    """One error of several lines, the first MOST of them."""
    out = error(lines[0])
    more = (message("complaint.more", source=source, count=len(lines) - MOST),) if len(lines) > MOST else ()
    out.complaints = (*lines[:MOST], *more)
    return out


def complaints(error: ValidationError, data: Any, root: type[BaseModel]) -> list[tuple[Keys, str]]:
    """Return pydantic's complaints as (keys in the file's form, fault)."""
    out: list[tuple[Keys, str]] = []
    hinted: set[Keys] = set()
    seen: set[Keys] = set()
    for one in error.errors(include_url=False):
        keys = _keys(one["loc"], data)
        raised = one.get("ctx", {}).get("error")
        if isinstance(raised, ContradictionError):
            out += [((*keys, *inner), text) for inner, text in raised.found]
        elif one["type"] == "extra_forbidden":
            owner = owner_of(root, one["loc"][:-1])
            key = str(one["loc"][-1])
            near = nearest(key, known_keys(owner))
            hinted.add((*keys[:-1], near))
            out.append((keys, message("complaint.unknown_key", key=key, hint=_hint(key, near, owner))))
        elif keys not in seen and not (one["type"] == "too_short" and _has_enough(_at(data, keys), one)):
            # pydantic reports a value that matches no kind once for each kind
            seen.add(keys)
            out.append(_plain(keys, one, data))
    # a key written wrongly is unknown, and its right name missing: once is enough
    missing = message("complaint.missing")
    return [(keys, _with_remedy(keys, text) if text == missing else text) for keys, text in out if text != missing or keys not in hinted]


def _with_remedy(keys: Keys, missing: str) -> str:
    of_a_drum = len(keys) > 1 and keys[0] == "observation_point" and keys[-1] == "drum"
    return message("complaint.missing_drum") if of_a_drum else missing


def _has_enough(value: Any, one: Any) -> bool:
    # pydantic does not count elements that are wrong themselves
    return isinstance(value, list | tuple | dict) and len(value) >= one["ctx"]["min_length"]


def complaint(one: Any) -> str:
    """One of pydantic's complaints about a value that was typed, in the words of files."""
    text = _plain((), one, None)[1]
    with_comma = one["type"] in ("float_parsing", "int_parsing") and "," in str(one.get("input"))
    return message("complaint.with_comma", text=text) if with_comma else text


def _plain(keys: Keys, one: Any, data: Any) -> tuple[Keys, str]:
    text = _words(one)
    if keys and isinstance(keys[-1], int) and isinstance(_at(data, keys[:-1]), list | tuple) and not isinstance(_at(data, keys), dict):
        text, keys = message("complaint.of_number", number=keys[-1] + 1, text=text), keys[:-1]
    value = one.get("input")
    is_shown = isinstance(value, int | float | str) and value != "" and len(repr(value)) < 60 and one["type"] != "missing"
    written = str(value).lower() if isinstance(value, bool) else repr(value)
    return keys, message("complaint.is", text=text, value=" ".join(written.split())) if is_shown else text


def _words(one: Any) -> str:
    """Return the fault of a value, in the words of files."""
    limits = {name: f"{value:g}" if isinstance(value, float) else value for name, value in one.get("ctx", {}).items()}
    raised, kind = limits.get("error"), _PLAIN.get(one["type"], "")
    if not kind:
        own = raised.args[0] if isinstance(raised, ValueError) and raised.args else ""
        return (
            own if isinstance(own, Message) else " ".join(one["msg"].removeprefix("Value error, ").replace("Input should", "must").split())
        )
    if kind == "more_than" and limits["gt"] in ("0", 0):
        kind = "positive"
    if kind == "too_few" and (limits["min_length"], limits["actual_length"]) == (1, 0):
        kind = "empty"
    return message(f"complaint.{kind}", **limits)


def _keys(loc: tuple[int | str, ...], data: Any) -> Keys:
    """Pydantic's location without its own words: for the chosen kind of a table, and for keys that are words of Python."""
    out: list[int | str] = []
    here = data
    for step in loc:
        missing = isinstance(here, dict) and isinstance(step, str) and step not in here
        if (step in _OWN_WORDS and missing) or (missing and step != loc[-1]) or (isinstance(step, str) and not isinstance(here, dict)):
            continue
        out.append(step)
        here = _at(here, (step,))
    return tuple(out)


def _at(data: Any, keys: Keys) -> Any:
    for key in keys:
        try:
            data = data[key]
        except (KeyError, IndexError, TypeError):
            return None
    return data


def shown_path(keys: Keys, data: Any) -> str:
    """Keys as a person reads them: `[observation_point B2].drum.scale`; one of several tables by its name, else by its number."""
    out, here = "", data
    for key in keys:
        if isinstance(key, int):
            at = here[key] if isinstance(here, list | tuple) and key < len(here) else None
            out = f"[{out.strip('[]').replace('].', '.')} {_called(here, key) if isinstance(at, dict) else key + 1}]"
        else:
            out = f"{out}.{key}" if out else key
        here = _at(here, (key,))
    return out


def _called(tables: list[Any], number: int) -> str:
    key = next((key for key in _NAMED_BY if key in tables[number]), "")
    name = tables[number].get(key)
    same = [t for t in tables if isinstance(t, dict) and t.get(key) == name]
    is_name = isinstance(name, str) and name.isprintable() and 0 < len(name) < 60 and len(same) == 1
    return str(name) if is_name else str(number + 1)


def known_keys(owner: type[BaseModel]) -> list[str]:
    """Keys of a table, as the file writes them, those included that other packages add (`further_keys`)."""
    return [*(f.alias or name for name, f in owner.model_fields.items()), *getattr(owner, "further_keys", tuple)()]


def nearest(key: str, known: list[str]) -> str:
    """The known key that was probably meant, empty where none is near."""
    same = [k for k in known if _stem(key) in _stems_of(k)]
    return next(iter(same or difflib.get_close_matches(key, known, n=1)), "")


def _hint(key: str, near: str, owner: type[BaseModel]) -> str:
    if not near:
        return message("complaint.known_keys", names=tuple(known_keys(owner)))
    return message("complaint.with_unit" if _stem(key) in _stems_of(near) else "complaint.did_you_mean", near=near)


def _stem(key: str) -> str:
    for unit in _UNITS:
        key = key.removesuffix(unit)
    return key


def _stems_of(known: str) -> tuple[str, ...]:
    return tuple(known.removesuffix(unit) for unit in ("_mm", "_deg", "_mm_s") if known.endswith(unit))


def owner_of(root: type[BaseModel], loc: tuple[int | str, ...]) -> type[BaseModel]:
    """The model of the table at a location of pydantic's, from the model of the file."""
    here = [root]
    for step in loc:
        if isinstance(step, int):
            continue
        inner = [f for model in here for name, f in model.model_fields.items() if step in (name, f.alias)]
        if inner:
            here = [m for f in inner for m in models_in(f.annotation)] or here
        else:
            # of several kinds of table, the one that states this word
            here = [m for m in here if any(step in literals_of(f.annotation) for f in m.model_fields.values())] or here
    return here[0]


def models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that an annotation speaks of."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for part in get_args(annotation):
        yield from models_in(part)


def literals_of(annotation: Any) -> tuple[Any, ...]:
    """The values that an annotation allows by name."""
    if get_origin(annotation) is Literal:
        return get_args(annotation)
    return tuple(value for part in get_args(annotation) for value in literals_of(part))
