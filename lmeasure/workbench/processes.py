"""Processes of jobs: forked from one that has loaded the modules of commands, or started alone without one.

The first takes 0.1 s to its first output, the second 1 to 3 s. There is one prepared process (lmeasure.cli.fork_server) for all projects of
a server. It starts after a page has been shown or a job has ended, so that the first page need not wait for it. Until it has loaded
everything, on systems with another fork (Windows, macOS) and after its death, jobs are started alone.
"""

import asyncio
import atexit
import contextlib
import json
import os
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import IO

PREPARED = (sys.executable, "-P", "-m", "lmeasure.cli.fork_server")
"""-P: a file of the project called random.py is no library of Python."""
READY, ONE = b"ready", b"one"
"""Messages: everything is loaded; fork one."""
ALONE = {"OPENBLAS_NUM_THREADS": "1", "NUMEXPR_NUM_THREADS": "1", "JE_ARROW_MALLOC_CONF": "background_thread:false"}
"""Settings by which libraries start no threads when loaded: a process with several is not forked."""
ANSWER_S = 5.0
PAUSE_S = 0.5
LIMIT = 2**24
"""Longest line of a job [bytes]."""


class Typed:
    """Standard input of a forked process, as asyncio has that of others."""

    def __init__(self, descriptor: int) -> None:
        os.set_blocking(descriptor, False)
        self._file: IO[bytes] = os.fdopen(descriptor, "wb", buffering=0)

    def write(self, data: bytes) -> None:
        """Write data; OSError if nothing has read it for long; ValueError once it is closed."""
        self._file.write(data)

    async def drain(self) -> None:
        """It is written already."""

    def close(self) -> None:
        """The process reads an end."""
        self._file.close()


Streams = tuple[Typed, asyncio.StreamReader, asyncio.StreamReader]
"""Standard input, output and error."""


class Forked:
    """A forked process, as asyncio has others: its standard streams, its end and how to bring it about."""

    def __init__(self, pid: int, streams: "Streams", reported: asyncio.StreamReader, asking: asyncio.StreamWriter) -> None:
        self.pid, (self.stdin, self.stdout, self.stderr) = pid, streams
        self.returncode: int | None = None
        self._end = asyncio.ensure_future(self._ended(reported, asking))

    async def _ended(self, reported: asyncio.StreamReader, asking: asyncio.StreamWriter) -> int:
        try:
            line = await reported.readline()
        except OSError:
            line = b""
        asking.close()
        if line.endswith(b"\n"):
            self.returncode = int(line)
        else:
            # its parent process was killed: it continues, and its exit code is lost
            await self._gone()
            self.returncode = -signal.SIGKILL
        self.stdin.close()
        return self.returncode

    async def _gone(self) -> None:
        """Until it has ended."""
        try:
            watched = os.pidfd_open(self.pid)
        except ProcessLookupError:
            return
        ended, loop = asyncio.Event(), asyncio.get_running_loop()
        loop.add_reader(watched, ended.set)
        try:
            await ended.wait()
        finally:
            loop.remove_reader(watched)
            os.close(watched)

    async def wait(self) -> int:
        """The exit code, negative the signal that ended it."""
        return await asyncio.shield(self._end)

    def terminate(self) -> None:
        """End it; ProcessLookupError where it has ended."""
        self._send(signal.SIGTERM)

    def kill(self) -> None:
        """End it at once."""
        self._send(signal.SIGKILL)

    def _send(self, number: signal.Signals) -> None:
        if self.returncode is None:
            os.kill(self.pid, number)


Process = asyncio.subprocess.Process | Forked


class _Prepared:
    """The prepared process of this server, begun when it is wanted."""

    def __init__(self) -> None:
        self._turn = threading.Lock()
        self._process: subprocess.Popen[bytes] | None = None
        self._control: socket.socket | None = None
        self._ready = False
        self._soon = False

    def want_soon(self) -> None:
        """Begin it, once, when the page that is being answered is in its browser."""
        if not self._soon:
            self._soon = True
            timer = threading.Timer(PAUSE_S, self.want)
            timer.daemon = True
            timer.start()

    def want(self) -> None:
        """Begin it, once, where processes can be forked from it."""
        with self._turn:
            if self._process is not None or sys.platform != "linux" or not hasattr(os, "pidfd_open"):
                return
            ours, theirs = socket.socketpair()
            quiet = {"stdin": subprocess.DEVNULL, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
            with theirs, contextlib.suppress(OSError):
                words = [*PREPARED, str(theirs.fileno())]
                self._process = subprocess.Popen(words, pass_fds=[theirs.fileno()], env=os.environ | ALONE, cwd="/", **quiet)  # type: ignore[call-overload]
                self._control = ours
                atexit.register(self.end)

    def end(self) -> None:
        """End it; forked processes continue."""
        with self._turn:
            if self._process is not None and self._control is not None:
                self._control.close()
                self._control, self._ready = None, False
                self._process.kill()
                self._process.wait()

    def ready(self) -> bool:
        """Return whether it has loaded everything."""
        with self._turn:
            return self._is_ready()

    def _is_ready(self) -> bool:
        if self._control is not None and not self._ready:
            with contextlib.suppress(OSError):
                self._ready = self._control.recv(len(READY), socket.MSG_DONTWAIT) == READY
        return self._ready

    def handed(self, descriptors: list[int]) -> bool:
        """Hand it the descriptors of a process that it shall fork; False where it is not there."""
        with self._turn, contextlib.suppress(OSError):
            if self._is_ready() and self._control is not None:
                socket.send_fds(self._control, [ONE], descriptors)
                return True
        return False


prepared = _Prepared()


async def begun(words: list[str], folder: Path, environment: Mapping[str, str]) -> Process:
    """Begin `lmeasure WORDS` in a folder with an environment. OSError where the system has no room for it."""
    return await _forked(words, folder, environment) or await asyncio.create_subprocess_exec(
        *(sys.executable, "-P", "-m", "lmeasure", *words),
        cwd=folder,
        env=environment,
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.PIPE,
        limit=LIMIT,
    )


async def _forked(words: list[str], folder: Path, environment: Mapping[str, str]) -> Forked | None:
    """One that is forked; None where none can be."""
    if not prepared.ready():
        return None
    requested = json.dumps({"words": words, "folder": str(folder), "environment": dict(environment)}).encode() + b"\n"
    with contextlib.ExitStack() as here, contextlib.ExitStack() as there:
        read, typed = _pipe(there, here)
        said, stdout = _pipe(here, there)
        shown, stderr = _pipe(here, there)
        talk, other = socket.socketpair()
        here.enter_context(talk)
        there.enter_context(other)
        if not prepared.handed([read, stdout, stderr, other.fileno()]):
            return None
        here.pop_all()
    reported, asking = await asyncio.open_unix_connection(sock=talk)
    streams = Typed(typed), await _reader(said), await _reader(shown)
    try:
        pid = int(await asyncio.wait_for(reported.readline(), ANSWER_S))
        asking.write(requested)
    except (OSError, TimeoutError, ValueError):
        # it has died; its children find no client and end
        asking.close()
        streams[0].close()
        return None
    return Forked(pid, streams, reported, asking)


def _pipe(reads: contextlib.ExitStack, writes: contextlib.ExitStack) -> tuple[int, int]:
    """Return a pipe whose ends are closed by their owners."""
    ends = os.pipe()
    reads.callback(os.close, ends[0])
    writes.callback(os.close, ends[1])
    return ends


async def _reader(descriptor: int) -> asyncio.StreamReader:
    """Read the lines of a pipe, which is closed at its end."""
    reader = asyncio.StreamReader(limit=LIMIT)
    await asyncio.get_running_loop().connect_read_pipe(
        lambda: asyncio.StreamReaderProtocol(reader), os.fdopen(descriptor, "rb", buffering=0)
    )
    return reader
