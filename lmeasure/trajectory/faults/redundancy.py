"""Comparison of redundant cables at a sample, with common errors of the lengths in their covariance.

Let A (m, f) be the rows of the cables by the free components of the twist, r the lengths minus those at a pose near the true one, S the
covariance of the lengths: of the counts themselves, and of the run's common errors (offset at zeroing, calibration, start pose, ...). With
N an orthonormal basis of the space that no motion reaches, A^T N = 0, the parity vector N^T r has the covariance N^T S N whatever the pose
is, and with

    W = N (N^T S N)^-1 N^T

chi-squared is r^T W r, of m - f degrees of freedom; the error that cable j alone would have to have is (W r)_j / W_jj, of standard
uncertainty 1/sqrt(W_jj): infinite if the others do not control it (Baarda 1968; Teunissen 2006, 4.4).

Size of the contradictions of sound readings by chance, with uniform rounding instead of a normal law.

A sample's parities, brought to unit covariance, are y = U u + V v with u uniform, of unit variance (the rounding of every reading, and the
sub-count offset of its counter at zeroing), v normal (calibration, clocks, ...), and U U^T + V V^T = 1 (d, d). Of chi-squared = |y|^2 the
mean is d, but its tail is shorter than the normal law's: sums of a few uniforms end. With g normal (d,), E exp(lambda |y|^2) = E exp(sqrt(2
lambda) g.y): so the generating function of the moments of chi-squared follows from that of y, averaged over directions theta of the sphere,

    B(t) = mean over theta of exp(sum_j log(sinh(s_j)/s_j) + t^2 |V^T theta|^2 / 2),   s_j = sqrt(3) t (U^T theta)_j
    E exp(lambda chi2) = 2^(1 - d/2) / Gamma(d/2) (2 lambda)^(-d/2) integral of t^(d-1) B(t) exp(-t^2 / (4 lambda)) dt

and the chance of a larger one from its logarithm K by the saddlepoint formula of Lugannani and Rice (1980) in the form of Barndorff-Nielsen
(1986), divided by the same formula for the normal law, whose chance is known: so it is exact if nothing is uniform.

Reliability of redundant channels in the terms of geodesy (Baarda, A testing procedure for use in geodetic networks, 1968).

With A the rows of a sample's channels, P their weights and G = (A^T P A)^-1 A^T P, a reading's *redundancy number* is r_j = 1 - (A G)_jj:
the part of an error of it that shows in its own residual; their sum is the number of redundant channels. Let W be the weight of the
contradictions (`redundancy`, with common errors of the readings in their covariance). The error of channel j alone is determined with the
variance 1/W_jj, so the smallest fault that a test of significance alpha finds with a power is

    m_j = (z(1 - alpha/2) + z(power)) / sqrt(W_jj)

(*internal reliability*), and one that is just not found moves the pose by G_j m_j (*external reliability*). The statistics of two channels
correlate by rho = W_jk / sqrt(W_jj W_kk): near 1 a fault of either looks like one of the other (Foerstner 1983). Without channel k that of
j weighs W_jj (1 - rho^2), by the Schur complement: so a fault of m_j / sqrt(1 - rho^2) is found even if k is omitted, and distinguished
from one of k. The smallest that is distinguished from every other is that of the largest rho.

Without a redundant cable, returns and reversals show faults of least sizes (`detectable_sizes`). With the limit c from which two visits of
a position do not agree, lost counts show from c, a point that moved along its cable from c, and in any direction from c sqrt(k) / s, with s
the least singular value of the directions of the cable at k positions. A warmer rig shows in two cables at least, from c / (a L) kelvin, a
the expansion of steel and L the second longest cable.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import lgamma
from statistics import NormalDist
from typing import Any

import numpy as np
import scipy
from numpy.typing import NDArray

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels import AXIAL, CABLE, KIND, TANGENT, platform_size, span_lengths, span_rows_of
from lmeasure.rig import STEEL_PER_K, Rig
from lmeasure.sensors import Lengths, changes_from_counts
from lmeasure.text import Message, message
from lmeasure.trajectory.uncertainty.budget import Budget
from lmeasure.trajectory.uncertainty.sources import Situation

DIRECTIONS = 256
ARGUMENTS = 120.0 * np.linspace(0.0, 1.0, 401)[1:] ** 2
LAMBDAS = np.concatenate([np.linspace(0.02, 0.5, 40)[:-1], np.geomspace(0.5, 10.0, 40)])
CUT = 1e-10  # Of the integrand's largest value, at the last argument: beyond it the integral is not all there
LEAST = -80.0  # Smallest log probability that is computed


@dataclass(frozen=True)
class ChanceOfContradiction:
    """Values of chi-squared (k,), rising, and the logarithms (k,) of the chance that sound readings contradict each other by more."""

    chi_squared: FloatArray
    log_chance: FloatArray

    def above(self, chi_squared: FloatArray) -> FloatArray:
        """(...) chance of more than chi_squared (...)."""
        # beyond the table as it falls at its end
        slope = (self.log_chance[-1] - self.log_chance[-2]) / (self.chi_squared[-1] - self.chi_squared[-2])
        beyond = np.maximum(chi_squared - self.chi_squared[-1], 0.0)
        return np.exp(np.interp(chi_squared, self.chi_squared, self.log_chance) + slope * beyond)

    def limit(self, chance: float) -> float:
        """Chi-squared that sound readings exceed with this chance."""
        return float(np.interp(-np.log(chance), -self.log_chance, self.chi_squared))


def chance_of(uniform: FloatArray, normal: FloatArray) -> ChanceOfContradiction:
    """Return the chance at p places of a run together, each as likely as the others: U (p, d, k) and V (p, d, l) of their parities."""
    each = [_of_one(U, V) for U, V in zip(uniform, normal, strict=True)]
    grid = np.linspace(0.0, max(q[-1] for q, _ in each), 400)
    chances = np.array([np.exp(np.interp(grid, np.append(0.0, q), np.append(0.0, p))) * (grid <= q[-1]) for q, p in each])
    mean = chances.mean(axis=0)
    determined = mean > np.exp(LEAST)
    return ChanceOfContradiction(grid[determined], np.log(mean[determined]))


def _of_one(U: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values of chi-squared, rising, and the logarithms of the chance of more."""
    d, t = len(U), ARGUMENTS
    theta = _directions(d)
    exponent = 0.5 * ((theta @ V) ** 2).sum(axis=1)[:, None] * t**2
    for along in np.abs(theta @ U).T:
        exponent += _log_sinhc(np.sqrt(3.0) * along[:, None] * t)
    most = exponent.max(axis=0)
    log_B = most + np.log(np.exp(exponent - most).mean(axis=0))
    integrand = log_B + (d - 1) * np.log(t) + np.log(np.gradient(t)) - t**2 / (4.0 * LAMBDAS[:, None])
    most = integrand.max(axis=1, keepdims=True)
    weight = np.exp(integrand - most)
    total = weight.sum(axis=1)
    square = (weight * t**2).sum(axis=1) / total
    spread = (weight * (t**2 - square[:, None]) ** 2).sum(axis=1) / total
    K = most[:, 0] + np.log(total) + (1.0 - d / 2.0) * np.log(2.0) - lgamma(d / 2.0) - d / 2.0 * np.log(2.0 * LAMBDAS)
    first = square / (4.0 * LAMBDAS**2) - d / (2.0 * LAMBDAS)
    second = spread / (16.0 * LAMBDAS**4) - square / (2.0 * LAMBDAS**3) + d / (2.0 * LAMBDAS**2)
    # from above the mean, up to where the integral is cut off, or a bound of chi-squared leaves nothing but rounding of its spread
    above = first > 1.5 * d
    good = above & (weight[:, -1] < CUT) & (second > 1e-6) & (LAMBDAS * first > K)
    good &= np.cumsum(above & ~good) == 0
    q, lam = first[good], LAMBDAS[good]
    like = (1.0 - d / q) / 2.0
    normal = _tail(like, q, -d / 2.0 * np.log(1.0 - 2.0 * like), 2.0 * d / (1.0 - 2.0 * like) ** 2)
    log_chance = scipy.stats.chi2.logsf(q, d) + _tail(lam, q, K[good], second[good]) - normal
    kept = log_chance > LEAST
    q, log_chance = q[kept], np.minimum.accumulate(log_chance[kept])
    # beyond the table: the farthest point of a convex body, with all uniforms at their ends, is the largest support; the rest is normal
    end = float(np.max(np.sqrt(3.0) * np.abs(theta @ U).sum(axis=1)))
    beyond = np.linspace(0.0, 12.0, 49)
    far = (end + beyond * max(float(np.linalg.norm(V, 2)) if V.size else 0.0, 1e-3)) ** 2
    left = np.minimum(scipy.stats.chi2.logsf(beyond**2, d), log_chance[-1])
    return np.append(q, far[far > q[-1]]), np.append(log_chance, left[far > q[-1]])


def _tail(lam: FloatArray, q: FloatArray, K: FloatArray, second: FloatArray) -> FloatArray:
    """Logarithm of the chance of more than q by K and its second derivative at lambda, where its first is q."""
    w, u = np.sqrt(2.0 * (lam * q - K)), lam * np.sqrt(second)
    return np.asarray(scipy.special.log_ndtr(-(w + np.log(u / w) / w)))


def _directions(d: int) -> FloatArray:
    """(n, d) spread evenly over the sphere."""
    if d == 1:
        return np.ones((1, 1))
    z = scipy.special.ndtri(np.clip(scipy.stats.qmc.Sobol(d, seed=0).random(DIRECTIONS), 1e-12, 1.0 - 1e-12))
    return np.asarray(z / np.linalg.norm(z, axis=1, keepdims=True))


def _log_sinhc(s: FloatArray) -> FloatArray:
    """log(sinh(s)/s) of s >= 0."""
    large = np.maximum(s, 1e-3)
    return np.where(s < 1e-3, s * s / 6.0, large + np.log1p(-np.exp(-2.0 * large)) - np.log(2.0 * large))


CHUNK = 2048  # samples whose systematic errors are in memory at once
TURN = 2.0 * np.pi
PLACES = 4  # Samples of a run, spread over it, at which the chance of contradictions is worked out
UNCONTROLLED = 1e-6  # Of a cable's variance that the others must be able to show


@dataclass(frozen=True)
class Epochs:
    """Samples of a run: time_s (n,), change_mm (n, m) of the cables, NaN for unused ones, gone_on_mm (n, m) the same with unused ones,
    counts and speeds (n, m), own variance of the lengths (n, m) [mm^2], temperatures and last travel (n, m) or None."""

    time_s: FloatArray
    change_mm: FloatArray
    gone_on_mm: FloatArray
    counts: FloatArray
    speed_mm_s: FloatArray
    variance_mm2: FloatArray
    temperature_c: FloatArray | None
    travel: FloatArray | None

    def __len__(self) -> int:
        return len(self.time_s)

    def at(self, index: NDArray[np.intp] | BoolArray | slice) -> "Epochs":
        """Some of them."""
        some: dict[str, Any] = {name: None if values is None else values[index] for name, values in vars(self).items()}
        return Epochs(**some)

    def excluding(self, cables: list[int]) -> "Epochs":
        """Return the same, nothing of these cables used."""
        change = self.change_mm.copy()
        change[:, cables] = np.nan
        return replace(self, change_mm=change)

    def situation(self, poses: FloatArray) -> Situation:
        """Return the conditions on which errors of the lengths depend, at poses (n, 7)."""
        return Situation(self.time_s, poses, self.counts, self.speed_mm_s, self.temperature_c, self.travel)


@dataclass(frozen=True)
class Parities:
    """residual_mm (n, m), zero for cables that are not used; used (n, m); weight (n, m, m), W; freedom (n,)."""

    residual_mm: FloatArray
    used: BoolArray
    weight: FloatArray
    freedom: IntArray

    @property
    def chi_squared(self) -> FloatArray:
        """(n,) of the contradictions."""
        return np.asarray(np.einsum("nj,njk,nk->n", self.residual_mm, self.weight, self.residual_mm))

    @property
    def errors(self) -> tuple[FloatArray, FloatArray]:
        """(n, m) each: the error [mm] that a cable alone would have, and its standard uncertainty, infinite where nothing controls it."""
        diagonal = np.einsum("njj->nj", self.weight)
        controlled = self.used & (diagonal > 0.0)
        weighed = np.einsum("njk,nk->nj", self.weight, self.residual_mm)
        known = np.where(controlled, diagonal, 1.0)
        return np.where(controlled, weighed / known, 0.0), np.where(controlled, 1.0 / np.sqrt(known), np.inf)


class Redundancy:
    """Tests of the lengths of one run against each other."""

    def __init__(self, budget: Budget) -> None:
        self.budget, self._rows, begun = budget, budget.scheme.rows, budget.model.begun
        self.free, self._size = budget.scheme.free_index, platform_size(budget.scheme.rows)
        at_start = span_lengths(self._rows, budget.model.zero_pose[None])[0]
        self.zero = np.where(budget.absolute, 0.0, at_start - (0.0 if begun is None else begun))
        """(m,) part of a span, or of an angle, that a channel's readings do not show."""
        angles = self._rows[:, KIND] > CABLE
        # unit of comparison: lengths unchanged, angles as lengths of about the same scatter
        self.unit = np.where(angles, np.sqrt(budget.variance / budget.variance[~angles].min()), 1.0)

    def epochs(self, lengths: Lengths, travel: FloatArray | None) -> Epochs:
        """A piece of the run; its changes may be set to NaN. travel (n, m) as `Budget.travel` gives it."""
        budget, used = self.budget, np.isfinite(lengths.change_mm)
        gone_on = lengths.counts if lengths.gone_on is None else lengths.gone_on
        speed = budget.speed_mm_s(lengths)
        shown = changes_from_counts(budget.rig, gone_on, budget.rig.observed) - budget.offsets(lengths.time_s)
        gone_on_mm = np.where(used, lengths.change_mm, shown)
        variance = np.broadcast_to(budget.variance + (0.0 if lengths.u_mm is None else lengths.u_mm**2), speed.shape)
        warm = lengths.temperature_c
        return Epochs(lengths.time_s, lengths.change_mm.copy(), gone_on_mm, gone_on, speed, variance, warm, travel)

    def residuals(self, poses: FloatArray, change_mm: FloatArray) -> FloatArray:
        """(n, m) [mm, rad] of changes (n, m) at poses (n, 7)."""
        residual = change_mm - (span_lengths(self._rows, np.ascontiguousarray(poses)) - self.zero)
        angles = self._rows[:, KIND] > CABLE
        residual[:, angles] -= TURN * np.round(residual[:, angles] / TURN)
        return np.asarray(residual)

    def parities(self, epochs: Epochs, poses: FloatArray, used: BoolArray | None = None) -> Parities:
        """Return the redundancy of epochs at poses (n, 7) near the true ones, by the cables used (n, m), those that have a change by
        default; where there is no pose nothing is known and no degree of freedom."""
        n, m = epochs.change_mm.shape
        used = np.isfinite(epochs.change_mm) if used is None else used
        used = used & np.isfinite(poses[:, :1])
        residual, weight = np.zeros((n, m)), np.zeros((n, m, m))
        for begin in range(0, n, CHUNK):
            part = slice(begin, begin + CHUNK)
            there = np.isfinite(poses[part, 0])
            at = epochs.at(part)
            placed = np.where(there[:, None], poses[part], self.budget.model.zero_pose)
            mine = used[part]
            residual[part] = np.where(mine, self.residuals(placed, at.gone_on_mm), 0.0)
            basis, shared = self.basis(placed, mine), self.shared(at, placed, mine)
            within = np.swapaxes(basis, 1, 2) @ self._covariance(at, shared, mine) @ basis
            weight[part] = basis @ np.linalg.solve(within, np.swapaxes(basis, 1, 2)) / np.outer(self.unit, self.unit)
        both = used[:, :, None] & used[:, None, :]
        weight = np.where(both, weight, 0.0)
        # rounding alone, where as many cables are left as there are unknowns
        diagonal = np.einsum("njj->nj", weight)
        uncontrolled = diagonal * epochs.variance_mm2 < UNCONTROLLED
        weight = np.where(uncontrolled[:, :, None] | uncontrolled[:, None, :], 0.0, weight)
        return Parities(residual, used, weight, np.maximum(used.sum(axis=1) - len(self.free), 0))

    def error_of(
        self, j: int, epochs: Epochs, poses: FloatArray, used: BoolArray, *, offsets: FloatArray, apart_from: int
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return (n,) each: the surplus of channel j's reading over that of the others' poses (n, 7) [mm, rad], the part of its uncertainty
        from a sample alone, and the common part without the last variables of the run; NaN if nothing controls it. Readings are too large
        by offsets (n, m) or (1, m)."""
        n, m = epochs.change_mm.shape
        error, own, common = np.full((3, n), np.nan)
        for begin in range(0, n, CHUNK):
            part = np.flatnonzero(np.isfinite(poses[begin : begin + CHUNK, 0]) & used[begin : begin + CHUNK, j]) + begin
            at, mine = epochs.at(part), used[part]
            readings = at.gone_on_mm - np.broadcast_to(offsets, (n, m))[part]
            basis, shared = self.basis(poses[part], mine), self.shared(at, poses[part], mine)
            shared = shared[:, :, : shared.shape[2] - apart_from]
            rounding = np.where(mine, at.variance_mm2 / self.unit**2, 1.0)
            within = np.swapaxes(basis, 1, 2) @ self._covariance(at, shared, mine) @ basis
            weight = basis @ np.linalg.solve(within, np.swapaxes(basis, 1, 2))
            row, diagonal = weight[:, j], weight[:, j, j]
            known = mine[:, j] & (diagonal * rounding[:, j] >= UNCONTROLLED)
            diagonal = np.where(known, diagonal, np.nan)
            residual = np.where(mine, self.residuals(poses[part], readings), 0.0) / self.unit
            error[part] = np.einsum("nm,nm->n", row, residual) / diagonal * self.unit[j]
            own[part] = np.sqrt((row**2 * rounding * mine).sum(axis=1)) / diagonal * self.unit[j]
            common[part] = np.sqrt((np.einsum("nm,nmk->nk", row, shared) ** 2).sum(axis=1)) / diagonal * self.unit[j]
        return error, own, common

    def weighed(self, basis: FloatArray, residual: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, m) residuals and (n, m, m) their weights by variances (n, m) of their own, in the units of the basis (n, m, r)."""
        own = basis * (variance / self.unit**2)[:, :, None]
        within = np.swapaxes(basis, 1, 2) @ own
        return residual / self.unit, np.asarray(basis @ np.linalg.solve(within, np.swapaxes(basis, 1, 2)))

    def basis(self, poses: FloatArray, used: BoolArray) -> FloatArray:
        """(n, m, m - f) orthonormal basis of errors of the readings, in units of about the same scatter, that no motion makes; of a cable
        that is not used the unit vector is in it."""
        rows = span_rows_of(self._rows, np.ascontiguousarray(poses))
        rows[:, :, :3] /= self._size
        rows /= self.unit[:, None]
        scaled = np.where(used[:, :, None], rows[:, :, self.free], 0.0)
        return np.asarray(np.linalg.qr(scaled, mode="complete")[0][:, :, len(self.free) :])

    def shared(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> FloatArray:
        """(n, m, K) errors of the readings, as `basis` has them, that the whole run has in common, by variables of unit variance."""
        lengths = self.budget.lengths_of(epochs.situation(poses), self.budget.every)
        return np.where(used[:, :, None] & np.isfinite(lengths), lengths, 0.0) / self.unit[:, None]

    def _covariance(self, epochs: Epochs, shared: FloatArray, used: BoolArray) -> FloatArray:
        own = np.where(used, epochs.variance_mm2 / self.unit**2, 1.0)
        return np.asarray(shared @ np.swapaxes(shared, 1, 2) + own[:, :, None] * np.eye(own.shape[1]))

    def chance(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> ChanceOfContradiction:
        """Return the chance of contradictions of the channels used (m,) where nothing is wrong, at any of n epochs at poses (n, 7)."""
        some = np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), PLACES)).round().astype(np.intp))
        epochs, poses = epochs.at(some), poses[some]
        every = np.broadcast_to(used, (len(some), len(used)))
        towards = np.swapaxes(_without_unused(self.basis(poses, every), every), 1, 2)
        rounding = np.minimum(epochs.variance_mm2, self.budget.variance)
        own = [np.sqrt(np.where(used, v, 0.0))[:, None, :] / self.unit for v in (rounding, epochs.variance_mm2 - rounding)]
        shared, uniform = towards @ self.shared(epochs, poses, every), np.array(self.budget.uniform, dtype=np.bool_)
        U = np.concatenate([towards * own[0], shared[:, :, uniform]], axis=2)
        V = np.concatenate([towards * own[1], shared[:, :, ~uniform]], axis=2)
        root = np.linalg.cholesky(U @ np.swapaxes(U, 1, 2) + V @ np.swapaxes(V, 1, 2))
        return chance_of(np.linalg.solve(root, U), np.linalg.solve(root, V))

    def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
        """Return chi-squared of all epochs together, with one draw of systematic errors and of the rounding of an unchanged count, each
        epoch's own (n,), and the degrees of freedom of an epoch; all use the same cables."""
        basis = _without_unused(self.basis(poses, used), used)
        residual = np.where(used, self.residuals(poses, epochs.gone_on_mm), 0.0) / self.unit
        parity = np.einsum("njr,nj->nr", basis, residual)
        shared = np.swapaxes(basis, 1, 2) @ self.shared(epochs, poses, used)
        variance = np.where(used, epochs.variance_mm2 / self.unit**2, 0.0)
        own, lasting = (np.swapaxes(basis, 1, 2) @ (v[:, :, None] * basis) for v in (variance, variance * repeats(epochs.gone_on_mm)))
        n, r = parity.shape
        each = shared @ np.swapaxes(shared, 1, 2) + own
        alone = np.einsum("nr,nr->n", parity, np.linalg.solve(each, parity[:, :, None])[:, :, 0])
        flat = shared.reshape(n * r, shared.shape[2])
        covariance = flat @ flat.T
        for i in range(n):
            covariance[i * r : (i + 1) * r, i * r : (i + 1) * r] += lasting[i]
        return float(parity.ravel() @ np.linalg.solve(covariance, parity.ravel())), np.asarray(alone), r


def repeats(readings: FloatArray) -> FloatArray:
    """(n, m) how many samples on end show the reading of each sample of (n, m)."""
    out = np.ones(readings.shape)
    for column, counted in zip(readings.T, out.T, strict=True):
        ends = np.flatnonzero(np.append(column[1:] != column[:-1], True))
        length = np.diff(ends, prepend=-1)
        counted[:] = np.repeat(length, length)
    return out


def _without_unused(basis: FloatArray, used: BoolArray) -> FloatArray:
    """The part of bases (n, m, m - f) without the unit vectors of cables that are not used, the same at all n."""
    unused = np.flatnonzero(~used[0])
    if not len(unused):
        return basis
    kept = basis.shape[2] - len(unused)
    # complement, within the basis, of its rows of the unused cables
    rows = np.swapaxes(basis[:, unused, :], 1, 2)
    turned = np.linalg.qr(rows, mode="complete")[0][:, :, len(unused) :]
    return np.asarray(basis @ turned)[:, :, :kept]


ALPHA, POWER = 1e-3, 0.8  # Baarda's: of a single sample and channel
SHIFT = NormalDist().inv_cdf(POWER) - NormalDist().inv_cdf(ALPHA / 2.0)  # Standard uncertainties of the smallest fault that is found: 4.13
RELIABILITY_PLACES = 64  # Samples of a run, spread over it, at which it is worked out
APART = 1e-9  # Of 1 - rho^2 from which two channels are not one
LEAST_WEIGHT = 1e-9  # Of a channel's own weight that must be left of it


@dataclass(frozen=True)
class Faults:
    """smallest, apart (n, m): smallest fault of a channel that is found, and that is distinguished from one of any other, infinite where
    there is none; correlation (n, m, m) of the channels' tests, NaN where one is not controlled."""

    smallest: FloatArray
    apart: FloatArray
    correlation: FloatArray


def faults_shown(weight: FloatArray, controlled: BoolArray | None = None) -> Faults:
    """Return detectable faults from the weights W (n, m, m) of contradictions; controlled (n, m): channels that the others control. None:
    those with more than a rounded weight, in units in which readings scatter by about 1."""
    diagonal = np.einsum("njj->nj", weight)
    controlled = diagonal > LEAST_WEIGHT if controlled is None else controlled
    root = np.sqrt(np.where(controlled, diagonal, np.nan))
    smallest = np.where(controlled, SHIFT / np.where(controlled, root, 1.0), np.inf)
    correlation = weight / (root[:, :, None] * root[:, None, :])
    others = np.nan_to_num(correlation**2) * (1.0 - np.eye(weight.shape[1]))
    left = 1.0 - others.max(axis=2)
    return Faults(smallest, np.where(left > APART, smallest / np.sqrt(np.maximum(left, APART)), np.inf), correlation)


@dataclass(frozen=True)
class Reliability:
    """At n samples of m channels: redundancy number (n, m); smallest fault that is found (n, m) [mm, rad], and that is distinguished from
    one of any other channel, infinite if nothing controls a channel; effect (n, m) on the tool's position [mm] of one that is just not
    found; correlation (n, m, m) of the channels' tests, NaN for a channel without control. NaN for unused channels."""

    time_s: FloatArray
    redundancy: FloatArray
    smallest: FloatArray
    apart: FloatArray
    effect_mm: FloatArray
    correlation: FloatArray


def reliability(redundancy: Redundancy, epochs: Epochs, poses: FloatArray) -> Reliability:
    """Return the reliability of epochs at poses (n, 7), NaN where there is none."""
    budget, known = redundancy.budget, np.isfinite(poses[:, 0])
    epochs, poses = epochs.at(known), np.ascontiguousarray(poses[known])
    used = np.isfinite(epochs.change_mm)
    weight = redundancy.parities(epochs, poses).weight
    G = budget.twists(poses, np.where(used, epochs.counts, np.nan), ~used, True)
    rows = span_rows_of(budget.scheme.rows, poses)
    diagonal = np.einsum("njj->nj", weight)
    controlled = used & (diagonal > 0.0)
    shown = faults_shown(weight, controlled)
    smallest, apart = (np.where(used, values, np.nan) for values in (shown.smallest, shown.apart))
    number = np.where(used, 1.0 - np.einsum("njc,ncj->nj", rows, G), np.nan)
    with np.errstate(invalid="ignore"):
        effect = np.linalg.norm(G[:, 3:], axis=1) * smallest
    return Reliability(epochs.time_s, number, smallest, apart, effect, shown.correlation)


def places_of_reliability(epochs: Epochs) -> Epochs:
    """Return the samples of a run at which its reliability is computed."""
    return epochs.at(np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), RELIABILITY_PLACES)).round().astype(np.intp)))


def reliability_notes(rig: Rig, found: Reliability) -> tuple[Message, ...]:
    """Return the least redundancy number with the largest fault that is not found, and the smallest faults that are distinguished; nothing
    where no pose is known."""
    return (_largest_fault(rig, found), _smallest_faults(rig, found)) if len(found.time_s) else ()


def _largest_fault(rig: Rig, found: Reliability) -> Message:
    """Return one line with the least redundancy number, the largest undetected fault, its effect on the tool, and the two channels that are
    hardest to distinguish."""
    observed = rig.observed
    names = [o.name for o in observed]
    number = np.where(np.isnan(found.redundancy), np.inf, found.redundancy)
    least = int(np.argmin(number.min(axis=0)))
    effect = np.where(np.isnan(found.effect_mm), -np.inf, found.effect_mm)
    i, j = (int(k) for k in np.unravel_index(int(np.argmax(effect)), effect.shape))
    size = float(found.smallest[i, j])
    about = {
        "alpha": 100.0 * ALPHA,
        "power": 100.0 * POWER,
        "number": max(float(number.min()), 0.0),
        "least": names[least],
        "channel": names[j],
        "s": float(found.time_s[i]),
        "effect_mm": float(effect[i, j]),
    }
    if not np.isfinite(size):
        return message("reliability.uncontrolled", channel=names[j], s=float(found.time_s[i]))
    worst = np.nan_to_num(np.abs(found.correlation)).max(axis=0)
    np.fill_diagonal(worst, 0.0)
    a, b = (int(k) for k in np.unravel_index(int(np.argmax(worst)), worst.shape))
    pair = {"one": names[min(a, b)], "other": names[max(a, b)], "correlation": float(worst[a, b])}
    sized = {"mm": size} if observed[j].is_length else {"deg": float(np.degrees(size))}
    return message(f"reliability.{'length' if observed[j].is_length else 'angle'}", **about, **pair, **sized)


def _smallest_faults(rig: Rig, found: Reliability) -> Message:
    """Return one line with the smallest fault of every channel that a sample distinguishes from one of any other, at the best and the worst
    of them."""
    determined = []
    for o, sizes in zip(rig.observed, found.apart.T, strict=True):
        seen = sizes[~np.isnan(sizes)]
        if not np.isfinite(seen).any():
            determined.append(message("reliability.apart.never", channel=o.name))
            continue
        kind, unit, per = ("length", "mm", 1.0) if o.is_length else ("angle", "deg", float(np.degrees(1.0)))
        size = {f"least_{unit}": float(seen.min()) * per}
        if np.isfinite(seen).all():
            size[f"most_{unit}"] = float(seen.max()) * per
        determined.append(message(f"reliability.apart.{kind}{'' if np.isfinite(seen).all() else '.partly'}", channel=o.name, **size))
    return message("reliability.apart", alpha=100.0 * ALPHA, power=100.0 * POWER, channels=tuple(determined))


FLAT = 0.05  # Least singular value of the directions at several positions from which they show a point that moved in any direction

CLOSED_COUNTS = 3.0
CLOSED_MM = 0.1
CLOSED_SCATTERS = 5.0  # Limits of the difference of two visits, below which counts close; the second one allows for drift of robots
ALONE = 8.0  # Times as much as the other channels together (root mean square): a robot that steps moves several cables
REPEATS_MM = 0.02  # Repeatability of a robot for which returns are planned, as lengths of cables
SIX = 6
RETURNS = 3  # Positions that are proposed


@dataclass(frozen=True)
class DetectableSizes:
    """Least sizes that a run shows, infinite where it shows none. positions: visited again; lost_mm: of lost counts of a channel;
    along_mm, moved_mm: of a point that moved along its cable, or in any direction; late_s: of a channel against the others."""

    positions: int = 0
    lost_mm: float = np.inf
    along_mm: float = np.inf
    moved_mm: float = np.inf
    warmer_k: float = np.inf
    late_s: float = np.inf

    @property
    def lines(self) -> list[Message]:
        """Return lines with the sizes, and the undetectable faults."""
        shown = self.sizes
        lines = [message("detectable.sizes", positions=self.positions, sizes=shown)] if shown else []
        if not np.isfinite(self.lost_mm):
            lines.append(message("detectable.no_return"))
        elif not np.isfinite(self.moved_mm):
            lines.append(message("detectable.few_returns"))
        return lines if np.isfinite(self.late_s) else [*lines, message("detectable.no_reversal")]

    @property
    def sizes(self) -> tuple[Message, ...]:
        """Return the sizes of the faults that show."""
        lengths = {"lost": self.lost_mm, "along": self.along_mm, "moved": self.moved_mm}
        sizes = [(kind, "mm", mm) for kind, mm in lengths.items()]
        sizes += [("warmer", "kelvin", self.warmer_k), ("late", "ms", 1e3 * self.late_s)]
        return tuple(message(f"detectable.{kind}", **{unit: size}) for kind, unit, size in sizes if np.isfinite(size))


def detectable_sizes(
    lost_mm: FloatArray, return_mm: FloatArray, directions: FloatArray, lengths_mm: FloatArray, *, late_s: float = np.inf
) -> DetectableSizes:
    """Return the least sizes by the limits (m,) of all visits and of two, and by unit directions (k, m, 3) of the cables and their free
    lengths (k, m) at the positions that are visited again."""
    if not len(directions):
        return DetectableSizes(late_s=late_s)
    k, m = directions.shape[:2]
    least = np.array([np.linalg.svd(directions[:, j], compute_uv=False)[-1] if k >= 3 else 0.0 for j in range(m)])
    moved = return_mm * np.sqrt(k) / least if (least > FLAT).all() else np.array([np.inf])
    second = np.sort(return_mm / (STEEL_PER_K * lengths_mm.max(axis=0)))[1] if m > 1 else np.inf
    return DetectableSizes(k, float(lost_mm.max()), float(return_mm.max()), float(moved.max()), float(second), late_s)


def proposed_returns(rig: Rig, poses: FloatArray, names: Sequence[str], speed_mm_s: float | None = None) -> list[Message]:
    """Return a line that proposes some of (n, 7) poses to visit again at the end, and a path forth and back at a speed, with the faults
    that these detect. No line unless the rig has six cables (redundant channels detect more), or with fewer than three poses.

    The first pose shows lost counts. The others add most to the directions of the cable that detects a moved point worst.
    """
    rows = rig.cable_rows()
    if len(rows) != SIX or rig.sensors or len(poses) < RETURNS:
        return []
    every = span_rows_of(rows, np.ascontiguousarray(poses))[:, :, 3:]
    chosen = [0]
    while len(chosen) < RETURNS:
        others = [i for i in range(len(poses)) if i not in chosen]
        seen = [np.linalg.svd(np.swapaxes(every[[*chosen, i]], 0, 1), compute_uv=False)[:, len(chosen)].min() for i in others]
        chosen.append(others[int(np.argmax(seen))])
    count_mm = np.array([(drum := rig.point(c.from_point).drum).count_length_mm / abs(drum.scale) for c in rig.cable])
    limit = np.maximum(np.maximum(CLOSED_COUNTS * count_mm, CLOSED_MM), ALONE * REPEATS_MM)
    lengths = span_lengths(rows, np.ascontiguousarray(poses[chosen])) + np.hypot(rows[:, TANGENT], rows[:, AXIAL])
    # a cable runs with the root of a third of the tool's speed, over all directions
    late_s = np.inf if speed_mm_s is None else float(limit.max()) * np.sqrt(3.0) / (2.0 * speed_mm_s)
    found = detectable_sizes(limit, limit, every[chosen], lengths, late_s=late_s)
    where = tuple(names[i] for i in sorted(chosen))
    if speed_mm_s is None:
        return [message("detectable.proposed", poses=where, sizes=found.sizes)]
    return [message("detectable.proposed_path", poses=where, speed=speed_mm_s, sizes=found.sizes)]
