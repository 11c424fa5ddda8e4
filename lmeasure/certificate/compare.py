"""Certificates side by side: one robot over time, or robots of one type (ISO 9283:1998, 7.6 exchangeability).

Two questions are kept apart. Whether two figures differ at all is limited by the instrument: their difference has the random parts of both
and, unless both were measured by the same calibration, their systematic parts. Whether a robot has moved is limited by its own scatter too:
the means of few cycles differ by chance, and that is tested by Hotelling's T-squared of the attained positions.

A measured distance from a commanded pose is too long on the average: the robot's scatter and the instrument's errors have a length of their
own. So the least mean distance is found by test inversion: the smallest, along the measured one, under which the measurement would not be
improbable. The largest is the larger of two: a robot corrected by the same instrument is right in the eyes of that instrument. Its measured
distance does not contain the errors common to both measurements, and the true errors are the measured ones minus those.
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from lmeasure.certificate.verification import label, with_u95
from lmeasure.core import CertificationError, FloatArray, LMeasureError
from lmeasure.text import message

SIGNIFICANT = 0.01
"""Probability of chance, over all poses together (Holm), under which a robot has moved."""
NORMAL_95 = 1.959963984540054
SAME_PLACE_MM = 1e-6


@dataclass(frozen=True)
class Change:
    """A figure in the first certificate and in a later one. u95: expanded uncertainty of the difference by the instrument alone; beyond:
    whether the difference exceeds it."""

    figure: str
    unit: str
    first: float
    later: float
    u95: float

    @property
    def beyond(self) -> bool:
        """Return whether the instrument can distinguish the two."""
        return abs(self.later - self.first) > self.u95


@dataclass(frozen=True)
class Shift:
    """Mean attained position of a pose, later minus first: shift (3,) [mm]; u95 [mm] of its length with instrument and scatter;
    probability of as much by chance, None for too few cycles; moved: less than `SIGNIFICANT` over all poses of the comparison."""

    pose: str
    shift_mm: FloatArray
    u95_mm: float
    probability: float | None
    moved: bool

    @property
    def distance_mm(self) -> float:
        """Length of the shift."""
        return float(np.linalg.norm(self.shift_mm))


@dataclass(frozen=True)
class Pair:
    """A later certificate against the first."""

    first: str
    later: str
    shared: bool
    changes: tuple[Change, ...]
    shifts: tuple[Shift, ...]
    otherwise: tuple[str, ...] = ()
    """Poses and paths with different commands in the two certificates: they are not compared."""


@dataclass(frozen=True)
class Exchangeability:
    """ISO 9283 E of a pose: the largest distance of the attained means of any two certificates [mm], which two, and its u95 [mm]."""

    pose: str
    value_mm: float
    u95_mm: float
    between: tuple[str, str]


@dataclass(frozen=True)
class Comparison:
    """All certificates against the first, in the order of their dates. kind: the subject of the certificates."""

    kind: str
    names: tuple[str, ...]
    pairs: tuple[Pair, ...]
    exchangeability: tuple[Exchangeability, ...]
    notes: tuple[str, ...]


def compare_certificates(certificates: Sequence[tuple[str, dict[str, Any]]]) -> Comparison:
    """Certificates (name, content of certificate.json) side by side.

    CertificationError for fewer than two, with nothing in common, or where one is not as `certify` writes it.
    """
    try:
        return _compared(certificates)
    except LMeasureError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError, IndexError, np.linalg.LinAlgError) as error:
        names = ", ".join(name for name, _ in certificates)
        raise CertificationError(message("error.one_is_not_as", where=names, error=error)) from None


def _compared(certificates: Sequence[tuple[str, dict[str, Any]]]) -> Comparison:
    if len(certificates) < 2:
        raise CertificationError(message("error.a_comparison_needs_two"))
    twice = [name for name, content in certificates if sum(content["id"] == c["id"] for _, c in certificates) > 1]
    if twice:
        raise CertificationError(message("error.is_given_twice", where=twice[0]))
    bare = [name for name, content in certificates if any(c["u95"] is None for c in content["characteristics"])]
    if bare:
        raise CertificationError(message("error.states_no_uncertainty_whether", where=bare[0]))
    ordered = sorted(certificates, key=lambda c: (_day(c[1]), c[1]["created"]))
    (first_name, first), *others = ordered
    pairs = tuple(_pair(first_name, first, name, content) for name, content in others)
    if not any(pair.changes or pair.shifts for pair in pairs):
        why = message("certificate_compare.otherwise", name=pairs[0].otherwise[0]) if pairs[0].otherwise else ""
        raise CertificationError(message("error.has_no_characteristic_in", where=others[0][0], first_name=first_name, why=why))
    return Comparison(_kind(ordered), tuple(name for name, _ in ordered), pairs, _exchangeability(ordered), tuple(_notes(ordered)))


def _day(content: dict[str, Any]) -> str:
    dates = content["details"].get("dates", {})
    return str(dates.get("measured_from") or dates.get("measured_to") or content["created"][:10])


def _kind(certificates: Sequence[tuple[str, dict[str, Any]]]) -> str:
    items = [c["details"].get("item", {}) for _, c in certificates]
    serials = [i.get("serial") for i in items]
    if None in serials:
        return message("certificate_line.no_serials")
    if len(set(serials)) == 1:
        return message("certificate_line.one_robot", serial=serials[0])
    models = {i.get("model") for i in items}
    code = "certificate_line.robots_model" if len(models) == 1 and None not in models else "certificate_line.robots"
    return message(code, n=len(set(serials)), model=items[0].get("model"))


def _notes(certificates: Sequence[tuple[str, dict[str, Any]]]) -> list[str]:
    out: list[str] = []
    if any(c["base_from_program"] is not None for _, c in certificates):
        out.append(message("certificate.frame_was_fitted_some"))
    for (_, a), (name, b) in itertools.pairwise(certificates):
        differ = sorted(k for k in {*a["settings"], *b["settings"]} - {"seed", "trials"} if a["settings"].get(k) != b["settings"].get(k))
        if differ:
            out.append(message("certificate.certified_other_settings", certificate=name, settings=tuple(differ)))
    return out


def shared_systematic(a: dict[str, Any], b: dict[str, Any]) -> bool:
    """Return whether both have the systematic errors of one calibration."""
    digests = [(c["instrument"] or {}).get("systematic_sha256") for c in (a, b)]
    return digests[0] is not None and digests[0] == digests[1]


def _pair(first_name: str, first: dict[str, Any], name: str, later: dict[str, Any]) -> Pair:
    shared = shared_systematic(first, later)
    other = commanded_otherwise(first, later)
    old, new = ({label(c): c for c in content["characteristics"]} for content in (first, later))
    changes = tuple(
        Change(key, a["unit"], float(a["value"]), float(new[key]["value"]), _u95_of_difference(a, new[key], shared))
        for key, a in old.items()
        if key in new and a["unit"] == new[key]["unit"] and not _of_any(a, other)
    )
    reported = tuple(f"{kind} {part} ({', '.join(keys)})" for (kind, part), keys in other.items())
    return Pair(first_name, name, shared, changes, _shifts(first, later, shared, other), reported)


Otherwise = dict[tuple[str, str], list[str]]


def commanded_otherwise(a: dict[str, Any], b: dict[str, Any]) -> Otherwise:
    """Return poses and paths of one name with different commands: (kind, name) and the keys that differ, speed and load among them. None if
    a certificate does not state its commands."""
    parts = [
        {
            (kind, str(row["name"])): {"load_kg": content["program"].get("load_kg")} | row
            for kind in ("pose", "path")
            for row in content["program"][kind]
        }
        for content in (a, b)
        if content.get("program")
    ]
    if len(parts) < 2:
        return {}
    found = {}
    for part, old in parts[0].items():
        new = parts[1].get(part, old)
        keys = [k for k in sorted({*old, *new} - {"cycles"}) if not _alike(old.get(k), new.get(k))]
        if keys:
            found[part] = keys
    return found


def _alike(a: Any, b: Any) -> bool:
    if isinstance(a, list) and isinstance(b, list):
        return len(a) == len(b) and all(map(_alike, a, b))
    if all(isinstance(v, int | float) for v in (a, b)):
        return bool(abs(a - b) <= SAME_PLACE_MM)
    return bool(a == b)


def _of_any(figure: dict[str, Any], other: Otherwise) -> bool:
    """Return whether a figure belongs to one of these parts, or to the distance between two poses with one among them."""
    if figure.get("path") is not None:
        return ("path", figure["path"]) in other
    pose = str(figure.get("pose"))
    return any(kind == "pose" and (pose == name or pose.startswith(f"{name}-") or pose.endswith(f"-{name}")) for kind, name in other)


def _parts(figure: dict[str, Any]) -> tuple[float, float, float]:
    """(random, systematic standard uncertainty, coverage factor) of a figure; all of it random where the parts are not stated."""
    random, systematic = figure.get("u_random"), figure.get("u_systematic")
    if random is None or systematic is None or not math.hypot(random, systematic) > 0:
        return float(figure["u95"]) / NORMAL_95, 0.0, NORMAL_95
    return float(random), float(systematic), max(float(figure["u95"]) / math.hypot(random, systematic), NORMAL_95)


def _u95_of_difference(a: dict[str, Any], b: dict[str, Any], shared: bool) -> float:
    (ra, sa, ka), (rb, sb, kb) = _parts(a), _parts(b)
    # errors of one calibration are in both: only their change from pose to pose remains
    systematic = abs(sa - sb) if shared else math.hypot(sa, sb)
    return max(ka, kb) * math.hypot(ra, rb, systematic)


def _shifts(first: dict[str, Any], later: dict[str, Any], shared: bool, other: Otherwise) -> tuple[Shift, ...]:
    old, new = (attained(content) for content in (first, later))
    found = []
    for pose, a in old.items():
        b = new.get(pose)
        if b is not None and ("pose", pose) not in other and np.abs(a.commanded - b.commanded).max() <= SAME_PLACE_MM:
            found.append((pose, *_test(a, b, shared)))
    # Holm: the least probability against the strictest bound, and so on until one fails
    known = sorted((p, pose) for pose, _, _, p in found if p is not None)
    moved: set[str] = set()
    for i, (p, pose) in enumerate(known):
        if p >= SIGNIFICANT / (len(known) - i):
            break
        moved.add(pose)
    return tuple(Shift(pose, shift, u95, p, pose in moved) for pose, shift, u95, p in found)


@dataclass(frozen=True)
class Attained:
    commanded: FloatArray
    mean: FloatArray
    cycles: int
    scatter: FloatArray
    random: FloatArray
    systematic: FloatArray


def attained(content: dict[str, Any]) -> dict[str, Attained]:
    """Return means of the poses' cycles with their scatter (3, 3) and the instrument's error along each axis (3,)."""
    figures = {label(c): c for c in content["characteristics"]}
    out = {}
    for entry in content["attained"]:
        own = [figures.get(f"AP_{axis} of {entry['pose']}") for axis in "xyz"]
        if any(f is None for f in own):
            continue
        parts = np.array([_parts(f)[:2] for f in own if f is not None])
        values = [np.array(entry[key], dtype=np.float64) for key in ("commanded_mm", "mean_mm", "covariance_mm2")]
        out[entry["pose"]] = Attained(values[0], values[1], int(entry["cycles"]), values[2], parts[:, 0], parts[:, 1])
    return out


def _test(a: Attained, b: Attained, shared: bool) -> tuple[FloatArray, float, float | None]:
    """(shift (3,), u95 of its length, probability of chance) of two means."""
    shift = b.mean - a.mean
    systematic = np.abs(a.systematic - b.systematic) if shared else np.hypot(a.systematic, b.systematic)
    covariance = a.scatter / a.cycles + b.scatter / b.cycles + np.diag(a.random**2 + b.random**2 + systematic**2)
    freedom = a.cycles + b.cycles - 2
    length = float(np.linalg.norm(shift))
    along = shift / length if length > 0 else np.array([1.0, 0.0, 0.0])
    u = math.sqrt(float(along @ covariance @ along))
    u95 = u * float(scipy.stats.t.ppf(0.975, freedom)) if freedom > 0 else u * NORMAL_95
    if min(a.cycles, b.cycles) < 2 or freedom < 3 or np.linalg.matrix_rank(covariance) < 3:
        return shift, u95, None
    squared = float(shift @ np.linalg.solve(covariance, shift))
    return shift, u95, float(scipy.stats.f.sf(squared * (freedom - 2) / (3 * freedom), 3, freedom - 2))


def _exchangeability(certificates: Sequence[tuple[str, dict[str, Any]]]) -> tuple[Exchangeability, ...]:
    known = [(name, content, attained(content)) for name, content in certificates]
    out = []
    for pose in known[0][2]:
        distances = []
        for (name_a, content_a, a), (name_b, content_b, b) in itertools.combinations(known, 2):
            if ("pose", pose) in commanded_otherwise(content_a, content_b):
                continue
            if pose in a and pose in b and np.abs(a[pose].commanded - b[pose].commanded).max() <= SAME_PLACE_MM:
                shift, u95, _ = _test(a[pose], b[pose], shared_systematic(content_a, content_b))
                distances.append(Exchangeability(pose, float(np.linalg.norm(shift)), u95, (name_a, name_b)))
        if distances:
            out.append(max(distances, key=lambda e: e.value_mm))
    return tuple(out)


def lines(found: Comparison) -> list[str]:
    """Return the lines for a person."""
    out: list[str] = [message("certificate_line.kind", kind=found.kind, names=tuple(found.names))]
    for pair in found.pairs:
        code = "certificate_line.shared" if pair.shared else "certificate_line.not_shared"
        out.append(message(code, later=pair.later, first=pair.first))
        for s in pair.shifts:
            chance = message("certificate.too_few_cycles_tell") if s.probability is None else message("certificate.chance", p=s.probability)
            verdict = (
                ""
                if s.probability is None
                else message("certificate_line.moved")
                if s.moved
                else message("certificate.not_shown_have_moved")
            )
            length, u95 = with_u95(s.distance_mm, s.u95_mm)
            out.append(message("certificate.mean_mm_u95", pose=s.pose, length=length, u95=u95, chance=chance, verdict=verdict))
        beyond = [c for c in pair.changes if c.beyond]
        out += [_changed(c) for c in beyond]
        out.append(
            message("certificate.figures_differ_more_than", count=len(beyond), count_=len(pair.changes), len=0.05 * len(pair.changes))
        )
        out += [message("certificate.commanded_otherwise_not_compared", v1=text) for text in pair.otherwise]
    for e in found.exchangeability:
        value, u95 = with_u95(e.value_mm, e.u95_mm)
        out.append(message("certificate.e_mm_u95_between", pose=e.pose, value=value, u95=u95, one=e.between[0], other=e.between[1]))
    return [*out, *(message("line.note", text=note) for note in found.notes)]


def _changed(change: Change) -> str:
    """A change whose numbers end where the U95 of their difference does."""
    first, later, difference = (with_u95(v, change.u95)[0] for v in (change.first, change.later, change.later - change.first))
    sign = "" if difference.startswith("-") else "+"
    values = {"first": first, "later": later, "difference": f"{sign}{difference}", "u95": with_u95(0.0, change.u95)[1]}
    return message("certificate_line.change", figure=change.figure, unit=change.unit, **values)


def as_dict(found: Comparison) -> dict[str, Any]:
    """Return every result in full, for a file."""
    return {
        "schema": "lmeasure.comparison/1",
        "kind": found.kind,
        "certificates": list(found.names),
        "pairs": [
            {
                "first": p.first,
                "later": p.later,
                "same_calibration": p.shared,
                "commanded_otherwise": list(p.otherwise),
                "figures": [vars(c) | {"difference": c.later - c.first, "beyond_u95": c.beyond} for c in p.changes],
                "poses": [vars(s) | {"shift_mm": s.shift_mm.tolist(), "distance_mm": s.distance_mm} for s in p.shifts],
            }
            for p in found.pairs
        ],
        "exchangeability": [vars(e) | {"between": list(e.between)} for e in found.exchangeability],
        "notes": list(found.notes),
    }


DRAWS = 2000
OUTSIDE = 0.0125
"""Part of the draws at each end of an interval of a mean distance: the quotient of two such intervals contains the true one with 95 % at
least."""
LARGEST, HALVINGS = 4.0, 24
"""Multiples of a measured distance that are looked among, in units of it and of its noise, and how finely."""


@dataclass(frozen=True)
class Parts:
    """Standard uncertainties of an attained mean [mm], all three coordinates together, as root mean square over the poses: by the
    instrument, by the robot's scatter over the root of its cycles, and by its identification; None if unknown."""

    instrument_mm: float
    scatter_mm: float
    identified_mm: float | None


@dataclass(frozen=True)
class Improvement:
    """Errors of poses by name: commanded (k, 3) places, errors (k, 3) [mm] attained minus commanded before and after; mean distances, each
    with the
    least and the largest that its noise leaves; floor_mm: the mean distance that the parts alone would show of a robot without any other
    error."""

    poses: tuple[str, ...]
    commanded: FloatArray
    before: FloatArray
    after: FloatArray
    before_mm: tuple[float, float, float]
    after_mm: tuple[float, float, float]
    parts: Parts
    floor_mm: float

    @property
    def factor(self) -> float:
        """Mean distance before over that after."""
        return self.before_mm[0] / self.after_mm[0]

    @property
    def factor_95(self) -> tuple[float, float]:
        """Return the least and largest factor, at 95 % or more; the largest is infinite if the remaining error may be zero."""
        low, high = self.before_mm[1] / self.after_mm[2], self.before_mm[2]
        return low, high / self.after_mm[1] if self.after_mm[1] > 0.0 else math.inf


def improvement(
    first: dict[str, Any], later: dict[str, Any], identified_mm: Mapping[str, float] | None = None, seed: int = 0
) -> Improvement:
    """Return the improvement between two certificates of one program, before and after; identified_mm: by pose, the standard uncertainty
    that its correction has by the identification. CertificationError where they have no pose in common that was commanded alike."""
    other = commanded_otherwise(first, later)
    old, new = attained(first), attained(later)
    names = tuple(pose for pose in old if pose in new and ("pose", pose) not in other)
    if not names:
        raise CertificationError(message("error.the_certificates_have_no"))
    before, after = ([of[name] for name in names] for of in (old, new))
    rng = np.random.default_rng(seed)
    noise = [_noise(rows, rng) for rows in (before, after)]
    errors = [np.array([row.mean - row.commanded for row in rows]) for rows in (before, after)]
    known = None if identified_mm is None else np.array([identified_mm.get(name, math.nan) for name in names])
    left = None if known is None or np.isnan(known).any() else float(np.sqrt(np.mean(known**2)))
    own = np.zeros(len(names)) if left is None or known is None else known / math.sqrt(3.0)
    whole = noise[1] + own[:, None] * rng.normal(size=(DRAWS, len(names), 3))
    parts = Parts(_rms([row.random**2 + row.systematic**2 for row in after]), _rms([np.diag(r.scatter) / r.cycles for r in after]), left)
    reported = [_mean_distance(e, n) for e, n in zip(errors, noise, strict=True)]
    commanded = np.array([row.commanded for row in before])
    return Improvement(names, commanded, errors[0], errors[1], reported[0], reported[1], parts, float(np.linalg.norm(whole, axis=2).mean()))


def _rms(variances: list[FloatArray]) -> float:
    """Root of the mean over poses of the sum over coordinates."""
    return float(np.sqrt(np.mean(np.sum(variances, axis=1))))


def _noise(rows: list[Attained], rng: np.random.Generator) -> FloatArray:
    """(`DRAWS`, k, 3) errors of attained means: each pose's own, and the instrument's systematic ones, which move all poses together."""
    own = np.array([np.linalg.cholesky(row.scatter / row.cycles + np.diag(row.random**2) + 1e-18 * np.eye(3)) for row in rows])
    drawn = np.einsum("kij,nkj->nki", own, rng.normal(size=(DRAWS, len(rows), 3)))
    return np.asarray(drawn + np.array([row.systematic for row in rows]) * rng.normal(size=(DRAWS, 1, 3)))


def _mean_distance(errors: FloatArray, noise: FloatArray) -> tuple[float, float, float]:
    """(measured, least, largest) mean distance [mm] of errors (k, 3) that have such noise."""
    measured = float(np.linalg.norm(errors, axis=1).mean())
    if measured == 0.0:
        return 0.0, 0.0, float(np.quantile(np.linalg.norm(noise, axis=2).mean(axis=1), 1.0 - OUTSIDE))

    def beyond(part: float) -> float:
        """Return how often a robot of so much of the errors would show more than was measured."""
        return float(np.mean(np.linalg.norm(part * errors + noise, axis=2).mean(axis=1) > measured))

    def bound(probability: float) -> float:
        low, high = 0.0, LARGEST * (1.0 + float(np.linalg.norm(noise, axis=2).mean()) / measured)
        for _ in range(HALVINGS):
            middle = 0.5 * (low + high)
            low, high = (middle, high) if beyond(middle) < probability else (low, middle)
        return 0.5 * (low + high)

    least = 0.0 if beyond(0.0) >= OUTSIDE else bound(OUTSIDE)
    shared = float(np.quantile(np.linalg.norm(errors - noise, axis=2).mean(axis=1), 1.0 - OUTSIDE))
    return measured, measured * least, max(measured * bound(1.0 - OUTSIDE), shared)
