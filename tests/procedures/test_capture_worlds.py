"""Captures in simulated worlds: a reading that was acknowledged is in the folder, none is invented, and a further session continues."""

from pathlib import Path

import pytest
from capture_worlds import drawn, lived

SEEDS = (0, 3, 6, 9, 13)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_a_capture_leaves_is_true(seed: int, tmp_path: Path) -> None:
    assert lived(drawn(seed), tmp_path / "run").wrong == []


def test_a_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    first, again = (lived(drawn(13), tmp_path / "run") for _ in range(2))
    assert first == again
