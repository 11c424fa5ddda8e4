"""Poses and observation points estimated together, where the reference poses are not known or not to be trusted.

With seven cables or more to a body, or four or more to one point, every pose brings more equations than it has unknowns. What is left over
calibrates the rig, as multilateration by tracking interferometers calibrates itself (Takatsuji and others, Meas. Sci. Technol. 9, 1998;
Zhuang and others, 1992). Lengths tell nothing of where rig and poses are together: six motions of the whole are free, and the frame is the
one in which the squared shifts from the nominal rig (or from the stated poses), in units of their prior widths, are least - the free
network of surveying, whose covariance is the pseudo-inverse (Mikhail and Ackermann, Observations and Least Squares, 1976, ch. 9). The
scale is that of the counts' length. Poses of which only positions were measured lack three rotations each, which the counts tie; positions
hold the frame, and no motion is free.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.refine import SETTLED, UNDECIDED, WALL, Noise, Whitened, residual_covariance
from lmeasure.calibration.unknowns import Model, Unknowns, unknowns_of
from lmeasure.calibration_record import Finding
from lmeasure.errors import CalibrationError
from lmeasure.kernels.cable import guide_direction

FloatArray = NDArray[np.float64]
Frame = Literal["rig", "poses"]

COMPONENTS = ("rx_deg", "ry_deg", "rz_deg", "x_mm", "y_mm", "z_mm")
ROTATIONS = (0, 1, 2)
MAX_STEPS = 200
RANK = 1e-12
FINE = 0.1 * SETTLED  # of a standard uncertainty: what remains when the steps end
MISFIT = 1e-3  # probability under which residuals are not put down to chance
CANDIDATES = 3  # orientations of the zero pose that are followed up
IN_SPAN = 0.99  # cosine from which a direction is a motion of the whole


class JointModel(Model):
    """A campaign whose poses have unknowns of their own behind those of the rig: rotations and shifts from the stated poses, base axes,
    R = Exp(rotation) R_stated. free: which of `COMPONENTS`. Nothing is known of them beforehand."""

    def __init__(self, campaign: Campaign, rig: Unknowns, free: tuple[int, ...]) -> None:
        self.rig, self.free = rig, np.array(free, dtype=np.int64)
        names = tuple(f"pose {name}.{COMPONENTS[c]}" for name in campaign.poses.names for c in free)
        none = np.full(len(names), np.inf)
        every = Unknowns((*rig.names, *names), np.r_[rig.nominal, np.zeros(len(names))], np.r_[rig.width, none])
        super().__init__(campaign, every)

    def shifts(self, theta: FloatArray) -> FloatArray:
        """(n, 6) rotation [rad] and shift [mm] of each pose from the stated one."""
        out = np.zeros((len(self.campaign.poses), 6))
        own = theta[len(self.rig.names) :].reshape(len(out), len(self.free))
        out[:, self.free] = np.where(self.free < 3, np.radians(own), own)
        return out

    @property
    def arms(self) -> FloatArray:
        """(n, 3) from the origin of a pose to the point that a motion of the whole carries along [mm, base frame]: the one attachment
        point, where the tool itself does not turn."""
        if 0 in self.free:
            return np.zeros((len(self.campaign.poses), 3))
        tool = self.campaign.rig.tool[self.campaign.cables[0].to_point]
        return self.campaign.poses.rotation.apply(np.array(tool))

    def poses(self, theta: FloatArray) -> FloatArray:
        """(n, 7) the stated poses, shifted."""
        shift, rows = self.shifts(theta), self.campaign.poses.rows.copy()
        rows[:, :3] += shift[:, 3:]
        rows[:, 3:] = (Rotation.from_rotvec(shift[:, :3]) * Rotation.from_quat(rows[:, 3:])).as_quat()
        return np.ascontiguousarray(rows)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p) as `Model.jacobian`, the poses' unknowns behind."""
        J = super().jacobian(theta)
        by_pose = self.pose_jacobian(theta)
        by_pose[:, :, :3] = np.einsum("eni,nij->enj", by_pose[:, :, :3], _left_jacobians(self.shifts(theta)[:, :3]))
        by_pose = np.where(np.isfinite(by_pose), by_pose, 0.0)[:, :, self.free] * np.where(self.free < 3, math.radians(1.0), 1.0)
        J[:, len(self.rig.names) :] = by_pose.reshape(len(J), -1)
        return J


def _left_jacobians(turns: FloatArray) -> FloatArray:
    """(n, 3, 3) of rotation vectors (n, 3): Exp(a + da) = Exp(J da) Exp(a) to first order."""
    angle = np.linalg.norm(turns, axis=1)[:, None, None]
    K = np.cross(turns[:, None, :], np.eye(3)).swapaxes(1, 2)
    # what cancels in (angle - sin angle)/angle^3 is multiplied by the angle's square, and nothing of a double is lost
    third = (1.0 - np.sinc(angle / np.pi)) / np.where(angle > 0.0, angle**2, 1.0)
    return np.asarray(np.eye(3) + 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * K + third * (K @ K))


@dataclass(frozen=True)
class Joint:
    """Poses and rig found together.

    model; theta (p + d n,) values of the rig and shifts of the poses in its frame; campaign with the poses found; residuals (e,) [mm];
    chi2 of them; s (p,) singular values of the whitened Jacobian by the rig's values in prior widths with the poses eliminated, directions
    (p, p) its right singular vectors as rows, known (p,) True where the data decide; covariance (p + d n, p + d n) in the frame; motions:
    how many motions of the whole the data leave free; silent (k, p) orthonormal directions that are undetermined beside them.
    """

    model: JointModel
    theta: FloatArray
    campaign: Campaign
    residuals: FloatArray
    chi2: float
    s: FloatArray
    directions: FloatArray
    known: NDArray[np.bool_]
    covariance: FloatArray
    motions: int
    silent: FloatArray
    converged: bool
    findings: tuple[Finding, ...] = ()

    @property
    def own(self) -> int:
        """How many unknowns are the rig's."""
        return len(self.model.rig.names)

    @property
    def freedom(self) -> int:
        """Degrees of freedom of the residuals."""
        return len(self.residuals) - int(self.known.sum()) - (len(self.theta) - self.own)


def free_components(campaign: Campaign, trusted: bool) -> tuple[int, ...]:
    """Which of `COMPONENTS` of the poses are unknown: none of trusted whole poses.

    CalibrationError when nothing could tell them.
    """
    used = {c.to_point for c in campaign.cables}
    if len(used) == 1:
        name = next(iter(used))
        if not campaign.poses.oriented and any(campaign.rig.tool[name]):
            raise CalibrationError(
                f"reference_poses.csv: has no orientations, and all cables lead to {name}: give the positions of {name} itself and "
                f"{name} = [0.0, 0.0, 0.0] in [tool]"
            )
        free: tuple[int, ...] = () if trusted else (3, 4, 5)
    elif trusted:
        free = () if campaign.poses.oriented else ROTATIONS
    else:
        free = (0, 1, 2, 3, 4, 5)
    if not trusted and len(campaign.cables) <= len(free):
        what, least = ("one point", 4) if len(free) == 3 else ("a body", 7)
        raise CalibrationError(
            f"--self: {len(campaign.cables)} cables bring {len(campaign.cables)} equations at a pose of {len(free)} unknowns, and nothing "
            f"is left over for the rig; {what} calibrates itself with {least} cables or more"
        )
    return free


def solve_jointly(campaign: Campaign, solve: tuple[str, ...], prior: bool, free: tuple[int, ...], frame: Frame, seed: int) -> Joint:
    """Poses and observation points together; free as `free_components` says.

    CalibrationError when poses without orientations have too few equations for what is unknown.
    """
    rig, trusted = unknowns_of(campaign, solve), free == ROTATIONS
    if not trusted and not {"position", "guide"} <= set(solve):
        raise CalibrationError("--self: needs position and guide in --solve, or what is taken as exact would hold the frame")
    n, m, d = len(campaign.poses), len(campaign.cables), len(free)
    equations = int(campaign.used.sum())
    # a frame of six motions need not be told where the poses do not hold it
    needed = d * n + (len(rig.names) if trusted else 0)
    if equations < needed:
        what = "has no orientations, and" if trusted else "is not trusted, and"
        raise CalibrationError(
            f"reference_poses.csv: {what} {equations} equations cannot tell {d} unknowns of each of {n} poses and "
            f"{len(rig.names)} values of the rig; with {m} cables at least {math.ceil((m + len(rig.names)) / (m - d))} poses are needed"
            if m > d
            else f"reference_poses.csv: {what} {m} cables cannot tell {d} unknowns of each pose"
        )
    noise = Noise.of(campaign.poses) if trusted else Noise(np.zeros(n), np.zeros(n))
    starts = _oriented(campaign, seed) if 0 in free and not campaign.poses.oriented else [campaign]
    found = min((_fit(JointModel(start, rig, free), noise, prior) for start in starts), key=lambda j: j.chi2)
    if frame == "poses" and not trusted:
        found = _in_frame_of_poses(found)
    findings = _findings(found, frame, trusted)
    covariance = found.covariance
    if any(f.code == "misfit" for f in findings):
        covariance = covariance * (found.chi2 / found.freedom)
    return replace(found, covariance=covariance, findings=tuple(findings))


def _fit(model: JointModel, noise: Noise, prior: bool) -> Joint:
    """Gauss-Newton with the poses eliminated at each step (variable projection: Golub and Pereyra 1973, in Kaufman's form); first with the
    prior on every direction of the rig, then only where the data are silent, as `refine` does."""
    own, width = len(model.rig.names), model.rig.width
    theta, most, converged = model.unknowns.nominal.copy(), own, False
    V = residual_covariance(model, theta, noise)
    for everywhere in (True,) if prior else (True, False):
        w = Whitened(model, V)
        r = w.whiten(model.residuals(theta)[:, None])[:, 0]
        for number in range(MAX_STEPS):
            z = (theta[:own] - model.rig.nominal) / width
            part = _Eliminated(w, model, theta, r, most)
            if not everywhere and number >= UNDECIDED:
                most = min(most, int(part.known.sum()))
            told, away = part.told, part.Vt @ z
            if everywhere:
                dz = -part.Vt.T @ ((part.s * told + away) / (1.0 + part.s**2))
                converged = float(np.linalg.norm(dz)) < FINE
            else:
                dz = -part.Vt.T @ np.where(part.known, told / np.where(part.known, part.s, 1.0), away)
                converged = max(float(np.linalg.norm(told[part.known])), float(np.linalg.norm(away[~part.known]))) < FINE
            dp, fraction = part.poses(dz), min(1.0, 2.0 / max(float(np.linalg.norm(dz)), 1e-300))
            now = part.merit(r, z, everywhere)
            for _ in range(12):
                trial = theta + fraction * np.r_[dz * width, dp]
                r_trial = w.whiten(model.residuals(trial)[:, None])[:, 0]
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
    w = Whitened(model, V)
    r = w.whiten(model.residuals(theta)[:, None])[:, 0]
    part = _Eliminated(w, model, theta, r, most)
    covariance, motions, silent = part.covariance(prior)
    campaign = model.campaign
    poses = replace(campaign.poses, rows=model.poses(theta))
    return Joint(
        model,
        theta,
        replace(campaign, poses=poses),
        model.residuals(theta),
        float(r @ r),
        part.s,
        part.Vt,
        part.known,
        covariance,
        motions,
        silent,
        converged,
    )


class _Eliminated:
    """The linear problem at a point: whitened residuals r = r0 + A dz + P dp, dz of the rig in prior widths, dp of the poses."""

    def __init__(self, w: Whitened, model: JointModel, theta: FloatArray, r: FloatArray, most: int) -> None:
        own = len(model.rig.names)
        J = w.whiten(model.jacobian(theta))
        self.A, P = J[:, :own] * model.rig.width, J[:, own:]
        # columns of one size, so that rank is a matter of geometry and not of units
        self.size = np.maximum(np.linalg.norm(P, axis=0), 1e-300)
        self.Q, self.R = np.linalg.qr(P / self.size, mode="complete")
        self.R = self.R[: P.shape[1]]
        self.r, self.model, self.theta = r, model, theta
        k = P.shape[1]
        self.left = self.Q[:, k:]
        self.U, s, self.Vt = np.linalg.svd(self.left.T @ self.A, full_matrices=True)
        self.s = np.r_[s, np.zeros(own - len(s))]
        self.known = (self.s > 1.0) & (np.arange(own) < most)
        self.rest = self.left.T @ r

    @property
    def told(self) -> FloatArray:
        """(p,) components of the residuals along the directions of the rig, 0 where there is no equation."""
        out = np.zeros(len(self.s))
        count = min(len(self.s), self.U.shape[1])
        out[:count] = self.U[:, :count].T @ self.rest
        return out

    def merit(self, r: FloatArray, z: FloatArray, everywhere: bool) -> float:
        """What a step must not make larger: residuals that no pose can take away, and with the prior the distance from the nominal rig."""
        return float(np.sum((self.left.T @ r) ** 2) + (z @ z if everywhere else 0.0))

    def poses(self, dz: FloatArray) -> FloatArray:
        """The poses' step that goes with the rig's."""
        right = self.Q[:, : len(self.R)].T @ (self.r + self.A @ dz)
        diagonal = np.abs(np.diag(self.R))
        if diagonal.min(initial=1.0) > RANK * diagonal.max(initial=1.0):
            return np.asarray(-scipy.linalg.solve_triangular(self.R, right) / self.size)
        return np.asarray(-np.linalg.lstsq(self.R, right, rcond=RANK)[0] / self.size)

    def covariance(self, prior: bool) -> tuple[FloatArray, int, FloatArray]:
        """Covariance of rig and poses where silent motions of the whole choose the frame and are no uncertainty, how many these are, and
        the other silent directions."""
        own, k = len(self.s), len(self.R)
        known = self.known
        motions, others = 0, self.Vt[:0]
        if prior:
            C = (self.Vt.T / (1.0 + self.s**2)) @ self.Vt
        else:
            basis, _ = np.linalg.qr(_motions(self.model, self.theta)[:own] / self.model.rig.width[:, None])
            silent = self.Vt[~known]
            left, cosines, _ = np.linalg.svd(silent @ basis, full_matrices=True)
            motions = int((cosines > IN_SPAN).sum())
            others = left[:, motions:].T @ silent
            C = (self.Vt[known].T / self.s[known] ** 2) @ self.Vt[known] + others.T @ others
        inverse = np.linalg.pinv(self.R, rcond=RANK) / self.size[:, None]
        # the poses follow the rig, and have the counts' noise
        follow = -inverse @ (self.Q[:, :k].T @ self.A)
        full = np.empty((own + k, own + k))
        full[:own, :own] = C
        full[own:, :own] = follow @ C
        full[:own, own:] = full[own:, :own].T
        full[own:, own:] = follow @ C @ follow.T + inverse @ inverse.T
        width = np.r_[self.model.rig.width, np.ones(k)]
        full = full * np.outer(width, width)
        return np.asarray((full + full.T) / 2), motions, others


def _in_frame_of_poses(found: Joint) -> Joint:
    """The same turned and shifted as a whole so that the tool's origin is nearest to the stated poses in the least squares sense.

    Linear in the motion; the covariance by the S-transformation that belongs to it (Baarda 1973).
    """
    model, theta = found.model, found.theta.copy()
    d, own = len(model.free), found.own
    rows = np.array([own + d * i + j for i in range(len(model.campaign.poses)) for j, c in enumerate(model.free) if c >= 3])
    for _ in range(MAX_STEPS):
        G = _motions(model, theta)
        move = np.linalg.lstsq(G[rows], -theta[rows], rcond=RANK)[0]
        theta = _moved(model, theta, move)
        if np.abs(G[rows] @ move).max() < 1e-9:
            break
    G = _motions(model, theta)
    H = np.zeros_like(G)
    H[rows] = G[rows]
    S = np.eye(len(theta)) - G @ np.linalg.solve(H.T @ G, H.T)
    poses = replace(found.campaign.poses, rows=model.poses(theta))
    campaign = replace(found.campaign, poses=poses)
    return replace(found, theta=theta, campaign=campaign, covariance=np.asarray(S @ found.covariance @ S.T))


def _moved(model: JointModel, theta: FloatArray, move: FloatArray) -> FloatArray:
    """The unknowns when rig and poses are turned by move (3) [rad] about the base frame's origin and then shifted by move (3) [mm]."""
    turn, shift = Rotation.from_rotvec(move[:3]), move[3:]
    out = theta.copy()
    place = {name: i for i, name in enumerate(model.unknowns.names)}
    for point in dict.fromkeys(c.from_point for c in model.campaign.cables):
        where = [place[f"{point}.{a}_mm"] for a in "xyz"]
        out[where] = turn.apply(theta[where]) + shift
        a, b = (place[f"{point}.guide_{g}_deg"] for g in ("alpha", "beta"))
        u = turn.apply(guide_direction(math.radians(theta[a]), math.radians(theta[b])))
        alpha, beta = math.degrees(math.asin(max(-1.0, min(1.0, u[2])))), math.degrees(math.atan2(-u[0], -u[1]))
        # on the branch of what it was
        out[a], out[b] = alpha, beta + 360.0 * round((theta[b] - beta) / 360.0)
    rows, stated = model.poses(theta), model.campaign.poses.rows
    turned = (turn * Rotation.from_quat(rows[:, 3:]) * Rotation.from_quat(stated[:, 3:]).inv()).as_rotvec()
    every = np.column_stack([np.degrees(turned), turn.apply(rows[:, :3] + model.arms) + shift - model.arms - stated[:, :3]])
    out[len(model.rig.names) :] = every[:, model.free].reshape(-1)
    return out


def _oriented(campaign: Campaign, seed: int) -> list[Campaign]:
    """The campaign with orientations that the counts fit best at the nominal rig, from several orientations of all poses at first."""
    model = JointModel(campaign, Unknowns((), np.zeros(0), np.zeros(0)), ROTATIONS)
    first = Rotation.concatenate([Rotation.create_group("O"), Rotation.random(12, rng=np.random.default_rng([seed, 17]))])
    found = []
    for turn in np.degrees(first.as_rotvec()):
        done = scipy.optimize.least_squares(
            model.residuals, np.tile(turn, len(campaign.poses)), jac=model.jacobian, method="lm", ftol=1e-6, xtol=1e-6, max_nfev=60
        )
        found.append((float(done.cost), done.x))
    found.sort(key=lambda pair: pair[0])
    chosen: list[FloatArray] = []
    for _, theta in found:
        rows = model.poses(theta)
        if all(np.abs((Rotation.from_quat(rows[:, 3:]) * Rotation.from_quat(o[:, 3:]).inv()).magnitude()).max() > 0.02 for o in chosen):
            chosen.append(rows)
    return [replace(campaign, poses=replace(campaign.poses, rows=rows, oriented=True)) for rows in chosen[:CANDIDATES]]


def _motions(model: JointModel, theta: FloatArray) -> FloatArray:
    """(p + d n, 6) what three turns [rad] about the base frame's origin and three shifts of rig and poses together do to the unknowns.
    Shifted points and guides of the rig's own cables turn with it; a value that is not solved stays, and then it is no motion."""
    names = model.unknowns.names
    rows, arms = model.poses(theta), model.arms
    values = dict(zip(names, theta, strict=True))
    out = np.zeros((len(names), 6))
    place = {name: i for i, name in enumerate(names)}
    for k, axis in enumerate(np.eye(3)):
        for point in dict.fromkeys(c.from_point for c in model.campaign.cables):
            own = model.campaign.rig.point(point)
            B = np.array([values.get(f"{point}.{a}_mm", own.position_mm[i]) for i, a in enumerate("xyz")])
            a = math.radians(values.get(f"{point}.guide_alpha_deg", own.guide_alpha_deg))
            b = math.radians(values.get(f"{point}.guide_beta_deg", own.guide_beta_deg))
            du = np.cross(axis, guide_direction(a, b))
            turned = {"guide_alpha_deg": du[2] / math.cos(a), "guide_beta_deg": -math.cos(b) * du[0] + math.sin(b) * du[1]}
            turned["guide_beta_deg"] /= math.cos(a)
            for i, c in enumerate("xyz"):
                if f"{point}.{c}_mm" in place:
                    out[place[f"{point}.{c}_mm"], k] = np.cross(axis, B)[i]
                    out[place[f"{point}.{c}_mm"], 3 + k] = axis[i]
            for key, rate in turned.items():
                if f"{point}.{key}" in place:
                    out[place[f"{point}.{key}"], k] = math.degrees(rate)
        inverse = np.linalg.inv(_left_jacobians(model.shifts(theta)[:, :3]))
        for i, name in enumerate(model.campaign.poses.names):
            move = {3 + j: (np.cross(axis, rows[i, :3] + arms[i])[j], axis[j]) for j in range(3)}
            move |= {j: (math.degrees((inverse[i] @ axis)[j]), 0.0) for j in range(3)}
            for c in model.free:
                out[place[f"pose {name}.{COMPONENTS[c]}"], k], out[place[f"pose {name}.{COMPONENTS[c]}"], 3 + k] = move[int(c)]
    return out


def _findings(found: Joint, frame: Frame, trusted: bool) -> list[Finding]:
    model, own, motions = found.model, found.own, found.motions
    n, d = len(model.campaign.poses), len(model.free)
    told = f"{model.equations} equations for {own} values of the rig and {d} of each of {n} poses"
    out = []
    if trusted:
        out.append(Finding(code="note", text=f"the reference poses have no orientations: {told}; the counts tell them"))
    else:
        held = "the nominal rig" if frame == "rig" else "the reference poses"
        text = f"{told}; {motions} motions of rig and poses together are free, and the frame is that of least squared shifts from {held}"
        out.append(Finding(code="frame", text=text, value=float(motions)))
    silent = own - int(found.known.sum()) - motions
    if silent:
        text = f"{silent}{' more' if motions else ''} direction(s) of the rig are undetermined; there the nominal rig's priors decide"
        out.append(Finding(code="underdetermined", text=text, value=float(silent)))
    freedom = found.freedom
    if freedom > 0 and scipy.stats.chi2.sf(found.chi2, freedom) < MISFIT:
        rms = float(np.sqrt(np.mean(found.residuals**2)))
        factor = math.sqrt(found.chi2 / freedom)
        text = f"residuals of {rms:.3g} mm rms exceed the stated noise; the uncertainties are multiplied by {factor:.3g}"
        out.append(Finding(code="misfit", text=text, value=rms))
    if not found.converged:
        out.append(Finding(code="not_converged", text="the least squares did not settle; the result is where they stopped"))
    return out
