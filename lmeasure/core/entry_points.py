"""Kinds that other installed packages add, each an object behind an entry point of one of `GROUPS`.

Entry points are read for a name or suffix that is not this program's own, or for a list of all; other commands lose no time. A package that
cannot be loaded stops only the commands that need it.
"""

import importlib.metadata
import sys
import traceback
from functools import cache
from importlib.metadata import PackageNotFoundError, requires, version
from importlib.util import find_spec
from pathlib import Path
from typing import TypeVar

from lmeasure.core.errors import LMeasureError

GROUPS = ("lmeasure.sensors", "lmeasure.log_formats", "lmeasure.robot_programs", "lmeasure.characteristics")
Kind = TypeVar("Kind")
_in_use: list[tuple[str, str]] = []


class PlugInError(LMeasureError):
    """Another package's kind cannot be used; the text names the package."""


@cache
def _entries(group: str) -> dict[str, importlib.metadata.EntryPoint]:
    """Entry points by name, in alphabetical order."""
    return {entry.name: entry for entry in sorted(importlib.metadata.entry_points(group=group), key=lambda entry: entry.name)}


def _source(entry: importlib.metadata.EntryPoint) -> str:
    """Name a package and its version as it was installed."""
    return "package unknown" if entry.dist is None else f"package {entry.dist.name} {entry.dist.version}"


@cache
def _loaded(group: str, name: str) -> "object | PlugInError":
    """Return the object of an entry point, or its error."""
    entry = _entries(group)[name]
    sources = sorted(_source(one) for one in importlib.metadata.entry_points(group=group, name=name))
    if len(sources) > 1:
        return PlugInError(f"{name}: {' and '.join(sources)} both add it; remove one of them")
    try:
        return entry.load()
    except (Exception, SystemExit) as error:
        return PlugInError(f"{_source(entry)}: {name} ({entry.value}) cannot be loaded: {type(error).__name__}: {error}")


def _kind(group: str, name: str, kind: type[Kind]) -> Kind | PlugInError:
    """Return the object of an entry point if it is of that kind, or its error."""
    found, entry = _loaded(group, name), _entries(group)[name]
    if not isinstance(found, PlugInError):
        _in_use.append((group, name))
    if isinstance(found, kind | PlugInError):
        return found
    return PlugInError(f"{_source(entry)}: {name} ({entry.value}) is a {type(found).__name__} and no {kind.__name__}")


def plug_in(group: str, name: str, kind: type[Kind]) -> Kind | None:
    """Return the kind that an entry point of a group names; None where no package has one.

    Raises
    ------
    PlugInError
        If it cannot be loaded, or is something else.
    """
    found = _kind(group, name, kind) if name in _entries(group) else None
    if isinstance(found, PlugInError):
        raise found
    return found


def plug_in_names(group: str) -> tuple[str, ...]:
    """Return the names of a group's entry points, without loading them."""
    return tuple(_entries(group))


def plug_ins(group: str, kind: type[Kind]) -> tuple[dict[str, Kind], str]:
    """Return all kinds of a group that can be loaded, by name, and a text on the others that may follow a message; empty without any."""
    found = {name: _kind(group, name, kind) for name in _entries(group)}
    broken = [f"; {one}" for one in found.values() if isinstance(one, PlugInError)]
    return {name: one for name, one in found.items() if not isinstance(one, PlugInError)}, "".join(broken)


def plug_in_version(group: str, name: str) -> str:
    """Return name and version of the package that an entry point comes from; "none" without one."""
    entry = _entries(group).get(name)
    return "none" if entry is None else _source(entry).removeprefix("package ")


def check_kind(suffixes: object, *functions: object) -> None:
    """Check what a kind states of itself, so that a package that states something else is found when it is loaded.

    Raises
    ------
    TypeError
        If suffixes are no tuple of texts such as ".log", in small letters, or a function is none.
    """
    stated = suffixes if isinstance(suffixes, tuple) else (None,)
    if not all(isinstance(one, str) and one[:1] == "." and one == one.lower() for one in stated):
        raise TypeError(f'suffixes must be a tuple of texts such as ".log", in small letters, not {suffixes!r}')
    if wrong := [one for one in functions if not callable(one)]:
        raise TypeError(f"{wrong[0]!r} is no function. Give a function")


def plug_in_of(error: BaseException) -> str:
    """Return the package in whose code an exception was raised, as far as it adds a kind; empty where it is this program's own code."""
    modules = [frame.f_globals.get("__name__", "").partition(".")[0] for frame, _ in traceback.walk_tb(error.__traceback__)]
    entries = [entry for group in GROUPS for entry in _entries(group).values()]
    tops = {entry.module.partition(".")[0]: entry for entry in entries}
    return next((_source(tops[name]) for name in reversed(modules) if name in tops and name != "lmeasure"), "")


def plug_ins_in_use() -> str:
    """Return a text that names the packages whose kinds this process has loaded; empty without any."""
    used = dict.fromkeys(_source(_entries(group)[name]) for group, name in _in_use)
    return f" (in use: {', '.join(used)})" if used else ""


def version_of(name: str) -> str:
    """Return the version of an installed package; "unknown" if its metadata were removed, as packagers do."""
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


def how_to_install(extra: str) -> str:
    """Return the command that installs an extra: from this program's folder, since no index has it, or without one the packages
    themselves."""
    installs = _installer()
    folder = Path(__file__).resolve().parents[2]
    if (folder / "pyproject.toml").is_file():
        return f"{installs} '{folder}[{extra}]'"
    try:
        stated = [text.replace("'", '"').partition(";") for text in requires("lmeasure") or []]
    except PackageNotFoundError:
        stated = []
    wanted = [package.strip() for package, _, condition in stated if condition.endswith(f'extra == "{extra}"')]
    return f"{installs} " + " ".join(f"'{text}'" for text in wanted) if wanted else f"install lmeasure with its extra {extra}"


def _installer() -> str:
    """Return the installer of the running environment: the `pip` of the path may belong to another, and uv makes environments without
    one."""
    if find_spec("pip") is None:
        return f"uv pip install --python {sys.executable}"
    return f"{sys.executable} -m pip install"
