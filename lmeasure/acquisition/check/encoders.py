"""The self-test of encoders of angles: which channel is which swivel or axis of an inclinometer, and which way it counts.

A swivel's angle rises with turns about the way of travel u of the cable at its point, right-handed: clockwise for who looks along the cable
as it comes from the drum. An inclination rises as its axis does.
"""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.check.watch import LEAST_TURN_DEG, Watch
from lmeasure.rig import Inclination, Swivel, Turned

STEPS = 3
ASKED_DEG = 45.0
TILTED_DEG = 5.0
"""By which a swivel pulley is to be turned, by eye."""
AS_ASKED = 0.5
"""By how many doublings that may be off: an encoder of half or twice the resolution is farther."""
LEAST_TILT_DEG = 1.0
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


def encoder_checked(watch: Watch, one: Turned, every: tuple[Turned, ...], *, turns: bool, settle_s: float) -> EncoderCheck:
    """One encoder of a pass among every of them, again as often as the person wants; turns: see about how many counts a revolution has."""
    what = f"swivel of {one.from_point}" if isinstance(one.encoder, Swivel) else f"inclination {one.name}"
    alike = [watch.channels.index(o.channel) for o in every if type(o.encoder) is type(one.encoder)]
    return watch.until_right(
        lambda: _once(watch, one, what, alike, turns=turns, settle_s=settle_s), lambda found: (what[0].upper() + what[1:], found.faults)
    )


def _asked(one: Turned) -> tuple[str, str, str]:
    """What a person is asked for: before, the motion, and back."""
    if isinstance(one.encoder, Inclination):
        axis = ", ".join(f"{x:g}" for x in one.encoder.axis)
        side = f"the side to which its axis ({axis}) points"
        motion = f"Tilt the tool by about {TILTED_DEG:g} degrees so that it rises on {side}, and hold it"
        return "Tool: get ready to tilt it, do not move it yet", motion, "Tilt the tool back to where it was"
    point = one.from_point
    return (
        f"Swivel pulley of {point}: get ready, do not turn it yet",
        f"Turn the swivel pulley of {point} by about {ASKED_DEG:g} degrees, clockwise as seen along the cable from the drum, and hold it",
        f"Let the swivel pulley of {point} back to where it was",
    )


def _once(watch: Watch, one: Turned, what: str, alike: list[int], *, turns: bool, settle_s: float) -> EncoderCheck:
    swivel, channels = isinstance(one.encoder, Swivel), watch.channels
    before, motion, after = _asked(one)
    start = watch.step(before, settle_s)[0]
    end, _ = watch.step(motion, settle_s, one.channel if swivel else "", f"swing {one.name} {ASKED_DEG if swivel else TILTED_DEG:g}")
    back, _ = watch.step(after, settle_s, act=f"let {one.name}")
    turned = (end - start) * watch.unit
    way = np.abs(turned)
    j = alike[int(np.argmax(way[alike]))]
    least = LEAST_TURN_DEG if swivel else LEAST_TILT_DEG
    if way[j] < least:
        kind = "swivel" if swivel else "inclination"
        return EncoderCheck(what, one.channel, faults=(f"no {kind} turned by {least:g} degrees{watch.instead(way)}",))
    faults = []
    if channels[j] != one.channel:
        faults.append(f"channel {channels[j]} turned, the rig says {one.channel}")
    others = [channels[i] for i in alike if i != j and way[i] > CROSSTALK * way[j]]
    if swivel and others:
        faults.append(f"{', '.join(others)} turned with it")
    direction = int(np.sign(turned[j]))
    if direction != one.encoder.count_sign:
        faults.append(f"counts {'up' if direction > 0 else 'down'}, the rig says count_sign = {one.encoder.count_sign}")
    play = float((back[j] - start[j]) * watch.unit[j])
    if abs(play) > PLAY_DEG:
        faults.append(f"came back {play:+.2f} degrees from where it was: loose on its shaft, or the cable does not take it along")
    doublings = math.log2(way[j] / ASKED_DEG)
    if swivel and turns and abs(doublings) > AS_ASKED and channels[j] == one.channel:
        counts = one.encoder.counts_per_revolution * way[j] / ASKED_DEG
        faults.append(
            f"turned by {way[j]:.0f} degrees with counts_per_revolution = {one.encoder.counts_per_revolution}; if it was by about "
            f"{ASKED_DEG:g}, a revolution has about {counts:.2g} counts"
        )
    return EncoderCheck(what, one.channel, channels[j], direction, float(way[j]), play, tuple(faults))
