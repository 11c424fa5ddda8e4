"""Recorded counts of one pass, and the effects of a finite counter: wraps, jumps, gaps."""

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.core import BoolArray, DataFrame, FileFormatError, FloatArray, IntArray, Shown, conventions, framed
from lmeasure.io import files
from lmeasure.kernels import BELIEVED_AT, FOLLOWED, FOREIGN, PAUSE, STATE, UNSURE, UNSURE_AT, resume_counting
from lmeasure.text import message

INFERRED_BITS = (16, 24, 32)
STAMPS = "_time_s"  # Behind the name of a channel: the column of its own times
FRAMES = "_frame"  # Behind the name of a channel: the column of the counts that came at its own times


@dataclass(frozen=True, repr=False)
class Counts(Shown):
    """Recorded counts of m channels over n samples, one pass of the motion.

    Examples
    --------
    >>> counts = run.passes[0]
    >>> counts.channels[0], counts.recorded.shape
    ('ch1', (58, 6))
    """

    time_s: FloatArray
    """(n,) strictly increasing times [s]."""
    channels: tuple[str, ...]
    """Names of the channels, m."""
    recorded: FloatArray
    """(n, m) counts as the encoders sent them; NaN: empty cell."""
    sync: FloatArray | None = None
    """(n,) start input, 0 or 1; or None."""
    source: str = "counts"
    """Name of the file, for messages."""
    u_time_s: FloatArray | None = None
    """(n,) standard uncertainty of the channels' times about the sample's time [s]; None: latched together."""
    temperature_c: FloatArray | None = None
    """(n,) temperature of cables, drums and frame [°C]; None: not recorded."""
    first: int = 0
    """Number of the first sample in the file, for messages."""
    stamp_s: FloatArray | None = None
    """(n, m) times of each channel's own frames [s], increasing; None: the sample's time."""
    frames: FloatArray | None = None
    """(n, m) counts that came at `stamp_s`, where `recorded` is interpolated to `time_s`; None: `recorded` came then."""

    def about(self) -> dict[str, str]:
        """Samples and channels."""
        return {"samples": f"{len(self.time_s)} over {self.time_s[-1] - self.time_s[0]:.6g} s", "channels": ", ".join(self.channels)}

    def to_frame(self) -> DataFrame:
        """The columns of a counts file."""
        return framed(self.columns())

    def __post_init__(self) -> None:
        n = len(self.time_s)
        if self.recorded.shape != (n, len(self.channels)):
            shapes = {"shape": str(self.recorded.shape), "n": n, "n_channels": len(self.channels)}
            raise FileFormatError(message("error.counts_of_shape_do", where=self.source, **shapes))
        if n == 0:
            raise FileFormatError(message("error.has_no_samples", where=self.source))
        late = np.flatnonzero(~(np.diff(self.time_s) > 0))
        if len(late):
            i = int(late[0])
            times = {"time_s": float(self.time_s[i + 1]), "time_s2": float(self.time_s[i])}
            raise FileFormatError(message("error.sample_time_s_does", where=self.source, first=self.first + i + 1, **times))
        if self.stamp_s is not None:
            if self.stamp_s.shape != self.recorded.shape:
                shapes = {"shape": str(self.stamp_s.shape), "counts": str(self.recorded.shape)}
                raise FileFormatError(message("counts.stamps_shape", where=self.source, **shapes))
            behind = np.argwhere(~(np.diff(self.stamp_s, axis=0) > 0))
            if len(behind):
                i, j = (int(k) for k in behind[0])
                times = {"time_s": float(self.stamp_s[i + 1, j]), "before_s": float(self.stamp_s[i, j])}
                column, row = self.channels[j] + STAMPS, self.first + i + 1
                raise FileFormatError(message("counts.stamps_order", where=self.source, sample=row, column=column, **times))

    def of(self, channel: str) -> FloatArray:
        """(n,) recorded counts of one channel; FileFormatError names the channels there are."""
        if channel not in self.channels:
            raise FileFormatError(message("error.column_is_missing_it_has", where=self.source, name=channel, has=", ".join(self.channels)))
        return np.asarray(self.recorded[:, self.channels.index(channel)])

    def rising(self) -> FloatArray:
        """Return (k,) times [s] of the samples at which sync is 1 after being 0. A 1 in the first sample is no edge."""
        if self.sync is None:
            return np.empty(0)
        return np.asarray(self.time_s[1:][(self.sync[1:] == 1) & (self.sync[:-1] == 0)])

    def whole(self) -> BoolArray:
        """Return (m,) whether each channel has whole numbers alone."""
        values = self.recorded
        return np.asarray((values == np.rint(values)).all(axis=0) & (np.abs(values).max(axis=0) < 2**53))

    def columns(self, whole: BoolArray | None = None) -> dict[str, Any]:
        """Columns of the counts file; whole (m,): channels with whole numbers alone, by default those of these samples."""
        out: dict[str, Any] = {"time_s": self.time_s}
        for values, channel, integer in zip(self.recorded.T, self.channels, self.whole() if whole is None else whole, strict=True):
            out[channel] = values.astype(np.int64) if integer else values
        if self.sync is not None:
            out["sync"] = self.sync.astype(np.int64)
        if self.u_time_s is not None:
            out["u_time_s"] = self.u_time_s
        if self.temperature_c is not None:
            out["temperature_c"] = self.temperature_c
        for end, own in ((STAMPS, self.stamp_s), (FRAMES, self.frames)):
            if own is not None:
                out |= {channel + end: own[:, i] for i, channel in enumerate(self.channels)}
        return out

    def by_frames(self) -> "Counts":
        """Return the counts of the channels' own frames, each at its own time."""
        return self if self.frames is None else replace(self, recorded=self.frames, frames=None)


def read_counts(path: Path, *, torn: bool = False) -> Counts:
    """Read the counts of one pass.

    Parameters
    ----------
    path
        .csv or .parquet with time_s, one column per channel, optional sync, u_time_s, temperature_c. Where channels were not read together,
        columns CHANNEL_time_s have the times of their own frames, and CHANNEL_frame the counts then, if CHANNEL is interpolated to time_s.
    torn
        True accepts a file whose last row is incomplete, as after a power failure.

    Returns
    -------
    Counts
        Recorded counts (n, m); an empty cell is NaN.

    Raises
    ------
    FileFormatError
        If a cell is no number. The message names row and column.

    Examples
    --------
    >>> lm.read_counts(Path("run/pass1.csv")).recorded.shape
    (58, 6)
    """
    return _counts(files.read_table(path, torn=torn))


def read_counts_in_pieces(path: Path, progress: Callable[[int, int], None] | None = None, first: int = 0) -> Iterator[Counts]:
    """`read_counts`, one piece after the other, for files that need not fit into memory; progress is called with (done, of) in percent.

    first: row of a .parquet file to begin at, as `read_table_in_pieces` has it."""
    before: tuple[int, float] | None = None
    for table, part in files.read_table_in_pieces(path, first):
        counts = _counts(table)
        begun = float(counts.time_s[0])
        if before is not None and not begun > before[1]:
            raise FileFormatError(message("error.sample_time_s_does", where=path, first=before[0], time_s=begun, time_s2=before[1]))
        before = table.first + len(table), float(counts.time_s[-1])
        yield counts
        if progress is not None:
            progress(round(100 * part), 100)


def _counts(table: files.Table) -> Counts:
    columns = table.columns
    named = set(columns)
    channels = tuple(c for c in columns if c not in conventions.RESERVED_COLUMNS and not _is_own(c, named))
    if not channels:
        raise FileFormatError(message("error.has_no_count_column", where=table.path, columns=", ".join(columns)))
    stamps, frames = (tuple(c + end for c in channels if c + end in named) for end in (STAMPS, FRAMES))
    for end, own in ((STAMPS, stamps or frames), (FRAMES, frames)):
        lacks = [c + end for c in channels if c + end not in named] if own else []
        if lacks:
            raise FileFormatError(message("counts.stamps_missing", where=table.path, column=lacks[0]))
    with table.every_fault(("time_s", "sync", "u_time_s", "temperature_c", *stamps), gaps=(*channels, *frames)):
        return _taken(table, channels, stamps, frames)


def _is_own(column: str, columns: Collection[str]) -> bool:
    stamped = column.endswith(STAMPS) and column.removesuffix(STAMPS) in columns
    base = column.removesuffix(FRAMES)
    return stamped or (base != column and base in columns and base + STAMPS in columns)


def _taken(table: files.Table, channels: tuple[str, ...], stamps: tuple[str, ...], frames: tuple[str, ...]) -> Counts:
    path, sync = table.path, None
    if "sync" in table.columns:
        sync = table.numbers("sync")
        bad = np.flatnonzero((sync != 0) & (sync != 1))
        if len(bad):
            raise FileFormatError(message("error.sample_sync_it_must", where=path, first=table.first + int(bad[0]), sync=sync[bad[0]]))
    skew = None
    if "u_time_s" in table.columns:
        skew = table.numbers("u_time_s")
        if (skew < 0).any():
            first = table.first + int(np.argmax(skew < 0))
            raise FileFormatError(message("error.sample_u_time_s", where=path, first=first, skew=skew.min()))
    warm = table.numbers("temperature_c") if "temperature_c" in table.columns else None
    if warm is not None:
        conventions.check_temperature(warm, f"{path}: column 'temperature_c'")
    own_s, own = table.matrix(stamps) if stamps else None, table.matrix(frames, gaps=True) if frames else None
    recorded = table.matrix(channels, gaps=True)
    return Counts(table.numbers("time_s"), channels, recorded, sync, str(path), skew, warm, table.first, own_s, own)


def write_counts(path: Path, counts: Counts, metadata: Mapping[str, str] | None = None) -> None:
    """Write a counts file, complete or not at all.

    Parameters
    ----------
    path
        .csv or .parquet to write.
    counts
        Counts of one pass.
    metadata
        Texts that a .parquet file carries.

    Examples
    --------
    >>> lm.write_counts(Path("pass1.parquet"), run.passes[0])
    """
    files.write_table(path, counts.columns(), metadata)


def joined_counts(parts: Sequence[Counts]) -> Counts:
    """Return the pieces of one pass, one after the other, as one; FileFormatError where their times do not rise."""
    names = ("time_s", "recorded", "sync", "u_time_s", "temperature_c", "stamp_s", "frames")
    parted = {name: [getattr(part, name) for part in parts] for name in names}
    whole: dict[str, Any] = {name: None if values[0] is None else np.concatenate(values) for name, values in parted.items()}
    return replace(parts[0], **whole)


def write_counts_in_pieces(path: Path, pieces: Iterable[Counts], whole: BoolArray) -> None:
    """Write a counts file from its pieces, complete or not at all; whole (m,): channels with whole numbers alone."""
    with files.table_writer(path) as write:
        for piece in pieces:
            write(piece.columns(whole))


@dataclass(frozen=True)
class Unwrapped:
    """A counter with its wraps undone.

    counts (n,) continuous, NaN without one; what (n,) codes of `kernels.counter`: followed, empty, jumped, unsure, foreign, went on;
    inferred_bits: width of the counter inferred from jumps that are wraps, or None. believed_rate: possible rate [1/s] in a pause, taken
    from the motion if needed, else None.
    """

    counts: FloatArray
    what: IntArray
    inferred_bits: int | None
    believed_rate: float | None = None


def unwrap(
    recorded: FloatArray,
    time_s: FloatArray,
    *,
    max_rate: float,
    bits: int | None,
    stated: bool = True,
    state: FloatArray | None = None,
    codes: int | None = None,
) -> Unwrapped:
    """Undo the wraps of a counter of `bits` bits (None: infer from the jumps) and find impossible motions. codes: number of values of an
    absolute encoder instead, 0 .. codes - 1, whose counts are wrong by whole turns at most, whatever happened meanwhile.

    recorded (n,) with NaN gaps; max_rate is the largest rate in recorded counts per second; stated: whether that is a statement; else the
    motion itself shows the possible unseen change (`RateEvidence`). See `kernels.counter.resume_counting`; a state is that of
    `kernels.counter.resume`, and then nothing is inferred: a piece does not show the whole counter.
    """
    inferred = None
    if codes is not None:
        strange = ~((recorded > -0.5) & (recorded < codes)) & np.isfinite(recorded)
        of_turn = np.where(strange, np.nan, recorded)
        state = np.zeros(STATE) if state is None else state
        counts, what = resume_counting(of_turn, time_s, max_rate, float(codes), state, _usual(time_s))
        # an absolute code is sure after any pause
        what[what == UNSURE], state[UNSURE_AT] = FOLLOWED, 0.0
        what[strange] = FOREIGN
        return Unwrapped(counts, what, None)
    if bits is None and state is None:
        seen = WidthEvidence(max_rate)
        seen.add(recorded, time_s)
        bits = inferred = seen.bits()
    full = 0.0 if bits is None else 2.0**bits
    if state is None:
        state = np.zeros(STATE)
        if full and not stated:
            rates = RateEvidence(max_rate, full)
            rates.add(recorded, time_s)
            state[BELIEVED_AT] = rates.believed()
    counts, what = resume_counting(recorded, time_s, max_rate, full, state, _usual(time_s))
    return Unwrapped(counts, what, inferred, float(state[BELIEVED_AT]) or None)


def _usual(time_s: FloatArray) -> float:
    """The usual interval [s] of stamps (n,): a counter may have gone for as long between two stamps that are closer."""
    if len(time_s) <= 2:
        return 0.0
    # as NumPy's median, which loads its masked arrays; one place alone, among few different values, takes a hundred times as long
    middle = sorted({(len(time_s) - 2) // 2, (len(time_s) - 1) // 2})
    return float(np.partition(np.diff(time_s), [*middle, -1])[middle].mean())


class _Pieces:
    """Counts of a channel that are given in pieces."""

    _last: tuple[float, float] | None = None

    def _known(self, recorded: FloatArray, time_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The counts of a piece that are known with their times, behind the last ones of the piece before; empty where none is."""
        seen = np.isfinite(recorded)
        values, times = recorded[seen], time_s[seen]
        if len(values) and self._last is not None:
            values, times = np.r_[self._last[0], values], np.r_[self._last[1], times]
        if len(values):
            self._last = float(values[-1]), float(times[-1])
        return values, times


class WidthEvidence(_Pieces):
    """Evidence of a channel's recorded counts, given in pieces, about the width of its counter."""

    def __init__(self, max_rate: float) -> None:
        self._rate = max_rate
        self._least, self._most = np.inf, -np.inf
        self._short = dict.fromkeys(INFERRED_BITS, False)

    def add(self, recorded: FloatArray, time_s: FloatArray) -> None:
        """Look at the next piece: recorded (n,) with NaN gaps."""
        values, times = self._known(recorded, time_s)
        if len(values) == 0:
            return
        self._least, self._most = min(self._least, values.min()), max(self._most, values.max())
        steps, limit = np.abs(np.diff(values)), self._rate * np.maximum(np.diff(times), _usual(time_s)) + 1.0
        impossible = steps > limit
        steps, limit = steps[impossible], limit[impossible]
        for bits in INFERRED_BITS:
            full = 2.0**bits
            self._short[bits] |= bool((np.abs(steps - full) <= np.minimum(limit, full / 2)).any())

    def bits(self) -> int | None:
        """Return the smallest usual width that contains all values and makes an impossible step possible; None without such a step."""
        for bits in INFERRED_BITS:
            full = 2.0**bits
            if self._short[bits] and self._least >= -full / 2 and self._most < full and self._most - self._least < full:
                return bits
        return None


class RateEvidence(_Pieces):
    """Evidence of a channel's recorded counts, given in pieces, about its speed: max_rate [1/s] bounds it, the counter has `full`
    values. Steps are taken the shorter way round: a drum that goes half its range from sample to sample has gone a quarter before."""

    def __init__(self, max_rate: float, full: float) -> None:
        self._rate, self._full = max_rate, full
        self._longest = self._fastest = self._pause = 0.0

    def add(self, recorded: FloatArray, time_s: FloatArray) -> None:
        """Look at the next piece: recorded (n,) with NaN gaps."""
        values, times = self._known(recorded, time_s)
        if len(values) == 0:
            return
        pauses, usual = np.diff(times), _usual(time_s)
        steps = np.abs(np.diff(values))
        steps = np.minimum(steps % self._full, -steps % self._full)
        pauses = np.maximum(pauses, usual)
        self._pause = max(self._pause, float(pauses.max(initial=0.0)))
        possible = steps <= self._rate * pauses + 1.0
        usually = possible & (pauses <= PAUSE * usual)
        self._longest = max(self._longest, float(steps[usually].max(initial=0.0)))
        self._fastest = max(self._fastest, float((steps[possible] / np.maximum(pauses[possible], 1e-12)).max(initial=0.0)))

    def believed(self) -> float:
        """Return the possible rate [1/s] of the counter in a pause: twice the fastest observed one, at least a tenth of the bound and at
        most that. It is 0 if the bound itself leaves no doubt, or if its steps are so long that the opposite direction may be right."""
        if self._rate * self._pause + 1.0 < self._full / 2.0 or self._longest >= self._full / 4.0:
            return 0.0
        return min(self._rate, max(2.0 * self._fastest, self._rate / 10.0))


def closure_counts(counts: Counts, rest_s: float = 0.2) -> dict[str, float]:
    """Per channel the mean count of the last rest minus that of the first [counts]; empty unless all channels rest, within two counts, for
    rest_s at both ends: the robot has not come back to the start, or was moving."""
    first = counts.recorded[counts.time_s <= counts.time_s[0] + rest_s]
    last = counts.recorded[counts.time_s >= counts.time_s[-1] - rest_s]
    if len(first) < 3 or len(last) < 3 or np.isnan(first).any() or np.isnan(last).any():
        return {}
    if (np.ptp(first, axis=0) > 2).any() or (np.ptp(last, axis=0) > 2).any():
        return {}
    return dict(zip(counts.channels, (last.mean(axis=0) - first.mean(axis=0)).tolist(), strict=True))
