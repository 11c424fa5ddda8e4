"""Robust loss for reference poses that the others contradict: Tukey's biweight by iteratively reweighted least squares.

The unit is the pose: its lengths are wrong together when the robot did not stand where it says. d is a pose's studentised deletion
residual: the shift of its lengths that all other poses ask for, in units of that shift's own covariance, so that a pose of great leverage
cannot hide; the zero pose shifts all lengths of its cables and is judged like any other. d^2 is chi-squared with as many degrees of
freedom as the pose has lengths; z is the normal deviate as improbable as it, and t = z/scale with the scale from the median of all z, at
least 1: the noise as stated. The biweight w = (1 - (t/c)^2)^2, zero beyond c, is 95 % efficient where nothing is wrong.

A weight is carried as a variance: the pose's lengths get the independent variance s^2 (1/w - 1) with s^2 their stated one, on top of it.
The covariance of the result is then that of a least squares with these variances, a little wider than without a robust loss, as it must be.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from lmeasure.arrays import FloatArray
from lmeasure.calibration.refine import Fit, Noise, Refit, residual_covariance
from lmeasure.calibration.unknowns import Model
from lmeasure.calibration.validation import Validation
from lmeasure.calibration_record import Finding

BIWEIGHT = 4.685  # Tukey's constant for 95 % efficiency
ROUNDS = 30
SETTLED = 1e-3  # of a weight
NEAR = 0.2  # of a weight, from where the optimum moves little
NAMED = 0.5  # weight under which a pose is named
EXCLUDED = 1e-6
"""Least weight, of the stated variances: a pose without any has a finite variance still. It leaves a pose 100 mm off a pull of 0.0001 mm,
and smaller ones would leave its deletion residual no digits."""


@dataclass(frozen=True)
class Weights:
    """weight (n,) of each pose, the same for all visits of one, 1 where it is not used or nothing speaks against it; scale of the noise in
    stated ones."""

    weight: FloatArray
    scale: float

    def findings(self, names: tuple[str, ...]) -> list[Finding]:
        """One finding for each pose that the robust loss took back."""
        out = []
        for i in np.flatnonzero(self.weight < NAMED):
            weight = 0.0 if self.weight[i] <= EXCLUDED else float(self.weight[i])
            text = f"pose {names[i]}: the other poses contradict it; the robust loss gave it the weight {weight:.2g}"
            out.append(Finding(code="down_weighted", pose=names[i], value=weight, text=text))
        return out

    def entry(self, names: tuple[str, ...]) -> dict[str, object]:
        """The record's account of the robust loss."""
        weights = [{"pose": n, "weight": float(w)} for n, w in zip(names, self.weight, strict=True)]
        return {"loss": "Tukey biweight", "constant": BIWEIGHT, "scale": self.scale, "weights": weights}


def robust_fit(model: Model, found: Fit, noise: Noise, refit: Refit) -> tuple[Fit, Noise, Weights]:
    """The fit with Tukey's biweight on the poses; the noise with the variance that each pose was given, and the weights.

    The biweight has many optima. Begun at found, which bad poses may have pulled far away, and, with the weights it then has, at the
    nominal rig; of the two, the one that believes more of the poses.
    """
    first = _reweighted(model, found, noise, refit)
    second = _reweighted(model, refit(model.unknowns.nominal, first[1], False), first[1], refit)
    return max(first, second, key=lambda result: float(result[2].weight.sum()))


def _reweighted(model: Model, found: Fit, noise: Noise, refit: Refit) -> tuple[Fit, Noise, Weights]:
    poses, reference = len(model.campaign.poses), model.campaign.reference_of
    weights = Weights(np.ones(poses), 1.0)
    variance = np.zeros(poses) if noise.robust_variance_mm2 is None else noise.robust_variance_mm2
    base = residual_covariance(model, found.theta, replace(noise, robust_variance_mm2=None))
    stated = np.bincount(model.pose_index, np.diag(base), poses) / np.maximum(np.bincount(model.pose_index, minlength=poses), 1)
    stated[stated == 0.0] = np.diag(base).mean()  # the zero pose
    for _ in range(ROUNDS):
        validation = Validation(model, found)
        z = np.full(poses, np.nan)
        for pose in np.unique(reference):
            judged = validation.shift(validation.visits(pose), float(variance[pose]))
            if judged is not None:
                z[pose] = _normal_deviate(judged.square, judged.freedom)
        z = z[reference]
        scale = max(1.0, float(np.nanmedian(z)) / scipy.stats.norm.ppf(0.75)) if np.isfinite(z).any() else 1.0
        t = np.where(np.isfinite(z), z, 0.0) / (scale * BIWEIGHT)
        weight = np.where(t < 1.0, (1.0 - np.minimum(t, 1.0) ** 2) ** 2, 0.0).clip(EXCLUDED)
        variance = stated * np.minimum(scale**2 * (1.0 / weight - 1.0), 1.0 / EXCLUDED)
        change = float(np.abs(weight - weights.weight).max())
        weights = Weights(weight, scale)
        noise = replace(noise, robust_variance_mm2=variance)
        found = refit(found.theta, noise, change < NEAR)
        if change < SETTLED:
            break
    return found, noise, weights


def _normal_deviate(square: float, freedom: int) -> float:
    """The |z| of a standard normal variable that is as improbable as a chi-squared with that many degrees of freedom."""
    probability = float(scipy.stats.chi2.sf(square, freedom))
    # beyond doubles' reach the degrees of freedom hardly matter
    return float(scipy.stats.norm.isf(probability / 2)) if probability > 1e-280 else math.sqrt(square)
