"""All assemblies of straight links: the thesis' example, the closed form over many poses, Dietmaier's forty, and all structures."""

import numpy as np
import pytest
from linkages import DIETMAIER, lengths_at, nearest, rig

from lmeasure.core import se3
from lmeasure.linkages import Structure, closed_form, incidence, krawczyk, parse, start_systems, straight_links, structures, study_quadric
from lmeasure.linkages.krawczyk import ExactLinks, whole

SOLVABLE = [s for s in structures() if s.degenerate is None]
# complex assemblies, each counted by monodromy and from the general platform (`benchmarks/assembly_counts.py`); all others 8 or 16
COUNTS = {"L-2211-2211:ab-ac-b-d": 24, "L-2211-21111:ab-ac-d-e": 32, "L-2211-21111:ab-cd-a-e": 24, "L-2211-111111:ab-cd-e-f": 32}
COUNTS |= {
    "L-21111-21111:ab-a-c-d-e": 40,
    "L-21111-21111:bc-a-a-d-e": 24,
    "L-21111-111111:ab-c-d-e-f": 40,
    "L-111111-111111:a-b-c-d-e-f": 40,
}


def test_the_example_of_4_1() -> None:
    """As corrected: the base's y are shifted and P3, P4 exchanged in print. l7, l8 and the published assembly to all digits."""
    base = np.array([(3, 3, 0), (4, 2, 0), (1, 1, 0), (1, 5, 0), (1, 5, 0), (4, 2, 0)], dtype=float)
    platform = np.array([(0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 4, 0), (-2, 2, 0), (1, 2, 0)], dtype=float)
    lengths = np.array([10.0, 10.5, 11.0, 8.9, 7.98, 9.9])
    assert incidence(base, platform).structure.class_name == "L-3111-2211"  # figure 4.1d, not 4.1a
    found = straight_links.assemblies(base, platform, lengths)
    assert found.certified.all()
    assert (len(found.poses), found.status) == (8, straight_links.ALL)
    above = found.poses[found.poses[:, 2] > 0.0]
    np.testing.assert_allclose(above[:, :3], np.tile([2.5625, 6.6875, 9.284985], (4, 1)), atol=1e-6)
    points = se3.apply(above[:, None], np.array([(0, 0, 0), (1, 2, 0), (-2, 2, 0), (0, 4, 0)], dtype=float))
    additional = np.linalg.norm(points[:, :2] - [1, 5, 0], axis=2)
    assert np.abs(additional - [9.565563, 9.653616]).max(axis=1).min() < 1e-6
    published = np.array([(2.660485, 4.463435, 9.494587), (0.346899, 5.563243, 7.933260), (1.216079, 2.972575, 8.663305)])
    best = np.abs(points[:, 1:] - published).max(axis=(1, 2)).argmin()
    np.testing.assert_allclose(points[best, 1:], published, atol=2e-6)
    # from B1 they are l7, l8, l5 and l4 away; from B1 as printed they are not
    points = points[best]
    true, printed = (np.linalg.norm(points - b, axis=1) for b in ([1.0, 5.0, 0.0], [1.0, 1.0, 0.0]))
    np.testing.assert_allclose(true, [9.5656, 9.6536, 7.98, 8.90], atol=1e-4)
    np.testing.assert_allclose(printed, [11.00, 10.24, 9.18, 8.89], atol=6e-3)
    # Rz Ry Rx with O' = P1: |a| > 90, which the thesis' arcsin formulas miss
    angles = se3.rotation(above[best]).as_euler("ZYX", degrees=True)
    np.testing.assert_allclose(angles, [-25.4250, -31.3619, -169.5130], atol=1e-3)


@pytest.mark.parametrize("structure", [s for s in SOLVABLE if s.closed_form][::3], ids=lambda s: s.notation)
def test_tetrahedra_over_many_poses(structure: Structure) -> None:
    """Every assembly closes to 1e-9 mm, and the true pose is among them."""
    base, platform, poses = rig(structure, 5, 2000)
    lengths = lengths_at(base, platform, poses)
    found, closes = closed_form(base, platform, lengths)
    assert np.abs(lengths_at(base, platform, found) - lengths[:, None])[closes].max() < 1e-9
    assert max(nearest(found[i][closes[i]], poses[i]) for i in range(0, 2000, 10)) < 1e-4
    assert np.abs(se3.displacement(found, poses[:, None])).max(axis=2).min(axis=1).max() < 1e-4


def test_tetrahedra_of_links_shorter_than_their_platform() -> None:
    structure = next(s for s in SOLVABLE if s.closed_form)
    base, platform, _ = rig(structure, 5)
    near = np.array([0.01, -0.02, 0.03, 0.0, 0.0, 0.0, 1.0])
    base = platform + 0.05 * (base - base.mean(axis=0)) / np.abs(base).max()
    lengths = lengths_at(base, platform, near)
    assert lengths.max() < np.ptp(platform, axis=0).max()
    found, closes = closed_form(base, platform, lengths)
    assert nearest(found[closes], near) < 1e-4


def test_tetrahedra_keep_the_shape_of_a_batch_and_refuse_other_structures() -> None:
    base, platform, poses = rig(parse("L-321-222")[0], 2, 6)
    lengths = lengths_at(base, platform, poses)
    found, closes = closed_form(base, platform, lengths.reshape(2, 3, 6))
    assert (found.shape, closes.shape) == ((2, 3, 8, 7), (2, 3, 8))
    np.testing.assert_array_equal(closed_form(base, platform, lengths[4])[0], found[1, 1])
    base, platform, poses = rig(parse("L-222-222")[0], 2)
    assert closed_form(base, platform, lengths_at(base, platform, poses))[0].shape == (1, 0, 7)


def test_dietmaiers_forty() -> None:
    base, platform, lengths = DIETMAIER
    found = straight_links.assemblies(base, platform, lengths)
    assert found.certified.all()
    assert (len(found.poses), found.complex_found, found.status) == (40, 40, straight_links.ALL)
    np.testing.assert_allclose(lengths_at(base, platform, found.poses), np.tile(lengths, (40, 1)), atol=1e-13)


@pytest.mark.parametrize("structure", SOLVABLE[::2], ids=lambda s: s.notation)
def test_every_second_structure_has_all_its_assemblies(structure: Structure) -> None:
    base, platform, (pose,) = rig(structure, 12)
    lengths = lengths_at(base, platform, pose)
    found = straight_links.assemblies(base, platform, lengths)
    assert found.status == straight_links.ALL
    assert found.certified.all()
    assert nearest(found.poses, pose) < 1e-6
    np.testing.assert_allclose(lengths_at(base, platform, found.poses), np.tile(lengths, (len(found.poses), 1)), atol=1e-9)
    if structure.closed_form:
        assert closed_form(base, platform, lengths)[1].sum() == len(found.poses)


def test_complex_assemblies_of_every_structure() -> None:
    for s in SOLVABLE:
        n = start_systems.complex_assemblies(s)
        assert n == start_systems.complex_assemblies(s.swapped)
        assert n == COUNTS.get(s.notation, COUNTS.get(s.swapped.notation, n))
        assert n in (8, 16, 24, 32, 40)
        assert n == 8 or not s.closed_form
    assert start_systems.complex_assemblies(next(s for s in structures() if s.degenerate)) == 0


@pytest.mark.parametrize("name", ["L-222-222", "L-2211-2211:ab-ac-b-d"])
def test_start_systems_by_monodromy_again(name: str) -> None:
    """Other dimensions, other loops: the same number, and as many from the general platform, some of whose forty paths are lost."""
    from lmeasure.kernels import REACHED, follow_homotopy

    (structure,) = parse(name)
    rng = np.random.default_rng(8)
    links, points = start_systems.grown(structure, rng)
    assert len(points) == start_systems.complex_assemblies(structure)
    residuals = np.einsum("ni,kij,nj->nk", points, study_quadric.quadrics(links), points)
    assert np.abs(residuals).max() < 1e-10
    general, forty = start_systems.start_of(SOLVABLE[-1])
    ends, determined = follow_homotopy(general, links, forty)
    proper = ends[(determined == REACHED) & (np.abs((ends[:, :4] ** 2).sum(axis=1)) > 1e-8)]
    assert len(start_systems.distinct(np.concatenate([start_systems.unit(points), proper]))) == len(points)


def test_no_assembly_is_missing_by_the_trace() -> None:
    """The sum over all assemblies moves in a straight line with a squared length, that without any one of them does not: of every structure
    but L-222-222, whose assemblies are among the ends of those of L-222-2211:ab-ac-bd, with as many."""
    rng, without = np.random.default_rng(3), []
    for structure in start_systems.of_its_own():
        off = start_systems.not_linear(structure, *start_systems.start_of(structure), rng)
        if off is None:
            without.append(structure.notation)
            continue
        size = np.abs(off).max()
        assert abs(off.sum()) < 1e-5 * size
        assert np.abs(off.sum() - off).min() > 1e-4 * size
    assert without == ["L-222-222:ab-ac-bc"]
    assert len({start_systems.complex_assemblies(parse(name)[0]) for name in ("L-222-222", "L-222-2211:ab-ac-bd")}) == 1


def test_links_that_hold_no_pose_have_no_assemblies_and_none_are_proved() -> None:
    structure = next(s for s in structures() if s.degenerate is not None)
    base, platform, (pose,) = rig(structure, 4)
    found = straight_links.assemblies(base, platform, lengths_at(base, platform, pose))
    assert (len(found.poses), found.complex_found, found.complex_expected, found.status) == (0, 0, 0, straight_links.NOT_PROVED)


def test_where_assemblies_meet_nothing_is_proved_and_the_pose_is_listed() -> None:
    """The three columns of 4.5: singular, two assemblies in one."""
    base = np.array([(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)])
    platform = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
    found = straight_links.assemblies(base, platform, np.full(6, 1.6))
    assert found.status == straight_links.NOT_PROVED
    assert nearest(found.poses[~found.certified], np.array([0.0, 0, 0, 0, 0, 0, 1])) < 1e-3


def test_what_nothing_proves_is_led_to_its_lengths() -> None:
    """From 0.01 rad and a hundredth of the size beside it, and listed once."""
    base, platform, (pose,) = rig(parse("L-222-111111")[0], 4)
    size = np.abs(base).max()
    a, b, lengths = base / size, platform / size, lengths_at(base, platform, pose) / size
    true = np.r_[pose[:3] / size, pose[3:]]
    near = se3.displaced(np.stack([true, true]), 0.01 * np.array([[1, -1, 0.5, 1, 1, -1], [-0.5, 1, 1, -1, 0.5, 1]]))
    found = straight_links._folds(a, b, lengths, near, np.empty((0, 7)))
    assert len(found) == 1
    assert np.abs(se3.displacement(found[0], true)).max() < 1e-9
    assert not len(straight_links._folds(a, b, lengths, near, true[None]))


def test_a_box_without_an_assembly_is_not_certified() -> None:
    base, platform, lengths = DIETMAIER
    rows = study_quadric.links(base, platform, lengths**2)
    true = study_quadric.points(straight_links.assemblies(base, platform, lengths).poses).astype(np.complex128)
    assert krawczyk.proved(rows, true).real.all()
    # what Newton's method is not let to mend
    Q, held = study_quadric.quadrics(rows), np.abs(true).argmax(axis=1)
    off = true / np.take_along_axis(true, held[:, None], axis=1) + 1e-3 * np.where(np.arange(8) == held[:, None], 0.0, 1.0)
    assert not krawczyk._box(Q, np.zeros((7, 8, 8)), off, held)[1].any()
    # the same assembly twice is one
    twice = krawczyk.proved(rows, np.concatenate([true[:1], 2.0j * true[:1], true[1:2]]))
    assert krawczyk.apart(twice).tolist() == [True, False, True]


def test_special_points_have_fewer_assemblies_and_are_done_with_these() -> None:
    """A plane hexapod with both hexagons on circles, mirrored at three axes, as machines are built: 28 of 40."""
    turns = np.radians([[10.0, 50.0, 130.0, 170.0, 250.0, 290.0], [-20.0, 80.0, 100.0, 200.0, 220.0, 320.0]])
    base, platform = (r * np.column_stack([np.cos(t), np.sin(t), 0.0 * t]) for r, t in zip((900.0, 300.0), turns, strict=True))
    pose = np.array([30.0, -20.0, 650.0, 0.1, 0.05, -0.08, np.sqrt(1.0 - 0.0189)])
    found = straight_links.assemblies(base, platform, lengths_at(base, platform, pose))
    assert (found.complex_found, found.complex_expected, found.status) == (28, 28, straight_links.ALL)
    assert nearest(found.poses, pose) < 1e-6


# of 200 rigs of each structure those that double precision leaves open: near a fold, with large coordinates, and both
HARD = {"L-222-321:ab-ab-ac": 82, "L-222-3111:ab-ac-ad": 14, "L-2211-2211:ab-ab-c-d": 4, "L-21111-321:bc-a-a-a-b": 191}


@pytest.mark.parametrize("name", HARD)
def test_what_double_precision_leaves_open_is_proved_in_whole_numbers(name: str) -> None:
    base, platform, (pose,) = rig(next(s for s in SOLVABLE if s.notation == name), 1000 + HARD[name])
    lengths = lengths_at(base, platform, pose)
    found = straight_links.assemblies(base, platform, lengths)
    assert found.status == straight_links.ALL
    assert found.certified.all()
    assert nearest(found.poses, pose) < 1e-8
    # not without
    rows, known = study_quadric.links(base, platform, lengths**2), study_quadric.points(found.poses).astype(np.complex128)
    exact = ExactLinks.of(base, platform, lengths, origins=(np.zeros(3), np.zeros(3)), size=1.0)
    # a little beside them and not quite real
    known *= 1.0 + 1e-9j * np.arange(8.0)
    with_digits, without = (krawczyk.proved(rows, known, whole) for whole in (exact, None))
    assert with_digits.certain.all()
    assert without.certain.sum() < len(known) or found.complex_found > len(known)
    for determined in (with_digits, without):
        assert not determined.points[determined.real].imag.any()
    assert with_digits.real.any()


def test_equations_in_whole_numbers_are_those_of_the_links() -> None:
    """At a turn by (4; 0, 0, 3), whose matrix is one of whole numbers over 25, without a rounding; elsewhere those of the quadrics."""
    base, platform, _ = rig(parse("L-111111-111111")[0], 3)
    base, platform = np.round(base), 25.0 * np.round(platform)
    turn = np.array([(7.0, -24.0, 0.0), (24.0, 7.0, 0.0), (0.0, 0.0, 25.0)]) / 25.0
    p, e = np.array([0.0, 3.0, -2.0, 8.0]), np.array([4.0, 0.0, 0.0, 3.0])
    squares = ((platform @ turn.T + p[1:] - base).round() ** 2).sum(axis=1)
    exact = ExactLinks.of(base, platform, np.arange(6.0), origins=(np.zeros(3), np.zeros(3)), size=1.0)
    x = whole(np.r_[e, study_quadric.product(p, e)][None])
    # |h|^2 = e.e |p + R b - a|^2
    np.testing.assert_array_equal(exact.equations(x, 0 * x)[0], [*25.0 * (squares - np.arange(6.0) ** 2), 0.0])
    rng = np.random.default_rng(1)
    y, lengths = rng.uniform(-1.0, 1.0, (4, 8)) + 1j * rng.uniform(-1.0, 1.0, (4, 8)), rng.uniform(100.0, 900.0, 6)
    exact = ExactLinks.of(base, platform, lengths, origins=(np.full(3, 0.3), np.full(3, -0.7)), size=512.0)
    rows = study_quadric.links((base - 0.3) / 512.0, (platform + 0.7) / 512.0, (lengths / 512.0) ** 2)
    expected = np.einsum("kij,ni,nj->nk", study_quadric.quadrics(rows), y, y)
    np.testing.assert_allclose(exact.equations(whole(y.real), whole(y.imag)), expected, rtol=1e-12, atol=1e-13)


def test_a_fold_in_whole_numbers_is_not_proved() -> None:
    """The three columns of 4.5 five times as large: singular without a rounding, and no digits prove one assembly where two are."""
    base = np.array([(0, -5, -8), (5, 0, -8), (0, 5, -8), (0, -13, 0), (13, 0, 0), (0, 13, 0)], dtype=float)
    platform = np.array([(0, -5, 0), (5, 0, 0), (0, 5, 0)] * 2, dtype=float)
    found = straight_links.assemblies(base, platform, np.full(6, 8.0))
    assert found.status == straight_links.NOT_PROVED
    here = np.array([[0.0, 0, 0, 0, 0, 0, 1]])
    exact = ExactLinks.of(base, platform, np.full(6, 8.0), origins=(np.zeros(3), np.zeros(3)), size=1.0)
    rows, beside = study_quadric.links(base, platform, np.full(6, 64.0)), se3.displaced(here, np.full((1, 6), 1e-9))
    for start in (here, beside):
        assert not krawczyk.proved(rows, study_quadric.points(start).astype(np.complex128), exact).certain.any()


def test_boxes_hold_the_assemblies_that_fifty_digits_find() -> None:
    """The equations once more in mpmath, from points and squared lengths: |p + R b - a|^2 = l^2 by quaternions, not from the quadrics."""
    import mpmath as mp

    mp.mp.dps = 50
    base, platform, lengths = DIETMAIER
    determined = krawczyk.proved(
        study_quadric.links(base, platform, lengths**2),
        study_quadric.points(straight_links.assemblies(*DIETMAIER).poses[:4]).astype(np.complex128),
    )

    def times(p: list[mp.mpf], q: list[mp.mpf]) -> list[mp.mpf]:
        (a, b, c, d), (e, f, g, h) = p, q
        return [a * e - b * f - c * g - d * h, a * f + b * e + c * h - d * g, a * g - b * h + c * e + d * f, a * h + b * g - c * f + d * e]

    for x, radius in zip(determined.points.real, determined.radius, strict=True):
        held = int(np.abs(x).argmax())

        def equations(*free: mp.mpf, held: int = held) -> list[mp.mpf]:
            y = [*free[:held], mp.mpf(1), *free[held:]]
            e, g = y[:4], y[4:]
            out = [mp.fdot(e, g)]
            for a, b, length in zip(base.tolist(), platform.tolist(), lengths.tolist(), strict=True):
                left, right = times([mp.mpf(0), *map(mp.mpf, a)], e), times(e, [mp.mpf(0), *map(mp.mpf, b)])
                out.append(sum((u + v - w) ** 2 for u, v, w in zip(g, right, left, strict=True)) - mp.mpf(length) ** 2 * mp.fdot(e, e))
            return out

        exact = mp.findroot(equations, [mp.mpf(v) for i, v in enumerate(x.tolist()) if i != held], tol=1e-45)
        off = max(abs(float(u - mp.mpf(v))) for u, v in zip(exact, (v for i, v in enumerate(x.tolist()) if i != held), strict=True))
        assert 0.0 < off < radius < 1e-9
