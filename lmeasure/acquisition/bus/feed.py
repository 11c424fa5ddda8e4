"""A simulated feed: recorded counts as the frames that encoders would send, on a real python-can bus."""

import itertools
import threading
import time
from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np

from lmeasure.acquisition.bus.frames import CLASSIC_BYTES, EXTENDED, FD, FD_BYTES, Frames, frames_from_messages, messages_from_frames
from lmeasure.acquisition.counters.assembly import Assembled, counts_from_frames
from lmeasure.acquisition.counters.decoders import CounterField, counter_fields, encode
from lmeasure.core import AcquisitionError, FloatArray
from lmeasure.recording import Counts
from lmeasure.rig import Rig
from lmeasure.text import message

if TYPE_CHECKING:
    import can


FD_LENGTHS = np.array([*range(9), 12, 16, 20, 24, 32, 48, 64])
"""Data lengths a frame can have."""

CLOSEST = 0.5
"""Smallest part of the time between two rows: rows that catch up behind a late one come no closer."""
BEHIND_S = 0.5
"""Largest delay of a row for those behind it to catch up: a machine that slept does not hurry."""

_places = itertools.count()


def frames_from_counts(time_s: FloatArray, recorded: FloatArray, fields: tuple[CounterField, ...], sync_id: int) -> Frames:
    """Return a SYNC for each of (n,) times, then one frame per field with its count of (n, m), all stamped with that time.

    Counts are whole; channels that share an identifier share the frame. AcquisitionError where a count is missing, or a field is no plain
    integer.
    """
    if not np.isfinite(recorded).all():
        raise AcquisitionError(message("error.sample_has_no_count", row=int(np.argmax(~np.isfinite(recorded).all(axis=1)))))
    for f in fields:
        if f.reader is not None:
            raise AcquisitionError(message("error.channel_multiplexed_and_floating", channel=f.channel))
    n = len(time_s)
    frames: dict[tuple[int, bool], list[int]] = {}
    for i, f in enumerate(fields):
        frames.setdefault((f.identifier, f.extended), []).append(i)
    lengths = [int(FD_LENGTHS[np.searchsorted(FD_LENGTHS, max(fields[i].bytes_needed for i in shared))]) for shared in frames.values()]
    width = FD_BYTES if max(lengths) > CLASSIC_BYTES else CLASSIC_BYTES
    per = 1 + len(frames)
    data = np.zeros((n, per, width), np.uint8)
    for j, shared in enumerate(frames.values(), 1):
        for i in shared:
            f = fields[i]
            values = np.rint(recorded[:, i] / f.scale).astype(np.int64) + f.start
            encode(values if f.modulus >= 2**62 else values % f.modulus, f, data[:, j])
    flags = [0] + [(EXTENDED if e else 0) | (FD if length > CLASSIC_BYTES else 0) for (_, e), length in zip(frames, lengths, strict=True)]
    return Frames(
        np.repeat(time_s, per),
        np.tile(np.array([sync_id] + [identifier for identifier, _ in frames], np.uint32), n),
        np.tile(np.array(flags, np.uint8), n),
        np.tile(np.array([0, *lengths], np.uint8), n),
        data.reshape(n * per, width),
        np.zeros(n * per, np.int16),
        source="simulated feed",
    )


def send(frames: Frames, bus: "can.BusABC", *, paced: bool, stop: threading.Event | None = None) -> int:
    """Send the frames in their order, at their own times when paced, else as fast as the bus takes them; how many were sent.

    Where the machine has kept this program waiting, paced frames follow each other at up to twice their pace until they are in time again.
    """
    begin = time.perf_counter()
    last = first = float(frames.time_s[0]) if len(frames) else 0.0
    sent = 0
    for one in messages_from_frames(frames):
        if stop is not None and stop.is_set():
            break
        if paced:
            wait = max(one.timestamp - first - (time.perf_counter() - begin), CLOSEST * (one.timestamp - last))
            if wait > 0:
                time.sleep(wait)
            last = one.timestamp
        bus.send(one)
        sent += 1
    return sent


class Pace:
    """Times of rows at a fixed rate from now on; now and sleep are the clock."""

    def __init__(self, rate_hz: float, now: Callable[[], float] = time.perf_counter, sleep: Callable[[float], None] = time.sleep) -> None:
        self._period, self._now, self._sleep = 1.0 / rate_hz, now, sleep
        self._due = now()

    def wait(self) -> None:
        """Wait until the next row is due. After a delay by the machine, rows come at up to twice the rate until they are in time again: a
        minute has all its rows, and no drum seems to turn twenty times as fast."""
        sent = self._now()  # the row before, wherever this program was kept waiting while it was sent
        self._sleep(max(self._due - sent, CLOSEST * self._period))
        self._due = max(self._due + self._period, self._now() - BEHIND_S)


def play(rows: FloatArray, fields: tuple[CounterField, ...], sync_id: int, bus: "can.BusABC", *, pace: Pace) -> None:
    """Send rows of counts (n, m) one by one when they are due, a SYNC and its answers each."""
    messages = list(messages_from_frames(frames_from_counts(np.arange(len(rows), dtype=np.float64), rows, fields, sync_id)))
    per = len(messages) // len(rows)
    for k in range(len(rows)):
        pace.wait()
        for one in messages[k * per : (k + 1) * per]:
            bus.send(one)


def virtual_place() -> str:
    """Return a channel of python-can's virtual bus that is unused in this process."""
    return f"lmeasure-feed-{next(_places)}"


def record_feed(rig: Rig, counts: Counts, passage: int = 1, progress: Callable[[int, int], None] | None = None) -> Assembled:
    """Send a pass of simulated counts over python-can's virtual bus from a thread and assemble the frames that arrive on its other side.

    The frames keep the simulation's times, and count as those of a log. AcquisitionError when the feed stops before its last frame.
    """
    from lmeasure.acquisition.bus.python_can import can

    fields = counter_fields(rig, passage)
    recorded = np.column_stack([counts.of(f.channel) for f in fields])
    frames = frames_from_counts(counts.time_s, recorded, fields, rig.can_table.sync_id)
    name = virtual_place()
    stop = threading.Event()
    with (
        can.Bus(interface="virtual", channel=name) as receiver,
        can.Bus(interface="virtual", channel=name, preserve_timestamps=True) as sender,
    ):
        thread = threading.Thread(target=send, args=(frames, sender), kwargs={"paced": False, "stop": stop}, daemon=True)
        thread.start()
        try:
            return counts_from_frames(rig, _received(receiver, len(frames), progress), fields, passage, source="simulated feed")
        finally:
            stop.set()
            thread.join()


def _received(bus: "can.BusABC", expected: int, progress: Callable[[int, int], None] | None) -> Iterator[Frames]:
    got = 0
    while got < expected:
        batch: list[can.Message] = []
        while len(batch) < min(8192, expected - got):
            received = bus.recv(10.0)
            if received is None:
                raise AcquisitionError(message("error.simulated_feed_nothing_came", got=got + len(batch), expected=expected))
            batch.append(received)
        got += len(batch)
        if progress is not None:
            progress(got, expected)
        yield frames_from_messages(batch, "log", "simulated feed")
