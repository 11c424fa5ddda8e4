"""Counters: wraps undone, start offsets taken off, and what no drum can do found. One state per channel, fed piece by piece."""

from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.decoders import NO_RANGE, CounterField
from lmeasure.acquisition.events import Event, EventLog
from lmeasure.acquisition.wraps import may_wrap
from lmeasure.arrays import BoolArray, FloatArray, IntArray
from lmeasure.kernels.counter import runs_on

RESET_WITHIN = 2
"""Units from zero within which a device that starts again is found."""
RESET_FACTOR = 20
"""A step to zero this many times longer than its neighbours is a reset even where the speed limit would allow it."""
RESET_LEAST = 200
"""Units: a shorter step to zero is not looked at."""


@dataclass
class CounterState:
    """One channel: its field, the largest rate [device units/s], whether later stages unwrap it themselves, and where it stands."""

    field: CounterField
    max_rate: float
    wraps_later: bool = False
    codes: bool = False
    """Whether it shows its angle within a revolution, from 0 on."""
    unit_mm: float | None = None
    """Millimetres of a device unit, None where it is no length."""
    value: int = 0
    total: int = 0
    time_s: float = float("nan")
    step: int = 0
    seen: bool = False
    lost: bool = False

    @property
    def values(self) -> int:
        """Number of its values, 0 where it never wraps unseen."""
        return self.field.modulus if self.field.modulus < NO_RANGE and not self.wraps_later else 0

    def advance(
        self,
        values: IntArray,
        times: FloatArray,
        samples: IntArray,
        events: EventLog,
        *,
        least_s: float = 0.0,
        passed_s: FloatArray | None = None,
        calm: BoolArray | None = None,
    ) -> FloatArray:
        """(n,) recorded counts, unwrapped, of the (n,) values read at the times [s], for the rows `samples`; NaN once the origin is
        lost. least_s: taken for the time between readings whose stamps are closer, as `kernels.counter.resume` takes it; passed_s (n,):
        the time since the reading before, where that is better known than by the stamps; calm (n,): where other channels rule out that
        it wrapped unseen."""
        if len(values) == 0:
            return np.empty(0)
        modulus, half = self.field.modulus, self.field.modulus // 2
        wraps = modulus < NO_RANGE
        if not self.seen:
            first = int(values[0]) - self.field.start
            self.total = (first + half) % modulus - half if wraps else first
            self.value, self.time_s, self.seen = int(values[0]), float(times[0]), True
        full = modulus if wraps else 0
        most = modulus / 2 if wraps and not self.wraps_later else np.inf
        if not self.lost and runs_on(values, times, self.value, self.time_s, full, self.max_rate, most, RESET_WITHIN, RESET_LEAST):
            totals = self.total + (values - self.value)
            self.step = int(values[-1]) - int(values[-2] if len(values) > 1 else self.value)
            self.value, self.total, self.time_s = int(values[-1]), int(totals[-1]), float(times[-1])
            return np.asarray(self.field.scale * totals, np.float64)
        before = np.concatenate([[self.value], values[:-1]])
        pause = np.maximum(np.diff(times, prepend=self.time_s) if passed_s is None else passed_s, least_s)
        with np.errstate(over="ignore"):
            plain = values - before
        steps = (plain + half) % modulus - half if wraps else plain
        totals = self.total + np.cumsum(steps)
        limit = self.max_rate * pause + 1.0
        self._find(values, plain, steps, limit, times, samples, events)
        out = np.asarray(self.field.scale * totals, np.float64)
        if self.lost:
            out[:] = np.nan
        elif (ends := self._origin_lost(values, steps, pause, times, samples, events, calm)) is not None:
            out[ends:] = np.nan
            self.lost = True
        self.value, self.total, self.time_s, self.step = int(values[-1]), int(totals[-1]), float(times[-1]), int(steps[-1])
        return out

    def shown(self, counts: FloatArray) -> FloatArray:
        """(n,) counts as the counts file holds them: wrapped like the encoder's where the rig says so and later stages unwrap."""
        if not self.wraps_later:
            return counts
        full = self.field.scale * self.field.modulus
        if self.codes:
            turned = counts % full
            # what is a rounding below a whole turn would be a code that there is not
            return np.asarray(np.where(turned < full, turned, 0.0))
        raised = counts + full / 2
        return (raised if ((raised >= 0) & (raised < full)).all() else raised % full) - full / 2

    def _find(
        self, values: IntArray, plain: IntArray, steps: IntArray, limit: FloatArray, times: FloatArray, samples: IntArray, events: EventLog
    ) -> None:
        for i in np.flatnonzero(plain != steps):
            events.add(Event(int(samples[i]), float(times[i]), self.field.channel, "wrap", f"from {values[i] - plain[i]} to {values[i]}"))
        for i in np.flatnonzero(np.abs(steps) > limit):
            text = f"{steps[i]} units where {limit[i]:.0f} are possible"
            events.add(Event(int(samples[i]), float(times[i]), self.field.channel, "jump", text))

    def _origin_lost(
        self,
        values: IntArray,
        steps: IntArray,
        pause: FloatArray,
        times: FloatArray,
        samples: IntArray,
        events: EventLog,
        calm: BoolArray | None,
    ) -> int | None:
        """Row from which the origin is lost: after a pause in which the counter could have wrapped unseen, or a start again at zero; never
        that of absolute codes."""
        if self.codes:
            return None
        found: list[tuple[int, str, str]] = []
        limit = self.max_rate * pause + 1.0
        if self.values:
            unsure = may_wrap(steps, pause, self.values, self.max_rate)
            unsure &= True if calm is None else ~calm
            if unsure.any():
                i = int(np.argmax(unsure))
                text = f"{pause[i]:.3g} s without a count, in which {limit[i]:.0f} units are possible: its range is {self.values}"
                found.append((i, "lost_wrap", text))
        length = np.abs(steps)
        previous = np.concatenate([[abs(self.step)], length[:-1]])
        following = np.concatenate([length[1:], [0]])
        usual = np.maximum(previous, following)
        zero = (np.abs(values) <= RESET_WITHIN) & (length > RESET_LEAST) & ((length > RESET_FACTOR * usual) | (length > limit))
        if zero.any():
            i = int(np.argmax(zero))
            found.append((i, "reset", f"from {int(values[i] - steps[i])} to {values[i]}"))
        if not found:
            return None
        row, kind, text = min(found)
        events.add(Event(int(samples[row]), float(times[row]), self.field.channel, kind, text))
        return row
