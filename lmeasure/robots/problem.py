"""An identification as a problem of `estimation`: residuals, derivatives, priors and covariance, and the noise that the residuals show.

Errors of different rows do not correlate, what they share being unknowns of their own: `estimation.normal_equations` takes the residuals
whitened row by row, which forms no covariance of all of them. Everything else that takes a problem may have that.
"""

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Generic

import numpy as np

from lmeasure import estimation
from lmeasure.arrays import FloatArray
from lmeasure.estimation.deletion import deletion_squares
from lmeasure.estimation.normal_equations import Optimum, optimum
from lmeasure.estimation.robust import EXCLUDED, biweights, normal_deviates, scatter, trust
from lmeasure.robots.measurements import POSITION, ROTATION, Measurements
from lmeasure.robots.unknowns import R, Unknowns

LEAST_MM, LEAST_RAD = 1e-6, 1e-9
"""Least noise where none is stated: exact numbers are weighed as rounded to a nanometre."""
ROUNDS = 12
SETTLED = 1e-3
WEIGHT_ROUNDS = 40
NORMAL_MEDIAN = 0.6745
"""Of |z|."""


@dataclass(frozen=True)
class Noise:
    """Standard deviations of what the robot itself adds to each coordinate of a target and to each component of its turn."""

    position_mm: float
    rotation_rad: float

    @property
    def variance(self) -> FloatArray:
        """(6,) of components (rotation; position)."""
        return np.repeat([self.rotation_rad**2, self.position_mm**2], 3)


@dataclass(frozen=True)
class Problem(estimation.Problem, Generic[R]):
    """Residuals of rows under a noise, in standard deviations, against changes theta of the unknowns in the units of their names."""

    unknowns: Unknowns[R]
    rows: Measurements
    noise: Noise
    own_noise: bool = True
    """Whether the noise is looked for in the residuals, or as it is."""
    weight: FloatArray | None = None
    """(N,) by which rows count, `estimation.robust.biweights` of what all others say of them; None: all alike."""
    trust: float = 1.0
    """What the weighted rows are worth together (`estimation.robust.trust`)."""
    parameters: estimation.Parameters = field(init=False, compare=False, repr=False)
    """The unknowns as changes, about nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "parameters", estimation.Parameters(self.names, np.zeros(len(self.names)), self.width))

    @property
    def names(self) -> tuple[str, ...]:
        """(p,) of the unknowns."""
        return self.unknowns.names

    @cached_property
    def width(self) -> FloatArray:
        """(p,) prior standard uncertainties in the units of the names."""
        return self.unknowns.width / self.unknowns.size

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) modelled less measured, of the components that were measured."""
        return -self.linearised(theta).residuals[self.rows.known]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p)."""
        return self.linearised(theta).jacobian[self.rows.known]

    def covariance(self, theta: FloatArray) -> FloatArray:
        """(e, e)."""
        known = self.rows.known
        row, component = np.nonzero(known)
        of = self.blocks[row[:, None], component[:, None], component[None, :]] / np.maximum(self.counts, EXCLUDED)[row][:, None]
        return np.where(row[:, None] == row[None, :], of, 0.0)

    @property
    def counts(self) -> FloatArray:
        """(N,) how much the rows' information counts."""
        return np.ones(len(self.rows)) if self.weight is None else self.trust * self.weight

    @cached_property
    def blocks(self) -> FloatArray:
        """(N, 6, 6) of a row's components, the identity where nothing was measured."""
        known = self.rows.known
        out = self.rows.covariance + np.diag(self.noise.variance)
        out = out * (known[:, :, None] & known[:, None, :])
        return np.asarray(out + (~known)[:, :, None] * np.eye(6))

    @cached_property
    def _whitening(self) -> FloatArray:
        """(N, 6, 6), or (N, 6, 1) where no component is correlated with another."""
        C, root = self.blocks, np.sqrt(self.counts)[:, None, None]
        variance = np.einsum("nii->ni", C)
        if np.count_nonzero(C) == variance.size:
            return np.asarray(root / np.sqrt(variance)[:, :, None])
        return np.asarray(root * np.linalg.inv(np.linalg.cholesky(C)))

    def linearised(self, theta: FloatArray) -> "Linear":
        """What the unknowns predict at theta (p,) and near it."""
        residuals, jacobian = self.unknowns.linearised(theta * self.unknowns.size, self.rows)
        return Linear(residuals, jacobian * self.unknowns.size)

    def shifted(self, at: "Linear", step: FloatArray) -> "Linear":
        """The same a small step (p,) farther."""
        return Linear(at.residuals - at.jacobian @ step, at.jacobian)

    def whitened(self, at: "Linear") -> tuple[FloatArray, FloatArray]:
        """(e,) residuals, measured less predicted, in standard deviations, and (e, p) derivatives of what is predicted."""
        known, W = self.rows.known, self._whitening
        if W.shape[2] == 1:
            return (at.residuals * W[:, :, 0])[known], at.jacobian[known] * W[known]
        return (W @ at.residuals[:, :, None])[:, :, 0][known], (W @ at.jacobian)[known]


@dataclass(frozen=True)
class Linear:
    """residuals (N, 6), measured less predicted; jacobian (N, 6, p) of what is predicted by the unknowns in the units of their names."""

    residuals: FloatArray
    jacobian: FloatArray


@dataclass(frozen=True)
class Fit(Optimum[Linear], Generic[R]):
    """The optimum of an identification: theta (p,) are changes in the units of the names."""

    problem: Problem[R]

    @property
    def counted(self) -> float:
        """Residuals, each as much as the weight of its row."""
        weight = self.problem.weight
        return float(self.equations) if weight is None else float(weight @ self.problem.rows.known.sum(axis=1))

    @property
    def spare(self) -> float:
        """The same less what they determine."""
        return self.counted - self.told

    @property
    def freedom(self) -> float:
        """The same, as degrees of freedom: 1 at least."""
        return max(self.spare, 1.0)

    @property
    def x(self) -> FloatArray:
        """(p,) changes in rad and mm."""
        return self.theta * self.problem.unknowns.size


def solved(problem: Problem[R], start: FloatArray, at: Linear | None = None) -> Fit[R]:
    """The optimum near start (p,), with the priors everywhere, which are too wide to move what is determined.

    at: what is predicted near start, where it is known already.
    """
    return Fit(**vars(optimum(problem, start, at)), problem=problem)


def with_noise(problem: Problem[R], start: FloatArray) -> Fit[R]:
    """The optimum with the robot's noise as the residuals show it: what they scatter beyond what the instrument states."""
    fit = solved(problem, start)
    for _ in range(ROUNDS if problem.own_noise else 0):
        before = fit.problem.noise
        now = _noise(fit)
        fit = solved(replace(fit.problem, noise=now), fit.theta, fit.at)
        if _near(before.position_mm, now.position_mm) and _near(before.rotation_rad, now.rotation_rad):
            break
    return fit


def weighted(fit: Fit[R]) -> Fit[R]:
    """The optimum with every row weighed by Tukey's biweight of what all others say of it, begun with the weights that the fit has.

    Weights and the robot's noise are found together. Judged first by the median of all rows, which half of them may spoil: a noise that
    was found with bad rows among the others would hide them.
    """
    components = fit.problem.rows.known.sum(axis=1)
    seen, middle = components > 0, 1.0
    for again in range(WEIGHT_ROUNDS):
        square = distances(fit, fit.problem, fit.at, fit.problem.counts)
        z = normal_deviates(square[seen], components[seen])
        middle = float(np.median(z)) / NORMAL_MEDIAN if not again else 1.0
        weight = np.zeros(len(components))
        weight[seen] = biweights(z / middle)
        before = fit.problem.weight
        problem = replace(fit.problem, weight=weight, trust=trust(square[seen], components[seen], weight[seen], fit.told))
        problem = replace(problem, noise=_noise(replace(fit, problem=problem))) if problem.own_noise else problem
        fit = solved(problem, fit.theta, fit.at)
        if before is not None and np.abs(weight - before).max() < SETTLED:
            break
    return fit


def distances(fit: Fit[R], problem: Problem[R], at: Linear, counts: FloatArray) -> FloatArray:
    """(N,) squared distance of the residual of each row of a problem, seen at the fit's optimum, from nothing in its own covariance, that
    of the prediction included; as in a fit without the row where it counted (N,) in this one."""
    known = problem.rows.known
    explained = at.jacobian @ fit.covariance @ np.swapaxes(at.jacobian, 1, 2) * (known[:, :, None] & known[:, None, :])
    return deletion_squares(np.where(known, at.residuals, 0.0), problem.blocks, explained, counts)


def _noise(fit: Fit[R]) -> Noise:
    """Moments: a component's residual has the variance (stated + robot's)(1 - leverage)."""
    problem = fit.problem
    known = problem.rows.known
    jacobian = fit.at.jacobian[known]
    explained = np.zeros(known.shape)
    explained[known] = ((jacobian @ fit.covariance) * jacobian).sum(axis=1)
    total = np.einsum("nii->ni", problem.blocks)
    stated = np.einsum("nii->ni", problem.rows.covariance)
    counts = problem.counts[:, None]
    # what is left of a component that is used up to determine the unknowns tells nothing of noise
    share = explained / total
    left = np.clip((1.0 - counts * share) * (1.0 - counts * share + share), 1e-3, 1.0)
    weight, of_normal = np.ones(len(known)), np.ones(len(known))
    if problem.weight is not None:
        weight, of_normal = problem.weight, np.array([scatter(int(m)) if m else 1.0 for m in known.sum(axis=1)])
    out = []
    for own, least in ((POSITION, LEAST_MM), (ROTATION, LEAST_RAD)):
        of = known[:, own]
        if not of.any():
            out.append(least)
            continue
        r, c, v, spared = fit.at.residuals[:, own][of], stated[:, own][of], total[:, own][of], left[:, own][of]
        times, normal = (np.broadcast_to(x[:, None], of.shape)[of] for x in (weight, of_normal))
        times = times / v**2
        out.append(max(float(times @ (r**2 / normal - c * spared)) / float(times @ spared), 0.0) ** 0.5)
        if not c.all():
            out[-1] = max(out[-1], least)
    return Noise(out[0], out[1])


def _near(one: float, other: float) -> bool:
    return abs(one - other) <= SETTLED * max(one, other)
