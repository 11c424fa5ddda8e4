"""Problems that have nothing to do with cables."""

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lmeasure.estimation import Nuisance, Parameters, Problem

FloatArray = NDArray[np.float64]


class Circle(Problem):
    """A circle through points (e, 2) whose distances from it err by u; its colour is a parameter that no point tells."""

    def __init__(self, points: FloatArray, u: float) -> None:
        self.points, self.u = points, u
        self.parameters = Parameters(
            ("circle.x_mm", "circle.y_mm", "circle.r_mm", "paint.colour"),
            np.array([0.0, 0.0, 90.0, 0.5]),
            np.array([20.0, 20.0, 20.0, 0.1]),
        )

    def residuals(self, theta: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(self.points - theta[:2], axis=1) - theta[2])

    def jacobian(self, theta: FloatArray) -> FloatArray:
        way = self.points - theta[:2]
        e = len(way)
        return np.column_stack([-way / np.linalg.norm(way, axis=1)[:, None], -np.ones(e), np.zeros(e)])

    def covariance(self, theta: FloatArray) -> FloatArray:
        return self.u**2 * np.eye(len(self.points))


@dataclass(frozen=True)
class Readings:
    """Readings y (e,) at x (e,), and covariances (e, e) that are added to that of readings which err by u."""

    x: FloatArray
    y: FloatArray
    u: float = 0.1
    more: FloatArray | None = None
    taken: FloatArray | None = None
    rounded: bool = False


class Line(Problem):
    """A polynomial through readings: a straight line, or with degree 2 a parabola."""

    def __init__(self, readings: Readings, degree: int = 1) -> None:
        self.readings, self.degree = readings, degree
        names = ("line.offset", "line.slope", "line.bend")[: degree + 1]
        self.parameters = Parameters(names, np.zeros(degree + 1), np.full(degree + 1, 10.0))

    def residuals(self, theta: FloatArray) -> FloatArray:
        return np.asarray(self.jacobian(theta) @ theta - self.readings.y)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        return np.vander(self.readings.x, self.degree + 1, increasing=True)

    def covariance(self, theta: FloatArray) -> FloatArray:
        V = self.readings.u**2 * np.eye(len(self.readings.x))
        return V if self.readings.more is None else V + self.readings.more

    @property
    def taken_back(self) -> FloatArray | None:
        return self.readings.taken

    def uniform(self) -> tuple[FloatArray, FloatArray]:
        e = len(self.readings.x)
        return np.full(e, self.readings.u**2 if self.readings.rounded else 0.0), np.zeros((e, 0))


@dataclass(frozen=True)
class Plane:
    """Stations (m, 2) and targets (n, 2) in a plane, and which targets are seen from which station."""

    stations: FloatArray
    targets: FloatArray
    seen: NDArray[np.bool_] = field(repr=False)


class Stations(Problem):
    """Distances from stations that are roughly known to targets that are not: targets are nuisance parameters. With since_first distances
    are counted from the first target, whose block every residual shares."""

    def __init__(self, nominal: Plane, measured: FloatArray, u: float, *, since_first: bool) -> None:
        self.nominal, self.u, self.since_first = nominal, u, since_first
        target, station = np.nonzero(nominal.seen)
        keep = target > 0 if since_first else np.ones(len(target), np.bool_)
        self.target, self.station = target[keep], station[keep]
        self.measured = measured[self.target, self.station] - since_first * measured[0, self.station]
        m, n = len(nominal.stations), len(nominal.targets)
        self.parameters = Parameters(tuple(f"S{j}.{a}" for j in range(m) for a in "xy"), nominal.stations.reshape(-1), np.full(2 * m, 5.0))
        names = tuple(f"target {i}.{a}" for i in range(n) for a in "xy")
        self.nuisance = Nuisance(2, names, self.target, np.array([0] if since_first else [], dtype=np.int64))

    def _ways(self, theta: FloatArray, target: NDArray[np.int64]) -> FloatArray:
        targets = self.nominal.targets + theta[self.own :].reshape(-1, 2)
        return np.asarray(targets[target] - theta[: self.own].reshape(-1, 2)[self.station])

    def residuals(self, theta: FloatArray) -> FloatArray:
        length = np.linalg.norm(self._ways(theta, self.target), axis=1)
        if self.since_first:
            length = length - np.linalg.norm(self._ways(theta, np.zeros_like(self.target)), axis=1)
        return np.asarray(length - self.measured)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        J, every = np.zeros((len(self.target), len(theta))), np.arange(len(self.target))
        for target, sign in ((self.target, 1.0), (np.zeros_like(self.target), -1.0))[: 1 + self.since_first]:
            way = self._ways(theta, target)
            way = sign * way / np.linalg.norm(way, axis=1)[:, None]
            for a in range(2):
                J[every, 2 * self.station + a] -= way[:, a]
                J[every, self.own + 2 * target + a] += way[:, a]
        return J

    def covariance(self, theta: FloatArray) -> FloatArray:
        same = self.station[:, None] == self.station
        return self.u**2 * (np.eye(len(self.target)) + self.since_first * same)
