"""Problem of an estimation: parameters that are known a little before, from residuals with a covariance."""

from abc import ABC, abstractmethod
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from lmeasure.core import FloatArray, IntArray


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
        """(e,) modelled less measured."""

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

    def untold(self, block: int) -> str:
        """Return the report for a block of nuisance parameters that the residuals do not determine completely."""
        assert self.nuisance is not None
        return f"{self.nuisance.names[block * self.nuisance.size]} and what belongs to it: the residuals do not tell it"
