"""Uncertainty, validation and diagnosis of calibrations whose poses are unknown, against refits and least squares of everything at once."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from random_campaigns import RandomCampaign, draw, true_unknowns
from scipy.spatial.transform import Rotation

from lmeasure.calibration import CalibrationSettings, Campaign, Model, calibrate, compare, unknowns_of
from lmeasure.calibration.solve.frame import condition, in_frame, model_of, motions, moved
from lmeasure.calibration.solve.joint_estimation import solve_jointly
from lmeasure.calibration.solve.unknown_poses import counted_poses, free_components
from lmeasure.calibration.validation.compare import Earlier
from lmeasure.calibration.validation.hold_out import deletion_residuals, shifted_lengths
from lmeasure.core import CalibrationError, FloatArray
from lmeasure.estimation import Deletion, Fit, fit
from lmeasure.recording import read_poses, write_poses
from lmeasure.rig import CalibrationRecord, Input
from lmeasure.sensors import counts_from_poses

POINT: dict[str, Any] = {"points": 6, "poses": 24, "attachments": 1, "off": (3.0, 0.0), "spread": (500.0, 0.3)}
FEW = POINT | {"poses": 16}
BODY: dict[str, Any] = {"points": 10, "poses": 24, "off": (3.0, 0.01), "spread": (500.0, 0.6)}
XYZ: dict[str, Any] = {"points": 6, "poses": 36, "oriented": False, "u_position_mm": 0.02, "spread": (500.0, 0.4)}
SELF = CalibrationSettings(self_calibration=True)


def solved(drawn: RandomCampaign, frame: Any = "rig", prior: bool = False) -> tuple[Model, Fit]:
    campaign = drawn.campaign
    return solve_jointly(
        campaign, ("position", "guide"), prior, free_components(campaign, not campaign.poses.oriented), frame=frame, seed=0
    )


@pytest.fixture(scope="module")
def point() -> tuple[Model, Fit]:
    return solved(draw(2, **POINT))


@pytest.mark.parametrize("frame", ["rig", "poses"])
@pytest.mark.parametrize("given", [POINT, BODY])
def test_frame_is_where_the_shifts_are_least(frame: Any, given: dict[str, Any]) -> None:
    """The condition's derivative against difference quotients, and the sum of squares against motions about the frame."""
    campaign = draw(0, **given).campaign
    model = model_of(campaign, unknowns_of(campaign, ("position", "guide")), free_components(campaign, False), frame)
    weight = np.zeros(len(model.names))
    if frame == "rig":
        weight[: model.own] = model.parameters.width**-2.0
    else:
        weight[[i for i, n in enumerate(model.names) if n.startswith("pose") and n.endswith("_mm")]] = 1.0

    def six(theta: FloatArray) -> FloatArray:
        return np.asarray(motions(model, theta).T @ (weight * (theta - model.start)))

    theta = model.start + np.random.default_rng(0).normal(size=len(weight))
    h = 1e-4
    numeric = np.array([(six(theta + d) - six(theta - d)) / (2 * h) for d in h * np.eye(len(theta))]).T
    np.testing.assert_allclose(condition(model, theta, frame), numeric, atol=1e-7 * np.abs(numeric).max())
    framed = in_frame(model, theta, frame)
    least = float(np.sum(weight * (framed - model.start) ** 2))
    for move in np.vstack([np.diag([1e-4] * 3 + [0.1] * 3), -np.diag([1e-4] * 3 + [0.1] * 3)]):
        there = moved(model, framed, move)
        assert float(np.sum(weight * (there - model.start) ** 2)) > least


def everything_at_once(model: Model, found: Fit) -> tuple[FloatArray, float]:
    """Optimum and chi-squared of SciPy's least squares with all unknowns, the poses' as good as any."""
    W = np.linalg.inv(np.linalg.cholesky(found.V))
    scale = np.r_[model.parameters.width, np.ones(len(found.theta) - model.own)]
    rng = np.random.default_rng(3)
    start = found.theta + 0.02 * scale * rng.normal(size=len(scale))
    result = scipy.optimize.least_squares(
        lambda t: W @ model.residuals(t), start, jac=lambda t: W @ model.jacobian(t), x_scale=scale, xtol=1e-15, ftol=1e-15, gtol=1e-15
    )
    return result.x, 2.0 * float(result.cost)


@pytest.mark.parametrize("frame", ["rig", "poses"])
def test_optimum_and_covariance_are_those_of_everything_at_once(frame: Any) -> None:
    """The bordered inverse of the information of all unknowns, not the elimination; the optimum moved into the same frame."""
    model, found = solved(draw(2, **POINT), frame)
    assert found.known.sum() == model.own - 6
    theta, chi2 = everything_at_once(model, found)
    assert found.chi2 == pytest.approx(chi2, rel=1e-6)
    J = np.linalg.solve(np.linalg.cholesky(found.V), model.jacobian(found.theta))
    scale = 1.0 / np.linalg.norm(J, axis=0)
    C = condition(model, found.theta, frame) * scale
    C /= np.linalg.norm(C, axis=1)[:, None]
    bordered = np.block([[scale[:, None] * (J.T @ J) * scale, C.T], [C, np.zeros((6, 6))]])
    expected = scale[:, None] * np.linalg.inv(bordered)[: len(J.T), : len(J.T)] * scale
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-5)
    assert np.abs((in_frame(model, theta, frame) - found.theta) / sigma).max() < 0.05


def test_positions_alone_are_as_everything_at_once() -> None:
    model, found = solved(draw(6, **XYZ))
    _, chi2 = everything_at_once(model, found)
    assert found.known.all()
    assert found.chi2 == pytest.approx(chi2, rel=1e-6)
    J = np.linalg.solve(np.linalg.cholesky(found.V), model.jacobian(found.theta))
    scale = 1.0 / np.linalg.norm(J, axis=0)
    expected = scale[:, None] * np.linalg.inv(scale[:, None] * (J.T @ J) * scale) * scale
    sigma = np.sqrt(np.diag(expected))
    np.testing.assert_allclose(found.covariance / np.outer(sigma, sigma), expected / np.outer(sigma, sigma), atol=1e-5)


def without(campaign: Campaign, pose: int) -> Campaign:
    counts = campaign.counts.copy()
    counts[pose] = np.nan
    return replace(campaign, counts=counts)


@pytest.mark.parametrize(("given", "poses"), [(XYZ | {"u_position_mm": 0.0}, (11,))])
def test_a_pose_left_out_is_judged_as_by_a_fit_without_it(given: dict[str, Any], poses: tuple[int, ...]) -> None:
    """chi-squared falls by the square of its shift, which has as many degrees of freedom as its own unknowns leave over; kept out and
    fitted with the calibrated rig, its errors and their uncertainties are those that deletion predicts."""
    drawn = draw(6, **given)
    model, found = solved(drawn)
    deletion, determined = Deletion(found), dict(deletion_residuals(model, found))
    left = 6 - model.pose_unknowns
    for pose in poses:
        judged = deletion.shift(shifted_lengths(model, np.array([pose])))
        assert judged is not None
        assert judged.freedom == left
        campaign = without(model.campaign, pose)
        other = model_of(campaign, model.parameters, tuple(model.free.tolist()), model.frame)
        start = found.theta[np.isin(model.names, other.names)]
        assert found.chi2 - fit(other, start).chi2 == pytest.approx(judged.square, rel=0.02)
        name = drawn.campaign.poses.names[pose]
        kept = calibrate(
            drawn.campaign, CalibrationSettings(hold_out=(name,), self_calibration=drawn.campaign.poses.oriented)
        ).record.validation
        errors = np.array([[p["error_mm"], p["u_mm"]] for p in kept["held_out"]["poses"]])
        assert np.sqrt(np.sum(errors[:, 0] ** 2) / left) == pytest.approx(determined[name], rel=0.02)
        rows = model.pose_index == pose
        values, vectors = np.linalg.eigh(deletion._P[np.ix_(rows, rows)])
        u = np.sqrt(np.diag((vectors[:, -left:] / values[-left:]) @ vectors[:, -left:].T))
        np.testing.assert_allclose(errors[:, 1], u, rtol=0.02)


def codes(record: CalibrationRecord) -> dict[str, Any]:
    return {w.code: w for w in record.warnings}


@pytest.fixture(scope="module")
def rounded() -> RandomCampaign:
    return draw(1, **(FEW | {"noise": "rounded"}))


def counted_wrong(campaign: Campaign, change: Any) -> Campaign:
    counts = campaign.counts.copy()
    change(counts)
    return replace(campaign, counts=counts)


def test_a_wild_count_is_named_and_the_robust_loss_takes_its_pose_back(rounded: RandomCampaign) -> None:
    def wild(counts: FloatArray) -> None:
        counts[7, 2] += 200

    campaign = counted_wrong(rounded.campaign, wild)
    plain = calibrate(campaign, SELF).record
    assert codes(plain)["outlier"].pose == "8"
    assert "misfit" in codes(plain)
    robust = calibrate(campaign, replace(SELF, robust=True)).record
    assert codes(robust)["down_weighted"].pose == "8"
    assert "misfit" not in codes(robust)
    clean = calibrate(without(rounded.campaign, 7), SELF).record
    for a, b in zip(robust.parameters, clean.parameters, strict=True):
        assert abs(a.value - b.value) < 1.5 * b.u
        assert 0.9 * b.u < a.u < 1.6 * b.u


def slip(counts: FloatArray) -> None:
    counts[9:, 3] -= 60


def half(counts: FloatArray) -> None:
    counts[:, 1] /= 2


def sign(counts: FloatArray) -> None:
    counts[:, 4] *= -1


@pytest.mark.parametrize(
    ("change", "code", "channel", "value", "tolerance"), [(slip, "slip", "ch4", -60 * 0.012, 0.05), (half, "scale", "ch2", 0.5, 0.0)]
)
def test_slips_and_scales_are_named_without_reference_poses(change: Any, code: str, channel: str, value: float, tolerance: float) -> None:
    named = codes(calibrate(counted_wrong(draw(1, **POINT).campaign, change), SELF).record)
    assert named[code].channel == channel
    assert named[code].value == pytest.approx(value, abs=tolerance)
    assert not {"slip", "scale", "sign", "swapped", "attachment"} & set(named) - {code}


def test_swapped_channels_of_one_point_are_named() -> None:
    """Two cables to one point: the fit exchanges their observation points, and hardly misses a count."""

    def swap(counts: FloatArray) -> None:
        counts[:, [0, 4]] = counts[:, [4, 0]]

    record = calibrate(counted_wrong(draw(1, **FEW).campaign, swap), SELF).record
    assert "ch1 and ch5" in codes(record)["swapped"].text


def test_what_nothing_can_judge_is_refused() -> None:
    campaign = draw(0, **(BODY | {"points": 8, "poses": 50})).campaign
    few = campaign.counts.copy()
    few[4, :2] = np.nan
    with pytest.raises(CalibrationError, match="--hold-out: pose 5: 6 counted cables and 6 unknowns of its own leave nothing to judge by"):
        calibrate(replace(campaign, counts=few), replace(SELF, hold_out=("5",)))
    few[4, :3] = np.nan
    with pytest.raises(CalibrationError, match=r"counts.csv: pose 5: 5 counted cables cannot determine its 6 unknowns. Remove the pose"):
        calibrate(replace(campaign, counts=few), SELF)
    rig = campaign.rig.model_copy(update={"tool": campaign.rig.tool | {"P3": campaign.rig.tool["P2"]}})
    with pytest.raises(CalibrationError, match="--self: the attachment points P1, P2, P3 lie on one line, and no length shows"):
        calibrate(replace(campaign, rig=rig), SELF)


def test_poses_that_were_not_counted_are_not_found(point: tuple[Model, Fit]) -> None:
    campaign = draw(2, **POINT).campaign
    result = calibrate(without(campaign, 5), SELF)
    assert "6" not in {p["pose"] for p in result.record.poses}
    assert "6" not in result.campaign.poses.names
    assert len(result.record.poses) == 23
    assert len(counted_poses(campaign).poses) == 24


def test_the_record_has_what_others_have() -> None:
    record = calibrate(draw(2, **(POINT | {"noise": "rounded"})).campaign, SELF).record
    assert sum(d["point"] == "frame" for d in record.spectrum) == 6
    assert sum(d["known"] for d in record.spectrum) + 3 * 24 == record.rank
    assert record.region["whole_counts"]
    assert record.region["factor"] > 3
    assert record.tangent_covariance is not None
    assert record.validation["poses"]
    assert all(p.U95 and p.U95 > 0 for p in record.parameters)


def visited(drawn: RandomCampaign, seed: int, u_mm: float) -> Campaign:
    """Each of the last ten poses comes a second time, where the robot repeats itself to u_mm."""
    campaign, rng = drawn.campaign, np.random.default_rng(seed)
    n, again = len(campaign.poses), np.arange(len(campaign.poses) - 10, len(campaign.poses))
    rows = drawn.poses[again].copy()
    rows[:, :3] += u_mm * rng.normal(size=(10, 3))
    counts = counts_from_poses(drawn.truth, np.vstack([drawn.poses, rows]), drawn.poses[0])[n:] + rng.normal(size=(10, 6)) / np.sqrt(12)
    order = np.r_[np.arange(n), again]
    p = campaign.poses
    names = (*p.names, *(f"{p.names[i]} (visit 2)" for i in again))
    poses = replace(p, names=names, rows=p.rows[order], u_position_mm=p.u_position_mm[order], u_rotation_rad=p.u_rotation_rad[order])
    visit = np.tile([0.0, 0.0, 0.0, u_mm, u_mm, u_mm], (n + 10, 1))
    return replace(campaign, poses=poses, counts=np.vstack([campaign.counts, counts]), reference=order, u_visit=visit)


def test_every_visit_has_a_pose_of_its_own() -> None:
    """The robot repeats itself to a millimetre only: visits that shared a pose, or an error, could not fit."""
    campaign = visited(draw(2, **POINT), 0, 1.0)
    record = calibrate(campaign, SELF).record
    assert record.unknowns == 30 + 3 * 34
    assert 0.4 < record.noise["chi_squared"] / record.noise["degrees_of_freedom"] < 1.7
    exact = calibrate(replace(campaign, u_visit=None), SELF).record
    assert [p.value for p in exact.parameters] == pytest.approx([p.value for p in record.parameters], abs=1e-9)
    assert [p["u_x_mm"] for p in exact.poses] == pytest.approx([p["u_x_mm"] for p in record.poses], rel=1e-9)
    # another visit is another pose to be judged
    assert {"20", "20 (visit 2)"} <= {p["pose"] for p in record.validation["poses"]}


def test_visits_of_positions_alone_share_the_stated_error_and_turn_on_their_own() -> None:
    drawn = draw(6, **(XYZ | {"u_position_mm": 0.05}))
    campaign = visited(drawn, 1, 0.01)
    assert campaign.u_visit is not None
    turns = np.tile([0.01, 0.01, 0.01, 0.0, 0.0, 0.0], (46, 1))
    free = free_components(campaign, True)
    model = model_of(replace(campaign, u_visit=campaign.u_visit + turns), unknowns_of(campaign, ("position", "guide")), free, None)
    V = model.covariance(model.start)
    # what is unknown anew at each visit is no uncertainty of it, the stated position's error is common to both
    assert model.campaign.u_visit == pytest.approx(campaign.u_visit)
    J = model.pose_jacobian(model.start)[:, :, 3:]
    shared = np.zeros((len(V), len(V)))
    for i in range(36):
        h = J[:, i] + (J[:, i + 10] if i >= 26 else 0.0)
        shared += 0.05**2 * h @ h.T
    own = sum(0.01**2 * J[:, i] @ J[:, i].T for i in range(46))
    np.testing.assert_allclose(V, shared + own + np.eye(len(V)) * 0.012**2 / 12, atol=1e-9)
    record = calibrate(campaign).record
    assert record.unknowns == 30 + 3 * 46
    assert 0.5 < record.noise["chi_squared"] / record.noise["degrees_of_freedom"] < 1.6
    assert "30 (visit 2)" not in {p["pose"] for p in record.validation["poses"]}


def test_poses_found_have_the_uncertainty_of_their_own(tmp_path: Path) -> None:
    """Errors of the poses in units of what poses.csv states of them, after a way through the file; the frame is the reference poses'."""
    drawn = draw(3, **(BODY | {"poses": 30}))
    result = calibrate(drawn.campaign, CalibrationSettings(self_calibration=True, frame="poses"))
    write_poses(tmp_path / "poses.csv", result.campaign.poses)
    poses = read_poses(tmp_path / "poses.csv", "puma-oat")
    assert poses.covariance is not None
    model = model_of(drawn.campaign, unknowns_of(drawn.campaign, ("position", "guide")), free_components(drawn.campaign, False), "poses")
    true = model.poses(true_unknowns(model, drawn))
    turn = (Rotation.from_quat(true[:, 3:]) * Rotation.from_quat(poses.rows[:, 3:]).inv()).as_rotvec()
    error = np.hstack([turn, true[:, :3] - poses.rows[:, :3]])
    squares = np.einsum("ni,nij,nj->n", error, np.linalg.inv(poses.covariance), error)
    assert 2.0 < squares.mean() < 12.0
    by_record = np.array([[p[f"u_{c}_mm"] for c in "xyz"] for p in result.record.poses])
    np.testing.assert_allclose(np.sqrt(np.einsum("nii->ni", poses.covariance)[:, 3:]), by_record, rtol=1e-9)


def test_frames_that_differ_are_not_compared() -> None:
    drawn = draw(2, **POINT)
    campaign = replace(drawn.campaign, inputs=(Input(file="rig.toml", sha256="0" * 64),))
    first = calibrate(campaign, SELF)
    earlier = Earlier(first.rig, first.record, "old")
    assert not compare(earlier, calibrate(campaign, replace(SELF, hold_out=("5",)))).moved
    with pytest.raises(CalibrationError, match="old: a self-calibration has a frame of its own") as error:
        compare(earlier, calibrate(campaign, replace(SELF, frame="poses")))
    assert "\n" not in str(error.value)
    with pytest.raises(CalibrationError, match="both with --self --frame rig from the same"):
        compare(earlier, calibrate(draw(2, **(POINT | {"off": (0.0, 0.0)})).campaign))
