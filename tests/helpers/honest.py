"""Whether stated uncertainties are those of the errors met: neither too narrow nor too wide."""

import numpy as np
import scipy.stats
from numpy.typing import ArrayLike

CHANCE = 0.001
"""Of honest uncertainties to be refused."""


def assert_honest(ratios: ArrayLike, trials: int | None = None, *, within_half: float = 0.673) -> None:
    """Of errors over their U95, (n, ...) of n trials: as many lie within it as of n errors would that are within it 95 times in 100, and
    within half of it no more than of errors of whose law that is the share (default: a normal one)."""
    ratios = np.abs(np.asarray(ratios, dtype=np.float64))
    n = len(ratios) if trials is None else trials
    inside, within = float(np.mean(ratios <= 1.0)), float(np.mean(ratios <= 0.5))
    assert inside >= scipy.stats.binom.ppf(CHANCE, n, 0.95) / n, f"too narrow: {inside:.1%} of the errors lie within U95"
    most = scipy.stats.binom.ppf(1.0 - CHANCE, n, within_half) / n
    assert within <= most, f"too wide: {within:.1%} of the errors lie within half of U95"
