from pathlib import Path
from types import SimpleNamespace

import can
import numpy as np
import pytest

from lmeasure.acquisition import Pace, record_feed
from lmeasure.acquisition.bus import feed
from lmeasure.acquisition.bus.feed import BEHIND_S, CLOSEST, send
from lmeasure.acquisition.bus.frames import frames_from_messages
from lmeasure.core import AcquisitionError
from lmeasure.recording import Counts, read_run
from lmeasure.rig import rig_from_dict
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

TRUTH = Path(__file__).parent.parent / "authorities" / "truth"
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])


@pytest.mark.parametrize("name", ["cell-run", "cell-run-16-bit", "three-drums-two-passes"])
def test_recorded_runs_cross_the_bus_bit_for_bit(name: str) -> None:
    run = read_run(TRUTH / name)
    for number, counts in enumerate(run.passes, 1):
        got = record_feed(run.rig, counts, number)
        np.testing.assert_array_equal(got.counts.recorded, np.column_stack([counts.of(c) for c in got.counts.channels]))
        np.testing.assert_array_equal(got.counts.time_s, counts.time_s)
        assert got.frames == len(counts.time_s) * (1 + len(counts.channels))
        assert set(got.events.tally) <= {"wrap"}


TABLES = {
    "shared frames, big endian": [
        {"channel": f"ch{i}", "id": 0x200 + i // 2, "byte_offset": 4 * (i % 2), "byte_order": "big"} for i in range(1, 7)
    ],
    "16 bits at an offset, extended": [
        {"channel": f"ch{i}", "id": 0x18FF0000 + i, "extended": True, "bits": 16, "byte_offset": 3, "signed": i % 2 == 0, "start": 700 * i}
        for i in range(1, 7)
    ],
    "24 bits, half units": [{"channel": f"ch{i}", "id": 0x300 + i, "bits": 24, "scale": 0.5} for i in range(1, 7)],
    "64 bits in one FD frame": [{"channel": f"ch{i}", "id": 0x7FF, "bits": 64, "byte_offset": 8 * i} for i in range(1, 7)],
    "own range": [{"channel": f"ch{i}", "id": 0x300 + i, "signed": False, "range": 36000, "start": 35990} for i in range(1, 7)],
}


@pytest.mark.parametrize("name", TABLES)
def test_every_layout_carries_the_counts(name: str) -> None:
    rig = cell_rig(3)
    rig = rig_from_dict(rig.to_dict() | {"can": {"decoder": "raw", "sync_id": 0x85, "channel": TABLES[name]}})
    far = np.array([300.0, -300.0, 250.0, 0.0, 0.0, 0.0, 1.0])
    time_s, poses = smooth_path(HOME, [Leg(far, 2000.0), Leg(HOME, 2000.0)], 500.0)
    counts = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0)).run.passes[0]
    got = record_feed(rig, counts)
    np.testing.assert_array_equal(got.counts.recorded, counts.recorded)
    assert set(got.events.tally) <= {"wrap"}
    # the stroke passes the ends of the short counters, so the wraps were there to undo
    assert (np.abs(counts.recorded).max() > 2**15) == ("wrap" in got.events.tally) or name not in {
        "16 bits at an offset, extended",
        "own range",
    }


def test_a_missing_count_is_not_sent() -> None:
    rig = cell_rig(0)
    recorded = np.zeros((3, 6))
    recorded[1, 2] = np.nan
    with pytest.raises(AcquisitionError, match="sample 1: has no count"):
        record_feed(rig, Counts(np.arange(3.0), rig.channels, recorded))


def test_rows_behind_a_late_one_catch_up_and_never_come_all_at_once() -> None:
    """By a clock whose sleep, or what sends, is late now and then: as many rows as were asked for; after a long sleep, not those of it."""
    now, late, slow = 0.0, {100: 0.02, 101: 0.004, 3000: 20.0}, {500: 0.05, 501: 0.03}

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds + late.get(len(sent), 0.0)

    sent: list[float] = []
    pace = Pace(1000.0, lambda: now, sleep)
    for i in range(6000):
        pace.wait()
        now += slow.get(i, 0.0)
        sent.append(now)
    apart = np.diff(sent)
    assert apart.min() >= CLOSEST / 1000.0 - 1e-9
    assert apart.max() >= 20.0
    at = [99, 300, 800, 2999]
    np.testing.assert_allclose(np.array(sent)[at], 0.0005 + 0.001 * np.array(at), atol=0.00051)
    # half a second of the sleep is caught up with, twice as fast
    assert sent[-1] - sent[3000] == pytest.approx(2.998 - BEHIND_S, abs=0.001)


def test_frames_that_were_kept_waiting_follow_each_other_at_up_to_twice_their_pace(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that is busy for a third of a second: without, sixty samples came at once, and drums seemed to turn at any speed."""
    now = 0.0
    sent: list[float] = []

    def sleep(seconds: float) -> None:
        nonlocal now
        now += seconds

    def taken(message: can.Message) -> None:
        nonlocal now
        now += 0.3 if len(sent) == 20 else 0.0
        sent.append(now)

    monkeypatch.setattr(feed, "time", SimpleNamespace(perf_counter=lambda: now, sleep=sleep))
    frames = frames_from_messages(can.Message(timestamp=0.005 * i, arbitration_id=0x80) for i in range(200))
    assert send(frames, SimpleNamespace(send=taken), paced=True) == 200  # type: ignore[arg-type]
    np.testing.assert_allclose(np.array(sent)[[19, 199]], [0.095, 0.995])
    assert np.diff(sent).min() == pytest.approx(CLOSEST * 0.005)
