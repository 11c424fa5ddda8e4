"""Counts of a log of any length: the latest in memory, earlier ones in a temporary file."""

import pickle
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from isal import igzip

from lmeasure.core import BoolArray, FileFormatError, LMeasureError
from lmeasure.io import files
from lmeasure.recording import Counts, joined_counts
from lmeasure.text import message

KEPT_SAMPLES = 1 << 17
"""Samples in memory."""
PAUSE_S = 5.0
"""Time without any counter on a recorded bus that counts as an interruption."""


class KeptCounts:
    """Pieces of counts in their order, with times as the log has them, and properties of the whole: its ends, pauses and gaps.

    The file is the system's temporary one, compressed, and vanishes with its last reader.
    """

    def __init__(self) -> None:
        self._parts: list[Counts] = []
        self._file: Any = None
        self._blocks = 0
        self._packed: Any = None
        self.samples = self._held = 0
        self.first_s = self.last_s = 0.0
        self.counted: BoolArray = np.zeros(0, np.bool_)
        """(m,) channels with a count anywhere."""
        self.whole: BoolArray = np.zeros(0, np.bool_)
        """(m,) channels with whole numbers alone."""
        self._steps: list[tuple[float, float]] = []
        """Ends of the parts before long steps of time, and these steps [s]."""
        self._medians: list[float] = []

    def add(self, piece: Counts) -> None:
        """Take the next piece."""
        times, there = piece.time_s, np.asarray(~np.isnan(piece.recorded).all(axis=0))
        if not self.samples:
            self.first_s, self.counted, self.whole = float(times[0]), there, piece.whole()
            steps, before = np.diff(times), times[:-1]
        elif times[0] > self.last_s:
            self.counted, self.whole = self.counted | there, self.whole & piece.whole()
            before = np.concatenate([[self.last_s], times[:-1]])
            steps = times - before
        else:
            at = {"time_s": float(times[0]), "time_s2": self.last_s}
            raise FileFormatError(message("error.sample_time_s_does", where=piece.source, first=piece.first, **at))
        if len(steps):
            self._medians.append(float(np.median(steps)))
            self._steps += [(float(before[i]), float(steps[i])) for i in np.flatnonzero(steps > PAUSE_S)]
        self.samples, self.last_s = self.samples + len(times), float(times[-1])
        self._parts.append(piece)
        self._held += len(times)
        if self._held >= KEPT_SAMPLES:
            self._put_away()

    def _put_away(self) -> None:
        try:
            if self._file is None:
                self._file = tempfile.TemporaryFile()  # noqa: SIM115 - open as long as the counts
                self._packed = igzip.IGzipFile(fileobj=self._file, mode="wb", compresslevel=1)  # type: ignore[no-untyped-call]
                weakref.finalize(self, _close, self._packed, self._file)
            pickle.dump(joined_counts(self._parts), self._packed, protocol=5)
        except OSError as error:
            raise LMeasureError(files.not_written(Path(tempfile.gettempdir()), error)) from error
        self._blocks += 1
        self._parts, self._held = [], 0

    def pieces(self) -> Iterator[Counts]:
        """Yield the counts piece by piece, after the last was added."""
        if self._blocks:
            self._packed.close()
            self._file.seek(0)
            packed: Any = igzip.IGzipFile(fileobj=self._file, mode="rb")  # type: ignore[no-untyped-call]
            for _ in range(self._blocks):
                yield pickle.load(packed)
        if self._parts:
            yield joined_counts(self._parts)

    def silences(self) -> list[tuple[float, float]]:
        """Return the interruptions: the time of the sample before, and how long it was [s]."""
        limit = max(PAUSE_S, 100.0 * float(np.median(self._medians))) if self._medians else 0.0
        return [(last, seconds) for last, seconds in self._steps if seconds > limit]

    def time_of(self, sample: int) -> float:
        """Return the time of a sample [s]."""
        for piece in self.pieces():
            if sample < piece.first + len(piece.time_s):
                return float(piece.time_s[sample - piece.first])
        raise IndexError(sample)


def _close(*opened: Any) -> None:
    with suppress(OSError):  # of a full disk, which has been reported
        for file in opened:
            file.close()
