"""Drums and swivel encoders of one rig over a real bus between processes: recorded by the command, live from power-on, and read again."""

import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from feed_process import UNSENT
from in_process import ran
from test_buses import a_group, feeding

from lmeasure.core import Status
from lmeasure.core.se3 import displacement
from lmeasure.recording import read_run
from lmeasure.rig import read_rig, rig_from_dict, write_rig
from lmeasure.trajectory import reconstruct

pytestmark = pytest.mark.live

TRUTH = Path(__file__).parent.parent / "authorities" / "truth" / "swivel-run"
RATE_HZ = 200.0
SILENT = slice(150, 260)
"""Samples that one of the encoders does not send."""
AT_REST = 800


def test_twelve_channels_are_recorded_live_without_a_start(tmp_path: Path) -> None:
    """Codes go round their end, and one encoder is silent for half a second: its samples are gaps, the poses go on by the other eleven."""
    data = read_rig(TRUTH / "rig.toml").to_dict()
    for point in data["observation_point"]:
        point["drum"]["max_cable_speed_mm_s"] = 1e6  # a feed that was held up sends at once what it missed
    data["swivel"] = [s | {"max_speed_deg_s": 1e6} for s in data["swivel"]]
    write_rig(tmp_path / "rig.toml", rig_from_dict(data))
    counts = read_run(TRUTH).passes[0].recorded[::5].astype(np.int64)
    # an encoder that was mounted so that its code passes the end on the way
    turn = data["swivel"][1]["counts_per_revolution"]
    shift = turn - int(counts[:, 7].min() + counts[:, 7].max()) // 2
    counts[:, 7] = (counts[:, 7] + shift) % turn
    data["swivel"][1]["zero_deg"] -= data["swivel"][1]["count_sign"] * shift * 360.0 / turn
    data["swivel"][1]["zero_deg"] = (data["swivel"][1]["zero_deg"] + 180.0) % 360.0 - 180.0
    write_rig(tmp_path / "rig.toml", rig_from_dict(data))
    assert np.abs(np.diff(counts[:, 7])).max() > turn / 2
    sent, group = counts.copy(), a_group()
    sent[SILENT, 9] = UNSENT
    command = [sys.executable, "-m", "lmeasure", "record", "--rig", "rig.toml", "--out", "run", "--live", "--seconds", "60"]
    command += ["--bus", f"udp_multicast:{group['channel']}", "--bus-option", f"port={group['port']}"]
    with (
        feeding("udp_multicast", sent, RATE_HZ, group | {"hold": 1}, tmp_path) as (_, encoders),
        subprocess.Popen(command, cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process,
    ):
        while not (tmp_path / "run" / "run.toml").exists() and process.poll() is None:
            time.sleep(0.05)
        assert encoders.stdin is not None
        encoders.stdin.write("go\n")
        encoders.stdin.flush()
        # the tool rests at the end of its way until the pose has surely been found, also by a busy machine
        while (tmp_path / "run" / "pass1.csv").read_text().count("\n") < len(counts) + AT_REST and process.poll() is None:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        said, live = process.communicate()
    assert process.returncode == 0, live
    assert "note: no --start pose. The absolute encoders must determine it" in said
    assert "pose: (" in live
    run = read_run(tmp_path / "run")
    assert run.start is None
    moving, recorded = len(counts), run.passes[0].recorded
    counts = counts[np.minimum(np.arange(len(recorded)), moving - 1)]
    missing = np.full(counts.shape, fill_value=False)
    missing[SILENT, 9] = True
    np.testing.assert_array_equal(recorded, np.where(missing, np.nan, counts))
    found = reconstruct(run)
    assert (found.status == Status.OK).all()
    silent = run.rig.observed[9].name
    assert all(silent in cables.split(", ") for cables in found.cable[SILENT])
    # a feed that was held up moves a tool as none can be moved, so that what errs is judged at the instants at which the counts were made
    even = replace(run, passes=(replace(run.passes[0], time_s=np.arange(len(counts)) / RATE_HZ, u_time_s=None),))
    reported = reconstruct(even)
    assert set(reported.cable[SILENT]) == {silent}, "\n".join(map(str, reported.notes))
    truth = np.loadtxt(TRUTH / "truth.csv", delimiter=",", skiprows=1)[::5, 1:]
    assert np.abs(displacement(found.poses[:moving], truth)[:, 3:]).max() < 0.05
    # the log that was recorded, imported as if it came from elsewhere
    ran("import", tmp_path / "run" / "pass1.log", "--rig", tmp_path / "rig.toml", "--out", tmp_path / "again")
    np.testing.assert_array_equal(read_run(tmp_path / "again").passes[0].recorded, recorded)
