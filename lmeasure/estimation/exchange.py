"""Which measurements to make: chosen by exchange (Fedorov 1972; Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, chapters 10
to 12).

A sweep takes one measurement out of a design, tries every candidate in its place by an update of the rank of its residuals, and keeps the
best; what all of them hang on, if anything, is tried in full. When no exchange helps, candidates beside each are tried. Everything is
deterministic for a seed.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Generic, Protocol, Self, TypeVar

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray

CRITERIA = {
    "I": "the mean variance of what is predicted",
    "G": "the largest variance of what is predicted",
    "D": "the determinant of the parameters' covariance",
}

SWEEPS = 20
WORTH = 1e-4  # relative fall of a variance that is worth an exchange


class Criterion:
    """A number to minimise, from an information matrix M (q, q) with its prior: mean or largest variance of targets, or the logarithm of
    the determinant of the parameters' covariance.

    targets (t, p) are derivatives of what is to be predicted by the parameters, in the units of M; shared errors stand in M behind these.
    """

    def __init__(self, kind: str, targets: FloatArray) -> None:
        self.kind, self._targets, self._p = kind, targets, targets.shape[1]

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
        spread = blocks @ S
        gram = np.eye(blocks.shape[1]) + spread @ blocks.transpose(0, 2, 1)
        if self.kind == "D":
            base = self._shared(M) - float(np.linalg.slogdet(M)[1])
            own = blocks[:, :, self._p :]
            if own.shape[2]:
                shared = np.eye(blocks.shape[1]) + own @ np.linalg.solve(M[self._p :, self._p :], own.transpose(0, 2, 1))
                return np.asarray(base - np.linalg.slogdet(gram)[1] + np.linalg.slogdet(shared)[1])
            return np.asarray(base - np.linalg.slogdet(gram)[1])
        # the variance of target b falls by |L^-1 A S b|^2, L L^T the gram matrix
        seen = np.linalg.solve(np.linalg.cholesky(gram), spread[:, :, : self._p])
        if self.kind == "I":
            fall = seen @ (self._targets.T @ self._targets / len(self._targets))
            return np.asarray(self.value(M) - np.sum(fall * seen, axis=(1, 2)))
        before = self._variances(S[: self._p, : self._p])
        return np.asarray((before - np.sum((seen @ self._targets.T) ** 2, axis=1)).max(axis=1))

    def better(self, new: float, old: float) -> bool:
        """Whether a value is worth an exchange."""
        return new < old - WORTH if self.kind == "D" else new < old * (1.0 - WORTH)

    def _variances(self, covariance: FloatArray) -> FloatArray:
        """(t,) variances of the targets."""
        return np.asarray(np.sum((self._targets @ covariance) * self._targets, axis=1))

    def _shared(self, M: FloatArray) -> float:
        """Part of log det M that belongs to shared errors."""
        own = M[self._p :, self._p :]
        return float(np.linalg.slogdet(own)[1]) if len(own) else 0.0


class Candidates(Protocol):
    """What could be measured, each by its coordinates (d,)."""

    @property
    def pool(self) -> FloatArray:
        """(c, d) candidates."""

    @property
    def told(self) -> FloatArray:
        """(c, m, q) their `blocks`, worked out once."""

    def blocks(self, points: FloatArray) -> FloatArray:
        """(n, m, q) matrices A_c (see `information`) of points (n, d)."""

    def apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        """(n,) True for those of tried (n, d) that repeat none of points (k, d), nor what was measured before."""

    def beside(self, point: FloatArray) -> FloatArray:
        """(n, d) further candidates that differ little from a point (d,)."""

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[Self]:
        """The same with something else that all measurements hang on, besides points (k, d); near: only what differs little."""


@dataclass(frozen=True)
class Numbered:
    """Candidates told apart by their numbers alone; told (c, m, q)."""

    told: FloatArray

    @property
    def pool(self) -> FloatArray:
        """(c, 1) their numbers."""
        return np.arange(len(self.told), dtype=np.float64)[:, None]

    def blocks(self, points: FloatArray) -> FloatArray:
        """(n, m, q) of numbers (n, 1)."""
        return self.told[points[:, 0].astype(np.int64)]

    def apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        """(n,) True for numbers not among points."""
        return np.asarray(~np.isin(tried[:, 0], points[:, 0]))

    def beside(self, point: FloatArray) -> FloatArray:
        """None."""
        return np.zeros((0, len(point)))

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[Self]:
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

    def of(self, candidates: C) -> "Design[C]":
        """The same points of other candidates."""
        return replace(self, candidates=candidates, blocks=candidates.blocks(self.points))


def empty(candidates: C, before: FloatArray) -> Design[C]:
    """A design without points."""
    return Design(candidates, before, candidates.pool[:0], candidates.told[:0])


def grown(design: Design[C], count: int, criterion: Criterion | None, rng: np.random.Generator) -> Design[C]:
    """The design with `count` points more, if there are so many: each the best in turn, or drawn at random without a criterion."""
    space = design.candidates
    for _ in range(count):
        free = np.flatnonzero(space.apart(space.pool, design.points))
        if not len(free):
            break
        best = rng.choice(free) if criterion is None else free[np.argmin(criterion.values(design.information, space.told[free]))]
        i = slice(int(best), int(best) + 1)
        design = replace(
            design, points=np.concatenate([design.points, space.pool[i]]), blocks=np.concatenate([design.blocks, space.told[i]])
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
    """Each point in turn against the pool, or against what lies beside it."""
    space = design.candidates
    for k in range(len(design.points)):
        tried = space.beside(design.points[k]) if near else space.pool
        free = np.flatnonzero(space.apart(tried, np.delete(design.points, k, axis=0)))
        if not len(free):
            continue
        blocks = space.blocks(tried[free]) if near else space.told[free]
        values = criterion.values(design.without(k), blocks)
        i = int(np.argmin(values))
        if criterion.better(float(values[i]), criterion.value(design.information)):
            points, own = design.points.copy(), design.blocks.copy()
            points[k], own[k] = tried[free[i]], blocks[i]
            design = replace(design, points=points, blocks=own)
    return design


def _hung(design: Design[C], criterion: Criterion, near: bool, rng: np.random.Generator) -> Design[C]:
    """What all points hang on against others: all equations are formed anew for each."""
    best, value = design, criterion.value(design.information)
    for other in design.candidates.others(design.points, near, rng):
        moved = design.of(other)
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
        i = left[int(np.argmin(criterion.values(M, design.blocks[left])))]
        M = M + design.blocks[i].T @ design.blocks[i]
        order.append(i)
        left.remove(i)
    return replace(design, points=design.points[order], blocks=design.blocks[order])
