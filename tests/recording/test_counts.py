"""Counts: their files, and counters that wrap, jump and pause."""

import tracemalloc
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.kernels import EMPTY, FOLLOWED, FOREIGN, JUMPED, UNSURE, WENT_ON
from lmeasure.recording import Counts, RateEvidence, read_counts, unwrap, write_counts

RATE = 1.5e6  # counts per second: 18 m/s at 0.012 mm


def times(n: int, step: float = 1e-3) -> FloatArray:
    return np.asarray(np.arange(n) * step, dtype=np.float64)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
@settings(max_examples=60, deadline=None, derandomize=True, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    st.lists(st.one_of(st.integers(-(2**53), 2**53).map(float), st.floats(-1e9, 1e9), st.just(float("nan"))), min_size=2, max_size=30),
    st.booleans(),
)
def test_counts_come_back_bit_for_bit(tmp_path: Path, suffix: str, values: list[float], with_sync: bool) -> None:
    n = len(values)
    recorded = np.column_stack([values, np.arange(float(n))])
    sync = (np.arange(n) % 2).astype(np.float64) if with_sync else None
    path = tmp_path / f"c{suffix}"
    write_counts(path, Counts(times(n, 1 / 3), ("ch1", "ch2"), recorded, sync))
    back = read_counts(path)
    assert back.time_s.tobytes() == times(n, 1 / 3).tobytes()
    assert back.channels == ("ch1", "ch2")
    assert np.array_equal(back.recorded, recorded, equal_nan=True)
    assert back.sync is None if sync is None else np.array_equal(back.sync, sync)  # type: ignore[arg-type]


def test_whole_counts_are_written_as_whole_numbers(tmp_path: Path) -> None:
    write_counts(tmp_path / "c.csv", Counts(times(2), ("ch1", "ch2"), np.array([[1.0, 0.5], [-2, np.nan]]), np.array([0.0, 1])))
    assert (tmp_path / "c.csv").read_text().splitlines() == ["time_s,ch1,ch2,sync", "0,1,0.5,0", "0.001,-2,,1"]


FILES = [
    ("time_s\n0\n", "has no count column besides time_s"),
    ("t,ch1\n0,1\n", "column 'time_s' is missing. It has t, ch1"),
    ("time_s,ch1\n", "has no samples"),
    ("time_s,ch1\n0,1\n1,2\n0.5,3\n", "sample 2: time_s = 0.5 does not follow 1.0"),
    ("time_s,ch1\n0,1\n0,2\n", "sample 1: time_s = 0.0 does not follow 0.0"),
    ("time_s,ch1\n0,1\n,2\n", ":3: time_s: is empty"),
    ("time_s,ch1\n0,1\nnan,2\n", ":3: time_s: must be a finite number, is nan"),
    ("time_s,ch1\n0,1\n1,12abc\n", ":3: ch1: must be a number, is '12abc'"),
    ("time_s,ch1,sync\n0,1,0\n1,1,2\n", "sample 1: sync = 2. It must be 0 or 1"),
    ("time_s,ch1,sync\n0,1,0\n1,1,\n", ":3: sync: is empty"),
    ("time_s,ch1,ch1\n0,1,2\n", "column 'ch1' occurs twice"),
]


@pytest.mark.parametrize(("text", "line"), FILES)
def test_one_line_names_the_row(tmp_path: Path, text: str, line: str) -> None:
    path = tmp_path / "pass1.csv"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_counts(path)
    assert str(caught.value).startswith(f"{path}:")
    assert line in str(caught.value)


def test_a_channel_that_is_not_there() -> None:
    counts = Counts(times(2), ("ch1",), np.zeros((2, 1)), source="pass1.csv")
    with pytest.raises(FileFormatError, match=r"pass1.csv: column 'ch2' is missing. It has ch1"):
        counts.of("ch2")
    with pytest.raises(FileFormatError, match="do not fit"):
        Counts(times(2), ("ch1", "ch2"), np.zeros((2, 1)))


def test_integers_of_parquet_with_nulls(tmp_path: Path) -> None:
    pq.write_table(pa.table({"time_s": [0.0, 1, 2], "ch1": pa.array([5, None, 7], pa.int32())}), tmp_path / "c.parquet")
    assert np.array_equal(read_counts(tmp_path / "c.parquet").recorded[:, 0], [5, np.nan, 7], equal_nan=True)


# --- counters ----------------------------------------------------------------------------------------------------------------------


def wrapped(k: FloatArray, bits: int, signed: bool) -> FloatArray:
    """Counts as a counter shows them, by integer arithmetic."""
    full = 1 << bits
    values = [int(x) % full for x in k]
    return np.array([v - full if signed and v >= full // 2 else v for v in values], dtype=np.float64)


@pytest.mark.parametrize("signed", [True, False])
@pytest.mark.parametrize("bits", [16, 24, 32])
def test_wraps_are_undone(bits: int, signed: bool) -> None:
    g = np.random.default_rng(bits)
    step = 1200.0
    k = np.rint(np.cumsum(g.uniform(-step, step, 20_000) + 0.2 * step * np.sin(times(20_000, 2e-3))))
    k += 2 ** (bits - 1) - 3000 - k[0]  # begins close to where a signed counter turns over
    shown = wrapped(k, bits, signed)
    out = unwrap(shown, times(20_000), max_rate=RATE, bits=bits)
    assert (out.what == FOLLOWED).all()
    assert np.array_equal(out.counts, k)
    assert out.inferred_bits is None
    if np.abs(np.diff(shown)).max() > RATE * 1e-3:
        inferred = unwrap(shown, times(20_000), max_rate=RATE, bits=None)
        assert inferred.inferred_bits == bits
        assert np.array_equal(inferred.counts, k)


def test_a_counter_without_width_is_left_alone() -> None:
    k = np.rint(np.cumsum(np.random.default_rng(0).uniform(-900, 900, 5000)))
    out = unwrap(k, times(5000), max_rate=RATE, bits=None)
    assert out.inferred_bits is None
    assert np.array_equal(out.counts, k)


def test_fractions_are_not_rounded() -> None:
    """Sums of steps would lose the last digits of counts of very different size."""
    g = np.random.default_rng(0)
    k = g.uniform(-700, 700, 5000) * 10 ** g.uniform(-9, 0, 5000)
    assert np.array_equal(unwrap(k, times(5000), max_rate=RATE, bits=None).counts, k)
    assert np.array_equal(unwrap(k, times(5000), max_rate=RATE, bits=32).counts, k)


def test_a_gap_is_a_gap_and_counting_goes_on() -> None:
    k = np.arange(200.0) * 100
    shown = wrapped(k, 16, True)
    shown[50:60] = np.nan
    out = unwrap(shown, times(200), max_rate=RATE, bits=16)
    assert (out.what[50:60] == EMPTY).all()
    assert np.isnan(out.counts[50:60]).all()
    good = out.what == FOLLOWED
    assert good.sum() == 190
    assert np.array_equal(out.counts[good], k[good])
    assert (unwrap(np.full(3, np.nan), times(3), max_rate=RATE, bits=None).what == EMPTY).all()


def test_after_a_long_pause_a_small_counter_is_unsure_for_good() -> None:
    """16 bits at 1.5 million counts/s can go round their range in 44 ms."""
    k = np.zeros(200)
    t = times(200)
    t[100:] += 0.045
    out = unwrap(k, t, max_rate=RATE, bits=16)
    assert (out.what[:100] == FOLLOWED).all()
    assert (out.what[100:] == UNSURE).all()
    assert (unwrap(k, t, max_rate=RATE, bits=32).what == FOLLOWED).all()
    assert (unwrap(k, t, max_rate=1e5, bits=16).what == FOLLOWED).all(), "a slower limit makes it sure"
    t[100:] -= 0.015
    assert (unwrap(k, t, max_rate=RATE, bits=16).what == FOLLOWED).all(), "a late stamp is no wrap"


def test_a_limit_that_nobody_stated_is_taken_from_the_motion() -> None:
    """16 bits at 22 Hz: 20 m/s could go round the range from sample to sample; the motion is slow."""
    t = np.arange(400) / 22.0
    k = 20000.0 * np.sin(t)
    shown = (k.round() + 2**15) % 2**16 - 2**15
    assert (unwrap(shown, t, max_rate=RATE, bits=16).what[1:] == UNSURE).all()
    out = unwrap(shown, t, max_rate=RATE, bits=16, stated=False)
    assert np.array_equal(out.counts, k.round())
    assert (out.what == FOLLOWED).all()
    assert out.believed_rate == pytest.approx(max(2.0 * 20000.0, RATE / 10.0), rel=0.01)
    # a pause in which that speed goes half the range: unsure, by the same limit
    for pause, sure in ((0.15, True), (0.3, False)):
        late = t + pause * (t > 4.0)
        assert (unwrap(shown, late, max_rate=RATE, bits=16, stated=False).what[-1] == FOLLOWED) == sure
    # steps of more than a quarter of the range: which way round they went cannot be told
    fast = (k.round() * 60 + 2**15) % 2**16 - 2**15
    assert (unwrap(fast, t, max_rate=RATE, bits=16, stated=False).what[1:] == UNSURE).any()
    assert unwrap(k.round(), t, max_rate=RATE, bits=32, stated=False).believed_rate is None


def test_a_spike_is_a_jump_and_what_follows_is_good() -> None:
    k = np.arange(100.0) * 50
    for bits in (None, 16, 32):
        for width in (1, 2, 7):
            shown = k.copy()
            shown[40 : 40 + width] += 20_000
            out = unwrap(shown, times(100), max_rate=RATE, bits=bits)
            bad = np.zeros(100, np.bool_)
            bad[40 : 40 + width] = True
            assert np.array_equal(out.what != FOLLOWED, bad)
            assert out.what[40] == JUMPED
            assert (out.what[41 : 40 + width] == WENT_ON).all()
            assert np.array_equal(out.counts[~bad], k[~bad])


def test_spikes_that_go_once_round_a_small_counter() -> None:
    k = np.zeros(10)
    shown = k.copy()
    shown[4], shown[5] = 30_000, -30_000
    out = unwrap(shown, times(10), max_rate=RATE, bits=16)
    assert (out.what[[4, 5]] == JUMPED).all()
    assert np.array_equal(out.counts[6:], k[6:])


def test_a_lost_origin_stays_lost() -> None:
    k = np.arange(100.0) * 50
    shown = k.copy()
    shown[40:] += 20_000
    out = unwrap(shown, times(100), max_rate=RATE, bits=32)
    assert out.what[40] == JUMPED
    assert (out.what[41:] == WENT_ON).all()
    assert np.array_equal(out.counts, shown), "it goes on, for who can prove it right"


def test_a_jump_back_that_comes_late_proves_nothing() -> None:
    """Behind a pause anything could have come."""
    for width, back in ((90, FOLLOWED), (110, JUMPED)):
        shown = np.arange(300.0) * 50
        shown[40 : 40 + width] += 20_000
        out = unwrap(shown, times(300), max_rate=RATE, bits=32)
        assert out.what[40 + width] == back
        assert (out.what[41 + width :] == (FOLLOWED if back == FOLLOWED else WENT_ON)).all()


def test_values_that_a_counter_cannot_show() -> None:
    shown = np.array([0.0, 10, 70_000, 30, -40_000, 50])
    out = unwrap(shown, times(6), max_rate=RATE, bits=16)
    assert out.what.tolist() == [FOLLOWED, FOLLOWED, FOREIGN, FOLLOWED, FOREIGN, FOLLOWED]
    assert np.array_equal(out.counts[[0, 1, 3, 5]], [0, 10, 30, 50])


@settings(max_examples=100, deadline=None, derandomize=True)
@given(st.lists(st.one_of(st.floats(-1e300, 1e300), st.just(float("nan"))), min_size=1, max_size=50), st.sampled_from([None, 8, 16, 64]))
def test_any_numbers_are_classified(values: list[float], bits: int | None) -> None:
    out = unwrap(np.array(values), times(len(values)), max_rate=RATE, bits=bits)
    assert np.array_equal(np.isnan(out.counts), (out.what == EMPTY) | (out.what == FOREIGN))


def test_an_hour_takes_little_memory() -> None:
    n = 400_000
    recorded, t = np.zeros(n), times(n)
    unwrap(recorded, t, max_rate=RATE, bits=32)
    tracemalloc.start()
    unwrap(recorded, t, max_rate=RATE, bits=32)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 4.5 * recorded.nbytes  # four arrays of as many numbers, and little beside


def test_a_sync_that_is_high_from_the_start_did_not_rise() -> None:
    counts = Counts(times(6), ("ch1",), np.zeros((6, 1)), np.array([1.0, 1.0, 0.0, 1.0, 1.0, 0.0]))
    assert counts.rising().tolist() == [times(6)[3]]
    assert Counts(times(6), ("ch1",), np.zeros((6, 1)), np.ones(6)).rising().tolist() == []
    assert Counts(times(6), ("ch1",), np.zeros((6, 1))).rising().tolist() == []


def believed(steps: list[float], pauses: list[float], rate: float, *, bits: int = 16, piece: int = 10**6) -> float:
    """The rate that is believed of a counter that goes by such steps in such pauses, read in pieces."""
    full, seen = 2.0**bits, RateEvidence(rate, 2.0**bits)
    recorded, time_s = np.cumsum([0.0, *steps]) % full, np.cumsum([0.0, *pauses])
    for first in range(0, len(time_s), piece):
        seen.add(recorded[first : first + piece], time_s[first : first + piece])
    return seen.believed()


def test_what_a_motion_tells_of_a_counters_rate() -> None:
    """Twice the fastest that was seen, at least a tenth of the bound, at most all of it; nothing where the bound leaves no doubt in the
    longest pause, or a step is a quarter of the range: each limit from both sides."""
    second = [1.0] * 40
    # in a second no drum goes half round at 32,766 a second, and may at 32,767
    assert believed([10.0] * 40, second, 32_766.0) == 0.0
    assert believed([10.0] * 40, second, 32_767.0) == 3_276.7
    assert believed([10.0] * 40, second, 32_766.5) == 0.0
    assert believed([10.0] * 40, [0.01] * 40, 40_000.0) == 0.0
    # a tenth against twice the fastest, whichever way it goes round
    for step in (3_000.0, -3_000.0):
        assert believed([step] * 40, second, 60_001.0) == 6_000.1
        assert believed([step] * 40, second, 59_999.0) == 6_000.0
    # a quarter of the range; and of what was fast in half a second twice is more than the bound
    assert believed([16_383.0] * 40, second, 40_000.0) == 32_766.0
    assert believed([16_384.0] * 40, second, 40_000.0) == 0.0
    assert believed([12_000.0] * 40, [0.5] * 20 + [1.0] + [0.5] * 19, 40_000.0) == 40_000.0


def test_in_pauses_steps_may_be_long_and_what_no_drum_does_is_passed_over() -> None:
    """A step behind a long pause is no proof that steps are long; one that is faster than the bound is no motion."""
    # of a pause as long as two and a half usual ones it is not a pause yet
    for pause, rate in ((2.5, 0.0), (2.6, 2.0 * 20_000.0 / 2.6)):
        got = believed([100.0] * 20 + [20_000.0] + [100.0] * 19, [1.0] * 20 + [pause] + [1.0] * 19, 40_000.0)
        assert got == pytest.approx(rate)
    # in half a second it may have gone as far as in the usual one
    slow, second = [100.0] * 20, [1.0] * 20
    assert believed([*slow, 15_000.0, *slow], [*second, 0.5, *second], 40_000.0) == pytest.approx(2.0 * 15_000.0)
    # at 9,000 a second a drum goes 9,001 counts between readings, and no more
    assert believed([*slow, 9_001.0, *slow, 0.0], [*second, 1.0, *second, 4.0], 9_000.0) == 9_000.0
    assert believed([*slow, 9_002.0, *slow, 0.0], [*second, 1.0, *second, 4.0], 9_000.0) == 900.0
    assert believed([*slow, 9_001.25, *slow, 0.0], [*second, 1.0, *second, 4.0], 9_000.0) == 900.0
    assert believed([*slow, 9_001.0, *slow], [*second, 4.0, *second], 9_000.0) == pytest.approx(2.0 * 9_001.0 / 4.0)


def test_a_counter_that_goes_over_its_end_goes_the_shorter_way() -> None:
    seen = RateEvidence(40_000.0, 2.0**16)
    seen.add(np.array([63_036.0, 2_500.0, 63_036.0, 2_500.0]), np.arange(4.0))
    assert seen.believed() == 10_000.0
    # slowly, of four values: nothing is taken for faster than it is
    assert believed([0.1] * 40, [1.0] * 40, 8.0, bits=2) == 0.8


@pytest.mark.parametrize("piece", [1, 2, 7, 40])
def test_a_rate_is_believed_whatever_the_pieces(piece: int) -> None:
    """Pieces of a few samples know the usual interval worse, where none is shorter than usual it does not matter."""
    steps = np.random.default_rng(5).uniform(-4_000.0, 4_000.0, 120)
    assert believed(list(steps), [1.0] * 120, 40_000.0, piece=piece) == believed(list(steps), [1.0] * 120, 40_000.0)


@pytest.mark.parametrize(
    ("values", "whole"),
    [
        ([0.0, -5.0], True), ([2.0**53 - 1.0, 1.0], True), ([1.0 - 2.0**53, 1.0], True), ([2.0**53, 1.0], False), ([0.0, 0.5], False),
        ([np.nan, 1.0], False),
    ],
)  # fmt: skip
def test_counts_are_integers_as_far_as_these_are_told_apart(values: list[float], whole: bool) -> None:
    """Beyond 2^53 a float stands for several."""
    column = Counts(times(2), ("ch1",), np.array(values)[:, None]).columns()["ch1"]
    assert column.dtype == (np.int64 if whole else np.float64)
    np.testing.assert_array_equal(column, values)


@pytest.mark.parametrize(("least", "bits"), [(-7e6, 24), (-8e6, None)])
def test_a_width_is_inferred_only_where_it_holds_all_values(least: float, bits: int | None) -> None:
    """A step of nearly 2^24 asks for 24 bits, which hold no more values than that, wherever they begin."""
    values = np.array([9e6, 9e6 - 2.0**24 + 1000.0, least])
    # a signed one goes down to half of that
    below = np.array([8e6, 8e6 - 2.0**24 + 300_000.0])
    assert unwrap(below, np.array([0.0, 1.0]), max_rate=1e6, bits=None).inferred_bits is None
    assert unwrap(values, times(3), max_rate=RATE, bits=None).inferred_bits == bits


@pytest.mark.parametrize(("short", "bits"), [(2.0, 24), (3.0, None)])
def test_a_step_is_a_wrap_where_what_is_short_of_it_could_be_gone(short: float, bits: int | None) -> None:
    """A count in a sample of 1 ms at 1000 counts/s, and one more for the rounding of both."""
    assert unwrap(np.array([0.0, 2.0**24 - short]), times(2), max_rate=1000.0, bits=None).inferred_bits == bits


def test_a_last_line_without_an_end_counts_but_in_a_recording_that_broke_off(tmp_path: Path) -> None:
    path = tmp_path / "pass1.csv"
    path.write_text("time_s,ch1\n0,1\n1,2\n2,3")
    assert read_counts(path).recorded[:, 0].tolist() == [1.0, 2.0, 3.0]
    assert read_counts(path, torn=True).recorded[:, 0].tolist() == [1.0, 2.0]


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_what_else_was_recorded_comes_back(tmp_path: Path, suffix: str) -> None:
    u, warmth = np.array([1e-6, 2e-6, 3e-6]), np.array([20.0, 20.5, 21.0])
    path = tmp_path / f"c{suffix}"
    write_counts(path, Counts(times(3), ("ch1",), np.zeros((3, 1)), u_time_s=u, temperature_c=warmth))
    back = read_counts(path)
    np.testing.assert_array_equal(np.array([back.u_time_s, back.temperature_c]), [u, warmth])
