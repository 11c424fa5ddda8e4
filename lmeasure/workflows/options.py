"""Options of settings as texts: on a command line, in a form, in a request. One place for every face."""

import re
import types
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, NamedTuple, Union, get_args, get_origin

from annotated_types import Ge, Le

from lmeasure.text import Message, texts
from lmeasure.workflows.registry import help_of, panel_of
from lmeasure.workflows.settings import Pose, Separated, Turned, said_of, unit_of

if TYPE_CHECKING:
    from pydantic.fields import FieldInfo

    from lmeasure.workflows.settings import CommandSettings


class Written(NamedTuple):
    """Form of an option: its kind in that form, where a tuple is one text and a choice a word; whether it is optional; whether it may be
    repeated; its default in the same form; its choices."""

    kind: Any
    optional: bool
    repeated: bool
    default: Any
    choices: tuple[str, ...]


def written(field: "FieldInfo") -> Written:
    """Return how an option is written."""
    default = field.default
    optional = get_origin(field.annotation) in (Union, types.UnionType)
    kind, marks = _marks(field)
    separated = next((mark for mark in marks if isinstance(mark, Separated)), None)
    if separated is not None:
        default = None if field.is_required() or default is None else separated.written(default)
        return Written(str, optional or default == "", False, default, ())
    if get_origin(kind) is Literal:
        return Written(str, optional, False, default, tuple(str(word) for word in get_args(kind)))
    if get_origin(kind) is tuple and get_args(kind)[-1] is Ellipsis:
        return Written(get_args(kind)[0], not field.is_required(), True, None, ())
    return Written(kind, optional, False, default, ())


def _marks(field: "FieldInfo") -> tuple[Any, list[Any]]:
    """Return the type of an option without None, and its marks."""
    annotation: Any = field.annotation
    one = next((part for part in get_args(annotation) if part is not type(None)), annotation)
    kind: Any = one if get_origin(annotation) in (Union, types.UnionType) else annotation
    marks = list(field.metadata)
    if get_origin(kind) is Annotated:
        kind, *inner = get_args(kind)
        marks += inner
    return kind, marks


def rows_of_numbers(settings: "type[CommandSettings]") -> dict[str, Pose | Separated]:
    """Return the marks of the options that take a row of numbers, by their flags."""
    out: dict[str, Pose | Separated] = {}
    for name, field in settings.model_fields.items():
        for mark in _marks(field)[1]:
            if isinstance(mark, Pose) or (type(mark) in (Separated, Turned) and mark.mark == ","):
                out[flag_of(name, field)] = mark
    return out


def with_commas(words: Sequence[str], rows: Mapping[str, Pose | Separated]) -> list[str]:
    """The words of a command line, in which a row of numbers may have blanks between them: `--position-mm 0 0 -5` as 0,0,-5."""
    out: list[str] = []
    i = 0
    while i < len(words):
        flag, given, first = words[i].partition("=")
        i += 1
        if words[i - 1] == "--":
            return [*out, *words[i - 1 :]]
        out.append(words[i - 1])
        if flag not in rows:
            continue
        row = [first] if given else []
        while i < len(words) and _are_numbers([*row, words[i]], rows[flag]):
            row.append(words[i])
            i += 1
        if len(row) > 1:
            out[-1] = f"{flag}={_joined(row)}"
        elif row and not given:
            out.append(row[0])
    return out


def _joined(words: Sequence[str]) -> str:
    return ",".join(word.strip(",") for word in words).replace(":,", ":")


def _are_numbers(words: Sequence[str], mark: Pose | Separated) -> bool:
    """Return whether the words are the first of a row: numbers, or three angles behind the name of their convention."""
    text, most = _joined(words), mark.count
    if isinstance(mark, Turned) and (named := re.match(r"[A-Za-z][\w-]*:", text)):
        text, most = text[named.end() :], 3
        if not text:
            return True
    parts = text.split(",")
    with suppress(ValueError):
        return bool([float(part) for part in parts]) and (most is None or len(parts) <= most)
    return False


def fields_of(settings: "type[CommandSettings]") -> dict[str, "FieldInfo"]:
    """Return all options of a command by their names, its own first and those that all commands share behind them."""
    shared = [name for name in settings.model_fields if name not in settings.__annotations__]
    return {name: field for name, field in settings.model_fields.items() if name not in shared} | {
        name: settings.model_fields[name] for name in shared
    }


def flag_of(name: str, field: "FieldInfo") -> str:
    """The option as it is typed; an argument by its place-holder."""
    said = said_of(field)
    return str(said["metavar"] if "positional" in said else said.get("flag", f"--{name.replace('_', '-')}"))


SHORT = {"--out": "-o", "--force": "-f"}


def other_flags(name: str, field: "FieldInfo") -> list[str]:
    """Return the other flags of an option, or of an argument that was an option."""
    short = SHORT.get(flag_of(name, field))
    return [*([short] if short else []), *said_of(field).get("also", ())]


def former_options(settings: "type[CommandSettings]") -> frozenset[str]:
    """Return the options that are arguments of the command now."""
    return frozenset(
        flag for name, field in settings.model_fields.items() if "positional" in said_of(field) for flag in other_flags(name, field)
    )


def as_arguments(words: Sequence[str], former: Iterable[str]) -> list[str]:
    """Return the words of a command line without the flags of these options, so that their values are arguments: `--rig FILE` as FILE."""
    out: list[str] = []
    for i, word in enumerate(words):
        if word == "--":
            return [*out, *words[i:]]
        flag, equals, value = word.partition("=")
        out += [word] if flag not in former else [value] if equals else []
    return out


def limits_of(field: "FieldInfo") -> tuple[float | None, float | None]:
    """Least and largest value, both allowed; None without one."""
    said = said_of(field)
    low = next((float(m.ge) for m in field.metadata if isinstance(m, Ge)), said.get("minimum"))  # type: ignore[arg-type]
    high = next((float(m.le) for m in field.metadata if isinstance(m, Le)), said.get("maximum"))  # type: ignore[arg-type]
    return low, high


class Option(NamedTuple):
    """An option for a form: its name, its label, and the data of a field and a help text. kind: flag, choice, list, path, whole, number, or
    text."""

    name: str
    label: Message
    flag: str
    help: Message
    unit: str
    panel: str
    kind: str
    choices: tuple[str, ...]
    minimum: float | None
    maximum: float | None
    default: str
    required: bool
    metavar: str


def options_of(settings: "type[CommandSettings]") -> tuple[Option, ...]:
    """Return all options of a command, in their order."""
    command = re.sub(r"(?<!^)(?=[A-Z])", "-", settings.__name__.removesuffix("Settings")).lower()
    return tuple(_option(command, name, field) for name, field in fields_of(settings).items())


def _label(command: str, name: str) -> Message:
    known = texts("en")
    ids = (one for one in (f"label.{command}.{name}", f"label.{name}") if one in known)
    return Message(next(ids, ""), template=name.replace("_", " ").capitalize())


def _option(command: str, name: str, field: "FieldInfo") -> Option:
    form, said = written(field), said_of(field)
    kinds = {bool: "flag", Path: "path", int: "whole", float: "number"}
    kind = "list" if form.repeated else "choice" if form.choices else kinds.get(form.kind, "text")
    plain = form.default is None or field.is_required() or kind in ("flag", "list")
    default = "" if plain else f"{form.default:g}" if isinstance(form.default, float) else str(form.default)
    if kind == "flag" and form.default is True:
        default = "on"
    return Option(
        name=name,
        label=_label(command, name),
        flag=flag_of(name, field),
        help=help_of(command, name, field.description or ""),
        unit=unit_of(name, field),
        panel=panel_of(said["panel"]) if "panel" in said else "",
        kind=kind,
        choices=form.choices,
        minimum=limits_of(field)[0],
        maximum=limits_of(field)[1],
        default=default,
        required=field.is_required(),
        metavar=str(said.get("metavar", "")),
    )


def command_line(command: str, settings: "type[CommandSettings]", given: Mapping[str, Any]) -> list[str]:
    """The words after `lmeasure` that ask the same; given are values by name: texts as they are typed, True and False, several texts."""
    arguments, words = [], []
    for option in options_of(settings):
        value = given.get(option.name)
        if value is None or value == "" or value == [] or (option.kind != "flag" and str(value) == option.default):
            continue
        positional = "positional" in said_of(settings.model_fields[option.name])
        if option.kind == "flag":
            words += _switched(option, value in (True, "on", "true", "1"))
        elif positional:
            arguments += [str(one) for one in value] if _several(value) else [str(value)]
        else:
            # a value that begins with a minus is no option
            words += [part for one in (value if _several(value) else [value]) for part in _pair(option.flag, str(one))]
    behind = ["--", *arguments] if any(a.startswith("-") for a in arguments) else arguments
    return [command, *words, *behind] if behind[:1] == ["--"] else [command, *arguments, *words]


def _several(value: Any) -> bool:
    return isinstance(value, Sequence) and not isinstance(value, str)


def _pair(flag: str, value: str) -> list[str]:
    return [f"{flag}={value}"] if value.startswith("-") else [flag, value]


def _switched(option: Option, on: bool) -> list[str]:
    """The word that switches a flag to another state than its default."""
    yes, _, no = option.flag.partition("/")
    if on == (option.default == "on"):
        return []
    return [yes] if on else [no or yes.replace("--", "--no-", 1)]
