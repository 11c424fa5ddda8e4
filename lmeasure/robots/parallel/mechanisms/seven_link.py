"""A body on five binary links between ball joints, 5(SS): one freedom, followed along its path (source 004).

Five equations |R B_j + o - A_j| = l_j leave a pose one freedom. Its way is followed by arc length, |ds|^2 = |do|^2 + (size |omega|)^2: a
single coordinate is a bad driver where it stops, as the turn phi about the body's axis does between poses 5 and 6 of the source. Angles
there are R = Rz(psi) Rx(theta) Rz(phi), unique among all orders and signs for its tables.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import count, islice
from typing import NamedTuple

import numpy as np
from scipy.linalg import null_space
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, GeometryError, se3

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

    def closed(self, pose: FloatArray, iterations: int = 50) -> FloatArray:
        """(7,) the pose of the mechanism nearest to one (7,) by steps of least length in the metric of the path. GeometryError where the
        links do not meet."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        for _ in range(iterations):
            lacks = self.residuals(pose)
            step = -scale * np.linalg.lstsq(self.rows(pose) * scale, lacks, rcond=1e-12)[0]
            step /= max(1.0, float(np.linalg.norm(step[:3])) / 0.3)
            pose = se3.displaced(pose, step)
            if np.abs(step / scale).max() < CLOSES * self.lengths.max():
                break
        if np.abs(self.residuals(pose)).max() > 1e3 * CLOSES * self.lengths.max():
            raise GeometryError(f"the links do not meet near this pose: {np.abs(self.residuals(pose)).max():.3g} off")
        return pose

    def tangent(self, pose: FloatArray) -> FloatArray:
        """(6,) displacement (omega; shift) of unit arc length along the path. GeometryError where the mechanism has more freedoms."""
        scale = np.array([1.0 / self.size] * 3 + [1.0] * 3)
        free = null_space(self.rows(pose) * scale, rcond=1e-9)
        if free.shape[1] != 1:
            raise GeometryError(f"a singular pose: {free.shape[1]} freedoms instead of one")
        return np.asarray(scale * free[:, 0])

    def path(self, start: FloatArray, step: float, most: int = 10000) -> "Path":
        """The way through a pose (7,) by steps of arc length, until it comes back to its start, or most steps were made each way.

        A singular pose on it is passed over, since a chord leads past it; that the way goes on straight there is how it is met.
        """
        first = self.closed(start)
        ahead, back = self.tangent(first), -self.tangent(first)
        forth, closed = self._followed(first, ahead, step, most)
        if closed:
            return Path(np.array([first, *forth]), True)
        other, _ = self._followed(first, back, step, most)
        return Path(np.array([*other[::-1], first, *forth]), False)

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

    def _followed(self, first: FloatArray, way: FloatArray, step: float, most: int) -> tuple[list[FloatArray], bool]:
        out = list(islice(self.walk(first, way, step), most + 1))
        return out[:most], len(out) <= most

    def _spans(self, poses: FloatArray) -> FloatArray:
        return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), self.points) - self.anchors)


class Path(NamedTuple):
    """poses (k, 7) evenly along the way; returns: whether it comes back to where it began."""

    poses: FloatArray
    returns: bool


def pose_of(coordinates: FloatArray) -> FloatArray:
    """(..., 7) poses of rows (X, Y, Z, psi, theta, phi), angles [rad]: R = Rz(psi) Rx(theta) Rz(phi)."""
    flat = np.asarray(coordinates).reshape(-1, 6)
    return se3.pose(flat[:, :3], Rotation.from_euler("ZXZ", flat[:, 3:])).reshape(*np.shape(coordinates)[:-1], 7)


def coordinates_of(poses: FloatArray) -> FloatArray:
    """(..., 6) (X, Y, Z, psi, theta, phi) of poses (..., 7), theta in [0, pi]."""
    flat = poses.reshape(-1, 7)
    angles = se3.rotation(flat).as_euler("ZXZ")
    return np.concatenate([flat[:, :3], angles], axis=1).reshape(*poses.shape[:-1], 6)


def exact_positions(chain_parameters: int, chains: int, constraints: int, unknown: int) -> int:
    """Most poses that a mechanism of equal chains can take exactly, of which so many coordinates are left open each time (source 004, 6).

    N (n S - m) <= n k - m for n chains of k parameters and S constraints and m open coordinates: each pose adds m unknowns but the first,
    whose open ones only say how the body's frame lies on it. 5(SS) with one open turn: (5 * 7 - 1) / (5 - 1) = 8.5, so eight.
    """
    return (chains * chain_parameters - unknown) // (chains * constraints - unknown)
