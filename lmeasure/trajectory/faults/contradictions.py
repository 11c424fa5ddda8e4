"""How large the contradictions of sound readings become by chance, rounding being uniform and not normal.

A sample's parities, brought to unit covariance, are y = U u + V v with u uniform, of unit variance (the rounding of every reading, and
where within a count its counter was zeroed), v normal (calibration, clocks, ...), and U U^T + V V^T = 1 (d, d). Of chi-squared = |y|^2 the
mean is d, but its tail is shorter than the normal law's: sums of a few uniforms end. With g normal (d,), E exp(lambda |y|^2) =
E exp(sqrt(2 lambda) g.y): so the generating function of the moments of chi-squared follows from that of y, averaged over directions theta
of the sphere,

    B(t) = mean over theta of exp(sum_j log(sinh(s_j)/s_j) + t^2 |V^T theta|^2 / 2),   s_j = sqrt(3) t (U^T theta)_j
    E exp(lambda chi2) = 2^(1 - d/2) / Gamma(d/2) (2 lambda)^(-d/2) integral of t^(d-1) B(t) exp(-t^2 / (4 lambda)) dt

and the chance of a larger one from its logarithm K by the saddlepoint formula of Lugannani and Rice (1980) in the form of
Barndorff-Nielsen (1986), divided by what the same formula gives for the normal law, whose chance is known: so it is exact where nothing
is uniform.
"""

from dataclasses import dataclass
from math import lgamma

import numpy as np
import scipy
from scipy.special import log_ndtr, ndtri

from lmeasure.core import FloatArray

DIRECTIONS = 256
ARGUMENTS = 120.0 * np.linspace(0.0, 1.0, 401)[1:] ** 2
LAMBDAS = np.concatenate([np.linspace(0.02, 0.5, 40)[:-1], np.geomspace(0.5, 10.0, 40)])
CUT = 1e-10
"""Of the integrand's largest value, at the last argument: beyond it the integral is not all there."""
LEAST = -80.0
"""Logarithm of a chance below which nothing is asked."""


@dataclass(frozen=True)
class ChanceOfContradiction:
    """Values of chi-squared (k,), rising, and the logarithms (k,) of the chance that sound readings contradict each other by more."""

    chi_squared: FloatArray
    log_chance: FloatArray

    def above(self, chi_squared: FloatArray) -> FloatArray:
        """(...) chance of more than chi_squared (...)."""
        # beyond the table as it falls at its end
        slope = (self.log_chance[-1] - self.log_chance[-2]) / (self.chi_squared[-1] - self.chi_squared[-2])
        beyond = np.maximum(chi_squared - self.chi_squared[-1], 0.0)
        return np.exp(np.interp(chi_squared, self.chi_squared, self.log_chance) + slope * beyond)

    def limit(self, chance: float) -> float:
        """Chi-squared that sound readings exceed with this chance."""
        return float(np.interp(-np.log(chance), -self.log_chance, self.chi_squared))


def chance_of(uniform: FloatArray, normal: FloatArray) -> ChanceOfContradiction:
    """At p places of a run together, each as likely as the others: U (p, d, k) and V (p, d, l) of their parities."""
    each = [_of_one(U, V) for U, V in zip(uniform, normal, strict=True)]
    grid = np.linspace(0.0, max(q[-1] for q, _ in each), 400)
    chances = np.array([np.exp(np.interp(grid, np.append(0.0, q), np.append(0.0, p))) * (grid <= q[-1]) for q, p in each])
    mean = chances.mean(axis=0)
    told = mean > np.exp(LEAST)
    return ChanceOfContradiction(grid[told], np.log(mean[told]))


def _of_one(U: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Values of chi-squared, rising, and the logarithms of the chance of more."""
    d, t = len(U), ARGUMENTS
    theta = _directions(d)
    exponent = 0.5 * ((theta @ V) ** 2).sum(axis=1)[:, None] * t**2
    for along in np.abs(theta @ U).T:
        exponent += _log_sinhc(np.sqrt(3.0) * along[:, None] * t)
    most = exponent.max(axis=0)
    log_B = most + np.log(np.exp(exponent - most).mean(axis=0))
    integrand = log_B + (d - 1) * np.log(t) + np.log(np.gradient(t)) - t**2 / (4.0 * LAMBDAS[:, None])
    most = integrand.max(axis=1, keepdims=True)
    weight = np.exp(integrand - most)
    total = weight.sum(axis=1)
    square = (weight * t**2).sum(axis=1) / total
    spread = (weight * (t**2 - square[:, None]) ** 2).sum(axis=1) / total
    K = most[:, 0] + np.log(total) + (1.0 - d / 2.0) * np.log(2.0) - lgamma(d / 2.0) - d / 2.0 * np.log(2.0 * LAMBDAS)
    first = square / (4.0 * LAMBDAS**2) - d / (2.0 * LAMBDAS)
    second = spread / (16.0 * LAMBDAS**4) - square / (2.0 * LAMBDAS**3) + d / (2.0 * LAMBDAS**2)
    # from above the mean, up to where the integral is cut off, or a bound of chi-squared leaves nothing but rounding of its spread
    above = first > 1.5 * d
    good = above & (weight[:, -1] < CUT) & (second > 1e-6) & (LAMBDAS * first > K)
    good &= np.cumsum(above & ~good) == 0
    q, lam = first[good], LAMBDAS[good]
    like = (1.0 - d / q) / 2.0
    normal = _tail(like, q, -d / 2.0 * np.log(1.0 - 2.0 * like), 2.0 * d / (1.0 - 2.0 * like) ** 2)
    log_chance = scipy.stats.chi2.logsf(q, d) + _tail(lam, q, K[good], second[good]) - normal
    kept = log_chance > LEAST
    q, log_chance = q[kept], np.minimum.accumulate(log_chance[kept])
    # behind the table: what is farthest of a convex body, all uniforms at their ends, is the largest of its supports; the rest is normal
    end = float(np.max(np.sqrt(3.0) * np.abs(theta @ U).sum(axis=1)))
    beyond = np.linspace(0.0, 12.0, 49)
    far = (end + beyond * max(float(np.linalg.norm(V, 2)) if V.size else 0.0, 1e-3)) ** 2
    left = np.minimum(scipy.stats.chi2.logsf(beyond**2, d), log_chance[-1])
    return np.append(q, far[far > q[-1]]), np.append(log_chance, left[far > q[-1]])


def _tail(lam: FloatArray, q: FloatArray, K: FloatArray, second: FloatArray) -> FloatArray:
    """Logarithm of the chance of more than q by K and its second derivative at lambda, where its first is q."""
    w, u = np.sqrt(2.0 * (lam * q - K)), lam * np.sqrt(second)
    return np.asarray(log_ndtr(-(w + np.log(u / w) / w)))


def _directions(d: int) -> FloatArray:
    """(n, d) spread evenly over the sphere."""
    if d == 1:
        return np.ones((1, 1))
    z = ndtri(np.clip(scipy.stats.qmc.Sobol(d, seed=0).random(DIRECTIONS), 1e-12, 1.0 - 1e-12))
    return np.asarray(z / np.linalg.norm(z, axis=1, keepdims=True))


def _log_sinhc(s: FloatArray) -> FloatArray:
    """log(sinh(s)/s) of s >= 0."""
    large = np.maximum(s, 1e-3)
    return np.where(s < 1e-3, s * s / 6.0, large + np.log1p(-np.exp(-2.0 * large)) - np.log(2.0 * large))
