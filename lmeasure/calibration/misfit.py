"""Residuals larger than the stated noise: what explains them best, and an uncertainty that covers what nothing explains."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy.stats

from lmeasure.arrays import FloatArray
from lmeasure.calibration import explanations
from lmeasure.calibration.explanations import Evidence, Explanation
from lmeasure.calibration.refine import ASSUMED, Fit, Noise, Refit, residual_covariance
from lmeasure.calibration.unknowns import Model
from lmeasure.calibration.validation import Suspect, Validation
from lmeasure.calibration_record import Finding

CHANCE = 1e-3
"""Probability under which residuals are not put down to chance."""

DOUBTED = 0.02
"""Probability under which residuals raise no alarm, and yet lengths that err are reckoned with in what is measured."""

NEEDED = 12.0
"""Least gain in twice the log likelihood for which an explanation is taken: chance has it once in thousands, and there are a dozen."""

SURE = 20.0
"""The same of a further explanation, when chi-squared is no longer beyond chance: residuals that could be left as they are."""

MOST = 3
"""Explanations of one campaign."""

ROUNDS = 2  # the second settles a size where the first moved the optimum

ASKED = 4.0
"""Gain from which residuals ask for an uncertainty of poses that state none; with less they are as good as exact."""

REFUTED = 9.2
"""By how much less lengths that err must gain than poses that do, so that they need not be reckoned with: odds of a hundred."""

REDUNDANT = 12
"""Degrees of freedom from which residuals tell how uncertain poses are that do not say it."""

_OPTIONS = {"position": "--u-position-mm", "rotation": "--u-rotation-deg", "pose": "--u-position-mm and --u-rotation-deg"}


@dataclass(frozen=True)
class Problem:
    """A campaign as it is solved: its model and noise, how to fit it again, and the same with a further group of values solved for (None
    where it is solved for already)."""

    model: Model
    noise: Noise
    refit: Refit
    freed: Callable[[str], "Problem | None"]

    def wider(self, group: str) -> Model | None:
        """The model with a group of values solved for."""
        problem = self.freed(group)
        return None if problem is None else problem.model


@dataclass(frozen=True)
class Explained:
    """What residuals were put down to: the problem as it is solved now, its fit, findings; whether a noise level was estimated from the
    residuals; u_length_mm (m,): what the lengths of each cable err by on their own, at other poses as here."""

    problem: Problem
    fit: Fit
    findings: list[Finding]
    estimated: bool
    u_length_mm: FloatArray


@dataclass(frozen=True)
class _State:
    """Explanations taken so far: groups of values solved for, errors (name, channel) with their sizes; stated: the noise without these."""

    problem: Problem
    stated: Noise
    fit: Fit
    groups: tuple[str, ...] = ()
    errors: tuple[tuple[str, str | None], ...] = ()
    sizes: tuple[float, ...] = ()
    doubt_mm: float = 0.0
    """Error of lengths that explains nearly as well what was put down to poses."""


def explain_misfit(problem: Problem, found: Fit, blamed: list[str]) -> Explained:
    """The fit under what explains its residuals best, where chi-squared exceeds chance or the poses do not say how uncertain they are.

    The pose or the slipped counter that the others contradict most is named. Then explanations compete (`explanations`), the one that gains
    most first, as long as one gains more than chance does: errors widen the noise, values that were taken as exact are solved for. What is
    left multiplies the covariance, and counts as an error of lengths elsewhere too. blamed: channels that a gross diagnosis has named
    already; their residuals are no measure of anything.
    """
    absent = problem.noise.absent if problem.model.places_known else ()
    telling = bool(absent) and found.freedom >= REDUNDANT and not blamed
    state = _State(problem, problem.noise, found)
    findings = [_assumed(name) for name in absent]
    if telling:
        state = _settled(replace(state, stated=problem.noise.bare(), errors=tuple((name, None) for name in absent)))
        findings = [_estimated(state, name) for name in absent]
    if not (telling or improbable(found)):
        doubt = _evidence(state, found.V).best(explanations.every_length(problem.model))[0] if improbable(found, DOUBTED) else 0.0
        return Explained(problem, found, findings, False, np.full(len(problem.model.campaign.cables), doubt))
    if blamed:
        rms = _rms(found)
        text = f"residuals of {rms:.3g} mm rms exceed the noise; look first at what is named above ({', '.join(blamed)})"
        return _covered(state, [*findings, Finding(code="misfit", text=text, value=rms)], rms)
    if improbable(state.fit):
        findings += _contradictions(state.problem.model, state.fit)
    begun = state
    for _ in range(MOST):
        gains = _gains(state)
        best = max(gains, key=lambda each: each.gain, default=None)
        if best is None or best.gain < _needed(state):
            break
        state = _pruned(_with(state, best, gains), problem)
    return _covered(state, [*findings, *_told(state, begun)], _rms(begun.fit))


def improbable(found: Fit, chance: float = CHANCE) -> bool:
    """Whether chi-squared of a fit is beyond chance."""
    freedom = found.freedom
    return freedom >= 1 and bool(scipy.stats.chi2.sf(found.chi2, freedom) < chance)


def _needed(state: _State) -> float:
    return NEEDED if improbable(state.fit) else SURE


def _rms(found: Fit) -> float:
    return float(np.sqrt(np.mean(found.residuals**2)))


def _evidence(state: _State, V: FloatArray) -> Evidence:
    """What is judged under a covariance V of the residuals; nominal values that decide are as uncertain as they say."""
    fit, model = state.fit, state.problem.model
    silent = fit.undetermined(model)
    return Evidence(fit.residuals, fit.determined(model), V + silent @ silent.T)


@dataclass(frozen=True)
class _Gain:
    """What an explanation of a size gains beside those taken."""

    explanation: Explanation
    size: float
    gain: float


def _gains(state: _State) -> list[_Gain]:
    """What each explanation that is not taken already gains."""
    model, theta = state.problem.model, state.fit.theta
    every = [x for x in explanations.of_noise(model, theta, state.stated) if (x.name, x.channel) not in state.errors]
    every += explanations.of_values(model, theta, state.problem.wider)
    judge = _evidence(state, state.fit.V)
    return [_Gain(x, *judge.best(x)) for x in every]


def _with(state: _State, taken: _Gain, gains: list[_Gain]) -> _State:
    """The state with a further explanation, the best of some."""
    name, channel = taken.explanation.name, taken.explanation.channel
    problem = state.problem.freed(name) if name in explanations.FREED else None
    if problem is None:
        if (name, channel) != ("length", None):
            # in few poses they look alike: poses that err, one cable's lengths, all cables'; only lengths err again in what is measured
            rival = next((g for g in gains if g.explanation.name == "length" and g.explanation.channel is None), None)
            if rival is not None and rival.gain > taken.gain - REFUTED:
                state = replace(state, doubt_mm=rival.size)
        return _settled(replace(state, errors=(*state.errors, (name, channel)), sizes=(*state.sizes, 0.0)))
    start = explanations.embedded(state.problem.model, state.fit.theta, problem.model)
    problem = replace(problem, noise=state.problem.noise)
    fit = problem.refit(start, problem.noise, False)
    return _settled(replace(state, problem=problem, fit=fit, groups=(*state.groups, name)))


def _pruned(state: _State, begun: Problem) -> _State:
    """The state without the groups of values that what was taken after them has made idle: errors of poses can look like anything."""
    for group in state.groups[:-1] if not state.errors else state.groups:
        problem, others = begun, tuple(g for g in state.groups if g != group)
        for name in others:
            problem = problem.freed(name) or problem
        problem = replace(problem, noise=state.problem.noise)
        start = explanations.embedded(state.problem.model, state.fit.theta, problem.model)
        trial = _settled(replace(state, problem=problem, fit=problem.refit(start, problem.noise, False), groups=others))
        if next(g.gain for g in _gains(trial) if g.explanation.name == group) < _needed(trial):
            state = trial
    return state


def _settled(state: _State) -> _State:
    """The state with the sizes of its errors estimated together, and the fit under them."""
    for _ in range(ROUNDS if state.errors else 0):
        model, theta = state.problem.model, state.fit.theta
        every = {(x.name, x.channel): x for x in explanations.of_noise(model, theta, state.stated)}
        judge = _evidence(state, residual_covariance(model, theta, state.stated))
        state = replace(state, sizes=tuple(judge.together([every[key] for key in state.errors], ASKED)))
        problem = replace(state.problem, noise=_widened(state))
        state = replace(state, problem=problem, fit=problem.refit(theta, problem.noise, False))
    return state


def _widened(state: _State) -> Noise:
    """The stated noise with errors of the sizes found."""
    noise, model = state.stated, state.problem.model
    for (name, channel), u in zip(state.errors, state.sizes, strict=True):
        if name == "stated":
            noise = noise.times(math.sqrt(1.0 + u**2))
        elif name == "length":
            own = np.array([channel in (None, c.channel) for c in model.campaign.cables])
            noise = noise.with_lengths(np.where(own, u, 0.0))
        else:
            noise = noise.widened(0.0 if name == "rotation" else u, 0.0 if name == "position" else u / explanations.arm_mm(model))
    return noise


def _covered(state: _State, findings: list[Finding], before: float) -> Explained:
    """What is left unexplained goes into the covariance, and into the lengths."""
    problem, found = state.problem, state.fit
    known = problem.noise.u_length_mm
    u_length = np.maximum(np.zeros(len(problem.model.campaign.cables)) if known is None else known, state.doubt_mm)
    if improbable(found):
        excess = found.chi2 / found.freedom
        # as if each length were off on its own: what stands behind it is not known, and may be in every length that is measured later
        u = _evidence(state, found.V).best(explanations.every_length(problem.model))[0]
        u_length = np.hypot(u_length, u or _rms(found) * math.sqrt(1.0 - 1.0 / excess))
        found = replace(found, covariance=np.asarray(found.covariance * excess), excess=excess)
        if not any(w.code == "misfit" for w in findings):
            text = (
                f"residuals of {before:.3g} mm rms exceed the stated noise, and nothing explains them; the uncertainties are multiplied by "
                f"{math.sqrt(excess):.3g}, and {np.sqrt(np.mean(u_length**2)):.3g} mm of each length is carried into what is measured"
            )
            findings = [*findings, Finding(code="misfit", text=text, value=before)]
    return Explained(problem, found, findings, bool(state.errors) or found.excess > 1.0, u_length)


def _assumed(name: str) -> Finding:
    size, unit = (ASSUMED[name], "mm") if name == "position" else (math.degrees(ASSUMED[name]), "deg")
    text = (
        f"reference_poses.csv does not state how uncertain the {name}s are, and the residuals are too few to tell: {size:g} {unit} "
        f"(1 sigma per axis) is assumed; state it ({_OPTIONS[name]})"
    )
    return Finding(code=f"assumed_{name}", text=text, value=size)


def _estimated(state: _State, name: str) -> Finding:
    u = _size(state, name)
    size = f"{u:.2g} mm" if name == "position" else f"{math.degrees(u):.2g} deg"
    text = (
        f"reference_poses.csv does not state how uncertain the {name}s are: the residuals ask for {size} (1 sigma per axis), which is "
        f"taken; state it if it is known ({_OPTIONS[name]})"
    )
    return Finding(code=f"assumed_{name}", text=text, value=u if name == "position" else math.degrees(u))


def _size(state: _State, name: str, channel: str | None = None) -> float:
    """Of an error: [mm], a rotation in rad."""
    u = state.sizes[state.errors.index((name, channel))]
    return u / explanations.arm_mm(state.problem.model) if name == "rotation" else u


def _told(state: _State, begun: _State) -> list[Finding]:
    """What was taken, in words."""
    rms = f"residuals of {_rms(begun.fit):.3g} mm rms exceed the stated noise"
    out = []
    for group in state.groups:
        text = f"{rms}; errors of the {_VALUES[group]} explain them best and were solved for too (ask for it: --solve ...,{group})"
        out.append(Finding(code="misfit", text=text, value=_rms(begun.fit)))
    for name, channel in state.errors[len(begun.errors) :]:
        u = _size(state, name, channel)
        if not u:
            continue
        if name == "length":
            whose = "each cable" if channel is None else f"channel {channel}"
            text = (
                f"{rms}; lengths of {whose} that err by {u:.3g} mm on their own (run-out, eccentric pulleys, friction) explain them best, "
                "and the uncertainties of this rig and of what is measured with it include that"
            )
        elif name == "stated":
            text = f"{rms}; reference poses {math.sqrt(1 + u**2):.3g} times as uncertain as stated explain them best, and are taken so"
        else:
            turn = math.degrees(u / explanations.arm_mm(state.problem.model) if name == "pose" else u)
            sizes = {"position": f"{u:.3g} mm", "rotation": f"{turn:.3g} deg", "pose": f"{u:.3g} mm and {turn:.3g} deg"}[name]
            text = (
                f"{rms}; reference poses in error by {sizes} (1 sigma per axis) more than stated explain them best, and the uncertainties "
                f"include that; if it is so, state it ({_OPTIONS[name]})"
            )
        if (name, channel) != ("length", None) and state.doubt_mm:
            rival = f"Lengths of all cables that err by {state.doubt_mm:.3g} mm on their own explain nearly as much"
            text += f". {rival}, and are reckoned with"
        value = math.degrees(u) if name == "rotation" else u
        out.append(Finding(code="misfit", text=text, channel=channel, value=value))
    return out


_VALUES = {"scale": "drums' circumferences (scales)", "attachment": "attachment points", "radius": "pulleys' radii"}


def _contradictions(model: Model, found: Fit) -> list[Finding]:
    validation = Validation(model, found)
    tests: list[Suspect] = [*validation.outlier_poses()[:1], *validation.slipped_counters()[:1]]
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
