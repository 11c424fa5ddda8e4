"""Clocks and pauses of a bus that is recorded."""

import threading
import time
from pathlib import Path

import can
import numpy as np
import pytest
from rigged_feed import PER_SAMPLE, cell, frames_of, motion

from lmeasure.acquisition import counter_fields, range_notes, record
from lmeasure.acquisition.bus.feed import send, virtual_place
from lmeasure.acquisition.bus.sources import BusSource, SteadyClock
from lmeasure.rig import rig_from_dict

RIG = cell()


@pytest.mark.parametrize("modulus", [2**32 / 1e6, 65.536, 60.0])
def test_a_live_clock_that_starts_again_goes_on_exactly(modulus: float) -> None:
    """Its step is known to the microsecond, whatever the latency of the host."""
    arrived = np.linspace(0.0, 3.99, 400)
    stamps = (arrived + modulus - 2.0) % modulus
    clock, latency = SteadyClock(), 0.02 * np.random.default_rng(0).random(400)
    out = stamps.copy()
    for a in range(0, 400, 20):
        part = np.asarray(out[a : a + 20], np.float64).copy()
        clock.correct(part, np.asarray(arrived[a : a + 20] + latency[a : a + 20], np.float64))
        out[a : a + 20] = part
    np.testing.assert_allclose(np.diff(out), 0.01, rtol=0, atol=1e-9)


def test_a_sync_that_stops_for_two_seconds_is_said(tmp_path: Path) -> None:
    frames = frames_of(RIG, motion(RIG, 800.0, 200.0)).take(slice(0, 60 * PER_SAMPLE))
    place = virtual_place()
    source = BusSource(lambda: can.Bus(interface="virtual", channel=place), f"virtual:{place}")
    with can.Bus(interface="virtual", channel=place) as sender:

        def play() -> None:
            send(frames.take(slice(0, 30 * PER_SAMPLE)), sender, paced=True)
            time.sleep(2.0)
            send(frames.take(slice(30 * PER_SAMPLE, None)), sender, paced=True)

        thread = threading.Thread(target=play)
        thread.start()
        recording = record(RIG, source, counter_fields(RIG), tmp_path / "run", stop=lambda: not thread.is_alive())
        thread.join()
    source.close()
    assert recording.faults["pause"] == 1
    assert "pause" in recording.summary()
    assert '"pause","marked","no SYNC for ' in (tmp_path / "run" / "pass1.events.csv").read_text()


def test_counters_that_can_pass_half_their_range_are_named_before_anything_is_recorded() -> None:
    table = {"decoder": "raw", "channel": [{"channel": c, "id": 0x181 + i, "bits": 16} for i, c in enumerate(RIG.channels)]}
    fast = cell(max_cable_speed_mm_s=20000.0)
    rig = rig_from_dict(fast.to_dict() | {"can": table})
    (note,) = range_notes(rig, counter_fields(rig))
    assert note == (
        "ch1, ch2, ch3, ch4, ch5, ch6: at 20000 mm/s, 65536 counts (half the range) pass in 19.7 ms. "
        "State a smaller max_cable_speed_mm_s, or keep the SYNC period below 9 ms"
    )
    assert range_notes(rig, counter_fields(rig), period_s=0.01)
    assert not range_notes(rig, counter_fields(rig), period_s=0.005)
    assert not range_notes(fast, counter_fields(fast))
