"""Contribution of the samples' uncertain instants to results of speeds and times; places and shapes do not feel it."""

from dataclasses import replace
from typing import Any

import numpy as np

from lmeasure.iso9283.characteristic import Characteristic, Contribution
from lmeasure.iso9283.figure import OfInstants
from lmeasure.iso9283.paths import Crossings
from lmeasure.iso9283.uncertainty import NORMAL_95
from lmeasure.recording import Program
from lmeasure.text import message
from lmeasure.trajectory import ErrorSource, PoseErrors, Stamps

APART = 10.0
"""Standard uncertainties of an instant that lie between planes at least, for speeds between them to tell anything."""


def on_times(program: Program, stamps: Stamps) -> Program:
    """The program with its windows, stated by the recorded stamps, on the times of the samples."""
    if stamps.kind != "even":
        return program

    def moved(part: Any) -> Any:
        stated = {key: getattr(part, key) for key in ("windows_s", "settling_s") if hasattr(part, key)}
        on = {key: tuple((_on_times(start, stamps), _on_times(end, stamps)) for start, end in windows) for key, windows in stated.items()}
        return part.model_copy(update=on)

    return program.model_copy(update={kind: tuple(map(moved, getattr(program, kind))) for kind in ("pose", "path", "posing", "compliance")})


def _on_times(stamp_s: float, stamps: Stamps) -> float:
    """The time of a recorded instant; before the first and behind the last sample as far from them as it was."""
    first, last = (float(x) for x in stamps.stamp_s[[0, -1]])
    within = min(max(stamp_s, first), last)
    return float(np.interp(within, stamps.stamp_s, stamps.time_s)) + stamp_s - within


def most_planes(stamps: Stamps, duration_s: float) -> int:
    """Planes that a path of this duration may have."""
    return int(duration_s / (APART * stamps.u_time_s)) if stamps.u_time_s > 0.0 else np.iinfo(np.int64).max


def of_crossing(places: PoseErrors, crossed: Crossings, stamps: Stamps) -> PoseErrors:
    """The errors (m n poses) of the places where planes are crossed, and those of when: an instant that is off by dt is a place that is off
    along the path by as much as the robot goes in dt. Anew at every crossing by u_time_s; in common, in proportion to the time since the
    middle of its cycle, by u_rate."""
    if stamps.kind == "sound":
        return places
    m, n = crossed.time_s.shape
    along = np.zeros((m, n, 6, 1))
    along[..., 3:, 0] = crossed.tangent[:, None] * crossed.pace_mm_s[:, :, None]
    since = crossed.time_s - crossed.time_s.mean(axis=0)
    single = (along * stamps.u_time_s).reshape(-1, 6, 1)
    common = (along[..., 0] * (stamps.u_rate * since)[:, :, None]).reshape(-1, 6)
    timed = replace(places, own=np.concatenate([places.own, single], axis=2))
    return timed.with_shared(common, ErrorSource(message("source.instants")))


def with_instants(c: Characteristic, added: OfInstants) -> Characteristic:
    """A figure with what the instants of its samples add to it."""
    row = Contribution(message("source.instants"), added.u)
    return c.with_budget((*c.budget, *(row,) * (added.u > 0.0)), float(np.hypot(c.u95, NORMAL_95 * added.u) + added.bias))


def of_duration(c: Characteristic, stamps: Stamps) -> Characteristic:
    """A duration, the mean of its cycles, with both ends of each cycle and the rate that all have in common."""
    if stamps.kind == "sound":
        return c
    return with_instants(c, OfInstants(float(np.hypot(np.sqrt(2.0 / c.cycles) * stamps.u_time_s, abs(c.value) * stamps.u_rate))))
