"""Sizes of groups of errors, estimated together from the residuals that they leave (variance components).

Residuals r ~ N(J theta, V) with V = V_0 + sum_g s_g^2 A_g, where theta is free. With N a basis of what no theta changes, the restricted
likelihood (Patterson and Thompson, Biometrika 58, 1971) is that of N'r ~ N(0, N'VN). A size s_g is known before to within a wide factor of
the typical one, which A_g has: x_g = log s_g has the density sech(x_g / WIDE), as the logarithm of a half-Cauchy variate has it (Gelman,
Bayesian Analysis 1, 2006). The mode is found by Fisher's scoring, and the posterior of x by importance sampling about it.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg

from lmeasure.core import FloatArray

WIDE = 1.0
SAMPLES = 64
MORE = 1.3
STEPS = 30


@dataclass(frozen=True)
class Sizes:
    """Sizes (g,) in units of the typical ones, root mean squares of the posterior; draws (k, g) of them with weights (k,).

    A size that the residuals hardly show has no bounded mean square: it is the typical size then, or a little over the geometric mean.
    """

    size: FloatArray
    draws: FloatArray
    weight: FloatArray


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
        return float(np.log(np.diag(L)).sum() + 0.5 * y @ y + np.sum(np.logaddexp(x / WIDE, -x / WIDE)))

    def derivatives(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Gradient and expected second derivatives of it."""
        s2 = np.exp(2.0 * x)
        P = np.linalg.inv(np.eye(len(self._r)) + np.tensordot(s2, self._A, 1))
        PA = P @ self._A
        y = P @ self._r
        gradient = s2 * (np.einsum("gii->g", PA) - np.einsum("i,gij,j->g", y, self._A, y)) + np.tanh(x / WIDE) / WIDE
        information = 2.0 * np.outer(s2, s2) * np.einsum("gij,hji->gh", PA, PA) + np.diag(1.0 / np.cosh(x / WIDE) ** 2) / WIDE**2
        return gradient, information


def sizes(r: FloatArray, J: FloatArray, V: FloatArray, parts: list[FloatArray], *, seed: int = 0) -> Sizes:
    """Return the sizes of groups of errors, parts (e, e) of the covariance of residuals r (e,) at their typical sizes, beside V (e, e).

    J (e, p): derivatives by what is free.
    """
    loss, x = _Restricted(r, J, V, parts), np.zeros(len(parts))
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
        x, done, least = x + step, least - now < 1e-6, now
        if done:
            break
    information = loss.derivatives(x)[1]
    values, vectors = np.linalg.eigh(information)
    root = vectors / np.sqrt(np.clip(values, 0.25, None))
    rng = np.random.default_rng([seed, 43])
    half = rng.normal(size=(SAMPLES // 2, len(x)))
    # Student's distribution of five degrees of freedom has the tails that the posterior has
    stretch = np.sqrt(5.0 / rng.chisquare(5.0, SAMPLES // 2))[:, None]
    every = np.vstack([half * stretch, -half * stretch])
    draws = x + every @ root.T
    log_p = -np.array([loss(d) for d in draws])
    log_q = -0.5 * (5.0 + len(x)) * np.log1p(np.sum(every**2, axis=1) / 5.0)
    weight = np.exp(log_p - log_q - (log_p - log_q).max())
    weight /= weight.sum()
    size, every = np.exp(weight @ draws), np.exp(draws)
    return Sizes(np.minimum(np.sqrt(weight @ every**2), np.maximum(MORE * size, 1.0)), every, weight)
