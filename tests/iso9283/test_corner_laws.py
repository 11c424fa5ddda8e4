"""What a corner is made of, against its definition written out: sides, the way past it, and what may be the farthest beyond in truth."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import Akima1DInterpolator
from scipy.stats import norm
from synthetic_paths import FloatArray
from synthetic_trajectories import UNIT

from lmeasure.core import CertificationError
from lmeasure.iso9283.clauses.corners import Corner, CornerPart, CornerTest, Passing, at_corner, corners_of, passings
from lmeasure.iso9283.figure import Subject, reduced
from lmeasure.iso9283.paths import Crossings, Cycle, Line, finer
from lmeasure.recording import CommandedPath
from lmeasure.trajectory import PoseErrors, kept_over

POINTS = np.array([[5.0, 7.0, 2.0], [65.0, 97.0, 182.0], [140.0, 247.0, 232.0], [200.0, 267.0, 202.0], [290.0, 447.0, 262.0]])
"""Sides of 210, 175, 70 and 210 mm; the turns are none of a right angle."""


def crossed(points: FloatArray = POINTS, cycles: tuple[Cycle, ...] = ()) -> Crossings:
    """Of a path of points, of which corners and cycles alone are asked."""
    line = Line(CommandedPath.model_validate({"name": "bent", "kind": "points", "points_mm": [tuple(p) for p in points]}))
    none: Any = None
    names = ["way_mm", "commanded", "tangent", "attained", "time_s", "pace_mm_s", "samples", "weights", "step", "scatter"]
    return Crossings(**dict.fromkeys(names, none), line=line, cycles=cycles, angle_deg=0.0)


def test_corners_stand_where_lines_meet() -> None:
    found = corners_of(crossed())
    assert [c.number for c in found] == [1, 2, 3]
    for c, here in zip(found, POINTS[1:], strict=False):
        before, after = here - POINTS[c.number - 1], POINTS[c.number + 1] - here
        np.testing.assert_allclose(c.place, here)
        np.testing.assert_allclose([c.before_mm, c.after_mm], [np.linalg.norm(before), np.linalg.norm(after)])
        np.testing.assert_allclose(np.cross(c.incoming, before), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.cross(c.outgoing, after), 0.0, atol=1e-9)
        assert min(c.incoming @ before, c.outgoing @ after) > 0.0
        # in the plane of both lines, normal to the second, towards where the first goes
        assert c.side @ c.outgoing == pytest.approx(0.0, abs=1e-12)
        assert c.side @ np.cross(c.incoming, c.outgoing) == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.norm(c.side) == pytest.approx(1.0)
        assert c.side @ c.incoming > 0.1
    assert [c.way_mm for c in found] == pytest.approx([210.0, 385.0, 455.0])
    straight = np.array([[0.0, 0.0, 0.0], [3.0, 4.0, 0.0], [6.0, 8.0, 0.0]])
    assert corners_of(crossed(straight)) == []


CORNER = Corner(2, np.array([40.0, -30.0, 20.0]), np.array([2.0, 3.0, 6.0]) / 7.0, np.array([3.0, 6.0, 2.0]) / 7.0, 500.0, 90.0, 120.0)


def cycle_of(way: FloatArray, away: FloatArray | None = None) -> Cycle:
    """A cycle along both lines of the corner, at ways from it, off by away (n, 3)."""
    place = CORNER.place + np.minimum(way, 0.0)[:, None] * CORNER.incoming + np.maximum(way, 0.0)[:, None] * CORNER.outgoing
    poses = np.column_stack([place + (0.0 if away is None else away), np.tile(UNIT, (len(way), 1))])
    return Cycle(np.arange(100, 100 + len(way)), way / 250.0, poses, CORNER.way_mm + way)


def by_definition(cycle: Cycle) -> tuple[FloatArray, float, FloatArray]:
    """The nearest point, at which part of how many samples from the first it is, and how far each sample is beyond the second line; by
    looking everywhere."""
    at, place = np.arange(len(cycle.poses)), cycle.poses[:, :3] - CORNER.place
    curve = Akima1DInterpolator(at, place, method="makima")
    # straight between sixteenths of a step
    sixteenths = np.arange(16 * (len(at) - 1) + 1) / 16.0
    every = np.linspace(0.0, at[-1], 16 * 50 * (len(at) - 1) + 1)
    points = np.column_stack([np.interp(every, sixteenths, column) for column in curve(sixteenths).T])
    nearest = int(np.argmin((points**2).sum(axis=1)))
    across = CORNER.incoming - (CORNER.incoming @ CORNER.outgoing) * CORNER.outgoing
    return points[nearest], float(every[nearest]), place @ across / np.linalg.norm(across)


def inside(cycle: Cycle) -> Cycle:
    """Of a cycle what lies within half a side of the corner."""
    kept = (cycle.way_mm > 455.0) & (cycle.way_mm < 560.0)
    return Cycle(cycle.samples[kept], cycle.time_s[kept], cycle.poses[kept], cycle.way_mm[kept])


@pytest.mark.parametrize(
    ("way", "swing", "neighbours"),
    [
        (np.arange(-100.3, 140.0, 0.7), 3.0, 1),
        # a sample at either end of the part that belongs to the corner
        (np.arange(-45.0, 62.0, 1.0), 5.0, 1),
        # 300 behind it, 301, and 750
        (0.2007 * np.arange(-50, 400), 0.0, 1),
        (0.2 * np.arange(-50, 400), 0.0, 2),
        (0.08 * np.arange(-300, 900), 0.0, 3),
        # it begins behind the corner, at it, and ends before it
        (np.arange(4.0, 70.0, 1.5), 6.0, 1),
        (np.arange(0.0, 70.0, 1.5), 0.0, 1),
        (np.arange(-60.0, -3.0, 1.5), 4.0, 1),
        # it stands there
        (np.sort(np.r_[np.arange(-30.0, 40.0, 1.5), np.full(5, 1.5)]), 2.0, 1),
    ],
)
def test_the_way_past_a_corner_is_seen_where_it_is_nearest(way: FloatArray, swing: float, neighbours: int) -> None:
    turned = np.column_stack([np.sin(way / 7.0 + k) for k in range(3)]) * np.exp(-((way / 15.0) ** 2))[:, None]
    cycle = cycle_of(way, swing * turned)
    nearest, at, beyond = by_definition(inside(cycle))
    found, first = at_corner(cycle, CORNER, "cycle"), int(np.flatnonzero(cycle.way_mm > 455.0)[0])
    np.testing.assert_allclose(found.nearest, nearest, atol=2e-3)
    assert np.linalg.norm(found.nearest) <= np.linalg.norm(nearest) + 1e-12
    # from the sample before: at a sample itself the whole step is behind it
    begun = at - (found.behind.start - first)
    assert 0.0 <= found.part < 1.0
    assert begun == pytest.approx(found.part or 1.0, abs=2e-3) or begun == pytest.approx(found.part, abs=2e-3)
    assert found.behind.stop == 1 + int(np.flatnonzero(cycle.way_mm < 560.0)[-1])
    after = beyond[found.behind.start - first :]
    assert found.neighbours == neighbours == int(np.ceil(len(after) / 300))
    rows = range(0, len(after) - neighbours + 1, neighbours)
    np.testing.assert_allclose(found.beyond, [np.mean(after[i : i + neighbours]) for i in rows], atol=1e-12)
    steps = np.linalg.norm(np.diff(cycle.poses[found.behind, :3], axis=0), axis=1)
    assert found.step_mm == pytest.approx(np.median(steps))


def test_two_samples_within_half_a_side_are_enough() -> None:
    """Those at its ends are not within."""
    for way, enough in ((np.array([-45.0, -2.0, 1.0, 60.0]), True), (np.array([-45.0, -2.0, 60.0]), False)):
        cycles = cycle_of(way), cycle_of(np.arange(-40.0, 40.0))
        if enough:
            assert at_corner(cycles[0], CORNER, "cycle").behind.stop == 3
        else:
            points = CORNER.place + np.array([-90.0 * CORNER.incoming, np.zeros(3), 120.0 * CORNER.outgoing])
            moved = tuple(replace(c, way_mm=c.way_mm - 410.0) for c in cycles)
            with pytest.raises(
                CertificationError, match=r"^path bent, cycle 2: has 1 sample within half a side of corner 1. At least 2 are needed$"
            ):
                list(passings(crossed(points, moved[::-1])))


def laws(n: int, *, rounded: bool) -> PoseErrors:
    """Of n poses; no two numbers are alike."""
    rng = np.random.default_rng(3)
    own, shared = rng.normal(size=(n, 6, 6)) * 0.004, rng.normal(size=(n, 6, 2)) * 0.002
    local = rng.normal(size=(n, 6, 1)) * 0.001
    return replace(PoseErrors.of(own, shared, rounded=rounded), local=local, place=np.arange(n))


def passed(beyond: FloatArray, part: float, neighbours: int, step_mm: float) -> Passing:
    return Passing(np.array([0.5 + part, -0.2, 0.3]), part, slice(7, 7 + len(beyond)), beyond, neighbours, step_mm)


def likely_by_definition(beyond: FloatArray, random: float, common: float) -> FloatArray:
    """Waves along what follows the last of the inner side, made as large as errors leave them; nothing where errors alone reach."""
    first, last = (np.flatnonzero(beyond >= -4.0 * np.sqrt(random + common))[i] for i in (0, -1))
    part = beyond[first : last + 1]
    n, i = len(part), np.arange(len(part))
    C = np.array([np.full(n, np.sqrt(1.0 / n)), *(np.sqrt(2.0 / n) * np.cos(np.pi * k * (2 * i + 1) / (2 * n)) for k in range(1, n))])
    added = np.full((n, 1), random)
    added[0] = random + n * common
    out = beyond.copy()
    out[first : last + 1] = C.T @ reduced((C @ part)[:, None, None], added, 1, 1.0)[:, 0, 0]
    if beyond.max() <= np.sqrt(random) * norm.ppf(1.0 - 0.01 / n) + np.sqrt(common) * norm.ppf(0.99):
        near = np.flatnonzero(out[first : last + 1] >= -np.sqrt(random + common)) + first
        out[near] = 0.0
    return out


def drawn_by_definition(beyond: FloatArray, likely: FloatArray, random: float) -> tuple[list[int], list[int]]:
    """Samples about the farthest, fifteen of them though the last be repeated, and others that may be the farthest in truth."""
    begin = max(min(int(np.argmax(beyond)) - 7, len(likely) - 15), 0)
    about = [min(begin + k, len(likely) - 1) for k in range(15)]
    return about, [k for k in range(len(likely)) if k not in about and likely[k] >= likely.max() - 8.0 * np.sqrt(random)]


COURSES = {
    "overshoots": 0.3 * np.exp(-(((np.arange(180.0) - 40.0) / 25.0) ** 2)) - 0.001 * np.arange(180.0),
    "stays on the line": 0.004 * np.random.default_rng(4).normal(size=120),
    "jumps on the inner side": np.r_[-0.4 + 0.1 * np.arange(4.0), 0.02 - 0.0007 * np.arange(160.0), -0.3],
    "is short": np.array([-0.01, 0.004, 0.09, 0.02]),
    "is short, and farthest late": np.array([0.13, 0.05, 0.07, 0.1, 0.09, 0.06, 0.08, 0.12, 0.11, 0.15, 0.14]),
    "is farthest first": 0.2 - 0.002 * np.arange(100.0),
    "is farthest last": 0.2 - 0.002 * np.arange(100.0)[::-1],
    "stays inside": -0.5 - 0.001 * np.arange(30.0),
}


@pytest.mark.parametrize("rounded", [False, True])
def test_what_may_be_the_farthest_in_truth_is_drawn(rounded: bool) -> None:
    every = list(COURSES.values())
    cycles = tuple(passed(y, 0.1 * i, 1 + i % 3, 0.002 * i) for i, y in enumerate(every))
    e = laws(len(cycles), rounded=rounded)
    part = CornerPart(CORNER, cycles, e)
    expected: dict[bool, list[tuple[FloatArray, FloatArray]]] = {False: [], True: []}
    shares = []
    for i, c in enumerate(cycles):
        of = e[np.array([i])]
        kept = float(kept_over(of, np.array([c.step_mm]))[0])
        shares.append(kept + (1.0 - kept) / c.neighbours)
        random = float(shares[-1] * CORNER.side @ of.random[0, 3:, 3:] @ CORNER.side)
        common = float(CORNER.side @ (of.covariance - of.random)[0, 3:, 3:] @ CORNER.side)
        near = (c.beyond >= -4.0 * np.sqrt(random + common)).any()
        likely = likely_by_definition(c.beyond, random, common) if near else c.beyond
        about, others = drawn_by_definition(c.beyond, likely, random)
        for which, values in ((False, c.beyond), (True, likely)):
            expected[which].append((values[about], values[others]))
    most = max(len(others) for _, others in expected[True])
    assert most > 30
    n, k = len(cycles), 15 + most
    errors = np.zeros((n * (1 + k), 6))
    for which in (False, True):
        nearest, beyond = part.state(errors, which)
        np.testing.assert_allclose(nearest, [c.nearest for c in cycles])
        for found, (near_top, far_off) in zip(beyond[..., 0], expected[which], strict=True):
            np.testing.assert_allclose(found[: 14 * 16 + 1], finer(near_top[:, None], kinks=True)[:, 0], atol=1e-12)
            np.testing.assert_allclose(found[14 * 16 + 1 :][: len(far_off)], far_off, atol=1e-12)
            assert (found[14 * 16 + 1 + len(far_off) :] < -1e6).all()
    # errors move the nearest points first, then cycle by cycle what lies beyond, by what of them is across the second line
    errors[:] = np.random.default_rng(5).normal(size=errors.shape) * 0.01
    draws = np.stack([errors, -2.0 * errors])
    still, moved = part.state(np.zeros_like(draws), True), part.state(draws, True)
    np.testing.assert_allclose(moved[0] - still[0], draws[:, :n, 3:], atol=1e-12)
    across = (draws[:, n:, 3:] @ CORNER.side).reshape(2, n, k)
    np.testing.assert_allclose(moved[1][:, :, : 14 * 16 + 1 : 16, 0] - still[1][:, :, : 14 * 16 + 1 : 16, 0], across[:, :, :15], atol=1e-12)
    np.testing.assert_allclose((moved[1] - still[1])[:, :, 14 * 16 + 1 :, 0], across[:, :, 15:], atol=1e-6)

    np.testing.assert_array_equal(part.positions, np.tile(CORNER.place, (n * (1 + k), 1)))
    law = part.errors
    assert len(law) == n * (1 + k)
    np.testing.assert_allclose(law.random[n:], np.repeat(np.array(shares)[:, None, None] * e.random, k, axis=0))
    np.testing.assert_array_equal(law.shared[n:], np.repeat(e.shared, k, axis=0))
    # between samples the four about have a part in what is read: by Lagrange's cubic
    t = 0.1 * np.arange(n)
    weights = [-t * (t - 1) * (t - 2) / 6, (t + 1) * (t - 1) * (t - 2) / 2, -(t + 1) * t * (t - 2) / 2, (t + 1) * t * (t - 1) / 6]
    np.testing.assert_allclose(law.random[:n], (np.array(weights) ** 2).sum(axis=0)[:, None, None] * e.random)
    assert not law.rounded
    single = CornerPart(CORNER, tuple(replace(c, neighbours=1) for c in cycles), e)
    assert single.errors.rounded == rounded


@pytest.mark.parametrize(("part", "stays"), [(1.0 - 1e-9, True), (1.0 + 1e-9, False)])
def test_a_robot_no_farther_beyond_than_errors_reach_is_taken_to_stay_on_the_line(part: float, stays: bool) -> None:
    """Own errors of 1 mm, common ones of 2: of 100 samples the largest is beyond 3.719 + 4.653 mm once in a hundred times. What lies
    farther in than both together, 2.236 mm, is left."""
    n = 100
    swing = part * (norm.isf(0.01 / n) + 2.0 * norm.isf(0.01)) * np.cos(3.0 * np.pi * np.arange(n) / n)
    own, shared = np.zeros((1, 6, 1)), np.zeros((1, 6, 1))
    own[0, 3:, 0], shared[0, 3:, 0] = CORNER.side, 2.0 * CORNER.side
    cornered = CornerPart(CORNER, (passed(swing, 0.0, 1, 1e9),), PoseErrors.of(own, shared))
    found = cornered.state(np.zeros((len(cornered.errors), 6)), True)[1][0, :, 0]
    likely = likely_by_definition(swing, 1.0, 4.0)
    assert (likely.max() == 0.0) == stays
    assert likely.min() < -np.sqrt(5.0)
    assert ((likely > -np.sqrt(5.0)) & (likely < 0.0)).any() != stays
    about, others = drawn_by_definition(swing, likely, 1.0)
    np.testing.assert_allclose(found[: 14 * 16 + 1 : 16], likely[about], atol=1e-9)
    np.testing.assert_allclose(found[14 * 16 + 1 :], likely[others], atol=1e-9)


def test_a_corner_states_how_near_and_how_far_beyond() -> None:
    """CR of the vectors to it, CO of what lies beyond; each of its path's subject, its samples those before the nearest points."""
    cycles = tuple(passed(COURSES[name], 0.25, 1, 0.5) for name in ("overshoots", "is short", "stays inside"))
    test = CornerTest(subject=Subject("path", "bent"), corner=CORNER, passed=cycles, at=np.array([11, 23, 47]))
    np.testing.assert_array_equal(test.samples(), [11, 23, 47])
    requested: list[FloatArray] = []

    def errors(samples: Any) -> PoseErrors:
        requested.append(samples)
        return laws(3, rounded=False)

    ((key, part),) = test.parts(errors).items()
    assert key == Subject("corner", "bent", 2)
    np.testing.assert_array_equal(requested, [[11, 23, 47]])
    states = {key: part.state(np.zeros((len(part.errors), 6)), False)}
    cr, co = test.figures()
    assert [(*f.key, f.clause, f.unit, f.cycles, f.needs) for f in (cr, co)] == [
        (name, None, "bent", "corner 2", "8.5", "mm", 3, (Subject("path", "bent"),)) for name in ("CR", "CO")
    ]
    assert float(cr.of(states)) == pytest.approx(np.linalg.norm([0.75, -0.2, 0.3]))
    # nothing is beyond in the third cycle, which does not take away from the others
    beyond = states[key][1][..., 0].max(axis=1)
    assert beyond[2] < -0.4
    assert float(co.of(states)) == pytest.approx((beyond[0] + beyond[1]) / 3.0)
