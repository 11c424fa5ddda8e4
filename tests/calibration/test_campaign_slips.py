"""Slips in a campaign's files are named, and applied, set aside or refused; counts come from a forward model that shares no code."""

from dataclasses import replace
from functools import cache

import numpy as np
from real_rig import scattered
from real_world import Case, RealCampaign, make
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Calibration, Campaign, calibrate
from lmeasure.core import FloatArray
from lmeasure.rig import Rig
from lmeasure.sensors import span_lengths

SLIPS = {"columns", "outlier", "exchanged_poses", "angles", "sign", "scale", "swapped", "attachment", "slip", "pass"}


@cache
def made(poses: int, stated: bool) -> RealCampaign:
    return make(Case(u_mm=0.03, stated=(0.03, 50e-6) if stated else None, poses=poses), 3, samples=2)


@cache
def sound_mm(poses: int, stated: bool) -> float:
    return error_mm(calibrate(made(poses, stated).campaign).rig, made(poses, stated))


def error_mm(rig: Rig, world: RealCampaign) -> float:
    """Root mean square error of the changes of lengths at poses that no campaign has."""
    poses = scattered(np.random.default_rng(8), 200)
    error = span_lengths(rig, poses) - world.truth.spans(poses)[0]
    return float(np.sqrt(np.mean((error - error.mean(axis=0)) ** 2)))


def moved(campaign: Campaign, rows: FloatArray) -> Campaign:
    return replace(campaign, poses=replace(campaign.poses, rows=rows))


def named(result: Calibration) -> list[tuple[str, str | None, str | None]]:
    return [(w.code, w.pose, w.channel) for w in result.record.warnings if w.code in SLIPS]


def test_a_coordinate_with_a_slip_is_set_aside() -> None:
    """Of the zero pose."""
    world = made(12, False)
    rows = world.campaign.poses.rows.copy()
    rows[0, 2] -= 100.0
    result = calibrate(moved(world.campaign, rows))
    assert named(result) == [("outlier", "1", None)]
    assert result.refused is None
    assert error_mm(result.rig, world) < 1.5 * sound_mm(12, False)


def test_a_count_with_a_slip_is_set_aside_alone() -> None:
    world = made(12, False)
    counts = world.campaign.counts.copy()
    counts[5, 3] += 833.0
    result = calibrate(replace(world.campaign, counts=counts))
    assert named(result) == [("outlier", "6", "ch4")]
    assert next(w for w in result.record.warnings if w.code == "outlier").value == counts[5, 3]
    assert {(r.pose, r.channel) for r in result.record.residuals}.isdisjoint({("6", "ch4")})
    assert error_mm(result.rig, world) < 1.2 * sound_mm(12, False)


def test_exchanged_poses_are_named_and_read_in_their_order() -> None:
    world, some = made(8, True), [1, 4, 7]
    rows = world.campaign.poses.rows.copy()
    rows[some] = rows[np.roll(some, 1)]
    result = calibrate(moved(world.campaign, rows))
    assert [code for code, _, _ in named(result)] == ["exchanged_poses"]
    text = next(str(w.text) for w in result.record.warnings if w.code == "exchanged_poses")
    assert all(str(i + 1) in text for i in some)
    np.testing.assert_allclose(result.campaign.poses.rows, world.campaign.poses.rows)


def test_angles_in_another_order_are_applied() -> None:
    """Columns of puma-oat filled from the last to the first."""
    world = made(12, False)
    angles = Rotation.from_quat(world.campaign.poses.rows[:, 3:]).as_euler("ZYX", degrees=True)
    wrong = Rotation.from_euler("ZYX", angles[:, ::-1], degrees=True).as_quat()
    campaign = moved(world.campaign, np.column_stack([world.campaign.poses.rows[:, :3], wrong]))
    result = calibrate(replace(campaign, rig=campaign.rig.model_copy(update={"angles": "kuka-abc"})))
    assert [code for code, _, _ in named(result)] == ["angles"]
    text = next(str(w.text) for w in result.record.warnings if w.code == "angles")
    # two readings with the same rotations
    assert any(reading in text for reading in ("kuka-abc with the columns in the order c_deg, b_deg, a_deg", "fanuc-wpr instead"))
    assert error_mm(result.rig, world) < 1.01 * sound_mm(12, False)


def test_coordinates_in_another_order_are_applied() -> None:
    world = made(8, True)
    result = calibrate(moved(world.campaign, world.campaign.poses.rows[:, [1, 2, 0, 3, 4, 5, 6]]))
    assert [code for code, _, _ in named(result)] == ["columns"]
    np.testing.assert_allclose(result.campaign.poses.rows, world.campaign.poses.rows)


def test_a_contradiction_that_nothing_explains_is_refused() -> None:
    """Orientations of other poses: no rule makes them right, and a rig that follows them is worse than the nominal one."""
    world = made(12, False)
    rows = world.campaign.poses.rows.copy()
    rows[:, 3:] = rows[np.random.default_rng(1).permutation(len(rows)), 3:]
    assert calibrate(moved(world.campaign, rows)).refused is not None
