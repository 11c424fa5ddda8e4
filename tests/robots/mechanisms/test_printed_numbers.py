"""Numbers of the documents that tests of the mechanisms' own modules do not look at; each by its section in the sources, slips named."""

from itertools import permutations, product

import numpy as np
import pytest
from mechanism_tables import TABLE_1, TABLE_2, TABLE_3, TABLE_4, poses
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from lmeasure.core import se3
from lmeasure.robots.parallel.mechanisms import dyads, legs, virtual_points
from lmeasure.robots.parallel.mechanisms.crank import CrankPlatform
from lmeasure.robots.parallel.mechanisms.four_chains import FourChains
from lmeasure.robots.parallel.mechanisms.rotopod import Rotopod
from lmeasure.robots.parallel.mechanisms.seven_link import SevenLink, coordinates_of, pose_of

LEVEL = np.array([0.0, 0.0, 0.0, 1.0])


def test_vectors_of_the_hooke_joints() -> None:
    """Thesis 5.8, of B (-0.1475, -0.49, 0.793): axes along the leg and of both crosses, turned by 20 degrees about Z; E5 has the other sign
    in print."""
    low, high, turn = np.array([-0.46, -0.421, 0.0]), np.array([-0.1475, -0.49, 0.793]), Rotation.from_rotvec([0, 0, np.radians(20.0)])
    a, b = 0.9 * low + 0.1 * high, 0.1 * low + 0.9 * high
    assert high[0] - low[0] == pytest.approx(0.312, abs=6e-4)
    e2 = -np.array([b[0], b[1], 0.0])
    assert np.cross(b - a, e2)[2] == pytest.approx(0.131, abs=6e-4)
    np.testing.assert_allclose(turn.apply(high), [0.0285, -0.511, 0.793], atol=6e-4)
    upper = turn.apply(b)
    np.testing.assert_allclose(upper, [-0.0027, -0.515, 0.714], atol=6e-4)
    e4, e6 = upper - a, -np.array([upper[0], upper[1], 0.0])
    np.testing.assert_allclose(e4, [0.426, -0.087, 0.634], atol=6e-4)
    e3, e5 = np.cross(e4, e2), np.cross(e4, e6)
    np.testing.assert_allclose(e3, [-0.307, 0.113, 0.221], atol=1e-3)
    np.testing.assert_allclose(e5, [-0.327, 0.0017, 0.22], atol=1e-3)
    np.testing.assert_allclose(e5, -np.array([0.327, -0.0017, -0.22]), atol=1e-3)
    assert np.degrees(np.arctan2(np.linalg.norm(np.cross(e2, e6)), e2 @ e6)) == pytest.approx(20.0, abs=1e-9)
    assert np.degrees(np.arctan2(np.linalg.norm(np.cross(e3, e5)), e3 @ e5)) == pytest.approx(16.555, abs=0.01)


def test_the_rotopod_to_all_digits() -> None:
    """002, 4.1: carriages, the whole matrix, its condition; the text's rule of elbows is the reverse, and r = 0.95 gives q1 = 5.508."""
    made, pose = Rotopod.of_triangle(1024.0, 87.0, 1019.8, 980.0), np.array([0.0, 0.0, 700.0, *LEVEL])
    q = made.inverse(pose)
    np.testing.assert_allclose(q, [5.5294, 0.7538, 1.3406, 2.8482, 3.4350, 4.9426], atol=6e-5)
    # the derivative printed in metres has 0.0435 sqrt(3) - 1.024, and the hinge's x by z is 0.9487
    assert made.points[0, 0] / 1000.0 == pytest.approx(1.024 - 0.0435 * np.sqrt(3.0), abs=1e-12)
    assert made.points[0, 0] / 1000.0 == pytest.approx(1.328 / 1.4, abs=1e-4)
    other = Rotopod.of_triangle(950.0, 87.0, 1019.8, 980.0)
    assert other.points[0, 0] == pytest.approx(874.6, abs=0.1)
    assert other.inverse(pose)[0] == pytest.approx(5.5081, abs=1e-4)
    reverse = Rotopod(made.points, made.ring, made.rod, -made.sides).inverse(pose)
    assert np.abs(np.sin(0.5 * (reverse - q))).min() > 0.2
    found = legs.jacobians(made, pose, q)
    rows = 2.0 * 980.0 * found.output / ([1e6] * 3 + [1e3] * 3)
    exact = [
        [-0.0609, -1.3281, 1.2596, 0.4103, 1.3089, 1.4],
        [0.0609, -1.3281, -1.2596, 0.4103, -1.3089, 1.4],
        [1.1806, 0.6113, 1.2596, -1.3387, -0.2992, 1.4],
        [1.1197, 0.7168, -1.2596, 0.9284, 1.0098, 1.4],
        [-1.1197, 0.7168, 1.2596, 0.9284, -1.0098, 1.4],
        [-1.1806, 0.6113, -1.2596, -1.3387, 0.2992, 1.4],
    ]
    np.testing.assert_allclose(rows, exact, atol=6e-5)
    assert np.linalg.cond(rows) == pytest.approx(1.70, abs=5e-3)
    drives = np.diag(2.0 * 980.0 * found.drives / 1e6)
    first = np.array([-1.259, 1.260, -1.863, -1.478, -1.864, 1.259])
    assert (np.flatnonzero(np.abs(drives - first) > 2e-3) + 1).tolist() == [3, 4, 5]


def test_the_four_chains_to_all_digits() -> None:
    """002, 4.2: the plain rods are 0.8461 long (1 is stated); one entry of A; the printed right side in the printed diagonal's order."""
    points = 1000.0 * np.array([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [-1.0, -2.0, 0.0], [1.0, -2.0, 0.0]])
    pose = np.array([0.0, 0.0, 172.0, *LEVEL])
    made = FourChains(points, 3000.0, 1000.0 * float(np.hypot(np.sqrt(8.0) - 2.0, 0.172)))
    assert made.rod == pytest.approx(846.1, abs=0.05)
    q = made.inverse(pose)
    np.testing.assert_allclose(q[:4], [1.1071, 2.0344, 4.3726, 5.0522], atol=6e-5)
    np.testing.assert_allclose(q[4:], 783.1, atol=0.06)
    # carriages straight beyond their hinges
    np.testing.assert_allclose(
        3.0 * np.column_stack([np.cos(q[2:4]), np.sin(q[2:4])]), [[-1.0, -np.sqrt(8.0)], [1.0, -np.sqrt(8.0)]], atol=1e-9
    )
    longer = [FourChains(points, 3000.0, 1000.0, sides=sides).inverse(pose)[2:4] for sides in ((1.0, 1.0), (-1.0, -1.0))]
    np.testing.assert_allclose(np.sort(np.transpose(longer), axis=1), [[4.0080, 4.4895], [4.9353, 5.4168]], atol=6e-5)
    found = made.jacobians(pose, q)
    scale = np.array([*(-1.0 / (np.sin(q[:2]) * np.cos(q[:2]))), *(2e-3 * q[4:]), *[2e-3 * made.rod] * 2])
    rows = (scale[:, None] * found.output * ([1e-3] * 3 + [1.0] * 3))[[2, 3, 4, 5, 0, 1]]
    assert rows[0, 1] == pytest.approx(-0.344, abs=6e-4)  # printed -0.688
    by = np.abs((scale[:, None] * found.drives)[[2, 3, 4, 5, 0, 1]] * ([1e-3] * 4 + [1.0] * 2)).max(axis=1)
    np.testing.assert_allclose(by, [1.5661, 1.5661, 1.6569, 1.6569, 5.5902, 5.5902], atol=6e-5)
    # of rods: 2 R times what is printed without R
    np.testing.assert_allclose(by[2:4] / 3.0, 0.5523, atol=6e-5)
    signed = (scale[:, None] * found.drives)[[2, 3, 4, 5, 0, 1]][np.arange(6), [4, 5, 2, 3, 0, 1]] * [1.0, 1.0, *[1e-3] * 4]

    def rates(right: list[float]) -> np.ndarray:
        return np.linalg.solve(rows, -signed * right)

    np.testing.assert_allclose(rates([0.0, 0.0, 0.1, 0.1, 0.1, 0.1]), [0, 0, 0.1, 0, 0, 0], atol=1e-12)
    assert np.abs(rates([0.1, 0.1, 0.1, 0.1, 0.0, 0.0]) - [0, 0, 0.1, 0, 0, 0]).max() > 0.05


def test_the_wrenches_of_chapter_5_to_all_digits() -> None:
    """002, 5.1: all rows; lengths of chains 1 and 3; moments are those of unit vectors; a sign of row four makes -3.945 of -8.0649."""
    points = 1000.0 * np.array([[1.0, 2.0, 0.0], [-1.0, 2.0, 0.0], [-1.0, -2.0, 0.0], [1.0, -2.0, 0.0]])
    made, pose = FourChains(points, 3000.0, 1000.0 * float(np.hypot(np.sqrt(8.0) - 2.0, 1.0))), np.array([0.0, 0.0, 1000.0, *LEVEL])
    drives = made.inverse(pose)
    assert made.rod / 1e3 == pytest.approx(1.2986, abs=6e-5)
    assert drives[4] / 1e3 == pytest.approx(1.2584, abs=6e-5)  # printed 1.259
    output = made.jacobians(pose, drives).output
    force = output[:, 3:]
    right = np.hstack([force, output[:, :3] / 1e3 + np.cross([0, 0, 1.0], force)])
    exact = np.array(
        [
            [0.0, 0.6380, 0.7701, -2.1781, 0.7701, -0.6380],
            [0.0, 0.6380, 0.7701, -2.1781, -0.7701, 0.6380],
            [-0.2715, -0.5430, 0.7947, 2.1323, -1.0661, 0.0],
            [0.8944, -0.4472, 0.0, 0.4472, 0.8944, -2.2361],
            [0.2715, -0.5430, 0.7947, 2.1323, 1.0661, 0.0],
            [0.8944, 0.4472, 0.0, -0.4472, 0.8944, -2.2361],
        ]
    )
    for row in exact:
        # each is one of the mechanism's wrenches, up to which end of the guide it points to
        assert min(np.abs(sign * own - row).max() for own in right for sign in (1.0, -1.0)) < 6e-5
    assert np.linalg.det(exact) == pytest.approx(-8.0649, abs=2e-3)
    # as printed, the last entry of row four with the other sign and all to three digits
    slipped = exact.copy()
    slipped[3, 5] *= -1.0
    assert np.linalg.det(slipped) == pytest.approx(-3.945, abs=0.04)
    np.testing.assert_allclose(np.cross([1, 2, 1], np.array([2, -1, 0]) / np.sqrt(5.0)), [0.4472, 0.8944, -2.2361], atol=6e-5)


def test_the_elevation_that_is_printed_for_the_angle_to_the_normal() -> None:
    """002, 3.1: 90 degrees less arccos(z / L) is the rod's elevation; of 11 degrees it stands at 0.187 m, where no carriages stand."""
    assert 0.98 * np.sin(np.radians(11.0)) == pytest.approx(0.187, abs=5e-4)
    made = Rotopod.of_triangle(1024.0, 87.0, 1019.8, 980.0)
    low = np.array([0.0, 0.0, 187.0, *LEVEL])
    gaps = np.degrees(np.mod(np.roll(made.inverse(low), -1) - made.inverse(low), 2.0 * np.pi))
    assert gaps.min() < 12.0 or gaps.max() > 120.0


def fixture(pair: float = 100.0, height: float = 200.0, base: float = 20.0) -> CrankPlatform:
    return CrankPlatform.regular(300.0, 200.0, np.radians(base), np.radians(pair), crank_mm=50.0, height_mm=height)


def test_the_frame_of_virtual_points() -> None:
    """003: W1 from the centre is x, the triangle's normal z, their product y; its normal by the printed determinants, and b6 and C3, which
    are missing in print."""
    made, drives = fixture(), np.radians([12.0, -17.0, 25.0])
    pose = virtual_points.forward(made, drives[None], made.home).poses[0]
    w = virtual_points.corners_at(made, pose)
    x, z = w[0] - w.mean(axis=0), np.cross(w[1] - w[0], w[2] - w[0])
    (_, y1, z1), (_, y2, z2), (_, y3, z3) = w
    assert z[0] == pytest.approx((y2 - y1) * (z3 - z1) - (z2 - z1) * (y3 - y1), rel=1e-12)
    x, z = x / np.linalg.norm(x), z / np.linalg.norm(z)
    np.testing.assert_allclose(se3.matrices(pose), np.column_stack([x, np.cross(z, x), z]), atol=1e-12)
    k = virtual_points.side_and_part(200.0, np.radians(100.0))[1]
    upper = legs.uppers(made, pose)
    np.testing.assert_allclose(upper[5], w[2] + k * (w[0] - w[2]), atol=1e-9)
    third = Rotation.from_rotvec([0, 0, np.radians(240.0)]).apply([300.0, 50.0 * np.sin(drives[2]), 50.0 * np.cos(drives[2])])
    np.testing.assert_allclose(made.legs(drives).ends[4], third, atol=1e-9)
    assert np.linalg.norm(upper[4] - third) == pytest.approx(246.119, abs=6e-4)


def test_platforms_that_do_not_keep_their_root() -> None:
    """003: nearly upright rods pass a dead point 18 degrees from upright; narrow pairs over each other leave no pose at large angles."""
    upright, f = fixture(pair=90.0, height=300.0, base=30.0), np.radians(np.arange(0.0, -30.1, -0.25))
    drives = np.outer(f, [1.0, -1.0, 0.0])
    way = legs.followed(upright, drives, upright.home)
    sides = upright.sides(way.poses, drives)
    first = int(np.argmax((sides != sides[0]).any(axis=1)))
    assert np.degrees(f[first]) == pytest.approx(-18.0, abs=0.6)
    narrow = fixture(pair=20.0, base=30.0)
    found = legs.forward(narrow, np.radians([[5.0, 5.0, 5.0], [-30.0, 30.0, 30.0]]), narrow.home).found
    assert found.tolist() == [True, False]


def test_turns_of_table_3() -> None:
    """004: what table 1 began with is off by these; the turn that fits table 2 best is table 3's; no other order of the axes fits it."""
    off = [0.041, 0.072, 0.089, 0.087, 0.071, 0.044, 0.017, -0.006, -0.018, -0.019]
    np.testing.assert_allclose(TABLE_1[:, 5] - TABLE_3, off, atol=6e-4)

    def turn(phi: np.ndarray, i: int) -> np.ndarray:
        at = pose_of(np.array([*TABLE_1[i, :3], *np.radians(TABLE_1[i, 3:5]), np.radians(phi[0])]))
        return dyads.misses(at[None], TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6])[0]

    best = np.array([least_squares(turn, TABLE_3[i : i + 1], args=(i,), xtol=1e-14, ftol=1e-14).x[0] for i in range(10)])
    assert np.abs(best - TABLE_3).max() < 0.0095
    # the next best order of the axes, signs and angles is off by 0.322 with the turns of table 1, by 0.327 with those of table 3
    for turns, right, next_best in ((TABLE_3, 0.0024, 0.327), (TABLE_1[:, 5], 0.0071, 0.322)):
        spread = spreads(np.column_stack([TABLE_1[:, 3:5], turns]))
        assert len(spread) == 12 * 6 * 8 * 2
        # about the body's axes one after the other, or about the base's from the last to the first: the same turn
        for same in (("ZXZ", (0, 1, 2)), ("zxz", (2, 1, 0))):
            assert spread.pop((*same, (1.0, 1.0, 1.0))) == pytest.approx(right, abs=6e-5)
        assert min(spread.values()) == pytest.approx(next_best, abs=5e-4)


def spreads(angles: np.ndarray) -> dict[tuple[str, tuple[int, ...], tuple[float, ...]], float]:
    """By axes, order and signs of angles (10, 3) [deg]: by how much the lengths that the links of table 2 would need differ, together."""
    out = {}
    for axes, order in product(product("xyz", repeat=3), permutations(range(3))):
        if axes[0] == axes[1] or axes[1] == axes[2]:
            continue
        for signs, name in product(product((1.0, -1.0), repeat=3), ("".join(axes), "".join(axes).upper())):
            at = se3.pose(TABLE_1[:, :3], Rotation.from_euler(name, np.radians(np.array(signs) * angles[:, order])))
            misses = dyads.misses(at, TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6])
            out[name, order, signs] = float(misses.std(axis=0).sum())
    return out


def test_table_4_from_the_turns_of_table_3() -> None:
    """004: with phi held, of table 2 as printed, the other five coordinates come out to 0.0004 to 0.002, but to 0.012 and 0.007 at poses 5
    and 6, where phi stands still along the path: so far as that of pose 6 the path never turns."""
    link, begin = SevenLink(TABLE_2[:, :3], TABLE_2[:, 3:6], TABLE_2[:, 6]), coordinates_of(poses(TABLE_3))
    off, left = [], []
    for row, stated in zip(begin, TABLE_4, strict=True):

        def lacks(x: np.ndarray, phi: float = float(row[5])) -> np.ndarray:
            return link.residuals(pose_of(np.array([*x, phi])))

        found = least_squares(lacks, row[:5], xtol=1e-15, ftol=1e-15, gtol=1e-15)
        left.append(float(np.abs(found.fun).max()))
        off.append(float(np.linalg.norm(found.x[:3] - stated)))
    assert (np.flatnonzero(np.array(left) > 1e-9) + 1).tolist() == [6]
    others = np.delete(off, [4, 5])
    assert [others.min(), others.max()] == pytest.approx([0.0004, 0.0019], abs=6e-5)
    assert off[4:6] == pytest.approx([0.012, 0.0072], abs=6e-5)


def test_synthesis_again_with_the_turns_of_table_3_and_with_free_ones() -> None:
    """004: largest misses by least squares from table 2, link by link with phi held, all together with phi free."""
    held = [np.abs(dyads.fitted(poses(TABLE_3), row[:3], row[3:6]).misses).max() for row in TABLE_2]
    np.testing.assert_allclose(held, [0.00053, 0.00039, 0.00148, 0.00041, 0.00057], atol=6e-5)

    def all_misses(x: np.ndarray) -> np.ndarray:
        links = x[:35].reshape(5, 7)
        return dyads.misses(poses(x[35:]), links[:, :3], links[:, 3:6], links[:, 6]).ravel()

    begin = np.concatenate([TABLE_2[:, :7].ravel(), TABLE_1[:, 5]])
    free = least_squares(all_misses, begin, x_scale=np.abs(begin) + 0.1, max_nfev=300).fun.reshape(10, 5)
    # in a flat valley, where turns go on to drift by degrees, each link's part is a matter of where one stops: the largest is told
    assert np.abs(free).max() < 0.00044
