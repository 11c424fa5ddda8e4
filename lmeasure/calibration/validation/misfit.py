"""Residuals larger than the stated noise: the best explanation, and an uncertainty that covers the rest."""

import math
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.calibration.campaign.campaign import Break
from lmeasure.calibration.solve.noise import ASSUMED
from lmeasure.calibration.solve.reference_field import field_covariance
from lmeasure.calibration.solve.sizes import Sized, with_estimated_sizes
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.explanations import Otherwise, arm_mm, every_length
from lmeasure.calibration.validation.hold_out import moved_points, outlier_poses, slipped_counters
from lmeasure.core import BoolArray, FloatArray
from lmeasure.estimation import CHANCE, Explained as State, Fit, evidence, explained, fit, improbable, settled
from lmeasure.rig import Finding
from lmeasure.sensors import ARM_MM
from lmeasure.text import message

DOUBTED = 0.02
"""Probability under which residuals raise no alarm, but measured lengths get an error of their own."""

MOST_CHANGES = 2
"""Changes of cables during a campaign that are solved for."""

REDUNDANT = 12
"""Degrees of freedom from which residuals determine the unstated uncertainty of poses."""

NOTED = 0.5
"""Part of the residuals' variance from which smooth errors of poses of unknown origin are reported."""

_OPTIONS = {"position": "--u-position-mm", "rotation": "--u-rotation-deg"}


@dataclass(frozen=True)
class Explained:
    """Explanation of residuals: the present problem, its fit, findings; whether a noise level was estimated from the residuals; u_length_mm
    (m,): independent errors of each cable's lengths at this and any other pose, of angles at `ARM_MM`."""

    model: Model
    fit: Fit
    findings: list[Finding]
    estimated: bool
    u_length_mm: FloatArray
    sized: Sized | None = None
    """Estimates of unstated sizes."""

    @property
    def averaged(self) -> Sized | None:
        """The same where the fit is still the one of these sizes."""
        return self.sized if self.sized is not None and self.model is self.sized.model else None


def explain_misfit(model: Model, found: Fit, blamed: list[str]) -> Explained:
    """Return the fit with the best explanation of its residuals, if chi-squared exceeds chance or the poses state no uncertainty.

    The pose or the slipped counter that the others contradict most is named. Then explanations compete (`estimation.explanations`): errors
    of poses and lengths, values that were taken as exact. The rest multiplies the covariance, and counts as an error of lengths elsewhere
    too. blamed: channels that a gross diagnosis has already named; their residuals are not used.
    """
    absent = model.noise.absent if model.places_known else ()
    telling = bool(absent) and found.freedom >= REDUNDANT and not blamed
    findings, changes = [_assumed(name) for name in absent], list[Finding]()
    model, found = _with_changes(model, found)
    sized = None if blamed else with_estimated_sizes(model, found)
    while not blamed and len(changes) < MOST_CHANGES and (change := _change(model, found, sized)):
        changes.append(change[1])
        model = model.with_break(change[0])
        model, found = _with_changes(model, fit(model, found.theta, found.prior_everywhere, near=True))
        sized = None if sized is None else with_estimated_sizes(model, found)
    alternatives, state = Otherwise(model.noise.bare() if telling else model.noise), State(model, found)
    if sized is not None:
        model, found = sized.model, sized.fit
        alternatives, state = Otherwise(model.noise), State(model, found)
        findings = [_sized(name, ASSUMED[name] * sized.size[name]) for name in absent]
        findings += _smooth(sized)
    elif telling:
        keys = tuple((name, None) for name in absent)
        state = settled(replace(state, sizes=dict.fromkeys(keys, 0.0), unstated=keys), alternatives)
        findings = [_estimated(state, name) for name in absent]
    findings += changes
    if not ((telling and sized is None) or improbable(found)):
        doubt = evidence(found, found.V).best(every_length(model))[0] if improbable(found, DOUBTED) else 0.0
        return Explained(model, found, findings, False, np.where(_drawn(model), doubt, 0.0), sized)
    if blamed:
        rms = _rms(found)
        text = message("calibration.residuals_mm_rms_exceed", rms=rms, blamed=tuple(blamed))
        return _covered(state, [*findings, Finding(code="misfit", text=text, value=rms)], rms)
    if improbable(state.fit) and not changes:
        findings += _outliers(state.problem, state.fit)
    begun, state = state, explained(state, alternatives)
    return replace(_covered(state, [*findings, *_findings_of_applied(state, begun)], _rms(begun.fit)), sized=sized)


def _drawn(model: Model) -> BoolArray:
    """(m,) which channels are cables."""
    return np.array([c.is_cable for c in model.campaign.cables], dtype=np.bool_)


def _rms(found: Fit) -> float:
    return float(np.sqrt(np.mean(found.residuals**2)))


def _covered(state: State[Model], findings: list[Finding], before: float) -> Explained:
    """Add the unexplained residuals to the covariance and to the lengths."""
    model, found = state.problem, state.fit
    known = model.noise.u_length_mm
    u_length = np.maximum(np.zeros(len(model.campaign.cables)) if known is None else known, np.where(_drawn(model), state.doubt, 0.0))
    if improbable(found):
        excess = found.chi2 / found.freedom
        # as independent errors of each length: the cause is unknown, and may affect every later length
        u = evidence(found, found.V).best(every_length(model))[0]
        u_length = np.hypot(u_length, np.where(_drawn(model), u or _rms(found) * math.sqrt(1.0 - 1.0 / excess), 0.0))
        found = replace(found, covariance=np.asarray(found.covariance * excess), excess=excess)
        if not any(w.code == "misfit" for w in findings):
            text = message(
                "calibration.residuals_mm_rms_exceed_stated", before=before, times=math.sqrt(excess), mm=np.sqrt(np.mean(u_length**2))
            )
            findings = [*findings, Finding(code="misfit", text=text, value=before)]
    return Explained(model, found, findings, bool(state.sizes) or found.excess > 1.0, u_length)


def _assumed(name: str) -> Finding:
    size = ASSUMED[name] if name == "position" else math.degrees(ASSUMED[name])
    text = message(f"calibration.assumed_{name}", size=size, option=_OPTIONS[name])
    return Finding(code=f"assumed_{name}", text=text, value=size)


def _estimated(state: State[Model], name: str) -> Finding:
    return _sized(name, _size(state, name))


def _sized(name: str, u: float) -> Finding:
    size = u if name == "position" else math.degrees(u)
    text = message(f"calibration.estimated_{name}", size=size, option=_OPTIONS[name])
    return Finding(code=f"assumed_{name}", text=text, value=size)


def _size(state: State[Model], name: str, channel: str | None = None) -> float:
    """Return the size of an error [mm], of a rotation [rad]."""
    u = state.sizes[name, channel]
    return u / arm_mm(state.problem) if name == "rotation" else u


def _smooth(sized: Sized) -> list[Finding]:
    """Return how far smooth errors of the reference poses limit the calibration, where a robot measured them or seems to have."""
    model, source = sized.model, sized.model.campaign.source
    own = {name: size for name, size in sized.size.items() if name.startswith("field_")}
    if not own:
        return []
    theta = sized.fit.theta
    errors = field_covariance(own, model.poses(theta), model.pose_jacobian(theta))
    mm, part = float(np.sqrt(np.mean(np.diag(errors)))), float(np.trace(errors) / np.trace(sized.fit.V))
    if source == "unknown" and part < NOTED:
        return []
    return [Finding(code="note", text=message(f"calibration.smooth_errors_{source}", mm=mm), value=mm)]


def _with_changes(model: Model, found: Fit) -> tuple[Model, Fit]:
    """Return the model with the most probable changes of its cables during the campaign, and the fit without them in its residuals."""
    if not model.campaign.breaks:
        return model, found
    model = model.with_changes(found)
    return model, replace(found, problem=model, residuals=model.residuals(found.theta))


def _change(model: Model, found: Fit, sized: Sized | None) -> tuple[Break, Finding] | None:
    """Return the observation point that moved during the calibration, or the counter that slipped; None without one. Estimated errors of
    poses would hide a move, which is looked for whether or not the residuals are beyond chance."""
    if sized is not None:
        model, found = sized.model, sized.fit
    one = None if sized is None else moved_points(model, found)
    if one is None and improbable(found):
        one = min([*outlier_poses(model, found), *slipped_counters(model, found)], key=lambda s: s.log_probability, default=None)
    if one is None or one.channel is None or one.log_probability > math.log(CHANCE):
        return None
    point = next((c.from_point for c in model.campaign.drums if c.channel == one.channel), "")
    p = math.exp(one.log_probability)
    values = {"point": point, "channel": one.channel, "pose": one.pose, "mm": one.shift_mm, "f": one.statistic, "p": p}
    text = message("calibration.moved_point" if one.kind == "moved" else "calibration.slip", **values)
    return Break(one.channel, one.pose), Finding(code=one.kind, channel=one.channel, pose=one.pose, value=one.shift_mm, text=text)


def _findings_of_applied(state: State[Model], begun: State[Model]) -> list[Finding]:
    """Report the applied explanations."""
    rms, out = _rms(begun.fit), []
    for group in state.groups:
        rest = message("calibration.exceed.solved", values=message(f"calibration.values.{group}"), group=group)
        out.append(Finding(code="misfit", text=message("calibration.exceed", rms=rms, rest=rest), value=rms))
    for name, channel in list(state.sizes)[len(begun.sizes) :]:
        u = _size(state, name, channel)
        if not u:
            continue
        encoder = channel is not None and not next(c.is_length for c in state.problem.campaign.cables if c.channel == channel)
        if name == "length" and encoder:
            rest = message("calibration.exceed.encoder", channel=channel, deg=math.degrees(u / ARM_MM))
        elif name == "length":
            whose = message("calibration.each_cable") if channel is None else message("calibration.channel", channel=channel)
            rest = message("calibration.exceed.lengths", whose=whose, u=u)
        elif name == "stated":
            rest = message("calibration.exceed.stated", times=math.sqrt(1 + u**2))
        else:
            turn = math.degrees(u / arm_mm(state.problem) if name == "pose" else u)
            rest = message(
                f"calibration.exceed.{name}", mm=u, deg=turn, option=_OPTIONS.get(name) or message("calibration.options_of_pose")
            )
        text = message("calibration.exceed", rms=rms, rest=rest)
        if (name, channel) != ("length", None) and state.doubt:
            text = message("calibration.exceed.lengths_too", rest=text, mm=state.doubt)
        value = math.degrees(u) if name == "rotation" else u
        out.append(Finding(code="misfit", text=text, channel=channel, value=value))
    return out


def _outliers(model: Model, found: Fit) -> list[Finding]:
    """Return the pose that the others contradict most, if chance does not explain it."""
    worst = min(outlier_poses(model, found), key=lambda s: s.log_probability, default=None)
    if worst is None or worst.log_probability > math.log(CHANCE):
        return []
    text = message("calibration.outlier", pose=worst.pose, f=worst.statistic, p=math.exp(worst.log_probability))
    return [Finding(code="outlier", pose=worst.pose, value=worst.statistic, text=text)]
