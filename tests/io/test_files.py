"""Files: read with the row and column of what is wrong, written whole or not at all, every double as it was."""

import os
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from lmeasure.core import FileFormatError, LMeasureError
from lmeasure.io import files

SUFFIXES = (".csv", ".parquet")


@pytest.mark.parametrize("suffix", SUFFIXES)
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(values=st.lists(st.floats(allow_nan=True, allow_infinity=False), min_size=1, max_size=20))
def test_every_double_comes_back(tmp_path: Path, suffix: str, values: list[float]) -> None:
    path = tmp_path / f"t{suffix}"
    files.write_table(path, {"a": np.arange(float(len(values))), "b": np.array(values)})
    table = files.read_table(path)
    back = table.numbers("b", gaps=True)
    assert back.tobytes() == np.where(np.isnan(values), np.nan, values).tobytes()
    assert len(table) == len(values)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_texts_come_back(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"t{suffix}"
    texts = np.array(["ok", "", 'a, "b"', "ok", "größer ≥ 5"], dtype=np.object_)
    files.write_table(path, {"time_s": np.arange(5.0), "cause": texts, "status": np.array(["x", "y", "x", "x", "y"], dtype=np.object_)})
    table = files.read_table(path)
    assert table.labels("cause").tolist() == texts.tolist()
    assert table.text("cause") == texts.tolist()
    assert table.choices("status", ["x", "y"]).tolist() == [0, 1, 0, 0, 1]
    with pytest.raises(FileFormatError, match=r"(:3|: row 1): status: 'y' is not one of x, z"):
        table.choices("status", ["x", "z"])
    with pytest.raises(FileFormatError, match=r"column 'time_s' is not a column of text"):
        table.labels("time_s")


def test_a_column_of_nothing_is_empty_text(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("time_s,cause\n0,\n1,\n")
    assert files.read_table(path).labels("cause").tolist() == ["", ""]


def test_metadata_is_kept_in_parquet(tmp_path: Path) -> None:
    files.write_table(tmp_path / "t.parquet", {"a": np.zeros(2)}, {"uncertainty_covers": "counts"})
    assert pq.read_schema(tmp_path / "t.parquet").metadata[b"uncertainty_covers"] == b"counts"


HEAD = b"time_s,ch1,ch2\n"
CELLS = [
    (b"0,1,2\n1,nan,3\n", ":3: ch1: must be a finite number, is nan"),
    (b"0,1,2\n1,-inf,3\n", ":3: ch1: must be a finite number, is -inf"),
    (b"0,1,2\n1,1e400,3\n", ":3: ch1: must be a finite number, is inf"),
    (b"0,1,2\n1,12abc,3\n", ":3: ch1: must be a number, is '12abc'"),
    (b"0,true,2\n", ":2: ch1: must be a number, is 'true'"),
    (b"0,1979-05-27,2\n", ":2: ch1: must be a number, is '1979-05-27'"),
    (b"0,12:00:00,2\n", ":2: ch1: must be a number, is '12:00:00'"),
    (b"0,1_000,2\n", ":2: ch1: must be a number, is '1_000'"),
    ("0,١٢,2\n".encode(), ":2: ch1: must be a number"),
    (b"0," + b"x" * 1000 + b",2\n", ":2: ch1: must be a number, is 'xxxx"),
    (b"0,9007199254740993,2\n", "column 'ch1' is not a column of numbers"),
    (b"0,\xe4,2\n", "column 'ch1' is not a column of numbers: Invalid UTF8"),
]


@pytest.mark.parametrize(("rows", "line"), CELLS, ids=[line[:40] for _, line in CELLS])
def test_a_cell_that_is_no_number_is_named(tmp_path: Path, rows: bytes, line: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(HEAD + rows)
    with pytest.raises(FileFormatError) as caught:
        files.read_table(path).numbers("ch1", gaps=True)
    assert str(caught.value).startswith(f"{path}:")
    assert line in str(caught.value)
    assert len(str(caught.value)) < 400
    assert "\n" not in str(caught.value)


TABLES = [
    (b"", "is empty"),
    (b"\n\n \n", "is empty"),
    (b"time_s,ch1,ch1\n0,1,2\n", "column 'ch1' occurs twice"),
    (b"time_s,ch1, ch1\n0,1,2\n", "column 'ch1' occurs twice"),
    (b"time_s,,ch1\n0,1,2\n", "column number 2 has no name"),
    (HEAD + b"0,1\n", ":2: has 2 cells, the first line 3"),
    (HEAD + b"0,1,2,3\n", ":2: has 4 cells, the first line 3"),
    (HEAD + b'0,"1,2\n', ":2: has 2 cells, the first line 3"),
    (b"time_s,ch\xe4\n0,1\n", "cannot be read as csv"),
    ("time_s,ch1\n0,1\n".encode("utf-16"), "cannot be read as csv"),
    (b"time_s,ch1", "cannot be read as csv"),
]


@pytest.mark.parametrize(("content", "line"), TABLES, ids=[line[:40] for _, line in TABLES])
def test_what_is_no_table(tmp_path: Path, content: bytes, line: str) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    with pytest.raises(FileFormatError) as caught:
        files.read_table(path)
    assert line in str(caught.value)
    assert "\n" not in str(caught.value)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    "content",
    [
        b"\xef\xbb\xbf" + HEAD + b"0,1,2\n", HEAD.replace(b"\n", b"\r\n") + b"0,1,2\r\n", HEAD + b'0," 1 ","2"\n',
        b"\xef\xbb\xbftime_s;ch1;ch2\r\n0,0;1;2\r\n", b"time_s;ch1;ch2\n0.0;1;2,0\n", b"time_s\tch1\tch2\n0\t1\t2\n",
    ],
)  # fmt: skip
def test_what_a_spreadsheet_writes_is_read(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(content)
    table = files.read_table(path)
    assert table.columns == ["time_s", "ch1", "ch2"]
    assert table.matrix(["time_s", "ch1", "ch2"]).tolist() == [[0, 1, 2]]


def test_empty_and_blank_cells_are_gaps_only_where_asked(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_bytes(HEAD + b"0,1,\n1, ,\n2,3,\n")
    table = files.read_table(path)
    assert np.isnan(table.numbers("ch1", gaps=True)).tolist() == [False, True, False]
    assert np.isnan(table.numbers("ch2", gaps=True)).all()
    with pytest.raises(FileFormatError, match=":3: ch1: is empty"):
        table.numbers("ch1")
    with pytest.raises(FileFormatError, match=r"column 'ch9' is missing. It has time_s, ch1, ch2"):
        table.numbers("ch9")


def test_parquet_cells(tmp_path: Path) -> None:
    path = tmp_path / "t.parquet"
    pq.write_table(
        pa.table(
            {
                "a": pa.array([1, None, 3], pa.int64()), "b": pa.array([1.0, float("nan"), 3.0]), "c": pa.array([True, False, True]),
                "d": pa.array([1.0, float("inf"), 3.0]), "e": pa.array([[1], [2], [3]]), "f": pa.array(["1", "2", "x"]),
                "g": pa.array(["u", "v", "u"]).dictionary_encode(),
            }
        ),
        path,
    )  # fmt: skip
    table = files.read_table(path)
    assert np.isnan(table.numbers("a", gaps=True)).tolist() == [False, True, False]
    assert np.isnan(table.numbers("b", gaps=True)).tolist() == [False, True, False], "in Parquet a missing float is often a NaN"
    assert table.labels("g").tolist() == ["u", "v", "u"]
    for column, line in (("a", "row 1: a: is empty"), ("b", "row 1: b: is empty"), ("d", "row 1: d: must be a finite number, is inf")):
        with pytest.raises(FileFormatError, match=line):
            table.numbers(column)
    for column in "cef":
        with pytest.raises(FileFormatError, match=rf"column '{column}'|row \d: {column}: "):
            table.numbers(column)
    path.write_bytes(path.read_bytes()[:100])
    with pytest.raises(FileFormatError, match="cannot be read as parquet"):
        files.read_table(path)


def test_only_csv_and_parquet(tmp_path: Path) -> None:
    (tmp_path / "t.xls").write_bytes(b"x")
    with pytest.raises(FileFormatError, match=r"is neither \.csv nor \.parquet"):
        files.read_table(tmp_path / "t.xls")
    with pytest.raises(FileFormatError, match=r"must end in \.csv or \.parquet"):
        files.write_table(tmp_path / "u.xls", {"a": np.zeros(1)})
    with pytest.raises(FileFormatError, match=r"cannot be read: Is a directory"):
        files.read_table(tmp_path)


def test_nothing_half_written_stays(tmp_path: Path) -> None:
    path = tmp_path / "deep" / "out.txt"
    path.parent.mkdir()
    path.write_text("before")

    def fail() -> None:
        with files.whole(path) as temporary:
            temporary.write_text("half")
            raise RuntimeError("power cut")

    with pytest.raises(RuntimeError, match="power cut"):
        fail()
    assert path.read_text() == "before"
    assert [p.name for p in path.parent.iterdir()] == ["out.txt"]
    files.write_text(path, "after\n")
    assert path.read_bytes() == b"after\n"


def test_where_nothing_can_be_written(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    for target in (tmp_path / "file" / "out.txt", tmp_path, Path()):
        with pytest.raises(LMeasureError, match="cannot be written"):
            files.write_text(target, "x")


def test_digest_is_that_of_the_bytes(tmp_path: Path) -> None:
    (tmp_path / "a").write_bytes(b"abc")
    assert files.sha256(tmp_path / "a") == "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad"


@pytest.mark.skipif(os.name == "nt", reason="pipes have no names there")
def test_no_digest_waits_for_a_pipe(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a")
    with pytest.raises(FileFormatError, match=r"a: cannot be read: it is no regular file"):
        files.sha256(tmp_path / "a")


def test_toml_round_trip(tmp_path: Path) -> None:
    data = {"a": 0.1, "b": [1.0, 2e-300], "t": {"x": "ä"}, "list": [{"n": 1}, {"n": 2}]}
    files.write_toml(tmp_path / "a.toml", data)
    assert files.read_toml(tmp_path / "a.toml") == data
