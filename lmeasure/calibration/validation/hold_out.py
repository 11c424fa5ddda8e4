"""Evidence of each pose and channel about the others: deletion residuals, outlier poses, slipped counters, poses held out."""

import math
from dataclasses import dataclass

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray, IntArray
from lmeasure.estimation import Deletion, Fit, validation_residuals

MOVED = 1e-3
"""Probability of chance below which a point is named that moved."""


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
class ValidationPose:
    """A pose that was kept out of the fit: errors (c,) measured minus predicted changes since the zero pose [mm] of its counted channels,
    and their standard uncertainties (c,) from the calibration, the counts and the reference poses."""

    pose: str
    channels: tuple[str, ...]
    error_mm: FloatArray
    u_mm: FloatArray


def validation_errors(whole: Model, theta: FloatArray, fit: Fit, poses: tuple[str, ...]) -> list[ValidationPose]:
    """Return the errors of a fit at validation poses. whole is the model of all poses; theta the fit's values of its unknowns. Unknowns of
    the validation poses, if any, are fitted to their own lengths: then the errors are the residuals."""
    campaign, names = whole.campaign, whole.names
    kept = np.isin(whole.pose_index, [campaign.poses.names.index(name) for name in poses])
    r, C = validation_residuals(whole, theta, fit, np.flatnonzero(~kept))
    J = whole.jacobian(theta)
    out = []
    for name in poses:
        rows = np.flatnonzero(whole.pose_index == campaign.poses.names.index(name))
        channels = tuple(campaign.cables[j].channel for j in whole.cable_index[rows])
        fitted = J[rows][:, [n.rsplit(".", 1)[0] == f"pose {name}" for n in names]]
        left = np.eye(len(rows)) - fitted @ np.linalg.pinv(fitted)
        u = np.sqrt(np.maximum(np.diag(left @ C[np.ix_(rows, rows)] @ left.T), 0.0))
        out.append(ValidationPose(name, channels, -left @ r[rows], u))
    return out


def shifted_lengths(model: Model, poses: IntArray) -> FloatArray:
    """(e, c) how the residuals follow a common shift of each length at the poses: a zero pose shifts all residuals of its cables."""
    campaign = model.campaign
    begun = np.isin(campaign.zero, poses) & campaign.from_zero
    there = np.isin(model.pose_index, poses).astype(np.float64) - begun[model.cable_index]
    columns = there[:, None] * (model.cable_index[:, None] == np.arange(len(campaign.cables)))
    return np.asarray(columns[:, columns.any(axis=0)])


def deletion_residuals(model: Model, fit: Fit) -> list[tuple[str, float]]:
    """Return for each pose with its other visits the rms [mm] of its residuals from a fit without it, per surplus equation."""
    campaign, at = model.campaign, model.pose_index
    left_out = Deletion(fit).deleted(campaign.reference_of[at])
    return [(campaign.poses.names[campaign.reference_of[at[rows[0]]]], float(np.sqrt(np.mean(e**2)))) for rows, e in left_out]


def poses_and_visits(campaign: Campaign) -> list[IntArray]:
    """Return the indices of each reference pose with all its visits, and of each single visit of poses that have several."""
    together = [np.flatnonzero(campaign.reference_of == pose) for pose in np.unique(campaign.reference_of)]
    return together + [np.array([visit]) for visits in together if len(visits) > 1 for visit in visits]


def outlier_poses(model: Model, fit: Fit) -> list[Suspect]:
    """Reference poses with all their visits, and single visits, that the others contradict, least likely by chance first."""
    out, campaign, deletion = [], model.campaign, Deletion(fit)
    every = poses_and_visits(campaign)
    for poses in every:
        judged = deletion.shift(shifted_lengths(model, poses))
        tested = deletion.test(judged.square, judged.freedom) if judged else None
        if tested:
            name = campaign.poses.names[poses[0]]
            out.append(Suspect("outlier", name, None, tested[0], min(0.0, tested[1] + math.log(len(every)))))
    return sorted(out, key=lambda s: s.log_probability)


def outlier_readings(model: Model, fit: Fit) -> list[Suspect]:
    """Return single readings that all others contradict, least likely by chance first."""
    out, campaign, deletion = [], model.campaign, Deletion(fit)
    for e, (i, j) in enumerate(zip(model.pose_index, model.cable_index, strict=True)):
        column = np.zeros(len(fit.residuals))
        column[e] = 1.0
        step = deletion.step(column)
        tested = None if step is None else deletion.test(step[1], 1)
        if tested:
            probability = min(0.0, tested[1] + math.log(campaign.counts.size))
            out.append(Suspect("outlier", campaign.poses.names[i], campaign.cables[j].channel, tested[0], probability))
    return sorted(out, key=lambda s: s.log_probability)


def moved_points(model: Model, fit: Fit) -> Suspect | None:
    """Return the observation point that most likely moved between two poses, with the size of its move; None where chance explains it.

    A counter that slips looks nearly the same: the lengths of one cable are off from some pose on.
    """
    campaign, deletion = model.campaign, Deletion(fit)
    J, every = model.pose_jacobian(fit.theta), np.arange(model.equations)
    # a point that moves is a tool that moves the other way, for its cable alone
    by_move, found = -J[every, model.pose_index, 3:], list[Suspect]()
    for j, c in enumerate(campaign.drums):
        own = model.cable_index == j
        when = model.pose_index if campaign.counted is None else np.nan_to_num(campaign.counted[model.pose_index, j])
        for first in np.unique(when[own])[2:-1]:
            columns = by_move * (own & (when >= first))[:, None]
            judged = deletion.added(columns)
            tested = deletion.test(judged.square, judged.freedom) if judged else None
            if tested:
                pose = campaign.poses.names[model.pose_index[own & (when == first)][0]]
                size = float(np.linalg.norm(deletion.sizes(columns)))
                found.append(Suspect("moved", pose, c.channel, tested[0], min(0.0, tested[1] + math.log(campaign.counts.size)), size))
    worst = min(found, key=lambda s: s.log_probability, default=None)
    return worst if worst is not None and worst.log_probability < math.log(MOVED) else None


def slipped_counters(model: Model, fit: Fit) -> list[Suspect]:
    """Channels whose counts are shifted by one constant from some pose on, in the order the poses were counted."""
    out, campaign, deletion = [], model.campaign, Deletion(fit)
    for j, c in enumerate(campaign.cables):
        own = np.flatnonzero(model.cable_index == j)
        when = model.pose_index if campaign.counted is None else campaign.counted[model.pose_index, j]
        own = own[np.argsort(when[own], kind="stable")]
        for place, first in enumerate(model.pose_index[own][1:], start=1):
            later = np.zeros(len(fit.residuals))
            later[own[place:]] = 1.0
            step = deletion.step(later)
            tested = None if step is None else deletion.test(step[1], 1)
            if step and tested:
                probability = min(0.0, tested[1] + math.log(campaign.counts.size))
                # modelled less measured: a counter that lost counts reads less than the model
                out.append(Suspect("slip", campaign.poses.names[first], c.channel, tested[0], probability, -step[0]))
    return sorted(out, key=lambda s: s.log_probability)
