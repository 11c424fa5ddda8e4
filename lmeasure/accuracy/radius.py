"""The exact 95 % radius of a three-dimensional Gaussian, and the polynomial that the kernels use for it."""

import numpy as np
import scipy

from lmeasure.core import FloatArray
from lmeasure.trajectory import radii_95 as radii_95


def exact_radius_95(eigenvalues: FloatArray, coverage: float = 0.95) -> float:
    """Radius that holds the coverage of a Gaussian with these three variances along its axes (same unit squared).

    In coordinates whitened by the variances the sphere reaches r^2/(n.Lambda n) along the direction n, so the probability is the mean over
    all directions of the chi-square distribution (3 degrees of freedom) there: Gauss-Legendre in the cosine to the longest axis,
    midpoints in the angle about it, both spectrally accurate. scipy.special.gammainc(3/2, x/2) is that distribution.
    """
    scaled = np.sort(np.asarray(eigenvalues, dtype=np.float64))[::-1]
    scale = scaled[0]
    if not scale > 0.0:
        return 0.0
    scaled = scaled / scale
    node, weight = np.polynomial.legendre.leggauss(80)
    cosine2 = (0.5 * (node + 1.0)) ** 2
    turn = (np.arange(24) + 0.5) / 24 * np.pi / 2
    along = cosine2[:, None] * scaled[0] + (1 - cosine2[:, None]) * (scaled[1] * np.cos(turn) ** 2 + scaled[2] * np.sin(turn) ** 2)

    def excess(square: float) -> float:
        return float(0.5 * weight @ scipy.special.gammainc(1.5, 0.5 * square / along).mean(axis=1)) - coverage

    low, high = (2.0 * scipy.special.gammaincinv(freedom / 2.0, coverage) for freedom in (1, 3))
    return float(np.sqrt(scale * scipy.optimize.brentq(excess, 0.9 * low, 1.1 * high, xtol=1e-13)))


def stated_radii_95(covariances: FloatArray) -> FloatArray:
    """(n,) `radii_95`; NaN where nothing is stated: no covariance, or a zero one, which no measurement has."""
    out = np.full(len(covariances), np.nan)
    stated = np.isfinite(covariances).all(axis=(1, 2)) & (np.einsum("nii->n", covariances) > 0.0)
    out[stated] = radii_95(covariances[stated])
    return out
