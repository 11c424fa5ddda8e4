"""Calibration of any channels: their readings at reference poses, as a problem of estimation."""

from collections.abc import Collection
from functools import cached_property

import numpy as np
import scipy.linalg

from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, Problem
from reference.channel import Channels, Observation, differences, variances


class AtReferencePoses(Problem):
    """Readings (n, m) of m channels at reference poses (n, 7), NaN where there is none; pose_covariance (n, 6, 6) or (6, 6) of the poses'
    errors, (rotation [rad]; position [mm]), independent from pose to pose. solve: names of the parameters to be found, all that are
    uncertain by default; the others are taken as exact.

    `estimation.fit(problem, problem.start)` finds them.
    """

    covariance_varies = True

    def __init__(
        self,
        channels: Channels,
        readings: FloatArray,
        poses: FloatArray,
        pose_covariance: FloatArray | None = None,
        *,
        solve: Collection[str] | None = None,
    ) -> None:
        own = {q.name: q for o in channels for q in o.parameters}
        wanted = [q for q in own.values() if q.prior_u > 0.0 and (solve is None or q.name in solve)]
        self.parameters = Parameters(
            tuple(q.name for q in wanted), np.array([q.value for q in wanted]), np.array([q.prior_u for q in wanted])
        )
        self._channels, self._readings, self._poses = channels, readings, poses
        self._pose_covariance = (
            np.zeros((len(poses), 6, 6)) if pose_covariance is None else np.broadcast_to(pose_covariance, (len(poses), 6, 6))
        )
        self._used = np.isfinite(readings)

    def residuals(self, theta: FloatArray) -> FloatArray:
        """(e,) predicted less read, pose by pose."""
        predicted = np.stack([o.predict(self._poses, self.values_of(o, theta)) for o in self._channels], axis=1)
        return -differences(self._channels, self._readings, predicted)[self._used]

    def jacobian(self, theta: FloatArray) -> FloatArray:
        """(e, p) by the parameters."""
        out = np.zeros((*self._readings.shape, len(self.parameters.names)))
        for j, (o, (here, there)) in enumerate(zip(self._channels, self._places, strict=True)):
            out[:, j, there] = o.gradient(self._poses, self.values_of(o, theta))[:, here]
        return out[self._used]

    def covariance(self, theta: FloatArray) -> FloatArray:
        """(e, e) of the readings' own errors, and of the poses', which the readings of one pose share."""
        rows = np.stack([o.row(self._poses, self.values_of(o, theta)) for o in self._channels], axis=1)
        shared = rows @ self._pose_covariance @ np.swapaxes(rows, 1, 2) + np.diag(variances(self._channels))
        return np.asarray(scipy.linalg.block_diag(*(c[np.ix_(u, u)] for c, u in zip(shared, self._used, strict=True))))

    def values_of(self, observation: Observation, theta: FloatArray) -> FloatArray:
        """(q,) a channel's parameters with theta (p,) among them."""
        given = dict(zip(self.parameters.names, theta, strict=True))
        return np.array([given.get(q.name, q.value) for q in observation.parameters])

    @cached_property
    def _places(self) -> list[tuple[list[int], list[int]]]:
        """Of each channel: which of its parameters are to be found, and where theta has them."""
        index = {name: i for i, name in enumerate(self.parameters.names)}
        every = [[(i, index[q.name]) for i, q in enumerate(o.parameters) if q.name in index] for o in self._channels]
        return [([i for i, _ in pairs], [k for _, k in pairs]) for pairs in every]
