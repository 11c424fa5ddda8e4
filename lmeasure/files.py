"""Files: read with errors that name the file, row and key; written whole or not at all."""

import hashlib
import os
import re
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet
import tomli_w

from lmeasure.arrays import BoolArray, FloatArray, IntArray, TextArray
from lmeasure.errors import FileFormatError, LMeasureError
from lmeasure.opened import open_regular, read_regular

"""(n,) texts, few of them different: millions of samples share the same strings."""


LARGEST_TOML = 1 << 26


@contextmanager
def whole(path: Path) -> Iterator[Path]:
    """A temporary name beside `path` to write to; it becomes `path` only when the block ends without an error."""
    path = Path(path)
    if not path.name:
        raise LMeasureError(f"{path}: cannot be written: it names no file")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.part{path.suffix}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        yield temporary
        temporary.replace(path)
    except OSError as error:
        raise LMeasureError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):  # where it could not even be made
            temporary.unlink(missing_ok=True)


def write_text(path: Path, text: str) -> None:
    """Write UTF-8 text with Unix line ends, whole or not at all."""
    with whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", newline="\n")


def write_bytes(path: Path, content: bytes | memoryview) -> None:
    """Write bytes, whole or not at all."""
    with whole(path) as temporary:
        temporary.write_bytes(content)


def read_bytes(path: Path) -> bytes:
    """The file's bytes; FileFormatError when it cannot be read, or is no regular file."""
    return read_regular(path)


def sha256(path: Path) -> str:
    """Hexadecimal SHA-256 of the file's bytes."""
    try:
        with Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return hashlib.sha256(read_bytes(path)).hexdigest()  # says what is wrong with it


def read_toml(path: Path) -> dict[str, Any]:
    """A TOML file as a dictionary; FileFormatError names the file and the line."""
    raw = read_regular(path, LARGEST_TOML)
    try:
        return tomllib.loads(raw.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise FileFormatError(f"{path}: is not UTF-8 text (byte {error.start})") from error
    except (ValueError, RecursionError) as error:  # besides TOMLDecodeError: numbers of thousands of digits
        raise FileFormatError(f"{path}: is not TOML: {error}") from error


def write_toml(path: Path, data: Mapping[str, Any]) -> None:
    """Write TOML whole or not at all; floats as the shortest text that reads back to the same double."""
    write_text(path, tomli_w.dumps(data))


# what a person calls a number: no nan, no inf, no 1_000, no digits of other scripts
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def _shown(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:40] + "...")


def _reason(error: Exception) -> str:
    """What another library says, as one short line of printable text."""
    text = " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in str(error)).split())
    return text if len(text) <= 200 else text[:200] + "..."


class Table:
    """Named columns of numbers or text read from a .csv or .parquet file, with errors that name file, row and column."""

    def __init__(self, path: Path, data: pa.Table, first: int = 0) -> None:
        self.path = Path(path)
        self.first = first
        """Number of its first row in the file, when it is a piece of it."""
        self._data = data

    @property
    def columns(self) -> list[str]:
        """Column names in file order."""
        return list(self._data.column_names)

    def __len__(self) -> int:
        return int(self._data.num_rows)

    def behind(self, rows: int) -> "Table":
        """The rows from that number on."""
        return Table(self.path, self._data.slice(rows), self.first + rows)

    def _row(self, index: int) -> str:
        # a CSV's first data row stands on line 2
        row = self.first + index
        return f"line {row + 2}" if self.path.suffix.lower() == ".csv" else f"row {row}"

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self._data.column_names:
            raise FileFormatError(f"{self.path}: column {name!r} is missing; it has {', '.join(self.columns)}")
        return self._data.column(name)

    def numbers(self, name: str, *, gaps: bool = False) -> FloatArray:
        """(n,) floats. An empty cell is NaN where gaps are allowed, an error otherwise; any other cell must be a finite number."""
        column = self._column(name)
        try:
            if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type) or pa.types.is_null(column.type)):
                column = self._parse(name, column.cast(pa.string()))
            column = column.cast(pa.float64())
        except pa.ArrowException as error:
            raise FileFormatError(f"{self.path}: column {name!r} is not a column of numbers: {_reason(error)}") from error
        values, empty = _numbers(column)
        if self.path.suffix.lower() == ".parquet":
            # there a missing float is a NaN as often as a null; in a CSV the text "nan" is a cell that is not a number
            empty |= np.isnan(values)
        bad = ~np.isfinite(values) & ~empty
        if not gaps:
            bad |= empty
        if bad.any():
            row = int(np.argmax(bad))
            what = "is empty" if empty[row] else f"is {values[row]}, not a finite number"
            raise FileFormatError(f"{self.path}: {self._row(row)}, column {name!r} {what}")
        values[empty] = np.nan
        return values

    def _parse(self, name: str, column: pa.ChunkedArray) -> pa.ChunkedArray:
        """Text cells as numbers: the column was not read as numbers, so at least one cell is bad, or all are empty."""
        values: list[float | None] = []
        for row, cell in enumerate(column.to_pylist()):
            text = "" if cell is None else cell.strip()
            if text and not _NUMBER.fullmatch(text):
                raise FileFormatError(f"{self.path}: {self._row(row)}, column {name!r}: {_shown(cell)} is not a number")
            values.append(float(text) if text else None)
        return pa.chunked_array([pa.array(values, pa.float64())])

    def matrix(self, names: Sequence[str], *, gaps: bool = False) -> FloatArray:
        """(n, len(names)) floats of several columns."""
        return np.column_stack([self.numbers(name, gaps=gaps) for name in names]) if names else np.empty((len(self), 0))

    def text(self, name: str) -> list[str]:
        """(n,) cells as text; numbers that are whole are written without a decimal point."""
        cells = self._column(name).to_pylist()
        return ["" if c is None else str(int(c)) if isinstance(c, float) and c.is_integer() else str(c) for c in cells]

    def labels(self, name: str) -> TextArray:
        """(n,) cells of a column of few different texts; an empty cell is the empty text."""
        texts, codes = self._encoded(name)
        return np.array(texts, dtype=np.object_)[codes]

    def choices(self, name: str, options: Sequence[str]) -> IntArray:
        """(n,) positions of the cells' texts among the options; FileFormatError names the row of any other text."""
        texts, codes = self._encoded(name)
        place = np.array([options.index(t) if t in options else -1 for t in texts], dtype=np.int64)[codes]
        if (place < 0).any():
            row = int(np.argmax(place < 0))
            raise FileFormatError(f"{self.path}: {self._row(row)}: {name} {texts[codes[row]]!r} is not one of {', '.join(options)}")
        return place

    def _encoded(self, name: str) -> tuple[list[str], IntArray]:
        column = self._column(name)
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type) or pa.types.is_null(column.type)):
            raise FileFormatError(f"{self.path}: column {name!r} is not a column of text")
        coded = column.cast(pa.string()).combine_chunks().dictionary_encode()
        texts, indices = coded.dictionary.to_pylist(), coded.indices
        codes = np.frombuffer(indices.buffers()[1] or b"", np.int32)[indices.offset : indices.offset + len(indices)].astype(np.int64)
        if coded.null_count:
            codes[np.from_dlpack(coded.is_null().cast(pa.uint8())) == 1] = len(texts)
        return [*texts, ""], codes


def read_table(path: Path, *, torn: bool = False, only: Sequence[str] | None = None) -> Table:
    """Read .csv (comma, header line, empty cells are gaps) or .parquet. FileFormatError names the file and what is wrong with it.

    torn: a recording that broke off; its last line counts only when it is whole. only: columns that are wanted; others of a .parquet are
    not read.
    """
    path = Path(path)
    raw = read_bytes(path)
    suffix = path.suffix.lower()
    if torn and suffix == ".csv":
        raw = raw[: raw.rfind(b"\n") + 1]
    try:
        if suffix == ".parquet":
            data = pa.parquet.read_table(pa.BufferReader(raw), columns=None if only is None else list(only))
        elif suffix == ".csv":
            if not raw or raw.isspace():
                raise FileFormatError(f"{path}: is empty")
            data = pa.csv.read_csv(
                pa.BufferReader(raw.removeprefix(b"\xef\xbb\xbf")),
                convert_options=pa.csv.ConvertOptions(
                    null_values=[""], strings_can_be_null=True, true_values=[], false_values=[], timestamp_parsers=[]
                ),
            )
        else:
            raise FileFormatError(f"{path}: is neither .csv nor .parquet")
        names = [name.strip() for name in data.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        raise FileFormatError(f"{path}: cannot be read as {suffix[1:]}: {_reason(error)}") from error
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise FileFormatError(f"{path}: column {twice[0]!r} stands twice")
    if "" in names:
        raise FileFormatError(f"{path}: column number {names.index('') + 1} has no name")
    return Table(path, data.rename_columns(names))


PIECE_BYTES = 2**20  # some 15,000 lines of a counts file
PIECE_ROWS = 2**14


def read_table_in_pieces(path: Path) -> Iterator[tuple[Table, float]]:
    """`read_table` of numbers, one piece after the other with the part of the file that is done; only a few pieces are in memory.

    What the fast reader of pieces does not take - text, blanks around numbers, a broken file - is left to `read_table`, which takes it
    or says what is wrong with it.
    """
    path = Path(path)
    rows = 0
    try:
        for data, part in _pieces(path):
            names = [name.strip() for name in data.column_names]
            if len(set(names)) < len(names) or "" in names:
                break
            if len(data):
                yield Table(path, data.rename_columns(names), rows), part
            rows += len(data)
        else:
            if rows:
                return
    except (pa.ArrowException, OSError, UnicodeDecodeError):
        pass
    yield read_table(path).behind(rows), 1.0


def _pieces(path: Path) -> Iterator[tuple[pa.Table, float]]:
    if path.suffix.lower() == ".parquet":
        # without its read-ahead, which keeps the compressed bytes of the whole file
        with open_regular(path) as raw, pa.parquet.ParquetFile(raw, pre_buffer=False, buffer_size=2**20) as file:
            done, total = 0, max(file.metadata.num_rows, 1)
            for batch in file.iter_batches(PIECE_ROWS):
                done += len(batch)
                yield pa.Table.from_batches([batch]), done / total
    elif path.suffix.lower() == ".csv":
        with open_regular(path) as raw:
            size = os.fstat(raw.fileno()).st_size
            names = raw.readline().decode("utf-8-sig").strip("\r\n").split(",")
            raw.seek(0)
            numbers = pa.csv.ConvertOptions(column_types=dict.fromkeys(names, pa.float64()), null_values=[""])
            with pa.csv.open_csv(raw, pa.csv.ReadOptions(block_size=PIECE_BYTES), convert_options=numbers) as batches:
                for batch in batches:
                    yield pa.Table.from_batches([batch]), min(raw.tell() / size, 1.0)


def write_table(path: Path, columns: Mapping[str, Any], metadata: Mapping[str, str] | None = None) -> None:
    """Write .csv or .parquet, whole or not at all. NaN becomes an empty cell in CSV; metadata is kept in Parquet's schema.

    Numbers are written in full: text reads back to the same double.
    """
    with table_writer(path, metadata) as write:
        write(columns)


@contextmanager
def table_writer(path: Path, metadata: Mapping[str, str] | None = None) -> Iterator[Callable[[Mapping[str, Any]], None]]:
    """`write_table` in pieces: the function it gives takes the columns of the next rows; the file stands when the block ends."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in {".csv", ".parquet"}:
        raise FileFormatError(f"{path}: the name must end in .csv or .parquet")
    writer: Any = None
    with whole(path) as temporary:

        def write(columns: Mapping[str, Any]) -> None:
            nonlocal writer
            data = pa.table({name: _arrow(values, nan_is_null=suffix == ".csv") for name, values in columns.items()})
            if writer is None:
                schema = data.schema.with_metadata(dict(metadata)) if metadata else data.schema
                if suffix == ".parquet":
                    writer = pa.parquet.ParquetWriter(temporary, schema, compression="zstd")
                else:
                    options = pa.csv.WriteOptions(quoting_style="needed", quoting_header="none")
                    writer = pa.csv.CSVWriter(temporary, schema, write_options=options)
            writer.write_table(data)

        try:
            yield write
        finally:
            if writer is not None:
                writer.close()


# Between pyarrow and NumPy by their buffers: pyarrow's own conversions load pandas, a third of a second and 55 MB for nothing.
_ARROW = {"f8": pa.float64(), "i8": pa.int64(), "i4": pa.int32()}


def _numbers(column: pa.ChunkedArray) -> tuple[FloatArray, BoolArray]:
    """(n,) values of a column of floats, a copy, and whether they are missing."""
    values, empty = np.empty(len(column)), np.zeros(len(column), np.bool_)
    begin = 0
    for chunk in column.chunks:
        end, data = begin + len(chunk), chunk.buffers()[1]
        if len(chunk) and data is not None:
            values[begin:end] = np.frombuffer(data, np.float64)[chunk.offset : chunk.offset + len(chunk)]
        if chunk.null_count:
            empty[begin:end] = np.from_dlpack(chunk.is_null().cast(pa.uint8())).astype(np.bool_)
        begin = end
    return values, empty


def _arrow(values: Any, *, nan_is_null: bool) -> pa.Array:
    if isinstance(values, list):
        return pa.array(values)
    values = np.ascontiguousarray(values)
    if values.dtype.kind == "O":
        return _texts(values)
    kind = _ARROW.get(values.dtype.str[1:])
    if kind is None:
        return pa.array(values, from_pandas=nan_is_null and values.dtype.kind == "f")
    present = None
    if nan_is_null and values.dtype.kind == "f" and np.isnan(values).any():
        present = pa.py_buffer(np.packbits(~np.isnan(values), bitorder="little"))
    return pa.Array.from_buffers(kind, len(values), [present, pa.py_buffer(values)])


def _texts(values: TextArray) -> pa.Array:
    """Texts of which few are different."""
    places: dict[str, int] = {}
    if len(values) and bool((values == values[0]).all()):
        places[values[0]], codes = 0, np.zeros(len(values), np.int32)
    else:
        codes = np.fromiter((places.setdefault(text, len(places)) for text in values), np.int32, len(values))
    encoded = [text.encode() for text in places]
    ends = np.cumsum([0, *map(len, encoded)], dtype=np.int32)
    different = pa.StringArray.from_buffers(len(encoded), pa.py_buffer(ends), pa.py_buffer(b"".join(encoded)))
    return different.take(_arrow(codes, nan_is_null=False))
