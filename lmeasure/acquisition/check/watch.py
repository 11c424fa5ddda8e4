"""Requests to a person in a self-test, and the counters meanwhile."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np

from lmeasure.acquisition.bus.network import BusWatch
from lmeasure.acquisition.counters.assembly import new_assembler
from lmeasure.acquisition.counters.origins import ContinuedCounts, moduli
from lmeasure.acquisition.counters.samples import SyncAssembler
from lmeasure.acquisition.session import Link
from lmeasure.core import AcquisitionError, FloatArray
from lmeasure.rig import Rig
from lmeasure.text import Message, joined, message

PATIENCE_S = 2.0
"""Additional time for the first of them."""
LEAST_PULL_MM = 20.0
LEAST_TURN_DEG = 5.0
"""Largest motion that is not a requested one, of a drum's channel and of an encoder's."""

Found = TypeVar("Found")


@dataclass(frozen=True)
class Moved:
    """Motion of a channel since a step began, in mm or degrees; moves: as far as counts for a motion; wanted: whether it is to."""

    channel: str
    by: float
    unit: str
    moves: bool
    wanted: bool


@dataclass(frozen=True)
class Step:
    """Request to the user: the step's number, the most steps, and the state of the counters meanwhile."""

    text: str
    number: int
    of: int
    look: Callable[[], str]
    """Read the frames of a tenth of a second and return a line with the motion since the step began."""
    moved: Callable[[], tuple["Moved", ...]] = tuple
    """The same of each channel, by the last look."""
    act: str = ""
    """Action of a simulated cell for this step, in the notation of `play`; empty if nothing moves."""
    question: bool = False
    """Whether it is a question, which only a person can answer."""

    def __str__(self) -> str:
        return f"{self.number} of {self.of}: {self.text}"


STILL = 0.02
"""Part of the requested motion within which channels count as still."""
HELD_S, READY_S = 1.5, 1.0
"""Time that channels are at rest after a motion, and where nothing is to be moved."""


class Finished:
    """Watch of the counters for the end of a step: the requested motion was done, and everything has been still since."""

    def __init__(self, step: Step, now_s: float) -> None:
        self._step, self._since_s, self._at = step, now_s, dict[str, float]()
        self.moved = not step.act
        """True after a motion, or if none is wanted."""

    def seen(self, now_s: float) -> bool:
        """Return whether the step is done, at its last look."""
        found = self._step.moved()
        self.moved = self.moved or any(one.moves for one in found)
        still = {"mm": STILL * LEAST_PULL_MM, "deg": STILL * LEAST_TURN_DEG}
        if any(not abs(one.by - self._at.get(one.channel, math.inf)) <= still[one.unit] for one in found):
            self._at, self._since_s = {one.channel: one.by for one in found}, now_s
        waits = HELD_S if self._step.act else READY_S
        return bool(found) and self.moved and not self._step.question and now_s - self._since_s >= waits


Ask = Callable[[Step], str]
"""Show a step and return when the user has done it: "r" to repeat the cable, anything else to continue."""
AGAIN = "r"


class Again(Exception):  # noqa: N818 - no error: the person wants to
    """The cable is to be done again."""


class Watch:
    """The counters over a link, step by step."""

    def __init__(self, rig: Rig, link: Link, passage: int, ask: Ask, *, of: int, settle_s: float) -> None:
        self._link, self._ask, self._of, self._settle_s, self.number = link, ask, of, settle_s, 0
        self._assembler = new_assembler(rig, link.fields, passage)
        self.bus = BusWatch.of_rig(rig, link.fields)
        self.channels = [f.channel for f in link.fields]
        known = [rig.counters_of(passage)[c] for c in self.channels]
        self.lengths = np.array([c.is_length for c in known])
        # millimetres, or degrees, of a recorded count
        self.unit = np.array([c.per_count / c.scale if c.is_length else math.degrees(c.per_count) for c in known])
        self.least = np.where(self.lengths, LEAST_PULL_MM, LEAST_TURN_DEG)
        self._gone_on = ContinuedCounts(moduli(rig, tuple(self.channels), passage))
        self.last: FloatArray | None = None
        self._least = self._most = np.full(len(self.channels), np.nan)

    def look(self, seconds: float) -> tuple[FloatArray, FloatArray]:
        """(n,) times and (n, m) counts that came since the last look and within the next seconds."""
        times, rows = [np.empty(0)], [np.empty((0, len(self._link.fields)))]
        end = time.monotonic() + seconds
        while time.monotonic() < end or (len(times) == 1 and seconds > 0 and time.monotonic() < end + PATIENCE_S):
            frames = self._link.source.receive(0.02)
            if frames is None:
                break
            self.bus.feed(frames)
            # a look at the counters, not at their times: nothing need wait for a busy host's stamps
            samples = self._assembler.feed(replace(frames, timestamp_source="hardware"))
            if len(samples.time_s):
                times.append(samples.time_s)
                rows.append(self._gone_on.of(samples.recorded))
        time_s, recorded = np.concatenate(times), np.vstack(rows)
        seen = recorded[np.isfinite(recorded).all(axis=1)]
        if len(seen):
            self.last = seen[-1]
            self._least = np.fmin(self._least, seen.min(axis=0))
            self._most = np.fmax(self._most, seen.max(axis=0))
        return time_s, recorded

    def begin(self, text: str) -> None:
        """The first step, before there need be counts."""
        self.number += 1
        self._ask(Step(text, self.number, self._of, lambda: self._said(self.last, ""), lambda: self._moved(self.last, "")))
        self.look(0.0)

    def step(
        self, text: str, wanted: str = "", act: str = "", *, question: bool = False
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """The counts when the person has done it, and the least and largest on the way; wanted: the channel that should move; act and
        question: see `Step`."""
        self.look(0.02)
        self.number += 1
        self._least = self._most = np.full(len(self.channels), np.nan)
        begun = self.last
        step = Step(text, self.number, self._of, lambda: self._said(begun, wanted), lambda: self._moved(begun, wanted), act, question)
        if self._ask(step).strip().lower() == AGAIN:
            raise Again
        _, rows = self.look(self._settle_s)
        if self.last is None or not np.isfinite(rows).any(axis=0).all():
            raise AcquisitionError(message("error.no_counts_any_more", text=text))
        return self.last, (self._least, self._most)

    def until_right(self, once: Callable[[], Found], reported: Callable[[Found], tuple[str, tuple[str, ...]]]) -> Found:
        """Return the result of a few steps, repeated as often as the user wants; reported prints it with its faults."""
        begun = self.number
        while True:
            self.number = begun
            try:
                found = once()
                what, faults = reported(found)
                if faults:
                    self.number -= 1  # a question, and no step more
                    self.step(message("check.again", what=what, faults=joined(faults), again=AGAIN), question=True)
            except Again:
                continue
            return found

    def nothing(self, code: str, way: FloatArray, **values: Any) -> Message:
        """Return that nothing moved as far as requested, and which channel of any kind did, by ways (m,) in the unit of each."""
        j = int(np.argmax(way / self.least))
        if way[j] < self.least[j]:
            return message(code, **values)
        unit = message("unit_sign.mm" if self.lengths[j] else "acquisition.degrees")
        return message(f"{code}_but", **values, channel=self.channels[j], way=way[j], **{"other" if "unit" in values else "unit": unit})

    def _said(self, begun: FloatArray | None, wanted: str) -> str:
        self.look(0.1)
        if self.last is None or begun is None:
            return message("acquisition.no_counts")
        moved = (self.last - begun) * self.unit
        reported = []
        for unit, of in ("mm", self.lengths), ("deg", ~self.lengths):
            shown = "  ".join(f"{self.channels[j]} {moved[j]:+.1f}" for j in np.flatnonzero(of))
            reported += [f"{unit}: {shown}"] if shown else []
        if wanted:
            alike = np.flatnonzero(self.lengths == self.lengths[self.channels.index(wanted)])
            j = int(alike[np.argmax(np.abs(moved[alike]))])
            if abs(moved[j]) > self.least[j] and self.channels[j] != wanted:
                reported.insert(
                    0, message("check.moves_not", channel=self.channels[j], wanted=wanted)
                )  # first, because a narrow terminal cuts the end
        return "  ".join(reported)

    def _moved(self, begun: FloatArray | None, wanted: str) -> tuple[Moved, ...]:
        if self.last is None or begun is None:
            return ()
        by, units = (self.last - begun) * self.unit, np.where(self.lengths, "mm", "deg")
        return tuple(
            Moved(c, float(by[j]), str(units[j]), bool(abs(by[j]) > self.least[j]), c == wanted) for j, c in enumerate(self.channels)
        )

    def every(self) -> dict[str, int]:
        """Channels that answer every n-th SYNC only, and their n."""
        if not isinstance(self._assembler, SyncAssembler):
            return {}
        return {c: n for c, n in zip(self.channels, self._assembler.transmission.n.tolist(), strict=True) if n > 1}

    def faults(self) -> dict[str, int]:
        """Faults of the frames so far."""
        return dict(self._assembler.events.tally)
