"""What a robot that stands still hides: rounding errors of repeated poses against counts that are rounded."""

import numpy as np
import pytest

from lmeasure.core import FloatArray, symmetric_root
from lmeasure.trajectory import PoseErrors, of_crossings, of_dwells
from lmeasure.trajectory.uncertainty.rounding import kept, scatter_counts, whitened_variance


@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.1, 0.2, 0.3])
def test_correlation_of_rounding_errors_is_that_of_rounded_counts(sigma: float) -> None:
    rng = np.random.default_rng(1)
    mean = rng.uniform(0, 1, (400_000, 1))
    lengths = mean + sigma * rng.normal(size=(400_000, 2))
    errors = np.rint(lengths) - lengths
    assert kept(sigma) == pytest.approx(12.0 * np.mean(errors[:, 0] * errors[:, 1]), abs=0.01)


@pytest.mark.parametrize("sigma", [0.0, 0.1, 0.3, 1.0, 10.0])
def test_scatter_is_found_from_rounded_counts(sigma: float) -> None:
    rng = np.random.default_rng(2)
    lengths = rng.uniform(0, 1, (4000, 1)) + sigma * rng.normal(size=(4000, 100))
    observed = 12.0 * np.rint(lengths).var(axis=1, ddof=1).mean()
    assert scatter_counts(observed) == pytest.approx(sigma, rel=0.02, abs=0.005)


def test_whitened_variance_counts_only_what_is_measured() -> None:
    one = np.diag([0.0, 0.0, 0.0, 1.0, 4.0, 9.0])
    assert whitened_variance(3.0 * one, one) == pytest.approx(3.0)
    assert whitened_variance(np.eye(6), np.zeros((6, 6))) == 0.0


def test_errors_of_counts_are_drawn_uniform_and_others_normal() -> None:
    own, rng = np.zeros((1, 6, 2)), np.random.default_rng(1)
    for rounded, most, kurtosis in ((True, np.sqrt(3.0), 1.8), (False, np.inf, 3.0)):
        drawn = PoseErrors.of(own, np.zeros((1, 6, 0)), rounded=rounded).drawn(rng, (100_000,))
        assert abs(drawn.mean()) < 0.02
        assert drawn.var() == pytest.approx(1.0, rel=0.02)
        assert (drawn**4).mean() == pytest.approx(kurtosis, rel=0.05)
        assert np.abs(drawn).max() <= most


def test_dwells_of_a_still_robot_are_one_draw_and_share_it() -> None:
    one = np.diag(np.repeat([1e-10, 1e-5], 3))
    errors = PoseErrors.of(symmetric_root(np.tile(one, (4, 1, 1))), np.zeros((4, 6, 0)))
    still = of_dwells(errors, np.ones((4, 6)), np.zeros((6, 6)), np.zeros(4, dtype=np.int64))
    np.testing.assert_allclose(still.random, errors.random)
    np.testing.assert_allclose(still.local @ still.local.transpose(0, 2, 1), errors.random, atol=1e-18)
    np.testing.assert_allclose(still.factors @ still.factors.transpose(0, 2, 1), errors.random, atol=1e-18)
    # means of a hundred readings each, and motion of many counts between the dwells: nothing is in common
    moving = of_dwells(errors, np.full((4, 6), 0.01), 5000.0 * one, np.zeros(4, dtype=np.int64))
    # of two places two dwells each, and of one that stands alone: what is in common is so within a place
    apart = of_dwells(errors, np.ones((4, 6)), np.zeros((6, 6)), np.array([0, 1, 0, 2]))
    np.testing.assert_allclose(apart.factors[0] @ apart.factors[2].T, one, atol=1e-18)
    assert not (apart.factors[0] @ apart.factors[1].T).any()
    assert not apart.local[[1, 3]].any()
    np.testing.assert_allclose(moving.random, errors.random / 100.0, rtol=1e-6)
    assert np.abs(moving.local).max() < 1e-12


def test_nothing_measured_keeps_nothing() -> None:
    one = np.diag([0.0, 0.0, 0.0, 1.0, 4.0, 9.0])
    both = whitened_variance(np.stack([one, np.eye(6)]), np.stack([one, np.zeros((6, 6))]))
    np.testing.assert_allclose(both, [1.0, 0.0])


COUNT = 0.01
QUARTER = np.array([-0.0546875, 0.8203125, 0.2734375, -0.0390625])
"""Of the cubic through four samples a quarter of the way from the second to the third: -7/128, 105/128, 35/128, -5/128."""


def crossed(steps_counts: FloatArray, apart_counts: float, cycles: int, seed: int) -> tuple[FloatArray, FloatArray]:
    """Rounding errors (k, 3, n) [mm] of crossings a quarter of the way between rounded samples, three lengths that are the axes, and
    what `of_crossings` says of one of them: variance of each and covariance of two cycles (2,); steps (3,) between the samples, cycles
    scatter by apart_counts. k places are drawn."""
    rng, k = np.random.default_rng(seed), 4000
    before = rng.uniform(0.0, 100.0, (k, 3, 1)) + apart_counts * rng.normal(size=(k, 3, cycles))
    # no speed is so even that it keeps to whole counts
    steps = steps_counts * (1.0 + 0.2 * rng.uniform(-1.0, 1.0, (k, 3)))
    lengths = [before + i * steps[:, :, None] for i in (-1, 0, 1, 2)]
    errors = COUNT * sum(w * (np.rint(x) - x) for w, x in zip(QUARTER, lengths, strict=True))
    one = np.zeros((6, 6))
    one[3:, 3:] = np.eye(3) * COUNT**2 / 12.0
    single = PoseErrors.of(symmetric_root(np.tile(one, (k * cycles, 1, 1))), np.zeros((k * cycles, 6, 0)))
    step = np.zeros((k, cycles, 6))
    step[:, :, 3:] = COUNT * steps[:, None, :]
    between = np.zeros((k, 6, 6))
    for i in range(3):
        between[:, 3 + i, 3 + i] = (COUNT * np.rint(before[:, i])).var(axis=1, ddof=1)
    law = of_crossings(single, np.tile(QUARTER, (k, cycles, 1)), step, between)
    common = (law.local @ law.local.transpose(0, 2, 1))[:, 3, 3].mean()
    return errors, np.array([law.random[:, 3, 3].mean(), common])


@pytest.mark.parametrize("step", [0.0, 0.1, 0.5, 3.3, 50.0])
def test_a_crossing_errs_by_parts_of_two_samples(step: float) -> None:
    # three cables of different speeds along the path
    errors, stated = crossed(step * np.array([0.4, 1.0, 1.3]), 20.0, 5, seed=1)
    # steps of about half a count are rounded rather to opposite sides: not counted on
    assert 0.8 * stated[0] < errors.var() < 1.02 * stated[0]
    assert stated[1] < 1e-4 * COUNT**2


@pytest.mark.parametrize("apart", [0.0, 0.05, 0.1, 0.2, 0.4])
def test_cycles_that_are_sampled_at_the_same_places_are_rounded_alike(apart: float) -> None:
    errors, stated = crossed(np.array([40.0, 55.5, 70.3]), apart, 6, seed=2)
    together = np.mean([np.mean(errors[:, :, i] * errors[:, :, j]) for i in range(6) for j in range(i)])
    # rather too much: the scatter is estimated from fifteen numbers, and what is kept of it is bent upwards
    assert -0.02 < (stated[1] - together) / (COUNT**2 / 12.0) < 0.12
    # each cycle has the whole of its own besides: what rounding hides of the scatter is not known
    assert stated[0] == pytest.approx((QUARTER**2).sum() * COUNT**2 / 12.0, rel=0.01)
