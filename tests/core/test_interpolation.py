"""Values between samples: cubics where samples bear them, straight lines where they do not, and by how much these miss."""

import numpy as np
import pytest
from scipy.interpolate import BarycentricInterpolator

from lmeasure.core import BoolArray, FloatArray, OtherTimes, lagrange


def read(
    time_s: FloatArray, values: FloatArray, at_s: FloatArray, quantum: float = 0.0, smooth: float = 0.2, bad: tuple[int, ...] = ()
) -> tuple[FloatArray, FloatArray]:
    """Values at at_s and by how much they miss; bad samples are in doubt."""
    return OtherTimes(time_s, at_s, 10.0).read(values, ~np.isin(np.arange(len(time_s)), bad), quantum, smooth)


def straight(time_s: FloatArray, values: FloatArray, at_s: FloatArray) -> FloatArray:
    return np.asarray(np.interp(at_s, time_s, values))


def test_a_cubic_is_met_at_uneven_stamps_and_the_ends_are_straight() -> None:
    time_s = np.arange(30) + np.random.default_rng(1).uniform(-0.05, 0.05, 30)
    at_s = time_s[:-1] + 0.5

    def law(t: FloatArray) -> FloatArray:
        return np.asarray(1e4 + 3.0 * t - 0.2 * t**2 + 0.01 * t**3)

    values, missed = read(time_s, law(time_s), at_s)
    np.testing.assert_allclose(values[1:-1], law(at_s)[1:-1], rtol=0.0, atol=1e-9)
    assert not missed[1:-1].any()
    ends = [0, -1]
    np.testing.assert_allclose(values[ends], straight(time_s, law(time_s), at_s)[ends], rtol=1e-15)
    np.testing.assert_allclose(missed[ends], np.abs(values - law(at_s))[ends], rtol=0.1)


def test_weights_by_hand() -> None:
    half, early = lagrange(np.array([[-1.0, 0.0, 1.0, 2.0], [-1.0, 0.0, 1.0, 2.0]]), np.array([0.5, 0.0]))
    np.testing.assert_allclose(half, np.array([-1.0, 9.0, 9.0, -1.0]) / 16.0, rtol=1e-15)
    np.testing.assert_array_equal(early, [0.0, 1.0, 0.0, 0.0])


def test_neither_a_step_nor_a_kink_is_spread_over_the_samples_about() -> None:
    time_s = np.arange(12.0)
    at_s = time_s[:-1] + 0.3
    for values in (np.where(time_s > 5.0, 2.0, 0.0), np.maximum(time_s - 5.0, 0.0)):
        np.testing.assert_allclose(read(time_s, values, at_s)[0], straight(time_s, values, at_s), rtol=1e-15, atol=1e-15)
    # as large an acceleration that comes and goes slowly is met
    values, true = np.sin(0.5 * time_s), np.sin(0.5 * at_s)
    assert np.abs(read(time_s, values, at_s)[0] - true)[1:-1].max() < 0.0012
    assert np.abs(straight(time_s, values, at_s) - true)[1:-1].max() > 0.02


def test_what_is_in_doubt_has_no_part_in_what_is_about_it() -> None:
    time_s = 0.5 * np.arange(12.0)
    values, at_s = time_s**2, time_s[:-1] + 0.25
    spoilt = values.copy()
    spoilt[6] = np.nan
    found, missed = read(time_s, spoilt, at_s, bad=(6,))
    assert np.isnan(found[[5, 6]]).all()
    np.testing.assert_allclose(found[[2, 3, 8, 9]], at_s[[2, 3, 8, 9]] ** 2, rtol=1e-14)
    # straight beside it, which misses a parabola by a quarter of the squared interval
    np.testing.assert_allclose(found[[4, 7]] - at_s[[4, 7]] ** 2, 0.0625, rtol=1e-12)
    np.testing.assert_allclose(missed[[4, 7]], 0.0625, rtol=1e-12)
    # nor where it is hardly to be told from what is sound
    spoilt[6] = values[6] + 0.03
    found, missed = read(time_s, spoilt, at_s, bad=(6,))
    np.testing.assert_allclose(found[[4, 7]] - at_s[[4, 7]] ** 2, 0.0625, rtol=1e-12)
    # two samples alone: what the others bend at most
    found, missed = read(time_s, values, at_s, bad=(4, 7))
    np.testing.assert_allclose(missed[5], 0.0625, rtol=1e-12)


def test_rounding_is_no_bend_and_is_not_made_larger() -> None:
    """A still sensor between two counts, sampled unevenly: nothing is missed, and what is read scatters less than a count does."""
    rng = np.random.default_rng(3)
    time_s = np.cumsum(rng.uniform(1.0, 9.0, 3000))
    values = np.rint(rng.uniform(-0.5, 0.5, 3000) + 0.5)
    at_s = time_s[:-1] + rng.uniform(0.0, 1.0, 2999) * np.diff(time_s)
    found, missed = read(time_s, values, at_s, quantum=1.0)
    assert missed.max() < 1e-12
    assert found.std() < values.std()
    assert np.abs(found - 0.5).max() <= 1.5
    # whatever unit times have
    again, _ = read(1e-3 * time_s, values, 1e-3 * at_s, quantum=1.0)
    np.testing.assert_allclose(again, found, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("part", [0.25, 0.5])
def test_what_a_straight_line_misses_is_reported(part: float) -> None:
    """Steps of a motion that comes on at once are read straight; the true miss is about what is told."""
    time_s = np.arange(40.0)
    at_s = time_s[:-1] + part
    values, missed = read(time_s, 50.0 * np.cos(time_s), at_s, smooth=0.0)
    error = np.abs(values - 50.0 * np.cos(at_s))
    determined = missed > 0.0
    assert determined.sum() > 5
    assert np.sqrt(np.mean(error[determined] ** 2)) == pytest.approx(np.sqrt(np.mean(missed[determined] ** 2)), rel=0.5)


def test_instants_on_samples_outside_and_in_holes() -> None:
    time_s = np.array([0.0, 1.0, 2.0, 5.0, 6.0, 7.0])
    times = OtherTimes(time_s, np.array([-0.5, 0.0, 0.5, 2.0, 3.0, 5.0, 6.5, 7.0, 7.1]), 2.5)
    assert np.flatnonzero(times.outside).tolist() == [0, 8]
    assert np.flatnonzero(times.in_hole).tolist() == [4]
    values = np.array([0.0, 10.0, 20.0, 50.0, 60.0, np.nan])
    read, missed = times.read(values, np.isfinite(values), 1.0, 0.2)
    np.testing.assert_array_equal(read, [np.nan, 0.0, 5.0, 20.0, np.nan, 50.0, np.nan, np.nan, np.nan])
    assert not missed[:6].any()
    # of an instant on a sample that sample alone is read
    mask = np.array([False, True, False, True, False, True])
    assert np.flatnonzero(times.either(mask)).tolist() == [2, 4, 5, 6, 7]
    alone = OtherTimes(np.array([1.0]), np.array([0.5, 1.0, 1.5]), 2.5)
    np.testing.assert_array_equal(alone.read(np.array([3.0]), np.array([True]), 1.0, 0.2)[0], [np.nan, 3.0, np.nan])


def looked_up(
    time_s: FloatArray, values: FloatArray, good: BoolArray, at: float, *, hole: float, quantum: float, smooth: float
) -> tuple[float, float]:
    """The value at one instant, and by how much it misses, from the samples about it one by one."""
    k, sure = len(time_s), values.copy()
    sure[~good] = np.nan
    whole = np.diff(time_s) <= hole * np.median(np.diff(time_s))

    def bends(i: int) -> tuple[float, float]:
        """The second derivative of the parabola through a sample and its neighbours, and how much of it rounding may be."""
        if not 0 < i < k - 1 or not whole[i - 1 : i + 1].all():
            return np.nan, np.nan
        early, late = np.diff(time_s[i - 1 : i + 2])
        return 2.0 * np.polyfit(time_s[i - 1 : i + 2] - time_s[i], sure[i - 1 : i + 2], 2)[0], 2.0 * quantum / (early * late)

    if not time_s[0] <= at <= time_s[-1]:
        return np.nan, 0.0
    if at in time_s:
        return float(values[time_s == at][0]), 0.0
    left = int(np.flatnonzero(time_s < at)[-1])
    h, f = time_s[left + 1] - time_s[left], (at - time_s[left]) / (time_s[left + 1] - time_s[left])
    if not whole[left]:
        return np.nan, 0.0
    if 0 < left < k - 2:
        (one, of_one), (other, of_other) = bends(left), bends(left + 1)
        four = slice(left - 1, left + 3)
        basis = [float(BarycentricInterpolator(time_s[four], unit)(at)) for unit in np.eye(4)]
        apart, mean = abs(one - other) * h**2, (abs(one) + abs(other)) / 2.0 * h**2
        if apart <= max(smooth + (of_one + of_other) * h**2, mean) and np.dot(basis, basis) <= 1.0:
            return float(np.dot(basis, values[four])), 0.0
    sizes = [max(abs(bend) - rounding, 0.0) for bend, rounding in map(bends, range(k)) if np.isfinite(bend)]
    sides = [max(abs(bend) - rounding, 0.0) for bend, rounding in map(bends, (left, left + 1)) if np.isfinite(bend)]
    size = float(np.mean(sides)) if sides else max(sizes, default=0.0)
    return float(values[left] + f * (values[left + 1] - values[left])), size * h**2 * f * (1.0 - f) / 2.0


@pytest.mark.parametrize("seed", range(6))
def test_every_value_is_what_its_own_samples_give(seed: int) -> None:
    """Of a motion that starts and stops, rounded, at uneven stamps with holes, some in doubt; read within, on and beside the samples."""
    rng = np.random.default_rng(seed)
    steps = rng.uniform(0.6, 1.4, 80) if seed % 3 else rng.uniform(0.1, 1.9, 80)
    steps[rng.integers(0, 80, 6)] *= 2.2
    time_s = 3.0 + np.cumsum(steps)
    motion = np.where(np.sin(0.2 * time_s) > 0.0, 4.0 * np.cos(0.9 * time_s), 4.0)
    quantum = 0.25 * (seed % 2)
    values = np.rint(motion / quantum) * quantum if quantum else motion
    good = rng.uniform(size=80) > 0.12
    at_s = np.sort(np.r_[rng.uniform(time_s[0] - 2.0, time_s[-1] + 2.0, 150), time_s[rng.integers(0, 80, 12)], time_s[[0, -1]]])
    kinds = {"hole": 2.0, "quantum": quantum, "smooth": 0.1 * (seed % 3)}
    found, missed = OtherTimes(time_s, at_s, kinds["hole"]).read(values, good, quantum, kinds["smooth"])
    alone = np.array([looked_up(time_s, values, good, float(at), **kinds) for at in at_s])
    np.testing.assert_allclose(found, alone[:, 0], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(missed, alone[:, 1], rtol=1e-6, atol=1e-9)
    assert (alone[:, 1] > 0.0).sum() > 20
    assert np.isnan(found).sum() > 4


@pytest.mark.parametrize(("last", "middle"), [(5.0, 0.25), (6.0, 0.5)])
def test_second_differences_bend_alike_that_are_no_farther_apart_than_their_mean(last: float, middle: float) -> None:
    """Of 1 and 3 the cubic, of 1 and 4 the line."""
    found, _ = read(np.arange(4.0), np.array([0.0, 0.0, 1.0, last]), np.array([1.5]), smooth=0.0)
    assert found[0] == middle
