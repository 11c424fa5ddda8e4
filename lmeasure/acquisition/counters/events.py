"""Events on the way from the device to a count: one event per fault, tied to the sample it concerns."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lmeasure.text import composed, count_of, joined, message

EVENTS_KEPT = 10_000
"""Most events of each kind that are kept; all are counted."""
CONTRADICTED = 0.05
"""Part of a channel's values outside the stated range from which the range is wrong."""

REPAIRED = frozenset(("duplicate", "reordered", "duplicate_sync", "wrap", "stamp", "clock_wrap", "unanswered", "clock_step", "gap_step"))
"""Kinds of events without a loss; docs/acquisition.md lists them."""
MARKED = frozenset((
    "gap", "conflict", "short_frame", "missing_sync", "jump", "no_value", "doubt", "reset", "lost_wrap", "stall",
    "time", "pause", "wider", "emcy", "nmt", "bus_error", "error_passive", "bus_off", "overflow", "unread", "heartbeat",
))  # fmt: skip
"""Kinds of events that cost counts or samples, or put them in doubt."""


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
        """Return whether it lost nothing."""
        return self.kind in REPAIRED


@dataclass
class EventLog:
    """Events in the order in which they were found, at most `EVENTS_KEPT` of each kind, and how many there were of each."""

    kept: list[Event] = field(default_factory=list)
    tally: Counter[str] = field(default_factory=Counter)
    steps: dict[str, tuple[float, str]] = field(default_factory=dict)
    """Largest step [mm or degrees] of each channel that a gap may hide, and that in words."""
    values: dict[str, list[int]] = field(default_factory=dict)
    """Number of values of each channel with limited values, and of those that are no counts."""
    limits: dict[str, str] = field(default_factory=dict)
    reserved: dict[str, bool] = field(default_factory=dict)
    """Whether a standard reserves these values."""

    def add(self, event: Event) -> None:
        """Count an event, and keep it while there are not too many of its kind."""
        self.tally[event.kind] += 1
        if self.tally[event.kind] <= EVENTS_KEPT:
            self.kept.append(event)

    def note_step(self, channel: str, size: float, text: str) -> None:
        """Keep the largest step that a gap of a channel may hide."""
        if channel not in self.steps or size > self.steps[channel][0]:
            self.steps[channel] = size, text

    def note_values(self, channel: str, came: int, void: int, limits: str, *, reserved: bool = False) -> None:
        """Count values of a channel, and those that are no counts; reserved: by a standard, not by a range that is stated."""
        total = self.values.setdefault(channel, [0, 0])
        total[0] += came
        total[1] += void
        self.limits[channel], self.reserved[channel] = limits, reserved

    def notes(self) -> list[str]:
        """Lines for a summary: steps that gaps may hide, and limits of values that the data contradict."""
        out: list[str] = []
        if self.steps:
            steps = tuple(text for _, (_, text) in sorted(self.steps.items()))
            out.append(message("acquisition.largest_step_counter_gap", steps=steps))
        for channel, (came, void) in sorted(self.values.items()):
            if void > CONTRADICTED * came:
                code = "acquisition.no_counts_reserved" if self.reserved[channel] else "acquisition.no_counts_range"
                part, limits = 100.0 * void / came, self.limits[channel]
                out.append(joined((message(code, channel=channel, part=part, limits=limits), message("acquisition.whole_range"))))
        return out

    def summary(self) -> str:
        """One line: how many of each kind."""
        if not self.tally:
            return message("acquisition.no_faults")
        return composed("{faults}", faults=tuple(count_of(kind, n) for kind, n in sorted(self.tally.items())))


def event_columns(events: Sequence[Event], origin_s: float, decimals: int | None = None) -> dict[str, Any]:
    """Columns of events.csv, in the order of the samples. Their times count from the first sample, which was at origin_s by the frames'
    clock, and have as many decimals as those of the counts' file (None: all)."""
    events = sorted(events, key=lambda e: e.sample)
    return {
        "sample": [e.sample for e in events],
        "time_s": [e.time_s - origin_s if decimals is None else round(e.time_s - origin_s, decimals) for e in events],
        "channel": [e.channel for e in events],
        "kind": [e.kind for e in events],
        "outcome": ["repaired" if e.repaired else "marked" for e in events],
        "text": [e.text for e in events],
    }
