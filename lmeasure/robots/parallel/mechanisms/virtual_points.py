"""The forward problem of the crank platform by virtual points, nine equations in place of eighteen (source 003).

The six upper hinges lie on the sides of an equilateral triangle W1 W2 W3, whose corners are the unknowns:

    W = 2 r sin(60 - v/2) + 4 r sin(v/2),   K = sin(v/2) / (2 sin(v/2) + sin(60 - v/2)),
    b1 = W1 + K (W3 - W1), b2 = W1 + K (W2 - W1), b3 = W2 + K (W1 - W2), b4 = W2 + K (W3 - W2), b5 = W3 + K (W2 - W3),
    b6 = W3 + K (W1 - W3)                                                                       (b6 is missing in print)

with v the angle of a pair and r the circle's radius. Three sides |Wi - Wj| = W and six rods |b_i - c_i| = l_i close the loops. All are
quadratic.
"""

import math

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import triangles
from lmeasure.robots.parallel.mechanisms.crank import CrankPlatform
from lmeasure.robots.parallel.mechanisms.legs import Placed

_HINGES = ((0, 2), (0, 1), (1, 0), (1, 2), (2, 1), (2, 0))
"""Each hinge: the corner it is near and the corner its side leads to."""


def side_and_part(radius: float, pair: float) -> tuple[float, float]:
    """W [the radius' unit] and K for a platform of this radius and angle of a pair [rad]."""
    half, rest = math.sin(0.5 * pair), math.sin(math.pi / 3.0 - 0.5 * pair)
    return 2.0 * radius * rest + 4.0 * radius * half, half / (2.0 * half + rest)


def pose(corners: FloatArray) -> FloatArray:
    """(..., 7) base_from_platform of triangles (..., 3, 3): the origin in their centre, x towards W1, z across the plane."""
    centre = corners.mean(axis=-2)
    x, z = corners[..., 0, :] - centre, np.cross(corners[..., 1, :] - corners[..., 0, :], corners[..., 2, :] - corners[..., 0, :])
    x, z = x / np.linalg.norm(x, axis=-1, keepdims=True), z / np.linalg.norm(z, axis=-1, keepdims=True)
    matrix = np.stack([x, np.cross(z, x), z], axis=-1)
    return se3.pose(centre.reshape(-1, 3), Rotation.from_matrix(matrix.reshape(-1, 3, 3))).reshape(*centre.shape[:-1], 7)


def corners_at(mechanism: CrankPlatform, poses: FloatArray) -> FloatArray:
    """(..., 3, 3) corners at poses (..., 7): where the sides that the hinges lie on meet, W1 on the platform's x axis."""
    far = _side(mechanism)[0] / math.sqrt(3.0)
    azimuth = 2.0 * np.pi / 3.0 * np.arange(3)
    own = far * np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(3)])
    return np.asarray(poses[..., None, :3] + np.einsum("...ij,nj->...ni", se3.matrices(poses), own))


def forward(mechanism: CrankPlatform, drives: FloatArray, start: FloatArray) -> Placed:
    """Poses at crank angles (n, 3) [rad] from the pose start (7,), for a platform whose hinges lie on a circle in equal pairs."""
    side, part = _side(mechanism)
    # in parts of the side: the equations are of one size then
    begin = corners_at(mechanism, start).reshape(9) / side
    ends = np.ascontiguousarray(mechanism.legs(drives).ends / side)
    status, corners = triangles(begin, np.array(_HINGES), part, ends, mechanism.rods / side)
    found = np.asarray(status == Status.OK)
    poses = np.full((len(drives), 7), np.nan)
    poses[found] = pose(side * corners[found].reshape(-1, 3, 3))
    return Placed(poses, found)


def _side(mechanism: CrankPlatform) -> tuple[float, float]:
    first = mechanism.points[:2]
    return side_and_part(float(np.linalg.norm(first[0])), float(2.0 * np.arctan2(first[1, 1], first[1, 0])))
