"""What errors that are not small make of a pose beyond first order: readings bend while the pose moves by a zero that is known to a degree.

With f what the channels read at a pose, G the inverse of its rows and L the errors of the readings by variables z of unit variance, the
pose errs by the delta for which f(delta) - f(0) = L z. With F = G L and H the second derivatives of f,

    delta = F z + sum_(i<j) D_ij z_i z_j + sum_i D_ii (z_i^2 - 1) / 2 + sum_i D_ii / 2 + rest,    D_ij = -G H[F_i, F_j].

Of normal z the products z_i z_j and (z_i^2 - 1) / sqrt(2) have unit variance and correlate with nothing else (JCGM 100, note to 5.1.2,
whose terms of second order these are for one quantity). So they are variables like the others, shared by all samples; the last sum is the
bias of the estimate, which is not taken off but stands beside them. Of the rest, by one step of Newton's, some draws tell the mean square.
"""

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3
from lmeasure.kernels import span_lengths, span_rows_of

STEP = 0.1
"""Standard deviations over which second differences are taken: far enough for rounding, near enough for what is of fourth order."""
DRAWS = 16
"""Of what is left: its mean square is known to about a third."""


def variables(k: int) -> int:
    """How many variables stand beside k of first order."""
    return k * (k + 1) // 2 + 1 + DRAWS if k else 0


def beyond_first(rows: FloatArray, poses: FloatArray, *, G: FloatArray, F: FloatArray, angles: BoolArray) -> FloatArray:
    """(n, 6, variables(k)) errors of (n, 7) poses beyond those of first order F (n, 6, k) [rad; mm], base axes, by k normal variables.

    rows (m, columns) of the channels, of which angles (m,) are on the circle; G (n, 6, m): motions of the poses per unit of each reading.
    NaN where there is no pose.
    """
    k = F.shape[2]
    out = np.full((len(poses), 6, variables(k)), np.nan)
    known = np.isfinite(poses).all(axis=1) & np.isfinite(F).all(axis=(1, 2))
    at, F, G = np.ascontiguousarray(poses[known]), F[known], np.where(np.isfinite(G[known]), G[known], 0.0)
    here, A = span_lengths(rows, at), span_rows_of(rows, at)

    def changed(delta: FloatArray) -> FloatArray:
        change = span_lengths(rows, np.ascontiguousarray(se3.displaced(at, delta))) - here
        return np.where(angles, np.remainder(change + np.pi, 2.0 * np.pi) - np.pi, change)

    def motions(readings: FloatArray) -> FloatArray:
        # no cable runs to some poses that far away: nothing is said of it there
        return np.asarray(G @ np.where(np.isfinite(readings), readings, 0.0))

    def bend(delta: FloatArray) -> FloatArray:
        """(n, m) H[delta, delta]."""
        return (changed(STEP * delta) + changed(-STEP * delta)) / STEP**2

    own = [bend(F[:, :, i]) for i in range(k)]
    pairs = [(i, j) for i in range(k) for j in range(i)]
    mixed = [(bend(F[:, :, i] + F[:, :, j]) - own[i] - own[j]) / 2.0 for i, j in pairs]
    second = -motions(np.stack([*mixed, *(h / np.sqrt(2.0) for h in own), np.sum(own, axis=0) / 2.0], axis=2))
    rest = []
    for z in np.random.default_rng(0).standard_normal((DRAWS, k)):
        products = np.array([*(z[i] * z[j] for i, j in pairs), *((z**2 - 1.0) / np.sqrt(2.0)), 1.0])
        asked = (A @ (F @ z)[:, :, None])[:, :, 0]
        rest.append(motions((asked - changed(F @ z + second @ products))[:, :, None])[:, :, 0])
    out[known] = np.concatenate([second, np.stack(rest, axis=2) / np.sqrt(DRAWS)], axis=2)
    return out
