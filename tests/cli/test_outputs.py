"""Nothing is lost: no command writes over what it reads, a recording, another command's output or a person's file."""

import json
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from lmeasure.cli import app
from lmeasure.errors import OverwriteError
from lmeasure.simulation import cell_rig, simulate_campaign, write_campaign
from lmeasure.workflows import COMMANDS, load
from lmeasure.workflows.settings import Asked
from lmeasure.written import LEDGER, left_over, writing

TRUTH = Path(__file__).parents[1] / "authorities" / "truth"
HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
SCENARIO = 'schema = "lmeasure.scenario/1"\nseed = 3\nrate_hz = 100.0\n[[waypoint]]\nposition_mm = [20.0, -10.0, 10.0]\n'


def run(*words: object) -> int:
    """Exit code of a command; an error of ours is as `main` ends on it."""
    done = CliRunner().invoke(app, [str(w) for w in words])
    if isinstance(done.exception, OverwriteError):
        return 2
    assert done.exception is None or isinstance(done.exception, SystemExit), done.exception
    return done.exit_code


def snapshot(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file() and p.name != LEDGER}


@pytest.fixture
def cell(tmp_path: Path) -> Path:
    """A run folder, a trajectory of it, and a calibration folder."""
    shutil.copytree(TRUTH / "cell-run", tmp_path / "run")
    assert run("reconstruct", tmp_path / "run", "--out", tmp_path / "t.csv") == 0
    made = simulate_campaign(
        cell_rig(3), 12, np.random.default_rng(4), centre=HOME, half_mm=(300, 300, 300), tilt_rad=0.3, nominal_shift_mm=5.0
    )
    write_campaign(tmp_path / "campaign", made)
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    (tmp_path / "notes.txt").write_text("mine")
    return tmp_path


def test_every_command_is_held_to_the_rule() -> None:
    """But those that write nothing, or only what they know again by themselves: a key is never written over, a demo has a mark."""
    assert {name for name in COMMANDS if load(name).settings.paths is Asked.paths} == {"key", "demo", "init", "verify", "view", "workbench"}


@pytest.mark.parametrize(
    "words",
    [
        "reconstruct run --out run/pass1.csv",
        "reconstruct run --out notes.csv",
        "reconstruct run --out t2.csv --rerun notes.rrd",
        "motion t.csv --out t.csv",
        "motion t.csv --out run/pass1.csv",
        "simulate scenario.toml --out run",
        "plan-poses campaign/rig.toml --poses 4 --box -100:100,-100:100,-100:100 --out campaign/reference_poses.csv",
        "calibrate campaign --out campaign",
        "calibrate campaign --out run",
        "zone run/rig.toml --x 0:100:50 --y 0:100:50 --z 0:100:50 --out run/rig.toml",
        "drum notes.txt --rig run/rig.toml --out run/rig.toml",
        "import notes.txt --rig run/rig.toml --out run --position-mm 0 0 0 --quaternion-xyzw 0 0 0 1",
        "record --rig run/rig.toml --bus replay:log.log --fast --out run",
        "place run/rig.toml --task notes.txt --out run",
        "program --out program --x 0:100 --y 0:100 --z 0:100",
        "key --out notes.txt",
        "certify t.csv --program notes.txt --out run",
        "certify t.csv --program notes.txt --out notes --zip",
        "demo --out run",
    ],
)
def test_nothing_is_written_over_what_is_not_the_command_s_own(cell: Path, words: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell)
    for name in ("notes.csv", "notes.rrd"):
        (cell / name).write_text("mine")
    (cell / "notes.zip").write_text("mine")
    (cell / "program").mkdir()
    (cell / "program" / "commands.csv").write_text("mine")
    (cell / "log.log").write_text("(1.0) can0 080#\n" + "".join(f"(1.1) can0 {i:03X}#00000000\n" for i in range(0x181, 0x187)))
    before = snapshot(cell)
    assert run(*words.split()) == 2
    assert snapshot(cell) == before


def test_a_command_replaces_what_it_wrote_itself(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell)
    for words in (
        "reconstruct run --out t.csv",
        "motion t.csv --out m.csv",
        "simulate scenario.toml --out made",
        "calibrate campaign --out calibrated",
        "program --out tests --x 0:100 --y 0:100 --z 0:100",
    ):
        assert run(*words.split()) == 0
        assert run(*words.split()) == 0, words


def test_what_was_changed_since_is_a_person_s(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Planned poses become measured ones under the same name and columns."""
    monkeypatch.chdir(cell)
    words = ["motion", "t.csv", "--out", "m.csv"]
    assert run(*words) == 0
    table = (cell / "m.csv").read_bytes()
    (cell / "m.csv").write_bytes(table.replace(b"0", b"1", 1))
    assert run(*words) == 2
    (cell / "m.csv").write_bytes(table)
    assert run(*words) == 0
    for broken in ("", "[]", '{"schema": "lmeasure.written/1", "files": 3}', "{" * 5000):
        (cell / LEDGER).write_text(broken)
        assert run(*words) == 2


def test_exit_code_and_one_line(cell: Path) -> None:
    path = cell / "t.csv"
    done = subprocess.run([sys.executable, "-m", "lmeasure", "motion", path, "--out", path], capture_output=True, text=True)
    assert done.returncode == 2
    assert done.stderr == f"lmeasure: {path}: is read by this command, which does not write over what it reads; give --out another name\n"


def test_the_ledger_forgets_what_is_gone_and_keeps_what_was_written_before_an_error(tmp_path: Path) -> None:
    first, second = tmp_path / "a.csv", tmp_path / "b.csv"
    with pytest.raises(KeyError), writing("motion", [first, second]):  # noqa: PT012 - what stands before the error is the point
        first.write_text("whole")
        raise KeyError
    assert list(json.loads((tmp_path / LEDGER).read_text())["files"]) == ["a.csv"]
    first.unlink()
    with writing("motion", [first, second]):
        second.write_text("whole")
    assert list(json.loads((tmp_path / LEDGER).read_text())["files"]) == ["b.csv"]
    with pytest.raises(OverwriteError, match=r"b\.csv: is there already, and not as `lmeasure zone` wrote it"), writing("zone", [second]):
        pass


def test_what_a_killed_command_left_is_named(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(cell)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = [cell / f".m.csv.{gone.pid}.part.csv", cell / f".certificate.{gone.pid}.part"]
    left[0].write_text("half")
    left[1].mkdir()
    (cell / ".m.csv.1.part.csv").write_text("of a process that runs")
    (cell / ".hidden.part").write_text("a person's")
    assert left_over([cell, cell]) == sorted(left)
    done = CliRunner().invoke(app, ["motion", "t.csv", "--out", "m.csv"])
    assert done.exit_code == 0
    for path in left:
        assert f"note: {path.name} was left by a command that was broken off; nothing needs it" in done.stderr


AT_ONCE = """
import sys
from pathlib import Path
from lmeasure.written import writing

folder, name = Path(sys.argv[1]), sys.argv[2]
print("ready", flush=True)
sys.stdin.readline()
for i in range(25):
    with writing("zone", [folder / f"{name}-{i}"]):
        (folder / f"{name}-{i}").write_text("here")
"""


def test_commands_that_end_at_one_moment_are_all_entered(tmp_path: Path) -> None:
    """Processes that write into one folder: none loses another's entries, and a lock that a killed one left stops nobody for good."""
    started = [
        subprocess.Popen([sys.executable, "-c", AT_ONCE, str(tmp_path), name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for name in "abc"
    ]
    for process in started:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
    for process in started:
        assert process.stdin is not None
        process.stdin.write("\n")
        process.stdin.flush()
    for process in started:
        assert process.communicate()[0] == ""
        assert process.returncode == 0
    assert len(json.loads((tmp_path / LEDGER).read_text())["files"]) == 75
    assert sorted(p.name for p in tmp_path.iterdir() if p.name.startswith(".")) == [LEDGER]


def test_a_lock_that_was_left_stops_nobody_for_good(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("lmeasure.written.WAIT_S", 0.05)
    (tmp_path / f"{LEDGER}.lock").touch()
    with writing("zone", [tmp_path / "z.nc"]):
        (tmp_path / "z.nc").write_text("here")
    assert list(json.loads((tmp_path / LEDGER).read_text())["files"]) == ["z.nc"]
    assert not (tmp_path / f"{LEDGER}.lock").exists()
