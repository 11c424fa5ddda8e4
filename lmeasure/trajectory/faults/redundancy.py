"""What redundant cables tell of each other at a sample, with everything the lengths share in their covariance.

Let A (m, f) be the rows of the cables by the free components of the twist, r the lengths less those at a pose near the true one, S the
covariance of the lengths: of the counts themselves, and of all that the run has in common (zero phase, calibration, start pose, ...). With
N an orthonormal basis of what no motion reaches, A^T N = 0, the parity vector N^T r has the covariance N^T S N whatever the pose is, and
with

    W = N (N^T S N)^-1 N^T

chi-squared is r^T W r, of m - f degrees of freedom; the error that cable j alone would have to have is (W r)_j / W_jj, of standard
uncertainty 1/sqrt(W_jj): infinite where the others do not control it (Baarda 1968; Teunissen 2006, 4.4).
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.kernels import CABLE, KIND, platform_size, span_lengths, span_rows_of
from lmeasure.sensors import Lengths, changes_from_counts
from lmeasure.trajectory.faults.contradictions import ChanceOfContradiction, chance_of
from lmeasure.trajectory.uncertainty.budget import Budget
from lmeasure.trajectory.uncertainty.sources import Situation

CHUNK = 2048  # samples whose systematic errors are in memory at once
TURN = 2.0 * np.pi
PLACES = 4
"""Samples of a run, spread over it, at which the chance of contradictions is worked out."""
UNCONTROLLED = 1e-6
"""Of a cable's variance that the others must be able to show."""


@dataclass(frozen=True)
class Epochs:
    """Samples of a run: time_s (n,), change_mm (n, m) of the cables, NaN where they are not used, gone_on_mm (n, m) the same of whatever
    they showed, counts and speeds (n, m), own variance of the lengths (n, m) [mm^2], temperatures and last travel (n, m) or None."""

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

        def some(values: FloatArray | None) -> FloatArray | None:
            return None if values is None else values[index]

        values = self.time_s, self.change_mm, self.gone_on_mm, self.counts, self.speed_mm_s, self.variance_mm2
        time_s, change, gone_on, counts, speed, variance = (v[index] for v in values)
        return Epochs(time_s, change, gone_on, counts, speed, variance, some(self.temperature_c), some(self.travel))

    def without(self, cables: list[int]) -> "Epochs":
        """The same, nothing of these cables used."""
        change = self.change_mm.copy()
        change[:, cables] = np.nan
        return replace(self, change_mm=change)

    def situation(self, poses: FloatArray) -> Situation:
        """What errors of their lengths depend on, at poses (n, 7)."""
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

    def __init__(self, budget: Budget, begun: FloatArray | None = None) -> None:
        self._budget, self._rows = budget, budget.scheme.rows
        self.free, self._size = budget.scheme.free_index, platform_size(budget.scheme.rows)
        at_start = span_lengths(self._rows, budget.scheme.start_of(budget.start)[None])[0]
        self.zero = np.where(budget.absolute, 0.0, at_start - (0.0 if begun is None else begun))
        """(m,) what of a span, or of an angle, a channel's readings do not show."""
        angles = self._rows[:, KIND] != CABLE
        # of what readings are compared in: lengths as they are, angles as lengths of about the same scatter
        self.unit = np.where(angles, np.sqrt(budget.variance / budget.variance[~angles].min()), 1.0)

    def epochs(self, lengths: Lengths, travel: FloatArray | None) -> Epochs:
        """A piece of the run; its changes may be set to NaN. travel (n, m) as `Budget.travel` gives it."""
        budget, used = self._budget, np.isfinite(lengths.change_mm)
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
        angles = self._rows[:, KIND] != CABLE
        residual[:, angles] -= TURN * np.round(residual[:, angles] / TURN)
        return np.asarray(residual)

    def parities(self, epochs: Epochs, poses: FloatArray, used: BoolArray | None = None) -> Parities:
        """Of epochs at poses (n, 7) near the true ones, by the cables used (n, m), those that have a change by default; where there is no
        pose nothing is known and no degree of freedom."""
        n, m = epochs.change_mm.shape
        used = np.isfinite(epochs.change_mm) if used is None else used
        used = used & np.isfinite(poses[:, :1])
        residual, weight = np.zeros((n, m)), np.zeros((n, m, m))
        for begin in range(0, n, CHUNK):
            part = slice(begin, begin + CHUNK)
            there = np.isfinite(poses[part, 0])
            at = epochs.at(part)
            placed = np.where(there[:, None], poses[part], self._budget.scheme.start_of(self._budget.start))
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
        """(n,) each: what channel j reads too much by the others at poses (n, 7) that these tell [mm, rad], what of its uncertainty is a
        sample's own, and what samples have in common without the last variables of the run; NaN where nothing controls it. Readings are
        too large by offsets (n, m) or (1, m)."""
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
        lengths = self._budget.lengths_of(epochs.situation(poses), self._budget.every)
        return np.where(used[:, :, None] & np.isfinite(lengths), lengths, 0.0) / self.unit[:, None]

    def _covariance(self, epochs: Epochs, shared: FloatArray, used: BoolArray) -> FloatArray:
        own = np.where(used, epochs.variance_mm2 / self.unit**2, 1.0)
        return np.asarray(shared @ np.swapaxes(shared, 1, 2) + own[:, :, None] * np.eye(own.shape[1]))

    def chance(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> ChanceOfContradiction:
        """Of contradictions of the channels used (m,) where nothing is wrong, at any of n epochs at poses (n, 7)."""
        some = np.unique(np.linspace(0, len(epochs) - 1, min(len(epochs), PLACES)).round().astype(np.intp))
        epochs, poses = epochs.at(some), poses[some]
        every = np.broadcast_to(used, (len(some), len(used)))
        towards = np.swapaxes(_without_unused(self.basis(poses, every), every), 1, 2)
        rounding = np.minimum(epochs.variance_mm2, self._budget.variance)
        own = [np.sqrt(np.where(used, v, 0.0))[:, None, :] / self.unit for v in (rounding, epochs.variance_mm2 - rounding)]
        shared, uniform = towards @ self.shared(epochs, poses, every), np.array(self._budget.uniform, dtype=np.bool_)
        U = np.concatenate([towards * own[0], shared[:, :, uniform]], axis=2)
        V = np.concatenate([towards * own[1], shared[:, :, ~uniform]], axis=2)
        root = np.linalg.cholesky(U @ np.swapaxes(U, 1, 2) + V @ np.swapaxes(V, 1, 2))
        return chance_of(np.linalg.solve(root, U), np.linalg.solve(root, V))

    def jointly(self, epochs: Epochs, poses: FloatArray, used: BoolArray) -> tuple[float, FloatArray, int]:
        """Chi-squared of all epochs together, whose systematic errors are one draw, and so is the rounding of a count that stands, each
        epoch's own (n,), and the degrees of freedom of an epoch; the same cables are used at all of them."""
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
    # what is orthogonal, within the basis, to its rows of the unused cables
    rows = np.swapaxes(basis[:, unused, :], 1, 2)
    turned = np.linalg.qr(rows, mode="complete")[0][:, :, len(unused) :]
    return np.asarray(basis @ turned)[:, :, :kept]
