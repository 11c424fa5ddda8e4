"""Contents of a trajectory's pages: its summary, its series, its rows. Computed in the process of `worker`."""

import io
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.accuracy import AXIS_95, Along, along, kept_rows, merged
from lmeasure.core import FileFormatError, framed
from lmeasure.io import decoded_bytes
from lmeasure.report import about_stretch, trajectory_summary
from lmeasure.text import message
from lmeasure.trajectory import read_trajectory

SHOWN = 1500
"""Samples of a series that a picture gets, the extremes among them."""
LISTED = 500
ROWS = 50_000
"""Rows of a piece of a table."""
LARGEST = 2**30
"""Largest file that a page shows, and largest size of its numbers and texts [bytes]."""


@lru_cache(maxsize=2)
def _read(path: Path, changed_ns: int) -> Along:
    return along(read_trajectory(path))


def along_of(path: Path) -> Along:
    size = path.stat().st_size
    if max(size, decoded_bytes(path) if path.suffix.lower() == ".parquet" else 0) > LARGEST:
        raise FileFormatError(message("error.holds_more_than_mb", where=path, largest=LARGEST / 2**20))
    return _read(path, path.stat().st_mtime_ns)


def about(path: Path, language: str) -> dict[str, Any]:
    """Return summary, left_out, begin and end [s] of a trajectory file, in words of a language."""
    found = along_of(path)
    time_s = found.trajectory.time_s
    reported = {"summary": trajectory_summary(found, language), "left_out": left_out(found, language)}
    return reported | {"begin": float(time_s[0]), "end": float(time_s[-1])}


def left_out(found: Along, language: str) -> list[dict[str, Any]]:
    """Stretches without a pose, or without a cable, in words, in the order of time; those that lie close together are one."""
    time_s = found.trajectory.time_s
    kept = merged(found.stretches, float(time_s[-1] - time_s[0]) / LISTED)
    return [{"begin": s.begin_s, "end": s.end_s, "ok": s.ok, "text": about_stretch(s, language)} for s in kept[:LISTED]]


def series_of(path: Path, begin_s: float, end_s: float) -> dict[str, list[float | None]]:
    """Return the `series` of a trajectory file."""
    return series(along_of(path), begin_s, end_s)


def series(found: Along, begin_s: float, end_s: float) -> dict[str, list[float | None]]:
    """Return for the samples of a span time_s; x, y, z [mm] with their U95, u_x, u_y, u_z [mm]; u95 [mm], the radius; angle, the worst
    pressure angle [deg]."""
    moved = found.trajectory
    own = np.flatnonzero((moved.time_s >= begin_s) & (moved.time_s <= end_s))
    if not len(own):
        return {}
    u = AXIS_95 * moved.u[own, :3]
    columns = dict(zip(("x", "y", "z", "u_x", "u_y", "u_z"), (*moved.poses[own, :3].T, *u.T), strict=True))
    columns |= {"u95": found.u95_mm[own], "angle": moved.worst_pressure_angle_deg[own]}
    rows = kept_rows(list(columns.values()), np.zeros(0, np.int64), SHOWN)
    columns["time_s"] = moved.time_s[own]
    return {name: [None if value != value else value for value in values[rows].tolist()] for name, values in columns.items()}


@lru_cache(maxsize=1)
def _columns(path: Path, changed_ns: int) -> dict[str, Any]:
    return along_of(path).trajectory.columns()


def rows(path: Path, begin_s: float, end_s: float, first: int) -> tuple[str, int]:
    """Return the next ROWS samples of a span as .csv, all columns of a trajectory file, from row `first` of the file on; and the next row,
    0 behind the last one."""
    columns = _columns(path, path.stat().st_mtime_ns)
    time_s = columns["time_s"]
    own = np.flatnonzero((time_s[first:] >= begin_s) & (time_s[first:] <= end_s))[:ROWS] + first
    text = io.StringIO()
    framed({name: values[own] for name, values in columns.items()}).to_csv(text, index=False, header=first == 0)
    return text.getvalue(), int(own[-1]) + 1 if len(own) == ROWS else 0
