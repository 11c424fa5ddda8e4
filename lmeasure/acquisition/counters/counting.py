"""Counts from a source: samples, faults, and the state of things for a person, with a recording behind it or without."""

import contextlib
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.acquisition.bus.frames import Frames, no_frames
from lmeasure.acquisition.bus.network import BusWatch
from lmeasure.acquisition.bus.sources import Notice, Source
from lmeasure.acquisition.counters.assembly import new_assembler
from lmeasure.acquisition.counters.decoders import CounterField
from lmeasure.acquisition.counters.events import Event
from lmeasure.acquisition.counters.samples import Samples
from lmeasure.core import AcquisitionError, FloatArray
from lmeasure.rig import Rig
from lmeasure.text import message

TURN_S = 0.05
"""Longest time of one look at the source."""
STALE_S = 2.0
"""For how long a count stands for how things are when no other comes."""


@dataclass(frozen=True)
class Progress:
    """State of counting for a person: counts, counts/s and mm/s per channel, NaN where none came for `STALE_S`; latency_s
    from a frame's own time to its being counted, where one clock tells both."""

    seconds: float
    frames: int
    samples: int
    faults: Mapping[str, int]
    channels: tuple[str, ...]
    counts: FloatArray
    rates: FloatArray
    speeds_mm_s: FloatArray
    latency_s: float | None
    origin_s: float | None = None
    """When the first sample was, by the frames' clock."""
    events: tuple[Event, ...] = ()
    """All faults so far, as far as they are kept."""
    newest_s: float | None = None
    """When the last sample was, by the frames' clock."""
    lost: int = 0
    """Frames that came and could not be taken."""
    disk_free: int | None = None
    """Bytes that the disk still has, looked at once a second; None where nothing is written."""


class Counting:
    """The samples of a source, as they come. Everything is compiled before the constructor returns."""

    def __init__(self, rig: Rig, source: Source, fields: tuple[CounterField, ...], passage: int) -> None:
        self.rig, self.source, self.fields, self.passage = rig, source, fields, passage
        self.assembler = new_assembler(rig, fields, passage)
        self.bus = BusWatch.of_rig(rig, fields)
        self.frames = self.samples = self.lost = 0
        self.origin: float | None = None
        self._latest: Samples | None = None
        self._seen = 0, 0.0
        self._noticed: list[Notice] = []
        self._latency: float | None = None
        self._heard: float | None = None
        self._newest_s = float("nan")
        """When the last frame came, by this program's clock and by the frames'."""
        self.assembler.feed(no_frames())

    def receive(self, seconds: float) -> Frames | None:
        """What comes within the time, by microseconds, as logs have it: reading it again gives the same. None when the source has ended."""
        frames = self.source.receive(seconds)
        self._noticed += self.source.notices()
        return frames if frames is None or not len(frames) else replace(frames, time_s=np.round(frames.time_s, 6))

    def samples_of(self, frames: Frames) -> Samples:
        """The samples that frames complete."""
        self.frames += len(frames)
        self._heard, self._newest_s = time.monotonic(), float(frames.time_s[-1])
        if not self.samples:  # why none comes; afterwards nobody asks
            self.bus.feed(frames)
        self._latency = time.time() - float(frames.time_s[-1])
        return self.assembler.feed(frames)

    def took(self, samples: Samples) -> Samples:
        """Count samples that are kept; they, with their times from the first one."""
        if self.origin is None:
            self.origin = float(samples.time_s[0])
        self.tell(samples.time_s)
        self.samples += len(samples.time_s)
        self._latest = samples
        return replace(samples, time_s=samples.time_s - self.origin)

    def tell(self, time_s: FloatArray, last: bool = False) -> None:
        """Tie what happened to the source to the first sample at its time or later, among the (n,) times of new ones."""
        later = []
        for notice in self._noticed:
            row = 0 if notice.time_s is None else int(np.searchsorted(time_s, notice.time_s))
            if row == len(time_s) and not last:
                later.append(notice)
                continue
            self.lost += notice.lost
            at = notice.time_s if notice.time_s is not None else float(time_s[0]) if len(time_s) else float("nan")
            self.assembler.events.add(Event(self.samples + row, at, "", notice.kind, notice.text))
        self._noticed = later
        if last and self._heard is not None and (silent := time.monotonic() - self._heard) > STALE_S:
            self.assembler.events.add(Event(self.samples, self._newest_s, "", "pause", message("event.no_frame", seconds=silent)))

    def progress(self, seconds: float, disk_free: int | None = None) -> Progress:
        """The state of things, for a display."""
        m = len(self.fields)
        counts, rates = np.full(m, np.nan), np.full(m, np.nan)
        if self._seen[0] != self.samples:
            self._seen = self.samples, seconds
        if self._latest is not None and seconds - self._seen[1] < STALE_S:
            counts = self._latest.recorded[-1]
            span = self._latest.time_s[-1] - self._latest.time_s[0]
            if span > 0:
                rates = (self._latest.recorded[-1] - self._latest.recorded[0]) / span
        known = self.rig.counters_of(self.passage)
        channels = tuple(f.channel for f in self.fields)
        events = self.assembler.events
        return Progress(
            seconds,
            self.frames,
            self.samples,
            dict(events.tally),
            channels,
            counts,
            rates,
            rates * np.array([known[c].count_sign * known[c].per_count / known[c].scale for c in channels]),
            self._latency if self._latency is not None and 0 <= self._latency < 60 else None,
            self.origin,
            tuple(events.kept),
            None if self._latest is None else float(self._latest.time_s[-1]),
            self.lost,
            disk_free,
        )


def watch(
    rig: Rig,
    source: Source,
    fields: tuple[CounterField, ...],
    *,
    passage: int = 1,
    seconds: float | None = None,
    show: Callable[[Progress], None] = lambda state: None,
    each: Callable[[Samples], None] = lambda samples: None,
    stop: Callable[[], bool] = lambda: False,
) -> Progress:
    """Count what comes until the time is over, the source ends, `stop` says so, or Ctrl-C (or SIGTERM), and keep nothing; the last state.

    show and each as `recorder.record` has them. AcquisitionError when the source is lost, or not one sample came.
    """
    counting, begin = Counting(rig, source, fields, passage), time.monotonic()
    with asked_to_end() as asked:
        while (seconds is None or time.monotonic() - begin < seconds) and not stop() and not asked():
            frames = counting.receive(TURN_S)
            if frames is None:
                break
            if len(frames) and len((samples := counting.samples_of(frames)).time_s):
                each(counting.took(samples))
            show(counting.progress(time.monotonic() - begin))
    last = counting.assembler.feed(no_frames(), last=True)
    if len(last.time_s):
        each(counting.took(last))
    counting.tell(np.empty(0), last=True)
    if counting.samples == 0:
        raise AcquisitionError(nothing_came(counting))
    return counting.progress(time.monotonic() - begin)


def nothing_came(counting: Counting) -> str:
    """Return what is said where not one sample came."""
    channels = ", ".join(f.channel for f in counting.fields)
    why = counting.bus.silence(counting.source.bit_rate or counting.rig.can_table.bit_rate)
    return message("bus.no_sample", bus=counting.source.name, frames=counting.frames, channels=channels, why=why)


@contextlib.contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Whether Ctrl-C or SIGTERM came: looked at between two batches, so that none is lost or cut in two by it; a second one breaks off."""
    if threading.current_thread() is not threading.main_thread():
        yield lambda: False
        return
    came = False

    def note(number: int, frame: object) -> None:
        nonlocal came
        if came:
            raise KeyboardInterrupt
        came = True

    before = {number: signal.signal(number, note) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield lambda: came
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
