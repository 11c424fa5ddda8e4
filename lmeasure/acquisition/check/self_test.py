"""The self-test of a wired rig: which channel is which cable, which way it counts, how many counts a turn has, stroke and slack.

A person pulls and turns, the program looks at the counters. Counts per turn are those of the thesis (Rashoyan 2021, 5.5: 6000).
"""

import copy
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from lmeasure.acquisition.bus.network import ordinal
from lmeasure.acquisition.check.watch import AGAIN as AGAIN, LEAST_PULL_MM, LEAST_TURN_DEG, Ask as Ask, Step as Step, Watch
from lmeasure.acquisition.counters.origins import range_notes
from lmeasure.acquisition.session import Link
from lmeasure.core import AcquisitionError, DataFrame, Shown, framed
from lmeasure.rig import Cable, Rig, SensorChannel, default_can, rig_from_dict
from lmeasure.text import Message, count_of, joined, message

STEPS = 3
ASKED_DEG = 45.0
TILTED_DEG = 5.0
"""Angle of a turn of a swivel pulley, by eye."""
AS_ASKED = 0.5
"""Doublings by which that may be off; an encoder of half or twice the resolution is farther off."""
LEAST_TILT_DEG = 1.0
MOVED_MM = 50.0
PLAY_DEG = 0.5
"""Difference [deg] allowed after the way back."""


@dataclass(frozen=True)
class EncoderCheck:
    """Result of one encoder; None where nothing moved. turned_deg and back_deg are of the channel that moved."""

    what: str
    channel: str
    moved: str | None = None
    direction: int | None = None
    turned_deg: float | None = None
    back_deg: float | None = None
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Motion:
    """Actions of a user on one sensor: before, the motion, and back. called: the sensor's name; act: the motion for a simulated cell;
    about, least: wanted and smallest rise of the reading, in the unit; alone: whether the others of its kind must be at rest."""

    before: str
    motion: str
    after: str
    called: str
    act: str
    about: float
    least: float
    unit: str = "degrees"
    alone: bool = False


def _motion(one: SensorChannel) -> _Motion:
    if one.kind == "swivel":
        point = one.from_point
        return _Motion(
            message("acquisition.swivel_pulley_get_ready", point=point),
            message("acquisition.turn_swivel_pulley_about_degrees", point=point, asked_deg=ASKED_DEG),
            message("acquisition.let_swivel_pulley_back", point=point),
            message("acquisition.swivel", point=point),
            f"swing {one.name} {ASKED_DEG:g}",
            ASKED_DEG,
            LEAST_TURN_DEG,
            alone=True,
        )
    if one.kind == "inclination":
        axis = ", ".join(f"{x:g}" for x in getattr(one.table, "axis", ()))
        motion = message("acquisition.tilt_tool", deg=TILTED_DEG, axis=axis)
        act = f"swing {one.name} {TILTED_DEG:g}"
        return _Motion(
            message("acquisition.tool_get_ready_tilt"), motion, message("acquisition.tilt_tool_back_where"),
            message("acquisition.inclination", name=one.name), act, TILTED_DEG, LEAST_TILT_DEG,
        )  # fmt: skip
    about, least, unit = (MOVED_MM, LEAST_PULL_MM, "mm") if one.is_length else (TILTED_DEG, LEAST_TILT_DEG, "degrees")
    move, sign = one.table.motion or message("acquisition.sensor_motion"), "unit_sign.mm" if unit == "mm" else "acquisition.degrees"
    return _Motion(
        message("acquisition.sensor_ready", kind=one.kind, name=one.name),
        message("acquisition.sensor_move", motion=move, about=about, unit=message(sign)),
        message("acquisition.sensor_back"), message("channel.sensor", kind=one.kind, name=one.name),
        f"swing {one.name} {about:g}", about, least, unit,
    )  # fmt: skip


def _encoder(watch: Watch, one: SensorChannel, every: tuple[SensorChannel, ...], *, turns: bool) -> EncoderCheck:
    """One sensor of a pass among every of them, again as often as the person wants; turns: see about how many counts a revolution has."""
    motion = _motion(one)
    what, alike = motion.called, [watch.channels.index(o.channel) for o in every if o.kind == one.kind]
    return watch.until_right(
        lambda: _encoder_once(watch, one, motion, alike, turns=turns), lambda found: (what[0].upper() + what[1:], found.faults)
    )


def _encoder_once(watch: Watch, one: SensorChannel, motion: _Motion, alike: list[int], *, turns: bool) -> EncoderCheck:
    channels, what, unit = watch.channels, motion.called, motion.unit
    start = watch.step(motion.before)[0]
    end, _ = watch.step(motion.motion, one.channel if motion.alone else "", motion.act)
    back, _ = watch.step(motion.after, act=f"let {one.name}")
    turned = (end - start) * watch.unit
    way = np.abs(turned)
    j = alike[int(np.argmax(way[alike]))]
    if way[j] < motion.least:
        return EncoderCheck(what, one.channel, faults=(watch.nothing("check.no_kind", way, kind=one.kind, least=motion.least, unit=unit),))
    faults: list[str] = []
    if channels[j] != one.channel:
        faults.append(message("acquisition.channel_turned_rig_says", channels=channels[j], channel=one.channel))
    others = [channels[i] for i in alike if i != j and way[i] > CROSSTALK * way[j]]
    if motion.alone and others:
        faults.append(message("acquisition.turned", v1=tuple(others)))
    direction = int(np.sign(turned[j]))
    if direction != one.table.count_sign:
        faults.append(message("check.counts_up" if direction > 0 else "check.counts_down", sign=one.table.count_sign))
    play = float((back[j] - start[j]) * watch.unit[j])
    if unit == "degrees" and abs(play) > PLAY_DEG:
        faults.append(message("acquisition.came_back_degrees_from", play=play))
    doublings = math.log2(way[j] / motion.about)
    if motion.alone and turns and abs(doublings) > AS_ASKED and channels[j] == one.channel:
        counts = one.table.counts_per_revolution * way[j] / motion.about
        faults.append(
            message(
                "acquisition.turned_degrees_counts_per_revolution",
                way=way[j],
                counts_per_revolution=one.table.counts_per_revolution,
                about=motion.about,
                counts=counts,
            )
        )
    return EncoderCheck(what, one.channel, channels[j], direction, float(way[j]), play, tuple(faults))


REST_S = 1.0
"""Time of looking at the counters before anything is moved."""
QUIET_COUNTS = 3.0
QUIET_DEG = 0.01
"""Spread of a counter at rest, of an encoder whichever is more."""
CROSSTALK = 0.2
"""Part of a motion by which another channel of the same kind may move with it."""
TURN_TOLERANCE = 0.01
"""A turn by hand from mark to mark is good to a few degrees."""
SLACK_MM = 0.5
FINE = ("wrap", "clock_wrap", "unanswered")
"""Events that are no faults."""


@dataclass(frozen=True)
class CableCheck:
    """Result of one cable; None where a step was left out. stroke_mm and slack_mm are of the channel that moved."""

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
            *(message("acquisition.cable", cable=c.cable, f=f) for c in self.cables for f in c.faults),
            *(message("check.encoder_fault", what=e.what, fault=f) for e in self.encoders for f in e.faults),
        ]

    def about(self) -> dict[str, str]:
        """Return the result of each cable and encoder by its name: its faults, or ok and its counts."""
        reported = {
            c.cable: c.faults
            or (message("acquisition.ok_mm_slack_mm", channel=c.channel, _or_not=_or_not(c.stroke_mm), _or_not_=_or_not(c.slack_mm)),)
            for c in self.cables
        }
        reported |= {
            e.what: e.faults or (message("check.ok_encoder", channel=e.channel, turned=_or_not(e.turned_deg)),) for e in self.encoders
        }
        return {name: joined(texts) for name, texts in reported.items()}

    def to_frame(self) -> DataFrame:
        """A row for each cable."""
        return framed([asdict(c) | {"faults": "; ".join(c.faults)} for c in self.cables])


def _or_not(value: float | None) -> str:
    return "-" if value is None else f"{value:.1f}"


def self_test(rig: Rig, link: Link, ask: Ask, *, passage: int = 1, turns: bool = True, settle_s: float = 0.3) -> Check:
    """Walk the user through the self-test. AcquisitionError if a channel does not show at all; it names the frames on the bus instead."""
    cables = rig.cables_of(passage)
    turned = tuple(o for o in rig.observed if isinstance(o, SensorChannel) and o.passage == passage)
    watch = Watch(rig, link, passage, ask, of=1 + len(cables) * (5 if turns else 3) + STEPS * len(turned), settle_s=settle_s)
    watch.begin(message("acquisition.leave_all_cables_rest"))
    time_s, rest = watch.look(REST_S)
    channels = watch.channels
    silent = [c for c, column in zip(channels, rest.T, strict=True) if not np.isfinite(column).any()]
    if len(time_s) < 2 or silent:
        reported = ", ".join(f"{n} {kind}" for kind, n in sorted(watch.faults().items()))
        why = f"; faults: {reported}" if reported else ""
        raise AcquisitionError(
            message(
                "error.no_counts_of_within",
                where=link.source.name,
                silent=", ".join(silent or channels),
                rest_s=REST_S,
                silence=watch.bus.silence(link.source.bit_rate or rig.can_table.bit_rate),
                why=why,
            )
        )
    rate = (len(time_s) - 1) / (time_s[-1] - time_s[0])
    spread = {c: float(np.nanmax(column) - np.nanmin(column)) for c, column in zip(channels, rest.T, strict=True)}
    quiet = np.where(watch.lengths, QUIET_COUNTS, np.maximum(QUIET_COUNTS, QUIET_DEG / watch.unit))
    faults: list[str] = [
        message("acquisition.channel_moves_counts_rest", channel=c, counts=s)
        for (c, s), most in zip(spread.items(), quiet, strict=True)
        if s > most
    ]
    results = tuple(
        watch.until_right(partial(_cable, rig, watch, cable, turns=turns), lambda found: (f"Cable {found.cable}", found.faults))
        for cable in cables
    )
    faults += _shared("acquisition.channel_moves_cables", results)
    encoders = tuple(_encoder(watch, one, turned, turns=turns) for one in turned)
    faults += _shared("check.moves_encoders", encoders)
    every = watch.every()
    faults += watch.bus.twice(every)
    faults += [message("acquisition.from_sender_rig_does", who=who) for who in watch.bus.foreign()]
    faults += [count_of(kind, n) for kind, n in sorted(watch.faults().items()) if kind not in FINE]
    notes: list[str] = [message("acquisition.channel_answers_every_sync", channel=c, n=ordinal(n)) for c, n in every.items()]
    notes += range_notes(rig, link.fields, passage, 1.0 / float(rate))
    return Check(float(rate), spread, results, tuple(faults), encoders, tuple(notes))


def _cable(rig: Rig, watch: Watch, cable: Cable, *, turns: bool) -> CableCheck:
    drum, channels, mm, drums = rig.point(cable.from_point).drum, watch.channels, watch.unit, np.flatnonzero(watch.lengths)
    start = watch.step(message("acquisition.cable_get_ready_do", cable=cable.name, point=cable.from_point))[0]
    end, extremes = watch.step(message("acquisition.pull_cable_out_about", cable=cable.name), cable.channel, f"pull {cable.name}")
    back, _ = watch.step(message("acquisition.let_cable_back_where", cable=cable.name), act=f"let {cable.name}")
    way = np.abs(end - start) * mm
    j = int(drums[np.argmax(way[drums])])
    faults: list[str] = []
    if way[j] < LEAST_PULL_MM:
        return CableCheck(cable.name, cable.channel, faults=(watch.nothing("check.no_channel", way, least=LEAST_PULL_MM),))
    moved = channels[j]
    if moved != cable.channel:
        faults.append(message("acquisition.channel_moved_rig_says", moved=moved, channel=cable.channel))
    others = [channels[i] for i in drums if i != j and way[i] > CROSSTALK * way[j]]
    if others:
        faults.append(message("acquisition.moved", channels=tuple(others)))
    direction = int(np.sign(end[j] - start[j]))
    if direction != drum.count_sign:
        faults.append(message("check.counts_up_paid" if direction > 0 else "check.counts_down_paid", sign=drum.count_sign))
    slack = float((back[j] - start[j]) * mm[j])
    if abs(slack) > SLACK_MM:
        faults.append(message("acquisition.came_back_mm_from", slack=slack))
    per_turn, expected = None, drum.counts_per_revolution * drum.scale
    if turns:
        before = watch.step(message("acquisition.drum_get_ready_turn", point=cable.from_point))[0]
        turn = message("acquisition.turn_drum_once_direction", point=cable.from_point)
        after, _ = watch.step(turn, act=f"turn {cable.name}")
        per_turn = float(abs(after[j] - before[j]))
        if abs(per_turn - expected) > TURN_TOLERANCE * expected:
            near = next((f for f in (0.25, 0.5, 2.0, 4.0) if abs(per_turn - f * expected) <= TURN_TOLERANCE * f * expected), None)
            code = "check.per_turn_times" if near else "check.per_turn"
            faults.append(message(code, counts=per_turn, expected=expected, times=near))
    stroke = float((extremes[1][j] - extremes[0][j]) * mm[j])
    return CableCheck(cable.name, cable.channel, moved, direction, stroke, slack, per_turn, expected, tuple(faults))


def _shared(code: str, checks: Sequence[CableCheck] | Sequence[EncoderCheck]) -> list[Message]:
    """Return a fault for each channel that several moved."""
    moved = Counter(c.moved for c in checks if c.moved is not None)
    return [message(code, channel=channel, count=count) for channel, count in moved.items() if count > 1]


def _one_each(checks: Sequence[CableCheck] | Sequence[EncoderCheck]) -> bool:
    """Return whether each moved a channel of its own."""
    moved = [c.moved for c in checks]
    return None not in moved and len(set(moved)) == len(moved)


def not_corrected(result: Check) -> tuple[str, ...]:
    """Return why channels that differ from the rig's stay uncorrected, a line for cables and one for encoders."""
    out = []
    for kind, checks in (("cable", result.cables), ("encoder", result.encoders)):
        if any(c.moved not in (None, c.channel) for c in checks) and not _one_each(checks):
            out.append(message(f"check.stay_{kind}"))
    return tuple(out)


def corrected(content: Mapping[str, Any], result: Check) -> tuple[dict[str, Any], list[str]]:
    """Return a rig.toml's content with the channels and signs of the self-test, and each correction in a line. Channels are only corrected
    if each cable, and each encoder, moved one of its own.

    Without a table [can] the n-th channel is node n: if channels change places, the table is written, or the nodes would move too.
    """
    data = copy.deepcopy(dict(content))
    reported: list[str] = []
    tables = {c["name"]: c for c in data["cable"]}
    points = {p["name"]: p for p in data["observation_point"]}
    if _one_each(result.cables):
        for c in result.cables:
            if c.moved != c.channel:
                reported.append(message("acquisition.cable_channel", cable=c.cable, was=c.channel, now=c.moved))
                tables[c.cable]["channel"] = c.moved
    for c in result.cables:
        point = tables[c.cable]["from"]
        before = points[point]["drum"].get("count_sign", 1)
        # of a channel that is not the cable's in the end the direction is another drum's
        if c.direction is not None and c.direction != before and tables[c.cable]["channel"] == c.moved:
            reported.append(message("acquisition.drum_count_sign", point=point, was=before, now=c.direction))
            points[point]["drum"]["count_sign"] = c.direction
    turned = {table["channel"]: table for kind in rig_from_dict(data).sensor_tables for table in data.get(kind, ())}
    owners: dict[str, str | None] = {e.what: e.channel for e in result.encoders}
    if _one_each(result.encoders):
        for e in result.encoders:
            if e.moved != e.channel:
                reported.append(message("check.encoder_channel", what=e.what, was=e.channel, now=e.moved))
                turned[e.channel]["channel"] = owners[e.what] = e.moved
    for e in result.encoders:
        before = turned[e.channel].get("count_sign", 1)
        if e.direction is not None and e.direction != before and owners[e.what] == e.moved:
            reported.append(message("check.encoder_sign", what=e.what, was=before, now=e.direction))
            turned[e.channel]["count_sign"] = e.direction
    frames = {c.channel: c.id for c in default_can(rig_from_dict(dict(content)).all_channels).channel}
    if "can" not in data and frames != {c.channel: c.id for c in default_can(rig_from_dict(data).all_channels).channel}:
        data["can"] = {"decoder": "raw", "channel": [{"channel": channel, "id": identifier} for channel, identifier in frames.items()]}
        reported.append(message("acquisition.table_can_says_frames"))
    return data, reported
