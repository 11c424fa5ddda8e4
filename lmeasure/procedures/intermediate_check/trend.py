"""Checks over time: a table to which every check appends its closures, and never takes a row away."""

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import scipy.stats

from lmeasure.core import FileFormatError, FloatArray
from lmeasure.io import files
from lmeasure.procedures.intermediate_check.check import Checked

COLUMNS = ("time", "rig", "kind", "name", "value_mm", "u95_mm", "probability", "verdict")


@dataclass(frozen=True)
class Trend:
    """Rows of checks, oldest first: time in ISO 8601, UTC; part (r,): value over U95. Of the agreement of the channels the value
    is the root of chi-squared over its freedom, in no unit, and U95 that of its 95 % quantile."""

    time: tuple[str, ...]
    kind: tuple[str, ...]
    name: tuple[str, ...]
    part: FloatArray


def now() -> str:
    """The time as trends have it."""
    return datetime.now(UTC).strftime("%Y-%m-%dT%H:%M:%SZ")


def appended(path: Path, found: Checked, when: str, *, into: Path | None = None) -> Trend:
    """Append a check to a file, which may not be there yet, and give all of it; into: where it is written instead. FileFormatError where it
    is no such file, or of another rig: then nothing is written."""
    own: dict[str, list[str]] = {name: [] for name in COLUMNS}
    if Path(path).exists():
        table = files.read_table(path)
        if tuple(table.columns) != COLUMNS:
            raise FileFormatError(f"{path}: is no file of checks: its columns are not {', '.join(COLUMNS)}")
        own = {name: list(table.text(name)) for name in COLUMNS}
        other = next((rig for rig in own["rig"] if rig != found.rig), None)
        if other is not None:
            raise FileFormatError(f"{path}: has checks of rig {other!r}; this is {found.rig!r}: a trend is of one rig")
    verdict = "passed" if found.passed else "calibrate again"
    new = [(c.kind, c.name, c.value_mm, c.u95_mm, c.probability) for c in found.closures]
    if found.agreement is not None:
        reported = found.agreement
        limit = scipy.stats.chi2.ppf(0.95, reported.freedom)
        per = max(reported.freedom, 1)
        new.append(("agreement", "channels", float(np.sqrt(reported.chi_squared / per)), float(np.sqrt(limit / per)), reported.probability))
    for kind, name, *numbers in new:
        row = (when, found.rig, kind, name, *(f"{number:.17g}" for number in numbers), verdict)
        for column, text in zip(COLUMNS, row, strict=True):
            own[column].append(text)
    files.write_table(into or path, {name: np.array(values, dtype=np.object_) for name, values in own.items()})
    value, u95 = (np.array([float(v) for v in own[name]]) for name in ("value_mm", "u95_mm"))
    return Trend(tuple(own["time"]), tuple(own["kind"]), tuple(own["name"]), np.abs(value) / u95)
