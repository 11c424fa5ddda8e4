"""Store of a batch: a folder, or a place that fsspec reaches, where each result arrives whole or not at all."""

import hashlib
import os
import shutil
import socket
import tempfile
import uuid
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import Any

from lmeasure.core import LMeasureError, how_to_install
from lmeasure.text import message

PARTS = ".parts"
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
        own = self.folder / PARTS / f"{socket.gethostname()}-{os.getpid()}-{uuid.uuid4().hex}"
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
        """Raise StoreError in one line for whatever the package of a remote place raises."""
        try:
            yield
        except Exception as error:
            why = " ".join(str(error).split()) or type(error).__name__
            raise StoreError(message("error.store_out_of_reach", where=self.place, why=why)) from None

    def swept(self) -> None:
        """Remove what workers of this machine that live no more have left unfinished."""
        host = socket.gethostname()
        for left in () if self.folder is None else (self.folder / PARTS).glob(f"{host}-*-*"):
            pid = left.name.rsplit("-", 2)[1]
            if pid.isdecimal() and not _lives(int(pid)):
                shutil.rmtree(left, ignore_errors=True)
        with suppress(OSError):
            if self.folder is not None:
                (self.folder / PARTS).rmdir()


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
