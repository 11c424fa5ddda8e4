"""A certificate as people read it: PDF read back page by page, page opened in a browser, texts in every language, hostile names."""

import base64
import hashlib
import re
from html import unescape
from pathlib import Path
from typing import Any

import pypdfium2
import pytest
from browser import LOOK, opened
from campaigns import write_campaign

from lmeasure.certificate import Inputs
from lmeasure.core import CertificationError
from lmeasure.iso9283 import CertificationSettings
from lmeasure.report import Choices, certificate_text as say, html, word, write_certificate
from lmeasure.report.certificate_figures import _LINES
from lmeasure.report.readable import page_text
from lmeasure.text import message

HOSTILE = {
    "P1": "<script>window.hacked=1</script>",
    "P2": '"><img src=x onerror="window.hacked=2">',
    "P3": "#panic(1) $x^2$ *b* =cmd|' /C calc'!A0 \u6f22 " + "long" * 30,
    "line": "</script><svg onload=window.hacked=3> `a` <b>line</b> javascript:alert(1)",
}
DETAILS = """
schema = "lmeasure.report/1"
number = "2026-017"
location = "Hall 3"
traceability = "Reference poses by tracker, certificate 123"
remarks = "#let x = 1 <script>window.hacked=4</script> =HYPERLINK(1)"
[laboratory]
name = "<img src=x onerror=window.hacked=5> \u041b\u0430\u0431\u043e\u0440\u0430\u0442\u043e\u0440\u0438\u044f"
[customer]
name = "Customer & Co"
[item]
serial = "R-0001"
[dates]
measured_from = 2026-03-02
measured_to = "2026-03-03"
[conditions]
temperature_c = 21.5
[authoriser]
name = "A. Head"
"""


@pytest.fixture(scope="module")
def campaign(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("hostile")
    write_campaign(folder, HOSTILE)
    (folder / "details.toml").write_text(DETAILS, encoding="utf-8")
    return folder


def certified(campaign: Path, out: Path, language: str, details: bool = True) -> dict[str, Any]:
    given = Inputs(
        campaign / "trajectory.parquet", campaign / "program.toml", campaign / "run", details=campaign / "details.toml" if details else None
    )
    return write_certificate(out, given, CertificationSettings(), Choices(language))


@pytest.fixture(scope="module")
def english(campaign: Path) -> tuple[Path, dict[str, Any]]:
    return campaign / "en", certified(campaign, campaign / "en", "en")


@pytest.fixture(scope="module")
def russian(campaign: Path) -> tuple[Path, dict[str, Any]]:
    return campaign / "ru", certified(campaign, campaign / "ru", "ru", details=False)


def stated_in(content: dict[str, Any]) -> dict[str, str]:
    return {row[0]: row[1] for row in say.about(content)}


def pages_of(path: Path) -> list[str]:
    document = pypdfium2.PdfDocument(path)
    texts = [page.get_textpage().get_text_bounded() for page in document]
    document.close()
    return texts


def flat(text: str) -> str:
    """Without the places where a long word may break, and where lines do."""
    return "".join(text.replace("\u200b", "").replace("\ufffe", "").split())


def test_every_page_is_identified_and_the_last_ends(english: tuple[Path, dict[str, Any]]) -> None:
    folder, content = english
    pages = pages_of(folder / "certificate.pdf")
    assert len(pages) > 1
    for number, text in enumerate(pages, 1):
        assert content["id"] in text
        assert f"page {number} of {len(pages)}" in text
        assert "The results relate only to the item tested." in text
    assert f"End of report {content['id']}" in pages[-1]
    assert not any("End of report" in text for text in pages[:-1])
    raw = (folder / "certificate.pdf").read_bytes()
    assert raw.startswith(b"%PDF-1.7")
    assert b"pdfaid" in raw


def test_no_bare_number_and_nothing_unstated_passed_over(english: tuple[Path, dict[str, Any]]) -> None:
    folder, content = english
    text = " ".join(pages_of(folder / "certificate.pdf"))
    assert text.startswith("Robot test report, ISO 9283:1998")
    assert flat("No accreditation is stated") in flat(text)
    rows = [row for test in say.results(content) for _, row in test.rows]
    assert len(rows) == len(content["characteristics"])
    for row in rows:
        assert row.u95.startswith("±\u00a0")  # the sign never stands alone on a line
        assert row.verdict
        assert flat(f"{row.value}{row.u95}{row.unit}").replace("-", "\u2212") in flat(text)
        assert float(row.k) > 0
        assert flat(row.k) in flat(text)
    # in one row what nobody stated, and rows of their own for those who ask for them
    lacking = ("customer.address", "sampling", "dates.issued", "item.model")
    assert all(word("en", key) in stated_in(content)["not stated"].split("; ") for key in lacking)
    requested = stated_in(content | {"details": content["details"] | {"show_not_stated": True}})
    assert all(requested[word("en", key)] == "not stated" for key in lacking)
    for stated in ("2026-017", "Hall 3", "2026-03-02 – 2026-03-03", "R-0001", "Customer & Co", "21.5 °C", "A. Head"):
        assert flat(stated) in flat(text)


def test_hostile_texts_are_printed_as_they_are(english: tuple[Path, dict[str, Any]]) -> None:
    text = flat(" ".join(pages_of(english[0] / "certificate.pdf")))
    for name in HOSTILE.values():
        shown = name.replace("\u6f22", "[U+6F22]")
        assert flat(shown) in text
    assert flat("#let x = 1 <script>window.hacked=4</script> =HYPERLINK(1)") in text


def test_page_opens_without_an_error_and_runs_nobody_elses_script(english: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, content = english
    with opened(folder / "report.html") as page:
        page.wait("document.querySelector('#space canvas') !== null")
        page.wait("document.querySelectorAll('.js-plotly-plot').length >= 3")
        assert page.evaluate("typeof window.hacked") == "undefined"
        assert page.evaluate("document.querySelectorAll('img').length") == 0
        # three targets beside the table of each pose, every cycle a point
        assert (
            page.evaluate("[...document.querySelectorAll('figure.pose svg')].map(s => s.querySelectorAll('circle[fill-opacity]').length)")
            == [5] * 9
        )
        # the list above a figure shows one pose at a time
        shown = "document.getElementById('drift').data.map(t => t.visible)"
        page.evaluate("document.getElementById('zoom').open = true")
        page.click("#drift .updatemenu-header")
        page.wait("document.querySelectorAll('#drift .updatemenu-dropdown-button').length === 4")
        page.evaluate(
            "(() => { const b = document.querySelectorAll('#drift .updatemenu-dropdown-button')[3];"
            "b.dispatchEvent(new MouseEvent('click', {bubbles: true})); })()"
        )
        page.wait(f"JSON.stringify({shown}) === '[false,false,true]'")
        text = page.evaluate("document.querySelector('main').textContent")
        page.resize(390)
        # names as long as these do not fit into a drawing; those of a laboratory are looked at by test_every_page
        wrong = [text for text in page.evaluate(LOOK) if "clipped" not in text and "collide" not in text]
        assert wrong == []
        assert page.evaluate("typeof window.hacked") == "undefined"
        assert [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))] == []
        assert page.errors == []
        # what is no script of the page does not run, and nothing is fetched, not even from the page itself
        page.evaluate(
            "(() => { const s = document.createElement('script'); s.textContent = 'window.hacked = 5'; document.body.append(s); })()"
        )
        assert page.evaluate("typeof window.hacked") == "undefined"
        assert page.evaluate("fetch('data:,x').then(() => 'came', () => 'refused')") == "refused"
    for name in (HOSTILE["P1"], HOSTILE["line"], "=HYPERLINK(1)", content["id"]):
        assert name in text
    written = (folder / "report.html").read_text(encoding="utf-8")
    assert 'src="http' not in written
    assert "<script>window.hacked" not in written


def test_every_page_states_what_may_run_in_it() -> None:
    policy = html.policy('<script>a < b</script><p><script type="x">c\n</script></p>')
    parts = dict(part.strip().split(" ", 1) for part in policy.split(";"))
    expected = {base64.b64encode(hashlib.sha256(code).digest()).decode() for code in (b"a < b", b"c\n")}
    assert {p[8:-1] for p in parts["script-src"].split() if p.startswith("'sha256-")} == expected
    assert "'unsafe-inline'" not in parts["script-src"]
    assert parts["connect-src"] == parts["default-src"] == parts["base-uri"] == parts["form-action"] == "'none'"
    assert "script-src 'none'" in html.policy("<p>nothing runs</p>")


def test_russian_has_no_english_left_of_ours(russian: tuple[Path, dict[str, Any]]) -> None:
    pages = pages_of(russian[0] / "certificate.pdf")
    assert pages[0].startswith("Протокол испытаний")
    assert f"страница 1 из {len(pages)}" in pages[0]
    text = flat(" ".join(pages))
    for key in ("only_item", "not_accredited", "section.results", "uncertainty.signed", "not_stated", "capable", "end"):
        assert flat(word("ru", key)) in text
        assert flat(word("en", key)) not in text
    assert '<html lang="ru">' in (russian[0] / "report.html").read_text(encoding="utf-8")


WORD = re.compile("[A-Za-z_]{2,}")
SYMBOL = re.compile("[vd]?[AR][PDTV]_?(p|l|rot|[abcxyz])|[XYZ]{2,3}")
NO_WORDS = {
    *(
        "ISO",
        "IEC",
        "JCGM",
        "SHA",
        "UTC",
        "LM",
        "lmeasure",
        "sources",
        "Linux",
        "aarch",
        "python",
    ),  # standards, names of programs and files
    *(
        "base_from_program",
        "quaternion",
        "simulated",
        "cell",
        "unstated",
        "exact",
    ),  # of the data, as certificate.json and the rig write them
    *("AP", "RP", "AT", "RT", "AD", "RD", "AV", "RV", "FV", "rot", "vAP", "puma", "oat", "fanuc", "wpr", "PNG"),  # symbols
    *("line", "inputs", "run", "rig", "pass", "program", "trajectory", "toml", "csv", "json", "parquet", "calibration"),  # inputs
}


def test_russian_has_no_latin_word_but_symbols_and_names(russian: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    """Whatever the program says of its own, wherever the text comes from: paper, page and what its figures draw."""
    folder, content = russian
    with opened(folder / "report.html") as page:
        page.wait("document.querySelector('#space canvas') !== null")
        shown = page_text(re.sub(rb"<code>.*?</code>", b"", (folder / "report.html").read_bytes())) + page.evaluate(
            "[...document.querySelectorAll('svg text, [aria-label]')]"
            ".map(e => e.textContent + ' ' + (e.getAttribute('aria-label') || '')).join(' ')"
        )
    stated = [*HOSTILE.values(), content["id"], *content["environment"], *content["environment"].values()]
    stated += [text for entry in content["inputs"] for text in (entry["file"], entry["sha256"])]
    theirs = " ".join(stated)
    for text in (shown, " ".join(pages_of(folder / "certificate.pdf"))):
        # a long name may be broken anywhere
        left = {found for found in WORD.findall(text.replace("\ufffe", "")) if found not in theirs and not SYMBOL.fullmatch(found)}
        assert sorted(left - NO_WORDS) == []


def test_russian_numbers_have_a_comma(russian: tuple[Path, dict[str, Any]]) -> None:
    folder, content = russian
    english, translated = (say.results(content | {"language": language}) for language in ("en", "ru"))
    for one, other in zip(english, translated, strict=True):
        assert [(row.value, row.u95, row.k) for _, row in other.rows] == [
            tuple(cell.replace(".", ",") for cell in (row.value, row.u95, row.k)) for _, row in one.rows
        ]
    assert any("," in row.value for test in translated for _, row in test.rows)
    pose = say.commanded(content)[1]
    assert "(120; 90; -80)" in pose[1]
    limits = say.tolerance(
        "ru", {"lower": -0.5, "upper": 0.5, "rule": "simple", "verdict": "conforms", "probability": 0.9312}, name_rule=False
    )
    assert limits[0] == "-0,5 … 0,5"
    assert "93,1" in limits[1]
    reported = [*say.uncertainty(content), *say.notes(content), *(cell for row in say.commanded(content) for cell in row)]
    assert [t for t in reported if re.search(r"\d\.\d", t)] == []
    assert 'separators":",\u00a0' in (folder / "report.html").read_text(encoding="utf-8").replace("\\u00a0", "\u00a0")


def test_accreditation_is_the_users_word_only(campaign: Path, tmp_path: Path) -> None:
    path = tmp_path / "details.toml"
    path.write_text(DETAILS + '[accreditation]\nstatement = "Accredited to ISO/IEC 17025"\nbody = "Body"\nnumber = "123"\n')
    given = Inputs(campaign / "trajectory.parquet", campaign / "program.toml", details=path)
    content = write_certificate(tmp_path / "c", given, CertificationSettings(), Choices())
    assert content["kind"] == "test certificate"
    text = " ".join(pages_of(tmp_path / "c" / "certificate.pdf"))
    assert text.startswith("Robot test certificate, ISO 9283:1998")
    assert "Accredited to ISO/IEC 17025; Body; 123" in text
    assert "No accreditation" not in text


def test_texts_of_the_computation_are_translated_with_what_is_in_them(russian: tuple[Path, dict[str, Any]]) -> None:
    content = russian[1]
    reported = [*content["notes"], content["uncertainty_covers"], *(c["note"] for c in content["characteristics"] if c.get("note"))]
    assert reported
    codes = {entry["text"]: entry["code"] for entry in content["findings"]}
    for text in reported:
        assert text in codes
        assert say.phrase(content, text) != text or codes[text] == "verdict.of_vector"
    beyond = message("zone.angle", angle_deg=71.2, limit_deg=60.0)
    assert say.phrase({"language": "ru", "findings": [beyond.stated()]}, str(beyond)) == "наибольший угол давления 71,2°. Граница зоны 60°"
    # what the certificate has no code for
    assert say.phrase({"language": "ru"}, "something else") == "something else"


def test_what_is_copied_from_the_paper_is_what_was_printed(english: tuple[Path, dict[str, Any]]) -> None:
    """Long words may break anywhere, but nothing invisible stands in them: a digest can be searched for and compared."""
    pages = " ".join(pages_of(english[0] / "certificate.pdf"))
    assert "\u200b" not in pages
    assert flat(english[1]["environment"]["lmeasure sources"]) in "".join(pages.replace("\ufffe", "").split())
    assert say.moment("2026-03-05T10:11:12.345678Z") == "2026-03-05 10:11:12 UTC"


def test_the_report_says_what_was_commanded_at_which_speed_and_load(english: tuple[Path, dict[str, Any]]) -> None:
    folder, content = english
    row = say.commanded(content)
    assert len(row) == 4
    assert flat(row[1][1]) == flat("(120, 90, -80) mm, quaternion x, y, z, w (0, 0, 0, 1)")
    assert row[1][2:] == ("not stated", "not stated")
    assert [cell.replace("\u00a0", " ") for cell in row[3][1:]] == ["line (120, 90, -80) → (-110, 80, 70) mm", "400 mm/s", "not stated"]
    printed = flat(row[3][1]).replace("-", "\u2212")
    assert printed in flat(" ".join(pages_of(folder / "certificate.pdf")))
    assert printed in flat((folder / "report.html").read_text(encoding="utf-8"))
    nowhere, there = [0.0, 0.0, 0.0], [9.0, 0.0, 0.0]
    content = content | {"program": {"load_kg": 5.0, "pose": [], "path": [
        {"name": "c", "kind": "circular", "centre_mm": [0.0, 0.0, 1.0], "radius_mm": 40.0, "start_mm": there, "speed_percent": 50.0},
        {"name": "r", "kind": "rectangular", "corners_mm": [nowhere, there, [9.0, 1.0, 0.0]], "load_kg": 2.0},
        {"name": "p", "kind": "points", "points_mm": [nowhere, there], "end_quaternion_xyzw": [0.0, 0.0, 1.0, 0.0]},
        {"name": "w", "kind": "linear", "start_mm": nowhere, "end_mm": there, "weave_stroke_mm": 3.0, "weave_distance_mm": 4.0},
    ]}}  # fmt: skip
    assert [[cell.replace("\u00a0", " ") for cell in r[1:]] for r in say.commanded(content)] == [
        ["circle about (0, 0, 1), radius 40, from (9, 0, 0) mm", "50 %", "5 kg"],
        ["rectangle (0, 0, 0), (9, 0, 0), (9, 1, 0) mm", "not stated", "2 kg"],
        ["2 points (0, 0, 0) … (9, 0, 0) mm; turning tool", "not stated", "5 kg"],
        ["line (0, 0, 0) → (9, 0, 0) mm; weave 3 mm across, 4 mm along", "not stated", "5 kg"],
    ]


def test_figures_of_two_poses_are_not_called_a_pose(english: tuple[Path, dict[str, Any]]) -> None:
    figures = [
        {"name": n, "pose": "P2-P4", "value": 1.0, "u95": 0.1, "unit": "mm", "capable": True} for n in ("AD_p", "RD_x", "t_min", "t_s")
    ]
    places = [place for test in say.results(english[1] | {"characteristics": figures}) for place, _ in test.rows]
    assert places == ["distance P2-P4", "distance P2-P4", "move P2-P4", "pose P2-P4"]
    band = message("settling.band", band_mm=0.05)
    changed = {"language": "ru", "characteristics": [figures[2] | {"note": str(band)}], "findings": [band.stated()]}
    reported = say.notes(english[1] | changed)
    assert "t_min, перемещение P2-P4: граничная полоса 0,05 мм" in reported


def test_each_path_has_a_colour_and_can_be_looked_at_alone(english: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    with opened(english[0] / "report.html") as page:
        page.wait("document.querySelectorAll('.js-plotly-plot').length >= 3")
        for name in ("drift", "deviation", "speed"):
            labels = page.evaluate(f"document.getElementById('{name}').layout.updatemenus[0].buttons.map(b => b.label)")
            groups = page.evaluate(f"Array.from(new Set(document.getElementById('{name}').data.map(t => t.legendgroup)))")
            assert labels == ["all", *(html.label(html.cut(unescape(group))) for group in groups)]
        assert page.errors == []
    assert len(set(_LINES)) >= 20


def test_a_program_without_poses_gives_no_certificate(campaign: Path, tmp_path: Path) -> None:
    (tmp_path / "p.toml").write_text('schema = "lmeasure.program/1"\n')
    with pytest.raises(CertificationError):
        write_certificate(tmp_path / "c", Inputs(campaign / "trajectory.parquet", tmp_path / "p.toml"), CertificationSettings(), Choices())
    assert not (tmp_path / "c").exists()
