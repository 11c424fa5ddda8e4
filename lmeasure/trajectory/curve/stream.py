"""The curve of a run that is still going on: poses with a fixed lag, at a constant cost per sample.

Each quarter of the lag, the readings of the last two lags are fitted (`fit.Fit`). The curve is evaluated where three quarters of a lag
of readings follow. A curve depends on readings some knots away at most, so with a longer lag the poses tend to those of the whole run.

What the run shares (start, zeros, sub-count offsets, calibration) it shows over a longer time. With J and j the Schur complement of a
window's equations on these variables, and its right side, windows that do not overlap add up: inverse covariance I + sum of J, and it times
the mean, sum of j. A fit begins with the sum over windows that were over before its own began. So no reading counts twice.
"""

from dataclasses import replace

import numpy as np

from lmeasure.core import FloatArray, Status, TrajectoryError
from lmeasure.recording import Counts, Run, known
from lmeasure.sensors import COUNTER_STATE, Lengths, lengths_from_counts
from lmeasure.text import message
from lmeasure.trajectory.curve.curve import ORDER, Curve, Instants
from lmeasure.trajectory.curve.fit import BRIDGED_MM, ROUNDS, Control, Fit, Known, curve_of_fit, readings_of
from lmeasure.trajectory.origin.start import enough_absolute
from lmeasure.trajectory.reconstruction.runs import prepare
from lmeasure.trajectory.reconstruction.screw_method import Place, Reconstruction
from lmeasure.trajectory.time.passes import align

HOPS = 4  # Fits in a lag
KNOTS_S = 8e-3  # Interval of the knots, if samples are not farther apart and fit; else it is halved down to half the samples' interval
AGAIN = 3  # Rounds of a fit that begins with the smoothness of the one before
LEAST_KNOTS = 8  # Least intervals of knots in a lag: farther readings hardly affect a pose
MISFIT = 1.5  # Mean square of residuals, in standard uncertainties, from which readings contradict each other or the knots


class CurveStream:
    """Curve of a run while it is being recorded: samples in, poses with velocities and covariances out, a lag behind.

    Parameters
    ----------
    run
        Rig, start and statements of the run. Its passes are not read: `lm.Run(rig, start, ())` is enough.
    lag_s
        Longest time [s] from a sample to its pose. At least three quarters of it are used to smooth.
    spacing_s
        Interval of the knots [s]; by default 8 ms, or that of the samples if it is longer, and less if the counts require it.

    Raises
    ------
    TrajectoryError
        If the rig has several passes, the lag is no positive time or shorter than eight knots, or nothing determines the start.

    Examples
    --------
    >>> stream = lm.CurveStream(simulated.run.run, lag_s=2.0)
    >>> counts = simulated.run.run.passes[0]
    >>> found = [stream.push(*sample) for sample in zip(counts.time_s, counts.recorded)]
    >>> stream.finish().poses.shape[1]
    7
    """

    why = ""
    """Reason why the last poses are missing, empty if they are not."""
    curve: Curve | None = None
    """Curve of the last two lags; None before the first pose."""

    def __init__(self, run: Run, *, lag_s: float = 0.5, spacing_s: float | None = None) -> None:
        if run.rig.passes > 1:
            raise TrajectoryError(message("curve.passes", passes=run.rig.passes))
        for code, value in (("curve.lag", lag_s), ("curve.spacing", spacing_s)):
            if value is not None and not 0.0 < value < np.inf:
                raise TrajectoryError(message(code, spacing_s=value))
        if run.start is None and not enough_absolute(run.rig):
            known(None, f"rig {run.rig.name!r}", run.rig)
        self.channels = tuple(o.channel for o in run.rig.observed)
        self.lag_s = lag_s
        self._run, self._spacing_s = run, spacing_s
        self._time_s, self._recorded = list[float](), list[FloatArray]()  # Of the window
        self._counters = np.zeros((len(self.channels), COUNTER_STATE))  # Where it begins, as its place
        self._place: Place | None = None
        self._reconstruction: Reconstruction | None = None
        self._due = self._done = self._block_ends = -np.inf
        self._knots_s = np.inf
        self._known: Known | None = None
        self._block: Known | None = None  # Information of the last non-overlapping window
        self._before: tuple[FloatArray, Control] | None = None  # Times of the control poses of the last fit

    def push(self, time_s: float, recorded: FloatArray) -> Instants | None:
        """Take a sample: recorded counts (m,) in the order of `channels`, NaN for none.

        Return
        ------
        Instants or None
            Poses and velocities of earlier samples, each once, whenever a quarter of the lag has passed; else None. Poses are NaN where
            the counts do not fit a smooth motion (`why` is the reason) and in long gaps.
        """
        if self._time_s and not time_s > self._time_s[-1]:
            raise TrajectoryError(message("curve.backwards", time_s=time_s, last_s=self._time_s[-1]))
        if not self._time_s:
            self._due = time_s + self.lag_s
        self._time_s.append(time_s)
        self._recorded.append(np.asarray(recorded, dtype=np.float64))
        if time_s < self._due:
            return None
        hop = self.lag_s / HOPS
        found = self._fitted(time_s - self.lag_s + hop)
        # a start that is not determined yet is sought again when the run is half as long again
        self._due = time_s + (hop if self._reconstruction is not None else 0.5 * (time_s - self._time_s[0]))
        self._drop(time_s + hop - 2.0 * self.lag_s)
        return found

    def finish(self) -> Instants | None:
        """Return the poses of the last samples. Behind these the curve has fewer readings, and a larger uncertainty."""
        return self._fitted(np.inf) if self._time_s else None

    def _lengths(self, few: slice, counters: FloatArray) -> Lengths:
        """Lengths of samples of the window, whose counters are moved on."""
        assert self._reconstruction is not None
        rig = self._reconstruction.model.rig
        counts = Counts(np.array(self._time_s[few]), self.channels, np.array(self._recorded[few]), source="the run so far")
        lengths = lengths_from_counts(replace(self._run, rig=rig, passes=(counts,)), counters)
        return self._reconstruction.doubts.applied(rig, lengths)

    def _prepared(self) -> Reconstruction | None:
        """The reconstruction, as the first window shows it; None as long as an unstated start is not determined."""
        if self._reconstruction is None:
            counts = Counts(np.array(self._time_s), self.channels, np.array(self._recorded), source="the run so far")
            try:
                self._reconstruction = prepare(align(replace(self._run, passes=(counts,))))
            except TrajectoryError as error:
                if self._run.start is not None:
                    raise
                self.why = str(error)
                return None
            self._place = replace(self._reconstruction.beginning, by_kernels=True)
        return self._reconstruction

    def _fitted(self, until_s: float) -> Instants | None:
        """Fit the window, and return the samples up to a time that were not given yet."""
        reconstruction = self._prepared()
        if reconstruction is None or self._place is None:
            return None
        lengths = self._lengths(slice(None), self._counters.copy())
        (trajectory,) = reconstruction.trajectories([lengths], covariances=False, place=self._place)
        time_s = lengths.time_s
        period_s = float(np.median(np.diff(time_s)))
        widest_s, finest_s = (max(KNOTS_S, period_s), 0.5 * period_s) if self._spacing_s is None else (self._spacing_s,) * 2
        if self.lag_s < LEAST_KNOTS * widest_s:
            raise TrajectoryError(message("curve.lag_short", lag_s=self.lag_s, least=LEAST_KNOTS, spacing_ms=1e3 * widest_s))
        given = (time_s > self._done) & (time_s <= until_s)
        self._done, self.why = min(until_s, float(time_s[-1])), ""
        readings, self.curve = readings_of(reconstruction, lengths, trajectory, self._place.state), None
        if self._known is not None and self._block is not None and time_s[0] > self._block_ends:
            (before, mean), (J, j) = self._known, self._block
            self._known, self._block = (before + J, mean + j), None
            self._knots_s *= 2.0  # The robot may move less sharply by now
        self._knots_s = min(self._knots_s, widest_s)
        while self.curve is None:
            try:
                self.curve = self._fit(Fit(readings, self._knots_s, reconstruction.budget.every, known=self._known))
            except TrajectoryError as error:
                self._before = None
                if self._knots_s <= finest_s:
                    self.why = str(error)
                    break
                self._knots_s = max(0.5 * self._knots_s, finest_s)
        if self.curve is None:
            nowhere = np.full((int(given.sum()), 2, 6, 6), np.nan)
            return Instants(time_s[given], nowhere[:, 0, 0, [0, 1, 2, 3, 4, 5, 5]], nowhere[:, :, 0], nowhere, nowhere[:, :, :, :1])
        there = self.curve.at(time_s[given], rates=1)
        u_mm = np.sqrt((there.u[:, 0, 3:] ** 2).sum(axis=1))
        far = (trajectory.status[given] != Status.OK) & (u_mm > BRIDGED_MM)
        there.poses[far] = there.rates[far] = there.random[far] = there.shared[far] = np.nan
        return there

    def _fit(self, fit: Fit) -> Curve:
        """The curve of a window, which begins as the last one ended."""
        poses = int(np.isfinite(fit.readings.poses[:, 0]).sum())
        if poses < ORDER:
            raise TrajectoryError(message("curve.few", poses=poses, least=ORDER))
        control, self._known = fit.begin(), fit.known
        at = np.asarray(fit.begin_s + fit.spacing_s * np.arange(len(control.snap)), dtype=np.float64)
        if self._before is not None:
            times, last = self._before
            control.snap = last.snap[np.clip(np.searchsorted(times, at - 0.5 * fit.spacing_s), 0, len(times) - 1)]
            control.variables = last.variables
        solution = fit.solve(control, ROUNDS if self._before is None else AGAIN)
        if fit.equations(solution.control)[5] > MISFIT * np.isfinite(fit.readings.changes).sum():
            raise TrajectoryError(message("curve.misfit", spacing_ms=1e3 * fit.spacing_s))
        self._before = at, solution.control
        if self._block is None:
            self._block, self._block_ends = solution.shown, float(fit.readings.lengths.time_s[-1])
        return curve_of_fit(fit, solution)

    def _drop(self, begin_s: float) -> None:
        """Let go of samples before a time, and move on to it."""
        gone = int(np.searchsorted(self._time_s, begin_s))
        if gone and self._reconstruction is not None and self._place is not None:
            self._reconstruction.follow(self._lengths(slice(gone), self._counters), self._place)
            del self._time_s[:gone], self._recorded[:gone]
