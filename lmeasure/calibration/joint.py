"""Poses and observation points estimated together, where the reference poses are not known or not to be trusted.

With seven cables or more to a body, or four or more to one point, every pose brings more equations than it has unknowns. What is left over
calibrates the rig, as multilateration by tracking interferometers calibrates itself (Takatsuji and others, Meas. Sci. Technol. 9, 1998;
Zhuang and others, 1992). Lengths tell nothing of where rig and poses are together: six motions of the whole are free, and the frame is
chosen (`calibration.frame`) - the free network of surveying (Mikhail and Ackermann, Observations and Least Squares, 1976, ch. 9). The
scale is that of the counts' length. Poses of which only positions were measured lack three rotations each, which the counts tie; positions
hold the frame, and no motion is free.

With r = r0 + A da + P dp, da of the rig and dp of the poses, and N a basis of what is normal to P (the columns of N are combinations of
lengths that no pose can change), N'r = N'r0 + N'A da is a calibration like any other, its covariance N'VN; dp follows from the generalised
least squares of the rest. Every pose but the zero pose touches its own equations only, so that N is made block by block.
"""

from dataclasses import dataclass

import numpy as np
import scipy.linalg
import scipy.stats

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.frame import in_frame, motions, to_frame
from lmeasure.calibration.joint_model import ROTATIONS, Frame, JointModel
from lmeasure.calibration.refine import SETTLED, UNDECIDED, WALL, Fit, Noise, residual_covariance
from lmeasure.calibration.unknown_poses import check_equations, fit_pose, oriented
from lmeasure.calibration.unknowns import Model, Unknowns, unknowns_of
from lmeasure.errors import CalibrationError
from lmeasure.kernels.cable import span_lengths

MAX_STEPS = 80
RANK = 1e-10  # of the largest singular value of a pose's derivatives, under which the counts do not tell all of it
FINE = 0.1 * SETTLED  # of a standard uncertainty: what remains when the steps end
MISFIT = 1e-3  # probability under which other starts are tried
RESTARTS = 2
IN_SPAN = 0.99  # cosine from which a direction is a motion of the whole


@dataclass(frozen=True, kw_only=True)
class Joint(Fit):
    """A fit of rig and poses together.

    theta (P,) and covariance (P, P) are of all P = p + d n unknowns of a `JointModel`, in its frame; s (p,), directions (p, p) and known
    (p,) of the rig with the poses eliminated, motions of the whole last. follows (P, e): how theta follows errors of the residuals [mm],
    with the other sign; held (P, q): how it follows one standard uncertainty of what only nominal values tell.
    """

    follows: FloatArray
    held: FloatArray

    @property
    def rank(self) -> int:
        """How many unknowns the data determine, those of the poses among them."""
        return int(self.known.sum()) + len(self.theta) - len(self.known)

    def held_covariance(self, model: Model) -> FloatArray:
        """(p, p) as `Fit.held_covariance`, in the frame."""
        held = self.held[: len(self.s)]
        return super().held_covariance(model) if self.prior_everywhere else np.asarray(held @ held.T)

    def determined(self, model: Model) -> FloatArray:
        """(e, rank) derivatives of the residuals along what the data determine, the poses' own unknowns among it."""
        J, own = model.jacobian(self.theta), len(self.s)
        return np.hstack([J[:, :own] * model.unknowns.width[:own] @ self.directions[self.known].T, J[:, own:]])

    def undetermined(self, model: Model) -> FloatArray:
        """(e, q) changes of the residuals by one standard uncertainty of what only nominal values tell."""
        return np.asarray(model.jacobian(self.theta) @ self.held)

    def gain(self, model: Model) -> FloatArray:
        """(P, e) how theta follows errors of the residuals, with the other sign."""
        return self.follows


def solve_jointly(
    campaign: Campaign, solve: tuple[str, ...], prior: bool, free: tuple[int, ...], frame: Frame, seed: int
) -> tuple[JointModel, Joint]:
    """Poses and observation points together; free as `free_components` says.

    CalibrationError when there are too few equations for what is unknown.
    """
    rig, trusted = unknowns_of(campaign, solve), free == ROTATIONS
    if not trusted and not {"position", "guide"} <= set(solve):
        raise CalibrationError("--self: needs position and guide in --solve, or what is taken as exact would hold the frame")
    check_equations(campaign, rig, free)
    model, begun = begun_jointly(campaign, rig, free, frame, seed)
    noise = model.noise(campaign.poses)
    return model, _restarted(model, begun if prior else fit_jointly(model, begun.theta, noise, prior, near=True), prior, seed)


def begun_jointly(campaign: Campaign, rig: Unknowns, free: tuple[int, ...], frame: Frame, seed: int) -> tuple[JointModel, Joint]:
    """The fit from the nominal rig with the prior on every direction; of orientations to begin with, where none is known, from the best."""
    starts = oriented(campaign, seed) if 0 in free and not campaign.poses.oriented else [campaign]
    models = [JointModel(start, rig, free, None if free == ROTATIONS else frame) for start in starts]
    noise = models[0].noise(campaign.poses)
    return min(((m, fit_jointly(m, m.unknowns.nominal, noise, True)) for m in models), key=lambda found: found[1].objective)


def linear_objective(model: JointModel, noise: Noise) -> float:
    """`Fit.objective` of the best fit with the prior everywhere, as the model linearised at the nominal rig and stated poses has it."""
    theta = model.unknowns.nominal
    part = _Eliminated(model, theta, residual_covariance(model, theta, noise), model.own)
    r = model.residuals(theta)
    told = part.told(r)
    return float(np.sum((part.W @ r) ** 2) - np.sum(told**2 * part.s**2 / (1.0 + part.s**2)))


def fitted_pose(model: JointModel, theta: FloatArray, pose: int, seed: int) -> FloatArray:
    """theta with the pose's own unknowns fitted to its own lengths, all others as they are. The pose is no zero pose."""
    at = int(np.flatnonzero(model.at == pose)[0])
    own = model.own + model.pose_unknowns * at + np.arange(model.pose_unknowns)
    mine = model.pose_index == pose
    cables, now = model.cable_index[mine], model.poses(theta)[pose]
    rows = np.ascontiguousarray(model.cables(theta)[0][cables])
    # what the free spans must measure there
    length = span_lengths(rows, now[None])[0] - model.residuals(theta)[mine]
    out = theta.copy()
    out[own] = fit_pose(rows, length, model.campaign.poses.rows[pose], model.free, theta[own], seed)
    return out


def _restarted(model: JointModel, found: Joint, prior: bool, seed: int) -> Joint:
    """The best of other starts too, where the residuals say that this may be another minimum: single poses that stand otherwise between the
    same lengths, and other rigs within the priors."""
    noise = model.noise(model.campaign.poses)

    def improbable() -> bool:
        return found.freedom > 0 and bool(scipy.stats.chi2.sf(found.chi2, found.freedom) < MISFIT)

    others = [int(i) for i in model.at if i not in model.campaign.zero]
    for _ in range(RESTARTS if 0 in model.free else 0):
        if not improbable():
            break
        start = found.theta
        for pose in others:
            start = fitted_pose(model, start, pose, seed)
        other = fit_jointly(model, start, noise, prior)
        if other.objective > found.objective - found.freedom:
            break
        found = other
    rng = np.random.default_rng([seed, 23])
    for _ in range(RESTARTS):
        if not improbable():
            break
        start = found.theta.copy()
        start[: model.own] = model.rig.nominal + model.rig.width * rng.normal(size=model.own)
        other = fit_jointly(model, start, noise, prior)
        if other.objective < found.objective:
            found = other
    return found


def fit_jointly(model: JointModel, start: FloatArray, noise: Noise, prior: bool, near: bool = False) -> Joint:
    """Gauss-Newton with the poses eliminated at each step (variable projection: Golub and Pereyra 1973, in Kaufman's form); first with the
    prior on every direction of the rig, then only where the data are silent, as `refine.fit` does, whose near this is."""
    own, width = model.own, model.rig.width
    theta, most, converged = start.copy(), own, False
    V = residual_covariance(model, theta, noise)
    for everywhere in (True,) if prior else (False,) if near else (True, False):
        r = model.residuals(theta)
        for number in range(MAX_STEPS):
            z = (theta[:own] - model.rig.nominal) / width
            part = _Eliminated(model, theta, V, most)
            if not everywhere and number >= UNDECIDED:
                most = min(most, int(part.known.sum()))
            told, away = part.told(r), part.Vt @ z
            if everywhere:
                dz = -part.Vt.T @ ((part.s * told + away) / (1.0 + part.s**2))
                converged = float(np.linalg.norm(dz)) < FINE
            else:
                dz = -part.Vt.T @ np.where(part.known, told / np.where(part.known, part.s, 1.0), away)
                converged = max(float(np.linalg.norm(told[part.known])), float(np.linalg.norm(away[~part.known]))) < FINE
            dp, fraction = part.poses(r, dz), min(1.0, 2.0 / max(float(np.linalg.norm(dz)), 1e-300))
            now = part.merit(r, z, everywhere)
            for _ in range(12):
                trial = theta + fraction * np.r_[dz * width, dp]
                r_trial = model.residuals(trial)
                then = part.merit(r_trial, z + fraction * dz, everywhere)
                # towards the nominal rig the way may leave the valley's floor a little, which the next step mends
                if then <= now * (1 + 1e-10) or (not everywhere and then <= WALL**2):
                    break
                fraction *= 0.5
            else:
                break
            theta, r = trial, r_trial
            if converged:
                break
        V = residual_covariance(model, theta, noise)
    framed = model.frame is not None and not (prior and model.frame == "rig")
    if framed and model.frame is not None:
        theta = in_frame(model, theta, model.frame)
        V = residual_covariance(model, theta, noise)
    return _described(model, theta, V, noise, prior, _Eliminated(model, theta, V, most), converged, framed)


class _Eliminated:
    """The linear problem at a point: residuals r = r0 + A dz + P dp, dz of the rig in prior widths, dp of the poses."""

    def __init__(self, model: JointModel, theta: FloatArray, V: FloatArray, most: int) -> None:
        own, J = model.own, model.jacobian(theta)
        self.A, self.V = J[:, :own] * model.rig.width, V
        N, self.inverse, self.loose = _eliminate(model, J[:, own:])
        self.W = scipy.linalg.solve_triangular(np.linalg.cholesky(N.T @ V @ N), N.T, lower=True)
        # of the directions of the rig all, of those of the residuals only what they see
        self.U, s, self.Vt = np.linalg.svd(self.W @ self.A, full_matrices=len(self.W) < own)
        self.s = np.r_[s, np.zeros(own - len(s))]
        self.known = (self.s > 1.0) & (np.arange(own) < most)

    def told(self, r: FloatArray) -> FloatArray:
        """(p,) components of the residuals along the directions of the rig, 0 where there is no equation."""
        out = np.zeros(len(self.s))
        count = min(len(self.s), self.U.shape[1])
        out[:count] = self.U[:, :count].T @ (self.W @ r)
        return out

    def merit(self, r: FloatArray, z: FloatArray, everywhere: bool) -> float:
        """What a step must not make larger: residuals that no pose can take away, and with the prior the distance from the nominal rig."""
        return float(np.sum((self.W @ r) ** 2) + (z @ z if everywhere else 0.0))

    def poses(self, r: FloatArray, dz: FloatArray) -> FloatArray:
        """The poses' step that goes with the rig's."""
        return -self.follow(r + self.A @ dz)

    def follow(self, columns: FloatArray) -> FloatArray:
        """(d n, ...) generalised least squares of the poses to residuals (e, ...)."""
        return np.asarray(self.inverse @ (columns - self.V @ (self.W.T @ (self.W @ columns))))


def _eliminate(model: JointModel, P: FloatArray) -> tuple[FloatArray, FloatArray, list[int]]:
    """An orthonormal basis N (e, e - rank) of what is normal to the poses' derivatives P (e, d n), a left inverse (d n, e) of P, and the
    poses that P does not tell wholly."""
    e, d = len(P), model.pose_unknowns
    zero = np.unique(model.campaign.zero)
    columns = np.arange(P.shape[1]).reshape(-1, d)
    inverse, loose = np.zeros((P.shape[1], e)), []
    at_zero = np.flatnonzero(np.isin(model.pose_index, zero))
    N = np.zeros((e, e))
    N[at_zero, np.arange(len(at_zero))] = 1.0
    used = len(at_zero)
    for poses, rows in model.alike:
        own = columns[poses]
        left, back, rank = _apart(P[rows[:, :, None], own[:, None, :]])
        inverse[own[:, :, None], rows[:, None, :]] = back
        loose += model.at[poses[rank < d]].tolist()
        # a pose that is not told wholly ends the calibration: its part need not be the largest
        many = max(rows.shape[1] - d, 0)
        N[rows[:, :, None], used + np.arange(len(poses) * many).reshape(-1, 1, many)] = left[:, :, rows.shape[1] - many :]
        used += len(poses) * many
    N = N[:, :used]
    shared = columns[np.isin(model.at, zero)].ravel()
    left, back, rank = (part[0] for part in _apart((N.T @ P[:, shared])[None]))
    if rank < len(shared):
        loose += zero.tolist()
    inverse[shared] = back @ N.T
    others = np.setdiff1d(np.arange(P.shape[1]), shared)
    # the zero poses' part goes before the others see it
    inverse[others] -= (inverse[others] @ P[:, shared]) @ inverse[shared]
    return N @ left[:, int(rank) :], inverse, loose


def _apart(P: FloatArray) -> tuple[FloatArray, FloatArray, IntArray]:
    """Of matrices P (k, e, c): orthonormal bases (k, e, e) whose columns from the rank on are normal to those of P, the pseudo-inverses
    (k, c, e) and the ranks (k,)."""
    # columns of one size, so that rank is a matter of geometry and not of units
    size = np.maximum(np.linalg.norm(P, axis=1), 1e-300)
    U, s, Vt = np.linalg.svd(P / size[:, None, :], full_matrices=True)
    told = s > RANK * s.max(axis=1, initial=0.0, keepdims=True)
    count = s.shape[1]
    back = (
        np.swapaxes(Vt[:, :count], 1, 2)
        * np.where(told, 1.0 / np.where(told, s, 1.0), 0.0)[:, None, :]
        @ np.swapaxes(U[:, :, :count], 1, 2)
    )
    return U, back / size[:, :, None], told.sum(axis=1)


def _described(
    model: JointModel, theta: FloatArray, V: FloatArray, noise: Noise, prior: bool, part: _Eliminated, converged: bool, framed: bool
) -> Joint:
    """CalibrationError where the counts do not tell all of a pose."""
    if part.loose:
        name = model.campaign.poses.names[part.loose[0]]
        raise CalibrationError(f"counts.csv: pose {name}: its counted cables do not tell all its unknowns; leave it out")
    own, width, z = model.own, model.rig.width, (theta[: model.own] - model.rig.nominal) / model.rig.width
    count, free = 0, part.Vt[~part.known]
    if model.frame is not None and not prior:
        basis, _ = np.linalg.qr(motions(model, theta)[:own] / width[:, None])
        left, cosines, _ = np.linalg.svd(free @ basis, full_matrices=True)
        count = int((cosines > IN_SPAN).sum())
        free = np.vstack([left[:, count:].T @ free, left[:, :count].T @ free])
    directions = np.vstack([part.Vt[part.known], free])
    s = np.r_[part.s[part.known], np.sort(part.s[~part.known])[::-1]]
    known = np.arange(own) < part.known.sum()
    U = np.zeros((len(part.W), own))
    U[:, : min(U.shape)] = part.U[:, : min(U.shape)]
    if prior:
        data, held = part.s / (1.0 + part.s**2), (part.Vt.T / (1.0 + part.s**2)) * width[:, None]
    else:
        data, held = np.where(part.known, 1.0 / np.where(part.known, part.s, 1.0), 0.0), free[: len(free) - count].T * width[:, None]
    rig = width[:, None] * ((part.Vt.T * data) @ U.T @ part.W)
    A = part.A / width
    follows = np.vstack([rig, part.follow(np.eye(len(V)) - A @ rig)])
    held = np.vstack([held, -part.follow(A @ held)])
    if framed and model.frame is not None:
        S = to_frame(model, theta, model.frame)
        follows, held = S @ follows, S @ held
    covariance = follows @ V @ follows.T + held @ held.T
    r, penalty = model.residuals(theta), z if prior else free[: len(free) - count] @ z
    return Joint(
        theta=theta, residuals=r, V=V, s=s, directions=directions, known=known, prior_everywhere=prior,
        covariance=np.asarray((covariance + covariance.T) / 2), chi2=float(np.sum((part.W @ r) ** 2)),
        prior_misfit=float(penalty @ penalty), nominal_misfit=float(z @ z), converged=converged, lost=_lost(model, V, noise),
        motions=count, follows=follows, held=held,
    )  # fmt: skip


def _lost(model: JointModel, V: FloatArray, noise: Noise) -> float:
    """How many equations a robust loss has taken back, less the unknowns of the poses that go with them."""
    if noise.robust_variance_mm2 is None:
        return 0.0
    share = noise.robust_variance_mm2[model.pose_index] / np.diag(V)
    equations = np.bincount(model.pose_index, minlength=len(model.campaign.poses))[model.pose_index]
    return float(np.sum(share * np.maximum(0.0, 1.0 - model.pose_unknowns / equations)))
