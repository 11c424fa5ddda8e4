"""The interim check as a laboratory does it: recorded from a bus that another process speaks on, then verdict, page and trend."""

import csv
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from in_process import ran
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from test_buses import a_group, feeding
from test_interim import HOME, PLACES, calibrated, true_rig

from lmeasure.core import angles_from_rotation, se3
from lmeasure.rig import Rig, rig_from_dict, write_calibration_record, write_rig
from lmeasure.simulation import Leg, simulate_run, smooth_path

RATE_HZ = 100.0
pytestmark = [pytest.mark.live, pytest.mark.slow]


def counted(true: Rig) -> NDArray[np.int64]:
    """(n, 12) what the counters of a rig show on a round over three places and back."""
    rng, legs = np.random.default_rng(1), []
    for place in (*PLACES[:3], (0.0, 0.0, 0.0), *PLACES[2::-1], (0.0, 0.0, 0.0)):
        there = se3.pose(np.array(place) + rng.normal(0, 0.01, 3), Rotation.from_rotvec(np.array(place) / 1000.0))
        legs.append(Leg(there, 1000.0, 60.0, 0.4))
    time_s, poses = smooth_path(HOME, legs, RATE_HZ)
    still = round(0.5 * RATE_HZ)
    time_s, poses = np.r_[np.arange(still) / RATE_HZ, time_s + still / RATE_HZ], np.vstack([np.repeat(poses[:1], still, axis=0), poses])
    return simulate_run(true, time_s, poses, noise_mm=0.0, rng=rng).run.passes[0].recorded.astype(np.int64)


def recorded(folder: Path, name: str, counts: NDArray[np.int64]) -> str:
    """The run folder that `lmeasure record` makes of counts that another process sends."""
    group = a_group()
    angles = angles_from_rotation(true_rig().angles, Rotation.identity(1))[0]
    begun = ",".join(f"{v:.9g}" for v in (0.0, 0.0, 0.0, *angles))
    command = [sys.executable, "-m", "lmeasure", "record", "--rig", "calibrated/rig.toml", "--out", name, "--start", begun]
    command += ["--seconds", str(len(counts) / RATE_HZ + 2.0)]
    command += ["--bus", f"udp_multicast:{group['channel']}", "--bus-option", f"port={group['port']}"]
    with (
        feeding("udp_multicast", counts, RATE_HZ, group, folder) as (_, encoders),
        subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True) as process,
    ):
        while not (folder / name / "run.toml").exists() and process.poll() is None:
            time.sleep(0.05)
        assert encoders.stdin is not None
        encoders.stdin.write("go\n")
        encoders.stdin.flush()
        said, _ = process.communicate()
    assert process.returncode == 0, said
    return str(folder / name)


def test_a_sound_instrument_passes_and_a_point_that_moved_is_named(tmp_path: Path) -> None:
    rig, record = calibrated()
    data = rig.to_dict()
    for point in data["observation_point"]:
        point["drum"]["max_cable_speed_mm_s"] = 1e6  # a feed that was held up sends at once what it missed
    data["swivel"] = [s | {"max_speed_deg_s": 1e6} for s in data["swivel"]]
    write_rig(tmp_path / "calibrated" / "rig.toml", rig_from_dict(data))
    write_calibration_record(tmp_path / "calibrated" / "calibration.json", record)
    worn = true_rig().to_dict()
    worn["observation_point"][2]["position_mm"][0] += 0.2
    options = ["--rig", str(tmp_path / "calibrated" / "rig.toml"), "--repeatability-mm", "0.01", "--trend", str(tmp_path / "checks.csv")]
    reported = []
    for name, true in (("monday", true_rig()), ("tuesday", rig_from_dict(worn))):
        run = recorded(tmp_path, name, counted(true))
        ran("check-instrument", run, *options, "--out", tmp_path / f"{name}-check")
        reported.append(json.loads((tmp_path / f"{name}-check" / "check.json").read_text(encoding="utf-8")))
    sound, moved = reported
    assert sound["verdict"] == "passed"
    assert not sound["moved"]
    assert moved["verdict"] == "calibrate again"
    (point,) = (cause for cause in moved["moved"] if cause["kind"] == "point")
    assert point["name"] == "B3"
    assert abs(point["size"] - 0.2) < 2.0 * point["u"]
    page = (tmp_path / "tuesday-check" / "check.html").read_text(encoding="utf-8")
    assert "B3" in page
    with (tmp_path / "checks.csv").open(newline="", encoding="utf-8") as file:
        trend = list(csv.DictReader(file))
    assert len({row["time"] for row in trend}) == 2
