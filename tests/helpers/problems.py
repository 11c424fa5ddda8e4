"""Problems that have nothing to do with cables."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from lmeasure.estimation import Nuisance, Parameters, Problem

FloatArray = NDArray[np.float64]
Function = Callable[[FloatArray], FloatArray]


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
    are counted from the first target, whose block every residual shares, or from one of the first so many in turn; taken (e,) of the
    variances was given them by a robust loss."""

    def __init__(
        self, nominal: Plane, measured: FloatArray, u: float, *, since_first: bool, firsts: int = 1, taken: FloatArray | None = None
    ) -> None:
        self.nominal, self.u, self.since_first, self.taken = nominal, u, since_first, taken
        target, station = np.nonzero(nominal.seen)
        keep = target != station % firsts if since_first else np.ones(len(target), np.bool_)
        self.target, self.station = target[keep], station[keep]
        self.first = self.station % firsts
        self.measured = measured[self.target, self.station] - since_first * measured[self.first, self.station]
        m, n = len(nominal.stations), len(nominal.targets)
        self.parameters = Parameters(tuple(f"S{j}.{a}" for j in range(m) for a in "xy"), nominal.stations.reshape(-1), np.full(2 * m, 5.0))
        names = tuple(f"target {i}.{a}" for i in range(n) for a in "xy")
        self.nuisance = Nuisance(2, names, self.target, np.arange(firsts if since_first else 0))

    def _ways(self, theta: FloatArray, target: NDArray[np.int64]) -> FloatArray:
        targets = self.nominal.targets + theta[self.own :].reshape(-1, 2)
        return np.asarray(targets[target] - theta[: self.own].reshape(-1, 2)[self.station])

    def residuals(self, theta: FloatArray) -> FloatArray:
        length = np.linalg.norm(self._ways(theta, self.target), axis=1)
        if self.since_first:
            length = length - np.linalg.norm(self._ways(theta, self.first), axis=1)
        return np.asarray(length - self.measured)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        J, every = np.zeros((len(self.target), len(theta))), np.arange(len(self.target))
        for target, sign in ((self.target, 1.0), (self.first, -1.0))[: 1 + self.since_first]:
            way = self._ways(theta, target)
            way = sign * way / np.linalg.norm(way, axis=1)[:, None]
            for a in range(2):
                J[every, 2 * self.station + a] -= way[:, a]
                J[every, self.own + 2 * target + a] += way[:, a]
        return J

    def covariance(self, theta: FloatArray) -> FloatArray:
        same = self.station[:, None] == self.station
        V = self.u**2 * (np.eye(len(self.target)) + self.since_first * same)
        return V if self.taken is None else V + np.diag(self.taken)

    @property
    def taken_back(self) -> FloatArray | None:
        return self.taken


class Curve(Problem):
    """Residuals (e,) that err by one each, by a function of values (p,) in prior widths from nominal ones, and its derivatives (e, p). With
    beside there is a place too, of which nothing is known before and which two more residuals tell; values do not hang on it."""

    def __init__(self, of: Function, by: Function, nominal: FloatArray, *, beside: bool = False) -> None:
        self.parameters = Parameters(tuple(f"curve.{i}" for i in range(len(nominal))), nominal, np.ones(len(nominal)))
        self.of, self.by, self.beside = of, by, beside
        if beside:
            self.nuisance = Nuisance(1, ("place",), np.zeros(len(of(nominal)) + 2, np.int64), np.zeros(0, np.int64))

    def residuals(self, theta: FloatArray) -> FloatArray:
        r = self.of(theta[: self.own])
        return np.r_[r, theta[-1] - 3.0, theta[-1] - 3.0] if self.beside else r

    def jacobian(self, theta: FloatArray) -> FloatArray:
        J = self.by(theta[: self.own])
        return scipy.linalg.block_diag(J, np.ones((2, 1))) if self.beside else J

    def covariance(self, theta: FloatArray) -> FloatArray:
        return np.eye(len(self.residuals(theta)))


class Tied:
    """The gauge of stations in a plane: nothing tells how the whole is shifted and turned, so the first station is put where it
    nominally is and the second one in the direction that it nominally has from there."""

    def __init__(self, problem: Stations, *, keeps_prior: bool = False) -> None:
        self.problem, self.keeps_prior = problem, keeps_prior
        self.at = np.r_[np.zeros(problem.own), problem.nominal.targets.reshape(-1)]
        way = problem.nominal.stations[1] - problem.nominal.stations[0]
        self.normal = np.array([-way[1], way[0]]) / np.linalg.norm(way)

    @property
    def conditions(self) -> FloatArray:
        """(3, P) of small changes."""
        C = np.zeros((3, len(self.at)))
        C[0, 0] = C[1, 1] = 1.0
        C[2, :4] = np.r_[-self.normal, self.normal]
        return C

    def motions(self, theta: FloatArray) -> FloatArray:
        points = (self.at + theta).reshape(-1, 2)
        turn = np.column_stack([-points[:, 1], points[:, 0]])
        return np.column_stack([np.tile([1.0, 0.0], len(points)), np.tile([0.0, 1.0], len(points)), turn.reshape(-1)])

    def settled(self, theta: FloatArray) -> FloatArray:
        points, first, second = (self.at + theta).reshape(-1, 2), *self.problem.nominal.stations[:2]
        (x, y), (to_x, to_y) = points[1] - points[0], second - first
        angle = np.arctan2(to_y, to_x) - np.arctan2(y, x)
        turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        return np.asarray(((points - points[0]) @ turn.T + first).reshape(-1) - self.at)

    def projection(self, theta: FloatArray) -> FloatArray:
        G, C = self.motions(theta), self.conditions
        return np.eye(len(theta)) - G @ np.linalg.solve(C @ G, C)


def arc(turn: float, count: int, u: float, seed: int) -> Circle:
    """A circle about (3, -2) of radius 100, seen along an arc."""
    angle = np.linspace(0.0, turn, count)
    r = 100.0 + np.random.default_rng(seed).normal(0, u, count)
    return Circle(np.column_stack([3.0 + r * np.cos(angle), -2.0 + r * np.sin(angle)]), u)


def plane(seed: int, *, since_first: bool, u: float = 0.01, hidden: int = 0, blind: bool = False, firsts: int = 1) -> Stations:
    """Five stations off by their priors, of which the last may be blind, and twelve targets; hidden many, behind those that are counted
    from, only two of them see."""
    rng = np.random.default_rng(seed)
    true = np.array([[0.0, 0.0], [1000.0, 50.0], [900.0, 800.0], [-50.0, 900.0], [400.0, -300.0]])
    targets = rng.uniform(100, 800, (12, 2))
    seen = np.ones((12, 5), np.bool_)
    seen[:, 4] = not blind
    seen[firsts : firsts + hidden, 2:] = False
    distance = np.linalg.norm(targets[:, None] - true, axis=2) + rng.normal(0, u, (12, 5))
    nominal = Plane(true + rng.normal(0, 5.0, true.shape), targets + rng.normal(0, 30.0, targets.shape), seen)
    return Stations(nominal, distance, u, since_first=since_first, firsts=firsts)
