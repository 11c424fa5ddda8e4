"""Every fast way to poses and their covariances gives what the reference gives, over random cells."""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.optimize
from hypothesis import assume, given, settings, strategies as st
from reference.cable import CableLength
from reference.channel import Observation, differences, predictions, values, variances
from reference.continuation import follow
from reference.solver import Solved, pressure_angles, shared_errors, twists
from rigs import COUNT_MM, HOME, FloatArray, cables, inclination, path, poses, rows_of, swivel
from scipy.spatial.transform import Rotation
from screw_poses import track

from lmeasure.core import Status, se3
from lmeasure.kernels import (
    ALPHA,
    ANGLE_ZERO,
    ATTACHMENT,
    BASE,
    BETA,
    CABLE_COLUMNS,
    CHANGES,
    INCLINATION,
    KIND,
    SWIVEL,
    TRAVEL,
    counter,
    damped_search,
    lanes,
    least_squares,
    length_gradients,
    live,
    screw,
    span_lengths,
)
from lmeasure.rig import FACTORS
from lmeasure.sensors import guide
from lmeasure.trajectory.reconstruction import screw_method
from lmeasure.trajectory.uncertainty import budget

SAME_MM, SAME_RAD = 1e-9, 1e-12
ALL = np.arange(6)


def a_run(seed: int, m: int, n: int, radius: float | None, missing: float = 0.0) -> tuple[list[CableLength], FloatArray, FloatArray]:
    """Cables, their kernels' rows, and changes of length by whole counts, some of them missing."""
    channels, g = cables(seed, m, radius), np.random.default_rng(seed)
    changes = predictions(channels, path(n, reach_mm=g.uniform(20.0, 150.0), turn_rad=g.uniform(0.0, 0.15)))
    changes = COUNT_MM * np.round(changes / COUNT_MM)
    changes[g.random(changes.shape) < missing] = np.nan
    return channels, rows_of(channels), changes


def assert_same(found: Sequence[Any], reference: Solved) -> None:
    """poses, residual, iterations, status, angle of a fast way."""
    np.testing.assert_array_equal(found[3], reference.status)
    ok = reference.status == Status.OK
    assert ok.mean() > 0.5
    assert np.isnan(found[0][~ok]).all()
    apart = np.abs(se3.displacement(found[0][ok], reference.poses[ok]))
    assert apart[:, 3:].max() < SAME_MM
    assert apart[:, :3].max() < SAME_RAD
    np.testing.assert_allclose(found[4][ok], reference.angle[ok], rtol=0, atol=1e-9)


@settings(max_examples=8, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.sampled_from([None, 0.0]), st.sampled_from([0.0, 0.02]))
def test_six_cables(seed: int, radius: float | None, gaps: float) -> None:
    """Sample by sample, in lanes, in NumPy and live."""
    channels, rows, changes = a_run(seed, 6, 256, radius, gaps)
    reference = follow(channels, changes, HOME)
    flags, u = np.where(np.isnan(changes).any(axis=1), Status.GAP, Status.OK).astype(np.int64), np.full(6, COUNT_MM / np.sqrt(12.0))
    # near singular poses the fast ways refuse earlier, by what errors of the lengths could do: they have tests of their own
    assume(not (reference.angle > np.radians(70.0)).any())
    assert_same(track(rows, HOME, changes, flags, u), reference)
    assert_same(lanes.follow_lanes(rows, HOME, screw.new_state(HOME), changes, flags, u), reference)
    few = screw_method.follow_together(rows, HOME, screw.new_state(HOME), changes, flags=flags)
    assert few is not None
    assert_same(few, reference)
    np.testing.assert_allclose(_live(rows, changes[:20], u), reference.poses[:20], rtol=0, atol=SAME_MM)


def _live(rows: FloatArray, changes: FloatArray, u: FloatArray) -> FloatArray:
    """(n, 7) poses of the counts of these changes, one after the other."""
    state, counters, out = screw.new_state(HOME), np.zeros((6, counter.STATE)), np.full((len(changes), 7), np.nan)
    plain = rows.copy()
    plain[:, TRAVEL] = 0.0  # a drum whose counts are so many mm
    channels = np.tile([1.0, 1e9, 0.0, COUNT_MM], (6, 1))
    for i, change in enumerate(changes):
        live.step(plain, HOME, state, counters, channels, i * 1e-3, change / COUNT_MM, u, out[i])
    return out


@settings(max_examples=8, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.sampled_from([6, 7, 8]), st.sampled_from([None, 0.0]), st.sampled_from([0.0, 0.03]))
def test_any_number_of_cables(seed: int, m: int, radius: float | None, missing: float) -> None:
    channels, rows, changes = a_run(seed, m, 200, radius, missing)
    reference = follow(channels, changes, HOME)
    flags = np.full(200, int(Status.GAP))
    found = least_squares.follow_least_squares(
        rows, HOME, span_lengths(rows, HOME[None])[0], least_squares.new_state(HOME, m), changes, flags,
        np.full(m, COUNT_MM / np.sqrt(12.0)), ALL,
    )  # fmt: skip
    assume(not (reference.angle > np.radians(80.0)).any())
    assert_same(found, reference)
    np.testing.assert_allclose(found[5], reference.chi2, rtol=1e-6, atol=1e-6)
    used = np.isfinite(changes)
    G = least_squares.twists(rows, reference.poses, used.astype(np.float64), ALL)
    np.testing.assert_allclose(G, twists(channels, reference.poses, used), rtol=1e-7, atol=1e-12)
    own = G * COUNT_MM / np.sqrt(12.0)
    np.testing.assert_allclose(own @ np.swapaxes(own, 1, 2), reference.covariance, rtol=1e-7, atol=1e-18)


def row_of(o: Observation) -> FloatArray:
    """Of a swivel or an inclination for the kernels."""
    row, p = np.zeros(CABLE_COLUMNS), values(o)
    if len(p) == 9:
        row[KIND], row[BASE : BASE + 3], row[ATTACHMENT : ATTACHMENT + 3] = SWIVEL, p[:3], p[5:8]
        row[ALPHA], row[BETA] = np.radians(p[3:5])
    else:
        row[KIND], row[ATTACHMENT : ATTACHMENT + 3], row[BASE : BASE + 3] = INCLINATION, p[:3], p[3:6]
    row[ANGLE_ZERO] = np.radians(p[-1])
    return row


def mixed() -> tuple[list[Observation], FloatArray]:
    """Five cables, two swivels and two inclinations, and their kernels' rows."""
    g, some = np.random.default_rng(3), cables(3)
    others: list[Observation] = [swivel(some[0], 5.0), swivel(some[3], -70.0), inclination(g, "i1"), inclination(g, "i2")]
    return [*some[:5], *others], np.concatenate([rows_of(some[:5]), [row_of(o) for o in others]])


def test_few_samples_of_channels_of_every_kind() -> None:
    """So few that the kernel is seen through without being compiled: followed, sought from beside, and their twists."""
    channels, rows = mixed()
    truth, u = path(400)[::40], np.sqrt(variances(channels))
    readings = predictions(channels, truth) + np.random.default_rng(0).normal(size=(10, 9)) * u
    readings[3, [2, 4]], readings[5, :4] = np.nan, np.nan
    readings[7, 5] += 4.0 * np.pi
    zero = np.where(rows[:, KIND] == 0, span_lengths(rows, HOME[None])[0], 0.0)
    state, flags = least_squares.new_state(HOME, 9), np.full(10, int(Status.GAP))
    state[CHANGES : CHANGES + 9] = predictions(channels, HOME[None])[0]
    found = least_squares.follow_least_squares(rows, HOME, zero, state, readings, flags, u, ALL)
    reference = follow(channels, readings, HOME)
    assert_same(found, reference)
    assert found[3].tolist() == [Status.OK] * 5 + [Status.GAP] + [Status.OK] * 4
    ok = found[3] == Status.OK
    np.testing.assert_allclose(found[5][ok], reference.chi2[ok], rtol=1e-6)
    assert (found[2][ok] > 0).all()
    left = differences(channels, readings[ok], predictions(channels, reference.poses[ok]))
    np.testing.assert_allclose(found[1][ok], np.nanmax(np.abs(left[:, :5]), axis=1), rtol=1e-6)
    np.testing.assert_allclose(state[:7], reference.poses[-1], atol=1e-9)
    np.testing.assert_allclose(state[CHANGES:], [*readings[-1], 0.0], atol=1e-12)
    used = np.isfinite(readings)
    G = least_squares.twists(rows, reference.poses, used / u, ALL)
    np.testing.assert_allclose(G, twists(channels, reference.poses, used), rtol=1e-7, atol=1e-10)
    beside = se3.displaced(truth[[1]], [[0.05, -0.04, 0.03, 30.0, -20.0, 10.0], [-0.02, 0.03, 0.05, -10.0, 25.0, 30.0]])
    sought, chi = damped_search(rows, readings[1] + zero, u, ALL, beside)
    np.testing.assert_allclose(se3.displacement(sought, reference.poses[[1, 1]]), 0.0, atol=1e-6)
    np.testing.assert_allclose(chi, reference.chi2[1], rtol=1e-6)


@pytest.mark.parametrize("unit", [1e-4, 1e4])
def test_few_samples_are_found_whatever_their_uncertainties_are_of(unit: float) -> None:
    rows, u = rows_of(cables(3)), np.full(6, 0.01)
    truth = path(10)[3]
    targets = span_lengths(rows, truth[None])[0] + np.array([3.0, -2.0, 1.0, 0.0, -1.0, 2.0])
    starts = se3.displaced(np.tile(truth, (2, 1)), [[0.05, -0.04, 0.03, 30.0, -20.0, 10.0], [0.0, 0.1, 0.0, 0.0, 0.0, -40.0]])
    poses, chi = damped_search(rows, targets, u, ALL, starts)
    assert np.isfinite(chi).all()
    scaled, square = damped_search(rows, targets, unit * u, ALL, starts)
    np.testing.assert_allclose(se3.displacement(scaled, poses), 0.0, atol=1e-6)
    assert np.isfinite(square).all()


def test_few_samples_sought_from_far_off_end_at_a_minimum() -> None:
    """From where whole steps lead nowhere, by half a metre and a radian: no step of another method leads down from what is stated as
    found, and the misfit is told by it; most are found at all."""
    rows, u = rows_of(cables(3)), np.full(6, 0.01)
    truth = path(10)[3]
    targets = span_lengths(rows, truth[None])[0]
    off = np.random.default_rng(11).uniform(-1.0, 1.0, (16, 6)) * [1.0, 1.0, 1.0, 700.0, 700.0, 700.0]
    poses, chi = damped_search(rows, targets, u, ALL, se3.displaced(np.tile(truth, (16, 1)), off))
    found = np.isfinite(chi)
    assert 10 <= found.sum() < 16
    for pose, square in zip(poses[found], chi[found], strict=True):

        def misfit(x: FloatArray, at: FloatArray = pose) -> FloatArray:
            return np.asarray((targets - span_lengths(rows, se3.displaced(at[None], x[None]))[0]) / u)

        assert square == pytest.approx(float(np.sum(misfit(np.zeros(6)) ** 2)), rel=1e-9, abs=1e-12)
        lower = scipy.optimize.least_squares(misfit, np.zeros(6), method="lm", x_scale=[1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0])
        assert square <= 2.0 * lower.cost * (1.0 + 1e-9) + 1e-9
    assert (chi[found] < 1e-9).sum() >= 7


def test_few_samples_until_the_tool_is_lost() -> None:
    """It turns far about the vertical: six cables lose it at a singular pose."""
    six, turn = cables(3), np.r_[0.0, 0.7, 1.4, 1.9, 2.2, np.linspace(2.3, 2.4, 17)]
    truth = se3.displaced(HOME, np.column_stack([np.zeros((22, 2)), turn, np.zeros((22, 3))]))
    rows, u = rows_of(six), np.full(6, COUNT_MM / np.sqrt(12.0))
    zero = span_lengths(rows, HOME[None])[0]
    state, flags = least_squares.new_state(HOME, 6), np.zeros(22, np.int64)
    found = least_squares.follow_least_squares(rows, HOME, zero, state, predictions(six, truth), flags, u, ALL)
    ok = found[3] == Status.OK
    lost = int(np.argmin(ok))
    assert 5 < lost < 20
    # before the first that six lengths cannot tell from a singular pose
    assert found[3][lost:].tolist() == [Status.OTHER_ASSEMBLY] * (22 - lost)
    np.testing.assert_allclose(se3.displacement(found[0][:lost], truth[:lost]), 0.0, atol=1e-6)
    angles = pressure_angles(six, truth[:lost], twists(six, truth[:lost])).max(axis=1)
    np.testing.assert_allclose(found[4][:lost], angles, rtol=1e-6)
    assert np.radians(80.0) < angles[-1] < np.radians(88.0)
    assert np.isnan(found[4][lost:]).all()
    # by how many cables it was lost, and where it was last
    assert state[-1] == 6.0
    np.testing.assert_allclose(se3.displacement(state[None, :7], truth[[lost - 1]]), 0.0, atol=1e-6)


@pytest.mark.parametrize("twice", [False, True])
def test_few_samples_at_rest_are_found_at_once_but_not_where_one_cable_is_there_twice(twice: bool) -> None:
    rows, u = rows_of(cables(3)), np.full(6, COUNT_MM / np.sqrt(12.0))
    if twice:
        rows[3] = rows[2]
    zero, state = span_lengths(rows, HOME[None])[0], least_squares.new_state(HOME, 6)
    found = least_squares.follow_least_squares(rows, HOME, zero, state, np.zeros((3, 6)), np.zeros(3, np.int64), u, ALL)
    assert found[3].tolist() == [Status.SINGULAR if twice else Status.OK] * 3
    assert found[2].tolist() == [1] * 3


@pytest.mark.parametrize(("by_mm", "steps"), [(1e-12, 1), (1e-10, 2)])
def test_few_samples_end_with_the_first_step_that_no_length_could_show(by_mm: float, steps: int) -> None:
    rows, u = rows_of(cables(3)), np.full(6, COUNT_MM / np.sqrt(12.0))
    zero, state = span_lengths(rows, HOME[None])[0], least_squares.new_state(HOME, 6)
    found = least_squares.follow_least_squares(rows, HOME, zero, state, np.full((1, 6), by_mm), np.zeros(1, np.int64), u, ALL)
    assert found[3].tolist() == [Status.OK]
    assert found[2].tolist() == [steps]


def test_few_samples_of_a_rig_of_kilometres_end_where_rounding_ends_them() -> None:
    """There it moves poses by more than a step that is none."""
    rows, start = rows_of(cables(3, radius=0.0)), HOME.copy()
    start[:3] *= 3000.0
    for place in (ATTACHMENT, BASE):
        rows[:, place : place + 3] *= 3000.0
    zero, state = span_lengths(rows, start[None])[0], least_squares.new_state(start, 6)
    changes = np.random.default_rng(3).uniform(-10.0, 10.0, (20, 6))
    found = least_squares.follow_least_squares(rows, start, zero, state, changes, np.zeros(20, np.int64), np.full(6, 1.0), ALL)
    assert found[3].tolist() == [Status.OK] * 20
    assert found[2].max() < 10
    np.testing.assert_allclose(span_lengths(rows, found[0]) - zero, changes, atol=1e-7)


def test_few_samples_are_not_sought_where_no_cable_can_run_nor_where_the_pose_is_undetermined() -> None:
    rows, u = rows_of(cables(3)), np.full(6, 0.01)
    zero = span_lengths(rows, HOME[None])[0]
    # an attachment point in the middle of a pulley
    into = HOME.copy()
    into[:3] = rows[2, BASE : BASE + 3] - rows[2, ATTACHMENT : ATTACHMENT + 3]
    poses, chi = damped_search(rows, zero, u, ALL, into[None])
    np.testing.assert_array_equal(poses, into[None])
    assert chi.tolist() == [np.inf]
    # cables that all end in one point see no rotation
    rows[:, ATTACHMENT : ATTACHMENT + 3] = 0.0
    assert damped_search(rows, zero, u, ALL, HOME[None])[1].tolist() == [np.inf]


@pytest.mark.parametrize("beside_mm", [1.0, 3.0])
@pytest.mark.parametrize("towards", [(0.19, -0.2, 0.96), (0.34, -0.94, -0.74)])
def test_few_samples_pass_close_by_a_pulley_that_turns_by_half_a_turn(beside_mm: float, towards: tuple[float, ...]) -> None:
    """In a gap: between two samples the tool goes straight by 240 mm, which turns the pulley at once. Lengths alone tell the way."""
    six, way = cables(3), np.array(towards) / np.linalg.norm(towards)
    u0, attachment = six[0], rows_of(cables(3))[0, ATTACHMENT : ATTACHMENT + 3]
    up = guide(*(np.radians(p.value) for p in u0.parameters[3:5]))[0]
    aside = np.cross(way, up) / np.linalg.norm(np.cross(way, up))
    s = swivel(u0, 5.0)
    base = HOME[:3] + attachment - 200.0 * up + beside_mm * aside
    s = replace(s, parameters=(*(replace(p, value=float(v)) for p, v in zip(s.parameters, base, strict=False)), *s.parameters[3:]))
    channels: list[Observation] = [*six, s]
    rows = np.concatenate([rows_of(six), row_of(s)[None]])
    truth = se3.displaced(HOME, np.array([[0, 0, 0, *(-120.0 * way)], [0, 0, 0, *(120.0 * way)]]))
    readings, u = predictions(channels, truth), np.sqrt(variances(channels))
    assert 170.0 < abs(np.degrees(readings[1, 6] - readings[0, 6])) < 190.0
    zero, state = np.append(span_lengths(rows[:6], HOME[None])[0], 0.0), least_squares.new_state(truth[0], 7)
    state[CHANGES : CHANGES + 7] = readings[0]
    found = least_squares.follow_least_squares(rows, HOME, zero, state, readings[1:], np.zeros(1, np.int64), u, ALL)
    assert found[3].tolist() == [Status.OK]
    np.testing.assert_allclose(se3.displacement(found[0], truth[1:]), 0.0, atol=1e-9)


def test_few_samples_have_twists_of_what_is_free_alone() -> None:
    """Whatever stood where they are put."""
    rows, free = rows_of(cables(3)), np.array([2, 3, 4])
    G, r = np.full((6, 6), 7.0), np.empty(6)
    assert least_squares.length_twists(rows, HOME, np.ones(6), free, 100.0, np.zeros(6), G, r)
    assert not G[[0, 1, 5]].any()
    assert np.abs(G[free]).min() > 0.0


def test_constrained_motions() -> None:
    """A planar stage on four cables."""
    channels, free = cables(1, 4), np.array([2, 3, 4])
    t = np.linspace(0.0, 1.0, 200)
    truth = se3.pose(np.column_stack([80.0 * np.sin(3.0 * t), 50.0 * t, 0.0 * t]), Rotation.from_rotvec(np.outer(0.2 * t, [0.0, 0.0, 1.0])))
    changes = COUNT_MM * np.round(predictions(channels, truth) / COUNT_MM)
    state, u = least_squares.new_state(HOME, 4), np.full(4, COUNT_MM / np.sqrt(12.0))
    found = least_squares.follow_least_squares(
        rows_of(channels), HOME, span_lengths(rows_of(channels), HOME[None])[0], state, changes, np.zeros(200, np.int64), u, free
    )
    assert_same(found, follow(channels, changes, HOME, free))


@pytest.mark.parametrize("seed", range(3))
def test_covariances_of_poses(seed: int) -> None:
    """Of parameters with a full covariance, the zero pose included."""
    g = np.random.default_rng(seed)
    channels, at = cables(seed), poses(seed, 8, reach_mm=120.0, turn_rad=0.1)
    rows = rows_of(channels)
    counts = np.stack([o._drum(values(o)).counts(y) for o, y in zip(channels, predictions(channels, at).T, strict=True)], axis=1)
    names = tuple(q.name for o in channels for q in o.parameters[:13])
    root = g.normal(size=(78, 5)) * np.tile([q.prior_u for q in channels[0].parameters[:13]], 6)[:, None] * 1e-3
    of_kernels = root * np.tile(FACTORS, 6)[:, None]
    since = length_gradients(rows, at, counts, np.ones(6)) - length_gradients(rows, HOME[None], np.zeros((1, 6)), np.ones(6))
    G = twists(channels, at)
    systematic = G @ np.einsum("nmp,mpk->nmk", since, of_kernels.reshape(6, 13, -1))
    for of_poses in (screw.pose_twists, budget.twists_of_six):
        np.testing.assert_allclose(of_poses(rows, at), G, rtol=1e-8, atol=1e-12)
    shared = shared_errors(channels, at, G, names, root=root)
    covariance, expected = (root @ np.swapaxes(root, 1, 2) for root in (shared, systematic))
    u = np.sqrt(np.einsum("nii->ni", expected))
    np.testing.assert_allclose(covariance / u[:, :, None] / u[:, None, :], expected / u[:, :, None] / u[:, None, :], atol=1e-7)
