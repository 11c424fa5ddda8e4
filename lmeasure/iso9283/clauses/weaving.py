"""Weaving deviations (clause 11), from the strokes that each cycle makes across its path."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from lmeasure.core import CertificationError, FloatArray, IntArray
from lmeasure.iso9283 import formulas as iso
from lmeasure.iso9283.attainment import Attainment
from lmeasure.iso9283.clause import Clause, IsoTest, Quantity, SampleErrors
from lmeasure.iso9283.figure import Figure, Maker, OfInstants, Subject
from lmeasure.iso9283.motion_readings import WITHOUT_HALF
from lmeasure.iso9283.paths import FINER, Crossings, Cycle, finer
from lmeasure.iso9283.uncertainty import Part
from lmeasure.recording import CommandedPath
from lmeasure.text import message
from lmeasure.trajectory import PoseErrors, Stamps, of_neighbours

FAR = 0.1
"""Smallest part of a cycle's sway, or of the commanded stroke, that is an excursion to a side and not noise about the middle."""
ABOUT, PART = 7, 6
"""Samples on either side of the farthest that may be the farthest in truth: so many at most, and a sixth of the stroke's."""
RESOLVED = 3.0
"""Percent that every other sample takes off a stroke at most, where the samples resolve it."""
SEEN = 3
"""Samples on either side of the farthest by which the value between them is read, fewer if there are fewer."""


@dataclass(frozen=True)
class Weave:
    """A cycle's way across its path, in the direction (3,) in which it sways most: rows of samples (q, k) about the farthest of each stroke
    and, the last two, of all, which in truth is within width of the middle one; y (q, k) [mm] and side (q,) of the middle; edges (2, 2):
    samples before and behind the first and the last crossing of the middle, at times edge_s (2, 2) [s] and edge_y (2, 2) [mm];
    positions (q, k, 3) and edge_positions (2, 2, 3) [mm]."""

    direction: FloatArray
    samples: IntArray
    positions: FloatArray
    y: FloatArray
    width: int
    side: FloatArray
    edges: IntArray
    edge_positions: FloatArray
    edge_y: FloatArray
    edge_s: FloatArray

    @property
    def strokes(self) -> int:
        """Return how many strokes lie between the crossings of the middle."""
        return len(self.y) - 2


def weaves(crossed: Crossings, stroke_mm: float) -> list[Weave]:
    """Each cycle's strokes, from one side of the middle line to the other; CertificationError when there are fewer than two."""
    out = []
    for number, cycle in enumerate(crossed.cycles, 1):
        inside = (cycle.way_mm > 0.0) & (cycle.way_mm < crossed.line.length)
        samples, time_s, positions = cycle.samples[inside], cycle.time_s[inside], cycle.poses[inside, :3]
        # normal to the line: a sample's way is that of the nearest point
        away = positions - crossed.line.at(cycle.way_mm[inside])[0]
        direction = np.linalg.svd(away - away.mean(axis=0), full_matrices=False)[2][0]
        y = away @ direction
        middle = y - 0.5 * (y.max() + y.min())
        before = _before_crossings(middle, FAR * max(float(y.max() - y.min()), stroke_mm))
        if len(before) < 3:
            what = f"path {crossed.line.path.name}, cycle {number}"
            raise CertificationError(message("error.has_strokes_across_the", where=what, value=max(len(before) - 1, 0)))
        begin, end = before[:-1] + 1, before[1:] + 1
        top = np.array([a + int(np.argmax(np.abs(middle[a:b]))) for a, b in zip(begin, end, strict=True)])
        width = int(np.clip(np.min(end - begin) // PART, 1, ABOUT))
        every = np.concatenate([top, [int(np.argmax(y)), int(np.argmin(y))]])
        seen = max(width, SEEN)
        about = np.clip(every[:, None] + np.arange(-seen, seen + 1), 0, len(y) - 1)
        edges = before[[0, -1], None] + np.arange(2)
        side = np.concatenate([np.sign(middle[top]), [1.0, -1.0]])
        out.append(
            Weave(
                direction=direction,
                samples=samples[about],
                positions=positions[about],
                y=y[about],
                width=width,
                side=side,
                edges=samples[edges],
                edge_positions=positions[edges],
                edge_y=y[edges],
                edge_s=time_s[edges],
            )
        )
    return out


def _before_crossings(y: FloatArray, least: float) -> IntArray:
    """(k,) samples behind which y goes through zero, between excursions of at least `least` to either side."""
    far = np.flatnonzero(np.abs(y) >= least)
    changed = np.flatnonzero(np.sign(y[far[1:]]) != np.sign(y[far[:-1]]))
    # the last change of sign between two excursions
    pairs = [(far[i], far[i + 1]) for i in changed]
    return np.array([a + np.flatnonzero(np.sign(y[a:b]) != np.sign(y[a + 1 : b + 1]))[-1] for a, b in pairs], dtype=np.int64)


@dataclass(frozen=True)
class WeavePart:
    """The weaves of a path's cycles with the law of the errors of their samples (n,); see `uncertainty.Part`."""

    cycles: tuple[Weave, ...]
    errors: PoseErrors

    @property
    def positions(self) -> FloatArray:
        """See `uncertainty.Part`: cycle by cycle, rows, then edges."""
        return np.concatenate([np.concatenate([c.positions.reshape(-1, 3), c.edge_positions.reshape(-1, 3)]) for c in self.cycles])

    @classmethod
    def of(cls, cycles: tuple[Weave, ...], errors: PoseErrors) -> "WeavePart":
        """Return the part with the errors of single samples; rounded counts are common to neighbouring samples."""
        if not errors.rounded:
            return cls(cycles, errors)
        step, row, first = [], [], 0
        for c in cycles:
            for rows in (c.positions, c.edge_positions):
                q, k, _ = rows.shape
                each = np.linalg.norm(np.diff(rows, axis=1), axis=2).max(axis=1)
                step.append(np.repeat(each, k))
                row.append(np.repeat(first + np.arange(q), k))
                first += q
        return cls(cycles, of_neighbours(errors, np.concatenate(step), np.concatenate(row)))

    def state(self, errors: FloatArray, reduced: bool) -> tuple[list[FloatArray], list[FloatArray]]:
        """See `uncertainty.Part`: farthest (..., q) [mm] of each cycle's rows, and times (..., 2) [s] at which it crosses the middle first
        and last; likely are the parabolas through the rows, where they are of a small part of a stroke."""
        far, times, first = [], [], 0
        for c in self.cycles:
            y = c.y
            if reduced and c.width >= SEEN:
                powers = np.linspace(-1.0, 1.0, y.shape[1])[:, None] ** np.arange(3)
                y = y @ (powers @ np.linalg.pinv(powers)).T
            moved = errors[..., first : first + y.size + 4, 3:] @ c.direction
            first += y.size + 4
            rows = y + moved[..., : y.size].reshape(*moved.shape[:-1], *y.shape)
            within = slice(FINER * (y.shape[1] // 2 - c.width), FINER * (y.shape[1] // 2 + c.width) + 1)
            farthest = c.side * finer(c.side[:, None, None] * rows[..., None], kinks=False)[..., within, 0].max(axis=-1)
            level = 0.5 * (farthest.max(axis=-1) + farthest.min(axis=-1))[..., None]
            edge = c.edge_y + moved[..., y.size :].reshape(*moved.shape[:-1], 2, 2)
            part = (edge[..., 0] - level) / (edge[..., 0] - edge[..., 1])
            times.append(c.edge_s[:, 0] + part * (c.edge_s[:, 1] - c.edge_s[:, 0]))
            far.append(farthest)
        return far, times


@dataclass(frozen=True, kw_only=True)
class WeaveTest(IsoTest):
    """WS of a weave on a path, WF where a speed is commanded. fewer: its cycles by every other sample; None where those show no weave."""

    path: CommandedPath
    cycles: tuple[Weave, ...]
    stamps: Stamps
    fewer: tuple[Weave, ...] | None = None

    @property
    def key(self) -> Subject:
        """Return the subject of its states."""
        return Subject("weave", self.path.name)

    def samples(self) -> IntArray:
        """See `IsoTest`: cycle by cycle, rows, then edges."""
        return np.concatenate([np.concatenate([c.samples.ravel(), c.edges.ravel()]) for c in self.cycles])

    def parts(self, errors: SampleErrors) -> dict[Subject, Part]:
        return {self.key: WeavePart.of(self.cycles, errors(self.samples()))}

    def figures(self) -> list[Figure]:
        key, stroke, distance = self.key, self.path.weave_stroke_mm, self.path.weave_distance_mm
        assert stroke is not None
        assert distance is not None
        make = Maker(cycles=len(self.cycles), needs=(self.subject,), path=key.name)
        between = self._between_percent(stroke)
        out = [make.one("WS", "11", "%", lambda s: iso.weaving_stroke_error(_strokes(s[key][0]), stroke), between=between)]
        if self.path.speed_mm_s is not None:
            commanded = self.path.speed_mm_s / distance
            of = make.one(
                "WF", "11", "%", lambda s: iso.weaving_frequency_error(self._rates(s[key][1]), commanded), instants=self._of_instants
            )
            out.append(of)
        return out

    def _between_percent(self, stroke_mm: float) -> float:
        """Return the error of WS [%] by crests between samples: the change of strokes without every other sample, by the cubics' own order
        if that is small."""
        if self.fewer is None:
            return 100.0
        every, half = (float(iso.weaving_stroke_error(_strokes(_farthest(c)), stroke_mm)) for c in (self.cycles, self.fewer))
        apart = abs(every - half)
        return apart / WITHOUT_HALF if apart < RESOLVED else apart

    def _rates(self, times: list[FloatArray]) -> FloatArray:
        """(..., n) weaves per second of cycles that cross the middle first and last at times (..., 2)."""
        return np.stack([0.5 * c.strokes / (t[..., 1] - t[..., 0]) for c, t in zip(self.cycles, times, strict=True)], axis=-1)

    def _of_instants(self, value: float) -> OfInstants:
        """Both ends of each cycle, and the rate that all have in common."""
        lasted = np.array([end - start for start, end in self.path.windows_s])
        of_ends = np.sqrt(2.0 * np.mean(lasted**-2.0) / len(self.cycles)) * self.stamps.u_time_s
        return OfInstants(float((100.0 + value) * np.hypot(of_ends, self.stamps.u_rate)))


def _farthest(cycles: tuple[Weave, ...]) -> list[FloatArray]:
    """Farthest places (q,) of each cycle's rows, as measured."""
    part = WeavePart(cycles, PoseErrors.of(np.zeros((0, 6, 0)), np.zeros((0, 6, 0))))
    return part.state(np.zeros((sum(c.y.size + 4 for c in cycles), 6)), reduced=False)[0]


def _of_every_other(crossed: Crossings, stroke_mm: float) -> tuple[Weave, ...] | None:
    """The weaves that every other sample of each cycle shows."""
    every = [c.measured[::2] for c in crossed.cycles]
    cycles = tuple(Cycle(c.samples[r], c.time_s[r], c.poses[r], c.way_mm[r]) for c, r in zip(crossed.cycles, every, strict=True))
    try:
        return tuple(weaves(replace(crossed, cycles=cycles), stroke_mm))
    except CertificationError:
        return None


def _strokes(far: list[FloatArray]) -> FloatArray:
    """(..., n) mean stroke [mm] of each cycle, from the farthest places of its strokes."""
    return np.stack([np.abs(np.diff(f[..., :-2], axis=-1)).mean(axis=-1) for f in far], axis=-1)


def tests(attained: Attainment) -> Iterator[WeaveTest]:
    """Return the tests of every path with a weave that has windows."""
    for path in attained.program.path:
        if path.weave_stroke_mm is not None and path.name in attained.paths:
            cycles = tuple(weaves(attained.paths[path.name], path.weave_stroke_mm))
            fewer = _of_every_other(attained.paths[path.name], path.weave_stroke_mm)
            yield WeaveTest(subject=Subject("path", path.name), path=path, cycles=cycles, stamps=attained.stamps, fewer=fewer)


CLAUSE = Clause(
    tests=tests,
    quantities=(
        Quantity(symbol="WS", label="weaving stroke error", summary={"WS": 220}, signed=("WS",)),
        Quantity(symbol="WF", label="weaving frequency error", summary={"WF": 230}, signed=("WF",)),
    ),
)
