"""The angle by which a swivel pulley is turned about the cable that comes to it."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.rig import Parameter
from lmeasure.sensors.wrap import by_guide, guide
from reference.channel import arms, by_point, row_of, values

TURN = 2.0 * np.pi
DEGREE = np.pi / 180.0
ZERO = 8


@dataclass(frozen=True, eq=False)
class SwivelAngle:
    """The angle [rad] of the pulley's plane, in which the attachment point P lies, about the way of travel u at the observation point B:
    atan2((P - B).e1, (P - B).e0) less the zero, with e0 normal to u and upward and e1 = u x e0.

    parameters (9,): B (0:3), the guide's angles alpha and beta (3:5), P in the tool frame (5:8), the zero (8), mm and deg. A turn more is
    the same angle, of an incremental encoder too: its turns are nothing that a pose could tell.
    """

    name: str
    parameters: tuple[Parameter, ...]
    variance: float
    period: ClassVar[float] = TURN

    @property
    def point(self) -> FloatArray:
        """(3,) the attachment point, tool frame."""
        return values(self)[5:8]

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) readings [rad]."""
        frame, way, _ = self._seen(poses, p)
        return np.arctan2(way @ frame[2], way @ frame[1]) - np.radians(p[ZERO])

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 6) by the motion."""
        return row_of(arms(poses, p[5:8]), self._seen(poses, p)[2])

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 9) by the parameters."""
        frame, way, by_way = self._seen(poses, p)
        of_guide, zero = by_guide(frame, way, by_way), np.full((len(poses), 1), -1.0)
        return np.concatenate([-by_way, DEGREE * of_guide, by_point(poses, by_way), DEGREE * zero], axis=1)

    def _seen(self, poses: FloatArray, p: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The guide's frame, the ways (n, 3) from B to P, and the gradient (n, 3) of the angle by the way."""
        frame = guide(*np.radians(p[3:5]))
        way = poses[:, :3] + arms(poses, p[5:8]) - p[:3]
        x, y = way @ frame[1], way @ frame[2]
        with np.errstate(invalid="ignore", divide="ignore"):
            return frame, way, (x[:, None] * frame[2] - y[:, None] * frame[1]) / (x * x + y * y)[:, None]
