"""Several projects: the folders of one folder that was stated when the workbench was begun."""

import datetime
import re
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple, Protocol

from lmeasure.core import LMeasureError
from lmeasure.io import os_reason
from lmeasure.text import Message, message, reason
from lmeasure.workbench.project import OWN, OutsideError
from lmeasure.workbench.uploads import DEVICES

REGISTER = "register"
"""Folder of a project's register."""
_NAME = re.compile(r"[^\W_][\w .+\-]{0,59}", re.UNICODE)
LISTED = 50


class Opener(Protocol):
    """Server of projects."""

    def address(self, folder: Path, shelf: "Shelf") -> str:
        """Return the address of a project, serving it from now on if needed."""

    def is_open(self, folder: Path) -> bool:
        """Return whether a project is open."""


class Beside(NamedTuple):
    """A project of the shelf: its name, its last use (seconds since 1970, 0 for never), whether it is open, due work in its register, and
    whether any of that is overdue."""

    name: str
    used_s: float
    is_open: bool
    due: tuple[Message, ...] = ()
    overdue: bool = False


@dataclass(frozen=True)
class Shelf:
    """The folder of projects, and their servers."""

    folder: Path
    desk: Opener

    def projects(self) -> list[Beside]:
        """Those that there are: the overdue ones first, then the one that was last worked on."""
        found = [Beside(path.name, _used(path), self.desk.is_open(path)) for path in self.folder.iterdir() if _plain(path)]
        first = sorted(found, key=lambda one: (-one.used_s, one.name))[:LISTED]
        listed = [Beside(*one[:3], *_due(self.folder / one.name)) for one in first]
        return sorted(listed, key=lambda one: not one.overdue)

    def path(self, name: str) -> Path:
        """The folder of a name; OutsideError for a name that is none, or leads elsewhere."""
        if not _NAME.fullmatch(name) or name != name.strip(" .") or DEVICES.fullmatch(name):
            raise OutsideError(message("error.is_no_name_of", name=name))
        path = self.folder / name
        if path.is_symlink():
            raise OutsideError(message("error.leads_elsewhere", where=name))
        return path

    def begin(self, name: str) -> Path:
        """Make the folder of a new project; OutsideError as `path`, and for one that is there."""
        path = self.path(name)
        try:
            path.mkdir()
        except FileExistsError:
            raise OutsideError(message("error.is_there_already_open", where=name)) from None
        except OSError as error:
            raise OutsideError(message("error.cannot_be_made", where=name, error=os_reason(error))) from error
        return path


def _due(folder: Path) -> tuple[tuple[Message, ...], bool]:
    """Return the lines of due work in the register of a project, and whether any is overdue; empty without one."""
    from lmeasure.register import FILE, Register, due, read_limits

    place = folder / REGISTER
    if place.is_symlink() or not (place / FILE).is_file():
        return (), False
    today = datetime.date.today()
    try:
        register = Register(place)
        try:
            found, kinds = due(register, read_limits(place)), [one.documents for one in register.subjects()]
        finally:
            register.close()
    except (LMeasureError, OSError, ValueError) as error:
        return (message("workbench.register_unreadable", why=reason(error)),), True
    lines = tuple(one.said(today) for one in found)
    return lines or (message("workbench.register_has", count=sum(kinds)),), any(one.overdue(today) for one in found)


def _plain(path: Path) -> bool:
    return _NAME.fullmatch(path.name) is not None and path.is_dir() and not path.is_symlink()


def _used(path: Path) -> float:
    try:
        return max(p.stat().st_mtime for p in ((path / OWN), (path / OWN / "jobs")) if p.exists())
    except (OSError, ValueError):
        return 0.0
