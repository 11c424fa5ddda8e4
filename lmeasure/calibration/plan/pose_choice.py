"""Choice of the reference poses that leave the least uncertainty in the lengths predicted over a zone."""

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign, extended
from lmeasure.calibration.plan.candidates import Candidates, candidates
from lmeasure.calibration.plan.information import Instrument
from lmeasure.calibration.plan.reach import Limits, Region, Usable
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation import observability
from lmeasure.core import CalibrationError, DataFrame, FloatArray, Shown, words_of
from lmeasure.estimation import (
    CRITERIA,
    Criterion,
    Design,
    Fit,
    empty,
    estimated_covariance,
    fit,
    grown,
    improved,
    ordered,
    parameter_information,
)
from lmeasure.kernels import span_lengths
from lmeasure.recording import Poses, joined, poses_from_rows
from lmeasure.rig import Observed, Rig, Unobservable, cables_among
from lmeasure.text import Lines, composed, message

Progress = Callable[[int, int], None]

POOL_LOG2 = 10
STARTS = 2  # besides the greedy one, random designs that are improved too
TARGETS_LOG2 = 5
CHECKS_LOG2 = 8
MAX_POSES = 200


@dataclass(frozen=True)
class PlanSettings:
    """Purpose of a plan.

    poses: how many to choose (the zero pose among them, unless recorded poses are extended); region: where the robot may go; zone: where
    lengths are to be predicted, default the region; criterion: a key of `CRITERIA`; u_position_mm, u_rotation_rad: standard
    uncertainty of the reference poses; further: how many poses beyond the plan are weighed.
    """

    poses: int
    region: Region
    zone: Region | None = None
    criterion: str = "G"
    solve: tuple[str, ...] = ("position", "guide")
    u_position_mm: float = 0.0
    u_rotation_rad: float = 0.0
    passes: tuple[int, ...] = (1,)
    limits: Limits = field(default_factory=Limits)
    further: int = 3
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "solve", words_of(self.solve))


@dataclass(frozen=True)
class Outlook:
    """Predicted standard uncertainty, from the calibration alone, of the change of a cable's length since the zone's middle [mm]: rms and
    worst over the zone and cables, the worst's cable; how many of the unknown directions the counts determine."""

    rms_mm: float
    worst_mm: float
    worst_cable: str
    rank: int


@dataclass(frozen=True, repr=False)
class Plan(Shown):
    """Reference poses to measure, and the predicted uncertainty.

    poses: all of them, recorded ones first, without their later visits; recorded: how many of them existed before. course: (number of
    poses, outlook) as the planned poses are measured one after the other, then with the further poses. without: (name, outlook) of the plan
    without one of its poses, the zero pose excepted. parameters: (name, u, prior u). undetermined: combinations that no count of the plan
    determines. usable: part of the tried poses that every cable allows, and broken: (limit, part that breaks it).
    """

    poses: Poses
    recorded: int
    outlook: Outlook
    course: tuple[tuple[int, Outlook], ...]
    without: tuple[tuple[str, Outlook], ...]
    parameters: tuple[tuple[str, float, float], ...]
    undetermined: tuple[Unobservable, ...]
    equations: int
    usable: float
    broken: tuple[tuple[str, float], ...]

    def about(self) -> dict[str, str]:
        """Return the number of poses, and their predicted uncertainty."""
        lengths = f"{self.outlook.rms_mm:.4f} mm rms, {self.outlook.worst_mm:.4f} at worst"
        return {"poses": f"{len(self.poses)}, {self.recorded} recorded", "predicted u of lengths": lengths}

    def to_frame(self) -> DataFrame:
        """The poses."""
        return self.poses.to_frame()


def plan_poses(rig: Rig, settings: PlanSettings, recorded: Campaign | None = None, progress: Progress | None = None) -> Plan:
    """Choose reference poses for a calibration of the rig, or further ones for a campaign already recorded.

    Poses are usable where `reach.Limits` hold at the rig's own values. CalibrationError when there are none, when the zone cannot be
    reached, when the recorded campaign has other cables than the rig, or when the settings make no sense.
    """
    least = 1 if recorded else 2
    if not least <= settings.poses <= MAX_POSES:
        raise CalibrationError(message("error.a_plan_of_poses", poses=settings.poses, least=least, max_poses=MAX_POSES))
    if settings.criterion not in CRITERIA:
        raise CalibrationError(message("error.the_criterion_is_not", criterion=settings.criterion, criteria=", ".join(CRITERIA)))
    channels = _channels(rig, settings, recorded)
    cables = cables_among(channels)
    sigma = np.repeat([settings.u_rotation_rad, settings.u_position_mm], 3)
    instrument = Instrument(rig, channels, settings.solve, sigma, visit=repeatability(recorded))
    zone = settings.zone or replace(settings.region, angles=None)
    targets, checks = (lengths_over(instrument, zone, log2, settings.seed) for log2 in (TARGETS_LOG2, CHECKS_LOG2))
    start = settings.region.centre if recorded is None else recorded.poses.rows[recorded.zero[0]]
    # with one orientation there is no other to choose
    limits = settings.limits if settings.region.tilt_rad > 0.0 else replace(settings.limits, singular_deg=0.0)
    usable = Usable(rig, cables, limits, start)
    rng = np.random.default_rng([settings.seed, 11])
    pool = settings.region.candidates(POOL_LOG2, rng)
    broken = usable.broken(settings.region.rows(pool))
    good = ~broken.any(axis=1)
    parts = tuple((reason, float(part)) for reason, part in zip(Usable.REASONS, broken.mean(axis=0), strict=True))
    if not good.any():
        why = ", ".join(f"{reason} at {part:.0%}" for reason, part in parts if part)
        raise CalibrationError(message("error.rig_no_pose_of", name=rig.name, why=why))
    p = len(instrument.unknowns.names)
    if recorded is None:
        shared = p + instrument.zero(settings.region.centre).root.shape[1]
        before, zero, taken = np.zeros((shared, shared)), None, np.zeros((0, 6))
    else:
        before, zero = instrument.recorded(recorded)
        taken = settings.region.unit(recorded.poses.rows)
    space = candidates(instrument, settings.region, usable, pool[good], taken=taken, zero=zero)
    design = _search(empty(space, before + np.eye(len(before))), settings, targets, rng, progress)
    chosen = settings.poses - (recorded is None)
    if len(design.points) < chosen:
        raise CalibrationError(message("error.the_box_has_room", n_points=len(design.points) + (recorded is None), poses=settings.poses))
    criterion = targets.criterion(settings.criterion)
    # a free zero pose comes first, whatever it brings
    design = ordered(design, criterion)
    more = grown(design, settings.further, criterion, rng)
    return _described(settings, recorded, design, more, checks, (float(good.mean()), parts))


def repeatability(recorded: Campaign | None) -> FloatArray:
    """(6,) standard deviations (rotations [rad]; coordinates [mm]) with which the robot is taken to come to a pose yet to be measured: the
    largest that the recorded poses state."""
    return np.zeros(6) if recorded is None or recorded.u_visit is None else np.asarray(recorded.u_visit.max(axis=0))


def _channels(rig: Rig, settings: PlanSettings, recorded: Campaign | None) -> tuple[Observed, ...]:
    if recorded is None:
        cables = tuple(c for c in rig.observed if c.passage in settings.passes)
        if not any(c.is_cable for c in cables):
            raise CalibrationError(message("error.rig_no_cable_belongs", name=rig.name, passes=", ".join(str(n) for n in settings.passes)))
        return cables
    own = {(c.name, c.channel, c.from_point, c.to_point, c.passage) for c in rig.observed}
    for c in recorded.cables:
        if (c.name, c.channel, c.from_point, c.to_point, c.passage) not in own:
            raise CalibrationError(message("error.rig_cable_of_the", name=rig.name, name2=c.name))
    return recorded.cables


@dataclass(frozen=True)
class PredictedLengths:
    """Derivatives [mm] of predicted changes of c cables by the unknowns in prior widths: inside (n, c, p) at poses spread evenly over the
    zone, corners (k, c, p) at its corners."""

    inside: FloatArray
    corners: FloatArray
    cables: tuple[str, ...]

    def criterion(self, kind: str) -> Criterion:
        """A mean is taken evenly over the zone; the worst is looked for at its corners too."""
        chosen = np.concatenate([self.inside, self.corners]) if kind == "G" else self.inside
        return Criterion(kind, chosen.reshape(-1, chosen.shape[2]))


def lengths_over(instrument: Instrument, zone: Region, log2: int, seed: int) -> PredictedLengths:
    """Return predicted lengths of all cables of the rig to a measured point, of any pass. Changes count from the middle of the zone, the
    zero pose of a run. Poses that a cable cannot reach are omitted."""
    points = {c.from_point for c in instrument.cables}
    cables = tuple(c for c in instrument.rig.cable if c.from_point in points)
    kernel_rows = instrument.rig.cable_rows(cables)
    start = zone.centre[None, :]
    unit = scipy.stats.qmc.Sobol(6, scramble=True, rng=np.random.default_rng([seed, log2])).random_base2(log2)
    out = []
    for rows in (zone.rows(np.where(zone.active, unit, 0.5)), zone.rows(zone.corners())):
        rows = rows[np.isfinite(span_lengths(kernel_rows, rows)).all(axis=1)]
        if not len(rows) or not np.isfinite(span_lengths(kernel_rows, start)).all():
            raise CalibrationError(message("error.rig_its_cables_cannot", name=instrument.rig.name))
        out.append(instrument.gradients(rows, start, np.zeros(len(cables), np.int64), cables))
    return PredictedLengths(out[0], out[1], tuple(c.name for c in cables))


def _search(
    start: Design[Candidates], settings: PlanSettings, targets: PredictedLengths, rng: np.random.Generator, progress: Progress | None
) -> Design[Candidates]:
    """The best of a greedy and some random starts, each improved; the largest variance is brought down from the smallest mean."""
    kinds = ("I", "G") if settings.criterion == "G" else (settings.criterion,)
    criteria = [targets.criterion(kind) for kind in kinds]
    count = settings.poses - (start.candidates.zero_unit is not None)
    best: Design[Candidates] | None = None
    for attempt in range(STARTS + 1):
        design = grown(start, count, criteria[0] if attempt == 0 else None, rng)
        for stage, criterion in enumerate(criteria):
            if progress:
                progress(attempt * len(criteria) + stage, (STARTS + 1) * len(criteria))
            design = improved(design, criterion, rng)
        value = criteria[-1].value(design.information)
        if best is None or criteria[-1].better(value, criteria[-1].value(best.information)):
            best = design
    assert best is not None
    if progress:
        progress((STARTS + 1) * len(criteria), (STARTS + 1) * len(criteria))
    return best


def _described(
    settings: PlanSettings,
    recorded: Campaign | None,
    design: Design[Candidates],
    more: Design[Candidates],
    checks: PredictedLengths,
    usable: tuple[float, tuple[tuple[str, float], ...]],
) -> Plan:
    """The plan; more: the design with the further poses that are weighed, behind its own."""
    instrument = design.candidates.instrument
    p = len(instrument.unknowns.names)
    prior = np.eye(len(design.before))

    def outlook(M: FloatArray) -> Outlook:
        return outlook_of(parameter_information(M - prior, p), checks)

    old, new = _poses(settings, recorded, design)
    poses, first = joined(old, new), len(old)
    start = first + (design.candidates.zero_unit is not None)
    course = []
    M = design.before.copy()
    if recorded is not None:
        course.append((first, outlook(M)))
    for i, block in enumerate(more.blocks):
        M = M + block.T @ block
        course.append((start + i + 1, outlook(M)))
    found, model = _predicted_fit(instrument, recorded, new)
    sight = observability.lines_of_sight(instrument.rig, instrument.cables, poses)
    u = np.sqrt(np.diag(found.covariance))
    return Plan(
        poses,
        first,
        outlook(design.information),
        tuple(course),
        tuple((name, outlook(design.without(k))) for k, name in enumerate(poses.names[start:])),
        tuple(zip(instrument.unknowns.names, u.tolist(), instrument.unknowns.width.tolist(), strict=True)),
        tuple(observability.unobservable_directions(instrument.unknowns, found.directions[~found.known], sight)),
        model.equations,
        *usable,
    )


def outlook_of(information: FloatArray, lengths: PredictedLengths) -> Outlook:
    """Return the outlook for lengths from counts with the information (p, p) in prior widths, without priors."""
    covariance, rank = estimated_covariance(information)
    inside, corners = (np.sum((g @ covariance) * g, axis=2) for g in (lengths.inside, lengths.corners))
    worst = np.maximum(inside.max(axis=0), corners.max(axis=0))
    return Outlook(math.sqrt(inside.mean()), math.sqrt(worst.max()), lengths.cables[int(np.argmax(worst))], rank)


def _poses(settings: PlanSettings, recorded: Campaign | None, design: Design[Candidates]) -> tuple[Poses, Poses]:
    """The recorded reference poses as they are stated, and the new ones, named by the next free numbers."""
    zero = design.candidates.zero_unit
    units = design.points if zero is None else np.vstack([zero, design.points])
    rows = settings.region.rows(units)
    old = poses_from_rows(np.zeros((0, 7))) if recorded is None else recorded.poses.of(np.unique(recorded.reference_of))
    number = max([0, *(int(n) for n in old.names if n.isascii() and n.isdigit())])
    names = tuple(str(number + i + 1) for i in range(len(rows)))
    return old, Poses(names, rows, np.full(len(rows), settings.u_position_mm), np.full(len(rows), settings.u_rotation_rad))


def _predicted_fit(instrument: Instrument, recorded: Campaign | None, new: Poses) -> tuple[Fit, Model]:
    """Return the estimator's own fit of the plan: to the counts that the rig predicts, not rounded."""
    n, m = len(new), len(instrument.cables)
    if recorded is None:
        campaign = Campaign(instrument.rig, new, instrument.cables, np.zeros((n, m)), np.zeros(m, np.int64))
    else:
        campaign = extended(recorded, new, np.zeros((n, m)), np.tile(instrument.visit, (n, 1)))
    model = Model(instrument.predicted(campaign), instrument.unknowns)
    return fit(model, model.start), model


MICRO_MM = 1e-3


def _line(first: str, outlook: Outlook, unknowns: int, note: str = "") -> str:
    known = message("calibration.plan.of", rank=outlook.rank, of=unknowns)
    rms, worst = (".4f" if mm >= MICRO_MM else ".2e" for mm in (outlook.rms_mm, outlook.worst_mm))
    row = f"{{first:>6s}} {{rms:10{rms}}} {{worst:10{worst}}}  {{cable:8s}} {{known:>10s}}" + ("  {note}" if note else "")
    return composed(row, first=first, known=known, note=note, rms=outlook.rms_mm, worst=outlook.worst_mm, cable=outlook.worst_cable)


def plan_summary(plan: Plan) -> str:
    """Return the predicted uncertainty after each pose and with further ones, and the parameters that the plan does not determine."""
    outlook, unknowns = plan.outlook, len(plan.parameters)
    predicted = message("calibration.predicted_worst_u_mm", worst=outlook.worst_mm, cable=outlook.worst_cable, rms=outlook.rms_mm)
    exact = not (plan.poses.u_position_mm.any() or plan.poses.u_rotation_rad.any())
    lines: list[str] = [
        message("calibration.plan.exact", what=predicted) if exact else predicted,
        message("calibration.equations_unknowns_directions_determined", equations=plan.equations, unknowns=unknowns, rank=outlook.rank),
    ]
    if plan.undetermined:
        lines.append(message("calibration.plan_leaves_directions_undetermined", count=len(plan.undetermined)))
    lines.append(message("calibration.poses_tried_can_used", part=plan.usable))
    lines += [message("calibration.ruled_out", part=part, reason=reason) for reason, part in plan.broken if part]
    lines += ["", message("calibration.predicted_standard_uncertainty_length"), message("calibration.after_many_poses"), _head()]
    for count, after in plan.course:
        of_plan, further = count == len(plan.poses), count > len(plan.poses)
        note = "recorded" if count == plan.recorded else "plan" if of_plan else "further" if further else ""
        lines.append(_line(str(count), after, unknowns, message(f"calibration.plan.{note}") if note else ""))
    return Lines(lines)


def plan_details(plan: Plan) -> str:
    """The plan without each of its poses, and each parameter combination that it does not determine."""
    lines: list[str] = []
    if len(plan.poses) - plan.recorded > 1:
        lines += [message("calibration.plan_without_one_pose"), _head()]
        lines += [_line(name, outlook, len(plan.parameters)) for name, outlook in plan.without]
    return Lines([*lines, *(composed("  {text}", text=u.text) for u in plan.undetermined)])


def _head() -> str:
    columns = {name: message(f"calibration.plan.{name}") for name in ("rms", "worst", "cable", "determined")}
    return message("calibration.plan.head", gap="", **columns)
