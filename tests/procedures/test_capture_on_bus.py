"""A capture over a real bus, by its command in a process of its own: killed in the middle, it goes on, and its folder calibrates."""

import os
import random
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest
from capture_bench import motion, nominal_of, on_bus, some_poses, true_rig, write_inputs

from lmeasure.calibration import calibrate, read_campaign
from lmeasure.core import FloatArray
from lmeasure.sensors import span_lengths

pytestmark = pytest.mark.live


def test_killed_in_the_middle_a_capture_goes_on_and_loses_nothing(tmp_path: Path) -> None:
    rig, poses = true_rig(), some_poses(9)
    write_inputs(tmp_path, nominal_of(rig), poses)
    port, group = random.randrange(20000, 60000), f"239.74.{random.randrange(1, 255)}.{random.randrange(1, 255)}"
    command = [sys.executable, "-m", "lmeasure", "capture", "rig.toml", "--poses", "planned.csv", "--bus", f"udp_multicast:{group}"]
    command += ["--bus-option", f"port={port}", "--out", "campaign", "--by", "rest", "--dwell-s", "0.2", "--settle-s", "0.1"]
    command += ["--u-position-mm", "0", "--u-rotation-deg", "0"]
    bus = {"interface": "udp_multicast", "channel": group, "port": port, "hop_limit": 0}

    def session(way: FloatArray, kill_at: str = "") -> list[str]:
        """The robot on its way once the command is ready; what it said."""
        go, lines = threading.Event(), []
        pipes = {"stdin": subprocess.DEVNULL, "stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
        with (
            on_bus(rig, motion(rig, way, 0.45, zero=poses[0]).recorded, bus, go),
            subprocess.Popen(command, cwd=tmp_path, text=True, **pipes) as process,  # type: ignore[call-overload]
        ):
            patience = threading.Timer(90.0, process.kill)
            patience.start()
            for line in process.stdout:
                lines.append(line.rstrip())
                if line.startswith("pose "):
                    go.set()
                if kill_at and line.startswith(kill_at):
                    os.kill(process.pid, signal.SIGKILL)
            patience.cancel()
        assert process.returncode == (-signal.SIGKILL if kill_at else 0), lines
        return lines

    session(poses[:5], kill_at="pose 6 ")
    before = (tmp_path / "campaign" / "counts.csv").read_bytes()
    assert before.count(b'"5",') > 20
    # back where it stood when the session was killed, on to the end, and back to the first
    lines = session(np.vstack([poses[4:], poses[:1]]))
    assert "continuing: 5 readings exist, of poses 1, 2, 3, 4, 5" in lines
    assert "the counters agree with pose 5: no counts were lost" in lines
    assert any("closed: at most 1.2 counts, which is within rounding" in line for line in lines)
    assert lines[-1] == "next: lmeasure calibrate campaign --out calibrated"
    assert (tmp_path / "campaign" / "counts.csv").read_bytes().startswith(before)
    assert sorted(p.name for p in (tmp_path / "campaign" / "frames").iterdir()) == ["1", "2"]
    found = calibrate(read_campaign(tmp_path / "campaign")).rig
    other = some_poses(40, seed=7)
    error, was = (span_lengths(one, other) - span_lengths(rig, other) for one in (found, nominal_of(rig)))
    assert np.abs(error - error[0]).max() < 0.2 < 2.0 < np.abs(was - was[0]).max()
