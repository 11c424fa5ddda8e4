"""What no line of a page breaks: numbers and their units, coordinates, dates, options; and where a long name is broken."""

import pypdfium2
import pytest
import typst
from markupsafe import Markup

from lmeasure.report import certificate_pdf, html
from lmeasure.report.readable import page_text


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("within 0.1 mm, 80 % of 7 counts", "within 0.1~mm, 80~% of 7~counts"),
        ("на 3,5 мм/с² при 5 К", 'на 3,5~<span class="kept">мм/с²</span> при 5~К'),
        ("mm/s; 0.1 ± 0.2 m/s, and/or m/s/x", '<span class="kept">mm/s</span>; 0.1~±~0.2~<span class="kept">m/s</span>, and/or m/s/x'),
        ("7 minutes, 3 msec, 12 kgs", "7 minutes, 3 msec, 12 kgs"),
        # a column would be wider than its numbers
        ("first length, mm", "first length, mm"),
        ("p = 0.001, probability < 10⁻⁹ (u 0.2)", "p~=~0.001, probability &lt;~10⁻⁹ (u~0.2)"),
        ("about (0.5, -1, 20) and (1; -2,5)", "about (0.5,~−1,~20) and (1;~−2,5)"),
        ("(a, b) and (1 of 2)", "(a, b) and (1 of 2)"),
        ("say --u-mm (--limit)", 'say <span class="kept">--u-mm</span> (<span class="kept">--limit</span>)'),
        ("or --solve eccentricity:B5 <now>", 'or <span class="kept">--solve eccentricity:B5</span> &lt;now&gt;'),
        ("a -- b, x--y", "a -- b, x--y"),
        ("1.6·10⁷ mm³, at (1, -2) mm, off by 1 mm, mm", "1.6·10⁷~mm³, at (1,~−2) mm, off by 1~mm,~mm"),
        ("0,8 мм на мм, 0.8 mm per mm", "0,8~мм на~мм, 0.8~mm per~mm"),
        ("50 : 1; 2 × 3 × 4 mm; 21,5 ± 0,5 °C; a : 1", "50~:~1; 2~×~3~×~4~mm; 21,5~±~0,5~°C; a : 1"),
        ("of 2026-03-02, 0001-2026-03-02", 'of <span class="kept">2026-03-02</span>, 0001-2026-03-02'),
        ("report LM-0123ABCD-4567CDEF", 'report <span class="kept">LM-0123ABCD-4567CDEF</span>'),
        ("from -1 to -2.5, a-1, 1-2, -x, --1, P-3", "from −1 to −2.5, a-1, 1-2, -x, --1, P-3"),
        ("a_b <a_very_long/name_of_a_path>", "a_b &lt;a_<wbr>very_<wbr>long/<wbr>name_<wbr>of_<wbr>a_<wbr>path&gt;"),
    ],
)
def test_what_belongs_together(text: str, expected: str) -> None:
    assert html.kept(text) == expected.replace("~", "\u00a0")


def test_what_is_ready_stays() -> None:
    assert html.kept(Markup("<b>0.1 mm --x</b>")) == "<b>0.1 mm --x</b>"


def test_a_page_says_the_same_as_without() -> None:
    """Sealed pages of before are compared by their words."""
    said = "state it (--u-mm), 0.1 mm or --solve eccentricity:B5."
    assert page_text(html.kept(said).encode()) == page_text(f"<p>{said}</p>".encode()) == said
    named = "by a_very_long_name_of_a_path of 2026-03-02"
    assert page_text(html.kept(named).encode()) == named
    assert page_text(b"<td>a<small>b</small></td><td>c</td>") == "a b c"


def test_sheets_are_set_from_texts_that_are_kept_together() -> None:
    svg = "<svg>0.1 mm</svg>"
    reported = html.on_paper({"a": ["within 0.1 mm", 3, None, svg], "b": (("U", "95"), True)})
    assert reported == {"a": ["within 0.1\u00a0mm", 3, None, svg], "b": [["U", "95"], True]}


@pytest.mark.parametrize(
    ("width", "name", "lines"),
    [
        (46, "path Bahn_von_Greifposition_zu_Ablageposition_rest", ["path Bahn_von_", "Greifposition_zu_", "Ablageposition_rest"]),
        (60, "inputs/run/another-folder/trajectory.parquet", ["inputs/run/another-folder/", "trajectory.parquet"]),
        # what has no joint is broken anywhere rather than run out of its cell
        (40, "long" * 9, ["longlonglonglonglongl", "onglonglonglong"]),
        (200, "of " + "0123456789abcdef" * 4, ["of " + "0123456789abcdef" * 4]),
    ],
)
def test_where_a_long_name_is_broken_on_paper(width: int, name: str, lines: list[str]) -> None:
    template = certificate_pdf.TEMPLATE.read_text(encoding="utf-8")
    rules = template[template.index("#let piece") : template.index("// symbols")]
    page = f"#set page(width: {width}mm, height: 40mm, margin: 4mm)\n#set text(size: 9.5pt)\n"
    pdf = typst.compile(f'{page}{rules}#fit("{name}")'.encode(), ignore_system_fonts=True)
    document = pypdfium2.PdfDocument(pdf)
    assert document[0].get_textpage().get_text_bounded().split("\r\n") == lines
    document.close()
