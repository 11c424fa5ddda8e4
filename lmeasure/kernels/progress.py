"""Progress of compilation, which takes long once on a machine: kernels report it here, and a face shows it."""

import time
from collections.abc import Callable
from dataclasses import dataclass, field


@dataclass
class Compilation:
    """Kernels that this process compiles and has compiled.

    Attributes
    ----------
    begun
        Called once with the name of the next kernel that must be compiled.
    names
        Kernels compiled by this process, in the order in which they ended.
    seconds
        Time that this took; a kernel's time includes that of the kernels that it calls.
    """

    begun: Callable[[str], None] | None = None
    names: list[str] = field(default_factory=list)
    seconds: float = 0.0
    _open: list[str] = field(default_factory=list)
    _since: float = 0.0

    def now(self) -> tuple[str, float] | None:
        """The kernel being compiled, here or by another process that this one waits for, and for how long [s]; None when none is."""
        return (self._open[0], time.perf_counter() - self._since) if self._open else None

    def start(self, name: str) -> None:
        """Note that a kernel is not kept: it will be compiled, here or by another process."""
        if not self._open:
            self._since = time.perf_counter()
            if self.begun is not None:
                report, self.begun = self.begun, None
                report(name)
        self._open.append(name)

    def by_another(self, name: str) -> None:
        """Note that another process has compiled it."""
        del self._open[self._open.index(name) :]

    def end(self, name: str) -> None:
        """Note that it is compiled. A kernel that was begun after it and never ended has failed."""
        if name in self._open:
            del self._open[self._open.index(name) :]
            self.names.append(name)
            if not self._open:
                self.seconds += time.perf_counter() - self._since


compilation = Compilation()
"""Of this process."""
