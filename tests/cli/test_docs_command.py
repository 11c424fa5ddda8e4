"""`lmeasure docs` finds the documentation of a copy of the repository, and says where it is otherwise."""

from pathlib import Path

import pytest
from in_process import ran, refused

from lmeasure.workflows import demo as docs


@pytest.fixture
def source(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A repository with one page, whose site is built by a script of one line."""
    pages = tmp_path / "docs"
    pages.mkdir()
    for name in ("README.md", "zone.md", "../README.md"):
        (pages / name).write_text("# Page\n")
    site = tmp_path / "build" / "docs"
    (pages / "build_site.py").write_text(
        f"import pathlib\np = pathlib.Path({str(site)!r})\np.mkdir(parents=True)\n(p / 'index.html').touch()\n"
    )
    monkeypatch.setattr(docs, "SOURCE", pages)
    return tmp_path


def test_pages_are_built_once_and_opened(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs, "find_spec", lambda name: object())
    assert ran("docs").splitlines()[0] == f"documentation: {source / 'build/docs/index.html'}"
    (source / "docs" / "build_site.py").write_text("raise SystemExit('built again')")
    assert ran("docs", "zone").splitlines()[0] == f"documentation: {source / 'build/docs/docs/zone.html'}"


@pytest.mark.parametrize(
    ("arguments", "code", "line"),
    [(["zoom"], 2, "'zoom' is not one of zone"), ([], 1, "Sphinx is not installed here. Run: python3 run.py docs")],
)
def test_what_cannot_be_opened_is_one_line(
    source: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], code: int, line: str
) -> None:
    monkeypatch.setattr(docs, "find_spec", lambda name: None)
    assert line in refused("docs", *arguments, code=code)


def test_a_site_that_cannot_be_built_and_an_installed_package(source: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(docs, "find_spec", lambda name: object())
    (source / "docs" / "build_site.py").write_text("raise SystemExit('zone.md: unknown link')")
    assert "cannot be built: zone.md: unknown link" in refused("docs")
    monkeypatch.setattr(docs, "SOURCE", source / "nowhere")
    assert "not part of an installed package" in refused("docs")
