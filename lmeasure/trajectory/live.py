"""The pose while the run is being recorded: one sample in, one pose out, in microseconds."""

import time
from dataclasses import dataclass

import numpy as np

from lmeasure.acquisition.samples import Samples
from lmeasure.arrays import FloatArray
from lmeasure.errors import TrajectoryError
from lmeasure.kernels import counter, live, screw
from lmeasure.rig import Rig
from lmeasure.status import WORDS
from lmeasure.trajectory.screw_method import Reconstruction


@dataclass(frozen=True)
class LiveSample:
    """A pose (7,) base_from_tool, NaN unless status is `ok`, with its worst pressure angle."""

    status: str
    pose: FloatArray
    worst_pressure_angle_deg: float


class LivePose:
    """A run of six cables in one pass that is followed sample by sample; the poses are those of `reconstruct`.

    Where a drum states no counter_bits its counter is taken as one that does not wrap. Raises what `Reconstruction` raises, and
    TrajectoryError when the rig has another scheme or more than one pass: then there is no pose yet. Everything is compiled before the
    constructor returns.
    """

    def __init__(self, rig: Rig, start: FloatArray) -> None:
        reconstruction = Reconstruction(rig, start)
        if reconstruction.correction is not None:
            raise TrajectoryError(f"rig {rig.name!r}: a live pose leaves out temperature, stretch and sag, which this rig states")
        if not reconstruction.scheme.six or rig.passes > 1:
            raise TrajectoryError(f"rig {rig.name!r}: a live pose needs six cables counted in one pass")
        self.channels = tuple(c.channel for c in rig.cable)
        self._rows, self._start = reconstruction.scheme.rows, reconstruction.start
        self._u = np.sqrt(reconstruction.budget.length_variance)
        drums = [rig.point(c.from_point).drum for c in rig.cable]
        self._channels = np.array(
            [(d.count_sign / d.scale, d.rate, 0.0 if d.counter_bits is None else 2.0**d.counter_bits, d.count_length_mm) for d in drums]
        )
        self._reset()
        self.update(0.0, np.zeros(len(drums)))
        self._reset()

    def _reset(self) -> None:
        self._state = screw.new_state(self._start)
        self._counters = np.zeros((len(self.channels), counter.STATE))

    def update(self, time_s: float, recorded: FloatArray) -> LiveSample:
        """The pose of the next sample: recorded counts (6,) in the order of `channels`, NaN where there is none."""
        pose = np.empty(7)
        status, angle = live.step(self._rows, self._start, self._state, self._counters, self._channels, time_s, recorded, self._u, pose)
        return LiveSample(WORDS[status], pose, float(np.degrees(angle)))


class PoseWatch:
    """Poses of a recording's samples as they come, and how long after its frames each was there.

    latest: the last sample's pose, or None; poses: how many were `ok`; longest_s: the longest that one took to work out.
    """

    def __init__(self, live: LivePose) -> None:
        self._live = live
        self.latest: LiveSample | None = None
        self.poses, self.longest_s = 0, 0.0
        self._time_s = self._finished = np.nan

    def __call__(self, samples: Samples) -> None:
        """Take samples whose columns are the live pose's channels, times from the first one."""
        for time_s, recorded in zip(samples.time_s.tolist(), samples.recorded, strict=True):
            begin = time.perf_counter()
            self.latest = self._live.update(time_s, recorded)
            self.longest_s = max(self.longest_s, time.perf_counter() - begin)
            self.poses += self.latest.status == "ok"
            self._time_s = time_s
        self._finished = time.time()

    def latency_s(self, origin_s: float | None) -> float | None:
        """From the last sample's own time to its pose, origin_s being when the first one was; None where no one clock tells both."""
        if origin_s is None or self.latest is None:
            return None
        latency = float(self._finished - origin_s - self._time_s)
        return latency if 0.0 <= latency < 60.0 else None
