"""A machine whose clocks, disk and bus are simulated from one seed: what the recorder and a capture run on in a simulated world.

Sleeping moves the clock to the next frame. The thread that reads the bus is called whenever time moves, so that a seed gives the same
bytes each time. Each write, rename and fsync in the folder of a world is counted, and the seed says which of them fails, and how.
"""

import contextlib
import errno
import io
import os
import types
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta, tzinfo
from pathlib import Path
from typing import Any
from unittest.mock import patch

import can

BEGIN_S = 1_700_000_000.0
RECORDER = ("lmeasure.acquisition.bus.sources", "lmeasure.acquisition.recorder")
Frame = can.Message | Exception | None
NUMBERS = {"error": errno.EIO, "interrupted": errno.EINTR}


class Killed(BaseException):
    """The process is gone."""


class Idle(BaseException):
    """Nothing is due: the thread that reads waits."""


def content(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder."""
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@dataclass(kw_only=True)
class Machine:
    """The clocks, the disk and the bus of a world."""

    seed: int
    due: list[tuple[float, Frame]] = field(default_factory=list)
    """Frames by the time at which they come."""
    disk: dict[int, str] = field(default_factory=dict)
    """What happens at an operation of the disk, by its number; 0: at all from the number that is negative."""
    back_s: float = 0.0
    """When a bus that failed can be opened again."""
    short: int = 10**9
    """So many bytes at most are written at once."""
    slow: int = 0
    """Every operation of the disk of this number takes seconds; 0: none does."""
    end_s: float = float("inf")
    """When nothing more happens."""
    step_s: float = 60.0
    """Longest time that one sleep may take."""
    now: float = 0.0
    position: int = 0
    operations: int = 0
    left: dict[str, bytes] | None = None
    """What the folder held when the process was killed."""
    pump: Callable[[], None] = lambda: None
    opened: list[io.FileIO] = field(default_factory=list)

    def monotonic(self) -> float:
        """Return the steady clock."""
        return self.now

    def time(self) -> float:
        """Return the clock of the wall."""
        return BEGIN_S + self.now

    def next_s(self) -> float:
        """Return when the next frame comes."""
        return self.due[self.position][0] if self.position < len(self.due) else float("inf")

    def sleep(self, seconds: float) -> None:
        """Let time pass, until a frame is due where none is before."""
        self.now = max(self.now + max(seconds, 1e-4), min(self.next_s(), self.end_s, self.now + self.step_s))
        self.pump()

    def recv(self) -> can.Message | None:
        """Return the next frame that is due; None once, then Idle, where none is. What fails, raises."""
        if self.next_s() <= self.now:
            what = self.due[self.position][1]
            self.position += 1
            if isinstance(what, Exception):
                raise what
            return what
        raise Idle

    @property
    def is_off(self) -> bool:
        """Return whether the bus has failed and cannot be opened yet."""
        return 0.0 < self.now < self.back_s and self.position > 0 and isinstance(self.due[self.position - 1][1], Exception)

    def operation(self, folder: Path, write: Callable[[int], None] | None = None) -> None:
        """Count an operation of the disk, and let it fail where the seed says so; write(k): writes a part of it."""
        self.operations += 1
        if self.slow and self.operations % self.slow == 0:
            end = self.now + 3.0
            while self.now < end:
                self.now = min(max(min(self.next_s(), end), self.now + 1e-4), end)
                self.pump()
        answer = self.disk.get(self.operations) or self.disk.get(0)
        if answer is None or (answer == "full" and self.operations < -min(self.disk)):
            return
        if answer == "killed":
            if write is not None:
                write(self.seed % 7)
            self.left = content(folder)
            raise Killed
        if answer in ("full", "part") and write is not None:
            write(self.seed % 5)
        number = NUMBERS.get(answer, errno.ENOSPC)
        raise OSError(number, os.strerror(number))

    def bus(self) -> can.BusABC:
        """Open the bus of python-can that this machine feeds."""
        return _Bus(self)  # type: ignore[return-value]


class _Bus:
    def __init__(self, machine: Machine) -> None:
        self._machine, self._empty, self._asked = machine, False, 0
        if machine.is_off:
            raise can.CanInitializationError("no bus")

    def recv(self, timeout: float) -> can.Message | None:
        """Return a frame that is due; None once where none is, then Idle."""
        del timeout
        if self._asked:  # it has failed: only another one receives
            self._asked += 1
            assert self._asked < 1000
            raise can.CanOperationError("bus off")
        try:
            one = self._machine.recv()
        except can.CanError:
            self._asked = 1
            raise
        except Idle:
            self._empty = not self._empty
            if self._empty:
                return None
            raise
        self._empty = False
        return one

    def shutdown(self) -> None:
        """Close."""

    def fileno(self) -> int:
        """Have no number."""
        raise OSError


class _Event:
    """An event whose waiting lets time pass."""

    def __init__(self, machine: Machine) -> None:
        self._machine, self._set = machine, False

    def is_set(self) -> bool:
        """Return whether it happened."""
        return self._set

    def set(self) -> None:
        """Let it happen."""
        self._set = True

    def wait(self, seconds: float) -> bool:
        """Let time pass."""
        self._machine.now += seconds
        return self._set


class _Thread:
    """A thread that runs when time moves."""

    def __init__(self, machine: Machine, target: Callable[[], None]) -> None:
        def pump() -> None:
            with contextlib.suppress(Idle):
                target()
                machine.pump = lambda: None

        self._machine, self._pump = machine, pump

    def start(self) -> None:
        """Run from now on."""
        self._machine.pump = self._pump

    def join(self) -> None:
        """End."""
        self._machine.pump = lambda: None


class _File(io.FileIO):
    """A file whose operations the machine counts."""

    def __init__(self, machine: Machine, folder: Path, path: Path, mode: str) -> None:
        machine.operation(folder)
        super().__init__(path, mode)
        self._machine, self._folder = machine, folder
        machine.opened.append(self)

    def write(self, data: Any) -> int:
        """Write, or fail."""
        self._machine.operation(self._folder, lambda k: self._part(bytes(data)[: min(k, len(data) - 1)]))
        return super().write(bytes(data)[: self._machine.short])

    def _part(self, data: bytes) -> None:
        super().write(data)


@contextlib.contextmanager
def simulated(machine: Machine, folder: Path, clocks: tuple[str, ...] = RECORDER) -> Iterator[None]:
    """Let the recorder, and the modules of `clocks`, live on a machine."""
    clock: Any = types.SimpleNamespace(monotonic=machine.monotonic, time=machine.time, sleep=machine.sleep, perf_counter=machine.monotonic)
    threads: Any = types.SimpleNamespace(
        Event=lambda: _Event(machine),
        Thread=lambda target, daemon: _Thread(machine, target),
        current_thread=lambda: None,
        main_thread=lambda: 1,
    )

    class Today(datetime):
        @classmethod
        def now(cls, tz: tzinfo | None = None) -> "Today":
            """Return the clock of the wall."""
            return cls.fromtimestamp(BEGIN_S, tz or UTC) + timedelta(seconds=machine.now)

    with contextlib.ExitStack() as stack:
        for name in clocks:
            stack.enter_context(patch(f"{name}.time", clock))
        for name in RECORDER:
            stack.enter_context(patch(f"{name}.threading", threads))
        stack.enter_context(patch("lmeasure.acquisition.recorder.datetime", Today))
        stack.enter_context(failing_disk(machine, folder))
        yield


@contextlib.contextmanager
def failing_disk(machine: Machine, folder: Path) -> Iterator[None]:
    """Let the machine count what is written in a folder."""
    usual_open, usual_replace, usual_rename = Path.open, os.replace, os.rename

    def opened(path: Path, mode: str = "r", buffering: int = -1, *args: Any, **more: Any) -> Any:
        if not set(mode) & set("wxa") or not path.is_relative_to(folder):
            return usual_open(path, mode, buffering, *args, **more)
        if mode in ("xb", "ab") and buffering == 0:
            return _File(machine, folder, path, mode)
        machine.operation(folder, lambda _: usual_open(path, mode).close())  # what is written anew is empty first
        return usual_open(path, mode, buffering, *args, **more)

    def synced(number: int) -> None:
        del number  # a disk that waits would be most of the time
        machine.operation(folder)

    def replaced(old: Any, new: Any, **more: Any) -> None:
        machine.operation(folder)
        usual_replace(old, new, **more)

    def renamed(old: Any, new: Any, **more: Any) -> None:
        machine.operation(folder)
        usual_rename(old, new, **more)

    with patch.object(Path, "open", opened), patch("os.fsync", synced), patch("os.replace", replaced), patch("os.rename", renamed):
        yield
