"""Who wants to know that kernels are compiled, which takes long once on a machine: the kernels tell it here, a face listens."""

import time
from collections.abc import Callable

begun: Callable[[str], None] | None = None
"""Is told the name of the next kernel that must be compiled, once."""
names: list[str] = []
"""Kernels compiled by this process, in the order in which they were done."""
seconds = 0.0
"""Time that this took; what a kernel calls is compiled within its time."""
_open: list[str] = []
_since = 0.0


def now() -> tuple[str, float] | None:
    """The kernel that is being compiled, here or by another process that this one waits for, and for how long [s]; None when none is."""
    return (_open[0], time.perf_counter() - _since) if _open else None


def start(name: str) -> None:
    """A kernel is not kept: it will be compiled, here or by another process."""
    global _since, begun
    if not _open:
        _since = time.perf_counter()
        if begun is not None:
            tell, begun = begun, None
            tell(name)
    _open.append(name)


def by_another(name: str) -> None:
    """Another process has compiled it."""
    del _open[_open.index(name) :]


def end(name: str) -> None:
    """It is compiled. What was begun after it and never ended has failed."""
    global seconds
    if name in _open:
        del _open[_open.index(name) :]
        names.append(name)
        if not _open:
            seconds += time.perf_counter() - _since
