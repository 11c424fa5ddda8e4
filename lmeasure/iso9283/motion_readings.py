"""Figures that are read from stretches of a motion: values between samples, and errors from the counts.

Between samples a motion is the cubic spline through them. Its own error follows from omitting every other sample: for a motion with three
derivatives that is seven times as large (Richardson). Errors of counts are drawn as roundings of lengths: a draw sets where within a count
the lengths of a place lie, and the lengths' changes along the stretch determine the rounding of each sample. So samples of a robot that
creeps, and cycles that come to rest within a count of each other, are rounded alike. Errors of another kind are taken for roundings as
large: they stay while the robot rests and change when it moves on.
"""

import itertools
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy

from lmeasure.core import BoolArray, CertificationError, FloatArray, IntArray, se3
from lmeasure.iso9283.characteristic import CertificationSettings, Characteristic, CharacteristicKey, Contribution
from lmeasure.iso9283.uncertainty import COVERAGE, NORMAL_95, drawn_errors, reduction
from lmeasure.recording import CommandedPath, CommandedPose, Program
from lmeasure.text import Message, message
from lmeasure.trajectory import LEAST_S, Frame, PoseErrors, Stamps, Trajectory, phases, rests, roundings, settled, window

FINE_S = 2.5e-4
"""Steps in which a motion is read between samples."""
MOST_PIECES = 64
FINER_THAN = 0.25
"""Longest step as a part of a limit, so that no passage of it is missed."""
WITHOUT_HALF = 7.0
"""Times as far off as the spline is that of every other sample, by its third derivatives."""
FEWER_ERR = 2.0
"""U95 by which a figure of every other sample may differ by errors of counts alone."""
SMOOTHED, DEGREE = 9, 4
"""Samples and degree of the polynomials that remove roundings from a stretch."""
MARGIN = 12
"""Samples beyond which a spline is not affected: 0.27 per sample."""
AT_REST = 0.1
"""Last part of a window, in which the robot is taken to rest."""
REST_SAMPLES = 20
FAR = 5.0
"""Standard deviations that an error does not reach."""
DRAWN_AT_ONCE = 500_000


@dataclass(frozen=True)
class Stretch:
    """Consecutive samples (k,) of a trajectory: time_s (k,) [s] and poses (k, 7) of the certified point. places: samples (i,), counted from
    the first of the stretch, at each reference place of the figure."""

    samples: IntArray
    time_s: FloatArray
    poses: FloatArray
    places: tuple[IntArray, ...]

    @classmethod
    def begun(cls) -> IntArray:
        """The place where a stretch begins."""
        return np.zeros(1, dtype=np.int64)

    @classmethod
    def rested(cls, samples: int) -> IntArray:
        """The place where a stretch of so many samples comes to rest; of very many samples there some."""
        last = max(1, int(AT_REST * samples))
        return np.unique(np.linspace(samples - last, samples - 1, min(last, REST_SAMPLES)).astype(np.int64))

    def moved(self, place: IntArray) -> FloatArray:
        """(k, 6) how far (rotation [rad]; position [mm]) the stretch is from a place, roundings smoothed away."""
        to = np.zeros((len(self.samples), 6))
        if not np.isnan(self.poses[0, 3]):
            turn = se3.rotation(self.poses)
            to[:, :3] = (turn * turn[int(place[0])].inv()).as_rotvec()
        to[:, 3:] = self.poses[:, :3]
        smooth = scipy.signal.savgol_filter(to, SMOOTHED, DEGREE, axis=0) if len(to) >= SMOOTHED else to
        return np.asarray(smooth - smooth[place].mean(axis=0))

    def finer(self, limit_mm: float) -> "Finer":
        """Times between the samples that step by no more than a part of a limit [mm]."""
        steps = np.diff(self.time_s)
        far = float(np.linalg.norm(np.diff(self.poses[:, :3], axis=0), axis=1).max())
        pieces = int(np.clip(np.ceil(max(np.median(steps) / FINE_S, far / (FINER_THAN * limit_mm)) - 1e-6), 1, MOST_PIECES))
        times = self.time_s[:-1, None] + np.arange(pieces) / pieces * steps[:, None]
        return Finer(self.time_s, pieces, np.append(times.ravel(), self.time_s[-1]))


@dataclass(frozen=True)
class Finer:
    """Times time_s (K,) [s] at which a stretch is read, so many pieces to the step from each of its samples (k,) to the next."""

    samples_s: FloatArray
    pieces: int
    time_s: FloatArray

    def read(self, values: FloatArray, every: int = 1) -> FloatArray:
        """Return (K, ...) values at finer times from values (k, ...) at the samples, by the spline through all of them or every other
        one."""
        chosen = np.union1d(np.arange(0, len(values), every), [len(values) - 1])
        return np.asarray(scipy.interpolate.CubicSpline(self.samples_s[chosen], values[chosen])(self.time_s))

    def near(self, sizes: Sequence[FloatArray], limit_mm: float, reach_mm: float, *, largest: bool) -> IntArray:
        """(F,) those at which errors of a reach may bring sizes (K,) to the other side of a limit - largest: or above the largest behind
        the first passage of it - and both ends."""
        near = np.isin(np.arange(len(self.time_s)), [0, len(self.time_s) - 1])
        for size in sizes:
            outside = size > limit_mm
            close = (np.abs(size - limit_mm) <= reach_mm) | np.diff(outside, prepend=outside[:1])
            if largest:
                entered = int(np.argmin(outside))
                close[entered:] |= size[entered:] >= size[entered:].max() - reach_mm
            near |= scipy.ndimage.binary_dilation(close, iterations=self.pieces)
        return np.flatnonzero(near)

    def _steps(self, points: IntArray) -> IntArray:
        return np.minimum(points // self.pieces, len(self.samples_s) - 2)

    def used(self, points: IntArray) -> BoolArray:
        """(k,) which samples `errors` at points (F,) come from."""
        step, used = self._steps(points), np.zeros(len(self.samples_s), np.bool_)
        used[step] = used[step + 1] = True
        return np.asarray(scipy.ndimage.binary_dilation(used, iterations=MARGIN))

    def errors(self, points: IntArray, of_samples: Callable[[IntArray], FloatArray]) -> FloatArray:
        """Return (trials, F, 3) errors at points (F,) from errors of positions, (trials, i, 3) at samples (i,)."""
        step = self._steps(points)
        ends = np.flatnonzero(np.diff(self.used(points), prepend=False, append=False))
        parts = [
            scipy.interpolate.CubicSpline(self.samples_s[a:b], of_samples(np.arange(a, b)), axis=1)(
                self.time_s[points[(step >= a) & (step < b)]]
            )
            for a, b in ends.reshape(-1, 2)
        ]
        return np.concatenate(parts, axis=1)


@dataclass(frozen=True)
class Reading:
    """Reading of results from cycles: `of` makes them (..., q) of times (F,) [s] and vectors (..., F, 3) [mm], one from each place of a
    stretch to the robot, whose sizes (..., F) are compared with a limit [mm].

    never (q,): values if the limit is not reached, in a draw or by every other sample. largest: whether the largest size is a figure.
    origin: the exact point (3,) from which vectors start instead of the only place.
    """

    of: Callable[..., FloatArray]
    size: Callable[[FloatArray], FloatArray]
    limit_mm: float
    never: FloatArray
    largest: bool = False
    origin: FloatArray | None = None

    def reported(self, figures: FloatArray) -> FloatArray:
        """Figures (..., q), those that are NaN being `never`."""
        return np.where(np.isnan(figures), self.never, figures)


@dataclass(frozen=True)
class Reported:
    """Figures (n, q) of n cycles, possible errors of the splines (n, q), and by each law of errors the figures of a likely motion without
    errors (n, q) and with them (trials, n, q). unresolved: as between (n, q), if the samples do not resolve the motion."""

    values: FloatArray
    between: FloatArray
    laws: tuple[tuple[FloatArray, FloatArray], ...]
    unresolved: FloatArray | None = None

    @property
    def reached(self) -> BoolArray:
        """(n,) whether every figure of a cycle could be read."""
        return np.asarray(np.isfinite(self.values).all(axis=1))

    def u95(self, i: int, over: Callable[..., FloatArray], above: float = -np.inf) -> float:
        """Return U95 of figure i over the cycles; the larger of the laws'.

        The part of errors in the scatter of cycles with figures above a value is removed, since otherwise the largest figure would be the
        one with the largest error.
        """
        out = []
        for base, drawn in ((likely[:, i], moved[:, :, i]) for likely, moved in self.laws):
            errors, of_robot, alike = drawn - base, base.copy(), base > above
            if alike.any():
                mean, freedom = base[alike].mean(), max(int(alike.sum()) - 1, 1)
                square = ((base[alike] - mean) ** 2).sum() / freedom
                of_robot[alike] = mean + reduction(square, errors[:, alike].var(axis=0).mean(), freedom) * (base[alike] - mean)
            out.append(float(np.quantile(np.abs(over(of_robot + errors, axis=1) - over(of_robot)), COVERAGE)))
        lost = self.between[:, i]
        if self.unresolved is not None:
            # errors of counts alone, whatever the samples resolve, differ by as much as they are
            of_counts = FEWER_ERR * max(out) * np.sqrt(len(lost))
            lost = np.where(WITHOUT_HALF * lost > of_counts, np.maximum(self.unresolved[:, i], lost), lost)
        return float(np.hypot(max(out), lost.max()))

    def characteristic(
        self, i: int, key: CharacteristicKey, *, clause: str, unit: str, note: Message, over: Callable[..., FloatArray] = np.mean,
        above: float = -np.inf
    ) -> Characteristic:  # fmt: skip
        """Return figure i over the cycles, with equal ones above a value; another run draws new errors."""
        u95, value = self.u95(i, over, above), float(over(self.values[:, i]))
        return Characteristic(
            **key._asdict(), clause=clause, value=value, unit=unit, u95=u95, capable=False, cycles=len(self.values), note=note
        ).with_budget((Contribution(message("source.motion"), u95 / NORMAL_95, distribution="drawn", random=True),), u95)  # fmt: skip


def distance(vectors: FloatArray) -> FloatArray:
    """(...) lengths of vectors (..., 3)."""
    return np.sqrt(np.einsum("...i,...i->...", vectors, vectors))


def longest_s(cycles: Sequence[Stretch]) -> float:
    """Return how long [s] the longest of cycles lasts."""
    return max(float(s.time_s[-1] - s.time_s[0]) for s in cycles)


class Motion:
    """A trajectory in the frame and at the point that are certified, with the errors at its samples by each law that may hold."""

    def __init__(
        self,
        trajectory: Trajectory,
        frame: Frame,
        errors: Callable[[IntArray], Sequence[PoseErrors]],
        *,
        stamps: Stamps,
        settings: CertificationSettings,
    ) -> None:
        self.trajectory, self.frame, self.stamps = trajectory, frame, stamps
        self._errors, self._settings = errors, settings

    def stretch(self, start: float, end: float, what: str, *, begins: bool) -> Stretch:
        """A window with the place where it comes to rest, and, where it begins from rest, that one before; CertificationError when it has
        fewer than two samples."""
        part = window(self.trajectory, start, end, what)
        n = part.stop - part.start
        if n < 2:
            raise CertificationError(message("error.the_window_s_holds", where=what, start=start, end=end))
        if self.stamps.stretch is not None and self.stamps.stretch[part.start] != self.stamps.stretch[part.stop - 1]:
            steps = np.diff(self.trajectory.time_s[part])
            a, b = self.trajectory.time_s[part][[int(np.argmax(steps)), int(np.argmax(steps)) + 1]]
            raise CertificationError(message("error.there_are_no_samples", where=what, a=a, b=b))
        places = (*((Stretch.begun(),) if begins else ()), Stretch.rested(n))
        poses = self.frame.of(self.trajectory.poses[part])
        return Stretch(np.arange(part.start, part.stop), self.trajectory.time_s[part], poses, places)

    def read(self, cycles: Sequence[Stretch], reading: Reading) -> Reported:
        """Return the figures of cycles."""
        values, halves, quarters, found = [], [], [], []
        # of each place by each law, at all cycles
        laws = [
            self._errors(np.array([s.samples[at[0]] for s, at in zip(cycles, at_place, strict=True)])) for at_place in _by_place(cycles)
        ]
        joint = laws[0][0].joint
        random = [e.random if reading.origin is None and not joint else e.covariance for of_place in laws for e in of_place]
        reach = FAR * float(np.sqrt(2.0 * max(np.linalg.eigvalsh(c[:, 3:, 3:]).max() for c in random)))
        for stretch in cycles:
            finer = stretch.finer(reading.limit_mm)
            vectors, of_half, of_quarter = (_vectors(stretch.poses[:, :3], stretch, finer, reading.origin, every) for every in (1, 2, 4))
            values.append(reading.of(finer.time_s, *vectors))
            halves.append(reading.reported(reading.of(finer.time_s, *of_half)))
            quarters.append(reading.reported(reading.of(finer.time_s, *of_quarter)))
            found.append((finer, finer.near([reading.size(v) for v in vectors], reading.limit_mm, reach, largest=reading.largest)))
        by_half, by_quarter = (np.abs(np.array(a) - np.array(b)) for a, b in ((values, halves), (halves, quarters)))
        nearer = np.divide(by_half, by_quarter, out=np.ones_like(by_half), where=by_quarter > by_half)
        # where leaving out samples once more changes a figure by hardly more, they do not resolve it, and all of the change may be left
        unresolved = by_half * np.clip(nearer / np.maximum(1.0 - nearer, 1e-9), 1.0 / WITHOUT_HALF, 1.0)
        by_law = tuple(self._drawn(cycles, found, of_places, reading) for of_places in zip(*laws, strict=True))
        return Reported(np.array(values), by_half / WITHOUT_HALF, by_law, unresolved)

    def _drawn(
        self, cycles: Sequence[Stretch], found: Sequence[tuple[Finer, IntArray]], laws: Sequence[PoseErrors], reading: Reading
    ) -> tuple[FloatArray, FloatArray]:
        """Figures of a likely motion without and with errors by the laws of the places."""
        rng = np.random.default_rng([self._settings.seed, int(cycles[0].samples[0])])

        def figures(finer: Finer, points: IntArray, vectors: Sequence[FloatArray]) -> FloatArray:
            return reading.reported(reading.of(finer.time_s[points], *vectors))

        joint = laws[0].joint
        likely = []
        for s, (finer, points) in zip(cycles, found, strict=True):
            # of a curve roundings are smoothed already
            smooth = s.poses[:, :3] if joint else s.moved(s.places[-1])[:, 3:] + s.poses[s.places[-1], :3].mean(axis=0)
            likely.append([v[points] for v in _vectors(smooth, s, finer, reading.origin)])
        base = [figures(finer, points, v) for v, (finer, points) in zip(likely, found, strict=True)]
        at_once = max(1, DRAWN_AT_ONCE // max(len(points) for _, points in found))
        out, together = [], self._together(cycles, found) if joint else []
        for first in range(0, self._settings.trials, at_once):
            trials = min(at_once, self._settings.trials - first)
            errors = (
                _joint_errors(cycles, found, together, rng, trials=trials, absolute=reading.origin is not None)
                if joint
                else [
                    _errors_from(cycles, found, at, law, rng=rng, trials=trials, absolute=reading.origin is not None)
                    for at, law in zip(_by_place(cycles), laws, strict=True)
                ]
            )
            moved = [[v + e[j] for v, e in zip(likely[j], errors, strict=True)] for j in range(len(cycles))]
            out.append(np.stack([figures(*found[j], moved[j]) for j in range(len(cycles))], axis=1))
        return np.array(base), np.concatenate(out)

    def _together(self, cycles: Sequence[Stretch], found: Sequence[tuple[Finer, IntArray]]) -> list[tuple[IntArray, PoseErrors]]:
        """Samples of each cycle that its figures come from, counted from its first, and their errors."""
        out = []
        for s, (finer, points) in zip(cycles, found, strict=True):
            used = finer.used(points)
            used[np.concatenate(s.places)] = True
            needed = np.flatnonzero(used)
            out.append((needed, self._errors(s.samples[needed])[0]))
        return out


def _joint_errors(
    cycles: Sequence[Stretch],
    found: Sequence[tuple[Finer, IntArray]],
    together: Sequence[tuple[IntArray, PoseErrors]],
    rng: np.random.Generator,
    *,
    trials: int,
    absolute: bool,
) -> list[list[FloatArray]]:
    """Drawn errors (trials, F, 3) [mm], by place and cycle, of vectors from a place to points (F,), of a curve."""
    out: list[list[FloatArray]] = [[] for _ in cycles[0].places]
    common = together[0][1].drawn_common(rng, trials)
    for s, (finer, points), (needed, law) in zip(cycles, found, together, strict=True):
        drawn = drawn_errors(law, rng, common)[..., 3:]

        def of_samples(samples: IntArray, needed: IntArray = needed, drawn: FloatArray = drawn) -> FloatArray:
            return np.asarray(drawn[:, np.searchsorted(needed, samples)])

        there = finer.errors(points, of_samples)
        for of_place, at in zip(out, s.places, strict=True):
            of_place.append(there if absolute else there - of_samples(at).mean(axis=1)[:, None])
    return out


def _by_place(cycles: Sequence[Stretch]) -> list[tuple[IntArray, ...]]:
    """The samples of each cycle at the first place, at the next one, .."""
    return list(zip(*(s.places for s in cycles), strict=True))


def _vectors(positions: FloatArray, stretch: Stretch, finer: Finer, origin: FloatArray | None, every: int = 1) -> list[FloatArray]:
    """(K, 3) each: from a stretch's places, or the origin, to positions (k, 3) of its samples, read finer."""
    fine = finer.read(positions, every)
    return [fine - (positions[at].mean(axis=0) if origin is None else origin) for at in stretch.places]


def _errors_from(
    cycles: Sequence[Stretch],
    found: Sequence[tuple[Finer, IntArray]],
    places: Sequence[IntArray],
    law: PoseErrors,
    *,
    rng: np.random.Generator,
    trials: int,
    absolute: bool,
) -> list[FloatArray]:
    """Return drawn errors (trials, F, 3) [mm] of each cycle's vectors from a place to points (F,), law: of positions at the place, one a
    cycle; absolute: the vectors are from a point without error, near the place, and contain the run's common errors too."""
    apart = np.zeros((len(cycles), 6))
    poses = np.array([s.poses[at[0]] for s, at in zip(cycles, places, strict=True)])
    apart[:, 3:] = poses[:, :3] - poses[:, :3].mean(axis=0)
    if not np.isnan(poses[0, 3]):
        turns = se3.rotation(poses)
        apart[:, :3] = (turns * turns.mean().inv()).as_rotvec()
    start = phases(law, apart, rng, trials)
    common = law.drawn_factors(rng, trials) if absolute else np.empty((trials, 0))
    out = []
    for j, (stretch, (finer, points), at) in enumerate(zip(cycles, found, places, strict=True)):
        moved = stretch.moved(at)
        away = rng.random((trials, law.own.shape[2]))

        def of_samples(samples: IntArray, j: int = j, moved: FloatArray = moved, away: FloatArray = away) -> FloatArray:
            return roundings(law.own[j], moved[samples], start[:, j], away)[..., 3:]

        of_place = -common @ law.factors[j, 3:].T if absolute else of_samples(at).mean(axis=1)
        out.append(finer.errors(points, of_samples) - of_place[:, None])
    return out


NEAR = 0.4
"""Part of the least distance between commanded poses: a rest farther from a pose does not belong to it."""
FARTHEST_MM = 20.0


def with_windows(trajectory: Trajectory, program: Program, frame: Frame, still_mm: float) -> tuple[Program, tuple[Message, ...]]:
    """Return the program with windows found in the trajectory, if it states no times, and remarks on them.

    A dwell is the second half of a rest near a commanded pose, up to `LAG_S` before the robot leaves it; a run of a path lies between a
    rest near its start and the next near its end. CertificationError if a pose or path is not found, or poses have different numbers of
    visits.
    """
    timed = [w for p in program.pose for w in (p.windows_s, p.settling_s)] + [p.windows_s for p in program.path]
    timed += [p.windows_s for p in program.posing] + [c.windows_s for c in program.compliance]
    if any(timed) or not (program.pose or program.path):
        return program, ()
    positions = frame.of(trajectory.poses)[:, :3]
    found = rests(trajectory, positions, still_mm)
    places = np.array([np.nanmean(positions[r], axis=0) for r in found]).reshape(-1, 3)
    seen = _Rests(trajectory, positions, found, places)
    poses = tuple(_with_dwells(p, program, seen) for p in program.pose)
    cycles = Counter(len(p.windows_s) for p in poses)
    if len(cycles) > 1:
        most = cycles.most_common(1)[0][0]
        odd = next(p for p in poses if len(p.windows_s) != most)
        raise CertificationError(message("error.pose_is_rested_at", name=odd.name, n_windows_s=len(odd.windows_s), most=most))
    paths = tuple(_with_runs(p, seen) for p in program.path)
    note = message("windows.found", rests=len(found), least_s=LEAST_S, still_mm=still_mm)
    data = program.model_dump(by_alias=True, exclude_none=True)
    data["pose"] = [p.model_dump(by_alias=True, exclude_none=True) for p in poses]
    data["path"] = [p.model_dump(by_alias=True, exclude_none=True) for p in paths]
    return Program.model_validate(data), (note,)


def _reach(program: Program) -> float:
    """Return how far from a commanded pose a rest may lie and still belong to it [mm]."""
    places = np.array([p.position_mm for p in program.pose]).reshape(-1, 3)
    apart = [float(np.linalg.norm(a - b)) for a, b in itertools.combinations(places, 2)]
    return min([FARTHEST_MM, *(NEAR * d for d in apart if d > 0)])


class _Rests(NamedTuple):
    """Rests of a trajectory: positions (n, 3) of the certified point, the samples of each rest, and its places (k, 3) [mm]."""

    trajectory: Trajectory
    positions: FloatArray
    found: list[slice]
    places: FloatArray


def _with_dwells(pose: CommandedPose, program: Program, rests: _Rests) -> CommandedPose:
    found = rests.found
    near = np.flatnonzero(np.linalg.norm(rests.places - np.array(pose.position_mm), axis=1) <= _reach(program))
    if len(near) == 0:
        raise CertificationError(message("error.pose_the_trajectory_has", name=pose.name, reach=_reach(program), n_found=len(found)))
    windows = [settled(rests.trajectory.time_s, rests.positions, found[i]) for i in near]
    _expect(pose.name, "pose", len(windows), pose.cycles)
    return pose.model_copy(update={"windows_s": tuple(windows)})


def _with_runs(path: CommandedPath, rests: _Rests) -> CommandedPath:
    trajectory, positions, found, places = rests
    points = path.points(10.0)
    windows = []
    for i in range(len(found) - 1):
        ends = np.linalg.norm(places[i] - points[0]), np.linalg.norm(places[i + 1] - points[-1])
        if max(ends) > FARTHEST_MM:
            continue
        first, last = found[i].stop - 1, found[i + 1].start
        # a way of other length between the same ends is another motion
        way = np.nansum(np.linalg.norm(np.diff(positions[first : last + 1], axis=0), axis=1))
        length = np.linalg.norm(np.diff(points, axis=0), axis=1).sum()
        if 0.8 * length < way < 1.5 * length:
            windows.append((float(trajectory.time_s[first]), float(trajectory.time_s[last])))
    if not windows:
        raise CertificationError(message("error.path_the_trajectory_has", name=path.name))
    _expect(path.name, "path", len(windows), path.cycles)
    return path.model_copy(update={"windows_s": tuple(windows)})


def _expect(name: str, kind: str, found: int, stated: int | None) -> None:
    if stated is not None and found != stated:
        raise CertificationError(message("error.found_cycles_in_the", kind=kind, name=name, found=found, stated=stated))
