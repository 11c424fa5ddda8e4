"""`lmeasure record` as a whole: the simulated cell, replayed logs, several passes, and what the folder says of the recording."""

import json
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from in_process import ran

from lmeasure.acquisition import import_logs, read_frames, record_session
from lmeasure.acquisition.bus.frames import messages_from_frames
from lmeasure.core import AcquisitionError, FileFormatError, LMeasureError
from lmeasure.io import files
from lmeasure.recording import read_run
from lmeasure.rig import rig_from_dict, write_rig
from lmeasure.simulation import cell_rig, read_scenario, simulate

pytestmark = pytest.mark.live

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
position_mm = [120.0, -90.0, 60.0]
"""


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with rig, scenario and the recording `run` of it."""
    folder = tmp_path_factory.mktemp("session")
    write_rig(folder / "rig.toml", cell_rig(6))
    (folder / "scenario.toml").write_text(SCENARIO)
    shown: list[Any] = []
    recording = record_session(
        folder / "rig.toml", f"simulated:{folder / 'scenario.toml'}", folder / "run", start="1,2,3,0,0,0,1", show=shown.append
    )
    assert recording.ended == "complete"
    assert recording.faults == {}
    assert shown[-1].channels == tuple(f"ch{i}" for i in range(1, 7))
    assert 0 <= shown[-1].latency_s < 60
    return folder


def test_the_simulated_cell_is_recorded_bit_for_bit(recorded: Path) -> None:
    run = simulate(*read_scenario(recorded / "scenario.toml")).run
    assert run is not None
    got = read_run(recorded / "run")
    np.testing.assert_array_equal(got.passes[0].recorded, run.run.passes[0].recorded)
    assert got.known_start.tolist() == [1, 2, 3, 0, 0, 0, 1]


def test_the_manifest_says_what_was_recorded_and_how_it_closed(recorded: Path) -> None:
    entry = files.read_toml(recorded / "run" / "run.toml")["recording"][0]
    assert entry["closure_counts"] == dict.fromkeys((f"ch{i}" for i in range(1, 7)), 0.0)
    assert entry["ended"] == "complete"
    assert entry["timestamps"] == "host"
    assert entry["software"].startswith("lmeasure ")
    for name, digest in entry["sha256"].items():
        assert files.sha256(recorded / "run" / name) == digest
    assert set(entry["sha256"]) == {"pass1.csv", "pass1.log", "rig.toml"}


@pytest.mark.parametrize("suffix", [".log", ".blf", ".trc"])
def test_a_log_replays_to_the_same_counts(suffix: str, recorded: Path, tmp_path: Path) -> None:
    frames, _ = read_frames(recorded / "run" / "pass1.log")
    log = tmp_path / f"drive{suffix}"
    with can.Logger(log) as logger:
        for message in messages_from_frames(frames):
            message.channel = 0
            logger(message)
    recording = record_session(recorded / "rig.toml", f"replay:{log}", tmp_path / "run", paced=False)
    np.testing.assert_array_equal(read_run(tmp_path / "run").passes[0].recorded, read_run(recorded / "run").passes[0].recorded)
    assert recording.frames == len(frames)
    assert files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]["timestamps"] == "log"


def test_a_replayed_log_that_breaks_off_says_so(recorded: Path, tmp_path: Path) -> None:
    log = tmp_path / "cut.log"
    log.write_bytes((recorded / "run" / "pass1.log").read_bytes()[:20_000])
    recording = record_session(recorded / "rig.toml", f"replay:{log}", tmp_path / "run", paced=False)
    assert recording.faults["unread"] == 1
    events = files.read_table(tmp_path / "run" / "pass1.events.csv")
    reported = events.text("text")[events.text("kind").index("unread")]
    assert reported.startswith("ended early: the last line has no end and was not read")


def test_a_replay_in_its_own_time_is_the_same_recording(recorded: Path, tmp_path: Path) -> None:
    record_session(recorded / "rig.toml", f"replay:{recorded / 'run' / 'pass1.log'}", tmp_path / "run")
    got, first = read_run(tmp_path / "run").passes[0], read_run(recorded / "run").passes[0]
    np.testing.assert_array_equal(got.recorded, first.recorded)
    # the first time a busy host's stamps were put right; a log's are taken as they are
    moved = files.read_toml(recorded / "run" / "run.toml")["recording"][0].get("stamps_brought_back_s", 0.0)
    np.testing.assert_allclose(got.time_s, first.time_s, rtol=0, atol=moved + 2e-6)


def test_passes_of_one_motion_join_one_folder(recorded: Path, tmp_path: Path) -> None:
    data = cell_rig(6).to_dict()
    for i, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + i % 2
    write_rig(tmp_path / "rig.toml", rig_from_dict(data))
    bus = f"replay:{recorded / 'run' / 'pass1.log'}"
    with pytest.raises(AcquisitionError, match="There is no pass 3"):
        record_session(tmp_path / "rig.toml", bus, tmp_path / "run", passage=3, paced=False)
    with pytest.raises(FileFormatError, match=r"run\.toml: cannot be read"):
        record_session(tmp_path / "rig.toml", bus, tmp_path / "run", passage=2, paced=False)
    for number in (1, 2):
        record_session(tmp_path / "rig.toml", bus, tmp_path / "run", passage=number, paced=False)
    run = read_run(tmp_path / "run")
    assert [p.channels for p in run.passes] == [("ch1", "ch3", "ch5"), ("ch2", "ch4", "ch6")]
    assert [e["pass"] for e in files.read_toml(tmp_path / "run" / "run.toml")["recording"]] == [1, 2]


@pytest.mark.parametrize(
    ("requested", "complaint"),
    [
        ({"start": "1,2,3"}, "--start '1,2,3': is neither six numbers, x,y,z in mm and the rig's three angles, nor seven"),
        ({"start": "1,2,3,0,0,0,2"}, "the quaternion's length is 2, not 1"),
        ({"start": "a,b,c,d,e,f,g"}, "--start"),
        ({"options": ["host"]}, "--bus-option 'host': is not KEY=VALUE"),
    ],
)
def test_a_wrong_option_is_refused_in_one_line(requested: dict[str, Any], complaint: str, recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(LMeasureError, match=complaint):
        record_session(recorded / "rig.toml", f"replay:{recorded / 'run' / 'pass1.log'}", tmp_path / "run", paced=False, **requested)
    assert not (tmp_path / "run").exists()


def test_what_the_rig_names_goes_with_the_recording(recorded: Path, tmp_path: Path) -> None:
    """A calibration and a DBC file: the run folder can be moved, reconstructed and read again from its log."""
    signals = "".join(f'BO_ {384 + n} M{n}: 4 A\n SG_ s{n} : 0|32@1- (1,0) [0|0] "" A\n\n' for n in range(1, 7))
    (tmp_path / "files").mkdir()
    (tmp_path / "files" / "drums.dbc").write_text(f'VERSION ""\nNS_ :\nBS_:\nBU_: A\n{signals}')
    truth = Path(__file__).parents[1] / "authorities" / "truth"
    ran("calibrate", truth / "cell-12-poses", "--out", tmp_path / "files")
    data = files.read_toml(tmp_path / "files" / "rig.toml")
    assert data["calibration"] == "calibration.json"
    channels = [{"channel": f"ch{n}", "message": f"M{n}", "signal": f"s{n}"} for n in range(1, 7)]
    data |= {"calibration": "files/calibration.json", "can": {"decoder": "dbc", "dbc": "files/drums.dbc", "channel": channels}}
    write_rig(tmp_path / "rig.toml", rig_from_dict(data))
    bus = f"replay:{recorded / 'run' / 'pass1.log'}"
    record_session(tmp_path / "rig.toml", bus, tmp_path / "run", paced=False)
    (tmp_path / "run").rename(tmp_path / "moved")
    run = read_run(tmp_path / "moved")
    assert run.calibration is not None
    again = import_logs([tmp_path / "moved" / "pass1.log"], run.rig, run.start, folder=tmp_path / "moved")
    np.testing.assert_array_equal(again.run.passes[0].recorded, run.passes[0].recorded)


def test_a_recording_without_a_sample_leaves_everything_as_it_was(recorded: Path, tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"none\.log: cannot be read"):
        record_session(recorded / "rig.toml", f"replay:{tmp_path / 'none.log'}", tmp_path / "run", paced=False)
    data = cell_rig(6).to_dict()
    for i, cable in enumerate(data["cable"]):
        cable["pass"] = 1 + i % 2
    write_rig(tmp_path / "rig.toml", rig_from_dict(data))
    (tmp_path / "empty.log").write_text("(1.000000) can0 7FF#00 R\n")
    with pytest.raises(AcquisitionError, match="1 frame, not one sample of ch1, ch3, ch5: frames come, but of 7FFh"):
        record_session(tmp_path / "rig.toml", f"replay:{tmp_path / 'empty.log'}", tmp_path / "run", paced=False)
    assert not (tmp_path / "run").exists()
    log = f"replay:{recorded / 'run' / 'pass1.log'}"
    record_session(tmp_path / "rig.toml", log, tmp_path / "run", paced=False)
    before = {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()}
    with pytest.raises(AcquisitionError, match="not one sample of ch2, ch4, ch6"):
        record_session(tmp_path / "rig.toml", f"replay:{tmp_path / 'empty.log'}", tmp_path / "run", passage=2, paced=False)
    data["tool"]["P1"] = [1.0, 2.0, 3.0]
    write_rig(tmp_path / "other.toml", rig_from_dict(data))
    with pytest.raises(AcquisitionError, match=r"rig\.toml: is another rig than that of pass 2"):
        record_session(tmp_path / "other.toml", log, tmp_path / "run", passage=2, paced=False)
    assert {path.name: path.read_bytes() for path in (tmp_path / "run").iterdir()} == before
    record_session(tmp_path / "rig.toml", log, tmp_path / "run", passage=2, paced=False)
    assert len(read_run(tmp_path / "run").passes) == 2


def test_asked_to_end_it_ends_between_two_batches(recorded: Path, tmp_path: Path) -> None:
    """By what a system sends that goes down; SIGINT is sent in `test_encoders_on_bus`."""
    (tmp_path / "scenario.toml").write_text(SCENARIO.replace('"rig.toml"', json.dumps(str(recorded / "rig.toml"))) + "dwell_s = 600.0\n")
    words = ["record", "--rig", recorded / "rig.toml", "--bus", f"simulated:{tmp_path / 'scenario.toml'}", "--out", tmp_path / "run"]
    process = subprocess.Popen([sys.executable, "-m", "lmeasure", *map(str, words)], stdout=subprocess.PIPE, text=True)
    try:
        counts = tmp_path / "run" / "pass1.csv"
        while process.poll() is None and not (counts.exists() and counts.read_bytes().count(b"\n") > 100):
            time.sleep(0.02)
        process.send_signal(signal.SIGTERM)
        reported, _ = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0
    assert "no faults" in reported
    entry = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]
    assert entry["ended"] == "complete"
    # every frame of the log is counted in the table
    again = import_logs([tmp_path / "run" / "pass1.log"], cell_rig(6), read_run(tmp_path / "run").start)
    np.testing.assert_array_equal(again.run.passes[0].recorded, read_run(tmp_path / "run").passes[0].recorded)
