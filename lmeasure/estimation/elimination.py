"""Nuisance parameters eliminated: the optimum of a problem in which each measurement has unknowns of its own.

With r = r0 + A da + P dp, da of the parameters and dp of the nuisance parameters, and N a basis of the normal space of P (its columns are
combinations of residuals that no nuisance parameter can change), N'r = N'r0 + N'A da is a problem like any other, its covariance N'VN; dp
follows from the generalised least squares of the rest. A block that is not shared touches its own residuals only, so that N is made block
by block. Gauss-Newton with the elimination at each step is variable projection (Golub and Pereyra 1973, in Kaufman's form).

If all may move without a change of residuals, the problem's gauge chooses: the free network of surveying (Mikhail and Ackermann,
Observations and Least Squares, 1976, ch. 9).
"""

import numpy as np
import scipy

from lmeasure.core import CalibrationError, FloatArray, IntArray
from lmeasure.estimation.problem import Fit, Nuisance, Problem, gains, untaken

MAX_STEPS = 80
UNDECIDED = 25  # steps after which a direction that was undetermined once stays so
SETTLED = 0.01  # of a standard uncertainty
WALL = 30.0  # standard uncertainties of the data, from where Gauss-Newton comes back to the floor of a valley
FINE = 0.1 * SETTLED  # remaining step at convergence, in standard uncertainties
RANK = 1e-10  # relative to the largest singular value of a block's derivatives: below it the block is not completely determined
IN_SPAN = 0.99  # cosine from which a direction is a motion of the gauge


def fit(problem: Problem, start: FloatArray, prior: bool, near: bool) -> Fit:
    """Gauss-Newton with the nuisance parameters eliminated at each step; first with the prior on every direction of the parameters, then
    only where the data are silent, as `least_squares.fit` does, whose near this is."""
    own, width = problem.own, problem.parameters.width
    theta, most, converged = start.copy(), own, False
    V = problem.covariance(theta)
    for everywhere in (True,) if prior else (False,) if near else (True, False):
        r = problem.residuals(theta)
        for number in range(MAX_STEPS):
            z = (theta[:own] - problem.parameters.nominal) / width
            part = Eliminated(problem, theta, V, most)
            if not everywhere and number >= UNDECIDED:
                most = min(most, int(part.known.sum()))
            determined, away = part.determined(r), part.Vt @ z
            if everywhere:
                dz = -part.Vt.T @ ((part.s * determined + away) / (1.0 + part.s**2))
                converged = float(np.linalg.norm(dz)) < FINE
            else:
                dz = -part.Vt.T @ np.where(part.known, determined / np.where(part.known, part.s, 1.0), away)
                converged = max(float(np.linalg.norm(determined[part.known])), float(np.linalg.norm(away[~part.known]))) < FINE
            dp, fraction = part.follow_up(r, dz), min(1.0, 2.0 / max(float(np.linalg.norm(dz)), 1e-300))
            now = part.merit(r, z, everywhere)
            for _ in range(12):
                trial = theta + fraction * np.r_[dz * width, dp]
                r_trial = problem.residuals(trial)
                then = part.merit(r_trial, z + fraction * dz, everywhere)
                # towards the nominal values the way may leave the valley's floor a little, which the next step mends
                if then <= now * (1 + 1e-10) or (not everywhere and then <= WALL**2):
                    break
                fraction *= 0.5
            else:
                break
            theta, r = trial, r_trial
            if converged:
                break
        V = problem.covariance(theta)
    framed = problem.gauge is not None and not (prior and problem.gauge.keeps_prior)
    if framed and problem.gauge is not None:
        theta = problem.gauge.settled(theta)
        V = problem.covariance(theta)
    return _described(problem, theta, V, prior, Eliminated(problem, theta, V, most), converged, framed)


def linear_objective(problem: Problem) -> float:
    """`Fit.objective` of the best fit with the prior everywhere, as the problem linearised at its start has it; infinite where that cannot
    be."""
    theta = problem.start
    if problem.nuisance is None:
        r = problem.residuals(theta)
        if not np.isfinite(r).all():
            return float("inf")
        V = problem.covariance(theta)
        along = problem.jacobian(theta) * problem.parameters.width
        return float(r @ np.linalg.solve(V + along @ along.T, r))
    part = Eliminated(problem, theta, problem.covariance(theta), problem.own)
    r = problem.residuals(theta)
    determined = part.determined(r)
    return float(np.sum((part.W @ r) ** 2) - np.sum(determined**2 * part.s**2 / (1.0 + part.s**2)))


class Eliminated:
    """The linear problem at a point: r = r0 + A dz + P dp, dz of the parameters in prior widths, dp of the nuisance parameters."""

    def __init__(self, problem: Problem, theta: FloatArray, V: FloatArray, most: int) -> None:
        assert problem.nuisance is not None
        own, J = problem.own, problem.jacobian(theta)
        self.A, self.V = J[:, :own] * problem.parameters.width, V
        N, self.inverse, self.loose = _eliminate(problem.nuisance, J[:, own:])
        self.W = scipy.linalg.solve_triangular(np.linalg.cholesky(N.T @ V @ N), N.T, lower=True)
        # all directions of the parameters, but only the observed ones of the residuals
        self.U, s, self.Vt = np.linalg.svd(self.W @ self.A, full_matrices=len(self.W) < own)
        self.s = np.r_[s, np.zeros(own - len(s))]
        self.known = (self.s > 1.0) & (np.arange(own) < most)

    def determined(self, r: FloatArray) -> FloatArray:
        """(p,) components of the residuals along the directions of the parameters, 0 where there is no equation."""
        out = np.zeros(len(self.s))
        count = min(len(self.s), self.U.shape[1])
        out[:count] = self.U[:, :count].T @ (self.W @ r)
        return out

    def merit(self, r: FloatArray, z: FloatArray, everywhere: bool) -> float:
        """Return the value that a step must not increase: residuals that no nuisance parameter can remove, and with the prior the distance
        from the nominal values."""
        return float(np.sum((self.W @ r) ** 2) + (z @ z if everywhere else 0.0))

    def follow_up(self, r: FloatArray, dz: FloatArray) -> FloatArray:
        """The nuisance parameters' step that goes with the parameters'."""
        return -self.follow(r + self.A @ dz)

    def follow(self, columns: FloatArray) -> FloatArray:
        """(d b, ...) generalised least squares of the nuisance parameters to residuals (e, ...)."""
        return np.asarray(self.inverse @ (columns - self.V @ (self.W.T @ (self.W @ columns))))


def _eliminate(nuisance: Nuisance, P: FloatArray) -> tuple[FloatArray, FloatArray, list[int]]:
    """Return an orthonormal basis N (e, e - rank) of the normal space of the nuisance parameters' derivatives P (e, d b), a left inverse (d
    b, e) of P, and the blocks that P determines only in part."""
    e, d = len(P), nuisance.size
    columns = np.arange(P.shape[1]).reshape(-1, d)
    inverse, loose = np.zeros((P.shape[1], e)), []
    of_shared = np.flatnonzero(np.isin(nuisance.of, nuisance.shared))
    N = np.zeros((e, e))
    N[of_shared, np.arange(len(of_shared))] = 1.0
    used = len(of_shared)
    for blocks, rows in nuisance.alike:
        own = columns[blocks]
        left, back, rank = _apart(P[rows[:, :, None], own[:, None, :]])
        inverse[own[:, :, None], rows[:, None, :]] = back
        loose += blocks[rank < d].tolist()
        # a block that is not wholly determined ends the estimation: its part need not be the largest
        many = max(rows.shape[1] - d, 0)
        N[rows[:, :, None], used + np.arange(len(blocks) * many).reshape(len(blocks), 1, many)] = left[:, :, rows.shape[1] - many :]
        used += len(blocks) * many
    N = N[:, :used]
    shared = columns[nuisance.shared].ravel()
    left, back, rank = (part[0] for part in _apart((N.T @ P[:, shared])[None]))
    if rank < len(shared):
        loose += nuisance.shared.tolist()
    inverse[shared] = back @ N.T
    others = np.setdiff1d(np.arange(P.shape[1]), shared)
    # the shared blocks' part goes before the others see it
    inverse[others] -= (inverse[others] @ P[:, shared]) @ inverse[shared]
    return N @ left[:, int(rank) :], inverse, loose


def _apart(P: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Return, for matrices P (k, e, c), orthonormal bases (k, e, e) whose columns from the rank on are normal to those of P, the
    pseudo-inverses (k, c, e) and the ranks (k,)."""
    # columns of one size, so that the rank does not depend on units
    size = np.maximum(np.linalg.norm(P, axis=1), 1e-300)
    U, s, Vt = np.linalg.svd(P / size[:, None, :], full_matrices=True)
    determined = s > RANK * s.max(axis=1, initial=0.0, keepdims=True)
    count = s.shape[1]
    back = (
        np.swapaxes(Vt[:, :count], 1, 2)
        * np.where(determined, 1.0 / np.where(determined, s, 1.0), 0.0)[:, None, :]
        @ np.swapaxes(U[:, :, :count], 1, 2)
    )
    return U, back / size[:, :, None], determined.sum(axis=1)


def _described(problem: Problem, theta: FloatArray, V: FloatArray, prior: bool, part: Eliminated, converged: bool, framed: bool) -> Fit:
    """Return the fit at theta; CalibrationError if the residuals do not determine all of a block."""
    if part.loose:
        raise CalibrationError(problem.undetermined_block(part.loose[0]))
    own, width = problem.own, problem.parameters.width
    z, gauge = (theta[:own] - problem.parameters.nominal) / width, problem.gauge
    count, free = 0, part.Vt[~part.known]
    if gauge is not None and not prior:
        basis, _ = np.linalg.qr(gauge.motions(theta)[:own] / width[:, None])
        left, cosines, _ = np.linalg.svd(free @ basis, full_matrices=True)
        count = int((cosines > IN_SPAN).sum())
        free = np.vstack([left[:, count:].T @ free, left[:, :count].T @ free])
    directions = np.vstack([part.Vt[part.known], free])
    s = np.r_[part.s[part.known], np.sort(part.s[~part.known])[::-1]]
    U = np.zeros((len(part.W), own))
    U[:, : min(U.shape)] = part.U[:, : min(U.shape)]
    data = gains(part.s, part.known, prior)[0]
    # of the parameters as they are named, and not along the directions, so that draws do not depend on LAPACK's choice of these
    along = free[: len(free) - count]
    held = ((part.Vt.T / (1.0 + part.s**2)) @ part.Vt if prior else along.T @ along) * width[:, None]
    of_own = width[:, None] * ((part.Vt.T * data) @ U.T @ part.W)
    A = part.A / width
    follows = np.vstack([of_own, part.follow(np.eye(len(V)) - A @ of_own)])
    held = np.vstack([held, -part.follow(A @ held)])
    if framed and gauge is not None:
        S = gauge.projection(theta)
        follows, held = S @ follows, S @ held
    covariance = follows @ V @ follows.T + held @ held.T
    r, penalty = problem.residuals(theta), z if prior else along @ z
    return Fit(
        problem=problem, theta=theta, residuals=r, V=V, s=s, directions=directions, known=np.arange(own) < part.known.sum(),
        prior_everywhere=prior, covariance=np.asarray((covariance + covariance.T) / 2), chi2=float(np.sum((part.W @ r) ** 2)),
        prior_misfit=float(penalty @ penalty), nominal_misfit=float(z @ z), converged=converged, lost=untaken(problem, V),
        motions=count, eliminated=(follows, held),
    )  # fmt: skip
