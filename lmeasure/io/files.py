"""Files: read with errors that name the file, row and key; written whole and durably, or not at all.

A file that a function here has written survives a power failure: its bytes and its name are on the disk before the function returns.
"""

import ctypes
import errno
import json
import os
import re
import sys
import tomllib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import tomli_w

from lmeasure.core import FileFormatError, LMeasureError, TextArray
from lmeasure.io.models import Document, loads
from lmeasure.io.safe_open import os_reason, read_regular, sha256 as sha256
from lmeasure.io.tables import Table as Table, read_table as read_table, read_table_in_pieces as read_table_in_pieces
from lmeasure.text import joined, message

LARGEST_TOML = 1 << 26
TO_DO = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT), "full"),
    **dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "no_permission"),
    errno.EFBIG: "large",
}
"""Ends of the ids of remedies for a file that cannot be written (`os.remedy.full`)."""
_becomes: dict[Path, Path] = {}  # temporary names and final names


def not_written(path: Path, error: OSError, cannot: str = "error.cannot_be_written_2", **values: Any) -> str:
    """Return a message with the file that could not be written, the reason and the remedy."""
    said, remedy = message(cannot, where=path, error=os_reason(error), **values), TO_DO.get(error.errno or 0)
    return joined([said, message(f"os.remedy.{remedy}")]) if remedy else said


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` to write to; it becomes `path` only when the block ends without an error.

    Given such a temporary name, it is written to: the block around makes it whole.
    """
    path = Path(path)
    if path in _becomes:
        try:
            yield path
        except OSError as error:
            raise LMeasureError(not_written(_becomes[path], error)) from error
        return
    if not path.name:
        raise LMeasureError(message("error.cannot_be_written_it", where=path))
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part{path.suffix}")
    _becomes[temporary] = path
    try:
        make_folder(path.parent)
        yield temporary
        to_disk(temporary)
        temporary.replace(path)
        to_disk(path.parent)
    except OSError as error:
        raise LMeasureError(not_written(path, error)) from error
    finally:
        _becomes.pop(temporary, None)
        with suppress(OSError):  # where it could not even be made
            temporary.unlink(missing_ok=True)


class Abandoned(NamedTuple):
    """An unfinished file or folder whose process is gone: its path, its final name, and its kind: part or old."""

    path: Path
    name: str
    kind: str


_ABANDONED = re.compile(r"\.(.+)\.(\d+)\.(part|old)(\..*)?")


def abandoned(folder: Path) -> list[Abandoned]:
    """Return the files of killed processes in a folder under temporary names, `.NAME.PROCESS.part` and `.NAME.PROCESS.old`."""
    try:
        found = [(path, _ABANDONED.fullmatch(path.name)) for path in sorted(folder.iterdir())]
    except OSError:
        return []
    return [Abandoned(path, name[1], name[3]) for path, name in found if name and not _runs(int(name[2]))]


def _runs(process: int) -> bool:
    """Return whether a process is alive; True where that cannot be known."""
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except (OSError, OverflowError):  # owned by another user, or not a process number
        return True
    return True


_NO_SYNC = (errno.EINVAL, errno.ENOTSUP, errno.ENOSYS)
"""Errors of file systems that cannot wait for their disk."""


def to_disk(path: Path) -> None:
    """Return when the disk has the bytes of a file, or the names in a folder. OSError when the disk does not take them."""
    if path.is_dir() and (os.name == "nt" or not os.access(path, os.R_OK)):
        return  # Windows opens no folder: its renames are in the journal of the file system
    number = os.open(path, os.O_RDWR if os.name == "nt" else os.O_RDONLY)
    try:
        os.fsync(number)
    except OSError as error:
        if error.errno not in _NO_SYNC:
            raise
    finally:
        os.close(number)


def exchange(one: Path, other: Path) -> bool:
    """Exchange two names in one step, as Linux and macOS can on most file systems; return False where it cannot be done."""
    try:
        system, at, flag = ctypes.CDLL(None, use_errno=True), -100, 2  # AT_FDCWD and RENAME_EXCHANGE of Linux
        call = system.renameat2 if sys.platform == "linux" else system.renamex_np
    except (AttributeError, OSError, TypeError):  # another system, or an old library
        return False
    names = os.fsencode(one), os.fsencode(other)
    return bool((call(at, names[0], at, names[1], flag) if sys.platform == "linux" else call(*names, flag)) == 0)


def make_folder(folder: Path) -> None:
    """Make a folder and those around it, durably."""
    missing = []
    while not folder.exists() and folder.name:
        missing.append(folder)
        folder = folder.parent
    if not missing:
        folder.mkdir(exist_ok=True)  # raises an error for a file of that name
    for new in reversed(missing):
        new.mkdir(exist_ok=True)
        to_disk(new.parent)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends, whole or not at all."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_json(path: Path, content: object) -> None:
    """Write a JSON document, whole or not at all."""
    write_text(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def harmless(text: str) -> str:
    """Return a text that a spreadsheet takes for no formula: ' before one that begins with = + - @, wide forms included, or a control."""
    return f"'{text}" if text.lstrip()[:1] in (*"=+-@＝＋－＠",) or text[:1] in (*"\t\r\n",) else text


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write bytes, whole or not at all."""
    with whole(path) as temporary:
        temporary.write_bytes(content)


def read_bytes(path: Path) -> bytes:
    """The file's bytes; FileFormatError when it cannot be read, or is no regular file."""
    return read_regular(path)


def read_toml(path: Path) -> Document:
    """A TOML file as a dictionary that knows the lines of its keys; FileFormatError names the file and the line."""
    raw = read_regular(path, LARGEST_TOML)
    try:
        text = raw.decode("utf-8-sig")  # with the mark that some editors set before it
        return Document(loads(text), text)
    except UnicodeDecodeError as error:
        raise FileFormatError(message("error.is_not_utf_8", where=path, start=error.start)) from error
    except (ValueError, RecursionError) as error:  # besides TOMLDecodeError: numbers of thousands of digits
        raise FileFormatError(message("error.is_not_toml", where=path, error=error, likely=_likely(text, error))) from error


def _likely(text: str, error: Exception) -> str:
    """Return the likely content of the line that an error of TOML names."""
    found = re.search(r"\(at line (\d+),", str(error))
    line = text.splitlines()[int(found[1]) - 1] if found and int(found[1]) <= len(text.splitlines()) else ""
    comma = re.search(r"=\s*([-+]?\d+),(\d+)\s*(#.*)?$", line)
    if comma:
        return message("file.decimal_point", number=f"{comma[1]}.{comma[2]}")
    return message("file.quotation_mark") if line.partition("#")[0].count('"') % 2 else ""


def write_toml(path: Path, data: Mapping[str, Any]) -> None:
    """Write TOML whole or not at all; floats as the shortest text that reads back to the same double."""
    write_text(path, tomli_w.dumps(data))


def rewrite_toml(path: Path, document: Document) -> None:
    """Write a document's content into its text, with comments and order kept and only differences changed."""
    import tomlkit
    from tomlkit.exceptions import TOMLKitError

    try:
        held = tomlkit.parse(document.text)
        _into(held, document)
        text = tomlkit.dumps(held)
        kept = tomllib.loads(text) == dict(document)
    except (TOMLKitError, ValueError):
        kept = False
    # if tomlkit would change a value, write without comments
    write_text(path, text if kept else tomli_w.dumps(document))


def _into(there: Any, content: Mapping[str, Any]) -> None:
    """Make a table of tomlkit hold the content."""
    for key in [key for key in there if key not in content]:
        del there[key]
    for key, value in content.items():
        now = there.get(key)
        if isinstance(value, Mapping) and isinstance(now, Mapping):
            _into(now, value)
        elif isinstance(value, list) and isinstance(now, list) and len(value) == len(now) and all(isinstance(v, Mapping) for v in value):
            for one, wanted in zip(now, value, strict=True):
                _into(one, wanted)
        elif key not in there or now != value or type(value) is bool:
            there[key] = value


Metadata = Mapping[str, str] | Callable[[], Mapping[str, str]]


def write_table(path: Path, columns: Mapping[str, Any], metadata: Metadata | None = None) -> None:
    """Write .csv or .parquet, whole or not at all. NaN becomes an empty cell in CSV; metadata is kept in Parquet.

    Numbers are written in full: text reads back to the same double.
    """
    with table_writer(path, metadata) as write:
        write(columns)


@contextmanager
def table_writer(path: Path, metadata: Metadata | None = None) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """Write a table in pieces: the function it gives takes the columns of the next rows. The file is whole when the block ends, and
    metadata is requested then."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in {".csv", ".parquet"}:
        raise FileFormatError(message("error.the_name_must_end", where=path))
    writer: Any = None
    with whole(path) as temporary:

        def write(columns: Mapping[str, Any]) -> None:
            nonlocal writer
            data = pa.table({name: _arrow(values, in_csv=suffix == ".csv") for name, values in columns.items()})
            if writer is None:
                schema = data.schema
                if suffix == ".parquet":
                    # measured numbers hardly repeat: a dictionary of them doubles the time and adds a half to the size
                    floats = [field.name for field in schema if pa.types.is_floating(field.type)]
                    texts = [field.name for field in schema if pa.types.is_dictionary(field.type)]
                    # some metadata are known at the end only; a stored copy of the schema would hide them
                    writer = pa.parquet.ParquetWriter(
                        temporary, schema, compression="zstd", use_dictionary=texts, use_byte_stream_split=floats, store_schema=False
                    )
                else:
                    options = pa.csv.WriteOptions(quoting_style="needed", quoting_header="none")
                    writer = pa.csv.CSVWriter(temporary, schema, write_options=options)
            writer.write_table(data)

        try:
            yield write
        finally:
            if writer is not None:
                if metadata is not None and suffix == ".parquet":
                    writer.add_key_value_metadata(dict(metadata() if callable(metadata) else metadata))
                writer.close()


FEW_ROWS = 10_000
"""Rows of a CSV for which pyarrow's functions are not loaded."""

_KINDS: dict[type, Any] = {str: np.object_, int: np.int64, float: np.float64}


# Between pyarrow and NumPy by their buffers: pyarrow's own conversions load pandas, a third of a second and 55 MB for nothing.
def _arrow(values: Any, *, in_csv: bool) -> pa.Array:
    if isinstance(values, list):
        kinds = {str if issubclass(kind, str) else kind for kind in set(map(type, values))}
        kind = _KINDS.get(kinds.pop()) if len(kinds) == 1 else None
        if kind is None:
            return pa.array(values)
        values = np.array(values, kind)
    values = np.ascontiguousarray(values)
    if values.dtype.kind == "O":
        return _texts(values, in_csv)
    if values.dtype.kind not in "biuf":
        return pa.array(values.tolist() if values.dtype.kind == "U" else values)
    present, kind = None, pa.from_numpy_dtype(values.dtype)
    if in_csv and values.dtype.kind == "f" and np.isnan(values).any():
        present = pa.py_buffer(np.packbits(~np.isnan(values), bitorder="little"))
    return pa.Array.from_buffers(
        kind, len(values), [present, pa.py_buffer(np.packbits(values, bitorder="little") if kind == pa.bool_() else values)]
    )


def _texts(values: TextArray, in_csv: bool) -> pa.Array:
    """Return texts that repeat each other. Only CSV needs each one written out, for which pyarrow loads its functions."""
    places: dict[str, int] = {}
    if len(values) and bool((values == values[0]).all()):
        places[values[0]], codes = 0, np.zeros(len(values), np.int32)
    else:
        codes = np.fromiter((places.setdefault(text, len(places)) for text in values), np.int32, len(values))
    if in_csv and len(values) <= FEW_ROWS:
        return _strings(values.tolist())
    different, numbers = _strings(list(places)), _arrow(codes, in_csv=False)
    return different.take(numbers) if in_csv else pa.DictionaryArray.from_arrays(numbers, different)


def _strings(texts: list[str]) -> pa.StringArray:
    encoded = [text.encode() for text in texts]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    return pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))
