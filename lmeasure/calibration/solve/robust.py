"""Reference poses that the others contradict are taken back by a robust loss (`estimation.robust`).

The unit is the pose with all its visits: its lengths are wrong together when the robot did not stand where it says. The zero pose
shifts all lengths of its cables and is judged like any other.
"""

from dataclasses import replace

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.hold_out import shifted_lengths
from lmeasure.estimation import BIWEIGHT, EXCLUDED, Fit, Group, Weights, robust_fit
from lmeasure.rig import Finding

NAMED = 0.5  # weight under which a pose is named


def robust_poses(model: Model, found: Fit) -> tuple[Model, Fit, Weights]:
    """The fit with Tukey's biweight on the poses; the model with the variance that each pose was given, and the weights (n,), the same for
    all visits of one."""
    reference, which = np.unique(model.campaign.reference_of, return_inverse=True)
    groups = [
        Group(shifted_lengths(model, np.flatnonzero(which == i)), np.flatnonzero(model.pose_index == pose), int(np.sum(which == i)))
        for i, pose in enumerate(reference)
    ]
    weighted, found, weights = robust_fit(found, groups, lambda v: model.with_noise(replace(model.noise, robust_variance_mm2=v[which])))
    return weighted, found, replace(weights, weight=weights.weight[which])


def down_weighted(campaign: Campaign, weights: Weights) -> list[Finding]:
    """One finding for each pose that the robust loss took back."""
    out = []
    for i in np.flatnonzero(weights.weight < NAMED):
        name, weight = campaign.poses.names[i], 0.0 if weights.weight[i] <= EXCLUDED else float(weights.weight[i])
        text = f"pose {name}: the other poses contradict it; the robust loss gave it the weight {weight:.2g}"
        out.append(Finding(code="down_weighted", pose=name, value=weight, text=text))
    return out


def weights_entry(campaign: Campaign, weights: Weights) -> dict[str, object]:
    """The record's account of the robust loss."""
    every = [{"pose": n, "weight": float(w)} for n, w in zip(campaign.poses.names, weights.weight, strict=True)]
    return {"loss": "Tukey biweight", "constant": BIWEIGHT, "scale": weights.scale, "weights": every}
