"""Safe opening of inputs: regular files only, of a sensible size, and .zip files whose every entry is such a file."""

import errno
import hashlib
import os
import re
import shutil
import stat
import struct
import unicodedata
import zipfile
import zlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path, PurePosixPath
from typing import IO, BinaryIO, cast

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.text import composed, message

LARGEST_BYTES = 1 << 33
"""Largest file read as a whole: more than an hour of counts, less than the memory of any machine for it."""

MOST_ENTRIES = 10_000
DIRECTORY_BYTES = 1 << 22
"""Largest directory of a .zip, which is read as a whole before anything else."""
LARGEST_NAME = 255
"""Bytes of the name of a file or folder, on most systems."""
LOCAL_HEADER = 30  # bytes before the name of an entry
PIECE = 1 << 20
_NO_NAME = re.compile(r'[\x00-\x1f\x7f\\:*?"<>|]')
"""Characters that no name of an entry has, on any system."""


_KNOWN = {
    errno.ENOENT: "missing",
    errno.ENOTDIR: "not_a_folder",
    errno.EISDIR: "is_a_folder",
    errno.EACCES: "no_permission",
    errno.EPERM: "no_permission",
    errno.EEXIST: "exists",
    errno.ENOSPC: "full",
    errno.EROFS: "read_only",
    errno.EADDRINUSE: "address_in_use",
}


def os_reason(error: OSError) -> str:
    """Return why the system refused, in the reader's language where the catalogue has it."""
    known = _KNOWN.get(error.errno or 0)
    return message(f"os.{known}") if known else os.strerror(error.errno) if error.errno else " ".join(str(error).split())


def open_regular(path: Path) -> BinaryIO:
    """Return the file opened for reading bytes. FileFormatError for other kinds: a pipe would block, a device never ends."""
    path = Path(path)
    try:
        # a pipe without a writer would hold up the opening itself
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0) | getattr(os, "O_NOCTTY", 0))
    except OSError as error:
        raise FileFormatError(message("error.cannot_be_read", where=path, broken=os_reason(error))) from error
    except ValueError as error:  # a zero byte in the name
        raise FileFormatError(message("error.cannot_be_read_2", path=str(path), error=error)) from error
    mode = os.fstat(number).st_mode
    if not stat.S_ISREG(mode):
        os.close(number)
        own_rig = (Path(path) / "rig.toml").is_file()
        what = "os.pipe" if not stat.S_ISDIR(mode) else "os.folder_with_rig" if own_rig else "os.folder"
        raise FileFormatError(message("error.cannot_be_read", where=path, broken=message(what)))
    return os.fdopen(number, "rb")


def no_folder(path: Path, holds: str) -> str:
    """Return the rest of the message that a path is no folder of a kind: it does not exist, or is a file of such a folder, or something
    else."""
    if not path.exists():
        return message("os.no_folder")
    if (path.parent / holds).is_file():
        return message("os.file_in_folder", folder=path.parent)
    return message("os.folder_holds", name=holds)


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of a file of any size, opened as `open_regular` does."""
    with open_regular(path) as file:
        try:
            return hashlib.file_digest(cast(BufferedReader, file), "sha256").hexdigest()
        except OSError as error:
            raise FileFormatError(message("error.cannot_be_read", where=path, broken=os_reason(error))) from error


def inside(folder: Path, name: str, what: str, place: str) -> Path:
    """The path of the name that a file states, in its folder or below; FileFormatError where it leads out of it, by links too."""
    try:
        stays = (folder / name).resolve().is_relative_to(folder.resolve())
    except (ValueError, OSError, RuntimeError) as error:  # a zero byte; links that lead in a circle
        raise FileFormatError(message("error.is_not_the_name_of", what=what, name=name, error=error)) from error
    if not stays:
        raise FileFormatError(message("error.lies_outside", what=what, name=name, place=place))
    return folder / name


def read_regular(path: Path, most: int = LARGEST_BYTES) -> bytes:
    """The file's bytes, as `open_regular`; FileFormatError where there are more than `most`."""
    with open_regular(path) as file:
        size = os.fstat(file.fileno()).st_size
        if size > most:
            raise FileFormatError(message("error.cannot_be_read_bytes", where=path, size=size, most=most))
        try:
            return file.read()
        except OSError as error:
            raise FileFormatError(message("error.cannot_be_read", where=path, broken=os_reason(error))) from error


class _Bounded:
    """A file that is not read by more than DIRECTORY_BYTES at once."""

    def __init__(self, file: BinaryIO) -> None:
        self._file = file
        self.seek, self.tell, self.seekable = file.seek, file.tell, file.seekable

    def read(self, size: int = -1) -> bytes:
        data = self._file.read(DIRECTORY_BYTES + 1 if size < 0 or size > DIRECTORY_BYTES else size)
        if len(data) > DIRECTORY_BYTES:
            raise zipfile.BadZipFile(message("zip.too_many_entries"))
        return data


@contextmanager
def open_zip(path: Path, most: int = LARGEST_BYTES) -> Iterator[zipfile.ZipFile]:
    """Yield the archive of a .zip whose entries are regular files and folders, inside it, each under a name of its own.

    FileFormatError, in one line, for any other .zip, for one of more than MOST_ENTRIES entries or `most` bytes in all, and for archives
    found in the block to be encrypted, compressed by another method than deflation, or garbled.
    """
    try:
        with open_regular(path) as file, zipfile.ZipFile(cast(IO[bytes], _Bounded(file))) as archive:
            _check_entries(archive, most)
            yield archive
    except LMeasureError:
        raise
    except (zipfile.BadZipFile, NotImplementedError, RuntimeError, EOFError, ValueError, OverflowError, zlib.error, struct.error) as error:
        reason = " ".join(str(error).split())[:200] or type(error).__name__
        raise FileFormatError(message("error.is_not_a_zip", where=path.name, reason=reason)) from error


def unpack(archive: zipfile.ZipFile, folder: Path, name_of: Callable[[str], str] = str) -> None:
    """Write the files of an archive from `open_zip` into a folder, each under the name that `name_of` gives its own; none where that is
    empty."""
    for entry in archive.infolist():
        if entry.is_dir() or not (name := name_of(entry.filename)):
            continue
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        with archive.open(entry) as source, target.open("xb") as sink:
            shutil.copyfileobj(source, sink, PIECE)
            if sink.tell() != entry.file_size:
                raise zipfile.BadZipFile(message("zip.other_size", name=repr(entry.filename), found=sink.tell(), stated=entry.file_size))


def _check_entries(archive: zipfile.ZipFile, most: int) -> None:
    entries = archive.infolist()
    if len(entries) > MOST_ENTRIES:
        raise zipfile.BadZipFile(message("zip.entries", found=len(entries), most=MOST_ENTRIES))
    if (total := sum(entry.file_size for entry in entries)) > most:
        raise zipfile.BadZipFile(message("zip.bytes", found=total, most=most))
    for entry in entries:
        if (wrong := _wrong(entry)) is not None:
            raise zipfile.BadZipFile(composed("{name} {wrong}", name=repr(entry.filename), wrong=wrong))
    end, files, folders = archive.start_dir, set[str](), set[str]()
    for entry in sorted(entries, key=lambda entry: entry.header_offset, reverse=True):
        # the same bytes would serve for many files, and a small zip unpack to a huge one
        needs = LOCAL_HEADER + len(entry.orig_filename) + entry.compress_size
        if entry.header_offset < 0 or entry.header_offset + needs > end:
            raise zipfile.BadZipFile(message("zip.overlaps", name=repr(entry.filename)))
        end = entry.header_offset
        path = PurePosixPath(entry.filename)
        folders |= {_alike(above) for above in (path.parents if not entry.is_dir() else (path, *path.parents))}
        if not entry.is_dir() and _alike(path) in files:
            raise zipfile.BadZipFile(message("zip.twice", name=repr(entry.filename)))
        files |= set() if entry.is_dir() else {_alike(path)}
    if both := sorted(files & folders):
        raise zipfile.BadZipFile(message("zip.file_and_folder", name=repr(both[0])))


def _wrong(entry: zipfile.ZipInfo) -> str | None:
    """Return the reason why an entry is no file or folder inside the archive; None without one."""
    parts = entry.filename.removesuffix("/").split("/")
    if any(part in ("", ".", "..") or _NO_NAME.search(part) or len(part.encode("utf-8", "replace")) > LARGEST_NAME for part in parts):
        return message("zip.no_name")
    if len(entry.filename) > 1000:
        return message("zip.long_name")
    if stat.S_IFMT(entry.external_attr >> 16) not in (0, stat.S_IFREG, stat.S_IFDIR):
        return message("zip.not_regular")
    if entry.flag_bits & 0x41:
        return message("zip.encrypted")
    if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
        return message("zip.method", method=entry.compress_type)
    if entry.compress_type == zipfile.ZIP_STORED and entry.file_size != entry.compress_size:
        return message("zip.two_sizes")
    return None


def _alike(path: PurePosixPath) -> str:
    """Return a path in the form of a system without capitals."""
    return unicodedata.normalize("NFC", str(path)).casefold()
