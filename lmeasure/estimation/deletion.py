"""Comparison of groups of residuals: deletion residuals, and tests of groups that may be wrong together (Baarda's data snooping; Cook and
Weisberg, Residuals and Influence in Regression, 1982).

Everything follows from one matrix, P = V^-1 - V^-1 J (J^T V^-1 J)^-1 J^T V^-1 with J the Jacobian in the directions the data determine: P r
are the residuals as the fit sees them, and the block of P for some residuals is the information about their disagreement with the rest.
With a prior on every direction P = (V + J J^T)^-1, J in prior widths: then the prior disagrees too.
"""

import copy
from dataclasses import dataclass
from typing import Self

import numpy as np
import scipy

from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation.problem import Fit, Problem

MIN_FREEDOM = 3  # degrees of freedom that must be left for an F test to mean something
LEFT = 1e-3  # least part of a group's smallest variance that remains after the fit
INDISPENSABLE = 1e10  # ratio of information with and without the rest, from which residuals are indispensable


@dataclass(frozen=True)
class Shift:
    """Prediction by all others of residuals that may be wrong together: square of their joint misfit in units of its covariance,
    chi-squared with freedom degrees."""

    square: float
    freedom: int


def fall_test(fall: float, freedom: float, rest: float, left: float) -> tuple[float, float] | None:
    """F statistic and log probability of a fall of chi-squared bought with some degrees of freedom, a rest staying behind with those left:
    a common noise level cancels. None where too few are left."""
    if left < MIN_FREEDOM:
        return None
    value = (fall / freedom) / (max(rest, 1e-300) / left)
    return value, float(scipy.stats.f.logsf(value, freedom, left))


class Remainder:
    """Remainder of residuals r (e,) by weights P (e, e) without the fitted part: chi-squared r' P r with freedom degrees of freedom."""

    def __init__(self, weights: FloatArray, residuals: FloatArray, freedom: int) -> None:
        self._P, self._seen = weights, np.asarray(weights @ residuals, dtype=np.float64)
        self._chi2, self._freedom = float(residuals @ self._seen), freedom

    @property
    def chi_squared(self) -> float:
        """Return the chi-squared of the rest."""
        return self._chi2

    @property
    def freedom(self) -> int:
        """Return the degrees of freedom of the remainder."""
        return self._freedom

    def test(self, fall: float, freedom: int) -> tuple[float, float] | None:
        """F statistic and log probability of a fall of chi-squared bought with some degrees of freedom; a common noise level cancels. None
        where too few are left."""
        return fall_test(fall, freedom, self._chi2 - fall, self._freedom - freedom)

    def added(self, columns: FloatArray) -> Shift | None:
        """Return the fall of chi-squared if the shifts of residuals by columns (e, c) were solved for as well, and the number of determined
        ones. None if none is determined."""
        stiffness, pull = self._whitened(columns)
        return Shift(float(pull @ pull), stiffness.shape[1]) if stiffness.shape[1] else None

    def information(self, columns: FloatArray) -> FloatArray:
        """(c, c) of the sizes of columns (e, c), all else being solved for: the noncentrality of `added` for sizes d is d' I d."""
        return np.asarray(columns.T @ self._P @ columns)

    def freed(self, columns: FloatArray) -> Self:
        """The same of a fit that solves for columns (e, c) too."""
        out = copy.copy(self)
        stiffness, pull = self._whitened(columns)
        out._P = self._P - stiffness @ stiffness.T
        out._seen = self._seen - stiffness @ pull
        out._chi2, out._freedom = self._chi2 - float(pull @ pull), self._freedom - len(pull)
        return out

    def _whitened(self, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """(e, k) P C W and (k,) W' C' P r, W making them orthonormal where the fit leaves anything of columns C (e, c)."""
        own = np.linalg.norm(columns, axis=0)
        unit = columns / np.where(own > 0.0, own, 1.0)
        seen = self._P @ unit
        values, vectors = np.linalg.eigh(unit.T @ seen)
        kept = values > 1e-9 * float(np.trace(self._P))
        W = vectors[:, kept] / np.sqrt(values[kept])
        return np.asarray(seen @ W), np.asarray(W.T @ (unit.T @ self._seen))

    def step(self, column: FloatArray) -> tuple[float, float] | None:
        """Return the shift of residuals along a column (e,), and the fall of chi-squared; None if undetermined."""
        stiffness, pull = float(column @ self._P @ column), float(column @ self._seen)
        if stiffness < 1e-9 * float(np.trace(self._P)):
            return None
        return pull / stiffness, pull * pull / stiffness

    def sizes(self, columns: FloatArray) -> FloatArray:
        """Return the (c,) sizes of columns (e, c) that the residuals follow best, the shortest if undetermined."""
        return np.asarray(np.linalg.pinv(self.information(columns), rcond=1e-9, hermitian=True) @ (columns.T @ self._seen))

    def falls(self, columns: FloatArray) -> FloatArray:
        """Return the (c,) falls of chi-squared by each of columns (e, c) alone, 0 if undetermined."""
        stiffness, pull = np.einsum("ec,ec->c", columns, self._P @ columns), columns.T @ self._seen
        determined = stiffness > 1e-9 * float(np.trace(self._P))
        return np.asarray(np.where(determined, pull**2 / np.where(determined, stiffness, 1.0), 0.0))


class Deletion(Remainder):
    """Deletion diagnostics of a fit.

    at_start: at the initial values instead, without a fit: P = V^-1, which carries the errors that residuals share from one group to the
    next.
    """

    def __init__(self, fit: Fit, *, at_start: bool = False) -> None:
        self._fit, problem = fit, fit.problem
        self._astray = np.zeros(len(fit.V))
        if at_start:
            self._P = np.asarray(np.linalg.inv(fit.V), dtype=np.float64)
            self._seen = self._P @ problem.residuals(problem.start)
        elif fit.prior_everywhere and problem.nuisance is None:
            # with z of unit variance before the data came, r_nominal = J z + e and r = V (V + J J')^-1 r_nominal
            self._P = np.asarray(np.linalg.inv(fit.V + fit.along @ fit.along.T), dtype=np.float64)
            self._seen = np.asarray(np.linalg.solve(fit.V, fit.residuals), dtype=np.float64)
        else:
            L = np.linalg.cholesky(fit.V)
            Q, _ = np.linalg.qr(np.linalg.solve(L, fit.determined))
            left = np.linalg.inv(L) - Q @ np.linalg.solve(L.T, Q).T
            self._P = np.asarray(left.T @ left, dtype=np.float64)
            self._seen = self._P @ fit.residuals
            # part of the residuals that the fit could still remove: zero at an optimum
            self._astray = fit.residuals - fit.V @ self._seen
        self._alone = np.asarray(np.linalg.inv(fit.V), dtype=np.float64)
        self._chi2, self._freedom = fit.chi2, fit.freedom

    def shift(self, columns: FloatArray, extra: float = 0.0) -> Shift | None:
        """Return the contradiction of all others to residuals that columns (e, c) shift together. extra: a variance of each shift that is
        in V and not in the verdict. None if the others do not determine it."""
        nuisance = self._fit.problem.nuisance
        if not columns.shape[1]:
            return None
        determined = _determined(columns.T @ self._P @ columns, columns.T @ self._alone @ columns, 0 if nuisance is None else nuisance.size)
        if determined is None:
            return None
        values, vectors = determined
        shift = vectors.T @ (columns.T @ self._seen) / values
        return Shift(float(np.sum(shift**2 / (1.0 / values - extra))), len(shift))

    def deleted(self, groups: IntArray) -> list[tuple[IntArray, FloatArray]]:
        """Return for each group of residuals, numbered by groups (e,), its rows, and these residuals from a fit without it. Own nuisance
        parameters of the group are eliminated. Groups that the rest needs are omitted."""
        out, nuisance = [], self._fit.problem.nuisance
        for group in np.unique(groups):
            rows = np.flatnonzero(groups == group)
            lost = 0 if nuisance is None else nuisance.size * len(np.unique(nuisance.of[rows]))
            determined = _determined(self._P[np.ix_(rows, rows)], self._alone[np.ix_(rows, rows)], lost)
            if determined is None:
                continue
            values, vectors = determined
            out.append((rows, vectors.T @ self._seen[rows] / values + vectors.T @ self._astray[rows]))
        return out


def _determined(information: FloatArray, alone: FloatArray, lost: int) -> tuple[FloatArray, FloatArray] | None:
    """Return (k,) eigenvalues and (c, k) eigenvectors of the others' information about c residuals. Combinations that the residuals' own
    nuisance parameters can fit are omitted. None without information. alone (c, c): information without any fit, the scale of rounding."""
    values, vectors = np.linalg.eigh(information)
    values, vectors = values[lost:], vectors[:, lost:]
    if not len(values) or values[0] * INDISPENSABLE < np.trace(alone):
        return None
    return values, vectors


def deletion_squares(residuals: FloatArray, covariance: FloatArray, explained: FloatArray, weight: FloatArray) -> FloatArray:
    """Return (n,) the square of `Deletion.shift` for groups of residuals (n, m) that correlate with no others, without a matrix over all of
    them.

    covariance (n, m, m) of the groups' own errors; explained (n, m, m): that of the fit's prediction; weight (n,): the weight of the group
    in the fit, as if its errors had the covariance V / weight; 0 for no use. In the eigenvectors of H = J C J' in units of V, with
    eigenvalues h, the residuals from a fit without the group are r / (1 - w h), of variance 1 + h / (1 - w h).
    """
    root = np.linalg.inv(np.linalg.cholesky(covariance))
    value, vector = np.linalg.eigh(root @ explained @ np.swapaxes(root, 1, 2))
    # a group that alone determines a parameter has no residual to test it
    left = np.maximum(1.0 - weight[:, None] * value, LEFT)
    own = np.einsum("nji,njk,nk->ni", vector, root, residuals)
    return np.asarray((own**2 / (left * (left + value))).sum(axis=1))


def validation_residuals(whole: Problem, theta: FloatArray, fit: Fit, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Return (k,) errors and (k, k) covariance of a fit's prediction of validation residuals.

    whole has the fit's unknowns by name, perhaps nuisance parameters of the validation data, and the residuals of both; theta: values of
    all; rows: the residuals of the fit.
    """
    r, J, V = whole.residuals(theta), whole.jacobian(theta), whole.covariance(theta)
    own = J[:, np.isin(whole.names, fit.problem.names)]
    # an error that both share is in the result and in the residual: they correlate
    shared = V[:, rows] @ (own @ fit.gain).T
    return r, V + own @ fit.covariance @ own.T - shared - shared.T
