"""Residuals larger than the stated noise: who is to blame, and how large the reference poses' errors must be."""

import math
from dataclasses import replace

import numpy as np
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray

from lmeasure.calibration.refine import Fit, Noise, Refit
from lmeasure.calibration.unknowns import Model
from lmeasure.calibration.validation import Suspect, Validation
from lmeasure.calibration_record import Finding

FloatArray = NDArray[np.float64]

CHANCE = 1e-3
"""Probability under which residuals are not put down to chance."""


def explain_misfit(model: Model, found: Fit, noise: Noise, refit: Refit, blamed: list[str]) -> tuple[Fit, Noise, list[Finding]]:
    """The fit with a covariance that covers what it does not explain, the noise it was made with, and findings.

    When chi-squared exceeds chance: name the pose or the slipped counter that the others contradict most, then estimate a common error of
    the reference positions from the residuals and fit again with it. blamed are channels that a gross diagnosis has named already: their
    residuals are no measure of the poses. Poses whose places are unknown have no errors to estimate. What is left unexplained multiplies
    the covariance.
    """
    if not _improbable(found):
        return found, noise, []
    findings = []
    rms = float(np.sqrt(np.mean(found.residuals**2)))
    if blamed:
        text = f"residuals of {rms:.3g} mm rms exceed the noise; look first at what is named above ({', '.join(blamed)})"
        findings.append(Finding(code="misfit", text=text, value=rms))
    else:
        findings += _contradictions(model, found)
    if not blamed and not model.places_known:
        factor = math.sqrt(found.chi2 / found.freedom)
        text = f"residuals of {rms:.3g} mm rms exceed the stated noise; the uncertainties are multiplied by {factor:.3g}"
        findings.append(Finding(code="misfit", text=text, value=rms))
    elif not blamed:
        before = noise
        # the second round settles the estimate where the first moved the optimum
        for _ in range(2):
            u = _pose_error(model, found)
            if u == 0.0:
                break
            noise = noise.widened(u)
            found = refit(found.theta, noise, False)
            if not _improbable(found):
                break
        u = float(np.sqrt(np.mean(noise.u_position_mm**2 - before.u_position_mm**2)))
        text = (
            f"residuals of {rms:.3g} mm rms exceed the stated noise; reference poses in error by {u:.3g} mm (1 sigma per axis) "
            "would explain them, and the uncertainties include that"
        )
        findings.append(Finding(code="misfit", text=text, value=u))
    if _improbable(found):
        excess = found.chi2 / found.freedom
        found = replace(found, covariance=np.asarray(found.covariance * excess), excess=excess)
    return found, noise, findings


def _improbable(found: Fit) -> bool:
    freedom = found.freedom
    return freedom >= 1 and bool(scipy.stats.chi2.sf(found.chi2, freedom) < CHANCE)


def _contradictions(model: Model, found: Fit) -> list[Finding]:
    validation = Validation(model, found)
    tests: list[Suspect] = [*validation.outlier_poses()[:1], *validation.slipped_counters()[:1]]
    worst = min(tests, key=lambda s: s.log_probability, default=None)
    if worst is None or worst.log_probability > math.log(CHANCE):
        return []
    odds = f"F = {worst.statistic:.3g}, p = {math.exp(worst.log_probability):.2g}"
    if worst.kind == "outlier":
        text = f"pose {worst.pose}: the other poses contradict it ({odds}); it was used all the same"
        return [Finding(code="outlier", pose=worst.pose, value=worst.statistic, text=text)]
    text = (
        f"channel {worst.channel}: its counter slipped by {worst.shift_mm:+.4g} mm from pose {worst.pose} on ({odds}); nothing was repaired"
    )
    return [Finding(code="slip", channel=worst.channel, pose=worst.pose, value=worst.shift_mm, text=text)]


def _pose_error(model: Model, found: Fit) -> float:
    """The extra standard uncertainty of the reference positions [mm] at which chi-squared equals its degrees of freedom (method of moments,
    with the model linearised at the fit)."""
    J = found.determined(model)
    reference = model.campaign.reference_of
    visits = reference[:, None] == np.unique(reference)
    by_pose = np.einsum("eni,nr->eri", model.pose_jacobian(found.theta)[:, :, 3:], visits).reshape(len(found.residuals), -1)
    extra = by_pose @ by_pose.T
    freedom = found.freedom

    def excess(log_u: float) -> float:
        L = np.linalg.cholesky(found.V + math.exp(2 * log_u) * extra)
        A, r = np.linalg.solve(L, J), np.linalg.solve(L, found.residuals)
        Q, _ = np.linalg.qr(A)
        r = r - Q @ (Q.T @ r)
        return float(r @ r) - freedom

    low, high = math.log(1e-5), math.log(1e3)
    if excess(low) <= 0:
        return 0.0
    if excess(high) >= 0:
        return math.exp(high)
    return math.exp(scipy.optimize.brentq(excess, low, high, xtol=1e-3))
