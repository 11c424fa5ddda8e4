"""The self-test of a wired rig: which channel is which cable, which way it counts, how many counts a turn has, stroke and slack.

A person pulls and turns, the program looks at the counters. Counts per turn are those of the thesis (Rashoyan 2021, 5.5: 6000).
"""

import copy
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from lmeasure.acquisition.bus.transmission import ordinal
from lmeasure.acquisition.check.encoders import STEPS, EncoderCheck, encoder_checked
from lmeasure.acquisition.check.watch import AGAIN as AGAIN, LEAST_PULL_MM, Ask as Ask, Step as Step, Watch
from lmeasure.acquisition.counters.wraps import range_notes
from lmeasure.acquisition.session import Link
from lmeasure.core import AcquisitionError, DataFrame, Shown, framed
from lmeasure.rig import Cable, Rig, SensorChannel, default_can, rig_from_dict

REST_S = 1.0
"""How long the counters are looked at before anything is moved."""
QUIET_COUNTS = 3.0
QUIET_DEG = 0.01
"""Spread of a counter at rest, of an encoder whichever is more."""
CROSSTALK = 0.2
"""Of the pulled cable's way: what another channel may move with it."""
TURN_TOLERANCE = 0.01
"""A turn by hand from mark to mark is good to a few degrees."""
SLACK_MM = 0.5
FINE = ("wrap", "clock_wrap", "unanswered")
"""Events that are no faults."""


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


@dataclass(frozen=True, repr=False)
class Check(Shown):
    """The self-test: sample rate [Hz], spread at rest per channel [counts], one row per cable and per encoder, faults of the whole."""

    rate_hz: float
    spread: dict[str, float]
    cables: tuple[CableCheck, ...]
    faults: tuple[str, ...]
    encoders: tuple[EncoderCheck, ...] = ()
    notes: tuple[str, ...] = ()

    @property
    def all_faults(self) -> list[str]:
        """One line each."""
        return [
            *self.faults,
            *(f"cable {c.cable}: {f}" for c in self.cables for f in c.faults),
            *(f"{e.what}: {f}" for e in self.encoders for f in e.faults),
        ]

    def about(self) -> dict[str, str]:
        """What each cable and encoder showed, by its name: its faults, or ok and what was counted."""
        told = {c.cable: c.faults or (f"ok: {c.channel}, {_or_not(c.stroke_mm)} mm, slack {_or_not(c.slack_mm)} mm",) for c in self.cables}
        told |= {e.what: e.faults or (f"ok: {e.channel}, {_or_not(e.turned_deg)} deg",) for e in self.encoders}
        return {name: "; ".join(texts) for name, texts in told.items()}

    def to_frame(self) -> DataFrame:
        """A row for each cable."""
        return framed([asdict(c) | {"faults": "; ".join(c.faults)} for c in self.cables])


def _or_not(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def self_test(rig: Rig, link: Link, ask: Ask, *, passage: int = 1, turns: bool = True, settle_s: float = 0.3) -> Check:
    """Walk a person through the self-test.

    AcquisitionError when a channel does not show at all; it says what the bus shows instead.
    """
    cables = rig.cables_of(passage)
    turned = tuple(o for o in rig.observed if isinstance(o, SensorChannel) and o.passage == passage)
    watch = Watch(rig, link, passage, ask, of=1 + len(cables) * (5 if turns else 3) + STEPS * len(turned))
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
    quiet = np.where(watch.lengths, QUIET_COUNTS, np.maximum(QUIET_COUNTS, QUIET_DEG / watch.unit))
    faults = [f"channel {c}: moves by {s:g} counts at rest" for (c, s), most in zip(spread.items(), quiet, strict=True) if s > most]
    results = tuple(_cable(rig, watch, cable, turns=turns, settle_s=settle_s) for cable in cables)
    moved = [c.moved for c in results if c.moved is not None]
    faults += [f"channel {c} moves with {moved.count(c)} cables" for c in dict.fromkeys(moved) if moved.count(c) > 1]
    encoders = tuple(encoder_checked(watch, one, turned, turns=turns, settle_s=settle_s) for one in turned)
    moved = [e.moved for e in encoders if e.moved is not None]
    faults += [f"channel {c} moves with {moved.count(c)} encoders" for c in dict.fromkeys(moved) if moved.count(c) > 1]
    every = watch.every()
    faults += watch.bus.twice(every)
    faults += [f"{who} from a sender that the rig does not name" for who in watch.bus.foreign()]
    faults += [f"{n} {kind}" for kind, n in sorted(watch.faults().items()) if kind not in FINE]
    notes = [f"channel {c}: answers every {ordinal(n)} SYNC" for c, n in every.items()]
    notes += range_notes(rig, link.fields, passage, 1.0 / float(rate))
    return Check(float(rate), spread, results, tuple(faults), encoders, tuple(notes))


def _cable(rig: Rig, watch: Watch, cable: Cable, *, turns: bool, settle_s: float) -> CableCheck:
    """One cable, again as often as the person wants."""
    return watch.until_right(
        lambda: _once(rig, watch, cable, turns=turns, settle_s=settle_s), lambda found: (f"Cable {cable.name}", found.faults)
    )


def _once(rig: Rig, watch: Watch, cable: Cable, *, turns: bool, settle_s: float) -> CableCheck:
    drum, channels, mm, drums = rig.point(cable.from_point).drum, watch.channels, watch.unit, np.flatnonzero(watch.lengths)
    start = watch.step(f"Cable {cable.name} at {cable.from_point}: get ready, do not pull yet", settle_s)[0]
    end, extremes = watch.step(f"Pull cable {cable.name} out by about 100 mm and hold it", settle_s, cable.channel, f"pull {cable.name}")
    back, _ = watch.step(f"Let cable {cable.name} back to where it was", settle_s, act=f"let {cable.name}")
    way = np.abs(end - start) * mm
    j = int(drums[np.argmax(way[drums])])
    faults = []
    if way[j] < LEAST_PULL_MM:
        return CableCheck(cable.name, cable.channel, faults=(f"no channel moved by {LEAST_PULL_MM:g} mm{watch.instead(way)}",))
    moved = channels[j]
    if moved != cable.channel:
        faults.append(f"channel {moved} moved, the rig says {cable.channel}")
    others = [channels[i] for i in drums if i != j and way[i] > CROSSTALK * way[j]]
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
        turn = f"Turn the drum of {cable.from_point} once, in the direction of paying out"
        after, _ = watch.step(turn, settle_s, act=f"turn {cable.name}")
        per_turn = float(abs(after[j] - before[j]))
        if abs(per_turn - expected) > TURN_TOLERANCE * expected:
            near = next((f for f in (0.25, 0.5, 2.0, 4.0) if abs(per_turn - f * expected) <= TURN_TOLERANCE * f * expected), None)
            hint = f": {near:g} times as many, as a counter decoded at another scale" if near else ""
            faults.append(f"{per_turn:.0f} counts in a turn, the rig says {expected:g}{hint}")
    stroke = float((extremes[1][j] - extremes[0][j]) * mm[j])
    return CableCheck(cable.name, cable.channel, moved, direction, stroke, slack, per_turn, expected, tuple(faults))


def _one_each(checks: Sequence[CableCheck] | Sequence[EncoderCheck]) -> bool:
    """Whether each moved a channel of its own."""
    moved = [c.moved for c in checks]
    return None not in moved and len(set(moved)) == len(moved)


def not_corrected(result: Check) -> tuple[str, ...]:
    """Why channels that are not those of the rig stay as they are, a line for cables and one for encoders."""
    out = []
    for kind, checks in (("cable", result.cables), ("encoder", result.encoders)):
        if any(c.moved not in (None, c.channel) for c in checks) and not _one_each(checks):
            out.append(f"channels stay as they are: not every {kind} moved one of its own; check again, then --write")
    return tuple(out)


def corrected(content: Mapping[str, Any], result: Check) -> tuple[dict[str, Any], list[str]]:
    """A rig.toml's content with the channels and signs that the self-test showed, and what was corrected, a line each. Channels are only
    corrected where each cable, and each encoder, moved one of its own.

    Without a table [can] the n-th channel is node n: where channels change their places one is written, or the nodes would go with them.
    """
    data = copy.deepcopy(dict(content))
    told: list[str] = []
    tables = {c["name"]: c for c in data["cable"]}
    points = {p["name"]: p for p in data["observation_point"]}
    if _one_each(result.cables):
        for c in result.cables:
            if c.moved != c.channel:
                told.append(f"cable {c.cable}: channel {c.channel} -> {c.moved}")
                tables[c.cable]["channel"] = c.moved
    for c in result.cables:
        point = tables[c.cable]["from"]
        before = points[point]["drum"].get("count_sign", 1)
        # of a channel that is not the cable's in the end the direction is another drum's
        if c.direction is not None and c.direction != before and tables[c.cable]["channel"] == c.moved:
            told.append(f"drum of {point}: count_sign {before} -> {c.direction}")
            points[point]["drum"]["count_sign"] = c.direction
    turned = {table["channel"]: table for kind in rig_from_dict(data).sensor_tables for table in data.get(kind, ())}
    owners: dict[str, str | None] = {e.what: e.channel for e in result.encoders}
    if _one_each(result.encoders):
        for e in result.encoders:
            if e.moved != e.channel:
                told.append(f"{e.what}: channel {e.channel} -> {e.moved}; see that its zero_deg is that encoder's")
                turned[e.channel]["channel"] = owners[e.what] = e.moved
    for e in result.encoders:
        before = turned[e.channel].get("count_sign", 1)
        if e.direction is not None and e.direction != before and owners[e.what] == e.moved:
            told.append(f"{e.what}: count_sign {before} -> {e.direction}")
            turned[e.channel]["count_sign"] = e.direction
    frames = {c.channel: c.id for c in default_can(rig_from_dict(dict(content)).all_channels).channel}
    if "can" not in data and frames != {c.channel: c.id for c in default_can(rig_from_dict(data).all_channels).channel}:
        data["can"] = {"decoder": "raw", "channel": [{"channel": channel, "id": identifier} for channel, identifier in frames.items()]}
        told.append("a table [can] says which frames the channels are, as before")
    return data, told
