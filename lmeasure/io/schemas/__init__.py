"""Files that users write: their models, JSON Schemas, and keys for the documentation.

`docs/write_keys.py` writes the schemas `NAME.json` beside this module. Editors use them to complete and check TOML by a first line such as
`#:schema schemas/rig.json` (taplo, Even Better TOML).
"""

import ast
import inspect
import json
import re
import textwrap
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from itertools import pairwise
from typing import Any, Union

from pydantic import BaseModel, TypeAdapter

from lmeasure.io.models import models_in
from lmeasure.text import message

DIALECT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True)
class Kind:
    """Kind of file: usual name, module and model of its content; others: modules and models for other values of its key
    `kind`."""

    file: str
    module: str
    model: str
    others: tuple[tuple[str, str], ...] = ()

    def load(self) -> tuple[type[BaseModel], ...]:
        """Return the models: one, and the others if there are any."""
        return tuple(getattr(import_module(module), model) for module, model in ((self.module, self.model), *self.others))


FILE_KINDS = {
    "rig": Kind("rig.toml", "lmeasure.rig.rig", "Rig"),
    "drums": Kind("drums.toml", "lmeasure.rig.drum_measurement", "DrumsFile"),
    "placement": Kind("placement.toml", "lmeasure.accuracy.placement", "Placement"),
    "bodies": Kind("bodies.toml", "lmeasure.accuracy.limits", "BodiesFile"),
    "run": Kind("run.toml", "lmeasure.recording.run", "RunFile"),
    "scenario": Kind("scenario.toml", "lmeasure.simulation.scenario", "Scenario"),
    "program": Kind("program.toml", "lmeasure.recording.program", "Program"),
    "details": Kind("details.toml", "lmeasure.certificate.details", "Details"),
    "robot": Kind(
        "robot.toml",
        "lmeasure.robots.robot",
        "Robot",
        (("lmeasure.robots.platform", "PlatformFile"), ("lmeasure.robots.parallel.file", "ParallelFile")),
    ),
    "structure": Kind("structure.toml", "lmeasure.structure.links", "StructureFile"),
}
"""Kinds of files by their names in `lmeasure schema`."""


def shipped(name: str) -> str:
    """Return the shipped JSON Schema of a kind of file; KeyError for an unknown kind."""
    if name not in FILE_KINDS:
        raise KeyError(name)
    return files("lmeasure.io.schemas").joinpath(f"{name}.json").read_text(encoding="utf-8")


def schema_of(name: str) -> dict[str, Any]:
    """Return the JSON Schema of the model, or of any of several models."""
    kind = FILE_KINDS[name]
    models = kind.load()
    for model in models:
        _describe(model)
    whole: Any = Union[models]  # noqa: UP007
    made = _plain(TypeAdapter(whole).json_schema(by_alias=True) if kind.others else models[0].model_json_schema(by_alias=True))
    return {"$schema": DIALECT, "$id": f"lmeasure/{name}", "title": f"{kind.file}: {message('schema.' + name)}"} | made


def _describe(model: type[BaseModel]) -> None:
    """Give the keys of a table, and of the tables in it, the docstrings below them as descriptions.

    Only schemas and the documentation need them; pydantic would read the source of every model in every process.
    """
    for _, one in reversed(list(tables_of(model))):
        for base in one.__mro__:
            if not issubclass(base, BaseModel) or base is BaseModel:
                continue
            (table,) = ast.parse(textwrap.dedent(inspect.getsource(base))).body
            for key, text in pairwise(table.body if isinstance(table, ast.ClassDef) else ()):
                match key, text:
                    case ast.AnnAssign(target=ast.Name(id=name)), ast.Expr(value=ast.Constant(value=str(words))) if (
                        name in base.model_fields
                    ):
                        one.model_fields[name].description = one.model_fields[name].description or inspect.cleandoc(words)
        one.model_rebuild(force=True)


def _plain(value: Any, properties: bool = False) -> Any:
    """Remove pydantic's titles, and write arrays of one type in the form of older schema readers."""
    if isinstance(value, list):
        return [_plain(one) for one in value]
    if not isinstance(value, dict):
        return value
    renamed = {} if properties else _AS_SCHEMA
    out = {renamed.get(key, key): _plain(one, key in ("properties", "$defs")) for key, one in value.items() if properties or key != "title"}
    items = out.get("prefixItems")
    if not properties and items and all(one == items[0] for one in items):
        del out["prefixItems"]
        out["items"] = items[0]
    if not properties and "patternProperties" in out:
        # a name that is none is refused
        out.setdefault("additionalProperties", False)
    if not properties and isinstance(out.get("description"), str):
        out["description"] = prose(out["description"])
    return out


def prose(docstring: str | None) -> str:
    """Return a docstring on one line, without its numpydoc sections."""
    return " ".join(re.split(r"^ *\w+\n *-{3,}$", docstring or "", maxsplit=1, flags=re.MULTILINE)[0].split())


def tables_of(model: type[BaseModel], path: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """Yield the tables of a file, itself first: path as in the table's header, and model."""
    yield path, model
    for name, field in model.model_fields.items():
        key = field.alias or name
        several = "tuple" in str(field.annotation)
        inner = f"{path}.{key}" if path else key
        for one in models_in(field.annotation):
            yield from tables_of(one, f"{inner.removesuffix('[]')}[]" if several else inner)


def keys_of(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """Return (key, type, default or "required", meaning) of a table's keys, required keys first."""
    _describe(model)
    schema: dict[str, Any] = _plain(model.model_json_schema(by_alias=True))
    if "$ref" in schema:
        schema = schema["$defs"][schema["$ref"].rpartition("/")[2]]
    required = set(schema.get("required", ()))
    # a schema that refers to another omits the field's own description
    texts = {f.alias or name: prose(f.description) for name, f in model.model_fields.items()}
    rows = [
        (key, _held(about), "required" if key in required else _default(about), texts[key]) for key, about in schema["properties"].items()
    ]
    return sorted(rows, key=lambda row: row[2] != "required")


def _default(about: dict[str, Any]) -> str:
    value = about.get("default")
    return "" if value is None or value in ([], {}) else json.dumps(value) if not isinstance(value, dict) else ""


def _held(about: dict[str, Any]) -> str:
    kinds = [one for one in about.get("anyOf", about.get("oneOf", [about])) if one.get("type") != "null"]
    return " or ".join(dict.fromkeys(_one_kind(one) for one in kinds))


def _one_kind(about: dict[str, Any]) -> str:
    if "const" in about or "enum" in about:
        return " or ".join(json.dumps(v) for v in about.get("enum", [about.get("const")]))
    kind = about.get("type")
    if "oneOf" in about or "anyOf" in about:
        return _held(about)
    if "$ref" in about:
        return "table"
    if kind in ("number", "integer"):
        words = "number" if kind == "number" else "whole number"
        return f"{words} {', '.join(f'{sign} {about[key]:.10g}' for key, sign in _LIMITS.items() if key in about)}".strip()
    if kind == "array":
        inner, count = about.get("items", {}), about.get("maxItems")
        if "prefixItems" in about:
            return f"[{', '.join(map(_held, about['prefixItems']))}]"
        if "$ref" in inner or "oneOf" in inner:
            return "tables"
        words = re.sub(r"^number\b", "numbers", _held(inner))
        return f"{count} {words}" if count and count == about.get("minItems") else f"array of {words}"
    if kind == "object":
        of_any = about.get("patternProperties", {})
        inner = next(iter(of_any.values()), about.get("additionalProperties"))
        return f"table of NAME = {_held(inner)}" if isinstance(inner, dict) else "table"
    return {"string": "text", "boolean": "true or false"}.get(str(kind), "anything")


_AS_SCHEMA = {"gt": "exclusiveMinimum", "ge": "minimum", "lt": "exclusiveMaximum", "le": "maximum"}
"""Names that pydantic keeps if a validator precedes the number."""
_LIMITS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
