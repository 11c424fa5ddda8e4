"""Compiled code kept between runs. It is used only where no other user can have written it.

Numba keeps its code pickled: who can write an index or a code file can run any code in each process that loads it. The folder is therefore
the user's own, of mode 0700; each file in it must be his too, and begins with a digest of what follows. A file that fails, is cut off or
changed, is ignored, and the function is compiled as if nothing were kept. A full disk costs the compile time, nothing else.

Processes that start together compile each function once: the second waits until the first has stored it. Functions call each other in
one direction only, so that two never wait for each other; a lock that is held too long is ignored.
"""

import contextlib
import hashlib
import os
import pickle
import stat
import time
from pathlib import Path
from typing import IO, Any

from numba.core import caching
from numba.core.registry import cpu_target

from lmeasure.kernels.kept_folder import is_mine
from lmeasure.kernels.progress import compilation

try:
    import fcntl
except ImportError:  # on Windows each compiles for itself
    fcntl = None  # type: ignore[assignment]

_Function: Any = caching.FunctionCache
_IndexAndData: Any = caching.IndexDataCacheFile

MARK = b"lmeasure kept code 1\n"
LONGEST_WAIT_S = 180.0
"""For another process that compiles the same function: several times as long as the longest of them takes."""
LOOK_AGAIN_S = 0.05


def ready() -> None:
    """Load the parts of numba that call compiled code; otherwise the first call does it, in 0.7 s. Nothing is compiled."""
    cpu_target.typing_context.refresh()
    cpu_target.target_context.refresh()


def _read(path: str) -> bytes | None:
    """Return the stored content; None if it was changed since, or is not of this user."""
    with open(path, "rb") as file:  # noqa: PTH123 - numba's own paths are texts
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or not is_mine(found):
            return None
        content = file.read()
    head = len(MARK) + hashlib.sha256().digest_size
    if not content.startswith(MARK) or content[len(MARK) : head] != hashlib.sha256(content[head:]).digest():
        return None
    return content[head:]


class _Files(_IndexAndData):  # type: ignore[misc]
    """Numba's index and code files, each behind its digest."""

    def _load_index(self) -> Any:
        try:
            content = _read(self._index_path)
        except FileNotFoundError:
            return {}
        version, stamp, overloads = pickle.loads(content) if content is not None else (None, None, {})
        return overloads if (version, stamp) == (self._version, self._source_stamp) else {}

    def _save_index(self, overloads: Any) -> None:
        self._write(self._index_path, self._dump((self._version, self._source_stamp, overloads)))

    def _load_data(self, name: str) -> Any:
        content = _read(self._data_path(name))
        if content is None:
            raise OSError(f"{name}: is not as it was kept")  # which numba takes for a file that is gone
        return pickle.loads(content)

    def _save_data(self, name: str, data: Any) -> None:
        self._write(self._data_path(name), self._dump(data))

    def _write(self, path: str, content: bytes) -> None:
        with self._open_for_write(path) as file:
            file.write(MARK + hashlib.sha256(content).digest() + content)


class KeptCode(_Function):  # type: ignore[misc]
    """The cache of one function; whatever fails in it costs a compilation, never a command.

    in_turn: whether others wait for this process to compile. They do not wait for one of the lowest priority.
    """

    in_turn = True

    def __init__(self, function: Any) -> None:
        super().__init__(function)
        self._name = str(function.__name__)
        self._cache_file = _Files(self._cache_path, self._impl.filename_base, self._impl.locator.get_source_stamp())
        self._turn: IO[bytes] | None = None

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """The kept code for a signature, or None."""
        kept = self._loaded(sig, target_context)
        if kept is None:
            compilation.start(self._name)
            kept = self._loaded(sig, target_context) if self._waited() else None
            if kept is not None:
                compilation.by_another(self._name)
                self._end_turn()
        return kept

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep compiled code, if it can be."""
        compilation.end(self._name)
        with contextlib.suppress(Exception):
            super().save_overload(sig, data)
        self._end_turn()

    def _loaded(self, sig: Any, target_context: Any) -> Any:
        with contextlib.suppress(Exception):
            return super().load_overload(sig, target_context)
        return None

    def _waited(self) -> bool:
        """Take the turn of compiling this function; whether another process had it until now."""
        self._end_turn()  # of a compilation that failed
        if fcntl is None or not self.in_turn:
            return False
        until, waited = time.monotonic() + LONGEST_WAIT_S, False
        try:
            self._impl.locator.ensure_cache_path()
            self._turn = (Path(self._cache_path) / f"{self._impl.filename_base}.lock").open("wb")
            while time.monotonic() < until:
                with contextlib.suppress(BlockingIOError):
                    fcntl.flock(self._turn, fcntl.LOCK_EX | fcntl.LOCK_NB)
                    break
                waited = True
                time.sleep(LOOK_AGAIN_S)
        except OSError:  # a folder that cannot be written, a file system without locks
            self._end_turn()
        return waited

    def _end_turn(self) -> None:
        if self._turn is not None:
            self._turn.close()
            self._turn = None
