"""Published examples of uncertainty, through the propagation that certificates use.

JCGM 100:2008, annex H; JCGM 101:2008, clause 9; JCGM 102:2011, clause 9. Numbers are printed with two or three digits.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.iso9283 import Spread, Subject, propagate
from lmeasure.trajectory import PoseErrors

AT = Subject("pose", "P1")
TRIALS = 100_000
Model = Callable[[FloatArray], FloatArray]


class Inputs:
    """Input quantities (k,) as errors of poses, six a pose, which the root (k, k) of their covariance mixes."""

    def __init__(self, values: Sequence[float] | FloatArray, root: FloatArray, rectangular: Sequence[bool]) -> None:
        k = len(values)
        poses = -(-k // 6)
        self.values, self.root, self.positions = np.array(values, dtype=np.float64), root, np.zeros((poses, 3))
        shared = np.eye(6 * poses, k).reshape(poses, 6, k)
        self.errors = PoseErrors.of(np.zeros((poses, 6, 0)), shared, uniform=tuple(rectangular))

    def state(self, errors: FloatArray, reduced: bool) -> FloatArray:
        """Return the quantities (..., k), off by errors (..., n, 6)."""
        z = errors.reshape(*errors.shape[:-2], -1)[..., : len(self.values)]
        return np.asarray(self.values + z @ self.root.T)


@dataclass(frozen=True)
class Example:
    """Functions of (..., k) quantities with values and u (k,), normal or rectangular, and the printed result: statistic, numbers, largest
    relative difference. Statistics: u by first order, drawn u, bias, u95, r of pairs of results, parts: contributions to the first
    result."""

    name: str
    models: tuple[Model, ...]
    values: Sequence[float] | FloatArray
    u: Sequence[float] | FloatArray
    printed: tuple[tuple[str, tuple[float, ...], float], ...]
    rectangular: Sequence[bool] = ()
    correlation: FloatArray | None = None

    def spreads(self) -> list[Spread]:
        """Return the results of the propagation."""
        root = np.diag(np.asarray(self.u, dtype=np.float64))
        if self.correlation is not None:
            root = root @ np.linalg.cholesky(self.correlation)
        part = Inputs(self.values, root, self.rectangular or [False] * len(self.values))
        return propagate({AT: part}, [lambda states, f=f: f(states[AT]) for f in self.models], trials=TRIALS, seed=1)  # type: ignore[misc]

    def differences(self) -> dict[str, float]:
        """Return the largest difference of each statistic from the printed one, in allowed ones."""
        found, out = self.spreads(), {}
        columns = [s.sensitivities for s in found]
        statistics = {
            "u": [float(np.linalg.norm(c)) for c in columns],
            "drawn": [s.u_drawn for s in found],
            "bias": [s.bias for s in found],
            "u95": [s.u95 for s in found],
            "r": [float(a @ b / np.linalg.norm(a) / np.linalg.norm(b)) for a, b in combinations(columns, 2)],
            "parts": [abs(c) for c in columns[0].tolist() if c],
        }
        for name, printed, allowed in self.printed:
            pairs = zip(statistics[name], printed, strict=False)
            out[name] = max(abs(mine - theirs) / (allowed * (abs(theirs) or 1.0)) for mine, theirs in pairs)
        return out


def _gauge(x: FloatArray) -> FloatArray:
    ls, d, d1, d2, alpha, theta, cyclic, dalpha, dtheta = np.moveaxis(x, -1, 0)
    return np.asarray(ls + d + d1 + d2 - ls * (dalpha * (theta + cyclic) + alpha * dtheta))


def _mass(x: FloatArray) -> FloatArray:
    m, d, air, weight, reference = np.moveaxis(x, -1, 0)
    return np.asarray((m + d) * (1.0 + (air - 1.2) * (1.0 / weight - 1.0 / reference)))


def _sum(x: FloatArray) -> FloatArray:
    return np.asarray(x.sum(axis=-1))


def _squares(x: FloatArray) -> FloatArray:
    return np.asarray((x**2).sum(axis=-1))


POLAR: tuple[Model, ...] = (lambda x: np.hypot(x[..., 0], x[..., 1]), lambda x: np.arctan2(x[..., 1], x[..., 0]))
SUMS: tuple[Model, ...] = (lambda x: x[..., 0] + x[..., 2], lambda x: x[..., 1] + x[..., 2])
IMPEDANCE: tuple[Model, ...] = (
    lambda x: x[..., 0] / x[..., 1] * np.cos(x[..., 2]),
    lambda x: x[..., 0] / x[..., 1] * np.sin(x[..., 2]),
    lambda x: x[..., 0] / x[..., 1],
)
THERMOMETER_C = np.array([21.521, 22.012, 22.512, 23.003, 23.507, 23.999, 24.513, 25.002, 25.503, 26.010, 26.511])
CORRECTIONS_C = np.array([-0.171, -0.169, -0.166, -0.159, -0.164, -0.165, -0.156, -0.157, -0.159, -0.161, -0.160])
_LINE = np.linalg.pinv(np.column_stack([np.ones(11), THERMOMETER_C - 20.0]))
_SCATTER = float(np.sqrt(np.sum((CORRECTIONS_C - np.linalg.pinv(_LINE) @ _LINE @ CORRECTIONS_C) ** 2) / 9))
LINE: tuple[Model, ...] = (lambda x: x @ _LINE[0], lambda x: x @ _LINE[1], lambda x: x @ (_LINE[0] + 10.0 * _LINE[1]))
_R_H2 = np.array([[1.0, -0.36, 0.86], [-0.36, 1.0, -0.65], [0.86, -0.65, 1.0]])
_R_H4 = np.eye(5) + 0.646 * (np.eye(5, k=1) + np.eye(5, k=-1)) * np.outer([0, 0, 0, 1, 1], [0, 0, 0, 1, 1])
# of t with so many degrees of freedom the variance is larger; limits that are uncertain by d add d^2 / 9 to a rectangular one
_OF_T = [u * (nu / (nu - 2)) ** 0.5 for u, nu in ((25, 18), (6, 24), (4, 5), (7, 8))]
_LIMITS = [(a**2 / 3 + d**2 / 9) ** 0.5 for a, d in ((1e-6, 0.1e-6), (0.05, 0.025))]
_H1_U = (25.0, 5.8, 3.9, 6.7, 2e-6 / 3**0.5, 0.2, 0.5 / 2**0.5, 1e-6 / 3**0.5, 0.05 / 3**0.5)
_GAUGE = (50000623.0, 215.0, 0.0, 0.0, 11.5e-6, -0.1, 0.0, 0.0, 0.0)
_SHAPES = (False,) * 4 + (True, False, False, True, True)
_OF_MASS = (0.05, 0.02, 0.1 / 3**0.5, 1000 / 3**0.5, 50 / 3**0.5)
_PARTS_H1 = (25.0, 5.8, 3.9, 6.7, 2.9, 16.6)
_PARTS_H6 = (0.45 / 5**0.5, 0.1 / 12**0.5, 0.11, 0.5)

EXAMPLES: tuple[Example, ...] = (
    Example(
        "JCGM 100 H.1", (_gauge,), _GAUGE, _H1_U, (("u", (32.0,), 0.016), ("drawn", (34.0,), 0.02), ("parts", _PARTS_H1, 0.02)), _SHAPES
    ),
    Example(
        "JCGM 100 H.2", IMPEDANCE, (4.9990, 19.6610e-3, 1.04446), (0.0032, 0.0095e-3, 0.00075),
        (("u", (0.071, 0.295, 0.236), 0.015), ("r", (-0.588, -0.485, 0.993), 0.035)), correlation=_R_H2,
    ),
    Example(
        "JCGM 100 H.3", LINE, CORRECTIONS_C, np.full(11, _SCATTER), (("u", (0.0029, 0.00067, 0.0041), 0.02), ("r", (-0.930,), 1e-3))
    ),
    Example(
        "JCGM 100 H.4", (lambda x: x[..., 0] * x[..., 1] / x[..., 2] * x[..., 3] / x[..., 4],), (0.1368, 5.0192, 5.0571, 652.46, 206.09),
        (0.0018, 0.005, 0.001, 6.42, 3.79), (("u", (0.0083,), 0.012),), correlation=_R_H4,
    ),
    Example("JCGM 100 H.5", (lambda x: x.mean(axis=-1),), np.zeros(10), np.full(10, 57.0), (("u", (18.0,), 0.006),)),
    Example(
        "JCGM 100 H.6", (lambda x: 100.0 - x.sum(axis=-1),), (36.0, 0.0, 0.0, 0.0), _PARTS_H6,
        (("u", (0.55,), 0.011), ("drawn", (0.55,), 0.011), ("parts", _PARTS_H6, 1e-6)), (False, True, False, False),
    ),
    Example("JCGM 101 9.2.2", (_sum,), np.zeros(4), np.ones(4), (("u", (2.0,), 1e-9), ("drawn", (2.0,), 0.01), ("u95", (3.92,), 0.01))),
    Example(
        "JCGM 101 9.2.3", (_sum,), np.zeros(4), np.ones(4), (("u", (2.0,), 1e-9), ("drawn", (2.0,), 0.01), ("u95", (3.88,), 0.01)),
        (True,) * 4,
    ),
    Example(
        "JCGM 101 9.2.4", (_sum,), np.zeros(4), (1, 1, 1, 10), (("u", (10.1,), 0.01), ("drawn", (10.1,), 0.01), ("u95", (17.0,), 0.01)),
        (True,) * 4,
    ),
    Example(
        "JCGM 101 9.3", (_mass,), (1e5, 1.234, 1.2, 8000, 8000), _OF_MASS,
        (("u", (0.0539,), 0.011), ("drawn", (0.0754,), 0.008), ("u95", (0.1495,), 0.014)), (False, False, True, True, True),
    ),
    Example(
        "JCGM 101 9.4.2", (_squares,), (0.0, 0.0), (0.005, 0.005),
        (("bias", (50e-6,), 0.02), ("drawn", (50e-6,), 0.02), ("u95", (150e-6,), 0.02)),
    ),
    Example("JCGM 101 9.4.3", (_squares,), (0.05, 0.0), (0.005, 0.005), (("u", (500e-6,), 0.01), ("drawn", (502e-6,), 0.01))),
    Example("JCGM 101 9.5", (_gauge,), _GAUGE, (*_OF_T, 2e-6 / 3**0.5, 0.2, 0.5 / 2**0.5, *_LIMITS), (("drawn", (36.0,), 0.014),), _SHAPES),
    Example("JCGM 102 9.2.2", SUMS, np.zeros(3), np.ones(3), (("u", (2**0.5, 2**0.5), 1e-6), ("r", (0.5,), 1e-6))),
    Example("JCGM 102 9.2.3", SUMS, np.zeros(3), (1.0, 1.0, 10.0), (("u", (101**0.5, 101**0.5), 1e-6), ("r", (100 / 101,), 1e-6))),
    Example("JCGM 102 9.3.2", POLAR, (0.001, 0.0), (0.01, 0.01), (("bias", (0.0116,), 0.02), ("drawn", (0.0066,), 0.02))),
    Example("JCGM 102 9.3.4", POLAR, (0.1, 0.0), (0.01, 0.01), (("u", (0.010, 0.1), 0.02), ("drawn", (0.010,), 0.02), ("r", (0.0,), 1e-3))),
)  # fmt: skip
"""Examples with the results printed in the documents."""
