"""The 27 nonlinear regressions of NIST's Statistical Reference Datasets, each from both published starts, by this program's least squares.

The data files are NIST's (public domain; https://www.itl.nist.gov/div898/strd/nls/nls_main.shtml), with certified values of 11 digits. The
models are the formulas that the files state. Derivatives are complex steps, exact to rounding. A prior of a hundred times the start is
none in effect.
"""

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.resources import files
from typing import Any

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.estimation import Parameters, Problem, fit_from_starts

Model = Callable[[Any, Any], Any]
PRIOR = 100.0
DIGITS = 4.0
"""Digits of the certified values that a right result has at least (NIST asks for four)."""


def _waves(b: Any, x: Any) -> Any:
    waves = b[0] + b[1] * np.cos(2 * np.pi * x / 12) + b[2] * np.sin(2 * np.pi * x / 12)
    for i in (3, 6):
        waves = waves + b[i + 1] * np.cos(2 * np.pi * x / b[i]) + b[i + 2] * np.sin(2 * np.pi * x / b[i])
    return waves


def _peaks(b: Any, x: Any) -> Any:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-((x - b[3]) ** 2) / b[4] ** 2) + b[5] * np.exp(-((x - b[6]) ** 2) / b[7] ** 2)


def _decays(b: Any, x: Any) -> Any:
    return b[0] * np.exp(-b[1] * x) + b[2] * np.exp(-b[3] * x) + b[4] * np.exp(-b[5] * x)


def _cubics(b: Any, x: Any) -> Any:
    return (b[0] + b[1] * x + b[2] * x**2 + b[3] * x**3) / (1 + b[4] * x + b[5] * x**2 + b[6] * x**3)


def _chwirut(b: Any, x: Any) -> Any:
    return np.exp(-b[0] * x) / (b[1] + b[2] * x)


MODELS: dict[str, Model] = {
    "Bennett5": lambda b, x: b[0] * (b[1] + x) ** (-1 / b[2]),
    "BoxBOD": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Chwirut1": _chwirut,
    "Chwirut2": _chwirut,
    "DanWood": lambda b, x: b[0] * x ** b[1],
    "ENSO": _waves,
    "Eckerle4": lambda b, x: b[0] / b[1] * np.exp(-0.5 * ((x - b[2]) / b[1]) ** 2),
    "Gauss1": _peaks,
    "Gauss2": _peaks,
    "Gauss3": _peaks,
    "Hahn1": _cubics,
    "Kirby2": lambda b, x: (b[0] + b[1] * x + b[2] * x**2) / (1 + b[3] * x + b[4] * x**2),
    "Lanczos1": _decays,
    "Lanczos2": _decays,
    "Lanczos3": _decays,
    "MGH09": lambda b, x: b[0] * (x**2 + x * b[1]) / (x**2 + x * b[2] + b[3]),
    "MGH10": lambda b, x: b[0] * np.exp(b[1] / (x + b[2])),
    "MGH17": lambda b, x: b[0] + b[1] * np.exp(-x * b[3]) + b[2] * np.exp(-x * b[4]),
    "Misra1a": lambda b, x: b[0] * (1 - np.exp(-b[1] * x)),
    "Misra1b": lambda b, x: b[0] * (1 - (1 + b[1] * x / 2) ** -2),
    "Misra1c": lambda b, x: b[0] * (1 - (1 + 2 * b[1] * x) ** -0.5),
    "Misra1d": lambda b, x: b[0] * b[1] * x / (1 + b[1] * x),
    "Nelson": lambda b, x: b[0] - b[1] * x[:, 0] * np.exp(-b[2] * x[:, 1]),
    "Rat42": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)),
    "Rat43": lambda b, x: b[0] / (1 + np.exp(b[1] - b[2] * x)) ** (1 / b[3]),
    "Roszman1": lambda b, x: b[0] - b[1] * x - np.arctan(b[2] / (x - b[3])) / np.pi,
    "Thurber": _cubics,
}
LOGARITHM = ("Nelson",)
"""Sets whose response is the logarithm of the observed one."""


@dataclass(frozen=True)
class DataSet:
    """A set: starts (2, p), certified values and standard deviations (p,), residual sum of squares, data (n,) and (n,) or (n, 2)."""

    name: str
    starts: FloatArray
    certified: FloatArray
    deviations: FloatArray
    squares: float
    y: FloatArray
    x: FloatArray


@dataclass(frozen=True)
class Judged:
    """A fit from one start: digits of the parameters that agree with the certified ones, at most 11, and of their standard deviations."""

    name: str
    start: int
    digits: float
    digits_of_u: float
    converged: bool

    @property
    def right(self) -> bool:
        """Return whether the result is right, or reports that it is not."""
        return self.digits >= DIGITS or not self.converged


def read_set(name: str) -> DataSet:
    """Read a set of the package."""
    lines = (files(__package__) / "strd" / f"{name}.dat").read_text(encoding="ascii").splitlines()
    table = np.array([line.split("=")[1].split() for line in lines if re.match(r"\s*b\d+ =", line)], dtype=np.float64)
    squares = next(float(line.partition(":")[2]) for line in lines if line.startswith("Residual Sum of Squares"))
    begin = max(i for i, line in enumerate(lines) if line.startswith("Data:")) + 1
    data = np.array([line.split() for line in lines[begin:] if line.strip()], dtype=np.float64)
    y = np.log(data[:, 0]) if name in LOGARITHM else data[:, 0]
    return DataSet(name, table[:, :2].T, table[:, 2], table[:, 3], squares, y, data[:, 1] if data.shape[1] == 2 else data[:, 1:])


class _Regression(Problem):
    """A set from one start, with the variance of its certified fit."""

    def __init__(self, data: DataSet, start: int) -> None:
        begin = data.starts[start]
        self.parameters = Parameters(tuple(f"b.{i}" for i in range(len(begin))), begin, PRIOR * np.abs(begin))
        self._data, self._model = data, MODELS[data.name]
        self._variance = data.squares / (len(data.y) - len(begin))

    def residuals(self, theta: FloatArray) -> FloatArray:
        with np.errstate(all="ignore"):
            return np.asarray(self._model(theta, self._data.x) - self._data.y)

    def jacobian(self, theta: FloatArray) -> FloatArray:
        columns = []
        with np.errstate(all="ignore"):
            for i, value in enumerate(theta):
                at, step = theta.astype(np.complex128), 1e-30 * max(1.0, abs(value))
                at[i] += 1j * step
                columns.append(self._model(at, self._data.x).imag / step)
        return np.column_stack(columns)

    def covariance(self, theta: FloatArray) -> FloatArray:
        return np.eye(len(self._data.y)) * self._variance


def judge(name: str, start: int) -> Judged:
    """Fit a set from its first (0) or second (1) start."""
    data = read_set(name)
    problem = _Regression(data, start)
    found = fit_from_starts(problem, problem.parameters.nominal)
    order = _ordered(name, found.theta)
    u = np.sqrt(np.diag(found.covariance))[order]
    return Judged(name, start + 1, _digits(found.theta[order], data.certified), _digits(u, data.deviations), found.converged)


def judge_all() -> Iterator[Judged]:
    """Fit all 27 sets from both starts."""
    return (judge(name, start) for name in MODELS for start in (0, 1))


def _ordered(name: str, theta: FloatArray) -> list[int]:
    """Return the order of the parameters that matches interchangeable terms to the certified result: by their rates."""
    order = list(range(len(theta)))
    if name == "MGH17" and theta[3] > theta[4]:
        order = [0, 2, 1, 4, 3]
    return order


def _digits(found: FloatArray, certified: FloatArray) -> float:
    """Return the digits in which the worst value agrees with the certified ones."""
    apart = np.abs(found / certified - 1.0).max()
    return float(np.clip(-np.log10(apart + 1e-30), -1.0, 11.0)) if np.isfinite(apart) else -1.0
