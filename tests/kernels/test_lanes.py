"""The lane kernel gives the poses of the sample-by-sample one, wherever it is allowed to answer."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from rows import HOME, cell_rows, singular_angle, turned
from scipy.spatial.transform import Rotation
from screw_poses import track

from lmeasure.core import FloatArray, Status
from lmeasure.kernels import cable, lanes, screw

IntArray = NDArray[np.int64]

U = np.full(6, 0.0035)
SAME_MM, SAME_RAD = 1e-9, 1e-12


def path(n: int, speed: float = 1.0, turn: float = 0.2) -> FloatArray:
    """(n, 7) poses of a smooth motion at 1 kHz that begins at HOME."""
    t = np.arange(n) * 1e-3 * speed
    w = 2.0 * np.pi * np.array([0.31, 0.43, 0.37])
    position = HOME[:3] + 180.0 * np.sin(np.outer(t, w)) * [1.0, -0.8, 0.6]
    rotation = Rotation.from_rotvec(turn * np.sin(np.outer(t, w[::-1]))) * Rotation.from_quat(HOME[3:])
    return np.column_stack([position, rotation.as_quat()])


def changes(rows: FloatArray, poses: FloatArray, noise_mm: float = 0.0, seed: int = 0) -> FloatArray:
    lengths = cable.span_lengths(rows, poses) - cable.span_lengths(rows, HOME[None])
    return np.asarray(lengths + np.random.default_rng(seed).normal(0.0, 1.0, lengths.shape) * noise_mm)


def both(rows: FloatArray, change: FloatArray, flags: IntArray | None = None) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    flags = np.zeros(len(change), np.int64) if flags is None else flags
    one = track(rows, HOME, change, flags, U)
    many = lanes.follow_lanes(rows, HOME, screw.new_state(HOME), change, flags, U)
    return one, many


def assert_same(one: tuple[FloatArray, ...], many: tuple[FloatArray, ...]) -> None:
    np.testing.assert_array_equal(many[3], one[3])
    ok = one[3] == Status.OK
    assert np.isnan(many[0][~ok]).all()
    assert np.isnan(many[1][~ok]).all()
    np.testing.assert_allclose(many[0][ok, :3], one[0][ok, :3], rtol=0, atol=SAME_MM)
    turn = Rotation.from_quat(many[0][ok, 3:]) * Rotation.from_quat(one[0][ok, 3:]).inv()
    if ok.any():
        assert turn.magnitude().max() < SAME_RAD
        assert many[1][ok].max() < 1e-10
    np.testing.assert_allclose(many[4][ok], one[4][ok], rtol=0, atol=1e-9)


@pytest.fixture(scope="module")
def rows() -> FloatArray:
    return cell_rows()


@pytest.mark.parametrize("noise_mm", [0.0, 0.02, 0.2])
def test_a_log_is_the_same_in_lanes(rows: FloatArray, noise_mm: float) -> None:
    truth = path(9000)
    one, many = both(rows, changes(rows, truth, noise_mm))
    assert (one[3] == Status.OK).all()
    assert_same(one, many)
    if noise_mm == 0.0:
        assert np.abs(many[0][:, :3] - truth[:, :3]).max() < SAME_MM


@settings(max_examples=30, deadline=None)
@given(st.integers(1, 700), st.integers(0, 2**32 - 1), st.floats(0.0, 0.3))
def test_any_length_of_log_and_any_gaps(n: int, seed: int, missing: float) -> None:
    table = cell_rows()
    generator = np.random.default_rng(seed)
    flags = np.where(generator.random(n) < missing, Status.GAP, Status.OK).astype(np.int64)
    change = changes(table, path(n, speed=5.0), 0.01, seed)
    change[flags != Status.OK] = np.nan
    assert_same(*both(table, change, flags))


def test_a_fast_motion_falls_back_sample_by_sample(rows: FloatArray) -> None:
    # 64 samples move the cables by decimetres: the lanes start too far away
    truth = path(2000, speed=60.0)
    one, many = both(rows, changes(rows, truth))
    assert_same(one, many)
    assert np.abs(many[0][:, :3] - truth[:, :3]).max() < SAME_MM


def test_behind_a_long_gap_the_motion_goes_on(rows: FloatArray) -> None:
    truth = path(6000)
    flags = np.zeros(6000, np.int64)
    flags[1000:3500] = Status.GAP
    one, many = both(rows, changes(rows, truth, 0.01), flags)
    assert (one[3][3500:] == Status.OK).all()
    assert_same(one, many)


def test_lengths_of_no_pose_spoil_their_own_samples_only(rows: FloatArray) -> None:
    change = changes(rows, path(5000), 0.01)
    change[2000:2010, 0] -= 5000.0
    one, many = both(rows, change)
    assert (one[3][2000:2010] != Status.OK).all()
    assert_same(one, many)


def test_what_is_lost_near_a_singular_pose_is_lost_in_lanes(rows: FloatArray) -> None:
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        t = np.linspace(0.0, 1.0, 6000)
        turn = Rotation.from_rotvec(np.outer(1.6 * np.sin(np.pi * t), axis)) * Rotation.from_quat(HOME[3:])
        truth = np.column_stack([np.tile(HOME[:3], (6000, 1)) + np.outer(40 * t, [1, 0, 0]), turn.as_quat()])
        change = changes(rows, truth)
        if not np.isfinite(change).all():
            continue
        one, many = both(rows, change)
        np.testing.assert_array_equal(many[3] == Status.OK, one[3] == Status.OK)
        ok = many[3] == Status.OK
        assert np.abs(many[0][ok, :3] - truth[ok, :3]).max() < 1e-4


def test_a_short_dip_through_a_singular_pose_between_coarse_samples_is_seen(rows: FloatArray) -> None:
    singular = singular_angle(rows)
    assert 0.5 < singular < 2.0
    # there slowly, a stand, and a dip of 40 samples to beyond and back that begins behind a coarse sample
    stand = singular - 0.03
    turn = np.concatenate([np.linspace(0.0, stand, 64 * 30 + 1), np.full(64 * 4, stand)])
    dip = slice(64 * 32 + 10, 64 * 32 + 50)
    turn[dip] += 0.04 * np.sin(np.linspace(0.0, np.pi, 40))
    one, many = both(rows, changes(rows, turned(turn)))
    assert (one[3][: dip.start] == Status.OK).all()
    assert (one[3][dip.stop :] == Status.OTHER_ASSEMBLY).all()
    assert_same(one, many)


def test_a_run_given_in_pieces_is_the_same_run(rows: FloatArray) -> None:
    change = changes(rows, path(3000), 0.01)
    flags = np.zeros(3000, np.int64)
    whole = lanes.follow_lanes(rows, HOME, screw.new_state(HOME), change, flags, U)
    for kernel in (lanes.follow_lanes, screw.resume_screw):
        state = screw.new_state(HOME)
        parts = [kernel(rows, HOME, state, change[i : i + 700], flags[i : i + 700], U)[0] for i in range(0, 3000, 700)]
        np.testing.assert_allclose(np.vstack(parts), whole[0], rtol=0, atol=SAME_MM)


@pytest.mark.parametrize(("degrees", "safe"), [(74.9, True), (75.1, False), (np.nan, False)])
def test_a_tile_is_taken_up_to_75_degrees_in_every_lane(degrees: float, safe: bool) -> None:
    tile = np.zeros((lanes.TILE_ROWS, lanes.WIDTH))
    tile[lanes.DETERMINANT] = 1.0
    tile[lanes.ANGLE, 17] = np.radians(degrees)
    assert lanes._safe(tile.ravel(), 1.0) == safe


def test_tiles_are_taken(rows: FloatArray) -> None:
    """Sample by sample a motion that stands at every second one needs other numbers of steps there than where it moves; a tile has one.
    Where nothing forbids them all tiles are taken, where the motion is too fast for them none."""
    whole = lanes.COARSE * 16
    standing = np.repeat(path(whole // 2, speed=3.0), 2, axis=0)
    one, many = both(rows, changes(rows, standing))
    assert_same(one, many)
    tiles = many[2].reshape(-1, lanes.WIDTH)
    assert (tiles == tiles[:, :1]).all()
    assert (tiles > 0).all()
    assert (one[2].reshape(-1, lanes.WIDTH).min(axis=1) < one[2].reshape(-1, lanes.WIDTH).max(axis=1)).all()
    # behind a tile that had to be gone through one by one they are taken again
    change = changes(rows, standing)
    change[3 * lanes.WIDTH + 10, 0] -= 5000.0
    one, many = both(rows, change)
    assert_same(one, many)
    tiles = many[2].reshape(-1, lanes.WIDTH)
    np.testing.assert_array_equal(tiles[3], one[2].reshape(-1, lanes.WIDTH)[3])
    assert (np.delete(tiles, 3, axis=0) == np.delete(tiles[:, :1], 3, axis=0)).all()
    fast = np.repeat(path(whole // 2, speed=60.0), 2, axis=0)
    one, many = both(rows, changes(rows, fast))
    np.testing.assert_array_equal(many[2], one[2])


def test_few_samples_begin_with_the_cables_farthest_from_coplanar(rows: FloatArray) -> None:
    ordered, places = lanes._order(rows, HOME)
    directions = cable.span_rows_of(rows, HOME[None])[0, :, 3:]
    volumes = {c: abs(np.linalg.det(directions[list(c)])) for c in itertools.combinations(range(6), 3)}
    assert tuple(places[:3]) == max(volumes, key=lambda c: volumes[c])
    assert sorted(places) == [0, 1, 2, 3, 4, 5]
    np.testing.assert_array_equal(ordered, rows[places])
    # and with quaternions on one half of their sphere
    turned = np.array([HOME, [*HOME[:3], *-HOME[3:]]])
    assert [lanes._side_of(turned, 0, b) for b in (0, 1)] == [1.0, -1.0]


def test_few_samples_in_tiles(rows: FloatArray) -> None:
    """So few that kernels are seen through without being compiled (NUMBA_DISABLE_JIT=1)."""
    change = changes(rows, np.repeat(path(2 * lanes.COARSE, speed=3.0), 2, axis=0))
    change[lanes.WIDTH + 10, 0] -= 5000.0
    one, many = both(rows, change)
    assert_same(one, many)
    assert (np.flatnonzero(one[3]) == lanes.WIDTH + 10).all()
    tiles = many[2].reshape(-1, lanes.WIDTH)
    np.testing.assert_array_equal(tiles[1], one[2].reshape(-1, lanes.WIDTH)[1])
    assert (np.delete(tiles, 1, axis=0) == np.delete(tiles[:, :1], 1, axis=0)).all()


@pytest.mark.parametrize("n", [1, lanes.WIDTH, lanes.WIDTH + 1, lanes.WIDTH + 2])
def test_few_samples_of_a_tile_begun(rows: FloatArray, n: int) -> None:
    change = changes(rows, path(n))
    one, many = both(rows, change)
    assert (one[3] == Status.OK).all()
    assert_same(one, many)


def test_few_samples_near_a_singular_pose_go_one_by_one(rows: FloatArray) -> None:
    """A tile beyond 75 degrees is not taken, not even the first, which begins at the state itself; one before is."""
    n = lanes.WIDTH
    for away, taken in ((0.05, False), (0.6, True)):
        poses = turned(singular_angle(rows) - away - np.linspace(0.0, 0.01, n))
        lengths = cable.span_lengths(rows, poses)
        change, flags = lengths - lengths[0], np.zeros(n, np.int64)
        one = track(rows, poses[0], change, flags, U)
        many = lanes.follow_lanes(rows, poses[0], screw.new_state(poses[0]), change, flags, U)
        assert (one[3] == Status.OK).all()
        assert_same(one, many)
        assert (one[4] > lanes.CLEAR_OF_SINGULAR).all() != taken
        assert len(set(one[2])) > 1
        assert (len(set(many[2])) == 1) == taken
        assert taken or (many[2] == one[2]).all()


def test_few_samples_at_rest_take_a_tile_in_one_step(rows: FloatArray) -> None:
    change, state = np.zeros((2 * lanes.WIDTH, 6)), screw.new_state(HOME)
    found = lanes.follow_lanes(rows, HOME, state, change, np.zeros(len(change), np.int64), U)
    assert (found[2] == 1).all()
    np.testing.assert_allclose(found[0], np.tile(HOME, (len(change), 1)), atol=1e-12)


def test_tiles_beyond_75_degrees_go_sample_by_sample(rows: FloatArray) -> None:
    """And those before are taken: a turn towards a singular pose, so slow that its coarse samples do not run over it."""
    near = singular_angle(rows)
    turn = np.concatenate(
        [np.linspace(0.0, near - 0.25, lanes.CHUNK), np.repeat(np.linspace(near - 0.25, near - 0.03, lanes.CHUNK // 2), 2)]
    )
    one, many = both(rows, changes(rows, turned(turn)))
    assert (one[3] == Status.OK).all()
    assert_same(one, many)
    alone, tiles = (found[2][lanes.CHUNK :].reshape(-1, lanes.WIDTH) for found in (one, many))
    beyond = one[4][lanes.CHUNK :].reshape(-1, lanes.WIDTH).max(axis=1) > lanes.CLEAR_OF_SINGULAR
    assert 8 < beyond.sum() < len(beyond) - 8
    np.testing.assert_array_equal(tiles[beyond], alone[beyond])
    assert (tiles[~beyond] == tiles[~beyond][:, :1]).all(axis=1).mean() > 0.8
    assert (alone != alone[:, :1]).any(axis=1).all()


@pytest.mark.parametrize("first", range(6))
def test_few_samples_of_a_tile_are_stepped_and_judged_as_by_whole_matrices(rows: FloatArray, first: int) -> None:
    """Each cable once in each place, so that each is the one that decides: Newton's step, residual, angle and determinant by NumPy."""
    table, n = np.roll(rows, first, axis=0), lanes.WIDTH
    g = np.random.default_rng(first)
    turns = Rotation.from_rotvec(g.uniform(-0.3, 0.3, (n, 3)))
    poses = np.column_stack([g.uniform(-150.0, 150.0, (n, 3)), turns.as_quat()])
    off = g.uniform(-5.0, 5.0, (n, 6))
    targets = cable.span_lengths(table, poses) + off
    tile = np.zeros((lanes.TILE_ROWS, n))
    tile[:7] = poses.T
    judged, stepped = tile.ravel().copy(), tile.ravel().copy()
    lanes._judge(judged, targets.T.ravel().copy(), table)
    lanes._step(stepped, targets.T.ravel().copy(), table)
    judged, stepped = judged.reshape(tile.shape), stepped.reshape(tile.shape)
    J = cable.span_rows_of(table, poses)
    inverse = np.linalg.inv(J)
    arms = np.einsum("nij,mj->nmi", turns.as_matrix(), table[:, 7:10])
    twists = np.swapaxes(inverse, 1, 2)
    speeds = np.linalg.norm(twists[:, :, 3:] + np.cross(twists[:, :, :3], arms), axis=2)
    np.testing.assert_array_equal(judged[:7], tile[:7])
    for found in (judged, stepped):
        np.testing.assert_allclose(found[lanes.RESIDUAL], np.abs(off).max(axis=1), rtol=1e-9)
    np.testing.assert_allclose(judged[lanes.ANGLE], np.arccos(1.0 / speeds.max(axis=1)), rtol=1e-9)
    clear = np.abs(np.linalg.det(J[:, :3, 3:])) > lanes.CLEAR_OF_FLAT
    expected = np.where(clear, -np.linalg.det(J), 0.0)  # turns before shifts, which exchanges three columns with three
    np.testing.assert_allclose(judged[lanes.DETERMINANT], expected, rtol=1e-9, atol=1e-9)
    step = np.linalg.solve(J, off[:, :, None])[:, :, 0]
    np.testing.assert_allclose(stepped[:3].T, poses[:, :3] + step[:, 3:], rtol=1e-9, atol=1e-9)
    half = np.linalg.norm(step[:, :3], axis=1) / 2.0
    turned = Rotation.from_rotvec(step[:, :3] * (np.arctan(half) / half)[:, None]) * turns
    assert (Rotation.from_quat(stepped[3:7].T) * turned.inv()).magnitude().max() < 1e-12
    np.testing.assert_allclose(np.linalg.norm(stepped[3:7], axis=0), 1.0, rtol=1e-14)


@pytest.mark.parametrize(
    ("fine", "coarse", "last"), [(lanes.MIDDLE, lanes.COARSE, 700), (lanes.MIDDLE, lanes.COARSE, 60), (1, lanes.MIDDLE, 601)]
)
def test_few_samples_are_started_between_those_known(fine: int, coarse: int, last: int) -> None:
    """By the cubic of Catmull and Rom through four of the far ones, straight at the ends and between near ones, whatever the signs of
    quaternions are; behind the last sample by that."""
    g = np.random.default_rng(coarse + last)
    known = np.unique(np.r_[np.arange(0, last, coarse), last])
    work = np.full((lanes.CHUNK, 7), np.nan)
    work[known, :3] = g.normal(size=(len(known), 3)) * 100.0
    straight = Rotation.from_rotvec(g.uniform(-0.4, 0.4, (len(known), 3))).as_quat()
    work[known, 3:] = straight * np.resize([1.0, 1.0, -1.0, -1.0], (len(known), 1))
    targets, places = g.normal(size=(lanes.CHUNK, 6)), np.array([3, 1, 5, 0, 2, 4])
    pose = dict(zip(known.tolist(), np.column_stack([work[known, :3], straight * np.sign(straight[:, 3:])]), strict=True))
    for first in (0, coarse * (last // coarse // 2), coarse * (last // coarse)):
        S, T = np.zeros((lanes.TILE_ROWS, lanes.WIDTH)), np.zeros((6, lanes.WIDTH))
        flat = S.ravel(), T.ravel()
        lanes._load(work, targets, places, first, fine, coarse, last, *flat)
        samples = np.minimum(first + fine * np.arange(lanes.WIDTH), last)
        np.testing.assert_array_equal(T, targets[samples][:, places].T)
        for lane, i in enumerate(samples.tolist()):
            a = i // coarse * coarse
            if i in pose:
                expected = pose[i]
            else:
                b = min(a + coarse, last)
                f = (i - a) / (b - a)
                p1, p2 = pose[a], pose[b]
                expected = p1 + f * (p2 - p1)
                if coarse == lanes.COARSE and a >= coarse and a + 2 * coarse <= last:
                    p0, p3 = pose[a - coarse], pose[a + 2 * coarse]
                    m1, m2 = (p2 - p0) / 2.0, (p3 - p1) / 2.0
                    expected = (2 * f**3 - 3 * f**2 + 1) * p1 + (f**3 - 2 * f**2 + f) * m1 + (3 * f**2 - 2 * f**3) * p2 + (f**3 - f**2) * m2
            turned = expected[3:] / np.linalg.norm(expected[3:])
            np.testing.assert_allclose(S[:3, lane], expected[:3], atol=1e-11)
            np.testing.assert_allclose(S[3:7, lane] * np.sign(S[6, lane]), turned, atol=1e-14)


@pytest.mark.parametrize(
    ("off_mm", "steps"), [(0.0, 1), (0.9 * 3e-5, 1), (1.1 * 3e-5, 2), (0.02, 2), (0.2, 3), (9.9, 4), (10.1, 0), (np.nan, 0)], ids=str
)
def test_few_samples_are_stepped_until_nothing_is_left(rows: FloatArray, off_mm: float, steps: int) -> None:
    """Of a tile with one lane that is so far off: no more than 10 mm, and none is needed behind one of 0.03 micrometres."""
    tile = np.zeros((lanes.TILE_ROWS, lanes.WIDTH))
    tile[:7] = HOME[:, None]
    targets = np.tile(cable.span_lengths(rows, HOME[None])[0][:, None], lanes.WIDTH)
    if np.isnan(off_mm):  # where the samples around could not be found
        tile[:7, 63] = np.nan
    else:
        targets[4, 63] -= off_mm
    S, T = tile.ravel(), targets.ravel()
    assert lanes._refine(S, T, rows) == steps
    if steps:
        found = cable.span_lengths(rows, tile[:7].T)
        np.testing.assert_allclose(found, targets.T, atol=1e-8)


@pytest.mark.parametrize("lane", [0, 63])
@pytest.mark.parametrize(
    ("row", "value", "safe"),
    [
        (lanes.RESIDUAL, 0.9 * screw.TOLERANCE_MM, True), (lanes.RESIDUAL, 1.1 * screw.TOLERANCE_MM, False),
        (lanes.DETERMINANT, -1e-6, True), (lanes.DETERMINANT, 1e-6, False), (lanes.DETERMINANT, 0.0, False),
        (lanes.DETERMINANT, np.nan, False),
    ],
    ids=str,
)  # fmt: skip
def test_few_samples_that_are_far_off_or_on_the_other_side_are_not_taken(row: int, value: float, safe: bool, lane: int) -> None:
    tile = np.zeros((lanes.TILE_ROWS, lanes.WIDTH))
    tile[lanes.DETERMINANT] = -0.3
    tile[row, lane] = value
    assert lanes._safe(tile.ravel(), -2.0) == safe


@pytest.mark.parametrize("axis", range(3))
def test_few_samples_go_on_where_the_run_gets_to(rows: FloatArray, axis: int) -> None:
    """Within a thousand-millionth of a metre along each axis, and only where the run gets there."""
    there = path(400)[399:]
    change, flag = changes(rows, there), np.zeros(1, np.int64)
    for off, goes in ((0.9e-6, True), (1.1e-6, False), (-1.1e-6, False)):
        tile = np.zeros((lanes.TILE_ROWS, lanes.WIDTH))
        tile[:7] = there[0][:, None]
        tile[axis, 0] += off
        assert lanes._goes_on(rows, HOME, screw.new_state(HOME), change, flag, U, tile.ravel()) == goes
    lost = change.copy()
    lost[0, 0] -= 5000.0
    tile[:7] = there[0][:, None]
    assert not lanes._goes_on(rows, HOME, screw.new_state(HOME), lost, flag, U, tile.ravel())
