"""Attempts to do harm by a file, for every reader: each is read or refused in a line; nothing is shown or written elsewhere."""

import zipfile
import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from readers import attempts, judged, readers

QUICK = (
    "any toml", "bodies", "run", "calibration", "counts", "poses", "table", "zone", "parquet", "urdf", "dcc", "rig", "robot", "mcap",
    "program ls", "program mod", "program src", "program script",
)  # fmt: skip
"""Readers that the suite attacks; the marked test attacks all."""


def some(name: str) -> Iterator[bytes]:
    """Yield a share of the attempts with a reader: another one each time the reader or the attempts change."""
    every = list(attempts(readers()[name]))
    step = max(len(every) // 20, 1)
    yield from every[zlib.crc32(name.encode()) % step :: step]


def found_by_fuzzing(name: str) -> Iterator[bytes]:
    """Yield inputs that reach different parts of a reader (benchmarks/fuzz_readers.py)."""
    with zipfile.ZipFile(Path(__file__).parent / "corpus.zip") as corpus:
        yield from (corpus.read(one) for one in corpus.namelist() if one.startswith(name.replace(" ", "-") + "/"))


@pytest.mark.parametrize("name", QUICK)
def test_no_file_does_harm(name: str, tmp_path: Path) -> None:
    wrong = {text for content in (*some(name), *found_by_fuzzing(name)) if (text := judged(readers()[name], content, tmp_path))}
    assert wrong == set()


@pytest.mark.slow
def test_none_of_all_attempts_does_harm(tmp_path: Path) -> None:
    wrong = set()
    for name, one in readers().items():
        (tmp_path / name).mkdir()
        wrong |= {(name, text) for content in attempts(one) if (text := judged(one, content, tmp_path / name))}
    assert wrong == set()
