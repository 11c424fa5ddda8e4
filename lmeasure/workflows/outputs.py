"""Rule for the outputs of a command: nothing that exists, unless `--force` is given; an input or a recording never.

The rule is one of commands. Functions of the Python package write to the caller's paths, except `certify`, which has `force` too.
"""

import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from lmeasure.core import CancelledError, LMeasureError, OverwriteError
from lmeasure.io import abandoned, read_toml
from lmeasure.recording import recording_at
from lmeasure.text import message


@contextmanager
def writing(outputs: Iterable[Path], inputs: Iterable[Path] = (), *, force: bool = False) -> Iterator[list[Path]]:
    """Refuse, before any work is done, what must not be written; yield the list of files that the block has written.

    Parameters
    ----------
    outputs
        Files that the command may write.
    inputs
        Files that it reads.
    force
        Replace outputs that exist.

    Raises
    ------
    OverwriteError
        An output exists and force is not given; or it is an input, a part of a recording, or no regular file.
    LMeasureError
        A folder cannot be written to.
    """
    candidates = list(dict.fromkeys(map(Path, outputs)))
    read = with_named(inputs) if any(map(os.path.lexists, candidates)) else []
    there = [path for path in candidates if _refused(path, read)]
    if there and not force:
        others = message("error.and_more_files", count=len(there) - 1) if len(there) > 1 else ""
        raise OverwriteError(message("error.exists_force_replaces_it", where=there[0], others=others))
    _clear(candidates)
    before = {path: _stamp(path) for path in candidates}
    done: list[Path] = []
    try:
        yield done
    except BaseException as error:
        # broken off, or out of room: a part of its files would only stand in the way of the same command
        if isinstance(error, CancelledError | KeyboardInterrupt) or isinstance(error.__cause__, OSError):
            for path in (one for one in candidates if before[one] is None):
                with suppress(OSError):
                    path.unlink()
        raise
    done.extend(path for path in candidates if _stamp(path) not in (None, before[path]))


def _refused(path: Path, inputs: Iterable[Path]) -> bool:
    """Return whether an output exists and may be replaced; OverwriteError where it never may."""
    try:
        path.lstat()
        mode = path.stat().st_mode if path.exists() else stat.S_IFREG  # a link that leads nowhere is replaced itself
    except (OSError, ValueError):  # not there, or no name at all, which the writer reports
        _writable(path)
        return False
    if not stat.S_ISREG(mode):
        kind = message("error.a_folder" if stat.S_ISDIR(mode) else "error.no_regular_file")
        raise OverwriteError(message("error.is_where_this_command", where=path, kind=kind))
    if any(_is(path, one) for one in inputs):
        raise OverwriteError(message("error.is_an_input_of", where=path))
    if recording_at(path):
        raise OverwriteError(message("error.is_part_of_a", where=path))
    _writable(path)
    return True


def with_named(inputs: Iterable[Path]) -> list[Path]:
    """Return the inputs and the files that they name: the rig of a run or a scenario, the calibration or the DBC file of a rig."""
    found = list(dict.fromkeys(map(Path, inputs)))
    for path in found:  # grows by what is named
        if path.suffix == ".toml":
            with suppress(LMeasureError, OSError, ValueError):
                named = [path.parent / text for text in _texts(dict(read_toml(path)))]
                found += [one for one in named if one.is_file() and one not in found]
    return found


def _texts(value: Any) -> Iterator[str]:
    """Yield the texts of a TOML document that may be names of files."""
    if isinstance(value, str) and 0 < len(value) < 256 and "\n" not in value:
        yield value
    elif isinstance(value, dict | list):
        for one in value.values() if isinstance(value, dict) else value:
            yield from _texts(one)


def _is(path: Path, read: Path) -> bool:
    """Return whether two names are one file, by links too."""
    with suppress(OSError, ValueError):
        return read.samefile(path)
    return False


def _writable(path: Path) -> None:
    """Raise LMeasureError where the file's folder, or the one in which that is made, may not be written to."""
    with suppress(OSError, ValueError):
        folder = next(one for one in path.parents if one.exists())
        if folder.is_dir() and not os.access(folder, os.W_OK | os.X_OK):
            raise LMeasureError(message("error.cannot_be_written_no", where=path, folder=folder))


def _clear(outputs: Iterable[Path]) -> None:
    """Remove the unfinished files of these outputs that killed processes have left."""
    names: dict[Path, set[str]] = {}
    for path in outputs:
        names.setdefault(path.parent, set()).add(path.name)
    for folder, own in names.items():
        for left in abandoned(folder):
            if left.name in own and left.path.is_file():
                with suppress(OSError):
                    left.path.unlink()


def _stamp(path: Path) -> tuple[int, ...] | None:
    """Return a stamp that changes if a file is written again; None without a file."""
    try:
        found = path.stat()
    except (OSError, ValueError):
        return None
    return (found.st_ino, found.st_mtime_ns, found.st_size) if stat.S_ISREG(found.st_mode) else None
