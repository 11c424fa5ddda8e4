"""Who wants to know that kernels are compiled, which takes long once on a machine: the kernels tell it here, a face listens."""

import time
from collections.abc import Callable

begun: Callable[[str], None] | None = None
"""Is told the name of the first kernel that must be compiled."""
names: list[str] = []
"""Kernels compiled by this process, in the order in which they were done."""
seconds = 0.0
"""Time that this took; what a kernel calls is compiled within its time."""
_open: list[str] = []
_since = 0.0


def now() -> tuple[str, float] | None:
    """The kernel that is being compiled, and for how long [s]; None when none is."""
    return (_open[0], time.perf_counter() - _since) if _open else None


def start(name: str) -> None:
    """A kernel is not kept and will be compiled."""
    global _since
    if not _open:
        _since = time.perf_counter()
        if not names and begun is not None:
            begun(name)
    _open.append(name)


def end(name: str) -> None:
    """It is compiled. What was begun after it and never ended has failed."""
    global seconds
    if name in _open:
        del _open[_open.index(name) :]
        names.append(name)
        if not _open:
            seconds += time.perf_counter() - _since
