"""Codes of absolute encoders, which begin anew after a revolution, beside counts that go on."""

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import Rig


def moduli(rig: Rig, channels: tuple[str, ...], passage: int) -> FloatArray:
    """(m,) how many codes absolute encoders have before they begin anew, 0 of channels that count on."""
    return np.array([float(rig.counters_of(passage)[c].codes or 0) for c in channels])


def folded(difference: FloatArray, modulus: FloatArray) -> FloatArray:
    """Differences (..., m) of counts, of absolute encoders the shorter way round."""
    turn = np.where(modulus > 0.0, modulus, 1.0)
    return np.where(modulus > 0.0, (difference + turn / 2.0) % turn - turn / 2.0, difference)


class GoneOn:
    """Counts of m channels, given one piece after the other, without the turns after which absolute encoders, modulus (m,), begin anew:
    they go on from the first that was seen."""

    def __init__(self, modulus: FloatArray) -> None:
        self._modulus, self._latest = modulus, np.full(len(modulus), np.nan)

    def of(self, recorded: FloatArray) -> FloatArray:
        """(n, m) of the next counts (n, m), NaN where there is none."""
        out = recorded.copy()
        for j in np.flatnonzero(self._modulus):
            there = np.flatnonzero(np.isfinite(recorded[:, j]))
            if len(there):
                first = recorded[there[0], j] if np.isnan(self._latest[j]) else self._latest[j]
                steps = folded(np.diff(recorded[there, j], prepend=first)[:, None], self._modulus[j : j + 1])[:, 0]
                out[there, j] = first + np.cumsum(steps)
                self._latest[j] = out[there[-1], j]
        return out
