"""Least squares of many residuals and few parameters, with priors everywhere: Levenberg's steps.

For problems whose residuals come in small blocks that do not correlate with each other, thousands of them: a problem whitens its own
residuals block by block, so that no covariance (e, e) is ever formed. The priors must be too wide to move determined values.
"""

from dataclasses import dataclass
from typing import Generic, Protocol, TypeVar

import numpy as np
import scipy

from lmeasure.core import FloatArray

STEPS = 60
SMALL = 1e-4  # Of a standard uncertainty: a step that is smaller ends
L = TypeVar("L")


class Blockwise(Protocol[L]):
    """Unknowns: changes theta (p,) of parameters, with normal priors about nothing of standard uncertainties width (p,)."""

    @property
    def width(self) -> FloatArray:
        """(p,)."""

    def linearised(self, theta: FloatArray) -> L:
        """Return the prediction at theta and near it."""

    def whitened(self, at: L) -> tuple[FloatArray, FloatArray]:
        """Return (e,) residuals, measured minus predicted, in standard deviations, and (e, p) derivatives of the prediction."""

    def shifted(self, at: L, step: FloatArray) -> L:
        """The same a step (p,) farther, so small that nothing but the residuals changes."""


@dataclass(frozen=True)
class Optimum(Generic[L]):
    """theta (p,), its covariance (p, p), information (p, p) of the residuals alone; determined: number of parameters that they determine,
    partly with the priors; chi2, its number of residuals, convergence, and the prediction there."""

    theta: FloatArray
    covariance: FloatArray
    information: FloatArray
    determined: float
    chi2: float
    equations: int
    converged: bool
    at: L


def optimum(problem: Blockwise[L], start: FloatArray, at: L | None = None) -> Optimum[L]:
    """Return the optimum near start (p,). at: the prediction near start, if already known."""
    theta, damping, width = start.copy(), 0.0, problem.width
    at = problem.linearised(theta) if at is None else at
    residuals, jacobian = problem.whitened(at)
    now = float(residuals @ residuals + (theta / width) @ (theta / width))
    converged, triangle = False, _triangle(jacobian * width, residuals, theta / width)
    for _ in range(STEPS):
        # length of the full step in standard uncertainties; a damped step does not show it
        if float(np.linalg.norm(triangle[:-1, -1])) < SMALL:
            step = width * _solved(triangle)
            theta, converged, at = theta + step, True, problem.shifted(at, step)
            residuals = residuals - jacobian @ step
            break
        if damping > 0.0:
            held = np.diag(np.sqrt(damping) * np.linalg.norm(triangle[:-1, :-1], axis=0))
            damped = np.vstack([triangle[:-1], np.column_stack([held, np.zeros(len(theta))])])
            step = width * _solved(np.asarray(np.linalg.qr(damped, mode="r")))
        else:
            step = width * _solved(triangle)
        tried = problem.linearised(theta + step)
        r, j = problem.whitened(tried)
        then = float(r @ r + ((theta + step) / width) @ ((theta + step) / width))
        if then <= now:
            theta, at, residuals, jacobian, now = theta + step, tried, r, j, then
            triangle = _triangle(jacobian * width, residuals, theta / width)
            damping = damping / 10.0 if damping > 1e-9 else 0.0
        else:
            damping = max(10.0 * damping, 1e-6)
            if damping > 1e8:
                break
    root = width[:, None] * scipy.linalg.solve_triangular(triangle[:-1, :-1], np.eye(len(theta)))
    determined = len(theta) - float(((root / width[:, None]) ** 2).sum())
    return Optimum(theta, root @ root.T, jacobian.T @ jacobian, determined, float(residuals @ residuals), len(residuals), converged, at)


def _triangle(jacobian: FloatArray, residuals: FloatArray, off: FloatArray) -> FloatArray:
    """Return the (p + 1, p + 1) triangle of a QR decomposition of residuals and priors, in prior widths, with their values in its last
    column. Normal equations would square the ratio of a prior of a hundred metres to a residual of a micrometre, and lose values that only
    priors fix."""
    p = len(off)
    rows = np.vstack([np.column_stack([jacobian, residuals]), np.column_stack([np.eye(p), -off])])
    return np.asarray(np.linalg.qr(rows, mode="r"))


def _solved(triangle: FloatArray) -> FloatArray:
    """(p,) the step to where the residuals and priors of a triangle are least."""
    p = triangle.shape[1] - 1
    return np.asarray(scipy.linalg.solve_triangular(triangle[:p, :p], triangle[:p, p]))
