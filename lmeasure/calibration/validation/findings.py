"""What a reader of a calibration must know beside its values, in words: what the counts leave open, and what is odd about the result."""

import math

import numpy as np

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.lp_search import Box
from lmeasure.calibration.solve.points import Point
from lmeasure.calibration.solve.prediction import Prediction
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.estimation import Fit, Parameters
from lmeasure.rig import GUIDE, PLACE, Finding, Unobservable
from lmeasure.sensors import effects_of

BEGINS = "no point can be searched for alone: the nominal rig starts the least squares"


def underdetermined(campaign: Campaign, model: Model, silent: list[Unobservable], by_prior: Prediction) -> list[Finding]:
    """Which points the counts do not determine, and how much of that reaches the lengths."""
    out = []
    for owner in dict.fromkeys(u.point for u in silent):
        own = [u for u in silent if u.point == owner]
        seen = [j for j, c in enumerate(campaign.cables) if owner in (c.from_point, f"tool.{c.to_point}", c.channel)]
        equations = int(np.isin(model.cable_index, seen).sum())
        cables = [j for j in seen if j < len(campaign.drums)]
        share = float(np.sqrt(np.mean(by_prior.length_mm[:, cables] ** 2))) if cables else 0.0
        text = (
            f"{owner}: {equations} equations leave {len(own)} of {len(model.parameters.of(owner))} unknowns undetermined; there the "
            f"nominal rig's priors decide ({share:.4f} mm rms of the predicted lengths)"
        )
        out.append(Finding(code="underdetermined", text=text, value=float(len(own))))
    return out


def unknown_temperature(campaign: Campaign) -> list[Finding]:
    """A rig that says how it grows, and counts that do not say how warm it was."""
    effects = effects_of(campaign.rig, campaign.drums)
    if effects is None or not effects.thermal or campaign.temperature_c is not None:
        return []
    text = f"the rig states expansions and no file a temperature_c: {effects.reference_c:g} deg C is taken, the rig's reference"
    return [Finding(code="temperature", text=text)]


def poses_findings(model: Model, found: Fit) -> list[Finding]:
    """What was unknown of the poses, and what holds the frame."""
    if not model.pose_unknowns:
        return []
    n, d = len(model.at), model.pose_unknowns
    told = f"{model.equations} equations for {model.own} values of the rig and {d} of each of {n} poses"
    if model.frame is None:
        return [Finding(code="note", text=f"the reference poses have no orientations: {told}; the counts tell them; {BEGINS}")]
    held = "the nominal rig" if model.frame == "rig" else "the reference poses"
    if found.prior_everywhere:
        text = f"{told}; the priors of the nominal rig act everywhere, and the frame is that of least squared shifts from {held}"
    else:
        text = (
            f"{told}; {found.motions} motions of rig and poses together are free, and the frame is that of least squared shifts from {held}"
        )
    text += f". The scale is that of the counts; {BEGINS}"
    return [Finding(code="frame", text=text, value=float(found.motions))]


def _u_of(name: str, found: Fit) -> float:
    """Standard uncertainty of a value, 0 where it is not solved."""
    names = found.problem.parameters.names
    return math.sqrt(found.covariance[names.index(name), names.index(name)]) if name in names else 0.0


def shape_findings(
    campaign: Campaign, unknowns: Parameters, found: Fit, points: list[Point], *, searched: dict[str, list[Box]]
) -> list[Finding]:
    """Results at the edge of the search or beyond, missing coarse solutions, and a fit that did not settle."""
    out = []
    for point in points:
        for rival in point.rivals[:1]:
            there = ", ".join(f"{n.split('.', 1)[1]} {v:.6g}" for n, v in zip(point.model.names, rival.theta, strict=True))
            text = f"{point.name}: another result fits as well (chi-squared {rival.chi2:.3g} against {point.fit.chi2:.3g}): {there}"
            out.append(Finding(code="ambiguous", text=text, value=rival.chi2 - point.fit.chi2))
        for channel, solutions in point.coarse.items():
            if not any(s.physical for s in solutions):
                why = "fewer than four poses, or poses in one plane" if not solutions else "no root has positive lengths"
                out.append(
                    Finding(
                        code="coarse",
                        channel=channel,
                        text=f"channel {channel}: no coarse solution ({why}); the nominal rig alone started the search",
                    )
                )
    for name, boxes in searched.items():
        values = dict(zip(unknowns.names, found.theta[: len(unknowns.names)], strict=True))
        p = campaign.rig.point(name)
        where = np.array(
            [values.get(f"{name}.{k}", v) for k, v in zip(PLACE, p.position_mm, strict=True)]
            + [math.radians(values.get(f"{name}.{k}", getattr(p, k))) for k in GUIDE]
        )
        if not any(box.holds(where.copy()) for box in boxes):
            text = f"{name}: the result lies at the edge of the neighbourhood searched, or beyond; widen it (--neighbourhood-mm, -deg)"
            out.append(Finding(code="edge", text=text))
        u_alpha = _u_of(f"{name}.{GUIDE[0]}", found)
        if math.cos(where[3]) < math.radians(u_alpha):
            text = (
                f"{name}: its guide is vertical within its uncertainty of {u_alpha:.2g} deg: beta says little, and covariances by alpha "
                "and beta leave out part of its direction's; a base frame in which no guide is vertical tells all of it"
            )
            out.append(Finding(code="vertical", text=text, value=u_alpha))
    if not found.converged:
        out.append(Finding(code="not_converged", text="the least squares did not settle; the result is where they stopped"))
    return out
