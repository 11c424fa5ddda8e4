"""The first screen of each kind of page gives five answers and a picture; docs/blind-test.md is the checklist of readers."""

import json
import re
from typing import Any

import pypdfium2
import pypdfium2.raw as pdfium
import pytest
from access import faults
from browser import opened
from pages import PAGES, ROOT, page_of

ANSWERS = ("measured", "verdict", "numbers", "limits", "next", "picture")
SCREENS = ((390, 844), (1400, 900))
QUICK = ("calibration", "trajectory-foreign", "zone-empty", "certificate", "structures", "mechanism")
KINDS = [kind if kind in QUICK else pytest.param(kind, marks=pytest.mark.slow) for kind in PAGES]
BEGIN = """[...document.querySelectorAll('[data-answer]')].filter(e => e.textContent.trim() || e.querySelector('svg'))
  .map(e => [e.dataset.answer, e.getBoundingClientRect().top, e.scrollWidth > e.clientWidth + 1])"""


@pytest.mark.parametrize("kind", KINDS)
def test_the_first_screen_answers(kind: str) -> None:
    language = "ru" if kind in QUICK and KINDS.index(kind) % 2 else "en"
    with opened(page_of(kind, language), size=(SCREENS[0][0], 1.0)) as page:
        for width, height in SCREENS:
            page.resize(width, height)
            shown: list[Any] = page.evaluate(BEGIN)
            assert sorted({name for name, _, _ in shown}) == sorted(ANSWERS)
            # a picture of which only the beginning is seen is none
            below = [name for name, top, _ in shown if top > height - (120 if name == "picture" else 40)]
            assert below == [], (width, shown)
            assert page.evaluate("document.documentElement.scrollWidth") <= width
        screens = page.evaluate("document.documentElement.scrollHeight / innerHeight")
        assert screens <= (6.0 if kind.startswith("certificate") else 4.0)  # at 1400 px, details folded
        assert faults(page) == []
        assert page.errors == []


def test_every_page_is_in_the_checklist() -> None:
    told = (ROOT / "docs" / "blind-test.md").read_text(encoding="utf-8")
    for name in {kind.partition("-")[0] for kind in PAGES}:
        assert re.search(rf"^\| {name} ", told, re.MULTILINE), name


def test_a_certificate_on_paper_has_a_structure() -> None:
    """Its tags, as a screen reader follows them: headings, tables with headers, pictures with a text."""
    document = pypdfium2.PdfDocument(page_of("certificate", "en").parent / "certificate.pdf")
    found: dict[str, int] = {}
    for page in document:
        tree = pdfium.FPDF_StructTree_GetForPage(page.raw)
        for i in range(pdfium.FPDF_StructTree_CountChildren(tree)):
            _count(pdfium.FPDF_StructTree_GetChildAtIndex(tree, i), found)
        pdfium.FPDF_StructTree_Close(tree)
    document.close()
    assert {"H1", "H2", "H3", "Table", "TR", "TH", "TD", "Figure"} <= set(found), json.dumps(found)
    assert found["TH"] >= 5 * found["H3"] // 2
    assert found.get("Figure without a text", 0) == 0


def _count(element: Any, found: dict[str, int]) -> None:
    if not element:
        return
    size = pdfium.FPDF_StructElement_GetType(element, None, 0)
    buffer = bytearray(size)
    pdfium.FPDF_StructElement_GetType(element, (pdfium.ctypes.c_char * size).from_buffer(buffer), size)
    kind = buffer.decode("utf-16-le").rstrip("\0")
    found[kind] = found.get(kind, 0) + 1
    if kind == "Figure" and pdfium.FPDF_StructElement_GetAltText(element, None, 0) <= 2:
        found["Figure without a text"] = found.get("Figure without a text", 0) + 1
    for i in range(pdfium.FPDF_StructElement_CountChildren(element)):
        _count(pdfium.FPDF_StructElement_GetChildAtIndex(element, i), found)
