"""The self-test of a wired rig: which channel is which cable, which way it counts, how many counts a turn has, stroke and slack.

A person pulls and turns, the program looks at the counters. Counts per turn are those of the thesis (Rashoyan 2021, 5.5: 6000).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.acquisition.assembly import new_assembler
from lmeasure.acquisition.session import Link
from lmeasure.arrays import FloatArray
from lmeasure.errors import AcquisitionError
from lmeasure.rig import Cable, Drum, Rig

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


class _Watch:
    """The counters over a link, step by step."""

    def __init__(self, rig: Rig, link: Link, passage: int) -> None:
        self._link = link
        self._assembler = new_assembler(rig, link.fields, passage)
        self.last: FloatArray | None = None

    def look(self, seconds: float) -> tuple[FloatArray, FloatArray]:
        """(n,) times and (n, m) counts that came since the last look and within the next seconds."""
        times, rows = [np.empty(0)], [np.empty((0, len(self._link.fields)))]
        end = time.monotonic() + seconds
        while time.monotonic() < end or (len(times) == 1 and time.monotonic() < end + PATIENCE_S):
            frames = self._link.source.receive(0.02)
            if frames is None:
                break
            # a look at the counters, not at their times: nothing need wait for a busy host's stamps
            samples = self._assembler.feed(replace(frames, timestamp_source="log"))
            if len(samples.time_s):
                times.append(samples.time_s)
                rows.append(samples.recorded)
        time_s, recorded = np.concatenate(times), np.vstack(rows)
        seen = recorded[np.isfinite(recorded).all(axis=1)]
        if len(seen):
            self.last = seen[-1]
        return time_s, recorded

    def faults(self) -> dict[str, int]:
        """Faults of the frames so far."""
        return dict(self._assembler.events.tally)


def check(rig: Rig, link: Link, ask: Callable[[str], None], *, passage: int = 1, turns: bool = True, settle_s: float = 0.3) -> Check:
    """Walk a person through the self-test. ask shows a text and returns when the person has done it.

    AcquisitionError when a channel does not show at all.
    """
    watch = _Watch(rig, link, passage)
    channels = [f.channel for f in link.fields]
    ask("Leave all cables at rest")
    watch.look(0.0)
    time_s, rest = watch.look(REST_S)
    silent = [c for c, column in zip(channels, rest.T, strict=True) if not np.isfinite(column).any()]
    if len(time_s) < 2 or silent:
        raise AcquisitionError(
            f"{link.source.name}: no counts of {', '.join(silent or channels)} within {REST_S:g} s; faults: {watch.faults() or 'none'}"
        )
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    spread = {c: float(np.nanmax(column) - np.nanmin(column)) for c, column in zip(channels, rest.T, strict=True)}
    faults = [f"channel {c}: moves by {s:g} counts at rest" for c, s in spread.items() if s > QUIET_COUNTS]
    drums = rig.drums_of(passage)
    # of encoders no length: no pull is one of theirs
    mm = np.array([drums[c].count_length_mm / drums[c].scale if c in drums else 0.0 for c in channels])
    results = tuple(_cable(rig, watch, ask, cable, drums[cable.channel], channels, mm, turns, settle_s) for cable in rig.cables_of(passage))
    moved = [c.moved for c in results if c.moved is not None]
    faults += [f"channel {c} moves with {moved.count(c)} cables" for c in dict.fromkeys(moved) if moved.count(c) > 1]
    faults += [f"{n} {kind}" for kind, n in sorted(watch.faults().items()) if kind != "wrap"]
    return Check(float(rate), spread, results, tuple(faults))


def _cable(
    rig: Rig,
    watch: _Watch,
    ask: Callable[[str], None],
    cable: Cable,
    drum: Drum,
    channels: list[str],
    mm: FloatArray,
    turns: bool,
    settle_s: float,
) -> CableCheck:
    start = _step(watch, ask, f"Cable {cable.name} at {cable.from_point}: get ready, do not pull yet", settle_s)[0]
    end, extremes = _step(watch, ask, f"Pull cable {cable.name} out by about 100 mm and hold it", settle_s)
    back, _ = _step(watch, ask, f"Let cable {cable.name} back to where it was", settle_s)
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
        before = _step(watch, ask, f"Drum of {cable.from_point}: get ready to turn it from mark to mark", settle_s)[0]
        after, _ = _step(watch, ask, f"Turn the drum of {cable.from_point} once, in the direction of paying out", settle_s)
        per_turn = float(abs(after[j] - before[j]))
        if abs(per_turn - expected) > TURN_TOLERANCE * expected:
            near = next((f for f in (0.25, 0.5, 2.0, 4.0) if abs(per_turn - f * expected) <= TURN_TOLERANCE * f * expected), None)
            hint = f": {near:g} times as many, as a counter decoded at another scale" if near else ""
            faults.append(f"{per_turn:.0f} counts in a turn, the rig says {expected:g}{hint}")
    stroke = float((extremes[1][j] - extremes[0][j]) * mm[j])
    return CableCheck(cable.name, cable.channel, moved, direction, stroke, slack, per_turn, expected, tuple(faults))


def _step(watch: _Watch, ask: Callable[[str], None], text: str, settle_s: float) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
    """The counts when the person has done it, and the least and largest on the way."""
    ask(text)
    _, rows = watch.look(settle_s)
    if watch.last is None or not np.isfinite(rows).any(axis=0).all():
        raise AcquisitionError(f"no counts any more at: {text}")
    return watch.last, (np.nanmin(rows, axis=0), np.nanmax(rows, axis=0))
