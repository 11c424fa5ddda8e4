"""What each pose and channel says about the others: deletion residuals, outlier poses, slipped counters.

All of it from one matrix, P = V^-1 - V^-1 J (J^T V^-1 J)^-1 J^T V^-1 with J the Jacobian in the directions the data determine: P r are the
residuals as the fit sees them, and the block of P for some equations tells how far these equations are free to disagree with the rest. With
a prior on every direction P = (V + J J^T)^-1, J in prior widths: then the prior disagrees too.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.stats

from lmeasure.arrays import FloatArray, IntArray
from lmeasure.calibration.refine import Fit, Noise, residual_covariance
from lmeasure.calibration.unknowns import Model

MIN_FREEDOM = 3  # degrees of freedom that must be left for an F test to mean something
UNTOLD = 1e10  # condition from which the rest cannot do without these equations


@dataclass(frozen=True)
class Suspect:
    """Equations against all others: which pose (and channel), the F statistic of letting them shift, the logarithm of the probability of
    chance after Bonferroni's correction, and the shift of a slipped counter [mm]."""

    kind: str
    pose: str
    channel: str | None
    statistic: float
    log_probability: float
    shift_mm: float | None = None


@dataclass(frozen=True)
class Shift:
    """What all other poses say about the lengths of one pose: square of their joint misfit in units of its covariance, chi-squared with
    freedom degrees."""

    square: float
    freedom: int


@dataclass(frozen=True)
class HeldOut:
    """A pose that was kept out of the fit: errors (c,) measured less predicted changes since the zero pose [mm] of its counted channels,
    and their standard uncertainties (c,) from the calibration, the counts and the reference poses."""

    pose: str
    channels: tuple[str, ...]
    error_mm: FloatArray
    u_mm: FloatArray


def held_out(whole: Model, theta: FloatArray, fit: Fit, model: Model, noise: Noise, poses: tuple[str, ...]) -> list[HeldOut]:
    """How the fit of model does at poses that it has not seen. whole is the model of all poses, these among them; theta the fit's values of
    its unknowns, with those of the poses held out, if they have unknowns of their own, fitted to their own lengths: then the errors are
    what these leave over."""
    campaign, names = whole.campaign, whole.unknowns.names
    r, J, V = whole.residuals(theta), whole.jacobian(theta), residual_covariance(whole, theta, noise)
    used = ~np.isin(whole.pose_index, [campaign.poses.names.index(name) for name in poses])
    own = np.isin(names, model.unknowns.names)
    # the error at the zero pose is in the result and in the residual: they correlate
    shared = V[:, used] @ (J[:, own] @ fit.gain(model)).T
    C = V + J[:, own] @ fit.covariance @ J[:, own].T - shared - shared.T
    out = []
    for name in poses:
        rows = np.flatnonzero(whole.pose_index == campaign.poses.names.index(name))
        channels = tuple(campaign.cables[j].channel for j in whole.cable_index[rows])
        fitted = J[rows][:, [n.rsplit(".", 1)[0] == f"pose {name}" for n in names]]
        left = np.eye(len(rows)) - fitted @ np.linalg.pinv(fitted)
        u = np.sqrt(np.maximum(np.diag(left @ C[np.ix_(rows, rows)] @ left.T), 0.0))
        out.append(HeldOut(name, channels, -left @ r[rows], u))
    return out


class Validation:
    """Deletion diagnostics of a fit (Baarda's data snooping; Cook and Weisberg, Residuals and Influence in Regression, 1982).

    at_nominal: of the nominal rig instead, of which nothing is fitted: P = V^-1, which takes the errors that its residuals share, that of
    the zero pose above all, from one pose to the next.
    """

    def __init__(self, model: Model, fit: Fit, *, at_nominal: bool = False) -> None:
        self._model, self._fit = model, fit
        if at_nominal:
            self._P: FloatArray = np.asarray(np.linalg.inv(fit.V), dtype=np.float64)
            self._seen = self._P @ model.residuals(model.unknowns.nominal)
            self._astray = np.zeros(len(fit.V))
            return
        if fit.prior_everywhere and not model.pose_unknowns:
            # with z of unit variance before the data came, r_nominal = J z + e and r = V (V + J J')^-1 r_nominal
            J = model.jacobian(fit.theta) * model.unknowns.width
            self._P = np.asarray(np.linalg.inv(fit.V + J @ J.T), dtype=np.float64)
            self._seen = np.asarray(np.linalg.solve(fit.V, fit.residuals), dtype=np.float64)
            self._astray = np.zeros(len(fit.V))
            return
        L = np.linalg.cholesky(fit.V)
        Q, _ = np.linalg.qr(np.linalg.solve(L, fit.determined(model)))
        left = np.linalg.inv(L) - Q @ np.linalg.solve(L.T, Q).T
        self._P = np.asarray(left.T @ left, dtype=np.float64)
        self._seen = self._P @ fit.residuals
        # what of the residuals the fit could take away and did not: none at an optimum
        self._astray = fit.residuals - fit.V @ self._seen

    def _statistic(self, fall: float, freedom: int) -> tuple[float, float] | None:
        """F statistic and log probability of a fall of chi-squared bought with some degrees of freedom; a common noise level cancels."""
        left = self._fit.freedom - freedom
        if left < MIN_FREEDOM:
            return None
        rest = max(self._fit.chi2 - fall, 1e-300)
        value = (fall / freedom) / (rest / left)
        return value, float(scipy.stats.f.logsf(value, freedom, left))

    def _lengths_of(self, poses: IntArray) -> FloatArray:
        """(e, c) how the residuals follow a common shift of each length at the poses: a zero pose shifts all residuals of its cables."""
        campaign, model = self._model.campaign, self._model
        there = np.isin(model.pose_index, poses).astype(np.float64) - np.isin(campaign.zero[model.cable_index], poses)
        columns = there[:, None] * (model.cable_index[:, None] == np.arange(len(campaign.cables)))
        return np.asarray(columns[:, columns.any(axis=0)])

    def visits(self, pose: int) -> IntArray:
        """The poses that are visits of the reference pose, itself among them."""
        return np.flatnonzero(self._model.campaign.reference_of == pose)

    def shift(self, poses: IntArray, extra: float) -> Shift | None:
        """How the others contradict poses whose lengths were given the extra variance [mm^2], in common; that variance takes no part in
        the verdict. None where the others cannot tell.
        """
        E = self._lengths_of(poses)
        if not E.shape[1]:
            return None
        told = self._told(E.T @ self._P @ E, 1)
        if told is None:
            return None
        values, vectors = told
        shift = vectors.T @ (E.T @ self._seen) / values
        return Shift(float(np.sum(shift**2 / (1.0 / values - extra))), len(shift))

    def _told(self, information: FloatArray, poses: int) -> tuple[FloatArray, FloatArray] | None:
        """(k,) eigenvalues and (c, k) eigenvectors of what the others say about the c lengths of so many poses: all of it, but for as many
        combinations as these have unknowns of their own, which can make anything of them. None where the others cannot tell."""
        lost = poses * self._model.pose_unknowns
        values, vectors = np.linalg.eigh(information)
        values, vectors = values[lost:], vectors[:, lost:]
        if not len(values) or values[0] * UNTOLD < values[-1]:
            return None
        return values, vectors

    def deleted(self) -> list[tuple[IntArray, FloatArray]]:
        """For each pose with its other visits the rows of its residuals, and these [mm] from a fit without it; of poses with unknowns of
        their own, what these leave over of them. Poses that the rest cannot do without are left out."""
        out = []
        reference = self._model.campaign.reference_of[self._model.pose_index]
        for pose in np.unique(reference):
            rows = np.flatnonzero(reference == pose)
            told = self._told(self._P[np.ix_(rows, rows)], len(np.unique(self._model.pose_index[rows])))
            if told is None:
                continue
            values, vectors = told
            out.append((rows, vectors.T @ self._seen[rows] / values + vectors.T @ self._astray[rows]))
        return out

    def deletion_residuals(self) -> list[tuple[str, float]]:
        """For each pose the rms [mm] of its `deleted` residuals, per equation left over."""
        campaign, at = self._model.campaign, self._model.pose_index
        names = campaign.poses.names
        return [(names[campaign.reference_of[at[rows[0]]]], float(np.sqrt(np.mean(e**2)))) for rows, e in self.deleted()]

    def outlier_poses(self) -> list[Suspect]:
        """Reference poses with all their visits, and single visits, that the others contradict, least likely by chance first."""
        out = []
        campaign = self._model.campaign
        together = [self.visits(pose) for pose in np.unique(campaign.reference_of)]
        every = together + [np.array([visit]) for visits in together if len(visits) > 1 for visit in visits]
        for poses in every:
            judged = self.shift(poses, 0.0)
            tested = self._statistic(judged.square, judged.freedom) if judged else None
            if tested:
                name = campaign.poses.names[poses[0]]
                out.append(Suspect("outlier", name, None, tested[0], min(0.0, tested[1] + math.log(len(every)))))
        return sorted(out, key=lambda s: s.log_probability)

    def slipped_counters(self) -> list[Suspect]:
        """Channels whose counts are shifted by one constant from some pose on, in the order the poses were counted."""
        out = []
        campaign = self._model.campaign
        for j, c in enumerate(campaign.cables):
            own = np.flatnonzero(self._model.cable_index == j)
            when = self._model.pose_index if campaign.counted is None else campaign.counted[self._model.pose_index, j]
            own = own[np.argsort(when[own], kind="stable")]
            for place, first in enumerate(self._model.pose_index[own][1:], start=1):
                h = np.zeros(len(self._fit.residuals))
                h[own[place:]] = 1.0
                stiffness = float(h @ self._P @ h)
                if stiffness < 1e-9 * float(np.trace(self._P)):
                    continue
                pull = float(h @ self._seen)
                tested = self._statistic(pull * pull / stiffness, 1)
                if tested:
                    probability = min(0.0, tested[1] + math.log(campaign.counts.size))
                    # modelled less measured: a counter that lost counts reads less than the model
                    shift = -pull / stiffness
                    out.append(Suspect("slip", campaign.poses.names[first], c.channel, tested[0], probability, shift))
        return sorted(out, key=lambda s: s.log_probability)
