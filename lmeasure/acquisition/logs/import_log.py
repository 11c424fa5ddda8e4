"""Import of logs of CAN frames as a run: each log is one pass of the motion."""

import itertools
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.acquisition.bus.canopen import as_mapped, fields_in_log
from lmeasure.acquisition.bus.frames import ERROR, EXTENDED, Frames, pieces
from lmeasure.acquisition.counters.assembly import counts_in_pieces, new_assembler
from lmeasure.acquisition.counters.decoders import STANDARD_IDENTIFIERS, CounterField, counter_fields, dbc_file, decode
from lmeasure.acquisition.counters.events import EventLog, event_columns
from lmeasure.acquisition.counters.stalls import Stall, Stalls, marked, note_stalls
from lmeasure.acquisition.logs.kept_counts import KeptCounts
from lmeasure.acquisition.logs.read import identifiers_in, log_batches
from lmeasure.acquisition.logs.report import LogReport
from lmeasure.core import AcquisitionError, FileFormatError, FloatArray, OverwriteError, pasted, version_of
from lmeasure.io import files
from lmeasure.recording import Counts, Run, UStart, joined_counts, write_counts_in_pieces, write_run
from lmeasure.rig import CalibrationRecord, CanOpenCan, DbcCan, DbcChannel, Rig
from lmeasure.text import Lines, message

SHOWN_IDENTIFIERS = 12
SHOWN_SEAMS = 3


@dataclass
class Survey:
    """Frames of a log: how many of each identifier (2^29 above it where extended) and bus, how many error frames."""

    identifiers: Counter[int] = field(default_factory=Counter)
    buses: Counter[str] = field(default_factory=Counter)
    errors: int = 0

    def feed(self, frames: Frames) -> None:
        """Count a batch."""
        data = (frames.flags & ERROR) == 0
        extended = (frames.flags & EXTENDED) != 0
        standard = np.bincount(frames.identifier[data & ~extended] % STANDARD_IDENTIFIERS, minlength=STANDARD_IDENTIFIERS)
        self.identifiers.update({int(i): int(standard[i]) for i in np.flatnonzero(standard)})
        for i, count in zip(*np.unique(frames.identifier[data & extended], return_counts=True), strict=True):
            self.identifiers[int(i) + (1 << 29)] += int(count)
        for i, count in enumerate(np.bincount(frames.channel, minlength=len(frames.buses))):
            self.buses[frames.buses[i]] += int(count)
        self.errors += int(len(frames) - data.sum())

    def lines(self) -> list[str]:
        """Return lines with the buses, and the most frequent identifiers."""
        most = self.identifiers.most_common(SHOWN_IDENTIFIERS)
        shown = ", ".join(f"{_name(i)} ({n})" for i, n in sorted(most))
        more = f" and {len(self.identifiers) - len(most)} more" if len(self.identifiers) > len(most) else ""
        return [
            message(
                "acquisition.buses_error_frames",
                buses=tuple(message("acquisition.frames", bus=bus, n=n) for bus, n in self.buses.items()),
                errors=self.errors,
            ),
            message("acquisition.identifiers", shown=shown, more=more),
        ]


def _name(identifier: int) -> str:
    return f"{identifier - (1 << 29):08X}x" if identifier >> 29 else f"{identifier:03X}"


@dataclass(frozen=True)
class ImportedLog:
    """One log as one pass: its counts, with time_s from the first sample, which was at start_s of the log's own clock."""

    path: Path
    sha256: str
    kept: KeptCounts
    stalls: list[Stall]
    report: LogReport
    survey: Survey
    events: EventLog
    fields: tuple[CounterField, ...]

    @property
    def start_s(self) -> float:
        """Return the time of the first sample by the log's own clock."""
        return self.kept.first_s

    @property
    def samples(self) -> int:
        """Return their number."""
        return self.kept.samples

    @property
    def seconds(self) -> float:
        """Return the time from the first sample to the last."""
        return self.kept.last_s - self.kept.first_s

    def pieces(self) -> Iterator[Counts]:
        """Yield the counts piece by piece."""
        for piece in self.kept.pieces():
            own_s = None if piece.stamp_s is None else piece.stamp_s - self.start_s
            yield replace(marked(piece, self.stalls), time_s=piece.time_s - self.start_s, stamp_s=own_s)

    @cached_property
    def counts(self) -> Counts:
        """Return the counts as a whole."""
        return joined_counts(list(self.pieces()))

    def write(self, path: Path, first: Counts) -> None:
        """Write the counts piece by piece."""
        whole = self.kept.whole & ~np.isin(np.arange(len(first.channels)), [stall.channel for stall in self.stalls])
        write_counts_in_pieces(path, self.pieces(), whole)

    def lines(self) -> list[str]:
        """Return lines with the content of the log."""
        return [
            message(
                "acquisition.frames_samples_s",
                file=self.path,
                frames=self.report.frames,
                samples=self.samples,
                seconds=self.seconds,
                faults=self.events.summary(),
            ),
            *self.survey.lines(),
            *self.report.notes(),
            *self.events.notes(),
            *self.seams(),
        ]

    def seams(self) -> list[str]:
        """Return a line for each of the first places where the log may be two recordings, one behind the other, by the log's own clock."""
        advice = message("log.two_recordings")
        out: list[str] = []
        for last, seconds in self.kept.silences():
            out.append(message("log.silence", advice=advice, log=self.path, seconds=seconds, last=last))
        for event in itertools.islice((event for event in self.events.kept if event.kind == "time"), SHOWN_SEAMS):
            last = self.kept.time_of(max(min(event.sample, self.samples) - 1, 0))
            out.append(message("log.clock", log=self.path, how=event.text, last=last, advice=advice))
        return out[:SHOWN_SEAMS]


@dataclass(frozen=True)
class Imported:
    """Run from logs, the content of each log, and the files that the rig's `[can]` table names, by name."""

    head: Run
    """Run with the first piece of the counts of each pass."""
    logs: tuple[ImportedLog, ...]
    beside: Mapping[str, bytes] = field(default_factory=dict)

    @cached_property
    def run(self) -> Run:
        """Return the run with all counts in memory."""
        return replace(self.head, passes=tuple(log.counts for log in self.logs))

    def summary(self) -> str:
        return Lines(line for log in self.logs for line in log.lines())


def import_logs(
    logs: Iterable[Path],
    rig: Rig,
    start: FloatArray | None,
    *,
    calibration: CalibrationRecord | None = None,
    u_start: UStart = (None, None),
    folder: Path = Path(),
    bus: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Imported:
    """Import the n-th log as the n-th pass of a run.

    start (7,) is the pose at which the counters were zeroed, None where it is unknown: logs do not hold it; u_start its uncertainty, as
    `Run` takes it. folder is the rig file's folder, bus the name of the bus to read if several carry the counters. FileFormatError and
    AcquisitionError name the log and its fault.
    """
    logs = tuple(logs)
    if len(logs) != rig.passes:
        raise AcquisitionError(message("error.rig_its_cables_need", name=rig.name, passes=rig.passes, n_logs=len(logs)))
    found = tuple(_import_log(log, rig, passage, folder, bus, progress) for passage, log in enumerate(logs, 1))
    for log in found:
        rig = as_mapped(rig, log.fields)
    rig, beside = with_files_beside(rig, folder)
    return Imported(Run(rig, start, tuple(next(log.pieces()) for log in found), calibration, u_start), found, beside)


def _import_log(
    log: Path, rig: Rig, passage: int, folder: Path, bus: str | None, progress: Callable[[int, int], None] | None
) -> ImportedLog:
    fields = fields_of_log(rig, passage, folder, log)
    report, survey = LogReport(), Survey()
    batches = _of_one_bus(log_batches(log, report, progress), fields, rig.can_table.sync_id, bus, survey, log)
    assembler, channels = new_assembler(rig, fields, passage), tuple(f.channel for f in fields)
    kept, search = KeptCounts(), Stalls(rig, channels, passage)
    try:
        for counts in counts_in_pieces(rig, assembler, pieces(batches), fields, source=str(log)):
            kept.add(counts)
            search.add(counts)
    except AcquisitionError:
        if report.frames == 0:
            raise FileFormatError(report.empty(log)) from None
        raise
    stalls, events = search.found(), assembler.events
    note_stalls(stalls, channels, events)
    if report.unread:
        events.tally["unread"] = report.unread
    for one, counted in zip(fields, kept.counted, strict=True):
        if not counted:
            there = ", ".join(_name(i) for i in sorted(survey.identifiers)[:SHOWN_IDENTIFIERS])
            wanted = f"{one.identifier:X}{'x' if one.extended else ''}"
            reported = message("log.no_count", wanted=wanted, found=there, command=f"lmeasure import {pasted(log)} --scan")
            raise AcquisitionError(message("error.channel", where=log, channel=one.channel, reported=reported))
    return ImportedLog(log, files.sha256(log), kept, stalls, report, survey, events, fields)


def fields_of_log(rig: Rig, passage: int, folder: Path, log: Path) -> tuple[CounterField, ...]:
    """The fields of the pass' channels as the rig's `[can]` table names them, without a device to ask; see `counter_fields`."""
    if isinstance(rig.can_table, CanOpenCan):
        return fields_in_log(rig, passage, folder, identifiers_in(log))
    return counter_fields(rig, passage, folder)


def _of_one_bus(
    batches: Iterable[Frames], fields: tuple[CounterField, ...], sync_id: int, bus: str | None, survey: Survey, log: Path
) -> Iterator[Frames]:
    """Yield the surveyed batches, only of the bus if it has a name; AcquisitionError if a counter or SYNC is on several."""
    where: dict[str, set[str]] = {}
    for batch in batches:
        survey.feed(batch)
        if bus is not None:
            yield batch.take(batch.channel == (batch.buses.index(bus) if bus in batch.buses else -1))
            continue
        if len(batch.buses) > 1:
            readings = decode(batch, fields, sync_id)
            for j, one in enumerate(fields):
                channels = np.unique(batch.channel[readings.frame[readings.field == j]])
                where.setdefault(message("acquisition.channel", channel=one.channel), set()).update(batch.buses[c] for c in channels)
            channels = np.unique(batch.channel[readings.sync])
            where.setdefault("SYNC", set()).update(batch.buses[c] for c in channels)
            for name, buses in where.items():
                if len(buses) > 1:
                    raise AcquisitionError(message("error.stands_on_buses_name", where=log, name=name, buses=", ".join(sorted(buses))))
        yield batch
    if bus is not None and bus not in survey.buses:
        raise AcquisitionError(message("error.has_no_bus_it", where=log, bus=bus, buses=", ".join(survey.buses) or "no frames"))


def with_files_beside(rig: Rig, folder: Path) -> tuple[Rig, dict[str, bytes]]:
    """Return the rig with its `[can]` table's DBC or EDS file beside it, and that file's bytes by its name; folder: its present folder."""
    key = "dbc" if isinstance(rig.can, DbcCan) else "eds" if isinstance(rig.can, CanOpenCan) and rig.can.eds else None
    if rig.can is None or key is None:
        return rig, {}
    path = folder / getattr(rig.can, key)
    return rig.model_copy(update={"can": rig.can.model_copy(update={key: path.name})}), {path.name: files.read_bytes(path)}


def with_dbc(rig: Rig, dbc: Path) -> Rig:
    """The rig, its counters named by this DBC file: by its own `[can]` table of decoder `dbc`, or each channel by the signal of its name.

    AcquisitionError where the table is of another decoder, or a channel's name is that of no signal or of several.
    """
    path = str(dbc.resolve())
    if isinstance(rig.can, DbcCan):
        return rig.model_copy(update={"can": rig.can.model_copy(update={"dbc": path})})
    if rig.can is not None:
        raise AcquisitionError(message("error.rig_its_can_table", name=rig.name, decoder=rig.can.decoder))
    database = dbc_file(dbc)
    channels = []
    for name in rig.all_channels:
        carriers = [m.name for m in database.messages if any(s.name == name for s in m.signals)]
        if len(carriers) != 1:
            what = message("log.no_signal")
            if carriers:
                what = message("log.several_signals", messages=", ".join(carriers))
            raise AcquisitionError(message("error.channel_in_it_say", where=dbc, name=name, what=what))
        channels.append(DbcChannel(channel=name, message=carriers[0], signal=name))
    return rig.model_copy(update={"can": DbcCan(decoder="dbc", dbc=path, channel=tuple(channels))})


def write_import(out: Path, imported: Imported, suffix: str = ".csv", *, force: bool = False) -> None:
    """Write the run folder, with the faults of each pass beside its counts, and their source under `[[recording]]` in run.toml.

    OverwriteError if a file that the rig names is in the folder with other bytes, unless force is set.
    """
    for name, content in imported.beside.items():
        if not force and (out / name).exists() and files.read_bytes(out / name) != content:
            raise OverwriteError(message("error.exists_and_is_not", where=out / name))
    recording = []
    for passage, log in enumerate(imported.logs, 1):
        events = out / f"pass{passage}.events.csv"
        if log.events.kept:
            files.write_table(events, event_columns(log.events.kept, log.start_s))
        else:
            events.unlink(missing_ok=True)  # of an import before this one
        entry: dict[str, Any] = {
            "pass": passage,
            "ended": "early" if log.report.ended_early else "complete",
            "bus": str(log.path.name),
            "timestamps": "log",
            "software": f"lmeasure {version_of('lmeasure')}",
            "first_sample_s": log.start_s,
            "samples": log.samples,
            "seconds": log.seconds,
            "received": log.report.frames,
            "read": log.report.as_dict(),
            "faults": dict(sorted(log.events.tally.items())),
            "sha256": {log.path.name: log.sha256},
        }
        if why := log.report.why():
            entry["why"] = why
        recording.append(entry)
    for name, content in imported.beside.items():
        if not (out / name).exists() or files.read_bytes(out / name) != content:
            files.write_bytes(out / name, content)
    write_run(out, imported.head, {"recording": recording}, suffix, writers=[log.write for log in imported.logs])
