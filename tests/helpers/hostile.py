"""Files and requests that were made to do harm: what tests of the workbench send it."""

import io
import os
import stat
import struct
import warnings
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet

DIGITS = "9" * 5000
LONG = "n" * 300


def packed(*entries: tuple[str | zipfile.ZipInfo, bytes], method: int = zipfile.ZIP_DEFLATED) -> bytes:
    """A zip of these entries, which may come twice."""
    held = io.BytesIO()
    with warnings.catch_warnings(), zipfile.ZipFile(held, "w", method) as archive:
        warnings.simplefilter("ignore")
        for name, content in entries:
            archive.writestr(name, content)
    return held.getvalue()


GOOD = ("fine/a.csv", b"time_s,c1\n0,1\n" * 50)
"""Comes first: what is left of a zip that is refused is seen."""


def changed(raw: bytes, at_local: int, at_central: int, kind: str, value: int) -> bytes:
    """The zip with another value in the header of its last entry and in the list of entries."""
    out = bytearray(raw)
    struct.pack_into(kind, out, out.rindex(b"PK\x03\x04") + at_local, value)
    struct.pack_into(kind, out, out.rindex(b"PK\x01\x02") + at_central, value)
    return bytes(out)


def entry(name: str, mode: int) -> zipfile.ZipInfo:
    """An entry that is a file of that kind."""
    info = zipfile.ZipInfo(name)
    info.create_system, info.external_attr = 3, (mode | 0o777) << 16
    return info


def garbled() -> bytes:
    """Its deflated bytes are no deflated bytes."""
    raw = bytearray(packed(GOOD, ("b.csv", os.urandom(200).hex().encode() * 20)))
    at = raw.rindex(b"PK\x03\x04") + 60
    raw[at : at + 200] = b"\xff" * 200
    return bytes(raw)


def overlapping(count: int = 500) -> bytes:
    """One file of a megabyte under many names."""
    raw = packed(("a000", bytes(1_000_000)))
    at, end = raw.index(b"PK\x01\x02"), raw.index(b"PK\x05\x06")
    entries = b"".join(raw[at:end].replace(b"a000", b"a%03d" % i) for i in range(count))
    return raw[:at] + entries + raw[end : end + 8] + struct.pack("<HHLL", count, count, len(entries), at) + raw[end + 20 :]


def bomb(size: int, stated: int | None = None) -> bytes:
    """Zeros of that size, deflated; stated: what it says that it holds."""
    deflate = zlib.compressobj(9, zlib.DEFLATED, -15)
    block, out, crc = bytes(2**20), io.BytesIO(), 0
    for _ in range(size // 2**20):
        out.write(deflate.compress(block))
        crc = zlib.crc32(block, crc)
    data, said = out.getvalue() + deflate.flush(), size if stated is None else stated
    name = b"zeros.csv"
    local = struct.pack("<4sHHHHHLLLHH", b"PK\x03\x04", 20, 0, 8, 0, 33, crc, len(data), said, len(name), 0) + name + data
    listed = (
        struct.pack("<4sHHHHHHLLLHHHHHLL", b"PK\x01\x02", 20, 20, 0, 8, 0, 33, crc, len(data), said, len(name), 0, 0, 0, 0, 0, 0) + name
    )
    return local + listed + struct.pack("<4sHHHHLLH", b"PK\x05\x06", 0, 0, 1, 1, len(listed), len(local), 0)


def zips() -> dict[str, bytes]:
    """Zips that are refused, by what is wrong with each; a good file comes first in most."""
    two = packed(GOOD, ("b.csv", b"1,2\n" * 100))
    stored = packed(GOOD, ("b.csv", b"1,2\n" * 100), method=zipfile.ZIP_STORED)
    end = two.index(b"PK\x05\x06")
    return {
        "encrypted": changed(two, 6, 8, "<H", 1),
        "strongly encrypted": changed(two, 6, 8, "<H", 0x41),
        "unknown method": changed(two, 8, 10, "<H", 77),
        "method deflate64": changed(two, 8, 10, "<H", 9),
        "bzip2": packed(GOOD, ("b.csv", b"1"), method=zipfile.ZIP_BZIP2),
        "lzma": packed(GOOD, ("b.csv", b"1"), method=zipfile.ZIP_LZMA),
        "garbled": garbled(),
        "wrong checksum": changed(two, 14, 16, "<L", 1),
        "states more than it holds": changed(two, 22, 24, "<L", 10**6),
        "states less than it holds": changed(two, 22, 24, "<L", 5),
        "stored with two sizes": changed(stored, 22, 24, "<L", 5),
        "states 4 GB": changed(two, 22, 24, "<L", 2**32 - 2),
        "header of another place": two[: two.rindex(b"PK\x01\x02") + 42] + struct.pack("<L", 7) + two[two.rindex(b"PK\x01\x02") + 46 :],
        "list of entries of 4 GB": two[: end + 12] + struct.pack("<L", 2**32 - 2) + two[end + 16 :],
        "cut off": two[: len(two) // 2],
        "cut off in its list": two[: end - 10],
        "no zip": b"not a zip",
        "empty": b"",
        "the same name twice": packed(GOOD, ("b.csv", b"1"), ("b.csv", b"2")),
        "names that differ in capitals": packed(GOOD, ("b.csv", b"1"), ("B.csv", b"2")),
        "names that differ in composition": packed(GOOD, ("\u00e9.csv", b"1"), ("e\u0301.csv", b"2")),
        "a file that is a folder": packed(GOOD, ("b", b"1"), ("b/c.csv", b"2")),
        "leads up": packed(GOOD, ("../evil.txt", b"1")),
        "leads up from within": packed(GOOD, ("a/../../evil.txt", b"1")),
        "absolute": packed(GOOD, ("/evil.txt", b"1")),
        "backslashes": packed(GOOD, ("a\\..\\evil.txt", b"1")),
        "a drive": packed(GOOD, ("C:evil.txt", b"1")),
        "a stream": packed(GOOD, ("a.txt:evil", b"1")),
        "a device of Windows": packed(GOOD, ("con.txt", b"1")),
        "a control character": packed(GOOD, ("a\nb.txt", b"1")),
        "a name of 300 bytes": packed(GOOD, (LONG, b"1")),
        "a path of 30 folders of 40 letters": packed(GOOD, ("/".join(["f" * 40] * 30), b"1")),
        "hidden hooks": packed(GOOD, (".git/hooks/post-commit", b"#!/bin/sh\n")),
        "hidden hooks deep": packed(GOOD, ("a/.git/hooks/post-commit", b"#!/bin/sh\n")),
        "the workbench's own": packed(GOOD, (".workbench/address", b"x")),
        "a hidden file": packed(GOOD, (".bashrc", b"x")),
        "a link": packed(GOOD, (entry("link", stat.S_IFLNK), b"../../secret.txt")),
        "a link, and a file through it": packed((entry("l", stat.S_IFLNK), b".."), ("l/evil.txt", b"1")),
        "a pipe": packed(GOOD, (entry("pipe.toml", stat.S_IFIFO), b"")),
        "a device": packed(GOOD, (entry("dev.toml", stat.S_IFCHR), b"")),
        "20,000 entries": packed(*((f"f{i}.csv", b"") for i in range(20_000)), method=zipfile.ZIP_STORED),
        "one file under 500 names": overlapping(),
    }


def parquet_of_equal_numbers(path: Path, rows: int, groups: int = 1) -> None:
    """A trajectory file of a few kilobytes whose numbers take rows x groups x 8 x 8 bytes."""
    columns = {name: np.zeros(rows) for name in ("time_s", "x_mm", "y_mm", "z_mm", "qx", "qy", "qz", "qw")}
    _written(path, pa.table(columns), groups)


def parquet_of_one_text(path: Path, rows: int, letters: int) -> None:
    """A trajectory file of a few kilobytes whose texts take rows x letters bytes."""
    texts = pa.DictionaryArray.from_arrays(np.zeros(rows, np.int32), pa.array(["x" * letters]))
    _written(path, pa.table({name: np.zeros(rows) for name in ("time_s", "x_mm", "y_mm", "z_mm")} | {"status": texts}), 1)


def _written(path: Path, table: pa.Table, groups: int) -> None:
    with pa.parquet.ParquetWriter(path, table.schema, compression="zstd") as out:
        for _ in range(groups):
            out.write_table(table)


def deep(depth: int) -> str:
    """JSON of lists in lists."""
    return "[" * depth + "]" * depth


def no_files(folder: Path) -> dict[str, Callable[[Path], None]]:
    """What stands where a file would, by its name: reading it would be waited for, or never end."""
    return {
        "pipe.toml": os.mkfifo,
        "folder.toml": Path.mkdir,
        "zero.toml": lambda path: path.symlink_to("/dev/zero"),
        "circle.toml": lambda path: path.symlink_to("circle.toml"),
    }
