"""Sources of systematic error: common errors of all samples of a run, as errors of the lengths.

A source is a few variables, each drawn once for the whole run, with the effect of one standard deviation of each on the lengths of the
cables at a sample. `budget.Budget` takes a tuple of sources, and the covariances, Monte Carlo and the certificate's draws follow.

Effects of larger errors on a pose beyond first order: readings bend while the pose moves by a zero that is known to a degree.

With f the channels' readings at a pose, G the inverse of its rows and L the errors of the readings by variables z of unit variance, the
pose error is the delta for which f(delta) - f(0) = L z. With F = G L and H the second derivatives of f,

    delta = F z + sum_(i<j) D_ij z_i z_j + sum_i D_ii (z_i^2 - 1) / 2 + sum_i D_ii / 2 + rest,    D_ij = -G H[F_i, F_j].

Of normal z the products z_i z_j and (z_i^2 - 1) / sqrt(2) have unit variance and correlate with nothing else (JCGM 100, note to 5.1.2,
whose terms of second order these are for one quantity). So they are variables like the others, shared by all samples; the last sum is the
bias of the estimate, which is not corrected but added to them. Some draws of the rest, by one step of Newton's, give its mean square.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray, TrajectoryError, se3
from lmeasure.kernels import TURN_COUNTS, span_lengths, span_rows_of
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.sensors import ARM_MM, phase_columns
from lmeasure.text import message

PHASE = "zero phase"
ZERO = "zero"
ANYWHERE = 2.0 * math.pi / math.sqrt(12.0)  # Standard uncertainty [rad] of an angle that may be anywhere on the circle
LOOSE_RAD = 0.1  # Standard uncertainty of an encoder's zero from which its readings are no help in finding the poses
NEAR_RAD = 3e-4
"""Error of a zero that is small enough for first order: 0.5 mm at 1.5 m bend by 0.5^2 / (2 * 1500) mm, a hundredth of a count."""
LIGHT_RAD = 2e-3  # As which a zero weighs that poses need, or its row is lost in the rounding of those of counts
UNKNOWN_MM = 1000.0
"""Standard uncertainty of a length against a guess that came from angles."""
LENGTHS = "lengths of their own"


@dataclass(frozen=True)
class PassClock:
    """Standard uncertainties of a pass's time against pass 1's: u_s [s], the same at all samples, and u_rate of the time [s] since about_s;
    the two are independent."""

    u_s: float = 0.0
    u_rate: float = 0.0
    about_s: float = 0.0

    @property
    def variables(self) -> int:
        """Return how many variables its error is."""
        return bool(self.u_s) + bool(self.u_rate)

    def late_s(self, time_s: FloatArray) -> FloatArray:
        """(n, variables) errors of the pass's time at times (n,) by one standard deviation of each variable."""
        every = np.column_stack([np.full(len(time_s), self.u_s), self.u_rate * (time_s - self.about_s)])
        return every[:, np.array([self.u_s, self.u_rate]) > 0.0]


@dataclass(frozen=True)
class Situation:
    """Quantities that errors of lengths may depend on: times (n,), poses (n, 7), true counts (n, m), speeds of the cables (n, m) [mm/s],
    their temperatures (n, m) [deg C], those of the start where None, and which way they travelled last (n, m), paying out where None."""

    time_s: FloatArray
    poses: FloatArray
    counts: FloatArray
    speed_mm_s: FloatArray
    temperature_c: FloatArray | None = None
    travel: FloatArray | None = None


@dataclass(frozen=True)
class Source:
    """One kind of error. names (k,): of its variables, as in `PoseCovariances.sources`; said: their name in the words of `Budget.covers`.
    lengths: errors of the lengths (n, m, k) [mm] per standard deviation of each variable, or (m, k) if they are the same at all samples.
    uniform: whether the variables are uniform, of unit variance, or normal. assumed (k,): the key of each typical size, empty for stated or
    calibrated ones; () without any."""

    names: tuple[str, ...]
    said: tuple[str, ...]
    lengths: Callable[[Situation], FloatArray]
    uniform: bool = False
    assumed: tuple[str, ...] = ()


def zero_phase(rig: Rig) -> Source:
    """Return the sub-count offset at zeroing: recorded = round(k + phase), so that every decoded count of a zeroing is off by the same
    phase, uniform within half a recorded count, and on top of it by its own rounding. The lengths are those of the zero pose plus the
    counts since. So the phase stays in all of them, whether the zero pose was stated or came from lengths (`[start] lengths_mm`)."""
    shifts = phase_columns(rig, rig.observed)
    return Source((PHASE,) * shifts.shape[1], (message("covers.of.phase"),), lambda _: shifts, uniform=True)


def unknown_start(rig: Rig, absolute: BoolArray) -> Source:
    """Return the unknown cable length or swivel angle at an unknown zeroing; absolute (m,) channels do not count from there."""
    u, of = np.array([UNKNOWN_MM if o.is_length else ANYWHERE for o in rig.observed]), rig.zeroings(rig.observed)
    relative = np.unique(of[~absolute])
    columns = np.where((of[:, None] == relative) & ~absolute[:, None], u[:, None], 0.0)
    return Source(("unknown start",) * len(relative), (message("covers.of.unknown_start"),) * bool(len(relative)), lambda _: columns)


def unknown_zeros(rig: Rig, record: CalibrationRecord | None) -> Source:
    """Return the error of absolute encoders by their zero: of the stated uncertainty, or any without a statement, except solved ones of a
    calibration."""
    columns, names = zero_columns(rig, record)
    return Source((ZERO,) * len(names), (message("covers.of.zeros"),) * bool(names), lambda _: columns)


def zero_columns(rig: Rig, record: CalibrationRecord | None) -> tuple[FloatArray, list[str]]:
    """Return (m, k) effects on the readings of one standard deviation of each uncertain zero of an encoder, and their channels."""
    solved = () if record is None else record.names
    u = np.zeros(len(rig.observed))
    for j, o in enumerate(rig.observed):
        counter = rig.counter(o)
        if counter.absolute and f"{o.channel}.{counter.zero}" not in solved:
            u[j] = counter.zero_u if o.is_length else math.radians(counter.zero_u)
    # an encoder that is read in several passes has one zero
    names = [o.channel for o in rig.observed]
    shared = [name for name in dict.fromkeys(names) if any(u[j] for j in range(len(u)) if names[j] == name)]
    return np.array([[u[j] * (names[j] == name) for name in shared] for j in range(len(u))]).reshape(len(u), len(shared)), shared


def zeros_of(rig: Rig, record: CalibrationRecord | None) -> FloatArray:
    """(m,) standard uncertainties [rad] of the zeros of the channels of a rig, of lengths as angles at `ARM_MM`, 0 where there is none or a
    calibration solved it."""
    return np.asarray(zero_columns(rig, record)[0].sum(axis=1)) * angle_of(rig)


def angle_of(rig: Rig) -> FloatArray:
    """(m,) angles [rad] that a unit of each channel's reading is like: 1 of angles, that at `ARM_MM` of a millimetre."""
    return np.array([1.0 / ARM_MM if o.is_length else 1.0 for o in rig.observed])


def variance_until_determined(zeros: FloatArray, free: int) -> FloatArray:
    """Return the (m,) variance [rad^2] of readings beyond their rounding until a run has determined the zeros, of standard uncertainties
    (m,) [rad]. A reading weighted by its rounding, but with the error of its zero, moves the pose away from that of the others, beyond
    first order. So it is weighted with its zero's uncertainty. If the others determine fewer than the free components (their number) of the
    pose, all uncertainties are reduced by one factor, since normal equations square the weights."""
    u = np.where(zeros < NEAR_RAD, 0.0, zeros)
    needed = needed_zero(u, free)
    return np.asarray((u * min(1.0, LIGHT_RAD / max(needed, LIGHT_RAD))) ** 2)


def needed_zero(zeros: FloatArray, free: int) -> float:
    """Standard uncertainty [rad] of the zero that is known worst of as many channels as there are free components, those known best."""
    return float(np.sort(zeros)[free - 1])


def rough_columns(rig: Rig, record: CalibrationRecord | None) -> FloatArray:
    """(m, k) of `zero_columns`, those of zeros that first order does not reach but poses may be found by, in their order."""
    columns = zero_columns(rig, record)[0]
    return columns[:, is_rough(rig, columns)]


def is_rough(rig: Rig, columns: FloatArray) -> BoolArray:
    """(K,) whether a zero of `zero_columns` is one of `rough_columns`."""
    u = (columns * angle_of(rig)[:, None]).max(axis=0, initial=0.0)
    return np.asarray((u > NEAR_RAD) & (u <= LOOSE_RAD))


def loose_zeros(rig: Rig, record: CalibrationRecord | None, free: int) -> IntArray:
    """Channels (index) whose zeros are so uncertain that poses must be found without them; TrajectoryError where the others are fewer than
    the free components (their number) of the pose."""
    loose = np.flatnonzero(zeros_of(rig, record) > LOOSE_RAD)
    if len(loose) and len(rig.observed) - len(loose) < free:
        determined = ", ".join(rig.observed[j].channel for j in loose)
        raise TrajectoryError(message("error.the_zero_of_is", determined=determined))
    return loose


def own_lengths(rig: Rig, record: CalibrationRecord | None) -> Source:
    """Return the cables' own errors of length, from the residuals of the calibration (`CalibrationRecord.u_length_mm`). Their cause is
    unknown: run-out, an eccentric pulley, friction. They are modelled as a wave of a drum's turn, of unknown phase, so that lengths a
    fraction of a turn apart have common errors and farther ones do not, minus the error at zeroing."""
    known = {} if record is None else record.u_length_mm
    u = np.array([known.get(c.name, 0.0) for c in rig.cable])
    own, turn = np.flatnonzero(u), rig.cable_rows()[:, TURN_COUNTS]

    def lengths(at: Situation) -> FloatArray:
        out = np.zeros((*at.counts.shape, 3 * len(own)))
        for column, j in enumerate(own):
            angle = 2.0 * np.pi * at.counts[:, j] / turn[j]
            out[:, j, 3 * column : 3 * column + 3] = u[j] * np.column_stack([np.cos(angle), np.sin(angle), np.ones_like(angle)])
        return out

    return Source((LENGTHS,) * (3 * len(own)), (message("covers.of.lengths"),) * bool(len(own)), lengths)


def drawn(sources: tuple[Source, ...], generator: "np.random.Generator") -> FloatArray:
    """(K,) a draw of the variables of these sources, one source after the other."""
    every = [standard(generator, (len(s.names),), s.uniform) for s in sources]
    return np.concatenate(every) if every else np.empty(0)


def standard(generator: "np.random.Generator", shape: tuple[int, ...], uniform: bool) -> FloatArray:
    """Draws of unit variance, uniform or normal."""
    if not uniform:
        return generator.standard_normal(shape)
    out = generator.random(shape)
    out -= 0.5
    out *= np.sqrt(12.0)
    return out


@dataclass(frozen=True)
class OriginEstimate:
    """Origins as a run determined them: mean (o,) of their variables, mix (K, K): errors of all shared variables, those of the origins
    last, by independent variables of unit variance; chi_squared of its samples, and their degrees of freedom; poses (n, 7) of those that
    had a part in it; covariance (K, K) of all shared variables, C; aside (K - o,): means of the other variables, which are not applied."""

    mean: FloatArray
    mix: FloatArray
    chi_squared: float
    freedom: int
    poses: FloatArray
    covariance: FloatArray
    aside: FloatArray


STEP = 0.1  # Step of second differences, in standard deviations: large against rounding, small against fourth order
DRAWS = 16  # Draws of the remainder: they give its mean square to about a third


def second_order_variables(k: int) -> int:
    """Return the number of second-order variables for k of first order."""
    return k * (k + 1) // 2 + 1 + DRAWS if k else 0


def beyond_first(rows: FloatArray, poses: FloatArray, *, G: FloatArray, F: FloatArray, angles: BoolArray) -> FloatArray:
    """Return (n, 6, second_order_variables(k)) errors of (n, 7) poses beyond those of first order F (n, 6, k) [rad; mm], base axes, by k
    normal variables. rows (m, columns) of the channels; angles (m,): which are angles; G (n, 6, m): motions of the poses per unit
    of each reading. NaN without a pose."""
    k = F.shape[2]
    out = np.full((len(poses), 6, second_order_variables(k)), np.nan)
    known = np.isfinite(poses).all(axis=1) & np.isfinite(F).all(axis=(1, 2))
    at, F, G = np.ascontiguousarray(poses[known]), F[known], np.where(np.isfinite(G[known]), G[known], 0.0)
    here, A = span_lengths(rows, at), span_rows_of(rows, at)

    def changed(delta: FloatArray) -> FloatArray:
        change = span_lengths(rows, np.ascontiguousarray(se3.displaced(at, delta))) - here
        return np.where(angles, np.remainder(change + np.pi, 2.0 * np.pi) - np.pi, change)

    def motions(readings: FloatArray) -> FloatArray:
        # some poses that far away have no cable path: no reading there
        return np.asarray(G @ np.where(np.isfinite(readings), readings, 0.0))

    def bend(delta: FloatArray) -> FloatArray:
        """(n, m) H[delta, delta]."""
        return (changed(STEP * delta) + changed(-STEP * delta)) / STEP**2

    own = [bend(F[:, :, i]) for i in range(k)]
    pairs = [(i, j) for i in range(k) for j in range(i)]
    mixed = [(bend(F[:, :, i] + F[:, :, j]) - own[i] - own[j]) / 2.0 for i, j in pairs]
    second = -motions(np.stack([*mixed, *(h / np.sqrt(2.0) for h in own), np.sum(own, axis=0) / 2.0], axis=2))
    rest = []
    for z in np.random.default_rng(0).standard_normal((DRAWS, k)):
        products = np.array([*(z[i] * z[j] for i, j in pairs), *((z**2 - 1.0) / np.sqrt(2.0)), 1.0])
        requested = (A @ (F @ z)[:, :, None])[:, :, 0]
        rest.append(motions((requested - changed(F @ z + second @ products))[:, :, None])[:, :, 0])
    out[known] = np.concatenate([second, np.stack(rest, axis=2) / np.sqrt(DRAWS)], axis=2)
    return out
