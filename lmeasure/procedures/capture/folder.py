"""The folder of a capture: a calibration folder from its first reading on, and everything that a session needs to continue.

    rig.toml, reference_poses.csv, counts.csv   input of `lmeasure calibrate`
    capture.toml                                the mark of a capture, and its actions beside readings
    frames/1, frames/2, ...                     a recording of each session: raw frames, counts, faults

`counts.csv` is the state: the rows of one pose that follow one another are a reading, the samples of a dwell, with their recording and
their time in it. It is written whole at every reading, so that a session that is killed leaves all readings or all but the last.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from lmeasure.acquisition import folded, moduli
from lmeasure.calibration import mean_variance, pooled_scatter
from lmeasure.core import AcquisitionError, FileFormatError, FloatArray, LMeasureError, OverwriteError
from lmeasure.io import files
from lmeasure.recording import AXIS_COLUMNS, Poses, read_poses
from lmeasure.rig import Rig, read_rig, write_rig
from lmeasure.text import message

SCHEMA = "lmeasure.capture/1"
UNCERTAINTIES = ("u_position_mm", "u_rotation_deg", "u_repeatability_mm")
MOST_ROWS = 50
"""Most rows of a dwell, spread over it: nearer samples repeat the same swing, and the same count."""


@dataclass(frozen=True)
class Reading:
    """A dwell at a pose: its samples' times (n,) [s] in a recording, and counts (n, m)."""

    pose: str
    passage: int
    recording: int
    time_s: FloatArray
    counts: FloatArray

    @property
    def mean(self) -> FloatArray:
        """(m,) mean counts."""
        return np.asarray(self.counts.mean(axis=0))

    @property
    def spread(self) -> FloatArray:
        """(m,) largest minus smallest count."""
        return np.asarray(np.ptp(self.counts, axis=0))


def thinned(pose: str, passage: int, recording: int, time_s: FloatArray, *, counts: FloatArray) -> Reading:
    """A reading of at most `MOST_ROWS` of a dwell's samples, spread evenly over it."""
    rows = np.unique(np.linspace(0, len(time_s) - 1, min(len(time_s), MOST_ROWS)).round().astype(np.int64))
    return Reading(pose, passage, recording, np.round(time_s[rows], 6), counts[rows])


def mean_variances(readings: list[Reading]) -> FloatArray:
    """(k, m) variances [counts^2] of the readings' means, as the calibration takes them (`calibration.campaign.dwells`)."""
    columns = []
    for j in range(readings[0].counts.shape[1]):
        scatter = pooled_scatter([r.counts[:, j] for r in readings])
        columns.append([mean_variance(scatter, len(r.counts)) for r in readings])
    return np.array(columns).T


class CaptureFolder:
    """A capture's folder: poses in the order in which they are to be read, readings in the order in which they were."""

    def __init__(self, path: Path, rig: Rig, channels: tuple[str, ...], passage: int) -> None:
        self.path, self.rig, self.channels, self.passage = Path(path), rig, channels, passage
        self.modulus = moduli(rig, channels, passage)
        self.readings: list[Reading] = []
        self.notes: list[str] = []

    @property
    def poses(self) -> Poses:
        """The reference poses as the folder states them."""
        return read_poses(self.path / "reference_poses.csv", self.rig.angles, positions_alone=True)

    @property
    def u_repeatability_mm(self) -> float:
        """Return the robot's stated repeatability, 0 without a statement."""
        table = files.read_table(self.path / "reference_poses.csv")
        return float(table.numbers(UNCERTAINTIES[2]).max()) if UNCERTAINTIES[2] in table.columns else 0.0

    @property
    def of_pass(self) -> list[Reading]:
        """Readings of the pass that is captured."""
        return [r for r in self.readings if r.passage == self.passage]

    @property
    def next_recording(self) -> int:
        """Number of the next recording of frames."""
        there = [int(p.name) for p in (self.path / "frames").glob("*") if p.name.isdigit()]
        return max([0, *there, *(r.recording for r in self.readings)]) + 1

    def frames(self, recording: int) -> Path:
        """The run folder of a recording."""
        return self.path / "frames" / str(recording)

    def add(self, reading: Reading) -> None:
        """Keep a reading, on the disk first: one that cannot be written is none."""
        self._keep([*self.readings, reading])

    def take_back(self) -> Reading:
        """Forget the last reading of the pass; its frames stay where they are."""
        reading = self.of_pass[-1]
        self._keep([r for r in self.readings if r is not reading])
        return reading

    def note(self, text: str) -> None:
        """Record an action beside readings."""
        notes = [*self.notes, text]
        files.write_toml(self.path / "capture.toml", {"schema": SCHEMA, "note": notes})
        self.notes = notes

    def state_uncertainty(self, stated: Mapping[str, float]) -> None:
        """Write how well the poses are known into reference_poses.csv: values by the names in `UNCERTAINTIES`."""
        path = self.path / "reference_poses.csv"
        columns = _columns(path)
        by_axis = next((c for c in columns if c in AXIS_COLUMNS), None)
        if by_axis is not None and set(stated) & set(UNCERTAINTIES[:2]):
            raise AcquisitionError(message("error.states_by_axes_how", where=path, by_axis=by_axis))
        count = len(columns["pose"])
        files.write_table(path, columns | {name: np.full(count, value) for name, value in stated.items()})

    def _keep(self, readings: list[Reading]) -> None:
        path = self.path / "counts.csv"
        if not readings:
            path.unlink(missing_ok=True)
            self.readings = []
            return
        columns: dict[str, Any] = {"pose": [r.pose for r in readings for _ in r.time_s]}
        if self.rig.passes > 1:
            columns["pass"] = np.concatenate([np.full(len(r.time_s), r.passage) for r in readings])
        every = np.vstack([r.counts for r in readings])
        codes = self.modulus > 0.0
        every[:, codes] %= self.modulus[codes]  # as the encoder shows them
        columns |= {name: _whole(every[:, j]) for j, name in enumerate(self.channels)}
        columns["recording"] = np.concatenate([np.full(len(r.time_s), r.recording) for r in readings])
        columns["time_s"] = np.concatenate([r.time_s for r in readings])
        files.write_table(path, columns)
        self.readings = readings


def open_folder(
    path: Path, rig: Rig, channels: tuple[str, ...], passage: int, *, planned: Path, beside: Mapping[str, bytes]
) -> CaptureFolder:
    """Return a new folder for the planned poses, or that of a capture of the same rig and poses, which continues; new planned poses are
    added.

    OverwriteError for any other folder, AcquisitionError for another rig, FileFormatError for poses that contradict its own.
    """
    path = Path(path)
    folder = CaptureFolder(path, rig, channels, passage)
    read_poses(planned, rig.angles, positions_alone=True)  # raises an error if they are wrong
    own = [path / name for name in ("rig.toml", "reference_poses.csv", "counts.csv", *beside)]
    begun = not (path / "capture.toml").exists()
    there = next((one for one in own if begun and one.exists()), None)
    if there is not None:
        raise OverwriteError(message("error.is_there_already_and", where=there, path=path))
    try:
        if begun:
            files.write_toml(path / "capture.toml", {"schema": SCHEMA, "note": []})
        # killed between two of these a session finds the others to be written
        if not (path / "rig.toml").exists():
            for name, content in beside.items():
                files.write_bytes(path / name, content)
            write_rig(path / "rig.toml", rig)
        if not (path / "reference_poses.csv").exists():
            files.write_table(path / "reference_poses.csv", _columns(planned))
    except LMeasureError:
        for one in (path / "capture.toml", *own) if begun else ():
            one.unlink(missing_ok=True)
        raise
    table = files.read_toml(path / "capture.toml")
    if table.get("schema") != SCHEMA:
        raise FileFormatError(
            message("error.schema_this_program_reads", where=path / "capture.toml", stated=table.get("schema"), schema=SCHEMA)
        )
    folder.notes = [str(text) for text in table.get("note", [])]
    links = {"can": None, "calibration": None}
    if read_rig(path / "rig.toml").model_copy(update=links) != rig.model_copy(update=links):
        raise AcquisitionError(message("error.is_another_rig_than_the", where=path / "rig.toml"))
    _join_poses(folder, planned)
    _read_readings(folder)
    return folder


def _join_poses(folder: CaptureFolder, planned: Path) -> None:
    """Planned poses that the folder has not, behind its own; FileFormatError where one of the same name is another pose."""
    path = folder.path / "reference_poses.csv"
    own, more = folder.poses, read_poses(planned, folder.rig.angles, positions_alone=True)
    for i, name in enumerate(more.names):
        if name in own.names and not np.allclose(more.rows[i], own.rows[own.names.index(name)], atol=1e-6):
            raise FileFormatError(message("error.pose_is_another_than", where=planned, name=name, path=path))
    new = np.array([name not in own.names for name in more.names])
    if not new.any():
        return
    there, planned_columns = _columns(path), _columns(planned)
    missing = next((c for c in planned_columns if c not in there), None)
    if missing is not None:
        raise FileFormatError(message("error.has_the_column_which", where=planned, missing=missing, path=path))
    columns: dict[str, Any] = {"pose": [*own.names, *(n for n, fresh in zip(more.names, new, strict=True) if fresh)]}
    for name, values in there.items():
        if name != "pose":
            # a value that only the old poses state applies to the new ones if all have the same
            other = planned_columns.get(name, np.full(len(new), values[0] if np.ptp(values) == 0.0 else np.nan))
            columns[name] = np.concatenate([values, other[new]])
    files.write_table(path, columns)


def _read_readings(folder: CaptureFolder) -> None:
    path = folder.path / "counts.csv"
    if not path.exists():
        return
    table = files.read_table(path)
    names, poses = table.text("pose"), set(folder.poses.names)
    counts, recording, time_s = table.matrix(folder.channels), table.numbers("recording"), table.numbers("time_s")
    passage = table.numbers("pass") if "pass" in table.columns else np.ones(len(names))
    key = [*zip(names, passage.tolist(), strict=True)]
    edges = [i for i in range(len(key)) if i == 0 or key[i] != key[i - 1]]
    for first, end in zip(edges, [*edges[1:], len(key)], strict=True):
        if names[first] not in poses:
            raise FileFormatError(message("error.line_pose_is_not", where=path, first=first + 2, names=names[first]))
        rows = slice(first, end)
        dwell = counts[first] + folded(counts[rows] - counts[first], folder.modulus)
        folder.readings.append(Reading(names[first], int(passage[first]), int(recording[first]), time_s[rows], dwell))


def _columns(path: Path) -> dict[str, Any]:
    """All columns of a table of poses."""
    table = files.read_table(path)
    return {name: table.text(name) if name == "pose" else table.numbers(name, gaps=True) for name in table.columns}


def _whole(values: FloatArray) -> Any:
    """Whole numbers as such."""
    return values.astype(np.int64) if (values == np.rint(values)).all() else values
