"""Judge whether a counter may have wrapped unseen between two of its readings.

A step s of a counter with M values may also be s - M or s + M. This is ruled out if

- the largest speed does not allow M - |s| in the time between the readings, which late stamps do not lengthen;
- the other channels were read throughout and moved by less than QUARTER of M - |s|: all cables hold one body;
- no channel changed its count by more than REST_MM: the body is at rest.
"""

from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from lmeasure.acquisition.counters.decoders import NO_RANGE, CounterField
from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.rig import Rig
from lmeasure.text import message


def moduli(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) how many codes absolute encoders have before they begin anew, 0 of channels that count on."""
    return np.array([float(rig.counters_of(passage)[c].codes or 0) for c in channels])


def folded(difference: FloatArray, modulus: FloatArray) -> FloatArray:
    """Differences (..., m) of counts, of absolute encoders the shorter way round."""
    turn = np.where(modulus > 0.0, modulus, 1.0)
    return np.where(modulus > 0.0, (difference + turn / 2.0) % turn - turn / 2.0, difference)


class GoneOn:
    """Counts of m channels, given one piece after the other, without the turns after which absolute encoders, modulus (m,), begin anew:
    they go on from the first that was seen."""

    def __init__(self, modulus: FloatArray) -> None:
        self._modulus, self._latest = modulus, np.full(len(modulus), np.nan)

    def of(self, recorded: FloatArray) -> FloatArray:
        """(n, m) of the next counts (n, m), NaN where there is none."""
        out = recorded.copy()
        for j in np.flatnonzero(self._modulus):
            there = np.flatnonzero(np.isfinite(recorded[:, j]))
            if len(there):
                first = recorded[there[0], j] if np.isnan(self._latest[j]) else self._latest[j]
                steps = folded(np.diff(recorded[there, j], prepend=first)[:, None], self._modulus[j : j + 1])[:, 0]
                out[there, j] = first + np.cumsum(steps)
                self._latest[j] = out[there[-1], j]
        return out


ASSUMED_S = 0.02
"""SYNC period for the warning, before the period is known."""
NARROW_S = 10.0
"""A counter that needs longer for half its range at the largest speed is not judged."""
QUARTER = 0.25
REST_MM = 5.0
WATCHED = 0.7
"""Smallest part of its SYNCs that a channel answers if it was read throughout."""
UNSEEN = 1e9
"""A pause counts as so many SYNCs."""
OTHERS = 2
"""Smallest number of other channels for a decision."""


class Counter(Protocol):
    """State a counter's number of values, largest rate [1/s], and millimetres per unit (None: it is no length)."""

    max_rate: float

    @property
    def unit_mm(self) -> float | None:
        """Return the millimetres per unit, None if it is no length."""

    @property
    def values(self) -> int:
        """Return the number of its values, 0 if it never wraps unseen."""


def range_notes(rig: Rig, fields: Sequence[CounterField], passage: int = 1, period_s: float | None = None) -> list[str]:
    """Return a line for counters that can pass half their range within two periods of the SYNC, or within ASSUMED_S where none is known."""
    known = rig.counters_of(passage)
    alike: dict[tuple[int, str, float, str, float], list[str]] = {}
    for f in fields:
        counter = known[f.channel]
        half_s = 0.5 * f.modulus * f.scale / counter.rate
        if counter.codes is None and f.modulus < NO_RANGE and half_s < 2.0 * (period_s or ASSUMED_S):
            key, unit = counter.rate_key, "mm/s" if counter.is_length else "deg/s"
            limit = counter.rate * counter.speed_per_count
            alike.setdefault((f.modulus, key, limit, unit, half_s), []).append(f.channel)
    return [
        message(
            "acquisition.counts_pass_half_their",
            channels=tuple(channels),
            counts=modulus,
            time=1000.0 * half_s,
            limit=limit,
            unit=unit,
            key=key,
            period=1000.0 * 0.46 * half_s,
        )
        for (modulus, key, limit, unit, half_s), channels in alike.items()
    ]


def may_wrap(steps: IntArray, passed_s: FloatArray, values: int, max_rate: float) -> BoolArray:
    """Return (n,) whether the speed allows another way round for steps (n,) between readings that are passed_s (n,) apart."""
    return np.asarray(values - np.abs(steps) <= max_rate * passed_s + 1.0)


class Evidence:
    """Collect what the other channels show about a channel's gap."""

    def __init__(self, counters: Sequence[Counter]) -> None:
        self._values = np.array([c.values for c in counters], np.float64)
        self._unit = np.array([np.nan if c.unit_mm is None else c.unit_mm for c in counters])
        rates = np.array([c.max_rate for c in counters])
        self.narrow = bool(((self._values > 0) & (self._values < 2.0 * NARROW_S * rates)).any())
        m = len(counters)
        self._before = np.zeros(m)
        self._any = np.zeros(m, np.bool_)
        self._since = np.zeros((m, m)), np.zeros((m, m)), np.zeros(m)
        """Since the last reading of each channel: how far each other one moved, how often it was read, and the SYNCs."""

    def of(self, value: IntArray, there: BoolArray, paused: BoolArray) -> Callable[[int], BoolArray] | None:
        """Take the readings of the next SYNCs (m, n); paused (n,): whether a long silence precedes each of them.

        Return a function of the channel: it returns for each of its readings (k,) whether the other channels rule out a wrap.
        """
        if not self.narrow:
            return None
        m, n = value.shape
        travel = np.zeros((m, n + 1))
        for c in range(m):
            rows = np.flatnonzero(there[c])
            if len(rows):
                first = self._before[c] if self._any[c] else float(value[c, rows[0]])
                steps = np.diff(value[c, rows].astype(np.float64), prepend=first)
                if full := self._values[c]:
                    steps = (steps + full / 2) % full - full / 2
                travel[c, rows + 1] = np.abs(steps)
                self._before[c], self._any[c] = float(value[c, rows[-1]]), True
        own = travel[:, 1:].copy()
        np.cumsum(travel, axis=1, out=travel)
        read = np.concatenate([np.zeros((m, 1)), np.cumsum(there, axis=1)], axis=1)
        syncs = np.concatenate([[0.0], np.cumsum(np.where(paused, UNSEEN, 1.0))])
        since = tuple(one.copy() for one in self._since)
        for c in range(m):
            rows = np.flatnonzero(there[c])
            ends = rows[-1] + 1 if len(rows) else 0
            for kept, table in zip(self._since[:2], (travel, read), strict=True):
                kept[c] = table[:, -1] - table[:, ends] + (0.0 if len(rows) else kept[c])
            self._since[2][c] = syncs[-1] - syncs[ends] + (0.0 if len(rows) else self._since[2][c])

        def calm(c: int) -> BoolArray:
            rows = np.flatnonzero(there[c])
            begin = np.concatenate([[0], rows[:-1] + 1])
            moved, seen = (table[:, rows + 1] - table[:, begin] for table in (travel, read))
            gone = syncs[rows + 1] - syncs[begin]
            moved[:, 0] += since[0][c]
            seen[:, 0] += since[1][c]
            gone[0] += since[2][c]
            others = np.isfinite(self._unit) & (np.arange(m) != c)
            mm = moved * self._unit[:, None]
            other_way = (self._values[c] - own[c, rows]) * self._unit[c]
            watched = others[:, None] & (seen >= WATCHED * gone)
            slow = np.where(watched, mm, 0.0).max(axis=0) <= QUARTER * other_way
            held = (watched.sum(axis=0) >= OTHERS) & (2 * watched.sum(axis=0) >= others.sum()) & slow
            rest = (own[c, rows] * self._unit[c] <= REST_MM) & (np.where(others[:, None], mm, 0.0).max(axis=0) <= REST_MM)
            return np.asarray(held | (rest & (others.sum() >= OTHERS)))

        return calm
