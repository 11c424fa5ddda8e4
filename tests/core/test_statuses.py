"""Statuses: words and numbers that files and kept compiled code rely on."""

from pathlib import Path

import numpy as np

from lmeasure.core import WORDS, Status, words
from lmeasure.io import files
from lmeasure.kernels import screw

CONTRACT = ("ok", "singular", "not_converged", "gap", "jump", "slack", "other_assembly", "inconsistent", "origin_lost")


def test_words_and_numbers_are_the_contract_s() -> None:
    assert {status.word: int(status) for status in Status} == {word: number for number, word in enumerate(CONTRACT)}
    assert WORDS == CONTRACT


def test_kernels_hold_the_same_numbers() -> None:
    """As plain integers, which is what numba takes for a constant."""
    held = {name: getattr(screw, name) for name in Status.__members__}
    assert held == {name: status.value for name, status in Status.__members__.items()}
    assert {type(number) for number in held.values()} == {int}


def test_a_column_of_words_is_read_as_its_numbers(tmp_path: Path) -> None:
    status = np.array([8, 0, 3, 0, 7, 6, 5, 4, 2, 1])
    files.write_table(tmp_path / "s.csv", {"status": words(status)})
    assert (tmp_path / "s.csv").read_text(encoding="utf-8").replace('"', "").split()[1:4] == ["origin_lost", "ok", "gap"]
    np.testing.assert_array_equal(files.read_table(tmp_path / "s.csv").choices("status", WORDS), status)
