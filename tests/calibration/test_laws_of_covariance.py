"""What residuals of a campaign err by, pair by pair, from what each of the two has in common with the other."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from test_laws_of_residuals import POSES, campaign_of
from test_with_encoders import swivelled

from lmeasure.calibration import Campaign
from lmeasure.calibration.frame import model_of
from lmeasure.calibration.residuals import unknowns_of
from lmeasure.calibration.unknowns import Model
from lmeasure.rig import rig_from_dict
from lmeasure.unused_counts import ARM_MM

FloatArray = NDArray[np.float64]
COUNT_MM, TICK_MM = 0.012, 2.0 * np.pi / 131072 * ARM_MM
REFERENCE = np.array([0, 1, 2, 3, 1, 2])
"""The last two poses are later visits of earlier ones."""


def measured(**changes: Any) -> Campaign:
    """Six cables and six absolute encoders, in two passes; every channel is counted from one of three zero poses."""
    data = swivelled(2).to_dict()
    for number, point in enumerate(data["observation_point"]):
        point["drum"] |= {"count_length_mm": COUNT_MM, "scale": 1.0 + 0.1 * number, "zero_exact": number == 5}
    campaign, _ = campaign_of(rig_from_dict(data))
    # whole counts, which are zero where they were zeroed
    counts = campaign.counts.copy()
    scales = campaign.rig.scales(campaign.cables)
    counts[:, :6] = np.rint(counts * scales)[:, :6] / scales[:6]
    zero = campaign.zero
    counts[zero[:6], np.arange(6)] = 0.0
    return replace(campaign, temperature_c=None, counts=counts, **changes)


def model_with(campaign: Campaign) -> Model:
    return Model(campaign, unknowns_of(campaign, ("position",)))


def pairs(model: Model, law: Any) -> FloatArray:
    """(e, e) of a law of two residuals, each a pose and a channel."""
    each = list(zip(model.pose_index.tolist(), model.cable_index.tolist(), strict=True))
    return np.array([law(*one, *other) for one, other in product(each, each)]).reshape(len(each), len(each))


def count_mm(campaign: Campaign, j: int) -> float:
    """A recorded count."""
    return COUNT_MM / campaign.rig.scales(campaign.cables)[j] if j < 6 else TICK_MM


@pytest.mark.parametrize("dwelt", [False, True])
def test_counts_err_each_on_its_own_and_by_where_their_channel_was_zeroed(dwelt: bool) -> None:
    """Rounding is uniform within a count, and so is the phase of a zero that is not exact; the mean of a dwell has its own variance."""
    campaign = measured()
    if dwelt:
        rng = np.random.default_rng(3)
        of_zeros = np.r_[np.linspace(0.1, 0.2, 6), [0.0] * 6]
        campaign = replace(campaign, dwell_variance=rng.uniform(0.01, 0.1, (POSES, 12)), zero_variance=of_zeros)
    model = model_with(campaign)
    own = np.full((POSES, 12), 1.0 / 12.0) if campaign.dwell_variance is None else campaign.dwell_variance
    zero = np.r_[np.full(5, 1.0 / 12.0), np.zeros(7)] if campaign.zero_variance is None else campaign.zero_variance

    def law(i: int, j: int, k: int, m: int) -> float:
        if j != m:
            return 0.0
        return float(count_mm(campaign, j) ** 2 * (zero[j] + (own[i, j] if i == k else 0.0)))

    np.testing.assert_allclose(model.reading_covariance(), pairs(model, law), rtol=1e-9, atol=1e-18)
    whole, shared = model.uniform()
    cables = model.cable_index < 6
    own_mm2 = own * [count_mm(campaign, j) ** 2 for j in range(12)]
    np.testing.assert_allclose(whole[cables], own_mm2[model.pose_index[cables], model.cable_index[cables]])
    np.testing.assert_array_equal(whole[~cables], 0.0)
    assert shared.shape == (len(cables), 6 if dwelt else 5)


def test_visits_of_a_pose_share_its_error_and_cables_of_a_pass_the_robots() -> None:
    """By the residuals' derivatives by the poses, of the zero poses too."""
    rng = np.random.default_rng(5)
    u_visit = rng.uniform(1e-4, 1e-3, (POSES, 6)) * [1, 1, 1, 100, 100, 100]
    campaign = measured(reference=REFERENCE, u_visit=u_visit)
    # at each pose two cables and their encoders are read after the others
    data = campaign.rig.to_dict()
    for number in (1, 3):
        data["cable"][number]["pass"] = 2
    rig = rig_from_dict(data)
    assert [o.channel for o in rig.observed] == [o.channel for o in campaign.cables]
    model = model_with(replace(campaign, rig=rig, cables=rig.observed))
    second = model.campaign.cables
    passage = [c.passage for c in second]
    assert set(passage) == {1, 2}
    theta = model.start
    J = model.pose_jacobian(theta)
    spread = np.repeat([1e-4, 0.05], 3) ** 2
    counts = model.reading_covariance()
    expected = counts.copy()
    for e, f in product(range(len(J)), repeat=2):
        for a, b in product(range(POSES), repeat=2):
            if REFERENCE[a] == REFERENCE[b]:
                expected[e, f] += float((J[e, a] * spread) @ J[f, b])
        if passage[model.cable_index[e]] == passage[model.cable_index[f]]:
            expected[e, f] += sum(float((J[e, a] * u_visit[a] ** 2) @ J[f, a]) for a in range(POSES))
    np.testing.assert_allclose(model.measurement_covariance(theta), expected, rtol=1e-9, atol=1e-15)


def test_lengths_err_on_their_own_at_every_pose_and_where_they_were_zeroed() -> None:
    """Absolute encoders count from no zero pose."""
    model = model_with(measured(reference=REFERENCE))
    noise = model.noise
    u, taken = np.linspace(0.01, 0.12, 12), np.array([0.0, 0.04, 0.0, 0.09, 0.5, 0.7])
    plain = model.covariance(model.start)

    def of_lengths(i: int, j: int, k: int, m: int) -> float:
        return float(u[j] ** 2 * ((i == k) + (j < 6))) if j == m else 0.0

    wide = model.with_noise(noise.with_lengths(u))
    np.testing.assert_allclose(wide.covariance(model.start) - plain, pairs(model, of_lengths), rtol=1e-7, atol=1e-12)
    assert wide is not model
    assert model.noise is noise
    zero = model.campaign.zero

    def taken_back(i: int, j: int, k: int, m: int) -> float:
        """Each end of a residual is the length of a reference pose, whose variance a loss has raised."""
        if j != m:
            return 0.0
        ends = [{REFERENCE[i]: 1.0}, {REFERENCE[k]: 1.0}]
        for end in ends:
            if j < 6:
                end[REFERENCE[zero[j]]] = end.get(REFERENCE[zero[j]], 0.0) - 1.0
        return float(sum(ends[0].get(r, 0.0) * ends[1].get(r, 0.0) * taken[r] for r in range(POSES)))

    robust = model.with_noise(replace(noise, robust_variance_mm2=taken))
    np.testing.assert_allclose(robust.covariance(model.start) - plain, pairs(model, taken_back), rtol=1e-7, atol=1e-12)
    np.testing.assert_array_equal(robust.taken_back, taken[model.pose_index])
    assert model.taken_back is None


def test_poses_that_were_unknown_are_as_uncertain_as_their_unknowns() -> None:
    """Each component by its own variance, where rotations are free beside what the file states of the positions."""
    campaign = measured(reference=None)
    for free in ((0, 1, 2), tuple(range(6))):
        model = model_of(campaign, unknowns_of(campaign, ("position",)), free, "rig" if len(free) == 6 else None)
        theta = model.start
        n = len(theta)
        variance = np.linspace(1.0, 2.0, n) ** 2
        found = model.found_poses(theta, np.diag(variance))
        own = variance[model.own :].reshape(POSES, len(free))
        expected = np.zeros((POSES, 6))
        expected[:, free] = own * np.where(np.array(free) < 3, np.radians(1.0), 1.0) ** 2
        if len(free) == 3:
            expected[:, 3:] += 0.05**2
        assert found.covariance is not None
        np.testing.assert_allclose(found.covariance, [np.diag(v) for v in expected], rtol=1e-9, atol=1e-15)
        np.testing.assert_allclose(found.u_rotation_rad, np.sqrt(expected[:, :3].mean(axis=1)))
        np.testing.assert_allclose(found.u_position_mm, np.sqrt(expected[:, 3:].mean(axis=1)))
        np.testing.assert_allclose(found.rows, campaign.poses.rows, atol=1e-12)
    alone = model_with(campaign)
    assert alone.found_poses(alone.start, np.eye(len(alone.start))) is campaign.poses


def test_play_errs_for_each_reading_and_once_for_all_of_a_cable_where_it_was_zeroed() -> None:
    """Which way a cable was pulled where it rests nobody recorded; play that is known takes part in the zero alone, of angles in both."""
    data = swivelled(2).to_dict()
    for number, point in enumerate(data["observation_point"]):
        point["drum"] |= {
            "count_length_mm": COUNT_MM,
            "scale": 1.0 + 0.1 * number,
            "backlash_counts": 4.0,
            "u_backlash_counts": 1.0 + number,
        }
    data["swivel"] = [s | {"backlash_deg": 0.02} for s in data["swivel"]]
    campaign, _ = campaign_of(rig_from_dict(data))
    model = model_with(replace(campaign, temperature_c=None))
    stated, known = COUNT_MM * (1.0 + np.arange(6)) / (1.0 + 0.1 * np.arange(6)), COUNT_MM * 4.0 / (1.0 + 0.1 * np.arange(6))
    arc = np.radians(0.01) * ARM_MM

    def law(i: int, j: int, k: int, m: int) -> float:
        if j != m:
            return 0.0
        if j >= 6:
            return float(arc**2) if i == k else 0.0
        return float(stated[j] ** 2 + known[j] ** 2 + (stated[j] ** 2 if i == k else 0.0))

    found = model.unsolved_covariance(model.start)
    assert found is not None
    np.testing.assert_allclose(found, pairs(model, law), rtol=1e-9, atol=1e-18)
