"""Poses kept out of the fit, the observability picture's numbers, and what the priors hold of the lengths."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from campaigns_of_truth import TRUTH, held_out_errors, true_rig
from random_campaigns import draw
from scipy.optimize import least_squares
from zeroed import zeroed_exactly

from lmeasure.calibration import CalibrationSettings, Model, calibrate, read_campaign, unknowns_of
from lmeasure.calibration.solve.unknowns import rig_with
from lmeasure.core import CalibrationError


def test_held_out_poses_are_told_with_their_uncertainty() -> None:
    """Standardised errors of held-out lengths over campaigns have unit mean square."""
    squares = []
    for seed in range(8):
        drawn = draw(seed, points=2, poses=24, u_position_mm=0.05)
        determined = calibrate(drawn.campaign, CalibrationSettings(hold_out=("5", "9", "14", "20"))).record.validation["held_out"]
        squares += [(p["error_mm"] / p["u_mm"]) ** 2 for p in determined["poses"]]
    assert len(squares) == 8 * 4 * 2
    # 64 of them, poses shared by two channels: standard deviation of the mean about 0.22
    assert np.mean(squares) == pytest.approx(1.0, abs=0.5)


def test_held_out_poses_take_no_part() -> None:
    drawn = draw(2, poses=16)
    counts = drawn.campaign.counts.copy()
    counts[[3, 7]] = np.nan
    without = calibrate(replace(drawn.campaign, counts=counts)).record
    record = calibrate(drawn.campaign, CalibrationSettings(hold_out=("4", "8"))).record
    assert record.parameters == without.parameters
    assert record.equations == 13


@pytest.mark.parametrize(("pose", "message"), [("99", "no such pose"), ("1", "zeroed there")])
def test_poses_that_cannot_be_held_out(pose: str, message: str) -> None:
    with pytest.raises(CalibrationError, match=message):
        calibrate(draw(2).campaign, CalibrationSettings(hold_out=(pose,)))


def test_spectrum_counts_the_rank() -> None:
    record = calibrate(draw(0, points=2, poses=5).campaign).record
    assert len(record.spectrum) == record.unknowns
    assert sum(d["known"] for d in record.spectrum) == record.rank
    assert {d["point"] for d in record.spectrum} == {"B1", "B2"}
    assert all(d["left"] > 1 for d in record.spectrum if not d["known"])


def test_the_priors_share_of_lengths_is_reported() -> None:
    warning = next(w for w in calibrate(draw(0, poses=5).campaign).record.warnings if w.code == "underdetermined")
    assert "so their nominal values are used (effect on lengths:" in warning.text


def test_optimum_is_that_of_a_generic_least_squares() -> None:
    """Twelve exact poses: SciPy from the nominal rig, without priors, reaches the same held-out error, 0.0025 mm."""
    folder: Path = TRUTH / "cell-12-poses"
    campaign = zeroed_exactly(read_campaign(folder))
    campaign = replace(campaign, poses=replace(campaign.poses, absent=()))  # stated as exact
    result, truth = calibrate(campaign), true_rig(campaign.rig, folder)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    width = model.parameters.width
    generic = least_squares(lambda z: model.residuals(model.parameters.nominal + width * z), np.zeros(len(width)), xtol=1e-15, ftol=1e-15)
    other = rig_with(campaign, model.parameters, model.parameters.nominal + width * generic.x, None)
    ours, theirs = held_out_errors(result.rig, truth, 3000), held_out_errors(other, truth, 3000)
    assert np.sqrt(np.mean(ours**2)) <= 0.00251
    assert np.sqrt(np.mean(ours**2)) == pytest.approx(np.sqrt(np.mean(theirs**2)), rel=0.01)
