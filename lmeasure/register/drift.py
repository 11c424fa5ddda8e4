"""Drift of a result between its calibrations, and when the next one is due (ILAC-G24:2022, methods by control chart and by drift).

x_i of standard uncertainty u_i at times t_i [days] is x_0 + r (t - t_0) + w(t) + error: a line of unknown height and slope, a random walk w
of variance q per day, and the measurements' errors. By the restricted likelihood of q the forecast is averaged over walks that have between
a tenth and ten times the measurements' uncertainty from one calibration to the next, all sizes alike (log-uniform): few calibrations do
not determine q, and that widens the forecast. At a later time the value is a mixture of normal laws.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.optimize
from scipy.special import ndtr

from lmeasure.core import CertificationError, FloatArray
from lmeasure.text import message

LEAST = 3
"""Calibrations from which a drift is estimated."""
WALKS, GRID = (1e-2, 1e2), 25
"""Variances of the walk between calibrations over that of a measurement, and how many of them."""
PROBABILITY = 0.95


@dataclass(frozen=True)
class Forecast:
    """A value at later times: (k,) weights of walks, and functions of the time [days] that give their (k,) means and standard deviations.

    drift, u_drift: slope of the line [unit/day]; last: time of the last calibration; walk: weighted standard deviation of the random walk
    [unit/sqrt(day)].
    """

    weights: FloatArray
    at: Callable[[float], tuple[FloatArray, FloatArray]]
    drift: float
    u_drift: float
    walk: float
    last: float

    def probability_within(self, time: float, lower: float, upper: float) -> float:
        """Return the probability that the value is within limits at a time."""
        mean, sigma = self.at(time)
        return float(self.weights @ (ndtr((upper - mean) / sigma) - ndtr((lower - mean) / sigma)))

    def interval(self, time: float, probability: float = PROBABILITY) -> tuple[float, float]:
        """Return the interval that holds the value at a time with a probability, its tails alike."""
        mean, sigma = self.at(time)
        low, high = float((mean - 12.0 * sigma).min()), float((mean + 12.0 * sigma).max())

        def quantile(q: float) -> float:
            return float(scipy.optimize.brentq(lambda x: self.weights @ ndtr((x - mean) / sigma) - q, low, high))

        tail = 0.5 * (1.0 - probability)
        return quantile(tail), quantile(1.0 - tail)

    def due(self, lower: float, upper: float, risk: float = 0.05, longest: float = 3650.0) -> float:
        """Return the first time [days] at which the value is beyond its limits with more than this risk; at most so long after the last
        calibration, and the time of that if the risk is exceeded there."""
        times = self.last + np.linspace(0.0, longest, 100)
        bad = [i for i, t in enumerate(times) if 1.0 - self.probability_within(float(t), lower, upper) > risk]
        if not bad:
            return float(times[-1])
        if bad[0] == 0:
            return self.last

        def excess(time: float) -> float:
            return 1.0 - self.probability_within(time, lower, upper) - risk

        return float(scipy.optimize.brentq(excess, times[bad[0] - 1], times[bad[0]]))


def forecast(times: FloatArray, values: FloatArray, u: FloatArray) -> Forecast:
    """Return the forecast from n calibrations: times (n,) [days], values (n,), standard uncertainties (n,) independent of each other.

    Raises
    ------
    CertificationError
        If there are fewer than three calibrations at different times, or an uncertainty is not above zero.
    """
    order = np.argsort(times, kind="stable")
    t, x, u = times[order], values[order], u[order]
    if len(np.unique(t)) < LEAST:
        raise CertificationError(message("error.calibrations_at_different_times", n_unique=len(np.unique(t)), least=LEAST))
    if not (u > 0.0).all():
        raise CertificationError(message("error.a_drift_is_estimated"))
    begin = float(t[0])
    s, A = t - begin, np.column_stack([np.ones(len(t)), t - begin])
    shared = np.minimum(s[:, None], s[None, :])
    # between calibrations the walk has between a tenth and ten times the measurements' uncertainty
    walks = float(np.mean(u**2)) / float(np.mean(np.diff(np.unique(t)))) * np.geomspace(*WALKS, GRID)

    def fitted(q: float) -> tuple[float, FloatArray, FloatArray, FloatArray]:
        W = np.asarray(np.linalg.inv(np.diag(u**2) + q * shared), dtype=np.float64)
        information: FloatArray = A.T @ W @ A
        line = np.asarray(np.linalg.solve(information, A.T @ W @ x), dtype=np.float64)
        left = x - A @ line
        log = 0.5 * (np.linalg.slogdet(W)[1] - np.linalg.slogdet(information)[1] - left @ W @ left)
        C = np.asarray(np.linalg.inv(information), dtype=np.float64)
        return float(log), line, C, W

    fits = [fitted(q) for q in walks]
    weighed = [(A.T @ W, W @ (x - A @ line)) for _, line, _, W in fits]
    logs = np.array([f[0] for f in fits])
    weights = np.exp(logs - logs.max())
    weights /= weights.sum()

    def at(time: float) -> tuple[FloatArray, FloatArray]:
        later = time - begin
        means, sigmas = np.empty(len(walks)), np.empty(len(walks))
        for i, (q, (_, line, C, W), (AW, left)) in enumerate(zip(walks, fits, weighed, strict=True)):
            c = q * np.minimum(s, later)
            row = np.array([1.0, later])
            rest = row - AW @ c
            means[i] = row @ line + c @ left
            sigmas[i] = np.sqrt(max(q * later - c @ W @ c + rest @ C @ rest, 0.0))
        return means, np.maximum(sigmas, 1e-12 * (1.0 + np.abs(means)))

    slopes, spread = np.array([f[1][1] for f in fits]), np.array([f[2][1, 1] for f in fits])
    drift = float(weights @ slopes)
    u_drift = float(np.sqrt(weights @ (spread + (slopes - drift) ** 2)))
    return Forecast(weights, at, drift, u_drift, float(np.sqrt(weights @ walks)), float(t[-1]))
