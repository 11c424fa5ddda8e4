"""The reference solver: poses from any channels, what they err by, and when there is none."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from reference.channel import Observation, predictions, rows, values, variances
from reference.continuation import _near, _side, _until_lost, follow
from reference.solver import ALL, lengths, pressure_angles, shared_errors, solve_poses, twists
from rigs import HOME, FloatArray, cables, distance, inclination, path, poses, swivel

from lmeasure.core import Status, se3

EXACT_MM = 1e-9


def mixed(seed: int) -> list[Observation]:
    """Four cables, two swivels, two axes of an inclinometer and a distance."""
    g, some = np.random.default_rng(seed), cables(seed, 6)
    return [*some[:4], swivel(some[0], 5.0), swivel(some[3], -70.0), inclination(g, "i1"), inclination(g, "i2"), distance(g, "beam")]


def error_of(found: FloatArray, truth: FloatArray) -> FloatArray:
    return np.abs(se3.displacement(found, truth))


@settings(max_examples=20, derandomize=True)
@given(st.integers(0, 2**32 - 1))
def test_exact_readings_give_the_exact_pose(seed: int) -> None:
    channels, truth = mixed(seed), poses(seed, 5, reach_mm=120.0, turn_rad=0.1)
    found = solve_poses(channels, predictions(channels, truth), HOME)
    determined = found.angle < np.radians(80.0)
    assert (found.status[determined] == Status.OK).all()
    assert error_of(found.poses[determined], truth[determined]).max(initial=0.0) < EXACT_MM
    assert (found.chi2[determined] < 1e-9).all()


def test_it_is_the_least_squares() -> None:
    """No small motion from what was found fits better, with noise in all readings and some of them missing."""
    channels, truth = mixed(3), poses(1, 40, reach_mm=120.0, turn_rad=0.1)
    g = np.random.default_rng(0)
    readings = predictions(channels, truth) + g.normal(size=(40, 9)) * np.sqrt(variances(channels))
    readings[:, :2][g.random((40, 2)) < 0.5] = np.nan
    found = solve_poses(channels, readings, HOME)
    assert (found.status == Status.OK).all()

    def chi2(at: FloatArray) -> FloatArray:
        return np.asarray(np.nansum((readings - predictions(channels, at)) ** 2 / variances(channels), axis=1))

    np.testing.assert_allclose(chi2(found.poses), found.chi2, rtol=1e-6)
    for _ in range(20):
        step = 1e-3 * g.normal(size=(40, 6)) * np.repeat([1.0 / 180.0, 1.0], 3)
        assert (chi2(se3.displaced(found.poses, step)) > found.chi2).all()


def test_stated_errors_are_those_met() -> None:
    channels, n = mixed(4), 3000
    truth = np.repeat(poses(2, 1, reach_mm=100.0, turn_rad=0.1), n, axis=0)
    g = np.random.default_rng(1)
    found = solve_poses(channels, predictions(channels, truth) + g.normal(size=(n, 9)) * np.sqrt(variances(channels)), truth)
    scatter = np.cov(se3.displacement(truth, found.poses).T)
    u = np.sqrt(np.diag(found.covariance[0]))
    # a covariance of 3,000 draws is known to sqrt(2/3000) of the standard uncertainties: four times that
    np.testing.assert_allclose(scatter / np.outer(u, u), found.covariance[0] / np.outer(u, u), atol=4.0 * np.sqrt(2.0 / n))
    assert found.chi2.mean() == pytest.approx(3.0, abs=4.0 * np.sqrt(6.0 / n))


def test_shared_parameters_move_the_pose_as_stated() -> None:
    """Against solving again with each parameter moved: one of two channels, and one of the zero pose too."""
    channels, truth = mixed(5), poses(3, 3, reach_mm=100.0, turn_rad=0.1)
    readings = predictions(channels, truth)
    names = ("B0.x_mm", "P1.x_mm", "B3.guide_beta_deg", "i1.zero_deg")
    found = shared_errors(channels, truth, twists(channels, truth), names, root=np.eye(4))
    for k, name in enumerate(names):
        h = 1e-3
        ends = [solve_poses([_moved(o, name, s * h) for o in channels], readings, truth).poses for s in (1, -1)]
        # where the true parameter is larger, a pose found by the smaller one is where it should be the other way
        np.testing.assert_allclose(found[:, :, k], se3.displacement(*ends) / (2.0 * h), rtol=1e-4, atol=1e-7)


def _moved(o: Observation, name: str, by: float) -> Observation:
    class Moved:
        def __getattr__(self, key: str) -> object:
            return getattr(o, key)

        def predict(self, at: FloatArray, p: FloatArray) -> FloatArray:
            return o.predict(at, values(o) + by * np.array([q.name == name for q in o.parameters]))

    return Moved()  # type: ignore[return-value]


def test_pressure_angles_are_those_of_speeds() -> None:
    """Of six straight or wrapped cables, by the definition; and none is singular in a cell."""
    channels, at = cables(0, 6), poses(0, 5)
    G = twists(channels, at)
    np.testing.assert_allclose(G @ rows(channels, at), np.tile(np.eye(6), (5, 1, 1)), atol=1e-9)
    found = pressure_angles(channels, at, G)
    arm = np.stack([se3.matrices(at) @ o.point for o in channels], axis=2)
    speed = np.linalg.norm(G[:, 3:] + np.cross(G[:, :3], arm, axis=1), axis=1)
    np.testing.assert_allclose(np.cos(found) * speed, 1.0, rtol=1e-12)
    assert found.max() < np.radians(80.0)


def test_what_is_not_told_is_no_pose() -> None:
    channels, at = cables(1, 6), poses(1, 4)
    readings = predictions(channels, at)
    readings[0, 2] = np.nan
    readings[1, 3] -= 5000.0
    readings[2] = np.inf
    found = solve_poses(channels, readings, HOME)
    assert found.status.tolist()[0] == Status.GAP
    assert found.status.tolist()[1] in (Status.NOT_CONVERGED, Status.SINGULAR)
    assert found.status.tolist()[2] == Status.GAP
    assert found.status.tolist()[3] == Status.OK
    assert np.isnan(found.poses[:3]).all()
    assert np.isnan(found.covariance[:3]).all()
    twice = [*channels[:5], channels[4]]
    assert (solve_poses(twice, predictions(twice, at), at).status == Status.SINGULAR).all()
    assert np.isnan(twists(channels[:5], at)).all()
    for solver in (solve_poses, follow):
        assert len(solver(channels, np.empty((0, 6)), HOME).status) == 0
    assert np.isnan(twists(twice, at)).all()


def test_what_is_held_does_not_move() -> None:
    """A planar stage on three cables: the other components stay as they were at the start."""
    channels, free = cables(2, 3), np.array([2, 3, 4])
    truth = path(200)
    truth[:, 2] = 0.0
    truth[:, 3:5] = 0.0
    truth[:, 3:] /= np.linalg.norm(truth[:, 3:], axis=1)[:, None]
    found = follow(channels, predictions(channels, truth), HOME, free)
    assert (found.status == Status.OK).all()
    assert error_of(found.poses, truth).max() < EXACT_MM
    assert (found.covariance[:, [0, 1, 5]] == 0.0).all()


def test_a_run_is_followed_over_gaps_and_leaps() -> None:
    channels, truth = mixed(6), path(900, reach_mm=120.0, turn_rad=0.1)
    readings = predictions(channels, truth)
    readings[100:110, :4] = np.nan
    readings[300:600] = np.nan
    readings[700:720, [0, 4]] = np.nan
    found = follow(channels, readings, HOME)
    gap = np.isnan(readings).sum(axis=1) > 3
    np.testing.assert_array_equal(found.status, np.where(gap, Status.GAP, Status.OK))
    assert error_of(found.poses[~gap], truth[~gap]).max() < EXACT_MM
    sparse = follow(channels, readings[::25], HOME)
    np.testing.assert_allclose(sparse.poses, found.poses[::25], rtol=0, atol=1e-9)
    # a gap behind a sample that was far from the one before it
    readings[2::25] = np.nan
    beside = follow(channels, readings[[0, 200, 202, 250]], HOME)
    assert beside.status.tolist() == [Status.OK, Status.OK, Status.GAP, Status.OK]


def test_far_poses_are_gone_to_in_parts() -> None:
    """A leap of a metre and half a radian, behind a long gap: straight from the start Newton's steps lead elsewhere or nowhere."""
    for seed in (2, 3, 4, 6, 7):
        channels, truth = cables(seed % 5), poses(seed, 1, reach_mm=700.0, turn_rad=0.5)
        readings = predictions(channels, truth)
        alone = solve_poses(channels, readings, HOME)
        assert not error_of(alone.poses[alone.status == Status.OK], truth).max(initial=np.inf, where=alone.status[0] == Status.OK) < 1.0
        assert error_of(follow(channels, readings, HOME).poses, truth).max() < EXACT_MM


def test_a_step_turns_by_half_a_radian_at_most() -> None:
    channels, truth = cables(1, 8), poses(1, 6, reach_mm=100.0, turn_rad=0.3)
    away = se3.displaced(truth, np.tile([0.8, 0.3, -0.2, 100.0, 0.0, 0.0], (6, 1)))
    found = solve_poses(channels, predictions(channels, truth), away)
    assert (np.abs(se3.displacement(found.poses, truth)).max(axis=1) < EXACT_MM).sum() >= 3


def test_the_other_side_of_a_singular_pose_is_another_assembly() -> None:
    """Poses on both sides, each found by itself: those beyond are refused, from the first one on, and the run is lost there."""
    six = cables(3)
    sides = se3.displaced(HOME, np.column_stack([np.zeros((5, 2)), [0.0, 0.1, -1.4, 0.2, 0.0], np.zeros((5, 3))]))
    each = solve_poses(six, predictions(six, sides), sides)
    assert (each.status == Status.OK).all()
    found, ended = _until_lost(each, six, ALL, float(_side(six, HOME[None], ALL)[0]))
    assert ended
    assert found.status.tolist() == [Status.OK, Status.OK, Status.OTHER_ASSEMBLY]
    assert np.isnan(found.poses[2]).all()
    assert np.isnan(found.covariance[2]).all()


def test_behind_a_singular_pose_nothing_is_guessed() -> None:
    """The tool turns far about the vertical: six cables lose it, and say so to the end."""
    turn = np.linspace(0.0, 2.5, 400)
    truth = se3.displaced(HOME, np.column_stack([np.zeros((400, 2)), turn, np.zeros((400, 3))]))
    six = cables(3)
    found = follow(six, predictions(six, truth), HOME)
    ok = found.status == Status.OK
    lost = int(np.argmin(ok))
    assert 50 < lost < 399
    assert found.status[lost] in (Status.SINGULAR, Status.OTHER_ASSEMBLY)
    assert (found.status[lost + 1 :] == Status.OTHER_ASSEMBLY).all()
    assert error_of(found.poses[ok], truth[ok]).max() < 1e-6
    # more channels than where it was lost tell the pose again
    both: list[Observation] = [*six, *(swivel(c, 0.0) for c in six)]
    readings = predictions(both, truth)
    readings[: lost + 20, 6:] = np.nan
    # nor do as many as before, where there were fewer in between
    readings[lost + 1 : lost + 4, 0] = np.nan
    again = follow(both, readings, HOME)
    assert (again.status[lost + 1 : lost + 20] == Status.OTHER_ASSEMBLY).all()
    there = again.status == Status.OK
    assert error_of(again.poses[there], truth[there]).max() < 1e-6


def test_a_sample_that_is_far_is_gone_to_alone() -> None:
    """By parts, from the pose before; those behind it are begun where it ends."""
    channels = cables(7)
    there = se3.displaced(HOME, np.array([0.0, 0.0, 0.0, 90.0, -40.0, 60.0]))
    readings = predictions(channels, np.stack([there, there, there]))
    found = _near(channels, readings, HOME[None], ALL)
    assert len(found.status) == 1
    assert found.status[0] == Status.OK
    assert error_of(found.poses, there[None]).max() < EXACT_MM
    assert len(_near(channels, readings, there[None], ALL).status) == 3


class Plain:
    """A channel whose reading is linear in a small motion from home, by a row that does not change; how it is asked is kept."""

    variance, period, parameters = 1.0, np.inf, ()

    def __init__(self, row: FloatArray, point: FloatArray) -> None:
        self.name, self.of, self.point = "plain", row, point
        self.asked: list[FloatArray] = []

    def predict(self, at: FloatArray, p: FloatArray) -> FloatArray:
        self.asked.append(at.copy())
        return np.asarray(se3.displacement(at, np.broadcast_to(HOME, at.shape)) @ self.of)

    def row(self, at: FloatArray, p: FloatArray) -> FloatArray:
        return np.tile(self.of, (len(at), 1))

    def gradient(self, at: FloatArray, p: FloatArray) -> FloatArray:
        return np.empty((len(at), 0))


def plain(*along: float) -> list[Plain]:
    """Six that each see one component of a motion so many times, turns counted at the 200 mm at which their points are."""
    return [Plain(row, np.array([0.0, 200.0, 0.0])) for row in np.diag(along) * np.repeat([200.0, 1.0], 3)]


@pytest.mark.parametrize("weak", [1, 4], ids=["a turn", "a shift"])
@pytest.mark.parametrize("strong", [0, 5], ids=["beside a turn", "beside a shift"])
def test_a_motion_that_rows_of_one_size_see_ten_million_times_less_is_not_determined(weak: int, strong: int) -> None:
    """Turns counted at the tool's size; on both sides of the limit. Two rows of one size that differ by p have singular values sqrt(2) and
    p / sqrt(2)."""
    for part, determined in ((1.9e-7, False), (2.1e-7, True)):
        seen = np.eye(6)
        seen[weak, [weak, strong]] = part, 1.0
        unit = np.repeat([200.0, 1.0], 3)
        found = twists([Plain(row, np.array([0.0, 200.0, 0.0])) for row in seen * unit], HOME[None])[0]
        assert np.isfinite(found).all() == determined
        if determined:
            np.testing.assert_allclose(found * unit[:, None], np.linalg.inv(seen), rtol=1e-6, atol=1e-6)


def test_a_motion_that_is_seen_little_is_determined_all_the_same() -> None:
    """A channel that hardly moves, or is hardly known, makes a pose uncertain, not singular."""
    seen = np.full(6, 0.5)
    seen[[1, 4]] = 1e-9, 1.0
    found = twists(plain(*seen), HOME[None])[0]
    np.testing.assert_allclose(found, np.diag(1.0 / (seen * np.repeat([200.0, 1.0], 3))), rtol=1e-6)


class Far:
    """A straight cable whose rig is a hundred times as large."""

    def __init__(self, o: Observation) -> None:
        self.name, self.variance, self.period, self.parameters = o.name, o.variance, o.period, o.parameters
        self.base, self.point = 100.0 * values(o)[:3], 100.0 * values(o)[9:12]

    def ways(self, at: FloatArray) -> FloatArray:
        return np.asarray(at[:, :3] + se3.matrices(at) @ self.point - self.base)

    def predict(self, at: FloatArray, p: FloatArray) -> FloatArray:
        return np.asarray(np.linalg.norm(self.ways(at), axis=1))

    def row(self, at: FloatArray, p: FloatArray) -> FloatArray:
        along = self.ways(at) / self.predict(at, p)[:, None]
        return np.hstack([np.cross(se3.matrices(at) @ self.point, along), along])

    def gradient(self, at: FloatArray, p: FloatArray) -> FloatArray:
        return np.zeros((len(at), len(p)))


def test_poses_in_a_hall_of_a_hundred_metres_are_found() -> None:
    """Where a step never gets as small as in a cell, as readings are rounded to more."""
    channels = [Far(o) for o in cables(0, 6, radius=0.0)]
    truth = poses(0, 40, reach_mm=10_000.0)
    found = solve_poses(
        channels, predictions(channels, truth), se3.displaced(truth, np.tile([0.01, 0.0, 0.01, 300.0, -200.0, 100.0], (40, 1)))
    )
    assert (found.status == Status.OK).all()
    assert error_of(found.poses, truth).max() < 1e-7


def test_where_a_channel_cannot_be_read_nothing_is_told() -> None:
    """A cable to a point on its pulley's swivel axis: no pose is found from there, and no channel is known to move it."""
    channels = mixed(0)
    p = values(channels[0])
    alpha, beta = np.radians(p[3:5])
    along = np.array([-np.cos(alpha) * np.sin(beta), -np.cos(alpha) * np.cos(beta), np.sin(alpha)])
    on = HOME.copy()
    on[:3] = p[:3] + 900.0 * along - p[9:12]
    beside = se3.displaced(on, np.array([0.0, 0.0, 0.0, 3.0, -5.0, 4.0]))
    known = np.isfinite(twists(channels, np.stack([on, beside])))
    assert not known[0].any()
    assert known[1].all()
    found = solve_poses(channels, predictions(channels, beside[None]), np.stack([on]))
    assert found.status.tolist() == [Status.NOT_CONVERGED]
    assert np.isnan(found.poses).all()


def test_lengths_of_motions_are_their_largest_part_at_the_size_of_the_tool() -> None:
    channels = plain(*np.ones(6))
    motions = np.array([(0.01, 0, 0, 1.0, 0, 0), (0.01, 0, -0.02, 0, 3.0, 0), (0, 0.01, 0, 0, 1.9, -2.5), np.zeros(6)])
    np.testing.assert_allclose(lengths(channels, motions), [2.0, 4.0, 2.5, 0.0], rtol=1e-12)
