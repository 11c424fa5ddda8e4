"""Least squares over channels, sample by sample: what each status says, and that neither order nor what is not free changes a pose."""

import numpy as np
import pytest
import scipy.optimize
from numpy.typing import NDArray
from rows import HOME, singular_angle, straight_row, turned
from scipy.spatial.transform import Rotation

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT, BASE, RADIUS, cable, damped_search, least_squares, span_lengths

ALL = np.arange(6)


def straight(m: int = 6) -> FloatArray:
    """(m, columns) straight cables from all around to a plate, in no plane of symmetry."""
    g, i = np.random.default_rng(5), np.arange(m)
    turn, up = np.radians(360.0 / m * i + 15.0 * (-1.0) ** i), np.where(i % 2, 0.7, -0.4)
    bases = 1300.0 * np.column_stack([np.cos(turn), np.sin(turn), up]) + g.uniform(-80.0, 80.0, (m, 3))
    at = np.radians(np.array([40.0, 160.0, 280.0]))[(i + 1) // 2 % 3]
    ends = 180.0 * np.column_stack([np.cos(at), np.sin(at), 0.0 * at]) + g.uniform(-15.0, 15.0, (m, 3))
    return np.array([straight_row(b, p) for b, p in zip(bases, ends, strict=True)])


def lengths(rows: FloatArray, poses: FloatArray) -> FloatArray:
    """(n, m) by the distances of points alone."""
    turned = np.stack([Rotation.from_quat(p[3:]).apply(rows[:, ATTACHMENT : ATTACHMENT + 3]) + p[:3] for p in poses])
    return np.asarray(np.linalg.norm(turned - rows[:, BASE : BASE + 3], axis=2))


def followed(
    rows: FloatArray, changes: FloatArray, *, start: FloatArray = HOME, state: FloatArray | None = None, free: NDArray[np.int64] = ALL
) -> tuple[FloatArray, list[int], NDArray[np.int64]]:
    """Poses, status and iterations of changes (n, m) from where the state is, else the start; what has no pose is a gap."""
    m = len(rows)
    state = least_squares.new_state(start, m) if state is None else state
    zero, flags = span_lengths(rows, start[None])[0], np.full(len(changes), int(Status.GAP))
    found = least_squares.follow_least_squares(rows, start, zero, state, changes, flags, np.full(m, 0.003), free)
    return found[0], found[3].tolist(), found[2]


def of(rows: FloatArray, truth: FloatArray, start: FloatArray = HOME) -> FloatArray:
    """(n, m) changes of length from the start."""
    return np.asarray(lengths(rows, truth) - lengths(rows, start[None]))


def about(turn: tuple[float, float, float], shift: tuple[float, float, float]) -> FloatArray:
    return se3.displaced(HOME, np.array([[*turn, *shift]]))


NEAR = about((0.02, -0.05, 0.04), (8.0, -5.0, 7.0))


@pytest.mark.parametrize("order", [(0, 1, 2, 3, 4, 5), (1, 0, 2, 3, 4, 5)])
def test_cables_are_followed_in_any_order(order: tuple[int, ...]) -> None:
    """Two of them exchanged, the determinant of their rows has the other sign."""
    rows = straight()[list(order)]
    poses, status, _ = followed(rows, of(rows, NEAR))
    assert status == [Status.OK]
    np.testing.assert_allclose(se3.displacement(poses, NEAR), 0.0, atol=1e-9)


def test_through_a_singular_pose_of_six_with_a_seventh_and_on_without_it() -> None:
    """What the seventh has led across is followed on the far side: where it stands decides, not where it began."""
    rows = straight(7)
    turns = singular_angle(rows[:6]) + np.array([-0.4, -0.2, -0.1, 0.1, 0.2, 0.4, 0.42, 0.45])
    truth = turned(turns)
    changes = of(rows, truth)
    changes[6:, 6] = np.nan
    poses, status, _ = followed(rows, changes)
    assert status == [Status.OK] * 8
    np.testing.assert_allclose(se3.displacement(poses, truth), 0.0, atol=1e-7)


@pytest.mark.parametrize("n", range(20, 60, 4))
def test_through_a_singular_pose_nothing_is_told_as_if_it_had_turned_back(n: int) -> None:
    """Six cables, whole counts and samples of any distance: what is told is where the tool is, until it could be either."""
    rows = straight()
    truth = turned(np.linspace(0.0, 1.6 * singular_angle(rows), n))
    poses, status, _ = followed(rows, 0.012 * np.round(of(rows, truth) / 0.012))
    ok = np.array(status) == Status.OK
    assert 5 < ok.sum() < n
    assert np.abs(se3.displacement(poses[ok], truth[ok])[:, 3:]).max() < 1.0
    assert set(status[int(ok.sum()) + 1 :]) <= {Status.OTHER_ASSEMBLY}


def test_no_cable_at_all_is_a_gap_before_it_is_anything_else() -> None:
    rows = straight()
    changes = of(rows, np.repeat(NEAR, 3, axis=0))
    changes[1] = np.nan
    assert followed(rows, changes)[1] == [Status.OK, Status.GAP, Status.OK]


def test_just_so_many_cables_as_unknowns_are_enough() -> None:
    rows = straight(8)
    changes = of(rows, np.repeat(NEAR, 3, axis=0))
    changes[1, [2, 5]], changes[2, [1, 3, 6]] = np.nan, np.nan
    poses, status, _ = followed(rows, changes)
    assert status == [Status.OK, Status.OK, Status.GAP]
    np.testing.assert_allclose(se3.displacement(poses[:2], NEAR[[0, 0]]), 0.0, atol=1e-9)


@pytest.mark.parametrize(("near", "met"), [(0.1, Status.OTHER_ASSEMBLY), (0.45, Status.SINGULAR)])
def test_what_six_cables_lost_a_seventh_finds_again_and_six_follow_on(near: float, met: Status) -> None:
    """All but the seventh come to a singular pose, which is foreseen or met; while the seventh is away nothing is told, once it is back
    all is, and it may go again."""
    rows = straight(7)
    lost = singular_angle(rows[:6])
    truth = turned(np.array([0.5 * lost, 0.6 * lost, lost - near, lost, lost - 0.3, lost - 0.3, lost - 0.32]))
    changes = of(rows, truth)
    changes[[0, 1, 2, 3, 4, 6], 6] = np.nan
    poses, status, _ = followed(rows, changes)
    assert status == [Status.OK] * 3 + [met, Status.OTHER_ASSEMBLY] + [Status.OK] * 2
    np.testing.assert_allclose(se3.displacement(poses[5:], truth[5:]), 0.0, atol=1e-7)


@pytest.mark.parametrize("seed", range(4))
def test_three_standard_uncertainties_of_what_counts_from_a_singular_pose(seed: int) -> None:
    """Readings uncertain by u along the column of the inverse that moves the tool most: with a little less the determinant keeps its sign
    within three standard uncertainties of the pose, with a little more it does not. A seventh cable does not count."""
    rows, g = straight(7), np.random.default_rng(seed)
    if seed % 2:
        rows[[0, 3]] = rows[[3, 0]]  # the other sign
    silent = 6 if seed < 2 else 2
    rows = np.insert(rows[:6], silent, rows[6], axis=0)
    used = np.delete(np.arange(7), silent)
    pose, size = turned(np.array([singular_angle(rows[used]) - 0.004]))[0], 180.0
    J = cable.span_rows(rows[used], pose)
    u, G = g.uniform(0.2, 1.0, 7), np.full((6, 7), np.nan)
    G[:, used] = np.linalg.inv(J)
    moved = np.linalg.norm(G[:, used] * np.repeat([[size], [1.0]], 3, axis=0), axis=0) * u[used]  # mm
    worst = int(np.argmax(moved))
    twist = G[:, used[worst]] * u[used[worst]] * np.sqrt((moved**2).sum()) / moved[worst]

    def sides(scale: float) -> list[bool]:
        probes = se3.displaced(np.tile(pose, (2, 1)), np.outer([3.0 * scale, -3.0 * scale], twist))
        return [bool(np.linalg.det(cable.span_rows(rows[used], probe)) * np.linalg.det(J) < 0.0) for probe in probes]

    beyond = next(scale for scale in np.geomspace(1e-3, 1e3, 200) if any(sides(scale)))
    assert sides(beyond) != [True, True]
    limit = scipy.optimize.bisect(lambda scale: any(sides(scale)) - 0.5, 0.9 * beyond, beyond, xtol=1e-4 * beyond)
    weights, side = (np.arange(7) != silent) / u, float(np.linalg.det(J / u[used][:, None]))
    for part, sees in ((0.98, False), (1.02, True)):
        assert least_squares._could_turn(rows, pose, weights, part * limit * u, ALL, size, G, side) == sees


def test_cables_that_hardly_tell_a_motion_tell_no_pose() -> None:
    """Of seven, two are one cable: from a pressure angle of 88 degrees on, by the pseudo-inverse of their rows, a sample is singular, and
    what comes after waits for more cables."""
    rows = straight(7)
    rows[6] = rows[5]
    lost = singular_angle(rows[:6])
    truth = turned(np.concatenate([np.linspace(0.0, lost - 0.1, 20), np.linspace(lost - 0.09, lost - 0.02, 30)]))
    poses, status, _ = followed(rows, of(rows, truth))
    speeds = []
    for pose in truth:
        G = np.linalg.pinv(cable.span_rows(rows, pose))
        arms = Rotation.from_quat(pose[3:]).apply(rows[:, ATTACHMENT : ATTACHMENT + 3])
        speeds.append(np.linalg.norm(G[3:].T + np.cross(G[:3].T, arms), axis=1).max())
    angles = np.degrees(np.arccos(1.0 / np.array(speeds)))
    first = int(np.argmax(angles > 88.0))
    assert 20 < first < 49
    assert status == [Status.OK] * first + [Status.SINGULAR] + [Status.OTHER_ASSEMBLY] * (49 - first)
    np.testing.assert_allclose(se3.displacement(poses[:first], truth[:first]), 0.0, atol=1e-7)


def test_one_cable_twice_tells_no_pose_and_no_twist() -> None:
    rows = straight()
    rows[3] = rows[2]
    poses, status, _ = followed(rows, np.full((1, 6), 0.5))
    assert status == [Status.SINGULAR]
    assert np.isnan(poses).all()
    assert np.isnan(least_squares.twists(rows, HOME[None], np.ones((1, 6)), ALL)).all()
    assert np.isfinite(least_squares.twists(straight(), HOME[None], np.ones((1, 6)), ALL)).all()


def test_from_inside_of_a_pulley_no_cable_runs() -> None:
    """A pose that only a state put there by hand can have: the sample says so, and holds no pose."""
    rows = straight()
    rows[:, RADIUS] = 20.0
    state = least_squares.new_state(HOME, 6)
    state[:3] = rows[2, BASE : BASE + 3] - rows[2, ATTACHMENT : ATTACHMENT + 3]
    poses, status, _ = followed(rows, np.zeros((1, 6)), state=state)
    assert status == [Status.NOT_CONVERGED]
    assert np.isnan(poses).all()


def test_a_stage_keeps_what_is_not_free() -> None:
    """A plate that shifts and turns in its plane alone: the rest of its pose stays what it was, to the bit."""
    rows, free = straight(4), np.array([2, 3, 4])
    truth = np.concatenate([about((0.0, 0.0, 0.02 * i), (3.0 * i, -2.0 * i, 0.0)) for i in range(4)])
    poses, status, _ = followed(rows, of(rows, truth), free=free)
    assert status == [Status.OK] * 4
    np.testing.assert_allclose(se3.displacement(poses, truth), 0.0, atol=1e-9)
    assert not poses[:, [2, 3, 4]].any()
    # sought from beside
    sought, chi = damped_search(rows, lengths(rows, truth)[3], np.full(4, 0.01), free, truth[[0]])
    np.testing.assert_allclose(se3.displacement(sought, truth[[3]]), 0.0, atol=1e-6)
    assert not sought[:, [2, 3, 4]].any()
    assert chi[0] < 1e-9


def test_across_a_gap_the_straight_way_of_the_lengths_is_gone() -> None:
    """Half a metre and more at once: what is found is where small steps of the lengths lead. One step would miss it (these ends were
    chosen so)."""
    rows, g = straight(), np.random.default_rng(1)
    ends = [about(tuple(g.uniform(-0.6, 0.6, 3)), tuple(g.uniform(-300.0, 300.0, 3))) for _ in range(2 * 16)]
    for k in (0, 3, 15):
        state = least_squares.new_state(HOME, 6)
        state[:7], state[7:13] = ends[2 * k][0], of(rows, ends[2 * k])[0]
        end = of(rows, ends[2 * k + 1])[0]
        between = state[7:13] + (end - state[7:13]) * np.linspace(0.0, 1.0, 101)[:, None]
        slowly, status, _ = followed(rows, between, state=state.copy())
        assert status == [Status.OK] * 101
        at_once, status, _ = followed(rows, end[None], state=state)
        assert status == [Status.OK]
        np.testing.assert_allclose(se3.displacement(at_once, slowly[-1:]), 0.0, atol=1e-9)
