"""What happened on the way from the device to a count: one event per fault, tied to the sample it concerns."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

EVENTS_KEPT = 10_000
"""Of each kind; all are counted."""

REPAIRED = {
    "duplicate": "the same frame twice: used once",
    "reordered": "frames on the wrong side of their SYNC, or out of time order: put back",
    "duplicate_sync": "the same SYNC twice: used once",
    "wrap": "the counter passed the end of its range: continued",
    "stamp": "a few frames stamped otherwise than those before and behind them: they come when they were due",
    "clock_wrap": "the clock that stamps the frames started again at the end of its range: times continue",
    "unanswered": "the channel answers every n-th SYNC by its transmission type: the SYNCs between are no samples",
    "clock_step": "the clock that stamps the frames was set: times continue on this program's steady clock",
}
MARKED = {
    "gap": "no frame of this channel for the sample: an empty cell",
    "conflict": "several frames that contradict each other: an empty cell",
    "short_frame": "a frame too short for the counter it should carry: not read",
    "missing_sync": "frames without the SYNC that belongs to them: no sample",
    "jump": "faster than the drum can turn: the counts are kept, and are not trusted from here on",
    "reset": "the encoder started again at zero: its origin is lost, empty cells from here on",
    "lost_wrap": "the counter may have wrapped unseen in a gap: empty cells from here on",
    "stall": "the channel stands still while the others move: empty cells",
    "time": "the log's clock was set: times continue one period later, and are not trusted across this point",
    "pause": "the bus or its SYNC was silent: no samples",
    "wider": "the counter has more bits than the rig says: its wraps are carries, and are undone only while it moves slowly enough",
    "emcy": "the encoder reported an emergency",
    "bus_error": "the interface reported an error frame",
    "bus_off": "the bus was lost and opened again",
    "overflow": "frames were not taken in time and are lost: the samples they belong to are not there",
    "unread": "the log breaks off, or has lines that cannot be read",
    "heartbeat": "a node changed its state",
}
"""Kinds of events: what is done about each."""


@dataclass(frozen=True)
class Event:
    """A fault at sample (row of the counts file, the next one where none belongs to it) and time [s] of a channel, or of all when empty."""

    sample: int
    time_s: float
    channel: str
    kind: str
    text: str = ""

    def __post_init__(self) -> None:
        if self.kind not in REPAIRED and self.kind not in MARKED:
            raise ValueError(f"{self.kind!r} is no kind of event")

    @property
    def repaired(self) -> bool:
        """Whether nothing was lost by it."""
        return self.kind in REPAIRED


@dataclass
class EventLog:
    """Events in the order in which they were found, at most `EVENTS_KEPT` of each kind, and how many there were of each."""

    kept: list[Event] = field(default_factory=list)
    tally: Counter[str] = field(default_factory=Counter)

    def add(self, event: Event) -> None:
        """Count an event, and keep it while there are not too many of its kind."""
        self.tally[event.kind] += 1
        if self.tally[event.kind] <= EVENTS_KEPT:
            self.kept.append(event)

    def summary(self) -> str:
        """One line: how many of each kind."""
        if not self.tally:
            return "no faults"
        return ", ".join(f"{n} {kind}" for kind, n in sorted(self.tally.items()))


def event_columns(events: Sequence[Event], origin_s: float) -> dict[str, Any]:
    """Columns of events.csv, their times from the first sample, as in the counts' file, which was at origin_s by the frames' clock."""
    return {
        "sample": [e.sample for e in events],
        "time_s": [round(e.time_s - origin_s, 6) for e in events],
        "channel": [e.channel for e in events],
        "kind": [e.kind for e in events],
        "outcome": ["repaired" if e.repaired else "marked" for e in events],
        "text": [e.text for e in events],
    }
