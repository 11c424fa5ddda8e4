"""Is something wrong with the data? Each suspicion is a test with its evidence, never a repair."""

from dataclasses import dataclass, replace

import numpy as np
import scipy.stats
from numpy.typing import NDArray

from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.refine import Fit
from lmeasure.calibration.unknowns import Model

FloatArray = NDArray[np.float64]

SCALES = (0.25, 0.5, 2.0, 4.0)
"""Decoding slips that occur: quadrature edges counted once, twice or four times, a shifted bit."""

EVIDENCE = 16.0
"""Smallest gain in twice the log posterior that names another hypothesis: odds of e^8."""

ALARM = 1e-4
"""Probability under which a misfit is no chance."""


@dataclass(frozen=True)
class Suspicion:
    """A hypothesis that explains a channel better than the rig as stated: its kind (scale or sign), value, and gain in evidence."""

    kind: str
    value: float
    gain: float


GROSS_MM = 1.0
"""Residuals that no reference pose or rounding makes, but a decoding slip does."""


def gross(fit: Fit) -> bool:
    """Whether a decoding slip is worth asking for: residuals of millimetres, or nominal values pulled far beyond their priors.

    fit has the prior on every direction. Prior and data together are chi-squared with one degree of freedom per equation.
    """
    if float(np.sqrt(np.mean(fit.residuals**2))) > GROSS_MM:
        return True
    return bool(scipy.stats.chi2.sf(fit.objective / _noise(fit), len(fit.residuals)) < ALARM)


def _noise(fit: Fit) -> float:
    """Variance of the residuals in units of the stated one, at least 1."""
    return max(1.0, fit.chi2 / max(len(fit.residuals) - fit.rank, 1))


def with_scale(campaign: Campaign, cable: int, scale: float) -> Campaign:
    """The campaign as it would be if a channel's recorded counts were `scale` times what the rig says (negative: the sign is wrong too)."""
    counts = campaign.counts.copy()
    counts[:, cable] /= scale
    return replace(campaign, counts=counts)


def gain(stated: Fit, other: Fit) -> float:
    """How much better another hypothesis explains the same data, in units of its own noise."""
    return (stated.objective - other.objective) / _noise(other)


@dataclass(frozen=True)
class PoseTest:
    """A reference pose against all others: F statistic of its removal, degrees of freedom, probability of chance (Bonferroni)."""

    pose: str
    statistic: float
    probability: float


def outlier_poses(model: Model, fit: Fit) -> list[PoseTest]:
    """Reference poses that the others contradict, worst first, by the mean-shift outlier test (Baarda; Cook and Weisberg 1982).

    For each pose an own shift is allowed to its residuals; the fall of chi-squared is compared with what is left by an F test, so an
    unknown common noise level does not matter. A campaign whose redundancy does not allow the test gives nothing.
    """
    e, rank = len(fit.residuals), fit.rank
    J = model.jacobian(fit.theta) * model.unknowns.width @ fit.directions[fit.known].T
    inverse = np.linalg.inv(fit.V)
    P = inverse - inverse @ J @ np.linalg.solve(J.T @ inverse @ J, J.T @ inverse)
    out = []
    poses = np.unique(model.pose_index)
    for pose in poses:
        rows = np.flatnonzero(model.pose_index == pose)
        block = P[np.ix_(rows, rows)]
        left = e - rank - len(rows)
        if left < 3 or np.linalg.cond(block) > 1e10:
            continue
        shift = P[rows] @ fit.residuals
        fall = float(shift @ np.linalg.solve(block, shift))
        rest = max(fit.chi2 - fall, 1e-12)
        statistic = (fall / len(rows)) / (rest / left)
        probability = min(1.0, len(poses) * float(scipy.stats.f.sf(statistic, len(rows), left)))
        out.append(PoseTest(model.campaign.poses.names[pose], statistic, probability))
    return sorted(out, key=lambda t: t.probability)
