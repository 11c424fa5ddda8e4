"""Poses and observation points estimated together, if the reference poses are unknown or cannot be trusted.

With seven cables or more to a body, or four or more to one point, every pose brings more equations than it has unknowns. The surplus
calibrates the rig, as multilateration by tracking interferometers calibrates itself (Takatsuji and others, Meas. Sci. Technol. 9, 1998;
Zhuang and others, 1992). Lengths do not determine the position of rig and poses together: six motions of the whole are free, and the frame
is chosen (`calibration.solve.frame`) - the free network of surveying (Mikhail and Ackermann, Observations and Least Squares, 1976, ch. 9).
The scale is that of the counts' length. Poses with measured positions only lack three rotations each, which the counts determine. Positions
fix the frame, and no motion is free.
"""

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.residuals import ROTATIONS, Frame, unknowns_of
from lmeasure.calibration.solve.unknown_poses import check_equations, fit_pose, oriented
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import CalibrationError, FloatArray
from lmeasure.estimation import Fit, Parameters, fit
from lmeasure.kernels import span_lengths
from lmeasure.text import message

MISFIT = 1e-3  # probability under which other starts are tried
RESTARTS = 2


def solve_jointly(
    campaign: Campaign, solve: tuple[str, ...], prior: bool, free: tuple[int, ...], *, frame: Frame, seed: int
) -> tuple[Model, Fit]:
    """Solve for poses and observation points together; free: as in `free_components`.

    CalibrationError if the unknowns have too few equations.
    """
    rig, trusted = unknowns_of(campaign, solve), free == ROTATIONS
    if not trusted and not {"position", "guide"} <= set(solve):
        raise CalibrationError(message("error.self_needs_position_and"))
    fixed = [c for c in campaign.cables if campaign.rig.counter(c).own]
    if not trusted and fixed:
        raise CalibrationError(message("error.self_channel_is_a", channel=fixed[0].channel, kind=fixed[0].kind))
    check_equations(campaign, rig, free)
    model, begun = begun_jointly(campaign, rig, free, frame, seed=seed)
    return model, _restarted(model, begun if prior else fit(model, begun.theta, near=True), prior, seed)


def begun_jointly(campaign: Campaign, rig: Parameters, free: tuple[int, ...], frame: Frame, *, seed: int) -> tuple[Model, Fit]:
    """The fit from the nominal rig with the prior on every direction; of orientations to begin with, where none is known, from the best."""
    starts = oriented(campaign, seed) if 0 in free and not campaign.poses.oriented else [campaign]
    models = [model_of(start, rig, free, frame) for start in starts]
    return min(((m, fit(m, m.zeros_begun(m.start), prior_everywhere=True)) for m in models), key=lambda found: found[1].objective)


def fitted_pose(model: Model, theta: FloatArray, pose: int, seed: int) -> FloatArray:
    """theta with the pose's own unknowns fitted to its own lengths, all others as they are. The pose is no zero pose."""
    at = int(np.flatnonzero(model.at == pose)[0])
    own = model.own + model.pose_unknowns * at + np.arange(model.pose_unknowns)
    mine = model.pose_index == pose
    cables, now = model.cable_index[mine], model.poses(theta)[pose]
    rows = np.ascontiguousarray(model.cables(theta)[0][cables])
    per_unit = model.campaign.mm_per_unit[cables]
    # lengths that the free spans must have there
    readings = span_lengths(rows, now[None])[0] - model.residuals(theta)[mine] / per_unit
    out = theta.copy()
    out[own] = fit_pose(rows, per_unit, readings, model.campaign.poses.rows[pose], free=model.free, begun=theta[own], seed=seed)
    return out


def _restarted(model: Model, found: Fit, prior: bool, seed: int) -> Fit:
    """Return the best fit from other starts too, if the residuals suggest another minimum: other poses between the same lengths, and other
    rigs within the priors."""

    def improbable() -> bool:
        return found.freedom > 0 and bool(scipy.stats.chi2.sf(found.chi2, found.freedom) < MISFIT)

    others = [int(i) for i in model.at if i not in model.campaign.zero]
    for _ in range(RESTARTS if 0 in model.free else 0):
        if not improbable():
            break
        start = found.theta
        for pose in others:
            start = fitted_pose(model, start, pose, seed)
        other = fit(model, start, prior)
        if other.objective > found.objective - found.freedom:
            break
        found = other
    rng = np.random.default_rng([seed, 23])
    for _ in range(RESTARTS):
        if not improbable():
            break
        start = found.theta.copy()
        start[: model.own] = model.parameters.nominal + model.parameters.width * rng.normal(size=model.own)
        other = fit(model, start, prior)
        if other.objective < found.objective:
            found = other
    return found
