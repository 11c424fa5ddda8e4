"""Checked tables: models that refuse unknown keys, and pydantic's complaint as one line that names the key."""

import difflib
from collections.abc import Callable, Mapping
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from lmeasure.errors import FileFormatError

Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[^\s.,;\x00-\x1f]+$")]


def whole(value: Any) -> int:
    """A number of a file as an integer; ValueError (pydantic's) when it is none."""
    if isinstance(value, bool) or not (isinstance(value, int) or (isinstance(value, float) and value.is_integer())):
        raise ValueError("must be a whole number")
    return int(value)


Whole = Annotated[int, BeforeValidator(whole)]
"""A whole number; 6000.0 is one, true is not."""

_PLAIN = {
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be text",
    "bool_type": "must be true or false",
    "tuple_type": "must be an array",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "too_short": "must not be empty",
    "string_too_short": "must not be empty",
    "string_pattern_mismatch": "may hold no spaces, commas, points, semicolons or control characters",
    "finite_number": "must be a finite number",
    "path_type": "must be a path",
}
"""Pydantic's complaints in the words of the file."""

_UNITS = ("_m", "_cm", "_um", "_inch", "_in", "_rad", "_deg", "_mm", "_m_s")


class Strict(BaseModel):
    """A frozen table of a file. Unknown keys, numbers that are not finite, and text or true/false for a number are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, populate_by_name=True, strict=True)

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


def checked(
    data: Mapping[str, Any],
    model: type[Model],
    source: str,
    tables: Mapping[str, type[BaseModel]] | None = None,
    error: Callable[[str], Exception] = FileFormatError,
) -> Model:
    """The model of a file's content; the error, in one line, names source (the file), table, key, the value that is wrong and what it must
    be. tables: see `complaint`."""
    try:
        return model.model_validate(data, by_alias=True, by_name=False)
    except ValidationError as found:
        raise error(f"{source}: {complaint(found, data, model, tables or {})}") from None


def complaint(error: ValidationError, data: Any, root: type[BaseModel], tables: Mapping[str, type[BaseModel]]) -> str:
    """The first complaint of pydantic as one line that names the key as the file writes it.

    root is the model of the file and tables the models of its tables, by key or by `<key above> <key>`, for a hint where a key is unknown.
    """
    complaints = error.errors(include_url=False)
    # a key written wrongly is unknown and its right name missing: the first says what to do
    first = next((c for c in complaints if c["type"] == "extra_forbidden"), complaints[0])
    where: list[str] = []
    here = data
    for step in first["loc"]:
        if step in {"schema_", "from_point", "to_point", "passage", "[key]"}:
            continue
        if isinstance(here, dict) and isinstance(step, str) and step not in here and step != first["loc"][-1]:
            continue  # pydantic's own word for the chosen kind of table
        if isinstance(step, int) and isinstance(here, list) and step < len(here) and isinstance(here[step], dict):
            where.append(str(here[step].get("name", f"number {step + 1}")))
        elif isinstance(step, int):
            where.append(f"[{step}]")
        else:
            where.append(str(step))
        try:
            here = here[step]
        except (KeyError, IndexError, TypeError):
            here = None
    key = str(first["loc"][-1]) if first["loc"] else ""
    place = " ".join(where)
    if first["type"] == "extra_forbidden":
        owner = root
        path = [step for step in first["loc"][:-1] if isinstance(step, str)]
        for above, step in zip(["", *path], path, strict=False):
            owner = tables.get(f"{above} {step}", tables.get(step, owner))
        return f"{place}: unknown key {key!r}{_hint(key, owner)}"
    if first["type"] == "missing":
        return f"{place}: is missing"
    message = _PLAIN.get(first["type"], first["msg"].removeprefix("Value error, ").replace("Input should", "must"))
    shown = first.get("input")
    got = f" (got {shown!r})" if isinstance(shown, int | float | str) and len(repr(shown)) < 60 else ""
    return " ".join(f"{place}: {message}{got}".removeprefix(": ").split())


def _hint(key: str, owner: type[BaseModel]) -> str:
    known = [f.alias or name for name, f in owner.model_fields.items()]
    stem = key
    for unit in _UNITS:
        stem = stem.removesuffix(unit)
    same = [k for k in known if k.removesuffix("_mm").removesuffix("_deg").removesuffix("_mm_s") == stem]
    if same:
        return f"; the unit is part of the name: {same[0]!r}"
    close = difflib.get_close_matches(key, known, n=1)
    return f"; did you mean {close[0]!r}?" if close else f"; known here: {', '.join(known)}"
