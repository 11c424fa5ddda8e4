"""One .rrd file, written whole, and the indexes of its columns."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from lmeasure.core import FileFormatError, FloatArray, IntArray, LMeasureError
from lmeasure.io import files
from lmeasure.text import Message, message, of_terminal
from lmeasure.view.viewer import check_recording

Colour = tuple[int, int, int]

LAST_TIME_S = 9e9  # rerun counts nanoseconds in 64 bits
# Okabe and Ito: distinguished by colour-blind readers too
CABLE_COLOURS: tuple[Colour, ...] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (0, 114, 178),
    (213, 94, 0),
    (204, 121, 167),
)


@contextmanager
def recording(path: Path, name: str) -> Iterator[rr.RecordingStream]:
    """A stream into a temporary file that becomes `path` once it can be read back."""
    if path.suffix.lower() != ".rrd":
        raise FileFormatError(message("error.the_name_must_end_in_rrd", where=path))
    with files.whole(path) as temporary:
        rec = rr.RecordingStream("lmeasure")
        if not rr.is_enabled(rec):
            raise LMeasureError(message("error.the_environment_variable_rerun", where=path))
        _room(temporary)  # without any, rerun may wait for ever
        temporary.unlink()
        try:
            rec.save(temporary)
            rec.send_recording_name(name)
            yield rec
            rec.flush()
        except RuntimeError as error:
            _room(temporary)  # rerun does not say whether the disk is full
            raise LMeasureError(message("error.cannot_be_written_2", where=path, error=error)) from error
        finally:
            rec.disconnect()
        check_recording(temporary, path)


def _room(path: Path) -> None:
    """OSError where the file cannot grow; it is left as one that cannot be used."""
    with path.open("ab") as file:
        file.write(bytes(1 << 16))


def shown(line: str) -> str:
    """Return a line in the language of the terminal."""
    return line.text(of_terminal()) if isinstance(line, Message) else line


def named(name: str, /, **values: object) -> str:
    """Return the name of a part of a recording in the language of the terminal."""
    return message(f"view.name.{name}", **values).text(of_terminal())


def entity_path(*parts: str) -> str:
    """An entity path whose last parts are names from files: whatever they hold, each stays one part."""
    return rr.new_entity_path(list(parts))


def indexes_at(time_s: FloatArray, samples: IntArray) -> list[rr.TimeColumn]:
    """Indexes of samples: their time to the nearest nanosecond and their number."""
    if np.abs(time_s).max() > LAST_TIME_S:
        raise LMeasureError(message("error.time_s_a_recording", time_s=time_s[np.argmax(np.abs(time_s))], last_time_s=LAST_TIME_S))
    return [rr.TimeColumn("time", duration=np.rint(time_s * 1e9).astype("timedelta64[ns]")), rr.TimeColumn("sample", sequence=samples)]


def time_indexes(time_s: FloatArray, first: int = 0) -> list[rr.TimeColumn]:
    """Indexes of samples that follow each other, from the number of the first one on."""
    return indexes_at(time_s, first + np.arange(len(time_s)))


def send_scalars(rec: rr.RecordingStream, entity: str, indexes: Sequence[rr.TimeColumn], values: FloatArray) -> None:
    rec.send_columns(entity, indexes, rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=np.float64)))


def send_measurements(rec: rr.RecordingStream, entity: str, indexes: Sequence[rr.TimeColumn], values: FloatArray, *, u: FloatArray) -> None:
    """Send values with their standard uncertainties: a plot draws a line and a band of one standard uncertainty to each side."""
    columns = rr.Measurements.columns(values=np.ascontiguousarray(values, dtype=np.float64), variances=np.square(u, dtype=np.float64))
    rec.send_columns(entity, indexes, columns)


def cable_colour(cable: int) -> Colour:
    return CABLE_COLOURS[cable % len(CABLE_COLOURS)]


class CableSeries:
    """A figure of every cable or channel over time, given for one piece of a run after the other."""

    def __init__(self, rec: rr.RecordingStream, parents: Sequence[str], names: Sequence[str]) -> None:
        self._rec, self._entities = rec, [entity_path(*parents, name) for name in names]
        for j, (entity, name) in enumerate(zip(self._entities, names, strict=True)):
            rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=name), static=True)

    def add(self, time_s: FloatArray, values: FloatArray, first: int = 0) -> None:
        """Send (n, names) values at times (n,) of samples of which the first has that number."""
        indexes = time_indexes(time_s, first)
        for entity, column in zip(self._entities, values.T, strict=True):
            send_scalars(self._rec, entity, indexes, column)


def changed_rows(values: NDArray[np.generic], before: object = None) -> IntArray:
    """Rows at which a value differs from the row before, which to the first row is `before`; None: the first row is one of them."""
    later = np.flatnonzero(values[1:] != values[:-1]) + 1
    new = before is None or values[0] != before
    return np.concatenate([[0], later] if new else [later]).astype(np.int64)
