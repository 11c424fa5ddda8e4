"""The coarse solve against the thesis' data recomputed independently, and against drawn truths."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.calibration.solve.points import coarse_solutions
from lmeasure.core import rotation_from_angles

# Thesis Rashoyan 2021, 5.5: centre of the flange [mm], A, Theta, T [deg], counts K1..K3, attachment points.
CENTRE = np.array([[84.63, -838.03, 298.41], [107.66, -615.09, 480.59], [361.59, -640.03, 479.72], [361.50, -159.72, 479.53]])
A_THETA_T = np.array([[-13.068, -62.770, 93.966], [0.143, -46.653, 84.315], [-1.939, -45.269, 95.879], [-1.939, -45.264, 95.861]])
COUNTS = np.array([[0, 0, 0], [1610, -6609, 175], [1165, -3355, 2059], [32050, 19885, 16715]], dtype=float)
ATTACHMENT = {"P1": [14.58, -14.58, 5.75], "P2": [14.58, 14.58, 5.65], "P3": [-14.58, 14.58, 5.65]}

# The exact roots of (5.6) with a large first length, recomputed from the printed data by a program that shares nothing with this one:
# (channel, attachment point, factor on the counts) -> B [mm], first length [mm] where it was kept.
PUBLISHED = [
    (0, "P1", 1, (132.580, -1896.547, 1655.774), 1720.555),
    (0, "P2", 1, (141.635, -2111.024, 1870.078), None),
    (0, "P3", 1, (132.869, -2424.591, 2148.678), None),
    (1, "P1", 1, (8.818, -1150.928, 1413.946), 1167.829),
    (1, "P2", 1, (1.176, -1189.530, 1503.754), None),
    (1, "P3", 1, (-24.944, -1251.103, 1622.503), None),
    (2, "P1", 2, (-94.133, -1524.768, 1374.680), 1289.697),
    (2, "P2", 2, (-125.442, -1653.551, 1527.016), None),
    (2, "P3", 2, (-195.895, -1853.847, 1729.023), None),
    (2, "P1", 1, (218.91, -580.49, 145.97), 337.0),
]
REFINED = np.array([[159.05, -1642.2, 1381.81], [2.05445, -1119.8, 1390.15], [-90.52, -1526.8, 1358.21]])


def points_of(attachment: str) -> np.ndarray:
    rotation = rotation_from_angles("puma-oat", A_THETA_T[:, [1, 0, 2]])
    return np.asarray(CENTRE + rotation.apply(ATTACHMENT[attachment]))


def test_flange_point_at_the_published_poses() -> None:
    expected = [
        [84.0448, -855.8232, 286.5240],
        [112.4748, -628.5098, 464.6231],
        [368.4529, -655.7486, 466.9121],
        [368.3612, -175.4352, 466.7171],
    ]
    np.testing.assert_allclose(points_of("P1"), expected, atol=6e-5)  # printed to four decimals


@pytest.mark.parametrize(("channel", "attachment", "factor", "position", "length"), PUBLISHED)
def test_published_rig(channel: int, attachment: str, factor: int, position: tuple[float, ...], length: float | None) -> None:
    change = COUNTS[:, channel] * 0.012 * factor
    found = coarse_solutions(points_of(attachment), change, 0, np.array(position))
    assert found[0].physical
    digits = 6e-4 if length != 337.0 else 6e-3  # as many decimals as were kept
    np.testing.assert_allclose(found[0].position, position, atol=digits)
    if length is not None:
        assert found[0].first_length == pytest.approx(length, abs=0.5 if length == 337.0 else 1e-3)


def test_both_roots_are_roots() -> None:
    points, change = points_of("P1"), COUNTS[:, 0] * 0.012
    found = coarse_solutions(points, change, 0, REFINED[0])
    assert len(found) == 2
    for root in found:
        np.testing.assert_allclose(np.linalg.norm(root.position - points, axis=1), root.first_length + change, atol=1e-9)


def test_the_nearer_root_is_chosen() -> None:
    points, change = points_of("P1"), COUNTS[:, 0] * 0.012
    first, second = coarse_solutions(points, change, 0, REFINED[0])
    again = coarse_solutions(points, change, 0, second.position)
    np.testing.assert_array_equal(again[0].position, second.position)
    np.testing.assert_array_equal(again[1].position, first.position)


def test_reversed_counts_keep_the_point_and_turn_the_length_over() -> None:
    points, change = points_of("P1"), COUNTS[:, 1] * 0.012
    turned = coarse_solutions(points, -change, 0, REFINED[1])
    place = np.array([r.position for r in turned])
    for root in coarse_solutions(points, change, 0, REFINED[1]):
        i = int(np.argmin(np.linalg.norm(place - root.position, axis=1)))
        np.testing.assert_allclose(place[i], root.position, atol=1e-8)
        assert turned[i].first_length == pytest.approx(-root.first_length)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(4, 12))
def test_exact_straight_cables_are_found(seed: int, poses: int) -> None:
    rng = np.random.default_rng(seed)
    base = rng.normal(size=3)
    base *= rng.uniform(1200, 2500) / np.linalg.norm(base)
    points = rng.uniform(-400, 400, (poses, 3))
    length = np.linalg.norm(points - base, axis=1)
    found = coarse_solutions(points, length - length[0], 0, base)
    # four random points may be nearly in a plane: as many digits are lost as their spread is flat
    spread = np.linalg.svd(points[1:] - points[0], compute_uv=False)
    assert found[0].physical
    assert np.linalg.norm(found[0].position - base) < 1e-8 * (spread[0] / spread[2]) ** 2 * 1e3


def test_poses_in_a_plane_have_no_coarse_solution() -> None:
    rng = np.random.default_rng(1)
    points = np.column_stack([rng.uniform(-1, 1, (6, 2)) * 300, np.zeros(6)])
    assert coarse_solutions(points, rng.normal(size=6), 0, np.zeros(3)) == []
    assert coarse_solutions(points[:3], rng.normal(size=3), 0, np.zeros(3)) == []
