"""Kinds of sensors that other packages add: the table of rig.toml and the law of its reading, called by the kernels as every other kind.

The law is a function of three arguments: the numbers that its table states (`SensorTable.own`, in their order; mm and rad), the place of
its tool point in the base frame (of the tool origin, where its table has no `to`), and the rotation of the tool. All rates follow by
central differences, whose steps leave 1e-9 of a rate. A law that fails has no reading there (NaN); the first failure of a kind is logged.

A law of plain arithmetic is compiled, some forty times as fast, if the compiled one gives the same as Python; any other runs in Python.
"""

import ctypes
import dis
import logging
import math
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy

from lmeasure.core import FloatArray, plug_in_names, plug_in_version, se3
from lmeasure.kernels import ATTACHMENT_XYZ, BY_ATTACHMENT, CABLE_COLUMNS, GROUP, OWN_COLUMNS, OWN_PARAMETERS, WIDTH, set_laws
from lmeasure.rig import AngleSensor as AngleSensor, LengthSensor as LengthSensor, SensorTable, external_number, register_table

STEP_MM = 1e-2
STEP_RAD = 3e-5
TURNS = [se3.matrices(se3.exp([[*on, 0.0, 0.0, 0.0], [*-on, 0.0, 0.0, 0.0]])) for on in STEP_RAD * np.eye(3)]
"""Small turns about each base axis, and back."""
READING_COLUMNS = 7
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
        period = math.inf if self.table.is_length else 2.0 * math.pi
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
            return _slopes(lambda x: law(own, x, turn), place, [STEP_MM] * 3, period)

        def reading(row: FloatArray, pose: FloatArray) -> FloatArray:
            own, place, turn, arm = at(row, pose)
            force = by_place(own, place, turn)
            turned = [_short(law(own, place, on @ turn) - law(own, place, back @ turn), period) for on, back in TURNS]
            moment = np.array(turned) / (2.0 * STEP_RAD)
            return np.concatenate([[law(own, place, turn)], moment + np.cross(arm, force), force])

        def gradient(row: FloatArray, pose: FloatArray) -> FloatArray:
            own, place, turn, _ = at(row, pose)
            out = np.zeros(WIDTH)
            out[list(OWN_PARAMETERS[: len(own)])] = _slopes(lambda p: law(p, place, turn), own, steps, period)
            out[BY_ATTACHMENT : BY_ATTACHMENT + 3] = by_place(own, place, turn) @ turn
            return out

        set_laws(number, reading, gradient)
        rows, poses = self._trials(len(parameters))
        with np.errstate(all="ignore"):
            wanted = [reading(*each) for each in zip(rows, poses, strict=True)]
        # a compiled law cannot report why it fails
        raises = failed or any(one.opname.startswith("RAISE") for one in dis.get_instructions(self.reading))
        failed = False
        if not raises and (compiled := _compiled(self.reading, len(parameters), steps, period)):
            found = [_called(compiled[0].address, each) for each in zip(rows, poses, strict=True)]
            if np.allclose(found, wanted, rtol=1e-6, atol=1e-9, equal_nan=True):
                set_laws(number, compiled[0].address, compiled[1].address)
                _kept.append(compiled)

    @staticmethod
    def _trials(q: int) -> tuple[FloatArray, FloatArray]:
        """Return rows (n, columns) and poses (n, 7) for a comparison of two ways to compute a law."""
        generator, n = np.random.default_rng(0), 5
        rows = np.zeros((n, CABLE_COLUMNS))
        rows[:, list(OWN_COLUMNS[:q])] = generator.uniform(-2.0, 2.0, (n, q)) * 10.0 ** np.arange(n)[:, None]
        rows[:, ATTACHMENT_XYZ] = generator.uniform(-100.0, 100.0, (n, 3))
        return rows, se3.pose(generator.uniform(-300.0, 300.0, (n, 3)), scipy.spatial.transform.Rotation.random(n, rng=generator))

    def _failure(self, error: Exception) -> str:
        kind = self.table.kind
        source = f"package {plug_in_version(GROUP, kind)}" if kind in plug_in_names(GROUP) else "this process"
        own = [frame for frame in traceback.extract_tb(error.__traceback__) if frame.filename != __file__]
        where = f" in {own[-1].filename.rpartition('/')[2]}:{own[-1].lineno}" if own else ""
        return f"lmeasure: sensor kind {kind} of {source}: its law fails at some poses: {type(error).__name__}{where}: {error}"


_kept: list[Any] = []


def _called(address: int, at: tuple[FloatArray, FloatArray]) -> FloatArray:
    """Return the (7,) result of a compiled law at a row and a pose."""
    pointers = [ctypes.POINTER(ctypes.c_double)] * 3
    out = np.empty(READING_COLUMNS)
    arrays = [np.ascontiguousarray(a).ctypes.data_as(pointers[0]) for a in (*at, out)]
    ctypes.CFUNCTYPE(None, *pointers)(address)(*arrays)
    return out


def _compiled(reading: Reading, q: int, steps: list[float], period: float) -> tuple[Any, Any] | None:
    """Return the compiled reading with its rates, and the derivatives by the parameters; None where numba cannot compile the law."""
    import numba

    any_numba: Any = numba  # has no types of its own
    types, carray, cfunc, njit = any_numba.types, any_numba.carray, any_numba.cfunc, any_numba.njit
    columns, places, own_steps = np.array(OWN_COLUMNS[:q], np.int64), np.array(OWN_PARAMETERS[:q], np.int64), np.array(steps)
    turns, width, attachment = np.array(TURNS), WIDTH, int(ATTACHMENT_XYZ.start)
    law: Any = njit(error_model="numpy")(reading)
    short: Any = njit(error_model="numpy")(_short)

    @njit(error_model="numpy")
    def at(row: Any, pose: Any) -> Any:
        own, point = np.empty(q), row[attachment : attachment + 3].copy()
        for i in range(q):
            own[i] = row[columns[i]]
        x, y, z, w = pose[3], pose[4], pose[5], pose[6]
        turn = np.array(
            (
                (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w)),
                (2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w)),
                (2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)),
            )
        )
        arm = turn @ point
        return own, pose[:3] + arm, turn, arm

    @njit(error_model="numpy")
    def by_place(own: Any, place: Any, turn: Any) -> Any:
        out = np.empty(3)
        for i in range(3):
            above, below = place.copy(), place.copy()
            above[i] += STEP_MM
            below[i] -= STEP_MM
            out[i] = short(law(own, above, turn) - law(own, below, turn), period) / (above[i] - below[i])
        return out

    def reading_at(row_: Any, pose_: Any, out_: Any) -> None:
        out = carray(out_, 7)
        out[:] = math.nan  # where the law fails
        own, place, turn, arm = at(carray(row_, CABLE_COLUMNS), carray(pose_, 7))
        force = by_place(own, place, turn)
        out[0] = law(own, place, turn)
        out[1] = arm[1] * force[2] - arm[2] * force[1]
        out[2] = arm[2] * force[0] - arm[0] * force[2]
        out[3] = arm[0] * force[1] - arm[1] * force[0]
        for i in range(3):
            out[1 + i] += short(law(own, place, turns[i, 0] @ turn) - law(own, place, turns[i, 1] @ turn), period) / (2.0 * STEP_RAD)
            out[4 + i] = force[i]

    def gradient_at(row_: Any, pose_: Any, out_: Any) -> None:
        out = carray(out_, width)
        out[:] = math.nan
        own, place, turn, _ = at(carray(row_, CABLE_COLUMNS), carray(pose_, 7))
        out[:] = 0.0
        for i in range(q):
            above, below = own.copy(), own.copy()
            above[i] += own_steps[i]
            below[i] -= own_steps[i]
            out[places[i]] = short(law(above, place, turn) - law(below, place, turn), period) / (above[i] - below[i])
        inward = by_place(own, place, turn) @ turn
        for i in range(3):
            out[BY_ATTACHMENT + i] = inward[i]

    signature = types.void(*[types.CPointer(types.float64)] * 3)
    try:
        return cfunc(signature)(reading_at), cfunc(signature)(gradient_at)
    except Exception:
        return None


def _short(difference: float, period: float) -> float:
    """The same difference of readings by less than half a period; a law may jump by a whole one."""
    return difference if period == math.inf else difference - period * math.floor(difference / period + 0.5)


def _slopes(f: Callable[[FloatArray], float], x: FloatArray, steps: list[float], period: float) -> FloatArray:
    """(k,) central differences of f at x (k,)."""
    out = np.empty(len(x))
    for i, step in enumerate(steps):
        here = x.copy()
        here[i] = x[i] + step
        above, high = f(here), here[i]
        here[i] = x[i] - step
        out[i] = _short(above - f(here), period) / (high - here[i])
    return out
