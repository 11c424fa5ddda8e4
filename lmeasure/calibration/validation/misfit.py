"""Residuals larger than the stated noise: what explains them best, in words, and an uncertainty that covers what nothing explains."""

import math
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.calibration.solve.noise import ASSUMED
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.explanations import Otherwise, arm_mm, every_length
from lmeasure.calibration.validation.hold_out import outlier_poses, slipped_counters
from lmeasure.core import BoolArray, FloatArray
from lmeasure.estimation import CHANCE, Explained as State, Fit, evidence, explained, improbable, settled
from lmeasure.rig import Finding
from lmeasure.sensors import ARM_MM

DOUBTED = 0.02
"""Probability under which residuals raise no alarm, and yet lengths that err are reckoned with in what is measured."""

REDUNDANT = 12
"""Degrees of freedom from which residuals tell how uncertain poses are that do not say it."""

_OPTIONS = {"position": "--u-position-mm", "rotation": "--u-rotation-deg", "pose": "--u-position-mm and --u-rotation-deg"}


@dataclass(frozen=True)
class Explained:
    """What residuals were put down to: the problem as it is solved now, its fit, findings; whether a noise level was estimated from the
    residuals; u_length_mm (m,): what the lengths of each cable err by on their own, at other poses as here, and angles at `ARM_MM`."""

    model: Model
    fit: Fit
    findings: list[Finding]
    estimated: bool
    u_length_mm: FloatArray


def explain_misfit(model: Model, found: Fit, blamed: list[str]) -> Explained:
    """The fit under what explains its residuals best, where chi-squared exceeds chance or the poses do not say how uncertain they are.

    The pose or the slipped counter that the others contradict most is named. Then explanations compete (`estimation.explanations`): errors
    of poses and lengths, values that were taken as exact. What is left multiplies the covariance, and counts as an error of lengths
    elsewhere too. blamed: channels that a gross diagnosis has named already; their residuals are no measure of anything.
    """
    absent = model.noise.absent if model.places_known else ()
    telling = bool(absent) and found.freedom >= REDUNDANT and not blamed
    alternatives, state = Otherwise(model.noise.bare() if telling else model.noise), State(model, found)
    findings = [_assumed(name) for name in absent]
    if telling:
        keys = tuple((name, None) for name in absent)
        state = settled(replace(state, sizes=dict.fromkeys(keys, 0.0), unstated=keys), alternatives)
        findings = [_estimated(state, name) for name in absent]
    if not (telling or improbable(found)):
        doubt = evidence(found, found.V).best(every_length(model))[0] if improbable(found, DOUBTED) else 0.0
        return Explained(model, found, findings, False, np.where(_drawn(model), doubt, 0.0))
    if blamed:
        rms = _rms(found)
        text = f"residuals of {rms:.3g} mm rms exceed the noise; look first at what is named above ({', '.join(blamed)})"
        return _covered(state, [*findings, Finding(code="misfit", text=text, value=rms)], rms)
    if improbable(state.fit):
        findings += _contradictions(state.problem, state.fit)
    begun, state = state, explained(state, alternatives)
    return _covered(state, [*findings, *_told(state, begun)], _rms(begun.fit))


def _drawn(model: Model) -> BoolArray:
    """(m,) which channels are cables."""
    return np.array([c.is_cable for c in model.campaign.cables], dtype=np.bool_)


def _rms(found: Fit) -> float:
    return float(np.sqrt(np.mean(found.residuals**2)))


def _covered(state: State[Model], findings: list[Finding], before: float) -> Explained:
    """What is left unexplained goes into the covariance, and into the lengths."""
    model, found = state.problem, state.fit
    known = model.noise.u_length_mm
    u_length = np.maximum(np.zeros(len(model.campaign.cables)) if known is None else known, np.where(_drawn(model), state.doubt, 0.0))
    if improbable(found):
        excess = found.chi2 / found.freedom
        # as if each length were off on its own: what stands behind it is not known, and may be in every length that is measured later
        u = evidence(found, found.V).best(every_length(model))[0]
        u_length = np.hypot(u_length, np.where(_drawn(model), u or _rms(found) * math.sqrt(1.0 - 1.0 / excess), 0.0))
        found = replace(found, covariance=np.asarray(found.covariance * excess), excess=excess)
        if not any(w.code == "misfit" for w in findings):
            text = (
                f"residuals of {before:.3g} mm rms exceed the stated noise, and nothing explains them; the uncertainties are multiplied by "
                f"{math.sqrt(excess):.3g}, and {np.sqrt(np.mean(u_length**2)):.3g} mm of each length is carried into what is measured"
            )
            findings = [*findings, Finding(code="misfit", text=text, value=before)]
    return Explained(model, found, findings, bool(state.sizes) or found.excess > 1.0, u_length)


def _assumed(name: str) -> Finding:
    size, unit = (ASSUMED[name], "mm") if name == "position" else (math.degrees(ASSUMED[name]), "deg")
    text = (
        f"reference_poses.csv does not state how uncertain the {name}s are, and the residuals are too few to tell: {size:g} {unit} "
        f"(1 sigma per axis) is assumed; state it ({_OPTIONS[name]})"
    )
    return Finding(code=f"assumed_{name}", text=text, value=size)


def _estimated(state: State[Model], name: str) -> Finding:
    u = _size(state, name)
    size = f"{u:.2g} mm" if name == "position" else f"{math.degrees(u):.2g} deg"
    text = (
        f"reference_poses.csv does not state how uncertain the {name}s are: the residuals agree with {size} (1 sigma per axis), which is "
        f"taken; state it if it is known ({_OPTIONS[name]})"
    )
    return Finding(code=f"assumed_{name}", text=text, value=u if name == "position" else math.degrees(u))


def _size(state: State[Model], name: str, channel: str | None = None) -> float:
    """Of an error: [mm], a rotation in rad."""
    u = state.sizes[name, channel]
    return u / arm_mm(state.problem) if name == "rotation" else u


def _told(state: State[Model], begun: State[Model]) -> list[Finding]:
    """What was taken, in words."""
    rms = f"residuals of {_rms(begun.fit):.3g} mm rms exceed the stated noise"
    out = []
    for group in state.groups:
        text = f"{rms}; errors of the {_VALUES[group]} explain them best and were solved for too (ask for it: --solve ...,{group})"
        out.append(Finding(code="misfit", text=text, value=_rms(begun.fit)))
    for name, channel in list(state.sizes)[len(begun.sizes) :]:
        u = _size(state, name, channel)
        if not u:
            continue
        encoder = channel is not None and not next(c.is_length for c in state.problem.campaign.cables if c.channel == channel)
        if name == "length" and encoder:
            text = (
                f"{rms}; angles of encoder {channel} that err by {math.degrees(u / ARM_MM):.3g} deg on their own (it stands off its axis, "
                "has play, or its pulley does not follow the cable) explain them best, and the uncertainties of this rig include that"
            )
        elif name == "length":
            whose = "each cable" if channel is None else f"channel {channel}"
            text = (
                f"{rms}; lengths of {whose} that err by {u:.3g} mm on their own (run-out, eccentric pulleys, friction) explain them best, "
                "and the uncertainties of this rig and of what is measured with it include that"
            )
        elif name == "stated":
            text = f"{rms}; reference poses {math.sqrt(1 + u**2):.3g} times as uncertain as stated explain them best, and are taken so"
        else:
            turn = math.degrees(u / arm_mm(state.problem) if name == "pose" else u)
            sizes = {"position": f"{u:.3g} mm", "rotation": f"{turn:.3g} deg", "pose": f"{u:.3g} mm and {turn:.3g} deg"}[name]
            text = (
                f"{rms}; reference poses in error by {sizes} (1 sigma per axis) more than stated explain them best, and the uncertainties "
                f"include that; if it is so, state it ({_OPTIONS[name]})"
            )
        if (name, channel) != ("length", None) and state.doubt:
            rival = f"Lengths of all cables that err by {state.doubt:.3g} mm on their own explain nearly as much"
            text += f". {rival}, and are reckoned with"
        value = math.degrees(u) if name == "rotation" else u
        out.append(Finding(code="misfit", text=text, channel=channel, value=value))
    return out


_VALUES = {"scale": "drums' circumferences (scales)", "attachment": "attachment points", "radius": "pulleys' radii"}


def _contradictions(model: Model, found: Fit) -> list[Finding]:
    tests = [*outlier_poses(model, found), *slipped_counters(model, found)]
    worst = min(tests, key=lambda s: s.log_probability, default=None)
    if worst is None or worst.log_probability > math.log(CHANCE):
        return []
    odds = f"F = {worst.statistic:.3g}, p = {math.exp(worst.log_probability):.2g}"
    if worst.kind == "outlier":
        text = f"pose {worst.pose}: the other poses contradict it ({odds}); it was used all the same"
        return [Finding(code="outlier", pose=worst.pose, value=worst.statistic, text=text)]
    text = (
        f"channel {worst.channel}: its counter slipped by {worst.shift_mm:+.4g} mm from pose {worst.pose} on ({odds}); nothing was repaired"
    )
    return [Finding(code="slip", channel=worst.channel, pose=worst.pose, value=worst.shift_mm, text=text)]
