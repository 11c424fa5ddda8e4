"""One command for many folders, on one machine or on the workers of a cluster."""

import errno
import hashlib
import json
import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from pydantic import Field, field_validator

from lmeasure.core import LMeasureError, SettingsError, version_of
from lmeasure.io import write_table
from lmeasure.text import Message, message, of_terminal, plain
from lmeasure.workflows.flow import Progress, Result, silent, workflow
from lmeasure.workflows.options import written
from lmeasure.workflows.registry import load
from lmeasure.workflows.settings import LANGUAGE, CommandSettings, Paths, Writing, option, said_of, then

if TYPE_CHECKING:
    from lmeasure.fleet import Item, Outcome, Store

COMMANDS = ("import", "reconstruct", "calibrate", "identify", "certify", "verify", "motion", "zone", "place", "simulate", "correct")
"""Commands that read one input, ask no questions, and write under --out."""
FOLLOWING = {
    "import": "batch reconstruct '{out}/import/*/*/*' --out {out}",
    "reconstruct": "batch certify '{out}/trajectory/*/*/*' --set program=program.toml --out {out}",
    "calibrate": "batch zone '{out}/calibrate/*/*/*/rig.toml' --out {out}",
    "certify": "batch verify '{out}/certify/*/*/*' --out {out}",
}
CATALOGUE = "catalogue.sqlite"
NO_PLACE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)


class BatchSettings(CommandSettings):
    command: Annotated[
        Literal["import", "reconstruct", "calibrate", "identify", "certify", "verify", "motion", "zone", "place", "simulate", "correct"],
        option("Command to do for each item.", metavar="COMMAND", positional=True),
    ]
    items: Annotated[
        tuple[str, ...],
        Field(min_length=1),
        option(
            "Folders, files or patterns; or a table (.csv) with a column per option, and name, robot, day.",
            metavar="ITEM...",
            positional=True,
        ),
    ]
    out: Annotated[str, option("Store of the results: a folder, or a URL such as s3://bucket/fleet.", metavar="STORE")]
    options: Annotated[tuple[str, ...], option("Option of the command, the same for all items.", flag="--set", metavar="NAME=VALUE")] = ()
    folders: Annotated[str, option("Meaning of the last folders of each path, to name robot and day.", metavar="{robot}/{day}/{name}")] = ""
    scheduler: Annotated[str | None, option("Dask scheduler, or local: one process for each processor.", metavar="tcp://HOST:PORT")] = None
    catalogue: Annotated[str, option("Database of the items (file or SQLAlchemy URL); default in the store.", metavar="URL")] = ""
    result: Annotated[str, option("Result to compare the robots by; default the first U95.", metavar="NAME")] = ""
    language: Annotated[Literal["en", "ru"] | None, LANGUAGE] = None

    @field_validator("out", mode="before")
    @classmethod
    def _as_text(cls, value: Any) -> Any:
        return str(value) if isinstance(value, Path) else value

    def following(self) -> str:
        return then(FOLLOWING.get(self.command, "workbench"), out=self.out)

    def paths(self) -> Paths:
        return Paths()


@dataclass(frozen=True)
class Task:
    """A worker's input: the item, all options as text, the store, and the digest of its earlier result."""

    command: str
    item: "Item"
    options: dict[str, str]
    out: str
    version: str
    before: "Outcome | None"


@workflow
def run_batch(settings: BatchSettings, progress: Progress = silent) -> Result:
    """Process the remaining items, keep each outcome as it comes, and write the summary."""
    from lmeasure.fleet import Catalogue, LostError, Outcome, Store, outcomes, read_items

    model = load(settings.command).settings
    subject = next(name for name, field in model.model_fields.items() if "positional" in said_of(field))
    common = _options(settings, model, subject)
    items = read_items(settings.items, subject, settings.folders)
    store = Store(settings.out)
    if store.folder is None and not settings.catalogue:
        raise SettingsError("catalogue", message("error.is_missing_holds_no", out=settings.out))
    if store.folder is not None:
        store.folder.mkdir(parents=True, exist_ok=True)
        store.swept()
    catalogue = Catalogue(settings.catalogue or str(Path(settings.out) / CATALOGUE))
    version = version_of("lmeasure")
    try:
        before = {one.item: one for one in catalogue.outcomes(settings.command)}
        tasks = []
        for item in items:
            own = _absolute(common | item.options, model)
            known = before.get((item.robot, item.day, item.name))
            tasks.append((f"{settings.command}-{item.place}", Task(settings.command, item, own, settings.out, version, known)))
        counts = {"done": 0, "failed": 0, "unchanged": 0}
        waiting, new = list[Outcome](), list[str]()
        saved = time.monotonic()
        try:
            for n, (task, came) in enumerate(outcomes(worked, tasks, settings.scheduler), start=1):
                if isinstance(came, LostError):
                    came = _failed(task, str(came))
                if isinstance(came, Stop):
                    raise LMeasureError(message("error.of_items_are_kept", line=came.line, n=n - 1, n_tasks=len(tasks)))
                counts["unchanged" if came == task.before else came.state] += 1
                if came != task.before:
                    waiting.append(came)
                    new += [came.output] if came.output else []
                if time.monotonic() > saved + 1.0:
                    catalogue.add(waiting)
                    waiting, saved = [], time.monotonic()
                progress(n / len(tasks), f"{settings.command} {task.item.name}")
        finally:
            catalogue.add(waiting)
        found = catalogue.outcomes(settings.command)
    finally:
        catalogue.close()
    files = [*_summary(store, settings, found), *([] if settings.catalogue else [Path(settings.out) / CATALOGUE])]
    files += [store.folder / output for output in new if store.folder is not None]
    store.swept()
    ours = {(item.robot, item.day, item.name) for item in items}
    failed = [one for one in found if one.state == "failed" and one.item in ours]
    lines: list[Message] = [message("batch.done", count=len(items), out=settings.out, **counts)]
    lines += [message("batch.failed", robot=one.robot, day=one.day, name=one.name, line=plain(one.line)) for one in failed[:MOST_LINES]]
    if len(failed) > MOST_LINES:
        lines.append(message("batch.more", count=len(failed) - MOST_LINES))
    figures = {"items": float(len(items)), **{key: float(value) for key, value in counts.items()}}
    made: dict[str, object] = {
        "store": settings.out,
        "failed": [{"robot": o.robot, "day": o.day, "name": o.name, "line": o.line} for o in failed],
    }
    failure = message("batch.some_failed", failed=len(failed), count=len(items)) if failed else ""
    return Result(made, tuple(lines), figures, files=tuple(files), failure=failure)


MOST_LINES = 10
"""Most failures on the screen."""


def _options(settings: BatchSettings, model: type[CommandSettings], subject: str) -> dict[str, str]:
    """Return the options that all items have; SettingsError for one that the command has not."""
    own = {"out", subject, "force", "report", "rerun", "browser"}
    known = sorted(name for name in model.model_fields if name not in own)
    out = {}
    for text in settings.options:
        name, mark, value = text.partition("=")
        name = name.strip().removeprefix("--").replace("-", "_")
        if not mark or name not in known:
            raise SettingsError("options", message("error.is_not_name_value", text=text, command=settings.command, known=", ".join(known)))
        out[name] = value.strip()
    return out


def _absolute(options: dict[str, str], model: type[CommandSettings]) -> dict[str, str]:
    """Return options in which files are found from any folder."""
    fields = model.model_fields
    paths = {name for name in options if name in fields and (written(fields[name]).kind is Path or Path(options[name]).exists())}
    return {name: str(Path(value).resolve()) if name in paths else value for name, value in options.items()}


@dataclass(frozen=True)
class Stop:
    """Reason why no further item can be processed: the store is full, or a worker is of another version."""

    line: str


def worked(task: Task) -> "Outcome | Stop":
    """Do one item in this process, and keep its result in the store: whole, or not at all.

    An item is done again only if its options, the bytes of its inputs or the version of the program are others, or its result is not
    there with the bytes that were kept.
    """
    from lmeasure.fleet import Store, StoreError

    if task.version != version_of("lmeasure"):
        return Stop(f"a worker has lmeasure {version_of('lmeasure')}, not {task.version}")
    begun = time.perf_counter()
    try:
        store = Store(task.out)
        with store.scratch() as scratch:
            found = _worked(task, store, scratch)
            return found if found is task.before else replace(found, seconds=time.perf_counter() - begun)
    except StoreError as error:
        return Stop(str(error))
    except LMeasureError as error:
        return _failed(task, str(error))
    except OSError as error:
        if error.errno in NO_PLACE:
            return Stop(f"{task.out}: {error.strerror}")
        return _failed(task, f"{error.filename or task.item.name}: {error.strerror or error}")
    except Exception as error:  # a fault of the program in one item is no reason to lose a night's work
        return _failed(task, f"internal error: {type(error).__name__}: {error}")


def _worked(task: Task, store: "Store", scratch: Path) -> "Outcome":
    from lmeasure.fleet import Outcome

    flow = load(task.command)
    model = flow.settings
    subject = next(name for name, field in model.model_fields.items() if "positional" in said_of(field))
    given: dict[str, Any] = {
        name: [v] if written(model.model_fields[name]).repeated else v for name, v in task.options.items() if name in model.model_fields
    }
    unknown = sorted(set(task.options) - set(model.model_fields))
    if unknown:
        raise SettingsError(unknown[0], message("error.is_no_option_of", command=task.command))
    output, made = "", scratch / "made"
    if "out" in model.model_fields:
        file = model.OUT_FILE if issubclass(model, Writing) else ""
        made = made / file if file else made
        output = _place(task, file)
        made.parent.mkdir(exist_ok=True)
        given["out"] = str(made)
    if "browser" in model.model_fields:
        given["browser"] = False
    settings = model.model_validate(given)
    digest = _digest(task, settings, subject)
    known = task.before
    if known is not None and known.state == "done" and known.digest == digest and (not output or store.digest(output) == known.sha256):
        return known
    result = flow.run(settings)
    failure = str(result.failure) or (str(result.summary[-1]) if result.exit_code else "")
    sha256 = ""
    if output and not failure:
        store.keep(made, output)
        sha256 = store.digest(output)
    figures = {name: float(value) for name, value in result.figures.items() if math.isfinite(value)}
    warnings = tuple(str(text) for text in result.warnings)
    state = "failed" if failure else "done"
    item = task.item
    values: dict[str, Any] = {
        "state": state,
        "line": failure,
        "digest": digest,
        "output": output,
        "sha256": sha256,
        "version": task.version,
    }
    return Outcome(task.command, item.robot, item.day, item.name, figures=figures, warnings=warnings, **values)


def _place(task: Task, file: str) -> str:
    """Return where the result of an item is in the store: tables of one kind are one dataset, by robot and day."""
    if file.endswith(".parquet"):
        return f"{file.removesuffix('.parquet')}/{task.item.place}.parquet"
    return f"{task.command}/{task.item.place}" + (f"/{file}" if file else "")


def _digest(task: Task, settings: CommandSettings, subject: str) -> str:
    """Return the SHA-256 of the version, the command, its options, and the bytes of all its inputs."""
    from lmeasure.fleet import digest_of

    paths = {*settings.paths().inputs, *(Path(value) for value in task.options.values() if Path(value).exists())}
    files = {str(path): digest_of(path) for path in sorted(paths)}
    whole = {"version": task.version, "command": task.command, "options": task.options, "files": files}
    return hashlib.sha256(json.dumps(whole, sort_keys=True).encode()).hexdigest()


def _failed(task: Task, line: str) -> "Outcome":
    from lmeasure.fleet import Outcome

    item = task.item
    return Outcome(task.command, item.robot, item.day, item.name, "failed", " ".join(line.split()), version=task.version)


def _summary(store: "Store", settings: BatchSettings, found: "Sequence[Outcome]") -> tuple[Path, ...]:
    """Write the items as a table, the figures as a dataset by robot and day, and the page; return them where they are files here."""
    from lmeasure.report import FleetItem, write_fleet_page

    result = settings.result or next((name for one in found for name in one.figures if "u95" in name), "")
    result = result or next((name for one in found for name in one.figures), "")
    if settings.result and found and not any(result in one.figures for one in found):
        known = sorted({name for one in found for name in one.figures})
        raise SettingsError("result", message("error.is_no_result_of", result=result, command=settings.command, known=", ".join(known)))
    with store.scratch() as scratch:
        table, page, folder = scratch / "items.csv", scratch / "summary.html", scratch / "figures"
        header = ["robot", "day", "name", "state", "line", "output", "sha256", "seconds", "version"]
        write_table(table, {name: [getattr(one, name) for one in found] for name in header})
        shown = [FleetItem(o.robot, o.day, o.name, o.figures.get(result), o.line) for o in found]
        write_fleet_page(page, settings.command, result, shown, language=settings.language or of_terminal())
        made = {f"{settings.command}.csv": table, f"{settings.command}.html": page}
        made |= {f"figures/{place}": path for place, path in _figures(folder, settings.command, found).items()}
        for place, path in made.items():
            store.keep(path, place)
    return () if store.folder is None else tuple(store.folder / place for place in made)


def _figures(folder: Path, command: str, found: "Sequence[Outcome]") -> dict[str, Path]:
    """Write a table of figures for each robot and day: name, figure, value; return the tables by their places in the dataset."""
    from lmeasure.fleet import Item

    days: dict[str, list[tuple[str, str, float]]] = {}
    for one in found:
        place = Item(command, one.robot, one.day).place
        days.setdefault(place, []).extend((one.name, name, value) for name, value in one.figures.items())
    out = {}
    for n, (place, rows) in enumerate((place, rows) for place, rows in days.items() if rows):
        folder.mkdir(exist_ok=True)
        path = folder / f"{n}.parquet"
        write_table(path, dict(zip(("name", "figure", "value"), map(list, zip(*rows, strict=True)), strict=True)))
        out[f"{place}.parquet"] = path
    return out
