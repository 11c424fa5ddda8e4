"""Choosing poses by exchange (Fedorov 1972; Atkinson, Donev and Tobias, Optimum Experimental Designs, 2007, chapters 10 to 12).

A design is a zero pose and further poses, each in coordinates of the region's unit cube. A sweep takes one pose out, tries every candidate
in its place by an update of rank m (m cables), and keeps the best; the zero pose, on which every equation hangs, is tried in full. When no
exchange helps, single coordinates of each pose are moved. Everything is deterministic for a seed.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.calibration.information import Instrument, Zero
from lmeasure.calibration.reach import Region, Usable

Progress = Callable[[int, int], None]

CRITERIA = {
    "I": "the mean variance of the predicted lengths",
    "G": "the largest variance of the predicted lengths",
    "D": "the determinant of the unknowns' covariance",
}

APART = 0.1
"""Two poses must differ by this part of a coordinate's range: a pose visited twice repeats its rounding, and tells nothing new."""

SWEEPS = 20
ZERO_TRIES = 24
LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
NUDGES = (-0.06, 0.06)
WORTH = 1e-4  # relative fall of a variance that is worth an exchange


class Criterion:
    """A number to minimise, from an information matrix M (q, q) with its prior: mean or largest variance [mm^2] of targets, or the
    logarithm of the determinant of the unknowns' covariance.

    targets (t, p) are derivatives of predicted lengths by the unknowns in prior widths.
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
        """(t,) variances of the targets [mm^2]."""
        return np.asarray(np.sum((self._targets @ covariance) * self._targets, axis=1))

    def _shared(self, M: FloatArray) -> float:
        """Part of log det M that belongs to the zero pose's errors."""
        own = M[self._p :, self._p :]
        return float(np.linalg.slogdet(own)[1]) if len(own) else 0.0


@dataclass(frozen=True)
class Design:
    """A zero pose, the coordinates (k, 6) of the other planned poses and their blocks (k, m, q), and the (q, q) information of what was
    there before, the prior included. free_zero: the zero pose is the plan's to choose, and zero_unit (6,) are its coordinates."""

    zero: Zero
    zero_unit: FloatArray
    free_zero: bool
    units: FloatArray
    blocks: FloatArray
    before: FloatArray

    @property
    def information(self) -> FloatArray:
        """(q, q) information of all poses and the prior."""
        return self.without(None)

    def without(self, k: int | None) -> FloatArray:
        """The same without the k-th planned pose."""
        kept = self.blocks if k is None else np.delete(self.blocks, k, axis=0)
        flat = kept.reshape(-1, len(self.before))
        return np.asarray(self.before + flat.T @ flat)


class Exchange:
    """The search for a design over one region, for one instrument."""

    def __init__(
        self, instrument: Instrument, region: Region, usable: Usable, pool: FloatArray, taken: FloatArray, rng: np.random.Generator
    ) -> None:
        """pool (c, 6): usable candidates; taken (r, 6): poses already recorded, which no planned pose may repeat."""
        self._instrument, self._region, self._usable, self._rng = instrument, region, usable, rng
        self._pool, self._taken = pool, taken

    def begin(self, before: FloatArray, zero: Zero | None) -> Design:
        """No pose yet; without a given zero pose, the candidate nearest to the middle of the region is the first."""
        unit = np.full(6, 0.5)
        if zero is None:
            unit = self._pool[int(np.argmin(np.sum((self._pool - 0.5) ** 2, axis=1)))]
        at = zero or self._instrument.zero(self._region.rows(unit[None, :])[0])
        q = len(before)
        return Design(at, unit, zero is None, np.zeros((0, 6)), np.zeros((0, len(self._instrument.cables), q)), before)

    def grow(self, design: Design, count: int, criterion: Criterion | None) -> Design:
        """The design with `count` poses more, each the best candidate in turn, or drawn at random without a criterion."""
        blocks = self._blocks(self._pool, design)
        for _ in range(count):
            free = np.flatnonzero(self._apart(self._pool, design, None))
            if not len(free):
                break
            i = (
                int(self._rng.choice(free))
                if criterion is None
                else int(free[np.argmin(criterion.values(design.information, blocks[free]))])
            )
            design = replace(
                design, units=np.vstack([design.units, self._pool[i]]), blocks=np.concatenate([design.blocks, blocks[i : i + 1]])
            )
        return design

    def improve(self, design: Design, criterion: Criterion, progress: Callable[[], None] | None = None) -> Design:
        """Exchange with the candidates, and of single coordinates, until nothing is gained."""
        for near in (False, True):
            for _ in range(SWEEPS):
                before = criterion.value(design.information)
                design = self._sweep(design, criterion, near)
                if design.free_zero:
                    design = self._move_zero(design, criterion, near)
                if progress:
                    progress()
                if not criterion.better(criterion.value(design.information), before):
                    break
        return design

    def _sweep(self, design: Design, criterion: Criterion, near: bool) -> Design:
        """Each planned pose in turn against the pool, or against its own neighbours."""
        pool = None if near else self._blocks(self._pool, design)
        for k in range(len(design.units)):
            tried = self._pool if pool is not None else self._neighbours(design.units[k])
            free = np.flatnonzero(self._apart(tried, design, k))
            if not len(free):
                continue
            blocks = pool[free] if pool is not None else self._blocks(tried[free], design)
            values = criterion.values(design.without(k), blocks)
            i = int(np.argmin(values))
            if criterion.better(float(values[i]), criterion.value(design.information)):
                units, own = design.units.copy(), design.blocks.copy()
                units[k], own[k] = tried[free[i]], blocks[i]
                design = replace(design, units=units, blocks=own)
        return design

    def _move_zero(self, design: Design, criterion: Criterion, near: bool) -> Design:
        """The zero pose against some of the pool, or of its neighbours: all equations are formed anew for each."""
        tried = self._neighbours(design.zero_unit) if near else self._pool
        free = tried[self._apart(tried, design, -1)]
        if len(free) > ZERO_TRIES:
            free = free[self._rng.choice(len(free), ZERO_TRIES, replace=False)]
        best, value = design, criterion.value(design.information)
        for unit, row in zip(free, self._region.rows(free), strict=True):
            moved = self.with_zero(design, unit, row)
            now = criterion.value(moved.information)
            if criterion.better(now, value):
                best, value = moved, now
        return best

    def with_zero(self, design: Design, unit: FloatArray, row: FloatArray) -> Design:
        """The design zeroed at another pose (7,) of coordinates unit (6,)."""
        moved = replace(design, zero=self._instrument.zero(row), zero_unit=unit)
        return replace(moved, blocks=self._blocks(design.units, moved))

    def _blocks(self, units: FloatArray, design: Design) -> FloatArray:
        return self._instrument.blocks(self._region.rows(units), design.zero)

    def _apart(self, tried: FloatArray, design: Design, k: int | None) -> BoolArray:
        """(n,) True for coordinates that repeat no pose of the design but the k-th (-1: the zero pose)."""
        others = [self._taken, design.units if k is None or k < 0 else np.delete(design.units, k, axis=0)]
        if design.free_zero and k != -1:
            others.append(design.zero_unit[None, :])
        every = np.vstack(others)
        if not len(every):
            return np.ones(len(tried), dtype=np.bool_)
        gap = np.abs(tried[:, None, :] - every[None, :, :])[:, :, self._region.active]
        return np.asarray((gap.max(axis=2, initial=0.0) >= APART - 1e-12).all(axis=1))

    def _neighbours(self, unit: FloatArray) -> FloatArray:
        """Usable poses with a single coordinate moved to levels of its range and a little to both sides."""
        out = []
        for c in np.flatnonzero(self._region.active):
            for value in (*LEVELS, *(np.clip(unit[c] + NUDGES, 0.0, 1.0))):
                if value != unit[c]:
                    moved = unit.copy()
                    moved[c] = value
                    out.append(moved)
        near = np.array(out).reshape(-1, 6)
        return near[self._usable(self._region.rows(near))]
