"""Bodies on straight links: rows and pressure angles against differences, the twist that is lost."""

import numpy as np
import pytest
import scipy.linalg
from hypothesis import example, given, settings, strategies as st

from lmeasure.core import FloatArray, se3
from lmeasure.linkages import Split, pluecker_rows, pressure_angles
from lmeasure.linkages.singularity import SHIFT_RAD_PER_MM, Screw

laws = settings(max_examples=30, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)


def hexapod(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Points of base and body (6, 3), far from singular, and a pose (7,)."""
    rng = np.random.default_rng(seed)
    turn = np.pi / 3 * np.arange(6)
    base = np.column_stack([900.0 * np.cos(turn), 900.0 * np.sin(turn), np.zeros(6)])
    wide = turn + np.where(np.arange(6) % 2, 0.9, -0.9) + np.pi / 3
    body = np.column_stack([200.0 * np.cos(wide), 200.0 * np.sin(wide), 40.0 * (-1.0) ** np.arange(6)])
    pose = se3.displaced(np.array([0.0, 0.0, 700.0, 0.0, 0.0, 0.0, 1.0]), rng.uniform(-0.2, 0.2, 6) * np.repeat([1.0, 300.0], 3))
    return base + rng.uniform(-30.0, 30.0, (6, 3)), body, pose


def links(base: FloatArray, body: FloatArray, pose: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Lengths (6,), unit directions (6, 3) and arms (6, 3)."""
    there = se3.apply(pose, body)
    away = there - base
    lengths = np.linalg.norm(away, axis=1)
    return lengths, away / lengths[:, None], there - pose[:3]


@laws
@given(seeds)
def test_a_row_is_the_derivative_of_a_length(seed: int) -> None:
    base, body, pose = hexapod(seed)
    _, e, arms = links(base, body, pose)
    for i, step in enumerate(1e-4 * np.diag(np.repeat([1e-2, 1.0], 3))):
        ahead, behind = (links(base, body, se3.displaced(pose, sign * step))[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(pluecker_rows(arms, e)[:, i], (ahead - behind) / (2.0 * step[i]), rtol=1e-6, atol=1e-6)


@laws
@given(seeds)
def test_pressure_angles_are_those_of_the_motions_of_single_links(seed: int) -> None:
    base, body, pose = hexapod(seed)
    _, e, arms = links(base, body, pose)
    rows = pluecker_rows(arms, e)
    found = pressure_angles(rows, arms)
    for i in range(6):
        delta = np.linalg.solve(rows, 1e-4 * np.eye(6)[i])
        moved = se3.apply(se3.displaced(pose, delta), body[i]) - se3.apply(pose, body[i])
        between = np.arctan2(np.linalg.norm(np.cross(e[i], moved)), e[i] @ moved)
        assert found[i] == pytest.approx(between, abs=1e-5)
    np.testing.assert_array_equal(pressure_angles(np.stack([rows, rows]), np.stack([arms, arms])), [found, found])


@laws
@given(seeds)
def test_links_through_one_line_lose_the_turn_about_it(seed: int) -> None:
    """However the line lies; and what a motion has beside that turn is found to first order."""
    rng = np.random.default_rng(seed)
    axis, at = rng.normal(size=3), 100.0 * rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    on_line, arms = at + np.outer(400.0 * rng.normal(size=6), axis), 200.0 * rng.normal(size=(6, 3))
    e = (arms - on_line) / np.linalg.norm(arms - on_line, axis=1)[:, None]
    rows, u = pluecker_rows(arms, e), np.full(6, 0.01)
    split = Split(rows, np.zeros(3), np.arange(6), u, size_mm=200.0)
    assert abs(split.lost.direction @ axis) == pytest.approx(1.0, abs=1e-9)
    np.testing.assert_allclose(np.cross(split.lost.point - at, axis), 0.0, atol=1e-5)
    assert abs(split.lost.pitch_mm) < 1e-5
    assert np.abs(rows @ split.twist).max() < 1e-10
    assert split.twist @ (split.metric * split.twist) == pytest.approx(1.0)
    twist = rng.normal(size=6) * np.repeat([1e-3, 1.0], 3)
    (found,), _ = split.determined((rows @ twist)[None])
    # what is left is a multiple of what is lost
    rest = twist - found
    size = split.metric * split.twist @ rest
    np.testing.assert_allclose(rest, size * split.twist, atol=1e-8)
    assert split.metric * split.twist @ found == pytest.approx(0.0, abs=1e-9)


def rows_that_lose(rng: np.random.Generator, omega: FloatArray, v: FloatArray, *, links: int) -> FloatArray:
    """Links of random points whose lines are normal to what their points do by the twist (rotation omega; origin v)."""
    arms = 200.0 * rng.normal(size=(links, 3))
    e = np.cross(rng.normal(size=(links, 3)), np.cross(omega, arms) + v)
    return pluecker_rows(arms, e / np.linalg.norm(e, axis=1)[:, None])


@laws
@given(seeds, st.sampled_from([-70.0, -0.6, 0.0, 35.0]), st.sampled_from([0.0, 1.0]))
@example(0, 0.0, 0.0)
def test_the_screw_that_no_link_resists_is_the_one_that_is_lost(seed: int, pitch_mm: float, off: float) -> None:
    """Its axis may pass the body's origin, and the body may be anywhere."""
    rng = np.random.default_rng(seed)
    axis, place, from_origin = rng.normal(size=3), 1000.0 * rng.normal(size=3), off * 100.0 * rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    v = np.cross(from_origin, axis) + pitch_mm / (2.0 * np.pi) * axis
    rows = rows_that_lose(rng, axis, v, links=int(rng.integers(6, 9)))
    lost = Split(rows, place, np.arange(6), rng.uniform(0.01, 0.02, len(rows)), size_mm=200.0).lost
    assert np.abs(lost.direction).max() == pytest.approx(lost.direction.max())
    np.testing.assert_allclose(np.cross(lost.direction, axis), 0.0, atol=1e-9)
    np.testing.assert_allclose(lost.point, place + from_origin - (from_origin @ axis) * axis, atol=1e-5)
    assert lost.pitch_mm == pytest.approx(pitch_mm, abs=1e-5)
    assert lost.mm_per_mm < 1e-12


@pytest.mark.parametrize(("turn", "shift"), [(0.0, True), (0.5, True), (2.0, False)])
def test_a_screw_that_hardly_turns_is_a_shift(turn: float, shift: bool) -> None:
    rng = np.random.default_rng(1)
    along, place = np.array([0.6, 0.0, -0.8]), np.array([10.0, -20.0, 30.0])
    rows = rows_that_lose(rng, turn * SHIFT_RAD_PER_MM * along, along, links=6)
    lost = Split(rows, place, np.arange(6), np.full(6, 0.01), size_mm=200.0).lost
    np.testing.assert_allclose(lost.direction, -along, atol=1e-6)
    assert np.isinf(lost.pitch_mm) == shift
    assert lost.said.code == ("screw.shift" if shift else "screw")
    if shift:
        np.testing.assert_array_equal(lost.point, place)
        lost.point[0] = 0.0
        assert place[0] == 10.0


@pytest.mark.parametrize(("pitch_mm", "code"), [(0.49, "screw.turn"), (-0.49, "screw.turn"), (0.5, "screw"), (-3.0, "screw")])
def test_what_is_said_of_a_screw(pitch_mm: float, code: str) -> None:
    along, at = (0.0, 0.6, 0.8), (1.0, 2.0, 3.0)
    said = Screw(np.array(along), np.array(at), pitch_mm, 0.1).said
    assert said.code == code
    assert said.values["along"] == along
    assert said.values["at"] == at


@laws
@given(seeds, st.sampled_from([(0, 1, 2, 3, 4, 5), (0, 1, 5), (3, 4, 5), (1, 2, 3, 4)]))
def test_what_links_see_least_and_what_they_tell_beside_it(seed: int, components: tuple[int, ...]) -> None:
    """By the generalised eigenvalues of what the links weigh a motion by and what it moves; uncertainties link by link."""
    rng = np.random.default_rng(seed)
    base, body, pose = hexapod(seed)
    _, e, arms = links(base, body, pose)
    free, size, u = np.array(components), 150.0, rng.uniform(0.005, 0.05, 6)
    rows = pluecker_rows(arms, e)
    split = Split(rows, pose[:3], free, u, size_mm=size)
    moves = np.diag([size**2] * 3 + [1.0] * 3)[np.ix_(free, free)]
    _, vectors = scipy.linalg.eigh(rows[:, free].T @ np.diag(u**-2.0) @ rows[:, free], moves)
    least = np.zeros(6)
    least[free] = vectors[:, 0]
    np.testing.assert_allclose(split.twist * np.sign(split.twist @ least), least, atol=1e-9)
    assert split.lost.mm_per_mm == pytest.approx(np.linalg.norm(rows @ least))
    changes = rng.normal(size=(3, 6))
    found, u_found = split.determined(changes)
    for one, change in zip(found, changes, strict=True):
        # the least squares among motions that have nothing of what is seen least
        others = vectors[:, 1:]
        part = np.linalg.lstsq((rows[:, free] @ others) / u[:, None], change / u, rcond=None)[0]
        np.testing.assert_allclose(one[free], others @ part, atol=1e-9)
        assert not np.delete(one, free).any()
    each, _ = split.determined(np.diag(u))
    np.testing.assert_allclose(u_found, np.sqrt((each**2).sum(axis=0)), rtol=1e-9)


@laws
@given(seeds, st.sampled_from([3, 5]))
def test_of_fewer_links_than_freedoms_a_screw_that_no_link_resists_is_lost(seed: int, number: int) -> None:
    """And all that the lengths tell is told beside it."""
    rng = np.random.default_rng(seed)
    base, body, pose = hexapod(seed)
    _, e, arms = (part[:number] for part in links(base, body, pose))
    rows = pluecker_rows(arms, e)
    split = Split(rows, pose[:3], np.arange(6), rng.uniform(0.005, 0.05, number), size_mm=150.0)
    assert split.lost.mm_per_mm < 1e-12
    np.testing.assert_allclose(rows @ split.twist, 0.0, atol=1e-12)
    changes = rng.normal(size=(2, number))
    found, u = split.determined(changes)
    np.testing.assert_allclose(found @ rows.T, changes, atol=1e-9)
    np.testing.assert_allclose(found @ (split.metric * split.twist), 0.0, atol=1e-9)
    assert np.isfinite(u).all()
