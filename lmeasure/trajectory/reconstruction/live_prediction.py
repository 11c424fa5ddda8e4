"""From a sample's counts to its pose, sample by sample, by what is known of a run: the ways that `live` follows."""

from typing import Protocol

import numpy as np
import scipy

from lmeasure.core import FloatArray, Status
from lmeasure.kernels import (
    CHANGES,
    CHANNEL_COLUMNS,
    CHANNEL_SHIFT,
    STATE,
    changes_from_counts,
    changes_of,
    counts_from_changes,
    follow_least_squares,
    new_state,
    step as live_step,
    step_of,
)
from lmeasure.rig import Rig
from lmeasure.sensors import Lengths
from lmeasure.trajectory.faults.consistency import SIGNIFICANCE
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.faults.suspicion import EVERY, Doubts, shifted
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction

SAMPLES = 10**6
"""Of a recording, for which a sound one gives an alarm of a contradiction once in `SIGNIFICANCE`."""


class Way(Protocol):
    """Follows a run, by a reconstruction."""

    reconstruction: Reconstruction

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        """Status, pose (7,) and worst pressure angle [rad] of the next sample, recorded counts (m,)."""


def channel_rows(rig: Rig) -> FloatArray:
    """(m, `CHANNEL_COLUMNS`) of the channels of a rig of one pass, as `kernels.live` takes them; a counter whose bits are not stated is
    taken as one that does not wrap."""
    out = np.zeros((len(rig.observed), CHANNEL_COLUMNS))
    for row, o in zip(out, rig.observed, strict=True):
        c = rig.counter(o)
        values = float(c.codes or 0) if c.counter_bits is None else 2.0**c.counter_bits
        row[:] = c.count_sign / c.scale, c.rate, values, c.per_count, c.codes is not None, 0.0
    return out


class SixCables:
    """Six cables to a body, as many as there are unknowns."""

    def __init__(self, reconstruction: Reconstruction) -> None:
        self.reconstruction = reconstruction
        self._rows, self._start = reconstruction.scheme.rows, reconstruction.start
        self._u = np.sqrt(reconstruction.budget.length_variance)
        self._channels = channel_rows(reconstruction.rig)
        self._state, self._counters = new_state(self._start), np.zeros((len(self._rows), STATE))

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        """As `Way` has it."""
        pose = np.empty(7)
        status, angle = live_step(self._rows, self._start, self._state, self._counters, self._channels, time_s, recorded, self._u, pose)
        return status, pose, angle


class AnyChannels:
    """Channels of any kind and number, by a reconstruction that is not used for anything else from here on, less what is in doubt at the
    end of what is known of the run: its beginning, time_s (n,) and recorded counts (n, m)."""

    def __init__(
        self, reconstruction: Reconstruction, doubts: Doubts, time_s: FloatArray | None = None, recorded: FloatArray | None = None
    ) -> None:
        self.reconstruction = reconstruction
        rows = self._rows = reconstruction.scheme.rows
        m = len(rows)
        self._zero, self._start = reconstruction.zero, reconstruction.start
        self._u, self._free = np.sqrt(reconstruction.budget.length_variance), reconstruction.scheme.free_index
        self._channels, self._counters = channel_rows(reconstruction.rig), np.zeros((m, STATE))
        self._state = reconstruction.begun_state()
        freedom = np.maximum(np.arange(m + 1) - len(self._free), 1)
        self._limit = scipy.stats.chi2.isf(SIGNIFICANCE / SAMPLES, freedom)
        self._limit[: len(self._free) + 1] = np.inf
        if reconstruction.redundancy is not None:
            # of all channels by the law of their rounding, of fewer by the normal one, which is never below it
            begun = self._state[CHANGES : CHANGES + m]
            chance = reconstruction.redundancy.chance(self._epochs(0.0, begun), self._start[None], np.ones(m, np.bool_))
            self._limit[m] = chance.limit(SIGNIFICANCE / SAMPLES)
        # how many channels were read is only counted where any number of them would be too much
        self._least = float(self._limit.min())
        now = 0.0 if time_s is None else float(time_s[-1])
        open_ = [d for d in doubts.every if np.isinf(d.until_s)]
        self._doubt = next((d.status for d in open_ if d.cable == EVERY), None)
        self._offsets = np.array(np.broadcast_to(reconstruction.budget.offsets(np.full(1, np.nextafter(now, np.inf)))[0], m))
        self._offsets[[d.cable for d in open_ if d.cable != EVERY]] = np.nan
        self.last = int(Status.GAP), np.full(7, np.nan), np.nan
        """Status, pose and angle of the last sample that is known."""
        if time_s is not None and recorded is not None:
            self._beginning(doubts, time_s, recorded)

    def _beginning(self, doubts: Doubts, time_s: FloatArray, recorded: FloatArray) -> None:
        """Go through what is known of the run."""
        changes, flags = changes_of(self._rows, self._channels, self._counters, time_s, np.ascontiguousarray(recorded))
        counts = shifted(doubts.shifts, time_s, counts_from_changes(self._rows, changes))
        for s in doubts.shifts:
            self._channels[s.cable, CHANNEL_SHIFT] += s.counts if np.isinf(s.until_s) else 0.0
        changes = changes_from_counts(self._rows, counts) - self.reconstruction.budget.offsets(time_s)
        for d in doubts.every:
            mask = d.mask(time_s)
            changes[mask] = np.where((np.arange(len(self._rows)) == d.cable) | (d.cable == EVERY), np.nan, changes[mask])
            flags[mask] = d.status
        flags[flags == Status.OK] = Status.GAP
        poses, _, _, status, angle, _ = follow_least_squares(
            self._rows, self._start, self._zero, self._state, changes, flags, self._u, self._free
        )
        self.last = int(status[-1]), poses[-1], float(angle[-1])

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        """As `Way` has it; a sample whose channels contradict each other is `INCONSISTENT`."""
        pose, change = np.empty(7), np.empty(len(self._rows))
        status, angle, chi = step_of(
            self._rows,
            self._start,
            self._zero,
            self._state,
            self._counters,
            self._channels,
            self._offsets,
            time_s,
            recorded,
            self._u,
            self._free,
            pose,
            change,
        )
        if status == Status.OK and self._doubt is not None:
            status = int(self._doubt)
        # by the counts alone is an upper bound of what they contradict each other by
        elif status == Status.OK and chi > self._least and self._contradicts(time_s, pose, change, chi):
            status = int(Status.INCONSISTENT)
        if status != Status.OK:
            pose[:] = angle = np.nan
        return status, pose, angle

    def _contradicts(self, time_s: float, pose: FloatArray, change: FloatArray, chi: float) -> bool:
        """Whether a sample does so with everything that its readings share in their covariance; chi: by the counts alone."""
        redundancy, limit = self.reconstruction.redundancy, self._limit[int(np.isfinite(change).sum())]
        if not chi > limit:
            return False
        assert redundancy is not None
        parities = redundancy.parities(self._epochs(time_s, change), pose[None])
        return bool(parities.chi_squared[0] > limit)

    def _epochs(self, time_s: float, change: FloatArray) -> Epochs:
        """A sample, its changes (m,), as the reconstruction's redundancy takes it."""
        redundancy = self.reconstruction.redundancy
        assert redundancy is not None
        rig, nothing = self.reconstruction.rig, np.full(1, "", dtype=np.object_)
        counts = np.asarray(counts_from_changes(self._rows, np.where(np.isfinite(change), change, 0.0)[None]))
        names, changes = tuple(o.name for o in rig.observed), change[None]
        lengths = Lengths(np.full(1, time_s), names, changes, counts, np.zeros(1, np.int64), nothing, nothing, gone_on=counts)
        return redundancy.epochs(lengths, None)
