"""Robust loss: a pose that the others contradict loses its say, and nothing else changes."""

from dataclasses import replace

import numpy as np
import pytest
from random_campaigns import RandomCampaign, draw, true_values

from lmeasure.calibration import Calibration, CalibrationSettings, calibrate
from lmeasure.rig import CalibrationRecord


def with_bad_poses(drawn: RandomCampaign, bad: dict[int, tuple[float, float, float]]) -> RandomCampaign:
    """The robot stood elsewhere than it says at some poses: {number: error [mm]}."""
    rows = drawn.campaign.poses.rows.copy()
    for pose, shift in bad.items():
        rows[pose, :3] += shift
    return replace(drawn, campaign=replace(drawn.campaign, poses=replace(drawn.campaign.poses, rows=rows)))


def squares(drawn: RandomCampaign, record: CalibrationRecord) -> float:
    """Squared error of all values in standard uncertainties, in units of the 95 % region."""
    error = np.array([p.value for p in record.parameters]) - true_values(drawn, [p.name for p in record.parameters])
    return float(error @ np.linalg.solve(record.covariance_matrix(), error)) / record.region["factor"] ** 2


def robust(drawn: RandomCampaign) -> Calibration:
    return calibrate(drawn.campaign, CalibrationSettings(robust=True))


@pytest.mark.parametrize("bad", [{5: (1.0, -2.0, 1.5)}, {3: (0.4, 0.3, -0.5), 8: (-1.0, 2.0, 1.0), 12: (0.2, -0.9, 0.3)}])
def test_bad_poses_lose_their_say(bad: dict[int, tuple[float, float, float]]) -> None:
    clean = draw(11, points=2, poses=22, noise="rounded")
    drawn = with_bad_poses(clean, bad)
    record = robust(drawn).record
    named = {w.pose for w in record.warnings if w.code == "down_weighted"}
    assert named == {str(i + 1) for i in bad}
    assert "misfit" not in {w.code for w in record.warnings}
    assert squares(drawn, record) < 1.5
    # as good as a campaign without these poses
    counts = clean.campaign.counts.copy()
    counts[list(bad)] = np.nan
    without = calibrate(replace(clean.campaign, counts=counts)).record
    u = np.array([p.u for p in record.parameters]) / [p.u for p in without.parameters]
    assert u.max() < 1.2
    difference = np.array([p.value for p in record.parameters]) - [p.value for p in without.parameters]
    assert (np.abs(difference) < 0.7 * np.array([p.u for p in without.parameters])).all()


def test_bad_zero_pose_is_found_too() -> None:
    """Its error is in every residual; all other poses agree among themselves."""
    drawn = with_bad_poses(draw(11, points=3, poses=22), {0: (1.0, 0.5, -1.5)})
    plain, record = calibrate(drawn.campaign).record, robust(drawn).record
    assert [w.pose for w in plain.warnings if w.code == "outlier"] == ["1"]
    assert [w.pose for w in record.warnings if w.code == "down_weighted"] == ["1"]
    assert squares(drawn, record) < 1.5


@pytest.mark.parametrize("seed", range(2))
def test_clean_campaigns_lose_little(seed: int) -> None:
    drawn = draw(seed, points=2, poses=20)
    plain, record = calibrate(drawn.campaign).record, robust(drawn).record
    assert squares(drawn, record) < 1.5
    u = np.array([p.u for p in record.parameters]) / [p.u for p in plain.parameters]
    assert u.max() < 1.35
    assert min(w["weight"] for w in record.robust["weights"]) > 0.0


def test_hypotheses_of_outliers_stay() -> None:
    drawn = with_bad_poses(draw(11, points=2, poses=22, noise="rounded"), {5: (1.0, -2.0, 1.5)})
    for settings in (CalibrationSettings(), CalibrationSettings(robust=True)):
        record = calibrate(drawn.campaign, settings).record
        assert [w.pose for w in record.warnings if w.code == "outlier"] == ["6"]
