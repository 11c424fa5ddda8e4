"""The law of contradictions of rounded readings, against drawn ones."""

import numpy as np
import pytest
from cells import motion, record, with_recorded, words
from scipy.stats import chi2
from test_schemes import EIGHT, rig_of

from lmeasure.core import FloatArray
from lmeasure.sensors import lengths_from_counts
from lmeasure.trajectory import Redundancy, RunModel, reconstruct, reconstruction_of
from lmeasure.trajectory.faults.redundancy import chance_of

DRAWS = 400_000


def parities(d: int, uniform: int, normal: int) -> tuple[FloatArray, FloatArray]:
    """U and V of unit covariance together."""
    M = np.random.default_rng(d + uniform).standard_normal((d, uniform + normal))
    M = np.linalg.solve(np.linalg.cholesky(M @ M.T), M)
    return M[:, :uniform], M[:, uniform:]


def drawn(U: FloatArray, V: FloatArray) -> FloatArray:
    rng = np.random.default_rng(0)
    u = np.sqrt(12.0) * (rng.random((U.shape[1], DRAWS)) - 0.5)
    return np.asarray(((U @ u + V @ rng.standard_normal((V.shape[1], DRAWS))) ** 2).sum(axis=0))


@pytest.mark.parametrize(("d", "uniform", "normal"), [(1, 7, 0), (2, 8, 0), (2, 8, 3), (6, 12, 0), (6, 24, 4)])
def test_the_chance_is_that_of_drawn_roundings(d: int, uniform: int, normal: int) -> None:
    U, V = parities(d, uniform, normal)
    law, chi = chance_of(U[None], V[None]), drawn(U, V)
    for chance in (1e-2, 1e-3):
        # four standard deviations of the number drawn, and the formula's own error
        assert (chi > law.limit(chance)).mean() == pytest.approx(chance, rel=0.15, abs=4.0 * np.sqrt(chance / DRAWS))
        assert law.above(np.array([law.limit(chance)]))[0] == pytest.approx(chance, rel=0.05)
    assert law.limit(1e-6) < chi2.isf(1e-6, d)


def test_normal_errors_have_the_law_of_chi_squared() -> None:
    law = chance_of(np.empty((1, 3, 0)), np.eye(3)[None])
    for chance in (1e-2, 1e-6, 1e-12):
        assert law.limit(chance) == pytest.approx(chi2.isf(chance, 3), rel=1e-3)


@pytest.mark.parametrize("normal", [0.0, 0.02])
def test_one_rounding_alone_ends_at_half_a_count(normal: float) -> None:
    """One coarse channel to spare: beyond the end of its rounding nothing is sound but what the others add."""
    size = np.hypot(1.0, normal)
    law = chance_of(np.full((1, 1, 1), 1.0 / size), np.full((1, 1, 1), normal / size))
    end = 3.0 / size**2
    assert end <= law.limit(1e-6) <= end * 1.02 + 12.0 * normal * np.sqrt(3.0)


def test_places_of_a_run_count_alike() -> None:
    """Of two places, one of a longer tail, the chance is the mean."""
    narrow, wide = parities(2, 8, 0)[0], np.pad(np.eye(2), ((0, 0), (0, 6)))
    both, each = (chance_of(U, np.empty((len(U), 2, 0))) for U in (np.stack([narrow, wide]), wide[None]))
    for chi in (4.0, 5.5, 10.0):
        alone = chance_of(narrow[None], np.empty((1, 2, 0))).above(np.array([chi]))[0]
        assert both.above(np.array([chi]))[0] == pytest.approx((alone + each.above(np.array([chi]))[0]) / 2.0, rel=0.05)


@pytest.mark.parametrize("exact", [True, False])
def test_a_run_knows_its_own_law(exact: bool) -> None:
    """Chi-squared of rounded lengths of eight cables, their counters zeroed anywhere in each of many runs."""
    times, path = motion(60, rate_hz=250.0)
    rig = rig_of(EIGHT)
    drums = [p.drum.model_copy(update={"zero_exact": exact}) for p in rig.observation_point]
    points = tuple(p.model_copy(update={"drum": drum}) for p, drum in zip(rig.observation_point, drums, strict=True))
    run = record(rig.model_copy(update={"observation_point": points}), times, path)
    redundancy = Redundancy(reconstruction_of(RunModel(run.rig, path[0])).budget)
    epochs = redundancy.epochs(lengths_from_counts(run), None)
    used = np.ones(8, np.bool_)
    law = redundancy.chance(epochs, path, used)
    rng, variance = np.random.default_rng(2), redundancy.budget.variance
    weight = redundancy.parities(epochs, path).weight
    chi = []
    for _ in range(2000):
        off = np.sqrt(12.0 * variance) * (rng.random((len(path), 8)) - 0.5 + (0.0 if exact else rng.random(8) - 0.5))
        chi.append(np.einsum("nj,njk,nk->n", off, weight, off))
    assert (np.array(chi) > law.limit(1e-3)).mean() == pytest.approx(1e-3, rel=0.35)
    assert (np.array(chi) > chi2.isf(1e-3, 2)).mean() < 5e-4


def test_a_channel_that_errs_while_all_stands_is_named() -> None:
    """Every sample of a tool that stands has the same roundings: forty of them tell no more than one."""
    times, path = motion(700, rate_hz=250.0)
    path = np.concatenate([path[:400], np.repeat(path[399:400], 300, axis=0)])
    run = record(rig_of(EIGHT), times, path)
    recorded = run.passes[0].recorded.copy()
    recorded[500:, 2] -= np.rint(120.0 * np.clip((np.arange(200) + 1) / 50.0, 0.0, 1.0))
    found = reconstruct(with_recorded(run, recorded))
    assert set(words(found)) == {"ok"}
    assert set(found.cable[510:]) == {"c3"}
    assert np.linalg.norm(found.poses[:, :3] - path[:, :3], axis=1).max() < 0.03
