"""Problem of an estimation: parameters that are known a little before, from residuals with a covariance.

Optimum of a problem, and its uncertainty.
"""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray


@dataclass(frozen=True)
class Parameters:
    """Names (p) of values, their prior values (p,) and prior standard uncertainties (p,), in the units of their names. A name has an owner,
    a point, and a quantity."""

    names: tuple[str, ...]
    nominal: FloatArray
    width: FloatArray

    def owner(self, i: int) -> str:
        """Whose value i is."""
        return self.names[i].rsplit(".", 1)[0]

    def of(self, owner: str) -> IntArray:
        """Indices of one owner's values."""
        return np.array([i for i in range(len(self.names)) if self.owner(i) == owner], dtype=np.int64)


@dataclass(frozen=True)
class Nuisance:
    """Parameters without a prior or a use, in blocks of one size behind the others: an instrument's position at each measurement, say. They
    are eliminated (`estimation.elimination`).

    names (d b) in the order of the unknowns; of (e,) the block each residual belongs to; shared: blocks on which residuals of any block
    depend beside their own.
    """

    size: int
    names: tuple[str, ...]
    of: IntArray
    shared: IntArray

    @property
    def blocks(self) -> int:
        """Return how many blocks there are."""
        return len(self.names) // self.size if self.size else 0

    @cached_property
    def alike(self) -> list[tuple[IntArray, IntArray]]:
        """Blocks that are not shared, in groups of as many residuals: their numbers (k,), and their residuals (k, m)."""
        others = [(k, np.flatnonzero(self.of == k)) for k in range(self.blocks) if k not in self.shared]
        sizes = sorted({len(rows) for _, rows in others} - {0})
        groups = [[(k, rows) for k, rows in others if len(rows) == size] for size in sizes]
        return [(np.array([k for k, _ in group]), np.array([rows for _, rows in group])) for group in groups]


class Gauge(Protocol):
    """Motions of all unknowns together that no residual determines, and the choice among them."""

    @property
    def keeps_prior(self) -> bool:
        """Return whether priors everywhere already make the choice."""

    def motions(self, theta: FloatArray) -> FloatArray:
        """(P, g) how the unknowns move."""

    def settled(self, theta: FloatArray) -> FloatArray:
        """The unknowns (P,) moved to where the choice puts them."""

    def projection(self, theta: FloatArray) -> FloatArray:
        """Return the (P, P) projection of deviations of unknowns back to the gauge: an S-transformation (Baarda 1973)."""


class Problem(ABC):
    """Residuals (e,) of P = p + d b unknowns theta: p parameters with priors, and behind them b blocks of d nuisance parameters, if any."""

    parameters: Parameters
    nuisance: Nuisance | None = None
    gauge: Gauge | None = None
    covariance_varies: bool = False
    """Whether the covariance depends on the unknowns, if only a little."""

    @abstractmethod
    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) modelled minus measured."""

    @abstractmethod
    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, P) derivatives of the residuals."""

    @abstractmethod
    def covariance(self, theta: FloatArray) -> FloatArray:
        """(e, e) of the residuals."""

    @property
    def own(self) -> int:
        """p, how many parameters have priors: they are the first."""
        return len(self.parameters.names)

    @property
    def names(self) -> tuple[str, ...]:
        """(P) of all unknowns."""
        return self.parameters.names if self.nuisance is None else (*self.parameters.names, *self.nuisance.names)

    @property
    def start(self) -> FloatArray:
        """Return (P,) the prior values of the unknowns: nuisance parameters are counted from there."""
        return np.r_[self.parameters.nominal, np.zeros(0 if self.nuisance is None else len(self.nuisance.names))]

    @property
    def taken_back(self) -> FloatArray | None:
        """(e,) the part of each residual's variance with which a robust loss takes it back; None without one."""
        return None

    def uniform(self) -> tuple[FloatArray, FloatArray]:
        """The part of the covariance whose errors are uniform and not Gaussian, as rounding is: (e,) variances of errors of each residual's
        own, and (e, z) the residuals' errors by one standard deviation of each of z that they share."""
        e = len(self.residuals(self.start))
        return np.zeros(e), np.zeros((e, 0))

    def undetermined_block(self, block: int) -> str:
        """Return the report for a block of nuisance parameters that the residuals do not determine completely."""
        assert self.nuisance is not None
        return f"{self.nuisance.names[block * self.nuisance.size]}: the residuals do not determine it"


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
        """Degrees of freedom of chi2: residuals that count, minus directions determined."""
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
    """Return how many residuals a robust loss has taken back, minus the nuisance parameters that go with them."""
    taken = problem.taken_back
    if taken is None:
        return 0.0
    share = taken / np.diag(V)
    if problem.nuisance is not None:
        size = np.bincount(problem.nuisance.of)[problem.nuisance.of]
        share = share * np.maximum(0.0, 1.0 - problem.nuisance.size / size)
    return float(np.sum(share))
