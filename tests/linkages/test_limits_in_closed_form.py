"""Boundaries and detours of limits that are known in closed form: walls, circles, wedges, pillars."""

from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from lmeasure.core import FloatArray, StructureError, se3
from lmeasure.linkages import Bounds, Slice, boundary, detour, detours, first_met, rim_mm, workspace
from lmeasure.linkages.detours import at, nearest_pose

HERE = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
BODY = np.array([(0, -90, 10), (120, 0, -20), (0, 150, 0), (-30, -80, 40), (60, 20, -50), (-100, 40, 0)], dtype=float)
BASE = 3.0 * np.array(
    [(0, -500, 300), (450, 0, -350), (-100, 620, 200), (-300, -410, -400), (250, 330, 500), (-480, 100, -300)], dtype=float
)
RIM = rim_mm(BODY)
assert 0.1 * rim_mm(BASE) > RIM  # so that it tells which of them counts a turn
ACROSS = np.array([(0.6, 0.0, 0.8), (0.0, 1.0, 0.0)])
PLANE = Slice(np.array([3.0, -2.0, 1.0, 0.0, 0.0, 0.6, 0.8]), ACROSS, 40.0)

Limit = Callable[[FloatArray], FloatArray]


def limits(*kept: Limit) -> Bounds:
    """Of poses (..., 7), positive where they are kept."""

    class Shape(Bounds):
        def values(self, poses: FloatArray) -> FloatArray:
            return np.stack([one(poses) for one in kept], axis=-1)

        @property
        def names(self) -> tuple[str, ...]:
            return tuple(f"limit {i + 1}" for i in range(len(kept)))

    return Shape(BASE, BODY, HERE)


def across(kept: Callable[[FloatArray, FloatArray], FloatArray]) -> Limit:
    """A limit of the coordinates in the slice."""
    return lambda poses: kept(*np.moveaxis((poses[..., :3] - PLANE.origin[:3]) @ ACROSS.T, -1, 0))


def within(radius: float, a: float = 0.0, b: float = 0.0) -> Limit:
    return across(lambda x, y: (radius**2 - (x - a) ** 2 - (y - b) ** 2) / radius**2)


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    """None of these boundaries has so many points: one that goes astray is seen soon."""
    monkeypatch.setattr(workspace, "MOST", 200)


def area(places: FloatArray) -> float:
    a, b = places.T
    return float(np.sum(a * np.roll(b, -1) - b * np.roll(a, -1))) / 2.0


# rays


def test_rays_meet_a_circle_and_a_wall_where_these_are() -> None:
    wall = across(lambda x, y: 1.0 - y / 7.0)
    rays = np.array([(3.0, 0.0), (0.0, 0.5), (-2.0, 0.0), (0.0, -1.0), (1.0, 1.0)])
    found = first_met(limits(within(10.0, 2.0), wall), PLANE, rays)
    np.testing.assert_allclose(found, [12.0, 7.0, 8.0, np.sqrt(96.0), 7.0 * np.sqrt(2.0)], atol=1e-11)
    assert first_met(limits(within(39.9)), PLANE, rays[:1])[0] == pytest.approx(39.9, abs=1e-11)
    np.testing.assert_array_equal(first_met(limits(within(40.1)), PLANE, rays[:2]), [np.inf, np.inf])
    # met before the first place of the march, and where nothing is known beyond
    assert first_met(limits(within(0.03)), PLANE, rays[:1])[0] == pytest.approx(0.03, abs=1e-12)
    assert first_met(limits(within(0.15)), PLANE, rays[:1])[0] == pytest.approx(0.15, abs=1e-12)
    known = limits(across(lambda x, y: np.sqrt(5.0 - x)))
    assert first_met(known, PLANE, rays[:1])[0] == pytest.approx(5.0, abs=1e-11)


@pytest.mark.parametrize(("inner", "outer", "seen"), [(5.02, 5.095, False), (5.02, 5.105, True), (0.05, 0.15, True)])
def test_a_ring_narrower_than_a_400th_of_the_reach_may_be_stepped_over(inner: float, outer: float, seen: bool) -> None:
    ring = across(lambda x, y: np.where((np.hypot(x, y) > inner) & (np.hypot(x, y) < outer), -1.0, 1.0))
    assert first_met(limits(ring), PLANE, np.array([[1.0, 0.0]]))[0] == pytest.approx(inner if seen else np.inf, abs=1e-11)


# Newton's method


# boundaries


@pytest.mark.parametrize("direction", [(1.0, 0.2), (-0.4, 3.0)])
def test_a_circle_is_followed_around_with_the_inside_on_the_left(direction: tuple[float, float]) -> None:
    found = boundary(limits(within(10.0, 2.0, -1.0)), PLANE, np.array(direction), 1.5, within_mm=10.0)
    assert found.closed
    np.testing.assert_allclose(np.linalg.norm(found.places - (2.0, -1.0), axis=1), 10.0, atol=1e-9)
    assert area(found.places) > 0.0
    steps = np.linalg.norm(np.roll(found.places, -1, axis=0) - found.places, axis=1)
    # a step along the tangent, put back onto the circle; the last one ends at the first place
    assert (steps <= 1.5).all()
    assert steps[:-1].min() > 1.4
    assert len(steps) == int(np.ceil(2.0 * np.pi * 10.0 / (10.0 * np.arctan(0.15))))
    # the ray is where it begins
    met = first_met(limits(within(10.0, 2.0, -1.0)), PLANE, np.array([direction]))[0]
    np.testing.assert_allclose(found.places[0], met * np.array(direction) / np.linalg.norm(direction), atol=1e-9)
    assert found.off_mm == pytest.approx(10.0 - np.sqrt(100.0 - (steps.max() / 2.0) ** 2), rel=0.02)
    assert found.area_mm2 == area(found.places)
    np.testing.assert_array_equal(found.limit, 0)


def test_a_wall_is_followed_to_both_edges_of_the_window() -> None:
    found = boundary(limits(across(lambda x, y: 2.0 - (0.6 * x + 0.8 * y))), PLANE, np.array([1.0, 0.0]), 3.0)
    assert not found.closed
    assert found.area_mm2 is None
    np.testing.assert_allclose(found.places @ [0.6, 0.8], 2.0, atol=1e-9)
    along = found.places @ [-0.8, 0.6]
    assert (np.diff(along) > 0.0).all()  # the inside on the left
    np.testing.assert_allclose(np.diff(along), 3.0, atol=1e-8)
    beyond = np.abs(found.places).max(axis=1) > 40.0
    np.testing.assert_array_equal(np.flatnonzero(beyond), [0, len(beyond) - 1])
    assert found.off_mm < 1e-9
    # the place that the ray meets is there once
    assert (np.linalg.norm(found.places - (10.0 / 3.0, 0.0), axis=1) < 1e-9).sum() == 1


def test_limits_take_over_from_each_other_at_their_corners() -> None:
    """A rectangle, whose limits have slopes and units of their own."""
    sides: list[Callable[[FloatArray, FloatArray], FloatArray]] = [
        lambda x, y: (4.0 - x) * 0.3, lambda x, y: (3.0 + x) * 2.0, lambda x, y: 6.0 - y, lambda x, y: (5.0 + y) * 0.1,
    ]  # fmt: skip
    bounds = limits(*(across(side) for side in sides))
    found = boundary(bounds, PLANE, np.array([1.0, 0.0]), 2.5)
    assert found.closed
    assert found.area_mm2 == pytest.approx(77.0, abs=1e-7)
    corners = np.array([(4.0, 6.0), (-3.0, 6.0), (-3.0, -5.0), (4.0, -5.0)])
    where = [int(np.linalg.norm(found.places - corner, axis=1).argmin()) for corner in corners]
    assert where == sorted(where)
    np.testing.assert_allclose(found.places[where], corners, atol=1e-8)
    # a place has the limit that is met there
    values = np.abs(bounds.values(PLANE.poses(found.places)))
    np.testing.assert_allclose(values[np.arange(len(values)), found.limit], 0.0, atol=1e-9)
    assert set(found.limit.tolist()) == {0, 1, 2, 3}
    assert found.off_mm < 1e-8
    assert np.linalg.norm(np.diff(found.places, axis=0), axis=1).max() <= 2.5 + 1e-9


def test_a_step_longer_than_what_is_walked_around_is_halved() -> None:
    """A circle of a tenth of it; and a rectangle's corner that is cut off, where a step would end beyond both limits that meet there."""
    found = boundary(limits(within(0.5)), PLANE, np.array([1.0, 0.0]), 5.0)
    assert found.closed
    assert found.area_mm2 == pytest.approx(np.pi / 4.0, rel=0.02)
    # a step goes along the tangent, and back to the circle
    found = boundary(limits(within(0.5)), PLANE, np.array([1.0, 0.0]), 5.0, within_mm=1.0)
    first = 0.5 * np.tan(2.0 * np.arcsin(np.linalg.norm(found.places[1] - found.places[0])))
    assert np.log2(5.0 / first) == pytest.approx(np.round(np.log2(5.0 / first)), abs=1e-6)
    cut = limits(
        across(lambda x, y: 4.0 - x), across(lambda x, y: 10.0 * (6.0 - y)), across(lambda x, y: 9.9 - x - y), across(lambda x, y: 5.0 + y),
        across(lambda x, y: 3.0 + x),
    )  # fmt: skip
    found = boundary(cut, PLANE, np.array([1.0, 0.0]), 2.5)
    assert found.closed
    assert found.area_mm2 == pytest.approx(77.0 - 0.005, abs=1e-6)
    x, y = found.places.T
    # upwards from (4, 0) a quarter of a step is the longest that ends before the cut; behind it each is twice the one before
    np.testing.assert_allclose(y[np.isclose(x, 4.0) & (y > 0.0)], [2.5, 5.0, 5.625, 5.9], atol=1e-9)
    ways = np.abs(np.diff(x[np.isclose(y, 6.0)]))
    np.testing.assert_allclose(ways[1:-1], np.minimum(2.0 * ways[:-2], 2.5), atol=1e-9)


@pytest.mark.parametrize(("half_deg", "from_tip"), [(5.0, 0.0), (5.0, 1e-5), (5.0, 0.001), (5.0, 0.7), (5.0, 1.2), (45.0, 0.001)])
@pytest.mark.parametrize("edge", [1.0, -1.0], ids=["towards", "away"])
def test_a_wedge_is_walked_around_to_its_tip(half_deg: float, from_tip: float, edge: float) -> None:
    """Begun beside the tip: where it is pointed the other edge passes near the place where the walk began."""
    steep = np.tan(np.radians(half_deg))
    bounds = limits(across(lambda x, y: steep * (6.0 - x) - y), across(lambda x, y: steep * (6.0 - x) + y), across(lambda x, y: 5.0 + x))
    found = boundary(bounds, PLANE, np.array([6.0 - from_tip, edge * steep * from_tip]), 0.6)
    assert found.closed
    assert found.area_mm2 == pytest.approx(121.0 * steep, abs=1e-4)
    assert np.linalg.norm(found.places - [6.0, 0.0], axis=1).min() < (2e-5 if from_tip > 0.5 else 0.01)


@pytest.mark.parametrize("direction", [(0.0, 1.0), (0.0, -1.0), (1.0, 0.0)])
@pytest.mark.parametrize("closed", [False, True])
def test_where_a_limit_crosses_itself_the_walk_stays_on_the_same_side(direction: tuple[float, float], closed: bool) -> None:
    """A right angle before a point in which the limit has no tangent, beyond which another one begins."""
    wedge = across(lambda x, y: ((x + 5.0) ** 2 - y**2) / 25.0)
    bounds = limits(wedge, within(10.0, -5.0)) if closed else limits(wedge, across(lambda x, y: 1e9 + 0.0 * x))
    if direction == (1.0, 0.0) and not closed:
        with pytest.raises(StructureError, match="nothing is met within 40 mm in that direction"):
            boundary(bounds, PLANE, np.array(direction), 1.0)
        return
    found = boundary(bounds, PLANE, np.array(direction), 1.0)
    assert found.closed == closed
    x, y = found.places.T + np.array([[5.0], [0.0]])
    assert x.min() > -1e-3
    assert np.hypot(x, y).min() < 0.1
    values = bounds.values(PLANE.poses(found.places))
    np.testing.assert_allclose(values[np.arange(len(x)), found.limit], 0.0, atol=1e-9)
    if closed:
        assert found.area_mm2 == pytest.approx(25.0 * np.pi, rel=1e-4)
        assert set(found.limit.tolist()) == {0, 1}
    else:
        assert np.sign(y[[0, -1]]).tolist() == [1.0, -1.0]
        on = np.abs(found.places).max(axis=1) > 40.0
        np.testing.assert_array_equal(np.flatnonzero(on), [0, len(on) - 1])


def test_how_far_lines_are_beside_a_boundary_is_measured_at_their_quarters() -> None:
    """Beside y = x^3 and a line far away, whose number counts where it is nearer to being broken."""
    bounds = limits(across(lambda x, y: 3.0 * (y - x**3)), across(lambda x, y: 9.0 - x))
    begin = np.array([(-1.0, -1.0), (0.0, 0.0), (-3.0, -27.0), (8.5, 800.0)])
    way = np.array([(2.0, 2.0), (2.0, 8.0), (3.0, 27.0), (1.0, 0.0)])
    off, nearest = workspace._beside_lines(bounds, PLANE, begin, way)
    expected = []
    for start, step in zip(begin, way, strict=True):
        far = []
        for t in (0.25, 0.5, 0.75):
            x, y = start + t * step
            far.append(min(float((y - x**3) / np.hypot(1.0, 3.0 * x**2)), float(9.0 - x)))
        expected.append(np.abs(far).max())
    np.testing.assert_allclose(off, expected, rtol=1e-6)
    np.testing.assert_array_equal(nearest, [0, 0, 0, 1])
    flat = limits(across(lambda x, y: 1.0 + 0.0 * x))
    assert np.isinf(workspace._beside_lines(flat, PLANE, begin, way)[0]).all()


@pytest.mark.parametrize("within_mm", [None, 0.3])
def test_places_are_put_between_until_lines_are_near_enough(within_mm: float | None) -> None:
    ellipse = across(lambda x, y: 1.0 - (x / 20.0) ** 2 - (y / 5.0) ** 2)
    found = boundary(limits(ellipse), PLANE, np.array([1.0, 1.0]), 8.0, within_mm=within_mm)
    requested = 1e-5 * 40.0 if within_mm is None else within_mm
    assert 0.2 * requested < found.off_mm <= requested
    begin, end = found.places, np.roll(found.places, -1, axis=0)
    fine = begin + np.linspace(0.0, 1.0, 33)[:, None, None] * (end - begin)
    x, y = fine[..., 0], fine[..., 1]
    gap = (1.0 - (x / 20.0) ** 2 - (y / 5.0) ** 2) / np.hypot(x / 200.0, y / 12.5)
    assert gap.min() > -1e-9
    assert 0.2 * requested < gap.max() <= 1.2 * requested
    assert found.area_mm2 == pytest.approx(100.0 * np.pi, rel=10.0 * requested / 5.0)
    assert len(found.limit) == len(found.places)


@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize(("low", "high"), [(-0.35, 0.87), (1.9, 3.4), (-2.9, -0.4)])
def test_around_a_corner_the_boundary_goes_on_along_its_other_edge(way: float, low: float, high: float) -> None:
    """Counted from where one came, through the inside."""
    corner = np.array([3.0, -4.0])
    lower = across(lambda x, y: np.cos(low) * (y + 4.0) - np.sin(low) * (x - 3.0))
    upper = across(lambda x, y: np.sin(high) * (x - 3.0) - np.cos(high) * (y + 4.0))
    came, goes, number = (high, low, 0) if way > 0 else (low, high, 1)
    tangent = -np.array([np.cos(came), np.sin(came)])
    place, along, which, _ = workspace._around(limits(lower, upper), PLANE, corner, tangent, way, 0.5)
    np.testing.assert_allclose(along, [np.cos(goes), np.sin(goes)], atol=1e-9)
    np.testing.assert_allclose(place, corner + 0.5 * along, atol=1e-8)
    assert which == number
    for everywhere in (across(lambda x, y: 1.0 + 0.0 * x), across(lambda x, y: 0.0 * x - 1.0)):
        with pytest.raises(StructureError, match="boundary: cannot be followed beyond 3, -4 mm"):
            workspace._around(limits(everywhere), PLANE, corner, tangent, way, 0.5)


def test_a_boundary_of_too_many_points_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(workspace, "MOST", 30)
    with pytest.raises(StructureError, match=r"30 points of 1.5 mm do not reach around it. Use a longer step"):
        boundary(limits(within(10.0)), PLANE, np.array([1.0, 0.0]), 1.5)


def test_a_limit_that_is_broken_and_has_no_slope_is_infinitely_far() -> None:
    begin, way = np.array([(1.0, 2.0)]), np.array([(3.0, 1.0)])
    broken = limits(across(lambda x, y: -1.0 + 0.0 * x), across(lambda x, y: 9.0 - x))
    off, nearest = workspace._beside_lines(broken, PLANE, begin, way)
    assert np.isinf(off).all()
    assert nearest.tolist() == [0]
    # nearest to being broken in the middle, whatever is elsewhere
    two = limits(across(lambda x, y: 5.0 - x), across(lambda x, y: 5.0 - y))
    assert workspace._beside_lines(two, PLANE, np.array([(0.0, -3.0), (-3.0, 0.0)]), np.array([(3.0, 8.0), (8.0, 3.0)]))[1].tolist() == [
        0,
        1,
    ]


def test_a_walk_that_comes_to_a_cliff_ends_with_a_word() -> None:
    cliff = across(lambda x, y: np.where(x < 5.0, 1.0, -1.0))
    with pytest.raises(StructureError, match="boundary: cannot be followed beyond"):
        boundary(limits(across(lambda x, y: y + 2.0), cliff), PLANE, np.array([0.0, -1.0]), 1.0)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_around_a_corner_of_a_third_of_a_degree_one_finds_its_other_edge(way: float) -> None:
    low, high = 0.7, 0.7 + np.radians(0.3)
    corner = np.array([3.0, -4.0])
    lower = across(lambda x, y: np.cos(low) * (y + 4.0) - np.sin(low) * (x - 3.0))
    upper = across(lambda x, y: np.sin(high) * (x - 3.0) - np.cos(high) * (y + 4.0))
    came, goes = (high, low) if way > 0 else (low, high)
    _, along, which, _ = workspace._around(limits(lower, upper), PLANE, corner, -np.array([np.cos(came), np.sin(came)]), way, 0.5)
    np.testing.assert_allclose(along, [np.cos(goes), np.sin(goes)], atol=1e-9)
    assert which == (0 if way > 0 else 1)


@pytest.mark.parametrize("way", [1.0, -1.0])
def test_around_a_bent_needle_one_goes_on_along_its_other_side(way: float) -> None:
    """It covers a little where one looks first, but not the direction from which one came."""

    def off(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.abs(np.arctan2(-way * (y + 4.0), x - 3.0) - np.radians(0.5)) - np.radians(0.3)

    place, along, *_ = workspace._around(limits(across(off)), PLANE, np.array([3.0, -4.0]), np.array([-1.0, 0.0]), way, 0.5)
    np.testing.assert_allclose(np.degrees(np.arctan2(-way * (place[1] + 4.0), place[0] - 3.0)), 0.2, atol=1e-6)
    assert along[0] > 0.999


def test_where_a_boundary_cannot_be_looked_from_is_said() -> None:
    bounds = limits(within(10.0, 10.5))
    with pytest.raises(StructureError, match="starting position itself is outside the limits"):
        boundary(bounds, PLANE, np.array([1.0, 0.0]), 1.0)
    with pytest.raises(StructureError, match="nothing is met within 40 mm in that direction"):
        boundary(limits(within(50.0)), PLANE, np.array([1.0, 0.0]), 1.0)


# detours


def about_z(poses: FloatArray) -> FloatArray:
    """The turn about z [rad] of poses that are turned about z alone."""
    return np.asarray(2.0 * np.arctan2(poses[..., 5], poses[..., 6]))


def turned(x: float, y: float, z: float, angle: float) -> FloatArray:
    return np.array([x, y, z, 0.0, 0.0, np.sin(angle / 2.0), np.cos(angle / 2.0)])


@pytest.mark.parametrize("short", [0.5, 130.0])
def test_the_nearest_pose_shifts_and_turns_as_the_rim_counts(short: float) -> None:
    """Of x + r a >= c the least dx^2 + (rim da)^2."""
    r, c = 70.0, 300.0
    pose = turned(c - short - r * 0.2, 40.0, -20.0, 0.2)
    found = nearest_pose(limits(lambda p: (p[..., 0] + r * about_z(p) - c) / 50.0), pose)
    dx = short / (1.0 + (r / RIM) ** 2)
    np.testing.assert_allclose(found, turned(pose[0] + dx, 40.0, -20.0, 0.2 + dx * r / RIM**2), atol=1e-6)
    shifted = nearest_pose(limits(lambda p: (p[..., 0] + r * about_z(p) - c) / 50.0), pose, turns=False)
    np.testing.assert_allclose(shifted, turned(pose[0] + short, 40.0, -20.0, 0.2), atol=1e-6)


def test_the_nearest_pose_keeps_every_limit_by_the_margin() -> None:
    """x >= 2 and x + 2 y >= 6: from the origin their corner, though the nearest place on the second is (1.2, 2.4)."""
    bounds = limits(lambda p: (p[..., 0] - 2.0) / 4.0, lambda p: 7.0 * (p[..., 0] + 2.0 * p[..., 1] - 6.0))
    np.testing.assert_allclose(nearest_pose(bounds, HERE)[:3], [2.0, 2.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(nearest_pose(bounds, HERE, 0.5)[:3], [4.0, (6.0 + 0.5 / 7.0 - 4.0) / 2.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(nearest_pose(bounds, HERE, 0.0, aim=0.25)[:3], [3.0, (6.0 + 0.25 / 7.0 - 3.0) / 2.0, 0.0], atol=1e-8)
    np.testing.assert_allclose(nearest_pose(bounds, HERE, start=turned(9.0, -3.0, 2.0, 0.3))[:3], [2.0, 2.0, 0.0], atol=1e-8)
    # what keeps its limits, be it just so, stays
    for x, margin in ((2.0, 0.0), (4.0, 0.5)):
        on = turned(x, 9.0, 0.0, 0.1)
        assert nearest_pose(bounds, on, margin, aim=3.0) is on


@pytest.mark.parametrize(
    "kept",
    [
        (lambda p: p[..., 0] - 1.0, lambda p: -1.0 - p[..., 0]),
        (lambda p: 0.0 * p[..., 0] - 1.0,),
        (lambda p: np.where(p[..., 0] > 0.5, np.nan, p[..., 0] - 1.0),),
        (lambda p: np.where(p[..., 0] > 1e-6, np.nan, p[..., 0] - 1.0),),
        (lambda p: -1.0 - p[..., 0] ** 2,),
    ],
    ids=["contradiction", "no slope", "not known", "not known beside it", "nowhere"],
)
def test_limits_that_no_pose_keeps_are_reported(kept: tuple[Limit, ...]) -> None:
    with pytest.raises(StructureError, match="no pose near the commanded one keeps the limits"):
        nearest_pose(limits(*kept), HERE)


def path(*xya: tuple[float, float, float]) -> FloatArray:
    return np.array([turned(x, y, 5.0, a) for x, y, a in xya])


def test_a_path_into_a_wall_is_led_along_it() -> None:
    command = path((30.0, 0.0, 0.0), (20.0, 40.0, 0.1), (4.0, 80.0, 0.2), (25.0, 120.0, 0.3), (30.0, 160.0, 0.2))
    found = detour(limits(lambda p: (p[..., 0] - 10.0) / 100.0), command)
    expected = command.copy()
    expected[2, 0] = 10.0
    np.testing.assert_array_equal(found.parameter, np.arange(5.0))
    np.testing.assert_allclose(found.poses, expected, atol=1e-6)
    np.testing.assert_allclose(found.deviation_mm, [0.0, 0.0, 6.0, 0.0, 0.0], atol=1e-6)
    np.testing.assert_allclose(found.deviation_rad, 0.0, atol=1e-9)
    np.testing.assert_allclose(found.norm_mm, [0.0, 0.0, 6.0, 0.0, 0.0], atol=1e-6)
    # turned into one: a turn counts at the rim
    found = detour(limits(lambda p: 0.25 - about_z(p)), command)
    np.testing.assert_allclose(found.deviation_rad[found.parameter == 3.0], 0.05, atol=1e-8)
    np.testing.assert_allclose(found.norm_mm, np.hypot(found.deviation_mm, RIM * found.deviation_rad), atol=1e-9)
    assert found.norm_mm.max() == pytest.approx(0.05 * RIM, rel=1e-6)
    # nearer than the margin is too near
    found = detour(limits(lambda p: (p[..., 0] - 10.0) / 100.0), command, 0.12)
    np.testing.assert_allclose(found.poses[found.parameter == 2.0, 0], 22.0, atol=1e-6)
    np.testing.assert_allclose(found.poses[found.parameter == 1.0, 0], 22.0, atol=1e-6)


@pytest.mark.parametrize(("samples", "turns"), [(9, False)])
def test_a_path_through_a_round_pillar_is_led_around_it(samples: int, turns: bool) -> None:
    pillar = limits(lambda p: (np.hypot(p[..., 0], p[..., 1]) - 100.0) / 100.0)
    command = path(*((x, 55.0, 0.0) for x in np.linspace(-160.0, 160.0, samples)))
    found = detour(pillar, command, turns=turns)
    wanted = np.array([at(command, t) for t in found.parameter])
    np.testing.assert_allclose(found.deviation_mm, np.linalg.norm(found.poses[:, :3] - wanted[:, :3], axis=1), atol=1e-9)
    # straight out from the axis, or left alone
    inside = np.hypot(wanted[:, 0], wanted[:, 1]) < 100.0
    cosine = (found.poses[:, :2] * wanted[:, :2]).sum(axis=1) / np.prod([np.hypot(*p[:, :2].T) for p in (found.poses, wanted)], axis=0)
    np.testing.assert_allclose(cosine[inside], 1.0, atol=1e-9)
    np.testing.assert_array_equal(found.poses[~inside], wanted[~inside])
    radius = np.hypot(*found.poses[inside, :2].T)
    assert 100.0 < radius.min() <= radius.max() < 101.0
    assert np.ptp(radius) < 1e-6
    # between its poses it keeps the pillar as nearly as is stated, in parts of 100 mm
    between = np.array([at(np.stack(two), t) for two in pairwise(found.poses) for t in (0.25, 0.5, 0.75)])
    assert pillar.values(between).min() >= -1e-7
    # and the poses are no farther out than the chords between them ask, about
    half = np.diff(found.parameter[np.flatnonzero(inside)]).max() * 320.0 / (samples - 1) / 2.0
    assert radius.max() - 100.0 < 2.5 * (100.0 - np.sqrt(100.0**2 - half**2)) * 100.0**2 / 55.0**2
    # halved three times, where it had to be
    assert np.diff(found.parameter).min() == 0.125
    np.testing.assert_array_equal(found.parameter, np.rint(8.0 * found.parameter) / 8.0)


def test_ends_beyond_a_limit_are_named() -> None:
    bounds = limits(lambda p: p[..., 0] - 2.0, lambda p: p[..., 0] + p[..., 1])
    for k, bad in enumerate([(1.0, 0.0, 0.0), (3.0, -4.0, 0.0)]):
        ways = [path(bad, (5.0, 0.0, 0.0), (6.0, 0.0, 0.0)), path((5.0, 0.0, 0.0), (6.0, 0.0, 0.0), bad)]
        for command, sample in zip(ways, (1, 3), strict=True):
            with pytest.raises(StructureError, match=rf"path: sample {sample}, an end, is beyond a limit itself: limit {k + 1}$"):
                detour(bounds, command)
    just = path((2.0, 0.0, 0.0), (5.0, 0.0, 0.0), (2.5, 1.0, 0.0))
    np.testing.assert_array_equal(detour(bounds, just).poses, just)
    with pytest.raises(StructureError, match="sample 1, an end"):
        detour(bounds, just, 1e-6)


def test_poses_between_two_are_on_a_straight_way_and_turned_about_one_axis() -> None:
    rng = np.random.default_rng(2)
    turns = Rotation.random(4, rng=rng)
    poses = np.column_stack([rng.normal(size=(4, 3)) * 100.0, turns.as_quat()])
    for t in (0.0, 0.3, 1.0, 1.75, 2.5, 3.0):
        k = min(int(t), 2)
        found = at(poses, t)
        np.testing.assert_allclose(found[:3], poses[k, :3] + (t - k) * (poses[k + 1, :3] - poses[k, :3]), atol=1e-9)
        assert (Rotation.from_quat(found[3:]) * Slerp(np.arange(4.0), turns)(t).inv()).magnitude() < 1e-9
    way = detours._ways(poses, 80.0)
    for i in range(3):
        shift, turn = np.linalg.norm(poses[i + 1, :3] - poses[i, :3]), (turns[i + 1] * turns[i].inv()).magnitude()
        assert way[i] == pytest.approx(np.hypot(shift, 80.0 * turn))
    assert se3.displacement(at(poses, 3.0), poses[3]) == pytest.approx(np.zeros(6), abs=1e-9)


def test_the_nearest_pose_of_a_bent_limit_is_straight_out() -> None:
    """From a pillar, and to a limit whose slope falls off with the square of how far one is from it."""
    pillar = limits(lambda p: (np.hypot(p[..., 0], p[..., 1]) - 100.0) / 100.0)
    np.testing.assert_allclose(nearest_pose(pillar, turned(30.0, 40.0, 7.0, 0.1)), turned(60.0, 80.0, 7.0, 0.1), atol=1e-6)
    flattened = limits(lambda p: np.arctan((p[..., 0] - 200.0) / 30.0))
    np.testing.assert_allclose(nearest_pose(flattened, HERE), turned(200.0, 0.0, 0.0, 0.0), atol=1e-6)
