"""Kinds of sensors that other packages add: kernels call their laws through a table of addresses.

A row's KIND selects the entry of the table: entry 2 i of the kind number i gives the reading and its rates, entry 2 i + 1 the
derivatives by the parameters. The table is a symbol of the process that compiled code finds when it is loaded, so that code kept from other
processes is valid here too. An entry that is not set calls `unset`, which loads the kind by its number: worker processes get rows, and
no rig. Failures leave NaN, as everywhere.
"""

import ctypes
import logging
from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np

from lmeasure.core import FloatArray, plug_in, plug_in_names
from lmeasure.kernels.decorators import inline, symbols
from lmeasure.kernels.layout import (
    ANGLE_ZERO,
    BY_ANGLE_ZERO,
    BY_SCALE,
    CABLE_COLUMNS,
    COUNT_LENGTH,
    EXTERNAL_ANGLE,
    EXTERNAL_LENGTH,
    KIND,
    POSE_COLUMNS,
    WIDTH,
)
from lmeasure.kernels.vector import Vec3

GROUP = "lmeasure.sensors"
KINDS = 64
"""How many kinds there can be."""
READING_COLUMNS = 7
_SYMBOL = "lmeasure_external_kinds"
_POINTER = ctypes.POINTER(ctypes.c_double)
_PROTOTYPE = ctypes.CFUNCTYPE(None, _POINTER, _POINTER, _POINTER)
_table = (ctypes.c_void_p * (2 * KINDS))()
_kept: dict[int, Any] = {}
symbols[_SYMBOL] = ctypes.addressof(_table)

Law = Callable[[FloatArray, FloatArray], FloatArray]
"""The row of a channel and a pose (7,) in; the reading with its rates by (omega; v) (7,), or derivatives by `PARAMETERS` (13,), out."""


def set_laws(number: int, reading: Law | int, gradient: Law | int) -> None:
    """Set the laws of an external kind: functions of Python, which must not raise, or addresses of compiled ones."""
    for place, law, size in ((2 * number, reading, READING_COLUMNS), (2 * number + 1, gradient, WIDTH)):
        if not isinstance(law, int):
            _kept[place] = _PROTOTYPE(_called(law, size))
            law = int(ctypes.cast(_kept[place], ctypes.c_void_p).value or 0)
        _table[place] = law


def _called(law: Law, size: int) -> Callable[[Any, Any, Any], None]:
    def call(row: Any, pose: Any, out: Any) -> None:
        into = _viewed(out, size)
        into[:] = np.nan
        into[:] = law(_viewed(row, CABLE_COLUMNS), _viewed(pose, POSE_COLUMNS))

    return call


def _viewed(pointer: Any, size: int) -> FloatArray:
    return np.frombuffer(memoryview((ctypes.c_double * size).from_address(ctypes.addressof(pointer.contents))), np.float64)


_log = logging.getLogger("lmeasure")


def _load(number: int) -> None:
    """Set the laws of the kind that the entry point of a number names; a kind that cannot be loaded has no reading."""
    names = plug_in_names(GROUP)
    if number < len(names):
        try:
            kind: Any = plug_in(GROUP, names[number], object)
            kind.connect(number)
        except Exception as error:
            _log.warning("lmeasure: sensor kind %s cannot be used: %s", names[number], error)


def _unset(place: int) -> Callable[[Any, Any, Any], None]:
    before = None

    def call(row: Any, pose: Any, out: Any) -> None:
        _load(place // 2)
        if _table[place] != before:
            _PROTOTYPE(_table[place] or 0)(row, pose, out)
        else:
            _viewed(out, READING_COLUMNS if place % 2 == 0 else WIDTH)[:] = np.nan

    _kept[place] = _PROTOTYPE(call)
    before = ctypes.cast(_kept[place], ctypes.c_void_p).value
    return call


for _place in range(2 * KINDS):
    _unset(_place)
    _table[_place] = ctypes.cast(_kept[_place], ctypes.c_void_p).value


def _copied(context: Any, builder: Any, kind: Any, value: Any, size: int) -> Any:
    """Copy an array of any layout to the stack: a law sees its numbers one behind the other, and cannot change them."""
    from llvmlite import ir
    from numba.core import cgutils

    array = context.make_array(kind)(context, builder, value)
    (stride,) = cgutils.unpack_tuple(builder, array.strides, 1)  # type: ignore[no-untyped-call]
    begin = builder.bitcast(array.data, ir.IntType(8).as_pointer())
    out: Any = cgutils.alloca_once(builder, ir.ArrayType(ir.DoubleType(), size))  # type: ignore[no-untyped-call]
    for i in range(size):
        at = builder.gep(begin, [builder.mul(stride, ir.Constant(stride.type, i))])
        value = builder.load(builder.bitcast(at, ir.DoubleType().as_pointer()))
        builder.store(value, cgutils.gep_inbounds(builder, out, 0, i))  # type: ignore[no-untyped-call]
    return cgutils.gep_inbounds(builder, out, 0, 0)  # type: ignore[no-untyped-call]


class _Law:
    """A call of the law at a place of the table, in compiled code and outside of it: (place, row, pose) in, numbers out."""

    def __init__(self, size: int) -> None:
        self._size = size

    def __call__(self, place: int, row: FloatArray, pose: FloatArray) -> tuple[Any, ...]:
        if pose.ndim > 1:  # of many samples, by columns
            return tuple(np.array([self(place, row, one) for one in pose.T]).reshape(-1, self._size).T)
        out = np.empty(self._size)
        _PROTOTYPE(_table[place] or 0)(*(np.ascontiguousarray(a, np.float64).ctypes.data_as(_POINTER) for a in (row, pose, out)))
        return tuple(out)

    @cached_property
    def _numba_type_(self) -> Any:
        from numba import types
        from numba.core.typing.templates import infer, make_intrinsic_template

        size, result = self._size, types.UniTuple(types.float64, self._size)  # type: ignore[no-untyped-call]

        def code(context: Any, builder: Any, signature: Any, args: Any) -> Any:
            return context.make_tuple(builder, result, _call(context, builder, signature, args, size))

        def law(typing: Any, place: Any, row: Any, pose: Any) -> Any:
            return result(types.int64, row, pose), code

        template = make_intrinsic_template(self, law, f"law of {size}")  # type: ignore[no-untyped-call]
        infer(template)  # type: ignore[no-untyped-call]
        return types.Function(template)  # type: ignore[no-untyped-call]


def _call(context: Any, builder: Any, signature: Any, args: Any, size: int) -> list[Any]:
    """Call the law at a place of the table with copies of row and pose; return its output."""
    from llvmlite import ir
    from numba.core import cgutils

    double, word = ir.DoubleType(), ir.IntType(64)
    function = ir.FunctionType(ir.VoidType(), [double.as_pointer()] * 3)
    table = builder.module.globals.get(_SYMBOL)
    if table is None:
        table = ir.GlobalVariable(builder.module, ir.ArrayType(function.as_pointer(), 2 * KINDS), _SYMBOL)
        table.linkage = "external"
    row = _copied(context, builder, signature.args[1], args[1], CABLE_COLUMNS)
    pose = _copied(context, builder, signature.args[2], args[2], POSE_COLUMNS)
    out: Any = cgutils.alloca_once(builder, ir.ArrayType(double, size))  # type: ignore[no-untyped-call]
    law = builder.load(builder.gep(table, [word(0), args[0]]))
    builder.call(law, [row, pose, cgutils.gep_inbounds(builder, out, 0, 0)])  # type: ignore[no-untyped-call]
    return [builder.load(cgutils.gep_inbounds(builder, out, 0, i)) for i in range(size)]  # type: ignore[no-untyped-call]


_reading, _gradient = _Law(READING_COLUMNS), _Law(WIDTH)


@inline
def is_external(kind: float) -> bool:
    """Whether a row's KIND is one that another package adds."""
    return kind <= EXTERNAL_LENGTH or kind >= EXTERNAL_ANGLE


@inline
def _place_of(kind: float) -> int:
    return 2 * int(EXTERNAL_LENGTH - kind if kind <= EXTERNAL_LENGTH else kind - EXTERNAL_ANGLE)


@inline
def external_at(channel: FloatArray, pose: FloatArray) -> tuple[float, Vec3, Vec3]:
    """(reading, moment, force) of a channel of an external kind."""
    found = _reading(_place_of(channel[KIND]), channel, pose)
    return found[0] - channel[ANGLE_ZERO], (found[1], found[2], found[3]), (found[4], found[5], found[6])


@inline
def external_gradient(channel: FloatArray, pose: FloatArray, k: float, scale_factor: float, out: FloatArray) -> None:
    """Derivatives of reading minus counted reading by `PARAMETERS`, into out (layout.WIDTH,)."""
    found = _gradient(_place_of(channel[KIND]) + 1, channel, pose)
    for c in range(WIDTH):
        out[c] = found[c]
    out[BY_ANGLE_ZERO] = -1.0
    out[BY_SCALE] = channel[COUNT_LENGTH] * k / scale_factor
