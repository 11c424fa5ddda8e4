"""What may be said of a figure: whether the instrument was good enough to say it, and whether it meets a tolerance."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from scipy.special import ndtr

from lmeasure.iso9283.characteristic import Characteristic, CharacteristicKey, Conformity, Rule, Verdict
from lmeasure.iso9283.settings import CertificationSettings
from lmeasure.iso9283.uncertainty import NORMAL_95
from lmeasure.recording import Tolerance
from lmeasure.text import message


def conformity(value: float, u95: float, tolerance: Tolerance, rule: Rule) -> Conformity:
    """A value held against a tolerance, JCGM 106:2012, 8.2 (simple acceptance) and 8.3 (guarded acceptance, guard band U95).

    Guarded: within the limits by U95 it conforms, outside them by U95 it does not, between nothing is decided.
    """
    rule = tolerance.rule or rule
    lower = -math.inf if tolerance.lower is None else tolerance.lower
    upper = math.inf if tolerance.upper is None else tolerance.upper
    guard = u95 if rule == "guarded" else 0.0
    verdict: Verdict
    if lower + guard <= value <= upper - guard:
        verdict = "conforms"
    elif value < lower - guard or value > upper + guard:
        verdict = "does not conform"
    else:
        verdict = "not decided"
    u = max(u95 / NORMAL_95, 1e-300)
    probability = float(ndtr((upper - value) / u) - ndtr((lower - value) / u))
    return Conformity(tolerance.lower, tolerance.upper, rule, verdict, probability)


def limit_of(value: float, tolerance: Tolerance | None, fraction: float) -> float:
    """Largest u95 with which a value may be stated: a fraction of it, or of half a tolerance of a signed figure, which may well be zero.

    A tolerance of one side reaches from zero.
    """
    if tolerance is None:
        return fraction * abs(value)
    lower = 0.0 if tolerance.lower is None else tolerance.lower
    upper = 0.0 if tolerance.upper is None else tolerance.upper
    return fraction * max(abs(value), 0.5 * abs(upper - lower))


def tolerance_of(c: Characteristic, tolerances: Sequence[Tolerance]) -> Tolerance | None:
    """The first tolerance that names this characteristic, at its pose or path or at all."""
    for t in tolerances:
        here = (t.pose is None and t.path is None) or (t.pose is not None and t.pose == c.pose) or (t.path is not None and t.path == c.path)
        if t.characteristic == c.name and here:
            return t
    return None


def undecided(found: Sequence[Characteristic], tolerances: Sequence[Tolerance]) -> Tolerance | None:
    """The first tolerance that no characteristic is held against, excluded ones counting: its name is another, or one before takes all."""
    used = {id(tolerance_of(c, tolerances)) for c in found}
    return next((t for t in tolerances if id(t) not in used), None)


def with_verdicts(
    found: Sequence[Characteristic],
    *,
    vectors: Mapping[CharacteristicKey, CharacteristicKey],
    signed: Sequence[str],
    tolerances: Sequence[Tolerance],
    settings: CertificationSettings,
) -> tuple[Characteristic, ...]:
    """All characteristics with their verdicts; vectors: of which vector each component takes its own; signed: names of others that may be
    zero without being bad."""
    own = [with_verdict(c, tolerances, settings, signed=c.key in vectors or c.name in signed) for c in found]
    known = {c.key: c for c in own}
    return tuple(with_vector_verdict(c, known[vectors[c.key]], settings.capability) if vectors.get(c.key) in known else c for c in own)


def with_verdict(c: Characteristic, tolerances: Sequence[Tolerance], settings: CertificationSettings, *, signed: bool) -> Characteristic:
    """The characteristic with its own verdict of capability and conformity; none when it is excluded."""
    tolerance = tolerance_of(c, tolerances)
    limit = limit_of(c.value, tolerance if signed else None, settings.capability)
    if c.excluded is not None:
        return replace(c, capable=False, limit_u95=None, conformity=None)
    found = None if tolerance is None else conformity(c.value, c.u95, tolerance, settings.rule)
    return replace(c, capable=bool(c.u95 <= limit), limit_u95=limit, conformity=found)


def with_vector_verdict(c: Characteristic, vector: Characteristic, fraction: float) -> Characteristic:
    """A signed component with the verdict of its vector, unless a tolerance gave it one: near zero it is small beside its own uncertainty
    whatever the instrument. What may be said of it alone stands beside."""
    c = replace(c, capable_alone=c.excluded is None and bool(c.u95 <= limit_of(c.value, None, fraction)))
    if c.conformity is not None or c.excluded is not None:
        return c
    return replace(c, capable=vector.capable, limit_u95=vector.limit_u95, note=message("verdict.of_vector", vector=vector.name))
