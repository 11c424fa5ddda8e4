"""What is plotted and said of what stands for itself: known poses, a calibration's record."""

import numpy as np
import rerun as rr

from lmeasure.core import FloatArray
from lmeasure.recording import Poses, Run
from lmeasure.rig import CalibrationRecord, Rig
from lmeasure.view.recording import cable_colour, entity_path, indexes_at, send_scalars, time_indexes
from lmeasure.view.space import MAX_FRAMES, draw_frames, send_tool, thinned_note
from lmeasure.view.subsample import Thinned


def log_truth(rec: rr.RecordingStream, rig: Rig, run: Run, poses: FloatArray) -> list[str]:
    """Tool and cables along (n, 7) known poses of the run's samples."""
    frames, time_s = Thinned(MAX_FRAMES, 8), run.passes[0].time_s
    frames.add(np.column_stack([time_s, poses]), np.zeros(1, np.int64))
    send_tool(rec, time_indexes(time_s), poses, place_only=False)
    draw_frames(rec, rig, indexes_at(frames.rows[:, 0], frames.numbers), frames.rows[:, 1:], place_only=False)
    return ["tool and cables move as they truly did", *thinned_note(frames)]


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
