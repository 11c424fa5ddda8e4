"""The tables of docs/published-rig.md are those that its benchmark computes."""

import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ("docs/published-rig.md", "benchmarks/results/published_rig.md")


def test_tables_are_computed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(ROOT / "benchmarks")
    study = importlib.import_module("published_rig")
    tables = ["\n".join(table) for table in (study.coarse_table(), study.fine_table())]
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        for table in tables:
            assert table in text, f"{page}: a table is not\n{table}"
