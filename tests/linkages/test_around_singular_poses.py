"""What is said of a singular pose and around it, each held against a second statement of it: differences, minors, work of force screws."""

import numpy as np
import pytest
from scipy.optimize import least_squares

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import Drive, extra_drives, leading_out, lost_twists, nearest_singular, singularity
from lmeasure.linkages.singularity import Neighbourhood

UNIT = np.repeat([150.0, 1.0], 3)  # a turn counted at a rim of 150 mm, a shift


def mechanism(seed: int, *, pairs_on_a_line: int = 0, shift: float = 0.0) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points of base and body (6, 3) and a pose (7,) at random; of so many pairs of links both lie on a line, but for a shift [mm]."""
    rng = np.random.default_rng(seed)
    base, body = rng.normal(size=(6, 3)) * 500.0, rng.normal(size=(6, 3)) * 150.0
    pose = se3.displaced(np.array([70.0, -40.0, 400.0, 0.0, 0.0, 0.0, 1.0]), rng.normal(size=6) * np.repeat([0.5, 100.0], 3))
    for i in range(0, 2 * pairs_on_a_line, 2):
        body[i + 1] = body[i]
        base[i + 1] = base[i] + 0.4 * (se3.apply(pose, body[i]) - base[i]) + shift * rng.normal(size=3)
    return base, body, pose


def second_differences(base: FloatArray, body: FloatArray, pose: FloatArray, ways: FloatArray) -> FloatArray:
    """(k, k) second derivatives of the determinant along displacements (k, 6)."""

    def det(d: FloatArray) -> float:
        return float(singularity.determinants(base, body, se3.displaced(pose, d)))

    out = np.empty((len(ways), len(ways)))
    for i, a in enumerate(ways):
        for j, b in enumerate(ways):
            out[i, j] = (det(a + b) - det(a - b) - det(b - a) + det(-a - b)) / 4.0
    return out


@pytest.mark.parametrize("singular", [False, True])
def test_cofactors_of_many_matrices_are_signed_minors(singular: bool) -> None:
    M = np.random.default_rng(4).normal(size=(3, 5, 5))
    if singular:
        M[:, 4] = M[:, 0] - 2.0 * M[:, 2]
        M[1] *= -1.0  # the other sign of the determinants of both its factors
    found = singularity.cofactors(M)
    for one, C in zip(M, found, strict=True):
        minors = [[(-1.0) ** (i + j) * np.linalg.det(np.delete(np.delete(one, i, 0), j, 1)) for j in range(5)] for i in range(5)]
        np.testing.assert_allclose(C, minors, atol=1e-12)


def test_the_rim_is_the_farthest_point_from_the_middle_and_never_nothing() -> None:
    assert singularity.rim_mm(np.array([(7.0, 2.0, 3.0), (1.0, 2.0, 3.0), (4.0, 2.0, 3.0), (4.0, 6.0, 3.0)])) == pytest.approx(
        np.hypot(3.0, 1.0)
    )
    assert singularity.rim_mm(np.full((6, 3), 5.0)) == 1e-3


def test_links_hold_as_well_as_the_singular_values_of_their_rows_say() -> None:
    base, body, pose = mechanism(5)
    held = singularity.hold(base, body, pose)
    M, _, points = singularity.link_rows(base, body, pose)
    arms = points - points.mean(axis=0)
    rows = np.hstack([M[:, :3], np.cross(arms, M[:, :3]) / np.linalg.norm(arms, axis=1).max()])
    assert held.rank == 6
    assert held.condition == pytest.approx(np.linalg.norm(rows, 2) * np.linalg.norm(np.linalg.inv(rows), 2))
    assert held.mm_per_mm == pytest.approx(np.linalg.norm(np.linalg.inv(rows), 2))
    lost = singularity.hold(*mechanism(5, pairs_on_a_line=1))
    assert (lost.rank, lost.condition, lost.mm_per_mm) == (5, np.inf, np.inf)


@pytest.mark.parametrize(
    ("bend", "size_mm", "expected"),
    [
        ((0.0, 0.9e-8, 0.0, -0.5e-8, 0.0), 100.0, "plane"),
        ((0.0, 0.2e-8, 0.0, -1.1e-8, 0.0), 100.0, "surface"),
        ((0.0, 0.0, 0.0, 0.0, 0.0, 0.0), 100.0, "higher order"),
        ((0.2, 0.3, 1.1e-6, 0.4, 0.5, 1.0), 100.0, "point"),
        ((-0.2, -0.3, -1.1e-6, -0.4, -0.5, -1.0), 100.0, "point"),
        ((0.2, 0.3, 0.9e-6, 0.4, 0.5, 1.0), 100.0, "cone"),
        ((0.2, 0.3, -1.1e-6, 0.4, 0.5, 1.0), 100.0, "cone"),
    ],
)
def test_what_singular_poses_are_is_told_by_their_curvatures(bend: tuple[float, ...], size_mm: float, expected: str) -> None:
    """A curvature under a millionth of one over the size is none, one under a millionth of the largest has no sign."""
    assert Neighbourhood(np.zeros(6), np.zeros((len(bend), 6)), np.array(bend), size_mm).topology == expected


@pytest.mark.parametrize("seed", [1, 2])
def test_second_rates_are_second_differences_of_the_determinant(seed: int) -> None:
    base, body, pose = mechanism(seed)
    steps = 0.45 / UNIT * np.eye(6)
    found = singularity.second_rates(base, body, pose) * np.outer(steps.sum(axis=0), steps.sum(axis=0))
    np.testing.assert_allclose(found, second_differences(base, body, pose, steps), atol=1e-3 * np.abs(found).max())


@pytest.mark.parametrize("size_mm", [None, 260.0])
def test_around_a_singular_pose_its_surface_bends_as_is_reported(size_mm: float | None) -> None:
    base, body, pose = mechanism(3, pairs_on_a_line=1)
    found = singularity.neighbourhood(base, body, pose, size_mm)
    size = singularity.rim_mm(body) if size_mm is None else size_mm
    assert found.size_mm == size
    assert found.twists.shape == (5, 6)
    np.testing.assert_allclose(found.gradient, singularity.gradients(base, body, pose))
    # about the body's origin, turns counted at the size: what a mm along the gradient does, and across it
    across = found.twists @ se3.at_points(pose[:3]).T
    np.testing.assert_allclose((across * np.repeat([size, 1.0], 3)) @ (across * np.repeat([size, 1.0], 3)).T, np.eye(5), atol=1e-9)
    unit = np.repeat([1.0 / size, 1.0], 3) * np.eye(6)
    steep = np.linalg.norm([found.gradient @ se3.at_points(-pose[:3]) @ way for way in unit])
    step = 2e-3 * size
    bent = second_differences(base, body, pose, step * across) / step**2
    np.testing.assert_allclose(bent, -steep * np.diag(found.bend), atol=1e-3 * steep * np.abs(found.bend).max())
    assert found.topology == "surface"


@pytest.mark.parametrize("size_mm", [None, 260.0])
def test_where_the_gradient_vanishes_the_determinant_bends_as_is_reported(size_mm: float | None) -> None:
    base, body, pose = mechanism(8, pairs_on_a_line=2)
    found = singularity.neighbourhood(base, body, pose, size_mm)
    size = singularity.rim_mm(body) if size_mm is None else size_mm
    along = found.twists @ se3.at_points(pose[:3]).T
    np.testing.assert_allclose((along * np.repeat([size, 1.0], 3)) @ (along * np.repeat([size, 1.0], 3)).T, np.eye(6), atol=1e-9)
    step, unit = 2e-3 * size, np.diag(np.repeat([1.0 / size, 1.0], 3))
    scale = np.abs(second_differences(base, body, pose, step * unit)).max()
    bent = second_differences(base, body, pose, step * along)
    np.testing.assert_allclose(bent / scale, np.diag(found.bend), atol=2e-3)
    assert found.topology == "cone"


def lost_twist(base: FloatArray, body: FloatArray, pose: FloatArray) -> FloatArray:
    """(omega; v) of size one turn, that no link sees."""
    M = singularity.link_rows(base, body, pose)[0]
    null = np.linalg.svd(M)[2][5]
    return np.asarray(np.r_[null[3:], null[:3]] / np.linalg.norm(null[3:]))


@pytest.mark.parametrize("stated", [False, True])
def test_an_extra_drive_works_on_its_own_pair_alone(stated: bool) -> None:
    base, body, pose = mechanism(3, pairs_on_a_line=1)
    M, _, points = singularity.link_rows(base, body, pose)
    rng = np.random.default_rng(6)
    axes = np.linalg.qr(rng.normal(size=(6, 3, 3)))[0][:, :2] if stated else None
    sets = extra_drives(base, body, pose, axes=axes)
    drives = [c.drives[0] for c in sets]
    lost = lost_twist(base, body, pose)
    side = np.sign(drives[0].wrench @ np.r_[lost[3:], lost[:3]] / drives[0].rates[0] / work(drives[0], base, points))
    spare = np.linalg.svd(M)[0][:, 5]
    assert {d.link for d in drives} == set(range(6))
    for c, d in zip(sets, drives, strict=True):
        normal = [d2.axis for d2 in drives if d2.link == d.link and d2.pair == "base"]
        if not stated:
            np.testing.assert_allclose([a @ M[d.link, :3] for a in normal], 0.0, atol=1e-12)
        assert np.linalg.norm(d.axis) == pytest.approx(1.0)
        # the work of the force screw on the lost twist is that on the pair
        assert d.wrench @ np.r_[lost[3:], lost[:3]] == pytest.approx(side * d.rates[0] * work(d, base, points), rel=1e-6, abs=1e-9)
        assert np.linalg.norm(d.wrench[:3]) == pytest.approx(1.0)
        # and none is done on the slide, nor on the pairs that turn about the same place
        assert d.wrench[:3] @ M[d.link, :3] == pytest.approx(0.0, abs=1e-9)
        others = np.eye(3) if d.pair == "base" else (axes[d.link] if axes is not None else np.array(normal))
        at = points[d.link] if d.pair == "base" else base[d.link]
        for axis in others:
            assert d.wrench @ np.r_[np.cross(at, axis), axis] == pytest.approx(0.0, abs=1e-6)
        assert abs(spare[c.spared[0]]) == pytest.approx(np.abs(spare).max())
        M2 = M.copy()
        M2[c.spared[0]] = d.wrench
        assert c.determinant == pytest.approx(np.linalg.det(M2), rel=1e-9)
    order = [(c.drives[0].pair == "body", -abs(c.determinant)) for c in sets]
    assert order == sorted(order)


def test_a_joint_that_turns_a_link_about_itself_carries_no_drive() -> None:
    """Nor do the others of its chain, for its turn is one of those at the body."""
    base, body, pose = mechanism(3, pairs_on_a_line=1)
    e = singularity.link_rows(base, body, pose)[0][:, :3]
    axes = np.linalg.qr(np.random.default_rng(6).normal(size=(6, 3, 3)))[0][:, :2]
    axes[4, 1] = e[4]
    assert {c.drives[0].link for c in extra_drives(base, body, pose, axes=axes)} == {0, 1, 2, 3, 5}


def work(d: Drive, base: FloatArray, points: FloatArray) -> float:
    """Of a drive's force screw on a unit turn of its pair."""
    at = base[d.link] if d.pair == "base" else points[d.link]
    return float(d.wrench @ np.r_[np.cross(at, d.axis), d.axis])


def test_a_lost_shift_is_counted_in_millimetres() -> None:
    """All links across x: the body slides along it, and a joint at the end of a link turns by the shift over the link's length."""
    rng = np.random.default_rng(2)
    body = rng.normal(size=(6, 3)) * 150.0
    base = body + rng.normal(size=(6, 3)) * 400.0 * [0.0, 1.0, 1.0]
    here = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    M, lengths, _ = singularity.link_rows(base, body, here)
    across = np.cross(M[:, :3], [1.0, 0.0, 0.0])
    axes = np.stack([across, np.tile([1.0, 0.0, 0.0], (6, 1))], axis=1)
    drives = [c.drives[0] for c in extra_drives(base, body, here, axes=axes)]
    assert {(d.link, d.pair) for d in drives if d.pair == "base"} == {(i, "base") for i in range(6)}
    for d in drives:
        if d.pair == "base":
            np.testing.assert_allclose(np.abs(d.axis), np.abs(across[d.link]), atol=1e-12)
            assert abs(d.rates[0]) == pytest.approx(1.0 / lengths[d.link], rel=1e-9)


@pytest.mark.parametrize(("off", "determined"), [(0.9e-9, True), (1.1e-9, False)])
def test_a_twist_is_lost_below_a_thousand_millionth_of_the_rows(off: float, determined: bool) -> None:
    """However large the rig is."""
    s = np.linalg.svd(singularity.link_rows(*mechanism(3, pairs_on_a_line=1, shift=1e-3))[0], compute_uv=False)
    base, body, pose = mechanism(3, pairs_on_a_line=1, shift=1e-3 * off * s[0] / s[5])
    s = np.linalg.svd(singularity.link_rows(base, body, pose)[0], compute_uv=False)
    assert s[5] / s[0] == pytest.approx(off, rel=0.05)
    assert bool(extra_drives(base, body, pose)) == determined


@pytest.mark.parametrize("missing", [2, 3])
def test_as_many_extra_drives_as_twists_are_lost_close_the_pose(missing: int) -> None:
    """Thesis 4.5: 6 - n at rank n. With them the rows have rank 6, with fewer of them not, and no motion is left to the chains."""
    base, body, pose = mechanism(8, pairs_on_a_line=missing)
    M = singularity.link_rows(base, body, pose)[0]
    twists = lost_twists(base, body, pose)
    assert (np.linalg.matrix_rank(M), twists.shape) == (6 - missing, (missing, 6))
    np.testing.assert_allclose(M @ np.roll(twists, 3, axis=1).T, 0.0, atol=1e-9 * np.abs(M).max() * np.abs(twists).max())
    sets = extra_drives(base, body, pose)
    assert len(sets) == 20
    for c in sets:
        rows = np.array([d.wrench for d in c.drives])
        assert np.linalg.matrix_rank(np.vstack([M, rows])) == 6
        assert np.linalg.matrix_rank(np.vstack([M, rows[1:]])) == 5
        kept = np.delete(M, c.spared, axis=0)
        assert abs(np.linalg.det(np.vstack([kept, rows]))) == pytest.approx(abs(c.determinant), rel=1e-9)


def test_the_exit_screw_moves_the_extra_drive_as_differences_say() -> None:
    """The turn of a link about its joint's axis, of the pose moved by the screw a little, over the little."""
    base, body, pose = mechanism(3, pairs_on_a_line=1)
    screw = singularity.gradients(base, body, pose)
    screw = screw / np.linalg.norm(screw[:3])
    e0 = singularity.link_rows(base, body, pose)[0][:, :3]
    h = 1e-6
    e1 = singularity.link_rows(base, body, singularity.moved(pose, h * screw))[0][:, :3]
    for c in extra_drives(base, body, pose, exit_twist=screw):
        d = c.drives[0]
        if d.pair == "base":
            assert d.exit_rate == pytest.approx(np.cross(e0[d.link], (e1 - e0)[d.link]) @ d.axis / h, abs=1e-5 * np.abs(screw).max())


@pytest.mark.parametrize("seed", range(6))
def test_drives_lead_out_or_jam_as_the_curvature_says(seed: int) -> None:
    """Thesis 4.2, by brute force: each length alone is changed both ways, and poses with these lengths are looked for on both sides."""
    base, body, pose = mechanism(seed, pairs_on_a_line=1)
    if seed % 2:
        base, body, pose = singular(seed)
    found = leading_out(base, body, pose)
    assert found is not None
    lost = lost_twist(base, body, pose)
    lengths = singularity.link_rows(base, body, pose)[1]
    assert np.count_nonzero(found) >= 2
    for i in np.flatnonzero(found):
        reached = []
        for sign in (1.0, -1.0):
            aim = lengths + sign * 1e-3 * np.eye(6)[i]
            ends = [
                closest(base, body, singularity.moved(pose, side * 0.02 * lost / max(1.0, np.abs(lost[:3]).max())), aim) for side in (1, -1)
            ]
            reached.append(min(ends) < 1e-9)
        assert reached == [found[i] > 0, found[i] < 0]


def singular(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Compare the singular pose nearest to a random one with a zero of the determinant that bisection finds."""
    base, body, pose = mechanism(seed)
    there = nearest_singular(base, body, pose)
    assert np.linalg.svd(singularity.link_rows(base, body, there)[0], compute_uv=False)[[0, 5]] @ [1e-9, -1.0] > 0.0
    # nearest: the way there is along the gradient, a turn counted at the rim
    K = singularity.displacement_gradients(base, body, pose, se3.displacement(there[None], pose)[0])
    unit = np.repeat([1.0 / singularity.rim_mm(body), 1.0], 3)
    way = se3.displacement(there[None], pose)[0] / unit
    assert abs(way @ (K * unit)) == pytest.approx(np.linalg.norm(way) * np.linalg.norm(K * unit), rel=1e-4)
    return base, body, there


def closest(base: FloatArray, body: FloatArray, pose: FloatArray, aim: FloatArray) -> float:
    """By how much lengths miss at the pose of least squares from a start [mm]."""

    def lacks(x: FloatArray) -> FloatArray:
        return np.asarray(singularity.link_rows(base, body, se3.displaced(pose, x / UNIT))[1] - aim)

    return float(np.abs(least_squares(lacks, np.zeros(6), method="lm", xtol=1e-15, ftol=1e-15, gtol=1e-15).fun).max())


def test_pressure_angles_of_links_beside_a_dependence_are_of_the_least_motion() -> None:
    base, body, pose = mechanism(3, pairs_on_a_line=1)
    M, _, points = singularity.link_rows(base, body, pose)
    lost = singularity.dependent(singularity.link_rows(base, body, pose)[0])
    np.testing.assert_array_equal(lost, [0, 1])
    found = singularity.link_pressure_angles(base, body, pose)
    np.testing.assert_array_equal(found[lost], np.pi / 2.0)
    middle, rim = points.mean(axis=0), singularity.rim_mm(body)
    for i in range(2, 6):
        rows = np.hstack([np.cross(points - middle, M[:, :3]) / rim, M[:, :3]])
        least = np.linalg.lstsq(rows, np.eye(6)[i], rcond=1e-9)[0]
        v = least[3:] + np.cross(least[:3] / rim, points[i] - middle)
        assert np.cos(found[i]) == pytest.approx(1.0 / max(1.0, float(np.linalg.norm(v))), rel=1e-6)
