"""Sensors that nobody thought of: what a channel has to say, in a test's own words."""

from dataclasses import dataclass
from math import inf
from typing import Any

import numpy as np
from reference.channel import predictions, variances
from rigs import HOME, FloatArray

from lmeasure.core import se3
from lmeasure.rig import Parameter


@dataclass(frozen=True)
class Lean:
    """One of the two readings of an inclinometer: the sine of how far an axis of the tool leans, less a zero."""

    name: str
    parameters: tuple[Parameter, ...]
    axis: tuple[float, float, float]
    variance: float = 4e-10
    period: float = inf
    point: None = None

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        return se3.matrices(poses)[:, 2] @ self.axis - p[0]

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        turned = se3.matrices(poses) @ self.axis
        return np.hstack([np.cross(turned, [0.0, 0.0, 1.0]), np.zeros_like(turned)])

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        return np.full((len(poses), 1), -1.0)


@dataclass(frozen=True)
class Beam:
    """The distance from a place in the cell to the tool origin, times a scale that nobody knows well."""

    name: str
    parameters: tuple[Parameter, ...]
    variance: float = 1e-4
    period: float = inf

    @property
    def point(self) -> FloatArray:
        return np.zeros(3)

    def predict(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        return p[3] * np.linalg.norm(poses[:, :3] - p[:3], axis=1)

    def row(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        way = poses[:, :3] - p[:3]
        return np.hstack([np.zeros_like(way), p[3] * way / np.linalg.norm(way, axis=1)[:, None]])

    def gradient(self, poses: FloatArray, p: FloatArray) -> FloatArray:
        return np.column_stack([-self.row(poses, p)[:, 3:], self.predict(poses, p) / p[3]])


def sensors() -> list[Any]:
    leans = [
        Lean(f"lean {a}", (Parameter(f"lean {a}.zero", 2e-3, 5e-3, ""),), axis) for a, axis in (("x", (1.0, 0, 0)), ("y", (0, 1.0, 0)))
    ]
    where = [Parameter(f"beam.{k}_mm", v, 5.0) for k, v in zip("xyz", (-400.0, 250.0, -900.0), strict=True)]
    return [*leans, Beam("beam", (*where, Parameter("beam.scale", 1.002, 0.01, "")))]


def around(seed: int, n: int) -> FloatArray:
    g = np.random.default_rng(seed)
    return se3.displaced(HOME, np.column_stack([g.uniform(-0.2, 0.2, (n, 3)), g.uniform(-250.0, 250.0, (n, 3))]))


def read(channels: list[Any], at: FloatArray, seed: int) -> FloatArray:
    noise = np.random.default_rng(seed).normal(size=(len(at), len(channels)))
    return predictions(channels, at) + noise * np.sqrt(variances(channels))
