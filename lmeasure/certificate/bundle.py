"""The folder of a certificate: its inputs and printed forms, under a manifest with the digest of each file.

    DIR/certificate.json, certificate.pdf, report.html, certificate.xml   the results, for machines and people
    DIR/inputs/...                                                        copies of all input files
    DIR/manifest.json                                                     size and SHA-256 of each of these files
    DIR/signature.json                                                    Ed25519 signature of manifest.json, if you gave a key

The .zip of a folder has the same bytes wherever it is made (stored, in order, without dates), so that it can be checked by making it again.
"""

import contextlib
import hashlib
import json
import os
import shutil
import stat
import zipfile
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any

from lmeasure.certificate.signature import canonical, digest, fingerprint, sign, signer
from lmeasure.core import CertificationError, FileFormatError, ForeignFolderError, LMeasureError
from lmeasure.io import files, open_zip, os_reason, unpack
from lmeasure.text import Message, composed, message

SCHEMA = "lmeasure.bundle/1"
MANIFEST = "manifest.json"
SIGNATURE = "signature.json"
CERTIFICATE = "certificate.json"
INPUTS = "inputs"
UNSIGNED = message("verification.unsigned")
CHUNK = 2**20


@dataclass(frozen=True)
class Difference:
    """A file of the bundle, or a result, and its difference."""

    what: str
    text: str

    def __str__(self) -> str:
        return str(self.line())

    def line(self) -> Message:
        """Return the line for a terminal."""
        return composed("{what}: {text}", what=self.what, text=self.text)


@contextmanager
def new_folder(out: Path, *, force: bool = False) -> Iterator[Path]:
    """Yield a folder under a temporary name beside `out`, which becomes `out` when the block ends without an error.

    ForeignFolderError when `out` is a file, or holds anything but an earlier certificate; also when it holds one and force is not given.

    At each instant `out` is absent, the earlier certificate or the new one, each whole, and a power failure leaves it so. Where the system
    cannot exchange two folders in one step, a kill between two renames leaves the earlier one as `.NAME.PROCESS.old`; then the next call
    for `out` gives it its name back.
    """
    out = Path(out)
    try:
        target = out.resolve()
        _recover(target)
        _claim(out, force=force)
    except OSError as error:
        raise CertificationError(files.not_written(out, error)) from error
    except ValueError as error:
        if isinstance(error, LMeasureError):
            raise
        raise CertificationError(message("error.cannot_be_written", out=str(out), error=error)) from error
    try:
        temporary = target.with_name(f".{target.name}.{os.getpid()}.part")
        files.make_folder(target.parent)
        try:
            temporary.mkdir()
            yield temporary
            _to_disk(temporary)
            _publish(temporary, target)
        finally:
            shutil.rmtree(temporary, ignore_errors=True)
    except OSError as error:
        raise CertificationError(files.not_written(out, error)) from error


def _publish(temporary: Path, target: Path) -> None:
    """Give a folder its name; the earlier content of that name keeps the temporary name."""
    if not target.exists() or not any(target.iterdir()):
        with contextlib.suppress(OSError):
            target.rmdir()
        temporary.rename(target)
    elif not files.exchange(temporary, target):
        old = temporary.with_suffix(".old")
        target.rename(old)
        try:
            temporary.rename(target)
        except OSError:
            old.rename(target)
            raise
        old.rename(temporary)
    files.to_disk(target.parent)


def _recover(target: Path) -> None:
    """Repair a folder after a killed process: earlier content gets its name back, unfinished content is removed."""
    for left in files.abandoned(target.parent):
        if left.name != target.name or not left.path.is_dir():
            continue
        if left.kind == "old" and not target.exists():
            left.path.rename(target)
            files.to_disk(target.parent)
        else:
            shutil.rmtree(left.path, ignore_errors=True)


def _to_disk(folder: Path) -> None:
    """Return when the disk has a folder with everything in it."""
    for path in [*folder.rglob("*"), folder]:
        files.to_disk(path)


def _claim(out: Path, *, force: bool) -> None:
    if out.is_symlink() or (out.exists() and not out.is_dir()):
        raise ForeignFolderError(message("error.is_not_a_folder", where=out))
    if out.is_dir() and any(out.iterdir()):
        known = _listed(out / MANIFEST)
        strange = sorted(found_files(out) - known - {MANIFEST, SIGNATURE}) if known else ["other files"]
        if strange:
            raise ForeignFolderError(message("error.holds_no_part_of", where=out, strange=strange[0]))
        if not force:
            raise ForeignFolderError(message("error.exists_force_replaces_the", where=out / MANIFEST))


def _listed(manifest: Path) -> set[str]:
    """Files of an earlier certificate; empty when it is none."""
    try:
        content = json.loads(manifest.read_bytes())
        return {entry["file"] for entry in content["files"]} if content["schema"] == SCHEMA else set()
    except (OSError, ValueError, KeyError, TypeError, RecursionError):
        return set()


def found_files(folder: Path) -> set[str]:
    """Everything in the folder that is not a folder, and folders without anything in them, by their names from it with slashes."""
    out = set()
    for path in Path(folder).rglob("*"):
        if path.is_symlink() or not path.is_dir() or not any(path.iterdir()):
            out.add(path.relative_to(folder).as_posix())
    return out


def copy_into(folder: Path, copies: dict[str, Path]) -> None:
    """Copy files to the places in the folder that are their keys. FileFormatError when one cannot be read, OSError when written."""
    for name, source in copies.items():
        target = folder / name
        target.parent.mkdir(parents=True, exist_ok=True)
        try:
            shutil.copyfile(source, target)
        except OSError:
            files.read_bytes(source)  # raises an error if this file was the missing one
            raise
        except ValueError as error:
            raise CertificationError(message("error.cannot_be_copied", where=source, error=error)) from error


def regular_bytes(path: Path) -> bytes:
    """The bytes of a regular file: a pipe, a device or a link is never opened, for it may never end. CertificationError names it."""
    _only_regular(path)
    return files.read_bytes(path)


def _only_regular(path: Path) -> None:
    try:
        mode = path.lstat().st_mode
    except (OSError, ValueError) as error:
        raise CertificationError(
            message("error.cannot_be_read", where=path, broken=os_reason(error) if isinstance(error, OSError) else error)
        ) from error
    if not stat.S_ISREG(mode):
        raise CertificationError(message("error.is_no_regular_file", where=path))


def entries(folder: Path, names: list[str]) -> list[dict[str, Any]]:
    """{file, bytes, sha256} of files of a folder, hashed side by side."""
    with ThreadPoolExecutor(max_workers=4) as pool:
        digests = list(pool.map(lambda name: files.sha256(folder / name), names))
    return [{"file": name, "bytes": (folder / name).stat().st_size, "sha256": value} for name, value in zip(names, digests, strict=True)]


def seal(folder: Path, certificate_id: str, known: list[dict[str, Any]], key: Any | None = None) -> None:
    """Write manifest.json over all files of the folder, and signature.json by an Ed25519 private key when one is given.

    known: `entries` that are there already.
    """
    have = {entry["file"]: entry for entry in known}
    missing = sorted(found_files(folder) - set(have) - {MANIFEST, SIGNATURE})
    have |= {entry["file"]: entry for entry in entries(folder, missing)}
    content: dict[str, Any] = {"schema": SCHEMA, "certificate": certificate_id, "files": [have[name] for name in sorted(have)]}
    content["sha256"] = digest(content)
    text = canonical(content)
    (folder / MANIFEST).write_bytes(text)
    if key is not None:
        (folder / SIGNATURE).write_bytes(canonical(sign(text, key)))


@dataclass(frozen=True)
class Seal:
    """Result of a check of every byte of a bundle. signer: fingerprint of the key that signed it, None without one."""

    differences: tuple[Difference, ...]
    signer: str | None
    certificate: str
    files: frozenset[str] = frozenset()
    """Files that the manifest names."""


def check_seal(folder: Path, public_key: Any | None = None) -> Seal:
    """Every file against the manifest, the manifest against itself, the signature against the manifest and the given key."""
    folder = Path(folder)
    if not folder.is_dir():
        raise CertificationError(message("error.is_no_folder_of", where=folder))
    found = found_files(folder)
    if not found & {MANIFEST, CERTIFICATE}:
        raise CertificationError(message("error.is_no_folder_of_a", where=folder, manifest=MANIFEST, certificate=CERTIFICATE))
    out: list[Difference] = []
    text, content = b"", None
    if MANIFEST in found:
        try:
            text = regular_bytes(folder / MANIFEST)
        except LMeasureError:
            out.append(Difference(MANIFEST, message("verification.no_regular_file")))
            return Seal(tuple(out), None, "")
        content = _manifest(text)
    if content is None:
        out.append(Difference(MANIFEST, message("verification.bytes_changed" if MANIFEST in found else "verification.missing")))
        listed = []
    else:
        listed = content["files"]
    signed_by = _check_signature(folder, found, text, public_key, out)
    out += _check_files(folder, found, listed) if content is not None else []
    named = frozenset(entry["file"] for entry in listed)
    return Seal(tuple(out), signed_by, "" if content is None else content["certificate"], named)


def _manifest(text: bytes) -> dict[str, Any] | None:
    """The manifest, None unless every byte of it is as `seal` writes it."""
    try:
        content = json.loads(text)
        stated = content.pop("sha256")
        if content["schema"] != SCHEMA or digest(content) != stated or canonical(content | {"sha256": stated}) != text:
            return None
        names = [entry["file"] for entry in content["files"]]
        # each file once, and never the files beside the manifest
        if set(content) != {"schema", "certificate", "files"} or names != sorted(set(names)) or {MANIFEST, SIGNATURE} & set(names):
            return None
        for entry in content["files"]:
            safe_name(entry["file"])
            if set(entry) != {"file", "bytes", "sha256"} or type(entry["bytes"]) is not int or not isinstance(entry["sha256"], str):
                return None
        return dict(content) if isinstance(content["certificate"], str) else None
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return None


def safe_name(name: str) -> str:
    """A name inside a folder; CertificationError when it leads elsewhere."""
    parts = PurePosixPath(name).parts
    if not parts or name != "/".join(parts) or ".." in parts or "\\" in name or ":" in name or name.startswith("/") or "\x00" in name:
        raise CertificationError(message("error.is_not_the_name", name=name))
    return name


def _check_signature(folder: Path, found: set[str], text: bytes, public_key: Any | None, out: list[Difference]) -> str | None:
    if SIGNATURE not in found:
        if public_key is not None:
            out.append(Difference(SIGNATURE, UNSIGNED))
        return None
    try:
        key = signer(text, regular_bytes(folder / SIGNATURE))
    except LMeasureError as error:
        out.append(Difference(SIGNATURE, str(error)))
        return None
    if public_key is not None and fingerprint(key) != fingerprint(public_key):
        out.append(
            Difference(SIGNATURE, message("verification.another_key", key=fingerprint(key)[:16], requested=fingerprint(public_key)[:16]))
        )
    return fingerprint(key)


def _check_files(folder: Path, found: set[str], listed: list[dict[str, Any]]) -> list[Difference]:
    names = {entry["file"] for entry in listed}
    out = [Difference(name, message("verification.missing")) for name in sorted(names - found)]
    out += [Difference(name, message("verification.added")) for name in sorted(found - names - {MANIFEST, SIGNATURE})]

    def check(entry: dict[str, Any]) -> str | None:
        path = folder / entry["file"]
        if path.is_symlink():
            return message("verification.link")
        if not stat.S_ISREG(path.stat().st_mode):
            return message("verification.no_regular_file")
        size = path.stat().st_size
        if size != entry["bytes"]:
            return message("verification.size_changed", size=size, stated=entry["bytes"])
        return None if files.sha256(path) == entry["sha256"] else message("verification.hash_changed")

    present = [entry for entry in listed if entry["file"] in found]
    with ThreadPoolExecutor(max_workers=4) as pool:
        reported = list(pool.map(check, present))
    return out + [Difference(entry["file"], text) for entry, text in zip(present, reported, strict=True) if text]


# --- the one .zip of a folder ---


def write_zip(path: Path, folder: Path) -> None:
    """Write the folder's .zip and, beside it, `path`.sha256 as sha256sum does; each whole or not at all."""
    with files.whole(path) as temporary:
        with temporary.open("wb") as out:
            for piece in zip_pieces(folder, sorted(found_files(folder))):
                out.write(piece)
        value = files.sha256(temporary)
    files.write_text(sidecar(path), f"{value}  {path.name}\n")


def sidecar(path: Path) -> Path:
    """Return the path of a .zip's digest."""
    return path.with_name(path.name + ".sha256")


@contextmanager
def opened_zip(path: Path, scratch: Path) -> Iterator[Path]:
    """The folder of a .zip, in the folder `scratch`, for as long as the block lasts.

    CertificationError refuses a zip that is not, byte for byte, the one its files give, or not the one of the digest beside it.
    """
    path = Path(path)
    _only_regular(path.resolve())
    actual = files.sha256(path)
    if sidecar(path).exists():
        words = regular_bytes(sidecar(path).resolve()).split()
        if not words or words[0] != actual.encode("ascii"):
            raise CertificationError(message("error.was_changed_its_sha", where=path, name=sidecar(path).name))
    folder = scratch / "bundle"
    try:
        folder.mkdir()
        names = _extract(path, folder)
        again = hashlib.sha256()
        for piece in zip_pieces(folder, names):
            again.update(piece)
    except OSError as error:
        if error.errno in files.TO_DO:
            raise CertificationError(files.not_written(scratch, error, "error.cannot_be_unpacked_there", name=path.name)) from None
        raise CertificationError(message("error.was_changed_or_is", where=path, error=error)) from None
    except FileFormatError as error:
        raise CertificationError(message("error.was_changed_or_is", where=path, error=error)) from None
    if again.hexdigest() != actual:
        raise CertificationError(message("error.was_changed_it_is", where=path))
    yield folder


def _extract(path: Path, folder: Path) -> list[str]:
    with open_zip(path) as archive:
        names = [safe_name(info.filename) for info in archive.infolist()]
        if names != sorted(set(names)):
            raise CertificationError(message("error.was_changed_its_files", where=path))
        # stored only, so that unpacked data cannot be larger than the zip
        if any(info.compress_type != zipfile.ZIP_STORED for info in archive.infolist()):
            raise CertificationError(message("error.was_changed_its_files_are", where=path))
        unpack(archive, folder)
    return names


class _Sink:
    """Writer for zipfile whose content a reader takes away in pieces; it cannot seek."""

    def __init__(self) -> None:
        self.pieces: list[bytes] = []

    def write(self, data: bytes) -> int:
        self.pieces.append(bytes(data))
        return len(data)

    def flush(self) -> None:
        """Nothing waits here."""

    def take(self) -> bytes:
        """All that was written since the last time."""
        out = b"".join(self.pieces)
        self.pieces.clear()
        return out


def zip_pieces(folder: Path, names: list[str]) -> Iterator[bytes]:
    """The bytes of the .zip of these files, in this order: stored, dated 1980-01-01, the same on every machine."""
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as archive:  # type: ignore[call-overload]
        for name in names:
            info = zipfile.ZipInfo(name)
            info.create_system, info.external_attr = 3, 0o100644 << 16
            with archive.open(info, "w", force_zip64=True) as out, (folder / name).open("rb") as source:
                while piece := source.read(CHUNK):
                    out.write(piece)
                    yield sink.take()
    yield sink.take()
