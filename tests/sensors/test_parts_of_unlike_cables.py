"""What parts add, of cables that are like no other: derivatives against differences of the law, numbers by hand where it is short."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from scipy.optimize import brentq

from lmeasure.core import FloatArray, se3
from lmeasure.kernels import layout
from lmeasure.rig import kernel_values, with_kernel_values, with_values
from lmeasure.sensors import PLAY, Parts, every_part, parts_of, phased
from lmeasure.sensors.imperfect_parts import PART_OVERSIZE
from lmeasure.simulation import Leg, cell_rig, reference_poses, simulate_run, smooth_path
from lmeasure.trajectory import reconstruct

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
SCALES = np.array([0.9, 1.2, 1.4])
PULLEYS = np.array([20.0, 0.0, 0.7])
"""A usual one, none, and one that is smaller than a millimetre."""
PHASES = {"lengths": np.array([900.0, 1100.0, 1300.0]), "the zero poses": np.full(3, np.nan), "either": np.array([np.nan, 1100.0, 1300.0])}
#                  run-out       eccentricity   offset oversize play
VALUES = np.array(
    [[0.05, 0.03, 0.08, -0.05, 0.3, 0.06, 1.5], [-0.04, 0.02, 0.5, 0.7, 0.9, 0.05, 2.0], [0.03, 0.06, -0.04, 0.02, 0.05, 0.04, 3.0]]
)


class Place(NamedTuple):
    """Where m cables are: the kernels' parameters (m, 13), poses (n, 7), poses (m, 7) and recorded counts (m,) where each was zeroed,
    recorded counts (n, m)."""

    kernel: FloatArray
    poses: FloatArray
    zero: FloatArray
    zeroed: FloatArray
    recorded: FloatArray
    scales: FloatArray = SCALES


def rows_of(kernel: FloatArray) -> FloatArray:
    rows = cell_rig(1).cable_rows()[:3].copy()
    rows[:, layout.TURN_COUNTS] = [6000.0, 5000.0, 7000.0]
    rows[:, layout.COUNT_LENGTH] = [0.012, 0.015, 0.011]
    return rows if not len(kernel) else with_kernel_values(rows, kernel)


def place() -> Place:
    kernel = kernel_values(rows_of(np.zeros((0, 13))))
    kernel[:, layout.BY_RADIUS] = PULLEYS
    kernel[:, layout.BY_PITCH] = [3.0, -5.0, 40.0]
    kernel[:, layout.BY_TANGENT], kernel[:, layout.BY_AXIAL] = [150.0, 180.0, 140.0], [12.0, -9.0, 20.0]
    rng, poses = np.random.default_rng(2), reference_poses()
    return Place(
        kernel, poses[[3, 7, 11, 12]], poses[[0, 1, 2]], np.array([300.0, -800.0, 500.0]), rng.uniform(-20_000.0, 20_000.0, (4, 3))
    )


def excess(at: Place, parts: Parts, travel: FloatArray | float = 0.0) -> FloatArray:
    counts = at.recorded / at.scales
    own = replace(parts, scales=at.scales)
    there, begun = own.added(rows_of(at.kernel), (at.zero, at.zeroed / at.scales), at.poses, counts, travel=np.zeros(counts.shape) + travel)
    return there.mm - begun.mm


def by_parameters(at: Place, parts: Parts, travel: FloatArray | float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    counts = at.recorded / at.scales
    return parts.by_parameters(
        rows_of(at.kernel), (at.zero, at.zeroed / at.scales), at.poses, counts, travel=np.zeros(counts.shape) + travel
    )


def difference(less: FloatArray, more: FloatArray, step: float) -> FloatArray:
    return np.asarray((more - less) / (2.0 * step))


@pytest.mark.parametrize("stated", PHASES)
def test_derivatives_by_the_cables_parameters(stated: str) -> None:
    at, parts = place(), Parts(VALUES, PHASES[stated], SCALES)
    found = by_parameters(at, parts)[1]
    for i, name in enumerate(layout.PARAMETERS):
        h = 3e-6 if i == layout.BY_RADIUS else 1e-3 if name.endswith("_mm") else 1e-5
        for j in range(3):
            one = h * (np.arange(3) == j)
            if i == layout.BY_SCALE:
                less, more = (excess(at._replace(scales=SCALES + sign * one), parts) for sign in (-1, 1))
            elif i == layout.BY_RADIUS and PULLEYS[j] == 0.0:
                continue  # there is no pulley
            else:
                less, more = (excess(at._replace(kernel=at.kernel + sign * one[:, None] * (np.arange(13) == i)), parts) for sign in (-1, 1))
            expected = difference(less, more, h)
            # left out: squares of what is not as drawn
            np.testing.assert_allclose(
                found[:, j, i], expected[:, j], rtol=2e-4, atol=3e-7 * max(1.0, np.abs(found[:, j]).max()), err_msg=name
            )


@pytest.mark.parametrize("stated", PHASES)
def test_derivatives_by_motions_of_the_poses(stated: str) -> None:
    at, parts = place(), Parts(VALUES, PHASES[stated], SCALES)
    of_pose, of_zero = by_parameters(at, parts)[2]
    for i in range(6):
        h = 1e-5 if i < 3 else 1e-3
        motion = h * (np.arange(6) == i)
        moved = [[se3.displaced(poses, sign * motion) for sign in (-1, 1)] for poses in (at.poses, at.zero)]
        less, more = (excess(at._replace(poses=p), parts) for p in moved[0])
        by_pose = difference(less, more, h)
        less, more = (excess(at._replace(zero=p), parts) for p in moved[1])
        by_zero = difference(less, more, h)
        np.testing.assert_allclose(of_pose[:, :, i], by_pose, rtol=2e-4, atol=1e-6 * np.abs(of_pose).max())
        np.testing.assert_allclose(of_zero[:, :, i], by_zero, rtol=2e-4, atol=1e-6 * np.abs(of_zero).max())


@pytest.mark.parametrize("values", [VALUES, 0.0 * VALUES], ids=["untrue", "as drawn"])
def test_derivatives_by_the_values_themselves(values: FloatArray) -> None:
    """With play, signs of travel at each sample; where counting began the sign is not known and counts for nothing."""
    at, parts = place(), Parts(values, PHASES["either"], SCALES)
    travel = np.array([[1.0, -1.0, 1.0], [-1.0, 1.0, 0.0], [1.0, 1.0, -1.0], [0.0, -1.0, 1.0]])
    rows, zero, counts = rows_of(at.kernel), (at.zero, at.zeroed / SCALES), at.recorded / SCALES
    found = by_parameters(at, parts, travel)[0]
    for i in range(7):
        h = 1e-4
        less, more = (excess(at, replace(parts, values=values + sign * h * (np.arange(7) == i)), travel) for sign in (-1, 1))
        np.testing.assert_allclose(found[:, :, i], difference(less, more, h), rtol=1e-6, atol=1e-7)
    np.testing.assert_array_equal(found[:, 1, 2:5], 0.0)
    np.testing.assert_array_equal(parts.gradient(rows, zero, at.poses, counts, travel=travel), found)
    still = parts.gradient(rows, zero, at.poses, counts)
    np.testing.assert_array_equal(still[:, :, :PLAY], found[:, :, :PLAY])
    np.testing.assert_array_equal(still[:, :, PLAY], 0.0)
    alone = parts.gradient(rows, zero, at.poses, counts, since=False)
    there, begun = parts.added(rows, zero, at.poses, counts, travel=np.zeros(counts.shape))
    np.testing.assert_array_equal(alone, there.by_values)
    np.testing.assert_allclose(still, alone - begun.by_values, atol=1e-15)


def test_a_point_without_a_pulley_has_only_its_drum() -> None:
    """Run-out, play and a thicker cable's turns, by hand; nothing of a pulley, also where there is no pulley at all."""
    at, parts = place(), Parts(VALUES, PHASES["lengths"], SCALES)
    a, b, _, _, _, over, play = VALUES[1]
    rows, counts = rows_of(at.kernel), at.recorded / SCALES
    k, k0, turn = counts[:, 1], at.zeroed[1] / SCALES[1], 5000.0
    straight = np.linalg.norm(se3.apply(at.zero[1], rows[1, layout.ATTACHMENT_XYZ]) - rows[1, layout.BASE_XYZ])

    # the drum stands at phase 0 where 1100 mm are out, by its law of the cable paid out
    def since_phase(at: float) -> float:
        paid = [0.015 * count - np.hypot(180.0, -9.0 - 5.0 * count / turn) for count in (k0, at)]
        return float(paid[0] - paid[1] - straight + 1100.0)

    at_phase = brentq(since_phase, k0 - 1e6, k0 + 1e6, xtol=1e-9)
    begun = 2.0 * np.pi * (k0 - at_phase) / turn
    angle = begun + 2.0 * np.pi * (k - k0) / turn
    r = np.sqrt((0.015 * turn) ** 2 - 5.0**2) / (2.0 * np.pi)
    longer = np.hypot(2.0 * np.pi * (r + 0.5 * over), 5.0) - 0.015 * turn
    # D'(k) where the drum's pay-out point has gone along
    axial = -9.0 - 5.0 * k / turn
    slope = 0.015 + 5.0 / turn * axial / np.hypot(180.0, axial)
    expected = -a * np.cos(angle) - b * np.sin(angle) - k * longer / turn - play / SCALES[1] * slope
    expected += a * np.cos(begun) + b * np.sin(begun) + k0 * longer / turn
    np.testing.assert_allclose(excess(at, parts, 1.0)[:, 1], expected, rtol=0, atol=1e-9)
    none = at._replace(kernel=at.kernel * (np.arange(13) != layout.BY_RADIUS))
    np.testing.assert_allclose(excess(none, parts, 1.0)[:, 1], expected, rtol=0, atol=1e-9)
    for pulleys in (False, True):
        own = replace(parts, pulleys=pulleys)
        np.testing.assert_array_equal(excess(at, own), excess(at, parts))
        np.testing.assert_array_equal(by_parameters(none, own)[0][:, :, 2:5], 0.0)
        np.testing.assert_array_equal(by_parameters(at, replace(own, values=0.0 * VALUES))[0][:, :, 2:5].any(), pulleys)


@pytest.mark.parametrize("lost", [[2], [0, 1, 2, 3]])
def test_of_what_nobody_knows_where_it_is_nothing_is_said(lost: list[int]) -> None:
    at, parts = place(), Parts(VALUES, PHASES["either"], SCALES)
    rows, zero, counts, poses = rows_of(at.kernel), (at.zero, at.zeroed / SCALES), at.recorded / SCALES, at.poses.copy()
    travel = np.ones(counts.shape)
    poses[lost] = np.nan
    known = np.setdiff1d(np.arange(4), lost)
    for of in (parts.excess, lambda *given: parts.gradient(*given, travel=travel), lambda *given: parts.gradient(*given, since=False)):
        found, whole = of(rows, zero, poses, counts), of(rows, zero, at.poses, counts)
        assert np.isnan(found[lost]).all()
        np.testing.assert_array_equal(found[known], whole[known])
        assert found.shape == whole.shape
    np.testing.assert_array_equal(parts.excess(rows, zero, at.poses, counts), excess(at, parts))


def test_parts_are_read_for_the_cables_that_are_asked_for() -> None:
    rig = with_values(cell_rig(1), {"B2.run_out_sin_mm": 0.03, "B3.backlash_counts": 2.0, "B3.cable_oversize_mm": 0.0, "B5.scale": 1.5})
    assert parts_of(with_values(cell_rig(1), {"B3.backlash_counts": 2.0})) is None
    found = parts_of(rig)
    assert found is not None
    assert np.argwhere(found.values).tolist() == [[1, 1], [2, PLAY]]
    assert found.values[[1, 2], [1, PLAY]].tolist() == [0.03, 2.0]
    assert found.scales.tolist() == [p.drum.scale for p in rig.observation_point]
    assert np.isnan(found.phase_mm).all()
    assert parts_of(rig, rig.cable[2:]) is None
    two = (rig.cable[4], rig.cable[1])
    some = parts_of(phased(rig, ("B2.run_out_sin_mm",), reference_poses()[:2], two), two)
    assert some is not None
    assert some.values[:, 1].tolist() == [0.0, 0.03]
    assert some.scales[0] == 1.5
    assert np.isfinite(some.phase_mm).tolist() == [False, True]
    np.testing.assert_array_equal(every_part(rig, two).values[:, PART_OVERSIZE], 0.0)


def test_samples_without_a_pose_do_not_stop_a_run_of_untrue_parts() -> None:
    """A gap in one of six channels is a gap in the poses, and in nothing else."""
    rig = with_values(cell_rig(4), {"B2.run_out_sin_mm": 0.03, "B3.pulley_eccentricity_cos_mm": 0.05})
    time_s, poses = smooth_path(HOME, [Leg(HOME + np.r_[30.0, -20.0, 25.0, 0.0, 0.0, 0.0, 0.0], 300.0, 10.0)], 100.0)
    run = simulate_run(rig, time_s, poses, noise_mm=0.0, rng=np.random.default_rng(0)).run
    recorded = run.passes[0].recorded.copy()
    recorded[10:13, 2] = np.nan
    found = reconstruct(replace(run, passes=(replace(run.passes[0], recorded=recorded),)))
    assert np.flatnonzero(np.isnan(found.poses).any(axis=1)).tolist() == [10, 11, 12]
    whole = reconstruct(run)
    known = np.isfinite(found.poses[:, 0])
    np.testing.assert_allclose(found.poses[known], whole.poses[known], rtol=0, atol=1e-6)
