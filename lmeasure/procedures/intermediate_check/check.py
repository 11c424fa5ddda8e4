"""The check as a whole: from a run to closures, agreement and a verdict with a stated rate of false alarms."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from lmeasure.calibration import Distance
from lmeasure.core import DataFrame, FileFormatError, FloatArray, Shown, framed
from lmeasure.io import files
from lmeasure.procedures.intermediate_check.closures import Closure, Stops, closures, find_stops
from lmeasure.procedures.intermediate_check.moved_parts import Cause, Verdict, agreement
from lmeasure.recording import Run
from lmeasure.text import decimal, joined, message, texts
from lmeasure.trajectory import (
    Alignment,
    Reconstruction,
    RunModel,
    Situation,
    align,
    collect_epochs,
    estimate_origins,
    prepare,
    reconstruction_of,
)

ASSUMED_MM = 0.05
"""Standard deviation per axis of a robot's return, by default: that of an industrial robot."""
FAR_MM = 50.0
"""Motion of a part that a user at the machine would see."""


@dataclass(frozen=True)
class Limits:
    """alarm: rate of checks of a sound instrument that are not passed; near_mm: stops nearer than this are of one place; repeatability_mm:
    of the robot, per axis, None where it is not known."""

    alarm: float = 0.01
    near_mm: float = 2.0
    repeatability_mm: float | None = None


@dataclass(frozen=True, repr=False)
class Checked(Shown):
    """Stops and closures of a run, agreement of its channels (None without redundancy); limit: the probability under which one of them
    fails, so that all together have the chosen rate of false alarms; notes: keys of remarks (`said`)."""

    rig: str
    stops: Stops
    closures: tuple[Closure, ...]
    agreement: Verdict | None
    limit: float
    notes: tuple[str, ...]

    @property
    def failed(self) -> tuple[Closure, ...]:
        """Closures that are off by more than chance lets them be."""
        return tuple(c for c in self.closures if c.probability < self.limit)

    @property
    def disagrees(self) -> bool:
        """Return whether the channels contradict each other beyond chance."""
        return self.agreement is not None and self.agreement.probability < self.limit

    @property
    def astray_mm(self) -> float:
        """Return the misfit of the run if it is larger than parts of a rig move unseen, else 0: the run is of something else. A start
        stated elsewhere explains itself."""
        off = max((abs(c.value_mm) for c in self.failed), default=0.0)
        if self.causes:
            off = min(c.size if c.unit == "mm" and c.kind != "start" else 0.0 for c in self.causes)
        return off if off > FAR_MM else 0.0

    @property
    def passed(self) -> bool:
        return not self.failed and not self.disagrees

    @property
    def causes(self) -> tuple[Cause, ...]:
        """Return possible changes, only one if the data determine it."""
        return self.agreement.named if self.agreement is not None and self.disagrees else ()

    def about(self) -> dict[str, str]:
        """Rig, stops, verdict."""
        return {"rig": self.rig, "stops": str(len(self.stops)), "verdict": "passed" if self.passed else "calibrate again"}

    def to_frame(self) -> DataFrame:
        """A row for each closure."""
        return framed([vars(c) for c in self.closures])


def check_instrument(run: Run, distances: Sequence[Distance] = (), limits: Limits | None = None) -> Checked:
    """Check an instrument by a run, whose start is stated or known from absolute encoders. TrajectoryError without a start, for too few
    stops, or for unknown names of positions; raises the errors of `prepare`."""
    limits = limits or Limits()
    aligned = align(run)
    reconstruction = _reconstruction(run, aligned)
    budget, lengths, redundancy = reconstruction.budget, aligned.lengths, reconstruction.redundancy
    lengths = replace(lengths, change_mm=lengths.change_mm - budget.offsets(lengths.time_s))
    zero = None if redundancy is None else redundancy.zero
    stops = find_stops(budget, lengths, run.passes[0].source, limits.near_mm, zero=zero)
    n, m = stops.readings.shape
    repeatability = ASSUMED_MM if limits.repeatability_mm is None else limits.repeatability_mm
    counts = np.nan_to_num(stops.counts)
    known = budget.of(Situation(stops.begin_s, stops.poses, counts, np.zeros((n, m)), travel=stops.travel), compiled=False)
    found = closures(budget, stops, known, distances, repeatability_mm=repeatability)
    notes = []
    if limits.repeatability_mm is None:
        notes.append("repeatability")
    if run.calibration is None:
        notes.append("uncalibrated")
    if not any(c.kind == "return" for c in found):
        notes.append("open")
    if not distances:
        notes.append("distance")
    tests = len(found) + (reconstruction.redundancy is not None)
    limit = limits.alarm / max(tests, 1)
    reported = None
    if reconstruction.model.correction is not None:
        notes.append("effects")
    else:
        reported = agreement(reconstruction, stops, limit)
        if reported is None:
            notes.append("six")
    return Checked(run.rig.name, stops, found, reported, limit, tuple(notes))


def _reconstruction(run: Run, aligned: Alignment) -> Reconstruction:
    """Return the reconstruction of a run: where its start is stated, before the run has shown anything of its origins."""
    if run.start is None:
        if not any(run.rig.counter(o).absolute for o in run.rig.observed):
            # raises an error with the remedy
            _ = run.known_start
        # with all channels: their contradictions are the subject of the check
        found = prepare(aligned).with_estimate(None)
        lengths = aligned.zeroed(found.model.rig).lengths
        return found.with_estimate(estimate_origins(found, collect_epochs(found, [lengths])[0]))
    model = RunModel(
        run.rig,
        run.start,
        run.calibration,
        u_start=run.start_errors.u,
        assumed_start=run.start_errors.assumed,
        clocks=aligned.clocks,
        temperature_c=run.temperature_c,
        exact=run.unstated == "exact",
    )
    return reconstruction_of(model)


def as_dict(found: Checked) -> dict[str, Any]:
    """Return the content of a check's file."""
    stops, reported = found.stops, found.agreement
    return {
        "schema": "lmeasure.check-instrument/1",
        "rig": found.rig,
        "verdict": "passed" if found.passed else "calibrate again",
        "limit": found.limit,
        "closures": [vars(c) | {"failed": c in found.failed} for c in found.closures],
        "agreement": None
        if reported is None
        else {
            "chi_squared": reported.chi_squared,
            "freedom": reported.freedom,
            "probability": reported.probability,
            "failed": found.disagrees,
        },
        "moved": [_cause(c) for c in found.causes],
        "causes": [] if reported is None else [_cause(c) for c in reported.causes],
        "stops": [
            {
                "place": name,
                "begin_s": float(begin),
                "end_s": float(end),
                "position_mm": pose[:3].tolist(),
                "quaternion_xyzw": pose[3:].tolist(),
            }
            for name, begin, end, pose in zip(stops.names, stops.begin_s, stops.end_s, stops.poses, strict=True)
        ],
        "notes": said(found),
    }


def _cause(c: Cause) -> dict[str, Any]:
    return {"kind": c.kind, "name": c.name, "size": c.size, "u": c.u, "unit": c.unit, "rest": c.rest, "detectable": c.detectable}


def said(found: Checked, language: str = "en") -> list[str]:
    """The notes in the words of a language."""
    words = texts(language, "interim")
    return [words[f"note.{key}"].format(mm=decimal(language, f"{ASSUMED_MM:g}")) for key in found.notes]


def moved_text(c: Cause) -> str:
    """Return the changes in words."""
    unit = message(f"unit_sign.{c.unit}") if c.unit in ("mm", "deg", "%") else c.unit
    return message(f"check_line.moved.{c.kind}", name=c.name, size=c.size, unit=unit, u=c.u)


def verdict_text(found: Checked) -> str:
    """One sentence for a person."""
    if found.passed:
        return message("interim_line.passed_all_closes_agrees")
    if found.astray_mm:
        return message("procedures.not_judged_run_off", mm=found.astray_mm)
    failed = [message(f"check_line.off.{c.kind}", name=c.name, mm=c.value_mm, u95=c.u95_mm) for c in found.failed]
    if not found.causes:
        return message(
            "procedures.calibrate_again_has_moved", failed=joined(failed) or message("interim_line.channels_contradict_each_other")
        )
    reported = [moved_text(c) for c in found.causes]
    if len(reported) == 1:
        only = found.causes[0].kind == "start"
        return message("check_line.state" if only else "check_line.calibrate", cause=reported[0])
    return message("procedures.calibrate_again_one_these", causes=joined(reported))


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
            raise FileFormatError(message("error.is_no_file_of", where=path, columns=", ".join(COLUMNS)))
        own = {name: list(table.text(name)) for name in COLUMNS}
        other = next((rig for rig in own["rig"] if rig != found.rig), None)
        if other is not None:
            raise FileFormatError(message("error.has_checks_of_rig", where=path, other=other, rig=found.rig))
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
