"""The one rule for what commands write: a command may replace whole what the same command wrote there before, and nothing else.

A file's own content cannot tell who wrote it: planned reference poses become measured ones by a person's hand, under the same name and
columns. So each folder written to keeps, in `LEDGER`, which command wrote which file and the digest of what it wrote. What is not there, or
has been changed since, is somebody's, and is not written over.
"""

import contextlib
import json
import os
import re
import stat
import time
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from lmeasure.errors import LMeasureError, OverwriteError
from lmeasure.opened import open_regular, sha256_of

LEDGER = ".lmeasure-written.json"
SCHEMA = "lmeasure.written/1"
WAIT_S = 5.0  # for another command that enters its files, which takes milliseconds
PART = re.compile(r"\..+\.(\d+)\.(part|old)(\..*)?")
"""Names under which files and folders stand until they are whole: .NAME.PROCESS.part"""


@contextmanager
def writing(command: str, outputs: Iterable[Path], inputs: Iterable[Path] = ()) -> Iterator[list[Path]]:
    """Around a command's work: outputs are the files that it may write, inputs those that it reads; the value lists, at the end, what the
    block has written.

    OverwriteError, before anything is done, where an output is there and is an input, or was not written by this command, or was changed
    since; LMeasureError where a folder cannot be written to. What the block has written is entered, also when it ends early: each file by
    itself is whole. Where it ends early and that cannot be entered, as on a full disk, the files that are new are taken away again.
    """
    candidates = list(dict.fromkeys(Path(path) for path in outputs))
    for path in candidates:
        _claim(command, path, inputs)
    before = {path: _stamp(path) for path in candidates}
    done: list[Path] = []

    def enter() -> None:
        done.extend(path for path in candidates if _stamp(path) not in (None, before[path]))
        for folder in dict.fromkeys(path.parent for path in done):
            _enter(command, folder, [path for path in done if path.parent == folder])

    try:
        yield done
    except BaseException:
        try:
            enter()
        except (OSError, LMeasureError):
            for path in done:
                if before[path] is None:  # else the next command would take it for somebody's
                    with contextlib.suppress(OSError):
                        path.unlink()
        raise
    with contextlib.suppress(OSError, LMeasureError):  # then the files are somebody's, and the next command says so
        enter()


def left_over(folders: Iterable[Path]) -> list[Path]:
    """Unfinished files and folders in the folders whose process is gone: it was killed, or the power failed."""
    found = []
    for folder in dict.fromkeys(Path(f) for f in folders):
        with contextlib.suppress(OSError):
            for path in sorted(folder.iterdir()):
                name = PART.fullmatch(path.name)
                if name and not _runs(int(name[1])):
                    found.append(path)
    return found


def _claim(command: str, path: Path, inputs: Iterable[Path]) -> None:
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError):  # not there, or no name at all, which the writer says
        _writable(path)
        return
    if stat.S_ISDIR(mode):
        return  # which the writer says too
    for one in inputs:
        with contextlib.suppress(OSError):
            if Path(one).samefile(path):
                raise OverwriteError(f"{path}: is read by this command, which does not write over what it reads; give --out another name")
    if not _is_own(command, path):
        raise OverwriteError(
            f"{path}: is there already, and not as `lmeasure {command}` wrote it, and is not written over: remove it or give another name"
        )
    _writable(path)


def _writable(path: Path) -> None:
    """Said before the work is done: LMeasureError where the file's folder, or the one in which that is made, may not be written to."""
    with contextlib.suppress(OSError, ValueError):
        folder = next(one for one in path.parents if one.exists())
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise LMeasureError(f"{path}: cannot be written: no permission in {folder}; give a folder that you may write to")


def _is_own(command: str, path: Path) -> bool:
    entry = _entries(path.parent).get(path.name)
    if not isinstance(entry, dict) or entry.get("command") != command:
        return False
    try:
        return entry.get("sha256") == sha256_of(path)
    except LMeasureError:
        return False


def _entries(folder: Path) -> dict[str, object]:
    try:
        with open_regular(folder / LEDGER) as file:
            content = json.load(file)
    except (LMeasureError, OSError, ValueError, RecursionError):
        return {}
    entries = content.get("files") if isinstance(content, dict) and content.get("schema") == SCHEMA else None
    return entries if isinstance(entries, dict) else {}


def _enter(command: str, folder: Path, paths: list[Path]) -> None:
    new = {path.name: {"command": command, "sha256": sha256_of(path)} for path in paths}
    temporary = folder / f"{LEDGER}.{os.getpid()}.part"
    with _alone(folder):
        entries = {name: entry for name, entry in _entries(folder).items() if (folder / name).exists()} | new
        try:
            temporary.write_text(json.dumps({"schema": SCHEMA, "files": entries}, indent=1, sort_keys=True) + "\n", encoding="utf-8")
            temporary.replace(folder / LEDGER)
        finally:
            temporary.unlink(missing_ok=True)


@contextmanager
def _alone(folder: Path) -> Iterator[None]:
    """While no other command enters what it wrote into this folder; one that was killed meanwhile is waited for in vain, and once."""
    lock, given_up = folder / f"{LEDGER}.lock", time.monotonic() + WAIT_S
    while True:
        try:
            os.close(os.open(lock, os.O_CREAT | os.O_EXCL | os.O_WRONLY))
            break
        except FileExistsError:
            if time.monotonic() > given_up:
                break
            time.sleep(0.01)
    try:
        yield
    finally:
        lock.unlink(missing_ok=True)


def _stamp(path: Path) -> tuple[int, ...] | None:
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return (found.st_ino, found.st_mtime_ns, found.st_size) if stat.S_ISREG(found.st_mode) else None


def _runs(process: int) -> bool:
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # of somebody else, or no number of a process: then it is not ours to judge
        return True
    return True
