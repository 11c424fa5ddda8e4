"""The recorder: raw frames and decoded counts, appended as they come, into a run folder that can be read at any moment.

pass1.log holds the frames as candump writes them (microseconds), pass1.csv the counts; both grow by whole lines and are on the disk once a
second. run.toml is there from the first moment and says `ended = "early"` until the recording is closed.
"""

import contextlib
import shutil
import signal
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure import files
from lmeasure.acquisition.assembly import mark_stalls, new_assembler
from lmeasure.acquisition.decoders import CounterField
from lmeasure.acquisition.events import Event, event_columns
from lmeasure.acquisition.frames import Frames, no_frames
from lmeasure.acquisition.growing_files import Appended, candump_lines, count_lines
from lmeasure.acquisition.samples import Samples
from lmeasure.acquisition.sources import Notice, Source
from lmeasure.arrays import FloatArray
from lmeasure.counts import closure_counts, read_counts, write_counts
from lmeasure.errors import AcquisitionError, LMeasureError, RecordedError
from lmeasure.rig import Rig, read_rig, write_rig
from lmeasure.run import SCHEMA

ON_DISK_EVERY_S = 1.0
TURN_S = 0.05
"""How long one look at the source takes at most."""


@dataclass(frozen=True)
class Progress:
    """What a person may want to see while it records: counts, counts/s and mm/s per channel; latency_s from a frame's own time to its being
    counted, where one clock tells both."""

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
    """Bytes that the disk still has, looked at once a second."""


@dataclass(frozen=True)
class Recording:
    """A closed recording: its folder, how it ended, the numbers of frames and samples, faults by kind, and the closure per channel
    [counts]: the mean of the last rest less that of the first, where the recording begins and ends at rest."""

    folder: Path
    ended: str
    frames: int
    samples: int
    seconds: float
    faults: Mapping[str, int]
    closure: Mapping[str, float]

    def summary(self) -> str:
        """A few lines for a person."""
        faults = ", ".join(f"{n} {kind}" for kind, n in sorted(self.faults.items())) or "no faults"
        lines = [f"{self.samples} samples from {self.frames} frames over {self.seconds:.3f} s: {faults}"]
        if self.closure:
            lines.append("back at the start, counts: " + ", ".join(f"{c} {v:+.1f}" for c, v in self.closure.items()))
        return "\n".join(lines)


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
    """Record a pass from the source into the run folder until the time is over, the source ends, `stop` says so, or Ctrl-C (or SIGTERM).

    start (7,): the pose at which the counters were zeroed, None where it is not known; that of pass 1 holds for later ones. devices:
    identities for the manifest. beside: files that the rig names, such as its calibration, which go into the folder too.
    show gets the state of things at every turn, each the samples as soon as they are known, their times from the first one, as in the file.
    A source that is lost, a log that breaks, or a disk that is full, ends the recording early: what came before is kept, the text says why.
    AcquisitionError when not one sample came.
    """
    writer = _Writer(folder, rig, fields, passage, start=start, source=source, devices=devices or [], beside=beside or {}, each=each)
    ended = "complete"
    begin = time.monotonic()
    try:
        with _asked_to_end() as asked:
            while (seconds is None or time.monotonic() - begin < seconds) and not stop() and not asked():
                if not writer.take(TURN_S):
                    break
                if show is not None:
                    show(writer.progress(time.monotonic() - begin))
        writer.take(0.0)  # what has come by now
        if show is not None:
            show(writer.progress(time.monotonic() - begin))
    except LMeasureError as error:
        ended = str(error)
    except OSError as error:
        ended = f"{error.filename}: {error.strerror}" if error.filename else " ".join(str(error).split())
    return writer.close(ended)


@contextlib.contextmanager
def _asked_to_end() -> Iterator[Callable[[], bool]]:
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
        self.folder, self.rig, self.fields, self.passage, self.source = Path(folder), rig, fields, passage, source
        self.assembler = new_assembler(rig, fields, passage)
        self.frames = self.samples = 0
        self._origin: float | None = None
        self._latest: Samples | None = None
        self._noticed: list[Notice] = []
        self._lost = 0
        self._latency: float | None = None
        self._synced = time.monotonic()
        self._free: int | None = None
        self._before = {self.folder / name: _content(self.folder / name) for name in ("rig.toml", "run.toml", *beside)}
        self._table = self._manifest(start, devices, beside)
        self.assembler.feed(no_frames())  # compiles before the first frame comes
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            self._log = self._begun(f"pass{passage}.log")
            self._csv = self._begun(f"pass{passage}.csv")
            extra = ["sync"] * (rig.can_table.start_input is not None)
            extra += ["u_time_s"] * (rig.can_table.timing == "free")
            self._csv.append((",".join(["time_s", *(f.channel for f in fields), *extra]) + "\n").encode())
            for name, content in beside.items():
                files.write_bytes(self.folder / name, content)
            write_rig(self.folder / "rig.toml", rig)
            files.write_toml(self.folder / "run.toml", self._table)
        except OSError as error:
            self._take_back()
            there = isinstance(error, FileExistsError) and self.folder.is_dir()
            what = "is there already; nothing is written over a recording" if there else f"cannot be written: {error.strerror or error}"
            raise (RecordedError if there else AcquisitionError)(f"{error.filename or folder}: {what}") from error
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
                raise AcquisitionError(f"{self.folder / 'rig.toml'}: is another rig than that of pass {self.passage}")
            if len(table.get("pass", [])) != self.passage - 1:
                raise AcquisitionError(f"{path}: has {len(table.get('pass', []))} passes; pass {self.passage} cannot follow")
        else:
            for name in ("run.toml", "rig.toml", *beside):
                there = self._before[self.folder / name]
                if there is not None and there != beside.get(name):
                    raise RecordedError(
                        f"{self.folder / name}: is there already; nothing is written over a recording, and a recording over nothing"
                    )
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
            "software": f"lmeasure {version('lmeasure')}",
            "frames": f"pass{self.passage}.log",
            "devices": devices,
        }
        if self.source.bit_rate is not None:
            entry["bit_rate"] = self.source.bit_rate
        table["recording"] = [*table.get("recording", []), entry]
        return table

    def take(self, seconds: float) -> bool:
        """Append what comes within the time and what it completes; False when the source has ended."""
        frames = self.source.receive(seconds)
        self._noticed += self.source.notices()
        if frames is not None:
            self._write(frames)
        return frames is not None

    def _write(self, frames: Frames) -> None:
        if len(frames):
            # what the log can say is what is counted: reading it again gives the same
            frames = replace(frames, time_s=np.round(frames.time_s, 6))
            self._log.append(candump_lines(frames))
            self.frames += len(frames)
            self._latency = time.time() - float(frames.time_s[-1])
            self._append(self.assembler.feed(frames))
        if time.monotonic() - self._synced >= ON_DISK_EVERY_S:
            self._to_disk()

    def _append(self, samples: Samples) -> None:
        if len(samples.time_s) == 0:
            return
        if self._origin is None:
            self._origin = float(samples.time_s[0])
        self._csv.append(count_lines(samples, self._origin))
        self._tell(samples.time_s)
        self.samples += len(samples.time_s)
        self._latest = samples
        if self._each is not None:
            self._each(replace(samples, time_s=samples.time_s - self._origin))

    def _tell(self, time_s: FloatArray, last: bool = False) -> None:
        """Tie what happened to the source to the first sample at its time or later, among the (n,) times of new ones."""
        later = []
        for notice in self._noticed:
            row = 0 if notice.time_s is None else int(np.searchsorted(time_s, notice.time_s))
            if row == len(time_s) and not last:
                later.append(notice)
                continue
            self._lost += notice.lost
            at = notice.time_s if notice.time_s is not None else float(time_s[0]) if len(time_s) else float("nan")
            self.assembler.events.add(Event(self.samples + row, at, "", notice.kind, notice.text))
        self._noticed = later

    def _to_disk(self) -> None:
        self._log.to_disk()
        self._csv.to_disk()
        self._synced = time.monotonic()
        with contextlib.suppress(OSError):
            self._free = shutil.disk_usage(self.folder).free

    def progress(self, seconds: float) -> Progress:
        """The state of things, for a display."""
        m = len(self.fields)
        counts, rates = np.full(m, np.nan), np.full(m, np.nan)
        if self._latest is not None:
            counts = self._latest.recorded[-1]
            span = self._latest.time_s[-1] - self._latest.time_s[0]
            if span > 0:
                rates = (self._latest.recorded[-1] - self._latest.recorded[0]) / span
        latency = self._latency if self._latency is not None and 0 <= self._latency < 60 else None
        known = self.rig.counters_of(self.passage)
        channels = tuple(f.channel for f in self.fields)
        speeds = rates * np.array([known[c].count_sign * known[c].per_count / known[c].scale for c in channels])
        events, newest = self.assembler.events, None if self._latest is None else float(self._latest.time_s[-1])
        return Progress(
            seconds,
            self.frames,
            self.samples,
            dict(events.tally),
            channels,
            counts,
            rates,
            speeds,
            latency,
            self._origin,
            tuple(events.kept),
            newest,
            self._lost,
            self._free,
        )

    def close(self, ended: str) -> Recording:
        """Write what is left, mark stalls, and say how it ended."""
        path = self.folder / f"pass{self.passage}.csv"
        try:
            self._append(self.assembler.feed(no_frames(), last=True))
            self._tell(np.empty(0), last=True)
            self._to_disk()
        except OSError as error:
            ended = ended if ended != "complete" else f"{path}: cannot be written: {error.strerror or error}"
        self._log.close()
        self._csv.close()
        if self.samples == 0:
            self._take_back()
            why = f": {ended}" if ended != "complete" else ""
            raise AcquisitionError(
                f"{self.source.name}: {self.frames} frames, not one sample of {', '.join(f.channel for f in self.fields)}{why}"
            )
        return self._finish(path, ended)

    def _finish(self, path: Path, ended: str) -> Recording:
        counts = read_counts(path, torn=True)
        seconds = float(counts.time_s[-1] - counts.time_s[0])
        closure = closure_counts(counts)
        events = self.assembler.events
        result = Recording(self.folder, ended, self.frames, len(counts.time_s), seconds, dict(events.tally), closure)
        with contextlib.suppress(OSError, LMeasureError):  # a full disk: run.toml goes on saying that it ended early
            marked = mark_stalls(self.rig, counts, events, self.passage, origin_s=self._origin or 0.0)
            if marked is not None:
                write_counts(path, marked)
            if events.kept:
                files.write_table(self.folder / f"pass{self.passage}.events.csv", event_columns(events.kept, self._origin or 0.0))
            entry = self._table["recording"][-1]
            entry |= {
                "ended": "complete" if ended == "complete" else "early",
                "first_sample_s": self._origin,
                "samples": len(counts.time_s),
                "seconds": seconds,
                "received": self.frames,
                "faults": dict(sorted(events.tally.items())),
                "closure_counts": closure,
                "sha256": {name: files.sha256(self.folder / name) for name in (path.name, entry["frames"], "rig.toml")},
            }
            if self._lost:
                entry["frames_lost"] = self._lost
            if self.assembler.stamps_moved_s:
                entry["stamps_brought_back_s"] = self.assembler.stamps_moved_s
            if ended != "complete":
                entry["why"] = ended
            # a start that was stated meanwhile, by a page or an editor, is kept
            stated = {key: value for key, value in files.read_toml(self.folder / "run.toml").items() if key == "start"}
            files.write_toml(self.folder / "run.toml", self._table | stated)
        return replace(result, faults=dict(events.tally))


def _content(path: Path) -> bytes | None:
    """The file's bytes, none of what is there and no file, None where nothing is."""
    if not path.exists():
        return None
    try:
        return files.read_bytes(path)
    except LMeasureError:
        return b""
