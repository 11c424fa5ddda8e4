"""Residuals somewhat larger than chance has them: no alarm, and yet lengths that err are reckoned with, by as much as is likeliest."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats
from random_campaigns import draw
from test_with_encoders import campaign_of, swivelled

from lmeasure.calibration import Model, unknowns_of
from lmeasure.calibration.campaign.campaign import Break
from lmeasure.calibration.solve.unknowns import MOVE_MM
from lmeasure.calibration.validation.misfit import explain_misfit
from lmeasure.estimation import Fit, fit, improbable


def fitted(times: float, poses: int = 20) -> Fit:
    """A campaign whose errors are so many times those that are stated."""
    drawn = draw(4, points=6, poses=poses)
    campaign = drawn.campaign
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    found = fit(model, model.start)
    modelled = campaign.counts.copy()
    # a count is so much of a length here
    per_count = 0.012
    modelled[model.pose_index, model.cable_index] += found.residuals / per_count
    counts = modelled + times * (campaign.counts - modelled)
    louder = Model(replace(campaign, counts=counts), unknowns_of(campaign, ("position", "guide")))
    return fit(louder, louder.start)


def likeliest(found: Fit) -> float:
    """The size of errors that each length has on its own, that of its zero reading in all of its cable, by restricted likelihood: brute
    force over sizes."""
    model = found.problem
    assert isinstance(model, Model)
    J = model.jacobian(found.theta)
    same = model.cable_index[:, None] == model.cable_index
    S = np.eye(len(J)) + same
    best, least = 0.0, np.inf
    for u in np.linspace(0.0, 0.02, 401):
        V = found.V + u**2 * S
        W = np.linalg.inv(V)
        N = J.T @ W @ J
        P = W - W @ J @ np.linalg.solve(N, J.T @ W)
        loss = np.linalg.slogdet(V)[1] + np.linalg.slogdet(N)[1] + float(found.residuals @ P @ found.residuals)
        if loss < least:
            best, least = float(u), loss
    return best


@pytest.mark.parametrize(("chance", "doubted"), [(0.3, False), (0.025, False), (0.015, True), (0.002, True)])
def test_what_is_doubted_is_the_likeliest_error_of_lengths(chance: float, doubted: bool) -> None:
    found = fitted(1.0)
    times = float(np.sqrt(scipy.stats.chi2.isf(chance, found.freedom) / found.chi2))
    found = fitted(times)
    model = found.problem
    assert isinstance(model, Model)
    assert scipy.stats.chi2.sf(found.chi2, found.freedom) == pytest.approx(chance, rel=0.15)
    determined = explain_misfit(model, found, [])
    assert determined.findings == []
    assert not determined.estimated
    assert determined.fit is found
    np.testing.assert_allclose(determined.u_length_mm, likeliest(found) if doubted else 0.0, atol=1e-4)
    assert (determined.u_length_mm > 0.0).all() == doubted


@pytest.mark.parametrize("times", [1.6, 3.0])
def test_what_nothing_explains_is_carried_into_lengths_by_the_likeliest_size(times: float) -> None:
    """And multiplies the covariance, as much as chi-squared is too large; where a channel was named as grossly wrong its residuals explain
    nothing."""
    found = fitted(times)
    model = found.problem
    assert isinstance(model, Model)
    determined = explain_misfit(model, found, ["ch1"])
    excess = found.chi2 / found.freedom
    assert determined.fit.excess == pytest.approx(excess)
    np.testing.assert_allclose(determined.fit.covariance, found.covariance * excess)
    assert determined.estimated
    np.testing.assert_allclose(determined.u_length_mm, likeliest(found), atol=1e-4)
    (finding,) = determined.findings
    assert finding.code == "misfit"
    assert "First check the causes above (ch1)" in str(finding.text)


def test_a_noise_somewhat_larger_than_stated_is_an_estimated_one() -> None:
    """Of many residuals a third more than stated is beyond chance."""
    found = fitted(1.0, poses=60)
    times = float(np.sqrt(1.35 * found.freedom / found.chi2))
    found = fitted(times, poses=60)
    model = found.problem
    assert isinstance(model, Model)
    determined = explain_misfit(model, found, ["ch1"])
    assert 1.3 < determined.fit.excess < 1.4
    assert determined.estimated


def test_lengths_that_err_by_metres_are_carried_by_their_residuals() -> None:
    """Beyond the sizes that are looked for: what of their mean square the stated noise does not make up for."""
    found = fitted(3.0)
    model = found.problem
    assert isinstance(model, Model)
    far = replace(found, residuals=1e7 * found.residuals, V=1e14 * found.V)
    determined = explain_misfit(model, far, ["ch1"])
    rms, excess = np.sqrt(np.mean(far.residuals**2)), far.chi2 / far.freedom
    assert excess > 5.0
    np.testing.assert_allclose(determined.u_length_mm, rms * np.sqrt(1.0 - 1.0 / excess), rtol=1e-9)


@pytest.mark.parametrize(("chance", "blamed"), [(0.01, []), (1e-9, ["ch1"])])
def test_encoders_have_no_lengths_that_err(chance: float, blamed: list[str]) -> None:
    """Neither where residuals are doubted nor where nothing explains them."""
    campaign, _ = campaign_of(swivelled(2), 10)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    found = fit(model, model.start)
    louder = np.sqrt(scipy.stats.chi2.isf(chance, found.freedom) / found.chi2)
    loud = replace(found, residuals=louder * found.residuals, chi2=louder**2 * found.chi2)
    determined = explain_misfit(model, loud, blamed)
    assert (determined.u_length_mm[:6] > 0.0).all()
    np.testing.assert_array_equal(determined.u_length_mm[6:], 0.0)


@pytest.mark.parametrize("wrong", ["pose", "counter", "all", "too few"])
def test_what_the_others_contradict_most_is_named(wrong: str) -> None:
    """A pose that was elsewhere, a counter that slipped by fifty counts; nothing where all err alike, or none could contradict another."""
    drawn = draw(4, points=1, poses=7) if wrong == "too few" else draw(4, points=6, poses=20)
    campaign = drawn.campaign
    counts, rows = campaign.counts.copy(), campaign.poses.rows.copy()
    if wrong == "pose":
        rows[7, :3] += [2.0, -1.0, 1.5]
    elif wrong == "counter":
        counts[12:, 2] += 50.0
    else:
        counts[1:] += 3.0 * np.random.default_rng(1).normal(size=counts[1:].shape)
    campaign = replace(campaign, counts=counts, poses=replace(campaign.poses, rows=rows))
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    found = fit(model, model.start)
    assert improbable(found)
    assert (found.freedom < 3) == (wrong == "too few")
    after = explain_misfit(model, found, [])
    named = [w for w in after.findings if w.code in ("outlier", "slip")]
    if wrong == "pose":
        assert [(w.code, w.pose) for w in named] == [("outlier", "8")]
    elif wrong == "counter":
        assert [(w.code, w.channel, w.pose) for w in named] == [("slip", "ch3", "13")]
        assert named[0].value == pytest.approx(0.6, rel=0.05)
        clean = fit(Model(drawn.campaign, model.parameters), model.start)
        # solved for: neither the values nor the residuals keep anything of it
        assert np.abs((after.fit.theta - clean.theta) / np.sqrt(np.diag(after.fit.covariance))).max() < 2.0
        assert np.sqrt(np.mean(after.fit.residuals**2)) < 1.1 * np.sqrt(np.mean(clean.residuals**2))
    else:
        assert named == []


def test_a_moved_point_was_elsewhere_at_the_poses_before_and_at_the_zero_pose() -> None:
    """Columns of a move against differences of residuals by the point: of whole changes before it, and of the zero pose alone after it."""
    campaign = draw(4, points=6, poses=20).campaign
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")))
    cable, names = campaign.cables[2], campaign.poses.names
    at_all_but_the_last, at_zero_alone = (
        model.with_break(Break(cable.channel, name)).break_shifts(model.start)[:, 1:] / MOVE_MM for name in (names[-1], names[1])
    )
    own, step = model.cable_index == 2, 1e-4
    whole = np.zeros((len(own), 3))
    for axis in range(3):
        moved = np.zeros_like(model.start)
        moved[model.names.index(f"{cable.from_point}.{'xyz'[axis]}_mm")] = step
        whole[:, axis] = (model.residuals(model.start + moved) - model.residuals(model.start - moved)) / (2.0 * step)
    last = own & (model.pose_index == len(names) - 1)
    before = own & ~last
    assert before.sum() == 18
    assert last.sum() == 1
    sign = np.sign((at_all_but_the_last[before] * whole[before]).sum())  # of a move there or back
    np.testing.assert_allclose(sign * at_all_but_the_last[before], whole[before], atol=1e-7)
    np.testing.assert_allclose(at_all_but_the_last[last], at_zero_alone[last], atol=1e-12)
    assert np.linalg.norm(at_zero_alone[own], axis=1) == pytest.approx(1.0, abs=1e-6)  # a straight span ends there
    assert not at_zero_alone[~own].any()


def silent(poses: int, left: int, u_mm: float) -> Fit:
    """A campaign whose poses do not say how uncertain they are, with so many degrees of freedom left, and errors of so much: places of its
    points are sought."""
    drawn = draw(4, points=6, poses=poses, u_position_mm=u_mm)
    campaign = drawn.campaign
    stated, counts = replace(campaign.poses, u_position_mm=np.zeros(poses), absent=("position",)), campaign.counts.copy()
    counts[-1, : 6 * (poses - 1) - 18 - left] = np.nan
    campaign = replace(campaign, rig=drawn.truth, poses=stated, counts=counts)
    model = Model(campaign, unknowns_of(campaign, ("position",)))
    found = fit(model, model.start)
    assert found.freedom == left
    return found


@pytest.mark.parametrize(("left", "telling"), [(11, False), (12, True)])
def test_twelve_degrees_of_freedom_tell_how_uncertain_poses_are(left: int, telling: bool) -> None:
    """Exact poses then err by less than a count, whose rounding hides more; with fewer an assumed size stays."""
    found = silent(6, left, 0.0)
    assert isinstance(found.problem, Model)
    determined = explain_misfit(found.problem, found, [])
    (finding,) = determined.findings
    assert ("is estimated from the residuals" if telling else "too few residuals are left to estimate it. 0.1 mm") in str(finding.text)
    assert finding.value is not None
    np.testing.assert_allclose(determined.model.noise.u_position_mm, finding.value)
    assert (1e-4 < finding.value < 0.012) if telling else finding.value == 0.1


def test_poses_that_do_not_say_are_as_uncertain_as_their_residuals() -> None:
    """Not what was assumed in place of a statement beside it."""
    found = silent(20, 96, 0.12)
    assert isinstance(found.problem, Model)
    determined = explain_misfit(found.problem, found, [])
    assert determined.estimated
    (finding,) = determined.findings
    assert finding.value == pytest.approx(0.12, rel=0.25)
    assert determined.model.noise.u_position_mm == pytest.approx(finding.value)
    assert determined.fit.chi2 / determined.fit.freedom == pytest.approx(1.0, abs=0.3)


def test_what_is_assumed_stays_beside_what_explains_residuals() -> None:
    """Of poses that do not say how uncertain they are and residuals too few to tell."""
    found = silent(6, 11, 3.0)
    assert isinstance(found.problem, Model)
    determined = explain_misfit(found.problem, found, [])
    assert [w.code for w in determined.findings][-1] == "misfit"
    assert determined.model is not found.problem
    assert (determined.model.noise.u_position_mm >= 0.1).all()
