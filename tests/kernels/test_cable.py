"""The cable: wrap, drum and their derivatives against a string laid around a disc and 40-digit arithmetic."""

import math
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import mpmath as mp
import numpy as np
import oracles
import pytest
from hypothesis import given, settings, strategies as st
from rows import row_of

from lmeasure.core import FloatArray
from lmeasure.kernels import CABLE_COLUMNS, PARAMETERS, cable, layout
from lmeasure.simulation import cell_rig

ROUNDING_MM = 1e-11  # some units in the last place of a few metres


def random_cables(seed: int, number: int, radius: float | None = None) -> Iterator[tuple[oracles.Cable, FloatArray, float]]:
    """Cables from random points over random pulleys, a pose each and a count."""
    g = np.random.default_rng(seed)
    for _ in range(number):
        base = g.uniform(-1500, 1500, 3)
        q = g.normal(size=4)
        # the generators draw every wrap from nearly none to nearly a full turn: the guide points anywhere
        pose = np.r_[g.uniform(-400, 400, 3), q / np.linalg.norm(q)]
        c = oracles.Cable(
            base=tuple(base.tolist()), alpha=float(g.uniform(-1.5, 1.5)), beta=float(g.uniform(-3, 3)),
            radius=float(g.uniform(5, 40)) if radius is None else radius, attachment=tuple(g.uniform(-150, 150, 3).tolist()),
            tangent=float(g.uniform(0, 300)), axial=float(g.uniform(-80, 80)), pitch=float(g.uniform(-3, 3)),
            count_length=float(g.uniform(0.005, 0.02)), scale=float(g.choice([0.5, 1.0, 2.0])),
        )  # fmt: skip
        yield c, pose, float(g.uniform(-90_000, 90_000))


@pytest.mark.parametrize("seed", range(40))
def test_wrap_is_a_string_laid_around_a_disc(seed: int) -> None:
    for c, pose, _ in random_cables(seed, 1):
        length, angle, heading = oracles.string_around_disc(
            oracles.attachment_in_base(c, pose), c.base, oracles.guide(c.alpha, c.beta), c.radius
        )
        rows, poses = row_of(c)[None], pose[None]
        assert cable.span_lengths(rows, poses)[0, 0] == pytest.approx(float(length), abs=ROUNDING_MM)
        assert cable.wrap_geometry(rows, poses)[3][0, 0] == pytest.approx(float(angle), abs=1e-12)
        assert cable.span_rows(rows, pose)[0, 3:] == pytest.approx([float(v) for v in heading], abs=1e-13)


@pytest.mark.parametrize("turn", [1e-9, 0.3, math.pi / 2, math.pi - 1e-6, math.pi, math.pi + 1e-6, 4.0, 2 * math.pi - 0.05])
def test_wrap_angle_is_built_by_hand(turn: float) -> None:
    """A point set at the end of a known arc and a known straight part gives back both, up to nearly a full turn."""
    u, n = np.array([1.0, 0, 0]), np.array([0.0, 0.6, 0.8])
    base, radius, straight = np.array([100.0, -200.0, 300.0]), 30.0, 700.0
    end = base + radius * n + radius * (math.sin(turn) * u - math.cos(turn) * n) + straight * (math.cos(turn) * u + math.sin(turn) * n)
    # beyond half a turn the point can come to lie on the other side of the axis: there it is another, shorter wrap
    across = float((end - base) @ n)
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, :3], row[0, 3:6], row[0, 6], row[0, 16] = base, u, radius, 6000
    pose = np.r_[end, 0, 0, 0, 1][None]
    if across > 0:
        assert cable.span_lengths(row, pose)[0, 0] == pytest.approx(radius * turn + straight, abs=1e-10)
        assert cable.wrap_geometry(row, pose)[3][0, 0] == pytest.approx(turn, abs=1e-12)
    else:
        expected = oracles.string_around_disc(tuple(end), tuple(base), tuple(u), radius)
        assert cable.span_lengths(row, pose)[0, 0] == pytest.approx(float(expected[0]), abs=1e-10)


def test_long_wraps_on_the_near_side() -> None:
    """Behind the pulley and close to it the cable goes round by more than half a turn."""
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, 3:6], row[0, 6], row[0, 16] = (1, 0, 0), 30.0, 6000
    for q, p in ((-200.0, 10.0), (-60.0, 1.0), (-45.0, 25.0), (-40.0, 0.01)):
        pose = np.array([[q, p, 0, 0, 0, 0, 1.0]])
        length, angle, _ = oracles.string_around_disc((q, p, 0), (0, 0, 0), (1, 0, 0), 30)
        assert float(angle) > math.pi
        assert cable.span_lengths(row, pose)[0, 0] == pytest.approx(float(length), abs=1e-10)
        assert cable.wrap_geometry(row, pose)[3][0, 0] == pytest.approx(float(angle), abs=1e-12)


def test_tangent_points_lie_on_the_pulley_and_see_the_point() -> None:
    for c, pose, _ in random_cables(7, 50):
        row = row_of(c)
        centre, tangent, point, angle = (x[0, 0] for x in cable.wrap_geometry(row[None], pose[None]))
        assert np.linalg.norm(centre - row[:3]) == pytest.approx(c.radius, abs=1e-11)
        assert (centre - row[:3]) @ row[3:6] == pytest.approx(0, abs=1e-10)
        assert np.linalg.norm(tangent - centre) == pytest.approx(c.radius, abs=1e-11)
        assert (tangent - centre) @ (point - tangent) == pytest.approx(0, abs=1e-8)
        length = cable.span_lengths(row[None], pose[None])[0, 0]
        assert c.radius * angle + np.linalg.norm(point - tangent) == pytest.approx(length, abs=1e-10)


def test_no_cable_from_inside_the_pulley_or_on_its_axis() -> None:
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, 3:6], row[0, 6], row[0, 16] = (0, 0, 1), 20.0, 6000
    inside, on_axis = np.array([0, 20.0, 5.0, 0, 0, 0, 1]), np.array([0, 0, 500.0, 0, 0, 0, 1])
    assert np.isnan(cable.span_lengths(row, np.array([inside, on_axis]))).all()
    row[0, 6] = 0
    assert cable.span_lengths(row, on_axis[None])[0, 0] == 500.0
    assert np.isnan(cable.span_rows(row, np.array([0, 0, 0, 0, 0, 0, 1.0]))).all(), "a cable of no length has no direction"


@pytest.mark.parametrize("seed", range(9))
def test_row_is_the_derivative_of_the_length_by_the_twist(seed: int) -> None:
    """Of pulleys, and of straight cables too."""
    for c, pose, _ in random_cables(seed, 4, radius=0.0 if seed == 8 else None):
        row = row_of(c)[None]
        analytic = cable.span_rows(row, pose)[0]
        for axis in range(6):
            h = 1e-3 if axis >= 3 else 1e-6
            step = np.zeros(6)
            step[axis] = h
            ahead, behind = (float(oracles.free_length(c, oracles.compose(pose, sign * step[:3], sign * step[3:]))) for sign in (1, -1))
            # rounding of the composed quaternions over the step bounds this one
            assert analytic[axis] == pytest.approx((ahead - behind) / (2 * h), abs=2e-6 if axis < 3 else 1e-8)


def moved(c: oracles.Cable, pose: FloatArray, recorded: Any, name: str, step: Any) -> Any:
    return oracles.misclosure(c.moved(name, step), pose, recorded)


@pytest.mark.parametrize("seed", range(10))
def test_every_parameter_against_difference_quotients(seed: int) -> None:
    """All of PARAMETERS against an independent length in 40 digits; radius 0 is another branch."""
    for c, pose, k in random_cables(100 + seed, 1, radius=0.0 if seed == 0 else None):
        recorded = mp.mpf(k) * mp.mpf(c.scale)
        got = cable.length_gradients(row_of(c)[None], pose[None], np.array([[k]]), np.array([c.scale]))[0, 0]
        for name, value in zip(PARAMETERS, got, strict=True):
            if c.radius == 0.0 and name == "pulley_radius_mm":
                # one-sided: there is no pulley of negative radius
                h = 1e-12
                expected = float((moved(c, pose, recorded, name, h) - moved(c, pose, recorded, name, 0)) / h)
                tolerance = 1e-9
            else:
                expected, tolerance = oracles.derivative(partial(moved, c, pose, recorded, name)), 1e-11
            assert value == pytest.approx(expected, rel=tolerance, abs=tolerance), name


def test_many_poses_are_one_by_one() -> None:
    """Rows and derivatives of four cables at nine poses and at two, each as it is alone."""
    some = [next(random_cables(seed, 1)) for seed in range(60, 64)]
    rows, scales = np.array([row_of(c) for c, _, _ in some]), np.array([c.scale for c, _, _ in some])
    for n in (9, 2):
        poses, counts = np.array([some[i % 4][1] for i in range(n)]), np.random.default_rng(n).uniform(-5e4, 5e4, (n, 4))
        at_once, gradients = cable.span_rows_of(rows, poses), cable.length_gradients(rows, poses, counts, scales)
        assert at_once.shape == (n, 4, 6)
        assert gradients.shape == (n, 4, layout.WIDTH)
        for i, j in np.ndindex(n, 4):
            np.testing.assert_array_equal(at_once[i, j], cable.span_rows(rows[[j]], poses[i])[0])
            one = cable.length_gradients(rows[[j]], poses[[i]], counts[[i]][:, [j]], scales[[j]])[0, 0]
            np.testing.assert_array_equal(gradients[i, j], one)


def test_a_drum_at_its_pulley_gives_nothing_where_nothing_is_paid_out() -> None:
    """Both legs nothing, and no count: no change, no count of it, and no way that a leg could be moved along."""
    c, pose, _ = next(random_cables(19, 1))
    row = row_of(replace(c, tangent=0.0, axial=0.0))[None]
    assert cable.changes_from_counts(row, np.zeros((1, 1)))[0, 0] == 0.0
    assert cable.counts_from_changes(row, np.zeros((1, 1)))[0, 0] == 0.0
    found = cable.length_gradients(row, pose[None], np.zeros((1, 1)), np.ones(1))[0, 0]
    assert found[[layout.BY_TANGENT, layout.BY_AXIAL, layout.BY_PITCH, layout.BY_SCALE]].tolist() == [0.0] * 4
    # from there it goes along the drum alone, whichever way
    for k in (1000.0, -1000.0):
        beyond = cable.length_gradients(row, pose[None], np.full((1, 1), k), np.ones(1))[0, 0]
        assert beyond[layout.BY_TANGENT] == 0.0
        assert abs(beyond[layout.BY_AXIAL]) == pytest.approx(1.0)


def test_drum_is_a_hypotenuse() -> None:
    for c, _, k in random_cables(3, 200):
        row = row_of(c)[None]
        for count in (k, 1.0, -1.0, 1e-6, 0.0):
            expected = float(oracles.drum_change(count, c))
            assert cable.changes_from_counts(row, np.array([[count]]))[0, 0] == pytest.approx(expected, rel=4e-15, abs=1e-300)


def test_published_drum_geometry() -> None:
    """|E_1 B_H| of the recomputed example of thesis 5.5: wound until the cable comes straight from the drum, its 20 mm of travel used up,
    the stretch to the pulley is the leg 149.756507 where it was 151.086106."""
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, 10:14] = 149.756507, 20.0, -0.01, 0.0125
    change = cable.changes_from_counts(row, np.array([[2000.0]]))[0, 0]
    assert change - 2000 * 0.0125 == pytest.approx(151.086106 - 149.756507, abs=1e-6)


def test_the_guide_is_that_of_its_angles() -> None:
    for alpha, beta in np.random.default_rng(4).uniform(-3.0, 3.0, (20, 2)):
        np.testing.assert_allclose(cable.guide_direction(alpha, beta), [float(x) for x in oracles.guide(alpha, beta)], rtol=0, atol=1e-15)


def test_straight_cables_are_drawn_from_their_point() -> None:
    """Without a pulley centre and tangent point are the observation point itself, and nothing is wrapped, whatever the cable beside it."""
    row = np.zeros((2, CABLE_COLUMNS))
    row[:, :3], row[:, 3:6], row[:, 7:10] = (10.0, -20.0, 30.0), (0.0, 1.0, 0.0), (5.0, 6.0, 7.0)
    row[1, 6] = 25.0
    turned = np.array([400.0, 500.0, -600.0, 0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)])
    centre, tangent, point, angle = (x[0] for x in cable.wrap_geometry(row, turned[None]))
    np.testing.assert_array_equal(centre[0], row[0, :3])
    np.testing.assert_array_equal(tangent[0], row[0, :3])
    np.testing.assert_allclose(point, np.tile([394.0, 505.0, -593.0], (2, 1)), rtol=1e-14)
    assert angle[0] == 0.0
    assert angle[1] > 0.1
    length = cable.span_lengths(row, turned[None])[0, 0]
    assert length == pytest.approx(np.linalg.norm(point[0] - row[0, :3]), rel=1e-15)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(
    k=st.floats(-1e7, 1e7), tangent=st.floats(0, 500), axial=st.floats(-200, 200), pitch=st.floats(-60, 60), length=st.floats(0.011, 0.02)
)
def test_counts_and_changes_are_inverse(k: float, tangent: float, axial: float, pitch: float, length: float) -> None:
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, 10:14] = tangent, axial, pitch / 6000, length
    change = cable.changes_from_counts(row, np.array([[k]]))
    back = cable.counts_from_changes(row, change)[0, 0]
    # a groove nearly as long as its turn leaves little cable per count: conditioning of 1/(1 - |g|/Nc)
    assert back == pytest.approx(k, rel=1e-11, abs=1e-9)


def test_pitch_zero_is_a_plain_drum() -> None:
    row = np.zeros((1, CABLE_COLUMNS))
    row[0, 10:14] = 180.0, 25.0, 0.0, 0.012
    assert cable.changes_from_counts(row, np.array([[12345.0]]))[0, 0] == 12345 * 0.012


@pytest.mark.parametrize("seed", range(5))
def test_lengths_do_not_depend_on_the_frame(seed: int) -> None:
    """The whole rig and the pose turned and shifted together: the guide's angles change, the lengths do not."""
    g = np.random.default_rng(seed)
    turn = g.normal(size=3)
    shift = g.uniform(-1000, 1000, 3)
    for c, pose, _ in random_cables(200 + seed, 20):
        moved = oracles.compose(np.r_[0, 0, 0, pose[3:]], turn, [0, 0, 0])
        rotation = oracles.matrix_of_quaternion(oracles.compose(np.r_[0, 0, 0, 0, 0, 0, 1], turn, [0, 0, 0])[3:])
        row = row_of(c)
        other = row.copy()
        other[:3] = rotation @ row[:3] + shift
        way = -(rotation @ row[3:6])
        alpha, beta = math.asin(-way[2]), math.atan2(way[0], way[1])
        other[3:6] = -math.cos(alpha) * math.sin(beta), -math.cos(alpha) * math.cos(beta), math.sin(alpha)
        other[14:16] = alpha, beta
        before = cable.span_lengths(row[None], pose[None])[0, 0]
        after = cable.span_lengths(other[None], np.r_[rotation @ pose[:3] + shift, moved[3:]][None])[0, 0]
        assert after == pytest.approx(before, abs=1e-10)


@pytest.mark.parametrize(("tangent", "axial"), [(0.4, 0.3), (0.7, 0.0)])
def test_drums_that_stand_at_their_pulleys_have_derivatives_too(tangent: float, axial: float) -> None:
    """Less than a millimetre off: against finite differences of the decoded change."""
    rig = cell_rig(1)
    rows, poses, counts = rig.cable_rows(), np.array([[10.0, -20.0, 30.0, 0.0, 0.0, 0.0, 1.0]]), np.full((1, 6), 200.0)
    rows[:, layout.TANGENT], rows[:, layout.AXIAL] = tangent, axial
    found = cable.length_gradients(rows, poses, counts, rig.scales())[0]
    for column, by in ((layout.TANGENT, layout.BY_TANGENT), (layout.AXIAL, layout.BY_AXIAL)):
        if rows[0, column] == 0.0:
            continue
        ends = []
        for sign in (1.0, -1.0):
            other = rows.copy()
            other[:, column] += sign * 1e-6
            ends.append(cable.changes_from_counts(other, counts)[0])
        np.testing.assert_allclose(found[:, by], -(ends[0] - ends[1]) / 2e-6, atol=1e-6)
        assert np.abs(found[:, by]).min() > 1e-3


@pytest.mark.parametrize("pitch", [-2.0, 1.5])
def test_derivatives_of_a_drum_whose_cable_leaves_it_at_its_pulley(pitch: float) -> None:
    """Both legs nothing at the zero pose, something behind it: the way along the drum still takes cable. By the formula of the drum in 40
    digits; by the legs themselves there is no derivative there."""
    c, pose, _ = next(random_cables(17, 1))
    for k in (4000.0, -3000.0):
        one = replace(c, tangent=0.0, axial=0.0, pitch=pitch)
        recorded = mp.mpf(k) * mp.mpf(one.scale)
        found = dict(
            zip(
                PARAMETERS, cable.length_gradients(row_of(one)[None], pose[None], np.array([[k]]), np.array([one.scale]))[0, 0], strict=True
            )
        )
        for name in ("scale", "groove_pitch_mm"):
            assert found[name] == pytest.approx(oracles.derivative(partial(moved, one, pose, recorded, name)), rel=1e-9), name
            assert abs(found[name]) > 1e-2


def test_a_drum_that_comes_past_its_pulley_has_finite_derivatives() -> None:
    """Where the cable has just wound to the pulley's plane, on a drum beside which the pulley stands, there is no stretch left."""
    c, pose, _ = next(random_cables(18, 1))
    one = replace(c, tangent=0.0, axial=25.0, pitch=-60.0)
    row = row_of(one)[None]
    row[0, layout.TRAVEL] = -0.01
    assert np.isfinite(cable.length_gradients(row, pose[None], np.array([[2500.0]]), np.array([one.scale]))).all()
    assert cable.changes_from_counts(row, np.array([[2500.0]]))[0, 0] == pytest.approx(
        2500.0 * row[0, layout.COUNT_LENGTH] + 25.0, rel=1e-14
    )


@pytest.mark.parametrize("radius", [0.3, 0.9, 1.0])
def test_thin_pulleys_are_pulleys(radius: float) -> None:
    """Of a millimetre or less: length, heading, angle and centre are those of a string around a disc, no straight cable's."""
    for c, pose, _ in random_cables(21, 4, radius=radius):
        length, angle, heading = oracles.string_around_disc(
            oracles.attachment_in_base(c, pose), c.base, oracles.guide(c.alpha, c.beta), c.radius
        )
        rows, poses = row_of(c)[None], pose[None]
        assert cable.span_lengths(rows, poses)[0, 0] == pytest.approx(float(length), abs=ROUNDING_MM)
        centre, tangent, point, wrapped = (x[0, 0] for x in cable.wrap_geometry(rows, poses))
        assert wrapped == pytest.approx(float(angle), abs=1e-12)
        assert np.linalg.norm(tangent - centre) == pytest.approx(radius, rel=1e-12)
        np.testing.assert_allclose(cable.span_rows(rows, pose)[0, 3:], [float(v) for v in heading], atol=1e-13)
        assert point - tangent == pytest.approx(np.linalg.norm(point - tangent) * np.array([float(v) for v in heading]), abs=1e-9)
        found = cable.length_gradients(rows, poses, np.zeros((1, 1)), np.ones(1))[0, 0]
        for name in ("guide_alpha_rad", "guide_beta_rad", "pulley_radius_mm"):
            at = PARAMETERS.index(name)
            assert found[at] == pytest.approx(oracles.derivative(partial(moved, c, pose, mp.mpf(0), name)), rel=1e-9, abs=1e-11)


@pytest.mark.parametrize("turns", [-2, -1, 0, 1, 3])
def test_angles_differ_the_shortest_way_around_and_lengths_as_they_are(turns: int) -> None:
    for angle in (-3.1, -1.0, 0.0, 0.4, 3.1):
        there = angle + 2.0 * math.pi * turns
        assert cable.way_round(there, layout.SWIVEL) == pytest.approx(angle, abs=1e-12)
        assert cable.way_round(there, layout.INCLINATION) == pytest.approx(angle, abs=1e-12)
        assert cable.way_round(there, layout.CABLE) == there


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_straight_cable_along_its_guide_has_a_derivative_by_the_radius(sign: float) -> None:
    """Of directions whose product with themselves is rounded to more than 1 too."""
    rng = np.random.default_rng(2)
    rows, pose = np.zeros((50, CABLE_COLUMNS)), np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]])
    rows[:, layout.BASE_XYZ] = rng.normal(size=(50, 3)) * 500.0
    e = -rows[:, layout.BASE_XYZ] / np.linalg.norm(rows[:, layout.BASE_XYZ], axis=1)[:, None]
    rows[:, layout.GUIDE_XYZ], rows[:, layout.TANGENT], rows[:, layout.COUNT_LENGTH] = sign * e, 200.0, 0.01
    rows[:, layout.TURN_COUNTS] = 6000.0
    assert (np.einsum("ji,ji->j", e, e) > 1.0).any()
    found = cable.length_gradients(rows, pose, np.zeros((1, 50)), np.ones(50))[0][:, layout.BY_RADIUS]
    np.testing.assert_allclose(found, 0.0 if sign > 0.0 else math.pi, atol=1e-6)
