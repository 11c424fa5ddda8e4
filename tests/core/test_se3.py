"""Poses as arrays: the laws of rigid motions, twists against the matrix exponential, adjoints against differences, batches."""

import math
from collections.abc import Callable

import numpy as np
import oracles
import pytest
from hypothesis import given, settings, strategies as st
from scipy.linalg import expm
from scipy.spatial.transform import RigidTransform, Rotation

from lmeasure.core import FloatArray, se3
from lmeasure.kernels import se3 as kernel

METRE = 1000.0
TURNS = [0.0, 1e-300, 1e-160, 1e-12, 1e-8, 1e-5, 1e-3, 0.1, 1.0, 3.0, math.pi - 1e-3, math.pi - 1e-6, math.pi - 1e-9]

laws = settings(max_examples=60, deadline=None, derandomize=True)
seeds = st.integers(0, 2**32 - 1)
angles = st.sampled_from(TURNS) | st.floats(0.0, math.pi - 1e-9)


def generator(twist: FloatArray) -> FloatArray:
    out = np.zeros((4, 4))
    out[:3, :3], out[:3, 3] = oracles.skew(twist[:3]), twist[3:]
    return out


def matrix(pose: FloatArray) -> FloatArray:
    """(4, 4) by the textbook's formula."""
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = oracles.matrix_of_quaternion(pose[3:]), pose[:3]
    return out


def drawn(seed: int, *shape: int) -> FloatArray:
    """(*shape, 7) poses within metres of each other."""
    rng = np.random.default_rng(seed)
    q = rng.normal(size=(*shape, 4))
    return np.concatenate([METRE * rng.normal(size=(*shape, 3)), q / np.linalg.norm(q, axis=-1, keepdims=True)], axis=-1)


def twist_of(turn: float, seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    return np.concatenate([turn * axis / np.linalg.norm(axis), METRE * rng.normal(size=3)])


def assert_same(found: FloatArray, expected: FloatArray, mm: float = 1e-11, rad: float = 1e-14) -> None:
    """Equal poses, whichever sign their quaternions have."""
    np.testing.assert_allclose(found[..., :3], expected[..., :3], rtol=0, atol=mm)
    off = np.abs(np.sum(found[..., 3:] * expected[..., 3:], axis=-1)) - 1.0
    sign = np.sign(np.sum(found[..., 3:] * expected[..., 3:], axis=-1, keepdims=True))
    np.testing.assert_allclose(off, 0.0, atol=rad)
    np.testing.assert_allclose(found[..., 3:], sign * expected[..., 3:], rtol=0, atol=rad)


@laws
@given(seeds)
def test_poses_are_a_group(seed: int) -> None:
    a_from_b, b_from_c, c_from_d = drawn(seed, 3)
    identity = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert_same(se3.compose(se3.compose(a_from_b, b_from_c), c_from_d), se3.compose(a_from_b, se3.compose(b_from_c, c_from_d)))
    assert_same(se3.compose(a_from_b, identity), a_from_b)
    assert_same(se3.compose(identity, a_from_b), a_from_b)
    assert_same(se3.compose(a_from_b, se3.inverse(a_from_b)), identity)
    assert_same(se3.compose(se3.inverse(a_from_b), a_from_b), identity)
    assert_same(se3.between(a_from_b, se3.compose(a_from_b, b_from_c)), b_from_c)


@laws
@given(seeds)
def test_they_are_the_products_of_their_matrices(seed: int) -> None:
    a_from_b, b_from_c = drawn(seed, 2)
    point = METRE * np.random.default_rng([seed, 1]).normal(size=3)
    np.testing.assert_allclose(matrix(se3.compose(a_from_b, b_from_c)), matrix(a_from_b) @ matrix(b_from_c), rtol=0, atol=1e-11)
    np.testing.assert_allclose(matrix(se3.inverse(a_from_b)), np.linalg.inv(matrix(a_from_b)), rtol=0, atol=1e-11)
    np.testing.assert_allclose(se3.apply(a_from_b, point), (matrix(a_from_b) @ [*point, 1.0])[:3], rtol=0, atol=1e-11)
    np.testing.assert_allclose(se3.matrices(a_from_b), matrix(a_from_b)[:3, :3], rtol=0, atol=1e-15)
    assert_same(se3.pose(a_from_b[:3], se3.rotation(a_from_b)), a_from_b)


@laws
@given(seeds)
def test_what_lies_between_two_frames_does_not_depend_on_the_third(seed: int) -> None:
    world_from_base, base_from_a, base_from_b = drawn(seed, 3)
    moved = se3.between(se3.compose(world_from_base, base_from_a), se3.compose(world_from_base, base_from_b))
    assert_same(moved, se3.between(base_from_a, base_from_b), mm=1e-10)


@laws
@given(angles, seeds)
def test_exponential_is_the_matrix_exponential(turn: float, seed: int) -> None:
    twist = twist_of(turn, seed)
    found = se3.exp(twist)
    np.testing.assert_allclose(matrix(found), expm(generator(twist)), rtol=0, atol=1e-9)  # the error of expm itself
    omega, v = tuple(twist[:3].tolist()), tuple(twist[3:].tolist())
    assert_same(found, np.concatenate([kernel.exp_translation(omega, v), kernel.exp_rotation(omega)]), mm=3e-12)


@laws
@given(angles, seeds)
def test_logarithm_gives_the_twist_back(turn: float, seed: int) -> None:
    """Down to the tiniest turn, and to one that is nearly half: there the axis is known to a rounding over what is missing."""
    twist = twist_of(turn, seed)
    found = se3.log(se3.exp(twist))
    np.testing.assert_allclose(found[:3], twist[:3], rtol=1e-14, atol=1e-15)
    np.testing.assert_allclose(found[3:], twist[3:], rtol=0, atol=1e-10)


@laws
@given(st.floats(0.0, math.pi), seeds)
def test_a_pose_comes_back_from_its_logarithm(turn: float, seed: int) -> None:
    """Half a turn too, of which two twists tell."""
    pose = se3.exp(twist_of(turn, seed))
    assert_same(se3.exp(se3.log(pose)), pose, mm=1e-10)


def test_exponential_agrees_with_scipy_where_that_is_sound() -> None:
    twists = np.array([twist_of(turn, i) for i, turn in enumerate((0.01, 0.5, 1.0, 2.0, 3.0))])
    theirs = RigidTransform.from_exp_coords(twists)
    assert_same(se3.exp(twists), np.column_stack([theirs.translation, theirs.rotation.as_quat()]), mm=1e-10)


@laws
@given(st.sampled_from(TURNS), seeds)
def test_displacements_are_turn_and_shift_in_the_outer_axes(turn: float, seed: int) -> None:
    pose, delta = drawn(seed), twist_of(turn, seed)
    moved = se3.displaced(pose, delta)
    assert_same(moved, oracles.compose(pose, delta[:3], delta[3:]))
    back = se3.displacement(moved, pose)
    np.testing.assert_allclose(back[3:], delta[3:], rtol=0, atol=1e-11)
    # both quaternions are rounded: of the turn 1e-15 rad is left
    np.testing.assert_allclose(Rotation.from_rotvec(back[:3]).as_matrix(), Rotation.from_rotvec(delta[:3]).as_matrix(), rtol=0, atol=2e-15)


@laws
@given(seeds)
def test_adjoint_takes_a_twist_to_the_other_frame(seed: int) -> None:
    """exp(Ad xi) g = g exp(xi), for finite twists."""
    a_from_b, twist = drawn(seed), twist_of(1.0, seed)
    in_a = se3.adjoint(a_from_b) @ twist
    assert_same(se3.compose(se3.exp(in_a), a_from_b), se3.compose(a_from_b, se3.exp(twist)), mm=1e-10)


@laws
@given(seeds)
def test_adjoint_is_the_derivative_of_conjugation(seed: int) -> None:
    a_from_b, step = drawn(seed), 1e-5
    there = matrix(a_from_b)
    for i, unit in enumerate(np.eye(6)):
        ways = [there @ expm(generator(sign * step * unit)) @ np.linalg.inv(there) for sign in (1.0, -1.0)]
        by = (ways[0] - ways[1]) / (2.0 * step)
        column = np.array([by[2, 1], by[0, 2], by[1, 0], *by[:3, 3]])
        np.testing.assert_allclose(se3.adjoint(a_from_b)[:, i], column, rtol=1e-7, atol=1e-6)


@laws
@given(seeds)
def test_adjoints_multiply_as_their_poses(seed: int) -> None:
    a_from_b, b_from_c = drawn(seed, 2)
    found = se3.adjoint(se3.compose(a_from_b, b_from_c))
    np.testing.assert_allclose(found, se3.adjoint(a_from_b) @ se3.adjoint(b_from_c), rtol=0, atol=1e-10)
    np.testing.assert_allclose(se3.adjoint(se3.inverse(a_from_b)), np.linalg.inv(se3.adjoint(a_from_b)), rtol=0, atol=1e-9)


@laws
@given(seeds)
def test_a_point_of_the_tool_moves_with_it(seed: int) -> None:
    """To first order, as errors of the tool origin are taken to a point at an arm."""
    pose, delta = drawn(seed), 1e-6 * twist_of(1.0, seed)
    offset = np.random.default_rng([seed, 2]).normal(size=3) * 100.0
    arm = se3.apply(pose, offset) - pose[:3]
    moved = se3.apply(se3.displaced(pose, delta), offset) - se3.apply(pose, offset)
    np.testing.assert_allclose((se3.at_points(arm) @ delta)[3:], moved, rtol=0, atol=1e-9)
    np.testing.assert_array_equal((se3.at_points(arm) @ delta)[:3], delta[:3])


@pytest.mark.parametrize("size", [0.0, 1e-9, 1e-5, 1e-3, 0.1, 1.0, 3.0])
def test_left_jacobian_against_the_exponential(size: float) -> None:
    """The integral of exp(s [a]x) over s from 0 to 1, as a block of a matrix exponential."""
    a = np.array([0.6, -0.64, 0.48]) * size
    K = np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])
    whole = expm(np.block([[K, np.eye(3)], [np.zeros((3, 6))]]))
    np.testing.assert_allclose(se3.left_jacobians(a), whole[:3, 3:], rtol=1e-14, atol=1e-15)


BINARY: dict[str, Callable[[FloatArray, FloatArray], FloatArray]] = {
    "compose": se3.compose,
    "between": se3.between,
    "displacement": se3.displacement,
    "apply": lambda poses, other: se3.apply(poses, other[..., :3]),
    "displaced": lambda poses, other: se3.displaced(poses, other[..., :6] / METRE),
}
UNARY: dict[str, Callable[[FloatArray], FloatArray]] = {
    "inverse": se3.inverse, "matrices": se3.matrices, "log": se3.log, "adjoint": se3.adjoint,
    "exp": lambda poses: se3.exp(poses[..., :6] / METRE), "at_points": lambda poses: se3.at_points(poses[..., :3]),
    "left_jacobians": lambda poses: se3.left_jacobians(poses[..., 3:6]),
}  # fmt: skip


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize(
    ("shape", "other"), [((), ()), ((5,), ()), ((), (5,)), ((5,), (5,)), ((2, 3), ()), ((2, 3), (3,)), ((2, 1), (4, 1, 3))]
)
def test_batches_broadcast(name: str, shape: tuple[int, ...], other: tuple[int, ...]) -> None:
    """Every pose of a batch is what it is alone."""
    one, two = drawn(1, *shape), drawn(2, *other)
    found = BINARY[name](one, two)
    batch = np.broadcast_shapes(shape, other)
    assert found.shape[:-1] == batch
    one, two = np.broadcast_to(one, (*batch, 7)), np.broadcast_to(two, (*batch, 7))
    for index in np.ndindex(batch):
        np.testing.assert_allclose(found[index], BINARY[name](one[index], two[index]), rtol=1e-14, atol=1e-12)


@pytest.mark.parametrize("name", UNARY)
@pytest.mark.parametrize("shape", [(), (5,), (2, 3)])
def test_batches_of_one_argument(name: str, shape: tuple[int, ...]) -> None:
    poses = drawn(3, *shape)
    found = UNARY[name](poses)
    for index in np.ndindex(shape):
        np.testing.assert_allclose(found[index], UNARY[name](poses[index]), rtol=1e-14, atol=1e-12)


def test_the_sign_of_a_quaternion_is_kept() -> None:
    """Quaternions of a motion are continuous in a file, which matrices would undo."""
    poses = drawn(4, 20)
    np.testing.assert_allclose(se3.displaced(poses, np.zeros(6))[:, 3:], poses[:, 3:], rtol=0, atol=3e-16)
    np.testing.assert_allclose(se3.pose(poses[:, :3], se3.rotation(poses))[:, 3:], poses[:, 3:], rtol=0, atol=3e-16)


def test_an_orientation_that_is_not_known_is_refused() -> None:
    poses = drawn(5, 3)
    poses[1, 3:] = np.nan
    with pytest.raises(ValueError, match="quaternion"):
        se3.matrices(poses)
