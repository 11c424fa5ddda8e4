"""A process of its own for files from others, with a limit of memory and of time for an answer.

A file of a few megabytes may expand to more than the memory of any machine. In the server's process that would end everything else: live
recordings, other people's pages, the whole machine.
"""

import asyncio
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from starlette.concurrency import run_in_threadpool

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.text import message, reason

MEMORY = 2**32
"""Bytes that the process may take beyond those at its start; no more than half of the machine's."""
PATIENCE_S = 120.0
WAITING = 4
"""Requests of a project that wait for it at once; others wait without a thread."""


class Worker:
    """A process that answers calls one after the other: begun with the first one, and anew after it was ended."""

    def __init__(self, memory: int = MEMORY, patience_s: float = PATIENCE_S) -> None:
        self.memory, self.patience_s = memory, patience_s
        self._turn = threading.Lock()
        self._process: multiprocessing.process.BaseProcess | None = None
        self._talk: Connection | None = None

    def call(self, function: Callable[..., Any], path: Path, *more: Any) -> Any:
        """Return the result of a module's function for a file. Errors are raised; FileFormatError if it takes too much memory or time."""
        with self._turn:
            try:
                if self._process is None:
                    self._begin()
                assert self._talk is not None
                self._talk.send((function, path, more))
                if not self._talk.poll(self.patience_s):
                    self._end()
                    raise FileFormatError(message("error.takes_more_than_s", where=path, patience_s=self.patience_s))
                good, answer = self._talk.recv()
            except (OSError, EOFError) as error:
                self._end()
                raise FileFormatError(_too_much(path, self.memory)) from error
        if not good:
            raise answer
        return answer

    def _begin(self) -> None:
        context = multiprocessing.get_context("spawn")
        self._talk, other = context.Pipe()
        self._process = context.Process(target=_answer, args=(other, self.memory), daemon=True)
        self._process.start()
        other.close()

    def _end(self) -> None:
        if self._process is not None and self._talk is not None:
            self._talk.close()
            self._process.kill()
            self._process.join()
        self._process = self._talk = None


def _too_much(path: Path, memory: int) -> str:
    return message("workbench.too_much_memory", path=path, megabytes=memory / 2**20)


def _answer(talk: Connection, memory: int) -> None:
    """Answer calls until their source ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    import lmeasure.workbench.trajectories  # noqa: F401  before the bound, with all that it loads

    _bound(memory)
    with contextlib.suppress(EOFError, OSError):
        while True:
            function, path, more = talk.recv()
            try:
                answer = True, function(path, *more)
            except MemoryError:
                answer = False, FileFormatError(_too_much(path, memory))
            except LMeasureError as error:
                answer = False, FileFormatError(reason(error))
            except Exception as error:  # other libraries have errors of their own for files that are none
                answer = (
                    False,
                    FileFormatError(
                        message("error.cannot_be_read_3", where=path, name=type(error).__name__, error=" ".join(str(error).split())[:200])
                    ),
                )
            talk.send(answer)


def _bound(memory: int) -> None:
    """Let this process take so many bytes more, where the system bounds that."""
    try:
        import resource

        now = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        half = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") // 2
        resource.setrlimit(resource.RLIMIT_AS, (now + min(memory, half),) * 2)
    except (ImportError, OSError, ValueError):
        return  # there the sizes that files state are the bound


worker = Worker()
"""Worker for all projects of this process."""


class Queue:
    """The requests of one server that wait for the worker: few at a time, so that threads are left for all others."""

    def __init__(self) -> None:
        self._waiting = asyncio.Semaphore(WAITING)

    async def ask(self, function: Callable[..., Any], path: Path, *more: Any) -> Any:
        """`Worker.call`, waited for."""
        async with self._waiting:
            return await run_in_threadpool(worker.call, function, path, *more)
