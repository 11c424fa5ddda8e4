"""`--json` of every command, as somebody would read it who writes a script around it: one document, numbers with their unit in the name,
and every file that was written."""

import ast
import inspect
import json
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pages
import pytest
import test_interim as interim
from test_json_and_words import KEYS, called

from lmeasure.recording import write_run
from lmeasure.workflows import COMMANDS, load

HERE = Path(__file__).parents[1]
TRUTH = HERE / "authorities" / "truth"
SEALED = HERE / "authorities" / "sealed" / "with-run"
GRID = "--x=0:50:50 --y=0:50:50 --z=0:50:50"
DEVICE = "--rig run/rig.toml --bus replay:drive.log --fast --start 0,0,0,0,0,0"
QUICK = (
    "schema rig --out rig.json",
    "schema",
    "init cell --template six-cables",
    "key --out key.pem",
    "drum cell/drums.toml --rig cell/rig.toml --out cell/measured.toml",
    "scan --bus replay:drive.log --seconds 0.2",
    "import drive.log --rig run/rig.toml --out imported --start 0,0,0,0,0,0",
    "import drive.log --scan",
    f"record {DEVICE} --out recorded",
    "structure run/rig.toml --position-mm 0,0,0 --quaternion 0,0,0,1",
    "program --out program --x 0:500 --y 0:500 --z 0:500 --tests pose",
    "mechanism rotopod --out m.json",
    "inspect drive.log --out log.html",
    "frames --robot plan/planned.csv --measured plan/planned.csv --out frames.json",
    "register kept --add sealed --export all.csv",
    "reconstruct run --out t.parquet --rerun t.rrd",
    "motion t.parquet --out m.csv",
    "simulate cell/scenario.toml --out simulated",
    "dyads plan/planned.csv --links 1 --starts 5 --out links",
    "capture plan/rig.toml --poses plan/planned.csv --bus replay:plan/drive.log --fast --by rest --out captured",
)
"""The others need these, or more than a second."""
SLOW = (
    "scan",
    f"watch {DEVICE}",
    "check --rig run/rig.toml --bus replay:drive.log",
    "play run/rig.toml --bus udp_multicast:239.74.211.9",
    "batch reconstruct run --out fleet",
    "report t.parquet --out page",
    "calibrate poses --out calibrated",
    f"zone calibrated/rig.toml {GRID} --out zone.nc --report zone --rerun zone.rrd",
    "plan-poses run/rig.toml --poses 8 --box=-100:100,-100:100,-100:100 --out planned.csv",
    "certify sealed/inputs/trajectory.parquet --program sealed/inputs/program.toml --run sealed/inputs/run --out certificate --trials 100",
    "verify certificate",
    "verify sealed",
    "compare certificate sealed --out compared.json --page compared.html",
    "check-instrument stops --out checked",
    "identify --robot ur5 --measurements ur5/rows.csv --out identified",
    "correct arm/pick.csv --identified arm/robot --out corrected --most-mm 2",
    "place cell/rig.toml --task cell/placement.toml --out placed --generations 2",
    "demo --out demonstrated",
    "qualify --out qualified",
    "warm",
)
SERVING = {"docs", "view", "workbench"}
"""They answer for as long as they are asked: of them errors alone are read."""
WITHOUT = {"docs", "key", "schema", "view", "workbench"}
"""Give a file, a text, a picture or a page, and no figure."""
UNIT = re.compile(r"_(mm3?|m3|mm_s|deg|rad|s|hz|counts)$")
COUNTED = [
    "adapters", "added", "apart", "assumed", "cables", "capable", "certificates", "characteristics", "checks", "compared",
    "complex_assemblies", "corrected", "counters", "counter_like", "determinant", "differences", "directions_determined", "done", "entries",
    "equations", "failed", "faults", "figures", "frames", "frames_lost", "freedoms", "identifiers", "items", "kernels", "known",
    "laboratories",
    "left_out",
    "lines", "links", "minutes", "nodes", "nodes_in_zone", "not_compared", "overdue", "passes", "poses", "rank", "readings", "recorded",
    "reference_poses", "results", "rigs_tried", "samples", "unchanged", "unknowns", "unread", "with_a_pose",
]  # fmt: skip
RATIOS = ["largest_e_n", "largest_relative_difference", "nearness", "positions_inside_95", "rotations_inside_95", "usable_part"]


def answer_apart(words: list[object], desk: Path) -> tuple[int, dict[str, Any]]:
    """Exit code and answer of a process of its own, whose input has ended."""
    command = [sys.executable, "-m", "lmeasure", *map(str, words)]
    done = subprocess.run(
        command, cwd=desk, env=os.environ | {"LANG": "ru_RU.UTF-8"}, stdin=subprocess.DEVNULL, capture_output=True, text=True
    )
    return done.returncode, json.loads(done.stdout)


def held(line: str, desk: Path, answer: Callable[[list[object]], tuple[int, dict[str, Any]]]) -> dict[str, Any]:
    """What a command says, held to what is promised of every answer; its terminal is Russian, and nobody sits at it."""
    before = set(desk.rglob("*"))
    code, reported = answer([*line.split(), "--json"])
    assert (list(reported), reported["command"], reported["exit_code"]) == (KEYS, line.split()[0], code)
    unnamed = [name for name in reported["figures"] if not UNIT.search(name) and name not in COUNTED and name not in RATIOS]
    assert unnamed == []
    assert all(value is None or np.isfinite(value) for value in reported["figures"].values())
    # a ledger of what is being written stays beside it
    made = {str(p.relative_to(desk)) for p in desk.rglob("*") if p.is_file() and p not in before and not p.name.startswith(".")}
    if reported["command"] == "demo":  # it names what to look at
        assert all((desk / name).exists() for name in reported["files"])
    else:
        assert made == {str(Path(name)) for name in reported["files"]}
    if reported["command"] != "certify":
        assert not re.search("[а-я]", json.dumps(reported, ensure_ascii=False))
    return reported


@pytest.mark.parametrize("line", QUICK)
def test_what_a_command_answers(line: str, desk: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.chdir(desk)
    monkeypatch.setenv("LANG", "ru_RU.UTF-8")
    with Path(os.devnull).open() as nobody:
        monkeypatch.setattr("sys.stdin", nobody)
        reported = held(line, desk, lambda words: called(words, monkeypatch, capsys)[:2])
    # nobody goes to the poses of the capture
    assert (reported["exit_code"], reported["error"] is None) == ((1, False) if reported["command"] == "capture" else (0, True))


@pytest.mark.slow
def test_what_the_others_answer(desk: Path) -> None:
    """After the quick ones, whose files they need; with `verify` of an older folder, whose figures differ, and a `check` nobody walks
    through."""
    shutil.copytree(TRUTH / "cell-12-poses", desk / "poses")
    write_run(desk / "stops", interim.run_of(interim.true_rig(), 0)[0])
    pages.PAGES["identification"](desk / "ur5", "en")
    pages.PAGES["correction"](desk / "arm", "en")
    codes = {line: held(line, desk, lambda words: answer_apart(words, desk))["exit_code"] for line in SLOW}
    assert {line: code for line, code in codes.items() if code} == {SLOW[2]: 130, "verify sealed": 3}


def test_every_workflow_that_finds_something_gives_figures() -> None:
    """Each `Result` of a workflow is given figures, but of those that find none, and lists of what there is."""
    for name in COMMANDS:
        work = inspect.unwrap(load(name).run)
        tree = ast.parse(inspect.getsource(work))
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == "Result"]
        if name in WITHOUT:
            assert all(len(call.args) < 3 for call in calls)
            continue
        for call in calls:
            given = len(call.args) >= 3 or any(k.arg == "figures" for k in call.keywords)
            assert given or "TEMPLATES" in ast.unparse(call), f"{name}: no figures"
    assert set(COMMANDS) >= WITHOUT


def test_every_command_is_asked() -> None:
    assert {line.split()[0] for line in (*QUICK, *SLOW)} | SERVING == set(COMMANDS)


@pytest.mark.parametrize("command", COMMANDS)
def test_a_wrong_call_of_a_command_is_a_document_too(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("LANG", "ru_RU.UTF-8")
    code, reported, _ = called([command, "--no-such-option", "--json"], monkeypatch, capsys)
    assert (list(reported), code, reported["command"], reported["exit_code"]) == (KEYS, 2, command, 2)
    assert reported["error"].startswith("No such option: --no-such-option")
    assert list(tmp_path.iterdir()) == []
