"""Ctrl-C ends every long command in one line and with 130, and nothing half-written stays: it is sent to each process while it works."""

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from in_process import ran

from lmeasure.acquisition import counter_fields
from lmeasure.acquisition.bus.feed import frames_from_counts
from lmeasure.acquisition.recorder import candump_lines
from lmeasure.cli.interrupts import heeded, noted
from lmeasure.core import CancelledError
from lmeasure.io import write_table
from lmeasure.recording import read_run

HERE = Path(__file__).parents[1]
SEALED = HERE / "authorities" / "sealed" / "with-run"
LINE = "lmeasure: interrupted. Nothing was left half-written"
GRID = "--x=-200:200:10 --y=-200:200:10 --z=-200:200:10"
WORDS = {
    "certify": "sealed/inputs/trajectory.parquet --run sealed/inputs/run --program sealed/inputs/program.toml --out out",
    "verify": "sealed",
    "identify": "--robot ur5 --measurements measurements.csv --out out",
    "calibrate": "campaign --out out",
    "demo": "--out out",
    "import": "drive.log --rig rig.toml --out out",
    "motion": "sealed/inputs/trajectory.parquet --out out.csv",
    "place": "rig.toml --task placement.toml --out out",
    "plan-poses": "rig.toml --poses 12 --box=-200:200,-200:200,-200:200 --out out.csv",
    "reconstruct": "run --out out.parquet --rerun out.rrd",
    "report": "run --out out",
    "simulate": "scenario.toml --out out",
    "zone": f"rig.toml {GRID} --out out.nc --report out",
    "check-instrument": "run --rig calibrated/rig.toml --out out",
}
QUICK = ("certify", "identify")


def interrupted(folder: Path, *words: str) -> tuple[int, list[str]]:
    """Exit code and lines of a command that is sent SIGINT when it first says that it works."""
    environment = os.environ | {"LMEASURE_EVENTS": "1", "LANG": "C"}
    command = [sys.executable, "-m", "lmeasure", *words]
    pipe = subprocess.PIPE
    said: list[str] = []
    with subprocess.Popen(command, cwd=folder, stdin=pipe, stdout=subprocess.DEVNULL, stderr=pipe, text=True, env=environment) as process:
        assert process.stderr is not None
        for line in process.stderr:
            if line.startswith("{"):
                reported: dict[str, Any] = json.loads(line)
                if reported["event"] == "progress" and not said:
                    process.send_signal(signal.SIGINT)
            else:
                said.append(line.rstrip("\n"))
    return process.wait(), said


def files(folder: Path) -> set[str]:
    return {p.relative_to(folder).as_posix() for p in folder.rglob("*")}


@pytest.mark.skipif(os.name == "nt", reason="SIGINT is not sent to one process there")
@pytest.mark.parametrize("name", QUICK)
def test_ctrl_c_ends_a_command_in_one_line(name: str, job: Path) -> None:
    ends(name, job)


@pytest.mark.slow
@pytest.mark.skipif(os.name == "nt", reason="SIGINT is not sent to one process there")
@pytest.mark.parametrize("name", sorted(set(WORDS) - set(QUICK)))
def test_ctrl_c_ends_every_long_command_in_one_line(name: str, whole_job: Path) -> None:
    ends(name, whole_job)


def ends(name: str, folder: Path) -> None:
    assert interrupted(folder, name, *WORDS[name].split()) == (130, [LINE])
    assert [path for path in files(folder) if ".part" in path] == []


@pytest.fixture(scope="module")
def job(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """What the quick ones read: a sealed folder with its inputs, and a robot's measurements."""
    here = tmp_path_factory.mktemp("job")
    shutil.copytree(SEALED, here / "sealed")
    table = np.genfromtxt(HERE.parent / "datasets" / "ur5" / "grid.csv", delimiter=",", names=True)
    rows = {f"joint_{i}_deg": table[f"joint_{i}"] for i in range(1, 7)}
    rows |= {f"{axis}_mm": table[f"{axis}_t"] + table[f"{axis}_dif"] for axis in "xyz"}
    write_table(here / "measurements.csv", {"name": [f"P{i}" for i in range(len(table))], **rows})
    return here


@pytest.fixture(scope="module")
def whole_job(job: Path) -> Path:
    """And what all others read, from a template."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(job)
        for words in ("init . --template six-cables", "simulate scenario.toml --out run", "calibrate run/calibration --out calibrated"):
            ran(*words.split())
        shutil.move("run/calibration", "campaign")
        run = read_run(Path("run"))
        counts = run.passes[0]
        Path("drive.log").write_bytes(
            candump_lines(frames_from_counts(counts.time_s, counts.recorded, counter_fields(run.rig), run.rig.can_table.sync_id))
        )
    return job


@pytest.mark.skipif(os.name == "nt", reason="SIGINT is not sent to one process there")
def test_ctrl_c_before_anything_is_loaded() -> None:
    """It comes while the parser of command lines is imported."""
    at_import = (
        "import runpy, signal, sys\n"
        "class Pressed:\n"
        "    def find_spec(self, name, path=None, target=None):\n"
        "        if name == 'typer': signal.raise_signal(signal.SIGINT)\n"
        "sys.meta_path.insert(0, Pressed())\n"
        "runpy.run_module('lmeasure', run_name='__main__')\n"
    )
    ended = subprocess.run([sys.executable, "-c", at_import], capture_output=True, text=True, check=False)
    assert (ended.returncode, ended.stderr, ended.stdout) == (130, f"{LINE}\n", "")


def test_ctrl_c_that_a_library_swallowed_ends_the_work_where_it_next_tells_how_far_it_is() -> None:
    reported: list[str] = []
    progress = heeded(lambda fraction, text: reported.append(text))
    with noted():
        progress(0.1, "before")
        with contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
        with pytest.raises(CancelledError):
            progress(0.2, "after")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
    progress(0.3, "the next command")
    assert reported == ["before", "the next command"]
