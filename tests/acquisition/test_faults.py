"""Every fault on the real path: frames over a bus into the recorder, and what the run folder then says."""

import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rigged_feed import PER_SAMPLE, cell, frames_of, motion, record_frames

from lmeasure.acquisition.bus import sources
from lmeasure.acquisition.bus.frames import frames_from_messages, join
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.io import files
from lmeasure.rig import rig_from_dict

pytestmark = pytest.mark.live

RIG = cell()
COUNTS = motion(RIG)
FRAMES = frames_of(RIG, COUNTS)
N = len(COUNTS.time_s)


def at(sample: int, channel: int = 0) -> int:
    """Position of a frame: channel 1 to 6, 0 the SYNC."""
    return PER_SAMPLE * sample + channel


def test_nothing_happens_and_nothing_is_flagged(tmp_path: Path) -> None:
    recording, run, events = record_frames(RIG, FRAMES, tmp_path / "run")
    np.testing.assert_array_equal(run.passes[0].recorded, COUNTS.recorded)
    np.testing.assert_allclose(run.passes[0].time_s, COUNTS.time_s, rtol=0, atol=1.1e-6)
    assert (recording.ended, recording.frames, events) == ("complete", len(FRAMES), {})
    assert "missing" not in recording.summary()


def test_dropped_frames_leave_empty_cells(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    lost = rng.choice(N - 2, 20, replace=False)
    channels = rng.integers(1, 7, 20)
    kept = np.ones(len(FRAMES), np.bool_)
    kept[[at(int(s), int(c)) for s, c in zip(lost, channels, strict=True)]] = False
    recording, run, events = record_frames(RIG, FRAMES.take(kept), tmp_path / "run")
    want = COUNTS.recorded.copy()
    want[lost, channels - 1] = np.nan
    np.testing.assert_array_equal(run.passes[0].recorded, want)
    assert recording.faults == {"gap": 20, "gap_step": 20}
    each = {f"ch{c}": n for c in range(1, 7) if (n := int((channels == c).sum()))}
    assert recording.missing == each
    line = ", ".join(f"{c} in {n}" for c, n in each.items())
    assert f"{line} of {N} samples have no counts: check the encoder, its plug and its cable" in recording.summary().splitlines()
    np.testing.assert_allclose([float(t) for t in events["time_s"]], run.passes[0].time_s[[int(s) for s in events["sample"]]], atol=2e-6)
    rows = list(zip(events["kind"], events["sample"], events["channel"], events["outcome"], strict=True))
    reported = {(int(s), c) for kind, s, c, outcome in rows if kind == "gap" and outcome == "marked"}
    assert reported == {(int(s), f"ch{c}") for s, c in zip(lost, channels, strict=True)}


def test_the_bus_goes_off_and_comes_back(tmp_path: Path) -> None:
    broken: list[float] = []

    def pull_the_plug(source: BusSource, seconds: float) -> None:
        if seconds > 0.15 and not broken:
            broken.append(seconds)
            source.bus.shutdown()

    recording, run, events = record_frames(RIG, FRAMES, tmp_path / "run", pull_the_plug)
    assert recording.ended == "complete"
    assert recording.faults["bus_off"] == 1
    assert "It was opened again after" in events["text"][events["kind"].index("bus_off")]
    counts = run.passes[0]
    # what is there is right, at its own time, on both sides of the hole
    sample = np.rint((counts.time_s + 0.0) * 1000).astype(int)
    present = np.isfinite(counts.recorded)
    np.testing.assert_array_equal(counts.recorded[present], COUNTS.recorded[sample][present])
    assert sample[-1] == N - 1
    assert present.all(axis=1).sum() > N // 2


def test_frames_that_are_not_taken_in_time_are_counted_as_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "MOST_WAITING", 100 * PER_SAMPLE)
    held: list[float] = []

    def be_busy(source: BusSource, seconds: float) -> None:
        if seconds > 0.05 and not held:
            held.append(seconds)
            time.sleep(0.25)

    recording, run, events = record_frames(RIG, FRAMES, tmp_path / "run", be_busy)
    said = files.read_toml(tmp_path / "run" / "run.toml")["recording"][0]
    assert said["frames_lost"] > 50 * PER_SAMPLE
    assert said["frames_lost"] + recording.frames == len(FRAMES)
    assert recording.faults["overflow"] == events["kind"].count("overflow")
    # what is there is right, and the flag stands on the first sample behind the hole
    counts = run.passes[0]
    sample = np.rint(counts.time_s * 1000).astype(int)
    present = np.isfinite(counts.recorded)
    np.testing.assert_array_equal(counts.recorded[present], COUNTS.recorded[sample][present])
    lost = [
        (int(s), int(text.split()[0]))
        for s, kind, text in zip(*(events[c] for c in ("sample", "kind", "text")), strict=True)
        if kind == "overflow"
    ]
    assert sum(n for _, n in lost) == said["frames_lost"]
    assert lost[0][0] == int(np.argmax(np.diff(sample) > 40)) + 1


def test_an_encoder_that_starts_again_is_not_trusted_any_more(tmp_path: Path) -> None:
    changed = COUNTS.recorded.copy()
    s = int(np.argmax(np.abs(changed[:, 2]) > 3000))
    changed[s:, 2] -= changed[s, 2]
    recording, run, events = record_frames(RIG, frames_of(RIG, replace(COUNTS, recorded=changed)), tmp_path / "run")
    want = COUNTS.recorded.copy()
    want[s:, 2] = np.nan
    np.testing.assert_array_equal(run.passes[0].recorded, want)
    assert recording.faults["reset"] == 1
    assert (int(events["sample"][events["kind"].index("reset")]), events["channel"][events["kind"].index("reset")]) == (s, "ch3")


def test_sixteen_bits_wrap_at_full_speed(tmp_path: Path) -> None:
    rig = cell(max_cable_speed_mm_s=20000.0)
    table = {"decoder": "raw", "channel": [{"channel": c, "id": 0x181 + i, "bits": 16} for i, c in enumerate(rig.channels)]}
    rig = rig_from_dict(rig.to_dict() | {"can": table})
    # twice through the range of 65536 counts within 0.2 s at the drum's limit of 20 m/s, 1666 counts per sample
    steps = np.full((120, 6), 1660.0) * np.where(np.arange(6) % 2, -1.0, 1.0)
    recorded = np.cumsum(np.vstack([np.zeros((1, 6)), steps]), axis=0)
    counts = replace(COUNTS, time_s=np.arange(121) / 1000.0, recorded=recorded)
    recording, run, _ = record_frames(rig, frames_of(rig, counts), tmp_path / "run")
    np.testing.assert_array_equal(run.passes[0].recorded, recorded)
    assert recording.faults == {"wrap": 18}


def test_a_stuck_channel_is_marked_from_where_it_sticks(tmp_path: Path) -> None:
    slow = motion(RIG, speed_mm_s=400.0, rate_hz=250.0)
    changed = slow.recorded.copy()
    s = len(changed) // 4
    changed[s:, 4] = changed[s, 4]
    recording, run, events = record_frames(RIG, frames_of(RIG, replace(slow, recorded=changed)), tmp_path / "run")
    got = run.passes[0].recorded
    assert recording.faults == {"stall": 1}
    np.testing.assert_array_equal(np.delete(got, 4, axis=1), np.delete(slow.recorded, 4, axis=1))
    np.testing.assert_array_equal(got[:s, 4], slow.recorded[:s, 4])
    assert s <= int(events["sample"][0]) <= s + 2
    assert float(events["time_s"][0]) == pytest.approx(run.passes[0].time_s[int(events["sample"][0])], abs=2e-6)
    assert np.isnan(got[s + 2 :, 4]).all()


def test_emergencies_and_states_are_told_with_their_channel(tmp_path: Path) -> None:
    import can

    said = frames_from_messages(
        [
            can.Message(arbitration_id=0x83, is_extended_id=False, data=[0x10, 0x42, 0x09, 0, 0, 0, 0, 0]),
            can.Message(arbitration_id=0x706, is_extended_id=False, data=[5]),
            can.Message(arbitration_id=0x706, is_extended_id=False, data=[4]),
            can.Message(arbitration_id=0x04, is_error_frame=True, is_extended_id=False, data=[0, 0x20, 0, 0, 0, 0, 0, 0]),
        ]
    )
    middle = at(N // 2, 6) + 1
    said = replace(said, time_s=np.full(4, FRAMES.time_s[middle - 1]))
    recording, run, events = record_frames(
        RIG, join([FRAMES.take(slice(middle)), said, FRAMES.take(slice(middle, None))]), tmp_path / "run"
    )
    np.testing.assert_array_equal(run.passes[0].recorded, COUNTS.recorded)
    assert recording.faults == {"emcy": 1, "heartbeat": 1, "error_passive": 1}
    assert "error frame of class 004h (controller), data 0020000000000000" in events["text"]
    emcy = events["kind"].index("emcy")
    assert events["channel"][emcy] == "ch3"
    assert events["text"][emcy] == "node 3: code 4210h (temperature), register 09h"
    assert int(events["sample"][emcy]) == N // 2 + 1


@pytest.mark.parametrize("step_s", [-7.0, 3600.0])
def test_a_clock_that_is_set_does_not_move_the_samples(step_s: float, tmp_path: Path) -> None:
    stamps = 1.7e9 + FRAMES.time_s + np.where(np.arange(len(FRAMES)) >= at(N // 2, 3), step_s, 0.0)
    recording, run, events = record_frames(RIG, FRAMES, tmp_path / "run", stamps=stamps)
    np.testing.assert_array_equal(run.passes[0].recorded, COUNTS.recorded)
    assert recording.faults == {"clock_step": 1}
    assert float(events["text"][0].split("moved by ")[1].split()[0]) == pytest.approx(step_s, abs=0.05)
    # to the latency of this host, which is not this program's to bound
    np.testing.assert_allclose(run.passes[0].time_s, COUNTS.time_s, rtol=0, atol=0.05)


def test_a_start_that_is_stated_while_it_records_is_kept(tmp_path: Path) -> None:
    """By a page or an editor; the recording's end writes run.toml anew."""
    folder = tmp_path / "run"

    def state(_: BusSource, seconds: float) -> None:
        path = folder / "run.toml"
        files.write_toml(path, files.read_toml(path) | {"start": {"position_mm": [1.0, 2.0, 3.0], "quaternion_xyzw": [0.0, 0.0, 0.0, 1.0]}})

    _, run, _ = record_frames(RIG, FRAMES, folder, meddle=state)
    assert run.start is not None
    assert run.start[:3].tolist() == [1.0, 2.0, 3.0]
    assert files.read_toml(folder / "run.toml")["recording"][0]["ended"] == "complete"
