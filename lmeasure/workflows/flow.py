"""Common parts of all workflows: progress and its end, the result, and the rule for outputs.

Rule for the outputs of a command: nothing that exists, unless `--force` is given; an input or a recording never.

The rule is one of commands. Functions of the Python package write to the caller's paths, except `certify`, which has `force` too.
"""

import os
import stat
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

from lmeasure.core import CancelledError, LMeasureError, OverwriteError
from lmeasure.io import abandoned, read_toml
from lmeasure.recording import recording_at
from lmeasure.text import Message, message, plain
from lmeasure.workflows.settings import CommandSettings, Writing


@contextmanager
def writing(outputs: Iterable[Path], inputs: Iterable[Path] = (), *, force: bool = False) -> Iterator[list[Path]]:
    """Refuse, before any work is done, outputs that must not be written; yield the list of files that the block has written.

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
        # interrupted, or out of space: partial files would only block the same command
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
    for path in found:
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


Given = TypeVar("Given", bound=CommandSettings)
More = ParamSpec("More")


Progress = Callable[[float, str], None]
"""Function that gets the finished part, 0 to 1, and a text. It raises CancelledError to end the work."""


def silent(fraction: float, text: str) -> None:
    """Report nothing."""


@dataclass
class Ending:
    """Progress of a recording until the user ends it: CancelledError is no error then, nor is Ctrl-C. ended: the user has ended it."""

    progress: Progress
    ended: bool = False

    def __call__(self, seconds: float, of_seconds: float | None, text: str) -> None:
        try:
            self.progress(min(1.0, seconds / of_seconds) if of_seconds else 0.0, text)
        except CancelledError:
            self.ended = True


def steps(progress: Progress, text: str) -> Callable[[int, int], None]:
    """The callback `(done, of)` that stages take."""

    def step(done: int, of: int) -> None:
        progress(done / of if of else 0.0, text)

    return step


@dataclass(frozen=True)
class Result:
    """Result of a workflow: its object, its lines for the user, with results by name and warnings for programs, and the files written.
    failure: why the result differs from the request, though it is kept; exit_code: as a command's; next: the command to type next; page: a
    page to open; details: more lines on request."""

    made: Any
    summary: tuple[str, ...]
    figures: Mapping[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    files: tuple[Path, ...] = ()
    failure: str = ""
    exit_code: int = 0
    next: str = ""
    page: Path | None = None
    details: tuple[str, ...] = ()


def workflow(work: Callable[Concatenate[Given, More], Result]) -> Callable[Concatenate[Given, More], Result]:
    """Apply the rule of `lmeasure.workflows.flow` to the work of a command, and list the files written."""

    @wraps(work)
    def run(settings: Given, *args: More.args, **more: More.kwargs) -> Result:
        outputs, inputs = settings.paths()
        force = isinstance(settings, Writing) and settings.force
        with writing(outputs, inputs, force=force) as written, _of_unlikely(inputs) as unlikely:
            result = work(settings, *args, **more)
        return replace(
            result,
            summary=(*map(_plain, result.summary), *(message("line.note", text=text) for text in unlikely)),
            warnings=(*map(_plain, result.warnings), *unlikely),
            failure=_plain(result.failure),
            files=tuple(dict.fromkeys((*written, *result.files))),
            next=result.next or settings.following(),
        )

    return cast(Callable[Concatenate[Given, More], Result], run)


def _plain(text: str) -> str:
    return text if isinstance(text, Message) else plain(text)


def present(*found: Path | None) -> tuple[Path, ...]:
    """Those that are given."""
    return tuple(path for path in found if path is not None)


def inside(folder: Path, *names: str) -> tuple[Path, ...]:
    """Files of a folder."""
    return tuple(folder / name for name in names)


def in_run_folder(folder: Path, *more: str) -> tuple[Path, ...]:
    """Return the content of a run folder, as far as it is there: which passes a command will write it does not know yet."""
    there = [path for pattern in ("pass[0-9]*.csv", "pass[0-9]*.parquet", "pass[0-9]*.log") for path in sorted(folder.glob(pattern))]
    there += [folder / left.name for left in abandoned(folder) if left.name.startswith("pass")]
    first = inside(folder, "pass1.csv", "pass1.parquet", "pass1.events.csv")
    return (*inside(folder, "run.toml", "rig.toml", "calibration.json", *more), *first, *there)


@contextmanager
def _of_unlikely(inputs: Iterable[Path]) -> Iterator[list[str]]:
    """Yield a list that gets unlikely values of the rigs that were read, when the work is done; if it fails, they follow the error."""
    unlikely: list[str] = []
    try:
        yield unlikely
    except LMeasureError as error:
        reported = sizes_of(inputs)
        if reported:
            error.complaints = (*error.lines, *reported)
        raise
    unlikely += sizes_of(inputs)


def sizes_of(paths: Iterable[Path]) -> list[str]:
    """Return the unlikely sizes of rigs among files."""
    from lmeasure.io import LARGEST_TOML, read_regular, read_toml
    from lmeasure.rig import unlikely_size

    reported: list[str] = []
    for path in dict.fromkeys(path for path in paths if path.suffix == ".toml"):
        with suppress(LMeasureError, OSError):
            # most files are no rigs, and some are large
            found = unlikely_size(read_toml(path), str(path)) if b"observation_point" in read_regular(path, LARGEST_TOML) else None
            reported += [] if found is None else [found]
    return reported
