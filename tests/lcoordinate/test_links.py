"""Bodies on straight links: rows and pressure angles against differences, the twist that is lost."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from lmeasure import se3
from lmeasure.arrays import FloatArray
from lmeasure.lcoordinate.pluecker import pluecker_rows, pressure_angles
from lmeasure.lcoordinate.singular import Split

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
