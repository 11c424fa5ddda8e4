"""Diagnosis of gross errors in a campaign's files or the rig's. Hypotheses compete, and certain ones are applied.

A hypothesis is another reading of the same files: a channel at another scale or sign, two swapped channels, a cable tied to another
attachment point, another angle convention, exchanged poses, or a pose, a reading or a counter that is wrong and is set aside. It is certain
if it raises the posterior by far, at any level of the noise. Then the campaign and the rig are corrected by it. Uncorrected faults and
gross residuals are reasons to refuse the rig.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy

from lmeasure.calibration.campaign.campaign import Campaign
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.calibration.validation.file_slips import Hypothesis, misread_poses, set_aside
from lmeasure.calibration.validation.hold_out import outlier_poses, outlier_readings, slipped_counters
from lmeasure.estimation import CHANCE, Fit, improbable
from lmeasure.rig import Cable, Finding, Rig
from lmeasure.text import message

Judge = Callable[[Campaign], Fit | None]
"""The best fit of all observation points to a campaign, with the prior on every direction; None where no cable could run so."""

SCALES = (0.25, 0.5, 2.0, 4.0)
"""Decoding slips that occur: quadrature edges counted once, twice or four times, a shifted bit."""

EVIDENCE = 16.0
"""Smallest gain in twice the log posterior that makes another hypothesis certain: odds of e^8."""

ALARM = 1e-4
"""Probability under which a misfit is no chance."""

SCREENED = 6
"""Hypotheses that are fitted in full, of those that a linear guess prefers."""

MOST_SLIPS = 3
"""Slips of one campaign that are found, one after another."""

GROSS_MM = 1.0
"""Residuals that no reference pose or rounding makes, but a slip of this kind does."""

AGREES = 3.0
"""Largest ratio of residuals to the stated noise after an applied hypothesis."""


@dataclass(frozen=True)
class Diagnosis:
    """The corrected campaign, the findings, and the reason to refuse a rig, if there is one."""

    campaign: Campaign
    findings: tuple[Finding, ...] = ()
    refused: str | None = None
    doubtful: bool = False
    """Whether counts, poses and the nominal rig still contradict each other."""


def gross(fit: Fit) -> bool:
    """Return whether a slip is likely: residuals of millimetres, or nominal values pulled far beyond their priors.

    fit has the prior on every direction. Prior and data together are chi-squared with one degree of freedom per equation.
    """
    if residual_rms(fit) > GROSS_MM and improbable(fit):
        return True
    return bool(scipy.stats.chi2.sf(fit.objective / max(1.0, fit.chi2 / max(fit.freedom, 1)), len(fit.residuals)) < ALARM)


def residual_rms(fit: Fit) -> float:
    """Return the root mean square of the residuals [mm]."""
    return float(np.sqrt(np.mean(fit.residuals**2)))


def contradicted(model: Model, fit: Fit) -> bool:
    """Return whether a pose, a reading or a counter contradicts all others beyond chance, whatever the noise level is."""
    tests = [*outlier_poses(model, fit), *outlier_readings(model, fit), *slipped_counters(model, fit)]
    return min((t.log_probability for t in tests), default=0.0) < np.log(CHANCE)


def diagnose(
    campaign: Campaign,
    judge: Judge,
    screen: Callable[[Campaign], float],
    stated: Fit,
    *,
    poses_known: bool,
    places_known: bool,
    aside: bool,
) -> Diagnosis:
    """Return the campaign corrected by all certain hypotheses, one after another.

    stated: its fit as it is. screen: a cheap guess of `Fit.objective`, by which the hypotheses that are worth a fit are chosen.
    poses_known: whether the reference poses are trusted, and may be misread; places_known: whether at least their positions are; aside:
    whether readings may be set aside.
    """
    findings: list[Finding] = []
    before_aside: tuple[Campaign, Fit, list[Finding]] | None = None
    points = list(dict.fromkeys(c.from_point for c in campaign.cables))
    for _ in range(MOST_SLIPS):
        model = stated.problem
        assert isinstance(model, Model)
        wrong = gross(stated) or not (places_known or _credible(stated))
        if not (wrong or (poses_known and improbable(stated) and contradicted(model, stated))):
            break
        whole = [*_swaps(campaign), *(h for name in points for h in _channels(campaign, name)), *_other_pass(campaign)]
        fitted = sorted(whole, key=lambda h: screen(h.campaign))[:SCREENED]
        if poses_known:
            fitted += sorted(misread_poses(campaign), key=lambda h: screen(h.campaign))[:SCREENED]
        if aside:
            fitted += set_aside(model, stated.theta, SCREENED)
        tested = [(h, fit) for h, fit in ((h, judge(h.campaign)) for h in fitted) if fit is not None]
        before = len(stated.residuals)
        best, fit = min(tested, key=lambda each: _loss(each[1], before, each[0]), default=(None, stated))
        if best is None:
            break
        gain = _loss(stated, before) - _loss(fit, before, best)
        if gain <= EVIDENCE:
            break
        if best.removed and before_aside is None:
            before_aside = campaign, stated, list(findings)
        findings.append(Finding(code=best.code, channel=best.channel, pose=best.pose, value=best.value, text=_text(best, gain)))
        if not best.curable:
            return Diagnosis(campaign, tuple(findings), message("calibration.correct_calibrate_again", what=best.text))
        campaign, stated = best.campaign, fit
    if before_aside is not None and (not _explains(stated) or _repeated(findings[len(before_aside[2]) :])):
        # excluded readings do not explain everything, or concentrate in one channel: then single numbers are not the cause
        campaign, stated, findings = before_aside
    if findings and not _agrees(stated):
        named = tuple(f.channel or f.pose or f.code for f in findings)
        why = message("calibration.left_after_cures", rms=residual_rms(stated), named=named)
        return Diagnosis(campaign, tuple(findings), why)
    return Diagnosis(campaign, tuple(findings), doubtful=gross(stated))


def _text(h: Hypothesis, gain: float) -> str:
    cure = "aside" if h.code == "outlier" else "applied" if h.curable else "not_applied"
    return message(f"calibration.cure.{cure}", what=h.text, gain=gain)


def _agrees(fit: Fit) -> bool:
    """Return whether no gross misfit is left."""
    return residual_rms(fit) <= GROSS_MM or not improbable(fit) or fit.chi2 <= AGREES**2 * max(fit.freedom, 1)


def _explains(fit: Fit) -> bool:
    """Return whether the rejected readings explain all: the rest agrees with the noise, or at least with itself."""
    model = fit.problem
    assert isinstance(model, Model)
    return not gross(fit) and (not improbable(fit) or not contradicted(model, fit))


def _repeated(findings: list[Finding]) -> bool:
    """Return whether several findings set numbers of one channel aside: its part follows a law of its own, as a drum with run-out does."""
    channels = [f.channel for f in findings if f.code in ("outlier", "slip") and f.channel is not None]
    return len(set(channels)) < len(channels)


def _credible(fit: Fit) -> bool:
    """Return whether counts and priors alone explain the misfit: prior and data together are chi-squared, one degree of freedom per
    equation that the poses leave."""
    freedom = len(fit.residuals) - (len(fit.theta) - len(fit.s))
    return bool(scipy.stats.chi2.sf(fit.objective, freedom) >= ALARM)


def _loss(fit: Fit, equations: int, h: Hypothesis | None = None) -> float:
    """Return twice the negative log posterior at the likeliest noise level, at least the stated one. Rejected readings are noise of their
    own, and cost two each: one of chance, one for another number taken from the data."""
    nuisances = len(fit.theta) - len(fit.s)
    level = max(1.0, fit.objective / max(len(fit.residuals) - nuisances, 1))
    return (equations - nuisances) * float(np.log(level)) + fit.objective / level + (0.0 if h is None else 2.0 * h.removed)


def _swaps(campaign: Campaign) -> Iterator[Hypothesis]:
    for i, j in combinations(range(len(campaign.cables)), 2):
        a, b = campaign.cables[i], campaign.cables[j]
        # a drum's counts and an encoder's codes are nothing alike
        if a.passage != b.passage or a.kind != b.kind:
            continue
        counts, unit = campaign.counts.copy(), [campaign.rig.counter(c).count_sign / campaign.rig.counter(c).scale for c in (a, b)]
        counts[:, [i, j]] = counts[:, [j, i]] * np.array([unit[0] / unit[1], unit[1] / unit[0]])
        text = message("calibration.channels_counts_fit_when", a=a.channel, b=b.channel)
        curable = a.is_cable
        other = replace(campaign, counts=counts)
        if curable:
            own, to = [c for c in campaign.rig.cable if c.passage == a.passage], {a.channel: b.channel, b.channel: a.channel}
            other = _with_cables(other, {c.name: {"channel": to[c.channel]} for c in own if c.channel in to})
        yield Hypothesis("swapped", text, other, a.channel, curable=curable)


def _channels(campaign: Campaign, point: str) -> Iterator[Hypothesis]:
    for c in campaign.cables:
        if c.from_point != point:
            continue
        # codes that are modulo a revolution have no other scale
        drawn = c.is_cable
        for factor in (*SCALES, -1.0, *(-s for s in SCALES)) if drawn else (-1.0,):
            counts = campaign.counts.copy()
            own = [k for k, each in enumerate(campaign.cables) if each.channel == c.channel]
            counts[:, own] /= factor
            read = "scale" if factor > 0 else "sign" if factor == -1 else "sign_scale"
            text = message(f"calibration.decoded.{read}", channel=c.channel, factor=abs(factor))
            rig = _decoded(campaign.rig, point, factor) if drawn else _reversed(campaign.rig, c.channel)
            other = replace(campaign, counts=counts, rig=rig)
            yield Hypothesis("scale" if factor > 0 else "sign", text, other, c.channel, value=factor)
        for other_point in campaign.rig.tool:
            if c.is_cable and other_point != c.to_point:
                tied = _with_cables(campaign, {c.name: {"to_point": other_point}})
                text = message("calibration.channel_counts_fit_when", channel=c.channel, cable=c.name, other=other_point, own=c.to_point)
                yield Hypothesis("attachment", text, tied, c.channel)


def _other_pass(campaign: Campaign) -> Iterator[Hypothesis]:
    """Yield the campaign as one of another pass, whose cables use the same channels."""
    own = {c.passage for c in campaign.cables}
    for passage in sorted({c.passage for c in campaign.rig.cable} - own) if len(own) == 1 else ():
        there = {c.channel: c for c in campaign.rig.cable if c.passage == passage}
        if all(c.channel in there for c in campaign.cables) and len(there) == len(campaign.cables):
            cables = tuple(there[c.channel] for c in campaign.cables)
            text = message("calibration.counts_fit_when_they", other=passage, own=min(own))
            yield Hypothesis("pass", text, replace(campaign, cables=cables))


def _decoded(rig: Rig, point: str, factor: float) -> Rig:
    """Return the rig whose counts of one drum mean 1/factor of their present length."""
    points = []
    for p in rig.observation_point:
        if p.name == point:
            sign = p.drum.count_sign if factor > 0 else -p.drum.count_sign
            p = p.model_copy(update={"drum": p.drum.model_copy(update={"count_sign": sign, "scale": p.drum.scale * abs(factor)})})
        points.append(p)
    return rig.model_copy(update={"observation_point": tuple(points)})


def _reversed(rig: Rig, channel: str) -> Rig:
    """Return the rig whose sensor of a channel counts the other way."""
    return rig.with_sensors(lambda sensor: {"count_sign": -sensor.count_sign} if sensor.channel == channel else {})


def _with_cables(campaign: Campaign, changes: dict[str, dict[str, str]]) -> Campaign:
    """Return the campaign with cables changed, by their names, in the rig too."""

    def new(c: Cable) -> Cable:
        return c.model_copy(update=changes.get(c.name, {}))

    rig = campaign.rig.model_copy(update={"cable": tuple(map(new, campaign.rig.cable))})
    return replace(campaign, cables=tuple(new(c) if isinstance(c, Cable) else c for c in campaign.cables), rig=rig)
