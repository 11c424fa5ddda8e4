"""A trajectory in a recording, whole or in pieces: what moves, what is plotted, what is said."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import rerun as rr

from lmeasure.accuracy import stated_radii_95
from lmeasure.core import WORDS, FloatArray, IntArray, Status
from lmeasure.rig import Rig
from lmeasure.text import message
from lmeasure.trajectory import Trajectory
from lmeasure.view.recording import changed_rows, entity_path, indexes_at, send_measurements, send_scalars, time_indexes
from lmeasure.view.space import MAX_FRAMES, MAX_PATH_POINTS, Thinned, draw_frames, draw_shaded_path, send_tool, thinned_note

GOOD, BAD = (0, 130, 95), (213, 94, 0)
PLACE = ("x_mm", "y_mm", "z_mm")
SERIES = {"u_position_mm": ("u_x_mm", "u_y_mm", "u_z_mm"), "u_rotation_rad": ("u_rx_rad", "u_ry_rad", "u_rz_rad")}


def log_trajectory(rec: rr.RecordingStream, rig: Rig, trajectory: Trajectory, errors: Mapping[str, FloatArray]) -> list[str]:
    """Everything a trajectory holds; returns what the reader must know."""
    log = TrajectoryLog(rec, rig)
    log.add(trajectory)
    indexes = time_indexes(trajectory.time_s)
    columns = trajectory.columns()
    for name, values in errors.items():
        if f"u_{name}" in columns:
            send_measurements(rec, entity_path("errors", name), indexes, values, u=columns[f"u_{name}"])
        else:
            send_scalars(rec, entity_path("errors", name), indexes, values)
    return log.end()


class TrajectoryLog:
    """A trajectory on its way into a recording: give it one piece after the other, then end it.

    Tool, scalars and statuses go out with their piece; of the poses only those are held at which cables and the path are drawn: a few
    thousand and those where the status changes.
    """

    def __init__(self, rec: rr.RecordingStream, rig: Rig) -> None:
        self._rec, self._rig = rec, rig
        self._frames = Thinned(MAX_FRAMES, 8)  # time and pose
        self._path = Thinned(MAX_PATH_POINTS, 5)  # place, whether it is known, its 95 % radius
        self._statuses = _Statuses(rec)
        # until a pose is known
        self._place_only = len({c.to_point for c in rig.cable}) == 1
        self._covers = ""
        self._notes: dict[str, None] = {}

    def add(self, piece: Trajectory) -> None:
        """Take the next samples."""
        rec, first = self._rec, self._frames.seen
        indexes = time_indexes(piece.time_s, first)
        known = ~np.isnan(piece.poses[:, 0])
        if known.any():
            self._place_only = bool(np.isnan(piece.poses[known, 3]).all())
        send_tool(rec, indexes, piece.poses, place_only=self._place_only)
        send_scalars(rec, "/worst_pressure_angle_deg", indexes, piece.worst_pressure_angle_deg)
        columns = piece.columns()
        for name in PLACE:
            send_measurements(rec, f"/position_mm/{name}", indexes, columns[name], u=columns[f"u_{name}"])
        for group, names in SERIES.items():
            for name in names:
                send_scalars(rec, f"/{group}/{name}", indexes, columns[name])
        changes = self._statuses.add(piece, first)
        self._frames.add(np.column_stack([piece.time_s, piece.poses]), changes)
        ok = piece.status == Status.OK
        before = self._path.rows[-1, 3] if len(self._path) else None
        radii = stated_radii_95((piece.random + piece.systematic)[:, 3:, 3:])
        self._path.add(np.column_stack([piece.poses[:, :3], ok, radii]), changed_rows(ok, before))
        self._covers = piece.covers
        self._notes |= dict.fromkeys(piece.notes)

    def end(self) -> list[str]:
        """Draw what goes over the whole run; returns what the reader must know."""
        self._statuses.end(self._frames.seen)
        frames, path = self._frames, self._path
        for i in range(0, len(frames), MAX_FRAMES):
            part = slice(i, i + MAX_FRAMES)
            indexes = indexes_at(frames.rows[part, 0], frames.numbers[part])
            draw_frames(self._rec, self._rig, indexes, frames.rows[part, 1:], place_only=self._place_only, looks=i == 0)
        notes = [message("trajectory.uncertainties", covers=self._covers), *self._notes, *thinned_note(frames)]
        return notes + draw_shaded_path(self._rec, "/world/path", path)


@dataclass
class _Stretch:
    """Samples of one status, from the first on."""

    first: int
    time_s: float
    status: int
    cause: str
    cable: str

    def text(self, last: int) -> str:
        detail = f": {self.cause}" * bool(self.cause) + f", cable {self.cable}" * bool(self.cable)
        return f"samples {self.first} to {last}: {WORDS[self.status]}{detail}"


class _Statuses:
    """Statuses as a log and a lane. A stretch of samples is said when it is known where it ends."""

    def __init__(self, rec: rr.RecordingStream) -> None:
        self._rec = rec
        self._open: _Stretch | None = None
        shades = [GOOD if status == Status.OK else BAD for status in Status]
        rec.log("/status_lane", rr.StateConfiguration(values=WORDS, colors=shades), static=True)

    def add(self, piece: Trajectory, first: int) -> IntArray:
        """Take the next samples, of which the first has that number; the rows at which something changes."""
        was = self._open
        causes = piece.cause
        columns = (piece.status, was and was.status), (causes, was and was.cause), (piece.cable, was and was.cable)
        rows = np.unique(np.concatenate([changed_rows(values, before) for values, before in columns]))
        begun = [_Stretch(first + i, float(piece.time_s[i]), int(piece.status[i]), causes[i], str(piece.cable[i])) for i in rows.tolist()]
        stretches = [was, *begun] if was is not None else begun
        self._say(stretches[:-1], [s.first - 1 for s in stretches[1:]])
        self._open = stretches[-1]
        return rows

    def end(self, samples: int) -> None:
        """The run has that many samples."""
        if self._open is not None:
            self._say([self._open], [samples - 1])

    def _say(self, stretches: list[_Stretch], last: list[int]) -> None:
        if not stretches:
            return
        at = indexes_at(np.array([s.time_s for s in stretches]), np.array([s.first for s in stretches]))
        texts = [s.text(i) for s, i in zip(stretches, last, strict=True)]
        levels = ["INFO" if s.status == Status.OK else "WARN" for s in stretches]
        self._rec.send_columns("/status", at, rr.TextLog.columns(text=texts, level=levels))
        self._rec.send_columns("/status_lane", at, rr.StateChange.columns(state=[WORDS[s.status] for s in stretches]))
