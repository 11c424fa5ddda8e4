"""Opening what is to be read: regular files only, and none larger than makes sense."""

import hashlib
import os
import stat
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO, cast

from lmeasure.errors import FileFormatError

LARGEST_BYTES = 1 << 33
"""Of a file that is read as a whole: more than an hour of counts, less than any memory it is read on could bear."""


def open_regular(path: Path) -> BinaryIO:
    """The file opened for reading bytes. FileFormatError for what is none: a pipe would be waited for, a device never ends."""
    path = Path(path)
    try:
        # a pipe without a writer would hold up the opening itself
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0))
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from error
    except ValueError as error:  # a zero byte in the name
        raise FileFormatError(f"{str(path)!r}: cannot be read: {error}") from error
    mode = os.fstat(number).st_mode
    if not stat.S_ISREG(mode):
        os.close(number)
        inside_it = "rig.toml in it, perhaps" if (Path(path) / "rig.toml").is_file() else "a file is wanted"
        what = f"Is a directory; {inside_it}" if stat.S_ISDIR(mode) else "it is no regular file but a pipe or a device; copy it into a file"
        raise FileFormatError(f"{path}: cannot be read: {what}")
    return os.fdopen(number, "rb")


def no_folder(path: Path, holds: str) -> str:
    """What to say behind that a path is no folder of a kind: it is not there, or a file of one that holds such a file, or something
    else."""
    if not path.exists():
        return ": it is not there"
    if (path.parent / holds).is_file():
        return f", but a file in one: give {path.parent}"
    return f", which holds {holds}"


def sha256_of(path: Path) -> str:
    """Hexadecimal SHA-256 of a regular file of any size."""
    with open_regular(path) as file:
        return hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest()


def inside(folder: Path, name: str, what: str, place: str) -> Path:
    """The path of the name that a file states, in its folder or below; FileFormatError where it leads out of it, by links too."""
    try:
        stays = (folder / name).resolve().is_relative_to(folder.resolve())
    except (ValueError, OSError, RuntimeError) as error:  # a zero byte; links that lead in a circle
        raise FileFormatError(f"{what} = {name!r} is not the name of a file: {error}") from error
    if not stays:
        raise FileFormatError(f"{what} = {name!r} lies outside {place}")
    return folder / name


def read_regular(path: Path, most: int = LARGEST_BYTES) -> bytes:
    """The file's bytes, as `open_regular`; FileFormatError where there are more than `most`."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise FileFormatError(f"{path}: cannot be read: {size} bytes, {most} are the most")
        try:
            return file.read()
        except OSError as error:
            raise FileFormatError(f"{path}: cannot be read: {error.strerror or error}") from error
