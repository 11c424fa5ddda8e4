"""Kinds of sensors that other packages add: the table of rig.toml and the law of its reading, called by the kernels as every other kind.

The law is a function of three things: the numbers that its table states (`SensorTable.own`, in their order; mm and rad), the place of its
tool point in the base frame (of the tool origin, where its table has no `to`), and the rotation of the tool. All rates follow by central
differences, whose steps leave 1e-9 of a rate. A law that fails has no reading there (NaN); the first failure of a kind is logged.
"""

import logging
import math
import traceback
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, plug_in_names, plug_in_version, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BY_ATTACHMENT, OWN_COLUMNS, OWN_PARAMETERS, WIDTH, set_laws
from lmeasure.rig import GROUP, AngleSensor as AngleSensor, LengthSensor as LengthSensor, SensorTable, external_number, register_table

STEP_MM = 1e-2
STEP_RAD = 3e-5
TURNS = [Rotation.from_rotvec([on, -on]).as_matrix() for on in STEP_RAD * np.eye(3)]
"""Small turns about each base axis, and back."""
_log = logging.getLogger("lmeasure")

Reading = Callable[[FloatArray, FloatArray, FloatArray], float]
"""A law: own numbers (q,), place of the tool point (3,) [mm], rotation (3, 3) of the tool; the reading [mm or rad] but for its zero."""


@dataclass(frozen=True)
class SensorKind:
    """A kind of sensor of another package.

    Parameters
    ----------
    table
        Model of its table in rig.toml: a subclass of `LengthSensor` or `AngleSensor`.
    reading
        Its law.
    """

    table: type[SensorTable]
    reading: Reading

    def __post_init__(self) -> None:
        if not (isinstance(self.table, type) and issubclass(self.table, LengthSensor | AngleSensor)):
            raise TypeError(f"table must be a subclass of LengthSensor or AngleSensor, not {self.table!r}")
        if not self.table.kind.isidentifier():
            raise TypeError(f"{self.table.__name__}: kind must be the name of its table in rig.toml, not {self.table.kind!r}")
        if unknown := [key for key in self.table.own if key not in self.table.model_fields]:
            raise TypeError(f"{self.table.__name__}: own names {unknown[0]!r}, which is no key of its table")
        if not callable(self.reading):
            raise TypeError(f"reading must be a function, not {self.reading!r}")
        self.table.parameters()

    def register(self) -> "SensorKind":
        """Register the kind in this process; one that an entry point names need not be."""
        register_table(self.table)
        self.connect(external_number(self.table.kind))
        return self

    def connect(self, number: int) -> None:
        """Have the kernels call its law under a number."""
        parameters, failed = self.table.parameters(), False
        steps = [STEP_RAD if p.unit == "deg" else STEP_MM for p in parameters]
        columns = list(OWN_COLUMNS[: len(parameters)])

        def law(own: FloatArray, place: FloatArray, turn: FloatArray) -> float:
            nonlocal failed
            try:
                return float(self.reading(own, place, turn))
            except Exception as error:
                if not failed:
                    failed = True
                    _log.warning(self._failure(error))
                return math.nan

        def at(row: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
            turn = se3.matrices(pose)
            arm = turn @ row[ATTACHMENT_XYZ]
            return row[columns], pose[:3] + arm, turn, arm

        def by_place(own: FloatArray, place: FloatArray, turn: FloatArray) -> FloatArray:
            return _slopes(lambda x: law(own, x, turn), place, [STEP_MM] * 3)

        def reading(row: FloatArray, pose: FloatArray) -> FloatArray:
            own, place, turn, arm = at(row, pose)
            force = by_place(own, place, turn)
            moment = np.array([law(own, place, on @ turn) - law(own, place, back @ turn) for on, back in TURNS]) / (2.0 * STEP_RAD)
            return np.concatenate([[law(own, place, turn)], moment + np.cross(arm, force), force])

        def gradient(row: FloatArray, pose: FloatArray) -> FloatArray:
            own, place, turn, _ = at(row, pose)
            out = np.zeros(WIDTH)
            out[list(OWN_PARAMETERS[: len(own)])] = _slopes(lambda p: law(p, place, turn), own, steps)
            out[BY_ATTACHMENT : BY_ATTACHMENT + 3] = by_place(own, place, turn) @ turn
            return out

        set_laws(number, reading, gradient)

    def _failure(self, error: Exception) -> str:
        kind = self.table.kind
        source = f"package {plug_in_version(GROUP, kind)}" if kind in plug_in_names(GROUP) else "this process"
        frame = traceback.extract_tb(error.__traceback__)[-1]
        where = f"{frame.filename.rpartition('/')[2]}:{frame.lineno}"
        return f"lmeasure: sensor kind {kind} of {source} has no reading at some poses: {type(error).__name__} in {where}: {error}"


def _slopes(f: Callable[[FloatArray], float], x: FloatArray, steps: list[float]) -> FloatArray:
    """(k,) central differences of f at x (k,)."""
    out = np.empty(len(x))
    for i, step in enumerate(steps):
        here = x.copy()
        here[i] = x[i] + step
        above, high = f(here), here[i]
        here[i] = x[i] - step
        out[i] = (above - f(here)) / (high - here[i])
    return out
