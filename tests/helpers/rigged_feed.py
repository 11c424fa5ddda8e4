"""A cell's frames in real time over python-can's virtual bus into the recorder, with whatever was done to the frames on the way."""

import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
from numpy.typing import NDArray

from lmeasure.acquisition import Frames, Recording, counter_fields, record
from lmeasure.acquisition.bus.feed import frames_from_counts, send, virtual_place
from lmeasure.acquisition.bus.sources import BusSource
from lmeasure.io import files
from lmeasure.recording import Counts, Run, read_run
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import Leg, cell_rig, simulate_run, smooth_path

FloatArray = NDArray[np.float64]
HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
AWAY = np.array([250.0, -200.0, 220.0, 0.0, 0.0, 0.0, 1.0])
PER_SAMPLE = 7
"""Frames of one sample: SYNC and six counters."""


def cell(**drum: Any) -> Rig:
    """The simulated cell, its drums changed alike; slow enough drums for faults of speed to show."""
    data = cell_rig(4).to_dict()
    for point in data["observation_point"]:
        point["drum"] |= {"max_cable_speed_mm_s": 2000.0} | drum
    return rig_from_dict(data)


def motion(rig: Rig, speed_mm_s: float = 1500.0, rate_hz: float = 1000.0, to: FloatArray = AWAY) -> Counts:
    """Counts of a way out that never rests."""
    time_s, poses = smooth_path(HOME, [Leg(to, speed_mm_s, 10.0)], rate_hz)
    return simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0)).run.passes[0]


def frames_of(rig: Rig, counts: Counts) -> Frames:
    """The frames of the counts: SYNC and its six answers, then the next."""
    fields = counter_fields(rig)
    return frames_from_counts(counts.time_s, np.column_stack([counts.of(f.channel) for f in fields]), fields, rig.can_table.sync_id)


def order_of(frames: Frames, order: list[int] | NDArray[np.intp]) -> Frames:
    """The frames in another order, each stamped when it comes: times stay where they were."""
    moved = frames.take(np.asarray(order, np.intp))
    return replace(moved, time_s=np.maximum.accumulate(moved.time_s))


def record_frames(
    rig: Rig, frames: Frames, folder: Path, meddle: Callable[[BusSource, float], None] | None = None, stamps: FloatArray | None = None
) -> tuple[Recording, Run, dict[str, list[Any]]]:
    """Send the frames at their times, record them, and read back what was written: the recording, the run, the events by column.

    stamps: what the interface stamps them with, default their times; meddle(source, seconds) is called while it records.
    """
    place = virtual_place()
    source = BusSource(lambda: can.Bus(interface="virtual", channel=place), f"virtual:{place}", patience_s=5.0)
    sender = can.Bus(interface="virtual", channel=place, preserve_timestamps=True)
    thread = threading.Thread(target=_send, args=(frames, frames.time_s if stamps is None else stamps, sender))
    begin = time.monotonic()
    thread.start()

    ended: list[float] = []

    def stop() -> bool:
        if meddle is not None:
            meddle(source, time.monotonic() - begin)
        if not ended and not thread.is_alive():
            ended.append(time.monotonic())
        return bool(ended) and time.monotonic() - ended[0] > 0.2

    try:
        recording = record(rig, source, counter_fields(rig), folder, start=HOME, stop=stop)
    finally:
        thread.join()
        source.close()
        sender.shutdown()
    events = folder / "pass1.events.csv"
    table = files.read_table(events) if events.exists() else None
    columns: dict[str, list[Any]] = {} if table is None else {c: table.text(c) for c in table.columns}
    return recording, read_run(folder), columns


def _send(frames: Frames, stamps: FloatArray, sender: Any) -> None:
    """Sent at their own times, stamped as if the interface had taken the stamps."""
    begin = time.perf_counter() - float(frames.time_s[0])
    group = np.flatnonzero(np.diff(frames.time_s, prepend=-np.inf) > 0)
    for a, b in zip(group, [*group[1:], len(frames)], strict=True):
        wait = begin + float(frames.time_s[a]) - time.perf_counter()
        if wait > 0:
            time.sleep(wait)
        send(replace(frames.take(slice(a, b)), time_s=stamps[a:b]), sender, paced=False)
