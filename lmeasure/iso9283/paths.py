"""Attained paths: a trajectory's samples along a commanded path, and their crossings of planes normal to it."""

import itertools
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import scipy
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, CertificationError, FloatArray, IntArray, lagrange
from lmeasure.iso9283.sample_gaps import Between, between, joined
from lmeasure.kernels import follow_polyline
from lmeasure.recording import CommandedPath
from lmeasure.text import message
from lmeasure.trajectory import Frame, Trajectory, moved, scatter, window

HALVINGS = 40
"""Halvings of a step between samples, until a passage is found in it: to 1e-12 of it."""
MOST_UNEVEN = 2.0
"""Times as long as the shortest of three steps the longest may be: cubics through samples at uneven times swing."""
FINER = 16
"""Pieces of a step in which the nearest or farthest place is looked for."""


def passage(time_s: FloatArray, ahead: FloatArray, part: FloatArray, smooth: BoolArray) -> tuple[FloatArray, FloatArray]:
    """Times (m,) at which something passes zero upwards between the second and the third of four samples ahead (m, 4) at time_s (m, 4), and
    the samples' weights (m, 4) there.

    By the cubic through the four where they are smooth (m,), even in time and on both sides of zero; else straight between the two, at
    part (m,) of the step.
    """
    time = time_s - time_s[:, 1:2]
    steps = np.diff(time, axis=1)
    cubic = smooth & (ahead[:, 1] < 0.0) & (ahead[:, 2] >= 0.0) & (steps.max(axis=1) <= MOST_UNEVEN * steps.min(axis=1))
    at = part * time[:, 2]
    weights = np.stack([np.zeros_like(part), 1.0 - part, part, np.zeros_like(part)], axis=1)
    at[cubic] = _zero(time[cubic], ahead[cubic])
    weights[cubic] = lagrange(time[cubic], at[cubic])
    return time_s[:, 1] + at, weights


def _zero(time_s: FloatArray, ahead: FloatArray) -> FloatArray:
    """(m,) where the cubics through (m, 4) pass zero between the second and the third, by bisection on their divided differences."""
    differences = ahead.T.copy()
    for k in range(1, 4):
        differences[k:] = (differences[k:] - differences[k - 1 : -1]) / (time_s[:, k:] - time_s[:, : 4 - k]).T
    start, end = time_s[:, 1], time_s[:, 2]
    for _ in range(HALVINGS):
        middle = 0.5 * (start + end)
        value = differences[3]
        for k in (2, 1, 0):
            value = differences[k] + (middle - time_s[:, k]) * value
        behind = value < 0.0
        start, end = np.where(behind, middle, start), np.where(behind, end, middle)
    return np.asarray(0.5 * (start + end))


def share(part: FloatArray) -> FloatArray:
    """Return (m,) parts of a sample's variance in a reading from the four about it, at part (m,) of the even step between the middle
    ones."""
    steps = np.tile(np.arange(-1.0, 3.0), (len(part), 1))
    return np.asarray((lagrange(steps, part) ** 2).sum(axis=1))


def finer(values: FloatArray, *, kinks: bool) -> FloatArray:
    """Return (..., FINER (k - 1) + 1, c) values between values (..., k, c) at even steps: by the cubic spline, or if there may be kinks by
    cubics that hardly swing there (modified Akima)."""
    steps = np.arange(values.shape[-2])
    curve = (
        scipy.interpolate.Akima1DInterpolator(steps, values, axis=-2, method="makima")
        if kinks
        else scipy.interpolate.CubicSpline(steps, values, axis=-2)
    )
    return np.asarray(curve(np.arange(FINER * steps[-1] + 1) / FINER))


SHARP_DEG = 20.0
"""A path of points turns a corner where its direction changes by more."""
LEAST_SAMPLES = 20
SAMPLES_PER_PLANE = 2
LEAST_PLANES = LEAST_SAMPLES // SAMPLES_PER_PLANE
BACKWARDS = 0.02
"""Largest part of a path's length by which a robot overshoots backwards; farther back it runs the other way."""
HOLE_PLANES = 3
"""Planes between two neighbouring samples that make a hole, if the time between these is long too: the path there would be a guess."""
HOLE_STEPS = 3.0
"""Times as long as the median step of a cycle that time is."""
ABOUT_MM = 0.05
"""Distance to either side of a plane over which the crossing speed is taken: as far as the possible error of the measurement."""


class Line:
    """A commanded path by the way along it [mm]: made of straight lines, or a whole circle."""

    def __init__(self, path: CommandedPath) -> None:
        self.path = path
        self.corners = path.corners()
        if path.kind == "circular":
            assert path.radius_mm is not None
            self.length = 2.0 * np.pi * path.radius_mm
        else:
            self.arc = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(self.corners, axis=0), axis=1))])
            self.length = float(self.arc[-1])

    def turns(self) -> list[int]:
        """Numbers of the points of the path at which it turns a corner; none where it turns back, and a closed path's start is none."""
        if self.path.kind == "circular":
            return []
        steps = np.diff(self.corners, axis=0)
        units = steps / np.linalg.norm(steps, axis=1)[:, None]
        turned = np.degrees(np.arccos(np.clip((units[1:] * units[:-1]).sum(axis=1), -1.0, 1.0)))
        return [int(i) + 1 for i in np.flatnonzero((turned > SHARP_DEG) & (turned < 180.0 - 1e-6))]

    def planes(self, number: int, *, quarters: bool = False) -> FloatArray:
        """Return (m,) arc lengths [mm] of about as many planes: in the middles of equal pieces from corner to corner, where the path has a
        direction; quarters: so that two planes of each line, if it has six or more, are at a quarter and at three quarters of it."""
        ends = [0.0, *(float(self.arc[i]) for i in self.turns()), self.length]
        pieces = [(a, b - a, max(1, round(number * (b - a) / self.length))) for a, b in itertools.pairwise(ends)]
        if quarters:
            pieces = [(a, way, k - (k - 2) % 4 if k >= 6 else k) for a, way, k in pieces]
        return np.concatenate([start + (np.arange(k) + 0.5) / k * way for start, way, k in pieces])

    def way(self, positions: FloatArray) -> FloatArray:
        """(n,) way along the path [mm] of the nearest point to each of consecutive positions (n, 3)."""
        if self.path.kind != "circular":
            return np.asarray(follow_polyline(self.corners, self.arc, np.ascontiguousarray(positions)))
        centre, out, across = self.path.circle()
        away, radius = positions - centre, float(np.linalg.norm(out))
        return np.asarray(radius * np.unwrap(np.arctan2(away @ across, away @ out)))

    def at(self, way_mm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (m, 3) [mm] and unit tangents (m, 3) at ways (m,)."""
        if self.path.kind == "circular":
            centre, out, across = self.path.circle()
            turn = (way_mm / np.linalg.norm(out))[:, None]
            return centre + np.cos(turn) * out + np.sin(turn) * across, (np.cos(turn) * across - np.sin(turn) * out) / np.linalg.norm(out)
        k = np.clip(np.searchsorted(self.arc, way_mm, side="right") - 1, 0, len(self.arc) - 2)
        steps = np.diff(self.corners, axis=0)
        tangents = steps / np.linalg.norm(steps, axis=1)[:, None]
        return self.corners[k] + (way_mm - self.arc[k])[:, None] * tangents[k], tangents[k]

    def orientation(self, way_mm: FloatArray) -> Rotation | None:
        """Commanded rotations at ways (m,), None where the program states none."""
        return self.path.orientation(way_mm / self.length)


@dataclass(frozen=True)
class Cycle:
    """One run of a path: samples of the trajectory (k,), their times [s], poses (k, 7) and ways along the path (k,) [mm].

    read (r,): which of them were measured, None for all; others are a curve's, and a path may hide between those.
    """

    samples: IntArray
    time_s: FloatArray
    poses: FloatArray
    way_mm: FloatArray
    read: IntArray | None = None

    @property
    def measured(self) -> IntArray:
        """(r,) numbers of the samples that were measured."""
        return np.arange(len(self.samples)) if self.read is None or len(self.read) < 2 else self.read


@dataclass(frozen=True)
class Crossings:
    """A path's cycles at m planes normal to it, way_mm (m,) along it: commanded (m, 3) and tangent (m, 3); attained poses (m, n, 7), times
    of crossing time_s (m, n) and speeds pace_mm_s (m, n), and the nearest samples (m, n).

    A crossing is read from the four samples about it, with the weights (m, n, 4); step (m, n, 6) from the one before it to the one behind,
    rotation [rad] and position [mm]; hidden (m n): possible error of the path between those; scatter (m, 6, 6): covariance of the nearest
    samples' poses over cycles. cycles: the runs themselves; angle_deg: worst pressure angle on them.
    """

    line: Line
    way_mm: FloatArray
    commanded: FloatArray
    tangent: FloatArray
    attained: FloatArray
    time_s: FloatArray
    pace_mm_s: FloatArray
    samples: IntArray
    weights: FloatArray
    step: FloatArray
    scatter: FloatArray
    cycles: tuple[Cycle, ...]
    angle_deg: float
    hidden: Between | None = None

    @property
    def stretch(self) -> IntArray:
        """Return (m,) indices of the stretches between corners that contain the planes."""
        turns = self.line.turns()
        return np.asarray(np.searchsorted(self.line.arc[turns], self.way_mm) if turns else np.zeros(len(self.way_mm), dtype=np.int64))

    def unseen(self) -> str | None:
        """The first part of the way on which a cycle has no samples, in words; None where there is none."""
        for number, cycle in enumerate(self.cycles, 1):
            planes = np.diff(np.searchsorted(self.way_mm, np.maximum.accumulate(cycle.way_mm)))
            steps = np.diff(cycle.time_s)
            holes = np.flatnonzero((planes >= HOLE_PLANES) & (steps > HOLE_STEPS * np.median(steps)))
            if len(holes):
                i = int(holes[0])
                (a, b), way = cycle.time_s[i : i + 2], cycle.way_mm[i + 1] - cycle.way_mm[i]
                return message("iso.no_samples", cycle=number, begin=float(a), end=float(b), way=float(way))
        return None

    @property
    def speed_mm_s(self) -> FloatArray:
        """(n, m - 1) speeds along the path, between planes."""
        return np.asarray((np.diff(self.way_mm)[:, None] / np.diff(self.time_s, axis=0)).T)


def crossings(
    trajectory: Trajectory, path: CommandedPath, planes: int, frame: Frame, *, quarters: bool = False, read: BoolArray | None = None
) -> Crossings:
    """The cycles of a path, one per window, in the frame and at the point of the tool that are certified; quarters: see `Line.planes`.

    read (n,): whether a sample was measured, see `Stamps`.

    CertificationError names the window that does not run along the path.
    """
    line = Line(path)
    cycles, worst = [], 0.0
    for number, (start, end) in enumerate(path.windows_s, 1):
        what = f"path {path.name}, cycle {number}"
        part = window(trajectory, start, end, what)
        if part.stop - part.start < LEAST_SAMPLES:
            raise CertificationError(
                message(
                    "error.the_window_s_has", where=what, start=start, end=end, stop=part.stop - part.start, least_samples=LEAST_SAMPLES
                )
            )
        poses = frame.of(trajectory.poses[part])
        measured = None if read is None else np.flatnonzero(read[part])
        cycle = Cycle(np.arange(part.start, part.stop), trajectory.time_s[part], poses, line.way(poses[:, :3]), measured)
        _runs_along(cycle, line.length, what)
        cycles.append(cycle)
        worst = float(np.fmax.reduce(trajectory.worst_pressure_angle_deg[part], initial=worst))
    moving = min(int(((c.way_mm > 0.01 * line.length) & (c.way_mm < 0.99 * line.length)).sum()) for c in cycles)
    if moving < LEAST_SAMPLES:
        raise CertificationError(message("error.path_a_cycle_has", name=path.name, moving=moving, least_samples=LEAST_SAMPLES))
    ways = line.planes(min(planes, moving // SAMPLES_PER_PLANE), quarters=quarters)
    m = len(ways)
    commanded, tangent = line.at(ways)
    bounds = np.array([-np.inf, *(line.arc[i] for i in line.turns()), np.inf])
    behind = np.searchsorted(bounds, ways)
    about = {"commanded": commanded, "tangent": tangent, "bounds": bounds[[behind - 1, behind]]}
    crossed = [_cross(cycle, ways, f"path {path.name}, cycle {j}", **about) for j, cycle in enumerate(cycles, 1)]
    every = _Crossed(*(np.stack(columns, axis=1) for columns in zip(*crossed, strict=True)))
    hidden = joined([_hidden(c, before) for c, before in zip(cycles, every.before.T, strict=True)])
    near = frame.of(trajectory.poses[every.samples.ravel()]).reshape(m, -1, 7)
    return Crossings(
        **{name: values for name, values in every._asdict().items() if name != "before"},
        hidden=hidden,
        line=line,
        way_mm=ways,
        commanded=commanded,
        tangent=tangent,
        scatter=np.array([scatter(poses) for poses in near]),
        cycles=tuple(cycles),
        angle_deg=worst,
    )


def _hidden(cycle: Cycle, before: IntArray) -> Between:
    """The steps between measured samples in which those of a cycle (m,) are."""
    read = cycle.measured
    step = np.searchsorted(read, before, side="right") - 1
    return between(cycle.time_s[read], cycle.poses[read, :3])[np.clip(step, 0, len(read) - 2)]


def _runs_along(cycle: Cycle, length: float, what: str) -> None:
    way = cycle.way_mm
    forward = np.maximum.accumulate(way)
    back = forward - way
    i = int(np.argmax(back))
    if back[i] > BACKWARDS * length:
        raise CertificationError(
            message("error.runs_backwards_by_mm", where=what, back=back[i], samples=cycle.samples[i], time_s=cycle.time_s[i])
        )


class _Crossed(NamedTuple):
    """One cycle of `Crossings`: poses (m, 7), times (m,), speeds (m,), nearest samples (m,), weights (m, 4) of those about each,
    the step (m, 6) from the one before it to the one behind, and the number of the one before in its cycle (m,)."""

    attained: FloatArray
    time_s: FloatArray
    pace_mm_s: FloatArray
    samples: IntArray
    weights: FloatArray
    step: FloatArray
    before: IntArray


def _cross(cycle: Cycle, ways: FloatArray, what: str, *, commanded: FloatArray, tangent: FloatArray, bounds: FloatArray) -> _Crossed:
    """Return the crossings of a cycle with the planes through commanded (m, 3) normal to tangent (m, 3); bounds (2, m): arc lengths of the
    corners before and behind each plane."""
    way, forward = cycle.way_mm, np.maximum.accumulate(cycle.way_mm)
    after = np.searchsorted(forward, ways, side="left")
    if after[0] == 0:
        raise CertificationError(message("error.begins_mm_along_the", where=what, way=way[0]))
    if after[-1] == len(forward):
        raise CertificationError(message("error.ends_mm_along_the", where=what, forward=forward[-1]))
    before = after - 1
    near = np.clip(before[:, None] + np.arange(-1, 3), 0, len(way) - 1)
    one, other = cycle.poses[before], cycle.poses[after]
    on_line = ((way[near] >= bounds[0, :, None]) & (way[near] <= bounds[1, :, None])).all(axis=1)
    ahead = np.einsum("mki,mi->mk", cycle.poses[near, :3] - commanded[:, None], tangent)
    times, weights = passage(cycle.time_s[near], ahead, (ways - way[before]) / (way[after] - way[before]), on_line)
    poses = cycle.poses[near]
    poses[:, :, 3:] *= np.where(np.einsum("mki,mi->mk", poses[:, :, 3:], one[:, 3:]) < 0, -1.0, 1.0)[:, :, None]
    pose = np.einsum("mk,mki->mi", weights, poses)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1)[:, None]
    about = np.clip(ways + ABOUT_MM * np.array([[-1.0], [1.0]]), forward[0], forward[-1])
    pace = np.diff(about, axis=0)[0] / np.diff(np.interp(about, forward, cycle.time_s), axis=0)[0]
    nearest = np.where(times - cycle.time_s[before] < cycle.time_s[after] - times, before, after)
    return _Crossed(pose, times, pace, cycle.samples[nearest], weights, moved(other, one), before)
