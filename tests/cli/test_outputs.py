"""A command writes over nothing that exists; with --force over its own outputs alone; over an input or a recording never."""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from desk import LONG, RECORDINGS, SHORT, set_up
from in_process import code_and_text

from lmeasure.workbench.forms import of_words
from lmeasure.workflows import COMMANDS, CommandSettings, Writing, load

EVERY = SHORT | LONG
SAME = ("schema", "program", "init", "frames", "dyads", "simulate", "drum", "reconstruct tum")
"""Quick commands that write the same bytes again."""


def run(*words: object) -> tuple[int, str]:
    """Exit code and output of a command; a refusal is one line."""
    code, text = code_and_text(*words)
    assert code != 2 or len(text.splitlines()) == 1, text
    return code, text


def snapshot(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    here = tmp_path_factory.mktemp("inputs")
    set_up(here)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(here)
        assert run("init", ".", "--template", "six-cables")[0] == 0
    (here / "measurements.csv").write_text("")
    return here


@pytest.fixture
def desk(inputs: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Its inputs are links to one copy, which no test may change."""
    for path in inputs.iterdir():
        (tmp_path / path.name).symlink_to(path)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "out").mkdir()
    return tmp_path


def settings_of(line: str) -> Any:
    words = line.replace("OUT", "out").split()
    return load(words[0]).settings.model_validate(of_words(words[0], words))


def test_every_command_that_writes_takes_force() -> None:
    """But those that go on with their own folder, or write nothing."""
    others = {"batch", "capture", "docs", "play", "scan", "verify", "view", "warm", "watch", "workbench"}
    assert {name for name in COMMANDS if not issubclass(load(name).settings, Writing)} == others
    assert {name for name in COMMANDS if issubclass(load(name).settings, Writing)} == {line.split()[0] for line in EVERY.values()} | {
        "record"
    }
    assert all(load(name).settings.paths is not CommandSettings.paths for name in COMMANDS if name not in others)


@pytest.mark.parametrize("name", EVERY)
def test_what_exists_is_refused_in_one_line_before_any_work(name: str, desk: Path) -> None:
    line = EVERY[name].replace("OUT", "out")
    if name == "demo":
        (desk / "out" / "demo").mkdir()
        (desk / "out" / "demo" / "demo.json").write_text("mine")
    for path in settings_of(line).paths().outputs:
        shutil.rmtree(desk / "out")
        path.parent.mkdir(parents=True)
        path.write_text("mine")
        code, said = run(*line.split())
        assert code == 2, (path, said)
        assert said.startswith(f"{path}: exists. Use --force to replace it")
        assert snapshot(desk / "out") == {os.path.relpath(path, "out"): b"mine"}


@pytest.mark.parametrize("name", SAME)
def test_with_force_the_result_is_the_same_and_other_files_are_kept(name: str, desk: Path) -> None:
    words = EVERY[name].replace("OUT", "out").split()
    assert run(*words)[0] == 0
    made = snapshot(desk / "out")
    strangers = {path.parent / "notes.txt": b"mine" for path in (desk / "out").rglob("*") if path.is_file()}
    for path, content in strangers.items():
        path.write_bytes(content)
    assert run(*words)[0] == 2
    some = desk / "out" / min(made)
    some.write_bytes(b"half")
    assert run(*words, "--force")[0] == 0
    now = snapshot(desk / "out")
    assert {path: now[path] for path in made} == made
    assert set(now) == set(made) | {path.relative_to(desk / "out").as_posix() for path in strangers}
    assert all(path.read_bytes() == content for path, content in strangers.items())
    shutil.rmtree(desk / "out")
    for folder in {path.parent for path in strangers}:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "notes.txt").write_text("mine")
    assert run(*words)[0] == 0, "a folder of other files is no obstacle"


@pytest.mark.parametrize("name", [name for name in EVERY if name not in ("schema", "key", "mechanism", "init", "program", "demo")])
@pytest.mark.parametrize("link", [os.symlink, os.link])
def test_an_input_is_no_output_by_any_name(name: str, link: Any, desk: Path) -> None:
    line = EVERY[name].replace("OUT", "out")
    outputs, inputs = settings_of(line).paths()
    for read in (path for path in inputs if path.is_file()):
        before = read.read_bytes()
        for path in outputs:
            path.parent.mkdir(parents=True, exist_ok=True)
            link(read.resolve(), path)
            code, said = run(*line.split(), "-f")
            assert code == 2, (path, said)
            assert said.startswith(f"{path}: is an input of this command, which is never written over, not even with --force")
            assert path.read_bytes() == before
            path.unlink()


def test_what_an_input_names_is_an_input_too(desk: Path) -> None:
    """The scenario's rig would be written over by the rig of its run."""
    for path in ("rig.toml", "scenario.toml"):
        (desk / path).unlink()
        shutil.copy((desk / "drums.toml").resolve().with_name(path), desk)
    before = (desk / "rig.toml").read_bytes()
    code, said = run("simulate", "scenario.toml", "--out", ".", "--force")
    assert (code, said.partition(",")[0]) == (2, "rig.toml: is an input of this command")
    assert (desk / "rig.toml").read_bytes() == before


@pytest.mark.parametrize("name", ["record", "capture"])
def test_a_recording_is_never_replaced(name: str, desk: Path) -> None:
    line = RECORDINGS[name].replace("OUT", "out")
    assert run(*line.split())[0] == (0 if name == "record" else 1)
    before = snapshot(desk / "out")
    assert before
    if name == "record":
        for word in ((), ("--force",)):
            code, said = run(*line.split(), *word)
            assert (code, said.partition(":")[0]) == (2, "out/recorded/run.toml")
            assert "not even with --force. Give --out another folder" in said
        for words in ("simulate scenario.toml --out out/recorded", f"{SHORT['import'].partition(' --out')[0]} --out out/recorded"):
            code, said = run(*words.split(), "--force")
            assert code == 2
            assert "is part of a recording, which is never written over" in said
        assert run("motion", "sealed/inputs/trajectory.parquet", "--out", "out/recorded/pass1.csv", "-f")[0] == 2
    else:
        (desk / "out" / "campaign" / "counts.csv").write_text("counted")
        before = snapshot(desk / "out")
        assert run("plan-poses", "rig.toml", "--poses", "3", "--out", "out/campaign/counts.csv", "-f")[0] == 2
    assert snapshot(desk / "out") == before


@pytest.mark.parametrize("kind", ["folder", "pipe"])
def test_what_is_no_file_is_never_replaced(kind: str, desk: Path) -> None:
    path = desk / "out" / "rig.json"
    # into a folder goes a file of the command's own name
    path, kind = (path / "schema.json", "a folder") if kind == "folder" else (path, "no regular file")
    path.mkdir(parents=True) if kind == "a folder" else os.mkfifo(path)
    code, said = run("schema", "rig", "--out", "out/rig.json", "--force")
    assert (code, said.partition(", where")[0]) == (2, f"{path.relative_to(desk)}: is {kind}")


def test_a_link_that_leads_nowhere_is_replaced_itself(desk: Path) -> None:
    (desk / "out" / "rig.json").symlink_to(desk / "elsewhere.json")
    assert run("schema", "rig", "--out", "out/rig.json")[0] == 2
    assert run("schema", "rig", "--out", "out/rig.json", "-f")[0] == 0
    assert not (desk / "out" / "rig.json").is_symlink()
    assert not (desk / "elsewhere.json").exists()


def test_a_demo_without_a_folder_makes_a_fresh_one(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made = []

    def demo(out: Path, *_: object) -> None:
        made.append(out)
        out.mkdir()
        raise KeyboardInterrupt

    monkeypatch.setattr("lmeasure.demo.demo", demo)
    monkeypatch.chdir(tmp_path)
    for _ in range(3):
        run("demo")
    assert made == [Path("lmeasure-demo"), Path("lmeasure-demo-2"), Path("lmeasure-demo-3")]


def test_what_killed_processes_left_of_files_whose_names_are_not_known_before_is_removed(
    desk: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    monkeypatch.setattr("lmeasure.demo.demo", interrupted)
    left = ("demo/.demo.rrd.{}.part.rrd", "demo/run/.pass1.csv.{}.part.csv", "simulated/.pass2.csv.{}.part.csv")
    for name in left:
        path = desk / "out" / name.format(gone.pid)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text("half")
    run("demo", "--out", "out/demo")
    assert snapshot(desk / "out" / "demo") == {}
    assert run(*SHORT["simulate"].replace("OUT", "out").split())[0] == 0
    assert not [name for name in snapshot(desk / "out") if ".part" in name]


def interrupted(*_: object) -> None:
    raise KeyboardInterrupt


def test_what_killed_processes_left_of_an_output_is_removed(desk: Path) -> None:
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    out = desk / "out"
    (out / f".rig.json.{gone.pid}.part.json").write_text("half")
    kept = {".rig.json.1.part.json", f".other.json.{gone.pid}.part.json", ".hidden.part"}  # of a process that runs, of another output
    for name in kept:
        (out / name).write_text("half")
    assert run("schema", "rig", "--out", "out/rig.json")[0] == 0
    assert set(snapshot(out)) == {"rig.json"} | kept
