"""Figures that are read from the motion itself: settling (7.4, 7.5), stabilisation length (8.5) and posing time (9).

Their limits are crossed or their extremes taken among thousands of samples. Of times and overshoots the errors of the counts are drawn:
errors common to the run cancel in distances of a few millimetres, and each of two positions has the rounding of its counts, which is new
when the robot has gone on by a count. To their U95 comes a bound on what lies between two samples, by the second difference there. The
U95 of a stabilisation length is found by moving its limit by the U95 of such a distance, up and down; the larger change counts.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation
from scipy.signal import savgol_filter

from lmeasure.certification import iso9283_path, iso9283_time
from lmeasure.certification.attained import Frame, window
from lmeasure.certification.characteristic import Characteristic
from lmeasure.certification.errors_of_poses import PoseErrors, roots
from lmeasure.certification.path_figures import Corner, at_corner
from lmeasure.certification.paths import Crossings
from lmeasure.certification.settings import Settings
from lmeasure.certification.uncertainty import COVERAGE, NORMAL_95, reduction
from lmeasure.errors import CertificationError
from lmeasure.program import CommandedPath, CommandedPose, Posing, Program
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


class NotReachedError(CertificationError):
    """A limit that the robot does not reach: its figure is left out of the certificate, and the certificate says so."""


OF_SAMPLES = ("t_s", "OV", "t_min")
"""Figures read from samples: their systematic part is a bound on what lies between two of them, another in every run."""
AT_REST = 0.1
"""Of a window: its last part, in which the robot is taken to rest."""
SMOOTHED = 7  # samples
FAR = 5.0  # times its U95, a distance does not err by
DRAWN_AT_ONCE = 1_000_000  # distances


@dataclass(frozen=True)
class Arrival:
    """A window in which the robot comes to rest: its samples, times (k,) [s], positions (k, 3) [mm] and where it rests at the end (3,)."""

    samples: IntArray
    time_s: FloatArray
    positions: FloatArray
    rest: FloatArray


class Motion:
    """A trajectory in the frame and at the point that are certified, with the errors at its samples by each law that may hold."""

    def __init__(
        self, trajectory: Trajectory, frame: Frame, errors: Callable[[IntArray], Sequence[PoseErrors]], settings: Settings
    ) -> None:
        self.trajectory, self.frame, self._errors, self._settings = trajectory, frame, errors, settings

    def u95_of_distance(self, samples: Sequence[int]) -> float:
        """U95 [mm] of a short distance between two positions near these samples: the worst direction of both roundings."""
        found = self._errors(np.asarray(samples, dtype=np.int64))
        largest = max(float(np.linalg.eigvalsh(e.random[:, 3:, 3:])[:, -1].max()) for e in found)
        return NORMAL_95 * float(np.sqrt(2.0 * largest))

    def arrival(self, start: float, end: float, what: str) -> Arrival:
        """A window, and what happens in it."""
        part = window(self.trajectory, start, end, what)
        positions = self.frame.of(self.trajectory.poses[part])[:, :3]
        rest = positions[-max(1, int(AT_REST * len(positions))) :].mean(axis=0)
        return Arrival(np.arange(part.start, part.stop), self.trajectory.time_s[part], positions, rest)

    def near(self, came: Arrival, distances: Sequence[FloatArray], band_mm: float) -> NDArray[np.bool_]:
        """(k,) the samples at which errors may bring distances (k,) to the other side of a limit band, and both ends."""
        reach = FAR * self.u95_of_distance(came.samples[[0, -1]].tolist())
        near = np.isin(np.arange(len(came.samples)), [0, len(came.samples) - 1])
        for distance in distances:
            crossed = np.diff(distance > band_mm, prepend=distance[0] > band_mm)
            near |= binary_dilation((np.abs(distance - band_mm) <= reach) | crossed, iterations=SMOOTHED)
        return np.asarray(near)

    def draws(
        self, came: Arrival, figure: Callable[[FloatArray, FloatArray], FloatArray], kept: NDArray[np.bool_] | None = None
    ) -> list[FloatArray]:
        """Figures (1 + trials, ...) by each law of the errors, the first without any; figure: of distances (trials, q) from the first
        position and from the rest, where they are likely to be: smoothed over a few samples. kept (k,): the q samples, by default all.

        Rounding errs anew when the robot has gone on by a count, and where it stands it errs alike. What is common to the run cancels.
        """
        trials, out = self._settings.trials, []
        likely = came.positions
        if len(likely) >= SMOOTHED:
            likely = savgol_filter(likely, SMOOTHED, 2, axis=0)
        away = likely - np.stack([came.positions[0], came.rest])[:, None]
        away = away if kept is None else away[:, kept]
        distance = np.linalg.norm(away, axis=2)
        unit = np.divide(away, distance[:, :, None], out=np.zeros_like(away), where=distance[:, :, None] > 0.0)
        steps = np.linalg.norm(np.diff(came.positions, axis=0), axis=1)
        for law in self._errors(came.samples[[0, -1]]):
            root = roots(law.random[:, 3:, 3:])
            # an exact instrument reads anew as soon as the robot moves
            count = max(float(np.sqrt(12.0 * np.trace(law.random[:, 3:, 3:], axis1=1, axis2=2).max() / 3.0)), 1e-12)
            reading = np.concatenate([[0], np.cumsum(steps) // count])
            reading = np.unique(reading if kept is None else reading[kept], return_inverse=True)[1]
            rng = np.random.default_rng([self._settings.seed, int(came.samples[0])])
            found, at_once = [figure(distance[:1], distance[1:])], max(1, DRAWN_AT_ONCE // len(reading))
            for first in range(0, trials, at_once):
                normals = rng.standard_normal((min(at_once, trials - first), int(reading[-1]) + 1, 3))
                # where the robot stands at the window's ends it is read as there
                own = (normals @ root[1])[:, reading]
                still = np.stack([normals[:, 0] @ root[1], normals[:, -1] @ root[1]], axis=1)
                moved = [np.abs(distance[i] + np.einsum("tkc,kc->tk", own - still[:, i, None], unit[i])) for i in (0, 1)]
                found.append(figure(moved[0], moved[1]))
            out.append(np.concatenate(found))
        return out


def _u95(draws: Sequence[Sequence[FloatArray]], over: Callable[..., FloatArray]) -> float:
    """U95 of a figure that is taken over cycles, draws[cycle][law] (1 + trials,); the larger of the laws'.

    What errors have added to the scatter of the cycles is taken away, lest the largest of them be the one that erred most.
    """
    out = []
    for of_law in zip(*draws, strict=True):
        base, errors = np.array([d[0] for d in of_law]), np.stack([d[1:] - d[0] for d in of_law])
        scatter, freedom = base - base.mean(), max(len(base) - 1, 1)
        likely = base.mean() + reduction((scatter**2).sum() / freedom, errors.var(axis=1).mean(), freedom) * scatter
        out.append(float(np.quantile(np.abs(over(likely[:, None] + errors, axis=0) - over(likely)), COVERAGE)))
    return max(out)


def _bend(time_s: FloatArray, distance: FloatArray, i: int) -> float:
    """How far [s] the crossing of a limit between samples i - 1 and i may be from where a straight line has it: by an eighth of the second
    difference of the distance (k,), over its slope."""
    about = distance[max(i - 2, 0) : i + 2]
    if i == 0 or i == len(distance) or len(about) < 3:
        return 0.0
    bend, fall = float(np.abs(np.diff(about, 2)).max()), float(abs(distance[i] - distance[i - 1]))
    return float(time_s[i] - time_s[i - 1]) * min(bend / 8.0 / fall, 1.0) if fall > 0.0 else 0.0


def _above(distance: FloatArray) -> float:
    """By how much [mm] the top between samples may be above the largest of them (k,): an eighth of the second difference there."""
    i = int(distance.argmax())
    return float(np.abs(np.diff(distance[i - 1 : i + 2], 2))[0]) / 8.0 if 0 < i < len(distance) - 1 else 0.0


def _of_samples(c: Characteristic, of_counts: float, between: float) -> Characteristic:
    """With the U95 of the counts' errors, and a bound on what lies between two samples."""
    return replace(c, u95=of_counts + between, u_random=of_counts / NORMAL_95, u_systematic=between / np.sqrt(3.0))


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
    times, overshoots, drawn, bends, tops = [], [], [], [], []
    for cycle, (start, end) in enumerate(pose.settling_s, 1):
        what = f"pose {pose.name}, settling {cycle}"
        came = motion.arrival(start, end, what)
        distance = np.linalg.norm(came.positions - came.rest, axis=1)
        times.append(float(iso9283_time.stabilisation_time(came.time_s, distance, band)))
        if not np.isfinite(times[-1]):
            raise NotReachedError(f"{what}: the robot does not come to rest within {band:.4g} mm in the window [{start:g}, {end:g}] s")
        overshoots.append(float(iso9283_time.overshoot(distance, band)))

        def both(_: FloatArray, to_end: FloatArray, t: FloatArray = came.time_s, longest: float = end - start) -> FloatArray:
            # a draw that does not come to rest: no shorter than the window
            time = np.nan_to_num(iso9283_time.stabilisation_time(t, to_end, band), nan=longest)
            return np.stack([time, np.nan_to_num(iso9283_time.overshoot(to_end, band), nan=np.inf)], axis=1)

        drawn.append(motion.draws(came, both))
        ends = int(iso9283_time.first_arrival(distance, band)), int(iso9283_time.last_arrival(distance, band))
        bends.append(sum(_bend(came.time_s, distance, i) for i in ends))
        tops.append(_above(distance[ends[0] :]) if overshoots[-1] > 0.0 else 0.0)
    n, t, worst = len(times), float(np.mean(times)), max(overshoots)
    u_time = _u95([[of_law[:, 0] for of_law in d] for d in drawn], np.mean)
    u_worst = _u95([[of_law[:, 1] for of_law in d] for d in drawn], np.max)
    note = f"limit band {band:.4g} mm" + ("" if pose.limit_band_mm else ", the pose's repeatability")
    return [
        _of_samples(Characteristic("t_s", "7.4", t, "s", 0.0, False, n, pose=pose.name, note=note), u_time, float(np.mean(bends))),
        _of_samples(Characteristic("OV", "7.5", worst, "mm", 0.0, False, n, pose=pose.name, note=note), u_worst, max(tops)),
    ]


def posing(asked: Posing, band_mm: float | None, motion: Motion) -> list[Characteristic]:
    """t_min of a move between two poses, mean of its cycles; band_mm: repeatability of the pose at its end, for want of limit_band_mm."""
    band = asked.limit_band_mm or band_mm
    if band is None:
        raise CertificationError(f"posing {asked.name}: needs limit_band_mm, or two cycles of {asked.to_pose} for its repeatability")
    times, drawn, bends = [], [], []
    for cycle, (start, end) in enumerate(asked.windows_s, 1):
        what = f"posing {asked.name}, cycle {cycle}"
        came = motion.arrival(start, end, what)
        from_start, to_end = (np.linalg.norm(came.positions - place, axis=1) for place in (came.positions[0], came.rest))

        near = motion.near(came, (from_start, to_end), band)

        def figure(a: FloatArray, z: FloatArray, t: FloatArray = came.time_s[near], longest: float = end - start) -> FloatArray:
            return np.nan_to_num(iso9283_time.posing_time(t, a, z, band), nan=longest)

        times.append(float(iso9283_time.posing_time(came.time_s, from_start, to_end, band)))
        if not np.isfinite(times[-1]):
            raise NotReachedError(f"{what}: the window [{start:g}, {end:g}] s holds no move from rest to rest within {band:.4g} mm")
        drawn.append(motion.draws(came, figure, near))
        leaves, arrives = int((from_start > band).argmax()), int(iso9283_time.last_arrival(to_end, band))
        bends.append(_bend(came.time_s, from_start, leaves) + _bend(came.time_s, to_end, arrives))
    mean = float(np.mean(times))
    note = f"limit band {band:.4g} mm; from the beginning of the motion, not from the command"
    out = Characteristic("t_min", "9", mean, "s", 0.0, False, len(times), pose=asked.name, note=note)
    return [_of_samples(out, _u95(drawn, np.mean), float(np.mean(bends)))]


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
