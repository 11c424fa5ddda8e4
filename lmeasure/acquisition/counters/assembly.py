"""From a rig and frames to counts: the assembler that the rig asks for, whole batches at once, and what only the whole run shows."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.acquisition.bus.frames import Frames, no_frames
from lmeasure.acquisition.counters.counters import CounterState, StartLine, Unit
from lmeasure.acquisition.counters.decoders import CounterField
from lmeasure.acquisition.counters.events import Event, EventLog
from lmeasure.acquisition.counters.free_running import FreeAssembler
from lmeasure.acquisition.counters.samples import Assembler, SyncAssembler, joined
from lmeasure.core import AcquisitionError
from lmeasure.kernels import rests
from lmeasure.recording import Counts
from lmeasure.rig import Drum, Rig, SensorTable
from lmeasure.text import composed, message

STICK_MM, STICK_DEG = 0.2, 0.02
"""By how much a count may be off its line by itself: a cable that sticks and slips, play."""
TIGHT_MM, TIGHT_DEG = 1.0, 0.1
"""Where the motion before a gap leads to within less than this, a restart at zero would be seen."""
HARD_MM_S2, HARD_DEG_S2 = 50_000.0, 100_000.0
"""The hardest acceleration of any machine."""
STALL_S = 1.0
STALL_OTHERS_MM = 20.0
"""A channel that keeps its count for STALL_S while the median of the others is moved this far (there and back counts) is stuck."""


@dataclass(frozen=True)
class Assembled:
    """Counts of one pass, the faults found on the way, and how many frames were looked at."""

    counts: Counts
    events: EventLog
    frames: int


def new_assembler(rig: Rig, fields: tuple[CounterField, ...], passage: int = 1) -> Assembler:
    """An assembler for the timing that the rig's `[can]` table states."""
    known, table = rig.counters_of(passage), rig.can_table
    counters = tuple(_counter(f, known[f.channel]) for f in fields)
    start_line = None if table.start_input is None else StartLine(table.start_input)
    if table.timing == "free":
        return FreeAssembler(fields, counters, EventLog(), start_line)
    return SyncAssembler(fields, counters, table.sync_id, EventLog(), start_line=start_line)


def _counter(field: CounterField, known: Drum | SensorTable) -> CounterState:
    """The state of a channel, its limits in the units of its device."""
    drum = isinstance(known, Drum)
    size = (known.per_count if drum else math.degrees(known.per_count)) * field.scale / known.scale
    slack, tight, hard, name = (STICK_MM, TIGHT_MM, HARD_MM_S2, "mm") if drum else (STICK_DEG, TIGHT_DEG, HARD_DEG_S2, "deg")
    hardest = known.max_cable_acceleration_mm_s2 if isinstance(known, Drum) else None
    return CounterState(
        field,
        known.rate / field.scale,
        wraps_later=known.counter_bits is not None or known.codes is not None,
        codes=known.codes is not None,
        unit=Unit(size, name, slack / size, tight / size, hard / size),
        acceleration=None if hardest is None else hardest / size,
        exact=known.zero_exact and isinstance(known, Drum),
    )


def counts_from_frames(
    rig: Rig, batches: Iterable[Frames], fields: tuple[CounterField, ...], passage: int = 1, *, source: str = "frames"
) -> Assembled:
    """Counts of one pass from batches of frames in the order of their reception; time_s is as the frames give it.

    AcquisitionError when there is not one sample.
    """
    assembler = new_assembler(rig, fields, passage)
    parts, frames = [], 0
    for batch in batches:
        parts.append(assembler.feed(batch))
        frames += len(batch)
    parts.append(assembler.feed(no_frames(source), last=True))
    samples = joined(parts)
    if len(samples.time_s) == 0:
        table = rig.can_table
        own = message("bus.frame_of_channel", channel=fields[0].channel)
        wanted = composed("SYNC {sync_id:#x}", sync_id=table.sync_id) if table.timing == "sync" else own
        raise AcquisitionError(message("error.frames_but_no_among", where=source, frames=frames, wanted=wanted))
    channels = tuple(f.channel for f in fields)
    frame, stamp_s = samples.frames or (None, None)
    counts = Counts(
        samples.time_s, channels, samples.recorded, samples.start_input, source, samples.u_time_s, stamp_s=stamp_s, frames=frame
    )
    marked = mark_stalls(rig, counts, assembler.events, passage)
    return Assembled(counts if marked is None else marked, assembler.events, frames)


def mark_stalls(rig: Rig, counts: Counts, events: EventLog, passage: int = 1, *, origin_s: float = 0.0) -> Counts | None:
    """The counts with empty cells where a channel stands still while the others move, and an event for each; None where none does.

    Six cables have no redundancy: a stuck counter gives a plausible pose. That a cable keeps its length to the count while the others
    are moved by centimetres does not happen by itself. origin_s: where the counts' times start by the frames' clock.
    """
    drums = rig.drums_of(passage)
    given = counts
    # a swivel may well stand still while cables are moved
    own = [j for j, channel in enumerate(given.channels) if channel in drums]
    counts = replace(given, channels=tuple(given.channels[j] for j in own), recorded=given.recorded[:, own], stamp_s=None, frames=None)
    if len(own) < 2:
        return None
    still = [rests(counts.time_s, column, STALL_S) for column in counts.recorded.T]
    if not any(len(stretches) for stretches in still):
        return None
    mm = np.array([drums[c].count_length_mm / drums[c].scale for c in counts.channels])
    moves = np.diff(counts.recorded, axis=0, prepend=counts.recorded[:1])
    for j, channel in enumerate(counts.channels):
        bits = drums[channel].counter_bits
        if bits is not None:
            moves[:, j] = (moves[:, j] + 2.0 ** (bits - 1)) % 2.0**bits - 2.0 ** (bits - 1)
    way = np.cumsum(np.nan_to_num(np.abs(moves)) * mm, axis=0)
    recorded = counts.recorded.copy()
    found = False
    for j, channel in enumerate(counts.channels):
        for first, last in still[j].tolist():
            others = np.delete(way[last] - way[first], j)
            if drums[channel].braked or np.median(others) < STALL_OTHERS_MM:
                continue
            # up to here the others still stood: the count is good
            begin = first + int(np.argmax(np.median(np.delete(way[first : last + 1] - way[first], j, axis=1), axis=1) > 0))
            recorded[begin : last + 1, j] = np.nan
            lasted = float(counts.time_s[last] - counts.time_s[begin])
            span = message("event.stall", seconds=lasted, others=float(np.median(others)))
            events.add(Event(begin, origin_s + float(counts.time_s[begin]), channel, "stall", span))
            found = True
    if not found:
        return None
    marked = given.recorded.copy()
    marked[:, own] = recorded
    frames = None if given.frames is None else np.where(np.isnan(marked) & ~np.isnan(given.recorded), np.nan, given.frames)
    return replace(given, recorded=marked, frames=frames)
