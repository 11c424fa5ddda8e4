"""A project folder: its content, found from the files themselves, and the next step. The command line and the workbench share it."""

import contextlib
import json
import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from lmeasure.acquisition import log_suffixes
from lmeasure.core import LMeasureError
from lmeasure.io import LARGEST_NAME, loads, open_regular, read_regular
from lmeasure.text import message

OWN = ".workbench"
DEEP, MANY = 5, 5000
_BY_SCHEMA = {kind: kind for kind in ("rig", "program", "robot", "structure", "scenario", "placement", "details")} | {
    "drum": "drums",
    "report": "details",
}
_HEAD = 65536
LARGEST_TEXT, LARGEST_JSON = 10**5, 10**8
"""Bytes of a file that a person could have written, and of a certificate: a page reads no more of it."""
LONGEST = 4096
"""Letters of a path."""


class OutsideError(LMeasureError):
    """A path that leads out of the project."""


@dataclass(frozen=True)
class ProjectFile:
    """An object of the project: its kind (rig, calibration, record, run, trajectory, zone, program, certificate, poses, robot, page,
    recording, log, ...) and its path in the folder, with slashes."""

    kind: str
    path: str


@dataclass(frozen=True)
class Project:
    """A folder and its content."""

    folder: Path
    found: tuple[ProjectFile, ...] = field(repr=False, default=())
    known: Mapping[str, str] = field(repr=False, default_factory=dict)
    """Values known beside files, by options: the used bus, and the pose of a simulated robot."""
    doubted: frozenset[str] = field(repr=False, default=frozenset())
    """Files of failed jobs: a form offers them last, and fills none of them in."""

    def of(self, kind: str) -> tuple[str, ...]:
        """Paths of a kind, those nearest to the top first."""
        return tuple(one.path for one in self.found if one.kind == kind)

    def calibrated(self) -> tuple[str, ...]:
        """Rigs that link a calibration."""
        return tuple(path for path in self.of("rig") if _links(self.folder / path))


def look_at(folder: Path) -> Project:
    """The project as it is now."""
    found = sorted({one for path in _walk(folder) for one in _kinds(folder, path)}, key=lambda one: (one.path.count("/"), one.path))
    return Project(folder, tuple(found))


def inside(folder: Path, text: str) -> Path:
    """Return the path of a text within the folder. OutsideError for one that leads elsewhere, by dots, links or drives, or to hidden files:
    all names that begin with a dot, such as the workbench's own folder."""
    if "\0" in text or not text.strip() or len(text) > LONGEST:
        raise OutsideError(message("error.is_no_path", text=text[:200]))
    root = folder.resolve()
    try:
        path = (root / text).resolve()
    except (OSError, RuntimeError, ValueError) as error:
        raise OutsideError(message("error.is_no_path_2", text=text, error=error)) from error
    if not path.is_relative_to(root):
        raise OutsideError(message("error.lies_outside_the_project", where=text, folder=folder))
    if any(part.startswith(".") for part in path.relative_to(root).parts):
        raise OutsideError(message("error.is_hidden_the_workbench", where=text))
    if any(len(os.fsencode(part)) > LARGEST_NAME for part in path.relative_to(root).parts):
        raise OutsideError(message("error.is_no_path_a", text=text[:200], largest_name=LARGEST_NAME))
    return path


def _walk(folder: Path, deep: int = DEEP) -> Iterator[Path]:
    """Files below the folder, not those of hidden folders nor behind links."""
    left, waiting = MANY, [(folder, deep)]
    while waiting and left > 0:
        here, depth = waiting.pop(0)
        with contextlib.suppress(OSError):
            for path in sorted(here.iterdir()):
                if path.name.startswith(".") or path.is_symlink():
                    continue
                if path.is_dir() and depth > 0 and not _aside(here, path.name):
                    waiting.append((path, depth - 1))
                elif path.is_file():
                    left -= 1
                    yield path


def _aside(here: Path, name: str) -> bool:
    """Return whether a folder in another contains nothing of the project's own: a certificate's copies, or the truth of a simulation."""
    beside = {"inputs": ("certificate.json",), "true": ("reference_poses.csv", "robot.toml")}
    return any((here / file).is_file() for file in beside.get(name, ()))


def _kinds(folder: Path, path: Path) -> Iterator[ProjectFile]:
    """Yield the kind of a file; a folder is known by the file that makes its kind."""
    here, above = path.relative_to(folder).as_posix(), path.parent.relative_to(folder).as_posix()
    suffix = path.suffix.lower()
    if path.name == "run.toml":
        yield ProjectFile("run", above)
    elif path.name == "certificate.json":
        yield ProjectFile("certificate", above)
    elif path.name == "calibration.json":
        yield ProjectFile("record", here)
    elif path.name == "check.json":
        yield ProjectFile("check", here)
    elif path.name == "register.sqlite":
        yield ProjectFile("register", above)
    elif path.name == "identified.json":
        yield ProjectFile("identification", above)
    elif path.name == "reference_poses.csv" and (path.parent / "counts.csv").is_file():
        yield ProjectFile("calibration", above)
        yield ProjectFile("poses", here)  # to be captured again
    elif suffix == ".toml":
        if kind := _BY_SCHEMA.get(schema_of(path)):
            yield ProjectFile(kind, here)
    elif suffix == ".nc":
        yield ProjectFile("zone", here)
    elif suffix == ".rrd":
        yield ProjectFile("recording", here)
    elif suffix in (".key", ".pub"):
        yield ProjectFile("key" if suffix == ".key" else "public key", here)
    elif suffix in (".html", ".pdf"):
        yield ProjectFile("page", here)
    elif suffix in log_suffixes():
        yield ProjectFile("log", here)
    elif suffix in (".csv", ".parquet", ".tum", ".mcap"):
        yield from _table(path, here)


def _table(path: Path, here: str) -> Iterator[ProjectFile]:
    if path.suffix.lower() in (".tum", ".mcap"):
        yield ProjectFile("trajectory", here)
        return
    if path.suffix.lower() == ".parquet":
        if not path.name.startswith("pass"):
            yield ProjectFile("trajectory", here)
        return
    # as they are read: a mark of other editors before the first, semicolons or tabs between them
    names = {name.strip().strip('"') for name in re.split("[,;\t]", _head(path).removeprefix("\ufeff").split("\n", 1)[0])}
    if {"time_s", "x_mm", "y_mm", "z_mm"} <= names:
        yield ProjectFile("trajectory", here)
    elif {"pose", "x_mm"} <= names:
        yield ProjectFile("poses", here)
    elif {"command", "target", "move", "x_mm"} <= names:
        yield ProjectFile("commands", here)
    elif {"name", "x_mm"} <= names and any(name.startswith("joint_") for name in names):
        yield ProjectFile("measurements", here)


def _head(path: Path) -> str:
    with contextlib.suppress(OSError, LMeasureError), open_regular(path) as file:
        return file.read(_HEAD).decode("utf-8", "replace")
    return ""


def schema_of(path: Path) -> str:
    """The middle of lmeasure.KIND/1; empty where the file states none."""
    for line in _head(path).splitlines():
        key, mark, value = line.partition("=")
        if mark and key.strip() == "schema":
            return value.strip().strip("\"'").removeprefix("lmeasure.").split("/")[0].split("#")[0].strip("\"' ")
        if line.strip().startswith("["):
            break
    return ""


def _links(path: Path) -> bool:
    try:
        return "calibration" in loads(read_regular(path, LARGEST_TEXT).decode())
    except (LMeasureError, OSError, ValueError, RecursionError):
        return False


class Step(NamedTuple):
    """A step of the whole job: its name, its page, whether it is done, and its objects."""

    name: str
    page: str
    done: bool
    what: tuple[str, ...]


def steps(project: Project, checked: bool = False) -> tuple[Step, ...]:
    """The way from an empty folder to a verified certificate."""
    calibrated = project.calibrated()
    certificates = project.of("certificate")
    return (
        Step("rig", "/rig", bool(project.of("rig")), project.of("rig")[:1]),
        # a calibration without them makes them unnecessary
        Step("check", "/check", checked or bool(calibrated), ()),
        Step("plan", "/calibrate", bool(calibrated or project.of("poses") or project.of("calibration")), project.of("poses")[:1]),
        Step("calibrate", "/calibrate", bool(calibrated), calibrated[:1]),
        Step("zone", "/zone", bool(project.of("zone")), project.of("zone")[:1]),
        Step("measure", "/runs", bool(project.of("run")), project.of("run")[:1]),
        Step("certify", "/robot", bool(certificates), certificates[:1]),
        Step("verify", "/robot#verify", any(_sealed(project.folder / one) for one in certificates), ()),
    )


def following(way: Sequence[Step]) -> Step | None:
    """Return the step to take next: the first open one behind all that is done, else the first that is open; None where all is done."""
    last = max((i for i, step in enumerate(way) if step.done), default=-1)
    return next((step for step in (*way[last + 1 :], *way) if not step.done), None)


def _sealed(folder: Path) -> bool:
    """Return whether a certificate's folder has its manifest."""
    try:
        return bool(json.loads(read_regular(folder / "certificate.json", LARGEST_JSON)).get("characteristics"))
    except (LMeasureError, OSError, ValueError, RecursionError, AttributeError):
        return False
