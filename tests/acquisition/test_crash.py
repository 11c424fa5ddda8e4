"""The recorder killed, and its disk full: what was recorded is readable, and the folder says that it ended early."""

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from lmeasure.acquisition import read_frames
from lmeasure.io import files
from lmeasure.recording import read_run
from lmeasure.rig import write_rig
from lmeasure.simulation import read_scenario, simulate

pytestmark = pytest.mark.live

SCENARIO = """
schema = "lmeasure.scenario/1"
seed = 3
[motion]
speed_mm_s = 300.0
cycles = 2
[[waypoint]]
position_mm = [250.0, -200.0, 150.0]
"""


class Recorders:
    """Recorders of the scenario in a folder, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        (folder / "scenario.toml").write_text(SCENARIO)
        scenario, rig = read_scenario(folder / "scenario.toml")
        write_rig(folder / "rig.toml", rig)
        run = simulate(scenario, rig).run
        assert run is not None
        self.recorded = run.run.passes[0].recorded
        nursery = [sys.executable, str(Path(__file__).parents[1] / "helpers" / "nursery.py")]
        self._process = subprocess.Popen(nursery, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert self._answer() == "ready"

    def _answer(self) -> str:
        assert self._process.stdout is not None
        return self._process.stdout.readline().strip()

    def _say(self, *words: str) -> str:
        assert self._process.stdin is not None
        self._process.stdin.write("\t".join(words) + "\n")
        self._process.stdin.flush()
        return self._answer()

    def start(self, name: str, limit: int = 0) -> int:
        """The process id of a recorder into the folder of that name; limit: bytes that a file may have."""
        words = ["record", "--rig", str(self.folder / "rig.toml"), "--start", "0,0,0,0,0,0,1", "--out", str(self.folder / name)]
        return int(self._say(str(self.folder / f"{name}.txt"), str(limit), *words, "--bus", f"simulated:{self.folder / 'scenario.toml'}"))

    def wait(self) -> int:
        """The exit status of the last one, negative for a signal."""
        return int(self._say("wait"))

    def close(self) -> None:
        """No more of them."""
        self._process.kill()
        self._process.communicate()


@pytest.fixture(scope="module")
def recorders(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Recorders]:
    started = Recorders(tmp_path_factory.mktemp("recorders"))
    yield started
    started.close()


def wait_for(path: Path, size: int) -> None:
    end = time.monotonic() + 60.0
    while not path.exists() or path.stat().st_size < size:
        assert time.monotonic() < end
        time.sleep(0.005)


def assert_readable_prefix(folder: Path, recorded: NDArray[np.float64], at_least: int) -> None:
    assert files.read_toml(folder / "run.toml")["recording"][0]["ended"] == "early"
    counts = read_run(folder).passes[0]
    n = len(counts.time_s)
    assert n >= at_least
    np.testing.assert_array_equal(counts.recorded, recorded[:n])
    # the raw frames are there too, at least as far
    frames, _ = read_frames(folder / "pass1.log")
    assert np.count_nonzero(frames.identifier == 0x80) >= n


def kill_many(recorders: Recorders, count: int, seed: int) -> None:
    """Kill recorders at random instants and look at what they leave."""
    rng = random.Random(seed)
    for k in range(count):
        folder = recorders.folder / f"killed{seed}-{k}"
        child = recorders.start(folder.name)
        wait_for(folder / "pass1.csv", 1)
        wait_for(folder / "run.toml", 1)
        wait_for(folder / "pass1.csv", 200)
        time.sleep(rng.uniform(0.0, 0.6))
        written = (folder / "pass1.csv").read_bytes().count(b"\n") - 1
        os.kill(child, signal.SIGKILL)
        assert recorders.wait() == -signal.SIGKILL
        assert_readable_prefix(folder, recorders.recorded, written)


def test_killed_at_any_moment_everything_up_to_then_is_readable(recorders: Recorders) -> None:
    kill_many(recorders, 3, seed=5)


@pytest.mark.slow
def test_killed_fifty_times_everything_up_to_then_is_readable(recorders: Recorders) -> None:
    kill_many(recorders, 50, seed=50)


def test_a_line_torn_in_the_middle_is_left_out(recorders: Recorders) -> None:
    child = recorders.start("torn")
    path = recorders.folder / "torn" / "pass1.csv"
    wait_for(path, 5000)
    os.kill(child, signal.SIGKILL)
    recorders.wait()
    whole = path.read_bytes()
    for cut in range(1, 30):
        path.write_bytes(whole[:-cut])
        assert_readable_prefix(path.parent, recorders.recorded, 1)


def test_a_full_disk_ends_the_recording_and_says_so(recorders: Recorders) -> None:
    full = 300_000
    recorders.start("full", full)
    assert recorders.wait() == 1
    said = (recorders.folder / "full.txt").read_text().splitlines()
    assert said[-1].endswith("pass1.log: cannot be written: File too large; no file may be so large there. Write to another disk")
    assert "ended early, everything before is kept" in said[-1]
    assert "samples from" in said[0]
    assert_readable_prefix(recorders.folder / "full", recorders.recorded, 100)
    log = recorders.folder / "full" / "pass1.log"
    assert log.stat().st_size <= full
    assert log.read_bytes().endswith(b"\n")
