"""A process that has loaded the modules of commands and forks one for each request: loading takes a command 1 to 3 s, forking none.

`python -P -m lmeasure.cli.fork_server FD` belongs to the workbench (lmeasure.workbench.processes), which has the other end of the socket
FD. Each message there brings four descriptors: standard input, output and error of a command, and a socket of its own, which returns its
process id, then brings its working directory, environment and words (JSON in one line), and at the end returns its exit code. The process
ends with the socket FD. It never computes, and it never forks while another thread lives, which would not be there in its children.
"""

import contextlib
import gc
import importlib
import io
import json
import os
import pkgutil
import selectors
import signal
import socket
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import NamedTuple, NoReturn

import lmeasure
from lmeasure.cli.app import end_at_once, run
from lmeasure.kernels import ready
from lmeasure.workbench import ONE, READY

LEFT_OUT = ("lmeasure.view", "lmeasure.workbench", "lmeasure.__main__")
"""rerun begins threads; a command serves no pages."""
BESIDE = ("can.interfaces.udp_multicast", "dask.array", "h5netcdf", "rich.progress", "tomlkit")
"""Modules that commands load where they need them, beside lmeasure's own modules; some of it may not be installed."""


class Command(NamedTuple):
    """Task of a process: the words after `lmeasure`, in a folder, with an environment."""

    words: list[str]
    folder: str
    environment: Mapping[str, str]


def load() -> None:
    """Load every module that commands need."""
    for found in pkgutil.walk_packages(lmeasure.__path__, "lmeasure."):
        if not found.name.startswith(LEFT_OUT):
            importlib.import_module(found.name)
    for name in BESIDE:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    ready()


def alone() -> bool:
    """Return whether this process has one thread only."""
    return len(list(Path("/proc/self/task").iterdir())) == 1


def answered(control: socket.socket) -> Command | None:
    """Answer until the socket ends: None then, and in each child its command."""
    ends: dict[int, tuple[int, socket.socket]] = {}
    with selectors.DefaultSelector() as waiting:
        waiting.register(control, selectors.EVENT_READ)
        while True:
            for key, _ in waiting.select():
                if key.fileobj is not control:
                    process, reported = ends.pop(key.fd)
                    waiting.unregister(key.fd)
                    os.close(key.fd)
                    _tell(reported, os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]))
                    reported.close()
                    continue
                message, descriptors, _, _ = socket.recv_fds(control, len(ONE), 4)
                if not message:
                    return None
                reported = socket.socket(fileno=descriptors[3])
                process = os.fork()
                if process == 0:
                    for watched, (_, other) in ends.items():
                        os.close(watched)
                        other.close()
                    control.close()
                    return _became(descriptors[:3], reported)
                for descriptor in descriptors[:3]:
                    os.close(descriptor)
                watched = os.pidfd_open(process)
                ends[watched] = (process, reported)
                waiting.register(watched, selectors.EVENT_READ)
                _tell(reported, process)


def _tell(reported: socket.socket, number: int) -> None:
    with contextlib.suppress(OSError):  # the client has gone
        reported.sendall(b"%d\n" % number)


def _became(standard: list[int], reported: socket.socket) -> Command | None:
    """Return a child's command with its standard input, output and error; None if the requesting process is gone."""
    for place, descriptor in enumerate(standard):
        os.dup2(descriptor, place)
        os.close(descriptor)
    # as with PYTHONUNBUFFERED; those that there are know the files that they were opened on
    sys.stdin = open(0, encoding="utf-8", closefd=False)  # noqa: SIM115
    sys.stdout, sys.stderr = (
        io.TextIOWrapper(open(place, "wb", buffering=0, closefd=False), encoding="utf-8", errors="backslashreplace", write_through=True)  # noqa: SIM115
        for place in (1, 2)
    )
    with reported, reported.makefile("rb") as requested:
        line = requested.readline()
    return Command(**json.loads(line)) if line.endswith(b"\n") else None


def become(command: Command) -> NoReturn:
    """Be that command from here on, as if begun by itself."""
    os.environ.clear()
    os.environ.update(command.environment)
    os.chdir(command.folder)
    sys.argv = ["lmeasure", *command.words]
    sys.modules["__main__"].__package__ = None  # "Usage: lmeasure", not "python -m" of this module
    importlib.import_module("numpy").random.seed()  # children would draw the same
    signal.signal(signal.SIGINT, signal.default_int_handler)
    run()


def main() -> None:
    """Load, report it, and answer until the requesting process is gone; end at once if threads make forking unsafe."""
    end_at_once()
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the working processes
    with socket.socket(fileno=int(sys.argv[1])) as control:
        control.set_inheritable(False)
        load()
        if not alone():
            return
        gc.collect()
        gc.freeze()
        control.sendall(READY)
        command = answered(control)
    if command is not None:
        become(command)


if __name__ == "__main__":
    main()
