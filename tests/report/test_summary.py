"""What stands first in a certificate: which figures, from certificate.json alone, and how they are drawn."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import segno
from lxml import etree

from lmeasure.certificate import chosen, round_scale
from lmeasure.certificate.content import MOST
from lmeasure.certificate.details import Logo, read_details, read_logo
from lmeasure.certificate.pictures import round_down
from lmeasure.core import CertificationError
from lmeasure.report import certificate_text as say, drawings, every_figure, headline
from lmeasure.report.certificate_pictures import errors_in_space, figures
from lmeasure.report.text import with_indices

SVG = "{http://www.w3.org/2000/svg}"


def figure(name: str, value: float, **more: Any) -> dict[str, Any]:
    return {"name": name, "pose": "P1", "value": value, "u95": 0.1, "unit": "mm", "capable": True, "coverage_factor": 1.9876} | more


def held(probability: float, upper: float = 1.0) -> dict[str, Any]:
    verdict = "conforms" if probability > 0.5 else "does not conform"
    return {"conformity": {"upper": upper, "rule": "simple", "verdict": verdict, "probability": probability}}


def certificate(found: list[dict[str, Any]], **more: Any) -> dict[str, Any]:
    settings = {"limit_angle_deg": 60.0, "capability": 0.25, "tool_offset_mm": [0.0, 0.0, 0.0]}
    rest: dict[str, Any] = {"program": {"pose": [], "path": []}, "instrument": None, "attained": [], "excluded": [], "settings": settings}
    return {"id": "LM-1", "created": "2026-03-05T10:11:12Z", "language": "en", "details": {}, "characteristics": found} | rest | more


def test_of_each_name_the_worst_stands_in_the_summary() -> None:
    found = [
        figure("AP_p", 0.5),
        figure("AP_p", 0.9, pose="P2"),
        figure("AP_p", 9.9, pose="P3", excluded="outside"),
        figure("AD_p", -0.8, pose="P1-P2"),
        figure("AD_p", 0.3, pose="P1-P3"),
        figure("RP_l", 0.9, **held(0.99)),
        figure("RP_l", 0.7, pose="P2", **held(0.2, upper=0.6)),
        figure("AP_x", 0.4),
    ]
    shown = chosen(certificate(found))
    assert [(c.figure["name"], c.figure["value"], c.of) for c in shown] == [("AP_p", 0.9, 2), ("RP_l", 0.7, 2), ("AD_p", -0.8, 2)]


ORDER = (
    "AP_p", "RP_l", "vAP_p", "AD_p", "RD", "t_s", "AT_p", "RT_p", "CR", "AV", "FV", "RV", "OV", "CO", "dAP_p", "dRP_l", "E", "t_min",
    "C_x", "C_y", "C_z", "WS", "WF", "AP_rot", "RP_rot", "AT_rot", "RT_rot",
)  # fmt: skip
"""Names that a first page may list, those first that show most of a robot."""


def test_the_first_page_lists_names_in_their_order() -> None:
    for some in (ORDER[:MOST], ORDER[10:20], ORDER[17:]):
        assert [c.figure["name"] for c in chosen(certificate([figure(name, 1.0) for name in reversed(some)]))] == list(some)


def test_a_name_with_a_tolerance_is_not_left_out_for_one_without() -> None:
    found = [figure(name, 1.0) for name in ORDER[:12]] + [figure("AP_x", 0.1, **held(0.9)), figure("RT_rot", 0.2, **held(0.9))]
    names = [c.figure["name"] for c in chosen(certificate(found))]
    assert len(names) == MOST
    assert names == [*ORDER[:8], "RT_rot", "AP_x"]


def test_the_screen_gets_a_headline_and_all_on_request() -> None:
    found = [figure("AP_p", k / 10, pose=f"P{k}") for k in range(1, 40)] + [figure("RP_l", 0.05, capable=False)]
    lines = headline(certificate(found), Path("made"))
    assert lines[0] == "Robot test report, ISO 9283:1998 LM-1"
    assert " ".join(lines[2].split()) == "AP_p pose accuracy pose P39, worst of 39 3.90 ± 0.10 mm U95 small enough"
    assert lines[4:] == [
        "No tolerance is stated, so there is no pass or fail.",
        "40 characteristics, 39 of them with U95 small enough for a verdict.",
        f"open {Path('made/certificate.pdf')}, {Path('made/report.html')}",
        "anyone can check it with: lmeasure verify made",
    ]
    full = every_figure(certificate(found))
    assert sum("k 1.99" in line for line in full) == 40
    assert not re.search(r"\d{6}", "".join(full))
    with_tolerances = headline(certificate([figure("AP_p", 0.5, **held(0.97)), figure("RP_l", 2.0, **held(0.01))]), Path("made"))
    assert "2 results have a tolerance: pass: 1, fail: 1." in with_tolerances


def test_parts_of_a_program_without_figures_are_named() -> None:
    program = {"pose": [{"name": name} for name in ("P1", "P2", "P3", "P4", "P5")], "path": [{"name": "line"}, {"name": "circle"}]}
    found = [figure("AP_p", 0.5), figure("t_min", 0.4, pose="P3-P2"), figure("AT_p", 0.5, pose=None, path="line")]
    excluded = [{"kind": "pose", "name": "P4", "reason": "outside"}]
    lines = headline(certificate(found, program=program, excluded=excluded), Path("made"))
    assert "not measured, because the program has no times of: pose P5, path circle" in lines
    all_told = headline(
        certificate(found, program=program | {"pose": program["pose"][:4], "path": program["path"][:1]}, excluded=excluded), Path("made")
    )
    assert not any("not measured" in line for line in all_told)


def test_the_instrument_is_described() -> None:
    measured = {
        "cables": 6, "observation_points": 6, "passes": 1, "counts_per_revolution": [6000],
        "count_length_mm": [0.0119987654321, 0.0120034],
        "worst_pressure_angle_deg": 20.512345,
        "calibration": {"reference_poses": 19, "equations": 114, "unknowns": 30, "residual_rms_mm": 0.0207},
    }  # fmt: skip
    reported = say.instrument(certificate([], measured_with=measured))
    assert reported == [
        "6 cables from 6 observation points",
        "encoders of 6000 counts per turn of the drum, 0.012 mm of cable per count",
        "calibrated with 19 reference poses, residuals 0.021 mm rms",
        "used up to a pressure angle of 20.5°. Its zone ends at 60°",
    ]
    russian = say.instrument(certificate([], language="ru", measured_with=measured | {"calibration": None, "passes": 2}))
    assert not re.search(r"[A-Za-z]|\d\.\d", "".join(russian))
    # what was sealed before does not describe it
    assert say.instrument(certificate([], instrument={"rig": "r"})) == ["cables, drums and encoders (lmeasure)"]


def test_symbols_have_their_index() -> None:
    assert with_indices("AP_p") == [("AP", "p")]
    assert with_indices("AD_p, t_min: limit band; U95 of vAP_c.") == [
        ("AD", "p"), (", t", "min"), (": limit band; U", "95"), (" of vAP", "c"), (".", "")
    ]  # fmt: skip
    # names of files and values are none
    assert with_indices("base_from_program AP_pose U951 xAP_p") == [("base_from_program AP_pose U951 xAP_p", "")]
    assert with_indices("") == [("", "")]


def numbers(element: Any, key: str) -> list[float]:
    return [float(v) for v in re.findall(r"-?[0-9.]+", element.get(key))]


@pytest.mark.parametrize(("value", "lower", "upper"), [(0.5, None, 1.0), (-0.4, -1.0, 0.2), (3.0, None, 1.0), (0.5, None, None)])
def test_a_bar_is_to_scale(value: float, lower: float | None, upper: float | None) -> None:
    limits = {k: v for k, v in (("lower", lower), ("upper", upper)) if v is not None}
    stated = figure("AP_p", value) | ({"conformity": limits} if limits else {})
    drawn = etree.fromstring(drawings.bar(stated, "AP").encode())
    dot = drawn.find(f"{SVG}circle")
    whisker = next(numbers(p, "d") for p in drawn.iter(f"{SVG}path") if p.get("d").endswith("11.00") and " 11.00L" in p.get("d"))
    per_mm = (whisker[2] - whisker[0]) / 0.2
    assert float(dot.get("cx")) == pytest.approx((whisker[0] + whisker[2]) / 2, abs=0.02)
    zone = [r for r in drawn.iter(f"{SVG}rect") if r.get("fill") == drawings.WITHIN]
    assert len(zone) == bool(limits)
    if upper is not None:
        end = float(zone[0].get("x")) + float(zone[0].get("width"))
        assert (float(dot.get("cx")) - end) / per_mm == pytest.approx(value - upper, abs=0.02)
    if lower is not None:
        assert (float(dot.get("cx")) - float(zone[0].get("x"))) / per_mm == pytest.approx(value - lower, abs=0.02)


def test_labels_do_not_cover_each_other_or_what_is_drawn() -> None:
    rng = np.random.default_rng(3)
    labels = [drawings.Label(x, y, f"P{i}") for i, (x, y) in enumerate(rng.uniform(0, 120, (40, 2)))]
    taken = [(20.0, 20.0, 30.0, 4.0)]
    shown = drawings.placed(labels, 10.0, taken)
    assert 10 < len(shown) <= 40
    boxes = taken + [(s.x, s.y - 8.2, drawings.CHARACTER * 10 * len(s.text), 10.0) for s in shown]
    for i, a in enumerate(boxes):
        for b in boxes[:i]:
            apart = a[0] >= b[0] + b[2] - 1e-9 or b[0] >= a[0] + a[2] - 1e-9 or a[1] >= b[1] + b[3] - 1e-9 or b[1] >= a[1] + a[3] - 1e-9
            assert apart


def test_errors_in_space_come_from_the_certificate_alone() -> None:
    attained = [
        {"pose": "P1", "commanded_mm": [0.0, 0.0, 0.0], "mean_mm": [0.0, 0.0, 0.5]},
        {"pose": "P2", "commanded_mm": [300.0, 200.0, 100.0], "mean_mm": [300.0, 200.0, 100.25]},
        {"pose": "P1 settling", "commanded_mm": [0.0, 0.0, 0.0], "mean_mm": [0.0, 0.0, 0.5]},
    ]
    picture = errors_in_space(certificate([], attained=attained))
    assert picture is not None
    assert "measures 300 × 200 × 100\u00a0mm." in picture.caption
    drawn = etree.fromstring(picture.svgs[0].encode())
    # a place that several poses share is named once
    assert [t.text for t in drawn.iter(f"{SVG}text")] == ["P1", "P2", "X", "Y", "Z"]
    tips = [numbers(p, "points") for p in drawn.iter(f"{SVG}polygon")]
    shafts = [numbers(p, "d") for p in drawn.iter(f"{SVG}path") if p.get("stroke") == drawings.RED]
    lengths = [s[1] - t[1] for s, t in zip(shafts, tips, strict=True)]
    assert lengths[0] == pytest.approx(2 * lengths[1], rel=0.02)
    assert errors_in_space(certificate([])) is None


def test_the_summary_draws_what_the_certificate_says() -> None:
    (shown,) = figures(certificate([figure("AP_p", 0.5, **held(0.97)), figure("AP_p", 0.1)]))
    assert (shown.result.value, shown.result.u95, shown.result.k, shown.where) == (
        "0.50",
        "\u00b1\u00a00.10",
        "1.99",
        "pose P1, worst of 2",
    )
    assert 'aria-label="AP_p 0.50 ' in shown.bar


def test_the_code_is_the_id() -> None:
    text = "LM-73EA90BB-00686CB7"
    drawn = etree.fromstring(drawings.code(text, text).encode())
    cells = drawn.find(f"{SVG}path").get("d")
    dark = {(int(x), int(y)) for x, y in re.findall(r"M(\d+) (\d+)h1v1h-1z", cells)}
    expected = {(i + 4, j + 4) for j, row in enumerate(segno.make(text, error="m", micro=False).matrix) for i, v in enumerate(row) if v}
    assert dark == expected
    size = numbers(drawn, "viewBox")[2]
    assert max(max(cell) for cell in dark) == size - 5  # a quiet zone of four


def test_a_logo_is_a_picture(tmp_path: Path) -> None:
    details = tmp_path / "details.toml"
    details.write_text('schema = "lmeasure.report/1"\nlogo = "mark.svg"\n')
    mark = tmp_path / "mark.svg"
    mark.write_text('<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"/>')
    assert read_logo(details, read_details(details)) == Logo(mark.read_bytes(), "svg")
    for content, said in ((b"<html/>", "is no picture"), (b"GIF89a", "is no picture"), (b"\x89PNG\r\n\x1a\n" + bytes(2**20), "At most")):
        mark.write_bytes(content)
        with pytest.raises(CertificationError, match=said):
            read_logo(details, read_details(details))
    details.write_text('schema = "lmeasure.report/1"\n')
    assert read_logo(details, read_details(details)) is None


def test_round_scales() -> None:
    assert [round_scale(x) for x in (0.11, 1.6, 3.0, 6.1, 9.0)] == pytest.approx([0.15, 2.0, 3.0, 8.0, 10.0])
    assert [round_down(x) for x in (0.11, 1.6, 3.0, 7.9, 99.0)] == pytest.approx([0.1, 1.5, 3.0, 6.0, 80.0])
    for radius in (0.1, 0.15, 2.0, 30.0, 400.0, 5.0, 0.06, 8.0):
        step = drawings.ring_step(radius)
        assert radius / step == pytest.approx(round(radius / step))


def test_without_uncertainties_there_are_values_and_no_verdict() -> None:
    nothing: dict[str, Any] = {"u95": None, "capable": None, "coverage_factor": None}
    content = certificate([figure("AP_p", 0.123456789, **nothing), figure("RP_l", 0.2)])
    lines = headline(content, Path("made"))
    assert " ".join(lines[2].split()) == "AP_p pose accuracy pose P1 0.123457 mm no verdict (no uncertainty stated)"
    assert lines[5] == "2 characteristics, 1 of them with U95 small enough for a verdict."
    assert "AP_p 0.123457 mm" in figures(content)[0].bar
