"""Optimum of a problem, and its uncertainty."""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from lmeasure.core import BoolArray, FloatArray
from lmeasure.estimation.problem import Problem


@dataclass(frozen=True, kw_only=True)
class Fit:
    """An optimum of a problem of p parameters and P unknowns in all.

    theta (P,) in the units of the unknowns; residuals (e,); V (e, e) their covariance; s (p,) singular values of the whitened Jacobian in
    prior widths, nuisance parameters eliminated (zero-padded), directions (p, p) its right singular vectors as rows; known (p,) True where
    the data decide; prior_everywhere: whether the prior acts on those too; covariance (P, P) of theta with the model linearised; chi2 of
    the residuals under V; prior_misfit: squared distance from the nominal values in prior widths where the prior acts; nominal_misfit: the
    same in all directions; lost: number of residuals that a robust loss has rejected; excess: factor on V by unexplained residuals (in the
    covariance already); motions: number of the last directions, those of the problem's gauge. eliminated: for a problem with nuisance
    parameters, minus the change of theta by errors of the residuals (P, e), and by one standard uncertainty of values known from their
    nominal ones only (P, q).
    """

    problem: Problem
    theta: FloatArray
    residuals: FloatArray
    V: FloatArray
    s: FloatArray
    directions: FloatArray
    known: BoolArray
    prior_everywhere: bool
    covariance: FloatArray
    chi2: float
    prior_misfit: float
    nominal_misfit: float
    converged: bool
    lost: float
    excess: float = 1.0
    motions: int = 0
    eliminated: tuple[FloatArray, FloatArray] | None = None

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2: residuals that count, less directions determined."""
        return round(len(self.residuals) - self.lost) - self.rank

    @property
    def gains(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(p,) each: how a unit of the data's and of the prior's error moves the result along each direction, and the standard
        uncertainty that both make, all in prior widths."""
        return gains(self.s, self.known, self.prior_everywhere)

    @property
    def rank(self) -> int:
        """Return how many unknowns the data determine, nuisance parameters among them."""
        return int(self.known.sum()) + len(self.theta) - len(self.known)

    @property
    def silent(self) -> FloatArray:
        """Return (k, p) directions of the parameters that neither the data nor a gauge determine."""
        return self.directions[~self.known][: int((~self.known).sum()) - self.motions]

    @property
    def objective(self) -> float:
        """Return twice the negative log posterior, constants omitted, which distinguishes minima."""
        return self.chi2 + self.nominal_misfit

    @cached_property
    def jacobian(self) -> FloatArray:
        """(e, P) of the problem, at theta."""
        return self.problem.jacobian(self.theta)

    @property
    def along(self) -> FloatArray:
        """(e, p) derivatives of the residuals by the parameters in prior widths."""
        return np.asarray(self.jacobian[:, : self.problem.own] * self.problem.parameters.width)

    @property
    def determined(self) -> FloatArray:
        """Return (e, rank) derivatives of the residuals along determined directions of the parameters, and by nuisance parameters."""
        return np.hstack([self.along @ self.directions[self.known].T, self.jacobian[:, self.problem.own :]])

    @property
    def undetermined(self) -> FloatArray:
        """Return (e, k) changes of the residuals by one standard uncertainty along directions that only nominal values determine."""
        return np.asarray(self.along @ self.directions[~self.known].T if self.eliminated is None else self.jacobian @ self.eliminated[1])

    @property
    def held_covariance(self) -> FloatArray:
        """(p, p) the part of the parameters' covariance that only nominal values hold."""
        if self.eliminated is None or self.prior_everywhere:
            held = (self.silent * self.problem.parameters.width).T
        else:
            held = self.eliminated[1][: self.problem.own]
        return np.asarray(held @ held.T)

    @property
    def gain(self) -> FloatArray:
        """(P, e) how theta follows errors of the residuals, with the other sign."""
        if self.eliminated is not None:
            return self.eliminated[0]
        data, width = self.gains[0], self.problem.parameters.width
        weight = np.where(data > 0, data / np.where(data > 0, self.s, 1.0), 0.0)
        by_information = (self.directions.T * weight) @ self.directions * np.outer(width, width)
        return np.asarray(by_information @ np.linalg.solve(self.V, self.jacobian).T)


def gains(s: FloatArray, known: BoolArray, prior_everywhere: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    """`Fit.gains` of directions with singular values s (p,)."""
    if prior_everywhere:
        data, prior = s / (1.0 + s**2), 1.0 / (1.0 + s**2)
    else:
        data, prior = np.where(known, 1.0 / np.where(known, s, 1.0), 0.0), np.where(known, 0.0, 1.0)
    return data, prior, np.hypot(data, prior)


def untaken(problem: Problem, V: FloatArray) -> float:
    """Return how many residuals a robust loss has taken back, less the nuisance parameters that go with them."""
    taken = problem.taken_back
    if taken is None:
        return 0.0
    share = taken / np.diag(V)
    if problem.nuisance is not None:
        size = np.bincount(problem.nuisance.of)[problem.nuisance.of]
        share = share * np.maximum(0.0, 1.0 - problem.nuisance.size / size)
    return float(np.sum(share))
