"""Draw an instrument, simulate a campaign, calibrate, compare: every option of the calibration inherits this."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.stats
from random_campaigns import RandomCampaign, draw, errors, square_of, true_values
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration, CalibrationSettings, Model, calibrate, unknowns_of
from lmeasure.core import se3
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import span_lengths

SEEDS = range(3)
CHANCE = 1e-5  # of a correct calibration failing one comparison


def compare(drawn: RandomCampaign, result: Calibration) -> None:
    """The error is one that the stated covariance allows, and so are the lengths the rig predicts."""
    record = result.record
    error = np.array([p.value for p in record.parameters]) - true_values(drawn, [p.name for p in record.parameters])
    square = float(error @ np.linalg.solve(record.covariance_matrix(), error))
    assert scipy.stats.chi2.ppf(CHANCE, len(error)) < square < scipy.stats.chi2.isf(CHANCE, len(error))
    rng = np.random.default_rng(9)
    rows = np.column_stack([rng.uniform(-300, 300, (100, 3)), Rotation.from_rotvec(rng.uniform(-0.3, 0.3, (100, 3))).as_quat()])
    rows = np.vstack([drawn.campaign.poses.rows[:1], rows])
    wrong = span_lengths(result.rig, rows) - span_lengths(drawn.truth, rows)
    worst = max(e["worst_mm"] for e in record.predicted["lengths"])
    # outside the reference poses' box the prediction grows; inside it the worst pose bounds all
    assert np.abs(wrong[1:] - wrong[0]).max() < 8 * max(worst, 0.004)


@pytest.mark.parametrize("seed", SEEDS)
@pytest.mark.parametrize("noise", ["gaussian", "rounded"])
def test_exact_poses(seed: int, noise: str) -> None:
    drawn = draw(seed, points=2, poses=14, noise=noise)
    result = calibrate(drawn.campaign)
    assert not {w.code for w in result.record.warnings} - {"nonlinear"}
    compare(drawn, result)


@pytest.mark.parametrize("seed", SEEDS)
def test_stated_pose_errors(seed: int) -> None:
    drawn = draw(seed, points=6, poses=22, noise="rounded", u_position_mm=0.05)
    result = calibrate(drawn.campaign)
    assert "misfit" not in {w.code for w in result.record.warnings}
    compare(drawn, result)


OPTIONS = {
    "default": CalibrationSettings(),
    "robust": CalibrationSettings(robust=True),
    "held out": CalibrationSettings(hold_out=("4", "11")),
    "scale": CalibrationSettings(("position", "guide", "scale")),
}


@pytest.mark.parametrize(("option", "noise"), [("default", "gaussian"), *((option, "rounded") for option in OPTIONS)])
def test_regions_hold_the_truth_as_often_as_they_say(option: str, noise: str) -> None:
    """The short form of benchmarks/calibration_coverage.py, over every option."""
    inside, below = 0, []
    for seed in range(12):
        drawn = draw(500 + seed, poses=20 + seed % 6, noise=noise)
        record = calibrate(drawn.campaign, OPTIONS[option]).record
        if record.rank < record.unknowns:
            continue
        error = np.array([p.value for p in record.parameters]) - true_values(drawn, [p.name for p in record.parameters])
        square = float(error @ np.linalg.solve(record.covariance_matrix(), error))
        inside += square <= record.region["factor"] ** 2
        below.append(scipy.stats.chi2.cdf(square, len(error)))
    assert len(below) >= 8
    assert scipy.stats.binomtest(inside, len(below), 0.95, alternative="less").pvalue > 1e-3
    # nor is the covariance wider than the errors are: their probabilities under it are anywhere from 0 to 1
    assert abs(np.mean(below) - 0.5) < 4.0 / np.sqrt(12 * len(below))


POINT: dict[str, Any] = {"points": 6, "poses": 24, "attachments": 1, "off": (3.0, 0.0), "spread": (500.0, 0.3)}
BODY: dict[str, Any] = {"points": 10, "poses": 24, "off": (3.0, 0.01), "spread": (500.0, 0.6)}
XYZ: dict[str, Any] = {"points": 7, "poses": 22, "oriented": False, "u_position_mm": 0.02, "spread": (500.0, 0.4)}
UNKNOWN_POSES = {
    "self, one point": (POINT, CalibrationSettings(self_calibration=True)),
    "self, a body": (BODY, CalibrationSettings(self_calibration=True)),
    "self, held out": (POINT, CalibrationSettings(self_calibration=True, hold_out=("4", "11"))),
    "self, prior": (POINT, CalibrationSettings(self_calibration=True, prior=True, frame="poses")),
    "positions alone": (XYZ, CalibrationSettings()),
}


@pytest.mark.parametrize("option", UNKNOWN_POSES)
def test_regions_of_rigs_found_with_their_poses(option: str) -> None:
    """The short form of benchmarks/self_calibration_coverage.py: the truth in the frame of the result, values held by priors among them."""
    given, settings = UNKNOWN_POSES[option]
    drawn = draw(501, noise="rounded", **given)
    record = calibrate(drawn.campaign, settings).record
    assert not {"misfit", "not_converged"} & {w.code for w in record.warnings}
    assert square_of(record, errors(drawn, record, settings)) <= record.region["factor"] ** 2


def without(drawn: RandomCampaign, key: str, shift: float) -> Rig:
    """The campaign's nominal rig with one more value off by `shift` on every point."""
    data: dict[str, Any] = drawn.campaign.rig.to_dict()
    for p in data["observation_point"]:
        holder = p if key in p else p["drum"]
        holder[key] = holder.get(key, 1.0) + shift
    return rig_from_dict(data)


@pytest.mark.parametrize(
    ("group", "key", "shift"),
    [
        ("radius", "pulley_radius_mm", 0.8),
        ("tangent", "tangent_length_mm", 4.0),
        ("axial", "axial_offset_mm", 4.0),
        ("pitch", "groove_pitch_mm", 0.04),
    ],
)
@pytest.mark.parametrize("seed", SEEDS[:2])
def test_more_unknowns(seed: int, group: str, key: str, shift: float) -> None:
    """What is not solved for biases; what is solved for is covered by its stated uncertainty."""
    drawn = draw(seed, points=1, poses=24, noise="gaussian")
    off = replace(drawn, campaign=replace(drawn.campaign, rig=without(drawn, key, shift)))
    result = calibrate(off.campaign, CalibrationSettings(("position", "guide", group)))
    compare(off, result)


@pytest.mark.parametrize("seed", SEEDS[:2])
def test_scale(seed: int) -> None:
    drawn = draw(seed, points=1, poses=24, noise="gaussian")
    off = without(drawn, "scale", 0.004)
    counts = drawn.campaign.counts / 1.004
    truth = drawn.truth.to_dict()
    truth["observation_point"][0]["drum"]["scale"] = 1.0
    moved = RandomCampaign(replace(drawn.campaign, rig=off, counts=counts), rig_from_dict(truth), drawn.poses)
    compare(moved, calibrate(moved.campaign, CalibrationSettings(("position", "guide", "scale"))))


@pytest.mark.parametrize("seed", SEEDS[:2])
def test_prior_everywhere(seed: int) -> None:
    drawn = draw(seed, points=1, poses=6, noise="gaussian")
    held = calibrate(drawn.campaign, CalibrationSettings(prior=True))
    assert "not_converged" not in {w.code for w in held.record.warnings}
    compare(drawn, held)


@pytest.mark.parametrize("seed", SEEDS)
def test_too_few_poses_are_never_a_bare_optimum(seed: int) -> None:
    drawn = draw(seed, points=1, poses=5, noise="gaussian")
    record = calibrate(drawn.campaign).record
    assert record.rank <= 4 < record.unknowns
    assert record.unobservable
    assert "underdetermined" in {w.code for w in record.warnings}


def test_a_stated_pose_whose_turn_was_free_has_its_own_uncertainty_and_that_of_the_turn() -> None:
    """By differences of the poses, for a covariance of the unknowns that couples them all."""
    rng, campaign = np.random.default_rng(2), draw(0, points=2, poses=14, noise="gaussian", u_position_mm=0.05).campaign
    u = np.linspace(0.02, 0.3, len(campaign.poses))
    poses = replace(campaign.poses, u_position_mm=u, u_rotation_rad=np.zeros(len(u)), covariance=None)
    campaign = replace(campaign, poses=poses)
    model = Model(campaign, unknowns_of(campaign, ("position", "guide")), free=(0, 1, 2), frame="rig")
    theta = model.start + 0.3 * rng.normal(size=len(model.start)) * (np.arange(len(model.start)) >= model.own)
    root = rng.normal(size=(len(theta), len(theta)))
    h, at = 1e-6, model.poses(theta)
    ahead, behind = (np.stack([se3.displacement(model.poses(theta + sign * h * e), at) for e in np.eye(len(theta))]) for sign in (1, -1))
    moved = np.einsum("pni,pq->nqi", (ahead - behind) / (2.0 * h), root)
    expected = np.einsum("nqi,nqj->nij", moved, moved) + np.einsum("n,ij->nij", u**2, np.diag([0.0, 0.0, 0.0, 1.0, 1.0, 1.0]))
    found = model.found_poses(theta, root @ root.T)
    assert found.covariance is not None
    np.testing.assert_allclose(found.covariance, expected, rtol=1e-5, atol=1e-6)
    np.testing.assert_array_equal(found.rows, at)
    squares = np.einsum("nii->ni", expected)
    np.testing.assert_allclose(found.u_position_mm, np.sqrt(squares[:, 3:].mean(axis=1)), rtol=1e-5)
    np.testing.assert_allclose(found.u_rotation_rad, np.sqrt(squares[:, :3].mean(axis=1)), rtol=1e-5)
