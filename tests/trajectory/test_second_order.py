"""Poses that hang on encoders whose zeros are known to a degree: errors of centimetres, by which readings bend."""

from dataclasses import replace

import numpy as np
import pytest
from cells import START, FloatArray, cell
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from scipy.stats import binom, chi2

from lmeasure.core import se3
from lmeasure.kernels import ANGLE_ZERO, ATTACHMENT_XYZ, BASE_XYZ, GUIDE_XYZ, span_lengths, span_rows_of
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import simulate_run
from lmeasure.trajectory import RunModel, covariances, reconstruct, reconstruction_of
from lmeasure.trajectory.uncertainty.sources import DRAWS, beyond_first, second_order_variables

DRUMS, POINTS = 3, (1, 3, 5)
TIME_S = np.arange(0.0, 0.5, 0.02)


def square(u_zero_deg: float, off: FloatArray | None = None) -> Rig:
    """Three drums and three swivels whose true zeros are off by so many degrees."""
    data = cell().to_dict()
    swivels = [
        {"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**20, "zero_deg": 20.0 + (0.0 if off is None else float(off[k]))}
        | ({} if off is not None else {"u_zero_deg": u_zero_deg})
        for k, i in enumerate(POINTS)
    ]
    return rig_from_dict(data | {"cable": [data["cable"][i - 1] for i in POINTS], "swivel": swivels})


def at_start(u_rad: float) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.bool_]]:
    """Rows of the channels, their twists (1, 6, m), errors of first order (1, 6, 3) by zeros of this uncertainty, and which are angles."""
    rig = square(1.0)
    rows = rig.cable_rows(rig.observed)
    G = np.linalg.inv(span_rows_of(rows, START[None]))
    return rows, G, u_rad * G[:, :, DRUMS:], np.arange(6) >= DRUMS


def exactly(rows: FloatArray, shift: FloatArray) -> FloatArray:
    """(6,) by which the pose errs where the readings err by shift (m,)."""
    here = span_lengths(rows, START[None])[0]
    scale = np.repeat([1e-3, 1.0], 3)

    def left(x: FloatArray) -> FloatArray:
        off = span_lengths(rows, se3.displaced(START, x * scale)[None])[0] - here - shift
        off[DRUMS:] = 1e3 * (np.remainder(off[DRUMS:] + np.pi, 2.0 * np.pi) - np.pi)
        return off

    return np.asarray(least_squares(left, np.zeros(6), xtol=1e-15, ftol=1e-15, gtol=1e-15).x * scale)


@given(st.lists(st.floats(-2.0, 2.0), min_size=3, max_size=3).filter(lambda z: np.linalg.norm(z) > 0.5))
def test_what_it_says_is_the_series_of_the_exact_pose(z: list[float]) -> None:
    """Left over by first and second order is of third: an eighth for half the error."""
    left, first_left = [], []
    for u in (4e-3, 2e-3):
        rows, G, F, angles = at_start(u)
        second = beyond_first(rows, START[None], G=G, F=F, angles=angles)[0]
        pairs = [z[i] * z[j] for i in range(3) for j in range(i)]
        products = np.array([*pairs, *((np.array(z) ** 2 - 1.0) / np.sqrt(2.0)), 1.0])
        exact = exactly(rows, np.array([0.0] * DRUMS + [u * v for v in z]))
        scaled = np.repeat([1e3, 1.0], 3)
        first_left.append(np.linalg.norm(scaled * (exact - F[0] @ z)))
        left.append(np.linalg.norm(scaled * (exact - F[0] @ z - second[:, :-DRAWS] @ products)))
    assert left[1] < 0.2 * left[0] + 1e-7
    assert left[1] < 0.1 * first_left[1]


def test_mean_squares_are_those_of_exact_poses_of_drawn_zeros() -> None:
    """Also across: a zero known to a degree leaves the pose on a bent sheet, which is thin where first order says so."""
    rows, G, F, angles = at_start(np.radians(1.0))
    every = np.concatenate([F, beyond_first(rows, START[None], G=G, F=F, angles=angles)], axis=2)[0]
    rng = np.random.default_rng(0)
    drawn = np.array([exactly(rows, np.concatenate([np.zeros(DRUMS), np.radians(1.0) * rng.standard_normal(3)])) for _ in range(250)])
    seen, said = drawn.T @ drawn / len(drawn), every @ every.T
    scale = np.repeat([1e3, 1.0], 3)
    values, vectors = np.linalg.eigh(said * np.outer(scale, scale))
    ratio = np.einsum("ji,jk,ki->i", vectors, seen * np.outer(scale, scale), vectors) / values
    np.testing.assert_allclose(ratio, 1.0, atol=0.45)
    # to first order a direction across seems exact
    assert np.linalg.eigvalsh((F[0] @ F[0].T) * np.outer(scale, scale))[0] < 1e-6 * values[0]


def test_poses_of_as_many_channels_as_unknowns_lie_in_their_regions() -> None:
    held = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        swing = np.repeat([0.06, 60.0], 3) * rng.uniform(0.4, 1.0, 6) * np.sin(rng.uniform(1.0, 2.5, 6) * TIME_S[:, None])
        poses = se3.displaced(START, swing)
        run = simulate_run(square(1.0, rng.normal(size=3)), TIME_S, poses, noise_mm=0.0, rng=rng).run
        run = replace(run, rig=square(1.0), start=poses[0])
        found = reconstruct(run)
        both = covariances(found, run)
        covariance = both.random + both.factors @ np.swapaxes(both.factors, 1, 2)
        np.testing.assert_allclose(covariance, found.random + found.systematic, rtol=1e-6, atol=1e-15)
        error = se3.displacement(found.poses, poses)[-1]
        held.append(error @ np.linalg.solve(covariance[-1], error) < chi2.ppf(0.95, 6))
    assert sum(held) >= binom.ppf(0.005, len(held), 0.95)


@pytest.mark.parametrize(("u_deg", "more"), [(0.002, 0), (1.0, second_order_variables(3))])
def test_zeros_that_are_known_well_need_no_more(u_deg: float, more: int) -> None:
    budget = reconstruction_of(RunModel(square(u_deg), START)).budget
    assert len(budget.sources) == len(budget.uniform) == sum(len(s.names) for s in budget.every) + more


def test_a_sample_without_a_pose_has_none_of_it() -> None:
    rows, G, F, angles = at_start(1e-2)
    nowhere = np.full((1, 7), np.nan)
    found = beyond_first(rows, np.concatenate([nowhere, START[None]]), G=np.tile(G, (2, 1, 1)), F=np.tile(F, (2, 1, 1)), angles=angles)
    assert np.isnan(found[0]).all()
    assert np.isfinite(found[1]).all()
    assert second_order_variables(0) == 0


def test_what_is_left_is_by_which_exact_poses_miss_the_series() -> None:
    rows, G, F, angles = at_start(2e-3)
    every = beyond_first(rows, START[None], G=G, F=F, angles=angles)[0]
    scale, missed = np.repeat([1e3, 1.0], 3), []
    for z in np.random.default_rng(0).standard_normal((DRAWS, 3)):
        products = np.array([*(z[i] * z[j] for i in range(3) for j in range(i)), *((z**2 - 1.0) / np.sqrt(2.0)), 1.0])
        exact = exactly(rows, np.concatenate([np.zeros(DRUMS), 2e-3 * z]))
        missed.append(scale * (exact - F[0] @ z - every[:, :-DRAWS] @ products))
    said = scale * np.linalg.norm(every[:, -DRAWS:], axis=1)
    np.testing.assert_allclose(said, np.sqrt(np.mean(np.square(missed), axis=0)), rtol=0.1, atol=1e-6)


def test_an_angle_that_passes_the_seam_of_the_circle_bends_as_beside_it() -> None:
    """The tool goes round the axis of a swivel to where its angle jumps from half a turn to minus that."""
    rows, _, _, angles = at_start(1.0)
    base, guide = rows[4, BASE_XYZ], rows[4, GUIDE_XYZ]
    to_seam = -np.pi - span_lengths(rows, START[None])[0, 4] - rows[4, ANGLE_ZERO]
    found = []
    for beside in (1e-5, 5e-3):
        turn = Rotation.from_rotvec((to_seam + beside) * guide[None])
        pose = se3.pose(base + turn.apply(START[:3] - base), turn)
        assert span_lengths(rows, pose)[0, 4] + rows[4, ANGLE_ZERO] == pytest.approx(beside - np.pi, abs=1e-7)
        G = np.linalg.inv(span_rows_of(rows, pose))
        found.append(beyond_first(rows, pose, G=G, F=2e-3 * G[:, :, DRUMS:], angles=angles)[0, :, :-DRAWS])
    most = np.abs(found[1]).max(axis=1, keepdims=True)
    np.testing.assert_allclose(found[0] / most, found[1] / most, atol=0.05)


def test_a_channel_that_tells_nothing_of_a_pose_bends_nothing() -> None:
    """Be it that the pose does not hang on it, or that it has no cable to a pose that is looked at."""
    rows, G, F, angles = at_start(1e-2)
    expected = beyond_first(rows, START[None], G=G, F=F, angles=angles)
    beside = [np.concatenate([a, a[:1]]) for a in (rows, angles)]
    unread = np.concatenate([G, np.full((1, 6, 1), np.nan)], axis=2)
    np.testing.assert_array_equal(beyond_first(beside[0], START[None], G=unread, F=F, angles=beside[1]), expected)
    # a tenth of this way the first cable's end is within its pulley
    into = np.concatenate([np.zeros(3), 10.0 * (rows[0, BASE_XYZ] - rows[0, ATTACHMENT_XYZ])])[None, :, None]
    assert np.isnan(span_lengths(rows[:1], se3.displaced(START, 0.1 * into[0, :, 0])[None])).all()
    without = np.where(np.arange(6) == 0, 0.0, G)
    found, expected = (beyond_first(rows, START[None], G=g, F=into, angles=angles)[..., :-DRAWS] for g in (G, without))
    np.testing.assert_array_equal(found, expected)
