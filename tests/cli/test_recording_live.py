"""What a person sees while it records: the table in the terminal, and a recording that grows."""

import io
import re
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from in_process import lmeasure
from rerun.chunk import RrdReader
from rich.console import Console

from lmeasure.acquisition import Progress, Samples
from lmeasure.cli.live import render
from lmeasure.core import LMeasureError
from lmeasure.io import files
from lmeasure.recording import read_counts, read_run
from lmeasure.rig import rig_from_dict, write_rig
from lmeasure.simulation import cell_rig
from lmeasure.trajectory import LivePose, PoseWatch, reconstruct
from lmeasure.view import growing_counts

SCENARIO = """
schema = "lmeasure.scenario/1"
rig = "rig.toml"
rate_hz = 200.0
[motion]
speed_mm_s = 1500.0
dwell_s = 0.3
[[waypoint]]
position_mm = [0.0, 0.0, 0.0]
[[waypoint]]
position_mm = [60.0, -40.0, 30.0]
"""


SOME = Progress(
    seconds=2.0, frames=1400, samples=200, faults={"gap": 3, "wrap": 1}, channels=("ch1", "ch2"), counts=np.array([1234.0, np.nan]),
    rates=np.array([-500.0, np.nan]), speeds_mm_s=np.array([-6.0, np.nan]), latency_s=0.0123,
)  # fmt: skip
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


def shown(path: Path, channel: str) -> list[float]:
    """The counts of a channel that the recording holds."""
    stream = RrdReader(path).stream().filter(content=f"/counts/pass1/{channel}", components="Scalars:scalars")
    return [cell[0] for chunk in stream for cell in chunk.to_record_batch().column("Scalars:scalars").to_pylist()]


def text_of(progress: Progress, pose: PoseWatch | str = "") -> list[str]:
    console = Console(width=200, file=io.StringIO())
    with console.capture() as said:
        console.print(render(progress, pose))
    return [line.strip() for line in said.get().splitlines()]


def test_the_table_is_in_the_language_of_the_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LANGUAGE", "ru")
    lines = text_of(SOME)
    assert lines[0] == "2,0 с  замеров 200 (100/с)  кадров 1400  задержка 12,3 мс"
    assert lines[1].split() == ["канал", "отсчёт", "отсчётов/с", "мм/с"]


def test_the_table_says_counts_rates_speeds_faults_and_latency() -> None:
    lines = text_of(SOME)
    assert lines[0] == "2.0 s  200 samples (100/s)  1400 frames  latency 12.3 ms"
    assert lines[1].split() == ["channel", "count", "counts/s", "mm/s"]
    assert lines[2].split() == ["ch1", "+1234", "-500", "-6"]
    assert lines[3].split() == ["ch2", "-", "-", "-"]
    assert lines[4] == "3 gap, 1 wrap"


def test_recording_shows_the_table_and_the_recording_is_whole_at_the_end(tmp_path: Path) -> None:
    write_rig(tmp_path / "rig.toml", cell_rig(6))
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    words = ["record", "--rig", tmp_path / "rig.toml", "--bus", f"simulated:{tmp_path / 'scenario.toml'}", "--out", tmp_path / "run"]
    done = lmeasure(*words, "--start", "0,0,0,0,0,0,1", "--live", "--lag-s", "0.2", "--rerun", tmp_path / "run.rrd")
    assert done.returncode == 0, done.stderr
    counts = read_counts(tmp_path / "run" / "pass1.csv")
    assert f"{7 * len(counts.time_s)} frames" in done.stderr
    assert "latency" in done.stderr
    assert "no faults" in done.stderr
    last = reconstruct(read_run(tmp_path / "run")).poses[-1]
    said = " ".join(done.stderr.split())
    place = re.search(r"pose: \((.*?)\) mm", said)
    assert place is not None
    np.testing.assert_allclose([float(x) for x in place[1].split(",")], last[:3], atol=1e-3)
    assert "frame to pose" in said
    smooth = re.search(r"curve, 0\.[12]. s behind: \((.*?)\) mm U95", said)
    assert smooth is not None
    np.testing.assert_allclose([float(x) for x in smooth[1].split(",")], last[:3], atol=0.02)
    np.testing.assert_array_equal(shown(tmp_path / "run.rrd", "ch4"), counts.of("ch4"))
    # the same frames, looked at and not recorded
    there = sorted(tmp_path.rglob("*"))
    words = ["watch", "--rig", tmp_path / "rig.toml", "--bus", f"replay:{tmp_path / 'run' / 'pass1.log'}", "--fast"]
    done = lmeasure(*words, "--start", "0,0,0,0,0,0,1")
    assert done.returncode == 0, done.stderr
    assert f"{len(counts.time_s)} samples from {7 * len(counts.time_s)} frames" in done.stdout
    assert "Nothing was recorded" in done.stdout
    assert "pose: " in done.stderr
    assert "ch4" in done.stderr
    assert sorted(tmp_path.rglob("*")) == there


def test_a_rig_that_cannot_tell_a_pose_live_says_why(tmp_path: Path) -> None:
    six = cell_rig(6).to_dict()
    write_rig(tmp_path / "rig.toml", rig_from_dict(six | {"cable": six["cable"][:5]}))
    (tmp_path / "scenario.toml").write_text(SCENARIO)
    words = [
        "record", "--rig", tmp_path / "rig.toml", "--bus", f"simulated:{tmp_path / 'scenario.toml'}", "--out", tmp_path / "run", "--live",
    ]  # fmt: skip
    done = lmeasure(*words, "--start", "0,0,0,0,0,0,1")
    assert done.returncode == 0, done.stderr
    assert "no pose: rig" in done.stderr
    assert "has 5 cables" in done.stderr
    done = lmeasure(*words, "--out", tmp_path / "again")
    assert done.returncode == 0, done.stderr
    assert "no pose: the start pose is unknown. State --start" in done.stderr
    assert "no --start pose. State [start] in" in done.stdout
    assert "start" not in files.read_toml(tmp_path / "again" / "run.toml")


def test_the_watch_tells_poses_statuses_and_latency() -> None:
    rig = cell_rig(6)
    watch = PoseWatch(LivePose(rig, HOME))
    assert text_of(SOME, watch)[4] == "pose: -"
    watch(Samples(np.array([0.0, 0.001]), np.zeros((2, 6))))
    assert (watch.poses, watch.latest is not None) == (2, True)
    assert text_of(replace(SOME, origin_s=time.time() - 0.5), watch)[4].startswith("pose: (+0.000, +0.000, +0.000) mm")
    latency = watch.latency_s(time.time() - 0.5)
    assert latency is not None
    assert 0.3 < latency < 20.0
    assert watch.latency_s(time.time() + 3600.0) is None  # clocks that are not the same
    watch(Samples(np.array([0.002]), np.full((1, 6), np.nan)))
    assert text_of(SOME, watch)[4] == "pose: gap"


@pytest.mark.filterwarnings("ignore:RRD file has no footer")  # it has none before its end
def test_what_is_recorded_can_be_read_while_it_grows(tmp_path: Path) -> None:
    path = tmp_path / "growing.rrd"
    with growing_counts(path, ("ch1", "ch2")) as append:
        for k in range(3):
            time_s = np.asarray(0.1 * np.arange(10 * k, 10 * k + 10), np.float64)
            append(Samples(time_s, np.asarray(np.column_stack([time_s * 100, -time_s]), np.float64)))
            np.testing.assert_allclose(shown(path, "ch1"), 10.0 * np.arange(10 * k + 10), atol=1e-9)
    np.testing.assert_allclose(shown(path, "ch2"), -0.1 * np.arange(30), atol=1e-9)


def test_a_place_where_nothing_can_be_written_is_said_at_once(tmp_path: Path) -> None:
    with (
        pytest.raises(LMeasureError, match=r"absent.run\.rrd: cannot be written"),
        growing_counts(tmp_path / "absent" / "run.rrd", ("ch1",)),
    ):
        pass
