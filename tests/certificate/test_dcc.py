"""The DCC: kept to a schema of our own (PTB's is the user's to name), its numbers to the last digit, hostile texts harmless."""

import re
from pathlib import Path
from typing import Any

import pytest
from dcclib.validation.schematron import SchematronValidator
from in_process import ran, refused
from lxml import etree

from lmeasure.certificate import dcc_xml
from lmeasure.certificate.dcc import DCC, SI, check_xml
from lmeasure.core import LMeasureError

XSD = Path(__file__).parents[1] / "authorities" / "dcc" / "small.xsd"
NAMES = {"dcc": DCC, "si": SI}
HOSTILE = "</dcc:name><!ENTITY x SYSTEM 'file:///etc/passwd'> &x; ]]> \x0b \ud800"


def certificate(**details: Any) -> dict[str, Any]:
    figure = {"name": "AP_p", "pose": HOSTILE, "value": 0.1 + 0.2, "unit": "mm", "u95": 1.0 / 3.0, "capable": False, "clause": "7.2.1"}
    speed = {"name": "FV", "path": "line", "value": 1e-17, "unit": "mm/s", "u95": 0.5, "capable": True, "coverage_factor": 2.1}
    return {
        "id": "LM-1", "created": "2026-03-05T10:00:00Z", "language": "ru", "details": details, "environment": {"lmeasure": "0.1.0"},
        "characteristics": [figure, speed],
    }  # fmt: skip


BARE = {"country": "DE"}
FULL = {
    "country": "CH",
    "method": "ISO 9283:1998, 30 cycles",
    "traceability": "tracker 123",
    "laboratory": {"name": HOSTILE, "address": "Street 1", "contact": "lab@example.org"},
    "customer": {"name": "Customer & Co", "contact": "+7 000"},
    "item": {"maker": "Maker", "model": "R-6", "serial": "0001", "description": "robot"},
    "dates": {"received": "2026-03-01", "measured_from": "2026-03-02", "measured_to": "2026-03-03", "issued": "2026-03-05"},
    "conditions": {"temperature_c": 21.5, "humidity_percent": 40.0, "text": "quiet"},
    "authoriser": {"name": "A. Head", "role": "head"},
    "accreditation": {"statement": "Accredited", "body": "B", "number": "D-K-1"},
    "number": "2026-017",
    "location": "hall 3",
    "performed_at": "customer",
}


@pytest.mark.parametrize("details", [BARE, FULL], ids=["nothing stated", "everything stated"])
def test_it_keeps_to_the_schema_and_to_every_digit(details: dict[str, Any]) -> None:
    content = certificate(**details)
    tree = etree.fromstring(dcc_xml(content, XSD))
    assert tree.get("schemaVersion") == "3.3.0"
    assert [float(v) for v in tree.xpath("//dcc:result//si:value/text()", namespaces=NAMES)] == [0.1 + 0.2, 1e-17]
    assert [float(v) for v in tree.xpath("//si:valueExpandedMU/text()", namespaces=NAMES)] == [1.0 / 3.0, 0.5]
    units = tree.xpath("//dcc:result//si:unit/text()", namespaces=NAMES)
    assert units == ["\\milli\\metre", "\\milli\\metre\\second\\tothe{-1}"]
    assert tree.xpath("//dcc:uniqueIdentifier/text()", namespaces=NAMES) == ["LM-1"]
    reported = " ".join(tree.xpath("//dcc:content/text()", namespaces=NAMES))
    assert "no verdict (uncertainty)" in reported
    assert "\\u{B} \\u{D800}" in reported
    assert ("no accreditation is stated" in reported) == (details is BARE)


@pytest.mark.parametrize("details", [BARE, FULL], ids=["nothing stated", "everything stated"])
def test_the_schematron_of_its_makers_accepts_it(details: dict[str, Any]) -> None:
    """`dcclib` has PTB's own rules for DCC 3.3.0 beyond the XSD."""
    reported = SchematronValidator.for_dcc().validate_str(dcc_xml(certificate(**details)).decode())
    assert not reported.failed_assertions
    assert [r.text for r in reported.successful_reports if r.role == "error"] == []


@pytest.mark.parametrize("country", [{}, {"country": "ZZ"}], ids=["none", "ZZ"])
def test_a_country_is_never_assumed(country: dict[str, str]) -> None:
    with pytest.raises(LMeasureError, match="country"):
        dcc_xml(certificate(**country))


def test_it_says_no_more_than_is_known() -> None:
    """Neither where the test was done nor in which language the laboratory wrote; our own texts are English whatever the PDF is."""
    bare, full = (etree.fromstring(dcc_xml(certificate(**d), XSD)) for d in (BARE, FULL))

    def one(tree: Any, path: str) -> list[str]:
        return list(map(str, tree.xpath(path, namespaces=NAMES)))

    assert one(bare, "//dcc:performanceLocation/text()") == ["other"]
    assert one(full, "//dcc:performanceLocation/text()") == ["customer"]
    assert one(full, "//dcc:usedLangCodeISO639_1/text()") == ["en"]
    assert one(full, "//dcc:coreData//dcc:value/text()") == ["2026-017"]
    for text in ("tracker 123", "quiet", "Customer & Co"):
        (found,) = (c for c in full.iterfind(f".//{{{DCC}}}content") if c.text == text)
        assert found.get("lang") is None


@pytest.mark.parametrize(
    ("value", "verdict", "status"),
    [(0.3, "conforms", "pass"), (0.9, "does not conform", "fail"), (0.49, "not decided", "conditionalPass"),
     (0.51, "not decided", "conditionalFail")],
)  # fmt: skip
def test_conformity_is_there_with_its_limits_and_rule(value: float, verdict: str, status: str) -> None:
    content = certificate(**BARE)
    content["characteristics"][0] |= {
        "value": value, "conformity": {"lower": None, "upper": 0.5, "rule": "guarded", "verdict": verdict, "probability": 0.5},
    }  # fmt: skip
    tree = etree.fromstring(dcc_xml(content, XSD))
    assert tree.xpath("//dcc:conformity/text()", namespaces=NAMES) == [status]
    (reported,) = tree.xpath("//dcc:metaData/dcc:declaration/dcc:content/text()", namespaces=NAMES)
    assert reported == "at most 0.5 mm; guarded acceptance (JCGM 106)"


def test_what_does_not_keep_to_the_schema_is_one_line(tmp_path: Path) -> None:
    content = certificate(**BARE, dates={"measured_from": "in March"})
    dcc_xml(content)
    with pytest.raises(LMeasureError, match=r"small\.xsd: the DCC does not keep to it: line \d+") as caught:
        dcc_xml(content, XSD)
    assert "beginPerformanceDate" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_what_is_no_schema_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(LMeasureError, match="cannot be read"):
        check_xml(b"<a/>", tmp_path / "none.xsd")
    for text in ("", "<a/>", "<xs:schema", '<!DOCTYPE a [<!ENTITY x SYSTEM "file:///etc/passwd">]><a>&x;</a>'):
        path = tmp_path / "bad.xsd"
        path.write_text(text)
        with pytest.raises(LMeasureError, match=r"bad\.xsd: cannot be used as an XSD") as caught:
            check_xml(b"<a/>", path)
        assert "\n" not in str(caught.value)


def test_inspect_opens_one_in_a_page(tmp_path: Path) -> None:
    dcc, page = tmp_path / "tracker.xml", tmp_path / "page.html"
    dcc.write_bytes(dcc_xml(certificate(**FULL)))
    said = ran("inspect", dcc, "--out", page)
    assert said.startswith(f"{dcc}: digital calibration certificate LM-1, 2 results\n")
    assert f"next: lmeasure register register --add {dcc}\n" in said
    text = page.read_text(encoding="utf-8")
    assert "Digital calibration certificate LM-1, 2 results" in text
    assert re.search(r"0\.3\s*mm", text.replace("\N{NO-BREAK SPACE}", " "))
    assert "u 0.17" in text.replace("\N{NO-BREAK SPACE}", " ")
    (tmp_path / "other.xml").write_text("<a/>")
    assert "is no DCC" in refused("inspect", tmp_path / "other.xml")
