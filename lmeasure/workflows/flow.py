"""Common parts of all workflows: progress and its end, the result, and the rule for outputs."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import wraps
from pathlib import Path
from typing import Any, Concatenate, ParamSpec, TypeVar, cast

from lmeasure.core import CancelledError, LMeasureError
from lmeasure.io import abandoned
from lmeasure.text import Message, message, plain
from lmeasure.workflows.outputs import writing
from lmeasure.workflows.settings import Asked, Writing

Given = TypeVar("Given", bound=Asked)
More = ParamSpec("More")


Progress = Callable[[float, str], None]
"""Function that gets the finished part, 0 to 1, and a text. It raises CancelledError to end the work."""


def silent(fraction: float, text: str) -> None:
    """Nobody watches."""


@dataclass
class Ending:
    """Progress of a recording until the user ends it: CancelledError is no error then, nor is Ctrl-C. asked: it was raised."""

    progress: Progress
    asked: bool = False

    def __call__(self, seconds: float, of_seconds: float | None, text: str) -> None:
        try:
            self.progress(min(1.0, seconds / of_seconds) if of_seconds else 0.0, text)
        except CancelledError:
            self.asked = True


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
    """Apply the rule of `lmeasure.workflows.outputs` to the work of a command, and list the files written."""

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
