"""What no line of a page breaks: numbers and their units, coordinates, options."""

import pytest

from lmeasure.report import html
from lmeasure.report.readable import page_text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("within 0.1 mm, 80 % of 7 counts", "within 0.1~mm, 80~% of 7~counts"),
        ("на 3,5 мм/с² при 5 К", "на 3,5~мм/с² при 5~К"),
        ("7 minutes, 3 msec, 12 kgs", "7 minutes, 3 msec, 12 kgs"),
        # a column would be wider than its numbers
        ("first length, mm", "first length, mm"),
        ("p = 0.001, probability < 10⁻⁹ (u 0.2)", "p~=~0.001, probability &lt;~10⁻⁹ (u~0.2)"),
        ("about (0.5, -1, 20) and (1; -2,5)", "about (0.5,~-1,~20) and (1;~-2,5)"),
        ("(a, b) and (1 of 2)", "(a, b) and (1 of 2)"),
        ("say --u-mm (--limit)", 'say <span class="kept">--u-mm</span> (<span class="kept">--limit</span>)'),
        ("or --solve eccentricity:B5 <now>", 'or <span class="kept">--solve eccentricity:B5</span> &lt;now&gt;'),
        ("a -- b, x--y", "a -- b, x--y"),
    ],
)
def test_what_belongs_together(text: str, expected: str) -> None:
    assert html.kept(text) == expected.replace("~", "\u00a0")


def test_what_is_ready_stays() -> None:
    assert html.kept(html.Ready("<b>0.1 mm --x</b>")) == "<b>0.1 mm --x</b>"


def test_a_page_says_the_same_as_without() -> None:
    """Sealed pages of before are compared by their words."""
    said = "state it (--u-mm), 0.1 mm or --solve eccentricity:B5."
    assert page_text(html.paragraph(said).encode()) == page_text(f"<p>{said}</p>".encode()) == said
    assert page_text(b"<td>a<small>b</small></td><td>c</td>") == "a b c"
