"""A channel that no rig file knows: the straight distance from a fixed point to a point of the tool, without pulley or drum."""

from dataclasses import dataclass
from math import inf
from typing import ClassVar

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import Parameter
from reference.channel import arms, by_point, row_of, values

ZERO = 6


@dataclass(frozen=True, eq=False)
class Distance:
    """The distance [mm] from a fixed point B to a point P of the tool less the zero.

    parameters (7,): B in the base frame (0:3), P in the tool frame (3:6), the zero (6), mm.
    """

    name: str
    parameters: tuple[Parameter, ...]
    variance: float
    period: ClassVar[float] = inf

    @property
    def point(self) -> FloatArray:
        """(3,) the point of the tool, tool frame."""
        return values(self)[3:6]

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) readings [mm]."""
        return np.linalg.norm(self._way(poses, p), axis=1) - p[ZERO]

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 6) by the motion."""
        return row_of(arms(poses, p[3:6]), _unit(self._way(poses, p)))

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 7) by the parameters."""
        e = _unit(self._way(poses, p))
        return np.concatenate([-e, by_point(poses, e), np.full((len(poses), 1), -1.0)], axis=1)

    def _way(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        return poses[:, :3] + arms(poses, p[3:6]) - p[:3]


def _unit(way: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore"):
        return way / np.linalg.norm(way, axis=1)[:, None]
