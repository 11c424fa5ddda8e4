"""Krawczyk's test and what tells two assemblies apart, number by number; why structures determine no pose, and rigs that never do."""

import itertools

import numpy as np
import pytest

from lmeasure.core import ComplexArray, FloatArray
from lmeasure.linkages import Structure, krawczyk as certified, singularity, study_quadric
from lmeasure.linkages.krawczyk import Proved

ROUNDING = 5e-15


def system(seed: int, lean: float = 0.5) -> tuple[ComplexArray, ComplexArray, int]:
    """Quadrics (7, 8, 8) that meet in a point x (8,), whose e.e is lean, and which of its coordinates is held at 1."""
    g = np.random.default_rng(seed)
    x = np.asarray(0.3 * (g.normal(size=8) + 1j * g.normal(size=8)), dtype=np.complex128)
    x[:4] = 1.0, 1j * np.sqrt(1.0 - lean), 0.0, 0.0
    Q = g.normal(size=(7, 8, 8)) + 1j * g.normal(size=(7, 8, 8))
    Q = Q + np.swapaxes(Q, 1, 2)
    v = g.normal(size=8)
    Q -= np.einsum("i,kij,j->k", x, Q, x)[:, None, None] * np.outer(v, v) / (v @ x) ** 2
    return Q, x, 0


def krawczyk(Q: ComplexArray, slack: FloatArray, x: ComplexArray, held: int, known: ComplexArray | None) -> tuple[float, bool]:
    """Radius and proof by sums over indices."""
    J, f = np.zeros((8, 8), complex), np.zeros(8)
    for k in range(7):
        value = 0j
        for i in range(8):
            for j in range(8):
                J[k, i] += 2.0 * Q[k, i, j] * x[j]
                value += x[i] * Q[k, i, j] * x[j]
                f[k] += (ROUNDING * abs(Q[k, i, j]) + slack[k, i, j]) * abs(x[i]) * abs(x[j])
        f[k] = f[k] + abs(value) if known is None else abs(known[k]) * (1.0 + ROUNDING)
    J[7, held] = 1.0
    Y = np.linalg.inv(J)
    reach = [sum(abs(Y[i, k]) * f[k] for k in range(8)) for i in range(8)]
    radius = 3.0 * max(reach) + (1e-15 if known is None else 1e-40)
    wide = np.zeros((8, 8))
    for k in range(7):
        for i in range(8):
            for j in range(8):
                wide[k, i] += 2.0 * (ROUNDING * abs(Q[k, i, j]) + slack[k, i, j]) * abs(x[j])
                wide[k, i] += 2.0 * radius * (abs(Q[k, i, j]) + slack[k, i, j])
    off = abs(np.eye(8) - Y @ J) + ROUNDING * abs(Y) @ abs(J) + abs(Y) @ wide
    inside = all((reach[i] + off[i].sum() * radius) * (1.0 + ROUNDING) < radius for i in range(8))
    ee, sizes = abs(sum(c * c for c in x[:4])), [abs(c) for c in x[:4]]
    proper = ee > 2.0 * radius * sum(sizes) + 4.0 * radius**2 + ROUNDING * sum(s * s for s in sizes)
    return radius, bool(inside and proper)


@pytest.mark.parametrize(("of_base", "of_platform"), [(1.0, 1.0), (1.0, 100.0), (100.0, 1.0), (0.0, 1.0)])
def test_magnitudes_bound_what_entries_are_summed_of(of_base: float, of_platform: float) -> None:
    """Each entry is linear in the products of coordinates: the sums without signs are those of all choices of signs, of which none is
    greater."""
    rng = np.random.default_rng(4)
    a, b, lengths = of_base * rng.normal(size=(6, 3)), of_platform * rng.normal(size=(6, 3)), rng.uniform(0.5, 2.0, 6)
    bound = certified._magnitudes(study_quadric.links(a, b, lengths**2))
    assert not bound[:, 4:, 4:].any()
    # what is left of three squares may be nothing
    squares = (a**2).sum(axis=1) + (b**2).sum(axis=1)
    nothing = certified._magnitudes(study_quadric.links(a, b, squares))[:6]
    assert (nothing[:, range(4), range(4)] >= 2.0 * squares[:, None]).all()
    assert not bound[6].any()
    for signs in itertools.product((1.0, -1.0), repeat=6):
        entries = study_quadric.quadrics(study_quadric.links(a * signs[:3], b * signs[3:], lengths**2))[:6]
        # but of exact ones, in the lower right
        assert (np.abs(entries)[:, :4] <= bound[:6, :4] + 1e-12).all()


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("loose", [0.0, 1e-9, 1e-5])
def test_a_box_is_proved_where_its_image_lies_within(seed: int, loose: float) -> None:
    """From beside the point to so far away that nothing is proved, and by dimensions that are off."""
    Q, x, held = system(seed)
    slack = loose * np.random.default_rng(seed).uniform(0.5, 1.0, (7, 8, 8))
    way = np.exp(1j * np.arange(8.0)) * np.where(np.arange(8) == held, 0.0, 1.0)
    points = np.array([x + off * way for off in (0.0, *10.0 ** np.linspace(-9.0, -1.0, 33))])
    radius, certain = certified._box(Q, slack, points, np.full(len(points), held))
    expected = [krawczyk(Q, slack, point, held, None) for point in points]
    np.testing.assert_array_equal(certain, [sure for _, sure in expected])
    assert certain[1] == (loose < 1e-5 or seed != 1)
    assert not certain[-1]
    np.testing.assert_allclose(radius[1:], [r for r, _ in expected[1:]], rtol=1e-4)
    # where the equations are met their rounding is all there is, and is not the same twice
    assert radius[0] == pytest.approx(expected[0][0], rel=0.2 if loose == 0.0 else 1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_a_box_is_as_small_as_equations_in_whole_numbers_allow(seed: int) -> None:
    Q, x, held = system(seed)
    slack = np.zeros((7, 8, 8))
    for size in (1e-30, 1e-20, 1e-12, 1e-3):
        known = size * np.exp(1j * np.arange(7.0))
        radius, certain = certified._box(Q, slack, x[None], np.array([held]), known[None])
        expected = krawczyk(Q, slack, x, held, known)
        assert radius[0] == pytest.approx(expected[0], rel=1e-9)
        assert certain[0] == expected[1]
        assert certain[0] or size == 1e-3
    least = certified._box(Q, slack, x[None], np.array([held]), np.zeros((1, 7), complex))[0][0]
    assert least == pytest.approx(1e-40, rel=1e-12, abs=0.0)


def test_a_box_that_may_hold_a_point_that_is_no_pose_proves_nothing() -> None:
    """Where e.e is nearly nothing, to what the box and the rounding leave of it."""
    sure = []
    for lean in 10.0 ** np.linspace(-15.0, -11.0, 41):
        Q, x, held = system(1, lean)
        known = np.full((1, 7), 1e-14 + 0j)
        found = certified._box(Q, np.zeros((7, 8, 8)), x[None], np.array([held]), known)[1][0]
        assert found == krawczyk(Q, np.zeros((7, 8, 8)), x, held, known[0])[1]
        sure.append(bool(found))
    assert sure == sorted(sure)
    assert 3 < sum(sure) < 38


@pytest.mark.parametrize(("off", "new"), [(0.99, False), (1.01, True)])
def test_two_assemblies_are_different_where_their_boxes_tell(off: float, new: bool) -> None:
    """Twice what the radii 0.1 and 0.2 leave of a minor of points of which one is three times as large, and a rounding."""
    points = np.zeros((3, 8), complex)
    points[:, 0] = 1.0, 9.0, 3.0
    radius = np.array([0.1, 0.5, 0.2])
    limit = 2.0 * (0.1 * (3.0 + 0.2) + 0.2 * (1.0 + 0.1))
    points[2, 4] = 1j * off * limit
    determined = Proved(points, radius, np.array([True, False, True]), np.zeros(3, bool))
    assert certified.apart(determined).tolist() == [True, False, new]
    # of points without a box a rounding is left
    points[2, 4] = off * 5e-15
    assert certified.apart(Proved(points, np.zeros(3), np.array([True, False, True]), np.zeros(3, bool))).tolist() == [True, False, new]


# structures


@pytest.mark.parametrize(
    ("links", "reason"),
    [
        ([(0, 0), (0, 1), (0, 2), (1, 0), (1, 1), (1, 2)], "links that meet in less than three points of a body leave it a turn"),
        ([(0, 0), (1, 0), (2, 0), (3, 1), (4, 1), (5, 1)], "links that meet in less than three points of a body leave it a turn"),
        ([(0, 0), (0, 1), (0, 2), (0, 3), (1, 4), (2, 5)], "four links at one point say no more than three"),
        ([(0, 0), (1, 0), (2, 0), (3, 0), (4, 1), (5, 2)], "four links at one point say no more than three"),
        ([(0, 0), (0, 0), (1, 1), (2, 2), (3, 3), (4, 4)], "two links join the same two points"),
        (
            [(0, 1), (0, 2), (0, 3), (1, 0), (2, 0), (3, 0)],
            "three links at one point of the platform and three at one point of the base allow a turn about their line",
        ),
        ([(0, 0), (0, 1), (0, 2), (1, 0), (2, 0), (3, 3)], None),
        ([(0, 0), (0, 1), (1, 1), (1, 2), (2, 2), (2, 0)], None),
    ],
)
def test_why_a_structure_determines_no_pose(links: list[tuple[int, int]], reason: str | None) -> None:
    structure = Structure(tuple(links))
    assert structure.degenerate == reason
    assert (structure.placements is None) or reason is None


# rigs that are singular everywhere


@pytest.mark.parametrize(("off", "flat"), [(0.95e-5, True), (1.05e-5, False)])
def test_points_are_on_a_line_or_plane_to_a_hundred_thousandth_of_the_figure(off: float, flat: bool) -> None:
    """As root mean squares about their middle, along it and across."""
    along = np.array([-3.0, -1.0, 1.0, 3.0])
    across = np.array([1.0, -1.0, -1.0, 1.0])
    part = off * np.sqrt(20.0 / 4.0)
    line = np.outer(along, [0.0, 0.6, 0.8]) + part * np.outer(across, [1.0, 0.0, 0.0]) + [70.0, -20.0, 10.0]
    assert singularity._flatness(line, 1) == flat
    assert singularity._flatness(line, 2)
    wide = np.outer(along, [0.0, 0.6, 0.8]) + np.outer([2.0, -2.0, -2.0, 2.0], [0.0, 0.8, -0.6])
    thick = wide + part * np.outer([1.0, -3.0, 3.0, -1.0] / np.sqrt(5.0), [1.0, 0.0, 0.0])
    assert singularity._flatness(thick, 2) == flat
    assert not singularity._flatness(thick, 1)


@pytest.mark.parametrize(("off", "alike"), [(0.9e-5, True), (1.4e-5, False)])
def test_figures_are_similar_to_a_hundred_thousandth_of_their_distances(off: float, alike: bool) -> None:
    a = np.array([(0.0, 0.0, 0.0), (4.0, 0.0, 0.0), (1.0, 3.0, 0.0), (-2.0, 2.0, 0.0), (-3.0, -1.0, 0.0), (2.0, -2.5, 0.0)])
    b = 0.3 * a[:, [1, 0, 2]]
    assert singularity._similar(a, b)
    of = np.linalg.norm(b[:, None] - b, axis=2)
    b[1, 1] += 1.3 * off * of.max()
    assert singularity._similar(a, b) == alike


def test_links_that_depend_on_each_other_for_no_known_reason_are_told_so() -> None:
    """The degenerate structure: three links at one point of the platform, the three others at one of the base."""
    g = np.random.default_rng(3)
    base, platform = g.normal(size=(6, 3)) * 500.0, g.normal(size=(6, 3)) * 150.0
    platform[:3], base[3:] = platform[0], base[3]
    assert singularity.architecturally_singular(base, platform) == "the links are dependent at every pose"
    base[5] += [30.0, -20.0, 10.0]
    assert singularity.architecturally_singular(base, platform) is None
