"""A few seconds of what benchmarks/fuzz_logs.py does for as long as one likes."""

from collections import Counter
from pathlib import Path

import pytest
from log_fuzz import run


@pytest.mark.parametrize("seed", range(4))
def test_mutated_files_are_read_or_refused_in_one_line(tmp_path: Path, seed: int) -> None:
    outcomes: Counter[tuple[str, str]] = Counter()
    run(tmp_path, 350, seed, lambda kind, outcome: outcomes.update([(kind, outcome)]))
    assert outcomes.total() == 350
    assert {outcome for _, outcome in outcomes} == {"accepted", "refused"}
