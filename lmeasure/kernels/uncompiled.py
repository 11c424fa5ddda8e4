"""Kernels without a compiler: their source, read once more for NumPy. Compiling takes seconds, and small jobs are faster without.

In the copy that is made of a kernel, a loop over `LANES` (by `lane`) or over samples (by `sample`) is one operation on arrays, and a
conditional expression chooses element by element. Everything else works on single numbers, as it is written. The copy does the same
operations in the same order, and NumPy rounds each as the processor does: the results are those of a strict kernel, bit by bit.

A copy understands loops, `if` whose test is the same for all lanes, conditional expressions, `and`, `or`, `not`, single comparisons, and a
`break` under an `if` at the end of a loop that adds to a number. A sample is the first index of an array. Anything else
is an exception, and the kernel is compiled.
"""

import ast
import inspect
import math
import os
import sys
import textwrap
import threading
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from lmeasure.kernels.kept_folder import VARIABLE

LANES_AT_ONCE = 1024
"""As many as make the work on arrays longer than the way to it, and fit into a processor's cache."""
NUMBERS_AT_ONCE = 4_000_000
"""More in the arguments of a call are worth compiling."""
used: set[str] = set()
"""Kernels that this process used uncompiled."""
wanted: dict[str, tuple[str, str, tuple[Any, ...]]] = {}
"""Kernels without kept compiled code, by name and types: module, name, and examples of the arguments."""


class TooLongError(Exception):
    """A call took longer than it may."""


class _Clock(threading.local):
    until, ticks = math.inf, 0


_clock = _Clock()


def _tick() -> None:
    _clock.ticks += 1
    if _clock.ticks & 31 == 0 and time.thread_time() > _clock.until:
        raise TooLongError


def call(kernel: Any, arguments: tuple[Any, ...], until: float) -> Any:
    """Return the result of a kernel, or leave its arguments unchanged and raise: TooLongError past a time of `time.thread_time`, or another
    exception if the copy does not understand the kernel."""
    arrays = [a for a in arguments if isinstance(a, np.ndarray)]
    if sum(a.size for a in arrays) > NUMBERS_AT_ONCE:
        raise TooLongError
    before = [(a, a.copy()) for a in arrays if a.flags.writeable]
    outer, _clock.until = _clock.until, min(_clock.until, until)
    try:
        with np.errstate(all="ignore"):
            result = _copied(kernel.py_func, _lanes_of(kernel.py_func, arguments))(*map(_number, arguments))
    except Exception:
        for array, content in before:
            array[...] = content
        raise
    finally:
        _clock.until = outer
    return result


@cache
def is_kept(function: Any) -> bool:
    """Whether an earlier process kept compiled code of a function, for arguments of some types."""
    code, (major, minor) = function.__code__, sys.version_info[:2]
    name = f"{Path(code.co_filename).stem}.{function.__qualname__}-{code.co_firstlineno}.py{major}{minor}"
    return any(Path(os.environ[VARIABLE]).glob(f"*/{name}*.nbi"))


def tile(count: int, least: int) -> int:
    """Return the number that the lanes of a call must be a multiple of, for this many places."""
    lanes = least
    while lanes < min(count, LANES_AT_ONCE):
        lanes *= 2
    return lanes


def _lanes_of(function: Any, arguments: tuple[Any, ...]) -> int:
    """How many lanes a call has at once: a kernel whose second argument is an array has a whole number of them in it."""
    if "LANES" not in function.__code__.co_names or not isinstance(arguments[1], np.ndarray):
        return LANES_AT_ONCE
    n = len(arguments[1])
    return min(n & -n, LANES_AT_ONCE)


def _number(value: Any) -> Any:
    """NumPy's own numbers divide by zero."""
    return np.float64(value) if type(value) is float else value


def want(kernel: Any, arguments: tuple[Any, ...]) -> None:
    """Note that a kernel had better be compiled for arguments of these types."""
    if not any(isinstance(a, np.ndarray) and not a.flags.c_contiguous for a in arguments):
        examples = tuple(map(_example, arguments))
        kinds = [(e.dtype.str, e.ndim, e.flags.writeable) if isinstance(e, np.ndarray) else type(e).__name__ for e in examples]
        wanted.setdefault(f"{kernel.__name__} {kinds}", (kernel.__module__, kernel.__name__, examples))


def _example(value: Any) -> Any:
    """A small argument of the same type."""
    if isinstance(value, np.ndarray):
        made = np.empty((0,) * value.ndim, value.dtype)
        made.flags.writeable = value.flags.writeable
        return made
    if isinstance(value, tuple):
        parts = map(_example, value)
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    return value


def _choose(test: Any, then: Callable[[], Any], other: Callable[[], Any]) -> Any:
    if not isinstance(test, np.ndarray):
        return then() if test else other()
    return _by_element(test, then(), other())


def _by_element(test: Any, then: Any, other: Any) -> Any:
    if isinstance(then, tuple):
        return tuple(_by_element(test, a, b) for a, b in zip(then, other, strict=True))
    return np.where(test, then, other)


def _both(a: Any, b: Callable[[], Any]) -> Any:
    return a & b() if isinstance(a, np.ndarray) else (a and b())


def _either(a: Any, b: Callable[[], Any]) -> Any:
    return a | b() if isinstance(a, np.ndarray) else (a or b())


def _not(a: Any) -> Any:
    return ~a if isinstance(a, np.ndarray) else not a


def _larger(a: Any, b: Any) -> Any:
    return _choose(b > a, lambda: b, lambda: a)


def _smaller(a: Any, b: Any) -> Any:
    return _choose(b < a, lambda: b, lambda: a)


def _as_compiled(function: Callable[[float], float]) -> Callable[[Any], Any]:
    """A function of the C library, as compiled code calls it: NaN where it has no value."""

    def one(value: float) -> float:
        try:
            return function(value)
        except ValueError:
            return math.nan

    def called(value: Any) -> Any:
        return np.array([one(v) for v in value.tolist()]) if isinstance(value, np.ndarray) else np.float64(one(float(value)))

    return called


_MATH = SimpleNamespace(
    inf=np.float64(math.inf), nan=np.float64(math.nan), pi=np.float64(math.pi), floor=np.floor, sqrt=np.sqrt, isfinite=np.isfinite,
    isnan=np.isnan, **{name: _as_compiled(getattr(math, name)) for name in ("acos", "asin", "atan", "cos", "exp", "log", "sin", "tan")},
)  # fmt: skip
_NAMES = {
    "_choose": _choose, "_both": _both, "_either": _either, "_not": _not, "_all": np.all, "_tick": _tick, "max": _larger, "min": _smaller,
    "math": _MATH,
}  # fmt: skip


@cache
def _copied(plain: Any, lanes: int) -> Any:
    known = plain.__globals__
    called = {name: _copied(known[name].py_func, lanes) for name in plain.__code__.co_names if hasattr(known.get(name), "py_func")}
    names = known | _NAMES | {"LANES": lanes} | called
    exec(_code_of(plain), names)
    return names[plain.__name__]


@cache
def _code_of(plain: Any) -> Any:
    module = ast.parse(textwrap.dedent(inspect.getsource(plain)))
    return compile(ast.fix_missing_locations(_ForArrays().visit(module)), f"<{plain.__module__}, uncompiled>", "exec")


def _call(name: str, *arguments: ast.expr) -> ast.expr:
    return ast.Call(ast.Name(name, ast.Load()), list(arguments), [])


def _later(value: ast.expr) -> ast.expr:
    return ast.Lambda(ast.arguments(posonlyargs=[], args=[], kwonlyargs=[], kw_defaults=[], defaults=[]), value)


def _names(node: ast.AST, name: str) -> bool:
    return any(isinstance(part, ast.Name) and part.id == name for part in ast.walk(node))


class _ForArrays(ast.NodeTransformer):
    def __init__(self) -> None:
        self.breaks = 0

    def visit_FunctionDef(self, node: ast.FunctionDef) -> Any:
        self.generic_visit(node)
        node.decorator_list, node.returns = [], None
        for argument in node.args.args:
            argument.annotation = None
        return node

    def visit_For(self, node: ast.For) -> Any:
        target, ends = node.target.id if isinstance(node.target, ast.Name) else "", self._break_of(node)
        before: list[ast.stmt] = []
        if ends is not None:
            self.breaks += 1
            node, before = self._without_break(node, ends, f"_done_{self.breaks}"), [ast.parse(f"_done_{self.breaks} = False").body[0]]
        self.generic_visit(node)
        if target == "sample" or (target == "lane" and ast.unparse(node.iter) == "range(LANES)"):
            return [ast.Assign([node.target], ast.Constant(0)), *node.body]
        node.body.insert(0, ast.Expr(_call("_tick")))
        return [*before, node]

    def visit_While(self, node: ast.While) -> Any:
        self.generic_visit(node)
        node.body.insert(0, ast.Expr(_call("_tick")))
        return node

    @staticmethod
    def _break_of(node: ast.For) -> ast.If | None:
        last = node.body[-1]
        ends = isinstance(last, ast.If) and len(last.body) == 1 and isinstance(last.body[0], ast.Break) and not last.orelse
        return last if ends and not node.orelse else None  # type: ignore[return-value]

    @staticmethod
    def _without_break(node: ast.For, ends: ast.If, done: str) -> ast.For:
        """A lane that has come to its end is no longer added to; the loop ends with the last."""
        ended = ast.Name(done, ast.Load())

        def guarded(statement: ast.stmt) -> ast.stmt:
            if not isinstance(statement, ast.AugAssign) or not isinstance(statement.target, ast.Name):
                return statement
            name = ast.Name(statement.target.id, ast.Load())
            return ast.Assign(
                [statement.target], _call("_choose", ended, _later(name), _later(ast.BinOp(name, statement.op, statement.value)))
            )

        body = [
            *(guarded(s) for s in node.body[:-1]),
            ast.Assign([ast.Name(done, ast.Store())], _call("_either", ended, _later(ends.test))),
        ]
        return ast.For(node.target, node.iter, [*body, ast.If(_call("_all", ended), [ast.Break()], [])], [])

    def visit_IfExp(self, node: ast.IfExp) -> Any:
        self.generic_visit(node)
        return _call("_choose", node.test, _later(node.body), _later(node.orelse))

    def visit_BoolOp(self, node: ast.BoolOp) -> Any:
        self.generic_visit(node)
        first, *others = node.values
        for other in others:
            first = _call("_both" if isinstance(node.op, ast.And) else "_either", first, _later(other))
        return first

    def visit_UnaryOp(self, node: ast.UnaryOp) -> Any:
        self.generic_visit(node)
        return _call("_not", node.operand) if isinstance(node.op, ast.Not) else node

    def visit_Subscript(self, node: ast.Subscript) -> Any:
        self.generic_visit(node)
        indices = list(node.slice.elts) if isinstance(node.slice, ast.Tuple) else [node.slice]
        sampled = isinstance(indices[0], ast.Name) and indices[0].id == "sample"
        indices = [ast.Slice() if sampled and i == 0 else _lanes(index) for i, index in enumerate(indices)]
        node.slice = ast.Tuple(indices, ast.Load()) if len(indices) > 1 else indices[0]
        if sampled and isinstance(node.ctx, ast.Load):
            return ast.Attribute(node, "T", ast.Load())  # of a row of each sample the columns
        return node


def _lanes(index: ast.expr) -> ast.expr:
    """The lanes from an index that is that of a lane."""
    return ast.Slice(index, ast.BinOp(index, ast.Add(), ast.Name("LANES", ast.Load()))) if _names(index, "lane") else index
