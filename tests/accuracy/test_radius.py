"""The sphere that holds 95 % of a Gaussian."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.stats import chi2, norm
from zone_oracle import sphere_radius

from lmeasure.accuracy import exact_radius_95
from lmeasure.kernels import radius_95

RELATIVE = 5e-5


@pytest.mark.parametrize(
    ("variances", "radius"),
    [
        ((1, 0, 0), norm.ppf(0.975)),
        ((1, 1, 0), np.sqrt(chi2.ppf(0.95, 2))),
        ((1, 1, 1), np.sqrt(chi2.ppf(0.95, 3))),
        ((4, 4, 4), 2 * np.sqrt(chi2.ppf(0.95, 3))),
    ],
)
def test_line_disc_and_ball_have_known_radii(variances: tuple[float, ...], radius: float) -> None:
    assert exact_radius_95(np.array(variances, float)) == pytest.approx(radius, rel=1e-10)
    assert radius_95.py_func(*variances, 0.0, 0.0, 0.0) == pytest.approx(radius, rel=RELATIVE)


@given(st.lists(st.floats(1e-6, 1.0), min_size=3, max_size=3), st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_polynomial_is_the_exact_radius_in_any_axes(variances: list[float], seed: int) -> None:
    turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
    c = turn @ np.diag(variances) @ turn.T
    value = radius_95.py_func(c[0, 0], c[1, 1], c[2, 2], c[0, 1], c[0, 2], c[1, 2])
    assert value == pytest.approx(exact_radius_95(np.array(variances)), rel=RELATIVE)


def test_exact_radius_agrees_with_draws() -> None:
    random = np.random.default_rng(4)
    for variances in ((1.0, 0.3, 0.02), (1.0, 0.9, 0.5)):
        assert exact_radius_95(np.array(variances)) == pytest.approx(sphere_radius(np.diag(variances), random), rel=5e-3)
