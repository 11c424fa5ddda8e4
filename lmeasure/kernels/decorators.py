"""Compiled numerics: floats and arrays in, floats and a status out; no exceptions, no objects.

Conventions of every kernel
---------------------------
* Millimetres and radians. A 3-vector is a tuple of three floats; a pose is a row `x, y, z, qx, qy, qz, qw`
  (base_from_tool, unit quaternion).
* What cannot exist is NaN, never an exception: the callers turn it into an error or a status.
* Compiled code is kept between runs, in a folder named by a digest of these sources. Numba's own cache looks only at the file a
  function stands in; a change in an inlined helper of another file would be missed. `kept` says what is believed.
"""

import contextlib
import hashlib
import os
import sys
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba import njit

from lmeasure.kernels.cache import KeptCode, own_folder

# a * b + c in one rounding and a division by a reciprocal are allowed; both keep the meaning of NaN, which the rest of fastmath does not
_FAST = {"contract", "arcp"}


def kernel(function: Any) -> Any:
    """Decorator of a compiled function that Python calls. Called by another kernel it is inlined: a process that compiles would otherwise
    call the one it compiled apart, one that loads the kept code the copy inside it, with other last digits."""
    return _keeping(njit(error_model="numpy", nogil=True, fastmath=_FAST, forceinline=True)(function))


inline: Any = njit(error_model="numpy", forceinline=True, fastmath=_FAST)
"""Decorator of a small function that only other kernels call."""


def strict_kernel(function: Any) -> Any:
    """Decorator of a compiled function that gives the same bits on every processor: nothing in it is fused or replaced.

    What it calls is compiled apart for it, since a small function keeps the licence of `inline` wherever it is used.
    """
    return _keeping(njit(error_model="numpy", nogil=True, fastmath=False)(_calling_strict(function)))


def _calling_strict(function: Any) -> Any:
    plain = getattr(function, "py_func", function)
    known = plain.__globals__
    called = {name: known[name] for name in plain.__code__.co_names if hasattr(known.get(name), "py_func")}
    strict = {name: njit(error_model="numpy", forceinline=True, fastmath=False)(_calling_strict(callee)) for name, callee in called.items()}
    copy = FunctionType(plain.__code__, known | strict, plain.__name__, plain.__defaults__, plain.__closure__)
    copy.__module__, copy.__qualname__, copy.__doc__ = plain.__module__, plain.__qualname__, plain.__doc__
    return copy


def _cache_folder() -> Path:
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for source in [*sorted(here.glob("*.py")), here.parent / "core" / "status.py"]:  # compiled code holds the numbers of statuses
        digest.update(source.read_bytes())
    if sys.platform == "win32":
        root = Path(os.environ.get("LOCALAPPDATA", Path.home() / "AppData" / "Local"))
    elif sys.platform == "darwin":
        root = Path.home() / "Library" / "Caches"
    else:
        root = Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache"))
    return root / "lmeasure" / f"kernels-{digest.hexdigest()[:16]}"


def _keeping(dispatcher: Any) -> Any:
    if _KEEPS and hasattr(dispatcher, "py_func"):  # with NUMBA_DISABLE_JIT nothing is compiled
        with contextlib.suppress(OSError, RuntimeError):  # numba finds no place for it
            dispatcher._cache = KeptCode(dispatcher.py_func)
    return dispatcher


if "NUMBA_CACHE_DIR" not in os.environ:
    os.environ["NUMBA_CACHE_DIR"] = str(_cache_folder())
    numba.config.reload_config()  # type: ignore[no-untyped-call]
_KEEPS = own_folder(Path(os.environ["NUMBA_CACHE_DIR"]))
