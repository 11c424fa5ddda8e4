"""Schemas and lists of keys are those of the models, and what people write validates where the program reads it."""

import json
import sys
import tomllib
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import test_rig
from in_process import ran, refused

from lmeasure.core import LMeasureError
from lmeasure.io import FILE_KINDS, checked, shipped
from lmeasure.io.models import literals_of, models_in
from lmeasure.io.schemas import prose, schema_of, tables_of
from lmeasure.robots.robot import robot_from_dict

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
import write_keys  # noqa: E402

MOST_WORDS = 26
"""Of the text of a key, signs included."""


@pytest.mark.parametrize("name", FILE_KINDS)
def test_a_shipped_schema_is_that_of_the_model(name: str) -> None:
    text = (ROOT / "lmeasure" / "io" / "schemas" / f"{name}.json").read_text(encoding="utf-8")
    assert text == write_keys.schema_text(name) == shipped(name), "python docs/write_keys.py writes it anew"
    jsonschema.Draft202012Validator.check_schema(json.loads(text))


@pytest.mark.parametrize("page", write_keys.PAGES)
def test_a_page_lists_the_keys_of_the_models(page: str) -> None:
    text = (ROOT / "docs" / page).read_text(encoding="utf-8")
    assert text == write_keys.page(text), "python docs/write_keys.py writes it anew"
    for name in write_keys.PAGES[page]:
        assert f"<!-- keys of {name}," in text


def test_all_kinds_of_files_are_listed_and_every_key_is_explained() -> None:
    assert sorted(name for names in write_keys.PAGES.values() for name in names) == sorted(FILE_KINDS)
    for kind in FILE_KINDS.values():
        tables = [table for model in kind.load() for table in tables_of(model)]
        for path, model in tables:
            assert model.__doc__, path
            texts = {name: prose(field.description).split() for name, field in model.model_fields.items()}
            assert {name for name, words in texts.items() if not 0 < len(words) <= MOST_WORDS} == set(), f"{kind.file} [{path}]"
            inner = [m for f in model.model_fields.values() for m in models_in(f.annotation)]
            assert all(m in [t for _, t in tables] for m in inner)


def examples() -> list[tuple[str, Path]]:
    """Files of the repository that name a schema of ours."""
    kinds = {literals_of(kind.load()[0].model_fields["schema_"].annotation)[0]: name for name, kind in FILE_KINDS.items()}
    found = []
    for folder in ("calibration", "datasets", "tests/authorities/truth", "lmeasure"):
        for path in sorted((ROOT / folder).rglob("*.toml")):
            stated = tomllib.loads(path.read_text(encoding="utf-8")).get("schema")
            if stated in kinds:
                found.append((kinds[stated], path))
    return found


def validator(name: str) -> Any:
    return jsonschema.Draft202012Validator(json.loads(shipped(name)))


def read(name: str, content: dict[str, Any], source: str) -> None:
    """As the program reads it."""
    if name == "robot":
        robot_from_dict(content, source)
    else:
        checked(content, FILE_KINDS[name].load()[0], source)


def test_files_validate_where_they_are_read() -> None:
    seen = set()
    for name, path in examples():
        content = tomllib.loads(path.read_text(encoding="utf-8"))
        errors = [e.message for e in validator(name).iter_errors(content)]
        try:
            read(name, content, path.name)
        except LMeasureError:
            assert errors != [], path
        else:
            assert errors == [], path
            seen.add(name)
    assert {"rig", "run", "placement", "robot", "program"} <= seen


# what only a look at several keys at once, or at several files, can tell
BEYOND_A_SCHEMA = (
    "schema: is missing",
    "cable of one turn", "names no value", "no observation_point", "no point of", "another cable too", "another column", "is given",
    "numbered from 1", "length of at most", "printable", "finite number", "count_length_mm: must be a number",
)  # fmt: skip


def test_what_is_refused_does_not_validate() -> None:
    """Each wrong rig of tests/rig/test_rig.py but those that no schema can tell, as an editor would mark it."""
    marked = 0
    for change, line in test_rig.REFUSALS:
        content = test_rig.data()
        change(content)
        if not any(words in line for words in BEYOND_A_SCHEMA):
            assert not validator("rig").is_valid(content), line
            marked += 1
    assert marked > 30
    assert validator("rig").is_valid(test_rig.data())


def test_the_command_lists_prints_and_writes(tmp_path: Path) -> None:
    assert [line.split()[0] for line in ran("schema").splitlines()] == [*FILE_KINDS, "next:"]
    assert json.loads(ran("schema", "rig")) == schema_of("rig")
    out = tmp_path / "schemas" / "rig.json"
    ran("schema", "rig", "--out", out)
    assert json.loads(out.read_text()) == schema_of("rig")
    refused("schema", "rigg", code=2)
