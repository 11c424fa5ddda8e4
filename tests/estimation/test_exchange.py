"""Which measurements to make: updates against the criterion itself, the search against trying everything, sums against covariances."""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Self

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from problems import Line, Readings

from lmeasure.core import FloatArray
from lmeasure.estimation import (
    Criterion,
    Numbered,
    blocks,
    empty,
    estimated_covariance,
    fit,
    grown,
    improved,
    ordered,
    parameter_information,
)
from lmeasure.estimation.exchange import WORST


@pytest.mark.parametrize("kind", ["I", "G", "D"])
@given(seed=st.integers(0, 10_000))
def test_rank_one_style_updates_are_the_criterion_itself(kind: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    p, q, m = 5, 11, 3
    criterion = Criterion(kind, rng.normal(size=(7, p)))
    M = np.eye(q) + (root := rng.normal(size=(4, q)) * 10 ** rng.uniform(-1, 2)).T @ root
    tried = rng.normal(size=(6, m, q)) * 10 ** rng.uniform(-1, 2)
    direct = [criterion.value(M + A.T @ A) for A in tried]
    np.testing.assert_allclose(criterion.values(M, tried), direct, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("shared", [0, 3])
def test_criteria_are_those_of_the_covariance_of_the_parameters(shared: int) -> None:
    """Mean and largest variance of targets, and the logarithm of the determinant, of what shared errors leave."""
    rng, p = np.random.default_rng(3), 4
    root, targets = rng.normal(size=(9, p + shared)), rng.normal(size=(7, p))
    M = root.T @ root + np.eye(p + shared)
    covariance = np.linalg.inv(M)[:p, :p]
    variances = [float(t @ covariance @ t) for t in targets]
    expected = {"I": np.mean(variances), "G": max(variances), "D": np.log(np.linalg.det(covariance))}
    assert {kind: Criterion(kind, targets).value(M) for kind in expected} == pytest.approx(expected)


@pytest.mark.parametrize("kind", ["I", "G", "D"])
@given(seed=st.integers(0, 10_000))
def test_the_best_is_the_least_of_all_values(kind: str, seed: int) -> None:
    """More targets and blocks than are looked at together."""
    rng = np.random.default_rng(seed)
    p, q, m = 4, 6, 2
    criterion = Criterion(kind, rng.normal(size=(3 * WORST, p)) * rng.uniform(0.1, 2.0, (3 * WORST, 1)))
    M = np.eye(q) + (root := rng.normal(size=(4, q)) * 10 ** rng.uniform(-1, 2)).T @ root
    tried = rng.normal(size=(2 * WORST, m, q)) * 10 ** rng.uniform(-1, 2, (2 * WORST, 1, 1))
    free = rng.uniform(size=len(tried)) < 0.7
    free[rng.integers(len(tried))] = True
    i, value = criterion.best(M, tried, free)
    assert free[i]
    assert value == pytest.approx(criterion.value(M + tried[i].T @ tried[i]), rel=1e-6, abs=1e-9)
    assert value == pytest.approx(criterion.values(M, tried)[free].min(), rel=1e-9, abs=1e-12)


@pytest.mark.parametrize("kind", ["I", "G", "D"])
def test_readings_of_a_parabola_are_chosen_as_by_trying_all(kind: str) -> None:
    """Nothing of cables: 4 of 11 places at which to read, each once; the order is that of what each brings."""
    x = np.linspace(-1.0, 1.0, 11)
    parabola = Line(Readings(x, np.zeros(11), u=0.1), degree=2)
    determined = blocks((parabola.jacobian(parabola.start) * parabola.parameters.width)[:, None, :], np.array([0.1**2]))
    criterion = Criterion(kind, np.vander(np.linspace(-1.0, 1.0, 50), 3, increasing=True) * parabola.parameters.width)
    rng = np.random.default_rng(1)
    design = improved(grown(empty(Numbered(determined), np.eye(3)), 4, None, rng), criterion, rng)
    every = {
        c: criterion.value(np.eye(3) + sum((determined[i].T @ determined[i] for i in c), np.zeros((3, 3))))
        for c in combinations(range(11), 4)
    }
    assert len(set(design.points[:, 0])) == 4
    assert criterion.value(design.information) == pytest.approx(min(every.values()), rel=1e-9, abs=1e-9)
    steps = ordered(design, criterion)
    M = np.eye(3)
    for i, own in enumerate(steps.blocks):
        left = [criterion.value(M + A.T @ A) for A in steps.blocks[i:]]
        assert left[0] == pytest.approx(min(left), rel=1e-9)
        M = M + own.T @ own
    np.testing.assert_allclose(M, design.information, rtol=1e-12, atol=1e-9)


def test_no_more_is_chosen_than_there_is() -> None:
    determined = np.random.default_rng(2).normal(size=(3, 1, 2))
    criterion = Criterion("I", np.eye(2))
    design = grown(empty(Numbered(determined), np.eye(2)), 5, criterion, np.random.default_rng(0))
    assert sorted(design.points[:, 0]) == [0.0, 1.0, 2.0]


def test_information_of_readings_that_share_an_error_is_the_estimators() -> None:
    """A zero read once is in all readings: its elimination is the generalised least squares with the full covariance."""
    x, u, shared = np.linspace(-1.0, 2.0, 8), 0.1, 0.4
    problem = Line(Readings(x, 0.3 + 0.5 * x, u=u, more=np.full((8, 8), shared**2)))
    found = fit(problem, problem.start)
    width = problem.parameters.width
    derivatives = np.column_stack([problem.jacobian(problem.start) * width, np.full(8, shared)])[:, None, :]
    A = blocks(derivatives, np.array([[u**2]]))
    np.testing.assert_allclose(A, blocks(derivatives, np.array([u**2])), rtol=1e-12)
    covariance, rank = estimated_covariance(parameter_information(np.einsum("nmq,nmr->qr", A, A), 2))
    assert rank == found.rank == 2
    np.testing.assert_allclose(covariance * np.outer(width, width), found.covariance, rtol=1e-9)


@dataclass(frozen=True)
class OnALine:
    """Places at which a parabola may be read, from -1 to 1 and coarsely spaced, by an instrument of so much gain."""

    gain: float = 1.0

    @property
    def pool(self) -> FloatArray:
        return np.array([-1.0, -0.7, -0.3, 0.2, 0.6, 1.0])[:, None]

    @property
    def determined(self) -> FloatArray:
        return self.blocks(self.pool)

    def blocks(self, points: FloatArray) -> FloatArray:
        return self.gain * np.vander(points[:, 0], 3, increasing=True)[:, None, :]

    def apart(self, tried: FloatArray, points: FloatArray) -> NDArray[np.bool_]:
        return np.asarray(~np.isclose(tried, points[:, 0]).any(axis=1))

    def beside(self, points: FloatArray) -> list[FloatArray]:
        return [np.clip(x + np.array([-0.1, 0.1]), -1.0, 1.0)[:, None] for x in points[:, 0]]

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[tuple[Self, FloatArray]]:
        return () if near else ((one, one.blocks(points)) for one in (replace(self, gain=gain) for gain in (0.5, 3.0, 2.0)))


def test_places_beside_and_what_all_hang_on_are_tried_too() -> None:
    """The best three places for a parabola are the ends and the middle (Atkinson, Donev and Tobias 2007, 11.2), two steps from the nearest
    candidate; and the best of the instruments."""
    criterion = Criterion("D", np.eye(3))
    design = grown(empty(OnALine(), 1e-9 * np.eye(3)), 3, criterion, np.random.default_rng(0))
    assert set(design.points[:, 0]) == {-1.0, 1.0, 0.2}
    better = improved(design, criterion, np.random.default_rng(0))
    np.testing.assert_allclose(np.sort(better.points[:, 0]), [-1.0, 0.0, 1.0], atol=1e-12)
    assert better.candidates.gain == 3.0
    # det of the information: the square of the Vandermonde determinant and of the gain
    np.testing.assert_allclose(np.linalg.det(better.information), 4.0 * 3.0**6, rtol=1e-6)


@dataclass(frozen=True)
class Hills(OnALine):
    """Places at which readings tell of one value, along two hills of which the second is the higher; two of them are known coarsely."""

    @property
    def pool(self) -> FloatArray:
        return np.array([-0.5, 0.5])[:, None]

    def blocks(self, points: FloatArray) -> FloatArray:
        x = points[:, 0]
        return np.asarray(np.maximum(1.0 - 2.0 * np.abs(x + 0.8), 2.0 - 3.0 * np.abs(x - 0.7)).clip(0.05)[:, None, None])

    def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[tuple[Self, FloatArray]]:
        return ()


def test_what_lies_beside_is_tried_last() -> None:
    """Beside the better of the coarse places, and not beside the one that it begins with."""
    begun = replace(empty(Hills(), np.eye(1)), points=np.array([[-0.5]]), blocks=Hills().blocks(np.array([[-0.5]])))
    best = improved(begun, Criterion("D", np.eye(1)), np.random.default_rng(0))
    np.testing.assert_allclose(best.points, [[0.7]], atol=1e-12)


def test_it_ends_when_nothing_is_gained() -> None:
    """What all hang on is formed anew once for a sweep that gains nothing, coarsely and finely."""
    requested: list[bool] = []

    @dataclass(frozen=True)
    class Asked(OnALine):
        def others(self, points: FloatArray, near: bool, rng: np.random.Generator) -> Iterable[tuple[Self, FloatArray]]:
            requested.append(near)
            return ()

    points = np.array([-1.0, 0.0, 1.0])[:, None]
    begun = replace(empty(Asked(), 1e-9 * np.eye(3)), points=points, blocks=Asked().blocks(points))
    assert improved(begun, Criterion("D", np.eye(3)), np.random.default_rng(0)).points.tolist() == points.tolist()
    assert requested == [False, True]


def test_worth_an_exchange_is_what_makes_the_criterion_less() -> None:
    """Variances by their ratio, logarithms of a determinant by their difference: from a ten-thousandth on."""
    by_variance, by_determinant = Criterion("I", np.eye(2)), Criterion("D", np.eye(2))
    assert by_variance.better(0.9, 1.0)
    assert not by_variance.better(1.0, 1.0)
    assert not by_variance.better(0.99992, 1.0)
    assert by_variance.better(0.99988, 1.0)
    assert by_determinant.better(-5.1, -5.0)
    assert not by_determinant.better(-5.0, -5.0)
    assert not by_determinant.better(-5.00008, -5.0)
    assert by_determinant.better(-5.00012, -5.0)


def test_numbered_candidates_are_what_their_numbers_say() -> None:
    determined = np.random.default_rng(2).normal(size=(3, 1, 2))
    design = grown(empty(Numbered(determined), np.eye(2)), 2, None, np.random.default_rng(1))
    np.testing.assert_array_equal(Numbered(determined[::-1]).blocks(design.points), determined[2 - design.points[:, 0].astype(int)])
    assert [len(beside) for beside in Numbered(determined).beside(design.points)] == [0, 0]
    np.testing.assert_array_equal(design.blocks, determined[design.points[:, 0].astype(int)])


def test_what_data_tell_less_of_than_the_prior_keeps_its_width() -> None:
    covariance, rank = estimated_covariance(np.diag([100.0, 1.25, 0.8]))
    np.testing.assert_allclose(covariance, np.diag([0.01, 0.8, 1.0]))
    assert rank == 2
