"""Lanes of redundant channels give what `least_squares.follow` gives, sample by sample, over random rigs, gaps and motions."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from lmeasure.core import FloatArray, Status, se3
from lmeasure.kernels import lanes_redundant, least_squares, span_lengths
from lmeasure.rig import Rig, rig_from_dict
from lmeasure.simulation import cell_rig

HOME = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
FREE = np.arange(6)


def rig_of(seed: int, swivels: int, axes: int, eccentric: bool) -> Rig:
    """Six drums, encoders on some of their swivels, and axes of an inclinometer."""
    rng = np.random.default_rng(seed)
    data = cell_rig(seed % 1000).to_dict()
    off = {"eccentricity_deg": 0.5, "eccentricity_phase_deg": 30.0} if eccentric else {}
    data["swivel"] = [
        {"point": f"B{i}", "channel": f"sw{i}", "counts_per_revolution": 2**17, "zero_deg": float(rng.uniform(-180.0, 180.0))} | off
        for i in range(1, swivels + 1)
    ]
    data["inclination"] = [
        {"channel": f"level{i}", "axis": [float(i == 0), float(i == 1), 0.1], "counts_per_revolution": 3_600_000} for i in range(axes)
    ]
    return rig_from_dict(data)


def path(n: int, seed: int, speed: float) -> FloatArray:
    """(n, 7) poses at 1 kHz from HOME on."""
    rng = np.random.default_rng(seed)
    phase = 2.0 * np.pi * np.outer(1e-3 * speed * np.arange(n), rng.uniform(0.25, 0.5, 6))
    return se3.displaced(HOME, np.sin(phase) * np.concatenate([rng.uniform(-0.15, 0.15, 3), rng.uniform(-200.0, 200.0, 3)]))


def both(rig: Rig, poses: FloatArray, seed: int, missing: float = 0.0, wrong_mm: float = 0.0) -> tuple[tuple[FloatArray, ...], ...]:
    """The arguments once each: rounded changes of all channels, stretches of some of them missing; wrong_mm: by how much the rig's cables
    are not what is taken for them."""
    rng, rows = np.random.default_rng(seed), rig.cable_rows(rig.observed)
    counters = [rig.counter(o) for o in rig.observed]
    unit = np.array([c.per_count for c in counters])
    zero = np.where([c.codes is None for c in counters], span_lengths(rows, HOME[None])[0], 0.0)
    changes = span_lengths(rows, poses) - zero
    changes = np.round(changes / unit) * unit
    changes[:, :6] += wrong_mm * np.sin(changes[:, :6] / 100.0)
    for j in np.flatnonzero(rng.random(len(unit)) < missing):
        first = int(rng.integers(0, len(poses)))
        changes[first : first + int(rng.integers(1, 300)), j] = np.nan
    flags = np.where(np.isnan(changes).any(axis=1), Status.GAP, Status.OK).astype(np.int64)
    state = np.concatenate([HOME, np.where([c.codes is None for c in counters], 0.0, span_lengths(rows, HOME[None])[0]), [0.0]])
    out, ends = [], []
    for follow in (least_squares.follow_least_squares, lanes_redundant.follow_redundant_lanes):
        own = state.copy()
        out.append(follow(rows, HOME, zero, own, changes, flags, unit / np.sqrt(12.0), FREE))
        ends.append(own)
    np.testing.assert_allclose(ends[1], ends[0], rtol=0, atol=1e-9)
    return tuple(out)


def assert_same(one: tuple[FloatArray, ...], many: tuple[FloatArray, ...]) -> None:
    np.testing.assert_array_equal(many[3], one[3])
    ok = one[3] == Status.OK
    assert all(np.isnan(many[k][~ok]).all() for k in (0, 1, 4, 5))
    apart = np.abs(se3.displacement(many[0][ok], one[0][ok]))
    assert apart[:, 3:].max(initial=0.0) < 1e-9
    assert apart[:, :3].max(initial=0.0) < 1e-11
    np.testing.assert_allclose(many[1][ok], one[1][ok], rtol=0, atol=1e-9)
    np.testing.assert_allclose(many[4][ok], one[4][ok], rtol=0, atol=1e-7)
    np.testing.assert_allclose(many[5][ok], one[5][ok], rtol=1e-6, atol=1e-6)


@settings(max_examples=25, deadline=None, derandomize=True)
@given(st.integers(0, 2**32 - 1), st.integers(0, 6), st.integers(0, 2), st.booleans(), st.integers(1, 900), st.sampled_from([0.0, 0.3]))
def test_any_rig_any_length_any_gaps(seed: int, swivels: int, axes: int, eccentric: bool, n: int, missing: float) -> None:
    if swivels + axes == 0:
        swivels = 1
    rig = rig_of(seed, swivels, axes, eccentric)
    assert_same(*both(rig, path(n, seed, 1.0), seed, missing))


@pytest.mark.parametrize(("speed", "wrong_mm", "least"), [(1.0, 0.0, 0.95), (1.0, 0.5, 0.9), (40.0, 0.0, 0.0)])
def test_a_log_is_gone_through_in_lanes_where_it_can_be(speed: float, wrong_mm: float, least: float) -> None:
    """Where a rig is half a millimetre off what is taken for it too, and not where 64 samples move the cables by decimetres."""
    one, many = both(rig_of(3, 6, 0, False), path(4500, 3, speed), 3, wrong_mm=wrong_mm)
    assert (one[3] == Status.OK).all()
    assert_same(one, many)
    by_lanes = many[2].reshape(-1)[:4480].reshape(-1, 64)
    assert (by_lanes == by_lanes[:, :1]).all(axis=1).mean() >= least
    assert many[2].mean() < one[2].mean() or speed > 1.0
