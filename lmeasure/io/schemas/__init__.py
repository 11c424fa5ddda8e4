"""The files that a person writes: the model of each, its JSON Schema, and its keys as a document lists them.

The schemas lie beside this module as `NAME.json`, made of the models by `docs/write_keys.py`, for editors that complete and check TOML by a
first line such as `#:schema schemas/rig.json` (taplo, Even Better TOML).
"""

import json
import re
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from importlib.resources import files
from typing import Any, Union

from pydantic import BaseModel, TypeAdapter

from lmeasure.io.models import models_in

DIALECT = "https://json-schema.org/draft/2020-12/schema"


@dataclass(frozen=True)
class Kind:
    """A kind of file: the name it usually has, the model of its content, what it is; others: module and model where its key `kind` says
    that it holds something else."""

    file: str
    module: str
    model: str
    text: str
    others: tuple[tuple[str, str], ...] = ()

    def load(self) -> tuple[type[BaseModel], ...]:
        """The models, one but where there are others."""
        return tuple(getattr(import_module(module), model) for module, model in ((self.module, self.model), *self.others))


FILE_KINDS = {
    "rig": Kind("rig.toml", "lmeasure.rig.rig", "Rig", "the instrument: points, drums, cables"),
    "drums": Kind("drums.toml", "lmeasure.rig.drum_measurement", "DrumsFile", "what a mechanic measures on drums"),
    "placement": Kind("placement.toml", "lmeasure.accuracy.placement", "Placement", "a task, and where points may be put"),
    "bodies": Kind("bodies.toml", "lmeasure.accuracy.bodies", "BodiesFile", "what cables must not touch"),
    "run": Kind("run.toml", "lmeasure.recording.run", "RunFile", "a recorded run"),
    "scenario": Kind("scenario.toml", "lmeasure.simulation.scenario", "Scenario", "a motion to simulate"),
    "program": Kind("program.toml", "lmeasure.recording.program", "Program", "poses and paths that a robot is told to take"),
    "details": Kind("details.toml", "lmeasure.certificate.details", "Details", "what a report must say besides its figures"),
    "robot": Kind(
        "robot.toml",
        "lmeasure.robots.robot",
        "Robot",
        "a robot's joints, or its legs",
        (("lmeasure.robots.platform", "PlatformFile"), ("lmeasure.robots.parallel.file", "ParallelFile")),
    ),
    "structure": Kind("structure.toml", "lmeasure.structure.links", "StructureFile", "points and links of a mechanism"),
}
"""By the names that `lmeasure schema` takes."""


def shipped(name: str) -> str:
    """The JSON Schema of a kind of file, as it comes along; KeyError for what is none."""
    if name not in FILE_KINDS:
        raise KeyError(name)
    return files("lmeasure.io.schemas").joinpath(f"{name}.json").read_text(encoding="utf-8")


def schema_of(name: str) -> dict[str, Any]:
    """The JSON Schema that the model gives, or any of several."""
    kind = FILE_KINDS[name]
    models = kind.load()
    whole: Any = Union[models]  # noqa: UP007
    made = _plain(TypeAdapter(whole).json_schema(by_alias=True) if kind.others else models[0].model_json_schema(by_alias=True))
    return {"$schema": DIALECT, "$id": f"lmeasure/{name}", "title": f"{kind.file}: {kind.text}"} | made


def _plain(value: Any, properties: bool = False) -> Any:
    """Without pydantic's titles, and arrays of one kind said so that older readers of schemas understand them."""
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
        out["description"] = " ".join(out["description"].split())
    return out


def tables_of(model: type[BaseModel], path: str = "") -> Iterator[tuple[str, type[BaseModel]]]:
    """The tables of a file: the path of each, as its header writes it, and its model; the file itself first."""
    yield path, model
    for name, field in model.model_fields.items():
        key = field.alias or name
        several = "tuple" in str(field.annotation)
        inner = f"{path}.{key}" if path else key
        for one in models_in(field.annotation):
            yield from tables_of(one, f"{inner.removesuffix('[]')}[]" if several else inner)


def keys_of(model: type[BaseModel]) -> list[tuple[str, str, str, str]]:
    """(key, what it holds, its default or "needed", what it means) of a table's keys."""
    schema: dict[str, Any] = _plain(model.model_json_schema(by_alias=True))
    if "$ref" in schema:
        schema = schema["$defs"][schema["$ref"].rpartition("/")[2]]
    needed = set(schema.get("required", ()))
    # a schema that only points to another leaves out a description that is the other's own
    texts = {f.alias or name: " ".join((f.description or "").split()) for name, f in model.model_fields.items()}
    rows = [(key, _held(about), "needed" if key in needed else _default(about), texts[key]) for key, about in schema["properties"].items()]
    return sorted(rows, key=lambda row: row[2] != "needed")


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
        return " ".join([words, *(f"{sign} {about[key]:.10g}" for key, sign in _LIMITS.items() if key in about)])
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
"""What pydantic leaves as it is where a validator of ours stands before the number."""
_LIMITS = {"exclusiveMinimum": ">", "minimum": "≥", "exclusiveMaximum": "<", "maximum": "≤"}
