"""Findings of a calibration beside its values, in words: undetermined directions, and oddities about the result."""

import math

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.dimensions import Dimensions
from lmeasure.calibration.solve.lp_search import Box
from lmeasure.calibration.solve.points import Point
from lmeasure.calibration.solve.prediction import Prediction
from lmeasure.calibration.solve.sizes import Sized
from lmeasure.calibration.solve.unknowns import Model, factor_of
from lmeasure.core import FloatArray
from lmeasure.estimation import Fit, Parameters
from lmeasure.rig import GUIDE, PLACE, STEEL_PER_K, TYPICAL_SIZES, Finding, Unobservable
from lmeasure.sensors import BACKLASH, Variable, effects_of, free_lengths
from lmeasure.text import message

ALIKE_K = 0.5
"""Temperatures that are not distinguished [K]."""
BY_CHANCE = 1e-3
"""Probability below which the errors of all parts of one kind are not typical. Their estimates are nearer to zero than they are."""
LARGER = 3.0
"""Typical sizes from which an error of a part is named: less than one of a hundred sound parts is so large by chance."""


def underdetermined(campaign: Campaign, model: Model, silent: list[Unobservable], by_prior: Prediction) -> list[Finding]:
    """Report the points that the counts do not determine, and the effect on the lengths."""
    out = []
    for owner in dict.fromkeys(u.point for u in silent):
        own = [u for u in silent if u.point == owner]
        seen = [j for j, c in enumerate(campaign.cables) if owner in (c.from_point, f"tool.{c.to_point}", c.channel)]
        equations = int(np.isin(model.cable_index, seen).sum())
        cables = [j for j in seen if j < len(campaign.drums)]
        share = float(np.sqrt(np.mean(by_prior.length_mm[:, cables] ** 2))) if cables else 0.0
        text = message(
            "calibration.equations_leave_unknowns_undetermined",
            owner=owner,
            equations=equations,
            left=len(own),
            of=len(model.parameters.of(owner)),
            mm=share,
        )
        out.append(Finding(code="underdetermined", text=text, value=float(len(own))))
    return out


def unknown_temperature(campaign: Campaign) -> list[Finding]:
    """Report a rig with thermal expansion and counts without a temperature, or the opposite."""
    effects, m = effects_of(campaign.rig, campaign.drums), len(campaign.drums)
    expands = effects is not None and effects.thermal
    if campaign.temperature_c is not None and not expands:
        return _unstated_expansion(campaign, campaign.temperature_c[:, :m][np.isfinite(campaign.counts[:, :m])])
    if effects is None or not expands or campaign.temperature_c is not None:
        return []
    text = message("calibration.rig_states_expansions_no", c=effects.reference_c)
    return [Finding(code="temperature", text=text)]


def _unstated_expansion(campaign: Campaign, warm: FloatArray) -> list[Finding]:
    """Report the growth of steel cables at temperatures warm (k,) [deg C] of the counts: of the length paid out from their mean, and of all
    that is free of the drum since zeroing."""
    mean, low, high = float(warm.mean()), float(warm.min()), float(warm.max())
    off = max(mean - low, high - mean)
    if off < ALIKE_K:
        return []
    rows, poses = campaign.rig.cable_rows(campaign.drums), campaign.poses.rows
    free = free_lengths(rows, poses[campaign.zero[: len(rows)]])
    paid = np.array([np.abs(free_lengths(rows, np.repeat(pose[None], len(rows), axis=0)) - free) for pose in poses])
    mm = STEEL_PER_K * float(np.max(off * paid + (high - low) * free))
    return [Finding(code="temperature", text=message("expansion.campaign", kelvin=off, at_deg_c=mean, mm=mm), value=mm)]


def larger_errors(sized: Sized | None, dimensions: Dimensions) -> list[Finding]:
    """Return the kinds of parts whose errors are much larger than their stated or typical sizes, with the worst part of each."""
    if sized is None:
        return []
    out, sizes = [], [(_least_size(v, sized, dimensions), v) for v in sized.model.variables if v.kind != BACKLASH]
    for kind in dict.fromkeys(v.kind for _, v in sizes):
        size, v = max((pair for pair in sizes if pair[1].kind is kind), key=lambda pair: pair[0])
        whole = _group_size([v for _, v in sizes if v.kind is kind and kind.adds is not None], dimensions)
        values = {"what": kind.said, "part": v.owner, "key": kind.key, "size": TYPICAL_SIZES[kind.key].size if v.assumed else ""}
        of, code = ("", "larger") if v.assumed else ("_stated", "misfit")
        if size > LARGER:
            out.append(Finding(code=code, text=message(f"calibration.larger{of}", times=size, **values), value=size))
        elif whole:
            out.append(Finding(code=code, text=message(f"calibration.larger_all{of}", times=whole, **values), value=whole))
    return out


def _group_size(parts: list[Variable], dimensions: Dimensions) -> float:
    """Return the root mean square of the errors of parts of one kind in units of their sizes; 0 where chance explains it, or their own
    uncertainty."""
    at, u = [dimensions.names.index(name) for v in parts for name in v.names], np.array([v.u for v in parts for _ in v.names])
    z = dimensions.correction[at] / u
    size = float(np.linalg.norm(z))
    along = z / u / size if size else z
    least = max(size - 2.0 * math.sqrt(along @ dimensions.covariance[np.ix_(at, at)] @ along), 0.0)
    return size / math.sqrt(len(z)) if len(z) and scipy.stats.chi2.sf(least**2, len(z)) < BY_CHANCE else 0.0


def _least_size(v: Variable, sized: Sized, dimensions: Dimensions) -> float:
    """Return how large the error of a part is at least (with 95 %), in units of its typical or stated size."""
    if v.kind.adds is None:
        return factor_of(v, {v.kind.code: sized.play.get(v.owner, 0.0)})
    at = [dimensions.names.index(name) for name in v.names]
    return float(np.max(np.abs(dimensions.correction[at]) - 2.0 * np.sqrt(np.diag(dimensions.covariance)[at]))) / v.u


def poses_findings(model: Model, found: Fit) -> list[Finding]:
    """Report the unknown components of the poses, and the choice of the frame."""
    if not model.pose_unknowns:
        return []
    n, d = len(model.at), model.pose_unknowns
    determined = message("calibration.equations_values_rig_each", equations=model.equations, own=model.own, d=d, n=n)
    if model.frame is None:
        return [
            Finding(
                code="note",
                text=message("calibration.reference_poses_have_no", determined=determined, begins=message("calibration.begins")),
            )
        ]
    held = message("calibration.frame.nominal_rig" if model.frame == "rig" else "calibration.frame.poses")
    code = "calibration.frame.priors" if found.prior_everywhere else "calibration.frame.motions"
    text = message(code, determined=determined, n=found.motions, held=held, begins=message("calibration.begins"))
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
            text = message("calibration.another_result_fits_well", name=point.name, rival=rival.chi2, own=point.fit.chi2, there=there)
            out.append(Finding(code="ambiguous", text=text, value=rival.chi2 - point.fit.chi2))
        for channel, solutions in point.coarse.items():
            if not any(s.physical for s in solutions):
                why = message("calibration.coarse.no_root" if solutions else "calibration.coarse.few")
                out.append(
                    Finding(
                        code="coarse", channel=channel, text=message("calibration.channel_no_coarse_solution", channel=channel, why=why)
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
            text = message("calibration.result_lies_edge_neighbourhood", name=name)
            out.append(Finding(code="edge", text=text))
        u_alpha = _u_of(f"{name}.{GUIDE[0]}", found)
        if math.cos(where[3]) < math.radians(u_alpha):
            text = message("calibration.vertical", name=name, u=u_alpha)
            out.append(Finding(code="vertical", text=text, value=u_alpha))
    if not found.converged:
        out.append(Finding(code="not_converged", text=message("calibration.not_converged")))
    return out
