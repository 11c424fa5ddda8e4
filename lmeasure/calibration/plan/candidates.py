"""Reference poses that may be chosen, in coordinates of the region's unit cube, with the zero pose on which all of them hang."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Self

import numpy as np

from lmeasure.calibration.plan.information import Instrument, Zero
from lmeasure.calibration.plan.reach import Region, Usable
from lmeasure.core import BoolArray, FloatArray

APART = 0.1
"""Two poses must differ by this part of a coordinate's range: a second visit repeats the rounding and adds no information."""

ZERO_TRIES = 24
LEVELS = (0.0, 0.25, 0.5, 0.75, 1.0)
NUDGES = (-0.06, 0.06)


@dataclass(frozen=True)
class Candidates:
    """Usable poses pool (c, 6) for an instrument whose counters are zeroed at `zero`; taken (r, 6): poses already recorded, which no
    planned pose may repeat. zero_unit (6,): coordinates of a zero pose that may be chosen too, None where it is given."""

    instrument: Instrument
    region: Region
    usable: Usable
    pool: FloatArray
    taken: FloatArray
    zero: Zero
    zero_unit: FloatArray | None

    @cached_property
    def determined(self) -> FloatArray:
        """(c, m, q) blocks of the pool."""
        return self.blocks(self.pool)

    def blocks(self, points: FloatArray) -> FloatArray:
        """(n, m, q) of points (n, 6)."""
        return self.instrument.blocks(self.region.rows(points), self.zero)

    def apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        """(n,) True for coordinates that repeat none of points, of the recorded poses, nor the zero pose."""
        return self._apart(tried, points if self.zero_unit is None else np.vstack([points, self.zero_unit]))

    def _apart(self, tried: FloatArray, points: FloatArray) -> BoolArray:
        every = np.vstack([self.taken, points])
        gap = np.abs(tried[:, None, :] - every[None, :, :])[:, :, self.region.active]
        return np.asarray((gap.max(axis=2, initial=0.0) >= APART - 1e-12).all(axis=1))

    def beside(self, points: FloatArray) -> list[FloatArray]:
        """Usable poses with a single coordinate of each of points (k, 6) moved to levels of its range and a little to both sides."""
        out = []
        for point in points:
            moved = [
                np.where(np.arange(6) == c, value, point)
                for c in np.flatnonzero(self.region.active)
                for value in (*LEVELS, *np.clip(point[c] + NUDGES, 0.0, 1.0))
                if value != point[c]
            ]
            out.append(np.array(moved).reshape(-1, 6))
        good = self.usable(self.region.rows(np.concatenate([points[:0], *out])))
        return [near[own] for near, own in zip(out, np.split(good, np.cumsum([len(near) for near in out[:-1]])), strict=True)]

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterator[tuple[Self, FloatArray]]:
        """Zeroed at some of the pool, or beside where they are, if that may be chosen."""
        if self.zero_unit is None:
            return
        tried = self.beside(self.zero_unit[None])[0] if near else self.pool
        free = tried[self._apart(tried, points)]
        if len(free) > ZERO_TRIES:
            free = free[rng.choice(len(free), ZERO_TRIES, replace=False)]
        rows = self.region.rows(points)
        for unit, row in zip(free, self.region.rows(free), strict=True):
            zero = self.instrument.zero(row)
            yield replace(self, zero=zero, zero_unit=unit), self.instrument.blocks(rows, zero)


def candidates(
    instrument: Instrument, region: Region, usable: Usable, pool: FloatArray, *, taken: FloatArray, zero: Zero | None
) -> Candidates:
    """Zeroed as given, or else, to begin with, at the candidate nearest to the middle of the region."""
    if zero is not None:
        return Candidates(instrument, region, usable, pool, taken, zero, None)
    unit = pool[int(np.argmin(np.sum((pool - 0.5) ** 2, axis=1)))]
    return Candidates(instrument, region, usable, pool, taken, instrument.zero(region.rows(unit[None, :])[0]), unit)
