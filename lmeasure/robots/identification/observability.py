"""Observability of a robot's parameters, in numbers and words.

A robot has more errors than its freed parameters: errors of its joints, once and twice per turn, exist whether they are identified or not.
Poses that are best for the links alone gather where the links are determined best and leave those unseen. Their residuals then do not show
them, and predictions elsewhere suffer (Box and Draper, J. Am. Stat. Assoc. 54, 1959: designs against bias are spread wider than those
against variance). So poses are chosen for the links and harmonics together, each with its prior, for any later choice of free parameters.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import BoolArray, FloatArray, IntArray
from lmeasure.estimation import Criterion, Numbered, blocks, by_few, empty, grown, improved, ordered
from lmeasure.robots.identification.identify import freed
from lmeasure.robots.identification.measurements import POSITION, measured
from lmeasure.robots.identification.problem import Fit
from lmeasure.robots.identification.unknowns import Frames, R, Unknowns
from lmeasure.text import Message, message

DETERMINED = 0.3
"""Standard uncertainty, as a part of its prior's, up to which a parameter counts as determined by the measurements."""
SILENT = 1.0
"""Information of the measurements, in that of the prior, below which a direction is held by nominal values."""
MENTIONED = 0.05
"""Smallest component of a direction that is mentioned, as a part of the largest."""
PLACED = 0.05
"""Motion [mm or deg] of a frame with a direction from which it is named as compensating."""


@dataclass(frozen=True)
class UnobservableDirection:
    """A combination of parameters that the measurements leave free: changes by name, in the units of the names, for one prior standard
    uncertainty of the first."""

    direction: dict[str, float]
    said: Message

    @property
    def text(self) -> str:
        """Return the message, whose text is English."""
        return self.said


def determined_parameters(fit: Fit[R]) -> BoolArray:
    """(p,) whether the measurements determine an unknown by itself."""
    return np.asarray(np.sqrt(np.diag(fit.covariance)) < DETERMINED * fit.problem.width)


def unobservable_directions(fit: Fit[R]) -> list[UnobservableDirection]:
    """Combinations that leave every measured value as it is, each with as few parameters as can be; those of few first."""
    unknowns, width = fit.problem.unknowns, fit.problem.width
    free, names = len(unknowns.freed), unknowns.names
    white = fit.information * np.outer(width, width)
    own, cross, frames = white[:free, :free], white[:free, free:], white[free:, free:]
    # common errors of the instrument are not a frame: their own size limits them
    shared = np.arange(free, len(names)) >= unknowns.asked
    frames = frames + np.diag(shared.astype(np.float64))
    size = np.sqrt(np.maximum(np.diag(frames), 1e-300))
    follow = -np.linalg.pinv(frames / np.outer(size, size), rcond=1e-12, hermitian=True) @ (cross / size).T / size[:, None]
    values, vectors = np.linalg.eigh(own + cross @ follow)
    basis = vectors[:, values < SILENT].T
    if len(basis) == 0:
        return []
    out = []
    for row, pivot in zip(*by_few(basis), strict=True):
        strong = [i for i in np.argsort(-np.abs(row), kind="stable") if abs(row[i]) > MENTIONED * np.abs(row).max()]
        change = row * width[:free]
        moved = (follow @ row) * width[free:]
        with_it = sorted({names[free + i].split(".")[0] for i in np.flatnonzero((np.abs(moved) > PLACED) & ~shared)})
        parts = tuple(message("identify.moved", name=names[i], by=float(change[i])) for i in sorted(strong, key=lambda i: (i != pivot, i)))
        if with_it:
            frames_said = tuple(_plain(name) for name in with_it)
            why = message("identify.silent.frames" if len(frames_said) > 1 else "identify.silent.frame", frames=frames_said)
        else:
            why = message("identify.silent.alone" if len(strong) == 1 else "identify.silent.together")
        out.append(UnobservableDirection({names[i]: float(change[i]) for i in strong}, message("identify.silent", moves=parts, why=why)))
    return sorted(out, key=lambda s: len(s.direction))


def unknown_frames(fit: Fit[R]) -> list[UnobservableDirection]:
    """Report frames that the measurements do not determine completely, and orientations that were not measured."""
    unknowns = fit.problem.unknowns
    free, sigma = len(unknowns.freed), np.sqrt(np.diag(fit.covariance))
    loose = [i for i in range(free, unknowns.asked) if sigma[i] > DETERMINED * fit.problem.width[i]]
    out = [UnobservableDirection({unknowns.names[i]: float(sigma[i])}, message("identify.untold", name=unknowns.names[i])) for i in loose]
    if not unknowns.based:
        out.append(UnobservableDirection({}, message("identify.untold.base")))
    if not unknowns.turned.any():
        out.append(UnobservableDirection({}, message("identify.untold.turn")))
    return out


def _plain(owner: str) -> Message:
    """Return the name of a frame."""
    if owner in ("base", "tool", "instrument"):
        return message(f"identify.frame.{owner}")
    kind, _, name = owner.partition("_")
    return message(f"identify.frame.{kind}", name=name)


FAR_MM, FAR_RAD = 1e3, 1.0
"""Prior of unknown frames while poses are chosen: wide enough, and the first poses are not lost in rounding."""
PLANNED_FOR = ("links", "once", "twice")
RANDOM = 20


@dataclass(frozen=True)
class Plan:
    """order (k,): chosen candidates, the most informative first; expected_mm, random_mm (k,): root mean square over the zone of a
    position's uncertainty by identification after as many of them, and after as many at random, the median of `RANDOM` sets."""

    order: IntArray
    expected_mm: FloatArray
    random_mm: FloatArray


def to_plan(robot: R, families: Sequence[str], base: FloatArray, tool: FloatArray, *, joints: FloatArray) -> Unknowns[R]:
    """Return the unknowns of positions to be measured at joint values, the planned ones beside the freed ones; base, tool (7,): assumed
    frames."""
    rows = measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints))
    frames = Frames(base, tool[None], np.zeros((0, 3)), 0.0, np.ones(len(joints), np.bool_))
    return Unknowns(robot, freed(robot, (*PLANNED_FOR, *families)), frames, rows)


def chosen(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, *, u_mm: float) -> IntArray:
    """Return (count,) candidates (N, n) joint values that, measured with u_mm in each coordinate, leave the least mean variance of
    predicted positions at the joint values `zone` (M, n) (I-optimality), the most informative first."""
    return planned(unknowns, candidates, zone, count, u_mm=u_mm).order


def planned(unknowns: Unknowns[R], candidates: FloatArray, zone: FloatArray, count: int, *, u_mm: float, seed: int = 0) -> Plan:
    """Return `chosen` with its expected uncertainty."""
    determined = blocks(_sensitivity(unknowns, candidates), np.full(3, u_mm**2))
    criterion = Criterion("I", _sensitivity(unknowns, zone).reshape(-1, len(unknowns)))
    rng = np.random.default_rng(seed)
    width = np.minimum(unknowns.width, np.where(unknowns.size == 1.0, FAR_MM, FAR_RAD))
    start = empty(Numbered(determined), np.diag((unknowns.size / width) ** 2))
    design = ordered(improved(grown(start, count, criterion, rng), criterion, rng), criterion)

    def after(numbers: IntArray) -> FloatArray:
        """(k,) rms [mm] of a place's three coordinates together, after each of the poses."""
        M, out = start.before, []
        for i in numbers:
            M = M + determined[i].T @ determined[i]
            out.append(np.sqrt(3.0 * criterion.value(M)))
        return np.array(out)

    order = design.points[:, 0].astype(np.int64)
    random = [after(rng.permutation(len(determined))[: len(order)]) for _ in range(RANDOM)]
    return Plan(order, after(order), np.median(random, axis=0))


def _sensitivity(unknowns: Unknowns[R], joints: FloatArray) -> FloatArray:
    """(N, 3, p) derivatives of the first target's place by the unknowns in the units of their names."""
    rows = replace(measured(joints, np.zeros((len(joints), 3)), side=np.zeros_like(joints)), targets=unknowns.rows.targets)
    return unknowns.linearised(np.zeros(len(unknowns)), rows)[1][:, POSITION] * unknowns.size
