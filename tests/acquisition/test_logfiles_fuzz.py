"""No mutated log loses a line or an object without a word."""

from collections import Counter
from pathlib import Path

from log_fuzz import run


def test_mutated_files_are_read_or_refused_in_one_line_and_accounted_for(tmp_path: Path) -> None:
    outcomes: Counter[tuple[str, str]] = Counter()
    run(tmp_path, 390, 0, lambda kind, outcome: outcomes.update([(kind, outcome)]))
    assert outcomes.total() == 390
    assert {outcome for _, outcome in outcomes} == {"accepted", "refused"}
