"""A body on five rods between ball joints, 5(SS): one freedom, followed along its path; the way of the point that drives it (source 004).

Five equations |R B_j + o - A_j| = l_j leave a pose one freedom. Its way is followed by arc length, |ds|^2 = |do|^2 + (size |omega|)^2: a
single coordinate is a bad driver where it stops, as the turn phi about the body's axis does between poses 5 and 6 of the source. Angles
there are R = Rz(psi) Rx(theta) Rz(phi), unique among all orders and signs for its tables.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import count

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import null_space

from lmeasure.core import FloatArray, GeometryError, se3
from lmeasure.text import message

RODS = 5
MOST_STEPS = 2000
LEAST_PART = 0.02
"""Of a step: least that the point moves in it."""
ITERATIONS = 50
CLOSES = 1e-12
"""Of the longest link: how well loops close."""


@dataclass(frozen=True)
class SevenLink:
    """anchors A (m, 3) in the base, points B (m, 3) on the body, lengths (m,), one unit throughout; m = 5 leaves one freedom."""

    anchors: FloatArray
    points: FloatArray
    lengths: FloatArray

    @property
    def size(self) -> float:
        """The largest distance of a point from the body's origin: what a radian is worth."""
        return float(max(np.linalg.norm(self.points, axis=1).max(), 1e-9 * self.lengths.max()))

    def residuals(self, poses: FloatArray) -> FloatArray:
        """(..., m) by how much the links are too short for poses (..., 7)."""
        return np.asarray(np.linalg.norm(self._spans(poses), axis=-1) - self.lengths)

    def rows(self, poses: FloatArray) -> FloatArray:
        """(..., m, 6) derivatives of the residuals by displacements (omega; shift of the body's origin)."""
        span = self._spans(poses)
        e = span / np.linalg.norm(span, axis=-1, keepdims=True)
        arm = np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points)
        return np.concatenate([np.cross(arm, e), e], axis=-1)

    def closed(self, pose: FloatArray) -> FloatArray:
        """(7,) the pose of the mechanism nearest to one (7,) by steps of least length in the metric of the path. GeometryError where the
        links do not meet."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        for _ in range(ITERATIONS):
            lacks = self.residuals(pose)
            step = -scale * np.linalg.lstsq(self.rows(pose) * scale, lacks, rcond=1e-12)[0]
            step /= max(1.0, float(np.linalg.norm(step[:3])) / 0.3)
            pose = se3.displaced(pose, step)
            if np.abs(step / scale).max() < CLOSES * self.lengths.max():
                break
        if np.abs(self.residuals(pose)).max() > 1e3 * CLOSES * self.lengths.max():
            raise GeometryError(message("error.the_links_do_not", abs=np.abs(self.residuals(pose)).max()))
        return pose

    def tangent(self, pose: FloatArray) -> FloatArray:
        """(6,) displacement (omega; shift) of unit arc length along the path. GeometryError where the mechanism has more freedoms."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        free = null_space(self.rows(pose) * scale, rcond=1e-9)
        if free.shape[1] != 1:
            raise GeometryError(message("error.a_singular_pose_freedoms", shape=free.shape[1]))
        return np.asarray(scale * free[:, 0])

    def walk(self, first: FloatArray, way: FloatArray, step: float) -> Iterator[FloatArray]:
        """The poses (7,) after one that closes, by steps of arc length the way of a displacement (6,), until they come back to it."""
        weigh = np.array([self.size] * 3 + [1.0] * 3)
        pose, sign = first, way * weigh
        for k in count():
            own = self.tangent(pose)
            own = own if (own * weigh) @ sign >= 0.0 else -own
            following = self.closed(se3.displaced(pose, step * own))
            left = float(np.linalg.norm(se3.displacement(following, first) * weigh))
            if k > 1 and left < 0.75 * step:
                if left > 0.25 * step:
                    yield following
                return
            yield following
            pose, sign = following, own * weigh

    def _spans(self, poses: FloatArray) -> FloatArray:
        return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points) - self.anchors)


@dataclass(frozen=True)
class Driver:
    """point of the body that is driven; step between nodes; limits: how far the way is needed, from home [mm]."""

    point: tuple[float, float, float]
    step_mm: float
    limits: tuple[float, float]


Rods = tuple[tuple[tuple[float, ...], tuple[float, ...], float], ...]
"""Of each its lower end in the base, its upper one on the body, and its length [mm]."""


@lru_cache(maxsize=8)
def way_of(rods: Rods, home: tuple[float, ...], driver: Driver) -> tuple[FloatArray, CubicSpline]:
    """The pose (7,) nearest to home (7,) that five rods allow, and the way of the point from there, by its length in chords [mm], a little
    farther than the driver's limits each way. GeometryError where they allow none, do not leave one freedom, or go less far."""
    if len(rods) != RODS:
        raise GeometryError(message("error.a_way_is_that", rods=RODS, n_rods=len(rods)))
    link = SevenLink(*(np.array(part) for part in zip(*rods, strict=True)))
    closed = link.closed(np.array(home))
    moved = link.tangent(closed)
    shift = moved[3:] + np.cross(moved[:3], se3.matrices(closed) @ np.array(driver.point))
    # ahead is where the point's fastest coordinate rises
    ahead = np.sign(shift[np.argmax(np.abs(shift))]) * moved
    least, most = driver.limits
    forth, back = (_walked(link, closed, way, driver, far) for way, far in ((ahead, most), (-ahead, -least)))
    poses = np.array([*back[::-1], closed, *forth])
    places = se3.apply(poses, driver.point)
    chords = np.linalg.norm(np.diff(places, axis=0), axis=1)
    if not (chords > LEAST_PART * driver.step_mm).all():
        raise GeometryError(message("error.its_point_hardly_moves"))
    along = np.concatenate([[0.0], np.cumsum(chords)])
    return closed, CubicSpline(along - along[len(back)], places)


def _walked(link: SevenLink, closed: FloatArray, way: FloatArray, driver: Driver, far: float) -> list[FloatArray]:
    """Poses after the one that is closed, until the point has gone so far and two steps more."""
    out, gone, last = [], 0.0, se3.apply(closed, driver.point)
    for pose in link.walk(closed, way, driver.step_mm):
        place = se3.apply(pose, driver.point)
        out.append(pose)
        gone, last = gone + float(np.linalg.norm(place - last)), place
        if gone > max(far, 0.0) + 2.0 * driver.step_mm:
            return out
        if len(out) >= MOST_STEPS:
            raise GeometryError(message("error.its_point_goes_mm", gone=gone, most_steps=MOST_STEPS, step_mm=driver.step_mm, far=far))
    raise GeometryError(message("error.the_way_comes_back", gone=gone, far=far))
