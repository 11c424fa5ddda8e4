"""Sizes of groups of errors, estimated together from the residuals that they leave (variance components).

Residuals r ~ N(J theta, V) with V = V_0 + sum_g s_g^2 A_g, with theta free. With N a basis of the space that no theta changes, the
restricted likelihood (Patterson and Thompson, Biometrika 58, 1971) is that of N'r ~ N(0, N'VN). A size s_g is in units of the typical one,
that of A_g. Its prior is the modulus of a Student variate of `FREEDOM` degrees of freedom, scaled to the mean square 1 (Gelman, Bayesian
Analysis 1, 2006). A group that the residuals do not show keeps its typical mean square. One that they show to be absent may be zero, and
others may be many times as large. The posterior of x_g = log s_g is drawn by Metropolis steps along each x_g from the mode.
"""

from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.core import FloatArray

FREEDOM = 4.0
BURNT = 6
STEPS = 12
ENOUGH = 0.01  # Gain in the logarithm of the density at which the mode is near enough to begin there
FARTHEST = 7.0  # Logarithms of sizes beyond this are no result


@dataclass(frozen=True)
class Sizes:
    """Sizes (g,) in units of the typical ones, root mean squares of the posterior; draws (k, g) of them."""

    size: FloatArray
    draws: FloatArray


class _Restricted:
    """The posterior of logarithms of sizes x (g,)."""

    def __init__(self, r: FloatArray, J: FloatArray, V: FloatArray, parts: list[FloatArray]) -> None:
        Q, _ = np.linalg.qr(J, mode="complete")
        N = Q[:, J.shape[1] :]
        L = np.linalg.cholesky(N.T @ V @ N)

        def white(M: FloatArray) -> FloatArray:
            return np.asarray(scipy.linalg.solve_triangular(L, M, lower=True))

        self._r = white(N.T @ r)
        self._A = np.array([white(white(N.T @ A @ N).T) for A in parts])

    def __call__(self, x: FloatArray) -> float:
        """Minus the logarithm of the posterior density."""
        V = np.eye(len(self._r)) + np.tensordot(np.exp(2.0 * x), self._A, 1)
        L = np.linalg.cholesky(V)
        y = scipy.linalg.solve_triangular(L, self._r, lower=True)
        return float(np.log(np.diag(L)).sum() + 0.5 * y @ y + np.sum(0.5 * (1.0 + FREEDOM) * np.log1p(_scaled(x)) - x))

    def derivatives(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient and expected second derivatives of it."""
        s2, f = np.exp(2.0 * x), _scaled(x)
        P = np.linalg.inv(np.eye(len(self._r)) + np.tensordot(s2, self._A, 1))
        PA = P @ self._A
        y = P @ self._r
        gradient = s2 * (np.einsum("gii->g", PA) - np.einsum("i,gij,j->g", y, self._A, y)) + (1.0 + FREEDOM) * f / (1.0 + f) - 1.0
        information = 2.0 * np.outer(s2, s2) * np.einsum("gij,hji->gh", PA, PA) + np.diag(2.0 * (1.0 + FREEDOM) * f / (1.0 + f) ** 2)
        return gradient, information


def _scaled(x: FloatArray) -> FloatArray:
    """Squares of the Student variates of these logarithms of sizes, over the degrees of freedom."""
    return np.asarray(np.exp(2.0 * x) / (FREEDOM - 2.0))


def sizes(
    r: FloatArray, J: FloatArray, V: FloatArray, parts: list[FloatArray], *, sweeps: int, begun: Sizes | None = None, seed: int = 0
) -> Sizes:
    """Return the sizes of groups of errors, parts (e, e) of the covariance of residuals r (e,) at their typical sizes, beside V (e, e).

    J (e, p): derivatives by free parameters; sweeps: number of draws, 0 for the mode alone; begun: sizes near the mode.
    """
    loss = _Restricted(r, J, V, parts)
    x = np.zeros(len(parts)) if begun is None else np.log(begun.size)
    if begun is None or not sweeps:
        x = _mode(loss, x)
    if not sweeps:
        return Sizes(np.exp(x), np.exp(x)[None])
    # a step crosses the range in which the density is of the order of its mode's
    width = 2.4 / np.sqrt(np.clip(np.diag(loss.derivatives(x)[1]), 0.3, 100.0))
    rng = np.random.default_rng([seed, 43])
    now, draws = loss(x), []
    for sweep in range(sweeps + BURNT):
        for g, step in enumerate(width * rng.normal(size=len(x))):
            there = x.copy()
            there[g] += step
            if abs(there[g]) > FARTHEST:
                continue
            other = loss(there)
            if np.log(rng.uniform()) < now - other:
                x, now = there, other
        if sweep >= BURNT:
            draws.append(np.exp(x))
    every = np.array(draws)
    return Sizes(np.sqrt(np.mean(every**2, axis=0)), every)


def _mode(loss: _Restricted, x: FloatArray) -> FloatArray:
    """The most probable logarithms of sizes, by Fisher's scoring from x."""
    least = loss(x)
    for _ in range(STEPS):
        gradient, information = loss.derivatives(x)
        step = -np.linalg.solve(information + 1e-3 * np.eye(len(x)), gradient)
        step *= min(1.0, 1.5 / max(float(np.abs(step).max()), 1e-300))
        for _ in range(8):
            now = loss(x + step)
            if now <= least:
                break
            step *= 0.5
        else:
            break
        x, done, least = x + step, least - now < ENOUGH, now
        if done:
            break
    return x
