"""Counts into a recording while they are made, for a viewer that follows the file."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import rerun as rr

from lmeasure.acquisition import Samples
from lmeasure.core import LMeasureError
from lmeasure.view.recording import CableSeries


@contextmanager
def growing_counts(path: Path, channels: tuple[str, ...], passage: int = 1) -> Iterator[Callable[[Samples], None]]:
    """A function that appends samples, their times from the first one [s], to the .rrd at path; what it holds can be read at any moment.

    The counts stand where `write_recording` puts those of the pass. LMeasureError when the file cannot be written.
    """
    rec = rr.RecordingStream("lmeasure")
    try:
        rec.save(path)
        series = CableSeries(rec, ("counts", f"pass{passage}"), channels)
    except RuntimeError as error:
        raise LMeasureError(f"{path}: cannot be written: {error}") from error
    given = 0

    def append(samples: Samples) -> None:
        nonlocal given
        series.add(samples.time_s, samples.recorded, given)
        given += len(samples.time_s)
        rec.flush()

    try:
        yield append
    finally:
        rec.disconnect()
