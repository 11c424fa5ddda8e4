"""Every page that the program writes, in fresh windows from a telephone to a wall, in both languages: nothing runs over, is clipped,
collides, or asks for anything outside. PDFs beside them: no text lies beyond its sheet or on another.
`LMEASURE_PICTURES=FOLDER pytest -m slow tests/report/test_every_page.py` keeps pictures of them."""

import base64
import itertools
import os
import re
from pathlib import Path

import pypdfium2
import pytest
from browser import LOOK, opened
from pages import PAGES, PDFS, page_of

SIZES = ((390, 1.0), (2560, 1.0), (1400, 1.0), (2000, 1.0), (3840, 1.0), (2800, 0.5), (700, 2.0))
"""Windows: their width and zoom; the last ones are a desk of 1400 px at 50 and at 200 %. Pages of the suite are opened in the first two."""
QUICK = (("zone", "ru"), ("calibration", "en"))
EVERY = [
    *((kind, language, SIZES[:2]) for kind, language in QUICK),
    *(pytest.param(kind, language, SIZES, marks=pytest.mark.slow) for kind in PAGES for language in ("en", "ru")),
]
DRAWN = "[...document.querySelectorAll('.js-plotly-plot')].every(e => e._fullLayout)"
TWO_FRAMES = "new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))"


@pytest.mark.parametrize(("kind", "language", "sizes"), EVERY)
def test_nothing_runs_over_collides_or_asks_for_anything(kind: str, language: str, sizes: tuple[tuple[int, float], ...]) -> None:
    """In a fresh window of each width, as a person opens it, at another zoom, in a window made narrow, and on paper."""
    page = page_of(kind, language)
    pictures = Path(os.environ["LMEASURE_PICTURES"]) if "LMEASURE_PICTURES" in os.environ else None
    reported, errors, requests = [], [], []
    for width, zoom in sizes:
        with opened(page, size=(width, zoom)) as shown:
            shown.wait(DRAWN)
            shown.evaluate(TWO_FRAMES)
            reported += [f"{width} at {zoom}: {text}" for text in shown.evaluate(LOOK)]
            if pictures and zoom == 1.0:
                (pictures / f"{kind}-{language}-{width}.png").write_bytes(base64.b64decode(shown.shoot()))
            if width == 2560:
                # what was drawn wide has to find its room again when the window is made narrow
                shown.resize(390)
                reported += [f"made narrow: {text}" for text in shown.evaluate(LOOK)]
                shown.resize(2560)
                reported += [f"on paper: {text}" for text in beyond(shown.printed(), pictures and pictures / f"{kind}-{language}-paper")]
                shown.evaluate(TWO_FRAMES)
                reported += [f"after printing: {text}" for text in shown.evaluate(LOOK)]
            errors += shown.errors
            requests += shown.requests
    assert reported == [], "\n".join(reported)
    assert errors == []
    assert [url[:80] for url in requests if not url.startswith(("file:", "data:", "blob:"))] == []
    for name in PDFS:
        if (page.parent / name).exists():
            assert faults_of(page.parent / name) == []
            if pictures:
                document = pypdfium2.PdfDocument(page.parent / name)
                for number, sheet in enumerate(document, 1):
                    sheet.render(scale=1.5).to_pil().save(pictures / f"{kind}-{language}-sheet{number}.png")
                document.close()


def beyond(pdf: bytes, pictures: Path | None = None) -> list[str]:
    """Lines of a printed page that lie beyond their sheet, or that it is printed small for something else that does; pictures is the
    beginning of the names under which its sheets are kept."""
    document, out, widest = pypdfium2.PdfDocument(pdf), [], 0.0
    for number, sheet in enumerate(document, 1):
        width = sheet.get_size()[0]
        text = sheet.get_textpage()
        for left, bottom, right, top in (text.get_rect(i) for i in range(text.count_rects())):
            widest = max(widest, right / width)
            if left < -1.0 or right > width + 1.0:
                out.append(f"sheet {number}: {text.get_text_bounded(left, bottom, right, top)!r} lies beyond it")
        if pictures:
            sheet.render(scale=1.0).to_pil().save(f"{pictures}{number}.png")
    document.close()
    return out if widest > 0.8 else [*out, f"printed small: {widest:.0%} of a sheet's width"]


def faults_of(pdf: Path) -> list[str]:
    """Lines of text that lie beyond their sheet, or on another; sheets that are not numbered one after the other."""
    document, out = pypdfium2.PdfDocument(pdf), []
    for number, sheet in enumerate(document, 1):
        width, height = sheet.get_size()
        text = sheet.get_textpage()
        numbers = f"{number} (of|из) {len(document)}"
        if not re.search(numbers, text.get_text_bounded()):
            out.append(f"sheet {number} is not numbered so")
        boxes = [text.get_rect(i) for i in range(text.count_rects())]
        lines = [(box, text.get_text_bounded(*box)) for box in boxes]
        for (left, bottom, right, top), said in lines:
            if left < 0.0 or bottom < 0.0 or right > width or top > height:
                out.append(f"sheet {number}: {said!r} lies beyond it")
        for (a, one), (b, other) in itertools.combinations(lines, 2):
            across, along = min(a[2], b[2]) - max(a[0], b[0]), min(a[3], b[3]) - max(a[1], b[1])
            # an index reaches into the height of its line
            if across > 2.0 and along > 0.6 * min(a[3] - a[1], b[3] - b[1]):
                out.append(f"sheet {number}: {one!r} and {other!r} collide by {across:.1f} x {along:.1f}")
    document.close()
    return out


def test_the_check_sees_what_it_is_for(tmp_path: Path) -> None:
    """A page with every fault it looks for."""
    page = tmp_path / "bad.html"
    svg = '<svg viewBox="0 0 100 20" width="100"><text x="1" y="10">one</text><text x="6" y="10">two</text>'
    svg += '<text x="90" y="10">beyond</text></svg>'
    broken = '<p style="width: 4em">as much as 0.1 mm, --many-mm</p>'
    page.write_text(
        f'{broken}<p style="width: 3000px">wide</p><figure><div class="drawn">{svg}</div></figure><img src="http://127.0.0.1:9/x.png">'
    )
    with opened(page) as shown:
        shown.resize(1400)
        reported = " ".join(shown.evaluate(LOOK))
    assert "the page is 30" in reported
    assert "'two' and 'one' collide" in reported
    assert "'beyond' is clipped" in reported
    assert "'wide' runs over" in reported
    assert "'1 mm' of 'as much as 0.1 mm, --many-mm' is in two lines" in reported
    assert "'--many-mm' of 'as much as 0.1 mm, --many-mm' is in two lines" in reported
    assert any(url.startswith("http://127.0.0.1") for url in shown.requests)


def test_the_check_of_sheets_sees_what_it_is_for(tmp_path: Path) -> None:
    typst = pytest.importorskip("typst")
    lines = "#set page(width: 100pt, height: 100pt)\n#place(dx: 0pt)[one]\n#place(dx: 6pt)[two]\n#place(dx: 80pt, dy: 30pt)[beyond it]"
    (tmp_path / "bad.pdf").write_bytes(typst.compile(lines.encode()))
    reported = " ".join(faults_of(tmp_path / "bad.pdf"))
    assert "collide" in reported
    assert "lies beyond it" in reported
    assert "sheet 1 is not numbered" in reported
