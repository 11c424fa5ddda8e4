"""Compiled numerics: floats and arrays in, floats and a status out; no exceptions, no objects.

Conventions of every kernel
---------------------------
* Millimetres and radians. A 3-vector is a tuple of three floats; a pose is a row `x, y, z, qx, qy, qz, qw`
  (base_from_tool, unit quaternion).
* A value that cannot exist is NaN, never an exception: the callers turn it into an error or a status.
* Compiled code is kept between runs, in a folder named by a digest of these sources. Numba's own cache looks only at the file a
  function is in; a change in an inlined helper of another file would be missed. `cache` states which files are trusted.

Numba is loaded when the first kernel is compiled or its kept code is used: a small job runs without it (`StrictKernel`).
"""

import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterator
from functools import cache, cached_property
from pathlib import Path
from types import FunctionType
from typing import Any

from lmeasure.kernels import uncompiled
from lmeasure.kernels.kept_folder import VARIABLE, own_folder

# a * b + c in one rounding and a division by a reciprocal are allowed; both keep the meaning of NaN, which the rest of fastmath does not
_FAST = {"contract", "arcp"}
UNCOMPILED_S = 0.4
"""Processor time: as long a strict kernel may work uncompiled in a process that has no compiled code of it: less than compiling takes."""
NUMBA_S = 0.8
"""As much longer where numba is not loaded yet, and as long where compiled code is kept: loading numba takes about as much."""


symbols: dict[str, int] = {}
"""Addresses that compiled code knows by name."""


class Kernel:
    """A function that numba compiles when it is first called, or called by another kernel.

    Parameters
    ----------
    function
        Its source.
    inlined
        Whether it becomes part of the kernels that call it: a process that compiles would otherwise call the one it compiled apart, one
        that loads the kept code the copy inside it, with other last digits.
    kept
        Whether its compiled code is kept between runs.
    """

    fast, strict = True, False

    def __init__(self, function: Any, *, inlined: bool, kept: bool) -> None:
        self.py_func, self._inlined, self._kept = function, inlined, kept
        self.__name__, self.__doc__, self.__module__ = function.__name__, function.__doc__, function.__module__

    def __call__(self, *arguments: Any) -> Any:
        return self.dispatcher(*arguments)

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__") or name == "dispatcher":
            raise AttributeError(name)
        return getattr(self.dispatcher, name)

    @property
    def _numba_type_(self) -> Any:
        return self.dispatcher._numba_type_

    def source(self) -> Any:
        """The function that is compiled."""
        return self.py_func

    @cached_property
    def dispatcher(self) -> Any:
        """Return numba's dispatcher of the function."""
        import llvmlite.binding
        import numba

        for name, address in symbols.items():
            llvmlite.binding.add_symbol(name, address)
        numba.config.reload_config()  # type: ignore[no-untyped-call]
        made: Any = numba.njit(
            error_model="numpy", nogil=self._kept, fastmath=_FAST if self.fast else False, forceinline=self._inlined
        )(self.source())  # fmt: skip
        if self._kept and _KEEPS and hasattr(made, "py_func"):  # with NUMBA_DISABLE_JIT nothing is compiled
            from lmeasure.kernels.cache import KeptCode

            with contextlib.suppress(OSError, RuntimeError):  # numba finds no place for it
                made._cache = KeptCode(self.py_func)
        return made


class StrictKernel(Kernel):
    """A kernel that gives the same bits on every processor, compiled or not: nothing in it is fused or replaced.

    Its callees are compiled apart for it, since a small function keeps the licence of `inline` wherever it is used. A call is computed
    uncompiled (`kernels.uncompiled`) as long as that is faster than to compile: each kernel has UNCOMPILED_S a process and types of
    arguments, and NUMBA_S until numba is loaded. A call that takes longer is stopped and repeated, compiled.

    usual: a function of arrays that gives the same for usual arguments, and None, with its arguments as they were, for others. It is called
    first where nothing is compiled.
    """

    fast, strict = False, True
    at_once = False
    """Whether every call is compiled, however small the job."""

    def __init__(self, function: Any, *, inlined: bool = False, kept: bool = True, uncompiled_s: float = UNCOMPILED_S) -> None:
        super().__init__(function, inlined=inlined, kept=kept)
        self.usual: Callable[..., Any] | None = None
        self._uncompiled_s = uncompiled_s
        self._left: dict[tuple[type, ...], float] = {}
        self._guessed: set[tuple[type, ...]] = set()

    def source(self) -> Any:
        """The function that is compiled: a copy that calls strict copies."""
        plain = self.py_func
        known = plain.__globals__
        called = {name: known[name] for name in plain.__code__.co_names if isinstance(known.get(name), Kernel)}
        strict = {name: _strict_part(callee.py_func) for name, callee in called.items()}
        copy = FunctionType(plain.__code__, known | strict, plain.__name__, plain.__defaults__, plain.__closure__)
        copy.__module__, copy.__qualname__, copy.__doc__ = plain.__module__, plain.__qualname__, plain.__doc__
        return copy

    def __call__(self, *arguments: Any) -> Any:
        kinds = tuple(map(type, arguments))
        if not self.at_once and self._left.get(kinds, math.nan) != 0.0:
            if kinds not in self._left:
                guessed = "numba" not in sys.modules and self._keeps_some()
                self._left[kinds] = NUMBA_S if guessed else self._allowed(arguments)
                if guessed:
                    self._guessed.add(kinds)
            result = self._uncompiled(kinds, arguments)
            if result is None and kinds in self._guessed:
                self._guessed.remove(kinds)
                self._left[kinds] = self._allowed(arguments)
                result = self._uncompiled(kinds, arguments)
            if result is not None:
                return result
        return self.dispatcher(*arguments)

    def _uncompiled(self, kinds: tuple[type, ...], arguments: tuple[Any, ...]) -> Any:
        """The result, None where it takes too long."""
        left = self._left[kinds]
        if left == 0.0:
            return None
        began, result = time.thread_time(), None
        if self.usual is not None:
            result = self.usual(*arguments)
        if result is None:
            with contextlib.suppress(Exception):
                result = uncompiled.call(self, arguments, began + left)
        self._left[kinds] = 0.0 if result is None else max(left - (time.thread_time() - began), 0.0)
        if result is not None:
            uncompiled.used.add(self.__name__)
            if kinds not in self._guessed:
                uncompiled.want(self, arguments)
        return result

    def _allowed(self, arguments: tuple[Any, ...]) -> float:
        """Processor time for calls with arguments of these types: none where their compiled code is kept."""
        if not self._keeps_some():
            return self._uncompiled_s + (NUMBA_S if "numba" not in sys.modules else 0.0)
        from numba import typeof

        signature, kept = tuple(map(typeof, arguments)), self.dispatcher._cache
        with contextlib.suppress(Exception):
            if any(key[0] == signature for key in kept._cache_file._load_index()):
                return 0.0
        return self._uncompiled_s

    def _keeps_some(self) -> bool:
        return _KEEPS and uncompiled.is_kept(self.py_func)

    def compile_for(self, examples: tuple[Any, ...]) -> None:
        """Compile for arguments of the types of these, and keep the code."""
        from numba import typeof

        self.dispatcher.compile(tuple(map(typeof, examples)))


@contextlib.contextmanager
def compiled_at_once() -> Iterator[None]:
    """Compile every kernel that is called, as jobs too large to be computed uncompiled do."""
    StrictKernel.at_once = True
    try:
        yield
    finally:
        StrictKernel.at_once = False


@cache
def _strict_part(function: Any) -> StrictKernel:
    return StrictKernel(function, inlined=True, kept=False)


def kernel(function: Any) -> Any:
    """Decorator of a compiled function that Python calls. Called by another kernel it is inlined."""
    return Kernel(function, inlined=True, kept=True)


def inline(function: Any) -> Any:
    """Decorator of a small function that only other kernels call."""
    return Kernel(function, inlined=True, kept=False)


def strict_kernel(function: Any) -> Any:
    """Decorator of a function that Python calls and that gives the same bits on every processor, compiled or not."""
    return StrictKernel(function)


def slow_to_compile(function: Any) -> Any:
    """The same for one that takes ten times as long to compile as others."""
    return StrictKernel(function, uncompiled_s=10.0 * UNCOMPILED_S)


_KEEPS = own_folder(Path(os.environ[VARIABLE]))
