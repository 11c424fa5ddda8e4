"""Docstrings of the public functions and classes: numpydoc sections, every parameter and field, examples that run in one folder."""

import ast
import doctest
import inspect
import re
import textwrap
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lmeasure as lm

FUNCTIONS = [name for name in lm.__all__ if inspect.isfunction(getattr(lm, name))]
CLASSES = [name for name in lm.__all__ if inspect.isclass(getattr(lm, name))]
FIRST = ["simulate", "calibrate", "reconstruct", "reconstruct_curve", "zone", "evaluate"]
"""Their examples make the objects that the others use."""
VERBS = re.compile(r"(Analyse|Calibrate|Check|Choose|Compute|Convert|Draw|Find|Make|Map|Read|Return|Simulate|Write)\b")


def sections(text: str) -> dict[str, str]:
    """Return the numpydoc sections of a docstring by their headings."""
    parts = re.split(r"^(\w+)\n-{3,}\n", text, flags=re.MULTILINE)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


@pytest.mark.parametrize("name", FUNCTIONS)
def test_sections(name: str) -> None:
    function = getattr(lm, name)
    text = inspect.getdoc(function) or ""
    has = sections(text)
    assert VERBS.match(text), "a verb first"
    assert "Examples" in has
    assert ("Returns" in has) == (inspect.signature(function).return_annotation is not None)
    described = re.findall(r"^[*\w][*\w, ]*$", has["Parameters"], flags=re.MULTILINE)
    named = [one.strip() for line in described for one in line.split(",")]
    given = [f"**{p.name}" if p.kind is p.VAR_KEYWORD else p.name for p in inspect.signature(function).parameters.values()]
    assert named == given or sorted(named) == sorted(given)


@pytest.mark.parametrize("name", CLASSES)
def test_classes(name: str) -> None:
    docstring = inspect.getdoc(getattr(lm, name)) or ""
    line = docstring.splitlines()[0]
    assert line.endswith(".")
    assert not re.match(r"(What|Who|Of|All|A|An|The)\b", line), "a noun first"
    parts = sections(docstring)
    assert ">>> " in parts["Examples"]
    # each field is described once: below it or in the section Attributes
    body = ast.parse(textwrap.dedent(inspect.getsource(getattr(lm, name)))).body[0]
    assert isinstance(body, ast.ClassDef)
    in_section = re.findall(r"^\w+$", parts.get("Attributes", ""), flags=re.MULTILINE)
    for node, after in zip(body.body, [*body.body[1:], None], strict=True):
        if isinstance(node, ast.AnnAssign) and isinstance(node.target, ast.Name):
            below = isinstance(after, ast.Expr) and isinstance(after.value, ast.Constant)
            assert below != (node.target.id in in_section), node.target.id


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("examples")


@pytest.fixture
def here(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder)


@pytest.mark.usefixtures("here")
def test_examples() -> None:
    names: dict[str, Any] = {"lm": lm, "np": np, "Path": Path}
    failed = []
    finder, runner = doctest.DocTestFinder(recurse=False), doctest.DocTestRunner(optionflags=doctest.ELLIPSIS, verbose=False)
    for name in [*FIRST, *(name for name in (*FUNCTIONS, *CLASSES) if name not in FIRST)]:
        report: list[str] = []
        for test in finder.find(getattr(lm, name), name, globs=names):
            test.globs = names  # shared: later examples use the objects of earlier ones
            runner.run(test, out=report.append, clear_globs=False)
        failed += report
        if name == "simulate":
            simulated = names["simulated"]
            names |= {"run": simulated.run.run, "rig": simulated.run.run.rig}
            lm.write_rig(Path("rig.toml"), names["rig"])
            lm.write_run(Path("run"), names["run"])
            from lmeasure.simulation import write_campaign

            write_campaign(Path("campaign"), simulated.campaign)
    assert not failed, "\n".join(failed)
    assert runner.tries > 60
