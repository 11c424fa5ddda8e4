"""Physical effects that explain the rest of a calibration's residuals, each by its own law, with the probability of chance.

    run-out of a drum         a cos(2 pi k/N) + b sin(2 pi k/N) of its lengths                        (`sensors.imperfect_parts`)
    eccentric pulley          two components of its groove's distance from the axle                         (likewise)
    drum's diameter, pitch    derivatives by the length of a count and by the groove's pitch; another cable's diameter is the first
    pulley's radius           derivative by it
    swivel axis off the groove's tangent by d    -d sin phi of its lengths                            (`sensors.imperfect_parts`)
    play, friction            -s w of its lengths, s the sign of the last travel, and a constant for where the counter was zeroed
    eccentric encoder         a cos(theta) + b sin(theta) of its angles
    groove beside the axis    the pulley's plane runs beside its swivel axis by d: the cable pulls it to where the span's line meets the
                              axis, as a castor whose trail is R (1 - cos phi), and the encoder is off by d/(R (1 - cos phi))
    encoder's axis tilted     the encoder turns about another axis than the pulley: alpha and beta of the encoder's own

Each is one or two columns that may be added to the residuals. Their part of chi-squared, compared with the rest, is an F test
(`estimation.deletion`). Its probability is multiplied by the number of effects tried (Bonferroni). An effect is named if that is under
`CHANCE`, the rate of false names in a campaign without any. Effects within odds of a hundred of it are named with it: each is solved for,
as a large one bends the fit, and those near the best stay. The others are tried again on the residuals of the best, and so on. In the end
the alternatives of each are tried beside all others. If one law may replace either of two, one finding names both. Nothing is corrected.
The size at which an effect is named follows from the noncentral F distribution.
"""

import math
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy

from lmeasure.calibration.solve.frame import model_of
from lmeasure.calibration.solve.unknowns import Model
from lmeasure.core import FloatArray, LMeasureError
from lmeasure.estimation import MIN_FREEDOM, Deletion, Fit, Parameters, Remainder, fall_test, fit
from lmeasure.kernels import BASE_XYZ, BY_ALPHA, BY_BETA, BY_PITCH, BY_RADIUS, BY_SCALE, COUNT_LENGTH, GUIDE_XYZ, length_gradients
from lmeasure.rig import Finding, ShownEffect, solved_parameters
from lmeasure.sensors import BACKLASH, ECCENTRICITY, OFFSET, RUN_OUT, Unsolved, Variable, Zero, arms, span
from lmeasure.text import joined, message

CHANCE = 0.01
NEAR = math.log(100.0)
POWER = 0.8
MOST = 8
"""Effects that are named of one campaign: more is no matter of single parts."""
LEAST_TRAIL = 0.02
"""Smallest part of the radius: a pulley that hardly touches its cable is turned by next to nothing."""
ASK = {RUN_OUT.key: "run-out", ECCENTRICITY.key: "eccentricity", OFFSET.key: "offset"}
"""Name for `--solve`."""


@dataclass(frozen=True)
class Effect:
    """Effect on a channel. kind: its law; columns (e, c): the residuals' change by one unit of each component; unit, and the size of one in
    it; key: the key of rig.toml that states or solves it, empty without one."""

    kind: str
    channel: str
    columns: FloatArray
    unit: str
    per_unit: float
    key: str
    sized: int | None = None
    """Number of components that are its size; None: all."""

    @property
    def law(self) -> tuple[str, str]:
        """Return the part of the law that differs from others."""
        return self.kind, self.channel


@dataclass(frozen=True)
class _Fitted:
    """A fit that takes some effects: those that can be solved for as unknowns of its own, the others by their columns."""

    model: Model
    found: Fit
    by_columns: tuple[Effect, ...] = ()

    @cached_property
    def left(self) -> Remainder:
        """Return the residuals without it."""
        left: Remainder = Deletion(self.found)
        for effect in self.by_columns:
            left = left.freed(effect.columns)
        return left

    @cached_property
    def tried(self) -> list[Effect]:
        """Effects that it does not take."""
        gone = {effect.law for effect in self.by_columns}
        return [effect for effect in effects(self.model, self.found.theta) if effect.law not in gone]

    def taking(self, *more: Effect) -> "_Fitted":
        """The same with more: solved for where they can be, for a large one bends the fit."""
        keys = tuple(effect.key for effect in more if ":" in effect.key)
        if keys:
            with suppress(LMeasureError):  # so large a one that a cable could not run
                others = tuple(effect for effect in more if ":" not in effect.key)
                return _Fitted(*_with(self.model, self.found, keys), (*self.by_columns, *others))
        return _Fitted(self.model, self.found, (*self.by_columns, *more))


@dataclass(frozen=True)
class _Named:
    """Effects that are followed together, each with log_p of chance among so many; laws: the names of all that are not distinguished, those
    followed first."""

    followed: tuple[tuple[Effect, float, int], ...]
    laws: dict[tuple[str, str], str]

    @property
    def best(self) -> Effect:
        """The first that is followed."""
        return self.followed[0][0]

    def joined(self, later: "_Named") -> "_Named":
        """Return both as one, if another law may replace either."""
        followed = (*self.followed, *later.followed)
        known = self.laws | later.laws
        first = [effect.law for effect, _, _ in followed]
        return _Named(followed, {law: known[law] for law in dict.fromkeys([*first, *known])})

    @property
    def finding(self) -> Finding:
        (_, log_p, tried), count = self.followed[0], len(self.followed)
        code = f"physical.left.{'one' if count == 1 else 'several'}{'_apart' if len(self.laws) > count else ''}"
        parts = [message(code, k=count, laws=tuple(self.laws.values()), p=math.exp(log_p), n=tried)]
        keys = [effect.key for effect, _, _ in self.followed]
        solved, stated = ([key for key in keys if key and (":" in key) is solvable] for solvable in (True, False))
        if solved:
            parts.append(message(f"physical.look_at_{'it' if count == 1 else 'them'}", key=",".join(solved)))
        parts += [message("physical.state", key=key) for key in dict.fromkeys(stated)]
        return Finding(code="effect", channel=self.best.channel, text=joined(parts), value=math.exp(log_p))


def named_effects(model: Model, found: Fit) -> tuple[list[Finding], tuple[ShownEffect, ...]]:
    """The effects that a fit's residuals ask for, in words, each with those that are not distinguished from it; and how large each effect
    must be to be named with `POWER`."""
    begun = _Fitted(model, found)
    shown = tuple(s for effect in begun.tried if (s := _shown(begun.left, effect, len(begun.tried))))
    named: list[_Named] = []
    at = begun
    while len(named) < MOST and (pair := _asked(at)) is not None:
        # the next one is searched in the remaining residuals
        one, at = pair
        named.append(one)
    out: list[_Named] = []
    for one in _beside_the_others(begun, named) if len(named) > 1 else named:
        group = one
        for other in [g for g in out if g.laws.keys() & group.laws.keys()]:
            out.remove(other)
            group = other.joined(group)
        out.append(group)
    return [one.finding for one in out], shown


def _asked(at: _Fitted) -> tuple[_Named, _Fitted] | None:
    """Return the effect that explains most of the residuals, and the fit with it; None if chance may explain all."""
    judged = sorted(tested(at.left, at.tried), key=lambda pair: pair[0])
    log_p = judged[0][0] + math.log(len(judged)) if judged else 0.0
    if log_p > math.log(CHANCE) or not judged:
        return None
    near, wider = _competed(at, [effect for each, effect in judged if each <= judged[0][0] + NEAR])
    laws: dict[tuple[str, str], str] = {
        e.law: message("physical.of", kind=e.kind, channel=e.channel, size=size_of(at.left, e), unit=message(f"unit_sign.{e.unit}"))
        for e in near
    }
    return _Named(((near[0], log_p, len(judged)),), laws), wider


def _beside_the_others(begun: _Fitted, named: list[_Named]) -> list[_Named]:
    """Return the alternatives of each effect beside all others: the second may be an alternative of the first, or both may be the others
    together."""
    others = [one.best for one in named]
    i, out = 0, list[_Named]()
    while i < len(others):
        pair = _asked(begun.taking(*others[:i], *others[i + 1 :]))
        if pair is None or pair[0].best.law in [one.best.law for one in out]:
            # no effect, or one that another already represents
            del others[i]
            i, out = 0, []
            continue
        out.append(pair[0])
        i += 1
    return out


def _competed(at: _Fitted, near: list[Effect]) -> tuple[list[Effect], _Fitted]:
    """Return, of effects that come near to each other by their columns those that still do when each is taken, the best first, and the fit
    that takes the best: a large effect bends the fit, and its column alone may look more like another's."""
    fits = [at.taking(effect) for effect in near]
    if len(near) == 1:
        return near, fits[0]
    log_p = []
    for fitted in fits:
        left, bought = fitted.left, at.left.freedom - fitted.left.freedom
        test = fall_test(at.left.chi_squared - left.chi_squared, bought, left.chi_squared, left.freedom) if bought > 0 else None
        log_p.append(test[1] if test else 0.0)
    order = sorted(range(len(near)), key=log_p.__getitem__)
    return [near[i] for i in order if log_p[i] <= log_p[order[0]] + NEAR], fits[order[0]]


def _with(model: Model, found: Fit, solve: tuple[str, ...]) -> tuple[Model, Fit]:
    """The fit that solves for something more."""
    known, campaign = model.parameters, model.campaign
    more = [p for p in solved_parameters(campaign.rig, campaign.cables, solve) if p.name not in known.names]
    nominal = np.array([p.value for p in more])
    wider = Parameters(
        (*known.names, *(p.name for p in more)), np.r_[known.nominal, nominal], np.r_[known.width, [p.prior_u for p in more]]
    )
    wide = model_of(campaign, wider, tuple(model.free.tolist()), model.frame).with_noise(model.noise).with_sizes(model.sizes)
    near = fit(wide, np.r_[found.theta[: model.own], nominal, found.theta[model.own :]], prior_everywhere=found.prior_everywhere)
    if scipy.stats.chi2.sf(near.chi2, max(near.freedom, 1)) > CHANCE:
        return wide, near
    # parameters that absorbed the effect may be at another optimum, so start again
    afresh = fit(wide, wide.start, prior_everywhere=found.prior_everywhere)
    return wide, min(near, afresh, key=lambda one: one.chi2)


def tested(left: Remainder, tried: list[Effect]) -> Iterator[tuple[float, Effect]]:
    """Logarithms of the probabilities that chance takes as much of chi-squared."""
    for effect in tried:
        judged = left.added(effect.columns)
        test = left.test(judged.square, judged.freedom) if judged else None
        if test:
            yield test[1], effect


def _shown(deletion: Remainder, effect: Effect, tried: int) -> ShownEffect | None:
    """Return the size at which the F test passes `CHANCE` with `POWER`, the mean over its components' directions; None if undetermined."""
    judged, left = deletion.added(effect.columns), deletion.freedom
    if judged is None or left - judged.freedom < MIN_FREEDOM:
        return None
    information = deletion.information(effect.columns)
    q = len(information) if effect.sized is None else effect.sized
    # directions that other components can compensate carry no information
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
    """Those that are neither solved nor stated in the rig, nor have an estimated size; travel (n, m): as `Campaign.travel` has it, which it
    replaces."""
    campaign, names = model.campaign, set(model.parameters.names)
    rows, scales, counts = model.cables(theta)
    poses, drums = model.poses(theta), campaign.drums
    at = model.pose_index, model.cable_index
    per_unit = campaign.mm_per_unit
    g = model.since_zero(length_gradients(rows, poses, counts, scales) * per_unit[:, None])
    m, zero = len(drums), campaign.zero[: len(drums)]
    travel = campaign.travel if travel is None else travel
    begun = Zero(poses[zero], counts[zero, np.arange(m)], np.zeros(m))
    own_counts = np.ascontiguousarray(counts[:, :m])
    for j, c in enumerate(campaign.cables):
        mine = model.cable_index == j
        if c.is_cable:
            point = campaign.rig.point(c.from_point)
            sized = {name for v in model.variables if v.assumed and v.owner == point.name for name in (v.kind.key, v.kind.parameter)}
            for kind, said, holder in (
                (RUN_OUT, message("physical.run_out"), point.drum),
                (ECCENTRICITY, message("physical.eccentric_pulley"), point),
                (OFFSET, message("physical.swivel_offset"), point),
            ):
                variable = Variable(kind, point.name, 1.0)
                if getattr(holder, kind.key) is not None or kind.key in sized or variable.names[0] in names:
                    continue
                if kind is RUN_OUT or point.pulley_radius_mm > 0.0:
                    shifts = Unsolved(campaign.rig, [variable], drums).shifts(rows[:m], begun, poses, own_counts)
                    columns = np.where(mine[:, None], shifts[at[0], np.minimum(at[1], m - 1)], 0.0)
                    yield Effect(said, c.channel, columns, "mm", 1.0, f"{ASK[kind.key]}:{point.name}")
            if f"{c.from_point}.backlash_counts" not in names and point.drum.u_backlash_counts is None and BACKLASH.key not in sized:
                way = np.where(mine, -travel[at] * rows[j, COUNT_LENGTH] / scales[j], 0.0)
                yield Effect(
                    message("physical.play"),
                    c.channel,
                    np.column_stack([way, mine.astype(np.float64)]),
                    "counts",
                    1.0,
                    f"backlash:{c.from_point}",
                    1,
                )
            solvable = (
                (BY_SCALE, "scale", message("physical.diameter"), "%", 100.0, "scale"),
                (BY_PITCH, "groove_pitch_mm", message("physical.pitch"), "mm", 1.0, "pitch"),
                (BY_RADIUS, "pulley_radius_mm", message("physical.radius"), "mm", 1.0, "radius"),
            )
            for column, key, said, unit, size, ask in solvable:
                if f"{c.from_point}.{key}" not in names and key not in sized:
                    yield Effect(said, c.channel, np.where(mine, g[:, column], 0.0)[:, None], unit, size, f"{ask}:{c.from_point}")
        elif c.from_point:
            way = poses[:, :3] + arms(rows[j : j + 1], poses)[:, 0] - rows[j, BASE_XYZ]
            radius = campaign.rig.point(c.from_point).pulley_radius_mm
            trail = radius * (1.0 - span(way, rows[j, GUIDE_XYZ], radius).cosine)
            angle = counts[:, j] * campaign.rig.counter(c).per_count
            seen = np.column_stack([np.cos(angle), np.sin(angle)]) * per_unit[j]
            yield Effect(
                message("physical.eccentric_encoder"), c.channel, _of(model, seen, j), "deg", math.degrees(1.0), "eccentricity_deg"
            )
            if radius > 0.0 and trail.min() > LEAST_TRAIL * radius:
                beside = (per_unit[j] / trail)[:, None]
                yield Effect(message("physical.groove_beside"), c.channel, _of(model, beside, j), "mm", 1.0, "")
            tilt = np.where(mine[:, None], g[:, [BY_ALPHA, BY_BETA]], 0.0)
            yield Effect(message("physical.tilted_encoder"), c.channel, tilt, "deg", math.degrees(1.0), "")


def _of(model: Model, values: FloatArray, j: int) -> FloatArray:
    """(e, c) of a channel's residuals from values (n, c) at the poses, since its zero pose where it counts from there."""
    every = np.zeros((len(values), len(model.campaign.cables), values.shape[1]))
    every[:, j] = values
    return model.since_zero(every)


def size_of(left: Remainder, effect: Effect) -> float:
    """Return how large it would be, in its unit: the length of its components, all together."""
    return float(np.linalg.norm(left.sizes(effect.columns)[: effect.sized])) * effect.per_unit
