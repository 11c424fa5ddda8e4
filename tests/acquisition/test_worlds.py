"""Recordings in simulated worlds, each from one seed: no sample that was shown is lost, none invented, files are whole or absent."""

from pathlib import Path

import pytest
from worlds import drawn, lived

SEEDS = (1, 2, 13, 27, 28, 37, 41)


@pytest.mark.parametrize("seed", SEEDS)
def test_what_a_world_leaves_is_true(seed: int, tmp_path: Path) -> None:
    assert lived(drawn(seed, 150), tmp_path / "run").wrong == []


def test_a_seed_gives_the_same_bytes(tmp_path: Path) -> None:
    first, again = (lived(drawn(4, 150), tmp_path / "run") for _ in range(2))
    assert first == again


def test_the_seeds_of_the_suite_have_each_fault() -> None:
    faults = {fault.split(":")[0] for seed in SEEDS for fault in drawn(seed, 150).faults}
    assert faults == {
        "another sender", "bus off", "clock set", "disk", "doubled", "encoder starts again", "junk", "late", "lost", "no frames", "pause",
        "silent channel", "slow disk",
    }  # fmt: skip
