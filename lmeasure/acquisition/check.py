"""The self-test of a wired rig: which channel is which cable, which way it counts, how many counts a turn has, stroke and slack.

A person pulls and turns, the program looks at the counters. Counts per turn are those of the thesis (Rashoyan 2021, 5.5: 6000).
"""

import copy
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from lmeasure.acquisition.assembly import new_assembler
from lmeasure.acquisition.bus_watch import BusWatch
from lmeasure.acquisition.session import Link
from lmeasure.arrays import FloatArray
from lmeasure.errors import AcquisitionError
from lmeasure.rig import Cable, Rig

REST_S = 1.0
"""How long the counters are looked at before anything is moved."""
PATIENCE_S = 2.0
"""How much longer for the first of them."""
QUIET_COUNTS = 3.0
"""Spread of a counter at rest."""
LEAST_PULL_MM = 20.0
CROSSTALK = 0.2
"""Of the pulled cable's way: what another channel may move with it."""
TURN_TOLERANCE = 0.01
"""A turn by hand from mark to mark is good to a few degrees."""
SLACK_MM = 0.5


@dataclass(frozen=True)
class CableCheck:
    """What one cable showed; None where a step was left out. stroke_mm and slack_mm are of the channel that moved."""

    cable: str
    channel: str
    moved: str | None = None
    direction: int | None = None
    stroke_mm: float | None = None
    slack_mm: float | None = None
    counts_per_turn: float | None = None
    expected_per_turn: float | None = None
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class Step:
    """What a person is asked to do: which step of how many at most, and how the counters stand meanwhile."""

    text: str
    number: int
    of: int
    look: Callable[[], str]
    """Takes what has come for a tenth of a second, and says in a line what moved since the step began."""

    def __str__(self) -> str:
        return f"{self.number} of {self.of}: {self.text}"


Ask = Callable[[Step], str]
"""Shows a step and returns when the person has done it: "r" to do the cable again, anything else to go on."""
AGAIN = "r"


@dataclass(frozen=True)
class Check:
    """The self-test: sample rate [Hz], spread at rest per channel [counts], one row per cable, faults of the whole."""

    rate_hz: float
    spread: dict[str, float]
    cables: tuple[CableCheck, ...]
    faults: tuple[str, ...]

    @property
    def all_faults(self) -> list[str]:
        """One line each."""
        return [*self.faults, *(f"cable {c.cable}: {f}" for c in self.cables for f in c.faults)]


class _Again(Exception):  # noqa: N818 - no error: the person wants to
    """The cable is to be done again."""


class _Watch:
    """The counters over a link, step by step."""

    def __init__(self, rig: Rig, link: Link, passage: int, ask: Ask, *, of: int) -> None:
        self._link, self._ask, self._of, self.number = link, ask, of, 0
        self._assembler = new_assembler(rig, link.fields, passage)
        start_input = rig.can_table.start_input
        self.bus = BusWatch(link.fields, rig.can_table.sync_id, () if start_input is None else (start_input.id,))
        self.channels = [f.channel for f in link.fields]
        drums = rig.drums_of(passage)
        self.mm = np.array([drums[c].count_length_mm / drums[c].scale for c in self.channels])
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
            samples = self._assembler.feed(replace(frames, timestamp_source="log"))
            if len(samples.time_s):
                times.append(samples.time_s)
                rows.append(samples.recorded)
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
        self._ask(Step(text, self.number, self._of, lambda: self._said(self.last, "")))
        self.look(0.0)

    def step(self, text: str, settle_s: float, wanted: str = "") -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """The counts when the person has done it, and the least and largest on the way; wanted: the channel that should move."""
        self.look(0.02)
        self.number += 1
        self._least = self._most = np.full(len(self.channels), np.nan)
        begun = self.last
        if self._ask(Step(text, self.number, self._of, lambda: self._said(begun, wanted))).strip().lower() == AGAIN:
            raise _Again
        _, rows = self.look(settle_s)
        if self.last is None or not np.isfinite(rows).any(axis=0).all():
            raise AcquisitionError(f"no counts any more at: {text}")
        return self.last, (self._least, self._most)

    def _said(self, begun: FloatArray | None, wanted: str) -> str:
        self.look(0.1)
        if self.last is None or begun is None:
            return "no counts"
        moved = (self.last - begun) * self.mm
        j = int(np.argmax(np.abs(moved)))
        counts = "  ".join(f"{c} {v:+.1f}" for c, v in zip(self.channels, moved, strict=True))
        instead = (
            f"  {self.channels[j]} moves, not {wanted}" if wanted and abs(moved[j]) > LEAST_PULL_MM and self.channels[j] != wanted else ""
        )
        return f"mm: {counts}{instead}"

    def faults(self) -> dict[str, int]:
        """Faults of the frames so far."""
        return dict(self._assembler.events.tally)


def check(rig: Rig, link: Link, ask: Ask, *, passage: int = 1, turns: bool = True, settle_s: float = 0.3) -> Check:
    """Walk a person through the self-test.

    AcquisitionError when a channel does not show at all; it says what the bus shows instead.
    """
    cables = rig.cables_of(passage)
    watch = _Watch(rig, link, passage, ask, of=1 + len(cables) * (5 if turns else 3))
    watch.begin("Leave all cables at rest")
    time_s, rest = watch.look(REST_S)
    channels = watch.channels
    silent = [c for c, column in zip(channels, rest.T, strict=True) if not np.isfinite(column).any()]
    if len(time_s) < 2 or silent:
        told = ", ".join(f"{n} {kind}" for kind, n in sorted(watch.faults().items()))
        why = f"; faults: {told}" if told else ""
        raise AcquisitionError(
            f"{link.source.name}: no counts of {', '.join(silent or channels)} within {REST_S:g} s: "
            f"{watch.bus.silence(link.source.bit_rate or rig.can_table.bit_rate)}{why}"
        )
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    spread = {c: float(np.nanmax(column) - np.nanmin(column)) for c, column in zip(channels, rest.T, strict=True)}
    faults = [f"channel {c}: moves by {s:g} counts at rest" for c, s in spread.items() if s > QUIET_COUNTS]
    results = tuple(_cable(rig, watch, cable, turns=turns, settle_s=settle_s) for cable in cables)
    moved = [c.moved for c in results if c.moved is not None]
    faults += [f"channel {c} moves with {moved.count(c)} cables" for c in dict.fromkeys(moved) if moved.count(c) > 1]
    faults += watch.bus.twice()
    faults += [f"{who} from a sender that the rig does not name" for who in watch.bus.foreign()]
    faults += [f"{n} {kind}" for kind, n in sorted(watch.faults().items()) if kind != "wrap"]
    return Check(float(rate), spread, results, tuple(faults))


def _cable(rig: Rig, watch: _Watch, cable: Cable, *, turns: bool, settle_s: float) -> CableCheck:
    """One cable, again as often as the person wants."""
    begun = watch.number
    while True:
        watch.number = begun
        try:
            found = _once(rig, watch, cable, turns=turns, settle_s=settle_s)
            if found.faults:
                watch.number -= 1  # a question, and no step more
                watch.step(f"Cable {cable.name}: {'; '.join(found.faults)}. Type {AGAIN} to do it again, or go on", 0.05)
        except _Again:
            continue
        return found


def _once(rig: Rig, watch: _Watch, cable: Cable, *, turns: bool, settle_s: float) -> CableCheck:
    drum, channels, mm = rig.point(cable.from_point).drum, watch.channels, watch.mm
    start = watch.step(f"Cable {cable.name} at {cable.from_point}: get ready, do not pull yet", settle_s)[0]
    end, extremes = watch.step(f"Pull cable {cable.name} out by about 100 mm and hold it", settle_s, cable.channel)
    back, _ = watch.step(f"Let cable {cable.name} back to where it was", settle_s)
    way = np.abs(end - start) * mm
    j = int(np.argmax(way))
    faults = []
    if way[j] < LEAST_PULL_MM:
        return CableCheck(cable.name, cable.channel, faults=(f"no channel moved by {LEAST_PULL_MM:g} mm",))
    moved = channels[j]
    if moved != cable.channel:
        faults.append(f"channel {moved} moved, the rig says {cable.channel}")
    others = [c for i, c in enumerate(channels) if i != j and way[i] > CROSSTALK * way[j]]
    if others:
        faults.append(f"{', '.join(others)} moved with it")
    direction = int(np.sign(end[j] - start[j]))
    if direction != drum.count_sign:
        faults.append(f"counts {'up' if direction > 0 else 'down'} when paid out, the rig says count_sign = {drum.count_sign}")
    slack = float((back[j] - start[j]) * mm[j])
    if abs(slack) > SLACK_MM:
        faults.append(f"came back {slack:+.2f} mm from where it was: slack, or it slips on the drum")
    per_turn, expected = None, drum.counts_per_revolution * drum.scale
    if turns:
        before = watch.step(f"Drum of {cable.from_point}: get ready to turn it from mark to mark", settle_s)[0]
        after, _ = watch.step(f"Turn the drum of {cable.from_point} once, in the direction of paying out", settle_s)
        per_turn = float(abs(after[j] - before[j]))
        if abs(per_turn - expected) > TURN_TOLERANCE * expected:
            near = next((f for f in (0.25, 0.5, 2.0, 4.0) if abs(per_turn - f * expected) <= TURN_TOLERANCE * f * expected), None)
            hint = f": {near:g} times as many, as a counter decoded at another scale" if near else ""
            faults.append(f"{per_turn:.0f} counts in a turn, the rig says {expected:g}{hint}")
    stroke = float((extremes[1][j] - extremes[0][j]) * mm[j])
    return CableCheck(cable.name, cable.channel, moved, direction, stroke, slack, per_turn, expected, tuple(faults))


def corrected(content: Mapping[str, Any], result: Check) -> tuple[dict[str, Any], list[str]]:
    """A rig.toml's content with the channels and signs that the self-test showed, and what was corrected, a line each. Channels are only
    corrected where each cable moved one of its own."""
    data = copy.deepcopy(dict(content))
    told: list[str] = []
    moved = [c.moved for c in result.cables]
    tables = {c["name"]: c for c in data["cable"]}
    points = {p["name"]: p for p in data["observation_point"]}
    if None not in moved and len(set(moved)) == len(moved):
        for c in result.cables:
            if c.moved != c.channel:
                told.append(f"cable {c.cable}: channel {c.channel} -> {c.moved}")
                tables[c.cable]["channel"] = c.moved
    for c in result.cables:
        point = tables[c.cable]["from"]
        before = points[point]["drum"].get("count_sign", 1)
        if c.direction is not None and c.direction != before:
            told.append(f"drum of {point}: count_sign {before} -> {c.direction}")
            points[point]["drum"]["count_sign"] = c.direction
    return data, told
