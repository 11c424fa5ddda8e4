"""The harness of the studies in benchmarks: records are kept, continued and written."""

import importlib
import json
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

ROOT = Path(__file__).parents[1]


@pytest.fixture(scope="module")
def harness() -> Iterator[ModuleType]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT / "benchmarks")
        yield importlib.import_module("study")


def draw(seed: int, kind: str, size: int) -> dict[str, Any] | None:
    return None if seed == 3 else {"seed": seed, "kind": kind, "size": size}


def test_a_study_continues_from_what_is_kept_and_writes_its_page(
    harness: ModuleType, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    drawn: list[tuple[Any, ...]] = []

    def counted(*case: Any) -> dict[str, Any] | None:
        drawn.append(case)
        return draw(*case)

    def page(records: list[dict[str, Any]]) -> tuple[str, bool]:
        return harness.table(["kind", "n"], [[kind, sum(r["kind"] == kind for r in records)] for kind in ("a, b", "c")]), len(records) > 6

    study = harness.Study("none", counted, page, "draws", 2, {"kind": ("a, b", "c"), "size": (1, 2)}, "{kind} {seed} {size}")
    kept, out = tmp_path / "kept.jsonl", tmp_path / "page.md"
    out.write_text("# Title\n\n| kind | n |\n|---|---|\n| c | 0 |\n\nWords.\n")

    def command(*words: str) -> int:
        monkeypatch.setattr("sys.argv", ["study.py", *words, "--keep", str(kept)])
        return int(study.command("About 100 %."))

    with pytest.raises(SystemExit, match="none: no record was drawn, and none is kept"):
        command("--runs", "0")
    assert command("--draws", "4", "--kind", "c", "--size", "1,2") == 1
    assert drawn == [(seed, "c", size) for seed in range(4) for size in (1, 2)]
    assert command("--runs", "2", "--first", "1", "--kind", "a, b", "c", "--size", "2", "--out", str(out)) == 0
    assert drawn[8:] == [(1, "a, b", 2), (2, "a, b", 2)]
    assert [json.loads(line)[0] for line in kept.read_text().splitlines()][-1] == "a, b 2 2"
    assert out.read_text() == "# Title\n\n| kind | n |\n|---|---|\n| a, b | 2 |\n| c | 6 |\n\nWords.\n"
    with pytest.raises(SystemExit):
        command("--kind", "d")
    assert "choose from a, b, c" in capsys.readouterr().err


def test_shares_and_their_probability(harness: ModuleType) -> None:
    assert harness.percent([True, False, True]) == "66.7"
    assert harness.two_sided([True] * 4 + [False], 0.5) == pytest.approx(0.375)
