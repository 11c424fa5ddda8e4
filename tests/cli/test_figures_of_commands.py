"""`--json` has in `figures` what a command found, as numbers with their unit in the name."""

import ast
import inspect
import json
from pathlib import Path

import pytest

from lmeasure.cli.app import main
from lmeasure.workflows import COMMANDS, load

TESTS = Path(__file__).parents[1]
RUN = TESTS / "authorities" / "truth" / "cell-run"
WITHOUT = {"docs", "key", "schema", "view", "workbench"}
"""Give a file, a text, a picture or a page, and no figure."""


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


def test_figures_of_commands_are_numbers_that_say_their_unit(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    grid = ["--x", "-100:100:100", "--y", "0:0:100", "--z", "0:0:100"]
    plan = ["plan-poses", "cell/measured.toml", "--poses", "2", "--box=-100:100,-100:100,0:0", "--tilt-deg", "5", "--further", "0"]
    asked: dict[str, list[object]] = {
        "cables": ["init", "cell", "--template", "six-cables"],
        "B1.tangent_length_mm": ["drum", "cell/drums.toml", "--rig", "cell/rig.toml", "--out", "cell/measured.toml"],
        "u_length_rms_mm": [*plan, "--criterion", "I", "--out", "planned.csv"],
        "reference_poses": ["simulate", "cell/scenario.toml", "--out", "tried"],
        "largest_u_position_mm": ["reconstruct", RUN, "--out", "t.parquet"],
        "largest_speed_mm_s": ["motion", "t.parquet", "--out", "m.parquet"],
        "least_u95_position_mm": ["zone", RUN / "rig.toml", *grid, "--out", "zone.nc"],
        "freedoms": ["structure", RUN / "rig.toml"],
    }
    for name, words in asked.items():
        monkeypatch.setattr("sys.argv", ["lmeasure", *map(str, words), "--json"])
        with pytest.raises(SystemExit) as end:
            main()
        reported = json.loads(capsys.readouterr().out)
        assert (end.value.code, reported["error"]) == (0, None), reported
        assert isinstance(reported["figures"][name], int | float), words
        assert all(isinstance(value, int | float | None) and not isinstance(value, bool) for value in reported["figures"].values())
        if words[0] == "reconstruct":
            assert reported["figures"]["samples"] == 2000
