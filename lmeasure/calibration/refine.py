"""Least squares: the calibration's optimum, with priors where the data are silent.

Everything is done in z = (theta - nominal)/prior_u, so that the prior is a unit normal, and with residuals whitened by their covariance V
(count resolution, plus reference-pose errors, which are shared between the cables of a pose and, through the zero pose, between all poses
of a cable; solving with V is total least squares in the reference poses to first order). The singular values s of the whitened
Jacobian in z then say how much better than the prior the data know each direction: u_data = prior_u/s. A direction with s < 1 is one
the data leave undetermined: there, and only there, the prior decides (unless it is asked to act everywhere).
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import scipy.linalg
import scipy.optimize

from lmeasure.arrays import BoolArray, FloatArray
from lmeasure.calibration.unknowns import Model
from lmeasure.poses import Poses

MAX_STEPS = 100
UNDECIDED = 25  # steps after which a direction that was undetermined once stays so
SETTLED = 0.01  # of a standard uncertainty
ROUGH = 1e-6  # of an objective: where those of hypotheses are compared, which differ by far
FLOOR = 3.0  # standard uncertainties of the data, within which a step may also go along the valley
ASSUMED = {"position": 0.1, "rotation": np.radians(0.02)}
"""Standard uncertainty [mm, rad] of reference poses that state none and cannot be judged by their residuals: an industrial robot's."""
WALL = 30.0  # standard uncertainties of the data, from where Gauss-Newton comes back to the floor of a valley


@dataclass(frozen=True)
class Noise:
    """Standard uncertainties of the reference poses (n,): of each coordinate [mm] and each small rotation [rad]."""

    u_position_mm: FloatArray
    u_rotation_rad: FloatArray
    covariance: FloatArray | None = None
    """(n, 6, 6) of (rotation; position), where more is stated than the two, which are then its root mean squares."""
    robust_variance_mm2: FloatArray | None = None
    """(n,) the variance with which a robust loss takes every length of a reference pose back; None without one."""
    u_length_mm: FloatArray | None = None
    """(m,) by which the lengths of each cable err on their own, at every pose anew, the zero pose among them; None where they do not."""
    absent: tuple[str, ...] = ()
    """Which of "position" and "rotation" the poses do not state: those are assumed."""

    @classmethod
    def of(cls, poses: Poses) -> Self:
        """As the file of the poses states it, and an assumed size of what it does not state."""
        none = cls(poses.u_position_mm, poses.u_rotation_rad, poses.covariance, absent=poses.absent)
        return none.widened(*(size if name in poses.absent else 0.0 for name, size in ASSUMED.items()))

    def bare(self) -> Self:
        """Without what was assumed. A covariance by axes has the other part alone."""
        place, turn = ("position" not in self.absent, "rotation" not in self.absent)
        own = None if self.covariance is None else self.covariance * np.outer(*2 * (np.repeat([turn, place], 3),))
        return replace(self, u_position_mm=self.u_position_mm * place, u_rotation_rad=self.u_rotation_rad * turn, covariance=own)

    def widened(self, u_mm: float, u_rad: float) -> Self:
        """With an independent error of these standard uncertainties in each coordinate and each component of a small rotation."""
        more = None if self.covariance is None else self.covariance + np.diag(np.repeat([u_rad**2, u_mm**2], 3))
        return replace(
            self, u_position_mm=np.hypot(self.u_position_mm, u_mm), u_rotation_rad=np.hypot(self.u_rotation_rad, u_rad), covariance=more
        )

    def times(self, factor: float) -> Self:
        """With all standard uncertainties of the poses multiplied."""
        return replace(
            self,
            u_position_mm=self.u_position_mm * factor,
            u_rotation_rad=self.u_rotation_rad * factor,
            covariance=None if self.covariance is None else self.covariance * factor**2,
        )

    def with_lengths(self, u_mm: FloatArray) -> Self:
        """With independent errors (m,) of the cables' lengths."""
        return replace(self, u_length_mm=np.hypot(0.0 if self.u_length_mm is None else self.u_length_mm, u_mm))

    @property
    def stated(self) -> bool:
        """Whether any pose is uncertain."""
        return bool(self.u_position_mm.any() or self.u_rotation_rad.any())

    def scaled(self, J: FloatArray) -> FloatArray:
        """(e, n, 6) derivatives by the errors of each pose in units of independent standard ones."""
        if self.covariance is None:
            return np.concatenate([J[:, :, :3] * self.u_rotation_rad[:, None], J[:, :, 3:] * self.u_position_mm[:, None]], axis=2)
        values, vectors = np.linalg.eigh(self.covariance)
        return np.asarray(np.einsum("eni,nij->enj", J, vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]))


@dataclass(frozen=True)
class Fit:
    """An optimum.

    theta (p,) in the units of the unknowns; residuals (e,) modelled less measured [mm]; V (e, e) their covariance [mm^2]; s (p,) singular
    values of the whitened, prior-scaled Jacobian (zero-padded), directions (p, p) its right singular vectors as rows; known (p,) True
    where the data decide; prior_everywhere: whether the prior acts on those too; covariance (p, p) of theta with the model linearised; chi2
    of the residuals under V; prior_misfit: squared distance from the nominal values in prior widths where the prior acts;
    nominal_misfit: the same in all directions; excess: how many times V the residuals ask for when nothing explains them (in the
    covariance already); lost: how many of the equations a robust loss has taken back; motions: how many of the directions, the last, are
    motions of rig and poses together, about which a choice of the frame decides (`calibration.joint`).
    """

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

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2: equations that count, less directions determined."""
        return round(len(self.residuals) - self.lost) - self.rank

    @property
    def gains(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(p,) each: how a unit of the data's and of the prior's error moves the result along each direction, and the standard
        uncertainty that both make, all in prior widths."""
        return _gains(self.s, self.known, self.prior_everywhere)

    @property
    def rank(self) -> int:
        """How many directions the data determine."""
        return int(self.known.sum())

    @property
    def silent(self) -> FloatArray:
        """(k, p) directions of the rig of which the data say nothing, and no choice of a frame."""
        return self.directions[~self.known][: int((~self.known).sum()) - self.motions]

    def held_covariance(self, model: Model) -> FloatArray:
        """(p, p) the part of the rig's covariance that only nominal values hold."""
        silent = self.silent * model.rig.width
        return np.asarray(silent.T @ silent)

    def determined(self, model: Model) -> FloatArray:
        """(e, rank) derivatives of the residuals [mm] along the directions that the data determine, in prior widths."""
        return np.asarray(model.jacobian(self.theta) * model.unknowns.width @ self.directions[self.known].T)

    def undetermined(self, model: Model) -> FloatArray:
        """(e, k) changes of the residuals [mm] by one standard uncertainty of what only nominal values tell."""
        return np.asarray(model.jacobian(self.theta) * model.unknowns.width @ self.directions[~self.known].T)

    def gain(self, model: Model) -> FloatArray:
        """(p, e) how theta follows errors of the residuals [mm], with the other sign."""
        data, width = self.gains[0], model.unknowns.width
        weight = np.where(data > 0, data / np.where(data > 0, self.s, 1.0), 0.0)
        by_information = (self.directions.T * weight) @ self.directions * np.outer(width, width)
        return np.asarray(by_information @ np.linalg.solve(self.V, model.jacobian(self.theta)).T)

    @property
    def objective(self) -> float:
        """Twice the negative log posterior, constants left out: what tells one minimum from another."""
        return self.chi2 + self.nominal_misfit


def _gains(s: FloatArray, known: BoolArray, prior_everywhere: bool) -> tuple[FloatArray, FloatArray, FloatArray]:
    if prior_everywhere:
        data, prior = s / (1.0 + s**2), 1.0 / (1.0 + s**2)
    else:
        data, prior = np.where(known, 1.0 / np.where(known, s, 1.0), 0.0), np.where(known, 0.0, 1.0)
    return data, prior, np.hypot(data, prior)


Refit = Callable[[FloatArray, Noise, bool], Fit]
"""The optimum nearest to values of the unknowns, under a noise, and whether they are an optimum under hardly different weights."""


def measurement_covariance(model: Model, theta: FloatArray, noise: Noise) -> FloatArray:
    """(e, e) covariance of the residuals [mm^2] from whole counts and reference poses."""
    V = model.reading_covariance()
    campaign = model.campaign
    if noise.stated or campaign.u_visit is not None:
        J = model.pose_jacobian(theta)
        shared = noise.scaled(J)
        if campaign.reference is not None:
            # visits of one pose share its error
            shared = np.einsum("eni,nr->eri", shared, campaign.reference_of[:, None] == np.arange(len(campaign.poses)))
        flat = shared.reshape(len(J), -1)
        V = V + flat @ flat.T
        if campaign.u_visit is not None:
            own = (J * campaign.u_visit).reshape(len(J), -1)
            # the robot comes anew in every pass
            passage = np.array([c.passage for c in campaign.cables])[model.cable_index]
            V = V + (own @ own.T) * (passage[:, None] == passage)
    return np.asarray(V)


def residual_covariance(model: Model, theta: FloatArray, noise: Noise) -> FloatArray:
    """`measurement_covariance`, physical effects and dimensions where their errors are stated, errors of lengths of their own, and what a
    robust loss takes back."""
    V = measurement_covariance(model, theta, noise)
    effects = model.effect_covariance(theta)
    if effects is not None:
        V = V + effects
    unsolved = model.unsolved_covariance(theta)
    if unsolved is not None:
        V = V + unsolved
    if noise.robust_variance_mm2 is not None:
        campaign = model.campaign
        same = model.cable_index[:, None] == model.cable_index
        reference, poses = campaign.reference_of, np.arange(len(campaign.poses))
        # a length at the zero pose is in every residual of its cable
        at, zero = reference[model.pose_index], reference[campaign.zero[model.cable_index]]
        h = (at[:, None] == poses).astype(np.float64) - (zero[:, None] == poses)
        V = V + same * ((h * noise.robust_variance_mm2) @ h.T)
    if noise.u_length_mm is not None:
        own = noise.u_length_mm[model.cable_index] ** 2
        V = V + np.diag(own) + np.where(model.cable_index[:, None] == model.cable_index, own, 0.0)
    return np.asarray(V)


class Whitened:
    """Whitened residuals and Jacobian of a model in z, for one covariance of the residuals."""

    def __init__(self, model: Model, V: FloatArray) -> None:
        self.model = model
        # the inverse once: it is applied hundreds of times, and V is far from singular (whole counts on its diagonal)
        diagonal = np.sqrt(np.diag(V))
        correlated = np.count_nonzero(V) > len(V)
        self._W = np.linalg.inv(np.linalg.cholesky(V)) if correlated else 1.0 / diagonal[:, None]
        self._nominal, self._width = model.unknowns.nominal, model.unknowns.width

    def theta(self, z: FloatArray) -> FloatArray:
        return np.asarray(self._nominal + self._width * z)

    def residuals(self, z: FloatArray) -> FloatArray:
        return self.whiten(self.model.residuals(self.theta(z))[:, None])[:, 0]

    def jacobian(self, z: FloatArray) -> FloatArray:
        return self.whiten(self.model.jacobian(self.theta(z)) * self._width)

    def whiten(self, columns: FloatArray) -> FloatArray:
        """(e, c) columns of errors of the residuals [mm] with unit covariance instead of V."""
        return np.asarray(self._W * columns if self._W.shape[1] == 1 else self._W @ columns)


def fit(model: Model, start: FloatArray, noise: Noise, prior_everywhere: bool, near: bool = False, roughly: bool = False) -> Fit:
    """The optimum nearest to start (p,): first with the prior on every direction, which is always well posed; then, unless the prior is
    to act everywhere, the prior is taken off the directions that the data determine. near: start is an optimum under hardly different
    weights, from where only the second part is needed. roughly: objectives are compared that differ by far, few digits of them will do."""
    z = (start - model.unknowns.nominal) / model.unknowns.width
    converged, most = True, len(z)
    V = residual_covariance(model, start, noise)
    # the optimum needs many digits only where nothing follows it
    precision = ROUGH if roughly else 1e-13 if prior_everywhere else 1e-7
    # V depends on theta where the poses are in error, and hardly: the second round has it at the optimum
    for again in range(2 if noise.stated else 1):
        w = Whitened(model, V)
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
        V = residual_covariance(model, w.theta(z), noise)
    lost = 0.0 if noise.robust_variance_mm2 is None else float(np.sum(noise.robust_variance_mm2[model.pose_index] / np.diag(V)))
    return _describe(model, z, V, prior_everywhere, converged, lost, most)


def _split(w: Whitened, z: FloatArray, most: int) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Singular value decomposition of the whitened Jacobian, and which directions the data determine: at most so many."""
    U, s, Vt = np.linalg.svd(w.jacobian(z), full_matrices=False)
    if len(s) < len(z):
        # the directions that no equation touches
        Vt = np.vstack([Vt, scipy.linalg.null_space(Vt).T])
        s = np.concatenate([s, np.zeros(len(z) - len(s))])
    return U, s, Vt, (s > 1.0) & (np.arange(len(z)) < most)


def _release(w: Whitened, z: FloatArray) -> tuple[FloatArray, bool, int]:
    """Gauss-Newton that fits the data in the directions they determine and goes back to the nominal value in the others.

    It walks along a curved valley: a step towards the nominal value may leave the floor by WALL standard uncertainties of the data, which
    the next ones mend. What remains is settled when it is a hundredth of the standard uncertainty there. A direction may be determined
    at its own optimum and not at the nominal value, or the other way round; one that keeps changing sides is left to its prior.

    The result, whether it settled, and how many directions the data were allowed to determine.
    """
    r = w.residuals(z)
    settled, most = False, len(z)
    for step_number in range(MAX_STEPS):
        U, s, Vt, known = _split(w, z, most)
        if step_number >= UNDECIDED:
            most = min(most, int(known.sum()))
        k = np.flatnonzero(known)
        misfit, silent = U[:, k].T @ r, Vt[~known]
        away = silent @ z
        off = float(np.linalg.norm(misfit))
        settled = off < SETTLED and float(np.linalg.norm(away)) < SETTLED
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
            if float(np.linalg.norm(r_trial)) <= max(float(np.linalg.norm(r)), WALL):
                break
            fraction *= 0.5
        else:
            return z, settled, most
        z, r = trial, r_trial
    return z, settled, most


def _describe(model: Model, z: FloatArray, V: FloatArray, prior_everywhere: bool, converged: bool, lost: float, most: int) -> Fit:
    w = Whitened(model, V)
    _, s, Vt, known = _split(w, z, most)
    sigma = _gains(s, known, prior_everywhere)[2]
    width = model.unknowns.width
    covariance = (Vt.T * sigma**2) @ Vt * np.outer(width, width)
    r = w.residuals(z)
    theta = w.theta(z)
    penalty = z if prior_everywhere else Vt[~known] @ z
    return Fit(
        theta,
        model.residuals(theta),
        V,
        s,
        Vt,
        known,
        prior_everywhere,
        np.asarray((covariance + covariance.T) / 2),
        float(r @ r),
        float(penalty @ penalty),
        float(z @ z),
        converged,
        lost,
    )
