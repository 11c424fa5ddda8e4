"""What every command has: JSON in one shape, help by jobs in the reader's language, a line on what is compiled."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from in_process import lmeasure
from typer.testing import CliRunner

from lmeasure.cli import machine
from lmeasure.cli.app import app, main
from lmeasure.cli.commands import command
from lmeasure.cli.progress import reported_compiling
from lmeasure.cli.text import rendered, word
from lmeasure.io import FILE_KINDS
from lmeasure.kernels import compilation
from lmeasure.text import of_terminal as language
from lmeasure.workflows import COMMANDS, JOBS, Result

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
KEYS = ["schema", "command", "exit_code", "error", "summary", "figures", "warnings", "files", "notes", "made"]


def called(words: list[object], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> tuple[int, dict[str, Any], str]:
    """Exit code, the JSON on standard output, and standard error of a command."""
    monkeypatch.setattr("sys.argv", ["lmeasure", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        main()
    done = capsys.readouterr()
    assert isinstance(end.value.code, int)
    return end.value.code, json.loads(done.out), done.err


def test_every_command_can_answer_in_json() -> None:
    for name in COMMANDS:
        assert "--json" in {option for parameter in command(name).params for option in parameter.opts}, name


def test_a_result_in_json(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    code, reported, said_besides = called(["structure", TRUTH / "cell-run" / "rig.toml", "--json"], monkeypatch, capsys)
    assert (code, list(reported), said_besides) == (0, KEYS, "")
    assert reported["schema"] == "lmeasure.result/1"
    assert reported["command"] == "structure"
    assert reported["error"] is None
    assert (
        reported["made"]["class"] == reported["summary"][0].split()[0].rstrip(":,") or reported["made"]["class"] in reported["summary"][0]
    )
    # what a file holds already is named, not said again
    words = ["structure", TRUTH / "cell-run" / "rig.toml", "--out", tmp_path / "s.json", "--json"]
    code, reported, _ = called(words, monkeypatch, capsys)
    assert (code, reported["files"], reported["made"]) == (0, [str(tmp_path / "s.json")], None)


def test_what_must_be_known_of_a_trajectory_is_a_list_in_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["reconstruct", TRUTH / "cell-run", "--out", tmp_path / "t.parquet", "--json"]
    code, reported, _ = called(words, monkeypatch, capsys)
    assert (code, list(reported)) == (0, KEYS)
    assert reported["notes"]
    assert all(list(note) == ["code", "text"] and f"note: {note['text']}" in reported["summary"] for note in reported["notes"])


def test_who_shows_a_result_has_its_lines_in_the_readers_language_beside(tmp_path: Path) -> None:
    """In a process of its own, as the workbench begins it: lines in English for scripts stay what they are."""
    words = [sys.executable, "-m", "lmeasure", "reconstruct", str(TRUTH / "cell-run"), "--out", str(tmp_path / "t.parquet"), "--json"]
    environment = os.environ | {"LMEASURE_EVENTS": "1", "LANGUAGE": "ru", "LANG": "C.UTF-8", "LC_ALL": "C.UTF-8"}
    with subprocess.Popen(words, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL) as process:
        assert process.stdout is not None
        document = json.loads(process.stdout.read())
    assert document["summary"][0] == "2000 samples: 2000 ok"
    assert document["shown"][0] == "замеров 2000: 2000 с позой"
    assert len(document["shown"]) == len(document["summary"])


@pytest.mark.parametrize(
    ("words", "code", "command_name", "text"),
    [
        (["reconstruct", "no-run", "--out", "t.parquet", "--json"], 1, "reconstruct", "no-run: is not a run folder: it is not there"),
        (["reconstruct", "no-run", "--json"], 2, "reconstruct", "Missing option '--out'."),
        (["calibrat", "--json"], 2, "", "There is no command 'calibrat'. Did you mean calibrate, calibrate-robot?"),
        (["structure", "--json"], 2, "structure", "Invalid value for FILE: give a file, or --list"),
    ],
)
def test_an_error_in_json(
    words: list[str], code: int, command_name: str, text: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    got, reported, err = called([*words], monkeypatch, capsys)
    assert (got, reported["exit_code"], reported["command"], reported["error"]) == (code, code, command_name, text)
    assert list(reported) == KEYS
    assert text in err
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_number_and_a_failure_in_json() -> None:
    made = machine.of_result("zone", Result(None, ("a", ""), {"volume": float("nan")}, failure="too few", files=(Path("z.nc"),)))
    reported = json.loads(machine.written(made))
    assert (reported["exit_code"], reported["error"], reported["figures"], reported["summary"], reported["files"]) == (
        1, "too few", {"volume": None}, ["a"], ["z.nc"],
    )  # fmt: skip
    assert not machine.enabled(["zone", "--", "--json"])


def test_help_names_every_command_under_its_job_in_whole_sentences() -> None:
    # lines break behind hyphens too
    text = "".join(CliRunner().invoke(app, ["--help"], env={"COLUMNS": "80"}).output.split())
    assert "..." not in text.partition("Options:")[2]
    for job, commands in JOBS.items():
        assert f"{job}:".replace(" ", "") in text
        for name, said_of in commands.items():
            assert name + said_of.split("\n")[0].replace(" ", "") in text
            assert said_of.split("\n")[0].endswith(".")


def test_options_stand_in_their_groups() -> None:
    text = CliRunner().invoke(app, ["zone", "--help"]).output
    assert text.index("Options:") < text.index("--tilt-deg") < text.index("Limits:") < text.index("--limit-deg")
    assert text.index("Computing:") < text.index("--workers")


@pytest.mark.parametrize(
    ("environment", "expected"),
    [
        ({}, "en"), ({"LANG": "ru_RU.UTF-8"}, "ru"), ({"LANG": "ru_RU.UTF-8", "LC_ALL": "C"}, "en"),
        ({"LANG": "en_GB.UTF-8", "LC_MESSAGES": "ru_RU"}, "ru"), ({"LANGUAGE": "de:ru:en", "LANG": "de_DE"}, "ru"),
        ({"LC_ALL": "", "LANG": "ru"}, "ru"), ({"LANG": "de_DE.UTF-8"}, "en"),
    ],
)  # fmt: skip
def test_the_language_is_that_of_the_environment(environment: dict[str, str], expected: str) -> None:
    assert language(environment) == expected


def test_compiling_is_told_on_a_terminal_alone(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setattr(compilation, "names", [])
    for terminal in (False, True):
        monkeypatch.setattr("sys.stderr.isatty", lambda terminal=terminal: terminal, raising=False)
        compilation.names.clear()
        with reported_compiling():
            compilation.start("outer")
            compilation.start("failed")
            compilation.start("inner")
            compilation.end("inner")
            compilation.end("outer")
        reported = capsys.readouterr().err
        assert compilation.names == ["inner", "outer"]
        assert ("compiling numerical kernels" in reported) == terminal
        assert bool(re.search(r"lmeasure: compiled 2 kernels in \d+ s, and stored them: inner, outer", reported)) == terminal


def test_completion_knows_commands_and_words(monkeypatch: pytest.MonkeyPatch) -> None:
    def completed(line: str) -> set[str]:
        """What completion offers behind a line."""
        environment = {"_LMEASURE_COMPLETE": "complete_bash", "COMP_WORDS": line, "COMP_CWORD": str(line.count(" "))}
        for name, value in environment.items():
            monkeypatch.setenv(name, value)
        return set(lmeasure().stdout.split())

    assert {"reconstruct", "record"} <= completed("lmeasure re")
    assert completed("lmeasure capture rig.toml --by ") == {"key", "rest", "both"}
    assert completed("lmeasure init --template six-") == {"six-cables"}
    assert completed("lmeasure schema r") == {name for name in FILE_KINDS if name.startswith("r")}


def test_words_in_english_are_the_texts() -> None:
    assert word("cli.missing_option", name="'--out'") == "Missing option '--out'."
    assert rendered("1.5 +- 0.2 mm/s2") == "1.5 ± 0.2 mm/s²"


def test_a_command_ends_when_it_has_said_its_last_line(tmp_path: Path) -> None:
    """What is taken apart behind it is never begun: here it would fail. Nor does a message come between what a script reads."""
    code = (
        "import sys\nclass Slow:\n    def __del__(self): print('taken apart')\nkept = Slow()\n"
        "from lmeasure.cli.app import program\nsys.argv = ['lmeasure', *sys.argv[1:]]\nprogram()"
    )
    made, wrong = (
        subprocess.run([sys.executable, "-c", code, *words], capture_output=True, text=True)
        for words in (["key", "--out", str(tmp_path / "k.pem"), "--json"], ["verify", "nothing"])
    )
    assert (made.returncode, made.stderr) == (0, "")
    assert json.loads(made.stdout)["files"] == [str(tmp_path / "k.pem"), str(tmp_path / "k.pem.pub")]
    assert (wrong.returncode, "taken apart" in wrong.stdout) == (1, False)


def test_help_and_errors_in_russian(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"LANGUAGE": "", "LC_ALL": "", "LANG": "ru_RU.UTF-8"}.items():
        monkeypatch.setenv(name, value)
    assert "Собрать и откалибровать установку:" in lmeasure("--help").stdout
    reported = lmeasure("zone", "--help").stdout
    assert "Пределы:" in reported
    assert "[обязательно]" in reported
    wrong = lmeasure("calibrat")
    assert wrong.returncode == 2
    assert "Ошибка: Нет команды «calibrat»" in wrong.stderr
    assert lmeasure("reconstruct", "nowhere", "--out", "t.csv").stderr == "lmeasure: nowhere: не папка прогона: такой нет\n"


def test_what_structure_identify_and_frames_say_is_russian_throughout(monkeypatch: pytest.MonkeyPatch, capsys: Any) -> None:
    """Lines of the first by the command, of the others as they come; numbers have a comma."""
    monkeypatch.setenv("LANGUAGE", "ru")
    rig = str(TRUTH / "cell-run" / "rig.toml")
    lines = []
    for words in (["structure", rig, "--position-mm", "0,0,0", "--to-mm", "100,50,0"], ["structure", "--list"]):
        monkeypatch.setattr("sys.argv", ["lmeasure", *words])
        with pytest.raises(SystemExit):
            main()
        lines += [line for line in capsys.readouterr().out.splitlines() if not line.startswith("дальше: lmeasure")]
    assert [line for line in lines if set(re.findall(r"[A-Za-z]{4,}", line)) - {"rank"}] == []
    assert "ранг 6" in " ".join(lines)
