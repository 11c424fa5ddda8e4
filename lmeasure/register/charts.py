"""Control charts of one result over time: does it vary as it did while the charts were set up?

With m and s of the first values (the baseline) and z = (x - m) / s:

    Shewhart    |z| > 3                                                              average run length 370 without a change
    EWMA        e = 0.2 z + 0.8 e,  |e| > 2.86 sqrt(0.2 / 1.8 (1 - 0.8^2i))          370    (Lucas, Saccucci, Technometrics 32 (1990))
    CUSUM       c+ = max(0, c+ + z - 0.5), c- = max(0, c- - z - 0.5), either > 4.774 370    (Hawkins, Olwell, Cumulative Sum Charts, 1998)

A shift by one s is found after 44, 9 and 10 values on average, if m and s are known. From a short baseline both are uncertain, so the
limits are wider: as many sound instruments signal within 20 values as with known m and s (5 %, 6 % and 4 %). `LIMITS` was simulated with
400,000 instruments for each baseline (Quesenberry, Journal of Quality Technology 25 (1993), shows why the usual limits are too narrow).
"""

from dataclasses import dataclass

import numpy as np

from lmeasure.core import CertificationError, FloatArray
from lmeasure.text import message

LEAST = 5
"""Values of a baseline."""
WEIGHT, SLACK = 0.2, 0.5
KNOWN = (3.0, 2.86, 4.774)
"""Limits of the Shewhart, EWMA and CUSUM charts with a known baseline."""
BASELINES = (5, 6, 7, 8, 10, 12, 15, 20, 30, 50, 100)
LIMITS = (
    (5.781, 5.133, 4.694, 4.418, 4.073, 3.861, 3.667, 3.481, 3.311, 3.189, 3.097),
    (6.414, 5.621, 5.090, 4.776, 4.327, 4.052, 3.801, 3.553, 3.315, 3.131, 2.989),
    (22.68, 18.26, 15.37, 13.61, 11.27, 9.866, 8.623, 7.466, 6.449, 5.723, 5.216),
)
"""Limits of the three charts with a baseline of so many values."""


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


def control_charts(values: FloatArray, baseline: int) -> tuple[Chart, ...]:
    """Return the Shewhart, EWMA and CUSUM charts of values (n,), oldest first, by their first `baseline`.

    EWMA and CUSUM begin anew after the baseline.

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
    z, limits = (values - mean) / spread, limits_after(baseline)
    parts = zip(charts_of(z[:baseline], limits), charts_of(z[baseline:], limits), strict=True)
    return tuple(Chart(a.name, np.append(a.statistic, b.statistic), np.append(a.limit, b.limit)) for a, b in parts)


def limits_after(baseline: int) -> tuple[float, ...]:
    """Return the limits of the three charts after a baseline of so many values: between those of `LIMITS`, by its inverse."""
    inverse = [0.0, *(1.0 / m for m in reversed(BASELINES))]
    wider = ([0.0, *np.log(np.array(row[::-1]) / known)] for row, known in zip(LIMITS, KNOWN, strict=True))
    return tuple(known * float(np.exp(np.interp(1.0 / baseline, inverse, by))) for known, by in zip(KNOWN, wider, strict=True))


def charts_of(z: FloatArray, limits: tuple[float, ...] = KNOWN) -> tuple[Chart, ...]:
    """Return the three charts of standardised values (n,) with their limits."""
    n, (shewhart, ewma, cusum) = len(z), limits
    smooth, sums = np.zeros(n), np.zeros(n)
    e = high = low = 0.0
    for i, value in enumerate(z.tolist()):
        e = WEIGHT * value + (1.0 - WEIGHT) * e
        high, low = max(0.0, high + value - SLACK), max(0.0, low - value - SLACK)
        smooth[i], sums[i] = e, high if high >= low else -low
    width = ewma * np.sqrt(WEIGHT / (2.0 - WEIGHT) * (1.0 - (1.0 - WEIGHT) ** (2.0 * np.arange(1, n + 1))))
    return Chart("Shewhart", z, np.full(n, shewhart)), Chart("EWMA", smooth, width), Chart("CUSUM", sums, np.full(n, cusum))
