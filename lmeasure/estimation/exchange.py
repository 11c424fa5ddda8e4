"""Choice of measurements by exchange (Fedorov 1972; Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, chapters 10 to 12).

A sweep removes one measurement from a design, tries every candidate in its place by an update of the rank of its residuals, and keeps the
best. A common element of all measurements, if any, is tried in full. When no exchange helps, candidates beside each are tried. Everything
is deterministic for a seed.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from lmeasure.core import BoolArray, FloatArray

CRITERIA = {
    "I": "the mean variance of what is predicted",
    "G": "the largest variance of what is predicted",
    "D": "the determinant of the parameters' covariance",
}

SWEEPS = 20
WORTH = 1e-4  # relative fall of a variance that is worth an exchange
WORST = 24  # targets that are looked at first, and blocks at a time


class Criterion:
    """A number to minimise, from an information matrix M (q, q) with its prior: mean or largest variance of targets, or the logarithm of
    the determinant of the parameters' covariance.

    targets (t, p) are derivatives of predictions by the parameters, in the units of M; shared errors follow these in M.
    """

    def __init__(self, kind: str, targets: FloatArray) -> None:
        self.kind, self._targets, self._p = kind, targets, targets.shape[1]
        self._mean = targets.T @ targets / len(targets)

    def value(self, M: FloatArray) -> float:
        """The criterion of one matrix."""
        if self.kind == "D":
            return self._shared(M) - float(np.linalg.slogdet(M)[1])
        S: FloatArray = np.asarray(np.linalg.inv(M), dtype=np.float64)
        variance = self._variances(S[: self._p, : self._p])
        return float(variance.mean() if self.kind == "I" else variance.max())

    def values(self, M: FloatArray, blocks: FloatArray) -> FloatArray:
        """(n,) the criterion of M + A^T A for each block A of (n, m, q)."""
        S: FloatArray = np.asarray(np.linalg.inv(M), dtype=np.float64)
        spread, gram = self._spread(S, blocks)
        if self.kind == "D":
            base = self._shared(M) - float(np.linalg.slogdet(M)[1])
            own = blocks[:, :, self._p :]
            if own.shape[2]:
                shared = np.eye(blocks.shape[1]) + own @ np.linalg.solve(M[self._p :, self._p :], own.transpose(0, 2, 1))
                return np.asarray(base - np.linalg.slogdet(gram)[1] + np.linalg.slogdet(shared)[1])
            return np.asarray(base - np.linalg.slogdet(gram)[1])
        if self.kind == "I":
            fall = _times(spread, self._mean) @ spread.transpose(0, 2, 1)  # m by m: its trace is that of the falls
            return np.asarray(self.value(M) - np.trace(np.linalg.solve(gram, fall), axis1=1, axis2=2))
        return self._largest(self._variances(S[: self._p, : self._p]), spread, gram, self._targets)

    def best(self, M: FloatArray, blocks: FloatArray, free: BoolArray) -> tuple[int, float]:
        """Return the index of the free (n,) block with the least of `values`, and that. For the largest variance, the `WORST` targets bound
        that of all from below: blocks whose bound is above a reached value are skipped."""
        if self.kind != "G" or len(self._targets) <= WORST:
            values = np.where(free, self.values(M, blocks), np.inf)
            return int(np.argmin(values)), float(values.min())
        S: FloatArray = np.asarray(np.linalg.inv(M), dtype=np.float64)
        spread, gram = self._spread(S, blocks)
        before = self._variances(S[: self._p, : self._p])
        worst = np.argsort(before)[-WORST:]
        bound = self._largest(before[worst], spread, gram, self._targets[worst])
        order = np.argsort(np.where(free, bound, np.inf), kind="stable")[: np.count_nonzero(free)]
        found, least = 0, np.inf
        for first in range(0, len(order), WORST):
            some = order[first : first + WORST]
            if bound[some[0]] > least:
                break  # the others are no better
            values = self._largest(before, spread[some], gram[some], self._targets)
            if values.min() < least:
                found, least = int(some[np.argmin(values)]), float(values.min())
        return found, least

    def _spread(self, S: FloatArray, blocks: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(n, m, p) A S, shared errors left out, and (n, m, m) the gram matrices 1 + A S A^T."""
        own = _times(blocks, np.ascontiguousarray(S[:, : self._p]))
        gram = np.eye(blocks.shape[1]) + own @ blocks[:, :, : self._p].transpose(0, 2, 1)
        if len(S) > self._p:
            gram += _times(blocks, np.ascontiguousarray(S[:, self._p :])) @ blocks[:, :, self._p :].transpose(0, 2, 1)
        return own, gram

    @staticmethod
    def _largest(before: FloatArray, spread: FloatArray, gram: FloatArray, targets: FloatArray) -> FloatArray:
        """(n,) the largest variance of targets (t, p) that were before (t,): that of target b falls by |L^-1 A S b|^2, L L^T the gram
        matrix."""
        L, rest = np.linalg.cholesky(gram), _times(spread, targets.T)
        after = np.broadcast_to(before, (len(spread), len(before))).copy()
        seen: list[FloatArray] = []
        for i in range(gram.shape[1]):  # forward substitution, of all blocks together
            own = rest[:, i]
            for j, one in enumerate(seen):
                own = own - L[:, i, j, None] * one
            seen.append(own / L[:, i, i, None])
            after -= seen[-1] ** 2
        return np.asarray(after.max(axis=1))

    def better(self, new: float, old: float) -> bool:
        """Return whether a value is worth an exchange."""
        return new < old - WORTH if self.kind == "D" else new < old * (1.0 - WORTH)

    def _variances(self, covariance: FloatArray) -> FloatArray:
        """(t,) variances of the targets."""
        return np.asarray(np.sum((self._targets @ covariance) * self._targets, axis=1))

    def _shared(self, M: FloatArray) -> float:
        """Part of log det M that belongs to shared errors."""
        own = M[self._p :, self._p :]
        return float(np.linalg.slogdet(own)[1]) if len(own) else 0.0


def _times(blocks: FloatArray, matrix: FloatArray) -> FloatArray:
    """(n, m, r) products of blocks (n, m, q) and one matrix (q, r), as one."""
    n, m, q = blocks.shape
    return np.asarray((blocks.reshape(n * m, q) @ matrix).reshape(n, m, matrix.shape[1]))


class Candidates(Protocol):
    """Candidates for measurement, each by its coordinates (d,)."""

    @property
    def pool(self) -> FloatArray:
        """(c, d) candidates."""

    @property
    def determined(self) -> FloatArray:
        """(c, m, q) their `blocks`, worked out once."""

    def blocks(self, points: FloatArray) -> FloatArray:
        """(n, m, q) matrices A_c (see `information`) of points (n, d)."""

    def apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        """Return (n,) True for those of tried (n, d) that repeat none of points (k, d), and no earlier measurement."""

    def beside(self, points: FloatArray) -> list[FloatArray]:
        """Return, for each of points (k, d), the further candidates (n, d) that differ little from it."""

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[tuple[Self, FloatArray]]:
        """Yield designs with another common element of all measurements, beside points (k, d), and their blocks; near: only small
        differences."""


@dataclass(frozen=True)
class Numbered:
    """Candidates distinguished by their numbers alone; determined (c, m, q)."""

    determined: FloatArray

    @property
    def pool(self) -> FloatArray:
        """(c, 1) their numbers."""
        return np.arange(len(self.determined), dtype=np.float64)[:, None]

    def blocks(self, points: FloatArray) -> FloatArray:
        """(n, m, q) of numbers (n, 1)."""
        return self.determined[points[:, 0].astype(np.int64)]

    def apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        """(n,) True for numbers not among points."""
        return np.asarray(~np.isin(tried[:, 0], points[:, 0]))

    def beside(self, points: FloatArray) -> list[FloatArray]:
        """None."""
        return [points[:0]] * len(points)

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[tuple[Self, FloatArray]]:
        """None."""
        return ()


C = TypeVar("C", bound=Candidates)


@dataclass(frozen=True)
class Design(Generic[C]):
    """Chosen points (k, d) of candidates, their blocks (k, m, q), and the information (q, q) before them, the prior included."""

    candidates: C
    before: FloatArray
    points: FloatArray
    blocks: FloatArray

    @property
    def information(self) -> FloatArray:
        """(q, q) information of all points and the prior."""
        return self.without(None)

    def without(self, k: int | None) -> FloatArray:
        """The same without the k-th point."""
        kept = self.blocks if k is None else np.delete(self.blocks, k, axis=0)
        flat = kept.reshape(-1, len(self.before))
        return np.asarray(self.before + flat.T @ flat)


def empty(candidates: C, before: FloatArray) -> Design[C]:
    """A design without points."""
    return Design(candidates, before, candidates.pool[:0], candidates.determined[:0])


def grown(design: Design[C], count: int, criterion: Criterion | None, rng: np.random.Generator) -> Design[C]:
    """The design with `count` points more, if there are so many: each the best in turn, or drawn at random without a criterion."""
    space = design.candidates
    for _ in range(count):
        free = space.apart(space.pool, design.points)
        if not free.any():
            break
        best = rng.choice(np.flatnonzero(free)) if criterion is None else criterion.best(design.information, space.determined, free)[0]
        i = slice(int(best), int(best) + 1)
        design = replace(
            design, points=np.concatenate([design.points, space.pool[i]]), blocks=np.concatenate([design.blocks, space.determined[i]])
        )
    return design


def improved(design: Design[C], criterion: Criterion, rng: np.random.Generator) -> Design[C]:
    """Exchange with the candidates, then with those beside, until nothing is gained."""
    for near in (False, True):
        for _ in range(SWEEPS):
            before = criterion.value(design.information)
            design = _hung(_swept(design, criterion, near), criterion, near, rng)
            if not criterion.better(criterion.value(design.information), before):
                break
    return design


def _swept(design: Design[C], criterion: Criterion, near: bool) -> Design[C]:
    """Return the design after trying each point in turn against the pool, or against its neighbours."""
    space, value = design.candidates, criterion.value(design.information)
    around = _around(design) if near else [(space.pool, space.determined)] * len(design.points)
    for k, (tried, determined) in enumerate(around):
        free = space.apart(tried, np.delete(design.points, k, axis=0))
        if not free.any():
            continue
        i, now = criterion.best(design.without(k), determined, free)
        if criterion.better(now, value):
            points, own = design.points.copy(), design.blocks.copy()
            points[k], own[k] = tried[i], determined[i]
            design = replace(design, points=points, blocks=own)
            value = criterion.value(design.information)
    return design


def _around(design: Design[C]) -> list[tuple[FloatArray, FloatArray]]:
    """Return the neighbours of each point (n, d), with their blocks (n, m, q)."""
    space = design.candidates
    beside = space.beside(design.points)
    determined = space.blocks(np.concatenate(beside))
    return list(zip(beside, np.split(determined, np.cumsum([len(b) for b in beside[:-1]])), strict=True))


def _hung(design: Design[C], criterion: Criterion, near: bool, rng: np.random.Generator) -> Design[C]:
    """Return the design with the best common element of all points; each choice forms all equations anew."""
    best, value = design, criterion.value(design.information)
    for other, blocks in design.candidates.others(design.points, near, rng):
        moved = replace(design, candidates=other, blocks=blocks)
        now = criterion.value(moved.information)
        if criterion.better(now, value):
            best, value = moved, now
    return best


def ordered(design: Design[C], criterion: Criterion) -> Design[C]:
    """The same points, the one that brings most first, then the next: measuring may stop at any of them."""
    left = list(range(len(design.points)))
    order: list[int] = []
    M = design.before
    while left:
        i = left[criterion.best(M, design.blocks[left], np.ones(len(left), np.bool_))[0]]
        M = M + design.blocks[i].T @ design.blocks[i]
        order.append(i)
        left.remove(i)
    return replace(design, points=design.points[order], blocks=design.blocks[order])
