"""What is asked of a channel, whatever it measures, and channels taken together.

A reading is a length [mm] or an angle [rad], made of recorded counts by what the rig states of drum or encoder
(docs/decisions/0032). Poses are (n, 7), base_from_tool (`lmeasure.core.se3`). Parameters are numbers that a reading depends on besides
the pose,
each in its own unit; those of one name are one number, which several channels share.
"""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import pluecker_rows
from lmeasure.rig import Parameter


class Observation(Protocol):
    """What one channel measures.

    name: the channel's; parameters (q,): what a reading depends on, with the values that they are taken to have; variance of one reading,
    its unit squared; period: readings that differ by it are the same (a turn, 2 pi), infinite where none are; point (3,): the place on the
    tool that the channel looks at, in the tool frame, None of one that only sees how the tool is turned.
    """

    @property
    def name(self) -> str: ...
    @property
    def parameters(self) -> tuple[Parameter, ...]: ...
    @property
    def variance(self) -> float: ...
    @property
    def period(self) -> float: ...
    @property
    def point(self) -> FloatArray | None: ...

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n,) readings at poses (n, 7) with parameters p (q,); NaN where there is none."""

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, 6) derivatives of the readings by a small motion (omega; v) in base axes, v at the tool origin."""

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        """(n, q) derivatives of the readings by the parameters."""


Channels = Sequence[Observation]


def values(observation: Observation) -> FloatArray:
    """(q,) what its parameters are taken to be."""
    return np.array([q.value for q in observation.parameters])


def predictions(channels: Channels, poses: FloatArray) -> FloatArray:
    """(n, m) readings of m channels at (n, 7) poses."""
    return np.stack([o.predict(poses, values(o)) for o in channels], axis=1)


def rows(channels: Channels, poses: FloatArray) -> FloatArray:
    """(n, m, 6) their rows."""
    return np.stack([o.row(poses, values(o)) for o in channels], axis=1)


def variances(channels: Channels) -> FloatArray:
    """(m,) their variances."""
    return np.array([o.variance for o in channels])


def differences(channels: Channels, readings: FloatArray, predicted: FloatArray) -> FloatArray:
    """(n, m) readings less predicted ones, the shortest way around where readings repeat themselves; NaN where there is no reading."""
    period = np.array([o.period for o in channels])
    difference = readings - predicted
    repeats = np.isfinite(period)
    difference[:, repeats] -= period[repeats] * np.round(difference[:, repeats] / period[repeats])
    return difference


def size_mm(channels: Channels) -> float:
    """Length that makes turns comparable with shifts: the largest distance of a point that is looked at from the tool origin [mm]."""
    return max([float(np.linalg.norm(o.point)) for o in channels if o.point is not None] + [1e-3])


def arms(poses: FloatArray, point: FloatArray) -> FloatArray:
    """(n, 3) from the tool origin to a point (3,) of the tool, base axes."""
    return np.asarray(se3.matrices(poses) @ point)


def row_of(arm: FloatArray, gradient: FloatArray) -> FloatArray:
    """(n, 6) row of what changes by gradient (n, 3) per mm that the point at arm (n, 3) moves."""
    return pluecker_rows(arm, gradient)


def by_point(poses: FloatArray, gradient: FloatArray) -> FloatArray:
    """(n, 3) of the same, by the coordinates of the point in the tool frame."""
    return np.asarray(np.einsum("nji,nj->ni", se3.matrices(poses), gradient))
