"""A leg of a parallel robot: its kind, its point on the platform and its values, as parameters and in equations."""

from dataclasses import dataclass, replace
from typing import Any, Self

import numpy as np

from lmeasure.core import FloatArray
from lmeasure.robots.model import Parameter
from lmeasure.robots.parallel.kinds import KINDS, STEP, Equation, Kind

WIDTHS = {"mm": 3.0, "deg": 0.5, "": 0.003}
"""What values of legs may be off by, as standard uncertainties: wider than those of any that is built."""


@dataclass(frozen=True)
class Leg:
    """name, kind: of `KINDS`; point (3,) on the platform [mm]; values (k,) of the kind's keys, mm and rad; low, high (d,) limits of its
    drives; carried: what its kind needs besides."""

    name: str
    kind: str
    point: FloatArray
    values: FloatArray
    low: FloatArray
    high: FloatArray
    carried: Any = None

    @property
    def of(self) -> Kind:
        """What its kind does."""
        return KINDS[self.kind]

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The point's three coordinates, then the kind's values, in the units of the names."""
        names = [f"platform_{axis}_mm" for axis in "xyz"] + list(self.of.keys)
        out = []
        for key, value in zip(names, (*self.point, *self.values), strict=True):
            unit = key.rpartition("_")[2] if key.endswith(("_mm", "_deg")) else ""
            size = float(np.radians(1.0)) if unit == "deg" else 1.0
            out.append(Parameter(f"{self.name}.{key}", unit, float(value) / size, size, WIDTHS[unit]))
        return tuple(out)

    def moved(self, change: FloatArray) -> Self:
        """With (3 + k,) added to its point and values."""
        return replace(self, point=self.point + change[:3], values=self.values + change[3:])

    def equations(self, drives: FloatArray) -> list[Equation]:
        """At drives (N, d)."""
        return self.of.equations(self.values, drives, self.carried)

    def derivatives(self, drives: FloatArray) -> list[tuple[Equation, bool]]:
        """Equations' derivatives by the drives and then by the values, and whether they are by a drive; as many as equations for each."""
        out = []
        for i in range(drives.shape[1]):
            step = STEP * 1j * np.eye(drives.shape[1])[i]
            out += [(_imaginary(e), True) for e in self.of.equations(self.values, drives + step, self.carried)]
        for i in range(len(self.values)):
            step = STEP * 1j * np.eye(len(self.values))[i]
            out += [(_imaginary(e), False) for e in self.of.equations(self.values + step, drives + 0j, self.carried)]
        return out


def _imaginary(equation: Equation) -> Equation:
    return Equation(*(None if part is None else np.imag(part) / STEP for part in equation))
