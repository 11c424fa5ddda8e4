"""The self-test of encoders of angles: which channel is which swivel or axis of an inclinometer, and which way it counts.

A swivel's angle rises with turns about the way of travel u of the cable at its point, right-handed: clockwise for who looks along the cable
as it comes from the drum. An inclination rises as its axis does.
"""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.check.watch import LEAST_PULL_MM, LEAST_TURN_DEG, Watch
from lmeasure.rig import SensorChannel
from lmeasure.text import message

STEPS = 3
ASKED_DEG = 45.0
TILTED_DEG = 5.0
"""By which a swivel pulley is to be turned, by eye."""
AS_ASKED = 0.5
"""By how many doublings that may be off: an encoder of half or twice the resolution is farther."""
LEAST_TILT_DEG = 1.0
MOVED_MM = 50.0
CROSSTALK = 0.2
"""Of the turned pulley's way: what another one may turn with it."""
PLAY_DEG = 0.5
"""By which it may have come back to another place."""


@dataclass(frozen=True)
class EncoderCheck:
    """What one encoder showed; None where nothing moved. turned_deg and back_deg are of the channel that moved."""

    what: str
    channel: str
    moved: str | None = None
    direction: int | None = None
    turned_deg: float | None = None
    back_deg: float | None = None
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Motion:
    """What a person does to one sensor: before, the motion, and back. called: how the sensor is called; act: the motion for a simulated
    cell; about, least: by how much the reading must rise, in the unit; alone: whether the others of its kind must stand still."""

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


def encoder_checked(watch: Watch, one: SensorChannel, every: tuple[SensorChannel, ...], *, turns: bool, settle_s: float) -> EncoderCheck:
    """One sensor of a pass among every of them, again as often as the person wants; turns: see about how many counts a revolution has."""
    motion = _motion(one)
    what, alike = motion.called, [watch.channels.index(o.channel) for o in every if o.kind == one.kind]
    return watch.until_right(
        lambda: _once(watch, one, motion, alike, turns=turns, settle_s=settle_s), lambda found: (what[0].upper() + what[1:], found.faults)
    )


def _once(watch: Watch, one: SensorChannel, motion: _Motion, alike: list[int], *, turns: bool, settle_s: float) -> EncoderCheck:
    channels, what, unit = watch.channels, motion.called, motion.unit
    start = watch.step(motion.before, settle_s)[0]
    end, _ = watch.step(motion.motion, settle_s, one.channel if motion.alone else "", motion.act)
    back, _ = watch.step(motion.after, settle_s, act=f"let {one.name}")
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
