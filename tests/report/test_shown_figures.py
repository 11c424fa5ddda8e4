"""Figures of `lmeasure.plot` show themselves without a request to anywhere, in a notebook and by `show`."""

import re
from pathlib import Path
from typing import Any, cast

import pytest
from browser import opened
from IPython.core import displaypub, interactiveshell

import lmeasure as lm
from lmeasure.report import plots
from lmeasure.simulation import cell_rig

FETCHED = re.compile(r"""<(?:script|link|img)[^>]*(?:src|href)\s*=\s*["']?https?:""")


@pytest.fixture(scope="module")
def figure() -> Any:
    return lm.plot(cell_rig(1))


def test_a_cell_draws_it_and_asks_for_nothing(figure: Any, tmp_path: Path) -> None:
    """As a front end does that has no drawing of its own: the HTML of the output in its page."""
    bundle = figure._repr_mimebundle_()
    assert set(bundle) == {plots.JSON, "text/html"}
    assert len(bundle[plots.JSON]["data"]) == len(figure.data)
    (tmp_path / "cell.html").write_text(f"<!doctype html><meta charset=utf-8><body>{bundle['text/html']}</body>", encoding="utf-8")
    with opened(tmp_path / "cell.html") as page:
        page.wait("Boolean(document.querySelector('.js-plotly-plot')?._fullLayout)")
        assert [url[:80] for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
        assert page.errors == []


def test_show_below_a_cell(figure: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    kind, publisher = cast("Any", interactiveshell).InteractiveShell, cast("Any", displaypub).CapturingDisplayPublisher
    shell = kind()
    monkeypatch.setattr(kind, "_instance", shell)
    shell.kernel = object()  # as the shell of a notebook has one
    shell.display_pub = publisher()
    figure.show()
    (shown,) = shell.display_pub.outputs
    assert set(shown["data"]) == {plots.JSON, "text/html"}
    assert not FETCHED.search(shown["data"]["text/html"])


def test_show_in_a_browser(figure: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    requested: list[str] = []
    monkeypatch.setattr("webbrowser.open", requested.append)
    monkeypatch.setattr("tempfile.mkdtemp", lambda prefix: str(tmp_path))
    figure.show()
    assert requested == [(tmp_path / "figure.html").as_uri()]
    assert not FETCHED.search((tmp_path / "figure.html").read_text(encoding="utf-8"))


def test_the_search_for_what_is_fetched_finds_what_plotly_itself_does(figure: Any) -> None:
    import plotly.io as pio

    assert FETCHED.search(pio.base_renderers.HtmlRenderer().to_mimebundle(figure.to_dict())["text/html"])
