"""What is plotted and said over time: a trajectory's scalars and statuses, counts, residuals, a calibration's record."""

from collections.abc import Mapping

import numpy as np
import rerun as rr

from lmeasure.calibration_record import CalibrationRecord
from lmeasure.kernels.screw import OK, STATUS
from lmeasure.lengths import length_residuals
from lmeasure.poses import Poses
from lmeasure.rig import Rig
from lmeasure.run import Run
from lmeasure.trajectory import Trajectory
from lmeasure.view.recording import FloatArray, at_rows, cable_colour, changed_rows, entity_path, send_scalars, time_indexes
from lmeasure.view.space import MAX_FRAMES, WHITE, log_motion, log_path, spread_rows

GOOD, BAD = (0, 130, 95), (213, 94, 0)
SERIES = {
    "position_mm": ("x_mm", "y_mm", "z_mm"),
    "u_position_mm": ("u_x_mm", "u_y_mm", "u_z_mm"),
    "u_rotation_rad": ("u_rx_rad", "u_ry_rad", "u_rz_rad"),
}


def log_trajectory(rec: rr.RecordingStream, rig: Rig, trajectory: Trajectory, errors: Mapping[str, FloatArray]) -> list[str]:
    """Everything a trajectory holds; returns what the reader must know."""
    indexes = time_indexes(trajectory.time_s)
    status, cause, cable = np.array(STATUS, dtype=np.object_)[trajectory.status], trajectory.cause, trajectory.cable
    changes = np.union1d(changed_rows(trajectory.status), np.union1d(changed_rows(cause), changed_rows(cable)))
    n = len(trajectory.time_s)
    frames = spread_rows(n, MAX_FRAMES, changes)
    notes = [f"uncertainties: {trajectory.covers}", *trajectory.notes, *_thinned(len(frames), n)]
    log_motion(rec, rig, indexes, trajectory.poses, frames)
    notes += log_path(rec, "/world/path", trajectory.poses, trajectory.status == OK, WHITE)

    send_scalars(rec, "/worst_pressure_angle_deg", indexes, trajectory.worst_pressure_angle_deg)
    columns = trajectory.columns()
    for group, names in SERIES.items():
        for name in names:
            send_scalars(rec, f"/{group}/{name}", indexes, columns[name])
    for name, values in errors.items():
        send_scalars(rec, entity_path("errors", name), indexes, values)

    texts = []
    for first, last in zip(changes, np.append(changes[1:], n) - 1, strict=True):
        detail = f": {cause[first]}" * bool(cause[first]) + f", cable {cable[first]}" * bool(cable[first])
        texts.append(f"samples {first} to {last}: {status[first]}{detail}")
    at = at_rows(indexes, changes)
    levels = np.where(trajectory.status[changes] == OK, "INFO", "WARN").tolist()
    rec.send_columns("/status", at, rr.TextLog.columns(text=texts, level=levels))
    shades = [GOOD if name == STATUS[OK] else BAD for name in STATUS]
    rec.log("/status_lane", rr.StateConfiguration(values=STATUS, colors=shades), static=True)
    rec.send_columns("/status_lane", at, rr.StateChange.columns(state=status[changes].tolist()))
    return notes


def _thinned(frames: int, samples: int) -> list[str]:
    text = f"cables, pulleys and platform are drawn at {frames} of {samples} samples; the tool and all scalars are whole"
    return [text] if frames < samples else []


def log_truth(rec: rr.RecordingStream, rig: Rig, run: Run, poses: FloatArray) -> list[str]:
    """Tool and cables along (n, 7) known poses of the run's samples."""
    n = len(poses)
    frames = spread_rows(n, MAX_FRAMES, np.zeros(1, np.int64))
    log_motion(rec, rig, time_indexes(run.passes[0].time_s), poses, frames)
    return ["tool and cables move as they truly did", *_thinned(len(frames), n)]


def log_residuals(rec: rr.RecordingStream, run: Run, trajectory: Trajectory) -> None:
    indexes = time_indexes(trajectory.time_s)
    residuals = length_residuals(run, trajectory.poses)
    for j, c in enumerate(run.rig.cable):
        entity = entity_path("residual_mm", c.name)
        rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=c.name), static=True)
        send_scalars(rec, entity, indexes, residuals[:, j])


def log_counts(rec: rr.RecordingStream, run: Run) -> None:
    """Recorded counts of every pass, on the pass' own clock."""
    for number, counts in enumerate(run.passes, 1):
        indexes = time_indexes(counts.time_s)
        for j, channel in enumerate(counts.channels):
            entity = entity_path("counts", f"pass{number}", channel)
            rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=channel), static=True)
            send_scalars(rec, entity, indexes, counts.recorded[:, j])


def log_record(rec: rr.RecordingStream, record: CalibrationRecord, reference: Poses | None) -> list[str]:
    """Residuals of a calibration by channel; returns its table of parameters and its warnings as lines of markdown."""
    names = reference.names if reference is not None else tuple(dict.fromkeys(r.pose for r in record.residuals))
    for j, channel in enumerate(dict.fromkeys(r.channel for r in record.residuals)):
        mine = {r.pose: r.mm for r in record.residuals if r.channel == channel}
        rows = np.array([i for i, name in enumerate(names, 1) if name in mine])
        entity = entity_path("calibration_residual_mm", channel)
        rec.log(entity, rr.SeriesLines(colors=cable_colour(j), names=channel), static=True)
        values = np.array([mine[names[i - 1]] for i in rows])
        send_scalars(rec, entity, [rr.TimeColumn("pose", sequence=rows)], values)
    lines = [f"**{w.code}**: {w.text}" for w in record.warnings]
    lines += [f"undetermined at {u.point}: {u.text}" for u in record.unobservable]
    lines.append(f"calibration: {record.equations} equations, {record.unknowns} unknowns, rank {record.rank}")
    return lines
