"""What is drawn with a seed is the same on every machine, whatever signs and bases its LAPACK gives eigenvectors."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from problems import arc, plane

from lmeasure.core import FloatArray, covariance_root, symmetric_root
from lmeasure.estimation import Fit, fit, regions


@pytest.fixture
def another_lapack(monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Turns NumPy's decompositions into equally right ones: other signs."""
    eigh, svd, rng = np.linalg.eigh, np.linalg.svd, np.random.default_rng(1)

    def other_eigh(a: FloatArray, *args: Any, **how: Any) -> Any:
        values, vectors = eigh(a, *args, **how)
        return values, vectors * rng.choice([-1.0, 1.0], (*vectors.shape[:-2], 1, vectors.shape[-1]))

    def other_svd(a: FloatArray, *args: Any, **how: Any) -> Any:
        found: Any = svd(a, *args, **how)
        if isinstance(found, np.ndarray):
            return found
        U, s, Vt = (part.copy() for part in found)
        signs, k = rng.choice([-1.0, 1.0], s.shape), s.shape[-1]
        U[..., :, :k] *= signs[..., None, :]
        Vt[..., :k, :] *= signs[..., :, None]
        return U, s, Vt

    def install() -> None:
        monkeypatch.setattr(np.linalg, "eigh", other_eigh)
        monkeypatch.setattr(np.linalg, "svd", other_svd)

    return install


def drawn_covariance(rng: np.random.Generator, size: int, rank: int) -> tuple[FloatArray, FloatArray]:
    """A covariance of millimetres and radians, and its standard uncertainties."""
    units = 10.0 ** rng.uniform(-6.0, 1.0, size)
    F = units[:, None] * rng.normal(size=(size, rank))
    return F @ F.T, np.linalg.norm(F, axis=1)


@given(st.integers(0, 10**6), st.integers(1, 7))
def test_a_root_holds_the_covariance_and_what_is_shared_once(seed: int, rank: int) -> None:
    rng = np.random.default_rng(seed)
    small, width = drawn_covariance(rng, 7, rank)
    # the third stands three times, once in other units and with the other sign; the eighth is exact
    of, times = np.array([0, 1, 2, 3, 4, 5, 6, 2, 2, 0]), np.array([1.0, 1, 1, 1, 1, 1, 1, 1, -0.01, 0])
    covariance = small[np.ix_(of, of)] * np.outer(times, times)
    F = covariance_root(covariance, width[of] * abs(times))
    assert F.shape == (10, 7 if rank > 1 else 1)
    unit = np.where(times == 0, 1.0, width[of] * abs(times))
    np.testing.assert_allclose((F @ F.T) / np.outer(unit, unit), covariance / np.outer(unit, unit), atol=1e-6)
    assert not F[9].any()


def test_no_covariance_has_no_root() -> None:
    assert covariance_root(np.zeros((4, 4)), np.zeros(4)).shape == (4, 0)


def test_roots_do_not_depend_on_the_eigenvectors_that_were_chosen(another_lapack: Callable[[], None]) -> None:
    rng = np.random.default_rng(2)
    covariance, width = drawn_covariance(rng, 12, 9)
    spheres = np.eye(12) * 0.25
    before = covariance_root(covariance, width), symmetric_root(covariance), covariance_root(spheres, np.full(12, 0.5))
    another_lapack()
    turned = np.linalg.eigh(covariance)[1]
    after = covariance_root(covariance, width), symmetric_root(covariance), covariance_root(spheres, np.full(12, 0.5))
    assert not np.allclose(turned, np.linalg.eigh(covariance)[1])
    for one, other in zip(before, after, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-15)


def test_what_is_rounded_off_a_covariance_of_few_directions_is_not_in_its_root() -> None:
    """Its square root would be 1e-8 of the largest, and another number on each processor."""
    rng = np.random.default_rng(3)
    for rank in (1, 2, 3):
        covariance, _ = drawn_covariance(rng, 6, rank)
        root = symmetric_root(covariance)
        np.testing.assert_allclose(root @ root, covariance, atol=1e-12 * covariance.max())
        assert np.linalg.matrix_rank(root, tol=1e-12 * np.abs(root).max()) <= rank
    one, other = (symmetric_root(np.stack([covariance * s, np.eye(6)]))[1] for s in (1.0, 1e30))
    np.testing.assert_array_equal(one, other)
    np.testing.assert_array_equal(symmetric_root(np.full((2, 2), np.nan)), np.zeros((2, 2)))
    # a turn that is known very well beside a place that is not is no rounding
    np.testing.assert_allclose(np.diag(symmetric_root(np.diag([1e2, 1e-9]) ** 2)), [1e2, 1e-9], rtol=1e-12)


@pytest.mark.parametrize("name", ["arc", "plane with a prior", "plane"])
def test_regions_do_not_depend_on_them_either(name: str, another_lapack: Callable[[], None]) -> None:
    """A silent direction, and nuisance parameters with a free frame, are drawn with the same seed."""
    problem: Any = arc(6.0, 20, 0.1, 0) if name == "arc" else plane(1, since_first=False, u=1.0)

    def found() -> Fit:
        return fit(problem, problem.start, prior_everywhere=name == "plane with a prior")

    before = regions(found(), 0)
    another_lapack()
    after = regions(found(), 0)
    np.testing.assert_allclose(after.U95, before.U95, rtol=1e-7)
    assert (after.factor, after.bend) == pytest.approx((before.factor, before.bend), rel=1e-6, abs=1e-9)
