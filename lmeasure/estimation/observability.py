"""Directions of parameters that the residuals do not determine, in a basis that can be described in words.

Their subspace, k orthonormal directions of p parameters in prior widths as rows (k, p), has no preferred basis. Two are offered: by the
owners of parameters, each with directions of its own, and by as few parameters as possible.

Information of future measurements: information matrices as sums over them.

With V the covariance of all residuals, V = D + K K^T, D a block per measurement and K shared errors (such as an instrument's zero), the
shared errors are unknowns eta of their own with a unit normal as prior, and the information of all is a sum over the measurements,

    M = M_0 + sum_c A_c^T A_c,    A_c = D_c^{-1/2} [J_c, K_c],

J_c the derivatives of its residuals by the parameters, M_0 the prior information. By Woodbury's identity the parameters' block of M^{-1} is
the covariance of the generalised least squares with V. In prior widths M_0 is the identity where nothing has been measured yet.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation.problem import Parameters


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


EVEN = 1e-9  # rounding tolerance for one half
SHARE = 0.3  # Of a direction that several owners share, from which an owner's part is determined


@dataclass(frozen=True)
class Direction:
    """weight (p,): in prior widths, of length 1; owner: the owner of the values that move most along it; alone: whether no others move."""

    owner: str
    weight: FloatArray
    alone: bool

    def parts(self, parameters: Parameters) -> Iterator[tuple[str, IntArray]]:
        """Owners whose values move with it, those that move most first, and their indices."""
        if self.alone:
            yield self.owner, parameters.of(self.owner)
            return
        own = {owner: parameters.of(owner) for owner in _owners(parameters)}
        size = {owner: float(np.linalg.norm(self.weight[at])) for owner, at in own.items()}
        for number, owner in enumerate(sorted(own, key=lambda name: -size[name])):
            if size[owner] > SHARE or not number:
                yield owner, own[owner]


def by_owner(parameters: Parameters, silent: FloatArray) -> list[Direction]:
    """Return (k) directions that span silent (k, p): those of each owner alone, strongest first, then those that owners share.

    The projector onto the subspace is the same for any basis: its block for one owner has an eigenvalue near 1 for each direction of that
    owner alone. The nearest one is taken, then the next from the remaining subspace. The last ones are spread over several owners, and
    listed under the one that moves most.
    """
    owners, left, out = _owners(parameters), silent, list[Direction]()
    while len(left):
        value, owner, weight = max((_strongest(parameters, owner, left) for owner in owners), key=lambda found: found[0])
        # half of a direction is its owner's no more than another's
        if value < 0.5 + EVEN:
            break
        out.append(Direction(owner, weight, alone=True))
        left = np.linalg.svd((left @ weight)[None])[2][1:] @ left
    out.sort(key=lambda found: owners.index(found.owner))
    alone = np.array([d.weight for d in out]).reshape(-1, len(parameters.names))
    _, _, spread = np.linalg.svd(silent - silent @ alone.T @ alone)
    for weight in spread[: max(0, len(silent) - len(out))]:
        most = max(owners, key=lambda name: float(np.linalg.norm(weight[parameters.of(name)])))
        out.append(Direction(most, np.asarray(weight), alone=False))
    return out


def _strongest(parameters: Parameters, owner: str, silent: FloatArray) -> tuple[float, str, FloatArray]:
    """Return how much of a direction of an owner alone lies in a subspace, at most: 1 where it does; the owner, and that direction (p,)."""
    own, weight = parameters.of(owner), np.zeros(len(parameters.names))
    values, vectors = np.linalg.eigh(silent[:, own].T @ silent[:, own])
    vector = vectors[:, -1]
    weight[own] = vector if vector[np.argmax(np.abs(vector))] >= 0 else -vector
    return float(values[-1]), owner, weight


def by_few(silent: FloatArray) -> tuple[FloatArray, IntArray]:
    """(k, p) directions that span silent (k, p), in echelon form: each has one parameter for itself, whose number is in (k,) and which
    moves by one prior width, and those that it does not need are nothing."""
    _, _, order = scipy.linalg.qr(silent, pivoting=True, mode="economic")
    pivots = order[: len(silent)]
    return np.asarray(np.linalg.solve(silent[:, pivots], silent), dtype=np.float64), np.asarray(pivots, dtype=np.int64)


def _owners(parameters: Parameters) -> list[str]:
    return list(dict.fromkeys(parameters.owner(i) for i in range(len(parameters.names))))
