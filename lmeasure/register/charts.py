"""Control charts of one result over time: does it vary as it did while the charts were set up?

With m and s of the first values (the baseline) and z = (x - m) / s:

    Shewhart    |z| > 3                                                              average run length 370 without a change
    EWMA        e = 0.2 z + 0.8 e,  |e| > 2.86 sqrt(0.2 / 1.8 (1 - 0.8^2i))          370    (Lucas, Saccucci, Technometrics 32 (1990))
    CUSUM       c+ = max(0, c+ + z - 0.5), c- = max(0, c- - z - 0.5), either > 4.774 370    (Hawkins, Olwell, Cumulative Sum Charts, 1998)

A shift by one s is found after 44, 9 and 10 values on average. m and s of a short baseline are uncertain, which shortens these runs.
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import CertificationError, FloatArray
from lmeasure.text import message

LEAST = 5
"""Values of a baseline."""
SHEWHART = 3.0
WEIGHT, EWMA = 0.2, 2.86
SLACK, CUSUM = 0.5, 4.774


@dataclass(frozen=True)
class Chart:
    """A chart of n values: name, statistic (n,), limit (n,), and indices of the values at which it signals."""

    name: str
    statistic: FloatArray
    limit: FloatArray

    @property
    def signals(self) -> tuple[int, ...]:
        """Indices at which the statistic is beyond its limit."""
        return tuple(np.flatnonzero(np.abs(self.statistic) > self.limit).tolist())


def control_charts(values: FloatArray, baseline: int) -> tuple[Chart, Chart, Chart]:
    """Return the Shewhart, EWMA and CUSUM charts of values (n,), oldest first, by their first `baseline`.

    Raises
    ------
    CertificationError
        If the baseline is shorter than 5, longer than the values, or does not vary.
    """
    if not LEAST <= baseline <= len(values):
        raise CertificationError(message("error.control_charts_need_a", least=LEAST, n_values=len(values), baseline=baseline))
    mean, spread = float(values[:baseline].mean()), float(values[:baseline].std(ddof=1))
    if not spread > 0.0:
        raise CertificationError(message("error.the_first_values_are", baseline=baseline))
    return charts_of((values - mean) / spread)


def charts_of(z: FloatArray) -> tuple[Chart, Chart, Chart]:
    """Return the three charts of standardised values (n,)."""
    n = len(z)
    smooth, sums = np.zeros(n), np.zeros(n)
    e = high = low = 0.0
    for i, value in enumerate(z.tolist()):
        e = WEIGHT * value + (1.0 - WEIGHT) * e
        high, low = max(0.0, high + value - SLACK), max(0.0, low - value - SLACK)
        smooth[i], sums[i] = e, high if high >= low else -low
    width = EWMA * np.sqrt(WEIGHT / (2.0 - WEIGHT) * (1.0 - (1.0 - WEIGHT) ** (2.0 * np.arange(1, n + 1))))
    return Chart("Shewhart", z, np.full(n, SHEWHART)), Chart("EWMA", smooth, width), Chart("CUSUM", sums, np.full(n, CUSUM))
