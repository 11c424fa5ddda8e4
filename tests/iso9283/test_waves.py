"""Deviations along a path without what the errors have added: bases, powers, and figures whose bias is known from simulation."""

import numpy as np
import pytest

from lmeasure.iso9283.figure import cosines, reduced


@pytest.mark.parametrize("stretch", [[0] * 7, [0, 0, 0, 1, 1, 1, 1, 1], [0, 1, 2]])
def test_cosines_are_orthonormal_and_constant_first(stretch: list[int]) -> None:
    rows = cosines(np.array(stretch))
    np.testing.assert_allclose(rows @ rows.T, np.eye(len(stretch)), atol=1e-12)
    for i in set(stretch):
        # a constant on one stretch is one wave, and the first there
        on = (np.array(stretch) == i).astype(float)
        waves = rows @ on
        assert np.flatnonzero(np.abs(waves) > 1e-12).tolist() == [i]


def test_exact_waves_stay() -> None:
    waves = np.random.default_rng(1).normal(size=(6, 4, 3))
    np.testing.assert_array_equal(reduced(waves, np.zeros((6, 3)), 3, 1.0), waves)
    added = np.tile([0.0, 1e-6, 1e-6], (6, 1))
    np.testing.assert_array_equal(reduced(waves, added, 3, 1.0)[:, :, 0], waves[:, :, 0])
    np.testing.assert_allclose(reduced(waves, added, 3, 1.0), waves, rtol=5e-3)


@pytest.mark.parametrize(("offset", "wave"), [(0.0, 0.0), (3.0, 0.0), (3.0, 4.0)])
def test_a_mean_with_white_errors_is_as_large_as_in_truth(offset: float, wave: float) -> None:
    rng, q = np.random.default_rng(2), 60
    rows = cosines(np.zeros(q, dtype=np.int64))
    true = offset + wave * np.cos(2.0 * np.pi * np.arange(q) / 30.0 + 0.3)
    bias, stated = [], []
    for _ in range(300):
        measured = true + rng.normal(size=q)
        likely = rows.T @ reduced((rows @ measured)[:, None, None], np.ones((q, 1)), 1, 1.0)[:, 0, 0]
        bias.append(np.abs(measured).max() - np.abs(true).max())
        stated.append(np.abs(likely + rng.normal(size=(40, q))).max(axis=1).mean() - np.abs(likely).max())
    # errors make the largest of sixty larger, by 1.5 to 2.6 of them here
    assert np.mean(stated) == pytest.approx(np.mean(bias), rel=0.3 if wave else 0.08)


@pytest.mark.parametrize("scatter", [0.0, 0.5, 2.0, 20.0])
def test_scatter_over_cycles_is_as_large_as_in_truth(scatter: float) -> None:
    rng, q, n = np.random.default_rng(3), 60, 5
    rows = cosines(np.zeros(q, dtype=np.int64))
    bias, stated = [], []
    for _ in range(200):
        true = np.tile(scatter * rng.normal(size=n), (q, 1))
        measured = true + rng.normal(size=(q, n))
        away = measured - measured.mean(axis=1, keepdims=True)
        likely = np.einsum("pq,pn->qn", rows, reduced((rows @ away)[:, :, None], np.ones((q, 1)), n - 1, 1.0)[:, :, 0])
        bias.append(measured.std(axis=1, ddof=1).max() - true.std(axis=1, ddof=1).max())
        moved = likely + rng.normal(size=(20, q, n))
        stated.append(moved.std(axis=2, ddof=1).max(axis=1).mean() - likely.std(axis=1, ddof=1).max())
    assert -0.05 < np.mean(stated) - np.mean(bias) < 0.25
