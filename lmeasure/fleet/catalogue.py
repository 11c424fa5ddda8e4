"""Catalogue of a store: the items done, by which version, from which inputs, and their results."""

import csv
import datetime
import glob
import hashlib
import io
import os
import re
import shutil
import socket
import tempfile
import time
import uuid
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import quote

import sqlalchemy as sa

from lmeasure.core import FileFormatError, LMeasureError, SettingsError, how_to_install
from lmeasure.io import cluster_client, decoded, open_regular, read_regular
from lmeasure.text import message

DONE, FAILED = "done", "failed"
_meta = sa.MetaData()
_item = sa.Table(
    "item", _meta,
    sa.Column("command", sa.String(32), primary_key=True),
    sa.Column("robot", sa.String(255), primary_key=True),
    sa.Column("day", sa.String(255), primary_key=True),
    sa.Column("name", sa.String(255), primary_key=True),
    sa.Column("state", sa.String(8), nullable=False, index=True),
    sa.Column("line", sa.Text, nullable=False),
    sa.Column("digest", sa.String(64), nullable=False),
    sa.Column("output", sa.Text, nullable=False),
    sa.Column("sha256", sa.String(64), nullable=False),
    sa.Column("figures", sa.JSON, nullable=False),
    sa.Column("warnings", sa.JSON, nullable=False),
    sa.Column("seconds", sa.Double, nullable=False),
    sa.Column("version", sa.String(32), nullable=False),
    sa.Column("finished", sa.String(20), nullable=False),
)  # fmt: skip


@dataclass(frozen=True)
class Outcome:
    """Outcome of an item.

    digest: SHA-256 of the command, its options and the bytes of its inputs; sha256: of its outputs; line: the reason for a failure.
    """

    command: str
    robot: str
    day: str
    name: str
    state: str
    line: str = ""
    digest: str = ""
    output: str = ""
    sha256: str = ""
    figures: dict[str, float] = field(default_factory=dict)
    warnings: tuple[str, ...] = ()
    seconds: float = 0.0
    version: str = ""
    finished: str = ""

    @property
    def item(self) -> tuple[str, str, str]:
        """Return robot, day and name."""
        return self.robot, self.day, self.name


class Catalogue:
    """Table of items in an SQLite file, or behind a database's URL.

    Parameters
    ----------
    place
        File, or an SQLAlchemy URL such as `postgresql+psycopg://host/name`.
    """

    def __init__(self, place: str) -> None:
        url = place if "://" in place else f"sqlite:///{Path(place)}"
        self.name = place if "://" not in place else sa.make_url(url).render_as_string()
        try:
            self._engine = sa.create_engine(url, connect_args={"timeout": 60} if url.startswith("sqlite:") else {})
            with self._engine.begin() as connection:
                if url.startswith("sqlite:"):
                    connection.exec_driver_sql("PRAGMA journal_mode = WAL")
                _meta.create_all(connection)
        except (sa.exc.SQLAlchemyError, ModuleNotFoundError) as error:
            raise LMeasureError(message("error.cannot_be_opened_as", where=self.name, error=str(error).splitlines()[0])) from None

    def close(self) -> None:
        """Let go of the database."""
        self._engine.dispose()

    def add(self, outcomes: Sequence[Outcome]) -> None:
        """Write outcomes over earlier ones of the same items, all or none."""
        now = datetime.datetime.now(datetime.UTC).strftime("%Y-%m-%dT%H:%M:%SZ")
        rows = [{**asdict(one), "warnings": list(one.warnings), "finished": now} for one in outcomes]
        try:
            with self._engine.begin() as connection:
                for row in rows:
                    same = sa.and_(*(_item.c[key] == row[key] for key in ("command", "robot", "day", "name")))
                    connection.execute(sa.delete(_item).where(same))
                    connection.execute(_item.insert().values(**row))
        except sa.exc.SQLAlchemyError as error:
            raise LMeasureError(message("error.cannot_be_written_2", where=self.name, error=str(error).splitlines()[0])) from None

    def outcomes(self, command: str = "") -> tuple[Outcome, ...]:
        """Return the outcomes of a command, or of all, by robot, day and name."""
        chosen = sa.select(_item).order_by(_item.c.command, _item.c.robot, _item.c.day, _item.c.name)
        chosen = chosen.where(_item.c.command == command) if command else chosen
        with self._engine.connect() as connection:
            return tuple(_outcome(row._mapping) for row in connection.execute(chosen))


def _outcome(row: "sa.RowMapping") -> Outcome:
    values = {str(key): value for key, value in row.items()}
    return Outcome(**values | {"warnings": tuple(values["warnings"])})


def failures(found: Iterable[Outcome]) -> list[Outcome]:
    """Return those that failed."""
    return [one for one in found if one.state == FAILED]


UNKNOWN = "unknown"
"""Robot or day of an item without a statement."""
SAFE = " !#$&'()+,;@[]^`{}~"
PARTS = ("name", "robot", "day")
LARGEST_TABLE, LARGEST_HEADER = 1 << 28, 1 << 16


@dataclass(frozen=True)
class Item:
    """Item of work: its name, unique within a robot and day, and its own options."""

    name: str
    robot: str = UNKNOWN
    day: str = UNKNOWN
    options: dict[str, str] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Return where its results are in a store: the partition, and the name."""
        return f"robot={_as_folder(self.robot)}/day={_as_folder(self.day)}/{_as_folder(self.name)}"


def _as_folder(text: str) -> str:
    """Return a text as a folder's name: separators, and names with another meaning, are written as %XX."""
    quoted = quote(text, safe=SAFE)
    return quoted.replace(".", "%2E") if set(text) <= {"."} else quoted


def read_items(places: Sequence[str], subject: str, folders: str = "") -> tuple[Item, ...]:
    """Return the items of a batch in the order of their places.

    Parameters
    ----------
    places
        Folders, files, patterns such as `runs/*/day-*`, and tables (.csv) with a column named as the subject. A folder that contains
        only folders means these.
    subject
        Option of the command that the path of an item is given to.
    folders
        Names of the last folders of a path, such as `{robot}/{day}/{name}`. Folders named `robot=...` and `day=...` need none.

    Raises
    ------
    SettingsError
        If a pattern names nothing, two items have one name, or a path does not fit `folders`.
    FileFormatError
        If a table is not readable, or a row is incomplete.
    """
    found: list[Item] = []
    for place in places:
        path = Path(place)
        if path.suffix.lower() == ".csv" and (rows := _rows(path, subject)) is not None:
            found += rows
        elif path.exists():
            found += _named(_within(path), subject, folders)
        else:
            matches = sorted(glob.glob(place, recursive=True))  # noqa: PTH207 - a pattern may begin at any folder
            if not matches:
                raise SettingsError("items", message("fleet.nothing_matches" if glob.has_magic(place) else "fleet.not_there", place=place))
            found += _named([Path(match) for match in matches], subject, folders)
    twice = _first_twice((item.robot, item.day, item.name) for item in found)
    if twice is not None:
        raise SettingsError("items", message("error.two_items_are_named", twice=twice[2], twice2=twice[0], twice3=twice[1]))
    return tuple(found)


def _within(path: Path) -> list[Path]:
    """Return the folders of a folder that holds nothing else; else itself."""
    inner = sorted(p for p in path.iterdir() if not p.name.startswith(".")) if path.is_dir() else []
    return inner if inner and all(p.is_dir() for p in inner) else [path]


def _named(paths: list[Path], subject: str, folders: str) -> list[Item]:
    """Return the items of paths; where one name is several times in a robot and day, the folders above it are part of it."""
    pattern = _pattern(folders) if folders else None
    whole = [path.resolve() for path in paths]
    out = [_item_of(path, given, subject, pattern, folders) for path, given in zip(whole, paths, strict=True)]
    if folders or len({(item.robot, item.day, item.name) for item in out}) == len(out) or len(set(whole)) < len(whole):
        return out
    depth = next(d for d in range(2, 256) if len({path.parts[-d:] for path in whole}) == len(whole))
    return [replace(item, name="-".join((*path.parts[-depth:-1], item.name))) for path, item in zip(whole, out, strict=True)]


def _item_of(path: Path, given: Path, subject: str, pattern: re.Pattern[str] | None, folders: str) -> Item:
    ends = "".join(path.suffixes[-2:] if path.suffix == ".gz" else path.suffixes[-1:])
    parts = {"name": path.name if path.is_dir() else path.name.removesuffix(ends)}
    parts |= {key: value for key, mark, value in (part.partition("=") for part in path.parts) if mark and key in PARTS}
    if pattern is not None:
        match = pattern.search(path.as_posix())
        if match is None:
            raise SettingsError("folders", message("error.does_not_end_in_2", where=given, folders=folders))
        parts |= match.groupdict()
    return Item(**parts, options={subject: str(path)})


def _pattern(folders: str) -> re.Pattern[str]:
    """Return a pattern for robot, day and name at the end of a path."""
    words = re.split(r"(\{[^{}]*\})", folders.strip("/"))
    names = [word[1:-1] for word in words if word.startswith("{")]
    if not names or set(names) - set(PARTS) or len(set(names)) < len(names):
        raise SettingsError("folders", message("error.names_folders_by_robot", folders=folders))
    return re.compile(
        "(?:^|/)"
        + "".join(f"(?P<{w[1:-1]}>[^/]+?)" if w.startswith("{") else re.escape(w).replace(r"\*", "[^/]*") for w in words)
        + r"(?:\.\w{1,8})?$"
    )


def _rows(path: Path, subject: str) -> list[Item] | None:
    """Return the items of a table; None for a file that has no column of the subject."""
    with open_regular(path) as file:
        # another .csv may be a log of gigabytes
        first = file.read(LARGEST_HEADER).splitlines()[:1]
    if not first or subject.encode() not in first[0]:
        return None
    text = decoded(read_regular(path, LARGEST_TABLE), path)
    reader = csv.DictReader(io.StringIO(text), strict=True)
    try:
        header = [(name or "").strip() for name in reader.fieldnames or ()]
        if subject not in header:
            return None
        if len(set(header)) < len(header):
            raise FileFormatError(message("error.line_1_two_columns", path=path))
        reader.fieldnames = header
        out = []
        for row in reader:
            if None in row or None in row.values():
                raise FileFormatError(message("error.line_has_not_cells", path=path, line_num=reader.line_num, n_header=len(header)))
            cells = {key: str(value).strip() for key, value in row.items() if str(value).strip()}
            if subject not in cells:
                raise FileFormatError(message("error.line_states_no", path=path, line_num=reader.line_num, subject=subject))
            parts = {key: cells.pop(key) for key in PARTS if key in cells}
            parts.setdefault("name", Path(cells[subject]).stem)
            out.append(Item(**parts, options=cells))
    except csv.Error as error:
        raise FileFormatError(message("error.line", path=path, line_num=reader.line_num, error=error)) from None
    if not out:
        raise FileFormatError(message("error.has_no_rows", where=path))
    return out


def _first_twice(names: Iterable[tuple[str, str, str]]) -> tuple[str, str, str] | None:
    seen: set[tuple[str, str, str]] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None


PARTS_FOLDER = ".parts"
"""Folder of results that are not whole yet."""


class StoreError(LMeasureError):
    """A store that cannot be reached or written."""


class Store:
    """Where the results of a batch are kept.

    Parameters
    ----------
    place
        Folder, or URL such as `s3://bucket/fleet`, for which fsspec and the package of that place are installed.
    """

    def __init__(self, place: str) -> None:
        self.place = place.removeprefix("file://").rstrip("/") or "/"
        self.folder = None if "://" in self.place else Path(self.place)
        self._remote: Any = None
        if self.folder is None:
            try:
                filesystems: Any = import_module("fsspec")
                self._remote, self._root = filesystems.core.url_to_fs(self.place)
            except (ImportError, ValueError) as error:
                why = " ".join(str(error).split())
                raise LMeasureError(message("error.needs_a_package_that", where=place, why=why, install=how_to_install("store"))) from None

    @contextmanager
    def scratch(self) -> Iterator[Path]:
        """Give a folder for a result that is not whole yet; it is removed afterwards."""
        if self.folder is None:
            with tempfile.TemporaryDirectory(prefix="lmeasure-") as folder:
                yield Path(folder)
            return
        # on the same file system, so that a whole result is moved by one rename
        own = self.folder / PARTS_FOLDER / f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex}"
        own.mkdir(parents=True)
        try:
            yield own
        finally:
            shutil.rmtree(own, ignore_errors=True)

    def keep(self, made: Path, place: str) -> None:
        """Move a result, a file or a folder, to its place; one that is there is replaced."""
        if self.folder is None:
            with self._reached():
                with suppress(FileNotFoundError):
                    self._remote.rm(f"{self._root}/{place}", recursive=True)
                self._remote.put(str(made), f"{self._root}/{place}", recursive=made.is_dir())
            return
        target = self.folder / place
        target.parent.mkdir(parents=True, exist_ok=True)
        if target.is_dir():
            with self.scratch() as old:
                with suppress(FileNotFoundError):  # another worker did the same item again
                    target.rename(old / "old")
                _renamed(made, target)
        else:
            made.replace(target)

    def digest(self, place: str) -> str:
        """Return the SHA-256 of a result, of a folder over its files' names and bytes; empty if it is not there."""
        if self.folder is not None:
            return digest_of(self.folder / place)
        with tempfile.TemporaryDirectory(prefix="lmeasure-") as scratch:
            copy = Path(scratch) / "copy"
            with self._reached(), suppress(FileNotFoundError):
                self._remote.get(f"{self._root}/{place}", str(copy), recursive=True)
            return digest_of(copy)

    @contextmanager
    def _reached(self) -> Iterator[None]:
        """Raise StoreError in one line for any error of a remote place's package."""
        try:
            yield
        except Exception as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise StoreError(message("error.store_out_of_reach", where=self.place, why=why)) from None

    def swept(self) -> None:
        """Remove unfinished files of workers of this machine that have ended."""
        host = socket.gethostname()
        for left in () if self.folder is None else (self.folder / PARTS_FOLDER).glob(f"{host}-*-*"):
            pid = left.name.rsplit("-", 2)[1]
            if pid.isdecimal() and not _lives(int(pid)):
                shutil.rmtree(left, ignore_errors=True)
        with suppress(OSError):
            if self.folder is not None:
                (self.folder / PARTS_FOLDER).rmdir()


def _renamed(made: Path, target: Path) -> None:
    try:
        made.rename(target)
    except OSError:
        if not target.is_dir():  # a worker that did the same item again came first
            raise


def _lives(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def digest_of(path: Path) -> str:
    """Return the SHA-256 of a file, or of a folder's files by name; empty if there is none."""
    if path.is_file():
        with path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    if not path.is_dir():
        return ""
    whole = hashlib.sha256()
    for inner in sorted(p for p in path.rglob("*") if p.is_file()):
        whole.update(f"{inner.relative_to(path).as_posix()}\0{digest_of(inner)}\n".encode())
    return whole.hexdigest()


Task = TypeVar("Task")
Done = TypeVar("Done")
AHEAD = 64
"""Tasks that are handed over before the first of them is done, at least."""
DEATHS = 2
"""Times that the scheduler may give an item up, after some workers died of it, before it has failed."""
AWAY_S = 60.0
"""Longest time for which a scheduler may be out of reach."""
NO_WORKER_S = 30.0
"""Within which a scheduler must have a worker."""


class LostError(LMeasureError):
    """A task whose workers died each time."""


def outcomes(
    work: Callable[[Task], Done], tasks: Sequence[tuple[str, Task]], scheduler: str | None
) -> Iterator[tuple[Task, "Done | LostError"]]:
    """Do tasks, and yield each with its result, as they end.

    Parameters
    ----------
    work
        Function that another process can import. Doing a task twice must do no harm: a worker may die after it.
    tasks
        Tasks by keys that distinguish them.
    scheduler
        Address of a Dask scheduler, `local`, or None: in this process, one after the other.

    Raises
    ------
    LMeasureError
        If no scheduler or worker can be reached; tasks that ended before are given before it.
    """
    if scheduler is None:
        for _, task in tasks:
            yield task, work(task)
        return
    left, since = dict(tasks), time.monotonic()
    while left:
        try:
            with cluster_client(scheduler) as client:
                for key, done in _through(client, work, left):
                    since = time.monotonic()
                    yield left.pop(key), done
        except (ConnectionError, LMeasureError) as error:
            # a lost scheduler may return without its earlier data
            first = len(left) == len(tasks)
            if (isinstance(error, LMeasureError) and first) or time.monotonic() > since + AWAY_S:
                raise LMeasureError(
                    message("error.of_items_are_left", where=scheduler, n_left=len(left), n_tasks=len(tasks), error=error)
                ) from None
            time.sleep(1.0)


def _through(client: Any, work: Callable[[Task], Done], left: dict[str, Task]) -> Iterator[tuple[str, "Done | LostError"]]:
    """Do the remaining work by one connection; ConnectionError if it is lost."""
    distributed: Any = import_module("distributed")
    try:
        client.wait_for_workers(1, timeout=NO_WORKER_S)
    except TimeoutError:
        raise LMeasureError(message("error.no_worker_within_s", no_worker_s=NO_WORKER_S)) from None
    waiting, deaths = deque(left), dict.fromkeys(left, 0)
    ahead = max(AHEAD, 4 * sum(client.ncores().values()))
    held: dict[str, str] = {}

    def submitted(key: str) -> Any:
        future = client.submit(work, left[key], key=f"lmeasure-{key}-{deaths[key]}", pure=False)
        held[future.key] = key
        return future

    running = distributed.as_completed([submitted(waiting.popleft()) for _ in range(min(ahead, len(waiting)))], loop=client.loop)
    for future in running:
        key = held.pop(future.key)
        try:
            done: Done | LostError = future.result()
        except distributed.KilledWorker:
            deaths[key] += 1
            if deaths[key] < DEATHS:
                running.add(submitted(key))
                continue
            done = LostError(message("error.times_all_workers_that", deaths=deaths[key]))
        except (distributed.client.FutureCancelledError, distributed.comm.core.CommClosedError) as error:
            raise ConnectionError(" ".join(str(error).split())) from None
        future.release()  # the workers need not keep it any longer
        if waiting:
            running.add(submitted(waiting.popleft()))
        yield key, done
