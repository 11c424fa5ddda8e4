"""Reasons why samples of a channel are not used: faults of its counter, and gaps between the samples of a later pass."""

from collections.abc import Mapping
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from lmeasure.core import BoolArray, FloatArray, OtherTimes, Status
from lmeasure.kernels import EMPTY, FOLLOWED, FOREIGN, JUMPED, UNSURE, WENT_ON
from lmeasure.recording import Unwrapped
from lmeasure.rig import Drum, SensorTable
from lmeasure.text import Cause, Message, message

SLACK_S = 0.5  # a cable that lost the tool is taut again before
HOLE = 2.5  # median sample intervals: farther apart, a later pass is not interpolated
SMOOTH_MM = 0.2
"""Change of a later pass's curvature around an interval up to which it is smooth there: a step of a counter or a jerk of a cable must not
be spread over neighbouring samples."""

ARM_MM = 1000.0  # Of an angle, to hold it against a length


class Reason(NamedTuple):
    """Reason why samples of a channel are not used: mask (n,), their status, and the message."""

    mask: BoolArray
    status: int
    said: Cause


Reasons = tuple[Reason, ...]


def reasons_of(counter: Unwrapped, channel: str, drum: Drum | SensorTable, time_s: FloatArray) -> Reasons:
    """Return why samples of a channel, at times (n,), are not used."""
    what, every = counter.what, list[Reason]()

    def add(mask: BoolArray, status: int, code: str, **values: Any) -> None:
        if mask.any():  # messages of nothing would take longer than all the rest
            every.append(Reason(mask, status, message(code, channel=channel, **values)))

    if (what != FOLLOWED).any():
        foreign = {"bits": drum.counter_bits} if drum.codes is None else {"codes": drum.codes}
        add(what == JUMPED, Status.JUMP, "cause.jumped", **_speed(drum, drum.rate))
        add(what == WENT_ON, Status.ORIGIN_LOST, "cause.went_on")
        add(what == FOREIGN, Status.JUMP, "cause.foreign.bits" if drum.codes is None else "cause.foreign.codes", **foreign)
        add(what == UNSURE, Status.GAP, "cause.wrapped", **_speed(drum, counter.believed_rate or drum.rate))
        add(what == EMPTY, Status.GAP, "cause.no_count")
    if isinstance(drum, Drum) and drum.max_cable_acceleration_mm_s2 is not None:
        limit = drum.max_cable_acceleration_mm_s2
        values = np.where(counter.what == FOLLOWED, counter.counts, np.nan) / drum.scale
        slack = slack_samples(values, time_s, limit / drum.count_length_mm, 1.0 / drum.scale)
        add(slack, Status.SLACK, "cause.slack", limit=limit)
    return tuple(every)


def rate_notes(source: str, believed: Mapping[str, tuple[Drum | SensorTable, float]]) -> list[Message]:
    """Report that rates [1/s] of these channels' counters were taken from their motion: a note for each missing key."""
    found: dict[str, tuple[list[str], float]] = {}
    for channel, (drum, rate) in believed.items():
        key, limit = _speed(drum, rate).values()
        channels, most = found.get(key, ([], 0.0))
        found[key] = [*channels, channel], max(most, limit)
    return [message("counts.rate", source=source, channels=", ".join(c), key=key, limit=most) for key, (c, most) in found.items()]


def _speed(drum: Drum | SensorTable, rate: float) -> dict[str, Any]:
    """The key that bounds a counter's rate, and the value that it has for this one [1/s]."""
    return {"key": drum.rate_key, "limit": rate * drum.speed_per_count}


def slack_samples(counts: FloatArray, time_s: FloatArray, limit: float, quantum: float) -> BoolArray:
    """Return (n,) where a cable is slack, from its true counts (n,) at times (n,). Its speed changed faster than limit [1/s^2], beyond the
    rounding to a quantum, or it lies between two such changes less than SLACK_S apart. The change is taken over as many samples as make
    rounding smaller than the limit."""
    n = len(counts)
    out = np.zeros(n, np.bool_)
    if n < 3:
        return out
    w = max(1, int(np.ceil(2.0 * np.sqrt(quantum / limit) / np.median(np.diff(time_s)))))
    if n <= 2 * w:
        return out
    before, after = time_s[w:-w] - time_s[: -2 * w], time_s[2 * w :] - time_s[w:-w]
    with np.errstate(invalid="ignore"):
        change = (counts[2 * w :] - counts[w:-w]) / after - (counts[w:-w] - counts[: -2 * w]) / before
        allowed = limit * (before + after) / 2.0 + quantum * (1.0 / before + 1.0 / after)
        out[w:-w] = np.abs(change) > allowed
    broken = np.flatnonzero(out)
    for a, b in pairwise(broken.tolist()):
        if time_s[b] - time_s[a] < SLACK_S:
            out[a:b] = True
    return out


def other_times(time_s: FloatArray, base_s: FloatArray) -> OtherTimes | None:
    """Return the positions of pass 1's times among those of a later pass; None if they are the same."""
    same = len(time_s) == len(base_s) and np.allclose(time_s, base_s, rtol=0, atol=1e-9)
    return None if same else OtherTimes(time_s, base_s, HOLE)


def on_time_base(
    passage: int, times: OtherTimes, values: FloatArray, reasons: Reasons, *, drum: Drum | SensorTable
) -> tuple[FloatArray, FloatArray, Reasons]:
    """Return counts of a later pass at pass 1's times and their errors, in counts; times outside it, in a hole of it, or next to a bad
    sample, are flagged."""
    good = np.isfinite(values)
    for reason in reasons:
        good &= ~reason.mask
    mm = drum.per_count * (1.0 if drum.is_length else ARM_MM)
    out, missed = times.read(values, good, 1.0 / drum.scale, SMOOTH_MM / mm)
    moved = (
        *(Reason(times.either(mask), flag, said) for mask, flag, said in reasons),
        Reason(times.outside, Status.GAP, message("cause.pass.outside", passage=passage)),
        Reason(times.in_hole, Status.GAP, message("cause.pass.hole", passage=passage)),
    )
    return out, missed, moved
