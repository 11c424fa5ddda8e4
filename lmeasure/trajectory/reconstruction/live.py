"""The pose while the run is being recorded: one sample in, one pose out, in microseconds.

The run so far determines origins by redundant channels, and an unstated start by absolute ones. They are found again whenever the run has
become twice as long, by `reconstruct` of the present samples, and used from there on.
"""

import math
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Protocol

import numpy as np
import scipy

from lmeasure import kernels
from lmeasure.acquisition import Samples
from lmeasure.core import WORDS, FloatArray, LMeasureError, Status, TrajectoryError, angles_from_rotation, convention, se3
from lmeasure.recording import Counts, Run, StartErrors, known
from lmeasure.rig import CalibrationRecord, Rig, Unstated
from lmeasure.sensors import Lengths, counts_from_poses, recorded_from_counts, span_rows
from lmeasure.text import message
from lmeasure.trajectory.faults.consistency import SIGNIFICANCE
from lmeasure.trajectory.faults.continuity import EVERY, Doubts, shifted
from lmeasure.trajectory.faults.redundancy import Epochs
from lmeasure.trajectory.origin.start import enough_absolute
from lmeasure.trajectory.reconstruction.run_model import RunModel
from lmeasure.trajectory.reconstruction.runs import prepare
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction, new_run_state, reconstruction_of, zero_readings
from lmeasure.trajectory.time.passes import align
from lmeasure.trajectory.uncertainty.sources import Situation

if TYPE_CHECKING:
    from lmeasure.trajectory.curve.curve import Instants
    from lmeasure.trajectory.curve.stream import CurveStream

SAMPLES = 10**6  # Of a recording, for which a sound one gives an alarm of a contradiction once in `SIGNIFICANCE`


class Follower(Protocol):
    """Follows a run, by a reconstruction."""

    reconstruction: Reconstruction

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        """Status, pose (7,) and worst pressure angle [rad] of the next sample, recorded counts (m,)."""


def channel_rows(rig: Rig) -> FloatArray:
    """(m, `CHANNEL_COLUMNS`) of the channels of a rig of one pass, as `kernels.live` takes them; a counter whose bits are not stated is
    taken as one that does not wrap."""
    out = np.zeros((len(rig.observed), kernels.CHANNEL_COLUMNS))
    for row, o in zip(out, rig.observed, strict=True):
        c = rig.counter(o)
        values = float(c.codes or 0) if c.counter_bits is None else 2.0**c.counter_bits
        row[:] = c.count_sign / c.scale, c.rate, values, c.per_count, c.codes is not None, 0.0
    return out


class SixCables:
    """Six cables to a body, as many as there are unknowns."""

    def __init__(self, reconstruction: Reconstruction) -> None:
        self.reconstruction = reconstruction
        self._rows, self._start = reconstruction.model.scheme.rows, reconstruction.model.zero_pose
        self._u = np.sqrt(reconstruction.budget.length_variance)
        self._channels = channel_rows(reconstruction.model.rig)
        self._state, self._counters = kernels.new_state(self._start), np.zeros((len(self._rows), kernels.STATE))

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        pose = np.empty(7)
        status, angle = kernels.step(self._rows, self._start, self._state, self._counters, self._channels, time_s, recorded, self._u, pose)
        return status, pose, angle


class AnyChannels:
    """Channels of any kind and number, by a reconstruction used for nothing else from here on, without those in doubt at the end of the
    known run: its beginning, time_s (n,) and recorded counts (n, m)."""

    def __init__(self, reconstruction: Reconstruction, time_s: FloatArray | None = None, recorded: FloatArray | None = None) -> None:
        self.reconstruction, doubts = reconstruction, reconstruction.doubts
        rows = self._rows = reconstruction.model.scheme.rows
        m = len(rows)
        self._start = reconstruction.model.zero_pose
        self._zero = zero_readings(reconstruction.model, rows, self._start)
        self._u, self._free = np.sqrt(reconstruction.budget.length_variance), reconstruction.model.scheme.free_index
        self._channels, self._counters = channel_rows(reconstruction.model.rig), np.zeros((m, kernels.STATE))
        self._state = new_run_state(reconstruction.model)
        freedom = np.maximum(np.arange(m + 1) - len(self._free), 1)
        self._limit = scipy.stats.chi2.isf(SIGNIFICANCE / SAMPLES, freedom)
        self._limit[: len(self._free) + 1] = np.inf
        if reconstruction.redundancy is not None:
            # of all channels by the law of their rounding, of fewer by the normal one, which is never below it
            begun = self._state[kernels.CHANGES : kernels.CHANGES + m]
            chance = reconstruction.redundancy.chance(self._epochs(0.0, begun), self._start[None], np.ones(m, np.bool_))
            self._limit[m] = chance.limit(SIGNIFICANCE / SAMPLES)
        # how many channels were read is only counted where any number of them would be too much
        self._least = float(self._limit.min())
        now = 0.0 if time_s is None else float(time_s[-1])
        open_ = [d for d in doubts.every if np.isinf(d.until_s)]
        self._doubt = next((d.status for d in open_ if d.cable == EVERY), None)
        self._offsets = np.array(np.broadcast_to(reconstruction.budget.offsets(np.full(1, np.nextafter(now, np.inf)))[0], m))
        self._offsets[[d.cable for d in open_ if d.cable != EVERY]] = np.nan
        self.last = int(Status.GAP), np.full(7, np.nan), np.nan  # Status, pose and angle of the last sample that is known
        if time_s is not None and recorded is not None:
            self._beginning(doubts, time_s, recorded)

    def _beginning(self, doubts: Doubts, time_s: FloatArray, recorded: FloatArray) -> None:
        """Follow the known run."""
        changes, flags = kernels.changes_of(self._rows, self._channels, self._counters, time_s, np.ascontiguousarray(recorded))
        counts = shifted(doubts.shifts, time_s, kernels.counts_from_changes(self._rows, changes))
        for s in doubts.shifts:
            self._channels[s.cable, kernels.CHANNEL_SHIFT] += s.counts if np.isinf(s.until_s) else 0.0
        changes = kernels.changes_from_counts(self._rows, counts) - self.reconstruction.budget.offsets(time_s)
        for d in doubts.every:
            mask = d.mask(time_s)
            changes[mask] = np.where((np.arange(len(self._rows)) == d.cable) | (d.cable == EVERY), np.nan, changes[mask])
            flags[mask] = d.status
        flags[flags == Status.OK] = Status.GAP
        run = self._rows, self._start, self._zero, self._state
        poses, _, _, status, angle, _ = kernels.follow_least_squares(*run, changes, flags, self._u, self._free)
        self.last = int(status[-1]), poses[-1], float(angle[-1])

    def step(self, time_s: float, recorded: FloatArray) -> tuple[int, FloatArray, float]:
        """Follow a sample; one with contradicting channels is `INCONSISTENT`."""
        pose, change = np.empty(7), np.empty(len(self._rows))
        run = self._rows, self._start, self._zero, self._state, self._counters, self._channels, self._offsets
        status, angle, chi = kernels.step_of(*run, time_s, recorded, self._u, self._free, pose, change)
        if status == Status.OK and self._doubt is not None:
            status = int(self._doubt)
        # chi-squared from the counts alone is an upper bound of their contradiction
        elif status == Status.OK and chi > self._least and self._contradicts(time_s, pose, change, chi):
            status = int(Status.INCONSISTENT)
        if status != Status.OK:
            pose[:] = angle = np.nan
        return status, pose, angle

    def _contradicts(self, time_s: float, pose: FloatArray, change: FloatArray, chi: float) -> bool:
        """Return whether a sample does so with common errors of its readings in their covariance; chi: by the counts alone."""
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
        rig, nothing = self.reconstruction.model.rig, np.full(1, "", dtype=np.object_)
        counts = np.asarray(kernels.counts_from_changes(self._rows, np.where(np.isfinite(change), change, 0.0)[None]))
        names, changes = tuple(o.name for o in rig.observed), change[None]
        lengths = Lengths(np.full(1, time_s), names, changes, counts, np.zeros(1, np.int64), nothing, nothing, gone_on=counts)
        return redundancy.epochs(lengths, None)


START_UNKNOWN = "start_unknown"  # Status of a sample while nothing has determined yet where the run began
FIRST = 50  # Samples for the first estimate of a run; then twice as many each time, and once more after a contradiction
COVARIANCE_EVERY_S = 0.2
MOST = 2**17  # Samples of a run that are kept to learn from


@dataclass(frozen=True)
class LiveSample:
    """A pose (7,) base_from_tool, NaN unless status is `ok`, with its worst pressure angle."""

    status: str
    pose: FloatArray
    worst_pressure_angle_deg: float


class LivePose:
    """A run in one pass that is followed sample by sample. Of six cables, or of six channels with a start, the poses are those of
    `reconstruct`. With more, or without a start (7,), at a sample of learning they are those of `reconstruct` for the run up to it; later
    ones use its results. aside: learn in a thread, and meanwhile follow with the known ones. unstated: as in `Run`, for start and
    temperature. A drum without counter_bits is taken not to wrap. Raises the errors of `Reconstruction`, and TrajectoryError if the rig has
    more than one pass, effects that are unavailable here, or no start and too few absolute channels. Everything is compiled before the
    constructor returns.

    why: the reason for an unknown start. learns: whether it continues to learn.
    """

    def __init__(
        self,
        rig: Rig,
        start: FloatArray | None,
        calibration: CalibrationRecord | None = None,
        *,
        aside: bool = False,
        unstated: Unstated = "typical",
    ) -> None:
        if rig.passes > 1:
            raise TrajectoryError(message("error.rig_a_live_pose", name=rig.name))
        if any(getattr(e, "backlash_deg", None) for e in rig.sensors):
            raise TrajectoryError(message("error.rig_a_live_pose_leaves", name=rig.name))
        if start is None and not enough_absolute(rig):
            known(None, f"rig {rig.name!r}", rig)
        self.channels, self.angles = tuple(o.channel for o in rig.observed), rig.angles
        self.why = "" if start is not None else "no attempt to find the start yet"
        self._rig = rig if start is None else rig.zeroed_at(start)
        self._start, self._calibration, self._aside, self._unstated = start, calibration, aside, unstated
        self.learns = True
        self._way = self._first_follower()
        if start is not None and self._way is not None:
            self._way.step(0.0, np.full(len(self.channels), np.nan))
            self._way = self._first_follower()
        m = len(self.channels)
        self._time_s, self._recorded, self._n, self._next, self._learned = np.empty(FIRST), np.empty((FIRST, m)), 0, FIRST, 0
        self._found: tuple[AnyChannels | None, str, int] | None = None
        self._thread: threading.Thread | None = None
        if self.learns:
            self._rehearse()
        if start is not None:
            self.covariance(start)

    def _rehearse(self) -> None:
        """Learn from a run that is made up, so that everything is compiled; one that cannot be made up leaves that for later."""
        middle = np.mean([p.position_mm for p in self._rig.observation_point], axis=0)
        home = np.array([*middle, 0.0, 0.0, 0.0, 1.0]) if self._start is None else self._start
        time_s: FloatArray = 0.01 * np.arange(FIRST, dtype=np.float64)
        path = se3.displaced(home, np.sin(np.pi * time_s)[:, None] * [0.02, -0.01, 0.03, 10.0, 8.0, -6.0])
        try:
            counts = counts_from_poses(self._rig, path, path[0], self._rig.observed)
        except LMeasureError:
            return
        way = self._channels_of(time_s, recorded_from_counts(self._rig, counts, self._rig.observed))[0]
        if way is not None:
            way.step(1.0, np.full(len(self.channels), np.nan))

    def _first_follower(self) -> Follower | None:
        """Return the way from the stated start."""
        if self._start is None:
            return None
        errors, exact = StartErrors.of((None, None), self._unstated), self._unstated == "exact"
        model = RunModel(self._rig, self._start, self._calibration, u_start=errors.u, assumed_start=errors.assumed, exact=exact)
        reconstruction = reconstruction_of(model)
        if reconstruction.model.correction is not None or any(p.drum.backlash_counts for p in self._rig.observation_point):
            what = "temperature, stretch, sag and parts that are not as drawn"
            raise TrajectoryError(message("error.rig_a_live_pose_leaves_out", name=self._rig.name, what=what))
        if reconstruction.model.scheme.point is not None:
            raise TrajectoryError(message("error.rig_a_live_pose_needs", name=self._rig.name))
        self.learns = reconstruction.redundancy is not None
        return SixCables(reconstruction) if reconstruction.model.scheme.six else AnyChannels(reconstruction)

    def update(self, time_s: float, recorded: FloatArray) -> LiveSample:
        """The pose of the next sample: recorded counts (m,) in the order of `channels`, NaN where there is none."""
        if self.learns:
            self._keep(time_s, recorded)
            if self._found is not None:
                self._adopt(*self._found, upto=self._n - 1)
            if self._n >= self._next and self._thread is None:
                self._learn()
                if self._found is not None and self._found[2] == self._n:
                    way = self._found[0]
                    self._adopt(*self._found, upto=self._n)
                    if way is not None:
                        return self._sample(*way.last)
        if self._way is None:
            return LiveSample(START_UNKNOWN, np.full(7, np.nan), np.nan)
        found = self._way.step(time_s, recorded)
        if found[0] == Status.INCONSISTENT and self.learns:
            self._next = min(self._next, max(self._learned * 5 // 4, self._n + FIRST))
        return self._sample(*found)

    def covariance(self, pose: FloatArray) -> FloatArray | None:
        """Return the (6, 6) covariance (rotation [rad]; tool origin [mm], base axes) of a pose (7,) of the run, slowly: that of
        `reconstruct` without the parts that depend on the run's course (its speed, play of drums, temperature). None while no pose is
        known."""
        if self._way is None:
            return None
        of = self._way.reconstruction
        model, rows, budget = of.model, of.model.scheme.rows, of.budget
        counts = np.asarray(kernels.counts_from_changes(rows, span_rows(rows, pose[None])[0] - zero_readings(model, rows, model.zero_pose)))
        nothing = np.zeros_like(counts)
        found = budget.of(Situation(np.zeros(1), pose[None], counts, nothing, travel=nothing), compiled=False)
        return np.asarray(found.random[0] + found.systematic[0])

    def _sample(self, status: int, pose: FloatArray, angle: float) -> LiveSample:
        return LiveSample(WORDS[status], pose, math.degrees(angle))

    def _keep(self, time_s: float, recorded: FloatArray) -> None:
        if self._n == MOST:
            self._next = MOST + 1
            return
        if self._n == len(self._time_s):
            self._time_s = np.concatenate([self._time_s, np.empty(self._n)])
            self._recorded = np.concatenate([self._recorded, np.empty_like(self._recorded)])
        self._time_s[self._n], self._recorded[self._n] = time_s, recorded
        self._n += 1

    def _learn(self) -> None:
        """Learn from the run so far, here or in a thread."""
        self._next = 2 * self._n
        time_s, recorded = self._time_s[: self._n].copy(), self._recorded[: self._n].copy()
        if self._aside:
            self._thread = threading.Thread(target=self._learn_from, args=(time_s, recorded), daemon=True)
            self._thread.start()
        else:
            self._learn_from(time_s, recorded)

    def _learn_from(self, time_s: FloatArray, recorded: FloatArray) -> None:
        self._found = *self._channels_of(time_s, recorded), len(time_s)

    def _channels_of(self, time_s: FloatArray, recorded: FloatArray) -> tuple[AnyChannels | None, str]:
        """Return the way behind a beginning of the run that it determines, or the reason for none."""
        counts = Counts(time_s, self.channels, recorded, source="the run so far")
        try:
            reconstruction = prepare(align(Run(self._rig, self._start, (counts,), self._calibration, unstated=self._unstated)))
        except LMeasureError as error:
            return None, str(error)
        return AnyChannels(reconstruction, time_s, recorded), ""

    def _adopt(self, way: AnyChannels | None, why: str, learned: int, *, upto: int) -> None:
        """Use the learned way, and the samples that came meanwhile, so many in all."""
        self._found, self._thread, self._learned = None, None, learned
        if way is None:
            self.why = why if self._way is None else ""
            return
        self._way, self.why = way, ""
        for i in range(learned, upto):
            way.last = way.step(self._time_s[i], self._recorded[i])

    def caught_up(self) -> LiveSample | None:
        """The last sample's pose anew, where something was learned since it came; else None."""
        if self._found is None:
            return None
        self._adopt(*self._found, upto=self._n)
        return self._sample(*self._way.last) if isinstance(self._way, AnyChannels) else None


class PoseWatch:
    """Poses of a recording's samples as they come, and how long after its frames each was there.

    latest: the last sample's pose, or None; poses: how many were `ok`; longest_s: the longest that one took to work out. smooth: the last
    poses of the curve, or the reason why there are none; None without a curve.
    """

    def __init__(self, live: LivePose, curve: "CurveStream | None" = None) -> None:
        self._live, self._curve = live, curve
        self.smooth: Instants | str | None = None
        self._covariance: FloatArray | None = None
        self._looked = -np.inf
        self.latest: LiveSample | None = None
        self.poses, self.longest_s = 0, 0.0
        self._time_s = self._finished = np.nan

    @property
    def why(self) -> str:
        """Return the reason for an unknown start."""
        return self._live.why

    def refresh(self) -> None:
        """Compute the latest pose again with later results."""
        self.latest = self._live.caught_up() or self.latest

    def __call__(self, samples: Samples) -> None:
        """Take samples whose columns are the live pose's channels, times from the first one."""
        for time_s, recorded in zip(samples.time_s.tolist(), samples.recorded, strict=True):
            begin = time.perf_counter()
            self.latest = self._live.update(time_s, recorded)
            self.longest_s = max(self.longest_s, time.perf_counter() - begin)
            self.poses += self.latest.status == "ok"
            self._time_s = time_s
            if self._curve is not None:
                self._smooth(self._curve, time_s, recorded)
        self._finished = time.time()

    def _smooth(self, curve: "CurveStream", time_s: float, recorded: FloatArray) -> None:
        try:
            found = curve.push(time_s, recorded)
        except LMeasureError as error:
            self._curve, self.smooth = None, str(error)
            return
        if found is not None and len(found.time_s):
            self.smooth = curve.why or found

    @property
    def time_s(self) -> float:
        """Return the time of the last sample [s]."""
        return self._time_s

    def angles(self) -> list[tuple[str, float]]:
        """Angles of the latest pose in the rig's convention: name and value [deg]."""
        if self.latest is None:
            return []
        known = convention(self._live.angles)
        values = angles_from_rotation(self._live.angles, se3.rotation(self.latest.pose[None]))[0]
        degrees = np.degrees(values) if known.columns[0].endswith("_rad") else values
        return [(c.rsplit("_", 1)[0], float(v)) for c, v in zip(known.columns, degrees, strict=True)]

    def covariance(self) -> FloatArray | None:
        """(6, 6) covariance of the latest pose, of one `COVARIANCE_EVERY_S` ago at most; None where there is no pose."""
        if self.latest is None or self.latest.status != "ok":
            return None
        now = time.monotonic()
        if self._covariance is None or now - self._looked >= COVARIANCE_EVERY_S:
            self._covariance, self._looked = self._live.covariance(self.latest.pose), now
        return self._covariance

    def latency_s(self, origin_s: float | None) -> float | None:
        """Return the time from the last sample's own time to its pose, origin_s being that of the first one; None if no one clock measures
        both."""
        if origin_s is None or self.latest is None:
            return None
        latency = float(self._finished - origin_s - self._time_s)
        return latency if 0.0 <= latency < 60.0 else None
