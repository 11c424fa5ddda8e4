"""Everything that a person reads on a Russian terminal is Russian: results, refusals, and wrong words of a command line."""

import ast
import json
import re
import shutil
from pathlib import Path

import pytest
from desk import SHORT, set_up
from in_process import code_and_text, lmeasure, refused

from lmeasure import core
from lmeasure.cli.progress import state_line
from lmeasure.text import Lines, message


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("zone rig.toml --out z.nc --limit-deg 0,5", "'--limit-deg': must be a number, is '0,5'. Write numbers with a decimal point"),
        ("plan-poses rig.toml --out p.csv --poses 3.5", "'--poses': must be a whole number, is '3.5'"),
        ("plan-poses rig.toml --out p.csv --poses 0", "'--poses': must be at least 1, is '0'"),
        ("zone rig.toml --out z.nc --tilt-steps 0", "'--tilt-steps': must be at least 1, is '0'"),
        ("plan-poses rig.toml --poses 3 --out p.csv --tilt-deg 91", "'--tilt-deg': must be at most 90, is '91'"),
    ],
)
def test_a_number_that_cannot_be_taken_is_refused_in_plain_words(words: str, text: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert f"Invalid value for {text}" in refused(*words.split(), code=2)
    assert json.loads(lmeasure(*words.split(), "--json").stdout)["error"] == f"Invalid value for {text}"
    monkeypatch.setenv("LANGUAGE", "ru")
    assert "Недопустимое значение '--" in refused(*words.split(), code=2)


def test_lines_between_keys_are_in_the_readers_language(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    with state_line() as (say, _):
        say(message("capture.nothing_take_back"))
        say(Lines([message("capture.nothing_take_back"), "one of no catalogue"]))
    assert capsys.readouterr().out == "отменять нечего\nотменять нечего\none of no catalogue\n"


QUICK = ("schema", "key", "import", "reconstruct", "program", "frames", "simulate", "drum", "register")
MORE = ("init . --template six-cables", "schema", "import drive.log --scan", "report OUT/t.parquet --out OUT/page", "verify sealed")
NAMES = re.compile(r"`[^`]*`|\S*[-_/=.:\d]\S*|[«\"][^»\"]*[»\"]")
SENTENCE = re.compile(r"\b[A-Za-z]{2,}(?:[ ,]+[A-Za-z]{2,}){2,}")
"""Three words of Latin letters in a row, where no names are left."""


def test_no_line_of_a_command_has_an_english_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    set_up(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LANGUAGE", "ru")
    (tmp_path / "out").mkdir()
    found = []
    for line in (MORE[0], *(SHORT[name] for name in QUICK), *MORE[1:]):
        code, said = code_and_text(*line.replace("OUT", "out").split())
        assert code in (0, 3), (line, said)
        found += [(line, text) for text in said.splitlines() if not text.startswith("дальше: ") and SENTENCE.search(NAMES.sub("", text))]
    assert found == []
    shutil.rmtree(tmp_path / "out")


def test_every_refusal_is_a_message() -> None:
    """A text that a person reads is in the catalogues, except below them (core) and in errors of those who program."""
    errors = {name for name in dir(core) if isinstance(getattr(core, name), type) and issubclass(getattr(core, name), core.LMeasureError)}
    raised = re.compile(rf"\b(?:{'|'.join(errors)})\([\s\w,]*[\"']")
    found = []
    for path in Path(core.__file__).parents[1].rglob("*.py"):
        source = path.read_text(encoding="utf-8")
        for node in ast.walk(ast.parse(source)) if path.parent.name != "core" and raised.search(source) else ():
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") in errors:
                literal = " ".join(ast.unparse(one) for one in node.args if isinstance(one, ast.JoinedStr | ast.Constant))
                if len(re.findall(r"[a-z]{2,}", re.sub(r"\{[^}]*\}", "", literal))) > 2:
                    found.append(f"{path.name}:{node.lineno}: {literal}")
    assert found == []
