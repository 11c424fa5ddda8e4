"""How far an axis of the tool leans from the horizontal."""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.rig import Parameter

AXIS, UP, ZERO = slice(0, 3), slice(3, 6), 6


@dataclass(frozen=True, eq=False)
class Inclination:
    """The angle [rad] of a sensing axis of the body above the horizontal, less the zero; an inclinometer has two such axes, one channel
    each.

    parameters (7,): the axis in the tool frame (0:3) and the way up in the base frame (3:6), of any length, and the zero (6) [deg].
    """

    name: str
    parameters: tuple[Parameter, ...]
    variance: float
    period: ClassVar[float] = inf
    point: ClassVar[None] = None

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) readings [rad]."""
        axis, up = _turned(poses, p)
        return np.arctan2(axis @ up, np.linalg.norm(np.cross(axis, up), axis=1)) - np.radians(p[ZERO])

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 6) by the motion."""
        axis, up = _turned(poses, p)
        across = np.cross(axis, up)
        # the angle grows where the axis turns about what is normal to it and the way up
        omega = across / np.linalg.norm(across, axis=1)[:, None]
        return np.concatenate([omega, np.zeros_like(omega)], axis=1)

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 7) by the parameters."""
        axis, up = _turned(poses, p)
        omega = self.row(poses, p)[:, :3]
        by_axis = np.cross(omega, axis) / (axis * axis).sum(axis=1)[:, None]
        by_up = np.cross(up, omega) / (up @ up)
        own = np.einsum("nji,nj->ni", se3.matrices(poses), by_axis)
        return np.concatenate([own, by_up, np.full((len(poses), 1), -np.pi / 180.0)], axis=1)


def _turned(poses: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The axis (n, 3) and the way up (3,), base axes."""
    return np.asarray(se3.matrices(poses) @ p[AXIS]), p[UP]
