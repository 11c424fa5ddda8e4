"""Finite screws: the exponential against that of the matrix, the logarithm of turns, down to the tiniest turn at a metre."""

import math

import mpmath as mp
import numpy as np
import oracles
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm

from lmeasure.core import FloatArray
from lmeasure.kernels import se3, vector

Vec3 = tuple[float, float, float]

METRE = 1000.0


def exp_screw(w: tuple[float, ...], v: tuple[float, ...]) -> tuple[Vec3, tuple[float, float, float, float]]:
    """Return translation and quaternion of the displacement by the twist (w; v)."""
    return se3.exp_translation(w, v), se3.exp_rotation(w)


def screws(turn: float, number: int = 8, seed: int = 1) -> list[tuple[Vec3, Vec3]]:
    """Twists that turn by the angle about random axes and shift by a metre."""
    g = np.random.default_rng(seed)
    out = []
    for _ in range(number):
        axis, v = g.normal(size=3), g.normal(size=3)
        w = turn * axis / np.linalg.norm(axis)
        v = METRE * v / np.linalg.norm(v)
        out.append((tuple(w.tolist()), tuple(v.tolist())))
    return out


def exact_displacement(w: Vec3, v: Vec3) -> FloatArray:
    """V v from the power series of the matrix exponential, in 40 digits."""
    a = mp.matrix([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    term, total = mp.matrix(v), mp.matrix(v)
    for n in range(2, 60):
        term = a * term / n
        total = total + term
    return np.array([float(x) for x in total])


TURNS = [0.0, 5e-324, 1e-300, 1e-160, 1e-20, 1e-12, 1e-8, 1e-5, 1e-3, 0.1, 0.49, 0.5, 0.51, 1.0, 2.0, 3.0, math.pi - 1e-9, math.pi]


@pytest.mark.parametrize("turn", TURNS)
def test_exponential_is_the_matrix_exponential(turn: float) -> None:
    for w, v in screws(turn):
        translation, q = exp_screw(w, v)
        generator = np.zeros((4, 4))
        generator[:3, :3], generator[:3, 3] = oracles.skew(w), v
        expected = expm(generator)
        assert oracles.matrix_of_quaternion(q) == pytest.approx(expected[:3, :3], abs=1e-13)  # the error of expm itself
        assert translation == pytest.approx(expected[:3, 3].tolist(), abs=1e-9)
        assert np.asarray(translation) == pytest.approx(exact_displacement(w, v), abs=1e-12)
        assert math.hypot(*q) == pytest.approx(1, abs=4e-16)


@pytest.mark.parametrize("turn", [t for t in TURNS if t < math.pi])
def test_logarithm_of_both_signs_of_a_quaternion_gives_the_turn_back(turn: float) -> None:
    # at half a turn the sign of the axis is a matter of rounding
    for w, _ in screws(turn):
        q = se3.exp_rotation(w)
        for same in (q, tuple(-x for x in q)):
            found = se3.log_rotation(same)
            assert found == pytest.approx(w, rel=1e-14, abs=1e-15 * max(1.0, 1.0 / (math.pi - turn)) if turn > 1e-3 else 1e-323)


def test_a_tiny_turn_at_a_metre_is_not_lost() -> None:
    """One nanoradian moves a shift of a metre by half a nanometre times a thousand: the loose branches of other codes lose micrometres."""
    t, _ = exp_screw((0.0, 0.0, 1e-9), (METRE, 0.0, 0.0))
    assert t[1] == pytest.approx(0.5e-9 * METRE, rel=1e-12)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1, 1), min_size=10, max_size=10), st.floats(1e-12, 3.1))
def test_displacements_compose_and_invert(x: list[float], turn: float) -> None:
    w = np.array(x[:3]) + [0, 0, 1.5]
    w = turn * w / np.linalg.norm(w)
    omega, v = tuple(w.tolist()), (x[3], x[4], x[5])
    t, q = exp_screw(omega, v)
    # the same screw twice is the screw of twice the length
    t2, q2 = exp_screw(tuple(2 * c for c in omega), tuple(2 * c for c in v))
    twice = np.asarray(vector.rotate(q, t)) + t
    assert twice == pytest.approx(np.asarray(t2), abs=1e-13)
    assert oracles.matrix_of_quaternion(vector.multiply(q, q)) == pytest.approx(oracles.matrix_of_quaternion(q2), abs=1e-13)
    # the opposite screw undoes it
    back, p = exp_screw(tuple(-c for c in omega), tuple(-c for c in v))
    assert np.asarray(vector.rotate(p, t)) + back == pytest.approx(np.zeros(3), abs=1e-13)


@settings(max_examples=200, deadline=None, derandomize=True)
@given(st.lists(st.floats(-1, 1), min_size=11, max_size=11))
def test_vectors_and_quaternions_as_matrices(x: list[float]) -> None:
    p = np.array(x[:4]) + [0, 0, 0, 1.5]
    q = np.array(x[4:8]) + [1.5, 0, 0, 0]
    p, q = p / np.linalg.norm(p), q / np.linalg.norm(q)
    a = np.array(x[8:])
    A, B = oracles.matrix_of_quaternion(p), oracles.matrix_of_quaternion(q)
    assert vector.rotate(tuple(p.tolist()), tuple(a.tolist())) == pytest.approx((A @ a).tolist(), abs=1e-14)
    assert vector.rotate_back(tuple(p.tolist()), tuple(a.tolist())) == pytest.approx((A.T @ a).tolist(), abs=1e-14)
    assert oracles.matrix_of_quaternion(vector.multiply(tuple(p.tolist()), tuple(q.tolist()))) == pytest.approx(A @ B, abs=1e-14)
    assert vector.cross(tuple(a.tolist()), (1.0, 2.0, 3.0)) == pytest.approx((oracles.skew(a) @ [1, 2, 3]).tolist(), abs=1e-14)
