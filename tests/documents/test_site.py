"""The documentation site: its parts that come from the program, and that its index reaches every page.

The site itself is built with warnings as errors by .ci/run: a build takes half a minute.
"""

import ast
import json
import re
import sys
from pathlib import Path

import pytest

import lmeasure as lm
from lmeasure.core import Shown
from lmeasure.io import FILE_KINDS
from lmeasure.report.plots import DRAWN
from lmeasure.workflows import COMMANDS

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "docs"))
import generated_pages as pages  # noqa: E402 - it lies beside the pages

NOT_DRAWN = {"DrumMeasurement", "PoseCovariances", "Campaign", "CalibrationSettings", "CertificationSettings", "LMeasureError"} | {
    "Curve",
    "CurveStream",
    "Instants",
}
"""Settings, covariances, errors, and curves, which are drawn as trajectories."""


def source(page: Path) -> str:
    return page.read_text(encoding="utf-8")


def test_the_index_reaches_every_page() -> None:
    every, reached, left = pages.sources(), set(), [ROOT / "docs" / "README.md"]
    while left:
        page = left.pop()
        reached.add(page)
        name = page.relative_to(ROOT).with_suffix("").as_posix()
        listed = {(page.parent / f"{entry}.md").resolve() for entry in pages.entries(source(page))} if name in pages.INDEXES else set()
        left += listed - reached
    results = set((ROOT / "benchmarks" / "results").glob("*.md"))
    assert sorted(every - reached - results) == []
    assert "../benchmarks/results/*" in pages.completed("docs/results", "")


def test_each_page_belongs_to_one_part() -> None:
    listed = [(index, entry) for index in pages.INDEXES for entry in pages.entries(source(ROOT / f"{index}.md"))]
    parts = [entry for index, entry in listed if index in [f"docs/{part}" for part in pages.PARTS]]
    own = {"docs/start": 5, "docs/how-to": 15, "docs/reference": 8, "docs/explanation": 12}
    assert all(sum(index == part for index, _ in listed) >= least for part, least in own.items())
    assert sorted({entry for entry in parts if parts.count(entry) > 1}) == []


def test_every_public_name_is_in_the_reference() -> None:
    text = pages.names()
    shown = re.findall(r"^\.\. auto\w+:: lmeasure\.(\w+)$", text, re.MULTILINE)
    assert sorted(shown) == sorted(lm.__all__)


@pytest.mark.parametrize("name", lm.__all__)
def test_every_public_name_has_a_docstring_with_an_example(name: str) -> None:
    assert re.search(r"^\s*Examples\n\s*-+\n[\s\S]*>>> ", getattr(lm, name).__doc__ or "", re.MULTILINE), name


def test_every_command_is_in_the_reference_with_its_options() -> None:
    text = pages.commands()
    assert re.findall(r"^### (\S+)$", text, re.MULTILINE) == list(COMMANDS)
    assert "`--neighbourhood-mm NUMBER`\n: " in text


def test_every_schema_is_in_the_reference() -> None:
    shown = [json.loads(text) for text in re.findall(r"^```json\n(.*?)\n```$", pages.schemas(), re.MULTILINE | re.DOTALL)]
    assert [one["$id"] for one in shown] == [f"lmeasure/{name}" for name in FILE_KINDS]


def codes_with_a_remedy() -> set[str]:
    rows = re.findall(r"^\| (`[^|]+`) \| [^|]{8,} \| [^|]{3,} \|$", source(ROOT / "docs" / "troubleshooting.md"), re.MULTILINE)
    return {code for row in rows for code in re.findall(r"`([^`]+)`", row)}


def codes_of_findings() -> set[str]:
    """Codes of the warnings of a calibration, from the calls that make them."""
    out = set()
    for path in (ROOT / "lmeasure" / "calibration").rglob("*.py"):
        for call in ast.walk(ast.parse(source(path))):
            if isinstance(call, ast.Call) and getattr(call.func, "id", "") in ("Finding", "Hypothesis"):
                named = [word.value for word in call.keywords if word.arg == "code"] or call.args[:1]
                for one in named:
                    both = [one.body, one.orelse] if isinstance(one, ast.IfExp) else [one]
                    out |= {str(value.value) for value in both if isinstance(value, ast.Constant)}
    return out | {"assumed_position", "assumed_rotation"}  # written with the name of the uncertainty


def test_every_code_has_its_remedy() -> None:
    known = codes_with_a_remedy()
    findings = codes_of_findings()
    assert len(findings) > 20
    assert sorted(findings - known) == []
    assert sorted(code for code in pages.notes() if not pages.begins(code, known)) == []


def test_every_code_with_a_remedy_exists() -> None:
    known = {code for code in codes_with_a_remedy() if "." in code}
    exist = set(pages.notes())
    assert sorted(code for code in known if not any(pages.begins(one, [code]) for one in exist)) == []


def test_links_to_what_is_no_page_are_words_on_the_site() -> None:
    page = ROOT / "docs" / "page.md"
    text = "[notebooks](notebooks) [zone](zone.md#criteria) [origin](../tests/authorities/truth/README.md) ![cable](images/cable.svg)"
    assert pages.without_foreign_links(page, text) == "notebooks [zone](zone.md#criteria) origin ![cable](images/cable.svg)"


def test_nouns_print_and_plot() -> None:
    nouns = {name: kind for name in lm.__all__ if isinstance(kind := getattr(lm, name), type)}
    assert {name for name, kind in nouns.items() if kind not in DRAWN} == NOT_DRAWN
    for name, kind in nouns.items():
        if kind in DRAWN:
            assert issubclass(kind, Shown), name
            assert kind._repr_html_ is Shown._repr_html_, name
