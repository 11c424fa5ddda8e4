"""The recorder: raw frames and decoded counts, appended as they come, into a run folder that can be read at any moment.

pass1.log holds the frames as candump writes them (microseconds), pass1.csv the counts; both grow by whole lines and are on the disk once a
second. run.toml is there from the first moment and states `ended = "early"` until the recording is closed.
"""

import contextlib
import os
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.acquisition.bus.frames import BITRATE_SWITCH, CLASSED, ERROR, ERROR_STATE, EXTENDED, FD, REMOTE, SENT, Frames, each, no_frames
from lmeasure.acquisition.bus.network import BusWatch
from lmeasure.acquisition.bus.sources import Notice, Source
from lmeasure.acquisition.counters.assembly import new_assembler
from lmeasure.acquisition.counters.decoders import CounterField
from lmeasure.acquisition.counters.events import Event, event_columns
from lmeasure.acquisition.counters.samples import Samples
from lmeasure.acquisition.counters.stalls import mark_stalls
from lmeasure.core import AcquisitionError, FloatArray, LMeasureError, RecordedError, version_of
from lmeasure.io import files
from lmeasure.recording import SCHEMA, closure_counts, read_counts, write_counts
from lmeasure.rig import Rig, read_rig, write_rig
from lmeasure.text import Lines, count_of, message

TURN_S = 0.05
"""Longest time of one look at the source."""
STALE_S = 2.0
"""Longest time for which a count is current if no other comes."""


@dataclass(frozen=True)
class Progress:
    """State of counting for a display: counts, counts/s and mm/s per channel, NaN where none came for `STALE_S`; latency_s from a frame's
    own time to its count, if one clock measures both."""

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
    """Time of the first sample, by the frames' clock."""
    events: tuple[Event, ...] = ()
    """All faults so far, as far as they are kept."""
    newest_s: float | None = None
    """Time of the last sample, by the frames' clock."""
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
        """Times of the last frame, by this program's clock and by the frames'."""
        self.assembler.feed(no_frames())

    def receive(self, seconds: float) -> Frames | None:
        """Return the frames of the next seconds, in microseconds as in logs, so that reading them again gives the same. None at the
        source's end."""
        frames = self.source.receive(seconds)
        self._noticed += self.source.notices()
        return frames if frames is None or not len(frames) else replace(frames, time_s=np.round(frames.time_s, 6))

    def samples_of(self, frames: Frames) -> Samples:
        """The samples that frames complete."""
        self.frames += len(frames)
        self._heard, self._newest_s = time.monotonic(), float(frames.time_s[-1])
        if not self.samples:  # the reason for no samples; it has no use later
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
        """Tie an event of the source to the first sample at its time or later, among the (n,) times of new ones."""
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
    """Count without recording until the time is over, the source ends, `stop` is true, or Ctrl-C (or SIGTERM); return the last state.

    show and each as in `recorder.record`. AcquisitionError if the source is lost, or no sample came.
    """
    counting, begin = Counting(rig, source, fields, passage), time.monotonic()
    with asked_to_end() as requested:
        while (seconds is None or time.monotonic() - begin < seconds) and not stop() and not requested():
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
    """Return the message of a recording without a sample."""
    channels = ", ".join(f.channel for f in counting.fields)
    why = counting.bus.silence(counting.source.bit_rate or counting.rig.can_table.bit_rate)
    return message("bus.no_sample", bus=counting.source.name, frames=counting.frames, channels=channels, why=why)


@contextlib.contextmanager
def asked_to_end() -> Iterator[Callable[[], bool]]:
    """Catch Ctrl-C and SIGTERM and report them between two batches, so that none is lost or cut in two; a second one breaks off."""
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


ERROR_FLAG, BUS_ERROR = 0x20000000, 0x80
"""Bit of an error frame's identifier in candump's logs, and its class for errors of the bus."""


def candump_lines(frames: Frames) -> bytes:
    """The frames as lines of candump, which python-can and can-utils read."""
    names = ["".join(c if (c.isascii() and c.isalnum()) or c in "._-" else "_" for c in name) or "can0" for name in frames.buses]
    names = [f"can{name}" if name.isdigit() else name for name in names]
    lines = []
    for t, identifier, flags, length, data, channel in each(frames):
        if flags & ERROR:
            # without a class the one that python-can takes for an error frame
            shown = ERROR_FLAG | (identifier if flags & CLASSED and identifier else BUS_ERROR)
            lines.append(f"({t:.6f}) {names[channel]} {shown:08X}#{data[:length].tobytes().hex().upper()}\n")
            continue
        arbitration = f"{identifier:08X}" if flags & EXTENDED else f"{identifier:03X}"
        direction = "T" if flags & SENT else "R"
        if flags & REMOTE:
            body = f"#R{length}"
        elif flags & FD:
            body = f"##{(1 if flags & BITRATE_SWITCH else 0) | (2 if flags & ERROR_STATE else 0):X}{data[:length].tobytes().hex().upper()}"
        else:
            body = f"#{data[:length].tobytes().hex().upper()}"
        lines.append(f"({t:.6f}) {names[channel]} {arbitration}{body} {direction}\n")
    return "".join(lines).encode("ascii")


def count_lines(samples: Samples, origin_s: float) -> bytes:
    """Samples as lines of a counts file; an empty cell where there is no count."""
    times = np.round(samples.time_s - origin_s, 6).tolist()
    columns = [samples.recorded, *(extra[:, None] for extra in (samples.start_input, samples.u_time_s) if extra is not None)]
    if samples.frames is not None:
        own, at_s = samples.frames
        columns += [np.round(at_s - origin_s, 6), own]
    rows = np.hstack(columns).tolist()
    return "".join(f"{t!r}," + ",".join(map(_cell, row)) + "\n" for t, row in zip(times, rows, strict=True)).encode("ascii")


def _cell(value: float) -> str:
    if value != value:  # NaN
        return ""
    return str(int(value)) if value.is_integer() else repr(value)


class Appended:
    """A file that grows by whole pieces: a piece that the disk does not take is taken off again, and the file is closed to more."""

    def __init__(self, path: Path) -> None:
        self._file = path.open("xb", buffering=0)
        self._size = 0
        self._failed: OSError | None = None

    def append(self, data: bytes) -> None:
        """Write all of it; OSError when it cannot be written, and from then on."""
        if self._failed is not None:
            raise self._failed
        view = memoryview(data)
        try:
            while view:
                view = view[self._file.write(view) :]
        except OSError as error:
            self._failed = OSError(error.errno, error.strerror, str(self._file.name))
            self._file.truncate(self._size)
            raise self._failed from error
        self._size += len(data)

    def to_disk(self) -> None:
        """Return when the disk has it."""
        os.fsync(self._file.fileno())

    def close(self) -> None:
        """No more."""
        self._file.close()


ON_DISK_EVERY_S = 1.0


@dataclass(frozen=True)
class Recording:
    """A closed recording: its folder, how it ended, the numbers of frames and samples, faults by kind, the closure per channel
    [counts]: the mean of the last rest minus that of the first, where the recording begins and ends at rest; and how many samples have no
    count of a channel, where there are any."""

    folder: Path
    ended: str
    frames: int
    samples: int
    seconds: float
    faults: Mapping[str, int]
    closure: Mapping[str, float]
    missing: Mapping[str, int] = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    """Steps that gaps may hide, and ranges of values that the counts contradict."""

    @property
    def _advice(self) -> str:
        """Return advice about missing counts."""
        if self.faults.get("lost_wrap"):
            return message("acquisition.counter_may_have_passed")
        return message("acquisition.look_encoder_plug_cable")

    def summary(self) -> str:
        """A few lines for a person."""
        counted = tuple(count_of(kind, n) for kind, n in sorted(self.faults.items()))
        faults = counted or message("acquisition.no_faults")
        lines: list[str] = [
            message("acquisition.samples_from_frames_over", samples=self.samples, frames=self.frames, seconds=self.seconds, faults=faults)
        ]
        if self.missing:
            reported = tuple(message("acquisition.channel_in", channel=channel, n=n) for channel, n in self.missing.items())
            lines.append(message("acquisition.counts_missing_samples", reported=reported, samples=self.samples, advice=self._advice))
        lines += self.notes
        if self.closure:
            differ = ", ".join(f"{c} {v:+.1f}" for c, v in self.closure.items())
            lines.append(message("acquisition.rest_both_ends_last", counts=differ))
        return Lines(lines)


def record(
    rig: Rig,
    source: Source,
    fields: tuple[CounterField, ...],
    folder: Path,
    *,
    start: FloatArray | None = None,
    passage: int = 1,
    seconds: float | None = None,
    devices: list[dict[str, Any]] | None = None,
    beside: Mapping[str, bytes] | None = None,
    show: Callable[[Progress], None] | None = None,
    each: Callable[[Samples], None] | None = None,
    stop: Callable[[], bool] = lambda: False,
) -> Recording:
    """Record a pass from the source into the run folder until the time is over, the source ends, `stop` is true, or Ctrl-C (or SIGTERM).

    start (7,): the pose at which the counters were zeroed, None if it is unknown; that of pass 1 is also that of later ones. devices:
    identities for the manifest. beside: files that the rig names, such as its calibration, which are copied into the folder. show gets the
    state at every turn, each the new samples, with times from the first one as in the file. A lost source, a broken log or a full disk ends
    the recording early: earlier samples are kept, and the text gives the reason. AcquisitionError if no sample came.
    """
    writer = _Writer(folder, rig, fields, passage, start=start, source=source, devices=devices or [], beside=beside or {}, each=each)
    ended = "complete"
    begin = time.monotonic()
    try:
        with asked_to_end() as requested:
            while (seconds is None or time.monotonic() - begin < seconds) and not stop() and not requested():
                if not writer.take(TURN_S):
                    break
                if show is not None:
                    show(writer.progress(time.monotonic() - begin))
        writer.take(0.0)  # frames received so far
        if show is not None:
            show(writer.progress(time.monotonic() - begin))
    except LMeasureError as error:
        ended = str(error)
    except OSError as error:
        ended = files.not_written(Path(error.filename), error) if error.filename else " ".join(str(error).split())
    return writer.close(ended)


class _Writer:
    """The files of a recording while it grows."""

    def __init__(
        self,
        folder: Path,
        rig: Rig,
        fields: tuple[CounterField, ...],
        passage: int,
        *,
        start: FloatArray | None,
        source: Source,
        devices: list[dict[str, Any]],
        beside: Mapping[str, bytes],
        each: Callable[[Samples], None] | None,
    ) -> None:
        self._each = each
        self.folder, self.rig, self.passage, self.source = Path(folder), rig, passage, source
        self._synced = time.monotonic()
        self._free: int | None = None
        self._before = {self.folder / name: _content(self.folder / name) for name in ("rig.toml", "run.toml", *beside)}
        self._table = self._manifest(start, devices, beside)
        self.counting = Counting(rig, source, fields, passage)
        try:
            files.make_folder(self.folder)
            self._log = self._begun(f"pass{passage}.log")
            self._csv = self._begun(f"pass{passage}.csv")
            extra = ["sync"] * (rig.can_table.start_input is not None)
            if rig.can_table.timing == "free":
                extra += ["u_time_s", *(f"{f.channel}{end}" for end in ("_time_s", "_frame") for f in fields)]
            self._csv.append((",".join(["time_s", *(f.channel for f in fields), *extra]) + "\n").encode())
            for name, content in beside.items():
                files.write_bytes(self.folder / name, content)
            write_rig(self.folder / "rig.toml", rig)
            files.write_toml(self.folder / "run.toml", self._table)
        except OSError as error:
            self._take_back()
            there = isinstance(error, FileExistsError) and self.folder.is_dir()
            path = Path(error.filename or folder)
            if there:
                raise RecordedError(_kept(path)) from error
            raise AcquisitionError(files.not_written(path, error)) from error
        except LMeasureError:
            self._take_back()
            raise

    def _begun(self, name: str) -> "Appended":
        file = Appended(self.folder / name)
        self._before[self.folder / name] = None
        return file

    def _take_back(self) -> None:
        """The folder as it was before: a recording without a sample leaves nothing behind, and takes nothing from an earlier pass."""
        for path, content in self._before.items():
            with contextlib.suppress(OSError, LMeasureError):
                if content is None:
                    path.unlink(missing_ok=True)
                elif path.read_bytes() != content:
                    files.write_bytes(path, content)
        with contextlib.suppress(OSError):
            self.folder.rmdir()

    def _manifest(self, start: FloatArray | None, devices: list[dict[str, Any]], beside: Mapping[str, bytes]) -> dict[str, Any]:
        path = self.folder / "run.toml"
        if self.passage > 1:
            table: dict[str, Any] = files.read_toml(path)
            earlier = read_rig(self.folder / "rig.toml")
            if earlier.model_copy(update={"can": None}) != self.rig.model_copy(update={"can": None}):
                raise AcquisitionError(message("error.is_another_rig_than", where=self.folder / "rig.toml", passage=self.passage))
            if len(table.get("pass", [])) != self.passage - 1:
                raise AcquisitionError(
                    message("error.has_passes_pass_cannot", where=path, n_get=len(table.get("pass", [])), passage=self.passage)
                )
        else:
            for name in ("run.toml", "rig.toml", *beside):
                there = self._before[self.folder / name]
                if there is not None and there != beside.get(name):
                    raise RecordedError(_kept(self.folder / name))
            table = {"schema": SCHEMA, "rig": "rig.toml"}
            if start is not None:
                table["start"] = {"position_mm": start[:3].tolist(), "quaternion_xyzw": start[3:].tolist()}
            table |= {"pass": [], "recording": []}
        table["pass"] = [*table["pass"], {"counts": f"pass{self.passage}.csv"}]
        entry: dict[str, Any] = {
            "pass": self.passage,
            "ended": "early",
            "started": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "bus": self.source.name,
            "timestamps": self.source.timestamp_source,
            "software": f"lmeasure {version_of('lmeasure')}",
            "frames": f"pass{self.passage}.log",
            "devices": devices,
        }
        if self.source.bit_rate is not None:
            entry["bit_rate"] = self.source.bit_rate
        table["recording"] = [*table.get("recording", []), entry]
        return table

    def take(self, seconds: float) -> bool:
        """Append the frames of the next seconds and the samples that they complete; False at the source's end."""
        frames = self.counting.receive(seconds)
        if frames is not None:
            self._write(frames)
        return frames is not None

    def _write(self, frames: Frames) -> None:
        if len(frames):
            # on the disk before it is counted
            self._log.append(candump_lines(frames))
            self._append(self.counting.samples_of(frames))
        if time.monotonic() - self._synced >= ON_DISK_EVERY_S:
            self._to_disk()

    def _append(self, samples: Samples) -> None:
        if len(samples.time_s) == 0:
            return
        origin = self.counting.origin
        self._csv.append(count_lines(samples, float(samples.time_s[0]) if origin is None else origin))
        kept = self.counting.took(samples)
        if self._each is not None:
            self._each(kept)

    def _to_disk(self) -> None:
        self._log.to_disk()
        self._csv.to_disk()
        self._synced = time.monotonic()
        with contextlib.suppress(OSError):
            self._free = shutil.disk_usage(self.folder).free

    def progress(self, seconds: float) -> Progress:
        return self.counting.progress(seconds, self._free)

    def close(self, ended: str) -> Recording:
        """Write the rest, mark stalls, and report the end."""
        path = self.folder / f"pass{self.passage}.csv"

        def rest() -> None:
            self._append(self.counting.assembler.feed(no_frames(), last=True))

        for step in (rest, partial(self.counting.tell, np.empty(0), last=True), self._to_disk):
            try:
                step()
            except OSError as error:
                ended = ended if ended != "complete" else files.not_written(path, error)
        self._log.close()
        self._csv.close()
        if self.counting.samples == 0:
            self._take_back()
            raise AcquisitionError(nothing_came(self.counting) + (f": {ended}" if ended != "complete" else ""))
        return self._finish(path, ended)

    def _finish(self, path: Path, ended: str) -> Recording:
        counts = read_counts(path, torn=True)
        seconds = float(counts.time_s[-1] - counts.time_s[0])
        closure = closure_counts(counts)
        events, origin = self.counting.assembler.events, self.counting.origin
        gaps = {c: n for c in counts.channels if (n := int(np.isnan(counts.of(c)).sum()))}
        result = Recording(self.folder, ended, self.counting.frames, len(counts.time_s), seconds, dict(events.tally), closure, gaps)
        with contextlib.suppress(OSError, LMeasureError):  # on a full disk, run.toml keeps stating an early end
            marked = mark_stalls(self.rig, counts, events, self.passage, origin_s=origin or 0.0)
            if marked is not None:
                write_counts(path, marked)
            if events.kept:
                files.write_table(self.folder / f"pass{self.passage}.events.csv", event_columns(events.kept, origin or 0.0, 6))
            entry = self._table["recording"][-1]
            entry |= {
                "ended": "complete" if ended == "complete" else "early",
                "first_sample_s": origin,
                "samples": len(counts.time_s),
                "seconds": seconds,
                "received": self.counting.frames,
                "faults": dict(sorted(events.tally.items())),
                "closure_counts": closure,
                "sha256": {name: files.sha256(self.folder / name) for name in (path.name, entry["frames"], "rig.toml")},
            }
            if self.counting.lost:
                entry["frames_lost"] = self.counting.lost
            if self.counting.assembler.stamps_moved_s:
                entry["stamps_brought_back_s"] = self.counting.assembler.stamps_moved_s
            if ended != "complete":
                entry["why"] = ended
            # keep statements that a page or an editor made meanwhile
            now = files.read_toml(self.folder / "run.toml")
            stated = {key: now[key] for key in ("start", "unstated", "temperature_c") if key in now}
            files.write_toml(self.folder / "run.toml", self._table | stated)
        return replace(result, faults=dict(events.tally), notes=tuple(events.notes()))


def _kept(path: Path) -> str:
    return message("error.recording_exists", path=path)


def _content(path: Path) -> bytes | None:
    """Return the file's bytes, empty if it is no regular file, None if it does not exist."""
    if not path.exists():
        return None
    try:
        return files.read_bytes(path)
    except LMeasureError:
        return b""
