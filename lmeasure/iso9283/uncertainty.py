"""Uncertainty of characteristics by propagation of distributions (JCGM 101) and by the linear law (JCGM 100).

A characteristic is a function f of the attained poses x of its cycles. The measurement is x + e, with e the instrument's errors of known
law, and f(x + e) is the certified value; its error is f(x + e) - f(x). For a signed component f is linear and the error's law does not
depend on x. For a length of a vector, a standard deviation or a maximum it does: noise makes them larger than they are. The law of the
error is therefore drawn at an x* as likely as x itself: the measured poses with their deviations reduced by the average part of errors
(`reduction`). U95 is the 95 % quantile of |f(x* + e) - f(x*)|, so that value +- U95 holds f(x).

The budget is the linear law at x: e = sum_k d_k z_k with independent z_k of unit variance, and c_k = df(x + s d_k) / ds at s = 0. A source
contributes the root sum of squares of its c_k; results a and b correlate by sum_k c_ak c_bk. Errors of more variables than LINEAR_TRIALS
that are new at every pose are LINEAR_TRIALS draws of them instead, which determine their contribution with as many degrees of freedom.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np

from lmeasure.core import FloatArray, IntArray
from lmeasure.iso9283.characteristic import Characteristic, Contribution
from lmeasure.iso9283.figure import Function, OfInstants, Subject
from lmeasure.iso9283.paths import Crossings
from lmeasure.recording import Program
from lmeasure.text import message
from lmeasure.trajectory import ErrorSource, PoseErrors, Stamps

COVERAGE = 0.95
NORMAL_95 = 1.959963984540054
"""Half width of the interval that holds 95 % of a normal law, in standard deviations."""
NORMAL_95_ONE_SIDED = 1.6448536269514722
STEP = 1e-3
"""Part of the errors used as step for the linear law: derivatives along the drawn errors."""
NO_ERROR = 1e-12  # mm, rad
POINTS_AT_ONCE, DRAWS_AT_ONCE = 100_000, 200_000
LINEAR_TRIALS = 500
"""Most variables of a part's own errors that have a derivative each. As many draws replace more: their deviation is known to 3 %."""


class Part(Protocol):
    """Attained poses that figures are made of, and the law of their errors (n poses)."""

    @property
    def positions(self) -> FloatArray:
        """(n, 3) where they are [mm]."""
        ...

    @property
    def errors(self) -> PoseErrors:
        """Law of the n errors."""
        ...

    def state(self, errors: FloatArray, reduced: bool) -> Any:
        """Return the state that figures are functions of, moved by errors (..., n, 6); reduced: of x*, else of the measured poses."""
        ...


@dataclass(frozen=True)
class Spread:
    """Uncertainty of a result: by Monte Carlo u95, its mean bias, u95_corrected without this, and standard deviation u_drawn; by
    the linear law the budget and derivatives sensitivities (T,) along all independent errors."""

    u95: float
    bias: float
    u_drawn: float
    budget: tuple[Contribution, ...]
    sensitivities: FloatArray = field(compare=False)
    u95_corrected: float

    def _of(self, random: bool) -> float:
        return float(np.sqrt(sum(row.contribution**2 for row in self.budget if row.random is random)))

    @property
    def u_random(self) -> float:
        """Return the standard uncertainty that another run draws anew."""
        return self._of(True)

    @property
    def u_systematic(self) -> float:
        """Standard uncertainty by all else."""
        return self._of(False)


def reduction(observed: FloatArray | float, added: FloatArray | float, freedom: float = np.inf) -> FloatArray:
    """Return the factor (...) on deviations with an observed mean square (...) that removes the part of errors.

    freedom: degrees of freedom of the observed mean square. It is taken as high as is likely, 1.64 standard deviations (5 %) of sqrt(2 /
    freedom) above its expectation: the smaller the deviations are in truth, the more the errors enlarge figures made of them.
    """
    observed, added = np.asarray(observed, dtype=np.float64), np.asarray(added, dtype=np.float64)
    least = observed / (1.0 + NORMAL_95_ONE_SIDED * np.sqrt(2.0 / freedom))
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(np.where(least > added, (least - added) / observed, 0.0))


def reduction_of_mean(observed: FloatArray | float, added: FloatArray | float, axes: int) -> FloatArray:
    """Factor (...) on vectors of so many axes, whose squared lengths are observed (...), down to the least length that could have been
    measured so long.

    added (...): trace of the covariance of their errors. One part of as many as there are axes lies along the vector, the rest lengthens
    it; the least is 1.64 standard deviations (5 %) of an error wholly along it shorter. Errors that are added to a vector near zero always
    lengthen it, by up to the radius that holds 95 % of them.
    """
    observed, added = np.asarray(observed, dtype=np.float64), np.asarray(added, dtype=np.float64)
    least = np.sqrt(np.maximum(observed - (1.0 - 1.0 / axes) * added, 0.0)) - NORMAL_95_ONE_SIDED * np.sqrt(added)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(least > 0.0, least / np.sqrt(observed), 0.0)


def drawn_errors(e: PoseErrors, rng: np.random.Generator, common: FloatArray) -> FloatArray:
    """Errors (trials, n, 6) of a part, with the run's own draws common (trials, K)."""
    trials, n = len(common), len(e)
    out = (common @ e.shared.reshape(n * 6, -1).T).reshape(trials, n, 6)
    at_once = max(DRAWS_AT_ONCE // max(e.own[:, 0].size, 1), 1)
    for first in range(0, trials, at_once):
        some = out[first : first + at_once]
        some += np.einsum("nij,tnj->tni", e.own, e.drawn(rng, (len(some), n, e.own.shape[2])), optimize=True)
    if e.local.any():
        drawn = e.drawn(rng, (trials, int(e.place.max()) + 1, e.local.shape[2]))
        out += np.einsum("nij,tnj->tni", e.local, drawn[:, e.place], optimize=True)
    return np.asarray(out)


Moving = Callable[[dict[Subject, FloatArray]], dict[Subject, FloatArray]]
"""Effect of a fitted frame on the errors of all parts."""


def propagate(
    parts: Mapping[Subject, Part],
    figures: Sequence[Function],
    *,
    trials: int,
    seed: int,
    fitted: Moving | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> list[Spread]:
    """The spread of each figure over as many trials; every part draws from its own stream, the run's common errors from one."""
    points = max(sum(len(p.errors) for p in parts.values()), 1)
    at_once = int(np.clip(POINTS_AT_ONCE // points, 1, trials))
    widest = max((p.errors for p in parts.values()), key=lambda e: e.shared.shape[2], default=None)
    streams = np.random.default_rng(seed).spawn(len(parts) + 2)
    laws = {name: (p.errors, rng) for (name, p), rng in zip(parts.items(), streams[1:-1], strict=True)}
    still = {name: np.zeros((len(p.errors), 6)) for name, p in parts.items()}
    uses: list[set[Subject]] = [set() for _ in figures]

    def states(errors: dict[Subject, FloatArray], *, reduced: bool) -> dict[Subject, Any]:
        moved = fitted(errors) if fitted is not None else errors
        return {name: parts[name].state(e, reduced) for name, e in moved.items()}

    def values(errors: dict[Subject, FloatArray], chosen: Sequence[int], *, reduced: bool) -> list[FloatArray]:
        moved = states(errors, reduced=reduced)
        return [np.atleast_1d(figures[i](moved)) for i in chosen]

    every, unmoved = range(len(figures)), states(still, reduced=True)
    base = [np.atleast_1d(figure(_Watched(unmoved, used))) for figure, used in zip(figures, uses, strict=True)]
    measured = values(still, every, reduced=False)
    error = np.empty((len(figures), trials))
    for first in range(0, trials, at_once):
        last = min(first + at_once, trials)
        common = np.empty((last - first, 0)) if widest is None else widest.drawn_common(streams[0], last - first)
        drawn = {name: drawn_errors(e, rng, common[:, : e.shared.shape[2]]) for name, (e, rng) in laws.items()}
        for i, value in enumerate(values(drawn, every, reduced=True)):
            error[i, first:last] = value - base[i]
        if progress is not None:
            progress(last, trials)
    rows: list[dict[_Kind, list[float]]] = [{} for _ in figures]
    sensitivities: list[list[FloatArray]] = [[] for _ in figures]
    for block in _blocks(parts, streams[-1], joint=fitted is not None):
        of = [i for i in every if not block.part or not uses[i] or block.part in uses[i]]
        needed = parts.keys() if not block.part else {block.part}.union(*(uses[i] or parts.keys() for i in of))
        size = len(block.kinds)
        for first in range(0, size, at_once):
            piece = slice(first, min(first + at_once, size))
            n = piece.stop - first
            errors = {
                k: STEP * block.errors[k][piece] if k in block.errors else np.zeros((n, *still[k].shape)) for k in parts if k in needed
            }
            slopes = dict(zip(of, values(errors, of, reduced=False), strict=True))
            for i in every:
                slope = np.broadcast_to((slopes[i] - measured[i]) / STEP, n) if i in slopes else np.zeros(n)
                sensitivities[i].append(slope)
                for kind, c in zip(block.kinds[piece], slope.tolist(), strict=True) if i in slopes else ():
                    rows[i].setdefault(kind, []).append(c)
    u95 = np.quantile(np.abs(error), COVERAGE, axis=1)
    corrected = np.quantile(np.abs(error - error.mean(axis=1, keepdims=True)), COVERAGE, axis=1)
    return [
        Spread(
            float(u95[i]), float(error[i].mean()), float(error[i].std()), tuple(_row(kind, c) for kind, c in rows[i].items()),
            np.concatenate(sensitivities[i]) if sensitivities[i] else np.empty(0), float(corrected[i]),
        )
        for i in every
    ]  # fmt: skip


class _Kind(NamedTuple):
    """Kind of an independent error: its source, its distribution, and whether another run draws it anew."""

    source: ErrorSource
    law: Literal["normal", "rectangular"]
    random: bool


class _Watched(dict[Subject, Any]):
    """States of parts that note which of them a figure uses."""

    def __init__(self, states: Mapping[Subject, Any], used: set[Subject]) -> None:
        super().__init__(states)
        self._used = used

    def __getitem__(self, key: Subject) -> Any:
        self._used.add(key)
        return super().__getitem__(key)


@dataclass(frozen=True)
class _Block:
    """Independent errors: of each part (T, n, 6) by a variable of unit variance each, and their source; part: the only part with them, None
    for all parts."""

    errors: dict[Subject, FloatArray]
    kinds: list[_Kind]
    part: Subject | None = None


def _blocks(parts: Mapping[Subject, Part], rng: np.random.Generator, *, joint: bool) -> Iterator[_Block]:
    """Yield the errors that all parts have in common, then those of each part; of all parts together where joint, as a fitted frame needs
    them."""
    if not parts:
        return
    widest = max((p.errors for p in parts.values()), key=lambda e: e.shared.shape[2])
    columns = widest.shared.shape[2]
    shared = {k: np.moveaxis(p.errors.shared, 2, 0) for k, p in parts.items()}
    uniform, counted = (np.pad(np.array(of, dtype=np.bool_), (0, columns - len(of))) for of in (widest.uniform, widest.counted))
    kinds = [_Kind(s, _law(u), c) for s, u, c in zip(widest.named()[2], uniform.tolist(), counted.tolist(), strict=True)]
    yield _Block({k: np.pad(e, ((0, columns - len(e)), (0, 0), (0, 0))) for k, e in shared.items()}, kinds)
    points = max(sum(len(p.errors) for p in parts.values()), 1)
    at_once = int(np.clip(POINTS_AT_ONCE // points, 1, LINEAR_TRIALS))
    for which, random in ((0, True), (1, False)):
        if joint:
            source, law = _named(next(iter(parts.values())).errors, which, drawn=True)
            for first in range(0, LINEAR_TRIALS, at_once):
                number = min(at_once, LINEAR_TRIALS - first)
                errors = {k: _drawn_directions(p.errors, which, rng, number) for k, p in parts.items()}
                yield _Block(errors, [_Kind(source, law, random or any(p.errors.joint for p in parts.values()))] * number)
            continue
        for k, part in parts.items():
            columns, place = _own(part.errors, which)
            drawn = (int(place.max(initial=-1)) + 1) * columns.shape[2] > LINEAR_TRIALS
            e = _drawn_directions(part.errors, which, rng, LINEAR_TRIALS) if drawn else _single_directions(columns, place)
            if len(e):
                source, law = _named(part.errors, which, drawn=drawn)
                yield _Block({k: e}, [_Kind(source, law, random or part.errors.joint)] * len(e), k)


def _law(uniform: bool) -> Literal["normal", "rectangular"]:
    return "rectangular" if uniform else "normal"


def _named(e: PoseErrors, which: int, *, drawn: bool) -> tuple[ErrorSource, Literal["normal", "rectangular"]]:
    own, local, _ = e.named()
    source = local if which else own
    return (source._replace(degrees_of_freedom=float(LINEAR_TRIALS)) if drawn else source), _law(e.rounded)


def _own(e: PoseErrors, which: int) -> tuple[FloatArray, IntArray]:
    """Return the columns (n, 6, q) and places (n,) of `own` or `local`, which 0 or 1."""
    return (e.own, np.arange(len(e))) if which == 0 else (e.local, e.place)


def _single_directions(columns: FloatArray, place: IntArray) -> FloatArray:
    """Return errors (T, n, 6) by the variables of columns (n, 6, q), each drawn once for a place (n,), one at a time."""
    n, _, q = columns.shape
    out = np.zeros((int(place.max(initial=-1)) + 1, q, n, 6))
    out[place, :, np.arange(n)] = np.swapaxes(columns, 1, 2)
    every: FloatArray = out.reshape(-1, n, 6)
    return every[(np.abs(every) > NO_ERROR).any(axis=(1, 2))]


def _drawn_directions(e: PoseErrors, which: int, rng: np.random.Generator, number: int) -> FloatArray:
    """Return random errors (number, n, 6); the squares of LINEAR_TRIALS of them add up to the variance by all variables."""
    columns, place = _own(e, which)
    z = e.drawn(rng, (number, int(place.max(initial=-1)) + 1, columns.shape[2])) / np.sqrt(LINEAR_TRIALS)
    return np.asarray(np.einsum("nij,tnj->tni", columns, z[:, place], optimize=True))


def _row(kind: _Kind, derivatives: list[float]) -> Contribution:
    """Return the row of a source from the derivatives by its variables."""
    s = kind.source
    return Contribution(s.name, float(np.linalg.norm(derivatives)), s.u, s.unit, kind.law, s.degrees_of_freedom, kind.random)


APART = 10.0
"""Fewest standard uncertainties of an instant between planes for a meaningful speed between them."""


def on_times(program: Program, stamps: Stamps) -> Program:
    """The program with its windows, stated by the recorded stamps, on the times of the samples."""
    if stamps.kind != "even":
        return program

    def moved(part: Any) -> Any:
        stated = {key: getattr(part, key) for key in ("windows_s", "settling_s") if hasattr(part, key)}
        on = {key: tuple((_on_times(start, stamps), _on_times(end, stamps)) for start, end in windows) for key, windows in stated.items()}
        return part.model_copy(update=on)

    return program.model_copy(update={kind: tuple(map(moved, getattr(program, kind))) for kind in ("pose", "path", "posing", "compliance")})


def _on_times(stamp_s: float, stamps: Stamps) -> float:
    """The time of a recorded instant; before the first and behind the last sample as far from them as it was."""
    first, last = (float(x) for x in stamps.stamp_s[[0, -1]])
    within = min(max(stamp_s, first), last)
    return float(np.interp(within, stamps.stamp_s, stamps.time_s)) + stamp_s - within


def most_planes(stamps: Stamps, duration_s: float) -> int:
    """Planes that a path of this duration may have."""
    return int(duration_s / (APART * stamps.u_time_s)) if stamps.u_time_s > 0.0 else np.iinfo(np.int64).max


def of_crossing(places: PoseErrors, crossed: Crossings, stamps: Stamps) -> PoseErrors:
    """The errors (m n poses) of the places where planes are crossed, and those of when: an instant that is off by dt is a place that is off
    along the path by as much as the robot goes in dt. Anew at every crossing by u_time_s; in common, in proportion to the time since the
    middle of its cycle, by u_rate."""
    if stamps.kind == "sound":
        return places
    m, n = crossed.time_s.shape
    along = np.zeros((m, n, 6, 1))
    along[..., 3:, 0] = crossed.tangent[:, None] * crossed.pace_mm_s[:, :, None]
    since = crossed.time_s - crossed.time_s.mean(axis=0)
    single = (along * stamps.u_time_s).reshape(-1, 6, 1)
    common = (along[..., 0] * (stamps.u_rate * since)[:, :, None]).reshape(-1, 6)
    timed = replace(places, own=np.concatenate([places.own, single], axis=2))
    return timed.with_shared(common, ErrorSource(message("source.instants")))


def with_instants(c: Characteristic, added: OfInstants) -> Characteristic:
    """Return a figure with the effect of errors of its samples' times."""
    row = Contribution(message("source.instants"), added.u)
    return c.with_budget((*c.budget, *(row,) * (added.u > 0.0)), float(np.hypot(c.u95, NORMAL_95 * added.u) + added.bias))


def of_duration(c: Characteristic, stamps: Stamps) -> Characteristic:
    """A duration, the mean of its cycles, with both ends of each cycle and the rate that all have in common."""
    if stamps.kind == "sound":
        return c
    return with_instants(c, OfInstants(float(np.hypot(np.sqrt(2.0 / c.cycles) * stamps.u_time_s, abs(c.value) * stamps.u_rate))))
