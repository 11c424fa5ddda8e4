"""What residuals do not tell, by owners and by as few parameters as can be: of problems that have nothing to do with cables."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from lmeasure.estimation import Parameters, by_few, by_owner

NAMES = ("a.x", "a.y", "b.x", "b.y", "c.x")
PARAMETERS = Parameters(NAMES, np.zeros(5), np.array([1.0, 2.0, 3.0, 4.0, 5.0]))


def mixed(directions: np.ndarray, seed: int) -> np.ndarray:
    """Another orthonormal basis of the same subspace."""
    Q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(directions), len(directions))))
    return np.asarray(Q @ directions)


@given(st.integers(0, 1000))
def test_each_owner_has_its_own_and_what_is_shared_comes_last(seed: int) -> None:
    own = np.array([0.6, -0.8, 0.0, 0.0, 0.0])
    shared = np.array([0.8 * np.sqrt(0.08), 0.6 * np.sqrt(0.08), np.sqrt(0.22), np.sqrt(0.22), -np.sqrt(0.48)])
    found = by_owner(PARAMETERS, mixed(np.array([own, shared]), seed))
    assert [(d.owner, d.alone) for d in found] == [("a", True), ("c", False)]
    # the largest part of an owner's is positive; a shared one has no sign of its own
    np.testing.assert_allclose(found[0].weight, -own, atol=1e-12)
    assert abs(float(found[1].weight @ shared)) == pytest.approx(1.0, abs=1e-12)
    assert [(owner, at.tolist()) for owner, at in found[0].parts(PARAMETERS)] == [("a", [0, 1])]
    assert [(owner, at.tolist()) for owner, at in found[1].parts(PARAMETERS)] == [("c", [4]), ("b", [2, 3])]


def test_the_largest_part_of_an_owners_direction_is_positive() -> None:
    """Whatever it is in the subspace: nobody is told the same direction with another sign on another machine."""
    for angle in np.linspace(0.05, 2.0 * np.pi, 40):
        (found,) = by_owner(PARAMETERS, np.array([[np.cos(angle), np.sin(angle), 0.0, 0.0, 0.0]]))
        assert found.weight[np.argmax(np.abs(found.weight))] > 0.7
        assert abs(found.weight[0] * np.sin(angle) - found.weight[1] * np.cos(angle)) < 1e-12


def test_small_parts_of_others_are_not_reported() -> None:
    direction = np.array([[0.0, 0.0, np.sqrt(0.48), np.sqrt(0.48), 0.2]])
    (found,) = by_owner(PARAMETERS, direction)
    assert (found.owner, found.alone) == ("b", True)
    even = np.array([[0.68, 0.0, 0.68, 0.0, np.sqrt(1 - 2 * 0.68**2)]])
    (found,) = by_owner(PARAMETERS, even)
    assert not found.alone
    assert {owner for owner, _ in found.parts(PARAMETERS)} == {"a", "b"}


def test_a_direction_that_two_share_alike_is_told_of_both_and_once() -> None:
    """Be it one of two owners, or two of three: as many are told as there are."""
    (found,) = by_owner(PARAMETERS, np.array([[1.0, 0.0, 1.0, 0.0, 0.0]]) / np.sqrt(2.0))
    assert not found.alone
    assert {owner for owner, _ in found.parts(PARAMETERS)} == {"a", "b"}
    three = np.array([[1.0, 0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 1.0, 0.0, -2.0]]) / np.sqrt([[2.0], [6.0]])
    for seed in range(5):
        assert [d.alone for d in by_owner(PARAMETERS, mixed(three, seed))] == [True, False]


def test_owners_are_told_in_the_order_of_their_parameters() -> None:
    """Though the one that is told first is the one that is clearest."""
    silent = np.array([[0.0, 0.0, 1.0, 0.0, 0.0], [0.95, 0.0, 0.0, 0.0, np.sqrt(1.0 - 0.95**2)]])
    first, last = PARAMETERS.owner(0), PARAMETERS.owner(2)
    assert first != last
    assert [d.owner for d in by_owner(PARAMETERS, silent)] == [first, last]


def test_an_owner_with_a_third_of_a_direction_is_reported() -> None:
    part = np.sqrt((1.0 - 0.35**2) / 2.0)
    (found,) = by_owner(PARAMETERS, np.array([[part, 0.0, part, 0.0, 0.35]]))
    assert {owner for owner, _ in found.parts(PARAMETERS)} == {"a", "b", "c"}


@given(st.integers(0, 1000))
def test_few_parameters_are_found_in_any_basis(seed: int) -> None:
    sparse = np.array([[1.0, 0.5, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0, -0.2]])
    silent = np.linalg.qr(sparse.T)[0].T
    rows, pivots = by_few(mixed(silent, seed))
    order = np.argsort(pivots)
    assert pivots[order].tolist() == [0, 2]
    np.testing.assert_allclose(rows[order], sparse, atol=1e-12)
    assert by_owner(PARAMETERS, np.zeros((0, 5))) == []
