"""Tests on the clock of a real bus: beside a busy worker a feed would come late. They go before what else the workers do, one of them at a
time; where a process may not put itself before others, they run alone."""

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

try:
    import fcntl
except ImportError:  # on Windows they run beside each other
    fcntl = None  # type: ignore[assignment]

BEFORE_OTHERS = -15


@contextlib.contextmanager
def turn(folder: Path, live: bool) -> Iterator[None]:
    """A test's turn among those of all processes that name this folder."""
    if fcntl is None:
        yield
    elif not may_go_before():
        with alone_or_beside(folder, live):
            yield
    elif live:
        with alone_or_beside(folder, True), before_others():
            yield
    else:
        yield


def may_go_before() -> bool:
    """Whether this process may."""
    try:
        with before_others():
            return True
    except PermissionError:
        return False


@contextlib.contextmanager
def before_others() -> Iterator[None]:
    """This thread, and what it starts, goes before what others do."""
    usual = os.getpriority(os.PRIO_PROCESS, 0)
    os.setpriority(os.PRIO_PROCESS, 0, BEFORE_OTHERS)
    try:
        yield
    finally:
        os.setpriority(os.PRIO_PROCESS, 0, usual)


@contextlib.contextmanager
def alone_or_beside(folder: Path, alone: bool) -> Iterator[None]:
    """Alone, or beside others that are not alone.

    Who waits to be alone holds the gate: nobody new comes before him.
    """
    folder.mkdir(parents=True, exist_ok=True)
    with (folder / "gate.lock").open("w") as gate, (folder / "turn.lock").open("w") as place:
        fcntl.flock(gate, fcntl.LOCK_EX)
        fcntl.flock(place, fcntl.LOCK_EX if alone else fcntl.LOCK_SH)
        fcntl.flock(gate, fcntl.LOCK_UN)
        yield
