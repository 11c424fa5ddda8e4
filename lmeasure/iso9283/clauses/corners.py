"""Cornering round-off and overshoot (clause 8.5): how near a robot comes to them, and how far beyond the next line it goes.

The overshoot is the largest of all samples behind a corner. For a robot that stays on the line that is the largest of as many errors,
without a true overshoot. So the law of its error is drawn at the deviations of all samples that may be the largest in truth, not only near
the largest measured one.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import scipy

from lmeasure.core import CertificationError, FloatArray, IntArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, SampleErrors
from lmeasure.iso9283.clauses.path import DOUBT_OF_MEAN
from lmeasure.iso9283.figure import Figure, Maker, Subject, reduced as less
from lmeasure.iso9283.paths import FINER, Crossings, Cycle, finer, share
from lmeasure.iso9283.sample_gaps import EDGE, Between, Chords, at_corner as read_at_corner, between, of_samples, with_hidden
from lmeasure.iso9283.uncertainty import Part
from lmeasure.text import message
from lmeasure.trajectory import PoseErrors, kept_over

ABOUT = 7  # samples on either side of the farthest, between which it is looked for
NEAR = 50  # samples on either side of the nearest that a corner is seen by
MOST_BEHIND = 300
"""Samples behind a corner: of more, means of neighbours are taken."""
REACH = 8.0
"""Standard deviations below the farthest sample beyond which none can be the farthest in any draw."""
INSIDE = 4.0
"""Standard deviations on the inner side of the line beyond which a sample has not reached it yet."""
CHANCE = 0.01
"""Probability with which errors alone look like an overshoot."""
NOWHERE = -1e9  # mm


@dataclass(frozen=True)
class Corner:
    """A corner of a path: number, its place (3,) [mm], unit directions (3,) into it and out of it, and how far each line goes [mm]."""

    number: int
    place: FloatArray
    incoming: FloatArray
    outgoing: FloatArray
    way_mm: float
    before_mm: float
    after_mm: float

    @property
    def side(self) -> FloatArray:
        """(3,) unit direction of the first line, normal to the second."""
        across = self.incoming - (self.incoming @ self.outgoing) * self.outgoing
        return np.asarray(across / np.linalg.norm(across))


def corners_of(crossings: Crossings) -> list[Corner]:
    """The corners between the straight lines of a path."""
    turns = crossings.line.turns()
    if not turns:
        return []
    points, arc = crossings.line.corners, crossings.line.arc
    steps = np.diff(points, axis=0)
    lengths = np.linalg.norm(steps, axis=1)
    units = steps / lengths[:, None]
    return [
        Corner(
            number=i,
            place=points[i],
            incoming=units[i - 1],
            outgoing=units[i],
            way_mm=float(arc[i]),
            before_mm=float(lengths[i - 1]),
            after_mm=float(lengths[i]),
        )
        for i in turns
    ]


@dataclass(frozen=True)
class Passing:
    """Passage of a corner by a cycle.

    nearest (3,) from the corner to the nearest point of the path, at part of the step between two samples; behind: its samples from the one
    before the nearest point on, half way to the next corner; beyond (k,) [mm]: how far they, or the means of so many neighbours each, lie
    beyond the second line, in steps of step_mm between samples. hidden: the steps from the one before the nearest point on; ends (k + 1, 3)
    [mm]: the samples of these, from the corner; about_mm: the largest step next to the nearest point; chords: the steps about
    it.
    """

    nearest: FloatArray
    part: float
    behind: slice
    beyond: FloatArray
    neighbours: int
    step_mm: float
    hidden: Between | None = None
    ends: FloatArray = field(default_factory=lambda: np.zeros((0, 3)))
    about_mm: float = 0.0
    chords: Chords | None = None
    of_curve: bool = False

    def unseen(self, corner: Corner, covariance: FloatArray, u_time_s: float) -> tuple[FloatArray, float]:
        """Return the possible error (3,) [mm] of the nearest point along its direction from the corner, and how far beyond its samples [mm]
        the path may go behind the second line, for samples of this covariance (3, 3) [mm²] and uncertainty of times."""
        if self.hidden is None or len(self.ends) == 0:
            return np.zeros(3), 0.0
        bound, where = self.hidden.bound(covariance, u_time_s)
        distance = float(np.linalg.norm(self.nearest))
        known = read_at_corner(distance, self.about_mm, float(corner.incoming @ corner.outgoing))
        off = known if self.of_curve else max(float(np.linalg.norm(bound[:3], axis=1).max()), known)
        if self.chords is not None:
            outside = float(self.nearest @ (corner.incoming - corner.outgoing)) > 0.0
            nearest, farthest = self.chords.passes(float(np.sqrt(np.trace(covariance))), u_time_s, outside=outside)
            off = min(off, EDGE * max(distance - nearest, farthest - distance, 0.0))
        apex = (self.ends[:-1] + where[:, None] * np.diff(self.ends, axis=0) + bound) @ corner.side
        there = np.linalg.norm(bound, axis=1) > 0.0
        beyond = float(apex[there].max(initial=-np.inf)) - max(float(self.beyond.max()), 0.0)
        if self.of_curve and there.any():
            # a curve that goes farther than the samples about a kink may swing there
            farther = float(self.beyond.max()) - max(float((self.ends @ corner.side).max()), 0.0)
            beyond = max(beyond, min(EDGE * farther, float(np.linalg.norm(bound, axis=1).max())))
        return self.nearest / max(distance, 1e-300) * off, max(beyond, 0.0)


def at_corner(cycle: Cycle, corner: Corner, what: str) -> Passing:
    """Return the passing of a corner by a cycle; what: the name of the cycle in a CertificationError."""
    near = np.flatnonzero((cycle.way_mm > corner.way_mm - 0.5 * corner.before_mm) & (cycle.way_mm < corner.way_mm + 0.5 * corner.after_mm))
    if len(near) < 2:
        raise CertificationError(message("error.has_samples_within_half", where=what, n_near=len(near), number=corner.number))
    positions = cycle.poses[near[0] : near[-1] + 1, :3] - corner.place
    closest = int(np.argmin((positions**2).sum(axis=1)))
    first = max(closest - NEAR, 0)
    fine = finer(positions[first : closest + NEAR + 1], kinks=True)
    steps = np.diff(fine, axis=0)
    square = np.maximum((steps**2).sum(axis=1), 1e-300)
    part = np.clip(-(fine[:-1] * steps).sum(axis=1) / square, 0.0, 1.0)
    feet = fine[:-1] + part[:, None] * steps
    nearest = int(np.argmin((feet**2).sum(axis=1)))
    i = first + nearest // FINER
    after = positions[i:]
    size = -(-len(after) // MOST_BEHIND)
    whole = len(after) // size * size
    beyond = (after[:whole] @ corner.side).reshape(-1, size).mean(axis=1)
    step = float(np.median(np.linalg.norm(np.diff(after, axis=0), axis=1)))
    part_of_step = (nearest + float(part[nearest])) % FINER / FINER
    behind = slice(int(near[0]) + i, int(near[-1]) + 1)
    # motion can hide only between measured samples
    read = cycle.measured
    read = read[(read >= near[0]) & (read <= near[-1])] - near[0]
    read = np.arange(len(positions)) if len(read) < 2 else read
    measured, times = positions[read], cycle.time_s[near[0] + read]
    j = max(int(np.searchsorted(read, i, side="right")) - 1, 0)
    begin, last = min(max(j - 1, 0), len(read) - 2), len(read) - 1
    every = np.linalg.norm(np.diff(measured[max(j - 2, 0) : j + 4], axis=0), axis=1)
    hidden = between(times, measured)[np.arange(begin, last)]
    middle = max(int(np.searchsorted(read, closest, side="right")) - 1, 0)
    about = slice(max(middle - NEAR, 0), middle + NEAR + 1)
    return Passing(
        nearest=feet[nearest],
        part=part_of_step,
        behind=behind,
        beyond=beyond,
        neighbours=size,
        step_mm=step,
        hidden=hidden,
        ends=measured[begin:],
        about_mm=float(every.max(initial=0.0)),
        chords=Chords.about(times[about], measured[about]),
        of_curve=cycle.read is not None,
    )


def passings(crossings: Crossings) -> Iterator[tuple[Corner, tuple[Passing, ...]]]:
    """The corners of a path, and how each cycle passes them."""
    name = crossings.line.path.name
    for corner in corners_of(crossings):
        yield corner, tuple(at_corner(cycle, corner, f"path {name}, cycle {j}") for j, cycle in enumerate(crossings.cycles, 1))


@dataclass(frozen=True, kw_only=True)
class CornerTest(IsoTest):
    """CR and CO of a corner of a path, which its cycles passed (n,) at samples (n,); behind: the samples of each behind it, as many as its
    `Passing.beyond` has places."""

    corner: Corner
    passed: tuple[Passing, ...]
    at: IntArray
    behind: tuple[IntArray, ...] = ()
    u_time_s: float = 0.0

    @property
    def key(self) -> Subject:
        """Return the subject of its states."""
        return Subject("corner", self.subject.name, self.corner.number)

    def samples(self) -> IntArray:
        return self.at

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        of_cycles = errors(self.at)
        every = errors(np.concatenate([self.at, *self.behind])) if of_cycles.joint else None
        return {self.key: CornerPart(self.corner, self.passed, of_cycles, self.u_time_s, every)}

    def figures(self) -> list[Figure]:
        key = self.key
        make = Maker(cycles=len(self.passed), needs=(self.subject,), path=key.name, part=f"corner {self.corner.number}")
        return [
            make.one("CR", "8.5", "mm", lambda s: iso.cornering_round_off(s[key][0]), extreme=True),
            make.one("CO", "8.5", "mm", lambda s: iso.cornering_overshoot(s[key][1], np.ones(1)), extreme=True),
        ]


def tests(attained: Attainment) -> Iterator[CornerTest]:
    """Return the tests of every corner of every path that has windows."""
    for name, crossed in attained.paths.items():
        for corner, passed in passings(crossed):
            at = np.array([c.samples[p.behind.start] for c, p in zip(crossed.cycles, passed, strict=True)], dtype=np.int64)
            behind = tuple(
                c.samples[p.behind][p.neighbours // 2 :: p.neighbours][: len(p.beyond)] for c, p in zip(crossed.cycles, passed, strict=True)
            )
            yield CornerTest(
                subject=Subject("path", name), corner=corner, passed=passed, at=at, behind=behind, u_time_s=attained.stamps.u_time_s
            )


@dataclass(frozen=True)
class CornerPart:
    """Passages of n cycles at a corner with the law of the errors of one sample there (n poses); see `uncertainty.Part`. every: of a
    curve, the errors of the nearest samples and of all behind them.

    The state is the vectors (..., n, 3) [mm] to the nearest points, and how far beyond the second line (..., n, k, 1) [mm] the path lies:
    between samples about the farthest, and at all other samples that may be the farthest in truth.
    """

    corner: Corner
    passed: tuple[Passing, ...]
    of_cycles: PoseErrors
    u_time_s: float = 0.0
    every: PoseErrors | None = None
    _used: list[IntArray] = field(init=False, default_factory=list)
    _about: list[FloatArray] = field(init=False, default_factory=list)
    _others: list[FloatArray] = field(init=False, default_factory=list)
    _share: list[FloatArray] = field(init=False, default_factory=list)

    def __post_init__(self) -> None:
        e, side = self.of_cycles, self.corner.side
        across = np.einsum("i,nij->nj", side, e.own[:, 3:])
        random = (across**2).sum(axis=1)
        common = ((side @ e.factors[:, 3:]) ** 2).sum(axis=1)
        rows, first = [], len(self.passed)
        for cycle, p in enumerate(self.passed):
            root = None
            if self.every is None:
                kept = float(kept_over(e, np.array([p.step_mm]))[cycle])
                of_mean = kept + (1.0 - kept) / p.neighbours
            else:
                of_mean, there = 1.0, self.every[np.arange(first, first + len(p.beyond))]
                root = np.einsum("i,nij->nj", side, np.concatenate([there.local[:, 3:], there.shared[:, 3:]], axis=2))
                random[cycle] = ((side @ there.own[:, 3:]) ** 2).sum(axis=1).mean() + (root**2).sum(axis=1).mean()
            self._share.append(np.array(of_mean))
            likely = _likely(p.beyond, of_mean * random[cycle], common[cycle], root)
            top = int(np.argmax(p.beyond))
            begin = int(np.clip(top - ABOUT, 0, max(len(likely) - 2 * ABOUT - 1, 0)))
            about = np.minimum(begin + np.arange(2 * ABOUT + 1), len(likely) - 1)
            reach = REACH * np.sqrt(of_mean * random[cycle])
            others = np.setdiff1d(np.flatnonzero(likely >= likely.max() - reach), about)
            self._used.append(first + np.concatenate([about, others]))
            first += len(p.beyond)
            rows.append((np.stack([p.beyond, likely]), about, others))
        most = max(len(others) for _, _, others in rows)
        for state in (0, 1):
            self._about.append(np.array([values[state, about] for values, about, _ in rows]))
            filled = np.full((len(rows), most), NOWHERE)
            for row, (values, _, others) in zip(filled, rows, strict=True):
                row[: len(others)] = values[state, others]
            self._others.append(filled)

    @property
    def positions(self) -> FloatArray:
        """See `uncertainty.Part`: about the corner."""
        return np.tile(self.corner.place, (len(self.passed) * (1 + self._about[0].shape[1] + self._others[0].shape[1]), 1))

    @property
    def errors(self) -> PoseErrors:
        """Return the values of the n nearest points, read between samples, and the n k others: the largest of many has a bias."""
        n, k = len(self.passed), self._about[0].shape[1] + self._others[0].shape[1]
        if self.every is not None:
            # rows that others fill have no size: any errors do
            used = [np.pad(of, (0, k - len(of)), mode="edge") for of in self._used]
            return self._hidden(self.every[np.concatenate([np.arange(n), *used])], k)
        every = self.of_cycles[np.concatenate([np.arange(n), np.repeat(np.arange(n), k)])]
        of_one = np.concatenate([share(np.array([p.part for p in self.passed])), np.repeat(np.array(self._share), k)])
        # means of several roundings are nearly normal, and have longer tails than one
        single = all(p.neighbours == 1 for p in self.passed)
        read = replace(every, own=np.sqrt(of_one)[:, None, None] * every.own, rounded=every.rounded and single)
        return self._hidden(read, k)

    def _hidden(self, read: PoseErrors, k: int) -> PoseErrors:
        unseen = [p.unseen(self.corner, c, self.u_time_s) for p, c in zip(self.passed, of_samples(self.of_cycles), strict=True)]
        beyond = np.repeat([b for _, b in unseen], k)[:, None] * self.corner.side
        return with_hidden(read, np.zeros((len(read), 3)), np.concatenate([np.array([off for off, _ in unseen]), beyond]))

    def state(self, errors: FloatArray, reduced: bool) -> tuple[FloatArray, FloatArray]:
        n, moved = len(self.passed), errors[..., 3:]
        about, others = self._about[int(reduced)], self._others[int(reduced)]
        away = (moved[..., n:, :] @ self.corner.side).reshape(*moved.shape[:-2], n, -1)
        fine = finer((about + away[..., : about.shape[1]])[..., None], kinks=True)
        nearest = np.array([p.nearest for p in self.passed]) + moved[..., :n, :]
        return nearest, np.concatenate([fine, (others + away[..., about.shape[1] :])[..., None]], axis=-2)


def _likely(beyond: FloatArray, random: float, common: float, root: FloatArray | None = None) -> FloatArray:
    """Return (k,) deviations as likely as the measured ones (k,), which have a random variance each and a common one, or errors root z,
    root (k, q).

    On the inner side, where the path comes from, it may jump, and nothing there can be the farthest beyond: waves begin behind it. A robot
    no farther beyond than errors alone explain is taken to stay on the line.
    """
    beyond = beyond.copy()
    near = np.flatnonzero(beyond >= -INSIDE * np.sqrt(random + common))
    if len(near):
        part = slice(int(near[0]), int(near[-1]) + 1)
        waves = scipy.fft.dct(beyond[part], norm="ortho")[:, None, None]
        added = np.full((len(waves), 1), random)
        added[0] += len(waves) * common
        if root is not None:
            added = (scipy.fft.dct(root[part], axis=0, norm="ortho") ** 2).sum(axis=1, keepdims=True)
        of_errors = np.sqrt(random) * scipy.stats.norm.isf(CHANCE / len(waves)) + np.sqrt(common) * scipy.stats.norm.isf(CHANCE)
        likely = np.asarray(scipy.fft.idct(less(waves, added, 1, DOUBT_OF_MEAN)[:, 0, 0], norm="ortho"))
        if beyond.max() <= of_errors:
            likely[likely >= -np.sqrt(random + common)] = 0.0
        beyond[part] = likely
    return beyond


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="CR", label="cornering round-off error", summary={"CR": 90}),
        Quantity(symbol="CO", label="cornering overshoot", summary={"CO": 140}),
    ),
)
