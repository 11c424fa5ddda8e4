"""Steps between samples against their definition written out sample by sample, and the sizes that a motion is held against."""

import numpy as np
import pytest

from lmeasure.core import FloatArray
from lmeasure.trajectory.faults.continuity import (
    BINS,
    Break,
    Candidates,
    counted_sizes,
    off_usual_s,
    others_largest,
    steps_seen,
    two_largest,
)

INTERVAL_S = 0.01


def median(*values: float) -> float:
    return float(np.median([0.0, *values])) if np.isfinite(values).all() else 0.0


def by_definition(time_s: FloatArray, mm: FloatArray, i: int, j: int, stride: int, off_s: FloatArray, count_mm: float) -> tuple[float, ...]:
    """Of the interval from sample i + stride to the next: step [mm], what it may be, what an acceleration adds to that [s^2]."""
    t = [float(time_s[i + k * stride]) for k in range(4)]
    x = [float(mm[i + k * stride, j]) for k in range(4)]
    (t1, t2, t3), (d1, d2, d3) = np.diff(t), np.diff(x)
    by = median(median(d2 - d1 * t2 / t1, d2 - d3 * t2 / t3), median(d2 - d1, d2 - d3))
    late = max(off_s[i : i + 3 * stride])
    speeds = [abs(v) for v in (d1 / t1, d3 / t3) if np.isfinite(v)]
    rounding = 2.0 * count_mm * max(1.0, (max(t2 / t1, t2 / t3) + 1.0) / 2.0)
    return by, 0.2 + rounding + 4.0 * late * max(speeds, default=0.0), t2 * (t1 + 2.0 * t2 + t3) / 4.0


def motions(rng: np.random.Generator, n: int = 60) -> tuple[FloatArray, FloatArray]:
    """Times and lengths (n, 3) of cables that move, stop, step and are not there for a moment; stamps that jitter, rows that lack."""
    rows = np.sort(rng.permutation(2 * n)[:n]) if rng.random() < 0.5 else np.arange(n)
    time_s = INTERVAL_S * rows + np.where(rng.random(n) < 0.2, rng.uniform(0.0, 0.004, n), 0.0)
    mm = np.cumsum(rng.normal(0.0, 0.3, (n, 3)), axis=0) + 2.0 * np.outer(rows, rng.normal(0.0, 1.0, 3))
    mm[rng.integers(n) :, 0] += rng.normal(0.0, 5.0)
    mm[rng.random((n, 3)) < 0.03] = np.nan
    return np.asarray(time_s, dtype=np.float64), mm


@pytest.mark.parametrize("stride", [1, 2])
@pytest.mark.parametrize("known", [0, 23])
def test_steps_are_the_median_of_both_continuations_and_nothing(stride: int, known: int) -> None:
    rng = np.random.default_rng(10 * stride + known)
    count_mm = np.array([0.01, 0.05, 0.2])
    found = 0
    for _ in range(12):
        time_s, mm = motions(rng)
        off_s = off_usual_s(time_s, INTERVAL_S)
        expected = {}
        for i in range(max(known - 3 * stride, 0), len(time_s) - 3 * stride):
            every = [by_definition(time_s, mm, i, j, stride, off_s, count_mm[j]) for j in range(3)]
            if any(abs(by) > allowed for by, allowed, _ in every):
                expected[i + stride] = every
        got = steps_seen(time_s, mm, np.ascontiguousarray(mm.T), known, stride=stride, count_mm=count_mm, off_s=off_s)
        assert len(got) == bool(expected)
        for one in got:
            at = np.searchsorted(time_s, one.before_s)
            np.testing.assert_array_equal(one.after_s, time_s[at + stride])
            assert at.tolist() == list(expected)
            for k, i in enumerate(at.tolist()):
                by, allowed, geometry = zip(*expected[i], strict=True)
                np.testing.assert_allclose(one.by[k], by, rtol=1e-9, atol=1e-12)
                np.testing.assert_allclose(one.allowed_mm[k], allowed, rtol=1e-9)
                np.testing.assert_allclose(one.geometry_s2[k], geometry[0], rtol=1e-9)
                np.testing.assert_array_equal(one.length_mm[:, k], mm[[i, i + stride]])
                behind = i + 2 * stride
                ends = (
                    (mm[i] - mm[i - stride]) / (time_s[i] - time_s[i - stride]),
                    (mm[behind] - mm[i + stride]) / (time_s[behind] - time_s[i + stride]),
                )
                np.testing.assert_allclose(one.speed_mm_s[:, k], ends, rtol=1e-9)
                first, last = max(i - 6, 0), min(i + stride + 6, len(time_s) - 1)
                way = mm[i] - mm[first] + mm[last] - mm[i + stride]
                lasted = time_s[i] - time_s[first] + time_s[last] - time_s[i + stride]
                np.testing.assert_allclose(one.going_mm_s[k], np.nan_to_num(way / lasted), rtol=1e-9, atol=1e-12)
                found += 1
    assert found > 20


def test_intervals_are_off_unless_rows_lack() -> None:
    steps = np.array([1.0, 1.01, 2.0, 1.99, 2.019, 2.021, 1.3, 0.7, 0.2, 2.4, 2.6, 7.0])
    expected = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 1.021, 0.3, 0.3, 0.8, 1.4, 0.0, 0.0])
    time_s = np.concatenate([[0.0], np.cumsum(steps)])
    np.testing.assert_allclose(off_usual_s(INTERVAL_S * time_s, INTERVAL_S), INTERVAL_S * expected, atol=1e-12)


def test_sizes_are_counted_between_the_bounds() -> None:
    values = np.array([[0.0, 0.5, 1.0, 1.0 + 1e-9, np.nan, 1e30], [BINS[7], BINS[8], -3.0, 0.0, BINS[-1], 1e6]])
    counts = counted_sizes(values)
    assert counts.shape == (2, len(BINS))
    assert counts.sum(axis=1).tolist() == [6, 6]
    assert np.flatnonzero(counts[0]).tolist() == [0, 1, 2, len(BINS) - 1]
    assert counts[0, [0, 1, 2, -1]].tolist() == [2, 2, 1, 1]
    assert counts[1, [0, 7, 8, -1]].tolist() == [2, 1, 1, 1]
    assert counts[1, np.searchsorted(BINS, 1e6)] == 1


def test_the_largest_two_and_the_largest_of_the_others() -> None:
    # so many that none are put in order beside those that are looked for
    values = np.random.default_rng(5).normal(size=(300, 8))
    values[2, 3] = values[0, 4] = np.nan
    largest, second = two_largest(values)
    for k in range(8):
        ordered = np.sort(values[:, k][np.isfinite(values[:, k])])
        assert (largest[k], second[k]) == (ordered[-1], ordered[-2])
    sizes = np.abs(values.T)
    others = others_largest(sizes)
    for k in range(8):
        for j in range(300):
            assert others[k, j] == np.nan_to_num(np.delete(sizes[k], j)).max()
    np.testing.assert_array_equal(others_largest(sizes[:, :1]), 0.0)


def test_a_candidate_as_a_break() -> None:
    two = np.arange(2.0)
    each = np.array([[1.0, 2.0], [3.0, 4.0]])
    one = Candidates(two, two + 0.5, each, each, two, each, np.array([each + 10.0, each + 20.0]), np.array([each + 30.0, each + 40.0]))
    assert one.at(1, 0, 0.7) == Break(0, 1.0, 1.5, 3.0, 0.7, (13.0, 23.0), (33.0, 43.0))


def test_of_two_cables_each_has_the_other_and_one_alone_none() -> None:
    two = np.array([[1.0, 5.0], [np.nan, 2.0], [3.0, 3.0]])
    np.testing.assert_array_equal(others_largest(two), [[5.0, 1.0], [2.0, 0.0], [3.0, 3.0]])
    np.testing.assert_array_equal(others_largest(two[:, :1]), np.zeros((3, 1)))
