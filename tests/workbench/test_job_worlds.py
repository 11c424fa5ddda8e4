"""Jobs of a workbench, and a store, in simulated worlds: what was told is there, files are whole, a further server continues."""

from collections.abc import Callable
from pathlib import Path

import pytest
from job_worlds import Workbench, drawn, lived, stored
from worlds import Outcome

Live = Callable[[Workbench, Path], Outcome]


@pytest.mark.parametrize(("live", "seeds"), [(lived, range(40)), (stored, range(6))])
def test_what_a_world_leaves_is_true(live: Live, seeds: range, tmp_path: Path) -> None:
    assert {seed: wrong for seed in seeds if (wrong := live(drawn(seed), tmp_path / "run").wrong)} == {}


@pytest.mark.parametrize("live", [lived, stored])
def test_a_seed_gives_the_same_bytes(live: Live, tmp_path: Path) -> None:
    first, again = (live(drawn(4), tmp_path / "run") for _ in range(2))
    assert first == again


def test_the_seeds_of_the_suite_have_each_fault() -> None:
    faults = {fault for seed in range(40) for fault in drawn(seed).faults}
    assert faults == {"disk: error", "disk: full", "disk: interrupted", "disk: killed", "disk: part"}
