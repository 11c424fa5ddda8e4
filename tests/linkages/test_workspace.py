"""Boundaries of workspaces and paths led around limits: the thesis' examples as recomputed, and brute force."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation

from lmeasure.core import BoolArray, FloatArray, StructureError, se3
from lmeasure.linkages import Bounds, Slice, boundary, detour, first_met, singularity
from lmeasure.linkages.detours import nearest_pose
from lmeasure.structure.slices import slices

laws = settings(max_examples=15, deadline=None, derandomize=True)
HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])

# thesis 5.3
BODY = np.array([(0, -1, 0), (1, 0, 0), (0, 1, 0)] * 2, dtype=float)
BASE = np.array([(0, -5, 0), (5, 0, 0), (-4, 1, 0), (0, -1, -4), (1, 0, -4), (0, 1, -4)], dtype=float)
LIMIT = np.radians(84.0)
XZ = np.array([(1, 0, 0), (0, 0, 1)], dtype=float)
# beta, then by level and limit: the first violation from (0, Y, 0), bisected
BETA = np.arange(15.0, 360.0, 30.0)
INF = np.inf
TABLE = {
    (0.0, None): (5.657, INF, INF, INF, INF, 5.657, 3.266, 2.828, 3.266, 3.266, 2.828, 3.266),
    (0.0, LIMIT): (5.123, 12.040, 26.019, 25.057, 11.421, 5.111, 3.121, 2.650, 3.125, 3.132, 2.657, 3.124),
    (1.0, None): (7.071, INF, INF, INF, INF, 4.243, 2.449, 2.121, 2.449, 4.082, 3.536, 4.082),
    (1.0, LIMIT): (5.948, 12.643, 25.270, 23.839, 10.079, 3.553, 2.158, 1.906, 2.233, 3.173, 3.058, 3.593),
    (-1.0, None): (4.243, INF, INF, INF, INF, 7.071, 4.082, 3.536, 4.082, 2.449, 2.121, 2.449),
    (-1.0, LIMIT): (3.661, 11.130, 26.694, 26.120, 12.538, 6.050, 3.791, 3.194, 3.480, 2.245, 1.930, 2.204),
}


def at_level(y: float, limit: float | None) -> tuple[Bounds, Slice]:
    """The bounds and the slice X, Z of a level."""
    origin = np.array([0.0, y, 0.0, 0.0, 0.0, 0.0, 1.0])
    return Bounds(BASE, BODY, origin, limit), Slice(origin, XZ, 40.0)


def test_thesis_5_3_determinant_in_closed_form() -> None:
    rng = np.random.default_rng(0)
    poses = np.column_stack([rng.uniform(-2.0, 2.0, (200, 3)), np.tile(HERE[3:], (200, 1))])
    x, y, z = poses[:, :3].T
    lengths = singularity.link_rows(BASE, BODY, poses)[1].prod(axis=1)
    expected = 128.0 * (z + 4.0) * ((z + 4.0) ** 2 - (x - y) ** 2) / lengths
    np.testing.assert_allclose(singularity.determinants(BASE, BODY, poses), expected, rtol=1e-11, atol=1e-12)
    np.testing.assert_allclose(singularity.determinants(BASE, BODY, np.array([0.3, 0.2, -0.7, *HERE[3:]])), 1.789580, atol=1e-6)
    np.testing.assert_allclose(singularity.gradients(BASE, BODY, HERE), [0, 0, -2.5, 0, -0.5, 0], atol=1e-12)
    np.testing.assert_allclose(np.degrees(singularity.link_pressure_angles(BASE, BODY, HERE)), [0, 45, 0, 0, 0, 0], atol=1e-5)


@pytest.mark.parametrize(("level", "limit"), TABLE)
def test_thesis_5_3_radii(level: float, limit: float | None) -> None:
    rays = np.column_stack([np.cos(np.radians(BETA)), np.sin(np.radians(BETA))])
    np.testing.assert_allclose(first_met(*at_level(level, limit), rays), TABLE[level, limit], atol=6e-4)


def test_thesis_5_3_boundary_by_following() -> None:
    """Closed with the limit of 84 degrees, open at the top without it; every point on it, and met by the rays."""
    level = 1.0
    bounds, plane = at_level(level, LIMIT)
    found = boundary(bounds, plane, np.array([0.2, -1.0]), 0.5)
    assert found.closed
    values = bounds.values(plane.poses(found.places))
    np.testing.assert_allclose(values.min(axis=1), 0.0, atol=1e-9)
    angles = np.degrees([singularity.link_pressure_angles(BASE, BODY, p).max() for p in plane.poses(found.places)])
    np.testing.assert_allclose(angles, 84.0, atol=1e-5)
    rays = found.places / np.linalg.norm(found.places, axis=1, keepdims=True)
    met = first_met(bounds, plane, rays)
    # rays that graze an edge are blunt there
    assert (np.abs(met / np.linalg.norm(found.places, axis=1) - 1.0) < 1e-6).mean() > 0.97
    # by counting nodes; below z = -4 lies another cell, which is not reached
    a, b = (axis.ravel() for axis in np.meshgrid(np.arange(-30.0, 30.0, 0.25), np.arange(-3.9, 35.0, 0.25)))
    counted = float(bounds.inside(plane.poses(np.column_stack([a, b]))).sum()) * 0.25**2
    assert found.area_mm2 == pytest.approx(counted, rel=0.01)
    free, plane = at_level(level, None)
    opened = boundary(free, plane, np.array([0.2, -1.0]), 0.5)
    assert not opened.closed
    assert opened.area_mm2 is None
    x, z = opened.places.T
    # the cell without singular poses: z + 4 > |x - y|
    np.testing.assert_allclose(z + 4.0, np.abs(x - level), atol=1e-6)
    clear = z + 4.0 > 1e-3
    assert clear.mean() > 0.95
    np.testing.assert_allclose(z[clear] + 4.0, np.abs(x - level)[clear], atol=1e-9)
    assert np.abs(opened.places[[0, -1]]).max(axis=1).min() > plane.reach_mm


@pytest.mark.parametrize(("plane", "level", "reach"), [("xz", 0.25, 25.0), ("xy", -3.0, 8.0)])
def test_thesis_5_3_cell_has_both_its_edges_at_every_level(plane: str, level: float, reach: float) -> None:
    """The cell of the origin is z + 4 > |x - y|: its edges meet in a point with those of other cells, or never."""
    pieces, said = slices(Bounds(BASE, BODY, HERE, None), HERE, plane, [level], reach_mm=reach)
    assert said == []
    x, y, z = np.vstack([piece.places for piece in pieces]).T
    np.testing.assert_allclose(z + 4.0, np.abs(x - y), atol=1e-5)
    assert not any(piece.closed or piece.hole for piece in pieces)
    a, b = ("xyz".index(axis) for axis in plane)
    for way in np.column_stack([np.cos(np.radians(BETA)), np.sin(np.radians(BETA))]):
        step = np.zeros(3)
        step[[a, b]] = way
        start = np.where(np.arange(3) == 3 - a - b, level, 0.0)
        # (z + 4) - |x - y| along the ray is the lesser of two straight lines
        rates = [step[2] - sign * (step[0] - step[1]) for sign in (1.0, -1.0)]
        values = [start[2] + 4.0 - sign * (start[0] - start[1]) for sign in (1.0, -1.0)]
        met = min((-value / rate for value, rate in zip(values, rates, strict=True) if rate < 0.0), default=np.inf)
        if met < 0.98 * reach:
            ends = [np.vstack([piece.places[:-1], piece.places[1:]]).reshape(2, -1, 3)[..., [a, b]] for piece in pieces]
            assert min(float(_apart(met * way, *one).min()) for one in ends) < 1e-4 * reach


def _apart(place: FloatArray, begin: FloatArray, end: FloatArray) -> FloatArray:
    """(n,) distances of a place from straight lines."""
    way = end - begin
    part = np.clip(((place - begin) * way).sum(axis=1) / np.maximum((way**2).sum(axis=1), 1e-300), 0.0, 1.0)
    return np.asarray(np.linalg.norm(begin + part[:, None] * way - place, axis=1))


def _enclosed(polygon: FloatArray, places: FloatArray) -> BoolArray:
    """(n,) whether a polygon encloses places, by the even-odd rule."""
    (x, y), (u, v) = polygon.T[:, :, None], np.roll(polygon, -1, axis=0).T[:, :, None]
    a, b = places.T
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = ((y > b) != (v > b)) & (a < x + (b - y) * (u - x) / (v - y))
    return np.asarray(crossed.sum(axis=0) % 2 == 1)


def test_a_cell_beyond_singular_poses_is_no_part_of_the_workspace() -> None:
    """At z = -5 the determinant has the sign of the pose's where |x - y| > 1, and every way there is singular somewhere."""
    pieces, said = slices(Bounds(BASE, BODY, HERE, None), HERE, "xy", [-5.0], reach_mm=8.0)
    assert pieces == []
    assert said == ["boundary at z = -5 mm: no position of the window is within the limits"]


def test_a_hole_is_followed_and_said_to_be_one() -> None:
    """Lengths from 7 mm on: the platform may come near no base point."""
    base = np.array([(np.cos(t), np.sin(t), 0.0) for t in np.radians([5, 115, 125, 235, 245, 355])]) * 10.0
    body = np.array([(np.cos(t), np.sin(t), 0.0) for t in np.radians([55, 65, 175, 185, 295, 305])])
    pose = np.array([-4.0, 0.0, 6.0, 0.0, 0.0, 0.0, 1.0])
    bounds = Bounds(base, body, pose, None, (7.0, 25.0))
    pieces, _ = slices(bounds, pose, "xy", [6.0], reach_mm=30.0)
    rng = np.random.default_rng(1)
    places = np.column_stack([rng.uniform(-12.0, 12.0, (4000, 2)), np.full(4000, 6.0), np.tile(HERE[3:], (4000, 1))])
    holes = [piece for piece in pieces if piece.hole]
    assert holes
    for hole in holes:
        assert hole.closed
        within = _enclosed(hole.places[:, :2], places[:, :2])
        assert within.any()
        assert not bounds.inside(places[within]).any()


def test_lengths_bound_too_and_limits_take_over_from_each_other() -> None:
    origin = HERE
    bounds = Bounds(BASE, BODY, origin, LIMIT, (2.5, 6.0))
    found = boundary(bounds, Slice(origin, XZ, 40.0), np.array([0.3, -1.0]), 0.1)
    assert found.closed
    met = {bounds.names[int(k)] for k in found.limit}
    assert {f"link {i} long" for i in (2, 3, 4)} < met <= {f"link {i} {way}" for i in (2, 3, 4, 5) for way in ("short", "long")}
    np.testing.assert_allclose(bounds.values(Slice(origin, XZ, 40.0).poses(found.places)).min(axis=1), 0.0, atol=1e-9)


def test_limits_in_several_orientations_are_those_of_the_body_so_turned() -> None:
    turns, poses = (Rotation.random(3, rng=np.random.default_rng(seed)) for seed in (0, 1))
    places = np.random.default_rng(2).uniform(-0.5, 0.5, (3, 3))
    one, every = (Bounds(BASE, BODY, HERE, LIMIT, (1.0, 9.0), turns=turned) for turned in (None, turns.as_quat()))
    found = every.values(np.column_stack([places, poses.as_quat()])).reshape(3, 3, -1)
    for i in range(3):
        for k in range(3):
            expected = one.values(np.r_[places[i], (turns[k] * poses[i]).as_quat()])
            np.testing.assert_allclose(found[i, k], expected, rtol=1e-9, atol=1e-12)
    assert every.names[len(one.names)] == f"{one.names[0]} in orientation 2"


class Lens(Bounds):
    """Kept within two circles of radius 10 mm, 12 mm apart: what is between is known in closed form."""

    def values(self, poses: FloatArray) -> FloatArray:
        away = [np.linalg.norm(poses[..., [0, 2]] - middle, axis=-1) for middle in ((6.0, 0.0), (-6.0, 0.0))]
        return 1.0 - np.stack(away, axis=-1) ** 2 / 100.0


@pytest.mark.parametrize("within", [0.1, 1e-3, 1e-6])
def test_lines_between_places_keep_what_was_asked(within: float) -> None:
    """Of two circles, by their sagittas, and corners where they meet."""
    found = boundary(Lens(BASE, BODY, HERE, None), Slice(HERE, XZ, 40.0), np.array([1.0, 0.1]), 2.0, within_mm=within)
    assert found.closed
    assert np.linalg.norm(found.places - (0.0, 8.0), axis=1).min() < 1e-6
    begin, end = found.places, np.roll(found.places, -1, axis=0)
    t = np.linspace(0.0, 1.0, 17)[:, None, None]
    lines = (1.0 - t) * begin + t * end
    inside = 10.0 - np.maximum(*(np.linalg.norm(lines - middle, axis=-1) for middle in ((6.0, 0.0), (-6.0, 0.0))))
    assert inside.min() > -1e-9
    assert 0.2 * within < inside.max() <= within + 1e-9
    assert found.off_mm == pytest.approx(inside.max(), rel=0.1)
    assert found.area_mm2 == pytest.approx(200.0 * np.arccos(0.6) - 96.0, rel=within)


def test_thesis_5_3_lines_keep_what_was_asked() -> None:
    within = 1e-3
    bounds, plane = at_level(1.0, LIMIT)
    found = boundary(bounds, plane, np.array([0.2, -1.0]), 0.5, within_mm=within)
    assert found.closed
    assert found.off_mm <= within
    begin, end = found.places, np.roll(found.places, -1, axis=0)
    normal = np.column_stack([begin[:, 1] - end[:, 1], end[:, 0] - begin[:, 0]]) / np.linalg.norm(end - begin, axis=1)[:, None]
    for t in (0.13, 0.37, 0.5, 0.81):
        # a tolerance to the left of the line is inside and to the right of it outside
        on = (1.0 - t) * begin + t * end
        assert bounds.inside(plane.poses(on + 1.1 * within * normal)).all()
        assert not bounds.inside(plane.poses(on - 1.1 * within * normal)).any()


class Cliff(Bounds):
    """Kept within a radius of 10 mm, and nowhere telling in which direction that is."""

    def values(self, poses: FloatArray) -> FloatArray:
        return np.where(np.linalg.norm(poses[..., :3], axis=-1) < 10.0, 1.0, -1.0)[..., None]

    def rates(self, pose: FloatArray, directions: FloatArray) -> FloatArray:
        return np.zeros((1, len(directions)))


def test_a_limit_without_a_slope_has_no_boundary() -> None:
    with pytest.raises(StructureError, match="has no tangent where the ray meets it"):
        boundary(Cliff(BASE, BODY, HERE, None), Slice(HERE, XZ, 40.0), np.array([1.0, 0.0]), 0.1)


def test_what_cannot_be_bounded_is_refused() -> None:
    with pytest.raises(StructureError, match="do not fix"):
        Bounds(BASE, BODY, np.array([0.0, 0.0, -4.0, 0.0, 0.0, 0.0, 1.0]))
    bounds, plane = at_level(0.0, None)
    with pytest.raises(StructureError, match="nothing is met within 40 mm"):
        boundary(bounds, plane, np.array([0.0, 1.0]), 0.2)
    with pytest.raises(StructureError, match="starting position itself is outside the limits"):
        boundary(Bounds(BASE, BODY, HERE, np.radians(10.0)), plane, np.array([0.0, -1.0]), 0.2)


# thesis 5.2, table 5.2
BASE2 = np.array([(0.25, -0.75, -1.3), (2.3, -0.85, 0.5), (1.25, -0.8, 1.5), (-1, 0, 1.2), (-2.5, 0, 0), (-1, 0, -1.1)])
BODY2 = np.array([(0.6, -0.4, 1.1), (2, -0.4, 0.3), (0.9, -0.4, 1.35), (-1, -1, 0), (-1, -1, 0), (-1, -1, 0)])


def parabola(t: FloatArray) -> FloatArray:
    """(n, 7) the commanded path of 5.2."""
    return np.column_stack([t, t**2 + 1.0, np.zeros_like(t), np.tile(HERE[3:], (len(t), 1))])


def test_thesis_5_2_determinants_along_the_path() -> None:
    t = np.array([-0.06, -0.05, -0.04, 0.04, 0.05, 0.06, -0.02, 0.02, -2.0, 2.0, 0.0])
    found = np.abs(singularity.determinants(BASE2, BODY2, parabola(t)))
    expected = [0.030071, 0.020736, 0.013175, 0.012319, 0.019066, 0.027186, 0.003244, 0.003137, 0.335043, 0.163718, 0.0]
    np.testing.assert_allclose(found, expected, atol=2e-6)


def test_thesis_5_2_where_the_determinant_is_small() -> None:
    """Below 0.015 and 0.01 in narrower intervals than the published -0.06 to 0.06, with P1 as printed and with a minus that may be lost."""

    def interval(body: FloatArray, least: float) -> tuple[float, float]:
        def over(t: float) -> float:
            return float(np.abs(singularity.determinants(BASE2, body, parabola(np.array([t])))[0])) - least

        return brentq(over, -0.1, -1e-4), brentq(over, 1e-4, 0.1)

    assert interval(BODY2, 0.015) == pytest.approx((-0.04264, 0.04423), abs=1e-5)
    assert interval(BODY2, 0.010) == pytest.approx((-0.03491, 0.03597), abs=1e-5)
    lost = BODY2 * np.where(np.arange(6)[:, None] == 0, [1.0, 1.0, -1.0], 1.0)
    assert interval(lost, 0.015) == pytest.approx((-0.04791, 0.04976), abs=1e-5)
    t = np.array([-0.06, -0.05, -0.04, 0.04, 0.05, 0.06])
    found = np.abs(singularity.determinants(BASE2, lost, parabola(t)))
    np.testing.assert_allclose(found, [0.023695, 0.016360, 0.010407, 0.009782, 0.015142, 0.021593], atol=2e-6)


def test_thesis_5_2_corrected_by_its_own_rule() -> None:
    """Where the next node is too near a singular pose, the step loses its part along the determinant's gradient: the determinant stays
    about what it was at the last good node. `detour` leads as far away as it must instead."""
    t = np.arange(-200, 201) / 100.0
    path, poses = parabola(t), parabola(t[:1])
    good = np.abs(singularity.determinants(BASE2, BODY2, path)) >= 0.015
    for i in range(1, len(t)):
        pose = path[i].copy()
        if not good[i]:
            e = singularity.gradients(BASE2, BODY2, poses[-1])[3:]
            step = path[i, :3] - path[i - 1, :3]
            pose[:3] = poses[-1, :3] + step - (step @ e) / (e @ e) * e
        poses = np.vstack([poses, pose])
    at = [196, 200, 204]  # t = -0.04, 0, 0.04
    np.testing.assert_allclose(poses[at, 1], [1.00252, 1.00260, 1.00269], atol=6e-6)
    np.testing.assert_allclose(np.abs(singularity.determinants(BASE2, BODY2, poses[at])), [0.020734, 0.020722, 0.020710], atol=6e-7)


def test_thesis_5_2_path_led_around() -> None:
    t = np.arange(-200, 201) / 100.0
    path = parabola(t)
    # what the thesis' rule leaves of the determinant, and a deviation no larger than its
    bounds = Bounds(BASE2, BODY2, path[0], determinant=0.0207)
    found = detour(bounds, path)
    values = np.abs(singularity.determinants(BASE2, BODY2, found.poses))
    assert values.min() >= 0.0207 - 1e-9
    assert 0.0 < found.deviation_mm.max() <= 0.0026
    np.testing.assert_array_equal(found.poses[[0, -1]], path[[0, -1]])
    kept = np.abs(singularity.determinants(BASE2, BODY2, path)) >= 0.0207
    inner = found.parameter == np.rint(found.parameter)
    assert (found.norm_mm[inner][kept] == 0.0).all()
    # a limit of the determinant is none of the angle
    worst = max(np.degrees(singularity.link_pressure_angles(BASE2, BODY2, p).max()) for p in found.poses)
    assert worst > 84.0


def test_a_path_led_around_a_limit_angle_keeps_it_everywhere() -> None:
    t = np.linspace(-1.0, 1.0, 41)
    path = np.column_stack([0.2 + 0.2 * t, np.zeros(41), -2.6 + 2.4 * t**2, np.tile(HERE[3:], (41, 1))])
    limit = np.radians(50.0)
    bounds = Bounds(BASE, BODY, HERE, limit)
    assert not bounds.inside(path).all()
    found = detour(bounds, path)
    pairs = zip(found.poses, found.poses[1:], strict=False)
    steps = np.concatenate([[se3.displaced(a, s * se3.displacement(b, a)) for s in np.linspace(0, 1, 5)] for a, b in pairs])
    worst = np.array([singularity.link_pressure_angles(BASE, BODY, p).max() for p in steps])
    assert worst.max() <= limit + 1e-6
    assert found.norm_mm.max() > 0.0


@laws
@given(st.integers(0, 2**32 - 1))
def test_the_pose_led_to_is_the_nearest(seed: int) -> None:
    rng = np.random.default_rng(seed)
    bounds = Bounds(BASE, BODY, HERE, np.radians(50.0))
    pose = se3.displaced(HERE, rng.normal(size=6) * np.repeat([0.25, 0.8], 3))
    rim = singularity.rim_mm(BODY)
    try:
        out = nearest_pose(bounds, pose)
    except StructureError:
        return
    weight = np.repeat([rim, 1.0], 3)
    least = float(np.linalg.norm(se3.displacement(out, pose) * weight))
    assert (bounds.values(out) >= -1e-9).all()
    if least == 0.0:
        return
    # nothing nearer among draws around it
    way = se3.displacement(out, pose)
    for size in (1e-3, 1e-2, 0.1):
        others = se3.displaced(pose, (way + rng.normal(size=(400, 6)) * size / weight) * 0.999)
        near = np.linalg.norm(se3.displacement(others, np.tile(pose, (400, 1))) * weight, axis=1) < least * 0.999
        assert not bounds.inside(others[near]).any()


def test_a_path_that_ends_beyond_a_limit_or_crosses_it_is_refused() -> None:
    bounds = Bounds(BASE, BODY, HERE, np.radians(60.0))
    beyond = np.array([0.0, 0.0, -4.5, 0.0, 0.0, 0.0, 1.0])
    with pytest.raises(StructureError, match="sample 2, an end"):
        detour(bounds, np.stack([HERE, beyond]))
