"""Which physical effect would explain what is left of a calibration's residuals, each by its own law, and how seldom chance looks like it.

    run-out of a drum         a cos(2 pi k/N) + b sin(2 pi k/N) of its lengths                        (`observation.cable_effects`)
    eccentric pulley          two components of its groove's way off the axle                         (likewise)
    drum's diameter, pitch    derivatives by the length of a count and by the groove's pitch; another cable's diameter is the first
    pulley's radius           derivative by it
    swivel axis off the groove's tangent by d    -d sin phi of its lengths                            (`observation.parts`)
    play, friction            -s w of its lengths, s the sign of the last travel, and a constant for where the counter was zeroed
    eccentric encoder         a cos(theta) + b sin(theta) of its angles
    groove beside the axis    the pulley's plane runs beside its swivel axis by d: the cable pulls it to where the span's line meets the
                              axis, as a castor whose trail is R (1 - cos phi), and the encoder is off by d/(R (1 - cos phi))
    encoder's axis tilted     the encoder turns about another axis than the pulley: alpha and beta of the encoder's own

Each is one to two columns that may be added to the residuals; what they would take of chi-squared, against what the rest leaves, is an F
test (`estimation.deletion`), whose probability is multiplied by the number of effects tried (Bonferroni): under `CHANCE` one is named,
which a campaign without any does by chance no more often. Those that come within odds of a hundred of it are named with it. Then the rest
are tried again on what it leaves, and so on. Nothing is corrected. How large an effect must be to be named follows from the noncentral F
distribution.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.optimize
import scipy.stats

from lmeasure.arrays import FloatArray
from lmeasure.calibration.frame import model_of
from lmeasure.calibration.unknowns import Model
from lmeasure.calibration_record import Finding, ShownEffect
from lmeasure.effects import Zero
from lmeasure.estimation import Fit, Parameters, fit
from lmeasure.estimation.deletion import MIN_FREEDOM, Deletion, Remainder
from lmeasure.kernels import cable as cable_kernels
from lmeasure.kernels.layout import BASE_XYZ, BY_ALPHA, BY_BETA, BY_PITCH, BY_RADIUS, BY_SCALE, COUNT_LENGTH, GUIDE_XYZ
from lmeasure.observation.cable_effects import ECCENTRICITY, OFFSET, RUN_OUT
from lmeasure.observation.parameters import solved_parameters
from lmeasure.observation.wrap import arms, span
from lmeasure.rig import Cable, Turned
from lmeasure.unsolved import Unsolved, Variable

CHANCE = 0.01
NEAR = math.log(100.0)
POWER = 0.8
MOST = 8
"""Effects that are named of one campaign: more is no matter of single parts."""
LEAST_TRAIL = 0.02
"""Of the radius: a pulley around which hardly any cable goes is turned by next to nothing."""
ASK = {RUN_OUT.key: "run-out", ECCENTRICITY.key: "eccentricity", OFFSET.key: "offset"}
"""What `--solve` calls it."""


@dataclass(frozen=True)
class Effect:
    """kind: what it is; channel: of which channel; columns (e, c): what one unit of each component adds to the residuals; unit, and the
    size of one in it; key: by which rig.toml states or solves it, empty where it has none."""

    kind: str
    channel: str
    columns: FloatArray
    unit: str
    per_unit: float
    key: str
    sized: int | None = None
    """How many of the components are its size; None: all."""


def named_effects(model: Model, found: Fit) -> tuple[list[Finding], tuple[ShownEffect, ...]]:
    """The effects that a fit's residuals ask for, in words, one after the other, each with those that are not told apart from it; and how
    large each effect must be to be named with `POWER`."""
    deletion, tried = Deletion(found), list(effects(model, found.theta))
    shown = tuple(s for effect in tried if (s := _shown(deletion, effect, len(tried))))
    out: list[Finding] = []
    unsolved: list[Effect] = []
    while len(out) < MOST:
        judged = sorted(tested(deletion, tried), key=lambda pair: pair[0])
        best = judged[0][0] + math.log(len(judged)) if judged else 0.0
        if best > math.log(CHANCE) or not judged:
            break
        near = [effect for log_p, effect in judged if log_p <= judged[0][0] + NEAR]
        said = [f"{effect.kind} of {effect.channel} ({size_of(deletion, effect):.2g} {effect.unit})" for effect in near[:4]]
        text = (
            f"what is left of the residuals follows the law of {', '.join(said)}: p = {math.exp(best):.2g} for chance, with {len(judged)} "
            "effects tried; nothing was corrected"
        )
        solvable = ":" in near[0].key
        if near[0].key:
            text += f"; look at it, or --solve {near[0].key}" if solvable else f"; state {near[0].key}"
        out.append(Finding(code="effect", channel=near[0].channel, text=text, value=math.exp(best)))
        # the next is looked for in what this one leaves: solved for where it can be, for a large one bends the fit
        if solvable:
            model, found = _with(model, found, near[0].key)
        else:
            unsolved.append(near[0])
        deletion, gone = Deletion(found), {(effect.kind, effect.channel) for effect in unsolved}
        for effect in unsolved:
            deletion = deletion.freed(effect.columns)
        tried = [effect for effect in effects(model, found.theta) if (effect.kind, effect.channel) not in gone]
    return out, shown


def _with(model: Model, found: Fit, solve: str) -> tuple[Model, Fit]:
    """The fit that solves for something more."""
    known, campaign = model.parameters, model.campaign
    more = [p for p in solved_parameters(campaign.rig, campaign.cables, (solve,)) if p.name not in known.names]
    nominal = np.array([p.value for p in more])
    wider = Parameters(
        (*known.names, *(p.name for p in more)), np.r_[known.nominal, nominal], np.r_[known.width, [p.prior_u for p in more]]
    )
    wide = model_of(campaign, wider, tuple(model.free.tolist()), model.frame).with_noise(model.noise)
    start = np.r_[found.theta[: model.own], nominal, found.theta[model.own :]]
    return wide, fit(wide, start, prior_everywhere=found.prior_everywhere)


def tested(left: Remainder, tried: list[Effect]) -> Iterator[tuple[float, Effect]]:
    """Logarithms of the probabilities that chance takes as much of chi-squared."""
    for effect in tried:
        judged = left.added(effect.columns)
        test = left.test(judged.square, judged.freedom) if judged else None
        if test:
            yield test[1], effect


def _shown(deletion: Deletion, effect: Effect, tried: int) -> ShownEffect | None:
    """The size at which the F test passes `CHANCE` with `POWER`, the mean over its components' directions; None where nothing tells it."""
    judged, left = deletion.added(effect.columns), deletion.freedom
    if judged is None or left - judged.freedom < MIN_FREEDOM:
        return None
    information = deletion.information(effect.columns)
    q = len(information) if effect.sized is None else effect.sized
    # what the components that are no size could make up for tells nothing
    mixed, others = information[:q, q:], information[q:, q:]
    information = information[:q, :q] - mixed @ np.linalg.pinv(others, hermitian=True) @ mixed.T
    mean = float(np.trace(information)) / q
    if not mean > 0.0:
        return None
    law = judged.freedom, left - judged.freedom
    limit = scipy.stats.f.isf(CHANCE / tried, *law)
    needed = scipy.optimize.brentq(lambda x: scipy.stats.ncf.sf(limit, *law, x) - POWER, 1e-3, 1e5)
    return ShownEffect(effect=effect.kind, channel=effect.channel, size=math.sqrt(needed / mean) * effect.per_unit, unit=effect.unit)


def effects(model: Model, theta: FloatArray, travel: FloatArray | None = None) -> Iterator[Effect]:
    """Those that are neither solved nor stated in the rig; travel (n, m): as `Campaign.travel` has it, which it replaces."""
    campaign, names = model.campaign, set(model.parameters.names)
    rows, scales, counts = model.cables(theta)
    poses, drums = model.poses(theta), campaign.drums
    at = model.pose_index, model.cable_index
    per_unit = campaign.mm_per_unit
    g = model.since_zero(cable_kernels.length_gradients(rows, poses, counts, scales) * per_unit[:, None])
    m, zero = len(drums), campaign.zero[: len(drums)]
    travel = campaign.travel if travel is None else travel
    begun = Zero(poses[zero], counts[zero, np.arange(m)], np.zeros(m))
    own_counts = np.ascontiguousarray(counts[:, :m])
    for j, c in enumerate(campaign.cables):
        mine = model.cable_index == j
        if isinstance(c, Cable):
            point = campaign.rig.point(c.from_point)
            for kind, said, holder in (
                (RUN_OUT, "run-out of the drum", point.drum),
                (ECCENTRICITY, "an eccentric pulley", point),
                (OFFSET, "a swivel axis off its groove", point),
            ):
                variable = Variable(kind, point.name, 1.0)
                if getattr(holder, kind.key) is not None or variable.names[0] in names:
                    continue
                if kind is RUN_OUT or point.pulley_radius_mm > 0.0:
                    shifts = Unsolved(campaign.rig, [variable], drums).shifts(rows[:m], begun, poses, own_counts)
                    columns = np.where(mine[:, None], shifts[at[0], np.minimum(at[1], m - 1)], 0.0)
                    yield Effect(said, c.channel, columns, "mm", 1.0, f"{ASK[kind.key]}:{point.name}")
            if f"{c.from_point}.backlash_counts" not in names and point.drum.u_backlash_counts is None:
                way = np.where(mine, -travel[at] * rows[j, COUNT_LENGTH] / scales[j], 0.0)
                yield Effect(
                    "play", c.channel, np.column_stack([way, mine.astype(np.float64)]), "counts", 1.0, f"backlash:{c.from_point}", 1
                )
            solvable = (
                (BY_SCALE, "scale", "a drum of another diameter", "%", 100.0, "scale"),
                (BY_PITCH, "groove_pitch_mm", "another groove pitch", "mm", 1.0, "pitch"),
                (BY_RADIUS, "pulley_radius_mm", "another pulley radius", "mm", 1.0, "radius"),
            )
            for column, key, said, unit, size, ask in solvable:
                if f"{c.from_point}.{key}" not in names:
                    yield Effect(said, c.channel, np.where(mine, g[:, column], 0.0)[:, None], unit, size, f"{ask}:{c.from_point}")
        elif isinstance(c, Turned) and c.from_point:
            way = poses[:, :3] + arms(rows[j : j + 1], poses)[:, 0] - rows[j, BASE_XYZ]
            radius = campaign.rig.point(c.from_point).pulley_radius_mm
            trail = radius * (1.0 - span(way, rows[j, GUIDE_XYZ], radius).cosine)
            angle = counts[:, j] * campaign.rig.counter(c).per_count
            seen = np.column_stack([np.cos(angle), np.sin(angle)]) * per_unit[j]
            yield Effect("an eccentric encoder", c.channel, _of(model, seen, j), "deg", math.degrees(1.0), "eccentricity_deg")
            if radius > 0.0 and trail.min() > LEAST_TRAIL * radius:
                beside = (per_unit[j] / trail)[:, None]
                yield Effect("a groove beside its swivel axis", c.channel, _of(model, beside, j), "mm", 1.0, "")
            tilt = np.where(mine[:, None], g[:, [BY_ALPHA, BY_BETA]], 0.0)
            yield Effect("an encoder with a tilted axis", c.channel, tilt, "deg", math.degrees(1.0), "")


def _of(model: Model, values: FloatArray, j: int) -> FloatArray:
    """(e, c) of a channel's residuals from values (n, c) at the poses, since its zero pose where it counts from there."""
    every = np.zeros((len(values), len(model.campaign.cables), values.shape[1]))
    every[:, j] = values
    return model.since_zero(every)


def size_of(left: Remainder, effect: Effect) -> float:
    """How large it would be, in its unit: the length of its components, all together."""
    return float(np.linalg.norm(left.sizes(effect.columns)[: effect.sized])) * effect.per_unit
