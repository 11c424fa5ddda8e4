"""Determinants, their gradients and what lies around singular poses: the thesis' examples as corrected, and differences."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import extra_drives, pluecker_rows, pressure_angles as regular_pressure_angles, singularity

laws = settings(max_examples=40, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

# thesis 4.5: three columns on three points of the base
COLUMNS = (
    np.array([(0, -1, -1.6), (1, 0, -1.6), (0, 1, -1.6), (0, -2.6, 0), (2.6, 0, 0), (0, 2.6, 0)], dtype=float),
    np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0), (0, -1, 0), (1, 0, 0), (0, 1, 0)], dtype=float),
)


def mechanism(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points of base and body (6, 3) and a pose (7,), all at random."""
    rng = np.random.default_rng(seed)
    pose = se3.displaced(np.array([0.0, 0.0, 400.0, 0.0, 0.0, 0.0, 1.0]), rng.normal(size=6) * np.repeat([0.5, 100.0], 3))
    return rng.normal(size=(6, 3)) * 500.0, rng.normal(size=(6, 3)) * 150.0, pose


@laws
@given(seeds)
def test_the_gradient_is_the_rate_of_the_determinant(seed: int) -> None:
    base, body, pose = mechanism(seed)
    K = singularity.gradients(base, body, pose)
    for i, step in enumerate(1e-4 * np.diag(np.repeat([1.0, 150.0], 3))):
        # five points: differences of the fourth order
        d = [singularity.determinants(base, body, singularity.moved(pose, k * step)) for k in (-2, -1, 1, 2)]
        rate = (d[0] - 8.0 * d[1] + 8.0 * d[2] - d[3]) / (12.0 * step[i])
        size = np.abs(K * np.repeat([1.0, 150.0], 3)).max() / (150.0 if i > 2 else 1.0)
        assert K[i] == pytest.approx(rate, rel=1e-7, abs=1e-7 * size)


@laws
@given(seeds)
def test_the_determinant_does_not_depend_on_the_frame(seed: int) -> None:
    base, body, pose = mechanism(seed)
    rng = np.random.default_rng(seed)
    other = se3.displaced(HERE, rng.normal(size=6) * np.repeat([1.0, 300.0], 3))
    d = singularity.determinants(base, body, pose)
    assert singularity.determinants(se3.apply(other, base), body, se3.compose(other, pose)) == pytest.approx(d, rel=1e-9)
    # a twist of one frame is the adjoint's of the other
    K, there = singularity.gradients(base, body, pose), singularity.gradients(se3.apply(other, base), body, se3.compose(other, pose))
    np.testing.assert_allclose(there @ se3.adjoint(other), K, rtol=1e-8, atol=1e-8 * np.abs(K).max())
    # rows about the tool origin, halves the other way round
    M, _, points = singularity.link_rows(base, body, pose)
    assert np.linalg.det(pluecker_rows(points - pose[:3], M[:, :3])) == pytest.approx(-d, rel=1e-9)


def test_thesis_4_5_gradient() -> None:
    assert singularity.determinants(*COLUMNS, HERE) == pytest.approx(0.0, abs=1e-12)
    K = singularity.gradients(*COLUMNS, HERE)
    assert K[2] == pytest.approx(6.5)
    assert np.flatnonzero(K).tolist() == [2]  # nor anything that rounding leaves
    # 0.016, printed as the gradient's size, is a step along it
    turned = [singularity.determinants(*COLUMNS, singularity.moved(HERE, np.array([0, 0, a, 0, 0, 0]))) for a in (0.01, 0.016, 0.1)]
    np.testing.assert_allclose(turned, [0.064992, 0.103966, 0.641888], atol=1e-6)


def test_thesis_4_5_extra_drive() -> None:
    M = singularity.link_rows(*COLUMNS, HERE)[0]
    assert [int(np.linalg.matrix_rank(np.delete(M, i, axis=0))) for i in range(6)] == [4, 4, 4, 5, 4, 5]
    axes = np.array([[(1, 0, 0), (0, 0, 1)]] * 6, dtype=float)
    axes[4] = [(0, 1, 0), (0, 0, 1)]
    # the columns stand: any two axes across them
    axes[:3] = [(1, 0, 0), (0, 1, 0)]
    sets = [c for c in extra_drives(*COLUMNS, HERE, axes=axes) if c.drives[0].link == 5]
    assert [(c.drives[0].pair, round(float(c.drives[0].rates[0]), 9)) for c in sets] == [("base", -0.625), ("body", 1.625)]
    of_base = sets[0].drives[0]
    np.testing.assert_allclose(of_base.axis, [0, 0, 1])
    # a force along x through P3, which holds the body as the printed determinant says
    np.testing.assert_allclose(of_base.wrench * np.sign(of_base.wrench[0]), [1, 0, 0, 0, 0, -1], atol=1e-12)
    assert sets[0].spared in ((3,), (5,))
    assert abs(sets[0].determinant) == pytest.approx(2.0)
    # without stated axes the universal joint's first is the one that the lost twist turns the link about: the same
    own = next(c for c in extra_drives(*COLUMNS, HERE) if c.drives[0].link == 5).drives[0]
    np.testing.assert_allclose([*own.axis, *own.rates], [0, 0, 1, -0.625], atol=1e-12)


def test_no_extra_drive_where_nothing_is_lost() -> None:
    assert extra_drives(*mechanism(0)) == []


# thesis 4.6; the second body of example 2 differs in two points; example 4's coordinates are those of its printed matrix
R1 = np.array([(0, 0, 0), (0, 0, 0), (0, 0, 0), (-1, 1, 0), (-1, -1, 0), (0, -1, 0)], dtype=float)
RHO1 = np.array([(1, 0, 0), (-1, 0, 0), (0, 1, 0), (-1, 1, -1), (-1, -1, -1), (1, -1, -1)], dtype=float)
R2 = R1 + [(0.5, 0, 0), (-0.5, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0), (0, 0, 0)]
R3 = np.array([(1, 4.5, 0), (1, 4.5, 0), (-1, 3.5, 0), (-1, 3.5, 0), (0, 3, 0), (0, 3, 0)])
RHO3 = np.array([(0, 1, -2), (2, 0, 0), (-2, 0, 0), (0, 1, -2), (2, 0, 0), (-2, 0, 0)], dtype=float)
R4 = np.array([(1, 0, 2), (1, 0, 2), (1, 0, 3), (1, 0, 3), (2, 0, 2), (2, 0, 2)], dtype=float)
RHO4 = np.array([(0, 0, 0), (1, 0, 0), (0, 3, 0), (0, 2, 0), (3, 0, 0), (2, 1, 0)], dtype=float)


@pytest.mark.parametrize(
    ("rho", "r", "gradient"),
    [
        (RHO1, R1, (0, 0, 0, 0, 0, 2.82843)),
        (RHO1, R2, (0, -2.82843, 2.82843, 0, 0, 5.65685)),
        (RHO3, R3, (0, 0.06318, 0, 0, 0, 0.06318 * 6.5)),
        (RHO4, R4, (0, 0, 0.016454, 0, 0.016454 * 1.33333, 0)),
    ],
)
def test_thesis_4_6_gradients_and_neighbouring_singular_poses(rho: FloatArray, r: FloatArray, gradient: tuple[float, ...]) -> None:
    """Up to a sign and, where rows are printed with three digits, to those."""
    K = singularity.gradients(rho, r, HERE)
    np.testing.assert_allclose(K * np.sign(K[np.argmax(np.abs(K))]), np.array(gradient) * np.sign(gradient[-1] or gradient[-2]), atol=1e-4)
    around = singularity.neighbourhood(rho, r, HERE, size_mm=1.0)
    assert around.twists.shape == (5, 6)
    np.testing.assert_allclose(around.twists @ around.twists.T, np.eye(5), atol=1e-9)
    np.testing.assert_allclose(around.twists @ K, 0.0, atol=1e-9)
    # a step along one of them leaves singular poses by its square alone, and by how much the curvature tells
    for twist, bend in zip(around.twists, around.bend, strict=True):
        for t in (1e-3, -1e-3):
            d = singularity.determinants(rho, r, se3.displaced(HERE, t * twist))
            assert d == pytest.approx(-0.5 * bend * t**2 * np.linalg.norm(K), abs=2e-8)


def test_thesis_4_6_a_printed_twist_is_rounded() -> None:
    """Omega5 of the third example, (0, 1, 0; 0, 0, -0.154), is normal to the gradient but for its last digit: -1/6.5."""
    K = singularity.gradients(RHO3, R3, HERE)
    assert abs(K @ [0, 1, 0, 0, 0, -1 / 6.5]) < 1e-12
    assert abs(K @ [0, 1, 0, 0, 0, -0.154]) == pytest.approx(0.06318 * 6.5 * (0.154 - 1 / 6.5), abs=1e-6)


def test_thesis_4_6_topology() -> None:
    """The first example's singular poses are a plane among the displacements, the second's are not."""
    assert singularity.neighbourhood(RHO1, R1, HERE, size_mm=1.0).topology == "plane"
    assert singularity.neighbourhood(RHO1, R2, HERE, size_mm=1.0).topology == "surface"


@laws
@given(seeds)
def test_neighbours_of_a_singular_pose_are_singular_wherever_the_frame_is(seed: int) -> None:
    base, body, pose = mechanism(seed)
    # link 6 becomes the sum of others' force screws: through the place where two of them meet, in their plane
    base[5], body[5] = base[4] + 0.3 * (base[3] - base[4]), body[4]
    body[3] = body[4]
    assert abs(singularity.determinants(base, body, pose)) < 1e-6
    around = singularity.neighbourhood(base, body, pose)
    np.testing.assert_allclose(around.twists @ around.gradient, 0.0, atol=1e-6 * max(1.0, np.abs(around.gradient).max()))
    rim = singularity.rim_mm(body)
    about = around.twists @ se3.at_points(pose[:3]).T * np.repeat([rim, 1.0], 3)
    np.testing.assert_allclose(about @ about.T, np.eye(len(about)), atol=1e-9)


def test_where_the_gradient_vanishes_it_is_said() -> None:
    """Links along two lines have rows of rank two, and the determinant begins with fourth powers; two pairs on lines, with squares."""
    base = np.array([(1, 0, 0), (-1, 0, 0), (2, 0, 0), (0, 1, 0), (0, -1, 0), (0, 2, 0)], dtype=float)
    body = np.array([(0.1, 0, 0), (-0.1, 0, 0), (0.1, 0, 0), (0, 0.1, 0), (0, -0.1, 0), (0, 0.1, 0)], dtype=float)
    assert singularity.hold(base, body, HERE).rank == 2
    around = singularity.neighbourhood(base, body, HERE)
    np.testing.assert_allclose(around.gradient, 0.0, atol=1e-12)
    assert around.twists.shape == (6, 6)
    assert around.topology == "higher order"
    base, body, pose = mechanism(8)
    for i in (0, 2):
        body[i + 1] = body[i]
        base[i + 1] = base[i] + 0.4 * (se3.apply(pose, body[i]) - base[i])
    assert singularity.hold(base, body, pose).rank == 4
    assert singularity.neighbourhood(base, body, pose).topology == "cone"


@pytest.mark.parametrize("unit", [1e-3, 1.0, 1e4])
def test_what_lies_around_does_not_depend_on_the_unit_of_length(unit: float) -> None:
    """Of a regular point of the singular poses, and of one where the gradient vanishes: a rig in metres, in millimetres, in tenths of
    micrometres."""
    base, body, pose = mechanism(8)
    for i in (0, 2):
        body[i + 1] = body[i]
        base[i + 1] = base[i] + 0.4 * (se3.apply(pose, body[i]) - base[i])
    there = np.concatenate([unit * pose[:3], pose[3:]])
    assert singularity.neighbourhood(unit * base, unit * body, there).topology == "cone"
    base, body = COLUMNS
    assert singularity.neighbourhood(unit * base, unit * body, HERE).topology == singularity.neighbourhood(base, body, HERE).topology
    assert len(singularity.neighbourhood(unit * base, unit * body, HERE).twists) == 5


# thesis 5.1, table 5.1: the pairing that its angles tell
P51 = np.array([(3, -3, 3), (3, -3, 3), (3, -3, 3), (2, 1, 3), (2, 1, 3), (0, -2, 3)], dtype=float)
B51 = np.array([(3, -4.5, 0), (4, -0.5, 0), (2, -1.5, 0), (3, 1, 0), (2, 1, 0), (0, -2, 0)])


def test_thesis_table_5_1() -> None:
    assert singularity.determinants(B51, P51, HERE) == pytest.approx(6.174488, abs=1e-6)
    found = np.degrees(singularity.link_pressure_angles(B51, P51, HERE))
    np.testing.assert_allclose(found, [36.7132, 57.1537, 61.2138, 72.1344, 72.0798, 0.0], atol=1e-4)


@laws
@given(seeds)
def test_pressure_angles_are_the_regular_ones_where_links_hold(seed: int) -> None:
    base, body, pose = mechanism(seed)
    M, _, points = singularity.link_rows(base, body, pose)
    arms = points - pose[:3]
    np.testing.assert_allclose(
        singularity.link_pressure_angles(base, body, pose), regular_pressure_angles(pluecker_rows(arms, M[:, :3]), arms), atol=1e-6
    )


def test_pressure_angles_at_a_singular_pose() -> None:
    """90 degrees where links depend on each other, and where they do not, the limit of small detours that bring no other motion in."""
    angles = singularity.link_pressure_angles(*COLUMNS, HERE)
    lost = singularity.dependent(singularity.link_rows(*COLUMNS, HERE)[0])
    assert len(lost) >= 2
    np.testing.assert_array_equal(angles[lost], np.pi / 2)
    rest = np.setdiff1d(np.arange(6), lost)
    assert np.isfinite(angles[rest]).all()
    assert (angles[rest] < np.pi / 2 - 0.01).all()


@laws
@given(seeds)
def test_how_well_links_hold_is_the_largest_motion_of_the_rim(seed: int) -> None:
    base, body, pose = mechanism(seed)
    held = singularity.hold(base, body, pose)
    M, _, points = singularity.link_rows(base, body, pose)
    arms = points - points.mean(axis=0)
    rows = pluecker_rows(arms, M[:, :3])
    rng = np.random.default_rng(seed)
    d = rng.normal(size=(6, 500))
    twist = np.linalg.solve(rows, d / np.linalg.norm(d, axis=0))
    moved = np.sqrt((twist[3:] ** 2).sum(axis=0) + ((singularity.rim_mm(body) * twist[:3]) ** 2).sum(axis=0))
    assert held.rank == 6
    assert 0.3 * held.mm_per_mm <= moved.max() <= held.mm_per_mm * (1 + 1e-9)
