"""The tables of docs/published-rig.md are those that its benchmark computes."""

import importlib.util
from pathlib import Path

ROOT = Path(__file__).parents[2]
PAGES = ("docs/published-rig.md", "benchmarks/results/published_rig.md")


def test_tables_are_computed() -> None:
    spec = importlib.util.spec_from_file_location("published_rig", ROOT / "benchmarks" / "published_rig.py")
    assert spec is not None
    assert spec.loader is not None
    study = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(study)
    tables = ["\n".join(table) for table in (study.coarse_table(), study.fine_table())]
    for page in PAGES:
        text = (ROOT / page).read_text(encoding="utf-8")
        for table in tables:
            assert table in text, f"{page}: a table is not\n{table}"
