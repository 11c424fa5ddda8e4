"""Is something wrong with the data? Each suspicion is a hypothesis with its evidence, never a repair.

A hypothesis is another reading of the same files: a channel decoded at another scale or sign, two channels swapped, a cable tied to another
attachment point, another angle convention. It is named when it raises the posterior of the points it concerns by far.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
import scipy.stats
from scipy.spatial.transform import Rotation

from lmeasure import conventions, se3
from lmeasure.calibration.campaign import Campaign
from lmeasure.calibration_record import Finding
from lmeasure.estimation import Fit
from lmeasure.rig import Cable

Judge = Callable[[Campaign, str], Fit]
"""The best fit of one observation point to a campaign, with the prior on every direction."""

SCALES = (0.25, 0.5, 2.0, 4.0)
"""Decoding slips that occur: quadrature edges counted once, twice or four times, a shifted bit."""

EVIDENCE = 16.0
"""Smallest gain in twice the log posterior that names another hypothesis: odds of e^8."""

ALARM = 1e-4
"""Probability under which a misfit is no chance."""

SCREENED = 6
"""Hypotheses that are fitted in full, of those that a linear guess prefers."""

MOST_SLIPS = 3
"""Slips of one campaign that are named where all are judged together."""

GROSS_MM = 1.0
"""Residuals that no reference pose or rounding makes, but a slip of this kind does."""


@dataclass(frozen=True)
class Hypothesis:
    """Another reading of the campaign: code and text of its finding, the observation points it concerns, the campaign as it would be."""

    code: str
    text: str
    points: tuple[str, ...]
    campaign: Campaign
    channel: str | None = None
    value: float | None = None


def gross(fit: Fit) -> bool:
    """Whether a slip is worth asking for: residuals of millimetres, or nominal values pulled far beyond their priors.

    fit has the prior on every direction. Prior and data together are chi-squared with one degree of freedom per equation.
    """
    if float(np.sqrt(np.mean(fit.residuals**2))) > GROSS_MM:
        return True
    return bool(scipy.stats.chi2.sf(fit.objective / _noise([fit]), len(fit.residuals)) < ALARM)


def diagnose(campaign: Campaign, stated: dict[str, Fit], judge: Judge) -> list[Finding]:
    """Findings about the channels and the pose file that explain gross misfits; stated are the points' fits to the campaign as it is."""
    suspects = [name for name, fit in stated.items() if gross(fit)]
    if not suspects:
        return []
    findings: list[Finding] = []
    explained: set[str] = set()
    # what explains everything at once goes before what explains a channel
    for hypotheses in (_conventions(campaign, suspects, list(stated)), _swaps(campaign, suspects)):
        tested = sorted(((_gain(stated, h, judge), h) for h in hypotheses if not explained & set(h.points)), key=lambda pair: -pair[0])
        for gain, h in tested:
            if gain > EVIDENCE and not explained & set(h.points):
                findings.append(_finding(h, gain))
                explained |= set(h.points)
    for name in suspects:
        if name in explained:
            continue
        gain, best = max(((_gain(stated, h, judge), h) for h in _channels(campaign, name)), key=lambda pair: pair[0])
        if gain > EVIDENCE:
            findings.append(_finding(best, gain))
    return findings


def diagnose_together(
    campaign: Campaign, stated: Fit, judge: Callable[[Campaign], Fit], screen: Callable[[Campaign], float], *, places_known: bool
) -> list[Finding]:
    """`diagnose` where points cannot be judged one by one, because the poses are unknown: one slip after another, each judged by the fit of
    everything. screen: a cheap guess of `Fit.objective`, by which the hypotheses that are worth a fit are chosen. places_known: whether
    stated positions may be to blame for residuals. Poses' angles take no part: they are not known, or not trusted."""
    points = list(dict.fromkeys(c.from_point for c in campaign.cables))
    findings: list[Finding] = []
    while (gross(stated) or not (places_known or _credible(stated))) and len(findings) < MOST_SLIPS:
        hypotheses = [*_swaps(campaign, points), *(h for name in points for h in _channels(campaign, name))]
        best = sorted(hypotheses, key=lambda h: screen(h.campaign))[:SCREENED]
        tested = [(h, fit, (stated.objective - fit.objective) / _noise([fit])) for h, fit in ((h, judge(h.campaign)) for h in best)]
        h, fit, gain = max(tested, key=lambda each: each[2])
        if gain <= EVIDENCE:
            break
        findings.append(_finding(h, gain))
        campaign, stated = h.campaign, fit
    return findings


def _credible(fit: Fit) -> bool:
    """Whether counts and priors alone may have made the misfit: prior and data together are chi-squared, one degree of freedom per equation
    that the poses leave over."""
    freedom = len(fit.residuals) - (len(fit.theta) - len(fit.s))
    return bool(scipy.stats.chi2.sf(fit.objective, freedom) >= ALARM)


def _finding(h: Hypothesis, gain: float) -> Finding:
    text = f"{h.text}; nothing was repaired (evidence {gain:.3g} in twice the log odds)"
    return Finding(code=h.code, channel=h.channel, value=h.value, text=text)


def _noise(fits: list[Fit]) -> float:
    """Variance of the residuals in units of the stated one, at least 1."""
    freedom = sum(f.freedom for f in fits)
    return max(1.0, sum(f.chi2 for f in fits) / max(freedom, 1))


def _gain(stated: dict[str, Fit], h: Hypothesis, judge: Judge) -> float:
    """How much better a hypothesis explains the data of its points, in units of its own noise."""
    others = [judge(h.campaign, name) for name in h.points]
    return (sum(stated[name].objective for name in h.points) - sum(f.objective for f in others)) / _noise(others)


def _conventions(campaign: Campaign, suspects: list[str], points: list[str]) -> Iterator[Hypothesis]:
    if set(suspects) != set(points):
        return
    own = campaign.rig.angles
    angles = conventions.angles_from_rotation(own, campaign.poses.rotation)
    for name, other in conventions.CONVENTIONS.items():
        if name == own or other.axes == "rotvec" or conventions.convention(own).axes == "rotvec":
            continue
        rotation: Rotation = conventions.rotation_from_angles(name, angles)
        rows = se3.pose(campaign.poses.rows[:, :3], rotation)
        poses = replace(campaign.poses, rows=rows)
        text = f"the reference poses fit when their angles are read as {name}, not as the rig's {own}"
        yield Hypothesis("angles", text, tuple(points), replace(campaign, poses=poses))


def _swaps(campaign: Campaign, suspects: list[str]) -> Iterator[Hypothesis]:
    cables = [j for j, c in enumerate(campaign.cables) if c.from_point in suspects]
    for i, j in combinations(cables, 2):
        a, b = campaign.cables[i], campaign.cables[j]
        # a drum's counts and an encoder's codes are nothing alike
        if a.passage != b.passage or isinstance(a, Cable) != isinstance(b, Cable):
            continue
        counts = campaign.counts.copy()
        counts[:, [i, j]] = counts[:, [j, i]]
        text = f"channels {a.channel} and {b.channel}: the counts fit when the two are swapped"
        points = tuple(dict.fromkeys((a.from_point, b.from_point)))
        yield Hypothesis("swapped", text, points, replace(campaign, counts=counts), a.channel)


def _channels(campaign: Campaign, point: str) -> Iterator[Hypothesis]:
    for j, c in enumerate(campaign.cables):
        if c.from_point != point:
            continue
        # codes that are modulo a revolution have no other scale
        drawn = isinstance(c, Cable)
        for factor in (*SCALES, -1.0, *(-s for s in SCALES)) if drawn else (-1.0,):
            counts = campaign.counts.copy()
            counts[:, j] /= factor
            read = f"at scale {factor:g}, not at the rig's" if factor > 0 else "with the other sign"
            read += f" and scale {-factor:g}" if factor < 0 and factor != -1 else ""
            text = f"channel {c.channel}: its counts fit when it is decoded {read}"
            yield Hypothesis("scale" if factor > 0 else "sign", text, (point,), replace(campaign, counts=counts), c.channel, factor)
        for other in campaign.rig.tool:
            if isinstance(c, Cable) and other != c.to_point:
                cables = list(campaign.cables)
                cables[j] = c.model_copy(update={"to_point": other})
                text = f"channel {c.channel}: its counts fit when cable {c.name} is tied to {other}, not to {c.to_point}"
                yield Hypothesis("attachment", text, (point,), replace(campaign, cables=tuple(cables)), c.channel)
