"""Channels and points that are wrong in a campaign are named: scaled, reversed, swapped, attached elsewhere, other angles."""

from dataclasses import replace

import numpy as np
import pytest
from campaigns_of_truth import TRUTH, codes, held_out_errors, true_rig
from zeroed import zeroed_exactly

from lmeasure.calibration import CalibrationSettings, calibrate, read_campaign
from lmeasure.core import angles_from_rotation, rotation_from_angles
from lmeasure.recording import poses_from_rows
from lmeasure.rig import rig_from_dict


def test_noisy_reference_poses_are_noticed_and_carried() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "cell-20-poses-noisy"))
    result = calibrate(campaign)
    error = held_out_errors(result.rig, true_rig(campaign.rig, TRUTH / "cell-20-poses-noisy"))
    assert np.sqrt(np.mean(error**2)) < 0.041
    # its file states nothing: the residuals tell it
    assert "misfit" not in codes(result)
    assert codes(result)["assumed_position"].value == pytest.approx(0.05, abs=0.015)  # 1 sigma per axis, from 60 drawn numbers
    assert codes(result)["assumed_rotation"].value == pytest.approx(0.0, abs=0.003)
    assert "outlier" not in codes(result)


def test_half_scale_channel_is_named_and_no_other() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "thesis-16-poses-half-scale"))
    result = calibrate(campaign)
    named = [(w.channel, w.value) for w in result.record.warnings if w.code == "scale"]
    assert named == [("ch3", 0.5)]
    assert result.refused is None
    assert result.rig.point("B3").drum.scale == 0.5
    assert not [w for w in result.record.warnings if w.code in {"sign", "outlier"}]


def test_a_scale_that_is_solved_for_is_found() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "thesis-16-poses-half-scale"))
    data = campaign.rig.to_dict()
    data["observation_point"][2]["drum"]["scale"] = 0.49
    halved = campaign.counts.copy()
    halved[:, 2] /= 0.49
    result = calibrate(replace(campaign, rig=rig_from_dict(data), counts=halved), CalibrationSettings(("position", "guide", "scale")))
    scales = {p.name: p for p in result.record.parameters if p.name.endswith(".scale")}
    assert scales["B3.scale"].value == pytest.approx(0.5, abs=5 * scales["B3.scale"].u)
    assert result.rig.point("B3").drum.scale == scales["B3.scale"].value


def test_reversed_channel_is_named() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "cell-12-poses"))
    counts = campaign.counts.copy()
    counts[:, 1] *= -1
    result = calibrate(replace(campaign, counts=counts))
    assert [(w.code, w.channel) for w in result.record.warnings if w.code in {"sign", "scale"}] == [("sign", "ch2")]
    assert result.rig.point("B2").drum.count_sign == -campaign.rig.point("B2").drum.count_sign


def test_swapped_channels_are_named() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "cell-12-poses"))
    counts = campaign.counts.copy()
    counts[:, [1, 4]] = counts[:, [4, 1]]
    result = calibrate(replace(campaign, counts=counts))
    named = [w for w in result.record.warnings if w.code in {"swapped", "sign", "scale", "attachment"}]
    assert [w.code for w in named] == ["swapped"]
    assert [c.channel for c in result.rig.cable] == ["ch1", "ch5", "ch3", "ch4", "ch2", "ch6"]
    assert "ch2 and ch5" in named[0].text


def test_cable_at_another_attachment_point_is_named() -> None:
    campaign = zeroed_exactly(read_campaign(TRUTH / "cell-12-poses"))
    data = campaign.rig.to_dict()
    assert data["cable"][3]["to"] == "P2"
    data["cable"][3]["to"] = "P3"
    rig = rig_from_dict(data)
    result = calibrate(replace(campaign, rig=rig, cables=rig.cable))
    assert result.rig.cable[3].to_point == "P2"
    named = [w for w in result.record.warnings if w.code in {"swapped", "sign", "scale", "attachment"}]
    assert [(w.code, w.channel) for w in named] == [("attachment", "ch4")]
    assert "tied to P2 instead of P3" in named[0].text


def test_wrong_angle_convention_is_named() -> None:
    """Pose angles written by another controller: read as the rig's, they fit only in their own convention."""
    campaign = zeroed_exactly(read_campaign(TRUTH / "cell-12-poses"))
    angles = angles_from_rotation("staubli-xyz", campaign.poses.rotation)
    wrong = np.column_stack([campaign.poses.rows[:, :3], rotation_from_angles("puma-oat", angles).as_quat()])
    result = calibrate(replace(campaign, poses=poses_from_rows(wrong, campaign.poses.names)))
    named = [w for w in result.record.warnings if w.code in {"angles", "swapped", "sign", "scale", "attachment"}]
    assert [w.code for w in named] == ["angles"]
    assert "staubli-xyz" in named[0].text
    error = held_out_errors(result.rig, true_rig(campaign.rig, TRUTH / "cell-12-poses"))
    assert np.sqrt(np.mean(error**2)) < 0.02
