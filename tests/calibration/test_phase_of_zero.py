"""Counters zeroed anywhere within a count, in a calibration: one error that all equations of a cable share, and how large it is."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from random_campaigns import RandomCampaign, draw, true_values
from scipy.stats import chi2
from zeroed import exactly, zeroed_exactly

from lmeasure.calibration import Campaign, Instrument, Model, of_cables, read_campaign, unknowns_of
from lmeasure.calibration.campaign.dwells import rounding_left
from lmeasure.core import FloatArray
from lmeasure.estimation import fit, regions
from lmeasure.io import write_table
from lmeasure.recording import pose_columns, poses_from_rows
from lmeasure.rig import Rig, rig_from_dict, write_rig
from lmeasure.sensors import counts_from_poses
from lmeasure.simulation import cell_rig, scattered_poses

HOME = np.array([0.0, 0, 0, 0, 0, 0, 1])
COUNT = 0.012
U2 = COUNT**2 / 12


def model_of(campaign: Campaign) -> Model:
    return Model(campaign, unknowns_of(campaign, ("position", "guide")))


def at_the_truth(campaign: Campaign, truth: Rig) -> tuple[FloatArray, FloatArray]:
    """(e,) residuals of the true rig, which are the errors of the counts, and (e, e) what is said of them."""
    model = model_of(replace(campaign, rig=truth))
    return model.residuals(model.parameters.nominal), model.reading_covariance()


@pytest.mark.parametrize("zeroed_there", [True, False])
def test_counts_err_by_what_is_said(zeroed_there: bool) -> None:
    """Either the phase of a counter zeroed at its zero pose is in all its equations, or the rounding of one that was only read there."""
    squares, means, freedom = [], [], 0
    generator = np.random.default_rng(3)
    for seed in range(60):
        drawn = draw(seed, points=3, noise="rounded", phased=True)
        campaign = drawn.campaign
        if not zeroed_there:
            elsewhere = scattered_poses(1, (300.0,) * 3, 0.3, HOME, rng=generator)[0]
            exact = counts_from_poses(drawn.truth, drawn.poses, elsewhere)
            campaign = replace(campaign, counts=np.rint(exact + generator.uniform(-0.5, 0.5, 3)))
        r, V = at_the_truth(campaign, drawn.truth)
        squares.append(r @ np.linalg.solve(V, r))
        freedom += len(r)
        # of means over poses, which hardly feel the roundings
        mean = r.reshape(-1, 3).mean(axis=0)
        of_mean = V.reshape(len(r) // 3, 3, -1, 3).mean(axis=(0, 2))
        means.append(mean @ np.linalg.solve(of_mean, mean))
        np.testing.assert_allclose(np.diag(V), 2 * U2, rtol=1e-9)
    assert 0.01 < chi2.sf(sum(squares), freedom) < 0.99
    assert 0.01 < chi2.sf(sum(means), 3 * len(means)) < 0.99


def test_an_exact_zero_errs_not_and_is_read_where_it_is_not_zero() -> None:
    drawn = draw(1, points=2, noise="rounded")
    assert drawn.truth.observation_point[0].drum.zero_exact
    _, V = at_the_truth(drawn.campaign, drawn.truth)
    np.testing.assert_allclose(V, U2 * np.eye(len(V)), rtol=1e-12)
    counts = drawn.campaign.counts.copy()
    counts[:, 1] += 700.0
    _, V = at_the_truth(replace(drawn.campaign, counts=counts), drawn.truth)
    first, second = slice(0, None, 2), slice(1, None, 2)
    np.testing.assert_allclose(V[first, first], U2 * np.eye(13), rtol=1e-12)
    np.testing.assert_allclose(V[second, second], U2 * (np.eye(13) + 1.0), rtol=1e-12)
    assert not V[first, second].any()


def in_passes(drawn: RandomCampaign, to: str) -> Campaign:
    """The campaign of a single cable counted in a second pass too, on the same channel to an attachment point."""
    data = drawn.truth.to_dict()
    data["cable"].append(dict(data["cable"][0], name="again", to=to) | {"pass": 2})
    rig = rig_from_dict(data)
    return replace(
        drawn.campaign, rig=rig, cables=rig.cable, counts=np.repeat(drawn.campaign.counts, 2, axis=1), zero=np.zeros(2, np.int64)
    )


def test_passes_share_a_phase_unless_the_counter_was_zeroed_again() -> None:
    drawn = draw(2, poses=5, phased=True)
    for to, common in (("P1", 1.0), ("P2", 0.0)):
        model = model_of(in_passes(drawn, to))
        V = model.reading_covariance().reshape(4, 2, 4, 2)
        np.testing.assert_allclose(V[:, 0, :, 1], common * U2, rtol=1e-12)
        np.testing.assert_allclose(V[:, 1, :, 1], U2 * (np.eye(4) + 1.0), rtol=1e-12)
    # one that shows another count where the second pass begins was not zeroed there
    campaign = in_passes(drawn, "P1")
    campaign.counts[:, 1] += 3.0
    assert not model_of(campaign).reading_covariance().reshape(4, 2, 4, 2)[:, 0, :, 1].any()


def folder_of(path: Path, rig: Rig, poses: FloatArray, names: list[str], recorded: FloatArray) -> Campaign:
    write_rig(path / "rig.toml", rig)
    write_table(path / "reference_poses.csv", pose_columns(poses_from_rows(poses), rig.angles))
    write_table(path / "counts.csv", {"pose": names} | {c.channel: recorded[:, j] for j, c in enumerate(rig.cable)})
    return read_campaign(path)


@pytest.mark.parametrize("sigma", [0.0, 0.15, 0.5])
@pytest.mark.parametrize("readings", [1, 40])
def test_what_dwells_leave_of_a_phase(tmp_path: Path, sigma: float, readings: int) -> None:
    """The mean of the readings at the zero pose tells the phase but for what a mean of roundings is off: of many zeroings that is met."""
    rig, n = cell_rig(5), 40
    poses = scattered_poses(6, (300.0,) * 3, 0.3, HOME, rng=np.random.default_rng(2))
    true = counts_from_poses(rig, poses, poses[0])
    generator, met, said = np.random.default_rng(7), [], []
    of_pose = np.repeat(np.arange(6), readings)
    for i in range(n):
        phase = generator.uniform(-0.5, 0.5, 6)
        noisy = np.rint(true[of_pose] + phase + sigma * generator.normal(size=(6 * readings, 6)))
        # a count is zero where it is zeroed, whatever stirs the cable then
        noisy -= noisy[0]
        if i == 0:
            campaign = folder_of(tmp_path, rig, poses, [str(k + 1) for k in of_pose], noisy)
            np.testing.assert_array_equal(campaign.counts, noisy.reshape(6, readings, 6).mean(axis=1))
            said = campaign.zero_variances.tolist()
        means = noisy.reshape(6, readings, 6).mean(axis=1)
        # long ways: the roundings of the other poses are drawn anew, those of the zero pose are common
        met.append((means[1:] - means[0] - true[1:]).mean(axis=0))
    left = rounding_left(sigma)
    own = left + (sigma**2 + 1 / 12 - left) / readings
    assert np.var(met) == pytest.approx(own * (1 + 1 / 5), rel=0.25)
    if readings > 1:
        assert np.mean(said) == pytest.approx(own, rel=0.3)
    else:
        # a single reading does not show its noise
        assert said == pytest.approx([1 / 12] * 6)


def test_still_dwells_of_an_exact_zero_leave_nothing(tmp_path: Path) -> None:
    rig = exactly(cell_rig(5))
    poses = scattered_poses(4, (300.0,) * 3, 0.3, HOME, rng=np.random.default_rng(2))
    recorded = np.rint(np.repeat(counts_from_poses(rig, poses, poses[0]), 3, axis=0))
    campaign = folder_of(tmp_path, rig, poses, [str(1 + k // 3) for k in range(12)], recorded)
    assert not campaign.zero_variances.any()
    assert (replace(campaign, rig=cell_rig(5), zero_variance=None).zero_variances == 1 / 12).all()


def test_cables_of_one_point_keep_their_own_readings() -> None:
    drawn = draw(4, points=3, phased=True)
    rng = np.random.default_rng(0)
    n = len(drawn.campaign.poses)
    campaign = replace(drawn.campaign, dwell_variance=rng.uniform(0.0, 0.1, (n, 3)), zero_variance=rng.uniform(0.0, 0.1, 3))
    own = of_cables(campaign, [2])
    own_V = Model(own, unknowns_of(own, ("position",))).reading_covariance()
    model = model_of(campaign)
    at = model.cable_index == 2
    np.testing.assert_allclose(own_V, model.reading_covariance()[np.ix_(at, at)], rtol=1e-12)


def test_calibrated_values_err_as_stated_where_counters_stand_anywhere_within_their_count() -> None:
    """Errors in the principal directions that the data determine, over their standard uncertainties; and the truth in the 95 % region."""
    squares, freedom, inside, other, nearer = 0.0, 0, 0, 0.0, 0
    trials = 30
    for seed in range(trials):
        drawn = draw(seed, noise="rounded", phased=True)
        model = model_of(drawn.campaign)
        truth = true_values(drawn, list(model.parameters.names))
        found = fit(model, truth)
        # to first order: how the result follows what the counts err by
        r = model.residuals(truth)
        error = found.directions[found.known] @ (found.gain @ r / model.parameters.width) * found.s[found.known]
        squares += float(error @ error)
        freedom += found.rank
        where = regions(found, seed)
        d = truth - found.theta
        square = float(d @ np.linalg.solve(where.covariance, d)) / where.factor**2
        inside += square <= 1.0
        nearer += square <= chi2.ppf(0.5, len(d)) / chi2.ppf(0.95, len(d))
        sure = model_of(zeroed_exactly(drawn.campaign))
        gain = fit(sure, truth)
        determined = gain.directions[gain.known] @ (gain.gain @ r / model.parameters.width) * gain.s[gain.known]
        other += float(determined @ determined)
    assert 0.01 < chi2.sf(squares, freedom) < 0.99
    assert inside >= 0.87 * trials
    # nor is the region too large: the half of all that is nearest lies where it should
    assert 0.3 * trials < nearer < 0.7 * trials
    assert chi2.sf(other, freedom) < 1e-6


def test_a_plan_counts_on_phases() -> None:
    """The zero pose's errors are those of the estimator: for an exact zero and an exact pose, none."""
    rig: Any = cell_rig(2)
    sigma, never = np.repeat([1e-4, 0.02], 3), np.zeros(6)
    rows = scattered_poses(5, (300.0,) * 3, 0.3, HOME, rng=np.random.default_rng(1))
    for chosen, phase in ((rig, 1.0), (exactly(rig), 0.0)):
        instrument = Instrument(chosen, chosen.cable, ("position",), 0.0 * sigma, visit=never)
        root = instrument.zero(rows[0]).root
        np.testing.assert_allclose(root @ root.T, phase * U2 * np.eye(6), atol=1e-20)
        instrument = Instrument(chosen, chosen.cable, ("position",), sigma, visit=never)
        counts = counts_from_poses(chosen, rows, rows[0])
        poses = replace(poses_from_rows(rows), u_position_mm=np.full(5, 0.02), u_rotation_rad=np.full(5, 1e-4))
        campaign = Campaign(chosen, poses, chosen.cable, counts, np.zeros(6, np.int64))
        model = Model(campaign, instrument.unknowns)
        V = model.covariance(instrument.unknowns.nominal).reshape(4, 6, 4, 6)
        root = instrument.zero(rows[0]).root
        np.testing.assert_allclose(root @ root.T, V[0, :, 1], rtol=1e-6, atol=1e-12)
