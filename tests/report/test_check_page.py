"""The page of an interim check: verdict and units as people write them, and a limit that is seen."""

from browser import opened
from pages import page_of


def test_a_verdict_is_seen_to_be_bad() -> None:
    with opened(page_of("check", "ru")) as page:
        verdict = page.evaluate("[...document.querySelectorAll('.verdict.bad')].map(e => e.textContent)")
        (line,) = page.evaluate("document.getElementById('closures').layout.shapes.map(s => s.x0)")
        low, high = page.evaluate("document.getElementById('closures').layout.xaxis.range")
        cells = page.evaluate("[...document.querySelectorAll('td')].map(e => e.textContent)")
    assert len(verdict) == 1
    assert verdict[0].startswith("Требуется калибровка")
    assert low == 0.0
    assert line < 0.96 * high
    # a degree stands at its number
    assert any(cell.endswith("°") for cell in cells)
    assert not any(cell.endswith((" °", "\u00a0°")) for cell in cells)
