"""Two calibrations of one rig, with what really moved between them known."""

import json
import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest
import scipy.stats
from bench import client
from in_process import ran, refused

from lmeasure.calibration import (
    Calibration,
    CalibrationSettings,
    Campaign,
    Comparison,
    calibrate,
    compare,
    comparison_summary,
    read_earlier,
)
from lmeasure.calibration.validation.compare import Earlier
from lmeasure.core import CalibrationError, FileFormatError
from lmeasure.io import write_table
from lmeasure.recording import write_poses
from lmeasure.rig import CalibrationRecord, Rig, rig_from_dict, write_calibration_record, write_rig
from lmeasure.simulation import cell
from lmeasure.simulation.instrument import simulate_campaign

MIDDLE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
NOISE_MM = 0.01


def three_drums(shift_mm: float = 0.0, alpha_deg: float = 0.0) -> Rig:
    """Three drums of the simulated cell; the second may have been knocked along X, or its guide turned."""
    data = cell.cell_rig(0).to_dict()
    data["observation_point"] = data["observation_point"][:3]
    data["cable"] = data["cable"][:3]
    second = data["observation_point"][1]
    second["position_mm"][0] += shift_mm
    second["guide_alpha_deg"] += alpha_deg
    return rig_from_dict(data)


def calibrated(rig: Rig, seed: int, poses: int = 14, settings: CalibrationSettings | None = None, u_mm: float = NOISE_MM) -> Calibration:
    """A campaign with errors of the reference poses and rounded counts, calibrated from the rig as it was before anything moved."""
    rng = np.random.default_rng(seed)
    made = simulate_campaign(rig, poses, rng, centre=MIDDLE, half_mm=(300.0, 300.0, 300.0), tilt_rad=0.3, u_position_mm=u_mm)
    campaign = Campaign(three_drums(), made.measured, rig.cable, made.recorded, np.zeros(3, np.int64))
    return calibrate(campaign, settings)


def earlier(found: Calibration) -> Earlier:
    return Earlier(found.rig, found.record, "before")


@pytest.fixture(scope="module")
def first() -> Calibration:
    return calibrated(three_drums(), 1)


def judged(first: Calibration, rig: Rig, seed: int = 2) -> Comparison:
    return compare(earlier(first), calibrated(rig, seed))


def test_a_rig_that_stood_still_has_not_moved(first: Calibration) -> None:
    found = judged(first, three_drums())
    assert not found.moved
    assert 12 <= found.together.freedom <= found.together.values == 15
    assert [p.point for p in found.points] == ["B1", "B2", "B3"]
    assert [c.cable for c in found.lengths] == ["c1", "c2", "c3"]
    assert "nothing moved" in comparison_summary(found)


def test_a_knocked_point_is_named_and_no_other(first: Calibration) -> None:
    found = judged(first, three_drums(shift_mm=3.0))
    assert [p.point for p in found.points if p.moved] == ["B2"]
    assert [c.cable for c in found.lengths if c.moved] == ["c2"]
    x = next(v for v in found.values if v.name == "B2.x_mm")
    assert abs(x.change - 3.0) < 4 * x.u


def test_a_shift_within_the_uncertainty_is_not_called_one(first: Calibration) -> None:
    found = judged(first, three_drums(shift_mm=0.02))
    assert next(v for v in found.values if v.name == "B2.x_mm").u > 0.02
    assert not found.moved


def test_the_joint_test_is_chi_squared_of_the_difference() -> None:
    first, second = (calibrated(three_drums(), seed, u_mm=0.0) for seed in (1, 2))
    found = compare(earlier(first), second)
    assert found.together.freedom == 15
    covariance = first.record.covariance_matrix() + second.record.covariance_matrix()
    d = np.array([b.value - a.value for a, b in zip(first.record.parameters, second.record.parameters, strict=True)])
    d = np.where([p.name.endswith("_deg") for p in first.record.parameters], (d + 180.0) % 360.0 - 180.0, d)
    chi2 = float(d @ np.linalg.solve(covariance, d))
    assert found.together.chi_squared == pytest.approx(chi2, rel=1e-6)
    assert found.together.probability == pytest.approx(float(scipy.stats.chi2.sf(chi2, 15)), rel=1e-6)


def test_false_alarms_are_as_rare_as_stated(first: Calibration) -> None:
    """Nine pairs of campaigns of a rig that stood still: probabilities are spread as chance spreads them."""
    results = [calibrated(three_drums(), 10 + k) for k in range(6)]
    pairs = [compare(earlier(results[i]), results[j]) for i in range(0, 6, 2) for j in range(1, 6, 2)]
    p = np.array([c.together.probability for c in pairs], dtype=np.float64)
    assert not any(c.moved for c in pairs)
    assert 0.2 < np.median(p) < 0.95  # the pairs share campaigns, so only the middle is asked for
    assert not any(length.moved for c in pairs for length in c.lengths)


def test_directions_that_only_priors_hold_take_no_part(first: Calibration) -> None:
    poor = calibrated(three_drums(), 4, poses=4)
    found = compare(earlier(first), poor)
    assert poor.record.rank < 15
    assert found.together.freedom <= poor.record.rank
    assert all(p.freedom < p.values for p in found.points)
    assert not found.moved


def test_a_value_solved_in_one_only_is_said(first: Calibration) -> None:
    second = calibrated(three_drums(), 5, settings=CalibrationSettings(solve=("position",)))
    found = compare(earlier(first), second)
    assert any("solved in only one of the two, and exact in the other" in note and "guide_alpha_deg" in note for note in found.notes)
    assert {v.name for v in found.values} == {p.name for p in first.record.parameters}


def test_rigs_without_a_common_point_are_refused(first: Calibration) -> None:
    data = first.rig.to_dict()
    for p in data["observation_point"]:
        p["name"] = f"X{p['name']}"
    for c in data["cable"]:
        c["from"] = f"X{c['from']}"
    with pytest.raises(CalibrationError, match="have no name in common"):
        compare(Earlier(rig_from_dict(data), renamed(first.record), "other"), first)


def renamed(record: CalibrationRecord) -> CalibrationRecord:
    return record.model_copy(update={"parameters": tuple(p.model_copy(update={"name": f"X{p.name}"}) for p in record.parameters)})


def test_a_cable_that_was_not_there_is_said(first: Calibration) -> None:
    data = first.rig.to_dict()
    data["cable"][0]["to"] = "P3"
    found = compare(Earlier(rig_from_dict(data), first.record, "before"), calibrated(three_drums(), 2))
    assert any("cable c1" in note for note in found.notes)
    assert [c.cable for c in found.lengths] == ["c2", "c3"]


def write_folder(folder: Path, rig: Rig, seed: int) -> None:
    rng = np.random.default_rng(seed)
    made = simulate_campaign(rig, 10, rng, centre=MIDDLE, half_mm=(300.0, 300.0, 300.0), tilt_rad=0.3)
    write_rig(folder / "rig.toml", three_drums())
    write_poses(folder / "reference_poses.csv", made.measured)
    write_table(folder / "counts.csv", {"pose": list(made.measured.names)} | dict(zip(made.channels, made.recorded.T, strict=True)))


def test_command_prints_the_table_and_writes_it_into_the_page(tmp_path: Path) -> None:
    write_folder(tmp_path / "a", three_drums(), 1)
    write_folder(tmp_path / "b", three_drums(shift_mm=1.0), 2)
    ran("calibrate", tmp_path / "a", "--out", tmp_path / "old")
    for old in (tmp_path / "old", tmp_path / "old" / "calibration.json"):
        result = ran("calibrate", tmp_path / "b", "--force", "--out", tmp_path / "new", "--compare", old)
        assert f"compared with {old}: something moved" in result
        moved = [line.split()[0] for line in result.splitlines() if line.endswith(" moved")]
        assert "B2" in moved
        assert "B1" not in moved
    # by the records alone, the same of the points, in the terminal and on the workbench's page
    own = ran("compare", tmp_path / "old", tmp_path / "new", "--out", tmp_path / "moved.json")
    points = [line for line in result.splitlines() if line.startswith(("B1 ", "B2 ", "B3 ", "all "))]
    assert len(points) == 4
    assert [line for line in own.splitlines() if line.startswith(("B1 ", "B2 ", "B3 ", "all "))] == points
    with client(tmp_path) as requested:
        text = unescape(requested.get("/calibrations?old=old/calibration.json&new=new/calibration.json").text)
    rows = [re.sub(r"<[^>]*>", " ", row).split() for row in re.findall(r"<tr class=.*?</tr>", text)]
    assert [row[0] for row in rows] == ["B1", "B2", "B3", "all"]
    assert [row[-1] == "moved" for row in rows] == [line.endswith("moved") for line in points]
    moved_json = json.loads((tmp_path / "moved.json").read_text())
    for value in moved_json["values"]:
        if value["u"] > 0.0:
            shift = f"{value['new'] - value['old']:+.4f}\xa0±\xa0{1.959964 * value['u']:.4f}"
            assert shift.replace("-", "\u2212") in text, value
    for words in (["old"], ["old", "new", "old"], ["old", "new", "--page", "page.html"]):
        refused("compare", *(tmp_path / w if w[0] != "-" else w for w in words), code=2)
    page = (tmp_path / "new" / "report.html").read_text()
    assert "Since the calibration" in page
    assert "Something moved beyond the uncertainties." in page


def test_an_earlier_calibration_that_is_not_there_is_one_line(tmp_path: Path, first: Calibration) -> None:
    with pytest.raises(FileFormatError, match="cannot be read"):
        read_earlier(tmp_path / "nothing")
    write_calibration_record(tmp_path / "calibration.json", first.record)
    with pytest.raises(FileFormatError, match=r"rig\.toml"):
        read_earlier(tmp_path)
