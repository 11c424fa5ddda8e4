"""Results of a stage that is about no single run: a program, poses, a path, and values with bands."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from lmeasure.core import FloatArray
from lmeasure.recording import Program
from lmeasure.rig import Rig
from lmeasure.view.recording import (
    GREY,
    MAX_PATH_POINTS,
    PLAIN,
    THICK,
    THIN,
    Thinned,
    cable_colour,
    draw_path,
    entity_path,
    log_rig,
    metres,
    named,
    recording,
    send_measurements,
    send_scalars,
    send_tool,
    shown,
    time_indexes,
)

STEP_MM = 10.0
"""Largest distance between the drawn points of a commanded path."""
Placed = tuple[Sequence[str], FloatArray]
"""Names of points and their positions (n, 3) [mm]."""


@dataclass(frozen=True)
class Series:
    """Values (n,) and the half width of the band around each, at times [s] or, without times, at rows from 1."""

    values: FloatArray
    band: FloatArray | None = None
    time_s: FloatArray | None = None

    def send(self, rec: rr.RecordingStream, entity: str) -> None:
        """Write the values to an entity, with a band where they have one."""
        rows = [rr.TimeColumn("row", sequence=np.arange(1, len(self.values) + 1))]
        index = rows if self.time_s is None else time_indexes(self.time_s)
        if self.band is None:
            send_scalars(rec, entity, index, self.values)
        else:
            send_measurements(rec, entity, index, self.values, u=self.band)


def write_scene(
    path: Path,
    title: str,
    *,
    rig: Rig | None = None,
    program: Program | None = None,
    points: Mapping[str, Placed] | None = None,
    moving: tuple[FloatArray, FloatArray] | None = None,
    series: Mapping[tuple[str, str], Series] | None = None,
    notes: Sequence[str] = (),
) -> None:
    """Write one .rrd, whole or not at all.

    moving: times (n,) [s] and poses (n, 7) [mm] of the tool, NaN in gaps; series: by group and name, one plot for each group.
    LMeasureError when the file cannot be written.
    """
    series = series or {}
    with recording(Path(path), f"lmeasure {title}") as rec:
        rec.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        if rig is not None:
            log_rig(rec, rig, "/world/rig", PLAIN, labelled=True)
        if program is not None:
            _log_program(rec, program)
        for number, (name, (labels, positions)) in enumerate((points or {}).items()):
            at = rr.Points3D(metres(positions), radii=THICK, colors=cable_colour(number), labels=labels, show_labels=False)
            rec.log(entity_path("world", name), at, static=True)
        lines = list(notes)
        if moving is not None:
            time_s, poses = moving
            send_tool(rec, time_indexes(time_s), poses, place_only=bool(np.isnan(poses[:, 3:]).all()))
            thinned = Thinned(MAX_PATH_POINTS, 4)
            thinned.add(np.column_stack([poses[:, :3], ~np.isnan(poses[:, 0])]), np.zeros(1, np.int64))
            lines += draw_path(rec, "/world/path", thinned, PLAIN)
        for (group, name), one in series.items():
            entity = entity_path(group, name)
            rec.log(entity, rr.SeriesLines(names=name), static=True)
            one.send(rec, entity)
        text = "\n".join([f"# {title}", "", *(f"- {shown(line)}" for line in lines)])
        rec.log("/notes", rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN), static=True)
        plots: list[rrb.View] = [rrb.TimeSeriesView(name=group, origin=entity_path(group)) for group in dict.fromkeys(g for g, _ in series)]
        right = [rrb.Tabs(*plots)] if plots else []
        space = rrb.Spatial3DView(name=title, origin="/world")
        layout = rrb.Horizontal(
            space, rrb.Vertical(*right, rrb.TextDocumentView(name=named("notes"), origin="/notes")), column_shares=[3, 2]
        )
        rec.send_blueprint(rrb.Blueprint(layout, rrb.TimePanel(state="collapsed")), make_active=True, make_default=True)


def _log_program(rec: rr.RecordingStream, program: Program) -> None:
    """Draw commanded poses and paths."""
    at = metres(np.array([p.position_mm for p in program.pose]).reshape(-1, 3))
    rec.log("/world/commanded/poses", rr.Points3D(at, radii=THICK, colors=GREY, labels=[p.name for p in program.pose]), static=True)
    strips = [metres(path.points(STEP_MM)) for path in program.path]
    rec.log("/world/commanded/paths", rr.LineStrips3D(strips, radii=THIN, colors=GREY, labels=[p.name for p in program.path]), static=True)
