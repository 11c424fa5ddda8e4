"""Texts, limits and pictures of a certificate, each by itself: names, digits, ellipses, details that cannot be meant."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.stats

from lmeasure.certificate import round_up, targets
from lmeasure.certificate.details import read_details
from lmeasure.certificate.pictures import prediction_ellipse
from lmeasure.core import FileFormatError
from lmeasure.report import certificate_text as say
from lmeasure.report.certificate_text import characteristic_name
from lmeasure.text import LANGUAGES
from lmeasure.trajectory import AttainedPose
from lmeasure.trajectory.motion.vibration import vibration


def test_the_verdict_of_a_component_alone_stands_beside_that_of_its_vector() -> None:
    figure: dict[str, Any] = {"name": "AP_x", "pose": "P1", "value": 0.01, "u95": 0.02, "unit": "mm", "capable": True}
    reported = {
        ("en", True, False): "U95 small enough; alone no verdict",
        ("en", False, True): "no verdict (uncertainty); alone small enough",
        ("en", True, True): "U95 small enough",
        ("ru", True, False): "U95 достаточно мала; сама по себе без заключения",
        ("ru", False, False): "без заключения (неопределённость)",
    }
    for (language, of_vector, alone), text in reported.items():
        assert say.verdict(language, figure | {"capable": of_vector, "capable_alone": alone}) == text
    # certificates sealed before do not say it
    assert say.verdict("en", figure) == "U95 small enough"
    assert say.verdict("en", figure | {"excluded": "x", "capable": False, "capable_alone": False}) == "excluded"


def test_characteristics_have_names() -> None:
    names = (
        "AP_p",
        "AP_x",
        "RP_l",
        "vAP_p",
        "AD_p",
        "RD",
        "t_s",
        "OV",
        "dAP_p",
        "dRP_l",
        "E",
        "AT_p",
        "RT_p",
        "CR",
        "CO",
        "AV",
        "t_min",
        "C_x",
    )
    for language in LANGUAGES:
        assert all(characteristic_name(language, name) for name in names)
        assert characteristic_name(language, "XYZ") == ""


def test_values_end_where_their_uncertainty_does() -> None:
    assert say.with_u95(0.123456, 0.0123) == ("0.123", "0.012")
    assert say.with_u95(0.123456, 0.0996) == ("0.12", "0.10")
    assert say.with_u95(1234.56, 12.3) == ("1235", "12")
    assert say.with_u95(1234.56, 99.6) == ("1230", "100")
    assert say.with_u95(1234.56, 1230.0) == ("1200", "1200")
    assert say.with_u95(-1e-9, 2.5e-10) == ("-0.00000000100", "0.00000000025")
    assert say.with_u95(-0.00001, 0.0035) == ("0.0000", "0.0035")
    assert say.with_u95(0.5, 0.0) == ("0.5", "0")


def test_limits_and_probabilities_of_conformity() -> None:
    def reported(lower: float | None, upper: float | None, probability: float) -> list[str]:
        stated = {"lower": lower, "upper": upper, "rule": "simple", "verdict": "conforms", "probability": probability}
        return [cell.replace("\u00a0", " ") for cell in say.tolerance("en", stated, name_rule=False)]

    assert reported(None, 0.8, 0.9731) == ["≤ 0.8", "pass (97.3 %)"]
    # nothing is certain
    assert reported(0.2, None, 0.99999) == ["≥ 0.2", "pass (> 99.9 %)"]
    assert reported(-0.2, 0.2, 1e-9) == ["-0.2 … 0.2", "pass (< 0.1 %)"]


def test_a_scatter_too_small_for_paper_is_enlarged_and_said_to_be() -> None:
    commanded = np.zeros(7)
    poses = np.zeros((30, 7))
    poses[:, :3] = np.array([1.0, 0.5, 0.0]) + np.random.default_rng(0).normal(0.0, 0.01, (30, 3))
    still = vibration([(np.arange(3.0), np.zeros((3, 6)))] * 30)
    pose = AttainedPose("P1", commanded, poses, np.arange(30.0), np.ones(30, dtype=np.int64), still, np.ones(30, dtype=np.int64), 10.0)
    plain, large = targets(pose)[0], targets(pose, readable=True)[0]
    assert plain.enlarged == 1.0
    assert large.enlarged in (20.0, 30.0)
    np.testing.assert_allclose(large.mean, plain.mean)
    np.testing.assert_allclose(large.deviations - large.mean, large.enlarged * (plain.deviations - plain.mean), atol=1e-12)
    assert plain.ellipse is not None
    assert large.ellipse is not None
    np.testing.assert_allclose(large.ellipse - large.mean, large.enlarged * (plain.ellipse - plain.mean), atol=1e-9)
    assert np.linalg.norm(large.deviations - large.mean, axis=1).max() <= np.linalg.norm(large.mean)
    # where the scatter can be seen nothing is changed
    poses[:, :3] -= [1.0, 0.5, 0.0]
    assert targets(pose, readable=True)[0].enlarged == 1.0
    # nor what rounding leaves of no scatter at all
    poses[:, :3] = np.array([1.0, 0.5, 0.0]) + 1e-12 * poses[:, :3]
    assert targets(pose, readable=True)[0].enlarged == 1.0


def test_the_ellipse_holds_what_it_says() -> None:
    """Of further draws from the law its points came from 95 % lie inside, however few the points are."""
    rng = np.random.default_rng(1)
    inside = []
    for _ in range(3000):
        factor = rng.normal(size=(2, 2))
        points, more = rng.normal(size=(6, 2)) @ factor, rng.normal(size=(1, 2)) @ factor
        line = prediction_ellipse(points)
        assert line is not None
        centre = points.mean(axis=0)
        # in coordinates in which the line is a circle
        root = np.linalg.inv(np.linalg.cholesky(np.cov(points.T)))
        radius = np.linalg.norm(root @ (line[0] - centre))
        inside.append(np.linalg.norm(root @ (more[0] - centre)) <= radius)
    assert abs(np.mean(inside) - 0.95) < 4 * np.sqrt(0.95 * 0.05 / 3000)
    assert prediction_ellipse(np.zeros((3, 2))) is None
    assert scipy.stats.f.ppf(0.95, 2, 4) > 0
    assert [round_up(x) for x in (0.11, 0.2, 0.21, 0.6, 0.0)] == pytest.approx([0.2, 0.2, 0.5, 1.0, 1e-3])


@pytest.mark.parametrize(
    ("text", "reported"),
    [
        ('schema = "lmeasure.report/2"', "schema"),
        ('schema = "lmeasure.report/1"\nlab = "x"', "unknown key 'lab'"),
        ('schema = "lmeasure.report/1"\n[laboratory]\nnam = "x"', "Did you mean 'name'"),
        ('schema = "lmeasure.report/1"\nlocation = "a\\u0000b"', "printable"),
        ('schema = "lmeasure.report/1"\nlocation = " "', "must not be empty"),
        ('schema = "lmeasure.report/1"\n[dates]\nissued = "tomorrow"', "must be a date"),
        ('schema = "lmeasure.report/1"\n[dates]\nissued = 2026-01-01T10:00:00', "without a time"),
        ('schema = "lmeasure.report/1"\n[dates]\nreceived = 2026-02-02\nissued = 2026-02-01', "lies before"),
        ('schema = "lmeasure.report/1"\n[accreditation]\nstatement = "x"', "is missing"),
        ('schema = "lmeasure.report/1"\n[conditions]\ntemperature_c = "warm"', "must be a number"),
        ('schema = "lmeasure.report/1"\nlaboratory = "x"', "must be a table"),
    ],
)
def test_details_that_cannot_be_meant(tmp_path: Path, text: str, reported: str) -> None:
    path = tmp_path / "details.toml"
    path.write_text(text)
    with pytest.raises(FileFormatError, match=r"details\.toml") as caught:
        read_details(path)
    assert reported in str(caught.value)


def test_nothing_hidden_stays_hidden() -> None:
    assert say.visible("a\u202eb\x00\n\ud800") == "a\\u{202E}b\\u{0}\n\\u{D800}"
