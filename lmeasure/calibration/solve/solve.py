"""From a campaign to calibrated observation points: coarse solve, LP-search, descent, least squares, and an honest record.

Quantities without a measurement give a result over their range. Reference poses that the others contradict get less weight by a robust loss
(`estimation.robust`).

The unit is the pose with all its visits: its lengths are wrong together if the robot was not at the stated pose. The zero pose shifts all
lengths of its cables and is judged like any other.

Every effect that was solved for has its size, the probability of chance, and the information gained. With d the departure of an effect's q
values from the rig's, and C their covariance, d' C^-1 d / q is as an F of q and the noise's degrees of freedom while there is none
(chi-squared over q where the noise is stated). An effect is found where its probability, times the number of those that were solved for
(Bonferroni), is under `CHANCE`. The information is log2 of the prior's volume over the remaining one, half of det(prior)/det(C): zero if a
law cannot be distinguished from other solved ones.
"""

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign, all_visits, with_counts_of, without_poses
from lmeasure.calibration.campaign.known_lengths import with_distances
from lmeasure.calibration.solve.dimensions import dimensions_of, with_dimensions
from lmeasure.calibration.solve.effect_candidates import CHANCE, named_effects
from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.joint_estimation import begun_jointly, fitted_pose, solve_jointly
from lmeasure.calibration.solve.lp_search import Box
from lmeasure.calibration.solve.points import CalibrationSettings, Point, box_of, coarse_entry, solve_point
from lmeasure.calibration.solve.prediction import Prediction, predict
from lmeasure.calibration.solve.record import held_out_entry, make_record, nominal_entry, predicted_entry
from lmeasure.calibration.solve.residuals import unknowns_of
from lmeasure.calibration.solve.sizes import with_play
from lmeasure.calibration.solve.unknown_poses import counted_poses, free_components
from lmeasure.calibration.solve.unknowns import Model, rig_with
from lmeasure.calibration.validation import observability
from lmeasure.calibration.validation.diagnosis import Diagnosis, diagnose
from lmeasure.calibration.validation.findings import larger_errors, poses_findings, shape_findings, underdetermined, unknown_temperature
from lmeasure.calibration.validation.guard import AgainstNominal, against_nominal
from lmeasure.calibration.validation.hold_out import ValidationPose, shifted_lengths, validation_errors
from lmeasure.calibration.validation.misfit import explain_misfit
from lmeasure.core import CalibrationError, DataFrame, FloatArray, Shown
from lmeasure.estimation import BENT, BIWEIGHT, EXCLUDED, Fit, Group, Regions, Weights, fit, linear_objective, regions, robust_fit
from lmeasure.rig import FURTHER, PLACE, TABLE, TILT, CalibrationRecord, Finding, Rig, SolvedEffect
from lmeasure.sensors import phased, stated
from lmeasure.text import message

LAWS = ("radius", "scale", "pitch", *dict.fromkeys(p.group for p in (*FURTHER, *TILT)))
"""Groups of parameters that are effects, not positions."""
_GROUP = {p.key: p.group for p in (*TABLE, *FURTHER, *TILT)}


def solved_effects(model: Model, found: Fit, *, estimated: bool) -> tuple[SolvedEffect, ...]:
    """Each effect of each observation point that was solved for; estimated: whether the noise was, from the residuals."""
    unknowns = model.parameters
    own: dict[tuple[str, str], list[int]] = {}
    for i, name in enumerate(unknowns.names):
        owner, _, key = name.rpartition(".")
        if not owner.startswith("tool.") and _GROUP.get(key) in LAWS:
            own.setdefault((owner, _GROUP[key]), []).append(i)
    out = []
    for (owner, group), which in own.items():
        d, C = found.theta[which] - unknowns.nominal[which], found.covariance[np.ix_(which, which)]
        u = np.sqrt(np.diag(C))
        square = float(d @ np.linalg.solve(C, d)) / len(d)
        law = scipy.stats.f(len(d), found.freedom) if estimated else scipy.stats.chi2(len(d), scale=1.0 / len(d))
        bits = float(np.sum(np.log2(unknowns.width[which]))) - 0.5 * float(np.linalg.slogdet(C)[1]) / math.log(2.0)
        size = float(np.linalg.norm(d))
        p = float(law.sf(square))
        along = d / size if size > 0.0 else np.full(len(d), len(d) ** -0.5)
        out.append(
            SolvedEffect(
                owner=owner,
                effect=group,
                value=size,
                u=float(np.sqrt(along @ C @ along)) if size > 0.0 else float(u.max()),
                unit=unknowns.names[which[0]].rpartition("_")[2] if group != "scale" else "",
                probability=p,
                bits=max(bits, 0.0),
                found=p * len(own) < CHANCE,
            )
        )
    return tuple(out)


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
        text = message("calibration.pose_other_poses_contradict", pose=name, weight=weight)
        out.append(Finding(code="down_weighted", pose=name, value=weight, text=text))
    return out


def weights_entry(campaign: Campaign, weights: Weights) -> dict[str, object]:
    """The record's account of the robust loss."""
    every = [{"pose": n, "weight": float(w)} for n, w in zip(campaign.poses.names, weights.weight, strict=True)]
    return {"loss": message("calibration.tukey"), "constant": BIWEIGHT, "scale": weights.scale, "weights": every}


SAMPLES_LOG2 = 6
FITS_MM = 0.05  # residual up to which an assumed set of values is held possible


@dataclass(frozen=True)
class Range:
    """Spread of a point's position over its assumed values: low, high (3,) [mm, base frame]; how many tried sets fit the counts."""

    point: str
    low: FloatArray
    high: FloatArray
    fitting: int
    tried: int


def position_range(model: Model, point: str, theta: FloatArray, seed: int) -> Range | None:
    """Position of a point, solved anew with its other values held at each of 64 Sobol sets within sqrt(3) prior widths of the nominal.

    theta (p,) is the result of the calibration: where to start, and the first of the sets. None when nothing but the position is
    unknown, or no set fits.
    """
    unknowns = model.parameters
    own = unknowns.of(point)
    place = [i for i in own if unknowns.names[i].rsplit(".", 1)[1] in PLACE]
    held = [i for i in own if i not in place]
    if not held or len(place) != 3:
        return None
    unit = scipy.stats.qmc.Sobol(len(held), scramble=True, rng=np.random.default_rng([seed, 7])).random_base2(SAMPLES_LOG2)
    found = [theta[place]] if np.abs(model.residuals(theta)).max() < FITS_MM else []
    for sample in unit:
        fixed = theta.copy()
        fixed[held] = unknowns.nominal[held] + np.sqrt(3.0) * (2 * sample - 1) * unknowns.width[held]

        def full(position: FloatArray, fixed: FloatArray = fixed) -> FloatArray:
            out = fixed.copy()
            out[place] = position
            return out

        solution = scipy.optimize.least_squares(
            lambda position, full=full: model.residuals(full(position)),
            theta[place],
            jac=lambda position, full=full: model.jacobian(full(position))[:, place],
            method="lm" if model.equations >= 3 else "trf",
            max_nfev=100,
        )
        if np.abs(solution.fun).max() < FITS_MM:
            found.append(solution.x)
    if not found:
        return None
    return Range(point, np.min(found, axis=0), np.max(found, axis=0), len(found), len(unit) + 1)


Progress = Callable[[int, int], None]

_WHO = ("outlier", "slip", "moved")  # findings that name a pose or a channel


@dataclass(frozen=True, repr=False)
class Calibration(Shown):
    """Result of a calibration: calibrated rig, record and predicted uncertainty.

    Examples
    --------
    >>> calibration.rig.name, len(calibration.record.parameters)
    ('simulated cell 1', 30)
    """

    rig: Rig
    """Calibrated rig."""
    record: CalibrationRecord
    """Parameters with their covariance, residuals and findings."""
    campaign: Campaign
    """Counts at reference poses, input of the fit."""
    predicted: Prediction
    """Predicted uncertainty over the workspace of the reference poses."""
    refused: str | None = None
    """Reason to reject the rig: its length predictions are significantly worse than the nominal rig's. None: usable."""

    def about(self) -> dict[str, str]:
        """Return a summary of its record, which marks a refused rig."""
        return self.record.about() | ({} if self.refused is None else {"refused": self.refused})

    def to_frame(self) -> DataFrame:
        """A row for each parameter."""
        return self.record.to_frame()


@dataclass(frozen=True)
class _SolverStart:
    """Start of the least squares of everything: the problem and its first fit, slips in the files, single points' solutions, and the boxes
    of expected results."""

    model: Model
    first: Fit
    diagnosis: Diagnosis
    points: list[Point]
    searched: dict[str, list[Box]]


def calibrate(campaign: Campaign, settings: CalibrationSettings | None = None, progress: Progress | None = None) -> Calibration:
    """Calibrate the observation points of a campaign.

    Residuals that the model cannot explain are in the record's warnings, undetermined directions in unobservable. A rig that predicts
    lengths at validation poses significantly worse than the nominal one is solved again with the nominal rig as a prior everywhere, and
    `refused` if that is no better. The campaign of the result contains the found poses. CalibrationError if there is nothing to solve.
    """
    settings = settings or CalibrationSettings()
    zeroed, names = campaign.poses.rows[campaign.zero[: len(campaign.drums)]], unknowns_of(campaign, settings.groups).names
    more = [] if settings.solve else [name for v in stated(campaign.rig, campaign.drums, names) for name in v.names]
    campaign = replace(campaign, rig=phased(campaign.rig, (*names, *more), zeroed, campaign.drums))
    result, compared = _calibrated(campaign, settings, progress)
    if result.refused is not None or compared is None or not compared.worse:
        return result
    if not settings.prior:
        again, then = _calibrated(campaign, replace(settings, prior=True), progress)
        if again.refused is None and then is not None and not then.worse:
            text = message("calibration.without_priors_nominal_rig", a=compared.text(), b=then.text())
            kept = Finding(code="kept_nominal", text=text, value=compared.rms_mm / compared.nominal_mm)
            return replace(again, record=again.record.model_copy(update={"warnings": (kept, *again.record.warnings)}))
    return replace(result, refused=compared.refusal())


def _calibrated(campaign: Campaign, settings: CalibrationSettings, progress: Progress | None) -> tuple[Calibration, AgainstNominal | None]:
    """Return `calibrate`'s result of any quality, and its comparison with the nominal rig."""
    free = free_components(campaign, trusted=not settings.self_calibration)
    # of poses that are unknown and were not counted nothing is found
    whole = counted_poses(campaign) if free else campaign
    kept_out = all_visits(whole, settings.hold_out)
    campaign = without_poses(whole, kept_out)
    steps = 3 if free else len({c.from_point for c in campaign.drums}) + 2
    begun = _begun_jointly(campaign, settings, free) if free else _begun(campaign, settings, progress, steps)
    campaign, wrong = begun.model.campaign, begun.diagnosis
    whole = with_counts_of(campaign, whole, kept_out)
    if progress:
        progress(steps - 1, steps)
    blamed = [w.channel or w.code for w in wrong.findings] if wrong.refused else []
    explained = explain_misfit(begun.model, begun.first, blamed)
    misfits, weights = explained.findings, None
    if settings.robust:
        # poses that contradict the others are named as without a robust loss; those that it keeps determine the noise
        sound, first = begun.model, begun.first
        for change in explained.model.campaign.breaks[len(sound.campaign.breaks) :]:
            sound = sound.with_break(change)
            first = fit(sound, first.theta, settings.prior, near=True)
        weighted, found, weights = robust_poses(sound, first)
        explained = explain_misfit(weighted, found, blamed)
        misfits = [w for w in misfits if w.code in _WHO] + [w for w in explained.findings if w.code not in _WHO]
        misfits += down_weighted(campaign, weights)
    model, found = explained.model, explained.fit
    sized = None if settings.distances else explained.averaged
    found, of_lengths = with_distances(model, found, settings.distances)
    misfits = [*misfits, *of_lengths]
    if settings.distances and explained.averaged is not None:
        misfits.append(Finding(code="note", text=message("calibration.most_probable_sizes")))
    where, mode = regions(found, settings.seed, found.freedom if explained.estimated else None), found
    if sized is not None:
        where, found = _widened(where, sized.spread[: model.own]), sized.mean(found)
    # dimensions that must not move keep their priors
    dimensions = dimensions_of(model, found, None, corrected=False) if settings.solve else dimensions_of(model, mode, sized)
    findings = [Finding(code="note", text=n) for n in campaign.notes]
    findings += [*poses_findings(model, found), *wrong.findings, *misfits]
    # with the stated noise, because estimated noise would hide the law of the residuals
    named, shown = (
        ([], ())
        if blamed
        else named_effects(*(begun.model, begun.first) if explained.sized is None else (explained.sized.model, explained.sized.fit))
    )
    findings += named
    findings += shape_findings(campaign, model.parameters, found, begun.points, searched=begun.searched)
    if where.bend > BENT and not len(found.silent):
        text = message("calibration.values_lie_bent_valley", bend=where.bend)
        findings.append(Finding(code="nonlinear", text=text, value=where.bend))
    compared = against_nominal(model, found, begun.first)
    judged = _held_out(whole, model, found, kept_out, settings.seed)
    campaign = replace(campaign, poses=model.found_poses(found.theta, found.covariance), breaks=model.campaign.breaks)
    u = np.sqrt(np.maximum(np.diag(found.covariance)[: model.own], 0.0))
    rig = with_play(
        rig_with(campaign, model.parameters, found.theta[: model.own], "calibration.json", u=u),
        model.variables,
        {} if explained.sized is None else explained.sized.play,
    )
    rig = with_dimensions(rig, dimensions)
    sight = observability.lines_of_sight(rig, campaign.cables, campaign.poses)
    silent = observability.unobservable_directions(model.parameters, found.silent, sight)
    record = make_record(campaign, model, found, where, findings=findings, silent=silent, rig=rig, dimensions=dimensions)
    assumed = {name.split(".")[0] for name in campaign.rig.assumed}
    ranges = [position_range(p.model, p.name, p.fit.theta, settings.seed) for p in begun.points if p.name in assumed]
    predicted = predict(campaign, rig, record, settings.seed)
    held = record.model_copy(update={"tangent_covariance": tuple(map(tuple, found.held_covariance.tolist()))})
    open_directions = underdetermined(campaign, model, silent, predict(campaign, rig, held, settings.seed, solved=True))
    record = record.model_copy(
        update={
            "warnings": (*record.warnings, *larger_errors(sized, dimensions), *open_directions, *unknown_temperature(campaign)),
            "sizes": () if explained.sized is None else explained.sized.rows,
            "effects": solved_effects(model, found, estimated=explained.estimated),
            "effects_shown": shown,
            "coarse": tuple(
                coarse_entry(p.name, channel, i, s) for p in begun.points for channel, both in p.coarse.items() for i, s in enumerate(both)
            ),
            "ranges": tuple(
                {"point": r.point, "low_mm": r.low.tolist(), "high_mm": r.high.tolist(), "fitting": r.fitting, "tried": r.tried}
                for r in ranges
                if r is not None
            ),
            "predicted": predicted_entry(campaign, predicted),
            "validation": record.validation | held_out_entry(judged) | nominal_entry(compared),
            "u_length_mm": {c.name: float(u) for c, u in zip(campaign.drums, explained.u_length_mm, strict=False) if u > 0.0},
            "robust": {} if weights is None else weights_entry(campaign, weights),
            "settings": asdict(settings)
            | {"solve": list(settings.solve), "hold_out": list(settings.hold_out), "distances": [d._asdict() for d in settings.distances]},
        }
    )
    if progress:
        progress(steps, steps)
    refused = wrong.refused
    if refused is None and compared is None and wrong.doubtful and not free:
        refused = message("calibration.contradict_too_few")
    return Calibration(rig, record, campaign, predicted, refused), compared


def _widened(where: Regions, spread: FloatArray) -> Regions:
    """The regions with further independent errors, columns (p, k)."""
    covariance = where.covariance + spread @ spread.T
    wider = np.sqrt(np.diag(covariance) / np.maximum(np.diag(where.covariance), 1e-300))
    return replace(where, covariance=covariance, U95=where.U95 * wider)


def _begun(campaign: Campaign, settings: CalibrationSettings, progress: Progress | None, steps: int) -> _SolverStart:
    """Each point alone first, at the reference poses: coarse solutions, LP-search, descent. Again where the files were corrected."""
    begun = _from_points(campaign, settings, progress, steps)

    def judge(other: Campaign) -> Fit | None:
        model = model_of(other, unknowns_of(other, settings.groups))
        start = model.start
        # start the search from nominal values that were not measured
        for name in dict.fromkeys(n.split(".")[0] for n in other.rig.assumed):
            if any(c.from_point == name for c in other.drums):
                start = _started(model, start, [solve_point(other, name, replace(settings, prior=True), roughly=True)])
        # the nominal rig may be in another valley than the solutions of single points, and these may follow errors
        fits = []
        for each in (start, begun.first.theta):
            # a reading that no rig can have runs off to where no cable runs: then it is no hypothesis
            with suppress(ValueError):
                fits.append(fit(model, model.zeros_begun(each), prior_everywhere=True, roughly=True))
        return min(fits, key=lambda f: f.objective, default=None)

    def screen(other: Campaign) -> float:
        return linear_objective(model_of(other, unknowns_of(other, settings.groups)))

    stated = judge(campaign) or fit(begun.model, begun.first.theta, prior_everywhere=True)
    found = diagnose(campaign, judge, screen, stated, poses_known=True, places_known=True, aside=not settings.robust)
    if found.campaign is not campaign:
        begun = _from_points(found.campaign, settings, progress, steps)
    return replace(begun, diagnosis=found)


def _from_points(campaign: Campaign, settings: CalibrationSettings, progress: Progress | None, steps: int) -> _SolverStart:
    """The fit of a campaign as it is, from the solutions of its single points."""
    model = model_of(campaign, unknowns_of(campaign, settings.groups))
    points: list[Point] = []
    for i, name in enumerate(dict.fromkeys(c.from_point for c in campaign.drums)):
        if progress:
            progress(i, steps)
        points.append(solve_point(campaign, name, settings))
    if progress:
        progress(len(points), steps)
    start = model.zeros_begun(_started(model, model.start, points))
    return _SolverStart(model, fit(model, start, settings.prior), Diagnosis(campaign), points, {p.name: p.boxes for p in points})


def _started(model: Model, start: FloatArray, points: list[Point]) -> FloatArray:
    """A start (P,) with the values of solved points."""
    known = {name: value for point in points for name, value in zip(point.model.names, point.fit.theta, strict=True)}
    return np.array([known.get(name, value) for name, value in zip(model.names, start, strict=True)])


def _begun_jointly(campaign: Campaign, settings: CalibrationSettings, free: tuple[int, ...]) -> _SolverStart:
    """All points at once from the nominal rig: no point can be solved alone where poses are unknown."""

    def solved(campaign: Campaign) -> tuple[Model, Fit]:
        return solve_jointly(campaign, settings.groups, settings.prior, free, frame=settings.frame, seed=settings.seed)

    model, first = solved(campaign)

    def judge(other: Campaign) -> Fit:
        own = unknowns_of(other, settings.groups)
        return begun_jointly(replace(other, poses=campaign.poses), own, free, settings.frame, seed=settings.seed)[1]

    def screen(other: Campaign) -> float:
        return linear_objective(model_of(other, unknowns_of(other, settings.groups), free, model.frame))

    stated = fit(model, first.theta, prior_everywhere=True)
    found = diagnose(model.campaign, judge, screen, stated, poses_known=False, places_known=model.places_known, aside=False)
    if found.findings:
        model, first = solved(replace(found.campaign, poses=campaign.poses))
    names = dict.fromkeys(c.from_point for c in campaign.drums)
    # nearest to the reference poses the whole may lie anywhere
    searched = {} if model.frame == "poses" else {name: [box_of(model.campaign, name, settings)] for name in names}
    return _SolverStart(model, first, found, [], searched)


def _held_out(whole: Campaign, model: Model, found: Fit, poses: tuple[str, ...], seed: int) -> list[ValidationPose]:
    """The poses that took no part, each with its own unknowns, if it has them, fitted to its own lengths."""
    if not poses:
        return []
    free = tuple(model.free.tolist())
    every = (
        model_of(replace(whole, poses=model.campaign.poses, breaks=model.campaign.breaks), model.parameters, free, model.frame)
        .with_noise(model.noise)
        .with_sizes(model.sizes)
    )
    every.changes, theta = model.changes, every.start
    theta[np.isin(every.names, model.names)] = found.theta
    for name in poses if free else ():
        pose = whole.poses.names.index(name)
        determined = int(whole.used[pose].sum())
        if determined <= model.pose_unknowns:
            raise CalibrationError(
                message("error.hold_out_pose_counted", name=name, determined=determined, pose_unknowns=model.pose_unknowns)
            )
        theta = fitted_pose(every, theta, pose, seed)
    return validation_errors(every, theta, found, poses)
