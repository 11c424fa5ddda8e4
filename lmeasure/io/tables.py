"""Tables of numbers and text from .csv and .parquet, with every fault of a file named by its line and column."""

import os
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet

from lmeasure.core import BoolArray, FileFormatError, FloatArray, IntArray, TextArray
from lmeasure.io.models import gathered
from lmeasure.io.safe_open import LARGEST_BYTES, open_regular, read_regular
from lmeasure.text import composed, message

# plain numbers only: no nan, no inf, no 1_000, no digits of other scripts
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


_Fault = tuple[int, str, str]
"""Row from 0, column, and fault."""
ENOUGH = 1000
"""Faults of a kind in a column that are looked for: far more than are reported."""


def _parsed(name: str, column: pa.ChunkedArray) -> tuple[pa.ChunkedArray, list[_Fault]]:
    """Text cells as numbers: the column was not read as numbers, so at least one cell is bad, or all are empty."""
    values: list[float | None] = []
    faults: list[_Fault] = []
    for row, cell in enumerate(column.to_pylist()):
        text = "" if cell is None else cell.strip()
        good = _NUMBER.fullmatch(text) is not None
        if text and not good and len(faults) < ENOUGH:
            faults.append((row, name, message("complaint.is", text=message("complaint.number"), value=_shown(cell))))
        values.append(float(text) if good else None)
    return pa.chunked_array([pa.array(values, pa.float64())]), faults


def _shown(cell: str) -> str:
    return repr(cell if len(cell) <= 40 else cell[:40] + "...")


def _reason(error: Exception) -> str:
    """Return the message of another library, as one short line of printable text."""
    text = " ".join("".join(c if c.isprintable() or c.isspace() else "?" for c in str(error)).split())
    return text if len(text) <= 200 else text[:200] + "..."


MOST_COLUMNS = 2000
"""More than any table of an instrument has; columns are looked up one by one."""


class Table:
    """Named columns of numbers or text read from a .csv or .parquet file, with errors that name file, row and column."""

    def __init__(self, path: Path, data: pa.Table, first: int = 0, lines: Sequence[int] = ()) -> None:
        self.path = Path(path)
        if data.num_columns > MOST_COLUMNS:
            raise FileFormatError(message("error.columns_most", where=path, n=data.num_columns, most=MOST_COLUMNS))
        self.first = first
        """Number of its first row in the file, when it is a piece of it."""
        self._lines = lines
        """Lines of its rows in the file, where they do not follow each other from the second on."""
        self._data = data

    @cached_property
    def columns(self) -> list[str]:
        """Column names in file order."""
        return list(self._data.column_names)

    def __len__(self) -> int:
        return int(self._data.num_rows)

    def kept(self, key: str) -> str:
        """Return the metadata of a Parquet file for a key; empty without any."""
        return str((self._data.schema.metadata or {}).get(key.encode(), b"").decode())

    def behind(self, rows: int) -> "Table":
        """The rows from that number on."""
        return Table(self.path, self._data.slice(rows), self.first + rows)

    def _at(self, index: int, column: str) -> str:
        if self._lines:
            return f"{self.path}:{self._lines[index]}: {column}"
        # the first data row of a CSV is line 2
        row = self.first + index
        return f"{self.path}:{row + 2}: {column}" if self.path.suffix.lower() == ".csv" else f"{self.path}: row {row}: {column}"

    def _column(self, name: str) -> pa.ChunkedArray:
        if name not in self._data.column_names:
            raise FileFormatError(message("error.column_is_missing_it_has", where=self.path, name=name, has=", ".join(self.columns)))
        return self._data.column(name)

    def numbers(self, name: str, *, gaps: bool = False) -> FloatArray:
        """(n,) floats. An empty cell is NaN where gaps are allowed, an error otherwise; any other cell must be a finite number."""
        values, faults = self._read(name, gaps)
        self._refuse(faults)
        return values

    @contextmanager
    def every_fault(self, numbers: Sequence[str], gaps: Sequence[str] = ()) -> Iterator[None]:
        """Extend a FileFormatError of the block by a line for each cell of these columns that is no number, or empty, except those of
        gaps."""
        try:
            yield
        except FileFormatError:
            known = set(self.columns)
            there = [name for name in dict.fromkeys((*numbers, *gaps)) if name in known]
            self._refuse([fault for name in there for fault in self._read(name, name in gaps)[1]])
            raise

    def _refuse(self, faults: list[_Fault]) -> None:
        lines = [
            composed("{where}: {text}", where=self._at(row, column), text=text)
            for row, column, text in sorted(faults, key=lambda fault: fault[0])
        ]
        if lines:
            raise gathered(str(self.path), lines)

    def _read(self, name: str, gaps: bool) -> tuple[FloatArray, list[_Fault]]:
        """Return (n,) values and the faults of cells, of each kind not many more than are reported."""
        column = self._column(name)
        faults: list[_Fault] = []
        try:
            if not (pa.types.is_integer(column.type) or pa.types.is_floating(column.type) or pa.types.is_null(column.type)):
                column, faults = _parsed(name, column.cast(pa.string()))
            if column.type != pa.float64():
                column = pa.chunked_array([_as_floats(chunk) for chunk in column.chunks], pa.float64())
        except pa.ArrowException as error:
            raise FileFormatError(message("error.column_is_not_a_column", where=self.path, name=name, reason=_reason(error))) from error
        values, empty = _numbers(column)
        if self.path.suffix.lower() == ".parquet":
            # there a missing float is a NaN as often as a null; in a CSV the text "nan" is a cell that is not a number
            empty |= np.isnan(values)
        bad = np.flatnonzero(~np.isfinite(values) & ~empty)
        faults += [(int(row), name, message("complaint.is", text=message("complaint.finite"), value=values[row])) for row in bad[:ENOUGH]]
        if not gaps:
            known = {row for row, _, _ in faults}
            faults += [(int(row), name, message("error.cell_is_empty")) for row in np.flatnonzero(empty)[:ENOUGH] if int(row) not in known]
        values[empty] = np.nan
        return values, faults

    def matrix(self, names: Sequence[str], *, gaps: bool = False) -> FloatArray:
        """(n, len(names)) floats of several columns."""
        read = [self._read(name, gaps) for name in names]
        self._refuse([fault for _, faults in read for fault in faults])
        return np.column_stack([values for values, _ in read]) if names else np.empty((len(self), 0))

    def kind(self, name: str) -> pa.DataType:
        """Return the type of a column's cells."""
        return self._column(name).type

    def cells(self, name: str) -> list[Any]:
        """Return (n,) cells as Python has them."""
        return list(self._column(name).to_pylist())

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
            raise FileFormatError(
                message("error.is_not_one_of", where=self._at(row, name), texts=texts[codes[row]], options=", ".join(options))
            )
        return place

    def _encoded(self, name: str) -> tuple[list[str], IntArray]:
        column = self._column(name)
        if pa.types.is_dictionary(column.type):
            column = column.cast(column.type.value_type)
        if not (pa.types.is_string(column.type) or pa.types.is_large_string(column.type) or pa.types.is_null(column.type)):
            raise FileFormatError(message("error.column_is_not_a", where=self.path, name=name))
        coded = column.cast(pa.string()).combine_chunks().dictionary_encode()
        texts, indices = coded.dictionary.to_pylist(), coded.indices
        codes = np.frombuffer(indices.buffers()[1] or b"", np.int32)[indices.offset : indices.offset + len(indices)].astype(np.int64)
        if coded.null_count:
            codes[np.from_dlpack(coded.is_null().cast(pa.uint8())) == 1] = len(texts)
        return [*texts, ""], codes


def decoded_bytes(path: Path, only: Sequence[str] | None = None) -> int:
    """Return the bytes in memory of a .parquet file's numbers, and of the texts of all or some columns; FileFormatError for any other file.

    A few bytes of such a file may contain millions of equal values. Numbers are counted by the file's own metadata, texts by their lengths.
    """
    path = Path(path)
    try:
        with open_regular(path) as raw, pa.parquet.ParquetFile(raw, pre_buffer=False) as file:
            bound, texts = _stated_bytes(path, file)
            texts = [name for name in texts if only is None or name in only]
        if bound > LARGEST_BYTES or not texts:
            return bound
        with open_regular(path) as raw, pa.parquet.ParquetFile(raw, pre_buffer=False, read_dictionary=texts) as file:
            for batch in file.iter_batches(PIECE_ROWS, columns=texts):
                bound += sum(_text_bytes(column) for column in batch.columns)
                if bound > LARGEST_BYTES:
                    break
    except (pa.ArrowException, OSError) as error:
        raise FileFormatError(message("error.cannot_be_read_as_parquet", where=path, reason=_reason(error))) from error
    return bound


def _stated_bytes(path: Path, file: Any) -> tuple[int, list[str]]:
    """Return the bytes in memory of a .parquet file's values by its own metadata, without texts, and the columns of texts."""
    groups = [file.metadata.row_group(i) for i in range(file.metadata.num_row_groups)]
    chunks = [group.column(i) for group in groups for i in range(group.num_columns)]
    bound, texts = sum(8 * chunk.num_values + chunk.total_uncompressed_size for chunk in chunks), []
    for field in file.schema_arrow:
        kind = field.type
        if pa.types.is_fixed_size_binary(kind):
            bound += kind.byte_width * file.metadata.num_rows
        elif _is_text(kind) or (pa.types.is_dictionary(kind) and _is_text(kind.value_type)):
            texts.append(field.name)
        elif pa.types.is_nested(kind) and any(_is_text(leaf) or pa.types.is_fixed_size_binary(leaf) for leaf in _leaves(kind)):
            raise FileFormatError(message("error.column_has_texts_in", where=path, name=field.name))
    return bound, texts


def _is_text(kind: pa.DataType) -> bool:
    return any(check(kind) for check in (pa.types.is_string, pa.types.is_large_string, pa.types.is_binary, pa.types.is_large_binary))


def _leaves(kind: pa.DataType) -> Iterator[pa.DataType]:
    if not pa.types.is_nested(kind):
        yield kind
    for i in range(kind.num_fields):
        yield from _leaves(kind.field(i).type)


def _text_bytes(column: pa.Array) -> int:
    """Return the bytes of the texts of a column whose different ones are kept once."""
    from pyarrow.compute import binary_length, sum as total

    lengths = binary_length(column.dictionary)
    return int(total(lengths.take(column.indices)).as_py() or 0)


def read_table(path: Path, *, torn: bool = False, only: Sequence[str] | None = None) -> Table:
    """Read .csv (header line, empty cells are gaps; commas, or semicolons or tabs with a spreadsheet's decimal commas) or .parquet.
    FileFormatError names the file and its fault.

    torn: a recording that broke off; its last line counts only if it is whole. only: columns that are wanted; others of a .parquet are not
    read.
    """
    path = Path(path)
    raw = read_regular(path)
    suffix, metadata = path.suffix.lower(), None
    if torn and suffix == ".csv":
        raw = raw[: raw.rfind(b"\n") + 1]
    try:
        if suffix == ".parquet":
            if (size := decoded_bytes(path, only)) > LARGEST_BYTES:
                raise FileFormatError(message("error.cannot_be_read_its", where=path, size=size, largest_bytes=LARGEST_BYTES))
            file = pa.parquet.ParquetFile(pa.BufferReader(raw))
            data, metadata = file.read(None if only is None else list(only)), file.metadata.metadata
        elif suffix == ".csv":
            if not raw or raw.isspace():
                raise FileFormatError(message("error.is_empty", where=path))
            separator = _separator(raw)
            data = pa.csv.read_csv(
                pa.BufferReader(raw.removeprefix(b"\xef\xbb\xbf")),
                parse_options=pa.csv.ParseOptions(delimiter=separator),
                convert_options=pa.csv.ConvertOptions(
                    null_values=[""],
                    strings_can_be_null=True,
                    true_values=[],
                    false_values=[],
                    timestamp_parsers=[],
                    # numbers with points are read as texts first, and then as numbers
                    decimal_point="." if separator == "," else ",",
                ),
            )
        else:
            raise FileFormatError(message("error.is_neither_csv_nor", where=path))
        names = [name.strip() for name in data.column_names]
    except (pa.ArrowException, OSError, UnicodeDecodeError) as error:
        _refuse_ragged(path, raw)
        raise FileFormatError(message("error.cannot_be_read_as_2", where=path, suffix=suffix[1:], reason=_reason(error))) from error
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise FileFormatError(message("error.column_stands_twice", where=path, name=twice[0]))
    if "" in names:
        raise FileFormatError(message("error.column_number_has_no", where=path, index=names.index("") + 1))
    return Table(path, data.rename_columns(names).replace_schema_metadata(metadata))


def _separator(raw: bytes) -> str:
    """Return the separator of the columns, by the header."""
    head = raw.lstrip().partition(b"\n")[0]
    return next((mark for mark in (",", ";", "\t") if mark.encode() in head), ",")


def _refuse_ragged(path: Path, raw: bytes) -> None:
    """FileFormatError for rows of a .csv that have more or fewer cells than its header, a line each; nothing where that is not it."""
    lines: list[str] = []

    def note(row: Any) -> str:
        if len(lines) < ENOUGH:
            where, wide, text = f"{path}:{row.number}", row.expected_columns, _shown(row.text)
            lines.append(message("error.row_has_cells", where=where, n_row=row.actual_columns, n_header=wide, text=text))
        return "skip"

    if path.suffix.lower() == ".csv":
        with suppress(pa.ArrowException, UnicodeDecodeError):
            raw.decode("utf-8")
            # one thread, which knows the lines' numbers
            options, rows = pa.csv.ReadOptions(use_threads=False), pa.csv.ParseOptions(delimiter=_separator(raw), invalid_row_handler=note)
            pa.csv.read_csv(pa.BufferReader(raw), read_options=options, parse_options=rows)
    if lines:
        raise gathered(str(path), lines)


PIECE_BYTES = 2**20  # some 15,000 lines of a counts file
PIECE_ROWS = 2**14
EXACT = 2**53


def read_table_in_pieces(path: Path, first: int = 0) -> Iterator[tuple[Table, float]]:
    """Yield `read_table` of numbers, one piece after the other with the finished part of the file; only a few pieces are in memory.

    first: of a .parquet file, the row to begin at: a multiple of `PIECE_ROWS`, for the pieces to be those of the whole file.

    The fast reader of pieces leaves text, blanks around numbers and broken files to `read_table`, which reads them or names the fault.
    """
    path = Path(path)
    rows = first
    try:
        for data, part in _pieces(path) if not first else _pieces_behind(path, first):
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


def _as_floats(chunk: pa.Array) -> pa.Array:
    """Return the cells as floats. Integers that all floats hold exactly are converted without pyarrow's own functions, which take long to
    load."""
    if pa.types.is_int64(chunk.type) and not chunk.null_count:
        values = np.frombuffer(chunk.buffers()[1] or b"", np.int64)[chunk.offset : chunk.offset + len(chunk)]
        if not len(values) or -EXACT <= values.min() <= values.max() <= EXACT:
            return pa.Array.from_buffers(pa.float64(), len(values), [None, pa.py_buffer(values.astype(np.float64))])
    return chunk.cast(pa.float64())


def _pieces_behind(path: Path, first: int) -> Iterator[tuple[pa.Table, float]]:
    """Yield the pieces of a .parquet file from a row on, without reading the groups of rows before it."""
    with open_regular(path) as raw, pa.parquet.ParquetFile(raw, pre_buffer=False, buffer_size=2**20) as file:
        ends = np.cumsum([file.metadata.row_group(i).num_rows for i in range(file.metadata.num_row_groups)])
        group = int(np.searchsorted(ends, first, side="right"))
        skip, held, done = first - int(ends[group - 1] if group else 0), None, first
        for batch in file.iter_batches(PIECE_ROWS, row_groups=list(range(group, len(ends)))):
            data = pa.Table.from_batches([batch])
            held = data if held is None else pa.concat_tables([held, data])
            passed = min(skip, len(held))
            held, skip = held.slice(passed), skip - passed
            while len(held) >= PIECE_ROWS:
                done += PIECE_ROWS
                yield held.slice(0, PIECE_ROWS), done / file.metadata.num_rows
                held = held.slice(PIECE_ROWS)
        if held is not None and len(held):
            yield held, 1.0


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
