"""Kernels of which every processor gives the same bits: nothing fused in them, whatever was compiled before."""

import itertools

import mpmath
import numpy as np
import pytest

from lmeasure.core import FloatArray
from lmeasure.kernels.clearance import square_distance
from lmeasure.kernels.decorators import kernel, strict_kernel
from lmeasure.kernels.vector import ARCTANGENT, angle, dot


@kernel
def fused(values: FloatArray) -> FloatArray:
    out = np.empty(len(values))
    for i in range(len(values)):
        v = values[i]
        out[i] = dot((v[0], v[1], v[2]), (v[3], v[4], v[5]))
    return out


@strict_kernel
def unfused(values: FloatArray) -> FloatArray:
    out = np.empty(len(values))
    for i in range(len(values)):
        v = values[i]
        out[i] = dot((v[0], v[1], v[2]), (v[3], v[4], v[5]))
    return out


@strict_kernel
def nested(values: FloatArray) -> FloatArray:
    out = np.empty(len(values))
    for i in range(len(values)):
        v = values[i]
        out[i] = square_distance((v[0], v[1], v[2]), (1.0, 0.0, 0.0), 0.0, (0.0, 1.0, 0.0), 0.0)
    return out


@strict_kernel
def angles(y: FloatArray, x: FloatArray) -> FloatArray:
    out = np.empty(len(y))
    for i in range(len(y)):
        out[i] = angle(y[i], x[i])
    return out


def test_products_are_rounded_before_they_are_added_even_where_others_may_fuse_them() -> None:
    values = np.random.default_rng(0).normal(size=(1000, 6))
    a, b = values[:, :3], values[:, 3:]
    expected = (a[:, 0] * b[:, 0] + a[:, 1] * b[:, 1]) + a[:, 2] * b[:, 2]
    fused(values)
    assert (unfused(values) == expected).all()
    # and in what the small functions call themselves
    square = (a[:, 0] * a[:, 0] + a[:, 1] * a[:, 1]) + a[:, 2] * a[:, 2]
    assert (nested(values) == square).all()


def test_angle_by_one_division() -> None:
    turn = np.concatenate([np.linspace(0.0, 2.0 * np.pi, 20_001)[:-1], np.pi / 8 * np.arange(16) + 1e-9])
    size = np.tile([1e-3, 1.0, 1e6, 4e12], len(turn) // 4)
    y, x = size * np.sin(turn), size * np.cos(turn)
    assert angles(y, x) == pytest.approx(np.mod(np.arctan2(y, x), 2.0 * np.pi), abs=1e-15, rel=4e-16)


def test_nothing_is_told_where_there_is_no_direction() -> None:
    for y, x in itertools.product([0.0, np.nan], repeat=2):
        assert np.isnan(angles(np.array([y]), np.array([x]))).all()


def test_the_arctangent_is_good_to_a_unit_in_the_last_place() -> None:
    with mpmath.workdps(40):
        for k in range(1, 200):
            z = mpmath.tan(mpmath.pi / 8) ** 2 * k / 200
            series = sum(mpmath.mpf(c) * z**i for i, c in enumerate(ARCTANGENT))
            assert abs(1 + z * series - mpmath.atan(mpmath.sqrt(z)) / mpmath.sqrt(z)) < 1.4e-16
