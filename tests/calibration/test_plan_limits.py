"""Limits that planned poses keep: the robot's region, cables that touch each other, and drums that cannot keep them taut."""

from itertools import combinations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from planned import CELL, IDENTITY, RIG, random_rows, two_drums
from scipy.spatial.transform import Rotation

from lmeasure.calibration import Limits, PlanSettings, Region, Usable, plan_poses
from lmeasure.core import CalibrationError
from lmeasure.kernels import least_clearances, wrap_geometry
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.sensors import span_lengths


def test_limits_that_nothing_keeps_name_what_breaks_them() -> None:
    with pytest.raises(CalibrationError, match=r"a cable too short or too long at 100% of the poses tried"):
        plan_poses(RIG, PlanSettings(4, CELL, limits=Limits(max_length_mm=500.0)))


def test_a_point_is_no_room_for_many_poses() -> None:
    region = Region(np.zeros(3), np.array([100.0, 0.0, 0.0]), 0.0, IDENTITY)
    with pytest.raises(CalibrationError, match="has room for"):
        plan_poses(two_drums(), PlanSettings(20, region))


@given(seed=st.integers(0, 1000))
def test_region_coordinates_run_both_ways(seed: int) -> None:
    rng = np.random.default_rng(seed)
    region = Region(rng.uniform(-500, 0, 3), rng.uniform(1, 500, 3), rng.uniform(0.01, 1.0), Rotation.random(rng=rng).as_quat())
    unit = rng.uniform(0.0, 1.0, (5, 6))
    np.testing.assert_allclose(region.unit(region.rows(unit)), unit, atol=1e-9)


def test_clearances_against_points_strewn_along_the_spans() -> None:
    rows = random_rows(12, 6)
    kernel_rows = RIG.cable_rows()
    centre, tangent, attachment, _ = wrap_geometry(kernel_rows, rows)
    pairs = np.array([(i, j) for i, j in combinations(range(6), 2) if RIG.cable[i].to_point != RIG.cable[j].to_point])
    strangers = np.array([(0, 1), (3, 5)])
    found = least_clearances(centre, tangent, attachment, kernel_rows[:, 6].copy(), pairs, strangers)
    s = np.linspace(0.0, 1.0, 300)[None, :, None]
    strewn = tangent[:, :, None, :] + s * (attachment - tangent)[:, :, None, :]
    least = np.full(len(rows), np.inf)
    for i, j in pairs:
        gap = np.linalg.norm(strewn[:, i, :, None, :] - strewn[:, j, None, :, :], axis=-1).min(axis=(1, 2))
        least = np.minimum(least, gap)
    for i, j in strangers:
        least = np.minimum(least, np.linalg.norm(strewn[:, i] - centre[:, j, None], axis=-1).min(axis=1) - kernel_rows[j, 6])
    # points lie 7 mm apart along a span of two metres, so their pairs miss the common normal by up to 3.5 mm on each span
    assert (found <= least + 1e-9).all()
    assert (least - found).max() < 8.0
    assert np.median(least - found) < 0.5


def test_each_limit_is_broken_by_its_own_pose() -> None:
    rig = two_drums()
    free = Usable(rig, rig.cable, Limits(), CELL.centre)
    base, u = rig.cable_rows()[0, :3], rig.cable_rows()[0, 3:6]
    arm = np.array(rig.tool[rig.cable[0].to_point])
    side = np.cross(u, [0.0, 0.0, 1.0]) / np.linalg.norm(np.cross(u, [0.0, 0.0, 1.0]))

    def pose(attachment: np.ndarray) -> np.ndarray:
        return np.concatenate([attachment - arm, IDENTITY])

    radius = rig.observation_point[0].pulley_radius_mm
    at = np.array(
        [
            pose(base + 60.0 * side),  # too near to the pulley
            pose(base + 800.0 * u + radius * side),  # ahead along the swivel axis
            pose(base - 800.0 * u + 20.0 * radius * side * 0.14),  # back along the incoming cable
            pose(base + 800.0 * side),
        ]
    )
    broken = free.broken(at)
    assert broken[[0, 1, 2], [0, 1, 2]].all()
    assert not broken[3].any()


def springs(**drum: float) -> Rig:
    """Two drums whose cables hang on springs: tension keys of their drums."""
    data = two_drums().to_dict()
    for p in data["observation_point"]:
        p["drum"] |= drum
    return rig_from_dict(data)


def test_a_cable_that_the_drum_takes_in_too_far_is_slack() -> None:
    """5 N where the counters begin, 10 N more for each metre paid out: 300 mm taken in leave 2 N, 600 mm none."""
    rig = springs(cable_tension_n=5.0, cable_tension_n_per_m=10.0, cable_stiffness_n=1e4)
    start = CELL.centre
    reach = span_lengths(rig, start[None])[0]
    towards = np.array(rig.observation_point[0].position_mm) / np.linalg.norm(rig.observation_point[0].position_mm)
    rows = np.array([np.concatenate([d * towards, IDENTITY]) for d in (0.0, 300.0, 600.0)])
    taken_in = reach[0] - span_lengths(rig, rows)[:, 0]
    tension = 5.0 - taken_in / 100.0
    assert tension[1] > 1.0 > 0.0 > tension[2]
    column = Usable.REASONS.index("a slack cable")
    assert Usable(rig, rig.cable, Limits(), start).broken(rows)[:, column].tolist() == [False, False, True]
    least = float(tension[1]) + 0.1
    assert Usable(rig, rig.cable, Limits(min_tension_n=least), start).broken(rows)[:, column].tolist() == [False, True, True]
    assert not Usable(two_drums(), rig.cable, Limits(), start).broken(rows)[:, column].any()


def test_a_cable_that_cannot_carry_itself_is_slack() -> None:
    """1.2 m of 100 g/m weigh 1.2 N: 0.5 N do not hold them up, 50 N do."""
    column = Usable.REASONS.index("a slack cable")
    for tension, slack in ((0.5, True), (50.0, False)):
        rig = springs(cable_tension_n=tension, cable_mass_kg_per_m=0.1)
        assert bool(Usable(rig, rig.cable, Limits(), CELL.centre).broken(random_rows(3, 1))[:, column].all()) is slack


def test_a_plan_keeps_every_cable_taut() -> None:
    rig = springs(cable_tension_n=4.0, cable_tension_n_per_m=8.0, cable_stiffness_n=1e4)
    plan = plan_poses(rig, PlanSettings(6, CELL, criterion="I", limits=Limits(min_tension_n=2.0)))
    change = span_lengths(rig, plan.poses.rows) - span_lengths(rig, CELL.centre[None])
    assert (4.0 + 8.0 * change / 1000.0 >= 2.0 - 1e-9).all()
    assert dict(plan.broken)["a slack cable"] > 0.05
