"""Attained paths: what a trajectory's samples are on a commanded path, and where they cross planes normal to it."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation, Slerp

from lmeasure.certification.attained import Frame, window
from lmeasure.errors import CertificationError
from lmeasure.kernels.polyline import follow
from lmeasure.program import CommandedPath
from lmeasure.trajectory import Trajectory

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

LEAST_SAMPLES = 20
SAMPLES_PER_PLANE = 2
BACKWARDS = 0.02
"""Of a path's length: farther back is not a robot that overshoots but one that runs the other way."""


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

    def way(self, positions: FloatArray) -> FloatArray:
        """(n,) way along the path [mm] of the nearest point to each of consecutive positions (n, 3)."""
        if self.path.kind != "circular":
            return np.asarray(follow(self.corners, self.arc, np.ascontiguousarray(positions)))
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
        if self.path.quaternion_xyzw is None:
            return None
        ends = Rotation.from_quat([self.path.quaternion_xyzw, self.path.end_quaternion_xyzw or self.path.quaternion_xyzw])
        return Slerp([0.0, 1.0], ends)(np.clip(way_mm / self.length, 0.0, 1.0))


@dataclass(frozen=True)
class Cycle:
    """One run of a path: samples of the trajectory (k,), their times [s], poses (k, 7) and ways along the path (k,) [mm]."""

    samples: IntArray
    time_s: FloatArray
    poses: FloatArray
    way_mm: FloatArray


@dataclass(frozen=True)
class Crossings:
    """A path's cycles at m planes normal to it, way_mm (m,) along it: commanded (m, 3) and tangent (m, 3); attained poses (m, n, 7), when
    they were crossed time_s (m, n), and the nearest samples (m, n). cycles: the runs themselves; angle_deg: worst pressure angle on them.
    """

    line: Line
    way_mm: FloatArray
    commanded: FloatArray
    tangent: FloatArray
    attained: FloatArray
    time_s: FloatArray
    samples: IntArray
    cycles: tuple[Cycle, ...]
    angle_deg: float

    @property
    def speed_mm_s(self) -> FloatArray:
        """(n, m - 1) speeds along the path, between planes."""
        return np.asarray((np.diff(self.way_mm)[:, None] / np.diff(self.time_s, axis=0)).T)


def crossings(trajectory: Trajectory, path: CommandedPath, planes: int, frame: Frame) -> Crossings:
    """The cycles of a path, one per window, in the frame and at the point of the tool that are certified.

    The planes stand in the middles of as many equal pieces. CertificationError names the window that does not run along the path.
    """
    line = Line(path)
    cycles, worst = [], 0.0
    for number, (start, end) in enumerate(path.windows_s, 1):
        what = f"path {path.name}, cycle {number}"
        part = window(trajectory, start, end, what)
        if part.stop - part.start < LEAST_SAMPLES:
            raise CertificationError(
                f"{what}: the window [{start:g}, {end:g}] s has {part.stop - part.start} samples; at least {LEAST_SAMPLES}"
            )
        poses = frame.of(trajectory.poses[part])
        cycle = Cycle(np.arange(part.start, part.stop), trajectory.time_s[part], poses, line.way(poses[:, :3]))
        _runs_along(cycle, line.length, what)
        cycles.append(cycle)
        worst = float(np.fmax.reduce(trajectory.worst_pressure_angle_deg[part], initial=worst))
    moving = min(int(((c.way_mm > 0.01 * line.length) & (c.way_mm < 0.99 * line.length)).sum()) for c in cycles)
    m = min(planes, moving // SAMPLES_PER_PLANE)
    if m < LEAST_SAMPLES // SAMPLES_PER_PLANE:
        raise CertificationError(f"path {path.name}: a cycle has {moving} samples on the way; at least {LEAST_SAMPLES}")
    ways = (np.arange(m) + 0.5) / m * line.length
    commanded, tangent = line.at(ways)
    attained, times, samples = np.empty((m, len(cycles), 7)), np.empty((m, len(cycles))), np.empty((m, len(cycles)), np.int64)
    for j, cycle in enumerate(cycles):
        attained[:, j], times[:, j], samples[:, j] = _cross(cycle, ways, f"path {path.name}, cycle {j + 1}")
    return Crossings(line, ways, commanded, tangent, attained, times, samples, tuple(cycles), worst)


def _runs_along(cycle: Cycle, length: float, what: str) -> None:
    way = cycle.way_mm
    forward = np.maximum.accumulate(way)
    back = forward - way
    i = int(np.argmax(back))
    if back[i] > BACKWARDS * length:
        raise CertificationError(
            f"{what}: runs backwards by {back[i]:.4g} mm until sample {cycle.samples[i]} at {cycle.time_s[i]:.6g} s: not the commanded path"
        )


def _cross(cycle: Cycle, ways: FloatArray, what: str) -> tuple[FloatArray, FloatArray, IntArray]:
    """Poses (m, 7), times (m,) and samples (m,) where the planes are crossed, straight between the two samples about each."""
    forward = np.maximum.accumulate(cycle.way_mm)
    after = np.searchsorted(forward, ways, side="left")
    if after[0] == 0:
        raise CertificationError(f"{what}: begins {cycle.way_mm[0]:.4g} mm along the path; the window must hold its start")
    if after[-1] == len(forward):
        raise CertificationError(f"{what}: ends {forward[-1]:.4g} mm along the path, before its end")
    before = after - 1
    a, b = cycle.way_mm[before], cycle.way_mm[after]
    part = ((ways - a) / (b - a))[:, None]
    one, other = cycle.poses[before], cycle.poses[after]
    same_side = np.where((one[:, 3:] * other[:, 3:]).sum(axis=1) < 0, -1.0, 1.0)
    pose = one + part * (other * np.concatenate([np.ones((len(one), 3)), np.tile(same_side[:, None], 4)], axis=1) - one)
    pose[:, 3:] /= np.linalg.norm(pose[:, 3:], axis=1)[:, None]
    times = cycle.time_s[before] + part[:, 0] * (cycle.time_s[after] - cycle.time_s[before])
    return pose, times, cycle.samples[np.where(part[:, 0] < 0.5, before, after)]
