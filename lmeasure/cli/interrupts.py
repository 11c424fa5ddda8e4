"""Ctrl-C during the loading of libraries: some swallow it, so it is raised again at the next progress of the work."""

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType

from lmeasure.core import CancelledError

_asked = threading.Event()


@contextmanager
def noted() -> Iterator[None]:
    """Note a Ctrl-C while a command works, beside its usual effect."""
    usual = signal.default_int_handler
    if threading.current_thread() is not threading.main_thread() or signal.getsignal(signal.SIGINT) is not usual:
        yield
        return
    _asked.clear()
    signal.signal(signal.SIGINT, _note)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, usual)
        _asked.clear()


def _note(number: int, frame: FrameType | None) -> None:
    _asked.set()
    signal.default_int_handler(number, frame)


def came() -> bool:
    """Return whether Ctrl-C came since the command began."""
    return _asked.is_set()


def heeded(progress: Callable[[float, str], None]) -> Callable[[float, str], None]:
    """The progress that ends the work, with CancelledError, once Ctrl-C came."""

    def reported(fraction: float, text: str) -> None:
        if _asked.is_set():
            raise CancelledError
        progress(fraction, text)

    return reported
