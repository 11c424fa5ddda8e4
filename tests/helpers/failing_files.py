"""Commands in a real process whose k-th file operation fails, or in which they are killed: the kernel asks this process before each.

A filter (seccomp's user notification, Linux) stops the child at each call that changes files: open for writing, write, fsync, rename,
mkdir, unlink, truncate, chmod. The answer is to go on, an error of the file system, or a kill. It makes no difference which library calls.
"""

import contextlib
import ctypes
import errno
import fcntl
import os
import platform
import select
import shutil
import signal
import socket
import struct
import sys
import tempfile
import time
import zipfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from kills import ABSENT_FOR_A_WHILE, WRITTEN_TWICE, Content, content, ended, lay, made

_X86 = {
    "open": 2, "openat": 257, "creat": 85, "write": 1, "pwrite64": 18, "writev": 20, "pwritev": 296, "fsync": 74, "fdatasync": 75,
    "rename": 82, "renameat": 264, "renameat2": 316, "mkdir": 83, "mkdirat": 258, "unlink": 87, "unlinkat": 263, "rmdir": 84,
    "truncate": 76, "ftruncate": 77, "chmod": 90, "fchmod": 91, "fchmodat": 268, "link": 86, "linkat": 265, "sendfile": 40,
    "copy_file_range": 326, "fallocate": 285,
}  # fmt: skip
_ARM = {
    "openat": 56, "write": 64, "pwrite64": 68, "writev": 66, "pwritev": 70, "fsync": 82, "fdatasync": 83, "renameat": 38, "renameat2": 276,
    "mkdirat": 34, "unlinkat": 35, "truncate": 45, "ftruncate": 46, "fchmod": 52, "fchmodat": 53, "linkat": 37, "sendfile": 71,
    "copy_file_range": 285, "fallocate": 47,
}  # fmt: skip
NUMBERS = {"x86_64": _X86, "aarch64": _ARM}.get(platform.machine(), {})
_NAMES = {number: name for name, number in NUMBERS.items()}
_SECCOMP = {"x86_64": 317, "aarch64": 277}.get(platform.machine(), -1)
BY_NUMBER = {"write", "pwrite64", "writev", "pwritev", "fsync", "fdatasync", "ftruncate", "fchmod", "sendfile", "fallocate"}
"""Calls whose first argument is an open file."""
_RECEIVE, _SEND, _GO_ON, _NO_NEW_PRIVILEGES = 0xC0502100, 0xC0182101, 1, 38
_WRITING = os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC
ANSWERS = {"ENOSPC": errno.ENOSPC, "EIO": errno.EIO, "EINTR": errno.EINTR, "KILL": 0}
LONGEST_S = 120.0


class Call(NamedTuple):
    """A call that changes a file: its name, and the file relative to the folder that is watched."""

    name: str
    path: str


class _Instruction(ctypes.Structure):
    _fields_ = [("code", ctypes.c_ushort), ("true", ctypes.c_ubyte), ("false", ctypes.c_ubyte), ("k", ctypes.c_uint)]


class _Program(ctypes.Structure):
    _fields_ = [("length", ctypes.c_ushort), ("filter", ctypes.POINTER(_Instruction))]


def _listener() -> int:
    """Filter this thread and those that it begins; return the number on which the kernel asks."""
    libc = ctypes.CDLL(None, use_errno=True)
    numbers = sorted(_NAMES)
    lines = [_Instruction(0x20, 0, 0, 0)]  # the call's number
    lines += [_Instruction(0x15, len(numbers) - i, 0, number) for i, number in enumerate(numbers)]
    lines += [_Instruction(0x06, 0, 0, 0x7FFF0000), _Instruction(0x06, 0, 0, 0x7FC00000)]  # allow, ask
    program = _Program(len(lines), (_Instruction * len(lines))(*lines))
    libc.prctl(_NO_NEW_PRIVILEGES, 1, 0, 0, 0)
    return int(libc.syscall(_SECCOMP, 1, 8, ctypes.byref(program)))


def available() -> bool:
    """Return whether this kernel can ask another process."""
    if sys.platform != "linux" or not NUMBERS:
        return False
    child = os.fork()
    if child == 0:
        os._exit(_listener() < 0)
    return os.waitpid(child, 0)[1] == 0


@dataclass
class Run:
    """calls: those that changed something in the folder; code: exit code, negative for a signal; said: lines of standard error;
    failed: the call that failed, if any."""

    calls: list[Call] = field(default_factory=list)
    code: int = 0
    said: list[str] = field(default_factory=list)
    failed: Call | None = None


def run(work: Callable[[], int], folder: Path, at: int = 0, answer: str = "") -> Run:
    """Run a piece of work in a child of this process; its call number `at` (from 1) in the folder gets the answer (see `ANSWERS`)."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with tempfile.TemporaryFile() as said:
        child = os.fork()
        if child == 0:
            _work(work, theirs, said.fileno())
        theirs.close()
        _, (listener, *_), _, _ = socket.recv_fds(ours, 1, 1)
        out = Run()
        try:
            _supervise(child, listener, folder, out, at, answer)
        finally:
            os.close(listener)
            ours.close()
        out.code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        said.seek(0)
        out.said = said.read().decode("utf-8", "replace").splitlines()
    return out


def _work(work: Callable[[], int], there: socket.socket, said: int) -> None:
    """Do the work in the child, and end it."""
    code = 70
    try:
        null = os.open(os.devnull, os.O_RDWR)
        os.dup2(null, 0)
        os.dup2(null, 1)
        os.dup2(said, 2)
        sys.stdout, sys.stderr = open(1, "w", closefd=False), open(2, "w", closefd=False)  # noqa: SIM115 - numbers
        socket.send_fds(there, [b"f"], [_listener()])
        code = work()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def _supervise(child: int, listener: int, folder: Path, out: Run, at: int, answer: str) -> None:
    watched, poll, end = os.pidfd_open(child), select.poll(), time.monotonic() + LONGEST_S
    poll.register(listener, select.POLLIN)
    poll.register(watched, select.POLLIN)
    where = str(folder.resolve())
    try:
        while True:
            ready = dict(poll.poll(1000))
            if time.monotonic() > end:
                os.kill(child, signal.SIGKILL)
                out.said.append("does not end")
                return
            if ready.get(listener, 0) & select.POLLIN:
                if not _answered(child, listener, where, out, at, answer):
                    return
            elif watched in ready:
                return
    finally:
        os.close(watched)


def _answered(child: int, listener: int, where: str, out: Run, at: int, answer: str) -> bool:
    requested = bytearray(80)
    try:
        fcntl.ioctl(listener, _RECEIVE, requested, True)
    except OSError:  # the thread that asked has ended
        return True
    identity, pid, _, number, _, _, *arguments = struct.unpack("=QIIiIQ6Q", requested)
    path = _path(pid, _NAMES[number], arguments)
    error = 0
    if path is not None and (path == where or path.startswith(f"{where}/")):
        call = Call(_NAMES[number], path[len(where) + 1 :])
        out.calls.append(call)
        if len(out.calls) == at:
            out.failed, error = call, ANSWERS[answer]
            if not error:
                os.kill(child, signal.SIGKILL)
                return False
    with contextlib.suppress(OSError):
        fcntl.ioctl(listener, _SEND, bytearray(struct.pack("=QqiI", identity, 0, -error, 0 if error else _GO_ON)), True)
    return True


def _link(pid: int, name: str) -> str:
    return str(Path(f"/proc/{pid}/{name}").readlink())


def _path(pid: int, name: str, arguments: list[int]) -> str | None:
    """Return the file that a call changes; None where it changes none."""
    try:
        if name in BY_NUMBER:
            return _link(pid, f"fd/{arguments[0]}").removesuffix(" (deleted)")
        if name == "copy_file_range":
            return _link(pid, f"fd/{arguments[2]}")
        at = name.endswith("at") or name == "renameat2"
        if name in ("open", "openat") and not arguments[1 + at] & _WRITING:
            return None
        start = ctypes.c_int(arguments[0] & 0xFFFFFFFF).value if at else -100
        base = _link(pid, "cwd" if start == -100 else f"fd/{start}")
        with open(f"/proc/{pid}/mem", "rb", buffering=0) as memory:  # noqa: PTH123
            memory.seek(arguments[at])
            text = memory.read(4096 - arguments[at] % 4096)
            if b"\0" not in text:
                text += memory.read(4096)
    except OSError:
        return None
    return os.path.normpath(os.path.join(base, os.fsdecode(text.split(b"\0")[0])))  # noqa: PTH118


# --- a command whose every operation fails once


def command(line: str, out: Path, *, force: bool = False) -> int:
    """Run a command line to its end, OUT in it being that folder, and return the exit code."""
    from lmeasure.cli.app import main

    sys.argv = ["lmeasure", *line.replace("OUT", str(out)).split(), *(["--force"] if force else [])]
    try:
        main()
    except SystemExit as end:
        return end.code if isinstance(end.code, int) else int(end.code is not None)
    return 0


def whole(name: str, data: bytes) -> bool:
    """Return whether a file of a form that says where it ends is whole."""
    if name.endswith(".json"):
        import json

        with contextlib.suppress(ValueError):
            json.loads(data)
            return True
        return False
    if name.endswith(".toml"):
        import tomllib

        with contextlib.suppress(ValueError):
            tomllib.loads(data.decode())
            return True
        return False
    if name.endswith((".zip", ".xlsx")):
        import io

        with contextlib.suppress(zipfile.BadZipFile):
            return zipfile.ZipFile(io.BytesIO(data)).testzip() is None
        return False
    ends = {".pdf": b"%%EOF", ".parquet": b"PAR1", ".html": b"</html>", ".csv": b"\n", ".log": b"\n", ".txt": b"\n"}
    return data.rstrip(b" \t\r" if name.endswith((".csv", ".log", ".txt")) else None).endswith(ends.get(Path(name).suffix, b""))


@dataclass(frozen=True)
class FaultReport:
    """calls: how many there are; failed: how many of them were answered with an error or a kill, and how many times a run after it came to
    the same files; wrong: what was wrong, a line each."""

    calls: int
    failed: int
    reruns: int
    wrong: list[str]


def chosen(calls: list[Call], every: int = 3) -> Iterator[int]:
    """Yield the numbers of the calls, of the writes to one file only the first, the second and the last ones."""
    writes: dict[str, list[int]] = {}
    for number, call in enumerate(calls, 1):
        if "write" in call.name:
            writes.setdefault(call.path.replace(".part", ""), []).append(number)
    passed_over = {number for numbers in writes.values() for number in numbers[every - 1 : -1]}
    yield from (number for number in range(1, len(calls) + 1) if number not in passed_over)


def failing(
    line: str, out: Path, answers: Sequence[str] = tuple(ANSWERS), *, replacing: bool = False, recording: bool = False
) -> FaultReport:
    """Let each call of a command fail once, with each of the answers, and look at what is left; run it again from each new state.

    replacing: the files are there already, each a byte longer, and the command replaces them. recording: files that grow, so that their
    beginnings are whole too.
    """
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir()
    code = ended(line, out)  # what is loaded here need not be loaded by each child
    if code:
        return FaultReport(0, 0, 0, [f"exit {code}"])
    one = made(content(out))
    before: Content = {}
    if replacing:
        before = {name: data if data is None else data + b"\n" for name, data in content(out).items()}
    lay(before, out, 0)
    second = run(lambda: command(line, out, force=replacing), out)
    final = made(content(out))
    if second.code:
        return FaultReport(0, 0, 0, [f"replacing: exit {second.code}: {second.said}"])
    same = {name for name in final if final[name] == one[name]}
    wrong: list[str] = []
    seen: set[tuple[tuple[str, bytes | None], ...]] = set()
    failed = 0
    for number in chosen(second.calls):
        for answer in answers:
            lay(before, out, 0)
            done = run(lambda: command(line, out, force=replacing), out, number, answer)
            if done.failed is None:  # it took another way
                continue
            failed += 1
            about = f"{answer} at {number} ({done.failed.name} {done.failed.path}): "
            state = content(out)
            wrong += [about + text for text in _judged(done, answer, state, made(before), final, same, recording)]
            key = tuple((name, data if name in same else None) for name, data in sorted(state.items()))
            if key in seen or recording:
                continue
            seen.add(key)
            lay(state, out, _gone())
            again = run(lambda: command(line, out, force=bool(made(content(out)))), out)
            after = content(out)
            if again.code or set(made(after)) != set(final) or any(made(after)[name] != final[name] for name in same):
                wrong.append(f"{about}run again: exit {again.code}, {len(made(after))} of {len(final)} files; {again.said[-1:]}")
            elif len(made(after)) != sum(data is not None for data in after.values()):
                wrong.append(f"{about}run again: an unfinished file is left")
    return FaultReport(len(second.calls), failed, len(seen), wrong)


def _gone() -> int:
    child = os.fork()
    if child == 0:
        os._exit(0)
    os.waitpid(child, 0)
    return child


def _judged(
    done: Run, answer: str, state: Content, before: dict[str, bytes], final: dict[str, bytes], same: set[str], recording: bool
) -> Iterator[str]:
    files = made(state)
    for name, data in files.items():
        if data == before.get(name) or data == final.get(name) or Path(name).name in WRITTEN_TWICE:
            continue
        if recording and data.endswith(b"\n"):
            continue
        if name in same or not whole(name, data):
            yield f"{name} is half-written"
    for name in before:
        if name not in files and name in final and Path(name).name not in ABSENT_FOR_A_WHILE:
            yield f"{name} is gone"
    if answer == "KILL":
        if done.code != -signal.SIGKILL:
            yield f"was killed and ended with {done.code}"
        return
    removing = done.failed is not None and (done.failed.name.startswith(("unlink", "rmdir")))
    if unfinished := [name for name, data in state.items() if data is not None and name not in files and not removing]:
        yield f"{unfinished} is left"
    if done.code == 0:
        if set(files) != set(final) or any(files[name] != final[name] for name in same):
            yield "exit 0, and the files are not all there"
        return
    if done.code != 1:
        yield f"exit {done.code}"
    lines = [text for text in done.said if text.startswith("lmeasure: ")]
    if len(lines) != 1 or done.said[-1:] != lines or "Traceback" in "".join(done.said) or "a fault of this program" in lines[0]:
        yield f"no single line: {done.said[-3:]}"
