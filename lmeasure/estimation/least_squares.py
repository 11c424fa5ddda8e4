"""Least squares: the optimum of a problem, with priors where the data are silent.

Everything is done in z = (theta - nominal)/prior_u, so that the prior is a unit normal, and with residuals whitened by their covariance V.
The singular values s of the whitened Jacobian in z compare the data with the prior along each direction: u_data = prior_u/s. The data do
not determine a direction with s < 1: there, and only there, the prior decides (unless it acts everywhere).
"""

from dataclasses import replace

import numpy as np
import scipy

from lmeasure.core import BoolArray, FloatArray
from lmeasure.estimation import elimination
from lmeasure.estimation.problem import Fit, Problem, gains, untaken

MAX_STEPS = 100
ROUGH = 1e-6  # of an objective: where those of hypotheses are compared, which differ by far
PLATEAU = 1e-6  # probability of residuals under which an optimum with directions that no residual determines is none
HUGE = 1e50
FLOOR = 3.0  # standard uncertainties of the data, within which a step may also go along the valley


class Whitened:
    """Whitened residuals and Jacobian of a problem in z, for one covariance V (e, e) of the residuals."""

    def __init__(self, problem: Problem, V: FloatArray) -> None:
        self.problem = problem
        # invert once: it is applied hundreds of times, and V is far from singular (every reading has an error of its own)
        diagonal = np.sqrt(np.diag(V))
        correlated = np.count_nonzero(V) > len(V)
        self._W = np.linalg.inv(np.linalg.cholesky(V)) if correlated else 1.0 / diagonal[:, None]
        self._nominal, self._width = problem.parameters.nominal, problem.parameters.width

    def theta(self, z: FloatArray) -> FloatArray:
        return np.asarray(self._nominal + self._width * z)

    def residuals(self, z: FloatArray) -> FloatArray:
        return self.whiten(self.problem.residuals(self.theta(z))[:, None])[:, 0]

    def jacobian(self, z: FloatArray) -> FloatArray:
        return self.whiten(self.problem.jacobian(self.theta(z)) * self._width)

    def whiten(self, columns: FloatArray) -> FloatArray:
        """(e, c) columns of errors of the residuals with unit covariance instead of V."""
        return np.asarray(self._W * columns if self._W.shape[1] == 1 else self._W @ columns)


def fit_from_starts(problem: Problem, start: FloatArray, starts: int = 32, *, seed: int = 0) -> Fit:
    """Return the optimum from a start (P,), and from others while it is a plateau: residuals that hardly change and are far too large.

    Other starts lie about the nominal values, by turns within 1, 0.1, 0.01 and 0.001 of the priors' widths.
    """
    best = fit(problem, start)
    normal = scipy.stats.norm.ppf(0.001 + 0.998 * scipy.stats.qmc.Sobol(len(start), rng=seed).random(starts))
    for i, z in enumerate(normal):
        if not _plateau(best):
            break
        other = problem.parameters.nominal + problem.parameters.width * z * 10.0 ** -(i % 4)
        # a start where the model overflows is none
        if np.nan_to_num(np.abs(problem.residuals(other)), nan=np.inf).max() < HUGE:
            best = min(best, fit(problem, other), key=lambda found: found.objective)
    return replace(best, converged=best.converged and not _plateau(best))


def _plateau(found: Fit) -> bool:
    lost = not found.known.all() and found.freedom > 0
    return lost and bool(scipy.stats.chi2.sf(found.chi2, found.freedom) < PLATEAU)


def fit(problem: Problem, start: FloatArray, prior_everywhere: bool = False, near: bool = False, *, roughly: bool = False) -> Fit:
    """Return the optimum nearest to start (P,): first with the prior on every direction, which is always well posed; then, unless the prior
    acts everywhere, without the prior on directions that the data determine. near: start is an optimum under hardly different weights, so
    that only the second part is needed. roughly: few digits, to compare objectives that differ by far.

    CalibrationError if the residuals do not determine all nuisance parameters.
    """
    if problem.nuisance is not None:
        return elimination.fit(problem, start, prior_everywhere, near)
    z = (start - problem.parameters.nominal) / problem.parameters.width
    converged, most = True, len(z)
    V = problem.covariance(start)
    # the optimum needs many digits only where nothing follows it
    precision = ROUGH if roughly else 1e-13 if prior_everywhere else 1e-7
    # the second round has the covariance at the optimum
    for again in range(2 if problem.covariance_varies else 1):
        w = Whitened(problem, V)
        if prior_everywhere or not (near or again):
            found = scipy.optimize.least_squares(
                lambda z, w=w: np.concatenate([w.residuals(z), z]),
                z,
                jac=lambda z, w=w: np.vstack([w.jacobian(z), np.eye(len(z))]),
                method="lm",
                x_scale=1.0,
                ftol=precision,
                xtol=precision,
                gtol=precision,
                max_nfev=400,
            )
            z, converged = found.x, found.status > 0
        if not prior_everywhere:
            z, converged, most = _release(w, z)
        V = problem.covariance(w.theta(z))
    return _described(problem, z, V, prior_everywhere, converged, most)


def _split(w: Whitened, z: FloatArray, most: int) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Singular value decomposition of the whitened Jacobian, and which directions the data determine: at most so many."""
    U, s, Vt = np.linalg.svd(w.jacobian(z), full_matrices=False)
    if len(s) < len(z):
        # the directions that no equation touches
        Vt = np.vstack([Vt, scipy.linalg.null_space(Vt).T])
        s = np.concatenate([s, np.zeros(len(z) - len(s))])
    return U, s, Vt, (s > 1.0) & (np.arange(len(z)) < most)


def _release(w: Whitened, z: FloatArray) -> tuple[FloatArray, bool, int]:
    """Fit the data by Gauss-Newton in the directions they determine, and return to the nominal value in the others. It walks along a curved
    valley: a step towards the nominal value may leave the floor by WALL standard uncertainties of the data, which the next ones repair. It
    has converged if the next step is a hundredth of the standard uncertainty. A direction may be determined at its own optimum and not at
    the nominal value, or the reverse; one that keeps changing sides is left to its prior. Return the result, its convergence, and the
    number of determined directions."""
    r = w.residuals(z)
    settled, most = False, len(z)
    for step_number in range(MAX_STEPS):
        U, s, Vt, known = _split(w, z, most)
        if step_number >= elimination.UNDECIDED:
            most = min(most, int(known.sum()))
        k = np.flatnonzero(known)
        misfit, silent = U[:, k].T @ r, Vt[~known]
        away = silent @ z
        off = float(np.linalg.norm(misfit))
        settled = off < elimination.SETTLED and float(np.linalg.norm(away)) < elimination.SETTLED
        step = -Vt[k].T @ (misfit / s[k])
        if off < FLOOR:
            step -= silent.T @ away
        size = float(np.linalg.norm(step))
        if size < 1e-9 * (1.0 + float(np.linalg.norm(z))):
            return z + step, True, most
        fraction = min(1.0, 2.0 / size)
        for _ in range(12):
            trial = z + fraction * step
            r_trial = w.residuals(trial)
            if float(np.linalg.norm(r_trial)) <= max(float(np.linalg.norm(r)), elimination.WALL):
                break
            fraction *= 0.5
        else:
            return z, settled, most
        z, r = trial, r_trial
    return z, settled, most


def _described(problem: Problem, z: FloatArray, V: FloatArray, prior_everywhere: bool, converged: bool, most: int) -> Fit:
    w = Whitened(problem, V)
    _, s, Vt, known = _split(w, z, most)
    sigma = gains(s, known, prior_everywhere)[2]
    width = problem.parameters.width
    covariance = (Vt.T * sigma**2) @ Vt * np.outer(width, width)
    r, theta, penalty = w.residuals(z), w.theta(z), z if prior_everywhere else Vt[~known] @ z
    return Fit(
        problem=problem, theta=theta, residuals=problem.residuals(theta), V=V, s=s, directions=Vt, known=known,
        prior_everywhere=prior_everywhere, covariance=np.asarray((covariance + covariance.T) / 2), chi2=float(r @ r),
        prior_misfit=float(penalty @ penalty), nominal_misfit=float(z @ z), converged=converged, lost=untaken(problem, V),
    )  # fmt: skip
