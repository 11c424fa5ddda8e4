"""Information of future measurements: information matrices as sums over them.

With V the covariance of all residuals, V = D + K K^T, D a block per measurement and K shared errors (such as an instrument's zero), the
shared errors are unknowns eta of their own with a unit normal as prior, and the information of all is a sum over the measurements,

    M = M_0 + sum_c A_c^T A_c,    A_c = D_c^{-1/2} [J_c, K_c],

J_c the derivatives of its residuals by the parameters, M_0 the prior information. By Woodbury's identity the parameters' block of M^{-1} is
the covariance of the generalised least squares with V. In prior widths M_0 is the identity where nothing has been measured yet.
"""

import numpy as np

from lmeasure.core import FloatArray


def blocks(derivatives: FloatArray, covariance: FloatArray) -> FloatArray:
    """(n, m, q) the matrices A_c of measurements with derivatives (n, m, q), by parameters and shared errors, of m residuals each.
    covariance: (m, m) or (n, m, m) of a measurement's own errors; (m,) where they are not correlated."""
    if covariance.ndim == 1:
        return np.asarray(derivatives / np.sqrt(covariance)[:, None])
    return np.asarray(np.linalg.solve(np.linalg.cholesky(covariance), derivatives))


def parameter_information(M: FloatArray, p: int) -> FloatArray:
    """(p, p) information about the parameters alone, from M (q, q) without a prior on anything: shared errors, the last, eliminated."""
    if len(M) == p:
        return M
    return np.asarray(M[:p, :p] - M[:p, p:] @ np.linalg.solve(M[p:, p:] + np.eye(len(M) - p), M[p:, :p]))


def estimated_covariance(information: FloatArray) -> tuple[FloatArray, int]:
    """(p, p) covariance in units of prior widths as the estimator states it, and how many directions the data determine.

    A direction better known from the data than from the prior is left to the data, any other to the prior (see `least_squares`).
    """
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    known = values > 1.0
    variance = np.where(known, 1.0 / np.where(known, values, 1.0), 1.0)
    return np.asarray((vectors * variance) @ vectors.T), int(known.sum())
