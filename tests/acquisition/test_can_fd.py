"""Six 64-bit counters in one CAN FD frame: live over two buses, replayed and imported from every log format that keeps such frames."""

import threading
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest
from rigged_feed import HOME, cell
from test_buses import a_group, after, positions

from lmeasure.acquisition import connect, counter_fields, import_logs, read_frames, record, record_session
from lmeasure.acquisition.bus.feed import frames_from_counts, send, virtual_place
from lmeasure.acquisition.bus.frames import FD
from lmeasure.recording import read_run
from lmeasure.rig import rig_from_dict, write_rig

pytestmark = pytest.mark.live

CHANNELS = [{"channel": f"ch{i}", "id": 0x7FF, "bits": 64, "byte_offset": 8 * i, "start": i * 2**40} for i in range(1, 7)]
RIG = rig_from_dict(cell(max_cable_speed_mm_s=1e6).to_dict() | {"can": {"decoder": "raw", "channel": CHANNELS}})
FIELDS = counter_fields(RIG)
COUNTS = positions(300, 500.0).astype(np.float64)
FRAMES = frames_from_counts(np.arange(300) / 500.0, COUNTS, FIELDS, 0x80)


def test_the_frames_are_fd_frames_of_64_bytes() -> None:
    assert FRAMES.data.shape == (600, 64)
    assert (FRAMES.flags[1::2] & FD).all()
    assert (FRAMES.data[1::2, 8:56].view("<i8") == COUNTS + 2**40 * np.arange(1, 7)).all()


@pytest.mark.parametrize("interface", ["virtual", "udp_multicast"])
def test_fd_frames_are_recorded_live(interface: str, tmp_path: Path) -> None:
    bus: dict[str, Any] = a_group() if interface == "udp_multicast" else {"channel": virtual_place()}
    options = {k: v for k, v in bus.items() if k != "channel"}
    link = connect(RIG, tmp_path, f"{interface}:{bus['channel']}", options=options)
    with can.Bus(interface=interface, **bus) as sender:
        thread = threading.Thread(target=send, args=(FRAMES, sender), kwargs={"paced": True})
        thread.start()
        try:
            recording = record(RIG, link.source, link.fields, tmp_path / "run", start=HOME, stop=after(lambda: not thread.is_alive()))
        finally:
            thread.join()
            link.source.close()
    assert recording.faults == {}
    np.testing.assert_array_equal(read_run(tmp_path / "run").passes[0].recorded, COUNTS)
    # and the log beside it says the same
    again = import_logs([tmp_path / "run" / "pass1.log"], RIG, HOME)
    np.testing.assert_array_equal(again.run.passes[0].recorded, COUNTS)


@pytest.mark.parametrize("suffix", [".asc", ".mf4"])
def test_fd_logs_are_replayed_and_imported(suffix: str, tmp_path: Path) -> None:
    log = tmp_path / f"drive{suffix}"
    with can.Logger(str(log)) as logger:
        for i in range(len(FRAMES)):
            fd = bool(FRAMES.flags[i] & FD)
            data = FRAMES.data[i, : FRAMES.length[i]].tobytes()
            common: dict[str, Any] = {"is_extended_id": False, "is_fd": fd, "bitrate_switch": fd, "data": data, "channel": 0}
            logger(can.Message(timestamp=1.7e9 + float(FRAMES.time_s[i]), arbitration_id=int(FRAMES.identifier[i]), **common))
    frames, report = read_frames(log)
    assert ((frames.flags & FD) != 0).sum() == 300
    assert report.notes() == []
    imported = import_logs([log], RIG, HOME)
    np.testing.assert_array_equal(imported.run.passes[0].recorded, COUNTS)
    np.testing.assert_allclose(imported.run.passes[0].time_s, np.arange(300) / 500.0, rtol=0, atol=1e-6)
    write_rig(tmp_path / "rig.toml", RIG)
    record_session(tmp_path / "rig.toml", f"replay:{log}", tmp_path / "run", paced=False)
    np.testing.assert_array_equal(read_run(tmp_path / "run").passes[0].recorded, COUNTS)
