"""Recorded counts of one pass, and what a finite counter hides: wraps, jumps, gaps."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lmeasure import conventions, files
from lmeasure.errors import FileFormatError

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

INFERRED_BITS = (16, 24, 32)


@dataclass(frozen=True)
class Counts:
    """Recorded counts of one pass of the motion.

    time_s (n,) strictly rising; recorded (n, m) counts as the encoder gave them, NaN where a cell was empty; sync (n,) 0 or 1, or None.
    """

    time_s: FloatArray
    channels: tuple[str, ...]
    recorded: FloatArray
    sync: FloatArray | None = None
    source: str = "counts"

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if self.recorded.shape != (n, len(self.channels)):
            raise FileFormatError(
                f"{self.source}: counts of shape {self.recorded.shape} do not fit {n} times and {len(self.channels)} channels"
            )
        if n == 0:
            raise FileFormatError(f"{self.source}: has no samples")
        late = np.flatnonzero(~(np.diff(self.time_s) > 0))
        if len(late):
            i = int(late[0])
            raise FileFormatError(
                f"{self.source}: sample {i + 1}: time_s = {float(self.time_s[i + 1])!r} does not follow {float(self.time_s[i])!r}"
            )

    def of(self, channel: str) -> FloatArray:
        """(n,) recorded counts of one channel; FileFormatError names the channels there are."""
        if channel not in self.channels:
            raise FileFormatError(f"{self.source}: column {channel!r} is missing; it has {', '.join(self.channels)}")
        return np.asarray(self.recorded[:, self.channels.index(channel)])

    def columns(self) -> dict[str, Any]:
        """Columns of the counts file."""
        out: dict[str, Any] = {"time_s": self.time_s}
        for i, channel in enumerate(self.channels):
            values = self.recorded[:, i]
            whole = not np.isnan(values).any() and bool((values == np.rint(values)).all()) and float(np.abs(values).max()) < 2**53
            out[channel] = values.astype(np.int64) if whole else values
        if self.sync is not None:
            out["sync"] = self.sync.astype(np.int64)
        return out


def read_counts(path: Path) -> Counts:
    """Read `time_s, ch1, ch2, ..., optional sync` from .csv or .parquet; FileFormatError names the row and column."""
    table = files.read_table(path)
    channels = tuple(c for c in table.columns if c not in conventions.RESERVED_COLUMNS)
    if not channels:
        raise FileFormatError(f"{path}: has no count column besides {', '.join(table.columns)}")
    sync = None
    if "sync" in table.columns:
        sync = table.numbers("sync")
        bad = np.flatnonzero((sync != 0) & (sync != 1))
        if len(bad):
            raise FileFormatError(f"{path}: sample {int(bad[0])}: sync = {sync[bad[0]]:g}; it must be 0 or 1")
    return Counts(table.numbers("time_s"), channels, table.matrix(channels, gaps=True), sync, str(path))


def write_counts(path: Path, counts: Counts, metadata: Mapping[str, str] | None = None) -> None:
    """Write a counts file, whole or not at all."""
    files.write_table(path, counts.columns(), metadata)


@dataclass(frozen=True)
class Unwrapped:
    """A counter with its wraps undone.

    counts (n,) continuous; bad (n,) samples whose count cannot be trusted since a jump; unsure (n,) samples after a pause in which the
    counter could have wrapped unseen; bits inferred from the data, or None; notes for the reader.
    """

    counts: FloatArray
    bad: BoolArray
    unsure: BoolArray
    inferred_bits: int | None


def unwrap(recorded: FloatArray, time_s: FloatArray, max_rate: float, bits: int | None) -> Unwrapped:
    """Undo the wraps of a counter of `bits` bits (None: infer from the jumps) and find what cannot be a motion.

    recorded (n,) with NaN gaps; max_rate is the largest rate in recorded counts per second. A step between neighbouring samples that
    is longer than max_rate allows is a jump: from there on the counter's origin is lost, until a jump back to where it could be.
    """
    n = len(recorded)
    counts, bad, unsure = np.full(n, np.nan), np.zeros(n, np.bool_), np.zeros(n, np.bool_)
    seen = np.flatnonzero(np.isfinite(recorded))
    if len(seen) == 0:
        return Unwrapped(counts, bad, unsure, None)
    values, times = recorded[seen], time_s[seen]
    steps = np.diff(values)
    limit = max_rate * np.diff(times) + 1.0
    inferred = None
    if bits is None:
        bits = inferred = _infer_bits(values, steps, limit)
    first = values[0]
    doubtful = np.zeros(len(steps), np.bool_)
    if bits is not None:
        full = 2.0**bits
        half = full / 2
        first = (first + half) % full - half
        # a counter that was never near its ends cannot have wrapped; ask only where the allowed motion reaches half a range
        doubtful = limit >= half
        steps = np.where(np.abs(steps) >= half, (steps + half) % full - half, steps)
    values = np.concatenate([[first], first + np.cumsum(steps)])
    counts[seen] = values
    bad[seen] = _after_jumps(values, times, steps, limit, max_rate)
    if doubtful.any():
        unsure[seen[int(np.argmax(doubtful)) + 1] :] = True
    return Unwrapped(counts, bad, unsure & np.isfinite(counts), inferred)


def _infer_bits(values: FloatArray, steps: FloatArray, limit: FloatArray) -> int | None:
    """The smallest usual width that holds all values and turns an impossible step into a possible one; None when no step asks for it."""
    impossible = np.abs(steps) > limit
    if not impossible.any():
        return None
    for bits in INFERRED_BITS:
        full = 2.0**bits
        fits = values.min() >= -full / 2 and values.max() < full and values.max() - values.min() < full
        short = np.abs((steps + full / 2) % full - full / 2) <= limit
        if fits and bool((short & impossible).any()):
            return bits
    return None


def _after_jumps(values: FloatArray, times: FloatArray, steps: FloatArray, limit: FloatArray, max_rate: float) -> BoolArray:
    """(n,) True from each impossible step until an impossible step back to a count that the last good one could have reached."""
    bad = np.zeros(len(values), np.bool_)
    since: int | None = None
    for i in np.flatnonzero(np.abs(steps) > limit) + 1:
        if since is None:
            since = int(i)
        elif abs(values[i] - values[since - 1]) <= max_rate * (times[i] - times[since - 1]) + 1.0:
            bad[since:i] = True
            since = None
    if since is not None:
        bad[since:] = True
    return bad
