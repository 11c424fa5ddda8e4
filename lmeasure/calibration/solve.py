"""From a campaign to calibrated observation points: coarse solve, LP-search, descent, least squares, and an honest record."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.optimize
import scipy.stats
from numpy.typing import NDArray

from lmeasure.calibration import diagnosis, observability
from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration.coarse import CoarseSolution, coarse_solutions
from lmeasure.calibration.lp_search import Box, point_data, search_point
from lmeasure.calibration.ranges import position_range
from lmeasure.calibration.refine import Fit, Noise, fit
from lmeasure.calibration.unknowns import Model, Unknowns, rig_with, unknowns_of
from lmeasure.calibration_record import CalibrationRecord, Finding, Parameter, Residual
from lmeasure.rig import Rig

FloatArray = NDArray[np.float64]
Progress = Callable[[int, int], None]

STARTS = 6  # distinct LP candidates that are polished per point
CHANCE = 1e-3


@dataclass(frozen=True)
class Settings:
    """Options of a calibration; see the contract's `lmeasure calibrate`."""

    solve: tuple[str, ...] = ("position", "guide")
    neighbourhood_mm: float = 100.0
    neighbourhood_deg: float = 15.0
    prior: bool = False
    seed: int = 0


@dataclass(frozen=True)
class Calibration:
    """The calibrated rig, its record, and the reference poses' campaign it came from."""

    rig: Rig
    record: CalibrationRecord
    campaign: Campaign


@dataclass(frozen=True)
class _Point:
    name: str
    coarse: dict[str, list[CoarseSolution]]
    boxes: list[Box]
    fit: Fit
    model: Model


def calibrate(campaign: Campaign, settings: Settings | None = None, progress: Progress | None = None) -> Calibration:
    """Calibrate the observation points of a campaign.

    Residuals that the model cannot explain, and directions the data cannot tell, are written into the record's warnings and unobservable;
    the result is never a bare optimum. CalibrationError when there is nothing to solve.
    """
    settings = settings or Settings()
    unknowns = unknowns_of(campaign, settings.solve)
    noise = Noise(campaign.poses.u_position_mm, campaign.poses.u_rotation_rad)
    names = list(dict.fromkeys(c.from_point for c in campaign.cables))
    points: list[_Point] = []
    findings = [Finding(code="note", text=n) for n in campaign.notes]
    suspects: dict[int, diagnosis.Suspicion] = {}
    for i, name in enumerate(names):
        if progress:
            progress(i, len(names) + 1)
        point = _solve_point(campaign, name, settings, noise)
        points.append(point)
        suspects |= _suspect_channels(campaign, point, settings, noise)
    if progress:
        progress(len(names), len(names) + 1)
    start = unknowns.nominal.copy()
    for point in points:
        for value, name in zip(point.fit.theta, point.model.unknowns.names, strict=True):
            start[unknowns.names.index(name)] = value
    model = Model(campaign, unknowns)
    joint = fit(model, start, noise, settings.prior)
    findings += _suspicion_findings(campaign, suspects)
    joint, noise, more = _explain_misfit(model, joint, noise, settings, set(suspects))
    findings += more
    findings += _shape_findings(campaign, unknowns, joint, points)
    sight = _lines_of_sight(campaign, unknowns, joint)
    silent = observability.unobservable_directions(unknowns, joint, sight)
    for owner in dict.fromkeys(u.point for u in silent):
        own = [u for u in silent if u.point == owner]
        equations = int(np.sum([campaign.cables[j].from_point == owner for j in model.cable_index]))
        left = f"{len(own)} of {len(unknowns.of(owner))} unknowns"
        text = f"{owner}: {equations} equations leave {left} undetermined; there the nominal rig's priors decide"
        findings.append(Finding(code="underdetermined", text=text, value=float(len(own))))
    record = _record(campaign, unknowns, model, joint, noise, settings, points, findings, silent)
    if progress:
        progress(len(names) + 1, len(names) + 1)
    return Calibration(rig_with(campaign, unknowns, joint.theta, "calibration.json"), record, campaign)


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
    best: Fit | None = None
    for start in _distinct(starts, unknowns.width):
        found = fit(model, start, noise, settings.prior)
        if best is None or found.objective < best.objective - 1e-6:
            best = found
    assert best is not None
    return _Point(name, coarse, boxes, best, model)


def _distinct(starts: list[FloatArray], width: FloatArray) -> list[FloatArray]:
    """The first STARTS starts that differ by more than a hundredth of a prior width in some value."""
    out: list[FloatArray] = []
    for start in starts:
        if all(np.abs((start - other) / width).max() > 1e-2 for other in out):
            out.append(start)
    return out[: STARTS + 1]


def _suspect_channels(campaign: Campaign, point: _Point, settings: Settings, noise: Noise) -> dict[int, diagnosis.Suspicion]:
    """Cables (by index) whose counts another scale or sign explains far better than the rig as stated."""
    stated = fit(point.model, point.fit.theta, noise, prior_everywhere=True)
    if not diagnosis.gross(stated):
        return {}
    out = {}
    for j, c in enumerate(campaign.cables):
        if c.from_point != point.name:
            continue
        best: diagnosis.Suspicion | None = None
        for scale in (*diagnosis.SCALES, -1.0, *(-s for s in diagnosis.SCALES)):
            other = _solve_point(diagnosis.with_scale(campaign, j, scale), point.name, replace(settings, prior=True), noise).fit
            gained = diagnosis.gain(stated, other)
            if gained > diagnosis.EVIDENCE and (best is None or gained > best.gain):
                best = diagnosis.Suspicion("scale" if scale > 0 else "sign", abs(scale) if scale > 0 else scale, gained)
        if best is not None:
            out[j] = best
    return out


def _suspicion_findings(campaign: Campaign, suspects: dict[int, diagnosis.Suspicion]) -> list[Finding]:
    out = []
    for j, s in suspects.items():
        channel = campaign.cables[j].channel
        if s.kind == "scale":
            text = f"channel {channel}: its counts fit when it is decoded at scale {s.value:g}, not at the rig's; nothing was repaired"
        else:
            text = (
                f"channel {channel}: its counts fit with the other sign"
                + (f" and scale {-s.value:g}" if s.value != -1 else "")
                + "; nothing was repaired"
            )
        out.append(Finding(code=s.kind, channel=channel, value=s.value, text=f"{text} (evidence {s.gain:.3g} in twice the log odds)"))
    return out


def _explain_misfit(model: Model, found: Fit, noise: Noise, settings: Settings, suspects: set[int]) -> tuple[Fit, Noise, list[Finding]]:
    """When the residuals exceed the stated noise: name a pose the others contradict, and estimate the reference poses' error."""
    freedom = len(found.residuals) - found.rank
    if freedom < 1 or scipy.stats.chi2.sf(found.chi2, freedom) > CHANCE:
        return found, noise, []
    findings = []
    rms = float(np.sqrt(np.mean(found.residuals**2)))
    clean = [c for j, c in enumerate(model.campaign.cables) if j not in suspects]
    if not clean or suspects:
        points = {model.campaign.cables[j].from_point for j in suspects}
        text = f"residuals of {rms:.3g} mm rms exceed the noise; look first at the channel named above ({', '.join(sorted(points))})"
        findings.append(Finding(code="misfit", text=text, value=rms))
    else:
        for test in diagnosis.outlier_poses(model, found)[:1]:
            if test.probability < CHANCE:
                odds = f"F = {test.statistic:.3g}, p = {test.probability:.2g}"
                text = f"pose {test.pose}: the other poses contradict it ({odds}); it was used all the same"
                findings.append(Finding(code="outlier", pose=test.pose, value=test.statistic, text=text))
        u = _pose_error(model, found, noise)
        noise = Noise(np.hypot(noise.u_position_mm, u), noise.u_rotation_rad)
        found = fit(model, found.theta, noise, settings.prior)
        u_more = _pose_error(model, found, noise) if scipy.stats.chi2.sf(found.chi2, max(freedom, 1)) < CHANCE else 0.0
        if u_more > 0:
            noise = Noise(np.hypot(noise.u_position_mm, u_more), noise.u_rotation_rad)
            found = fit(model, found.theta, noise, settings.prior)
        total = math.hypot(u, u_more)
        text = (
            f"residuals of {rms:.3g} mm rms exceed the stated noise; reference poses in error by {total:.3g} mm (1 sigma per axis) "
            "would explain them, and the uncertainties include that"
        )
        findings.append(Finding(code="misfit", text=text, value=total))
    freedom = len(found.residuals) - found.rank
    if freedom >= 1 and scipy.stats.chi2.sf(found.chi2, freedom) < CHANCE:
        # what nobody can explain widens the uncertainties by its own size
        found = replace(found, covariance=_inflated(found, freedom))
    return found, noise, findings


def _inflated(found: Fit, freedom: int) -> FloatArray:
    factor = found.chi2 / freedom
    return np.asarray(found.covariance * factor)


def _pose_error(model: Model, found: Fit, noise: Noise) -> float:
    """The extra standard uncertainty of the reference positions [mm] at which chi-squared equals its degrees of freedom (method of moments,
    with the model linearised at the fit)."""
    J = model.jacobian(found.theta) * model.unknowns.width @ found.directions[found.known].T
    by_pose = model.pose_jacobian(found.theta)[:, :, 3:].reshape(len(found.residuals), -1)
    extra = by_pose @ by_pose.T
    freedom = len(found.residuals) - found.rank

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


def _shape_findings(campaign: Campaign, unknowns: Unknowns, found: Fit, points: list[_Point]) -> list[Finding]:
    """Results at the edge of the search, missing coarse solutions, and a fit that did not settle."""
    out = []
    for point in points:
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


def _lines_of_sight(campaign: Campaign, unknowns: Unknowns, found: Fit) -> dict[str, FloatArray]:
    middle = campaign.poses.rows[:, :3].mean(axis=0)
    out = {}
    values = dict(zip(unknowns.names, found.theta, strict=True))
    for c in campaign.cables:
        at = campaign.rig.point(c.from_point).position_mm
        position = np.array([values.get(f"{c.from_point}.{k}", v) for k, v in zip(("x_mm", "y_mm", "z_mm"), at, strict=True)])
        way = middle - position
        out[c.from_point] = way / max(float(np.linalg.norm(way)), 1e-9)
    return out


def _record(
    campaign: Campaign,
    unknowns: Unknowns,
    model: Model,
    found: Fit,
    noise: Noise,
    settings: Settings,
    points: list[_Point],
    findings: list[Finding],
    silent: list[Any],
) -> CalibrationRecord:
    u = np.sqrt(np.diag(found.covariance))
    coarse = [
        {
            "point": p.name,
            "channel": channel,
            "position_mm": [float(x) for x in s.position],
            "first_length_mm": s.first_length,
            "rms_mm": s.rms,
            "physical": s.physical,
            "chosen": i == 0 and s.physical,
        }
        for p in points
        for channel, solutions in p.coarse.items()
        for i, s in enumerate(solutions)
    ]
    freedom = len(found.residuals) - found.rank
    assumed = {name.split(".")[0] for name in campaign.rig.assumed}
    ranges = [position_range(p.model, p.name, p.fit.theta, settings.seed) for p in points if p.name in assumed]
    return CalibrationRecord(
        rig=campaign.rig.name,
        parameters=tuple(
            Parameter(name=n, value=float(v), u=float(s), prior_u=float(w))
            for n, v, s, w in zip(unknowns.names, found.theta, u, unknowns.width, strict=True)
        ),
        covariance=tuple(tuple(float(x) for x in row) for row in found.covariance),
        residuals=tuple(
            Residual(pose=campaign.poses.names[i], channel=campaign.cables[j].channel, mm=-float(r))
            for i, j, r in zip(model.pose_index, model.cable_index, found.residuals, strict=True)
        ),
        equations=model.equations,
        unknowns=len(unknowns.names),
        rank=found.rank,
        unobservable=tuple(silent),
        warnings=tuple(findings),
        inputs=campaign.inputs,
        coarse=tuple(coarse),
        ranges=tuple(
            {"point": r.point, "low_mm": r.low.tolist(), "high_mm": r.high.tolist(), "fitting": r.fitting, "tried": r.tried}
            for r in ranges
            if r is not None
        ),
        noise={
            "chi_squared": found.chi2,
            "degrees_of_freedom": float(freedom),
            "residual_rms_mm": float(np.sqrt(np.mean(found.residuals**2))),
            "reference_u_position_mm": float(np.sqrt(np.mean(noise.u_position_mm**2))),
            "reference_u_rotation_deg": float(np.degrees(np.sqrt(np.mean(noise.u_rotation_rad**2)))),
        },
        settings={
            "solve": list(settings.solve),
            "neighbourhood_mm": settings.neighbourhood_mm,
            "neighbourhood_deg": settings.neighbourhood_deg,
            "prior": settings.prior,
            "seed": settings.seed,
        },
    )
