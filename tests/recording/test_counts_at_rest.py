"""What the ends of a run say when it rests there, counts read in pieces, and numbers just inside and just outside what is allowed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.kernels import FOLLOWED, FOREIGN
from lmeasure.recording import Counts, RateEvidence, WidthEvidence, closure_counts, read_counts, read_counts_in_pieces, unwrap

STEP_S = 0.125
"""Exact in doubles, so that a rest of two steps has three samples at its end."""


def ended(first: FloatArray, last: FloatArray) -> Counts:
    """Two channels that rest at the ends, and move by hundreds of counts in between."""
    between = np.array([[300.0, 500.0], [600.0, 900.0]])
    recorded = np.vstack([first, between, last])
    return Counts(np.asarray(STEP_S * np.arange(len(recorded)), dtype=np.float64), ("a", "b"), recorded)


REST = np.array([[10.0, 20.0], [12.0, 20.0], [11.0, 21.0]])
"""Within two counts."""
BACK = np.array([[14.0, 17.0], [16.0, 17.0], [15.0, 18.0]])


def test_what_has_changed_between_two_rests() -> None:
    found = closure_counts(ended(REST, BACK), 2 * STEP_S)
    assert list(found) == ["a", "b"]
    assert list(found.values()) == pytest.approx([4.0, -3.0], abs=1e-12)
    # by default a fifth of a second
    quick = replace(ended(REST, BACK), time_s=np.asarray(0.075 * np.arange(8), dtype=np.float64))
    assert closure_counts(quick) == found


@pytest.mark.parametrize("row", [0, 1, 2])
@pytest.mark.parametrize("value", [np.nan, 23.0])
def test_what_moves_or_is_missing_at_an_end_is_no_rest(row: int, value: float) -> None:
    """A gap, or three counts; at either end alone."""
    spoiled = REST.copy()
    spoiled[:, 1] = [20.0, 20.0, 20.0]
    spoiled[row, 1] = value
    assert closure_counts(ended(spoiled, BACK), 2 * STEP_S) == {}
    assert closure_counts(ended(BACK, spoiled), 2 * STEP_S) == {}
    spoiled[row, 1] = 22.0
    assert closure_counts(ended(spoiled, BACK), 2 * STEP_S)
    assert closure_counts(ended(BACK, spoiled), 2 * STEP_S)


def test_two_samples_are_no_rest() -> None:
    whole = ended(REST, BACK)
    for early, late in ((2, 8), (0, 6)):
        times = whole.time_s.copy()
        times[early:late] += 1.0 if early else 0.0
        times[late:] += 1.0
        assert closure_counts(replace(whole, time_s=times), 2 * STEP_S) == {}


def test_pieces_follow_each_other(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a file of which three rows are read at a time: the same counts, how much is done, and what does not rise, by its sample."""
    monkeypatch.setattr("lmeasure.io.tables.PIECE_ROWS", 3)
    path, times = tmp_path / "counts.parquet", 0.5 * np.arange(9.0)

    def written(time_s: FloatArray) -> None:
        pq.write_table(pa.table({"time_s": time_s, "a": np.arange(9.0), "b": 2.0 * np.arange(9.0)}), path)

    written(times)
    reported: list[tuple[int, int]] = []
    parts = list(read_counts_in_pieces(path, lambda *done: reported.append(done)))
    np.testing.assert_array_equal(np.vstack([p.recorded for p in parts]), read_counts(path).recorded)
    assert [p.first for p in parts] == [0, 3, 6]
    assert reported == [(33, 100), (67, 100), (100, 100)]
    written(np.where(np.arange(9) >= 6, times - 1.0, times))
    with pytest.raises(FileFormatError, match=r"sample 6: time_s = 2\.0 does not follow 2\.5"):
        list(read_counts_in_pieces(path))
    written(np.where(np.arange(9) >= 6, times - 0.5, times))
    with pytest.raises(FileFormatError, match=r"sample 6: time_s = 2\.5 does not follow 2\.5"):
        list(read_counts_in_pieces(path))


def test_a_standard_uncertainty_may_be_nothing_and_not_less(tmp_path: Path) -> None:
    path = tmp_path / "counts.csv"
    path.write_text("time_s,a,u_time_s\n0,1,0\n1,2,0.001\n2,3,0\n")
    skew = read_counts(path).u_time_s
    assert skew is not None
    assert skew.tolist() == [0.0, 0.001, 0.0]
    path.write_text("time_s,a,u_time_s\n0,1,0\n1,2,-0.001\n2,3,0\n")
    with pytest.raises(FileFormatError, match=r"sample 1: u_time_s = -0\.001. A standard uncertainty is not negative"):
        read_counts(path)


def test_absolute_codes_begin_in_the_turn_about_nothing() -> None:
    """Codes of more than half a turn are negative; what is no code is foreign."""
    for code, count in ((0.0, 0.0), (400.0, 400.0), (499.0, 499.0), (501.0, -499.0), (999.0, -1.0)):
        found = unwrap(np.array([code, code]), np.array([0.0, 1e-3]), max_rate=1e4, bits=None, codes=1000)
        assert found.counts.tolist() == [count, count]
        assert found.what.tolist() == [FOLLOWED, FOLLOWED]
    found = unwrap(np.array([7.0, -1.0, 1000.0, 8.0]), 1e-3 * np.arange(4.0), max_rate=1e4, bits=None, codes=1000)
    assert found.what.tolist() == [FOLLOWED, FOREIGN, FOREIGN, FOLLOWED]


def test_a_width_holds_every_value_that_was_seen() -> None:
    """A signed counter of 16 bits from its highest value to its lowest; one value more and it is no such counter."""
    for extra, bits in ((-32_768.0, 16), (-32_769.0, None)):
        seen = WidthEvidence(1000.0)
        seen.add(np.array([32_766.0, 32_767.0, extra, -32_767.0]), 1e-3 * np.arange(4.0))
        assert seen.bits() == bits


def test_of_three_stamps_the_usual_interval_is_known() -> None:
    """Two that are close had as long as usual: 50 counts in 0.05 s, twice that rate is believed."""
    rates = RateEvidence(1e4, 1000.0)
    rates.add(np.array([0.0, 0.0, 50.0]), np.array([0.0, 0.1, 0.1001]))
    assert rates.believed() == pytest.approx(2.0 * 50.0 / 0.05005)


def test_of_two_stamps_the_usual_interval_is_not_known() -> None:
    """A hundred counts in a tenth of a millisecond are no motion, though two more stamps are a tenth of a second apart."""
    rates = RateEvidence(1e4, 1000.0)
    rates.add(np.array([0.0]), np.array([0.0]))
    rates.add(np.array([100.0, 100.0]), np.array([1e-4, 0.1]))
    assert rates.believed() == 1000.0


@pytest.mark.parametrize(
    ("values", "bits"),
    [
        # the highest value of 16 bits without a sign is 65,535
        ([1.0, 65_535.0], 16),
        ([1.0, 65_536.0], None),
        # and with one there are no more between the lowest and the highest
        ([-32_767.0, 32_768.0], 16),
        ([-32_768.0, 32_768.0], None),
    ],
)
def test_a_width_is_one_of_which_the_counter_shows_every_value(values: list[float], bits: int | None) -> None:
    assert unwrap(np.array(values), np.array([0.0, 1e-3]), max_rate=2000.0, bits=None).inferred_bits == bits


def test_a_step_that_is_just_possible_asks_for_no_width() -> None:
    """Half way round 16 bits, in as long as a drum needs at most."""
    for step, bits in ((32_768.0, None), (32_769.0, 16)):
        assert unwrap(np.array([0.0, step]), np.array([0.0, 32_767.0]), max_rate=1.0, bits=None).inferred_bits == bits


def test_samples_are_numbered_from_nothing() -> None:
    with pytest.raises(FileFormatError, match=r"counts: sample 2: time_s = 1\.0 does not follow 1\.0"):
        Counts(np.array([0.0, 1.0, 1.0]), ("a",), np.zeros((3, 1)))
