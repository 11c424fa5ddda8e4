"""Counts recorded while the robot is at rest: their mean, and the uncertainty of a mean of rounded readings.

A still counter shows the same whole count again and again, and its mean is as far from the truth as one reading. Only noise that moves the
count makes the mean better. Of a reading y = round(x + nu), nu Gaussian of standard deviation sigma [counts], the mean over nu is off x by

    b(x) = sum over j of (-1)^j / (pi j) exp(-2 pi^2 j^2 sigma^2) sin(2 pi j x),

whose mean square over all x is B(sigma) = sum of exp(-4 pi^2 j^2 sigma^2) / (2 pi^2 j^2), 1/12 without noise and zero beyond half a count
(Widrow and Kollar, Quantization Noise, 2008, ch. 9). The scatter of readings about their mean is s^2 = sigma^2 + 1/12 - B(sigma), for the
error of one reading is sigma^2 + 1/12 in all. So s, pooled over the dwells of a channel, gives sigma, and the mean of n readings has the
variance B + s^2/n. The noise of readings must be independent: readings taken faster than a structure swings are one.
"""

import math

import numpy as np
import scipy

from lmeasure.core import FloatArray

_TERMS = np.arange(1, 200)


def rounding_left(sigma: float) -> float:
    """B(sigma): mean square error [counts^2] of the mean of many readings with that noise [counts]."""
    if sigma == 0.0:
        return 1.0 / 12.0
    return float(np.sum(np.exp(-4.0 * np.pi**2 * _TERMS**2 * sigma**2) / (2.0 * np.pi**2 * _TERMS**2)))


def noise_of(scatter: float) -> float:
    """The noise sigma [counts] of readings whose variance about their means is scatter [counts^2]."""
    if scatter <= 0.0:
        return 0.0

    def excess(sigma: float) -> float:
        return sigma**2 + 1.0 / 12.0 - rounding_left(sigma) - scatter

    return float(scipy.optimize.brentq(excess, 0.0, math.sqrt(scatter) + 1.0, xtol=1e-12))


def pooled_scatter(readings: list[FloatArray]) -> float:
    """Variance [counts^2] of readings about the means of their dwells; 0 when no dwell has more than one."""
    freedom = sum(len(r) - 1 for r in readings)
    return 0.0 if freedom == 0 else float(sum(((r - r.mean()) ** 2).sum() for r in readings) / freedom)


def mean_variance(scatter: float, readings: int) -> float:
    """Variance [counts^2] of the mean of so many readings, from their pooled scatter [counts^2]."""
    return rounding_left(noise_of(scatter)) + scatter / readings
