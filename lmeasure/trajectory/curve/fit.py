"""A run as a curve: least squares of all readings, each at its own time, with a smoothness and a knot spacing that the readings choose.

Model
-----
A reading is the channel's law at the pose of its instant, plus L z of variables z that the run shares (`Budget.every`: start, zeros,
sub-count offsets, calibration, drums; each of unit variance), plus its own rounding and noise. Clocks of channels that were not latched
together are such variables too: an offset and a rate each, about the mean of all channels, since a common offset is a convention.

The fourth differences of the control poses are normal about 0, of variance v(i) at knot i and by component: white snap, the prior of a jerk
that wanders. v maximises the evidence: v = sum K (D c)^2 / sum K (1 - var(D c) / v) (MacKay 1992), K a bell of `BELL` knots. So the curve
is stiff where the robot rests and yields where it jerks, and a gap is bridged with the uncertainty that the motion about it has. As the
posterior of a Gaussian prior it covers on average over the run (Nychka, JASA 1988). The spacing of the knots has the largest evidence among
those by powers of two, on a part of the run, or is wider and about as likely. It is halved once more: the spline's own error then falls by
2^6, below its uncertainty.

Solution
--------
Gauss-Newton: normal equations N of the control poses have a band of 36 rows, N + D^T v^-1 D is factored in it, so time and memory grow
linearly with the run. The shared variables border the band (S = P - X^T N^-1 X, Schur): with Y = N^-1 X the errors of the control poses are
Y S^-1/2 of independent variables of unit variance, besides the band of N^-1 (Takahashi's recurrence).

A constant count is one error, however often it is read: a reading that k samples on end repeat has k times its variance. A dwell
then counts as its interval does, a uniform error of one count. Where readings move by a count or more between samples, roundings are
independent and as good as normal: some twenty of them act on each pose.

Without redundant channels nothing but the smoothness of the motion would speak about the shared variables, and a robot need not be smooth.
There they keep their earlier values, and the poses include it.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import comb

import numpy as np
import scipy
from scipy.ndimage import gaussian_filter1d
from scipy.spatial.transform import Slerp

from lmeasure import kernels
from lmeasure.core import FloatArray, Status, TrajectoryError, se3, symmetric_root
from lmeasure.recording import Run
from lmeasure.sensors import Lengths, rounding_variance
from lmeasure.text import Message, message
from lmeasure.trajectory.curve.curve import ORDER, Curve, tables
from lmeasure.trajectory.curve.joint_log import JointLog, Shape
from lmeasure.trajectory.faults.redundancy import repeats
from lmeasure.trajectory.files.trajectory import Trajectory
from lmeasure.trajectory.reconstruction.run_model import FREEDOMS
from lmeasure.trajectory.reconstruction.runs import Judge, prepare, with_evidence
from lmeasure.trajectory.reconstruction.screw_method import Reconstruction, zero_readings
from lmeasure.trajectory.time.passes import Alignment, align
from lmeasure.trajectory.uncertainty.sources import Situation, Source

DIFFERENCES = 4  # Of the control poses, that are white: snap
BELL = 2.0  # Knots, one standard deviation, over which the size of the snap is estimated
ANYWHERE = 1e-5  # Of the weight of that estimate: the whole run's
ROUNDS, ESTIMATES, SETTLED = 20, 12, 1e-5
"""Most rounds of Gauss-Newton, those in which the size of the snap is estimated, and the mean squared part of an unknown in the last step,
in standard uncertainties. A size that the readings hardly show wanders on without changing the curve: it is taken as it is then."""
STIFFEST = 1e-10  # Of the variance that a control pose has by its readings: the least of a fourth difference
TRIES = 3  # Spacings, each half of the one before, that are tried where the chosen one has no solution
STRAIGHT_MM, LEVER_MM = 0.1, 1000.0
"""Move, of a turn at this lever, up to which the equations are followed by their own slopes: readings bend by some 5e-6 mm
there. Equations of clocks are made anew, since they bend with the acceleration."""
DOUBT = 16.0  # Factor on the estimated variance of differences from a log, because a robot's deviations follow its motion, not chance
SMOOTHINGS = 3  # Estimates of the snap in each round
CHOSEN_BY = 3000  # Samples for the choice of the spacing
WIDEST = 8  # Intervals that the run, or that part, has at least
FARTHEST = 2  # Spacings worse than the best after which no finer one is tried
ALIKE = 10.0  # Largest loss of log evidence of a spacing against the best; it is halved
CHUNK = 4096
U_CLOCK_RATE = 1e-4  # For a clock without a stated rate: a quartz in its worst climate
BRIDGED_MM = 1.0  # Standard uncertainty of the position up to which a gap is bridged
HELD = 1e24  # Weight of constrained values
BEYOND = 4.0  # Extension of a curve beyond its first and last stamp, in standard uncertainties of the stamps
UNSEEN = 0.9  # Relative to the standard uncertainty of a clock before the run: above it the run does not determine the clock


@dataclass(frozen=True)
class Readings:
    """Readings of m channels at n samples: changes (n, m) [mm, rad], NaN where there is none, at times (n, m) [s] with variances (n, m)."""

    reconstruction: Reconstruction
    lengths: Lengths
    times: FloatArray
    changes: FloatArray
    variance: FloatArray
    poses: FloatArray  # (n, 7) of the run at the samples' times, from which the fit begins; NaN where there is none
    u_clock_s: float  # Standard uncertainty of a channel's stamps as a whole; 0 where channels are latched together
    middle_s: float  # Time about which rates of clocks count

    def part(self, few: slice) -> "Readings":
        """Return some of the samples."""
        some = {name: getattr(self, name)[few] for name in ("times", "changes", "variance", "poses")}
        whole = self.lengths
        late, warm = (None if values is None else values[few] for values in (whole.u_time_s, whole.temperature_c))
        lengths = replace(
            whole, time_s=whole.time_s[few], counts=whole.counts[few], change_mm=whole.change_mm[few], u_time_s=late, temperature_c=warm
        )
        return replace(self, lengths=lengths, **some)


@dataclass
class Control:
    """Control poses with the variances of their fourth differences (K - 4, 6), and the sources of the shared variables."""

    points: FloatArray
    turns: FloatArray  # (K, 4) unit quaternions
    snap: FloatArray
    variables: FloatArray

    def differences(self) -> FloatArray:
        """Return (K - 4, 6) fourth differences, of turns in the chart about the middle one."""
        return np.asarray(kernels.spline_differences(self.points, self.turns, _SIGNS))

    def moved(self, by: FloatArray) -> None:
        """Move the control poses by displacements (K, 6)."""
        self.points, self.turns = kernels.spline_moved(self.points, self.turns, by)


Known = tuple[FloatArray, FloatArray]
"""Inverse covariance (b, b) of shared variables, and it times their mean (b,)."""
Equations = tuple[FloatArray, FloatArray, FloatArray, FloatArray, FloatArray, float]
_SIGNS = np.array([(-1.0) ** (DIFFERENCES - i) * comb(DIFFERENCES, i) for i in range(DIFFERENCES + 1)])


@dataclass(frozen=True)
class Solution:
    """A fit: its control poses, band of their covariance and of the factor of its inverse, shared (K, 6, b) errors by independent
    variables, covariance (b, b) of the shared variables, what the readings alone show of these (`Known`), the logarithm of the evidence,
    and the squared length of the step to it in standard uncertainties."""

    control: Control
    band: FloatArray
    factor: FloatArray
    shared: FloatArray
    covariance: FloatArray
    shown: Known
    evidence: float
    decrement: float


class Fit:
    """Gauss-Newton on the control poses of a spacing [s], with the variables of some sources of the run and those of its clocks."""

    def __init__(
        self, readings: Readings, spacing_s: float, sources: tuple[Source, ...], *, known: Known | None = None, shape: Shape | None = None
    ) -> None:
        """known: of the variables by readings that are not among these; where it is None they are independent, of unit variance. shape: of
        the motion by the robot's log."""
        self.readings, self.spacing_s, self.sources = readings, spacing_s, sources
        self.reconstruction = readings.reconstruction
        model, budget = self.reconstruction.model, self.reconstruction.budget
        beyond = BEYOND * readings.u_clock_s
        every = np.concatenate([readings.times.ravel(), readings.lengths.time_s])
        self.begin_s, self.end_s = float(every.min()) - beyond, float(every.max()) + beyond
        self.knots = max(int(np.ceil((self.end_s - self.begin_s) / spacing_s * (1.0 - 1e-12))), 1) + ORDER - 1
        self.knots_s: FloatArray = self.begin_s + spacing_s * (np.arange(self.knots, dtype=np.float64) - 0.5 * (ORDER - 2))
        self.expected = np.zeros((self.knots - DIFFERENCES, 6)) if shape is None else shape.differences(self.knots_s, _SIGNS)
        self.rows, self.zero = model.scheme.rows, zero_readings(model, model.scheme.rows, model.zero_pose)
        self.in_mm = np.repeat([LEVER_MM, 1.0], 3)
        self.held = np.setdiff1d(np.arange(6), model.scheme.free_index)
        # a common offset of all clocks is a convention; a channel without readings has no part in it
        seen = np.asarray(np.isfinite(readings.changes).any(axis=0))
        apart = np.zeros((len(seen), max(int(seen.sum()) - 1, 0) if readings.u_clock_s else 0))
        if apart.size:
            apart[seen] = np.linalg.svd(np.ones((1, int(seen.sum()))))[2][1:].T
        self.late, self.slow = readings.u_clock_s * apart, U_CLOCK_RATE * apart
        self.names = tuple(name for source in sources for name in source.names)
        b = len(self.names) + 2 * self.late.shape[1]
        self.known = (np.eye(b), np.zeros(b)) if known is None else known
        self.origins = budget.supposed if budget.estimate is None else budget.estimate.mean

    def begin(self) -> Control:
        """Return control poses on the run's poses sample by sample (Schoenberg), straight on beyond its ends."""
        known = np.isfinite(self.readings.poses[:, 0])
        times, poses = self.readings.lengths.time_s[known], self.readings.poses[known]
        at = self.knots_s
        inside = np.clip(at, times[0], times[-1])
        points = np.column_stack([np.interp(inside, times, poses[:, c]) for c in range(3)])
        beyond = (at - inside)[:, None]
        near = min(max(int(np.searchsorted(times, times[0] + self.spacing_s)), 1), len(times) - 1)
        first, last = ((poses[b, :3] - poses[a, :3]) / (times[b] - times[a]) for a, b in ((0, near), (-1 - near, -1)))
        points += np.where(beyond < 0.0, beyond * first, beyond * last)
        turns = np.asarray(Slerp(times, se3.rotation(poses))(inside).as_quat())
        variables = np.zeros(len(self.names) + 2 * self.late.shape[1])
        variables[len(self.names) - len(self.origins) : len(self.names)] = self.origins
        control = Control(points, turns, np.empty((0, 6)), variables)
        control.snap = np.tile(
            np.maximum(((control.differences() - self.expected) ** 2).mean(axis=0), 1e-30), (self.knots - DIFFERENCES, 1)
        )
        return control

    def _chunks(self) -> Iterator[tuple[slice, FloatArray]]:
        """Yield slices of the samples with the errors (n, m, b0) of their readings by the shared variables."""
        (n, m), lengths = self.readings.changes.shape, self.readings.lengths
        budget = self.reconstruction.budget.with_estimate(None)
        if not self.names:
            yield slice(0, n), np.zeros((n, m, 0))
            return
        speed, travel = budget.speed_mm_s(lengths), budget.travel(lengths)
        for i in range(0, n, CHUNK):
            few = slice(i, min(i + CHUNK, n))
            warm, gone = (None if values is None else values[few] for values in (lengths.temperature_c, travel))
            at = Situation(lengths.time_s[few], self.readings.poses[few], lengths.counts[few], speed[few], warm, gone)
            every = budget.lengths_of(at, self.sources)
            yield few, np.ascontiguousarray(np.where(np.isfinite(every), every, 0.0))

    def equations(self, control: Control) -> Equations:
        """Return N, g, X, S, s of `spline_equations`, and the sum of squares."""
        readings, b0, c = self.readings, len(self.names), self.late.shape[1]
        b, z = b0 + 2 * c, control.variables
        N, g, X = np.zeros((6 * self.knots, 6 * ORDER)), np.zeros(6 * self.knots), np.zeros((6 * self.knots, b))
        S, s, total = np.zeros((b, b)), np.zeros(b), 0.0
        own, cumulative = tables(self.spacing_s)
        turns, middle = control.turns, readings.middle_s
        steps = np.asarray(kernels.spline_steps(turns))
        for few, shared in self._chunks():
            times = readings.times[few]
            if c:
                times = times + self.late @ z[b0 : b0 + c] + (times - middle) * (self.slow @ z[b0 + c :])
            changes = readings.changes[few] - shared @ z[:b0] if b0 else readings.changes[few]
            at = np.ascontiguousarray(np.clip(times, self.begin_s, self.end_s))
            read = self.rows, self.zero, np.ascontiguousarray(changes), at, 1.0 / readings.variance[few]
            curve = (self.begin_s, self.spacing_s), (own[:2], cumulative[:2]), control.points, turns, steps
            total += kernels.spline_equations(*read, *curve, shared, (self.late, self.slow, middle), N, g, X, S, s)
        return N, g, X, S, s, total

    def solve(self, control: Control, rounds: int = ROUNDS, most: int = ESTIMATES) -> Solution:
        """Return the fit, from control poses that are moved on; TrajectoryError where it does not settle, if it has all `ROUNDS` for it."""
        size = moved = np.inf
        equations: Equations | None = None
        for number in range(rounds):
            if equations is None or moved > STRAIGHT_MM or self.late.size:
                equations, moved = self.equations(control), 0.0
            estimates = number < most
            for _ in range(SMOOTHINGS if estimates else 1):
                step, solution = self._step(equations, control, estimates=estimates)
            own, shared = np.split(step, [6 * self.knots])
            control.moved(own.reshape(-1, 6))
            control.variables = control.variables + shared
            moved += float(np.abs(own.reshape(-1, 6) * self.in_mm).max())
            equations = _followed(equations, own, shared)
            size = solution.decrement / len(own)
            if size < SETTLED or not np.isfinite(size):
                break
        if np.isfinite(size) and (size < SETTLED or rounds < ROUNDS):
            return solution
        raise TrajectoryError(message("curve.unsettled", spacing_ms=1e3 * self.spacing_s, rounds=rounds))

    def _step(self, equations: Equations, control: Control, *, estimates: bool) -> tuple[FloatArray, Solution]:
        """Solve the equations for a step, and estimate the snap anew, if it is to be."""
        N, g, X, S, s, total = equations
        K, width, b = self.knots, 6 * ORDER, len(s)
        # stiffer than this, the readings would be lost in the rounding of the prior
        floor = STIFFEST / np.maximum(N[:, 0].reshape(K, 6).mean(axis=0), 1e-30)
        difference, by_variance = control.differences() - self.expected, 1.0 / np.maximum(control.snap, floor)
        A, right = N.copy(), g.copy()
        kernels.add_spline_prior(_SIGNS, by_variance, difference, A, right)
        right.reshape(K, 6)[:, self.held] = 0.0
        A.reshape(K, 6, width)[:, self.held, 0] += HELD
        factor, failed = scipy.linalg.lapack.dpbtrf(A.T, lower=1)
        if failed:
            raise TrajectoryError(message("curve.undetermined", spacing_ms=1e3 * self.spacing_s))
        Y = scipy.linalg.lapack.dpbtrs(factor, np.column_stack([right, X]), lower=1)[0]
        step, Y = Y[:, 0], Y[:, 1:]
        left = np.ascontiguousarray(factor.T)
        band = np.asarray(kernels.band_inverse(left))
        evidence = -0.5 * (total + (by_variance * difference**2).sum() - step @ right)
        evidence += 0.5 * np.log(by_variance).sum() - np.log(left[:, 0]).sum()
        # of polynomials, which the prior leaves alone, coefficients by time are alike for all spacings
        evidence -= 6.0 * 0.5 * DIFFERENCES * (DIFFERENCES - 1) * np.log(self.spacing_s)
        covariance, shared, move = np.eye(b), np.zeros((K, 6, b)), np.zeros(b)
        shown, decrement = (np.zeros((b, b)), np.zeros(b)), float(step @ right)
        if b:
            if self.reconstruction.model.scheme.redundancy:
                J, (before, mean) = S - X.T @ Y, self.known
                shown = J, s - X.T @ step + J @ control.variables
                covariance = np.linalg.inv(before + J)
                covariance = 0.5 * (covariance + covariance.T)
                along = mean + shown[1] - (before + J) @ control.variables
                move = covariance @ along
                step, decrement = step - Y @ move, decrement + float(along @ move)
            shared = -(Y @ symmetric_root(covariance)).reshape(K, 6, b)
        if estimates:
            control.snap = self._snap(difference, step.reshape(K, 6), band, by_variance)
        return np.concatenate([step, move]), Solution(control, band, left, shared, covariance, shown, float(evidence), decrement)

    @staticmethod
    def _snap(difference: FloatArray, step: FloatArray, band: FloatArray, by_variance: FloatArray) -> FloatArray:
        """Return the variances (K - 4, 6) of the fourth differences by the evidence, from those before a step and its covariance."""
        rows = len(difference)
        variance, after = np.asarray(kernels.variances_of_differences(_SIGNS, band, rows)), difference.copy()
        for i, di in enumerate(_SIGNS):
            after += di * step[i : rows + i]
        square, known = after**2, np.clip(1.0 - variance * by_variance, 1e-9, 1.0)
        whole = square.sum(axis=0) / known.sum(axis=0)
        bell = 0.5 * ANYWHERE / BELL
        square, known = (gaussian_filter1d(values, BELL, axis=0, mode="nearest") for values in (square, known))
        return np.maximum((square + bell * whole) / (known + bell), 1e-30)


def _followed(equations: Equations, own: FloatArray, shared: FloatArray) -> Equations:
    """Return the equations after a step of control poses (6 K,) and shared variables (b,), by their slopes."""
    N, g, X, S, s, total = equations
    by_own = scipy.linalg.blas.dsbmv(N.shape[1] - 1, 1.0, N.T, own, lower=1) + X @ shared
    by_shared = X.T @ own + S @ shared
    total += own @ by_own + shared @ by_shared - 2.0 * (own @ g + shared @ s)
    return N, g - by_own, X, S, s - by_shared, float(total)


def spacing_of(readings: Readings) -> float:
    """Return the knot spacing [s] that the readings choose."""
    n = len(readings.times)
    begin = max((n - CHOSEN_BY) // 2, 0)
    part = readings.part(slice(begin, begin + CHOSEN_BY))
    at = part.lengths.time_s
    period, lasts = float(np.median(np.diff(at))), float(at[-1] - at[0])
    finest = 0.5 * period
    spacings = finest * 2.0 ** np.arange(max(int(np.log2(lasts / WIDEST / finest)), 0) + 1)
    found: list[tuple[float, float]] = []
    for spacing_s in spacings[::-1].tolist():
        fit = Fit(part, spacing_s, readings.reconstruction.budget.origins)
        try:
            found.append((spacing_s, fit.solve(fit.begin(), 3).evidence))
        except TrajectoryError:
            continue
        if len(found) - 1 - int(np.argmax([evidence for _, evidence in found])) == FARTHEST:
            break
    best = max((evidence for _, evidence in found), default=np.inf)
    coarsest = next((spacing_s for spacing_s, evidence in found if evidence >= best - ALIKE), float(spacings[0]))
    return max(0.5 * coarsest, finest)


def jitter_of(times: FloatArray) -> FloatArray:
    """Return the standard uncertainty (m,) [s] of single stamps of channels (n, m) that send regularly, by how far these are from even."""
    if len(times) < WIDEST:
        return np.zeros(times.shape[1])
    period, off = np.median(np.diff(times, axis=0), axis=0), np.abs(np.diff(times, 2, axis=0))
    off = np.where(off < period, off, 0.0)
    typical = np.maximum(1.4826 * np.median(off, axis=0), np.sqrt(0.5 * np.pi) * off.mean(axis=0))
    return np.asarray(typical / np.sqrt(6.0))


def readings_of(reconstruction: Reconstruction, lengths: Lengths, trajectory: Trajectory, state: FloatArray | None = None) -> Readings:
    """Return the readings of a run, as a curve takes them: those of channels with their own times at these. state: where the run is as they
    begin, by default its start. TrajectoryError for a run of several passes, whose channels were read in different motions, and for one of
    fewer freedoms than six."""
    budget = reconstruction.budget
    rig = budget.rig
    if len(budget.scheme.free) < len(FREEDOMS):
        raise TrajectoryError(message("curve.freedoms", free=len(budget.scheme.free)))
    if rig.passes > 1:
        raise TrajectoryError(message("curve.passes", passes=rig.passes))
    changes = reconstruction.corrected(lengths, state).change_mm + budget.offsets(lengths.time_s)
    times, counts, u_mm, u_clock_s = np.tile(lengths.time_s[:, None], (1, changes.shape[1])), lengths.counts, lengths.u_mm, 0.0
    if lengths.frames is not None:
        # each frame at its own time; the uncertainty of that time is the clock's
        times, beyond = lengths.frames
        counts, u_mm = lengths.counts + beyond, None
        rows = rig.cable_rows(rig.observed)
        changes = changes + kernels.changes_from_counts(rows, np.ascontiguousarray(counts)) - lengths.change_mm
        u_clock_s = 0.0 if lengths.u_time_s is None else float(np.sqrt(np.mean(lengths.u_time_s**2)))
        u_mm = jitter_of(times) * budget.speed_mm_s(lengths)
    rounding, middle = rounding_variance(rig, rig.observed), 0.5 * float(times.min() + times.max())
    variance = np.asarray(budget.variance + (0.0 if u_mm is None else u_mm**2) + rounding * (repeats(counts) - 1.0))
    return Readings(reconstruction, lengths, times, np.ascontiguousarray(changes), variance, trajectory.poses, u_clock_s, middle)


def curve_of(readings: Readings, spacing_s: float | None = None, shape: Shape | None = None) -> Curve:
    """Return the curve of the readings; spacing_s: of its knots, chosen by the readings where it is None; shape: by the robot's log."""
    if spacing_s is not None and not 0.0 < spacing_s < np.inf:
        raise TrajectoryError(message("curve.spacing", spacing_s=spacing_s))
    known = np.isfinite(readings.poses[:, 0])
    if known.sum() < ORDER:
        raise TrajectoryError(message("curve.few", poses=int(known.sum()), least=ORDER))
    budget = readings.reconstruction.budget
    chosen = spacing_of(readings) if spacing_s is None else spacing_s
    tries = TRIES if spacing_s is None else 1
    for halved in range(tries):
        first = fit = Fit(readings, chosen / 2.0**halved, budget.origins, shape=shape)
        try:
            solution = first.solve(first.begin())
            break
        except TrajectoryError:
            # knots so far apart that the path bends much between them
            if halved == tries - 1:
                raise
    if len(budget.every) > len(budget.origins):
        fit = Fit(readings, fit.spacing_s, budget.every, shape=shape)
        control, more = solution.control, len(fit.names) - len(first.names)
        control.variables = np.concatenate([np.zeros(more), control.variables])
        solution = fit.solve(control)
    if shape is not None:
        solution.control.snap *= DOUBT
        solution = replace(fit.solve(solution.control, most=0), evidence=solution.evidence)
    return curve_of_fit(fit, solution)


def curve_of_fit(fit: Fit, solution: Solution) -> Curve:
    """Return the curve of a fit."""
    control, b0, c = solution.control, len(fit.names), fit.late.shape[1]
    clocks = {"clocks_s": fit.late, "clock_rates": fit.slow}
    seen: dict[str, FloatArray] = {}
    for i, (name, of) in enumerate(clocks.items()):
        mine = slice(b0 + i * c, b0 + (i + 1) * c)
        seen[name] = of @ control.variables[mine] if c else np.empty(0)
        seen[f"u_{name}"] = np.sqrt(np.einsum("ij,jk,ik->i", of, solution.covariance[mine, mine], of)) if c else np.empty(0)
    sources = (*fit.names, *("clock offset",) * c, *("clock rate",) * c)
    keys = (*(key for source in fit.sources for key in source.assumed or ("",) * len(source.names)), *("",) * (2 * c))
    solved = control.points, control.turns, solution.band, solution.factor, solution.shared
    u_before_s = float(np.linalg.norm(fit.late, axis=1).max(initial=0.0))
    return Curve(
        fit.begin_s,
        fit.end_s,
        fit.spacing_s,
        *solved,
        sources,
        keys,
        fit.readings.lengths.cables,
        **seen,
        u_before_s=u_before_s,
        evidence=solution.evidence,
    )


def reconstruct_curve(
    run: Run | Alignment,
    constraint: str | None = None,
    *,
    spacing_s: float | None = None,
    joints: JointLog | None = None,
    judge: Judge | None = None,
) -> tuple[Trajectory, Curve]:
    """Return the trajectory of a run at its samples from its curve, and the curve.

    spacing_s: of the knots, None: chosen by the readings; joints: the robot's own log, a prior of the shape if the readings agree with it;
    constraint, judge: as in `reconstruct`. Raises the errors of that, and TrajectoryError without a curve.
    """
    run = replace(run, run=run.run.by_frames()) if isinstance(run, Alignment) else run.by_frames()
    aligned = align(run)
    first = aligned.run.passes[0]
    # channels whose clocks are off contradict each other at every sample, until the curve has found by how much
    clocks = first.stamp_s is not None and first.u_time_s is not None
    reconstruction = prepare(aligned, constraint, compares=not clocks)
    aligned = aligned.zeroed(reconstruction.model.rig)
    more = () if judge is None or clocks else judge(reconstruction)
    lengths = aligned.lengths_of(reconstruction.doubts)
    trajectory = with_evidence(reconstruction, reconstruction.trajectory(lengths), lengths, aligned, covariances=True)
    readings = readings_of(reconstruction, lengths, trajectory)
    curve = curve_of(readings, spacing_s)
    notes = (*trajectory.notes, *more, *aligned.notes, *notes_of_curve(curve))
    if joints is not None:
        shape, without = joints.moving(trajectory), curve
        by_log = curve_of(readings, without.spacing_s, shape)
        used = by_log.evidence > without.evidence
        curve = by_log if used else without
        notes = (*notes, _note_of_log(joints, shape, trajectory.time_s, curve, without))
    # zeros known to a degree only are nonlinear: their part beyond first order is that of the samples
    rough = len(reconstruction.budget.sources) > sum(len(source.names) for source in reconstruction.budget.every)
    return replace(on_curve(trajectory, curve, systematic=not rough), notes=notes), curve


def on_curve(trajectory: Trajectory, curve: Curve, *, systematic: bool = True) -> Trajectory:
    """Return a trajectory whose poses and covariances are those of the curve, with its gaps bridged up to `BRIDGED_MM`; systematic: whether
    the systematic covariances are the curve's too."""
    there = curve.at(trajectory.time_s, rates=0)
    own, shared = there.random[:, 0], there.systematic[:, 0]
    u_mm = np.sqrt(np.einsum("nii->n", own[:, 3:, 3:]) + np.einsum("nii->n", shared[:, 3:, 3:]))
    ok = trajectory.status == Status.OK
    bridged = np.isin(trajectory.status, (Status.GAP, Status.JUMP)) & (u_mm <= BRIDGED_MM)
    used = ok | bridged
    turned = ~np.isnan(trajectory.poses[ok, 3:]).all()
    poses = there.poses
    for values in (poses, own, shared):
        values[~used] = np.nan
    if not systematic:
        shared[ok] = trajectory.systematic[ok]
    if not turned:
        poses[:, 3:] = np.nan
        for covariance in (own, shared):
            covariance[:, :3, :] = covariance[:, :, :3] = np.nan
    status, cause = trajectory.status.copy(), trajectory.cause.copy()
    status[bridged], cause[bridged] = Status.OK, message("cause.bridged")
    return replace(trajectory, poses=poses, random=own, systematic=shared, status=status, cause=cause)


def _note_of_log(joints: JointLog, shape: Shape, time_s: FloatArray, curve: Curve, without: Curve) -> Message:
    """Return a note on the effect of a joint log, or that it has none."""
    if curve is without:
        return message("curve.log_unused", source=joints.source, late_ms=1e3 * shape.late_s, off_mm=shape.off_mm)
    apart = float(np.linalg.norm(curve.poses(time_s)[:, :3] - without.poses(time_s)[:, :3], axis=1).max())
    some = time_s[:: max(len(time_s) // CHUNK, 1)]
    u, u_without = (1e3 * float(np.median(np.linalg.norm(each.at(some, rates=0).u[:, 0, 3:], axis=1))) for each in (curve, without))
    frames = {"late_ms": 1e3 * shape.late_s, "off_mm": shape.off_mm}
    return message("curve.log_used", source=joints.source, **frames, apart_um=1e3 * apart, u_um=u, u_without_um=u_without)


def notes_of_curve(curve: Curve) -> tuple[Message, ...]:
    """Return notes on the knots and the clocks of a curve."""
    notes = [message("curve.knots", spacing_ms=1e3 * curve.spacing_s)]
    if len(curve.clocks_s):
        late = np.round(1e3 * curve.clocks_s, 4)
        clocks = ", ".join(f"{name} {value:+g} ms" for name, value in zip(curve.channels, late.tolist(), strict=True))
        notes.append(message("curve.clocks", clocks=clocks, u_us=1e6 * float(curve.u_clocks_s.max())))
        if (curve.u_clocks_s[curve.u_clocks_s > 0.0] > UNSEEN * curve.u_before_s).all():
            notes.append(message("curve.clocks_unseen", u_us=1e6 * curve.u_before_s))
    return tuple(notes)
