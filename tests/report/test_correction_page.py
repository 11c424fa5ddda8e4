"""The page of a corrected program."""

import re

import pytest
from pages import page_of


@pytest.mark.slow
def test_errors_of_targets_that_were_left_are_not_hidden_by_those_that_were_corrected() -> None:
    """13 of 20 targets stay up to 2.4 mm off, while the corrected ones arrive."""
    page = page_of("correction", "en").read_text(encoding="utf-8").replace("\u00a0", " ")
    rows = [re.findall(r"<td[^>]*>(.*?)</td>", row) for row in re.findall(r"<tr>(.*?)</tr>", page, re.DOTALL)]
    left = [float(row[4]) for row in rows if len(row) == 7 and row[4] and row[6]]
    corrected = [float(row[4]) for row in rows if len(row) == 7 and row[4] and not row[6]]
    assert max(left) > max(corrected) + 0.1
    reported = dict(re.findall(r"<dt>([^<]*)(?:<small>.*?</small>)?</dt><dd[^>]*>([0-9.]+)", page))
    assert float(reported["Largest error, before and after"]) == max(corrected)
    assert float(reported["largest error of uncorrected targets"]) == max(left)
