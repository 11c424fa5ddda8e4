"""Results of several laboratories, against published values and a few lines of NumPy."""

import datetime
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import test_dcc
from hypothesis import given, settings, strategies as st
from in_process import ran, refused

from lmeasure.certificate import consensus, dcc_xml, read_dcc
from lmeasure.core import LMeasureError

# values of G [1e-11 m^3/(kg s^2)] of CODATA 2010 (Mohr, Taylor, Newell, Rev. Mod. Phys. 84 (2012), table XVII), whose Birge ratio is 4.58
GRAVITY = (6.67248, 6.6729, 6.67398, 6.674255, 6.67559, 6.67422, 6.67387, 6.67222, 6.67425, 6.67349, 6.67234)
U_GRAVITY = (43e-5, 50e-5, 70e-5, 9.2e-5, 27e-5, 98e-5, 27e-5, 87e-5, 12e-5, 18e-5, 14e-5)
# BCG vaccine against tuberculosis, 13 trials (Colditz and others, JAMA 271 (1994)): ill and healthy of the vaccinated, then of the others;
# Q = 152.23, between-study variance 0.3088, log risk ratio -0.7141 with standard error 0.1787 by DerSimonian and Laird
TRIALS = np.array(
    [
        (4, 119, 11, 128), (6, 300, 29, 274), (3, 228, 11, 209), (62, 13536, 248, 12619), (33, 5036, 47, 5761), (180, 1361, 372, 1079),
        (8, 2537, 10, 619), (505, 87886, 499, 87892), (29, 7470, 45, 7232), (17, 1699, 65, 1600), (186, 50448, 141, 27197),
        (5, 2493, 3, 2338), (27, 16886, 29, 17825),
    ],
    dtype=float,
)  # fmt: skip


def labels(n: int) -> list[str]:
    return [f"L{i}" for i in range(n)]


def test_the_birge_ratio_of_a_published_set() -> None:
    found = consensus("G", labels(11), np.array(GRAVITY), np.array(U_GRAVITY))
    assert found.birge == pytest.approx(4.58, abs=0.005)


def test_random_effects_of_a_published_set() -> None:
    a, b, c, d = TRIALS.T
    x, u = np.log(a / (a + b) / (c / (c + d))), np.sqrt(1 / a - 1 / (a + b) + 1 / c - 1 / (c + d))
    found = consensus("log risk ratio", labels(13), x, u)
    assert found.q == pytest.approx(152.2330, abs=1e-4)
    assert found.between**2 == pytest.approx(0.3088, abs=5e-5)
    assert found.random_effects == pytest.approx((-0.7141, 0.1787), abs=5e-5)
    # of two that contradict each other none is blamed
    two = consensus("x", labels(2), np.array([0.0, 1.0]), np.array([0.1, 0.1]))
    assert (two.method, two.outlying, two.value) == ("random effects", (), 0.5)


def test_a_laboratory_that_stands_apart_is_named() -> None:
    x, u = np.array([1.00, 1.02, 0.99, 1.30]), np.array([0.02, 0.02, 0.02, 0.02])
    found = consensus("AP_p P1", labels(4), x, u)
    assert found.outlying == ("L3",)
    assert found.value == pytest.approx(1.0033, abs=1e-4)
    (apart,) = (e for e in found.laboratories if not e.in_mean)
    assert apart.u_difference == pytest.approx(0.02 * np.sqrt(1 + 1 / 3))
    assert apart.e_n == pytest.approx(0.29667 / (2 * 0.023094), abs=1e-3)
    # the robot itself may have changed as much
    assert consensus("AP_p P1", labels(4), x, u, artefact=0.2).outlying == ()


@settings(max_examples=25, deadline=None)
@given(st.integers(3, 8), st.integers(0, 2**32 - 1))
def test_differences_have_the_covariance_of_least_squares(n: int, seed: int) -> None:
    """Of n results with a common error, by the whole covariance matrix; laboratories that agree."""
    rng = np.random.default_rng(seed)
    common, u = 0.3, rng.uniform(0.5, 2.0, n)
    x = 5.0 + 1e-3 * rng.normal(size=n)
    found = consensus("x", labels(n), x, u, common=common)
    V = np.diag(u**2 - common**2) + common**2
    weights = np.linalg.solve(V, np.ones(n)) / np.linalg.solve(V, np.ones(n)).sum()
    H = np.eye(n) - np.outer(np.ones(n), weights)
    assert found.value == pytest.approx(weights @ x)
    assert found.u == pytest.approx(np.sqrt(weights @ V @ weights))
    assert [e.u_difference for e in found.laboratories] == pytest.approx(np.sqrt(np.diag(H @ V @ H.T)))


def certificate(name: str, value: float) -> dict[str, Any]:
    content = test_dcc.certificate(country="DE", laboratory={"name": name})
    content["characteristics"][0] |= {"pose": "P1", "value": value, "u95": 0.02, "coverage_factor": 2.0}
    return content


@pytest.fixture
def dccs(tmp_path: Path) -> list[Path]:
    """Certificates of four laboratories as DCCs; one of them differs."""
    out = []
    for name, value in (("A", 0.500), ("B", 0.505), ("C", 0.495), ("D", 0.600)):
        out.append(tmp_path / f"{name}.xml")
        out[-1].write_bytes(dcc_xml(certificate(name, value)))
    return out


def test_dccs_are_compared_by_command(dccs: list[Path], tmp_path: Path) -> None:
    said = ran("compare", "--between", *dccs, "--out", tmp_path / "between.json")
    assert "D differs by +0.1 mm: E_n = +4.33" in " ".join(said.split())
    found = {one["name"]: one for one in json.loads((tmp_path / "between.json").read_text())["results"]}
    assert found["AP_p P1"]["outlying"] == ["D"]
    assert found["AP_p P1"]["value"] == pytest.approx(0.5)
    assert found["FV line"]["outlying"] == []


def test_what_cannot_be_compared_is_one_line(dccs: list[Path], tmp_path: Path) -> None:
    (tmp_path / "no.xml").write_text("<a/>")
    (tmp_path / "bad.xml").write_text(dccs[0].read_text().replace("<si:value>0.5<", "<si:value>half<"))
    for paths, word in ((dccs[:1], "two or more"), ((dccs[0], dccs[0]), "'A'"), ((dccs[0], tmp_path / "no.xml"), "is no DCC")):
        assert word in refused("compare", "--between", *paths)
    with pytest.raises(LMeasureError, match="is no number"):
        read_dcc(tmp_path / "bad.xml")


def test_what_was_written_is_read(tmp_path: Path) -> None:
    (tmp_path / "c.xml").write_bytes(dcc_xml(certificate("A", 0.5)))
    dcc = read_dcc(tmp_path / "c.xml")
    assert (dcc.identifier, dcc.laboratory, str(dcc.performed)) == ("LM-1", "A", "2026-03-05")
    assert [(r.name, r.value, r.unit, r.u) for r in dcc.results] == [("AP_p P1", 0.5, "mm", 0.01), ("FV line", 1e-17, "mm/s", 0.5 / 2.1)]


def test_older_ways_to_state_an_uncertainty_are_read(tmp_path: Path) -> None:
    """D-SI before 2.2 has `expandedUnc`; a standard uncertainty has no factor."""
    text = dcc_xml(certificate("A", 0.5)).decode()
    begin, end = text.index("<si:measurementUncertaintyUnivariate>"), text.index("</si:measurementUncertaintyUnivariate>") + 39
    old = "<si:expandedUnc><si:uncertainty>0.06</si:uncertainty><si:coverageFactor>3</si:coverageFactor></si:expandedUnc>"
    standard = "<si:measurementUncertaintyUnivariate><si:standardMU><si:valueStandardMU>0.02</si:valueStandardMU></si:standardMU>"
    for stated in (old, f"{standard}</si:measurementUncertaintyUnivariate>"):
        (tmp_path / "old.xml").write_text(text[:begin] + stated + text[end:])
        assert read_dcc(tmp_path / "old.xml").results[0].u == pytest.approx(0.02)


def quantity(name: str, real: str) -> str:
    return f"<dcc:quantity><dcc:name>{name}</dcc:name>{real}</dcc:quantity>"


UNCERTAIN = (
    "<si:measurementUncertaintyUnivariate{x}><si:expandedMU{x}><si:valueExpandedMU{x}>{U}</si:valueExpandedMU{x}><si:coverageFactor{x}>2</si:coverageFactor{x}>"
    "</si:expandedMU{x}></si:measurementUncertaintyUnivariate{x}>"
)
REAL = "<si:real><si:value>{0}</si:value><si:unit>{1}</si:unit>" + UNCERTAIN.format(x="", U="{2}") + "</si:real>"
LIST = (
    "<si:realListXMLList><si:valueXMLList>{0}</si:valueXMLList><si:unitXMLList>{1}</si:unitXMLList>"
    + UNCERTAIN.format(x="XMLList", U="{2}")
    + "</si:realListXMLList>"
)


def of_another_program(path: Path, *quantities: str) -> Path:
    """A DCC with one result of several quantities."""
    text = dcc_xml(certificate("Other", 0.5)).decode()
    begin, end = text.index("<dcc:results>"), text.index("</dcc:results>")
    name = '<dcc:name><dcc:content lang="de">Länge</dcc:content><dcc:content lang="en">length</dcc:content></dcc:name>'
    path.write_text(f"{text[:begin]}<dcc:results><dcc:result>{name}<dcc:data>{''.join(quantities)}</dcc:data></dcc:result>{text[end:]}")
    return path


def test_lists_and_units_of_other_laboratories_are_read(tmp_path: Path) -> None:
    """A list, a hybrid (once in inches), and two quantities of one name: each result has its own name, in mm, degrees or its own unit."""
    hybrid = "<si:hybrid>" + REAL.format("0.0254", r"\metre", "2e-6") + REAL.format(1, r"\inch", 1) + "</si:hybrid>"
    path = of_another_program(
        tmp_path / "other.xml",
        quantity("<dcc:content>step</dcc:content>", LIST.format("0.1 0.2", r"\metre", "2e-6 4e-6")),
        quantity("<dcc:content>step</dcc:content>", LIST.format("100 200", r"\micro\metre", 1)),
        quantity("", hybrid),
        quantity("<dcc:content>angle</dcc:content>", REAL.format("3.141592653589793", r"\radian", "0")),
        quantity("<dcc:content>mass</dcc:content>", REAL.format("2", r"\kilogram", "0.2")),
    )
    assert [(r.name, r.value, r.unit, r.u) for r in read_dcc(path).results] == [
        ("length: step [1]", pytest.approx(100.0), "mm", pytest.approx(1e-3)),
        ("length: step [2]", pytest.approx(200.0), "mm", pytest.approx(2e-3)),
        ("length: step [1] (2)", pytest.approx(0.1), "mm", pytest.approx(5e-4)),
        ("length: step [2] (2)", pytest.approx(0.2), "mm", pytest.approx(5e-4)),
        ("length", pytest.approx(25.4), "mm", pytest.approx(1e-3)),
        ("length: angle", pytest.approx(180.0), "deg", None),
        ("length: mass", 2.0, r"\kilogram", 0.1),
    ]
    with pytest.raises(LMeasureError, match=r"valueExpandedMUXMLList has 3 values for 2 results"):
        read_dcc(of_another_program(tmp_path / "bad.xml", quantity("", LIST.format("1 2", r"\metre", "1 2 3"))))


STATEMENT = "<dcc:statement><dcc:traceable>{traceable}</dcc:traceable>{valid}</dcc:statement></dcc:statements>"


@pytest.mark.parametrize(
    ("traceable", "valid", "day", "codes"),
    [
        ("true", "<dcc:date>2026-03-05</dcc:date><dcc:period>P1Y</dcc:period>", "2027-03-05", []),
        ("true", "<dcc:date>2026-03-05</dcc:date><dcc:period>P1Y</dcc:period>", "2027-03-06", ["dcc.expired"]),
        ("false", "<dcc:period>P18M</dcc:period>", "2027-09-05", ["dcc.not_traceable"]),
        ("true", "<dcc:period>P11M23D</dcc:period>", "2027-03-01", ["dcc.expired"]),
        ("1", "<dcc:period>P30D</dcc:period>", None, ["dcc.undated"]),
        ("true", "", "2026-03-04", ["dcc.later"]),
    ],
)
def test_a_reference_states_traceability_and_expiry(tmp_path: Path, traceable: str, valid: str, day: str | None, codes: list[str]) -> None:
    """A year from 5 March ends with 5 March; 11 months of 5 March end on 5 February, 23 days later on 28 February."""
    text = dcc_xml(certificate("A", 0.5)).decode().replace("</dcc:statements>", STATEMENT.format(traceable=traceable, valid=valid))
    (tmp_path / "c.xml").write_text(text)
    dcc = read_dcc(tmp_path / "c.xml")
    assert [d.code for d in dcc.doubts(None if day is None else datetime.date.fromisoformat(day))] == codes
    assert "certificate LM-1 of A, 2026-03-05" in dcc.traceability


@pytest.mark.parametrize("period", ["P", "1Y", "PxY", "P9999Y"])
def test_a_period_that_is_none_is_one_line(tmp_path: Path, period: str) -> None:
    text = dcc_xml(certificate("A", 0.5)).decode()
    valid = f"<dcc:period>{period}</dcc:period>"
    (tmp_path / "c.xml").write_text(text.replace("</dcc:statements>", STATEMENT.format(traceable="true", valid=valid)))
    with pytest.raises(LMeasureError, match="period"):
        read_dcc(tmp_path / "c.xml")
