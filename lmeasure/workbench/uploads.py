"""Uploads into a project: files, a folder, a zip that is unpacked. All of it is taken in, or nothing."""

import contextlib
import re
import shutil
import tempfile
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError
from lmeasure.io import LARGEST_NAME, not_written, open_zip, unpack
from lmeasure.text import message
from lmeasure.workbench.guard import LARGEST_UPLOAD
from lmeasure.workbench.project import OutsideError

MOST_UNPACKED = 2**31
LEFT_FREE = 2**28
"""Bytes of the disk that unpacking leaves to others: a recording may be at work."""
_NAME = re.compile(r"[^\W.][\w .+()\-]{0,120}(?<![ .])", re.UNICODE)
DEVICES = re.compile(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", re.IGNORECASE)
"""Names that Windows keeps for devices."""
BY_PRODUCTS = re.compile(r"\.DS_Store|\._.*|__MACOSX|Thumbs\.db")
"""Names of files that systems create by themselves: they are ignored."""
Uploads = Sequence[tuple[str, Any]]
"""Names of files, and the files."""
_turn = threading.Lock()


def take_in(folder: Path, uploads: Uploads) -> list[Path]:
    """Copy uploaded files into a folder under their own names, and each .zip also, unpacked, into a folder of its name.

    Return the paths of the files. Existing files stay: OutsideError for a used name, for names not allowed in a project, and for too many
    bytes; FileFormatError for a wrong .zip. Then nothing is written.
    """
    with _staged(folder) as stage:
        names = [_plain(name) for name, _ in uploads]
        for name, (_, file) in zip(names, uploads, strict=True):
            copy = _copied(file, stage / name)
            if copy.suffix.lower() == ".zip":
                _unpacked(copy, stage / copy.stem)
        _publish(stage, folder)
    return [folder / name for name in names]


def take_in_folder(folder: Path, uploads: Uploads) -> None:
    """Copy the files of folders that were dropped into a folder, under their names in them. Errors as `take_in`."""
    with _staged(folder) as stage:
        for name, file in uploads:
            if inner := _inner(name):
                (stage / inner).parent.mkdir(parents=True, exist_ok=True)
                _copied(file, stage / inner)
        _publish(stage, folder)


@contextmanager
def _staged(folder: Path) -> Iterator[Path]:
    """Yield a hidden folder in a folder; where the block fails, neither is left that was not there."""
    made = [one for one in (folder, *folder.parents) if not one.exists()]
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = Path(tempfile.mkdtemp(".part", ".upload-", folder))
        try:
            yield stage
        finally:
            shutil.rmtree(stage, ignore_errors=True)
    except BaseException as error:
        for one in made:
            with contextlib.suppress(OSError):
                one.rmdir()
        if isinstance(error, OSError):
            raise LMeasureError(not_written(folder, error)) from error
        raise


def _publish(stage: Path, folder: Path) -> None:
    """Move the staged files to their names in the folder, each by one rename; all of them or none."""
    with _turn:
        staged = sorted(stage.iterdir())
        for one in staged:
            if (folder / one.name).exists() or (folder / one.name).is_symlink():
                raise OutsideError(message("error.is_there_already_and_stays", where=one.name))
        done: list[Path] = []
        try:
            for one in staged:
                done.append(one.rename(folder / one.name))
        except BaseException:
            for one in done:
                one.rename(stage / one.name)
            raise


def _plain(name: str) -> str:
    plain = name.replace("\\", "/").rpartition("/")[2]
    if not _is_name(plain):
        raise OutsideError(message("error.a_file_of_that", plain=plain[:200]))
    return plain


def _is_name(part: str) -> bool:
    return bool(_NAME.fullmatch(part)) and not DEVICES.fullmatch(part) and len(part.encode("utf-8", "replace")) <= LARGEST_NAME


def _inner(name: str) -> str:
    """Return the name of a file in a folder; empty for a by-product, which is ignored. OutsideError for paths that lead elsewhere, and for
    hidden files."""
    parts = name.split("/")
    if any(BY_PRODUCTS.fullmatch(part) for part in parts) and not {"", ".", ".."} & set(parts):
        return ""
    if not all(_is_name(part) for part in parts):
        raise OutsideError(message("error.a_file_of_that", plain=name[:200]))
    return name


def _unpacked(packed: Path, folder: Path) -> None:
    most = min(MOST_UNPACKED, max(shutil.disk_usage(packed.parent).free - LEFT_FREE, 0))
    with open_zip(packed, most) as archive:
        names = [inner for entry in archive.infolist() if not entry.is_dir() and (inner := _inner(entry.filename))]
        # a zip of a folder holds that folder
        top = names[0].split("/")[0] + "/" if names else ""
        top = top if all(name.startswith(top) for name in names) else ""
        if folder.exists():
            raise OutsideError(message("error.comes_twice", where=folder.name))
        folder.mkdir()
        unpack(archive, folder, lambda name: _inner(name).removeprefix(top))


def _copied(file: Any, target: Path) -> Path:
    taken = 0
    try:
        with target.open("xb") as sink:
            while block := file.read(2**20):
                taken += len(block)
                if taken > LARGEST_UPLOAD:
                    raise OutsideError(message("error.is_larger_than_gib", where=target.name, largest_upload=LARGEST_UPLOAD / 2**30))
                sink.write(block)
    except FileExistsError:
        raise OutsideError(message("error.comes_twice", where=target.name)) from None
    return target
