"""The rest that the newest samples belong to, held beside a search through all samples."""

import numpy as np

from lmeasure.acquisition import Samples
from lmeasure.core import FloatArray
from lmeasure.procedures.capture.rest import Rest


def begins(counts: FloatArray, band: float) -> int:
    """Return the first row of the longest end in which no channel leaves the band; empty cells say nothing."""
    first = len(counts) - 1
    for row in range(len(counts) - 1, -1, -1):
        end = counts[row:]
        extent = [np.ptp(column[np.isfinite(column)]) if np.isfinite(column).any() else 0.0 for column in end.T]
        if max(extent) > band:
            break
        first = row
    return first


def test_a_rest_is_the_longest_end_within_the_band() -> None:
    rng = np.random.default_rng(0)
    for trial in range(25):
        count, channels = int(rng.integers(20, 90)), int(rng.integers(1, 4))
        moves = rng.choice([0, 0, 0, 0, 1, -1, 8], size=(count, channels)) * (rng.random((count, 1)) < (0.05, 0.5)[trial % 2])
        counts: FloatArray = np.cumsum(moves, axis=0).astype(np.float64)
        counts[rng.random(counts.shape) < 0.1] = np.nan
        time_s: FloatArray = np.linspace(0.0, 0.005 * count, count)
        rest, done = Rest(tuple("abc"[:channels]), np.full(channels, 5.0), np.zeros(channels)), 0
        while done < count:
            end = min(count, done + int(rng.integers(1, 12)))
            rest.add(Samples(time_s[done:end], counts[done:end]))
            done, first = end, begins(counts[:end], 5.0)
            np.testing.assert_array_equal(rest.time_s, time_s[first:done])
            np.testing.assert_array_equal(rest.counts, counts[first:done])
            assert rest.since_s == time_s[first]
