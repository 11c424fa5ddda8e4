"""Figures that are read from the motion itself: settling (7.4, 7.5), stabilisation length (8.5), posing time (9), weaving (11).

Their limits are crossed or their extremes taken among thousands of samples. U95 is found by moving the limit: what the figure would be if
the distance that is compared with it were off by its own U95, up or down; the larger change counts. Errors common to the run cancel in
distances of a few millimetres; each of two positions has the rounding of its counts.
"""

import itertools
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from lmeasure.certification import iso9283_path, iso9283_time
from lmeasure.certification.attained import Frame, window
from lmeasure.certification.characteristic import Characteristic
from lmeasure.certification.errors_of_poses import PoseErrors
from lmeasure.certification.path_figures import Corner, at_corner
from lmeasure.certification.paths import Crossings
from lmeasure.certification.uncertainty import NORMAL_95
from lmeasure.errors import CertificationError
from lmeasure.program import CommandedPath, CommandedPose, Posing, Program
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class NotReachedError(CertificationError):
    """A limit that the robot does not reach: its figure is left out of the certificate, and the certificate says so."""


AT_REST = 0.1
"""Of a window: its last part, in which the robot is taken to rest."""


class Motion:
    """A trajectory in the frame and at the point that are certified, with the errors at its samples by each law that may hold."""

    def __init__(self, trajectory: Trajectory, frame: Frame, errors: Callable[[IntArray], Sequence[PoseErrors]]) -> None:
        self.trajectory, self.frame, self._errors = trajectory, frame, errors

    def u95_of_distance(self, samples: Sequence[int]) -> float:
        """U95 [mm] of a short distance between two positions near these samples: the worst direction of both roundings."""
        found = self._errors(np.asarray(samples, dtype=np.int64))
        largest = max(float(np.linalg.eigvalsh(e.random[:, 3:, 3:])[:, -1].max()) for e in found)
        return NORMAL_95 * float(np.sqrt(2.0 * largest))

    def arrival(self, start: float, end: float, what: str) -> tuple[slice, FloatArray, FloatArray, FloatArray]:
        """Samples of a window, their times (k,) [s] and positions (k, 3), and where the robot rests at its end."""
        part = window(self.trajectory, start, end, what)
        positions = self.frame.of(self.trajectory.poses[part])[:, :3]
        return part, self.trajectory.time_s[part], positions, positions[-max(1, int(AT_REST * len(positions))) :].mean(axis=0)


def samples_of(program: Program, trajectory: Trajectory) -> IntArray:
    """(k,) samples at whose errors `settling` and `posing` look: first and last of their windows."""
    asked = [(f"pose {p.name}, settling", w) for p in program.pose for w in p.settling_s]
    asked += [(f"posing {p.name}", w) for p in program.posing for w in p.windows_s]
    parts = [window(trajectory, *w, what) for what, w in asked]
    return np.array([i for part in parts for i in (part.start, part.stop - 1)], dtype=np.int64)


def _bounds(figure: Callable[[float], float], limit: float, u95: float, largest: float) -> tuple[float, float]:
    """A figure that depends on a limit, and its U95; `largest` when the figure cannot be told with the limit moved."""
    value = figure(limit)
    moved = [figure(limit + u95), figure(limit - u95) if limit > u95 else np.nan]
    u = max(abs(m - value) for m in moved)
    return value, u if np.isfinite(u) else largest


def settling(pose: CommandedPose, band_mm: float | None, motion: Motion) -> list[Characteristic]:
    """t_s and OV of a pose with settling_s: mean and largest of its cycles. band_mm: the pose's repeatability, for want of limit_band_mm.

    CertificationError when no band is known or the robot never comes to rest within it.
    """
    band = pose.limit_band_mm or band_mm
    if band is None:
        raise CertificationError(f"pose {pose.name}: settling_s needs limit_band_mm, or two cycles for the pose's repeatability")
    times, overshoots, u = [], [], 0.0
    for cycle, (start, end) in enumerate(pose.settling_s, 1):
        what = f"pose {pose.name}, settling {cycle}"
        part, time_s, positions, rest = motion.arrival(start, end, what)
        distance = np.linalg.norm(positions - rest, axis=1)
        u = motion.u95_of_distance([part.stop - 1])
        step = float(np.max(np.diff(time_s), initial=0.0))
        value, u_time = _bounds(lambda b, t=time_s, d=distance: iso9283_time.stabilisation_time(t, d, b), band, u, end - start)  # type: ignore[misc]
        if not np.isfinite(value):
            raise NotReachedError(f"{what}: the robot does not come to rest within {band:.4g} mm in the window [{start:g}, {end:g}] s")
        times.append((value, u_time + step))
        overshoots.append(_bounds(lambda b, d=distance: iso9283_time.overshoot(d, b), band, u, float(distance.max())))  # type: ignore[misc]
    n = len(times)
    t, of_t = np.array(times).mean(axis=0)
    worst, of_worst = max(overshoots)
    note = f"limit band {band:.4g} mm" + ("" if pose.limit_band_mm else ", the pose's repeatability")
    return [
        Characteristic("t_s", "7.4", float(t), "s", float(of_t), False, n, pose=pose.name, note=note),
        Characteristic("OV", "7.5", worst, "mm", max(of_worst, u), False, n, pose=pose.name, note=note),
    ]


def posing(asked: Posing, band_mm: float | None, motion: Motion) -> list[Characteristic]:
    """t_min of a move between two poses, mean of its cycles; band_mm: repeatability of the pose at its end, for want of limit_band_mm."""
    band = asked.limit_band_mm or band_mm
    if band is None:
        raise CertificationError(f"posing {asked.name}: needs limit_band_mm, or two cycles of {asked.to_pose} for its repeatability")
    times = []
    for cycle, (start, end) in enumerate(asked.windows_s, 1):
        what = f"posing {asked.name}, cycle {cycle}"
        part, time_s, positions, rest = motion.arrival(start, end, what)
        from_start, to_end = np.linalg.norm(positions - positions[0], axis=1), np.linalg.norm(positions - rest, axis=1)
        u = motion.u95_of_distance([part.start, part.stop - 1])

        def figure(b: float, t: FloatArray = time_s, a: FloatArray = from_start, z: FloatArray = to_end) -> float:
            return iso9283_time.posing_time(t, a, z, b)

        value, of_value = _bounds(figure, band, u, end - start)
        if not np.isfinite(value):
            raise NotReachedError(f"{what}: the window [{start:g}, {end:g}] s holds no move from rest to rest within {band:.4g} mm")
        times.append((value, of_value + float(np.max(np.diff(time_s), initial=0.0))))
    mean, of_mean = np.array(times).mean(axis=0)
    note = f"limit band {band:.4g} mm; from the beginning of the motion, not from the command"
    return [Characteristic("t_min", "9", float(mean), "s", float(of_mean), False, len(times), pose=asked.name, note=note)]


def stabilisation(crossed: Crossings, corner: Corner, path: CommandedPath, motion: Motion) -> list[Characteristic]:
    """SPL behind a corner, mean of the cycles, of a path with stabilisation_mm."""
    limit = path.stabilisation_mm
    assert limit is not None
    found = []
    for number, cycle in enumerate(crossed.cycles, 1):
        _, _, sample, along, away = at_corner(cycle, corner, f"path {path.name}, cycle {number}")
        u = motion.u95_of_distance([sample])
        behind = along >= 0.0

        def figure(b: float, s: FloatArray = along[behind], d: FloatArray = away[behind]) -> float:
            return iso9283_path.stabilisation_length(s, d, b)

        value, of_value = _bounds(figure, limit, u, 0.5 * corner.after_mm)
        if not np.isfinite(value):
            raise NotReachedError(
                f"path {path.name}, cycle {number}: corner {corner.number}: the robot is not back within {limit:g} mm half way to the next"
            )
        found.append((value, of_value + u))
    mean, of_mean = np.array(found).mean(axis=0)
    part = f"corner {corner.number}"
    note = f"back within {limit:g} mm"
    return [Characteristic("SPL", "8.5", float(mean), "mm", float(of_mean), False, len(found), path=path.name, part=part, note=note)]


def weaving(crossed: Crossings, path: CommandedPath, motion: Motion) -> list[Characteristic]:
    """WS, and WF where a speed is commanded, of a linear path with weave_stroke_mm and weave_distance_mm.

    The weave is taken in the direction across the path in which the deviation is largest; strokes run from one side of the middle line to
    the other, so that a cycle needs at least two; CertificationError otherwise.
    """
    stroke, distance = path.weave_stroke_mm, path.weave_distance_mm
    assert stroke is not None
    assert distance is not None
    strokes, rates, u_strokes, u_ways = [], [], [], []
    for number, cycle in enumerate(crossed.cycles, 1):
        inside = (cycle.way_mm > 0.0) & (cycle.way_mm < crossed.line.length)
        way, time_s = cycle.way_mm[inside], cycle.time_s[inside]
        points, tangent = crossed.line.at(way)
        away = cycle.poses[inside, :3] - points
        away = away - (away * tangent).sum(axis=1)[:, None] * tangent
        y = away @ np.linalg.svd(away - away.mean(axis=0), full_matrices=False)[2][0]
        u = motion.u95_of_distance([int(crossed.samples[len(crossed.samples) // 2, number - 1])])
        middle = y - 0.5 * (y.max() + y.min())
        turns = _crossings_of_zero(way, middle, max(u, 0.1 * (y.max() - y.min())))
        if len(turns) < 3:
            raise CertificationError(f"path {path.name}, cycle {number}: has {max(len(turns) - 1, 0)} strokes across the path; at least 2")
        edges = np.searchsorted(way, turns)
        tops = np.array([middle[a:b][np.argmax(np.abs(middle[a:b]))] for a, b in itertools.pairwise(edges)])
        strokes.append(float(np.abs(np.diff(tops)).mean()))
        length = 2.0 * (turns[-1] - turns[0]) / (len(turns) - 1)
        seconds = np.interp(turns[[0, -1]], way, time_s)
        rates.append(float((turns[-1] - turns[0]) / (seconds[1] - seconds[0]) / length))
        u_strokes.append(np.sqrt(2.0) * u)
        # the slope at the middle line is at least that of a triangle
        u_ways.append(u * (1.0 + length / (2.0 * strokes[-1])) / (turns[-1] - turns[0]))
    common = {"unit": "%", "capable": False, "cycles": len(strokes), "path": path.name}
    value = float(iso9283_path.weaving_stroke_error(np.array(strokes), stroke))
    out = [Characteristic(name="WS", clause="11", value=value, u95=float(100.0 * max(u_strokes) / stroke), **common)]  # type: ignore[arg-type]
    if path.speed_mm_s is not None:
        commanded = path.speed_mm_s / distance
        value = float(iso9283_path.weaving_frequency_error(np.array(rates), commanded))
        u95 = float(100.0 * max(u_ways) * np.mean(rates) / commanded)
        out.append(Characteristic(name="WF", clause="11", value=value, u95=u95, **common))  # type: ignore[arg-type]
    return out


def _crossings_of_zero(way: FloatArray, y: FloatArray, least: float) -> FloatArray:
    """Ways (k,) at which y goes through zero, between excursions of at least `least` to either side."""
    far = np.flatnonzero(np.abs(y) >= least)
    sides = np.sign(y[far])
    out = []
    for i in np.flatnonzero(sides[1:] != sides[:-1]):
        a, b = far[i], far[i + 1]
        # the last change of sign between them
        k = a + int(np.flatnonzero(np.sign(y[a:b]) != np.sign(y[a + 1 : b + 1]))[-1])
        out.append(way[k] - y[k] * (way[k + 1] - way[k]) / (y[k + 1] - y[k]))
    return np.array(out)
