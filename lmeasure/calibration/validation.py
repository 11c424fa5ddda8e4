"""What each pose and channel says about the others: deletion residuals, outlier poses, slipped counters.

All of it from one matrix, P = V^-1 - V^-1 J (J^T V^-1 J)^-1 J^T V^-1 with J the Jacobian in the directions the data determine: P r are the
residuals as the fit sees them, and the block of P for some equations tells how far these equations are free to disagree with the rest.
"""

import math
from dataclasses import dataclass

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from lmeasure.calibration.refine import Fit
from lmeasure.calibration.unknowns import Model

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

MIN_FREEDOM = 3  # degrees of freedom that must be left for an F test to mean something


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


class Validation:
    """Deletion diagnostics of a fit (Baarda's data snooping; Cook and Weisberg, Residuals and Influence in Regression, 1982)."""

    def __init__(self, model: Model, fit: Fit) -> None:
        self._model, self._fit = model, fit
        J = model.jacobian(fit.theta) * model.unknowns.width @ fit.directions[fit.known].T
        inverse = np.linalg.inv(fit.V)
        self._P = inverse - inverse @ J @ np.linalg.solve(J.T @ inverse @ J, J.T @ inverse)
        self._seen = self._P @ fit.residuals

    def _statistic(self, fall: float, freedom: int) -> tuple[float, float] | None:
        """F statistic and log probability of a fall of chi-squared bought with some degrees of freedom; a common noise level cancels."""
        left = len(self._fit.residuals) - self._fit.rank - freedom
        if left < MIN_FREEDOM:
            return None
        rest = max(self._fit.chi2 - fall, 1e-300)
        value = (fall / freedom) / (rest / left)
        return value, float(scipy.stats.f.logsf(value, freedom, left))

    def _rows(self, pose: int) -> IntArray:
        return np.flatnonzero(self._model.pose_index == pose)

    def deletion_residuals(self) -> list[tuple[str, float]]:
        """For each pose the rms [mm] of its residuals from a fit without it; poses that the rest cannot do without are left out."""
        out = []
        for pose in np.unique(self._model.pose_index):
            rows = self._rows(pose)
            block = self._P[np.ix_(rows, rows)]
            if np.linalg.cond(block) > 1e10:
                continue
            deleted = np.linalg.solve(block, self._seen[rows])
            out.append((self._model.campaign.poses.names[pose], float(np.sqrt(np.mean(deleted**2)))))
        return out

    def outlier_poses(self) -> list[Suspect]:
        """Reference poses that the others contradict, least likely by chance first."""
        out = []
        poses = np.unique(self._model.pose_index)
        for pose in poses:
            rows = self._rows(pose)
            block = self._P[np.ix_(rows, rows)]
            if np.linalg.cond(block) > 1e10:
                continue
            fall = float(self._seen[rows] @ np.linalg.solve(block, self._seen[rows]))
            tested = self._statistic(fall, len(rows))
            if tested:
                name = self._model.campaign.poses.names[pose]
                out.append(Suspect("outlier", name, None, tested[0], min(0.0, tested[1] + math.log(len(poses)))))
        return sorted(out, key=lambda s: s.log_probability)

    def slipped_counters(self) -> list[Suspect]:
        """Channels whose counts are shifted by one constant from some pose on, in the order the poses were counted."""
        out = []
        campaign = self._model.campaign
        for j, c in enumerate(campaign.cables):
            own = np.flatnonzero(self._model.cable_index == j)
            for first in self._model.pose_index[own][1:]:
                h = np.zeros(len(self._fit.residuals))
                h[own[self._model.pose_index[own] >= first]] = 1.0
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
