"""What a robot that stands still hides: rounding errors of repeated poses against counts that are rounded."""

import numpy as np
import pytest

from lmeasure.certification import PoseErrors
from lmeasure.certification.rounding import kept, of_dwells, scatter_counts, whitened_variance


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


def test_dwells_of_a_still_robot_are_one_draw_and_share_it() -> None:
    one = np.diag(np.repeat([1e-10, 1e-5], 3))
    errors = PoseErrors(np.tile(one, (4, 1, 1)), np.zeros((4, 6, 0)), np.zeros((4, 6, 0)))
    still = of_dwells(errors, np.zeros((4, 6, 6)), np.zeros((6, 6)), np.ones(4, dtype=np.int64), np.zeros(4, dtype=np.int64))
    np.testing.assert_allclose(still.random, errors.random)
    np.testing.assert_allclose(still.own @ still.own.transpose(0, 2, 1), errors.random, atol=1e-18)
    # motion of many counts in each dwell and between them: a hundred readings are averaged, nothing is in common
    moving = of_dwells(errors, np.tile(5000.0 * one, (4, 1, 1)), 5000.0 * one, np.full(4, 100), np.zeros(4, dtype=np.int64))
    # of two places two dwells each, and of one that stands alone: what is in common is so within a place
    apart = of_dwells(errors, np.zeros((4, 6, 6)), np.zeros((6, 6)), np.ones(4, dtype=np.int64), np.array([0, 1, 0, 2]))
    assert apart.own.shape == (4, 6, 6)
    np.testing.assert_allclose(apart.own[0] @ apart.own[2].T, one, atol=1e-18)
    assert not apart.own[[1, 3]].any()
    np.testing.assert_allclose(moving.random, errors.random / 100.0, rtol=1e-6)
    assert np.abs(moving.own).max() < 1e-12
