"""Assemblies of straight links of given lengths, corner by corner of tetrahedra (thesis 4.1)."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.kernels.tetrahedron import apex

Placed = dict[int, FloatArray]
"""Attachment points that have their places [mm], by their numbers."""


def by_tetrahedra(base: FloatArray, body: FloatArray, lengths: FloatArray) -> FloatArray:
    """(k, 7) poses base_from_body at which links of the lengths (m,) [mm] join the points base (m, 3), in the base frame, to the points
    body (m, 3), in the body's; none where tetrahedra do not lead to three points of the body."""
    points = np.unique(body, axis=0)
    of = [np.flatnonzero((body == p).all(axis=1)) for p in points]
    ways: list[Placed] = [{}] if len(points) >= 3 else []
    for _ in points:
        ways = [more for placed in ways for more in _next(placed, points, of, base, lengths)]
    poses = []
    for placed in ways:
        local, there = points[list(placed)], np.array(list(placed.values()))
        turn = Rotation.align_vectors(there - there.mean(axis=0), local - local.mean(axis=0))[0]
        poses.append(se3.pose(there.mean(axis=0) - turn.apply(local.mean(axis=0)), turn))
    return np.array(poses).reshape(len(poses), 7)


def _next(placed: Placed, points: FloatArray, of: list[NDArray[np.intp]], base: FloatArray, lengths: FloatArray) -> list[Placed]:
    """What is placed with one more point, on both sides of a plane of three that are known; none where no point has three."""
    for i, links in enumerate(of):
        corners = [(base[j], lengths[j]) for j in links] + [(there, np.linalg.norm(points[i] - points[k])) for k, there in placed.items()]
        if i in placed or len(corners) < 3:
            continue
        (a, ra), (b, rb), (c, rc) = corners[:3]
        above, below, square = apex(tuple(a), tuple(b), tuple(c), float(ra), float(rb), float(rc))
        if square == square:
            return [{**placed, i: np.array(p)} for p in (above, below)]
    return []
