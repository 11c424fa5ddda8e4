"""Calibration of campaigns whose truth is known, through the files of the contract."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from campaigns_of_truth import TRUTH, codes, held_out_errors, true_rig
from scipy.spatial.transform import Rotation
from zeroed import exact_poses, zeroed_exactly

import lmeasure as lm
from lmeasure.calibration import Calibration, CalibrationSettings, Campaign, Model, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.core import CalibrationError, LMeasureError
from lmeasure.kernels import guide_direction
from lmeasure.recording import poses_from_rows
from lmeasure.rig import rig_from_dict
from lmeasure.sensors import span_lengths

PUBLISHED = Path(__file__).parents[2] / "calibration" / "thesis-5.5"


@pytest.fixture(scope="module")
def twelve() -> Calibration:
    return calibrate(exact_poses(zeroed_exactly(read_campaign(TRUTH / "cell-12-poses"))))


@pytest.fixture(scope="module")
def four() -> Calibration:
    return calibrate(exact_poses(zeroed_exactly(read_campaign(TRUTH / "thesis-4-poses"))))


@pytest.fixture(scope="module")
def published() -> Calibration:
    return calibrate(read_campaign(PUBLISHED))


def test_twelve_exact_poses_predict_held_out_lengths(twelve: Calibration) -> None:
    error = held_out_errors(twelve.rig, true_rig(twelve.campaign.rig, TRUTH / "cell-12-poses"), 3000)
    rms = np.sqrt(np.mean(error**2))
    assert rms <= 0.00251  # mm; a count is 0.012
    assert f"| {rms:.4f} mm rms over 3,000;" in (TRUTH.parents[2] / "README.md").read_text(encoding="utf-8")
    assert twelve.record.rank == twelve.record.unknowns == 30
    assert twelve.record.equations == 66
    assert not twelve.record.warnings
    assert not twelve.record.unobservable


def test_cables_that_end_on_one_line_are_calibrated_without_a_word_on_poses(twelve: Calibration) -> None:
    rig = rig_from_dict(twelve.campaign.rig.to_dict() | {"tool": {"P1": [0, 0, -50], "P2": [0, 0, 0], "P3": [0, 0, 60]}})
    scenario = {
        "waypoint": [{"position_mm": [0, 0, 0]}],
        "motion": {"dwell_s": 0.5},
        "reference_poses": {"count": 12, "u_position_mm": 0.02},
    }
    found = lm.calibrate(lm.simulate(scenario, rig=rig, rate_hz=50.0))
    assert found.record.rank == 30
    assert found.predicted.pose.shape[1] == 0
    assert twelve.predicted.pose.shape[1] == 6


def test_four_poses_are_underdetermined_and_say_so(four: Calibration) -> None:
    record = four.record
    assert (record.equations, record.unknowns, record.rank) == (9, 15, 9)
    assert [u.point for u in record.unobservable] == ["B1", "B1", "B2", "B2", "B3", "B3"]
    assert [w.code for w in record.warnings] == ["underdetermined"] * 3
    assert max(abs(r.mm) for r in record.residuals) < 1e-6
    rows = np.array([[u.direction.get(p.name, 0.0) for p in record.parameters] for u in record.unobservable])
    np.testing.assert_allclose(rows @ rows.T, np.eye(6), atol=1e-6)


def test_poses_that_are_stated_to_be_exact_have_no_smooth_errors(published: Calibration) -> None:
    """Four exact poses were said to have the smooth errors of a robot."""
    campaign = published.campaign
    exact = calibrate(replace(campaign, poses=campaign.poses.with_uncertainty(0.0, 0.0)))
    assert "smooth" in "".join(w.text for w in published.record.warnings)
    assert "smooth" not in "".join(w.text for w in exact.record.warnings)


def test_silent_directions_do_not_change_a_count(four: Calibration) -> None:
    model = Model(four.campaign, unknowns_of(four.campaign, ("position", "guide")))
    theta = np.array([p.value for p in four.record.parameters])
    width = np.array([p.prior_u for p in four.record.parameters])
    for u in four.record.unobservable:
        direction = np.array([u.direction.get(p.name, 0.0) for p in four.record.parameters]) * width
        step = 1e-4
        moved = (model.residuals(theta + step * direction) - model.residuals(theta - step * direction)) / (2 * step)
        assert np.abs(moved).max() < 1e-3  # mm per prior width, where a seen direction moves millimetres


def test_silent_directions_stay_at_the_nominal_value(four: Calibration) -> None:
    theta = np.array([p.value for p in four.record.parameters])
    model = Model(four.campaign, unknowns_of(four.campaign, ("position", "guide")))
    z = (theta - model.parameters.nominal) / model.parameters.width
    for u in four.record.unobservable:
        assert abs(z @ np.array([u.direction.get(p.name, 0.0) for p in four.record.parameters])) < 1e-6


def test_predicted_lengths_cover_the_true_error(twelve: Calibration) -> None:
    """Error of the calibrated rig at the predicted poses, since the zero pose, in units of its predicted standard uncertainty."""
    campaign, predicted = twelve.campaign, twelve.predicted
    truth = true_rig(campaign.rig, TRUTH / "cell-12-poses")
    rows = np.vstack([campaign.poses.rows[:1], predicted.rows])
    error = span_lengths(twelve.rig, rows) - span_lengths(truth, rows)
    ratio = (error[1:] - error[0]) / predicted.length_mm
    # one draw of thirty parameters: the mean square over the workspace has few degrees of freedom
    assert 0.2 < np.sqrt(np.mean(ratio**2)) < 2.0
    assert twelve.record.predicted["position_rms_mm"] < 0.02


def test_edge_of_the_neighbourhood_warns(twelve: Calibration) -> None:
    result = calibrate(twelve.campaign, CalibrationSettings(neighbourhood_mm=0.5, neighbourhood_deg=0.1))
    assert "edge" in codes(result)


def test_published_rig(published: Calibration) -> None:
    """Seed of the thesis: three equations a point, channel 3 decoded at half scale, positions known to decimetres at best."""
    record = published.record
    assert record.equations == record.rank == 9
    scale = [(w.channel, w.value) for w in record.warnings if w.code == "scale"]
    assert scale == [("K3", 0.5)]
    chosen = {c["point"]: c for c in record.coarse if c["chosen"]}
    np.testing.assert_allclose(chosen["B1"]["position_mm"], (132.580, -1896.547, 1655.774), atol=6e-4)
    np.testing.assert_allclose(chosen["B2"]["position_mm"], (8.818, -1150.928, 1413.946), atol=6e-4)
    spread = {r["point"]: np.subtract(r["high_mm"], r["low_mm"]) for r in record.ranges}
    assert spread["B1"].max() > 200
    assert spread["B2"].max() > 100


def test_result_does_not_depend_on_the_frame(twelve: Calibration) -> None:
    """Turning and moving the robot's base about the vertical moves the observation points with it."""
    campaign = twelve.campaign
    turn, move = Rotation.from_euler("z", 0.7), np.array([120.0, -340.0, 55.0])
    rows = campaign.poses.rows
    moved_rows = np.column_stack([turn.apply(rows[:, :3]) + move, (turn * Rotation.from_quat(rows[:, 3:])).as_quat()])
    data = campaign.rig.to_dict()
    for p in data["observation_point"]:
        p["position_mm"] = (turn.apply(p["position_mm"]) + move).tolist()
        # beta runs from +Y towards +X, against the sense of rotation about Z
        p["guide_beta_deg"] = float(np.degrees(np.arctan2(*turn.apply(_way(p["guide_beta_deg"]))[:2])))
    moved = calibrate(replace(campaign, rig=rig_from_dict(data), poses=poses_from_rows(moved_rows, campaign.poses.names)))
    for a, b in zip(twelve.rig.observation_point, moved.rig.observation_point, strict=True):
        np.testing.assert_allclose(turn.apply(a.position_mm) + move, b.position_mm, atol=1e-5)
        assert a.guide_alpha_deg == pytest.approx(b.guide_alpha_deg, abs=1e-5)


@pytest.mark.parametrize(("tilt_deg", "towards_deg"), [(4.0, 20.0), (0.3, -70.0)])
def test_guides_may_be_vertical(twelve: Calibration, tilt_deg: float, towards_deg: float) -> None:
    """A cable that goes straight down to its drum has a guide without a horizontal projection: its true direction, a few degrees off, has a
    beta that no nominal one tells."""
    campaign, found = twelve.campaign, np.array([_guide_of(p) for p in twelve.rig.observation_point])
    tilted = Rotation.from_euler("ZY", [towards_deg, tilt_deg], degrees=True).apply([0.0, 0.0, 1.0])
    turn = Rotation.align_vectors([tilted], [found[0]])[0]
    rows = campaign.poses.rows
    turned_rows = np.column_stack([turn.apply(rows[:, :3]), (turn * Rotation.from_quat(rows[:, 3:])).as_quat()])
    data = campaign.rig.to_dict()
    for p, own in zip(data["observation_point"], campaign.rig.observation_point, strict=True):
        p["position_mm"] = turn.apply(p["position_mm"]).tolist()
        x, y, z = turn.apply(_guide_of(own))
        p["guide_alpha_deg"], p["guide_beta_deg"] = np.degrees([np.arcsin(z), np.arctan2(-x, -y)]).tolist()
    data["observation_point"][0] |= {"guide_alpha_deg": 90.0, "guide_beta_deg": 100.0}
    turned = calibrate(replace(campaign, rig=rig_from_dict(data), poses=poses_from_rows(turned_rows, campaign.poses.names)))
    for a, b, u in zip(twelve.rig.observation_point, turned.rig.observation_point, found, strict=True):
        np.testing.assert_allclose(turn.apply(a.position_mm), b.position_mm, atol=1e-4)
        np.testing.assert_allclose(turn.apply(u), _guide_of(b), atol=1e-6)
    assert not {w.code for w in turned.record.warnings} & {"edge", "underdetermined"}


def _guide_of(point: Any) -> np.ndarray:
    """Direction in which the cable travels at B."""
    return np.array(guide_direction(np.radians(point.guide_alpha_deg), np.radians(point.guide_beta_deg)))


def _way(beta_deg: float) -> np.ndarray:
    return np.array([np.sin(np.radians(beta_deg)), np.cos(np.radians(beta_deg)), 0.0])


def test_same_seed_same_result(twelve: Calibration) -> None:
    assert calibrate(twelve.campaign).record == twelve.record


def test_nothing_to_solve_is_refused(twelve: Calibration) -> None:
    with pytest.raises(CalibrationError, match="colour"):
        calibrate(twelve.campaign, CalibrationSettings(("colour",)))


def folder_with(tmp_path: Path, **texts: str) -> Path:
    for name in ("rig.toml", "reference_poses.csv", "counts.csv"):
        text = (TRUTH / "cell-12-poses" / name).read_text()
        (tmp_path / name).write_text(texts.get(name.split(".")[0], text))
    return tmp_path


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("counts", lambda t: t.replace("\n2,", "\nother,"), "pose: 'other' is not in reference_poses.csv"),
        ("counts", lambda t: t + t.splitlines()[-1].replace(",", ",9").replace("9-", "-9") + "\n", "mm between readings of one dwell"),
        ("counts", lambda t: t.replace("ch3", "xx"), "column 'ch3' is missing"),
        ("counts", lambda t: "\n".join(t.splitlines()[:2]) + "\n", "At least 2 are needed"),
        ("counts", lambda t: t.splitlines()[0] + "\n", "has no rows"),
        ("reference_poses", lambda t: t.replace("o_deg", "phi"), "needs the columns"),
        ("reference_poses", lambda t: t.replace("\n3,", "\n2,"), "is given 2 times"),
    ],
)
def test_bad_folders_are_refused_in_one_line(tmp_path: Path, name: str, change: Any, message: str) -> None:
    text = (TRUTH / "cell-12-poses" / f"{name}.csv").read_text()
    with pytest.raises(LMeasureError, match=message) as raised:
        read_campaign(folder_with(tmp_path, **{name: change(text)}))
    assert "\n" not in str(raised.value)


def test_wrapped_counters_are_continued_by_the_nominal_rig(twelve: Calibration, tmp_path: Path) -> None:
    """16 bits of 0.012 mm wrap inside the stroke; the nominal rig is off by 30 mm, the register by 786."""
    rig_text = (TRUTH / "cell-12-poses" / "rig.toml").read_text().replace("count_sign = 1", "count_sign = 1\ncounter_bits = 16")
    lines = (TRUTH / "cell-12-poses" / "counts.csv").read_text().splitlines()
    wrapped = [lines[0]]
    for line in lines[1:]:
        pose, *counts = line.split(",")
        wrapped.append(",".join([pose, *(str((int(c) + 2**15) % 2**16 - 2**15) for c in counts)]))
    assert wrapped != lines
    campaign = read_campaign(folder_with(tmp_path, rig=rig_text, counts="\n".join(wrapped) + "\n"))
    np.testing.assert_array_equal(campaign.counts, twelve.campaign.counts)
    assert "unwrapped" in campaign.notes[0]


def test_guide_angles_come_back_to_their_range(twelve: Calibration) -> None:
    unknowns = unknowns_of(twelve.campaign, ("position", "guide"))
    theta = unknowns.nominal.copy()
    a, b = (unknowns.names.index(f"B1.guide_{k}_deg") for k in ("alpha", "beta"))
    theta[a], theta[b] = 180.0 - theta[a], theta[b] + 180.0
    same = rig_with(twelve.campaign, unknowns, theta, None)
    np.testing.assert_allclose(same.cable_rows()[:, :14], twelve.campaign.rig.cable_rows()[:, :14], atol=1e-9)
    assert abs(same.point("B1").guide_alpha_deg) <= 90


def test_campaign_counts_only_what_was_counted(twelve: Calibration) -> None:
    counts = twelve.campaign.counts.copy()
    counts[3, 2] = np.nan
    campaign: Campaign = replace(twelve.campaign, counts=counts)
    assert campaign.used.sum() == 65
    assert calibrate(campaign).record.equations == 65
