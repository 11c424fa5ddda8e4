"""Square roots of covariances, the same on every machine.

LAPACK chooses the sign of an eigenvector, and any basis among equal eigenvalues: two builds of it give two factors V sqrt(L), both right,
and draws by them with the same seed differ. A third party must get the same results: the symmetric root V sqrt(L) V' does not depend on the
choice.
"""

import numpy as np

from lmeasure.core.arrays import FloatArray

NOTHING = 1e-14  # Relative to the largest eigenvalue: smaller ones are rounding
SAME = 1e-12  # 1 minus the correlation from which two parameters count as one


def symmetric_root(covariance: FloatArray) -> FloatArray:
    """Return the (..., k, k) symmetric square roots of covariances (..., k, k); NaN (not measured) counts as zero.

    The rounding of a zero eigenvalue would be 1e-8 of the largest in its root, and another number on each processor. The number of zeros is
    decided in units of each component's own width, since millimetres and radians are not comparable; rank is the same in all units.
    """
    covariance = np.nan_to_num(covariance)
    width = np.sqrt(np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0))
    unit = np.where(width > 0.0, width, 1.0)
    scaled = np.linalg.eigvalsh(covariance / (unit[..., :, None] * unit[..., None, :]))
    rank = (scaled > NOTHING * scaled.max(axis=-1, initial=0.0, keepdims=True)).sum(axis=-1, keepdims=True)
    values, vectors = np.linalg.eigh(covariance)
    # they are in ascending order
    values = np.where(np.arange(values.shape[-1]) >= values.shape[-1] - rank, np.maximum(values, 0.0), 0.0)
    return np.asarray((vectors * np.sqrt(values)[..., None, :]) @ np.swapaxes(vectors, -1, -2))


def covariance_root(covariance: FloatArray, width: FloatArray) -> FloatArray:
    """Return (p, r) F with F F^T the covariance (p, p), of the columns of the symmetric root; width (p,): a standard uncertainty of each
    parameter, 0 where it is exact.

    Parameters are millimetres and radians, with small and large uncertainties: zero is only defined in units of their own widths. A
    parameter of several cables is in the covariance several times, and once in F. Exact ones have no column.
    """
    unit = np.where(width > 0.0, width, 1.0)
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    kept = values > NOTHING * max(float(values.max(initial=0.0)), 0.0)
    root = (vectors[:, kept] * np.sqrt(values[kept])) @ vectors[:, kept].T
    sigma = np.linalg.norm(root, axis=1)
    uncertain = np.flatnonzero(sigma > np.sqrt(NOTHING) * sigma.max(initial=0.0))
    own = root[uncertain] / sigma[uncertain, None]
    alike = np.abs(own @ own.T) > 1.0 - SAME
    first = ~np.tril(alike, -1).any(axis=1)
    # rows of one variable are multiples of one row, and so are columns of a symmetric matrix
    times = np.sqrt((alike[first] * sigma[uncertain] ** 2).sum(axis=1)) / sigma[uncertain[first]]
    return np.ascontiguousarray(unit[:, None] * root[:, uncertain[first]] * times)
