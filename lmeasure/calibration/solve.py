"""From a campaign to calibrated observation points: coarse solve, LP-search, descent, least squares, and an honest record."""

import math
from collections.abc import Callable
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure.calibration import diagnosis, observability
from lmeasure.calibration.campaign import Campaign, all_visits, without_poses
from lmeasure.calibration.coarse import CoarseSolution, coarse_solutions
from lmeasure.calibration.joint import Frame, free_components, solve_jointly
from lmeasure.calibration.lp_search import Box, point_data, search_point
from lmeasure.calibration.misfit import explain_misfit
from lmeasure.calibration.prediction import Prediction, predict
from lmeasure.calibration.ranges import position_range
from lmeasure.calibration.recording import held_out_entry, make_joint_record, make_record, predicted_entry
from lmeasure.calibration.refine import Fit, Noise, fit
from lmeasure.calibration.regions import BENT, regions
from lmeasure.calibration.robust import robust_fit
from lmeasure.calibration.unknowns import Model, Unknowns, rig_with, unknowns_of
from lmeasure.calibration.validation import held_out
from lmeasure.calibration_record import CalibrationRecord, Finding, Unobservable
from lmeasure.errors import CalibrationError
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int], None]

STARTS = 6  # distinct LP candidates that are polished per point
APART = 10.0  # standard uncertainties between two results that are not one


@dataclass(frozen=True)
class Settings:
    """Options of a calibration; see the contract's `lmeasure calibrate`."""

    solve: tuple[str, ...] = ("position", "guide")
    neighbourhood_mm: float = 100.0
    neighbourhood_deg: float = 15.0
    prior: bool = False
    seed: int = 0
    robust: bool = False
    hold_out: tuple[str, ...] = ()
    """Poses that take no part in the fit and judge it."""
    self_calibration: bool = False
    """Poses are estimated with the points, and not trusted; see `calibration.joint`."""
    frame: Frame = "rig"
    """What holds the frame of a self-calibration: the nominal rig or the reference poses."""


@dataclass(frozen=True)
class Calibration:
    """The calibrated rig, its record, the campaign it came from, and how well it predicts over the reference poses' workspace."""

    rig: Rig
    record: CalibrationRecord
    campaign: Campaign
    predicted: Prediction


@dataclass(frozen=True)
class _Point:
    name: str
    coarse: dict[str, list[CoarseSolution]]
    boxes: list[Box]
    fit: Fit
    model: Model
    rivals: list[Fit]


def calibrate(campaign: Campaign, settings: Settings | None = None, progress: Progress | None = None) -> Calibration:
    """Calibrate the observation points of a campaign.

    Residuals that the model cannot explain, and directions the data cannot tell, are written into the record's warnings and unobservable;
    the result is never a bare optimum. CalibrationError when there is nothing to solve.
    """
    settings = settings or Settings()
    free = free_components(campaign, trusted=not settings.self_calibration)
    if free:
        return _calibrate_jointly(campaign, settings, free, progress)
    kept_out = all_visits(campaign, settings.hold_out)
    whole, campaign = campaign, without_poses(campaign, kept_out)
    unknowns = unknowns_of(campaign, settings.solve)
    noise = Noise.of(campaign.poses)
    names = list(dict.fromkeys(c.from_point for c in campaign.cables))
    points: list[_Point] = []
    findings = [Finding(code="note", text=n) for n in campaign.notes]
    for i, name in enumerate(names):
        if progress:
            progress(i, len(names) + 2)
        points.append(_solve_point(campaign, name, settings, noise))
    if progress:
        progress(len(names), len(names) + 2)
    everywhere = replace(settings, prior=True)
    stated = {p.name: fit(p.model, p.fit.theta, noise, prior_everywhere=True) for p in points}
    gross = diagnosis.diagnose(campaign, stated, lambda other, name: _solve_point(other, name, everywhere, noise).fit)
    if progress:
        progress(len(names) + 1, len(names) + 2)
    start = unknowns.nominal.copy()
    for point in points:
        for value, name in zip(point.fit.theta, point.model.unknowns.names, strict=True):
            start[unknowns.names.index(name)] = value
    model = Model(campaign, unknowns)
    blamed = [w.channel or w.code for w in gross]
    first = fit(model, start, noise, settings.prior)
    joint, final_noise, misfits = explain_misfit(model, first, noise, settings.prior, blamed)
    weights = None
    if settings.robust:
        # who contradicts the others is told as without a robust loss; how large the noise is, by the poses that it leaves
        joint, robust_noise, weights = robust_fit(model, first, noise)
        joint, final_noise, remaining = explain_misfit(model, joint, robust_noise, settings.prior, blamed)
        misfits = [w for w in misfits if w.code != "misfit"] + [w for w in remaining if w.code == "misfit"]
        misfits += weights.findings(campaign.poses.names)
    noise = final_noise
    findings += [*gross, *misfits, *_shape_findings(campaign, unknowns, joint, points)]
    estimated = any(w.code == "misfit" for w in misfits)
    where = regions(model, joint, settings.seed, joint.freedom if estimated else None)
    if where.bend > BENT and joint.rank == len(unknowns.names):
        text = (
            f"the values lie on a bent valley ({where.bend:.2g} standard uncertainties off its tangent): their covariance and U95 include "
            "that; lengths are told better than the values suggest"
        )
        findings.append(Finding(code="nonlinear", text=text, value=where.bend))
    rig = rig_with(campaign, unknowns, joint.theta, "calibration.json")
    sight = observability.lines_of_sight(rig, campaign.cables, campaign.poses)
    silent = observability.unobservable_directions(unknowns, joint.directions[~joint.known], sight)
    record = make_record(campaign, model, joint, where, noise, findings, silent)
    ranges = [position_range(p.model, p.name, p.fit.theta, settings.seed) for p in points if p.name in _with_assumed(campaign)]
    predicted = predict(campaign, rig, record, settings.seed)
    undetermined = _underdetermined(campaign, model, silent, predict(campaign, rig, _prior_part(record, joint, unknowns), settings.seed))
    record = record.model_copy(
        update={
            "warnings": (*record.warnings, *undetermined),
            "coarse": tuple(
                _coarse_entry(p.name, channel, i, s) for p in points for channel, both in p.coarse.items() for i, s in enumerate(both)
            ),
            "ranges": tuple(
                {"point": r.point, "low_mm": r.low.tolist(), "high_mm": r.high.tolist(), "fitting": r.fitting, "tried": r.tried}
                for r in ranges
                if r is not None
            ),
            "predicted": predicted_entry(campaign, predicted),
            "validation": record.validation | held_out_entry(held_out(Model(whole, unknowns), joint, noise, kept_out)),
            "robust": {} if weights is None else weights.entry(campaign.poses.names),
            "settings": asdict(settings) | {"solve": list(settings.solve), "hold_out": list(settings.hold_out)},
        }
    )
    if progress:
        progress(len(names) + 2, len(names) + 2)
    return Calibration(rig, record, campaign, predicted)


def _calibrate_jointly(campaign: Campaign, settings: Settings, free: tuple[int, ...], progress: Progress | None) -> Calibration:
    """Rig and poses together; the campaign of the result has the poses found. CalibrationError for options that need whole poses."""
    for given, option in ((settings.robust, "--robust"), (settings.hold_out, "--hold-out")):
        if given:
            raise CalibrationError(f"{option}: judges by whole reference poses, and here their unknowns are estimated with the rig")
    if progress:
        progress(0, 2)
    found = solve_jointly(campaign, settings.solve, settings.prior, free, settings.frame, settings.seed)
    if progress:
        progress(1, 2)
    unknowns, theta = found.model.rig, found.theta[: found.own]
    rig = rig_with(campaign, unknowns, theta, "calibration.json")
    sight = observability.lines_of_sight(rig, campaign.cables, found.campaign.poses)
    silent = observability.unobservable_directions(unknowns, found.silent, sight)
    findings = [*(Finding(code="note", text=n) for n in campaign.notes), *found.findings]
    record = make_joint_record(found, findings, silent)
    predicted = predict(found.campaign, rig, record, settings.seed)
    more = {"predicted": predicted_entry(found.campaign, predicted), "settings": asdict(settings) | {"solve": list(settings.solve)}}
    if progress:
        progress(2, 2)
    return Calibration(rig, record.model_copy(update=more), found.campaign, predicted)


def _prior_part(record: CalibrationRecord, found: Fit, unknowns: Unknowns) -> CalibrationRecord:
    """The record with that part of the covariance which only the priors hold."""
    silent = found.directions[~found.known] * unknowns.width
    return record.model_copy(update={"tangent_covariance": tuple(tuple(float(x) for x in row) for row in silent.T @ silent)})


def _underdetermined(campaign: Campaign, model: Model, silent: list[Unobservable], by_prior: Prediction) -> list[Finding]:
    """Which points the counts do not determine, and how much of that reaches the lengths."""
    out = []
    for owner in dict.fromkeys(u.point for u in silent):
        own = [u for u in silent if u.point == owner]
        cables = [j for j, c in enumerate(campaign.cables) if owner in (c.from_point, f"tool.{c.to_point}")]
        equations = int(np.isin(model.cable_index, cables).sum())
        share = float(np.sqrt(np.mean(by_prior.length_mm[:, cables] ** 2)))
        text = (
            f"{owner}: {equations} equations leave {len(own)} of {len(model.unknowns.of(owner))} unknowns undetermined; there the nominal "
            f"rig's priors decide ({share:.4f} mm rms of the predicted lengths)"
        )
        out.append(Finding(code="underdetermined", text=text, value=float(len(own))))
    return out


def _with_assumed(campaign: Campaign) -> set[str]:
    return {name.split(".")[0] for name in campaign.rig.assumed}


def _coarse_entry(point: str, channel: str, place: int, s: CoarseSolution) -> dict[str, Any]:
    return {
        "point": point,
        "channel": channel,
        "position_mm": s.position.tolist(),
        "first_length_mm": s.first_length,
        "rms_mm": s.rms,
        "physical": s.physical,
        "chosen": place == 0 and s.physical,
    }


def _of_point(campaign: Campaign, name: str) -> Campaign:
    keep = [j for j, c in enumerate(campaign.cables) if c.from_point == name]
    return replace(
        campaign,
        cables=tuple(campaign.cables[j] for j in keep),
        counts=np.ascontiguousarray(campaign.counts[:, keep]),
        zero=campaign.zero[keep],
    )


def _solve_point(campaign: Campaign, name: str, settings: Settings, noise: Noise) -> _Point:
    """Coarse solutions, search boxes and the best of several polished starts for one observation point."""
    own = _of_point(campaign, name)
    unknowns = unknowns_of(own, settings.solve)
    model = Model(own, unknowns)
    nominal = campaign.rig.point(name)
    guide = np.radians([nominal.guide_alpha_deg, nominal.guide_beta_deg])
    coarse = {}
    for j, c in enumerate(own.cables):
        rows = np.flatnonzero(np.isfinite(own.counts[:, j]))
        # thesis 5.6: straight cables, dl = k * 0.012 mm; the drum's own part is as small as the wrap that is left out
        change = own.counts[rows, j] * nominal.drum.count_length_mm
        zero = int(np.flatnonzero(rows == own.zero[j])[0])
        points = own.poses.points(own.rig.tool[c.to_point])[rows]
        coarse[c.channel] = coarse_solutions(points, change, zero, np.array(nominal.position_mm))
    half = np.array([settings.neighbourhood_mm] * 3 + [math.radians(settings.neighbourhood_deg)] * 2)
    # nobody measured an assumed angle: all of its range is searched
    for key, i, whole in (("guide_alpha_deg", 3, math.pi / 2), ("guide_beta_deg", 4, math.pi)):
        if f"{name}.{key}" in campaign.rig.assumed:
            half[i] = whole
    boxes = [Box(np.array([*nominal.position_mm, *guide]), half)]
    boxes += [Box(np.array([*s.position, *guide]), half) for solutions in coarse.values() for s in solutions[:1] if s.physical]
    starts = [unknowns.nominal]
    free = [f"{name}.{key}" for key in ("x_mm", "y_mm", "z_mm", "guide_alpha_deg", "guide_beta_deg")]
    for candidate in search_point(point_data(campaign, name), boxes, settings.seed):
        start = unknowns.nominal.copy()
        values = [*candidate[:3], *np.degrees(candidate[3:])]
        for key, value in zip(free, values, strict=True):
            if key in unknowns.names:
                start[unknowns.names.index(key)] = value
        starts.append(start)
    best, *others = sorted(
        (fit(model, start, noise, settings.prior) for start in _distinct(starts, unknowns.width)), key=lambda f: f.objective
    )
    rivals = [f for f in others if f.objective < best.objective + diagnosis.EVIDENCE and _apart(best, f, unknowns.width) > APART]
    if best.rank < len(unknowns.names):
        rivals = []  # the priors decide there, which is said
    return _Point(name, coarse, boxes, best, model, rivals)


def _apart(a: Fit, b: Fit, width: FloatArray) -> float:
    """Distance of two results in the directions that the data determine at either, in standard uncertainties there: the smaller one."""
    d = (a.theta - b.theta) / width
    return min(float(np.linalg.norm((f.s * (f.directions @ d))[f.known])) for f in (a, b))


def _distinct(starts: list[FloatArray], width: FloatArray) -> list[FloatArray]:
    """The first STARTS starts that differ by more than a hundredth of a prior width in some value."""
    out: list[FloatArray] = []
    for start in starts:
        if all(np.abs((start - other) / width).max() > 1e-2 for other in out):
            out.append(start)
    return out[: STARTS + 1]


def _shape_findings(campaign: Campaign, unknowns: Unknowns, found: Fit, points: list[_Point]) -> list[Finding]:
    """Results at the edge of the search, missing coarse solutions, and a fit that did not settle."""
    out = []
    for point in points:
        for rival in point.rivals[:1]:
            there = ", ".join(f"{n.split('.', 1)[1]} {v:.6g}" for n, v in zip(point.model.unknowns.names, rival.theta, strict=True))
            text = f"{point.name}: another result fits as well (chi-squared {rival.chi2:.3g} against {point.fit.chi2:.3g}): {there}"
            out.append(Finding(code="ambiguous", text=text, value=rival.chi2 - point.fit.chi2))
        rig_point = campaign.rig.point(point.name)
        values = dict(zip(unknowns.names, found.theta, strict=True))
        where = np.array(
            [values.get(f"{point.name}.{k}", v) for k, v in zip(("x_mm", "y_mm", "z_mm"), rig_point.position_mm, strict=True)]
            + [
                math.radians(values.get(f"{point.name}.guide_alpha_deg", rig_point.guide_alpha_deg)),
                math.radians(values.get(f"{point.name}.guide_beta_deg", rig_point.guide_beta_deg)),
            ]
        )
        if not any(box.holds(where.copy()) for box in point.boxes):
            text = (
                f"{point.name}: the result lies at the edge of the neighbourhood searched, or beyond; widen it (--neighbourhood-mm, -deg)"
            )
            out.append(Finding(code="edge", text=text))
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
    if not found.converged:
        out.append(Finding(code="not_converged", text="the least squares did not settle; the result is where they stopped"))
    return out
