"""Least squares of many residuals and few parameters, with priors everywhere: Levenberg's steps by normal equations.

For problems whose residuals come in small blocks that do not correlate with each other, thousands of them: a problem whitens its own
residuals block by block, so that no covariance (e, e) is ever formed. The priors must be too wide to move what is determined.
"""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np

from lmeasure.arrays import FloatArray

STEPS = 60
SMALL = 1e-4
"""Of a standard uncertainty: a step that is smaller ends."""
L = TypeVar("L")


class Blockwise(Protocol[L]):
    """What is to be estimated: changes theta (p,) of parameters, with normal priors about nothing of standard uncertainties width (p,)."""

    @property
    def width(self) -> FloatArray:
        """(p,)."""

    def linearised(self, theta: FloatArray) -> L:
        """What is predicted at theta and near it."""

    def whitened(self, at: L) -> tuple[FloatArray, FloatArray]:
        """(e,) residuals, measured less predicted, in standard deviations, and (e, p) derivatives of what is predicted."""

    def shifted(self, at: L, step: FloatArray) -> L:
        """The same a step (p,) farther, so small that nothing but the residuals changes."""


@dataclass(frozen=True)
class Optimum(Generic[L]):
    """theta (p,), its covariance (p, p), information (p, p) of the residuals alone, chi2 of them, how many, whether it settled, and what is
    predicted there."""

    theta: FloatArray
    covariance: FloatArray
    information: FloatArray
    chi2: float
    equations: int
    converged: bool
    at: L


def optimum(problem: Blockwise[L], start: FloatArray, at: L | None = None) -> Optimum[L]:
    """The optimum near start (p,). at: what is predicted near start, where it is known already."""
    theta, damping = start.copy(), 0.0
    at = problem.linearised(theta) if at is None else at
    prior = 1.0 / problem.width**2
    residuals, jacobian = problem.whitened(at)
    now = float(residuals @ residuals + theta @ (prior * theta))
    converged = False
    information = jacobian.T @ jacobian
    for _ in range(STEPS):
        normal = information + np.diag(prior)
        size = 1.0 / np.sqrt(np.diag(normal))
        scaled, downhill = normal * np.outer(size, size), size * (jacobian.T @ residuals - prior * theta)
        step = size * np.linalg.solve(scaled, downhill)
        # how far the whole step goes in standard uncertainties: one made short by damping says nothing of that
        if float(step @ normal @ step) < SMALL**2:
            theta, converged, at = theta + step, True, problem.shifted(at, step)
            residuals = residuals - jacobian @ step
            break
        if damping > 0.0:
            step = size * np.linalg.solve(scaled + damping * np.eye(len(size)), downhill)
        tried = problem.linearised(theta + step)
        r, j = problem.whitened(tried)
        then = float(r @ r + (theta + step) @ (prior * (theta + step)))
        if then <= now:
            theta, at, residuals, jacobian, now = theta + step, tried, r, j, then
            information = jacobian.T @ jacobian
            damping = damping / 10.0 if damping > 1e-9 else 0.0
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e8:
                break
    normal = information + np.diag(prior)
    size = 1.0 / np.sqrt(np.diag(normal))
    covariance = np.linalg.inv(normal * np.outer(size, size)) * np.outer(size, size)
    return Optimum(theta, (covariance + covariance.T) / 2, information, float(residuals @ residuals), len(residuals), converged, at)
