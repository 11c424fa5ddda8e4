"""How far a mechanism goes: along each of its six coordinates from a pose, and over a grid of places."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lmeasure.core import BoolArray, FloatArray, se3

Inside = Callable[[FloatArray], BoolArray]
"""Which of poses (n, 7) a mechanism may take."""

STEPS = 200


def ranges(inside: Inside, home: FloatArray, most: FloatArray) -> FloatArray:
    """(6, 2) least and largest displacement (turns about the base's axes [rad], shifts [mm]) from the pose home (7,), one coordinate at
    a time, without leaving what is inside on the way; searched to +-most (6,) in `STEPS` steps each way. Zeros where home is outside."""
    out = np.zeros((6, 2))
    for axis in range(6):
        for way, sign in enumerate((-1.0, 1.0)):
            delta = np.zeros((STEPS + 1, 6))
            delta[:, axis] = sign * most[axis] * np.linspace(0.0, 1.0, STEPS + 1)
            kept = inside(se3.displaced(np.broadcast_to(home, (STEPS + 1, 7)), delta))
            last = int(np.argmin(kept)) - 1 if not kept.all() else STEPS
            out[axis, way] = delta[max(last, 0), axis]
    return out


class Workspace(NamedTuple):
    """inside (len(x), len(y), len(z)) at the nodes; volume_mm3: of the cells about the nodes inside."""

    x_mm: FloatArray
    y_mm: FloatArray
    z_mm: FloatArray
    inside: BoolArray

    @property
    def volume_mm3(self) -> float:
        """Nodes inside times the cell of the grid."""
        return float(self.inside.sum() * np.prod([a[1] - a[0] for a in self[:3]]))


def workspace(inside: Inside, x_mm: FloatArray, y_mm: FloatArray, z_mm: FloatArray, *, orientation: FloatArray | None = None) -> Workspace:
    """Of evenly spaced nodes (at least two each way), the platform turned by the quaternion orientation (4,), by default not at all."""
    place = np.stack(np.meshgrid(x_mm, y_mm, z_mm, indexing="ij"), axis=-1)
    turn = np.array([0.0, 0.0, 0.0, 1.0]) if orientation is None else orientation
    poses = np.concatenate([place.reshape(-1, 3), np.broadcast_to(turn, (place[..., 0].size, 4))], axis=1)
    return Workspace(x_mm, y_mm, z_mm, inside(poses).reshape(place.shape[:3]))
