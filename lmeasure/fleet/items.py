"""Items of a batch: folders and files by their names or a pattern, or the rows of a table."""

import csv
import glob
import io
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from urllib.parse import quote

from lmeasure.core import FileFormatError, SettingsError
from lmeasure.io import decoded, open_regular, read_regular
from lmeasure.text import message

UNKNOWN = "unknown"
"""Robot or day of an item that nobody stated."""
SAFE = " !#$&'()+,;@[]^`{}~"
PARTS = ("name", "robot", "day")
LARGEST_TABLE, LARGEST_HEADER = 1 << 28, 1 << 16


@dataclass(frozen=True)
class Item:
    """One thing to do: its name, unique within a robot and day, and the options that are its own."""

    name: str
    robot: str = UNKNOWN
    day: str = UNKNOWN
    options: dict[str, str] = field(default_factory=dict)

    @property
    def place(self) -> str:
        """Return where its results are in a store: the partition, and the name."""
        return f"robot={_as_folder(self.robot)}/day={_as_folder(self.day)}/{_as_folder(self.name)}"


def _as_folder(text: str) -> str:
    """Return a text as a folder's name: what separates folders, or means another one, is written as %XX."""
    quoted = quote(text, safe=SAFE)
    return quoted.replace(".", "%2E") if set(text) <= {"."} else quoted


def read_items(places: Sequence[str], subject: str, folders: str = "") -> tuple[Item, ...]:
    """Return the items of a batch in the order of their places.

    Parameters
    ----------
    places
        Folders, files, patterns such as `runs/*/day-*`, and tables (.csv) with a column named as the subject. A folder that holds
        only folders stands for these.
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
    out = [_item(path, given, subject, pattern, folders) for path, given in zip(whole, paths, strict=True)]
    if folders or len({(item.robot, item.day, item.name) for item in out}) == len(out) or len(set(whole)) < len(whole):
        return out
    depth = next(d for d in range(2, 256) if len({path.parts[-d:] for path in whole}) == len(whole))
    return [replace(item, name="-".join((*path.parts[-depth:-1], item.name))) for path, item in zip(whole, out, strict=True)]


def _item(path: Path, given: Path, subject: str, pattern: re.Pattern[str] | None, folders: str) -> Item:
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
    """Return what finds robot, day and name at the end of a path."""
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
