"""One .rrd file: written whole, checked, opened; and the indexes of its columns."""

import os
import subprocess
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from lmeasure import files
from lmeasure.errors import FileFormatError, LMeasureError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
Colour = tuple[int, int, int]

LAST_TIME_S = 9e9  # rerun counts nanoseconds in 64 bits
# `python -m rerun_cli` would lose the exit code
RERUN = (sys.executable, "-c", "import sys, rerun_cli.__main__ as r; sys.exit(r.main())")

# Okabe and Ito: told apart by colour-blind readers too
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
        raise FileFormatError(f"{path}: the name must end in .rrd")
    with files.whole(path) as temporary:
        rec = rr.RecordingStream("lmeasure")
        if not rr.is_enabled(rec):
            raise LMeasureError(f"{path}: the environment variable RERUN switches recordings off")
        try:
            rec.save(temporary)
            rec.send_recording_name(name)
            yield rec
            rec.flush()
        except RuntimeError as error:
            raise LMeasureError(f"{path}: cannot be written: {error}") from error
        finally:
            rec.disconnect()
        check_recording(temporary, path)


def check_recording(path: Path, name: Path | None = None) -> None:
    """FileFormatError (naming `name`, default the path) unless the file is a whole .rrd that this version of rerun reads."""
    from rerun.chunk import RrdReader

    name = name or path
    try:
        with Path(path).open("rb") as file:
            file.read(1)
        with warnings.catch_warnings():
            # a file that was cut off is only warned about
            warnings.simplefilter("error")
            RrdReader(path).store()
    except OSError as error:
        raise FileFormatError(f"{name}: cannot be read: {error.strerror or error}") from error
    except (RuntimeError, ValueError, Warning) as error:
        raise FileFormatError(f"{name}: is not a whole rerun recording") from error


def open_viewer(path: Path) -> None:
    """Open a recording in rerun's viewer and wait until that is closed; LMeasureError without a recording or a display."""
    check_recording(path)
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise LMeasureError(f"{path}: cannot be shown: there is no display here; open it with `lmeasure view` on a machine that has one")
    # the viewer also listens for other programs' recordings: on this machine only
    code = subprocess.run([*RERUN, str(Path(path).resolve()), "--bind", "127.0.0.1"], check=False).returncode
    if code != 0:
        raise LMeasureError(f"{path}: the rerun viewer ended with code {code}")


def entity_path(*parts: str) -> str:
    """An entity path whose last parts are names from files: whatever they hold, each stays one part."""
    return rr.new_entity_path(list(parts))


def time_indexes(time_s: FloatArray) -> list[rr.TimeColumn]:
    """Indexes of samples: their time to the nearest nanosecond and their number."""
    if np.abs(time_s).max() > LAST_TIME_S:
        raise LMeasureError(f"time_s = {time_s[np.argmax(np.abs(time_s))]:g}: a recording holds times up to {LAST_TIME_S:g} s")
    return [
        rr.TimeColumn("time", duration=np.rint(time_s * 1e9).astype("timedelta64[ns]")),
        rr.TimeColumn("sample", sequence=np.arange(len(time_s))),
    ]


def at_rows(indexes: Sequence[rr.TimeColumn], rows: IntArray) -> list[rr.TimeColumn]:
    """The same indexes at some of their rows."""
    out = []
    for index in indexes:
        values = index.as_arrow_array().take(rows).to_numpy(zero_copy_only=False)
        name = index.timeline_name()
        out.append(rr.TimeColumn(name, duration=values) if values.dtype.kind == "m" else rr.TimeColumn(name, sequence=values))
    return out


def send_scalars(rec: rr.RecordingStream, entity: str, indexes: Sequence[rr.TimeColumn], values: FloatArray) -> None:
    rec.send_columns(entity, indexes, rr.Scalars.columns(scalars=np.ascontiguousarray(values, dtype=np.float64)))


def cable_colour(cable: int) -> Colour:
    return CABLE_COLOURS[cable % len(CABLE_COLOURS)]


def changed_rows(values: NDArray[np.generic]) -> IntArray:
    """Rows at which a value differs from the row before; the first row is one of them."""
    return np.concatenate([[0], np.flatnonzero(values[1:] != values[:-1]) + 1]).astype(np.int64)
