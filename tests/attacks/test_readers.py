"""Attempts to do harm by a file, for every reader: each is read or refused in a line; nothing is shown or written elsewhere."""

import zlib
from collections.abc import Iterator
from pathlib import Path

import pytest
from readers import attempts, judged, readers

FOUND = sorted((Path(__file__).parent / "found").iterdir())


def some(name: str) -> Iterator[bytes]:
    """Yield a share of the attempts with a reader: another one each time the reader or the attempts change."""
    every = list(attempts(readers()[name]))
    step = max(len(every) // 60, 1)
    yield from every[zlib.crc32(name.encode()) % step :: step]


@pytest.mark.parametrize("name", readers())
def test_a_right_file_is_read_or_refused_in_a_line(name: str, tmp_path: Path) -> None:
    assert judged(readers()[name], readers()[name].right, tmp_path) == ""


@pytest.mark.parametrize("name", readers())
def test_no_file_does_harm(name: str, tmp_path: Path) -> None:
    wrong = {text for content in some(name) if (text := judged(readers()[name], content, tmp_path))}
    assert wrong == set()


@pytest.mark.slow
@pytest.mark.parametrize("name", readers())
def test_none_of_all_attempts_does_harm(name: str, tmp_path: Path) -> None:
    wrong = {text for content in attempts(readers()[name]) if (text := judged(readers()[name], content, tmp_path))}
    assert wrong == set()


def test_the_list_is_long() -> None:
    assert sum(1 for one in readers().values() for _ in attempts(one)) >= 1500


@pytest.mark.parametrize("path", FOUND, ids=lambda path: path.name)
def test_inputs_that_were_found_are_refused_in_a_line(path: Path, tmp_path: Path) -> None:
    name = max((one for one in readers() if path.name.startswith(one.replace(" ", "-"))), key=len)
    assert judged(readers()[name], path.read_bytes(), tmp_path) == ""
