"""The screw method: published steps, poses from lengths made by an independent model, continuation, covariances by difference quotients."""

import math

import numpy as np
import oracles
import pytest
import scipy.linalg
import scipy.optimize
from rows import HOME, cell, cell_rows, singular_angle, straight_row, turned
from scipy.spatial.transform import Rotation
from screw_poses import U, angles_at, changes_of, random_pose, track

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import ATTACHMENT, BASE, cable, screw, span_lengths

NANOMETRE = 1e-6  # mm
NANORADIAN = 1e-9
# Thesis Rashoyan 2021, 4.4: a platform of three points on six legs of length 2, unit lengths throughout
SIX_LEGS = (
    ((0, 3, 0), (0, 1, 0)), ((-2, 1, 0), (0, 1, 0)), ((0, 1, -2), (0, 1, 0)), ((1, 0, -2), (1, 0, 0)), ((3, 0, 0), (1, 0, 0)),
    ((-1, 0, -2), (-1, 0, 0)),
)  # fmt: skip
# Thesis Table 5.1, with the pairing of legs to platform points that its figures imply
TABLE_5_1 = (
    ((3, -4.5, 0), (3, -3, 3)), ((4, -0.5, 0), (3, -3, 3)), ((2, -1.5, 0), (3, -3, 3)), ((3, 1, 0), (2, 1, 3)), ((2, 1, 0), (2, 1, 3)),
    ((0, -2, 0), (0, -2, 3)),
)  # fmt: skip


def legs(table: tuple[tuple[tuple[float, ...], tuple[float, ...]], ...]) -> FloatArray:
    return np.array([straight_row(b, p) for b, p in table])


def lengths_at(pose: FloatArray, seed: int = 0) -> FloatArray:
    """(6,) free lengths of the cell by the string oracle."""
    return np.array([float(oracles.free_length(c, pose)) for c in cell(seed)])


def poses_apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    """Distance [mm] and angle [rad] between two poses."""
    turn = (Rotation.from_quat(a[3:]) * Rotation.from_quat(b[3:]).inv()).magnitude()
    return float(np.linalg.norm(a[:3] - b[:3])), float(turn)


# --- published steps ---------------------------------------------------------------------------------------------------------------


def test_published_matrix_of_six_legs() -> None:
    """(4.27): rows (e; m) of the legs, determinant -2."""
    rows = cable.span_rows(legs(SIX_LEGS), HOME)
    printed = np.array(
        [[0, -1, 0, 0, 0, 0], [1, 0, 0, 0, 0, -1], [0, 0, 1, 1, 0, 0], [0, 0, 1, 0, -1, 0], [-1, 0, 0, 0, 0, 0], [0, 0, 1, 0, 1, 0]]
    )
    assert rows[:, [3, 4, 5, 0, 1, 2]] == pytest.approx(printed, abs=1e-15)
    assert np.linalg.det(printed) == pytest.approx(-2)


@pytest.mark.parametrize(
    ("signs", "twist", "moved"),
    [
        ((1, 1, 1, 1, 1, 1), (0.05, 0.05, -0.1, 0, -0.1, 0.05), ((0.1, 0.9, 0.1), (1, -0.2, 0), (-1, 0, 0.1))),
        # the transformed matrix: counts taken on levers, which turns the sign of legs 1, 2 and 5
        ((-1, -1, 1, 1, -1, 1), (0.05, 0.05, 0.1, 0, 0.1, 0.05), ((-0.1, 1.1, 0.1), (1, 0.2, 0), (-1, 0, 0.1))),
    ],
)
def test_published_screw_step(signs: tuple[int, ...], twist: tuple[float, ...], moved: tuple[tuple[float, ...], ...]) -> None:
    """Thesis 4.4: the twist of dl = (.1, .1, .1, 0, 0, .1) and the residuals 0.00475, 0.01 and 0 of its linear move.

    The printed z of P1 has a misprinted sign: only +0.1 gives the printed residual of leg 3.
    """
    table = legs(SIX_LEGS)
    change = np.array([0.1, 0.1, 0.1, 0, 0, 0.1])
    matrix = np.array(signs)[:, None] * cable.span_rows(table, HOME)
    solution = change[:, None].copy()
    screw.eliminate(matrix.copy(), solution)
    assert solution[:, 0] == pytest.approx(twist, abs=1e-15)
    omega, v = solution[:3, 0], solution[3:, 0]
    points = np.array([p for _, p in SIX_LEGS], dtype=np.float64)
    linear = points + v + np.cross(omega, points)
    assert linear[[0, 3, 5]] == pytest.approx(np.array(moved), abs=1e-15)
    base = np.array([b for b, _ in SIX_LEGS], dtype=np.float64)
    if all(sign == 1 for sign in signs):
        residual = np.linalg.norm(linear - base, axis=1) - (2 + change)
        assert sorted(np.abs(residual)) == pytest.approx([0, 0.004757, 0.004757, 0.004757, 0.009975, 0.009975], abs=1e-6)


def test_the_finite_screw_goes_on_until_the_lengths_are_met() -> None:
    """Where the published step stops at 0.01 the method goes on: residuals vanish and the platform stays rigid."""
    table = legs(SIX_LEGS)
    targets = 2 + np.array([0.1, 0.1, 0.1, 0, 0, 0.1])
    status, iterations, worst, pose = screw.solve_pose(table, targets, HOME)
    assert (status, worst < 1e-11) == (Status.OK, True)
    assert iterations <= 6
    turned = oracles.matrix_of_quaternion(pose[3:])
    for (b, p), length in zip(SIX_LEGS, targets, strict=True):
        assert np.linalg.norm(turned @ np.array(p) + pose[:3] - b) == pytest.approx(length, abs=1e-11)


def test_published_pressure_angles() -> None:
    """Table 5.1: printed 36.7, 57.2, 61.2, 72.2, 72, 0."""
    table = legs(TABLE_5_1)
    angles = np.degrees(angles_at(table, HOME[None])[0])
    assert angles == pytest.approx([36.7132, 57.1537, 61.2138, 72.1344, 72.0798, 0.0], abs=6e-5)
    _, _, _, _, worst = track(table, HOME, np.zeros((1, 6)), np.zeros(1, np.int64), U * 1e-6)
    assert np.degrees(worst[0]) == pytest.approx(72.1344, abs=6e-5)
    rows = cable.span_rows(table, HOME)
    assert abs(np.linalg.det(rows)) == pytest.approx(6.174488, abs=1e-6)


def test_pressure_angles_from_their_definition() -> None:
    """Angle between the free span and the velocity of its point when the other five lengths are held."""
    rows = cell_rows()
    g = np.random.default_rng(5)
    for _ in range(5):
        pose = random_pose(g)
        angles = angles_at(rows, pose[None])[0]
        for i in range(6):
            h = 1e-4
            ends = []
            for step in (h, -h):
                targets = cable.span_lengths(rows, pose[None])[0]
                targets[i] += step
                _, _, _, moved = screw.solve_pose(rows, targets, pose)
                ends.append(oracles.matrix_of_quaternion(moved[3:]) @ rows[i, 7:10] + moved[:3])
            v = (ends[0] - ends[1]) / (2 * h)
            e = cable.span_rows(rows, pose)[i, 3:]
            assert angles[i] == pytest.approx(math.acos(e @ v / np.linalg.norm(v)), abs=1e-6)


# --- linear algebra ----------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(5))
def test_elimination_against_lapack(seed: int) -> None:
    g = np.random.default_rng(seed)
    for m in (1, 3, 6):
        a, b = g.normal(size=(6, 6)), g.normal(size=(6, m))
        x, used = b.copy(), a.copy()
        assert screw.eliminate(used, x) == pytest.approx(np.linalg.det(a), rel=1e-12)
        assert x == pytest.approx(np.linalg.solve(a, b), rel=1e-10, abs=1e-12)


def test_elimination_says_singular() -> None:
    g = np.random.default_rng(1)
    a = g.normal(size=(6, 6))
    a[4] = a[1] + a[2]
    assert screw.eliminate(a.copy(), np.eye(6)) == 0.0
    a[0, 0] = np.nan
    assert screw.eliminate(a, np.eye(6)) == 0.0


def test_rows_of_which_one_is_the_other_and_something_more_are_solved() -> None:
    """Whatever of the one is to be taken from the other, just once too."""
    x = np.array([[5.0], [7.0]])
    assert screw.eliminate(np.array([[1.0, 2.0], [1.0, 3.0]]), x) == 1.0
    assert x.tolist() == [[1.0], [2.0]]


# --- poses from lengths ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_pose_from_lengths_of_an_independent_model(seed: int) -> None:
    g = np.random.default_rng(seed)
    rows = cell_rows(seed)
    for _ in range(4):
        truth = random_pose(g, 150.0, 0.2)
        status, iterations, worst, pose = screw.solve_pose(rows, lengths_at(truth, seed), HOME)
        assert status == Status.OK
        assert iterations <= 8
        assert worst < 1e-9
        away, turn = poses_apart(pose, truth)
        assert away < NANOMETRE * 1e-3
        assert turn < NANORADIAN * 1e-2


def test_the_frame_does_not_matter() -> None:
    """The rig turned and shifted as a whole: the pose found is the pose turned and shifted."""
    rows = cell_rows()
    frame = oracles.compose(HOME, [0.7, -1.1, 2.0], [500.0, -800.0, 300.0])
    turn = oracles.matrix_of_quaternion(frame[3:])
    other = rows.copy()
    other[:, :3] = rows[:, :3] @ turn.T + frame[:3]
    other[:, 3:6] = rows[:, 3:6] @ turn.T
    truth = random_pose(np.random.default_rng(3), 100.0, 0.1)
    targets = cable.span_lengths(rows, truth[None])[0]
    _, _, _, here = screw.solve_pose(rows, targets, HOME)
    _, _, _, there = screw.solve_pose(other, targets, frame)
    expected = np.r_[turn @ here[:3] + frame[:3], (Rotation.from_matrix(turn) * Rotation.from_quat(here[3:])).as_quat()]
    away, angle = poses_apart(there, expected)
    assert away < 1e-8
    assert angle < 1e-11


@pytest.mark.parametrize("targets", [np.full(6, 1e15), np.full(6, -1000.0), np.full(6, np.nan), np.full(6, np.inf), np.zeros(6)])
def test_impossible_lengths_are_no_pose(targets: FloatArray) -> None:
    assert screw.solve_pose(cell_rows(), targets, HOME)[0] != Status.OK


# --- runs --------------------------------------------------------------------------------------------------------------------------


def motion(n: int = 400) -> FloatArray:
    """(n, 7) poses of a smooth motion that begins at HOME."""
    t = np.linspace(0, 2 * math.pi, n)
    shift = np.column_stack([150 * np.sin(t), 100 * np.sin(2 * t), 80 * (1 - np.cos(t))])
    turn = np.column_stack([0.2 * np.sin(2 * t), 0.15 * np.sin(t), 0.2 * np.sin(3 * t)])
    return np.array([oracles.compose(HOME, w, v) for w, v in zip(turn, shift, strict=True)])


def worst_apart(a: FloatArray, b: FloatArray) -> tuple[float, float]:
    apart = [poses_apart(x, y) for x, y in zip(a, b, strict=True)]
    return max(x for x, _ in apart), max(y for _, y in apart)


def test_lengths_of_a_rig_of_hundreds_of_metres_are_met_as_far_as_they_are_rounded() -> None:
    rows, start = cell_rows(), HOME.copy()
    for place in (ATTACHMENT, BASE):
        rows[:, place : place + 3] *= 300.0
    start[:3] *= 300.0
    changes = np.random.default_rng(5).uniform(-8.0, 8.0, (20, 6))
    poses, residual, iterations, status, _ = track(rows, start, changes, np.zeros(20, np.int64), U)
    assert (status == Status.OK).all()
    assert screw.TOLERANCE_MM < residual.max() < 1e-9
    assert iterations.max() <= 8
    np.testing.assert_allclose(span_lengths(rows, poses) - span_lengths(rows, start[None]), changes, atol=1e-8)


def test_a_run_begins_anywhere_and_goes_on_behind_gaps() -> None:
    rows, truth = cell_rows(), motion()
    changes = changes_of(truth, rows)
    flags = np.zeros(400, np.int64)
    flags[100:250] = Status.GAP
    flags[300:310] = Status.JUMP
    changes[100:250] = np.nan
    poses, residual, _, status, angle = track(rows, HOME, changes, flags, U)
    assert (status == flags).all()
    assert np.isnan(poses[flags != 0]).all()
    assert np.isnan(residual[flags != 0]).all()
    assert np.isnan(angle[flags != 0]).all()
    away, turn = worst_apart(poses[flags == 0], truth[flags == 0])
    assert away < 1e-8
    assert turn < 1e-11
    # the first sample need not be at the start: here it is 150 samples into the motion
    late, _, _, status, _ = track(rows, HOME, changes[260:], flags[260:], U)
    assert (status == flags[260:]).all()
    assert worst_apart(late[flags[260:] == 0], truth[260:][flags[260:] == 0])[0] < 1e-8


def test_lengths_that_no_pose_has_are_said_and_the_rest_is_followed() -> None:
    rows, truth = cell_rows(), motion()
    changes = changes_of(truth, rows)
    changes[200] += [4000, -900, 3000, -900, 0, 5000]
    changes[220] = np.nan
    changes[240] = 1e300
    poses, _, _, status, _ = track(rows, HOME, changes, np.zeros(400, np.int64), U)
    bad = np.zeros(400, np.bool_)
    bad[[200, 220, 240]] = True
    assert (status[bad] != Status.OK).all()
    assert np.isnan(poses[bad]).all()
    assert (status[~bad] == Status.OK).all()
    assert worst_apart(poses[~bad], truth[~bad])[0] < 1e-8


def test_a_rig_that_cannot_tell_the_pose_is_singular() -> None:
    """All cables through one line of attachment points: the turn about it moves no cable."""
    rows = cell_rows()
    rows[:, 7:10] = [[x, 0, 0] for x in (-100, -60, -20, 20, 60, 100)]
    poses, _, _, status, _ = track(rows, HOME, np.zeros((3, 6)) + 0.1, np.zeros(3, np.int64), U)
    assert (status == Status.SINGULAR).all()
    assert np.isnan(poses).all()
    # at the start itself, where no step has to be made
    assert track(rows, HOME, np.zeros((2, 6)), np.zeros(2, np.int64), U)[3].tolist() == [Status.SINGULAR, Status.SINGULAR]


def test_far_cables_along_the_edges_of_a_box_have_no_pressure_angles() -> None:
    """Three hold it from above, two at one side, one in front: each moves its own point along itself, at any size of the tool."""
    ends = np.array([[100.0, 0, 0], [-100, 60, 0], [-100, -60, 0], [80, 0, 0], [-80, 0, 0], [0, 0, 0]])
    ways = np.array([[0.0, 0, 1]] * 3 + [[0.0, 1, 0]] * 2 + [[1.0, 0, 0]])
    for part in (1.0, 1e-3):
        rows = np.array([straight_row(part * p + 2e3 * e, part * p) for p, e in zip(ends, ways, strict=True)])
        assert angles_at(rows, np.tile(HOME, (3, 1))) == pytest.approx(np.zeros((3, 6)), abs=1e-6)
        assert track(rows, HOME, np.zeros((1, 6)), np.zeros(1, np.int64), U)[4] == pytest.approx(0.0, abs=1e-6)


def test_behind_a_gap_the_straight_way_of_the_lengths_is_gone() -> None:
    """Half a metre at once: what is found is where small steps of the lengths lead. One step would miss some of these ends."""
    rows, g = cell_rows(), np.random.default_rng(1)
    agree = 0
    for _ in range(24):
        begin, end = (changes_of(random_pose(g, 300.0, 0.6)[None], rows)[0] for _ in range(2))
        slowly = np.concatenate(
            [begin * np.linspace(0.0, 1.0, 101)[1:, None], begin + (end - begin) * np.linspace(0.0, 1.0, 101)[1:, None]]
        )
        poses, _, _, status, _ = track(rows, HOME, slowly, np.zeros(200, np.int64), U)
        if (status == Status.OK).all():
            found, _, iterations, status, _ = track(rows, HOME, slowly[[99, 199]], np.zeros(2, np.int64), U)
            if (status != Status.OK).any():  # said, at least
                continue
            assert max(worst_apart(found, poses[[99, 199]])) < 1e-8
            assert (iterations > 0).all()
            agree += 1
    assert agree >= 8


def test_what_is_found_leaves_no_more_than_the_tolerance_of_its_lengths() -> None:
    """Of a rig of a metre or two, whichever step comes last."""
    rows, g = cell_rows(), np.random.default_rng(7)
    changes = g.uniform(-9.0, 9.0, (300, 6))
    poses, residual, iterations, status, _ = track(rows, HOME, changes, np.zeros(300, np.int64), U)
    assert (status == Status.OK).all()
    assert residual.max() <= 1e-11
    assert (iterations > 0).all()
    np.testing.assert_allclose(changes_of(poses, rows), changes, rtol=0, atol=2e-11)


def test_the_other_assembly_is_never_given() -> None:
    """Legs from a plane: the mirrored platform has the same lengths. A motion through the plane must not come back as either."""
    table = legs(SIX_LEGS)
    table[:, :3] *= 200
    table[:, 7:10] *= 200
    base = table.copy()
    base[:, 2] = -400  # all fixed points in one plane
    base[:, 0] = [0, -400, 300, 500, 700, -400]
    base[:, 1] = [500, 200, 400, -300, 100, -200]
    heights = np.linspace(0, -800, 400)  # the platform goes through the plane of the fixed points, where the legs lie flat
    truth = np.column_stack([np.zeros((400, 2)), heights, np.zeros((400, 3)), np.ones(400)])
    poses, _, _, status, _ = track(base, HOME, changes_of(truth, base), np.zeros(400, np.int64), U)
    good = status == Status.OK
    assert good[:150].all()
    assert not good[-150:].any()
    assert set(status[~good]) <= {Status.SINGULAR, Status.OTHER_ASSEMBLY, Status.NOT_CONVERGED}
    assert worst_apart(poses[good], truth[good])[0] < 1e-3


def test_near_a_singular_pose_and_back_nothing_is_lost() -> None:
    """Beyond 80 degrees of pressure angle a slow motion that turns back in time is followed to its end; nearer it is lost."""
    rows = cell_rows()
    angle = singular_angle(rows)
    for nearest, followed in ((0.03, True), (1e-6, False)):
        way = np.concatenate([np.linspace(0.0, angle - nearest, 800), np.linspace(angle - nearest, 0.3, 200)])
        truth = turned(way)
        poses, _, _, status, angles = track(rows, HOME, changes_of(truth, rows), np.zeros(1000, np.int64), U)
        assert (status == Status.OK).all() == followed
        if followed:
            assert np.degrees(angles.max()) > 80.5
            assert worst_apart(poses, truth)[0] < 1e-6
        else:
            # until the next run all is refused, though it comes back to where it was sound
            assert (status[-100:] == Status.OTHER_ASSEMBLY).all()


@pytest.mark.parametrize("seed", range(4))
def test_three_standard_uncertainties_from_a_singular_pose(seed: int) -> None:
    """Lengths uncertain by u along the column of the inverse that moves the tool most: with a little less the determinant keeps its sign
    within three standard uncertainties of the pose, with a little more it does not."""
    rows, g = cell_rows(), np.random.default_rng(seed)
    if seed % 2:
        rows[[0, 3]] = rows[[3, 0]]  # the other sign
    pose, size = turned(np.array([singular_angle(rows) - 0.005]))[0], screw.platform_size(rows)
    side, inverse = np.linalg.det(cable.span_rows(rows, pose)), np.linalg.inv(cable.span_rows(rows, pose))
    u = g.uniform(0.2, 1.0, 6)
    moved = np.linalg.norm(inverse * np.repeat([[size], [1.0]], 3, axis=0), axis=0) * u  # mm
    worst = int(np.argmax(moved))
    twist = inverse[:, worst] * u[worst] * np.sqrt((moved**2).sum()) / moved[worst]

    def turns(scale: float) -> bool:
        probes = se3.displaced(np.tile(pose, (2, 1)), np.outer([3.0 * scale, -3.0 * scale], twist))
        return any(np.linalg.det(cable.span_rows(rows, probe)) * side < 0.0 for probe in probes)

    beyond = next(scale for scale in np.geomspace(1e-3, 1e3, 200) if turns(scale))
    limit = scipy.optimize.bisect(lambda scale: turns(scale) - 0.5, 0.9 * beyond, beyond, xtol=1e-4 * beyond)
    assert 3.0 * limit * np.linalg.norm(twist[:3]) < screw.MAX_STEP_ROTATION
    for part, sees in ((0.98, False), (1.02, True)):
        work = np.empty(7), np.empty((6, 6)), inverse.copy(), size
        assert screw._could_turn(rows, pose, part * limit * u, side, *work) == sees


def test_a_step_turns_and_moves_by_its_twist_and_no_farther_than_a_step_may() -> None:
    """By the matrix exponential of the twist, shortened as a whole where it turns too far."""
    g = np.random.default_rng(4)
    for turn in (0.1, 0.9 * screw.MAX_STEP_ROTATION, 1.1 * screw.MAX_STEP_ROTATION, 5.0):
        omega, v = g.normal(size=3), g.uniform(-90.0, 90.0, 3)
        omega *= turn / np.linalg.norm(omega)
        pose, size = random_pose(g), 170.0
        moved = pose.copy()
        screw.displace(moved, np.concatenate([size * omega, v]), size)
        part = min(1.0, screw.MAX_STEP_ROTATION / turn)
        x, y, z = part * omega
        twist = np.zeros((4, 4))
        twist[:3] = np.array([[0.0, -z, y, part * v[0]], [z, 0.0, -x, part * v[1]], [-y, x, 0.0, part * v[2]]])
        motion = scipy.linalg.expm(twist)
        assert moved[:3] == pytest.approx(pose[:3] + motion[:3, 3], abs=1e-9)
        found = Rotation.from_quat(moved[3:]).as_matrix()
        np.testing.assert_allclose(found, motion[:3, :3] @ Rotation.from_quat(pose[3:]).as_matrix(), atol=1e-12)
        assert np.linalg.norm(moved[3:]) == pytest.approx(1.0, abs=1e-15)


@pytest.mark.parametrize("steps", [1.0, 2.0])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_pose_goes_on_as_it_went(steps: float, sign: float) -> None:
    """Shifted and turned about an axis evenly, whichever of both quaternions its last pose has."""
    axis, begun = np.array([2.0, -1.0, 2.0]) / 3.0, Rotation.from_rotvec([0.4, -0.9, 0.3])

    def at(t: float) -> FloatArray:
        return np.r_[100.0 + 3.0 * t, -50.0, 20.0 - t, (Rotation.from_rotvec(1e-3 * t * axis) * begun).as_quat()]

    pose, behind = at(1.0), at(0.0)
    behind[3:] *= sign
    screw.go_on(behind, pose, steps)
    assert np.linalg.norm(pose[3:]) == pytest.approx(1.0, abs=1e-14)
    assert poses_apart(pose, at(1.0 + steps)) == pytest.approx((0.0, 0.0), abs=1e-8)


def test_many_poses_are_those_of_one_by_one_and_say_which_are_none() -> None:
    rows = cell_rows()
    starts = np.array([HOME, HOME, HOME])
    targets = cable.span_lengths(rows, HOME[None])[0] + [1.0, -2.0, 0.5, 1.5, -1.0, 0.0]
    starts[1, 0] = np.nan
    status, poses = screw.solve_poses(rows, targets, starts)
    assert status.tolist() == [Status.OK, Status.NOT_CONVERGED, Status.OK]
    np.testing.assert_array_equal(poses[0], screw.solve_pose(rows, targets, HOME)[3])
    np.testing.assert_allclose(cable.span_lengths(rows, poses[[2]])[0], targets, atol=1e-9)
