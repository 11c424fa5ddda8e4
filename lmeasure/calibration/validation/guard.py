"""Is the calibrated rig better than the drawing? Both predict the changes of lengths at poses left out, and their errors are compared."""

from dataclasses import dataclass

import numpy as np
import scipy

from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.diagnosis import GROSS_MM, residual_rms
from lmeasure.estimation import Deletion, Fit, improbable
from lmeasure.text import message

SIGNIFICANT = 1e-3
"""Probability under which a rig that predicts no worse than the nominal one would look as bad by chance."""

LEAST = 5  # poses

BETTER = 3.0
"""Number of times better than the nominal rig's the predictions must be of a rig whose residuals are gross."""


@dataclass(frozen=True)
class AgainstNominal:
    """Root mean squares [mm] of the errors of length changes at poses left out, by the rig calibrated without each and by the nominal rig;
    how many poses; probability of errors this much larger than the nominal rig's if they are not."""

    rms_mm: float
    nominal_mm: float
    poses: int
    p_worse: float
    misfit: bool = False
    """Whether residuals of millimetres, beyond the noise, are put down to errors."""

    @property
    def worse(self) -> bool:
        """Return whether the calibrated rig is significantly worse, or counts and poses contradict each other and it is hardly better.

        The comparison uses the campaign's own poses. If these are wrong, both rigs have their errors, and a rig fitted to wrong poses looks
        as good as the nominal one.
        """
        return self.p_worse < SIGNIFICANT or (self.misfit and self.rms_mm > self.nominal_mm / BETTER)

    def refusal(self) -> str:
        """Return why the rig must not be used."""
        if self.p_worse < SIGNIFICANT:
            return message("calibration.calibrated_rig_worse_than", why=self.text())
        return message("calibration.counts_poses_contradict_each", why=self.text())

    def text(self) -> str:
        return message("calibration.lengths_poses_each_left", poses=self.poses, rms=self.rms_mm, nominal=self.nominal_mm, p=self.p_worse)


def against_nominal(model: Model, found: Fit, first: Fit) -> AgainstNominal | None:
    """Compare a fit with its nominal rig; None with too few poses that others determine, or unknown poses, for which the nominal rig
    predicts nothing. first: the fit under the stated noise.

    Each pose is predicted from all others, under the covariance of the residuals: an error of the zero pose is in both, and favours
    neither. The errors at one pose are one observation: cables share the pose's own error. A one-sided t test of the logarithms of the
    ratios of their mean squares, pose by pose, so that a few wild poses decide nothing.
    """
    if model.pose_unknowns:
        return None
    groups = model.campaign.reference_of[model.pose_index]
    left_out = Deletion(found).deleted(groups)
    determined = {int(rows[0]) for rows, _ in left_out}
    drawn = [errors for rows, errors in Deletion(found, at_start=True).deleted(groups) if int(rows[0]) in determined]
    if len(left_out) < LEAST or len(drawn) != len(left_out):
        return None
    own, nominal = (np.array([np.mean(errors**2) for errors in each]) for each in ([e for _, e in left_out], drawn))
    if not (np.isfinite(own).all() and (own > 0).all() and (nominal > 0).all()):
        return None
    gross = residual_rms(found) > GROSS_MM and improbable(first)
    test = scipy.stats.ttest_1samp(np.log(own / nominal), 0.0, alternative="greater")
    return AgainstNominal(float(np.sqrt(own.mean())), float(np.sqrt(nominal.mean())), len(own), float(test.pvalue), gross)
