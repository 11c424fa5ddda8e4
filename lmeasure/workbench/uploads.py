"""What is brought into a project: files, a folder, a zip that is unpacked; names that lead elsewhere are refused."""

import re
import zipfile
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from lmeasure.files import whole
from lmeasure.workbench.project import OutsideError

LARGEST_UPLOAD = 2**31
MOST_UNPACKED = 2**31
_NAME = re.compile(r"[^\W.][\w .+()\-]{0,120}", re.UNICODE)
DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices."""


def take_in(folder: Path, name: str, file: Any, *, unpacked: bool = False) -> Path:
    """Copy an uploaded file into the folder under its own name; unpacked: a zip also into a folder of its name. What is there stays. The
    path of the copy; OutsideError for names that lead elsewhere, and for too much."""
    plain = Path(name.replace("\\", "/")).name
    if not _NAME.fullmatch(plain) or DEVICES.fullmatch(plain):
        raise OutsideError(f"{plain!r}: a file of that name is not taken in")
    target = folder / plain
    if target.exists() or target.is_symlink():
        raise OutsideError(f"{plain}: is there already, and stays")
    with whole(target) as part, part.open("wb") as sink:
        _copied(file, sink, plain)
    if unpacked and plain.lower().endswith(".zip"):
        try:
            _unpack(target, folder / Path(plain).stem)
        except (OutsideError, zipfile.BadZipFile):
            target.unlink()
            raise
    return target


def take_in_folder(folder: Path, uploads: Sequence[tuple[str, Any]]) -> None:
    """Copy the files of a folder that was dropped, under their names in it. OutsideError as `take_in`."""
    for name, file in uploads:
        *above, plain = name.split("/")
        if "\\" in name or any(not _inner(part) for part in (*above, plain)):
            raise OutsideError(f"{name!r}: a file of that name is not taken in")
        target = folder.joinpath(*above, plain)
        if target.exists() or target.is_symlink():
            raise OutsideError(f"{name}: is there already, and stays")
        with whole(target) as part, part.open("wb") as sink:
            _copied(file, sink, name)


def _unpack(packed: Path, folder: Path) -> None:
    if folder.exists():
        raise OutsideError(f"{folder.name}: is there already, and stays")
    with zipfile.ZipFile(packed) as held:
        entries = [entry for entry in held.infolist() if not entry.is_dir()]
        if sum(entry.file_size for entry in entries) > MOST_UNPACKED or len(entries) > 5000:
            raise OutsideError(f"{packed.name}: holds too much")
        names = [entry.filename for entry in entries]
        # a zip of a folder holds that folder
        top = names[0].split("/")[0] + "/" if names and all("/" in n and n.split("/")[0] == names[0].split("/")[0] for n in names) else ""
        for name in names:
            parts = name.split("/")
            if "\\" in name or name.startswith("/") or any(not _inner(part) for part in parts):
                raise OutsideError(f"{packed.name}: {name!r}: a file of that name is not unpacked")
        for entry in entries:
            target = folder / entry.filename.removeprefix(top)
            target.parent.mkdir(parents=True, exist_ok=True)
            with held.open(entry) as source, target.open("xb") as sink:
                while block := source.read(2**20):
                    sink.write(block)


def _inner(part: str) -> bool:
    # certificates keep which command wrote what in a file with a dot before its name
    return bool(_NAME.fullmatch(part.lstrip(".") or "?")) and part not in (".", "..") and not DEVICES.fullmatch(part)


def _copied(file: Any, sink: Any, name: str) -> None:
    taken = 0
    while block := file.read(2**20):
        taken += len(block)
        if taken > LARGEST_UPLOAD:
            raise OutsideError(f"{name}: is larger than {LARGEST_UPLOAD / 2**30:g} GiB")
        sink.write(block)
